"""A Hann window on the records of a blow, by the envelopes of impulse responses.

The response to a blow decays from its beginning, where a Hann window is nearly zero. What it leaves grows up to the middle of the record,
so that the FRFs are too high, and each peak is broadened.
"""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.knots import evenly


def hann_text(frequency_hz: Floats, own: Complexes, tight: Complexes, reference: str, *, parts: int = 20) -> str:
    """Message if the envelope of the impulse responses is that of another job times a Hann window, or the reverse; else empty.

    Parameters
    ----------
    frequency_hz : (F,) float array
        Must be evenly spaced, otherwise nothing is said.
    own, tight : (F, R) complex arrays
        Responses that both jobs have.
    reference : str
        Name of the other job.
    parts : int
        Number of parts of the record. A choice.
    """
    if not evenly(frequency_hz) or frequency_hz.size < 4 * parts or not own.shape[1]:
        return ""
    found = _window_between(*(_envelope(values, parts) for values in (own, tight)))
    if found is None:
        return ""
    sign, begin, before, after = found
    return (
        f"the impulse responses do not decay like those of {reference}: their envelope differs from a straight line in dB by {before:.1f} "
        f"dB, and by {after:.1f} dB with a Hann window {'in this job' if sign > 0 else f'in {reference}'} (the blow at {begin:.0%} of the "
        "record). A Hann window suppresses the blow and broadens each peak: set a uniform (or force and exponential) window, and measure "
        "again"
    )


def _window_between(
    own: Floats,
    tight: Floats,
    *,
    deep_db: float = 20.0,
    floor_db: float = 6.0,
    least: int = 8,
    clear_db: float = 2.0,
    share: float = 0.3,
) -> tuple[float, float, float, float] | None:
    """Sign (1: in the first job), place of the blow, and deviations from a line without and with a Hann window [dB]; None without one.

    The window counts from the blow, some time after the beginning of the record. Loosened bolts change how fast an envelope falls, which
    is a straight line in decibels; that line is taken out.

    Parameters
    ----------
    own, tight : (parts,) float arrays
        Envelopes [dB].
    deep_db : float
        Parts in which the window is lower than this below its middle do not count: noise is there.
    floor_db : float
        Nor do parts in which an envelope is within this of its lowest value, which may be noise: where one reaches it there is a kink.
    least : int
        Least number of parts that count. A choice.
    clear_db : float
        Least deviation from a straight line, root of the mean square over the parts [dB].
    share : float
        Largest share of it that the window may leave. In 224 jobs of right virtual rigs more was left, also below ``clear_db``.
    """
    change, at = own - tight, (np.arange(own.size) + 0.5) / own.size
    above = (own > own.min() + floor_db) & (tight > tight.min() + floor_db)
    found: tuple[float, float, float, float] | None = None
    for begin in np.arange(0.01, 0.4, 0.01).tolist():
        window = 40.0 * np.log10(np.maximum(np.abs(np.sin(np.pi * (at + begin))), 1e-9))
        kept = above & (window > -deep_db) & (at + begin < 1.0)
        lines = np.stack([np.ones(at.size), at], axis=1)[kept]
        for sign in (1.0, -1.0) if kept.sum() >= least else ():
            before, after = (_beside(lines, values[kept]) for values in (change, change - sign * window))
            if before > clear_db and after < share * before:
                found, share = (sign, begin, before, after), after / before
    return found


def _envelope(values: Complexes, parts: int) -> Floats:
    """Energy of the impulse responses (F, R) in equal parts of the record, mean over the responses [dB]."""
    tapered = np.nan_to_num(values) * np.hanning(len(values) + 2)[1:-1, None]
    energy = np.abs(np.fft.ifft(tapered, axis=0)) ** 2
    whole = np.maximum(energy.sum(axis=0), 1e-300)
    return np.array([10.0 * np.log10(max(float(part.sum(axis=0).mean()), 1e-300)) for part in np.array_split(energy / whole, parts)])


def _beside(lines: Floats, values: Floats) -> float:
    """Root of the mean square of what a straight line leaves."""
    return float(np.sqrt(np.mean((values - lines @ np.linalg.lstsq(lines, values, rcond=None)[0]) ** 2)))
