"""The script for a measurement campaign: FRF files arrive, verdicts are told, the exit code says whether a bolt is loose."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from campaigns import ROOT, Folder, command, environment, frame, measure_again

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="a POSIX shell script"),
    pytest.mark.skipif(len(command()) > 1, reason="the command is not installed"),
]


def measure(folder: Folder, *args: str) -> subprocess.CompletedProcess[str]:
    path = f"{Path(command()[0]).parent}{os.pathsep}{os.environ['PATH']}"
    line = ["sh", str(ROOT / "configs" / "measure.sh"), *args]
    return subprocess.run(
        line, capture_output=True, text=True, check=False, timeout=600, env=environment() | {"PATH": path, "LRBC_CACHE": str(folder.cache)}
    )


@pytest.mark.slow
def test_files_arrive_one_by_one(tmp_path: Path) -> None:
    """The campaign's own files are missing: what arrives is identified, from a folder that needs quotes."""
    folder = frame(tmp_path / "frame")
    waiting = tmp_path / "waiting"
    (folder.data / "frf").rename(waiting)
    new = tmp_path / "it's new: #1"
    new.mkdir()
    nothing = measure(folder, str(folder.config), str(new), "--once")
    assert nothing.returncode == 7, nothing.stderr

    shutil.copy(waiting / "tight.csv", new)
    (new / "notes.csv").write_text("no measurement")
    (new / "two words.csv").write_text("no measurement")
    tight = measure(folder, str(folder.config), str(new), "--once")
    # The tight state alone shows nothing.
    assert tight.returncode == 7, tight.stderr
    assert "reduced model:" in tight.stdout
    assert "tight: the reference job, taken as tight" in tight.stdout
    assert "go on" not in tight.stdout
    assert "notes.csv: no job of this campaign has this name" in tight.stdout
    assert "two words.csv: no job of this campaign has this name" in tight.stdout
    assert (folder.out / "report.html").is_file()
    assert not (folder.out / "notes").exists()

    # Another measurement under the name of this job.
    before = (folder.out / "tight" / "result.json").stat().st_mtime_ns
    shutil.copy(waiting / "loose-2.csv", new / "loose-all.csv")
    loose = measure(folder, str(folder.config), str(new), "--once")
    # 6 comes before 7.
    assert loose.returncode == 6, loose.stderr
    assert "go on" not in loose.stdout
    assert "cache: hit" in loose.stdout
    assert "loose-all: A BOLT IS LOOSE: B3, B4 loose" in loose.stdout
    loose_bolts = {bolt["name"] for bolt in folder.result("loose-all")["bolts"] if bolt["verdict"] == "loose"}
    assert loose_bolts == {"B3", "B4"}
    assert (folder.out / "tight" / "result.json").stat().st_mtime_ns == before
    assert "loose-all" in (folder.out / "report.html").read_text()

    # Half a file.
    (new / "loose-2.csv").write_bytes(b"frequency_hz,acc1_r")
    half = measure(folder, str(folder.config), str(new), "--once")
    assert half.returncode == 5
    assert "loose-2: no result" in half.stdout
    assert str(new / "loose-2.csv") in half.stderr
    assert folder.result("loose-all")["status"] == "converged"


def waiting_for(tmp_path: Path) -> tuple[Folder, Path, Path]:
    """A campaign without measurements, where they wait, and where they are put."""
    folder = frame(tmp_path / "frame")
    tree = folder.tree()
    del tree["calibration"]
    folder.write(tree)
    waiting = tmp_path / "waiting"
    (folder.data / "frf").rename(waiting)
    new = tmp_path / "new"
    new.mkdir()
    shutil.copy(waiting / "tight.csv", new)
    return folder, waiting, new


@pytest.mark.slow
def test_go_on_is_said_only_of_what_is_clear(tmp_path: Path) -> None:
    """A second tight measurement, and beside it a file of no job."""
    folder, waiting, new = waiting_for(tmp_path)
    tree = folder.tree()
    # Bolts that are stated as removed and come out tight would be no all-clear.
    tree["jobs"]["loose-all"].pop("removed")
    folder.write(tree)
    # A second measurement of the tight state: the same file once more would tell nothing.
    measure_again(waiting / "tight.csv", new / "loose-all.csv")
    misnamed = new / "Loose-2.csv"
    shutil.copy(waiting / "loose-2.csv", misnamed)
    assert measure(folder, str(folder.config), str(new), "--once").returncode == 7
    misnamed.unlink()
    clear = measure(folder, str(folder.config), str(new), "--once")
    assert clear.returncode == 0, clear.stderr
    assert "loose-all: all bolts tight, go on (no loose bolt found: 6 tight)" in clear.stdout


@pytest.mark.slow
def test_no_all_clear_of_what_the_model_does_not_explain(tmp_path: Path) -> None:
    """The channel that checks the result is wrong by a factor."""
    folder, waiting, new = waiting_for(tmp_path)
    header, *rows = [line.split(",") for line in (waiting / "tight.csv").read_text().splitlines()]
    at = [i for i, name in enumerate(header) if name.startswith("acc4_")]
    wrong = [header, *([repr(10.0 * float(cell)) if i in at else cell for i, cell in enumerate(row)] for row in rows)]
    (new / "loose-2.csv").write_text("\n".join(",".join(row) for row in wrong) + "\n")
    unexplained = measure(folder, str(folder.config), str(new), "--once")
    assert unexplained.returncode == 7, unexplained.stderr
    assert "loose-2: NO ALL-CLEAR: loose-2: no verdict: the model does not explain the measurement" in unexplained.stdout
    assert "go on" not in unexplained.stdout
    assert folder.result("loose-2")["status"] == "unexplained"


@pytest.mark.slow
def test_wrong_calls(tmp_path: Path) -> None:
    folder = frame(tmp_path / "frame")
    assert "usage: measure.sh CONFIG FOLDER" in measure(folder).stderr
    nowhere = measure(folder, str(folder.config), str(tmp_path / "nowhere"), "--once")
    assert nowhere.returncode == 2
    assert "nowhere" in nowhere.stderr
    missing = measure(folder, str(tmp_path / "none.yaml"), str(tmp_path), "--once")
    assert missing.returncode == 2
    assert "none.yaml" in missing.stderr
