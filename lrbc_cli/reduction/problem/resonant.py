"""States of the terms that resonate at a given line: where a reduced model errs most, and where drawn states hardly ever lie."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.model.terms import LowRankTerms
from lrbc_cli.reduction.problem.vectors import RANDOM_DECADES
from lrbc_cli.reduction.reduced.ports import PortFrf

#: Loss factor that the terms have at least in such a state: a resonance without any damping has no relative error, and no bolted
#: structure is damped less.
LEAST_LOSS = 1e-3

#: Decades around the local values in which the shares of the terms are drawn, all patterns but the first.
PATTERN_DECADES = 2.0

#: Shares of the local values from which the terms are raised, and to which: a motion that a term alone holds is not set free, and terms
#: that depend on each other are not clamped together.
LOWEST, HIGHEST = 1e-12, 10.0 ** RANDOM_DECADES[0][1]

_SEED = 20180406


def resonant_vectors(ports: PortFrf, terms: LowRankTerms, scale: Floats, *, patterns: int, count: int) -> list[Complexes]:
    """Dynamic values D(s) of states that resonate at the very lines of some port FRFs.

    From free on, the stiffness terms are raised together in fixed shares d: ``D = free + a d``. A resonance is where ``I + a diag(d) Hpp``
    is singular, ``a = -1 / lambda`` with an eigenvalue of ``sqrt(d) Hpp sqrt(d)``. With light damping, where resonances are sharp, those
    are the negative ones of its real part, and the imaginary part moves them by its Rayleigh quotient. So no level has to be drawn, and
    none is missed because the mesh makes local stiffnesses as large as it likes.

    Parameters
    ----------
    ports : PortFrf
        Exact ones, or those of a reduced model.
    terms : LowRankTerms
    scale : (nt,) float array
        From ``local_scale``: shares of the first pattern.
    patterns : int
        Sets of shares, those after the first one drawn.
    count : int
        States of each pattern: those which the responses feel most.

    Returns
    -------
    list of (F, nt) complex arrays
        At lines where fewer states resonate, the free one stands in their place; none without terms of stiffness.
    """
    stiff = np.flatnonzero(terms.power == 0)
    free = -terms.baseline * ports.s[:, None] ** terms.power + 0j
    if not stiff.size or not patterns * count:
        return []
    free[:, stiff] += LOWEST * scale[stiff]
    about = ports.about(free).among(stiff)
    rng = np.random.default_rng(_SEED)
    found: list[Complexes] = []
    for pattern in range(patterns):
        shares = scale[stiff] * (10.0 ** rng.uniform(-PATTERN_DECADES, PATTERN_DECADES, stiff.size) if pattern else 1.0)
        for level in _levels(about, shares, count):
            D = free.copy()
            D[:, stiff] += level[:, None] * shares
            found.append(D)
    return found


def _levels(ports: PortFrf, shares: Floats, count: int) -> list[Complexes]:
    """(F,) factors of the shares at which a line resonates, those felt most first; zero where there are no more."""
    root = np.sqrt(shares)
    H = root[:, None] * ports.Hpp * root
    values, vectors = np.linalg.eigh(0.5 * (H.real + H.real.transpose(0, 2, 1)))
    usable = values < -1.0 / HIGHEST
    values = np.where(usable, values, -1.0)
    damping = np.abs(np.einsum("fik,fij,fjk->fk", vectors, H.imag, vectors) / values)
    heard = np.linalg.norm((ports.H0p * root) @ vectors, axis=1)
    driven = np.linalg.norm(vectors.transpose(0, 2, 1) @ (root[:, None] * ports.Hp0), axis=2)
    felt = np.where(usable, heard * driven / (np.abs(values) * np.maximum(damping, LEAST_LOSS)), -1.0)
    levels = np.where(usable, -1.0 / values * (1.0 + 1j * np.maximum(LEAST_LOSS - damping, 0.0)), 0.0)
    return list(np.take_along_axis(levels, np.argsort(-felt, axis=1, kind="stable")[:, :count], axis=1).T)


__all__ = ["LEAST_LOSS", "resonant_vectors"]
