"""Chart of the deflection shapes of a job: the deformed structure, with measured and modelled values at the responses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Axis, Chart, Curve, Item, Panel, Word
from lrbc_cli.report.drawing.structure import Camera, broken, marks_at, scene_of
from lrbc_cli.results.shapes import DeflectionShape, ShapesRecord
from lrbc_cli.results.structure import StructureRecord

#: Drawn size of the largest deflection relative to the structure, and number of pictures in a row.
DEFLECTION, _COLUMNS = 0.1, 3
_WIDTH, _LEFT = 640.0, 12.0


def shape_label(shape: DeflectionShape) -> str:
    """Return the label of a shape."""
    correlation = "" if np.isnan(shape.cosine) else f", FDAC {fmt.fixed(shape.cosine, 2)}"
    return f"{fmt.figures(shape.frequency_hz, 4)} Hz{correlation}"


def points_of(record: StructureRecord, shapes: ShapesRecord, shape: DeflectionShape) -> Iterator[tuple[Floats, Floats, complex, complex]]:
    """Yield place, direction, measured and modelled deflection of each response that has them; pressures point upwards."""
    known = {point.name: point for point in record.responses}
    for index, name in enumerate(shapes.responses):
        point = known.get(name)
        measured = complex(shape.measured_real[index], shape.measured_imag[index])
        modelled = complex(shape.modelled_real[index], shape.modelled_imag[index])
        if point is None or np.isnan([measured, modelled]).any():
            continue
        direction = np.array([0.0, 0.0, 1.0]) if point.quantity == "pressure" else point.direction
        if direction is not None:
            yield point.position, direction, measured, modelled


def fits(record: StructureRecord, shapes: ShapesRecord) -> bool:
    """Return whether shapes belong to the nodes that are drawn."""
    return [len(field.xyz) for field in record.fields if field.field == "structure"] == [shapes.nodes] and bool(shapes.shapes)


def shapes_chart(record: StructureRecord, shapes: ShapesRecord) -> Chart:
    """Return the chart of all shapes of a job, each at the phase of its largest deflection; `shapes` must fit `record`."""
    (field,) = (field for field in record.fields if field.field == "structure")
    scene = scene_of(record)
    # A flat structure deflects out of its plane, so a plan view would not show it.
    view = (Camera(-60.0, 25.0) if scene.plane else scene.camera).axes.T
    size = float(np.ptp(field.xyz, axis=0).max())
    pairs = np.array(field.lines, dtype=np.int64).reshape(-1, 2)
    pictures = []
    for shape in shapes.shapes:
        moved = field.xyz + DEFLECTION * size * shape.real.reshape(-1, 3)
        ways = [
            (at, at + DEFLECTION * size * way * measured.real, at + DEFLECTION * size * way * modelled.real)
            for at, way, measured, modelled in points_of(record, shapes, shape)
        ]
        pictures.append((moved @ view, np.array(ways).reshape(-1, 3, 3) @ view))
    still = field.xyz @ view
    places = np.concatenate([still, *(part.reshape(-1, 2) for picture in pictures for part in picture)])
    low, high = places.min(axis=0), places.max(axis=0)
    cell = (high - low) * [1.15, 1.0] + [0.0, 0.16 * size]
    columns = min(_COLUMNS, len(pictures))
    items: list[Item] = []
    for index, (shape, (moved, points)) in enumerate(zip(shapes.shapes, pictures, strict=True)):
        by = cell * [index % columns, -(index // columns)]
        if len(pairs):
            items += [Curve("mesh", *broken(still[pairs] + by), "at rest"), Curve("shape", *broken(moved[pairs] + by), "model")]
        else:
            items += [marks_at("mesh-dot", still + by, "at rest"), marks_at("shape-dot", moved + by, "model")]
        if len(points):
            items.append(Curve("measured-way", *broken(points[:, :2] + by)))
            items.append(marks_at("measured-point", points[:, 1] + by, "measured"))
            items.append(marks_at("modelled-point", points[:, 2] + by, "model at the sensors"))
        x, y = np.array([0.5 * (low[0] + high[0]), high[1] + 0.08 * size]) + by
        items.append(Word(role="strong", x=float(x), y=float(y), text=shape_label(shape), size=8.0))
    down = cell[1] * (-(-len(pictures) // columns) - 1)
    (x0, y0), (x1, y1) = low - np.array([0.0, down + 0.04 * size]), high + np.array([cell[0] * (columns - 1), 0.14 * size])
    width = _LEFT + 10.0 + (_WIDTH - _LEFT - 10.0) * columns / _COLUMNS
    height = (width - _LEFT - 10.0) * (y1 - y0) / (x1 - x0)
    alt = f"Deflection shapes of job {shapes.job} with excitation {shapes.excitation}: {'; '.join(map(shape_label, shapes.shapes))}."
    panel = Panel(x=Axis("", float(x0), float(x1), ()), y=Axis("", float(y0), float(y1), ()), items=tuple(items), grid=False)
    return Chart(
        title=f"Deflection shapes · {shapes.job}",
        subtitle=f"excitation {shapes.excitation}",
        alt=alt,
        panels=(panel,),
        width=width,
        height=height + 22.0,
        left=_LEFT,
    )
