"""Posterior of changes at bolts under a mixture prior: each bolt is of one of two kinds, tight (hardly changed) or loose.

A Gaussian prior would spread a change over neighbours that the data hardly distinguish. Here each change has the prior
``(1 - pi) N(0, tight²) + pi N(mean, loose²)`` (spike and slab: George and McCulloch, J. Am. Stat. Assoc. 88, 1993). Given the kinds,
everything is Gaussian about a linearisation and the changes are integrated out in closed form. This module searches the most probable
kinds; ``sampling`` samples them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Bools, Floats, Integers
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.misfit.cost import Evaluation
from lrbc_cli.updating.posterior.kinds import KindScore, adjacency, improve
from lrbc_cli.updating.search.optimise import Solution, gauss_newton
from lrbc_cli.updating.statistics.priors import BoltPrior
from lrbc_cli.updating.unknowns.springs import SpringsOf

#: Precision that fixes a change, far above what data give [1/decade²].
HELD = 1e10

#: From unknowns z (m,) to whitened residuals (n,) and their Jacobian (n, m).
Data = Callable[[Floats], tuple[Floats, Floats]]

#: Stop rule of a descent: relative decrease of the cost at which it ends, and largest number of iterations.
Stop = tuple[float, int]


@dataclass(frozen=True)
class Springs:
    """Springs of a joint that it can lose: the joint as a position among the bolts, which of its springs (None: all), their terms."""

    joint: int
    of: SpringsOf | None
    terms: Integers = field(repr=False)


@dataclass(frozen=True, kw_only=True)
class SpringLoss:
    """Residuals without (n,) and with (n,) a loss of some springs in one state, and their Jacobian (n, m), all with one covariance."""

    without: Floats = field(repr=False)
    lost: Floats = field(repr=False)
    jacobian: Floats = field(repr=False)


#: From springs, their change and the error of their level in the reference state [decades] to residuals with the covariances of either end.
SpringLosses = Callable[[Integers, float, float], Sequence[SpringLoss]]


@dataclass(frozen=True, kw_only=True)
class MixtureProblem:
    """Data and priors of m unknowns z, b of which are changes at bolts.

    Attributes
    ----------
    data : callable
        See ``Data``.
    variance : float
        v, of a residual, correlation and coarsening included [dB²].
    bounds : (m, 2) float array
    bolts : (b,) int array
        Which of z are changes at bolts [decades].
    neighbours : sequence of (int, int)
        Pairs of neighbours, as positions in ``bolts``.
    joint : (b,) bool array
        Which of the bolts own their terms; the others have hats along an edge.
    mean, std : (m,) float arrays
        Gaussian prior of the other unknowns; not read at bolts.
    about : callable or None
        Given if the covariance of the residuals depends on the state: from z to ``data`` with the covariance there, and the log
        determinant's part of the log evidence.
    shared : float
        Further relative standard deviation of a joint's change, by errors of predicted shifts that all resonances have in common. Not for
        hats along an edge.
    ratio : float
        Errors of the data over what ``variance`` says, see ``noise.validation_ratio``. It widens the changes, but does not reduce the
        weight of the data against the prior, which would make badly explained bolts tight.
    springs : sequence of Springs
        Those whose loss is asked for, of joints that are tight.
    losses : callable or None
        From z to ``SpringLosses``; needed where there are ``springs``.
    level_error : float
        Standard deviation of the level of a joint in the reference state, by errors of the model [decades]; 0 if no comparison rests on it.
    cells : (n,) int array or None
        Response and band of lines of each residual, within which errors of the model are common; needed where there are ``springs``, and
        without it no comparison of states is limited by its significance.
    near : callable or None
        From z to the same problem, faster at unknowns that differ from z in few stiffnesses; None if there is no faster way.
    residuals : callable or None
        ``data`` without the Jacobian, with the covariance at z: from z to a function of unknowns; None if ``data`` is as fast.
    """

    data: Data
    variance: float
    bounds: Floats
    bolts: NDArray[np.int64]
    neighbours: Sequence[tuple[int, int]]
    joint: Bools
    mean: Floats
    std: Floats
    about: Callable[[Floats], tuple[Data, float]] | None = None
    shared: float = 0.0
    ratio: float = 1.0
    springs: Sequence[Springs] = ()
    losses: Callable[[Floats], SpringLosses] | None = None
    level_error: float = 0.0
    cells: Integers | None = field(default=None, repr=False)
    near: Callable[[Floats], MixtureProblem] | None = None
    residuals: Callable[[Floats], Callable[[Floats], Floats]] | None = None

    def loosened(self, i: int, prior: BoltPrior) -> float:
        """Typical change of bolt ``i`` if it is a loose joint, as far as its bounds allow [decades]."""
        return max(prior.joint_loose_mean, float(self.bounds[self.bolts[i], 0]))

    def by(self, z: Floats) -> MixtureProblem:
        """The fastest form of the problem for unknowns that differ from z in few stiffnesses."""
        return self if self.near is None else self.near(z)


@dataclass(frozen=True, kw_only=True)
class State:
    """Optimum z for given kinds, its log evidence (Laplace approximation), and the linear problem A, b of the bolts about it."""

    kinds: Bools
    z: Floats
    evidence: float
    A: Floats = field(repr=False)
    b: Floats = field(repr=False)


def priors_of(problem: MixtureProblem, prior: BoltPrior, kinds: Bools) -> tuple[Floats, Floats]:
    """(m,) prior precisions and means of all unknowns, given the kinds."""
    precision, mean = problem.std**-2.0, problem.mean.copy()
    beside = adjacency(problem.neighbours, problem.joint)
    precision[problem.bolts], mean[problem.bolts] = prior.of(kinds, beside, problem.joint)
    return precision, mean


def _posed(
    problem: MixtureProblem, prior: BoltPrior, kinds: Bools, held: tuple[int, float] | None
) -> tuple[Callable[[Floats], Evaluation], Floats, Floats]:
    """Cost whose total is -2 log posterior but for constants, given the kinds, with the prior's precisions and means (m,)."""
    precision, mean = priors_of(problem, prior, kinds)
    if held is not None:
        precision[problem.bolts[held[0]]], mean[problem.bolts[held[0]]] = HELD, held[1]
    scale, weight = problem.variance**-0.5, np.sqrt(precision)

    def cost(z: Floats) -> Evaluation:
        r, J = problem.data(z)
        residual = np.concatenate([scale * r, weight * (z - mean)])
        total = max(float(residual @ residual), np.finfo(float).tiny)
        jacobian = np.vstack([scale * J, np.diag(weight)])
        return Evaluation(
            cost=float(np.log10(total)),
            total=total,
            data=float(r @ r),
            misfit_db=float(np.mean(np.abs(r))),
            residual=residual,
            jacobian=jacobian,
        )

    return cost, precision, mean


def _evidence(prior: BoltPrior, kinds: Bools, precision: Floats, total: float, H: Floats) -> float:
    """Laplace approximation of the log evidence from the least total of a cost and its curvature."""
    return 0.5 * (float(np.log(precision).sum()) - total - float(np.linalg.slogdet(H)[1])) + float(kinds.sum()) * prior.log_odds


def foreseen(problem: MixtureProblem, prior: BoltPrior, kinds: Bools, z: Floats, held: tuple[int, float]) -> float:
    """Log evidence that one linear step of everything but the change ``held`` (see ``settle``) promises from z, without a descent."""
    data, offset = (problem.data, 0.0) if problem.about is None else problem.about(z)
    cost, precision, _ = _posed(replace(problem, data=data), prior, kinds, held)
    value = cost(z)
    H, slope = value.jacobian.T @ value.jacobian, value.jacobian.T @ value.residual
    return _evidence(prior, kinds, precision, value.total - float(slope @ np.linalg.solve(H, slope)), H) + offset


def _settle(problem: MixtureProblem, prior: BoltPrior, kinds: Bools, z: Floats, stop: Stop, held: tuple[int, float] | None) -> State:
    """Descend for given kinds from z, and linearise at the end; see ``settle``."""
    cost, precision, mean = _posed(problem, prior, kinds, held)
    found: Solution = gauss_newton(cost, z, problem.bounds, tolerance=stop[0], max_iterations=stop[1])
    value, z = found.evaluation, found.theta
    rows = value.residual.size - z.size
    J, r = value.jacobian[:rows], value.residual[:rows]
    evidence = _evidence(prior, kinds, precision, value.total, value.jacobian.T @ value.jacobian)
    A, b = J.T @ J, J.T @ (J @ z - r)
    at = problem.bolts
    rest = np.setdiff1d(np.arange(z.size), at)
    # The unknowns that are no bolts are marginalised here, once for all sweeps.
    across = A[np.ix_(at, rest)]
    share = np.linalg.solve(
        A[np.ix_(rest, rest)] + np.diag(precision[rest]), np.column_stack([across.T, b[rest] + precision[rest] * mean[rest]])
    )
    return State(kinds=kinds, z=z, evidence=evidence, A=A[np.ix_(at, at)] - across @ share[:, :-1], b=b[at] - across @ share[:, -1])


def settle(
    problem: MixtureProblem,
    prior: BoltPrior,
    kinds: Bools,
    z: Floats,
    stop: Stop,
    *,
    held: tuple[int, float] | None = None,
    rounds: int = 2,
) -> State:
    """Descend for given kinds, with the covariance of the residuals updated at the end of each round; gives the optimum and its evidence.

    With ``held`` (position in ``bolts``, value) the change of one bolt is fixed.
    """
    if problem.about is None:
        return _settle(problem, prior, kinds, z, stop, held)
    for _ in range(rounds):
        data, offset = problem.about(z)
        state = _settle(replace(problem, data=data), prior, kinds, z, stop, held)
        z = state.z
    return replace(state, evidence=state.evidence + offset)


def pinned(problem: MixtureProblem, z: Floats) -> MixtureProblem:
    """The same problem with the covariance of the residuals fixed to that at z; its log evidence has no determinant of it."""
    return problem if problem.about is None else replace(problem, data=problem.about(z)[0], about=None, near=None)


def _climb(problem: MixtureProblem, prior: BoltPrior, limits: tuple[int, int], stop: Stop, begin: tuple[Bools, Floats]) -> State:
    """Best state of a search from given kinds and a start: descend, then flip kinds by the linearisation, in turn; see ``best_states``."""
    kinds, start = begin
    rounds, moves = limits
    end: State | None = None
    seen: set[bytes] = set()
    for _ in range(rounds):
        state = settle(problem, prior, kinds, start, stop)
        if end is None or state.evidence > end.evidence:
            end = state
        seen.add(kinds.tobytes())
        score = KindScore(state.A, state.b, prior, kinds, problem.neighbours, problem.joint)
        # Few moves at a time: a linearisation does not hold far from its point.
        improve(score, problem.neighbours, moves)
        if score.loose.tobytes() in seen:
            break
        kinds, start = score.loose.copy(), state.z
    assert end is not None
    return end


def _alone(problem: MixtureProblem, prior: BoltPrior, z: Floats, kept: int) -> list[tuple[Bools, Floats]]:
    """Kinds and unknowns of the best states of one loose joint, from the tight state z: at most ``kept`` joints.

    Each joint is moved to the mean change of loose ones and one standard deviation to either side. The sums of squares are compared that
    one linear step of all else leaves.
    """
    none, near = np.zeros(problem.bolts.size, dtype=bool), problem.by(z)
    data = near.data if near.about is None else near.about(z)[0]
    _, J = data(z)
    residual = (lambda z: data(z)[0]) if near.residuals is None else near.residuals(z)
    precision, mean = priors_of(problem, prior, none)
    C = np.linalg.inv(J.T @ J / problem.variance + np.diag(precision))

    def nearest(i: int) -> tuple[float, Floats]:
        at, found = problem.bolts[i], []
        for away in (-prior.joint_loose_std, 0.0, prior.joint_loose_std):
            moved = z.copy()
            moved[at] = max(prior.joint_loose_mean + away, float(problem.bounds[at, 0]))
            r = residual(moved)
            slope = J.T @ r / problem.variance + precision * (moved - mean)
            slope[at] = 0.0
            # The inverse without the row and the column of the joint itself.
            step = C @ slope - C[:, at] * ((C[at] @ slope) / C[at, at])
            found.append((float(r @ r) / problem.variance - float(slope @ step), moved))
        return min(found, key=lambda one: one[0])

    joints = np.flatnonzero(problem.joint).tolist()
    ranked = sorted(zip(joints, side_by_side(nearest, joints), strict=True), key=lambda one: one[1][0])
    return [(none | (np.arange(none.size) == i), start) for i, (_, start) in ranked[:kept]]


def compared(problem: MixtureProblem, prior: BoltPrior, ends: Sequence[State], stop: Stop) -> Floats:
    """(k,) log evidence of ends of searches, relative to the first; each pair has one covariance of the residuals.

    If the covariance follows the state, its determinant moves the log evidence by more than the ends differ. So an end and the first are
    compared with the covariance of either, and the mean of both log evidence ratios counts: a covariance tolerates errors of its own end's
    changes, in which the other end may differ, and alone it is no fair judge of both.
    """
    if problem.about is None:
        return np.array([end.evidence - ends[0].evidence for end in ends])

    def under(form: MixtureProblem, end: State) -> float:
        return settle(form, prior, end.kinds, end.z, stop).evidence

    here = pinned(problem, ends[0].z)
    first = under(here, ends[0])

    def against(end: State) -> float:
        there = pinned(problem, end.z)
        return 0.5 * (under(here, end) - first + under(there, end) - under(there, ends[0]))

    return np.array([0.0, *side_by_side(against, ends[1:])])


def best_states(
    problem: MixtureProblem,
    starts: Sequence[Floats],
    prior: BoltPrior,
    *,
    large: float = -0.4,
    rounds: int = 8,
    moves: int = 3,
    near: float = 5.0,
    kept: int = 3,
    search: Stop = (1e-3, 5),
    last: Stop = (1e-4, 12),
) -> list[State]:
    """Most probable kinds by local search with relinearisation.

    It begins from all tight, from each start with its large changes as loose, and from the most probable states of one loose joint.

    Parameters
    ----------
    problem : MixtureProblem
    starts : sequence of (m,) float array
    prior : BoltPrior
    large : float
        A bolt is loose at a start if its change is below this [decades].
    rounds, moves : int
        Largest number of linearisations, and of moves at each.
    near : float
        States with so much less log evidence are no alternatives: 1 in 150.
    kept : int
        Number of states of one loose joint from which the search begins.
    search, last : (float, int)
        Stop rules of the descents during the search, and of the last one. The sum of squares is a few hundred to a few thousand, and a
        tenth matters.

    Returns
    -------
    list of State
        The most probable one first, then ends of searches with other kinds that are nearly as probable, see ``compared``.
    """
    tight = np.zeros(problem.bolts.size, dtype=bool)
    # Starts that are equal to a tenth of a decade are searched from once.
    apart = {np.round(z, 1).tobytes(): z for z in reversed(starts)}
    begun = [(tight, np.zeros(starts[0].size)), *((z[problem.bolts] < large, z) for z in reversed(apart.values()))]
    if problem.joint.any():
        # The ends of a fit may all be in valleys of other joints: from the tight state each joint alone is tried, too.
        begun += _alone(problem, prior, settle(problem, prior, tight, begun[0][1], search).z, kept)
    ends: dict[bytes, State] = {}
    for end in side_by_side(partial(_climb, problem, prior, (rounds, moves), search), begun):
        key = end.kinds.tobytes()
        ends[key] = max(end, ends.get(key, end), key=lambda one: one.evidence)
    found = sorted(ends.values(), key=lambda one: -one.evidence)
    ratios = compared(problem, prior, found, search)
    kept_ends = [found[i] for i in np.argsort(-ratios, kind="stable") if ratios[i] > ratios.max() - near]
    return side_by_side(lambda end: settle(problem, prior, end.kinds, end.z, last), kept_ends)
