"""Lines that tell nothing new: where a resonance covers many lines, those that follow from their neighbours are not compared.

Errors of the model are common to lines within a half-power bandwidth, so with three lines in it or with twenty a resonance tells the same.
The time of an identification is proportional to the number of lines.
"""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.updating.peaks import peaks_of
from lrbc_cli.updating.statistics.decibels import decibel
from lrbc_cli.updating.statistics.lines import RESONANCES, Resonances


def thinned(frequency_hz: Floats, measured: Complexes, lines: Integers, rule: Resonances = RESONANCES) -> Integers:
    """Some of the lines about resonances, so that FRFs between them follow by linear interpolation, see ``Resonances.followed``.

    Every second, fourth, ... line of each run of neighbouring lines is kept, and the last one. A resonance of a single mode keeps about
    three lines in its half-power bandwidth b: halfway between lines a distance d apart interpolation errs by ``(d/b)²`` of the peak.

    Parameters
    ----------
    frequency_hz : (F,) float array
    measured : (F, R) complex array
        NaN where a response was not measured.
    lines : (m,) int array
        Sorted indices of lines, see ``resonance_lines``.
    rule : Resonances

    Returns
    -------
    (k,) int array
        Sorted; a run of ``least_lines`` or fewer is kept whole.
    """
    if not lines.size:
        return lines
    runs = np.split(lines, np.flatnonzero(np.diff(lines) > 1) + 1)
    return np.concatenate([_run(frequency_hz[run], measured[run], run, rule) for run in runs])


def _run(frequency_hz: Floats, H: Complexes, run: Integers, rule: Resonances) -> Integers:
    """Lines of one run of neighbouring lines that are kept, see ``thinned``."""
    known, kept, step = np.isfinite(H), run, 2
    size = np.where(known, np.abs(H), 0.0)
    allowed = np.tile(rule.followed * size.max(axis=0), (run.size, 1))
    # A lower peak beside a high one has a tolerance of its own; below the tolerance of the high one there is none.
    for r in np.flatnonzero(known.all(axis=0) & (size > 0.0).all(axis=0)).tolist():
        peaks = peaks_of(decibel(H[:, r]), prominence=rule.prominence_db)
        peaks = peaks[size[peaks, r] > allowed[peaks, r]]
        allowed[peaks, r] = rule.followed * size[peaks, r]
    while (run.size - 1) // step + 1 >= max(rule.least_lines, 3):
        nodes = np.union1d(np.arange(0, run.size, step), run.size - 1)
        before = np.clip(np.searchsorted(nodes, np.arange(run.size), side="right") - 1, 0, nodes.size - 2)
        first, last = nodes[before], nodes[before + 1]
        share = ((frequency_hz - frequency_hz[first]) / (frequency_hz[last] - frequency_hz[first]))[:, None]
        apart = np.abs((1.0 - share) * H[first] + share * H[last] - H)
        # A measured value beside a missing one does not follow.
        if bool((known & ~(apart <= allowed)).any()):
            break
        kept, step = run[nodes], 2 * step
    return kept


def ranks(lines: Integers) -> Integers:
    """(m,) places of lines among their neighbours: lines as far apart as either is from its nearest one differ by one.

    Parameters
    ----------
    lines : (m,) int array
        Ascending.
    """
    gaps = np.diff(lines)
    if not gaps.size:
        return np.zeros_like(lines)
    nearest = np.minimum(np.append(gaps, gaps[-1]), np.append(gaps[0], gaps))
    steps = np.rint(gaps / np.maximum(nearest[:-1], nearest[1:])).astype(lines.dtype)
    return np.concatenate([np.zeros(1, dtype=lines.dtype), np.cumsum(np.maximum(steps, 1))])
