"""Colours and strokes of all charts by role; roles differ in lightness, dash and shape as well as in hue."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Style:
    """Look of all items with one role in a chart.

    Attributes
    ----------
    light, dark : str
        Colours on the light and on the dark page.
    width : float
        Width of lines [points].
    dash : tuple of float
        Dash pattern [points]; empty for solid lines.
    marker : str
        Shape of marks: circle, ring, cross, plus, square, diamond, up, down, bar.
    size : float
        Radius of marks [points].
    opacity : float
        Opacity of filled areas.
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
# Probability of being loose: pale to dark on the light page, dark to bright on the dark page, so that it is readable in grey too.
_LOOSE = (("#e1e8ee", "#f0b65c", "#a33600"), ("#262d36", "#96641c", "#ff9b57"))
# FDAC: the two signs differ in hue and lightness; zero has the colour of the page.
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
    """Return the ink, dark or light, with the higher contrast on a colour."""
    return "#14181d" if luminance(colour) > 0.19 else "#ffffff"


def _scales() -> dict[str, Style]:
    roles: dict[str, Style] = {}
    for step in range(PROBABILITIES):
        light, dark = (_blend(stops, step / (PROBABILITIES - 1)) for stops in _LOOSE)
        ink, dark_ink = _ink(light), _ink(dark)
        roles[f"p{step}"] = Style(light=light, dark=dark, marker="circle", size=7.0)
        roles[f"on{step}"] = Style(light=ink, dark=dark_ink)
        roles[f"loose-on{step}"] = Style(light=ink, dark=dark_ink, width=1.5, marker="cross", size=2.7)
        roles[f"tight-on{step}"] = Style(light=ink, dark=dark_ink, marker="circle", size=1.3)
    for step in range(COSINES):
        light, dark = (_blend(stops, step / (COSINES - 1)) for stops in _FDAC)
        roles[f"fdac{step}"] = Style(light=light, dark=dark)
    return roles


STYLES: dict[str, Style] = {
    "text": Style(light="#3b434d", dark="#b7bfca"),
    "strong": Style(light="#14181d", dark="#eceff3"),
    "grid": Style(light="#e6e9ed", dark="#2b3139", width=0.6),
    "frame": Style(light="#b4bac3", dark="#4c545f", width=0.8),
    "measured": Style(light="#15191e", dark="#f1f3f6", width=2.4),
    "initial": Style(light="#7d858f", dark="#98a1ad", width=1.1, dash=(4, 2.6)),
    "updated": Style(light="#1a8cf0", dark="#3aa0f5", width=1.2),
    "selected": Style(light="#009e73", dark="#2fc79b", width=0.8, marker="bar", size=3.0),
    "doubtful": Style(light="#8b93a0", dark="#8b93a0", opacity=0.16),
    "identified": Style(light="#0a74c4", dark="#4fb0f0", width=1.8),
    "reference": Style(light="#949ca7", dark="#7e8793", width=1.0),
    "band": Style(light="#0a74c4", dark="#4fb0f0", opacity=0.16),
    "tight-state": Style(light="#008a64", dark="#2fc79b", width=1.4),
    "coherence": Style(light="#6b7280", dark="#a3acb8", width=1.0),
    "channel": Style(light="#4c9fd6", dark="#3f84ba"),
    "channel-unseen": Style(light="#e0a33e", dark="#b8811f"),
    "before": Style(light="#5a626d", dark="#a5aeb9", width=1.6),
    "whisker": Style(light="#5a626d", dark="#a5aeb9", width=1.2),
    "stated": Style(light="#b0508a", dark="#e58fc0", width=1.6, marker="cross", size=3.4),
    "tight": Style(light="#15191e", dark="#f1f3f6", marker="circle", size=2.5),
    "removed": Style(light="#8a929d", dark="#929ba7", width=1.3, marker="cross", size=3.2),
    "bolt": Style(light="#5a626d", dark="#a5aeb9", width=1.0, marker="ring", size=2.6),
    "loose-name": Style(light="#a33600", dark="#ff9c5f"),
    "loose": Style(light="#d55e00", dark="#ff8a3d", opacity=0.17),
    "undecided": Style(light="#c98a00", dark="#f0b840", opacity=0.13),
    "outside": Style(light="#c4c8cd", dark="#474d55"),
    "outside-on": Style(light="#3b424b", dark="#d5dae0"),
    "outside-dot": Style(light="#c4c8cd", dark="#474d55", marker="circle", size=7.0),
    "outside-stripe": Style(light="#8b93a0", dark="#8b93a0", opacity=0.2),
    "open": Style(light="#0a74c4", dark="#4fb0f0", opacity=0.06),
    "open-up": Style(light="#0a74c4", dark="#4fb0f0", marker="up", size=2.4),
    "open-down": Style(light="#0a74c4", dark="#4fb0f0", marker="down", size=2.4),
    "unknown": Style(light="#d5d9df", dark="#3d4550"),
    "unknown-dot": Style(light="#d5d9df", dark="#3d4550", marker="circle", size=7.0),
    "hatch": Style(light="#5a626d", dark="#a5aeb9", width=0.9),
    "known": Style(light="#14181d", dark="#eceff3", width=1.8, marker="ring", size=9.2),
    "known-dot": Style(light="#14181d", dark="#eceff3", width=1.8, marker="ring", size=4.0),
    "unsure-dot": Style(light="#5a626d", dark="#a5aeb9", width=1.2, marker="ring", size=4.0),
    "edge": Style(light="#b4bac3", dark="#4c545f", width=3.0),
    "mesh": Style(light="#c3cad3", dark="#444c57", width=0.5),
    "mesh-dot": Style(light="#aab2bd", dark="#566070", marker="circle", size=1.0),
    "shape": Style(light="#1a8cf0", dark="#3aa0f5", width=0.45),
    "shape-dot": Style(light="#1a8cf0", dark="#3aa0f5", marker="circle", size=1.0),
    "measured-way": Style(light="#15191e", dark="#f1f3f6", width=1.0),
    "measured-point": Style(light="#15191e", dark="#f1f3f6", marker="circle", size=2.6),
    "modelled-point": Style(light="#d55e00", dark="#ff8a3d", width=1.2, marker="ring", size=3.6),
    "air": Style(light="#9fc3dd", dark="#3f6480", marker="circle", size=0.8),
    "box": Style(light="#8b93a0", dark="#767f8b", width=0.8),
    "term": Style(light="#4f9ad6", dark="#2f7fbe", width=2.4),
    "term-dot": Style(light="#4f9ad6", dark="#2f7fbe", marker="circle", size=2.0),
    "sensor": Style(light="#009e73", dark="#2fc79b", marker="square", size=4.0),
    "sensor-unseen": Style(light="#009e73", dark="#2fc79b", width=1.4, marker="ring", size=4.0),
    "microphone": Style(light="#b0508a", dark="#e58fc0", marker="diamond", size=4.6),
    "microphone-unseen": Style(light="#b0508a", dark="#e58fc0", width=1.4, marker="ring", size=4.0),
    "hammer": Style(light="#14181d", dark="#eceff3", marker="down", size=5.0),
    "unsure": Style(light="#5a626d", dark="#a5aeb9", width=1.2, dash=(2.2, 1.8), marker="ring", size=7.0),
    "diagonal": Style(light="#d81b60", dark="#ff8ab5", width=1.0, dash=(3, 2)),
    "tolerance": Style(light="#d55e00", dark="#ff8a3d", width=1.2, dash=(6, 3)),
    "taken": Style(light="#d55e00", dark="#ff8a3d", marker="up", size=3.4),
    "corner": Style(light="#d55e00", dark="#ff8a3d", width=1.6, marker="ring", size=6.0),
    "plan-loss0": Style(light="#d3e4f1", dark="#24506d"),
    "plan-loss1": Style(light="#7fb5dc", dark="#3878a6"),
    "plan-loss2": Style(light="#2b7bba", dark="#4fa3dc"),
    "plan-interval": Style(light="#14181d", dark="#eceff3", width=0.8),
    "plan-missed": Style(light="#d55e00", dark="#ff8a3d", width=1.6, marker="cross", size=3.0),
    "plan-alarm": Style(light="#d81b60", dark="#ff8ab5", width=1.6, marker="ring", size=3.2),
    "plan-limit": Style(light="#5a626d", dark="#a5aeb9", width=1.0, dash=(4, 2.6)),
    "plan-candidate": Style(light="#009e73", dark="#2fc79b"),
    "plan-planned": Style(light="#7f97ad", dark="#6f8ba5"),
    **{
        f"series{index}": Style(light=light, dark=dark, width=1.5, dash=dash, marker=marker, size=3.2)
        for index, (light, dark, marker, dash) in enumerate(_SERIES)
    },
    **_scales(),
    **{f"step{index}": Style(light=light, dark=dark, width=1.3) for index, (light, dark) in enumerate(_STEPS)},
}
SERIES = len(_SERIES)
STEPS = len(_STEPS)


def css() -> str:
    """Return the colours as CSS custom properties, light and dark, and one class ``r-ROLE`` for each role."""
    light = "".join(f"--{role}:{style.light};" for role, style in STYLES.items())
    dark = "".join(f"--{role}:{style.dark};" for role, style in STYLES.items())
    classes = "".join(f".r-{role}{{color:var(--{role})}}" for role in STYLES)
    return f":root{{{light}}}\n@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}\n{classes}\n"
