"""The command ``lrbc plan``."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from lrbc_cli.campaign.planning.files import write_plan
from lrbc_cli.cli.common import load, progress, say_json
from lrbc_cli.cli.options import accept_tolerance_option, calibration_option, campaign_options
from lrbc_cli.cli.terminal import remark, say
from lrbc_cli.report.parts.plan import draw_plan, plan_text
from lrbc_cli.study import Study


@click.command()
@campaign_options
@calibration_option
@click.option(
    "--noise", type=click.FloatRange(min=1e-3), metavar="DB", help="Standard deviation of the noise per line in dB, at least 0.001."
)
@click.option(
    "--state",
    metavar="STATE",
    help="State to plan for: initial, clamped, free or job:NAME. Default: result of the reference job, else initial.",
)
@click.option(
    "--by", type=click.Choice(["auto", "bolts", "values"]), default="auto", show_default=True, help="What is loosened, one at a time."
)
@click.option(
    "--draws",
    type=click.IntRange(min=0),
    metavar="N",
    help="Rehearsals per bolt and loss, identified and judged as by `lrbc update`; 0: linearised figures only. Default: 1 to 5, "
    "about 150 in total; and five times N of the tight structure.",
)
@accept_tolerance_option
def plan(
    *,
    config: Path,
    overrides: tuple[str, ...],
    cache: Path | None,
    as_json: bool,
    calibration: bool,
    noise: float | None,
    state: str | None,
    by: Literal["auto", "bolts", "values"],
    draws: int | None,
    accept_tolerance: bool,
) -> None:
    """Predict the verdict of `lrbc update` for each bolt if it alone is loose, and rank the responses. No measurement is needed."""
    study = Study(load(config, overrides, calibration=calibration), cache, progress())
    output = study.inputs.campaign.output
    record = study.plan(state, noise_db=noise, by=by, draws=draws, accept=accept_tolerance)
    kept = write_plan(output, record)
    draw_plan(output)
    if as_json:
        say_json(record.tree())
    else:
        say(plan_text(output))
        say(f"plan written to {output}: plan.json, plan.csv, plan.png")
    if kept:
        remark(f"the earlier plan, of more rehearsals, is kept in {output}: {', '.join(kept)}", kind="note")
