"""What another damping of the structure makes of levels, told from FRFs alone."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.statistics.decibels import DB


def damping_pattern(frequency_hz: Floats, slope: Complexes) -> Floats:
    """(F, R) change of the levels by one of the loss factor, over that [dB].

    FRFs of a structure with the loss factor eta depend on ``(1 + i eta) K - omega² M`` alone, so that eta turns what the frequency does by
    90 degrees: ``d ln H / d eta = -i (1 + omega/2 d ln H / d omega) / (1 + i eta)``, here with eta beside 1 left out. Levels move by the
    slope of the phase: down at resonances, up at antiresonances, hardly between.

    Parameters
    ----------
    frequency_hz : (F,) float array
    slope : (F, R) complex array
        Of ln H along the frequency [1/Hz].
    """
    return np.asarray(0.5 * DB * frequency_hz[:, None] * slope.imag)


def beside_damping(levels: Floats, pattern: Floats, *, bends: float = 1.0) -> Floats:
    """Differences of levels without what of them is another damping; as they are where they cannot be compared.

    Parameters
    ----------
    levels, pattern : arrays of one shape
        [dB]
    bends : float
        From where on a difference counts by its size only, as those at antiresonances [dB]. A choice.
    """
    known = np.isfinite(levels) & np.isfinite(pattern)
    own, size = levels[known], float(np.sqrt(np.mean(pattern[known] ** 2))) if known.any() else 0.0
    if size == 0.0:
        return levels
    moved = pattern[known] / size
    # Beside a constant, which a gain is.
    found = least_squares(lambda x: x[0] + x[1] * moved - own, np.array([np.median(own), 0.0]), loss="soft_l1", f_scale=bends)
    return np.asarray(levels - found.x[1] / size * np.where(known, pattern, 0.0))
