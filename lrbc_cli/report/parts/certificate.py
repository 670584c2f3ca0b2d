"""The part of the page on the reduced model: its measured and its estimated error."""

from __future__ import annotations

import math
from collections.abc import Sequence

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.svg import drawn, legend
from lrbc_cli.report.html import Cell, Markup, details, table, tag
from lrbc_cli.report.parts.figures import certificate_chart, trace_chart
from lrbc_cli.report.parts.tables import names_of
from lrbc_cli.results.job import Job
from lrbc_cli.results.model import ReductionRecord

#: What the kinds of certificate vectors are.
_STATES = {
    "free": "without the terms",
    "loose": "a hundredth of the local stiffness of the structure",
    "local": "equal to it",
    "clamped": "10⁴ times it",
    "beyond": "10⁹ times it",
    "random": "drawn for each term, from 10⁻⁴ to 10⁶ times",
}


def certificate_parts(reduction: ReductionRecord, jobs: Sequence[Job] = ()) -> list[Markup | None]:
    """Return the parts of the section; jobs that rest on another reduced model are named."""
    low, high = (float(edge) for edge in reduction.band_hz)
    text = (
        f"{fmt.count(reduction.full_size)} → {fmt.count(reduction.size)} DOFs, {fmt.figures(low)} to {fmt.figures(high)} Hz, "
        f"{len(reduction.expansion_points)} expansion points. "
    )
    measured = reduction.certificate
    if measured.held_out:
        vectors = "" if measured.vectors is None else f" and {fmt.count(measured.vectors)} parameter vectors"
        text += (
            f"Against full solves at {len(measured.held_out)} lines outside the basis{vectors} the worst measured error is "
            f"{fmt.small(measured.worst)} of the line's norm. "
        )
    bound, share, sure = measured.unseen, measured.unseen_share, measured.unseen_confidence
    if bound is not None and share is not None and sure is not None:
        text += f"At {fmt.percent(share)} % of all other lines it is below {fmt.small(bound)}, with {fmt.percent(sure)} % confidence"
        text += ": that is above the tolerance. " if bound > reduction.tolerance else ". "
    text += f"The tolerance of {fmt.small(reduction.tolerance)} is {'reached' if reduction.reached else 'NOT reached'}."
    parts: list[Markup | None] = [tag("p", text)]
    kinds = list(dict.fromkeys(kind for line in measured.held_out for kind in line.errors))
    if told := [f"{kind}: {_STATES[kind]}" for kind in kinds if kind in _STATES]:
        parts.append(tag("p", "States of the updated terms at which it is measured: " + "; ".join(told) + "."))
    if others := [job.job for job in jobs if _key(job) not in (None, reduction.cache.key)]:
        names = names_of(others)
        parts.append(tag("p", tag("strong", f"The results of {names} rest on another reduced model"), "; lrbc update runs them again."))
    # As many decimals as tell lines of a narrow band apart.
    digits = max(1, math.ceil(2 - math.log10(high - low))) if high > low else 1
    charts = [chart for chart in (certificate_chart(reduction), trace_chart(reduction)) if chart is not None]
    pictures = [tag("div", drawn(chart), legend(chart)) for chart in charts]
    parts.append(tag("div", *pictures, class_="grid pairs") if pictures else None)
    if measured.held_out:
        rows: list[list[str | Cell]] = [
            [f"{fmt.fixed(line.frequency_hz, digits)} Hz", *(fmt.small(line.errors.get(kind)) for kind in kinds)]
            for line in measured.held_out
        ]
        made = table("Measured relative error at held-out lines, by kind of parameter vector", ["Line", *kinds], rows)
        parts.append(details("The figures as a table", made))
    if reduction.expansion_points:
        points: list[list[str | Cell]] = [
            [f"{fmt.fixed(point.frequency_hz, digits)} Hz", fmt.count(point.order), fmt.count(point.added)]
            for point in reduction.expansion_points
        ]
        parts.append(details("Expansion points", table("Expansion points", ["Point", "Order", "DOFs added"], points)))
    return parts


def _key(job: Job) -> str | None:
    """Key of the reduced model that a job was identified with; None for the full model, and where nothing tells."""
    return None if job.provenance.certificate is None else job.provenance.certificate.key
