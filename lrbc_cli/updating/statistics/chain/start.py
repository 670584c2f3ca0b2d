"""How the impulse responses of FRFs begin: the first milliseconds are lost if an analyser starts to record after the blow."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Complexes, Floats


def starting(frequency_hz: Floats, values: Complexes, *, most: int = 16, quantile: float = 0.75) -> tuple[Floats, Floats]:
    """Times after the blow [s], and the energy of impulse responses before each of them over that of as long a time after it.

    A part of the structure near the hammer moves at once. Of each time the value is given that a quarter of the responses exceed, since
    others are far from the hammer.

    Parameters
    ----------
    frequency_hz : (F,) float array
        Evenly spaced.
    values : (F, R) complex array
        NaN where there is no value.
    most : int
        Longest time over the time that the band resolves.
    quantile : float
    """
    count, step = frequency_hz.size, float(np.mean(np.diff(frequency_hz)))
    fine = 8
    known = values[:, np.isfinite(values).any(axis=0)]
    energy = np.abs(np.fft.ifft(np.nan_to_num(known), fine * count, axis=0)) ** 2
    summed = np.concatenate([np.zeros((1, energy.shape[1])), energy.cumsum(axis=0)])
    ends = np.unique(np.geomspace(fine, fine * min(most, count // 4), 12).round().astype(int))
    before, after = summed[ends], summed[2 * ends] - summed[ends]
    return ends / (fine * count * step), np.quantile(before / np.maximum(after, np.finfo(float).tiny), quantile, axis=1)
