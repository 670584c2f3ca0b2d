"""Cheap estimate of the error of y over the whole band: product of sketched primal and dual residuals."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.reduction.problem.basis import Projection
from lrbc_cli.reduction.problem.norms import ROUNDING, SILENT, local_responses
from lrbc_cli.reduction.problem.problem import Problem
from lrbc_cli.reduction.problem.vectors import certificate_vectors
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.reduced.sweep import ReducedSolver
from lrbc_cli.reduction.steps.grid import Grid
from lrbc_cli.reduction.threads import in_chunks

#: Lines of the grid; fewer where each costs more, by the number of terms.
GRID_LINES = 120


@dataclass(frozen=True)
class Sweep:
    """What one pass of the reduced system over the band gives.

    Attributes
    ----------
    estimate : (count,) float array
        Estimated relative error of y, worst over a few parameter vectors.
    ports : PortFrf
        Of the reduced model at the grid.
    spread : list of (r_f, r_f) float arrays
        Sum of x xᵀ over all normalised solutions, primal and dual, real and imaginary parts, of each field: how they fill the basis.
    """

    estimate: Floats
    ports: PortFrf
    spread: list[Floats]


class Estimator:
    """Residual estimate on a grid of lines.

    The error of a response is ``z_lᵀ R u``, with R the residual of the reduced solutions for all inputs, u the inputs that a parameter
    vector makes (auxiliary ones included), and z_l the dual solution; by Galerkin orthogonality only the error of the dual counts, so that
    |e_l| is about |R_dual| |R u| in rows scaled by the diagonals of M and K. Residuals enter through a random sketch, so that they do
    not drown in round-off as in the expanded normal form (Balabanov and Nouy 2019).

    Parameters
    ----------
    problem : Problem

    Attributes
    ----------
    grid : Grid
    vectors : list of (F, nt) complex arrays
        Dynamic values of the terms for which the error is estimated.
    local : (R,) float array
        From ``local_responses``.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        low, high = problem.options.band_hz
        model = problem.model
        count = int(np.clip(GRID_LINES * (100 / max(model.terms.size, 1)) ** 1.25, 16, GRID_LINES))
        count = max(count, 3 * problem.options.held_out)
        self.grid = Grid(low, high, count)
        s = 2j * np.pi * self.grid.lines_hz
        chosen = certificate_vectors(model.terms, problem.scale, s, count=1 if problem.many else 2)
        kinds = ("free", "clamped", "random") if problem.many else ("free", "loose", "local", "clamped", "random")
        self.vectors = [D for kind in kinds for D in chosen[kind]]
        self.local = local_responses(model, complex(s[count // 2]), problem.input_of)
        self._acoustic_response = np.asarray(abs(problem.dual).T @ model.is_acoustic.astype(float)) > 0

    def sweep(self, basis: Projection) -> Sweep:
        """Solve the reduced system over the band: estimated error, port FRFs, and how its solutions fill the basis."""
        problem = self._problem
        s = 2j * np.pi * self.grid.lines_hz
        symmetric = problem.Z.symmetric
        solver = ReducedSolver(basis.operators, problem.structure_of(basis), basis.inputs, basis.dual, symmetric=symmetric)
        turn = solver.turn
        SK, SC, SM = (basis.sketched(i) @ turn for i in range(3))
        TK, TC, TM = (SK, SC, SM) if symmetric else tuple(basis.sketched(i, transposed=True) @ turn for i in range(3))
        L, theta_B, theta_dual = basis.outputs @ turn, basis.sketched_inputs, basis.sketched_dual
        kappa = problem.Z.coupling.kappa
        R, n_in = problem.responses, problem.loads
        H = np.empty((s.size, L.shape[0], theta_B.shape[1]), dtype=complex)
        estimate = np.zeros(s.size)
        ends = np.cumsum([0, *basis.sizes])
        spreads: dict[int, list[Floats]] = {}

        def work(part: slice) -> None:
            z = s[part, None, None]
            X, Y = solver.solve(s[part])
            H[part] = _times(L, X)
            # Rows of the acoustic field scaled as in the symmetrised system, by |l| = 1/|kappa s²|.
            weight = _row_weight(s[part], basis, kappa)[:, :, None]
            rest = weight * (theta_dual - (z**2 * _times(TM, Y) + z * _times(TC, Y) + _times(TK, Y)))
            dual_norm = np.linalg.norm(rest, axis=1)
            if kappa is not None:
                dual_norm = dual_norm * np.where(self._acoustic_response[None, :], np.abs(kappa * s[part, None] ** 2), 1.0)
            dual_norm = dual_norm[:, problem.dual_of[:R]]
            ports = problem.ports(H[part], s[part])
            driven = [ports.drive(D[part]) for D in self.vectors]
            # What drives the system for every input and vector: the input itself and what the terms add.
            unit = np.broadcast_to(np.eye(n_in, dtype=complex), (part.stop - part.start, n_in, n_in))
            u = np.concatenate([np.concatenate([unit, aux], axis=1) for _, aux in driven], axis=2)
            x = X @ u
            residual = np.linalg.norm(weight * (_times(theta_B, u) - (z**2 * _times(SM, x) + z * _times(SC, x) + _times(SK, x))), axis=1)
            size = np.abs(s[part, None] ** problem.model.output_power[None, :])
            for at, (y, _) in enumerate(driven):
                of_vector = residual[:, at * n_in : (at + 1) * n_in]
                estimate[part] = np.maximum(estimate[part], self._relative(of_vector, dual_norm * size, y, ports.H00))
            both = np.concatenate([X, Y], axis=2)
            spreads[part.start] = [_spread(_times(turn[low:high, low:high], both[:, low:high])) for low, high in itertools.pairwise(ends)]

        in_chunks(s.size, work, chunk=solver.chunk(s.size))
        # In the order of the lines, whichever thread came first: sums must not depend on it.
        spread = [np.sum(parts, axis=0) for parts in zip(*(spreads[at] for at in sorted(spreads)), strict=True)]
        return Sweep(estimate, problem.ports(H, s), spread)

    def _relative(self, residual: Floats, dual: Floats, y: Complexes, reference: Complexes) -> Floats:
        """(F,) estimated relative error for one parameter vector, the worst over inputs and quantities."""
        worst = np.zeros(y.shape[0])
        for column in range(residual.shape[1]):
            mine = self._problem.input_of == column
            for group in self._problem.quantities:
                rows = group[mine[group]]
                if rows.size:
                    error = residual[:, column] * np.linalg.norm(dual[:, rows], axis=1)
                    # What is silent counts as the certificate counts it.
                    floor = max(ROUNDING * float(np.linalg.norm(self.local[rows])), np.finfo(float).tiny)
                    silent = np.maximum(SILENT * np.linalg.norm(reference[:, rows], axis=1), floor)
                    worst = np.maximum(worst, error / np.maximum(np.linalg.norm(y[:, rows], axis=1), silent))
        return worst


def _row_weight(s: Complexes, basis: Projection, kappa: float | None) -> Floats:
    """(F, sketch rows) square root of |l| of each field's rows."""
    weight = np.ones((s.size, basis.rows * len(basis.fields)))
    if kappa is not None:
        weight[:, basis.rows :] = (1.0 / np.sqrt(np.abs(kappa * s**2)))[:, None]
    return weight


def _spread(X: Complexes) -> Floats:
    """Sum of Re(x xᴴ) over the normalised columns of a stack."""
    rows = X.transpose(1, 0, 2).reshape(X.shape[1], -1)
    norm = np.linalg.norm(rows, axis=0)
    rows = rows / np.where(norm > 0, norm, 1.0)
    return np.asarray(rows.real @ rows.real.T + rows.imag @ rows.imag.T)


def _times(A: Any, X: Complexes) -> Complexes:
    """A X for a stack of X; one real product of two, where A is real, instead of many complex ones."""
    if np.iscomplexobj(A):
        return np.asarray(A @ X)
    F, r, k = X.shape
    flat = X.transpose(1, 0, 2).reshape(r, -1)
    out = (A @ flat.real) + 1j * (A @ flat.imag)
    return np.asarray(out.reshape(A.shape[0], F, k).transpose(1, 0, 2))


#: By how much an estimate may prove too large.
LEAST_EFFECTIVITY = 0.1


class Effectivity:
    """Measured over estimated error at lines that were solved: how far the estimate is believed.

    Points of very many terms are so costly that an estimate that proves too large is believed less.
    """

    def __init__(self, many: bool) -> None:
        self.value, self._least, self._known = 1.0, LEAST_EFFECTIVITY if many else 1.0, not many

    def see(self, error: float, expected: float) -> None:
        """Take a measured and an estimated error."""
        if expected > 0:
            seen = float(np.clip(error / expected, self._least, 10.0))
            self.value = max(self.value, seen) if self._known else seen
            self._known = True
