"""Decides for each job of a campaign, with the reason: identify, judge anew, or keep the finished result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from lrbc_cli.campaign.digests import content_of
from lrbc_cli.campaign.jobs.identity import JUDGED, PARTS, Copied, Identity, changed, identification, judgement, measured
from lrbc_cli.campaign.jobs.judging import ComparedWith
from lrbc_cli.campaign.jobs.standing import altered, of_other_libraries, other_baselines, other_reference, rests_on
from lrbc_cli.config import Campaign
from lrbc_cli.errors import DataError, LrbcError
from lrbc_cli.results.job import FailedJob, Job, JobRecord, RestsOn
from lrbc_cli.results.store import read_evidence, read_job
from lrbc_cli.updating.judging.clearance import JobFinding
from lrbc_cli.updating.judging.evidence import Evidence
from lrbc_cli.updating.judging.rule import DecisionRule

if TYPE_CHECKING:
    from lrbc_cli.campaign.reading.inputs import Inputs


@dataclass(frozen=True, kw_only=True)
class JobPlan:
    """What is to be done for one job, and why.

    Attributes
    ----------
    name : str
    run : bool
        It is identified.
    reason : str
    identity, judgement : Identity
        Digests of what its identification and judgement depend on now.
    judge : bool
        Its identification is kept and judged anew.
    waits : bool
        Jobs on which it depends run first; whether it runs is decided after them.
    record : JobRecord or None
        Finished result, if it can be kept.
    evidence : Evidence or None
        Stored evidence from which it is judged anew.
    original : str
        Job of which its measurement was a copy, if that job has another measurement now.
    """

    name: str
    run: bool
    reason: str
    identity: Identity
    judgement: Identity
    judge: bool = False
    waits: bool = False
    record: JobRecord | None = field(default=None, repr=False, compare=False)
    evidence: Evidence | None = field(default=None, repr=False, compare=False)
    original: str = ""

    @property
    def knows_copies(self) -> bool:
        """Whether the finished result states if its measurement is a copy, of one of the present baselines among others."""
        stored = None if self.record is None else self.record.provenance.judgement
        return stored is not None and not self.original and stored.parts.get("baselines") == self.judgement.parts["baselines"]

    @property
    def copied(self) -> Copied | None:
        """What is stored about a copied measurement; None if it is none."""
        stored = None if self.record is None else self.record.provenance.judgement
        if stored is None or stored.copied is None:
            return None
        return Copied(stored.copied, stored.original or "", stored.content or "")

    @property
    def kept(self) -> bool:
        """Nothing is done, whatever the results of other jobs."""
        return not (self.run or self.judge or self.waits)

    @property
    def verb(self) -> str:
        """What is done, in words."""
        return "runs" if self.run else "judged anew" if self.judge else "kept"


def needs(campaign: Campaign, name: str) -> tuple[str | None, tuple[str, ...]]:
    """Reference job and baselines on which the verdicts of a job depend."""
    update = campaign.update
    if update.reference in (None, name):
        return None, ()
    # A baseline does not use the others: its result must not depend on which of them are done.
    return update.reference, () if name in update.baselines else update.baselines


def decided(
    campaign: Campaign, rule: DecisionRule, identity_of: Callable[[str], Identity], names: Sequence[str], force: bool = False
) -> list[JobPlan]:
    """Plan of each job; changes no files.

    Parameters
    ----------
    campaign : Campaign
    rule : DecisionRule
    identity_of : callable
        From the name of a job to the digest of what its identification depends on now.
    names : sequence of str
        Jobs after those on which they depend, as ``choose_jobs`` orders them.
    force : bool
        Identify finished jobs again.
    """
    output = campaign.output
    plans: dict[str, JobPlan] = {}
    for name in names:
        own, judged = identity_of(name), judgement(campaign, rule, name)
        plans[name] = _alone(campaign, JobPlan(name=name, run=True, reason="no result yet", identity=own, judgement=judged))
        if force and not plans[name].run:
            plans[name] = replace(plans[name], run=True, judge=False, reason="--force", record=None)
        reference, baselines = needs(campaign, name)
        if plans[name].run or reference is None:
            continue
        first = [other for other in (reference, *baselines) if other not in plans or plans[other].run or plans[other].waits]
        if first:
            plans[name] = _waiting(plans[name], first, reference)
        else:
            kept = {other: record for other in baselines if (record := plans[other].record) is not None}
            before = plans[reference].record
            tight = ComparedWith(None if before is None else before.state, kept)
            plans[name] = settled(plans[name], output, rests_on(tight), reference)
            anew = [other for other in baselines if plans[other].judge]
            if anew and plans[name].kept:
                # The rule that judges the baselines anew also applies to this job; their verdicts are not known yet.
                plans[name] = _judged(plans[name], output, f"changed: the judgement of {', '.join(anew)}")
    return list(plans.values())


def plan(inputs: Inputs, parts: Mapping[str, str], names: Sequence[str], force: bool = False) -> list[JobPlan]:
    """As ``decided``, from inputs that were read and the ``parts`` of the model by ``cache.key_parts``."""
    return decided(inputs.campaign, inputs.method.rule, partial(identification, inputs, parts), names, force)


def _alone(campaign: Campaign, job: JobPlan) -> JobPlan:
    """Plan of a job by its own files and settings, without those on which it depends."""
    folder = campaign.output / job.name
    try:
        stored = read_job(folder.parent, job.name)
    except DataError as error:
        return replace(job, reason=f"the earlier result is unusable ({error.problem})")
    if stored is None:
        return job
    if isinstance(stored, FailedJob):
        return replace(job, reason="it failed before")
    reason = _outdated(stored, job, folder)
    if reason is not None:
        return replace(job, reason=reason)
    found = replace(job, run=False, reason=unchanged(stored), record=stored)
    rested = stored.provenance.judgement
    other = changed(None if rested is None else rested.parts, job.judgement.parts, JUDGED)
    if (copy := found.copied) is not None and copy.original not in campaign.update.baselines:
        job_there = campaign.jobs.get(copy.original)
        # As long as the original cannot be read, nothing shows that it is another measurement now.
        gone = job_there is not None and not all(file.is_file() for file in job_there.all_files)
        if not gone and (job_there is None or measured(campaign, copy.original) != copy.content):
            found, other = replace(found, original=copy.original), other or f"changed: the measurement of {copy.original}"
    return found if other is None else _judged(found, folder.parent, other)


def unchanged(stored: JobRecord | None) -> str:
    """Reason for keeping a result: nothing changed; says if Python or its libraries did, which does not count."""
    if stored is None or not of_other_libraries(stored):
        return "nothing changed"
    return "its inputs did not change, but Python or its libraries did; --force identifies it again"


def _outdated(stored: JobRecord, job: JobPlan, folder: Path) -> str | None:
    """Reason why a stored identification is out of date, by its own files and settings; None if it is not."""
    if stored.provenance.identity != job.identity.digest:
        return changed(stored.provenance.parts, job.identity.parts, PARTS) or "it rests on something else"
    return altered(folder, stored)


def _judged(job: JobPlan, output: Path, reason: str) -> JobPlan:
    """Plan of a finished job that is judged anew, or identified again if the stored evidence cannot be read."""
    if job.evidence is not None:
        return replace(job, judge=True, reason=reason)
    try:
        return replace(job, judge=True, reason=reason, evidence=read_evidence(output / job.name))
    except DataError as error:
        return replace(job, run=True, judge=False, reason=f"{reason}; the stored evidence is unusable ({error.problem})")


def _waiting(job: JobPlan, first: Sequence[str], reference: str | None) -> JobPlan:
    """Plan of a finished job for which reference job or baselines (``first``) run before."""
    stored = None if job.record is None else job.record.provenance.rests_on
    if first[0] == reference and (stored is None or stored.reference is None):
        return replace(job, run=True, judge=False, reason=f"identified without {reference}, which runs before it", waits=True)
    unless = f"unless {', '.join(first)}, which runs before it, gives another result"
    # A job that is judged anew in any case keeps that reason.
    return replace(job, reason=job.reason if job.judge else unless, waits=True)


def settled(job: JobPlan, output: Path, now: RestsOn, reference: str | None) -> JobPlan:
    """Plan of a finished job with the present tight states: run again if the reference state differs, judged anew if baselines do."""
    stored = None if job.record is None else job.record.provenance.rests_on
    other = other_reference(stored, now, reference)
    if other is not None:
        return replace(job, run=True, judge=False, reason=other, waits=False)
    anew = other_baselines(stored, now)
    job = replace(job, run=False, waits=False, reason=job.reason if job.judge else unchanged(job.record))
    return job if anew is None else _judged(job, output, anew)


def choose_jobs(campaign: Campaign, wanted: Sequence[str]) -> list[str]:
    """Jobs to run: reference job and baselines first, added if not wanted, then the wanted ones (all if none) in the campaign's order.

    Raises
    ------
    ConfigError
        If a job is unknown, or the campaign has none.
    """
    for name in wanted:
        campaign.require_job(name, "--job")
    if not campaign.jobs:
        raise campaign.error("this campaign has no jobs", "jobs", expected="at least one measurement", hint="add a job: NAME: {frf: file}")
    names = [name for name in campaign.jobs if not wanted or name in wanted]
    reference = campaign.update.reference
    if reference is not None:
        baselines = [name for name in campaign.jobs if name in campaign.update.baselines]
        names = list(dict.fromkeys([reference, *baselines, *names]))
    return names


def of_earlier_files(campaign: Campaign, *, contents: bool = True) -> dict[str, str]:
    """Notes on results, by job, whose file is gone or, with ``contents``, was replaced, or that rest on replaced tight states."""
    return _replaced(campaign, stored_jobs(campaign), contents=contents)


def other_findings(campaign: Campaign, own: Mapping[str, JobFinding]) -> dict[str, JobFinding]:
    """Findings of the jobs beside those of a call, by which copies are recognised: stored ones of present files, and of the same files."""
    if own.keys() >= campaign.jobs.keys():
        return {}
    twins = {content_of(file) or "": name for name in own for file in campaign.jobs[name].all_files}
    stored, found = stored_jobs(campaign), dict[str, JobFinding]()
    earlier = _replaced(campaign, stored, contents=True)
    for name, job in campaign.jobs.items():
        if name in own:
            continue
        twin = next((twins[digest] for file in job.all_files if (digest := content_of(file)) and digest in twins), None)
        if twin is not None:
            found[name] = replace(own[twin], assumed=None)
        elif name in stored and name not in earlier:
            found[name] = stored[name].finding
    return found


def stored_jobs(campaign: Campaign) -> dict[str, Job]:
    """Results and failures that can be read, by job."""
    found = {}
    for name in campaign.jobs:
        with suppress(LrbcError, OSError):
            if (job := read_job(campaign.output, name)) is not None:
                found[name] = job
    return found


def _replaced(campaign: Campaign, stored: Mapping[str, Job], *, contents: bool) -> dict[str, str]:
    found = {}
    for name, record in stored.items():
        files = campaign.jobs[name].all_files
        lacking = [file for file in files if not file.exists()]
        if lacking:
            found[name] = f"{lacking[0].name} no longer exists; the result is that of an earlier measurement"
        elif contents and isinstance(record, JobRecord) and record.provenance.inputs:
            known = set(record.provenance.inputs.values())
            other = next((file.name for file in files if content_of(file) not in known), None)
            if other is not None:
                found[name] = f"{other} is not the file that was identified; the result is that of an earlier measurement (`lrbc update`)"
            elif rested := _rested(campaign, name, record, stored):
                found[name] = f"{rested}; the result is that of earlier tight states (`lrbc update`)"
    return found


def _rested(campaign: Campaign, name: str, record: JobRecord, stored: Mapping[str, Job]) -> str | None:
    """How the tight states that a result rests on differ from the stored ones; None if they do not."""
    reference, names = needs(campaign, name)
    before, tight = record.provenance.rests_on, stored.get(reference or "")
    if before is None or not isinstance(tight, JobRecord):
        return None
    baselines = {other: known for other in names if isinstance(known := stored.get(other), JobRecord)}
    now = rests_on(ComparedWith(tight.state, baselines))
    return other_reference(before, now, reference) or other_baselines(before, now)
