"""``lrbc guide``."""

from __future__ import annotations

import click

from lrbc_cli import guide as pages
from lrbc_cli.cli.options import verbosity_options
from lrbc_cli.errors import ConfigError


@click.command(short_help="Show the pages of the guide.")
@click.argument("topic", required=False)
@verbosity_options
def guide(topic: str | None) -> None:
    """Show a page of the guide, or the list of its topics."""
    if topic is None:
        width = max(map(len, pages.TOPICS))
        click.echo("lrbc guide TOPIC shows a page:\n")
        for name, text in pages.TOPICS.items():
            click.echo(f"  {name:{width}}  {text}")
        return
    if topic not in pages.TOPICS:
        raise ConfigError(f"the guide has no page '{topic}'", place="lrbc guide", expected=f"one of {', '.join(pages.TOPICS)}", found=topic)
    click.echo(pages.page(topic), nl=False)
