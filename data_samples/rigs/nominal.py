"""The nominal model of a design, written as ``model.h5``, ``dofs.csv`` and ``bolts.csv``.

Pinned left edge, the other edges clamped, hard walls; quadratic tetrahedra for the air.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path

import h5py
import numpy as np
import scipy.sparse as sp
import skfem
from skfem.helpers import dot, grad

from rigs.cavity import IntArray, block_grid, tetrahedra
from rigs.design import Array, Design, Materials
from rigs.plate import hermite, plate_matrices

COMPONENTS = ("UZ", "ROTX", "ROTY", "TWIST")
# The plate's DOFs of a node are w, w_y, w_x, w_xy; ROTY is -w_x.
COMPONENT_SIGN = (1.0, 1.0, -1.0, 1.0)
# Blocks are stored in steps of 2^-BITS of a power of two above their largest entry: exact symmetry and row sums.
BITS = 31
#: Corners and midsides of the tetrahedron on the lower half of a cell's front, in halves of its sides; the other is its mirror image.
CELL_NODES = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (2, 2, 2), (1, 0, 0), (1, 1, 0), (1, 1, 1), (2, 1, 0), (2, 1, 1), (2, 2, 1)])
#: Pressures on the plate are taken so far inside the cavity [m]. It adds entries of one step of ``BITS``; the stored sample has them.
INSIDE = 1e-9


@dataclass(frozen=True)
class Model:
    """The coupled model: ``(K - w^2 M) x = f``, plate DOFs first, pressures after them.

    Attributes
    ----------
    stiffness, mass : csr_array
        Unsymmetric (u, p) matrices in SI units.
    stiffness_x : csr_array
        What of the stiffness goes with E_x of the plate.
    node : (n,) int array
        Node number of each DOF.
    component : (n,) str array
        UZ, ROTX, ROTY, TWIST or PRES.
    xyz : (n, 3) float array
        Coordinates [m].
    structure_size : int
        Number of plate DOFs.
    """

    stiffness: sp.csr_array
    mass: sp.csr_array
    stiffness_x: sp.csr_array
    node: IntArray
    component: np.ndarray
    xyz: Array
    structure_size: int


def quantise(matrix: sp.csr_array, bits: int = BITS) -> sp.csr_array:
    """Round to whole multiples of a power of two, `bits` below the largest entry."""
    matrix = sp.csr_array(matrix)
    step = 2.0 ** (np.ceil(np.log2(np.abs(matrix.data).max())) - bits)
    rounded = sp.csr_array((np.round(matrix.data / step) * step, matrix.indices, matrix.indptr), shape=matrix.shape)
    rounded.eliminate_zeros()
    return rounded


def close_rows(matrix: sp.csr_array) -> sp.csr_array:
    """Set the diagonal such that each row sums to zero exactly: a constant pressure stores no energy of motion."""
    off = sp.csr_array(matrix - sp.dia_array((matrix.diagonal()[None, :], [0]), shape=matrix.shape))
    off.eliminate_zeros()
    return sp.csr_array(off - sp.diags_array(np.asarray(off.sum(axis=1)).ravel()))


def symmetric(matrix: sp.csr_array) -> sp.csr_array:
    """Mean of the matrix and its transpose."""
    return sp.csr_array(0.5 * (matrix + matrix.T))


def acoustic_basis(design: Design) -> tuple[skfem.Basis, IntArray]:
    """Quadratic tetrahedra of the cavity, and the lattice index (n, 3) of each DOF."""
    mesh = design.nominal
    grid = block_grid(design, mesh.aperture, mesh.sides, mesh.depths, mesh.neck, snap=True)
    cells = tetrahedra(grid)
    tets = skfem.MeshTet(np.ascontiguousarray(grid.points.T), np.ascontiguousarray(cells.T), sort_t=False, validate=False)
    basis = skfem.Basis(tets, skfem.ElementTetP2(), intorder=4)
    # Twice the lattice index of the vertices: midside nodes have whole indices too.
    lattice = np.empty((basis.N, 3), dtype=np.int64)
    lattice[basis.nodal_dofs[0]] = 2 * grid.lattice
    lattice[basis.edge_dofs[0]] = grid.lattice[tets.edges[0]] + grid.lattice[tets.edges[1]]
    return basis, lattice


@skfem.BilinearForm
def _stiffness(p, q, _w):  # type: ignore[no-untyped-def]
    return dot(grad(p), grad(q))


@skfem.BilinearForm
def _mass(p, q, _w):  # type: ignore[no-untyped-def]
    return p * q


def acoustic_matrices(basis: skfem.Basis, materials: Materials) -> tuple[sp.csr_array, sp.csr_array]:
    """``int grad p . grad q / rho`` and ``int p q delta / (rho c^2)``."""
    stiffness = sp.csr_array(_stiffness.assemble(basis)) / materials.air_density
    mass = sp.csr_array(_mass.assemble(basis)) * materials.compliance
    return symmetric(stiffness), symmetric(mass)


def tetrahedron_pressure(x: Array, y: Array, z: float, lower: bool) -> Array:
    """(10, q) quadratic shape functions on a tetrahedron at the front of a unit cell, y < x where `lower`; nodes as ``CELL_NODES``."""
    u, v = (x, y) if lower else (y, x)
    corner = (1 - u, u - v, v - z, np.full_like(u, z))
    return np.stack([c * (2 * c - 1) for c in corner] + [4 * a * b for a, b in combinations(corner, 2)])


def coupling_matrix(design: Design, basis: skfem.Basis, lattice: IntArray) -> sp.csr_array:
    """``int N_w N_p`` over the aperture: plate DOFs (all nodes, w w_y w_x w_xy) times pressures.

    Parameters
    ----------
    design : Design
    basis, lattice
        From ``acoustic_basis``.

    Notes
    -----
    The diagonals of the acoustic faces are diagonals of the plate elements too, so both shape functions are polynomials on each half of a
    plate element, and quadrature of degree 8 is exact. Plate elements at the same place in their cells have equal integrals.
    """
    (cells_x, cells_y), (hx, hy), mesh = design.plate_cells, design.plate_step, design.nominal
    points, weights = skfem.quadrature.get_quadrature(skfem.ElementTriP1, 8)
    # The two halves of a unit square with the diagonal (0, 0)-(1, 1).
    halves = {True: (points[0] + points[1], points[1]), False: (points[1], points[0] + points[1])}
    # The pressure of each point of the first layer of the neck, by twice its lattice index.
    front = np.flatnonzero(lattice[:, 2] <= 2)
    number = np.full(lattice[front].max(axis=0) + 1, -1, dtype=np.int64)
    number[tuple(lattice[front].T)] = front
    p, inside = mesh.plate, -INSIDE * mesh.neck / design.plate_origin[2]
    cell_i, cell_j = (a.ravel() for a in np.meshgrid(*map(np.arange, mesh.aperture), indexing="ij"))
    rows, cols, values = [], [], []
    for at_i, at_j, half in product(range(p), range(p), halves):
        tx, ty = halves[half]
        lower = at_i > at_j or (at_i == at_j and half)
        nx, ny = hermite(tx, hx).reshape(2, 2, -1), hermite(ty, hy).reshape(2, 2, -1)
        deflection = np.einsum("iaq,jbq->ijabq", nx, ny).reshape(16, -1) * (weights * hx * hy)
        local = deflection @ tetrahedron_pressure((at_i + tx) / p, (at_j + ty) / p, inside, lower).T
        i, j = p * cell_i + at_i, p * cell_j + at_j
        nodes = [(i + a) * (cells_y + 1) + j + b for a in (0, 1) for b in (0, 1)]
        plate = np.stack([4 * node + kind for node in nodes for kind in range(4)])
        offsets = CELL_NODES if lower else CELL_NODES[:, [1, 0, 2]]
        pressure = np.stack([number[2 * (mesh.sides[0] + cell_i) + a, 2 * (mesh.sides[2] + cell_j) + b, c] for a, b, c in offsets])
        shape = (16, 10, cell_i.size)
        rows.append(np.broadcast_to(plate[:, None], shape).ravel())
        cols.append(np.broadcast_to(pressure[None], shape).ravel())
        values.append(np.broadcast_to(local[:, :, None], shape).ravel())
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(cols))
    return sp.csr_array(sp.coo_array(entries, shape=(4 * (cells_x + 1) * (cells_y + 1), basis.N)))


def edge_nodes(design: Design, edge: str, row: int = 0) -> tuple[IntArray, IntArray]:
    """Indices (i, j) of the nodes along an edge without its ends, `row` lines inside of it."""
    nx, ny = design.plate_cells
    upright = edge in ("left", "right")
    along = np.arange(row + 1, (ny if upright else nx) - row)
    across = np.full(along.size, row if edge in ("left", "bottom") else (nx if upright else ny) - row)
    return (across, along) if upright else (along, across)


def free_plate_dofs(design: Design) -> IntArray:
    """DOFs that the supports leave: the slope across a pinned edge and the twist, nothing on the other edges and at the corners."""
    cells_x, cells_y = design.plate_cells
    keep = np.zeros((cells_x + 1, cells_y + 1, 4), dtype=bool)
    keep[1:-1, 1:-1] = True
    for edge in design.pinned:
        across, along = (2, 1) if edge in ("left", "right") else (1, 2)
        i, j = edge_nodes(design, edge)
        keep[i, j, across] = keep[i, j, 3] = True
        keep[i, j, along] = design.held_at_nodes
    return np.flatnonzero(keep.ravel())


def point_load(design: Design, x: float, y: float) -> sp.csc_array:
    """(plate DOFs, 1) unit force in +z anywhere on the nominal plate: the deflection's shape functions at the point."""
    (x0, y0, _), cells, steps = design.plate_origin, design.plate_cells, design.plate_step
    at = ((x - x0) / steps[0], (y - y0) / steps[1])
    cell = [min(max(int(a), 0), count - 1) for a, count in zip(at, cells, strict=True)]
    nx, ny = (hermite(np.array(a - c), h) for a, c, h in zip(at, cell, steps, strict=True))
    column = np.zeros((cells[0] + 1, cells[1] + 1, 2, 2))
    column[cell[0] : cell[0] + 2, cell[1] : cell[1] + 2] = np.einsum("ia,jb->ijab", nx.reshape(2, 2), ny.reshape(2, 2))
    free = free_plate_dofs(design)
    return sp.csc_array((column.ravel()[free] * np.tile(COMPONENT_SIGN, column.size // 4)[free])[:, None])


def build(design: Design) -> Model:
    """Assemble the nominal model."""
    materials = design.materials
    (x0, y0, z0), (cells_x, cells_y), (hx, hy) = design.plate_origin, design.plate_cells, design.plate_step
    basis, lattice = acoustic_basis(design)
    order = np.lexsort((lattice[:, 0], lattice[:, 1], lattice[:, 2]))
    ka, ma = acoustic_matrices(basis, materials)
    ka, ma = (m[order][:, order] for m in (ka, ma))
    ka, ma = close_rows(quantise(ka)), quantise(ma)

    free = free_plate_dofs(design)
    sign = sp.diags_array(np.tile(COMPONENT_SIGN, (cells_x + 1) * (cells_y + 1))[free])
    ks, ms, kx = (sp.csr_array(sign @ m[free][:, free] @ sign) for m in plate_matrices(cells_x, cells_y, hx, hy, materials))
    coupling = quantise(sp.csr_array(sign @ coupling_matrix(design, basis, lattice)[free][:, order]))

    stiffness = sp.csr_array(sp.block_array([[ks, coupling], [None, ka]], format="csr"))
    mass = sp.csr_array(sp.block_array([[ms, None], [-coupling.T, ma]], format="csr"))
    share = sp.csr_array(sp.block_diag([kx, sp.csr_array(ka.shape)], format="csr"))
    for matrix in (stiffness, mass, share):
        matrix.eliminate_zeros()
        matrix.sort_indices()

    i, j = np.divmod(free // 4, cells_y + 1)
    plate_xyz = np.stack([x0 + hx * i, y0 + hy * j, np.full(free.size, z0)], axis=1)
    plate_nodes = (cells_x + 1) * (cells_y + 1)
    return Model(
        stiffness,
        mass,
        share,
        np.concatenate([free // 4 + 1, plate_nodes + 1 + np.arange(basis.N)]),
        np.concatenate([np.array(COMPONENTS)[free % 4], np.full(basis.N, "PRES")]),
        np.concatenate([plate_xyz, basis.doflocs.T[order]]),
        free.size,
    )


def write_csr(file: h5py.File, name: str, matrix: sp.csr_array) -> None:
    """Write a CSR matrix as a group of three data sets."""
    group = file.create_group(name)
    group.attrs["encoding-type"] = "csr_matrix"
    group.attrs["encoding-version"] = "0.1.0"
    group.attrs["shape"] = np.array(matrix.shape, dtype=np.int64)
    options = {"compression": "gzip", "compression_opts": 9, "shuffle": True, "track_times": False}
    group.create_dataset("data", data=matrix.data, chunks=(min(131072, matrix.nnz),), **options)
    group.create_dataset("indices", data=matrix.indices.astype(np.int32), chunks=(min(262144, matrix.nnz),), **options)
    group.create_dataset("indptr", data=matrix.indptr.astype(np.int32), **options)


def _number(value: float) -> str:
    text = f"{value:.8f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def bolt_table(design: Design) -> str:
    """The text of ``bolts.csv``."""
    lines = ["name,x,y,z", *(f"{name}," + ",".join(_number(v) for v in xyz) for name, xyz in design.bolts.items())]
    return "\n".join(lines) + "\n"


def write(design: Design, model: Model, folder: Path) -> None:
    """Write the model as any FE program would export it."""
    folder.mkdir(parents=True, exist_ok=True)
    with h5py.File(folder / "model.h5", "w", track_order=False) as file:
        write_csr(file, "K", model.stiffness)
        write_csr(file, "M", model.mass)
        write_csr(file, "K_x", model.stiffness_x)
    lines = ["dof,node,component,x,y,z"]
    for dof, (node, component, xyz) in enumerate(zip(model.node, model.component, model.xyz, strict=True)):
        lines.append(f"{dof},{node},{component}," + ",".join(_number(v) for v in xyz))
    (folder / "dofs.csv").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    (folder / "bolts.csv").write_text(bolt_table(design), encoding="utf-8", newline="\n")
