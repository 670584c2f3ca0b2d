"""One table of colours and strokes for page and PNG; told apart by lightness, dash and shape as well as by hue."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Style:
    """Look of everything that plays one role in a chart.

    Attributes
    ----------
    light, dark : str
        Colours on white and on the dark page.
    width : float
        Of lines, in chart units (points).
    dash : tuple of float
        Dash pattern in chart units; empty for solid.
    marker : str
        Shape of marks: circle, ring, cross, plus, square, diamond, up, down, bar.
    size : float
        Radius of marks in chart units.
    opacity : float
        Of filled areas.
    """

    light: str
    dark: str
    width: float = 1.4
    dash: tuple[float, ...] = ()
    marker: str = "circle"
    size: float = 3.0
    opacity: float = 1.0


# The hues of series follow Okabe and Ito's palette for colour-blind readers.
_SERIES = (
    ("#0072b2", "#56b4e9", "circle", ()),
    ("#d55e00", "#ff8a3d", "square", (6, 2)),
    ("#009e73", "#2fc79b", "up", (2, 2)),
    ("#b0508a", "#e58fc0", "diamond", (8, 2, 2, 2)),
    ("#c98a00", "#f0b840", "down", (4, 3)),
    ("#2aa1e0", "#8fd0f5", "plus", (1, 2)),
    ("#6b7280", "#a3acb8", "cross", (10, 3)),
    ("#111827", "#f3f4f6", "ring", (3, 1.5, 1, 1.5)),
)
_STEPS = (
    ("#a9cbe6", "#27496b"),
    ("#7fb2da", "#2f6494"),
    ("#5596c9", "#3f84ba"),
    ("#2f78b3", "#62a5d6"),
    ("#155a94", "#93c6ea"),
    ("#083a6b", "#cfe8fb"),
)

STYLES: dict[str, Style] = {
    "text": Style("#3b434d", "#b7bfca"),
    "strong": Style("#14181d", "#eceff3"),
    "grid": Style("#e6e9ed", "#2b3139", width=0.6),
    "frame": Style("#b4bac3", "#4c545f", width=0.8),
    "measured": Style("#15191e", "#f1f3f6", width=2.4),
    "initial": Style("#7d858f", "#98a1ad", width=1.1, dash=(4, 2.6)),
    "updated": Style("#1a8cf0", "#3aa0f5", width=1.2),
    "selected": Style("#009e73", "#2fc79b", width=0.8, marker="bar", size=3.0),
    "doubtful": Style("#8b93a0", "#8b93a0", opacity=0.16),
    "identified": Style("#0a74c4", "#4fb0f0", width=1.8),
    "reference": Style("#949ca7", "#7e8793", width=1.0),
    "band": Style("#0a74c4", "#4fb0f0", opacity=0.16),
    "tight": Style("#15191e", "#f1f3f6", marker="circle", size=2.5),
    "removed": Style("#8a929d", "#929ba7", width=1.3, marker="cross", size=3.2),
    "bolt": Style("#5a626d", "#a5aeb9", width=1.0, marker="ring", size=2.6),
    "loose": Style("#d55e00", "#ff8a3d", opacity=0.17),
    "undecided": Style("#c98a00", "#f0b840", opacity=0.13),
    "tolerance": Style("#d55e00", "#ff8a3d", width=1.2, dash=(6, 3)),
    "taken": Style("#d55e00", "#ff8a3d", marker="up", size=3.4),
    "corner": Style("#d55e00", "#ff8a3d", width=1.6, marker="ring", size=6.0),
    "quiet": Style("#a3abb6", "#6c7580", width=1.0),
    **{f"series{index}": Style(light, dark, 1.5, dash, marker, 3.2) for index, (light, dark, marker, dash) in enumerate(_SERIES)},
    **{f"step{index}": Style(light, dark, 1.3) for index, (light, dark) in enumerate(_STEPS)},
}
SERIES = len(_SERIES)
STEPS = len(_STEPS)


def css() -> str:
    """Return the colours as CSS custom properties, light and dark, and one class ``r-ROLE`` a role."""
    light = "".join(f"--{role}:{style.light};" for role, style in STYLES.items())
    dark = "".join(f"--{role}:{style.dark};" for role, style in STYLES.items())
    classes = "".join(f".r-{role}{{color:var(--{role})}}" for role in STYLES)
    return f":root{{{light}}}\n@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}\n{classes}\n"
