"""What ``sizes.py`` measures, each in a process of its own so that its peak memory is its own: ``python sizes_work.py TASK FILE``.

FILE is a JSON document with the arguments of the task; its result is written to the same file.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import measure
import numpy as np
import scipy.linalg as la

from lrbc_cli.campaign.identification.identify import identify
from lrbc_cli.campaign.identification.unknowns import parameterise
from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.stage import ReductionStage, frf_source, line_seconds
from lrbc_cli.config import load_campaign
from lrbc_cli.reduction.build import Reduction, ReductionOptions, full_operators, reduce_model
from lrbc_cli.reduction.problem.vectors import local_scale, reference_values
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.solve.dynamic import DynamicStiffness
from lrbc_cli.updating.misfit.cost import Misfit

MB = 1e6


def peak() -> float:
    """Largest resident memory of this process so far [MB]."""
    status = Path("/proc/self/status")
    if status.is_file():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / MB
    # Kilobytes on Linux, bytes on macOS; Linux counts what the process was before it started Python, too.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / MB


def _inputs(config: str, backend: str, *overrides: str, fixed: bool = False) -> Inputs:
    """Inputs of a campaign; with start values and bounds that need not be found where `fixed`."""
    asked = [f"reduction.backend={backend}", *overrides]
    if fixed:
        groups = load_campaign(Path(config)).parameters
        asked += [text for name in groups for text in (f"parameters.{name}.initial=3.0", f"parameters.{name}.bounds=[-1.0, 6.0]")]
    return read_as_exported(load_campaign(Path(config), asked))


def one_factorisation(config: str, backend: str, lines: int) -> dict[str, Any]:
    """Read the model, analyse and factorise it once: seconds and peak memory of that; then full lines, their median."""
    start = time.perf_counter()
    inputs = _inputs(config, backend)
    read, read_peak = time.perf_counter() - start, peak()
    model, (low, upper) = inputs.model, inputs.campaign.reduction.band
    high = 2 * np.pi * upper
    reference = reference_values(model.terms, local_scale(model.K, model.M, model.terms, high), high)
    start = time.perf_counter()
    Z = DynamicStiffness(*full_operators(model, reference), model.is_acoustic, backend=backend)
    prepared = time.perf_counter() - start
    Z.factor(1j * high)
    factor_peak, nonzeros, first = peak(), Z.nonzeros, Z.factor_seconds[0]
    line, _ = measure.full_lines(Z, inputs, np.linspace(low, upper, lines + 2)[1:-1])
    return {
        "n": model.size,
        "terms": model.terms.size,
        "nnz_stiffness": int(model.K.nnz),
        "nnz_factors": nonzeros,
        "read_s": read,
        "prepare_s": prepared,
        "first_factor_s": first,
        "full_line_s": line,
        "read_peak_mb": read_peak,
        "factor_peak_mb": factor_peak,
    }


def one_reduction(config: str, backend: str, folder: str, cost_lines: int = 0) -> dict[str, Any]:
    """Read the model and reduce it with certificate, cold; then keep it, and time the cost with its gradient on so many lines."""
    start = time.perf_counter()
    inputs = _inputs(config, backend)
    read = time.perf_counter() - start
    settings = inputs.campaign.reduction
    options = ReductionOptions(band_hz=settings.band, tolerance=settings.tolerance, held_out=settings.held_out, max_size=settings.max_size)
    start = time.perf_counter()
    reduction = reduce_model(inputs.model, inputs.input_of, options, backend=backend)
    seconds, high = time.perf_counter() - start, peak()
    start = time.perf_counter()
    parts = cache.key_parts(inputs)
    key = time.perf_counter() - start
    reduction = replace(reduction, seconds=reduction.seconds | line_seconds(reduction.model, settings.band))
    cache.store(cache.look_up(Path(folder), parts), parts, reduction)
    found = {
        "n": inputs.model.size,
        "terms": inputs.model.terms.size,
        "read_s": read,
        "key_s": key,
        "reduction_s": seconds,
        "reduction_peak_mb": high,
        "stages_s": {name: value for name, value in reduction.seconds.items() if name in measure.STAGES},
        "own_full_line_s": reduction.seconds["full_line"],
        "r": reduction.model.size,
        "sizes": list(reduction.sizes),
        "factorisations": len(reduction.trace),
        "points": sum(1 for step in reduction.trace if step.order),
        "worst": reduction.worst,
        "reached": reduction.reached,
    }
    if cost_lines:
        inputs = _inputs(config, backend, fixed=True)
        found |= cost(inputs, stage_from(inputs, Path(folder)), cost_lines)
    return found


def stage_from(inputs: Inputs, folder: Path) -> ReductionStage:
    """The reduced model that an earlier process kept."""
    decision = cache.look_up(folder, cache.key_parts(inputs))
    if not decision.hit:
        raise SystemExit(f"{inputs.campaign.name}: {decision.reason}")
    return ReductionStage(cache.load(decision, inputs), decision, 0.0)


def cost(inputs: Inputs, stage: ReductionStage, count: int, repeats: int = 5) -> dict[str, Any]:
    """Seconds of the port FRFs of `count` lines, once, and of one evaluation of the cost (29) with its gradient on them."""
    s = 2j * np.pi * np.linspace(*inputs.campaign.reduction.band, count)
    for old in stage.decision.path.parent.glob("ports-*.h5"):
        old.unlink()
    source = frf_source(inputs, stage)
    parameters, _ = parameterise(inputs, source, s)
    for old in stage.decision.path.parent.glob("ports-*.h5"):
        old.unlink()
    fresh = frf_source(inputs, stage)
    start = time.perf_counter()
    model = fresh.model(s, parameters, None, inputs.used)
    table = time.perf_counter() - start
    # A measurement that is not the model's own, so that no residual vanishes.
    theta = parameters.initial
    misfit = Misfit(model, 1.1 * model.frf(theta - 0.5), theta, 0.04)
    return {"cost_lines": count, "table_s": table, "cost_s": measure.timed(lambda: misfit(theta), repeats), "unknowns": theta.size}


def costs(config: str, backend: str, folder: str, counts: list[int]) -> dict[str, Any]:
    """``cost`` for several numbers of lines, interleaved three times; medians."""
    inputs = _inputs(config, backend, fixed=True)
    stage = stage_from(inputs, Path(folder))
    runs = [[cost(inputs, stage, count) for count in counts] for _ in range(3)]
    rows = [
        {"lines": count} | {key: float(np.median([run[i][key] for run in runs])) for key in ("table_s", "cost_s")}
        for i, count in enumerate(counts)
    ]
    return {"rows": rows, "r": stage.reduction.model.size, "terms": inputs.model.terms.size}


def padded(model: ReducedModel, size: int) -> ReducedModel:
    """The same FRFs from a larger model: oscillators far above every band that nothing drives, at the end of the acoustic field."""
    more = size - model.size
    if more <= 0:
        return model
    air = slice(model.structure, None) if model.structure < model.size else slice(None)
    mass = float(np.mean(np.diag(model.M)[air]))
    stiffness = 1e3 * float(np.abs(np.diag(model.K)).max())

    def block(A: Any, value: float) -> Any:
        return la.block_diag(A, value * np.eye(more))

    def wide(A: Any, axis: int) -> Any:
        return np.concatenate([A, np.zeros((more, A.shape[1]) if axis == 0 else (A.shape[0], more))], axis=axis)

    extras = {name: {key: block(A, 0.0) for key, A in group.items()} for name, group in model.extras.items()}
    K, C, M = block(model.K, stiffness), block(model.C, 0.0), block(model.M, mass)
    left, right = wide(model.left, 0), wide(model.right, 0)
    return replace(model, K=K, C=C, M=M, B=wide(model.B, 0), L=wide(model.L, 1), left=left, right=right, extras=extras)


def identifications(configs: list[str], backend: str, folder: str, job: str, repeats: int) -> dict[str, Any]:
    """One identification on each model from its cached reduced model: equal r by padding, interleaved against drift of the machine."""
    loaded = []
    for config in configs:
        inputs = _inputs(config, backend, "update.approach=paper", "update.regularisation=0.04")
        loaded.append((inputs, stage_from(inputs, Path(folder))))
    size = max(stage.reduction.model.size for _, stage in loaded)
    ready = [(inputs, _with(stage, padded(stage.reduction.model, size))) for inputs, stage in loaded]
    runs: list[list[Any]] = [[] for _ in ready]
    for _ in range(repeats):
        for i, (inputs, stage) in enumerate(ready):
            for old in stage.decision.path.parent.glob("ports-*.h5"):
                old.unlink()
            used = time.process_time()
            found_now = identify(inputs, frf_source(inputs, stage), job)
            runs[i].append(replace(found_now, seconds=found_now.seconds | {"processor": time.process_time() - used}))
    rows = []
    for (inputs, _), (_, kept), found in zip(ready, loaded, runs, strict=True):
        evaluations = found[0].line_evaluations / found[0].selected.size
        seconds = {key: float(np.median([run.seconds[key] for run in found])) for key in ("read", "port", "optimise", "total", "processor")}
        rows.append(
            {
                "n": inputs.model.size,
                "r": kept.reduction.model.size,
                "unknowns": int(found[0].parameters.initial.size),
                "lines": int(found[0].selected.size),
                "evaluations": evaluations,
                "seconds": seconds,
                # The fastest run is the one that other processes disturbed least.
                "per_evaluation_s": min(run.seconds["optimise"] for run in found) / evaluations,
                "misfit_db": float(np.mean(found[0].misfit_final[inputs.used])),
            }
        )
    return {"r": size, "repeats": repeats, "rows": rows}


def _with(stage: ReductionStage, model: ReducedModel) -> ReductionStage:
    reduction: Reduction = replace(stage.reduction, model=model)
    return replace(stage, reduction=reduction)


TASKS: dict[str, Callable[..., dict[str, Any]]] = {
    task.__name__: task for task in (one_factorisation, one_reduction, costs, identifications)
}


def main() -> None:
    """Run one task."""
    task, file = sys.argv[1], Path(sys.argv[2])
    arguments = json.loads(file.read_text(encoding="utf-8"))
    file.write_text(json.dumps(TASKS[task](**arguments)), encoding="utf-8")


if __name__ == "__main__":
    main()
