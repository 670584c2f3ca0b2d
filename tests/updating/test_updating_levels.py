"""Start values by levels, and what is identified from them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pads import PADS, S, loosened, pads_model, pads_ports
from scipy.optimize import least_squares
from sharp import sharp_misfit
from systems import direct_frf

from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import port_model
from lrbc_cli.updating.search.descent import Level, even_hats, level_matrix
from lrbc_cli.updating.search.ends import near_tie, other_ends
from lrbc_cli.updating.search.levels import gauss_newton_by_levels
from lrbc_cli.updating.search.optimise import Start, bfgs, gauss_newton
from lrbc_cli.updating.search.starts import basins, group_levels, uniform_values


def problem(*, eta=1e-3, at=(4, 5, 6), noise_db=0.0, **more):
    """A cost whose true theta is known; the measurement comes from direct solves."""
    model, parameters = pads_model(**more)
    truth = loosened(parameters, at=at)
    y = direct_frf(model, S, parameters.dynamic(truth, S))
    y = y * 10.0 ** (np.random.default_rng(0).normal(scale=noise_db, size=y.shape) / 20)
    return Misfit(port_model(pads_ports(model), parameters), y, parameters.initial, eta), parameters, truth


class TestHats:
    def test_they_interpolate(self):
        positions = np.linspace(0.2, 1.0, 17)
        T = even_hats(positions, 5)
        assert T.shape == (17, 5)
        np.testing.assert_allclose(T.sum(axis=1), 1.0)
        np.testing.assert_allclose(T @ np.linspace(0.2, 1.0, 5), positions)
        np.testing.assert_allclose(T[::4], np.eye(5), atol=1e-12)

    def test_one_knot_and_one_position(self):
        np.testing.assert_array_equal(even_hats(np.linspace(0, 1, 4), 1), np.ones((4, 1)))
        np.testing.assert_array_equal(even_hats(np.array([0.3]), 5), np.ones((1, 1)))


class TestLevelMatrix:
    def test_groups_and_damping_have_their_own_columns(self):
        _, parameters = pads_model(extras=True)
        T = level_matrix(parameters, 3, damping=True)
        # Three hats, p_damp, the dashpot, the mass.
        assert T.shape == (PADS + 3, 6)
        np.testing.assert_allclose(T.sum(axis=1), 1.0)
        np.testing.assert_array_equal(T[PADS], np.eye(6)[3])
        np.testing.assert_array_equal(T[PADS + 1 :], np.eye(6)[4:])
        without = level_matrix(parameters, 3, damping=False)
        assert without.shape == (PADS + 3, 5)
        assert not without[PADS].any()

    def test_short_groups_keep_every_value(self):
        _, parameters = pads_model()
        np.testing.assert_array_equal(level_matrix(parameters, PADS, damping=True), np.eye(PADS + 1))


def with_positions(parameters, positions):
    """The same pads elsewhere along the edge."""
    group = dataclasses.replace(parameters.groups[0], arc_length=np.asarray(positions, dtype=float))
    return Parameterisation((group, *parameters.groups[1:]))


@pytest.mark.parametrize(
    "positions",
    [
        pytest.param([0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 1.0], id="one far away"),
        pytest.param([0.0, 0.1, 0.1, 0.1, 0.2, 0.2, 0.9, 0.9, 1.0, 1.0], id="coinciding"),
        pytest.param(np.zeros(10), id="all in one place"),
    ],
)
def test_uneven_positions(positions):
    """Knots that no term is near to must not stop the identification."""
    misfit, parameters, _ = problem()
    parameters = with_positions(parameters, positions)
    misfit = Misfit(dataclasses.replace(misfit.model, parameters=parameters), 10.0 ** (misfit.target / 20), misfit.prior, 1e-3)
    for knots in (3, 5, 9):
        T = level_matrix(parameters, knots, damping=True)
        level = Level(misfit, parameters.initial, T)
        bounds = level.bounds(parameters.bounds)
        assert bounds.shape == (T.shape[1], 2)
        assert np.all(bounds[:, 0] <= 0)
        assert np.all(bounds[:, 1] >= 0)
    solution = gauss_newton_by_levels(misfit, parameters.initial, parameters.bounds, max_iterations=20)
    assert solution.status in ("converged", "stopped")


class TestLevel:
    def test_chain_rule(self):
        misfit, parameters, _ = problem()
        T = level_matrix(parameters, 5, damping=True)
        level = Level(misfit, parameters.initial, T)
        z = np.random.default_rng(1).uniform(-0.4, 0.4, size=T.shape[1])
        value, full = level(z), misfit(parameters.initial + T @ z)
        assert value.total == pytest.approx(full.total, rel=1e-14)
        np.testing.assert_allclose(value.gradient, T.T @ full.gradient, rtol=1e-10)

    def test_bounds_keep_theta_inside(self):
        misfit, parameters, _ = problem()
        rng = np.random.default_rng(1)
        for knots in (3, 5, 9):
            T = level_matrix(parameters, knots, damping=True)
            theta = parameters.bounds[:, 0] + rng.uniform(size=parameters.size) * np.diff(parameters.bounds, axis=1)[:, 0]
            level = Level(misfit, theta, T)
            bounds = level.bounds(parameters.bounds)
            assert np.all(bounds[:, 0] <= 0)
            assert np.all(bounds[:, 1] >= 0)
            # From an even profile, as the first level has it, the bounds are kept exactly.
            even = Level(misfit, parameters.initial, T)
            for corner in (0, 1):
                found = even.theta(even.bounds(parameters.bounds)[:, corner])
                assert np.all(found >= parameters.bounds[:, 0] - 1e-12)
                assert np.all(found <= parameters.bounds[:, 1] + 1e-12)


def test_uniform_values_leave_the_damping_alone():
    misfit, parameters, _ = problem()
    tried = uniform_values(misfit, parameters.initial, parameters.bounds)
    assert len(tried) > 5
    for theta in tried:
        assert np.ptp(theta[:PADS]) == 0.0
        assert theta[PADS] == parameters.initial[PADS]
    np.testing.assert_allclose([tried[0][0], tried[-1][0]], parameters.bounds[0])


class TestRecovery:
    """The measurement is made by the model itself from a known state: it has to be found."""

    @pytest.mark.parametrize(
        "at", [(4, 5, 6), (0, 1), tuple(range(PADS)), *(pytest.param(at, marks=pytest.mark.slow) for at in ((9,), (7, 8), ()))]
    )
    @pytest.mark.parametrize("initial", [3.0, pytest.param(6.5, marks=pytest.mark.slow)])
    def test_by_levels(self, at, initial):
        misfit, parameters, truth = problem(at=at, initial=initial, eta=1e-5)
        solution = gauss_newton_by_levels(misfit, parameters.initial, parameters.bounds, tolerance=1e-8, max_iterations=200)
        assert solution.status in ("converged", "stopped")
        assert solution.evaluation.misfit_db < 0.05
        found, expected = (np.log10(parameters.scales(theta)) for theta in (solution.theta, truth))
        np.testing.assert_allclose(found, expected, atol=0.1)
        assert solution.theta[PADS] == pytest.approx(truth[PADS], abs=0.1)

    def test_history_is_one_list(self):
        misfit, parameters, _ = problem()
        solution = gauss_newton_by_levels(misfit, parameters.initial, parameters.bounds)
        assert solution.evaluations == len(solution.history)
        assert [entry.evaluation for entry in solution.history] == list(range(solution.evaluations))
        assert solution.evaluation.total == pytest.approx(misfit(solution.theta).total)
        accepted = [entry.cost for entry in solution.history if entry.accepted]
        assert solution.evaluation.cost == pytest.approx(min(accepted), abs=1e-9)

    def test_never_worse_than_all_at_once(self):
        """A start on the clamped plateau, where all nodes at once run into another basin or crawl."""
        misfit, parameters, _ = problem(initial=6.9)
        by_levels = gauss_newton_by_levels(misfit, parameters.initial, parameters.bounds)
        at_once = gauss_newton(misfit, parameters.initial, parameters.bounds)
        assert by_levels.evaluation.total <= 1.05 * at_once.evaluation.total

    def test_noise_is_not_chased(self):
        """Half a decibel of noise leaves half a decibel of misfit, and the loose pads loose."""
        misfit, parameters, truth = problem(noise_db=0.5, eta=1.0)
        solution = gauss_newton_by_levels(misfit, parameters.initial, parameters.bounds)
        assert 0.3 < solution.evaluation.misfit_db < 0.55
        found, expected = (np.log10(parameters.scales(theta)) for theta in (solution.theta, truth))
        loose = np.array([4, 5, 6])
        assert found[loose].mean() < np.delete(found, [3, 4, 5, 6, 7]).mean() - 1.0
        assert np.abs(found - expected)[[0, 1, 8, 9]].max() < 1.0

    def test_no_better_minimum_next_to_it(self):
        """Another solver of bounded least squares, started there, gains nothing."""
        misfit, parameters, _ = problem(noise_db=0.5, eta=0.3)
        solution = gauss_newton_by_levels(misfit, parameters.initial, parameters.bounds, tolerance=1e-6)
        low, high = parameters.bounds.T
        inside = np.clip(solution.theta, low + 1e-9, high - 1e-9)
        polished = least_squares(lambda x: misfit(x).residual, inside, lambda x: misfit(x).jacobian, (low, high), ftol=1e-10)
        assert solution.evaluation.total < 1.001 * 2 * polished.cost

    def test_bfgs_of_the_paper_gets_there_too(self):
        misfit, parameters, truth = problem(initial=4.0, eta=1e-5)
        solution = bfgs(misfit, parameters.initial, parameters.bounds, tolerance=1e-7, max_iterations=500)
        assert solution.evaluation.misfit_db < 0.3
        found, expected = (np.log10(parameters.scales(theta)) for theta in (solution.theta, truth))
        np.testing.assert_allclose(found, expected, atol=0.3)

    def test_dashpots_and_masses_too(self):
        """Stiffness, damping and mass terms and p_damp together, from a start in the neighbourhood."""
        misfit, parameters, truth = problem(extras=True, eta=0.0, at=())
        truth[-2:] = 0.8, -1.9
        model, _ = pads_model(extras=True)
        misfit = Misfit(misfit.model, direct_frf(model, S, parameters.dynamic(truth, S)), parameters.initial, 0.0)
        start = truth + np.random.default_rng(0).uniform(-0.03, 0.03, size=truth.size)
        solution = gauss_newton(misfit, start, parameters.bounds, tolerance=1e-9)
        assert solution.evaluation.misfit_db < 1e-3
        np.testing.assert_allclose(solution.theta[-2:], [0.8, -1.9], atol=1e-3)
        np.testing.assert_allclose(parameters.scales(solution.theta), parameters.scales(truth), rtol=1e-2)


class TestGroups:
    """Two groups of joints that are off by different amounts, peaks between the lines: one level for all leads astray, to 11 to 21 dB."""

    @staticmethod
    def parts(count, initial=4.5):
        """The pads as two groups of ``count`` values each."""
        group = pads_model()[1].groups[0]
        half = np.arange(PADS).reshape(2, -1)
        own = dict(initial=np.full(count, initial), bounds=np.tile([0.0, 7.0], (count, 1)), smoothing=np.eye(count), damping=None)
        own |= dict(parameter=np.arange(PADS // 2) % count, xyz=None, arc_length=None, bolt=np.arange(count))
        return Parameterisation(tuple(dataclasses.replace(group, name=str(k), terms=at, **own) for k, at in enumerate(half)))

    @staticmethod
    def exact(parameters, truth):
        model = pads_model()[0]
        y = direct_frf(model, S, parameters.dynamic(truth, S))
        return Misfit(port_model(pads_ports(model), parameters), y, parameters.initial, 1e-5)

    @pytest.mark.parametrize("truth", [(2.5, 6.0), (6.0, 2.5), (5.5, 3.5), (3.0, 5.0)])
    @pytest.mark.parametrize("initial", [3.0, 6.5])
    def test_levels_that_differ(self, truth, initial):
        parameters = self.parts(1, initial)
        misfit = self.exact(parameters, np.array(truth))
        solution = gauss_newton_by_levels(misfit, parameters.initial, parameters.bounds)
        np.testing.assert_allclose(solution.theta, truth, atol=1e-3)

    @pytest.mark.slow
    def test_single_values_that_differ(self):
        """Levels alone leave 3.4 dB."""
        parameters = self.parts(PADS // 2)
        theta = np.repeat([6.0, 2.5], PADS // 2) + np.random.default_rng(1).normal(scale=0.15, size=PADS)
        misfit = self.exact(parameters, theta)
        solution = gauss_newton_by_levels(misfit, parameters.initial, parameters.bounds)
        assert solution.evaluation.misfit_db < 1e-3
        np.testing.assert_allclose(solution.theta, theta, atol=0.01)

    def test_one_group_has_no_levels_of_its_own(self):
        misfit, parameters, _ = problem()
        assert group_levels(misfit, parameters.initial, parameters.bounds) == []


class TestBasins:
    def test_two_valleys_and_the_given_start(self):
        assert basins([9.0, 5.0, 2.0, 6.0, 1.0, 4.0]) == [4, 2, 0]

    def test_one_valley_and_the_given_start(self):
        assert basins([3.0, 5.0, 4.0, 2.0, 4.0]) == [3, 0]

    def test_a_fall_to_the_end_is_a_valley(self):
        assert basins([3.0, 5.0, 4.0, 2.0]) == [3, 0]

    def test_values_without_a_cost_are_passed_over(self):
        assert basins([3.0, np.inf, np.inf, 2.0, np.inf]) == [3, 0]
        assert basins([3.0, np.inf, np.inf]) == [0]


class Spy:
    """A cost that keeps every place at which it was evaluated."""

    def __init__(self, misfit):
        self.misfit, self.seen = misfit, []

    def __call__(self, theta):
        value = self.misfit(theta)
        self.seen.append((value.total, theta.copy()))
        return value

    def __getattr__(self, name):
        return getattr(self.misfit, name)

    def least(self, bounds):
        """Lowest cost between the bounds."""
        return min(total for total, theta in self.seen if np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1])))


class TestSharpResonances:
    """Next to no damping, lines wider apart than the peaks: a cost full of valleys, in which descents and the scan go astray."""

    @pytest.mark.parametrize("truth", [3.0, 3.6])
    @pytest.mark.parametrize("offset", [-0.03, 0.01])
    def test_never_worse_than_a_place_seen(self, truth, offset):
        misfit = sharp_misfit(truth)
        bounds, start = misfit.model.parameters.bounds, np.array([truth + offset])
        spy = Spy(misfit)
        solution = gauss_newton_by_levels(spy, start, bounds)
        assert solution.evaluation.total <= misfit(start).total
        assert solution.evaluation.total <= spy.least(bounds) * (1 + 1e-9)
        assert solution.evaluation.total == pytest.approx(misfit(solution.theta).total)

    @pytest.mark.slow
    def test_many_values(self):
        misfit = sharp_misfit(3.0, shared=False)
        bounds = misfit.model.parameters.bounds
        start = 3.0 + np.random.default_rng(0).normal(scale=0.02, size=bounds.shape[0])
        spy = Spy(misfit)
        solution = gauss_newton_by_levels(spy, start, bounds, max_iterations=20)
        assert solution.evaluation.total <= misfit(start).total
        assert solution.evaluation.total <= spy.least(bounds) * (1 + 1e-9)

    @pytest.mark.parametrize("beta", [1e-4, 4e-7, 0.0])
    def test_exact_data_of_one_value(self, beta):
        """From 4 % of damping at 100 Hz to none: the scan alone ended 0.04 decades away, with a misfit of 1.5 dB."""
        misfit = sharp_misfit(3.0, beta=beta)
        solution = gauss_newton_by_levels(misfit, np.array([3.05]), misfit.model.parameters.bounds)
        assert solution.theta[0] == pytest.approx(3.0, abs=1e-3)
        assert solution.evaluation.misfit_db < 1e-6

    @pytest.mark.slow
    def test_exact_data_of_many_equal_values(self):
        misfit = sharp_misfit(3.0, beta=4e-7, shared=False)
        bounds = misfit.model.parameters.bounds
        solution = gauss_newton_by_levels(misfit, np.full(bounds.shape[0], 3.05), bounds)
        np.testing.assert_allclose(solution.theta, 3.0, atol=1e-3)

    @pytest.mark.parametrize("optimise", [gauss_newton, bfgs])
    @pytest.mark.parametrize("start", [2.7, 3.2, 3.45])
    def test_a_single_descent(self, optimise, start):
        misfit = sharp_misfit(3.0)
        bounds, spy = misfit.model.parameters.bounds, Spy(misfit)
        solution = optimise(spy, np.array([start]), bounds)
        assert solution.evaluation.total <= spy.least(bounds)


class TestStarts:
    def test_where_each_led_to(self):
        misfit, parameters, truth = problem()
        solution = gauss_newton_by_levels(misfit, parameters.initial, parameters.bounds, further={"the truth": truth})
        assert [start.description for start in solution.starts][-1] == "the truth"
        # The two basins of the scan, the given start, the uniform value by smaller steps, and the one described.
        assert len(solution.starts) == 5
        assert solution.starts[2].description == "start values of the campaign"
        (kept,) = [start for start in solution.starts if start.kept]
        assert kept.total == solution.evaluation.total == min(start.total for start in solution.starts)
        np.testing.assert_array_equal(kept.theta, solution.theta)
        assert solution.evaluations == len(solution.history)

    def test_near_tie(self):
        _, parameters, truth = problem()
        other = truth.copy()
        other[:PADS] += np.where(np.arange(PADS) % 4 < 2, 0.5, -0.5)

        def start(cost, theta, kept=False):
            return Start(description="there", cost=cost, total=10.0**cost, kept=kept, theta=theta)

        best, second, apart = near_tie(parameters, (start(2.04, other), start(2.0, truth, True), start(2.5, truth)))
        assert (best.cost, second.cost) == (2.0, 2.04)
        assert apart > 0.25
        assert near_tie(parameters, (start(2.06, other), start(2.0, truth, True))) is None
        assert near_tie(parameters, (start(2.0, truth + 0.01), start(2.0, truth, True))) is None
        assert near_tie(parameters, (start(2.0, truth, True),)) is None
        # The result is neither of the two.
        assert near_tie(parameters, (start(2.04, other), start(2.0, truth), start(2.5, truth, True))) is None
        assert near_tie(parameters, ()) is None

    def test_other_ends_are_about_as_good_and_apart(self):
        """Several descents end in one place: the next best of them says nothing that the best did not say."""
        _, parameters, truth = problem()
        moved = [truth.copy() for _ in range(4)]
        for k in range(3):
            moved[k][k] -= 0.3
        moved[3][PADS] += 2.0

        def start(cost, theta):
            return Start(description="there", cost=cost, total=10.0**cost, kept=False, theta=theta)

        ends = [start(2.03, moved[1]), start(2.0, truth), start(2.001, truth + 0.01), start(2.02, moved[0]), start(2.06, moved[2])]
        ends += [start(2.01, moved[3])]
        found = other_ends(parameters, ends)
        assert len(found) == 2
        np.testing.assert_array_equal(found, moved[:2])
        assert len(other_ends(parameters, ends, tie=0.1)) == 3
        assert len(other_ends(parameters, ends, tie=0.1, kept=1)) == 1
        assert other_ends(parameters, ends[1:2]) == other_ends(parameters, []) == []

    def test_the_damping_exponent_makes_no_tie(self):
        """Where nothing is loose the FRFs do not depend on it."""
        _, parameters, truth = problem()
        other = truth.copy()
        other[PADS] += 2.0
        assert (
            near_tie(
                parameters,
                (
                    Start(description="a", cost=2.0, total=100.0, kept=True, theta=truth),
                    Start(description="b", cost=2.0, total=100.0, kept=False, theta=other),
                ),
            )
            is None
        )
