"""The cost of the paper (29): squared dB differences of the FRFs plus a Tikhonov term on the log10 parameters.

``Misfit`` is what all searches minimise and what the posterior linearises. It joins the FRFs of the model (``misfit/frf``) to the
whitened residuals of the data (``statistics/residuals``) and to the rows of the prior.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.knots import hats
from lrbc_cli.updating.misfit.frf import Sensitive, changed
from lrbc_cli.updating.statistics.decibels import DB, decibel
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel
from lrbc_cli.updating.statistics.noise import spent
from lrbc_cli.updating.statistics.residuals import DataResidual, ResidualOptions


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Cost, residuals and Jacobian at one theta.

    Attributes
    ----------
    cost : float
        log10 of ``total``, eq. (29).
    total : float
        Sum of squares of data residuals and penalty [dB²].
    data : float
        Sum of squares of the data residuals alone [dB²].
    misfit_db : float
        Mean absolute difference in dB over the selected lines and responses, without loss and weights, gains taken out.
    residual : (m,) float array
        Data residuals, then the weighted departures from the prior [dB].
    jacobian : (m, size) float array
        Of ``residual`` to theta.
    """

    cost: float
    total: float
    data: float
    misfit_db: float
    residual: Floats = field(repr=False)
    jacobian: Floats = field(repr=False)

    @property
    def gradient(self) -> Floats:
        """(size,) gradient of ``cost``: 2 Jᵀr / (ln 10 total)."""
        return np.asarray(2.0 * self.jacobian.T @ self.residual / (np.log(10.0) * self.total))


def penalty_rows(parameters: Parameterisation, value: float = 1.0, slope: float = 0.0) -> Floats:
    """Rows R of the penalty ``|R (theta - prior)|²`` for the values of each group.

    A group has a row for the departure of each value from the prior, and rows for differences: between neighbours along an edge, or from
    the mean of the group among joints, which have no order.

    Parameters
    ----------
    parameters : Parameterisation
    value, slope : float
        Weights of the squares of departures and of differences [1/decade²]; the rows hold their square roots, 0 omits the rows.

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
                # Joints have no order: each is compared with the mean of its group.
                part = np.diff(eye, n=order, axis=0) if group.bolt is None or not order else eye - 1.0 / group.count
                block = np.zeros((part.shape[0], parameters.size))
                block[:, values] = np.sqrt(weight) * part
                rows.append(block)
    return np.vstack(rows) if rows else np.zeros((0, parameters.size))


#: Step of the finite difference along the frequency, as a fraction of the highest line.
SLOPE_STEP = 1e-4


@dataclass(frozen=True, kw_only=True)
class ChangeError:
    """Error of a predicted change of the FRFs; its parts ``sigma_l``, G and P are defined on the guide's statistics page, section 3.

    A resonance that the model shifts may in fact have shifted by some per cent more or less, in all responses alike: an unknown piecewise
    linear shift of the frequency axis, whose standard deviation is a share of the predicted shift of the resonances nearby (P). Levels may
    have changed by some per cent more or less, each line by itself (sigma_l) and the lines of a response about a resonance together (G).

    Attributes
    ----------
    most : float
        Upper limit of the error of a level: that of the reference state [dB].
    here, above : Sensitive
        FRFs (F, R) at the lines, and at lines ``step_hz`` above them.
    frequency_hz : (F,) float array
    step_hz : float
    size : int
        Number of boundary parameters; entries of theta beyond these are nuisance parameters and are ignored here.
    errors : ErrorModel
    """

    most: float
    here: Sensitive
    above: Sensitive
    frequency_hz: Floats = field(repr=False)
    step_hz: float
    size: int
    errors: ErrorModel = ERRORS
    _kept: dict[bytes, tuple[Complexes, Complexes]] = field(default_factory=dict, repr=False)

    def _sloped(self, theta: Floats) -> tuple[Complexes, Complexes]:
        """(F, R) FRFs and ``20/ln10 d ln(H)/df`` [dB/Hz]; in the imaginary part a radian counts as 8.69 dB."""
        y = self.here.frf(theta[: self.size])
        with np.errstate(divide="ignore", invalid="ignore"):
            return y, np.asarray(DB * np.log(self.above.frf(theta[: self.size]) / y) / self.step_hz, dtype=complex)

    def _before(self, prior: Floats) -> tuple[Complexes, Complexes]:
        """``_sloped`` in the state from which changes are predicted, computed once."""
        key = prior[: self.size].tobytes()
        if key not in self._kept:
            self._kept[key] = self._sloped(prior)
        return self._kept[key]

    def near(self, theta: Floats) -> ChangeError:
        """The same error, faster at states that differ from theta in few stiffnesses."""
        own = theta[: self.size]
        return replace(self, here=self.here.near(own), above=self.above.near(own))

    def weakened(self, terms: Integers, decades: float, factor: Complexes | None, prior: Floats) -> ChangeError:
        """The same error, of states in which some terms changed besides, see ``Misfit.weakened``; ``prior`` is the state without."""
        self._before(prior)
        return replace(self, here=changed(self.here, terms, decades, factor), above=changed(self.above, terms, decades, factor))

    def __call__(self, prior: Floats, theta: Floats) -> tuple[Floats, Complexes, Integers]:
        """Predicted change of the FRFs from prior to theta, and the errors of its shifts of resonances.

        Returns
        -------
        change : (F, R) float array
            Change of the levels [dB].
        shifts : (F, R, K) complex array
            Change of ``20/ln10 ln(H)`` by a shift of the frequency axis at each of K knots, of one standard deviation [dB].
        band : (F,) int array
            Nearest knot of each line.
        """
        f = self.frequency_hz
        spacing = self.errors.shift_knots * f.max()
        knots = np.arange(f.min() - spacing, f.max() + 2 * spacing, spacing)
        shapes = hats(f, knots)
        shapes = shapes[:, shapes.any(axis=0)]
        before, first = self._before(prior)
        now, slope = self._sloped(theta)
        with np.errstate(divide="ignore", invalid="ignore"):
            change = decibel(now) - decibel(before)
        slope, first, change = (np.where(np.isfinite(x), x, 0.0) for x in (slope, first, change))
        steep = 0.5 * (slope.real**2 + first.real**2)
        shift = np.sqrt((shapes.T @ (change**2).sum(axis=1)) / np.maximum(shapes.T @ steep.sum(axis=1), np.finfo(float).tiny))
        shifts = np.asarray(slope[:, :, None] * (self.errors.shift_error * shapes * shift)[:, None, :])
        return change, shifts, shapes.argmax(axis=1)


class Misfit:
    """The cost ``rᵀr + eta |R (theta - prior)|²`` with gradient and Jacobian at the selected lines; immutable, changed copies by methods.

    Parameters
    ----------
    model : Sensitive
        FRFs at the selected lines, of the compared responses.
    measured : (F, R) complex array
        Measured FRFs there; NaN where a value is not compared.
    prior : (size,) float array
        p_init of the Tikhonov term.
    eta : float
        Weight of the penalty [dB² per unit of the squared rows; dB²/decade² in (29)].
    penalty : (m, size) float array or None
        Rows R, see ``penalty_rows``; None for the departures themselves, as in (29), without p_damp.
    options : ResidualOptions or None
        How data residuals are formed; None for (29).
    sigma : (F, R) float array or None
        Standard deviation of the measured magnitude [dB], by which lines are weighted.
    errors : ErrorModel
    sharp : bool
        Whether the lines do not resolve the peaks. Squares of dB then have a valley wherever a pole lies between two lines, see
        ``on_sphere``.
    gains : (R, K) float array or None
        See ``DataResidual``.

    Raises
    ------
    DataError
        If no measured value is left to compare with.
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
        """(F, R) whether a value is compared."""
        return self._data.valid

    @property
    def target(self) -> Floats:
        """(F, R) measured levels [dB], zero where not compared."""
        return self._data.target

    @property
    def penalty(self) -> Floats:
        """(m, size) rows of the penalty with their weight, ``sqrt(eta) R``."""
        return np.asarray(np.sqrt(self.eta) * self.rows)

    def data_rows(self, evaluation: Evaluation) -> int:
        """Number of data residuals in an evaluation; they come before those of the penalty."""
        return int(evaluation.residual.size - self.rows.shape[0])

    @property
    def lines(self) -> int:
        """Number of lines F of one evaluation."""
        return int(self.model.s.size)

    def __call__(self, theta: Floats) -> Evaluation:
        """Cost, residual and Jacobian at theta, from one evaluation of the model."""
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
        """The same cost with another model and measurement, on other lines; without noise weights."""
        data = self._data
        return Misfit(model, measured, self.prior, self.eta, self.rows, options=data.options, errors=self.errors, gains=data.gains)

    def mean_db(self, y: Complexes) -> float:
        """Mean absolute difference [dB] of FRFs y (F, R) from the measurement, as ``Evaluation.misfit_db``."""
        gains = self._data.gains_db(y)
        return float(np.mean(np.abs(decibel(y) - self.target + (0.0 if gains is None else gains))[self.valid]))

    def near(self, theta: Floats) -> Misfit:
        """The same cost, faster at states that differ from theta in few stiffnesses."""
        other = copy(self)
        other.model = self.model.near(theta)
        return other

    def weakened(self, terms: Integers, decades: float, factor: Complexes | None = None) -> Misfit:
        """The same cost, of a model with some terms changed and its FRFs times a factor, see ``frf.changed``."""
        other = copy(self)
        other.model = changed(self.model, terms, decades, factor)
        return other

    @property
    def cells(self) -> Integers:
        """(n,) response and band of G (``ErrorModel.shift_knots``) of each data residual, as one number."""
        f = np.abs(self.model.s)
        band = np.round((f - f.min()) / (self.errors.shift_knots * f.max())).astype(int)
        own = (band[:, None] + (band.max() + 1) * np.arange(self.valid.shape[1]))[self.valid]
        return np.tile(own, 2 if self._data.phase else 1)

    def residuals(self, theta: Floats) -> Floats:
        """Data residuals [dB], without derivatives."""
        y = self.model.frf(theta)
        return self._data(y, np.zeros((*y.shape, 0), dtype=complex))[0]

    def data_sum(self, theta: Floats) -> float:
        """Sum of squares of ``residuals`` [dB²]."""
        own = self.residuals(theta)
        return float(own @ own)

    def sum(self, theta: Floats) -> float:
        """Sum of squares of data residuals and penalty [dB²], without derivatives."""
        return self.data_sum(theta) + self.eta * self.departures(theta)

    def departures(self, theta: Floats) -> float:
        """``|R (theta - prior)|²``, the penalty before it is weighted by eta."""
        rows = self.rows @ (theta - self.prior)
        return float(rows @ rows)

    def with_rows(self, rows: Floats) -> Misfit:
        """The same cost with other rows R of the penalty; rows of zeros are dropped."""
        other = copy(self)
        other.rows = rows[np.any(rows != 0.0, axis=1)]
        return other

    def _with_data(self, data: DataResidual) -> Misfit:
        other = copy(self)
        other._data = data
        return other

    def with_model(self, model: Sensitive, prior: Floats, rows: Floats, eta: float) -> Misfit:
        """The same comparison with a model that has more unknowns, and their prior, rows and weight."""
        other = copy(self)
        other.model, other.prior, other.eta = model, prior, eta
        return other.with_rows(rows)

    @property
    def level(self) -> float:
        """Standard deviation of the model discrepancy [dB]."""
        return self._data.level

    @property
    def coarsening(self) -> float:
        """See ``ErrorModel.coarsening_of``."""
        return self.errors.coarsening_of(self.model.parameters.of_joints)

    @property
    def weighted(self) -> bool:
        """Whether lines have weights, by their noise or by errors of a predicted change."""
        return self._data.weighted

    def with_level(self, level: float) -> Misfit:
        """The same cost with another standard deviation of the model discrepancy."""
        return self._with_data(self._data.with_level(level))

    def weighted_as(self, other: Misfit) -> Misfit:
        """The same cost with the weights of another one, which has the same lines."""
        return self._with_data(self._data.weighted_as(other._data))

    def with_gains(self, gains: Floats) -> Misfit:
        """The same cost with gains as marginalised errors, see ``DataResidual``."""
        return self._with_data(self._data.with_gains(gains))

    def gained_about(self, theta: Floats) -> Misfit:
        """The same cost, its loss linearised about the most probable gains at theta; unchanged if there are no gains."""
        if self._data.gains is None:
            return self
        return self._with_data(self._data.gained_about(self.model.frf(theta)))

    def on_sphere(self) -> Misfit:
        """The same cost with differences on Riemann's sphere, bounded at poles and zeros, see ``DataResidual.on_sphere``."""
        return self._with_data(self._data.on_sphere())

    def without(self, theta: Floats, share: float) -> Misfit:
        """The same cost without that share of the measured values whose levels differ most from the model at theta."""
        return self._with_data(self._data.without(self.model.frf(theta), share))

    def about(self, theta: Floats, error: ChangeError) -> Misfit:
        """The same cost with the errors of the change predicted from the prior to theta: the covariance of section 3 at this state."""
        change, shifts, band = error(self.prior, theta)
        return self._with_data(self._data.with_change(self.model.frf(theta), change, error.most, shifts, band))

    def gains(self, theta: Floats, jacobian: Floats, covariance: Floats, variance: float) -> tuple[Floats, Floats] | None:
        """Gains of the responses at an optimum and their standard deviations, each (R,) [dB]; None if there are no gains.

        Parameters
        ----------
        theta : (size,) float array
        jacobian : (m, n) float array
            Of the data residuals there to n unknowns.
        covariance : (n, n) float array
            Of the unknowns.
        variance : float
            Of the residuals [dB²].
        """
        found, std = self._data.gains_db(self.model.frf(theta)), self._data.gains_std(jacobian, covariance, variance)
        return None if found is None or std is None else (found, std)

    @property
    def log_det(self) -> float:
        """``log det(Cov(q) / level²)`` of the data residuals."""
        return self._data.log_det

    def carried(self, columns: Floats, other: Misfit) -> Floats:
        """Columns of the Jacobian of the data residuals, computed with the weights of ``other``, converted to the weights of this cost."""
        return self._data.carried(columns, other._data)

    def followed(self, theta: Floats, evaluation: Evaluation) -> float:
        """Standard deviation of the model discrepancy from the residuals at an optimum [dB], see ``DataResidual.follow``."""
        rows = self.data_rows(evaluation)
        return self._data.follow(self.model.frf(theta), spent(evaluation.jacobian[:rows], evaluation.jacobian[rows:]))

    def with_eta(self, eta: float) -> Misfit:
        """The same cost with another weight eta of the penalty."""
        other = copy(self)
        other.eta = eta
        return other


def mean_misfit(y: Complexes, measured: Complexes) -> Floats:
    """(R,) mean absolute dB difference of each response over the lines where it was measured; NaN if there are none."""
    valid = np.isfinite(measured) & (np.abs(measured) > 0)
    difference = np.abs(decibel(y) - decibel(np.where(valid, measured, 1.0)))
    count = valid.sum(axis=0)
    return np.where(count > 0, np.where(valid, difference, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
