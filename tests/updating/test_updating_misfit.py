"""Cost, residuals and derivatives of the updating."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from derivatives import check_derivative
from pads import PADS, THIRDS, S, loosened, pads_dynamic, pads_model, pads_ports
from systems import direct_frf, relative

from lrbc_cli.errors import DataError
from lrbc_cli.model.terms import Parameterisation, smoothing_matrix
from lrbc_cli.updating.misfit.cost import ChangeError, Misfit, mean_misfit, penalty_rows
from lrbc_cli.updating.misfit.frf import changed, level_factor, port_model, reduced_model
from lrbc_cli.updating.statistics.decibels import decibel
from lrbc_cli.updating.statistics.error_model import ERRORS

ROWS = np.array([0, 2, 3])


def wavy(parameters, seed=2):
    """A theta in general position."""
    rng = np.random.default_rng(seed)
    theta = parameters.initial + rng.uniform(-1.2, 0.2, size=parameters.size)
    theta[parameters.is_damping] = 0.7
    return theta


def measurement(model, parameters, rows, s=S):
    """FRFs of the loosened state, with three values missing."""
    y = direct_frf(model, s, parameters.dynamic(loosened(parameters), s))[:, rows]
    y[3, 0] = y[17, 1] = np.nan
    y[40, 2] = 0.0
    return y


def misfits(smoothing=THIRDS, *, eta=0.04, extras=True, **more):
    """The same cost by both formulas."""
    model, parameters = pads_model(smoothing, extras=extras, **more)
    measured = measurement(model, parameters, ROWS)
    by_ports = port_model(pads_ports(model).select(np.arange(S.size), ROWS), parameters)
    by_stiffness = reduced_model(pads_dynamic(model), S, parameters, ROWS)
    return [Misfit(by, measured, parameters.initial, eta) for by in (by_ports, by_stiffness)]


class TestGradient:
    """|C(x + h d) - C(x) - h g·d| falls as h² over three decades of h."""

    @pytest.mark.parametrize("which", ["port", "reduced"])
    @pytest.mark.parametrize("part", ["stiffness", "p_damp", "damping", "mass", "all"])
    def test_of_the_cost(self, which, part):
        misfit = misfits()[which == "reduced"]
        parameters = misfit.model.parameters
        theta = wavy(parameters)
        where = {
            "stiffness": slice(0, PADS),
            "p_damp": slice(PADS, PADS + 1),
            "damping": slice(PADS + 1, PADS + 2),
            "mass": slice(PADS + 2, PADS + 3),
        }
        direction = np.zeros(theta.size)
        part_of = where.get(part, slice(None))
        direction[part_of] = np.random.default_rng(1).normal(size=direction[part_of].size)
        check_derivative(lambda t: misfit(t).cost, misfit(theta).gradient, theta, direction / np.linalg.norm(direction), first=0.1)

    @pytest.mark.parametrize("smoothing", [None, THIRDS, (0.1, 0.2, 0.4, 0.2, 0.1)])
    @pytest.mark.parametrize("k", [0, 4, PADS - 1])
    def test_of_every_parameter_through_the_smoothing(self, smoothing, k):
        misfit = misfits(smoothing)[0]
        theta = wavy(misfit.model.parameters)
        check_derivative(lambda t: misfit(t).cost, misfit(theta).gradient, theta, np.eye(theta.size)[k], first=0.1)

    def test_of_the_residuals(self):
        misfit = misfits()[0]
        theta = wavy(misfit.model.parameters)
        direction = np.random.default_rng(3).normal(size=theta.size)
        check_derivative(lambda t: misfit(t).residual, misfit(theta).jacobian, theta, direction / np.linalg.norm(direction), first=0.03)

    def test_several_parameters_share_terms(self):
        """One parameter for two pads: a bolt with several terms."""
        model, parameters = pads_model(None)
        pads = parameters.groups[0]
        pairs = Parameterisation(
            (
                type(pads)(
                    **{
                        **pads.__dict__,
                        "parameter": np.arange(PADS) // 2,
                        "initial": pads.initial[: PADS // 2],
                        "bounds": pads.bounds[: PADS // 2],
                        "smoothing": smoothing_matrix(THIRDS, PADS // 2),
                    }
                ),
            )
        )
        misfit = Misfit(port_model(pads_ports(model), pairs), measurement(model, parameters, np.arange(4)), pairs.initial, 0.1)
        theta = wavy(pairs)
        direction = np.random.default_rng(3).normal(size=theta.size)
        check_derivative(lambda t: misfit(t).cost, misfit(theta).gradient, theta, direction / np.linalg.norm(direction), first=0.1)


class TestCost:
    def test_equation_29(self):
        """Against the formula written out with direct solves."""
        misfit = misfits(extras=False, eta=0.3)[0]
        parameters = misfit.model.parameters
        model, _ = pads_model()
        measured, theta = measurement(model, parameters, ROWS), wavy(parameters)
        y = direct_frf(model, S, parameters.dynamic(theta, S))[:, ROWS]
        valid = np.isfinite(measured) & (measured != 0)
        T = 20 * np.log10(np.abs(y[valid])) - 20 * np.log10(np.abs(measured[valid]))
        data = np.sum(T**2)
        total = data + 0.3 * np.sum((theta[:PADS] - parameters.initial[:PADS]) ** 2)
        value = misfit(theta)
        assert valid.sum() == 3 * S.size - 3
        assert value.data == pytest.approx(data, rel=1e-8)
        assert value.total == pytest.approx(total, rel=1e-8)
        assert value.cost == pytest.approx(np.log10(total), rel=1e-9)
        assert value.misfit_db == pytest.approx(np.mean(np.abs(T)), rel=1e-8)
        assert misfit.lines == S.size

    def test_both_formulas_agree(self):
        by_ports, by_stiffness = misfits()
        theta = wavy(by_ports.model.parameters)
        a, b = by_ports(theta), by_stiffness(theta)
        assert a.total == pytest.approx(b.total, rel=1e-7)
        np.testing.assert_allclose(a.gradient, b.gradient, rtol=1e-6, atol=1e-7 * np.abs(b.gradient).max())
        np.testing.assert_allclose(a.jacobian, b.jacobian, rtol=1e-5, atol=1e-6 * np.abs(b.jacobian).max())
        assert relative(by_ports.model.frf(theta), by_stiffness.model.frf(theta)) < 1e-9

    def test_terms_that_changed_besides_whatever_the_unknowns_are(self):
        """About a state as about none, with derivatives to the unknowns; what was computed without the change is not taken for it."""
        model, parameters = pads_model(THIRDS)
        plain = port_model(pads_ports(model).select(np.arange(S.size), ROWS), parameters)
        theta, terms = wavy(parameters), np.array([0, 3])
        before, D = plain.frf(theta), parameters.dynamic(theta, plain.s)
        D[:, terms] *= 10.0**-1.5
        expected = plain.values(D)
        assert relative(before, expected) > 1e-3
        for form in (plain, plain.near(theta)):
            changed = form.weakened(terms, -1.5)
            np.testing.assert_allclose(changed.frf(theta), expected, rtol=1e-9)
            y, J = changed.sensitivities(theta)
            np.testing.assert_allclose(y, expected, rtol=1e-9)
            way = np.cos(np.arange(parameters.size))
            check_derivative(
                lambda t, changed=changed: 20 * np.log10(np.abs(changed.frf(t))), J, theta, way / np.linalg.norm(way), first=0.03
            )

    def test_terms_at_another_level_in_the_state_compared_with(self):
        """What is compared is the change from there; with factors of the FRFs the derivatives of levels are those of the changed model."""
        model, parameters = pads_model(THIRDS)
        plain = port_model(pads_ports(model).select(np.arange(S.size), ROWS), parameters)
        prior, theta, terms = parameters.initial, wavy(parameters), np.array([0, 3])
        lower, lost = plain.weakened(terms, -0.5), plain.weakened(terms, -2.0)
        factor = level_factor(plain.near(prior), terms, -0.5, prior)
        misfit = Misfit(plain, plain.frf(theta) * 1.1, prior, 0.0).weakened(terms, -2.0, factor)
        y, J = misfit.model.sensitivities(theta)
        np.testing.assert_allclose(y / plain.frf(prior), lost.frf(theta) / lower.frf(prior), rtol=1e-9)
        np.testing.assert_allclose(J, lost.sensitivities(theta)[1], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(changed(plain, terms, -0.5, factor).frf(prior), plain.frf(prior), rtol=1e-9)
        near = changed(plain, terms, -0.5, factor).near(theta)
        np.testing.assert_allclose(near.weakened(terms, -1.5).frf(theta), y, rtol=1e-8)

    def test_cells_are_bands_of_lines_of_one_response(self):
        model, parameters = pads_model(THIRDS)
        plain = port_model(pads_ports(model).select(np.arange(S.size), ROWS), parameters)
        measured = plain.frf(parameters.initial).copy()
        measured[3, 0] = np.nan
        misfit = Misfit(plain, measured, parameters.initial, 0.0)
        cells, (line, response) = misfit.cells, np.nonzero(misfit.valid)
        assert cells.size == misfit.data_rows(misfit(parameters.initial)) == measured.size - 1
        f, width = np.abs(S), misfit.errors.shift_knots * np.abs(S).max()
        for cell in np.unique(cells):
            own = cells == cell
            assert np.unique(response[own]).size == 1
            assert np.ptp(f[line[own]]) <= width * (1.0 + 1e-9)
        assert np.unique(cells).size > measured.shape[1]

    def test_a_state_is_computed_once_unless_it_is_large(self, monkeypatch):
        model, parameters = pads_model(THIRDS)
        ports, calls = pads_ports(model).select(np.arange(S.size), ROWS), []
        by = port_model(ports, parameters)
        object.__setattr__(by, "linearised", lambda *of: (calls.append("linearised"), ports.linearise(*of))[1])
        object.__setattr__(by, "values", lambda D: (calls.append("values"), ports.evaluate(D))[1])
        here, there = parameters.initial, wavy(parameters)
        y, J = by.sensitivities(here)
        np.testing.assert_allclose(by.frf(there), ports.evaluate(parameters.dynamic(there, by.s)), rtol=1e-12)
        assert by.frf(here) is y
        assert by.sensitivities(here.copy())[1] is J
        assert calls == ["linearised", "values"]
        by.sensitivities(here, phase=True)
        by.sensitivities(there)
        assert calls == ["linearised", "values", "linearised", "linearised"]
        with pytest.raises(ValueError, match="read-only"):
            J[:] = 0.0
        monkeypatch.setattr("lrbc_cli.updating.misfit.frf.MOST_KEPT", 1)
        by.frf(here)
        by.frf(here)
        assert calls[4:] == ["values", "values"]

    def test_p_damp_is_not_regularised(self):
        weak, strong = misfits(eta=0.0)[0], misfits(eta=1e4)[0]
        parameters = weak.model.parameters
        theta = parameters.initial.copy()
        theta[parameters.is_damping] += 1.3
        assert strong(theta).total == pytest.approx(weak(theta).total, rel=1e-12)
        theta[0] += 0.5
        assert strong(theta).total == pytest.approx(weak(theta).total + 1e4 * 0.25, rel=1e-9)

    def test_no_regularisation_has_no_rows(self):
        misfit = misfits(eta=0.0)[0]
        assert not misfit(wavy(misfit.model.parameters)).residual[3 * S.size - 3 :].any()

    def test_the_true_state_costs_nothing(self):
        misfit = misfits(eta=0.0)[0]
        value = misfit(loosened(misfit.model.parameters))
        assert value.misfit_db < 1e-6
        assert np.isfinite(value.cost)

    def test_nothing_to_compare_with(self):
        model, parameters = pads_model()
        with pytest.raises(DataError, match="no measured value"):
            Misfit(port_model(pads_ports(model), parameters), np.full((S.size, 4), np.nan + 0j), parameters.initial, 0.0)


class TestPenalty:
    def test_values_and_slopes_of_each_edge_apart(self):
        _, parameters = pads_model(extras=True)
        x = np.random.default_rng(0).normal(size=parameters.size)
        pads = x[:PADS]
        rows = penalty_rows(parameters, 0.5, 2.0)
        expected = 0.5 * np.sum(pads**2) + 2.0 * np.sum(np.diff(pads) ** 2)
        # The dashpot and the mass have a value and no neighbours.
        expected += 0.5 * np.sum(x[PADS + 1 :] ** 2)
        assert np.sum((rows @ x) ** 2) == pytest.approx(expected)
        assert not rows[:, parameters.is_damping].any()

    def test_no_weights(self):
        _, parameters = pads_model()
        assert penalty_rows(parameters, 0.0).shape == (0, parameters.size)

    def test_it_enters_the_cost_about_the_prior(self):
        model, parameters = pads_model()
        measured = measurement(model, parameters, np.arange(4)[ROWS])
        by_ports = port_model(pads_ports(model).select(np.arange(S.size), ROWS), parameters)
        prior, theta, rows = wavy(parameters, 5), wavy(parameters, 6), penalty_rows(parameters, 0.3, 1.0)
        plain, penalised = Misfit(by_ports, measured, prior, 0.0), Misfit(by_ports, measured, prior, 7.0, rows)
        expected = plain(theta).total + 7.0 * np.sum((rows @ (theta - prior)) ** 2)
        assert penalised(theta).total == pytest.approx(expected, rel=1e-10)
        direction = np.random.default_rng(3).normal(size=theta.size)
        check_derivative(lambda t: penalised(t).cost, penalised(theta).gradient, theta, direction / np.linalg.norm(direction), first=0.1)


def test_decibel():
    np.testing.assert_allclose(decibel(np.array([10.0, -1.0, 0.1j])), [20.0, 0.0, -20.0], atol=1e-12)


def test_mean_misfit_leaves_out_what_was_not_measured():
    y = np.array([[1.0, 1.0, 1.0], [10.0, 1.0, 1.0]], dtype=complex)
    measured = np.array([[10.0, np.nan, np.nan], [10.0, 0.1, 0.0]], dtype=complex)
    np.testing.assert_allclose(mean_misfit(y, measured), [10.0, 20.0, np.nan])


@pytest.mark.parametrize("factor", [0.99, 1.01, -1.0])
def test_the_check_of_gradients_sees_an_error_of_a_percent(factor):
    misfit = misfits()[0]
    theta = wavy(misfit.model.parameters)
    direction = np.random.default_rng(3).normal(size=theta.size)
    with pytest.raises(AssertionError, match="second order"):
        check_derivative(lambda t: misfit(t).cost, factor * misfit(theta).gradient, theta, direction / np.linalg.norm(direction))


class TestChangeError:
    """A resonance that is moved may have moved by some percent more or less."""

    LINES = np.arange(20.0, 201.0)
    STEP = 1e-3

    def response(self, theta: np.ndarray, f: np.ndarray) -> np.ndarray:
        """Two responses, a resonance at 60 Hz that stays and one near 140 Hz that follows theta."""
        moved = 140.0 + float(theta[0])
        first, second = (1.0 / (f0**2 - f**2 + 0.02j * f0 * f) for f0 in (60.0, moved))
        return np.column_stack([first + second, 2.0 * first - second])

    def error(self, most: float = 1.0) -> ChangeError:
        here, above = (SimpleNamespace(frf=lambda theta, f=f: self.response(theta, f)) for f in (self.LINES, self.LINES + self.STEP))
        return ChangeError(most=most, here=here, above=above, frequency_hz=self.LINES, step_hz=self.STEP, size=1)

    @pytest.mark.parametrize("shift", [0.02, -0.3])
    def test_the_error_is_a_share_of_the_shift(self, shift: float) -> None:
        prior, theta = np.zeros(1), np.array([shift])
        change, patterns, band = self.error()(prior, theta)
        assert (np.diff(band) >= 0).all()
        # Bands are as wide as the knots lie apart.
        assert np.bincount(band)[1:-1].max() <= np.ceil(ERRORS.shift_knots * self.LINES[-1]) + 1
        np.testing.assert_allclose(
            change, decibel(self.response(theta, self.LINES)) - decibel(self.response(prior, self.LINES)), atol=1e-10
        )
        # Near the resonance that moves: what 12 % more of the shift would change, in both responses.
        near = (self.LINES > 132) & (self.LINES < 148)
        more = decibel(self.response(theta * 1.12, self.LINES)) - decibel(self.response(theta, self.LINES))
        total = patterns.real.sum(axis=2) * np.sign(shift)
        # The axis of frequency moves against the resonance.
        size = np.sqrt(np.mean(more[near] ** 2))
        assert np.sqrt(np.mean((total + more)[near] ** 2)) < 0.25 * size
        # Where nothing moves there is hardly any error.
        still = (self.LINES > 50) & (self.LINES < 70)
        assert np.abs(total[still]).max() < 0.02 * np.abs(total[near]).max()

    def test_no_change_no_error(self) -> None:
        change, patterns, _ = self.error()(np.zeros(1), np.zeros(1))
        np.testing.assert_array_equal(change, 0.0)
        np.testing.assert_array_equal(patterns, 0.0)

    def test_what_drifted_does_not_count(self) -> None:
        """Theta may be longer than the boundary's."""
        one = self.error()(np.zeros(1), np.array([0.1]))
        two = self.error()(np.zeros(3), np.array([0.1, 5.0, -2.0]))
        for a, b in zip(one, two, strict=True):
            np.testing.assert_array_equal(a, b)
