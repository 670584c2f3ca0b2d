"""What ``run.py`` measures: each function takes what it needs and returns rows of the table."""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg as la
from numpy.typing import NDArray

from lrbc_cli.campaign.identification.identify import identify
from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.identification.unknowns import parameterise, select_lines
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.stage import ReductionStage, frf_source
from lrbc_cli.reduction.build import Reduction, ReductionOptions, full_operators, full_ports, reduce_model
from lrbc_cli.reduction.problem.vectors import local_scale, reference_values
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.solve.dynamic import DynamicStiffness
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.statistics.decibels import decibel

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]

#: The paper's own figures in units of its full line (0.206 s).
PAPER_REDUCTION, PAPER_LINE, PAPER_IDENTIFICATION = 2518, 86, 2794

#: Of the seconds of a reduction.
STAGES = ("basis", "projection", "estimate", "compression", "certificate")


@dataclass(frozen=True)
class Figure:
    """One row.

    Attributes
    ----------
    part : str
        Heading under which it stands.
    name : str
    value : float
    text : str
        As shown.
    target : str
        Empty where there is none.
    holds : bool or None
        Whether the target is reached.
    """

    part: str
    name: str
    value: float
    text: str
    target: str = ""
    holds: bool | None = None


def at_most(part: str, name: str, value: float, limit: float, text: str, target: str) -> Figure:
    """A figure with an upper limit."""
    return Figure(part, name, value, text, target, bool(value <= limit))


def timed(work: Callable[[], object], repeats: int) -> float:
    """Median seconds of some calls."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def duration(seconds: float) -> str:
    """Seconds in a unit that suits them."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def machine() -> dict[str, Any]:
    """Where this is measured, and how busy it was before."""
    processor = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line.split(":", 1)[1].strip() for line in info.read_text(encoding="utf-8").splitlines() if line.startswith("model name")]
        processor = names[0] if names else processor
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "platform": platform.platform(),
        "processor": processor,
        "cores": usable,
        "threads": os.environ.get("OMP_NUM_THREADS", "not limited"),
        "load_before": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }


def processor_seconds() -> tuple[float, float]:
    """Seconds of all cores that anyone used since the machine started, and that this process and its finished children used."""
    own = os.times()
    stat = Path("/proc/stat")
    everyone = float("nan")
    if stat.is_file():
        user, nice, system, _idle, _wait, *rest = (float(word) for word in stat.read_text(encoding="utf-8").split("\n", 1)[0].split()[1:])
        # Interrupts and what the host takes away count as busy; guests are in user already.
        everyone = (user + nice + system + sum(rest[:3])) / os.sysconf("SC_CLK_TCK")
    return everyone, own.user + own.system + own.children_user + own.children_system


def full_lines(Z: DynamicStiffness, inputs: Inputs, frequencies: Floats) -> tuple[float, float]:
    """Median seconds of a full line on an analysed pattern, and of its factorisation."""
    b = inputs.model.B[:, [0]].toarray()[:, 0]
    times, factors = [], []
    for frequency in frequencies:
        start = time.perf_counter()
        factorisation = Z.factor(2j * np.pi * float(frequency))
        factors.append(time.perf_counter() - start)
        factorisation.solve(b, refine=1)
        times.append(time.perf_counter() - start)
    return float(np.median(times)), float(np.median(factors))


def full_line(inputs: Inputs, backend: str) -> tuple[float, list[Figure]]:
    """Factorisation on an analysed pattern, one solve, one refinement step; median of five lines (seconds)."""
    model, (low, upper) = inputs.model, inputs.campaign.reduction.band
    high = 2 * np.pi * upper
    reference = reference_values(model.terms, local_scale(model.K, model.M, model.terms, high), high)
    Z = DynamicStiffness(*full_operators(model, reference), model.is_acoustic, backend=backend)
    start = time.perf_counter()
    Z.factor(2j * np.pi * upper)
    first = time.perf_counter() - start
    line, factor = full_lines(Z, inputs, np.linspace(low, upper, 7)[1:-1])
    part = "Full model"
    text = f"{line:.3f} s (factorisation {factor:.3f} s; the first, with analysis, {first:.2f} s)"
    return line, [Figure(part, f"full line, {model.size} DOFs, {backend}", line, text)]


def cold_reduction(inputs: Inputs, backend: str, repeats: int) -> tuple[Reduction, float]:
    """A whole reduction with its certificate; seconds of the fastest, which other processes disturbed least."""
    settings = inputs.campaign.reduction
    options = ReductionOptions(band_hz=settings.band, tolerance=settings.tolerance, held_out=settings.held_out, max_size=settings.max_size)
    runs = []
    for _ in range(repeats):
        start = time.perf_counter()
        reduction = reduce_model(inputs.model, inputs.input_of, options, backend=backend)
        runs.append((time.perf_counter() - start, reduction))
    seconds, reduction = min(runs, key=lambda run: run[0])
    return reduction, seconds


def reduction_figures(r: Reduction, seconds: float, line: float) -> list[Figure]:
    """What a reduction cost and what it reached."""
    part = "Reduction"
    points = sum(1 for step in r.trace if step.order)
    done = sum(1 for step in r.trace if np.isfinite(step.frequency_hz))
    worth = seconds / line
    own = r.seconds["full_line"]
    cost = f"{seconds:.2f} s = {worth:.1f} full lines (paper {PAPER_REDUCTION})"
    error = f"{r.worst:.1e} ({len(r.held_out)} lines, {r.vectors} vectors each)"
    return [
        at_most(part, "cold, with certificate", worth, 12, cost, "12 full lines"),
        Figure(part, "reduced DOFs r", r.model.size, f"{r.model.size} ({' + '.join(str(size) for size in r.sizes)})"),
        Figure(part, "factorisations", done, f"{done}: {points} expansion points, {len(r.held_out)} held-out lines"),
        at_most(part, "certificate, worst measured error", r.worst, r.options.tolerance, error, f"{r.options.tolerance:.0e}"),
        Figure(part, "of this", seconds, ", ".join(f"{stage} {r.seconds[stage]:.2f} s" for stage in STAGES)),
        Figure(part, "full line as the reduction measures it", own, f"{own:.3f} s"),
    ]


def stage_of(inputs: Inputs, reduction: Reduction, folder: Path) -> ReductionStage:
    """The reduction as a campaign holds it, with an empty cache."""
    decision = cache.look_up(folder, cache.key_parts(inputs))
    decision.path.parent.mkdir(parents=True, exist_ok=True)
    return ReductionStage(reduction, decision, reduction.seconds["total"])


def misfit_of(inputs: Inputs, stage: ReductionStage, job: str, *, every_line: bool) -> tuple[Misfit, Floats]:
    """The cost of a job as its identification has it, or over all lines of the band; and theta at the start."""
    source = frf_source(inputs, stage)
    measurement = read_measurement(inputs, inputs.campaign.jobs[job], job)
    s = 2j * np.pi * measurement.frequency_hz
    parameters, _ = parameterise(inputs, source, s)
    lines = np.arange(s.size) if every_line else select_lines(inputs, measurement, job)[0]
    model = source.model(s, parameters, lines, inputs.used)
    measured = measurement.values[np.ix_(lines, inputs.used)]
    eta = inputs.campaign.update.regularisation
    # Automatic weights begin here; what an evaluation costs does not depend on them.
    weight = inputs.statistics.values.first_variance if isinstance(eta, str) else float(eta)
    return Misfit(model, measured, parameters.initial, weight), parameters.initial


def lines_of_the_reduced_model(inputs: Inputs, stage: ReductionStage, job: str, line: float, repeats: int) -> list[Figure]:
    """One line of the reduced dynamic stiffness, of the port formula, and of the whole cost with its gradient."""
    reduced = stage.reduction.model
    misfit, theta = misfit_of(inputs, stage, job, every_line=True)
    s = misfit.model.s
    D = misfit.model.parameters.dynamic(theta, s)
    few = np.linspace(0, s.size - 1, min(s.size, 64)).astype(int)
    start = time.perf_counter()
    ports = reduced.ports(s)
    table = time.perf_counter() - start
    mine = ports.select(np.arange(s.size), inputs.used)
    single = timed(lambda: reduced.evaluate(s[few], D[few], workers=1), repeats) / few.size
    adjoint = timed(lambda: reduced.linearise(s[few], D[few], workers=1), repeats) / few.size
    port = timed(lambda: mine.linearise(D), repeats) / s.size
    cost = timed(lambda: misfit(theta), repeats) / s.size
    part = f"One line ({s.size} lines, {inputs.used.size} responses, {theta.size} parameters)"
    goal = "1/8000 of a full line"
    return [
        Figure(part, "reduced dynamic stiffness (28)", single, f"{duration(single)} = 1/{line / single:.0f} (paper 1/{PAPER_LINE})"),
        Figure(part, "the same with adjoint gradient (28), (32)", adjoint, f"{duration(adjoint)} = 1/{line / adjoint:.0f}"),
        Figure(part, "port formula with full gradient", port, f"{duration(port)} = 1/{line / port:.0f}"),
        at_most(part, "cost (29) with full gradient", cost / line, 1 / 8000, f"{duration(cost)} = 1/{line / cost:.0f}", goal),
        Figure(part, "port FRFs of all lines, once", table, f"{duration(table)} = {table / line:.1f} full lines"),
    ]


def one_identification(load: Callable[[str], Inputs], stage: ReductionStage, job: str, line: float, reduction: float) -> list[Figure]:
    """Table 4 of the paper for one job, by both optimisers, port FRFs included."""
    figures = []
    for method in ("gauss-newton", "bfgs"):
        inputs = load(method)
        for old in stage.decision.path.parent.glob("ports-*.h5"):
            old.unlink()
        result = identify(inputs, frf_source(inputs, stage), job)
        total = result.seconds["total"]
        full = result.line_evaluations * line
        count = result.solution.evaluations
        part = f"One identification, {job}, {method}"
        misfit = float(np.mean(result.misfit_final[inputs.used]))
        cost = f"{total:.2f} s ({result.seconds['optimise']:.2f} s optimising)"
        gain = f"{full:.0f} s = {full / total:.0f} times, {full / (total + reduction):.0f} times with the reduction"
        figures += [
            at_most(part, "seconds, reading and port FRFs included", total, 3.0, cost, "3 s"),
            Figure(part, "evaluations", count, f"{count} = {result.line_evaluations} lines"),
            Figure(part, "in full lines", total / line, f"{total / line:.1f} (paper {PAPER_IDENTIFICATION})"),
            Figure(part, "as many full lines take", full, gain),
            Figure(part, "misfit, all lines of the band", misfit, f"{misfit:.2f} dB ({result.solution.status})"),
        ]
    return figures


def command() -> str:
    """The installed command."""
    beside = Path(sys.executable).with_name("lrbc.exe" if os.name == "nt" else "lrbc")
    found = str(beside) if beside.is_file() else shutil.which("lrbc")
    if found is None:
        raise SystemExit("the command lrbc is not installed: pip install .")
    return found


def campaign(config: Path, backend: str, jobs: Sequence[str], folder: Path) -> list[Figure]:
    """The installed command on a cold cache: update, then report."""
    shared = ["--cache", str(folder / "cache"), "--override", f"output={json.dumps((folder / 'results').as_posix())}"]
    shared += ["--override", f"reduction.backend={backend}"]
    chosen = [word for job in jobs for word in ("--job", job)]
    part = f"Campaign, command lrbc, {len(jobs)} jobs"
    figures, total = [], 0.0
    for words in (["update", str(config), *chosen], ["report", str(config), *chosen]):
        start = time.perf_counter()
        done = subprocess.run([command(), *words, *shared], capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - start
        if done.returncode:
            raise SystemExit(f"lrbc {words[0]} ended with {done.returncode}: {done.stderr[-2000:]}")
        total += seconds
        figures.append(Figure(part, f"lrbc {words[0]}", seconds, f"{seconds:.1f} s"))
    limit = 60.0 if backend == "pardiso" else 120.0
    return [*figures, at_most(part, "total, cold cache", total, limit, f"{total:.1f} s", f"{limit:.0f} s")]


def random_stiffness(terms: int, count: int, rng: np.random.Generator) -> Floats:
    """(count, terms) stiffness from free to clamped: half of the vectors rough from node to node, half smooth along the edge."""
    out = np.empty((count, terms))
    for i in range(count):
        knots = terms if i % 2 == 0 else 5
        coarse = rng.uniform(-2.0, 9.0, size=knots)
        out[i] = np.interp(np.linspace(0, 1, terms), np.linspace(0, 1, knots), coarse)
    return np.asarray(10.0**out)


def relative_errors(y: Complexes, exact: Complexes) -> Floats:
    """(F,) error of each line relative to its norm."""
    return np.asarray(np.linalg.norm(y - exact, axis=1) / np.linalg.norm(exact, axis=1))


def resonances(model: ReducedModel, reference: bool, band: tuple[float, float]) -> Complexes:
    """Lines at the undamped resonances of the free model, or of the one with the reference values of the terms."""
    K = model.K + (model.left * model.reference[:, 0]) @ model.right.T if reference else model.K
    squared = la.eigvals(K, model.M)
    frequency = np.sqrt(np.maximum(squared.real, 0.0)) / (2 * np.pi)
    return np.asarray(2j * np.pi * np.sort(frequency[(frequency >= band[0]) & (frequency <= band[1])]))


def accuracy(inputs: Inputs, reduction: Reduction, backend: str, lines: int, vectors: int) -> list[Figure]:
    """Error of the reduced model at lines that it has not seen, and of the port formula against (28)."""
    rng = np.random.default_rng(1804)
    model, band = reduction.model, inputs.campaign.reduction.band
    seen = np.array([step.frequency_hz for step in reduction.trace if np.isfinite(step.frequency_hz)])
    frequency = rng.uniform(band[0], band[1], size=4 * lines)
    frequency = np.sort(rng.permutation(frequency[np.abs(frequency[:, None] - seen).min(axis=1) > 0.05])[:lines])
    s = 2j * np.pi * frequency
    exact = full_ports(inputs.model, inputs.input_of, s, band, backend=backend)
    approximate = model.ports(s)
    values = random_stiffness(model.terms, vectors, rng)
    lags = 10.0 ** rng.uniform(-8.0, -3.0, size=vectors)
    worst: dict[str, float] = {}
    random = []
    for value, lag in zip(values, lags, strict=True):
        D = value[None, :] * (1.0 + s[:, None] * lag)
        random.append(relative_errors(approximate.evaluate(D), exact.evaluate(D)))
    for name, stiffness in (("free", 0.0), ("beyond", 1e9), ("clamped", np.inf)):
        D = np.full((s.size, model.terms), stiffness, dtype=complex)
        worst[name] = float(relative_errors(approximate.evaluate(D), exact.evaluate(D)).max())
    error = float(np.max(random))
    part = "Accuracy"
    text = f"{error:.1e} worst, {np.median(random):.1e} median"
    limits = " / ".join(f"{value:.1e}" for value in worst.values())
    figures = [
        at_most(part, "bound for unseen lines", error, reduction.unseen, f"{error:.1e} found, {reduction.unseen:.1e} stated", "the bound"),
        at_most(part, f"reduced model, {lines} unsampled lines x {vectors} random vectors", error, 1e-3, text, "1e-3"),
        at_most(part, "the same lines, edge free / 1e9 / clamped", max(worst.values()), 1e-3, limits, "1e-3"),
    ]
    for where, at in (("these lines", s), ("resonances", np.concatenate([resonances(model, ref, band) for ref in (False, True)]))):
        ports = model.ports(at)
        difference = []
        for value in (*values, np.zeros(model.terms), np.full(model.terms, 1e7)):
            D = np.broadcast_to(value + 0j, (at.size, model.terms))
            difference.append(relative_errors(ports.evaluate(D), model.evaluate(at, D)).max())
        gap = float(np.max(difference))
        figures.append(at_most(part, f"port formula against (28), free to 1e7, {where} ({at.size})", gap, 1e-8, f"{gap:.1e}", "1e-8"))
    return figures


def gradients(inputs: Inputs, stage: ReductionStage, job: str, repeats: int) -> list[Figure]:
    """Gradient by forward differences against the analytic one."""
    misfit, theta = misfit_of(inputs, stage, job, every_line=False)
    # Away from the plateau, where the gradient is small and differences are noise.
    theta = np.where(misfit.model.parameters.is_damping, 1.0, 2.0)

    def cost(at: Floats) -> float:
        difference = (decibel(misfit.model.frf(at)) - misfit.target)[misfit.valid]
        prior = misfit.penalty @ (at - misfit.prior)
        return float(np.log10(difference @ difference + prior @ prior))

    def forward() -> Floats:
        base, h = cost(theta), 1e-6
        return np.array([(cost(theta + h * row) - base) / h for row in np.eye(theta.size)])

    analytic = timed(lambda: misfit(theta).gradient, repeats)
    differences = timed(forward, max(1, repeats // 2))
    g = misfit(theta).gradient
    gap = float(np.linalg.norm(forward() - g) / np.linalg.norm(g))
    part = f"Gradient ({misfit.lines} lines, {theta.size} parameters)"
    return [
        Figure(part, "cost with analytic gradient", analytic, duration(analytic)),
        Figure(part, "gradient by forward differences", differences, f"{duration(differences)} = {differences / analytic:.1f} times"),
        Figure(part, "relative difference of the two", gap, f"{gap:.1e}"),
    ]
