"""Start values by levels: first one value for a whole edge, then a few along it, then all.

With a start on the clamped plateau and every node free at once, the damping exponent can flatten the peaks that the stiffness has not
moved yet, and the optimiser stays in that basin. A coarse profile moves the peaks first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.misfit import Evaluation, FrfModel, Misfit
from lrbc_cli.updating.optimise import Best, HistoryEntry, Objective, Solution, Start, gauss_newton
from lrbc_cli.updating.shapes import Shapes

Floats = NDArray[np.float64]

#: Totals, bounds and spans are told apart down to this share: round-off of their sums.
ROUND_OFF = 1e-9


def hats(positions: Floats, knots: int) -> Floats:
    """(k, m) piecewise linear interpolation from evenly spaced knots to positions along an edge; knots that no term feels are left out."""
    if knots == 1 or np.ptp(positions) == 0.0:
        return np.ones((positions.size, 1))
    at = np.linspace(positions[0], positions[-1], knots)
    T = np.column_stack([np.interp(positions, at, row) for row in np.eye(knots)])
    return np.asarray(T[:, T.any(axis=0)])


def level_matrix(parameters: Parameterisation, knots: int, damping: bool) -> Floats:
    """(size, m) map from the values of a level to theta; p_damp is one of them where ``damping``."""
    columns: list[Floats] = []
    for group, (values, at) in zip(parameters.groups, parameters.slices, strict=True):
        positions = group.arc_length if group.arc_length is not None else np.arange(group.count, dtype=float)
        block = np.eye(group.count) if group.count <= knots else hats(positions, knots)
        columns.append(np.zeros((parameters.size, block.shape[1])))
        columns[-1][values] = block
        if at is not None and damping:
            columns.append(np.zeros((parameters.size, 1)))
            columns[-1][at] = 1.0
    return np.hstack(columns)


class Level:
    """The cost as a function of the values of one level, about a fixed theta.

    Parameters
    ----------
    misfit : callable
    theta : (size,) float array
    T : (size, m) float array
        ``theta + T z``.
    """

    def __init__(self, misfit: Objective, theta: Floats, T: Floats) -> None:
        self._misfit, self._theta, self._T = misfit, theta, T

    def __call__(self, z: Floats) -> Evaluation:
        """Cost and derivatives to z."""
        value = self._misfit(self.theta(z))
        return Evaluation(value.cost, value.total, value.data, value.misfit_db, value.residual, value.jacobian @ self._T)

    def theta(self, z: Floats) -> Floats:
        """The full theta."""
        return self._theta + self._T @ z

    def bounds(self, bounds: Floats) -> Floats:
        """(m, 2) bounds of z that keep theta inside its own: hats have weights from 0 to 1."""
        low, high = bounds[:, 0] - self._theta, bounds[:, 1] - self._theta
        half = 0.5 * self._T.max(axis=0)
        inside = half < self._T
        return np.array([[low[column].max(), high[column].min()] for column in inside.T])


def _moved(parameters: Parameterisation) -> NDArray[np.bool_]:
    """(size,) values of the stiffness groups; of all groups where there is none."""
    moved = np.zeros(parameters.size, dtype=bool)
    for group, (values, _) in zip(parameters.groups, parameters.slices, strict=True):
        moved[values] = group.kind == "stiffness"
    return moved if moved.any() else ~parameters.is_damping


def uniform_values(misfit: Misfit, theta: Floats, bounds: Floats, *, step: float = 0.25, most: int = 41) -> list[Floats]:
    """Thetas with a few uniform values of the stiffness groups between their bounds; p_damp, damping and mass groups stay.

    Where there is no stiffness group all groups are moved; in steps of at most ``step`` decades, ``most`` values at the most.
    """
    moved = _moved(misfit.model.parameters)
    width = bounds[:, 1] - bounds[:, 0]
    count = int(np.clip(np.ceil(float(np.max(width[moved], initial=0.0)) / step) + 1, 2, most))
    return [np.where(moved, bounds[:, 0] + fraction * width, theta) for fraction in np.linspace(0.0, 1.0, count)]


def zoom(
    objective: Objective, theta: Floats, bounds: Floats, direction: Floats, *, step: float = 0.125, least: float = 1e-4
) -> Iterator[tuple[Floats, Evaluation]]:
    """Compass search on the mean absolute difference, from steps that pass over many peaks down to such that stay between two lines.

    Where lines lie further apart than a peak is wide, the cost has a valley wherever a peak lies between two lines; the mean difference
    falls towards the truth all the same.

    Parameters
    ----------
    objective : callable
    theta : (size,) float array
        Where to begin.
    bounds : (size, 2) float array
    direction : (size,) float array
    step, least : float
        First and last step along it, halved where neither way helps.

    Yields
    ------
    (size,) float array, Evaluation
        Every place that is tried; the last one that lowers the mean difference is the best.
    """
    value = objective(theta)
    yield theta, value
    while step >= least:
        for way in (step, -step):
            trial = np.clip(theta + way * direction, *bounds.T)
            found = objective(trial)
            yield trial, found
            if found.misfit_db < value.misfit_db:
                theta, value = trial, found
                break
        else:
            step *= 0.5


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
    hop_rounds: int = 3,
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
    hop_rounds : int
        How often valleys beside that end are looked for, see ``hops``.

    Returns
    -------
    Solution
        With the evaluations of all levels in its history, and where each start led to; the Jacobian of its evaluation is to z where
        there is a span. None of the places seen that could be a solution costs less.
    """
    parameters = misfit.model.parameters
    seen = Best(misfit, _admissible(misfit, bounds, span))
    unknowns = parameters.size if span is None else span.shape[1]
    history: list[HistoryEntry] = []

    def note(entries: Iterable[HistoryEntry]) -> None:
        first = len(history)
        history.extend(replace(entry, evaluation=first + i) for i, entry in enumerate(entries))

    first = np.clip(start, bounds[:, 0], bounds[:, 1])
    trials = [first, *(uniform_values(misfit, first, bounds) if span is None else uniform_changes(misfit, bounds))]
    totals: list[float] = []
    for trial in trials:
        value = seen(trial)
        note([HistoryEntry(0, value.cost, value.misfit_db, bool(value.total < min(totals, default=np.inf)))])
        totals.append(value.total if np.isfinite(value.total) else np.inf)
    iterations = 0
    ends: list[tuple[str, Solution]] = []
    starts = [at for at in basins(totals) if not at or not np.array_equal(trials[at], first)]
    if span is None and len(trials) > 1:
        nearest, least_db = first, np.inf
        for place, found in zoom(seen, trials[starts[0]], bounds, _moved(parameters).astype(float)):
            note([HistoryEntry(0, found.cost, found.misfit_db, bool(found.total < min(totals)))])
            totals.append(found.total if np.isfinite(found.total) else np.inf)
            nearest, least_db = (place, found.misfit_db) if found.misfit_db < least_db else (nearest, least_db)
        further = {"the uniform value found by smaller steps": nearest} | dict(further or {})

    few, more = (min(count, max_iterations) for count in ((max_iterations, max_iterations) if span is None else first_iterations))

    def finish(description: str, theta: Floats) -> int:
        last = descend(misfit, theta, bounds, span, tolerance=tolerance, max_iterations=few)
        note(last.history)
        ends.append((description, last))
        return last.iterations

    def go_on(at: int, limit: int) -> int:
        description, end = ends[at]
        if end.status != "stopped" or end.iterations >= limit:
            return 0
        last = descend(misfit, end.theta, bounds, span, tolerance=tolerance, max_iterations=limit - end.iterations)
        note(last.history)
        ends[at] = description, replace(last, iterations=end.iterations + last.iterations)
        return last.iterations

    def halve(begin: int) -> int:
        order = sorted(range(begin, len(ends)), key=lambda at: ends[at][1].evaluation.total)
        return sum(go_on(at, more) for at in order[: (len(order) + 1) // 2])

    for at in starts:
        theta = trials[at]
        for count in knots:
            T = level_matrix(parameters, count, damping=True)
            if T.shape[1] >= unknowns:
                break
            level = Level(seen, theta, T)
            coarse = gauss_newton(
                level, np.zeros(T.shape[1]), level.bounds(bounds), tolerance=coarse_tolerance, max_iterations=coarse_iterations
            )
            note(coarse.history)
            iterations += coarse.iterations
            theta = np.clip(level.theta(coarse.theta), bounds[:, 0], bounds[:, 1])
        iterations += finish(_describe(parameters, trials[at], at, None if span is None else misfit.prior), theta)
    for description, theta in (further or {}).items():
        iterations += finish(description, theta)
    # A coarse level may pass a valley that its end has left.
    least = min(end.evaluation.total for _, end in ends)
    if seen.theta is not None and seen.evaluation is not None and not seen.evaluation.total >= (1 - ROUND_OFF) * least:
        iterations += finish("the best place seen on the way", seen.theta)
    iterations += halve(0)
    hopped = 0
    while span is not None and more < max_iterations:
        at = int(np.argmin([end.evaluation.total for _, end in ends]))
        iterations += go_on(at, max_iterations)
        description, end = ends[at]
        reached, before = end.evaluation.total, len(ends)
        for theta in hops(misfit, end, bounds, span) if np.isfinite(reached) else ():
            iterations += finish(f"a hop beside '{description}'", theta)
        iterations += halve(before)
        hopped += 1
        if hopped == hop_rounds or not min(end.evaluation.total for _, end in ends) < (1.0 - tolerance) * reached:
            break
    iterations += go_on(int(np.argmin([end.evaluation.total for _, end in ends])), max_iterations)
    # The first of equals, also where a cost is not finite.
    kept = 0
    for i, (_, end) in enumerate(ends):
        if end.evaluation.total < ends[kept][1].evaluation.total:
            kept = i
    led = tuple(Start(text, end.evaluation.cost, end.evaluation.total, i == kept, end.theta) for i, (text, end) in enumerate(ends))
    return replace(ends[kept][1], iterations=iterations, evaluations=len(history), history=tuple(history), starts=led)


def _admissible(misfit: Misfit, bounds: Floats, span: Floats | None) -> Callable[[Floats], bool]:
    """Whether a theta could be a solution: inside its bounds, and ``prior + span z`` with z inside its own where there is a span."""

    def inside(values: Floats, box: Floats) -> bool:
        return bool(np.all((values >= box[:, 0] - ROUND_OFF) & (values <= box[:, 1] + ROUND_OFF)))

    if span is None:
        return lambda theta: inside(theta, bounds)
    T, inverse, box = span, np.linalg.pinv(span), Level(misfit, misfit.prior, span).bounds(bounds)

    def spanned(theta: Floats) -> bool:
        z = inverse @ (theta - misfit.prior)
        return inside(theta, bounds) and inside(z, box) and bool(np.abs(misfit.prior + T @ z - theta).max() <= ROUND_OFF)

    return spanned


def hops(misfit: Misfit, end: Solution, bounds: Floats, span: Floats, *, step: float = 0.25, kept: int = 3) -> list[Floats]:
    """Places beside an optimum from which a descent may lead elsewhere: where the cost rises least for what its curvature promises.

    A peak that passes a line is a ridge in the cost, narrow and steep; beyond it there is another valley.

    Parameters
    ----------
    misfit : Misfit
    end : Solution
        Its Jacobian is to z.
    bounds : (size, 2) float array
    span : (size, m) float array
        Each of z is moved by so much either way.
    step : float
        [decades].
    kept : int
        Places to begin at.

    Returns
    -------
    list of (size,) float array
        One of each of z at most.
    """
    model, here = misfit.model, end.evaluation
    found: list[tuple[float, int, Floats]] = []
    frf = model.nearby(end.theta) if isinstance(model, FrfModel) else model.frf
    for k in np.flatnonzero(~model.parameters.is_damping @ np.abs(span) > 0).tolist():
        slope, column = float(here.jacobian[:, k] @ here.residual), here.jacobian[:, k]
        ratios = []
        for way in (step, -step):
            theta = np.clip(end.theta + way * span[:, k], *bounds.T)
            promised = float(column @ column) * way**2 + 2.0 * slope * way
            rise = misfit.sum(theta, frf) - here.total
            ratios.append((rise / promised if promised > 0.0 else np.inf, theta))
        ratio, theta = min(ratios, key=lambda one: one[0])
        found.append((ratio, k, theta))
    return [theta for ratio, _, theta in sorted(found, key=lambda one: one[:2])[:kept] if np.isfinite(ratio)]


def prior_draws(misfit: Misfit, shapes: Shapes, bounds: Floats, *, draws: int = 64, kept: int = 3, seed: int = 0) -> dict[str, Floats]:
    """The lowest of some changes drawn from the prior, as further starts.

    Tables of changes at single bolts start from discrete levels and from the damping of the prior; of small changes of everything at once
    they see nothing.

    Parameters
    ----------
    misfit : Misfit
    shapes : Shapes
    bounds : (size, 2) float array
    draws, kept, seed : int
        Draws, those of them to begin at, and the seed.

    Returns
    -------
    dict of str to (size,) float array
        The same for the same input.
    """
    rng = np.random.default_rng(seed)
    std = np.where(np.isfinite(shapes.std), shapes.std, 1.0)
    thetas = [np.clip(misfit.prior + shapes.T @ (std * draw), *bounds.T) for draw in rng.normal(size=(draws, std.size))]
    order = np.argsort([misfit.sum(theta) for theta in thetas], kind="stable")[:kept]
    return {f"changes drawn from the prior, {k + 1} of {draws}": thetas[k] for k in order}


def descend(
    misfit: Misfit, start: Floats, bounds: Floats, span: Floats | None = None, *, tolerance: float = 1e-4, max_iterations: int = 100
) -> Solution:
    """Gauss-Newton on all values, or on the unknowns z of ``prior + span z``; the Jacobian of its evaluation is to those."""
    if span is None:
        return gauss_newton(misfit, start, bounds, tolerance=tolerance, max_iterations=max_iterations)
    level = Level(misfit, misfit.prior, span)
    box = level.bounds(bounds)
    z = np.clip(np.linalg.lstsq(span, start - misfit.prior, rcond=None)[0], box[:, 0], box[:, 1])
    found = gauss_newton(level, z, box, tolerance=tolerance, max_iterations=max_iterations)
    return replace(found, theta=level.theta(found.theta))


def uniform_changes(misfit: Misfit, bounds: Floats, *, step: float = 0.25, most: int = 41) -> list[Floats]:
    """Thetas with the prior of the stiffness groups moved as a whole, as far as their bounds let it."""
    prior, moved = misfit.prior, _moved(misfit.model.parameters)
    low, high = (bounds - prior[:, None])[moved].T
    steps = np.arange(np.ceil(np.median(low) / step), np.floor(np.median(high) / step) + 1)[:most]
    return [np.clip(np.where(moved, prior + step * count, prior), bounds[:, 0], bounds[:, 1]) for count in steps]


def _describe(parameters: Parameterisation, theta: Floats, trial: int, prior: Floats | None) -> str:
    if trial == 0:
        return "start values of the campaign" if prior is None else "the reference job"
    if prior is not None:
        change = theta - prior
        return f"uniform change of log10 by {change[int(np.argmax(np.abs(change)))]:.3g}"
    stiff = [group.kind == "stiffness" for group in parameters.groups]
    moved = [
        f"{group.name} {theta[values][0]:.3g}"
        for group, (values, _), own in zip(parameters.groups, parameters.slices, stiff, strict=True)
        if own or not any(stiff)
    ]
    return "uniform log10 " + ", ".join(moved)


def near_tie(
    parameters: Parameterisation, starts: Sequence[Start], *, tie: float = 0.05, distance: float = 0.25
) -> tuple[Start, Start, float] | None:
    """The two best ends where they are as good as each other and clearly different; and how different, in decades.

    The difference is the rms over the terms of log10(W 10^p): what the smoothing hides does not count. As good are ends within ``tie`` in
    cost (log10), different ones at least ``distance`` decades apart.
    """
    if len(starts) < 2:
        return None
    best, second = sorted(starts, key=lambda start: start.total)[:2]
    apart = float(np.sqrt(np.mean((np.log10(parameters.scales(best.theta)) - np.log10(parameters.scales(second.theta))) ** 2)))
    return (best, second, apart) if second.cost - best.cost <= tie and apart >= distance else None


def basins(totals: Sequence[float], count: int = 2) -> list[int]:
    """Indices of the trials to start from: the lowest of so many basins, and trial 0, which is the given start.

    The trials after the first stand in order of their values.
    """
    scan = np.array([np.inf, *totals[1:], np.inf])
    valleys = [i for i in range(1, len(totals)) if scan[i] < scan[i - 1] and scan[i] <= scan[i + 1]]
    return [*sorted(valleys, key=lambda i: totals[i])[:count], 0]
