"""Values of the terms for which the structure resonates exactly at a given line, used by estimate and certificate.

A reduced model errs most at such states, and randomly drawn states hardly ever are near one.
"""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.model.terms import LowRankTerms
from lrbc_cli.reduction.problem.vectors import RANDOM_DECADES
from lrbc_cli.reduction.reduced.ports import PortFrf

#: Least loss factor in such a state: a resonance without damping has no relative error, and no bolted structure is damped less.
LEAST_LOSS = 1e-3

#: Decades around the local values within which the shares of all patterns but the first are drawn.
PATTERN_DECADES = 2.0

#: Lowest and highest share of the local values. Above zero, so that a motion held by one term only does not become free; and finite, since
#: linearly dependent terms cannot all be clamped.
LOWEST, HIGHEST = 1e-12, 10.0 ** RANDOM_DECADES[0][1]

_SEED = 20180406


def resonant_vectors(ports: PortFrf, terms: LowRankTerms, scale: Floats, *, patterns: int, count: int) -> list[Complexes]:
    """Dynamic values D(s) of the terms for which the structure resonates at each line of the port FRFs.

    The stiffness terms are raised from free with fixed shares d: ``D = free + a d``. A line is a resonance if ``I + a diag(d) Hpp`` is
    singular, ``a = -1 / lambda`` with an eigenvalue lambda of ``sqrt(d) Hpp sqrt(d)``. With light damping (sharp resonances) these are the
    negative eigenvalues of its real part; the Rayleigh quotient of the imaginary part gives their damping. Levels a need not be drawn, so
    none is missed however much the local stiffnesses depend on the mesh.

    Parameters
    ----------
    ports : PortFrf
        Exact, or of a reduced model.
    terms : LowRankTerms
    scale : (nt,) float array
        From ``local_scale``; the shares of the first pattern.
    patterns : int
        Number of sets of shares; all but the first are drawn at random.
    count : int
        States of each pattern at each line: those with the largest effect on the responses.

    Returns
    -------
    list of (F, nt) complex arrays
        At lines with fewer resonant states the free state takes their place; empty without stiffness terms.
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
    """At most ``count`` arrays of (F,) levels a at which each line resonates, largest effect on responses first; 0 if there are no more."""
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
