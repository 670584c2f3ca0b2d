"""What is squared: differences between model and measurement, bounded against wild lines, floored and weighted."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.errors import DataError
from lrbc_cli.updating.statistics.decibels import DB, decibel, noise_weights
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel
from lrbc_cli.updating.statistics.losses import on_sphere, soft
from lrbc_cli.updating.statistics.shared import Bands, Shared, band_means


@dataclass(frozen=True)
class ResidualOptions:
    """How the difference of a line is formed.

    Attributes
    ----------
    kind : str
        ``db``: difference of the magnitudes in dB, eqs. (29) to (31). ``log-complex``: ``20/ln10 ln(y/m)``, the difference in dB and the
        wrapped difference of the phases, a radian counting as 8.69 dB. ``sphere``: difference of the points on Riemann's sphere, see
        ``DataResidual.on_sphere``.
    loss_scale : float or None
        Differences well above it [dB] count by their size and no longer by its square; None: squares throughout.
    floor : float or None
        Level below a response's largest selected line [dB] under which differences fade.
    """

    kind: Literal["db", "log-complex", "sphere"] = "db"
    loss_scale: float | None = None
    floor: float | None = None

    @property
    def phase(self) -> bool:
        """Whether the phase enters, with a residual of its own: then the logarithmic derivatives have to be complex."""
        return self.kind in ("log-complex", "sphere")


class DataResidual:
    """Residuals of the data and their Jacobian, from the FRFs of the model and their logarithmic derivatives.

    Parameters
    ----------
    measured : (F, R) complex array
        NaN or zero where a line is not to count.
    options : ResidualOptions
    sigma : (F, R) float array or None
        Standard deviation of the measured magnitude [dB], NaN where unknown; lines are weighted by it, see ``noise_weights``.
    errors : ErrorModel
        Its model discrepancy is the first one.
    gains : (R, K) float array or None
        Gains of the responses that may be wrong at all lines alike, each with a standard deviation of one [dB]: taken out.

    Attributes
    ----------
    valid : (F, R) bool array
    target : (F, R) float array
        Measurement in dB, zero where not valid.
    level : float
        Standard deviation of the model discrepancy [dB].

    Raises
    ------
    DataError
        Where nothing is left to compare.
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
        # Where the loss is linearised in the gains, in their standard deviations.
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
        """(m, K) changes of small residuals by the gains; None without them."""
        if self.gains is None or self.options.kind == "sphere":
            return None
        rows = np.broadcast_to(self.gains, (*self.valid.shape, self.gains.shape[1]))[self.valid]
        return np.vstack([rows, np.zeros_like(rows)]) if self.phase else rows

    def _own_weights(self, count: int) -> Floats:
        """(count,) weights of the residuals."""
        return np.ones(count) if self._weights is None else np.tile(self._weights, count // self._weights.size)

    @property
    def weighted(self) -> bool:
        """Whether lines are weighted by what is known of their noise."""
        return self._sigma is not None or self._shifts is not None

    def with_level(self, level: float) -> DataResidual:
        """The same with another standard deviation of the model discrepancy [dB]."""
        other = copy(self)
        other._weigh(level)
        return other

    def weighted_as(self, other: DataResidual) -> DataResidual:
        """The same with the weights of another on the same lines."""
        found = copy(self)
        found._sigma, found._shifts, found._changes = other._sigma, other._shifts, other._changes
        found._gained, found._centre = other._gained, other._centre
        found._weigh(other.level)
        return found

    def with_gains(self, gains: Floats) -> DataResidual:
        """The same where such gains may be wrong, see the class."""
        other = copy(self)
        other.gains, other._centre = gains, np.zeros(gains.shape[1])
        other._gained = other._gain_rows()
        other._weigh(self.level)
        return other

    def gained_about(self, y: Complexes) -> DataResidual:
        """The same with the loss linearised in the gains about the most probable ones at the model's FRFs y (F, R)."""
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
        """The same between points on Riemann's sphere, whose equator is the mean level of each response: for a search.

        With one poles and zeros are the sphere's, and no FRF is further from another than its diameter. Each term moves an FRF by a Moebius
        transformation (eq. (28) and a change of rank one), smoothly also where a pole passes a line: in dB that is a ridge without bound,
        the narrower the less damping there is. About the mean level, differences are those of dB and phase.
        """
        other = copy(self)
        other.options, other._floor = ResidualOptions(kind="sphere"), None
        other._shifts, other._changes, other._gained = None, None, None
        other._centre = np.zeros_like(self._centre)
        other._weigh(self.level)
        return other

    def without(self, y: Complexes, share: float) -> DataResidual:
        """The same without the share of the values that lie furthest from the model's FRFs y (F, R)."""
        distance = np.abs(decibel(y) - self.target)[self.valid]
        other = copy(self)
        other._sigma = np.where(distance > np.quantile(distance, 1.0 - share), np.inf, 0.0 if self._sigma is None else self._sigma)
        other._weigh(self.level)
        return other

    def with_change(self, y: Complexes, change: Floats, most: float, shifts: Floats | Complexes, band: Integers) -> DataResidual:
        """The same where the model has moved by so much [dB] from a state that it explains: a share of that may be wrong.

        Of every line for itself, and of the mean over the lines of a band together: the lines about a resonance gain and lose alike.

        Parameters
        ----------
        y : (F, R) complex array
            FRFs there.
        change : (F, R) float array
            In dB.
        most : float
            The error that no change exceeds: that of a state which is compared with nothing [dB].
        shifts : (F, R, K) float or complex array
            Errors that all responses share, each with a standard deviation of one: ``20/ln10`` times the change of ln(H).
        band : (F,) int array
            Lines of one band of a response share the error of their mean change.

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
        # Nothing is wrong with a model that explains its reference state exactly.
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
        """The same without weights."""
        other = copy(self)
        other._weights = other._bands = other._shared = other._gained = None
        return other

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of the covariance of the residuals over ``level²``; lines that are only noise do not count."""
        weights = 0.0 if self._weights is None else float(np.log(self._weights[self._weights > 0]).sum())
        # Real and imaginary parts have the same weights.
        shared = sum(part.log_det for part in (self._bands, self._shared) if part is not None)
        return -2.0 * weights * (2 if self.phase else 1) + shared

    def carried(self, columns: Floats, other: DataResidual) -> Floats:
        """Derivatives of residuals as another that differs in the weights only gives them, as this one would."""
        before = other._own_weights(columns.shape[0])
        plain = columns if other._shared is None else other._shared.undo(columns)
        plain = plain if other._bands is None else other._bands.undo(plain)
        share = np.divide(self._own_weights(columns.shape[0]), before, out=np.zeros_like(before), where=before > 0)
        return self._whiten(share[:, None] * plain)

    def raw(self, y: Complexes) -> Floats:
        """Residuals before they are weighted, and without a gain."""
        found = self._plain()(y, np.zeros((*y.shape, 0), dtype=complex))[0]
        return found if self._gained is None else found - self._gained @ self._centre

    def follow(self, y: Complexes, spent: float) -> float:
        """Standard deviation of the model discrepancy, by the residuals that are left [dB].

        The s at which the sum of squares is ``s²`` for each residual less those that the unknowns take: lines that the measurement's noise
        explains, and errors that lines share, tell nothing of the rest.

        Parameters
        ----------
        y : (F, R) complex array
            FRFs at the optimum.
        spent : float
            Unknowns that the residuals determine.

        Returns
        -------
        float
            At least the least discrepancy of the error model; the present one where nothing is known of the noise.
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
        # Loaded here: most commands do without.
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
        """Residuals at the valid lines.

        Parameters
        ----------
        y : (F, R) complex array
        J : (F, R, size) float or complex array
            ``20/ln10 dln(y)/dtheta``; its real part suffices without the phase.

        Returns
        -------
        residual : (m,) float array
            [dB]; real parts, then imaginary parts where the phase enters.
        jacobian : (m, size) float array
        difference : (v,) float array
            Plain difference in dB of each valid line, gains taken out.
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
        if self.options.loss_scale is not None:
            residual, jacobian = soft(residual, jacobian, self.options.loss_scale)
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
        """(K,) most probable gains, in standard deviations, by the residuals without a gain."""
        if self._gained is None or self._shared is None:
            return np.zeros(0)
        own = residual if weighted else self._own_weights(residual.size) * residual
        plain = own if self._bands is None else self._bands(own)
        return -self._shared.sizes(plain / self.level)[-self._gained.shape[1] :]

    def gains_db(self, y: Complexes) -> Floats | None:
        """(R,) by how much measured lies above the model's FRFs y at all lines, most probably [dB]; None where no gain is allowed for."""
        return None if self.gains is None or self._gained is None else np.asarray(self.gains @ self._sizes(self.raw(y)))

    def gains_std(self, jacobian: Floats, covariance: Floats, variance: float) -> Floats | None:
        """(R,) standard deviations of those gains [dB].

        Parameters
        ----------
        jacobian : (m, n) float array
            Of the residuals to unknowns, as a call gives it.
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
        """Differences of the three coordinates, one after the other; the scale is such that a dB at the equator counts as one."""
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
        """Difference in dB, of ``sqrt(|H|² + f²)`` where there is a floor f, with that of the phases as imaginary part."""
        real, slope = difference, np.ones_like(difference)
        weight: Floats | float = 1.0
        if self._floor is not None:
            power, before = np.abs(now) ** 2, np.abs(self._measured) ** 2
            real = 0.5 * DB * np.log((power + self._floor) / (before + self._floor))
            slope = power / (power + self._floor)
            # The phase fades as the magnitude does, by what was measured: so both parts weigh the same where the model fits.
            weight = before / (before + self._floor)
        real_rows = slope[:, None] * jacobian.real
        if not self.phase:
            return real, real_rows
        angle = weight * DB * np.angle(now / self._measured)
        return real + 1j * angle, real_rows + 1j * (np.broadcast_to(weight, angle.shape)[:, None] * jacobian.imag)
