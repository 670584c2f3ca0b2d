"""The whole search of an identification: uniform values, coarse profiles along the edge, then all unknowns from several starts.

From a start on the clamped plateau with all values free at once, the damping exponent can flatten peaks that the stiffness has not yet
moved, and the optimiser stays in that basin. Coarse profiles move the peaks first.
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
    """Minimise the cost by bounded Gauss-Newton from many starts: best uniform values, coarse profiles, tables, places beside the best end.

    Parameters
    ----------
    misfit : Misfit
        Cost (29); its prior is the same on all levels.
    start : (size,) float array
    bounds : (size, 2) float array
    tolerance, max_iterations
        Stop rule of the last level, see ``gauss_newton``.
    further : mapping of str to (size,) float array
        Further starts of the last level, by description.
    span : (size, m) float array or None
        Unknowns z of the last level, ``prior + span z``; the scan of uniform values then moves the prior as a whole. None: all values.
    knots : sequence of int
        Number of values along an edge at each level before the last.
    coarse_tolerance, coarse_iterations
        Stop rule of these levels.
    first_iterations : (int, int)
        With a span: iterations of each descent, and of the better half of them; only the best one continues to its end (successive
        halving, Jamieson and Talwalkar, AISTATS 2016).
    left_out : sequence of float
        With a span: shares of the measured values that are left out to continue from the best end, see ``Race.look_beside``.
    rounds : int
        Largest number of rounds beside the best end; each joint adds one.
    joints : sequence of int
        Indices in z of the changes of joints, if all bolts are joints.
    mirrors : callable
        Pairs of joints that are exchanged together with a pair, see ``Shapes.mirrored``.
    wide : sequence of Misfit
        Costs over smoothed spectra, widest first, see ``smooth.smoothed_costs``.
    unexplained_db : float
        Mean misfit of the best end above which, without a span, single values are moved, see ``single_values``: the limit up to which a
        state counts as explained [dB].

    Returns
    -------
    Solution
        The lowest end, with the evaluations of all levels in its history, and the end of each start. With a span its Jacobian is to z. No
        admissible place that was evaluated has a lower cost.
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
    # Coarse profiles need values in a row, which joints are not.
    coarse = race.coarse(
        [trials[at] for at in begun], () if misfit.model.parameters.of_joints else knots, coarse_tolerance, coarse_iterations
    )
    race.begin([*zip(texts, coarse, strict=True), *places.items()], few)
    # A coarse level may have passed a lower place than its end.
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
    """The place with the least mean misfit that ``zoom`` tries along a uniform change of the stiffness groups."""
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
