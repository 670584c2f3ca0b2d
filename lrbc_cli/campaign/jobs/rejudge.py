"""Judges finished jobs anew after a change of the decision rule, without reading the model if no input file changed.

Such a call takes ``unchanged`` and ``judge_finished``; otherwise ``run`` uses ``judge_one`` and ``keep`` for single jobs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from lrbc_cli.campaign.beside import unnamed, unseen
from lrbc_cli.campaign.digests import content_of, origin, surroundings
from lrbc_cli.campaign.jobs.identity import Copied, Identity
from lrbc_cli.campaign.jobs.judging import ComparedWith, judged_anew
from lrbc_cli.campaign.jobs.plans import JobPlan, choose_jobs, decided, needs, other_findings, settled
from lrbc_cli.campaign.jobs.standing import Outcome, rests_on
from lrbc_cli.campaign.jobs.table import write_table
from lrbc_cli.campaign.protect import input_files
from lrbc_cli.config import Campaign
from lrbc_cli.errors import DataError
from lrbc_cli.method.rule import rule_of
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.model import CampaignRecord, ReadingRecord
from lrbc_cli.results.store import read, read_job, write_sealed
from lrbc_cli.updating.judging.rule import DecisionRule

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Standing:
    """Finished jobs of which none must be identified, because nothing changed on which they depend.

    Attributes
    ----------
    plans : tuple of JobPlan
        Each is judged anew or kept.
    said : ReadingRecord
        Warnings and digest of the inputs, from when they were read.
    """

    plans: tuple[JobPlan, ...] = field(repr=False)
    said: ReadingRecord


def unchanged(campaign: Campaign, wanted: Sequence[str], *, calibration: bool) -> Standing | None:
    """The finished jobs, if the contents of all files show that at most the rule changed; None otherwise, or if this cannot be decided.

    Parameters
    ----------
    campaign : Campaign
    wanted : sequence of str
        Jobs; all if empty.
    calibration : bool
        A stored calibration is used if it fits.

    Raises
    ------
    ConfigError
        See ``choose_jobs``.
    """
    names, output, contents = choose_jobs(campaign, wanted), campaign.output, cache(content_of)

    def as_written(folder: Path, files: Mapping[str, str]) -> bool:
        return all(contents(folder / name) == digest for name, digest in files.items())

    def as_it_was(name: str, record: object, now: str) -> bool:
        if not isinstance(record, JobRecord) or record.provenance.origin != now:
            return False
        known = record.provenance.inputs
        return _files_of(campaign, name) <= set(known) and as_written(Path(), known)

    try:
        told = read(output / "campaign.json", CampaignRecord)
        # Without bolts, reading the inputs gives warnings that only that case has.
        if told is None or told.reading is None or campaign.bolts is None or not (output / "reduction.json").is_file():
            return None
        now = origin(campaign, surroundings(campaign, calibration))
        if told.reading.origin != now or not as_written(output, told.reading.files):
            return None
        records = {name: record for name in names if isinstance(record := read_job(output, name), JobRecord)}
        if not all(as_it_was(name, records.get(name), now) for name in names):
            return None
    except DataError:
        return None

    def identity_of(name: str) -> Identity:
        # As stored, except for the reference job, which may have been identified again.
        reference, parts = campaign.update.reference, records[name].provenance.parts or {}
        own = {} if reference is None or "reference" not in parts else {"reference": records[reference].provenance.identity or ""}
        return Identity.of({**parts, **own})

    plans = decided(campaign, rule_of(campaign.update), identity_of, names)
    if any(p.run or p.waits or (p.judge and not p.knows_copies) for p in plans):
        return None
    return Standing(tuple(plans), told.reading)


def _files_of(campaign: Campaign, name: str) -> set[str]:
    """Paths that the campaign file names for a job, and for everything that all jobs share."""
    named = ((path, keys) for path, keys in input_files(campaign) if keys and keys[0] != "watch")
    return {path.as_posix() for path, keys in named if keys[0] != "jobs" or keys[1] == name}


def judge_finished(campaign: Campaign, found: Standing, *, all_jobs: bool, progress: Progress) -> Outcome:
    """Judge finished jobs by the present rule where needed, and write their results.

    Parameters
    ----------
    campaign : Campaign
    found : Standing
    all_jobs : bool
        These are all jobs of the campaign: measurement files that belong to no job are reported, too.
    progress : callable
    """
    outcome, rule = Outcome(), rule_of(campaign.update)
    try:
        for p in found.plans:
            reference, names = needs(campaign, p.name)
            baselines = {other: outcome.results[other] for other in names if other in outcome.results}
            tight = ComparedWith(None if reference is None else outcome.results[reference].state, baselines)
            plan = settled(p, campaign.output, rests_on(tight), campaign.update.reference)
            if plan.judge:
                judge_one(campaign, rule, plan, tight, outcome, come_from=found.said.origin, copied=plan.copied, progress=progress)
            else:
                keep(plan, outcome, progress)
    finally:
        write_table(campaign.output, list(campaign.jobs), outcome.results)
    outcome.unseen, outcome.beside = unseen(campaign), unnamed(campaign) if all_jobs else []
    outcome.others = other_findings(campaign, outcome.findings)
    return outcome


def judge_one(
    campaign: Campaign,
    rule: DecisionRule,
    p: JobPlan,
    tight: ComparedWith,
    outcome: Outcome,
    *,
    come_from: str | None,
    copied: Copied | None,
    progress: Progress,
) -> None:
    """Judge a finished job anew, and write its result.

    Parameters
    ----------
    campaign : Campaign
    rule : DecisionRule
    p : JobPlan
        Must hold the finished result and its evidence.
    tight : ComparedWith
    outcome : Outcome
        Receives the result.
    come_from : str or None
        See ``digests.origin``.
    copied : Copied or None
        If its measurement is a copy of that of another job.
    progress : callable
    """
    assert p.record is not None
    assert p.evidence is not None
    provenance = {"origin": come_from, "judgement": p.judgement.record(copied), "rests_on": rests_on(tight)}
    record = judged_anew(campaign, rule, p.record, p.evidence.beside(copied and copied.copied), tight, provenance)
    outcome.results[p.name] = write_sealed(campaign.output / p.name / "result.json", record)
    outcome.judged.append(p.name)
    progress(f"{p.name}: judged anew, {p.reason}")


def keep(p: JobPlan, outcome: Outcome, progress: Progress) -> None:
    """Keep the result of a finished job."""
    outcome.kept.append(p.name)
    if p.record is not None:
        outcome.results[p.name] = p.record
    progress(f"{p.name}: kept, {p.reason}")
