"""Choice of the lines that enter the cost: around the resonances, where noise matters least (Sec. 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers
from lrbc_cli.updating.peaks import peaks_of
from lrbc_cli.updating.residuals import decibel


@dataclass(frozen=True)
class Resonances:
    """Which lines belong to a resonance.

    Attributes
    ----------
    prominence_db : float
        A resonance stands out of the mean spectrum by at least this [dB]. A choice: twice the first model discrepancy.
    depth_db : float
        Lines within this of the peak belong to it [dB] ... By trial on virtual rigs.
    half_width : float
        ... as long as they are within this fraction of its frequency, or two lines. By trial on virtual rigs.
    """

    prominence_db: float = 2.0
    depth_db: float = 15.0
    half_width: float = 0.06


#: The default, for those who call a part alone.
RESONANCES = Resonances()


def resonance_lines(frequency_hz: Floats, measured: Complexes, rule: Resonances = RESONANCES) -> Integers:
    """Indices of the lines around the resonances of FRFs.

    Parameters
    ----------
    frequency_hz : (F,) float array
    measured : (F, R) complex array
        NaN where a response was not measured.
    rule : Resonances

    Returns
    -------
    (m,) int array
        Sorted; all lines where no resonance stands out.
    """
    chosen = np.flatnonzero(around_resonances(frequency_hz, measured, rule))
    return chosen if chosen.size else np.arange(frequency_hz.size)


def around_resonances(frequency_hz: Floats, H: Complexes, rule: Resonances = RESONANCES) -> Bools:
    """(F,) whether a line belongs to a resonance of these (F, R) FRFs."""
    valid = np.isfinite(H) & (np.abs(H) > 0)
    level = np.where(valid, decibel(np.where(valid, H, 1.0)), np.nan)
    keep: Bools = np.zeros(frequency_hz.size, dtype=bool)
    # Each response shows other resonances; the mean spectrum shows those that several share without the noise of each. A mean of
    # decibels also takes in some lines between antiresonances; with the mean power instead, fewer rigs were identified well.
    spectra = [level[:, r] for r in range(level.shape[1]) if valid[:, r].any()]
    if len(spectra) > 1:
        centred = np.stack([spectrum - np.nanmean(spectrum) for spectrum in spectra])
        spectra = [
            np.where(
                np.isfinite(centred).any(axis=0), np.nansum(centred, axis=0) / np.maximum(np.isfinite(centred).sum(axis=0), 1), -np.inf
            )
        ]
    for spectrum in spectra:
        filled = np.where(np.isfinite(spectrum), spectrum, np.nanmin(spectrum[np.isfinite(spectrum)]))
        peaks = peaks_of(filled, prominence=rule.prominence_db)
        for peak in peaks:
            for direction in (-1, 1):
                at = peak
                while 0 <= at < filled.size and filled[at] > filled[peak] - rule.depth_db:
                    near = abs(frequency_hz[at] - frequency_hz[peak]) <= rule.half_width * frequency_hz[peak] or abs(at - peak) <= 2
                    if not near:
                        break
                    keep[at] = True
                    at += direction
    return keep


def unresolved(measured: Complexes, *, prominence_db: float = 6.0, drop_db: float = 6.0) -> tuple[int, int]:
    """How many peaks of FRFs fall by more than ``drop_db`` to both neighbouring lines, and how many peaks there are.

    At the half-power points a resonance lies 3 dB below its peak: where lines are no further apart than those, one of the two lines beside
    a peak lies within that.

    Parameters
    ----------
    measured : (F, R) complex array
        NaN where a response was not measured.
    prominence_db : float
        Of what counts as a peak.
    drop_db : float
        A choice, that noise and the place of the peak between two lines do not reach where it is resolved.
    """
    sharp = total = 0
    for response in measured.T:
        valid = np.isfinite(response) & (np.abs(response) > 0)
        if valid.sum() < 3:
            continue
        level = decibel(response[valid])
        peaks = peaks_of(level, prominence=prominence_db)
        total += peaks.size
        sharp += int(np.count_nonzero(level[peaks] - np.maximum(level[peaks - 1], level[peaks + 1]) > drop_db))
    return sharp, total


def too_wide(*measured: Complexes, most: float = 1 / 3) -> str | None:
    """What to say of lines that do not resolve the peaks of FRFs; None where they do.

    Parameters
    ----------
    measured : (F, R) complex arrays
        Of one job, or of those that are compared.
    most : float
        Share of the peaks that may fall as far as in ``unresolved``. Of resonances anywhere between the lines a quarter do where these lie
        as far apart as the half-power points, and half of them at 1.6 times that.
    """
    sharp, peaks = (sum(counts) for counts in zip(*(unresolved(values) for values in measured), strict=True))
    if sharp <= most * peaks:
        return None
    return f"the lines do not resolve the peaks: {sharp} of {peaks} fall by more than 6 dB to both neighbouring lines"
