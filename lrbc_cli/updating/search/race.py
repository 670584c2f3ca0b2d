"""Descents from many starts by successive halving: the better ones continue, of several that meet only one; used by ``levels``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.misfit.cost import Evaluation, Misfit
from lrbc_cli.updating.search.descent import Level, admissible, descend, level_matrix, over_smoothed
from lrbc_cli.updating.search.optimise import Best, HistoryEntry, Solution, Start, gauss_newton, numbered
from lrbc_cli.updating.search.starts import Mirrors, alone, hops, other_levels
from lrbc_cli.updating.search.valleys import Lead, leading_apart, worth


class Race:
    """Descents from many starts, with their ends and all evaluations.

    Parameters
    ----------
    misfit : Misfit
    bounds : (size, 2) float array
    span : (size, m) float array or None
        Unknowns ``prior + span z``; None for all values.
    tolerance, max_iterations
        Stop rule of a descent, see ``gauss_newton``.

    Attributes
    ----------
    seen : Best
        The misfit; remembers the best admissible theta.
    ends : list of (str, Solution)
        Description of each start, and the end of its descent so far.
    history : list of HistoryEntry
        All evaluations of the misfit.
    iterations : int
    elsewhere : int
        Number of evaluations of other costs (on Riemann's sphere, over smoothed spectra).
    """

    def __init__(self, misfit: Misfit, bounds: Floats, span: Floats | None, tolerance: float, max_iterations: int) -> None:
        self.seen = Best(misfit, admissible(misfit, bounds, span))
        self.ends: list[tuple[str, Solution]] = []
        self.history: list[HistoryEntry] = []
        self.iterations = self.elsewhere = 0
        self._began: dict[str, str] = {}
        self._misfit, self._bounds, self._span = misfit, bounds, span
        self._tolerance, self._most = tolerance, max_iterations

    def note(self, entries: Iterable[HistoryEntry]) -> None:
        """Add evaluations to the history."""
        self.history += numbered(entries, len(self.history))

    def tried(self, value: Evaluation, totals: list[float]) -> None:
        """Add one evaluation of a scan to the history, and its total to ``totals``."""
        lowest = bool(value.total < min(totals, default=np.inf))
        self.note([HistoryEntry(evaluation=0, cost=value.cost, misfit_db=value.misfit_db, accepted=lowest)])
        totals.append(value.total if np.isfinite(value.total) else np.inf)

    def begin(self, places: Iterable[tuple[str, Floats]], limit: int | None = None) -> None:
        """Descend from further described places, ``limit`` iterations at most; of those that meet after one only the best continues."""
        most = self._most if limit is None else min(limit, self._most)
        described, before = list(places), len(self.ends)
        first = min(1, most) if self._meeting else most
        for (text, _), end in zip(described, self._descents([(theta, first) for _, theta in described]), strict=True):
            self.ends.append((text, end))
        if first < most:
            self.go_on(self.apart(before), most)

    @property
    def _meeting(self) -> bool:
        """Whether it is tested if descents meet: not if lines do not resolve the peaks, since linearisations then hold too near only."""
        return self._span is not None and not self._misfit.sharp

    def apart(self, first: int) -> list[int]:
        """Indices of the ends from the ``first`` on that do not meet a better one, best first."""
        if not self._meeting:
            return sorted(range(first, len(self.ends)), key=lambda at: self.ends[at][1].evaluation.total)
        return [at for at in self._leading_apart(self._misfit, [end for _, end in self.ends]) if at >= first]

    def _leading_apart(self, misfit: Misfit, ends: Sequence[Solution]) -> list[int]:
        """Indices of ends of descents on a cost that do not meet a better one, best first; see ``valleys``."""
        assert self._span is not None
        box, inverse = Level(misfit, misfit.prior, self._span).bounds(self._bounds), np.linalg.pinv(self._span)
        leads = [Lead.of(end.evaluation, inverse @ (end.theta - misfit.prior), box) for end in ends]
        return leading_apart(leads, worth(misfit, min((end.evaluation for end in ends), key=lambda value: value.total)))

    def go_on(self, which: Iterable[int], limit: int | None = None) -> None:
        """Continue those of these descents that stopped at their limit of iterations."""
        most = self._most if limit is None else min(limit, self._most)
        stopped = [at for at in which if self.ends[at][1].status == "stopped" and self.ends[at][1].iterations < most]
        before = [self.ends[at][1] for at in stopped]
        further = self._descents([(end.theta, most - end.iterations) for end in before])
        for at, end, last in zip(stopped, before, further, strict=True):
            self.ends[at] = self.ends[at][0], replace(last, iterations=end.iterations + last.iterations)

    def halve(self, first: int, limit: int) -> None:
        """Continue the better half of the descents from the ``first`` on, of those that do not meet."""
        order = self.apart(first)
        self.go_on(order[: (len(order) + 1) // 2], limit)

    def _descents(self, begun: Sequence[tuple[Floats, int]]) -> list[Solution]:
        """Descents from (theta, limit of iterations), side by side; their evaluations are noted."""

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
        wide: Sequence[Misfit] = (),
    ) -> None:
        """Descend from places beside the best end, in rounds, until a round gains less than the data can resolve (``valleys.worth``).

        The places are those of ``other_levels`` among joints (followed over smoothed spectra, if given: from each of their widths to the
        narrowest), else of ``hops``; and ends of descents without those shares of the measured values that the best end explains least. A
        peak that passes a line is a narrow, steep ridge in the cost with another valley beyond it; without the values that are explained
        least there is no such ridge.
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

            first = self._began.get(description, description)

            def beside(way: str, first: str = first) -> str:
                self._began[text := f"{first}, then {way}"] = first
                return text

            if joints:
                way, moved = "one joint at another level", other_levels((self._misfit, *wide)[-1], end, self._bounds, span, joints, mirrors)
                if wide:
                    # From near the truth a wide smoothing may lead away, and a narrow one alone leads there.
                    led = [self._smoothed(wide[first:], [end.theta, *moved]) for first in range(len(wide))]
                    way, moved = "over smoothed spectra", [place for ends in led for place in ends]
            else:
                way, moved = "a hop", hops(self._misfit, end, self._bounds, span)
            places = [(beside(way), theta) for theta in moved]
            texts = [beside(f"without the {100 * share:g} % that it explains least") for share in shares]
            self.begin([*places, *zip(texts, side_by_side(without, shares), strict=True)], few)
            self.halve(before, more)
            if not self.ends[self.best][1].evaluation.total < end.evaluation.total - worth(self._misfit, end.evaluation):
                return

    def _smoothed(self, wide: Sequence[Misfit], places: Sequence[Floats]) -> list[Floats]:
        """Ends of descents over smoothed spectra, widest first, from some places; of those that meet only the best continues."""
        for misfit in wide:
            ends = side_by_side(partial(over_smoothed, [misfit], bounds=self._bounds, span=self._span), places)
            self.elsewhere += sum(end.evaluations for end in ends)
            places = [ends[at].theta for at in self._leading_apart(misfit, ends)]
        return list(places)

    def coarse(self, places: Sequence[Floats], knots: Sequence[int], tolerance: float, iterations: int) -> list[Floats]:
        """Ends of successive descents on coarse profiles from each place, with ``knots`` values along an edge."""
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
        """Index of the end with the least cost; the first of equal ones, or if no cost is finite."""
        return min(range(len(self.ends)), key=lambda at: self.ends[at][1].evaluation.total)

    def solution(self) -> Solution:
        """The best end, with all evaluations and the ends of all starts."""
        kept = self.best
        led = tuple(
            Start(description=text, cost=end.evaluation.cost, total=end.evaluation.total, kept=i == kept, theta=end.theta)
            for i, (text, end) in enumerate(self.ends)
        )
        history = tuple(self.history)
        count = len(history) + self.elsewhere
        return replace(self.ends[kept][1], iterations=self.iterations, evaluations=count, history=history, starts=led)
