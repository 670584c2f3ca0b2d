"""Places names beside points of a chart so that they do not overlap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.report.drawing.chart import Curve, Item, Word

#: Width of a character in units of the font size.
GLYPH = 0.6
#: Room taken by a symbol and by a point of a line [points].
_SYMBOL, _DOT = 8.0, 2.0


def names_beside(
    names: Sequence[str],
    places: Floats,
    clear: Floats,
    scale: float,
    limits: tuple[float, float],
    *,
    first: Sequence[int] = (),
    size: float = 7.0,
    taken: Sequence[tuple[float, float, float, float]] = (),
) -> list[Item]:
    """Return names beside their points, clear of other items and inside the figure; names without room are left out.

    Parameters
    ----------
    names
        Names of the points.
    places : (n, 2) float array
        Points in units of the axes.
    clear : (m, 2) float array
        Other points that names must not cover.
    scale : float
        Points of the picture in one unit of the axes.
    limits
        Limits of the horizontal axis.
    first
        Indices of the points whose names are placed first.
    size
        Size of the letters [points].
    taken
        Occupied boxes (left, right, low, high) [points].
    """
    points, (least, most) = places * scale, (limit * scale for limit in limits)
    below, right, left, above = (0.0, -15.5, "middle"), (12.0, 0.0, "start"), (-12.0, 0.0, "end"), (0.0, 15.5, "middle")
    boxes = [*taken, *((x - _SYMBOL, x + _SYMBOL, y - _SYMBOL, y + _SYMBOL) for x, y in points)]
    boxes += [(x - _DOT, x + _DOT, y - _DOT, y + _DOT) for x, y in clear * scale]
    words: list[Item] = []
    for index in [*first, *(index for index in range(len(names)) if index not in first)]:
        x, y = points[index]
        width = GLYPH * size * len(names[index])
        apart = np.abs(points - points[index])
        apart[index] = np.inf
        beside = apart[int(np.argmin(apart.sum(axis=1)))]
        # Points in a vertical row: names go to the side, where they cannot be mistaken for that of the next point.
        upright = len(points) > 1 and beside[1] > beside[0]
        near = (right, left, below, above) if upright else (below, above, right, left)
        # The most important names may be farther away, at the end of a line.
        far = [(30.0 * h, 24.0 * v, "end" if h < 0 else "start") for v in (1, -1) for h in (-1, 1)] if index in first else []
        for dx, dy, anchor in (*near, *far):
            low = x + dx - {"middle": 0.5, "start": 0.0, "end": 1.0}[anchor] * width
            box = (low, low + width, y + dy - 4.0, y + dy + 4.0)
            if low >= least and box[1] <= most and not any(box[0] < b and a < box[1] and box[2] < d and c < box[3] for a, b, c, d in boxes):
                # Keeps a gap, so that two names are not read as one.
                boxes.append((box[0] - _DOT, box[1] + _DOT, *box[2:]))
                place = places[index] + np.array([dx, dy]) / scale
                words.append(Word(role="text", x=float(place[0]), y=float(place[1]), text=names[index], size=size, anchor=anchor))
                if (dx, dy, anchor) in far:
                    words.append(Curve("box", *np.stack([places[index], places[index] + np.array([0.94 * dx, dy]) / scale]).T))
                break
    return words
