"""Killed while a file is being written: nothing half written counts, what was there stays, the next run completes."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import pytest
import scipy.io
from campaigns import Folder, environment, finished, frame, two_jobs

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

#: The command, killed when it has written the first half of a file; the file's name comes first.
KILLED = """
import os, signal, sys
from lrbc_cli.io import atomic

name = sys.argv.pop(1)

def flush(path, flush=atomic._flush):
    if path.name.startswith("." + name.partition(".")[0] + "-") and path.suffix == "." + name.partition(".")[2]:
        os.truncate(path, path.stat().st_size // 2)
        os.kill(os.getpid(), signal.SIGKILL)
    flush(path)

atomic._flush = flush
from lrbc_cli.cli.main import main
main()
"""


def kill(folder: Folder, file: str, command: str, *args: str) -> None:
    line = [sys.executable, "-c", KILLED, file, command, str(folder.config), "--cache", str(folder.cache), *args]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=120, env=environment())
    assert done.returncode == -signal.SIGKILL, done.stderr
    # It did die with half a file, under another name.
    assert [path for path in folder.path.rglob(f".{file.partition('.')[0]}-*") if path.is_file()]


def calibration(folder: Folder) -> Any:
    tree = json.loads((folder.out / "calibration.json").read_text())
    return {key: tree[key] for key in ("key", "status", "factors", "boundary", "misfit_db", "rounds")}


def found(folder: Folder) -> Any:
    return {
        job: {key: tree[key] for key in ("status", "parameters", "misfit_db", "bolts")} | {"identity": tree["provenance"]["identity"]}
        for job, tree in folder.results().items()
    }


#: Jobs of these campaigns.
JOBS = ["tight", "loose-2"]


@pytest.fixture
def calibrated(tmp_path: Path) -> Folder:
    """No job is done yet."""
    return finished("calibrated").copy(tmp_path / "calibrated")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    folder = finished("calibrated").copy(tmp_path_factory.mktemp("undisturbed") / "frame")
    outcome = folder.run("update")
    assert outcome.code == 0, outcome.stderr
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("file", ["model.h5", "calibration.json", "campaign.json"])
def test_calibrate(tmp_path: Path, undisturbed: Folder, file: str) -> None:
    folder = two_jobs(tmp_path / "frame")
    kill(folder, file, "calibrate")
    folder.assert_whole()
    # What vouches for the others comes after them.
    there = (folder.out / "calibration.json").is_file()
    assert there == (file == "campaign.json")
    outcome = folder.run("calibrate", "--json")
    assert outcome.code == 0, outcome.stderr
    folder.assert_whole()
    assert calibration(folder) == calibration(undisturbed)
    assert folder.run("update", "--job", "tight").code == 0
    assert found(folder) == {"tight": found(undisturbed)["tight"]}


@pytest.mark.slow
def test_calibrating_again(tmp_path: Path, undisturbed: Folder) -> None:
    """The calibration that was there stays in use, and so do the results that rest on it."""
    folder = undisturbed.copy(tmp_path / "frame")
    before = (folder.out / "calibration.json").read_bytes()
    kill(folder, "calibration.json", "calibrate", "--force")
    assert (folder.out / "calibration.json").read_bytes() == before
    outcome = folder.run("update", "--json")
    assert "calibration: used" in outcome.stderr
    assert outcome.json["kept"] == JOBS


@pytest.mark.slow
@pytest.mark.parametrize("file", ["campaign.json", "reduction.json", "evidence.json", "campaign.csv", "result.json"])
def test_update(calibrated: Folder, undisturbed: Folder, file: str) -> None:
    folder = calibrated
    kill(folder, file, "update")
    folder.assert_whole()
    for path in folder.out.glob("*/result.json"):
        assert {other.name for other in path.parent.iterdir()} >= {"profile.csv", "frf.csv", "fdac.csv", "evidence.json"}
    outcome = folder.run("update", "--json")
    assert outcome.code == 0, outcome.stderr
    assert set(outcome.json["kept"]) == (set(JOBS) if file == "campaign.csv" else set())
    folder.assert_whole()
    assert found(folder) == found(undisturbed)
    with (folder.out / "campaign.csv").open(newline="") as table:
        assert [row["job"] for row in csv.DictReader(table)] == JOBS
    # The report needs every file; one of these folders is as good as another.
    assert file != "result.json" or folder.run("report", "--job", "tight").code == 0


@pytest.mark.slow
@pytest.mark.parametrize("file", ["frf.csv", "result.json"])
def test_killed_between_the_files_of_a_job(tmp_path: Path, undisturbed: Folder, file: str) -> None:
    """They are replaced together, so the earlier result is whole."""
    folder = undisturbed.copy(tmp_path / "frame")
    kill(folder, file, "update", "--override", "parameters.left_edge.initial=6.0")
    assert folder.run("report").code == 0
    outcome = folder.run("update", "--json")
    assert outcome.json["kept"] == JOBS


@pytest.mark.slow
@pytest.mark.parametrize("file", ["model.h5", "rows.h5"])
def test_killed_between_the_model_and_its_basis(tmp_path: Path, file: str) -> None:
    """Every job has its deflection shapes in the end."""
    folder = two_jobs(tmp_path / "frame")
    kill(folder, file, "reduce")
    outcome = folder.run("update", "--job", "tight")
    assert outcome.code == 0, outcome.stderr
    assert "no deflection shapes" not in outcome.stderr
    assert "shapes.json" in folder.result("tight")["provenance"]["files"]


@pytest.mark.slow
def test_files_of_two_runs(tmp_path: Path, undisturbed: Folder) -> None:
    """As a copy of a part of the folder leaves them: never shown together, and never kept."""
    folder = undisturbed.copy(tmp_path / "frame")
    mixed = folder.out / "tight" / "profile.csv"
    mixed.write_bytes((folder.out / "loose-2" / "profile.csv").read_bytes())
    report = folder.run("report")
    assert report.code == 3
    assert str(mixed) in report.stderr
    assert "two runs are mixed" in report.stderr
    assert "loose-2: B3, B4 loose" in report.stdout
    assert "tight: no verdict: its result cannot be read" in (folder.out / "report.html").read_text(encoding="utf-8")
    plan = folder.run("update", "--dry-run", "--json").json["jobs"]["tight"]
    assert plan == {"run": True, "judge": False, "reason": "profile.csv is not the file that was written with it"}
    outcome = folder.run("update", "--json")
    # The same end as before, so that what rests on it stays.
    assert outcome.json["kept"] == ["loose-2"]
    assert found(folder) == found(undisturbed)
    for name in ("profile.csv", "frf.csv", "fdac.csv"):
        assert (folder.out / "tight" / name).read_bytes() == (undisturbed.out / "tight" / name).read_bytes()
    assert folder.run("report", "--job", "tight").code == 0


READERS = {"h5": lambda path: h5py.File(path).close(), "mat": scipy.io.loadmat}


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["h5", "mat"])
def test_export(tmp_path: Path, ending: str) -> None:
    folder = frame(tmp_path / "frame")
    target = folder.path / f"mine.{ending}"
    options = ("--export", str(target), "--state-space")
    kill(folder, target.name, "reduce", *options)
    assert not target.exists()
    assert folder.run("reduce", *options).code == 0
    READERS[ending](target)
    before = target.read_bytes()
    kill(folder, target.name, "reduce", *options)
    assert target.read_bytes() == before


@pytest.mark.parametrize("ending", ["h5", "mat"])
@pytest.mark.parametrize("place", ["a folder", "below a file"])
def test_export_to_a_place_that_cannot_be_written(frame: Folder, ending: str, place: str) -> None:
    target = frame.path / f"mine.{ending}" if place == "a folder" else frame.config / f"mine.{ending}"
    if place == "a folder":
        (target / "inside").mkdir(parents=True)
    before = frame.listing()
    outcome = frame.run("reduce", "--export", str(target))
    assert outcome.code == 2, outcome.stderr
    assert target.name in outcome.stderr
    assert "Traceback" not in outcome.stderr
    after = frame.listing()
    assert set(after) == set(before)
    assert after["campaign.yaml"] == before["campaign.yaml"]
