"""``lrbc check`` names the part of a mesh, whose parts share nodes, that has another material, density or thickness."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
import solids
from campaigns import Folder
from scipy.sparse.linalg import splu

from lrbc_cli.io.frf import write_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet

STIFFNESS = {"UX": 6e6, "UY": 6e6, "UZ": 4e6}
BOLTS = {"B1": (0, 0), "B2": (10, 0), "B3": (10, 6), "B4": (0, 6), "B5": (5, 0), "B6": (5, 6)}
HAMMER = ((3, 2, 1), "UZ")
SENSORS = {
    "a1": ((2, 3, 1), "UZ"), "a2": ((8, 4, 1), "UZ"), "a3": ((5, 4, 4), "UY"), "a4": ((9, 2, 3), "UX"),
    "a5": ((6, 2, 1), "UZ"), "a6": ((3, 5, 4), "UY"), "a7": ((7, 5, 1), "UZ"), "a8": ((2, 1, 1), "UZ"),
}  # fmt: skip
LOSS = 0.02


def node(xyz: np.ndarray, place: tuple[int, int, int]) -> int:
    """Number of the node at these lines of the mesh."""
    i, j, k = place
    return int(np.argmin(np.linalg.norm(xyz - [solids.X[i], solids.Y[j], solids.Z[k]], axis=1)))


def campaign(path: Path, materials: dict[str, tuple[float, float]]) -> Folder:
    """The model is of aluminium; on the test bench some parts have other materials."""
    data = path / "data"
    data.mkdir(parents=True)
    K, M, xyz = solids.assembled()
    springs = [(name, node(xyz, (*place, 0)), c, size) for name, place in BOLTS.items() for c, size in STIFFNESS.items()]

    def dof(at: int, component: str) -> int:
        return 3 * at + ("UX", "UY", "UZ").index(component)

    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(data / f"{name}.mtx", matrix, symmetry="symmetric", precision=17)
    rows = [f"{dof(n, c)},{n + 1},{c},{x:.6f},{y:.6f},{z:.6f}" for n, (x, y, z) in enumerate(xyz) for c in STIFFNESS]
    (data / "dofs.csv").write_text("\n".join(["dof,node,component,x,y,z", *rows]) + "\n")
    rows = [f"{name},{at + 1},,{c},{size:g}" for name, at, c, size in springs]
    (data / "bushings.csv").write_text("\n".join(["bolt,node_a,node_b,component,stiffness", *rows]) + "\n")
    rng, hz = np.random.default_rng(3), np.arange(200.0, 1801.0, 4.0)
    K, M, _ = solids.assembled(materials)
    held = np.zeros(K.shape[0])
    for _, at, c, size in springs:
        held[dof(at, c)] += size * 10.0 ** (0.04 * rng.standard_normal())
    K = (sp.csc_array(K) + sp.diags_array(held)) * (1.0 + 1j * LOSS)
    force = np.zeros(K.shape[0], dtype=complex)
    force[dof(node(xyz, HAMMER[0]), HAMMER[1])] = 1.0
    own = [dof(node(xyz, place), c) for place, c in SENSORS.values()]
    y = np.array([s**2 * splu(sp.csc_array(K + s**2 * M)).solve(force)[own] for s in 2j * np.pi * hz])
    y *= 1.0 + 0.005 * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
    records = tuple(FrfRecord(name=name, frequency_hz=hz, values=y[:, k], quantity="acceleration") for k, name in enumerate(SENSORS))
    write_frf(data / "tight.uff", FrfSet(source="tight", records=records))
    folder = Folder(path)
    folder.write(
        {
            "campaign": "mesh parts",
            "output": "out",
            "model": {
                "stiffness": "data/K.mtx",
                "mass": "data/M.mtx",
                "damping": {"structure": {"loss_factor": LOSS}},
                "dofs": "data/dofs.csv",
            },
            "excitation": {"hammer": {"node": node(xyz, HAMMER[0]) + 1, "component": HAMMER[1]}},
            "responses": {
                name: {"node": node(xyz, place) + 1, "component": c, "quantity": "acceleration"} for name, (place, c) in SENSORS.items()
            },
            "parameters": {"joints": {"select": {"bushings": "data/bushings.csv"}, "damping": "none"}},
            "reduction": {"band": [200.0, 1800.0], "tolerance": 1e-4},
            "update": {"responses": list(SENSORS)[:7], "lines": "all", "reference": "tight"},
            "calibration": {"job": "tight", "factors": ["stiffness.structure", "mass.structure", "loss_factor.structure"]},
            "jobs": {"tight": {"frf": "data/tight.uff"}},
        }
    )
    return folder


def told(folder: Folder) -> str:
    """Warnings of ``lrbc check``."""
    done = folder.run("check")
    assert done.code == 0, done.stderr
    return done.stdout.partition("\nwarnings\n")[2]


def test_a_right_mesh_is_no_finding(tmp_path: Path) -> None:
    assert "job tight" not in told(campaign(tmp_path / "right", {}))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "material", "place", "cause"),
    [
        (
            "wall",
            (210e9, 7850.0),
            "x 0.06 to 0.24, y 0.12 to 0.15, z 0.01 to 0.055 m",
            r"Modulus and density are probably both [23]\.\d times too s",
        ),
        ("block", (70e9, 7850.0), "x 0.21 to 0.3, y 0 to 0.09, z 0.01 to 0.04 m", r"density is probably (2\.[5-9]|3)\d* times too small"),
        (
            "plate",
            (0.58 * 70e9, 0.84 * 2700.0),
            "x 0 to 0.3, y 0 to 0.18, z 0 to 0.01 m",
            r"thickness of plates, .* 1\.[12]\d* times too large",
        ),
    ],
)
def test_the_wrong_part_of_a_mesh_is_named(tmp_path: Path, part: str, material: tuple[float, float], place: str, cause: str) -> None:
    """A wall of steel modelled as of aluminium, a block of another density, a sheet that is thinner."""
    text = told(campaign(tmp_path / part, {part: material}))
    assert re.search(rf"with the stiffness of the part of \d+ nodes at {re.escape(place)} times", text), text
    assert re.search(cause, text), text
