"""All figures and the page, from the result files of a campaign."""

from __future__ import annotations

import difflib
import logging
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.report.drawing.chart import Chart
from lrbc_cli.report.files import frf_file, replace
from lrbc_cli.report.page import Content, FrfFigure, render
from lrbc_cli.report.parts.correlation import fdac_chart
from lrbc_cli.report.parts.figures import frf_chart, profile_chart, profile_scales
from lrbc_cli.report.parts.lcurve import l_curve_chart
from lrbc_cli.report.parts.plan import plan_chart
from lrbc_cli.report.parts.strip import map_chart, strip_chart
from lrbc_cli.results.job import Job, JobRecord
from lrbc_cli.results.model import CalibrationRecord, CampaignRecord, ReductionRecord
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.results.store import read, read_job
from lrbc_cli.results.tables import read_fdac, read_frf, require_files

log = logging.getLogger(__name__)

#: Fewer figures than this are drawn here: starting processes takes about as long.
_WORTH_PROCESSES = 40

_Task = tuple[Chart, Path]


def write_report(
    output: Path, *, jobs: Sequence[str] | None = None, workers: int = 2, progress: Callable[[str], None] | None = None
) -> Path:
    """Draw all figures and write ``report.html``; reads result files only.

    Figures whose content did not change since they were drawn are left alone.

    Parameters
    ----------
    output
        The campaign's output folder.
    jobs
        Names of the jobs to show; all that have results where None.
    workers
        Processes that draw figures.
    progress
        Called with one line of text now and then.

    Returns
    -------
    Path
        Of ``report.html``.

    Raises
    ------
    ConfigError
        Where a job is named that the campaign does not have.
    DataError
        Where a result file is missing or damaged, or nothing can be written.
    """
    say = progress or (lambda line: None)
    campaign, results = read_results(output, jobs)
    reduction = read(output / "reduction.json", ReductionRecord)
    done = [job for job in results if isinstance(job, JobRecord)]
    for job in done:
        require_files(output / job.job, job.provenance.files or {})
    unknown = [job.job for job in done if not job.provenance.files]
    if unknown:
        # Of an older version.
        some = ", ".join(unknown[:5]) + (" ..." if len(unknown) > 5 else "")
        log.warning("%s: no hashes tell whether profile.csv and frf.csv belong to result.json; `lrbc update` identifies them anew", some)
    scales = profile_scales(done)
    calibration, calibration_frf = None, None
    try:
        calibration = read(output / "calibration.json", CalibrationRecord)
        calibration_frf = None if calibration is None else read_frf(output / calibration.frf)
    except DataError as error:
        # The results stand without it, as they do for the commands that would use it.
        calibration = None
        log.warning("calibration.json is left out: %s (lrbc calibrate writes it anew)", error.problem)
    strip = strip_chart(campaign, done)
    profiles: dict[str, Chart] = {}
    maps: dict[str, Chart] = {}
    fdac: dict[str, Chart] = {}
    frfs: list[FrfFigure] = []
    tasks: list[_Task] = [] if strip is None else [(strip, output / "verdicts.png")]
    plan = read(output / "plan.json", PlanRecord)
    if plan is not None:
        tasks.append((plan_chart(plan), output / "plan.png"))
    l_curves: list[Chart] = []
    for job in done:
        profile = profile_chart(job, scales)
        if profile is not None:
            profiles[job.job] = profile
            tasks.append((profile, output / job.job / "profile.png"))
        chart = map_chart(job, done)
        if chart is not None:
            maps[job.job] = chart
            tasks.append((chart, output / job.job / "map.png"))
        found = read_fdac(output / job.job / "fdac.csv")
        if found is not None:
            fdac[job.job] = fdac_chart(job, found)
            tasks.append((fdac[job.job], output / job.job / "fdac.png"))
        curve = l_curve_chart(job)
        if curve is not None:
            l_curves.append(curve)
            tasks.append((curve, output / job.job / "l-curve.png"))
        frf = read_frf(output / job.job / "frf.csv")
        for name in frf.responses:
            response = campaign.response(name)
            change = job.misfit_db.responses.get(name)
            chart = frf_chart(job, response, frf)
            frfs.append(FrfFigure(job.job, name, response.used if change is None else change.used, chart))
            tasks.append((chart, output / job.job / frf_file(name)))
    drawn = _draw_all(tasks, workers, say)
    say(f"{drawn} figures drawn, {len(tasks) - drawn} unchanged")
    page = output / "report.html"
    text = render(
        Content(
            campaign=campaign,
            jobs=results,
            reduction=reduction,
            profiles=profiles,
            frfs=frfs,
            strip=strip,
            maps=maps,
            fdac=fdac,
            calibration=calibration,
            calibration_frf=calibration_frf,
            l_curves=l_curves,
            plan=plan,
        )
    )
    with replace(page) as sink:
        sink.write(text.encode("utf-8", errors="replace"))
    say(f"{page} written")
    return page


def read_results(output: Path, jobs: Sequence[str] | None = None) -> tuple[CampaignRecord, list[Job]]:
    """Read the campaign and its jobs, in the campaign's order.

    Parameters
    ----------
    output
        The campaign's output folder.
    jobs
        Names of the jobs wanted; all that have results where None.

    Raises
    ------
    ConfigError
        Where a job is named that the campaign does not have.
    DataError
        Where a file is missing or damaged, or no job has results.
    """
    campaign = read(output / "campaign.json", CampaignRecord)
    if campaign is None:
        raise DataError(
            "there are no results here", file=output / "campaign.json", hint="run `lrbc update` first; the report only shows what it wrote"
        )
    for name in jobs or ():
        if name not in campaign.jobs:
            near = difflib.get_close_matches(name, campaign.jobs, n=1)
            hint = f"did you mean {near[0]}?" if near else "name one of the campaign's jobs"
            raise ConfigError(
                "no such job in the results", file=output / "campaign.json", expected=", ".join(campaign.jobs), found=name, hint=hint
            )
    wanted = [job for job in campaign.jobs if not jobs or job in jobs]
    # A job that has not run yet is no error, unless it was asked for.
    present = [job for job in wanted if jobs or (output / job / "result.json").exists()]
    if not present:
        raise DataError("no job has results yet", file=output, hint="run `lrbc update` first; the report only shows what it wrote")
    results = [read_job(output, job) for job in present]
    for name, job in zip(present, results, strict=True):
        if job is None:
            raise DataError("this result file is missing", file=output / name / "result.json", hint=JobRecord.HINT)
    return campaign, [job for job in results if job is not None]


def _draw_all(tasks: Sequence[_Task], workers: int, say: Callable[[str], None]) -> int:
    # matplotlib takes a second to import; `update` comes by here for the summary only.
    from lrbc_cli.report.drawing.png import is_current

    todo = [(chart, file) for chart, file in tasks if not is_current(chart, file)]
    if todo:
        say(f"drawing {len(todo)} figures")
    if workers > 1 and len(todo) >= _WORTH_PROCESSES:
        # Spawned: a fork would copy the threads of numerical libraries in a state of their own.
        with ProcessPoolExecutor(min(workers, len(todo)), mp_context=multiprocessing.get_context("spawn")) as pool:
            for _ in pool.map(_draw_one, todo, chunksize=8):
                pass
    else:
        for task in todo:
            _draw_one(task)
    return len(todo)


def _draw_one(task: _Task) -> None:
    from lrbc_cli.report.drawing.png import draw

    draw(*task)
