"""Judgement of a job: from its evidence to a verdict on each bolt by the decision rule; pure functions, no files are read or written."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np

from lrbc_cli.updating import robust
from lrbc_cli.updating.judging.bolt import BASELINE, JOB, REFERENCE, BoltVerdict, Role, verdict_on
from lrbc_cli.updating.judging.evidence import USED, VALIDATION, BoltEvidence, Evidence
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.judging.rule import LOOSE, NO_SCATTER, OUTSIDE, TIGHT, UNDECIDED, DecisionRule, TightScatter, probably
from lrbc_cli.updating.normal import normal_cdf

#: Message on a bolt that was probably not tight in the tight state.
FALLEN = "far looser than the other bolts"

#: Message on a joint that is undecided because it is far stiffer than the others in the tight state.
RISEN = "far stiffer than the other bolts in the reference job, as an error of the model makes it: its change may be an error, too"

#: Message on a bolt that is tight by channels used that the validation channels contradict.
UNCONFIRMED = "tight by the channels used alone, which the validation channels contradict"


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
    nearest : tuple of str
        Bolts that are loose, else those that probably are, in the state that fits best, if it is not explained: to be checked first.
    """

    passed: bool | None
    compared: str | None
    misfit_db: float | None
    limit_db: float
    reason: str
    unvalidated: str = ""
    nearest: tuple[str, ...] = ()

    @property
    def explained(self) -> bool:
        """Whether the bolts may be judged."""
        return self.passed is not False

    @property
    def contradicted(self) -> bool:
        """Whether bolts are judged although the validation channels are not explained, see ``judge``."""
        return self.passed is None and self.misfit_db is not None and self.misfit_db > self.limit_db

    def doubted(self, why: str, *, last: bool = False) -> Validity:
        """The same, judged but not validated for this reason, too (before or after the others); unchanged if not explained."""
        if not self.explained or not why:
            return self
        known = [self.unvalidated] if self.unvalidated else []
        reasons = "; ".join([*known, why] if last else [why, *known])
        rest = self.reason.removeprefix(f"not validated: {self.unvalidated}; ") if known else self.reason
        return replace(self, passed=None, unvalidated=reasons, reason=f"not validated: {reasons}; {rest}")


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
    evidence: Evidence, rule: DecisionRule, role: Role = JOB, scatter: TightScatter = NO_SCATTER, reference: ReferenceState | None = None
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
        If the job is not explained, or no stiffness of bolts was identified, every bolt within reach is undecided; the bolts that would be
        loose, else those that probably are, are named (``Validity.nearest``) unless they are more than half. If only the validation
        channels are not explained, bolts that are loose by the channels used are called so, and no bolt is called tight: a loose bolt
        beside a sensor that was not fitted shows errors of the model there, while of a tight bolt these channels are the only proof.
    """
    valid = validity(evidence, rule, reference)
    used = _by_channels_used(valid, evidence, rule, reference) if role == JOB else None
    if used is not None:
        found = _judged(used, evidence, rule, role, scatter)
        if any(bolt.verdict == LOOSE for bolt in found.bolts):
            return replace(found, bolts=tuple(_unconfirmed(bolt) for bolt in found.bolts))
    found = _judged(valid, evidence, rule, role, scatter)
    if valid.explained or role != JOB or not evidence.against_reference or reference is None or not reference.explained:
        return found
    if any(doubt.kind in ("copy", "exchanged") for doubt in evidence.doubts):
        # Records of another job or sensor come first.
        return found
    # A loose bolt that rattles or slips makes FRFs that no linear model explains, yet the nearest state mostly has it loose.
    would = [bolt for bolt in _judged(replace(valid, passed=None), evidence, rule, role, scatter).bolts if bolt.verdict != OUTSIDE]
    loose = [bolt.name for bolt in would if bolt.verdict == LOOSE] or [bolt.name for bolt in would if probably(bolt.probability_loose)]
    return replace(found, validity=replace(valid, nearest=tuple(loose))) if 2 * len(loose) <= len(would) else found


def _by_channels_used(found: Validity, evidence: Evidence, rule: DecisionRule, reference: ReferenceState | None) -> Validity | None:
    """Validity of what the channels used say, if only the validation channels speak against it; None otherwise."""
    if found.explained or found.compared != VALIDATION or evidence.used_misfit_db is None or not evidence.against_reference:
        return None
    if found.misfit_db is None or not isfinite(found.misfit_db):
        return None
    if not validity(replace(evidence, misfit_db=0.0), rule, reference).explained:
        return None
    why = (
        f"the validation channels are not explained (misfit {found.misfit_db:.2f} dB, limit {found.limit_db:.3g} dB), so bolts are called "
        "loose by the channels used, and none is called tight"
    )
    unvalidated = "; ".join([why, *evidence.reasons()])
    return replace(found, passed=None, unvalidated=unvalidated, reason=f"not validated: {unvalidated}; {found.reason}")


def _unconfirmed(bolt: BoltVerdict) -> BoltVerdict:
    """The same, undecided instead of tight."""
    if bolt.verdict != TIGHT:
        return bolt
    return replace(bolt, verdict=UNDECIDED, probability_loose=None, note=UNCONFIRMED, open_groups=(), unclear={}, lost_groups=())


def _judged(valid: Validity, evidence: Evidence, rule: DecisionRule, role: Role, scatter: TightScatter) -> Judgement:
    """Judgement of the bolts of a job with this validity."""
    felt = [bolt.felt for bolt in evidence.bolts if bolt.felt is not None]
    level = float(np.quantile(felt, rule.contrast_quantile)) if felt else 0.0
    far = _far_from_others(evidence.bolts, rule)
    fallen = {name: below for name, below in far.items() if below < 0.0 and role != BASELINE}
    risen = {bolt.name: _beside_risen(bolt, rise) for bolt in evidence.bolts if (rise := far.get(bolt.name, 0.0)) > 0.0 and bolt.joint}
    known = [risen.get(bolt.name, bolt) for bolt in evidence.bolts]
    found = tuple(verdict_on(bolt, evidence, rule, role, scatter, level, valid.explained) for bolt in known)
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


def scatter_of(baselines: Iterable[Sequence[BoltVerdict]]) -> TightScatter:
    """Root mean square of the changes at the bolts of the baselines, and the number of baselines with changes."""
    told = [
        [bolt.change for bolt in bolts if bolt.change is not None and bolt.change_std is not None and bolt.verdict != UNDECIDED]
        for bolts in baselines
    ]
    changes = [change for own in told for change in own]
    return TightScatter(float(np.sqrt(np.mean(np.square(changes)))), sum(bool(own) for own in told)) if changes else NO_SCATTER
