"""Global factors from a measurement: gradients, smoothed spectra, and what was put in has to come out."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from derivatives import check_derivative
from factors import COEFFICIENTS, FREQUENCY, SPRINGS, affine, duct_model, measured, problem, springs
from systems import beam, direct_frf, fe_model, unit

from lrbc_cli.model.factors import make_recipe, with_factors
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.calibration.apart import apart_notes, damping_at_bounds, indistinguishable, overdamped
from lrbc_cli.updating.calibration.calibrate import fit_factors, moves_resonances
from lrbc_cli.updating.calibration.far import far_factors
from lrbc_cli.updating.search.smooth import smoothed
from lrbc_cli.updating.search.starts import single_joints
from lrbc_cli.updating.statistics.residuals import ResidualOptions

SIX = ("stiffness.structure", "mass.acoustic", "alpha.structure", "beta.structure", "alpha.acoustic", "beta.acoustic")
KINDS = [(False, name) for name in (*SIX, "stiffness.acoustic", "mass.structure", "sound_speed", "part")]
KINDS += [(True, name) for name in ("damping.structure", "damping.acoustic", "part")]


def test_what_moves_resonances():
    _, recipe = duct_model(loss=(0.02, 0.003))
    still = {name for name in recipe.names if not moves_resonances(recipe, name)}
    assert still == {f"{kind}.{field}" for kind in ("alpha", "beta", "loss_factor") for field in ("structure", "acoustic")}


TIGHT = np.array([4.6, 4.4, 4.5, 4.7, 4.5, 4.6])


@cache
def trial(matrix, name):
    """Model, recipe, and a measurement with this factor."""
    model, recipe = duct_model(matrix)
    return model, recipe, measured(model, recipe, {name: 1.1}, TIGHT, 0.01)


@pytest.mark.parametrize(("matrix", "name"), KINDS)
class TestOneFactor:
    def test_frfs_are_those_of_the_assembled_model(self, matrix, name):
        model, recipe = duct_model(matrix)
        s = 2j * np.pi * np.array([33.0, 97.0, 251.0])
        P, theta = springs(), springs().initial
        found = affine(model, recipe).linearise(s, P.dynamic(theta, s), {name: 1.07}, [name]).y
        exact = direct_frf(with_factors(model, recipe, {name: 1.07})[0], s, P.dynamic(theta, s))
        np.testing.assert_allclose(found, exact, rtol=1e-8)

    @pytest.mark.parametrize("kind", ["db", "log-complex", "smoothed"])
    def test_taylor(self, matrix, name, kind):
        model, recipe, values = trial(matrix, name)
        options = None if kind == "smoothed" else ResidualOptions(kind=kind)
        p = problem(
            affine(model, recipe),
            values,
            (name,),
            options=options,
            parameters=springs(damped=True),
            selected=np.arange(0, FREQUENCY.size, 7),
        )
        misfit = p.smoothed_misfit(8.0, 4.0) if kind == "smoothed" else p.misfit(4.0)
        rng = np.random.default_rng(1)
        theta = p.start + rng.normal(scale=0.05, size=p.start.size)
        direction = np.append(rng.normal(scale=0.01, size=SPRINGS + 1), 1.0)
        check_derivative(
            lambda t: misfit(t).cost,
            misfit(theta).gradient,
            theta,
            direction / np.linalg.norm(direction),
            first=0.03 if moves_resonances(recipe, name) else 1.0,
        )


def test_factors_of_damping_have_the_wider_prior():
    for matrix, name in KINDS:
        recipe = duct_model(matrix)[1]
        assert moves_resonances(recipe, name) == (not name.startswith(("alpha", "beta", "damping")))


class TestSmoothed:
    def test_poisson(self):
        """A decaying oscillation: the exact FRF beside the axis, from lines on it."""
        f = np.arange(1.0, 800.0)

        def frf(s):
            return sum(1.0 / ((s + 2 * np.pi * d) ** 2 + (2 * np.pi * w) ** 2) for w, d in ((60.0, 1.5), (140.0, 2.0)))

        values = frf(2j * np.pi * f)[:, None]
        at = np.array([40.0, 60.0, 100.0, 140.0, 200.0])
        found = smoothed(f, values, 8.0, at)[:, 0]
        np.testing.assert_allclose(found, frf(2 * np.pi * (8.0 + 1j * at)), rtol=0.02)

    def test_what_is_not_covered_is_left_out(self):
        f = np.arange(20.0, 401.0)
        values = np.ones((f.size, 2), dtype=complex)
        values[(f > 150) & (f < 250), 1] = np.nan
        found = smoothed(f, values, 8.0, np.array([22.0, 100.0, 200.0, 398.0]))
        np.testing.assert_array_equal(np.isfinite(found[:, 0]), [False, True, True, False])
        np.testing.assert_array_equal(np.isfinite(found[:, 1]), [False, True, False, False])
        np.testing.assert_allclose(found[1], 1.0)

    def test_lines_too_far_apart(self):
        model, recipe = duct_model()
        p = problem(affine(model, recipe), measured(model, recipe, {}, TIGHT, 0.01), ("mass.acoustic",))
        assert p.smoothed_misfit(8.0, 4.0) is not None
        assert p.smoothed_misfit(0.5, 4.0) is None


class TestRecovery:
    @pytest.mark.parametrize(("stiffness", "mass", "damping"), [(1.05, 0.97, 0.5), (0.95, 1.02, 2.0)])
    def test_from_afar(self, stiffness, mass, damping):
        """5 % of stiffness and a factor of 2 in the damping, springs unknown, noise of 1 %."""
        model, recipe = duct_model(matrix_damping=True)
        names = ("stiffness.structure", "mass.acoustic", "damping.structure", "damping.acoustic")
        truth = dict(zip(names, (stiffness, mass, damping, damping), strict=True))
        fit = fit_factors(problem(affine(model, recipe), measured(model, recipe, truth, TIGHT, 0.01), names))
        assert fit.solution.status == "converged"
        for name, value in truth.items():
            assert fit.factors[name] == pytest.approx(value, rel=0.005 if moves_resonances(recipe, name) else 0.2), name
            low, high = fit.interval(name)
            assert low < fit.factors[name] < high
        assert [stage.width_hz for stage in fit.stages[:3]] == [16.0, 4.0, 0.0]
        np.testing.assert_allclose(fit.solution.theta[:SPRINGS], TIGHT, atol=0.1)

    def test_searched_on_few_lines_identified_on_all(self):
        """The end is that of all lines, and no worse under their cost than that of a search on all of them."""
        model, recipe = duct_model()
        names = ("stiffness.structure", "mass.acoustic", "beta.structure")
        values = measured(model, recipe, dict(zip(names, (1.05, 0.97, 0.7), strict=True)), TIGHT, 0.01)
        whole = problem(affine(model, recipe), values, names)
        few = problem(affine(model, recipe), values, names, few=np.arange(0, FREQUENCY.size, 3), sigma=np.full(values.shape, 0.1))
        assert few.thinned().selected.size == few.thinned().sigma.shape[0] == np.arange(0, FREQUENCY.size, 3).size
        assert whole.thinned() is whole
        fits = [fit_factors(one) for one in (whole, few)]
        assert fits[1].noise.sigma == pytest.approx(fits[0].noise.sigma, rel=0.05)
        cost = whole.misfit(fits[0].noise.variance, soft=True)
        assert cost(fits[1].solution.theta).total <= 1.01 * cost(fits[0].solution.theta).total
        for name in names:
            assert fits[1].factors[name] == pytest.approx(fits[0].factors[name], rel=0.3 * fits[0].spread[name] + 1e-3), name

    @pytest.mark.parametrize("levels", [(2.5, 5.5), pytest.param((6.0, 3.0), marks=pytest.mark.slow)])
    def test_groups_that_are_off_by_different_amounts(self, levels):
        """Springs that start at 4.5; from there, and with all of them alike, the descents end elsewhere."""
        model, recipe = duct_model()
        own, half = springs().groups[0], SPRINGS // 2
        alike = dict(parameter=np.zeros(half, dtype=int), initial=own.initial[:1], bounds=own.bounds[:1], smoothing=np.eye(1))
        terms = np.arange(SPRINGS).reshape(2, half)
        two = Parameterisation(tuple(replace(own, name=str(k), terms=at, **alike) for k, at in enumerate(terms)))
        names = ("stiffness.structure", "mass.acoustic")
        values = measured(model, recipe, dict(zip(names, (1.02, 0.99), strict=True)), np.repeat(levels, half), 0.01)
        fit = fit_factors(problem(affine(model, recipe), values, names, parameters=two))
        np.testing.assert_allclose(fit.solution.theta[:2], levels, atol=0.05)
        assert fit.factors["stiffness.structure"] == pytest.approx(1.02, rel=0.005)

    def test_a_loose_joint_in_the_reference_job(self):
        """From springs that are all alike the descents end 2.1 dB away: factor and neighbours take up what one of them has lost."""
        K, M = beam(14, bending=40.0)
        n = K.shape[0]
        # Deflections have the odd numbers.
        springs_at, heard = unit(n, 3, 7, 11, 15, 19, 23), unit(n, 1, 9, 17, 23)
        model = fe_model(K, M, loads=unit(n, 5), outputs=heard, left=springs_at, damping=(2.0, 4e-6), output_power=2)
        recipe, names = make_recipe(((2.0, 4e-6), (0.0, 0.0)), False), ("stiffness.structure", "beta.structure")
        state = 4.5 + np.array([0.1, -0.05, -1.5, 0.08, -0.1, 0.05])
        values = measured(model, recipe, dict(zip(names, (1.06, 1.5), strict=True)), state, 0.01)
        fit = fit_factors(problem(affine(model, recipe), values, names))
        assert fit.solution.evaluation.misfit_db < 0.2
        np.testing.assert_allclose(fit.solution.theta[:SPRINGS], state, atol=0.05)
        assert fit.factors["stiffness.structure"] == pytest.approx(1.06, rel=0.002)

    def test_what_belongs_to_a_bolt_is_moved_together(self):
        """Springs 0 and 3, 1 and 4 are of one bolt each, 2 and 5 of none."""
        model, recipe = duct_model()
        own, half = springs().groups[0], SPRINGS // 2
        part = dict(parameter=np.arange(half), initial=own.initial[:half], bounds=own.bounds[:half], smoothing=np.eye(half))
        groups = [replace(own, name=str(k), terms=k * half + np.arange(half), bolt=np.array([0, 1, -1]), **part) for k in (0, 1)]
        state = np.full(SPRINGS, 4.5)
        state[[1, 4]] -= 1.2
        P = Parameterisation(tuple(groups))
        p = problem(affine(model, recipe), measured(model, recipe, {}, state, 0.001), ("mass.acoustic",), parameters=P)
        found = single_joints(p.misfit(9.0), p.start, p.start, p.bounds, kept=4)
        assert len(found) == 4
        np.testing.assert_allclose(found[0], np.append(state, 0.0))
        moved = {tuple(np.flatnonzero(theta != p.start).tolist()) for theta in found}
        assert moved == {(0, 3), (1, 4), (2,), (5,)}

    @pytest.mark.slow
    def test_intervals_hold_what_they_promise(self):
        """Two standard deviations over several draws of the noise."""
        model, recipe = duct_model()
        truth = {"stiffness.structure": 1.02, "beta.structure": 1.3}
        miss = []
        for seed in range(4):
            fit = fit_factors(problem(affine(model, recipe), measured(model, recipe, truth, TIGHT, 0.01, seed), tuple(truth)))
            miss += [(fit.logarithms[name] - np.log(value)) / fit.spread[name] for name, value in truth.items()]
        assert np.abs(miss).max() < 3.5
        assert np.sqrt(np.mean(np.square(miss))) < 1.8

    def test_boundary_held(self):
        model, recipe = duct_model()
        truth = {"stiffness.structure": 1.04, "part": 0.97}
        held = springs().initial
        p = problem(affine(model, recipe), measured(model, recipe, truth, held, 0.01), tuple(truth), hold=True)
        fit = fit_factors(p)
        np.testing.assert_array_equal(fit.solution.theta[: held.size], held)
        assert np.all(fit.covariance[: held.size] == 0)
        # Errors twice as large as the residuals double what the data tell: all of it, so far from the prior.
        wider = fit.wider(2.0)
        assert wider.spread == {name: pytest.approx(2.0 * std, rel=0.01) for name, std in fit.spread.items()}
        assert np.all(wider.covariance[: held.size] == 0)
        for name, value in truth.items():
            assert fit.factors[name] == pytest.approx(value, rel=2e-3)

    def test_on_a_model_that_contains_factors(self):
        """The rebuilt model gives the same factors of the exported one, and the same state."""
        model, recipe = duct_model()
        truth = {"stiffness.structure": 1.05, "beta.structure": 1.5, "part": 0.98}
        values = measured(model, recipe, truth, TIGHT, 0.005)
        first = fit_factors(problem(affine(model, recipe), values, tuple(truth)))
        p = problem(affine(*with_factors(model, recipe, first.factors)), values, tuple(truth), base=first.factors)
        theta = first.moved(p)
        np.testing.assert_allclose(theta[SPRINGS:], 0.0, atol=1e-12)
        second = fit_factors(p, theta)
        for name in truth:
            assert second.factors[name] == pytest.approx(first.factors[name], rel=5e-3)
        assert p.misfit(1.0)(theta).total == pytest.approx(first.problem.misfit(1.0)(first.solution.theta).total, rel=1e-6)

    @pytest.mark.slow
    def test_what_cannot_be_told_apart_is_said(self):
        """The same share twice: their product is determined, the prior shares it; a third factor is none of it."""
        model, _ = duct_model()
        model = replace(model, extras={"part": model.extras["part"], "same": model.extras["part"]})
        recipe = make_recipe(COEFFICIENTS, True, True, {name: list(group) for name, group in model.extras.items()})
        truth = {"stiffness.acoustic": 1.02, "part": 1.04, "same": 1.0}
        values = measured(model, recipe, truth, TIGHT, 0.01)
        fit = fit_factors(problem(affine(model, recipe), values, tuple(truth)))
        assert fit.notes[-1] == (
            "part and same cannot be distinguished by these FRFs: only their combination is determined, the prior divides it between them"
        )
        # Half each, and neither is known.
        assert fit.logarithms["part"] == pytest.approx(fit.logarithms["same"], abs=1e-3)
        assert sum(fit.logarithms[name] for name in ("part", "same")) == pytest.approx(np.log(1.04), abs=3e-3)
        assert min(fit.spread[name] for name in ("part", "same")) > 0.03
        names = ("stiffness.acoustic", "part")
        notes = fit_factors(problem(affine(model, recipe), values, names)).notes
        assert not [note for note in notes if "cannot be distinguished" in note]

    def test_a_loss_factor(self):
        """Damping that is hysteretic beside a proportional start: found, and what the three come to is told."""
        model, recipe = duct_model(loss=(0.005, 0.0))
        damping = ("alpha.structure", "beta.structure", "loss_factor.structure")
        truth = {"stiffness.structure": 1.02, "alpha.structure": 0.3, "beta.structure": 0.3, "loss_factor.structure": 6.0}
        values = measured(model, recipe, truth, TIGHT, 0.01)
        fit = fit_factors(problem(affine(model, recipe), values, tuple(truth)))
        without = fit_factors(problem(affine(model, recipe), values, tuple(truth)[:3]))
        assert fit.solution.evaluation.misfit_db < 0.5 * without.solution.evaluation.misfit_db
        low, high = fit.interval("loss_factor.structure")
        assert low < 6.0 < high

        (losses, _) = fit.problem.losses(fit.solution.theta, fit.covariance)
        assert losses.names == damping
        total, spread, hz = losses.best_known()
        exact = 0.3 * COEFFICIENTS[0][0] / (2 * np.pi * hz) + 0.3 * COEFFICIENTS[0][1] * 2 * np.pi * hz + 0.03
        assert total == pytest.approx(exact, rel=4 * spread)
        assert spread < 0.05
        (note,) = apart_notes([(damping, True)], [losses])
        assert "loss factor alpha / omega + beta omega + loss_factor of field structure is" in note
        assert f"is {total:.3g} (" in note
        assert f") at {hz:.4g} Hz" in note

    @pytest.mark.slow
    def test_what_damps_alike_is_told_as_one(self):
        """On lines of few resonances: the loss factor that alpha, beta and eta come to."""
        model, recipe = duct_model(loss=(0.005, 0.0))
        truth = {"beta.structure": 0.3, "loss_factor.structure": 6.0}
        values = measured(model, recipe, truth, TIGHT, 0.01)
        lines = np.flatnonzero(FREQUENCY >= 200.0)
        fit = fit_factors(problem(affine(model, recipe), values, tuple(truth), selected=lines))
        (note,) = (note for note in fit.notes if "be distinguished" in note)
        assert note.startswith("beta.structure and loss_factor.structure cannot be distinguished by these FRFs: only their combination")
        told = re.search(r"of field structure is (\S+) \((\S+) to (\S+)\) at (\S+) Hz", note)
        value, low, high, hz = map(float, told.groups())
        assert low < value < high < 1.2 * low
        exact = COEFFICIENTS[0][0] / (2 * np.pi * hz) + 0.3 * COEFFICIENTS[0][1] * 2 * np.pi * hz + 0.03
        assert value == pytest.approx(exact, rel=0.1)

    @pytest.mark.slow
    def test_what_lies_at_a_bound_is_said(self):
        """Air half as heavy is beyond the bounds of its mass."""
        model, recipe = duct_model()
        fit = fit_factors(problem(affine(model, recipe), measured(model, recipe, {"mass.acoustic": 0.5}, TIGHT, 0.01), ("mass.acoustic",)))
        assert any("at its bound" in note for note in fit.notes)


#: Of a structure beside air, with a part whose stiffness, and one whose damping, has a factor of its own.
FAR = make_recipe(((2.0, 4e-6), (1.0, 0.0)), True, groups={"part_2": ("stiffness",), "dashpots": ("damping",)})


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        # A lid over a cavity: 370.4 m/s for 343.2, a loss factor of 0.1 for 0.01, 2.5 for 3 mm.
        ({"sound_speed": 0.926}, "the calibration multiplies the speed of sound by 0.926: check the speed of sound"),
        ({"sound_speed": 1.04}, "the speed of sound by 1.04, as of air 24 K warmer: check"),
        ({"mass.acoustic": 1.1}, "the speed of sound by 0.953, as of air 27 K colder"),
        (
            {"loss_factor.structure": 0.099},
            "the loss factor of structure by 0.099: in model.damping, or in the FE model, it is probably 10 t",
        ),
        ({"loss_factor.acoustic": 8.0}, "8 times too small"),
        ({"stiffness.structure": 1.3}, "multiplies the stiffness of the structure by 1.3, more than materials scatter: the FE model is"),
        ({"mass.structure": 0.8}, "multiplies the mass of the structure by 0.8"),
        # FRFs hardly tell one from the other.
        ({"stiffness.structure": 1.26, "mass.structure": 0.741}, "the quotient of stiffness and mass of the structure by 1.7"),
        ({"part_2": 1.2}, "the calibration multiplies part_2 by 1.2, more than materials scatter"),
    ],
)
def test_a_factor_far_from_one_is_told(factors: dict[str, float], said: str) -> None:
    (text,) = far_factors(factors, FAR)
    assert said in text


def test_factors_that_materials_rooms_and_guessed_damping_explain_are_not_told() -> None:
    usual = {"stiffness.structure": 1.15, "mass.structure": 1.1, "loss_factor.structure": 5.0, "part_2": 0.87, "dashpots": 9.0}
    air = {"sound_speed": 1.02, "mass.acoustic": 1.3, "stiffness.acoustic": 1.3}
    assert far_factors(usual | air | {"alpha.structure": 30.0, "beta.structure": 0.01, "damping.structure": 20.0}, FAR) == []


class TestApart:
    """Against linear problems whose weak directions are known."""

    NAMES = ("a", "b", "c")
    STD = np.array([0.05, 0.05, 1.0])

    def found(self, data, others=None):
        return indistinguishable(self.NAMES, data, self.STD, np.zeros((0, 0)) if others is None else others)

    @pytest.mark.parametrize(
        ("correlation", "said"), [(0.0, False), (0.9, False), (0.97, False), (-0.97, False), (0.985, True), (-0.985, True)]
    )
    def test_two(self, correlation, said):
        R = np.eye(3)
        R[0, 1] = R[1, 0] = correlation
        data = 30.0 * np.linalg.cholesky(R).T
        assert self.found(data) == ([(("a", "b"), True)] if said else [])

    def test_units_do_not_matter(self):
        data = np.random.default_rng(0).normal(size=(50, 3)) * 100.0
        data[:, 2] = 1e-3 * data[:, 0] * (1 + 1e-6)
        ((names, left),) = indistinguishable(self.NAMES, data, np.array([0.05, 0.05, 50.0]), np.zeros((0, 0)))
        assert names == ("a", "c")
        assert left

    def test_three(self):
        """Each pair is told apart, the three are not."""
        data = np.random.default_rng(0).normal(size=(200, 3)) * 100.0
        data[:, 2] = data[:, 0] + data[:, 1]
        assert self.found(data) == [(("a", "b", "c"), True)]

    def test_by_what_else_is_unknown(self):
        """Two factors that differ by what a third unknown can do as well, unless its prior holds it."""
        rng = np.random.default_rng(0)
        common, other = rng.normal(size=(2, 200)) * 100.0
        data = np.column_stack([common, common + other, rng.normal(size=200), other])
        assert self.found(data, np.array([[1.0]])) == [(("a", "b"), True)]
        assert self.found(data, np.array([[1e9]])) == []

    def test_a_factor_that_nothing_feels(self):
        data = np.random.default_rng(0).normal(size=(50, 3)) * 100.0
        data[:, 1] = 0.0
        assert self.found(data) == []

    def test_with_data_that_would_tell_but_for_the_model(self):
        rng = np.random.default_rng(0)
        common = rng.normal(size=200)
        data = 1e5 * np.column_stack([common, common + 0.05 * rng.normal(size=200), rng.normal(size=200)])
        assert self.found(data) == [(("a", "b"), False)]
        (note,) = apart_notes(self.found(data))
        assert "prior" not in note


@pytest.mark.parametrize(("value", "told"), [(-2.0, True), (-1.9986, True), (-1.9, False), (0.0, False), (1.995, True)])
def test_a_damping_exponent_that_creeps_up_to_its_bound_is_told(value: float, told: bool) -> None:
    """A descent may stop short of the bound, since less and less changes towards it."""
    P = springs(damped=True)
    theta = P.initial.copy()
    (_, _, at), *_ = P.placed
    theta[at] = value
    notes = damping_at_bounds(P, theta)
    assert bool(notes) is told
    assert not told or notes[0].startswith("springs: the damping exponent is at its bound")
    assert damping_at_bounds(springs(), springs().initial) == []


def test_damping_that_no_joint_has_is_told() -> None:
    P, hz = springs(damped=True), np.linspace(20.0, 400.0, 50)
    theta = P.initial.copy()
    (group, _, at), *_ = P.placed
    theta[at] = -np.log10(abs(group.damping.loss(np.array([2j * np.pi * 400.0]))[0]))
    for by, told in ((-0.01, False), (0.01, True)):
        notes = overdamped(P, theta + by * (np.arange(theta.size) == at), hz)
        assert bool(notes) is told
        assert not told or notes[0].startswith("springs: a loss factor of 1 at 400 Hz, more than any joint has")
    assert overdamped(springs(), springs().initial, hz) == []
