"""The command ``lrbc calibrate``."""

from __future__ import annotations

import math
from pathlib import Path

import click

from lrbc_cli.campaign.calibrate import require_calibration
from lrbc_cli.campaign.calibration import fitting, too_coarse
from lrbc_cli.campaign.digests import CALIBRATION_FILE as FILE
from lrbc_cli.campaign.reduced.cache import key_parts, look_up
from lrbc_cli.cli.common import cache_folder, load, progress, say_json
from lrbc_cli.cli.options import accept_tolerance_option, campaign_options
from lrbc_cli.cli.terminal import say
from lrbc_cli.results.model import CalibrationRecord
from lrbc_cli.study import Study


@click.command()
@campaign_options
@click.option("--force", is_flag=True, help="Calibrate again even if nothing changed.")
@click.option("--dry-run", is_flag=True, help="Print whether the calibration would run, and why; change nothing.")
@accept_tolerance_option
def calibrate(
    config: Path, overrides: tuple[str, ...], cache: Path | None, as_json: bool, force: bool, dry_run: bool, accept_tolerance: bool
) -> None:
    """Identify the global factors of the reference model. `reduce`, `update`, `simulate` and `check` use them while the inputs match."""
    inputs = load(config, overrides, calibration=None)
    settings = require_calibration(inputs)
    folder = cache_folder(cache)
    if dry_run:
        found = fitting(inputs)
        decision = look_up(folder, key_parts(inputs))
        reason = "--force" if force and found.record else found.reason
        runs = force or found.record is None
        if as_json:
            say_json(
                {
                    "run": runs,
                    "reason": reason,
                    "job": settings.job,
                    "factors": list(settings.names),
                    "boundary": settings.boundary,
                    "cache": {"hit": decision.hit, "reason": decision.reason},
                }
            )
        else:
            say(f"calibration from {settings.job}: {'runs' if runs else 'kept'} ({reason})")
            say(f"factors: {', '.join(settings.names)}; boundary {'held' if settings.boundary == 'held' else 'also identified'}")
            say(f"reduced model: {'in the cache' if decision.hit else 'to be built'} ({decision.reason})")
        return
    record, kept = Study(inputs, folder, progress()).calibrate(force=force, accept=accept_tolerance)
    if as_json:
        say_json(record.tree())
    else:
        say("\n".join(describe(record, kept)))
        if coarse := too_coarse(inputs, record):
            say(f"note: {coarse}")
        say(f"{inputs.campaign.output / FILE}")


def describe(record: CalibrationRecord, kept: bool) -> list[str]:
    """Lines of text on a calibration; `kept`: it was not computed again."""
    misfit, reduction = record.misfit_db, record.reduction

    def change(before: float, after: float) -> str:
        return "none" if math.isnan(after) else f"{before:.2f} -> {after:.2f} dB"

    def limit(value: float | None) -> str:
        return "open" if value is None else f"{value:.5g}"

    lines = [
        f"calibration from {record.job}: {record.status} ({record.reason}){', kept: nothing changed' if kept else ''}",
        f"mean misfit over all lines: responses used {change(misfit.initial, misfit.final)}, "
        f"validation channels {change(misfit.held_out_initial, misfit.held_out_final)}",
    ]
    width = max(len(name) for name in record.factors)
    for name, entry in record.factors.items():
        lines.append(f"  {name:<{width}}  {entry.value:.5g}  95 % {limit(entry.lower95)} to {limit(entry.upper95)}")
    rounds = len(record.rounds)
    lines.append(
        f"error of the reduced model with these factors: at most {reduction.worst:.1e} (tolerance {reduction.tolerance:.0e}) at "
        f"{len(reduction.held_out)} full lines; {rounds} round{'s' if rounds > 1 else ''}, {record.seconds:.1f} s"
    )
    # Warnings were printed while it was computed.
    lines += [f"note: {note}" for note in record.notes if kept or note not in record.warnings]
    return lines
