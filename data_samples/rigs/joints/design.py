"""What the nominal model and the rig of a design have in common: parts, joints, sensors, damping, band."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from rigs.joints.beams import Frame
from rigs.joints.plates import Sheet, disc, plate
from rigs.joints.system import Array, Material, System, join

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Place:
    """Where a hammer hits or an accelerometer sits: part, point [m] and direction (``UX``, ``UY``, ``UZ``)."""

    point: Point
    component: str = "UZ"
    part: int = 0


@dataclass(frozen=True)
class Spring:
    """One component of a joint.

    Attributes
    ----------
    joint, component, group : str
        The group is the kind of component: ``axial``, ``rocking``.
    stiffness : float
        Of the tight joint [N/m, N m/rad].
    """

    joint: str
    component: str
    group: str
    stiffness: float


@dataclass(frozen=True)
class Specimen:
    """Factors on the nominal properties, part by part, that make a rig; ones and zeros for the rig as designed.

    Attributes
    ----------
    young, density, thickness : tuple of float
        Factors on each part.
    loss, viscous, joint_loss : float
        Factors on the damping of the structure and of the joints.
    joints : mapping of str to float
        log10 of each joint's tight stiffness over the nominal one, common to its components.
    springs : mapping of str to float
        What a component adds to that, by ``joint.component``.
    offsets : mapping of str to tuple
        True less nominal position of hammers and accelerometers [m].
    supports : float
        Factor on the soft supports.
    """

    young: tuple[float, ...]
    density: tuple[float, ...]
    thickness: tuple[float, ...]
    loss: float = 1.0
    viscous: float = 1.0
    joint_loss: float = 1.0
    joints: Mapping[str, float] = field(default_factory=dict)
    springs: Mapping[str, float] = field(default_factory=dict)
    offsets: Mapping[str, Point] = field(default_factory=dict)
    supports: float = 1.0


@dataclass(frozen=True)
class Support:
    """A soft spring to the ground [N/m] along UZ; ``nominal`` where the exported model has it too."""

    point: Point
    stiffness: float
    part: int = 0
    nominal: bool = True


@dataclass(frozen=True)
class JointDesign(ABC):
    """Everything about a rig but what differs from one specimen to the next.

    Attributes
    ----------
    name, title : str
    material : Material
    band : (float, float)
        [Hz]; measured from 5 lines below to 5 above, 1 Hz apart.
    loss : float
        Loss factor of the rig's parts: its stiffness is K (1 + i loss). 0 where the rig is damped viscously.
    proportional : (float, float)
        alpha [1/s], beta [s] of the nominal model, and of the rig where `loss` is 0.
    joint_loss : float
        Loss factor of a tight joint; it grows by as much for every decade that is lost, up to six times.
    hammers, sensors : mapping of str to Place
    held_out : tuple of str
        Accelerometers that test the result.
    springs : tuple of Spring
    bolts : mapping of str to (float, float, float)
    loosened : tuple of int
        How many joints are loose in each judged job.
    supports : tuple of Support
    """

    name: str
    title: str
    material: Material
    band: tuple[float, float]
    loss: float
    proportional: tuple[float, float]
    joint_loss: float
    hammers: Mapping[str, Place]
    sensors: Mapping[str, Place]
    held_out: tuple[str, ...]
    springs: tuple[Spring, ...]
    bolts: Mapping[str, Point]
    loosened: tuple[int, ...]
    supports: tuple[Support, ...] = ()

    @property
    def frequencies(self) -> Array:
        """Lines of the measurement [Hz]."""
        return np.arange(self.band[0] - 5.0, self.band[1] + 6.0)

    @property
    def responses(self) -> dict[str, tuple[str, str]]:
        """Hammer and accelerometer of each response."""
        return {f"{sensor}-{hammer}": (hammer, sensor) for hammer in self.hammers for sensor in self.sensors}

    @property
    @abstractmethod
    def parts(self) -> int:
        """How many parts there are."""

    @abstractmethod
    def system(self, specimen: Specimen | None) -> System:
        """The rig without its joints, or the nominal model for None."""

    @abstractmethod
    def row(self, system: System, place: Place, *, true: bool) -> Array:
        """(n,) what an accelerometer or a hammer at a place meets."""

    @abstractmethod
    def nodes(self, system: System, spring: Spring) -> tuple[int, int]:
        """DOFs of the nominal model that a spring joins; the second is -1 at the ground."""

    @abstractmethod
    def term(self, system: System, spring: Spring) -> Array:
        """(n,) elongation of a spring of the rig."""

    def vector(self, system: System, spring: Spring) -> Array:
        """(n,) elongation of a spring of the nominal model."""
        found = np.zeros(system.node.size)
        for dof, sign in zip(self.nodes(system, spring), (1.0, -1.0), strict=True):
            if dof >= 0:
                found[dof] = sign
        return found

    def supported(self, system: System, *, true: bool, factor: float = 1.0) -> System:
        """The same on its soft supports."""
        stiffness = system.stiffness
        for support in self.supports:
            if true or support.nominal:
                row = sp.csr_array(self.row(system, Place(support.point, "UZ", support.part), true=true)[None, :])
                stiffness = sp.csr_array(stiffness + support.stiffness * factor * (row.T @ row))
        return replace(system, stiffness=stiffness)

    def as_designed(self) -> Specimen:
        """The rig without a deviation."""
        ones = (1.0,) * self.parts
        return Specimen(ones, ones, ones)

    def draw(self, rng: np.random.Generator) -> Specimen:
        """Draw a specimen."""

        def off(low: float, high: float) -> float:
            return round(float(1 + rng.choice([-1, 1]) * rng.uniform(low, high)), 6)

        def each(low: float, high: float) -> tuple[float, ...]:
            return tuple(off(low, high) for _ in range(self.parts))

        def normal(std: float) -> float:
            return round(float(rng.normal(0.0, std)), 5)

        def shift() -> Point:
            x, y, z = rng.normal(0.0, 0.0015, 3).clip(-0.003, 0.003).round(5).tolist()
            return x, y, z

        return Specimen(
            young=each(0.003, 0.015),
            density=each(0.002, 0.006),
            thickness=each(0.001, 0.004),
            loss=off(0.05, 0.2),
            viscous=off(0.05, 0.2),
            joint_loss=off(0.1, 0.3),
            joints={name: normal(0.11) for name in self.bolts},
            springs={f"{s.joint}.{s.component}": normal(0.05) for s in self.springs},
            offsets={name: shift() for name in (*self.hammers, *self.sensors)},
            supports=off(0.05, 0.3),
        )


@dataclass(frozen=True)
class PlateDesign(JointDesign):
    """Plates on bolts, to the ground or from the first to the second plate.

    Attributes
    ----------
    sheets : tuple of Sheet
    washer : float
        Radius of what a bolt holds in the rig [m]; in the nominal model it holds a node.
    """

    sheets: tuple[Sheet, ...] = ()
    washer: float = 0.008

    @property
    def parts(self) -> int:
        """As many as sheets."""
        return len(self.sheets)

    def system(self, specimen: Specimen | None) -> System:
        """Triangles, or quadrilaterals for a specimen."""
        true, known = specimen is not None, specimen or self.as_designed()
        made = []
        for sheet, young, density, thickness in zip(self.sheets, known.young, known.density, known.thickness, strict=True):
            material = replace(self.material, young=self.material.young * young, density=self.material.density * density)
            made.append(plate(replace(sheet, thickness=sheet.thickness * thickness), material, true=true))
        return self.supported(join(made), true=true, factor=known.supports)

    def row(self, system: System, place: Place, *, true: bool) -> Array:
        """Interpolated on the rig's mesh, of the nearest node in the nominal model."""
        found = np.zeros(system.node.size)
        own = np.flatnonzero((system.part == place.part) & (system.component == place.component))
        if true:
            nodes, weights = self.sheets[place.part].weights(*place.point[:2])
            found[own[nodes]] = weights
        else:
            found[own[np.argmin(np.linalg.norm(system.xyz[own, :2] - place.point[:2], axis=1))]] = 1.0
        return found

    def nodes(self, system: System, spring: Spring) -> tuple[int, int]:
        """Nodes below and above each other, or a node and the ground."""
        rows = [self.row(system, Place(self.bolts[spring.joint], spring.component, part), true=False) for part in range(self.parts)]
        first, *others = (int(np.flatnonzero(row)[0]) for row in rows)
        return first, others[0] if others else -1

    def term(self, system: System, spring: Spring) -> Array:
        """The mean under the washer, of the first plate less the second."""
        x, y, z = self.bolts[spring.joint]
        points = disc(self.washer) + np.array([x, y])
        found = np.zeros(system.node.size)
        for part, sign in zip(range(self.parts), (1.0, -1.0), strict=False):
            for a, b in points:
                found += sign / len(points) * self.row(system, Place((a, b, z), spring.component, part), true=True)
        return found


@dataclass(frozen=True)
class FrameDesign(JointDesign):
    """A space frame.

    Attributes
    ----------
    frame : Frame
    elements : (int, int)
        A member, in the nominal model and in the rig.
    """

    frame: Frame = field(default_factory=lambda: Frame({}, (), (), 0.0))
    elements: tuple[int, int] = (5, 12)

    @property
    def parts(self) -> int:
        """One: all members are of one lot."""
        return 1

    def _assembled(self, specimen: Specimen | None) -> tuple[System, list[tuple[np.ndarray, np.ndarray]]]:
        true, known = specimen is not None, specimen or self.as_designed()
        material = replace(self.material, young=self.material.young * known.young[0], density=self.material.density * known.density[0])
        scaled = replace(
            self.frame,
            members=tuple(replace(m, section=replace(m.section, wall=m.section.wall * known.thickness[0])) for m in self.frame.members),
        )
        return scaled.assembled(material, self.elements[int(true)], true=true)

    def system(self, specimen: Specimen | None) -> System:
        """Euler-Bernoulli beams, or more and Timoshenko's for a specimen."""
        return self._assembled(specimen)[0]

    def row(self, system: System, place: Place, *, true: bool) -> Array:
        """Between the two nodes of the member next to a point."""
        found = np.zeros(system.node.size)
        if not true:
            found[system.nearest(place.point, place.component)] = 1.0
            return found
        best = None
        for member in self.frame.members:
            a, b = (np.array(self.frame.hubs[name]) for name in (member.start, member.end))
            s = float(np.clip((np.array(place.point) - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0))
            distance = float(np.linalg.norm(a + s * (b - a) - place.point))
            if best is None or distance < best[0] - 1e-9:
                best = distance, a, b, s
        assert best is not None
        _, a, b, s = best
        count = self.elements[1]
        k = min(int(s * count), count - 1)
        for step, weight in ((k, 1 - (s * count - k)), (k + 1, s * count - k)):
            found[system.nearest(tuple(a + (b - a) * step / count), place.component)] += weight
        return found

    def nodes(self, system: System, spring: Spring) -> tuple[int, int]:
        """Member and hub, or member and ground."""
        kind = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ").index(spring.component)
        hub, member = self._joint(None, spring.joint)
        return int(member[kind]), int(hub[kind])

    def term(self, system: System, spring: Spring) -> Array:
        """The same on the rig's nodes."""
        kind = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ").index(spring.component)
        hub, member = self._joint(self.as_designed(), spring.joint)
        found = np.zeros(system.node.size)
        found[member[kind]] = 1.0
        if hub[kind] >= 0:
            found[hub[kind]] = -1.0
        return found

    def _joint(self, specimen: Specimen | None, name: str) -> tuple[np.ndarray, np.ndarray]:
        return self._assembled(specimen)[1][list(self.bolts).index(name)]
