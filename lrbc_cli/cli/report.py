"""The command ``lrbc report``."""

from __future__ import annotations

import os
from pathlib import Path

import click

from lrbc_cli.campaign.documents import require_own_output
from lrbc_cli.campaign.protect import require_inputs_apart
from lrbc_cli.cli.common import progress, say_json
from lrbc_cli.cli.options import campaign_options
from lrbc_cli.cli.terminal import say
from lrbc_cli.config import load_campaign
from lrbc_cli.report import summary_text, write_report


@click.command()
@campaign_options
@click.option("--job", "jobs", multiple=True, metavar="NAME", help="Show this job only; repeatable.")
def report(config: Path, overrides: tuple[str, ...], cache: Path | None, as_json: bool, jobs: tuple[str, ...]) -> None:
    """Draw figures, tables and report.html from the results."""
    campaign = load_campaign(config, overrides)
    require_own_output(campaign)
    require_inputs_apart(campaign)
    page = write_report(campaign.output, jobs=jobs or None, workers=min(2, os.cpu_count() or 1), progress=progress())
    if as_json:
        say_json({"report": page})
    else:
        say(summary_text(campaign.output, jobs or None), finding=True)
        say(f"report: {page}")
