"""What a job found, as one line for people: on the terminal, at the top of the page, to a hook of ``lrbc watch``."""

from __future__ import annotations

from lrbc_cli.results.job import FailedJob, Job
from lrbc_cli.updating.judging.clearance import sentence


def job_sentence(record: Job) -> str:
    """``bolts-04: B08 to B10 loose, B11 probably; 9 tight``; of a failed job the first line of its reason."""
    if isinstance(record, FailedJob):
        return f"{record.job}: failed: {(record.reason.strip() or 'no reason given').splitlines()[0]}"
    return f"{record.job}: {sentence(record.finding)}"
