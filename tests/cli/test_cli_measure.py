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
    folder = frame(tmp_path / "frame")
    arrived = folder.data / "frf"
    waiting = tmp_path / "waiting"
    arrived.rename(waiting)
    arrived.mkdir()

    nothing = measure(folder, str(folder.config), str(arrived), "--once")
    assert nothing.returncode == 0, nothing.stderr
    assert "reduced model:" in nothing.stdout
    assert not list(folder.out.glob("*/result.json"))

    shutil.copy(waiting / "tight.csv", arrived)
    tight = measure(folder, str(folder.config), str(arrived), "--once")
    assert tight.returncode == 0, tight.stderr
    assert "cache: hit" in tight.stdout
    assert "tight: all bolts tight, go on" in tight.stdout
    assert (folder.out / "report.html").is_file()

    shutil.copy(waiting / "loose-2.csv", arrived)
    before = (folder.out / "tight" / "result.json").stat().st_mtime_ns
    loose = measure(folder, str(folder.config), str(arrived), "--once")
    assert loose.returncode == 6, loose.stderr
    assert "loose-2: A BOLT IS LOOSE" in loose.stdout
    assert "tight: all bolts tight, go on" in loose.stdout
    assert (folder.out / "tight" / "result.json").stat().st_mtime_ns == before
    assert "loose-2" in (folder.out / "report.html").read_text()

    # Half a file: no result, and that comes before the loose bolt.
    content = (waiting / "loose-all.csv").read_bytes()
    (arrived / "loose-all.csv").write_bytes(content[:20])
    half = measure(folder, str(folder.config), str(arrived), "--once")
    assert half.returncode == 5
    assert "loose-all: no result" in half.stdout
    assert "loose-2: A BOLT IS LOOSE" in half.stdout
    assert folder.result("loose-2")["status"] == "converged"


def test_wrong_calls(tmp_path: Path) -> None:
    folder = frame(tmp_path / "frame")
    assert "usage: measure.sh CONFIG FOLDER" in measure(folder).stderr
    missing = measure(folder, str(tmp_path / "none.yaml"), str(tmp_path), "--once")
    assert missing.returncode == 2
    assert "none.yaml" in missing.stderr
