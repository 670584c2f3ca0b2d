"""A reduced model in coordinates in which the air is diagonal, and its solution by condensing the air out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg as la

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.reduction.reduced.model import ReducedModel

#: The projected acoustic blocks count as symmetric, and what is left beside their diagonals as zero, below this fraction.
NEGLIGIBLE = 1e-9

#: Entries of the table of products of left and right vectors above which it is not formed.
PAIRS = 4_000_000


def air_modes(K: Any, M: Any, structure: int) -> Floats | None:
    """(na, na) modes of the rigid-walled cavity in its reduced coordinates, mass-normalised.

    Parameters
    ----------
    K, M : (r, r) arrays
    structure : int
        Structural coordinates, the first ones.

    Returns
    -------
    float array or None
        None where there is no air or its matrices are not symmetric and of definite mass.
    """
    if structure == K.shape[0]:
        return None
    Ka, Ma = K[structure:, structure:].real, M[structure:, structure:]
    if any(np.abs(A - A.T).max() > NEGLIGIBLE * np.abs(A).max() for A in (Ka, Ma)):
        return None
    try:
        return np.asarray(la.eigh(0.5 * (Ka + Ka.T), 0.5 * (Ma + Ma.T))[1])
    except la.LinAlgError:
        return None


def turned(A: Any, modes: Floats, structure: int) -> Any:
    """``Tᵀ A T`` for T that turns the air's coordinates only; what round-off leaves beside the diagonal of its block becomes zero."""
    ns = structure
    out = np.array(A)
    out[:, ns:] = out[:, ns:] @ modes
    out[ns:] = modes.T @ out[ns:]
    air = out[ns:, ns:]
    diagonal = np.diag(np.diag(air))
    if np.abs(air - diagonal).max() <= NEGLIGIBLE * max(float(np.abs(air).max()), np.finfo(float).tiny):
        out[ns:, ns:] = diagonal
    return out


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
    modes = None if np.iscomplexobj(model.C) else air_modes(model.K, model.M, ns)
    if modes is None:
        return model
    T = np.eye(model.size)
    T[ns:, ns:] = modes
    return replace(
        model,
        K=turned(model.K, modes, ns),
        C=turned(model.C, modes, ns),
        M=turned(model.M, modes, ns),
        B=T.T @ model.B,
        L=model.L @ T,
        left=T.T @ model.left,
        right=T.T @ model.right,
        extras={name: {operator: turned(A, modes, ns) for operator, A in group.items()} for name, group in model.extras.items()},
    )


def air_is_diagonal(K: Any, C: Any, M: Any, structure: int, left: Floats, right: Floats) -> bool:
    """Whether the air can be condensed out by its diagonal: no term acts on it either."""
    ns = structure
    if ns in (0, K.shape[0]) or left[ns:].any() or right[ns:].any():
        return False
    return all(not (A[ns:, ns:] - np.diag(np.diag(A[ns:, ns:]))).any() for A in (K, C, M))


def condensed_solve(
    z: Complexes,
    D: Complexes,
    operators: tuple[Any, Any, Any],
    terms: tuple[Floats, Floats],
    structure: int,
    loads: Complexes | Floats,
    outputs: Complexes | Floats,
) -> tuple[Complexes, Complexes]:
    """``Z x = B`` and ``Zᵀ v = Lᵀ`` with a diagonal air: one factorisation of the size of the structure.

    ``S = Z_ss - Z_sa Z_aa⁻¹ Z_as``; the transposed problem has the transposed Schur complement. What air and terms add to S is linear
    in one number a mode and one a term, so it is formed for all lines in one product.

    Parameters
    ----------
    z : (F, 1, 1) complex array
    D : (F, nt) complex array
    operators : three (r, r) arrays
        K, C, M.
    terms : two (r, nt) arrays
        Left and right vectors.
    structure : int
        Structural coordinates, the first ones.
    loads : (r, n) array
    outputs : (r, R) array

    Returns
    -------
    x : (F, r, n) complex array
    v : (F, r, R) complex array
    """
    ns, (K, C, M) = structure, operators
    s, a = slice(0, ns), slice(ns, None)
    w = z[:, :, 0]
    air = np.asarray(np.diag(K[a, a]) + w * np.diag(C[a, a]) + w**2 * np.diag(M[a, a]))
    above, below = _powers(K, C, M, s, a), _powers(K, C, M, a, s)
    left, right = terms[0][s], terms[1][s]
    S = np.asarray(z**2 * M[s, s] + z * C[s, s] + K[s, s], dtype=complex)
    S += weighted(D, left, right)
    for p, A in above:
        for q, B in below:
            S -= weighted(w ** (p + q) / air, A, B.T)
    up = sum(z**p * A for p, A in above)
    down = sum(z**q * B for q, B in below)
    inverse = 1.0 / air[:, :, None]
    forward = loads[s] - up @ (inverse * loads[a])
    backward = outputs[s] - np.swapaxes(down, 1, 2) @ (inverse * outputs[a])
    if np.abs(S - np.swapaxes(S, 1, 2)).max() <= NEGLIGIBLE * np.abs(S).max():
        both = np.linalg.solve(S, np.concatenate([forward, backward], axis=2))
        u, vs = both[:, :, : forward.shape[2]], both[:, :, forward.shape[2] :]
    else:
        u, vs = np.linalg.solve(S, forward), np.linalg.solve(np.swapaxes(S, 1, 2), backward)
    q = (loads[a] - down @ u) * inverse
    va = (outputs[a] - np.swapaxes(up, 1, 2) @ vs) * inverse
    return np.concatenate([u, q], axis=1), np.concatenate([vs, va], axis=1)


def _powers(K: Any, C: Any, M: Any, rows: slice, columns: slice) -> list[tuple[int, Any]]:
    """Blocks of K, C, M that are not zero, with their powers of s; a zero block of K where all are."""
    found = [(power, plain(A[rows, columns])) for power, A in enumerate((K, C, M)) if A[rows, columns].any()]
    return found or [(0, plain(K[rows, columns]))]


def plain(A: Any) -> Any:
    """The real part of an array that has no other, as the coupling in a stiffness with loss factors."""
    return A.real if not A.imag.any() else A


def weighted(weight: Complexes, left: Floats, right: Floats) -> Complexes:
    """(F, m, n) ``left diag(weight) rightᵀ`` for every line, by one real product where its table of pairs is small."""
    F, m, n = weight.shape[0], left.shape[0], right.shape[0]
    if weight.shape[1] * m * n > PAIRS:
        return np.asarray((left * weight[:, None, :]) @ right.T)
    pairs = np.ascontiguousarray((left.T[:, :, None] * right.T[:, None, :]).reshape(weight.shape[1], m * n))
    parts = np.concatenate([weight.real, weight.imag]) @ pairs
    return np.asarray((parts[:F] + 1j * parts[F:]).reshape(F, m, n))
