"""Symmetry of the operators and the form of a vibro-acoustic coupling, verified numerically."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

#: Two blocks count as equal where their difference is below this fraction of their norm.
EQUAL = 1e-8


@dataclass(frozen=True)
class Coupling:
    """How the system can be symmetrised.

    Attributes
    ----------
    symmetric : bool
        Z(s) is complex symmetric, for u-p systems after the acoustic rows are divided by -kappa s².
    kappa : float or None
        Ratio of the coupling blocks, M_as = -kappa K_saᵀ; None where there is no u-p coupling of that form.
    defect : float
        Largest relative asymmetry that is left.
    text : str
        The finding in words.
    """

    symmetric: bool
    kappa: float | None
    defect: float
    text: str


def _norm(matrix: sp.sparray) -> float:
    return float(np.linalg.norm(matrix.data)) if matrix.nnz else 0.0


def asymmetry(matrix: sp.csc_array) -> float:
    """Relative Frobenius norm of A - Aᵀ."""
    norm = _norm(matrix)
    return _norm((matrix - matrix.T).tocsc()) / norm if norm else 0.0


def coupling_of(K: sp.csc_array, C: sp.csc_array, M: sp.csc_array, is_acoustic: NDArray[np.bool_]) -> Coupling:
    """Find out whether Z(s) is symmetric, symmetrisable (u-p), or neither.

    Parameters
    ----------
    K, C, M : (n, n) csc_array
    is_acoustic : (n,) bool array

    Returns
    -------
    Coupling
    """
    s, a = np.flatnonzero(~is_acoustic), np.flatnonzero(is_acoustic)

    def block(X: sp.csc_array, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> sp.csc_array:
        return X[rows][:, cols].tocsc()

    defects = [asymmetry(block(X, i, i)) for X in (K, C, M) for i in (s, a)]
    # Coupling blocks against the geometric mean of the fields' own blocks: their units differ, and either may dwarf the coupling.
    stray, mixed = [], []
    for X, foreign in ((K, "as"), (M, "sa"), (C, "both")):
        upper, lower = block(X, s, a), block(X, a, s)
        scale = np.sqrt(_norm(block(X, s, s)) * _norm(block(X, a, a))) or max(_norm(upper), _norm(lower)) or 1.0
        stray.append(max(_norm(upper) if foreign != "as" else 0.0, _norm(lower) if foreign != "sa" else 0.0) / scale)
        mixed.append(_norm((upper - lower.T).tocsc()) / scale)
    whole = max(*defects, *mixed)
    if whole < EQUAL:
        # No acoustic rows need scaling; a symmetric coupling needs none either.
        return Coupling(True, None, whole, "symmetric")
    if not is_acoustic.any() or is_acoustic.all():
        return Coupling(False, None, whole, f"unsymmetric (relative asymmetry {whole:.1e}): LU")
    A, B = block(K, s, a), block(M, a, s)
    dot = float(np.real(B.multiply(A.T).sum()))
    if not A.nnz or not B.nnz or dot == 0.0:
        return Coupling(False, None, whole, f"unsymmetric and not of u-p form (relative asymmetry {whole:.1e}): LU")
    kappa = -dot / _norm(A) ** 2
    mismatch = _norm((B + kappa * A.T).tocsc()) / _norm(B)
    defect = max(*defects, *stray, mismatch)
    if defect < EQUAL:
        return Coupling(
            True, kappa, defect, f"u-p coupled, M_as = -kappa K_saᵀ with kappa = {kappa:.6g} (mismatch {mismatch:.1e}): symmetrised"
        )
    return Coupling(
        False,
        None,
        defect,
        f"u-p coupled, but coupling blocks or diagonal blocks are not transposes of each other (defect {defect:.1e}): LU",
    )
