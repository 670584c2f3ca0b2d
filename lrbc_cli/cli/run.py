"""The command ``lrbc run``."""

from __future__ import annotations

import webbrowser
from collections.abc import Callable
from functools import partial
from pathlib import Path

import click

from lrbc_cli.campaign.beside import outlived, passed_over
from lrbc_cli.campaign.jobs.plans import choose_jobs, of_earlier_files
from lrbc_cli.campaign.jobs.status import of_other_settings
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.cli.common import load, progress, say_json, tell_calibration
from lrbc_cli.cli.options import accept_tolerance_option, calibration_option, campaign_options
from lrbc_cli.cli.terminal import complain, remark, say
from lrbc_cli.cli.update import FAIL_HELP, finished, outcome_tree, tell_clearance, tell_troubles
from lrbc_cli.errors import LrbcError
from lrbc_cli.reduction.threads import cores
from lrbc_cli.report.old import outdating
from lrbc_cli.report.reading import read_results
from lrbc_cli.report.write import write_report
from lrbc_cli.study import Study
from lrbc_cli.watch.lock import at_work


@click.command()
@campaign_options
@calibration_option
@click.option("--open", "opened", is_flag=True, help="Open the report in the browser.")
@click.option("--job", "jobs", multiple=True, metavar="NAME", help="Run only this job; repeatable.")
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Number of jobs run in parallel.")
@click.option("--force", is_flag=True, help="Calibrate again, and run finished jobs again.")
@click.option("--fail-on-loose", is_flag=True, help=FAIL_HELP)
@accept_tolerance_option
def run(
    *,
    config: Path,
    overrides: tuple[str, ...],
    cache: Path | None,
    as_json: bool,
    calibration: bool,
    opened: bool,
    jobs: tuple[str, ...],
    workers: int,
    force: bool,
    fail_on_loose: bool,
    accept_tolerance: bool,
) -> int:
    """Calibrate if the campaign file says so, update all jobs, write the report, and print one sentence for each job.

    Finished work that is still valid is kept. Exit codes are those of `lrbc update`. The report is written even if jobs failed.
    """
    tell = progress()
    study = Study(load(config, overrides, calibration=None), cache, tell)
    choose_jobs(study.inputs.campaign, jobs)
    if calibration and study.inputs.campaign.calibration is not None:
        study.calibrate(force=force, accept=accept_tolerance)
    else:
        study.use_calibration(calibration)
    inputs = study.inputs
    tell_calibration(inputs.calibration, wanted=calibration)
    output = inputs.campaign.output
    with at_work(output, partial(remark, kind="note")), outdating(output / "report.html"):
        outcome = study.update(jobs, force=force, accept=accept_tolerance, workers=workers)
    tell_troubles(outcome)
    code, page = outcome.exit_code(fail_on_loose), None
    try:
        page = _page(inputs, tell)
        wrong = [*read_results(output).unreadable.values()]
    except LrbcError as error:
        wrong = [error]
    for unread in wrong:
        complain(unread.message)
        # The lower exit code counts: the error of the report comes before those of single jobs.
        code = min(code or unread.exit_code, unread.exit_code)
    if as_json:
        use = inputs.calibration
        found = None if use is None else {"used": use.used, "text": use.text, "factors": use.factors}
        say_json({**outcome_tree(inputs.campaign, outcome, code), "calibration": found, "report": page})
    else:
        for name in finished(inputs.campaign, outcome):
            failure = outcome.errors.get(name)
            said = outcome.results[name].sentence if failure is None else f"{name}: failed: {failure.message.splitlines()[0]}"
            say(said, finding=True)
        if page is not None:
            say(f"report: {page}")
        tell_clearance(outcome, code, fail_on_loose)
    if opened and page is not None and not webbrowser.open(page.resolve().as_uri()):
        remark(f"no browser could be opened; open {page}", kind="warning")
    return code


def _page(inputs: Inputs, tell: Callable[[str], None]) -> Path:
    """Write the report of all jobs; it says which results are those of earlier measurements or settings."""
    campaign = inputs.campaign
    return write_report(
        campaign.output,
        expected=list(campaign.jobs),
        earlier=of_other_settings(campaign, lambda: inputs) | of_earlier_files(campaign),
        passed_over=[*passed_over(campaign), *outlived(campaign)],
        workers=min(2, cores()),
        progress=tell,
    )
