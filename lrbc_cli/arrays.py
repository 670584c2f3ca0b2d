"""Types of arrays, as the signatures of all rooms name them; shapes and units stand in the docstrings. And a choice of indices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]


def spaced(count: int, most: int) -> Integers:
    """At most so many of these indices, evenly spaced from the first to the last."""
    found: Integers = np.unique(np.linspace(0, max(count - 1, 0), min(count, most)).round().astype(np.int64))
    return found
