"""What the error is likely to be at lines that were never solved in full."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from scipy.special import nctdtrit, ndtri

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.reduction.problem.basis import Projected
from lrbc_cli.reduction.problem.norms import ROUNDING, SILENT
from lrbc_cli.reduction.problem.problem import Problem
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.steps.certify import measured_vectors
from lrbc_cli.reduction.steps.estimate import Estimator, Sweep

#: Rounding is known to such a factor.
ROUNDING_KNOWN = 10.0

#: Errors below this share of the tolerance do not tell how far the estimate is off, nor do fewer lines than this.
NEGLIGIBLE, LEAST_TELLING = 1e-4, 3

#: Share of the lines that the bound is for, and how sure it is of that.
SHARE, CONFIDENCE = 0.95, 0.95


#: Every which line of the grid is looked at for all vectors of the certificate: at each some of them resonate.
SPARSER = 8


@dataclass(frozen=True)
class Candidate:
    """A basis that may be the last.

    Attributes
    ----------
    rich, sweep : Sweep
        Of the rich basis, and of the one compressed from it.
    full : ReducedModel
        The rich model.
    basis : Projected
        Of the rich basis.
    """

    rich: Sweep
    sweep: Sweep
    full: ReducedModel = field(repr=False)
    basis: Projected = field(repr=False)

    @property
    def compressed(self) -> bool:
        """Whether it was."""
        return self.sweep is not self.rich


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


def unseen_bound(
    measured: Floats,
    expected: Floats,
    rounding: Floats,
    *,
    estimate: Floats,
    rounded: Floats,
    lost: Floats | float = 0.0,
    tolerance: float = 0.0,
) -> float:
    """Bound of the relative error of y over a band of which a few lines were solved in full.

    The final model differs from the rich one that it was compressed from by ``lost``, which is computed at every line. What the rich
    one misses is estimated at every line and measured at some; the logarithms of measured over estimated are taken as normal, and
    their tolerance limit raises the estimate. Lines where rounding may be all that was measured do not tell.

    Parameters
    ----------
    measured, expected, rounding : (m,) float arrays
        Measured errors of the rich model, and at the same lines what is estimated and what rounding may come to.
    estimate, rounded : (F,) float arrays
        Both over the band.
    lost : (F,) float array or float
        Relative difference of the final model to it.
    tolerance : float
        Of the error.

    Returns
    -------
    float
        NaN for fewer than two measured lines.
    """
    if measured.size < 2:
        return float("nan")
    tiny = np.finfo(float).tiny
    # Errors hold what rounding there was.
    seen = min(1.0, float(np.max(measured / np.maximum(rounding, tiny))))
    level = np.maximum(rounding, max(NEGLIGIBLE * tolerance, tiny))
    telling = (expected > level) | (measured > np.maximum(ROUNDING_KNOWN * rounding, level))
    if telling.sum() >= LEAST_TELLING:
        measured, expected, level = measured[telling], expected[telling], np.full(int(telling.sum()), tiny)
    ratio = np.log(np.maximum(measured, level) / np.maximum(expected, level))
    factor = np.exp(ratio.mean() + tolerance_factor(measured.size) * ratio.std(ddof=1))
    return float(np.max(lost + factor * estimate + seen * rounded))


def unseen_error(
    problem: Problem, estimator: Estimator, candidate: Candidate, final: ReducedModel, measured: Mapping[float, float]
) -> float:
    """Bound of the relative error of y at lines that were not solved in full, from estimates for all vectors of the certificate.

    Parameters
    ----------
    problem : Problem
    estimator : Estimator
    candidate : Candidate
    final : ReducedModel
        The compressed one, or the rich one itself.
    measured : dict
        Measured errors of the rich one by held-out line [Hz].
    """
    lines, terms = np.array(list(measured)), problem.model.terms
    grid = np.union1d(estimator.grid.lines_hz[::SPARSER], lines)
    rich = estimator.sweep(candidate.basis, grid, lambda ports: list(chain(*measured_vectors(ports, terms, problem.scale).values())))
    lost = np.zeros(grid.size)
    if candidate.compressed:
        lost = distance(rich.ports, final.ports(rich.ports.s), rich.vectors, problem.quantities, estimator.local)
    at = np.searchsorted(grid, lines)
    return unseen_bound(
        np.array(list(measured.values())),
        rich.estimate[at],
        rich.rounding[at],
        estimate=rich.estimate,
        rounded=rich.rounding,
        lost=lost,
        tolerance=problem.options.tolerance,
    )
