"""Judging: from what an identification says of the bolts to verdicts, by a decision rule. A pure function of values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lrbc_cli.updating import robust
from lrbc_cli.updating.judging.evidence import USED, VALIDATION, BoltEvidence, Change, Evidence, Interval, PartialChange
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.judging.rule import LOOSE, NO_SCATTER, OUTSIDE, TIGHT, UNDECIDED, DecisionRule, TightScatter
from lrbc_cli.updating.normal import normal_cdf

#: What is said of a bolt that cannot well have been tight in the tight state.
FALLEN = "far looser than the other bolts"

#: What is said of a joint that is undecided because it lay far above the others in the tight state.
RISEN = "in the reference job far stiffer than the other bolts, as an error of the model makes it: its change may be one as well"


#: What a job is in its campaign: the tight state itself, a further tight state, or one of unknown state.
REFERENCE, BASELINE, JOB = "reference", "baseline", "job"


@dataclass(frozen=True, kw_only=True)
class Validity:
    """Whether the model explains the measurement.

    Attributes
    ----------
    passed : bool or None
        By the validation channels; None where there are none and nothing speaks against it: then it is not validated.
    compared : str or None
        The channels whose misfit was compared: ``validation channels`` or ``channels used``.
    misfit_db : float or None
        Their mean misfit.
    limit_db : float
    reason : str
    unvalidated : str
        Why it is not validated, where nothing speaks against it.
    """

    passed: bool | None
    compared: str | None
    misfit_db: float | None
    limit_db: float
    reason: str
    unvalidated: str = ""

    @property
    def explained(self) -> bool:
        """Whether bolts may be judged."""
        return self.passed is not False


@dataclass(frozen=True, kw_only=True)
class BoltVerdict:
    """What is said of one bolt.

    Attributes
    ----------
    name : str
    verdict : str
        ``tight``, ``loose``, ``undecided``, or ``outside`` where no term reaches the bolt.
    note : str or None
    log10_stiffness : float or None
    change, change_std : float or None
        Against the tight state, and its standard deviation, scatter of tight states included [decades].
    change_interval95 : (float or None, float or None) or None
        Its 95 % limits, None to the side where they are open [decades].
    probability_loose : float or None
        That the change lies below the threshold.
    threshold : float or None
        Of the change [decades].
    suspect : bool
        Taken as tight, but it would be loose in another job, or in the reference job lies far below the other bolts.
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
    suspect: bool = False


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What is said of a job.

    Attributes
    ----------
    validity : Validity
    bolts : tuple of BoltVerdict
        In the order of the evidence.
    implausible : tuple of str
        Bolts that come out tighter than in the tight state, by as much and as surely as a loose one looser.
    alternatives : tuple of (tuple of str, float)
        Bolts below their threshold in each of several states of nearly equal posterior probability; empty where these agree.
    fallen : dict
        How far bolts lie below the others of the tight state, by name, where they hardly can have been tight there [decades].
    """

    validity: Validity
    bolts: tuple[BoltVerdict, ...]
    implausible: tuple[str, ...]
    alternatives: tuple[tuple[tuple[str, ...], float], ...] = ()
    fallen: dict[str, float] = field(default_factory=dict)


def validity(evidence: Evidence, rule: DecisionRule, reference: ReferenceState | None = None) -> Validity:
    """Compare the misfit of the validation channels with that of the reference job and a margin, or with ``rule.largest_misfit``.

    The channels used must stay below theirs too, which is necessary and shows nothing: they were fitted, and where they are not explained
    a sensor may sit elsewhere than the model has it. So must both of the reference job: what the model does not explain is no state to
    compare with. Nor does a measurement that was not exchanged tell anything of the bolts. Above ``rule.validated_misfit`` bolts may be
    judged, but nothing is validated, nor is a change from a reference job that is known to within the limit only: it is the difference of
    two states, each as wrong as that one.
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
            reason += f", but of the {of} of the reference job, with which it is compared, {most}"
    before = max(db or 0.0 for db in (compared_before, used_before))
    worst = max(db for db in (misfit, fitted, before) if db is not None)
    usual = rule.validated_misfit
    beyond = f"a misfit of {worst:.2f} dB, above {usual:g} dB, validates nothing" if worst > usual else ""
    both = math.hypot(before, before)
    coarse = (
        f"the model explains the reference job to {before:.2f} dB, so that a change from it, a difference of two such states, may err "
        f"by {both:.2f} dB, above {usual:g} dB: improve model or calibration"
    )
    unvalidated = evidence.doubted or (evidence.unvalidated if evidence.compared != VALIDATION else "") or beyond
    unvalidated = unvalidated or (coarse if both > usual else "")
    if not within or not unvalidated:
        return Validity(passed=within, compared=compared, misfit_db=misfit, limit_db=limit, reason=reason)
    reason = f"not validated: {unvalidated}; {reason}"
    return Validity(passed=None, compared=compared, misfit_db=misfit, limit_db=limit, reason=reason, unvalidated=unvalidated)


def judge(
    evidence: Evidence,
    rule: DecisionRule,
    role: str = JOB,
    scatter: TightScatter = NO_SCATTER,
    reference: ReferenceState | None = None,
) -> Judgement:
    """Judge the bolts of a job.

    Parameters
    ----------
    evidence : Evidence
    rule : DecisionRule
    role : str
        ``reference``, ``baseline`` or ``job``.
    scatter : TightScatter
        Of the changes between tight states, see ``scatter_of``; none where there is only one.
    reference : ReferenceState or None
        That it was identified against; None in the reference job itself.

    Returns
    -------
    Judgement
        Without stiffness along edges every bolt is undecided.
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
        # Of a baseline, too: what such a joint does is no scatter of tight ones.
        known_loose = {v.name for v in found if v.verdict == LOOSE}
        found = tuple(replace(v, note=RISEN, verdict=UNDECIDED) if v.name in risen.keys() - known_loose else v for v in found)
    if role == REFERENCE and valid.explained:
        found = tuple(v if v.name not in fallen else replace(v, suspect=True, note=f"{v.note}, but {FALLEN}") for v in found)
    rises = tuple(v.name for v in found if _risen(v, rule))
    if role == JOB and valid.explained and (rises or fallen or evidence.excused) and not any(v.verdict == LOOSE for v in found):
        if rises or fallen:
            # A reference state with loose bolts shows here: what it lacked has come back, and what it lacks still is compared with itself.
            which = f"{', '.join(rises)} tighter than in" if rises else f"{', '.join(fallen)} {FALLEN} in"
            why = f"{which} the reference job: was all tight there?"
        else:
            # Of tight bolts no change is so sure that it excuses a measurement.
            why = f"{evidence.excused}; the change identified would explain it, but no bolt is judged loose;"
        reasons = "; ".join([why.rstrip(";"), *([valid.unvalidated] if valid.unvalidated else [])])
        valid = replace(
            valid, passed=None, unvalidated=reasons, reason=f"not validated: {why}{'' if why.endswith('?') else ';'} {valid.reason}"
        )
    several = _alternatives(evidence, found) if valid.explained and role == JOB else ()
    return Judgement(validity=valid, bolts=found, implausible=rises, alternatives=several, fallen=fallen)


def _risen(verdict: BoltVerdict, rule: DecisionRule) -> bool:
    """Whether a bolt is tighter than in the tight state, as surely as a loose one is looser."""
    change, std, threshold = verdict.change, verdict.change_std, verdict.threshold
    if change is None or std is None or threshold is None:
        return False
    return float(normal_cdf((change + threshold) / max(std, 1e-12))) >= rule.confidence


def _beside_risen(bolt: BoltEvidence, rise: float) -> BoltEvidence:
    """The same of a joint that in the tight state lies far above the others, by an error of the model, which its change may be as well.

    A spring that is hardly felt takes up what the model lacks; where it does not in another job, it seems to have loosened.
    """
    change = bolt.change
    if change is None:
        return bolt
    std = float(np.hypot(change.std, rise))
    return replace(bolt, change=replace(change, mean=change.mean + rise, std=std, excess=change.excess + rise, parts=()))


def _far_from_others(bolts: Sequence[BoltEvidence], rule: DecisionRule) -> dict[str, float]:
    """How far bolts lie from the others in the tight state [decades], those that do by more than these scatter.

    Bolts of the same groups are compared, with their median. Their scatter is taken from the median of the departures, which those that
    are loose do not move as long as they are the fewer, and is no less than that of tight joints.
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
    """On one bolt; ``level`` is that of the others."""
    if not evidence.along_edges:
        return BoltVerdict(name=bolt.name, verdict=UNDECIDED, note="no stiffness group that bolts own or lie along")
    if bolt.outside is not None:
        return BoltVerdict(name=bolt.name, verdict=OUTSIDE, note=bolt.outside)
    word, note, change, std, probability, threshold = _by_role(bolt, evidence, rule, role, scatter, level)
    suspect = role == BASELINE and word == LOOSE
    if role == BASELINE:
        word, probability = TIGHT, None
        tight = "a baseline, taken as tight"
        note = f"{tight}, but against the reference job it comes out loose" if suspect else note or tight
    if not explained:
        word, probability, note = UNDECIDED, None, "the model does not explain the measurement"
    return BoltVerdict(
        name=bolt.name,
        verdict=word,
        note=note,
        log10_stiffness=bolt.log10_stiffness,
        change=change,
        change_std=std,
        change_interval95=None if change is None or std is None or bolt.change is None else bolt.change.interval(change, std),
        probability_loose=probability,
        threshold=threshold,
        suspect=suspect and explained,
    )


def _by_role(
    bolt: BoltEvidence, evidence: Evidence, rule: DecisionRule, role: str, scatter: TightScatter, level: float
) -> tuple[str, str | None, float | None, float | None, float | None, float | None]:
    """Verdict, note, change and its standard deviation, probability of being loose, threshold."""
    if role == REFERENCE:
        return TIGHT, "reference state, taken as tight", 0.0, None, None, None
    if bolt.change is not None:
        posterior = bolt.change
        # Beside a gap a tight bolt takes part of it: what is below the threshold for that says nothing.
        own = rule.loose_change if posterior.sampled is None else min(rule.mixture_change, posterior.leakage)
        between = scattered = rule.scatter(scatter, bolt.joint)
        limit = rule.limit(own, between, bolt.joint)
        between *= rule.joint_spread if bolt.joint else 1.0
        probability, note = posterior.below(limit, between), None
        part, alone = _most_changed(posterior, own, scattered, rule)
        if part is not None and alone > probability:
            # An error of the model can look like it, beside loose bolts above all: the data do not say which of the two it is.
            whole, probability = probability, 0.5 * (probability + alone)
            if rule.word(alone) != rule.word(whole):
                note = f"its springs of {part.group} alone changed by {part.mean:.2g} ± {part.std:.2g} decades"
        word = rule.word(probability)
        if word == UNDECIDED and note is None:
            note = "the data do not decide: the interval of its change holds the threshold"
        excused = _excused(posterior, own, rule) if word == TIGHT else None
        if word == TIGHT and excused is None and bolt.joint and bolt.difference is not None and bolt.difference <= limit:
            excused = "its posterior says tight, but the stiffness identified lies below the threshold"
        if word == TIGHT and posterior.may_be_free:
            excused = "the data do not object to it being free: no response feels it as it is"
        if excused is not None:
            word, note = UNDECIDED, excused
        elif word == TIGHT and posterior.unfelt:
            note = f"judged by its other springs: no response feels those of {', '.join(posterior.unfelt)}"
        change = posterior.mean if posterior.ceiling is None else min(posterior.mean, posterior.ceiling)
        return word, note, change, float(np.hypot(posterior.std, between)), probability, limit
    if evidence.missing_reference is not None:
        # Changes were wanted: a contrast between bolts is no answer.
        return UNDECIDED, f"no result of {evidence.missing_reference} to compare with", bolt.difference, None, None, None
    if bolt.difference is not None:
        return LOOSE if bolt.difference <= rule.loose_change else TIGHT, None, bolt.difference, None, None, None
    # Without a tight state nothing says that a bolt is tight: all may be loose.
    loose = bolt.felt is not None and bolt.felt - level <= rule.loose_change
    note = "no tight state to compare with: loose by contrast with the other bolts, or inconclusive"
    return LOOSE if loose else UNDECIDED, note, None, None, None, None


def _most_changed(posterior: Change, own: float, scatter: float, rule: DecisionRule) -> tuple[PartialChange | None, float]:
    """The group of a joint's springs that is most probably loose by itself, and how probably: a joint is no tighter than that.

    By the rule for the whole joint, with the scatter of the springs of one group, which is that of the joint and their own about it.
    """
    found: tuple[PartialChange | None, float] = (None, 0.0)
    for part in posterior.parts:
        between = float(np.hypot(scatter, part.deviation))
        limit = rule.limit(own, between, joint=True)
        probability = float(normal_cdf((limit - part.mean) / max(float(np.hypot(part.std, rule.joint_spread * between)), 1e-12)))
        if probability > found[1]:
            found = part, probability
    return found


def _excused(posterior: Change, own: float, rule: DecisionRule) -> str | None:
    """What excuses a change that lies above its threshold, where only that does; ``own``: the threshold without scatter of tight states.

    Excuses clear no bolt, least of all one that the data do not see: of the prior itself little lies below a threshold that was lowered.
    """
    if rule.word(posterior.below(own, 0.0)) != TIGHT:
        return "no more than tight states scatter, but not clearly above the threshold without that"
    gap = posterior.sampled is not None and own < rule.mixture_change
    if gap and TIGHT not in (rule.word(posterior.below(rule.mixture_change, 0.0)), rule.word(posterior.below(own, 0.0, changed=True))):
        return "no more than the gap beside it explains, but not clearly above the threshold without that"
    return None


def scatter_of(baselines: Iterable[Sequence[BoltVerdict]]) -> TightScatter:
    """Root mean square of the changes at the bolts of further tight jobs, and how many of these tell it."""
    told = [
        [bolt.change for bolt in bolts if bolt.change is not None and bolt.change_std is not None and bolt.verdict != UNDECIDED]
        for bolts in baselines
    ]
    changes = [change for own in told for change in own]
    return TightScatter(float(np.sqrt(np.mean(np.square(changes)))), sum(bool(own) for own in told)) if changes else NO_SCATTER
