"""Judges the jobs of a campaign: applies the decision rule to their evidence, and makes the judged part of ``result.json``.

The verdicts themselves: ``updating/judging`` and guide page *statistics*, sections 7 and 8.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import inf, isfinite
from statistics import median
from typing import Any

from lrbc_cli.campaign.reading.doubts.settings import lenient_text
from lrbc_cli.config import Campaign, UpdateConfig
from lrbc_cli.errors import listing
from lrbc_cli.results.job import Alternative, Bolt, Certificate, JobRecord, TakenAsTight, ValidityRecord
from lrbc_cli.updating.judging.bolt import BASELINE, JOB, REFERENCE, BoltVerdict, Role
from lrbc_cli.updating.judging.decide import Judgement, judge, scatter_of
from lrbc_cli.updating.judging.evidence import VALIDATION, Evidence
from lrbc_cli.updating.judging.groups import whole_groups
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.judging.rule import LOOSE, OUTSIDE, TIGHT, UNDECIDED, DecisionRule, TightScatter, probably
from lrbc_cli.updating.unknowns.springs import SpringsOf

#: Status of a job whose measurement the model does not explain.
UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class ComparedWith:
    """Tight states with which a job is compared.

    Attributes
    ----------
    reference : ReferenceState or None
        None for the reference job itself, and if it has no result.
    baselines : mapping
        Results of the baselines, by name.
    """

    reference: ReferenceState | None
    baselines: Mapping[str, JobRecord]

    @property
    def scatter(self) -> TightScatter:
        """Scatter of the changes between tight states [decades]."""
        return scatter_of_records(self.baselines.values())


def role_of(update: UpdateConfig, name: str) -> Role:
    """Role of a job in its campaign: reference job, baseline, or any other job."""
    return REFERENCE if name == update.reference else BASELINE if name in update.baselines else JOB


def final_judgement(
    campaign: Campaign, rule: DecisionRule, evidence: Evidence, tight: ComparedWith, certificate: Certificate | None
) -> tuple[Judgement, list[str]]:
    """Judgement of a job of a campaign, with doubts of what the campaign states and of the reduced model, and warnings of the former.

    Parameters
    ----------
    campaign : Campaign
    rule : DecisionRule
    evidence : Evidence
    tight : ComparedWith
    certificate : Certificate or None
        Of the reduced model, if there is one.
    """
    judgement = judge(evidence, rule, role_of(campaign.update, evidence.job), tight.scatter, tight.reference)
    judgement = replace(judgement, bolts=_beside_baselines(judgement.bolts, tight.baselines))
    against = contradicted(campaign, evidence.job, judgement)
    soft = softer(judgement, {bolt.name for bolt in evidence.bolts if bolt.joint}, rule)
    doubts = [
        *(["bolts are stated to be missing, but judged tight"] if against else []),
        *(["all joints are softer than in the reference job"] if soft else []),
        *([inaccurate] if (inaccurate := missed(certificate)) else []),
    ]
    seen = [bolt for bolt in judgement.bolts if bolt.verdict != OUTSIDE]
    # A bolt that is probably loose, or springs of it, explain a larger misfit.
    loose = any(bolt.verdict == LOOSE or probably(bolt.probability_loose) or bolt.lost_groups for bolt in seen)
    if role_of(campaign.update, evidence.job) == JOB and seen and not loose:
        doubts += filter(None, [_worse(evidence, tight, rule)])
    return replace(judgement, validity=judgement.validity.doubted("; ".join(doubts), last=True)), [*against, *soft]


def _beside_baselines(bolts: Sequence[BoltVerdict], baselines: Mapping[str, JobRecord]) -> tuple[BoltVerdict, ...]:
    """The verdicts with ``unclear_groups``: springs of a tight bolt whose loss alone the data exclude in each baseline, but not here.

    Errors of the model may hide a loss that would show by the model; whether they do, only other tight states tell. At a single bolt it
    may be chance, so the data must exclude it less than of a tight one, or not exclude it of most bolts.
    """
    records = [{each.name: each.excluded_groups for each in record.bolts} for record in baselines.values() if record.explained]

    def usual(bolt: BoltVerdict, springs: SpringsOf) -> bool:
        return bool(records) and all(str(springs) in record.get(bolt.name, ()) for record in records)

    lacking = set[SpringsOf]()
    for springs in {springs for bolt in bolts for springs in bolt.unclear}:
        asked = [bolt for bolt in bolts if usual(bolt, springs)]
        count = sum(springs in bolt.unclear for bolt in asked)
        lacking |= {springs} if count > 1 and 2 * count > len(asked) else set()
    found = []
    for bolt in bolts:
        unlike = [one for one, improbable in bolt.unclear.items() if (improbable or one in lacking) and usual(bolt, one)]
        found.append(replace(bolt, unclear_groups=tuple(map(str, whole_groups(unlike)))) if unlike else bolt)
    return tuple(found)


def _worse(evidence: Evidence, tight: ComparedWith, rule: DecisionRule) -> str:
    """That a job without a loose bolt fits worse than every tight state; empty if it does not."""
    # Without some of its channels a misfit is another mean.
    whole = [record for record in tight.baselines.values() if record.explained and not record.finding.missing]
    known = [None if tight.reference is None else tight.reference.misfit_db, *(record.misfit_db.final for record in whole)]
    worst, own = max((db for db in known if db is not None and isfinite(db)), default=inf), evidence.used_misfit_db
    if own is None or own <= worst + rule.tight_margin:
        return ""
    return (
        f"the misfit of the channels used, {own:.2f} dB, is {own - worst:.2f} dB above that of every tight state, and no loose bolt "
        "explains it: something else may have changed, or springs of one component alone"
    )


def judged(
    campaign: Campaign, rule: DecisionRule, evidence: Evidence, tight: ComparedWith, certificate: Certificate | None
) -> dict[str, Any]:
    """The fields of ``JobRecord`` that judging gives, see ``final_judgement``."""
    name, update = evidence.job, campaign.update
    judgement, against = final_judgement(campaign, rule, evidence, tight, certificate)
    valid = judgement.validity
    fitted = "" if valid.explained else f"{nearest_text(judgement)}{evidence.setting}"
    warnings = [] if valid.explained else [f"the model does not explain the measurement: {valid.reason}; {fitted}"]
    warnings += [contradicted_text(judgement, evidence)] if valid.contradicted else []
    warnings += [*evidence.warnings, *suspects(judgement), *against]
    warnings += [text for text in [lenient_text(update)] if text]
    unvalidated = [valid.reason] if valid.passed is None else []
    several = [f"{', '.join(loose) or 'none'} ({share:.2f})" for loose, share in judgement.alternatives if share >= 0.005]
    states = [f"several states are probable, by their loose bolts: {'; or '.join(several)}"] if len(several) > 1 else []
    status, reason = evidence.status, evidence.reason
    if not valid.explained:
        status, reason = UNEXPLAINED, f"{valid.reason}: no verdicts ({status}: {reason}); {fitted}"
    return {
        "status": status,
        "reason": reason,
        "removed": tuple(campaign.jobs[name].removed) if states_removed(campaign) else None,
        "bolts": bolt_records(campaign, evidence, judgement),
        "alternatives": tuple(Alternative(loose=loose, probability=share) for loose, share in judgement.alternatives),
        "taken_as_tight": taken_as_tight(update, name, judgement),
        "validity": ValidityRecord.like(valid, held_out_db=valid.misfit_db if valid.compared == VALIDATION else None),
        "decision_rule": asdict(rule),
        "warnings": tuple(warnings),
        "notes": (*evidence.data_warnings, *warnings, *unvalidated, *states, *evidence.notes, *implausible(judgement)),
    }


def judged_anew(
    campaign: Campaign, rule: DecisionRule, stored: JobRecord, evidence: Evidence, tight: ComparedWith, provenance: Mapping[str, Any]
) -> JobRecord:
    """Record of a stored identification with a new judgement; the other files of the job stay as they are.

    Parameters
    ----------
    campaign : Campaign
    rule : DecisionRule
    stored : JobRecord
    evidence : Evidence
    tight : ComparedWith
    provenance : mapping
        New values of ``judgement``, ``rests_on`` and ``origin``.
    """
    prior = None if stored.prior is None else stored.prior.model_copy(update={"scatter": tight.scatter.rms})
    about = stored.provenance.model_copy(update={"configuration": campaign.resolved(), **provenance})
    fields = judged(campaign, rule, evidence, tight, stored.provenance.certificate)
    return stored.model_copy(update=fields | {"prior": prior, "provenance": about})


def missed(certificate: Certificate | None) -> str:
    """That the reduced model misses its tolerance (``--accept-tolerance``), with its error; empty if it does not."""
    if certificate is None or certificate.reached is not False:
        return ""
    return f"the reduced model has an error of {certificate.worst:.2g}, above the tolerance of {certificate.tolerance:g}"


def bolt_records(campaign: Campaign, evidence: Evidence, judgement: Judgement) -> tuple[Bolt, ...]:
    """Change [decades], probability and verdict of each bolt."""
    removed = campaign.jobs[evidence.job].removed
    stated = states_removed(campaign)
    return tuple(
        Bolt.like(
            verdict,
            position=bolt.position,
            probability_changed=bolt.probability_changed,
            removed=verdict.name in removed if stated else None,
        )
        for bolt, verdict in zip(evidence.bolts, judgement.bolts, strict=True)
    )


def states_removed(campaign: Campaign) -> bool:
    """Whether any job of the campaign states removed bolts; then jobs without that key have none removed."""
    return any(job.removed for job in campaign.jobs.values())


def taken_as_tight(update: UpdateConfig, name: str, judgement: Judgement) -> TakenAsTight | None:
    """Role of a job whose bolts are assumed tight, with the bolts that nevertheless come out loose; None for other jobs."""
    role = role_of(update, name)
    return None if role == JOB else TakenAsTight(role=role, doubtful=tuple(bolt.name for bolt in judgement.bolts if bolt.suspect))


def suspects(judgement: Judgement) -> list[str]:
    """Warning if bolts of an assumed tight state come out loose, which hides loose bolts in other jobs; else empty.

    A baseline gives the scatter of tight states; the bolts of all jobs are compared with those of the reference job.
    """
    if judgement.fallen and any(bolt.suspect for bolt in judgement.bolts):
        named = ", ".join(f"{name} ({below:+.2f} decades)" for name, below in judgement.fallen.items())
        return [
            f"probably not all tight (far below the other bolts: {named}). Bolts that are as loose in other jobs come out tight against "
            "this one. Tighten them and measure the reference job again. Bolts that are softer by design need a group of their own "
            "(parameters), or a stiffness each (select: {bushings: FILE})"
        ]
    named = ", ".join(f"{bolt.name} ({bolt.change or 0.0:+.2f} decades)" for bolt in judgement.bolts if bolt.suspect)
    if not named:
        return []
    return [
        f"probably not all tight (loose or probably loose against the reference job: {named}). As a baseline it lowers the change at which "
        "bolts of the other jobs count as loose. Remove it from update.baselines, or measure it again"
    ]


def softer(judgement: Judgement, joints: Collection[str], rule: DecisionRule) -> list[str]:
    """Warning if all joints that are not judged loose are softer than in the reference job, by much more than they scatter; else empty.

    Such a state is neither of the two kinds of bolts between which a verdict decides. Along an edge the neighbours of a gap take part of
    its change.

    Parameters
    ----------
    judgement : Judgement
    joints : collection of str
        Bolts that own their springs.
    rule : DecisionRule
    """
    rest = [bolt for bolt in judgement.bolts if bolt.name in joints and bolt.verdict in (TIGHT, UNDECIDED)]
    rest = [bolt for bolt in rest if bolt.threshold is not None and bolt.change is not None and isfinite(bolt.change)]
    changes, limits = [bolt.change or 0.0 for bolt in rest], [bolt.threshold or 0.0 for bolt in rest]
    if len(rest) < rule.softer_joints or max(changes) >= 0.0 or median(changes) > rule.softer_share * median(limits):
        return []
    return [
        f"all {len(rest)} joints that are not judged loose are softer than in the reference job, half of them by {-median(changes):.2f} "
        "decades and more: all were tightened less, or something else changed (temperature, supports). Verdicts on single joints may be "
        "wrong then. Tighten all of them, and measure again"
    ]


def nearest_text(judgement: Judgement) -> str:
    """Which bolts of an unexplained job are to be checked first, as the beginning of a text; empty if none."""
    nearest = judgement.validity.nearest
    if not nearest:
        return ""
    known = {bolt.name: bolt.change for bolt in judgement.bolts if bolt.change is not None and bolt.change < (bolt.threshold or -inf)}
    # One group of springs may be lost without a loss on the whole.
    named = [f"{name} ({known[name]:+.2f} decades)" if name in known else name for name in nearest]
    which = "this bolt" if len(nearest) == 1 else "these bolts"
    return (
        f"the nearest state has a loss at {listing(named, 4)}: check {which} first. A loose bolt that rattles or slips makes FRFs that no "
        "linear model explains, and beside it the model errs most. If tight, see what else may be wrong: "
    )


def contradicted_text(judgement: Judgement, evidence: Evidence) -> str:
    """What to check in a job with loose bolts whose validation channels are not explained."""
    valid = judgement.validity
    loose = [f"{bolt.name} ({bolt.change:+.2f} decades)" for bolt in judgement.bolts if bolt.verdict == LOOSE and bolt.change is not None]
    return (
        f"the model does not explain the validation channels: mean misfit {valid.misfit_db:.2f} dB, above the limit of "
        f"{valid.limit_db:.3g} dB; it explains the channels used ({evidence.used_misfit_db:.2f} dB), with {listing(loose, 4)} loose. "
        f"No bolt is called tight. Check {'these bolts' if len(loose) > 1 else 'this bolt'} first. If tight, check place, direction and "
        "sensitivity of the validation channels"
    )


def contradicted(campaign: Campaign, name: str, judgement: Judgement) -> list[str]:
    """Warning if bolts that are stated to be removed are judged tight; else empty."""
    update = campaign.update
    # A measurement that was handed over may have a name of its own.
    removed = campaign.jobs[name].removed if name in campaign.jobs and role_of(update, name) == JOB else ()
    tight = [bolt.name for bolt in judgement.bolts if bolt.name in removed and bolt.verdict == TIGHT]
    if not tight:
        return []
    others = [bolt.name for bolt in judgement.bolts if bolt.name not in removed and bolt.verdict == LOOSE]
    numbered = (
        f"{', '.join(others)} come{'s' if len(others) == 1 else ''} out loose instead: check whether the bolts are numbered differently "
        "at the rig, for instance from the other end"
    )
    numbered += f", and correct the names in {campaign.bolts.name}. Otherwise check" if campaign.bolts else ". Otherwise check"
    return [
        f"jobs.{name}.removed: {', '.join(tight)} {'is' if len(tight) == 1 else 'are'} stated to be missing, but judged tight against "
        f"{update.reference}. {numbered if others else 'Check'} whether the files of the two jobs, or of others, are exchanged, and "
        "correct `frf` or `removed`. If both are right, these responses do not show it (`lrbc plan`)"
    ]


def implausible(judgement: Judgement) -> list[str]:
    """Note if bolts come out tighter than in the reference job (they were loose there, or the model is wrong); else empty."""
    if not judgement.implausible:
        return []
    many = len(judgement.implausible) > 1
    names = ", ".join(judgement.implausible)
    return [f"{names}: tighter than in the reference job; {'they were' if many else 'it was'} loose there, or the model is wrong"]


def scatter_of_records(baselines: Iterable[JobRecord]) -> TightScatter:
    """Scatter of the changes between tight states, from results of baselines [decades]."""
    return scatter_of(
        [BoltVerdict(name=bolt.name, verdict=bolt.verdict, change=bolt.change, change_std=bolt.change_std) for bolt in record.bolts]
        for record in baselines
    )
