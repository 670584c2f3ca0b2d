"""Finds out from K, C and M whether Z(s) is symmetric or can be made so (u-p models), which decides between LDLᵀ and LU."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

#: Two blocks count as equal if their difference is below this fraction of their norm.
EQUAL = 1e-8


@dataclass(frozen=True)
class Coupling:
    """Symmetry of the system, and kappa with which a u-p model (displacements and pressures) becomes symmetric.

    Attributes
    ----------
    symmetric : bool
        Z(s) is complex symmetric, in u-p models after the acoustic rows are divided by -kappa s².
    kappa : float or None
        Ratio of the coupling blocks, M_as = -kappa K_saᵀ (s structure, a acoustic); None without a coupling of this form.
    text : str
        The same in words.
    """

    symmetric: bool
    kappa: float | None
    text: str


def _norm(matrix: sp.sparray) -> float:
    return float(np.linalg.norm(matrix.data)) if matrix.nnz else 0.0


def asymmetry(matrix: sp.csc_array) -> float:
    """Frobenius norm of A - Aᵀ relative to that of A."""
    norm = _norm(matrix)
    return _norm((matrix - matrix.T).tocsc()) / norm if norm else 0.0


def _block_norms(X: sp.csc_array, is_acoustic: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(2, 2) Frobenius norms of the blocks of both fields, structure first."""
    column = np.repeat(is_acoustic, np.diff(X.indptr))
    at = 2 * is_acoustic[X.indices].astype(np.int8) + column
    # Scaled by the largest entry, since the square of 1e-200 would underflow.
    size = np.abs(X.data)
    largest = float(size.max(initial=0.0)) or 1.0
    squares = np.bincount(at, weights=(size / largest) ** 2, minlength=4)
    return np.asarray(largest * np.sqrt(squares).reshape(2, 2))


def coupling_of(K: sp.csc_array, C: sp.csc_array, M: sp.csc_array, is_acoustic: NDArray[np.bool_]) -> Coupling:
    """Determine from K, C and M whether Z(s) is symmetric, can be symmetrised (u-p), or neither.

    Parameters
    ----------
    K, C, M : (n, n) csc_array
    is_acoustic : (n,) bool array

    Returns
    -------
    Coupling
    """
    defects, stray, mixed = [], [], []
    for X, foreign in ((K, "as"), (M, "sa"), (C, "both")):
        norm, lack = _block_norms(X, is_acoustic), _block_norms((X - X.T).tocsc(), is_acoustic)
        defects += [lack[f, f] / norm[f, f] if norm[f, f] else 0.0 for f in (0, 1)]
        # Coupling blocks relative to the geometric mean of the diagonal blocks, whose units and sizes differ.
        scale = np.sqrt(norm[0, 0] * norm[1, 1]) or max(norm[0, 1], norm[1, 0]) or 1.0
        stray.append(max(norm[0, 1] if foreign != "as" else 0.0, norm[1, 0] if foreign != "sa" else 0.0) / scale)
        mixed.append(lack[0, 1] / scale)
    whole = max(*defects, *mixed)
    if whole < EQUAL:
        # Includes models without air, and symmetric couplings: no row needs scaling.
        return Coupling(True, None, "symmetric")
    if not is_acoustic.any() or is_acoustic.all():
        return Coupling(False, None, f"unsymmetric (relative asymmetry {whole:.1e}): LU")
    s, a = np.flatnonzero(~is_acoustic), np.flatnonzero(is_acoustic)
    A, B = K[:, a].tocsr()[s].tocsc(), M[:, s].tocsr()[a].tocsc()
    dot = float(np.real(B.multiply(A.T).sum()))
    if not A.nnz or not B.nnz or dot == 0.0:
        return Coupling(False, None, f"unsymmetric and not of u-p form (relative asymmetry {whole:.1e}): LU")
    kappa = -dot / _norm(A) ** 2
    mismatch = _norm((B + kappa * A.T).tocsc()) / _norm(B)
    defect = max(*defects, *stray, mismatch)
    if defect < EQUAL:
        return Coupling(True, kappa, f"u-p coupled, M_as = -kappa K_saᵀ with kappa = {kappa:.6g} (mismatch {mismatch:.1e}): symmetrised")
    return Coupling(
        False,
        None,
        f"u-p coupled, but coupling blocks or diagonal blocks are not transposes of each other (defect {defect:.1e}): LU",
    )
