"""The grid of lines at which the error is estimated, the choice of the next line to be solved, and checks of lines against the band."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.errors import ConfigError

#: Ratio of the ends above which a band counts as wide.
WIDE_BAND = 40.0

#: Least distance of a chosen line from expansion points, as a share of the grid.
APART = 0.01

#: Largest number of lines in one call, so that a mistaken step does not fill the memory.
MAX_LINES = 200_000


def band_lines(band: tuple[float, float], place: str | None = None, hint: str = "narrow reduction.band") -> Floats:
    """The whole-number frequencies inside a band [Hz]; its two ends if it contains none.

    Raises
    ------
    ConfigError
        If there are more than ``MAX_LINES``.
    """
    first, last = np.ceil(band[0]), np.floor(band[1])
    if last - first > MAX_LINES:
        raise ConfigError(f"the band contains more than {MAX_LINES} lines at 1 Hz spacing", place=place, hint=hint)
    return np.arange(first, last + 1) if first <= last else np.array(band)


def require_in_band(lines: Floats, band: tuple[float, float], place: str | None = None, hint: str | None = None) -> None:
    """Refuse lines [Hz] outside the band in which the reduced model holds, and an empty list.

    Raises
    ------
    ConfigError
    """
    if lines.size == 0 or not (band[0] * (1 - 1e-9) <= lines.min() and lines.max() <= band[1] * (1 + 1e-9)):
        raise ConfigError(
            "the reduced model is not valid outside its band",
            place=place,
            expected=f"lines from {band[0]:g} to {band[1]:g} Hz",
            found=f"{lines.min():g} to {lines.max():g} Hz" if lines.size else "none",
            hint=hint,
        )


class Grid:
    """Lines of a band, evenly spaced; in a wide band half of them are spaced logarithmically, so that its lower decades are covered.

    Parameters
    ----------
    low, high : float
        Ends of the band [Hz].
    count : int

    Attributes
    ----------
    lines_hz : (count,) float array
        Ascending.
    """

    def __init__(self, low: float, high: float, count: int) -> None:
        lines = np.linspace(low, high, count)
        if low > 0 and high > WIDE_BAND * low:
            octaves = np.geomspace(low, high, count // 2)
            lines = np.sort(np.concatenate([octaves, np.linspace(low, high, count - octaves.size + 2)[1:-1]]))
        self.lines_hz: Floats = lines
        self._places = np.linspace(0.0, 1.0, count)

    def position(self, frequency_hz: Floats) -> Floats:
        """Position of lines [Hz] on the grid, from 0 to 1, counted in grid lines."""
        return np.asarray(np.interp(frequency_hz, self.lines_hz, self._places))

    def frequency(self, position: Floats) -> Floats:
        """The lines at positions on the grid [Hz]."""
        return np.asarray(np.interp(position, self._places, self.lines_hz))

    def worst(self, estimate: Floats, points: Sequence[float], held_out: Sequence[float], count: int, parts: int) -> list[float]:
        """Choose lines with the largest estimates, away from expansion points, each in a part of the grid without a held-out line.

        Parameters
        ----------
        estimate : (lines,) float array
        points, held_out : sequences of float
            Present expansion points and held-out lines [Hz].
        count : int
            Number of lines to choose.
        parts : int
            Number of equal parts of the grid.
        """

        def apart(lines: Sequence[float]) -> Floats:
            return np.asarray(np.abs(self._places[:, None] - np.array([*self.position(np.array(lines)), np.inf])[None, :]).min(axis=1))

        chosen: list[float] = []
        part = np.minimum(self._places * parts, parts - 1).astype(int)
        away = apart(points)
        for _ in range(count):
            free = ~np.isin(part, np.minimum(self.position(np.array([*held_out, *chosen])) * parts, parts - 1).astype(int))
            weight = np.where(free & (away > APART), estimate, 0.0)
            if not np.any(weight > 0):
                weight = np.where(free, away, 0.0) if free.any() else np.minimum(away, apart([*held_out, *chosen]))
            chosen.append(float(self.lines_hz[int(np.argmax(weight))]))
        return chosen


__all__ = ["MAX_LINES", "WIDE_BAND", "Grid", "band_lines", "require_in_band"]
