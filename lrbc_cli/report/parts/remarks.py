"""Section of the page on what qualifies the verdicts: validity, nuisance parameters, noise, misfits, notes on jobs."""

from __future__ import annotations

from collections.abc import Sequence

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.html import Cell, Markup, details, table, tag
from lrbc_cli.report.parts.tables import misfit_table, names_of
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.model import CampaignRecord
from lrbc_cli.results.nuisances import Estimate
from lrbc_cli.updating.misfit.nuisances import title_of

UNEXPLAINED = "the model does not explain the measurement: no verdict"
UNVALIDATED = "not validated: the verdicts stand, but are no all-clear (reason: see the sentence of the job, or “Confidence and notes”)"
_OUTCOMES = {True: ("passed", "passed"), False: ("NOT passed", "failed"), None: ("not validated", "stopped")}
_COLUMNS = (
    "Validation channels: responses that the fit did not use. If the updated model reproduces them within the limit, it is trusted. "
    "Scatter: standard deviation of the remaining difference in level on one line. Lines per independent line: neighbouring lines share "
    "errors, so this many lines count as one. Validation over used: how much worse the model reproduces the validation channels than the "
    "channels used (1: no worse); intervals and verdicts allow for errors of this many times the scatter."
)
#: Tables of notes with more rows than this are folded away.
_MANY = 12


def remarks_parts(campaign: CampaignRecord, jobs: Sequence[JobRecord]) -> list[Markup | None] | None:
    """Return the parts of the section; None if there are none."""
    parts = [
        _validity(jobs),
        tag("p", _COLUMNS, class_="meta") if jobs else None,
        misfit_table(campaign, jobs),
        _nuisances(jobs),
        _job_notes(jobs),
    ]
    return parts if any(part is not None for part in parts) else None


def _validity(jobs: Sequence[JobRecord]) -> Markup | None:
    if not jobs:
        return None
    rows: list[list[str | Cell]] = []
    for job in jobs:
        check, noise = job.validity, job.noise
        outcome: str | Cell = fmt.MISSING
        if check is not None:
            words, look = _OUTCOMES[check.passed]
            outcome = Cell(tag("span", words, class_=f"badge {look}"))
        rows.append(
            [
                job.job,
                outcome,
                Cell(fmt.MISSING if check is None else check.reason or fmt.MISSING, class_="words"),
                fmt.fixed(None if check is None else check.held_out_db),
                fmt.fixed(None if check is None else check.limit_db),
                fmt.fixed(noise.sigma_db),
                fmt.figures(noise.correlation_factor),
                fmt.figures(noise.validation_ratio),
            ]
        )
    head: list[str | Cell] = [
        "Job",
        "Validation",
        "What was compared",
        Cell("Validation", tag("br"), "channels [dB]"),
        "Limit [dB]",
        Cell("Scatter [dB]", title="standard deviation of the residuals, the basis of the confidence"),
        Cell(
            "Lines per",
            tag("br"),
            "independent line",
            title="number of lines over their effective sample size: neighbouring lines share errors, so this many count as one",
        ),
        Cell(
            "Validation",
            tag("br"),
            "over used",
            title="misfit of the validation channels over that of the channels used, at least 1: errors are this many times the scatter",
        ),
    ]
    return table("Model validation: misfit and its limit, and the basis of the confidence", head, rows, text_columns=3)


def _nuisances(jobs: Sequence[JobRecord]) -> Markup | None:
    shown = {job.job: found for job in jobs if (found := _estimates(job))}
    if not shown:
        return None
    keys = list(dict.fromkeys(key for found in shown.values() for key in found))
    head: list[str | Cell] = ["Job", *(Cell(title, tag("br"), tag("small", of or "\u00a0")) for title, of in keys)]
    rows: list[list[str | Cell]] = [[job, *(_nuisance(found.get(key)) for key in keys)] for job, found in shown.items()]
    caption = "Nuisance parameters (estimated with the other parameters), ± standard deviation"
    return table(caption, head, rows, class_="misfits")


def _estimates(job: JobRecord) -> dict[tuple[str, str], Estimate]:
    """Nuisance parameters of a job by title, and by response or direction."""
    return {(title_of(key), of): entry for key, of, entry in job.nuisances.entries()}


def _nuisance(entry: Estimate | None) -> str:
    if entry is None:
        return fmt.MISSING
    return fmt.fixed(entry.value) + ("" if entry.std is None else f" ± {fmt.fixed(entry.std)}")


def _job_notes(jobs: Sequence[JobRecord]) -> Markup | None:
    where: dict[str, list[str]] = {}
    for job in jobs:
        for note in job.notes:
            where.setdefault(note, []).append(job.job)
    if not where:
        return None
    rows = [["all" if 1 < len(found) == len(jobs) else names_of(found), note] for note, found in where.items()]
    made = table("Notes on jobs", ["Jobs", "Note"], rows, text_columns=2, class_="notes")
    return made if len(rows) <= _MANY else details(f"Notes on jobs ({len(rows)})", made)
