"""The SoundBox campaign from end to end, by the installed command: every result file, every key, the figures it must reach."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import ROOT, command, environment
from shared import shared

from lrbc_cli import load
from lrbc_cli.campaign.identification.weights import mostly_noise
from lrbc_cli.campaign.jobs.table import CAMPAIGN_COLUMNS

pytestmark = pytest.mark.slow

REMOVED = {"bolts-00": 0, "bolts-04": 4, "bolts-06": 6, "bolts-10": 10, "bolts-12": 12, "bolts-15": 15, "bolts-17": 17}
MICS = [f"mic{i:02d}" for i in range(1, 11)]
USED = ["mic01", "mic03", "mic04", "mic05", "mic09", "mic10"]


@dataclass(frozen=True)
class Run:
    """The campaign after one update and one report."""

    out: Path
    cache: Path
    update: Any
    page: str

    def lrbc(self, name: str, *args: str) -> subprocess.CompletedProcess[str]:
        """Run the installed command on the sample, results elsewhere."""
        config = str(ROOT / "configs" / "soundbox.yaml")
        line = [*command(), name, config, "--cache", str(self.cache), "--override", f"output={self.out.as_posix()}", *args]
        return subprocess.run(line, capture_output=True, text=True, env=environment(), check=False)

    def result(self, job: str) -> Any:
        """A job's result.json."""
        return json.loads((self.out / job / "result.json").read_text())


def make(folder: Path) -> None:
    """The campaign from an empty folder to its report."""
    empty = Run(folder / "out", folder / "cache", None, "")
    for name, args in (("update", ["--json"]), ("report", [])):
        done = empty.lrbc(name, *args)
        assert done.returncode == 0, done.stderr
        # The model is not calibrated: its intervals say less than they seem to, and it says so.
        # A slow machine tells the progress of each minute, too.
        said = [line for line in done.stderr.splitlines() if f" of {len(REMOVED)} jobs" not in line]
        assert all(line.startswith("warning: job bolts-") and "the fit does not reach the data" in line for line in said), said
        assert bool(said) == (name == "update")
        (folder / name).write_text(done.stdout)


@pytest.fixture(scope="module")
def run() -> Run:
    """Read only."""
    folder = shared("soundbox-campaign", make)
    return Run(folder / "out", folder / "cache", json.loads((folder / "update").read_text()), (folder / "report").read_text())


def test_all_jobs_are_done(run: Run) -> None:
    assert list(run.update["results"]) == list(REMOVED)
    assert run.update["kept"] == []
    assert run.update["failed"] == {}
    for job, tree in run.update["results"].items():
        assert tree == run.result(job)
        assert tree["status"] == "converged"


def test_every_file_is_there(run: Run) -> None:
    figures = {f"frf-{mic}.png" for mic in MICS}
    tables = {"result.json", "evidence.json", "profile.csv", "frf.csv", "fdac.csv", "shapes.json"}
    files = tables | {"profile.png", "fdac.png", "map.png", "structure.png", "shapes.png"}
    for job in REMOVED:
        assert {p.name for p in (run.out / job).iterdir()} == files | figures
        for png in (run.out / job).glob("*.png"):
            assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    names = {p.name for p in run.out.iterdir() if p.is_file()}
    assert names == {"campaign.csv", "campaign.json", "damping.png", "reduction.json", "report.html", "structure.json", "verdicts.png"}


@pytest.mark.parametrize("job", REMOVED)
def test_every_key_is_there(run: Run, job: str) -> None:
    tree = run.result(job)
    assert set(tree) >= {
        "job",
        "status",
        "reason",
        "parameters",
        "cost",
        "misfit_db",
        "bolts",
        "iterations",
        "evaluations",
        "seconds",
        "provenance",
    }
    group = tree["parameters"]["left_edge"]
    assert set(group) >= {"log10", "log10_effective", "positions", "damping_exponent", "damping_factor", "bounds", "unit"}
    assert group["unit"] == "N m/rad"
    assert len(group["log10"]) == len(group["positions"]) == 34
    assert np.all(np.isfinite(group["log10"]))
    assert len(group["std"]) == len(group["lower95"]) == len(group["upper95"]) == 34
    assert np.all(np.isfinite(group["std"]))
    for low, value, high in zip(group["lower95"], group["log10_effective"], group["upper95"], strict=True):
        # An open interval has no limit.
        assert low is None or low <= value
        assert high is None or value <= high
    for key in ("cost", "misfit_db"):
        assert tree[key]["final"] < tree[key]["initial"]
    assert list(tree["misfit_db"]["responses"]) == MICS
    assert [mic for mic, entry in tree["misfit_db"]["responses"].items() if entry["used"]] == USED
    assert [bolt["name"] for bolt in tree["bolts"]] == [f"B{i:02d}" for i in range(1, 18)]
    for bolt in tree["bolts"]:
        assert {"name", "position", "log10_stiffness", "change", "verdict", "removed"} <= set(bolt)
        assert bolt["verdict"] in ("tight", "loose", "undecided", "outside")
        # These stand beyond the ends of the edge.
        beyond = bolt["name"] in ("B01", "B02", "B16", "B17")
        assert (bolt["verdict"] == "outside") == beyond
        assert beyond or job == "bolts-00" or 0.0 <= bolt["probability_loose"] <= 1.0
    assert sum(bolt["removed"] for bolt in tree["bolts"]) == REMOVED[job]
    assert {"read", "optimise", "total"} <= set(tree["seconds"])
    provenance = tree["provenance"]
    assert set(provenance) >= {"versions", "inputs", "certificate", "configuration"}
    assert {Path(name).name for name in provenance["inputs"]} == {"model.h5", "dofs.csv", "bolts.csv", f"{job}.uff"}
    assert provenance["certificate"]["worst"] <= provenance["certificate"]["tolerance"] == 1e-3
    assert provenance["configuration"]["campaign"] == "soundbox-left-edge"
    assert provenance["configuration"]["reduction"]["held_out"] >= 5


def test_the_reduction_is_certified_and_priced(run: Run) -> None:
    tree = json.loads((run.out / "reduction.json").read_text())
    assert 20_000 <= tree["full_size"] <= 25_000
    assert tree["size"] < 0.05 * tree["full_size"]
    assert tree["terms"] == 34
    assert tree["reached"] is True
    assert tree["certificate"]["worst"] <= 1e-3
    points = {point["frequency_hz"] for point in tree["expansion_points"]}
    held_out = [line["frequency_hz"] for line in tree["certificate"]["held_out"]]
    assert len(held_out) >= 5
    assert not points & set(held_out)
    for line in tree["certificate"]["held_out"]:
        assert {"free", "loose", "clamped", "random"} <= set(line["errors"])
    for key in ("full_line", "reduced_line", "port_line", "basis", "projection", "total", "full_lines_worth"):
        assert tree["seconds"][key] > 0
    assert tree["machine"]["cores"] >= 1
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", tree["date"])


def near(positions: np.ndarray, bolts: list[Any], removed: bool) -> np.ndarray:
    """Nodes within half a pitch, along the edge (y), of removed or of tight bolts."""
    y = np.array([bolt["position"][1] for bolt in bolts])
    pitch = np.median(np.diff(np.sort(y)))
    own = np.array([bolt["removed"] is removed for bolt in bolts])
    away = np.abs(positions[:, 1][:, None] - y[own][None, :])
    return away.min(axis=1) <= 0.5 * pitch * (1 + 1e-9) if own.any() else np.zeros(len(positions), dtype=bool)


@pytest.mark.parametrize("job", [job for job, count in REMOVED.items() if count])
def test_removed_bolts_are_seen(run: Run, job: str) -> None:
    """More than a decade between the stiffness at removed bolts and at tight ones."""
    tree, tight = run.result(job), run.result("bolts-00")
    group = tree["parameters"]["left_edge"]
    positions, log10 = np.array(group["positions"]), np.array(group["log10_effective"])
    gone, left = near(positions, tree["bolts"], True), near(positions, tree["bolts"], False) & ~near(positions, tree["bolts"], True)
    assert gone.any()
    high = log10[left].mean() if left.any() else np.array(tight["parameters"]["left_edge"]["log10_effective"])[gone].mean()
    assert log10[gone].mean() < high - 1.0


@pytest.fixture(scope="module")
def noisy() -> np.ndarray:
    """Values of the reference job that are mostly noise, by its coherence."""
    study = load(ROOT / "configs" / "soundbox.yaml", calibration=False)
    return mostly_noise(study.inputs, study.read("bolts-00"), study.inputs.campaign.jobs["bolts-00"], known=True)


@pytest.mark.parametrize("job", REMOVED)
def test_the_misfit_is_small(run: Run, noisy: np.ndarray, job: str) -> None:
    """Over all lines of the band that are not mostly noise in the reference job, recomputed from the table of FRFs."""
    with (run.out / job / "frf.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 381
    tree = run.result(job)
    assert noisy.shape == (381, len(MICS))
    assert 0.0 < noisy.mean() < 0.01
    found = {}
    for mic, lost in zip(MICS, noisy.T, strict=True):
        measured, updated = (np.array([float(row[f"{mic}_{kind}_db"] or "nan") for row in rows]) for kind in ("measured", "updated"))
        found[mic] = float(np.nanmean(np.where(lost, np.nan, np.abs(updated - measured))))
        assert found[mic] == pytest.approx(tree["misfit_db"]["responses"][mic]["final"], abs=1e-6)
    used = np.mean([found[mic] for mic in USED])
    assert tree["misfit_db"]["final"] == pytest.approx(used, abs=1e-6)
    assert used <= 2.5


def test_the_table_of_the_campaign(run: Run) -> None:
    with (run.out / "campaign.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == CAMPAIGN_COLUMNS
    assert [row["job"] for row in rows] == list(REMOVED)
    for row in rows:
        assert row["status"] == "converged"
        assert len(row["removed"].split()) == REMOVED[row["job"]]
        assert float(row["misfit_final_db"]) < float(row["misfit_initial_db"])
        assert -3.0 <= float(row["damping_exponent"]) <= 4.0


def test_the_page_stands_alone(run: Run) -> None:
    page = (run.out / "report.html").read_text()
    assert page.lstrip().lower().startswith("<!doctype html")
    assert page.rstrip().endswith("</html>")
    # No request to anywhere: links to places inside the page and to the files beside it only, which are there.
    assert not re.search(r"""src\s*=\s*["'](?!data:)""", page)
    for link in set(re.findall(r"""href\s*=\s*["'](?!#|data:)([^"']*)""", page)):
        assert (run.out / link).is_file(), link
    assert not re.search(r"url\((?!['\"]?(?:#|data:))", page)
    assert "<script src" not in page
    for word in [*REMOVED, *MICS]:
        assert word in page
    assert "report.html" in run.page
    assert all(job in run.page for job in REMOVED)


def test_the_second_run_keeps_everything(run: Run, tmp_path: Path) -> None:
    run = replace(run, out=Path(shutil.copytree(run.out, tmp_path / "out")))
    before = {path: path.stat().st_mtime_ns for path in run.out.glob("*/*")}
    reduced = run.lrbc("reduce", "--json")
    assert reduced.returncode == 0
    tree = json.loads(reduced.stdout)
    assert tree["cache"]["hit"] is True
    assert "matrices, terms, excitation, responses, band and tolerance are those of a model in the cache" in tree["cache"]["reason"]
    # All is kept, and the exit code still says that bolts are loose.
    update = run.lrbc("update", "--json", "--fail-on-loose")
    assert update.returncode == 6
    assert json.loads(update.stdout)["kept"] == list(REMOVED)
    assert {path: path.stat().st_mtime_ns for path in run.out.glob("*/*")} == before
