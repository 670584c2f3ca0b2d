"""The charts of the report, made from result files: stiffness profiles, FRF overlays, convergence, certificate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace as changed

import numpy as np

from lrbc_cli.report.chart import Area, Axis, Chart, Curve, Item, Level, Marks, Note, Panel, Span, decade_axis, linear_axis, number, span_of
from lrbc_cli.report.reading import FloatArray
from lrbc_cli.report.reduction import Reduction
from lrbc_cli.report.results import BoltVerdict, Frf, Group, JobResult, Response
from lrbc_cli.report.style import SERIES, STEPS

#: Below this ordinary coherence a measured line is shaded as doubtful.
COHERENCE = 0.8
#: How far computed curves may widen the magnitude axis beyond the measured one, in dB.
_BEYOND_DB = 15.0
#: FRFs with more lines than this are thinned for drawing, about what a figure can resolve.
_DENSE = 2400
_STATES = {"measured": "measured", "initial": "initial model", "updated": "updated model"}


def changes_of(job: JobResult) -> str:
    """Say in a few words what is known and what was found."""
    parts = []
    if job.removed is not None:
        parts.append(f"{len(job.removed)} bolt{'' if len(job.removed) == 1 else 's'} removed")
    if job.bolts:
        parts.append(f"{len(job.names('loose'))} of {len(job.bolts)} judged loose")
    return ", ".join(parts)


def profile_scales(jobs: Sequence[JobResult]) -> dict[str, tuple[float, float]]:
    """Return one range of whole decades for each group, over all jobs."""
    scales = {}
    for name in dict.fromkeys(group.name for job in jobs for group in job.groups):
        groups = [group for job in jobs for group in job.groups if group.name == name]
        arrays = [values for group in groups for values in (group.effective, group.initial, group.reference) if values is not None]
        low, high = span_of(arrays)
        scales[name] = (float(np.floor(low)), float(np.ceil(high))) if np.isfinite([low, high]).all() else (0.0, 1.0)
    return scales


def profile_chart(job: JobResult, scales: dict[str, tuple[float, float]]) -> Chart | None:
    """Return the identified profile of each group along its edge, bolts marked below (paper, Fig. 6); None without groups."""
    groups = [group for group in job.groups if len(group.log10)]
    if not groups:
        return None
    panels = tuple(
        _profile_panel(group, _bolts_of(group, groups, job.bolts), scales[group.name], several=len(groups) > 1) for group in groups
    )
    loose = job.names("loose")
    found = f"judged loose: {', '.join(loose)}" if loose else "no bolt is judged loose"
    alt = f"Identified {', '.join(group.name for group in groups)} of job {job.job}: " + (found if job.bolts else "no bolts given") + "."
    return Chart(job.job, changes_of(job), alt, panels, width=430.0, height=230.0 + 170.0 * (len(panels) - 1))


def _profile_panel(group: Group, bolts: Sequence[tuple[BoltVerdict, float]], scale: tuple[float, float], *, several: bool) -> Panel:
    place = _places(group)
    items: list[Item] = []
    along = np.array([where for _, where in bolts])
    low, high = span_of([place, along])
    margin = 0.03 * (high - low) if high > low else 0.5
    half = _half_pitch(along, (high - low) or 1.0)
    for verdict, label in (("loose", "judged loose"), ("undecided", "undecided")):
        chosen = np.array([where for bolt, where in bolts if bolt.verdict == verdict])
        if chosen.size:
            items.append(Span(verdict, np.column_stack([chosen - half, chosen + half]), label))
    items += [
        Note("loose", where, 0.98, bolt.name, rotated=True) for bolt, where in bolts if bolt.verdict == "loose" and len(bolt.name) <= 5
    ]
    if group.lower is not None and group.upper is not None:
        items.append(Area("band", place, group.lower, group.upper, "95 % band"))
    items.append(Curve("initial", place, group.initial, "initial"))
    if group.reference is not None:
        items.append(Curve("reference", place, group.reference, "reference job"))
    items.append(Curve("identified", place, group.effective, "identified"))
    for role, known, label in (("tight", False, "bolt in place"), ("removed", True, "bolt removed"), ("bolt", None, "bolt")):
        standing = [(bolt.name, where) for bolt, where in bolts if bolt.removed is known]
        if standing:
            items.append(Marks(role, np.array([where for _, where in standing]), None, label, 0.055, tuple(name for name, _ in standing)))
    bottom = scale[0] - 0.13 * (scale[1] - scale[0]) if bolts else scale[0]
    x_label = "along the edge [m]" if group.arc_length is not None else "term"
    unit = f" [{group.unit}]" if group.unit else ""
    y_label = f"{group.name}{unit}" if several else f"{group.kind}{unit}"
    # Room above for the names of loose bolts.
    y = decade_axis(y_label, bottom, scale[1] + 0.16 * (scale[1] - scale[0]))
    y = changed(y, ticks=tuple(tick for tick in y.ticks if scale[0] <= tick[0] <= scale[1]))
    return Panel(linear_axis(x_label, low - margin, high + margin), y, tuple(items))


def _places(group: Group) -> FloatArray:
    return np.arange(len(group.log10), dtype=float) if group.arc_length is None else group.arc_length


def _half_pitch(along: FloatArray, length: float) -> float:
    gaps = np.diff(np.unique(along))
    return 0.42 * float(np.median(gaps)) if gaps.size else 0.02 * length


def _bolts_of(group: Group, groups: Sequence[Group], bolts: Sequence[BoltVerdict]) -> list[tuple[BoltVerdict, float]]:
    """Return the bolts nearest to this group, each with its arc length (beyond the ends along the last segment)."""
    if group.positions is None or group.arc_length is None or len(group.positions) < 2:
        return []
    found = []
    for bolt in bolts:
        nearest = min(
            (entry for entry in groups if entry.positions is not None and len(entry.positions)), key=lambda entry: _distance(entry, bolt)
        )
        if nearest is group and np.isfinite(bolt.position).all():
            found.append((bolt, _arc_length(group, bolt.position)))
    return found


def _distance(group: Group, bolt: BoltVerdict) -> float:
    positions = np.empty((0, 3)) if group.positions is None else group.positions
    return float(np.linalg.norm(positions - bolt.position, axis=1).min())


def _arc_length(group: Group, point: FloatArray) -> float:
    if group.positions is None or group.arc_length is None:
        raise ValueError("a group without positions has no arc length")
    order = np.argsort(group.arc_length)
    nodes, length = group.positions[order], group.arc_length[order]
    step = np.diff(nodes, axis=0)
    size = np.maximum((step**2).sum(axis=1), 1e-300)
    share = ((point - nodes[:-1]) * step).sum(axis=1) / size
    low, high = np.zeros(len(share)), np.ones(len(share))
    low[0], high[-1] = -np.inf, np.inf
    share = np.clip(share, low, high)
    foot = nodes[:-1] + share[:, None] * step
    best = int(np.argmin(((foot - point) ** 2).sum(axis=1)))
    return float(length[best] + share[best] * (length[best + 1] - length[best]))


def frf_chart(job: JobResult, response: Response, frf: Frf) -> Chart:
    """Return measured, initial and updated FRF of one response, magnitude above phase (paper, Fig. 7)."""
    frequency, columns = _thinned(frf.frequency_hz, frf.responses[response.name])
    change = job.responses.get(response.name)
    used = response.used if change is None else change.used
    role = "used for updating" if used else "held out: not used for updating"
    misfit = "" if change is None else f" · misfit {change.initial:.1f} → {change.final:.1f} dB"
    empty = np.full(len(frequency), np.nan)
    levels = {state: columns.get(f"{state}_db", empty) for state in _STATES}
    magnitude: list[Item] = []
    if "coherence" in columns:
        edges = _runs(frequency, columns["coherence"] < COHERENCE)
        if len(edges):
            magnitude.append(Span("doubtful", edges, f"coherence below {COHERENCE:g}"))
    drawn = [(state, label) for state, label in _STATES.items() if np.isfinite(levels[state]).any()]
    magnitude += [Curve(state, frequency, levels[state], label) for state, label in drawn]
    if used and job.lines_hz.size:
        magnitude.append(Marks("selected", job.lines_hz, None, "lines used", 0.018))
    phase = [Curve(state, frequency, _wrapped(columns.get(f"{state}_phase_deg", empty)), label) for state, label in drawn]
    x = linear_axis("frequency [Hz]", float(frequency.min()), float(frequency.max()), 8)
    levels_axis = linear_axis(f"dB re 1 {response.unit}", *_level_range(levels), 6)
    degrees = Axis("phase [°]", -190.0, 190.0, tuple((float(k), number(k)) for k in (-180, -90, 0, 90, 180)))
    alt = f"FRF of {response.name}, job {job.job}, {role}{misfit.replace('→', 'to')}: measured, initial and updated, magnitude and phase."
    panels = (Panel(x, levels_axis, tuple(magnitude), 2.3), Panel(x, degrees, tuple(phase), 1.0))
    return Chart(f"{response.name} · {job.job}", role + misfit, alt, panels)


def _level_range(levels: dict[str, FloatArray]) -> tuple[float, float]:
    low, high = span_of([levels["measured"]])
    if not np.isfinite([low, high]).all():
        low, high = span_of(levels.values())
    else:
        lowest, highest = span_of(levels.values())
        low, high = max(lowest, low - _BEYOND_DB), min(highest, high + _BEYOND_DB)
    margin = 0.04 * (high - low)
    return low - 2 * margin, high + margin


def _runs(x: FloatArray, where: np.ndarray) -> FloatArray:
    """Return the (n, 2) edges of the runs of True, half a line wider on both sides."""
    half = 0.5 * float(np.median(np.diff(x))) if len(x) > 1 else 0.5
    padded = np.concatenate([[False], where, [False]])
    starts, ends = np.flatnonzero(padded[1:] & ~padded[:-1]), np.flatnonzero(padded[:-1] & ~padded[1:]) - 1
    return np.column_stack([x[starts] - half, x[ends] + half])


def _thinned(frequency: FloatArray, columns: Mapping[str, FloatArray]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Thin very dense lines for drawing: per bucket the lines where each column is smallest and largest, so that no peak is lost."""
    if len(frequency) <= _DENSE:
        return frequency, dict(columns)
    keep = {0, len(frequency) - 1}
    for bucket in np.array_split(np.arange(len(frequency)), _DENSE // 4):
        for name, values in columns.items():
            finite = bucket[np.isfinite(values[bucket])]
            if finite.size and name != "coherence":
                keep |= {int(finite[np.argmin(values[finite])]), int(finite[np.argmax(values[finite])])}
    order = np.array(sorted(keep))
    return frequency[order], {name: values[order] for name, values in columns.items()}


def _wrapped(degrees: FloatArray) -> FloatArray:
    """Wrap into ±180 degrees and cut the line where it jumps from one side to the other."""
    wrapped = (degrees + 180.0) % 360.0 - 180.0
    wrapped[1:][np.abs(np.diff(wrapped)) > 180.0] = np.nan
    return wrapped


def convergence_charts(jobs: Sequence[JobResult]) -> list[Chart]:
    """Return cost and mean misfit per evaluation, all jobs; nothing where no job has a history."""
    known = [job for job in jobs if any(entry.accepted for entry in job.history)]
    charts = []
    for title, label in (("Cost", "cost, eq. (29)"), ("Misfit at the lines used", "mean misfit [dB]")):
        curves = []
        for index, job in enumerate(known):
            # Trials that were rejected would hide the descent.
            accepted = [entry for entry in job.history if entry.accepted]
            values = [entry.cost if title == "Cost" else entry.misfit_db for entry in accepted]
            few = len(known) <= SERIES
            role, name = (f"series{index}", job.job) if few else ("quiet", "each line: one job")
            curves.append(Curve(role, np.array([entry.number for entry in accepted]), np.array(values), name))
        low, high = span_of(curve.y for curve in curves)
        if not np.isfinite([low, high]).all():
            continue
        floor = low - 0.05 * (high - low) if title == "Cost" else 0.0
        last = max(float(curve.x.max()) for curve in curves)
        panel = Panel(
            linear_axis("evaluation", 0.0, max(last, 1.0), 8), linear_axis(label, floor, high + 0.05 * (high - low), 5), tuple(curves)
        )
        count = f"{len(known)} job{'' if len(known) == 1 else 's'}"
        alt = f"{title} per evaluation of {count}, from {number(high, 3)} at most to {number(low, 3)} at least."
        charts.append(Chart(title, "per evaluation", alt, (panel,), width=620.0, height=280.0))
    return charts


def certificate_chart(reduction: Reduction) -> Chart | None:
    """Return the measured errors at lines outside the basis, per kind of parameter vector; None without held-out lines."""
    if not reduction.held_out:
        return None
    kinds = list(dict.fromkeys(kind for line in reduction.held_out for kind in line.errors))
    items: list[Item] = [Level("tolerance", _log10(reduction.tolerance), "tolerance")]
    for index, kind in enumerate(kinds):
        lines = [line for line in reduction.held_out if kind in line.errors]
        x = np.array([line.frequency_hz for line in lines])
        y = np.array([_log10(line.errors[kind]) for line in lines])
        items.append(Marks(f"series{index % SERIES}", x, y, kind))
    low, high = span_of(
        [mark.y for mark in items if isinstance(mark, Marks) and mark.y is not None] + [np.array([_log10(reduction.tolerance)])]
    )
    y_axis = decade_axis("measured relative error", low - 0.3, high + 0.3)
    worst = "" if reduction.worst is None else f" The worst is {reduction.worst:.1e}, the tolerance {reduction.tolerance:.0e}."
    alt = f"Measured error of the reduced model at {len(reduction.held_out)} held-out lines, parameter vectors {', '.join(kinds)}.{worst}"
    panel = Panel(linear_axis("frequency [Hz]", float(reduction.band_hz[0]), float(reduction.band_hz[1]), 8), y_axis, tuple(items))
    return Chart("Measured error", "at lines outside the basis", alt, (panel,), width=620.0, height=300.0)


def trace_chart(reduction: Reduction) -> Chart | None:
    """Return the estimated error over the band after each adaptive step; None without a trace."""
    if not reduction.steps:
        return None
    items: list[Item] = [Level("tolerance", _log10(reduction.tolerance), "tolerance")]
    curves: list[Curve] = []
    for index, step in enumerate(reduction.steps):
        shade = STEPS - 1 if len(reduction.steps) == 1 else round(index * (STEPS - 1) / (len(reduction.steps) - 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            estimate = np.log10(np.maximum(step.estimate, 0.0))
        estimate[~np.isfinite(estimate)] = np.nan
        label = f"step {step.number}: {step.size:g} DOFs" if len(reduction.steps) <= 8 or index in {0, len(reduction.steps) - 1} else ""
        curves.append(Curve(f"step{shade}", step.frequency_hz, estimate, label))
    taken = np.array([frequency for frequency, _, _ in reduction.points])
    if taken.size:
        items.append(Marks("taken", taken, None, "expansion points", 0.02))
    low, high = span_of([curve.y for curve in curves] + [np.array([_log10(reduction.tolerance)])])
    x_low, x_high = span_of([curve.x for curve in curves] + [taken])
    alt = (
        f"Estimated error over frequency after each of {len(reduction.steps)} adaptive steps, with the tolerance and the expansion points."
    )
    panel = Panel(
        linear_axis("frequency [Hz]", x_low, x_high, 8),
        decade_axis("estimated relative error", low - 0.5, high + 0.3),
        (*items, *curves),
    )
    return Chart("Estimated error", "after each adaptive step", alt, (panel,), width=620.0, height=300.0)


def _log10(value: float) -> float:
    return float(np.log10(value)) if value > 0 else float("nan")
