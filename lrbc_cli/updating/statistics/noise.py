"""Variance of the residuals and their effective sample size; they divide JᵀJ in every posterior.

Most of a residual is model error, which neighbouring lines share: hence the correlation factor and the coarsening.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Scatter of the residuals.

    Attributes
    ----------
    sigma : float
        Standard deviation of a residual [dB], degrees of freedom of the unknowns subtracted.
    factor : float
        Correlation factor: variance of an estimate over that with independent residuals.
    ratio : float
        Errors of the model over what the residuals show, see ``validation_ratio``.
    coarsening : float
        Number of residuals that count as one, see ``ErrorModel``; 1 if the noise is not estimated from residuals.
    """

    sigma: float
    factor: float
    ratio: float = 1.0
    coarsening: float = 1.0

    @property
    def variance(self) -> float:
        """``coarsening sigma² factor`` [dB²], the variance of a residual in every posterior."""
        return self.sigma**2 * self.factor * self.coarsening

    def at(self, sigma: float) -> Noise:
        """The same with another standard deviation of a residual [dB]."""
        return replace(self, sigma=sigma)


def validation_ratio(validation_db: float | None, used_db: float | None) -> float:
    """Misfit of the validation channels over that of the channels used, at least 1: how far errors of the model exceed the residuals.

    The unknowns absorb part of the model discrepancy, so the residuals of fitted channels show less than all of it. On virtual rigs the
    errors of identified changes grow with this ratio.

    Parameters
    ----------
    validation_db, used_db : float or None
        Mean misfits, each line weighted by its noise [dB]; None if nothing was compared, which gives 1.
    """
    if not validation_db or not used_db or not np.isfinite(validation_db / used_db):
        return 1.0
    return max(validation_db / used_db, 1.0)


def widened(variance: Floats | float, told: Floats | float, ratio: float) -> Floats:
    """Covariance of an estimate if the errors of the data are ``ratio`` times those assumed, with the same prior.

    Parameters
    ----------
    variance : float array
        ``s² H⁻¹``, with H of data and prior together.
    told : float array
        ``s² H⁻¹ JᵀJ H⁻¹``, the part that comes from errors of the data.
    ratio : float
    """
    return np.asarray(variance + (ratio**2 - 1.0) * told)


def correlation_factor(residual: Floats, jacobian: Floats, line: Integers, response: Integers, errors: ErrorModel = ERRORS) -> float:
    """Correlation factor c: variance of the estimates over what it would be if residuals of neighbouring lines were independent.

    ``1 + 2 sum_k rho_r(k) rho_J(k)`` over the lags k, with the autocorrelations of residuals and of Jacobian along the lines: the variance
    of a least-squares estimate with autocorrelated errors and regressors.

    Parameters
    ----------
    residual : (m,) float array
    jacobian : (m, k) float array
        Of these residuals.
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
    # Columns of the Jacobian are not normalised: each counts by its share of the sum of squares.
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
    """Effective number of unknowns that the data determine: ``tr((JᵀJ + PᵀP)⁻¹ JᵀJ)``.

    Parameters
    ----------
    jacobian, penalty : (m, k) and (q, k) float arrays
        J of the data residuals, and P of the weighted penalty.
    """
    normal = jacobian.T @ jacobian
    return float(np.trace(np.linalg.lstsq(normal + penalty.T @ penalty, normal, rcond=1e-12)[0]))


def estimate_noise(
    residual: Floats, jacobian: Floats, penalty: Floats, line: Integers, response: Integers, errors: ErrorModel = ERRORS
) -> Noise:
    """Scatter of the data residuals at an optimum, with correlation factor and coarsening.

    Parameters
    ----------
    residual, jacobian : (m,) and (m, k) float arrays
        Of the data [dB].
    penalty : (q, k) float array
        Jacobian of the weighted penalty, see ``spent``.
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
    return Noise(sigma=sigma, factor=factor, coarsening=errors.coarsening)
