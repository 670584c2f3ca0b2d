"""Kinds of joints whose loss the data feel less and less: against integration on a grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import expit, logsumexp
from scipy.stats import norm

from lrbc_cli.updating.posterior import sampling
from lrbc_cli.updating.posterior.mixture import MixtureProblem, State, settle
from lrbc_cli.updating.posterior.sampling import about_itself, beyond, profile, sample_changes
from lrbc_cli.updating.statistics.priors import BoltPrior

PRIOR = BoltPrior()
ROWS = 30


def response(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a spring in series with a stiffer structure gives: free below minus one and a half decades, and its slope."""
    k = 10.0**z
    return k / (k + 0.2), np.log(10.0) * 0.2 * k / (k + 0.2) ** 2


class Saturating:
    """Two joints, ``r = J (g(z) - g(truth)) + noise``."""

    def __init__(self, truth: tuple[float, float], strength: float, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.J = strength * rng.normal(size=(ROWS, 2)) / np.sqrt(ROWS)
        self.r0 = rng.normal(size=ROWS) - self.J @ response(np.array(truth))[0]

    def data(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        g, slope = response(z)
        return self.r0 + self.J @ g, self.J * slope

    def problem(self) -> MixtureProblem:
        one = np.ones(2)
        return MixtureProblem(
            data=self.data,
            variance=1.0,
            bounds=np.tile([-4.0, 2.0], (2, 1)),
            bolts=np.arange(2),
            neighbours=[(0, 1)],
            joint=np.ones(2, dtype=bool),
            mean=0 * one,
            std=one,
        )

    def exact(self, limit: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Inclusion, probability below a limit and mean, by sums over both kinds on a grid."""
        t = np.linspace(-4.0, 1.0, 501)
        g = response(t)[0]
        r = self.r0[:, None] + self.J[:, [0]] * g
        a, b, c = np.sum(r**2, axis=0), 2.0 * (r.T @ self.J[:, 1]), float(self.J[:, 1] @ self.J[:, 1])
        log = -0.5 * (a[:, None] + b[:, None] * g + c * g**2)
        kinds = [
            norm.logpdf(t, 0.0, PRIOR.joint_tight_std) + np.log(1.0 - PRIOR.loose_share),
            norm.logpdf(t, PRIOR.joint_loose_mean, PRIOR.joint_loose_std) + np.log(PRIOR.loose_share),
        ]
        weights = np.array([[log + p[:, None] + q for q in kinds] for p in kinds])
        weights = np.exp(weights - logsumexp(weights))
        inclusion = np.array([weights[1].sum(), weights[:, 1].sum()])
        marginals = np.array([weights.sum(axis=(0, 1, 3)), weights.sum(axis=(0, 1, 2))])
        return inclusion, marginals[:, t < limit].sum(axis=1), marginals @ t


def one_joint(data: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]) -> tuple[MixtureProblem, float]:
    """The problem of a single joint, and its exact log likelihood ratio of loose against tight, by sums over a grid."""
    one = np.ones(1)
    problem = replace(
        Saturating((0.0, 0.0), 1.0).problem(), data=data, bounds=np.array([[-4.0, 2.0]]), bolts=np.arange(1), neighbours=[],
        joint=one > 0.0, mean=0.0 * one, std=one,
    )  # fmt: skip
    t = np.linspace(-4.0, 1.0, 2001)
    fits = np.array([-0.5 * float(np.sum(data(np.array([change]))[0] ** 2)) for change in t])
    tight, loose = (0.0, PRIOR.joint_tight_std), (PRIOR.joint_loose_mean, PRIOR.joint_loose_std)
    return problem, float(logsumexp(fits + norm.logpdf(t, *loose)) - logsumexp(fits + norm.logpdf(t, *tight)))


@pytest.mark.parametrize("truth", [(-2.5, 0.0), (-3.0, -2.0), (-1.3, 0.05), (0.0, 0.0)])
@pytest.mark.parametrize("start", [0.0, -2.0])
def test_a_free_joint_is_loose_however_flat_the_data_are_there(truth: tuple[float, float], start: float) -> None:
    toy = Saturating(truth, 14.0)
    found = sample_changes(toy.problem(), [np.full(2, start)], PRIOR, sweeps=250)
    inclusion, below, mean = toy.exact(-0.35)
    np.testing.assert_allclose(found.inclusion, inclusion, atol=0.03)
    np.testing.assert_allclose(found.below(-0.35), below, atol=0.05)
    np.testing.assert_allclose(found.mean, mean, atol=0.15)


@pytest.mark.parametrize("strength", [0.0, 1.0, 2.0, 3.0])
def test_data_against_a_small_loss_say_nothing_on_a_large_one(strength: float) -> None:
    """A resonance that passes a line: a part of the loss shows far more than all of it, which the linear problem excludes."""
    width, start = 0.3, np.zeros(1)

    def data(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lost, left = -z[0] / width, 10.0 ** z[0]
        passing = 40.0 * np.exp(-(lost**2))
        r = np.array([passing * lost, -strength * left])
        return r, np.array([[-passing * (1.0 - 2.0 * lost**2) / width], [-strength * np.log(10.0) * left]])

    problem, ratio = one_joint(data)
    exact = expit(ratio + PRIOR.log_odds)
    assert exact > 0.6
    assert sample_changes(problem, [start], PRIOR, sweeps=50).inclusion[0] == pytest.approx(exact, abs=0.03)


@pytest.mark.parametrize(("rows", "calls"), [(1, 0.5), (3, 0.9), (60, 1.0)])
def test_a_loss_that_few_bands_show_is_weighed_by_its_significance(rows: int, calls: float) -> None:
    """All that is missing in 1, 3 or 60 of 60 bands a loss explains, of the same log likelihood ratio together; the others are at rest."""
    n, change = 60, PRIOR.joint_loose_mean
    J = np.zeros(n)
    J[:rows] = np.sqrt(2.0 * 40.0 / rows) / -change

    def data(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return J * (z[0] - change), J[:, None]

    problem, ratio = one_joint(data)
    assert ratio > 20.0
    asked = [replace(problem, cells=cells) for cells in (None, np.arange(n))]
    without, found = (sample_changes(one, [np.zeros(1)], PRIOR, sweeps=50).inclusion[0] for one in asked)
    assert without > 0.9999
    # z is the root of the number of bands that say it.
    assert found == pytest.approx(expit(min(0.5 * rows, ratio) + PRIOR.log_odds), abs=0.03)
    assert found <= calls


@pytest.mark.parametrize(("change", "found"), [(-1.2, 0.85), (-0.25, 0.0)])
def test_a_tight_joint_is_no_looser_than_tight_joints_are(change: float, found: float) -> None:
    """Half of the loss contradicts residuals that are no noise little more than all of it: with that, a decade lost was called unlikely.

    The tight kind ends at half of ``change``. Against that, all of it counts z = 1.9; against what 97.5 % of tight joints keep, 2.8.
    """
    n, bands = 60, np.tile([1.0, -1.0], 30)
    J = np.full(n, PRIOR.joint_tight_std**-1.0 / np.sqrt(n))

    def data(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return J * (z[0] - change) + bands, J[:, None]

    problem, ratio = one_joint(data)
    told = sample_changes(replace(problem, cells=np.arange(n)), [np.zeros(1)], PRIOR, sweeps=50).inclusion[0]
    assert bool(ratio > 10.0) is (found > 0.5)
    assert told == pytest.approx(found, abs=0.03)


@pytest.mark.parametrize("soon", [0.1, 0.3, 1.0])
@pytest.mark.parametrize(("strength", "shown"), [(4.5, 0.6), (6.0, 0.5), (6.0, 0.6), (8.0, 0.6)])
def test_a_loss_that_soon_shows_no_more_is_weighed_as_a_whole(soon: float, strength: float, shown: float) -> None:
    """A support beside stiffer ones: the data show a part of what a free one does, between none and all of it, and exclude neither well."""

    def data(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lost = 10.0 ** -min(z[0], 0.0) - 1.0
        slope = -np.log(10.0) * (lost + 1.0) * soon / (lost + soon) ** 2
        effect = lost / (lost + soon) + slope * max(z[0], 0.0)
        return np.array([strength * (effect - shown), 0.0]), np.array([[strength * slope], [0.0]])

    problem, ratio = one_joint(data)
    found = sample_changes(problem, [np.zeros(1)], PRIOR, sweeps=50)
    # Within a third of a nat; up to two thirds more where the tight kind is no Gaussian either.
    assert -0.35 < found.ratios[0] - ratio < 0.65


def test_the_determinant_of_the_errors_of_a_change_does_not_excuse_a_loose_joint() -> None:
    """The covariance grows with any change, which its determinant counts by far more than the data tell: a loose joint is loose anyway."""
    toy = Saturating((-1.5, 0.0), 30.0)
    plain = toy.problem()

    def about(z: np.ndarray) -> tuple[Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], float]:
        return toy.data, -80.0 * float((z < -1.1).sum())

    follows, none = replace(plain, about=about), np.zeros(2, dtype=bool)
    tight, loose = (
        settle(follows, PRIOR, np.array([kind, False]), np.array([change, 0.0]), (1e-6, 20))
        for kind, change in ((False, 0.0), (True, -1.5))
    )
    assert loose.evidence < tight.evidence - 50.0
    found = [beyond(problem, PRIOR, settle(problem, PRIOR, none, np.zeros(2), (1e-6, 20))) for problem in (plain, follows)]
    for state, more in found:
        assert state.kinds.tolist() == [True, False]
        np.testing.assert_allclose(more.further, found[0][1].further, atol=1e-6)


def test_joints_whose_kind_another_search_changed_are_weighed_by_descents() -> None:
    """Also if the linear problem about the tight state excludes them."""
    toy = Saturating((0.0, 0.0), 30.0)
    problem, none = toy.problem(), np.zeros(2, dtype=bool)
    state = settle(problem, PRIOR, none, np.zeros(2), (1e-6, 20))
    for suspects in ((), (1,)):
        _, found = beyond(problem, PRIOR, state, suspects=suspects)
        assert (found.further != 0.0).tolist() == [False, bool(suspects)]


def test_data_that_say_little_leave_it_open() -> None:
    toy = Saturating((-2.5, 0.0), 6.5)
    found = sample_changes(toy.problem(), [np.zeros(2)], PRIOR, sweeps=250)
    inclusion, below, _ = toy.exact(-0.35)
    assert 0.1 < inclusion[0] < 0.9
    np.testing.assert_allclose(found.inclusion, inclusion, atol=0.08)
    np.testing.assert_allclose(found.below(-0.35), below, atol=0.08)


def test_the_error_that_all_resonances_share_widens_what_joints_lost_and_nothing_else() -> None:
    problem, starts = Saturating((-1.3, 0.0), 40.0).problem(), [np.array([-1.3, 0.0])]
    data = sample_changes(problem, starts, PRIOR, sweeps=50)
    shared = sample_changes(replace(problem, shared=0.12), starts, PRIOR, sweeps=50)
    np.testing.assert_array_equal(shared.mean, data.mean)
    np.testing.assert_allclose(shared.std, np.hypot(data.std, 0.12 * np.abs(data.mean)), rtol=0.02)
    assert data.std[0] < 0.1 < 0.14 < shared.std[0]
    hats = sample_changes(replace(problem, shared=0.12, joint=np.zeros(2, dtype=bool)), starts, PRIOR, sweeps=50)
    plain = sample_changes(replace(problem, joint=np.zeros(2, dtype=bool)), starts, PRIOR, sweeps=50)
    np.testing.assert_array_equal(hats.std, plain.std)


def test_errors_beyond_the_residuals_widen_what_the_data_tell_and_not_the_prior() -> None:
    starts = [np.array([-1.3, 0.0])]
    told = Saturating((-1.3, 0.0), 400.0).problem()
    data, wider = (sample_changes(replace(told, ratio=r), starts, PRIOR, sweeps=50) for r in (1.0, 3.0))
    np.testing.assert_array_equal(wider.mean, data.mean)
    np.testing.assert_array_equal(wider.inclusion, data.inclusion)
    np.testing.assert_allclose(wider.std, 3.0 * data.std, rtol=0.02)
    untold = Saturating((0.0, 0.0), 1e-3).problem()
    data, wider = (sample_changes(replace(untold, ratio=r), starts, PRIOR, sweeps=50) for r in (1.0, 3.0))
    # A profile that ends at no change is a little narrower than its prior.
    np.testing.assert_allclose(wider.std, data.std, rtol=0.12)


@pytest.mark.parametrize("seed", range(4))
def test_a_joint_that_no_data_feel_keeps_its_prior(seed: int) -> None:
    """Though the evidence moves by nats with each descent, as it does where the covariance follows the state: that tells of no joint."""
    rng = np.random.default_rng(seed)
    J = np.column_stack([np.zeros(ROWS), 5.0 * rng.normal(size=ROWS)])
    r0 = rng.normal(size=ROWS) - J @ np.array([0.0, -0.2])

    def data(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return r0 + J @ z, J

    def about(z: np.ndarray):
        return data, 3.0 * float(np.sin(1e9 * z[1]))

    problem = replace(Saturating((0.0, 0.0), 1.0).problem(), data=data, about=about)
    found = sample_changes(problem, [np.array([0.0, -0.2])], PRIOR, sweeps=50)
    # The profile ends at no change, a little above which its prior reaches.
    assert found.inclusion[0] == pytest.approx(PRIOR.loose_share, abs=0.005)
    assert found.inclusion[1] < 0.3


@pytest.mark.parametrize("bound", [-4.0, -2.0, -1.0, -0.5])
def test_what_the_prior_has_beyond_the_free_limit_counts_as_loose(bound: float) -> None:
    """A joint that no data feel keeps its prior, however near its lower bound lies."""
    problem = replace(Saturating((0.0, 0.0), 1e-6).problem(), bounds=np.tile([bound, 2.0], (2, 1)))
    found = sample_changes(problem, [np.zeros(2)], PRIOR, sweeps=50)
    np.testing.assert_allclose(found.inclusion, PRIOR.loose_share, atol=0.005)
    assert np.all(found.means[:, :, 1] > bound)


def test_a_profile_ends_where_nothing_is_left() -> None:
    """Of a change that the data tell, values far away cost descents and say nothing."""
    toy = Saturating((-0.8, 0.0), 40.0)
    stops, calls, found = ((1e-3, 5), (1e-2, 3)), list[int](), list[tuple[float, float, float]]()

    def data(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls[-1] += 1
        return toy.data(z)

    problem = replace(toy.problem(), data=data)
    calls.append(0)
    state = settle(problem, PRIOR, np.array([True, False]), np.array([-0.8, 0.0]), stops[0])
    for negligible in (np.inf, 10.0):
        calls.append(0)
        found.append(profile(PRIOR, *about_itself(problem, PRIOR, state, stops[0]), 0, stops[1], 0.06, negligible=negligible))
    np.testing.assert_allclose(found[1], found[0], atol=0.01)
    assert calls[2] < 0.7 * calls[1]


def test_a_settled_joint_is_looked_at_again_where_the_state_has_gained_as_much(monkeypatch: pytest.MonkeyPatch):
    """Joint 0 is tight by 35 nats beside a tight joint 1, and loose by 20 beside a loose one, as which joint 1 gains 20."""
    evidence = {(): 0.0, (0,): -35.0, (1,): 20.0, (0, 1): 40.0}

    def settled(problem, prior, kinds, z, stop, **_):
        return State(kinds=kinds, z=z, evidence=evidence[tuple(np.flatnonzero(kinds).tolist())], A=np.eye(2), b=np.zeros(2))

    monkeypatch.setattr(sampling, "settle", settled)
    problem = replace(Saturating((0.0, 0.0), 1.0).problem(), bounds=np.zeros((2, 2)))
    state, found = beyond(problem, PRIOR, settled(problem, PRIOR, np.zeros(2, dtype=bool), np.zeros(2), (1e-3, 5)), doubt=-np.inf)
    assert state.kinds.tolist() == [True, True]
    assert np.all(np.isfinite(found.further))
