"""The command ``lrbc report``."""

from __future__ import annotations

from pathlib import Path

import click

from lrbc_cli.campaign.beside import outlived, passed_over
from lrbc_cli.campaign.documents import require_own_output
from lrbc_cli.campaign.jobs.plans import of_earlier_files
from lrbc_cli.campaign.jobs.status import of_other_settings
from lrbc_cli.campaign.protect import require_inputs_apart
from lrbc_cli.cli.common import progress, read, say_json
from lrbc_cli.cli.options import campaign_options
from lrbc_cli.cli.terminal import complain, say
from lrbc_cli.config import load_campaign
from lrbc_cli.reduction.threads import cores
from lrbc_cli.report.reading import read_results
from lrbc_cli.report.sections.top import NO_RESULT
from lrbc_cli.report.summary import summary_text
from lrbc_cli.report.write import VECTORS, missing_jobs, write_report


def _kinds(ctx: click.Context, param: click.Parameter, value: str) -> tuple[str, ...]:
    kinds = tuple(dict.fromkeys(part.strip().lower() for part in value.split(",") if part.strip()))
    unknown = [kind for kind in kinds if kind not in VECTORS]
    if unknown:
        raise click.BadParameter(f"{', '.join(unknown)}: give {' or '.join(VECTORS)}, or both separated by a comma.")
    return kinds


@click.command()
@campaign_options
@click.option(
    "--figures",
    metavar="KINDS",
    default="",
    callback=_kinds,
    help="Also write figures for print, beside the PNG files: pdf, svg or both (pdf,svg).",
)
@click.option("--job", "jobs", multiple=True, metavar="NAME", help="Show only this job; repeatable.")
def report(
    config: Path, overrides: tuple[str, ...], cache: Path | None, as_json: bool, figures: tuple[str, ...], jobs: tuple[str, ...]
) -> int:
    """Draw figures, tables and report.html from the results.

    Jobs whose results cannot be read (exit code 3) do not hide the others.
    """
    campaign = load_campaign(config, overrides)
    require_own_output(campaign)
    require_inputs_apart(campaign)
    workers = min(2, cores())
    expected, gone = list(campaign.jobs), outlived(campaign)
    earlier = of_other_settings(campaign, lambda: read(campaign, warn=False)) | of_earlier_files(campaign)
    page = write_report(
        campaign.output,
        jobs=jobs or None,
        expected=expected,
        earlier=earlier,
        passed_over=[*passed_over(campaign), *gone],
        workers=workers,
        figures=figures,
        progress=progress(),
    )
    unreadable = read_results(campaign.output, jobs or None).unreadable
    for name, error in unreadable.items():
        complain(f"job {name} is not shown: {error.message}")
    if as_json:
        say_json({"report": page, "unreadable": {name: error.message for name, error in unreadable.items()}})
    else:
        say(summary_text(campaign.output, jobs or None), finding=True)
        for name in missing_jobs(campaign.output, jobs or None, expected):
            say(f"{name}: {NO_RESULT}", finding=True)
        for text in [*(f"{name}: {why}" for name, why in earlier.items()), *gone]:
            say(text)
        say(f"report: {page}")
    return min((error.exit_code for error in unreadable.values()), default=0)
