"""Bending of plates by two elements that have nothing in common.

The nominal models take discrete Kirchhoff triangles (DKT) with the mass of Zienkiewicz's incomplete cubic, the rigs MITC4 quadrilaterals
with shear and rotatory inertia. DOFs of a node: UZ = w, ROTX = w_y and ROTY = -w_x, or the turn of the cross-section where it shears.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rigs.joints.system import Array, IntArray, Material, System, assemble

COMPONENTS = ("UZ", "ROTX", "ROTY")
#: Corners of the sides of a triangle; the side opposite of corner k comes k-th.
SIDES = ((1, 2), (2, 0), (0, 1))
SHEAR_CORRECTION = 5 / 6


@dataclass(frozen=True)
class Sheet:
    """A plate: a rectangle, or a ring around (0, 0) where it has radii; its grid is regular in (x, y) or (radius, angle).

    Attributes
    ----------
    start, end : (float, float)
        Corners [m], or (radius, angle) where the ring begins and ends.
    z : float
        [m]
    thickness : float
        [m]
    nominal, true : (int, int)
        Elements along both directions.
    ring : bool
    """

    start: tuple[float, float]
    end: tuple[float, float]
    z: float
    thickness: float
    nominal: tuple[int, int]
    true: tuple[int, int]
    ring: bool = False

    def grid(self, cells: tuple[int, int]) -> tuple[Array, IntArray]:
        """Points (n, 2) and quadrilaterals (m, 4), counterclockwise."""
        (nu, nv), wrap = cells, int(self.ring)
        u, v = np.meshgrid(np.linspace(self.start[0], self.end[0], nu + 1), np.linspace(self.start[1], self.end[1], nv + 1), indexing="ij")
        if self.ring:
            u, v = u[:, :-1], v[:, :-1]
            u, v = u * np.cos(v), u * np.sin(v)
        number = np.arange(u.size).reshape(u.shape)
        i, j = (a.ravel() for a in np.meshgrid(np.arange(nu), np.arange(nv), indexing="ij"))
        k = (j + 1) % nv if wrap else j + 1
        return np.stack([u.ravel(), v.ravel()], axis=1), np.stack([number[i, j], number[i + 1, j], number[i + 1, k], number[i, k]], axis=1)

    def weights(self, x: float, y: float) -> tuple[IntArray, Array]:
        """Nodes of the rig's grid around a point, and their bilinear weights."""
        at = np.array([np.hypot(x, y), np.arctan2(y, x) % (2 * np.pi)] if self.ring else [x, y])
        steps = (at - self.start) / np.subtract(self.end, self.start) * self.true
        cell = np.clip(np.floor(steps).astype(int), 0, np.subtract(self.true, 1))
        a, b = steps - cell
        columns = self.true[1] if self.ring else self.true[1] + 1
        nodes = [(cell[0] + i) * columns + (cell[1] + j) % columns for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
        return np.array(nodes), np.array([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b])


def gradients(xy: Array) -> tuple[Array, Array]:
    """Gradients (m, 3, 2) of the area coordinates of triangles, and their areas."""
    x, y = xy[..., 0], xy[..., 1]
    nxt, last = [1, 2, 0], [2, 0, 1]
    slope = np.stack([y[:, nxt] - y[:, last], x[:, last] - x[:, nxt]], axis=2)
    twice = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    return slope / twice[:, None, None], 0.5 * twice


def elasticity(material: Material, thickness: float) -> Array:
    """Moments by curvatures [N m]."""
    scale, nu = material.young * thickness**3 / 12 / (1 - material.nu**2), material.nu
    return scale * np.array([[1.0, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])


def curvatures(rotations: Array, gradient: Array) -> Array:
    """Curvatures (m, 3, d) from rotations (m, k, 2, d) of the nodes and gradients (m, k, 2) of their shape functions."""
    field = np.einsum("mkj,mkid->mijd", gradient, rotations)
    return np.stack([field[:, 0, 0], field[:, 1, 1], field[:, 0, 1] + field[:, 1, 0]], axis=1)


def dkt_stiffness(xy: Array, moments: Array) -> Array:
    """Discrete Kirchhoff triangles, (m, 9, 9) for corners (m, 3, 2): quadratic turns follow the slope at corners and along sides."""
    turns = np.zeros((xy.shape[0], 6, 2, 9))
    for i in range(3):
        turns[:, i, 0, 3 * i + 2], turns[:, i, 1, 3 * i + 1] = 1.0, -1.0
    for k, (i, j) in enumerate(SIDES):
        side = xy[:, j] - xy[:, i]
        length = np.linalg.norm(side, axis=1)
        along = side / length[:, None]
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        both = turns[:, i] + turns[:, j]
        # Along the side w is cubic: its slope in the middle follows from the ends.
        slope = -0.25 * np.einsum("mi,mid->md", along, both)
        slope[:, 3 * i] += 1.5 / length
        slope[:, 3 * j] -= 1.5 / length
        turn = 0.5 * np.einsum("mi,mid->md", across, both)
        turns[:, 3 + k] = along[:, :, None] * slope[:, None] + across[:, :, None] * turn[:, None]
    gradient, area = gradients(xy)
    matrix = np.zeros((xy.shape[0], 9, 9))
    for middle in (np.array([0, 0.5, 0.5]), np.array([0.5, 0, 0.5]), np.array([0.5, 0.5, 0])):
        shapes = [(4 * middle[i] - 1) * gradient[:, i] for i in range(3)]
        shapes += [4 * (middle[i] * gradient[:, j] + middle[j] * gradient[:, i]) for i, j in SIDES]
        strain = curvatures(turns, np.stack(shapes, axis=1))
        matrix += np.einsum("mad,ab,mbe,m->mde", strain, moments, strain, area / 3)
    return matrix


def cubic(xy: Array, at: Array) -> Array:
    """Zienkiewicz's deflection (m, 9) of the nine DOFs at area coordinates (3,)."""
    shapes = np.zeros((xy.shape[0], 9))
    bubble = 0.5 * at.prod()
    for i in range(3):
        others = [j for j in range(3) if j != i]
        shapes[:, 3 * i] = at[i] + sum(at[i] ** 2 * at[j] - at[i] * at[j] ** 2 for j in others)
        for j in others:
            side = (xy[:, j] - xy[:, i]) * (at[i] ** 2 * at[j] + bubble)
            shapes[:, 3 * i + 1] += side[:, 1]
            shapes[:, 3 * i + 2] -= side[:, 0]
    return shapes


def cubic_mass(xy: Array, surface_mass: float) -> Array:
    """Mass (m, 9, 9) of that deflection, by a collapsed Gauss rule."""
    points, weights = np.polynomial.legendre.leggauss(5)
    points, weights = 0.5 * (points + 1), 0.5 * weights
    area = gradients(xy)[1]
    matrix = np.zeros((xy.shape[0], 9, 9))
    for a, wa in zip(points, weights, strict=True):
        for b, wb in zip(points, weights, strict=True):
            shapes = cubic(xy, np.array([a, (1 - a) * b, (1 - a) * (1 - b)]))
            matrix += np.einsum("md,me,m->mde", shapes, shapes, 2 * area * surface_mass * wa * wb * (1 - a))
    return matrix


def bilinear(xi: float, eta: float) -> tuple[Array, Array]:
    """Shape functions (4,) of a quadrilateral and their derivatives (4, 2)."""
    a, b = np.array([-1.0, 1, 1, -1]), np.array([-1.0, -1, 1, 1])
    return 0.25 * (1 + a * xi) * (1 + b * eta), 0.25 * np.stack([a * (1 + b * eta), b * (1 + a * xi)], axis=1)


def mitc4(xy: Array, material: Material, thickness: float) -> tuple[Array, Array]:
    """Stiffness and mass (m, 12, 12) of MITC4 quadrilaterals with corners (m, 4, 2)."""
    count = xy.shape[0]
    turns = np.zeros((count, 4, 2, 12))
    for i in range(4):
        turns[:, i, 0, 3 * i + 2], turns[:, i, 1, 3 * i + 1] = 1.0, -1.0

    def sheared(xi: float, eta: float, direction: int) -> Array:
        """Shear (m, 12) along a natural coordinate, from the displacements."""
        shapes, slopes = bilinear(xi, eta)
        tangent = np.einsum("k,mki->mi", slopes[:, direction], xy)
        found = np.einsum("k,mi,mkid->md", shapes, tangent, turns)
        found[:, ::3] += slopes[:, direction]
        return found

    ends = [[sheared(0, eta, 0) for eta in (-1, 1)], [sheared(xi, 0, 1) for xi in (-1, 1)]]
    moments = elasticity(material, thickness)
    rigidity = SHEAR_CORRECTION * thickness * material.young / (2 * (1 + material.nu))
    inertia = np.tile([1.0, thickness**2 / 12, thickness**2 / 12], 4) * material.density * thickness
    stiffness, mass = np.zeros((2, count, 12, 12))
    for xi in (-(3**-0.5), 3**-0.5):
        for eta in (-(3**-0.5), 3**-0.5):
            shapes, slopes = bilinear(xi, eta)
            jacobian = np.einsum("ka,mki->mai", slopes, xy)
            weight = np.linalg.det(jacobian)
            strain = curvatures(turns, np.einsum("mia,ka->mki", np.linalg.inv(jacobian), slopes))
            stiffness += np.einsum("mad,ab,mbe,m->mde", strain, moments, strain, weight)
            natural = [0.5 * ((1 - s) * low + (1 + s) * high) for s, (low, high) in zip((eta, xi), ends, strict=True)]
            shear = np.einsum("mia,amd->mid", np.linalg.inv(jacobian), np.stack(natural))
            stiffness += rigidity * np.einsum("mad,mae,m->mde", shear, shear, weight)
            same = np.kron(np.outer(shapes, shapes), np.eye(3))
            mass += same * inertia * weight[:, None, None]
    return stiffness, mass


def triangles(quads: IntArray) -> IntArray:
    """Cut quadrilaterals along diagonals that alternate."""
    a, b, c, d = quads.T
    even = (np.arange(a.size) % 2 == 0)[:, None]
    first = np.where(even, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(even, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    return np.concatenate([first, second])


def plate(sheet: Sheet, material: Material, *, true: bool) -> System:
    """Matrices of a free plate: of the rig, or of the nominal model."""
    points, cells = sheet.grid(sheet.true if true else sheet.nominal)
    if true:
        stiffness, mass = mitc4(points[cells], material, sheet.thickness)
    else:
        cells = triangles(cells)
        stiffness = dkt_stiffness(points[cells], elasticity(material, sheet.thickness))
        mass = cubic_mass(points[cells], material.density * sheet.thickness)
    dofs = (3 * cells[:, :, None] + np.arange(3)).reshape(cells.shape[0], -1)
    count = points.shape[0]
    xyz = np.repeat(np.column_stack([points, np.full(count, sheet.z)]), 3, axis=0)
    return System(
        assemble(stiffness, dofs, 3 * count),
        assemble(mass, dofs, 3 * count),
        np.repeat(np.arange(count) + 1, 3),
        np.tile(np.array(COMPONENTS), count),
        xyz,
        np.zeros(3 * count, dtype=np.int64),
    )


def disc(radius: float, rings: int = 3) -> Array:
    """(p, 2) points that share a disc evenly."""
    edges = radius * np.sqrt(np.arange(rings + 1) / rings)
    found = []
    for k, (inner, outer) in enumerate(pairwise(edges)):
        angle = 2 * np.pi * (np.arange(8) + 0.5 * (k % 2)) / 8
        middle = np.sqrt(0.5 * (inner**2 + outer**2))
        found.append(middle * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(found)
