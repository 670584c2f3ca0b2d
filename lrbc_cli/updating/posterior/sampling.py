"""Sampling of the kinds of bolts on the problem linearised about the most probable state, and what that does not tell of joints.

A joint that lost a decade or two stands where the data hardly feel it: from there a linear problem takes the way back for cheap. So the
evidence of doubtful joints comes from descents with the other kind, and a change that stays wide from its profile.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import expit, logsumexp

from lrbc_cli.arrays import Floats
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.posterior.mixture import ChangeSamples, KindScore, MixtureProblem, State, Stop, along_edges, best_states, settle
from lrbc_cli.updating.statistics.noise import widened
from lrbc_cli.updating.statistics.priors import BOLT_PRIOR, BoltPrior


@dataclass(frozen=True)
class Beyond:
    """What descents say of joints beyond the linear problem.

    Attributes
    ----------
    further : (b,) float array
        Log evidence for being loose to be added; 0 where the linear problem holds.
    loose : (b, 2) float array
        Mean and standard deviation of the change if loose [decades]; NaN where the linear problem holds.
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
) -> tuple[State, Beyond]:
    """Descend with the other kind of each joint that is loose or could be.

    Parameters
    ----------
    problem : MixtureProblem
    prior : BoltPrior
    state : State
    doubt : float
        A tight joint could be loose where the linear problem gives that so much log evidence.
    wide : float
        Standard deviation of a loose joint's change from which on it is taken from a profile [decades].
    gain, rounds : float, int
        Where the other kind gains so much log evidence, all begins anew there, at most so many times.
    certain : float
        Log evidence between both kinds of a joint from which on it is not looked at again, 1 in 10^13; less what the state has gained
        since: one with the other kind could have gained as much.
    stop, held : (float, int)
        Of the descents, and of those with a change held, each from the end of the one before.

    Returns
    -------
    State, Beyond
        The best state seen.
    """
    # Log evidence for loose over tight of those that are settled.
    known: dict[int, float] = {}
    for turn in range(rounds):
        score = KindScore(state.A, state.b, prior, state.kinds, problem.neighbours, problem.joint)
        gains, means, stds = score.flips()
        doubted = np.flatnonzero(problem.joint & (state.kinds | (gains > doubt))).tolist()
        # Where errors follow the state, a descent moves the evidence by a nat though nothing changes: both kinds go the same way.
        own = settle(problem, prior, state.kinds, state.z, stop) if doubted else state
        asked = [(i, float(means[i, 1])) for i in doubted if i not in known]
        others = dict(zip((i for i, _ in asked), side_by_side(partial(_other_kind, problem, prior, state, stop), asked), strict=True))
        for i, other in others.items():
            apart = own.evidence - other.evidence
            if apart > certain:
                known[i] = apart if state.kinds[i] else -apart
        best = max([own, *others.values()], key=lambda one: one.evidence)
        if best.evidence <= own.evidence + gain or turn == rounds - 1:
            break
        gained = best.evidence - own.evidence
        known = {i: apart - float(np.copysign(gained, apart)) for i, apart in known.items() if abs(apart) > certain + gained}
        state = best
    last = _Turn(state=state, own=own, others=others, doubted=doubted, known=known, gains=gains)
    felt = np.where(problem.bounds[problem.bolts, 0] < -wide, stds[:, 1], 0.0)
    return state, last.said(problem, prior, np.where(felt > wide, felt, np.nan), (stop, held))


@dataclass(frozen=True, kw_only=True)
class _Turn:
    """What descents from one state found: where it leads itself, and with the other kind of each joint that is not settled.

    Attributes
    ----------
    state, own : State
    others : mapping of int to State
    doubted : sequence of int
        Joints that are loose or could be.
    known : mapping of int to float
        Log evidence for loose over tight of those that are settled.
    gains : (b,) float array
        Log evidence that the linear problem gives a flip.
    """

    state: State
    own: State
    others: Mapping[int, State]
    doubted: Sequence[int]
    known: Mapping[int, float]
    gains: Floats

    def said(self, problem: MixtureProblem, prior: BoltPrior, widths: Floats, stops: tuple[Stop, Stop]) -> Beyond:
        """Evidence beyond the linear problem, and changes by profiles of those joints that have a width (b,), else NaN."""
        kinds, found = self.state.kinds, Beyond(np.zeros(self.gains.size), np.full((self.gains.size, 2), np.nan))
        loose = {i: self.own if kinds[i] else self.others[i] for i in self.doubted if kinds[i] or i in self.others}
        flat = [(i, at, float(widths[i])) for i, at in loose.items() if np.isfinite(widths[i])]
        profiles = dict(zip((i for i, *_ in flat), _profiles(problem, prior, flat, stops), strict=True))
        for i in self.doubted:
            sign = 1.0 if kinds[i] else -1.0
            apart = self.known[i] if i in self.known else sign * (self.own.evidence - self.others[i].evidence)
            more, mean, std = profiles.get(i, (0.0, np.nan, np.nan))
            found.loose[i] = mean, std
            found.further[i] = apart + more + sign * self.gains[i]
        return found


def _other_kind(problem: MixtureProblem, prior: BoltPrior, state: State, stop: Stop, joint: tuple[int, float]) -> State:
    """Where a state with one joint of the other kind leads; the change of that, if loose, begins as given."""
    i, change = joint
    z, kinds = state.z.copy(), state.kinds.copy()
    kinds[i] = not kinds[i]
    z[problem.bolts[i]] = change if kinds[i] else 0.0
    return settle(problem, prior, kinds, z, stop)


def _profiles(
    problem: MixtureProblem, prior: BoltPrior, joints: Sequence[tuple[int, State, float]], stops: tuple[Stop, Stop]
) -> list[tuple[float, float, float]]:
    """Profiles of some joints, each in a state in which it is loose, with its width; states that several share are settled once."""
    states = list({id(state): state for _, state, _ in joints}.values())
    bases = dict(zip(map(id, states), side_by_side(lambda state: about_itself(problem, prior, state, stops[0]), states), strict=True))
    return side_by_side(lambda one: profile(prior, *bases[id(one[1])], one[0], stops[1], one[2]), joints)


def about_itself(problem: MixtureProblem, prior: BoltPrior, state: State, stop: Stop) -> tuple[MixtureProblem, State]:
    """The problem with the covariance of the residuals of a state throughout, and where the state leads then.

    Of a change that the data do not feel a profile is flat then.
    """
    if problem.about is not None:
        problem = replace(problem, data=problem.about(state.z)[0], about=None)
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
    """Log evidence of a loose joint beyond that of its state, mean and standard deviation of its change, from descents with it held.

    Parameters
    ----------
    prior, problem, base
        The latter two as ``about_itself`` gives them for a state in which the joint is loose.
    i : int
        Which of the bolts.
    stop : (float, int)
        Of the descents with the change held.
    width : float
        Standard deviation of the change by the linear problem [decades]: values are held there on both sides, too.
    points, reach : int, float
        Values from no change to so many standard deviations of the prior below its mean, or to the bound.
    fine : int
        Values between which the log evidence is interpolated.
    negligible : float
        Where the data and the prior say so much less of a value, the ones beyond it are left out: 1 in 20 000 each.
    """
    low = max(prior.joint_loose_mean - reach * prior.joint_loose_std, float(problem.bounds[problem.bolts[i], 0]))
    own = min(float(base.z[problem.bolts[i]]), 0.0)
    low = min(low, own)
    at = np.unique(np.round(np.clip([*np.linspace(low, 0.0, points), *(own + width * np.arange(-2.0, 3.0))], low, 0.0), 6))
    at, evidence = _held(problem, prior, base, (i, at), stop, negligible)
    t = np.linspace(at[0], at[-1], fine)
    # Loaded here: most commands do without.
    from scipy.interpolate import PchipInterpolator

    log = PchipInterpolator(at, evidence)(t) + prior.log_density(t) + np.log(t[1] - t[0])
    # What the prior has beyond the lowest value stands there: a joint that is free cannot lose more.
    beyond_free = evidence[0] + prior.log_below(float(at[0]))
    t, log = np.append(t, at[0]), np.append(log, beyond_free)
    weight = np.exp(log - logsumexp(log))
    mean = float(weight @ t)
    return float(logsumexp(log)) - base.evidence, mean, float(np.sqrt(weight @ (t - mean) ** 2))


def _held(
    problem: MixtureProblem, prior: BoltPrior, base: State, joint: tuple[int, Floats], stop: Stop, negligible: float
) -> tuple[Floats, Floats]:
    """Changes of a joint that count, of those given, and the evidence with each held: from the state outwards, each from the one before."""
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
    problem: MixtureProblem, starts: Sequence[Floats], prior: BoltPrior = BOLT_PRIOR, *, sweeps: int = 700, burn_in: int = 50, seed: int = 0
) -> ChangeSamples:
    """Sample which bolts are loose, on the problem linearised about the most probable state and about others nearly as probable.

    Parameters
    ----------
    problem : MixtureProblem
    starts : sequence of (m,) float array
        First estimates, such as that with a Gaussian prior.
    prior : BoltPrior
    sweeps, burn_in, seed : int
        Sweeps over all bolts, shared by the states in proportion to their evidence, those before them that are left out at each; the same
        seed gives the same result.

    Returns
    -------
    ChangeSamples
    """
    first, *others = best_states(problem, starts, prior)
    best, more = beyond(problem, prior, first)
    # What one flip reaches the sweeps about the best state reach themselves.
    rest = [state for state in others if np.count_nonzero(state.kinds != best.kinds) > 1]
    evidence = np.array([best.evidence, *(state.evidence for state in rest)])
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
    return ChangeSamples(
        bolts=problem.bolts, loose=loose, means=means, stds=stds, kinds=best.kinds, neighbours=hats, prior=prior, alternatives=alternatives
    )


def _sweeps(
    problem: MixtureProblem, prior: BoltPrior, state: State, more: Beyond, sweeps: int, burn_in: int, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Gibbs sampling of the kinds about one state: conditional probabilities (s, b), means and standard deviations (s, b, 2)."""
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
        # Neighbours whose hats overlap take each other's part: by single flips that is a long way.
        swaps = score.swaps()
        for pair, (i, j) in enumerate(problem.neighbours):
            if score.loose[i] != score.loose[j] and np.log(rng.random()) < swaps[pair]:
                score.flip(i, j)
                swaps = score.swaps()
    known = np.isfinite(more.loose[:, 0])
    means[:, known, 1], stds[:, known, 1] = more.loose[known].T[:, None]
    # Of one change by itself: variance less variance² over that of the prior is what the errors of the data make.
    stds = np.sqrt(widened(stds**2, np.maximum(stds**2 - stds**4 * precision, 0.0), problem.ratio))
    return loose, means, np.hypot(stds, problem.shared * np.abs(means) * problem.joint[:, None])
