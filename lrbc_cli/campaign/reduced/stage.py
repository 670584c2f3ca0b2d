"""Obtains the reduced model of a campaign (from the cache, or by a reduction), and gives FRFs of the model to all other steps.

``FrfSource`` is the interface: FRFs as a function of theta by interface FRFs (ports), the reduced matrices, or the full model.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from timeit import repeat
from typing import Any, ClassVar

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.reading.doubts.springs import lacking_springs
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.memory import options_of, require_memory
from lrbc_cli.campaign.structure import drawn_dofs
from lrbc_cli.errors import DataError, NumericalError, listing
from lrbc_cli.io.atomic import remove_leftovers
from lrbc_cli.method.resolve import formula
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.outcome import Reduction
from lrbc_cli.reduction.reduced.affine import AffineModel
from lrbc_cli.reduction.reduced.many import ports_of
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import PortFrf
from lrbc_cli.reduction.threads import in_turn, single_threaded
from lrbc_cli.updating.misfit.extended import ExtendedFrf
from lrbc_cli.updating.misfit.frf import FrfModel, port_model, reduced_model
from lrbc_cli.updating.misfit.nuisances import Nuisance

log = logging.getLogger(__name__)

#: Ratio of the error bound at unsolved lines to the tolerance from which a warning is given.
FAR_ABOVE = 10.0

#: If the errors at held-out lines are below this share of the tolerance, a large bound is due to their small number; this many mostly
#: suffice.
_LOW, _ENOUGH = 0.1, 12


@dataclass(frozen=True)
class ReductionStage:
    """A reduced model and its origin.

    Attributes
    ----------
    reduction : Reduction
    decision : CacheDecision
    seconds : float
        Time for reading it from the cache or for the reduction, in this call.
    rows : (k, r) float array or None
        Rows of the basis at those of ``drawn_dofs`` that exist.
    """

    reduction: Reduction
    decision: cache.CacheDecision
    seconds: float
    rows: Floats | None = field(default=None, repr=False)


def with_rows(inputs: Inputs, stage: ReductionStage) -> tuple[ReductionStage, str]:
    """The stage with the rows of the basis at the drawn nodes, from the cache; and the reason if they are needed but missing."""
    dofs = drawn_dofs(inputs)
    if not dofs.size:
        return stage, ""
    rows, reason = cache.load_rows(stage.decision, stage.reduction, dofs[dofs >= 0])
    return replace(stage, rows=rows), reason


def obtain_reduction(
    inputs: Inputs,
    folder: Path,
    *,
    force: bool = False,
    accept: bool = False,
    progress: Callable[[str], None] = lambda _: None,
    missed: Callable[[ReductionStage], object] = lambda _: None,
) -> ReductionStage:
    """Reduced model from the cache, or built and stored there.

    Parameters
    ----------
    inputs : Inputs
    folder : Path
        Folder of the cache.
    force : bool
        Reduce again even if the cache contains the model.
    accept : bool
        Accept a model that misses the tolerance.
    progress : callable
    missed : callable
        Called with a model that misses the tolerance and is not accepted, before the error is raised.

    Returns
    -------
    ReductionStage

    Raises
    ------
    ConfigError
        If the cache cannot be written.
    DataError
        See ``require_baselines``.
    NumericalError
        If there is not enough memory, or if the tolerance is missed and that is not accepted; the model is stored all the same.
    """
    start = time.perf_counter()
    parts = cache.key_parts(inputs)
    decision = cache.look_up(folder, parts)
    remove_leftovers(decision.path.parent)
    reduction: Reduction | None = None
    if decision.hit and not force:
        decision, reduction = _cached(inputs, decision)
    elif decision.hit:
        decision = replace(decision, hit=False, reason="--force")
    elif decision.path.is_file():
        log.warning("the cached reduced model is built anew (%s: %s)", decision.path, decision.reason)
    if reduction is None:
        reduction = _built_and_kept(inputs, decision, parts, progress)
    require_baselines(inputs, reduction.model)
    stage = ReductionStage(reduction, decision, time.perf_counter() - start)
    if not reduction.reached and not accept:
        missed(stage)
        raise _missed(inputs, stage)
    return stage


def require_baselines(inputs: Inputs, model: ReducedModel, *, share: float = 1e-3, rounding: float = 1e-11) -> None:
    """Check that the stiffness matrix contains the baselines: after their subtraction no motion may have negative stiffness.

    Parameters
    ----------
    inputs : Inputs
    model : ReducedModel
        With the baselines subtracted.
    share : float
        Share of the stiffness subtracted from a motion that may be missing in the matrix.
    rounding : float
        Negative stiffness attributed to rounding, relative to the largest stiffness.

    Raises
    ------
    DataError
        If a motion has a negative stiffness beyond both.
    """
    baseline = np.zeros(inputs.model.terms.size)
    for one in inputs.groups:
        baseline[one.terms] = one.config.baseline if one.config.kind == "stiffness" else 0.0
    found = _lacking(model, baseline, share, rounding)
    if found is None:
        return
    lacking, each = found
    group = max(inputs.groups, key=lambda one: float(each[one.terms].sum()))
    full, terms = inputs.model, inputs.model.terms
    exported = replace(full, K=(full.K + (terms.left * baseline) @ terms.right.T).tocsc())
    hint = lacking_springs(exported, group, inputs.dofs, inputs.bolts) or _of_some_bolts(inputs, model, baseline, share, rounding)
    hint = hint or "remove `baseline` if the matrix was exported without the springs; otherwise give the stiffness that it contains"
    raise DataError(
        f"parameters.{group.name}.baseline: the stiffness matrix does not contain what is subtracted from it",
        file=inputs.campaign.path,
        expected="a matrix that was exported with these springs, and their stiffness as the baseline",
        found=f"a motion whose stiffness in the matrix is {_share(1.0 - lacking / float(each.sum()))} of what baselines subtract from it",
        hint=hint if not inputs.warnings else f"first fix the causes of these warnings: {'; '.join(inputs.warnings)}",
    )


def _lacking(model: ReducedModel, baseline: Floats, share: float, rounding: float) -> tuple[float, Floats] | None:
    """Negative stiffness of the softest motion, and (m,) what ``baseline`` subtracts from it by term; None if it is none beyond the limits.

    ``model`` is the one from which these baselines are subtracted.
    """
    if not baseline.any():
        return None
    n = model.structure
    K, left, right = model.K.real[:n, :n], model.left[:n].real, model.right[:n].real
    values, vectors = np.linalg.eigh(0.5 * (K + K.T))
    x = vectors[:, 0]
    each = baseline * (left.T @ x) * (right.T @ x)
    lacking = -float(x @ K @ x)
    return None if values[0] > -rounding * np.abs(values).max() or lacking < share * float(each.sum()) else (lacking, each)


def _of_some_bolts(inputs: Inputs, model: ReducedModel, baseline: Floats, share: float, rounding: float) -> str:
    """Hint that names bolts whose springs the stiffness matrix does not contain, while it contains those of the others; else empty."""
    if inputs.bolts is None:
        return ""
    owner = np.full(baseline.size, -1)
    for one in inputs.groups:
        if one.bolt is not None:
            owner[one.terms] = one.bolt[one.parameter]
    n = model.structure
    left, right = model.left[:n].real, model.right[:n].real
    held, lacking = np.unique(owner[(owner >= 0) & (baseline != 0.0)]).tolist(), list[str]()
    for bolt in held:
        # As exported, without the springs of this bolt alone.
        others = np.where(owner == bolt, 0.0, baseline)
        K = model.K.copy()
        K[:n, :n] += (left * others) @ right.T
        if _lacking(replace(model, K=K), baseline - others, share, rounding) is not None:
            lacking.append(inputs.bolts.name[bolt])
    if not lacking or len(lacking) == len(held):
        return ""
    return (
        f"it contains the springs of the other bolts, but not those of {listing(lacking, 12)}, or not as stiff: check whether it was "
        "exported with these springs missing, and export it with all of them; otherwise correct their stiffnesses in the table"
    )


def _share(value: float) -> str:
    """A share in words."""
    return f"{100.0 * value:.3g} %" if 0.01 <= value < 10.0 else "less than 1 %" if value < 0.01 else f"{value:.3g} times"


def _cached(inputs: Inputs, decision: cache.CacheDecision) -> tuple[cache.CacheDecision, Reduction | None]:
    """The model from the cache; None, and why it is a miss, if its file is damaged or its basis cannot be read."""
    try:
        reduction = cache.load(decision, inputs)
    except DataError as error:
        told, reason = error.problem, "the file in the cache is damaged"
    else:
        # Without its basis, the jobs identified with it would stay without deflection shapes.
        told = reason = cache.rows_fault(decision) if drawn_dofs(inputs).size else ""
        if not reason:
            return decision, reduction
    log.warning("the cached reduced model is built anew (%s: %s)", decision.path, told)
    return replace(decision, hit=False, reason=reason), None


def _built_and_kept(inputs: Inputs, decision: cache.CacheDecision, parts: dict[str, str], progress: Callable[[str], None]) -> Reduction:
    # Imported here because most calls find the model in the cache.
    from lrbc_cli.reduction.build import reduce_model

    settings = inputs.campaign.reduction
    cache.require_writable(decision)
    require_memory(inputs)
    dofs = drawn_dofs(inputs)
    reduction = reduce_model(
        inputs.model,
        inputs.input_of,
        options_of(inputs),
        backend=settings.backend,
        progress=progress,
        rows=dofs[dofs >= 0] if dofs.size else None,
    )
    if reduction.reached and reduction.unseen > FAR_ABOVE * reduction.options.tolerance:
        log.warning(
            "the reduced model reaches its tolerance of %.1e at the held-out lines, but the bound for the other lines is %.1e: %s",
            reduction.options.tolerance,
            reduction.unseen,
            bound_hint(reduction.worst, reduction.options.tolerance, len(reduction.held_out)),
        )
    reduction = replace(reduction, seconds=reduction.seconds | line_seconds(reduction.model, settings.band))
    # The model comes last: a process that is killed in between leaves nothing that counts as finished.
    if reduction.rows is not None:
        cache.store_rows(decision, reduction, dofs[dofs >= 0])
    cache.store(decision, parts, reduction)
    return replace(reduction, rows=None)


def bound_hint(worst: float, tolerance: float, lines: int) -> str:
    """Remedy if the error bound at unsolved lines is above the tolerance.

    Parameters
    ----------
    worst : float
        Largest relative error at the lines that were solved.
    tolerance : float
    lines : int
        Number of these lines.
    """
    if worst > _LOW * tolerance:
        return "lower reduction.tolerance or raise reduction.held_out"
    return (
        f"no measured error is above {worst:.1e}, but {lines} lines are too few to bound the others. Write reduction.held_out: "
        f"{max(2 * lines, _ENOUGH)}; a lower tolerance hardly helps"
    )


def _missed(inputs: Inputs, stage: ReductionStage) -> NumericalError:
    reduction, size, limit = stage.reduction, stage.reduction.model.size, stage.reduction.options.max_size
    hint = "raise reduction.tolerance" + (" or reduction.max_size" if limit is not None and size >= limit else "")
    hint += ", or accept it with --accept-tolerance"
    if size >= inputs.model.size:
        hint = "the remaining error is rounding where the responses are silent: use other responses, or --accept-tolerance"
    return NumericalError(
        "the reduced model does not reach its tolerance" + (f" (stopped by: {reduction.stopped})" if reduction.stopped else ""),
        expected=f"a measured error of at most {reduction.options.tolerance:.1e}",
        found=f"{reduction.worst:.1e} with {size} DOFs; it is kept in {stage.decision.path}",
        hint=hint,
    )


def affine_model(inputs: Inputs, stage: ReductionStage) -> AffineModel:
    """The reduced model as a function of global factors and hammer offsets; factors of 1 give ``inputs.model``."""
    omega = 2.0 * np.pi * float(np.sqrt(np.prod(inputs.campaign.reduction.band)))
    return AffineModel(stage.reduction.model, inputs.recipe, inputs.shifts).diagonalised(omega)


def line_seconds(model: ReducedModel, band: tuple[float, float]) -> dict[str, float]:
    """Time for one line [s] of the reduced dynamic stiffness, and of the interface FRFs with derivatives (Table 4 of the paper)."""
    s = 2j * np.pi * np.linspace(*band, 32)
    D = model.reference_dynamic(s)
    ports = model.ports(s, workers=1)

    def best(work: Callable[[], object]) -> float:
        return min(repeat(work, number=1, repeat=3)) / s.size

    return {"reduced_line": best(lambda: model.evaluate(s, D, workers=1)), "port_line": best(lambda: ports.linearise(D))}


@dataclass(kw_only=True)
class FrfSource:
    """FRFs of the model on any lines; interface FRFs are computed once per set of lines and stored beside the reduced model.

    Attributes
    ----------
    inputs : Inputs
    stage : ReductionStage or None
        None only for full-order evaluation.
    kind : str
        ``port`` (interface FRFs of the reduced model), ``reduced`` (its matrices) or ``full`` (interface FRFs of the full model).
    known : dict
        Results on sets of lines, stored by other modules for reuse.
    most_lines : int or None
        Largest number of lines on which bounds and start values that are ``auto`` are found; None for all.
    """

    most_lines: ClassVar[int | None] = None

    inputs: Inputs = field(repr=False)
    stage: ReductionStage | None
    kind: str
    progress: Callable[[str], None] = field(default=lambda _: None, repr=False)
    known: dict[bytes, Any] = field(default_factory=dict, repr=False)
    _tables: dict[bytes, PortFrf] = field(default_factory=dict, repr=False)
    _parts: dict[str, str] = field(default_factory=dict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle inputs, stage and kind only; tables are computed again in the other process."""
        return partial(FrfSource, inputs=self.inputs, stage=self.stage, kind=self.kind), ()

    @contextmanager
    def threads(self) -> Iterator[None]:
        """Context for many evaluations: single-threaded algebra; with the full model, whose solver has threads, one user at a time."""
        with single_threaded(), nullcontext() if self.stage is not None else in_turn():
            yield

    @property
    def parts(self) -> dict[str, str]:
        """``cache.key_parts`` of the inputs, computed once."""
        if not self._parts:
            self._parts.update(cache.key_parts(self.inputs))
        return self._parts

    def table(self, s: Complexes) -> PortFrf:
        """Interface FRFs for all responses at the lines s (i omega)."""
        with self._lock:
            key = s.tobytes()
            if key not in self._tables:
                self._tables[key] = self._compute(s)
            return self._tables[key]

    def _compute(self, s: Complexes) -> PortFrf:
        # A worker on another machine has no such cache.
        decision = self.stage.decision if self.stage and self.stage.decision.path.parent.is_dir() else None
        found = cache.load_ports(decision, s, self.kind, self.inputs) if decision else None
        if found is not None:
            return found
        if self.kind == "full":
            from lrbc_cli.reduction.problem.full import full_ports

            settings = self.inputs.campaign.reduction

            def tell(done: int, count: int) -> None:
                self.progress(f"full model: line {done} of {count}")

            ports = full_ports(self.inputs.model, self.inputs.input_of, s, settings.band, backend=settings.backend, progress=tell)
        else:
            assert self.stage is not None
            ports = ports_of(self.stage.reduction.model, s)
        if decision:
            cache.store_ports(decision, s, self.kind, ports)
        return ports

    def model(
        self, s: Complexes, parameters: Parameterisation, lines: Integers | None = None, responses: Integers | None = None
    ) -> FrfModel:
        """FRFs as a function of theta, on some of the lines s and for some of the responses (None: all)."""
        rows = np.arange(len(self.inputs.responses)) if responses is None else responses
        at = np.arange(s.size) if lines is None else lines
        if self.kind == "reduced":
            assert self.stage is not None
            return reduced_model(self.stage.reduction.model, s[at], parameters, rows)
        return port_model(self.table(s).select(at, rows), parameters)

    def drifting(
        self, s: Complexes, parameters: Parameterisation, nuisances: Sequence[Nuisance], responses: Integers | None = None
    ) -> ExtendedFrf:
        """FRFs of the reduced model as a function of theta and nuisance parameters."""
        assert self.stage is not None
        rows = np.arange(len(self.inputs.responses)) if responses is None else responses
        return ExtendedFrf(affine_model(self.inputs, self.stage), s, parameters, nuisances, rows)


def frf_source(inputs: Inputs, stage: ReductionStage | None, progress: Callable[[str], None] = lambda _: None) -> FrfSource:
    """Source of FRFs of the reduced model, by the ``formula`` that the settings state; of the full model if there is no reduced one."""
    evaluation = inputs.campaign.update.evaluation
    kind = "full" if stage is None else formula(evaluation, inputs.model.terms.size, stage.reduction.model.size)
    return FrfSource(inputs=inputs, stage=stage, kind=kind, progress=progress)


def obtain_source(inputs: Inputs, folder: Path, *, accept: bool = False, progress: Callable[[str], None] = lambda _: None) -> FrfSource:
    """Source of FRFs for the identification of jobs, see ``obtain_reduction``; without reduced model if the method is full-order."""
    stage = None if inputs.method.full_order else obtain_reduction(inputs, folder, accept=accept, progress=progress)
    return frf_source(inputs, stage, progress)
