"""What the nominal and the true model of a rig have in common: geometry, materials, supports, jobs.

SI units; the defaults are the SoundBox.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Point = tuple[float, float, float]
#: Edges of a plate: x = x0, x = x1, y = y0, y = y1.
EDGES = ("left", "right", "bottom", "top")
Corners = tuple[tuple[float, float], tuple[float, float], tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class Materials:
    """Plate and air; the defaults are Table 2 of the paper, before its two scaling factors.

    Attributes
    ----------
    ex, ey : float
        Young's moduli of the plate along x and y [Pa].
    nu : float
        Poisson's ratio, ``sqrt(nu_xy nu_yx)``.
    density : float
        Density of the plate [kg/m3].
    thickness : float
        Plate thickness [m].
    air_density : float
        Density of the air [kg/m3].
    sound_speed : float
        Speed of sound [m/s], before `acoustic_mass_factor`.
    stiffness_factor, acoustic_mass_factor : float
        gamma and delta of Table 2.
    """

    ex: float = 66e9
    ey: float = 81e9
    nu: float = 0.33
    density: float = 2700.0
    thickness: float = 0.003
    air_density: float = 1.225
    sound_speed: float = 340.0
    stiffness_factor: float = 0.85361
    acoustic_mass_factor: float = 0.98179

    @property
    def bending(self) -> tuple[float, float, float, float]:
        """Bending stiffnesses Dx, Dy, D1 (coupling of the curvatures) and Dxy (twist) [N m]."""
        scale = self.stiffness_factor * self.thickness**3 / 12
        dx = scale * self.ex / (1 - self.nu**2)
        dy = scale * self.ey / (1 - self.nu**2)
        mean = float(np.sqrt(dx * dy))
        return dx, dy, self.nu * mean, 0.5 * (1 - self.nu) * mean

    @property
    def surface_mass(self) -> float:
        """Mass of the plate per area [kg/m2]."""
        return self.density * self.thickness

    @property
    def compliance(self) -> float:
        """Delta / (rho c^2) of the air [1/Pa]."""
        return self.acoustic_mass_factor / (self.air_density * self.sound_speed**2)


@dataclass(frozen=True)
class Foundation:
    """What the plate of the true rig rests on under its clamping frame.

    Attributes
    ----------
    tight, elsewhere : float
        In the patch of a tightened bolt of the left edge, and under the other edges, which are never loosened [N/m3].
    weak : float
        Bedding of the whole frame [N/m3].
    lip, lip_width : float
        Sealing lip [N/m3, m]: holds the deflection at the edge, hardly its slope.
    patch_radius : float
        Of a bolt [m].
    loss : float
        Loss factor.
    patch_damping : float
        Viscous damping in the patch of a removed bolt [N s/m3].
    clamp_compliance : float
        The nominal edges are ideally clamped, the rig's are not: factor on the rig's bending stiffness that makes up for it.
    """

    tight: float = 1.0e11
    elsewhere: float = 3.0e12
    weak: float = 1.0e7
    lip: float = 4.0e9
    lip_width: float = 0.005
    patch_radius: float = 0.020
    loss: float = 0.03
    patch_damping: float = 5.0e4
    # Table 2's stiffness factor was found for ideally clamped edges, so it holds the compliance of the clamps.
    clamp_compliance: float = 1.067


@dataclass(frozen=True)
class Mesh:
    """A grid of neck and cavity, see ``cavity.block_grid``.

    Attributes
    ----------
    aperture : (int, int)
        Cells across the aperture.
    sides : (int, int, int, int)
        Cells left of, right of, below and above it.
    depths : tuple of int
        Cells along z between z = 0, the depths of the microphones inside, and the back wall.
    plate : int
        Plate elements along one side of a cell of the aperture.
    neck : int
        Cells along z in the neck.
    """

    aperture: tuple[int, int]
    sides: tuple[int, int, int, int]
    depths: tuple[int, ...]
    plate: int
    neck: int = 1


def _soundbox_microphones() -> Mapping[str, Point]:
    return {
        "mic01": (0.6, 0.5, 0.05),
        "mic02": (0.4, 0.5, 0.05),
        "mic03": (0.2, 0.5, 0.05),
        "mic04": (0.55, 0.29, 0.535),
        "mic05": (0.35, 0.29, 0.535),
        "mic06": (0.15, 0.29, 0.535),
        "mic07": (0.5, 0.607, 0.82),
        "mic08": (0.3, 0.607, 0.82),
        "mic09": (0.783, 0.848, 1.082),
        "mic10": (0.0, 0.849, 1.082),
    }


def _soundbox_jobs() -> Mapping[str, tuple[int, ...]]:
    limits = ((8, 11), (7, 12), (5, 14), (4, 15), (2, 16), (1, 17))
    return {"bolts-00": ()} | {f"bolts-{b - a + 1:02d}": tuple(range(a, b + 1)) for a, b in limits}


@dataclass(frozen=True)
class Design:
    """Everything about a rig but what differs from one specimen to the next.

    Attributes
    ----------
    name, title : str
    plate_origin : (float, float, float)
        Corner of the plate, the aperture of the box; its z is the length of the neck with a minus.
    plate_cells : (int, int)
        Elements of the nominal plate along x and y.
    plate_step : (float, float)
        Their sizes [m]; a node lies on the hammer point.
    depth : float
        Of the cavity [m]: a rectangular front at z = 0 that tapers to a skewed quadrilateral.
    front, back : four corners
        In the order (0, 0), (1, 0), (1, 1), (0, 1) [m].
    hammer : (float, float)
        Hammer point on the plate [m].
    microphones : mapping
        Positions [m]: rows along x at up to four depths inside, and corners of the back wall.
    used : tuple of str
        Microphones that enter the cost of the campaign file; the others test the result.
    frame_width : float
        The bolts stand in the middle of the clamping frame, left of the edge x = x0.
    bolt_count : int
    bolt_pitch : float
        [m]
    materials : Materials
    structure_damping, acoustic_damping : (float, float)
        Proportional damping: alpha [1/s], beta [s].
    foundation : Foundation
    nominal, true : Mesh
        Of the nominal model (tetrahedra) and of the rig (hexahedra).
    pinned : tuple of str
        Edges of the nominal plate that may turn (``left``, ``right``, ``bottom``, ``top``); the others and the corners are clamped.
    held_at_nodes : bool
        The pinned edges are held at their nodes only, so that the slope along them is free too.
    jobs : mapping
        Numbers of the removed bolts by job, the first job with none.
    """

    name: str = "soundbox"
    title: str = "SoundBox"
    plate_origin: Point = (0.1, 0.2, -0.035)
    plate_cells: tuple[int, int] = (40, 35)
    plate_step: tuple[float, float] = (0.1735 / 12, 0.0144)
    depth: float = 1.082
    front: Corners = ((0.0, 0.0), (0.8, 0.0), (0.8, 0.865), (0.0, 0.865))
    back: Corners = ((0.012, 0.0), (0.795, 0.010), (0.783, 0.848), (0.0, 0.849))
    hammer: tuple[float, float] = (0.2735, 0.3440)
    microphones: Mapping[str, Point] = field(default_factory=_soundbox_microphones)
    used: tuple[str, ...] = ("mic01", "mic03", "mic04", "mic05", "mic09", "mic10")
    frame_width: float = 0.030
    bolt_count: int = 17
    bolt_pitch: float = 0.04
    materials: Materials = field(default_factory=Materials)
    # Table 2.
    structure_damping: tuple[float, float] = (5.1357, 2.554e-6)
    acoustic_damping: tuple[float, float] = (3.7755, 5.199e-7)
    foundation: Foundation = field(default_factory=Foundation)
    nominal: Mesh = field(default_factory=lambda: Mesh((8, 7), (1, 1, 3, 2), (1, 6, 4, 3), 5))
    true: Mesh = field(default_factory=lambda: Mesh((8, 8), (2, 2, 3, 3), (1, 7, 4, 4), 3))
    jobs: Mapping[str, tuple[int, ...]] = field(default_factory=_soundbox_jobs)
    pinned: tuple[str, ...] = ("left",)
    held_at_nodes: bool = False

    def __post_init__(self) -> None:
        if tuple(n * self.nominal.plate for n in self.nominal.aperture) != self.plate_cells:
            raise ValueError(f"{self.name}: the plate's elements do not divide the cells of the aperture")
        if not set(self.pinned) <= set(EDGES):
            raise ValueError(f"{self.name}: no edges of a plate: {', '.join(sorted(set(self.pinned) - set(EDGES)))}")
        if any(self.jobs[self.reference]):
            raise ValueError(f"{self.name}: the first job has no bolt removed")

    @property
    def plate_end(self) -> tuple[float, float]:
        """Opposite corner of the plate."""
        (x0, y0, _), (nx, ny), (hx, hy) = self.plate_origin, self.plate_cells, self.plate_step
        return x0 + nx * hx, y0 + ny * hy

    @property
    def hammer_point(self) -> Array:
        """(3,) hammer point."""
        return np.array([*self.hammer, self.plate_origin[2]])

    @property
    def reference(self) -> str:
        """The job with all bolts tight."""
        return next(iter(self.jobs))

    @property
    def bolts(self) -> dict[str, Array]:
        """Names and positions of the bolts along the left edge, in the direction of y."""
        x0, y0, z = self.plate_origin
        middle = 0.5 * (y0 + self.plate_end[1])
        y = middle + self.bolt_pitch * (np.arange(self.bolt_count) - (self.bolt_count - 1) / 2)
        return {self.bolt(i + 1): np.array([x0 - self.frame_width / 2, y[i], z]) for i in range(self.bolt_count)}

    @staticmethod
    def bolt(number: int) -> str:
        """Name of a bolt."""
        return f"B{number:02d}"

    def removed(self, job: str) -> list[str]:
        """Names of the bolts that a job of the design removes."""
        return [self.bolt(i) for i in self.jobs[job]]

    def cross_section(self, xi: Array, eta: Array, z: Array) -> tuple[Array, Array]:
        """Map front coordinates onto the cross-section at depth `z`.

        Parameters
        ----------
        xi, eta : array
            Coordinates in the front rectangle [m].
        z : array
            Depth [m]; the neck (z < 0) is a straight continuation of the front.

        Returns
        -------
        x, y : array
            Coordinates in the box [m].
        """
        front, back = np.array(self.front), np.array(self.back)
        s = np.maximum(z, 0.0) / self.depth
        u, v = xi / front[2, 0], eta / front[2, 1]
        shape = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
        shift = np.tensordot((back - front).T, shape, axes=1)
        return xi + s * shift[0], eta + s * shift[1]

    def front_coordinates(self, x: float, y: float, z: float) -> tuple[float, float]:
        """Inverse of `cross_section` for one point, by fixed-point iteration."""
        xi, eta = x, y
        for _ in range(50):
            px, py = self.cross_section(np.array(xi), np.array(eta), np.array(z))
            xi, eta = xi + x - float(px), eta + y - float(py)
        return xi, eta
