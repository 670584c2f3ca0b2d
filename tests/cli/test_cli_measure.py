"""The script for a measurement campaign: FRF files arrive, verdicts are told, the exit code says whether a bolt is loose."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from campaigns import ROOT, Folder, command, environment, frame

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="a POSIX shell script"),
    pytest.mark.skipif(len(command()) > 1, reason="the command is not installed"),
]


def measure(folder: Folder, *args: str) -> subprocess.CompletedProcess[str]:
    path = f"{Path(command()[0]).parent}{os.pathsep}{os.environ['PATH']}"
    line = ["sh", str(ROOT / "configs" / "measure.sh"), *args]
    return subprocess.run(
        line, capture_output=True, text=True, check=False, timeout=120, env=environment() | {"PATH": path, "LRBC_CACHE": str(folder.cache)}
    )


def test_files_arrive_one_by_one(tmp_path: Path) -> None:
    """The campaign's own files are missing: what arrives is identified, from a folder that needs quotes."""
    folder = frame(tmp_path / "frame")
    waiting = tmp_path / "waiting"
    (folder.data / "frf").rename(waiting)
    new = tmp_path / "it's new: #1"
    new.mkdir()

    shutil.copy(waiting / "tight.csv", new)
    (new / "notes.csv").write_text("no measurement")
    (new / "two words.csv").write_text("no measurement")
    tight = measure(folder, str(folder.config), str(new), "--once")
    assert tight.returncode == 0, tight.stderr
    assert "reduced model:" in tight.stdout
    assert "tight: all bolts tight, go on" in tight.stdout
    assert "notes.csv: no job of this campaign has this name" in tight.stdout
    assert "two words.csv: no job of this campaign has this name" in tight.stdout
    assert (folder.out / "report.html").is_file()
    assert not (folder.out / "notes").exists()

    # Another measurement under the name of this job.
    before = (folder.out / "tight" / "result.json").stat().st_mtime_ns
    shutil.copy(waiting / "loose-2.csv", new / "loose-all.csv")
    loose = measure(folder, str(folder.config), str(new), "--once")
    assert loose.returncode == 6, loose.stderr
    assert "cache: hit" in loose.stdout
    assert "loose-all: A BOLT IS LOOSE" in loose.stdout
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


def test_wrong_calls(tmp_path: Path) -> None:
    folder = frame(tmp_path / "frame")
    assert "usage: measure.sh CONFIG FOLDER" in measure(folder).stderr
    nowhere = measure(folder, str(folder.config), str(tmp_path / "nowhere"), "--once")
    assert nowhere.returncode == 2
    assert "nowhere" in nowhere.stderr
    missing = measure(folder, str(tmp_path / "none.yaml"), str(tmp_path), "--once")
    assert missing.returncode == 2
    assert "none.yaml" in missing.stderr
