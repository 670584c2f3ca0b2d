"""Sampling of tight and loose bolts against the sum over all kinds, which is known where all is linear."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from linear import line_group
from scipy.stats import multivariate_normal, norm

from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.posterior.kinds import KindScore, adjacency
from lrbc_cli.updating.posterior.mixture import MixtureProblem, best_states, compared, foreseen, settle
from lrbc_cli.updating.posterior.samples import ChangeSamples
from lrbc_cli.updating.posterior.sampling import sample_changes
from lrbc_cli.updating.statistics.priors import BoltPrior
from lrbc_cli.updating.unknowns.shapes import bolt_shapes, neighbours

BOLTS, ROWS = 8, 40
PRIOR = BoltPrior()


class Toy:
    """``r = r0 + J z`` with smooth columns, so that neighbours are hard to tell apart; further Gaussian unknowns before the bolts."""

    def __init__(self, truth: np.ndarray, *, sigma: float = 0.3, further: int = 2, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.sigma, self.further = sigma, further
        at = np.arange(BOLTS)
        alike = 0.9 ** np.abs(at[:, None] - at)
        self.J = np.hstack([rng.normal(size=(ROWS, further)), rng.normal(size=(ROWS, BOLTS)) @ np.linalg.cholesky(alike).T / 3.0])
        z = np.concatenate([0.3 * rng.normal(size=further), truth])
        self.r0 = -self.J @ z + sigma * rng.normal(size=ROWS)

    def problem(self) -> MixtureProblem:
        size = self.further + BOLTS
        return MixtureProblem(
            data=lambda z: (self.r0 + self.J @ z, self.J),
            variance=self.sigma**2,
            bounds=np.tile([-9.0, 9.0], (size, 1)),
            bolts=np.arange(self.further, size),
            neighbours=[(i, i + 1) for i in range(BOLTS - 1)],
            joint=np.zeros(BOLTS, dtype=bool),
            mean=np.full(size, 0.1),
            std=np.full(size, 0.5),
        )

    def exact(self, limit: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Inclusion, mean, std and probability below a limit by summation over all kinds, with densities of the data themselves."""
        problem, logs, means, stds = self.problem(), [], [], []
        kinds = np.array(list(product([False, True], repeat=BOLTS)))
        for loose in kinds:
            gap = np.convolve(loose, [1, 0, 1], "same") > 0
            means_of = np.where(gap, PRIOR.loose_mean, PRIOR.alone_mean)
            stds_of = np.where(gap, PRIOR.loose_std, PRIOR.alone_std)
            mean = np.concatenate([problem.mean[: self.further], np.where(loose, means_of, 0.0)])
            cov = np.diag(np.concatenate([problem.std[: self.further], np.where(loose, stds_of, PRIOR.tight_std)]) ** 2)
            total = self.J @ cov @ self.J.T + problem.variance * np.eye(ROWS)
            logs.append(multivariate_normal.logpdf(-self.r0, self.J @ mean, total) + loose.sum() * PRIOR.log_odds)
            gain = cov @ self.J.T @ np.linalg.inv(total)
            means.append((mean + gain @ (-self.r0 - self.J @ mean))[self.further :])
            stds.append(np.sqrt(np.diag(cov - gain @ self.J @ cov))[self.further :])
        w = np.exp(np.array(logs) - max(logs))
        w /= w.sum()
        m, s = np.array(means), np.array(stds)
        mean = w @ m
        return w @ kinds, mean, np.sqrt(w @ (s**2 + (m - mean) ** 2)), w @ norm.cdf((limit - m) / s)


ONE = np.array([0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0])
TWO = np.array([0.05, -0.6, 0.0, 0.05, 0.0, -0.05, -0.4, 0.0])


@pytest.mark.parametrize(("truth", "sigma", "further"), [(ONE, 0.3, 2), (TWO, 0.3, 2), (TWO, 0.6, 0), (0 * ONE, 0.3, 2)])
@pytest.mark.parametrize("seed", [0, 1])
def test_it_agrees_with_the_sum_over_all_kinds(truth: np.ndarray, sigma: float, further: int, seed: int) -> None:
    toy = Toy(truth, sigma=sigma, further=further, seed=seed)
    found = sample_changes(toy.problem(), [np.zeros(further + BOLTS)])
    inclusion, mean, std, below = toy.exact(-0.3)
    np.testing.assert_allclose(found.inclusion, inclusion, atol=0.03)
    np.testing.assert_allclose(found.below(-0.3), below, atol=0.03)
    np.testing.assert_allclose(found.mean, mean, atol=0.03)
    np.testing.assert_allclose(found.std, std, atol=0.04)


def test_the_toy_is_no_easy_one() -> None:
    """Between none and all: else the comparison would say little."""
    inclusion = Toy(TWO).exact(-0.3)[0]
    assert np.sum((inclusion > 0.1) & (inclusion < 0.9)) >= 2


def test_the_same_again() -> None:
    first, second = (sample_changes(Toy(TWO).problem(), [np.zeros(2 + BOLTS)]) for _ in range(2))
    np.testing.assert_array_equal(first.loose, second.loose)
    np.testing.assert_array_equal(first.means, second.means)
    other = sample_changes(Toy(TWO).problem(), [np.zeros(2 + BOLTS)], seed=1)
    assert (other.loose != first.loose).any()
    np.testing.assert_allclose(other.inclusion, first.inclusion, atol=0.04)


def test_a_clear_loose_bolt() -> None:
    found = sample_changes(Toy(ONE, sigma=0.05).problem(), [np.zeros(2 + BOLTS)])
    assert found.kinds.tolist() == (ONE < 0).tolist()
    assert found.below(-0.3)[3] > 0.99
    assert np.delete(found.below(-0.3), 3).max() < 0.05
    assert found.mean[3] == pytest.approx(-1.0, abs=0.15)
    # Tight states that scatter make every probability less certain.
    assert found.below(-0.3, 0.5)[3] < found.below(-0.3)[3]


def test_where_the_data_say_nothing_the_prior_stays() -> None:
    toy = Toy(0 * ONE)
    toy.J[:] *= 1e-6
    found = sample_changes(toy.problem(), [np.zeros(2 + BOLTS)])
    np.testing.assert_allclose(found.inclusion, PRIOR.loose_share, atol=1e-3)
    share = PRIOR.loose_share
    alone = np.array([1 - share, *[(1 - share) ** 2] * (BOLTS - 2), 1 - share])
    np.testing.assert_allclose(found.mean, share * (alone * PRIOR.alone_mean + (1 - alone) * PRIOR.loose_mean), atol=1e-3)


@pytest.mark.parametrize("follows", [False, True])
def test_what_one_step_promises_a_descent_keeps_where_all_is_linear(follows: bool) -> None:
    toy = Toy(ONE)
    problem, kinds, rng = toy.problem(), ONE < -0.1, np.random.default_rng(5)
    if follows:
        problem = replace(problem, about=lambda z: (lambda y: (2.0 * (toy.r0 + toy.J @ y), 2.0 * toy.J), -7.0))
    for i, change in ((0, -1.0), (3, 0.2)):
        z = 0.5 * rng.normal(size=problem.mean.size)
        z[problem.bolts[i]] = change
        kept = settle(problem, PRIOR, kinds, z, (1e-12, 50), held=(i, change))
        assert foreseen(problem, PRIOR, kinds, z, (i, change)) == pytest.approx(kept.evidence, rel=1e-9)
        z[problem.bolts[i]] += 0.1
        # Another change has another evidence.
        assert abs(foreseen(problem, PRIOR, kinds, z, (i, change + 0.1)) - kept.evidence) > 1e-3


def test_a_nonlinear_problem_is_linearised_where_it_ends() -> None:
    toy = Toy(ONE, sigma=0.05)
    linear = toy.problem()

    def bend(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # A monotone bend of every unknown, far from linear at the truth.
        own, slope = np.sinh(z), np.cosh(z)
        return toy.r0 + toy.J @ own, toy.J * slope

    bent = MixtureProblem(
        data=bend,
        variance=linear.variance,
        bounds=linear.bounds,
        bolts=linear.bolts,
        neighbours=linear.neighbours,
        joint=linear.joint,
        mean=linear.mean,
        std=linear.std,
    )
    found = sample_changes(bent, [np.zeros(2 + BOLTS)])
    assert found.mean[3] == pytest.approx(np.arcsinh(-1.0), abs=0.15)
    assert found.below(-0.3)[3] > 0.99


@pytest.mark.parametrize("seed", range(12))
def test_no_bolt_that_is_loose_alone_is_more_probable_than_the_state_found(seed: int) -> None:
    """Data with valleys: all starts lie in one of another bolt, and no linearisation leads from there to the right one."""
    rng = np.random.default_rng(seed)
    A, B, turned = 6.0 * rng.normal(size=(20, 3)) / np.sqrt(20), 2.0 + 3.0 * rng.random((20, 3)), 2.0 * np.pi * rng.random((20, 3))

    def measured(z: np.ndarray) -> np.ndarray:
        return np.asarray((A * np.sin(B * z + turned)).sum(axis=1))

    y = measured(np.array([-1.6, 0.0, 0.0])) + 0.3 * rng.normal(size=20)
    three = np.ones(3)
    problem = MixtureProblem(
        data=lambda z: (measured(z) - y, A * B * np.cos(B * z + turned)), variance=1.0, bounds=np.tile([-4.0, 2.0], (3, 1)),
        bolts=np.arange(3), neighbours=[], joint=three > 0.0, mean=0.0 * three, std=three,
    )  # fmt: skip
    wrong = settle(problem, PRIOR, np.array([False, True, False]), np.array([0.0, -0.7, 0.0]), (1e-4, 12))
    best = best_states(problem, [wrong.z], PRIOR)[0]
    alone = settle(problem, PRIOR, np.array([True, False, False]), np.array([-1.5, 0.0, 0.0]), (1e-4, 12))
    assert best.evidence >= alone.evidence - 0.05


def test_two_ends_are_compared_with_the_covariance_of_either() -> None:
    """Against normal densities of the data given the kinds; the determinant, which follows every descent, decides nothing."""
    toy = Toy(ONE)
    plain, calls = toy.problem(), list[int]()

    def weights(z: np.ndarray) -> np.ndarray:
        return np.where(np.arange(ROWS) < ROWS // 2, 1.0, 0.4 if z[plain.bolts[3]] < -0.5 else 0.8)

    def about(z: np.ndarray):
        calls.append(1)
        w = weights(z)
        return (lambda y: (w * (toy.r0 + toy.J @ y), w[:, None] * toy.J)), 50.0 * (-1.0) ** len(calls)

    problem, zero = replace(plain, about=about), np.zeros(2 + BOLTS)
    ends = [settle(problem, PRIOR, kinds, zero, (1e-12, 50)) for kinds in (ONE < -0.1, np.arange(BOLTS) == 6)]

    def log(kinds: np.ndarray, z: np.ndarray) -> float:
        precision, mean = plain.std**-2.0, plain.mean.copy()
        precision[plain.bolts], mean[plain.bolts] = PRIOR.of(kinds, adjacency(plain.neighbours, plain.joint), plain.joint)
        w = weights(z)
        total = w[:, None] * toy.J @ np.diag(1.0 / precision) @ toy.J.T * w + plain.variance * np.eye(ROWS)
        return float(multivariate_normal.logpdf(-w * toy.r0, w * (toy.J @ mean), total)) + kinds.sum() * PRIOR.log_odds

    expected = np.mean([log(ends[1].kinds, end.z) - log(ends[0].kinds, end.z) for end in ends])
    assert weights(ends[0].z)[-1] != weights(ends[1].z)[-1]
    np.testing.assert_allclose(compared(problem, PRIOR, ends, (1e-12, 50)), [0.0, expected], rtol=1e-6)
    np.testing.assert_allclose(compared(problem, PRIOR, ends[::-1], (1e-12, 50)), [0.0, -expected], rtol=1e-6)


def test_a_state_answers_for_its_own_errors_only() -> None:
    """Errors that a large change brings along are no excuse for no change at all."""
    rows, truth = 40, -1.2
    J = np.full((rows, 1), 3.0)
    r0 = -truth * J[:, 0] + np.random.default_rng(0).normal(size=rows)

    def about(z: np.ndarray):
        w = 1.0 / np.sqrt(1.0 + (8.0 * float(z[0])) ** 2)
        return (lambda z: (w * (r0 + J @ z), w * J)), float(rows * np.log(w))

    def problem(data, about=None):
        one = np.ones(1)
        return MixtureProblem(
            data=data,
            variance=1.0,
            bounds=np.array([[-9.0, 9.0]]),
            bolts=np.array([0]),
            neighbours=[],
            joint=np.zeros(1, dtype=bool),
            mean=0 * one,
            std=one,
            about=about,
        )

    fixed = sample_changes(problem(about(np.array([truth]))[0]), [np.array([truth])])
    own = sample_changes(problem(about(np.array([truth]))[0], about), [np.array([truth])])
    assert not fixed.kinds.any()
    assert own.kinds.all()
    assert own.below(-0.3)[0] > 0.95


@pytest.mark.parametrize("joint", [[False] * 5, [True] * 5, [False, False, True, True, False]])
def test_changes_of_low_rank_are_what_a_fresh_start_gives(joint: list[bool]) -> None:
    rng = np.random.default_rng(3)
    J = rng.normal(size=(12, 5))
    A, b = J.T @ J, rng.normal(size=5)
    pairs, joints = [(0, 1), (1, 2), (3, 4)], np.array(joint)

    def evidence(loose: np.ndarray) -> float:
        precision, mean = PRIOR.of(loose, adjacency(pairs, joints), joints)
        H, h = A + np.diag(precision), b + precision * mean
        return float(
            0.5 * h @ np.linalg.solve(H, h)
            - 0.5 * precision @ mean**2
            - 0.5 * np.linalg.slogdet(H)[1]
            + 0.5 * np.log(precision).sum()
            + loose.sum() * PRIOR.log_odds
        )

    score = KindScore(A, b, PRIOR, np.array([True, False, False, True, False]), pairs, joints)
    for i in rng.integers(5, size=30):
        before = score.loose.copy()
        gains, means, stds = score.flips()
        for k in range(5):
            flipped = before.copy()
            flipped[k] = not flipped[k]
            assert gains[k] == pytest.approx(evidence(flipped) - evidence(before), abs=1e-8)
            fresh = KindScore(A, b, PRIOR, flipped, pairs, joints)
            own, other = int(before[k]), int(flipped[k])
            assert means[k, other] == pytest.approx(fresh.mean[k], abs=1e-10)
            assert stds[k, other] == pytest.approx(np.sqrt(fresh.covariance[k, k]), abs=1e-10)
            assert means[k, own] == score.mean[k]
        for gain, pair in zip(score.swaps(), pairs, strict=True):
            both = before.copy()
            both[list(pair)] = ~both[list(pair)]
            assert gain == pytest.approx(evidence(both) - evidence(before), abs=1e-8)
        score.flip(i)
        assert score.loose.tolist() == [bool(kind) != (k == i) for k, kind in enumerate(before)]


def test_moments_of_two_conditionals() -> None:
    found = ChangeSamples(
        bolts=np.array([0]),
        loose=np.array([[0.25]]),
        means=np.array([[[0.0, -1.0]]]),
        stds=np.array([[[0.1, 0.2]]]),
        kinds=np.array([False]),
        z=np.zeros(1),
    )
    assert found.mean[0] == pytest.approx(-0.25)
    assert found.std[0] == pytest.approx(np.sqrt(0.75 * 0.01 + 0.25 * 0.04 + 0.75 * 0.25))
    assert found.below(-1.0)[0] == pytest.approx(0.125)


def test_neighbours_follow_the_edge() -> None:
    """Not the list of bolts, nor one edge into the next."""
    parameters = Parameterisation((line_group(12),))
    bolts = np.array([[0.01, y, 0.0] for y in (0.9, 0.1, 0.5, 0.3)])
    shapes = bolt_shapes(parameters, bolts)
    assert (shapes.bolts >= 0).all()
    assert neighbours(parameters, bolts, shapes) == [(1, 3), (3, 2), (2, 0)]
    without = replace(shapes, bolts=np.where(np.arange(4) == 3, -1, shapes.bolts))
    assert neighbours(parameters, bolts, without) == [(1, 2), (2, 0)]
