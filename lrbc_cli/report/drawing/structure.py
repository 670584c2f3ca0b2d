"""The structure as a scene of lines, dots and symbols in space, and its projection; the page can rotate the same scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Axis, Curve, Item, Marks, Panel, Word, linear_axis
from lrbc_cli.report.drawing.names import GLYPH, names_beside
from lrbc_cli.results.structure import DrawnPoint, StructureRecord

#: A structure is flat if it is thinner than this share of its size.
_FLAT = 0.02
#: Room around the structure for names, in points, and the largest height of a picture.
_MARGIN, _HIGHEST = 30.0, 430.0
#: Length of the line that shows the direction of a sensor, as a share of the size.
_STUB = 0.05


@dataclass(frozen=True)
class Camera:
    """Direction of view [degrees]: azimuth about z from x, elevation above the x-y plane."""

    azimuth: float
    elevation: float

    @property
    def axes(self) -> Floats:
        """Unit vectors (2, 3) to the right and upwards in the picture."""
        a, e = np.radians([self.azimuth, self.elevation])
        return np.array([[-np.sin(a), np.cos(a), 0.0], [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]])


@dataclass(frozen=True)
class Ruler:
    """An edge of the box around the structure: its (2, 3) ends, its ticks and its label."""

    ends: Floats
    ticks: tuple[tuple[Floats, str], ...]
    label: str


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Everything that is drawn of a structure.

    Attributes
    ----------
    camera : Camera
        Plan view of a flat structure, otherwise a view from the front and above.
    plane : str
        The two coordinates of a plan view; empty for a view in space.
    low, high : (3,) float arrays
        Corners of the box around the structure and what is placed on it, and around the air of a view in space [m].
    middle : (3,) float array
        Middle of the structure without air [m].
    segments : mapping of str to (k, 2, 3) float arrays
        Lines by role.
    dots : mapping of str to (n, 3) float arrays
    marks : tuple of (str, DrawnPoint)
        Excitations and responses with their roles.
    rulers : tuple of Ruler
    labels : mapping of str to str
        Texts of the legend by role.
    """

    camera: Camera
    plane: str
    low: Floats
    high: Floats
    middle: Floats
    segments: Mapping[str, Floats]
    dots: Mapping[str, Floats]
    marks: tuple[tuple[str, DrawnPoint], ...]
    rulers: tuple[Ruler, ...]
    labels: Mapping[str, str]


def scene_of(record: StructureRecord) -> Scene:
    """Return the scene of a structure that has a picture."""
    solid = np.concatenate([field.xyz for field in record.fields if field.field == "structure"] or [record.fields[0].xyz])
    camera, plane = _camera(np.ptp(solid, axis=0))
    placed = [*(point.position for point in (*record.excitations, *record.responses)), *(bolt.position for bolt in record.bolts)]
    points = np.concatenate([solid, np.array(placed).reshape(-1, 3), *([] if plane else [field.xyz for field in record.fields])])
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.ptp(solid, axis=0).max())
    segments: dict[str, list[Floats]] = {}
    dots: dict[str, list[Floats]] = {}
    labels: dict[str, str] = {}
    for field in record.fields:
        role, what = ("mesh", "structure") if field.field == "structure" else ("air", "air")
        pairs = np.array(field.lines, dtype=np.int64).reshape(-1, 2)
        segments.setdefault("mesh", []).append(field.xyz[pairs])
        alone = np.ones(len(field.xyz), dtype=bool)
        alone[pairs.ravel()] = False
        dots.setdefault("air" if role == "air" else "mesh-dot", []).append(field.xyz[alone])
        count = fmt.count(field.count) if field.count == len(field.xyz) else f"{fmt.count(len(field.xyz))} of {fmt.count(field.count)}"
        labels[role if len(pairs) or role == "air" else "mesh-dot"] = f"{what}, {count} nodes"
    for group in record.terms:
        if group.along_edge:
            segments.setdefault("term", []).append(np.stack([group.positions[:-1], group.positions[1:]], axis=1))
        elif len(group.springs):
            segments.setdefault("term", []).append(group.springs.reshape(-1, 2, 3))
        else:
            dots.setdefault("term-dot", []).append(group.positions)
        labels["term" if group.along_edge or len(group.springs) else "term-dot"] = "updated terms"
    marks = [("hammer", point) for point in record.excitations]
    labels |= {"hammer": "excitation"} if marks else {}
    for point in record.responses:
        kind = "microphone" if point.quantity == "pressure" else "sensor"
        role = kind if point.used else f"{kind}-unseen"
        marks.append((role, point))
        labels[role] = kind if point.used else f"{kind} for validation"
    for role, point in marks:
        if point.direction is not None:
            stub = np.stack([point.position, point.position + _STUB * size * point.direction])
            segments.setdefault(role, []).append(stub[None])
    return Scene(
        camera=camera,
        plane=plane,
        low=low,
        high=high,
        middle=0.5 * (solid.min(axis=0) + solid.max(axis=0)),
        segments={role: np.concatenate(parts) for role, parts in segments.items() if sum(map(len, parts))},
        dots={role: np.concatenate(parts) for role, parts in dots.items() if sum(map(len, parts))},
        marks=tuple(marks),
        rulers=tuple(_ruler(axis, low, high) for axis in range(3) if high[axis] - low[axis] > 4 * _FLAT * size),
        labels=labels,
    )


def _camera(extent: Floats) -> tuple[Camera, str]:
    thin = extent <= _FLAT * extent.max()
    if not thin.any():
        return Camera(-60.0, 25.0), ""
    # A beam is flat in two directions: seen from above if possible, else from the front.
    axis = 2 if thin[2] else int(np.flatnonzero(thin)[0])
    return (Camera(0.0, 0.0), "yz") if axis == 0 else (Camera(-90.0, 0.0), "xz") if axis == 1 else (Camera(-90.0, 90.0), "xy")


def _ruler(axis: int, low: Floats, high: Floats) -> Ruler:
    # The edges in front, to the right and to the left in the first view.
    start = np.array([high[0] if axis == 1 else low[0], low[1], low[2]])
    end = start.copy()
    end[axis] = high[axis]
    ticks = []
    for value, text in linear_axis("", float(low[axis]), float(high[axis]), 4).ticks:
        place = start.copy()
        place[axis] = value
        ticks.append((place, text))
    return Ruler(np.stack([start, end]), tuple(ticks), f"{'xyz'[axis]} [m]")


def panel_of(scene: Scene, width: float, left: float, extra: list[Item]) -> tuple[Panel, float, float]:
    """Return the still picture with further items, its height and its scale in points per metre.

    Parameters
    ----------
    scene
        The scene to draw.
    width, left : float
        Width of the chart, and of the labels at its left [points].
    extra
        Items drawn above all others.
    """
    view = scene.camera.axes.T
    corners = np.array(np.meshgrid(*zip(scene.low, scene.high, strict=True))).reshape(3, -1).T @ view
    marks = np.array([point.position for _, point in scene.marks]).reshape(-1, 3) @ view
    least, most = corners.min(axis=0), corners.max(axis=0)
    inner = width - left - 10.0
    extent = np.maximum(most - least, 1e-9 * float((most - least).max()))
    scale = min((inner - 2 * _MARGIN) / extent[0], (_HIGHEST - 2 * _MARGIN) / extent[1])
    height = float(extent[1]) * scale + 2 * _MARGIN
    middle, half = 0.5 * (least + most), 0.5 * np.array([inner, height]) / scale
    (x0, y0), (x1, y1) = middle - half, middle + half
    items: list[Item] = [
        Curve(role, *broken(segments @ view), scene.labels.get(role, "") if above < 2 else "") for above, role, segments in layers(scene)
    ]
    items += [
        marks_at(role, dots @ view, scene.labels.get(role, "")) for role, dots in scene.dots.items() if not scene.plane or role != "air"
    ]
    for role in dict.fromkeys(role for role, _ in scene.marks):
        chosen = [index for index, (own, _) in enumerate(scene.marks) if own == role]
        names = tuple(scene.marks[index][1].name for index in chosen)
        items.append(marks_at(role, marks[chosen], scene.labels[role], names))
    x, y = Axis("", x0, x1, ()), Axis("", y0, y1, ())
    if scene.plane:
        x, y = linear_axis(f"{scene.plane[0]} [m]", x0, x1, 6), linear_axis(f"{scene.plane[1]} [m]", y0, y1, 5)
    else:
        items += _rulers(scene, scale)
    return Panel(x=x, y=y, items=tuple([*items, *extra]), grid=bool(scene.plane)), height, scale


def marks_at(role: str, places: Floats, label: str, names: tuple[str, ...] = ()) -> Marks:
    """Return symbols at (n, 2) places."""
    return Marks(role=role, x=places[:, 0], y=places[:, 1], label=label, names=names)


def mark_names(scene: Scene, bolts: Mapping[str, Floats], scale: float, limits: tuple[float, float], first: list[int]) -> list[Item]:
    """Return the names of bolts, excitations and responses for which there is room."""
    view = scene.camera.axes.T
    names = [*bolts, *(point.name for _, point in scene.marks)]
    places = np.array([*bolts.values(), *(point.position for _, point in scene.marks)]).reshape(-1, 3) @ view
    terms = scene.segments.get("term", np.empty((0, 2, 3)))
    stubs = [lines for role, lines in scene.segments.items() if role not in {"mesh", "term"}]
    lines = np.concatenate([terms, *stubs])
    along = np.concatenate([lines[:, 0] + share * (lines[:, 1] - lines[:, 0]) for share in np.linspace(0.0, 1.0, 16)])
    taken = [_box(word, scale) for word in ([] if scene.plane else _rulers(scene, scale)) if isinstance(word, Word)]
    return names_beside(names, places, along @ view, scale, limits, first=first, size=7.5, taken=taken)


def _box(word: Word, scale: float) -> tuple[float, float, float, float]:
    """Left, right, low and high edge of a word centred at a point [points]."""
    half = 0.5 * GLYPH * word.size * len(word.text)
    return word.x * scale - half, word.x * scale + half, word.y * scale - 0.5 * word.size, word.y * scale + 0.5 * word.size


def layers(scene: Scene) -> list[tuple[int, str, Floats]]:
    """Return lines by role with their layer: the mesh below the terms and these below those of sensors."""
    order = {"mesh": 0, "term": 1}
    return sorted(((order.get(role, 2), role, lines) for role, lines in scene.segments.items()), key=lambda entry: entry[0])


def broken(segments: Floats) -> tuple[Floats, Floats]:
    """Lines (k, 2, 2) as a single one, with NaN between them."""
    gap = np.full((len(segments), 1, 2), np.nan)
    x, y = np.concatenate([segments, gap], axis=1).reshape(-1, 2).T
    return x, y


def _rulers(scene: Scene, scale: float) -> list[Item]:
    view = scene.camera.axes.T
    middle = 0.5 * (scene.low + scene.high) @ view
    items: list[Item] = []
    for ruler in scene.rulers:
        ends = ruler.ends @ view
        items.append(Curve("box", *ends.T))
        along = (ends[1] - ends[0]) / max(float(np.linalg.norm(ends[1] - ends[0])), 1e-300)
        out = np.array([along[1], -along[0]])
        out *= np.sign(out @ (ends.mean(axis=0) - middle)) or 1.0
        for place, text in (*ruler.ticks, (ruler.ends.mean(axis=0), ruler.label)):
            far = (11.0 if text != ruler.label else 26.0) + (0.5 * GLYPH * 8.0 * len(text) - 4.0) * abs(float(out[0]))
            at = place @ view + out * far / scale
            items.append(Word(role="text", x=float(at[0]), y=float(at[1]), text=text, size=8.0))
            if text != ruler.label:
                tick = np.stack([place @ view, place @ view + out * 3.0 / scale])
                items.append(Curve("box", *tick.T))
    return items
