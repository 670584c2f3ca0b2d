"""Evidence: the results of an identification that are needed to judge the bolts; stored, so that another rule can judge them later."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.normal import NORMAL_95, normal_cdf
from lrbc_cli.updating.unknowns.springs import LossAlone

if TYPE_CHECKING:
    # Only for types: judging stored evidence should not load the sampling.
    from lrbc_cli.updating.posterior.samples import ChangeSamples
    from lrbc_cli.updating.unknowns.places import Edge, Joints, Spot

#: Lower and upper limit; None if open.
Interval = tuple[float | None, float | None]

#: Names of the channels over which a misfit is taken.
VALIDATION, USED = "validation channels", "channels used"


def carried(change: Floats | float, tight_std: float) -> Floats:
    """Standard deviation of a joint's change z that comes from the error of its level k in the tight state [decades].

    FRFs depend on the compliance of a joint, and a comparison with the tight state on its increase ``10^-k (10^-z - 1)``. The same increase
    results from an error of k if ``dz/dk = -(1 - 10^z)``: the error cancels out of small changes, but not of large ones.

    Parameters
    ----------
    change : float or float array
        z [decades].
    tight_std : float
        Standard deviation of k [decades].
    """
    return np.asarray((1.0 - 10.0 ** np.minimum(change, 0.0)) * tight_std)


@dataclass(frozen=True, kw_only=True)
class SampledChange:
    """Posterior of a change as a mixture of pairs of Gaussians (tight, loose), see ``mixture.ChangeSamples``; equal pairs are merged.

    Attributes
    ----------
    count, loose : (s,) tuples of float
        Number of sweeps with a pair, and the probability of its loose Gaussian.
    means, stds : two (s,) tuples each
        Of the tight and of the loose Gaussians [decades].
    """

    count: tuple[float, ...] = field(repr=False)
    loose: tuple[float, ...] = field(repr=False)
    means: tuple[tuple[float, ...], tuple[float, ...]] = field(repr=False)
    stds: tuple[tuple[float, ...], tuple[float, ...]] = field(repr=False)

    @classmethod
    def of(cls, samples: ChangeSamples, at: int, tight_std: float = 0.0) -> SampledChange:
        """From the samples of bolt ``at``; the standard deviation of a joint's level in the tight state widens them, see ``carried``."""
        means = samples.means[:, at]
        rows = np.column_stack([samples.loose[:, at], means, np.hypot(samples.stds[:, at], carried(means, tight_std))])
        unique, count = np.unique(rows, axis=0, return_counts=True)
        loose, *pairs = (tuple(column.tolist()) for column in unique.T)
        return cls(count=tuple(count.tolist()), loose=loose, means=(pairs[0], pairs[1]), stds=(pairs[2], pairs[3]))

    def below(self, limit: float, scatter: float, *, changed: bool = False) -> float:
        """Probability that the change is below a limit, with a further standard deviation [decades]; with ``changed`` given it is loose."""
        loose, weight = np.array(self.loose), np.array(self.count) / np.sum(self.count)
        tight_cdf, loose_cdf = normal_cdf((limit - np.array(self.means)) / np.hypot(self.stds, scatter))
        if changed:
            return float(weight @ (loose * loose_cdf)) / max(float(weight @ loose), 1e-300)
        # Rounded weights may add up to more than one.
        return min(float(weight @ ((1.0 - loose) * tight_cdf + loose * loose_cdf)), 1.0)


@dataclass(frozen=True, kw_only=True)
class PartialChange:
    """Posterior of the change of a joint's springs in one group.

    Attributes
    ----------
    group : str
    mean, std : float
        Of the change relative to the tight state [decades].
    deviation : float
        Standard deviation between tight states of a group's change about that of the whole joint [decades].
    """

    group: str
    mean: float
    std: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class Change:
    """Posterior of a bolt's change relative to the tight state [decades].

    Attributes
    ----------
    mean, std : float
    ceiling : float or None
        Upper limit of the stated change by saturation of the FRFs; None for no limit.
    excess : float
        Distance of the tight state above saturation; already added to ``mean`` and, as an uncertainty, to ``std``.
    leakage : float
        Change that a tight bolt would show because of its neighbours (negative): the threshold is no higher than that.
    sampled : SampledChange or None
        Distribution without ``excess``; None if Gaussian.
    beyond : float
        Extension of a joint's 95 % interval downwards by errors of its predicted effect, beyond the linear part in ``std``.
    open_below : bool
        Whether with those errors the joint may be free, so that the interval is open.
    may_be_free : bool
        Whether the data allow all of its values to be free, all else as identified: then they do not show that it is tight.
    unfelt : tuple of str
        Groups whose springs the data allow to be free, if other groups of the bolt affect the FRFs: these alone determine the change.
    parts : tuple of PartialChange
        Groups of a joint with springs in several groups whose change is known to within ``deviation``.
    alone : tuple of LossAlone
        Groups of a joint with several, and their translations and rotations.
    whole : float or None
        The same of all its springs; None if its change was not sampled, or if it is loose.
    ratio : float or None
        Log likelihood ratio of loose against tight, for a joint; None if its change was not sampled.
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
    alone: tuple[LossAlone, ...] = ()
    whole: float | None = None
    ratio: float | None = None

    def below(self, limit: float, scatter: float, *, changed: bool = False) -> float:
        """Posterior probability of a change below a limit, widened by the scatter of tight states; with ``changed`` given it is loose."""
        if self.sampled is not None:
            return self.sampled.below(limit - self.excess, float(np.hypot(scatter, self.excess)), changed=changed)
        return float(normal_cdf((limit - self.mean) / max(float(np.hypot(self.std, scatter)), 1e-12)))

    def interval(self, change: float, std: float) -> Interval:
        """95 % interval about a change with a standard deviation [decades]; None as lower limit if open."""
        low = None if self.open_below or self.may_be_free else change - float(np.hypot(NORMAL_95 * std, self.beyond))
        return low, change + NORMAL_95 * std


@dataclass(frozen=True, kw_only=True)
class BoltEvidence:
    """Results of an identification on one bolt.

    Attributes
    ----------
    name : str
    position : (3,) tuple of float
        [m].
    outside : str or None
        Message why no term reaches it; it then has no numbers.
    log10_stiffness : float or None
        Mean log10 stiffness of the values that it owns, or of those within half a pitch along the edge.
    felt : float or None
        The same with values above saturation replaced by the stiffness at saturation.
    difference : float or None
        ``felt`` less that of the tight state, if there is one [decades].
    change : Change or None
        Posterior of its change, if the job was identified relative to a tight state.
    probability_changed : float or None
        Probability of the loose kind, however small the change.
    joint : bool
        Whether it owns its terms; otherwise it is on an edge.
    tight_std : float or None
        Standard deviation of the log10 stiffness in the tight state (``felt - difference``, or ``felt`` in the reference job) [decades].
    groups : tuple of int
        Indices of the groups of its values: bolts with the same groups have the same unit and scale.
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


#: What is in doubt: a copy of another job, a file that is not whole, lines between measured ones or too far apart, unlike blows, noise, the
#: measuring chain, exchanged sensors, a gain or another factor, a sensor or hammer point that alone does not fit, the places of the bolts,
#: or that no validation channel can be compared.
DoubtKind = Literal[
    "copy",
    "incomplete",
    "interpolated",
    "resolution",
    "blows",
    "noise",
    "chain",
    "exchanged",
    "gain",
    "factor",
    "astray",
    "places",
    "channels",
]


@dataclass(frozen=True, kw_only=True)
class Doubt:
    """A reason why a job cannot be validated.

    Attributes
    ----------
    kind : str
        See ``DoubtKind``.
    text : str
    explained : bool
        Whether loose bolts may cause it, too (the identified change explains it, or it is beyond the model); then it counts only if no
        bolt is judged loose.
    """

    kind: DoubtKind
    text: str
    explained: bool = False


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Results of an identification that are needed to judge it.

    Attributes
    ----------
    job : str
    status, reason : str
        How the optimisation ended.
    along_edges : bool
        Whether stiffness was identified that bolts own, or along edges on which bolts can be.
    bolts : tuple of BoltEvidence
    missing_reference : str or None
        Reference job that has no result, although changes relative to it are wanted.
    compared : str or None
        Channels whose misfit shows whether the model explains the measurement, ``VALIDATION`` or ``USED``; None if none can be compared.
    misfit_db : float or None
        Their mean misfit [dB].
    used_misfit_db : float or None
        Mean misfit of the channels used (fitted) [dB].
    against_reference : bool
        Whether changes relative to the reference state were identified.
    doubts : tuple of Doubt
        Why it cannot be validated, whatever its misfit; the gravest first.
    setting : str
        What was compared, and what constant factors explain, for messages.
    data_warnings, warnings, notes : tuples of str
        Warnings on the measurement, warnings on which the user has to act, and other messages.
    alternatives : tuple of (tuple of float or None, float)
        States of nearly equal posterior probability: the change of each bolt [decades], None if it has none, and the probability.
    """

    job: str
    status: str
    reason: str
    along_edges: bool
    bolts: tuple[BoltEvidence, ...]
    missing_reference: str | None
    compared: str | None
    misfit_db: float | None
    setting: str
    doubts: tuple[Doubt, ...] = ()
    data_warnings: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    used_misfit_db: float | None = None
    against_reference: bool = False
    alternatives: tuple[tuple[tuple[float | None, ...], float], ...] = ()

    def beside(self, copied: str | None) -> Evidence:
        """The same with the message ``copied`` as a further doubt, unless it is None."""
        return self if copied is None else replace(self, doubts=(*self.doubts, Doubt(kind="copy", text=copied)))

    def reasons(self, *, explained: bool = False) -> list[str]:
        """Texts of the doubts that count in any case, or of those that the identified change explains."""
        return [doubt.text for doubt in self.doubts if doubt.explained == explained]


def at_bolts(
    groups: Sequence[Edge | Joints],
    names: Sequence[str],
    xyz: Floats,
    change_of: Callable[[int, Spot, float | None], Change | None] | None = None,
) -> tuple[BoltEvidence, ...]:
    """Evidence of each bolt from the identified values of edges and joints.

    Parameters
    ----------
    groups : sequence of Edge or Joints
        At least one if there are bolts.
    names : (m,) sequence of str
        Of the bolts.
    xyz : (m, 3) float array
        Positions of the bolts [m].
    change_of : callable or None
        Posterior of a bolt's change, from its index, ``Spot`` and difference; None if the job is not compared with a tight state.
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
