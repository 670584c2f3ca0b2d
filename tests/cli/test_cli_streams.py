"""Standard streams that are closed, full or narrow, and what the commands import."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import click
import pytest
from campaigns import Folder, command, environment

from lrbc_cli import __version__
from lrbc_cli.cli import common, terminal

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="a POSIX shell")
FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")


def shell(line: str) -> subprocess.CompletedProcess[str]:
    line = line.replace("lrbc", shlex.join(command()), 1)
    return subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False, timeout=120, env=environment())


@POSIX
@pytest.mark.parametrize(
    "closed", [*(pytest.param(closed, marks=pytest.mark.slow) for closed in (">&-", "2>&-", "2>&- >/dev/null")), "<&- >&- 2>&-"]
)
def test_closed_streams_do_not_break_a_run(frame: Folder, closed: str) -> None:
    result = frame.out / "loose-2" / "result.json"
    result.unlink()
    done = shell(f"lrbc update {shlex.quote(str(frame.config))} --cache {shlex.quote(str(frame.cache))} {closed}")
    assert (done.returncode, done.stderr) == (0, "")
    assert frame.result("loose-2")["status"] == "converged"
    assert bool(done.stdout) == (closed == "2>&-")


@FULL
@pytest.mark.parametrize("args", ["schema", "--help", "--version", "update --help"])
def test_a_full_stdout_is_told_once(args: str) -> None:
    done = shell(f"lrbc {args} > /dev/full")
    assert done.returncode == 2
    assert done.stderr.startswith("the results cannot be written (")
    assert done.stderr.count("\n") == 2
    assert "defect" not in done.stderr


@FULL
def test_a_full_stderr_changes_no_exit_code() -> None:
    assert shell("lrbc check none.yaml 2> /dev/full").returncode == 2
    assert shell("lrbc 2> /dev/full").returncode == 2


@POSIX
@pytest.mark.parametrize("args", [["--help"], ["schema"], ["update", "--help"]])
def test_no_reader_is_no_defect(args: list[str]) -> None:
    with subprocess.Popen([*command(), *args], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(60) == 141


@pytest.mark.parametrize("columns", [80, 40])
def test_progress_fits_the_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], columns: int) -> None:
    common.verbosity.reset()
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr(terminal.shutil, "get_terminal_size", lambda: os.terminal_size((columns, 24)))
    with click.Context(click.Command("trial")):
        show: Callable[[str], None] = common.progress()
        show("long " * 50)
        show("short")
    lines = capsys.readouterr().err.split("\r")
    assert max(len(line) for line in lines) == columns - 1
    assert lines[2].rstrip() == "short"
    assert len(lines[2]) == columns - 1


def test_progress_in_a_log_is_a_line_a_minute(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    common.verbosity.reset()
    clock = iter([0.0, 1.0, 59.0, 61.0, 61.0, 100.0, 122.0, 122.0])
    monkeypatch.setattr(common.time, "monotonic", lambda: next(clock))
    with click.Context(click.Command("trial")):
        show = common.progress()
        for step in "abcde":
            show(step)
    assert capsys.readouterr().err == "c\ne\n"


@pytest.mark.parametrize("name", ["check", "reduce", "update", "simulate"])
def test_only_the_report_imports_matplotlib(frame: Folder, name: str) -> None:
    code = "import sys; from lrbc_cli.cli.main import main; main(sys.argv[1:], standalone_mode=False); print(*sys.modules, file=sys.stderr)"
    args = [name, str(frame.config), "--cache", str(frame.cache)] + (["--out", str(frame.path / "x.csv")] if name == "simulate" else [])
    done = subprocess.run([sys.executable, "-c", code, *args], capture_output=True, text=True, check=False, env=environment())
    assert done.returncode == 0, done.stderr
    assert "lrbc_cli.campaign.reading.inputs" in done.stderr
    assert "matplotlib" not in done.stderr


def test_the_package_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "lrbc_cli", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"lrbc {__version__}\n"
