"""Residuals between model and measurement: differences in dB, optionally with phase, floor and soft loss, whitened by their covariance.

``DataResidual`` holds the covariance ``diag(s² + sigma_n² + sigma_l²) + G Gᵀ + P Pᵀ`` (guide, *statistics*, section 3); ``Misfit``
adds the prior.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.updating.checked import Checked, Positive
from lrbc_cli.updating.statistics.decibels import DB, decibel, noise_weights
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel
from lrbc_cli.updating.statistics.losses import Loss, Soft, on_sphere
from lrbc_cli.updating.statistics.shared import Bands, Shared, band_means


@dataclass(frozen=True, kw_only=True)
class ResidualOptions(Checked):
    """How the difference of model and measurement at a line is formed.

    Attributes
    ----------
    kind : str
        ``db``: difference of the magnitudes in dB, eqs. (29) to (31). ``log-complex``: ``20/ln10 ln(y/m)``, the difference in dB and the
        wrapped difference of the phases, where a radian counts as 8.69 dB. ``sphere``: difference of the points on Riemann's sphere, see
        ``DataResidual.on_sphere``.
    loss_scale : float or None
        Scale a of the soft loss [dB], see ``losses.Soft``; None for squares, or ``loss``.
    loss : Loss or None
        Another loss.
    floor : float or None
        Depth below a response's largest selected line [dB] beyond which differences are damped out; None for no floor.
    """

    kind: Literal["db", "log-complex", "sphere"] = "db"
    loss_scale: Positive | None = None
    loss: Loss | None = None
    floor: Positive | None = None

    def __post_init__(self) -> None:
        """See ``Checked``; there can be one loss only."""
        super().__post_init__()
        if self.loss is not None and self.loss_scale is not None:
            raise ConfigError("two losses", place="ResidualOptions", expected="loss or loss_scale", found="both")

    @property
    def phase(self) -> bool:
        """Whether the phase is compared, which needs the complex derivatives of ``20/ln10 ln(H)``."""
        return self.kind in ("log-complex", "sphere")

    @cached_property
    def transform(self) -> Loss | None:
        """The loss, soft or another; None for squares."""
        return self.loss if self.loss_scale is None else Soft(scale=self.loss_scale)


class DataResidual:
    """Whitened residuals of the data and their Jacobian, from the FRFs of the model and their logarithmic derivatives.

    Immutable; methods return changed copies. Whitened residuals have the variance ``s²``: a line without noise keeps its difference in dB.

    Parameters
    ----------
    measured : (F, R) complex array
        NaN or zero where a value is not compared.
    options : ResidualOptions or None
        None for (29).
    sigma : (F, R) float array or None
        Standard deviation sigma_n of the measured magnitude [dB], NaN if unknown; lines are weighted by it, see ``noise_weights``.
    errors : ErrorModel
        Gives the first model discrepancy ``s`` among others.
    gains : (R, K) float array or None
        Unknown gains, the same at all lines: a column is the change of the responses by one standard deviation of a gain [dB]. They are
        marginalised, as further columns beside P.

    Attributes
    ----------
    valid : (F, R) bool array
        Whether a value is compared.
    target : (F, R) float array
        Measured level [dB], zero where not valid.
    level : float
        Standard deviation s of the model discrepancy [dB].

    Raises
    ------
    DataError
        If no measured value is left to compare with.
    """

    def __init__(
        self,
        measured: Complexes,
        options: ResidualOptions | None = None,
        sigma: Floats | None = None,
        errors: ErrorModel = ERRORS,
        gains: Floats | None = None,
    ) -> None:
        self.errors, self.gains = errors, gains
        self.options = ResidualOptions() if options is None else options
        self.valid = np.isfinite(measured) & (np.abs(measured) > 0)
        if not self.valid.any():
            raise DataError("no measured value is left to compare with", expected="finite, non-zero FRFs on the selected lines")
        filled = np.where(self.valid, measured, 1.0)
        self.target = np.where(self.valid, decibel(filled), 0.0)
        self._measured = filled[self.valid]
        self._sigma = None if sigma is None else np.nan_to_num(sigma[self.valid], nan=0.0, posinf=np.inf)
        power = np.where(self.valid, np.abs(filled) ** 2, 0.0)
        self._floor: Floats | None = None
        if self.options.floor is not None:
            floor = power.max(axis=0) * 10.0 ** (-self.options.floor / 10.0)
            self._floor = np.broadcast_to(floor, self.valid.shape)[self.valid]
        self._noise = self._sigma
        self._shifts: Floats | None = None
        self._changes: tuple[Floats, Integers] | None = None
        # Gains about which the loss is linearised, in their standard deviations.
        self._centre = np.zeros(0 if gains is None else gains.shape[1])
        self._gained = self._gain_rows()
        self._weigh(errors.first_discrepancy_db)

    def _weigh(self, level: float) -> None:
        self.level = level
        self._weights = None if self._sigma is None else noise_weights(self._sigma, level)
        self._bands: Bands | None = None
        self._shared: Shared | None = None
        patterns = [part for part in (self._shifts, self._gained) if part is not None]
        if not patterns:
            return
        columns = np.hstack(patterns)
        own = self._own_weights(len(columns)) / level
        if self._changes is not None:
            size, band = self._changes
            self._bands = Bands(own * size, band)
        columns = own[:, None] * columns
        self._shared = Shared(columns if self._bands is None else self._bands(columns))

    def _gain_rows(self) -> Floats | None:
        """(m, K) derivative of the residuals to the gains, without the soft loss; None if there are no gains or on the sphere."""
        if self.gains is None or self.options.kind == "sphere":
            return None
        rows = np.broadcast_to(self.gains, (*self.valid.shape, self.gains.shape[1]))[self.valid]
        return np.vstack([rows, np.zeros_like(rows)]) if self.phase else rows

    def _own_weights(self, count: int) -> Floats:
        """(count,) weights of the residuals; real and imaginary parts have the same."""
        return np.ones(count) if self._weights is None else np.tile(self._weights, count // self._weights.size)

    @property
    def weighted(self) -> bool:
        """Whether lines have weights, by their noise or by errors of a predicted change."""
        return self._sigma is not None or self._shifts is not None

    def with_level(self, level: float) -> DataResidual:
        """The same with another standard deviation s of the model discrepancy [dB]."""
        other = copy(self)
        other._weigh(level)
        return other

    def weighted_as(self, other: DataResidual) -> DataResidual:
        """The same with the weights of another one, which has the same lines."""
        found = copy(self)
        found._sigma, found._shifts, found._changes = other._sigma, other._shifts, other._changes
        found._gained, found._centre = other._gained, other._centre
        found._weigh(other.level)
        return found

    def with_gains(self, gains: Floats) -> DataResidual:
        """The same with these unknown gains, see the class."""
        other = copy(self)
        other.gains, other._centre = gains, np.zeros(gains.shape[1])
        other._gained = other._gain_rows()
        other._weigh(self.level)
        return other

    def gained_about(self, y: Complexes) -> DataResidual:
        """The same with the soft loss linearised about the most probable gains at the model's FRFs y (F, R), found in ``gain_rounds``."""
        other = self
        for _ in range(0 if self._gained is None else self.errors.gain_rounds):
            assert self.gains is not None
            centred = copy(self)
            centred._centre = other._sizes(other.raw(y))
            columns = np.broadcast_to(self.gains, (*self.valid.shape, self.gains.shape[1]))
            centred._gained = centred._plain()(y, columns)[1]
            centred._weigh(self.level)
            other = centred
        return other

    def on_sphere(self) -> DataResidual:
        """The same with differences of points on Riemann's sphere, for a search where lines do not resolve the peaks.

        FRFs are projected stereographically, with the mean measured level of each response as equator. Zeros and poles are the two poles of
        the sphere, so differences are bounded by its diameter. Each term changes an FRF by a Moebius transformation (eq. (28), a change of
        rank one), which is smooth on the sphere even where a resonance passes a line; in dB this is an unbounded ridge, the narrower the
        less damping there is. Near the mean level the differences equal those of dB and phase.
        """
        other = copy(self)
        other.options, other._floor = ResidualOptions(kind="sphere"), None
        other._shifts, other._changes, other._gained = None, None, None
        other._centre = np.zeros_like(self._centre)
        other._weigh(self.level)
        return other

    def without(self, y: Complexes, share: float) -> DataResidual:
        """The same without that share of the values whose levels differ most from the model's FRFs y (F, R)."""
        distance = np.abs(decibel(y) - self.target)[self.valid]
        other = copy(self)
        other._sigma = np.where(distance > np.quantile(distance, 1.0 - share), np.inf, 0.0 if self._sigma is None else self._sigma)
        other._weigh(self.level)
        return other

    def with_change(self, y: Complexes, change: Floats, most: float, shifts: Floats | Complexes, band: Integers) -> DataResidual:
        """The same with the errors sigma_l, G and P of a predicted change of the FRFs, see ``ChangeError``.

        A share of the predicted change may be wrong: at every line by itself (sigma_l), and of the mean over the lines of a band together
        (G), because levels about a resonance rise and fall together.

        Parameters
        ----------
        y : (F, R) complex array
            FRFs of the model in the changed state.
        change : (F, R) float array
            Predicted change of the levels [dB].
        most : float
            Upper limit of the error of a level: that of the reference state [dB].
        shifts : (F, R, K) float or complex array
            Columns of P: change of ``20/ln10 ln(H)`` by one standard deviation of each shift, common to all responses [dB].
        band : (F,) int array
            Band of each line.

        Returns
        -------
        DataResidual
        """
        other = self._changed(y, change, most, shifts, band)
        for _ in range(0 if self.gains is None else self.errors.gain_rounds):
            centred = copy(self)
            centred._centre = other._sizes(other.raw(y))
            other = centred._changed(y, change, most, shifts, band)
        return other

    def _changed(self, y: Complexes, change: Floats, most: float, shifts: Floats | Complexes, band: Integers) -> DataResidual:
        other = self._plain()
        wrong = self.errors.change_error * change
        both = np.hypot(wrong, most)
        # Without error of the reference state (most = 0) no error of a change is assumed.
        wrong = np.divide(wrong * most, both, out=np.zeros_like(wrong), where=both > 0)
        own = np.abs(wrong[self.valid])
        other._sigma = own if self._noise is None else np.hypot(self._noise, own)
        mean, count = band_means(wrong, band, self.valid), int(band.max()) + 1
        parts = [shifts, ((1.0 + 1.0j) * mean if self.phase else mean)[:, :, None]]
        if self.gains is not None:
            parts.append(np.broadcast_to(self.gains, (*mean.shape, self.gains.shape[1])))
        errors = np.concatenate(parts, axis=2)
        _, rows, _ = other(y, errors if self.phase else errors.real)
        bands = (band[:, None] + count * np.arange(change.shape[1]))[self.valid]
        if self.phase:
            bands = np.concatenate([bands, bands + count * change.shape[1]])
        known = shifts.shape[2]
        other._shifts, other._changes = rows[:, :known], (rows[:, known], bands)
        other._gained = None if self.gains is None else rows[:, known + 1 :]
        other._weigh(self.level)
        return other

    def _plain(self) -> DataResidual:
        """The same without weights and whitening."""
        other = copy(self)
        other._weights = other._bands = other._shared = other._gained = None
        return other

    @property
    def log_det(self) -> float:
        """``log det(Cov(q) / s²)``, without lines of infinite sigma."""
        weights = 0.0 if self._weights is None else float(np.log(self._weights[self._weights > 0]).sum())
        # Real and imaginary parts have the same weights.
        shared = sum(part.log_det for part in (self._bands, self._shared) if part is not None)
        return -2.0 * weights * (2 if self.phase else 1) + shared

    def carried(self, columns: Floats, other: DataResidual) -> Floats:
        """Columns of the Jacobian (m, n) computed with the weights of ``other``, converted to the weights of this one."""
        before = other._own_weights(columns.shape[0])
        plain = columns if other._shared is None else other._shared.undo(columns)
        plain = plain if other._bands is None else other._bands.undo(plain)
        share = np.divide(self._own_weights(columns.shape[0]), before, out=np.zeros_like(before), where=before > 0)
        return self._whiten(share[:, None] * plain)

    def raw(self, y: Complexes) -> Floats:
        """(m,) residuals q before weights and whitening, with gains of zero [dB]."""
        found = self._plain()(y, np.zeros((*y.shape, 0), dtype=complex))[0]
        return found if self._gained is None else found - self._gained @ self._centre

    def follow(self, y: Complexes, spent: float) -> float:
        """Standard deviation s of the model discrepancy from the residuals [dB]: solves ``rᵀr = s² (m - spent)``.

        r are the whitened residuals at s, so that what noise and common errors explain is not counted as model discrepancy.

        Parameters
        ----------
        y : (F, R) complex array
            FRFs at the optimum.
        spent : float
            Number of unknowns that the residuals determine, see ``noise.spent``.

        Returns
        -------
        float
            Within the limits of the error model; the present s if the lines have no weights.
        """
        if not self.weighted:
            return self.level
        residual = self.raw(y)
        freedom = max(float(residual.size) - spent, 1.0)

        def excess(log_level: float) -> float:
            level = float(np.exp(log_level))
            other = self.with_level(level)
            own = other._whiten(other._own_weights(residual.size) * residual)
            return float(own @ own) / level**2 / freedom - 1.0

        least, most = self.errors.least_discrepancy_db, self.errors.most_discrepancy_db
        low, high = np.log(least), np.log(most)
        if excess(low) <= 0.0:
            return least
        # Imported here: most commands do not need it.
        from scipy.optimize import brentq

        return most if excess(high) >= 0.0 else float(np.exp(brentq(excess, low, high, xtol=1e-3)))

    def _whiten(self, columns: Floats) -> Floats:
        columns = columns if self._bands is None else self._bands(columns)
        return columns if self._shared is None else self._shared(columns)

    @property
    def phase(self) -> bool:
        """See ``ResidualOptions.phase``."""
        return self.options.phase

    def __call__(self, y: Complexes, J: Floats | Complexes) -> tuple[Floats, Floats, Floats]:
        """Whitened residuals r of the compared values, and their Jacobian.

        Parameters
        ----------
        y : (F, R) complex array
            FRFs of the model.
        J : (F, R, size) float or complex array
            ``20/ln10 dln(y)/dtheta``; its real part suffices if the phase is not compared.

        Returns
        -------
        residual : (m,) float array
            [dB]; levels, then phases if they are compared.
        jacobian : (m, size) float array
        difference : (v,) float array
            Difference of the levels of each compared value without loss and weights, most probable gains taken out [dB].
        """
        if self.gains is not None and self._centre.any():
            y = y * 10.0 ** (self.gains @ self._centre / 20.0)
        difference = (decibel(y) - self.target)[self.valid]
        jacobian: NDArray[Any] = J[self.valid]
        residual: NDArray[Any] = difference
        if self.options.kind == "sphere":
            residual, jacobian = self._spherical(y[self.valid], jacobian)
        elif self.phase or self._floor is not None:
            residual, jacobian = self._logarithmic(y[self.valid], difference, jacobian)
        if self.options.transform is not None:
            residual, jacobian = self.options.transform(residual, jacobian)
        if self._weights is not None:
            weights = self._own_weights(len(residual))
            residual, jacobian = weights * residual, weights[:, None] * jacobian
        if np.iscomplexobj(residual):
            residual, jacobian = np.concatenate([residual.real, residual.imag]), np.vstack([jacobian.real, jacobian.imag])
        found = np.asarray(residual)
        if self.gains is not None and self._gained is not None:
            found = found - self._own_weights(len(found)) * (self._gained @ self._centre)
            gain = self.gains @ (self._sizes(found, weighted=True) - self._centre)
            difference = difference + np.broadcast_to(gain, self.valid.shape)[self.valid]
        return self._whiten(found), self._whiten(np.asarray(jacobian)), difference

    def _sizes(self, residual: Floats, weighted: bool = False) -> Floats:
        """(K,) most probable gains in their standard deviations, from residuals with gains of zero."""
        if self._gained is None or self._shared is None:
            return np.zeros(0)
        own = residual if weighted else self._own_weights(residual.size) * residual
        plain = own if self._bands is None else self._bands(own)
        return -self._shared.sizes(plain / self.level)[-self._gained.shape[1] :]

    def gains_db(self, y: Complexes) -> Floats | None:
        """(R,) most probable gains of the measured responses relative to the model's FRFs y (F, R) [dB]; None if there are no gains."""
        return None if self.gains is None or self._gained is None else np.asarray(self.gains @ self._sizes(self.raw(y)))

    def gains_std(self, jacobian: Floats, covariance: Floats, variance: float) -> Floats | None:
        """(R,) standard deviations of the most probable gains [dB]; None if there are no gains.

        Parameters
        ----------
        jacobian : (m, n) float array
            Of the whitened residuals to n unknowns.
        covariance : (n, n) float array
            Of the unknowns.
        variance : float
            Of the residuals [dB²].
        """
        if self.gains is None or self._gained is None or self._shared is None:
            return None
        spread = self._shared.sizes_covariance(self._shared.undo(jacobian) / self.level, covariance, variance / self.level**2)
        own = spread[-self.gains.shape[1] :, -self.gains.shape[1] :]
        return np.asarray(np.sqrt(np.einsum("rk,kl,rl->r", self.gains, own, self.gains)))

    def _spherical(self, now: Complexes, jacobian: Complexes) -> tuple[Floats, Floats]:
        """Differences of the three coordinates on the sphere, one after the other, scaled so that 1 dB at the equator counts as 1."""
        level = (band_means(self.target, np.zeros(len(self.target), dtype=np.int64), self.valid)[self.valid]) / DB
        (here, along), (there, _) = (
            on_sphere(np.asarray(decibel(x) / DB - level), np.asarray(np.angle(x), dtype=float)) for x in (now, self._measured)
        )
        by_level, by_phase = along
        rows = by_level[:, :, None] * jacobian.real + by_phase[:, :, None] * jacobian.imag
        return DB * (here - there).ravel(), rows.reshape(here.size, jacobian.shape[1])

    def _logarithmic(
        self, now: Complexes, difference: Floats, jacobian: Floats | Complexes
    ) -> tuple[Floats | Complexes, Floats | Complexes]:
        """Difference of the levels in dB, of ``sqrt(|H|² + f²)`` with a floor f, and that of the phases as imaginary part if compared."""
        real, slope = difference, np.ones_like(difference)
        weight: Floats | float = 1.0
        if self._floor is not None:
            power, before = np.abs(now) ** 2, np.abs(self._measured) ** 2
            real = 0.5 * DB * np.log((power + self._floor) / (before + self._floor))
            slope = power / (power + self._floor)
            # The phase is damped by the measured magnitude, so that both parts have the same weight where the model fits.
            weight = before / (before + self._floor)
        real_rows = slope[:, None] * jacobian.real
        if not self.phase:
            return real, real_rows
        angle = weight * DB * np.angle(now / self._measured)
        return real + 1j * angle, real_rows + 1j * (np.broadcast_to(weight, angle.shape)[:, None] * jacobian.imag)
