"""Renders the page: one self-contained HTML document with a section for each part of the results."""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import datetime

from lrbc_cli.report.content import Content
from lrbc_cli.report.drawing.chart import Chart
from lrbc_cli.report.drawing.style import css
from lrbc_cli.report.drawing.svg import drawn, legend
from lrbc_cli.report.html import Markup, beside, details, document, tag
from lrbc_cli.report.live import live_note
from lrbc_cli.report.parts import tables
from lrbc_cli.report.parts.calibration import calibration_parts
from lrbc_cli.report.parts.certificate import certificate_parts
from lrbc_cli.report.parts.correlation import correlation_parts
from lrbc_cli.report.parts.damping import damping_parts
from lrbc_cli.report.parts.plan import plan_parts
from lrbc_cli.report.parts.provenance import provenance
from lrbc_cli.report.parts.remarks import remarks_parts
from lrbc_cli.report.parts.structure import structure_parts
from lrbc_cli.report.sections.jobs import job_parts
from lrbc_cli.report.sections.methods import methods_parts
from lrbc_cli.report.sections.top import header
from lrbc_cli.report.sections.verdicts import verdict_parts

#: Number of profiles shown; further ones are folded away.
_PROFILES = 24

_Section = tuple[str, str, list[Markup | None]]


def render(content: Content, written: datetime | None = None, *, live: bool = False) -> str:
    """Return the whole document.

    Parameters
    ----------
    content
        Content of the page.
    written
        Printed time of writing; None: now.
    live
        Whether the page reloads itself if there is a newer one, while ``lrbc watch`` runs.
    """
    now = written or datetime.now().astimezone()
    sections = [part for part in _sections(content) if part is not None]
    links = [tag("li", tag("a", re.split(":| of ", title)[0], href=f"#{anchor}")) for anchor, title, _ in sections]
    return document(
        f"{content.campaign.campaign} – bolts and boundary stiffness from FRFs",
        tag("a", "Skip to the verdicts", href="#verdicts", class_="skip"),
        header(content, now, live_note(now) if live else None),
        tag("nav", tag("ul", *links), aria_label="Parts of this report"),
        tag("main", *(tag("section", tag("h2", title), *parts, id=anchor) for anchor, title, parts in sections)),
        tag(
            "footer",
            f"Written by {content.tool} from the result files beside this page; nothing was recomputed. ",
            "lrbc guide page explains each part.",
        ),
        colours=css(),
        scripts=["page.js", "structure.js", *(["live.js"] if live else [])],
        pictures=live,
    )


def _sections(content: Content) -> Iterable[_Section | None]:
    done, paper = content.done, content.campaign.compare_with == "paper"
    yield _part("structure", "The structure", structure_parts(content.structure, done, content.shapes) if content.structure else None)
    yield "verdicts", "Verdicts", verdict_parts(content)
    yield _part("jobs", "Job by job", job_parts(content))
    yield _profiles(content)
    yield _part("damping", "Damping", damping_parts(done, content.damping, paper=paper))
    yield _part("remarks", "Confidence and notes", remarks_parts(content.campaign, done))
    yield _part("correlation", "Correlation", correlation_parts(content.campaign, done, content.fdac))
    if content.calibration is not None:
        yield _part(
            "calibration",
            "Calibration of the reference model",
            calibration_parts(content.calibration, content.calibration_frf, content.campaign),
        )
    if content.plan is not None:
        yield _part("plan", "Plan: what can be detected", plan_parts(content.plan))
    yield _cost(content, paper=paper)
    yield _convergence(content)
    if content.reduction is not None:
        yield _part("certificate", "Verification of the reduced model", certificate_parts(content.reduction, content.jobs))
    yield _l_curves(content)
    yield "methods", "Methods: to quote and cite", methods_parts(content)
    yield "provenance", "Provenance", provenance(content.campaign, content.jobs, content.reduction)


def _part(anchor: str, title: str, parts: list[Markup | None] | None) -> _Section | None:
    return None if parts is None else (anchor, title, parts)


def _profiles(content: Content) -> _Section | None:
    if not content.profiles:
        return None
    figures = [drawn(chart, beside((job, "profile.png"), (job, "profile.csv"))) for job, chart in content.profiles.items()]
    text = "Identified values along the edge, all jobs on one scale (paper, Fig. 6). Bolts are marked below the profile"
    if not content.along_edges:
        text = "Identified values of each bolt, all jobs on one scale"
    text += "; stripes mark bolts that are judged loose or inconclusive"
    text += ", and bolts outside (not observable)." if any(b.outside for job in content.done for b in job.bolts) else "."
    kinds = {group.kind for job in content.done for group in job.parameters.values()}
    title = f"Stiffness {'along the edge' if content.along_edges else 'of the joints'}" if kinds == {"stiffness"} else "Identified profiles"
    return "profiles", title, [tag("p", text), *_small_multiples(list(content.profiles.values()), figures, "profiles")]


def _small_multiples(charts: list[Chart], figures: list[Markup], what: str) -> list[Markup | None]:
    """Common legend of the charts and their figures, of which those beyond ``_PROFILES`` are folded away."""
    first, rest = figures[:_PROFILES], figures[_PROFILES:]
    more = details(f"{len(rest)} further {what}", tag("div", *rest, class_="grid profiles")) if rest else None
    richest = max(charts, key=lambda chart: len(chart.legend()))
    return [legend(richest), tag("div", *first, class_="grid profiles"), more]


def _convergence(content: Content) -> _Section | None:
    made = tables.starts_table(content.done)
    if made is None:
        return None
    text = (
        "The search begins at several starting points, because from a single one it may end in a local minimum; the result with the lowest "
        "cost is kept. The cost measures how badly the computed FRFs fit the measured ones (lower is better). Searches that end at nearly "
        "the same cost have found the same state again, or another state that fits as well, which the notes on the job then list. Results "
        "of higher cost were discarded."
    )
    words = (
        "Starting points: the values of the campaign file or of the calibration. “uniform”: one change of all values. “table of changes”: "
        "the most probable of many precomputed states with loosened bolts, with the change of each bolt in decades. “over smoothed "
        "spectra”: a first search with the peaks blurred. “hop”: continued from beyond a ridge of the cost beside the optimum found. "
        "“without the n %”: a first search without the lines that fit worst. “the most probable state of the bolts”: the search went on "
        "from there, because its cost is the lowest by the final weights of the lines; all costs in this table are by the first weights."
    )
    return "convergence", "Search for the best fit", [tag("p", text), made, tag("p", words, class_="meta")]


def _l_curves(content: Content) -> _Section | None:
    if not content.l_curves:
        return None
    text = (
        "Each point is the solution for one weight η of the penalty. Horizontal axis: sum of squares of the data residuals; vertical axis: "
        "sum of squares of the penalised departures. Beyond the corner, a smaller weight improves the fit little and lets the parameters "
        "run away; a larger weight makes the fit worse. Without a corner the curve selects no weight, and the default was used."
    )
    figures = [drawn(chart, beside((job, "l-curve.png"))) for job, chart in content.l_curves.items()]
    return "l-curves", "Regularisation", [tag("p", text), *_small_multiples(list(content.l_curves.values()), figures, "L-curves")]


def _cost(content: Content, *, paper: bool) -> _Section | None:
    costs = tables.cost_table(content.jobs, content.reduction, paper=paper)
    if costs is None:
        return None
    text = "Times on this machine. Seconds depend on the machine; multiples of the time for one line of the full model hardly do."
    if paper:
        text += (
            " For comparison: the times stated in the paper (Table 4; laptop, 2.7 GHz, 23\u202f537 DOFs). It prints 4.90e4 s for the full "
            "model, but its own counts, 23\u202f762 × 0.206 s, give 4.90e3 s, which is shown here."
        )
    missing = (
        None
        if content.reduction
        else tag("p", "reduction.json is missing. Run `lrbc reduce` to write the times and the certificate of the reduced model.")
    )
    return "cost", "Cost", [tag("p", text), missing, costs]
