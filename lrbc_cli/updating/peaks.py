"""Peaks of a curve."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def peaks_of(values: NDArray[np.float64], **limits: Any) -> NDArray[np.int64]:
    """Indices of the peaks, with the limits of ``scipy.signal.find_peaks``.

    Parameters
    ----------
    values : (n,) float array
    **limits
        ``height``, ``prominence``, ...
    """
    # Loaded here: it takes longer to load than all else, and commands that look for no peak need not wait.
    from scipy.signal import find_peaks

    return np.asarray(find_peaks(values, **limits)[0], dtype=np.int64)
