"""Charts as data: panels with axes and items. One layout serves all back ends, so that page and files show the same."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Floats


@dataclass(frozen=True)
class Axis:
    """Range, label and ticks (value, text) of one axis; with ``powers`` the values are log10."""

    label: str
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]
    powers: bool = False


@dataclass(frozen=True)
class Curve:
    """A line through points; NaN interrupts it. With an empty label it is not in the legend."""

    role: str
    x: Floats
    y: Floats
    label: str = ""


@dataclass(frozen=True)
class Area:
    """A filled band between two curves."""

    role: str
    x: Floats
    low: Floats
    high: Floats
    label: str = ""


@dataclass(frozen=True)
class Span:
    """Vertical stripes over the whole height, (n, 2) edges."""

    role: str
    edges: Floats
    label: str = ""


@dataclass(frozen=True)
class LevelLine:
    """A horizontal line over the whole width."""

    role: str
    y: float
    label: str = ""


@dataclass(frozen=True, kw_only=True)
class Marks:
    """Symbols at points or, if ``y`` is None, at the fraction ``at`` of the height."""

    role: str
    x: Floats
    y: Floats | None = None
    label: str = ""
    at: float = 0.0
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Note:
    """A short text at ``x`` and the fraction ``at`` of the height, which is its middle or, if rotated, its end."""

    role: str
    x: float
    at: float
    text: str
    rotated: bool = False


@dataclass(frozen=True)
class Tiles:
    """Filled rectangles, (n, 4) edges left, right, low, high; ``names`` are shown under the pointer."""

    role: str
    edges: Floats
    label: str = ""
    names: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Word:
    """A text centred at a point."""

    role: str
    x: float
    y: float
    text: str
    size: float = 8.0
    bold: bool = False
    anchor: str = "middle"


#: Kinds of labelled items, in the order of a legend.
KINDS: dict[type[Item], str] = {Curve: "curve", Area: "area", Tiles: "tiles", Marks: "marks", LevelLine: "level", Span: "span"}

Item = Curve | Area | Span | LevelLine | Marks | Note | Tiles | Word


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One pair of axes; ``weight`` is its share of the height.

    ``title`` is shown above panels that lie side by side; without ``grid`` only the labels of the ticks are drawn.
    ``steps`` has the first x and the step between the points of the curves if these are equidistant, to read them back exactly.
    """

    x: Axis
    y: Axis
    items: tuple[Item, ...]
    weight: float = 1.0
    title: str = ""
    grid: bool = True
    steps: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Chart:
    """A figure: panels from top to bottom, or from left to right.

    Attributes
    ----------
    title, subtitle : str
    alt : str
        Description for readers who cannot see the figure.
    panels : tuple of Panel
    width, height : float
        Size of the plot without title and legend [points].
    beside : bool
        Whether the panels lie side by side.
    left : float
        Room for the labels at the left [points].
    """

    title: str
    subtitle: str
    alt: str
    panels: tuple[Panel, ...]
    width: float = 620.0
    height: float = 330.0
    beside: bool = False
    left: float = 50.0

    def legend(self) -> list[tuple[str, str, str]]:
        """Return (role, kind, label) of all labelled items, each label once; lines first, stripes last."""
        found: dict[str, tuple[str, str, str]] = {}
        for panel in self.panels:
            for item in panel.items:
                label = "" if isinstance(item, Note | Word) else item.label
                if label and label not in found:
                    found[label] = (item.role, KINDS[type(item)], label)
        order = list(KINDS.values())
        return sorted(found.values(), key=lambda entry: order.index(entry[1]))


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 6) -> str:
    """Format a number like ``format(value, 'g')`` with `digits` digits and a true minus sign."""
    return f"{value:.{digits}g}".replace("-", "−")


def linear_axis(label: str, low: float, high: float, count: int = 6) -> Axis:
    """Return an axis with about ``count`` ticks at round values inside ``low..high``."""
    if not np.isfinite([low, high]).all():
        low, high = 0.0, 1.0
    if high - low <= 1e-12 * max(abs(low), abs(high), 1e-300):
        low, high = low - 0.5, high + 0.5
    raw = (high - low) / count
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * next(factor for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * power >= raw * 0.999)
    ticks = np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) * step
    return Axis(label, float(low), float(high), tuple((float(tick), number(tick + 0.0)) for tick in ticks))


def decade_axis(label: str, low: float, high: float) -> Axis:
    """Return an axis for log10 values with whole decades marked as powers of ten."""
    if not np.isfinite([low, high]).all():
        low, high = 0.0, 1.0
    if high - low < 1.0:
        middle = (low + high) / 2
        low, high = middle - 0.6, middle + 0.6
    every = max(1, int(np.ceil((high - low) / 6)))
    decades = range(int(np.ceil(low - 1e-9)), int(np.floor(high + 1e-9)) + 1)
    ticks = tuple((float(k), "10" + str(k).translate(_SUPERSCRIPT)) for k in decades if k % every == 0)
    return Axis(label, float(low), float(high), ticks, powers=True)


def span_of(arrays: Iterable[Floats]) -> tuple[float, float]:
    """Return the smallest and largest finite value of all arrays; NaN if there is none."""
    finite = [array[np.isfinite(array)] for array in arrays]
    values = np.concatenate([np.empty(0), *finite])
    return (float(values.min()), float(values.max())) if values.size else (float("nan"), float("nan"))
