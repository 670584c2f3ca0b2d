"""The normal distribution by the standard library: importing SciPy's takes a good part of the second in which a campaign is judged anew."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from lrbc_cli.arrays import Floats

#: Two-sided 95 %.
NORMAL_95 = NormalDist().inv_cdf(0.975)


def normal_cdf(x: Floats | float) -> Floats:
    """Probability that a standard normal variable is at most x, element by element; relative accuracy kept in both tails."""
    values = np.asarray(x, dtype=float)
    return np.reshape([0.5 * math.erfc(-value * math.sqrt(0.5)) for value in values.ravel().tolist()], values.shape)
