"""The picture of the structure: a still chart with the verdicts of a job, and one that can be rotated on the page."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.report.drawing.chart import Chart, Item
from lrbc_cli.report.drawing.layout import Shape, Symbols, Text
from lrbc_cli.report.drawing.shapes import DEFLECTION, points_of, shape_label
from lrbc_cli.report.drawing.structure import Scene, layers, mark_names, marks_at, panel_of, scene_of
from lrbc_cli.report.drawing.style import css
from lrbc_cli.report.drawing.svg import legend, markup_of, own_size, svg
from lrbc_cli.report.html import Markup, document, tag
from lrbc_cli.report.parts.strip import bolt_items, bolt_signs, letter_size, told, verdict_key
from lrbc_cli.report.parts.tables import loose_of
from lrbc_cli.results.job import Bolt, JobRecord
from lrbc_cli.results.shapes import DeflectionShape, ShapesRecord
from lrbc_cli.results.structure import StructureRecord
from lrbc_cli.updating.judging.clearance import sentence

_WIDTH = 640.0
#: Coordinates on the page are whole numbers; the size of the structure is this number.
_GRID = 10_000

#: Most characters of deflection shapes on the page, approximately; shapes of further jobs are only figures in their folders.
_ROOM = 1_200_000

_SHAPES = (
    "Shapes: deflection of the updated model under the excitation, at the largest peaks of its mean spectrum. Dots: measured; rings: the "
    "model at the same sensors, to the same scale. Pressures are drawn upwards, as shares of the largest. FDAC compares both over all "
    "responses: 1 is the same shape at the same phase; the phase turns quickly at a sharp peak."
)
_ABOUT = (
    "Drag to turn, or use the arrow keys; + and − zoom, 0 returns to the first view. Names appear where there is room. To see the name of "
    "a symbol, point at it, tap it, or step along the symbols with n."
)


def structure_chart(record: StructureRecord, job: JobRecord | None = None, among: Sequence[JobRecord] = ()) -> Chart:
    """Return the still picture with bolts coloured by the verdicts of a job; jobs in ``among`` have a common legend."""
    scene = scene_of(record)
    view = scene.camera.axes.T
    found = _bolts(record, job)
    bolts = {place.name: place.position for place in record.bolts}
    places = np.array([*bolts.values()]).reshape(-1, 3) @ view
    extra: list[Item] = verdict_key(among or [job]) if job is not None else []
    judged = [index for index, bolt in enumerate(found) if bolt is not None]
    rest = [index for index, bolt in enumerate(found) if bolt is None]
    if rest:
        extra.append(marks_at("bolt", places[rest], "bolt", tuple(record.bolts[index].name for index in rest)))
    if job is not None:
        extra += bolt_items([bolt for bolt in found if bolt is not None], places[judged], explained=job.explained)
    left = 50.0 if scene.plane else 12.0
    panel, height, scale = panel_of(scene, _WIDTH, left, extra)
    first = [index for index, bolt in enumerate(found) if bolt is not None and bolt.verdict in {"loose", "undecided"}]
    words = mark_names(scene, bolts, scale, (panel.x.low, panel.x.high), first)
    panel = replace(panel, items=(*panel.items, *words))
    title, subtitle = (record.campaign, "") if job is None else (job.job, loose_of(job) if job.explained else "no verdict")
    alt = f"Picture of the structure with {len(bolts)} bolts" + (f", job {title}: {subtitle}." if job is not None else ".")
    return Chart(
        title=title, subtitle=subtitle, alt=alt, panels=(panel,), width=_WIDTH, height=height + (44.0 if scene.plane else 22.0), left=left
    )


def _bolts(record: StructureRecord, job: JobRecord | None) -> list[Bolt | None]:
    found = {} if job is None else {bolt.name: bolt for bolt in job.bolts}
    return [found.get(place.name) for place in record.bolts]


def structure_parts(
    record: StructureRecord, jobs: Sequence[JobRecord] = (), shapes: Mapping[str, ShapesRecord] | None = None
) -> list[Markup | None]:
    """Return the rotatable picture with menus of jobs and deflection shapes; it is still if scripts do not run."""
    # Start with the first job that has a loose bolt.
    first = next((index for index, job in enumerate(jobs) if job.names("loose")), 0)
    shown = jobs[first] if jobs else None
    chart = structure_chart(record, shown, jobs)
    scene = scene_of(record)
    options = [tag("option", job.job, value=str(index), selected=index == first) for index, job in enumerate(jobs)]
    choose = tag("label", "Job ", tag("select", *options, name="shown")) if len(jobs) > 1 else None
    buttons = [
        tag("button", text, type="button", data_do=do, title=about)
        for text, do, about in (("First view", "0", "Back to the first view"), ("+", "+", "Zoom in"), ("−", "-", "Zoom out"))
    ]
    switches = [("names", "Names")] + ([("air", "Air")] if "air" in scene.dots else [])
    boxes = [
        tag("label", tag("input", type="checkbox", name=name, checked=name != "air" or not scene.plane), f" {text}")
        for name, text in switches
    ]
    shapes = shapes or {}
    data = json.dumps(_data(record, scene, jobs, first, shapes), ensure_ascii=False, separators=(",", ":")).replace("</", "<\\/")
    stage = tag(
        "div",
        tag("div", svg(chart), class_="still", style=own_size(chart)),
        class_="stage",
        tabindex="0",
        role="group",
        aria_label=f"{chart.alt} {_ABOUT}",
    )
    text = "" if shown is None else f"{shown.job}: {sentence(shown.finding)}"
    thinned = f" {'; '.join(record.notes)}." if record.notes else ""
    return [
        tag("p", "Verdicts of the bolts: ✕ judged loose, ? inconclusive, a dot judged tight.") if jobs else None,
        legend(chart),
        tag(
            "div",
            tag("div", choose, *boxes, *buttons, class_="controls", hidden=True),
            _shape_controls() if shapes else None,
            tag("p", text, class_="told", aria_live="polite") if text else None,
            stage,
            tag("script", Markup(data), type="application/json"),
            class_="turnable",
        ),
        tag("p", _ABOUT + thinned, class_="about"),
        tag("p", _SHAPES, class_="about") if shapes else None,
    ]


def _shape_controls() -> Markup:
    """Menu of deflection shapes, which the script fills with those of the displayed job."""
    size = tag("input", type="range", name="size", min="0.2", max="3", step="0.2", value="1")
    return tag(
        "div",
        tag("label", "Shape ", tag("select", tag("option", "none", value=""), name="shape")),
        tag("label", "Size ", size, class_="moves"),
        tag("button", "Animate", type="button", data_do="play", aria_pressed="false", class_="moves"),
        class_="controls",
        hidden=True,
    )


def _data(
    record: StructureRecord, scene: Scene, jobs: Sequence[JobRecord], first: int, shapes: Mapping[str, ShapesRecord]
) -> dict[str, Any]:
    """Data for the script; the mesh refers to node numbers, since deflection shapes move the nodes."""
    middle, size = 0.5 * (scene.low + scene.high), float((scene.high - scene.low).max())

    def whole(xyz: Floats) -> list[int]:
        return np.rint((xyz - middle) / size * _GRID).astype(int).ravel().tolist()

    solid = [field for field in record.fields if field.field == "structure"]
    glyphs: dict[str, int] = {}

    def glyph(*shapes: Shape) -> int:
        return glyphs.setdefault("".join(map(markup_of, shapes)), len(glyphs))

    at = np.zeros((1, 2))
    plain = glyph(Symbols("bolt", at))
    states, room = [], _ROOM
    for job in jobs:
        bolts = [[plain, place.name] if bolt is None else [glyph(*_shapes(bolt, job)), told(bolt, job.explained)]
                 for place, bolt in zip(record.bolts, _bolts(record, job), strict=True)]  # fmt: skip
        moved = [_shape(record, shapes[job.job], shape, whole) for shape in shapes[job.job].shapes] if job.job in shapes else []
        room -= sum(len(part) for shape in moved for part in shape[1:3])
        states.append({"text": f"{job.job}: {sentence(job.finding)}", "bolts": bolts, "shapes": moved if room >= 0 else []})
    return {
        "camera": [scene.camera.azimuth, scene.camera.elevation],
        "low": whole(scene.low),
        "high": whole(scene.high),
        "middle": whole(scene.middle),
        "nodes": whole(np.concatenate([np.zeros((0, 3)), *(field.xyz for field in solid)])),
        "ends": [end for field in solid for end in field.lines],
        "lines": [[role, whole(lines)] for _, role, lines in layers(scene) if role != "mesh"],
        "deflection": DEFLECTION * _GRID,
        "dots": [[role, whole(dots)] for role, dots in scene.dots.items()],
        "marks": [
            *(
                [p.name, whole(p.position), glyph(Symbols(role, at)), f"{p.name}: {scene.labels[role]}", p.quantity == "pressure"]
                for role, p in scene.marks
            ),
            *([place.name, whole(place.position), plain, place.name] for place in record.bolts),
        ],
        "rulers": [
            [whole(ruler.ends), ruler.label, [[whole(place), text] for place, text in ruler.ticks]] for ruler in scene.rulers
        ],
        "jobs": states,
        "first": first,
        "bolts": len(record.bolts),
        "glyphs": [*glyphs],
    }  # fmt: skip


def _shape(record: StructureRecord, shapes: ShapesRecord, shape: DeflectionShape, whole: Callable[[Floats], list[int]]) -> list[Any]:
    """A shape as bytes scaled to 127 at the largest deflection, and its responses: place, direction, measured and modelled value."""
    bytes_of = [base64.b64encode(np.rint(127.0 * part).astype(np.int8).tobytes()).decode() for part in (shape.real, shape.imag)]
    points = [
        [*whole(at), *way.round(3).tolist(), *np.round([measured.real, measured.imag, modelled.real, modelled.imag], 3).tolist()]
        for at, way, measured, modelled in points_of(record, shapes, shape)
    ]
    return [shape_label(shape), *bytes_of, points]


def _shapes(bolt: Bolt, job: JobRecord) -> list[Shape]:
    """Shapes of the symbol of a bolt about the origin."""
    shapes: list[Shape] = []
    for role, letter in bolt_signs(bolt, job.explained):
        size = letter_size(letter)
        shapes.append(
            Text(role=role, x=0.0, y=0.36 * size, text=letter, anchor="middle", size=size, bold=True)
            if letter
            else Symbols(role, np.zeros((1, 2)))
        )
    return shapes


def structure_page(record: StructureRecord) -> str:
    """Return a self-contained page with only the rotatable picture."""
    heading = tag("header", tag("h1", record.campaign), tag("p", "The structure, its bolts, sensors and updated terms", class_="meta"))
    main = tag("main", tag("section", *structure_parts(record)))
    return document(f"{record.campaign} – the structure", heading, main, colours=css(), scripts=["structure.js"])
