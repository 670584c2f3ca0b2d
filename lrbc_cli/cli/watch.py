"""The command ``lrbc watch``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import click

from lrbc_cli.campaign.beside import unseen
from lrbc_cli.cli.common import cache_folder, progress, tell_calibration
from lrbc_cli.cli.options import accept_tolerance_option, calibration_option, campaign_options
from lrbc_cli.cli.terminal import remark, say
from lrbc_cli.config import Campaign
from lrbc_cli.config.watch import WatchConfig
from lrbc_cli.errors import listing
from lrbc_cli.updating.judging.clearance import JobFinding, not_clear
from lrbc_cli.watch.loop import Pace, Watch
from lrbc_cli.watch.session import Session, WatchSettings
from lrbc_cli.watch.verdict import Hook, Verdict


@click.command()
@campaign_options
@calibration_option
@click.option("--folder", type=click.Path(path_type=Path, file_okay=False), help="Watch this folder instead of watch.folder.")
@click.option("--pattern", "patterns", multiple=True, metavar="GLOB", help="Pattern of the measurement files in the folder; repeatable.")
@click.option("--once", is_flag=True, help="Judge the files that are present, then exit.")
@click.option("--fail-on-loose", is_flag=True, help="With --once: exit with 6 or 7 as `lrbc update` does.")
@click.option("--bell", is_flag=True, help="Ring the terminal bell at each verdict.")
@click.option("--hook", metavar="COMMAND", help="Run this program at each verdict, with job, verdict and exit code as arguments.")
@click.option(
    "--interval",
    type=click.FloatRange(min=0.05),
    default=2.0,
    show_default=True,
    help="Seconds between scans of the folder if no file event arrives.",
)
@accept_tolerance_option
def watch(
    *,
    config: Path,
    overrides: tuple[str, ...],
    cache: Path | None,
    as_json: bool,
    calibration: bool,
    folder: Path | None,
    patterns: tuple[str, ...],
    once: bool,
    fail_on_loose: bool,
    bell: bool,
    hook: str | None,
    interval: float,
    accept_tolerance: bool,
) -> int:
    """Identify, judge and report FRF files as they arrive: those of the campaign's jobs, and those in a folder (one job per file).

    Calibrates if the campaign file says so. Runs until Ctrl+C. Finished results are kept, and all commands can use them.
    With --json each verdict is one JSON document on a line of its own (JSON lines).
    """
    if fail_on_loose and not once:
        raise click.UsageError("--fail-on-loose needs --once: without --once this command never ends")
    given: list[tuple[str, str | list[str]]] = [("watch.folder", str(folder.absolute()))] if folder is not None else []
    given += [("watch.pattern", list(patterns))] if patterns else []
    overrides = (*overrides, *(f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in given))
    program = None if hook is None else Hook(hook)
    settings = WatchSettings(
        config=config, overrides=overrides, cache=cache_folder(cache), calibration=calibration, accept=accept_tolerance
    )
    session = Session(settings, progress())
    page = session.output / "report.html"
    if session.campaign.calibration is None or not calibration:
        # Otherwise the calibration is computed or checked while watching.
        tell_calibration(session.inputs.calibration, wanted=calibration)

    def tell(verdict: Verdict) -> None:
        if as_json:
            say(json.dumps(verdict.tree(), ensure_ascii=False))
        else:
            say(verdict.sentence, finding=True)
        if bell:
            click.echo("\a", err=True, nl=False)
        trouble = None if program is None else program.run(verdict, page)
        if trouble is not None:
            remark(f"--hook: {trouble}", kind="warning")

    _begin(session.campaign.watch, page, once)
    if given:
        remark("other commands do not know this folder; enter it in the campaign file: watch: {folder: ..., pattern: ...}")
    pace = Pace(interval=interval, settle=min(Pace.settle, interval), retry=10 * interval)
    run = Watch(session=session, tell=tell, say=remark, pace=pace)
    run.run(once)
    if run.failed:
        return 5
    if not fail_on_loose:
        return 0
    return _clearance(run.findings, session.campaign)


def _clearance(findings: Mapping[str, JobFinding], campaign: Campaign) -> int:
    """Exit code of ``--fail-on-loose`` for the findings of the measured jobs."""
    if any(found.assumed is None and found.named("loose") for found in findings.values()):
        return 6
    lacking = [name for name in campaign.jobs if name not in findings]
    if lacking:
        remark(f"no all-clear: {listing(lacking)} {'is' if len(lacking) == 1 else 'are'} not measured", kind="warning")
    return 7 if lacking or not_clear(findings) or unseen(campaign) else 0


def _begin(watched: WatchConfig | None, page: Path, once: bool) -> None:
    """Print what is watched, with a warning if its folder cannot be read."""
    place = "the files of its jobs" if watched is None else f"{watched.folder} for {', '.join(watched.patterns)}"
    remark(f"watching {place}; the page is {page}" + ("" if once else "; Ctrl+C to end"))
    if watched is not None and not watched.in_reach:
        later = "" if once else " Its files are judged as soon as it is available"
        remark(
            f"the watched folder {watched.folder} cannot be read: check the path, and whether the drive is connected.{later}",
            kind="warning",
        )
