"""The command ``lrbc update``."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lrbc_cli.campaign.documents import require_own_output
from lrbc_cli.campaign.jobs.plans import choose_jobs, plan
from lrbc_cli.campaign.jobs.rejudge import judge_finished, unchanged
from lrbc_cli.campaign.jobs.standing import Outcome, findings_of
from lrbc_cli.campaign.protect import require_inputs_apart
from lrbc_cli.cli.common import cache_folder, progress, read, say_json, tell_calibration, tell_warnings
from lrbc_cli.cli.options import accept_tolerance_option, calibration_option, campaign_options, verbosity
from lrbc_cli.cli.terminal import complain, remark, say
from lrbc_cli.config import Campaign, load_campaign
from lrbc_cli.errors import listing
from lrbc_cli.report.old import outdating
from lrbc_cli.report.summary import summary_of
from lrbc_cli.updating.judging.clearance import open_groups, sentence

if TYPE_CHECKING:
    from lrbc_cli.campaign.reading.inputs import Inputs

FAIL_HELP = """Exit with 6 if all jobs ran and a bolt is judged loose; with 7 if no bolt is judged loose but not every observable bolt is
judged tight in every job, or nothing was compared. Exit code 0 is an all-clear."""

#: Meaning of the exit codes of ``--fail-on-loose``.
CLEARANCE = {
    0: "all clear: every observable bolt is tight",
    6: "a bolt is loose",
    7: "no bolt is judged loose, but this is no all-clear",
}


@click.command()
@campaign_options
@calibration_option
@click.option("--job", "jobs", multiple=True, metavar="NAME", help="Run only this job; repeatable.")
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Number of jobs run in parallel.")
@click.option(
    "--scheduler", metavar="ADDRESS", help="Identify on the workers of this Dask scheduler, with as many jobs in parallel as they can run."
)
@click.option("--force", is_flag=True, help="Run finished jobs again.")
@click.option("--dry-run", is_flag=True, help="Print which jobs would run, and why; change nothing.")
@click.option("--fail-on-loose", is_flag=True, help=FAIL_HELP)
@accept_tolerance_option
def update(
    *,
    config: Path,
    overrides: tuple[str, ...],
    cache: Path | None,
    as_json: bool,
    calibration: bool,
    jobs: tuple[str, ...],
    workers: int,
    scheduler: str | None,
    force: bool,
    dry_run: bool,
    fail_on_loose: bool,
    accept_tolerance: bool,
) -> int:
    """Identify and judge all jobs, or those given by --job. Finished jobs whose inputs did not change are kept.

    Exit codes: 0 success, 2 error in the campaign file or command line, 3 error in the input data, 4 numerical failure, 5 some jobs
    failed; with --fail-on-loose also 6 a bolt is loose, 7 none is judged loose but not every observable bolt is judged tight.
    """
    if dry_run and fail_on_loose:
        raise click.UsageError("--dry-run judges no bolts: leave out --fail-on-loose")
    if scheduler is not None and workers > 1:
        raise click.UsageError("--workers sets the number of jobs on this machine: leave it out with --scheduler")
    campaign, folder = load_campaign(config, overrides), cache_folder(cache)
    require_own_output(campaign)
    if dry_run:
        _dry_run(read(campaign, calibration=calibration), folder, jobs, force=force, as_json=as_json)
        return 0
    outcome = None if force else _judged_anew(campaign, jobs, calibration=calibration)
    if outcome is None:
        inputs = read(campaign, calibration=calibration)
        outcome = _updated(inputs, folder, scheduler, jobs=jobs, force=force, accept=accept_tolerance, workers=workers)
    tell_troubles(outcome)
    code = outcome.exit_code(fail_on_loose)
    if as_json:
        say_json(outcome_tree(campaign, outcome, code))
    else:
        say(summary_of({name: outcome.results.get(name) for name in finished(campaign, outcome)}), finding=True)
        tell_clearance(outcome, code, fail_on_loose)
        say(f"results in {campaign.output}")
    return code


def _judged_anew(campaign: Campaign, jobs: tuple[str, ...], *, calibration: bool) -> Outcome | None:
    """Outcome of judging the stored evidence again, without reading the model; None if anything has to be identified."""
    require_inputs_apart(campaign)
    found = unchanged(campaign, jobs, calibration=calibration)
    if found is None:
        return None
    tell_warnings(found.said.warnings)
    tell_calibration(found.said.calibration, wanted=calibration)
    with outdating(campaign.output / "report.html"):
        return judge_finished(campaign, found, all_jobs=not jobs, progress=progress())


def _updated(inputs: Inputs, folder: Path, scheduler: str | None, **options: Any) -> Outcome:
    """Identify and judge all jobs that are not up to date."""
    # Imported here, since they would delay runs that only judge.
    from lrbc_cli.campaign.jobs.remote import cluster
    from lrbc_cli.study import Study
    from lrbc_cli.watch.lock import at_work

    output = inputs.campaign.output
    with (
        at_work(output, partial(remark, kind="note")),
        nullcontext() if scheduler is None else cluster(scheduler) as remote,
        outdating(output / "report.html"),
    ):
        return Study(inputs, folder, progress()).update(remote=remote, **options)


def _dry_run(inputs: Inputs, folder: Path, jobs: tuple[str, ...], *, force: bool, as_json: bool) -> None:
    from lrbc_cli.campaign.reduced.cache import key_parts, look_up

    parts = key_parts(inputs)
    decision = look_up(folder, parts)
    plans = plan(inputs, parts, choose_jobs(inputs.campaign, jobs), force)
    if as_json:
        say_json(
            {
                "cache": {"hit": decision.hit, "reason": decision.reason, "missed": decision.missed or None},
                "calibration": None if inputs.calibration is None else inputs.calibration.text,
                "jobs": {p.name: {"run": p.run, "judge": p.judge, "reason": p.reason} for p in plans},
            }
        )
        return
    if not inputs.method.full_order:
        say(f"reduced model: {'in the cache' if decision.hit else 'to be built'} ({decision.reason})")
        if decision.missed:
            say(f"{decision.missed}; --accept-tolerance accepts it")
    for p in plans:
        say(f"{p.name}: {p.verb} ({p.reason})")


def tell_troubles(outcome: Outcome) -> None:
    """Print to stderr why jobs failed, and the warnings on the others."""
    if verbosity.level >= 0:
        for name, error in outcome.errors.items():
            complain(f"job {name} failed: {error.message}")
        for name, record in outcome.results.items():
            for warning in record.warnings:
                remark(f"job {name}: {warning}", kind="warning")
        for name, problem in outcome.across.items():
            remark(f"job {name}: {problem}", kind="warning")
        for text in [*([outcome.unseen] if outcome.unseen else []), *outcome.beside]:
            remark(text, kind="warning")
        if older := outcome.of_other_libraries:
            remark(f"{listing(older)}: kept, but Python or its libraries changed since; --force identifies again", kind="note")


def finished(campaign: Campaign, outcome: Outcome) -> list[str]:
    """Names of the jobs of this call, in the order of the campaign."""
    return [name for name in campaign.jobs if name in outcome.results or name in outcome.failed]


def outcome_tree(campaign: Campaign, outcome: Outcome, code: int) -> dict[str, Any]:
    """Content of the document that ``--json`` prints."""
    return {
        "exit_code": code,
        "output": campaign.output,
        "kept": outcome.kept,
        "judged": outcome.judged,
        "failed": {n: e.message for n, e in outcome.errors.items()},
        "findings": {name: sentence(job) for name, job in findings_of(outcome.results, finished(campaign, outcome)).items()},
        "not_clear": outcome.not_clear,
        "results": outcome.results,
    }


def tell_clearance(outcome: Outcome, code: int, fail_on_loose: bool) -> None:
    """Print the meaning of the exit code of ``--fail-on-loose``."""
    if fail_on_loose and code in CLEARANCE:
        why = "; ".join(f"{name}: {', '.join(points)}" if name else ", ".join(points) for name, points in outcome.not_clear.items())
        partly = list(dict.fromkeys(group for job in outcome.findings.values() for group in open_groups(job))) if code == 0 else []
        # What the sentences of the jobs leave open must not be closed by the last line.
        whole = f" as a whole; that springs of {' or '.join(partly)} alone are loose is not excluded, see above" if partly else ""
        say(f"{CLEARANCE[code]}{whole}" + (f" ({why})" if code == 7 else ""))
