"""The page: one self-contained HTML document from what the result files say."""

from __future__ import annotations

import base64
import hashlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.resources import files
from urllib.parse import quote

import numpy as np

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Chart
from lrbc_cli.report.drawing.style import css
from lrbc_cli.report.drawing.svg import legend, own_size, svg
from lrbc_cli.report.files import frf_file
from lrbc_cli.report.html import Cell, Markup, details, figure, join, table, tag
from lrbc_cli.report.parts import tables
from lrbc_cli.report.parts.calibration import calibration_parts, serves
from lrbc_cli.report.parts.certificate import certificate_parts
from lrbc_cli.report.parts.correlation import correlation_parts
from lrbc_cli.report.parts.figures import convergence_charts
from lrbc_cli.report.parts.plan import plan_parts
from lrbc_cli.report.parts.provenance import provenance
from lrbc_cli.report.parts.remarks import UNEXPLAINED, UNVALIDATED, remarks_parts
from lrbc_cli.report.parts.structure import structure_parts
from lrbc_cli.results.job import STATUSES, Job, JobRecord
from lrbc_cli.results.model import CalibrationRecord, CampaignRecord, ReductionRecord
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.results.structure import StructureRecord
from lrbc_cli.results.tables import Frf

#: Profiles beyond this number are folded away.
_PROFILES = 24
#: FRF figures are put into the page up to about this many characters; the others are linked.
_BUDGET = 6_000_000


@dataclass(frozen=True)
class FrfFigure:
    """An FRF chart and whose it is."""

    job: str
    response: str
    used: bool
    chart: Chart


@dataclass(frozen=True)
class Content:
    """Everything that the page shows."""

    campaign: CampaignRecord
    jobs: Sequence[Job]
    reduction: ReductionRecord | None
    profiles: Mapping[str, Chart]
    frfs: Sequence[FrfFigure]
    strip: Chart | None = None
    maps: Mapping[str, Chart] = field(default_factory=dict)
    fdac: Mapping[str, Chart] = field(default_factory=dict)
    calibration: CalibrationRecord | None = None
    calibration_frf: Frf | None = None
    l_curves: Sequence[Chart] = ()
    plan: PlanRecord | None = None
    structure: StructureRecord | None = None

    @property
    def along_edges(self) -> bool:
        """Whether values lie along an edge; else they are those of joints."""
        return any(group.arc_length is not None for job in self.done for group in job.parameters.values())

    @property
    def done(self) -> list[JobRecord]:
        """The jobs that have a result."""
        return [job for job in self.jobs if isinstance(job, JobRecord)]


def render(content: Content, written: datetime | None = None, *, live: bool = False) -> str:
    """Return the whole document.

    Parameters
    ----------
    content
        What to show.
    written
        The time to print; now where None.
    live
        The page loads itself anew while ``lrbc watch`` runs.
    """
    resources = files("lrbc_cli.report")
    scripts = ["page.js", "structure.js", *(["live.js"] if live else [])]
    script = "\n".join(resources.joinpath(name).read_text(encoding="utf-8") for name in scripts)
    sheet = css() + resources.joinpath("page.css").read_text(encoding="utf-8")
    allowed = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{allowed}'; base-uri 'none'; form-action 'none'"
    sections = [part for part in _sections(content) if part is not None]
    links = [tag("li", tag("a", re.split(":| of ", title)[0], href=f"#{anchor}")) for anchor, title, _ in sections]
    name = content.campaign.campaign
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", name="viewport", content_="width=device-width, initial-scale=1"),
        tag("meta", http_equiv="Content-Security-Policy", content_=policy),
        tag("title", f"{name} – boundary conditions identified from FRFs"),
        tag("style", Markup(sheet)),
    )
    body = tag(
        "body",
        _header(content, written or datetime.now().astimezone()),
        tag("nav", tag("ul", *links), aria_label="Parts of this report"),
        tag("main", *(tag("section", tag("h2", title), *parts, id=anchor) for anchor, title, parts in sections)),
        tag(
            "footer",
            f"Written by {_tool(content)} from the result files beside this page; nothing was computed for it anew.",
        ),
        tag("script", Markup(script)),
    )
    return "<!doctype html>\n" + tag("html", head, body, lang="en") + "\n"


_Section = tuple[str, str, list[Markup | None]]


def _sections(content: Content) -> Iterable[_Section | None]:
    done = content.done
    yield _part("structure", "The structure", structure_parts(content.structure, done) if content.structure else None)
    yield _verdicts(content)
    yield _part("remarks", "Confidence and notes", remarks_parts(done))
    yield _profiles(content)
    yield _frfs(content)
    yield _part("correlation", "Correlation", correlation_parts(content.campaign, done, content.fdac))
    if content.calibration is not None:
        yield _part(
            "calibration",
            "Calibration of the reference model",
            calibration_parts(content.calibration, content.calibration_frf, content.campaign),
        )
    if content.plan is not None:
        yield _part("plan", "Plan: what can be seen", plan_parts(content.plan))
    yield _damping(done)
    yield _cost(content)
    yield _convergence(done)
    if content.reduction is not None:
        yield _part("certificate", "Certificate of the reduced model", certificate_parts(content.reduction, content.jobs))
    yield _l_curves(content)
    yield "provenance", "Provenance", provenance(content.campaign, content.jobs, content.reduction)


def _part(anchor: str, title: str, parts: list[Markup | None] | None) -> _Section | None:
    return None if parts is None else (anchor, title, parts)


def _drawn(chart: Chart, **attributes: str | bool | None) -> Markup:
    return figure(svg(chart), chart.title, chart.subtitle, **attributes)


def _header(content: Content, written: datetime) -> Markup:
    reduction = content.reduction
    parts = [f"Report of {written:%d %B %Y, %H:%M %Z}".strip(), _tool(content)]
    if reduction is not None:
        machine = ", ".join(str(reduction.machine[key]) for key in ("processor", "platform") if reduction.machine.get(key))
        cores = reduction.machine.get("cores")
        parts += [f"{machine}, {cores} cores" if cores else machine, f"reduced model of {_date(reduction.date)}" if reduction.date else ""]
    return tag(
        "header",
        tag("p", "Boundary conditions identified from measured FRFs", class_="eyebrow"),
        tag("h1", content.campaign.campaign),
        tag("p", " · ".join(part for part in parts if part), class_="meta"),
        tag("dl", *_tiles(content), class_="tiles"),
    )


def _tool(content: Content) -> str:
    return f"{content.campaign.tool.name} {content.campaign.tool.version}"


def _date(text: str) -> str:
    try:
        return f"{datetime.fromisoformat(text.replace('Z', '+00:00')).astimezone(UTC):%d %B %Y, %H:%M UTC}"
    except ValueError:
        return text


def _tiles(content: Content) -> Iterable[Markup]:
    jobs, reduction = content.jobs, content.reduction
    done = content.done
    states = [f"{count} {state}" for state in STATUSES if (count := sum(job.status == state for job in jobs))]
    yield _tile("Jobs", str(len(jobs)), ", ".join(states))
    if any(job.bolts for job in done):
        assumed = [job.job for job in done if job.taken_as_tight is not None]
        yield _loose([job for job in done if job.job not in assumed], len(jobs) - len(assumed))
    known = [job.misfit_db for job in done if math.isfinite(job.misfit_db.initial)]
    if known:
        value = fmt.change(float(np.mean([entry.initial for entry in known])), float(np.mean([entry.final for entry in known]))) + " dB"
        yield _tile("Mean misfit before → after", value, "over all lines of the band, responses used, jobs")
    if reduction is not None:
        reached = "reached" if reduction.reached else "NOT reached"
        note = f"measured error {fmt.small(reduction.certificate.worst)}, tolerance {fmt.small(reduction.tolerance)} {reached}"
        yield _tile("Degrees of freedom", f"{fmt.count(reduction.full_size)} → {fmt.count(reduction.size)}", note)
    times = tables.account(jobs, reduction)
    if times is not None and times.full is not None:
        note = f"with the full model about {fmt.seconds(times.full)}: {fmt.factor(times.speed_up)}"
        calibration = content.calibration
        if calibration is not None and serves(calibration, content.campaign):
            note += f"; calibration, {fmt.seconds(calibration.seconds)}, not included"
        yield _tile("Time, reduction included", fmt.seconds(times.spent), note)


def _loose(jobs: Sequence[JobRecord], count: int) -> Markup:
    """Jobs with loose bolts among all, and those that may have some: no silence may pass for an all-clear."""
    judged = [job for job in jobs if job.explained and job.observable]
    removed = [bolt for job in judged for bolt in job.observable if bolt.removed]
    counts = (
        (count - len(judged), "without verdict"),
        (sum(not job.validated for job in judged), "not validated"),
        (sum(bool(job.names("undecided")) for job in judged), "with undecided bolts"),
    )
    notes = [f"{count} {what}" for count, what in counts if count]
    if removed:
        found = sum(bolt.verdict == "loose" for bolt in removed)
        notes.append(f"{found} of {len(removed)} observable bolts known to be removed are found")
    loose = sum(bool(job.names("loose")) for job in judged)
    return _tile("Jobs with loose bolts", f"{loose} of {count}" if judged else fmt.MISSING, ", ".join(notes))


def _tile(title: str, value: str, note: str) -> Markup:
    return tag("div", tag("dt", title), tag("dd", value, class_="value"), tag("dd", note, class_="note"), class_="tile")


def _verdicts(content: Content) -> _Section:
    done = content.done
    anchors = {job: f"profile-{index}" for index, job in enumerate(content.profiles)}
    grid = tables.bolt_grid(content.campaign, done)
    parts: list[Markup | None] = []
    unexplained = [job.job for job in done if not job.explained]
    if unexplained:
        parts.append(tag("p", f"{tables.names_of(unexplained)}: {UNEXPLAINED}.", class_="warning"))
    unsure = [job.job for job in done if not job.validated]
    if unsure:
        parts.append(tag("p", f"{tables.names_of(unsure)}: {UNVALIDATED}.", class_="warning"))
    warned = [tag("li", f"{job.job}: {text}") for job in done for text in job.warnings]
    if warned:
        parts.append(tag("ul", *warned, class_="warning"))
    if content.strip is not None:
        hits = tables.hits(done)
        # The picture keeps the size of its letters: it is as wide as its bolts need.
        drawn = tag("div", svg(content.strip), class_="plot strip", style=own_size(content.strip))
        bolts = [bolt for job in done for bolt in job.bolts]
        text = "Each row is a job, each cell a bolt: ✕ judged loose, ? undecided, a dot judged tight"
        text += f", {tables.NOT_COVERED} not covered by the identified terms" if any(bolt.outside for bolt in bolts) else ""
        text += f"; below, the {tables.OF_LOOSE} in per cent." if any(bolt.probability_loose is not None for bolt in bolts) else "."
        parts += [tag("p", text), legend(content.strip), drawn, tag("p", hits) if hits else None]
    parts.append(tables.verdict_table(content.campaign, content.jobs, anchors))
    if content.maps:
        charts = list(content.maps.values())
        key_of_all = legend(replace(charts[0], panels=tuple(panel for chart in charts for panel in chart.panels)))
        maps = [_drawn(chart) for chart in content.maps.values()]
        # Along a straight edge the strip tells the same.
        wide = any(not chart.panels[0].y.ticks for chart in content.maps.values())
        parts.append(
            details(
                f"Maps of the {'edge' if content.along_edges else 'joints'} ({len(maps)})",
                key_of_all,
                tag("div", *maps, class_="grid pairs"),
                open_=not wide and len(maps) <= _PROFILES,
            )
        )
    if grid is not None:
        bolts = [bolt for job in done if job.explained for bolt in job.bolts]
        signs = ["✕ judged loose", "? undecided", "· judged tight"]
        signs += ["framed: known to be removed"] if any(bolt.removed for bolt in bolts) else []
        if any(bolt.outside for bolt in bolts):
            signs.append(f"{tables.NOT_COVERED} outside: no term reaches it, not observable")
        if any(bolt.probability_loose is not None for bolt in bolts):
            signs.append(f"per cent: {tables.OF_LOOSE}")
        signs += ["† see its note"] if any(bolt.note for bolt in bolts if not bolt.outside) else []
        key = [tag("li", text) for text in signs]
        parts.append(details("The figures of each bolt", tag("ul", *key, class_="key"), grid))
    return "verdicts", "Verdicts", parts


def _profiles(content: Content) -> _Section | None:
    if not content.profiles:
        return None
    drawn = [_drawn(chart, id=f"profile-{index}") for index, chart in enumerate(content.profiles.values())]
    first, rest = drawn[:_PROFILES], drawn[_PROFILES:]
    text = "Identified values along the edge, all jobs on one scale (paper, Fig. 6). Bolts stand below the profile"
    if not content.along_edges:
        text = "Identified values of each bolt, all jobs on one scale"
    text += "; stripes mark those that are judged loose or undecided"
    text += ", and those outside, of which nothing is observable." if any(b.outside for job in content.done for b in job.bolts) else "."
    richest = max(content.profiles.values(), key=lambda chart: len(chart.legend()))
    more = details(f"{len(rest)} further profiles", tag("div", *rest, class_="grid profiles")) if rest else None
    kinds = {group.kind for job in content.done for group in job.parameters.values()}
    title = f"Stiffness {'along the edge' if content.along_edges else 'of the joints'}" if kinds == {"stiffness"} else "Identified profiles"
    return "profiles", title, [tag("p", text), legend(richest), tag("div", *first, class_="grid profiles"), more]


def _frfs(content: Content) -> _Section | None:
    if not content.frfs:
        return None
    drawn, left = _within_budget(content.frfs)
    responses = {entry.response: entry.used for entry in sorted(content.frfs, key=lambda entry: not entry.used)}
    jobs = list(dict.fromkeys(entry.job for entry in content.frfs))
    first = next(iter(responses))
    options = [tag("option", "all responses", value="")]
    options += [
        tag("option", name if used else f"{name} (validation)", value=name, selected=name == first) for name, used in responses.items()
    ]
    choose = tag(
        "div",
        tag("label", "Response ", tag("select", *options, name="response")),
        tag(
            "label",
            "Job ",
            tag("select", tag("option", "all jobs", value=""), *(tag("option", job, value=job) for job in jobs), name="job"),
        ),
        class_="filter",
        hidden=True,
    )
    used, unseen = [name for name, flag in responses.items() if flag], [name for name, flag in responses.items() if not flag]
    text = f"Used for updating: {', '.join(used) or 'none'}. Validation channels, which test the result: {', '.join(unseen) or 'none'}. "
    text += "Ticks at the foot mark the lines that the updating uses (paper, Fig. 7). Point at a curve to read its values."
    done = content.done
    misfits = tables.misfit_table(content.campaign, done)
    richest = max((entry.chart for entry in content.frfs), key=lambda chart: len(chart.legend()))
    return (
        "frfs",
        "FRFs: measured, initial, updated",
        [
            tag("p", text),
            legend(richest),
            choose,
            tag("div", *drawn, class_="grid frfs"),
            _links(left),
            None if misfits is None else join([tag("h3", "Misfit by response"), misfits]),
        ],
    )


def _within_budget(frfs: Sequence[FrfFigure]) -> tuple[list[Markup], list[FrfFigure]]:
    """Draw until the page is full: the first used response of every job, then the next; return figures and what is left out."""
    turn: dict[str, int] = {}
    order = []
    for index, entry in sorted(enumerate(frfs), key=lambda pair: (not pair[1].used, pair[0])):
        turn[entry.job] = turn.get(entry.job, 0) + 1
        order.append((turn[entry.job], index))
    drawn: dict[int, Markup] = {}
    room = _BUDGET
    for _, index in sorted(order):
        entry = frfs[index]
        made = _drawn(entry.chart, data_job=entry.job, data_response=entry.response)
        room -= len(made)
        if room < 0:
            break
        drawn[index] = made
    return [drawn[index] for index in sorted(drawn)], [entry for index, entry in enumerate(frfs) if index not in drawn]


def _links(left: Sequence[FrfFigure]) -> Markup | None:
    if not left:
        return None
    jobs: dict[str, list[Markup]] = {}
    for entry in left:
        link = tag("a", entry.response, href=f"{quote(entry.job)}/{quote(frf_file(entry.response))}")
        jobs.setdefault(entry.job, []).append(link)
    rows: list[list[str | Cell]] = [[job, Cell(join(links, ", "))] for job, links in jobs.items()]
    title = f"{len(left)} further figures, as files beside this page"
    return details(title, table(title, ["Job", "Figures"], rows, text_columns=2))


def _damping(jobs: Sequence[JobRecord]) -> _Section | None:
    made = tables.damping_table(jobs)
    if made is None:
        return None
    text = (
        "The exponent is p_damp of eq. (33); the factor 10^p_damp multiplies β on the identified stiffness. Where nothing is loose "
        "the FRFs hardly depend on it. In the paper (Table 3) it grows with the number of removed bolts, from 0.009 to about 3."
    )
    return "damping", "Damping", [tag("p", text), made]


def _convergence(jobs: Sequence[JobRecord]) -> _Section | None:
    charts = convergence_charts(jobs)
    if not charts:
        return None
    drawn = [_drawn(chart) for chart in charts]
    text = "Accepted evaluations only."
    counts = sorted({len(job.optimiser.starts) for job in jobs if job.optimiser.starts})
    if counts:
        number = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
        text += (
            f" The optimiser had {number} start{'' if counts[-1] == 1 else 's'} a job, one after the other along a curve, and the end of "
            "lowest cost is kept; a jump is the next start, a finer profile of the same one, or a change of the weights."
        )
    return "convergence", "Convergence", [tag("p", text), legend(charts[0]), tag("div", *drawn, class_="grid pairs")]


def _l_curves(content: Content) -> _Section | None:
    if not content.l_curves:
        return None
    drawn = [_drawn(chart) for chart in content.l_curves]
    text = (
        "Each point is the solution for one weight η of the penalty: the sum of squares of the data to the right, that of the penalised "
        "departures upwards. Beyond the corner a smaller weight lets the parameters run and fits little better, a larger one costs fit. "
        "A curve without such a corner chooses nothing, and the default weight was used."
    )
    richest = max(content.l_curves, key=lambda chart: len(chart.legend()))
    first, rest = drawn[:_PROFILES], drawn[_PROFILES:]
    more = details(f"{len(rest)} further L-curves", tag("div", *rest, class_="grid profiles")) if rest else None
    return "l-curves", "Choice of the weight", [tag("p", text), legend(richest), tag("div", *first, class_="grid profiles"), more]


def _cost(content: Content) -> _Section | None:
    costs = tables.cost_table(content.jobs, content.reduction)
    if costs is None:
        return None
    text = (
        "Times of this machine beside the paper's (Table 4; laptop, 2.7 GHz, 23\u202f537 DOFs). Seconds depend on the machine, "
        "multiples of one full line hardly do. The paper prints 4.90e4 s for the full model; its own counts, "
        "23\u202f762 × 0.206 s, give 4.90e3 s, which stands here."
    )
    missing = (
        None
        if content.reduction
        else tag("p", "reduction.json is missing: `lrbc reduce` writes the reduced model's times and certificate.")
    )
    return "cost", "Cost", [tag("p", text), missing, costs]
