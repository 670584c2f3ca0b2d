"""Gradients against their definition."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def check_derivative(
    function: Callable[[np.ndarray], np.ndarray], derivative: np.ndarray, x: np.ndarray, direction: np.ndarray, *, first: float = 1e-1
) -> None:
    """The Taylor remainder ``|f(x + h d) - f(x) - h f'(x) d|`` falls as h² over at least three decades of h.

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
    steps = first * 10.0 ** -np.arange(0.0, 4.01, 0.5)
    remainder = np.array([np.linalg.norm(np.asarray(function(x + h * direction)) - f0 - h * slope) for h in steps])
    change = np.array([np.linalg.norm(np.asarray(function(x + h * direction)) - f0) for h in steps])
    assert change[0] > 0, "the function does not depend on this direction"
    # Round-off of the two values, which the remainder cannot pass below.
    floor = 1e-13 * max(float(np.linalg.norm(f0)), float(change[0]))
    seen = remainder > 10 * floor
    if not seen.any():
        assert remainder.max() <= 10 * floor  # linear to the last digit
        return
    last = int(np.argmin(seen)) if not seen.all() else seen.size
    order = np.log10(remainder[: last - 1] / remainder[1:last]) / 0.5
    table = "\n".join(f"h = {h:.1e}   remainder {r:.3e}" for h, r in zip(steps, remainder, strict=True))
    assert last >= 7, f"fewer than three decades above round-off:\n{table}"
    # The first steps may still feel the third order.
    assert np.all(order[-4:] > 1.9), f"orders {np.round(order, 2)}:\n{table}"
    assert np.all(order > 1.5), f"orders {np.round(order, 2)}:\n{table}"
    assert np.all(order < 3.5), f"orders {np.round(order, 2)}:\n{table}"
