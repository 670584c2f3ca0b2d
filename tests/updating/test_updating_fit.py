"""The posterior against closed forms, and the weight of the prior that follows the noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear import LinearModel, line_group

from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.misfit.cost import Evaluation, Misfit
from lrbc_cli.updating.misfit.nuisances import Gain
from lrbc_cli.updating.posterior.fit import extended_misfit, follow_noise, no_worse, noise_of, posterior, residual_places, weighed
from lrbc_cli.updating.search.descent import Level, descend
from lrbc_cli.updating.search.optimise import HistoryEntry, Solution, gauss_newton
from lrbc_cli.updating.statistics.noise import Noise
from lrbc_cli.updating.statistics.residuals import ResidualOptions
from lrbc_cli.updating.unknowns.shapes import bolt_shapes, node_shapes

LINES, RESPONSES, VALUES = 60, 4, 12
SIGMA, STD = 0.5, 0.35
SELECTED = np.arange(LINES)


class Case:
    """A linear problem with bolts along an edge."""

    def __init__(self, seed: int, bolts: tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 0.9), values: bool = False, strength: float = 1.0):
        self.rng = np.random.default_rng(seed)
        self.parameters = Parameterisation((line_group(VALUES, damping=values),))
        size = self.parameters.size
        places = np.array([[0.01, b, 0.0] for b in bolts])
        self.shapes = node_shapes(self.parameters, STD) if values else bolt_shapes(self.parameters, places)
        self.prior = self.parameters.initial
        self.model = LinearModel(strength * self.rng.normal(size=(LINES, RESPONSES, size)), self.parameters)
        self.J = (self.model.A @ self.shapes.T).reshape(-1, self.shapes.T.shape[1])

    def misfit(self, z: np.ndarray, sigma: float = SIGMA) -> Misfit:
        """A measurement of this change, with noise."""
        clean = self.model.frf(self.prior + self.shapes.T @ z)
        measured = clean * 10.0 ** (sigma * self.rng.normal(size=clean.shape) / 20.0)
        return Misfit(self.model, measured, self.prior, 4.0, self.shapes.penalty())

    def begin(self, misfit: Misfit):
        return descend(misfit, self.prior, self.parameters.bounds, self.shapes.T)

    def follow(self, misfit: Misfit):
        def again(misfit: Misfit, theta: np.ndarray):
            return descend(misfit, theta, self.parameters.bounds, self.shapes.T, tolerance=1e-8)

        return follow_noise(misfit, self.begin(misfit), again, SELECTED)


def data_of(case: Case, misfit: Misfit) -> np.ndarray:
    """dB that the measurement lies above the prior."""
    return (misfit.target - case.model.A @ case.prior).ravel()


class TestPosterior:
    def test_linear_and_gaussian(self) -> None:
        case = Case(1)
        misfit = case.misfit(case.rng.normal(size=5) * STD)
        misfit, solution, noise = case.follow(misfit)
        found = posterior(misfit, solution, case.shapes, (), noise, case.prior)
        precision = case.J.T @ case.J / noise.variance + np.diag(misfit.eta / noise.variance / case.shapes.std**2)
        mean = np.linalg.solve(precision, case.J.T @ data_of(case, misfit) / noise.variance)
        np.testing.assert_allclose(found.z, mean, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(found.covariance, np.linalg.inv(precision), rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(found.boundary, case.shapes.T @ np.linalg.inv(precision) @ case.shapes.T.T, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(found.std, np.sqrt(np.diag(found.covariance)))

    def test_where_the_data_say_nothing_the_prior_stays(self) -> None:
        case = Case(2, strength=1e-6)
        misfit, solution, noise = case.follow(case.misfit(np.zeros(5)))
        found = posterior(misfit, solution, case.shapes, (), noise, case.prior)
        np.testing.assert_allclose(found.std, STD, rtol=0.03)
        np.testing.assert_allclose(found.prior_std, STD, rtol=0.03)

    @pytest.mark.parametrize("count", [2, 3])
    def test_bolts_in_one_place(self, count: int) -> None:
        """The data give their mean; of the differences the prior is all there is, neither certainty nor infinity."""
        case = Case(3, (0.1, *[0.5] * count, 0.9))
        misfit, solution, noise = case.follow(case.misfit(np.array([0.0, *[-0.6] * count, 0.0])))
        found = posterior(misfit, solution, case.shapes, (), noise, case.prior)
        np.testing.assert_allclose(found.z[1:-1], -0.6, atol=0.05)
        np.testing.assert_allclose(found.std[1:-1], STD * np.sqrt(1 - 1 / count), rtol=0.05)
        assert found.std[[0, -1]].max() < 0.05
        # What the edge does between them is known well in any case.
        assert np.sqrt(np.diag(found.boundary)).max() < 0.05

    def test_it_covers_the_truth(self) -> None:
        inside, count = 0, 0
        for seed in range(60):
            case = Case(100 + seed, strength=0.1)
            z = STD * case.rng.normal(size=5)
            misfit, solution, noise = case.follow(case.misfit(z))
            found = posterior(misfit, solution, case.shapes, (), noise, case.prior)
            inside += int(np.sum(np.abs(found.z - z) <= 1.96 * found.std))
            count += z.size
        assert 0.90 <= inside / count <= 0.99, inside / count

    @pytest.mark.parametrize("ratio", [1.0, 2.5])
    def test_it_covers_errors_that_are_larger_than_the_residuals(self, ratio: float) -> None:
        """Standardised errors have unit variance where the data err so many times as much; where they say nothing the prior stays."""
        z, noise, found = [], Noise(sigma=SIGMA, factor=1.0), None
        for seed in range(80):
            case = Case(300 + seed, strength=0.03)
            true = STD * case.rng.normal(size=5)
            misfit = case.misfit(true, ratio * SIGMA).with_eta(SIGMA**2)
            solution = descend(misfit, case.prior, case.parameters.bounds, case.shapes.T, tolerance=1e-10)
            plain = posterior(misfit, solution, case.shapes, (), noise, case.prior)
            found = plain.wider(ratio)
            z += ((found.z - true) / found.std).tolist()
        assert found is not None
        assert found.noise.ratio == ratio
        assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.1)
        assert (ratio == 1.0) == np.allclose(found.covariance, plain.covariance)
        case = Case(2, strength=1e-6)
        misfit, solution, noise = case.follow(case.misfit(np.zeros(5)))
        np.testing.assert_allclose(posterior(misfit, solution, case.shapes, (), noise, case.prior).wider(10.0).std, STD, rtol=0.03)

    def test_the_error_of_another_state_is_not_widened_with_it(self) -> None:
        case = Case(1)
        misfit, solution, noise = case.follow(case.misfit(case.rng.normal(size=5) * STD))
        plain = posterior(misfit, solution, case.shapes, (), noise, case.prior)
        state = np.diag(np.linspace(0.1, 0.2, case.parameters.size) ** 2)
        np.testing.assert_allclose(plain.about_estimate(state).wider(2.0).boundary, plain.wider(2.0).boundary + state, rtol=1e-9)


class TestFollowNoise:
    @pytest.mark.parametrize("sigma", [0.05, 0.5, 3.0])
    def test_the_weight_is_the_noise(self, sigma: float) -> None:
        case = Case(4)
        misfit, solution, noise = case.follow(case.misfit(np.array([0.0, -0.5, 0.2, 0.0, 0.1]), sigma))
        assert noise.sigma == pytest.approx(sigma, rel=0.15)
        assert misfit.eta == pytest.approx(noise.variance, rel=0.06)
        assert solution.evaluations == len(solution.history)
        assert [entry.evaluation for entry in solution.history] == list(range(len(solution.history)))

    def test_it_does_not_depend_on_where_it_begins(self) -> None:
        found = []
        for eta in (0.01, 4.0, 400.0):
            case = Case(5)
            found.append(case.follow(case.misfit(np.array([0.0, -0.5, 0.2, 0.0, 0.1])).with_eta(eta))[1].theta)
        np.testing.assert_allclose(found[1:], [found[0]] * 2, atol=1e-3)

    def test_values_with_a_damping_exponent(self) -> None:
        """The exponent has no prior of its own, and no row."""
        case = Case(6, values=True)
        truth = np.zeros(VALUES + 1)
        truth[[3, -1]] = -0.8, 1.5
        _, solution, noise = case.follow(case.misfit(truth))
        np.testing.assert_allclose(solution.theta - case.prior, truth, atol=0.25)
        assert noise.sigma == pytest.approx(SIGMA, rel=0.15)


class _WithGain:
    """The linear model with gains of its responses [dB] behind theta."""

    def __init__(self, model: LinearModel, responses: tuple[int, ...]) -> None:
        self.model, self.parameters, self.s = model, model.parameters, model.s
        self.G = np.zeros((LINES, RESPONSES, len(responses)))
        for i, r in enumerate(responses):
            self.G[:, r, i] = 1.0

    def frf(self, theta: np.ndarray) -> np.ndarray:
        n = self.parameters.size
        return self.model.frf(theta[:n]) * 10.0 ** (self.G @ theta[n:] / 20.0)

    def sensitivities(self, theta: np.ndarray, phase: bool = False) -> tuple[np.ndarray, np.ndarray]:
        return self.frf(theta), np.concatenate([self.model.A, self.G], axis=2)


@pytest.mark.parametrize("eta", [0.01, 0.3, 40.0])
def test_further_unknowns_have_their_priors(eta: float) -> None:
    """Gains beside the boundary, whatever the weight of its prior: a standard deviation of a gain costs one of the data."""
    case = Case(8, strength=0.2)
    misfit = case.misfit(np.array([0.0, -0.5, 0.2, 0.0, 0.1])).with_eta(eta)
    variance = SIGMA**2
    nuisances = tuple(Gain(name=f"r{i}", index=i, mean=mean, std=0.3, reach=9.0) for i, mean in enumerate((0.0, 0.2)))
    model = _WithGain(case.model, (0, 1))
    extended = extended_misfit(misfit, model, nuisances, variance)
    size, m = case.parameters.size, case.shapes.T.shape[1]
    T = np.zeros((size + 2, m + 2))
    T[:size, :m], T[size:, m:] = case.shapes.T, np.eye(2)
    level = Level(extended, extended.prior, T)
    found = gauss_newton(level, np.zeros(m + 2), np.tile([-9.0, 9.0], (m + 2, 1)), tolerance=1e-10)
    J = np.hstack([case.J, model.G.reshape(-1, 2)])
    precision = J.T @ J / variance + np.diag(np.concatenate([eta / variance / case.shapes.std**2, np.full(2, 1 / 0.3**2)]))
    data = data_of(case, misfit) - J[:, m:] @ np.array([0.0, 0.2])
    mean = np.linalg.solve(precision, J.T @ data / variance)
    np.testing.assert_allclose(found.theta, mean, rtol=1e-5, atol=1e-7)
    end = replace(found, theta=level.theta(found.theta))
    known = posterior(extended, end, case.shapes, nuisances, Noise(sigma=SIGMA, factor=1.0), case.prior)
    np.testing.assert_allclose(known.covariance, np.linalg.inv(precision), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(known.values, mean[m:] + np.array([0.0, 0.2]), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(known.z, mean[:m], rtol=1e-5, atol=1e-6)


class TestPlaces:
    def misfit(self, kind: str) -> Misfit:
        parameters = Parameterisation((line_group(VALUES),))
        model = LinearModel(np.ones((6, 2, VALUES)), parameters)
        measured = model.frf(parameters.initial) * np.ones((6, 2), dtype=complex)
        measured[2, 1] = np.nan
        return Misfit(model, measured, parameters.initial, 0.0, options=ResidualOptions(kind=kind))

    def test_lines_and_responses(self) -> None:
        selected = np.array([4, 5, 6, 20, 21, 40])
        line, response = residual_places(self.misfit("db"), selected, 11)
        np.testing.assert_array_equal(line, [4, 4, 5, 5, 6, 20, 20, 21, 21, 40, 40])
        np.testing.assert_array_equal(response, [0, 1, 0, 1, 0, 0, 1, 0, 1, 0, 1])

    def test_imaginary_parts_are_responses_of_their_own(self) -> None:
        selected = np.array([4, 5, 6, 20, 21, 40])
        line, response = residual_places(self.misfit("log-complex"), selected, 22)
        np.testing.assert_array_equal(line[:11], line[11:])
        np.testing.assert_array_equal(response[11:], response[:11] + 2)


def test_noise_of_an_evaluation() -> None:
    case = Case(9)
    misfit = case.misfit(np.zeros(5))
    found = noise_of(misfit, case.begin(misfit).evaluation, SELECTED)
    assert found.sigma == pytest.approx(SIGMA, rel=0.15)


def measured_with_noise_known(case: Case, z: np.ndarray) -> Misfit:
    """The same measurement, its noise known."""
    found = case.misfit(z)
    measured = 10.0 ** (found.target / 20.0) + 0j
    sigma = np.full(measured.shape, SIGMA)
    return Misfit(found.model, measured, found.prior, found.eta, case.shapes.penalty(), options=found._data.options, sigma=sigma)


class TestRounds:
    def test_a_round_that_loses_the_fit_is_not_kept(self) -> None:
        case = Case(7)
        misfit = measured_with_noise_known(case, np.array([0.5, -1.0, 0.7, -0.3, 0.2]))
        begun = case.begin(misfit)

        def slides(misfit: Misfit, theta: np.ndarray):
            return descend(misfit, case.prior, case.parameters.bounds, case.shapes.T, max_iterations=0)

        kept, solution, noise = follow_noise(misfit, begun, slides, SELECTED)
        assert kept is misfit
        np.testing.assert_array_equal(solution.theta, begun.theta)
        assert noise == noise_of(misfit, begun.evaluation, SELECTED)
        assert solution.evaluations > begun.evaluations

    def test_no_noise_at_all(self) -> None:
        case = Case(8)
        clean = case.misfit(np.array([0.5, -1.0, 0.7, -0.3, 0.2]), 0.0)
        _, solution, noise = case.follow(clean)
        assert noise.sigma < 1e-3
        assert solution.status == "converged"

    def test_residuals_of_joints_are_coarsened(self) -> None:
        """Beside the correlation along lines, errors that responses share: along an edge neighbours hold the values."""
        case = Case(4)
        misfit = case.misfit(np.array([0.0, -0.5, 0.2, 0.0, 0.1]))
        evaluation = case.begin(misfit).evaluation
        edge = noise_of(misfit, evaluation, SELECTED)
        (group,) = case.parameters.groups
        case.model.parameters = Parameterisation((replace(group, bolt=np.arange(group.count)),))
        joints = noise_of(misfit, evaluation, SELECTED)
        assert edge.coarsening == 1.0
        assert joints.variance == pytest.approx(misfit.errors.coarsening * edge.variance)

    def test_half_the_way(self) -> None:
        case = Case(9)
        misfit = measured_with_noise_known(case, np.zeros(5))
        begun = case.begin(misfit)
        noise = noise_of(misfit, begun.evaluation, SELECTED)
        full, _ = weighed(misfit, begun.evaluation, noise, begun.theta, None)
        half, variance = weighed(misfit, begun.evaluation, noise, begun.theta, None, True)
        assert half.level == pytest.approx(np.sqrt(full.level * misfit.level))
        assert variance == pytest.approx(half.level**2 * noise.factor)


class TestNoWorse:
    """After rounds of weights the last end is compared with the earlier places by the last cost."""

    def evaluation(self, total: float, misfit_db: float) -> Evaluation:
        return Evaluation(
            cost=float(np.log10(total)),
            total=total,
            data=total,
            misfit_db=misfit_db,
            residual=np.array([np.sqrt(total)]),
            jacobian=np.ones((1, 1)),
        )

    def settle(self, values: dict[float, tuple[float, float]], end: float, places: list[float]) -> Solution:
        def objective(theta: np.ndarray) -> Evaluation:
            return self.evaluation(*values[float(theta[0])])

        def ended(theta: np.ndarray) -> Solution:
            return Solution(
                theta=theta,
                evaluation=objective(theta),
                status="converged",
                reason="there",
                iterations=1,
                evaluations=1,
                history=(HistoryEntry(evaluation=0, cost=0.0, misfit_db=0.0, accepted=True),),
            )

        return no_worse(objective, ended(np.array([end])), [np.array([place]) for place in places], ended)

    def test_a_start_that_was_better_is_taken_up(self) -> None:
        found = self.settle({1.0: (9.0, 3.7), 2.0: (4.0, 2.2), 3.0: (6.0, 2.5)}, 1.0, [2.0, 3.0])
        assert found.theta[0] == 2.0
        assert found.evaluation.misfit_db == 2.2
        # Three evaluations to compare, and a descent of one.
        assert found.evaluations == len(found.history) == 5
        assert [entry.evaluation for entry in found.history] == list(range(5))

    def test_a_place_that_only_the_weights_forgive_is_not(self) -> None:
        found = self.settle({1.0: (9.0, 1.0), 2.0: (4.0, 2.2)}, 1.0, [2.0])
        assert found.theta[0] == 1.0

    def test_the_best_stays(self) -> None:
        found = self.settle({1.0: (3.0, 1.0), 2.0: (4.0, 2.2)}, 1.0, [2.0])
        assert found.theta[0] == 1.0
        assert found.evaluations == 3
