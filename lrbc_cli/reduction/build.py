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
from lrbc_cli.reduction.certify import port_errors, quantity_groups
from lrbc_cli.reduction.dynamic import DynamicStiffness, Factorisation
from lrbc_cli.reduction.estimate import Estimator
from lrbc_cli.reduction.full import full_operators, full_ports
from lrbc_cli.reduction.outcome import HeldOut, Reduction, ReductionOptions, Step
from lrbc_cli.reduction.ports import PortFrf, port_frf
from lrbc_cli.reduction.reduced import ReducedModel, reference_dynamic
from lrbc_cli.reduction.vectors import certificate_vectors, local_scale, reference_values

log = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]

#: Increased whenever the same input would give another basis.
ALGORITHM_VERSION = 4

#: Expansion points before the estimate takes over.
FIRST_POINTS = 2


class _Clock:
    def __init__(self) -> None:
        self.seconds: dict[str, float] = {"basis": 0.0, "projection": 0.0, "certificate": 0.0, "estimate": 0.0}
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
        high = 2 * np.pi * options.band_hz[1]
        self.scale = local_scale(model.K, model.M, model.terms, high)
        self.reference = reference_values(model.terms, self.scale, high)
        K, C, M = full_operators(model, self.reference)
        self.C, self.M = C, M
        self.Z = DynamicStiffness(K, C, M, model.is_acoustic, backend=backend, ordering=ordering)
        self.inputs = model.inputs
        self.outputs = model.outputs
        # With a symmetric Z and equal left and right vectors only the responses need dual solutions.
        covered = self.Z.symmetric and model.terms.symmetric
        self.dual_rhs = (model.L.T if covered else self.outputs.T).tocsc()
        weight = energy_weight(K, M, high)
        masks = [~model.is_acoustic, model.is_acoustic]
        self.fields = [Field(np.flatnonzero(mask), weight[mask], np.zeros((int(mask.sum()), 0))) for mask in masks if mask.any()]
        self.projection = Projection(
            (K, C, M),
            self.inputs,
            self.outputs,
            self.fields,
            dual=self.dual_rhs,
            residual_weight=energy_weight(K, M, high, RESIDUAL_STIFFNESS),
            transposed=not self.Z.symmetric,
        )
        # Directions far below the tolerance cannot be seen in y, whose error is a product of two such errors.
        self.deflation = 0.1 * options.tolerance
        self.estimator = Estimator(self, count=max(160, 4 * options.held_out))
        self.exact: dict[float, PortFrf] = {}
        self.enriched: list[float] = []
        self.trace: list[Step] = []
        self.full_lines: list[float] = []
        self.clock.lap("basis")

    # -- one factorisation ------------------------------------------------------------------------------------------

    def factor(self, frequency: float) -> tuple[Factorisation, Complexes]:
        """Factorise, solve for all inputs, keep the exact port FRFs."""
        s = 2j * np.pi * frequency
        start = time.perf_counter()
        factorisation = self.Z.factor(s)
        middle = time.perf_counter()
        X = factorisation.solve(self.inputs.toarray())
        after = time.perf_counter()
        if len(self.full_lines) < 5:
            # What one line of the full model costs: this factorisation, one solve, one refinement step.
            factorisation.solve(self.inputs[:, [0]].toarray()[:, 0], refine=1)
            self.full_lines.append(middle - start + time.perf_counter() - after)
        H = np.asarray(self.outputs @ X)[None]
        lines = np.array([s])
        D_ref = reference_dynamic(self.reference, lines)
        self.exact[frequency] = port_frf(H, lines, D_ref, self.model.output_power, self.input_of)
        return factorisation, X

    def order(self) -> int:
        """Moments an expansion point: a second one pays where a factorisation costs far more than a block of solves.

        Decided by fill, not by a stopwatch, so that the same input gives the same basis.
        """
        nonzeros = self.Z.nonzeros * (2 if self.Z.half else 1)
        columns = nonzeros / self.Z.size
        return 2 if columns > 12 * (self.inputs.shape[1] + self.dual_rhs.shape[1]) else 1

    def enrich(self, frequency: float, factorisation: Factorisation, X: Complexes) -> tuple[int, int]:
        """Add the moments at a factorised point to the basis; returns (order, added directions)."""
        s = 2j * np.pi * frequency
        blocks = [X, factorisation.solve_transposed(self.dual_rhs.toarray())]
        order = self.order()
        if order > 1:
            # Second moment, X1 = -Z⁻¹ (2 s M + C) X0.
            slope = (2 * s * self.M + self.C).tocsr()
            blocks += [-factorisation.solve(slope @ blocks[0]), -factorisation.solve_transposed(slope.T @ blocks[1])]
        snapshots = np.hstack(blocks)
        new = self.limited([new_directions(f, snapshots[f.dofs], self.deflation) for f in self.fields])
        self.clock.lap("basis")
        self.projection.extend(new)
        self.clock.lap("projection")
        self.enriched.append(frequency)
        return order, sum(block.shape[1] for block in new)

    def limited(self, new: list[Floats]) -> list[Floats]:
        """New directions, cut to ``max_size`` in proportion of the fields; they come in order of their singular values."""
        limit = self.options.max_size
        total = sum(block.shape[1] for block in new)
        if limit is None or self.projection.size + total <= limit:
            return new
        share = max(limit - self.projection.size, 0) / total
        return [block[:, : int(share * block.shape[1])] for block in new]

    # -- errors -----------------------------------------------------------------------------------------------------

    def reduced(self) -> ReducedModel:
        """The reduced model on the basis so far."""
        P, R = self.projection, self.model.L.shape[0]
        n_in = self.model.B.shape[1]
        inputs, outputs = P.inputs, P.outputs
        left, right = inputs[:, n_in:], outputs[R:].T
        K, C, M = (P.operator(i) - (left * self.reference[:, i]) @ right.T for i in range(3))
        structure = P.sizes[0] if not self.model.is_acoustic.all() else 0
        return ReducedModel(
            K, C, M, inputs[:, :n_in], outputs[:R], left, right, self.model.output_power, self.input_of, self.reference, structure
        )

    def projected_groups(self) -> dict[str, dict[str, Any]]:
        """Vᵀ A V of the further groups of factors."""
        return {name: {key: self.projection.project(A) for key, A in group.items()} for name, group in self.model.extras.items()}

    def errors(self, frequency: float, model: ReducedModel) -> dict[str, float]:
        """Measured relative error of y at a factorised line, by kind of parameter vector."""
        exact = self.exact[frequency]
        return port_errors(self.model, self.scale, exact, model.ports(exact.s, workers=1))

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
        low, high = options.band_hz
        grid = self.estimator.grid_hz
        angles = np.pi * (np.arange(FIRST_POINTS) + 0.5) / FIRST_POINTS
        for frequency in 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angles):
            self._expand(float(frequency), progress)
        held_out: list[float] = []
        effectivity = 1.0
        # Valid for the basis as it is: emptied whenever it grows.
        measured: dict[float, dict[str, float]] = {}
        estimate: Floats | None = None
        while True:
            if estimate is None:
                estimate = self.estimator.estimate()
                self.clock.lap("estimate")
            frequency = self._next(estimate, held_out)
            expected = float(np.interp(frequency, grid, estimate))
            model = self.reduced()
            factorisation, X = self.factor(frequency)
            measured[frequency] = self.errors(frequency, model)
            error = max(measured[frequency].values())
            if expected > 0:
                effectivity = max(effectivity, min(error / expected, 10.0))
            needs = error > 0.5 * options.tolerance or float(estimate.max()) * effectivity > 3 * options.tolerance
            order = added = 0
            if needs and len(self.enriched) < options.max_points and self.projection.size < (options.max_size or np.inf):
                self.clock.lap("certificate")
                order, added = self.enrich(frequency, factorisation, X)
                # Nothing new although the error is too large: the deflation hides what is missing.
                if added == 0:
                    self.deflation *= 0.1
                    if self.deflation < 1e-12:
                        held_out.append(frequency)
            else:
                held_out.append(frequency)
                self.clock.lap("certificate")
            self._record(frequency, order, added, error, estimate)
            progress(
                f"{frequency:8.2f} Hz  r = {self.projection.size:4d}  measured error {error:.1e}  "
                + (f"expansion point, +{added}" if order else "held out")
            )
            if added:
                estimate, measured = None, {}
            if len(held_out) >= options.held_out:
                break
        return self._finish(held_out, measured)

    def _expand(self, frequency: float, progress: Callable[[str], None]) -> None:
        factorisation, X = self.factor(frequency)
        order, added = self.enrich(frequency, factorisation, X)
        self._record(frequency, order, added, None, np.full(self.estimator.grid_hz.size, np.nan))
        progress(f"{frequency:8.2f} Hz  r = {self.projection.size:4d}  expansion point, +{added}")

    def _record(self, frequency: float, order: int, added: int, error: float | None, estimate: Floats) -> None:
        self.trace.append(Step(frequency, self.projection.size, order, added, error, self.estimator.grid_hz, estimate))

    def _next(self, estimate: Floats, held_out: list[float]) -> float:
        """The line with the worst estimate, away from expansion points, and the held-out lines spread over the band."""
        grid = self.estimator.grid_hz
        low, high = self.options.band_hz
        width = high - low

        def apart(lines: list[float]) -> Floats:
            return np.asarray(np.abs(grid[:, None] - np.array([*lines, np.inf])[None, :]).min(axis=1))

        points, checks = apart(self.enriched), apart(held_out)
        allowed = (points > 0.01 * width) & (checks > 0.5 * width / self.options.held_out)
        weight = np.where(allowed, estimate, 0.0)
        if not np.any(weight > 0):
            weight = np.minimum(points, checks)
        return float(grid[int(np.argmax(weight))])

    def _finish(self, held_out: list[float], measured: dict[float, dict[str, float]]) -> Reduction:
        for f in self.fields:
            check_orthonormal(f)
        model = replace(self.reduced(), extras=self.projected_groups())
        # The basis may have grown after a line was held out: all errors are those of the final model.
        lines = tuple(HeldOut(f, measured.get(f) or self.errors(f, model)) for f in sorted(held_out))
        tolerance = self.options.tolerance
        self.clock.lap("certificate")
        seconds = dict(self.clock.seconds)
        seconds["full_line"] = float(np.median(self.full_lines))
        seconds["factor"] = float(np.median(self.Z.factor_seconds))
        seconds["total"] = time.perf_counter() - self.clock.start
        vectors = sum(len(v) for v in certificate_vectors(self.model.terms, self.scale, np.array([1j])).values())
        reached = all(line.worst <= tolerance for line in lines)
        return Reduction(
            model,
            self.options,
            reached,
            lines,
            tuple(self.trace),
            seconds,
            self.Z.backend,
            self.Z.coupling.text,
            tuple(self.projection.sizes),
            self.model.size,
            vectors,
            {"platform": platform.platform(), "processor": platform.processor() or platform.machine(), "cores": os.cpu_count() or 1},
            datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
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
        return Reducer(model, input_of, options, backend=backend, ordering=ordering).run(progress)


__all__ = ["HeldOut", "Reducer", "Reduction", "ReductionOptions", "Step", "full_operators", "full_ports", "reduce_model"]
