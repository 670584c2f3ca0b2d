"""How the costs grow: with the DOFs of the model, the terms, the lines, and the jobs.

    python tests/benchmarks/sizes.py [--parts n,terms,lines,jobs] [--sizes 10000,20000,...] [--terms 1,10,...] [--backend superlu|pardiso]
        [--generate] [--models DIR] [--out DIR] [--quick]

The models are the SoundBox on finer meshes (data_samples/soundbox/generate/refined.py; needs the extra ``samples``), kept in --models.
Each figure is measured in a process of its own; into --out go sizes-BACKEND.json, .md and .png. Compare ratios within one run.
"""

from __future__ import annotations

import argparse
import datetime
import json
import logging
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "data_samples"))

import measure
import numpy as np
from measure import Figure, at_most
from run import head, table
from sizes_chart import draw, exponent

from lrbc_cli.reduction.solve import pardiso
from lrbc_cli.results.store import versions
from rigs.campaign import campaign_text
from rigs.design import EDGES
from rigs.designs import SOUNDBOX
from rigs.refine import Terms, refined, write_model, write_refined

SAMPLE = Path(__file__).resolve().parents[2] / "data_samples" / "soundbox"
PARTS = ("n", "terms", "lines", "jobs")
SIZES = (10_000, 20_000, 50_000, 100_000, 250_000)
#: SuperLU needs 7 GB and minutes a factorisation beyond.
LARGEST_SUPERLU = 100_000
TERMS = (1, 10, 31, 60, 120, 500)
#: Terms and edges of the models of all sizes.
SIZE_TERMS = Terms(("left", "right"), 60)
LINES = (50, 100, 200, 400, 800, 1600)
JOBS = (1, 2, 4, 7, 14, 28)


class Bench:
    """One run of the benchmark.

    Parameters
    ----------
    models, folder : Path
        Where the models are kept; where this run keeps its reduced models and results.
    backend : str
    quick : bool
    """

    def __init__(self, models: Path, folder: Path, backend: str, quick: bool) -> None:
        self.models, self.folder, self.backend, self.quick = models, folder, backend, quick
        self.started = time.perf_counter()

    def tell(self, text: str) -> None:
        """Progress to stderr."""
        print(f"[{time.perf_counter() - self.started:6.0f} s] {text}", file=sys.stderr, flush=True)

    def work(self, task: str, **arguments: Any) -> dict[str, Any]:
        """Run a task of ``sizes_work.py`` in a process of its own."""
        file = self.folder / "task.json"
        file.write_text(json.dumps(arguments), encoding="utf-8")
        done = subprocess.run([sys.executable, str(Path(__file__).with_name("sizes_work.py")), task, str(file)], check=False)
        if done.returncode:
            raise SystemExit(f"{task} {arguments} ended with {done.returncode}")
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        return found

    def campaigns(self, dofs: int, terms: Sequence[Terms], support: Terms) -> list[Path]:
        """Campaign files with these terms on one model of the SoundBox; written where they are missing."""
        folder = self.models / f"{'-'.join(support.edges)}-{support.count}-{dofs}"
        files = [folder / f"terms-{item.count}.yaml" for item in terms]
        if not all(file.is_file() for file in files):
            self.tell(f"model of {dofs} DOFs")
            design = support.support(refined(SOUNDBOX, dofs))
            model = write_model(design, folder)
            jobs = {job: SOUNDBOX.removed(job) for job in SOUNDBOX.jobs}
            for item in terms:
                write_refined(design, model, item, folder, SAMPLE / "frf", jobs, f"terms-{item.count}")
        return files

    def of_size(self, dofs: int) -> Path:
        """The campaign file of a size."""
        return self.campaigns(dofs, [SIZE_TERMS], SIZE_TERMS)[0]

    def lines(self, dofs: int) -> int:
        """Full lines of which the median is taken: few of large models, where one takes a minute."""
        return 5 if dofs <= LARGEST_SUPERLU and not self.quick else 1 if self.quick else 3

    # -- parts ------------------------------------------------------------------------------------------------------

    def by_size(self, sizes: Sequence[int]) -> dict[str, Any]:
        """Full line, reduction and memory by DOFs; then one identification at equal r, unknowns and lines."""
        rows, configs = [], []
        for dofs in sizes:
            config = str(self.of_size(dofs))
            self.tell(f"{dofs} DOFs: full line")
            row = self.work("one_factorisation", config=config, backend=self.backend, lines=self.lines(dofs))
            self.tell(f"{dofs} DOFs: reduction")
            row |= self.work("one_reduction", config=config, backend=self.backend, folder=str(self.folder / "library"))
            if not self.quick:
                # The smaller of the two is the one that other processes disturbed less, and the stricter unit.
                again = self.work("one_factorisation", config=config, backend=self.backend, lines=self.lines(dofs))
                for key in ("full_line_s", "first_factor_s", "factor_peak_mb"):
                    row[key] = min(row[key], again[key])
            row["full_lines"] = row["reduction_s"] / row["full_line_s"]
            row["memory_ratio"] = row["reduction_peak_mb"] / row["factor_peak_mb"]
            rows.append(row)
            configs.append(config)
        self.tell("identification")
        folder = str(self.folder / "library")
        found = self.work(
            "identifications", configs=configs, backend=self.backend, folder=folder, job="bolts-04", repeats=3 if self.quick else 9
        )
        return {"rows": rows, "identification": found}

    def by_terms(self, counts: Sequence[int]) -> dict[str, Any]:
        """Reduction and cost by terms, on one model whose four edges are held at their nodes."""
        support = Terms(EDGES, max(max(TERMS), *counts))
        configs = self.campaigns(20_000, [Terms(EDGES, count) for count in counts], support)
        line = self.work("one_factorisation", config=str(configs[0]), backend=self.backend, lines=5)
        rows = []
        for count, config in zip(counts, configs, strict=True):
            self.tell(f"{count} terms")
            arguments = {"config": str(config), "backend": self.backend, "folder": str(self.folder / "library")}
            runs = [self.work("one_reduction", **arguments, cost_lines=100)]
            runs += [runs[0] | self.work("one_reduction", **arguments) for _ in range(0 if self.quick else 2)]
            row = min(runs, key=lambda run: float(run["reduction_s"]))
            rows.append(row | {"full_lines": row["reduction_s"] / line["full_line_s"]})
        return {"n": line["n"], "full_line_s": line["full_line_s"], "rows": rows}

    def by_lines(self, counts: Sequence[int]) -> dict[str, Any]:
        """Port FRFs and one cost with gradient by lines, 31 terms on a model of the SoundBox's size."""
        support = Terms(("left",), 31)
        config = str(self.campaigns(20_000, [support], support)[0])
        folder = str(self.folder / "library")
        self.tell("lines")
        self.work("one_reduction", config=config, backend=self.backend, folder=folder)
        return self.work("costs", config=config, backend=self.backend, folder=folder, counts=list(counts))

    def by_jobs(self, counts: Sequence[int]) -> dict[str, Any]:
        """The command ``lrbc update`` by jobs on a warm cache, the reduced model and the port FRFs included."""
        frf = self.folder / "frf"
        frf.mkdir(exist_ok=True)
        names = list(SOUNDBOX.jobs)
        jobs: dict[str, list[str]] = {}
        for k in range(max(counts)):
            source = names[k % len(names)]
            name = source if k < len(names) else f"{source}-{k // len(names) + 1}"
            shutil.copyfile(SAMPLE / "frf" / f"{source}.uff", frf / f"{name}.uff")
            jobs[name] = SOUNDBOX.removed(source)
        config = self.folder / "jobs.yaml"
        text = campaign_text(SOUNDBOX, "jobs", Path(os.path.relpath(SAMPLE, self.folder)).as_posix(), jobs)
        config.write_text(text, encoding="utf-8", newline="\n")
        shared = [str(config), "--cache", str(self.folder / "cache"), "--override", f"reduction.backend={self.backend}"]
        self.lrbc("reduce", *shared)
        rows = []
        for count in counts:
            self.tell(f"{count} jobs")
            chosen = [word for name in list(jobs)[:count] for word in ("--job", name)]
            shutil.rmtree(self.folder / "output", ignore_errors=True)
            rows.append({"jobs": count, "seconds": self.lrbc("update", *shared, "--no-calibration", "--workers", "1", *chosen)})
        return {"rows": rows}

    @staticmethod
    def lrbc(*words: str) -> float:
        """Seconds of one run of the command."""
        start = time.perf_counter()
        done = subprocess.run([measure.command(), *words], capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(f"lrbc {words[0]} ended with {done.returncode}: {done.stderr[-2000:]}")
        return time.perf_counter() - start


def figures(found: dict[str, Any]) -> list[Figure]:
    """What stands in the table, with the targets."""
    out: list[Figure] = []
    if "n" in found:
        part = "With the DOFs, 60 terms"
        rows = found["n"]["rows"]
        largest = rows[-1]
        for key, name in (
            ("full_line_s", "full line"),
            ("reduction_s", "reduction"),
            ("reduction_peak_mb", "peak memory of the reduction"),
        ):
            power = exponent([row["n"] for row in rows], [row[key] for row in rows])
            out.append(Figure(part, f"{name} grows as n^", power, f"{power:.2f}"))
        text = f"{largest['reduction_s']:.1f} s = {largest['full_lines']:.1f} full lines"
        out.append(at_most(part, f"cold reduction of {largest['n']} DOFs", largest["full_lines"], 20, text, "20 full lines"))
        text = f"{largest['reduction_peak_mb']:.0f} MB = {largest['memory_ratio']:.2f} of one factorisation"
        out.append(at_most(part, "its peak memory", largest["memory_ratio"], 1.5, text, "1.5"))
        some = [row for row in found["n"]["identification"]["rows"] if row["n"] <= 1.1 * LARGEST_SUPERLU]
        for key, name in (("per_evaluation_s", "one evaluation of an identification"), ("total", "one identification")):
            values = [row[key] if key in row else row["seconds"][key] for row in some]
            spread = max(values) / min(values) - 1
            text = f"{measure.duration(min(values))} to {measure.duration(max(values))}, {spread:.0%} apart"
            title = f"{name}, equal r, unknowns and lines, {some[0]['n']} to {some[-1]['n']} DOFs"
            out.append(at_most(part, title, spread, 0.1, text, "10 %") if key != "total" else Figure(part, title, spread, text))
    if "terms" in found:
        part = f"With the terms, {found['terms']['n']} DOFs"
        rows = {row["terms"]: row for row in found["terms"]["rows"]}
        power = exponent(list(rows), [row["reduction_s"] for row in rows.values()])
        out.append(Figure(part, "reduction grows as terms^", power, f"{power:.2f}"))
        if {31, 500} <= set(rows):
            ratio = rows[500]["reduction_s"] / rows[31]["reduction_s"]
            text = f"{rows[500]['reduction_s']:.1f} s / {rows[31]['reduction_s']:.1f} s = {ratio:.1f}"
            out.append(at_most(part, "reduction with 500 terms against 31", ratio, 5, text, "5"))
    if "lines" in found:
        rows = found["lines"]["rows"]
        for key, name in (("table_s", "port FRFs, once"), ("cost_s", "cost with gradient")):
            power = exponent([row["lines"] for row in rows], [row[key] for row in rows])
            per = measure.duration(rows[-1][key] / rows[-1]["lines"])
            out.append(Figure("With the lines, 31 terms", f"{name}, grows as lines^", power, f"{power:.2f}; {per} a line"))
    if "jobs" in found:
        rows = found["jobs"]["rows"]
        slope, start = np.polyfit([row["jobs"] for row in rows], [row["seconds"] for row in rows], 1)
        out.append(Figure("With the jobs", "lrbc update", slope, f"{start:.1f} s + {slope:.2f} s a job"))
    return out


def rows_table(columns: Sequence[tuple[str, Any]], rows: Sequence[dict[str, Any]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(name for name, _ in columns) + " |", "| " + " | ".join("---" for _ in columns) + " |"]
    return "\n".join(lines + ["| " + " | ".join(show(row) for _, show in columns) + " |" for row in rows])


def document(found: dict[str, Any]) -> str:
    """All tables."""
    parts = [table(figures(found))]
    reduction = [
        ("reduction [s]", lambda r: f"{r['reduction_s']:.2f}"),
        ("full lines", lambda r: f"{r['full_lines']:.1f}"),
        (
            "basis / projection / estimate / compression / certificate [s]",
            lambda r: " / ".join(f"{r['stages_s'].get(k, 0.0):.2f}" for k in measure.STAGES),
        ),
        ("r", lambda r: f"{r['r']} ({' + '.join(map(str, r['sizes']))})"),
        ("factorisations", lambda r: f"{r['factorisations']}"),
        ("worst measured error", lambda r: f"{r['worst']:.1e}"),
    ]
    if "n" in found:
        columns = [
            ("DOFs", lambda r: f"{r['n']}"),
            ("full line [s]", lambda r: f"{r['full_line_s']:.2f}"),
            *reduction,
            ("read [s]", lambda r: f"{r['read_s']:.1f}"),
            ("peak, one factorisation [MB]", lambda r: f"{r['factor_peak_mb']:.0f}"),
            ("peak, reduction [MB]", lambda r: f"{r['reduction_peak_mb']:.0f} ({r['memory_ratio']:.2f})"),
        ]
        parts.append(rows_table(columns, found["n"]["rows"]))
        identification = found["n"]["identification"]
        columns = [
            ("DOFs", lambda r: f"{r['n']}"),
            ("r before padding", lambda r: f"{r['r']}"),
            ("unknowns", lambda r: f"{r['unknowns']}"),
            ("lines", lambda r: f"{r['lines']}"),
            ("evaluations", lambda r: f"{r['evaluations']:.0f}"),
            ("one evaluation", lambda r: measure.duration(r["per_evaluation_s"])),
            ("port FRFs [s]", lambda r: f"{r['seconds']['port']:.2f}"),
            ("identification [s]", lambda r: f"{r['seconds']['total']:.2f}"),
            ("of all cores [s]", lambda r: f"{r['seconds']['processor']:.2f}"),
            ("misfit [dB]", lambda r: f"{r['misfit_db']:.2f}"),
        ]
        parts.append(f"One identification at r = {identification['r']}:\n\n" + rows_table(columns, identification["rows"]))
    if "terms" in found:
        columns = [
            ("terms", lambda r: f"{r['terms']}"),
            *reduction,
            ("peak [MB]", lambda r: f"{r['reduction_peak_mb']:.0f}"),
            ("port FRFs of 100 lines", lambda r: measure.duration(r["table_s"])),
            ("cost with gradient on them", lambda r: measure.duration(r["cost_s"])),
        ]
        parts.append(rows_table(columns, found["terms"]["rows"]))
    if "lines" in found:
        columns = [
            ("lines", lambda r: f"{r['lines']}"),
            ("port FRFs, once", lambda r: measure.duration(r["table_s"])),
            ("cost with gradient", lambda r: measure.duration(r["cost_s"])),
        ]
        parts.append(rows_table(columns, found["lines"]["rows"]))
    if "jobs" in found:
        columns = [("jobs", lambda r: f"{r['jobs']}"), ("lrbc update [s]", lambda r: f"{r['seconds']:.1f}")]
        parts.append(rows_table(columns, found["jobs"]["rows"]))
    return "\n\n".join(parts)


def numbers(text: str) -> tuple[int, ...]:
    """Whole numbers, comma-separated."""
    return tuple(sorted(int(word) for word in text.split(",")))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default=",".join(PARTS), help="some of n,terms,lines,jobs")
    parser.add_argument("--sizes", type=numbers, metavar="LIST", help=f"about so many DOFs ({','.join(map(str, SIZES))})")
    parser.add_argument("--terms", type=numbers, default=TERMS, metavar="LIST")
    parser.add_argument("--backend", choices=("superlu", "pardiso"), help="default: pardiso where it is installed")
    parser.add_argument("--generate", action="store_true", help="write the models only")
    parser.add_argument(
        "--models", type=Path, default=Path(tempfile.gettempdir()) / "lrbc-sizes", help="folder that holds the models, or gets them"
    )
    parser.add_argument("--out", type=Path, default=Path("runs/sizes"))
    parser.add_argument("--quick", action="store_true", help="fewer repeats")
    arguments = parser.parse_args()
    parts = arguments.parts.split(",")
    if not set(parts) <= set(PARTS):
        parser.error(f"--parts: some of {', '.join(PARTS)}")
    backend = arguments.backend or ("pardiso" if pardiso.library() else "superlu")
    if backend == "pardiso" and not pardiso.library():
        parser.error("pardiso is not installed: pip install 'lrbc[accelerated]'")
    sizes = arguments.sizes or (SIZES if backend == "pardiso" else tuple(n for n in SIZES if n <= LARGEST_SUPERLU))
    logging.getLogger("skfem").setLevel(logging.ERROR)
    out: Path = arguments.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    about: dict[str, Any] = {"date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"), "backend": backend}
    about |= measure.machine() | {"quick": arguments.quick}
    everyone, own = measure.processor_seconds()
    start = time.perf_counter()
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="lrbc-sizes-") as scratch:
        bench = Bench(arguments.models.resolve(), Path(scratch), backend, arguments.quick)
        if arguments.generate:
            for dofs in sizes:
                print(bench.of_size(dofs))
            return
        for part, measured in (
            ("n", lambda: bench.by_size(sizes)),
            ("terms", lambda: bench.by_terms(arguments.terms)),
            ("lines", lambda: bench.by_lines(LINES)),
            ("jobs", lambda: bench.by_jobs(JOBS)),
        ):
            if part in parts:
                found[part] = measured()
                (out / f"sizes-{backend}.json").write_text(json.dumps({"about": about, "found": found}, indent=1) + "\n", encoding="utf-8")
        used = [now - then for now, then in zip(measure.processor_seconds(), (everyone, own), strict=True)]
        about["others"] = max(used[0] - used[1], 0.0) / ((time.perf_counter() - start) * (about["cores"] or 1))
        bench.tell("done")
    (out / f"sizes-{backend}.json").write_text(json.dumps({"about": about, "found": found}, indent=1) + "\n", encoding="utf-8")
    text = f"{head(about, versions())}\n\n{document(found)}\n"
    print(text)
    (out / f"sizes-{backend}.md").write_text(text, encoding="utf-8", newline="\n")
    draw(found, out / f"sizes-{backend}.png")


if __name__ == "__main__":
    main()
