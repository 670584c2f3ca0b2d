"""``lrbc init``."""

from __future__ import annotations

from pathlib import Path

import click

from lrbc_cli.cli.options import verbosity_options
from lrbc_cli.config.skeleton import write_skeleton


@click.command(short_help="Write a commented campaign file to fill in.")
@click.argument("directory", metavar="[DIR]", type=click.Path(path_type=Path), default=Path())
@verbosity_options
def init(directory: Path) -> None:
    """Write a commented campaign file, and folders for the model and the FRFs, into DIR (default: the current folder)."""
    for path in write_skeleton(directory):
        click.echo(path)
