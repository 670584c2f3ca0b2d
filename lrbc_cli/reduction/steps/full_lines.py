"""Full-order solves at single lines for the reduction: exact port FRFs and snapshots, two lines at a time if cores and memory allow."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.reduction.problem.problem import Problem, distinct_columns
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.solve.dynamic import Analysis, DynamicStiffness, Factorisation, columns_at_once
from lrbc_cli.reduction.threads import cores

#: Factors of more bytes than this are computed one at a time, and released early.
SIDE_BY_SIDE_BYTES = 400e6

#: Number of random combinations that replace very many term inputs, see ``Problem.many``.
COMBINATIONS = 96

#: A second moment is computed if a factorisation costs more than this many blocks of solves.
MOMENT_PAYS = 4.0

#: Time per operation of a solve over that of a factorisation, which works on dense blocks; measured with both sparse solvers.
SOLVE_EFFORT = 5.0


@dataclass(frozen=True, kw_only=True)
class FullLine:
    """One solved line of the full model; its factorisation is valid until the next lines are solved.

    Attributes
    ----------
    frequency_hz : float
    factorisation : Factorisation
    X : (n, m) complex array or None
        Solutions for all inputs, if they were computed.
    exact : PortFrf or None
        Exact port FRFs at this line, if it was solved for all inputs or all outputs.
    snapshots : tuple of (n, k) complex arrays or None
        Solutions that extend the basis; None before ``FullLines.expanded``.
    order : int
        Number of moments in the snapshots.
    """

    frequency_hz: float
    factorisation: Factorisation
    X: Complexes | None
    exact: PortFrf | None
    snapshots: tuple[Complexes, ...] | None = None
    order: int = 0


def _trim() -> None:
    """Return freed memory to the system before large factors are allocated; only the GNU C library keeps it and has this call."""
    with suppress(OSError, TypeError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def _by_columns(solve: Callable[[Complexes], Complexes], slope: sp.csr_array, X: Complexes) -> Complexes:
    """Solve for ``slope @ X`` in blocks of columns, without storing the whole product."""
    found = np.empty(X.shape, dtype=complex)
    step = columns_at_once(X.shape[0])
    for at in range(0, X.shape[1], step):
        found[:, at : at + step] = solve(slope @ X[:, at : at + step])
    return found


class FullLines:
    """Factorises and solves lines of the full model; ``close`` must be called at the end.

    Parameters
    ----------
    problem : Problem
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._stations = [problem.Z]
        self._heard, self._heard_of = distinct_columns(problem.outputs.T.tocsc())
        self._one_solve: float | None = None
        self._pools: list[ThreadPoolExecutor] = []
        self._spanned = False

    @cached_property
    def combinations(self) -> Complexes | Floats:
        """(n, k) loads, and random combinations of the term inputs, weighted by the square root of their local values."""
        inputs, loads, scale = self._problem.inputs, self._problem.loads, self._problem.scale
        mix = np.random.default_rng(20180405).normal(size=(scale.size, COMBINATIONS)) * np.sqrt(scale)[:, None]
        return np.hstack([inputs[:, :loads].toarray(), inputs[:, loads:] @ mix])

    @property
    def width(self) -> int:
        """Number of lines solved at a time: one, or two with SuperLU on several cores once a first factorisation has proved small."""
        Z = self._stations[0]
        alone = Z.backend != "superlu" or not Z.factor_seconds or cores() < 2 or self._large(Z)
        return 1 if alone else 2

    @property
    def factor_seconds(self) -> float:
        """Time of the shortest factorisation [s]; the first one includes the analysis, and parallel ones slow each other down."""
        return min(seconds for Z in self._stations for seconds in Z.factor_seconds)

    @property
    def line_seconds(self) -> float:
        """Time of one line of the full model [s]: factorisation on the analysed pattern, one solve, one refinement step."""
        return self.factor_seconds + (self._one_solve or 0.0)

    def solve(self, frequencies_hz: Sequence[float], *, expand: bool = False) -> list[FullLine]:
        """Factorise at some lines, at most ``width`` of them, and solve for all inputs (or outputs, if fewer).

        With ``Problem.many`` only the first line is solved for all inputs; later ones have a factorisation only.

        Parameters
        ----------
        frequencies_hz : sequence of float
        expand : bool
            Compute the snapshots as well.

        Raises
        ------
        NumericalError
            If a factorisation fails.
        """
        while len(self._stations) < len(frequencies_hz):
            self._stations.append(self._stations[0].twin())
        # SciPy keeps SuperLU's memory by thread, and what another thread releases is lost: each dynamic stiffness has its own thread.
        while len(self._pools) < len(self._stations):
            self._pools.append(ThreadPoolExecutor(1))
        work = zip(self._pools, self._stations, frequencies_hz, strict=False)
        tasks = [pool.submit(self._line, Z, frequency, expand) for pool, Z, frequency in work]
        return [task.result() for task in tasks]

    def close(self) -> None:
        """End the threads; after an interrupt the interpreter would otherwise wait for one that was just starting."""
        for pool in self._pools:
            pool.shutdown(wait=False, cancel_futures=True)

    def _line(self, Z: DynamicStiffness, frequency_hz: float, expand: bool) -> FullLine:
        problem, s = self._problem, 2j * np.pi * frequency_hz
        if self._large(Z):
            _trim()
        factorisation = Z.factor(s)
        if self._one_solve is None:
            load, times = problem.inputs[:, [0]].toarray()[:, 0], []
            for _ in range(3):
                start = time.perf_counter()
                factorisation.solve(load, refine=1)
                times.append(time.perf_counter() - start)
            self._one_solve = min(times)
        if problem.many and (self._spanned or not expand):
            line = FullLine(frequency_hz=frequency_hz, factorisation=factorisation, X=None, exact=None)
        elif not expand and self._heard.shape[1] < problem.inputs.shape[1]:
            # More inputs than distinct outputs: transposed solves are fewer.
            H = np.asarray(problem.inputs.T @ factorisation.solve_transposed(self._heard)).T[self._heard_of]
            line = FullLine(frequency_hz=frequency_hz, factorisation=factorisation, X=None, exact=self._ports(s, H))
        else:
            X = factorisation.solve(problem.inputs)
            self._spanned = True
            line = FullLine(
                frequency_hz=frequency_hz, factorisation=factorisation, X=X, exact=self._ports(s, np.asarray(problem.outputs @ X))
            )
        return self.expanded(line) if expand else line

    def _ports(self, s: complex, H: Complexes) -> PortFrf:
        return self._problem.ports(H[None], np.array([s]))

    def release(self, line: FullLine) -> None:
        """Release large factors; no further solve is possible at this line."""
        Z = line.factorisation.owner
        if self._large(Z):
            Z.release()

    @staticmethod
    def _large(Z: DynamicStiffness) -> bool:
        return 16 * Z.nonzeros > SIDE_BY_SIDE_BYTES

    def expanded(self, line: FullLine) -> FullLine:
        """The line with snapshots: moments of the inputs and of the dual right-hand sides."""
        if line.snapshots is not None:
            return line
        s, factorisation = 2j * np.pi * line.frequency_hz, line.factorisation
        problem = self._problem
        primal = factorisation.solve(self.combinations if problem.many else problem.inputs) if line.X is None else line.X
        blocks = [primal, factorisation.solve_transposed(problem.dual)]
        if self.order > 1:
            # Second moment, X1 = -Z⁻¹ (2 s M + C) X0; the sign does not matter for the span.
            Z = factorisation.owner
            slope = (2 * s * Z.M + Z.C).tocsr()
            blocks += [_by_columns(factorisation.solve, slope, blocks[0]), _by_columns(factorisation.solve_transposed, slope.T, blocks[1])]
        return FullLine(
            frequency_hz=line.frequency_hz,
            factorisation=factorisation,
            X=line.X,
            exact=line.exact,
            snapshots=tuple(blocks),
            order=self.order,
        )

    @cached_property
    def order(self) -> int:
        """Moments computed at each expansion point, see ``moments_worth``."""
        return moments_worth(self._problem, self._problem.Z.analyse())


def moments_worth(problem: Problem, analysis: Analysis) -> int:
    """Moments to compute at each expansion point: two if a factorisation costs far more than a block of solves, else one.

    Operations are counted, not timed, so that a model has the same basis on every machine.
    """
    # Complex multiplications and additions. LU factorises two triangles, LDLᵀ one; both solve with two.
    factor = analysis.operations * (1 if problem.Z.half else 2)
    block = 2 * analysis.triangle * (problem.inputs.shape[1] + problem.dual.shape[1])
    return 2 if factor > MOMENT_PAYS * SOLVE_EFFORT * block else 1
