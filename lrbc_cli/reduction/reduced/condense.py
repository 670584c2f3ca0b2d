"""Faster solution of reduced u-p models: cavity modes make the acoustic blocks diagonal, and the air is condensed out at each line."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg as la

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.reduction.reduced.model import ReducedModel

#: Asymmetry of the acoustic blocks, and off-diagonal entries after the transformation, count as zero up to this fraction.
NEGLIGIBLE = 1e-9

#: Largest number of entries of the table of products of left and right vectors in ``weighted``.
PAIRS = 4_000_000


def air_modes(K: Any, M: Any, structure: int) -> Floats | None:
    """(na, na) mass-normalised modes of the rigid-walled cavity, in reduced acoustic coordinates.

    Parameters
    ----------
    K, M : (r, r) arrays
    structure : int
        Number of structural coordinates, the first ones.

    Returns
    -------
    float array or None
        None without air, or if its matrices are not symmetric or its mass is not positive definite.
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
    """``Tᵀ A T`` with T = diag(I, modes); off-diagonal entries of the acoustic block that are round-off become zero."""
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
    """The model with modes of the rigid-walled cavity as acoustic coordinates, which make the acoustic blocks diagonal.

    They stay diagonal when factors multiply the acoustic stiffness or mass, and with proportional damping.

    Parameters
    ----------
    model : ReducedModel

    Returns
    -------
    ReducedModel
        Unchanged without air, with a complex C, or if the acoustic matrices are not symmetric with a positive definite mass.
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
    """Whether the air can be condensed out: its blocks of K, C, M are diagonal, and no term acts on it."""
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
    """Solve ``Z x = B`` and ``Zᵀ v = Lᵀ`` with diagonal acoustic blocks: one factorisation of the size of the structure for each line.

    The Schur complement is ``S = Z_ss - Z_sa Z_aa⁻¹ Z_as``, and its transpose for the transposed problem. The contributions of air and
    terms to S are linear in one number for each mode and term, so they are formed for all lines in one product.

    Parameters
    ----------
    z : (F, 1, 1) complex array
        Lines s.
    D : (F, nt) complex array
        Dynamic values of the terms, finite.
    operators : three (r, r) arrays
        K, C, M.
    terms : two (r, nt) arrays
        Left and right vectors.
    structure : int
        Number of structural coordinates, the first ones.
    loads : (r, n) array
        B.
    outputs : (r, R) array
        Lᵀ.

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
    """Non-zero blocks of K, C, M with their powers of s; the (zero) block of K if all are zero."""
    found = [(power, plain(A[rows, columns])) for power, A in enumerate((K, C, M)) if A[rows, columns].any()]
    return found or [(0, plain(K[rows, columns]))]


def plain(A: Any) -> Any:
    """A as a real array if its imaginary part is zero, for example the coupling block of a complex stiffness."""
    return A.real if not A.imag.any() else A


def weighted(weight: Complexes, left: Floats, right: Floats) -> Complexes:
    """(F, m, n) ``left diag(weight) rightᵀ`` for every line; by one real product for all lines unless its table would be too large."""
    F, m, n = weight.shape[0], left.shape[0], right.shape[0]
    if weight.shape[1] * m * n > PAIRS:
        return np.asarray((left * weight[:, None, :]) @ right.T)
    pairs = np.ascontiguousarray((left.T[:, :, None] * right.T[:, None, :]).reshape(weight.shape[1], m * n))
    parts = np.concatenate([weight.real, weight.imag]) @ pairs
    return np.asarray((parts[:F] + 1j * parts[F:]).reshape(F, m, n))
