"""Functions shared by the commands that read a campaign: loading, warnings and progress on stderr, JSON on stdout."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lrbc_cli.campaign.documents import cache_folder, require_own_output
from lrbc_cli.cli.interruption import stop_if_asked
from lrbc_cli.cli.options import verbosity
from lrbc_cli.cli.terminal import line, remark, say
from lrbc_cli.config import Campaign, load_campaign
from lrbc_cli.results.fields import Record, plain

if TYPE_CHECKING:
    from lrbc_cli.campaign.reading.factors import CalibrationUse
    from lrbc_cli.campaign.reading.inputs import Inputs
    from lrbc_cli.results.model import CalibrationNews

__all__ = ["cache_folder", "load", "progress", "say_json", "tell_calibration"]


def load(
    config: Path, overrides: tuple[str, ...], *, own_output: bool = True, calibration: bool | None = True, warn: bool = True
) -> Inputs:
    """Read the campaign file and its model, see ``read``; with `own_output`, an output folder of another campaign is refused."""
    campaign = load_campaign(config, overrides)
    if own_output:
        require_own_output(campaign)
    return read(campaign, calibration=calibration, warn=warn)


def read(campaign: Campaign, *, calibration: bool | None = True, warn: bool = True) -> Inputs:
    """Read the model of a campaign; warnings go to stderr.

    ``calibration``: True applies a stored calibration, False leaves it out, None does not look for one.
    ``warn=False`` leaves the warnings about files, model and calibration to the caller.
    """
    # Imported here, since commands that only judge again read no model.
    from lrbc_cli.campaign.calibration import read_inputs
    from lrbc_cli.campaign.reading.inputs import read_as_exported

    inputs = read_as_exported(campaign) if calibration is None else read_inputs(campaign, calibration=calibration)
    if warn:
        tell_warnings((*inputs.warnings, *inputs.method.warnings))
        tell_calibration(inputs.calibration, wanted=bool(calibration))
    return inputs


def tell_warnings(warnings: Sequence[str]) -> None:
    """Print warnings about files and model to stderr."""
    for warning in warnings if verbosity.level >= 0 else ():
        remark(warning, kind="warning")


def tell_calibration(use: CalibrationUse | CalibrationNews | None, *, wanted: bool) -> None:
    """Print to stderr whether a stored calibration is used; if there is none, only with -v or if it was left out (`wanted` false)."""
    if use is not None and verbosity.level >= (0 if use.used or use.stale or not wanted else 1):
        remark(f"calibration: {use.text}", kind="warning" if use.stale else "")


def progress() -> Callable[[str], None]:
    """Function that writes progress to stderr: lines with -v, else one changing line on a terminal, else a line a minute.

    Each call is also a point at which an interrupted run stops.
    """
    show = _shown()

    def step(text: str) -> None:
        show(text)
        stop_if_asked()

    return step


def _shown() -> Callable[[str], None]:
    if verbosity.level >= 1:
        return lambda text: remark(text)
    if verbosity.level == 0 and sys.stderr.isatty():
        click.get_current_context().call_on_close(line.clear)
        return line.show
    return _by_the_minute()


def _by_the_minute(every: float = 60.0) -> Callable[[str], None]:
    """Progress in a log file: what is being done, once in so many seconds."""
    last = time.monotonic()

    def step(text: str) -> None:
        nonlocal last
        if verbosity.level == 0 and time.monotonic() - last >= every:
            last = time.monotonic()
            remark(text)

    return step


def say_json(tree: Mapping[str, Any]) -> None:
    """Print one JSON document."""
    say(json.dumps(plain(tree), indent=1, ensure_ascii=False, allow_nan=False, default=Record.tree))
