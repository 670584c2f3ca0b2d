"""Formats numbers for the page and the charts; missing or infinite ones become a dash."""

from __future__ import annotations

import math

from lrbc_cli.report.drawing.chart import number

MISSING = "–"


def fixed(value: float | None, digits: int = 2) -> str:
    """Format with a fixed number of decimals and separated thousands."""
    if value is None or not math.isfinite(value):
        return MISSING
    return f"{value:,.{digits}f}".replace(",", "\u202f").replace("-", "−")


def signed(value: float | None, digits: int = 1) -> str:
    """Format with a sign, also for positive numbers; without one if it rounds to zero."""
    if value is None or not math.isfinite(value):
        return MISSING
    text = f"{value:+.{digits}f}"
    return text.replace("-", "−") if float(text) else text[1:]


def shortened(name: str, limit: int) -> str:
    """Shorten a name to at most `limit` characters."""
    return name if len(name) <= limit else name[: limit - 1] + "…"


def over_force(unit: str) -> str:
    """Format the unit of an FRF without ambiguity, with the response in parentheses: (m/s²)/N."""
    above, slash, below = unit.rpartition("/")
    return f"({above}){slash}{below}" if "/" in above and not above.startswith("(") else unit


def count(value: float | None) -> str:
    """Format a whole number with separated thousands."""
    return fixed(value, 0)


def small(value: float | None) -> str:
    """Format an error as 4.0e-4."""
    return (
        MISSING if value is None or not math.isfinite(value) else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e").replace("-", "−")
    )


def figures(value: float | None, digits: int = 3) -> str:
    """Format with significant digits; the thousands of large numbers are separated."""
    if value is None or not math.isfinite(value):
        return MISSING
    return count(value) if abs(value) >= 10**digits else number(value, digits)


def seconds(value: float | None) -> str:
    """Format a duration [s] with a suitable unit."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value >= 7200.0:
        return f"{count(value)}\u00a0s ({fixed(value / 3600, 1)}\u00a0h)"
    if value >= 120.0:
        return f"{count(value)}\u00a0s ({fixed(value / 60, 1)}\u00a0min)"
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")):
        if value * factor >= 1.0 or unit == "µs":
            return f"{figures(value * factor)}\u00a0{unit}"
    return MISSING


def percent(value: float) -> str:
    """Format a probability in per cent without the sign, never as 0 or 100, since rounding must not suggest certainty."""
    return {0: "<1", 100: ">99"}.get(whole := round(100.0 * value), str(whole))


def probability(value: float | None) -> str:
    """Format a probability."""
    return MISSING if value is None else f"{percent(value)}\u00a0%"


def inverse(value: float | None) -> str:
    """Format a share below one as 1/86."""
    if value is None or not math.isfinite(value) or value <= 0:
        return MISSING
    return figures(value) if value >= 0.1 else f"1/{figures(1 / value)}"


def factor(value: float | None) -> str:
    """Format a speed-up."""
    return MISSING if value is None or not math.isfinite(value) else f"{figures(value)}\u00a0×"


def change(initial: float | None, final: float | None, digits: int = 1) -> str:
    """Format a pair of numbers as before → after."""
    return f"{fixed(initial, digits)} → {fixed(final, digits)}"
