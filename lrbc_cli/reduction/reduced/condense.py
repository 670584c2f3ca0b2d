"""Faster solution of reduced u-p models: cavity modes make the acoustic blocks diagonal, and the air is condensed out at each line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg as la

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.reduction.reduced.model import ReducedModel

#: Asymmetry of the acoustic blocks, and off-diagonal entries after the transformation, count as zero up to this fraction.
NEGLIGIBLE = 1e-9

#: Largest number of entries of a table of products of left and right vectors.
PAIRS = 8_000_000


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
    Ka, Ma = 0.5 * (Ka + Ka.T), 0.5 * (Ma + Ma.T)
    try:
        # As in ``modal_structure``: the round-off of the lowest modes must not be relative to the highest one.
        shift = float(np.median(la.eigvalsh(Ka, Ma)))
        mu, modes = la.eigh(Ma, Ka + shift * Ma)
    except la.LinAlgError:
        return None
    return np.asarray(modes / np.sqrt(mu)) if mu[0] > 0.0 else None


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


class CondensedAir:
    """Solves ``Z x = B`` and ``Zᵀ v = Lᵀ`` with diagonal acoustic blocks: one factorisation of the size of the structure for each line.

    The Schur complement is ``S = Z_ss - Z_sa Z_aa⁻¹ Z_as``, and its transpose for the transposed problem. It is linear in one number for
    each block of the structure, term and mode of the air, so it is formed for many lines by one product with a table of these matrices,
    of which the lower triangles are enough if all are symmetric.

    Parameters
    ----------
    operators : three (r, r) arrays
        K, C, M, for which ``air_is_diagonal``.
    terms : two (r, nt) arrays
        Left and right vectors.
    structure : int
        Number of structural coordinates, the first ones.

    Attributes
    ----------
    symmetric : bool
        Whether S is, so that both problems share one factorisation.
    """

    def __init__(self, operators: tuple[Any, Any, Any], terms: tuple[Floats, Floats], structure: int) -> None:
        self._ns, (K, C, M) = structure, operators
        s, a = slice(0, structure), slice(structure, None)
        self._air = [np.diag(A[a, a]) for A in operators]
        self._above, self._below = _powers(K, C, M, s, a), _powers(K, C, M, a, s)
        self._blocks = [A[s, s] for A in operators]
        pairs = [(p + q, A, B.T) for p, A in self._above for q, B in self._below]
        # Left and right vectors of the terms, and by power of s those of the air: products that share a weight are one sum.
        self._products: list[tuple[int | None, list[tuple[Any, Any]]]] = [(None, [(terms[0][s], terms[1][s])])]
        self._products += [(power, [(A, B) for t, A, B in pairs if t == power]) for power in sorted({power for power, *_ in pairs})]
        self.symmetric = all(_is_symmetric(A) for A in self._blocks) and all(_balanced(found) for _, found in self._products)
        rows, columns = np.tril_indices(structure) if self.symmetric else np.indices((structure, structure)).reshape(2, -1)
        self._place = np.empty((structure, structure), dtype=np.intp)
        self._place[columns, rows] = self._place[rows, columns] = np.arange(rows.size)
        count = 3 + sum(found[0][0].shape[1] for _, found in self._products)
        self._table: tuple[Floats, Integers] | None = None
        if count * rows.size <= PAIRS:
            parts = [A[rows, columns][None] for A in self._blocks]
            parts += [np.asarray(sum((A[rows] * B[columns]).T for A, B in found)) for _, found in self._products]
            own = np.vstack(parts)
            lossy = np.flatnonzero(own.imag.any(axis=1)) if np.iscomplexobj(own) else np.zeros(0, dtype=np.intp)
            self._table = np.vstack([own.real, own.imag[lossy]]), lossy

    def solve(self, z: Complexes, D: Complexes, loads: Complexes | Floats, outputs: Complexes | Floats) -> tuple[Complexes, Complexes]:
        """Solutions of both problems.

        Parameters
        ----------
        z : (F, 1, 1) complex array
            Lines s.
        D : (F, nt) complex array
            Dynamic values of the terms, finite.
        loads : (r, n) array
            B.
        outputs : (r, R) array
            Lᵀ.

        Returns
        -------
        x : (F, r, n) complex array
        v : (F, r, R) complex array
        """
        ns, w = self._ns, z[:, :, 0]
        K, C, M = self._air
        diagonal = np.asarray(1.0 / (K + w * C + w**2 * M))
        S = self._schur(w, D, diagonal)
        count, inverse = loads.shape[1], diagonal[:, :, None]
        both = [inverse * loads[ns:], inverse * outputs[ns:]]
        turned = [(power, B.T) for power, B in self._below]
        forward, backward = loads[:ns] - _moved(self._above, z, both[0]), outputs[:ns] - _moved(turned, z, both[1])
        if self.symmetric:
            found = np.linalg.solve(S, np.concatenate([forward, backward], axis=2))
            u, vs = found[:, :, :count], found[:, :, count:]
        else:
            u, vs = np.linalg.solve(S, forward), np.linalg.solve(np.swapaxes(S, 1, 2), backward)
        q = both[0] - inverse * _moved(self._below, z, u)
        va = both[1] - inverse * _moved([(power, A.T) for power, A in self._above], z, vs)
        return np.concatenate([u, q], axis=1), np.concatenate([vs, va], axis=1)

    def cancelled(self, s: Complexes) -> Floats:
        """(F,) largest ratio of the parts of a mode of the air, K and s² M, to their sum at the lines s: digits that the solution loses."""
        K, C, M = self._air
        w = s[:, None]
        return np.asarray(((np.abs(K) + np.abs(w**2 * M)) / np.abs(K + w * C + w**2 * M)).max(axis=1, initial=0.0))

    def _schur(self, w: Complexes, D: Complexes, inverse: Complexes) -> Complexes:
        """(F, ns, ns) S at the lines w (F, 1), with ``1 / Z_aa`` (F, na) of the air."""
        weights = [D if power is None else -(w**power) * inverse for power, _ in self._products]
        if self._table is None:
            S = np.asarray(sum(w[:, :, None] ** power * A for power, A in enumerate(self._blocks)), dtype=complex)
            for weight, (_, found) in zip(weights, self._products, strict=True):
                for A, B in found:
                    S += weighted(weight, A, B)
            return S
        table, lossy = self._table
        weight = np.hstack([w**0, w, w**2, *weights])
        return np.take(_combined(np.hstack([weight, 1j * weight[:, lossy]]), table), self._place, axis=1)


def _is_symmetric(A: Any) -> bool:
    """Whether the asymmetry of a square array is negligible."""
    return bool(np.abs(A - A.T).max(initial=0.0) <= NEGLIGIBLE * np.abs(A).max(initial=0.0))


def _balanced(products: Sequence[tuple[Any, Any]], tries: int = 3) -> bool:
    """Whether the sum of the products of two (m, n) arrays, column by column, is symmetric for each column: tried on random vectors.

    Round-off of a mode that is not coupled is negligible beside the others.
    """
    for x, y in np.random.default_rng(0).standard_normal((tries, 2, products[0][0].shape[0])):
        found = np.array([[(x @ A) * (y @ B), (y @ A) * (x @ B)] for A, B in products])
        if np.abs((found[:, 0] - found[:, 1]).sum(axis=0)).max(initial=0.0) > NEGLIGIBLE * np.abs(found).max(initial=0.0):
            return False
    return True


def _moved(powers: Sequence[tuple[int, Any]], z: Complexes, x: Complexes) -> Complexes:
    """(F, m, k) ``sum z^p A x`` of (m, n) arrays for (F, n, k) x; a real A multiplies real and imaginary parts side by side."""
    parts = np.ascontiguousarray(x).view(float)

    def product(A: Any) -> Complexes:
        return np.asarray(A @ x if np.iscomplexobj(A) else (A @ parts).view(complex))

    return np.asarray(sum(z**power * product(A) for power, A in powers))


def _powers(K: Any, C: Any, M: Any, rows: slice, columns: slice) -> list[tuple[int, Any]]:
    """Non-zero blocks of K, C, M with their powers of s; the (zero) block of K if all are zero."""
    found = [(power, plain(A[rows, columns])) for power, A in enumerate((K, C, M)) if A[rows, columns].any()]
    return found or [(0, plain(K[rows, columns]))]


def plain(A: Any) -> Any:
    """A as a real array if its imaginary part is zero, for example the coupling block of a complex stiffness."""
    return A.real if not A.imag.any() else A


def weighted(weight: Complexes, left: Any, right: Any) -> Complexes:
    """(F, m, n) ``left diag(weight) rightᵀ`` for every line; by one real product for all lines unless its table would be too large."""
    F, m, n = weight.shape[0], left.shape[0], right.shape[0]
    if weight.shape[1] * m * n > PAIRS or np.iscomplexobj(left) or np.iscomplexobj(right):
        return np.asarray((left * weight[:, None, :]) @ right.T)
    pairs = np.ascontiguousarray((left.T[:, :, None] * right.T[:, None, :]).reshape(weight.shape[1], m * n))
    return _combined(weight, pairs).reshape(F, m, n)


def _combined(weight: Complexes, table: Floats) -> Complexes:
    """(F, m) product of a complex (F, n) and a real (n, m) array."""
    parts = np.concatenate([weight.real, weight.imag]) @ table
    out = np.empty((weight.shape[0], table.shape[1]), dtype=complex)
    out.real, out.imag = parts[: weight.shape[0]], parts[weight.shape[0] :]
    return out
