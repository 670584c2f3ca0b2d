"""The part of the page on the reduced model: its measured and its estimated error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from lrbc_cli.report import format as fmt
from lrbc_cli.report.figures import certificate_chart, trace_chart
from lrbc_cli.report.html import Cell, Markup, details, figure, table, tag
from lrbc_cli.report.reduction import Reduction
from lrbc_cli.report.results import JobResult
from lrbc_cli.report.svg import legend, svg
from lrbc_cli.report.tables import names_of


def certificate_parts(reduction: Reduction, jobs: Sequence[JobResult] = ()) -> list[Markup | None]:
    """Return the parts of the section; jobs that rest on another reduced model are named."""
    low, high = (float(edge) for edge in reduction.band_hz)
    text = (
        f"{fmt.count(reduction.full_size)} → {fmt.count(reduction.size)} DOFs, {fmt.figures(low)} to {fmt.figures(high)} Hz, "
        f"{len(reduction.points)} expansion points. "
    )
    if reduction.held_out:
        vectors = "" if reduction.vectors is None else f" and {fmt.count(reduction.vectors)} parameter vectors"
        text += (
            f"Against full solves at {len(reduction.held_out)} lines outside the basis{vectors} the worst measured error is "
            f"{fmt.small(reduction.worst)} of the line's norm. "
        )
    if reduction.unseen is not None:
        bound, share, sure = reduction.unseen
        text += f"At {fmt.percent(share)} % of all other lines it is below {fmt.small(bound)}, with {fmt.percent(sure)} % confidence"
        text += ": that is above the tolerance. " if bound > reduction.tolerance else ". "
    text += f"The tolerance of {fmt.small(reduction.tolerance)} is {'reached' if reduction.reached else 'NOT reached'}."
    parts: list[Markup | None] = [tag("p", text)]
    if others := [job.job for job in jobs if _key(job) not in (None, reduction.cache.get("key"))]:
        names = names_of(others)
        parts.append(tag("p", tag("strong", f"The results of {names} rest on another reduced model"), "; lrbc update runs them again."))
    # As many decimals as tell lines of a narrow band apart.
    digits = max(1, math.ceil(2 - math.log10(high - low))) if high > low else 1
    charts = [chart for chart in (certificate_chart(reduction), trace_chart(reduction)) if chart is not None]
    drawn = [tag("div", figure(svg(chart), chart.title, chart.subtitle), legend(chart)) for chart in charts]
    parts.append(tag("div", *drawn, class_="grid pairs") if drawn else None)
    if reduction.held_out:
        kinds = list(dict.fromkeys(kind for line in reduction.held_out for kind in line.errors))
        rows: list[list[str | Cell]] = [
            [f"{fmt.fixed(line.frequency_hz, digits)} Hz", *(fmt.small(line.errors.get(kind)) for kind in kinds)]
            for line in reduction.held_out
        ]
        made = table("Measured relative error at held-out lines, by kind of parameter vector", ["Line", *kinds], rows)
        parts.append(details("The figures as a table", made))
    if reduction.points:
        points: list[list[str | Cell]] = [
            [f"{fmt.fixed(where, digits)} Hz", fmt.count(order), fmt.count(added)] for where, order, added in reduction.points
        ]
        parts.append(details("Expansion points", table("Expansion points", ["Point", "Order", "DOFs added"], points)))
    return parts


def _key(job: JobResult) -> str | None:
    """Key of the reduced model that a job was identified with; None for the full model, and where nothing tells."""
    certificate = job.provenance.get("certificate")
    key = certificate.get("key") if isinstance(certificate, Mapping) else None
    return key if isinstance(key, str) else None
