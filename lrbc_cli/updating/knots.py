"""Interpolation between knots on an axis, and whether an axis is evenly spaced."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Floats


def hats(x: Floats, knots: Floats) -> Floats:
    """(n, m) weights of the piecewise linear interpolation from m ascending knots to the positions x (n,)."""
    return np.column_stack([np.interp(x, knots, row) for row in np.eye(knots.size)])


def evenly(axis: Floats, tolerance: float = 1e-3) -> bool:
    """Whether the steps of an axis (n,) are the same, up to rounding of the lines; False for a single line."""
    steps = np.diff(axis)
    return bool(steps.size) and bool(np.allclose(steps, steps.mean(), rtol=tolerance))
