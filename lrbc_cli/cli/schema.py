"""``lrbc schema``."""

from __future__ import annotations

import json

import click

from lrbc_cli.cli.options import verbosity_options
from lrbc_cli.config.schema import campaign_schema


@click.command(short_help="Print the JSON Schema of the campaign file.")
@verbosity_options
def schema() -> None:
    """Print the JSON Schema of the campaign file, for editors and other programs."""
    click.echo(json.dumps(campaign_schema(), indent=2, ensure_ascii=False))
