"""Statistical bound of the error at lines that were not solved with the full model, the second part of the certificate."""

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

#: Factor to which the rounding error is known.
ROUNDING_KNOWN = 10.0

#: Errors below this share of the tolerance are not used to calibrate the estimate, and at least this many lines are needed for it.
NEGLIGIBLE, LEAST_TELLING = 1e-4, 3

#: Share of the lines for which the bound holds, and the confidence of this.
SHARE, CONFIDENCE = 0.95, 0.95


#: All certificate vectors are evaluated at every SPARSER-th line of the grid; at each some of them resonate.
SPARSER = 8


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A rich basis and its compression, which becomes the result if its errors hold.

    Attributes
    ----------
    rich, sweep : Sweep
        Of the rich and of the compressed basis; the same object without compression.
    full : ReducedModel
        The reduced model on the rich basis.
    basis : Projected
        Projections of the rich basis.
    """

    rich: Sweep
    sweep: Sweep
    full: ReducedModel = field(repr=False)
    basis: Projected = field(repr=False)

    @property
    def compressed(self) -> bool:
        """Whether the basis was compressed."""
        return self.sweep is not self.rich


def distance(
    ports: PortFrf, other: PortFrf, vectors: Sequence[Complexes], groups: Sequence[Integers], local: Floats | None = None
) -> Floats:
    """(F,) relative difference of y between two sets of port FRFs, the largest over parameter vectors and physical quantities.

    Parameters
    ----------
    ports, other : PortFrf
        The first one counts as exact.
    vectors : sequence of (F, nt) complex arrays
        Dynamic values of the terms.
    groups : sequence of int arrays
        Indices of the responses that share a quantity.
    local : (R,) float array or None
        From ``local_responses``; limits the norm from below as in ``relative_error``.
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


def tolerance_factor(count: int, share: float = SHARE) -> float:
    """One-sided tolerance factor k: mean plus k standard deviations of ``count`` normal samples exceeds ``share`` of the population.

    With ``CONFIDENCE``; from the noncentral t distribution (Owen 1968), as tabulated in ISO 16269-6.
    """
    root = np.sqrt(count)
    return float(nctdtrit(count - 1, ndtri(share) * root, CONFIDENCE) / root)


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
    """Statistical bound of the relative error of y over a band in which a few lines were solved with the full model.

    The final model differs by ``lost``, computed at every line, from the rich model that it was compressed from. The error of the rich
    model is estimated at every line and measured at some. The logarithms of measured over estimated errors are taken as normal, and
    their tolerance limit multiplies the estimate. Lines where the measured error may be rounding only are left out of this.

    Parameters
    ----------
    measured, expected, rounding : (m,) float arrays
        At the solved lines: measured and estimated errors of the rich model, and possible rounding errors.
    estimate, rounded : (F,) float arrays
        Estimated errors of the rich model and possible rounding errors over the band.
    lost : (F,) float array or float
        Relative difference of the final to the rich model.
    tolerance : float
        Tolerance of the reduction.

    Returns
    -------
    float
        NaN for fewer than two solved lines.
    """
    if measured.size < 2:
        return float("nan")
    tiny = np.finfo(float).tiny
    # Measured errors include the actual rounding error, which limits the possible one.
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
    """``unseen_bound`` of a reduced model, from estimates for all certificate vectors at a part of the grid and the held-out lines.

    Parameters
    ----------
    problem : Problem
    estimator : Estimator
    candidate : Candidate
    final : ReducedModel
        The compressed model, or the rich one itself.
    measured : dict
        Measured errors of the rich model by held-out line [Hz].
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
