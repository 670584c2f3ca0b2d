"""The figures that the READMEs state about a design: frequencies, mesh error, how much the left edge matters. Forward computations only."""

from __future__ import annotations

from math import ceil
from pathlib import Path

import numpy as np
import pyuff
import scipy.sparse as sp
import skfem

from lrbc_cli.virtual.drift import Drift
from rigs.cavity import block_grid
from rigs.coupled import Cavity, PlateModes, factorise, lowest_modes, pressure_frfs
from rigs.design import Array, Design
from rigs.nominal import acoustic_basis, acoustic_matrices, build
from rigs.reduced import Basis
from rigs.truth import Air, Perturbations, Plate, Rig, hexahedra

LINES = np.arange(20.0, 401.0)
MODES = 90
CLAMPED = 1e7


def hertz(eigenvalues: Array) -> Array:
    """Natural frequencies [Hz]."""
    return np.asarray(np.sqrt(np.abs(eigenvalues)) / (2 * np.pi))


def cavity_frequencies(design: Design, basis: skfem.Basis, count: int = 24) -> Array:
    """Lowest natural frequencies [Hz] of the cavity with rigid walls."""
    stiffness, mass = acoustic_matrices(basis, design.materials)
    solve = factorise(sp.csr_array(stiffness - Cavity.SHIFT * mass))
    return hertz(lowest_modes(stiffness, mass, count, Cavity.SHIFT, solve)[0])


class Nominal:
    """FRFs of the nominal model for uniform springs along the left edge."""

    def __init__(self, design: Design) -> None:
        model = build(design)
        n = model.structure_size
        self.design, self.model = design, model
        self.stiffness, self.mass = model.stiffness[:n, :n], model.mass[:n, :n]
        self.coupling = model.stiffness[:n, n:]
        pressure = model.xyz[n:]
        nearest = [int(np.argmin(np.linalg.norm(pressure - xyz, axis=1))) for xyz in design.microphones.values()]
        outputs = sp.csr_array((np.ones(len(nearest)), (np.arange(len(nearest)), nearest)), shape=(len(nearest), len(pressure)))
        self.cavity = Cavity(model.stiffness[n:, n:], model.mass[n:, n:], outputs)
        self.edge = np.flatnonzero((model.component == "ROTY") & (np.abs(model.xyz[:, 0] - design.plate_origin[0]) < 1e-9))
        at = np.flatnonzero(model.component == "UZ")
        self.hammer = at[np.argmin(np.linalg.norm(model.xyz[at] - design.hammer_point, axis=1))]

    def plate_modes(self, spring: float) -> tuple[Array, Array]:
        """Eigenvalues and modes of the plate alone for a spring [N m/rad] at each free node of the edge."""
        springs = np.zeros(self.stiffness.shape[0])
        springs[self.edge] = spring
        total = sp.csr_array(self.stiffness + sp.diags_array(springs))
        return lowest_modes(total, self.mass, MODES, 0.0, factorise(total))

    def frfs_db(self, spring: float) -> Array:
        """FRFs (lines, microphones) [dB re 1 Pa/N]."""
        alpha, beta = self.design.structure_damping
        values, modes = self.plate_modes(spring)
        plate = PlateModes(values, alpha * np.eye(MODES) + beta * np.diag(values), np.zeros((MODES, MODES)), modes[self.hammer])
        air = self.cavity.responding_to(self.coupling.T @ modes)
        return np.asarray(20 * np.log10(np.abs(pressure_frfs(plate, air, *self.design.acoustic_damping, LINES))))


def rig_figures(design: Design) -> tuple[Array, dict[str, float]]:
    """Of the unperturbed rig: natural frequencies [Hz] of its plate, all bolts tight, and by job the mean dB from the tight FRFs."""
    air = Air(design)
    plate, none = Plate(design, air), Perturbations.none(design)
    basis = Basis(plate, air)
    rig = Rig(basis.plate, basis.air, none)
    frequencies = hertz(rig.plate_modes(none.bolts, np.array(design.hammer))[0].eigenvalues)

    def decibels(job: str) -> Array:
        factors = {name: 0.0 if name in design.removed(job) else 1.0 for name in design.bolts}
        return np.asarray(20 * np.log10(np.abs(rig.frfs(factors, Drift(), LINES))))

    tight = decibels(design.reference)
    return frequencies, {job: float(np.abs(decibels(job) - tight).mean()) for job in design.jobs}


def measured_db(design: Design, path: Path) -> Array:
    """Measured FRFs (lines, microphones) [dB re 1 Pa/N] on `LINES`."""
    records = {s["rsp_ent_name"]: s for s in pyuff.UFF(str(path)).read_sets() if s["type"] == 58 and s["func_type"] == 4}
    columns = [records[name]["data"][np.isin(records[name]["x"].round(6), LINES)] for name in design.microphones]
    return np.asarray(20 * np.log10(np.abs(np.array(columns).T)))


def report(design: Design, measured: Path | None) -> None:
    """Print them all.

    Parameters
    ----------
    design : Design
    measured : Path or None
        Folder of measurements ``JOB.uff`` to compare with.
    """
    nominal = Nominal(design)
    model = nominal.model
    n, pressures = model.mass.shape[0], model.mass.shape[0] - model.structure_size
    print(f"nominal model: {n} DOFs, {model.structure_size} plate, {pressures} pressures, {nominal.edge.size} terms")
    coarse = cavity_frequencies(design, acoustic_basis(design)[0])
    aperture, sides, depths = (tuple(ceil(1.4 * n) for n in part) for part in (design.true.aperture, design.true.sides, design.true.depths))
    fine = cavity_frequencies(design, hexahedra(block_grid(design, aperture, sides, depths, 1, snap=False)))
    in_band = (fine > 1.0) & (fine < 400.0)
    print("cavity [Hz]:", coarse[in_band].round(1))
    print(f"largest difference from a finer mesh: {100 * np.abs(coarse / fine - 1)[in_band].max():.3f} %")
    free, clamped = (hertz(nominal.plate_modes(spring)[0]) for spring in (0.0, CLAMPED))
    print("plate, left edge free to turn [Hz]:", free[free < 400].round(1))
    print("plate, clamped [Hz]:", clamped[clamped < 400].round(1))
    low = clamped < 400
    frequencies, changes = rig_figures(design)
    ratio = frequencies[low.nonzero()] / clamped[low]
    print(f"rig, unperturbed, tight, over that: {ratio.min():.4f} to {ratio.max():.4f}, mean {ratio.mean():.4f}")
    print("its jobs, mean dB from tight:", ", ".join(f"{job} {value:.2f}" for job, value in changes.items()))

    used = [list(design.microphones).index(name) for name in design.used]
    clamped_db, free_db = nominal.frfs_db(CLAMPED), nominal.frfs_db(0.0)
    print("uniform log10 spring: mean dB from the clamped limit, all microphones and those used")
    print(f"  free {np.abs(free_db - clamped_db).mean():.2f} {np.abs(free_db - clamped_db)[:, used].mean():.2f}")
    for exponent in (0.0, 1.0, 2.0, 2.5, 3.0, 3.25, 3.5, 4.0, 4.5, 5.0):
        difference = np.abs(nominal.frfs_db(10**exponent) - clamped_db)
        print(f"  {exponent:4.2f} {difference.mean():.3f} {difference[:, used].mean():.3f}")
    for job, removed in design.jobs.items() if measured else ():
        if len(removed) in (0, design.bolt_count):
            other, label = (free_db, "free") if removed else (clamped_db, "clamped")
            difference = np.abs(measured_db(design, measured / f"{job}.uff") - other)
            print(f"{job} measured against nominal {label}: {difference.mean():.2f} {difference[:, used].mean():.2f} dB")
