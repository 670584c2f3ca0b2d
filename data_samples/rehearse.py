"""Rehearse a campaign on your own model: measurements with bolts loosened, before any are made.

    python data_samples/rehearse.py my/campaign.yaml --out runs/rehearsal --tight 2 --loose B03,B04 --loose B09
    lrbc update runs/rehearsal/campaign.yaml

Takes any campaign file that lrbc reads; its own FRF files need not exist. The model is made a little wrong first (--perturb, --damping), so
that nothing is identified from its own equations; then the stiffness along the edge is lowered around loose bolts, and a hammer, noise
and what drifts between jobs are drawn. Writes campaign.yaml, frf/JOB.uff and truth.json (nothing reads it). See rigs/README.md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from lrbc_cli.campaign.cache import cache_folder
from lrbc_cli.campaign.inputs import read_as_exported
from lrbc_cli.campaign.simulate import parse_lines
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import ConfigError, LrbcError
from rigs.drift import Scatter
from rigs.options import add_drift, spread
from rigs.rehearsal import Rehearsal, Settings, job_list, rehearse


def count(text: str) -> int:
    """A number of jobs."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("one job with all bolts tight is the reference")
    return value


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder of the rehearsal")
    parser.add_argument("--loose", action="append", default=[], metavar="B03,B04", help="a job with these bolts loose; repeatable")
    parser.add_argument("--tight", type=count, default=1, metavar="N", help="jobs with all bolts tight (1)")
    parser.add_argument(
        "--depth", type=spread, default=Settings.depth, metavar="DECADES", help="stiffness that a loose bolt takes away (2)"
    )
    parser.add_argument("--reach", type=spread, metavar="M", help="radius of a bolt's patch along the edge (half the pitch)")
    parser.add_argument("--level", type=float, metavar="LOG10", help="stiffness of a tight term (the campaign's start value)")
    parser.add_argument("--noise", type=spread, default=Settings.noise, metavar="S", help="of a response line, relative to its rms (0.004)")
    parser.add_argument(
        "--retorque", type=spread, default=Settings.retorque, metavar="S", help="std of log stiffness of tight bolts (0.08)"
    )
    parser.add_argument(
        "--perturb", type=spread, default=Settings.perturb, metavar="S", help="std of stiffness, mass and air factors (0.005)"
    )
    parser.add_argument("--damping", type=spread, default=Settings.damping, metavar="S", help="std of the log of damping factors (0.1)")
    add_drift(parser)
    parser.add_argument("--lines", metavar="20:400:1", help="lines of the measurement [Hz] (1 Hz lines of the band)")
    parser.add_argument("--override", action="append", default=[], metavar="KEY.PATH=VALUE", help="as of lrbc")
    parser.add_argument("--cache", type=Path, help="as of lrbc")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    settings = Settings(
        depth=given.depth,
        reach=given.reach,
        level=given.level,
        noise=given.noise,
        retorque=given.retorque,
        perturb=given.perturb,
        damping=given.damping,
        scatter=Scatter(given.kelvin, given.hammer, given.gain),
    )
    try:
        inputs = read_as_exported(load_campaign(given.config, given.override))
        band = inputs.campaign.reduction.band
        lines = parse_lines(given.lines, band)
        if lines[0] < band[0] * (1 - 1e-9) or lines[-1] > band[1] * (1 + 1e-9):
            raise ConfigError(
                "the reduced model does not hold outside its band",
                place=f"--lines {given.lines}",
                expected=f"{band[0]:g} to {band[1]:g} Hz",
            )
        jobs = job_list(inputs, given.tight, given.loose)
        rehearsal = Rehearsal(inputs, settings, given.seed, cache_folder(given.cache), lines, lambda _: None)
        rehearse(rehearsal, jobs, given.out)
    except LrbcError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    print(f"{given.out}: {len(jobs)} jobs, {lines.size} lines, {len(inputs.responses)} responses")
    print(f"lrbc update {given.out / 'campaign.yaml'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
