"""The command ``lrbc reduce``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from lrbc_cli.campaign.cache import key_parts, look_up
from lrbc_cli.campaign.results import write_campaign, write_reduction
from lrbc_cli.campaign.stage import obtain_reduction
from lrbc_cli.cli.common import cache_folder, load, progress, say_json
from lrbc_cli.cli.options import calibration_option, campaign_options


@click.command()
@campaign_options
@calibration_option
@click.option("--force", is_flag=True, help="Build anew even where the cache has the model.")
@click.option("--dry-run", is_flag=True, help="Say whether the cache has the model, and why; change nothing.")
@click.option("--accept-tolerance", is_flag=True, help="Accept a model that does not reach its tolerance.")
def reduce(
    config: Path,
    overrides: tuple[str, ...],
    cache: Path | None,
    as_json: bool,
    calibration: bool,
    force: bool,
    dry_run: bool,
    accept_tolerance: bool,
) -> None:
    """Build the reduced model, or find it in the cache."""
    inputs = load(config, overrides, calibration=calibration)
    folder = cache_folder(cache)
    if dry_run:
        decision = look_up(folder, key_parts(inputs))
        would = "builds the reduced model (--force)" if force else ("finds it in the cache" if decision.hit else "builds the reduced model")
        used = None if inputs.calibration is None else inputs.calibration.text
        if as_json:
            say_json(
                {
                    "hit": decision.hit,
                    "reason": decision.reason,
                    "key": decision.key,
                    "builds": force or not decision.hit,
                    "calibration": used,
                }
            )
        else:
            click.echo(f"{would}: {decision.reason}")
        return
    stage = obtain_reduction(inputs, folder, force=force, accept=accept_tolerance, progress=progress())
    tree = write_reduction(inputs.campaign.output, inputs, stage)
    write_campaign(inputs.campaign.output, inputs)
    if as_json:
        say_json(tree)
    else:
        click.echo("\n".join(describe(tree, stage.seconds)))


def describe(tree: dict[str, Any], seconds: float) -> list[str]:
    """The reduced model in a few lines."""
    worst = tree["certificate"]["worst"]
    points = tree["expansion_points"]
    cache = tree["cache"]
    held_out = tree["certificate"]["held_out"]
    lines = [
        f"reduced model: {tree['size']} DOFs ({tree['size_structure']} structural, {tree['size_acoustic']} acoustic) "
        f"for {tree['full_size']}, {tree['terms']} terms",
        f"cache: {'hit' if cache['hit'] else 'miss'} ({cache['reason']}); {seconds:.1f} s",
        f"measured error: at most {worst:.1e} (tolerance {tree['tolerance']:.0e}) at {len(held_out)} held-out lines, "
        f"{tree['certificate']['vectors']} parameter vectors each, free to clamped",
    ]
    for line in held_out:
        errors = ", ".join(f"{kind} {error:.1e}" for kind, error in line["errors"].items())
        lines.append(f"  {line['frequency_hz']:8.2f} Hz  {errors}")
    lines.append(
        f"built {tree['date']} with {tree['backend']}: {len(points)} expansion points, {tree['seconds']['total']:.1f} s, "
        f"the time of {tree['seconds']['full_lines_worth']:.0f} full lines ({tree['seconds']['full_line']:.2f} s each)"
    )
    return lines
