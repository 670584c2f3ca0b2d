"""Solves the reduced system at its reference values for all inputs and dual right-hand sides at many lines."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg as la

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.reduction.reduced.condense import CondensedAir, air_is_diagonal, air_modes, turned


class ReducedSolver:
    """Solves ``Z(s) X = B`` and ``Z(s)ᵀ Y = Lᵀ``, if possible in coordinates in which the acoustic blocks are diagonal.

    Parameters
    ----------
    operators : three (r, r) arrays
        Projected K, C, M.
    structure : int
        Number of structural coordinates, the first ones.
    inputs : (r, m) float array
        B.
    dual : (r, q) float array
        Lᵀ.
    symmetric : bool
        Solve the dual problem with Z instead of Zᵀ, which differs by scaling of the acoustic rows only.

    Attributes
    ----------
    turn : (r, r) float array
        Maps the coordinates of the solutions to those of the basis.
    air : CondensedAir or None
        None if the acoustic blocks cannot be made diagonal, or without air.
    """

    def __init__(self, operators: tuple[Any, Any, Any], structure: int, inputs: Floats, dual: Floats, *, symmetric: bool) -> None:
        self.structure, self.symmetric, self.columns = structure, symmetric, inputs.shape[1]
        size = operators[0].shape[0]
        self.turn: Floats = np.eye(size)
        self._none = np.zeros((size, 0))
        modes = None if np.iscomplexobj(operators[1]) or structure == 0 else air_modes(operators[0], operators[2], structure)
        if modes is not None:
            K, C, M = (turned(A, modes, structure) for A in operators)
            if air_is_diagonal(K, C, M, structure, self._none, self._none):
                self.turn, operators = la.block_diag(np.eye(structure), modes), (K, C, M)
            else:
                modes = None
        self._operators = operators
        self.air = None if modes is None else CondensedAir(operators, (self._none, self._none), structure)
        self.inputs, self.dual = self.turn.T @ inputs, self.turn.T @ dual

    def solve(self, s: Complexes) -> tuple[Complexes, Complexes]:
        """(F, r, m) and (F, r, q) solutions X and Y at the lines s; ``turn`` maps them to the coordinates of the basis."""
        z, m = s[:, None, None], self.columns
        both = np.hstack([self.inputs, self.dual])
        if self.air is not None:
            loads, outputs = (both, self._none) if self.symmetric else (self.inputs, self.dual)
            x, y = self.air.solve(z, np.zeros((s.size, 0), dtype=complex), loads, outputs)
            return (x[:, :, :m], x[:, :, m:]) if self.symmetric else (x, y)
        K, C, M = self._operators
        Z = z**2 * M + z * C + K
        if self.symmetric:
            x = np.linalg.solve(Z, both.astype(complex)[None])
            return x[:, :, :m], x[:, :, m:]
        return np.linalg.solve(Z, self.inputs.astype(complex)[None]), np.linalg.solve(Z.transpose(0, 2, 1), self.dual.astype(complex)[None])

    def chunk(self, lines: int, workers: int = 2) -> int:
        """Number of lines to solve at a time: large chunks pay with diagonal air, where all lines of a chunk share one product."""
        if self.air is None:
            return 8
        size = self.turn.shape[0]
        memory = min(int(4e6 / max(self.structure, 1) ** 2), int(8e6 / (size * (self.columns + 1))))
        return max(8, min(-(-lines // workers), memory))
