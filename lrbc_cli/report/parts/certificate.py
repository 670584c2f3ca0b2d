"""Section of the page on the reduced model: measured and estimated errors as text and charts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Chart, Curve, Item, LevelLine, Marks, Panel, decade_axis, linear_axis, span_of
from lrbc_cli.report.drawing.style import SERIES, STEPS
from lrbc_cli.report.drawing.svg import drawn, legend
from lrbc_cli.report.html import Cell, Markup, details, table, tag
from lrbc_cli.report.parts.tables import names_of
from lrbc_cli.results.job import Job
from lrbc_cli.results.model import ReductionRecord

#: Descriptions of the kinds of parameter vectors in the certificate.
_STATES = {
    "free": "without the terms",
    "loose": "a hundredth of the local stiffness of the structure",
    "local": "equal to the local stiffness",
    "clamped": "10⁴ times the local stiffness",
    "beyond": "10⁹ times the local stiffness",
    "random": "drawn for each term, from 10⁻⁴ to 10⁶ times the local stiffness",
    "resonant": "raised from free until a mode of the structure lies exactly on the line",
}


def certificate_parts(reduction: ReductionRecord, jobs: Sequence[Job] = ()) -> list[Markup | None]:
    """Return the parts of the section, with the names of jobs that rest on another reduced model."""
    low, high = (float(edge) for edge in reduction.band_hz)
    text = (
        f"{fmt.count(reduction.full_size)} → {fmt.count(reduction.size)} DOFs, {fmt.figures(low)} to {fmt.figures(high)} Hz, "
        f"{len(reduction.expansion_points)} expansion points. "
    )
    measured = reduction.certificate
    if measured.held_out:
        vectors = "" if measured.vectors is None else f" and {fmt.count(measured.vectors)} parameter vectors"
        text += (
            f"The largest error, measured against full solves at {len(measured.held_out)} lines outside the basis{vectors}, is "
            f"{fmt.small(measured.worst)} of the line's norm. "
        )
    bound, share, sure = measured.unseen, measured.unseen_share, measured.unseen_confidence
    if bound is not None and share is not None and sure is not None:
        text += f"At {fmt.percent(share)} % of all other lines the error is below {fmt.small(bound)}, with {fmt.percent(sure)} % confidence"
        text += ". This bound is above the tolerance. " if bound > reduction.tolerance else ". "
    text += f"The tolerance of {fmt.small(reduction.tolerance)} is {'reached' if reduction.reached else 'NOT reached'}."
    parts: list[Markup | None] = [tag("p", text)]
    kinds = list(dict.fromkeys(kind for line in measured.held_out for kind in line.errors))
    if told := [f"{kind}: {_STATES[kind]}" for kind in kinds if kind in _STATES]:
        parts.append(tag("p", "States of the updated terms at which the error is measured: " + "; ".join(told) + "."))
    if others := [job.job for job in jobs if _key(job) not in (None, reduction.cache.key)]:
        names = names_of(others)
        parts.append(
            tag("p", tag("strong", f"The results of {names} rest on another reduced model"), ". Run `lrbc update` to identify them again.")
        )
    # Enough decimals to distinguish the lines of a narrow band.
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
        parts.append(details("Measured errors as a table", made))
    if reduction.expansion_points:
        points: list[list[str | Cell]] = [
            [f"{fmt.fixed(point.frequency_hz, digits)} Hz", fmt.count(point.order), fmt.count(point.added)]
            for point in reduction.expansion_points
        ]
        parts.append(details("Expansion points", table("Expansion points", ["Point", "Order", "DOFs added"], points)))
    return parts


def _key(job: Job) -> str | None:
    """Key of the reduced model used for a job; None for the full model or if unknown."""
    return None if job.provenance.certificate is None else job.provenance.certificate.key


def certificate_chart(reduction: ReductionRecord) -> Chart | None:
    """Return the measured errors at lines outside the basis by kind of parameter vector; None without such lines."""
    held_out, worst_error = reduction.certificate.held_out, reduction.certificate.worst
    if not held_out:
        return None
    kinds = list(dict.fromkeys(kind for line in held_out for kind in line.errors))
    items: list[Item] = [LevelLine("tolerance", _log10(reduction.tolerance), "tolerance")]
    for index, kind in enumerate(kinds):
        lines = [line for line in held_out if kind in line.errors]
        x = np.array([line.frequency_hz for line in lines])
        y = np.array([_log10(line.errors[kind]) for line in lines])
        items.append(Marks(role=f"series{index % SERIES}", x=x, y=y, label=kind))
    low, high = span_of(
        [mark.y for mark in items if isinstance(mark, Marks) and mark.y is not None] + [np.array([_log10(reduction.tolerance)])]
    )
    y_axis = decade_axis("measured relative error", low - 0.3, high + 0.3)
    worst = "" if np.isnan(worst_error) else f" The largest is {worst_error:.1e}, the tolerance {reduction.tolerance:.0e}."
    alt = f"Measured error of the reduced model at {len(held_out)} held-out lines, parameter vectors {', '.join(kinds)}.{worst}"
    panel = Panel(
        x=linear_axis("frequency [Hz]", float(reduction.band_hz[0]), float(reduction.band_hz[1]), 8), y=y_axis, items=tuple(items)
    )
    return Chart(title="Measured error", subtitle="at lines outside the basis", alt=alt, panels=(panel,), width=620.0, height=300.0)


def trace_chart(reduction: ReductionRecord) -> Chart | None:
    """Return the estimated error over the band after each adaptive step; None without a trace."""
    # Steps at lines outside the basis do not change the estimate.
    steps = [step for step in reduction.trace if np.any(np.isfinite(step.estimate))]
    if not steps:
        return None
    items: list[Item] = [LevelLine("tolerance", _log10(reduction.tolerance), "tolerance")]
    curves: list[Curve] = []
    expanded = {point.frequency_hz for point in reduction.expansion_points}
    for index, step in enumerate(steps):
        shade = STEPS - 1 if len(steps) == 1 else round(index * (STEPS - 1) / (len(steps) - 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            estimate = np.log10(np.maximum(step.estimate, 0.0))
        estimate[~np.isfinite(estimate)] = np.nan
        points = sum(1 for other in reduction.trace if other.step <= step.step and other.factorised_hz in expanded)
        name = "compressed" if step.factorised_hz is None else f"{points} points"
        label = f"{name}: {step.size:g} DOFs" if len(steps) <= 8 or index in {0, len(steps) - 1} else ""
        curves.append(Curve(f"step{shade}", step.frequency_hz, estimate, label))
    taken = np.array([point.frequency_hz for point in reduction.expansion_points])
    if taken.size:
        items.append(Marks(role="taken", x=taken, y=None, label="expansion points", at=0.02))
    low, high = span_of([curve.y for curve in curves] + [np.array([_log10(reduction.tolerance)])])
    x_low, x_high = span_of([curve.x for curve in curves] + [taken])
    alt = f"Estimated error over frequency after each of {len(steps)} adaptive steps, with the tolerance and the expansion points."
    panel = Panel(
        x=linear_axis("frequency [Hz]", x_low, x_high, 8),
        # The axis is cut below: at expansion points the estimate is almost zero.
        y=decade_axis("estimated relative error", max(low - 0.5, _log10(reduction.tolerance) - 5.0), high + 0.3),
        items=(*items, *curves),
    )
    return Chart(title="Estimated error", subtitle="after each adaptive step", alt=alt, panels=(panel,), width=620.0, height=300.0)


def _log10(value: float) -> float:
    return float(np.log10(value)) if value > 0 else float("nan")
