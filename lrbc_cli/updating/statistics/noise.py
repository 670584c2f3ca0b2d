"""How far the residuals scatter, and their effective sample size: most of what is left is model error, which neighbours share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel


@dataclass(frozen=True)
class Noise:
    """Scatter of the residuals.

    Attributes
    ----------
    sigma : float
        Standard deviation of a residual [dB], unknowns accounted for.
    factor : float
        Variance of an estimate over what it would be with independent residuals.
    ratio: float
        How many times larger errors are where nothing was fitted, see ``validation_ratio``.
    coarsening : float
        How many residuals tell as much as one, see ``ErrorModel``; 1 where no residual tells the noise.
    """

    sigma: float
    factor: float
    ratio: float = 1.0
    coarsening: float = 1.0

    @property
    def variance(self) -> float:
        """sigma² times the factor and the coarsening [dB²]: divides JᵀJ in every posterior."""
        return self.sigma**2 * self.factor * self.coarsening

    def at(self, sigma: float) -> Noise:
        """The same with another scatter of a residual [dB]."""
        return replace(self, sigma=sigma)


def validation_ratio(validation_db: float | None, used_db: float | None) -> float:
    """How many times larger than the residuals the errors of the model are, by responses that were not fitted; at least 1.

    Unknowns take up part of the model discrepancy, so that the residuals of the channels used tell less than that. Where the two misfits
    agree, they tell it. On virtual rigs the errors of identified changes grow with this ratio as the residuals do not.

    Parameters
    ----------
    validation_db, used_db : float or None
        Mean misfits, each line by its noise [dB]; None where nothing was compared.
    """
    if not validation_db or not used_db or not np.isfinite(validation_db / used_db):
        return 1.0
    return max(validation_db / used_db, 1.0)


def widened(variance: Floats | float, told: Floats | float, ratio: float) -> Floats:
    """Variance of an estimate whose data err by ``ratio`` times as much as they were weighted by, the prior being what it was.

    Parameters
    ----------
    variance : float array
        ``s² H⁻¹``, of data and prior together.
    told : float array
        ``s² H⁻¹ JᵀJ H⁻¹``, what of it the errors of the data make.
    ratio : float
    """
    return np.asarray(variance + (ratio**2 - 1.0) * told)


def correlation_factor(residual: Floats, jacobian: Floats, line: Integers, response: Integers, errors: ErrorModel = ERRORS) -> float:
    """Inflation of the variance of the estimates by residuals that neighbouring lines share.

    ``1 + 2 sum_k rho_r(k) rho_J(k)`` over the lags k: residuals that are correlated harm where the sensitivities are correlated over
    the same lags (variance of a least-squares estimate with autocorrelated errors and regressors).

    Parameters
    ----------
    residual : (m,) float array
    jacobian : (m, k) float array
        Of the same residuals.
    line, response : (m,) int arrays
        Index of the measured line, and of the response (or part of it), of each residual.
    errors : ErrorModel

    Returns
    -------
    float
        At least 1.
    """
    if residual.size == 0:
        return 1.0
    count = int(line.max()) + 1
    at = np.full((int(response.max()) + 1, count), -1)
    at[response, line] = np.arange(residual.size)
    power = float(np.mean(residual**2))
    # The columns of the Jacobian have different sizes: each counts by its share of the sum of squares.
    strength = float(np.sum(jacobian**2)) / residual.size
    if power == 0.0 or strength == 0.0:
        return 1.0
    factor = 1.0
    for lag in range(1, min(errors.most_lags, count - 1) + 1):
        both = (at[:, :-lag] >= 0) & (at[:, lag:] >= 0)
        first, second = at[:, :-lag][both], at[:, lag:][both]
        if first.size < errors.least_pairs:
            break
        rho = float(np.mean(residual[first] * residual[second])) / power
        if rho < errors.least_correlation:
            break
        along = float(np.sum(jacobian[first] * jacobian[second])) / first.size / strength
        factor += 2.0 * rho * along * first.size / residual.size
    return max(factor, 1.0)


def spent(jacobian: Floats, penalty: Floats) -> float:
    """How many unknowns the data determine, the penalty taking freedom from them.

    Parameters
    ----------
    jacobian, penalty : (m, k) and (q, k) float arrays
        Of the data, and of the weighted penalty.
    """
    normal = jacobian.T @ jacobian
    return float(np.trace(np.linalg.lstsq(normal + penalty.T @ penalty, normal, rcond=1e-12)[0]))


def estimate_noise(
    residual: Floats,
    jacobian: Floats,
    penalty: Floats,
    line: Integers,
    response: Integers,
    errors: ErrorModel = ERRORS,
) -> Noise:
    """Scatter of the data residuals at an optimum.

    Parameters
    ----------
    residual, jacobian : (m,) and (m, k) float arrays
        Of the data.
    penalty : (q, k) float array
        Jacobian of the penalty, weighted: it takes freedom from the unknowns.
    line, response : (m,) int arrays
        See ``correlation_factor``.
    errors : ErrorModel

    Returns
    -------
    Noise
    """
    freedom = max(residual.size - spent(jacobian, penalty), 1.0)
    sigma = float(np.sqrt(residual @ residual / freedom))
    factor = correlation_factor(residual, jacobian, line, response, errors)
    return Noise(sigma, factor, coarsening=errors.coarsening)
