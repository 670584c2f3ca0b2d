"""Normal distribution without SciPy, whose import would take a large part of the second in which a campaign is judged again."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from lrbc_cli.arrays import Floats

#: 0.975 quantile of the standard normal distribution: half width of a two-sided 95 % interval in standard deviations.
NORMAL_95 = NormalDist().inv_cdf(0.975)


def normal_cdf(x: Floats | float) -> Floats:
    """Probability that a standard normal variable is at most x, for each element; accurate to a relative error in both tails."""
    values = np.asarray(x, dtype=float)
    return np.reshape([0.5 * math.erfc(-value * math.sqrt(0.5)) for value in values.ravel().tolist()], values.shape)
