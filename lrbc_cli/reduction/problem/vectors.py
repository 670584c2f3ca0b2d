"""Reference values of the terms, and the certificate vectors: parameter vectors for which errors are estimated and measured."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import norm as spnorm

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.model.terms import LowRankTerms

#: A term whose outer product has more entries than this has the reference value zero, since it would fill the sparse matrices.
FILL_LIMIT = 4096

#: Kinds of certificate vectors: decades above the local value of each term, (stiffness, damping and mass).
KINDS = {"loose": (-2.0, -2.0), "local": (0.0, 0.0), "clamped": (4.0, 1.0), "beyond": (9.0, 2.0)}

#: All kinds of certificate vectors in the order in which they are shown.
RESONANT = "resonant"
ERROR_KINDS = ("free", *KINDS, "random", RESONANT)

#: Decades around the local value within which random vectors are drawn, (stiffness, damping and mass).
RANDOM_DECADES = ((-4.0, 6.0), (-4.0, 1.0))


def highest_omega(K: sp.csc_array, M: sp.csc_array) -> float:
    """Approximate upper limit of the frequencies of the mesh [rad/s]: twice the largest sqrt(K_ii / M_ii); infinite without any."""
    stiffness, mass = np.abs(K.diagonal()), np.abs(M.diagonal())
    both = (stiffness > 0) & (mass > 0)
    return float(2.0 * np.sqrt(np.max(stiffness[both] / mass[both]))) if both.any() else float("inf")


def band_omega(K: sp.csc_array, M: sp.csc_array, band_hz: tuple[float, float]) -> float:
    """Angular frequency that represents a band in norms and local values [rad/s]: its upper end, at most ``highest_omega``.

    With a higher one the masses alone would determine the local stiffnesses, for lower lines too.
    """
    return float(min(2.0 * np.pi * band_hz[1], highest_omega(K, M)))


def local_scale(K: sp.csc_array, M: sp.csc_array, terms: LowRankTerms, omega: float) -> Floats:
    """Local value of each term, at which it is as stiff as the structure where it acts: nearly free below, nearly clamped above.

    Parameters
    ----------
    K, M : (n, n) csc_array
    terms : LowRankTerms
    omega : float
        Angular frequency that represents the band [rad/s], from ``band_omega``.

    Returns
    -------
    (nt,) float array
        In the unit of each term (stiffness, damping or mass).
    """
    stiffness = np.abs(K.diagonal()) + omega**2 * np.abs(M.diagonal())
    flexible = np.where(stiffness > 0, 1.0 / np.where(stiffness > 0, stiffness, 1.0), 0.0)
    flexibility = np.asarray((abs(terms.left).multiply(abs(terms.right))).T @ flexible)
    # Left and right vectors without a common entry: geometric mean of the flexibilities of both.
    root = np.sqrt(flexible)[:, None]
    sides = np.asarray([spnorm(sp.csc_array(side.multiply(root)), axis=0) for side in (terms.left, terms.right)]).prod(axis=0)
    flexibility = np.where(flexibility > 0, flexibility, sides)
    scale = np.where(flexibility > 0, 1.0 / np.where(flexibility > 0, flexibility, 1.0), 1.0)
    return np.asarray(scale / omega**terms.power)


def reference_values(terms: LowRankTerms, scale: Floats, omega: float) -> Floats:
    """(nt, 3) coefficients k, c, m of the reference values ``D_ref(s) = k + s c + s² m``, about which port FRFs are taken.

    Stiffness terms have their local stiffness and a loss factor of 0.1 (at omega), so that the reference state is neither free nor clamped
    and resonances that involve the terms are damped. Damping and mass terms have zero.
    """
    reference = np.zeros((terms.size, 3))
    fill = np.diff(terms.left.indptr) * np.diff(terms.right.indptr)
    use = (terms.power == 0) & (fill <= FILL_LIMIT)
    reference[use, 0] = scale[use]
    reference[use, 1] = 0.1 * scale[use] / omega
    return reference


def certificate_vectors(terms: LowRankTerms, scale: Floats, s: Complexes, count: int = 16) -> dict[str, list[Complexes]]:
    """Certificate vectors by kind: dynamic values D(s) from free to far beyond clamped, and random ones; independent of start values.

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
        # Damping tied to stiffness (33): time constants from negligible to a loss factor of order one.
        lag = 10.0 ** rng.uniform(-8.0, -3.0) * (terms.power == 0)
        vectors["random"].append(base + value * power * (1.0 + s[:, None] * lag))
    return vectors
