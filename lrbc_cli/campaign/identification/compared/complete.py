"""How much of the lines of the reference job a measurement has: files that were cut, or that lack a part of the band."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification.records import Measurement


def shares(own: Measurement, tight: Measurement, least: float) -> Floats:
    """(R,) share of the lines of the reference job that a measurement covers, by response; NaN where it has no value.

    A gap, or an end, counts if it contains more than the share ``least`` of these lines: not the notches about mains frequencies, nor wide
    steps between resonances.
    """
    known = [(np.isfinite(own.values[:, r]), np.isfinite(tight.values[:, r])) for r in range(own.values.shape[1])]
    return np.array([_share(own.frequency_hz[here], tight.frequency_hz[there], least) for here, there in known])


def _share(lines: Floats, wanted: Floats, least: float, *, gap: float = 3.0) -> float:
    """Share of the lines ``wanted`` outside gaps of ``lines`` more than ``gap`` times as wide as usual, on a linear or logarithmic axis."""
    if lines.size < 2 or not wanted.size:
        return float("nan") if not lines.size or not wanted.size else 0.0
    steps, middle = np.diff(lines), 0.5 * (lines[1:] + lines[:-1])
    usual = np.maximum(np.median(steps), np.median(steps / middle) * middle)
    # Beyond the ends, a line counts that is no farther away than the next one would be.
    edges = np.concatenate([[-np.inf, lines[0] - steps[0]], lines, [lines[-1] + steps[-1], np.inf]])
    wide = np.concatenate([[True, False], steps > gap * usual, [False, True]])
    at = np.searchsorted(edges, wanted, side="right") - 1
    inside = np.bincount(at[~np.isin(wanted, lines)], minlength=wide.size)
    return 1.0 - float(inside[wide & (inside > least * wanted.size)].sum()) / wanted.size
