"""Start values by levels: first one value for a whole edge, then a few along it, then all.

With a start on the clamped plateau and every node free at once, the damping exponent can flatten the peaks that the stiffness has not
moved yet, and the optimiser stays in that basin. A coarse profile moves the peaks first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.search.descent import ROUND_OFF
from lrbc_cli.updating.search.optimise import Solution
from lrbc_cli.updating.search.race import Race
from lrbc_cli.updating.search.starts import (
    Mirrors,
    alone,
    basins,
    group_levels,
    moved_values,
    single_values,
    uniform_changes,
    uniform_values,
    zoom,
)


def gauss_newton_by_levels(
    misfit: Misfit,
    start: Floats,
    bounds: Floats,
    *,
    tolerance: float = 1e-4,
    max_iterations: int = 100,
    further: Mapping[str, Floats] | None = None,
    span: Floats | None = None,
    knots: Sequence[int] = (1, 3, 5, 9),
    coarse_tolerance: float = 1e-3,
    coarse_iterations: int = 25,
    first_iterations: tuple[int, int] = (3, 8),
    left_out: Sequence[float] = (0.03, 0.2),
    rounds: int = 3,
    joints: Sequence[int] = (),
    mirrors: Mirrors = alone,
    wide: Sequence[Misfit] = (),
    unexplained_db: float = 3.0,
) -> Solution:
    """Bounded Gauss-Newton on a uniform value, on coarse profiles, then on all parameters.

    Parameters
    ----------
    misfit : Misfit
        Cost (29); its prior stays the same on all levels.
    start : (size,) float array
    bounds : (size, 2) float array
    tolerance, max_iterations
        Of the last level, see ``gauss_newton``.
    further : mapping of str to (size,) float array
        Described profiles from which the last level is tried too.
    span : (size, m) float array or None
        Unknowns of the last level, ``prior + span z``; every value where None. The scan then moves the prior as a whole.
    knots : sequence of int
        Values along an edge at each level before the full one.
    coarse_tolerance, coarse_iterations
        Stop rule of these levels.
    first_iterations : (int, int)
        Where there is a span: of each descent, and of the better half of them; only the best goes on to its end (successive halving,
        Jamieson and Talwalkar, AISTATS 2016).
    left_out : sequence of float
        Where there is a span: shares of the values without which the best end is followed further, see ``Race.look_beside``.
    rounds : int
        How often, and once more for each joint.
    joints : sequence of int
        Of the unknowns of a span, the changes of the joints where there is nothing else.
    mirrors : callable
        Which of them are exchanged with two of them, see ``Shapes.mirrored``.
    wide : sequence of Misfit
        The cost between smoothed spectra, the widest first, see ``smooth.smoothed_costs``.
    unexplained_db : float
        Mean difference of the best end above which, without a span, single values are tried, see ``single_values``: where it would not be
        called explained [dB].

    Returns
    -------
    Solution
        With the evaluations of all levels in its history, and where each start led to; the Jacobian of its evaluation is to z where
        there is a span. None of the places seen that could be a solution costs less.
    """
    race = Race(misfit, bounds, span, tolerance, max_iterations)
    few, more = (max_iterations, max_iterations) if span is None else first_iterations
    first = np.clip(start, bounds[:, 0], bounds[:, 1])
    trials = [first, *(uniform_values(misfit, first, bounds) if span is None else uniform_changes(misfit, bounds))]
    totals: list[float] = []
    for trial in trials:
        race.tried(race.seen(trial), totals)
    begun = [at for at in basins(totals) if not at or not np.array_equal(trials[at], first)]
    places, apart = dict(further or {}), list[Floats]()
    if span is None and len(trials) > 1:
        nearest = _nearest_uniform(race, misfit, trials[begun[0]], bounds, totals)
        apart = group_levels(misfit, nearest, bounds)
        places = {"the uniform value found by smaller steps": nearest} | places
        places |= {f"levels of the groups, {k + 1}": place for k, place in enumerate(apart)}
    texts = [_describe(misfit.model.parameters, trials[at], at, None if span is None else misfit.prior) for at in begun]
    # Coarse profiles are for values in a row.
    coarse = race.coarse(
        [trials[at] for at in begun], () if misfit.model.parameters.of_joints else knots, coarse_tolerance, coarse_iterations
    )
    race.begin([*zip(texts, coarse, strict=True), *places.items()], few)
    # A coarse level may pass a valley that its end has left.
    passed, least = race.seen, race.ends[race.best][1].evaluation.total
    if passed.theta is not None and passed.evaluation is not None and not passed.evaluation.total >= (1 - ROUND_OFF) * least:
        race.begin([("the best place seen on the way", passed.theta)], few)
    race.halve(0, more)
    found = race.ends[race.best][1]
    if span is None and found.evaluation.misfit_db > unexplained_db:
        moved = side_by_side(lambda place: single_values(misfit, place, bounds), (found.theta, *apart[:1]))
        race.begin([("single values moved by tables", place) for place in moved])
    if span is not None and more < max_iterations:
        race.look_beside(span, left_out, (few, more), rounds, joints, mirrors, wide)
    race.go_on([race.best])
    return race.solution()


def _nearest_uniform(race: Race, misfit: Misfit, theta: Floats, bounds: Floats, totals: list[float]) -> Floats:
    """The place of ``zoom`` with the least mean difference."""
    tried = []
    for place, value in zoom(race.seen, theta, bounds, moved_values(misfit.model.parameters).astype(float)):
        race.tried(value, totals)
        tried.append((value.misfit_db, place))
    return min(tried, key=lambda one: one[0] if np.isfinite(one[0]) else np.inf)[1]


def _describe(parameters: Parameterisation, theta: Floats, trial: int, prior: Floats | None) -> str:
    if trial == 0:
        return "start values of the campaign" if prior is None else "the reference job"
    if prior is not None:
        change = theta - prior
        return f"uniform change of log10 by {change[int(np.argmax(np.abs(change)))]:.3g}"
    stiff = [(group, values) for group, values, _ in parameters.placed if group.kind == "stiffness"]
    moved = stiff or [(group, values) for group, values, _ in parameters.placed]
    return "uniform log10 " + ", ".join(f"{group.name} {theta[values][0]:.3g}" for group, values in moved)
