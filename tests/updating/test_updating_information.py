"""What a measurement will tell, against what noisy identifications find, and what must hold for any set of responses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from systems import chain, csc, dense_ports, fe_model, unit

from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.terms import LowRankTerms, ParameterGroup, Parameterisation
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import FrfModel, port_model
from lrbc_cli.updating.posterior.information import (
    FACTOR,
    RANGE_DB,
    Experiment,
    Unknowns,
    bits_of,
    chance,
    distances,
    experiment,
    fading,
    greedy,
    outlook,
    verdict,
)
from lrbc_cli.updating.search.descent import Level
from lrbc_cli.updating.search.optimise import gauss_newton
from lrbc_cli.updating.statistics.decibels import decibel
from lrbc_cli.updating.statistics.residuals import ResidualOptions

BOLTS = 4
LINES = np.arange(20.0, 260.0, 2.0)
TRUTH = np.array([4.6, 4.4, 4.7, 4.5])


def system(units: float = 1.0) -> FeModel:
    """Masses in a row, four of them on springs, and beside them a chain of its own that no spring touches; responses a to d on the first,
    e on the second, hit by a hammer of its own. The vectors of the springs are in other units by a factor."""
    K, M = chain(10, grounded=False)
    own, mass = chain(4)
    K, M = csc(sp.block_diag([K, own])), csc(sp.block_diag([M, mass]))
    springs = csc(units * unit(14, 0, 3, 5, 8))
    return fe_model(
        K, M, loads=unit(14, 9, 12), outputs=unit(14, 1, 4, 6, 9, 11), left=springs, damping=(20.0, 2e-5), output_power=[2, 2, 2, 2, 2]
    )


def model_of(fem: FeModel, units: float = 1.0) -> FrfModel:
    shift = -2.0 * np.log10(units)
    bounds = np.tile([0.0 + shift, 8.0 + shift], (BOLTS, 1))
    group = ParameterGroup(
        name="springs",
        kind="stiffness",
        terms=np.arange(BOLTS),
        parameter=np.arange(BOLTS),
        initial=TRUTH + shift,
        bounds=bounds,
        smoothing=np.eye(BOLTS),
    )
    reference = np.zeros((BOLTS, 3))
    reference[:, 0] = 10.0 ** (TRUTH + shift)
    ports = dense_ports(fem, 2j * np.pi * LINES, reference, input_of=np.array([0, 0, 0, 0, 1]))
    return port_model(ports, Parameterisation((group,)))


def moved(model: FrfModel, theta, change: float):
    """FRFs with one value changed as far as its bounds let it, and by how much."""

    def changed(bolt: int):
        there = theta.copy()
        there[bolt] = np.clip(theta[bolt] + change, *model.parameters.bounds[bolt])
        return model.frf(there), there[bolt] - theta[bolt]

    return changed


def look(units: float = 1.0, std: float = 0.35, sigma: float = 1.0, change: float = -1.5) -> Experiment:
    model = model_of(system(units), units)
    P = model.parameters
    return experiment(
        model,
        P.initial,
        Unknowns(np.eye(BOLTS), np.eye(BOLTS) / std**2, np.arange(BOLTS)),
        moved(model, P.initial, change),
        variance=sigma**2 * FACTOR,
        options=ResidualOptions(),
        quantity=["acceleration"] * 5,
    )


@pytest.fixture(scope="module")
def found() -> Experiment:
    return look()


def restricted(model: FrfModel, responses) -> FrfModel:
    return FrfModel(
        s=model.s,
        parameters=model.parameters,
        values=lambda D: model.values(D)[:, responses],
        linearised=lambda *state: tuple(part[:, responses] for part in model.linearised(*state)),
    )


def test_the_standard_deviation_is_the_scatter_of_identifications():
    """Two hundred noisy measurements, identified; the spread of a standard deviation from so many is 5 %."""
    sigma, std, used = 0.3, 0.5, [0, 2]
    model = restricted(model_of(system()), used)
    P, rng = model.parameters, np.random.default_rng(7)
    y = model.frf(P.initial)
    ends, costs = [], []
    for _ in range(200):
        # The state itself is drawn from the prior too: the posterior's standard deviation is that of the error over both.
        truth = P.initial + 0.02 * rng.normal(size=BOLTS)
        measured = model.frf(truth) * 10.0 ** (sigma * rng.normal(size=y.shape) / 20.0)
        misfit = Misfit(model, measured, P.initial, sigma**2, np.eye(BOLTS) / 0.02)
        found = gauss_newton(Level(misfit, P.initial, np.eye(BOLTS)), np.zeros(BOLTS), P.bounds - P.initial[:, None], tolerance=1e-8)
        ends.append(P.initial + found.theta - truth)
        costs.append(found.status)
    narrow = look(std=0.02, sigma=sigma / np.sqrt(FACTOR))
    expected = outlook(narrow, used, 0.95).std
    assert set(costs) == {"converged"}
    np.testing.assert_allclose(np.std(ends, axis=0), expected, rtol=0.15)
    # Not the prior again: the measurement has removed most of it somewhere.
    assert expected.min() < 0.5 * 0.02 < 0.5 * std


@pytest.mark.parametrize(("change", "close"), [(-0.005, 0.01), (-0.03, 0.1)])
def test_the_distance_is_that_of_the_best_imitation(change, close):
    """Least squares over all other bolts, not linearised, against the slopes over finite changes; on the SoundBox in ``tests/samples``."""
    used = [0, 1, 2]
    found = look(change=change)
    model = restricted(model_of(system()), used)
    P = model.parameters
    linear = distances(found, used)
    for bolt in range(BOLTS):
        moved = P.initial.copy()
        moved[bolt] += change
        misfit = Misfit(model, model.frf(moved), P.initial, FACTOR, np.eye(BOLTS) / 0.35)
        T = np.delete(np.eye(BOLTS), bolt, axis=1)
        bounds = np.delete(P.bounds - P.initial[:, None], bolt, axis=0)
        end = gauss_newton(Level(misfit, P.initial, T), np.zeros(BOLTS - 1), bounds, tolerance=1e-8)
        exact = np.sqrt(end.evaluation.total / FACTOR)
        plain = np.sqrt(np.sum((decibel(model.frf(moved)) - decibel(model.frf(P.initial))) ** 2) / FACTOR)
        assert linear[bolt] == pytest.approx(exact, rel=close)
        assert linear[bolt] <= plain * (1 + 1e-9)


@given(seed=st.integers(0, 2**31))
@settings(max_examples=25, deadline=None)
def test_a_further_response_never_takes_information(seed):
    rng = np.random.default_rng(seed)
    N = K = 5
    R = 6
    rows = [rng.normal(size=(8, K)) * 10.0 ** rng.uniform(-2, 1) for _ in range(R)]
    chords = [A + 0.5 * rng.normal(size=A.shape) for A in rows]
    change = np.full(N, -1.5)
    differences = [[A[:, n] * change[n] for A in chords] for n in range(N)]
    of = Experiment(
        prior=np.diag(rng.uniform(0.1, 10.0, K)),
        columns=np.arange(N),
        change=change,
        tangent=np.array([A.T @ A for A in rows]),
        secant=np.array([A.T @ A for A in chords]),
        product=np.array([[chords[r].T @ d for r, d in enumerate(ds)] for ds in differences]),
        square=np.array([[d @ d for d in ds] for ds in differences]),
    )
    order = rng.permutation(R)
    before = outlook(of, [], 0.95)
    assert np.all(before.distance == 0.0)
    np.testing.assert_allclose(before.removed, 0.0, atol=1e-9)
    for count in range(1, R + 1):
        after = outlook(of, order[:count], 0.95)
        assert np.all(after.std <= before.std * (1 + 1e-9))
        assert np.all(after.distance >= before.distance - 1e-6 * (1 + before.distance))
        assert after.bits >= before.bits - 1e-6
        before = after
    ranked = greedy(of)
    assert sorted(r for r, _ in ranked) == list(range(R))
    gains = [bits_of(d) for _, d in ranked]
    assert gains == sorted(gains)
    assert gains[-1] == pytest.approx(before.bits)


def test_units_of_the_terms_do_not_matter(found):
    other = look(units=30.0)
    for used in ([0], [1, 3], [0, 1, 2, 3]):
        one, two = outlook(found, used, 0.95), outlook(other, used, 0.95)
        for name in ("std", "removed", "distance", "correct"):
            np.testing.assert_allclose(getattr(two, name), getattr(one, name), rtol=1e-6, atol=1e-9)


def test_a_response_that_feels_nothing_ranks_last(found):
    ranked = greedy(found)
    assert ranked[-1][0] == 4
    np.testing.assert_allclose(ranked[-1][1], ranked[-2][1], rtol=1e-9)
    alone = outlook(found, [4], 0.95)
    np.testing.assert_allclose(alone.distance, 0.0, atol=1e-9)
    np.testing.assert_allclose(alone.std, 0.35, rtol=1e-9)
    assert [verdict(value) for value in alone.correct] == ["not detectable"] * BOLTS


def test_values_in_the_noise_of_the_chain_count_nothing():
    y = np.array([[1.0, 1e-10, 0.0, 1e-3], [0.1, 1e-11, 1e-30, 1e-4]], dtype=complex)
    weights = fading(y, ["pressure", "pressure", "pressure", "acceleration"])
    # Beside a pressure a hundred decibels stronger, nothing; the only acceleration is its own measure.
    np.testing.assert_allclose(weights[:, 0], 1.0, rtol=1e-5)
    assert np.all(weights[:, 1] < 1e-4)
    assert np.all(weights[:, 2] < 1e-20)
    np.testing.assert_allclose(weights[:, 3], 1.0, rtol=1e-5)
    # At the floor itself noise and signal are alike.
    edge = fading(np.array([[1.0, 10.0 ** (-RANGE_DB / 20.0)]], dtype=complex), ["pressure"] * 2)
    assert edge[0, 1] == pytest.approx(np.sqrt(0.5))


def test_a_silent_response_is_worth_nothing():
    """A response that is round-off beside the others has wild decibels, and one that is zero has none."""
    model = model_of(system())
    scale = np.array([1.0, 1.0, 1e-14, 0.0, 1.0])

    def slopes(*state):
        y, dy = model.linearised(*state)
        return y * scale, (dy + 1e-3 * np.abs(dy).max()) * np.where(scale > 0, 1.0, 0.0)[:, None]

    noisy = replace(model, values=lambda D: model.values(D) * scale, linearised=slopes)
    P = model.parameters
    of = experiment(
        noisy,
        P.initial,
        Unknowns(np.eye(BOLTS), np.eye(BOLTS), np.arange(BOLTS)),
        moved(noisy, P.initial, -1.5),
        variance=2.0,
        options=ResidualOptions(),
        quantity=["acceleration"] * 5,
    )
    assert np.isfinite(of.tangent).all()
    assert np.isfinite(of.square).all()
    assert bits_of(distances(of, [3])) == 0.0
    assert bits_of(distances(of, [2])) < 1e-3 < bits_of(distances(of, [0]))


def test_bounds_stop_a_change(found):
    stuck = look()
    model = model_of(system())
    P = model.parameters
    theta = P.initial.copy()
    theta[1] = P.bounds[1, 0]
    theta[2] = P.bounds[2, 0] + 0.5
    of = experiment(
        model,
        theta,
        Unknowns(np.eye(BOLTS), stuck.prior, np.array([0, 1, 2, -1])),
        moved(model, theta, -1.5),
        variance=2.0,
        options=ResidualOptions(),
        quantity=["acceleration"] * 5,
    )
    np.testing.assert_allclose(of.change, [-1.5, 0.0, -0.5, 0.0])
    seen = outlook(of, [0, 1, 2, 3], 0.95)
    assert seen.distance[1] == 0.0
    assert seen.distance[3] == 0.0
    assert np.isnan(seen.std[3])
    assert found.change == pytest.approx(-1.5)


def test_the_chance_is_that_of_the_likelihood_ratio():
    """Counted: differences of many noisy lines, decided by the posterior odds of changed against unchanged."""
    rng = np.random.default_rng(3)
    d = rng.normal(size=40)
    d *= 3.0 / np.linalg.norm(d)
    noise = rng.normal(size=(200_000, 40))
    for truth in (0.0, 1.0):
        ratio = (truth * d + noise) @ d - 0.5 * d @ d
        odds = np.log(0.95 / 0.05)
        share = np.mean(ratio >= odds) if truth else np.mean(ratio <= -odds)
        assert share == pytest.approx(float(chance(np.array(3.0), 0.95)), abs=0.005)


def test_terms_of_the_system_are_springs():
    """The helper is what it says: the terms touch one chain only."""
    terms = system().terms
    assert isinstance(terms, LowRankTerms)
    assert not terms.left[10:].nnz
