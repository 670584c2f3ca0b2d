"""How long does an identification of many joints take? A plate on a grid of bolts, measured virtually by ``lrbc rehearse``.

    python tests/benchmarks/many.py [--joints 100] [--loose B034] [--loose B012,B077] [--out DIR]

The free plate is that of ``data_samples/rigs/plate.py``; each bolt is an axial spring. Prints what is judged and the seconds of each job.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import scipy.io

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "data_samples"))

from rigs.design import Materials  # noqa: E402
from rigs.plate import plate_matrices  # noqa: E402

#: Elements between two bolts, their distance [m], and the stiffness of a tight bolt [N/m]. Waves travel from where a bolt's share of the
#: plate resonates on it, 79 Hz.
BETWEEN, PITCH, STIFFNESS = 3, 0.1, 2e4


def write_model(folder: Path, joints: int) -> None:
    """A campaign of a plate on a grid of bolts, without measurements."""
    along = math.isqrt(joints)
    across = -(-joints // along)
    nx, ny = BETWEEN * (along + 1), BETWEEN * (across + 1)
    h = PITCH / BETWEEN
    K, M, _ = plate_matrices(nx, ny, h, h, Materials())
    folder.mkdir(parents=True)
    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(folder / f"{name}.mtx", matrix.tocoo(), symmetry="symmetric")
    nodes = [(i * (ny + 1) + j + 1, i * h, j * h) for i in range(nx + 1) for j in range(ny + 1)]
    # w, dw/dy = ROTX, dw/dx = -ROTY: its sign is of no consequence here, as no rotation is used; the twist has no name of its own.
    kinds = ("UZ", "ROTX", "ROTY", "TWIST")
    dofs = ((4 * (node - 1) + k, node, kind, x, y, 0.0) for node, x, y in nodes for k, kind in enumerate(kinds))
    write(folder / "dofs.csv", ["dof", "node", "component", "x", "y", "z"], dofs)
    places = [(BETWEEN * (1 + k // across), BETWEEN * (1 + k % across)) for k in range(joints)]
    names = [f"B{k + 1:03d}" for k in range(joints)]
    write(folder / "bolts.csv", ["name", "x", "y", "z"], ((n, i * h, j * h, 0.0) for n, (i, j) in zip(names, places, strict=True)))
    springs = ((n, i * (ny + 1) + j + 1, "", "UZ", STIFFNESS) for n, (i, j) in zip(names, places, strict=True))
    write(folder / "bushings.csv", ["bolt", "node_a", "node_b", "component", "stiffness"], springs)
    rng = np.random.default_rng(7)
    sensors = [(BETWEEN * rng.integers(0, along + 1) + 1, BETWEEN * rng.integers(0, across + 1) + 2) for _ in range(16)]
    at = "component: UZ, quantity: acceleration"
    responses = "".join(f"  a{k + 1:02d}: {{near: [{i * h:.6g}, {j * h:.6g}, 0], {at}}}\n" for k, (i, j) in enumerate(sensors))
    (folder / "campaign.yaml").write_text(
        f"""campaign: plate-on-{joints}-bolts
output: runs
model:
  stiffness: K.mtx
  mass: M.mtx
  damping: {{structure: {{alpha: 4.0, beta: 4.0e-6}}}}
  dofs: dofs.csv
excitation:
  hammer: {{near: [{h:.6g}, {2 * h:.6g}, 0], component: UZ}}
responses:
{responses}parameters:
  bolts:
    kind: stiffness
    select: {{bushings: bushings.csv}}
    initial: 0.0
    bounds: [-4.0, 2.0]
bolts: bolts.csv
reduction: {{band: [90.0, 400.0], tolerance: 1.0e-3}}
update: {{reference: tight}}
calibration: {{job: tight, factors: [stiffness.structure, mass.structure, alpha.structure, beta.structure]}}
jobs:
  tight: {{frf: tight.uff}}
""",
        encoding="utf-8",
    )


def write(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A table with a header line."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([header, *rows])


def lrbc(*arguments: object) -> None:
    """The installed program."""
    subprocess.run([sys.executable, "-m", "lrbc_cli", *map(str, arguments)], check=True)


def main() -> None:
    """Make the campaign, measure it virtually, identify and judge it, and print what came out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--joints", type=int, default=100, help="(100)")
    parser.add_argument("--loose", action="append", metavar="NAMES", help="a job with these bolts loose (B034; B012,B077)")
    parser.add_argument("--out", type=Path, help="keep everything here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.out or Path(scratch) / "many"
        write_model(folder, options.joints)
        wanted = [part for names in options.loose or ("B034", "B012,B077") for part in ("--loose", names)]
        lrbc("rehearse", folder / "campaign.yaml", "--out", folder / "rehearsal", *wanted)
        lrbc("run", next((folder / "rehearsal").glob("*.yaml")))
        for file in sorted((folder / "rehearsal").glob("**/result.json")):
            job = json.loads(file.read_text(encoding="utf-8"))
            by_verdict: dict[str, list[str]] = {}
            for bolt in job["bolts"]:
                by_verdict.setdefault(bolt["verdict"], []).append(bolt["name"])
            counted = ", ".join(f"{len(names)} {verdict}" for verdict, names in by_verdict.items())
            print(f"{job['job']}: {job['seconds']['total']:.1f} s, {job['status']}, {counted}; loose: {by_verdict.get('loose', [])}")


if __name__ == "__main__":
    main()
