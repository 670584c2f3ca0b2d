"""``lrbc schema``."""

from __future__ import annotations

import json

import click

from lrbc_cli.cli.options import verbosity_options
from lrbc_cli.config.schema import campaign_schema
from lrbc_cli.results.store import results_schema


@click.command(short_help="Print the JSON Schema of the campaign or result files.")
@click.option("--results", is_flag=True, help="Print the schema of the result files.")
@verbosity_options
def schema(results: bool) -> None:
    """Print the JSON Schema of the campaign file, or of the result files, for editors and other programs."""
    click.echo(json.dumps(results_schema() if results else campaign_schema(), indent=2, ensure_ascii=False))
