"""Are the right places found? Contrast, misfit and ranking on rigs that the identification knows nothing about.

    python tests/benchmarks/blind.py [FOLDER]... [--generate SEED]... [--override KEY.PATH=VALUE]... [--json FILE] [--markdown FILE]

Each FOLDER holds ``JOB.uff`` for the jobs of the campaign file and ``truth.json``, as written by
``data_samples/soundbox/generate/measurements.py --seed N --out FOLDER``; ``--generate`` makes such folders for these seeds first
(extra ``samples``). Without either the sample's own folder is used. Exit code 1 where a job misses a limit.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.campaign.inputs import read_inputs
from lrbc_cli.campaign.run import run_jobs
from lrbc_cli.config import load_campaign
from lrbc_cli.updating.verdicts import Edge, foot, pitch_of

Floats = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "configs" / "soundbox.yaml"
SAMPLE = ROOT / "data_samples" / "soundbox"

#: Limits of the figures: decades between tight and removed, mean dB over all lines of the band for the responses used.
LEAST_CONTRAST, LARGEST_MISFIT = 1.0, 2.5


@dataclass(frozen=True)
class Row:
    """Figures of one job.

    Attributes
    ----------
    folder, job : str
    status : str
    removed : float or None
        Mean log10 stiffness within half a pitch of the removed bolts.
    tight : float or None
        The same of the tight bolts of this job, or of the removed bolts' places in the tight state where no tight bolt has a term near it.
    against : str
        ``tight`` or ``reference``: which of the two.
    contrast : float or None
        tight - removed [decades].
    contrast_reference : float or None
        Contrast to the same places in the tight state.
    misfit_initial, misfit, held_out : float
        Mean absolute difference [dB] over all lines of the band: responses used (start, end), the others.
    auc, auc_covered : float or None
        Probability that a removed bolt has changed more than a tight one: all bolts, and those with a term within half a pitch.
    damping_exponent : float or None
    evaluations : int
    seconds : float
    missed : list of str
        Limits that do not hold.
    """

    folder: str
    job: str
    status: str
    removed: float | None
    tight: float | None
    against: str
    contrast: float | None
    contrast_reference: float | None
    misfit_initial: float
    misfit: float
    held_out: float
    auc: float | None
    auc_covered: float | None
    damping_exponent: float | None
    evaluations: int
    seconds: float
    missed: list[str] = field(default_factory=list)


def nodes_near(edge: Edge, bolts: dict[str, Floats], names: Sequence[str]) -> NDArray[np.int64]:
    """Terms within half a pitch, along the edge, of any of the named bolts."""
    half = 0.5 * pitch_of(np.array(list(bolts.values())))
    away = [np.abs(edge.arc_length - foot(edge, bolts[name])[0]) for name in names]
    return np.flatnonzero(np.min(away, axis=0) <= half * (1 + 1e-9)) if away else np.zeros(0, dtype=np.int64)


def ranking(changes: dict[str, float], removed: Sequence[str]) -> float | None:
    """Area under the ROC curve of the ranking by change, removed against tight; None where one kind is missing."""
    low = [value for name, value in changes.items() if name in removed]
    high = [value for name, value in changes.items() if name not in removed]
    if not low or not high:
        return None
    wins = [1.0 if a < b else (0.5 if a == b else 0.0) for a in low for b in high]
    return float(np.mean(wins))


def figures(folder: str, tree: dict[str, Any], reference: dict[str, Any], removed: list[str]) -> Row:
    """Figures of one job from its result and that of the tight state."""
    (name,) = [key for key, group in tree["parameters"].items() if group["kind"] == "stiffness"]
    group, before = tree["parameters"][name], reference["parameters"][name]
    bolts = {b["name"]: np.array(b["position"], dtype=float) for b in tree["bolts"]}
    log10, log10_tight = (np.array(g["log10_effective"], dtype=float) for g in (group, before))
    edge = Edge(np.array(group["positions"]), np.array(group["arc_length"]), log10, np.inf, None)
    gone = nodes_near(edge, bolts, removed)
    left = np.setdiff1d(nodes_near(edge, bolts, [b for b in bolts if b not in removed]), gone)
    low = tight = contrast = contrast_reference = None
    against = "tight"
    if gone.size:
        low = float(log10[gone].mean())
        places = float(log10_tight[gone].mean())
        tight, against = (float(log10[left].mean()), "tight") if left.size else (places, "reference")
        contrast, contrast_reference = tight - low, places - low
    elif left.size:
        tight = float(log10[left].mean())
    changes = {b["name"]: float(b["change"]) for b in tree["bolts"]}
    covered = {b: changes[b] for b in bolts if nodes_near(edge, bolts, [b]).size}
    misfit = tree["misfit_db"]
    missed = []
    if contrast is not None and contrast <= LEAST_CONTRAST:
        missed.append("contrast")
    if misfit["final"] > LARGEST_MISFIT:
        missed.append("misfit")
    return Row(
        folder,
        tree["job"],
        tree["status"],
        low,
        tight,
        against,
        contrast,
        contrast_reference,
        float(misfit["initial"]),
        float(misfit["final"]),
        float(misfit["held_out_final"]),
        ranking(changes, removed),
        ranking(covered, removed),
        group.get("damping_exponent"),
        int(tree["evaluations"]),
        float(tree["seconds"]["total"]),
        missed,
    )


def identify_folder(config: Path, folder: Path, output: Path, cache: Path, overrides: Sequence[str]) -> list[Row]:
    """Run the campaign on the measurements of a folder; the identification does not see which bolts are removed."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    own = [f"output={json.dumps(output.as_posix())}"]
    for job in load_campaign(config).jobs:
        own.append(f"jobs.{job}={json.dumps({'frf': (folder / f'{job}.uff').resolve().as_posix()})}")
    inputs = read_inputs(load_campaign(config, [*own, *overrides]))
    outcome, _ = run_jobs(inputs, cache)
    for job, error in outcome.errors.items():
        print(f"{folder}: {job} failed: {error.message}", file=sys.stderr)
    reference = outcome.results[str(inputs.campaign.update.reference)]
    return [figures(folder.name, tree, reference, truth["jobs"][job]["removed"]) for job, tree in sorted(outcome.results.items())]


COLUMNS = {
    "folder": "rig",
    "job": "job",
    "removed": "removed",
    "tight": "tight",
    "contrast": "contrast",
    "contrast_reference": "to tight state",
    "misfit_initial": "dB start",
    "misfit": "dB used",
    "held_out": "dB others",
    "auc": "AUC",
    "auc_covered": "AUC covered",
    "damping_exponent": "p_damp",
    "evaluations": "evaluations",
    "seconds": "s",
    "missed": "missed",
}


def table(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table."""

    def cell(row: Row, key: str) -> str:
        value = getattr(row, key)
        if key == "tight" and row.against == "reference" and value is not None:
            return f"({value:.2f})"
        if isinstance(value, float):
            return f"{value:.2f}"
        if isinstance(value, list):
            return ", ".join(value)
        return "" if value is None else str(value)

    lines = ["| " + " | ".join(COLUMNS.values()) + " |", "|" + " --- |" * len(COLUMNS)]
    lines += ["| " + " | ".join(cell(row, key) for key in COLUMNS) + " |" for row in rows]
    return "\n".join(lines)


def summary(rows: Sequence[Row]) -> str:
    """Worst figures, and which jobs miss which limit."""
    contrasts = [row.contrast for row in rows if row.contrast is not None]
    aucs = [row.auc for row in rows if row.auc is not None]
    covered = [row.auc_covered for row in rows if row.auc_covered is not None]
    missed = [f"{row.folder}/{row.job} ({', '.join(row.missed)})" for row in rows if row.missed]
    return "\n".join(
        [
            f"{len(rows)} jobs; least contrast {min(contrasts):.2f} decades (limit {LEAST_CONTRAST:g}), "
            f"largest misfit {max(row.misfit for row in rows):.2f} dB (limit {LARGEST_MISFIT:g}), "
            f"mean misfit {np.mean([row.misfit for row in rows]):.2f} dB used, {np.mean([row.held_out for row in rows]):.2f} dB others; "
            f"mean AUC {np.mean(aucs):.2f} all bolts, {np.mean(covered):.2f} bolts with a term near",
            "missed: " + ("; ".join(missed) if missed else "none"),
        ]
    )


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--generate", type=int, action="append", default=[], metavar="SEED")
    parser.add_argument("--config", type=Path, default=CONFIG)
    parser.add_argument("--override", action="append", default=[], metavar="KEY.PATH=VALUE", help="as of lrbc")
    parser.add_argument("--cache", type=Path, help="keep the reduced model here; default: built anew")
    parser.add_argument("--out", type=Path, help="keep generated measurements and results here")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="lrbc-blind-") as scratch:
        work: Path = arguments.out or Path(scratch)
        folders = list(arguments.folders)
        for seed in arguments.generate:
            folder = work / f"seed-{seed}"
            generator = SAMPLE / "generate" / "measurements.py"
            subprocess.run([sys.executable, str(generator), "--seed", str(seed), "--out", str(folder)], check=True, env=dict(os.environ))
            folders.append(folder)
        rows: list[Row] = []
        for at, folder in enumerate(folders or [SAMPLE / "frf"]):
            output = work / f"results-{at}-{folder.name}"
            rows += identify_folder(arguments.config, folder, output, arguments.cache or work / "cache", arguments.override)
    text = f"{table(rows)}\n\n{summary(rows)}\n"
    print(f"{text}\n{time.perf_counter() - start:.0f} s in all")
    if arguments.markdown:
        arguments.markdown.write_text(text, encoding="utf-8", newline="\n")
    if arguments.json:
        document = {"limits": {"contrast": LEAST_CONTRAST, "misfit_db": LARGEST_MISFIT}, "rows": [asdict(row) for row in rows]}
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")
    return 1 if any(row.missed for row in rows) else 0


if __name__ == "__main__":
    raise SystemExit(main())
