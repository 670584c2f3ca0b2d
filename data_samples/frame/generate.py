"""Write the frame sample: a cover plate in a frame, six bolts along its left edge, three states.

    python data_samples/frame/generate.py [--seed N] [--out DIR]

The model (Bogner-Fox-Schmit rectangles, ideal supports) goes to ``model/``, the measurements of another, finer model
(Argyris triangles, elastic supports) to ``frf/``. See the README beside this file.
"""

from __future__ import annotations

import argparse
import gzip
import io
import itertools
import json
import logging
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse as sp
import scipy.sparse.linalg as sla
import skfem
from numpy.typing import NDArray
from skfem.helpers import dd

Array = NDArray[np.float64]

LX, LY = 0.48, 0.40
CELLS = (12, 10)
SEGMENTS = 10
ALPHA, BETA = 4.0, 2.0e-6
COMPONENTS = np.array(["UZ", "ROTY", "ROTX", "TWIST"])
# skfem's DOFs of a node are w, w_x, w_y, w_xy; ROTY is -w_x.
SIGNS = np.array([1.0, -1.0, 1.0, 1.0])

HAMMER = (0.16, 0.12)
SENSORS = {"acc1": (0.32, 0.28), "acc2": (0.08, 0.20), "acc3": (0.215, 0.335), "acc4": (0.405, 0.095)}
ON_NODES = ("acc1", "acc2")
BOLTS = {f"B{i + 1}": LY * (i + 0.5) / 6 for i in range(6)}
JOBS: dict[str, list[str]] = {"tight": [], "loose-2": ["B3", "B4"], "loose-all": list(BOLTS)}

# Elastic supports of the true model: deflection [N/m2], slope [N] of a tight, a loose and the other edges.
HOLD, TIGHT, LOOSE, ELSEWHERE = 1.0e9, 3.0e4, 2.0e2, 1.0e6
BOLT_REACH = 0.035
LINES = np.arange(30.0, 501.0)
SEED = 11


@dataclass(frozen=True)
class Plate:
    """An isotropic plate.

    Attributes
    ----------
    young : float
        [Pa]
    nu : float
        Poisson's ratio.
    density : float
        [kg/m3]
    thickness : float
        [m]
    """

    young: float = 70e9
    nu: float = 0.33
    density: float = 2700.0
    thickness: float = 0.002

    def matrices(self, basis: skfem.Basis) -> tuple[sp.csr_array, sp.csr_array]:
        """Stiffness and mass without supports."""
        bending = self.young * self.thickness**3 / 12 / (1 - self.nu**2)
        nu = self.nu

        @skfem.BilinearForm
        def stiffness(u, v, _w):  # type: ignore[no-untyped-def]
            a, b = dd(u), dd(v)
            direct = a[0, 0] * b[0, 0] + a[1, 1] * b[1, 1] + nu * (a[0, 0] * b[1, 1] + a[1, 1] * b[0, 0])
            return bending * (direct + 2 * (1 - nu) * a[0, 1] * b[0, 1])

        @skfem.BilinearForm
        def mass(u, v, _w):  # type: ignore[no-untyped-def]
            return u * v

        return symmetric(stiffness.assemble(basis)), symmetric(mass.assemble(basis)) * (self.density * self.thickness)


def symmetric(matrix: sp.csr_array) -> sp.csr_array:
    """Mean of the matrix and its transpose."""
    matrix = sp.csr_array(matrix)
    return sp.csr_array(0.5 * (matrix + matrix.T))


def clean(matrix: sp.csr_array) -> sp.csr_array:
    """Round to eleven digits below the largest entry and drop what becomes zero."""
    matrix = sp.csr_array(matrix)
    step = 10.0 ** np.floor(np.log10(np.abs(matrix.data).max()) - 11)
    matrix.data = np.round(matrix.data / step) * step
    matrix.eliminate_zeros()
    return matrix


def write_matrix(path: Path, matrix: sp.csr_array, comment: str, symmetry: str = "general") -> None:
    """Write a Matrix Market file, compressed where the name ends with .gz; the same bytes each time."""
    buffer = io.BytesIO()
    scipy.io.mmwrite(buffer, sp.coo_array(matrix), comment=comment, symmetry=symmetry, precision=13)
    content = buffer.getvalue()
    path.write_bytes(gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def write_table(path: Path, heading: str, rows: list[str]) -> None:
    """Write a CSV file."""
    path.write_text("\n".join([heading, *rows]) + "\n", encoding="utf-8", newline="\n")


def write_model(folder: Path) -> None:
    """Write the nominal model: left edge pinned, the other edges clamped."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh = skfem.MeshQuad.init_tensor(np.linspace(0, LX, CELLS[0] + 1), np.linspace(0, LY, CELLS[1] + 1))
    basis = skfem.Basis(mesh, skfem.ElementQuadBFS(), intorder=6)
    stiffness, mass = Plate().matrices(basis)

    x, y = mesh.p
    inside = (x > 1e-9) & (x < LX - 1e-9) & (y > 1e-9) & (y < LY - 1e-9)
    left = (x < 1e-9) & (y > 1e-9) & (y < LY - 1e-9)
    keep = np.zeros(basis.N, dtype=bool)
    keep[basis.nodal_dofs[:, inside]] = True
    keep[basis.nodal_dofs[np.ix_([1, 3], np.flatnonzero(left))]] = True
    kind = np.empty(basis.N, dtype=int)
    node = np.empty(basis.N, dtype=int)
    for k in range(4):
        kind[basis.nodal_dofs[k]] = k
        node[basis.nodal_dofs[k]] = np.arange(mesh.nvertices)
    free = np.flatnonzero(keep)
    # By position, then component.
    free = free[np.lexsort((kind[free], y[node[free]].round(9), x[node[free]].round(9)))]
    sign = sp.diags_array(SIGNS[kind[free]])
    stiffness, mass = (clean(sign @ m[free][:, free] @ sign) for m in (stiffness, mass))
    write_matrix(folder / "stiffness.mtx", stiffness, "cover plate, left edge pinned; SI units", "symmetric")
    write_matrix(folder / "mass.mtx.gz", mass, "cover plate; SI units", "symmetric")
    write_matrix(folder / "damping.mtx.gz", clean(ALPHA * mass + BETA * stiffness), "viscous damping; SI units", "symmetric")

    edges = np.linspace(0, LY, SEGMENTS + 1)
    columns, positions = [], []
    for start, end in itertools.pairwise(edges):
        middles = mesh.p[:, mesh.facets].mean(axis=1)
        facets = np.flatnonzero((middles[0] < 1e-9) & (middles[1] > start) & (middles[1] < end))
        edge = skfem.FacetBasis(mesh, skfem.ElementQuadBFS(), facets=facets, intorder=6)

        @skfem.LinearForm
        def slope(v, w):  # type: ignore[no-untyped-def]
            return v.grad[0] * w.n[0] + v.grad[1] * w.n[1]

        columns.append(sign @ slope.assemble(edge)[free])
        positions.append(f"0,{0.5 * (start + end):.6g},0")
    write_matrix(folder / "edge.mtx", clean(sp.csr_array(np.array(columns).T)), "integral of dw/dn over each segment of the left edge")
    write_table(folder / "edge.csv", "x,y,z", positions)

    at = np.array([xy for name, xy in SENSORS.items() if name not in ON_NODES]).T
    rows = clean(sp.csr_array(sp.csr_array(basis.probes(at))[:, free] @ sign))
    write_matrix(folder / "sensors.mtx", rows, "deflection at acc3 and acc4")
    table = [f"{i},{node[d] + 1},{COMPONENTS[kind[d]]},{x[node[d]]:.6g},{y[node[d]]:.6g},0" for i, d in enumerate(free)]
    write_table(folder / "dofs.csv", "dof,node,component,x,y,z", table)
    write_table(folder / "bolts.csv", "name,x,y,z", [f"{name},-0.01,{y:.6g},0" for name, y in BOLTS.items()])
    print(f"n {free.size}, nnz K {stiffness.nnz}, M {mass.nnz}, {SEGMENTS} terms")


def write_points(path: Path) -> None:
    """Write where the plate is hit, and where the sensors on nodes are."""
    rows = [f"hammer,{HAMMER[0]:g},{HAMMER[1]:g},0,UZ,"]
    rows += [f"{name},{SENSORS[name][0]:g},{SENSORS[name][1]:g},0,UZ,acceleration" for name in ON_NODES]
    write_table(path, "name,x,y,z,component,quantity", rows)


def write_measurements(folder: Path, seed: int) -> None:
    """Write accelerances of the true model in each state."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    plate = Plate(
        young=70e9 * (1 + rng.choice([-1, 1]) * rng.uniform(0.003, 0.01)),
        density=2700.0 * (1 + rng.choice([-1, 1]) * rng.uniform(0.003, 0.006)),
    )
    damping = 1 + rng.uniform(-0.1, 0.1, 2)
    tightness = np.exp(rng.normal(0.0, 0.25, len(BOLTS)))
    mesh = skfem.MeshTri.init_tensor(np.linspace(0, LX, 15), np.linspace(0, LY, 13))
    basis = skfem.Basis(mesh, skfem.ElementTriArgyris(), intorder=10)
    stiffness, mass = plate.matrices(basis)
    edge = skfem.FacetBasis(mesh, skfem.ElementTriArgyris(), intorder=12)
    x, y = np.asarray(edge.global_coordinates())
    left = (x < 1e-9) & (np.asarray(edge.normals)[0] < -0.5)

    @skfem.BilinearForm
    def support(u, v, w):  # type: ignore[no-untyped-def]
        turn = (u.grad[0] * w.n[0] + u.grad[1] * w.n[1]) * (v.grad[0] * w.n[0] + v.grad[1] * w.n[1])
        return HOLD * u * v + w["slope"] * turn

    probes = sp.csr_array(basis.probes(np.array([HAMMER, *SENSORS.values()]).T))
    states = {}
    for job, loose in JOBS.items():
        slope = np.where(left, LOOSE, ELSEWHERE)
        settled = tightness * np.exp(rng.normal(0.0, 0.08, len(BOLTS)))
        for factor, (name, position) in zip(settled, BOLTS.items(), strict=True):
            if name not in loose:
                slope = slope + left * TIGHT * factor * np.exp(-(((y - position) / BOLT_REACH) ** 4))
        total = symmetric(stiffness + support.assemble(edge, slope=slope))
        values, modes = sla.eigsh(total.tocsc(), 60, mass.tocsc(), sigma=0.0, v0=np.ones(basis.N))
        omega = 2 * np.pi * LINES[:, None]
        damper = ALPHA * damping[0] + BETA * damping[1] * values
        shapes = probes @ modes
        modal = shapes[0] / (values - omega**2 + 1j * omega * damper)
        frfs = -(omega**2) * (modal @ shapes[1:].T)
        noise = rng.standard_normal(frfs.shape) + 1j * rng.standard_normal(frfs.shape)
        level = 0.003 * np.abs(frfs) + 0.001 * np.sqrt(np.mean(np.abs(frfs) ** 2, axis=0))
        frfs = frfs + noise * level / np.sqrt(2)
        heading = ",".join(["frequency_hz", *(f"{name}_{part}" for name in SENSORS for part in ("real", "imag"))])
        table = []
        for frequency, row in zip(LINES, frfs, strict=True):
            table.append(",".join([f"{frequency:g}", *(f"{part:.5e}" for h in row for part in (h.real, h.imag))]))
        write_table(folder / f"{job}.csv", heading, table)
        states[job] = {"loose": loose, "tightness": settled.round(4).tolist()}
        print(f"{job}: first modes", (np.sqrt(values[:4]) / (2 * np.pi)).round(1), "Hz")
    record = {"seed": seed, "plate": asdict(plate), "damping_factors": damping.tolist(), "jobs": states}
    (folder / "truth.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8", newline="\n")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent)
    arguments = parser.parse_args()
    logging.getLogger("skfem").setLevel(logging.ERROR)
    write_model(arguments.out / "model")
    write_points(arguments.out / "points.csv")
    write_measurements(arguments.out / "frf", arguments.seed)


if __name__ == "__main__":
    main()
