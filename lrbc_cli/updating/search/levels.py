"""Start values by levels: first one value for a whole edge, then a few along it, then all.

With a start on the clamped plateau and every node free at once, the damping exponent can flatten the peaks that the stiffness has not
moved yet, and the optimiser stays in that basin. A coarse profile moves the peaks first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.misfit.cost import Evaluation, Misfit
from lrbc_cli.updating.search.optimise import Best, HistoryEntry, Objective, Solution, Start, gauss_newton
from lrbc_cli.updating.search.starts import (
    Mirrors,
    alone,
    basins,
    group_levels,
    hops,
    moved_values,
    other_levels,
    single_values,
    uniform_changes,
    uniform_values,
    zoom,
)

#: Totals, bounds and spans are told apart down to this share: round-off of their sums.
ROUND_OFF = 1e-9

#: How the description of an end goes on that was followed further, see ``Race.look_beside``.
BESIDE = ", then"


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
    for group, values, at in parameters.placed:
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
        return Evaluation(
            cost=value.cost,
            total=value.total,
            data=value.data,
            misfit_db=value.misfit_db,
            residual=value.residual,
            jacobian=value.jacobian @ self._T,
        )

    def theta(self, z: Floats) -> Floats:
        """The full theta."""
        return self._theta + self._T @ z

    def bounds(self, bounds: Floats) -> Floats:
        """(m, 2) bounds of z that keep theta inside its own: hats have weights from 0 to 1."""
        low, high = bounds[:, 0] - self._theta, bounds[:, 1] - self._theta
        half = 0.5 * self._T.max(axis=0)
        inside = half < self._T
        return np.array([[low[column].max(), high[column].min()] for column in inside.T])


class Race:
    """Descents from many places, of which the better ones go on.

    Parameters
    ----------
    misfit : Misfit
    bounds : (size, 2) float array
    span : (size, m) float array or None
        Unknowns ``prior + span z``; every value where None.
    tolerance, max_iterations
        Of a descent, see ``gauss_newton``.

    Attributes
    ----------
    seen : Best
        The misfit; remembers the best place that could be a solution.
    ends : list of (str, Solution)
        Where each start led to, described.
    history : list of HistoryEntry
        All evaluations.
    iterations : int
    elsewhere : int
        Evaluations of another cost, see ``descend``.
    """

    def __init__(self, misfit: Misfit, bounds: Floats, span: Floats | None, tolerance: float, max_iterations: int) -> None:
        self.seen = Best(misfit, _admissible(misfit, bounds, span))
        self.ends: list[tuple[str, Solution]] = []
        self.history: list[HistoryEntry] = []
        self.iterations = self.elsewhere = 0
        self._misfit, self._bounds, self._span = misfit, bounds, span
        self._tolerance, self._most = tolerance, max_iterations

    def note(self, entries: Iterable[HistoryEntry]) -> None:
        """Add evaluations to the history."""
        first = len(self.history)
        self.history.extend(replace(entry, evaluation=first + i) for i, entry in enumerate(entries))

    def tried(self, value: Evaluation, totals: list[float]) -> None:
        """Note one evaluation of a scan, whose totals these are."""
        self.note([HistoryEntry(0, value.cost, value.misfit_db, bool(value.total < min(totals, default=np.inf)))])
        totals.append(value.total if np.isfinite(value.total) else np.inf)

    def begin(self, places: Iterable[tuple[str, Floats]], limit: int | None = None) -> None:
        """Descend from further places, described, so many iterations at the most."""
        most = self._most if limit is None else min(limit, self._most)
        described = list(places)
        for (text, _), end in zip(described, self._descents([(theta, most) for _, theta in described]), strict=True):
            self.ends.append((text, end))

    def go_on(self, which: Iterable[int], limit: int | None = None) -> None:
        """Continue those of the descents that their limit stopped."""
        most = self._most if limit is None else min(limit, self._most)
        stopped = [at for at in which if self.ends[at][1].status == "stopped" and self.ends[at][1].iterations < most]
        before = [self.ends[at][1] for at in stopped]
        further = self._descents([(end.theta, most - end.iterations) for end in before])
        for at, end, last in zip(stopped, before, further, strict=True):
            self.ends[at] = self.ends[at][0], replace(last, iterations=end.iterations + last.iterations)

    def halve(self, first: int, limit: int) -> None:
        """Continue the better half of the descents from the ``first`` on."""
        order = sorted(range(first, len(self.ends)), key=lambda at: self.ends[at][1].evaluation.total)
        self.go_on(order[: (len(order) + 1) // 2], limit)

    def _descents(self, begun: Sequence[tuple[Floats, int]]) -> list[Solution]:
        """From each place with its limit."""

        def one(begin: tuple[Floats, int]) -> Solution:
            theta, most = begin
            return descend(self._misfit, theta, self._bounds, self._span, tolerance=self._tolerance, max_iterations=most)

        ends = side_by_side(one, begun)
        for end in ends:
            self.note(end.history)
            self.elsewhere += end.evaluations - len(end.history)
            self.iterations += end.iterations
        return ends

    def look_beside(
        self,
        span: Floats,
        shares: Sequence[float],
        limits: tuple[int, int],
        rounds: int,
        joints: Sequence[int] = (),
        mirrors: Mirrors = alone,
    ) -> None:
        """Descend from places beside the best end until no round leads lower.

        Those of ``other_levels`` among joints, else of ``hops``, and where it leads without some values.

        A peak that passes a line is a ridge in the cost, narrow and steep. Beyond it there is another valley; and without the values that
        the end explains least there is no ridge, so that the rest leads on.
        """
        few, more = limits
        for _ in range(rounds + len(joints)):
            self.go_on([self.best])
            (description, end), before = self.ends[self.best], len(self.ends)
            if not np.isfinite(end.evaluation.total):
                return

            def without(share: float, theta: Floats = end.theta) -> Floats:
                rest = self._misfit.without(theta, share)
                return descend(rest, theta, self._bounds, span, tolerance=self._tolerance, max_iterations=more).theta

            first = description.partition(BESIDE)[0]
            if joints:
                moved = other_levels(self._misfit, end, self._bounds, span, joints, mirrors)
                places = [(f"{first}{BESIDE} one joint at another level", theta) for theta in moved]
            else:
                places = [(f"{first}{BESIDE} a hop", theta) for theta in hops(self._misfit, end, self._bounds, span)]
            texts = [f"{first}{BESIDE} without the {100 * share:g} % that it explains least" for share in shares]
            self.begin([*places, *zip(texts, side_by_side(without, shares), strict=True)], few)
            self.halve(before, more)
            if not self.ends[self.best][1].evaluation.total < (1.0 - self._tolerance) * end.evaluation.total:
                return

    def coarse(self, places: Sequence[Floats], knots: Sequence[int], tolerance: float, iterations: int) -> list[Floats]:
        """Where descents on coarse profiles lead from each place, each profile with more knots than the one before."""
        parameters, bounds = self._misfit.model.parameters, self._bounds
        unknowns = parameters.size if self._span is None else self._span.shape[1]

        def one(theta: Floats) -> tuple[Floats, Best, list[Solution]]:
            seen, found = self.seen.another(), list[Solution]()
            for count in knots:
                T = level_matrix(parameters, count, damping=True)
                if T.shape[1] >= unknowns:
                    break
                level = Level(seen, theta, T)
                found.append(
                    gauss_newton(level, np.zeros(T.shape[1]), level.bounds(bounds), tolerance=tolerance, max_iterations=iterations)
                )
                theta = np.clip(level.theta(found[-1].theta), bounds[:, 0], bounds[:, 1])
            return theta, seen, found

        ends = []
        for theta, seen, found in side_by_side(one, places):
            ends.append(theta)
            self.seen.take(seen)
            for end in found:
                self.note(end.history)
                self.iterations += end.iterations
        return ends

    @property
    def best(self) -> int:
        """Which end costs least: the first of equals, also where a cost is not finite."""
        kept = 0
        for i, (_, end) in enumerate(self.ends):
            if end.evaluation.total < self.ends[kept][1].evaluation.total:
                kept = i
        return kept

    def solution(self) -> Solution:
        """The best end, with all evaluations, and where each start led to."""
        kept = self.best
        led = tuple(Start(text, end.evaluation.cost, end.evaluation.total, i == kept, end.theta) for i, (text, end) in enumerate(self.ends))
        history = tuple(self.history)
        count = len(history) + self.elsewhere
        return replace(self.ends[kept][1], iterations=self.iterations, evaluations=count, history=history, starts=led)


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
    coarse = race.coarse([trials[at] for at in begun], () if joints else knots, coarse_tolerance, coarse_iterations)
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
        race.look_beside(span, left_out, (few, more), rounds, joints, mirrors)
    race.go_on([race.best])
    return race.solution()


def _nearest_uniform(race: Race, misfit: Misfit, theta: Floats, bounds: Floats, totals: list[float]) -> Floats:
    """The place of ``zoom`` with the least mean difference."""
    tried = []
    for place, value in zoom(race.seen, theta, bounds, moved_values(misfit.model.parameters).astype(float)):
        race.tried(value, totals)
        tried.append((value.misfit_db, place))
    return min(tried, key=lambda one: one[0] if np.isfinite(one[0]) else np.inf)[1]


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


def descend(
    misfit: Misfit,
    start: Floats,
    bounds: Floats,
    span: Floats | None = None,
    *,
    tolerance: float = 1e-4,
    max_iterations: int = 100,
    most_led: int = 50,
) -> Solution:
    """Gauss-Newton on all values, or on the unknowns z of ``prior + span z``; the Jacobian of its evaluation is to those.

    Where lines do not resolve the peaks, the lower one of this end and of that from where differences on Riemann's sphere lead, in
    ``most_led`` iterations at the most whatever the limit: it is there that poles have to pass many lines.
    """
    if not misfit.sharp:
        return _one_descent(misfit, start, bounds, span, tolerance, max_iterations)
    led = _one_descent(misfit.on_sphere(), start, bounds, span, tolerance, most_led)
    ends = [_one_descent(misfit, place, bounds, span, tolerance, max_iterations) for place in (start, led.theta)]
    best = min(ends, key=lambda end: end.evaluation.total if np.isfinite(end.evaluation.total) else np.inf)
    history = tuple(entry for end in ends for entry in end.history)
    return replace(best, evaluations=led.evaluations + len(history), history=history)


def _one_descent(misfit: Misfit, start: Floats, bounds: Floats, span: Floats | None, tolerance: float, max_iterations: int) -> Solution:
    if span is None:
        return gauss_newton(misfit, start, bounds, tolerance=tolerance, max_iterations=max_iterations)
    level = Level(misfit, misfit.prior, span)
    box = level.bounds(bounds)
    z = np.clip(np.linalg.lstsq(span, start - misfit.prior, rcond=None)[0], box[:, 0], box[:, 1])
    found = gauss_newton(level, z, box, tolerance=tolerance, max_iterations=max_iterations)
    return replace(found, theta=level.theta(found.theta))


def _describe(parameters: Parameterisation, theta: Floats, trial: int, prior: Floats | None) -> str:
    if trial == 0:
        return "start values of the campaign" if prior is None else "the reference job"
    if prior is not None:
        change = theta - prior
        return f"uniform change of log10 by {change[int(np.argmax(np.abs(change)))]:.3g}"
    stiff = [(group, values) for group, values, _ in parameters.placed if group.kind == "stiffness"]
    moved = stiff or [(group, values) for group, values, _ in parameters.placed]
    return "uniform log10 " + ", ".join(f"{group.name} {theta[values][0]:.3g}" for group, values in moved)
