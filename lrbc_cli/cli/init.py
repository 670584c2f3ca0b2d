"""``lrbc init``."""

from __future__ import annotations

from pathlib import Path

import click

from lrbc_cli.cli.options import verbosity_options
from lrbc_cli.cli.terminal import say, typed
from lrbc_cli.config.skeleton import FILE, write_skeleton


@click.command(short_help="Write a commented campaign file to fill in.")
@click.argument("directory", metavar="[DIR]", type=click.Path(path_type=Path), default=Path())
@click.option(
    "--from", "source", type=click.Path(path_type=Path), help="Fill in the campaign file from the files in this folder, as far as possible."
)
@verbosity_options
def init(directory: Path, source: Path | None) -> None:
    """Write a commented campaign file and its schema for editors into DIR (default: the current folder). Nothing is overwritten.

    With --from, the file lists the matrices, tables and FRF files of a folder. Files are recognised by their content, their roles by name
    and content. Without --from, folders and tables to fill in are written too.
    """
    if source is None:
        for path in write_skeleton(directory):
            say(path)
        return
    # Imported here, since a template needs neither NumPy nor the readers.
    from lrbc_cli.campaign.drafting.draft import draft
    from lrbc_cli.campaign.drafting.recognise import recognise

    made = draft(directory, recognise(source))
    text = made.text()
    for path in write_skeleton(directory, text):
        say(path)
    for line in made.recognised:
        say(f"recognised  {line}")
    for line in made.todo:
        say(f"to do       {' '.join(line.split())}")
    say(f"next: {typed('lrbc', 'check', directory / FILE)}")
