"""The command ``lrbc check``."""

from __future__ import annotations

from pathlib import Path

import click

from lrbc_cli.campaign.check import check as examine
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.structure import structure_of
from lrbc_cli.cli.common import cache_folder, load, say_json
from lrbc_cli.cli.options import calibration_option, campaign_options, verbosity


@click.command()
@campaign_options
@calibration_option
@click.option("--picture", is_flag=True, help="Draw the structure: structure.png and structure.html in the output folder.")
def check(config: Path, overrides: tuple[str, ...], cache: Path | None, as_json: bool, calibration: bool, *, picture: bool) -> int:
    """Read all inputs and print the plan; change nothing, but for the picture where it is asked for."""
    inputs = load(config, overrides, calibration=calibration, warn=False)
    drawn = _draw(inputs, tell=not as_json) if picture else []
    findings = examine(inputs, cache_folder(cache), detailed=as_json or verbosity.level >= 1)
    if as_json:
        say_json(findings.tree | ({"picture": drawn} if picture else {}))
    else:
        for title, lines in findings.sections.items():
            click.echo(title)
            for line in lines:
                click.echo(f"  {line}")
        if findings.warnings:
            click.echo("warnings")
            for line in findings.warnings:
                click.echo(f"  {line}")
    for error in findings.errors.values():
        click.echo(error.message, err=True)
    return max((error.exit_code for error in findings.errors.values()), default=0)


def _draw(inputs: Inputs, *, tell: bool) -> list[Path]:
    """Write the picture, and say so."""
    # Drawing loads matplotlib, which nobody else needs here.
    from lrbc_cli.report.write import write_structure

    record = structure_of(inputs)
    files = write_structure(inputs.campaign.output, record)
    if tell:
        click.echo("picture")
        for line in [*map(str, files), *record.notes] if files else [f"none: {record.reason}"]:
            click.echo(f"  {line}")
    return files
