"""Lines of the full model: factorised, solved for all ports, side by side where cores and memory allow."""

from __future__ import annotations

import ctypes
import os
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

#: Factors above this size are made one at a time.
SIDE_BY_SIDE_BYTES = 400e6

#: Random combinations that stand for very many inputs, see ``Problem.many``.
COMBINATIONS = 96

#: A second moment pays where a factorisation costs more than this many blocks of solves.
MOMENT_PAYS = 4.0

#: Time of an operation of a solve over that of an operation of a factorisation, which works on dense blocks: measured with both back ends.
SOLVE_EFFORT = 5.0


@dataclass(frozen=True, kw_only=True)
class FullLine:
    """One line of the full model; its factorisation is valid until the next lines are solved.

    Attributes
    ----------
    frequency_hz : float
    factorisation : Factorisation
    X : (n, m) complex array or None
        Solutions for all inputs, where those were solved for.
    exact : PortFrf or None
        At this line, where it was solved for all inputs or all outputs.
    snapshots : tuple of (n, k) complex arrays or None
        What enriches a basis, where it was asked for at once.
    order : int
        Moments in the snapshots.
    """

    frequency_hz: float
    factorisation: Factorisation
    X: Complexes | None
    exact: PortFrf | None
    snapshots: tuple[Complexes, ...] | None = None
    order: int = 0


def _trim() -> None:
    """Hand freed memory back to the system before factors take as much again; only the C library of GNU keeps it, and can."""
    with suppress(OSError, TypeError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def _by_columns(solve: Callable[[Complexes], Complexes], slope: sp.csr_array, X: Complexes) -> Complexes:
    """Solve for ``slope @ X`` without holding all of it."""
    found = np.empty(X.shape, dtype=complex)
    step = columns_at_once(X.shape[0])
    for at in range(0, X.shape[1], step):
        found[:, at : at + step] = solve(slope @ X[:, at : at + step])
    return found


class FullLines:
    """Solves lines of the full model.

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
        """(n, k) the loads and random combinations of the term inputs, each term weighted with its local stiffness."""
        inputs, loads, scale = self._problem.inputs, self._problem.loads, self._problem.scale
        mix = np.random.default_rng(20180405).normal(size=(scale.size, COMBINATIONS)) * np.sqrt(scale)[:, None]
        return np.hstack([inputs[:, :loads].toarray(), inputs[:, loads:] @ mix])

    @property
    def width(self) -> int:
        """How many lines are solved at a time: one until a first factorisation has shown its size, and where it has threads of its own."""
        Z = self._stations[0]
        alone = Z.backend != "superlu" or not Z.factor_seconds or cores() < 2 or self._large(Z)
        return 1 if alone else 2

    @property
    def factor_seconds(self) -> float:
        """Shortest factorisation: the first one analyses, and those side by side share the machine."""
        return min(seconds for Z in self._stations for seconds in Z.factor_seconds)

    @property
    def line_seconds(self) -> float:
        """What one line of the full model costs: a factorisation on the analysed pattern, one solve, one refinement step."""
        return self.factor_seconds + (self._one_solve or 0.0)

    def solve(self, frequencies_hz: Sequence[float], *, expand: bool = False) -> list[FullLine]:
        """Factorise at some lines, at most ``width``, and solve for all inputs.

        Parameters
        ----------
        frequencies_hz : sequence of float
        expand : bool
            Take the snapshots at once.

        Raises
        ------
        NumericalError
            Where a factorisation fails.
        """
        while len(self._stations) < len(frequencies_hz):
            self._stations.append(self._stations[0].twin())
        # SciPy keeps SuperLU's memory by thread: factors that another thread releases are lost, so each station has one of its own.
        while len(self._pools) < len(self._stations):
            self._pools.append(ThreadPoolExecutor(1))
        work = zip(self._pools, self._stations, frequencies_hz, strict=False)
        tasks = [pool.submit(self._line, Z, frequency, expand) for pool, Z, frequency in work]
        return [task.result() for task in tasks]

    def close(self) -> None:
        """End the threads, also one that an interrupt met in its start and that the interpreter would wait for."""
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
            # More hammer points than responses: the port FRFs take fewer solves from the other side.
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
        """Give the memory of large factors back; the line cannot be solved again."""
        Z = line.factorisation.owner
        if self._large(Z):
            Z.release()

    @staticmethod
    def _large(Z: DynamicStiffness) -> bool:
        return 16 * Z.nonzeros > SIDE_BY_SIDE_BYTES

    def expanded(self, line: FullLine) -> FullLine:
        """The same with its snapshots: the moments of the inputs and of the duals."""
        if line.snapshots is not None:
            return line
        s, factorisation = 2j * np.pi * line.frequency_hz, line.factorisation
        problem = self._problem
        primal = factorisation.solve(self.combinations if problem.many else problem.inputs) if line.X is None else line.X
        blocks = [primal, factorisation.solve_transposed(problem.dual)]
        if self.order > 1:
            # Second moment, X1 = -Z⁻¹ (2 s M + C) X0; the sign spans nothing.
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
        """Moments an expansion point, see ``moments_worth``."""
        return moments_worth(self._problem, self._problem.Z.analyse())


def moments_worth(problem: Problem, analysis: Analysis) -> int:
    """Moments an expansion point: a second one pays where a factorisation costs far more than a block of solves.

    By counted operations, not by the clock: the same model gives the same basis on a busy machine.
    """
    # Both in complex multiplications and additions; LU has two triangles to fill, and both LU and LDLᵀ two to solve with.
    factor = analysis.operations * (1 if problem.Z.half else 2)
    block = 2 * analysis.triangle * (problem.inputs.shape[1] + problem.dual.shape[1])
    return 2 if factor > MOMENT_PAYS * SOLVE_EFFORT * block else 1


def cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1
