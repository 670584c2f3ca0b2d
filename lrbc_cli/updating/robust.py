"""Spread that a few outliers do not move."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Floats

#: Standard deviation of Gaussian values over their median absolute deviation.
DEVIATION = 1.4826


def scatter(values: Floats) -> float:
    """Standard deviation of Gaussian values, by the median of their departures from their median."""
    return DEVIATION * float(np.median(np.abs(values - np.median(values))))
