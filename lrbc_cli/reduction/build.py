"""Adaptive multi-point second-order Krylov reduction of the extended system, with a measured certificate.

Every factorisation serves twice: the exact port FRFs that it gives are compared with those of the reduced model (so the error
of y is *measured* there for any parameter vector), and its solutions enrich the basis where that error is too large.
"""

from __future__ import annotations

import datetime
import logging
import os
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.basis import RESIDUAL_STIFFNESS, Field, Projection, check_orthonormal, energy_weight, new_directions
from lrbc_cli.reduction.certify import port_errors, quantity_groups, random_vectors, residual_errors
from lrbc_cli.reduction.compress import Compressor
from lrbc_cli.reduction.dynamic import DynamicStiffness
from lrbc_cli.reduction.estimate import Estimator, Sweep
from lrbc_cli.reduction.full import full_operators, full_ports
from lrbc_cli.reduction.lines import FullLine, FullLines
from lrbc_cli.reduction.outcome import HeldOut, Reduction, ReductionOptions, Step
from lrbc_cli.reduction.ports import PortFrf
from lrbc_cli.reduction.reduced import ReducedModel
from lrbc_cli.reduction.unseen import ROUNDING_LEVEL, distance, unseen_bound
from lrbc_cli.reduction.vectors import band_omega, certificate_vectors, local_scale, reference_values

log = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]

#: Increased whenever the same input would give another basis.
ALGORITHM_VERSION = 10

#: Expansion points before the estimate takes over, at Chebyshev places.
FIRST_POINTS = 3

#: Directions below this share of the tolerance cannot be seen in y, whose error is a product of two such errors. They are dropped late:
#: a rich basis needs fewer factorisations, and is compressed afterwards.
DEFLATION = 1e-3

#: Points without progress after which what is left counts as rounding, and the errors below which that is looked for.
PATIENCE, ROUNDED = 4, 1e-8

#: What compression may cost, in tolerances; less by a factor where a full solve shows that it cost too much.
COMPRESSION, STRICTER = 0.1, 0.1

#: By how much an estimate may prove too large.
LEAST_EFFECTIVITY = 0.1

#: Lines of the grid of the estimate; fewer where each costs more, by the number of terms.
GRID_LINES = 120


class _Clock:
    def __init__(self) -> None:
        self.seconds: dict[str, float] = dict.fromkeys(("basis", "projection", "estimate", "compression", "certificate"), 0.0)
        self._last = time.perf_counter()
        self.start = self._last

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] += now - self._last
        self._last = now


class Reducer:
    """State of one adaptive reduction; ``run`` does it."""

    def __init__(
        self, model: FeModel, input_of: NDArray[np.int64], options: ReductionOptions, *, backend: str = "auto", ordering: str = "auto"
    ) -> None:
        self.clock = _Clock()
        self.model, self.options, self.input_of = model, options, input_of
        high = band_omega(model.K, model.M, options.band_hz)
        self.scale = local_scale(model.K, model.M, model.terms, high)
        self.reference = reference_values(model.terms, self.scale, high)
        K, C, M = full_operators(model, self.reference)
        self.Z = DynamicStiffness(K, C, M, model.is_acoustic, backend=backend, ordering=ordering)
        self.lines = FullLines(self.Z, model, input_of, self.reference, self.scale)
        weight = energy_weight(K, M, high)
        masks = [~model.is_acoustic, model.is_acoustic]
        self.fields = [Field(np.flatnonzero(mask), weight[mask], np.zeros((int(mask.sum()), 0))) for mask in masks if mask.any()]
        self.projection = Projection(
            (K, C, M),
            self.lines.inputs,
            self.lines.outputs,
            self.fields,
            dual=self.lines.dual,
            residual_weight=energy_weight(K, M, high, RESIDUAL_STIFFNESS),
            transposed=not self.Z.symmetric,
        )
        # Large bases are costlier than points.
        self.deflation = max((10 if self.lines.many else 1) * DEFLATION * options.tolerance, 1e-12)
        count = int(np.clip(GRID_LINES * (100 / max(model.terms.size, 1)) ** 1.25, 16, GRID_LINES))
        self.estimator = Estimator(self, count=max(count, 3 * options.held_out))
        self.loss = COMPRESSION * options.tolerance
        #: Whether ``max_size`` cuts away what the tolerance needs, so that further points are of no use.
        self.capped = False
        self.exact: dict[float, PortFrf] = {}
        self.enriched: list[float] = []
        self.trace: list[Step] = []
        self.clock.lap("basis")

    # -- one line ---------------------------------------------------------------------------------------------------

    def enrich(self, line: FullLine) -> tuple[int, int]:
        """Add the moments at a factorised line to the basis; returns (order, added directions)."""
        line = self.lines.expanded(line)
        self.lines.release(line)
        assert line.snapshots is not None
        new = [new_directions(f, line.snapshots, self.deflation) for f in self.fields]
        self.clock.lap("basis")
        self.projection.extend(new)
        self.clock.lap("projection")
        self.enriched.append(line.frequency_hz)
        return line.order, sum(block.shape[1] for block in new)

    def compress(self, sweep: Sweep) -> None:
        """Keep the part of the basis that its solutions use, at most ``max_size`` directions."""
        compressor = Compressor(self, sweep, self.loss)
        counts = compressor.search(self.options.tolerance)
        limit = self.options.max_size
        self.capped = limit is not None and sum(counts) > limit
        if limit is not None and self.capped:
            counts = compressor.within(limit)
        self.projection.restrict(compressor.turns(counts))
        self.clock.lap("compression")

    # -- errors -----------------------------------------------------------------------------------------------------

    def operators(self) -> tuple[Any, Any, Any]:
        """Projected K, C and M with the terms at their reference values."""
        P = self.projection
        return P.operator(0), P.operator(1), P.operator(2)

    @property
    def structure(self) -> int:
        """Structural ones of the reduced DOFs."""
        return 0 if self.model.is_acoustic.all() else self.projection.sizes[0]

    def reduced(self) -> ReducedModel:
        """The reduced model on the basis so far."""
        P, R = self.projection, self.model.L.shape[0]
        n_in = self.model.B.shape[1]
        inputs, outputs = P.inputs, P.outputs
        left, right = inputs[:, n_in:], outputs[R:].T
        K, C, M = (A - (left * self.reference[:, i]) @ right.T for i, A in enumerate(self.operators()))
        return ReducedModel(
            K, C, M, inputs[:, :n_in], outputs[:R], left, right, self.model.output_power, self.input_of, self.reference, self.structure
        )

    def projected_groups(self) -> dict[str, dict[str, Any]]:
        """Vᵀ A V of the further groups of factors."""
        return {name: {key: self.projection.project(A) for key, A in group.items()} for name, group in self.model.extras.items()}

    def errors(self, frequency: float, model: ReducedModel) -> dict[str, float]:
        """Measured relative error of y at a line that was solved for all inputs, by kind of parameter vector."""
        exact = self.exact[frequency]
        return port_errors(self.model, self.scale, exact, model.ports(exact.s, workers=1))

    def measure(self, line: FullLine, model: ReducedModel) -> dict[str, float]:
        """The same at a line just factorised, by the residuals where not all inputs were solved."""
        if line.exact is not None:
            return self.errors(line.frequency_hz, model)
        return residual_errors(
            self.model, self.scale, model, line.factorisation, self.projection.lift, lambda amplitudes: self.lines.inputs @ amplitudes
        )

    def quantity_groups(self) -> list[NDArray[np.int64]]:
        """Responses that share a physical quantity."""
        return quantity_groups(self.model)

    # -- the loop ---------------------------------------------------------------------------------------------------

    def run(self, progress: Callable[[str], None] = lambda _: None) -> Reduction:
        """Grow the basis until the estimate holds over the band and the measured error at the held-out lines.

        Raises
        ------
        NumericalError
            Where a factorisation fails.
        """
        options = self.options
        angles = np.pi * (np.arange(FIRST_POINTS) + 0.5) / FIRST_POINTS
        rich = self._expand(self.estimator.grid.frequency(0.5 - 0.5 * np.cos(angles)), progress)
        held_out: list[float] = []
        # Measured over estimated error. Points of very many terms are so costly that an estimate that proves too large is believed less.
        effectivity, least = 1.0, LEAST_EFFECTIVITY if self.lines.many else 1.0
        # Valid for the basis as it is: emptied whenever it grows.
        measured: dict[float, dict[str, float]] = {}
        sweep = rich
        full, compressed = self.reduced(), False
        again: list[float] = []
        known = not self.lines.many
        while True:
            if len(held_out) >= options.held_out:
                # The basis may have grown after a line was held out: all errors are those of the final model.
                final = self.reduced()
                measured = {frequency: measured.get(frequency) or self.errors(frequency, final) for frequency in held_out}
                again = [frequency for frequency in held_out if max(measured[frequency].values()) > options.tolerance]
                if not again or not self._may_grow():
                    break
                held_out = [frequency for frequency in held_out if frequency not in again]
            if not compressed and (self._is_good(rich.estimate, effectivity) or not self._may_grow()):
                full, compressed, sweep = self.reduced(), True, rich
                # With very many terms it would save little, and each comparison costs as much as several full lines.
                if not self.lines.many or options.max_size is not None:
                    size = self.projection.size
                    self.compress(rich)
                    sweep = self._sweep()
                    self.trace.append(Step(float("nan"), self.projection.size, 0, 0, None, self.estimator.grid.lines_hz, sweep.estimate))
                    progress(f"   compressed  r = {self.projection.size:4d}  from {size}")
            # A line that is likely to enrich the basis decides where the next one is.
            width = min(self.lines.width if compressed else 1, options.held_out - len(held_out))
            batch = self.lines.solve(
                again[:1] or self.estimator.grid.worst(sweep.estimate, self.enriched, held_out, width, options.held_out)
            )
            again = []
            self.exact.update({line.frequency_hz: line.exact for line in batch if line.exact is not None})
            grown = False
            while batch:
                line = batch.pop(0)
                frequency, model = line.frequency_hz, self.reduced()
                measured[frequency] = self.measure(line, model)
                error = max(measured[frequency].values())
                expected = float(np.interp(frequency, self.estimator.grid.lines_hz, sweep.estimate))
                if expected > 0 and not grown:
                    seen = float(np.clip(error / expected, least, 10.0))
                    effectivity = max(effectivity, seen) if known else seen
                    known = True
                if compressed and not grown and error > 0.5 * options.tolerance and self._lost_by_compression(line, full, error):
                    self.loss *= STRICTER
                needs = error > 0.5 * options.tolerance or not (grown or self._is_good(rich.estimate, effectivity))
                order = added = 0
                if needs and self._may_grow():
                    self.clock.lap("certificate")
                    order, added = self.enrich(line)
                    # Nothing new although the error is too large: the deflation hides what is missing.
                    if added == 0:
                        self.deflation *= 0.1
                        if self.deflation < 1e-15:
                            held_out.append(frequency)
                else:
                    held_out.append(frequency)
                    self.clock.lap("certificate")
                self._record(frequency, order, added, error)
                progress(
                    f"{frequency:8.2f} Hz  r = {self.projection.size:4d}  measured error {error:.1e}  "
                    + (f"expansion point, +{added}" if order else "held out")
                )
                if added:
                    grown, measured = True, {}
                del line
            if grown:
                sweep = rich = self._sweep(seen=True)
                compressed = False
                # A larger basis can be measured again only where the exact port FRFs are known.
                held_out = [frequency for frequency in held_out if frequency in self.exact]
        return self._finish(held_out, measured, full if compressed else self.reduced(), rich, sweep)

    def _lost_by_compression(self, line: FullLine, full: ReducedModel, error: float) -> bool:
        """Whether the rich model is much better than the compressed one at a line."""
        return line.exact is not None and max(self.errors(line.frequency_hz, full).values()) < 0.5 * error

    def _sweep(self, *, seen: bool = False) -> Sweep:
        """Estimate the error over the band; the trace shows it as what the last factorisation led to."""
        sweep = self.estimator.sweep()
        if seen:
            self.trace[-1] = replace(self.trace[-1], estimate=sweep.estimate)
        self.clock.lap("estimate")
        return sweep

    def _is_good(self, estimate: Floats, effectivity: float) -> bool:
        return float(estimate.max()) * effectivity <= self.options.tolerance

    def _may_grow(self) -> bool:
        return not self.stopped

    @property
    def stopped(self) -> str:
        """Why no further point is of use; empty where one may be."""
        if self.capped:
            return f"max_size {self.options.max_size}"
        if len(self.enriched) >= self.options.max_points:
            return f"{self.options.max_points} expansion points"
        if self.projection.size >= self.model.size:
            return "the basis is as large as the model"
        errors = [step.measured_error for step in self.trace if step.measured_error is not None]
        if len(errors) > PATIENCE and min(errors[-PATIENCE:]) > 0.5 * min(errors[:-PATIENCE]) and max(errors[-PATIENCE:]) < ROUNDED:
            return "rounding"
        return ""

    def _expand(self, frequencies_hz: Floats, progress: Callable[[str], None]) -> Sweep:
        """Expand at these lines, the outer ones first, until the estimate is good."""
        rest = [float(frequency) for frequency in (*frequencies_hz[::2], *frequencies_hz[1::2])]
        while True:
            batch, rest = rest[: self.lines.width], rest[self.lines.width :]
            solved = self.lines.solve(batch, expand=True)
            self.clock.lap("basis")
            while solved:
                # Solutions of a line are as large as several bases: none is kept while the next line is solved.
                line = solved.pop(0)
                error = None
                if line.exact is not None:
                    self.exact[line.frequency_hz] = line.exact
                    if self.enriched:
                        # What the basis before it misses there.
                        error = max(self.errors(line.frequency_hz, self.reduced()).values())
                        self.clock.lap("certificate")
                order, added = self.enrich(line)
                self._record(line.frequency_hz, order, added, error)
                missed = "" if error is None else f"measured error {error:.1e}  "
                progress(f"{line.frequency_hz:8.2f} Hz  r = {self.projection.size:4d}  {missed}expansion point, +{added}")
                del line
            if len(self.enriched) > (FIRST_POINTS - 1 if self.lines.many else 1):
                sweep = self._sweep(seen=True)
                if not rest or self._is_good(sweep.estimate, 1.0):
                    return sweep

    def _record(self, frequency: float, order: int, added: int, error: float | None) -> None:
        grid = self.estimator.grid.lines_hz
        self.trace.append(Step(frequency, self.projection.size, order, added, error, grid, np.full(grid.size, np.nan)))

    def _unseen(
        self, held_out: list[float], measured: dict[float, dict[str, float]], full: ReducedModel, rich: Sweep, sweep: Sweep
    ) -> float:
        """Bound of the error at lines that were not solved in full."""
        lines = np.array(held_out)
        if self.lines.many:
            worst = np.array([max(measured[line].values()) for line in held_out])
            return unseen_bound(
                worst, np.interp(lines, self.estimator.grid.lines_hz, sweep.estimate), sweep.estimate, np.zeros(()), self.options.tolerance
            )
        worst = np.array([max(self.errors(line, full).values()) for line in held_out])
        lost = distance(rich.ports, sweep.ports, self.estimator.vectors, self.quantity_groups(), self.estimator.local)
        # The certificate has more vectors than the sweep: where it measured, its differences correct those.
        final = np.array([max(measured[line].values()) for line in held_out])
        computed = np.interp(lines, self.estimator.grid.lines_hz, lost)
        lost = lost * max(1.0, float(np.max((final - worst) / np.maximum(computed, ROUNDING_LEVEL))))
        return unseen_bound(
            worst, np.interp(lines, self.estimator.grid.lines_hz, rich.estimate), rich.estimate, lost, self.options.tolerance
        )

    def _finish(
        self, held_out: list[float], measured: dict[float, dict[str, float]], full: ReducedModel, rich: Sweep, sweep: Sweep
    ) -> Reduction:
        for f in self.fields:
            check_orthonormal(f)
        model = replace(self.reduced(), extras=self.projected_groups())
        lines = tuple(HeldOut(f, measured[f]) for f in sorted(held_out))
        tolerance = self.options.tolerance
        # No bound below what was measured.
        unseen = max(self._unseen(held_out, measured, full, rich, sweep), max((line.worst for line in lines), default=0.0))
        self.clock.lap("certificate")
        seconds = dict(self.clock.seconds)
        seconds["full_line"] = self.lines.line_seconds
        seconds["factor"] = self.lines.factor_seconds
        seconds["total"] = time.perf_counter() - self.clock.start
        vectors = sum(
            len(v)
            for v in certificate_vectors(self.model.terms, self.scale, np.array([1j]), random_vectors(self.model.terms.size)).values()
        )
        reached = all(line.worst <= tolerance for line in lines)
        return Reduction(
            model,
            self.options,
            reached,
            lines,
            unseen,
            tuple(self.trace),
            seconds,
            self.Z.backend,
            self.Z.coupling.text,
            tuple(self.projection.sizes),
            self.model.size,
            vectors,
            {"platform": platform.platform(), "processor": platform.processor() or platform.machine(), "cores": os.cpu_count() or 1},
            datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            "" if reached else self.stopped,
        )


def reduce_model(
    model: FeModel,
    input_of: NDArray[np.int64],
    options: ReductionOptions,
    *,
    backend: str = "auto",
    ordering: str = "auto",
    progress: Callable[[str], None] = lambda _: None,
) -> Reduction:
    """Reduce a model so that y is within the tolerance on the band for every value of the terms.

    Parameters
    ----------
    model : FeModel
    input_of : (n_out,) int array
        Which input each response belongs to.
    options : ReductionOptions
    backend, ordering : str
        Execution only, see ``DynamicStiffness``.
    progress : callable
        Gets one line of text a factorisation.

    Returns
    -------
    Reduction
        With ``reached`` False where the tolerance was not met.

    Raises
    ------
    NumericalError
        Where the system is singular on the band.
    """
    # Tall and thin QR does not gain from threads, and spinning BLAS threads on busy cores cost a factor of ten; PARDISO keeps its own.
    with ThreadpoolController().select(internal_api="openblas").limit(limits=1):
        reducer = Reducer(model, input_of, options, backend=backend, ordering=ordering)
        try:
            return reducer.run(progress)
        finally:
            reducer.lines.close()


__all__ = ["HeldOut", "Reducer", "Reduction", "ReductionOptions", "Step", "full_operators", "full_ports", "reduce_model"]
