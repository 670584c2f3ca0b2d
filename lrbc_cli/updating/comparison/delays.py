"""Delays between measured and computed FRFs, from their phases."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from lrbc_cli.arrays import Complexes, Floats

#: Least mean cosine between measured and computed phases with a delay taken out, and its least excess over the cosine without: phases that
#: fall by 180 degrees at each resonance, compared with those of a model that do not, reach 2 / pi = 0.64.
LATE, LATER = 0.8, 0.3

#: Largest share of the distance of that cosine from 1 that a delay of several responses may leave, instead of the excess, if they do not
#: agree without. Errors of the model differ between responses: on right virtual rigs 0.7 and more is left.
LEFT = 0.5

#: Largest number of lines from which a delay is estimated.
DELAY_LINES = 200


def delay_of(frequency_hz: Floats, measured: Complexes, model: Complexes) -> float:
    """Delay of measured relative to computed FRFs [s]; 0 if no delay makes their phases agree, or they agree without.

    Parameters
    ----------
    frequency_hz : (F,) float array
    measured, model : (F, R) complex arrays
        Of responses with one delay; NaN or zero where there is no value.
    """
    few = np.unique(np.linspace(0, frequency_hz.size - 1, min(frequency_hz.size, DELAY_LINES)).round().astype(np.int64))
    f, product = frequency_hz[few], (measured * np.conj(model))[few]
    known = np.isfinite(product) & (product != 0.0)
    z = np.where(known, product, 0.0) / np.abs(np.where(known, product, 1.0))
    width = float(np.ptp(f))

    def alike(turns: Complexes) -> Floats:
        # Absolute values, because sensors may be reversed, too.
        return np.asarray((np.abs(np.real(turns @ z)) / np.maximum(known.sum(axis=0), 1)).mean(axis=1))

    coarse, turns = _delays(f.tobytes())
    fine = coarse[int(np.argmax(alike(turns)))] + np.linspace(-1.0, 1.0, 41) / (4.0 * width)
    found, before = alike(np.exp(2j * np.pi * np.outer(fine, f))), float(alike(np.ones((1, f.size), dtype=complex))[0])
    best = int(np.argmax(found))
    after = float(found[best])
    shared = z.shape[1] > 1 and before < LATE and 1.0 - after <= LEFT * (1.0 - before)
    return float(fine[best]) if after >= LATE and (shared or after - before >= LATER) else 0.0


@lru_cache(maxsize=4)
def _delays(lines: bytes) -> tuple[Floats, Complexes]:
    """Delays to try for given lines, and the factors that undo each; cached, since most responses of a campaign have the same lines."""
    f = np.frombuffer(lines)
    width, step = float(np.ptp(f)), float(np.median(np.diff(f)))
    # Up to a quarter turn from line to line, in four steps over the width of the maximum.
    count = int(np.ceil(width / step))
    delays = np.arange(-count, count + 1) / (4.0 * width)
    return delays, np.exp(2j * np.pi * np.outer(delays, f))
