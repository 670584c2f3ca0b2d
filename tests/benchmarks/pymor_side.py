"""The same reduction with pyMOR: same model, same factorisations, as many expansion points as its error needs.

    pip install pymor
    python tests/benchmarks/run.py --pymor

pyMOR (BSD-2) is never imported by the tool itself. Its second-order model gets K, C and M with the terms at their reference values, B_ext
and L_ext; what its reductors ask of (s² M + s E + K)⁻¹ is answered by the tool's own factorisation, so that both factorise equally fast.
They want to be told the points: the fewest Chebyshev points of the band are searched at which the error of y holds the tolerance on
held-out lines, in two ways: one Galerkin basis of the solutions for all inputs and outputs, solved in blocks (``gram_schmidt``,
``SOLTIPGReductor``), and its bitangential Hermite interpolation (``SOBHIReductor``), which solves one direction after the other. The run
with that number of points is timed alone: neither the search nor any verification counts for pyMOR, while the tool's seconds include
its choice of points and its certificate.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from measure import Figure, at_most
from numpy.typing import NDArray

from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.reduction.build import Reduction
from lrbc_cli.reduction.problem.full import full_operators, full_ports
from lrbc_cli.reduction.problem.norms import quantity_groups, relative_error
from lrbc_cli.reduction.problem.vectors import certificate_vectors, local_scale, reference_values
from lrbc_cli.reduction.reduced.model import reference_dynamic
from lrbc_cli.reduction.reduced.ports import PortFrf, port_frf
from lrbc_cli.reduction.solve.dynamic import DynamicStiffness, Factorisation

Complexes = NDArray[np.complexfloating[Any, Any]]

#: Expansion points after which the search gives up.
MOST_POINTS = 8

#: Runs with the number of points that was found; the fastest counts, as for the tool.
REPEATS = 3


def available() -> bool:
    """Whether pyMOR is installed."""
    return importlib.util.find_spec("pymor") is not None


@dataclass(frozen=True)
class Side:
    """One way to reduce, and what it gave.

    Attributes
    ----------
    name : str
    seconds : float
    points, size : int
    error : float
        Worst error of y at held-out lines.
    """

    name: str
    seconds: float
    points: int
    size: int
    error: float


class Benchmark:
    """The model as pyMOR has it, and exact port FRFs at the held-out lines."""

    def __init__(self, inputs: Inputs, backend: str, lines: int) -> None:
        import scipy.sparse as sp
        from pymor.core.logger import set_log_levels
        from pymor.models.iosys import SecondOrderModel

        set_log_levels({"pymor": "ERROR"})
        self.model, self.input_of = inputs.model, inputs.input_of
        self.band, self.tolerance = inputs.campaign.reduction.band, inputs.campaign.reduction.tolerance
        high = 2 * np.pi * self.band[1]
        self.scale = local_scale(self.model.K, self.model.M, self.model.terms, high)
        self.reference = reference_values(self.model.terms, self.scale, high)
        self.K, self.C, self.M = full_operators(self.model, self.reference)
        self.backend = backend
        self.B, self.L = self.model.inputs.toarray(), self.model.outputs.toarray()
        matrices = (sp.csc_matrix(A) for A in (self.M, self.C, self.K))
        self.fom = SecondOrderModel.from_matrices(*matrices, self.B, self.L)
        rng = np.random.default_rng(26)
        frequencies = np.sort(rng.uniform(*self.band, size=lines))
        self.s = 2j * np.pi * frequencies
        self.exact = full_ports(self.model, self.input_of, self.s, self.band, backend=backend)
        self.vectors = [D for kind in certificate_vectors(self.model.terms, self.scale, self.s).values() for D in kind]

    def error(self, ports: PortFrf) -> float:
        """Worst error of y as the certificate measures it, over the held-out lines and all its parameter vectors."""
        groups, worst = quantity_groups(self.model), 0.0
        for D in self.vectors:
            y, exact = ports.evaluate(D), self.exact.evaluate(D)
            worst = max(worst, *(relative_error(groups, *row) for row in zip(y, exact, self.exact.H00, strict=True)))
        return worst

    def ports(self, rom: Any) -> PortFrf:
        """Port FRFs of pyMOR's reduced model."""
        M, E, K, B, Cp = (np.asarray(op.matrix) for op in (rom.M, rom.E, rom.K, rom.B, rom.Cp))
        H = np.array([Cp @ np.linalg.solve(s**2 * M + s * E + K, B.astype(complex)) for s in self.s])
        return port_frf(H, self.s, reference_dynamic(self.reference, self.s), self.model.output_power, self.input_of)

    def galerkin(self, points: Complexes) -> Any:
        """One orthonormal basis of the solutions for all inputs and all outputs: blocks, as large as it may be in one solve."""
        from pymor.algorithms.gram_schmidt import gram_schmidt
        from pymor.reductors.basic import SOLTIPGReductor

        space, Z = self.fom.solution_space, self.stiffness()
        V = space.empty()
        for s in points:
            factorisation = Z.factor(complex(s))
            for X in (factorisation.solve(self.B), factorisation.solve_transposed(self.L.T)):
                for part in (X.real, X.imag):
                    V.append(space.from_numpy(np.asfortranarray(part)))
        gram_schmidt(V, copy=False)
        return SOLTIPGReductor(self.fom, V, V).reduce()

    def bitangential(self, points: Complexes) -> Any:
        """Hermite interpolation with one basis for the inputs and one for the outputs: every term, and the load with all responses."""
        from pymor.reductors.interpolation import SOBHIReductor

        Z, fom = self.stiffness(), self.fom
        latest: list[Factorisation] = []

        def at(s: complex) -> Factorisation:
            if not latest or latest[0].s != complex(s):
                latest[:] = [Z.factor(complex(s))]
            return latest[0]

        class Reductor(SOBHIReductor):
            def _K_apply_inverse(self, s: complex, V: Any) -> Any:
                return fom.solution_space.from_numpy(at(s).solve(V.to_numpy()))

            def _K_apply_inverse_adjoint(self, s: complex, V: Any) -> Any:
                return fom.solution_space.from_numpy(at(s).solve_transposed(V.to_numpy().conj()).conj())

        inputs, responses = self.B.shape[1], self.model.L.shape[0]
        loads = self.model.B.shape[1]
        right, left = np.eye(inputs), np.zeros((inputs, self.L.shape[0]))
        left[:loads, :responses] = 1.0
        left[loads:, responses:] = np.eye(inputs - loads)
        count = len(points)
        return Reductor(fom).reduce(np.repeat(points, inputs), np.tile(right, (count, 1)), np.tile(left, (count, 1)))

    def stiffness(self) -> DynamicStiffness:
        """A fresh one, as its analysis belongs to the time of a run."""
        return DynamicStiffness(self.K, self.C, self.M, self.model.is_acoustic, backend=self.backend)

    def fewest(self, name: str, way: Callable[[Complexes], Any], repeats: int, tell: Callable[[str], None]) -> Side | None:
        """The first number of points that holds the tolerance, and the seconds of that run alone; None where none does."""
        low, high = self.band
        for count in range(2, MOST_POINTS + 1):
            at = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.pi * (np.arange(count) + 0.5) / count)
            start = time.perf_counter()
            rom = way(2j * np.pi * at)
            seconds = time.perf_counter() - start
            error = self.error(self.ports(rom))
            tell(f"{name}, {count} points: {seconds:.1f} s, r {rom.order}, worst error {error:.1e}")
            if error <= self.tolerance:
                for _ in range(repeats - 1):
                    start = time.perf_counter()
                    way(2j * np.pi * at)
                    seconds = min(seconds, time.perf_counter() - start)
                return Side(name, seconds, count, int(rom.order), error)
        return None


def side_by_side(
    inputs: Inputs, reduction: Reduction, seconds: float, line: float, backend: str, *, quick: bool, tell: Callable[[str], None]
) -> list[Figure]:
    """Rows of the table: this tool, with its certificate, and pyMOR without."""
    import pymor

    lines = 5 if quick else 20
    bench = Benchmark(inputs, backend, lines)
    part = f"Side by side with pyMOR {pymor.__version__} ({lines} other lines, {len(bench.vectors)} vectors)"
    ours = bench.error(reduction.model.ports(bench.s))
    points = sum(1 for step in reduction.trace if step.order)

    def text(side: Side) -> str:
        cost = f"{side.seconds:.2f} s = {side.seconds / line:.1f} full lines"
        return f"{cost}, {side.points} points, r {side.size}, worst error {side.error:.1e}"

    mine = Side("this tool, with its certificate", seconds, points, reduction.model.size, ours)
    figures = [at_most(part, mine.name, ours, bench.tolerance, text(mine), f"{bench.tolerance:.0e}")]
    ways: list[tuple[str, Callable[[Complexes], Any]]] = [("pyMOR, one Galerkin basis", bench.galerkin)]
    if not quick:
        ways.append(("pyMOR, SOBHIReductor", bench.bitangential))
    found = []
    for name, way in ways:
        side = bench.fewest(name, way, 1 if quick else REPEATS, tell)
        if side is None:
            figures.append(Figure(part, name, float("nan"), f"tolerance not reached with {MOST_POINTS} points"))
        else:
            found.append(side)
            figures.append(Figure(part, name, side.seconds, text(side)))
    if found:
        best = min(side.seconds for side in found)
        alone = seconds - reduction.seconds["certificate"]
        for name, own in (("seconds, this tool over pyMOR", seconds), ("the same without certificate, as pyMOR has none", alone)):
            figures.append(at_most(part, name, own / best, 0.5, f"{own / best:.2f} ({own:.2f} s / {best:.2f} s)", "0.5"))
    return figures
