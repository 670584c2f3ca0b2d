"""Verdict on one bolt: its threshold, the word of its probability, and what forbids this word; used by ``decide.judge``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from lrbc_cli.updating.judging.evidence import BoltEvidence, Change, Evidence, Interval
from lrbc_cli.updating.judging.groups import (
    by_prior,
    excluded_groups,
    hidden_groups,
    lost_alone,
    lost_note,
    not_excluded,
    of_its_groups,
    unclear_springs,
)
from lrbc_cli.updating.judging.rule import LOOSE, OUTSIDE, TIGHT, UNDECIDED, DecisionRule, TightScatter, probably
from lrbc_cli.updating.unknowns.springs import SpringsOf

#: Message on a joint that is probably not of the loose kind: residuals of a wrong model pull the change of a tight one below the limit.
INSIGNIFICANT = "errors of the model may explain its change: a loss improves the fit, but not significantly"

#: Role of a job in its campaign: the tight state itself, a further tight state, or an unknown state.
Role = Literal["reference", "baseline", "job"]
REFERENCE: Final = "reference"
BASELINE: Final = "baseline"
JOB: Final = "job"


@dataclass(frozen=True, kw_only=True)
class BoltVerdict:
    """Verdict on one bolt, with its numbers.

    Attributes
    ----------
    name : str
    verdict : str
        ``tight``, ``loose``, ``undecided``, or ``outside`` if no term reaches the bolt.
    note : str or None
    log10_stiffness : float or None
    change, change_std : float or None
        Change relative to the tight state, and its standard deviation with the scatter of tight states [decades].
    change_interval95 : (float or None, float or None) or None
        Its 95 % limits; None on a side that is open [decades].
    probability_loose : float or None
        Posterior probability that the change is below the threshold.
    threshold : float or None
        Of the change [decades].
    open_groups : tuple of str
        Groups of springs of a tight bolt whose loss alone the data do not exclude.
    unclear : mapping of SpringsOf to bool
        Springs of a tight bolt whose loss alone the data do not exclude; True if they exclude it less than of a tight bolt.
    unclear_groups, excluded_groups : tuples of str
        Those of ``unclear`` that all baselines exclude: no all-clear; groups, also in part, that the data exclude, whatever the verdict.
    lost_groups : tuple of str
        Groups of springs that the data call loose alone, the most probable first, of a bolt that would be tight otherwise.
    suspect : bool
        Taken as tight, although in a baseline it is loose or probably loose, or in the reference job it is far looser than the other bolts.
    """

    name: str
    verdict: str
    note: str | None = None
    log10_stiffness: float | None = None
    change: float | None = None
    change_std: float | None = None
    change_interval95: Interval | None = None
    probability_loose: float | None = None
    threshold: float | None = None
    open_groups: tuple[str, ...] = ()
    unclear: Mapping[SpringsOf, bool] = field(default_factory=dict)
    unclear_groups: tuple[str, ...] = ()
    excluded_groups: tuple[str, ...] = ()
    lost_groups: tuple[str, ...] = ()
    suspect: bool = False


def verdict_on(
    bolt: BoltEvidence, evidence: Evidence, rule: DecisionRule, role: str, scatter: TightScatter, level: float, explained: bool
) -> BoltVerdict:
    """Verdict on one bolt; ``level`` is the log10 stiffness of the others, for a contrast without a tight state."""
    if not evidence.along_edges:
        return BoltVerdict(name=bolt.name, verdict=UNDECIDED, note="no stiffness group that belongs to bolts or that bolts lie along")
    if bolt.outside is not None:
        return BoltVerdict(name=bolt.name, verdict=OUTSIDE, note=bolt.outside)
    found = _by_role(bolt, evidence, rule, role, scatter, level)
    if role == BASELINE:
        # Probably loose is enough: what is taken as tight there sets the threshold of all jobs.
        suspect = found.verdict == LOOSE or probably(found.probability_loose)
        tight, surely = "a baseline, taken as tight", "" if found.verdict == LOOSE else "probably "
        note = f"{tight}, but compared with the reference job it comes out {surely}loose" if suspect else found.note or tight
        found = replace(found, verdict=TIGHT, probability_loose=None, note=note, suspect=suspect and explained)
    if not explained:
        why = "the model does not explain the measurement"
        found = replace(found, verdict=UNDECIDED, probability_loose=None, note=why, open_groups=(), unclear={}, lost_groups=())
    return found


@dataclass(frozen=True, kw_only=True)
class Threshold:
    """Change below which a bolt counts as loose, with the scatter of tight states in it [decades].

    Attributes
    ----------
    own : float
        Threshold without scatter.
    scatter : float
        Standard deviation of the changes between tight states.
    spread : float
        Part of it that is an error of this change: it widens the posterior.
    limit : float
        The threshold itself: ``own``, lowered if the scatter requires it.
    """

    own: float
    scatter: float
    spread: float
    limit: float

    @classmethod
    def of(cls, rule: DecisionRule, measured: TightScatter, *, joint: bool, mixture: bool, leakage: float = 0.0) -> Threshold:
        """From the rule, the scatter measured in baselines, and the kind of posterior.

        Parameters
        ----------
        rule : DecisionRule
        measured : TightScatter
        joint : bool
        mixture : bool
            Whether the change was sampled as tight or loose; otherwise its posterior is Gaussian.
        leakage : float
            Change that a tight bolt beside a gap shows of the neighbour's [decades]: the threshold is below that.
        """
        own = min(rule.mixture_change, leakage) if mixture else rule.loose_change
        scatter = rule.scatter(measured, joint)
        spread = scatter * rule.joint_spread if joint else scatter
        return cls(own=own, scatter=scatter, spread=spread, limit=rule.limit(own, scatter, joint))


def _by_role(bolt: BoltEvidence, evidence: Evidence, rule: DecisionRule, role: str, scatter: TightScatter, level: float) -> BoltVerdict:
    """Verdict on one bolt, before the role of a baseline."""
    found = BoltVerdict(name=bolt.name, verdict=UNDECIDED, log10_stiffness=bolt.log10_stiffness)
    if role == REFERENCE:
        return replace(found, verdict=TIGHT, note="reference state, taken as tight", change=0.0)
    if bolt.change is not None:
        sampled = bolt.change.sampled is not None
        threshold = Threshold.of(rule, scatter, joint=bolt.joint, mixture=sampled, leakage=bolt.change.leakage)
        return _by_change(found, bolt, bolt.change, threshold, rule)
    if evidence.missing_reference is not None:
        # A change is wanted, which a contrast between bolts does not replace.
        return replace(found, note=f"no result of {evidence.missing_reference} to compare with", change=bolt.difference)
    if bolt.difference is not None:
        return replace(found, verdict=LOOSE if bolt.difference <= rule.loose_change else TIGHT, change=bolt.difference)
    # Without a tight state no bolt can be judged tight: all may be loose.
    loose = bolt.felt is not None and bolt.felt - level <= rule.loose_change
    note = "no tight state to compare with: loose by contrast with the other bolts, or inconclusive"
    return replace(found, verdict=LOOSE if loose else UNDECIDED, note=note)


def _by_change(found: BoltVerdict, bolt: BoltEvidence, posterior: Change, at: Threshold, rule: DecisionRule) -> BoltVerdict:
    """Verdict by the posterior of a bolt's change: first the word of its probability, then what forbids this word."""
    probability, note = of_its_groups(posterior, posterior.below(at.limit, at.spread), at.own, at.scatter, rule)
    word, kind = rule.word(probability), bolt.probability_changed
    if word == LOOSE and bolt.joint and kind is not None and rule.word(kind) != LOOSE:
        word, probability, note = UNDECIDED, kind, INSIGNIFICANT
    if word == UNDECIDED and note is None:
        note = "the data do not decide: the interval of its change contains the threshold"
    lost, hidden = dict[str, float](), tuple[str, ...]()
    if word == TIGHT:
        lost = lost_alone(posterior, rule)
        if (doubt := _doubt_of_tight(bolt, posterior, at, rule, lost)) is not None:
            word, note = UNDECIDED, doubt
        elif hidden := hidden_groups(posterior, rule):
            note = f"tight as a whole; the data do not exclude that its springs of {' or '.join(hidden)} alone are loose"
    change = posterior.mean if posterior.ceiling is None else min(posterior.mean, posterior.ceiling)
    std = float(np.hypot(posterior.std, at.spread))
    return replace(
        found,
        verdict=word,
        note=note,
        change=change,
        change_std=std,
        change_interval95=posterior.interval(change, std),
        probability_loose=probability,
        threshold=at.limit,
        open_groups=hidden,
        unclear=unclear_springs(posterior, rule) if word == TIGHT else {},
        excluded_groups=excluded_groups(posterior, rule),
        lost_groups=tuple(lost),
    )


def _doubt_of_tight(bolt: BoltEvidence, posterior: Change, at: Threshold, rule: DecisionRule, lost: Mapping[str, float]) -> str | None:
    """Why a bolt that is tight by its probability is not called so; None if nothing forbids it. ``lost`` as returned by ``lost_alone``."""
    if posterior.may_be_free:
        return "the data do not rule out that it is free: no response is sensitive to it in its present state"
    by_data = (by_prior(posterior, at.limit, at.spread, rule), not_excluded(posterior, rule))
    doubt = next(filter(None, (_excused(posterior, at.own, rule), *by_data)), None)
    if lost or doubt is not None:
        return "; ".join(filter(None, (lost_note(lost), doubt)))
    if bolt.joint and bolt.difference is not None and bolt.difference <= at.limit:
        return (
            f"its posterior probability says tight, but in the state that fits best its change is {bolt.difference:.2f} decades, below the "
            "threshold"
        )
    return None


def _excused(posterior: Change, own: float, rule: DecisionRule) -> str | None:
    """Message on a bolt that is tight only because scatter or leakage lowered its threshold; ``own`` is the threshold without scatter.

    A lowered threshold must not make a bolt tight, least of all one without influence on the data: little of the prior is below it.
    """
    if rule.word(posterior.below(own, 0.0)) != TIGHT:
        return "within the scatter of tight states, but without this scatter not clearly above the threshold"
    gap = posterior.sampled is not None and own < rule.mixture_change
    if gap and TIGHT not in (rule.word(posterior.below(rule.mixture_change, 0.0)), rule.word(posterior.below(own, 0.0, changed=True))):
        return "no more than the gap beside it explains, but without the gap not clearly above the threshold"
    return None
