"""Options that several commands share."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from lrbc_cli.cli.terminal import remark

F = TypeVar("F", bound=Callable[..., Any])

LEVELS = {-2: logging.CRITICAL, -1: logging.ERROR, 0: logging.WARNING, 1: logging.INFO, 2: logging.DEBUG}


class _StderrHandler(logging.Handler):
    """Log handler that writes to the current stderr, which tests and callers may replace."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            # In the form of the commands' own messages.
            remark(self.format(record), kind=record.levelname.lower())
        except Exception:
            self.handleError(record)


class Verbosity:
    """Level of messages on stderr: the number of -v minus the number of -q, before and after the name of the command."""

    def __init__(self) -> None:
        self.level = 0
        self.handler = _StderrHandler()

    def reset(self) -> None:
        """Reset to the default level, warnings."""
        self.add(-self.level)

    def add(self, steps: int) -> None:
        """Raise the level by `steps` (lower it if negative), and set the log level."""
        self.level += steps
        logger = logging.getLogger("lrbc_cli")
        if self.handler not in logger.handlers:
            logger.addHandler(self.handler)
        logger.setLevel(LEVELS[max(-2, min(2, self.level))])


verbosity = Verbosity()


def _more(ctx: click.Context, param: click.Parameter, value: int) -> None:
    verbosity.add(value)


def _less(ctx: click.Context, param: click.Parameter, value: int) -> None:
    verbosity.add(-value)


def verbosity_options(function: F) -> F:
    """Decorator that adds the options -v and -q."""
    function = click.option("-q", "--quiet", count=True, expose_value=False, callback=_less, help="Print less; repeat for even less.")(
        function
    )
    return click.option("-v", "--verbose", count=True, expose_value=False, callback=_more, help="Print more; -vv adds tracebacks.")(
        function
    )


#: Receives ``calibration: bool``.
calibration_option = click.option(
    "--no-calibration", "calibration", is_flag=True, flag_value=False, default=True, help="Ignore a stored calibration."
)
accept_tolerance_option = click.option("--accept-tolerance", is_flag=True, help="Accept a reduced model that does not reach its tolerance.")
lines_option = click.option(
    "--lines", metavar="LINES", help="Frequency lines [Hz], e.g. 20:400:1 or 33.3,71.7. Default: every 1 Hz in the band."
)


def campaign_options(function: F) -> F:
    """Decorator that adds the argument and options of all commands that read a campaign.

    The command receives ``config: Path``, ``overrides: tuple[str, ...]``, ``cache: Path | None`` and ``as_json: bool``.
    """
    decorators: list[Callable[[F], F]] = [
        click.argument("config", type=click.Path(path_type=Path)),
        click.option(
            "--override", "overrides", multiple=True, metavar="KEY.PATH=VALUE", help="Change a key of the campaign file; repeatable."
        ),
        click.option(
            "--cache",
            type=click.Path(path_type=Path, file_okay=False),
            envvar="LRBC_CACHE",
            help="Cache folder (or set LRBC_CACHE). Default: the user's cache folder.",
        ),
        click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout."),
        verbosity_options,
    ]
    for decorator in reversed(decorators):
        function = decorator(function)
    return function
