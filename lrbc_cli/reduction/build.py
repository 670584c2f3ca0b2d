"""Adaptive reduction of the extended system (second-order Krylov subspaces at several frequencies) with a measured certificate.

Every factorisation of the full model is used twice. It gives exact port FRFs, and with them the true error of the FRFs y at that line
for any parameter vector; where this error is too large, its solutions extend the basis. ``reduce_model`` is the entry point.
"""

from __future__ import annotations

import datetime
import os
import platform
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from threadpoolctl import ThreadpoolController

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.errors import NumericalError
from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.outcome import HeldOut, Reduction, ReductionOptions, Step
from lrbc_cli.reduction.problem.basis import check_orthonormal, new_directions
from lrbc_cli.reduction.problem.full import full_operators, full_ports
from lrbc_cli.reduction.problem.problem import FIRST_POINTS, Problem
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.steps.certify import port_errors, residual_errors, vector_count
from lrbc_cli.reduction.steps.compress import Compressor
from lrbc_cli.reduction.steps.estimate import Effectivity, Estimator, Sweep
from lrbc_cli.reduction.steps.full_lines import FullLine, FullLines
from lrbc_cli.reduction.steps.unseen import Candidate, unseen_error

#: Directions with singular values below this share of the tolerance are dropped; they do not affect y, whose error is the product of a
#: primal and a dual error. The share is small on purpose: a rich basis needs fewer factorisations, and it is compressed afterwards.
DEFLATION = 1e-3

#: Measured errors in a row without progress after which errors below the rounding estimate count as rounding.
PATIENCE = 4

#: Error that compression may add, as a share of the tolerance, and the factor that lowers it if a full solve shows a larger error.
COMPRESSION, STRICTER = 0.1, 0.1


class _Clock:
    """Seconds by stage: ``lap`` adds the time since the previous lap to a stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = dict.fromkeys(("basis", "projection", "estimate", "compression", "certificate"), 0.0)
        self._last = time.perf_counter()
        self.start = self._last

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] += now - self._last
        self._last = now


class Reducer:
    """One adaptive reduction and its state: ``run`` expands, compresses and certifies. Parameters as of ``reduce_model``."""

    def __init__(
        self,
        model: FeModel,
        input_of: Integers,
        options: ReductionOptions,
        *,
        backend: str = "auto",
        blocks: int | None = None,
        small: int = 600,
    ) -> None:
        self.clock = _Clock()
        self.problem = Problem.of(model, input_of, options, backend=backend)
        # A ``small`` basis takes little time, however many modes there are.
        self.most = np.inf if blocks is None else max(blocks * (self.problem.inputs.shape[1] + self.problem.dual.shape[1]), small)
        self.lines = FullLines(self.problem)
        self.basis = self.problem.empty_basis()
        self.estimator = Estimator(self.problem)
        self.effectivity = Effectivity(self.problem.many)
        # With very many inputs a large basis costs more than further expansion points.
        self.deflation = max((10 if self.problem.many else 1) * DEFLATION * options.tolerance, 1e-12)
        self.loss = COMPRESSION * options.tolerance
        #: Whether ``max_size`` is smaller than the basis that the tolerance needs, so that further points are of no use.
        self.capped = False
        #: Estimated rounding error at the worst line of the latest sweep.
        self.rounding = 0.0
        self.exact: dict[float, PortFrf] = {}
        self.enriched: list[float] = []
        self.held_out: list[float] = []
        #: Measured errors of the current basis at held-out lines.
        self.measured: dict[float, dict[str, float]] = {}
        self.trace: list[Step] = []
        self.clock.lap("basis")

    @property
    def options(self) -> ReductionOptions:
        """Band, tolerance and limits of this reduction."""
        return self.problem.options

    def reduced(self) -> ReducedModel:
        """The reduced model on the current basis."""
        return self.problem.reduced(self.basis)

    def run(self, progress: Callable[[str], None] = lambda _: None) -> Reduction:
        """Extend the basis until the estimated error over the band and the measured errors at held-out lines are within the tolerance.

        Raises
        ------
        NumericalError
            If a factorisation fails.
        """
        rich = self.expand(progress)
        while True:
            if self._holds(rich) or self.stopped:
                candidate = self.compress(rich, progress)
                if not self.certify(candidate, progress):
                    return self._finish(candidate)
            elif not self._visit_worst(self._uncompressed(rich), 1, progress):
                continue
            rich = self._sweep(seen=True)

    # -- expand -----------------------------------------------------------------------------------------------------

    def expand(self, progress: Callable[[str], None] = lambda _: None) -> Sweep:
        """Expand at the first three lines (Chebyshev places, outer ones first), fewer if the estimate is already within the tolerance."""
        if self.problem.is_small:
            return self._whole(progress)
        angles = np.pi * (np.arange(FIRST_POINTS) + 0.5) / FIRST_POINTS
        frequencies_hz = self.estimator.grid.frequency(0.5 - 0.5 * np.cos(angles))
        rest = [float(frequency) for frequency in (*frequencies_hz[::2], *frequencies_hz[1::2])]
        while True:
            batch, rest = rest[: self.lines.width], rest[self.lines.width :]
            solved = self.lines.solve(batch, expand=True)
            self.clock.lap("basis")
            while solved:
                # The solutions of a line take as much memory as several bases: they are released before the next line.
                line = solved.pop(0)
                error = None
                if line.exact is not None:
                    self.exact[line.frequency_hz] = line.exact
                    if self.enriched:
                        # Error of the basis before this line extends it.
                        error = max(self.errors(line.frequency_hz, self.reduced()).values())
                        self.clock.lap("certificate")
                order, added = self.enrich(line)
                self._record(line.frequency_hz, order, added, error, progress)
                del line
            if len(self.enriched) > (FIRST_POINTS - 1 if self.problem.many else 1):
                sweep = self._sweep(seen=True)
                if not rest or self._is_good(sweep.estimate, 1.0):
                    return sweep

    def _whole(self, progress: Callable[[str], None]) -> Sweep:
        """Keep a small model whole: exact for every state of the terms, also for a resonance between the lines of the grid."""
        self.basis.extend([np.eye(part.dofs.size) for part in self.basis.fields])
        self.clock.lap("projection")
        self._record(float("nan"), 0, self.basis.size, None, lambda _: None)
        progress(f"   kept whole  r = {self.basis.size:4d}")
        try:
            return self._sweep(seen=True)
        except np.linalg.LinAlgError:
            raise NumericalError("the dynamic stiffness is singular in the band", hint="add damping, or choose another band") from None

    def enrich(self, line: FullLine) -> tuple[int, int]:
        """Extend the basis by the moments at a factorised line; returns (order, number of added directions)."""
        line = self.lines.expanded(line)
        self.lines.release(line)
        assert line.snapshots is not None
        new = [new_directions(part, line.snapshots, self.deflation) for part in self.basis.fields]
        self.clock.lap("basis")
        self.basis.extend(new)
        self.clock.lap("projection")
        if self.basis.size > self.most:
            raise NumericalError(
                f"the model has very many modes in the band: after {len(self.enriched) + 1} expansion points its error is still too large",
                place="reduction",
                hint="check the mass sum and the units of the model; `lrbc reduce` goes on for as long as it takes",
            )
        self.enriched.append(line.frequency_hz)
        added = sum(block.shape[1] for block in new)
        if added:
            self._changed()
        return line.order, added

    # -- compress ---------------------------------------------------------------------------------------------------

    def compress(self, rich: Sweep, progress: Callable[[str], None] = lambda _: None) -> Candidate:
        """Restrict the rich basis to the principal directions of its solutions, at most ``max_size`` of them."""
        whole, limit, size = self._uncompressed(rich), self.options.max_size, self.basis.size
        # With very many terms compression saves little, and each comparison costs as much as several full lines.
        if limit is None and (self.problem.many or self.problem.is_small):
            return whole
        compressor = Compressor(self.problem, self.basis, rich, self.estimator, self.loss)
        counts = compressor.search(self.options.tolerance)
        self.capped = limit is not None and sum(counts) > limit
        if limit is not None and self.capped:
            counts = compressor.within(limit)
        self.basis.restrict(compressor.turns(counts))
        self._changed()
        self.clock.lap("compression")
        sweep = self._sweep()
        self.trace.append(
            Step(
                frequency_hz=float("nan"),
                size=self.basis.size,
                order=0,
                added=0,
                measured_error=None,
                grid_hz=self.estimator.grid.lines_hz,
                estimate=sweep.estimate,
            )
        )
        progress(f"   compressed  r = {self.basis.size:4d}  from {size}")
        return replace(whole, sweep=sweep)

    def _uncompressed(self, rich: Sweep) -> Candidate:
        return Candidate(rich=rich, sweep=rich, full=self.reduced(), basis=self.basis.projected())

    def _changed(self) -> None:
        """Discard errors of the previous basis; a line stays held out only if its exact port FRFs are known for a new measurement."""
        self.measured = {}
        self.held_out = [frequency for frequency in self.held_out if frequency in self.exact]

    # -- certify ----------------------------------------------------------------------------------------------------

    def certify(self, candidate: Candidate, progress: Callable[[str], None] = lambda _: None) -> bool:
        """Measure errors until ``held_out`` lines outside the basis meet the tolerance; returns True as soon as one extends the basis."""
        while True:
            missing = self.options.held_out - len(self.held_out)
            if missing > 0:
                if self._visit_worst(candidate, min(self.lines.width, missing), progress):
                    return True
                continue
            final = self.reduced()
            self.measured = {frequency: self.measured.get(frequency) or self.errors(frequency, final) for frequency in self.held_out}
            missed = [frequency for frequency in self.held_out if max(self.measured[frequency].values()) > self.options.tolerance]
            if not missed or self.stopped:
                return False
            self.held_out = [frequency for frequency in self.held_out if frequency not in missed]
            if self._visit(self.lines.solve(missed[:1]), candidate, progress):
                return True

    def _visit_worst(self, candidate: Candidate, count: int, progress: Callable[[str], None]) -> bool:
        """Solve and visit the lines with the largest estimates, each in a different part of the band."""
        grid, estimate = self.estimator.grid, candidate.sweep.estimate
        return self._visit(
            self.lines.solve(grid.worst(estimate, self.enriched, self.held_out, count, self.options.held_out)), candidate, progress
        )

    def _visit(self, batch: list[FullLine], candidate: Candidate, progress: Callable[[str], None]) -> bool:
        """Measure the error at solved lines: each is held out, or extends the basis if the error is too large; returns whether one did.

        The remaining lines are then dropped: which lines come next must depend on the new basis, not on how many are solved at a time.
        """
        tolerance = self.options.tolerance
        self.exact.update({line.frequency_hz: line.exact for line in batch if line.exact is not None})
        while batch:
            line = batch.pop(0)
            frequency = line.frequency_hz
            errors = self.measure(line, self.reduced())
            error = max(errors.values())
            self.effectivity.see(error, float(np.interp(frequency, self.estimator.grid.lines_hz, candidate.sweep.estimate)))
            if error > 0.5 * tolerance and self._lost_by_compression(line, candidate, error):
                self.loss *= STRICTER
            order = added = 0
            self.clock.lap("certificate")
            if (error > 0.5 * tolerance or not self._holds(candidate.rich)) and not self.stopped:
                order, added = self.enrich(line)
                # No new direction although the error is too large: deflation has dropped what is missing.
                self.deflation *= 1.0 if added else 0.1
            if not order or self.deflation < 1e-15:
                self.held_out.append(frequency)
                self.measured[frequency] = errors
            self._record(frequency, order, added, error, progress)
            del line
            if added:
                return True
        return False

    def errors(self, frequency: float, model: ReducedModel) -> dict[str, float]:
        """Measured relative error of y at a line whose exact port FRFs are known, by kind of parameter vector."""
        exact = self.exact[frequency]
        return port_errors(self.problem.model, self.problem.scale, exact, model.ports(exact.s, workers=1))

    def measure(self, line: FullLine, model: ReducedModel) -> dict[str, float]:
        """The same at a line just factorised; from residuals if its exact port FRFs are not known."""
        if line.exact is not None:
            return self.errors(line.frequency_hz, model)
        inputs = self.problem.inputs
        return residual_errors(
            self.problem.model, self.problem.scale, model, line.factorisation, self.basis.lift, lambda amplitudes: inputs @ amplitudes
        )

    def _lost_by_compression(self, line: FullLine, candidate: Candidate, error: float) -> bool:
        """Whether the error at a line comes from compression: that of the rich model is less than half of it."""
        return (
            line.exact is not None and candidate.compressed and max(self.errors(line.frequency_hz, candidate.full).values()) < 0.5 * error
        )

    # -- used by all three steps ----------------------------------------------------------------------------------------

    def _sweep(self, *, seen: bool = False) -> Sweep:
        """Estimate the error of the current basis over the band; with ``seen`` the last step of the trace gets the estimate."""
        sweep = self.estimator.sweep(self.basis.projected())
        self.rounding = float(sweep.rounding.max())
        if seen:
            self.trace[-1] = replace(self.trace[-1], estimate=sweep.estimate)
        self.clock.lap("estimate")
        return sweep

    def _holds(self, rich: Sweep) -> bool:
        return self._is_good(rich.estimate, self.effectivity.value)

    def _is_good(self, estimate: Floats, effectivity: float) -> bool:
        return float(estimate.max()) * effectivity <= self.options.tolerance

    @property
    def stopped(self) -> str:
        """Why further expansion points would not help; empty if they may."""
        if self.capped:
            return f"max_size {self.options.max_size}"
        if len(self.enriched) >= self.options.max_points:
            return f"{self.options.max_points} expansion points"
        if self.basis.size >= self.problem.model.size:
            return "the basis is as large as the model"
        errors = [step.measured_error for step in self.trace if step.measured_error is not None]
        if len(errors) > PATIENCE and min(errors[-PATIENCE:]) > 0.5 * min(errors[:-PATIENCE]) and max(errors[-PATIENCE:]) < self.rounding:
            return "rounding"
        return ""

    def _record(self, frequency: float, order: int, added: int, error: float | None, progress: Callable[[str], None]) -> None:
        grid = self.estimator.grid.lines_hz
        self.trace.append(
            Step(
                frequency_hz=frequency,
                size=self.basis.size,
                order=order,
                added=added,
                measured_error=error,
                grid_hz=grid,
                estimate=np.full(grid.size, np.nan),
            )
        )
        missed = "" if error is None else f"measured error {error:.1e}  "
        done = f"expansion point, +{added}" if order else "held out"
        progress(f"{frequency:8.2f} Hz  r = {self.basis.size:4d}  {missed}{done}")

    # -- result ----------------------------------------------------------------------------------------------------

    def _unseen(self, candidate: Candidate) -> float:
        """Statistical bound of the error at lines that were not solved with the full model."""
        errors = {line: self.errors(line, candidate.full) if candidate.compressed else self.measured[line] for line in self.held_out}
        return unseen_error(
            self.problem, self.estimator, candidate, self.reduced(), {line: max(found.values()) for line, found in errors.items()}
        )

    def _finish(self, candidate: Candidate) -> Reduction:
        for part in self.basis.fields:
            check_orthonormal(part)
        problem, options = self.problem, self.options
        groups = {name: {key: self.basis.project(A) for key, A in group.items()} for name, group in problem.model.extras.items()}
        lines = tuple(HeldOut(frequency, self.measured[frequency]) for frequency in sorted(self.held_out))
        # The bound must not lie below a measured error.
        unseen = max(self._unseen(candidate), max((line.worst for line in lines), default=0.0))
        self.clock.lap("certificate")
        reached = all(line.worst <= options.tolerance for line in lines)
        return Reduction(
            model=replace(self.reduced(), extras=groups),
            options=options,
            reached=reached,
            held_out=lines,
            unseen=unseen,
            trace=tuple(self.trace),
            seconds=self.clock.seconds
            | {
                "full_line": self.lines.line_seconds,
                "factor": self.lines.factor_seconds,
                "total": time.perf_counter() - self.clock.start,
            },
            backend=problem.Z.backend,
            coupling=problem.Z.coupling.text,
            sizes=tuple(self.basis.sizes),
            full_size=problem.model.size,
            vectors=vector_count(problem.model.terms),
            machine={
                "platform": platform.platform(),
                "processor": platform.processor() or platform.machine(),
                "cores": os.cpu_count() or 1,
            },
            date=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            stopped="" if reached else self.stopped,
        )


def reduce_model(
    model: FeModel,
    input_of: Integers,
    options: ReductionOptions,
    *,
    backend: str = "auto",
    progress: Callable[[str], None] = lambda _: None,
    rows: Integers | None = None,
    blocks: int | None = None,
) -> Reduction:
    """Reduce a model so that the FRFs y are within the tolerance in the band for all values of the terms.

    Parameters
    ----------
    model : FeModel
    input_of : (n_out,) int array
        Which input (column of B) each response belongs to.
    options : ReductionOptions
    backend : str
        Sparse solver, see ``DynamicStiffness``; affects the time only.
    progress : callable
        Called with one line of text for each factorisation.
    rows : (k,) int array or None
        DOFs at which rows of the basis are kept in the result.
    blocks : int or None
        Largest number of basis vectors for each input and each dual right-hand side, two for each expansion point; 600 in all are allowed.

    Returns
    -------
    Reduction
        With ``reached`` False if the tolerance was not met.

    Raises
    ------
    NumericalError
        If the system is singular in the band, or if the basis would exceed ``blocks``.
    """
    # QR of tall matrices does not gain from threads, and BLAS threads on busy cores cost a factor of ten. PARDISO has its own threads.
    with ThreadpoolController().select(internal_api="openblas").limit(limits=1):
        reducer = Reducer(model, input_of, options, backend=backend, blocks=blocks)
        try:
            reduction = reducer.run(progress)
            return reduction if rows is None else replace(reduction, rows=reducer.basis.rows_at(rows))
        finally:
            reducer.lines.close()


__all__ = ["HeldOut", "Reducer", "Reduction", "ReductionOptions", "Step", "full_operators", "full_ports", "reduce_model"]
