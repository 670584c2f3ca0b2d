"""Faster lines for structures without air whose damping is diagonal in the undamped modes; the terms enter by the port formula."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg as la

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.reduction.reduced.condense import NEGLIGIBLE, weighted
from lrbc_cli.reduction.reduced.ports import port_frf


@dataclass(frozen=True, kw_only=True)
class Motions:
    """Solutions for unit inputs and of the dual problem of each response, with the terms included in Z.

    Attributes
    ----------
    x : (F, r, n_in) complex array
        Solution of ``Z x = B``, in the coordinates of the solver.
    v : (F, r, R) complex array
        Solution of ``Zᵀ v = Lᵀ``, likewise.
    after : (F, nt, n_in) complex array
        ``cᵀ x`` for every term.
    before : (F, nt, R) complex array
        ``bᵀ v`` for every term.
    y : (F, R) complex array
        Displacement of each response over its own input.
    """

    x: Complexes = field(repr=False)
    v: Complexes = field(repr=False)
    after: Complexes = field(repr=False)
    before: Complexes = field(repr=False)
    y: Complexes = field(repr=False)


@dataclass(frozen=True)
class ModalStructure:
    """Modal coordinates of a structure, in which K, C and M are diagonal.

    Attributes
    ----------
    turn : (r, r) float array
        Modes as columns: maps modal to reduced coordinates.
    diagonals : three (r,) arrays
        Of K, C and M in modal coordinates.
    """

    turn: Floats = field(repr=False)
    diagonals: tuple[Any, Any, Any] = field(repr=False)

    def _flexible(self, z: Complexes) -> Complexes:
        """(F, r) ``1 / (K + s C + s² M)`` of each mode."""
        K, C, M = self.diagonals
        return np.asarray(1.0 / (K + z[:, None] * C + z[:, None] ** 2 * M))

    def transfer(self, z: Complexes, outputs: Floats, inputs: Floats) -> Complexes:
        """(F, m, n) ``outputs (K + s C + s² M)⁻¹ inputs`` at the lines z, from (m, r) and (r, n) arrays in reduced coordinates."""
        return weighted(self._flexible(z), outputs @ self.turn, (self.turn.T @ inputs).T)

    def motions(self, z: Complexes, D: Complexes, terms: tuple[Floats, Floats], B: Floats, L: Floats, input_of: Integers) -> Motions:
        """Solve for all inputs and responses: ``x = G (B + b u)``, ``G = (K + s C + s² M)⁻¹``, u from the port formula (14)-(18).

        Each line needs the solution of nt equations instead of r.

        Parameters
        ----------
        z : (F,) complex array
            Lines s.
        D : (F, nt) complex array
            Dynamic values of the terms.
        terms : two (r, nt) arrays
            Left and right vectors, in reduced coordinates as B and L.
        B : (r, n_in) array
        L : (R, r) array
        input_of : (R,) int array
            Which input each response belongs to.
        """
        G = self._flexible(z)
        left, right, loads, heard = (self.turn.T @ A for A in (*terms, B, L.T))
        H = weighted(G, np.hstack([heard, right]).T, np.hstack([loads, left]).T)
        nothing = np.zeros(D.shape, dtype=complex)
        ports = port_frf(H, z, nothing, np.zeros(L.shape[0], dtype=int), input_of)
        y, u, v, after, before = ports.motions(D, ports.H0p.transpose(0, 2, 1))
        G = G[:, :, None]
        return Motions(x=G * (loads + left @ u), v=G * (heard + right @ v), after=after, before=before, y=y)


def modal_structure(K: Any, C: Any, M: Any, omega: float) -> ModalStructure | None:
    """Modal coordinates of a structure, if they make its damping diagonal too.

    The eigenvalue problem is ``M x = mu (K + omega² M) x``: its round-off is small relative to the mu of modes up to omega, however high
    the highest frequency is.

    Parameters
    ----------
    K, C, M : (r, r) arrays
        Of a structure without air.
    omega : float
        Angular frequency in the band [rad/s].

    Returns
    -------
    ModalStructure or None
        None if the matrices are not symmetric, ``K + omega² M`` is not positive definite, or damping couples the modes.
    """
    if not any((A - np.diag(np.diag(A))).any() for A in (K, C, M)):
        return ModalStructure(np.eye(K.shape[0]), (np.diag(K), np.diag(C), np.diag(M)))
    if any(np.abs(A - A.T).max(initial=0.0) > NEGLIGIBLE * np.abs(A).max(initial=0.0) for A in (K, C, M)):
        return None
    stiff = K.real + omega**2 * M
    try:
        T = la.eigh(0.5 * (M + M.T), 0.5 * (stiff + stiff.T))[1]
    except la.LinAlgError:
        return None
    found = [diagonal_of(T.T @ A @ T) for A in (K.real, K.imag, C, M)]
    if any(diagonal is None for diagonal in found):
        return None
    return ModalStructure(np.asarray(T), (found[0] + 1j * found[1], *found[2:]))


def diagonal_of(A: Any) -> Any:
    """(r,) diagonal of a matrix; None if it has off-diagonal entries beyond round-off."""
    diagonal = np.diag(A)
    return None if np.abs(A - np.diag(diagonal)).max(initial=0.0) > NEGLIGIBLE * np.abs(diagonal).max(initial=0.0) else diagonal
