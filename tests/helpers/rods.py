"""A campaign on an axial rod in two pieces: a bolt at each end, one between the pieces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse as sp

#: Elements of each piece, stiffness of the bolts [N/m], nodes of hammer and sensors.
PIECE, BOLTS, HAMMER, SENSORS = 20, {"E1": 2e8, "MID": 2e9, "E2": 2e8}, 9, (5, 17, 25, 32, 39)
HZ = np.arange(300.0, 6001.0, 10.0)


def matrices(length: float = 1.5, area: float = 4e-4, modulus: float = 2.1e11, density: float = 7850.0) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass without bolts."""
    size, element = 2 * PIECE + 2, length / (2 * PIECE)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for first in (*range(PIECE), *range(PIECE + 1, 2 * PIECE + 1)):
        at = np.ix_([first, first + 1], [first, first + 1])
        K[at] += modulus * area / element * np.array([[1.0, -1.0], [-1.0, 1.0]])
        M[at] += density * area * element / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]])
    return K, M


def held() -> np.ndarray:
    """A column for each bolt."""
    found = np.zeros((2 * PIECE + 2, 3))
    found[[0, PIECE, PIECE + 1, -1], [0, 1, 1, 2]] = 1.0, 1.0, -1.0, 1.0
    return found


def measured(changes: dict[str, float], loss_factor: float, seed: int, noise: float = 0.005) -> np.ndarray:
    """Accelerances of the state with these changes [decades], with noise, of a rod 1 % denser than the model."""
    K, M = matrices(density=1.01 * 7850.0)
    stiffness = np.array([size * 10.0 ** changes.get(name, 0.0) for name, size in BOLTS.items()])
    K = (K + (held() * stiffness) @ held().T) * (1.0 + 1j * loss_factor)
    omega = 2.0 * np.pi * HZ
    force = np.zeros((K.shape[0], 1))
    force[HAMMER] = 1.0
    y = -(omega[:, None] ** 2) * np.linalg.solve(K - omega[:, None, None] ** 2 * M, force[None])[:, list(SENSORS), 0]
    rng = np.random.default_rng(seed)
    floor = 1e-6 * np.abs(y).max()
    return np.asarray(y + (noise * np.abs(y) + floor) * (rng.normal(size=y.shape) + 1j * rng.normal(size=y.shape)) / np.sqrt(2.0))


def rod(folder: Path, jobs: dict[str, tuple[dict[str, float], float]], loss_factor: float = 0.008) -> Path:
    """The campaign file; a job is changes of bolts [decades] and a factor on the loss factor, and ``tight`` the reference job."""
    K, M = matrices()
    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(folder / f"{name}.mtx", sp.coo_array(matrix), symmetry="symmetric")
    x = np.concatenate([np.linspace(0.0, 0.75, PIECE + 1), np.linspace(0.75, 1.5, PIECE + 1)])
    rows = "".join(f"{k},{k + 1},UX,{at:.6f},0,0\n" for k, at in enumerate(x))
    (folder / "dofs.csv").write_text(f"dof,node,component,x,y,z\n{rows}")
    ends = {"E1": "1,", "MID": f"{PIECE + 1},{PIECE + 2}", "E2": f"{2 * PIECE + 2},"}
    (folder / "bushings.csv").write_text(
        "bolt,node_a,node_b,component,stiffness\n" + "".join(f"{name},{ends[name]},UX,{size:g}\n" for name, size in BOLTS.items())
    )
    head = "frequency_hz," + ",".join(f"a{k}_real [m/s2/N],a{k}_imag [m/s2/N]" for k in range(len(SENSORS)))
    every = {"tight": ({}, 1.0)} | jobs
    for seed, (name, (changes, times)) in enumerate(every.items()):
        y = measured(changes, times * loss_factor, seed)
        columns = np.column_stack([HZ, *(part for h in y.T for part in (h.real, h.imag))])
        np.savetxt(folder / f"{name}.csv", columns, delimiter=",", header=head, comments="", fmt="%.7g")
    responses = "".join(f"  a{k}: {{node: {at + 1}, component: UX, quantity: acceleration}}\n" for k, at in enumerate(SENSORS))
    (folder / "campaign.yaml").write_text(
        f"campaign: rod\nmodel:\n  stiffness: K.mtx\n  mass: M.mtx\n  dofs: dofs.csv\n"
        f"  damping: {{structure: {{loss_factor: {loss_factor}}}}}\n"
        f"excitation:\n  hammer: {{node: {HAMMER + 1}, component: UX}}\nresponses:\n{responses}"
        "parameters:\n  bolts:\n    select: {bushings: bushings.csv}\n    initial: 0.0\n    bounds: [-3.0, 1.0]\n"
        f"reduction: {{band: [{HZ[0]:g}, {HZ[-1]:g}]}}\n"
        f"update: {{reference: tight, responses: [{', '.join(f'a{k}' for k in range(len(SENSORS) - 1))}]}}\n"
        "jobs:\n" + "".join(f"  {name}: {{frf: {name}.csv}}\n" for name in every)
    )
    return folder / "campaign.yaml"
