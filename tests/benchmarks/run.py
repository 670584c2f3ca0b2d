"""What the SoundBox costs, in seconds and in units of one line of the full model; ratios hold within one run.

    python tests/benchmarks/run.py [--quick] [--backend superlu|pardiso] [--pymor] [--json FILE] [--markdown FILE]

A full line is one numeric factorisation on an analysed pattern, one solve and one refinement step, median of five; the unit is the smaller
of two such medians, before and after the reduction.
"""

from __future__ import annotations

import argparse
import datetime
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import measure
import pymor_side
from measure import Figure
from smallest import smallest_basis

from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.config import load_campaign
from lrbc_cli.reduction.solve import pardiso
from lrbc_cli.results.store import versions

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "soundbox.yaml"


def head(about: dict[str, Any], installed: dict[str, str]) -> str:
    """Machine, date and versions in one paragraph."""
    parts = [
        about["date"],
        f"back end {about['backend']}",
        f"{about['processor']}, {about['cores']} cores, {about['platform']}",
        f"OMP_NUM_THREADS {about['threads']}",
        f"load before {about['load_before']}, other processes used {about['others']:.0%} of the machine during the run",
        ", ".join(f"{name} {version}" for name, version in installed.items()),
    ]
    return "; ".join(parts)


def table(figures: Sequence[Figure]) -> str:
    """One Markdown table, its parts as bold rows."""
    lines = ["| figure | measured | at most | holds |", "| --- | --- | --- | --- |"]
    part = None
    for figure in figures:
        if figure.part != part:
            part = figure.part
            lines.append(f"| **{part}** | | | |")
        holds = "" if figure.holds is None else ("yes" if figure.holds else "**no**")
        lines.append(f"| {figure.name} | {figure.text} | {figure.target} | {holds} |")
    return "\n".join(lines)


def measure_all(config: Path, backend: str, quick: bool, job: str, pymor: bool) -> list[Figure]:
    """All parts, in order; progress goes to stderr."""
    started = time.perf_counter()

    def tell(text: str) -> None:
        print(f"[{time.perf_counter() - started:5.0f} s] {text}", file=sys.stderr, flush=True)

    def load(method: str = "gauss-newton") -> Inputs:
        return read_as_exported(load_campaign(config, [f"reduction.backend={backend}", f"update.method={method}"]))

    inputs = load()
    jobs = list(inputs.campaign.jobs)
    if quick:
        reference = inputs.campaign.update.reference
        jobs = [name for name in jobs if name in (reference, job)]
    repeats = 3 if quick else 7
    tell("full line")
    before, figures = measure.full_line(inputs, backend)
    other = "superlu" if backend == "pardiso" else "pardiso"
    if other == "superlu" or pardiso.library():
        figures += measure.full_line(inputs, other)[1]
    tell("reduction")
    reduction, seconds = measure.cold_reduction(inputs, backend, 1 if quick else 3)
    # The smaller of the two is the one that other processes disturbed less, and the stricter unit.
    after, rows = measure.full_line(inputs, backend)
    line = min(before, after)
    figures.insert(1, replace(rows[0], name=f"{rows[0].name}, again after the reduction"))
    figures += measure.reduction_figures(reduction, seconds, line)
    with tempfile.TemporaryDirectory(prefix="lrbc-benchmark-") as scratch:
        folder = Path(scratch)
        stage = measure.stage_of(inputs, reduction, folder / "library")
        tell("lines of the reduced model")
        figures += measure.lines_of_the_reduced_model(inputs, stage, job, line, repeats)
        figures += measure.gradients(inputs, stage, job, repeats)
        tell("identification")
        figures += measure.one_identification(load, stage, job, line, seconds)
        tell("campaign")
        figures += measure.campaign(config, backend, jobs, folder)
    tell("accuracy")
    figures += measure.accuracy(inputs, reduction, backend, 10 if quick else 200, 5 if quick else 50)
    tell("smallest basis")
    figures += smallest_basis(inputs, reduction, backend, quick=quick)
    if pymor:
        tell("pyMOR")
        figures += pymor_side.side_by_side(inputs, reduction, seconds, line, backend, quick=quick, tell=tell)
    tell("done")
    return figures


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer repeats, lines, vectors and jobs")
    parser.add_argument("--backend", choices=("superlu", "pardiso"), help="default: pardiso where it is installed")
    parser.add_argument("--pymor", action="store_true", help="the reduction side by side with pyMOR (pip install pymor)")
    parser.add_argument("--config", type=Path, default=CONFIG)
    parser.add_argument("--job", default="bolts-04", help="the job that is identified alone")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    backend = arguments.backend or ("pardiso" if pardiso.library() else "superlu")
    if backend == "pardiso" and not pardiso.library():
        parser.error("pardiso is not installed: pip install 'lrbc[accelerated]'")
    if arguments.pymor and not pymor_side.available():
        parser.error("pymor is not installed: pip install pymor")
    about: dict[str, Any] = {"date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"), "backend": backend}
    about |= measure.machine() | {"quick": arguments.quick}
    everyone, own = measure.processor_seconds()
    start = time.perf_counter()
    figures = measure_all(arguments.config, backend, arguments.quick, arguments.job, arguments.pymor)
    used = [now - then for now, then in zip(measure.processor_seconds(), (everyone, own), strict=True)]
    about["others"] = max(used[0] - used[1], 0.0) / ((time.perf_counter() - start) * (about["cores"] or 1))
    text = f"{head(about, versions())}\n\n{table(figures)}\n"
    print(text)
    if arguments.markdown:
        arguments.markdown.write_text(text, encoding="utf-8", newline="\n")
    if arguments.json:
        document = {"about": about, "versions": versions(), "figures": [asdict(figure) for figure in figures]}
        arguments.json.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
