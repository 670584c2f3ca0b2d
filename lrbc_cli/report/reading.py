"""Reads the results of a campaign for the page and the tables."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lrbc_cli.errors import ConfigError, DataError, LrbcError
from lrbc_cli.results.job import Job, JobRecord
from lrbc_cli.results.model import CampaignRecord
from lrbc_cli.results.store import read, read_job
from lrbc_cli.results.tables import require_files


@dataclass(frozen=True)
class Results:
    """The record of a campaign, the results of its jobs in its order, and the errors of those that cannot be read, by job."""

    campaign: CampaignRecord
    jobs: Sequence[Job]
    unreadable: Mapping[str, LrbcError]


def read_results(output: Path, jobs: Sequence[str] | None = None) -> Results:
    """Read the record of the campaign and the results of its jobs.

    A job whose ``result.json`` or tables are damaged, or of two runs, does not hide the others.

    Parameters
    ----------
    output
        The campaign's output folder.
    jobs
        Names of the jobs to read; None: all with results.

    Raises
    ------
    ConfigError
        If a job is named that the campaign does not have, or the output folder cannot be read.
    DataError
        If the record of the campaign is missing or damaged, or no job has results that can be read.
    """
    campaign = read(output / "campaign.json", CampaignRecord)
    if campaign is None:
        raise DataError("no results here", file=output / "campaign.json", hint="run `lrbc update` first; the report only shows its results")
    for name in jobs or ():
        if name not in campaign.jobs:
            near = difflib.get_close_matches(name, campaign.jobs, n=1)
            hint = f"did you mean {near[0]}?" if near else "name one of the campaign's jobs"
            raise ConfigError(
                "no such job in the results", file=output / "campaign.json", expected=", ".join(campaign.jobs), found=name, hint=hint
            )
    results, unreadable = list[Job](), dict[str, LrbcError]()
    for name in [job for job in campaign.jobs if not jobs or job in jobs]:
        try:
            job = read_job(output, name)
            if isinstance(job, JobRecord):
                require_files(output / name, job.provenance.files or {})
            # A job that has not run yet is an error only if it was asked for.
            if job is None and jobs:
                raise DataError("this result file is missing", file=output / name / "result.json", hint=JobRecord.HINT)
        except LrbcError as error:
            unreadable[name] = error
        else:
            results += [] if job is None else [job]
    if not results:
        none = DataError("no job has results yet", file=output, hint="run `lrbc update` first; the report only shows its results")
        raise next(iter(unreadable.values()), none)
    return Results(campaign, results, unreadable)
