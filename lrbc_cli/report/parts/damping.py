"""Section of the page on the identified damping: a chart over the number of removed bolts, if known, and a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Chart, Curve, Item, Marks, Panel, linear_axis, span_of
from lrbc_cli.report.drawing.style import SERIES
from lrbc_cli.report.drawing.svg import drawn, legend
from lrbc_cli.report.html import Cell, Markup, beside, table, tag
from lrbc_cli.report.parts.tables import fold
from lrbc_cli.results.job import JobRecord, Parameter

#: Exponent p_damp by the number of removed bolts, as stated by the paper for its SoundBox (Table 3).
PAPER = {0: 0.0092, 4: 0.2606, 6: 1.8705, 10: 2.0591, 12: 2.5127, 15: 3.2690, 17: 3.0573}
_SIGMAS = 1.96


def interval(group: Parameter) -> tuple[float, float] | None:
    """Return the 95 % interval of the damping exponent of a group, limited to its bounds; None if unknown."""
    if group.damping_exponent is None or group.damping_exponent_std is None:
        return None
    low, high = (group.damping_exponent + sign * _SIGMAS * group.damping_exponent_std for sign in (-1.0, 1.0))
    least, most = (-np.inf, np.inf) if group.damping_bounds is None else group.damping_bounds
    return max(low, float(least)), min(high, float(most))


def damping_chart(jobs: Sequence[JobRecord], *, paper: bool) -> Chart | None:
    """Return exponents over the number of removed bolts, with intervals; None with fewer than two different numbers."""
    shown = [job for job in jobs if job.damped and job.removed is not None]
    if len({len(job.removed or ()) for job in shown}) < 2:
        return None
    items: list[Item] = []
    for index, name in enumerate(dict.fromkeys(name for job in shown for name in job.damped)):
        found = [(float(len(job.removed or ())), job.damped[name]) for job in shown if name in job.damped]
        role, label = f"series{index % SERIES}", name if len(shown[0].damped) > 1 else "identified"
        known = [(x, band) for x, group in found if (band := interval(group)) is not None]
        if known:
            x = np.array([[count, count, np.nan] for count, _ in known]).ravel()
            y = np.array([[*band, np.nan] for _, band in known]).ravel()
            items.append(Curve("whisker", x, y, "95 % interval"))
        values = np.array([group.damping_exponent for _, group in found], dtype=float)
        items.append(
            Marks(role=role, x=np.array([x for x, _ in found]), y=values, label=label, names=tuple(_point(x, group) for x, group in found))
        )
    if paper:
        names = tuple(f"paper, {count} removed: {value:.2f}" for count, value in PAPER.items())
        items.append(
            Marks(
                role="stated",
                x=np.array([*PAPER], dtype=float),
                y=np.array([*PAPER.values()]),
                label="stated by the paper (Table 3)",
                names=names,
            )
        )
    low, high = span_of([item.y for item in items if isinstance(item, Curve | Marks) and item.y is not None])
    most = max(float(np.nanmax(item.x)) for item in items if isinstance(item, Curve | Marks))
    margin = 0.06 * (high - low) or 0.5
    counts = linear_axis("bolts known to be removed", -0.5, most + 0.5, 9)
    panel = Panel(
        x=replace(counts, ticks=tuple(tick for tick in counts.ticks if tick[0].is_integer())),
        y=linear_axis("damping exponent", low - margin, high + margin, 6),
        items=tuple(items),
    )
    alt = f"Damping exponent over the number of removed bolts, {len(shown)} jobs" + (", with the values of the paper." if paper else ".")
    return Chart(title="Damping exponent", subtitle="over the number of removed bolts", alt=alt, panels=(panel,), width=520.0, height=270.0)


def _point(count: float, group: Parameter) -> str:
    band = interval(group)
    spread = "" if band is None else f", 95 % {fmt.fixed(band[0])} to {fmt.fixed(band[1])}"
    return f"{count:.0f} removed: {fmt.fixed(group.damping_exponent)}{spread}"


def damping_parts(jobs: Sequence[JobRecord], chart: Chart | None, *, paper: bool) -> list[Markup | None] | None:
    """Return the parts of the section; None if no damping was identified."""
    made = damping_table(jobs, paper=paper)
    if made is None:
        return None
    text = (
        "The exponent is p_damp of eq. (33). The factor 10^p_damp multiplies β, or the loss factor, of the identified stiffness. "
        "If nothing is loose, the FRFs hardly depend on it."
    )
    if paper:
        text += " The values of the paper are for another structure, its SoundBox, and are stated without intervals."
    pictures: list[Markup | None] = []
    if chart is not None:
        pictures = [tag("div", legend(chart), drawn(chart, beside(("", "damping.png"), ("", "campaign.csv"))), class_="single")]
    return [tag("p", text), *pictures, made]


def damping_table(jobs: Sequence[JobRecord], *, paper: bool) -> Markup | None:
    """Return the identified damping by job and group, with that of the paper (Table 3) if `paper`; None if none was identified."""
    shown = [job for job in jobs if job.damped]
    if not shown:
        return None
    several = len({name for job in shown for name in job.damped}) > 1
    head: list[str | Cell] = [
        "Job",
        *(["Group"] if several else []),
        "Bolts removed",
        "Exponent p_damp",
        "95 % interval",
        "Factor 10^p_damp",
    ]
    head += ["Paper: exponent"] if paper else []
    rows: list[list[str | Cell]] = []
    for job in shown:
        count = None if job.removed is None else len(job.removed)
        for name, group in job.damped.items():
            band = interval(group)
            row: list[str | Cell] = [job.job, *([name] if several else []), fmt.MISSING if count is None else str(count)]
            row += [fmt.fixed(group.damping_exponent), fmt.MISSING if band is None else f"{fmt.fixed(band[0])} to {fmt.fixed(band[1])}"]
            row.append(fmt.figures(group.damping_factor))
            rows.append([*row, *([fmt.fixed(PAPER.get(-1 if count is None else count))] if paper else [])])
    caption = "Damping of the identified stiffness, eq. (33)"
    return fold(table(caption, head, rows, text_columns=2 if several else 1), caption, len(rows))
