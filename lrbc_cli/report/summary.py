"""The summary of results on the terminal: a table and one sentence for each job."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from lrbc_cli.errors import listing
from lrbc_cli.report.reading import read_results
from lrbc_cli.results.job import FailedJob, Job, JobRecord
from lrbc_cli.updating.judging.clearance import JobFinding, sentence
from lrbc_cli.updating.judging.rule import probably


def summary_text(output: Path, jobs: Sequence[str] | None = None) -> str:
    """Return ``summary_of`` stored results, then the reasons of failures.

    Parameters
    ----------
    output
        The campaign's output folder.
    jobs
        Names of the jobs to show; None: all with results that can be read.

    Raises
    ------
    ConfigError, DataError
        As ``read_results``.
    """
    results = read_results(output, jobs).jobs
    failed = [job for job in results if isinstance(job, FailedJob)]
    reasons = [f"{job.job} failed: {job.reason or 'no reason given'}" for job in failed]
    return "\n".join([*_lines({job.job: job for job in results}, told=[job.job for job in failed]), *reasons])


def summary_of(jobs: Mapping[str, Job | None]) -> str:
    """Return a table with a line for each job (status, loose bolts, damping exponent, misfit, evaluations, seconds), then sentences.

    Parameters
    ----------
    jobs
        Results by job; None for one that failed in this call, whose stored result may be an earlier one.
    """
    return "\n".join(_lines(jobs))


def _lines(jobs: Mapping[str, Job | None], told: Sequence[str] = ()) -> list[str]:
    """Lines of the table, and a sentence for each job that is not ``told`` otherwise."""
    head = ["job", "status", "loose bolts", "p_damp", "misfit [dB]", "evaluations", "seconds"]
    right = [False, False, False, True, True, True, True]
    rows = [_row(name, job) for name, job in jobs.items()]
    keep = [column for column in range(len(head)) if any(row[column] for row in rows)]
    widths = {column: max(len(head[column]), *(len(row[column]) for row in rows)) for column in keep}
    lines = []
    for row in [head, *rows]:
        cells = [row[column].rjust(widths[column]) if right[column] else row[column].ljust(widths[column]) for column in keep]
        lines.append("  ".join(cells).rstrip())
    for name, job in jobs.items():
        if name not in told:
            lines.append(f"{name}: {sentence(JobFinding(status='failed') if job is None else job.finding)}")
    return lines


def _row(name: str, job: Job | None) -> list[str]:
    if not isinstance(job, JobRecord):
        return [name, "failed", "", "", "", "", ""]
    return [
        job.job,
        job.status,
        _verdicts(job),
        ", ".join(f"{group.damping_exponent:.2f}" for group in job.damped.values()),
        f"{job.misfit_db.initial:.2f} -> {job.misfit_db.final:.2f}",
        str(job.evaluations),
        f"{job.seconds['total']:.1f}",
    ]


def _verdicts(job: JobRecord) -> str:
    if not job.bolts:
        return ""
    if not job.explained:
        nearest = job.finding.nearest
        first = f"check {listing(nearest, 4)} first" if nearest else "not explained by the model"
        return f"no verdict: {first}"
    known = [bolt.probability_loose for bolt in job.bolts if bolt.verdict == "loose" and bolt.probability_loose is not None]
    undecided = job.names("undecided")
    # The lowest of the probabilities holds as a lower limit for all loose bolts.
    notes = [f"p >= {math.floor(1000 * min(known)) / 1000:.3g}"] if known else []
    likely = [bolt.name for bolt in job.bolts if bolt.verdict == "undecided" and probably(bolt.probability_loose)]
    also = f"probably {_short(likely, 4)}" if likely else ""
    notes += [also] if also and job.names("loose") else []
    rest = len(undecided) - len(likely)
    notes += [f"{rest} {('others ' if rest > 1 else 'other ') if likely else ''}inconclusive"] if rest else []
    return (_short(job.names("loose")) or also or "none found") + (f" ({'; '.join(notes)})" if notes else "")


def _short(names: Sequence[str], limit: int = 6) -> str:
    return ", ".join(names) if len(names) <= limit else f"{len(names)}: " + ", ".join(names[:limit]) + ", ..."
