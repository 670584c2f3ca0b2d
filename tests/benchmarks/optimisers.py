"""Optimisers side by side on the same evaluations: what they need, and where they end.

    python tests/benchmarks/optimisers.py [--config FILE]... [--job NAME]... [--cache FOLDER] [--override KEY.PATH=VALUE]...
        [--rows optimiser|start|job] [--markdown FILE] [--json FILE]

For every job of the campaigns (both samples where none is given) and every start: Gauss-Newton by levels (the default; it brings its own
starts, so it is run once a job), plain Gauss-Newton, the BFGS of the paper with its stop rule, and L-BFGS-B and the bounded least squares
(trf, dogbox) of SciPy with their default stop rules. An evaluation is cost and derivatives together. Prints one row a sample and
optimiser, over all jobs and starts. The cost is that of ``update.approach: paper`` with a number as its weight, 0.04 unless overridden.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

import lrbc_cli as lrbc
from lrbc_cli.campaign.identification.unknowns import select_lines
from lrbc_cli.campaign.identification.weights import line_sigma
from lrbc_cli.updating.misfit.cost import Evaluation, Misfit
from lrbc_cli.updating.search.levels import gauss_newton_by_levels
from lrbc_cli.updating.search.optimise import bfgs, gauss_newton

Floats = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = (ROOT / "configs" / "frame.yaml", ROOT / "configs" / "soundbox.yaml")

#: The cost that all minimise, unless an override says otherwise.
COST = ("update.approach=paper", "update.regularisation=0.04")

#: Iterations of every optimiser at the most, and seeds of the random starts.
ITERATIONS, SEEDS = 200, (1, 2, 3)

#: An end within this of the lowest cost of a job (log10 of the sum) is the lowest basin.
SAME_BASIN = 0.01


class Shared:
    """One evaluation serves cost, gradient, residual and Jacobian of the same theta; each is counted once."""

    def __init__(self, misfit: Misfit) -> None:
        self._misfit, self._last = misfit, (np.empty(0), None)
        self.evaluations = 0

    def __call__(self, theta: Floats) -> Evaluation:
        at, value = self._last
        if value is None or not np.array_equal(at, theta):
            value = self._misfit(theta)
            self.evaluations += 1
            self._last = (np.array(theta), value)
        return value


@dataclass(frozen=True)
class Run:
    """One optimiser from one start."""

    sample: str
    job: str
    optimiser: str
    start: str
    evaluations: int
    seconds: float
    cost: float
    misfit_db: float


def by_levels(cost: Shared, misfit: Misfit, start: Floats, bounds: Floats) -> Floats:
    """The default; it evaluates the misfit itself."""
    solution = gauss_newton_by_levels(misfit, start, bounds, max_iterations=ITERATIONS)
    cost.evaluations += solution.evaluations
    return solution.theta


def plain(cost: Shared, misfit: Misfit, start: Floats, bounds: Floats) -> Floats:
    """All parameters at once."""
    return gauss_newton(cost, start, bounds, max_iterations=ITERATIONS).theta


def of_the_paper(cost: Shared, misfit: Misfit, start: Floats, bounds: Floats) -> Floats:
    """BFGS until two costs differ by less than 1e-3."""
    return bfgs(cost, start, bounds, tolerance=1e-3, max_iterations=ITERATIONS).theta


def l_bfgs_b(cost: Shared, misfit: Misfit, start: Floats, bounds: Floats) -> Floats:
    """SciPy's, on the log10 cost."""

    def function(theta: Floats) -> tuple[float, Floats]:
        value = cost(theta)
        return value.cost, value.gradient

    return np.asarray(minimize(function, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": ITERATIONS}).x)


def of_scipy(method: str, cost: Shared, misfit: Misfit, start: Floats, bounds: Floats) -> Floats:
    """SciPy's bounded least squares; they have to start inside the bounds."""
    inside = np.clip(start, bounds[:, 0] + 1e-6, bounds[:, 1] - 1e-6)
    found = least_squares(
        lambda theta: cost(theta).residual,
        inside,
        lambda theta: cost(theta).jacobian,
        bounds=(bounds[:, 0], bounds[:, 1]),
        method=method,
        max_nfev=ITERATIONS,
    )
    return np.asarray(found.x)


OPTIMISERS: dict[str, Callable[[Shared, Misfit, Floats, Floats], Floats]] = {
    "Gauss-Newton by levels": by_levels,
    "Gauss-Newton": plain,
    "BFGS (paper)": of_the_paper,
    "L-BFGS-B": l_bfgs_b,
    "least_squares trf": partial(of_scipy, "trf"),
    "least_squares dogbox": partial(of_scipy, "dogbox"),
}


def starts(misfit: Misfit, initial: Floats, bounds: Floats) -> Iterator[tuple[str, Floats]]:
    """Campaign start, uniform at a quarter and at three quarters between the bounds, at random within; only the last move p_damp."""
    damping = misfit.model.parameters.is_damping
    low, width = bounds[:, 0], np.diff(bounds, axis=1)[:, 0]
    yield "campaign", initial
    for name, share in (("uniform low", 0.25), ("uniform high", 0.75)):
        yield name, np.where(damping, initial, low + share * width)
    for seed in SEEDS:
        yield f"random {seed}", low + np.random.default_rng(seed).uniform(size=initial.size) * width


def misfit_of(study: lrbc.Study, name: str) -> tuple[Misfit, Floats, Floats]:
    """The cost of a job as `lrbc update` forms it, start and bounds."""
    inputs, measurement = study.inputs, study.read(name)
    method = inputs.method
    assert method.approach == "paper"
    assert isinstance(method.regularisation, float)
    parameters = study.parameters(measurement.frequency_hz)
    selected, _ = select_lines(inputs, measurement, name)
    sigma, _ = line_sigma(inputs, measurement, inputs.campaign.jobs[name], selected)
    misfit = Misfit(
        model=study.source.model(2j * np.pi * measurement.frequency_hz, parameters, selected, inputs.used),
        measured=measurement.values[np.ix_(selected, inputs.used)],
        prior=parameters.initial,
        eta=method.regularisation,
        options=method.residual,
        sigma=sigma,
    )
    return misfit, parameters.initial, parameters.bounds


def runs_of(sample: str, job: str, misfit: Misfit, initial: Floats, bounds: Floats) -> Iterator[Run]:
    """Every optimiser from every start."""
    misfit(initial)
    for name, optimiser in OPTIMISERS.items():
        for label, start in starts(misfit, initial, bounds):
            if optimiser is by_levels and label != "campaign":
                continue
            cost = Shared(misfit)
            begin = time.perf_counter()
            theta = optimiser(cost, misfit, start, bounds)
            seconds = time.perf_counter() - begin
            end = misfit(np.clip(theta, bounds[:, 0], bounds[:, 1]))
            yield Run(sample, job, name, label, cost.evaluations, seconds, end.cost, end.misfit_db)


def table(runs: list[Run], rows_of: str) -> str:
    """Markdown: one row a sample and optimiser, and a start or a job where wanted; medians over the others."""
    lowest: dict[tuple[str, str], float] = {}
    for run in runs:
        key = (run.sample, run.job)
        lowest[key] = min(lowest.get(key, np.inf), run.cost)
    heads = ["sample", "optimiser"] + ([] if rows_of == "optimiser" else [rows_of])
    heads += ["runs", "evaluations", "ms", "cost above the lowest, median", "largest", "misfit [dB]", "in the lowest basin"]
    lines = ["| " + " | ".join(heads) + " |", "|" + " --- |" * len(heads)]
    rows: dict[tuple[str, ...], list[Run]] = {}
    for run in runs:
        rows.setdefault(tuple(getattr(run, head) for head in heads[: 2 if rows_of == "optimiser" else 3]), []).append(run)
    for key, members in rows.items():
        above = np.array([run.cost - lowest[run.sample, run.job] for run in members])
        cells = [
            *key,
            str(len(members)),
            f"{np.median([run.evaluations for run in members]):.0f}",
            f"{1e3 * np.median([run.seconds for run in members]):.0f}",
            f"{np.median(above):.3f}",
            f"{above.max():.3f}",
            f"{np.median([run.misfit_db for run in members]):.2f}",
            f"{np.sum(above < SAME_BASIN)} of {len(members)}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", type=Path, action="append", default=[])
    parser.add_argument("--job", action="append", default=[], help="default: all")
    parser.add_argument("--override", action="append", default=[], metavar="KEY.PATH=VALUE", help="as of lrbc")
    parser.add_argument("--cache", type=Path, help="keep the reduced models here; default: built anew")
    parser.add_argument("--rows", choices=("optimiser", "start", "job"), default="optimiser", help="what a row of the table stands for")
    parser.add_argument("--markdown", type=Path, metavar="FILE")
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments: Any = parser.parse_args()
    runs: list[Run] = []
    with tempfile.TemporaryDirectory(prefix="lrbc-optimisers-") as scratch:
        for config in arguments.config or CONFIGS:
            study = lrbc.load(config, overrides=[*COST, *arguments.override], calibration=False, cache=arguments.cache or scratch)
            for job in study.jobs:
                if not arguments.job or job in arguments.job:
                    runs += runs_of(config.stem, job, *misfit_of(study, job))
    text = table(runs, arguments.rows)
    print(text)
    if arguments.markdown:
        arguments.markdown.write_text(text + "\n", encoding="utf-8", newline="\n")
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(run) for run in runs], indent=1) + "\n", encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
