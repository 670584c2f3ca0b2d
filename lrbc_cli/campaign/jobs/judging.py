"""Judging the jobs of a campaign: the rule and the role that its settings give, and what a judgement adds to a result."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from lrbc_cli.campaign.reading.doubts.settings import lenient_text
from lrbc_cli.config import Campaign, UpdateConfig
from lrbc_cli.results.job import JobRecord
from lrbc_cli.updating.judging.decide import BASELINE, JOB, REFERENCE, BoltVerdict, Judgement, judge, scatter_of
from lrbc_cli.updating.judging.evidence import VALIDATION, Evidence
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.judging.rule import LOOSE, TIGHT, DecisionRule, TightScatter

#: Status of a job whose measurement the model does not explain.
UNEXPLAINED = "unexplained"

#: What of a result judging writes.
JUDGED = ("status", "reason", "removed", "bolts", "alternatives", "taken_as_tight", "validity", "decision_rule", "warnings", "notes")


@dataclass(frozen=True)
class ComparedWith:
    """The tight states that the verdicts of a job rest on.

    Attributes
    ----------
    reference : ReferenceState or None
        None for the reference job itself, and where it has no result.
    baselines : mapping
        Stored results of the baselines, by name.
    """

    reference: ReferenceState | None
    baselines: Mapping[str, JobRecord]

    @property
    def scatter(self) -> TightScatter:
        """Of the changes between tight states [decades]."""
        return scatter_of_records(self.baselines.values())


def role_of(update: UpdateConfig, name: str) -> str:
    """What a job is in its campaign."""
    return REFERENCE if name == update.reference else BASELINE if name in update.baselines else JOB


def judged(campaign: Campaign, rule: DecisionRule, evidence: Evidence, tight: ComparedWith) -> dict[str, Any]:
    """The part of ``result.json`` that judging writes, over what the identification wrote."""
    name, update = evidence.job, campaign.update
    judgement = judge(evidence, rule, role_of(update, name), tight.scatter, tight.reference)
    valid = judgement.validity
    warnings = [] if valid.explained else [f"the model does not explain the measurement: {valid.reason}; {evidence.setting}"]
    warnings += [*evidence.warnings, *suspects(judgement), *contradicted(campaign, name, judgement)]
    warnings += [text for text in [lenient_text(update)] if text]
    unvalidated = [valid.reason] if valid.passed is None else []
    several = [f"{', '.join(loose) or 'none'} ({share:.2f})" for loose, share in judgement.alternatives]
    states = [f"states of nearly equal posterior probability, by their loose bolts: {'; or '.join(several)}"] if several else []
    status, reason = evidence.status, evidence.reason
    if not valid.explained:
        status, reason = UNEXPLAINED, f"{valid.reason}: no verdicts ({status}: {reason}); {evidence.setting}"
    return {
        "status": status,
        "reason": reason,
        "removed": list(campaign.jobs[name].removed) if states_removed(campaign) else None,
        "bolts": bolt_trees(campaign, evidence, judgement),
        "alternatives": [{"loose": list(loose), "probability": share} for loose, share in judgement.alternatives],
        "taken_as_tight": taken_as_tight(update, name, judgement),
        "validity": {
            **asdict(valid),
            "held_out_db": valid.misfit_db if valid.compared == VALIDATION else None,
        },
        "scatter": tight.scatter.rms,
        "decision_rule": asdict(rule),
        "warnings": warnings,
        "notes": [
            *evidence.data_warnings,
            *warnings,
            *unvalidated,
            *states,
            *evidence.notes,
            *implausible(judgement),
        ],
    }


def with_judgement(
    campaign: Campaign, rule: DecisionRule, identified: Mapping[str, Any], evidence: Evidence, tight: ComparedWith
) -> dict[str, Any]:
    """The content of ``result.json``: what was identified, and what that says of the bolts."""
    said = judged(campaign, rule, evidence, tight)
    prior = {**identified["prior"], "scatter": said.pop("scatter")}
    provenance = {**identified["provenance"], "configuration": campaign.resolved()}
    return {"job": evidence.job, **said, **identified, "prior": prior, "provenance": provenance}


def judged_anew(
    campaign: Campaign,
    rule: DecisionRule,
    stored: JobRecord,
    evidence: Evidence,
    tight: ComparedWith,
    provenance: Mapping[str, Any],
) -> JobRecord:
    """A stored identification with another judgement; its other files stay as they are.

    Parameters
    ----------
    campaign : Campaign
    rule : DecisionRule
    stored : JobRecord
    evidence : Evidence
    tight : ComparedWith
    provenance : mapping
        What changes of the provenance: ``judgement``, ``rests_on``, ``origin``.
    """
    identified = {key: value for key, value in stored.tree().items() if key not in JUDGED}
    tree = with_judgement(campaign, rule, identified, evidence, tight)
    tree["provenance"] |= provenance
    return JobRecord.checked(tree)


def bolt_trees(campaign: Campaign, evidence: Evidence, judgement: Judgement) -> list[dict[str, Any]]:
    """``bolts`` of ``result.json``."""
    removed = campaign.jobs[evidence.job].removed
    stated = states_removed(campaign)
    return [
        {
            "name": verdict.name,
            "position": bolt.position,
            "log10_stiffness": verdict.log10_stiffness,
            "change": verdict.change,
            "change_std": verdict.change_std,
            "change_interval95": verdict.change_interval95,
            "threshold": verdict.threshold,
            "probability_loose": verdict.probability_loose,
            "probability_changed": bolt.probability_changed,
            "verdict": verdict.verdict,
            "removed": verdict.name in removed if stated else None,
            "note": verdict.note,
        }
        for bolt, verdict in zip(evidence.bolts, judgement.bolts, strict=True)
    ]


def states_removed(campaign: Campaign) -> bool:
    """Whether the campaign says which bolts are removed: then a job without that key has none removed."""
    return any(job.removed for job in campaign.jobs.values())


def taken_as_tight(update: UpdateConfig, name: str, judgement: Judgement) -> dict[str, Any] | None:
    """The role in which the bolts of a job are tight by assumption, and those that come out loose all the same; None for other jobs."""
    role = role_of(update, name)
    return None if role == JOB else {"as": role, "doubtful": [bolt.name for bolt in judgement.bolts if bolt.suspect]}


def suspects(judgement: Judgement) -> list[str]:
    """A warning where bolts of a tight state come out loose, which hides loose bolts.

    Those of a baseline count as scatter of tight states; with those of the reference job the bolts of all others are compared.
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
        f"probably not all tight (loose against the reference job: {named}). As a baseline it lowers the change at which bolts of the "
        "other jobs count as loose. Remove it from update.baselines, or measure it again"
    ]


def contradicted(campaign: Campaign, name: str, judgement: Judgement) -> list[str]:
    """A warning where bolts that are stated to be removed are judged tight."""
    update = campaign.update
    removed = campaign.jobs[name].removed if role_of(update, name) == JOB else ()
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
    """A note where bolts come out tighter than in the reference job: they were loose there, or the model errs."""
    if not judgement.implausible:
        return []
    many = len(judgement.implausible) > 1
    names = ", ".join(judgement.implausible)
    return [f"{names}: tighter than in the reference job; {'they were' if many else 'it was'} loose there, or the model is wrong"]


def scatter_of_records(baselines: Iterable[JobRecord]) -> TightScatter:
    """Scatter of the changes between tight states, of stored results [decades]."""
    return scatter_of(
        [BoltVerdict(name=bolt.name, verdict=bolt.verdict, change=bolt.change, change_std=bolt.change_std) for bolt in record.bolts]
        for record in baselines
    )
