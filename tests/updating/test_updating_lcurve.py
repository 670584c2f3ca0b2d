"""The weight of the penalty from the L-curve: known corners, no corner, and the real thing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pads import PADS, S, loosened, pads_model, pads_ports
from systems import direct_frf

from lrbc_cli.updating.misfit.cost import Misfit, penalty_rows
from lrbc_cli.updating.misfit.frf import port_model
from lrbc_cli.updating.search.lcurve import curvature, find_corner, l_curve, natural_weight

ETAS = np.logspace(-3.0, 3.0, 9)


def tikhonov(eta, *, noise=1e-2, decay=0.5, size=40, seed=0, scale=1.0):
    """Data and penalty sums of squares of ``min |A x - b|² + eta |x|²`` in closed form, A with falling singular values."""
    rng = np.random.default_rng(seed)
    sigma = scale * 10.0 ** (-decay * np.arange(size) / 4.0)
    exact = 1.0 / (1.0 + np.arange(size))
    b = sigma * exact + scale * noise * rng.normal(size=size)
    outside = scale * noise * np.sqrt(10.0)
    eta = np.asarray(eta)[:, None]
    data = ((eta / (sigma**2 + eta) * b) ** 2).sum(axis=1) + outside**2
    penalty = ((sigma / (sigma**2 + eta) * b) ** 2).sum(axis=1)
    return data, penalty


def dense_corner(**options):
    """log10 of the weight where the curvature of the closed form is largest (Hansen's formula, finite differences of 2000 weights)."""
    t = np.linspace(-7.0, 3.0, 2000)
    x, y = (np.log10(values) for values in tikhonov(10.0**t, **options))
    dx, dy = np.gradient(x, t), np.gradient(y, t)
    kappa = (dx * np.gradient(dy, t) - dy * np.gradient(dx, t)) / np.hypot(dx, dy) ** 3
    return t[20:-20][kappa[20:-20].argmax()]


class TestCorner:
    @pytest.mark.parametrize("noise", [3e-3, 1e-2, 3e-2])
    @pytest.mark.parametrize("seed", range(3))
    def test_of_tikhonov(self, noise, seed):
        """Nine weights find the corner of the closed form within a step."""
        expected = dense_corner(noise=noise, seed=seed)
        eta = np.logspace(-6.0, 0.0, 9)
        found = find_corner(eta, *tikhonov(eta, noise=noise, seed=seed))
        assert found is not None
        assert abs(np.log10(found.eta) - expected) < 0.75
        assert found.index == np.abs(np.log10(eta) - np.log10(found.eta)).argmin()
        assert 0 < found.index < 8

    def test_units_do_not_matter(self):
        eta = np.logspace(-6.0, 0.0, 9)
        data, penalty = tikhonov(eta)
        plain, scaled = find_corner(eta, data, penalty), find_corner(100.0 * eta, 1e3 * data, 10.0 * penalty)
        assert plain is not None
        assert scaled is not None
        assert scaled.eta == pytest.approx(100.0 * plain.eta)
        assert (scaled.data, scaled.penalty) == pytest.approx((1e3 * plain.data, 10.0 * plain.penalty))

    def test_a_right_angle(self):
        """Down, then right."""
        x = np.array([0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0])
        y = np.array([4, 3.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        found = find_corner(ETAS, 10.0**x, 10.0**y)
        assert found is not None
        assert found.index == 4
        # The same curve run through the other way bends to the other side.
        assert find_corner(ETAS, 10.0 ** x[::-1], 10.0 ** y[::-1]) is None

    @pytest.mark.parametrize(
        ("x", "y"),
        [
            pytest.param(np.linspace(0, 3, 9), np.linspace(3, 0, 9), id="straight"),
            pytest.param(np.zeros(9), np.linspace(3, 0, 9), id="data do not change"),
            pytest.param(np.linspace(0, 3, 9), np.zeros(9), id="penalty does not change"),
            pytest.param(np.zeros(9), np.zeros(9), id="a point"),
            pytest.param(4 - 4 * np.cos(np.linspace(0.2, 1.3, 9)), 4 - 4 * np.sin(np.linspace(0.2, 1.3, 9)), id="wide circle"),
            pytest.param(np.sin(np.linspace(0, 1.5, 9)), np.cos(np.linspace(0, 1.5, 9)), id="bent outwards"),
        ],
    )
    def test_no_corner(self, x, y):
        assert find_corner(ETAS, 10.0**x, 10.0**y) is None

    def test_nothing_is_left_over(self):
        assert find_corner(ETAS, np.zeros(9), np.ones(9)) is None
        assert find_corner(ETAS, np.ones(9), np.zeros(9)) is None

    @settings(max_examples=60)
    @given(st.integers(0, 10_000))
    def test_the_stop_rule_makes_no_corner(self, seed):
        """A per mille on a straight line."""
        rng = np.random.default_rng(seed)
        x, y = np.linspace(0, 0.3, 9), np.linspace(3, 0, 9)
        x, y = (values + 4e-4 * rng.uniform(-1, 1, size=9) for values in (x, y))
        assert find_corner(ETAS, 10.0**x, 10.0**y) is None

    @pytest.mark.parametrize("radius", [0.5, 2.0])
    def test_curvature_of_a_circle(self, radius):
        """In 1/decade, away from the ends of the quarter."""
        angle = np.linspace(np.pi, 1.5 * np.pi, 9)
        _, kappa = curvature(ETAS, 10.0 ** (radius * np.cos(angle)), 10.0 ** (radius * np.sin(angle)))
        middle = kappa[kappa.size // 2]
        assert middle == pytest.approx(1.0 / radius, rel=0.15)
        assert (middle > 1.0) == (radius < 1.0)


def problem(noise_db=1.0, eta=1.0):
    model, parameters = pads_model()
    truth = loosened(parameters, at=(4, 5, 6))
    y = direct_frf(model, S, parameters.dynamic(truth, S))
    y = y * 10.0 ** (np.random.default_rng(0).normal(scale=noise_db, size=y.shape) / 20)
    return Misfit(port_model(pads_ports(model), parameters), y, parameters.initial, eta), parameters, truth


class TestCurve:
    def test_natural_weight(self):
        misfit, parameters, _ = problem()
        assert natural_weight(misfit, parameters.initial) == pytest.approx(4 * S.size / PADS)
        rows = penalty_rows(parameters, 4.0)
        four = Misfit(misfit.model, 10.0 ** (misfit.target / 20), misfit.prior, 1.0, rows)
        assert natural_weight(four, parameters.initial) == pytest.approx(S.size / PADS)

    def test_it_is_one(self):
        """A larger weight leaves more of the data and less of the departures, and a corner stands where both are small."""
        misfit, parameters, _ = problem()
        curve = l_curve(misfit, parameters.initial, parameters.bounds, 0.04)
        np.testing.assert_allclose(curve.eta, natural_weight(misfit, parameters.initial) * np.logspace(-3, 3, 9))
        assert np.all(np.diff(curve.data) > -2e-3 * curve.data[:-1])
        # With next to no penalty the departures creep on below the stop rule.
        assert np.all(np.diff(curve.penalty[1:]) < 2e-3 * curve.penalty[1:-1])
        assert curve.corner is not None
        assert curve.chosen == curve.corner.eta
        assert curve.eta[0] < curve.chosen < curve.eta[-1]
        for i, eta in enumerate(curve.eta):
            value = misfit.with_eta(float(eta))(curve.theta[i])
            assert value.total == pytest.approx(curve.data[i] + eta * curve.penalty[i], rel=1e-10)

    @pytest.mark.slow
    def test_the_weight_of_the_misfit_does_not_matter(self):
        curves = [l_curve(problem(eta=eta)[0], problem()[1].initial, problem()[1].bounds, 0.04) for eta in (0.0, 50.0)]
        np.testing.assert_array_equal(curves[0].data, curves[1].data)

    def test_evaluations_are_counted(self):
        misfit, parameters, _ = problem()
        calls = []
        inner = misfit.model.sensitivities
        object.__setattr__(misfit.model, "sensitivities", lambda *args: (calls.append(1), inner(*args))[1])
        assert l_curve(misfit, parameters.initial, parameters.bounds, 0.04).evaluations == len(calls)

    def test_without_a_corner_the_fallback_is_taken(self):
        """A measurement of the start state itself: nothing to gain by any departure."""
        model, parameters = pads_model()
        y = direct_frf(model, S, parameters.dynamic(parameters.initial, S))
        y = y * 10.0 ** (np.random.default_rng(0).normal(scale=1.0, size=y.shape) / 20)
        misfit = Misfit(port_model(pads_ports(model), parameters), y, parameters.initial, 1.0)
        curve = l_curve(misfit, parameters.initial, parameters.bounds, 0.3)
        assert curve.corner is None
        assert curve.chosen == 0.3
        assert np.any(np.all(curve.theta == curve.nearest, axis=1))
