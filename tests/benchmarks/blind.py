"""Are the right bolts found? Ranking, alarms, places, verdicts and misfit on rigs that the identification knows nothing about.

    python tests/benchmarks/blind.py [FOLDER]... [--generate SEED]... [--virtual DESIGN:SEEDS]... [--tight DESIGN:SEEDS]...
        [--override KEY.PATH=VALUE]... [--workers N] [--json FILE] [--markdown FILE]

A FOLDER holds ``truth.json`` and either ``campaign.yaml`` and ``frf/``, as ``data_samples/virtual.py`` writes them, or ``JOB.uff`` for the
jobs of --config (the SoundBox), as ``data_samples/soundbox/generate/measurements.py`` writes them, which --generate does first.
--virtual writes campaigns of a design (``steel:11,12``), --tight such with all bolts tight (``soundbox:1-50``), re-torque scatter of 30 %,
2 K and 3 mm of hammer offset between jobs; all need the extra ``samples``. Without any of these the SoundBox sample is used.
A campaign with a block ``calibration`` is calibrated first, unless --no-calibration. Exit code 1 where a figure misses its limit.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from scores import Figure, JobScore, figures, locate, roc_auc, score_job

import lrbc_cli as lrbc
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import LrbcError, NumericalError

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "configs" / "soundbox.yaml"
SAMPLE = ROOT / "data_samples" / "soundbox"

T = TypeVar("T")

#: What drifts in the fully tightened campaigns.
TIGHT = ("--jobs", "tight:4", "--retorque", "0.3", "--kelvin", "2", "--hammer", "0.003")

#: Campaigns run side by side, one thread each.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Task:
    """One campaign to run, as a process of its own is told.

    Attributes
    ----------
    name : str
    folder : Path
        With ``truth.json``.
    config : Path
        Campaign file for folders without one.
    output, cache : Path
    overrides : tuple of str
    calibrate : bool
        Where its file says how.
    resume : bool
        Keep finished jobs and calibrations that are in the output folder.
    """

    name: str
    folder: Path
    config: Path
    output: Path
    cache: Path
    overrides: tuple[str, ...]
    calibrate: bool
    resume: bool


@dataclass(frozen=True)
class Calibration:
    """What became of the calibration of a campaign; misfits of the responses used and held out [dB]."""

    status: str
    misfit: float | None
    held_out: float | None
    factors: dict[str, float]
    rounds: int
    seconds: float


def campaign_of(task: Task) -> tuple[Path, list[str]]:
    """Campaign file of a task, and overrides that hide from it which bolts are removed."""
    own = task.folder / "campaign.yaml"
    config = own if own.is_file() else task.config
    overrides = [f"output={json.dumps(task.output.resolve().as_posix())}"]
    for name, job in load_campaign(config).jobs.items():
        frf = job.frf if own.is_file() else task.folder / f"{name}.uff"
        overrides.append(f"jobs.{name}={json.dumps({'frf': frf.resolve().as_posix()})}")
    return config, overrides


@dataclass(frozen=True)
class Results:
    """What a campaign gave: ``result.json`` of every job, its role (``reference``, ``baseline``, ``judged``), and the truth."""

    reference: str
    trees: dict[str, dict[str, Any]]
    roles: dict[str, str]
    truth: dict[str, Any]
    calibration: Calibration | None
    study: lrbc.Study


def results_of(task: Task) -> Results:
    """Run a campaign.

    Raises
    ------
    LrbcError
        Where nothing can be compared: its inputs, its calibration or its reference job fail.
    """
    config, own = campaign_of(task)
    study = lrbc.load(config, overrides=[*own, *task.overrides], calibration=task.calibrate, cache=task.cache)
    calibration = None
    if task.calibrate and study.inputs.campaign.calibration is not None:
        record, _ = study.calibrate(force=not task.resume)
        factors = {name: entry.value for name, entry in record.factors.items()}
        misfit = record.misfit_db
        calibration = Calibration(record.status, misfit.final, misfit.held_out_final, factors, len(record.rounds), record.seconds)
    inputs = study.inputs
    if calibration is not None and (inputs.calibration is None or not inputs.calibration.used):
        raise NumericalError("the calibration that was just made is not used")
    outcome = study.update(force=not task.resume)
    update = inputs.campaign.update
    reference = str(update.reference)
    if reference in outcome.errors:
        raise outcome.errors[reference]
    truth = json.loads((task.folder / "truth.json").read_text(encoding="utf-8"))["jobs"]
    trees, roles = {}, {}
    for job in inputs.campaign.jobs:
        roles[job] = "reference" if job == reference else "baseline" if job in update.baselines else "judged"
        failure = {"job": job, "status": "failed", "reason": outcome.errors[job].message} if job in outcome.errors else None
        trees[job] = failure or outcome.results[job].tree()
    return Results(reference, trees, roles, truth, calibration, study)


def run_campaign(task: Task) -> tuple[list[JobScore], Calibration | None]:
    """Run a campaign and compare it with its truth; see ``results_of``."""
    found = results_of(task)
    before = found.trees[found.reference]
    scores = [score_job(task.name, tree, before, found.truth[job]["removed"], found.roles[job]) for job, tree in found.trees.items()]
    return scores, found.calibration


def in_processes(run: Callable[..., T], calls: Sequence[tuple[Any, ...]], workers: int) -> tuple[dict[str, T], dict[str, str]]:
    """Run campaigns, each in a process of its own with one thread; what failed as a whole, by its name."""
    for variable in THREADS:
        os.environ[variable] = "1"
    found: dict[str, T] = {}
    failures: dict[str, str] = {}
    start = time.perf_counter()
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), max_tasks_per_child=1) as pool:
        pending = [(arguments[0].name, pool.submit(run, *arguments)) for arguments in calls]
        for done, (name, future) in enumerate(pending, 1):
            try:
                found[name] = future.result()
            except LrbcError as error:
                failures[name] = error.message
            print(
                f"{done}/{len(calls)} {name}: {failures.get(name, 'done')}, {time.perf_counter() - start:.0f} s",
                file=sys.stderr,
                flush=True,
            )
    return found, failures


def shown(value: float | None) -> str:
    """A number as in the tables."""
    return "" if value is None else f"{value:.3g}" if abs(value) < 10 else f"{value:.1f}"


def pooled_table(pooled: Sequence[Figure], by_campaign: dict[str, list[Figure]]) -> str:
    """Every figure over all campaigns, the worst campaign beside it."""
    lines = ["| figure | limit | pooled | counts | holds | worst campaign | campaigns that hold |", "|" + " --- |" * 7]
    for i, figure in enumerate(pooled):
        own = {name: found[i] for name, found in by_campaign.items() if found[i].value is not None}
        worst = ""
        if figure.limit is not None and len(own) > 1:
            pick = min if figure.at_least else max
            name = pick(own, key=lambda name: own[name].value or 0.0)
            worst = f"{name}: {shown(own[name].value)}"
        holding = [f.holds for f in own.values() if f.holds is not None]
        limit = "" if figure.limit is None else f"{'at least' if figure.at_least else 'at most'} {figure.limit:g}"
        cells = [
            figure.title,
            limit,
            shown(figure.value),
            ", ".join(f"{count} {what.replace('_', ' ')}" for what, count in figure.counts.items()),
            {None: "", True: "yes", False: "**no**"}[figure.holds],
            worst,
            f"{sum(holding)} of {len(holding)}" if holding else "",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


#: Short headings of the figures in the table of campaigns.
HEADINGS = {
    "auc_near_probability": "AUC P near",
    "auc_near_change": "by change",
    "auc_interior_probability": "AUC P interior",
    "auc_interior_change": "by change",
    "alarms": "alarms",
    "located_probability": "located P",
    "located_change": "by change",
    "wrong": "wrong",
    "decided": "decided",
    "caught": "caught",
    "misfit_used": "dB used",
    "misfit_held_out": "dB held out",
    "seconds": "s",
    "contrast": "contrast",
    "tight_change": "tight rms",
    "tight_ratio": "in std",
    "lost": "lost",
}


def campaign_table(by_campaign: dict[str, list[Figure]]) -> str:
    """One row a campaign; shares with their counts, a star where a limit is missed."""

    def cell(figure: Figure) -> str:
        text = shown(figure.value)
        if text and figure.key in ("wrong", "decided", "caught", "located_probability", "located_change"):
            text = "{}/{}".format(*list(figure.counts.values())[:2])
        return text + ("*" if figure.holds is False else "")

    lines = ["| campaign | " + " | ".join(HEADINGS.values()) + " |", "|" + " --- |" * (len(HEADINGS) + 1)]
    for name, found in by_campaign.items():
        keyed = {figure.key: figure for figure in found}
        lines.append(f"| {name} | " + " | ".join(cell(keyed[key]) for key in HEADINGS) + " |")
    return "\n".join(lines)


def calibration_table(calibrations: dict[str, Calibration]) -> str:
    """One row a campaign."""
    names = list(dict.fromkeys(name for c in calibrations.values() for name in c.factors))
    heading = ["campaign", "status", "dB used", "dB held out", *names, "rounds", "s"]
    lines = ["| " + " | ".join(heading) + " |", "|" + " --- |" * len(heading)]
    for name, c in calibrations.items():
        cells = [name, c.status, shown(c.misfit), shown(c.held_out), *(f"{c.factors[n]:.4f}" if n in c.factors else "" for n in names)]
        lines.append("| " + " | ".join([*cells, str(c.rounds), shown(c.seconds)]) + " |")
    return "\n".join(lines)


def job_table(jobs: Sequence[JobScore]) -> str:
    """One row a job."""
    heading = [
        "campaign",
        "job",
        "status",
        "removed",
        "dB start",
        "dB used",
        "dB held out",
        "sigma [dB]",
        "correlation",
        "compared",
        "AUC near",
        "AUC interior",
    ]
    heading += ["contrast", "loose", "undecided", "wrong", "evaluations", "s"]
    lines = ["| " + " | ".join(heading) + " |", "|" + " --- |" * len(heading)]
    for job in jobs:
        cells = [job.campaign, job.job, job.status if job.role == "judged" else f"{job.status}, {job.role}", str(len(job.removed) or "")]
        cells += [shown(v) for v in (job.misfit_initial, job.misfit, job.held_out, job.sigma, job.factor)]
        cells.append("" if job.role == "reference" else "relative" if job.relative else "direct")
        for inside in (False, True):
            cells.append(shown(roc_auc([b for b in job.bolts if (b.interior if inside else b.near)], "probability")[0]))
        cells.append(shown(job.contrast))
        cells += [str(sum(b.verdict == word for b in job.bolts)) for word in ("loose", "undecided")]
        cells += [str(sum(b.wrong for b in job.bolts)), str(job.evaluations), shown(job.seconds)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def wrong_table(jobs: Sequence[JobScore]) -> str:
    """Every wrong verdict of a judged job."""
    lines = ["| campaign | job | bolt | truth | verdict | change | std | probability loose | interior |", "|" + " --- |" * 9]
    for job in jobs:
        for bolt in job.bolts if job.role == "judged" else ():
            if bolt.wrong:
                truth = "removed" if bolt.removed else "tight"
                numbers = [f"{v:.3f}" if v is not None else "" for v in (bolt.change, bolt.std, bolt.probability)]
                cells = [bolt.campaign, bolt.job, bolt.bolt, truth, bolt.verdict, *numbers, "yes" if bolt.interior else ""]
                lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) if len(lines) > 2 else "none"


def lost_places(jobs: Sequence[JobScore]) -> str:
    """Single loose bolts that were put elsewhere."""
    found = []
    for by in ("probability", "change"):
        for job in jobs:
            if job.role == "judged":
                found += [
                    f"- by {by}: {p.campaign}/{p.job} {p.bolt} put at {p.found}, {1e3 * p.distance:.0f} mm away"
                    for p in locate(job, by)
                    if not p.located
                ]
    return "\n".join(found) or "none"


def runs(seeds: Sequence[int]) -> list[tuple[int, int]]:
    """First and last of each stretch of neighbouring seeds."""
    found: list[tuple[int, int]] = []
    for seed in sorted(set(seeds)):
        if found and seed == found[-1][1] + 1:
            found[-1] = (found[-1][0], seed)
        else:
            found.append((seed, seed))
    return found


def generated(arguments: argparse.Namespace, work: Path) -> list[tuple[str, Path]]:
    """Write the measurements that were asked for; names and folders."""
    found: list[tuple[str, Path]] = []

    def write(script: Path, *options: str) -> None:
        subprocess.run([sys.executable, str(script), *options], check=True, env=dict(os.environ), stdout=sys.stderr)

    for seed in arguments.generate:
        folder = work / f"seed-{seed}"
        write(SAMPLE / "generate" / "measurements.py", "--seed", str(seed), "--out", str(folder))
        found.append((folder.name, folder))
    virtual = ROOT / "data_samples" / "virtual.py"
    for kind, wanted, options in (("virtual", arguments.virtual, ()), ("tight", arguments.tight, TIGHT)):
        for design, seeds in wanted:
            out = work / kind / design
            # A rig is assembled once a call: neighbouring seeds are written together.
            for first, last in runs(seeds):
                place = out if last > first else out / f"seed-{first}"
                write(virtual, design, "--seed", f"{first}-{last}", "--out", str(place), "--model", str(out / "model"), *options)
            found += [(f"{design}-{kind}-{seed}" if options else f"{design}-{seed}", out / f"seed-{seed}") for seed in seeds]
    return found


def designs(text: str) -> tuple[str, list[int]]:
    """A design and seeds from ``steel:11,12`` or ``soundbox:1-50``."""
    found = re.fullmatch(r"([\w-]+):((?:\d+(?:-\d+)?)(?:,\d+(?:-\d+)?)*)", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"'{text}' is no DESIGN:SEEDS as steel:11,12 or soundbox:1-50")
    seeds: list[int] = []
    for part in found[2].split(","):
        first, _, last = part.partition("-")
        seeds += range(int(first), int(last or first) + 1)
    return found[1], seeds


def names_of(folders: Sequence[Path]) -> list[tuple[str, Path]]:
    """Names that tell folders apart: the last part of their paths, or the last two."""
    short = [folder.resolve().name for folder in folders]
    return [(name if short.count(name) == 1 else f"{f.resolve().parent.name}-{name}", f) for name, f in zip(short, folders, strict=True)]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Those of every benchmark that runs campaigns."""
    parser.add_argument("--override", action="append", default=[], metavar="KEY.PATH=VALUE", help="as of lrbc")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="campaigns at a time (1)")
    parser.add_argument("--out", type=Path, help="keep generated measurements and results here")
    parser.add_argument("--resume", action="store_true", help="keep finished jobs and calibrations that --out holds, as lrbc does")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE")


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--generate", type=int, action="append", default=[], metavar="SEED")
    parser.add_argument("--virtual", type=designs, action="append", default=[], metavar="DESIGN:SEEDS")
    parser.add_argument("--tight", type=designs, action="append", default=[], metavar="DESIGN:SEEDS")
    parser.add_argument("--sample", action="store_true", help="the SoundBox sample beside the others")
    parser.add_argument("--config", type=Path, default=CONFIG, help="campaign file of folders without one")
    parser.add_argument("--no-calibration", action="store_true", help="the model as exported")
    parser.add_argument("--cache", type=Path, help="keep reduced models here; default: built anew")
    add_options(parser)
    arguments = parser.parse_args()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="lrbc-blind-") as scratch:
        work: Path = arguments.out or Path(scratch)
        campaigns = [*names_of(arguments.folders), *generated(arguments, work)]
        if arguments.sample or not campaigns:
            campaigns.insert(0, ("sample", SAMPLE / "frf"))
        cache = arguments.cache or work / "cache"
        tasks = [
            Task(
                name,
                folder,
                arguments.config,
                work / "results" / name,
                cache,
                tuple(arguments.override),
                not arguments.no_calibration,
                arguments.resume,
            )
            for name, folder in campaigns
        ]
        found, failures = in_processes(run_campaign, [(task,) for task in tasks], arguments.workers)
    jobs = [job for scores, _ in found.values() for job in scores]
    calibrations = {name: calibration for name, (_, calibration) in found.items() if calibration is not None}
    pooled = figures(jobs)
    by_campaign = {task.name: figures([job for job in jobs if job.campaign == task.name]) for task in tasks if task.name not in failures}
    parts = [
        pooled_table(pooled, by_campaign),
        campaign_table(by_campaign),
        f"Wrong verdicts:\n\n{wrong_table(jobs)}",
        f"Single loose bolts put elsewhere:\n\n{lost_places(jobs)}",
        job_table(jobs),
    ]
    if calibrations:
        parts.append(f"Calibrations:\n\n{calibration_table(calibrations)}")
    if failures:
        parts.append("Campaigns that failed:\n\n" + "\n".join(f"- {name}: {reason}" for name, reason in failures.items()))
    text = "\n\n".join(parts) + "\n"
    print(f"{text}\n{time.perf_counter() - start:.0f} s in all")
    if arguments.markdown:
        arguments.markdown.write_text(text, encoding="utf-8", newline="\n")
    if arguments.json:
        document = {
            "overrides": arguments.override,
            "pooled": [asdict(figure) | {"holds": figure.holds} for figure in pooled],
            "campaigns": {name: [asdict(f) | {"holds": f.holds} for f in found] for name, found in by_campaign.items()},
            "calibrations": {name: asdict(calibration) for name, calibration in calibrations.items()},
            "jobs": [asdict(job) for job in jobs],
            "failures": failures,
        }
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")
    return 1 if failures or any(figure.holds is False for figure in pooled) else 0


if __name__ == "__main__":
    raise SystemExit(main())
