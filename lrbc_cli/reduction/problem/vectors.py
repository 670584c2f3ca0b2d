"""Reference values of the terms and the parameter vectors for which errors are estimated and measured."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import norm as spnorm

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.model.terms import LowRankTerms

#: A term whose outer product would have more entries than this stays out of the reference.
FILL_LIMIT = 4096

#: Kinds of certificate vectors as decades from the local value of each term: of stiffness, and of damping and mass.
KINDS = {"loose": (-2.0, -2.0), "local": (0.0, 0.0), "clamped": (4.0, 1.0), "beyond": (9.0, 2.0)}

#: Kinds of certificate vectors in the order in which they are shown.
RESONANT = "resonant"
ERROR_KINDS = ("free", *KINDS, "random", RESONANT)

#: Range in decades around the local value from which random vectors are drawn.
RANDOM_DECADES = ((-4.0, 6.0), (-4.0, 1.0))


def highest_omega(K: sp.csc_array, M: sp.csc_array) -> float:
    """Twice the largest local frequency, sqrt(K_ii / M_ii), about above all that the mesh can do [rad/s]; infinite without any."""
    stiffness, mass = np.abs(K.diagonal()), np.abs(M.diagonal())
    both = (stiffness > 0) & (mass > 0)
    return float(2.0 * np.sqrt(np.max(stiffness[both] / mass[both]))) if both.any() else float("inf")


def band_omega(K: sp.csc_array, M: sp.csc_array, band_hz: tuple[float, float]) -> float:
    """Angular frequency that stands for a band [rad/s]: its upper end, but none beyond all that the mesh can do.

    Above it the masses alone would set what is stiff, for the lower lines too.
    """
    return float(min(2.0 * np.pi * band_hz[1], highest_omega(K, M)))


def local_scale(K: sp.csc_array, M: sp.csc_array, terms: LowRankTerms, omega: float) -> Floats:
    """Value at which each term is as strong as the structure it acts on: free well below, clamped well above.

    Parameters
    ----------
    K, M : (n, n) csc_array
    terms : LowRankTerms
    omega : float
        Angular frequency that stands for the band [rad/s].

    Returns
    -------
    (nt,) float array
        In the unit of the term (stiffness, damping or mass).
    """
    stiffness = np.abs(K.diagonal()) + omega**2 * np.abs(M.diagonal())
    flexible = np.where(stiffness > 0, 1.0 / np.where(stiffness > 0, stiffness, 1.0), 0.0)
    flexibility = np.asarray((abs(terms.left).multiply(abs(terms.right))).T @ flexible)
    # Vectors without a common entry: the geometric mean of both sides.
    root = np.sqrt(flexible)[:, None]
    sides = np.asarray([spnorm(sp.csc_array(side.multiply(root)), axis=0) for side in (terms.left, terms.right)]).prod(axis=0)
    flexibility = np.where(flexibility > 0, flexibility, sides)
    scale = np.where(flexibility > 0, 1.0 / np.where(flexibility > 0, flexibility, 1.0), 1.0)
    return np.asarray(scale / omega**terms.power)


def reference_values(terms: LowRankTerms, scale: Floats, omega: float) -> Floats:
    """(nt, 3) coefficients of D_ref(s) = k + s c + s² m.

    Stiffness terms take their local stiffness with a loss factor of 0.1, so that the base system is neither free nor clamped
    and its resonances are damped where they move the terms; damping and mass terms stay at zero.
    """
    reference = np.zeros((terms.size, 3))
    fill = np.diff(terms.left.indptr) * np.diff(terms.right.indptr)
    use = (terms.power == 0) & (fill <= FILL_LIMIT)
    reference[use, 0] = scale[use]
    reference[use, 1] = 0.1 * scale[use] / omega
    return reference


def certificate_vectors(terms: LowRankTerms, scale: Floats, s: Complexes, count: int = 16) -> dict[str, list[Complexes]]:
    """Dynamic values D(s) from free through random to clamped and beyond, independent of any start values or bounds.

    Parameters
    ----------
    terms : LowRankTerms
    scale : (nt,) float array
        From ``local_scale``.
    s : (F,) complex array
    count : int
        Number of random vectors.

    Returns
    -------
    dict of lists of (F, nt) complex arrays
    """
    power = s[:, None] ** terms.power
    base = -terms.baseline * power
    vectors = {"free": [base]}
    stiff = terms.power == 0
    for kind, decades in KINDS.items():
        vectors[kind] = [base + 10.0 ** np.where(stiff, *decades) * scale * power]
    rng = np.random.default_rng(20180405)
    vectors["random"] = []
    for _ in range(count):
        low, high = (np.where(stiff, *ends) for ends in zip(*RANDOM_DECADES, strict=True))
        value = scale * 10.0 ** rng.uniform(low, high)
        # Damping tied to stiffness (33): a time constant from none to a loss factor of order one.
        lag = 10.0 ** rng.uniform(-8.0, -3.0) * (terms.power == 0)
        vectors["random"].append(base + value * power * (1.0 + s[:, None] * lag))
    return vectors
