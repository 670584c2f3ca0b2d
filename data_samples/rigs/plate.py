"""Bogner-Fox-Schmit plate on a uniform rectangular grid, as sums of Kronecker products of cubic Hermite line matrices.

Degrees of freedom of a node: w, w_x, w_y, w_xy. Kronecker products keep equal entries bitwise equal, so the matrices compress well.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from rigs.design import Array, Materials

# Coefficients (rows: 1, t, t^2, t^3) of the Hermite shape functions of w0, h w0', w1, h w1' on 0..1.
HERMITE = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [-3, -2, 3, -1], [2, 1, -2, 1]])


def hermite(t: Array, h: float, order: int = 0) -> Array:
    """Values (4, ...) of the Hermite shape functions, or their derivatives with respect to x = h t."""
    values = [np.polynomial.polynomial.polyval(t, np.polynomial.polynomial.polyder(HERMITE[:, j], order)) for j in range(4)]
    scale = np.array([1.0, h, 1.0, h]) / h**order
    return np.stack([s * v for s, v in zip(scale, values, strict=True)])


def line_matrix(count: int, h: float, left: int, right: int) -> sp.csr_array:
    """Integral of N^(left) N^(right) over a line of `count` elements of length `h`; 2 (count + 1) DOFs, value and slope of each node."""
    points, weights = np.polynomial.legendre.leggauss(4)
    t = 0.5 * (points + 1)
    element = np.einsum("iq,jq,q->ij", hermite(t, h, left), hermite(t, h, right), 0.5 * h * weights)
    if left == right:
        element = 0.5 * (element + element.T)
    dofs = 2 * np.arange(count)[:, None] + np.arange(4)
    rows = np.repeat(dofs, 4, axis=1).ravel()
    cols = np.tile(dofs, (1, 4)).ravel()
    size = 2 * (count + 1)
    return sp.csr_array(sp.coo_array((np.tile(element.ravel(), count), (rows, cols)), shape=(size, size)))


def plate_matrices(nx: int, ny: int, hx: float, hy: float, materials: Materials) -> tuple[sp.csr_array, sp.csr_array, sp.csr_array]:
    """Stiffness and mass of the free plate, and the share of E_x in the stiffness.

    Returns
    -------
    stiffness, mass, share : csr_array
        ``share = d stiffness / d ln E_x``: the bending along x, half of the coupling of the curvatures and half of the twist, which go with
        the geometric mean of E_x and E_y; the rest is the share of E_y.

        DOF ``4 (i (ny + 1) + j) + 2 a + b`` belongs to node (i, j) and the derivative of order (a, b).
    """
    dx, dy, d1, dxy = materials.bending
    x = {(a, b): line_matrix(nx, hx, a, b) for a, b in ((0, 0), (1, 1), (2, 2), (2, 0))}
    y = {(a, b): line_matrix(ny, hy, a, b) for a, b in ((0, 0), (1, 1), (2, 2), (2, 0))}
    coupling = sp.kron(x[2, 0], y[2, 0].T, format="csr")
    stiffness = (
        dx * sp.kron(x[2, 2], y[0, 0], format="csr")
        + dy * sp.kron(x[0, 0], y[2, 2], format="csr")
        + d1 * (coupling + coupling.T)
        + 4 * dxy * sp.kron(x[1, 1], y[1, 1], format="csr")
    )
    share = dx * sp.kron(x[2, 2], y[0, 0], format="csr") + 0.5 * (
        d1 * (coupling + coupling.T) + 4 * dxy * sp.kron(x[1, 1], y[1, 1], format="csr")
    )
    mass = materials.surface_mass * sp.kron(x[0, 0], y[0, 0], format="csr")
    # Kronecker order is (i, a, j, b): bring it to (i, j, a, b).
    order = np.arange(4 * (nx + 1) * (ny + 1)).reshape(nx + 1, 2, ny + 1, 2).transpose(0, 2, 1, 3).ravel()
    bending, inertia, along_x = (sp.csr_array(matrix[order][:, order]) for matrix in (stiffness, mass, share))
    return bending, inertia, along_x
