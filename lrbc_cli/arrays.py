"""Array types for the signatures of all packages (shapes and units are in the docstrings), and a choice of evenly spaced indices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]


def spaced(count: int, most: int) -> Integers:
    """At most ``most`` of the indices 0 to ``count - 1``, evenly spaced and including both ends."""
    found: Integers = np.unique(np.linspace(0, max(count - 1, 0), min(count, most)).round().astype(np.int64))
    return found
