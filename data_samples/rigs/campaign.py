"""The campaign file of a design."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from lrbc_cli.virtual.drift import Scatter
from rigs.design import Design
from rigs.nominal import bolt_table, build, write

#: Global factors of the model that are calibrated.
FACTORS = ("stiffness.structure", "mass.acoustic", "alpha.structure", "beta.structure", "alpha.acoustic", "beta.acoustic")


def parse_jobs(design: Design, text: str | None) -> dict[str, list[str]]:
    """Removed bolts by job.

    Parameters
    ----------
    design : Design
    text : str or None
        Names of the design's jobs, ``tight:N`` for N jobs with all bolts tight, and ``B03+B09`` for a job with these removed,
        comma-separated; None: the jobs of the design. The first job has all bolts tight; the design's reference where none is asked for.

    Raises
    ------
    ValueError
        Where the text is none of these.
    """
    if text is None:
        return {job: design.removed(job) for job in design.jobs}
    jobs: dict[str, list[str]] = {}
    for item in text.split(","):
        if found := re.fullmatch(r"tight:([1-9]\d*)", item):
            jobs |= {f"tight-{k + 1}": [] for k in range(int(found[1]))}
        elif item in design.jobs:
            jobs[item] = design.removed(item)
        elif set(item.split("+")) <= set(design.bolts):
            jobs["loose-" + "-".join(item.split("+"))] = item.split("+")
        else:
            raise ValueError(
                f"'{item}' is no job: expected tight:N, bolts as B03+B09 (to B{design.bolt_count:02d}), or {', '.join(design.jobs)}"
            )
    if next(iter(jobs.values())):
        jobs = {design.reference: []} | jobs
    return jobs


def ensure_model(design: Design, folder: Path) -> None:
    """Write the nominal model unless the folder holds it.

    Raises
    ------
    ValueError
        Where the folder holds the model of another design.
    """
    ensure(folder, design.name, bolt_table(design), lambda: write(design, build(design), folder))


def ensure(folder: Path, name: str, bolts: str, make: Callable[[], object]) -> None:
    """Make a model unless the folder holds it, known by its table of bolts; raises as ``ensure_model``."""
    table = folder / "bolts.csv"
    if not (folder / "model.h5").is_file():
        make()
    elif not table.is_file() or table.read_text(encoding="utf-8") != bolts:
        raise ValueError(f"{folder} holds a model that is not that of {name}")


def nuisances_text(scatter: Scatter) -> str:
    """The settings that let an update follow what drifts between jobs; empty where nothing does."""
    known = {"temperature": scatter.kelvin, "hammer": scatter.hammer, "gain": scatter.gain}
    return ", ".join(f"{key}: {value:g}" for key, value in known.items() if value)


def group_lines(name: str, select: str) -> list[str]:
    """A parameter group along an edge."""
    return [
        f"  {name}:",
        "    kind: stiffness",
        f"    select: {select}",
        "    initial: auto",
        "    bounds: auto",
        "    smoothing: [0.333333, 0.666667, 0.333333]",
        "    damping: {initial: 0.0, bounds: [-3.0, 4.0]}",
    ]


def campaign_text(
    design: Design,
    name: str,
    model: str,
    jobs: Mapping[str, Sequence[str]],
    scatter: Scatter | None = None,
    *,
    baselines: bool = False,
    frf: str = "frf",
    hammer: str | None = None,
    groups: Mapping[str, str] | None = None,
) -> str:
    """The campaign file.

    Parameters
    ----------
    design : Design
    name : str
        Of the campaign.
    model : str
        Folder of the model, relative to the file.
    jobs : mapping of str to names of bolts
        What is removed; the first job is the reference.
    scatter : Scatter or None
        What drifts between the jobs: the update is told its standard deviations, never what was drawn.
    baselines : bool
        The second job is a further tight state, for the scatter between tight states.
    frf : str
        Folder of the measurements, relative to the file.
    hammer : str or None
        The load, where it is no node of the model.
    groups : mapping or None
        What each parameter group selects; None for the rotations along the left edge.

    Raises
    ------
    ValueError
        Where the baseline has bolts removed or no other job is left.
    """
    reference, *others = jobs
    if baselines and (len(others) < 2 or jobs[others[0]]):
        raise ValueError(f"a baseline needs a second job with all bolts tight, and a third one: found {', '.join(jobs)}")
    nuisances = nuisances_text(scatter or Scatter())
    (x0, y0, z), (_, y1) = design.plate_origin, design.plate_end
    (alpha_s, beta_s), (alpha_a, beta_a) = design.structure_damping, design.acoustic_damping

    def numbers(*values: float) -> str:
        return "[" + ", ".join(f"{round(v, 6):g}" for v in values) + "]"

    if hammer is None:
        hammer = f"{{near: {numbers(*design.hammer_point)}, component: UZ}}"
    if groups is None:
        box = ", ".join((numbers(x0 - 0.001, x0 + 0.001), numbers(y0, y1), numbers(z - 0.001, z + 0.001)))
        groups = {"left_edge": f"{{component: ROTY, box: [{box}]}}"}
    lines = [
        f"# {design.title}: a virtual rig, measured. What was drawn for it stands in truth.json, which is not read.",
        "",
        f"campaign: {name}",
        "output: output",
        "",
        "model:",
        f"  stiffness: {model}/model.h5#K",
        f"  mass: {model}/model.h5#M",
        "  damping:",
        f"    structure: {{alpha: {alpha_s:g}, beta: {beta_s:.4g}}}",
        f"    acoustic: {{alpha: {alpha_a:g}, beta: {beta_a:.4g}}}",
        f"  dofs: {model}/dofs.csv",
        "",
        "excitation:",
        f"  hammer: {hammer}",
        "",
        "responses:",
        *(f"  {mic}: {{near: {numbers(*xyz)}, component: PRES}}" for mic, xyz in design.microphones.items()),
        "",
        "parameters:",
        *(line for group, select in groups.items() for line in group_lines(group, select)),
        "",
        f"bolts: {model}/bolts.csv",
        "",
        "reduction: {band: [20.0, 400.0], tolerance: 1.0e-3}",
        "",
        "update:",
        f"  reference: {reference}",
        *([f"  baselines: [{others[0]}]"] if baselines else []),
        f"  responses: [{', '.join(design.used)}]",
        "  lines: resonances",
        "  loss: soft",
        "  loss_scale: 1.0",
        "  regularisation: auto",
        "  method: gauss-newton",
        *([f"  nuisances: {{{nuisances}}}"] if nuisances else []),
        "",
        "calibration:",
        f"  job: {reference}",
        f"  factors: [{', '.join(FACTORS)}]",
        "  groups:",
        f"    E_x: {{stiffness: {model}/model.h5#K_x}}",
        "",
        "jobs:                                     # `removed` is for the report only",
    ]
    for job, removed in jobs.items():
        known = f", removed: [{', '.join(removed)}]" if removed else ""
        lines.append(f"  {job}: {{frf: {frf}/{job}.uff{known}}}")
    return "\n".join(lines) + "\n"


def write_campaign(
    design: Design,
    folder: Path,
    model: Path,
    jobs: Mapping[str, Sequence[str]],
    scatter: Scatter | None = None,
    *,
    baselines: bool = False,
) -> None:
    """Write ``campaign.yaml`` into a folder; see ``campaign_text``."""
    try:
        where = Path(os.path.relpath(model.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        where = model.resolve().as_posix()
    text = campaign_text(design, f"{design.name}-{folder.resolve().name}", where, jobs, scatter, baselines=baselines)
    (folder / "campaign.yaml").write_text(text, encoding="utf-8", newline="\n")
