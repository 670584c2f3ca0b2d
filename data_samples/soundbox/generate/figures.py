"""Print the figures that the README states: mesh error, and how much the left edge matters to the FRFs of the nominal model.

    python data_samples/soundbox/generate/figures.py

Forward computations only.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pyuff
import scipy.sparse as sp
import skfem
from cavity import block_grid
from coupled import Cavity, PlateModes, factorise, lowest_modes, pressure_frfs
from geometry import ACOUSTIC_DAMPING, HAMMER, MICROPHONES, PLATE_X0, STRUCTURE_DAMPING, Array, Materials
from nominal import Model, acoustic_basis, acoustic_matrices, build
from truth import hexahedra

USED = ("mic01", "mic03", "mic04", "mic05", "mic09", "mic10")
LINES = np.arange(20.0, 401.0)
MODES = 90


def cavity_frequencies(basis: skfem.Basis, count: int = 24) -> Array:
    """Lowest natural frequencies [Hz] of the cavity with rigid walls."""
    stiffness, mass = acoustic_matrices(basis, Materials())
    solve = factorise(sp.csr_array(stiffness - Cavity.SHIFT * mass))
    values, _ = lowest_modes(stiffness, mass, count, Cavity.SHIFT, solve)
    return np.sqrt(np.abs(values)) / (2 * np.pi)


class Nominal:
    """FRFs of the nominal model for uniform springs along the left edge."""

    def __init__(self, model: Model) -> None:
        n = model.structure_size
        self.stiffness, self.mass = model.stiffness[:n, :n], model.mass[:n, :n]
        self.coupling = model.stiffness[:n, n:]
        self.cavity = Cavity(model.stiffness[n:, n:], model.mass[n:, n:])
        self.edge = np.flatnonzero((model.component == "ROTY") & (np.abs(model.xyz[:, 0] - PLATE_X0) < 1e-9))
        at = np.flatnonzero(model.component == "UZ")
        self.hammer = at[np.argmin(np.linalg.norm(model.xyz[at] - HAMMER, axis=1))]
        pressure = model.xyz[n:]
        nearest = [int(np.argmin(np.linalg.norm(pressure - xyz, axis=1))) for xyz in MICROPHONES.values()]
        self.outputs = sp.csr_array((np.ones(len(nearest)), (np.arange(len(nearest)), nearest)), shape=(len(nearest), len(pressure)))

    def frfs_db(self, spring: float) -> Array:
        """FRFs (lines, microphones) [dB re 1 Pa/N] for a spring [N m/rad] at each free node of the edge."""
        alpha, beta = STRUCTURE_DAMPING
        springs = np.zeros(self.stiffness.shape[0])
        springs[self.edge] = spring
        total = sp.csr_array(self.stiffness + sp.diags_array(springs))
        values, modes = lowest_modes(total, self.mass, MODES, 0.0, factorise(total))
        damping = alpha * np.eye(MODES) + beta * np.diag(values)
        plate = PlateModes(values, damping, np.zeros((MODES, MODES)), modes[self.hammer], self.coupling.T @ modes)
        return 20 * np.log10(np.abs(pressure_frfs(plate, self.cavity, *ACOUSTIC_DAMPING, self.outputs, LINES)))


def measured_db(path: Path) -> Array:
    """Measured FRFs (lines, microphones) [dB re 1 Pa/N] on `LINES`."""
    records = {s["rsp_ent_name"]: s for s in pyuff.UFF(str(path)).read_sets() if s["type"] == 58 and s["func_type"] == 4}
    columns = [records[name]["data"][np.isin(records[name]["x"].round(6), LINES)] for name in MICROPHONES]
    return 20 * np.log10(np.abs(np.array(columns).T))


def main() -> None:
    """Command line."""
    logging.getLogger("skfem").setLevel(logging.ERROR)
    coarse = cavity_frequencies(acoustic_basis()[0])
    fine = cavity_frequencies(hexahedra(block_grid((12, 11), (2, 2, 4, 3), [1, 9, 6, 5], 1, snap=False)))
    in_band = (fine > 1.0) & (fine < 400.0)
    print("cavity [Hz]:", coarse[in_band].round(1))
    print(f"largest difference from a finer mesh: {100 * np.abs(coarse / fine - 1)[in_band].max():.3f} %")

    nominal = Nominal(build())
    used = [list(MICROPHONES).index(name) for name in USED]
    clamped = nominal.frfs_db(1e7)
    free = nominal.frfs_db(0.0)
    print("uniform log10 spring: mean dB from the clamped limit, all microphones and those used")
    print(f"  free {np.abs(free - clamped).mean():.2f} {np.abs(free - clamped)[:, used].mean():.2f}")
    for exponent in (0.0, 1.0, 2.0, 2.5, 3.0, 3.25, 3.5, 4.0, 4.5, 5.0):
        difference = np.abs(nominal.frfs_db(10**exponent) - clamped)
        print(f"  {exponent:4.2f} {difference.mean():.3f} {difference[:, used].mean():.3f}")
    folder = Path(__file__).resolve().parents[1] / "frf"
    for name, other, label in (("bolts-00", clamped, "clamped"), ("bolts-17", free, "free")):
        difference = np.abs(measured_db(folder / f"{name}.uff") - other)
        print(f"{name} measured against nominal {label}: {difference.mean():.2f} {difference[:, used].mean():.2f} dB")


if __name__ == "__main__":
    main()
