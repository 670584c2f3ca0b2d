"""Gains: factors of FRFs that are the same at all lines, as sensitivities that are off leave them.

A job may differ from the reference job by one gain of all responses, another hammer; the reference job from the model by one of each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.statistics.error_model import ErrorModel


@dataclass(frozen=True)
class Gains:
    """By how much measured FRFs lie above expected ones at all lines.

    Attributes
    ----------
    values, stds : (U,) float arrays
        Of the responses used, and their standard deviations [dB].
    shared : bool
        One gain of all responses, against the reference job; else one of each, against the model.
    """

    values: Floats
    stds: Floats
    shared: bool

    @property
    def mean(self) -> tuple[float, float]:
        """Of all responses used; the standard deviation of a shared gain, else that of their mean."""
        return float(self.values.mean()), float(self.stds.max() if self.shared else np.sqrt(np.mean(self.stds**2) / self.stds.size))

    def alike(self, errors: ErrorModel) -> bool:
        """Whether all responses lie on one side, and less far from each other than from none."""
        return self.shared or float(np.ptp(self.values)) < errors.gain_shown * abs(float(self.values.mean()))

    def seen(self, errors: ErrorModel) -> Bools:
        """(U,) whether it lies, with its 95 % interval, beyond what a measuring chain is calibrated to."""
        return np.asarray(np.abs(self.values) - NORMAL_95 * self.stds > errors.least_gain_db)

    def shown(self, elsewhere: Floats, errors: ErrorModel) -> Bools:
        """(U,) whether a gain shows on lines where damping would not, which moves levels about resonances, and hardly others.

        Parameters
        ----------
        elsewhere : (m, U) float array
            By how much levels lie above what the fit expects on lines that are not compared [dB]; NaN where not known.
        """
        middle = np.array([_median(elsewhere if self.shared else elsewhere[:, at]) for at in range(self.values.size)])
        return np.asarray(np.isnan(middle) | (np.abs(middle - self.values) < errors.gain_shown * np.abs(self.values)))

    def over(self, inputs: Inputs) -> Floats:
        """(R,) those of all responses [dB]: of one that is not used what the others have in common, as far as they tell it."""
        found = np.full(len(inputs.responses), self.mean[0] * (1.0 if self.shared else self.values.size / (1.0 + self.values.size)))
        found[inputs.used] = self.values
        return found

    def factors(self, inputs: Inputs) -> Floats:
        """(R,) the same as factors on FRFs."""
        return np.asarray(10.0 ** (self.over(inputs) / 20.0))


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def columns_of(inputs: Inputs, *, shared: bool) -> Floats:
    """(U, K) gains that may be wrong, of one standard deviation [dB]: of all responses used, and of each where they are not shared."""
    common = np.ones((inputs.used.size, 1))
    return inputs.statistics.errors.gain_db * (common if shared else np.hstack([common, np.eye(inputs.used.size)]))


def gains_of(
    inputs: Inputs, misfit: Misfit, theta: Floats, jacobian: Floats, covariance: Floats, variance: float, *, shared: bool
) -> Gains | None:
    """Gains at an optimum; None where the cost allows for none. For the parameters see ``Misfit.gains``."""
    found = misfit.gains(theta, jacobian, covariance, variance)
    if found is None:
        return None
    reach = inputs.statistics.values.nuisance_reach * inputs.statistics.errors.gain_db
    return Gains(np.clip(found[0], -reach, reach), found[1], shared)


def none_shown(inputs: Inputs, elsewhere: Floats) -> bool:
    """Whether the lines that are not compared lie so near to the model that no gain of a response could show there.

    Parameters
    ----------
    elsewhere : (m, U) float array
        See ``Gains.shown``, of a fit without gains.
    """
    middle, errors = np.array([_median(column) for column in elsewhere.T]), inputs.statistics.errors
    return bool(middle.size and np.all(np.abs(middle) < errors.gain_shown * errors.least_gain_db))


def kept(inputs: Inputs, gains: Gains | None, left: tuple[float, float], elsewhere: Floats) -> bool:
    """Whether gains bring a fit nearer to the measurement, and one of them is seen and shows.

    Where bolts change much, errors of the predicted changes and a gain are told apart by little: one that leaves more than was left
    without it is none. Against the model the mass may be the inverse of a gain, and stiffnesses with it: there half of the gains has to be
    missing without them, by the squares, else nothing is wrong that they would mend.

    Parameters
    ----------
    inputs : Inputs
    gains : Gains or None
    left : (float, float)
        Misfit without gains, and with them [dB].
    elsewhere : (m, U) float array
        See ``Gains.shown``.
    """
    errors = inputs.statistics.errors
    if gains is None or not left[1] < left[0]:
        return False
    if not gains.shared and left[0] ** 2 - left[1] ** 2 < errors.gain_shown**2 * float(np.mean(gains.values**2)):
        return False
    return bool(np.any(gains.seen(errors) & gains.shown(elsewhere, errors)))
