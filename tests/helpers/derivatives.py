"""Gradients against their definition."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: Steps of half a decade.
DECADES = np.arange(0.0, 6.01, 0.5)


def check_derivative(
    function: Callable[[np.ndarray], np.ndarray], derivative: np.ndarray, x: np.ndarray, direction: np.ndarray, *, first: float = 1e-1
) -> None:
    """The Taylor remainder ``|f(x + h d) - f(x) - h f'(x) d|`` falls as h² over three decades of h on end.

    A wrong derivative makes it fall as h.

    Parameters
    ----------
    function : callable
        From x to a scalar or an array.
    derivative : array
        f'(x), the last axis over x.
    x, direction : (n,) arrays
    first : float
        Largest step.
    """
    f0 = np.asarray(function(x))
    slope = derivative @ direction
    steps = first * 10.0**-DECADES
    change = [np.asarray(function(x + h * direction)) - f0 for h in steps]
    assert np.linalg.norm(change[0]) > 0, "the function does not depend on this direction"
    remainder = np.array([np.linalg.norm(c - h * slope) for c, h in zip(change, steps, strict=True)])
    floor = 1e-13 * max(float(np.linalg.norm(f0)), float(np.linalg.norm(change[0])))
    if remainder.max() <= 10 * floor:
        return  # linear to the last digit
    with np.errstate(divide="ignore", invalid="ignore"):
        order = np.log10(remainder[:-1] / remainder[1:]) / 0.5
    # The largest steps may feel higher orders, the smallest ones drown in round-off.
    second = (order > 1.5) & (order < 2.5) & (remainder[1:] > floor)
    runs = "".join("x" if ok else " " for ok in second).split()
    longest = max(runs, key=len, default="")
    table = "\n".join(f"h = {h:.1e}   remainder {r:.3e}" for h, r in zip(steps, remainder, strict=True))
    assert len(longest) >= 6, f"not three decades of second order, orders {np.round(order, 2)}:\n{table}"
    at = "".join("x" if ok else " " for ok in second).index(longest)
    typical = float(np.median(order[at : at + len(longest)]))
    assert abs(typical - 2.0) < 0.1, f"order {typical:.2f}:\n{table}"
