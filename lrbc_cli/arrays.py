"""Types of arrays, as the signatures of all rooms name them; shapes and units stand in the docstrings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]
