"""The command ``lrbc check``."""

from __future__ import annotations

from pathlib import Path

import click

from lrbc_cli.campaign.check import check as examine
from lrbc_cli.cli.common import cache_folder, load, say_json
from lrbc_cli.cli.options import calibration_option, campaign_options, verbosity


@click.command()
@campaign_options
@calibration_option
def check(config: Path, overrides: tuple[str, ...], cache: Path | None, as_json: bool, calibration: bool) -> int:
    """Read all inputs and print the plan; change nothing."""
    inputs = load(config, overrides, calibration=calibration, warn=False)
    findings = examine(inputs, cache_folder(cache), detailed=as_json or verbosity.level >= 1)
    if as_json:
        say_json(findings.tree)
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
