"""Charts of the verdicts: a strip of all jobs and bolts, and a map of the bolts of each job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Axis, Chart, Curve, Item, Marks, Panel, Tiles, Word, linear_axis
from lrbc_cli.report.drawing.layout import RIGHT, SMALL, TOP
from lrbc_cli.report.drawing.names import GLYPH, names_beside
from lrbc_cli.report.drawing.style import PROBABILITIES
from lrbc_cli.report.parts.tables import NOT_COVERED, loose_of, names_of, sentence
from lrbc_cli.report.places import along_the_edges
from lrbc_cli.results.job import Bolt, JobRecord
from lrbc_cli.results.model import CampaignRecord

#: Width (largest and smallest) and height of a cell of the strip [points]; cells shrink if there are many bolts.
_WIDE, _NARROW, _HIGH = 38.0, 13.0, 23.0
#: Largest width of the strip [points], unless its cells would become too narrow to read.
_WIDTH = 980.0
#: Least width of a cell that shows the probability as a number [points].
_FIGURES = 22.0


def level_of(bolt: Bolt) -> int | None:
    """Return the step on the scale of probability, from the probability if there is one, else from the verdict; None if undecided."""
    if bolt.probability_loose is not None:
        return min(int(bolt.probability_loose * PROBABILITIES), PROBABILITIES - 1)
    return {"loose": PROBABILITIES - 1, "tight": 0}.get(bolt.verdict)


def strip_chart(campaign: CampaignRecord, jobs: Sequence[JobRecord]) -> Chart | None:
    """Return a table-like chart with a row for each job and a column for each bolt along the edges; None without bolts."""
    shown = [job for job in jobs if job.bolts]
    names = list(dict.fromkeys([*campaign.bolt_names, *(bolt.name for job in shown for bolt in job.bolts)]))
    edges = along_the_edges(names, shown)
    if not shown or not names:
        return None
    # Edges are separated by a gap of half a cell.
    column = {name: index + 0.5 * edge for edge, index, name in _numbered(edges)}
    count = len(names) + 0.5 * (len(edges) - 1)
    labels = [fmt.shortened(job.job, 30) for job in shown]
    left = 16.0 + GLYPH * SMALL * max(len(label) for label in labels)
    cell = float(np.clip((_WIDTH - left - RIGHT) / count, _NARROW, _WIDE))
    items = [*verdict_key(shown), *_cells(shown, column, cell)]
    every = max(1, int(np.ceil((GLYPH * SMALL * max(len(name) for name in names) + 3.0) / cell)))
    ticks = tuple((column[name] + 0.5, name) for edge in edges for name in edge[::every])
    along = any(group.arc_length is not None for job in shown for group in job.parameters.values())
    x_axis = Axis("" if len(names) < 2 else "bolts, in order along the edge" if along else "bolts", 0.0, count, ticks)
    y_axis = Axis("", float(len(shown)), 0.0, tuple((row + 0.5, label) for row, label in enumerate(labels)))
    alt = " ".join(
        f"{job.job}: " + (f"loose {', '.join(job.names('loose')) or 'none'}." if job.explained else f"no verdict, {job.status}.")
        for job in shown
    )
    panel = Panel(x=x_axis, y=y_axis, items=tuple(items), grid=False)
    width, height = left + cell * count + RIGHT, TOP + _HIGH * len(shown) + 36.0
    unsure = [job.job for job in shown if not job.validated]
    subtitle = f"not validated: {names_of(unsure)}" if unsure else ""
    return Chart(title="Verdicts job by job", subtitle=subtitle, alt=alt, panels=(panel,), width=width, height=height, left=left)


def _cells(shown: Sequence[JobRecord], column: Mapping[str, float], cell: float) -> list[Item]:
    """Cells of all bolts of all jobs: colour, sign, and the probability if there is room."""
    filled: dict[str, list[tuple[tuple[float, ...], str]]] = {}
    marks: dict[str, list[tuple[float, float]]] = {}
    words: list[Item] = []
    hatched, framed = [], []
    for row, job in enumerate(shown):
        for bolt in job.bolts:
            x, level = column[bolt.name], level_of(bolt) if job.explained else None
            judged = job.explained and not bolt.outside
            inside = 0.5 * 2.4 / cell, 0.5 * 2.4 / _HIGH
            box = (x + inside[0], x + 1 - inside[0], row + 1 - inside[1], row + inside[1])
            role = "outside" if bolt.outside else "unknown" if level is None else f"p{level}"
            on = "outside-on" if bolt.outside else "strong" if level is None else f"on{level}"
            told = job.explained or bolt.outside
            text = f"{job.job}, {sentence(bolt)}" if told else f"{job.job}, {bolt.name}: no verdict, {job.status}"
            filled.setdefault(role, []).append((box, text))
            figures = bolt.probability_loose is not None and cell >= _FIGURES and judged
            high = row + (0.34 if figures else 0.5)
            if bolt.outside:
                words.append(Word(role=on, x=x + 0.5, y=row + 0.5, text=NOT_COVERED, size=min(7.6, 0.5 * cell)))
            elif bolt.verdict == "undecided" or not job.explained:
                hatched.append(box)
                words.append(Word(role=on, x=x + 0.5, y=high, text="?" if job.explained else "–", size=SMALL, bold=True))
            else:
                marks.setdefault(f"{bolt.verdict}-{'on0' if level is None else on}", []).append((x + 0.5, high))
            if figures and bolt.probability_loose is not None:
                words.append(Word(role=on, x=x + 0.5, y=row + 0.73, text=fmt.percent(bolt.probability_loose), size=7.6))
            if bolt.removed:
                framed.append(box)
    items: list[Item] = [
        Tiles(role, np.array([box for box, _ in found]), "", tuple(text for _, text in found)) for role, found in sorted(filled.items())
    ]
    if hatched:
        signs = ["? inconclusive"] if any(bolt.verdict == "undecided" for job in shown if job.explained for bolt in job.bolts) else []
        signs += [] if all(job.explained for job in shown) else ["– no verdict"]
        items.append(Tiles("hatch", np.empty((0, 4)), f"hatched: {', '.join(signs)}"))
        items.append(_hatching(np.array(hatched), cell))
    if framed:
        items.append(Tiles("known", np.empty((0, 4)), "framed: known to be removed"))
        items.append(Curve("known", *_outlines(np.array(framed))))
    items += [
        Marks(role=role, x=np.array([x for x, _ in found]), y=np.array([y for _, y in found])) for role, found in sorted(marks.items())
    ]
    return [*items, *words]


def verdict_key(jobs: Sequence[JobRecord]) -> list[Item]:
    """Items without shapes that explain the colours in the legend."""
    bolts = [bolt for job in jobs for bolt in job.bolts]
    words = [(0, "tight"), (PROBABILITIES - 1, "loose")]
    if any(bolt.probability_loose is not None for bolt in bolts):
        words = [(0, "probability of being loose: 0 %"), (PROBABILITIES // 2, "50 %"), (PROBABILITIES - 1, "100 %")]
    key: list[Item] = [Tiles(f"p{step}", np.empty((0, 4)), text) for step, text in words]
    if any(bolt.outside for bolt in bolts):
        key.append(Tiles("outside", np.empty((0, 4)), f"{NOT_COVERED} outside: no term reaches it, not observable"))
    return key


def _numbered(edges: Sequence[Sequence[str]]) -> list[tuple[int, int, str]]:
    flat = [(edge, name) for edge, names in enumerate(edges) for name in names]
    return [(edge, index, name) for index, (edge, name) in enumerate(flat)]


def _hatching(boxes: Floats, cell: float) -> Curve:
    """Diagonal lines in two corners of boxes (left, right, low, high), 4 points apart, clear of the text and separated by NaN."""
    x: list[float] = []
    y: list[float] = []
    for left, right, low, high in boxes:
        width, height = (right - left) * cell, (low - high) * _HIGH
        near = np.arange(4.0, 0.25 * (width + height), 4.0)
        for start in (*near, *(width + height - near)):
            a, b = max(0.0, start - height), min(width, start)
            x += [left + a / cell, left + b / cell, np.nan]
            y += [high + (start - a) / _HIGH, high + (start - b) / _HIGH, np.nan]
    return Curve("hatch", np.array(x), np.array(y))


def _outlines(boxes: Floats) -> tuple[Floats, Floats]:
    gap = np.full(len(boxes), np.nan)
    left, right, low, high = boxes.T
    return np.column_stack([left, right, right, left, left, gap]).ravel(), np.column_stack([low, low, high, high, low, gap]).ravel()


def map_chart(job: JobRecord, among: Sequence[JobRecord] = ()) -> Chart | None:
    """Return a map of edges and joints in the plane of their largest extent, bolts coloured by probability; None without positions.

    Maps of several jobs (``among``) have a common legend of colours.
    """
    bolts = [bolt for bolt in job.bolts if np.isfinite(bolt.position).all()]
    lines = [
        group.positions
        for group in job.parameters.values()
        if group.positions is not None and group.arc_length is not None and len(group.positions)
    ]
    if not bolts:
        return None
    points = np.concatenate([*lines, np.array([bolt.position for bolt in bolts])])
    spread = np.ptp(points, axis=0)
    # The two coordinates of largest extent; the first of them points to the right.
    across, up = sorted(np.argsort(-spread, kind="stable")[:2].tolist())
    flat = bool(min(spread[across], spread[up]) <= 0.12 * max(spread[across], spread[up]))
    if flat:
        across, up = (across, up) if spread[across] >= spread[up] else (up, across)
    # At this width, names of 7 points are legible if two figures are side by side.
    width, margin = 335.0, 16.0
    inner = width - 50.0 - RIGHT
    size = float(spread[across]) or 1.0
    scale = (inner - 2 * margin) / size
    height = 46.0
    if not flat:
        scale = min(scale, (250.0 - 2 * margin) / float(spread[up]))
        height = float(spread[up]) * scale + 2 * margin + 10.0
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    half = 0.5 * inner / scale, 0.5 * height / scale
    x_axis = linear_axis(f"{'xyz'[across]} [m]", middle[across] - half[0], middle[across] + half[0], 6)
    y_axis = (
        Axis("", middle[up] - half[1], middle[up] + half[1], ())
        if flat
        else linear_axis(f"{'xyz'[up]} [m]", middle[up] - half[1], middle[up] + half[1], 5)
    )

    def level(point: Floats) -> float:
        return float(middle[up] + 5.0 / scale) if flat else float(point[up])

    items = verdict_key(among or [job])
    for positions in lines:
        items.append(Curve("edge", positions[:, across], np.array([level(point) for point in positions])))
    places = np.array([[bolt.position[across], level(bolt.position)] for bolt in bolts])
    items += bolt_items(bolts, places, explained=job.explained)
    nodes = [(x, level(point)) for positions in lines for x, point in zip(positions[:, across], positions, strict=True)]
    names, sought = [bolt.name for bolt in bolts], [index for index, bolt in enumerate(bolts) if bolt.verdict in {"loose", "undecided"}]
    items += names_beside(names, places, np.array(nodes).reshape(-1, 2), scale, (x_axis.low, x_axis.high), first=sought)
    found = job.names("loose")
    alt = f"Map of the bolts of job {job.job}: " + (f"loose {', '.join(found) or 'none'}." if job.explained else "no verdict.")
    subtitle = loose_of(job) if job.explained else "no verdict"
    panel = Panel(x=x_axis, y=y_axis, items=tuple(items))
    return Chart(title=job.job, subtitle=subtitle, alt=alt, panels=(panel,), width=width, height=TOP + height + 36.0)


def bolt_signs(bolt: Bolt, explained: bool) -> list[tuple[str, str]]:
    """Return the roles of a bolt's symbol from bottom to top, each with its letter, if it is one."""
    step = level_of(bolt) if explained else None
    on = "strong" if step is None else f"on{step}"
    signs = [("outside-dot" if bolt.outside else "unknown-dot" if step is None else f"p{step}", "")]
    signs += [("known", "")] if bolt.removed else []
    if bolt.outside:
        return [*signs, ("outside-on", NOT_COVERED)]
    if bolt.verdict == "undecided" or not explained:
        return [*signs, ("unsure", ""), (on, "?" if explained else "–")]
    return [*signs, (f"{bolt.verdict}-{'on0' if step is None else on}", "")]


def told(bolt: Bolt, explained: bool) -> str:
    """Return the text shown when the pointer is on a bolt."""
    return sentence(bolt) if explained or bolt.outside else f"{bolt.name}: no verdict"


def letter_size(letter: str) -> float:
    """Return the size of a letter on the symbol of a bolt [points]."""
    return 7.0 if letter == NOT_COVERED else 8.5


def bolt_items(bolts: Sequence[Bolt], places: Floats, *, explained: bool) -> list[Item]:
    """Return the symbols of bolts at (n, 2) places, with the labels for the legend."""
    layers: dict[int, list[Item]] = {}
    for bolt, (x, y) in zip(bolts, places, strict=True):
        for layer, (role, letter) in enumerate(bolt_signs(bolt, explained)):
            names = (told(bolt, explained),) if layer == 0 else ()
            mark = Marks(role=role, x=np.array([x]), y=np.array([y]), names=names)
            bold = letter in {"?", "–"}
            layers.setdefault(layer, []).append(
                Word(role=role, x=x, y=y, text=letter, size=letter_size(letter), bold=bold) if letter else mark
            )
    # Drawn layer by layer, so that no disc covers the sign of a close neighbour.
    items = [item for layer in sorted(layers) for item in layers[layer]]
    nothing, roles = np.empty(0), {item.role for item in items}
    items += [Marks(role="known-dot", x=nothing, y=nothing, label="ringed: known to be removed")] if "known" in roles else []
    items += (
        [Marks(role="unsure-dot", x=nothing, y=nothing, label="? inconclusive" if explained else "– no verdict")]
        if "unsure" in roles
        else []
    )
    return items
