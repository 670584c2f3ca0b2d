"""One identification with its uncertainty: weight of the prior from the noise, nuisance parameters, posterior covariance.

The descents themselves are those of ``search``; here cost, weights and covariance are set about them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.misfit.cost import ChangeError, Evaluation, Misfit
from lrbc_cli.updating.misfit.frf import Sensitive
from lrbc_cli.updating.misfit.nuisances import Nuisance
from lrbc_cli.updating.search.optimise import HistoryEntry, Objective, Solution, numbered
from lrbc_cli.updating.statistics.noise import Noise, estimate_noise, widened
from lrbc_cli.updating.statistics.thinning import ranks
from lrbc_cli.updating.unknowns.shapes import Shapes

#: Weight of a penalty that is off, where it cannot be zero because other rows are scaled by it.
LEAST_ETA = 1e-30


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Gaussian posterior of m boundary unknowns z and k nuisance parameters, linearised about the optimum.

    Attributes
    ----------
    shapes : Shapes
        Maps z to theta.
    nuisances : tuple of Nuisance
        They follow z in the covariance.
    z, values : (m,) and (k,) float arrays
        Optimum of z and of the nuisance parameters.
    covariance : (m + k, m + k) float array
        ``variance (JᵀJ + eta RᵀR)⁻¹``, prior included.
    noise : Noise
        Gives the variance.
    prior_std : (m,) float array
        Standard deviations of z in the prior, ``sqrt(variance / eta)`` times those of the shapes.
    about : (size, size) float array or None
        Covariance of theta that comes from the reference state, which z is a change of; None if that is no estimate.
    own : (m, m) float array or None
        Covariance of z without the errors of the reference state; None if these do not contribute.
    told : (m + k, m + k) float array or None
        Part of the covariance that comes from errors of the data, see ``noise.widened``.
    """

    shapes: Shapes
    nuisances: tuple[Nuisance, ...]
    z: Floats
    values: Floats
    covariance: Floats
    noise: Noise
    prior_std: Floats
    about: Floats | None = None
    own: Floats | None = None
    told: Floats | None = None

    def wider(self, ratio: float) -> Posterior:
        """The same with errors of the data ``ratio`` times as large as their residuals, see ``noise.validation_ratio``."""
        told, m = np.zeros_like(self.covariance) if self.told is None else self.told, self.z.size
        own = None if self.own is None else widened(self.own, told[:m, :m], ratio)
        return replace(self, covariance=widened(self.covariance, told, ratio), own=own, noise=replace(self.noise, ratio=ratio))

    @property
    def boundary(self) -> Floats:
        """(size, size) covariance of theta, nuisance parameters marginalised, errors of the reference state included."""
        m = self.z.size
        covariance = self.shapes.T @ (self.covariance[:m, :m] if self.own is None else self.own) @ self.shapes.T.T
        return np.asarray(covariance if self.about is None else covariance + self.about)

    def about_estimate(self, state: Floats, jacobian: Floats | None = None, by_theta: Floats | None = None) -> Posterior:
        """The same with the error of the reference state added, of which theta is a change.

        An error dtheta of that state moves the optimum by ``dz = -(JᵀJ + eta RᵀR)⁻¹ Jᵀ J_theta dtheta``.

        Parameters
        ----------
        state : (size, size) float array
            Covariance of theta in the reference state.
        jacobian, by_theta : (n, m + k) and (n, size) float arrays or None
            Jacobians of the data residuals to the unknowns and to theta; None for a relative comparison, in which the error of the
            reference state cancels out of the changes.
        """
        size, m = self.shapes.T.shape
        moved = np.zeros((self.covariance.shape[0], size))
        if jacobian is not None and by_theta is not None:
            # Without noise nothing is uncertain.
            moved = self.covariance @ (jacobian.T @ by_theta) / (self.noise.variance or 1.0)
        left = np.eye(size) - self.shapes.T @ moved[:m]
        return replace(self, covariance=self.covariance + moved @ state @ moved.T, about=left @ state @ left.T, own=self.covariance[:m, :m])

    @property
    def std(self) -> Floats:
        """(m + k,) standard deviations of z and of the nuisance parameters."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


def residual_places(misfit: Misfit, selected: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(n,) measured line and (n,) response of each data residual; the imaginary part (phase) counts as a further response.

    Parameters
    ----------
    misfit : Misfit
    selected : (F,) int array
        Index of each line of the misfit among the measured lines.
    count : int
        Number n of data residuals.
    """
    line, response = np.nonzero(misfit.valid)
    line = selected[line]
    if count == 2 * line.size:
        return np.concatenate([line, line]), np.concatenate([response, response + misfit.valid.shape[1]])
    return line, response


def noise_of(misfit: Misfit, evaluation: Evaluation, selected: NDArray[np.int64]) -> Noise:
    """Noise from the residuals of an evaluation, see ``estimate_noise``, with the coarsening of the misfit."""
    rows = misfit.data_rows(evaluation)
    line, response = residual_places(misfit, ranks(selected), rows)
    errors = replace(misfit.errors, coarsening=misfit.coarsening)
    return estimate_noise(evaluation.residual[:rows], evaluation.jacobian[:rows], evaluation.jacobian[rows:], line, response, errors)


def weighed(
    misfit: Misfit, evaluation: Evaluation, noise: Noise, theta: Floats, error: ChangeError | None, damped: bool = False
) -> tuple[Misfit, float]:
    """The cost with the covariance of its residuals updated at an optimum, and the variance that a residual then has.

    Parameters
    ----------
    misfit : Misfit
    evaluation : Evaluation
        Of the misfit at theta.
    noise : Noise
        Estimated from that evaluation.
    theta : (size,) float array
        The optimum.
    error : ChangeError or None
        Errors of predicted changes; None in a state that is no change of another.
    damped : bool
        Move the model discrepancy half the way only, in logarithms: two levels can lead to each other.

    Returns
    -------
    Misfit, float
        The variance in dB².
    """
    before = misfit.level
    misfit = misfit.gained_about(theta) if error is None else misfit.about(theta, error)
    if not misfit.weighted:
        return misfit, noise.variance
    level = misfit.followed(theta, evaluation)
    if damped:
        level = float(np.sqrt(level * before))
    return misfit.with_level(level), noise.at(level).variance


def no_worse(objective: Objective, solution: Solution, places: Sequence[Floats], again: Callable[[Floats], Solution]) -> Solution:
    """Descend again from an earlier place if both the last cost and the mean misfit are lower there than at the solution.

    Weights change from round to round, so an earlier place may be better by the last ones. The cost alone does not decide, because the
    covariance of a loosened state tolerates the residuals of the tight one.

    Parameters
    ----------
    objective : callable
        The last cost.
    solution : Solution
    places : sequence of (size,) float arrays
        Starts, and ends of earlier rounds.
    again : callable
        Descent of the last cost from a theta.

    Returns
    -------
    Solution
        The better of both, with all evaluations in its history.
    """
    here, *values = [objective(theta) for theta in (solution.theta, *places)]
    tried = [HistoryEntry(evaluation=0, cost=value.cost, misfit_db=value.misfit_db, accepted=False) for value in (here, *values)]
    history = [*solution.history, *numbered(tried, len(solution.history))]
    better = [i for i, value in enumerate(values) if value.total < here.total and value.misfit_db < here.misfit_db]
    evaluations, iterations = solution.evaluations + 1 + len(values), solution.iterations
    if better:
        found = again(places[min(better, key=lambda i: values[i].total)])
        history += numbered(found.history, len(history))
        evaluations, iterations = evaluations + found.evaluations, iterations + found.iterations
        if found.status != "failed" and found.evaluation.total < here.total:
            solution = replace(found, starts=solution.starts)
    return replace(solution, evaluations=evaluations, iterations=iterations, history=tuple(history))


def follow_noise(
    misfit: Misfit,
    solution: Solution,
    again: Callable[[Misfit, Floats], Solution],
    selected: NDArray[np.int64],
    error: ChangeError | None = None,
    starts: Sequence[Floats] = (),
    *,
    change: float = 0.05,
    rounds: int = 6,
) -> tuple[Misfit, Solution, Noise]:
    """Alternate descents with updates of the weights and of the prior, ``eta = variance``, until the variance of the residuals settles.

    Parameters
    ----------
    misfit : Misfit
        Its rows R are in standard deviations of the prior.
    solution : Solution
        Start of the first round.
    again : callable
        The descent of a round: from a misfit and a theta to a solution whose Jacobian is to z.
    selected : int array
        See ``residual_places``.
    error : ChangeError or None
        See ``weighed``.
    starts : sequence of (size,) float arrays
        Places that the last end is compared with, besides the ends of the rounds, see ``no_worse``.
    change, rounds : float, int
        End when the variance changes by a smaller share than this, or after so many rounds.

    Returns
    -------
    Misfit, Solution, Noise
        With the last weights and the status of the last round, but evaluations and history of all rounds.
    """
    places, errors = [*starts], misfit.errors
    noise = noise_of(misfit, solution.evaluation, selected)
    history, iterations, evaluations = list(solution.history), solution.iterations, solution.evaluations
    for round_ in range(rounds):
        kept = misfit, solution, noise
        places.append(solution.theta)
        misfit, before = weighed(misfit, solution.evaluation, noise, solution.theta, error, round_ > 1)
        misfit = misfit.with_eta(max(before, errors.least_variance))
        found = again(misfit, solution.theta)
        history += numbered(found.history, len(history))
        iterations, evaluations = iterations + found.iterations, evaluations + found.evaluations
        solution = replace(found, iterations=iterations, evaluations=evaluations, history=tuple(history), starts=solution.starts)
        noise = noise_of(misfit, solution.evaluation, selected)
        if misfit.weighted and solution.evaluation.misfit_db > errors.runaway * kept[1].evaluation.misfit_db + errors.least_runaway_db:
            # The covariance of a loosened state tolerates these residuals: in further rounds the noise would only grow.
            misfit, solution, noise = kept
            solution = replace(solution, iterations=iterations, evaluations=evaluations, history=tuple(history))
            break
        if round_ and abs(noise.variance - before) < change * max(before, errors.least_variance):
            break
    best = no_worse(misfit, solution, places, lambda theta: again(misfit, theta))
    return misfit, best, noise if best.theta is solution.theta else noise_of(misfit, best.evaluation, selected)


def extended_misfit(misfit: Misfit, model: Sensitive, nuisances: Sequence[Nuisance], variance: float) -> Misfit:
    """The same cost with nuisance parameters as further unknowns, each with its Gaussian prior.

    Parameters
    ----------
    misfit : Misfit
    model : ExtendedFrf
    nuisances : sequence of Nuisance
    variance : float
        Of a residual [dB²]: one standard deviation of a nuisance parameter costs as much as one of a residual.
    """
    # Without a prior of the boundary (eta = 0) the rows of the nuisance parameters still need a weight.
    eta = misfit.eta or LEAST_ETA
    rows = np.zeros((misfit.rows.shape[0] + len(nuisances), misfit.rows.shape[1] + len(nuisances)))
    rows[: misfit.rows.shape[0], : misfit.rows.shape[1]] = misfit.rows
    for i, nuisance in enumerate(nuisances):
        rows[misfit.rows.shape[0] + i, misfit.rows.shape[1] + i] = np.sqrt(variance / eta) / nuisance.std
    prior = np.concatenate([misfit.prior, [nuisance.mean for nuisance in nuisances]])
    return misfit.with_model(model, prior, rows, eta)


def posterior(misfit: Misfit, solution: Solution, shapes: Shapes, nuisances: Sequence[Nuisance], noise: Noise, prior: Floats) -> Posterior:
    """Posterior at the optimum: ``variance (JᵀJ + eta RᵀR)⁻¹``, see the guide's statistics page, section 5.

    Parameters
    ----------
    misfit : Misfit
        As it was minimised, nuisance parameters included.
    solution : Solution
        Its theta ends with the nuisance parameters; its Jacobian is to z and the nuisance parameters.
    shapes : Shapes
    nuisances : sequence of Nuisance
    noise : Noise
    prior : (size,) float array
        Prior mean of theta, without nuisance parameters.

    Returns
    -------
    Posterior
    """
    J = solution.evaluation.jacobian
    normal = J.T @ J
    size = prior.size
    # Directions of z that leave theta unchanged (bolts in one place, more bolts than terms) are determined by the prior alone.
    blind = np.eye(shapes.T.shape[1]) - np.linalg.pinv(shapes.T) @ shapes.T
    blind *= np.where(np.isfinite(shapes.std), 1.0 / shapes.std, 0.0)[:, None]
    normal[: blind.shape[0], : blind.shape[0]] += misfit.eta * blind.T @ blind
    # Unknowns without data and prior have no finite variance: a precision far below the largest one keeps the matrix regular.
    floor = 1e-10 * max(float(np.diag(normal).max(initial=0.0)), np.finfo(float).tiny)
    inverse = np.linalg.inv(normal + floor * np.eye(normal.shape[0]))
    rows = misfit.data_rows(solution.evaluation)
    told = noise.variance * inverse @ (J[:rows].T @ J[:rows]) @ inverse
    z = np.asarray(np.linalg.lstsq(shapes.T, solution.theta[:size] - prior, rcond=None)[0])
    held = np.isfinite(shapes.std) & (misfit.eta > 0)
    spread = np.full(shapes.std.size, np.inf)
    spread[held] = shapes.std[held] * np.sqrt(noise.variance / (misfit.eta or 1.0))
    values, covariance = solution.theta[size:], np.asarray(noise.variance * inverse)
    return Posterior(
        shapes=shapes, nuisances=tuple(nuisances), z=z, values=values, covariance=covariance, noise=noise, prior_std=spread, told=told
    )
