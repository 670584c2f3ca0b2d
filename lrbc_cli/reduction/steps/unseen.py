"""What the error is likely to be at lines that were never solved in full."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import nctdtrit, ndtri

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.reduction.problem.norms import ROUNDING, SILENT
from lrbc_cli.reduction.reduced.ports import PortFrf

#: Errors below this are rounding, of the full solution too.
ROUNDING_LEVEL = 1e-11

#: Errors below this share of the tolerance that no estimate foresaw are rounding; their lines do not count, where so many others remain.
NEGLIGIBLE, LEAST_TELLING = 1e-4, 3

#: Share of the lines that the bound is for, and how sure it is of that.
SHARE, CONFIDENCE = 0.95, 0.95


def distance(
    ports: PortFrf, other: PortFrf, vectors: Sequence[Complexes], groups: Sequence[Integers], local: Floats | None = None
) -> Floats:
    """(F,) relative difference of y between two sets of port FRFs, worst over vectors and physical quantities.

    Parameters
    ----------
    ports, other : PortFrf
        The first one counts as exact.
    vectors : sequence of (F, nt) complex arrays
    groups : sequence of int arrays
        Responses that share a quantity.
    local : (R,) float array or None
        From ``local_responses``; silence counts as in the certificate.
    """
    worst = np.zeros(ports.lines)
    tiny = np.finfo(float).tiny
    for D in vectors:
        y, exact = other.evaluate(D), ports.evaluate(D)
        for group in groups:
            floor = tiny if local is None else max(ROUNDING * float(np.linalg.norm(local[group])), tiny)
            silent = np.maximum(SILENT * np.linalg.norm(ports.H00[:, group], axis=1), floor)
            norm = np.maximum(np.linalg.norm(exact[:, group], axis=1), silent)
            worst = np.maximum(worst, np.linalg.norm((y - exact)[:, group], axis=1) / norm)
    return worst


def tolerance_factor(count: int, share: float = SHARE, confidence: float = CONFIDENCE) -> float:
    """Standard deviations above the mean of ``count`` normal samples below which a share of all lies, one-sided, with confidence.

    The noncentral t distribution of Owen (1968), as tabled in ISO 16269-6.
    """
    root = np.sqrt(count)
    return float(nctdtrit(count - 1, ndtri(share) * root, confidence) / root)


def unseen_bound(measured: Floats, expected: Floats, estimate: Floats, lost: Floats, tolerance: float = 0.0) -> float:
    """Bound of the relative error of y over a band of which a few lines were solved in full.

    The final model differs from the rich one that it was compressed from by ``lost``, which is computed at every line. What the rich
    one misses is estimated at every line and measured at some; the logarithms of measured over estimated are taken as normal, and
    their tolerance limit raises the estimate.

    Parameters
    ----------
    measured, expected : (m,) float arrays
        Measured errors of the rich model, and its estimates at the same lines.
    estimate : (F,) float array
        Its estimates over the band.
    lost : (F,) float array
        Relative difference of the final model to it.
    tolerance : float
        Of the error; what lies far below it does not tell rounding from what the estimate misses.

    Returns
    -------
    float
        NaN for fewer than two measured lines.
    """
    if measured.size < 2:
        return float("nan")
    level = max(ROUNDING_LEVEL, NEGLIGIBLE * tolerance)
    telling = (measured > level) | (measured <= expected)
    if telling.sum() >= LEAST_TELLING:
        measured, expected, level = measured[telling], expected[telling], ROUNDING_LEVEL
    measured, expected, estimate = (np.maximum(values, level) for values in (measured, expected, estimate))
    ratio = np.log(measured / expected)
    factor = np.exp(ratio.mean() + tolerance_factor(measured.size) * ratio.std(ddof=1))
    return float(np.max(lost + factor * estimate))
