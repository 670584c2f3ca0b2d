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


def arrive(folder: Folder, waiting: Path, name: str, content: bytes | None = None) -> str:
    """Put a new file where the campaign expects it; the folder to watch, which holds what is new."""
    shutil.rmtree(folder.path / "new", ignore_errors=True)
    (folder.path / "new").mkdir()
    (folder.data / "frf" / name).write_bytes(content or (waiting / name).read_bytes())
    shutil.copy(folder.data / "frf" / name, folder.path / "new")
    return str(folder.path / "new")


def test_files_arrive_one_by_one(tmp_path: Path) -> None:
    folder = frame(tmp_path / "frame")
    waiting = tmp_path / "waiting"
    (folder.data / "frf").rename(waiting)
    (folder.data / "frf").mkdir()

    tight = measure(folder, str(folder.config), arrive(folder, waiting, "tight.csv"), "--once")
    assert tight.returncode == 0, tight.stderr
    assert "reduced model:" in tight.stdout
    assert "tight: all bolts tight, go on" in tight.stdout
    assert (folder.out / "report.html").is_file()

    before = (folder.out / "tight" / "result.json").stat().st_mtime_ns
    loose = measure(folder, str(folder.config), arrive(folder, waiting, "loose-2.csv"), "--once")
    assert loose.returncode == 6, loose.stderr
    assert "cache: hit" in loose.stdout
    assert "loose-2: A BOLT IS LOOSE" in loose.stdout
    assert (folder.out / "tight" / "result.json").stat().st_mtime_ns == before
    assert "loose-2" in (folder.out / "report.html").read_text()

    # Half a file.
    half = measure(folder, str(folder.config), arrive(folder, waiting, "loose-all.csv", b"frequency_hz,acc1_r"), "--once")
    assert half.returncode == 5
    assert "loose-all: no result" in half.stdout
    assert "loose-all.csv" in half.stderr
    assert folder.result("loose-2")["status"] == "converged"


def test_wrong_calls(tmp_path: Path) -> None:
    folder = frame(tmp_path / "frame")
    assert "usage: measure.sh CONFIG FOLDER" in measure(folder).stderr
    missing = measure(folder, str(tmp_path / "none.yaml"), str(tmp_path), "--once")
    assert missing.returncode == 2
    assert "none.yaml" in missing.stderr
