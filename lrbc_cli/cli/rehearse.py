"""The command ``lrbc rehearse``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from lrbc_cli.campaign.simulate import parse_lines
from lrbc_cli.cli.common import cache_folder, load, progress, say_json
from lrbc_cli.cli.options import campaign_options, lines_option
from lrbc_cli.cli.terminal import say, typed
from lrbc_cli.config.skeleton import FILE
from lrbc_cli.study import Study
from lrbc_cli.virtual.campaign import RECORD, declared_scatter, job_list
from lrbc_cli.virtual.structure import Settings

STD = click.FloatRange(min=0.0, max=1e3)
DECLARED = ". Default: as in `update.nuisances`."


@click.command()
@campaign_options
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder to write the rehearsal to.")
@click.option(
    "--loose",
    multiple=True,
    metavar="B03,B04",
    help="A job with these bolts loose; repeatable. Without --loose and --tight: one job with one bolt, drawn by --seed.",
)
@click.option(
    "--tight",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of jobs with all bolts tight (default: 1); the first is the reference job.",
)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of all random draws.")
@click.option(
    "--noise",
    type=STD,
    default=Settings.noise,
    show_default=True,
    metavar="S",
    help="Noise per line, relative to the rms of the response.",
)
@click.option("--depth", type=STD, default=Settings.depth, show_default=True, metavar="DECADES", help="Loss of stiffness of a loose bolt.")
@click.option("--reach", type=STD, metavar="M", help="Radius of a bolt's patch along the edge. Default: half the bolt pitch.")
@click.option("--level", type=float, metavar="LOG10", help="Stiffness of a tight term. Default: the start value of the campaign.")
@click.option(
    "--retorque",
    type=STD,
    default=Settings.retorque,
    show_default=True,
    metavar="S",
    help="Scatter of the log stiffness of tight bolts from job to job.",
)
@click.option(
    "--perturb", type=STD, default=Settings.perturb, show_default=True, metavar="S", help="Errors of the stiffness and mass of the model."
)
@click.option("--damping", type=STD, default=Settings.damping, show_default=True, metavar="S", help="Error of the log of the damping.")
@click.option("--temperature", type=STD, metavar="K", help=f"Drift of the air temperature between jobs{DECLARED}")
@click.option("--hammer", type=STD, metavar="M", help=f"Drift of the hammer point along the surface{DECLARED}")
@click.option("--gain", type=STD, metavar="DB", help=f"Drift of the gain of each response{DECLARED}")
@lines_option
@click.option("--force", is_flag=True, help="Replace the files of an earlier rehearsal.")
def rehearse(
    *,
    config: Path,
    overrides: tuple[str, ...],
    cache: Path | None,
    as_json: bool,
    out: Path,
    loose: tuple[str, ...],
    tight: int | None,
    seed: int,
    temperature: float | None,
    hammer: float | None,
    gain: float | None,
    lines: str | None,
    force: bool,
    **settings: Any,
) -> None:
    """Write a campaign of simulated measurements: your own model, slightly changed, with noise, drift and loose bolts.

    Run this campaign before any test. The FRF files of CONFIG need not exist. Values of S, K, M and DB for errors, scatter, noise and
    drift are standard deviations of what is drawn for each rehearsal or job.
    """
    # Without a stored calibration, which belongs to other measurements.
    inputs = load(config, overrides, own_output=False, calibration=None)
    jobs = job_list(inputs, loose, tight, seed)
    given: dict[str, Any] = {"kelvin": temperature, "hammer": hammer, "gain": gain}
    scatter = replace(declared_scatter(inputs), **{name: std for name, std in given.items() if std is not None})
    hz = parse_lines(lines, inputs.campaign.reduction.band)
    study = Study(inputs, cache_folder(cache), progress())
    record = study.rehearse(out, jobs, settings=Settings(**settings, scatter=scatter), seed=seed, hz=hz, force=force)
    if as_json:
        say_json({"file": out / FILE, "record": out / RECORD} | record.tree())
    else:
        for job, removed in jobs.items():
            say(f"{job}: {', '.join(removed) + ' loose' if removed else 'all bolts tight'}")
        say(f"what was drawn: {out / RECORD}")
        say(f"next: {typed('lrbc', 'update' if inputs.campaign.calibration is None else 'run', out / FILE)}")
