"""Saturation: the stiffness above or below which FRFs no longer change; it gives start values and bounds for any scale of the terms.

The unit of a term depends on the exporter, so no fixed start value fits all models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.updating.checked import Checked, Positive
from lrbc_cli.updating.statistics.decibels import decibel


@dataclass(frozen=True, kw_only=True)
class Limits(Checked):
    """When FRFs count as those of the free or clamped limit.

    Attributes
    ----------
    start_db : float
        Mean distance of the FRFs from the clamped limit at the start value [dB]. A choice: below the plateau, where the gradient is useful.
    bound_db : float
        The same at the upper bound, and from the free limit at the lower bound [dB]. A choice: no measurement resolves less.
    fallback : (float, float, float)
        Lower bound, start and upper bound if the FRFs reach no limit, in decades from the local stiffness. A choice.
    """

    start_db: Positive = 0.3
    bound_db: Positive = 0.02
    fallback: tuple[float, float, float] = (-4.0, 1.0, 4.0)


#: The default, for callers that use a part of the package by itself.
LIMITS = Limits()


@dataclass(frozen=True)
class Saturation:
    """Start value and bounds of a group, as uniform log10 stiffness.

    Attributes
    ----------
    start : float
        Where the FRFs are ``Limits.start_db`` from the clamped limit.
    lower, upper : float
        Where they are ``Limits.bound_db`` from the free and from the clamped limit.
    found : bool
        False if the FRFs reach no such limit (for example because clamping makes them zero) and ``Limits.fallback`` is used.
    """

    start: float
    lower: float
    upper: float
    found: bool = True


def saturation(
    values: Callable[[Complexes], Complexes],
    D: Complexes,
    terms: Integers,
    scale: float,
    limits: Limits = LIMITS,
    *,
    search: tuple[float, float] = (8.0, 6.0),
    steps: int = 14,
) -> Saturation:
    """Start value and bounds of one group of stiffness terms by bisection, with the other terms fixed.

    Parameters
    ----------
    values : callable
        From D (F, nt) to FRFs (F, R), on the lines of the band for the responses used.
    D : (F, nt) complex array
        Dynamic values of all terms; those of the group are replaced.
    terms : int array
        Terms of the group.
    scale : float
        Local stiffness of its terms, the centre of the search.
    limits : Limits
    search, steps : (float, float), int
        Range of the search in decades below and above the local stiffness, and number of bisections.

    Returns
    -------
    Saturation
        The lower bound is at least a decade below the start, the upper one at least half a decade above.
    """

    def level(value: float) -> Floats:
        trial = np.array(D, dtype=complex)
        trial[:, terms] = value
        return decibel(values(trial))

    with np.errstate(divide="ignore"):
        free, clamped = level(0.0), level(np.inf)

    def distance(p: float, limit: Floats) -> float:
        return float(np.mean(np.abs(level(10.0**p) - limit)))

    def crossing(limit: Floats, target: float, low: float, high: float, rising: bool) -> float:
        # The distance falls (towards clamped) or rises (from free) monotonically except for small ripples.
        for _ in range(steps):
            p = 0.5 * (low + high)
            low, high = (low, p) if (distance(p, limit) > target) == rising else (p, high)
        return 0.5 * (low + high)

    middle = float(np.log10(scale))
    low, high = middle - search[0], middle + search[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        reached = distance(high, clamped) <= limits.bound_db and distance(low, free) <= limits.bound_db
        if not (reached and distance(low, clamped) > limits.start_db):
            return Saturation(middle + limits.fallback[1], middle + limits.fallback[0], middle + limits.fallback[2], found=False)
        start = crossing(clamped, limits.start_db, low, high, rising=False)
        upper = crossing(clamped, limits.bound_db, start, high, rising=False)
        lower = crossing(free, limits.bound_db, low, start, rising=True)
    return Saturation(start, min(lower, start - 1.0), max(upper, start + 0.5))
