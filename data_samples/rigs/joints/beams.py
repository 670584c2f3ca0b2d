"""Space frames of straight beams: Euler-Bernoulli in the nominal models, Timoshenko with rotatory inertia and more elements in the rigs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from rigs.joints.system import Array, IntArray, Material, System, assemble

COMPONENTS = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")


@dataclass(frozen=True)
class Section:
    """A rectangular tube.

    Attributes
    ----------
    width, height, wall : float
        Along the local y and z [m].
    """

    width: float
    height: float
    wall: float

    @property
    def area(self) -> float:
        """Of the wall [m2]."""
        return self.width * self.height - self._inner[0] * self._inner[1]

    @property
    def _inner(self) -> tuple[float, float]:
        return self.width - 2 * self.wall, self.height - 2 * self.wall

    @property
    def about_y(self) -> float:
        """Second moment for bending along the local z [m4]."""
        return (self.width * self.height**3 - self._inner[0] * self._inner[1] ** 3) / 12

    @property
    def about_z(self) -> float:
        """Second moment for bending along the local y [m4]."""
        return (self.height * self.width**3 - self._inner[1] * self._inner[0] ** 3) / 12

    @property
    def torsion(self) -> float:
        """Bredt's torsion constant [m4]."""
        a, b = self.width - self.wall, self.height - self.wall
        return 2 * self.wall * (a * b) ** 2 / (a + b)


@dataclass(frozen=True)
class Member:
    """A beam between two hubs.

    Attributes
    ----------
    start, end : str
        Hubs; ``ground`` hubs hold the translations.
    section : Section
    joints : (bool, bool)
        Which ends are joined through rotational springs, not rigidly.
    """

    start: str
    end: str
    section: Section
    joints: tuple[bool, bool]


def bending(rigidity: float, length: float, shear: float) -> Array:
    """(4, 4) stiffness of deflections and slopes; `shear` is 12 EI / (k G A L^2), 0 for Euler-Bernoulli."""
    a, b, h = 4 + shear, 2 - shear, length
    rows = [[12, 6 * h, -12, 6 * h], [6 * h, a * h**2, -6 * h, b * h**2], [-12, -6 * h, 12, -6 * h], [6 * h, b * h**2, -6 * h, a * h**2]]
    return rigidity / (length**3 * (1 + shear)) * np.array(rows)


def inertia(line_mass: float, line_inertia: float, length: float) -> Array:
    """(4, 4) mass of deflections and slopes."""
    h = length
    move = [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2]]
    move += [[54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
    turn = [[36, 3 * h, -36, 3 * h], [3 * h, 4 * h**2, -3 * h, -(h**2)], [-36, -3 * h, 36, -3 * h], [3 * h, -(h**2), -3 * h, 4 * h**2]]
    return line_mass * h / 420 * np.array(move) + line_inertia / (30 * h) * np.array(turn)


def axes(direction: Array) -> Array:
    """(3, 3) local axes as rows: along the beam, and across it, the local z as upright as can be."""
    x = direction / np.linalg.norm(direction)
    up = np.array([1.0, 0, 0]) if abs(x[2]) > 0.9 else np.array([0, 0, 1.0])
    y = np.cross(up, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])


def beam(section: Section, material: Material, span: Array, *, true: bool) -> tuple[Array, Array]:
    """Stiffness and mass (12, 12) of an element that spans a vector [m], in global axes."""
    length = float(np.linalg.norm(span))
    young, rho, area = material.young, material.density, section.area
    shear_modulus = young / (2 * (1 + material.nu))
    stiffness, mass = np.zeros((2, 12, 12))
    polar = section.about_y + section.about_z
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    for at, rigidity, line in ((0, young * area, rho * area), (3, shear_modulus * section.torsion, rho * polar)):
        where = np.ix_([at, at + 6], [at, at + 6])
        stiffness[where] = rigidity / length * pair
        mass[where] = line * length / 6 * (np.abs(pair) + np.eye(2))
    for where, moment, web, sign in (
        ([1, 5, 7, 11], section.about_z, section.width, 1.0),
        ([2, 4, 8, 10], section.about_y, section.height, -1.0),
    ):
        # The two walls along the force carry the shear.
        shear = 12 * young * moment / (shear_modulus * 2 * web * section.wall * length**2) if true else 0.0
        flip = np.diag([1.0, sign, 1.0, sign])
        stiffness[np.ix_(where, where)] = flip @ bending(young * moment, length, shear) @ flip
        mass[np.ix_(where, where)] = flip @ inertia(rho * area, rho * moment if true else 0.0, length) @ flip
    turn = np.kron(np.eye(4), axes(span))
    return turn.T @ stiffness @ turn, turn.T @ mass @ turn


@dataclass(frozen=True)
class Frame:
    """Hubs and members.

    Attributes
    ----------
    hubs : mapping of str to (float, float, float)
        [m]
    ground : tuple of str
        Hubs that cannot move; a member's end there turns.
    members : tuple of Member
    gusset : float
        Mass of each hub that moves [kg].
    """

    hubs: Mapping[str, tuple[float, float, float]]
    ground: tuple[str, ...]
    members: tuple[Member, ...]
    gusset: float

    def assembled(self, material: Material, elements: int, *, true: bool) -> tuple[System, list[tuple[IntArray, IntArray]]]:
        """Matrices without the joints, and the DOFs (6,) of the hub and of the member at each joint, in the order of the members.

        Where the member is held at the ground, its DOFs there are those of turning alone, and those of the hub are -1.
        """
        place = {name: np.array(xyz) for name, xyz in self.hubs.items()}
        dofs: list[tuple[int, str, Array]] = []
        nodes = 0

        def new(xyz: Array, kinds: Sequence[int]) -> IntArray:
            nonlocal nodes
            nodes += 1
            own = np.full(6, -1, dtype=np.int64)
            for kind in kinds:
                own[kind] = len(dofs)
                dofs.append((nodes, COMPONENTS[kind], xyz))
            return own

        hub = {name: new(xyz, range(6)) if name not in self.ground else np.full(6, -1, dtype=np.int64) for name, xyz in place.items()}
        joints, matrices, where = [], [], []
        for member in self.members:
            a, b = place[member.start], place[member.end]
            ends = []
            for name, jointed in zip((member.start, member.end), member.joints, strict=True):
                own = hub[name].copy()
                if jointed:
                    own[3:] = new(place[name], range(3, 6))[3:]
                    joints.append((hub[name], own))
                ends.append(own)
            inner = [new(a + (b - a) * k / elements, range(6)) for k in range(1, elements)]
            chain = [ends[0], *inner, ends[1]]
            matrices += [beam(member.section, material, (b - a) / elements, true=true)] * elements
            where += [np.concatenate(two) for two in pairwise(chain)]
        size = len(dofs)
        gussets = np.zeros(size)
        for own in hub.values():
            gussets[own[:3][own[:3] >= 0]] = self.gusset
        node, component, xyz = zip(*dofs, strict=True)
        system = System(
            assemble(np.array([k for k, _ in matrices]), np.array(where), size),
            sp.csr_array(assemble(np.array([m for _, m in matrices]), np.array(where), size) + sp.diags_array(gussets)),
            np.array(node),
            np.array(component),
            np.array(xyz),
            np.zeros(size, dtype=np.int64),
        )
        return system, joints
