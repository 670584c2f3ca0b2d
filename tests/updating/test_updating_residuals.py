"""Residuals of other kinds, the loss against wild lines, the floor and the weights."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from derivatives import check_derivative
from hypothesis import given
from hypothesis import strategies as st
from pads import PADS, THIRDS, S, loosened, pads_dynamic, pads_model, pads_ports
from systems import direct_frf

from lrbc_cli.errors import ConfigError
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import port_model, reduced_model
from lrbc_cli.updating.search.optimise import gauss_newton
from lrbc_cli.updating.statistics.decibels import DB, coherence_sigma, decibel, noise_weights
from lrbc_cli.updating.statistics.error_model import ERRORS
from lrbc_cli.updating.statistics.losses import Loss, Soft
from lrbc_cli.updating.statistics.residuals import DataResidual, ResidualOptions

ROWS = np.array([0, 2, 3])
KINDS = ("db", "log-complex")
CASES = [
    ResidualOptions(kind=kind, loss_scale=loss, floor=floor) for kind, loss, floor in itertools.product(KINDS, (None, 2.0), (None, 20.0))
]


def case_name(options):
    return f"{options.kind}-{'soft' if options.loss_scale else 'squares'}-{'floor' if options.floor else 'bare'}"


def state(at=(4, 5, 6), rows=ROWS):
    model, parameters = pads_model(THIRDS, extras=True)
    y = direct_frf(model, S, parameters.dynamic(loosened(parameters, at=at), S))[:, rows]
    y[3, 0] = y[17, 1] = np.nan
    y[40, 2] = 0.0
    return model, parameters, y


def misfit_of(options, *, eta=0.04, sigma=None, measured=None, formula="port"):
    model, parameters, own = state()
    measured = own if measured is None else measured
    by = (
        port_model(pads_ports(model).select(np.arange(S.size), ROWS), parameters)
        if formula == "port"
        else reduced_model(pads_dynamic(model), S, parameters, ROWS)
    )
    return Misfit(by, measured, parameters.initial, eta, options=options, sigma=sigma)


def wavy(parameters, seed=2):
    theta = parameters.initial + np.random.default_rng(seed).uniform(-1.2, 0.2, size=parameters.size)
    theta[parameters.is_damping] = 0.7
    return theta


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("options", CASES, ids=case_name)
class TestTaylor:
    def sigma(self, weighted):
        return np.random.default_rng(7).uniform(0.2, 2.0, size=(S.size, ROWS.size)) if weighted else None

    def test_cost(self, options, weighted):
        misfit = misfit_of(options, sigma=self.sigma(weighted))
        theta = wavy(misfit.model.parameters)
        direction = np.random.default_rng(14).normal(size=theta.size)
        # The smallest steps would not cross a wrapped phase: the measurement lies in general position.
        check_derivative(lambda t: misfit(t).cost, misfit(theta).gradient, theta, direction / np.linalg.norm(direction), first=0.01)

    def test_residuals(self, options, weighted):
        misfit = misfit_of(options, sigma=self.sigma(weighted))
        theta = misfit.model.parameters.initial + 0.02 * np.random.default_rng(5).normal(size=misfit.model.parameters.size)
        # About a state of the model itself no phase is near the wrap.
        measured = misfit.model.frf(misfit.model.parameters.initial)
        near = misfit_of(options, sigma=self.sigma(weighted), measured=measured)
        direction = np.random.default_rng(3).normal(size=theta.size)
        check_derivative(lambda t: near(t).residual, near(theta).jacobian, theta, direction / np.linalg.norm(direction), first=0.01)


@pytest.mark.parametrize("options", CASES, ids=case_name)
class TestEvery:
    def test_nothing_at_the_true_state(self, options):
        misfit = misfit_of(options, eta=0.0)
        value = misfit(loosened(misfit.model.parameters))
        assert np.abs(value.residual).max() < 1e-5
        assert value.misfit_db < 1e-6

    def test_the_reported_misfit_is_plain(self, options):
        theta = wavy(pads_model(THIRDS, extras=True)[1])
        sigma = np.full((S.size, ROWS.size), 0.3)
        assert misfit_of(options, sigma=sigma)(theta).misfit_db == misfit_of(ResidualOptions())(theta).misfit_db

    def test_data_and_rows(self, options):
        misfit = misfit_of(options, eta=0.3)
        theta = wavy(misfit.model.parameters)
        value = misfit(theta)
        lines = (3 * S.size - 3) * (1 if options.kind == "db" else 2)
        assert value.residual.dtype == value.jacobian.dtype == float
        assert value.residual.shape == (lines + PADS + 2,)
        assert value.data == pytest.approx(float(value.residual[:lines] @ value.residual[:lines]), rel=1e-13)
        assert value.total == pytest.approx(value.data + 0.3 * misfit.departures(theta), rel=1e-12)

    def test_both_formulas_agree(self, options):
        theta = wavy(pads_model(THIRDS, extras=True)[1])
        a, b = misfit_of(options)(theta), misfit_of(options, formula="reduced")(theta)
        np.testing.assert_allclose(a.residual, b.residual, atol=1e-6 * np.abs(b.residual).max())
        np.testing.assert_allclose(a.jacobian, b.jacobian, atol=1e-6 * np.abs(b.jacobian).max())

    def test_a_line_that_was_not_measured_does_not_count(self, options):
        misfit = misfit_of(options)
        other = state()[2]
        other[3, 0] = np.inf
        other[40, 2] = np.nan
        theta = wavy(misfit.model.parameters)
        np.testing.assert_array_equal(misfit_of(options, measured=other)(theta).residual, misfit(theta).residual)

    def test_another_weight_of_the_penalty(self, options):
        misfit = misfit_of(options, eta=0.3)
        theta = wavy(misfit.model.parameters)
        other = misfit.with_eta(2.0)
        assert other(theta).total == pytest.approx(misfit_of(options, eta=2.0)(theta).total, rel=1e-14)
        assert misfit.eta == 0.3

    def test_a_known_state_is_found(self, options):
        """From near: differences of the FRFs themselves have many minima."""
        misfit = misfit_of(options, eta=0.0)
        parameters = misfit.model.parameters
        truth = loosened(parameters)
        start = truth + 0.02 * np.random.default_rng(4).normal(size=truth.size)
        solution = gauss_newton(misfit, start, parameters.bounds, tolerance=1e-10, max_iterations=200)
        assert misfit(start).misfit_db > 0.05
        assert solution.evaluation.misfit_db < 1e-3
        found, expected = (np.log10(parameters.scales(theta)) for theta in (solution.theta, truth))
        np.testing.assert_allclose(found[4:7], expected[4:7], atol=0.02)


class TestDefinitions:
    def residual(self, y, m, **options):
        data = DataResidual(np.atleast_2d(m).T, ResidualOptions(**options))
        return data(np.atleast_2d(y).T, np.zeros((np.size(y), 1, 1), dtype=complex))[0]

    def test_log_complex_is_decibels_and_phase(self):
        y, m = np.array([2.0, 1j, -0.5 + 0.1j]), np.array([1.0, 1.0, -0.5 - 0.1j])
        found = self.residual(y, m, kind="log-complex")
        np.testing.assert_allclose(found[:3], decibel(y) - decibel(m), atol=1e-12)
        np.testing.assert_allclose(found[3:], DB * np.array([0.0, np.pi / 2, -2 * np.arctan(0.2)]), atol=1e-12)

    @given(st.floats(-20.0, 20.0))
    def test_the_phase_is_wrapped(self, angle):
        found = self.residual(np.exp([1j * angle]), np.array([1.0]), kind="log-complex")
        assert abs(found[1]) <= DB * np.pi * (1 + 1e-12)
        assert np.exp(1j * found[1] / DB) == pytest.approx(np.exp(1j * angle), abs=1e-9)

    @given(st.floats(-60.0, 60.0), st.floats(-100.0, 0.0), st.floats(5.0, 60.0))
    def test_the_floor_only_fades(self, difference, level, floor):
        """Never more than the plain difference, of the same sign; nearly the same well above the floor."""
        m = np.array([1.0, 10.0 ** (level / 20)])
        y = m * np.array([1.0, 10.0 ** (difference / 20)])
        found = self.residual(y, m, floor=floor)[1]
        assert abs(found) <= abs(difference) + 1e-9
        assert found * difference >= 0
        if min(level, level + difference) > 30.0 - floor:
            assert found == pytest.approx(difference, rel=5e-3, abs=1e-9)
        if max(level, level + difference) < -floor - 30.0:
            assert abs(found) < 0.01

    def test_the_floor_belongs_to_each_response(self):
        m = np.array([[1.0, 1e-3], [1e-2, 1e-5]])
        y = m * np.array([[1.0, 1.0], [10.0, 10.0]])
        found = DataResidual(m, ResidualOptions(floor=30.0))(y, np.zeros((2, 2, 1)))[0].reshape(2, 2)
        assert found[1, 0] == pytest.approx(found[1, 1])
        assert 0.5 < found[1, 0] < 15.0

    def test_the_phase_fades_below_the_floor(self):
        m = np.array([1.0, 1e-4])
        found = self.residual(m * 1j, m, kind="log-complex", floor=30.0)
        assert found[2] == pytest.approx(DB * np.pi / 2, rel=2e-3)
        assert abs(found[3]) < 1e-3


class TestSoft:
    @given(st.floats(-1e4, 1e4), st.floats(0.1, 30.0))
    def test_it_is_the_root_of_pseudo_huber(self, r, scale):
        q, slope = Soft(scale=scale)(np.array([r]), np.ones((1, 1)))
        # 2 a² (sqrt(1 + x²) - 1) without its cancellation.
        loss = 2 * r**2 / (np.sqrt(1 + (r / scale) ** 2) + 1)
        assert q[0] ** 2 == pytest.approx(loss, rel=1e-10, abs=1e-300)
        assert q[0] * r >= 0
        assert 0 < slope[0, 0] <= 1 + 1e-12

    def test_small_differences_stay_and_large_ones_grow_as_a_root(self):
        q, _ = Soft(scale=2.0)(np.array([1e-3, 1e6, 4e6]), np.ones((3, 1)))
        assert q[0] == pytest.approx(1e-3, rel=1e-6)
        assert q[2] / q[1] == pytest.approx(2.0, rel=1e-3)

    @given(st.complex_numbers(max_magnitude=1e3), st.floats(0.1, 30.0))
    def test_a_complex_difference_keeps_its_direction(self, r, scale):
        q = Soft(scale=scale)(np.array([r]), np.zeros((1, 1), dtype=complex))[0][0]
        assert abs(q) == pytest.approx(abs(Soft(scale=scale)(np.array([abs(r)]), np.zeros((1, 1)))[0][0]), rel=1e-9, abs=1e-12)
        assert abs((q * np.conj(r)).imag) <= 1e-9 * abs(q) * abs(r) + 1e-12

    @pytest.mark.parametrize("kind", KINDS)
    def test_a_wild_line_moves_the_minimum_less(self, kind):
        """Three lines off by 30 dB."""
        _, parameters, measured = state()
        truth = loosened(parameters)
        for line in (10, 25, 50):
            measured[line] *= 10.0**1.5
        error = {}
        for loss in (None, 1.0):
            misfit = misfit_of(ResidualOptions(kind=kind, loss_scale=loss), eta=1e-4, measured=measured)
            found = gauss_newton(misfit, truth, parameters.bounds, max_iterations=60).theta
            error[loss] = np.linalg.norm((np.log10(parameters.scales(found)) - np.log10(parameters.scales(truth)))[:PADS])
        assert error[1.0] < 0.5 * error[None]


@dataclass(frozen=True, kw_only=True)
class StudentT(Loss):
    dof: float = 4.0

    def rho(self, square):
        u = 1.0 + square / self.dof
        return self.dof * np.log(u), 1.0 / u


class TestOwnLoss:
    @pytest.mark.parametrize("kind", [*KINDS, "sphere"])
    def test_its_jacobian(self, kind):
        misfit = misfit_of(ResidualOptions(kind=kind, loss=StudentT()))
        theta = state()[1].initial + 0.1
        check_derivative(lambda x: misfit(x).residual, misfit(theta).jacobian, theta, np.linspace(-1.0, 1.0, theta.size))

    @given(st.complex_numbers(max_magnitude=1e3), st.floats(0.1, 30.0))
    def test_the_general_form_is_that_of_the_soft_one(self, r, scale):
        own, J = Soft(scale=scale), np.array([[1.0 + 0.3j, -0.2j]])
        for found, expected in zip(Loss.__call__(own, np.array([r]), J), own(np.array([r]), J), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)

    def test_a_residual_of_zero(self):
        q, slope = StudentT()(np.zeros(1), np.ones((1, 1)))
        assert (q[0], slope[0, 0]) == (0.0, 1.0)

    def test_a_wrong_derivative_is_refused(self):
        class Wrong(Loss):
            def rho(self, square):
                return np.log1p(square), 1.0 / np.sqrt(1.0 + square)

        with pytest.raises(ConfigError, match=r"Wrong\.rho"):
            Wrong()

    def test_there_is_one_loss_only(self):
        with pytest.raises(ConfigError, match="two losses"):
            ResidualOptions(loss=StudentT(), loss_scale=1.0)


class TestWeights:
    def test_coherence(self):
        sigma = coherence_sigma(np.array([1.0, 0.9, 0.5, 0.0, np.nan]), 5)
        assert sigma[0] == 0.0
        assert sigma[1] == pytest.approx(DB * np.sqrt(0.1 / 9.0))
        assert sigma[2] == pytest.approx(DB * np.sqrt(0.1))
        assert np.isfinite(sigma[3])
        assert sigma[3] > 100
        assert np.isnan(sigma[4])

    def test_against_simulated_measurements(self):
        """H1 of noisy outputs: the scatter of its magnitude is what the formula says of the coherence."""
        rng = np.random.default_rng(0)
        trials, averages, noise = 20000, 8, 0.5
        x, n = (rng.normal(size=(2, trials, averages)) @ np.eye(averages) for _ in range(2))
        x, n = x[0] + 1j * x[1], noise * (n[0] + 1j * n[1])
        H = (np.conj(x) * (x + n)).sum(axis=1) / (np.abs(x) ** 2).sum(axis=1)
        expected = coherence_sigma(np.array(1.0 / (1.0 + noise**2)), averages)
        assert np.std(decibel(H)) == pytest.approx(float(expected), rel=0.12)

    def test_factors(self):
        np.testing.assert_allclose(noise_weights(np.array([0.0, 1.0, np.nan, np.inf]), 1.0), [1.0, np.sqrt(0.5), 1.0, 0.0])
        assert np.all(np.diff(noise_weights(np.linspace(0, 10, 50), 1.0)) < 0)

    def test_no_noise_changes_nothing(self):
        theta = wavy(pads_model(THIRDS, extras=True)[1])
        plain, none = misfit_of(ResidualOptions())(theta), misfit_of(ResidualOptions(), sigma=np.zeros((S.size, ROWS.size)))(theta)
        np.testing.assert_array_equal(plain.residual, none.residual)
        np.testing.assert_array_equal(plain.jacobian, none.jacobian)

    @pytest.mark.parametrize("kind", KINDS)
    def test_a_line_that_is_only_noise_does_not_matter(self, kind):
        _, parameters, measured = state()
        measured[5] *= 100.0 * np.exp(2.0j)
        sigma = np.zeros((S.size, ROWS.size))
        sigma[5] = np.inf
        theta = wavy(parameters)
        a = misfit_of(ResidualOptions(kind=kind), sigma=sigma)(theta)
        b = misfit_of(ResidualOptions(kind=kind), sigma=sigma, measured=measured)(theta)
        assert a.total == pytest.approx(b.total, rel=1e-12)


class TestLevel:
    """What the model lacks, from residuals of which some are the measurement's noise."""

    @pytest.mark.parametrize("level", [0.05, 0.5])
    def test_it_is_found_beside_the_noise(self, level):
        rng = np.random.default_rng(1)
        measured = np.exp(1j * rng.uniform(0, 6, (400, 5)))
        sigma = np.exp(rng.uniform(np.log(0.01), np.log(5.0), measured.shape))
        y = measured * 10 ** (np.hypot(level, sigma) * rng.normal(size=measured.shape) / 20)
        found = DataResidual(measured, sigma=sigma).follow(y, 0.0)
        assert found == pytest.approx(level, rel=0.1)
        # As if the noise were not known.
        assert np.std(decibel(y)) > 2 * level

    def test_unknowns_take_residuals(self):
        rng = np.random.default_rng(2)
        measured = np.ones((40, 5), dtype=complex)
        y = measured * 10 ** (0.3 * rng.normal(size=measured.shape) / 20)
        data = DataResidual(measured, sigma=np.zeros(measured.shape))
        assert data.follow(y, 50.0) == pytest.approx(data.follow(y, 0.0) * np.sqrt(200 / 150), rel=2e-3)

    def test_limits(self):
        measured = np.ones((40, 5), dtype=complex)
        assert DataResidual(measured, sigma=np.ones(measured.shape)).follow(measured, 0.0) == ERRORS.least_discrepancy_db
        # Where nothing is known of the noise nothing is followed.
        assert DataResidual(measured).follow(2 * measured, 0.0) == ERRORS.first_discrepancy_db


class TestSharedErrors:
    """Errors that lines share are whitened: the sum of squares is that of the full covariance."""

    @pytest.mark.parametrize("kind", KINDS)
    def test_against_the_full_covariance(self, kind):
        rng = np.random.default_rng(3)
        shape = (30, 4)
        measured = np.exp(rng.normal(size=shape) + 1j * rng.uniform(0, 6, shape))
        y = measured * np.exp(0.05 * (rng.normal(size=shape) + 1j * rng.normal(size=shape)))
        patterns = rng.normal(size=(*shape, 3)) + 1j * rng.normal(size=(*shape, 3))
        band = rng.integers(0, 5, shape[0])
        measured[rng.integers(0, shape[0], 6), rng.integers(0, shape[1], 6)] = np.nan
        sigma, level, change = np.abs(rng.normal(size=shape)), 0.3, 2.0 * rng.normal(size=shape)
        plain = DataResidual(measured, ResidualOptions(kind=kind))
        data = DataResidual(measured, ResidualOptions(kind=kind), sigma).with_level(level).with_change(y, change, 0.4, patterns, band)
        J = rng.normal(size=(*shape, 2)) + 1j * rng.normal(size=(*shape, 2))
        real = kind == "db"
        r, rows, _ = plain(y, J.real if real else J)
        B = plain(y, patterns.real if real else patterns)[1]
        valid = np.isfinite(measured)
        wrong = ERRORS.change_error * change
        wrong /= np.sqrt(1 + (wrong / 0.4) ** 2)
        own = np.tile(np.hypot(sigma, wrong)[valid], 1 if real else 2)
        # Of a response, the lines of a band share the error of their mean change.
        shared = []
        for k, n in itertools.product(range(5), range(shape[1])):
            here = valid & (band == k)[:, None] & (np.arange(shape[1]) == n)
            mean = np.where(here, wrong[here].mean() if here.any() else 0.0, 0.0)[valid]
            shared += [mean] if real else [np.r_[mean, 0.0 * mean], np.r_[0.0 * mean, mean]]
        B = np.column_stack([B, *shared])
        inverse = level**2 * np.linalg.inv(np.diag(level**2 + own**2) + B @ B.T)
        found, found_rows, _ = data(y, J.real if real else J)
        np.testing.assert_allclose(found @ found, r @ inverse @ r, rtol=1e-9)
        np.testing.assert_allclose(found_rows.T @ found_rows, rows.T @ inverse @ rows, rtol=1e-9)
        np.testing.assert_allclose(found_rows.T @ found, rows.T @ inverse @ r, rtol=1e-8)
        assert data.log_det == pytest.approx(-np.linalg.slogdet(inverse)[1], rel=1e-9)
        # Derivatives under other weights need not be formed again.
        other = (
            DataResidual(measured, ResidualOptions(kind=kind), sigma)
            .with_level(level)
            .with_change(1.3 * y, 0.5 * change, 0.4, 2.0 * patterns, band)
        )
        np.testing.assert_allclose(data.carried(other(y, J.real if real else J)[1], other), found_rows, rtol=1e-8, atol=1e-10)

    def test_the_level_beside_shared_errors(self):
        """Errors along known patterns tell nothing of the model discrepancy besides."""
        rng = np.random.default_rng(4)
        shape = (200, 5)
        measured = np.ones(shape, dtype=complex)
        patterns = rng.normal(size=(*shape, 6))
        error = patterns @ rng.normal(size=6) + 0.1 * rng.normal(size=shape)
        y = 10 ** (error / 20) + 0j
        data = DataResidual(measured).with_change(y, np.zeros(shape), 1.0, patterns, np.zeros(shape[0], dtype=np.int64))
        assert data.follow(y, 0.0) == pytest.approx(0.1, rel=0.1)
        assert np.std(error) > 1.0

    def test_weights_are_handed_over(self):
        rng = np.random.default_rng(5)
        shape = (20, 3)
        measured = np.exp(rng.normal(size=shape)) + 0j
        y = measured * 1.1
        band = np.repeat([0, 1], 10)
        first = DataResidual(measured, sigma=np.ones(shape)).with_change(y, np.ones(shape), 1.0, rng.normal(size=(*shape, 2)), band)
        second = DataResidual(measured, sigma=np.zeros(shape)).weighted_as(first.with_level(0.2))
        empty = np.zeros((*shape, 0))
        np.testing.assert_array_equal(first.with_level(0.2)(y, empty)[0], second(y, empty)[0])
        assert second.level == 0.2

    def test_a_state_that_is_explained_exactly(self):
        """Its error bounds that of any change: no error at all, and no division by it."""
        shape = (20, 3)
        measured = np.full(shape, 2.0 + 0j)
        data = DataResidual(measured).with_change(measured, np.zeros(shape), 0.0, np.zeros((*shape, 2)), np.zeros(20, dtype=np.int64))
        r, _, _ = data(1.1 * measured, np.zeros((*shape, 0)))
        np.testing.assert_allclose(r, decibel(np.array(1.1 + 0j)))
