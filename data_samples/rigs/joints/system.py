"""Matrices with a DOF table, and how elements and parts are put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Material:
    """Isotropic.

    Attributes
    ----------
    young : float
        [Pa]
    nu : float
        Poisson's ratio.
    density : float
        [kg/m3]
    """

    young: float
    nu: float
    density: float


@dataclass(frozen=True)
class System:
    """A structure without its joints.

    Attributes
    ----------
    stiffness, mass : (n, n) csr_array
        [SI]
    node : (n,) int array
        Node of each DOF, from 1.
    component : (n,) str array
    xyz : (n, 3) float array
        [m]
    part : (n,) int array
        Which part a DOF belongs to.
    """

    stiffness: sp.csr_array
    mass: sp.csr_array
    node: IntArray
    component: np.ndarray
    xyz: Array
    part: IntArray

    def nearest(self, xyz: Sequence[float], component: str) -> int:
        """The DOF of that component next to a point."""
        dofs = np.flatnonzero(self.component == component)
        return int(dofs[np.argmin(np.linalg.norm(self.xyz[dofs] - np.asarray(xyz), axis=1))])

    def share(self, part: int) -> sp.csr_array:
        """What of the stiffness belongs to a part."""
        own = sp.diags_array((self.part == part).astype(float))
        return sp.csr_array(own @ self.stiffness @ own)


def symmetric(matrix: sp.csr_array) -> sp.csr_array:
    """Mean of the matrix and its transpose."""
    matrix = sp.csr_array(matrix)
    return sp.csr_array(0.5 * (matrix + matrix.T))


def assemble(elements: Array, dofs: IntArray, size: int) -> sp.csr_array:
    """Sum of element matrices (m, k, k) at their DOFs (m, k); entries at negative ones are left out."""
    rows, cols = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
    keep = (rows >= 0) & (cols >= 0)
    return symmetric(sp.csr_array(sp.coo_array((elements[keep], (rows[keep], cols[keep])), shape=(size, size))))


def join(systems: Sequence[System]) -> System:
    """Parts side by side, nodes numbered on."""
    starts = np.cumsum([0, *(int(s.node.max()) for s in systems)])
    return System(
        sp.csr_array(sp.block_diag([s.stiffness for s in systems], format="csr")),
        sp.csr_array(sp.block_diag([s.mass for s in systems], format="csr")),
        np.concatenate([s.node + start for s, start in zip(systems, starts, strict=False)]),
        np.concatenate([s.component for s in systems]),
        np.concatenate([s.xyz for s in systems]),
        np.concatenate([np.full(s.node.size, k) for k, s in enumerate(systems)]),
    )
