"""The command ``lrbc``: finds its commands, and turns every error into one message and an exit code."""

from __future__ import annotations

import errno
import importlib
import json
import os
import re
import select
import sys
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, NoReturn

import click

from lrbc_cli import __version__
from lrbc_cli.cli import interruption
from lrbc_cli.cli.options import verbosity, verbosity_options
from lrbc_cli.cli.terminal import complain
from lrbc_cli.errors import ConfigError, LrbcError, NumericalError

#: Where each command stands, and its line in the help: commands are imported when they run, so that the help is quick.
COMMANDS: dict[str, tuple[str, str]] = {
    "init": ("lrbc_cli.cli.init:init", "Write a commented campaign file to fill in."),
    "check": ("lrbc_cli.cli.check:check", "Check all inputs and print what will be done; change nothing."),
    "plan": ("lrbc_cli.cli.plan:plan", "Predict, before measuring, which loose bolts can be detected."),
    "rehearse": ("lrbc_cli.cli.rehearse:rehearse", "Write a campaign of simulated measurements with loose bolts."),
    "reduce": ("lrbc_cli.cli.reduce:reduce", "Build the reduced model, or load it from the cache."),
    "calibrate": ("lrbc_cli.cli.calibrate:calibrate", "Identify the global factors of the reference model."),
    "update": ("lrbc_cli.cli.update:update", "Identify and judge all jobs, or those given by --job."),
    "watch": ("lrbc_cli.cli.watch:watch", "Judge and report measurements as their files arrive."),
    "report": ("lrbc_cli.cli.report:report", "Draw figures, tables and report.html from the results."),
    "run": ("lrbc_cli.cli.run:run", "Calibrate (if configured), update and report; print the result."),
    "status": ("lrbc_cli.cli.status:status", "Show which jobs are done, and the time left."),
    "simulate": ("lrbc_cli.cli.simulate:simulate", "Compute FRFs of the model and write them to a file."),
    "schema": ("lrbc_cli.cli.schema:schema", "Print the JSON Schema of the campaign or result files."),
    "guide": ("lrbc_cli.cli.guide:guide", "Show the pages of the guide."),
}
DEFECT = 1
INTERRUPTED = 130
PIPE_CLOSED = 141
#: What an error that is not of this package is under --json, by its exit code.
KINDS = {2: "usage", 3: "data", 4: "numerical", INTERRUPTED: "interrupted"}
#: How long an interrupted run waits for what it is about to finish.
GRACE_SECONDS = 5.0
#: Errors of writing that more space or another place fixes.
NO_SPACE = {code for name in ("ENOSPC", "EDQUOT", "EFBIG") if (code := getattr(errno, name, None)) is not None}


class LazyGroup(click.Group):
    """A group that imports a command when it is needed, and the only place where errors become exit codes."""

    def __init__(self, *args: Any, table: Mapping[str, tuple[str, str]] = COMMANDS, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.table = table

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Give the names in the order of the table."""
        return list(self.table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command."""
        if cmd_name not in self.table:
            return None
        module, _, name = self.table[cmd_name][0].partition(":")
        command = getattr(importlib.import_module(module), name)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command, or say which one was meant."""
        if args and args[0] not in self.table and not args[0].startswith("-"):
            raise ConfigError(
                f"no command '{args[0]}'", place="lrbc", expected=f"one of {', '.join(self.table)}", hint=_nearest(args[0], self.table)
            )
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands from the table, importing none."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in self.table.items()])

    def make_context(self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any) -> click.Context:
        """Read the options; end quietly where the help has no reader."""
        try:
            return super().make_context(info_name, args, parent, **extra)
        except BrokenPipeError:
            _release_streams()
            raise click.exceptions.Exit(PIPE_CLOSED) from None

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; end quietly where the reader of its output has gone (``lrbc schema | head``)."""
        try:
            result = super().invoke(ctx)
            sys.stdout.flush()
        except OSError as error:
            if error.errno != errno.EPIPE:
                raise
            if not _reader_has_gone():
                raise RuntimeError(f"a pipe broke: {error}") from error
            _release_streams()
            ctx.exit(PIPE_CLOSED)
        return result

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run and exit: an int that a command returns is its exit code, errors have theirs."""
        verbosity.reset()
        # Before NumPy is loaded. Matrices are small and threads share the lines: those of BLAS only wait for each other, on a busy machine
        # several times as long as they work; reductions of 10⁵ DOFs, whose factorisations have threads of their own, take no longer.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        _complete_streams()
        interruption.listen()
        try:
            code = super().main(args, prog_name or "lrbc", complete_var, standalone_mode=False, **extra)
            interruption.stop_if_asked()
        except (Exception, KeyboardInterrupt) as caught:
            error = interruption.cause_of(caught)
            if isinstance(error, Exception) and not standalone_mode:
                raise
            # click makes an Abort of most interrupts.
            interrupted = isinstance(error, KeyboardInterrupt | click.Abort) and args is None
            as_json = "--json" in (sys.argv[1:] if args is None else args)
            _stop(error, at_once=interrupted and not _leave_soon(), as_json=as_json)
        if not standalone_mode:
            return code
        sys.exit(code if type(code) is int else 0)


def _leave_soon() -> bool:
    """End the process even where a thread does not: in the middle of a long factorisation, or started while the signal came.

    False where no thread can be started that would see to it.
    """

    def leave() -> None:
        time.sleep(GRACE_SECONDS)
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(INTERRUPTED)

    try:
        threading.Thread(target=leave, daemon=True).start()
    except RuntimeError:
        return False
    return True


def _nearest(word: str, candidates: Mapping[str, Any]) -> str:
    import difflib

    near = difflib.get_close_matches(word, candidates, n=1)
    return f"did you mean 'lrbc {near[0]}'?" if near else "'lrbc --help' lists the commands"


_CLEARER = {
    r"is not in the range x>=(\S+?)\.?$": r"must be at least \1",
    r"is not in the range (\S+?)<=x<=(\S+?)\.?$": r"must be from \1 to \2",
    r"is not a valid integer(?: range)?": "is not a whole number",
    r"is not a valid float(?: range)?": "is not a number",
    r"requires an argument": "needs a value",
}


def _command(words: Sequence[str]) -> str:
    """The command that was meant, with its name where that is the first word."""
    return f"lrbc {words[0]}" if words and words[0] in COMMANDS else "lrbc"


def _usage_error(error: click.ClickException) -> str:
    """Give a click error the form of all others; the help for no arguments stays as it is."""
    text = error.format_message()
    if text.startswith("Usage:"):
        return text
    # What the words of click leave unclear.
    for said, clear in _CLEARER.items():
        text = re.sub(said, clear, text)
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else _command(sys.argv[1:])
    hint = f"'{command} --help' shows the usage"
    if "extra argument" in text and context is not None and any("--job" in option.opts for option in context.command.params):
        hint = f"give one campaign file; select jobs with --job NAME; {hint}"
    return ConfigError(text[:1].lower() + text[1:].rstrip("."), place=command, hint=hint).message


def _defect(error: BaseException) -> str:
    problem = f"{type(error).__name__}: {error}".splitlines()[0][:300]
    return f"lrbc: internal error ({problem})\n  fix:      run with -vv for the traceback, and report the error"


def _complete_streams() -> None:
    """Open the null device where a standard stream was closed (``>&-``): a run needs no reader, and no file may get its number."""
    for name, flags, mode in (("stdin", os.O_RDONLY, "r"), ("stdout", os.O_WRONLY, "w"), ("stderr", os.O_WRONLY, "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, flags), mode, encoding="utf-8"))


def _release_streams() -> None:
    """Let go what a standard stream cannot take: the interpreter would try, and complain, once more at its end."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _reader_has_gone() -> bool:
    """Tell whether the reader of stdout or stderr has gone; a pipe may have broken elsewhere."""
    try:
        poll = select.poll()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):  # no file, as in tests
                poll.register(stream.fileno(), 0)
        return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
    except AttributeError:  # no poll on Windows
        return True


def _stop(error: BaseException, *, at_once: bool = False, as_json: bool = False) -> NoReturn:
    """Say what happened, once, and exit; at once: whatever threads do; with --json the document on stdout is the error."""
    # Some versions of click name it as the cause, others do not.
    if isinstance(error, click.Abort) and isinstance(error.__cause__ or error.__context__, EOFError):
        error = error.__cause__ or error.__context__ or error
    message, code = _told(error)
    with suppress(OSError):
        complain(message)
        if verbosity.level >= 2 and not isinstance(error, click.ClickException):
            click.echo("".join(traceback.format_exception(error)).rstrip(), err=True)
        if as_json:
            parts = error.tree() if isinstance(error, LrbcError) else {"problem": message}
            click.echo(
                json.dumps({"exit_code": code, "error": {"kind": KINDS.get(code, "internal"), **parts}}, indent=1, ensure_ascii=False)
            )
    if at_once:
        sys.stderr.flush()
        os._exit(code)
    _release_streams()
    sys.exit(code)


def _told(error: BaseException) -> tuple[str, int]:
    """Message and exit code."""
    if isinstance(error, click.ClickException):
        return _usage_error(error), error.exit_code
    if isinstance(error, KeyboardInterrupt | click.Abort):
        return "lrbc: interrupted; finished results are kept", INTERRUPTED
    if isinstance(error, MemoryError):
        error = NumericalError(
            f"not enough memory ({str(error).rstrip('.') or 'no details'})",
            hint="use a coarser model, fewer terms or responses, or more memory; lrbc check predicts the memory needed",
        )
    elif isinstance(error, OSError) and error.errno in NO_SPACE:
        hint = "free disk space where stdout and the results are written, or choose another place"
        error = ConfigError(f"the results cannot be written ({error.strerror})", file=error.filename, hint=hint)
    return (error.message, error.exit_code) if isinstance(error, LrbcError) else (_defect(error), DEFECT)


@click.group(
    "lrbc",
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Find the loose bolts of a structure from measured FRFs.",
)
@click.version_option(__version__, "--version", prog_name="lrbc", message="%(prog)s %(version)s")
@verbosity_options
def main() -> None:
    """Find the loose bolts of a structure from measured FRFs."""
