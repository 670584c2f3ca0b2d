"""The command ``lrbc``: imports and runs its commands, and turns every error into one message and an exit code."""

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

from lrbc_cli.cli import interruption
from lrbc_cli.cli.options import verbosity, verbosity_options
from lrbc_cli.cli.terminal import complain
from lrbc_cli.errors import ConfigError, LrbcError, NumericalError
from lrbc_cli.version import __version__

#: Module and function of each command, and its line in the help; commands are imported when they run, so that the help is fast.
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
#: ``kind`` of an error that is no LrbcError under --json, by exit code.
KINDS = {2: "usage", 3: "data", 4: "numerical", INTERRUPTED: "interrupted"}
#: Time that an interrupted run has to finish its current step [s].
GRACE_SECONDS = 5.0
#: Error numbers of a full disk, an exhausted quota or a file-size limit.
NO_SPACE = {code for name in ("ENOSPC", "EDQUOT", "EFBIG") if (code := getattr(errno, name, None)) is not None}
#: Errors of the system that a user can mend: no permission, a loop of links, a name that is too long.
DENIED = {errno.EACCES, errno.EPERM, errno.ELOOP, errno.EROFS, errno.ENAMETOOLONG}


class LazyGroup(click.Group):
    """A group that imports a command when it is needed, and the only place where errors become exit codes."""

    def __init__(self, *args: Any, table: Mapping[str, tuple[str, str]] = COMMANDS, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.table = table

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands in the order of the table."""
        return list(self.table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command; None if there is no such command."""
        if cmd_name not in self.table:
            return None
        module, _, name = self.table[cmd_name][0].partition(":")
        command = getattr(importlib.import_module(module), name)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; for an unknown name, raise a ConfigError with the most similar one."""
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
        """Parse the options; end without a message if nobody reads the help."""
        try:
            return super().make_context(info_name, args, parent, **extra)
        except BrokenPipeError:
            _release_streams()
            raise click.exceptions.Exit(PIPE_CLOSED) from None

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; end without a message if the reader of its output has closed the pipe (``lrbc schema | head``)."""
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
        """Run a command and exit with the int that it returns, or with the exit code of its error."""
        verbosity.reset()
        # Set before NumPy is loaded. Matrices are small and our threads share the frequency lines: threads of BLAS would mostly wait for
        # each other on a busy machine. Reductions of 10⁵ DOFs take no longer, as their factorisations have threads of their own.
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
            # click turns most interruptions into an Abort.
            interrupted = isinstance(error, KeyboardInterrupt | click.Abort) and args is None
            as_json = "--json" in (sys.argv[1:] if args is None else args)
            _stop(error, at_once=interrupted and not _leave_soon(), as_json=as_json)
        if not standalone_mode:
            return code
        sys.exit(code if type(code) is int else 0)


def _leave_soon() -> bool:
    """End the process after ``GRACE_SECONDS`` even if another thread goes on, for instance in a long factorisation.

    Returns False if the thread that does this cannot be started.
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
    """``lrbc`` with the name of the command, if that is the first of the words."""
    return f"lrbc {words[0]}" if words and words[0] in COMMANDS else "lrbc"


def _usage_error(error: click.ClickException) -> str:
    """Message of a click error in the form of all other errors; the help that click shows without arguments is not changed."""
    text = error.format_message()
    if text.startswith("Usage:"):
        return text
    # Clearer words for messages of click.
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
    """Replace closed standard streams (``>&-``) by the null device, since a file opened later could get their number."""
    for name, flags, mode in (("stdin", os.O_RDONLY, "r"), ("stdout", os.O_WRONLY, "w"), ("stderr", os.O_WRONLY, "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, flags), mode, encoding="utf-8"))


def _release_streams() -> None:
    """Discard output that a standard stream cannot take; the interpreter would try again at its end and print an error."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _reader_has_gone() -> bool:
    """Whether the reader of stdout or stderr has gone; the broken pipe may also be another one."""
    try:
        poll = select.poll()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):  # no file, as in tests
                poll.register(stream.fileno(), 0)
        return any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
    except AttributeError:  # no poll on Windows
        return True


def _stop(error: BaseException, *, at_once: bool = False, as_json: bool = False) -> NoReturn:
    """Print the error and exit; `at_once` does not wait for threads; with --json the error is the document on stdout."""
    # Some versions of click keep the EOFError as the cause, others only as the context.
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
    """Message and exit code of an error of any kind."""
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
    elif isinstance(error, OSError) and error.filename is not None and error.errno in DENIED:
        hint = "check the permissions of this file and its folder, and links on the way to it"
        error = ConfigError(f"this path cannot be used ({error.strerror})", file=error.filename, hint=hint)
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
