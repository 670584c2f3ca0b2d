"""Where the FRFs stop to feel a stiffness: start values and bounds that fit the exporter's scale of the terms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.updating.misfit import decibel

Floats = NDArray[np.float64]

#: Mean distance in dB from the clamped limit at the start value and at the upper bound, and from the free limit at the lower bound.
START_DB, BOUND_DB = 0.3, 0.02

#: Decades below and above the local stiffness between which the limits are sought.
SEARCH = (8.0, 6.0)

#: Halvings of a range of at most 14 decades: a thousandth of a decade.
STEPS = 14

#: Lower bound, start and upper bound in decades from the local stiffness where the FRFs reach no limit.
FALLBACK = (-4.0, 1.0, 4.0)


@dataclass(frozen=True)
class Saturation:
    """Uniform log10 stiffness of a group at which the FRFs reach their limits.

    Attributes
    ----------
    start : float
        ``START_DB`` from the clamped limit: below the plateau.
    lower, upper : float
        ``BOUND_DB`` from the free and from the clamped limit.
    found : bool
        False where the FRFs reach no such limit (clamping silences them, say): the values are then decades from the local stiffness.
    """

    start: float
    lower: float
    upper: float
    found: bool = True


def saturation(
    values: Callable[[NDArray[np.complexfloating[Any, Any]]], NDArray[np.complexfloating[Any, Any]]],
    D: NDArray[np.complexfloating[Any, Any]],
    terms: NDArray[np.int64],
    scale: float,
    baseline: float = 0.0,
) -> Saturation:
    """Find the limits of one group of stiffness terms, the others held.

    Parameters
    ----------
    values : callable
        From D (F, nt) to FRFs (F, R), on the lines of the band for the responses used.
    D : (F, nt) complex array
        Dynamic values of the other terms.
    terms : int array
        The group.
    scale : float
        Local stiffness of its terms: the search starts there.
    baseline : float
        What the operators already contain.

    Returns
    -------
    Saturation
        log10 values.
    """

    def level(value: float) -> Floats:
        trial = np.array(D, dtype=complex)
        trial[:, terms] = value - baseline
        return decibel(values(trial))

    with np.errstate(divide="ignore"):
        free, clamped = level(0.0), level(np.inf)

    def distance(p: float, limit: Floats) -> float:
        return float(np.mean(np.abs(level(10.0**p) - limit)))

    middle = float(np.log10(scale))

    def crossing(limit: Floats, target: float, low: float, high: float, rising: bool) -> float:
        # Bisection on a curve that falls (towards clamped) or rises (from free) but for small ripples.
        for _ in range(STEPS):
            p = 0.5 * (low + high)
            if (distance(p, limit) > target) == rising:
                high = p
            else:
                low = p
        return 0.5 * (low + high)

    low, high = middle - SEARCH[0], middle + SEARCH[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = [distance(high, clamped) <= BOUND_DB, distance(low, clamped) > START_DB, distance(low, free) <= BOUND_DB]
    if not all(ends):
        return Saturation(middle + FALLBACK[1], middle + FALLBACK[0], middle + FALLBACK[2], found=False)
    start = crossing(clamped, START_DB, low, high, rising=False)
    upper = crossing(clamped, BOUND_DB, start, high, rising=False)
    lower = crossing(free, BOUND_DB, low, start, rising=True)
    return Saturation(start, min(lower, start - 1.0), max(upper, start + 0.5))
