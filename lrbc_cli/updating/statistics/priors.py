"""What is expected of the unknowns before anything is measured: every number of the priors, in one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Bools, Floats


@dataclass(frozen=True, kw_only=True)
class BoltPrior:
    """Prior of the change at a bolt that is tight or loose [decades]; see ``lrbc guide statistics``, section 6.

    Attributes
    ----------
    tight_std : float
        Of a tight bolt's change along an edge, whose mean is zero. Retorquing scatters by 30 %, 0.11 decades at a bolt's patch; its shape,
        wider than the patch, smears that.
    loose_mean, loose_std : float
        Of a loose bolt's change: from a patch that has lost half its stiffness to one that has lost nearly all, smeared alike.
    alone_mean, alone_std : float
        The same between tight neighbours, which hold part of what it held. By trial on virtual rigs.
    joint_tight_std : float
        Of the change of a tight joint, a bolt that owns its terms: retorquing scatters by 30 %, a seat that is lifted and put down again
        by more, and nothing smears it. 0.1 to 0.2 on virtual rigs.
    joint_loose_mean, joint_loose_std : float
        Of a loose joint's change: nothing beside it holds what it held, so that 0.3 decades (half) to 3 (finger-tight, and free) are
        within one and a half to two standard deviations. A choice.
    deviation_std : float
        Of the change of each kind of terms of a joint (axial, rocking) about what is common to them. A choice: a stiffness of contact
        and one of bending under it fall nearly alike.
    loose_share : float
        Probability of being loose before anything is measured. A choice: a campaign looks for few loose bolts among many.
    leakage : float
        Share of a loose bolt's change that a tight neighbour along its edge may show, whose hat does not end where a gap does. 0.1 to 0.3
        on virtual rigs.
    """

    tight_std: float = 0.05
    loose_mean: float = -0.6
    loose_std: float = 0.3
    alone_mean: float = -0.5
    alone_std: float = 0.2
    joint_tight_std: float = 0.15
    joint_loose_mean: float = -1.5
    joint_loose_std: float = 0.8
    deviation_std: float = 0.15
    loose_share: float = 0.1
    leakage: float = 0.3

    def tables(self, joint: Bools) -> tuple[Floats, Floats]:
        """(b, 2, 2) precision and mean of each bolt's change, by its kind and whether a neighbour along its edge is loose.

        Parameters
        ----------
        joint : (b,) bool array
            Bolts that own their terms; the others are hats along an edge.
        """
        std = np.array([[[self.tight_std] * 2, [self.alone_std, self.loose_std]], [[self.joint_tight_std] * 2, [self.joint_loose_std] * 2]])
        mean = np.array([[[0.0, 0.0], [self.alone_mean, self.loose_mean]], [[0.0, 0.0], [self.joint_loose_mean] * 2]])
        which = joint.astype(np.int64)
        return std[which] ** -2.0, mean[which]

    def of(self, loose: Bools, beside: NDArray[np.int64], joint: Bools) -> tuple[Floats, Floats]:
        """Precision and mean of each bolt's change, given the kinds and which hats are neighbours, see ``mixture.adjacency``."""
        kind, (precision, mean) = loose.astype(np.int64), self.tables(joint)
        gap, each = (beside @ kind > 0).astype(np.int64), np.arange(kind.size)
        return precision[each, kind, gap], mean[each, kind, gap]

    def log_density(self, change: Floats) -> Floats:
        """Natural logarithm of the density of a loose joint's change, of the same shape as its changes [1 / decade]."""
        away = (change - self.joint_loose_mean) / self.joint_loose_std
        return np.asarray(-0.5 * away**2 - np.log(self.joint_loose_std * np.sqrt(2.0 * np.pi)))

    def log_below(self, change: float) -> float:
        """Natural logarithm of the probability that a loose joint's change lies below one [decades]."""
        # Loaded here: whoever reads a prior's numbers can do without.
        from scipy.special import log_ndtr

        return float(log_ndtr((change - self.joint_loose_mean) / self.joint_loose_std))

    @property
    def log_odds(self) -> float:
        """Of being loose."""
        return float(np.log(self.loose_share / (1.0 - self.loose_share)))


@dataclass(frozen=True, kw_only=True)
class ValuePrior:
    """Gaussian prior of values along the edge, of changes at bolts, and of nuisance parameters.

    Attributes
    ----------
    std : float
        Of a value against its neighbours and against the reference state, or of the change at a bolt along an edge [decades]:
        ``update.prior_std``.
    joint_std : float
        Of the change of a joint, a bolt that owns its terms [decades]: ``update.prior_std``, or this. A choice: one that is finger-tight
        loses two, which a normal prior as narrow as along an edge would not grant.
    level_std : float
        Of the stiffness of a state that is compared with nothing, about its start values [decades]. A choice.
    damping_std : float
        Of the change of a damping exponent, in a calibration of the exponent [decades]. A choice: a factor of ten either way.
    first_variance : float
        Variance of the residuals with which the weight of the prior begins, before they are known [dB²].
    nuisance_reach : float
        Bounds of nuisance parameters lie this many standard deviations away. A choice: what lies beyond is no drift.
    """

    std: float = 0.35
    joint_std: float = 1.0
    level_std: float = 0.5
    damping_std: float = 1.0
    first_variance: float = 4.0
    nuisance_reach: float = 6.0


@dataclass(frozen=True, kw_only=True)
class CalibrationPrior:
    """Priors of the global factors of the reference model, and when a measurement does not tell them apart.

    Attributes
    ----------
    stiff_std, damping_factor_std : float
        Of the natural logarithm of factors that move resonances, and of those that damp. A choice: the one is
        known from data sheets, the other hardly.
    stiff_bound, damping_bound : float
        Bounds of the natural logarithm of the factors.
    first_sigma_db, least_sigma_db : float
        Standard deviation of the residuals while nothing is known of them, and the least that is assumed [dB].
    soft_scale_db : float
        Differences well above it count by their size only once the fit is close: a line in the noise can be 10 dB off [dB].
    widths : tuple of float
        Widths sigma/(2 pi) of the smoothed spectra over the highest frequency: 5 % of stiffness move a resonance by 2.5 %.
    covered : float
        Poisson's integral is taken where this much of its kernel lies on measured lines.
    same : float
        From this correlation of their estimates on two factors are not told apart; of more than two, at as weak a direction.
    belongs : float
        A factor belongs to a weak direction with at least this share of its largest entry.
    left : float
        Where a direction keeps this much of its prior variance, the data say next to nothing of it.
    """

    stiff_std: float = 0.05
    damping_factor_std: float = 1.0
    stiff_bound: float = 0.3
    damping_bound: float = 2.5
    first_sigma_db: float = 3.0
    least_sigma_db: float = 0.05
    soft_scale_db: float = 1.0
    widths: tuple[float, ...] = (0.04, 0.01)
    covered: float = 0.8
    same: float = 0.98
    belongs: float = 0.3
    left: float = 0.5


#: The defaults, for those who call a part alone.
BOLT_PRIOR, VALUE_PRIOR, CALIBRATION_PRIOR = BoltPrior(), ValuePrior(), CalibrationPrior()
