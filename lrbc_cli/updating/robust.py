"""Scatter and medians that a few outliers or missing values do not distort."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Floats

#: Ratio of the standard deviation of Gaussian values to their median absolute deviation.
DEVIATION = 1.4826


def scatter(values: Floats) -> Floats:
    """Robust standard deviation along the first axis: 1.4826 times the median absolute deviation from the median."""
    return np.asarray(DEVIATION * np.median(np.abs(values - np.median(values, axis=0)), axis=0))


def medians(values: Floats, axis: int = -1) -> Floats:
    """Medians along an axis without NaN values; the axis is kept with length one, and the median is NaN where all values are NaN.

    Gives the values of ``np.nanmedian`` five to ten times as fast where there are thousands of medians.

    Parameters
    ----------
    values : float array
        At least one value along the axis.
    axis : int
    """
    if not np.isnan(values).any():
        return np.asarray(np.median(values, axis=axis, keepdims=True))
    ordered = np.sort(np.moveaxis(values, axis, -1), axis=-1)
    known = ordered.shape[-1] - np.isnan(ordered).sum(axis=-1, keepdims=True)
    below, above = (np.take_along_axis(ordered, at, axis=-1) for at in (np.maximum(known - 1, 0) // 2, np.where(known, known // 2, 0)))
    return np.asarray(np.moveaxis(0.5 * (below + above), -1, axis))
