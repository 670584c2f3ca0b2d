"""Change of the levels of FRFs by another damping of the structure, estimated from the FRFs alone, without a model."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.statistics.decibels import DB


def damping_pattern(frequency_hz: Floats, slope: Complexes) -> Floats:
    """(F, R) derivative of the levels to the loss factor of the structure [dB].

    FRFs of a structure with loss factor eta depend on ``(1 + i eta) K - omega² M`` alone, so a change of eta acts like a change of the
    frequency, turned by 90 degrees: ``d ln H / d eta = -i (1 + omega/2 d ln H / d omega) / (1 + i eta)``, here with eta neglected beside
    1. Levels change by the slope of the phase: down at resonances, up at antiresonances, hardly in between.

    Parameters
    ----------
    frequency_hz : (F,) float array
    slope : (F, R) complex array
        d ln H / d f [1/Hz].
    """
    return np.asarray(0.5 * DB * frequency_hz[:, None] * slope.imag)


def beside_damping(levels: Floats, pattern: Floats, *, bends: float = 1.0) -> Floats:
    """Differences of levels without the part that another damping explains; unchanged if they cannot be compared.

    Parameters
    ----------
    levels, pattern : float arrays of the same shape
        Differences of levels, and their pattern by ``damping_pattern`` [dB].
    bends : float
        Scale of the soft loss of the fit [dB], because differences at antiresonances are large. A choice.
    """
    known = np.isfinite(levels) & np.isfinite(pattern)
    own, size = levels[known], float(np.sqrt(np.mean(pattern[known] ** 2))) if known.any() else 0.0
    if size == 0.0:
        return levels
    moved = pattern[known] / size
    # Fitted together with a constant, as a gain is, which stays in the result.
    found = least_squares(lambda x: x[0] + x[1] * moved - own, np.array([np.median(own), 0.0]), loss="soft_l1", f_scale=bends)
    return np.asarray(levels - found.x[1] / size * np.where(known, pattern, 0.0))
