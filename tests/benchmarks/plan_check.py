"""Does `lrbc plan` promise what `lrbc update` delivers? Its probabilities against rehearsals that were drawn elsewhere, in bins.

    python tests/benchmarks/plan_check.py [--config FILE:SEEDS]... [--virtual DESIGN:SEEDS]... [--draws N] [--unmeasured]
        [--retorque S] [--override KEY.PATH=VALUE]... [--out DIR] [--json FILE] [--markdown FILE]

Each seed is a structure of its own, written by `lrbc rehearse`: the campaign's model with stiffness, mass and damping a little off, every
bolt loosened alone by 0.5, 1 and 2 decades. It is calibrated where the campaign says how, then planned from its tight job (--unmeasured:
before anything is measured), then run as by `lrbc update`. A seed has one tight job, so that its rehearsals share what is off. The changes
of tight bolts scatter as the prior says unless --retorque does. The frame sample where nothing is given; --virtual takes the models of
``data_samples/virtual.py`` (cover, lap, space-frame, flange). Exit code 1 where a bin misses its limit.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from blind import ROOT, designs
from joints import generated
from scipy.special import betaincinv

import lrbc_cli as lrbc
from lrbc_cli.campaign.planning.files import write_plan
from lrbc_cli.campaign.simulate import parse_lines
from lrbc_cli.errors import NumericalError
from lrbc_cli.updating.posterior.information import LOSSES
from lrbc_cli.virtual.campaign import declared_scatter, rehearse
from lrbc_cli.virtual.structure import Settings

BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)

#: Largest difference of what is stated and what is delivered, and rehearsals from which on a bin is judged.
APART, FEWEST = 0.1, 20


@dataclass(frozen=True)
class Comparison:
    """One rehearsal: a bolt loosened alone, what was stated for it and what was said then."""

    campaign: str
    seed: int
    bolt: str
    loss: float
    right: float
    missed: float
    alarm: float
    linearised: float
    draws: int
    verdict: str
    alarms: int
    verdicts: int
    status: str


def compare(name: str, config: Path, seed: int, work: Path, arguments: argparse.Namespace) -> list[Comparison]:
    """Rehearse one structure, plan for it, run it."""
    cache = work / "cache"
    inputs = lrbc.load(config, overrides=arguments.override, calibration=False).inputs
    assert inputs.bolts is not None
    prior = inputs.statistics.bolts
    joints = any(group.bolt is not None for group in inputs.groups)
    retorque = arguments.retorque
    if retorque is None:
        # The prior is one of changes between two jobs, and each of them scatters.
        retorque = np.log(10.0) * (prior.joint_tight_std if joints else prior.tight_std) / np.sqrt(2.0)
    reference = inputs.campaign.update.reference or "tight"
    lines = parse_lines(None, inputs.campaign.reduction.band)
    jobs = {reference: []} | {f"loose-{n}": [bolt] for n, bolt in enumerate(inputs.bolts.name)}
    own: dict[str, tuple[str, float]] = {}
    overrides = list(arguments.override)
    for k, loss in enumerate(LOSSES):
        folder = work / name / f"seed-{seed}" / f"loss-{k}"
        settings = Settings(depth=loss, retorque=float(retorque), scatter=declared_scatter(inputs))
        rehearse(inputs, cache, folder, jobs, settings=settings, seed=seed, lines=lines, replace=True)
        for job, loose in jobs.items():
            if loose:
                own[f"{job}-{k}"] = loose[0], loss
                overrides.append(f"jobs.{job}-{k}={json.dumps({'frf': (folder / 'frf' / f'{job}.uff').resolve().as_posix()})}")
    first = work / name / f"seed-{seed}" / "loss-0"
    study = lrbc.load(first / "campaign.yaml", overrides=overrides, cache=cache)
    if arguments.unmeasured:
        bare = [*arguments.override, 'output="unmeasured"']
        plan = lrbc.load(first / "campaign.yaml", overrides=bare, calibration=False, cache=cache).plan(draws=arguments.draws, seed=seed)
    if study.inputs.campaign.calibration is not None:
        study.calibrate()
    before = study.update([reference], force=True)
    if reference not in before.results:
        raise NumericalError(f"{name}, seed {seed}: the reference job failed")
    if not arguments.unmeasured:
        plan = study.plan(draws=arguments.draws, seed=seed)
    write_plan(study.inputs.campaign.output, plan)
    outcome = study.update([*own], force=True)
    stated = {(bolt.name, loss.decades): loss for bolt in plan.bolts for loss in bolt.losses if bolt.note is None}
    found = []
    for job, (bolt, loss) in own.items():
        if (bolt, loss) not in stated:
            continue
        promise = stated[bolt, loss]
        record = outcome.results.get(job)
        said = {} if record is None else {one.name: one.verdict for one in record.bolts}
        tight = [verdict for other, verdict in said.items() if other != bolt]
        found.append(
            Comparison(
                name,
                seed,
                bolt,
                loss,
                promise.right,
                promise.missed,
                promise.alarm,
                promise.linearised,
                plan.draws,
                said.get(bolt, "undecided"),
                tight.count("loose"),
                sum(verdict in ("loose", "tight") for verdict in said.values()),
                "failed" if record is None else record.status,
            )
        )
    return found


def _row(title: str, stated: Sequence[float], delivered: Sequence[bool]) -> tuple[str, bool | None]:
    """A line of a table: what is stated in the mean, what is delivered with its 95 % interval; and whether they agree."""
    n, hits = len(stated), sum(delivered)
    if not n:
        return f"| {title} | 0 | | | | |", None
    low, high = betaincinv(hits + 0.5, n - hits + 0.5, [0.025, 0.975])
    apart = hits / n - float(np.mean(stated))
    holds = None if n < FEWEST else abs(apart) <= APART
    word = "" if holds is None else "yes" if holds else "no"
    return f"| {title} | {n} | {np.mean(stated):.2f} | {hits / n:.2f} ({low:.2f} to {high:.2f}) | {apart:+.2f} | {word} |", holds


def table(found: Sequence[Comparison], stated: Callable[[Comparison], float]) -> tuple[list[str], list[bool | None]]:
    """Probabilities of a right verdict against the rate delivered, in bins and by loss."""
    lines = ["| stated | rehearsals | mean stated | delivered (95 %) | difference | within 0.1 |", "|" + " --- |" * 6]
    holds = []
    for low, high in pairwise(BINS):
        own = [one for one in found if low <= stated(one) < high or (high == 1.0 and stated(one) == 1.0)]
        line, good = _row(f"{low:.1f} to {high:.1f}", [stated(one) for one in own], [one.verdict == "loose" for one in own])
        lines.append(line)
        holds.append(good)
    for loss in LOSSES:
        own = [one for one in found if one.loss == loss]
        lines.append(_row(f"{loss:g} decades lost", [stated(one) for one in own], [one.verdict == "loose" for one in own])[0])
    return lines, holds


def report(found: Sequence[Comparison]) -> tuple[str, bool]:
    """Tables over these rehearsals, and whether every bin that can be judged holds."""
    lines, holds = table(found, lambda one: one.right)
    missed = _row("called tight", [one.missed for one in found], [one.verdict == "tight" for one in found])[0]
    alarm = _row("a tight one called loose", [one.alarm for one in found], [one.alarms > 0 for one in found])[0]
    wrong = sum(one.alarms + (one.verdict == "tight") for one in found)
    text = [*lines, missed, alarm]
    text += [
        "",
        f"{wrong} of {sum(one.verdicts for one in found)} verdicts wrong; {sum(one.status == 'unexplained' for one in found)} unexplained",
    ]
    linear, _ = table(found, lambda one: one.linearised)
    return "\n".join([*text, "", "Linearised figures instead:", "", *linear]), all(good is not False for good in holds)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", action="append", default=[], metavar="FILE:SEEDS", help="as configs/frame.yaml:1-5")
    parser.add_argument("--virtual", type=designs, action="append", default=[], metavar="DESIGN:SEEDS", help="as cover:1-5")
    parser.add_argument("--draws", type=int, metavar="N", help="of the plan, each bolt and loss (as `lrbc plan` without it)")
    parser.add_argument("--unmeasured", action="store_true", help="plan before the tight job is measured")
    parser.add_argument("--retorque", type=float, metavar="S", help="scatter of tight bolts, of the log stiffness (as the prior says)")
    parser.add_argument("--override", action="append", default=[], metavar="KEY.PATH=VALUE", help="as of lrbc")
    parser.add_argument("--out", type=Path, help="keep rehearsals and results here")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="lrbc-plan-") as scratch:
        work = (arguments.out or Path(scratch)).resolve()
        wanted: list[tuple[str, Path, int]] = []
        for text in arguments.config or ([] if arguments.virtual else [f"{ROOT / 'configs' / 'frame.yaml'}:1-2"]):
            file, _, seeds = text.rpartition(":")
            wanted += [(Path(file).stem, Path(file), seed) for seed in designs(f"x:{seeds}")[1]]
        for design, seeds in arguments.virtual:
            ((_, folder),) = generated([(design, [1])], work)
            wanted += [(design, folder / "campaign.yaml", seed) for seed in seeds]
        found: list[Comparison] = []
        for name, config, seed in wanted:
            start = time.perf_counter()
            own = compare(name, config, seed, work, arguments)
            found += own
            stated, right = np.mean([one.right for one in own]), np.mean([one.verdict == "loose" for one in own])
            print(
                f"{name} {seed}: stated {stated:.2f}, delivered {right:.2f}, {time.perf_counter() - start:.0f} s",
                file=sys.stderr,
                flush=True,
            )
            text, holds = report(found)
            if arguments.markdown:
                arguments.markdown.write_text(text + "\n", encoding="utf-8", newline="\n")
            if arguments.json:
                arguments.json.write_text(json.dumps([asdict(one) for one in found], indent=1) + "\n", encoding="utf-8", newline="\n")
    print(text)
    return 0 if holds else 1


if __name__ == "__main__":
    raise SystemExit(main())
