"""The rig that is measured: another model than the nominal one.

Argyris triangles for a plate that goes on under its clamping frame, held there by an elastic foundation; quadratic hexahedra for the air.
The foundation is strong in a patch around each tightened bolt; a sealing lip along the inner edge of the frame and a weak bedding
remain where a bolt is removed, and friction there damps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import scipy.sparse as sp
import skfem
from skfem.helpers import dd, dot, grad

from lrbc_cli.virtual.drift import Drift
from rigs.cavity import Grid, block_grid
from rigs.coupled import Cavity, PlateModes, factorise, lowest_modes, pressure_frfs
from rigs.design import Array, Design, Materials

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

    ex: float = 1.0
    ey: float = 1.0
    density: float = 1.0
    thickness: float = 1.0
    sound_speed: float = 1.0
    alpha_structure: float = 1.0
    beta_structure: float = 1.0
    alpha_acoustic: float = 1.0
    beta_acoustic: float = 1.0
    bolts: dict[str, float] = field(default_factory=dict)
    settling: float = 0.08
    microphones: dict[str, list[float]] = field(default_factory=dict)
    hammer: list[float] = field(default_factory=lambda: [0.0, 0.0])

    @staticmethod
    def none(design: Design) -> Perturbations:
        """The rig as it was designed."""
        return Perturbations(
            bolts=dict.fromkeys(design.bolts, 1.0), settling=0.0, microphones={name: [0.0, 0.0, 0.0] for name in design.microphones}
        )

    @staticmethod
    def draw(design: Design, rng: np.random.Generator) -> Perturbations:
        """Draw all of them."""

        def off(low: float, high: float) -> float:
            return float(1 + rng.choice([-1, 1]) * rng.uniform(low, high))

        width, height = design.front[2]
        shifts = {}
        for name, (x, y, z) in design.microphones.items():
            shift = rng.normal(0.0, 0.001, 3).clip(-0.002, 0.002)
            # Those in corners of the box can only move inwards.
            inside = np.array([1 if x < width / 2 else -1, 1 if y < height / 2 else -1, -1])
            shifts[name] = (np.abs(shift) * inside if z == design.depth else shift).round(5).tolist()
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
            bolts={name: float(np.exp(rng.normal(0.0, 0.25))) for name in design.bolts},
            microphones=shifts,
            hammer=rng.normal(0.0, 0.0007, 2).round(5).tolist(),
        )

    def as_dict(self) -> dict[str, object]:
        """Plain dictionary for the record beside the data."""
        return asdict(self)

    def materials(self, design: Design) -> Materials:
        """Return the true materials."""
        nominal = design.materials
        return replace(
            nominal,
            ex=nominal.ex * self.ex,
            ey=nominal.ey * self.ey,
            density=nominal.density * self.density,
            thickness=nominal.thickness * self.thickness,
            stiffness_factor=nominal.stiffness_factor * design.foundation.clamp_compliance,
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


def symmetric(matrix: sp.csr_array) -> sp.csr_array:
    """Mean of the matrix and its transpose."""
    matrix = sp.csr_array(matrix)
    return sp.csr_array(0.5 * (matrix + matrix.T))


def hexahedra(grid: Grid) -> skfem.Basis:
    """Quadratic hexahedra on a block grid."""
    corners = ((0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 0), (1, 1, 1))
    cells = np.stack([grid.cells[:, a, b, c] for a, b, c in corners])
    mesh = skfem.MeshHex(np.ascontiguousarray(grid.points.T), np.ascontiguousarray(cells))
    return skfem.Basis(mesh, skfem.ElementHex2(), intorder=5)


class Air:
    """Air of the rigs of a design.

    Parameters
    ----------
    design : Design
    """

    def __init__(self, design: Design) -> None:
        mesh = design.true
        self.basis = hexahedra(block_grid(design, mesh.aperture, mesh.sides, mesh.depths, mesh.neck, snap=False))
        self.stiffness = sp.csr_array(_laplace.assemble(self.basis))
        self.mass = sp.csr_array(_product.assemble(self.basis))

    def at(self, points: Array) -> sp.csr_array:
        """Interpolation of the pressure at points (r, 3)."""
        try:
            return sp.csr_array(self.basis.probes(points.T))
        except ValueError:
            # A wall is a bilinear surface, which the finder takes for two planes: what it loses between them lies within 0.1 mm.
            inwards = self.basis.mesh.p.mean(axis=1) - points
            moved = points + 1e-4 * inwards / np.linalg.norm(inwards, axis=1, keepdims=True)
            return sp.csr_array(self.basis.probes(moved.T))

    def cavity(self, materials: Materials, microphones: Array) -> Cavity:
        """The cavity of one rig."""
        stiffness, mass = self.stiffness / materials.air_density, self.mass * materials.compliance
        return Cavity(symmetric(stiffness), symmetric(mass), self.at(microphones))


class Plate:
    """Plates of the rigs of a design: full matrices.

    Parameters
    ----------
    design : Design
    air : Air
    """

    def __init__(self, design: Design, air: Air) -> None:
        self.design = design
        nx, ny = (design.true.plate * n for n in design.true.aperture)
        frame, lip = design.frame_width, design.foundation.lip_width
        (x0, y0, _), (x1, y1) = design.plate_origin, design.plate_end
        xs = _line([x0 - frame, x0 - lip, x0, x1, x1 + lip, x1 + frame], [2, 1, nx, 1, 2])
        ys = _line([y0 - frame, y0 - lip, y0, y1, y1 + lip, y1 + frame], [2, 1, ny, 1, 2])
        mesh = skfem.MeshTri.init_tensor(xs, ys)
        self.basis = skfem.Basis(mesh, skfem.ElementTriArgyris(), intorder=12)
        self._unit_mass = symmetric(_product.assemble(self.basis))
        self.points = np.asarray(self.basis.global_coordinates())
        x, y = self.points
        under = (x < x0) | (x > x1) | (y < y0) | (y > y1)
        near = under & (x > x0 - lip) & (x < x1 + lip) & (y > y0 - lip) & (y < y1 + lip)
        elsewhere = under & ~(x < x0)
        rest = design.foundation
        self.bedding = rest.weak * under + rest.lip * near + rest.elsewhere * elsewhere
        self.under_left = under & (x < x0)
        self.coupling = self._couple(air, ~under)

    def elastic(self, bending: tuple[float, float, float, float]) -> sp.csr_array:
        """Stiffness of the plate itself for Dx, Dy, D1, Dxy."""
        dx, dy, d1, dxy = bending

        @skfem.BilinearForm
        def form(u, v, _w):  # type: ignore[no-untyped-def]
            a, b = dd(u), dd(v)
            direct = dx * a[0, 0] * b[0, 0] + dy * a[1, 1] * b[1, 1] + d1 * (a[0, 0] * b[1, 1] + a[1, 1] * b[0, 0])
            return direct + 4 * dxy * a[0, 1] * b[0, 1]

        return symmetric(form.assemble(self.basis))

    def mass(self, surface_mass: float) -> sp.csr_array:
        """Mass of the plate [kg/m2]."""
        return self._unit_mass * surface_mass

    def load(self, point: Array) -> Array:
        """Deflection at a point."""
        return np.asarray(self.basis.probes(point[:, None]).todense()).ravel()

    def patch(self, name: str) -> Array:
        """Shape of the patch of a bolt at the quadrature points."""
        x, y, _ = self.design.bolts[name]
        distance = np.hypot(self.points[0] - x, self.points[1] - y)
        return np.asarray(np.exp(-((distance / self.design.foundation.patch_radius) ** 4))) * self.under_left

    def foundation(self, factors: Mapping[str, float]) -> sp.csr_array:
        """Stiffness of the foundation, the patch of each bolt by its factor."""
        springs = self.bedding.copy()
        for name, factor in factors.items():
            if factor:
                springs += self.design.foundation.tight * factor * self.patch(name)
        return self.weighted(springs)

    def friction(self, removed: list[str]) -> sp.csr_array:
        """Viscous damping where bolts are removed."""
        dashpots = np.zeros_like(self.bedding)
        for name in removed:
            dashpots += self.design.foundation.patch_damping * self.patch(name)
        return self.weighted(dashpots)

    def weighted(self, values: Array) -> sp.csr_array:
        """``int f w w`` for a field `f` at the quadrature points."""
        return symmetric(_weighted.assemble(self.basis, field=values))

    @staticmethod
    def modes(stiffness: sp.csr_array, mass: sp.csr_array, count: int) -> tuple[Array, Array]:
        """Lowest eigenvalues and mass-normalised modes."""
        return lowest_modes(stiffness, mass, count, 0.0, factorise(stiffness))

    def _couple(self, air: Air, aperture: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> sp.csr_array:
        """``int N_w N_p`` over the aperture: plate DOFs times pressures, at the plate's quadrature points."""
        inside = np.flatnonzero(aperture.all(axis=1))
        x, y = self.points[0][inside], self.points[1][inside]
        pressure = air.at(np.stack([x.ravel(), y.ravel(), np.full(x.size, self.design.plate_origin[2])], axis=1))
        weights = self.basis.dx[inside]
        rows, cols, values = [], [], []
        column = np.arange(x.size).reshape(x.shape)
        for k in range(self.basis.Nbfun):
            rows.append(np.repeat(self.basis.element_dofs[k, inside], x.shape[1]))
            cols.append(column.ravel())
            values.append((np.asarray(self.basis.basis[k][0])[inside] * weights).ravel())
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols)))
        return sp.csr_array(sp.csr_array(sp.coo_array(entries, shape=(self.basis.N, x.size))) @ pressure)


class Rig:
    """One rig of a design; assemble once, then measure it in each configuration.

    Parameters
    ----------
    plate : Plate
    air : Air
        Or both as in ``reduced.py``.
    perturbations : Perturbations
    """

    def __init__(self, plate: Plate, air: Air, perturbations: Perturbations) -> None:
        self.plate, self.design, self.perturbations = plate, plate.design, perturbations
        materials = perturbations.materials(self.design)
        self.elastic, self.mass = plate.elastic(materials.bending), plate.mass(materials.surface_mass)
        microphones = np.array([np.add(xyz, perturbations.microphones[name]) for name, xyz in self.design.microphones.items()])
        self.cavity = air.cavity(materials, microphones)

    def factors(self, removed: list[str], rng: np.random.Generator) -> dict[str, float]:
        """Factor on each bolt's patch, 0 where removed; `rng` draws how the tight bolts have settled since the last configuration."""
        settled = {name: float(np.exp(rng.normal(0.0, self.perturbations.settling))) for name in self.design.bolts}
        return {name: 0.0 if name in removed else self.perturbations.bolts[name] * value for name, value in settled.items()}

    def plate_modes(self, factors: Mapping[str, float], hammer: Array) -> tuple[PlateModes, Array]:
        """Modes of the plate for the patches' factors and a hammer point (2,), and the vectors themselves."""
        foundation = self.plate.foundation(factors)
        values, modes = self.plate.modes(self.elastic + foundation, self.mass, PLATE_MODES)
        alpha, beta = self.design.structure_damping
        damping = alpha * self.perturbations.alpha_structure * np.eye(values.size)
        damping += beta * self.perturbations.beta_structure * (modes.T @ (self.elastic @ modes))
        removed = [name for name, factor in factors.items() if not factor]
        if removed:
            damping += modes.T @ (self.plate.friction(removed) @ modes)
        loss = self.design.foundation.loss * (modes.T @ (foundation @ modes))
        return PlateModes(values, damping, loss, self.plate.load(hammer) @ modes), modes

    def frfs(self, factors: Mapping[str, float], drift: Drift, frequencies: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.complex128]]:
        """Pressures per force.

        Parameters
        ----------
        factors : mapping
            Factor on each bolt's patch; 0 where removed.
        drift : Drift
            How this job differs from the others besides.
        frequencies : (f,) array
            Lines [Hz].

        Returns
        -------
        (f, r) complex array
            [Pa/N]
        """
        plate, modes = self.plate_modes(factors, np.array(self.design.hammer) + self.perturbations.hammer + drift.hammer)
        air = self.cavity.responding_to(self.plate.coupling.T @ modes)
        # Of the air, only the stiffness int grad p . grad q / rho knows the temperature: rho c^2 does not depend on it.
        air = replace(air, eigenvalues=air.eigenvalues * drift.warming)
        alpha, beta = self.design.acoustic_damping
        damping = alpha * self.perturbations.alpha_acoustic, beta * self.perturbations.beta_acoustic
        return pressure_frfs(plate, air, *damping, frequencies) * drift.gains(list(self.design.microphones))
