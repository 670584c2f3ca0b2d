"""A grillage of beams on discrete bolts with an axial and two rocking springs each: eight on a ring and a single one inside; 105 DOFs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.io
from campaigns import Folder
from systems import beam_element

from lrbc_cli.io.frf import write_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet

NX, NY, DX, DY = 7, 5, 0.1, 0.09
BENDING, TORSION, LINE_MASS = 90.0, 45.0, 2.0
ALPHA, BETA = 40.0, 1e-5
BAND = (20.0, 400.0)

#: Bolts: number of the node along x and y; in no order round the ring, the last one inside.
BOLTS = {"B1": (0, 0), "B5": (6, 4), "B3": (6, 0), "B7": (0, 4), "B2": (3, 0), "B6": (3, 4), "B4": (6, 2), "B8": (0, 2), "B9": (3, 2)}

#: Nominal stiffness of each kind of spring [N/m, N m/rad].
NOMINAL = {"UZ": 4e5, "ROTX": 300.0, "ROTY": 300.0}

#: Changes of the loosened bolts in each state [decades].
JOBS: dict[str, dict[str, float]] = {"tight": {}, "ring": {"B8": -1.0}, "single": {"B9": -1.0}}


def node(i: int, j: int) -> int:
    """Number of a node."""
    return 10 * (i + NX * j) + 1


def dof(i: int, j: int, component: str) -> int:
    """Number of a DOF."""
    return 3 * (i + NX * j) + ("UZ", "ROTX", "ROTY").index(component)


def _element(h: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of a beam with deflection, slope dw/ds and twist at both ends."""
    K, M = np.zeros((6, 6)), np.zeros((6, 6))
    at = [0, 1, 3, 4]
    K[np.ix_(at, at)], M[np.ix_(at, at)] = beam_element(h, BENDING, LINE_MASS)
    twist = np.ix_([2, 5], [2, 5])
    K[twist] = TORSION / h * np.array([[1, -1], [-1, 1]])
    M[twist] = LINE_MASS * 2e-4 * h / 6 * np.array([[2, 1], [1, 2]])
    return K, M


def matrices() -> tuple[np.ndarray, np.ndarray]:
    """K and M of the free grillage; DOFs UZ, ROTX, ROTY of each node."""
    n = 3 * NX * NY
    K, M = np.zeros((n, n)), np.zeros((n, n))
    for j in range(NY):
        for i in range(NX):
            for di, dj, h in ((1, 0, DX), (0, 1, DY)):
                if i + di >= NX or j + dj >= NY:
                    continue
                T = np.zeros((6, n))
                for end, (a, b) in enumerate(((i, j), (i + di, j + dj))):
                    T[3 * end, dof(a, b, "UZ")] = 1.0
                    # Along x the slope dw/dx is -ROTY and the twist ROTX; along y the slope is ROTX and the twist ROTY.
                    T[3 * end + 1, dof(a, b, "ROTY" if di else "ROTX")] = -1.0 if di else 1.0
                    T[3 * end + 2, dof(a, b, "ROTX" if di else "ROTY")] = 1.0
                k, m = _element(h)
                K, M = K + T.T @ k @ T, M + T.T @ m @ T
    return K, M


SENSORS = {"a1": (1, 1), "a2": (5, 3), "a3": (4, 1), "a4": (2, 3), "a5": (5, 1)}
HAMMER = (2, 1)


def measured(changes: dict[str, float], rng: np.random.Generator, frequency: np.ndarray) -> np.ndarray:
    """(F, 5) accelerances of the bolted grillage by dense solves, with scatter of 0.05 decades a bolt and 0.3 % of noise.

    Changes [decades] of bolts (``B9``), and of single kinds of their springs besides (``B9.ROTX``).
    """
    K, M = matrices()
    K0 = K.copy()
    for name, (i, j) in BOLTS.items():
        change = changes.get(name, 0.05 * rng.standard_normal())
        for component, stiffness in NOMINAL.items():
            # Each kind of spring loses a little more or less.
            own = 0.03 * rng.standard_normal() + changes.get(f"{name}.{component}", 0.0)
            K[dof(i, j, component), dof(i, j, component)] += stiffness * 10.0 ** (change + own)
    C = ALPHA * M + BETA * K0
    force = np.zeros(K.shape[0])
    force[dof(*HAMMER, "UZ")] = 1.0
    at = [dof(*place, "UZ") for place in SENSORS.values()]
    s = 2j * np.pi * frequency
    y = np.array([s_**2 * np.linalg.solve(s_**2 * M + s_ * C + K, force)[at] for s_ in s])
    noise = rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape)
    return y * (1.0 + 0.003 * noise)


def write_job(data: Path, job: str, changes: dict[str, float], seed: int) -> None:
    """Write the file of a measurement, see ``measured``."""
    frequency = np.arange(BAND[0], BAND[1] + 1, 4.0)
    y = measured(changes, np.random.default_rng(seed), frequency)
    records = tuple(
        FrfRecord(
            name=name,
            frequency_hz=frequency,
            values=y[:, k],
            quantity="acceleration",
            response_node=node(*at),
            response_direction=3,
            reference_node=node(*HAMMER),
            reference_direction=3,
        )
        for k, (name, at) in enumerate(SENSORS.items())
    )
    write_frf(data / f"{job}.uff", FrfSet(source=job, records=records))


def grillage(path: Path, jobs: tuple[str, ...] = tuple(JOBS)) -> Folder:
    """A campaign whose bolts are bushings: axial springs in one group, rocking about x and y in two more; no bolts file."""
    K, M = matrices()
    data = path / "data"
    data.mkdir(parents=True)
    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(data / f"{name}.mtx", matrix, symmetry="general", precision=17)
    rows = ["dof,node,component,x,y,z"]
    rows += [
        f"{dof(i, j, c)},{node(i, j)},{c},{DX * i:.6f},{DY * j:.6f},0" for j in range(NY) for i in range(NX) for c in ("UZ", "ROTX", "ROTY")
    ]
    (data / "dofs.csv").write_text("\n".join(rows) + "\n")
    rows = ["bolt,node_a,node_b,component,stiffness"]
    rows += [f"{name},{node(*at)},,{component},{k:g}" for name, at in BOLTS.items() for component, k in NOMINAL.items()]
    (data / "bushings.csv").write_text("\n".join(rows) + "\n")
    for index, job in enumerate(jobs):
        write_job(data, job, JOBS[job], 100 + index)
    folder = Folder(path)
    groups = {"axial": "UZ", "rocking_x": "ROTX", "rocking_y": "ROTY"}
    folder.write(
        {
            "campaign": "grillage",
            "output": "out",
            "model": {
                "stiffness": "data/K.mtx",
                "mass": "data/M.mtx",
                "damping": {"structure": {"alpha": ALPHA, "beta": BETA}},
                "dofs": "data/dofs.csv",
            },
            "excitation": {"hammer": {"node": node(*HAMMER), "component": "UZ"}},
            "responses": {name: {"node": node(*at), "component": "UZ", "quantity": "acceleration"} for name, at in SENSORS.items()},
            "parameters": {name: {"select": {"bushings": "data/bushings.csv", "component": label}} for name, label in groups.items()},
            "reduction": {"band": list(BAND), "tolerance": 1e-4},
            "update": {"responses": ["a1", "a2", "a3", "a4"], "lines": "all", **({"reference": "tight"} if jobs else {})},
            "jobs": {job: {"frf": f"data/{job}.uff", "removed": list(JOBS[job])} for job in jobs},
        }
    )
    return folder
