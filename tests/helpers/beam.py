"""A beam on five bolts, measured on one that is as fine again and a little stiffer: a small campaign for mistakes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import scipy.io
import scipy.linalg
import scipy.sparse as sp
from systems import beam_element

LENGTH, WIDTH, HEIGHT, STEEL, DENSITY = 0.9, 0.04, 0.006, 2.1e11, 7850.0
ALPHA, BETA = 1.0, 1.5e-6
BOLTS, HAMMER = (0.05, 0.24, 0.43, 0.66, 0.86), 0.14
SENSORS = {"a1": 0.1, "a2": 0.33, "a3": 0.55, "a4": 0.78, "a5": 0.7}
HZ = np.arange(40.0, 900.1, 1.0)
SPRING = 1e5
STATES = {"ref": (1.0, 1.1, 0.9, 1.05, 0.95), "loose": (1.0, 0.02, 0.95, 1.0, 1.1)}

Change = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def matrices(elements: int, modulus: float = STEEL) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass, UZ and ROTY a node."""
    k, m = beam_element(LENGTH / elements, modulus * WIDTH * HEIGHT**3 / 12, DENSITY * WIDTH * HEIGHT)
    # A positive rotation about y tilts the beam downwards.
    turned = np.outer([1, -1, 1, -1], [1, -1, 1, -1])
    K, M = np.zeros((2, 2 * elements + 2, 2 * elements + 2))
    for first in range(0, 2 * elements, 2):
        at = slice(first, first + 4)
        K[at, at] += k * turned
        M[at, at] += m * turned
    return K, M


def measured(state: Sequence[float], *, hammer: float = HAMMER, seed: int = 0, elements: int = 180) -> np.ndarray:
    """(F, R) accelerances with half a per cent of noise."""

    def dof(x: float) -> int:
        return 2 * round(x / LENGTH * elements)

    K, M = matrices(elements, 1.01 * STEEL)
    for x, level in zip(BOLTS, state, strict=True):
        K[dof(x), dof(x)] += level * SPRING
    lam, phi = scipy.linalg.eigh(K, M)
    omega = 2.0 * np.pi * HZ[:, None]
    flexible = phi[dof(hammer)] / (lam - omega**2 + 1j * omega * (ALPHA + BETA * lam))
    y = -(omega**2) * np.stack([flexible @ phi[dof(x)] for x in SENSORS.values()], axis=1)
    noise = np.random.default_rng(seed).normal(size=(4, *y.shape))
    y *= 1.0 + 0.005 * (noise[0] + 1j * noise[1])
    return np.asarray(y + 0.001 * np.sqrt(np.mean(np.abs(y) ** 2, axis=0)) * (noise[2] + 1j * noise[3]))


def write_frf(path: Path, hz: np.ndarray, values: np.ndarray) -> None:
    """Columns of real and imaginary parts, divided by semicolons."""
    head = ["Frequency [Hz]", *(f"{name} {part} [(m/s²)/N]" for name in SENSORS for part in ("Real", "Imag"))]
    rows = np.column_stack([hz, *(part for value in values.T for part in (value.real, value.imag))])
    lines = [";".join(head), *(";".join(f"{value:.8g}" for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def change(path: Path, damage: Change) -> None:
    """Frequencies and values of a file that ``write_frf`` wrote."""
    rows = np.loadtxt(path, delimiter=";", skiprows=1, encoding="utf-8")
    write_frf(path, *damage(rows[:, 0], rows[:, 1::2] + 1j * rows[:, 2::2]))


def make(folder: Path, *, elements: int = 90) -> Path:
    """The campaign file; the model has nodes every 10 mm."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, matrix in zip(("K", "M"), matrices(elements), strict=True):
        scipy.io.mmwrite(folder / f"{name}.mtx", sp.coo_array(matrix), symmetry="symmetric", precision=17)
    node = {x: 1 + round(x / LENGTH * elements) for x in BOLTS}
    dofs = [
        f"{2 * i + k},{i + 1},{label},{i * LENGTH / elements:.6g},0,0"
        for i in range(elements + 1)
        for k, label in enumerate(("UZ", "ROTY"))
    ]
    tables = {
        "dofs.csv": ["dof,node,component,x,y,z", *dofs],
        "bolts.csv": ["name,x,y,z", *(f"B{i},{x},0,0" for i, x in enumerate(BOLTS, start=1))],
        "bushings.csv": [
            "bolt,node_a,node_b,component,stiffness",
            *(f"B{i},{node[x]},,UZ,{SPRING:g}" for i, x in enumerate(BOLTS, start=1)),
        ],
    }
    for name, lines in tables.items():
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    for seed, (job, state) in enumerate(STATES.items()):
        write_frf(folder / f"{job}.csv", HZ, measured(state, seed=seed))
    responses = [f"  {name}: {{near: [{x}, 0, 0], component: UZ, quantity: acceleration}}" for name, x in SENSORS.items()]
    path = folder / "campaign.yaml"
    path.write_text(
        "\n".join(
            [
                "campaign: beam",
                "model:",
                "  stiffness: K.mtx",
                "  mass: M.mtx",
                f"  damping: {{structure: {{alpha: {ALPHA}, beta: {BETA}}}}}",
                "  dofs: dofs.csv",
                "excitation:",
                f"  hammer: {{near: [{HAMMER}, 0, 0], component: UZ}}",
                "responses:",
                *responses,
                "parameters:",
                "  bolts: {kind: stiffness, select: {bushings: bushings.csv}, initial: 0.0, bounds: [-3.0, 1.5]}",
                "bolts: bolts.csv",
                "reduction: {band: [40.0, 900.0], tolerance: 1.0e-3}",
                "update: {reference: ref, responses: [a1, a2, a3, a4]}",
                "jobs:",
                *(f"  {job}: {{frf: {job}.csv}}" for job in STATES),
                "",
            ]
        ),
        encoding="utf-8",
    )
    return path
