"""Charts of the report for each job: stiffness profiles, misfit by response, FRF overlays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace as changed

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import (
    Area,
    Axis,
    Chart,
    Curve,
    Item,
    Marks,
    Note,
    Panel,
    Span,
    Tiles,
    decade_axis,
    linear_axis,
    number,
    span_of,
)
from lrbc_cli.report.drawing.layout import RIGHT, SMALL
from lrbc_cli.report.drawing.names import GLYPH
from lrbc_cli.report.parts.tables import loose_of
from lrbc_cli.report.places import bolts_of
from lrbc_cli.results.job import Bolt, JobRecord, Parameter
from lrbc_cli.results.model import ResponseRecord
from lrbc_cli.results.tables import Frf

#: Measured lines with a coherence below this are shaded as doubtful.
COHERENCE = 0.8
#: Most that computed curves may widen the magnitude axis beyond the measured one [dB].
_BEYOND_DB = 15.0
#: FRFs with more lines than this, about what a figure can resolve, are thinned for drawing.
_DENSE = 2400
#: Shares of the distance to the frame that the layers of an open band cover; together they look like a fading band.
_FADES = (0.25, 0.5, 0.75, 1.0)
#: Width of the small figures of a job [points].
_WIDTH = 430.0
_OUTSIDE = "outside: not observable"
_STATES = {"measured": "measured", "initial": "initial model", "updated": "updated model"}


def changes_of(job: JobRecord) -> str:
    """Return a short text on what is known and what was found in a job."""
    parts = []
    if job.removed is not None:
        parts.append(f"{len(job.removed)} bolt{'' if len(job.removed) == 1 else 's'} removed")
    if job.bolts and not job.explained:
        parts.append("no verdict: the model does not explain the measurement")
    elif job.bolts:
        parts.append(loose_of(job))
        parts += [] if job.validated else ["not validated"]
    return ", ".join(parts)


def profile_scales(jobs: Sequence[JobRecord]) -> dict[str, tuple[float, float]]:
    """Return a common range of whole decades for the profiles of each group in all jobs."""
    scales = {}
    for name in dict.fromkeys(name for job in jobs for name in job.parameters):
        groups = [job.parameters[name] for job in jobs if name in job.parameters]
        arrays = [
            values
            for group in groups
            for values in (group.log10_effective, group.initial, group.reference_log10_effective)
            if values is not None
        ]
        low, high = span_of(arrays)
        # A wide confidence band widens the range by at most one decade.
        bands = [values for group in groups for values in (group.lower95, group.upper95) if values is not None]
        lowest, highest = span_of([*bands, np.array([low, high])])
        low, high = max(low - 1.0, lowest), min(high + 1.0, highest)
        scales[name] = (float(np.floor(low)), float(np.ceil(high))) if np.isfinite([low, high]).all() else (0.0, 1.0)
    return scales


def profile_chart(job: JobRecord, scales: dict[str, tuple[float, float]]) -> Chart | None:
    """Return the identified values of each group along its edge, with bolts below (paper, Fig. 6), or of its joints; None without any."""
    groups = {name: group for name, group in job.parameters.items() if len(group.log10)}
    if not groups:
        return None
    # An unexplained job has no verdicts, so no bolt is marked as loose.
    bolts = (
        job.bolts
        if job.explained
        else tuple(bolt if bolt.outside else bolt.model_copy(update={"verdict": "undecided"}) for bolt in job.bolts)
    )
    unsure = "inconclusive" if job.explained else "no verdict"
    several = [*groups.values()]
    titles = {name: name if len(several) > 1 else group.kind for name, group in groups.items()}
    panels = tuple(
        _profile_panel(group, bolts_of(group, several, bolts), scales[name], titles[name], unsure)
        if group.bolts is None
        else _joint_panel(group, group.bolts, bolts, scales[name], titles[name], unsure)
        for name, group in groups.items()
    )
    loose = [bolt.name for bolt in bolts if bolt.verdict == "loose"]
    found = f"judged loose: {', '.join(loose)}" if loose else "no bolt is judged loose"
    alt = f"Identified {', '.join(groups)} of job {job.job}: " + (found if job.bolts else "no bolts given") + "."
    return Chart(title=job.job, subtitle=changes_of(job), alt=alt, panels=panels, width=_WIDTH, height=230.0 + 170.0 * (len(panels) - 1))


def _profile_panel(group: Parameter, bolts: Sequence[tuple[Bolt, float]], scale: tuple[float, float], title: str, unsure: str) -> Panel:
    place = _places(group)
    items: list[Item] = []
    along = np.array([where for _, where in bolts])
    low, high = span_of([place, along])
    margin = 0.03 * (high - low) if high > low else 0.5
    half = _half_pitch(along, (high - low) or 1.0)
    stripes = (("loose", "loose", "judged loose"), ("undecided", "undecided", unsure), ("outside", "outside-stripe", _OUTSIDE))
    for verdict, role, label in stripes:
        chosen = np.array([where for bolt, where in bolts if bolt.verdict == verdict])
        if chosen.size:
            items.append(Span(role, np.column_stack([chosen - half, chosen + half]), label))
    items += [
        Note("loose-name", where, 0.98, bolt.name, rotated=True) for bolt, where in bolts if bolt.verdict == "loose" and len(bolt.name) <= 5
    ]
    bottom = scale[0] - 0.13 * (scale[1] - scale[0]) if bolts else scale[0]
    top = scale[1] + 0.16 * (scale[1] - scale[0])
    if group.lower95 is not None and group.upper95 is not None:
        items += _band(place, group.log10_effective, group.lower95, group.upper95, (scale[0], top))
    items.append(Curve("initial", place, group.initial, "initial"))
    if group.reference_log10_effective is not None:
        items.append(Curve("reference", place, group.reference_log10_effective, "reference job"))
    items.append(Curve("identified", place, group.log10_effective, "identified"))
    for role, known, label in (("tight", False, "bolt in place"), ("removed", True, "bolt removed"), ("bolt", None, "bolt")):
        standing = [(bolt.name, where) for bolt, where in bolts if bolt.removed is known]
        if standing:
            items.append(
                Marks(
                    role=role,
                    x=np.array([where for _, where in standing]),
                    y=None,
                    label=label,
                    at=0.055,
                    names=tuple(name for name, _ in standing),
                )
            )
    x_label = "along the edge [m]" if group.arc_length is not None else "term"
    unit = f" [{group.unit}]" if group.unit else ""
    # Room for the names of loose bolts above.
    y = decade_axis(f"{title}{unit}", bottom, top)
    y = changed(y, ticks=tuple(tick for tick in y.ticks if scale[0] <= tick[0] <= scale[1]))
    return Panel(x=linear_axis(x_label, low - margin, high + margin), y=y, items=tuple(items))


def _joint_panel(
    group: Parameter, owners: Sequence[str | None], bolts: Sequence[Bolt], scale: tuple[float, float], title: str, unsure: str
) -> Panel:
    """Panel with a bar for each value of joints, which do not lie along an edge."""
    count, known = len(owners), {bolt.name: bolt for bolt in bolts}
    verdicts = [None if name is None or name not in known else known[name].verdict for name in owners]
    left, right = np.arange(count) - 0.38, np.arange(count) + 0.38
    items: list[Item] = []
    for verdict, role, label in (("loose", "loose", "judged loose"), ("undecided", "undecided", unsure)):
        chosen = np.flatnonzero([found == verdict for found in verdicts])
        if chosen.size:
            items.append(Span(role, np.column_stack([chosen - 0.5, chosen + 0.5]), label))
    bottom, top = scale[0] - 0.13 * (scale[1] - scale[0]), scale[1] + 0.04 * (scale[1] - scale[0])
    if group.lower95 is not None and group.upper95 is not None:
        low, high = (np.where(np.isfinite(side), side, edge) for side, edge in ((group.lower95, bottom), (group.upper95, top)))
        items += [
            Area("band", np.array([left[k], right[k]]), np.full(2, low[k]), np.full(2, high[k]), "" if k else "95 % interval of the level")
            for k in range(count)
        ]
    drawn = [("initial", "initial", group.initial), ("reference", "reference job", group.reference_log10_effective)]
    for role, label, values in (*drawn, ("identified", "identified", group.log10_effective)):
        if values is not None:
            items.append(Curve(role, *_bars(0.38, values), label))
    removed = [k for k, name in enumerate(owners) if name is not None and name in known and known[name].removed]
    if removed:
        items.append(
            Marks(
                role="removed",
                x=np.array(removed, dtype=float),
                y=None,
                label="bolt removed",
                at=0.055,
                names=tuple(str(owners[k]) for k in removed),
            )
        )
    y = decade_axis(f"{title}{f' [{group.unit}]' if group.unit else ''}", bottom, top)
    y = changed(y, ticks=tuple(tick for tick in y.ticks if scale[0] <= tick[0] <= scale[1]))
    # Names of bolts with a stripe are placed first, since readers look for them.
    first = [k for wanted in ("loose", "undecided") for k, verdict in enumerate(verdicts) if verdict == wanted]
    return Panel(x=Axis("bolt", -0.6, count - 0.4, _some(owners, first)), y=y, items=tuple(items))


def _band(place: Floats, value: Floats, lower: Floats, upper: Floats, limits: tuple[float, float]) -> list[Item]:
    """Return the confidence band; an open side fades from the value to the frame and is marked by arrows."""
    items: list[Item] = []
    open_below, open_above = (np.asarray(~np.isfinite(side)) for side in (lower, upper))
    # On an open side the solid part ends at the value.
    items.append(Area("band", place, np.where(open_below, value, lower), np.where(open_above, value, upper), "95 % band"))
    for role, is_open, edge in (("open-down", open_below, limits[0]), ("open-up", open_above, limits[1])):
        where = np.flatnonzero(is_open & np.isfinite(value))
        if not where.size:
            continue
        label = "open: no limit found"
        for run in np.split(where, np.flatnonzero(np.diff(where) > 1) + 1):
            x, start = _stretched(place, run), np.concatenate([value[run[:1]], value[run], value[run[-1:]]])
            for share in _FADES:
                end = start + share * (edge - start)
                items.append(Area("open", x, np.minimum(start, end), np.maximum(start, end)))
        # Only some nodes have an arrow, so that arrows do not overlap.
        every = max(1, len(place) // 17)
        arrows = where[where % every == 0] if every > 1 and (where % every == 0).any() else where
        inside = edge + (0.02 if edge == limits[0] else -0.02) * (limits[1] - limits[0])
        items.append(Marks(role=role, x=place[arrows], y=np.full(len(arrows), inside), label=label))
    return items


def _stretched(place: Floats, run: np.ndarray) -> Floats:
    """Return the places of a run of neighbours, extended by half a step on both sides, so that a single one has a width too."""
    step = float(np.median(np.diff(place))) if len(place) > 1 else 0.1
    return np.concatenate([[place[run[0]] - 0.5 * step], place[run], [place[run[-1]] + 0.5 * step]])


def _places(group: Parameter) -> Floats:
    return np.arange(len(group.log10), dtype=float) if group.arc_length is None else group.arc_length


def _half_pitch(along: Floats, length: float) -> float:
    gaps = np.diff(np.unique(along))
    return 0.42 * float(np.median(gaps)) if gaps.size else 0.02 * length


def channel_chart(job: JobRecord) -> Chart | None:
    """Return bars of the misfit of every response, with that before updating; None without any."""
    found = {name: entry for name, entry in job.misfit_db.responses.items() if np.isfinite(entry.final)}
    if not found:
        return None
    items: list[Item] = []
    for role, used, label in (("channel", True, "used for updating"), ("channel-unseen", False, "validation channel")):
        bars = [(k - 0.32, k + 0.32, 0.0, entry.final) for k, entry in enumerate(found.values()) if entry.used is used]
        names = tuple(f"{name}: {entry.initial:.2f} → {entry.final:.2f} dB" for name, entry in found.items() if entry.used is used)
        if bars:
            items.append(Tiles(role, np.array(bars), label, names))
    initial = np.array([entry.initial for entry in found.values()])
    items.append(Curve("before", *_bars(0.4, initial), "initial model"))
    high = span_of([initial, np.array([entry.final for entry in found.values()])])[1]
    x = Axis("response", -0.6, len(found) - 0.4, _some(list(found)))
    mean = f"{job.misfit_db.initial:.1f} → {job.misfit_db.final:.1f} dB" if np.isfinite(job.misfit_db.initial) else ""
    alt = f"Mean absolute misfit of job {job.job} by response: " + ", ".join(
        f"{name} {entry.final:.2f} dB" for name, entry in found.items()
    )
    panel = Panel(x=x, y=linear_axis("misfit [dB]", 0.0, 1.05 * high, 4), items=tuple(items))
    return Chart(
        title=f"Misfit by channel · {job.job}",
        subtitle=f"mean of channels used {mean}",
        alt=alt,
        panels=(panel,),
        width=_WIDTH,
        height=190.0,
    )


def _bars(half: float, values: Floats) -> tuple[Floats, Floats]:
    """Horizontal strokes of half width `half` at 0, 1, 2, ... and the heights `values` as one curve, separated by NaN."""
    place, nothing = np.arange(len(values)), np.full(len(values), np.nan)
    return np.column_stack([place - half, place + half, nothing]).ravel(), np.column_stack([values, values, nothing]).ravel()


def _some(names: Sequence[str | None], first: Sequence[int] = ()) -> tuple[tuple[float, str], ...]:
    """Names as ticks, as many as there is room for: those with the indices ``first``, then every n-th of the others."""
    letter = GLYPH * SMALL * (len(names) + 0.2) / (_WIDTH - Chart.left - RIGHT)
    half = [0.5 * letter * (len(name or "") + 1) for name in names]
    every = max(1, int(np.ceil(2.0 * max(half))))
    chosen: list[int] = []
    for k in [*first, *range(0, len(names), every)]:
        if names[k] and all(abs(k - other) >= half[k] + half[other] for other in chosen):
            chosen.append(k)
    return tuple((float(k), names[k] or "") for k in sorted(chosen))


def frf_chart(job: JobRecord, response: ResponseRecord, frf: Frf, tight: tuple[str, Frf] | None = None) -> Chart:
    """Return measured, initial and updated FRF of one response, magnitude above phase (paper, Fig. 7), and its coherence.

    Parameters
    ----------
    job, response, frf
        The job, the response, and all FRFs of the job.
    tight
        Name and FRFs of the reference job, whose measurement is also drawn.
    """
    change = job.misfit_db.responses.get(response.name)
    used = response.used if change is None else change.used
    role = "used for updating" if used else "validation channel: not used for updating"
    misfit = "" if change is None else f" · misfit {change.initial:.1f} → {change.final:.1f} dB"
    lines = job.lines.frequency_hz if used else np.empty(0)
    return overlay_chart(response, frf, _STATES, f"{response.name} · {job.job}", role + misfit, lines, tight)


def overlay_chart(
    response: ResponseRecord,
    frf: Frf,
    labels: Mapping[str, str],
    title: str,
    subtitle: str,
    lines_hz: Floats | None = None,
    tight: tuple[str, Frf] | None = None,
) -> Chart:
    """Return measured and computed FRFs of one response, magnitude above phase.

    Parameters
    ----------
    response
        The response to draw.
    frf
        FRFs of all responses.
    labels
        Texts of the legend for ``measured``, ``initial``, ``updated``.
    title, subtitle
        Titles of the chart.
    lines_hz
        Lines to mark at the bottom [Hz].
    tight
        Name and FRFs of another measurement that is also drawn.
    """
    frequency, columns = _thinned(frf.frequency_hz, frf.responses[response.name])
    empty = np.full(len(frequency), np.nan)
    levels = {state: columns.get(f"{state}_db", empty) for state in _STATES}
    magnitude: list[Item] = []
    phase: list[Item] = []
    coherence = columns.get("coherence", empty)
    edges = _runs(frequency, coherence < COHERENCE)
    if len(edges):
        magnitude.append(Span("doubtful", edges, f"coherence below {COHERENCE:g}"))
    if tight is not None and response.name in tight[1].responses:
        other, found = _thinned(tight[1].frequency_hz, tight[1].responses[response.name])
        inside = (other >= frequency.min()) & (other <= frequency.max())
        # Its lines may differ from those of the job.
        for items, values in ((magnitude, found["measured_db"]), (phase, _wrapped(found["measured_phase_deg"]))):
            items.append(Curve("tight-state", other[inside], values[inside], f"measured, {tight[0]}"))
    drawn = [(state, label) for state, label in labels.items() if np.isfinite(levels[state]).any()]
    magnitude += [Curve(state, frequency, levels[state], label) for state, label in drawn]
    if lines_hz is not None and lines_hz.size:
        magnitude.append(Marks(role="selected", x=lines_hz, y=None, label="lines used", at=0.018))
    phase += [Curve(state, frequency, _wrapped(columns.get(f"{state}_phase_deg", empty)), label) for state, label in drawn]
    x = linear_axis("frequency [Hz]", float(frequency.min()), float(frequency.max()), 8)
    levels_axis = linear_axis(f"dB re 1 {fmt.over_force(response.unit)}", *_level_range(levels), 6)
    degrees = Axis("phase [°]", -190.0, 190.0, tuple((float(k), number(k)) for k in (-180, -90, 0, 90, 180)))
    panels = [Panel(x=x, y=levels_axis, items=tuple(magnitude), weight=2.3), Panel(x=x, y=degrees, items=tuple(phase), weight=1.0)]
    known = bool(np.isfinite(coherence).any())
    if known:
        share = Axis("coh. [1]", 0.0, 1.04, ((0.0, "0"), (0.5, "0.5"), (1.0, "1")))
        panels.append(Panel(x=x, y=share, items=(Curve("coherence", frequency, coherence, "coherence"),), weight=0.6))
    shown = [label for item in magnitude if isinstance(item, Curve) and (label := item.label)]
    alt = f"FRF {title}, {subtitle.replace('→', 'to')}: {', '.join(shown)}, magnitude and phase{', coherence' if known else ''}."
    read = tuple(changed(panel, steps=steps_of(frf.frequency_hz)) for panel in panels)
    return Chart(title=title, subtitle=subtitle, alt=alt, panels=read, height=390.0 if known else 330.0)


def steps_of(frequency: Floats) -> tuple[float, float] | None:
    """Return the first line and the step of equidistant lines; None for others."""
    if len(frequency) < 2:
        return None
    first, step = float(frequency[0]), float(frequency[-1] - frequency[0]) / (len(frequency) - 1)
    even = first + step * np.arange(len(frequency))
    return (first, step) if step > 0.0 and float(np.abs(frequency - even).max()) <= 1e-3 * step else None


def _level_range(levels: dict[str, Floats]) -> tuple[float, float]:
    low, high = span_of([levels["measured"]])
    if not np.isfinite([low, high]).all():
        low, high = span_of(levels.values())
    else:
        lowest, highest = span_of(levels.values())
        low, high = max(lowest, low - _BEYOND_DB), min(highest, high + _BEYOND_DB)
    margin = 0.04 * (high - low)
    return low - 2 * margin, high + margin


def _runs(x: Floats, where: np.ndarray) -> Floats:
    """Return the (n, 2) edges of the runs of True, extended by half a line on both sides."""
    half = 0.5 * float(np.median(np.diff(x))) if len(x) > 1 else 0.5
    padded = np.concatenate([[False], where, [False]])
    starts, ends = np.flatnonzero(padded[1:] & ~padded[:-1]), np.flatnonzero(padded[:-1] & ~padded[1:]) - 1
    return np.column_stack([x[starts] - half, x[ends] + half])


def _thinned(frequency: Floats, columns: Mapping[str, Floats]) -> tuple[Floats, dict[str, Floats]]:
    """Thin dense lines for drawing: keep the smallest and largest value of each column in each bucket, so that no peak is lost."""
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


def _wrapped(degrees: Floats) -> Floats:
    """Wrap phases into ±180 degrees and interrupt the curve where it jumps from one side to the other."""
    wrapped = (degrees + 180.0) % 360.0 - 180.0
    wrapped[1:][np.abs(np.diff(wrapped)) > 180.0] = np.nan
    return wrapped
