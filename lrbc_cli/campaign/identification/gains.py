"""Gains: factors of FRFs that are the same at all lines, caused by wrong sensitivities.

A job may differ from the reference job by one gain that all responses share (another hammer), or all of one sensor or hammer point,
the reference job from the model by one gain of each response. Which gains are believed: guide page *statistics*, section 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.campaign.identification.compared.sensors import ends_of
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.statistics.error_model import ErrorModel


@dataclass(frozen=True)
class Sharers:
    """Responses that share a gain relative to the reference job.

    Attributes
    ----------
    kind : str
        ``"all"``, ``"sensor"`` or ``"hammer point"``.
    responses : tuple of int
        All of them, also those that are not used.
    """

    kind: str
    responses: tuple[int, ...]

    def among(self, inputs: Inputs) -> Bools:
        """(U,) which of the responses used."""
        return np.isin(inputs.used, self.responses)


@dataclass(frozen=True)
class Gains:
    """Levels of measured above expected FRFs, the same at all lines.

    Attributes
    ----------
    values, stds : (U,) float arrays
        Gains of the responses used, and their standard deviations [dB].
    shared : Sharers or None
        Responses with one gain relative to the reference job; None: one of each relative to the model.
    """

    values: Floats
    stds: Floats
    shared: Sharers | None

    @property
    def mean(self) -> tuple[float, float]:
        """Mean gain of the responses used, or the one that responses share, and its standard deviation [dB]."""
        if self.shared is not None:
            at = int(np.argmax(np.abs(self.values)))
            return float(self.values[at]), float(self.stds[at])
        return float(self.values.mean()), float(np.sqrt(np.mean(self.stds**2) / self.stds.size))

    def alike(self, errors: ErrorModel) -> bool:
        """Whether the gains are shared, or differ by less than ``gain_shown`` times their mean."""
        return self.shared is not None or float(np.ptp(self.values)) < errors.gain_shown * abs(float(self.values.mean()))

    def seen(self, errors: ErrorModel) -> Bools:
        """(U,) whether the 95 % interval of a gain lies beyond ``least_gain_db``, the accuracy of a calibrated measuring chain."""
        return np.asarray(np.abs(self.values) - NORMAL_95 * self.stds > errors.least_gain_db)

    def shown(self, elsewhere: Floats, errors: ErrorModel) -> Bools:
        """(U,) whether the lines that were not compared confirm a gain; damping moves levels about resonances, and others hardly.

        Parameters
        ----------
        elsewhere : (m, U) float array
            Measured levels above those that the fit expects, on the lines that are not compared [dB]; without values a gain is confirmed.
        """
        every = self.shared is not None and self.shared.kind == "all"
        middle = np.array([_median(elsewhere if every else elsewhere[:, at]) for at in range(self.values.size)])
        return np.asarray(np.isnan(middle) | (np.abs(middle - self.values) < errors.gain_shown * np.abs(self.values)))

    def over(self, inputs: Inputs) -> Floats:
        """(R,) gains of all responses [dB]; without shared ones, validation channels get the mean of the others, shrunk to zero."""
        found = np.full(len(inputs.responses), 0.0 if self.shared else self.mean[0] * self.values.size / (1.0 + self.values.size))
        found[inputs.used] = self.values
        if self.shared is not None:
            found[list(self.shared.responses)] = self.mean[0]
        return found

    def factors(self, inputs: Inputs) -> Floats:
        """(R,) gains of all responses as factors of the FRFs."""
        return np.asarray(10.0 ** (self.over(inputs) / 20.0))


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def everything(inputs: Inputs) -> Sharers:
    """All responses: the gain of another hammer."""
    return Sharers("all", tuple(range(len(inputs.responses))))


def columns_of(inputs: Inputs, shared: Sharers | None) -> Floats:
    """(U, K) prior gains of one standard deviation [dB]: one that responses share; or, with None, one of all and one of each."""
    own = np.hstack([np.ones((inputs.used.size, 1)), np.eye(inputs.used.size)]) if shared is None else shared.among(inputs)[:, None]
    return np.asarray(inputs.statistics.errors.gain_db * own)


def sharers(inputs: Inputs, elsewhere: Floats) -> Iterator[Sharers]:
    """Responses that may share a gain, in the order in which it is looked for: those of one sensor or hammer point, then all.

    A sensor or hammer point is asked for if the levels of all its responses differ from those expected in one direction, by more than
    ``least_gain_db``, and those of all others by less than ``gain_shown`` times as much.

    Parameters
    ----------
    elsewhere : (m, U) float array
        See ``Gains.shown``.
    """
    middle, errors = np.array([_median(column) for column in elsewhere.T]), inputs.statistics.errors
    found: list[tuple[float, Sharers]] = []
    for group in (Sharers(kind, responses) for kind, responses in ends_of(inputs)):
        among = group.among(inputs)
        own, others = (values[np.isfinite(values)] for values in (middle[among], middle[~among]))
        if not own.size or not others.size or np.ptp(np.sign(own)):
            continue
        least, most = float(np.abs(own).min()), float(np.abs(others).max())
        if least > errors.least_gain_db and most < errors.gain_shown * least:
            found.append((most / least, group))
    if found:
        yield min(found, key=lambda each: each[0])[1]
    yield everything(inputs)


def gains_of(
    inputs: Inputs, misfit: Misfit, theta: Floats, jacobian: Floats, covariance: Floats, variance: float, *, shared: Sharers | None
) -> Gains | None:
    """Gains at an optimum; None if the cost has none. For the parameters see ``Misfit.gains``."""
    found = misfit.gains(theta, jacobian, covariance, variance)
    if found is None:
        return None
    reach = inputs.statistics.values.nuisance_reach * inputs.statistics.errors.gain_db
    return Gains(np.clip(found[0], -reach, reach), found[1], shared)


def none_shown(inputs: Inputs, elsewhere: Floats) -> bool:
    """Whether the levels on lines that are not compared differ so little from the model that they could confirm no gain.

    Parameters
    ----------
    elsewhere : (m, U) float array
        As in ``Gains.shown``, for a fit without gains.
    """
    middle, errors = np.array([_median(column) for column in elsewhere.T]), inputs.statistics.errors
    return bool(middle.size and np.all(np.abs(middle) < errors.gain_shown * errors.least_gain_db))


def kept(inputs: Inputs, gains: Gains | None, left: tuple[float, float], elsewhere: Floats) -> bool:
    """Whether gains are accepted: the misfit falls with them, and at least one is significant and confirmed by other lines.

    If bolts change much, errors of the predicted changes resemble a gain: one with which the misfit does not fall is none. Relative to the
    model, factors of mass and stiffness together can act like a gain; values of one sensor may differ at a few lines. Unless all responses
    share the gain, the square of the misfit must therefore also fall by the mean square of the gains times ``gain_shown`` squared.

    Parameters
    ----------
    inputs : Inputs
    gains : Gains or None
    left : (float, float)
        Misfit without and with gains [dB].
    elsewhere : (m, U) float array
        See ``Gains.shown``.
    """
    errors = inputs.statistics.errors
    if gains is None or not left[1] < left[0]:
        return False
    every = gains.shared is not None and gains.shared.kind == "all"
    if not every and left[0] ** 2 - left[1] ** 2 < errors.gain_shown**2 * float(np.mean(gains.values**2)):
        return False
    return bool(np.any(gains.seen(errors) & gains.shown(elsewhere, errors)))
