"""Finds sensors that were measured in another run: all modes of a structure have one frequency each, whatever sensor shows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.statistics.chain.modal import MODAL, ModalRule


class OtherRun(NamedTuple):
    """Sensors whose records show all modes at lower frequencies than those of other sensors.

    Attributes
    ----------
    lower, higher : list of str
        Names of the sensors.
    shift : float
        Relative difference of the frequencies (median).
    """

    lower: list[str]
    higher: list[str]
    shift: float


def other_run(jobs: Sequence[Mapping[str, Floats]], rule: ModalRule = MODAL, *, share: float = 0.8, least: int = 12) -> OtherRun | None:
    """Sensors that show the modes at other frequencies than others in the same jobs; None if there are none, or if they form no two groups.

    Each mode of a sensor is compared with the nearest one of another sensor; as neighbouring modes are confused, most must agree in the
    sign. In right campaigns at most 57 % of the pairs of two sensors did, mostly 10 %.

    Parameters
    ----------
    jobs : sequence of mapping
        Of each job the frequencies of the modes fitted to the records of each sensor alone [Hz].
    rule : ModalRule
        ``clock`` is the least median difference, ``tolerance`` the largest distance of the frequencies of one mode.
    share : float
        Least share of the modes that are lower by more than half of ``clock``.
    least : int
        Least number of modes of two sensors compared, in all jobs together.
    """
    names = list(dict.fromkeys(name for job in jobs for name in job))
    lower, higher, shifts = set[str](), set[str](), list[float]()
    for one, other in permutations(names, 2):
        found = np.concatenate([np.zeros(0), *(_shifts(job[one], job[other], rule.tolerance) for job in jobs if {one, other} <= set(job))])
        if found.size < least or float(np.median(found)) > -rule.clock or np.mean(found < -0.5 * rule.clock) < share:
            continue
        lower.add(one)
        higher.add(other)
        shifts.append(float(np.median(found)))
    if not shifts or lower & higher:
        return None
    return OtherRun([name for name in names if name in lower], [name for name in names if name in higher], -float(np.median(shifts)))


def _shifts(own: Floats, other: Floats, tolerance: float) -> Floats:
    """Relative differences of the frequencies [Hz] that are each other's nearest, within a tolerance."""
    if not own.size or not other.size:
        return np.zeros(0)
    away = np.abs(np.log(own[:, None] / other))
    nearest = away.argmin(axis=1)
    pairs = [(i, k) for i, k in enumerate(nearest.tolist()) if away[i, k] < tolerance and away[:, k].argmin() == i]
    return np.array([own[i] / other[k] - 1.0 for i, k in pairs])
