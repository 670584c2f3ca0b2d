"""What turns the rows of matrices and vectors into SI."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.model.coupling import coupling_of
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, DofLabels
from lrbc_cli.model.units import UnitSystem

#: Power of time in the unit of each operator.
_TIME = {"stiffness": 0, "damping": 1, "mass": 2}

#: What tells acoustic equations divided by the density, whose coupling blocks are equal, from others.
_EQUAL = 1e-6


@dataclass(frozen=True)
class Scaling:
    """Units of the degree of freedom and of the equation of each row, in SI.

    Attributes
    ----------
    unit : UnitSystem
    turns : (n,) bool array
        Rotations.
    motion : (n,) float array
        Displacement, rotation or pressure.
    source : (n,) float array
        Force, moment, or what belongs to a pressure.
    """

    unit: UnitSystem
    turns: Bools
    motion: Floats
    source: Floats

    def matrix(self, matrix: sp.csc_array, operator: str) -> sp.csc_array:
        """A stiffness, damping or mass matrix in SI."""
        column = np.repeat(1.0 / self.motion, np.diff(matrix.indptr))
        data = matrix.data * (self.source[matrix.indices] * column * self.unit.time ** _TIME[operator])
        return sp.csc_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)

    def vectors(self, vectors: sp.csc_array) -> sp.csc_array:
        """Columns in SI: of plain numbers where nodes move and lengths where they turn; of plain numbers where they only turn."""
        column = np.repeat(np.arange(vectors.shape[1]), np.diff(vectors.indptr))
        moved = np.bincount(column, weights=~self.turns[vectors.indices], minlength=vectors.shape[1]) > 0
        factor = np.where(self.turns[vectors.indices] & moved[column], self.unit.length, 1.0)
        return sp.csc_array((vectors.data * factor, vectors.indices, vectors.indptr), shape=vectors.shape)


def scaling(unit: UnitSystem, labels: DofLabels, K: sp.csc_array, M: sp.csc_array) -> Scaling:
    """From the units of length, force, mass and time; acoustic equations may be divided by the density.

    Parameters
    ----------
    unit : UnitSystem
    labels : DofLabels
    K, M : (n, n) csc_array
        As exported.
    """
    acoustic, turns = labels.component == ACOUSTIC_COMPONENT, np.char.startswith(labels.component, "ROT")
    kappa = None
    if acoustic.any() and not acoustic.all():
        kappa = coupling_of(K, sp.csc_array(K.shape), M, acoustic).kappa
    pressure = unit.force / unit.length**2
    # Volume accelerations; else pressure times length, as the integral of grad p over the volume is.
    source = unit.length**3 / unit.time**2 if kappa is not None and abs(kappa - 1.0) < _EQUAL else pressure * unit.length
    return Scaling(
        unit=unit,
        turns=np.asarray(turns),
        motion=np.where(acoustic, pressure, np.where(turns, 1.0, unit.length)),
        source=np.where(acoustic, source, np.where(turns, unit.force * unit.length, unit.force)),
    )
