"""The decision rule: from the posterior probability that a bolt is loose to a verdict, and what counts as explained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Words of a verdict; that on a bolt that no term reaches: the FRFs say nothing of it, so it has no numbers.
TIGHT, LOOSE, UNDECIDED, OUTSIDE = "tight", "loose", "undecided", "outside"


@dataclass(frozen=True)
class TightScatter:
    """Changes between tight states.

    Attributes
    ----------
    rms : float
        [decades].
    baselines : int
        Of how many further tight states.
    """

    rms: float = 0.0
    baselines: int = 0


#: Of a campaign without baselines.
NO_SCATTER = TightScatter()


@dataclass(frozen=True, kw_only=True)
class DecisionRule:
    """When a bolt is judged, and when none may be.

    Attributes
    ----------
    loose_change : float
        Change of log10 stiffness below which a bolt is loose, where its posterior is Gaussian (negative) [decades]. A
        choice: a third of the stiffness is left.
    mixture_change : float
        The same where the change was sampled as tight or loose: less spreads to the neighbours. A choice; with it no bolt of the 50 tight
        campaigns of the benchmarks was called loose.
    confidence : float
        Posterior probability that a verdict, loose or tight, needs.
    largest_misfit : float
        Mean misfit above which the model does not explain the measurement, so that no bolt is judged [dB]: of the reference job, and of
        jobs that are compared with none.
    validated_misfit : float
        Mean misfit above which nothing is validated, whatever else is judged; √2 times that of the reference job counts as one, too
        [dB]. The usual ``largest_misfit``.
    misfit_margin : float
        Mean misfit above that of the reference job, over the same channels, from which on a state is not explained [dB]; 0:
        ``largest_misfit`` alone holds, as where it is given. A choice: states of the samples lie within 0.3 of their reference, of 7 states
        of virtual rigs above 3 dB the four that had been found right within 0.8 to 1.4, the three wrong ones at 2 and more.
    scatter_margin : float
        Standard deviations of the changes between tight states that the threshold keeps from zero: of a normal distribution 1 in 30 000
        lies beyond four.
    joint_margin : float
        The same of joints, where tight states scatter by a quarter of a decade. A choice; with ``joint_spread`` a joint is loose from 3.3
        of these standard deviations on (1 tight one in 2000), and tight down to 1.7.
    joint_scatter : float
        Standard deviation of the changes of joints between tight states where no baseline tells it [decades]: torques that scatter by 30 %
        in both states, and a seat. 0.18 to 0.28 on virtual rigs.
    joint_assumed : float
        Baselines that ``joint_scatter`` counts as where those measured scatter less. A choice: a single one, of a dozen joints, stated 0.06
        to 0.36 decades on 20 virtual campaigns whose tight joints scatter by 0.16 to 0.23.
    joint_spread : float
        Share of that scatter by which the posterior of a joint's change is widened: the rest is what tight joints do, not an error of this
        change. A choice.
    contrast_quantile : float
        Without a tight state bolts are compared with this quantile of them. A choice: some of a row may be loose.
    copied_db : float
        Jobs hold one measurement, written with other digits, where all figures of its levels differ by no more [dB]: no two blows of a
        hammer give the same means over hundreds of lines.
    """

    loose_change: float = -0.5
    mixture_change: float = -0.35
    confidence: float = 0.95
    largest_misfit: float = 3.0
    validated_misfit: float = 3.0
    misfit_margin: float = 1.5
    scatter_margin: float = 4.0
    joint_margin: float = 2.5
    joint_scatter: float = 0.2
    joint_assumed: float = 2.0
    joint_spread: float = 0.5
    contrast_quantile: float = 0.75
    copied_db: float = 2e-4

    def scatter(self, measured: TightScatter, joint: bool) -> float:
        """Standard deviation of the changes between tight states [decades]: as baselines tell it, or of joints without any as assumed."""
        if not joint:
            return measured.rms
        assumed, told = self.joint_assumed, measured.baselines
        believed = np.sqrt((assumed * self.joint_scatter**2 + told * measured.rms**2) / (assumed + told))
        return max(measured.rms, float(believed))

    def limit(self, change: float, scatter: float, joint: bool = False) -> float:
        """A threshold, or further down where tight states scatter that much [decades]."""
        return min(change, -(self.joint_margin if joint else self.scatter_margin) * scatter)

    def most_db(self, before: float | None) -> float:
        """Mean misfit above which a state is not explained [dB], that of the reference job being ``before``; None: not known."""
        if before is None or before > self.largest_misfit or not self.misfit_margin:
            return self.largest_misfit
        return before + self.misfit_margin

    def word(self, probability: float) -> str:
        """Verdict at a posterior probability of being loose."""
        return LOOSE if probability >= self.confidence else TIGHT if probability <= 1.0 - self.confidence else UNDECIDED
