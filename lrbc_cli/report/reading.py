"""Reads the results of a campaign for the page and the tables."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path

from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.results.job import Job, JobRecord
from lrbc_cli.results.model import CampaignRecord
from lrbc_cli.results.store import read, read_job


def read_results(output: Path, jobs: Sequence[str] | None = None) -> tuple[CampaignRecord, list[Job]]:
    """Read the record of the campaign and the results of its jobs, in the order of the campaign.

    Parameters
    ----------
    output
        The campaign's output folder.
    jobs
        Names of the jobs to read; None: all with results.

    Raises
    ------
    ConfigError
        If a job is named that the campaign does not have.
    DataError
        If a file is missing or damaged, or no job has results.
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
    wanted = [job for job in campaign.jobs if not jobs or job in jobs]
    # A job that has not run yet is an error only if it was asked for.
    present = [job for job in wanted if jobs or (output / job / "result.json").exists()]
    if not present:
        raise DataError("no job has results yet", file=output, hint="run `lrbc update` first; the report only shows its results")
    results = [read_job(output, job) for job in present]
    for name, job in zip(present, results, strict=True):
        if job is None:
            raise DataError("this result file is missing", file=output / name / "result.json", hint=JobRecord.HINT)
    return campaign, [job for job in results if job is not None]
