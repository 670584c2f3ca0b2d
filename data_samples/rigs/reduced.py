"""Plate and air of a design in a basis that serves all its rigs, so that a rig costs small dense matrices only.

The plate's operators are sums of fixed matrices (four bending stiffnesses, mass, bedding, one patch a bolt), and the air's are two
matrices with a factor each, so they are projected once. The basis holds plate modes with all bolts tight, all removed, and every other one
removed, static corrections for each patch, and the air's answers to them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from rigs.coupled import AirModes, factorise
from rigs.design import Array, Materials
from rigs.truth import Air, Perturbations, Plate

# Modes of each state of the bolts in the basis; how many of them get static corrections for each patch, in how many directions.
MODES_PER_STATE = 100
MODES_CORRECTED = 40
CORRECTIONS = 6
# Directions whose mass that is not in the others is below this fraction are left out.
NEAR = 1e-8


def _orthonormal(gram: Array, near: float, most: int | None = None) -> Array:
    """Combinations of vectors that are orthonormal, by their Gram matrix; the leading ones."""
    values, rotation = np.linalg.eigh(0.5 * (gram + gram.T))
    keep = np.flatnonzero(values > near * values[-1])[::-1][:most]
    return np.asarray(rotation[:, keep] / np.sqrt(values[keep]))


def _leading(vectors: Array, mass: Array, count: int) -> Array:
    """The leading directions of some vectors, mass-orthonormal."""
    return np.asarray(vectors @ _orthonormal(vectors.T @ (mass @ vectors), 1e-10, count))


class ReducedPlate:
    """``truth.Plate`` in the basis.

    Parameters
    ----------
    full : Plate
    vectors : (n, m) array
        Mass-orthonormal.
    coupling : (m, k) array
        With the vectors of the reduced air.
    """

    def __init__(self, full: Plate, vectors: Array, coupling: Array) -> None:
        self.design, self._full, self._vectors, self.coupling = full.design, full, vectors, coupling
        self._bending = [self._project(full.elastic(tuple(row))) for row in np.eye(4)]
        self._mass = self._project(full.mass(1.0))
        self._bedding = self._project(full.weighted(full.bedding))
        self._patches = {name: self._project(full.weighted(full.patch(name))) for name in full.design.bolts}

    def _project(self, matrix: Array) -> Array:
        projected = self._vectors.T @ (matrix @ self._vectors)
        return np.asarray(0.5 * (projected + projected.T))

    def elastic(self, bending: tuple[float, float, float, float]) -> Array:
        """Stiffness of the plate itself for Dx, Dy, D1, Dxy."""
        return np.asarray(sum(value * part for value, part in zip(bending, self._bending, strict=True)))

    def mass(self, surface_mass: float) -> Array:
        """Mass of the plate [kg/m2]."""
        return self._mass * surface_mass

    def load(self, point: Array) -> Array:
        """Deflection at a point."""
        return np.asarray(self._full.load(point) @ self._vectors)

    def foundation(self, factors: Mapping[str, float]) -> Array:
        """Stiffness of the foundation, the patch of each bolt by its factor."""
        tight = self.design.foundation.tight
        return np.asarray(self._bedding + sum(tight * factor * self._patches[name] for name, factor in factors.items()))

    def friction(self, removed: list[str]) -> Array:
        """Viscous damping where bolts are removed."""
        return np.asarray(self.design.foundation.patch_damping * sum(self._patches[name] for name in removed))

    @staticmethod
    def modes(stiffness: Array, mass: Array, count: int) -> tuple[Array, Array]:
        """Lowest eigenvalues and mass-normalised modes."""
        values, modes = sl.eigh(stiffness, mass, subset_by_index=(0, count - 1))
        return values, modes


@dataclass(frozen=True)
class ReducedCavity:
    """``coupled.Cavity`` in the basis.

    Attributes
    ----------
    eigenvalues : (k,) array
    observed : (r, k) array
        Pressures at the microphones.
    scale : float
        Factor that normalises the basis to this rig's air.
    """

    eigenvalues: Array
    observed: Array
    scale: float

    def responding_to(self, loads: Array) -> AirModes:
        """Modes, with the `loads` (k, m) of some plate modes on the basis."""
        return AirModes(self.eigenvalues, self.scale * loads.T, self.scale * self.observed)


class ReducedAir:
    """``truth.Air`` in the basis.

    Parameters
    ----------
    full : Air
    materials : Materials
        Of the air that the basis belongs to.
    eigenvalues : (k,) array
    vectors : (n, k) array
        Mass-orthonormal, and orthogonal in the stiffness.
    """

    def __init__(self, full: Air, materials: Materials, eigenvalues: Array, vectors: Array) -> None:
        self._full, self._materials, self._eigenvalues, self._vectors = full, materials, eigenvalues, vectors

    def cavity(self, materials: Materials, microphones: Array) -> ReducedCavity:
        """The cavity of one rig: the same modes, as stiffness and mass only change by a factor."""
        mass = materials.compliance / self._materials.compliance
        stiffness = self._materials.air_density / materials.air_density
        observed = np.asarray(self._full.at(microphones) @ self._vectors)
        return ReducedCavity(self._eigenvalues * stiffness / mass, observed, 1 / np.sqrt(mass))


class Basis:
    """Builds the basis of a design.

    Parameters
    ----------
    plate : Plate
    air : Air

    Attributes
    ----------
    plate : ReducedPlate
    air : ReducedAir
    """

    def __init__(self, plate: Plate, air: Air) -> None:
        design = plate.design
        materials = Perturbations.none(design).materials(design)
        elastic, mass = plate.elastic(materials.bending), plate.mass(materials.surface_mass)
        names = list(design.bolts)
        blocks = []
        for tight in (names, [], names[::2], names[1::2]):
            stiffness = elastic + plate.foundation(dict.fromkeys(tight, 1.0))
            modes = plate.modes(stiffness, mass, MODES_PER_STATE)[1]
            blocks.append(modes)
            if len(tight) in (0, len(names)):
                # How each patch changes the modes, statically.
                solve = factorise(sp.csr_array(stiffness))
                for name in names:
                    loads = plate.weighted(plate.patch(name)) @ modes[:, :MODES_CORRECTED]
                    blocks.append(_leading(solve(loads), mass, CORRECTIONS))
        vectors = np.hstack(blocks)
        vectors = vectors @ _orthonormal(vectors.T @ (mass @ vectors), NEAR)
        cavity = air.cavity(materials, np.array(list(design.microphones.values())))
        loads = plate.coupling.T @ vectors
        eigenvalues, pressures = cavity.ritz(loads)
        self.plate = ReducedPlate(plate, vectors, loads.T @ pressures)
        self.air = ReducedAir(air, materials, eigenvalues, pressures)
