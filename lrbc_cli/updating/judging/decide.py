"""Judgement of a job: from its evidence to a verdict on each bolt by the decision rule; pure functions, no files are read or written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from lrbc_cli.updating import robust
from lrbc_cli.updating.judging.evidence import USED, BoltEvidence, Change, Evidence, Interval
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
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.judging.rule import LOOSE, NO_SCATTER, OUTSIDE, TIGHT, UNDECIDED, DecisionRule, TightScatter, probably
from lrbc_cli.updating.normal import normal_cdf
from lrbc_cli.updating.unknowns.springs import SpringsOf

#: Message on a bolt that was probably not tight in the tight state.
FALLEN = "far looser than the other bolts"

#: Message on a joint that is undecided because it is far stiffer than the others in the tight state.
RISEN = "far stiffer than the other bolts in the reference job, as an error of the model makes it: its change may be an error, too"

#: Message on a joint that is probably not of the loose kind: residuals of a wrong model pull the change of a tight one below the limit.
INSIGNIFICANT = "errors of the model may explain its change: a loss improves the fit, but not significantly"

#: Role of a job in its campaign: the tight state itself, a further tight state, or an unknown state.
Role = Literal["reference", "baseline", "job"]
REFERENCE: Final = "reference"
BASELINE: Final = "baseline"
JOB: Final = "job"


@dataclass(frozen=True, kw_only=True)
class Validity:
    """Whether the model explains the measurement.

    Attributes
    ----------
    passed : bool or None
        True if explained and validated, False if not explained, None if judged but not validated.
    compared : str or None
        Channels whose misfit was compared: ``validation channels`` or ``channels used``.
    misfit_db : float or None
        Their mean misfit [dB].
    limit_db : float
        Limit of the misfit [dB].
    reason : str
    unvalidated : str
        Why it is not validated, if ``passed`` is None.
    """

    passed: bool | None
    compared: str | None
    misfit_db: float | None
    limit_db: float
    reason: str
    unvalidated: str = ""

    @property
    def explained(self) -> bool:
        """Whether the bolts may be judged."""
        return self.passed is not False

    def doubted(self, why: str, *, last: bool = False) -> Validity:
        """The same, judged but not validated for this reason, too (before or after the others); unchanged if not explained."""
        if not self.explained or not why:
            return self
        known = [self.unvalidated] if self.unvalidated else []
        reasons = "; ".join([*known, why] if last else [why, *known])
        rest = self.reason.removeprefix(f"not validated: {self.unvalidated}; ") if known else self.reason
        return replace(self, passed=None, unvalidated=reasons, reason=f"not validated: {reasons}; {rest}")


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


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Judgement of a job.

    Attributes
    ----------
    validity : Validity
    bolts : tuple of BoltVerdict
        In the order of the evidence.
    implausible : tuple of str
        Bolts tighter than in the tight state by the threshold, with the probability that a verdict needs.
    alternatives : tuple of (tuple of str, float)
        Loose bolts in each of several states of nearly equal posterior probability, and this probability; empty if these agree.
    fallen : dict
        Bolts that were probably not tight in the tight state: by name the distance from the other bolts (negative) [decades].
    """

    validity: Validity
    bolts: tuple[BoltVerdict, ...]
    implausible: tuple[str, ...]
    alternatives: tuple[tuple[tuple[str, ...], float], ...] = ()
    fallen: dict[str, float] = field(default_factory=dict)


def validity(evidence: Evidence, rule: DecisionRule, reference: ReferenceState | None = None) -> Validity:
    """Compare the misfit of a job with its limits: guide, *statistics*, section 7.

    The misfit of the validation channels must not exceed that of the reference job by more than the margin, or ``rule.largest_misfit``
    without one. The channels used have a limit, too, although they were fitted: a sensor may be elsewhere than in the model. Both misfits
    of the reference job must be below ``rule.largest_misfit``, because a state that is not explained is nothing to compare with. A job is
    judged but not validated if its measurement is doubted, if there is no validation channel, or if a misfit, or √2 times that of the
    reference job (a change is the difference of two states), is above ``rule.validated_misfit``.
    """
    against = reference if evidence.against_reference else None
    compared_before, used_before = (None if against is None else against.misfit_of(channels) for channels in (evidence.compared, USED))
    limit, misfit = rule.most_db(compared_before), evidence.misfit_db
    if misfit is None:
        return Validity(passed=False, compared=None, misfit_db=None, limit_db=limit, reason="no response can be compared")
    compared, fitted, of_used = evidence.compared, evidence.used_misfit_db, max(rule.largest_misfit, rule.most_db(used_before))
    if misfit <= limit and fitted is not None and fitted > of_used:
        compared, misfit, limit = USED, fitted, of_used
    beside = f" ({rule.misfit_margin:g} dB more than that of the reference job)" if limit != rule.largest_misfit else ""
    within = misfit <= limit
    side = "within" if within else "above"
    reason = f"mean misfit of the {compared} {misfit:.2f} dB, {side} the limit of {limit:.3g} dB{beside}"
    for of, before in ((evidence.compared, compared_before), (USED, used_before)):
        if within and before is not None and before > rule.largest_misfit:
            within = False
            most = f"{before:.2f} dB, above the limit of {rule.largest_misfit:.3g} dB"
            reason += f", but the misfit of the {of} of the reference job, with which it is compared, is {most}"
    before = max(db or 0.0 for db in (compared_before, used_before))
    worst = max(db for db in (misfit, fitted, before) if db is not None)
    usual = rule.validated_misfit
    beyond = f"a misfit of {worst:.2f} dB is above {usual:g} dB and validates nothing" if worst > usual else ""
    own = beyond or rule.too_coarse(before)
    unvalidated = "; ".join([*evidence.reasons(), *([own] if own else [])])
    if not within or not unvalidated:
        return Validity(passed=within, compared=compared, misfit_db=misfit, limit_db=limit, reason=reason)
    reason = f"not validated: {unvalidated}; {reason}"
    return Validity(passed=None, compared=compared, misfit_db=misfit, limit_db=limit, reason=reason, unvalidated=unvalidated)


def judge(
    evidence: Evidence, rule: DecisionRule, role: str = JOB, scatter: TightScatter = NO_SCATTER, reference: ReferenceState | None = None
) -> Judgement:
    """Judge the bolts of a job.

    Parameters
    ----------
    evidence : Evidence
    rule : DecisionRule
    role : str
        ``reference``, ``baseline`` or ``job``.
    scatter : TightScatter
        Scatter of the changes between tight states, see ``scatter_of``.
    reference : ReferenceState or None
        The reference state of the job; None in the reference job itself.

    Returns
    -------
    Judgement
        If the job is not explained, or no stiffness of bolts was identified, every bolt within reach is undecided.
    """
    valid = validity(evidence, rule, reference)
    felt = [bolt.felt for bolt in evidence.bolts if bolt.felt is not None]
    level = float(np.quantile(felt, rule.contrast_quantile)) if felt else 0.0
    far = _far_from_others(evidence.bolts, rule)
    fallen = {name: below for name, below in far.items() if below < 0.0 and role != BASELINE}
    risen = {bolt.name: _beside_risen(bolt, rise) for bolt in evidence.bolts if (rise := far.get(bolt.name, 0.0)) > 0.0 and bolt.joint}
    known = [risen.get(bolt.name, bolt) for bolt in evidence.bolts]
    found = tuple(_verdict(bolt, evidence, rule, role, scatter, level, valid.explained) for bolt in known)
    if valid.explained and role != REFERENCE:
        # In a baseline, too: the change of such a joint must not count as scatter of tight ones.
        known_loose = {v.name for v in found if v.verdict == LOOSE}
        found = tuple(replace(v, note=RISEN, verdict=UNDECIDED) if v.name in risen.keys() - known_loose else v for v in found)
    if role == REFERENCE and valid.explained:
        found = tuple(v if v.name not in fallen else replace(v, suspect=True, note=f"{v.note}, but {FALLEN}") for v in found)
    rises = tuple(v.name for v in found if _risen(v, rule))
    if (
        role == JOB
        and valid.explained
        and (rises or fallen or evidence.reasons(explained=True))
        and not any(v.verdict == LOOSE for v in found)
    ):
        if rises or fallen:
            # Signs of a reference state with loose bolts: bolts tightened since appear tighter, bolts loose in both jobs appear unchanged.
            which = f"{', '.join(rises)} tighter than in" if rises else f"{', '.join(fallen)} {FALLEN} in"
            why = f"{which} the reference job: check whether all bolts were tight there"
        else:
            # Without a loose bolt no change is certain enough to explain the apparent fault of the measurement.
            why = f"{'; '.join(evidence.reasons(explained=True))}; a loose bolt might cause it, but none is judged loose"
        valid = valid.doubted(why)
    several = _alternatives(evidence, found) if valid.explained and role == JOB else ()
    return Judgement(validity=valid, bolts=found, implausible=rises, alternatives=several, fallen=fallen)


def _risen(verdict: BoltVerdict, rule: DecisionRule) -> bool:
    """Whether a bolt is tighter than in the tight state by the threshold, with probability ``confidence``."""
    change, std, threshold = verdict.change, verdict.change_std, verdict.threshold
    if change is None or std is None or threshold is None:
        return False
    return float(normal_cdf((change + threshold) / max(std, 1e-12))) >= rule.confidence


def _beside_risen(bolt: BoltEvidence, rise: float) -> BoltEvidence:
    """The same with ``rise`` added to the change and to its standard deviation, for a joint far stiffer than others in the tight state.

    A spring that hardly affects the FRFs absorbs errors of the model. If it does not in another job, it appears loosened.
    """
    change = bolt.change
    if change is None:
        return bolt
    std = float(np.hypot(change.std, rise))
    return replace(bolt, change=replace(change, mean=change.mean + rise, std=std, excess=change.excess + rise, parts=()))


def _far_from_others(bolts: Sequence[BoltEvidence], rule: DecisionRule) -> dict[str, float]:
    """Bolts far from the others in the tight state: by name the distance from the median of the bolts with the same groups [decades].

    The limit is the threshold of a loose bolt, with the robust scatter of these bolts (at least that of tight joints), which few loose
    ones do not change.
    """
    found = {}
    tight = {
        bolt.name: (bolt.felt - (bolt.difference or 0.0), bolt.tight_std, bolt.groups)
        for bolt in bolts
        if bolt.felt is not None and bolt.tight_std is not None
    }
    for name, (value, std, own) in tight.items():
        peers = np.array([other for other, _, groups in tight.values() if groups == own])
        middle = float(np.median(peers))
        limit = rule.limit(rule.loose_change, max(float(robust.scatter(peers)), rule.joint_scatter))
        if float(normal_cdf((limit + abs(value - middle)) / max(std, 1e-12))) >= rule.confidence:
            found[name] = value - middle
    return found


def _alternatives(evidence: Evidence, verdicts: Sequence[BoltVerdict]) -> tuple[tuple[tuple[str, ...], float], ...]:
    found = dict[tuple[str, ...], float]()
    for changes, share in evidence.alternatives:
        both = zip(verdicts, changes, strict=True)
        loose = tuple(v.name for v, change in both if change is not None and v.threshold is not None and change <= v.threshold)
        found[loose] = found.get(loose, 0.0) + share
    return tuple(sorted(found.items(), key=lambda one: -one[1])) if len(found) > 1 else ()


def _verdict(
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


def scatter_of(baselines: Iterable[Sequence[BoltVerdict]]) -> TightScatter:
    """Root mean square of the changes at the bolts of the baselines, and the number of baselines with changes."""
    told = [
        [bolt.change for bolt in bolts if bolt.change is not None and bolt.change_std is not None and bolt.verdict != UNDECIDED]
        for bolts in baselines
    ]
    changes = [change for own in told for change in own]
    return TightScatter(float(np.sqrt(np.mean(np.square(changes)))), sum(bool(own) for own in told)) if changes else NO_SCATTER
