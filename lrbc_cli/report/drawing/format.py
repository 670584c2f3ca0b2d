"""Numbers as a reader wants to see them."""

from __future__ import annotations

import math

from lrbc_cli.report.drawing.chart import number

MISSING = "–"


def fixed(value: float | None, digits: int = 2) -> str:
    """Write with a fixed number of decimals, thousands apart."""
    if value is None or not math.isfinite(value):
        return MISSING
    return f"{value:,.{digits}f}".replace(",", "\u202f").replace("-", "−")


def signed(value: float | None, digits: int = 1) -> str:
    """Write with its sign."""
    if value is None or not math.isfinite(value):
        return MISSING
    text = f"{value:+.{digits}f}"
    return text.replace("-", "−") if float(text) else text[1:]


def shortened(name: str, limit: int) -> str:
    """Write a name in at most so many characters."""
    return name if len(name) <= limit else name[: limit - 1] + "…"


def over_force(unit: str) -> str:
    """Write the unit of an FRF, a quotient over a force, so that it can be read in one way: (m/s²)/N."""
    above, slash, below = unit.rpartition("/")
    return f"({above}){slash}{below}" if "/" in above and not above.startswith("(") else unit


def count(value: float | None) -> str:
    """Write a whole number, thousands apart."""
    return fixed(value, 0)


def small(value: float | None) -> str:
    """Write an error as 4.0e-4."""
    return (
        MISSING if value is None or not math.isfinite(value) else f"{value:.1e}".replace("e-0", "e-").replace("e+0", "e").replace("-", "−")
    )


def figures(value: float | None, digits: int = 3) -> str:
    """Write with significant digits; thousands apart where it is large."""
    if value is None or not math.isfinite(value):
        return MISSING
    return count(value) if abs(value) >= 10**digits else number(value, digits)


def seconds(value: float | None) -> str:
    """Write a duration with the unit that suits it."""
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
    """Write a probability in per cent without the sign, never as 0 or 100: what rounds to certainty is none."""
    return {0: "<1", 100: ">99"}.get(whole := round(100.0 * value), str(whole))


def probability(value: float | None) -> str:
    """Write a probability."""
    return MISSING if value is None else f"{percent(value)}\u00a0%"


def inverse(value: float | None) -> str:
    """Write a share below one as 1/86."""
    if value is None or not math.isfinite(value) or value <= 0:
        return MISSING
    return figures(value) if value >= 0.1 else f"1/{figures(1 / value)}"


def factor(value: float | None) -> str:
    """Write a speed-up."""
    return MISSING if value is None or not math.isfinite(value) else f"{figures(value)}\u00a0×"


def change(initial: float | None, final: float | None, digits: int = 1) -> str:
    """Write before → after."""
    return f"{fixed(initial, digits)} → {fixed(final, digits)}"
