"""The four panels of ``sizes.py``: cost against DOFs, terms, lines and jobs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullLocator, StrMethodFormatter

BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#777777"


def exponent(x: Sequence[float], y: Sequence[float]) -> float:
    """Power p of the best fit y = c x^p on logarithmic axes; nan for a single point."""
    if len(x) < 2:
        return float("nan")
    return float(np.polyfit(np.log(np.asarray(x, dtype=float)), np.log(np.asarray(y, dtype=float)), 1)[0])


def _short(value: float, _: object = None) -> str:
    return f"{value / 1000:.3g}k" if value >= 1000 else f"{value:g}"


def _curve(axes: Axes, x: Sequence[float], y: Sequence[float], name: str, colour: str, *, power: bool = True) -> None:
    fit = exponent(x, y)
    label = f"{name}, slope {fit:.2f}" if power and np.isfinite(fit) else name
    axes.plot(x, y, "o-", color=colour, markersize=4.5, linewidth=1.4, label=label)


def _panel(axes: Axes, title: str, xlabel: str, ylabel: str, ticks: Sequence[float]) -> None:
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.set_xticks(list(ticks))
    axes.xaxis.set_major_formatter(FuncFormatter(_short))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.grid(True, which="major", color="#dddddd", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)


def draw(found: dict[str, Any], path: Path) -> None:
    """Write the figure; parts that were not measured stay away."""
    panels = [(part, found[part]) for part in ("n", "terms", "lines", "jobs") if part in found]
    columns = min(len(panels), 2)
    with mpl.rc_context({"font.size": 9, "axes.edgecolor": GREY}):
        figure, grid = plt.subplots(
            -(-len(panels) // columns), columns, figsize=(4.8 * columns, 3.5 * -(-len(panels) // columns)), squeeze=False
        )
        for axes in grid.flat[len(panels) :]:
            axes.set_visible(False)
        for (part, data), axes in zip(panels, grid.flat, strict=False):
            rows = data["rows"]
            if part == "n":
                n = [row["n"] for row in rows]
                axes.set(xscale="log", yscale="log")
                _curve(axes, n, [row["reduction_s"] for row in rows], "reduction", BLUE)
                _curve(axes, n, [row["full_line_s"] for row in rows], "full line", ORANGE)
                identified = data["identification"]["rows"]
                _curve(axes, [row["n"] for row in identified], [row["seconds"]["total"] for row in identified], "identification", GREEN)
                _panel(axes, f"{rows[0]['terms']} terms", "DOFs", "seconds", n)
            elif part == "terms":
                terms = [row["terms"] for row in rows]
                axes.set(xscale="log", yscale="log")
                _curve(axes, terms, [row["reduction_s"] for row in rows], "reduction [s]", BLUE)
                _curve(axes, terms, [1e3 * row["cost_s"] for row in rows], "cost with gradient, 100 lines [ms]", GREEN)
                _panel(axes, f"{data['n']} DOFs", "terms", "seconds, milliseconds", terms)
            elif part == "lines":
                lines = [row["lines"] for row in rows]
                axes.set(xscale="log", yscale="log")
                _curve(axes, lines, [1e3 * row["table_s"] for row in rows], "port FRFs, once", BLUE)
                _curve(axes, lines, [1e3 * row["cost_s"] for row in rows], "cost with gradient", GREEN)
                _panel(axes, f"{data['terms']} terms, r = {data['r']}", "lines", "milliseconds", lines)
            else:
                jobs = [row["jobs"] for row in rows]
                slope = np.polyfit(jobs, [row["seconds"] for row in rows], 1)[0] if len(jobs) > 1 else float("nan")
                _curve(axes, jobs, [row["seconds"] for row in rows], f"lrbc update, {slope:.2f} s a job", BLUE, power=False)
                axes.set_ylim(bottom=0)
                axes.set_xlim(left=0)
                _panel(axes, "SoundBox, reduced model in the cache", "jobs", "seconds", jobs)
                axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        figure.tight_layout()
        figure.savefig(path, dpi=150)
        plt.close(figure)
