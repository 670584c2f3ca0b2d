"""Progress of a campaign for ``lrbc status``: state of each job, last errors, and estimated time left. Reads files only."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any

from lrbc_cli.campaign.beside import passed_over
from lrbc_cli.campaign.digests import content_of
from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.jobs.plans import JobPlan, choose_jobs, needs, plan, stored_jobs
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.memory import reduction_cost
from lrbc_cli.config import Campaign
from lrbc_cli.errors import DataError, LrbcError, NumericalError, on_one_line
from lrbc_cli.results.job import FailedJob, Job, JobRecord
from lrbc_cli.results.model import ReductionRecord
from lrbc_cli.results.store import read, read_job
from lrbc_cli.updating.judging.clearance import sentence

#: Keys of a campaign file on which no result depends.
_ABOUT = ("campaign", "output", "description", "test_article", "operator", "compare_with", "watch")

#: States of a job, and the words shown for them.
STATES = {
    "done": "done",
    "stale": "out of date",
    "missing": "no FRF file",
    "unusable": "unusable",
    "failed": "failed",
    "new": "not run yet",
}


@dataclass(frozen=True)
class JobStatus:
    """State of a job.

    Attributes
    ----------
    state : str
        One of ``STATES``.
    reason : str
        Which part changed, which file is missing, why its files cannot be used, or the last error; the finding of a job that is done.
    seconds : float or None
        Duration of its last identification.
    """

    state: str
    reason: str
    seconds: float | None = None


@dataclass(frozen=True)
class CampaignStatus:
    """State of a campaign.

    Attributes
    ----------
    jobs : dict of JobStatus
        In the campaign's order.
    seconds_left : float or None
        Estimated duration of the jobs that `lrbc update` would run, reduction included; None if it cannot be estimated yet.
    cache : CacheDecision
    page : str
        Fault of ``report.html``: missing, or older than results; empty if there is none.
    passed_over : list of str
        Notes on files in the watched folder that belong to no job.
    """

    jobs: dict[str, JobStatus]
    seconds_left: float | None
    cache: cache.CacheDecision
    page: str = ""
    passed_over: list[str] = field(default_factory=list)

    def named(self, *states: str) -> list[str]:
        """Names of the jobs in one of these states."""
        return [name for name, job in self.jobs.items() if job.state in states]


def status(inputs: Inputs, folder: Path) -> CampaignStatus:
    """State of a campaign; changes no files and identifies nothing.

    Parameters
    ----------
    inputs : Inputs
        With the stored calibration, if it fits.
    folder : Path
        Folder of the cache of reduced models.
    """
    parts, campaign = cache.key_parts(inputs), inputs.campaign
    decision = cache.look_up(folder, parts)
    plans = {p.name: p for p in plan(inputs, parts, choose_jobs(campaign, ()))} if campaign.jobs else {}
    jobs = {name: _status(inputs, plans[name]) for name in campaign.jobs}
    found = CampaignStatus(jobs, None, decision, _page(inputs), passed_over(campaign))
    ahead = len(found.named("new", "failed")) + sum(plans[name].run or plans[name].waits for name in found.named("stale"))
    known = [job.seconds for job in jobs.values() if job.seconds is not None]
    if not ahead:
        return replace(found, seconds_left=0.0)
    reduction = 0.0 if decision.hit or inputs.method.full_order else _reduction_seconds(inputs)
    left = None if not known or reduction is None else reduction + ahead * median(known)
    return replace(found, seconds_left=left)


def of_other_settings(campaign: Campaign, read_model: Callable[[], Inputs]) -> dict[str, str]:
    """Notes on results, by job, that rest on other settings or another model than the campaign file states now.

    Parameters
    ----------
    campaign : Campaign
    read_model : callable
        Reads the inputs; only called if settings or files differ. Not every difference matters.
    """
    results = {name: record for name, record in stored_jobs(campaign).items() if isinstance(record, JobRecord)}
    others = {name for name, record in results.items() if _differ(campaign, name, record)}
    if not others:
        return {}
    try:
        inputs = read_model()
        plans = plan(inputs, cache.key_parts(inputs), choose_jobs(campaign, ()))
    except (LrbcError, OSError):
        unread = "the campaign file or the model changed since, and the model cannot be read now"
        return dict.fromkeys(sorted(others), unread)
    outdated = (job for job in plans if job.name in others and (job.run or job.judge))
    return {job.name: f"{job.reason}; the result is that of earlier settings (`lrbc update`)" for job in outdated}


def _differ(campaign: Campaign, name: str, record: JobRecord) -> bool:
    """Whether settings, or files of the model, differ from those of a result; its measurement is not looked at."""
    jobs = {name, *filter(None, (needs(campaign, name)[0],)), *needs(campaign, name)[1]}

    def settings(tree: Mapping[str, Any]) -> str:
        own = {key: value for key, value in tree.items() if key not in _ABOUT}
        own["jobs"] = {job: about for job, about in tree.get("jobs", {}).items() if job in jobs}
        return json.dumps(own, sort_keys=True, default=str)

    if settings(record.provenance.configuration) != settings(campaign.resolved()):
        return True
    measured = {file.as_posix() for job in campaign.jobs.values() for file in job.all_files}
    files = {file: known for file, known in record.provenance.inputs.items() if file not in measured}
    return any(content_of(Path(file)) not in (known, None) for file, known in files.items())


def _status(inputs: Inputs, job: JobPlan) -> JobStatus:
    config, output = inputs.campaign.jobs[job.name], inputs.campaign.output
    stored: Job | None = None
    damaged = ""
    try:
        stored = read_job(output, job.name)
    except DataError:
        damaged = job.reason  # the plan says what is wrong with it
    seconds = stored.seconds.get("total") if isinstance(stored, JobRecord) else None
    missing = [str(file) for file in config.all_files if not file.is_file()]
    before = "; there is a result of an earlier measurement" if isinstance(stored, JobRecord) else ""
    if missing:
        return JobStatus("missing", ", ".join(missing) + before, seconds)
    if isinstance(stored, FailedJob):
        return JobStatus("failed", (stored.reason.strip() or "no reason given").splitlines()[0])
    trouble = _unusable(inputs, job) if job.run else None
    if trouble is not None:
        return JobStatus("unusable", trouble + before, seconds)
    if stored is None:
        return JobStatus("new", damaged)
    if not job.kept:
        return JobStatus("stale", job.reason + ("; it is only judged anew" if job.judge and not job.run else ""), seconds)
    return JobStatus("done", sentence(stored.finding), seconds)


def _unusable(inputs: Inputs, job: JobPlan) -> str | None:
    """Reason on one line why the files of a job that is to run cannot be used, as ``lrbc watch`` reports it; else None."""
    try:
        read_measurement(inputs, inputs.campaign.jobs[job.name], job.name)
    except (LrbcError, OSError) as error:
        return on_one_line(error)
    return None


def _page(inputs: Inputs) -> str:
    """Fault of the report by the times of the files; empty if there is none, or without results."""
    output = inputs.campaign.output
    times = {name: time for name in inputs.campaign.jobs if (time := _written(output / name / "result.json"))}
    page = _written(output / "report.html")
    if not times or (page is not None and page >= max(times.values())):
        return ""
    if page is None:
        return "missing"
    return f"older than the results of {', '.join(name for name, time in times.items() if time > page)}"


def _written(file: Path) -> int | None:
    """Time when a file was last written [ns]; None if it does not exist."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return None


def _reduction_seconds(inputs: Inputs) -> float | None:
    """Duration of the reduction [s]: that of the last one, else as predicted; None if neither is known."""
    try:
        before = read(inputs.campaign.output / "reduction.json", ReductionRecord)
        return reduction_cost(inputs)[0].seconds if before is None else float(before.seconds["total"])
    except (DataError, NumericalError, KeyError):
        return None
