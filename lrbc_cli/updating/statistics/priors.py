"""Priors of the unknowns: every number of the Gaussian priors and of the mixture prior of tight and loose bolts, in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.updating.checked import Checked, Inside, Negative, Positive, Share


@dataclass(frozen=True, kw_only=True)
class BoltPrior(Checked):
    """Prior of the change at a bolt that is tight or loose [decades]; see ``lrbc guide statistics``, section 6.

    Attributes
    ----------
    tight_std : float
        Standard deviation of the change of a tight bolt along an edge; its mean is zero. Retorquing scatters by 30 %, 0.11 decades at a
        bolt's patch; the hat, wider than the patch, spreads that.
    loose_mean, loose_std : float
        Of the change of a loose bolt: from a patch that has lost half its stiffness to one that has lost nearly all, spread by the hat.
    alone_mean, alone_std : float
        The same between tight neighbours, which take over part of the load. By trial on virtual rigs.
    joint_tight_std : float
        Of the change of a tight joint, a bolt that owns its terms: retorquing scatters by 30 %, a seat that is lifted and put down again
        by more, and no hat spreads it. 0.1 to 0.2 on virtual rigs.
    joint_loose_mean, joint_loose_std : float
        Of the change of a loose joint. Nothing beside it takes over its load, so 0.3 decades (half) to 3 (finger-tight, or free) are
        within one and a half to two standard deviations. A choice.
    deviation_std : float
        Of the change of each group of a joint (axial, rocking) about their common change. A choice: contact stiffness and the bending
        stiffness under it fall nearly alike.
    loose_share : float
        Prior probability that a bolt is loose. A choice: a campaign looks for few loose bolts among many.
    leakage : float
        Share of a loose bolt's change that a tight neighbour along its edge may show, because hats do not end where a gap does. 0.1 to
        0.3 on virtual rigs.
    """

    tight_std: Positive = 0.05
    loose_mean: Negative = -0.6
    loose_std: Positive = 0.3
    alone_mean: Negative = -0.5
    alone_std: Positive = 0.2
    joint_tight_std: Positive = 0.15
    joint_loose_mean: Negative = -1.5
    joint_loose_std: Positive = 0.8
    deviation_std: Positive = 0.15
    loose_share: Inside = 0.1
    leakage: Share = 0.3

    @property
    def joint_slight_loss(self) -> float:
        """Upper quartile of the change of a loose joint: three of four have lost more [decades]."""
        return self.joint_loose_mean + 0.6745 * self.joint_loose_std

    def tables(self, joint: Bools) -> tuple[Floats, Floats]:
        """(b, 2, 2) precision [1/decade²] and mean [decades] of each bolt's change; axes: tight or loose, and 1 if a neighbour is loose.

        Parameters
        ----------
        joint : (b,) bool array
            Bolts that own their terms; the others have hats along an edge.
        """
        std = np.array([[[self.tight_std] * 2, [self.alone_std, self.loose_std]], [[self.joint_tight_std] * 2, [self.joint_loose_std] * 2]])
        mean = np.array([[[0.0, 0.0], [self.alone_mean, self.loose_mean]], [[0.0, 0.0], [self.joint_loose_mean] * 2]])
        which = joint.astype(np.int64)
        return std[which] ** -2.0, mean[which]

    def of(self, loose: Bools, beside: NDArray[np.int64], joint: Bools) -> tuple[Floats, Floats]:
        """(b,) precision and mean of each bolt's change, given its kind (``loose``) and the matrix ``mixture.adjacency`` (``beside``)."""
        kind, (precision, mean) = loose.astype(np.int64), self.tables(joint)
        gap, each = (beside @ kind > 0).astype(np.int64), np.arange(kind.size)
        return precision[each, kind, gap], mean[each, kind, gap]

    def log_density(self, change: Floats) -> Floats:
        """Natural logarithm of the prior density [1/decade] of a loose joint's change, for each of the given changes [decades].

        It weighs the profile of a change that remains wide; elsewhere the Gaussians of ``tables`` are used.
        """
        away = (change - self.joint_loose_mean) / self.joint_loose_std
        return np.asarray(-0.5 * away**2 - np.log(self.joint_loose_std * np.sqrt(2.0 * np.pi)))

    def log_below(self, change: float) -> float:
        """Natural logarithm of the prior probability that a loose joint's change is below the given one [decades]; see ``log_density``."""
        # Imported here: the numbers alone need no SciPy.
        from scipy.special import log_ndtr

        return float(log_ndtr((change - self.joint_loose_mean) / self.joint_loose_std))

    @property
    def log_odds(self) -> float:
        """Prior log odds of loose against tight."""
        return float(np.log(self.loose_share / (1.0 - self.loose_share)))


@dataclass(frozen=True, kw_only=True)
class ValuePrior(Checked):
    """Gaussian prior of values along the edge, of changes at bolts, and bounds of nuisance parameters.

    Attributes
    ----------
    std : float
        Standard deviation of a value relative to its neighbours and to the reference state, or of the change at a bolt along an edge
        [decades]: ``update.prior_std``.
    joint_std : float
        Of the change of a joint [decades]: ``update.prior_std``, or this. A choice: a finger-tight joint loses two decades, which is too
        improbable under a normal prior as narrow as along an edge.
    level_std : float
        Of the stiffness about its start values, in a state that is compared with no other [decades]. A choice.
    damping_std : float
        Of the change of a damping exponent, in a calibration of the exponent [decades]. A choice: a factor of ten either way.
    first_variance : float
        Variance of the residuals from which the weight of the prior starts, before it is estimated [dB²].
    nuisance_reach : float
        Distance of the bounds of nuisance parameters from the prior mean, in standard deviations. A choice: more is no drift.
    """

    std: Positive = 0.35
    joint_std: Positive = 1.0
    level_std: Positive = 0.5
    damping_std: Positive = 1.0
    first_variance: Positive = 4.0
    nuisance_reach: Positive = 6.0


@dataclass(frozen=True, kw_only=True)
class CalibrationPrior(Checked):
    """Priors of the global factors of the reference model, and limits from which a measurement does not determine them.

    Attributes
    ----------
    stiff_std, damping_factor_std : float
        Standard deviation of the natural logarithm of factors that move resonances, and of damping factors. A choice: the former are
        known from data sheets, the latter hardly.
    stiff_bound, damping_bound : float
        Bounds of the natural logarithm of the factors.
    first_sigma_db, least_sigma_db : float
        Standard deviation of the residuals before it is estimated, and its least value [dB].
    soft_scale_db : float
        Scale of the soft loss once the fit is close [dB]: a line in the noise can be 10 dB off.
    widths : tuple of float
        Widths sigma/(2 pi) of the smoothed spectra over the highest frequency: 5 % of stiffness move a resonance by 2.5 %.
    covered : float
        Poisson's integral is evaluated at lines where this share of its kernel is on measured lines.
    same : float
        Correlation of their estimates from which two factors are not identifiable separately; for more than two, the same by a weak
        direction.
    belongs : float
        A factor belongs to a weak direction if its entry is at least this share of the largest one.
    left : float
        A direction that keeps this share of its prior variance is hardly determined by the data.
    """

    stiff_std: Positive = 0.05
    damping_factor_std: Positive = 1.0
    stiff_bound: Positive = 0.3
    damping_bound: Positive = 2.5
    first_sigma_db: Positive = 3.0
    least_sigma_db: Positive = 0.05
    soft_scale_db: Positive = 1.0
    widths: tuple[Positive, ...] = (0.04, 0.01)
    covered: Share = 0.8
    same: Share = 0.98
    belongs: Share = 0.3
    left: Share = 0.5


#: The defaults, for callers that use a part of the package by itself.
BOLT_PRIOR, VALUE_PRIOR, CALIBRATION_PRIOR = BoltPrior(), ValuePrior(), CalibrationPrior()
