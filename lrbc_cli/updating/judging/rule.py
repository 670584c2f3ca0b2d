"""The decision rule: thresholds of a change, posterior probability of a verdict, limits of the misfit; guide, *statistics*, 7 and 8."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Gt, Lt

from lrbc_cli.updating.checked import Checked, Count, Negative, NotNegative, Positive, Share

#: Words of a verdict. ``outside`` is for a bolt that no term reaches: the FRFs contain no information on it, so it has no numbers.
TIGHT, LOOSE, UNDECIDED, OUTSIDE = "tight", "loose", "undecided", "outside"


def probably(probability: float | None) -> bool:
    """Whether a bolt is more probably loose than not, which is said of it, and makes a baseline suspect; False without a probability."""
    return probability is not None and probability > 0.5


@dataclass(frozen=True)
class TightScatter:
    """Scatter of the changes between tight states.

    Attributes
    ----------
    rms : float
        Root mean square change [decades].
    baselines : int
        Number of baselines that it comes from.
    """

    rms: float = 0.0
    baselines: int = 0


#: For a campaign without baselines.
NO_SCATTER = TightScatter()


@dataclass(frozen=True, kw_only=True)
class DecisionRule(Checked):
    """Numbers that turn a posterior into a verdict, and misfits into explained, validated or neither.

    Attributes
    ----------
    loose_change : float
        Change of log10 stiffness (negative) below which a bolt is loose, if its posterior is Gaussian [decades]. A choice: a third of the
        stiffness is left.
    mixture_change : float
        The same if the change was sampled as tight or loose, which spreads less to the neighbours [decades]. A choice; with it no bolt of
        the 50 tight campaigns of the benchmarks was called loose.
    confidence : float
        Posterior probability that a verdict, loose or tight, needs.
    largest_misfit : float
        Mean misfit above which the model does not explain the measurement, so that no bolt is judged [dB]; for the reference job, and for
        jobs that are compared with none.
    validated_misfit : float
        Mean misfit, or √2 times that of the reference job, above which a job is judged but not validated [dB]. Usually ``largest_misfit``.
    misfit_margin : float
        Largest excess of the mean misfit over that of the reference job, over the same channels, for a state that counts as explained [dB];
        0 if ``largest_misfit`` alone decides. A choice: states of the samples are within 0.3 of their reference; of 7 states of virtual
        rigs above 3 dB the four correct ones are within 0.8 to 1.4, the three wrong ones at 2 and more.
    tight_margin : float
        Largest excess of the misfit of the channels used over that of each tight state, for a job without a loose bolt that is validated
        [dB]. A choice: 0.3 at most in 48 tight states of virtual rigs; 0.5 to 2.2 in jobs of two other structures that would have been
        all-clears with a fault of the measurement, another mass, or springs of one component lost.
    scatter_margin : float
        Distance of the threshold from zero in standard deviations of the changes between tight states: 1 in 30 000 of a normal
        distribution is beyond four.
    joint_margin : float
        The same for joints, which scatter by a quarter of a decade between tight states. A choice; with ``joint_spread`` a joint is loose
        from 3.3 of these standard deviations (1 tight one in 2000), and tight up to 1.7.
    joint_scatter : float
        Standard deviation of the changes of joints between tight states if there is no baseline [decades]: torques that scatter by 30 % in
        both states, and the seat. 0.18 to 0.28 on virtual rigs.
    joint_assumed : float
        Number of baselines as which ``joint_scatter`` counts if the measured ones scatter less. A choice: a single one of a dozen joints
        gave 0.06 to 0.36 decades in 20 virtual campaigns whose tight joints scatter by 0.16 to 0.23.
    joint_spread : float
        Share of that scatter by which the posterior of a joint's change is widened; the rest is behaviour of tight joints, not an error of
        this change. A choice.
    contrast_quantile : float
        Quantile of all bolts with which each is compared if there is no tight state. A choice: some of a row may be loose.
    copied_db : float
        Largest difference of all figures of the levels of two jobs with the same measurement, written with other digits [dB]: two blows
        of a hammer never have the same mean levels over hundreds of lines.
    softer_joints : int
        Least number of joints, all of them softer than in the reference job, that are no chance: each could have either sign.
    softer_share : float
        Share of the threshold that their median change must then exceed for a job that is not validated. A choice: in 247 jobs of virtual
        rigs and of four structures it is so in one, in which all joints were hand-tight.
    """

    loose_change: Negative = -0.5
    mixture_change: Negative = -0.35
    confidence: Annotated[float, Gt(0.5), Lt(1.0)] = 0.95
    largest_misfit: Positive = 3.0
    validated_misfit: Positive = 3.0
    misfit_margin: NotNegative = 1.5
    tight_margin: NotNegative = 0.5
    scatter_margin: NotNegative = 4.0
    joint_margin: NotNegative = 2.5
    joint_scatter: NotNegative = 0.2
    joint_assumed: Positive = 2.0
    joint_spread: NotNegative = 0.5
    contrast_quantile: Share = 0.75
    copied_db: NotNegative = 2e-4
    softer_joints: Count = 6
    softer_share: NotNegative = 0.5

    def scatter(self, measured: TightScatter, joint: bool) -> float:
        """Standard deviation of the changes between tight states [decades]: from baselines, for joints combined with that assumed."""
        if not joint:
            return measured.rms
        assumed, told = self.joint_assumed, measured.baselines
        believed = np.sqrt((assumed * self.joint_scatter**2 + told * measured.rms**2) / (assumed + told))
        return max(measured.rms, float(believed))

    def limit(self, change: float, scatter: float, joint: bool = False) -> float:
        """Threshold of a change: ``change``, lowered if the scatter of tight states requires it [decades]."""
        return min(change, -(self.joint_margin if joint else self.scatter_margin) * scatter)

    def most_db(self, before: float | None) -> float:
        """Mean misfit above which a state is not explained [dB]; ``before`` is that of the reference job, None if not known."""
        if before is None or before > self.largest_misfit or not self.misfit_margin:
            return self.largest_misfit
        return before + self.misfit_margin

    def too_coarse(self, before: float) -> str:
        """Why no job is validated beside a reference job with this mean misfit [dB]; empty if it is small enough."""
        both = math.hypot(before, before)
        if both <= self.validated_misfit:
            return ""
        return (
            f"a change from the reference job (misfit {before:.2f} dB) may be wrong by {both:.2f} dB, above {self.validated_misfit:g} dB: "
            "improve model or calibration"
        )

    def none_validated(self, *before: float | None) -> str:
        """The same as a warning, by all misfits of the reference job that are known [dB]."""
        coarse = self.too_coarse(max((db for db in before if db is not None and math.isfinite(db)), default=0.0))
        return f"no job will be validated, so none is an all-clear: {coarse}" if coarse else ""

    def word(self, probability: float) -> str:
        """Verdict for a posterior probability of being loose."""
        return LOOSE if probability >= self.confidence else TIGHT if probability <= 1.0 - self.confidence else UNDECIDED
