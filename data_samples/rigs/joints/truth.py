"""The rig that is measured: one specimen of a design in any state of its joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from lrbc_cli.virtual.chain import Complexes
from lrbc_cli.virtual.drift import Drift
from rigs.coupled import factorise, lowest_modes
from rigs.joints.design import JointDesign, Place, Specimen
from rigs.joints.system import Array

#: Modes of the tight rig in its basis, with the static responses to its springs, hammers and accelerometers.
MODES = 110

#: Young's modulus by temperature [1/K].
SOFTENING = -4e-4

#: A joint that has lost decades rubs: loss factor over that of the tight one.
RUBBING = 6.0


@dataclass(frozen=True)
class State:
    """The joints of one job.

    Attributes
    ----------
    log10 : mapping of str to float
        Over the nominal stiffness, by joint: what its components have in common.
    loss : mapping of str to float
        Decades that a loose joint has lost; absent where it is tight.
    spread : mapping of str to float
        What a component of a loose joint adds, by ``joint.component``.
    """

    log10: Mapping[str, float]
    loss: Mapping[str, float]
    spread: Mapping[str, float]


def draw_state(design: JointDesign, specimen: Specimen, count: int, retorque: float, rng: np.random.Generator) -> State:
    """Draw a job.

    Parameters
    ----------
    count : int
        How many joints have lost 0.3 to 3 decades, evenly over the decades.
    retorque : float
        Standard deviation of the log stiffness of all joints from job to job.
    """
    names = list(design.bolts)
    settled = rng.normal(0.0, retorque / np.log(10), len(names))
    loose = sorted(rng.choice(names, count, replace=False).tolist())
    loss = {name: round(float(rng.uniform(0.3, 3.0)), 4) for name in loose}
    tight = {name: specimen.joints.get(name, 0.0) + float(s) for name, s in zip(names, settled, strict=True)}
    log10 = {name: round(value - loss.get(name, 0.0), 4) for name, value in tight.items()}
    # Turning is lost a little earlier or later than pressing.
    spread = {
        f"{s.joint}.{s.component}": round(0.05 * loss[s.joint] * float(rng.standard_normal()), 4) for s in design.springs if s.joint in loss
    }
    return State(log10, loss, spread)


class Rig:
    """A specimen, reduced once: modes of the tight rig and static responses; exact dynamics of the joints in that basis.

    Parameters
    ----------
    design : JointDesign
    specimen : Specimen
    """

    def __init__(self, design: JointDesign, specimen: Specimen) -> None:
        self.design, self.specimen = design, specimen
        system = design.system(specimen)
        terms = np.stack([design.term(system, spring) for spring in design.springs], axis=1)
        ends = np.stack([design.row(system, self._moved(name, place), true=True) for name, place in self._places().items()], axis=1)
        rows = np.hstack([terms, ends])
        springs = sp.csr_array(terms)
        tight = sp.csr_array(system.stiffness + (springs * [s.stiffness for s in design.springs]) @ springs.T)
        # A shift far below the band: a rig that hangs freely has no stiffness of its own there.
        shift = -((2 * np.pi * 0.2 * design.band[0]) ** 2)
        solve = factorise(sp.csr_array(tight - shift * system.mass))
        modes = lowest_modes(tight, system.mass, MODES, shift, solve)[1]
        statics = np.stack([solve(row) for row in rows.T], axis=1)
        basis = np.linalg.qr(np.hstack([part / np.linalg.norm(part, axis=0) for part in (modes, statics)]))[0]
        stiffness, mass = (basis.T @ (matrix @ basis) for matrix in (system.stiffness, system.mass))
        values, vectors = sl.eigh(0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T))
        self.values = np.maximum(values, 0.0)
        self.rows = vectors.T @ (basis.T @ rows)

    def _places(self) -> dict[str, Place]:
        return {**self.design.hammers, **self.design.sensors}

    def _moved(self, name: str, place: Place) -> Place:
        offset = self.specimen.offsets.get(name, (0.0, 0.0, 0.0))
        x, y, z = (a + b for a, b in zip(place.point, offset, strict=True))
        return replace(place, point=(x, y, z))

    def stiffness(self, state: State) -> Complexes:
        """(t,) complex stiffness of all springs."""
        design, specimen = self.design, self.specimen
        found = []
        for spring in design.springs:
            key = f"{spring.joint}.{spring.component}"
            log10 = state.log10[spring.joint] + specimen.springs.get(key, 0.0) + state.spread.get(key, 0.0)
            loss = design.joint_loss * specimen.joint_loss * min(1.0 + state.loss.get(spring.joint, 0.0), RUBBING)
            found.append(spring.stiffness * 10**log10 * (1 + 1j * loss))
        return np.array(found)

    def frfs(self, state: State, drift: Drift, frequencies: Array) -> Complexes:
        """Accelerances (f, hammers, accelerometers) [m/s2/N]."""
        design, specimen = self.design, self.specimen
        values = self.values * (1 + SOFTENING * drift.kelvin)
        omega = 2 * np.pi * frequencies[:, None]
        if design.loss:
            dynamic = values * (1 + 1j * design.loss * specimen.loss) - omega**2
        else:
            alpha, beta = (c * specimen.viscous for c in design.proportional)
            dynamic = values + 1j * omega * (alpha + beta * values) - omega**2
        receptance = np.einsum("ra,fr,rb->fab", self.rows, 1 / dynamic, self.rows, optimize=True)
        count = len(design.springs)
        springs = receptance[:, :count, :count] + np.diag(1 / self.stiffness(state))
        hammers = slice(count, count + len(design.hammers))
        sensors = slice(hammers.stop, None)
        free = receptance[:, hammers, sensors]
        held = receptance[:, hammers, :count] @ np.linalg.solve(springs, receptance[:, :count, sensors])
        return -(omega[:, :, None] ** 2) * (free - held)
