"""Lays out a chart as shapes in points from its top left corner; back ends only stroke, fill and write these shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.report.drawing.chart import Area, Axis, Chart, Curve, Item, LevelLine, Marks, Note, Panel, Span, Tiles, Word

RIGHT, TOP, BOTTOM, GAP, TITLE = 10.0, 8.0, 36.0, 12.0, 14.0
SMALL, NORMAL, LARGE = 9.0, 10.0, 12.5
_GLYPH = 0.56  # mean width of a character in units of the font size


@dataclass(frozen=True)
class Line:
    """A stroked line, (n, 2) points, interrupted by NaN; ``label`` names curves for readouts."""

    role: str
    points: Floats
    label: str = ""


@dataclass(frozen=True)
class Fill:
    """A filled polygon, (n, 2) corners."""

    role: str
    points: Floats


@dataclass(frozen=True)
class Symbols:
    """Markers of the role's shape at (n, 2) points."""

    role: str
    points: Floats
    names: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Text:
    """A text; ``anchor`` is start, middle or end along the writing direction."""

    role: str
    x: float
    y: float
    text: str
    anchor: str = "start"
    size: float = NORMAL
    bold: bool = False
    rotated: bool = False


@dataclass(frozen=True)
class Mosaic:
    """Filled rectangles, (n, 4) left, top, right, bottom."""

    role: str
    points: Floats
    names: tuple[str, ...] = ()


Shape = Line | Fill | Symbols | Text | Mosaic


@dataclass(frozen=True)
class Frame:
    """A panel laid out: its rectangle (left, top, right, bottom), its axes, and the shapes inside."""

    box: tuple[float, float, float, float]
    panel: Panel
    shapes: tuple[Shape, ...]


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """A chart laid out: the shapes around the panels (title, legend), and the panels."""

    width: float
    height: float
    around: tuple[Shape, ...]
    frames: tuple[Frame, ...]

    @property
    def shapes(self) -> list[Shape]:
        """All shapes in the order in which they are drawn."""
        return [*self.around, *(shape for frame in self.frames for shape in frame.shapes)]


def lay_out(chart: Chart, *, header: bool, title: bool = True) -> Drawing:
    """Compute all shapes of a chart.

    Parameters
    ----------
    chart
        The chart to draw.
    header
        Whether title, subtitle and legend are part of the picture (files) or not (page).
    title
        Whether this header has title and subtitle, or only the legend.
    """
    around: list[Shape] = []
    offset = _header(chart, around, title=title) if header else 0.0
    frames = []
    for panel, box, label_x in _boxes(chart, offset):
        around += _axes(panel, box, label_x=label_x)
        shapes = tuple(shape for item in sorted(panel.items, key=_depth) for shape in _item(item, panel, box))
        frames.append(Frame(box, panel, shapes))
    return Drawing(width=chart.width, height=chart.height + offset, around=tuple(around), frames=tuple(frames))


def _boxes(chart: Chart, offset: float) -> list[tuple[Panel, tuple[float, float, float, float], bool]]:
    """Return each panel with its rectangle, and whether the labels of its x axis are shown below it."""
    found = []
    total = sum(panel.weight for panel in chart.panels)
    top = offset + TOP
    if chart.beside:
        room = chart.width - sum(chart.left + RIGHT for _ in chart.panels)
        left = 0.0
        head = TITLE if any(panel.title for panel in chart.panels) else 0.0
        for panel in chart.panels:
            right = left + chart.left + room * panel.weight / total
            found.append((panel, (left + chart.left, top + head, right, offset + chart.height - BOTTOM), True))
            left = right + RIGHT
        return found
    following = [*(panel.x for panel in chart.panels[1:]), None]
    # Panels over the same axis share the labels of the lowest one.
    below = [
        GAP if panel.x == axis else BOTTOM if panel.x.label else BOTTOM - 14.0 for panel, axis in zip(chart.panels, following, strict=True)
    ]
    room = chart.height - TOP - sum(below)
    for panel, gap in zip(chart.panels, below, strict=True):
        bottom = top + room * panel.weight / total
        found.append((panel, (chart.left, top, chart.width - RIGHT, bottom), gap != GAP))
        top = bottom + gap
    return found


def _depth(item: Item) -> int:
    return (Span, Tiles, Area, LevelLine, Curve, Marks, Note, Word).index(type(item))


def _header(chart: Chart, shapes: list[Shape], *, title: bool) -> float:
    left, top = min(chart.left, 50.0), 14.0
    if title:
        shapes.append(Text(role="strong", x=left, y=18.0, text=chart.title, size=LARGE, bold=True))
        top = 33.0
    if title and chart.subtitle:
        shapes.append(Text(role="text", x=left, y=top, text=chart.subtitle, size=NORMAL))
        top += 16.0
    x = left
    for role, kind, label in chart.legend():
        width = 24.0 + _GLYPH * SMALL * len(label) + 14.0
        if x > left and x + width > chart.width - RIGHT:
            x, top = left, top + 14.0
        shapes += swatch(role, kind, x, top - 3.0)
        shapes.append(Text(role="text", x=x + 22.0, y=top, text=label, size=SMALL))
        x += width
    return top + 4.0


def swatch(role: str, kind: str, x: float, y: float) -> list[Shape]:
    """Return the symbol before a legend entry: 16 points wide, centred at the height ``y``."""
    if role == "hatch":
        # The same hatching as in the corners of a cell.
        ends = [((0, 0), (4, -4)), ((0, 4), (8, -4)), ((8, 4), (16, -4)), ((12, 4), (16, 0))]
        return [Line(role, np.array([[x + a, y + b] for a, b in pair])) for pair in ends]
    if kind == "tiles" and role == "known":
        return [Line(role, np.array([[x + 1, y - 4], [x + 15, y - 4], [x + 15, y + 4], [x + 1, y + 4], [x + 1, y - 4]]))]
    if kind in {"area", "span", "tiles"}:
        return [Fill(role, np.array([[x, y - 4], [x + 16, y - 4], [x + 16, y + 4], [x, y + 4]]))]
    if kind == "marks":
        return [Symbols(role, np.array([[x + 8, y]]))]
    return [Line(role, np.array([[x, y], [x + 16, y]]))]


def _scale(axis: Axis, values: Floats, start: float, end: float) -> Floats:
    scaled = start + (np.asarray(values, dtype=float) - axis.low) / (axis.high - axis.low) * (end - start)
    # Infinite values (a free or clamped term) are drawn at the frame; NaN stays a gap.
    return np.clip(scaled, min(start, end), max(start, end))


def _axes(panel: Panel, box: tuple[float, float, float, float], *, label_x: bool) -> list[Shape]:
    left, top, right, bottom = box
    shapes: list[Shape] = []
    for value, text in panel.x.ticks:
        x = float(_scale(panel.x, np.array(value), left, right))
        if panel.grid:
            shapes.append(Line("grid", np.array([[x, top], [x, bottom]])))
        if label_x:
            shapes.append(Text(role="text", x=x, y=bottom + 13.0, text=text, anchor="middle", size=SMALL))
    for value, text in panel.y.ticks:
        y = float(_scale(panel.y, np.array(value), bottom, top))
        if panel.grid:
            shapes.append(Line("grid", np.array([[left, y], [right, y]])))
        shapes.append(Text(role="text", x=left - 5.0, y=y + 3.2, text=text, anchor="end", size=SMALL))
    if panel.grid:
        shapes.append(Line("frame", np.array([[left, top], [left, bottom], [right, bottom]])))
    if panel.title:
        shapes.append(Text(role="text", x=(left + right) / 2, y=top - 5.0, text=panel.title, anchor="middle", size=NORMAL))
    if label_x and panel.x.label:
        shapes.append(Text(role="text", x=(left + right) / 2, y=bottom + 28.0, text=panel.x.label, anchor="middle", size=NORMAL))
    if panel.y.label:
        shapes.append(
            Text(role="text", x=left - 38.0, y=(top + bottom) / 2, text=panel.y.label, anchor="middle", size=NORMAL, rotated=True)
        )
    return shapes


def _item(item: Item, panel: Panel, box: tuple[float, float, float, float]) -> list[Shape]:
    left, top, right, bottom = box

    def across(values: Floats) -> Floats:
        return _scale(panel.x, values, left, right)

    def up(values: Floats) -> Floats:
        return _scale(panel.y, values, bottom, top)

    match item:
        case Curve():
            return [Line(item.role, np.column_stack([across(item.x), up(item.y)]), item.label)]
        case Area():
            keep = np.asarray(~(np.isnan(item.low) | np.isnan(item.high)))
            x = across(item.x[keep])
            outline = np.concatenate([np.column_stack([x, up(item.low[keep])]), np.column_stack([x[::-1], up(item.high[keep])[::-1]])])
            return [Fill(item.role, outline)] if keep.any() else []
        case Span():
            edges = across(item.edges)
            return [Fill(item.role, np.array([[a, top], [b, top], [b, bottom], [a, bottom]])) for a, b in edges]
        case LevelLine():
            y = float(up(np.array(item.y)))
            return [Line(item.role, np.array([[left, y], [right, y]]))]
        case Marks():
            height = np.full(len(item.x), bottom - item.at * (bottom - top)) if item.y is None else up(item.y)
            points = np.column_stack([across(item.x), height])
            present = np.asarray(~np.isnan(points).any(axis=1))
            names = tuple(name for name, kept in zip(item.names, present, strict=True) if kept) if item.names else ()
            return [Symbols(item.role, points[present], names)] if present.any() else []
        case Tiles():
            boxes = np.column_stack([across(item.edges[:, 0]), up(item.edges[:, 3]), across(item.edges[:, 1]), up(item.edges[:, 2])])
            boxes = np.column_stack([np.minimum(boxes[:, :2], boxes[:, 2:]), np.maximum(boxes[:, :2], boxes[:, 2:])])
            return [Mosaic(item.role, boxes, item.names)] if len(boxes) else []
        case Word():
            middle = float(up(np.array(item.y))) + 0.36 * item.size
            return [
                Text(
                    role=item.role,
                    x=float(across(np.array(item.x))),
                    y=middle,
                    text=item.text,
                    anchor=item.anchor,
                    size=item.size,
                    bold=item.bold,
                )
            ]
        case Note():
            place, level = float(across(np.array(item.x))), bottom - item.at * (bottom - top)
            return [
                Text(
                    role=item.role,
                    x=place + (3.0 if item.rotated else 0.0),
                    y=level,
                    text=item.text,
                    anchor="end" if item.rotated else "middle",
                    size=SMALL,
                    rotated=item.rotated,
                )
            ]
