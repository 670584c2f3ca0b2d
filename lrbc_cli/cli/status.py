"""The command ``lrbc status``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import click

from lrbc_cli.campaign.jobs.status import STATES, CampaignStatus
from lrbc_cli.campaign.jobs.status import status as examine
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.cli.common import cache_folder, load, say_json
from lrbc_cli.cli.options import calibration_option, campaign_options
from lrbc_cli.cli.terminal import say, typed
from lrbc_cli.report.old import outdated


@click.command()
@campaign_options
@calibration_option
def status(config: Path, overrides: tuple[str, ...], cache: Path | None, as_json: bool, calibration: bool) -> None:
    """Show which jobs are done, and the time left; change nothing.

    A job is done, out of date, without a file, with files that cannot be used, failed or not run yet. A report page that is missing
    or older than the results is reported too.
    """
    inputs = load(config, overrides, calibration=calibration, warn=False)
    found = examine(inputs, cache_folder(cache))
    use, page = inputs.calibration, inputs.campaign.output / "report.html"
    trouble = "; ".join(filter(None, (found.page, outdated(page))))
    if as_json:
        say_json(
            {
                "campaign": inputs.campaign.name,
                "output": inputs.campaign.output,
                "counts": {state: len(found.named(state)) for state in STATES},
                "jobs": {name: asdict(job) for name, job in found.jobs.items()},
                "passed_over": found.passed_over,
                "seconds_left": found.seconds_left,
                "calibration": None if use is None else {"used": use.used, "text": use.text},
                "cache": {"hit": found.cache.hit, "reason": found.cache.reason},
                "report": {"file": page, "trouble": trouble or None},
            }
        )
        return
    campaign: list[Path | str] = [config, *(word for override in overrides for word in ("--override", override))]
    counts = [f"{count} {words}" for state, words in STATES.items() if (count := len(found.named(state)))]
    say(f"{inputs.campaign.name}: {', '.join(counts) or 'no jobs'}")
    width = max([len(name) for name in found.jobs], default=0)
    for name, job in found.jobs.items():
        say(f"{name:{width}}  {STATES[job.state]:{max(map(len, STATES.values()))}}  {job.reason}".rstrip(), finding=True)
    for text in found.passed_over:
        say(f"watched folder: {text}")
    if use is not None:
        say(f"calibration: {use.text}")
    if trouble:
        say(f"report.html: {trouble}; next: {typed('lrbc', 'report', *campaign)}")
    say("\n".join(_ahead(inputs, found, campaign)))


def _ahead(inputs: Inputs, found: CampaignStatus, campaign: Sequence[Path | str]) -> list[str]:
    """Lines with the commands still to run (`campaign`: the arguments that name it) and the time they will take."""
    todo = found.named("stale", "failed", "new")
    if not todo:
        lacking = [state for state in ("missing", "unusable") if found.named(state)]
        return ["nothing to run" + (f", but FRF files are {' or '.join(lacking)}" if lacking else "")]
    model = "" if found.cache.hit or inputs.method.full_order else ", and a reduced model to build"
    left = "time left: not known before a job has run"
    if found.seconds_left is not None:
        left = f"time left: about {found.seconds_left:.0f} s" if found.seconds_left >= 1 else "time left: less than a second"
    return [f"{left}, for {len(todo)} job{'s' if len(todo) > 1 else ''}{model}", f"next: {typed('lrbc', 'run', *campaign)}"]
