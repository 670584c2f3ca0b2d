"""What the commands that read a campaign share: loading it, progress on stderr, output on stdout."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lrbc_cli.campaign.documents import cache_folder, require_own_output
from lrbc_cli.cli.interruption import stop_if_asked
from lrbc_cli.cli.options import verbosity
from lrbc_cli.cli.terminal import line, remark, say
from lrbc_cli.config import Campaign, load_campaign
from lrbc_cli.results.fields import plain

if TYPE_CHECKING:
    from lrbc_cli.campaign.reading.factors import CalibrationUse
    from lrbc_cli.campaign.reading.inputs import Inputs
    from lrbc_cli.results.model import CalibrationNews

__all__ = ["cache_folder", "load", "progress", "say_json", "tell_calibration"]


def load(
    config: Path, overrides: tuple[str, ...], *, own_output: bool = True, calibration: bool | None = True, warn: bool = True
) -> Inputs:
    """Read the campaign file and its model, see ``read``. An output folder of another campaign is refused where it counts."""
    campaign = load_campaign(config, overrides)
    if own_output:
        require_own_output(campaign)
    return read(campaign, calibration=calibration, warn=warn)


def read(campaign: Campaign, *, calibration: bool | None = True, warn: bool = True) -> Inputs:
    """Read the model of a campaign; warnings go to stderr.

    What became of a stored calibration is said; False leaves it out, None looks for none.
    ``warn=False`` leaves the warnings about files and model, and the calibration, to the caller.
    """
    # Here: who judges anew reads no model.
    from lrbc_cli.campaign.calibration import read_inputs
    from lrbc_cli.campaign.reading.inputs import read_as_exported

    inputs = read_as_exported(campaign) if calibration is None else read_inputs(campaign, calibration=calibration)
    if warn:
        tell_warnings((*inputs.warnings, *inputs.method.warnings))
        tell_calibration(inputs.calibration, wanted=bool(calibration))
    return inputs


def tell_warnings(warnings: Sequence[str]) -> None:
    """Say on stderr what is doubtful about files and model."""
    for warning in warnings if verbosity.level >= 0 else ():
        remark(warning, kind="warning")


def tell_calibration(use: CalibrationUse | CalibrationNews | None, *, wanted: bool) -> None:
    """Say on stderr what became of a stored calibration; that there is none is no news but for those who left it out."""
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
