"""Both optimisers on least squares with known minima, bounds, limits and failures."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from lrbc_cli.updating.misfit.cost import Evaluation
from lrbc_cli.updating.search.optimise import bfgs, gauss_newton

OPTIMISERS = [pytest.param(gauss_newton, id="gauss-newton"), pytest.param(bfgs, id="bfgs")]


def evaluation(residual, jacobian):
    total = max(float(residual @ residual), np.finfo(float).tiny)
    return Evaluation(
        cost=float(np.log10(total)),
        total=total,
        data=total,
        misfit_db=float(np.mean(np.abs(residual))),
        residual=residual,
        jacobian=jacobian,
    )


def linear(A, b):
    """|A x - b|² and a floor that no x removes, so that log10 has a minimum."""
    rows = np.vstack([A, np.zeros((1, A.shape[1]))])
    return lambda x: evaluation(np.append(A @ x - b, 1.0), rows)


def curved(x):
    """Rosenbrock's valley as residuals, with a floor; minimum at (1, 1)."""
    residual = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0], 0.1])
    return evaluation(residual, np.array([[-20 * x[0], 10.0], [-1.0, 0.0], [0.0, 0.0]]))


def wide(n, half=50.0):
    return np.tile([-half, half], (n, 1))


def rising(history):
    """Costs of the accepted evaluations never rise."""
    costs = [entry.cost for entry in history if entry.accepted]
    return any(later > earlier + 1e-12 for earlier, later in itertools.pairwise(costs))


@pytest.mark.parametrize("optimise", OPTIMISERS)
class TestBoth:
    def test_linear_least_squares(self, optimise):
        rng = np.random.default_rng(0)
        A, b = rng.normal(size=(20, 6)), rng.normal(size=20)
        solution = optimise(linear(A, b), np.zeros(6), wide(6), tolerance=1e-10)
        assert solution.status == "converged"
        np.testing.assert_allclose(solution.theta, np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-4)

    @given(seed=st.integers(0, 2**31))
    @settings(max_examples=20, deadline=None)
    def test_active_bounds(self, optimise, seed):
        """The constrained minimum, with some parameters at their bounds, from a corner that is wrong."""
        rng = np.random.default_rng(seed)
        A, b = rng.normal(size=(15, 5)), 3 * rng.normal(size=15)
        bounds = np.column_stack([rng.uniform(-0.6, -0.1, size=5), rng.uniform(0.1, 0.6, size=5)])
        best = lsq_linear(A, b, bounds.T, tol=1e-12)
        solution = optimise(linear(A, b), bounds[:, rng.integers(0, 2)], bounds, tolerance=1e-10, max_iterations=500)
        assert solution.status == "converged", solution.reason
        assert np.all((solution.theta >= bounds[:, 0]) & (solution.theta <= bounds[:, 1]))
        assert solution.evaluation.total <= (2 * best.cost + 1.0) * (1 + 1e-6)
        np.testing.assert_allclose(solution.theta, best.x, atol=3e-3)

    def test_a_curved_valley(self, optimise):
        solution = optimise(curved, np.array([-1.2, 1.0]), wide(2), tolerance=1e-9, max_iterations=300)
        assert solution.status == "converged"
        np.testing.assert_allclose(solution.theta, [1.0, 1.0], atol=2e-3)
        assert not rising(solution.history)

    def test_a_start_outside_is_brought_inside(self, optimise):
        bounds = np.array([[0.0, 1.0], [0.0, 1.0]])
        seen = []

        def spy(x):
            seen.append(x.copy())
            return linear(np.eye(2), np.array([0.5, 0.25]))(x)

        solution = optimise(spy, np.array([7.0, -3.0]), bounds, tolerance=1e-10)
        np.testing.assert_array_equal(seen[0], [1.0, 0.0])
        assert np.min(seen) >= 0
        assert np.max(seen) <= 1
        np.testing.assert_allclose(solution.theta, [0.5, 0.25], atol=1e-4)

    def test_all_parameters_at_their_bounds(self, optimise):
        bounds = np.array([[0.0, 1.0], [0.0, 1.0]])
        solution = optimise(linear(np.eye(2), np.array([5.0, -5.0])), np.array([1.0, 0.0]), bounds)
        assert solution.status == "converged"
        assert solution.evaluations == 1
        np.testing.assert_array_equal(solution.theta, [1.0, 0.0])

    def test_the_iteration_limit_is_no_failure(self, optimise):
        solution = optimise(curved, np.array([-1.2, 1.0]), wide(2), tolerance=0.0, max_iterations=3)
        assert solution.status == "stopped"
        assert "3 iterations" in solution.reason
        assert solution.iterations == 3
        assert solution.evaluation.total < curved(np.array([-1.2, 1.0])).total
        assert solution.evaluation.total == pytest.approx(curved(solution.theta).total)

    @pytest.mark.parametrize("bad", [np.nan, np.inf])
    def test_a_start_that_cannot_be_evaluated_fails(self, optimise, bad):
        solution = optimise(lambda x: evaluation(np.array([bad, 1.0]), np.ones((2, 2))), np.zeros(2), wide(2))
        assert solution.status == "failed"
        assert "start" in solution.reason
        assert solution.evaluations == 1

    def test_a_pocket_that_cannot_be_evaluated_is_walked_around(self, optimise):
        def holed(x):
            value = linear(np.eye(2), np.array([2.0, 2.0]))(x)
            return evaluation(value.residual * (np.nan if x[0] > 2.5 or x[1] > 2.5 else 1.0), value.jacobian)

        solution = optimise(holed, np.zeros(2), wide(2), tolerance=1e-9)
        assert solution.status == "converged"
        np.testing.assert_allclose(solution.theta, 2.0, atol=1e-2)

    def test_no_step_is_longer_than_a_decade(self, optimise):
        seen = [np.zeros(2)]

        def spy(x):
            seen.append(x.copy())
            return linear(np.eye(2), np.array([30.0, -20.0]))(x)

        solution = optimise(spy, np.zeros(2), wide(2), tolerance=1e-10)
        np.testing.assert_allclose(solution.theta, [30.0, -20.0], atol=1e-2)
        accepted = np.array(seen[1:])[[entry.accepted for entry in solution.history]]
        assert np.abs(np.diff(accepted, axis=0)).max() <= 1.0 + 1e-9

    def test_history_counts_every_evaluation(self, optimise):
        calls = []

        def counted(x):
            calls.append(x)
            return curved(x)

        solution = optimise(counted, np.array([-1.2, 1.0]), wide(2))
        assert solution.evaluations == len(calls) == len(solution.history)
        assert [entry.evaluation for entry in solution.history] == list(range(len(calls)))
        assert solution.history[0].accepted
        # What is returned was accepted.
        accepted = [entry.cost for entry in solution.history if entry.accepted]
        assert solution.evaluation.cost == pytest.approx(accepted[-1])
        assert accepted[-1] == pytest.approx(min(accepted))

    def test_parameters_without_influence_stay(self, optimise):
        """A saturated stiffness has a zero column; a nearly saturated one has a tiny column, and may go anywhere between its bounds."""
        A = np.array([[1.0, 0.0, 0.0], [0.5, 0.0, 1e-9], [0.2, 0.0, 0.0]])
        solution = optimise(linear(A, np.array([1.0, 0.4, 0.3])), np.array([0.0, 0.3, 0.4]), wide(3, 5.0), tolerance=1e-9)
        assert solution.status == "converged"
        assert solution.theta[0] == pytest.approx(np.linalg.lstsq(A[:, :1], [1.0, 0.4, 0.3], rcond=None)[0][0], abs=1e-3)
        assert solution.theta[1] == 0.3
        assert abs(solution.theta[2]) <= 5.0

    def test_nothing_has_influence(self, optimise):
        solution = optimise(linear(np.zeros((3, 2)), np.ones(3)), np.array([0.1, 0.2]), wide(2))
        assert solution.status == "converged"
        np.testing.assert_array_equal(solution.theta, [0.1, 0.2])

    def test_sensitivities_of_very_different_size(self, optimise):
        """Eight decades between columns: no warning of a bad condition, the strong ones are found."""
        rng = np.random.default_rng(2)
        A = rng.normal(size=(30, 6)) * 10.0 ** np.array([0, -1, -2, -4, -6, -8])
        x = np.array([0.4, -0.3, 0.2, 0.1, 0.0, 0.0])
        solution = optimise(linear(A, A @ x), np.zeros(6), wide(6, 3.0), tolerance=1e-12, max_iterations=400)
        np.testing.assert_allclose(solution.theta[:2], x[:2], atol=2e-2)
        assert np.all(np.isfinite(solution.theta))

    def test_one_parameter(self, optimise):
        solution = optimise(linear(np.array([[2.0]]), np.array([1.0])), np.zeros(1), wide(1), tolerance=1e-10)
        np.testing.assert_allclose(solution.theta, 0.5, atol=1e-4)


class TestGaussNewton:
    def test_few_evaluations_on_a_linear_problem(self):
        rng = np.random.default_rng(0)
        A, b = rng.normal(size=(20, 6)), rng.normal(size=20)
        assert gauss_newton(linear(A, b), np.zeros(6), wide(6)).evaluations <= 8

    def test_undamped_end(self):
        """Converges fast on a zero-residual problem: the damping dies out."""
        solution = gauss_newton(curved, np.array([-1.2, 1.0]), wide(2), tolerance=1e-8)
        assert solution.evaluations < 60

    def test_a_wrong_jacobian_ends_without_a_rise(self):
        solution = gauss_newton(lambda x: evaluation(np.array([x[0] - 1.0, 1.0]), np.array([[-1.0], [0.0]])), np.zeros(1), wide(1))
        assert solution.status == "converged"
        assert "no further decrease" in solution.reason
        np.testing.assert_array_equal(solution.theta, 0.0)


class TestBfgs:
    def test_the_stop_rule_of_the_paper(self):
        """Two successive costs differ by less than 1e-3 on log10."""
        solution = bfgs(curved, np.array([-1.2, 1.0]), wide(2))
        assert "less than 0.001" in solution.reason
        accepted = [entry.cost for entry in solution.history if entry.accepted]
        assert accepted[-2] - accepted[-1] < 1e-3
        assert all(a - b >= 1e-3 for a, b in itertools.pairwise(accepted[:-1]))

    def test_a_wrong_gradient_ends_without_a_rise(self):
        solution = bfgs(lambda x: evaluation(np.array([x[0] - 1.0, 1.0]), np.array([[-1.0], [0.0]])), np.zeros(1), wide(1))
        assert solution.status == "converged"
        np.testing.assert_array_equal(solution.theta, 0.0)

    def test_it_learns_the_curvature(self):
        """Far fewer evaluations than steepest descent on an ill-scaled bowl."""
        A = np.diag([1.0, 0.1, 0.03])
        solution = bfgs(linear(A, A @ np.array([1.0, -2.0, 3.0])), np.zeros(3), wide(3), tolerance=1e-10, max_iterations=200)
        np.testing.assert_allclose(solution.theta, [1.0, -2.0, 3.0], atol=2e-2)
        assert solution.evaluations < 80
