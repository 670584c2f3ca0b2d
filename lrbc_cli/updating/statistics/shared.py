"""Whitening of residuals with common errors: G, common to the lines of a band, and P, patterns over all lines.

Both work on residuals in standard deviations, whose covariance is ``I + GGᵀ`` or ``I + BBᵀ``; see the guide's statistics page, section 3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from lrbc_cli.arrays import Floats, Integers


def band_means(values: Floats, band: Integers, valid: NDArray[np.bool_] | None = None) -> Floats:
    """(F, R) mean of each response over the lines of the band (F,) that a line belongs to, over ``valid`` values (F, R) if given."""
    lies = (band[:, None] == np.arange(band.max() + 1)).astype(float)
    known = np.ones(values.shape, dtype=bool) if valid is None else valid
    return np.asarray((lies.T @ np.where(known, values, 0.0) / np.maximum(lies.T @ known, 1.0))[band])


class Bands:
    """The whitening ``(I + GGᵀ)^(-1/2)`` for one common error in each band; a residual belongs to one band, so a row of G has one value.

    Parameters
    ----------
    size : (m,) float array
        The values of G: change of a residual by one standard deviation of the common error, over the residual's own standard deviation.
    band : (m,) int array
        Band of each residual.
    """

    def __init__(self, size: Floats, band: Integers) -> None:
        self._errors = csr_array((size, band, np.arange(size.size + 1)), shape=(size.size, int(band.max(initial=-1)) + 1))
        self._power = np.bincount(band, size**2)
        self._known = self._power > 0.0
        #: log det of ``I + GGᵀ``.
        self.log_det = float(np.log1p(self._power).sum())

    def _scaled(self, columns: Floats, exponent: float) -> Floats:
        factor = np.zeros_like(self._power)
        factor[self._known] = ((1.0 + self._power[self._known]) ** exponent - 1.0) / self._power[self._known]
        along = self._errors.T @ columns
        return np.asarray(columns + self._errors @ (factor.reshape(-1, *[1] * (columns.ndim - 1)) * along))

    def __call__(self, columns: Floats) -> Floats:
        """Whiten columns of residuals or derivatives, (m,) or (m, n)."""
        return self._scaled(columns, -0.5)

    def undo(self, columns: Floats) -> Floats:
        """Inverse of the whitening."""
        return self._scaled(columns, 0.5)


class Shared:
    """The whitening ``(I + BBᵀ)^(-1/2)`` for k errors that all residuals share.

    Parameters
    ----------
    patterns : (m, k) float array
        B: change of the residuals by one standard deviation of each error, over the residuals' own standard deviations.
    """

    def __init__(self, patterns: Floats) -> None:
        self._patterns = patterns
        power, rotation = np.linalg.eigh(patterns.T @ patterns)
        #: (k, k) ``(I + BᵀB)⁻¹``.
        self._left = (rotation / (1.0 + np.maximum(power, 0.0))) @ rotation.T
        kept = power > 1e-10 * max(float(power.max(initial=0.0)), 1e-10)
        self._directions = patterns @ (rotation[:, kept] / np.sqrt(power[kept]))
        self._grown = np.sqrt(1.0 + power[kept])
        #: log det of ``I + BBᵀ``.
        self.log_det = float(2.0 * np.log(self._grown).sum())

    def __call__(self, columns: Floats) -> Floats:
        """Whiten columns of residuals or derivatives, (m,) or (m, n)."""
        return np.asarray(columns - (self._directions * (1.0 - 1.0 / self._grown)) @ (self._directions.T @ columns))

    def undo(self, columns: Floats) -> Floats:
        """Inverse of the whitening."""
        return np.asarray(columns + (self._directions * (self._grown - 1.0)) @ (self._directions.T @ columns))

    def sizes(self, residual: Floats) -> Floats:
        """(k,) most probable size of each common error, in its standard deviations, from residuals (m,) over their own."""
        return np.asarray(self._left @ (self._patterns.T @ residual))

    def sizes_covariance(self, jacobian: Floats, covariance: Floats, variance: float) -> Floats:
        """(k, k) covariance of the sizes of the common errors.

        Parameters
        ----------
        jacobian : (m, n) float array
            Of the residuals, over their own standard deviations, before whitening.
        covariance : (n, n) float array
            Of the unknowns.
        variance : float
            Of the residuals over their own standard deviations squared.
        """
        moved = self._left @ (self._patterns.T @ jacobian)
        return np.asarray(variance * self._left + moved @ covariance @ moved.T)
