"""Measurements that hold the numbers of another: copied under the wrong name, exported again, in other units or with fewer digits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.updating.residuals import decibel
from lrbc_cli.updating.statistics import ValidationChannels


def copied_responses(own: Measurement, other: Measurement, limits: ValidationChannels) -> NDArray[np.int64]:
    """Responses whose magnitudes are those of another measurement, but for a constant factor and the rounding of three digits.

    On half of the common lines the levels then differ by no more than ``copied_db`` from their median difference. Measured anew they
    differ by the noise: a coherence of 0.9999 and ten averages leave 0.03 dB between two measurements of one state.

    Parameters
    ----------
    own, other : Measurement
        Of the same responses; their lines may differ.
    limits : ValidationChannels

    Returns
    -------
    int array
        Empty where too few lines are common to tell.
    """
    at = np.searchsorted(other.frequency_hz, own.frequency_hz * (1 - limits.same_line))
    near = np.minimum(at, other.frequency_hz.size - 1)
    common = np.flatnonzero(np.abs(other.frequency_hz[near] - own.frequency_hz) <= limits.same_line * own.frequency_hz)
    a, b = own.values[common], other.values[near[common]]
    found = []
    for i in range(min(a.shape[1], b.shape[1])):
        valid = np.isfinite(a[:, i]) & np.isfinite(b[:, i]) & (a[:, i] != 0) & (b[:, i] != 0)
        if int(valid.sum()) < limits.least_common:
            continue
        difference = decibel(a[valid, i]) - decibel(b[valid, i])
        if float(np.median(np.abs(difference - np.median(difference)))) <= limits.copied_db:
            found.append(i)
    return np.array(found, dtype=np.int64)


def copied_text(own: Measurement, other: Measurement, name: str, responses: list[str], limits: ValidationChannels) -> str:
    """What is wrong with a measurement that holds the numbers of that of the job ``name``; empty where it does not."""
    same = copied_responses(own, other, limits)
    if not same.size:
        return ""
    held = int(np.isfinite(own.values).any(axis=0).sum())
    which = "" if same.size == held else f" in {', '.join(responses[i] for i in same[:6])}{' ...' if same.size > 6 else ''}"
    return f"it has the numbers of the measurement of {name}{which}; was another file meant?"
