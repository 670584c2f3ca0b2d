"""Conversion of exported matrices and vectors from the unit system of the FE program to SI."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.model.coupling import coupling_of
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, DofLabels
from lrbc_cli.model.units import UnitSystem

#: Power of time by which the unit of each operator exceeds that of stiffness.
_TIME = {"stiffness": 0, "damping": 1, "mass": 2}

#: Tolerance on kappa = 1, which identifies acoustic equations divided by the density (both coupling blocks are then equal up to the sign).
_EQUAL = 1e-6


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """SI values of the unit of each DOF and of the unit of its equation.

    Attributes
    ----------
    unit : UnitSystem
    turns : (n,) bool array
        Which DOFs are rotations.
    motion : (n,) float array
        Unit of the DOF: displacement, rotation or pressure.
    source : (n,) float array
        Unit of the right-hand side: force, moment, or the source term of an acoustic equation.
    """

    unit: UnitSystem
    turns: Bools
    motion: Floats
    source: Floats

    def matrix(self, matrix: sp.csc_array, operator: str) -> sp.csc_array:
        """Convert a stiffness, damping or mass matrix (``operator``) to SI."""
        column = np.repeat(1.0 / self.motion, np.diff(matrix.indptr))
        data = matrix.data * (self.source[matrix.indices] * column * self.unit.time ** _TIME[operator])
        return sp.csc_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)

    def vectors(self, vectors: sp.csc_array) -> sp.csc_array:
        """Convert columns to SI: entries on rotations are lengths in a column that also has other DOFs; all other entries are numbers."""
        column = np.repeat(np.arange(vectors.shape[1]), np.diff(vectors.indptr))
        moved = np.bincount(column, weights=~self.turns[vectors.indices], minlength=vectors.shape[1]) > 0
        factor = np.where(self.turns[vectors.indices] & moved[column], self.unit.length, 1.0)
        return sp.csc_array((vectors.data * factor, vectors.indices, vectors.indptr), shape=vectors.shape)


def scaling(unit: UnitSystem, labels: DofLabels, K: sp.csc_array, M: sp.csc_array) -> Scaling:
    """The scaling of a model given in a unit system.

    Parameters
    ----------
    unit : UnitSystem
    labels : DofLabels
    K, M : (n, n) csc_array
        As exported; their coupling blocks show whether the acoustic equations are divided by the density, which changes their unit.
    """
    acoustic, turns = labels.component == ACOUSTIC_COMPONENT, np.char.startswith(labels.component, "ROT")
    kappa = None
    if acoustic.any() and not acoustic.all():
        kappa = coupling_of(K, sp.csc_array(K.shape), M, acoustic).kappa
    pressure = unit.force / unit.length**2
    # Divided by the density: volume accelerations. Else pressure times length, the unit of the integral of grad p over a surface.
    source = unit.length**3 / unit.time**2 if kappa is not None and abs(kappa - 1.0) < _EQUAL else pressure * unit.length
    return Scaling(
        unit=unit,
        turns=np.asarray(turns),
        motion=np.where(acoustic, pressure, np.where(turns, 1.0, unit.length)),
        source=np.where(acoustic, source, np.where(turns, unit.force * unit.length, unit.force)),
    )
