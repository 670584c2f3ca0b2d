"""Lines of the full model: factorised, solved for all ports, side by side where cores and memory allow."""

from __future__ import annotations

import ctypes
import itertools
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.dynamic import DynamicStiffness, Factorisation, columns_at_once
from lrbc_cli.reduction.ports import PortFrf, port_frf
from lrbc_cli.reduction.reduced import reference_dynamic

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]

#: Factors above this size are made one at a time.
SIDE_BY_SIDE_BYTES = 400e6

#: Inputs above which only the first line is solved for all of them, and later ones for so many random combinations.
MANY_INPUTS = 150
COMBINATIONS = 96

#: A second moment pays where a factorisation takes more time than this many blocks of solves.
MOMENT_PAYS = 4.0

#: Faster factorisations [s] are not worth the choice, and their times are noise.
MOMENT_SECONDS = 0.2


@dataclass(frozen=True)
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
    Z : DynamicStiffness
        With the terms at their reference values.
    model : FeModel
    input_of : (n_out,) int array
    reference : (nt, 3) float array
    scale : (nt,) float array
        From ``local_scale``.

    Attributes
    ----------
    dual : (n, d) csc_array
        Distinct responses, and outputs of the terms where their solutions are not those of the inputs.
    dual_of : int array
        Which of them belongs to each response (and output of a term).
    many : bool
        So many inputs that they are compressed before solving: what one line's solutions span, random combinations at the next one leave
        only where it is new. Errors are then measured by residuals.
    """

    def __init__(self, Z: DynamicStiffness, model: FeModel, input_of: NDArray[np.int64], reference: Floats, scale: Floats) -> None:
        self._stations = [Z]
        self._model, self._input_of, self._reference = model, input_of, reference
        self.inputs: sp.csc_array = model.inputs
        self.outputs = model.outputs
        # With a symmetric Z and equal left and right vectors only the responses need dual solutions.
        covered = Z.symmetric and model.terms.symmetric
        # A response to several hammer points is one place all the same.
        self.dual, self.dual_of = distinct_columns((model.L.T if covered else self.outputs.T).tocsc())
        self._heard, self._heard_of = distinct_columns(self.outputs.T.tocsc())
        self._one_solve: float | None = None
        self._pools: list[ThreadPoolExecutor] = []
        self.many = self.inputs.shape[1] > MANY_INPUTS
        self._spanned = False
        self._scale = scale

    @cached_property
    def combinations(self) -> Complexes | Floats:
        """(n, k) the loads and random combinations of the term inputs, each term weighted with its local stiffness."""
        n_in = self._model.B.shape[1]
        mix = np.random.default_rng(20180405).normal(size=(self._scale.size, COMBINATIONS)) * np.sqrt(self._scale)[:, None]
        return np.hstack([self.inputs[:, :n_in].toarray(), self.inputs[:, n_in:] @ mix])

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
        s = 2j * np.pi * frequency_hz
        if self._large(Z):
            _trim()
        factorisation = Z.factor(s)
        if self._one_solve is None:
            load, times = self.inputs[:, [0]].toarray()[:, 0], []
            for _ in range(3):
                start = time.perf_counter()
                factorisation.solve(load, refine=1)
                times.append(time.perf_counter() - start)
            self._one_solve = min(times)
        if self.many and (self._spanned or not expand):
            line = FullLine(frequency_hz, factorisation, None, None)
        elif not expand and self._heard.shape[1] < self.inputs.shape[1]:
            # More hammer points than responses: the port FRFs take fewer solves from the other side.
            H = np.asarray(self.inputs.T @ factorisation.solve_transposed(self._heard)).T[self._heard_of]
            line = FullLine(frequency_hz, factorisation, None, self._ports(s, H))
        else:
            X = factorisation.solve(self.inputs)
            self._spanned = True
            line = FullLine(frequency_hz, factorisation, X, self._ports(s, np.asarray(self.outputs @ X)))
        return self.expanded(line) if expand else line

    def _ports(self, s: complex, H: Complexes) -> PortFrf:
        lines = np.array([s])
        return port_frf(H[None], lines, reference_dynamic(self._reference, lines), self._model.output_power, self._input_of)

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
        primal = factorisation.solve(self.combinations if self.many else self.inputs) if line.X is None else line.X
        blocks = [primal, factorisation.solve_transposed(self.dual)]
        order = self.order()
        if order > 1:
            # Second moment, X1 = -Z⁻¹ (2 s M + C) X0; the sign spans nothing.
            Z = factorisation.owner
            slope = (2 * s * Z.M + Z.C).tocsr()
            blocks += [_by_columns(factorisation.solve, slope, blocks[0]), _by_columns(factorisation.solve_transposed, slope.T, blocks[1])]
        return FullLine(line.frequency_hz, factorisation, line.X, line.exact, tuple(blocks), order)

    def order(self) -> int:
        """Moments an expansion point: a second one pays where a factorisation costs far more than a block of solves, by measured times."""
        Z = self._stations[0]
        # PARDISO's first factorisation contains its analysis.
        factored = Z.factor_seconds[1:] if Z.backend == "pardiso" else Z.factor_seconds
        if not factored:
            return 1
        most = max(columns for columns, _ in Z.solve_seconds)
        block = min(seconds for columns, seconds in Z.solve_seconds if columns == most) / most * (self.inputs.shape[1] + self.dual.shape[1])
        return 2 if min(factored) > max(MOMENT_PAYS * block, MOMENT_SECONDS) else 1


def distinct_columns(A: sp.csc_array) -> tuple[sp.csc_array, NDArray[np.int64]]:
    """Columns that differ, in their order, and for each column of A which of them it is."""
    A = A.copy()
    A.sum_duplicates()
    kept: dict[tuple[bytes, bytes], int] = {}
    of = np.empty(A.shape[1], dtype=np.int64)
    for j, (low, high) in enumerate(itertools.pairwise(A.indptr)):
        of[j] = kept.setdefault((A.indices[low:high].tobytes(), A.data[low:high].tobytes()), len(kept))
    return A[:, np.unique(of, return_index=True)[1]].tocsc(), of


def cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1
