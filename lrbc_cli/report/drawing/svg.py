"""Draws charts as inline SVG, with the colours of the page's style sheet for light and dark pages and print."""

from __future__ import annotations

import math
import pickle
from collections.abc import Iterable
from html import escape

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.remembered import Remembered
from lrbc_cli.report.drawing.chart import Chart
from lrbc_cli.report.drawing.layout import Drawing, Fill, Frame, Line, Mosaic, Shape, Symbols, Text, lay_out, swatch
from lrbc_cli.report.drawing.style import STYLES
from lrbc_cli.report.html import Markup, figure, tag

# Coordinates are written as whole numbers in tenths of a point: short, and finer than any screen.
_SCALE = 10.0
#: Least height of letters [pixels].
_LEAST = 9.05

#: Cache of the last charts drawn.
_drawn = Remembered[Markup](2000)


def svg(chart: Chart) -> Markup:
    """Return the chart as one ``svg`` element with its alternative text."""
    return _drawn.of(pickle.dumps(chart), lambda: _element(lay_out(chart, header=False), label=chart.alt))


def drawn(chart: Chart, files: Markup | None = None, *, title: str | None = None, **attributes: str | bool | None) -> Markup:
    """Return the chart as a figure with its own title or another one."""
    return figure(svg(chart), title or chart.title, chart.subtitle, files, **attributes)


def with_rows(chart: Chart) -> Markup:
    """Return the chart as two drawings side by side, so that the labels of its rows stay in place while the rest is scrolled."""
    drawing = lay_out(chart, header=False)
    rows = [shape for shape in drawing.around if isinstance(shape, Text) and shape.anchor == "end"]
    rest = tuple(shape for shape in drawing.around if not (isinstance(shape, Text) and shape.anchor == "end"))
    left, width, height = (round(size * _SCALE) for size in (chart.left, drawing.width, drawing.height))
    labels = Markup("".join(map(markup_of, rows)))
    return tag(
        "div",
        tag("svg", labels, viewBox=f"0 0 {left} {height}", aria_hidden="true", style=f"flex:{left} 0 0"),
        tag("svg", _body(rest, drawing.frames), viewBox=f"{left} 0 {width - left} {height}", role="img", aria_label=chart.alt,
            style=f"flex:{width - left} 0 0"),
        class_="rows",
        style=f"min-width:{least_width(drawing):.0f}px",
    )  # fmt: skip


def least_width(drawing: Drawing) -> float:
    """Width [pixels] at which the smallest letters of a drawing have `_LEAST` pixels; narrower screens scroll it."""
    sizes = [shape.size for shape in drawing.shapes if isinstance(shape, Text)]
    return math.ceil(drawing.width * _LEAST / min(sizes)) if sizes else 0.0


def own_size(chart: Chart) -> str:
    """CSS of an element that shows a drawing at the size of its letters, independent of the width of the page."""
    return f"max-width:{max(1.35 * chart.width, least_width(lay_out(chart, header=False))):.0f}px"


def legend(chart: Chart) -> Markup:
    """Return the chart's legend as an HTML list."""
    entries = []
    for role, kind, label in chart.legend():
        shapes = "".join(markup_of(shape) for shape in swatch(role, kind, 1.0, 6.0))
        swatches = Markup(f'<svg viewBox="0 0 180 120" width="18" height="12" aria-hidden="true">{shapes}</svg>')
        entries.append(tag("li", swatches, label, data_role=role))
    return tag("ul", *entries, class_="legend")


def _element(drawing: Drawing, label: str) -> Markup:
    box = f"0 0 {drawing.width * _SCALE:.0f} {drawing.height * _SCALE:.0f}"
    return tag(
        "svg",
        _body(drawing.around, drawing.frames),
        viewBox=box,
        role="img",
        aria_label=label,
        style=f"min-width:{least_width(drawing):.0f}px",
    )


def _body(around: Iterable[Shape], frames: Iterable[Frame]) -> Markup:
    return Markup("".join(map(markup_of, around)) + "".join(map(_frame, frames)))


def _frame(frame: Frame) -> str:
    left, top, right, bottom = (round(edge * _SCALE) for edge in frame.box)
    x, y = frame.panel.x, frame.panel.y
    shapes = Markup("".join(markup_of(shape) for shape in frame.shapes))
    hit = Markup(f'<rect class="hit" x="{left}" y="{top}" width="{right - left}" height="{bottom - top}"/>')
    return tag(
        "g",
        # Below the shapes, so that the pointer reaches them and shows their titles.
        hit,
        shapes,
        class_="panel",
        data_x=f"{x.low:.9g} {x.high:.9g}",
        data_y=f"{y.low:.9g} {y.high:.9g}",
        data_xl=x.label,
        data_yl=y.label,
        data_scale="log" if y.powers else None,
        data_steps=None if frame.panel.steps is None else "{:.9g} {:.9g}".format(*frame.panel.steps),
    )


def markup_of(shape: Shape) -> str:
    """Return one shape as SVG, in tenths of a point."""
    style = STYLES[shape.role]
    match shape:
        case Line():
            dash = f' stroke-dasharray="{" ".join(f"{part * _SCALE:g}" for part in style.dash)}"' if style.dash else ""
            name = f' data-name="{escape(shape.label)}"' if shape.label else ""
            return f'<path class="l r-{shape.role}" stroke-width="{style.width * _SCALE:g}"{dash}{name} d="{path(shape.points)}"/>'
        case Fill():
            return f'<path class="f r-{shape.role}" opacity="{style.opacity:g}" d="{path(shape.points)}Z"/>'
        case Symbols():
            return _symbols(shape)
        case Mosaic():
            return _mosaic(shape)
        case Text():
            x, y = round(shape.x * _SCALE), round(shape.y * _SCALE)
            turn = f' transform="rotate(-90 {x} {y})"' if shape.rotated else ""
            bold = ' font-weight="600"' if shape.bold else ""
            place = f'x="{x}" y="{y}" text-anchor="{shape.anchor}" font-size="{shape.size * _SCALE:g}"'
            return tag("text", shape.text, markup=Markup(f'class="t r-{shape.role}" {place}{bold}{turn}'))


def path(points: Floats) -> str:
    """Return SVG path data: absolute starts, relative steps, a new start after every NaN."""
    if len(points) == 2 and np.isfinite(points).all():
        # A fast path for lines of two points: most belong to axes.
        x, y, end_x, end_y = (round(value * _SCALE) for value in points.ravel().tolist())
        return f"M{x} {y}l{end_x - x} {end_y - y}".replace(" -", "-")
    whole = np.asarray(np.isfinite(points).all(axis=1))
    rounded = np.rint(np.where(whole[:, None], points, 0.0) * _SCALE).astype(int)
    steps = np.diff(rounded, axis=0).ravel().tolist()
    starts = np.flatnonzero(whole & ~np.concatenate([[False], whole[:-1]]))
    ends = np.flatnonzero(whole & ~np.concatenate([whole[1:], [False]])) + 1
    parts = []
    for start, end, (x, y) in zip(starts.tolist(), ends.tolist(), rounded[starts].tolist(), strict=True):
        way = " ".join(map(str, steps[2 * start : 2 * (end - 1)]))
        parts.append(f"M{x} {y}" + (f"l{way}" if way else "h0"))
    return "".join(parts).replace(" -", "-")


def _mosaic(shape: Mosaic) -> str:
    corners = np.rint(shape.points * _SCALE).astype(int)
    pieces = [f"M{left} {top}h{right - left}v{bottom - top}h{left - right}z" for left, top, right, bottom in corners.tolist()]
    if not shape.names:
        return f'<path class="f m r-{shape.role}" d="{"".join(pieces)}"/>'
    return "".join(
        f'<path class="f m r-{shape.role}" d="{piece}">{tag("title", name)}</path>' for piece, name in zip(pieces, shape.names, strict=True)
    )


def _symbols(shape: Symbols) -> str:
    style = STYLES[shape.role]
    r = round(style.size * _SCALE)
    form = outline(style.marker, r)
    kind = "l" if style.marker in {"ring", "cross", "plus", "bar"} else "f"
    stroke = f' stroke-width="{style.width * _SCALE:g}"' if kind == "l" else ""
    if not shape.names:
        parts = "".join(f"M{round(x * _SCALE)} {round(y * _SCALE)}{form}" for x, y in shape.points)
        return f'<path class="{kind} r-{shape.role}"{stroke} d="{parts}"/>'
    return "".join(
        f'<path class="{kind} r-{shape.role}"{stroke} d="M{round(x * _SCALE)} {round(y * _SCALE)}{form}">{tag("title", name)}</path>'
        for (x, y), name in zip(shape.points, shape.names, strict=True)
    )


def outline(marker: str, r: int) -> str:
    """Return the outline of a marker as relative path data that starts at its centre."""
    match marker:
        case "cross":
            return f"m{-r}-{r}l{2 * r} {2 * r}m0-{2 * r}l{-2 * r} {2 * r}"
        case "plus":
            return f"m{-r} 0h{2 * r}m{-r}-{r}v{2 * r}"
        case "bar":
            return f"m0-{r}v{2 * r}"
        case "square":
            return f"m{-r}-{r}h{2 * r}v{2 * r}h{-2 * r}z"
        case "diamond":
            return f"m0-{r}l{r} {r}l{-r} {r}l{-r}-{r}z"
        case "up":
            return f"m0-{r}l{r} {2 * r}h{-2 * r}z"
        case "down":
            return f"m0 {r}l{r}-{2 * r}h{-2 * r}z"
        case _:
            return f"m{-r} 0a{r} {r} 0 1 0 {2 * r} 0a{r} {r} 0 1 0 {-2 * r} 0"
