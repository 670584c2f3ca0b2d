"""A reduced model in coordinates in which the air is diagonal, and its solution by condensing the air out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg as la
from numpy.typing import NDArray

from lrbc_cli.reduction.reduced import ReducedModel

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]

#: The projected acoustic blocks count as symmetric, and what is left beside their diagonals as zero, below this fraction.
NEGLIGIBLE = 1e-9


def with_diagonal_air(model: ReducedModel) -> ReducedModel:
    """The same model with the modes of the rigid-walled cavity, in its acoustic subspace, as acoustic coordinates.

    Whatever multiplies the acoustic stiffness or mass as a whole, damping in proportion to them included, then stays diagonal.

    Parameters
    ----------
    model : ReducedModel

    Returns
    -------
    ReducedModel
        The given one where there is no air or its matrices are not symmetric, definite mass.
    """
    ns = model.structure
    if ns == model.size or np.iscomplexobj(model.K) or np.iscomplexobj(model.C):
        return model
    Ka, Ma = model.K[ns:, ns:], model.M[ns:, ns:]
    if any(np.abs(A - A.T).max() > NEGLIGIBLE * np.abs(A).max() for A in (Ka, Ma)):
        return model
    try:
        _, modes = la.eigh(0.5 * (Ka + Ka.T), 0.5 * (Ma + Ma.T))
    except la.LinAlgError:
        return model
    T = np.eye(model.size)
    T[ns:, ns:] = modes

    def turned(A: Any) -> Any:
        out = T.T @ A @ T
        air = out[ns:, ns:]
        diagonal = np.diag(np.diag(air))
        if np.abs(air - diagonal).max() <= NEGLIGIBLE * max(float(np.abs(air).max()), np.finfo(float).tiny):
            out[ns:, ns:] = diagonal
        return out

    return replace(
        model,
        K=turned(model.K),
        C=turned(model.C),
        M=turned(model.M),
        B=T.T @ model.B,
        L=model.L @ T,
        left=T.T @ model.left,
        right=T.T @ model.right,
        extras={name: {operator: turned(A) for operator, A in group.items()} for name, group in model.extras.items()},
    )


def air_is_diagonal(K: Any, C: Any, M: Any, model: ReducedModel) -> bool:
    """Whether the air can be condensed out by its diagonal: no term acts on it either."""
    ns = model.structure
    if ns in (0, model.size) or model.left[ns:].any() or model.right[ns:].any():
        return False
    return all(not (A[ns:, ns:] - np.diag(np.diag(A[ns:, ns:]))).any() for A in (K, C, M))


def condensed_solve(
    z: Complexes, D: Complexes, K: Any, C: Any, M: Any, model: ReducedModel, loads: Complexes | Floats, outputs: Complexes | Floats
) -> tuple[Complexes, Complexes]:
    """``Z x = B`` and ``Zᵀ v = Lᵀ`` with a diagonal air: one factorisation of the size of the structure.

    ``S = Z_ss - Z_sa Z_aa⁻¹ Z_as``; the transposed problem has the transposed Schur complement.

    Parameters
    ----------
    z : (F, 1, 1) complex array
    D : (F, nt) complex array
    K, C, M : (r, r) arrays
    model : ReducedModel
        For the terms and the size of the structure.
    loads : (r, n) array
    outputs : (r, R) array

    Returns
    -------
    x : (F, r, n) complex array
    v : (F, r, R) complex array
    """
    ns = model.structure

    def part(rows: slice, columns: slice) -> Any:
        out: Any = 0.0
        for power, A in enumerate((K, C, M)):
            piece = A[rows, columns]
            if piece.any():
                out = out + z**power * piece
        return out

    s, a = slice(0, ns), slice(ns, None)
    w = z[:, :, 0]
    air = np.asarray(np.diag(K[a, a]) + w * np.diag(C[a, a]) + w**2 * np.diag(M[a, a]))
    above, below = part(s, a), part(a, s)
    over = np.broadcast_to(above, (z.shape[0], ns, model.size - ns)) / air[:, None, :]
    left, right = model.left[s], model.right[s]
    S = part(s, s) + (left * D[:, None, :]) @ right.T - over @ below
    forward = loads[s] - over @ loads[a]
    u = np.linalg.solve(S, forward)
    q = (loads[a] - below @ u) / air[:, :, None]
    scaled = outputs[a] / air[:, :, None]
    backward = outputs[s] - np.swapaxes(np.broadcast_to(below, (z.shape[0], model.size - ns, ns)), 1, 2) @ scaled
    vs = np.linalg.solve(np.swapaxes(S, 1, 2), backward)
    va = scaled - np.swapaxes(over, 1, 2) @ vs
    return np.concatenate([u, q], axis=1), np.concatenate([vs, va], axis=1)
