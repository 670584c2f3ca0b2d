"""The command ``lrbc simulate``."""

from __future__ import annotations

from pathlib import Path

import click

from lrbc_cli.campaign.simulate import simulate as compute
from lrbc_cli.cli.common import cache_folder, load, progress, say_json
from lrbc_cli.cli.options import accept_tolerance_option, calibration_option, campaign_options, lines_option
from lrbc_cli.cli.terminal import say


@click.command()
@campaign_options
@calibration_option
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="File to write: .csv, .uff or .h5.")
@click.option("--job", metavar="NAME", help="Use the parameters identified from this job.")
@lines_option
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="GROUP=LOG10",
    help="Value of the group, or one value per parameter; inf: clamped, -inf: free. Damping: GROUP.damping=LOG10.",
)
@click.option("--full", is_flag=True, help="Use the full model: one full-order solve for each line.")
@click.option("--force", is_flag=True, help="Replace the file of --out if it exists.")
@accept_tolerance_option
def simulate(
    *,
    config: Path,
    overrides: tuple[str, ...],
    cache: Path | None,
    as_json: bool,
    calibration: bool,
    out: Path,
    job: str | None,
    lines: str | None,
    assignments: tuple[str, ...],
    full: bool,
    force: bool,
    accept_tolerance: bool,
) -> None:
    """Compute FRFs of the model and write them to a file."""
    inputs = load(config, overrides, own_output=job is not None, calibration=calibration)
    frf = compute(
        inputs,
        cache_folder(cache),
        out,
        job=job,
        lines=lines,
        assignments=assignments,
        full=full,
        replace=force,
        accept=accept_tolerance,
        progress=progress(),
    )
    count = frf.records[0].frequency_hz.size
    if as_json:
        say_json({"file": out, "lines": count, "responses": [r.name for r in frf.records]})
    else:
        say(f"{out}: {len(frf.records)} responses, {count} lines, {'full' if full else 'reduced'} order")
