"""Changes at bolts under a prior of two kinds: tight, hardly changed, or loose; by Gibbs sampling over which bolt is of which kind.

A Gaussian prior spreads a change over neighbours that the data hardly tell apart. Here each change is drawn from
``(1 - pi) N(0, tight²) + pi N(mean, loose²)`` (spike and slab: George and McCulloch, J. Am. Stat. Assoc. 88, 1993): given the kinds all is
Gaussian about a linearisation, the changes drop out in closed form, and the kinds alone are sampled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit
from scipy.stats import norm

from lrbc_cli.updating.misfit import Evaluation
from lrbc_cli.updating.optimise import Solution, gauss_newton

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Changes of tight bolts [decades]: retorquing scatters by 30 %, 0.11 decades at a bolt's patch; its shape, wider than the patch, smears
#: that.
TIGHT_STD = 0.07

#: Changes of loose bolts [decades]: from a patch that has lost half its stiffness to one that has lost nearly all, smeared alike.
LOOSE_MEAN, LOOSE_STD = -0.7, 0.6

#: Share of loose bolts that is expected before anything is measured.
LOOSE_SHARE = 0.1

#: Sweeps over all bolts, those before them that are left out, and the seed: a result does not change when it is computed again.
SWEEPS, BURN_IN, SEED = 600, 50, 0

#: The linearisation follows the kinds at most so many times, by at most so many changes each, as long as they gain more than this
#: [natural units of log evidence].
ROUNDS, MOVES, LEAST_GAIN = 8, 3, 0.01

#: Changes below this make a bolt loose at the second start [decades]; the first start has all bolts tight.
START_CHANGE = -0.4

#: Descent for given kinds, at last and while they are sought: its sum of squares is a few hundred to a few thousand; a tenth matters.
DESCENT_TOLERANCE, DESCENT_ITERATIONS, SEARCH_ITERATIONS = 1e-4, 12, 6


@dataclass(frozen=True)
class MixturePrior:
    """Prior of one bolt's change [decades].

    Attributes
    ----------
    tight_std, loose_mean, loose_std : float
        Of the two kinds; a tight bolt's change has mean zero.
    loose_share : float
        Probability of being loose.
    """

    tight_std: float = TIGHT_STD
    loose_mean: float = LOOSE_MEAN
    loose_std: float = LOOSE_STD
    loose_share: float = LOOSE_SHARE

    def of(self, loose: Bools) -> tuple[Floats, Floats]:
        """Precision and mean of each bolt's change, given the kinds."""
        return np.where(loose, self.loose_std**-2, self.tight_std**-2), np.where(loose, self.loose_mean, 0.0)

    @property
    def log_odds(self) -> float:
        """Of being loose."""
        return float(np.log(self.loose_share / (1.0 - self.loose_share)))


@dataclass(frozen=True)
class MixtureProblem:
    """What is measured of unknowns z, some of which are changes at bolts.

    Attributes
    ----------
    data : callable
        From z (m,) to residuals (n,) and their Jacobian (n, m).
    variance : float
        Of a residual, correlation included.
    bounds : (m, 2) float array
    bolts : (b,) int array
        Which of z are changes at bolts.
    neighbours : sequence of (int, int)
        Pairs of positions in ``bolts`` that lie side by side along an edge.
    mean, std : (m,) float arrays
        Gaussian prior of those of z that are none; not read at bolts.
    """

    data: Callable[[Floats], tuple[Floats, Floats]]
    variance: float
    bounds: Floats
    bolts: NDArray[np.int64]
    neighbours: Sequence[tuple[int, int]]
    mean: Floats
    std: Floats


@dataclass(frozen=True)
class ChangeSamples:
    """Posterior of the changes at bolts: for each sweep and bolt two Gaussians, tight and loose, given the kinds of the others.

    Averages over these conditionals scatter less than draws of the changes would (Rao-Blackwell).

    Attributes
    ----------
    bolts : (b,) int array
        Columns of the bolts among the unknowns.
    loose : (s, b) float array
        Conditional probability of the loose kind.
    means, stds : (s, b, 2) float arrays
        Of the change [decades], tight and loose.
    kinds : (b,) bool array
        Loose bolts of the most probable state about which all was linearised.
    """

    bolts: NDArray[np.int64]
    loose: Floats = field(repr=False)
    means: Floats = field(repr=False)
    stds: Floats = field(repr=False)
    kinds: Bools

    @property
    def inclusion(self) -> Floats:
        """(b,) probabilities of the loose kind."""
        return np.asarray(self.loose.mean(axis=0))

    @property
    def mean(self) -> Floats:
        """(b,) posterior means of the changes [decades]."""
        return np.asarray((self._weights * self.means).sum(axis=2).mean(axis=0))

    @property
    def std(self) -> Floats:
        """(b,) posterior standard deviations of the changes [decades]."""
        square = (self._weights * (self.stds**2 + (self.means - self.mean[:, None]) ** 2)).sum(axis=2).mean(axis=0)
        return np.asarray(np.sqrt(square))

    def below(self, limit: float, scatter: float = 0.0) -> Floats:
        """(b,) probabilities that the changes lie below a limit [decades], with a further standard deviation where tight states scatter."""
        inside = norm.cdf((limit - self.means) / np.hypot(self.stds, scatter))
        return np.asarray((self._weights * inside).sum(axis=2).mean(axis=0))

    @property
    def _weights(self) -> Floats:
        return np.stack([1.0 - self.loose, self.loose], axis=2)


class KindScore:
    """Evidence of kinds on ``z'Az/2 - b'z``, with what a flip of each kind would add to it, kept up to date by rank-one changes.

    Parameters
    ----------
    A, b : (b, b) and (b,) float arrays
        Curvature and slope of the data's half sum of squares over the variance, all else marginalised.
    prior : MixturePrior
    loose : (b,) bool array
        Kinds to begin with.

    Attributes
    ----------
    covariance, mean : (b, b) and (b,) float arrays
        Of the changes given the kinds.
    """

    def __init__(self, A: Floats, b: Floats, prior: MixturePrior, loose: Bools) -> None:
        self._A, self._b, self._prior = A, b, prior
        precision, mean = (np.stack(pair) for pair in zip(*(prior.of(np.full(b.size, kind)) for kind in (False, True)), strict=True))
        tight, slack = float(precision[0, 0]), float(precision[1, 0])
        # To loose: added to the precision, to the slope, and to the log evidence whatever the data.
        self._step = (slack - tight, slack * prior.loose_mean)
        self._offset = prior.log_odds + 0.5 * np.log(slack / tight) - 0.5 * slack * prior.loose_mean**2
        self._table = precision, precision * mean
        self.loose = loose.copy()
        self.refresh()

    def refresh(self) -> None:
        """Compute covariance and mean afresh: many rank-one changes gather round-off."""
        row = self.loose.astype(np.int64)
        at = np.arange(row.size)
        self.covariance = np.asarray(np.linalg.inv(self._A + np.diag(self._table[0][row, at])))
        self.mean = self.covariance @ (self._b + self._table[1][row, at])

    def gains(self) -> Floats:
        """(b,) log evidence that each single flip adds."""
        return np.array([self.gain(i) for i in range(self.loose.size)])

    def gain(self, i: int) -> float:
        """Log evidence that a flip of bolt i adds."""
        sign = -1.0 if self.loose[i] else 1.0
        d, e = sign * self._step[0], sign * self._step[1]
        c, m = float(self.covariance[i, i]), float(self.mean[i])
        grown = 1.0 + d * c
        return float(sign * self._offset + e * m + 0.5 * e * e * c - 0.5 * d * (m + e * c) ** 2 / grown - 0.5 * np.log(grown))

    def conditionals(self, i: int) -> tuple[tuple[float, float], tuple[float, float]]:
        """Mean and standard deviation of change i if it is tight, and if it is loose, given the kinds of the others."""
        sign = -1.0 if self.loose[i] else 1.0
        c, m = float(self.covariance[i, i]), float(self.mean[i])
        grown = 1.0 + sign * self._step[0] * c
        own, other = (m, c**0.5), ((m + sign * self._step[1] * c) / grown, (c / grown) ** 0.5)
        return (other, own) if self.loose[i] else (own, other)

    def flip(self, i: int) -> None:
        """Make bolt i of the other kind."""
        sign = -1.0 if self.loose[i] else 1.0
        d, e = sign * self._step[0], sign * self._step[1]
        column = self.covariance[:, i].copy()
        grown = 1.0 + d * column[i]
        self.mean = self.mean + column * ((e - d * self.mean[i]) / grown)
        self.covariance = self.covariance - np.outer(column, column * (d / grown))
        self.loose[i] = not self.loose[i]

    def swap_gain(self, i: int, j: int) -> float:
        """Log evidence that flips of both add."""
        kept = self.covariance, self.mean, self.loose.copy()
        first = self.gain(i)
        self.flip(i)
        both = first + self.gain(j)
        self.covariance, self.mean, self.loose = kept
        return both


def improve(score: KindScore, neighbours: Sequence[tuple[int, int]], moves: int) -> None:
    """Flip, or swap neighbours of different kinds, for the better, at most so many times."""
    for _ in range(moves):
        gains = score.gains()
        best: tuple[float, tuple[int, ...]] = (float(gains.max()), (int(gains.argmax()),))
        for i, j in neighbours:
            if score.loose[i] != score.loose[j]:
                best = max(best, (score.swap_gain(i, j), (i, j)))
        if best[0] <= LEAST_GAIN:
            return
        for bolt in best[1]:
            score.flip(bolt)


@dataclass(frozen=True)
class _State:
    """Optimum for given kinds, its log evidence (Laplace), and the linear problem of the bolts about it."""

    kinds: Bools
    z: Floats
    evidence: float
    A: Floats = field(repr=False)
    b: Floats = field(repr=False)


def _priors(problem: MixtureProblem, prior: MixturePrior, kinds: Bools) -> tuple[Floats, Floats]:
    """(m,) precisions and means of all unknowns."""
    precision, mean = problem.std**-2.0, problem.mean.copy()
    precision[problem.bolts], mean[problem.bolts] = prior.of(kinds)
    return precision, mean


def _settle(problem: MixtureProblem, prior: MixturePrior, kinds: Bools, z: Floats, iterations: int) -> _State:
    """Descend for given kinds, and linearise."""
    precision, mean = _priors(problem, prior, kinds)
    scale, weight = problem.variance**-0.5, np.sqrt(precision)

    def cost(z: Floats) -> Evaluation:
        r, J = problem.data(z)
        residual = np.concatenate([scale * r, weight * (z - mean)])
        total = max(float(residual @ residual), np.finfo(float).tiny)
        jacobian = np.vstack([scale * J, np.diag(weight)])
        return Evaluation(float(np.log10(total)), total, float(r @ r), float(np.mean(np.abs(r))), residual, jacobian)

    found: Solution = gauss_newton(cost, z, problem.bounds, tolerance=DESCENT_TOLERANCE, max_iterations=iterations)
    value, z = found.evaluation, found.theta
    rows = value.residual.size - z.size
    J, r = value.jacobian[:rows], value.residual[:rows]
    H = value.jacobian.T @ value.jacobian
    evidence = 0.5 * (float(np.log(precision).sum()) - value.total - float(np.linalg.slogdet(H)[1])) + float(kinds.sum()) * prior.log_odds
    A, b = J.T @ J, J.T @ (J @ z - r)
    at = problem.bolts
    rest = np.setdiff1d(np.arange(z.size), at)
    # All that is Gaussian whatever the kinds drops out here, once for all sweeps.
    across = A[np.ix_(at, rest)]
    share = np.linalg.solve(
        A[np.ix_(rest, rest)] + np.diag(precision[rest]), np.column_stack([across.T, b[rest] + precision[rest] * mean[rest]])
    )
    return _State(kinds, z, evidence, A[np.ix_(at, at)] - across @ share[:, :-1], b[at] - across @ share[:, -1])


def best_state(problem: MixtureProblem, z: Floats, prior: MixturePrior) -> _State:
    """The most probable kinds that relinearisation and local search find, from all tight and from the large changes of z."""
    best: _State | None = None
    for kinds, start in ((np.zeros(problem.bolts.size, dtype=bool), np.zeros(z.size)), (z[problem.bolts] < START_CHANGE, z)):
        seen: set[bytes] = set()
        for _ in range(ROUNDS):
            state = _settle(problem, prior, kinds, start, SEARCH_ITERATIONS)
            if best is None or state.evidence > best.evidence:
                best = state
            seen.add(kinds.tobytes())
            score = KindScore(state.A, state.b, prior, kinds)
            # Few moves at a time: a linearisation does not carry far.
            improve(score, problem.neighbours, MOVES)
            if score.loose.tobytes() in seen:
                break
            kinds, start = score.loose.copy(), state.z
    assert best is not None
    return _settle(problem, prior, best.kinds, best.z, DESCENT_ITERATIONS)


def sample_changes(
    problem: MixtureProblem, z: Floats, prior: MixturePrior | None = None, sweeps: int = SWEEPS, seed: int = SEED
) -> ChangeSamples:
    """Sample which bolts are loose, on the problem linearised about the most probable state.

    Parameters
    ----------
    problem : MixtureProblem
    z : (m,) float array
        A first estimate, such as that with a Gaussian prior.
    prior : MixturePrior or None
    sweeps, seed : int
        The same seed gives the same result.

    Returns
    -------
    ChangeSamples
    """
    prior = MixturePrior() if prior is None else prior
    state = best_state(problem, z, prior)
    score = KindScore(state.A, state.b, prior, state.kinds)
    rng = np.random.default_rng(seed)
    count = problem.bolts.size
    loose, means, stds = np.zeros((sweeps, count)), np.zeros((sweeps, count, 2)), np.zeros((sweeps, count, 2))
    for sweep in range(-BURN_IN, sweeps):
        score.refresh()
        chance = np.log(rng.random(count))
        for turn, i in enumerate(rng.permutation(count).tolist()):
            gain = score.gain(i)
            if sweep >= 0:
                loose[sweep, i] = expit(-gain if score.loose[i] else gain)
                (means[sweep, i, 0], stds[sweep, i, 0]), (means[sweep, i, 1], stds[sweep, i, 1]) = score.conditionals(i)
            if chance[turn] < gain:
                score.flip(i)
        # Neighbours whose hats overlap take each other's part: by single flips that is a long way.
        for i, j in problem.neighbours:
            if score.loose[i] != score.loose[j] and np.log(rng.random()) < score.swap_gain(i, j):
                score.flip(i)
                score.flip(j)
    return ChangeSamples(problem.bolts, loose, means, stds, state.kinds)
