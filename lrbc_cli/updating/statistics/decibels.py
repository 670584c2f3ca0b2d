"""Levels in decibels, their standard deviation from the coherence, and weights of lines."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel

#: d(20 log10 x)/d ln x.
DB = 20.0 / float(np.log(10.0))


def decibel(H: Complexes | Floats) -> Floats:
    """20 log10 |H|, eqs. (30), (31)."""
    return np.asarray(20.0 * np.log10(np.abs(H)))


def coherence_sigma(coherence: Floats, averages: Floats | int, errors: ErrorModel = ERRORS) -> Floats:
    """Standard deviation of the magnitude of an averaged FRF [dB].

    ``20/ln10 sqrt((1 - g²)/(2 n g²))``, the random error of a frequency response in Bendat and Piersol, *Random Data*, chapter 9.

    Parameters
    ----------
    coherence : float array
        Ordinary coherence g²; NaN if unknown.
    averages : int or float array
        Number of averages n.
    errors : ErrorModel

    Returns
    -------
    float array
        NaN if the coherence is unknown.
    """
    g2 = np.clip(coherence, errors.least_coherence, 1.0)
    return np.asarray(DB * np.sqrt((1.0 - g2) / (2.0 * averages * g2)))


def stated_coherence(coherence: Floats) -> Floats:
    """(F, R) coherence as far as a file states it: NaN where it is unknown.

    Some programs write zeros where they have no coherence. Zeros between positive values are an estimate that was rounded or cut off, and
    those lines are the worst: they must not weigh as much as lines without noise.

    Parameters
    ----------
    coherence : (F, R) float array
        As read; NaN where there is none.
    """
    positive = coherence > 0.0
    estimated = 2 * positive.sum(axis=0) > np.isfinite(coherence).sum(axis=0)
    return np.asarray(np.where(positive | estimated & (coherence == 0.0), coherence, np.nan))


def noise_weights(sigma: Floats, level: float) -> Floats:
    """Factors ``1/sqrt(1 + (sigma/level)²)`` on residuals in dB; 1 if sigma is NaN.

    A line whose noise is well below the model discrepancy keeps a weight of about 1.

    Parameters
    ----------
    sigma : float array
        Standard deviations [dB].
    level : float
        Standard deviation of the model discrepancy [dB].
    """
    return np.where(np.isnan(sigma), 1.0, 1.0 / np.sqrt(1.0 + (np.nan_to_num(sigma, posinf=np.inf) / level) ** 2))
