"""What an identification says of the bolts, as far as it is needed to judge them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.normal import NORMAL_95, normal_cdf

if TYPE_CHECKING:
    # Judging needs nothing of what samples or finds places.
    from lrbc_cli.updating.posterior.mixture import ChangeSamples
    from lrbc_cli.updating.unknowns.places import Edge, Joints, Spot

#: Lower and upper limit, None where open.
Interval = tuple[float | None, float | None]

#: Which channels a misfit was taken over.
VALIDATION, USED = "validation channels", "channels used"


def carried(change: Floats | float, tight_std: float) -> Floats:
    """What an error of the tight state makes of a joint's change [decades].

    FRFs feel the compliance of a joint, and a comparison with the tight state its rise, ``10^-k (10^-z - 1)`` from a level k on by a change
    z. An error of k leaves that rise as it is where ``dz/dk = -(1 - 10^z)``: it drops out of small changes, and of large ones it does not.
    """
    return np.asarray((1.0 - 10.0 ** np.minimum(change, 0.0)) * tight_std)


@dataclass(frozen=True, kw_only=True)
class SampledChange:
    """Posterior of a change as a sum of pairs of Gaussians, see ``mixture.ChangeSamples``; equal pairs are counted.

    Attributes
    ----------
    count, loose : (s,) tuples of float
        How often a pair was drawn, and the probability of its loose Gaussian.
    means, stds : two (s,) tuples each
        Of the tight and of the loose Gaussian [decades].
    """

    count: tuple[float, ...] = field(repr=False)
    loose: tuple[float, ...] = field(repr=False)
    means: tuple[tuple[float, ...], tuple[float, ...]] = field(repr=False)
    stds: tuple[tuple[float, ...], tuple[float, ...]] = field(repr=False)

    @classmethod
    def of(cls, samples: ChangeSamples, at: int, tight_std: float = 0.0) -> SampledChange:
        """Those of one of the sampled bolts; of a joint whose level in the tight state has a standard deviation, see ``carried``."""
        means = samples.means[:, at]
        rows = np.column_stack([samples.loose[:, at], means, np.hypot(samples.stds[:, at], carried(means, tight_std))])
        unique, count = np.unique(rows, axis=0, return_counts=True)
        loose, *pairs = (tuple(column.tolist()) for column in unique.T)
        return cls(count=tuple(count.tolist()), loose=loose, means=(pairs[0], pairs[1]), stds=(pairs[2], pairs[3]))

    def below(self, limit: float, scatter: float, *, changed: bool = False) -> float:
        """Probability that the change lies below a limit, with a further standard deviation [decades]; given that it is loose, if asked."""
        loose, weight = np.array(self.loose), np.array(self.count) / np.sum(self.count)
        tight_cdf, loose_cdf = normal_cdf((limit - np.array(self.means)) / np.hypot(self.stds, scatter))
        if changed:
            return float(weight @ (loose * loose_cdf)) / max(float(weight @ loose), 1e-300)
        # Weights that are rounded may add up to more than one.
        return min(float(weight @ ((1.0 - loose) * tight_cdf + loose * loose_cdf)), 1.0)


@dataclass(frozen=True, kw_only=True)
class PartialChange:
    """Posterior of the change of a joint's springs in one of its groups.

    Attributes
    ----------
    group : str
    mean, std : float
        Against the tight state [decades].
    deviation : float
        Standard deviation of such changes about that of the whole joint between tight states [decades].
    """

    group: str
    mean: float
    std: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class Change:
    """Posterior of a bolt's change against the tight state [decades].

    Attributes
    ----------
    mean, std : float
    ceiling : float or None
        The largest change that the FRFs would feel; None: none.
    excess : float
        How far the tight state lies above saturation, which is uncertain as much: part of ``mean`` and ``std``.
    leakage : float
        Change that a tight bolt would show of its neighbours' (negative): a loose bolt changes more than that.
    sampled : SampledChange or None
        Its distribution without ``excess``; None: Gaussian.
    beyond : float
        How much further a joint may have loosened (95 %) by errors of its predicted effect that ``std`` does not hold, which is linear.
    open_below : bool
        With those errors it may be free; ``beyond`` has no number for that.
    may_be_free : bool
        The data do not object to each of its values being free, all else as identified: of a bolt that seems tight they say nothing then.
    unfelt : tuple of str
        Groups of which that is true where others of the bolt are felt: of these springs the change is told by the others alone.
    parts : tuple of PartialChange
        Of a joint with springs in several groups, those whose change is known to within ``deviation``: one may lose what the others hold.
    """

    mean: float
    std: float
    ceiling: float | None = None
    excess: float = 0.0
    leakage: float = 0.0
    sampled: SampledChange | None = None
    beyond: float = 0.0
    open_below: bool = False
    may_be_free: bool = False
    unfelt: tuple[str, ...] = ()
    parts: tuple[PartialChange, ...] = ()

    def below(self, limit: float, scatter: float, *, changed: bool = False) -> float:
        """Posterior probability of a change below a limit, where tight states scatter so much; given that it is loose, if asked."""
        if self.sampled is not None:
            return self.sampled.below(limit - self.excess, float(np.hypot(scatter, self.excess)), changed=changed)
        return float(normal_cdf((limit - self.mean) / max(float(np.hypot(self.std, scatter)), 1e-12)))

    def interval(self, change: float, std: float) -> Interval:
        """95 % limits about a change with a standard deviation [decades]; None to the side where they are open."""
        low = None if self.open_below or self.may_be_free else change - float(np.hypot(NORMAL_95 * std, self.beyond))
        return low, change + NORMAL_95 * std


@dataclass(frozen=True, kw_only=True)
class BoltEvidence:
    """What an identification says of one bolt.

    Attributes
    ----------
    name : str
    position : (3,) tuple of float
        [m].
    outside : str or None
        Why no term reaches it: then there are no numbers.
    log10_stiffness : float or None
        Mean log10 stiffness of the values that it owns, or within half a pitch along the edge.
    felt : float or None
        The same with values above saturation counted as saturated.
    difference : float or None
        ``felt`` less that of the tight state, where there is one [decades].
    change : Change or None
        Its posterior, where the job was identified against a tight state.
    probability_changed : float or None
        That it is loose rather than tight at all, however little it changed.
    joint : bool
        It owns its terms; else it is a place along an edge.
    tight_std : float or None
        Standard deviation of the stiffness in the tight state, which is ``felt`` less ``difference``, or ``felt`` in the reference job.
    groups : tuple of int
        Numbers of the groups whose values speak for it: bolts of the same ones have the same unit and scale.
    """

    name: str
    position: tuple[float, float, float]
    outside: str | None = None
    log10_stiffness: float | None = None
    felt: float | None = None
    difference: float | None = None
    change: Change | None = None
    probability_changed: float | None = None
    joint: bool = False
    tight_std: float | None = None
    groups: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What an identification says, as far as it is needed to judge it.

    Attributes
    ----------
    job : str
    status, reason : str
        How the optimisation ended.
    along_edges : bool
        Whether stiffness was identified that bolts own, or along edges at which they can lie.
    bolts : tuple of BoltEvidence
    missing_reference : str or None
        The job that changes were wanted against, and which had no result.
    compared : str or None
        The channels whose misfit tells whether the model explains the measurement; None where none can be compared.
    misfit_db : float or None
        Their mean misfit.
    used_misfit_db : float or None
        Mean misfit of the channels that were fitted.
    against_reference : bool
        What was identified is changes against the reference state.
    unvalidated : str
        Why none of them is a validation channel.
    doubted : str or None
        What is wrong with the measurement where it is that of the reference job once more, ends before it, or has sensors exchanged.
    excused : str
        What would be wrong with the measurement if the change that was identified did not explain it as well.
    setting : str
        What was compared, and what constant factors explain, for messages.
    data_warnings, warnings, notes : tuples of str
        On the measurement; what the user has to act on; the rest.
    alternatives : tuple of (tuple of float or None, float)
        States of nearly equal posterior probability: the change of each bolt [decades], None where it has none, and that probability.
    """

    job: str
    status: str
    reason: str
    along_edges: bool
    bolts: tuple[BoltEvidence, ...]
    missing_reference: str | None
    compared: str | None
    misfit_db: float | None
    unvalidated: str
    doubted: str | None
    setting: str
    data_warnings: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    used_misfit_db: float | None = None
    against_reference: bool = False
    alternatives: tuple[tuple[tuple[float | None, ...], float], ...] = ()
    excused: str = ""

    def beside(self, copied: str | None) -> Evidence:
        """With a doubt where the measurement is a copy in some way, unless there is one already."""
        return self if copied is None or self.doubted else replace(self, doubted=copied)


def at_bolts(
    groups: Sequence[Edge | Joints],
    names: Sequence[str],
    xyz: Floats,
    change_of: Callable[[int, Spot, float | None], Change | None] | None = None,
) -> tuple[BoltEvidence, ...]:
    """What the values of edges and joints say of each bolt.

    Parameters
    ----------
    groups : sequence of Edge or Joints
        At least one where there are bolts.
    names : (m,) sequence of str
    xyz : (m, 3) float array
    change_of : callable or None
        Posterior of the change of a bolt by its number, spot and difference, where the job was identified against a tight state.
    """
    from lrbc_cli.updating.unknowns.places import Joints, spots

    found = []
    for b, (name, spot) in enumerate(zip(names, spots(groups, xyz) if len(names) else [], strict=True)):
        position = (float(xyz[b, 0]), float(xyz[b, 1]), float(xyz[b, 2]))
        if isinstance(spot, str):
            found.append(BoltEvidence(name=name, position=position, outside=spot))
            continue
        parts = [(groups[i], at) for i, at in spot]
        felt = float(np.mean(np.concatenate([np.minimum(group.log10[at], group.cap) for group, at in parts])))
        tight = [np.minimum(group.reference[at], group.cap) for group, at in parts if group.reference is not None]
        difference = felt - float(np.mean(np.concatenate(tight))) if len(tight) == len(parts) else None
        stds = [group.std[at] for group, at in parts if group.std is not None]
        tight_std = float(np.sqrt(np.mean(np.square(np.concatenate(stds))))) if len(stds) == len(parts) else np.inf
        found.append(
            BoltEvidence(
                name=name,
                position=position,
                log10_stiffness=float(np.mean(np.concatenate([group.log10[at] for group, at in parts]))),
                felt=felt,
                difference=difference,
                change=None if change_of is None else change_of(b, spot, difference),
                joint=isinstance(parts[0][0], Joints),
                tight_std=tight_std if np.isfinite(tight_std) else None,
                groups=tuple(i for i, _ in spot),
            )
        )
    return tuple(found)
