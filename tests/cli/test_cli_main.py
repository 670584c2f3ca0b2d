"""The command line: lazy, one message an error, the exit codes of the interface."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click
import jsonschema
import pytest

from lrbc_cli import __version__
from lrbc_cli.cli.main import COMMANDS, LazyGroup, main
from lrbc_cli.cli.options import campaign_options, verbosity_options
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import ConfigError, DataError, NumericalError

logger = logging.getLogger("lrbc_cli.trial")


@click.command()
@click.argument("what")
@verbosity_options
def trial(what: str) -> int | None:
    """Fail in one way or another."""
    errors = {
        "config": ConfigError("wrong key", file="a.yaml", place="line 3, x"),
        "data": DataError("damaged", file="k.mtx"),
        "numerical": NumericalError("not reached"),
        "defect": ZeroDivisionError("division by zero\nsecond line"),
        "interrupt": KeyboardInterrupt(),
        "eof": EOFError("pipe"),
    }
    if what in errors:
        raise errors[what]
    if what == "exit":
        click.get_current_context().exit(6)
    if what == "log":
        logger.debug("debug")
        logger.info("info")
        logger.warning("warning")
        logger.error("error")
    return 5 if what == "five" else None


@click.command()
@campaign_options
def echo(config: Path, overrides: tuple[str, ...], cache: Path | None, as_json: bool) -> None:
    """Say what was given."""
    click.echo(json.dumps([str(config), list(overrides), None if cache is None else str(cache), as_json]))


group = LazyGroup(
    name="lrbc", table={"trial": (f"{__name__}:trial", "Fail."), "echo": (f"{__name__}:echo", "Say.")}, params=[], callback=lambda: None
)
verbosity_options(group.callback)


@dataclass
class Result:
    exit_code: int
    stdout: str
    stderr: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    """Run a command as from a shell."""

    def run(*args: str, command: click.Command = group) -> Result:
        with pytest.raises(SystemExit) as caught:
            command.main(list(args))
        out = capsys.readouterr()
        return Result(int(caught.value.code or 0), out.out, out.err)

    return run


@pytest.mark.parametrize(
    ("what", "code", "message"),
    [
        ("config", 2, "a.yaml, line 3, x: wrong key\n"),
        ("data", 3, "k.mtx: damaged\n"),
        ("numerical", 4, "not reached\n"),
        ("interrupt", 130, "\nlrbc: interrupted; finished results are kept\n"),
        ("five", 5, ""),
        ("exit", 6, ""),
        ("nothing", 0, ""),
    ],
)
def test_exit_codes(run, what: str, code: int, message: str) -> None:  # type: ignore[no-untyped-def]
    result = run("trial", what)
    assert (result.exit_code, result.stdout, result.stderr) == (code, "", message)


@pytest.mark.parametrize(("what", "name"), [("defect", "ZeroDivisionError: division by zero)"), ("eof", "EOFError: pipe)")])
def test_a_defect_is_told_shortly(run, what: str, name: str) -> None:  # type: ignore[no-untyped-def]
    result = run("trial", what)
    assert result.exit_code == 1
    assert f"internal error ({name}" in result.stderr
    assert "Traceback" not in result.stderr
    assert "Traceback" not in run("trial", "-v", what).stderr


@pytest.mark.parametrize("what", ["defect", "data"])
def test_tracebacks_are_for_vv(run, what: str) -> None:  # type: ignore[no-untyped-def]
    assert "Traceback" in run("trial", "-vv", what).stderr
    assert "Traceback" not in run("trial", what).stderr, "the level of one run must not outlive it"


@pytest.mark.parametrize(
    ("args", "levels"),
    [
        ([], ["warning", "error"]),
        (["-q"], ["error"]),
        (["-qq"], []),
        (["-v"], ["info", "warning", "error"]),
        (["-v", "-v"], ["debug", "info", "warning", "error"]),
        (["-vvv", "-q"], ["debug", "info", "warning", "error"]),
    ],
)
def test_verbosity(run, args: list[str], levels: list[str]) -> None:  # type: ignore[no-untyped-def]
    result = run("trial", *args, "log")
    assert [line.split(":")[0] for line in result.stderr.splitlines()] == levels
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("args", "parts"),
    [
        (["schem"], ["lrbc: no command 'schem'", "did you mean 'lrbc schema'?"]),
        (["--nonsense"], ["lrbc: no such option", "--nonsense", "lrbc --help"]),
        (["schema", "--nonsense"], ["lrbc schema: no such option", "lrbc schema --help"]),
        (["plan", "c.yaml", "--draws", "x"], ["lrbc plan: invalid value for '--draws': 'x' is not a whole number"]),
        (["update", "c.yaml", "--workers", "0"], ["lrbc update: invalid value for '--workers': 0 must be at least 1"]),
        (["rehearse", "c.yaml", "--noise", "1e9"], ["'--noise': 1000000000.0 must be from 0.0 to 1000.0"]),
        (["update", "c.yaml", "tight"], ["lrbc update: got unexpected extra argument (tight)", "select jobs with --job NAME"]),
        (["schema", "more"], ["lrbc schema: got unexpected extra argument"]),
    ],
)
def test_usage_errors(run, args: list[str], parts: list[str]) -> None:  # type: ignore[no-untyped-def]
    result = run(*args, command=main)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "Usage:" not in result.stderr
    for part in parts:
        assert part in result.stderr


def test_help_lists_all_commands_without_importing_them(run) -> None:  # type: ignore[no-untyped-def]
    result = run("--help", command=main)
    assert result.exit_code == 0
    for name, (_, text) in COMMANDS.items():
        assert f"  {name} " in result.stdout
        assert text in result.stdout
    assert run("-h", command=main).stdout == result.stdout
    assert run("--version", command=main).stdout == f"lrbc {__version__}\n"


def test_help_is_quick(run) -> None:  # type: ignore[no-untyped-def]
    code = "import sys; from lrbc_cli.cli.main import main; main(['--help'], standalone_mode=False); print(*sys.modules, file=sys.stderr)"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr.split()
    assert "click" in modules
    assert not {"numpy", "scipy", "matplotlib", "pydantic", "yaml", "h5py"} & set(modules)


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_the_table_is_right(run, name: str) -> None:  # type: ignore[no-untyped-def]
    module = COMMANDS[name][0].partition(":")[0]
    if not (Path(__file__).parents[2] / (module.replace(".", "/") + ".py")).exists():
        pytest.skip("not written yet")
    result = run(name, "--help", command=main)
    assert result.exit_code == 0
    assert "-v, --verbose" in result.stdout


def test_campaign_options(run, monkeypatch: pytest.MonkeyPatch) -> None:  # type: ignore[no-untyped-def]
    result = run("echo", "-v", "c.yaml", "--override", "a=1", "--override", "b.c=[1, 2]", "--cache", "x", "--json", "-q")
    assert json.loads(result.stdout) == ["c.yaml", ["a=1", "b.c=[1, 2]"], "x", True]
    monkeypatch.setenv("LRBC_CACHE", "y")
    assert json.loads(run("echo", "c.yaml").stdout) == ["c.yaml", [], "y", False]
    monkeypatch.setenv("LRBC_CACHE", "")
    assert json.loads(run("echo", "c.yaml").stdout) == ["c.yaml", [], None, False]


def test_schema_is_a_json_schema(run) -> None:  # type: ignore[no-untyped-def]
    result = run("schema", command=main)
    assert result.exit_code == 0
    jsonschema.Draft202012Validator.check_schema(json.loads(result.stdout))


def test_init(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    result = run("init", str(tmp_path / "new"), command=main)
    assert result.exit_code == 0
    assert result.stdout.splitlines()[0] == str(tmp_path / "new" / "campaign.yaml")
    load_campaign(tmp_path / "new" / "campaign.yaml")
    again = run("init", str(tmp_path / "new"), command=main)
    assert again.exit_code == 2
    assert "already exists" in again.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="no poll")
def test_a_closed_pipe_is_no_defect() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", "from lrbc_cli.cli.main import main; main()", "schema"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.wait(60) == 141
    assert process.stderr.read() == b""
    process.stderr.close()


@pytest.mark.parametrize(("asked", "threads"), [(None, 1), ("2", 2)])
def test_blas_has_one_thread_unless_asked(asked: str | None, threads: int) -> None:
    """Threads of BLAS wait for each other on matrices of a hundred rows, on a busy machine several times as long as they work."""
    code = (
        "from lrbc_cli.cli.main import main; main(['schema'], standalone_mode=False);"
        "import numpy, threadpoolctl;"
        "print('threads', {found['num_threads'] for found in threadpoolctl.threadpool_info() if found['internal_api'] == 'openblas'})"
    )
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    environment |= {} if asked is None else {"OPENBLAS_NUM_THREADS": asked}
    found = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    told = found.stdout.splitlines()[-1]
    if told == "threads set()" or (os.cpu_count() or 1) < threads:
        pytest.skip("NumPy without OpenBLAS, or too few cores")
    assert told == f"threads {{{threads}}}"
