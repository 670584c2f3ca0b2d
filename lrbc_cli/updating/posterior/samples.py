"""Posterior of the changes at bolts as samples of their kinds: probabilities, means and standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit, ndtr

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.updating.statistics.priors import BOLT_PRIOR, BoltPrior
from lrbc_cli.updating.unknowns.springs import SpringsOf


class LossRatio(NamedTuple):
    """Log likelihood ratio of a loss of springs of a joint (position, springs; None: all) against none.

    ``shown``: what it would be if the FRFs were those of the state: near zero where the loss does not show.
    """

    joint: int
    of: SpringsOf | None
    ratio: float
    shown: float


@dataclass(frozen=True, kw_only=True)
class ChangeSamples:
    """Posterior of the changes at b bolts: for each of s sweeps and each bolt two Gaussians, tight and loose, given the other kinds.

    Averages over these conditionals scatter less than draws of the changes would (Rao-Blackwell).

    Attributes
    ----------
    bolts : (b,) int array
        Index of each bolt among the unknowns z.
    z : (m,) float array
        The most probable state.
    loose : (s, b) float array
        Conditional probability of the loose kind.
    means, stds : (s, b, 2) float arrays
        Of the change, if tight and if loose [decades].
    kinds : (b,) bool array
        Which bolts are loose in the most probable state.
    neighbours : sequence of (int, int)
        Pairs of neighbours along an edge, as positions in ``bolts``.
    prior : BoltPrior
    alternatives : sequence of ((b,) float array, float)
        Changes in each state about which was linearised [decades], and its posterior probability among these, the share of its sweeps.
    groups : sequence of LossRatio
        For the springs of each tight joint with several groups, see ``excluded.loss_ratios``.
    """

    bolts: NDArray[np.int64]
    z: Floats = field(repr=False)
    loose: Floats = field(repr=False)
    means: Floats = field(repr=False)
    stds: Floats = field(repr=False)
    kinds: Bools
    neighbours: Sequence[tuple[int, int]] = ()
    prior: BoltPrior = BOLT_PRIOR
    alternatives: Sequence[tuple[Floats, float]] = ()
    groups: Sequence[LossRatio] = ()

    @property
    def inclusion(self) -> Floats:
        """(b,) probabilities of the loose kind."""
        return np.asarray(self.loose.mean(axis=0))

    @property
    def ratios(self) -> Floats:
        """(b,) log likelihood ratios of loose against tight: what the data add to the prior odds."""
        return np.asarray(logit(np.clip(self.inclusion, 1e-300, 1.0 - 1e-15)) - self.prior.log_odds)

    @property
    def mean(self) -> Floats:
        """(b,) posterior means of the changes [decades]."""
        return np.asarray((self._weights * self.means).sum(axis=2).mean(axis=0))

    @property
    def std(self) -> Floats:
        """(b,) posterior standard deviations of the changes [decades]."""
        square = (self._weights * (self.stds**2 + (self.means - self.mean[:, None]) ** 2)).sum(axis=2).mean(axis=0)
        return np.asarray(np.sqrt(square))

    @property
    def smeared(self) -> Floats:
        """(b,) change that a tight bolt would show beside the change of a neighbour, by ``leakage`` [decades]."""
        mean, found, share = self.mean, np.zeros(self.bolts.size), self.prior.leakage
        for i, j in self.neighbours:
            found[i], found[j] = min(found[i], share * mean[j]), min(found[j], share * mean[i])
        return found

    def below(self, limit: float | Floats, scatter: float | Floats = 0.0) -> Floats:
        """(b,) probabilities that the changes are below a limit [decades]; the scatter of tight states widens each Gaussian."""
        limits, further = (np.broadcast_to(value, self.bolts.shape)[:, None] for value in (limit, scatter))
        inside = ndtr((limits - self.means) / np.hypot(self.stds, further))
        return np.asarray((self._weights * inside).sum(axis=2).mean(axis=0))

    @property
    def _weights(self) -> Floats:
        return np.stack([1.0 - self.loose, self.loose], axis=2)
