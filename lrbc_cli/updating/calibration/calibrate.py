"""Calibration: global factors of the reference model from one measurement, with the boundary identified too or held at its start values.

Peaks that are many line widths apart give the cost (29) many local minima. Descents therefore begin over smoothed spectra, whose width
decreases to zero, see ``search.smooth``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.linalg as sl

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.factors import FIELDS, LOSS, Recipe
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.reduced.affine import AffineModel
from lrbc_cli.updating.calibration.apart import Losses, apart_notes, at_bounds, indistinguishable
from lrbc_cli.updating.misfit.cost import Misfit, penalty_rows
from lrbc_cli.updating.misfit.extended import ExtendedFrf
from lrbc_cli.updating.misfit.nuisances import ModelFactor, Nuisance, estimates
from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.posterior.fit import no_worse, noise_of
from lrbc_cli.updating.search.optimise import Solution, gauss_newton
from lrbc_cli.updating.search.smooth import smoothed_lines
from lrbc_cli.updating.search.starts import group_levels, single_joints
from lrbc_cli.updating.statistics.model import STATISTICS, StatisticalModel
from lrbc_cli.updating.statistics.noise import Noise, widened
from lrbc_cli.updating.statistics.residuals import ResidualOptions


def moves_resonances(recipe: Recipe, name: str) -> bool:
    """Whether a factor scales stiffness or mass, rather than damping alone."""
    return any(name in share.exponents and share.slot != 1 for piece in recipe.pieces if piece.operator != LOSS for share in piece.shares)


@dataclass(frozen=True, kw_only=True)
class FactorProblem:
    """The fit of factors on one reduced model; its unknowns theta are boundary values, logarithms of factors, nuisance parameters.

    Attributes
    ----------
    model : AffineModel
    base : mapping of str to float
        Factors that ``model`` already contains.
    names : tuple of str
        Factors to be identified.
    parameters : Parameterisation
    hold : bool
        Whether the boundary is held at its start values.
    frequency_hz : (F,) float array
    measured : (F, U) complex array
    responses : (U,) int array
        Rows of the model to compare with.
    selected : int array
        Indices of the lines that are compared unsmoothed.
    few : int array or None
        Which of these are enough for the search, see ``thinning.thinned``; None: all. Damping and factors are identified with all of them:
        with few, those of a skid with much damping were off by half, and its validation channels by 0.4 dB more.
    options : ResidualOptions or None
    sigma : (selected, U) float array or None
        Standard deviation of the measured magnitudes [dB].
    nuisances : tuple of Nuisance
        Of the job, such as the offset of the hammer point.
    statistics : StatisticalModel
    gains : (U, K) float array or None
        Unknown gains of the responses, see ``DataResidual``: marginalised on the measured lines.
    progress : callable
        Called with a text at the end of each descent.
    """

    model: AffineModel
    base: Mapping[str, float]
    names: tuple[str, ...]
    parameters: Parameterisation
    hold: bool
    frequency_hz: Floats = field(repr=False)
    measured: Complexes = field(repr=False)
    responses: Integers = field(repr=False)
    selected: Integers = field(repr=False)
    few: Integers | None = field(default=None, repr=False)
    options: ResidualOptions | None = None
    sigma: Floats | None = field(default=None, repr=False)
    nuisances: tuple[Nuisance, ...] = ()
    statistics: StatisticalModel = STATISTICS
    gains: Floats | None = field(default=None, repr=False)
    progress: Callable[[str], None] = field(default=lambda _: None, repr=False)

    @property
    def scalars(self) -> tuple[Nuisance, ...]:
        """The unknown factors, as natural logarithms relative to those that the model contains; then the nuisance parameters."""
        out, prior = list[Nuisance](), self.statistics.calibration
        stiff, damps = (prior.stiff_std, prior.stiff_bound), (prior.damping_factor_std, prior.damping_bound)
        # Coarsening reduces the weight of the data for joints. Factors affect all resonances, so their prior is reduced alike.
        wide = float(np.sqrt(self.statistics.errors.coarsening_of(self.parameters.of_joints)))
        for name in self.names:
            shift = float(np.log(self.base.get(name, 1.0)))
            std, bound = stiff if moves_resonances(self.model.recipe, name) else damps
            out.append(ModelFactor(name=name, mean=-shift, std=std * wide, reach=bound))
        return (*out, *self.nuisances)

    @property
    def start(self) -> Floats:
        """(size,) boundary at its start values, factors of the exported model 1, nuisance parameters at their prior means."""
        return np.concatenate([self.parameters.initial, [scalar.mean for scalar in self.scalars]])

    @property
    def bounds(self) -> Floats:
        """(size, 2) lower and upper bounds; equal for a boundary that is held."""
        boundary = self.parameters.bounds
        if self.hold:
            boundary = np.repeat(self.parameters.initial[:, None], 2, axis=1)
        return np.vstack([boundary, np.array([scalar.bounds for scalar in self.scalars]).reshape(-1, 2)])

    def losses(self, theta: Floats, covariance: Floats) -> list[Losses]:
        """Damping of each field at theta, with its part of the covariance of theta."""
        size, found = self.parameters.size, []
        coefficients = self.model.damping_coefficients()
        for part in FIELDS:
            own = tuple(name for name in sorted(coefficients) if name.endswith(f".{part}"))
            if not own:
                continue
            at = np.array([size + self.names.index(name) if name in self.names else -1 for name in own])
            values = [coefficients[name] * (np.exp(theta[i]) if i >= 0 else 1.0) for name, i in zip(own, at, strict=True)]
            known = np.where(np.logical_and.outer(at >= 0, at >= 0), covariance[np.ix_(at, at)], 0.0)
            found.append(Losses(names=own, values=np.array(values), covariance=known, frequency_hz=self.frequency_hz[self.selected]))
        return found

    def rows(self) -> Floats:
        """(q, size) rows of the penalty, in standard deviations of the prior.

        The boundary has the prior of a reference job: unknown level, neighbours (or joints of a group) alike. With independent values those
        that hardly affect the FRFs absorbed model discrepancy, and the factors were biased.
        """
        P, values = self.parameters, self.statistics.values
        alike = penalty_rows(P, values.level_std**-2, values.std**-2)
        own = np.vstack([alike, np.eye(P.size)[P.is_damping] / values.damping_std])
        return np.asarray(sl.block_diag(own, np.diag([1.0 / scalar.std for scalar in self.scalars])))

    def thinned(self) -> FactorProblem:
        """The same with the lines that are enough for the search."""
        if self.few is None:
            return self
        return replace(self, selected=self.selected[self.few], sigma=None if self.sigma is None else self.sigma[self.few], few=None)

    def frf(self, s: Complexes, responses: Integers | None = None) -> ExtendedFrf:
        """FRFs at lines ``s``, of the compared or of other responses."""
        return ExtendedFrf(self.model, s, self.parameters, self.scalars, self.responses if responses is None else responses)

    def misfit(self, variance: float, soft: bool = False) -> Misfit:
        """Cost at the selected lines with eta = ``variance``; ``soft`` applies the soft loss unless the options have one."""
        model = self.frf(2j * np.pi * self.frequency_hz[self.selected])
        options = ResidualOptions() if self.options is None else self.options
        if soft and options.transform is None:
            options = replace(options, loss_scale=self.statistics.calibration.soft_scale_db)
        return Misfit(
            model=model,
            measured=self.measured[self.selected],
            prior=self.start,
            eta=variance,
            penalty=self.rows(),
            options=options,
            sigma=self.sigma,
            errors=self.statistics.errors,
            gains=self.gains,
        )

    def smoothed_misfit(self, width_hz: float, variance: float) -> Misfit | None:
        """Cost over smoothed spectra; None if the measured lines are too far apart for them."""
        found = smoothed_lines(self.frequency_hz, self.measured, width_hz, self.statistics.calibration.covered)
        if found is None:
            return None
        s, target = found
        return Misfit(self.frf(s), target, self.start, variance, self.rows(), errors=self.statistics.errors)


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One descent: width of the smoothing [Hz] (0 for the measured lines), misfit before and after [dB], number of evaluations."""

    width_hz: float
    before_db: float
    after_db: float
    evaluations: int


@dataclass(frozen=True, kw_only=True)
class FactorFit:
    """The identified factors, with their covariance.

    Attributes
    ----------
    problem : FactorProblem
    solution : Solution
    noise : Noise
    covariance : (size, size) float array
        Of theta, prior included.
    stages : tuple of Stage
    notes : tuple of str
    """

    problem: FactorProblem
    solution: Solution
    noise: Noise
    covariance: Floats = field(repr=False)
    stages: tuple[Stage, ...]
    notes: tuple[str, ...]

    @property
    def logarithms(self) -> dict[str, float]:
        """Natural logarithm of each factor, relative to the exported model."""
        size, problem = self.problem.parameters.size, self.problem
        return {
            name: float(value + np.log(problem.base.get(name, 1.0)))
            for name, value in zip(problem.names, self.solution.theta[size : size + len(problem.names)], strict=True)
        }

    @property
    def factors(self) -> dict[str, float]:
        """Each factor, relative to the exported model."""
        return {name: float(np.exp(value)) for name, value in self.logarithms.items()}

    @property
    def spread(self) -> dict[str, float]:
        """Standard deviation of the natural logarithm of each factor."""
        std = np.sqrt(np.maximum(np.diag(self.covariance)[self.problem.parameters.size :], 0.0))
        return dict(zip(self.problem.names, std[: len(self.problem.names)].tolist(), strict=True))

    @property
    def nuisances(self) -> dict[str, Any]:
        """Estimates of the nuisance parameters, see ``nuisances.estimates``."""
        at = self.problem.parameters.size + len(self.problem.names)
        std = np.sqrt(np.maximum(np.diag(self.covariance)[at:], 0.0))
        return estimates(self.problem.nuisances, self.solution.theta[at:], std)

    def interval(self, name: str) -> tuple[float, float]:
        """95 % interval of a factor, of a log-normal posterior."""
        value, reach = self.logarithms[name], NORMAL_95 * self.spread[name]
        return float(np.exp(value - reach)), float(np.exp(value + reach))

    def gains(self) -> tuple[Misfit, Floats, Floats, Floats, float]:
        """Cost, theta, Jacobian of the data residuals, covariance and variance at the optimum: the input of ``Misfit.gains``."""
        problem, J, theta = self.problem, self.solution.evaluation.jacobian, self.solution.theta
        misfit = problem.misfit(self.noise.variance, soft=True).gained_about(theta)
        return misfit, theta, J[: J.shape[0] - problem.rows().shape[0]], self.covariance, self.noise.variance

    def wider(self, ratio: float) -> FactorFit:
        """The same with errors of the data ``ratio`` times as large as their residuals, see ``noise.validation_ratio``."""
        J = self.solution.evaluation.jacobian
        by_data = J[: J.shape[0] - self.problem.rows().shape[0]] @ self.covariance
        covariance = widened(self.covariance, by_data.T @ by_data / self.noise.variance, ratio)
        return replace(self, covariance=covariance, noise=replace(self.noise, ratio=ratio))

    def moved(self, problem: FactorProblem) -> Floats:
        """(size,) theta of the same state in a problem whose model contains other factors."""
        size = problem.parameters.size
        shift = [np.log(self.problem.base.get(name, 1.0) / problem.base.get(name, 1.0)) for name in problem.names]
        shift += [0.0] * len(problem.nuisances)
        return np.concatenate([self.solution.theta[:size], self.solution.theta[size:] + shift])


def _descend(problem: FactorProblem, misfit: Misfit, theta: Floats, width: float, tolerance: float, limit: int) -> tuple[Solution, Stage]:
    solution = gauss_newton(misfit, theta, problem.bounds, tolerance=tolerance, max_iterations=limit)
    first, last = solution.history[0].misfit_db, solution.evaluation.misfit_db
    problem.progress(f"a descent from {first:.2f} to {last:.2f} dB")
    return solution, Stage(width_hz=width, before_db=first, after_db=last, evaluations=solution.evaluations)


def descents(problem: FactorProblem, theta: Floats, far: bool, limit: int, soft: bool = False) -> tuple[Solution, list[Stage]]:
    """Descents over smoothed spectra where theta is far from the solution, then at the measured lines; without weights from the noise."""
    stages, prior = [], problem.statistics.calibration
    variance = prior.first_sigma_db**2
    for share in prior.widths if far else ():
        width = share * float(problem.frequency_hz[-1])
        misfit = problem.smoothed_misfit(width, variance)
        if misfit is None:
            continue
        solution, stage = _descend(problem, misfit, theta, width, 1e-3, 30)
        stages.append(stage)
        if solution.status != "failed":
            theta = solution.theta
    solution, stage = _descend(problem, problem.misfit(variance, soft), theta, 0.0, 1e-3, limit)
    return solution, [*stages, stage]


def fit_factors(
    problem: FactorProblem,
    start: Floats | None = None,
    *,
    tolerance: float = 1e-4,
    max_iterations: int = 100,
    change: float = 0.1,
    rounds: int = 4,
    same: float = 0.02,
    explained_db: float = 2.1,
) -> FactorFit:
    """Identify the factors, and the boundary unless it is held.

    Parameters
    ----------
    problem : FactorProblem
    start : (size,) float array or None
        Start on the measured lines; None for the start values, which may be far away: several starts, over smoothed spectra first.
    tolerance : float
        Stop rule of the last descents.
    max_iterations : int
        Of each descent on the measured lines.
    change, rounds : float, int
        The weight of the priors follows the noise until its variance changes by a smaller share, or for so many rounds.
    same : float
        A note is made if the costs of the ends of two starts differ by more than this share.
    explained_db : float
        Mean misfit above which joints are moved one by one: beside a state explained so badly no job would be an all-clear.

    Returns
    -------
    FactorFit
        Its solution has the status ``failed`` if the cost is not finite at the start.
    """
    notes: list[str] = []
    places, sought = [problem.start if start is None else start], problem.thinned()
    solution, stages = descents(sought if start is None else problem, places[0], start is None, max_iterations)
    if start is None:
        ends = {"over smoothed spectra": solution} | _others(sought, solution, stages, max_iterations)
        solution = _lowest(ends, notes, same)
        if not problem.hold and solution.evaluation.misfit_db > explained_db:
            solution = _joint_by_joint(sought, solution, stages, max_iterations)
        places += [end.theta for end in ends.values()]
    noise = Noise(sigma=problem.statistics.calibration.first_sigma_db, factor=1.0)
    # Between few lines and all of them, a descent leaves valleys that belong to one of the two costs only.
    for one in (problem,) if sought is problem or start is not None else (problem, sought, problem):
        if solution.status != "failed":
            solution, noise = _weighed(one, solution, places, stages, descent=(tolerance, max_iterations), change=change, rounds=rounds)
    J = solution.evaluation.jacobian
    covariance = _covariance(problem, J, noise)
    damping = problem.losses(solution.theta, covariance)
    limits = at_bounds(problem.parameters, problem.scalars, solution.theta, problem.frequency_hz, hold=problem.hold)
    notes += [*_apart(problem, J, noise, damping), *limits]
    return FactorFit(problem=problem, solution=solution, noise=noise, covariance=covariance, stages=tuple(stages), notes=tuple(notes))


def _weighed(
    problem: FactorProblem,
    solution: Solution,
    places: list[Floats],
    stages: list[Stage],
    *,
    descent: tuple[float, int],
    change: float,
    rounds: int,
) -> tuple[Solution, Noise]:
    """Alternate descents and updates of the weight of the priors by the noise; the last solution and its noise."""
    first, least = problem.statistics.calibration.first_sigma_db, problem.statistics.calibration.least_sigma_db
    tolerance, limit = descent
    misfit = problem.misfit(first**2, soft=True)
    noise = noise_of(misfit, misfit(solution.theta), problem.selected)
    for _ in range(rounds):
        before = max(noise.variance, least**2)
        misfit = misfit.with_eta(before).gained_about(solution.theta)
        places.append(solution.theta)
        found, stage = _descend(problem, misfit, solution.theta, 0.0, tolerance, limit)
        stages.append(stage)
        if found.status == "failed":
            return replace(found, theta=solution.theta), noise.at(max(noise.sigma, least))
        solution = found
        noise = noise_of(misfit, solution.evaluation, problem.selected)
        if abs(noise.variance / before - 1.0) < change:
            break

    def again(theta: Floats) -> Solution:
        return gauss_newton(misfit, theta, problem.bounds, tolerance=tolerance, max_iterations=limit)

    solution = no_worse(misfit, solution, places, again)
    noise = noise_of(misfit, solution.evaluation, problem.selected)
    return solution, noise.at(max(noise.sigma, least))


def _others(problem: FactorProblem, first: Solution, stages: list[Stage], limit: int) -> dict[str, Solution]:
    """Ends of other starts, by description: the start values on the measured lines, and best levels of the groups if there are several."""
    variance = problem.statistics.calibration.first_sigma_db**2
    width = problem.statistics.calibration.widths[0] * float(problem.frequency_hz[-1])
    far = problem.smoothed_misfit(width, variance)
    apart = [] if far is None else group_levels(far, problem.start, problem.bounds, kept=1)
    found: dict[str, Solution] = {}
    if apart and not np.array_equal(apart[0], problem.start):
        found["from the levels of the groups"], more = descents(problem, apart[0], True, limit)
        stages += more
    # A rough descent first: it continues only if its cost is below twice that of the others.
    other, stage = _descend(problem, problem.misfit(variance), problem.start, 0.0, 1e-2, limit)
    stages.append(stage)
    if other.evaluation.total < 2.0 * min(end.evaluation.total for end in (first, *found.values())):
        other, more = descents(problem, other.theta, False, limit)
        stages += more
    return found | {"from the start values": other}


def _joint_by_joint(problem: FactorProblem, best: Solution, stages: list[Stage], limit: int) -> Solution:
    """Descents with one joint moved at a time, as long as one of them ends lower, because the reference job may have loose joints.

    If all joints start alike, the factors absorb the effect of a loose joint, and no descent finds it.
    """
    misfit = problem.misfit(problem.statistics.calibration.first_sigma_db**2)
    while True:
        ends = []
        for theta in single_joints(misfit, best.theta, problem.start, problem.bounds):
            end, stage = _descend(problem, misfit, theta, 0.0, 1e-3, limit)
            ends.append(end)
            stages.append(stage)
        lowest = min((end for end in ends if end.status != "failed"), key=lambda end: end.evaluation.total, default=best)
        if not lowest.evaluation.total < (1 - 1e-3) * best.evaluation.total:
            return best
        best = lowest


def _lowest(ends: Mapping[str, Solution], notes: list[str], same: float) -> Solution:
    """The lowest of the ends, or the first of nearly equal ones; adds a note if costs differ by more than ``same``."""
    kept, best = next(iter(ends.items()))
    for name, end in ends.items():
        lower = end.status != "failed" and end.evaluation.total < (1 - 1e-3) * best.evaluation.total
        if lower or best.status == "failed":
            kept, best = name, end
    if any(abs(end.evaluation.total / best.evaluation.total - 1.0) > same for end in ends.values()):
        listed = ", ".join(f"{name} at {end.evaluation.misfit_db:.2f} dB" for name, end in ends.items())
        notes.append(f"starts end apart: {listed}; that {kept} is kept")
    return best


def _covariance(problem: FactorProblem, J: Floats, noise: Noise) -> Floats:
    """(size, size) covariance of theta; zero for values that are held."""
    low, high = problem.bounds.T
    free = high > low
    covariance = np.zeros((low.size, low.size))
    covariance[np.ix_(free, free)] = noise.variance * np.linalg.inv(J[:, free].T @ J[:, free])
    return covariance


def _apart(problem: FactorProblem, jacobian: Floats, noise: Noise, damping: Sequence[Losses]) -> list[str]:
    """Notes on factors that are not identifiable separately; ``jacobian`` has the rows of the penalty last."""
    size, count = problem.parameters.size, len(problem.names)
    rows = problem.rows()
    low, high = problem.bounds.T
    other = [i for i in range(low.size) if high[i] > low[i] and not size <= i < size + count]
    data = jacobian[: jacobian.shape[0] - rows.shape[0], [*range(size, size + count), *other]] / np.sqrt(noise.variance)
    std = np.array([scalar.std for scalar in problem.scalars[:count]])
    precision = rows[:, other].T @ rows[:, other]
    return apart_notes(indistinguishable(problem.names, data, std, precision, problem.statistics.calibration), damping)
