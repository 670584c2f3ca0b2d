"""Tables of the page: verdicts, bolts, misfit by response, starts of the optimiser, cost."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.html import Cell, Markup, details, table, tag
from lrbc_cli.results.job import Bolt, FailedJob, Job, JobRecord, ResponseMisfit
from lrbc_cli.results.model import CampaignRecord, ReductionRecord
from lrbc_cli.updating.judging.clearance import ranges

#: Numbers of the paper (Table 4 and Sec. 4.5): seconds on its laptop, and line evaluations for four removed bolts.
PAPER = {"full_line": 0.206, "reduced_line": 0.00239, "basis": 417.82, "projection": 100.95, "total": 575.58, "evaluations": 23762.0}
PAPER["full_total"] = PAPER["evaluations"] * PAPER["full_line"]
#: Tables with more rows than this are folded away, except that of the verdicts.
_LONG = 40
#: Sign of a bolt that is outside: not covered by the identified terms.
NOT_COVERED = "n/c"
_MARKS = {"loose": "✕", "undecided": "?", "tight": "·", "outside": NOT_COVERED}
#: Words for verdicts that differ from those in the result files.
WORDS = {"undecided": "inconclusive"}
#: Meaning of the probability of a bolt; that of any change is in the result files only.
OF_LOOSE = "posterior probability of being loose (change below the threshold)"
#: Explanation of two columns.
COMPUTED = "how often the FRFs of the model were computed on all lines until the best fit was found"
DAMPING = "exponent p_damp of eq. (33): the springs are damped 10^p_damp times as much as stated in the campaign file"


def status_badge(job: Job) -> Markup:
    """Return the status as a small coloured word."""
    return tag("span", job.status, class_=f"badge {job.status}", title=job.reason or None)


def loose_of(job: JobRecord) -> str:
    """Return a text with the number of loose bolts among those that a term reaches, and of inconclusive and outside bolts."""
    counts = [(len(job.names("undecided")), WORDS["undecided"]), (len(job.bolts) - len(job.observable), "outside")]
    return ", ".join([f"{len(job.names('loose'))} of {len(job.observable)} judged loose", *(f"{n} {what}" for n, what in counts if n)])


def names_of(names: Sequence[str], order: Sequence[str] = ()) -> str:
    """Return a list of names as text, preceded by their number if there are many.

    Parameters
    ----------
    names
        Names to list.
    order
        Order of the names; three or more neighbours in it with consecutive numbers are written as a range.
    """
    if not names:
        return "none"
    return listed(names, order) if len(names) <= 2 else f"{len(names)}: {listed(names, order)}"


def listed(names: Sequence[str], order: Sequence[str] = ()) -> str:
    """Return a list of names as text without their number; see `names_of`."""
    place = {name: index for index, name in enumerate(order)}
    return ", ".join(part for part, _ in ranges(sorted(names, key=lambda name: place.get(name, len(place))), "–"))


def verdict_table(campaign: CampaignRecord, jobs: Sequence[Job], anchors: Mapping[str, str]) -> Markup:
    """Return a table with a row for each job: verdicts, misfit and cost."""
    done = [job for job in jobs if isinstance(job, JobRecord)]
    bolts = any(job.bolts for job in done)
    known = any(job.removed is not None for job in done)
    damped = any(job.damped for job in done)
    head: list[str | Cell] = ["Job", "Status"]
    head += ["Judged loose"] if bolts else []
    head += ["Inconclusive"] if bolts else []
    outside = any(bolt.outside for job in done for bolt in job.bolts)
    head += [Cell("Outside", tag("br"), tag("small", "not observable"))] if outside else []
    head += ["Known removed"] if known else []
    words = len(head)
    head += [Cell("Damping", tag("br"), "p_damp (factor)", title=DAMPING)] if damped else []
    head += [
        Cell("Misfit, channels", tag("br"), "used [dB]", title="mean absolute difference of measured and computed levels"),
        Cell("Misfit, validation", tag("br"), "channels [dB]", title="the same for channels that the fit did not use"),
        Cell("FRFs", tag("br"), "computed", title=COMPUTED),
        "Time",
    ]
    rows: list[list[str | Cell]] = []
    for job in jobs:
        title: list[str | None] = [tag("a", job.job, href=f"#{anchors[job.job]}") if job.job in anchors else job.job]
        if job.job == campaign.reference:
            title.append(tag("small", " reference"))
        doubt = None if isinstance(job, FailedJob) or job.validated else tag("span", "not validated", class_="badge stopped")
        row: list[str | Cell] = [Cell(*title), Cell(status_badge(job), " " if doubt else None, doubt)]
        if isinstance(job, FailedJob):
            rows.append([*row, Cell(job.reason or "no reason given", class_="reason", span=len(head) - 2)])
            continue
        row += _loose_cells(campaign, job) if bolts else []
        if outside:
            beyond = job.names("outside")
            row.append(Cell(names_of(beyond, campaign.bolt_names), class_="names none"))
        if known:
            row.append(
                Cell(
                    fmt.MISSING if job.removed is None else names_of(job.removed, campaign.bolt_names),
                    class_="names none" if not job.removed else "names",
                )
            )
        if damped:
            pairs = [f"{fmt.fixed(group.damping_exponent)} ({fmt.figures(group.damping_factor)})" for group in job.damped.values()]
            row.append(", ".join(pairs) or fmt.MISSING)
        row += [
            fmt.change(job.misfit_db.initial, job.misfit_db.final),
            validation_misfit(job),
            fmt.count(job.evaluations),
            fmt.seconds(job.seconds["total"]),
        ]
        rows.append(row)
    return table("Results job by job; misfits before → after updating", head, rows, class_="verdicts", text_columns=words)


def _loose_cells(campaign: CampaignRecord, job: JobRecord) -> list[str | Cell]:
    """Cells with the bolts judged loose, and the inconclusive ones."""
    if not job.explained:
        return [Cell(job.sentence.removeprefix(f"{job.job}: "), class_="reason"), fmt.MISSING]
    if not job.bolts:
        return [fmt.MISSING, fmt.MISSING]
    loose, undecided = job.names("loose"), job.names("undecided")
    return [
        Cell(names_of(loose, campaign.bolt_names), class_="names loose" if loose else "names none"),
        Cell(names_of(undecided, campaign.bolt_names), class_="names" if undecided else "names none"),
    ]


def validation_misfit(job: JobRecord) -> str:
    """Return the misfit of the validation channels, before → after."""
    unseen = [entry for entry in job.misfit_db.responses.values() if not entry.used and math.isfinite(entry.initial + entry.final)]
    if not unseen:
        return fmt.MISSING
    return fmt.change(float(np.mean([entry.initial for entry in unseen])), float(np.mean([entry.final for entry in unseen])))


def fold(made: Markup, title: str, rows: int) -> Markup:
    """Return a table, folded away if it is long."""
    return made if rows <= _LONG else details(f"{title} ({rows} rows)", made)


def bolt_table(job: JobRecord) -> Markup | None:
    """Return a table with a row for each bolt (verdict, probability, change, true state), and its notes; None without bolts."""
    if not job.bolts:
        return None
    bolts = job.bolts
    sure, known = (any(getattr(bolt, key) is not None for bolt in bolts) for key in ("probability_loose", "removed"))
    changes = any(bolt.change is not None for bolt in bolts)
    notes: dict[str, list[str]] = {}
    columns = {
        "Verdict": True,
        "Probability of being loose": sure,
        "log10 stiffness": not changes,
        "Change, 95 % interval [decades]": changes,
        "Loose from": any(bolt.threshold is not None for bolt in bolts),
        "Known": known,
    }
    rows: list[list[str | Cell]] = []
    for bolt in bolts:
        verdict = bolt.verdict if job.explained or bolt.outside else "no verdict"
        cells: list[str | Cell] = [
            Cell(
                tag("b", _MARKS.get(verdict, "–"), aria_hidden="true"),
                " ",
                WORDS.get(verdict, verdict),
                class_=f"verdict {verdict}" if verdict in _MARKS else "verdict none",
            ),
            fmt.probability(bolt.probability_loose if job.explained else None),
            fmt.fixed(bolt.log10_stiffness),
            change_text(bolt),
            fmt.MISSING if bolt.threshold is None else fmt.signed(bolt.threshold, 2),
            {True: "removed", False: "in place", None: fmt.MISSING}[bolt.removed],
        ]
        rows.append([bolt.name, *(cell for cell, kept in zip(cells, columns.values(), strict=True) if kept)])
        if bolt.note:
            notes.setdefault(bolt.note, []).append(bolt.name)
    head = ["Bolt", *(name for name, kept in columns.items() if kept)]
    order = [bolt.name for bolt in bolts]
    said = [tag("li", f"{listed(names, order)}: {note}") for note, names in notes.items()]
    made = table(f"Bolts of {job.job}", head, rows, class_="bolts", text_columns=2)
    return tag("div", made, tag("ul", *said, class_="notes") if said else None, class_="judged")


def change_text(bolt: Bolt) -> str:
    """Return the change of a bolt with its 95 % interval [decades]."""
    if bolt.change is None:
        return fmt.MISSING
    sides = bolt.change_interval95
    if sides is None:
        return fmt.signed(bolt.change, 2)
    low, high = (fmt.signed(side, 2) if math.isfinite(side) else "open" for side in sides.tolist())
    return f"{fmt.signed(bolt.change, 2)} ({low} to {high})"


def sentence(bolt: Bolt) -> str:
    """Return everything that is known and was found about a bolt in one line."""
    truth = {True: "known to be removed", False: "known to be in place", None: ""}[bolt.removed]
    words = [f"{bolt.name}: {WORDS.get(bolt.verdict, bolt.verdict)}"]
    if bolt.outside:
        return ", ".join(word for word in (*words, "not observable", truth, bolt.note) if word)
    if bolt.probability_loose is not None:
        words.append(f"{OF_LOOSE} {fmt.probability(bolt.probability_loose)}")
    words += [truth, f"log10 stiffness {fmt.fixed(bolt.log10_stiffness)}"]
    if bolt.change is not None:
        limit = "" if bolt.threshold is None else f" (loose from {fmt.signed(bolt.threshold, 2)})"
        words.append(f"change {change_text(bolt)} decades{limit}")
    words.append(bolt.note or "")
    return ", ".join(word for word in words if word)


def hits(jobs: Iterable[JobRecord]) -> str | None:
    """Return how the verdicts agree with the true states, in jobs that are not assumed to be tight; None if none is known."""
    told = [job for job in jobs if job.explained and job.taken_as_tight is None]
    bolts = [bolt for job in told for bolt in job.bolts if bolt.removed is not None]
    removed: list[str] = [bolt.verdict for bolt in bolts if bolt.removed]
    tight: list[str] = [bolt.verdict for bolt in bolts if not bolt.removed]
    if not bolts:
        return None
    parts = []
    for verdicts, what, right, wrong in ((removed, "removed", "loose", "tight"), (tight, "in place", "tight", "loose")):
        seen = len(verdicts) - verdicts.count("outside")
        if seen:
            good, plural = verdicts.count(right), "" if seen == 1 else "s"
            judged = f"{good} {'is' if good == 1 else 'are'} judged {right}"
            others = f"{verdicts.count('undecided')} inconclusive, {verdicts.count(wrong)} {wrong}."
            parts.append(f"Of {seen} bolt{plural} known to be {what}, {judged}, {others}")
    outside = (removed + tight).count("outside")
    if outside:
        parts.append(f"Outside (not observable): {outside}.")
    return " ".join(parts)


def misfit_table(campaign: CampaignRecord, jobs: Sequence[JobRecord]) -> Markup | None:
    """Return the misfit of every response and job; None if no job has any."""
    shown = [job for job in jobs if job.misfit_db.responses]
    names = list(
        dict.fromkeys([*(entry.name for entry in campaign.responses), *(name for job in shown for name in job.misfit_db.responses)])
    )
    if not shown or not names:
        return None
    head: list[str | Cell] = ["Job"]
    for name in names:
        used = any(job.misfit_db.responses[name].used for job in shown if name in job.misfit_db.responses)
        head.append(Cell(name, None if used else tag("small", " validation")))
    rows: list[list[str | Cell]] = []
    for job in shown:
        rows.append([job.job, *(_misfit_cell(job.misfit_db.responses.get(name)) for name in names)])
    caption = "Mean absolute misfit over all lines of the band, before → after [dB]"
    return fold(table(caption, head, rows, class_="misfits"), caption, len(rows))


def _misfit_cell(entry: ResponseMisfit | None) -> Cell:
    if entry is None:
        return Cell(fmt.MISSING)
    return Cell(fmt.change(entry.initial, entry.final), class_=None if entry.used else "unseen")


def starts_table(jobs: Sequence[JobRecord]) -> Markup | None:
    """Return a row for each job: the start that was kept, its cost, and the ends of the others; None if no job has them."""
    rows: list[list[str | Cell]] = []
    for job in jobs:
        kept = next((start for start in job.optimiser.starts if start.kept), None)
        if kept is None:
            continue
        others = sorted(start.cost for start in job.optimiser.starts if not start.kept and math.isfinite(start.cost))
        rows.append(
            [
                job.job,
                kept.description,
                fmt.change(job.cost.initial, kept.cost, 3),
                fmt.count(len(job.optimiser.starts)),
                Cell(f"{fmt.fixed(others[0], 3)} to {fmt.fixed(others[-1], 3)}" if others else fmt.MISSING),
                fmt.count(job.evaluations),
            ]
        )
    head: list[str | Cell] = [
        "Job",
        "Starting point that led to the best fit",
        Cell(
            "Cost",
            tag("br"),
            "before → after",
            title="how badly computed FRFs fit the measured ones, eq. (29) of the paper: lower is better",
        ),
        Cell("Starting", tag("br"), "points", title="number of starting points tried"),
        Cell(
            "Cost from the",
            tag("br"),
            "other starts",
            title="near the cost of the best fit: the same state again, or another that fits as well",
        ),
        Cell("FRFs", tag("br"), "computed", title=COMPUTED),
    ]
    return (
        table("Best fit of each job, and cost reached from the other starting points", head, rows, text_columns=2, class_="notes")
        if rows
        else None
    )


@dataclass(frozen=True, kw_only=True)
class Account:
    """Time spent on some jobs including the reduction, and the time that the full model would have taken; None if unknown."""

    jobs: int
    line_evaluations: float
    spent: float
    full: float | None

    @property
    def speed_up(self) -> float | None:
        """Ratio of the time of the full model to the time spent."""
        return None if self.full is None or not self.spent else self.full / self.spent


def account(jobs: Sequence[Job], reduction: ReductionRecord | None) -> Account | None:
    """Sum of the times of the jobs that state them; None if none does."""
    done = [job for job in jobs if isinstance(job, JobRecord) and job.line_evaluations]
    if not done:
        return None
    evaluations = sum(job.line_evaluations for job in done)
    seconds = reduction.seconds if reduction else {}
    line = seconds.get("full_line")
    spent = seconds.get("total", 0.0) + sum(job.seconds["total"] for job in done)
    return Account(jobs=len(done), line_evaluations=evaluations, spent=spent, full=None if line is None else line * evaluations)


def cost_table(jobs: Sequence[Job], reduction: ReductionRecord | None, *, paper: bool) -> Markup | None:
    """Return times compared with the full model, in seconds and in full lines, with those of the paper (Table 4) if `paper`, or None."""
    whole = account(jobs, reduction)
    if reduction is None and whole is None:
        return None
    spent = reduction.seconds if reduction else {}
    line = spent.get("full_line")
    rows: list[list[str | Cell]] = []

    def row(title: str | Cell, own: Sequence[str | Cell], stated: Sequence[str]) -> None:
        rows.append([title, *own, *(stated if paper else ())])

    def time(text: str | Cell, own: float | None, stated: float | None = None) -> None:
        if reduction is None and own is None:
            return
        share = own / line if own is not None and line else None
        stated_share = None if stated is None else stated / PAPER["full_line"]
        row(text, [fmt.seconds(own), fmt.inverse(share)], [fmt.seconds(stated), fmt.inverse(stated_share)])

    def part(title: str, note: str, own: Account, stated: Mapping[str, float]) -> None:
        rows.append([Cell(title, tag("small", f" {note}"), class_="part", span=5 if paper else 3)])
        row("Line evaluations", [fmt.count(own.line_evaluations), ""], [fmt.count(stated.get("evaluations")), ""])
        time("Reduced model, reduction included" if reduction else "Identification alone", own.spent, stated.get("total"))
        time(Cell("Full model", tag("small", " evaluations × full line")), own.full, stated.get("full_total"))
        if own.speed_up is None:
            return
        factor = stated["full_total"] / stated["total"] if stated else None
        row("Speed-up", [Cell(fmt.factor(own.speed_up), class_="strong"), ""], [fmt.factor(factor), ""])

    time("One frequency line, full model", line, PAPER["full_line"])
    time("One frequency line, reduced model", spent.get("reduced_line"), PAPER["reduced_line"])
    time("One frequency line, interface FRFs", spent.get("port_line"))
    time("Computation of the reduced basis", spent.get("basis"), PAPER["basis"])
    time("Projection", spent.get("projection"), PAPER["projection"])
    time("Verification: measured error", spent.get("certificate"))
    time("Reduction, total", spent.get("total"), PAPER["basis"] + PAPER["projection"])
    if whole is not None:
        hardest = max((job for job in jobs if isinstance(job, JobRecord)), key=lambda job: job.line_evaluations)
        one = account([hardest], reduction) or whole
        note = f"{hardest.job}, the job with the most line evaluations" + ("; paper: four bolts removed" if paper else "")
        part("One job", note, one, PAPER)
        part("Whole campaign", f"{whole.jobs} job{'' if whole.jobs == 1 else 's'}", whole, {})
    head = ["What", "This campaign", "in full lines", *(["Paper", "in full lines"] if paper else [])]
    return table("Times compared with the full model", head, rows, class_="cost")
