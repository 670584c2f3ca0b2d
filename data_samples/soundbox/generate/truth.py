"""The rig that is measured: another model than the nominal one.

Argyris triangles for a plate that goes on under its clamping frame, held there by an elastic foundation; quadratic hexahedra for the air.
The foundation is strong in a patch around each tightened bolt; a sealing lip along the inner edge of the frame and a weak bedding
remain where a bolt is removed, and friction there damps.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np
import scipy.sparse as sp
import skfem
from cavity import Grid, block_grid
from coupled import Cavity, PlateModes, factorise, lowest_modes
from geometry import (
    ACOUSTIC_DAMPING,
    FRAME_WIDTH,
    HAMMER,
    MICROPHONES,
    PLATE_X0,
    PLATE_X1,
    PLATE_Y0,
    PLATE_Y1,
    PLATE_Z,
    STRUCTURE_DAMPING,
    Array,
    Materials,
    bolts,
)
from skfem.helpers import dd, dot, grad

# Foundation under the frame [N/m3].
TIGHT = 1.0e11  # in the patch of a tightened bolt of the left edge
TIGHT_ELSEWHERE = 3.0e12  # under the other edges, which are never loosened
WEAK = 1.0e7  # bedding of the whole frame
LIP = 4.0e9  # sealing lip: holds the deflection at the edge, hardly its slope
LIP_WIDTH = 0.005
PATCH_RADIUS = 0.020
# Loss factor of the foundation, and viscous damping in the patch of a removed bolt [N s/m3].
FOUNDATION_LOSS = 0.03
PATCH_DAMPING = 5.0e4
# Table 2's stiffness factor was found for ideally clamped edges, so it holds the compliance of the clamps, which the rig has besides.
CLAMP_COMPLIANCE = 1.067
PLATE_MODES = 90


@dataclass(frozen=True)
class Perturbations:
    """How the rig differs from the nominal model: factors on its materials, patches and damping, and the positions of the sensors.

    Attributes
    ----------
    ex, ey, density, thickness, sound_speed : float
        Factors on the nominal materials.
    alpha_structure, beta_structure, alpha_acoustic, beta_acoustic : float
        Factors on the nominal damping.
    bolts : dict of str to float
        Factors on the patches of the left edge, bolt by bolt.
    settling : float
        Standard deviation of the logarithm of a further factor, drawn bolt by bolt for each configuration.
    microphones : dict of str to list of float
        True minus nominal position [m].
    hammer : list of float
        True minus nominal x and y of the hits [m].
    """

    ex: float
    ey: float
    density: float
    thickness: float
    sound_speed: float
    alpha_structure: float
    beta_structure: float
    alpha_acoustic: float
    beta_acoustic: float
    bolts: dict[str, float] = field(default_factory=dict)
    settling: float = 0.08
    microphones: dict[str, list[float]] = field(default_factory=dict)
    hammer: list[float] = field(default_factory=lambda: [0.0, 0.0])

    @staticmethod
    def draw(rng: np.random.Generator) -> Perturbations:
        """Draw all of them."""

        def off(low: float, high: float) -> float:
            return float(1 + rng.choice([-1, 1]) * rng.uniform(low, high))

        inside = {"mic09": (-1, -1, -1), "mic10": (1, -1, -1)}
        shifts = {}
        for name in MICROPHONES:
            shift = rng.normal(0.0, 0.001, 3).clip(-0.002, 0.002)
            # The two in corners of the box can only move inwards.
            shifts[name] = (np.abs(shift) * inside[name] if name in inside else shift).round(5).tolist()
        return Perturbations(
            ex=off(0.003, 0.01),
            ey=off(0.003, 0.01),
            density=off(0.003, 0.006),
            thickness=off(0.001, 0.003),
            sound_speed=off(0.003, 0.005),
            alpha_structure=off(0.05, 0.15),
            beta_structure=off(0.05, 0.15),
            alpha_acoustic=off(0.05, 0.15),
            beta_acoustic=off(0.05, 0.15),
            bolts={name: float(np.exp(rng.normal(0.0, 0.25))) for name in bolts()},
            microphones=shifts,
            hammer=rng.normal(0.0, 0.0007, 2).round(5).tolist(),
        )

    def as_dict(self) -> dict[str, object]:
        """Plain dictionary for the record beside the data."""
        return asdict(self)

    def materials(self) -> Materials:
        """Return the true materials."""
        nominal = Materials()
        return Materials(
            ex=nominal.ex * self.ex,
            ey=nominal.ey * self.ey,
            density=nominal.density * self.density,
            thickness=nominal.thickness * self.thickness,
            stiffness_factor=nominal.stiffness_factor * CLAMP_COMPLIANCE,
            sound_speed=nominal.sound_speed * self.sound_speed,
        )


@skfem.BilinearForm
def _laplace(p, q, _w):  # type: ignore[no-untyped-def]
    return dot(grad(p), grad(q))


@skfem.BilinearForm
def _product(p, q, _w):  # type: ignore[no-untyped-def]
    return p * q


@skfem.BilinearForm
def _weighted(u, v, w):  # type: ignore[no-untyped-def]
    return w["field"] * u * v


def _line(stops: list[float], counts: list[int]) -> Array:
    return np.unique(np.concatenate([np.linspace(a, b, c + 1) for a, b, c in zip(stops[:-1], stops[1:], counts, strict=True)]).round(12))


def hexahedra(grid: Grid) -> skfem.Basis:
    """Quadratic hexahedra on a block grid."""
    corners = ((0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 0), (1, 1, 1))
    cells = np.stack([grid.cells[:, a, b, c] for a, b, c in corners])
    mesh = skfem.MeshHex(np.ascontiguousarray(grid.points.T), np.ascontiguousarray(cells))
    return skfem.Basis(mesh, skfem.ElementHex2(), intorder=5)


class Rig:
    """The true model; assemble once, then ask for the plate of each configuration.

    Parameters
    ----------
    perturbations : Perturbations
    """

    # Cells of the cavity across the aperture, beside it, along z and in the neck; plate cells per acoustic cell.
    APERTURE = (8, 8)
    SIDES = (2, 2, 3, 3)
    DEPTHS = (1, 7, 4, 4)
    PLATE_PER_ACOUSTIC = 3

    def __init__(self, perturbations: Perturbations) -> None:
        self.perturbations = perturbations
        self.materials = perturbations.materials()
        self._assemble_cavity()
        self._assemble_plate()

    def _assemble_cavity(self) -> None:
        grid = block_grid(self.APERTURE, self.SIDES, list(self.DEPTHS), 1, snap=False)
        self.air = hexahedra(grid)
        stiffness = sp.csr_array(_laplace.assemble(self.air)) / self.materials.air_density
        mass = sp.csr_array(_product.assemble(self.air)) * self.materials.compliance
        self.cavity = Cavity(0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T))
        at = np.array([np.add(xyz, self.perturbations.microphones[name]) for name, xyz in MICROPHONES.items()])
        self.outputs = sp.csr_array(self.air.probes(at.T))

    def _assemble_plate(self) -> None:
        nx, ny = (self.PLATE_PER_ACOUSTIC * n for n in self.APERTURE)
        frame, lip = FRAME_WIDTH, LIP_WIDTH
        x0, x1, y0, y1 = PLATE_X0, PLATE_X1, PLATE_Y0, PLATE_Y1
        xs = _line([x0 - frame, x0 - lip, x0, x1, x1 + lip, x1 + frame], [2, 1, nx, 1, 2])
        ys = _line([y0 - frame, y0 - lip, y0, y1, y1 + lip, y1 + frame], [2, 1, ny, 1, 2])
        mesh = skfem.MeshTri.init_tensor(xs, ys)
        self.plate = skfem.Basis(mesh, skfem.ElementTriArgyris(), intorder=12)
        dx, dy, d1, dxy = self.materials.bending

        @skfem.BilinearForm
        def bending(u, v, _w):  # type: ignore[no-untyped-def]
            a, b = dd(u), dd(v)
            direct = dx * a[0, 0] * b[0, 0] + dy * a[1, 1] * b[1, 1] + d1 * (a[0, 0] * b[1, 1] + a[1, 1] * b[0, 0])
            return direct + 4 * dxy * a[0, 1] * b[0, 1]

        self.elastic = self._symmetric(bending.assemble(self.plate))
        self.mass = self._symmetric(_product.assemble(self.plate)) * self.materials.surface_mass
        point = HAMMER[:2] + self.perturbations.hammer
        self.load = np.asarray(self.plate.probes(point[:, None]).todense()).ravel()
        self.points = np.asarray(self.plate.global_coordinates())
        x, y = self.points
        under = (x < x0) | (x > x1) | (y < y0) | (y > y1)
        near = under & (x > x0 - lip) & (x < x1 + lip) & (y > y0 - lip) & (y < y1 + lip)
        elsewhere = under & ~(x < x0)
        self.foundation = WEAK * under + LIP * near + TIGHT_ELSEWHERE * elsewhere
        self.under_left = under & (x < x0)
        self.coupling = self._couple(~under)

    @staticmethod
    def _symmetric(matrix: sp.csr_array) -> sp.csr_array:
        matrix = sp.csr_array(matrix)
        return sp.csr_array(0.5 * (matrix + matrix.T))

    def _patch(self, x: float, y: float) -> Array:
        distance = np.hypot(self.points[0] - x, self.points[1] - y)
        return np.asarray(np.exp(-((distance / PATCH_RADIUS) ** 4)))

    def _couple(self, aperture: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> sp.csr_array:
        """``int N_w N_p`` over the aperture: plate DOFs times pressures, at the plate's quadrature points."""
        inside = np.flatnonzero(aperture.all(axis=1))
        x, y = self.points[0][inside], self.points[1][inside]
        pressure = sp.csr_array(self.air.probes(np.stack([x.ravel(), y.ravel(), np.full(x.size, PLATE_Z)])))
        weights = self.plate.dx[inside]
        rows, cols, values = [], [], []
        column = np.arange(x.size).reshape(x.shape)
        for k in range(self.plate.Nbfun):
            rows.append(np.repeat(self.plate.element_dofs[k, inside], x.shape[1]))
            cols.append(column.ravel())
            values.append((np.asarray(self.plate.basis[k][0])[inside] * weights).ravel())
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols)))
        return sp.csr_array(sp.csr_array(sp.coo_array(entries, shape=(self.plate.N, x.size))) @ pressure)

    def _weighted(self, values: Array) -> sp.csr_array:
        return self._symmetric(_weighted.assemble(self.plate, field=values))

    def configuration(self, removed: list[str], rng: np.random.Generator) -> tuple[PlateModes, dict[str, float]]:
        """Plate with some bolts of the left edge removed.

        Parameters
        ----------
        removed : list of str
            Names of the removed bolts.
        rng : numpy.random.Generator
            Draws how the tight bolts have settled since the last configuration.

        Returns
        -------
        plate : PlateModes
        factors : dict of str to float
            Factor on each bolt's patch; 0 where removed.
        """
        springs = self.foundation.copy()
        dashpots = np.zeros_like(springs)
        factors = {}
        for name, (x, y, _) in bolts().items():
            settled = float(np.exp(rng.normal(0.0, self.perturbations.settling)))
            patch = self._patch(x, y) * self.under_left
            if name in removed:
                factors[name] = 0.0
                dashpots += PATCH_DAMPING * patch
            else:
                factors[name] = self.perturbations.bolts[name] * settled
                springs += TIGHT * factors[name] * patch
        foundation = self._weighted(springs)
        stiffness = sp.csr_array(self.elastic + foundation)
        values, modes = lowest_modes(stiffness, self.mass, PLATE_MODES, 0.0, factorise(stiffness))
        alpha, beta = STRUCTURE_DAMPING
        damping = alpha * self.perturbations.alpha_structure * np.eye(PLATE_MODES)
        damping += beta * self.perturbations.beta_structure * (modes.T @ (self.elastic @ modes))
        if removed:
            damping += modes.T @ (self._weighted(dashpots) @ modes)
        loss = FOUNDATION_LOSS * (modes.T @ (foundation @ modes))
        return PlateModes(values, damping, loss, self.load @ modes, self.coupling.T @ modes), factors

    def air_damping(self) -> tuple[float, float]:
        """Coefficients alpha and beta of the air."""
        alpha, beta = ACOUSTIC_DAMPING
        return alpha * self.perturbations.alpha_acoustic, beta * self.perturbations.beta_acoustic
