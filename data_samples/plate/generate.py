"""Write the plate sample: a plate on six bolts in CalculiX, and FRFs of a finer, somewhat different plate in four states.

    python data_samples/plate/generate.py [--seed N] [--out DIR]

Needs CalculiX (``ccx`` on the path). See the README beside this file.
"""

from __future__ import annotations

import argparse
import gzip
import itertools
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as sla
from numpy.typing import NDArray

from lrbc_cli.io.frf import write_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet

Floats = NDArray[np.float64]

LENGTH, WIDTH, THICKNESS = 300.0, 200.0, 4.0  # mm
YOUNG, POISSON, DENSITY = 70000.0, 0.33, 2.7e-9  # N/mm2, t/mm3
BOLTS = {"B1": (20, 20), "B2": (150, 20), "B3": (280, 20), "B4": (20, 180), "B5": (150, 180), "B6": (280, 180)}
STIFFNESS = {"UX": 5000.0, "UY": 5000.0, "UZ": 1000.0}  # N/mm, of a tight bolt
HAMMER = (63.3333, 60.0)
SENSORS = {"acc1": (20, 100), "acc2": (106.6667, 180), "acc3": (193.3333, 60), "acc4": (236.6667, 140), "acc5": (280, 100)}
LINES = np.arange(150.0, 850.1, 1.25)

#: Stiffness that is left of the bolts that are not tight.
JOBS: dict[str, dict[str, float]] = {"tight-1": {}, "tight-2": {}, "b5-loose": {"B5": 0.03}, "b3-half-b4-loose": {"B3": 0.3, "B4": 0.01}}
#: What the measured plate differs in.
YOUNG_MEASURED, LOSS_FACTOR, SCATTER, RETORQUE, NOISE = 1.015 * YOUNG, 0.012, 0.15, 0.06, 0.01
SEED = 5
MODES = 120

#: Nodes of C3D20 on the half steps of its cell, in the order of CalculiX.
_CORNERS = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)]
_MIDDLES = [(1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)]
_CELL = [*_CORNERS, *_MIDDLES, (0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)]


def grid(end: float, middle: int, parts: int) -> Floats:
    """Lines of the mesh with their half steps: 20 mm at both ends, as many cells between, each in so many parts [mm]."""
    lines = np.concatenate([[0.0], np.linspace(20.0, end - 20.0, middle + 1), [end]])
    return np.interp(np.arange(0, 2 * parts * (lines.size - 1) + 1) / (2 * parts), np.arange(lines.size), lines)


def input_file(parts: int, young: float, springs: bool) -> tuple[str, dict[tuple[float, float, float], int]]:
    """The input of CalculiX: C3D20R, springs to ground or none, matrices as output; nodes by place."""
    axes = grid(LENGTH, 6, parts), grid(WIDTH, 4, parts), np.array([0.0, 0.5 * THICKNESS, THICKNESS])
    places = [at for at in itertools.product(*(range(axis.size) for axis in axes)) if sum(i % 2 for i in at) < 2]
    places.sort(key=lambda at: at[::-1])
    number = {at: n for n, at in enumerate(places, start=101)}
    where = {tuple(round(float(axis[i]), 3) for axis, i in zip(axes, at, strict=True)): n for at, n in number.items()}
    text = ["*HEADING", "plate on six bolts; mm, N, t", "*NODE, NSET=ALL"]
    text += [f"{n}, " + ", ".join(f"{axis[i]:.6g}" for axis, i in zip(axes, at, strict=True)) for at, n in number.items()]
    text.append("*ELEMENT, TYPE=C3D20R, ELSET=PLATE")
    cells = itertools.product(range(0, axes[0].size - 1, 2), range(0, axes[1].size - 1, 2))
    count = 0
    for count, (i, j) in enumerate(cells, start=1):
        nodes = [str(number[i + a, j + b, c]) for a, b, c in _CELL]
        text += [", ".join([str(count), *nodes[:10]]) + ",", ", ".join(nodes[10:])]
    for direction, (component, stiffness) in enumerate(STIFFNESS.items() if springs else (), start=1):
        text.append(f"*ELEMENT, TYPE=SPRING1, ELSET={component}")
        text += [f"{count + 6 * (direction - 1) + k}, {where[(*map(float, at), 0.0)]}" for k, at in enumerate(BOLTS.values(), start=1)]
        text += [f"*SPRING, ELSET={component}", str(direction), f"{stiffness:.1f}"]
    text += ["*MATERIAL, NAME=ALUMINIUM", "*ELASTIC", f"{young:g}, {POISSON:g}", "*DENSITY", f"{DENSITY:g}"]
    text += ["*SOLID SECTION, ELSET=PLATE, MATERIAL=ALUMINIUM", "*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "1", "*END STEP"]
    return "\n".join(text) + "\n", where


def matrices(folder: Path) -> tuple[sp.csc_array, sp.csc_array, list[str]]:
    """K, M and the ``node.direction`` of each row, as CalculiX wrote them (upper triangles)."""
    dofs = (folder / "plate.dof").read_text().split()
    found = []
    for ending in ("sti", "mas"):
        row, column, value = np.loadtxt(folder / f"plate.{ending}", unpack=True)
        half = sp.coo_array((value, (row.astype(np.int32) - 1, column.astype(np.int32) - 1)), shape=(len(dofs),) * 2)
        found.append(sp.csc_array(half + half.T - sp.diags_array(half.diagonal())))
    return found[0], found[1], dofs


def run(folder: Path, text: str) -> None:
    """Let CalculiX write ``plate.sti``, ``plate.mas`` and ``plate.dof``."""
    (folder / "plate.inp").write_text(text)
    subprocess.run(["ccx", "plate"], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def main() -> None:
    """Write the model and its measurements."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    chosen = parser.parse_args()
    out, rng = chosen.out, np.random.default_rng(chosen.seed)
    (out / "frf").mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        text, nodes = input_file(1, YOUNG, springs=True)
        run(folder, text)
        (out / "plate.inp").write_text(text)
        shutil.copy(folder / "plate.dof", out)
        for ending in ("sti", "mas"):
            packed = gzip.compress((folder / f"plate.{ending}").read_bytes(), 9, mtime=0)
            (out / f"plate.{ending}.gz").write_bytes(packed)
    bolts = [f"{bolt},{x},{y},0\n" for bolt, (x, y) in BOLTS.items()]
    (out / "bolts.csv").write_text("name,x,y,z\n" + "".join(bolts))
    rows = [f"{bolt},{nodes[(*map(float, at), 0.0)]},,{c},{k:g}\n" for bolt, at in BOLTS.items() for c, k in STIFFNESS.items()]
    (out / "bushings.csv").write_text("bolt,node_a,node_b,component,stiffness\n" + "".join(rows))
    built = {bolt: float(np.exp(rng.normal(0.0, SCATTER))) for bolt in BOLTS}
    for job, left in JOBS.items():
        torque = {bolt: built[bolt] * float(np.exp(rng.normal(0.0, RETORQUE))) * left.get(bolt, 1.0) for bolt in BOLTS}
        records = measured(torque, nodes, rng)
        write_frf(out / "frf" / f"{job}.uff", FrfSet(source=job, records=tuple(records)))


def measured(springs: Mapping[str, float], nodes: Mapping[tuple[float, float, float], int], rng: np.random.Generator) -> list[FrfRecord]:
    """FRFs of the finer plate; the test's points have the node numbers of the model."""
    with tempfile.TemporaryDirectory() as work:
        text, finer = input_file(2, YOUNG_MEASURED, springs=False)
        run(Path(work), text)
        K, M, dofs = matrices(Path(work))
    row = {name: index for index, name in enumerate(dofs)}
    ground = np.zeros(len(dofs))
    for (bolt, place), (direction, stiffness) in itertools.product(BOLTS.items(), enumerate(STIFFNESS.values(), start=1)):
        ground[row[f"{finer[(*map(float, place), 0.0)]}.{direction}"]] = stiffness * springs[bolt]
    stiff = sp.csc_array(K + sp.diags_array(ground))
    top = {name: (round(float(x), 3), round(float(y), 3), THICKNESS) for name, (x, y) in {"hammer": HAMMER, **SENSORS}.items()}
    at = {name: row[f"{finer[place]}.3"] for name, place in top.items()}
    force = np.zeros(len(dofs))
    force[at["hammer"]] = 1.0
    sensors = [at[name] for name in SENSORS]
    # Modes far beyond the band, and the static deflection that the rest of them give.
    _, modes = sla.eigsh(stiff, MODES, M, sigma=0.0)
    basis, _ = np.linalg.qr(np.column_stack([modes, sla.spsolve(stiff, force)]))
    small_K, small_M, load = basis.T @ (stiff @ basis + 1j * LOSS_FACTOR * (K @ basis)), basis.T @ (M @ basis), basis.T @ force
    values = np.empty((LINES.size, len(sensors)), dtype=complex)
    for index, omega in enumerate(2.0 * np.pi * LINES):
        x = basis[sensors] @ np.linalg.solve(small_K - omega**2 * small_M, load)
        values[index] = -(omega**2) * x * 1e-3  # mm/s2/N to m/s2/N
    scale = np.sqrt(np.mean(np.abs(values) ** 2, axis=0))
    noise = rng.normal(size=values.shape) + 1j * rng.normal(size=values.shape)
    values += NOISE / np.sqrt(2.0) * (np.abs(values) + 0.03 * scale) * noise
    return [
        FrfRecord(
            name=name,
            frequency_hz=LINES,
            values=values[:, index],
            quantity="acceleration",
            response_node=nodes[top[name]],
            response_direction=3,
            reference_node=nodes[top["hammer"]],
            reference_direction=3,
        )
        for index, name in enumerate(SENSORS)
    ]


if __name__ == "__main__":
    main()
