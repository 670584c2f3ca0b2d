"""Writes ``campaign.csv``, one row for each job that has a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from lrbc_cli.errors import DataError, on_one_line
from lrbc_cli.results.job import FailedJob, Job, JobRecord
from lrbc_cli.results.store import read_job
from lrbc_cli.results.tables import write_csv
from lrbc_cli.updating.judging.clearance import across, sentence

CAMPAIGN_COLUMNS = [
    "job",
    "status",
    "loose",
    "loose_probability",
    "undecided",
    "outside",
    "removed",
    "damping_exponent",
    "damping_factor",
    "misfit_initial_db",
    "misfit_final_db",
    "held_out_misfit_final_db",
    "frac_initial",
    "frac_final",
    "cost_initial",
    "cost_final",
    "iterations",
    "evaluations",
    "line_evaluations",
    "seconds",
    "reason",
    "finding",
]


def write_table(output: Path, jobs: Sequence[str], known: Mapping[str, JobRecord]) -> None:
    """Write ``campaign.csv``, one row for each job that has a result or failed.

    Parameters
    ----------
    output : Path
    jobs : sequence of str
    known : mapping
        Results in memory, by job; others are read.
    """
    rows: list[list[str | float | None]] = []
    found: dict[str, Job] = {}
    for name in jobs:
        with suppress(DataError):
            if (stored := known.get(name) or read_job(output, name)) is not None:
                found[name] = stored
    again = across({name: job.finding for name, job in found.items()})
    for name, job in found.items():
        if isinstance(job, FailedJob):
            rows.append([name, "failed", *[None] * (len(CAMPAIGN_COLUMNS) - 4), on_one_line(job.reason), sentence(job.finding)])
        if not isinstance(job, JobRecord):
            continue
        damped, misfit, correlation = job.damped.values(), job.misfit_db, job.correlation
        rows.append(
            [
                name,
                job.status,
                " ".join(job.names("loose")),
                _probabilities(job),
                " ".join(job.names("undecided")),
                " ".join(job.names("outside")),
                " ".join(job.removed or ()),
                " ".join(f"{group.damping_exponent:.6g}" for group in damped),
                " ".join(f"{group.damping_factor:.6g}" for group in damped),
                misfit.initial,
                misfit.final,
                misfit.held_out_final,
                None if correlation is None else correlation.frac_initial,
                None if correlation is None else correlation.frac_final,
                job.cost.initial,
                job.cost.final,
                job.iterations,
                job.evaluations,
                job.line_evaluations,
                job.seconds["total"],
                on_one_line(job.reason),
                "; ".join([sentence(job.finding), *([again[name]] if name in again else [])]),
            ]
        )
    write_csv(output / "campaign.csv", CAMPAIGN_COLUMNS, rows)


def _probabilities(job: JobRecord) -> str:
    """Probabilities of the loose bolts, in the order of their names; empty if none has one."""
    known = [bolt.probability_loose for bolt in job.bolts if bolt.verdict == "loose"]
    return " ".join("-" if p is None else f"{p:.3g}" for p in known) if any(p is not None for p in known) else ""
