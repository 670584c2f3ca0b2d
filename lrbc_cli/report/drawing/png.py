"""Draws charts into files by matplotlib: PNG, only if the content has changed, and PDF or SVG in the widths of journals."""

from __future__ import annotations

import hashlib
import struct
import warnings
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path as Outline
from matplotlib.text import Text as TextArtist
from matplotlib.transforms import Affine2D, Transform

from lrbc_cli.io.common import regular_bytes
from lrbc_cli.report.drawing.chart import Chart
from lrbc_cli.report.drawing.layout import Drawing, Fill, Line, Mosaic, Shape, Symbols, Text, lay_out
from lrbc_cli.report.drawing.style import STYLES
from lrbc_cli.report.files import replace

DPI = 120
#: Widths of figures for print [mm] (1, 1.5 or 2 columns), and the least share of their size on a screen to which letters may shrink.
WIDTHS, _LEAST_SCALE = (90.0, 140.0, 190.0), 0.78
_KEY = b"lrbc-chart"
_BACKEND = f"1 {DPI} {matplotlib.__version__} {sorted(STYLES.items())!r}"
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_MARKERS = {"circle": "o", "ring": "o", "cross": "x", "plus": "+", "square": "s", "diamond": "D", "up": "^", "down": "v", "bar": "|"}
_ALIGN: dict[str, Literal["left", "center", "right"]] = {"start": "left", "middle": "center", "end": "right"}


def draw(chart: Chart, file: Path) -> bool:
    """Draw a chart into a PNG file, unless the file already contains this drawing.

    Returns
    -------
    bool
        Whether it was drawn.

    Raises
    ------
    DataError
        If the file cannot be written.
    """
    drawing = lay_out(chart, header=True)
    digest = _digest(drawing)
    if _digest_in(file) == digest:
        return False
    canvas = FigureCanvasAgg(_figure(drawing, 1.0))
    with warnings.catch_warnings(), replace(file) as sink:
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        options = {"metadata": {_KEY.decode(): digest, "Title": chart.title}, "pil_kwargs": {"compress_level": 2}}
        canvas.print_png(sink, **options)  # type: ignore[no-untyped-call]
    return True


def publish(chart: Chart, file: Path) -> None:
    """Draw a chart as PDF or SVG, by the ending of the file: legend but no title, one of `WIDTHS`, fonts embedded or as outlines.

    Raises
    ------
    DataError
        If the file cannot be written.
    """
    drawing = lay_out(chart, header=True, title=False)
    points = [width / 25.4 * 72 for width in WIDTHS]
    scale = next((width for width in points if width >= _LEAST_SCALE * drawing.width), points[-1]) / drawing.width
    kind = file.suffix[1:]
    # Without dates, the same results give the same bytes.
    metadata = {"Title": chart.title, **({"CreationDate": None} if kind == "pdf" else {"Date": None})}
    fonts: Any = {"pdf.fonttype": 42, "svg.fonttype": "path", "svg.hashsalt": "lrbc"}
    with matplotlib.rc_context(fonts), warnings.catch_warnings(), replace(file) as sink:
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        _figure(drawing, scale).savefig(sink, format=kind, metadata=metadata)


def _figure(drawing: Drawing, scale: float) -> Figure:
    """Figure of matplotlib with the drawing, enlarged by ``scale``."""
    unit = scale / 72
    figure = Figure(figsize=(drawing.width * unit, drawing.height * unit), dpi=DPI, facecolor="white")
    transform = Affine2D().scale(unit, -unit).translate(0, drawing.height * unit) + figure.dpi_scale_trans
    for order, shape in enumerate(drawing.shapes):
        artist = _artist(shape, transform, scale)
        artist.set_zorder(order)
        figure.add_artist(artist)
    return figure


def is_current(chart: Chart, file: Path) -> bool:
    """Return whether a file is a complete PNG with the digest of this chart."""
    return _digest_in(file) == _digest(lay_out(chart, header=True))


def _digest(drawing: Drawing) -> str:
    """Digest of everything that the picture depends on."""
    sink = hashlib.sha256(_BACKEND.encode())
    for shape in drawing.shapes:
        if isinstance(shape, Text):
            sink.update(repr(shape).encode())
        else:
            sink.update(f"{type(shape).__name__} {shape.role} {shape.points.shape}".encode())
            sink.update(np.ascontiguousarray(shape.points).tobytes())
    sink.update(repr((drawing.width, drawing.height)).encode())
    return sink.hexdigest()


def _digest_in(file: Path) -> str | None:
    try:
        data = regular_bytes(file)
    except OSError:
        return None
    if not data.startswith(_SIGNATURE) or not data.endswith(b"IEND\xaeB`\x82"):
        return None
    place = len(_SIGNATURE)
    while place + 8 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, place)
        if kind == b"tEXt":
            key, _, value = data[place + 8 : place + 8 + size].partition(b"\0")
            if key == _KEY:
                return value.decode("latin-1")
        if kind == b"IDAT":
            break
        place += size + 12
    return None


def _artist(shape: Shape, transform: Transform, scale: float) -> Artist:
    style = STYLES[shape.role]
    match shape:
        case Line():
            x, y = shape.points.T
            return Line2D(
                x,
                y,
                color=style.light,
                linewidth=scale * style.width,
                linestyle=(0, tuple(part / style.width for part in style.dash)) if style.dash else "-",
                dash_capstyle="butt",
                solid_joinstyle="round",
                transform=transform,
            )
        case Fill():
            return Polygon(shape.points, closed=True, facecolor=style.light, edgecolor="none", alpha=style.opacity, transform=transform)
        case Mosaic():
            corners = shape.points[:, [[0, 1], [2, 1], [2, 3], [0, 3], [0, 1]]].reshape(-1, 2)
            codes = np.tile([Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY], len(shape.points))
            # Neighbours share edges; without antialiasing there is no visible line between them.
            return PathPatch(Outline(corners, codes), facecolor=style.light, edgecolor="none", antialiased=False, transform=transform)
        case Symbols():
            x, y = shape.points.T
            fill = "none" if style.marker == "ring" else style.light
            return Line2D(
                x,
                y,
                linestyle="none",
                marker=_MARKERS[style.marker],
                markersize=2 * scale * style.size,
                markerfacecolor=fill,
                markeredgecolor=style.light,
                markeredgewidth=scale * style.width if style.marker in {"ring", "cross", "plus", "bar"} else 0.0,
                transform=transform,
            )
        case Text():
            return TextArtist(
                shape.x,
                shape.y,
                shape.text,
                color=style.light,
                fontfamily="DejaVu Sans",
                fontsize=scale * shape.size,
                fontweight="bold" if shape.bold else "normal",
                horizontalalignment=_ALIGN[shape.anchor],
                verticalalignment="baseline",
                rotation=90 if shape.rotated else 0,
                rotation_mode="anchor",
                parse_math=False,
                transform=transform,
            )
