"""Differences on Riemann's sphere: bounded at poles and zeros, and where they lead when lines do not resolve the peaks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp
from systems import csc, dense_ports, fe_model, unit

from lrbc_cli.model.terms import ParameterGroup, Parameterisation
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import port_model
from lrbc_cli.updating.search.levels import gauss_newton_by_levels
from lrbc_cli.updating.statistics.decibels import DB
from lrbc_cli.updating.statistics.lines import too_wide
from lrbc_cli.updating.statistics.residuals import DataResidual

SPRINGS = 6
LINES = np.arange(20.0, 600.5)


def chain(loss: float = 0.0):
    """Thirty masses on springs, six more of which to ground are unknown; lines 1 Hz apart."""
    n = 30
    K = 2e6 * sp.diags_array([np.r_[1.0, np.full(n - 2, 2.0), 1.0], -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1])
    at = [0, 5, 11, 17, 23, 29]
    ends = {"loads": unit(n, 3), "outputs": unit(n, 1, 8, 14, 20, 27)}
    model = fe_model(csc(K * (1 + 1j * loss) if loss else K), csc(0.5 * sp.eye_array(n)), left=1e3 * unit(n, *at), output_power=2, **ends)
    each = np.arange(SPRINGS)
    group = ParameterGroup(
        name="springs",
        kind="stiffness",
        terms=each,
        parameter=each,
        initial=np.zeros(SPRINGS),
        bounds=np.tile([-4.0, 1.5], (SPRINGS, 1)),
        smoothing=np.eye(SPRINGS),
        bolt=each,
    )
    reference = np.zeros((SPRINGS, 3))
    reference[:, :2] = [1.0, 1e-4]
    return port_model(dense_ports(model, 2j * np.pi * LINES, reference), Parameterisation((group,)))


@pytest.fixture(scope="module")
def undamped():
    return chain()


class TestResidual:
    def test_jacobian(self, undamped):
        theta = 0.1 * np.random.default_rng(0).standard_normal(SPRINGS)
        misfit = Misfit(undamped, undamped.frf(np.zeros(SPRINGS)), theta, 0.0).on_sphere()
        value, step = misfit(theta), 1e-6
        for k, row in enumerate(np.eye(SPRINGS) * step):
            slope = (misfit(theta + row).residual - misfit(theta - row).residual) / (2 * step)
            np.testing.assert_allclose(value.jacobian[:, k], slope, atol=1e-5 * np.abs(slope).max())

    def test_decibels_and_radians_about_the_mean_level(self):
        measured = np.exp(1j * np.linspace(0.0, 3.0, 7))[:, None]
        data = DataResidual(measured).on_sphere()
        for change in (1e-4, 1e-4j):
            residual, _, _ = data(measured * np.exp(change), np.zeros((7, 1, 0), dtype=complex))
            assert np.linalg.norm(residual) == pytest.approx(DB * 1e-4 * np.sqrt(7), rel=1e-4)

    def test_bounded_at_poles_and_zeros(self):
        measured = np.array([1.0, -1.0, 1e-9, 1e9])[:, None] + 0j
        for other in (1e-12, -1e12, 1e30j):
            residual, _, _ = DataResidual(measured).on_sphere()(np.full((4, 1), other), np.zeros((4, 1, 0), dtype=complex))
            assert np.linalg.norm(residual.reshape(3, 4), axis=0).max() <= 2 * DB * (1 + 1e-9)

    def test_a_pole_that_passes_a_line_is_no_ridge(self):
        pole = np.linspace(-0.5, 0.5, 1001)
        data = DataResidual(np.array([[1.0], [-2.0]], dtype=complex))
        line = [np.array([[1.0 / (1e-9 + p)], [-1.0]], dtype=complex) for p in pole]

        def steepest(residual):
            return np.abs(np.diff([residual(y, np.zeros((2, 1, 0), dtype=complex))[0] for y in line], axis=0)).max()

        assert steepest(data.on_sphere()) < 0.1
        assert steepest(data) > 50.0


class TestUnresolvedPeaks:
    @pytest.mark.parametrize("loss", [0.0, 2e-4])
    def test_six_values_without_damping(self, loss):
        """Squares in dB leave 1 to 3 dB: there is a valley between any two lines."""
        model, truth = chain(loss), 0.03 * np.random.default_rng(1).standard_normal(SPRINGS)
        misfit = Misfit(model, model.frf(truth), np.zeros(SPRINGS), 4.0, sharp=True)
        found = gauss_newton_by_levels(misfit, misfit.prior, model.parameters.bounds)
        assert found.evaluation.total <= 1.01 * misfit(truth).total
        np.testing.assert_allclose(found.theta, truth, atol=1e-4)
        assert found.evaluations > len(found.history)
        assert min(entry.cost for entry in found.history) >= found.evaluation.cost

    def test_the_lines_tell(self, undamped):
        theta = np.zeros(SPRINGS)
        assert too_wide((LINES, undamped.frf(theta))) is not None
        assert too_wide((LINES, chain(2e-4).frf(theta))) is not None
        assert too_wide((LINES, chain(2e-2).frf(theta))) is None

    def test_decibels_alone_do_not_get_there(self, undamped):
        truth = 0.03 * np.random.default_rng(1).standard_normal(SPRINGS)
        misfit = Misfit(undamped, undamped.frf(truth), np.zeros(SPRINGS), 4.0)
        found = gauss_newton_by_levels(misfit, misfit.prior, undamped.parameters.bounds)
        assert found.evaluation.total > 100.0 * misfit(truth).total


def test_a_response_that_is_rounding_has_no_derivative(undamped):
    """At a zero of an undamped model the logarithm is steep without limit, and one line outweighed all others."""
    theta = np.zeros(SPRINGS)
    P, s = undamped.parameters, undamped.s
    y, dy = undamped.linearised(P.dynamic(theta, s), P.slopes(theta, s))
    y = y.copy()
    y[7, 2] = 1e-18 * np.abs(y[:, 2]).max()
    model = dataclasses.replace(undamped, linearised=lambda *_: (y, dy.copy()))
    _, J = model.sensitivities(theta)
    assert not J[7, 2].any()
    assert np.abs(J).max() < 1e8
