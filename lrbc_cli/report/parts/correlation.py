"""Section of the page on the correlation of FRFs before and after updating: FDAC maps, FRAC, peak shifts, modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Chart, Curve, Item, Panel, Tiles, linear_axis
from lrbc_cli.report.drawing.layout import BOTTOM, RIGHT, TITLE, TOP
from lrbc_cli.report.drawing.style import COSINES
from lrbc_cli.report.drawing.svg import drawn, legend
from lrbc_cli.report.html import Cell, Markup, beside, details, table, tag
from lrbc_cli.results.agreement import CorrelationRecord, Peak
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.model import CampaignRecord
from lrbc_cli.results.tables import Fdac

#: Side of an FDAC map [points].
_SIDE = 215.0
#: Most maps on the page; further ones are only files.
_MAPS = 12
_LEVELS = ((0, "−1: opposite phase"), (2, "−0.6"), (COSINES - 3, "0.6"), (COSINES - 1, "1: same shape"))


def fdac_chart(job: JobRecord, fdac: Fdac) -> Chart:
    """Return the FDAC maps before and after updating side by side, with their diagonals and the means on these."""
    f = fdac.frequency_hz
    edges = np.concatenate([[1.5 * f[0] - 0.5 * f[1]], 0.5 * (f[1:] + f[:-1]), [1.5 * f[-1] - 0.5 * f[-2]]])
    means = [_mean(np.diag(values)) for values in (fdac.initial, fdac.updated)]
    panels = []
    for title, values in (("initial model", fdac.initial), ("updated model", fdac.updated)):
        items: list[Item] = [Tiles(f"fdac{step}", np.empty((0, 4)), text) for step, text in _LEVELS]
        items += _tiles(values, edges)
        low, high = edges[[0, -1]]
        items.append(Curve("frame", np.array([low, high, high, low, low]), np.array([low, low, high, high, low])))
        items.append(Curve("diagonal", f[[0, -1]], f[[0, -1]]))
        x = linear_axis("model [Hz]", edges[0], edges[-1], 5)
        panels.append(Panel(x=x, y=linear_axis("measured [Hz]", edges[0], edges[-1], 5), items=tuple(items), title=title, grid=False))
    alt = (
        f"FDAC of job {job.job}: measured lines against lines of the model, before and after. "
        f"Mean of the diagonal {fmt.fixed(means[0])} before, {fmt.fixed(means[1])} after."
    )
    subtitle = f"mean on the diagonal {fmt.change(means[0], means[1], 2)}"
    width, height = 2 * (50.0 + _SIDE + RIGHT), TOP + TITLE + _SIDE + BOTTOM
    return Chart(title=f"FDAC · {job.job}", subtitle=subtitle, alt=alt, panels=tuple(panels), width=width, height=height, beside=True)


def _mean(values: Floats) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else float("nan")


def _tiles(values: Floats, edges: Floats) -> list[Item]:
    """Return one item for each step of the scale; equal neighbours in a row are merged to one rectangle."""
    steps = np.full(values.shape, -1)
    known = np.isfinite(values)
    steps[known] = np.clip(np.rint((values[known] + 1.0) / 2.0 * (COSINES - 1)), 0, COSINES - 1).astype(int)
    boxes: dict[int, list[tuple[float, float, float, float]]] = {}
    for row, line in enumerate(steps):
        starts = np.flatnonzero(np.diff(line, prepend=-2))
        for start, end in zip(starts, [*starts[1:], len(line)], strict=True):
            boxes.setdefault(int(line[start]), []).append((edges[start], edges[end], edges[row], edges[row + 1]))
    return [Tiles("unknown" if step < 0 else f"fdac{step}", np.array(found)) for step, found in sorted(boxes.items())]


def correlation_parts(campaign: CampaignRecord, jobs: Sequence[JobRecord], maps: Mapping[str, Chart]) -> list[Markup | None] | None:
    """Return the parts of the section; None if no job has a correlation."""
    shown = [(job, job.correlation) for job in jobs if job.correlation is not None]
    modes = _modes(jobs)
    if not shown and not maps and modes is None:
        return None
    text = (
        "FRAC is 1 if two FRFs differ only by a factor. It weights lines by their magnitude, so a shift of a sharp peak by its own width "
        "costs most of it. FDAC compares the shapes over all responses, every measured line with every line of the model: 1 on the "
        "diagonal is agreement, a ridge beside the diagonal a shift in frequency. Peaks are matched one to one by frequency (within 5 %) "
        "and shape."
    )
    pictures = [drawn(chart, beside((job, "fdac.png"), (job, "fdac.csv"))) for job, chart in list(maps.items())[:_MAPS]]
    further = list(maps)[_MAPS:]
    links = [tag("p", f"The maps of {len(further)} further jobs are in their folders (fdac.png).")] if further else []
    first = next(iter(maps.values()), None)
    parts: list[Markup | None] = [tag("p", text)]
    if shown:
        parts += [_overview(shown), _by_response(campaign, shown), _peaks(shown)]
    parts.append(modes)
    if first is not None:
        parts += [tag("h3", "FDAC, initial and updated"), legend(first), tag("div", *pictures, class_="grid pairs"), *links]
    return parts


def _modes(jobs: Sequence[JobRecord]) -> Markup | None:
    """Return tables of natural frequencies and damping before and after updating, one for each job that has them."""
    tables = []
    for job in jobs:
        if job.modes is None or not job.modes.pairs:
            continue
        rows: list[list[str | Cell]] = [
            [
                fmt.fixed(pair.before_hz, 1),
                fmt.fixed(pair.after_hz, 1),
                fmt.signed(100.0 * (pair.after_hz / pair.before_hz - 1.0), 2),
                fmt.fixed(100.0 * pair.before_damping, 2),
                fmt.fixed(100.0 * pair.after_damping, 2),
                fmt.fixed(pair.mac, 2),
            ]
            for pair in job.modes.pairs
        ]
        state = "reference state" if job.modes.before == "reference" else "initial model"
        head = ["Before [Hz]", "After [Hz]", "Shift [%]", "ζ before [%]", "ζ after [%]", "MAC"]
        tables.append(
            tag("div", table(f"{job.job}: modes of the {state} (before) and of the updated model (after)", head, rows, text_columns=0))
        )
    if not tables:
        return None
    text = (
        "Modes of the reduced model in its band; the loss factor of a mode is 2ζ. The MAC compares the shapes over the whole model, "
        "weighted by kinetic energy. Modes with a MAC below 0.5 have no counterpart."
    )
    count = f"{len(tables)} job{'' if len(tables) == 1 else 's'}"
    return details(f"Natural frequencies and damping, {count}", tag("p", text), tag("div", *tables, class_="grid peaks"))


def _overview(shown: Sequence[tuple[JobRecord, CorrelationRecord]]) -> Markup:
    rows: list[list[str | Cell]] = []
    for job, found in shown:
        total = len(found.mean_spectrum.peaks)
        before, after = (sum(np.isfinite(values)) for values in _matched(found.mean_spectrum.peaks))
        rows.append(
            [
                job.job,
                fmt.change(found.frac_initial, found.frac_final, 2),
                fmt.change(found.peak_shift_percent_initial, found.peak_shift_percent_final, 2),
                f"{before} → {after} of {total}" if total else fmt.MISSING,
            ]
        )
    head: list[str | Cell] = [
        "Job",
        "Mean FRAC, responses used",
        Cell("Shift of peaks [%]", title="mean absolute shift of the peaks of the mean spectrum that are matched before and after"),
        "Peaks matched",
    ]
    return table("Correlation, before → after", head, rows)


def _matched(peaks: Sequence[Peak]) -> tuple[Floats, Floats]:
    return np.array([peak.initial_hz for peak in peaks]), np.array([peak.final_hz for peak in peaks])


def _by_response(campaign: CampaignRecord, shown: Sequence[tuple[JobRecord, CorrelationRecord]]) -> Markup | None:
    names = list(dict.fromkeys([*(entry.name for entry in campaign.responses), *(name for _, found in shown for name in found.responses)]))
    names = [name for name in names if any(name in found.responses for _, found in shown)]
    if not names:
        return None
    head: list[str | Cell] = ["Job"]
    for name in names:
        unseen = any(name in job.misfit_db.responses and not job.misfit_db.responses[name].used for job, _ in shown)
        head.append(Cell(name, tag("small", " validation") if unseen else None))
    rows: list[list[str | Cell]] = []
    for job, found in shown:
        row: list[str | Cell] = [job.job]
        for name in names:
            entry = found.responses.get(name)
            if entry is None:
                row.append(fmt.MISSING)
                continue
            before, after = (_shift(entry.peaks, values) for values in _matched(entry.peaks))
            content = fmt.change(entry.frac_initial, entry.frac_final, 2)
            row.append(Cell(content, tag("br"), tag("small", f"{fmt.change(before, after, 1)} %")))
        rows.append(row)
    caption = "FRAC of each response; below it the mean absolute shift of its peaks, before → after"
    return details(f"By response ({len(names)})", table(caption, head, rows, class_="misfits"))


def _shift(peaks: Sequence[Peak], model: Floats) -> float:
    """Mean absolute shift [%] over the peaks matched in both states, like the mean in the result file."""
    measured = np.array([peak.measured_hz for peak in peaks])
    both = np.isfinite(sum(_matched(peaks), np.zeros(len(peaks))))
    return 100.0 * float(np.mean(np.abs(model[both] / measured[both] - 1.0))) if both.any() else float("nan")


def _peaks(shown: Sequence[tuple[JobRecord, CorrelationRecord]]) -> Markup | None:
    tables = []
    for job, found in shown:
        if not found.mean_spectrum.peaks:
            continue
        rows: list[list[str | Cell]] = [
            [
                fmt.fixed(peak.measured_hz, 1),
                fmt.fixed(peak.initial_hz, 1),
                fmt.fixed(peak.final_hz, 1),
                fmt.signed(100.0 * (peak.initial_hz / peak.measured_hz - 1.0), 2),
                fmt.signed(100.0 * (peak.final_hz / peak.measured_hz - 1.0), 2),
            ]
            for peak in found.mean_spectrum.peaks
        ]
        head = ["Measured", "Initial", "Updated", "Shift before [%]", "after [%]"]
        tables.append(tag("div", table(f"{job.job}: peaks of the mean spectrum [Hz]", head, rows, text_columns=0)))
    count = f"{len(tables)} job{'' if len(tables) == 1 else 's'}"
    return details(f"Peaks of the mean spectrum, {count}", tag("div", *tables, class_="grid peaks")) if tables else None
