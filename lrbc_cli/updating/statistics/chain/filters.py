"""Filters of a measuring chain, recognised in the ratios of measured to computed FRFs: high-pass, low-pass, resonance of a mounting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.robust import medians
from lrbc_cli.updating.statistics.decibels import decibel


@dataclass(frozen=True, kw_only=True)
class Filter:
    """A filter of second order and quality ``q``, or a Butterworth filter of some order.

    Attributes
    ----------
    corner_hz : float
        Corner, or resonance.
    order : int
    high : bool
        Whether it passes high frequencies.
    q : float
        Amplification at the resonance; 0 for a Butterworth filter.
    inverse : bool
        Whether the force passed it.
    """

    corner_hz: float
    order: int = 2
    high: bool = False
    q: float = 0.0
    inverse: bool = False

    def at(self, frequency_hz: Floats) -> Complexes:
        """Factor of the FRFs at (F,) frequencies."""
        s = 1j * frequency_hz / self.corner_hz
        s = 1.0 / s if self.high else s
        if self.q:
            factor = 1.0 / (1.0 + s / self.q + s**2)
        else:
            poles = np.exp(1j * np.pi * (2.0 * np.arange(1, self.order + 1) + self.order - 1.0) / (2.0 * self.order))
            factor = 1.0 / np.prod(s[:, None] - poles, axis=1)
        return np.asarray(1.0 / factor if self.inverse else factor)


def filters(
    frequency_hz: Floats, *, inverse: bool, corners: int = 24, orders: tuple[int, ...] = (1, 2, 3, 4), qs: tuple[float, ...] = (2, 4, 8, 16)
) -> list[Filter]:
    """Filters to try, with corners in the band; with ``inverse`` those of the force, too."""
    hz = np.geomspace(frequency_hz[0], frequency_hz[-1], corners).tolist()
    plain = [Filter(corner_hz=corner, order=order, high=high) for high in (True, False) for order in orders for corner in hz]
    if inverse:
        return plain + [Filter(corner_hz=each.corner_hz, order=each.order, high=each.high, inverse=True) for each in plain]
    return plain + [Filter(corner_hz=corner, q=q) for q in qs for corner in hz]


def filtered(
    frequency_hz: Floats,
    measured: Complexes,
    model: Complexes,
    tried: list[Filter],
    *,
    alike: float = 0.6,
    gain: float = 0.05,
    left: float = 0.9,
) -> Filter | None:
    """The filter that explains both levels and phases of all responses relative to the model; None if none does.

    Modes of lightly damped structures are real: errors of a model turn phases by 180 degrees between two resonances, not gradually, and
    not in all responses alike.

    Parameters
    ----------
    frequency_hz : (F,) float array
    measured, model : (F, R) complex arrays
    tried : list of Filter
    alike : float
        Least mean cosine between measured and computed phases with the filter; see ``comparison.scale.ALIKE``.
    gain : float
        Least gain of that cosine. On 25 virtual rigs no filter gained anything; one of first
        order with its corner at twice the lowest frequency gained 0.05, others 0.1 to 0.7.
    left : float
        Largest share of the median level misfit that is left. Filters left 0.9 to 0.4.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = measured / model
        level, phases = decibel(ratio), ratio / np.abs(ratio)
        # NaN on lines on which no response has a value.
        turn = np.where(np.isnan(phases), 0.0, phases).sum(axis=1) / np.sum(~np.isnan(phases), axis=1)
        level = medians(np.where(np.isfinite(level), level, np.nan) - medians(level, 0), 1)[:, 0]
    known = np.isfinite(level) & np.isfinite(turn)
    if not known.any():
        return None
    factors = np.array([np.ones(known.sum()), *(each.at(frequency_hz[known]) for each in tried)])
    cosine = np.real(turn[known] * np.conj(factors / np.abs(factors))).mean(axis=1)
    rest = level[known] - decibel(factors)
    off = np.abs(rest - np.median(rest, axis=1, keepdims=True)).mean(axis=1)
    explains = (cosine >= max(alike, cosine[0] + gain)) & (off <= left * off[0])
    if not explains.any():
        return None
    # Orders differ in levels where they hardly do in phases, and the other way round.
    return tried[int(np.where(explains, cosine - off / off[0], -np.inf).argmax()) - 1]
