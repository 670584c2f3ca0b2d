"""What the commands that read a campaign share: loading it, progress on stderr, output on stdout."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from lrbc_cli.campaign.calibration import read_inputs
from lrbc_cli.campaign.documents import require_own_output
from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.campaign.reduced.cache import cache_folder
from lrbc_cli.cli.interruption import stop_if_asked
from lrbc_cli.cli.options import verbosity
from lrbc_cli.cli.terminal import line, remark, say
from lrbc_cli.config import load_campaign
from lrbc_cli.results.fields import plain

__all__ = ["cache_folder", "load", "progress", "say_json", "tell_calibration"]


def load(
    config: Path, overrides: tuple[str, ...], *, own_output: bool = True, calibration: bool | None = True, warn: bool = True
) -> Inputs:
    """Read the campaign file and its model; warnings go to stderr. An output folder of another campaign is refused where it counts.

    What became of a stored calibration is said; False leaves it out, None looks for none.
    ``warn=False`` leaves the warnings about files and model, and the calibration, to the caller.
    """
    campaign = load_campaign(config, overrides)
    if own_output:
        require_own_output(campaign)
    inputs = read_as_exported(campaign) if calibration is None else read_inputs(campaign, calibration=calibration)
    if warn and verbosity.level >= 0:
        for warning in (*inputs.warnings, *inputs.method.warnings):
            remark(warning, kind="warning")
    if warn:
        tell_calibration(inputs, wanted=bool(calibration))
    return inputs


def tell_calibration(inputs: Inputs, *, wanted: bool) -> None:
    """Say on stderr what became of a stored calibration; that there is none is no news but for those who left it out."""
    use = inputs.calibration
    if use is not None and verbosity.level >= (0 if use.used or use.stale or not wanted else 1):
        remark(f"calibration: {use.text}", kind="warning" if use.stale else "")


def progress() -> Callable[[str], None]:
    """Write progress lines to stderr: kept with -v, one changing line on a terminal, nothing otherwise.

    Each is a step after which an interrupted run stops.
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
    return lambda _: None


def say_json(tree: Mapping[str, Any]) -> None:
    """Print one JSON document."""
    say(json.dumps(plain(tree), indent=1, ensure_ascii=False, allow_nan=False))
