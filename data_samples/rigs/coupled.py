"""FRFs of a coupled plate and cavity by Ritz vectors: plate modes, cavity modes, and the cavity's response to each plate mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from rigs.design import Array

try:
    import pymetis
except ImportError:  # no wheel on this platform: slower, otherwise the same
    pymetis = None

Solve = Callable[[Array], Array]


def factorise(matrix: sp.csr_array) -> Solve:
    """Solver for a real symmetric matrix, with a nested-dissection ordering where available."""
    if pymetis is None:
        lu = sla.splu(sp.csc_array(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return lambda rhs: np.asarray(lu.solve(rhs))
    off = sp.csr_array(matrix - sp.diags_array(matrix.diagonal()))
    off.eliminate_zeros()
    order = np.array(pymetis.nested_dissection(adjacency=pymetis.CSRAdjacency(off.indptr, off.indices))[0])
    permuted = sp.csc_array(matrix[order][:, order])
    lu = sla.splu(permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    def solve(rhs: Array) -> Array:
        result = np.empty_like(rhs)
        result[order] = lu.solve(np.ascontiguousarray(rhs[order]))
        return result

    return solve


def lowest_modes(stiffness: sp.csr_array, mass: sp.csr_array, count: int, shift: float, solve: Solve) -> tuple[Array, Array]:
    """Lowest eigenvalues and mass-normalised modes; `solve` inverts ``stiffness - shift * mass``, `shift` below all eigenvalues."""
    inverse = sla.LinearOperator(stiffness.shape, matvec=solve, dtype=float)
    start = np.random.default_rng(0).standard_normal(stiffness.shape[0])
    values, vectors = sla.eigsh(stiffness, count, mass, sigma=shift, OPinv=inverse, v0=start)
    order = np.argsort(values)
    return values[order], vectors[:, order]


class Cavity:
    """Air with rigid walls.

    Parameters
    ----------
    stiffness, mass : csr_array
        ``int grad p . grad q / rho`` and ``int p q / (rho c^2)``.
    outputs : (r, n) csr_array
        Interpolation of the pressure at the microphones.
    modes : int
        Number of cavity modes in the Ritz basis.
    """

    SHIFT = -((2 * np.pi * 150.0) ** 2)

    def __init__(self, stiffness: sp.csr_array, mass: sp.csr_array, outputs: sp.csr_array, modes: int = 120) -> None:
        self.stiffness, self.mass, self.outputs = stiffness, mass, outputs
        self.solve = factorise(sp.csr_array(stiffness - self.SHIFT * mass))
        self.eigenvalues, self.modes = lowest_modes(stiffness, mass, modes, self.SHIFT, self.solve)

    def basis(self, loads: Array) -> Array:
        """Mass-orthonormal basis of the modes and the static-like responses to `loads` (n, k)."""
        vectors = self.solve(loads)
        for _ in range(2):
            vectors = vectors - self.modes @ (self.modes.T @ (self.mass @ vectors))
            gram = vectors.T @ (self.mass @ vectors)
            values, rotation = np.linalg.eigh(gram)
            keep = values > 1e-10 * values[-1]
            vectors = vectors @ (rotation[:, keep] / np.sqrt(values[keep]))
        return np.hstack([self.modes, vectors])

    def ritz(self, loads: Array) -> tuple[Array, Array]:
        """Eigenvalues and modes within the basis for `loads`."""
        basis = self.basis(loads)
        ka = basis.T @ (self.stiffness @ basis)
        values, rotation = sl.eigh(0.5 * (ka + ka.T))
        return values, basis @ rotation

    def responding_to(self, loads: Array) -> AirModes:
        """Modes for the `loads` (n, m) of some plate modes."""
        values, modes = self.ritz(loads)
        return AirModes(values, loads.T @ modes, self.outputs @ modes)


@dataclass(frozen=True)
class AirModes:
    """The air in the basis of its mass-normalised modes.

    Attributes
    ----------
    eigenvalues : (k,) float array
        Squared angular frequencies.
    coupling : (m, k) float array
        ``int w p`` over the aperture, plate modes times air modes.
    observed : (r, k) float array
        Pressures of each mode at the microphones.
    """

    eigenvalues: Array
    coupling: Array
    observed: Array


@dataclass(frozen=True)
class PlateModes:
    """A plate in the basis of its modes.

    Attributes
    ----------
    eigenvalues : (m,) float array
        Squared angular frequencies.
    damping : (m, m) float array
        Viscous damping matrix.
    loss : (m, m) float array
        Imaginary part of the stiffness (hysteretic).
    load : (m,) float array
        Deflection of each mode at the hammer point.
    """

    eigenvalues: Array
    damping: Array
    loss: Array
    load: Array


def pressure_frfs(
    plate: PlateModes, air: AirModes, alpha: float, beta: float, frequencies: Array
) -> np.ndarray[tuple[int, ...], np.dtype[np.complex128]]:
    """Pressures per unit force at the hammer.

    Parameters
    ----------
    plate : PlateModes
    air : AirModes
    alpha, beta : float
        Proportional damping of the air.
    frequencies : (f,) array
        Lines [Hz].

    Returns
    -------
    frfs : (f, r) complex array
        [Pa/N]
    """
    s = air.coupling
    frfs = np.empty((frequencies.size, air.observed.shape[0]), dtype=complex)
    for k, omega in enumerate(2 * np.pi * frequencies):
        structure = np.diag(plate.eigenvalues - omega**2) + 1j * omega * plate.damping + 1j * plate.loss
        gas = air.eigenvalues - omega**2 + 1j * omega * (alpha + beta * air.eigenvalues)
        # Second row of (K - w^2 M) x = f, where M holds -s^T: p = -w^2 gas^-1 s^T q.
        transfer = -(omega**2) * (s.T / gas[:, None])
        q = np.linalg.solve(structure + s @ transfer, plate.load)
        frfs[k] = air.observed @ (transfer @ q)
    return frfs
