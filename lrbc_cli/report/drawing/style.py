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

#: Steps of the two scales below.
PROBABILITIES, COSINES = 10, 11
# Probability of being loose: pale to dark on white, dark to bright on the dark page, so that grey tells as well.
_LOOSE = (("#e1e8ee", "#f0b65c", "#a33600"), ("#262d36", "#96641c", "#ff9b57"))
# FDAC: the two signs differ in hue and in depth; nothing in common is the page's own colour.
_FDAC = (("#e08a33", "#ffffff", "#0b4a86"), ("#b8660f", "#14181d", "#8fcbff"))


def _rgb(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[k : k + 2], 16) for k in (1, 3, 5))


def _blend(stops: tuple[str, str, str], at: float) -> str:
    low, high = (stops[0], stops[1]) if at < 0.5 else (stops[1], stops[2])
    share = 2.0 * at - (at >= 0.5)
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(_rgb(low), _rgb(high), strict=True))


def luminance(colour: str) -> float:
    """Return the relative luminance of a colour ``#rrggbb``, as WCAG 2 defines it."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (part / 255 for part in _rgb(colour))]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _ink(colour: str) -> str:
    """Return the ink, dark or light, that stands out more on a colour."""
    return "#14181d" if luminance(colour) > 0.19 else "#ffffff"


def _scales() -> dict[str, Style]:
    roles: dict[str, Style] = {}
    for step in range(PROBABILITIES):
        light, dark = (_blend(stops, step / (PROBABILITIES - 1)) for stops in _LOOSE)
        ink, dark_ink = _ink(light), _ink(dark)
        roles[f"p{step}"] = Style(light, dark, marker="circle", size=7.0)
        roles[f"on{step}"] = Style(ink, dark_ink)
        roles[f"loose-on{step}"] = Style(ink, dark_ink, width=1.5, marker="cross", size=2.7)
        roles[f"tight-on{step}"] = Style(ink, dark_ink, marker="circle", size=1.3)
    for step in range(COSINES):
        light, dark = (_blend(stops, step / (COSINES - 1)) for stops in _FDAC)
        roles[f"fdac{step}"] = Style(light, dark)
    return roles


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
    "tight-state": Style("#008a64", "#2fc79b", width=1.4),
    "coherence": Style("#6b7280", "#a3acb8", width=1.0),
    "channel": Style("#4c9fd6", "#3f84ba"),
    "channel-unseen": Style("#e0a33e", "#b8811f"),
    "before": Style("#5a626d", "#a5aeb9", width=1.6),
    "whisker": Style("#5a626d", "#a5aeb9", width=1.2),
    "stated": Style("#b0508a", "#e58fc0", width=1.6, marker="cross", size=3.4),
    "tight": Style("#15191e", "#f1f3f6", marker="circle", size=2.5),
    "removed": Style("#8a929d", "#929ba7", width=1.3, marker="cross", size=3.2),
    "bolt": Style("#5a626d", "#a5aeb9", width=1.0, marker="ring", size=2.6),
    "loose-name": Style("#a33600", "#ff9c5f"),
    "loose": Style("#d55e00", "#ff8a3d", opacity=0.17),
    "undecided": Style("#c98a00", "#f0b840", opacity=0.13),
    "outside": Style("#c4c8cd", "#474d55"),
    "outside-on": Style("#3b424b", "#d5dae0"),
    "outside-dot": Style("#c4c8cd", "#474d55", marker="circle", size=7.0),
    "outside-stripe": Style("#8b93a0", "#8b93a0", opacity=0.2),
    "open": Style("#0a74c4", "#4fb0f0", opacity=0.06),
    "open-up": Style("#0a74c4", "#4fb0f0", marker="up", size=2.4),
    "open-down": Style("#0a74c4", "#4fb0f0", marker="down", size=2.4),
    "unknown": Style("#d5d9df", "#3d4550"),
    "unknown-dot": Style("#d5d9df", "#3d4550", marker="circle", size=7.0),
    "hatch": Style("#5a626d", "#a5aeb9", width=0.9),
    "known": Style("#14181d", "#eceff3", width=1.8, marker="ring", size=9.2),
    "known-dot": Style("#14181d", "#eceff3", width=1.8, marker="ring", size=4.0),
    "unsure-dot": Style("#5a626d", "#a5aeb9", width=1.2, marker="ring", size=4.0),
    "edge": Style("#b4bac3", "#4c545f", width=3.0),
    "mesh": Style("#c3cad3", "#444c57", width=0.5),
    "mesh-dot": Style("#aab2bd", "#566070", marker="circle", size=1.0),
    "shape": Style("#1a8cf0", "#3aa0f5", width=0.45),
    "shape-dot": Style("#1a8cf0", "#3aa0f5", marker="circle", size=1.0),
    "measured-way": Style("#15191e", "#f1f3f6", width=1.0),
    "measured-point": Style("#15191e", "#f1f3f6", marker="circle", size=2.6),
    "modelled-point": Style("#d55e00", "#ff8a3d", width=1.2, marker="ring", size=3.6),
    "air": Style("#9fc3dd", "#3f6480", marker="circle", size=0.8),
    "box": Style("#8b93a0", "#767f8b", width=0.8),
    "term": Style("#4f9ad6", "#2f7fbe", width=2.4),
    "term-dot": Style("#4f9ad6", "#2f7fbe", marker="circle", size=2.0),
    "sensor": Style("#009e73", "#2fc79b", marker="square", size=4.0),
    "sensor-unseen": Style("#009e73", "#2fc79b", width=1.4, marker="ring", size=4.0),
    "microphone": Style("#b0508a", "#e58fc0", marker="diamond", size=4.6),
    "microphone-unseen": Style("#b0508a", "#e58fc0", width=1.4, marker="ring", size=4.0),
    "hammer": Style("#14181d", "#eceff3", marker="down", size=5.0),
    "unsure": Style("#5a626d", "#a5aeb9", width=1.2, dash=(2.2, 1.8), marker="ring", size=7.0),
    "diagonal": Style("#d81b60", "#ff8ab5", width=1.0, dash=(3, 2)),
    "tolerance": Style("#d55e00", "#ff8a3d", width=1.2, dash=(6, 3)),
    "taken": Style("#d55e00", "#ff8a3d", marker="up", size=3.4),
    "corner": Style("#d55e00", "#ff8a3d", width=1.6, marker="ring", size=6.0),
    "plan-loss0": Style("#d3e4f1", "#24506d"),
    "plan-loss1": Style("#7fb5dc", "#3878a6"),
    "plan-loss2": Style("#2b7bba", "#4fa3dc"),
    "plan-interval": Style("#14181d", "#eceff3", width=0.8),
    "plan-missed": Style("#d55e00", "#ff8a3d", width=1.6, marker="cross", size=3.0),
    "plan-alarm": Style("#d81b60", "#ff8ab5", width=1.6, marker="ring", size=3.2),
    "plan-limit": Style("#5a626d", "#a5aeb9", width=1.0, dash=(4, 2.6)),
    "plan-candidate": Style("#009e73", "#2fc79b"),
    "plan-planned": Style("#7f97ad", "#6f8ba5"),
    **{f"series{index}": Style(light, dark, 1.5, dash, marker, 3.2) for index, (light, dark, marker, dash) in enumerate(_SERIES)},
    **_scales(),
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
