"""Draws all figures and writes the page from the result files of a campaign: the last step of the chain."""

from __future__ import annotations

import dataclasses
import logging
import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, MappingProxyType

from lrbc_cli.errors import DataError, from_folder, on_one_line
from lrbc_cli.report.content import Content, FrfFigure
from lrbc_cli.report.drawing.chart import Chart
from lrbc_cli.report.drawing.shapes import fits, shapes_chart
from lrbc_cli.report.files import frf_file, replace
from lrbc_cli.report.old import outdating
from lrbc_cli.report.page import render
from lrbc_cli.report.parts.correlation import fdac_chart
from lrbc_cli.report.parts.damping import damping_chart
from lrbc_cli.report.parts.figures import channel_chart, frf_chart, profile_chart, profile_scales
from lrbc_cli.report.parts.lcurve import l_curve_chart
from lrbc_cli.report.parts.plan import plan_chart
from lrbc_cli.report.parts.strip import map_chart, strip_chart
from lrbc_cli.report.parts.structure import structure_chart, structure_page
from lrbc_cli.report.reading import read_results
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.model import CalibrationRecord, CampaignRecord, ReductionRecord
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.results.shapes import ShapesRecord
from lrbc_cli.results.store import read, write_sealed
from lrbc_cli.results.structure import StructureRecord
from lrbc_cli.results.tables import Frf, read_fdac, read_frf

log = logging.getLogger(__name__)

#: Fewer figures than this are drawn in this process: starting others takes about as long.
_WORTH_PROCESSES = 40

#: Formats of figures for print.
VECTORS = ("pdf", "svg")

_Task = tuple[Chart, Path]


def write_report(
    output: Path,
    *,
    jobs: Sequence[str] | None = None,
    expected: Sequence[str] = (),
    unusable: Mapping[str, str] = MappingProxyType({}),
    earlier: Mapping[str, str] = MappingProxyType({}),
    passed_over: Sequence[str] = (),
    workers: int = 2,
    draw: bool = True,
    figures: Sequence[str] = (),
    live: bool = False,
    halt: Callable[[], bool] = lambda: False,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Draw the figures whose content has changed and write ``report.html``, from result files only; it names jobs that cannot be read.

    Parameters
    ----------
    output
        The campaign's output folder.
    jobs, expected
        Names of the jobs to show (None: all with results), and of all jobs of the campaign file, to list those without a result.
    unusable, earlier, passed_over
        By job, errors in its files, and why its result is that of an earlier measurement; messages on files that belong to no job.
    workers
        Number of processes that draw figures.
    figures
        Formats of `VECTORS` to write beside the PNG files.
    draw
        Whether to draw the image files; without them writing takes a fraction of the time.
    live
        Whether the page reloads itself if there is a newer one.
    halt
        Polled between figures; once it is true, no further image file and no page are written.
    progress
        Called with a line of text at each step.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    ConfigError
        If a job is named that the campaign does not have.
    DataError
        If a file of the campaign is missing or damaged, no job has results that can be read, or nothing can be written.
    """
    say = progress or (lambda line: None)
    content, tasks = _contents(output, jobs, expected, draw=draw)
    content = dataclasses.replace(content, unusable=unusable, earlier=earlier, passed_over=passed_over)
    if draw:
        tasks += [(chart, file.with_suffix(f".{kind}")) for kind in figures for chart, file in tasks]
    page = output / "report.html"
    with outdating(page):
        _publish(page, content, tasks if draw else (), workers, live=live, halt=halt, say=say)
    return page


def _publish(
    page: Path, content: Content, tasks: Sequence[_Task], workers: int, *, live: bool, halt: Callable[[], bool], say: Callable[[str], None]
) -> None:
    if tasks:
        _draw_all(tasks, workers, halt, say)
    if halt():
        return
    with replace(page) as sink:
        sink.write(render(content, live=live).encode("utf-8", errors="replace"))
    say(f"{page} written")


def _contents(output: Path, jobs: Sequence[str] | None, expected: Sequence[str], *, draw: bool) -> tuple[Content, list[_Task]]:
    """Content of the page, and the charts with their files; pictures that are not on the page are left out unless `draw`."""
    found = read_results(output, jobs)
    campaign, results = found.campaign, found.jobs
    done = [job for job in results if isinstance(job, JobRecord)]
    calibration, calibration_frf = _calibration(output)
    plan = read(output / "plan.json", PlanRecord)
    structure = _structure(output)
    shapes = {} if structure is None else _shapes(output, done, structure)
    profiles, maps, channels, fdac = dict[str, Chart](), dict[str, Chart](), dict[str, Chart](), dict[str, Chart]()
    frfs, l_curves = list[FrfFigure](), dict[str, Chart]()
    content = Content(
        campaign=campaign,
        jobs=results,
        reduction=read(output / "reduction.json", ReductionRecord),
        profiles=profiles,
        frfs=frfs,
        strip=strip_chart(campaign, done),
        maps=maps,
        channels=channels,
        fdac=fdac,
        damping=damping_chart(done, paper=campaign.compare_with == "paper"),
        calibration=calibration,
        calibration_frf=calibration_frf,
        l_curves=l_curves,
        plan=plan,
        structure=structure,
        shapes=shapes,
        missing=missing_jobs(output, jobs, expected),
        unreadable={name: from_folder(on_one_line(error), output) for name, error in found.unreadable.items()},
    )
    whole = {"verdicts.png": content.strip, "damping.png": content.damping, "plan.png": None if plan is None else plan_chart(plan)}
    tasks: list[_Task] = [(chart, output / file) for file, chart in whole.items() if chart is not None]
    scales = profile_scales(done)
    tight = _reference(output, campaign, done)
    pictured = structure if draw else None
    for job in done:
        folder, table = output / job.job, read_fdac(output / job.job / "fdac.csv")
        bars = channel_chart(job)
        if bars is not None:
            channels[job.job] = bars
        charts = {
            "profile.png": (profile_chart(job, scales), profiles),
            "map.png": (map_chart(job, done), maps),
            "structure.png": (None if pictured is None else structure_chart(pictured, job, done), {}),
            "shapes.png": (None if pictured is None or job.job not in shapes else shapes_chart(pictured, shapes[job.job]), {}),
            "fdac.png": (None if table is None else fdac_chart(job, table), fdac),
            "l-curve.png": (l_curve_chart(job), l_curves),
        }
        for file, (chart, shown) in charts.items():
            if chart is not None:
                shown[job.job] = chart
                tasks.append((chart, folder / file))
        frf = read_frf(folder / "frf.csv")
        for name in frf.responses:
            response, misfit = campaign.response(name), job.misfit_db.responses.get(name)
            chart = frf_chart(job, response, frf, tight if job.job != campaign.reference else None)
            frfs.append(FrfFigure(job=job.job, response=name, used=response.used if misfit is None else misfit.used, chart=chart))
            tasks.append((chart, folder / frf_file(name)))
    return content, tasks


def _reference(output: Path, campaign: CampaignRecord, done: Sequence[JobRecord]) -> tuple[str, Frf] | None:
    """Name and FRFs of the reference job, drawn beside those of other jobs; None if it has no result or is not shown."""
    name = next((job.job for job in done if job.job == campaign.reference), None)
    return None if name is None else (name, read_frf(output / name / "frf.csv"))


def _structure(output: Path) -> StructureRecord | None:
    """Record of the structure; None if there is no picture of it."""
    record = read(output / "structure.json", StructureRecord)
    return None if record is None or record.reason is not None else record


def _shapes(output: Path, done: Sequence[JobRecord], structure: StructureRecord) -> dict[str, ShapesRecord]:
    """Deflection shapes by job, if the result lists their file and they fit the drawn nodes."""
    vouched = [job.job for job in done if "shapes.json" in (job.provenance.files or {})]
    found = {name: read(output / name / "shapes.json", ShapesRecord) for name in vouched}
    return {name: shapes for name, shapes in found.items() if shapes is not None and fits(structure, shapes)}


def write_structure(output: Path, record: StructureRecord) -> list[Path]:
    """Write ``structure.json``, and ``structure.png`` and ``structure.html`` if there is a picture.

    Parameters
    ----------
    output
        The campaign's output folder.
    record
        The structure to draw.

    Returns
    -------
    list of Path
        Picture and page; empty if there is no picture.

    Raises
    ------
    ConfigError, DataError
        If the output folder cannot be written.
    """
    from lrbc_cli.report.drawing.png import draw

    write_sealed(output / "structure.json", record)
    if record.reason is not None:
        return []
    picture, page = output / "structure.png", output / "structure.html"
    draw(structure_chart(record), picture)
    with replace(page) as sink:
        sink.write(structure_page(record).encode("utf-8", errors="replace"))
    return [picture, page]


def _calibration(output: Path) -> tuple[CalibrationRecord | None, Frf | None]:
    """The calibration and its FRFs; None with a warning if a file is damaged, since results can be shown without it."""
    try:
        calibration = read(output / "calibration.json", CalibrationRecord)
        return calibration, None if calibration is None else read_frf(output / calibration.frf)
    except DataError as error:
        log.warning("calibration.json is left out: %s (run lrbc calibrate to write it again)", error.problem)
        return None, None


def missing_jobs(output: Path, jobs: Sequence[str] | None, expected: Sequence[str]) -> list[str]:
    """Jobs of the campaign without a result; empty if single jobs are asked for by `jobs`. Raises as ``read_results``."""
    found = read_results(output, jobs)
    known = {*(job.job for job in found.jobs), *found.unreadable}
    return [] if jobs else [name for name in dict.fromkeys((*found.campaign.jobs, *expected)) if name not in known]


def _draw_all(tasks: Sequence[_Task], workers: int, halt: Callable[[], bool], say: Callable[[str], None]) -> None:
    """Draw the figures whose content has changed, in other processes if there are many."""
    # matplotlib takes a second to import, which commands that do not draw should not spend.
    from lrbc_cli.report.drawing.png import is_current

    todo = [(chart, file) for chart, file in tasks if not is_current(chart, file)]
    if todo:
        say(f"drawing {len(todo)} figures")
    if workers > 1 and len(todo) >= _WORTH_PROCESSES:
        # Spawned, because a fork would copy the state of threads of numerical libraries without the threads.
        with ProcessPoolExecutor(min(workers, len(todo)), mp_context=multiprocessing.get_context("spawn")) as pool:
            with _interruption_held_back():
                drawn = pool.map(_draw_one, todo, chunksize=8)
            for _ in drawn:
                pass
    else:
        for done, task in enumerate(todo):
            if halt():
                say(f"{done} of {len(todo)} figures drawn")
                return
            _draw_one(task)
    say(f"{len(todo)} figures drawn, {len(tasks) - len(todo)} unchanged")


@contextmanager
def _interruption_held_back() -> Iterator[None]:
    """Delay Ctrl-C until the processes have started: one that loses its parent before it has read its task prints a traceback."""
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
    if came:
        handler(*came[-1])


def _draw_one(task: _Task) -> None:
    from lrbc_cli.report.drawing.png import draw, publish

    if task[1].suffix == ".png":
        draw(*task)
    else:
        publish(*task)
