"""The cost of the paper (29): squared dB differences of the FRFs plus a Tikhonov term on the log10 parameters."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.misfit.frf import Sensitive
from lrbc_cli.updating.statistics.decibels import DB, decibel
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel
from lrbc_cli.updating.statistics.noise import spent
from lrbc_cli.updating.statistics.residuals import DataResidual, ResidualOptions


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Cost and its ingredients at one theta.

    Attributes
    ----------
    cost : float
        log10 of ``total``, eq. (29).
    total : float
        Sum of squares of data and regularisation [dB²].
    data : float
        Part of the FRFs.
    misfit_db : float
        Mean absolute difference in dB over the selected lines and responses, whatever the residual, its loss and its weights.
    residual : (m,) float array
        Data residuals, then weighted deviations from the prior.
    jacobian : (m, size) float array
    """

    cost: float
    total: float
    data: float
    misfit_db: float
    residual: Floats = field(repr=False)
    jacobian: Floats = field(repr=False)

    @property
    def gradient(self) -> Floats:
        """Of ``cost``: 2 Jᵀr / (ln 10 total)."""
        return np.asarray(2.0 * self.jacobian.T @ self.residual / (np.log(10.0) * self.total))


def penalty_rows(parameters: Parameterisation, value: float = 1.0, slope: float = 0.0) -> Floats:
    """Rows of the regularisation: departures from the prior, and their differences along each edge, or from the mean of the joints.

    Parameters
    ----------
    parameters : Parameterisation
    value, slope : float
        Weights of the departures, and of their differences between neighbours, or from the mean of a group of joints [per decade].

    Returns
    -------
    (m, size) float array
        p_damp has no row.
    """
    rows: list[Floats] = []
    for group, values, _ in parameters.placed:
        eye = np.eye(group.count)
        for weight, order in ((value, 0), (slope, 1)):
            if weight > 0 and group.count > order:
                # Joints stand in no order: they are alike, each as much as any other.
                part = np.diff(eye, n=order, axis=0) if group.bolt is None or not order else eye - 1.0 / group.count
                block = np.zeros((part.shape[0], parameters.size))
                block[:, values] = np.sqrt(weight) * part
                rows.append(block)
    return np.vstack(rows) if rows else np.zeros((0, parameters.size))


#: Distance of the lines between which a slope is taken, over the highest line.
SLOPE_STEP = 1e-4


@dataclass(frozen=True, kw_only=True)
class ChangeError:
    """How wrong a predicted change of the FRFs may be.

    A resonance that the model moves may in fact have moved by some percent more or less, in all responses alike: an unknown shift of the
    axis of frequency, piecewise linear, with a standard deviation of that share of how far the resonances nearby have moved. And
    levels may have changed by some percent more or less: every line for itself, and those of a response about a resonance together.

    Attributes
    ----------
    most : float
        Error of a level that no change exceeds [dB].
    here, nearby : callable
        From the boundary's theta to (F, R) FRFs at the lines, and at lines that lie ``step_hz`` above.
    frequency_hz : (F,) float array
    step_hz : float
    size : int
        Of that theta; what drifted stands behind it.
    errors : ErrorModel
    """

    most: float
    here: Callable[[Floats], Complexes]
    nearby: Callable[[Floats], Complexes]
    frequency_hz: Floats = field(repr=False)
    step_hz: float
    size: int
    errors: ErrorModel = ERRORS
    _kept: dict[bytes, tuple[Complexes, Complexes]] = field(default_factory=dict, repr=False)

    def _sloped(self, theta: Floats) -> tuple[Complexes, Complexes]:
        """(F, R) FRFs, and their slopes along the frequency [dB/Hz], radians counting as 8.69 dB."""
        y = self.here(theta[: self.size])
        with np.errstate(divide="ignore", invalid="ignore"):
            return y, np.asarray(DB * np.log(self.nearby(theta[: self.size]) / y) / self.step_hz, dtype=complex)

    def __call__(self, prior: Floats, theta: Floats) -> tuple[Floats, Complexes, Integers]:
        """(F, R) change of the levels from the prior to theta [dB], (F, R, K) shifts of one standard deviation, (F,) the knot nearby."""
        f = self.frequency_hz
        spacing = self.errors.shift_knots * f.max()
        knots = np.arange(f.min() - spacing, f.max() + 2 * spacing, spacing)
        hats = np.column_stack([np.interp(f, knots, row) for row in np.eye(knots.size)])
        hats = hats[:, hats.any(axis=0)]
        key = prior[: self.size].tobytes()
        if key not in self._kept:
            self._kept[key] = self._sloped(prior)
        before, first = self._kept[key]
        now, slope = self._sloped(theta)
        with np.errstate(divide="ignore", invalid="ignore"):
            change = decibel(now) - decibel(before)
        slope, first, change = (np.where(np.isfinite(x), x, 0.0) for x in (slope, first, change))
        steep = 0.5 * (slope.real**2 + first.real**2)
        shift = np.sqrt((hats.T @ (change**2).sum(axis=1)) / np.maximum(hats.T @ steep.sum(axis=1), np.finfo(float).tiny))
        shifts = np.asarray(slope[:, :, None] * (self.errors.shift_error * hats * shift)[:, None, :])
        return change, shifts, hats.argmax(axis=1)


class Misfit:
    """Cost (29) with gradient and Jacobian at the selected lines.

    Parameters
    ----------
    model : FrfModel
        At the selected lines, responses used only.
    measured : (F, R) complex array
        Measured FRFs there; lines that are not to count are NaN.
    prior : (size,) float array
        p_init of the Tikhonov term.
    eta : float
        Weight of the squared departures [dB²/decade²]; p_damp is not regularised.
    penalty : (m, size) float array or None
        Rows that are applied to ``p - p_init`` before squaring, see ``penalty_rows``; the departures themselves where None, as in (29).

    options : ResidualOptions or None
        How data residuals are formed; as in (29) where None.
    sigma : (F, R) float array or None
        Standard deviation of the measured magnitude [dB], by which lines are weighted.
    errors : ErrorModel
    sharp : bool
        Whether the lines do not resolve the peaks: then squares in dB have a valley between any two lines, see ``on_sphere``.
    gains : (R, K) float array or None
        See ``DataResidual``.

    Raises
    ------
    DataError
        Where nothing is left to compare.
    """

    def __init__(
        self,
        model: Sensitive,
        measured: Complexes,
        prior: Floats,
        eta: float,
        penalty: Floats | None = None,
        *,
        options: ResidualOptions | None = None,
        sigma: Floats | None = None,
        errors: ErrorModel = ERRORS,
        sharp: bool = False,
        gains: Floats | None = None,
    ) -> None:
        self.model, self.errors, self.sharp = model, errors, sharp
        self._data = DataResidual(measured, options, sigma, errors, gains)
        self.prior, self.eta = prior, eta
        rows = penalty_rows(model.parameters) if penalty is None else penalty
        self.rows = rows[np.any(rows != 0.0, axis=1)]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(F, R) lines that count."""
        return self._data.valid

    @property
    def target(self) -> Floats:
        """(F, R) measurement in dB, zero where it does not count."""
        return self._data.target

    @property
    def penalty(self) -> Floats:
        """(m, size) rows of the penalty with its weight."""
        return np.asarray(np.sqrt(self.eta) * self.rows)

    def data_rows(self, evaluation: Evaluation) -> int:
        """How many of its residuals are the data's; those of the penalty stand behind them."""
        return int(evaluation.residual.size - self.rows.shape[0])

    @property
    def lines(self) -> int:
        """Lines of one evaluation."""
        return int(self.model.s.size)

    def __call__(self, theta: Floats) -> Evaluation:
        """Evaluate cost, residual and Jacobian in a single pass."""
        y, J = self.model.sensitivities(theta, self._data.phase)
        own, rows, difference = self._data(y, J)
        penalty = self.penalty
        residual = np.concatenate([own, penalty @ (theta - self.prior)])
        jacobian = np.vstack([rows, penalty])
        data = float(own @ own)
        total = max(float(residual @ residual), np.finfo(float).tiny)
        cost, misfit_db = float(np.log10(total)), float(np.mean(np.abs(difference)))
        return Evaluation(cost=cost, total=total, data=data, misfit_db=misfit_db, residual=residual, jacobian=jacobian)

    def on(self, model: Sensitive, measured: Complexes) -> Misfit:
        """The same cost with another model and measurement, on other lines that weigh alike."""
        data = self._data
        return Misfit(model, measured, self.prior, self.eta, self.rows, options=data.options, errors=self.errors, gains=data.gains)

    def mean_db(self, y: Complexes) -> float:
        """Mean absolute difference in dB, as in ``Evaluation``."""
        gains = self._data.gains_db(y)
        return float(np.mean(np.abs(decibel(y) - self.target + (0.0 if gains is None else gains))[self.valid]))

    def data_sum(self, theta: Floats, frf: Callable[[Floats], Complexes] | None = None) -> float:
        """Sum of squares of the data residuals, without derivatives; with another way to the same FRFs, see ``FrfModel.nearby``."""
        y = (frf or self.model.frf)(theta)
        own, _, _ = self._data(y, np.zeros((*y.shape, 0), dtype=complex))
        return float(own @ own)

    def sum(self, theta: Floats, frf: Callable[[Floats], Complexes] | None = None) -> float:
        """Sum of squares of data and penalty, without derivatives."""
        return self.data_sum(theta, frf) + self.eta * self.departures(theta)

    def departures(self, theta: Floats) -> float:
        """Sum of squares of the penalty before it is weighted by eta [decade²]."""
        rows = self.rows @ (theta - self.prior)
        return float(rows @ rows)

    def with_rows(self, rows: Floats) -> Misfit:
        """The same cost with other rows of the penalty."""
        other = copy(self)
        other.rows = rows[np.any(rows != 0.0, axis=1)]
        return other

    def _with_data(self, data: DataResidual) -> Misfit:
        other = copy(self)
        other._data = data
        return other

    def with_model(self, model: Sensitive, prior: Floats, rows: Floats, eta: float) -> Misfit:
        """The same comparison with FRFs that depend on more."""
        other = copy(self)
        other.model, other.prior, other.eta = model, prior, eta
        return other.with_rows(rows)

    @property
    def level(self) -> float:
        """Standard deviation of the model discrepancy [dB]."""
        return self._data.level

    @property
    def coarsening(self) -> float:
        """How many residuals count as one: values along an edge are held by their neighbours."""
        return self.errors.coarsening if self.model.parameters.of_joints else 1.0

    @property
    def weighted(self) -> bool:
        """Whether lines are weighted by what is known of their noise."""
        return self._data.weighted

    def with_level(self, level: float) -> Misfit:
        """The same cost with another standard deviation of the model discrepancy."""
        return self._with_data(self._data.with_level(level))

    def weighted_as(self, other: Misfit) -> Misfit:
        """The same cost with the weights of another on the same lines."""
        return self._with_data(self._data.weighted_as(other._data))

    def with_gains(self, gains: Floats) -> Misfit:
        """The same cost where such gains may be wrong, see ``DataResidual``."""
        return self._with_data(self._data.with_gains(gains))

    def gained_about(self, theta: Floats) -> Misfit:
        """The same cost, linearised in the gains that may be wrong about the most probable ones at theta; itself without such gains."""
        if self._data.gains is None:
            return self
        return self._with_data(self._data.gained_about(self.model.frf(theta)))

    def on_sphere(self) -> Misfit:
        """The same cost with differences that are bounded at poles and zeros alike, see ``DataResidual.on_sphere``."""
        return self._with_data(self._data.on_sphere())

    def without(self, theta: Floats, share: float) -> Misfit:
        """The same cost without the share of the measured values that lie furthest from the model at theta."""
        return self._with_data(self._data.without(self.model.frf(theta), share))

    def about(self, theta: Floats, error: ChangeError) -> Misfit:
        """The same cost with lines weighted by how far the boundary has moved the model at theta from the prior."""
        change, shifts, band = error(self.prior, theta)
        return self._with_data(self._data.with_change(self.model.frf(theta), change, error.most, shifts, band))

    def gains(self, theta: Floats, jacobian: Floats, covariance: Floats, variance: float) -> tuple[Floats, Floats] | None:
        """Gains of the responses at an optimum and their standard deviations [dB]; None where none are allowed for.

        Parameters
        ----------
        theta : (size,) float array
        jacobian : (m, n) float array
            Of the data residuals there, to the unknowns.
        covariance : (n, n) float array
            Of these.
        variance : float
            Of the residuals [dB²].
        """
        found, std = self._data.gains_db(self.model.frf(theta)), self._data.gains_std(jacobian, covariance, variance)
        return None if found is None or std is None else (found, std)

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of the covariance of the data residuals over ``level²``."""
        return self._data.log_det

    def carried(self, columns: Floats, other: Misfit) -> Floats:
        """Derivatives of the data residuals of another that differs in the weights only, as this one would give them."""
        return self._data.carried(columns, other._data)

    def followed(self, theta: Floats, evaluation: Evaluation) -> float:
        """Standard deviation of the model discrepancy, by what is left at an optimum [dB]: see ``DataResidual.follow``."""
        rows = self.data_rows(evaluation)
        return self._data.follow(self.model.frf(theta), spent(evaluation.jacobian[:rows], evaluation.jacobian[rows:]))

    def with_eta(self, eta: float) -> Misfit:
        """The same cost with another weight of the penalty."""
        other = copy(self)
        other.eta = eta
        return other


def mean_misfit(y: Complexes, measured: Complexes) -> Floats:
    """(R,) mean absolute dB difference of each response over the lines where it was measured."""
    valid = np.isfinite(measured) & (np.abs(measured) > 0)
    difference = np.abs(decibel(y) - decibel(np.where(valid, measured, 1.0)))
    count = valid.sum(axis=0)
    return np.where(count > 0, np.where(valid, difference, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
