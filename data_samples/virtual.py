"""Measurement campaigns of virtual rigs, ready for ``lrbc``.

    python data_samples/virtual.py steel --seed 11 --out runs/steel
    python data_samples/virtual.py single --seed 1-50 --out runs/tight --jobs tight:4 --retorque 0.3 --kelvin 2 --hammer 0.003
    python data_samples/virtual.py twelve --figures
    python data_samples/virtual.py cover --seed 1-20 --out runs/cover

Writes campaign.yaml, frf/JOB.uff and truth.json (what was drawn; nothing reads it) into the folder, and the nominal model, which no seed
changes, into its subfolder ``model`` or where --model says. Several seeds get a folder ``seed-N`` each and share one model. See
rigs/README.md.
"""

from __future__ import annotations

import argparse
import logging
import re
import time
from pathlib import Path

from lrbc_cli.virtual.drift import Scatter
from rigs.campaign import campaign_text, ensure_model, parse_jobs, write_campaign
from rigs.designs import DESIGNS
from rigs.figures import report
from rigs.joints import campaign as joints
from rigs.joints.designs import JOINT_DESIGNS
from rigs.joints.nominal import ensure_model as ensure_joint_model
from rigs.measure import Laboratory
from rigs.options import add_drift, spread


def seeds(text: str) -> list[int]:
    """Seeds from ``7`` or ``1-50``."""
    found = re.fullmatch(r"(\d+)(?:-(\d+))?", text)
    if found is None or int(found[2] or found[1]) < int(found[1]):
        raise argparse.ArgumentTypeError(f"'{text}' is neither a seed nor a range of seeds as 1-50")
    return list(range(int(found[1]), int(found[2] or found[1]) + 1))


def write_joints(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """Campaigns of a rig whose bolts are joints; its jobs are drawn with it."""
    if arguments.out is None:
        parser.error("--out is needed")
    if arguments.jobs or arguments.baselines or arguments.figures is not None:
        parser.error(f"{arguments.design} draws its jobs, its second job is a baseline: without --jobs, --baselines and --figures")
    design, out = JOINT_DESIGNS[arguments.design], arguments.out
    model: Path = arguments.model or out / "model"
    # Nothing but the structure warms up, little enough to be left on.
    scatter = Scatter(kelvin=2.0 if arguments.kelvin is None else arguments.kelvin, hammer=arguments.hammer, gain=arguments.gain)
    try:
        ensure_joint_model(design, model)
    except ValueError as error:
        parser.error(str(error))
    for seed in arguments.seed:
        start = time.perf_counter()
        folder = out / f"seed-{seed}" if len(arguments.seed) > 1 else out
        jobs = joints.measure_campaign(
            design, seed, folder, retorque=0.3 if arguments.retorque is None else arguments.retorque, scatter=scatter
        )
        joints.write_campaign(design, folder, model, scatter)
        print(f"{folder}: {len(jobs)} jobs, {time.perf_counter() - start:.1f} s")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("design", choices=(*DESIGNS, *JOINT_DESIGNS))
    parser.add_argument("--seed", type=seeds, default=[1], metavar="N", help="a seed, or several as 1-50")
    parser.add_argument("--out", type=Path, help="folder of the campaign")
    parser.add_argument(
        "--jobs", metavar="JOBS", help="tight:4, B03+B09 or names of the design's jobs, comma-separated (all jobs of the design)"
    )
    parser.add_argument(
        "--retorque", type=spread, metavar="S", help="standard deviation of the log stiffness of tight bolts, job to job (0.08; joints 0.3)"
    )
    add_drift(parser)
    parser.set_defaults(kelvin=None)
    parser.add_argument("--baselines", action="store_true", help="the second job, all bolts tight, is a baseline and not judged")
    parser.add_argument("--model", type=Path, help="folder that holds the nominal model, or gets it")
    parser.add_argument(
        "--figures", type=Path, nargs="?", const=Path(), metavar="FRF", help="print figures of the design and stop; FRF: measurements"
    )
    arguments = parser.parse_args()
    logging.getLogger("skfem").setLevel(logging.ERROR)
    if arguments.design in JOINT_DESIGNS:
        write_joints(parser, arguments)
        return
    design = DESIGNS[arguments.design]
    if arguments.figures is not None:
        report(design, arguments.figures if arguments.figures != Path() else None)
        return
    if arguments.out is None:
        parser.error("--out is needed")
    out: Path = arguments.out
    model: Path = arguments.model or out / "model"
    scatter = Scatter(kelvin=arguments.kelvin or 0.0, hammer=arguments.hammer, gain=arguments.gain)
    try:
        jobs = parse_jobs(design, arguments.jobs)
        # Refuses a baseline that is none before anything is computed.
        campaign_text(design, design.name, "model", jobs, scatter, baselines=arguments.baselines)
        ensure_model(design, model)
    except ValueError as error:
        parser.error(str(error))
    start = time.perf_counter()
    laboratory = Laboratory(design)
    print(f"{design.name}: rig assembled, {time.perf_counter() - start:.0f} s")
    for seed in arguments.seed:
        start = time.perf_counter()
        folder = out / f"seed-{seed}" if len(arguments.seed) > 1 else out
        folder.mkdir(parents=True, exist_ok=True)
        laboratory.campaign(seed, jobs, folder / "frf", folder / "truth.json", retorque=arguments.retorque, scatter=scatter)
        write_campaign(design, folder, model, jobs, scatter, baselines=arguments.baselines)
        print(f"{folder}: {len(jobs)} jobs, {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
