"""Gibbs sampling of the kinds of bolts (tight or loose) about the most probable states, with nonlinear corrections for joints.

FRFs hardly depend on a joint that has lost a decade or two, so a linear problem about that state makes the way back to tight too cheap.
Therefore the evidence of doubtful joints comes from descents with the other kind, and a change that remains uncertain from its profile.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.special import expit, logsumexp

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.posterior.excluded import between, loss_ratios
from lrbc_cli.updating.posterior.kinds import KindScore, along_edges
from lrbc_cli.updating.posterior.mixture import (
    MixtureProblem,
    State,
    Stop,
    best_states,
    compared,
    foreseen,
    pinned,
    settle,
)
from lrbc_cli.updating.posterior.samples import ChangeSamples
from lrbc_cli.updating.statistics.noise import widened
from lrbc_cli.updating.statistics.priors import BOLT_PRIOR, BoltPrior


@dataclass(frozen=True)
class Beyond:
    """Corrections of the linear problem by descents, for b bolts.

    Attributes
    ----------
    further : (b,) float array
        Log evidence for loose to be added; 0 where the linear problem is used.
    loose : (b, 2) float array
        Mean and standard deviation of the change if loose [decades]; NaN where the linear problem is used.
    """

    further: Floats
    loose: Floats


def beyond(
    problem: MixtureProblem,
    prior: BoltPrior,
    state: State,
    *,
    doubt: float = -3.5,
    wide: float = 0.12,
    gain: float = 0.01,
    rounds: int = 3,
    certain: float = 30.0,
    stop: Stop = (1e-3, 5),
    held: Stop = (1e-2, 3),
    suspects: Collection[int] = (),
) -> tuple[State, Beyond]:
    """Evidence of each joint that is loose or could be, by descents with its other kind, and profiles of uncertain changes.

    Parameters
    ----------
    problem : MixtureProblem
    prior : BoltPrior
    state : State
    doubt : float
        A tight joint could be loose if a flip gives more than this log evidence, see ``_doubted``.
    wide : float
        Standard deviation of a loose joint's change above which its profile is computed [decades]; for a tight one that could be loose it
        is computed in any case.
    gain, rounds : float, int
        If the other kind gains more log evidence than this, all begins again from that state, at most so many times.
    certain : float
        Difference of log evidence between both kinds of a joint beyond which later rounds do not repeat the descent, 1 in 10^13. It counts
        less what the state has gained since, because the state with the other kind could have gained as much.
    stop, held : (float, int)
        Stop rules of the descents, and of those with a fixed change, each of which starts at the end of the one before.
    suspects : collection of int
        Joints that could be loose whatever the linear problem says.

    Returns
    -------
    State, Beyond
        The best state found, and the corrections about it.
    """
    # Log evidence for loose over tight of joints that are certain.
    known: dict[int, float] = {}
    for turn in range(rounds):
        score = KindScore(state.A, state.b, prior, state.kinds, problem.neighbours, problem.joint)
        gains, means, stds = score.flips()
        asked_of = np.where(state.kinds | np.isin(np.arange(gains.size), sorted(suspects)), np.inf, gains)
        doubted = _doubted(problem, prior, state, asked_of, means[:, 1], (doubt, certain))
        own = settle(problem, prior, state.kinds, state.z, stop) if doubted else state
        others = _other_kinds(problem, prior, own, [one for one in doubted.items() if one[0] not in known], stop)
        known |= {i: -more if state.kinds[i] else more for i, (_, more) in others.items() if abs(more) > certain}
        best, most = max(others.values(), key=lambda one: one[1], default=(own, 0.0))
        if most <= gain or turn == rounds - 1:
            break
        known = {i: apart - float(np.copysign(most, apart)) for i, apart in known.items() if abs(apart) > certain + most}
        state = settle(problem, prior, best.kinds, best.z, stop)
    last = _Turn(state=state, own=own, others=others, doubted=list(doubted), known=known, gains=gains)
    # A tight joint that could be loose is no Gaussian then: what it could have lost beyond its valley is in no curvature.
    asked_of = (problem.bounds[problem.bolts, 0] < -wide) & ((stds[:, 1] > wide) | ~state.kinds)
    return state, last.said(problem, prior, np.where(asked_of, stds[:, 1], np.nan), (stop, held))


@dataclass(frozen=True, kw_only=True)
class _Turn:
    """Results of the descents from one state.

    Attributes
    ----------
    state, own : State
        The state, and the end of a descent from it with the same kinds.
    others : mapping of int to (State, float)
        Ends of descents with the other kind of a joint, and gains in log evidence, for joints that are not certain.
    doubted : sequence of int
        Joints that are loose or could be.
    known : mapping of int to float
        Log evidence for loose over tight of joints that are certain.
    gains : (b,) float array
        Gain in log evidence by a flip, by the linear problem.
    """

    state: State
    own: State
    others: Mapping[int, tuple[State, float]]
    doubted: Sequence[int]
    known: Mapping[int, float]
    gains: Floats

    def said(self, problem: MixtureProblem, prior: BoltPrior, widths: Floats, stops: tuple[Stop, Stop]) -> Beyond:
        """Corrections of the linear problem; profiles are computed for joints with a finite width (b,) [decades]."""
        kinds, found = self.state.kinds, Beyond(np.zeros(self.gains.size), np.full((self.gains.size, 2), np.nan))
        loose = {i: self.own if kinds[i] else self.others[i][0] for i in self.doubted if kinds[i] or i in self.others}
        flat = [(i, at, float(widths[i])) for i, at in loose.items() if np.isfinite(widths[i])]
        profiles = dict(zip((i for i, *_ in flat), _profiles(problem, prior, flat, stops), strict=True))
        for i in self.doubted:
            sign = 1.0 if kinds[i] else -1.0
            apart = self.known[i] if i in self.known else -sign * self.others[i][1]
            more, mean, std = profiles.get(i, (0.0, np.nan, np.nan))
            found.loose[i] = mean, std
            found.further[i] = apart + more + sign * self.gains[i]
        return found


def _doubted(
    problem: MixtureProblem,
    prior: BoltPrior,
    state: State,
    gains: Floats,
    changes: Floats,
    limits: tuple[float, float],
    *,
    slack: float = 5.0,
    step: Stop = (1e-2, 1),
) -> dict[int, float]:
    """Joints that are loose or could be (a flip gives more than ``doubt``), with the change from which to descend if loose.

    The linear problem (``gains``, ``changes`` if loose) extrapolates the effect of a small loss. Where a resonance moves past lines, or
    the effect of the joint soon saturates, it excludes a loose joint with which the FRFs agree. Therefore each other joint is fixed at
    the mean change of loose ones, with one step of everything else; ``limits``: ``doubt`` and ``certain`` of ``beyond``. If the linear
    problem about that place excludes the joint with certainty, the step is not made. One step from one change gives up to ``slack`` less
    than descents and all changes of a loose joint: a support that had lost a decade had -9.5 and -5.7, and in fact -2.7.
    """
    doubt, certain = limits
    found = {int(i): float(changes[i]) for i in np.flatnonzero(problem.joint & (gains > doubt))}
    rest, near = np.flatnonzero(problem.joint & (gains <= doubt)).tolist(), problem.by(state.z)

    forms = [near] if near.about is None else [near, pinned(near, state.z)]
    own = [settle(form, prior, state.kinds, state.z, step, rounds=1).evidence for form in forms] if rest else []

    def possible(i: int) -> bool:
        z, kinds = state.z.copy(), state.kinds.copy()
        change = problem.loosened(i, prior)
        z[problem.bolts[i]], kinds[i] = change, True
        return any(
            foreseen(form, prior, kinds, z, (i, change)) - tight >= -certain
            and settle(form, prior, kinds, z, step, held=(i, change), rounds=1).evidence - tight > doubt - slack
            for form, tight in zip(forms, own, strict=True)
        )

    far = zip(rest, side_by_side(possible, rest), strict=True)
    return dict(sorted((found | {i: float(changes[i]) for i, loose in far if loose}).items()))


def _other_kinds(
    problem: MixtureProblem, prior: BoltPrior, own: State, asked: Sequence[tuple[int, float]], stop: Stop
) -> dict[int, tuple[State, float]]:
    """See ``_other_kind``, for several joints of one state."""
    if not asked:
        return {}
    here = pinned(problem, own.z)
    base = own if problem.about is None else settle(here, prior, own.kinds, own.z, stop)
    ends = side_by_side(partial(_other_kind, problem, here, prior, base, stop), asked)
    return dict(zip((i for i, _ in asked), ends, strict=True))


def _other_kind(
    problem: MixtureProblem, here: MixtureProblem, prior: BoltPrior, state: State, stop: Stop, joint: tuple[int, float]
) -> tuple[State, float]:
    """Descend from a state with the kind of one joint changed; its end, and the gain in log evidence.

    ``joint`` is its position and its first change if it becomes loose. Both kinds have the same covariance: with one that follows the
    state, small changes of all others move the determinant by more than a kind does, and errors of a predicted change count against it even
    where the FRFs agree with the prediction. Whether these errors are as large is not known, so the kinds are compared with the covariance
    at either end (``here`` has that of ``state``), and loose gains by the mean of both likelihood ratios. Each counts no more than its
    significance allows: where the model is wrong by decibels, the loss of a tight joint may absorb some of that.
    """
    i, change = joint
    kinds = state.kinds.copy()
    kinds[i] = not kinds[i]

    def end(form: MixtureProblem, start: Floats, of: Bools) -> State:
        return _tight_enough(form, prior, settle(form, prior, of, start, stop), i, stop)

    def ended(first: float) -> State:
        z = state.z.copy()
        z[problem.bolts[i]] = first
        return end(here, z, kinds)

    # The linear problem may lead to the next valley only.
    other = max(map(ended, (change, problem.loosened(i, prior)) if kinds[i] else (0.0,)), key=lambda end: end.evidence)
    sign = 1.0 if kinds[i] else -1.0
    odds = sign * prior.log_odds
    gains = [odds + between(here, _tight_enough(here, prior, state, i, stop), other, odds)]
    if problem.about is not None:
        there = pinned(problem, other.z)
        before, after = (end(there, one.z, one.kinds) for one in (state, other))
        gains.append(odds + between(there, before, after, odds))
    return other, sign * float(logsumexp(sign * np.array(gains)) - np.log(len(gains)))


def _tight_enough(problem: MixtureProblem, prior: BoltPrior, state: State, i: int, stop: Stop) -> State:
    """The state; if joint ``i`` is tight but below what 97.5 % of tight joints keep, the end of a descent with it held there.

    Where residuals are large against its prior, a tight joint may lose as much as a loose one: both kinds then explain the FRFs by its
    loss, and say nothing on whether it is tight.
    """
    least = -NORMAL_95 * prior.joint_tight_std
    if state.kinds[i] or not problem.joint[i] or state.z[problem.bolts[i]] >= least:
        return state
    z = state.z.copy()
    z[problem.bolts[i]] = least
    return settle(problem, prior, state.kinds, z, stop, held=(i, least))


def _profiles(
    problem: MixtureProblem, prior: BoltPrior, joints: Sequence[tuple[int, State, float]], stops: tuple[Stop, Stop]
) -> list[tuple[float, float, float]]:
    """Profiles of joints, given as (position, state in which it is loose, width); a state that several share is settled once."""
    states = list({id(state): state for _, state, _ in joints}.values())
    bases = dict(zip(map(id, states), side_by_side(lambda state: about_itself(problem, prior, state, stops[0]), states), strict=True))
    return side_by_side(lambda one: profile(prior, *bases[id(one[1])], one[0], stops[1], one[2]), joints)


def about_itself(problem: MixtureProblem, prior: BoltPrior, state: State, stop: Stop) -> tuple[MixtureProblem, State]:
    """The problem with the covariance of the residuals fixed to that of a state, and the end of a descent from the state with it.

    With a fixed covariance the profile of a change that does not affect the FRFs is flat.
    """
    problem = pinned(problem, state.z)
    return problem, settle(problem, prior, state.kinds, state.z, stop)


def profile(
    prior: BoltPrior,
    problem: MixtureProblem,
    base: State,
    i: int,
    stop: Stop,
    width: float,
    *,
    points: int = 8,
    reach: float = 3.0,
    fine: int = 400,
    negligible: float = 10.0,
) -> tuple[float, float, float]:
    """Profile of a loose joint's change, by descents with the change fixed at several values and everything else identified anew.

    Parameters
    ----------
    prior, problem, base
        The latter two as ``about_itself`` gives them for a state in which the joint is loose.
    i : int
        Position of the joint among the bolts.
    stop : (float, int)
        Stop rule of the descents with a fixed change.
    width : float
        Standard deviation of the change by the linear problem [decades]: one and two of these to either side are further values.
    points, reach : int, float
        Number of values from no change down to so many prior standard deviations below the prior mean, or to the bound.
    fine : int
        Number of points to which the log evidence is interpolated.
    negligible : float
        Values beyond one with so much less log probability are left out: 1 in 20 000 each.

    Returns
    -------
    float, float, float
        Log evidence in addition to that of ``base``, mean and standard deviation of the change [decades].
    """
    low = max(prior.joint_loose_mean - reach * prior.joint_loose_std, float(problem.bounds[problem.bolts[i], 0]))
    own = min(float(base.z[problem.bolts[i]]), 0.0)
    low = min(low, own)
    at = np.unique(np.round(np.clip([*np.linspace(low, 0.0, points), *(own + width * np.arange(-2.0, 3.0))], low, 0.0), 6))
    at, evidence = _held(problem, prior, base, (i, at), stop, negligible)
    t = np.linspace(at[0], at[-1], fine)
    # Imported here: most commands do not need it.
    from scipy.interpolate import PchipInterpolator

    log = PchipInterpolator(at, evidence)(t) + prior.log_density(t) + np.log(t[1] - t[0])
    # The prior's probability beyond the lowest value is placed at that value: a free joint cannot lose more.
    beyond_free = evidence[0] + prior.log_below(float(at[0]))
    t, log = np.append(t, at[0]), np.append(log, beyond_free)
    weight = np.exp(log - logsumexp(log))
    mean = float(weight @ t)
    return float(logsumexp(log)) - base.evidence, mean, float(np.sqrt(weight @ (t - mean) ** 2))


def _held(
    problem: MixtureProblem, prior: BoltPrior, base: State, joint: tuple[int, Floats], stop: Stop, negligible: float
) -> tuple[Floats, Floats]:
    """Changes of a joint that are not negligible, and the log evidence with each fixed; from that of ``base`` outwards to either side."""
    i, at = joint
    evidence, known, best = np.zeros(at.size), np.zeros(at.size, dtype=bool), -np.inf
    expected = prior.log_density(at)
    begin = int(np.argmin(np.abs(at - min(float(base.z[problem.bolts[i]]), 0.0))))
    for order in (range(begin, at.size), range(begin - 1, -1, -1)):
        z = base.z
        for k in order:
            z = z.copy()
            z[problem.bolts[i]] = at[k]
            held = settle(problem, prior, base.kinds, z, stop, held=(i, float(at[k])))
            evidence[k], z, known[k] = held.evidence, held.z, True
            best = max(best, float(evidence[k] + expected[k]))
            if evidence[k] + expected[k] < best - negligible:
                break
    return at[known], evidence[known]


def sample_changes(
    problem: MixtureProblem,
    starts: Sequence[Floats],
    prior: BoltPrior = BOLT_PRIOR,
    *,
    sweeps: int = 700,
    burn_in: int = 50,
    seed: int = 0,
    compare: Stop = (1e-3, 5),
) -> ChangeSamples:
    """Posterior of the changes at bolts by Gibbs sampling of the kinds, about the most probable state and others nearly as probable.

    Parameters
    ----------
    problem : MixtureProblem
    starts : sequence of (m,) float array
        First estimates, such as that with a Gaussian prior.
    prior : BoltPrior
    sweeps, burn_in, seed : int
        Number of sweeps over all bolts, divided among the states in proportion to their evidence; number of discarded sweeps at each
        state; seed of the random numbers.

    Returns
    -------
    ChangeSamples
    """
    first, *others = best_states(problem, starts, prior)
    # Joints whose kind alone differs at the end of another search.
    apart = [np.flatnonzero(state.kinds != first.kinds).tolist() for state in others]
    best, more = beyond(problem, prior, first, suspects={one[0] for one in apart if len(one) == 1})
    # States that differ by one flip are reached by the sweeps about the best state.
    rest = [state for state in others if np.count_nonzero(state.kinds != best.kinds) > 1]
    evidence = compared(problem, prior, [best, *rest], compare)
    count = np.round(sweeps * np.exp(evidence - logsumexp(evidence))).astype(int)
    hats, rng = along_edges(problem.neighbours, problem.joint), np.random.default_rng(seed)
    parts: list[tuple[Floats, Floats, Floats]] = []
    alternatives: list[tuple[Floats, float]] = []
    for state, own in zip([best, *rest], count.tolist(), strict=True):
        if own:
            about = more if state is best else beyond(problem, prior, state, rounds=1)[1]
            parts.append(_sweeps(problem, prior, state, about, own, burn_in, rng))
            alternatives.append((state.z[problem.bolts], own / int(count.sum())))
    loose, means, stds = (np.concatenate(part) for part in zip(*parts, strict=True))
    further: dict[str, Any] = {"neighbours": hats, "alternatives": alternatives, "groups": loss_ratios(problem, prior, best), "z": best.z}
    return ChangeSamples(bolts=problem.bolts, loose=loose, means=means, stds=stds, kinds=best.kinds, prior=prior, **further)


def _sweeps(
    problem: MixtureProblem, prior: BoltPrior, state: State, more: Beyond, sweeps: int, burn_in: int, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Gibbs sampling of the kinds about one state: ``loose`` (s, b), ``means`` and ``stds`` (s, b, 2) of ``ChangeSamples``."""
    score = KindScore(state.A, state.b, prior, state.kinds, problem.neighbours, problem.joint, more.further)
    count = problem.bolts.size
    loose, means, stds = np.zeros((sweeps, count)), np.zeros((sweeps, count, 2)), np.zeros((sweeps, count, 2))
    precision = prior.tables(problem.joint)[0].min(axis=2)
    for sweep in range(-burn_in, sweeps):
        chance = np.log(rng.random(count))
        gains, centres, spreads = score.flips()
        for turn, i in enumerate(rng.permutation(count).tolist()):
            if sweep >= 0:
                loose[sweep, i] = expit(-gains[i] if score.loose[i] else gains[i])
                means[sweep, i], stds[sweep, i] = centres[i], spreads[i]
            if chance[turn] < gains[i]:
                score.flip(i)
                gains, centres, spreads = score.flips()
        # Neighbours whose hats overlap can replace each other, which single flips hardly reach.
        swaps = score.swaps()
        for pair, (i, j) in enumerate(problem.neighbours):
            if score.loose[i] != score.loose[j] and np.log(rng.random()) < swaps[pair]:
                score.flip(i, j)
                swaps = score.swaps()
    known = np.isfinite(more.loose[:, 0])
    means[:, known, 1], stds[:, known, 1] = more.loose[known].T[:, None]
    # For a single change the part of its variance that comes from errors of the data is variance - variance² / prior variance.
    stds = np.sqrt(widened(stds**2, np.maximum(stds**2 - stds**4 * precision, 0.0), problem.ratio))
    return loose, means, np.hypot(stds, problem.shared * np.abs(means) * problem.joint[:, None])
