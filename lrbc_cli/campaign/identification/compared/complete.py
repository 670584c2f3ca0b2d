"""How much of the lines of the reference job a measurement has: files that were cut, or that lack a part of the band."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification.records import Measurement


def shares(own: Measurement, tight: Measurement) -> Floats:
    """(R,) share of the lines of the reference job that lie between lines of a measurement, by response; NaN where it has no value."""
    known = [(np.isfinite(own.values[:, r]), np.isfinite(tight.values[:, r])) for r in range(own.values.shape[1])]
    return np.array([_share(own.frequency_hz[here], tight.frequency_hz[there]) for here, there in known])


def _share(lines: Floats, wanted: Floats, *, gap: float = 3.0) -> float:
    """Share of the lines ``wanted`` that lie in no gap: more than ``gap`` times as wide as is usual, on a linear or a logarithmic axis."""
    if lines.size < 2 or not wanted.size:
        return float("nan") if not lines.size or not wanted.size else 0.0
    steps, middle = np.diff(lines), 0.5 * (lines[1:] + lines[:-1])
    usual = np.maximum(np.median(steps), np.median(steps / middle) * middle)
    # Beyond the ends, a line counts that is no farther away than the next one would be.
    edges = np.concatenate([[lines[0] - steps[0]], lines, [lines[-1] + steps[-1]]])
    narrow = np.concatenate([[True], steps <= gap * usual, [True]])
    at = np.searchsorted(edges, wanted, side="right") - 1
    inside = (at >= 0) & (wanted <= edges[-1])
    on_line = np.isin(wanted, lines)
    return float((on_line | (inside & narrow[np.clip(at, 0, narrow.size - 1)])).mean())
