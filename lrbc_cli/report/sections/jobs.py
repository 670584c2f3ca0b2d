"""Section of the page with a part for each job: finding, profile, misfit by response, bolts and FRFs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lrbc_cli.report.content import Content, FrfFigure
from lrbc_cli.report.drawing.svg import drawn, legend
from lrbc_cli.report.files import frf_file
from lrbc_cli.report.html import Markup, beside, join, tag
from lrbc_cli.report.parts import tables
from lrbc_cli.results.job import FailedJob, Job

#: Most characters of FRF figures on the page, approximately; further ones are linked.
_BUDGET = 4_000_000


def job_parts(content: Content) -> list[Markup | None] | None:
    """Return the parts of the section; None without jobs."""
    if not content.jobs:
        return None
    figures = _within_budget(content.frfs)
    parts: list[Markup | None] = []
    if content.frfs:
        responses = {entry.response: entry.used for entry in sorted(content.frfs, key=lambda entry: not entry.used)}
        used, unseen = [name for name, flag in responses.items() if flag], [name for name, flag in responses.items() if not flag]
        text = (
            f"Responses used for updating: {', '.join(used) or 'none'}. Validation channels (not fitted): {', '.join(unseen) or 'none'}. "
        )
        text += "Ticks at the foot of an FRF mark the lines used for updating (paper, Fig. 7). "
        text += "To read values, point at a curve, tap it, or use the arrow keys."
        parts += [tag("p", text), _filter(responses)]
    parts += [_job(content, job, figures.get(job.job, [])) for job in content.jobs]
    return parts


def _filter(responses: Mapping[str, bool]) -> Markup:
    """Menu that selects the FRFs to show; without scripts all of them are shown."""
    first = next(iter(responses))
    options = [tag("option", "all responses", value="")]
    options += [
        tag("option", name if used else f"{name} (validation)", value=name, selected=name == first) for name, used in responses.items()
    ]
    initial = tag("input", type="checkbox", name="initial")
    return tag(
        "div",
        tag("label", "FRFs of ", tag("select", *options, name="response")),
        tag("label", initial, " initial model"),
        class_="filter",
        hidden=True,
    )


def _job(content: Content, job: Job, frfs: Sequence[tuple[FrfFigure, Markup | None]]) -> Markup:
    name, anchor = job.job, content.anchors[job.job]
    heading = tag("h3", name, " ", tables.status_badge(job))
    finding = tag("p", job.sentence.removeprefix(f"{name}: "), class_="finding")
    back = tag("a", "all jobs", href="#verdicts")
    if isinstance(job, FailedJob):
        return tag("article", heading, finding, tag("p", back, class_="files"), id=anchor, class_="job")
    known = None if job.removed is None else tag("p", f"Known to be removed: {tables.names_of(job.removed, content.campaign.bolt_names)}.")
    sketches = [
        tag("div", drawn(chart, beside(*((name, file) for file in files)), title=title), legend(chart))
        for title, charts, files in (
            ("Identified values", content.profiles, ("profile.png", "profile.csv")),
            ("Misfit by channel", content.channels, ()),
            ("Map of the bolts", content.maps, ("map.png",)),
        )
        # For a single straight edge, the map shows no more than the strip.
        if (chart := charts.get(name)) is not None and (charts is not content.maps or chart.panels[0].y.ticks)
    ]
    overview = tag("div", *sketches, tables.bolt_table(job), class_="overview pair" if len(sketches) == 2 else "overview")
    pictures = [made for _, made in frfs if made is not None]
    left = [entry for entry, made in frfs if made is None]
    richest = max((entry.chart for entry, _ in frfs), key=lambda chart: len(chart.legend()), default=None)
    pictured = [beside((name, "structure.png"), text="picture of the structure")] if content.structure is not None else []
    pictured += [beside((name, "shapes.png"), text="deflection shapes")] if name in content.shapes else []
    links = join([beside((name, "result.json")), *pictured, back], " · ")
    return tag(
        "article",
        heading,
        finding,
        known,
        overview,
        legend(richest) if richest is not None and pictures else None,
        tag("div", *pictures, class_="grid frfs") if pictures else None,
        _links(left),
        tag("p", links, class_="files"),
        id=anchor,
        class_="job",
    )


def _within_budget(frfs: Sequence[FrfFigure]) -> dict[str, list[tuple[FrfFigure, Markup | None]]]:
    """Draw FRFs by job up to ``_BUDGET``: the first used response of every job, then the second, ...; None for those left out."""
    turn: dict[str, int] = {}
    order = []
    for index, entry in sorted(enumerate(frfs), key=lambda pair: (not pair[1].used, pair[0])):
        turn[entry.job] = turn.get(entry.job, 0) + 1
        order.append((turn[entry.job], index))
    pictures: dict[int, Markup] = {}
    room = _BUDGET
    for _, index in sorted(order):
        entry = frfs[index]
        files = beside((entry.job, frf_file(entry.response)), (entry.job, "frf.csv"))
        made = drawn(entry.chart, files, data_response=entry.response)
        room -= len(made)
        if room < 0:
            break
        pictures[index] = made
    found: dict[str, list[tuple[FrfFigure, Markup | None]]] = {}
    for index, entry in enumerate(frfs):
        found.setdefault(entry.job, []).append((entry, pictures.get(index)))
    return found


def _links(left: Sequence[FrfFigure]) -> Markup | None:
    if not left:
        return None
    links = [beside((entry.job, frf_file(entry.response)), text=entry.response) for entry in left]
    return tag("p", f"{len(left)} further FRFs, as files beside this page: ", join(links, ", "), class_="files")
