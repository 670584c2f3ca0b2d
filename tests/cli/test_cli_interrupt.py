"""Interrupted and killed runs: finished jobs stay, nothing is half written, the next run completes."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from campaigns import Folder, frame

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

JOBS = [f"state-{i:02d}" for i in range(6)]


def many_jobs(path: Path) -> Folder:
    """The frame with four jobs, so that a signal always comes before the end."""
    folder = frame(path)
    tree = folder.tree()
    tree["jobs"] = {job: {"frf": f"data/frf/{'loose-2' if i % 2 else 'tight'}.csv"} for i, job in enumerate(JOBS)}
    tree["update"]["reference"] = JOBS[0]
    del tree["calibration"]
    folder.write(tree)
    return folder


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    folder = many_jobs(tmp_path_factory.mktemp("undisturbed") / "frame")
    assert folder.run("update").code == 0
    return folder


def interrupt_after(folder: Folder, kind: signal.Signals, after: int | str, pause: float, *args: str) -> tuple[int, list[str]]:
    """Send a signal after a line of progress: the n-th, or the one that tells of a job."""
    process = folder.start("update", "-v", *args)
    assert process.stderr is not None
    lines: list[str] = []
    try:
        while not (len(lines) == after or (lines and lines[-1].startswith(f"{after}:"))):
            text = process.stderr.readline()
            assert text, f"ended early: {lines}"
            lines.append(text.rstrip("\n"))
        time.sleep(pause)
        process.send_signal(kind)
        _, rest = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    return process.returncode, lines + rest.splitlines()


def assert_whole(folder: Folder) -> None:
    folder.assert_whole()
    # result.json comes last: it vouches for the others.
    for path in folder.out.glob("*/result.json"):
        assert json.loads(path.read_text())["status"] == "converged"
        assert (path.parent / "profile.csv").is_file()
        assert (path.parent / "frf.csv").is_file()


def assert_same(folder: Folder, other: Folder) -> None:
    found, expected = folder.results(), other.results()
    assert list(found) == list(expected) == JOBS
    for job in JOBS:
        a, b = found[job], expected[job]
        np.testing.assert_allclose(a["parameters"]["left_edge"]["log10"], b["parameters"]["left_edge"]["log10"], atol=1e-6)
        assert a["parameters"]["left_edge"]["damping_exponent"] == pytest.approx(b["parameters"]["left_edge"]["damping_exponent"], abs=1e-6)
        assert a["misfit_db"]["final"] == pytest.approx(b["misfit_db"]["final"], abs=1e-6)
        assert [bolt["verdict"] for bolt in a["bolts"]] == [bolt["verdict"] for bolt in b["bolts"]]
        assert a["provenance"]["identity"] == b["provenance"]["identity"]
    with (folder.out / "campaign.csv").open(newline="") as file:
        assert [row["job"] for row in csv.DictReader(file)] == JOBS


def done(lines: list[str]) -> list[str]:
    return [line.split(":")[0] for line in lines if ": converged, misfit" in line]


@pytest.mark.parametrize(
    ("after", "pause", "args"),
    [
        pytest.param(1, 0.0, (), id="while-reducing", marks=pytest.mark.slow),
        pytest.param("state-01", 0.02, (), id="within-a-job", marks=pytest.mark.slow),
        pytest.param("state-01", 0.01, ("--workers", "2"), id="with-two-workers", marks=pytest.mark.slow),
    ],
)
def test_interrupted(tmp_path: Path, undisturbed: Folder, after: int | str, pause: float, args: tuple[str, ...]) -> None:
    folder = many_jobs(tmp_path / "frame")
    code, lines = interrupt_after(folder, signal.SIGINT, after, pause, *args)
    assert code == 130, lines
    assert lines[-1] == "lrbc: interrupted; finished results are kept"
    assert not any("Traceback" in line for line in lines)
    assert folder.leftovers() == []
    assert_whole(folder)
    finished = done(lines)
    assert len(finished) < len(JOBS)
    kept = {job: (folder.out / job / "result.json").read_bytes() for job in finished}
    if finished:
        with (folder.out / "campaign.csv").open(newline="") as file:
            assert set(finished) <= {row["job"] for row in csv.DictReader(file)}
    result = folder.run("update", "--json")
    assert result.code == 0
    assert set(finished) <= set(result.json["kept"])
    assert {job: (folder.out / job / "result.json").read_bytes() for job in finished} == kept
    assert_same(folder, undisturbed)


@pytest.mark.slow
def test_killed_within_a_job(tmp_path: Path, undisturbed: Folder) -> None:
    """While files are written: test_cli_killed.py."""
    folder = many_jobs(tmp_path / "frame")
    code, lines = interrupt_after(folder, signal.SIGKILL, "state-01", 0.03)
    assert code == -signal.SIGKILL
    assert_whole(folder)
    finished = done(lines)
    result = folder.run("update", "--json")
    assert result.code == 0
    assert set(finished) <= set(result.json["kept"])
    assert_whole(folder)
    assert_same(folder, undisturbed)


@pytest.mark.slow
def test_an_interrupted_rerun_keeps_what_was_there(undisturbed: Folder, tmp_path: Path) -> None:
    """Running finished jobs again, an interruption leaves every job with a whole result: the old one or the new one."""
    folder = undisturbed.copy(tmp_path / "frame")
    code, lines = interrupt_after(folder, signal.SIGINT, "state-01", 0.01, "--force")
    assert code == 130, lines
    assert folder.leftovers() == []
    assert_whole(folder)
    assert_same(folder, undisturbed)


@pytest.mark.slow
def test_an_interrupted_report_leaves_no_half_page(undisturbed: Folder, tmp_path: Path) -> None:
    folder = undisturbed.copy(tmp_path / "frame")
    process = folder.start("report", "-v")
    try:
        assert process.stderr is not None
        assert process.stderr.readline()
        time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    assert process.returncode == 130, rest
    assert "Traceback" not in rest
    assert folder.leftovers() == []
    page = folder.out / "report.html"
    assert not page.exists() or page.read_text().rstrip().endswith("</html>")


def test_an_interruption_that_is_swallowed_stops_the_run_at_its_next_step(tmp_path: Path) -> None:
    """Python ignores exceptions in finalisers: a signal that came in one let the whole run go on, with exit code 0."""
    (tmp_path / "deaf.py").write_text(
        "import os, signal, click\n"
        "from lrbc_cli.cli.common import progress\n"
        "from lrbc_cli.cli.main import LazyGroup\n"
        "class Deaf:\n"
        "    def __del__(self):\n"
        "        signal.raise_signal(signal.SIGINT)\n"
        "@click.command()\n"
        "@click.option('--steps', type=int)\n"
        "def listen(steps):\n"
        "    tell = progress()\n"
        "    Deaf()\n"
        "    click.echo('goes on')\n"
        "    for _ in range(steps):\n"
        "        tell('a step')\n"
        "        click.echo('another')\n"
        "if __name__ == '__main__':\n"
        "    LazyGroup('lrbc', table={'listen': ('deaf:listen', 'Listen.')})()\n"
    )
    for steps in ("0", "2"):
        command = [sys.executable, "deaf.py", "listen", "--steps", steps]
        found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
        assert (found.returncode, found.stdout.split("\n")) == (130, ["goes on", ""]), found.stderr
        assert "interrupted; finished results are kept" in found.stderr
        assert "Traceback" not in found.stderr


@pytest.mark.slow
def test_a_thread_that_does_not_end_does_not_hold_an_interrupted_run(tmp_path: Path) -> None:
    (tmp_path / "hanging.py").write_text(
        "import threading, click\n"
        "from lrbc_cli.cli.main import LazyGroup\n"
        "@click.command()\n"
        "def hang():\n"
        "    threading.Thread(target=threading.Event().wait).start()\n"
        "    raise KeyboardInterrupt\n"
        "if __name__ == '__main__':\n"
        "    LazyGroup('lrbc', table={'hang': ('hanging:hang', 'Hang.')})()\n"
    )
    found = subprocess.run([sys.executable, "hanging.py", "hang"], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert found.returncode == 130
    assert "interrupted; finished results are kept" in found.stderr


@pytest.mark.parametrize(("asked", "code", "says"), [("True", 130, "lrbc: interrupted"), ("False", 1, "release unlocked lock")])
def test_what_an_interruption_broke_into_may_fail_in_its_own_way(tmp_path: Path, asked: str, code: int, says: str) -> None:
    """A signal between taking a lock and noting it: threading then says that the lock is not held."""
    (tmp_path / "broken.py").write_text(
        "import signal, threading, click\n"
        "from lrbc_cli.cli.main import LazyGroup\n"
        "@click.command()\n"
        "def breaks():\n"
        "    try:\n"
        f"        {asked} and signal.raise_signal(signal.SIGINT)\n"
        "    finally:\n"
        "        threading.Lock().release()\n"
        "if __name__ == '__main__':\n"
        "    LazyGroup('lrbc', table={'breaks': ('broken:breaks', 'Break.')})()\n"
    )
    found = subprocess.run([sys.executable, "broken.py", "breaks"], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert found.returncode == code, found.stderr
    assert says in found.stderr
