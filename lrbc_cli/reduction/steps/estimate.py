"""Estimates the error of y over the whole band from primal and dual residuals of the reduced solutions, without full solves."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.reduction.problem.basis import SKETCH, Projected
from lrbc_cli.reduction.problem.norms import ROUNDING, SILENT, local_responses
from lrbc_cli.reduction.problem.problem import Problem
from lrbc_cli.reduction.problem.resonant import resonant_vectors
from lrbc_cli.reduction.problem.vectors import certificate_vectors
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.reduced.sweep import ReducedSolver
from lrbc_cli.reduction.steps.grid import Grid
from lrbc_cli.reduction.threads import in_chunks

#: Number of resonant states for which the error is estimated at each line.
RESONANCES = 2

#: Largest number of lines of the grid; fewer with more than 100 terms, where each line costs more.
GRID_LINES = 120


def grid_lines(terms: int, held_out: int) -> int:
    """Number of lines of the grid by the numbers of terms and of held-out lines."""
    return max(int(np.clip(GRID_LINES * (100 / max(terms, 1)) ** 1.25, 16, GRID_LINES)), 3 * held_out)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Result of one pass of the reduced system over F lines of the band.

    Attributes
    ----------
    estimate : (F,) float array
        Estimated relative error of y, the largest over a few parameter vectors.
    rounding : (F,) float array
        Estimated rounding error, of the full solution as of the reduced one; no larger basis lowers it.
    ports : PortFrf
        Of the reduced model at the lines.
    vectors : list of (F, nt) complex arrays
        Dynamic values of the terms for which the error was estimated.
    spread : list of (r_f, r_f) float arrays
        For each field the sum of x xᵀ over all normalised solutions (primal and dual, real and imaginary parts), for the compression.
    """

    estimate: Floats
    rounding: Floats
    ports: PortFrf
    vectors: list[Complexes]
    spread: list[Floats]


class Estimator:
    """Estimates the error of y on a grid of lines from residuals.

    The error of response l is ``z_lᵀ r``, with the residual r of the reduced solution and the full dual solution z_l, both for one
    parameter vector. By Galerkin orthogonality only the error of the dual solution contributes, so it is of the size of
    ``|R_dual (e_l + v_l)| |R (e + u)|`` in rows scaled by the diagonals of M and K. R and R_dual are the residuals for all inputs and
    outputs at the reference values, e and e_l unit vectors, u and v_l the amplitudes of the terms. Norms of residuals are those of a
    random sketch, which avoids the round-off of the expanded normal form (Balabanov and Nouy 2019). Rounding errors are not orthogonal to
    the basis: errors of the last digit in Z cause an error of ``eps |z_l| |x|`` in the same scale.

    Parameters
    ----------
    problem : Problem

    Attributes
    ----------
    grid : Grid
    local : (R,) float array
        From ``local_responses``.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        low, high = problem.options.band_hz
        model = problem.model
        count = grid_lines(model.terms.size, problem.options.held_out)
        self.grid = Grid(low, high, count)
        self.local = local_responses(model, 2j * np.pi * float(self.grid.lines_hz[count // 2]), problem.input_of)
        # Equal rows of one response to several hammer points count once.
        self._places = np.unique(problem.dual_of[: problem.responses], return_index=True)[1]
        acoustic = model.is_acoustic.astype(float)
        self._in_air = np.concatenate([(abs(model.L) @ acoustic)[self._places], abs(model.terms.right).T @ acoustic]) > 0

    def states(self, ports: PortFrf) -> list[Complexes]:
        """A few certificate vectors (free to clamped, random, and resonant at the lines) as (F, nt) dynamic values."""
        terms, scale, many = self._problem.model.terms, self._problem.scale, self._problem.many
        chosen = certificate_vectors(terms, scale, ports.s, count=1 if many else 2)
        kinds = ("free", "clamped", "random") if many else ("free", "loose", "local", "clamped", "random")
        return [D for kind in kinds for D in chosen[kind]] + resonant_vectors(
            ports, terms, scale, patterns=1, count=0 if many else RESONANCES
        )

    def sweep(self, basis: Projected, lines_hz: Floats | None = None, states: Callable[[PortFrf], list[Complexes]] | None = None) -> Sweep:
        """Solve the reduced system at all lines: estimated errors, port FRFs, and the shares of the basis that its solutions use.

        Parameters
        ----------
        basis : Projected
        lines_hz : (F,) float array or None
            Lines [Hz]; None: the grid.
        states : callable or None
            Maps port FRFs of some of the lines to parameter vectors; None: the method ``states``.
        """
        problem, states = self._problem, states or self.states
        s = 2j * np.pi * (self.grid.lines_hz if lines_hz is None else lines_hz)
        symmetric = problem.Z.symmetric
        solver = ReducedSolver(basis.operators, problem.structure_of(basis), basis.inputs, basis.dual, symmetric=symmetric)
        turn = solver.turn
        SK, SC, SM = (sketch @ turn for sketch in basis.sketches)
        TK, TC, TM = (SK, SC, SM) if symmetric else (sketch @ turn for sketch in basis.turned)
        L, theta_B, theta_dual = basis.outputs @ turn, basis.sketched_inputs, basis.sketched_dual
        H = np.empty((s.size, L.shape[0], theta_B.shape[1]), dtype=complex)
        estimate, rounding = np.zeros(s.size), np.zeros(s.size)
        fields = list(itertools.pairwise(np.cumsum([0, *basis.sizes])))
        parts: dict[int, tuple[list[Floats], list[Complexes]]] = {}

        def work(part: slice) -> None:
            z = s[part, None, None]
            X, Y = solver.solve(s[part])
            H[part] = _times(L, X)
            weight, of_fields = self._weights(s[part], basis)
            primal = weight * (theta_B - (z**2 * _times(SM, X) + z * _times(SC, X) + _times(SK, X)))
            dual = weight * (theta_dual - (z**2 * _times(TM, Y) + z * _times(TC, Y) + _times(TK, Y)))
            both = np.concatenate([X, Y], axis=2)
            filled = [_times(turn[low:high, low:high], both[:, low:high]) for low, high in fields]
            x, y = np.split(np.concatenate([a * b for a, b in zip(of_fields, filled, strict=True)], axis=1), [X.shape[2]], axis=2)
            pairs = (primal, self._outputs(dual, primal, s[part])), (x, self._outputs(y, x, s[part]))
            ports = problem.ports(H[part], s[part])
            vectors = states(ports)
            for D in vectors:
                missed, rounded = self._relative(ports, *pairs, D)
                estimate[part], rounding[part] = np.maximum(estimate[part], missed), np.maximum(rounding[part], rounded)
            parts[part.start] = [_spread(field) for field in filled], vectors

        in_chunks(s.size, work, chunk=solver.chunk(s.size))
        # Sum in the order of the lines, so that the result does not depend on the threads.
        spreads, vectors = zip(*(parts[at] for at in sorted(parts)), strict=True)
        return Sweep(
            estimate=estimate,
            rounding=np.finfo(float).eps * rounding,
            ports=problem.ports(H, s),
            vectors=[np.concatenate(some) for some in zip(*vectors, strict=True)],
            spread=[np.sum(some, axis=0) for some in zip(*spreads, strict=True)],
        )

    def _weights(self, s: Complexes, basis: Projected) -> tuple[Floats, list[Any]]:
        """Weights, for sketched rows and for fields, that scale the acoustic field as in the symmetrised system: 1/sqrt|kappa s²|."""
        kappa, rows = self._problem.Z.coupling.kappa, np.ones((s.size, SKETCH * len(basis.sizes), 1))
        if kappa is None:
            return rows, [1.0] * len(basis.sizes)
        of_air = (1.0 / np.sqrt(np.abs(kappa * s**2)))[:, None, None]
        rows[:, SKETCH:] = of_air
        return rows, [1.0, of_air]

    def _outputs(self, dual: Complexes, primal: Complexes, s: Complexes) -> Complexes:
        """(F, k, places + nt) columns of the distinct responses, then of the outputs of the terms, scaled as in the symmetrised system."""
        problem, kappa = self._problem, self._problem.Z.coupling.kappa
        of = problem.dual_of
        of_terms = dual[:, :, of[problem.responses :]] if of.size > problem.responses else primal[:, :, problem.loads :]
        both = np.concatenate([dual[:, :, of[self._places]], of_terms], axis=2)
        return np.asarray(both if kappa is None else both * np.where(self._in_air, -kappa * s[:, None] ** 2, 1.0)[:, None, :])

    def _relative(
        self, ports: PortFrf, residuals: tuple[Complexes, Complexes], solutions: tuple[Complexes, Complexes], D: Complexes
    ) -> tuple[Floats, Floats]:
        """(F,) estimated relative errors of y for one parameter vector: by the basis, and by rounding (in units of machine epsilon).

        Parameters
        ----------
        ports : PortFrf
        residuals, solutions : pairs of (F, k, m) complex arrays
            First for all inputs, second for the distinct responses and the outputs of the terms (dual).
        D : (F, nt) complex array
        """
        problem, places = self._problem, self._places
        n_in, of = problem.loads, problem.dual_of[: problem.responses]
        to_quantity = ports.s[:, None] ** problem.model.output_power
        y, u, v, _, _ = ports.motions(D, (ports.H0p[:, places] / to_quantity[:, places, None]).transpose(0, 2, 1))

        def heard(dual: Complexes) -> Floats:
            norm = np.linalg.norm(dual[:, :, : places.size] + dual[:, :, places.size :] @ v, axis=1)
            return np.asarray(norm[:, of] * np.abs(to_quantity))

        missed = np.linalg.norm(residuals[0][:, :, :n_in] + residuals[0][:, :, n_in:] @ u, axis=1)
        # Each input is solved separately: rounding errors do not cancel where solutions do.
        size = np.sum(np.abs(solutions[0]) ** 2, axis=1)[:, None]
        rounded = np.sqrt(size[:, 0, :n_in] + (size[:, :, n_in:] @ np.abs(u) ** 2)[:, 0])
        of_input = problem.input_of
        return self._worst(ports, y, missed[:, of_input] * heard(residuals[1])), self._worst(
            ports, y, rounded[:, of_input] * heard(solutions[1])
        )

    def _worst(self, ports: PortFrf, y: Complexes, errors: Floats) -> Floats:
        """(F,) errors of the responses relative to the norm of y, the largest over inputs and physical quantities."""
        worst = np.zeros(y.shape[0])
        for column in range(self._problem.loads):
            mine = self._problem.input_of == column
            for group in self._problem.quantities:
                rows = group[mine[group]]
                if rows.size:
                    # Lower limits of the norm as in ``relative_error``.
                    floor = max(ROUNDING * float(np.linalg.norm(self.local[rows])), np.finfo(float).tiny)
                    silent = np.maximum(SILENT * np.linalg.norm(ports.H00[:, rows], axis=1), floor)
                    size = np.maximum(np.linalg.norm(y[:, rows], axis=1), silent)
                    worst = np.maximum(worst, np.linalg.norm(errors[:, rows], axis=1) / size)
        return worst


def _spread(X: Complexes) -> Floats:
    """(r, r) sum of Re(x xᴴ) over the normalised columns x of an (F, r, k) stack."""
    rows = X.transpose(1, 0, 2).reshape(X.shape[1], -1)
    norm = np.linalg.norm(rows, axis=0)
    rows = rows / np.where(norm > 0, norm, 1.0)
    return np.asarray(rows.real @ rows.real.T + rows.imag @ rows.imag.T)


def _times(A: Any, X: Complexes) -> Complexes:
    """A X for an (F, r, k) stack X; for a real A by two large real products instead of many complex ones."""
    if np.iscomplexobj(A):
        return np.asarray(A @ X)
    F, r, k = X.shape
    flat = X.transpose(1, 0, 2).reshape(r, -1)
    out = (A @ flat.real) + 1j * (A @ flat.imag)
    return np.asarray(out.reshape(A.shape[0], F, k).transpose(1, 0, 2))


#: Smallest ``Effectivity`` with very many inputs.
LEAST_EFFECTIVITY = 0.1


class Effectivity:
    """Ratio ``value`` of measured over estimated error, by which estimates are multiplied: the largest seen so far, at least 1.

    With very many inputs, whose expansion points are costly, the first measured ratio may lower it, to ``LEAST_EFFECTIVITY`` at least.
    """

    def __init__(self, many: bool) -> None:
        self.value, self._least, self._known = 1.0, LEAST_EFFECTIVITY if many else 1.0, not many

    def see(self, error: float, expected: float) -> None:
        """Update the ratio from a measured error and the error expected by the estimate at the same line."""
        if expected > 0:
            seen = float(np.clip(error / expected, self._least, 10.0))
            self.value = max(self.value, seen) if self._known else seen
            self._known = True
