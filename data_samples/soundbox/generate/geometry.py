"""Geometry and materials of the SoundBox: what the nominal and the true model have in common. SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Plate: aperture of the box in the plane z = PLATE_Z.
PLATE_Z = -0.035
PLATE_X0 = 0.1
PLATE_Y0 = 0.2
PLATE_NX = 40
PLATE_NY = 35
# Steps that put a node on the hammer point (0.2735, 0.3440).
PLATE_HX = 0.1735 / 12
PLATE_HY = 0.0144
PLATE_X1 = PLATE_X0 + PLATE_NX * PLATE_HX
PLATE_Y1 = PLATE_Y0 + PLATE_NY * PLATE_HY
# Plate elements along one side of an acoustic element of the aperture.
PLATE_PER_ACOUSTIC = 5

# Cavity: a rectangular front at z = 0 that tapers to a skewed quadrilateral at z = DEPTH; a neck joins the front to the plate.
DEPTH = 1.082
FRONT = np.array([[0.0, 0.0], [0.8, 0.0], [0.8, 0.865], [0.0, 0.865]])
BACK = np.array([[0.012, 0.0], [0.795, 0.010], [0.783, 0.848], [0.0, 0.849]])

HAMMER = np.array([0.2735, 0.3440, PLATE_Z])
MICROPHONES: dict[str, tuple[float, float, float]] = {
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

# Bolts: a row in the middle of the 30 mm wide clamping frame, beyond the ends of the plate's left edge too.
FRAME_WIDTH = 0.030
BOLT_COUNT = 17
BOLT_PITCH = 0.04
BOLT_X = PLATE_X0 - FRAME_WIDTH / 2


def bolts() -> dict[str, Array]:
    """Names and positions of the bolts along the left edge, in the direction of y."""
    middle = 0.5 * (PLATE_Y0 + PLATE_Y1)
    y = middle + BOLT_PITCH * (np.arange(BOLT_COUNT) - (BOLT_COUNT - 1) / 2)
    return {f"B{i + 1:02d}": np.array([BOLT_X, y[i], PLATE_Z]) for i in range(BOLT_COUNT)}


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


# Proportional damping of Table 2: alpha [1/s], beta [s].
STRUCTURE_DAMPING = (5.1357, 2.554e-6)
ACOUSTIC_DAMPING = (3.7755, 5.199e-7)


def cross_section(xi: Array, eta: Array, z: Array) -> tuple[Array, Array]:
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
    s = np.maximum(z, 0.0) / DEPTH
    u, v = xi / FRONT[2, 0], eta / FRONT[2, 1]
    shape = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
    shift = np.tensordot((BACK - FRONT).T, shape, axes=1)
    return xi + s * shift[0], eta + s * shift[1]


def front_coordinates(x: float, y: float, z: float) -> tuple[float, float]:
    """Inverse of `cross_section` for one point, by fixed-point iteration."""
    xi, eta = x, y
    for _ in range(50):
        px, py = cross_section(np.array(xi), np.array(eta), np.array(z))
        xi, eta = xi + x - float(px), eta + y - float(py)
    return xi, eta
