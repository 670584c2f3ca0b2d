"""Peak search; the one place that imports ``scipy.signal``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def peaks_of(values: NDArray[np.float64], **limits: Any) -> NDArray[np.int64]:
    """Indices of the peaks of a curve, by ``scipy.signal.find_peaks``.

    Parameters
    ----------
    values : (n,) float array
    **limits
        ``height``, ``prominence``, ... of ``find_peaks``.
    """
    # Imported here: this import is the slowest of all, and most commands need no peaks.
    from scipy.signal import find_peaks

    return np.asarray(find_peaks(values, **limits)[0], dtype=np.int64)
