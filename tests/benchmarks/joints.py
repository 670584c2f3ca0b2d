"""Are loose joints found on structures of other kinds? Verdicts, intervals, fits and times on rigs whose truth is known.

    python tests/benchmarks/joints.py [--virtual DESIGN:SEEDS]... [--plan [DRAWS]] [--override KEY.PATH=VALUE]... [--workers N]
        [--out DIR] [--resume] [--json FILE] [--markdown FILE]
    python tests/benchmarks/joints.py --exact [--virtual DESIGN:SEEDS]... [--states N]

Campaigns of ``data_samples/virtual.py`` (cover, lap, space-frame, flange): calibrated, identified and judged through the Python face of
the installed program, which sees no truth. Seeds 1 to 20 are for choosing; 501 to 540 for judging, once. --plan asks ``lrbc plan`` which
joints are detectable; without it all count. --exact asks another question, of the nominal models themselves: measurements that they
compute, without noise, in states drawn anew; the cost at the end must not lie above that at the truth. Exit code 1 where a figure
misses its limit.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from blind import Task, add_options, designs, in_processes, pooled_table, results_of, runs, shown
from scores import Figure

from lrbc_cli import load
from lrbc_cli.updating.unknowns.shapes import joints_of

ROOT = Path(__file__).resolve().parents[2]
DESIGNS = ("cover", "lap", "space-frame", "flange")

#: Decades lost from which a joint has to be found, and from which it is wrong to call it tight.
FOUND, LOOSE = 1.0, 0.5

#: Misfit of a reference job that counts as explained [dB].
EXPLAINED_DB = 2.0

#: Cost at the end over that at the truth that counts as reached.
REACHED = 1.01


@dataclass(frozen=True)
class JointScore:
    """One joint of one job.

    Attributes
    ----------
    joint : str
    lost : float
        By the truth [decades]; 0 for a tight one.
    truth : float
        Change of log10 stiffness against the reference job, re-torque scatter included.
    change, low, high : float or None
        As identified, with its 95 % interval.
    probability : float or None
    verdict : str
    detectable : bool
        As planned.
    """

    joint: str
    lost: float
    truth: float
    change: float | None
    low: float | None
    high: float | None
    probability: float | None
    verdict: str
    detectable: bool = True

    @property
    def wrong(self) -> bool:
        """Tight and called loose, or loose by half a decade and called tight."""
        return (self.verdict == "loose" and not self.lost) or (self.verdict == "tight" and self.lost >= LOOSE)

    @property
    def covered(self) -> bool | None:
        """Whether the interval, which may be open below, holds the truth; None without one."""
        return None if self.high is None else (self.low is None or self.low <= self.truth) and self.truth <= self.high


@dataclass(frozen=True)
class StateScore:
    """One job; misfits of the responses used and held out [dB], costs, and the reference job's misfit."""

    campaign: str
    job: str
    status: str
    role: str
    joints: tuple[JointScore, ...]
    reference_db: float
    used_db: float | None = None
    held_out_db: float | None = None
    cost_initial: float | None = None
    cost: float | None = None
    evaluations: int = 0
    seconds: float | None = None
    reason: str = ""

    @property
    def design(self) -> str:
        """The campaign's name is DESIGN-SEED."""
        return self.campaign.rsplit("-", 1)[0]


def score_state(
    campaign: str, tree: Mapping[str, Any], reference: Mapping[str, Any], truth: Mapping[str, Any], role: str, seen: Mapping[str, bool]
) -> StateScore:
    """Compare ``result.json`` of a job with the truth; `reference` serves for names and misfit, `seen` tells what is detectable."""
    failed = tree["status"] == "failed"
    judged = {bolt["name"]: bolt for bolt in tree.get("bolts") or ()}
    joints = []
    for name, change in truth["change"].items():
        bolt = judged.get(name, {})
        value, std = bolt.get("change"), bolt.get("change_std")
        interval = bolt.get("change_interval95")
        if interval is None:
            interval = (None, None) if value is None or std is None else (value - 1.96 * std, value + 1.96 * std)
        lost = truth["lost"].get(name, 0.0)
        verdict = bolt.get("verdict", "undecided")
        joints.append(JointScore(name, lost, change, value, *interval, bolt.get("probability_loose"), verdict, seen.get(name, True)))
    # A reference job that is unexplained itself is explained within no limit.
    known = math.inf if reference["status"] == "unexplained" else reference["misfit_db"]["final"]
    if failed:
        return StateScore(campaign, tree["job"], "failed", role, tuple(joints), known, reason=tree["reason"])
    misfit, cost = tree["misfit_db"], tree["cost"]
    return StateScore(
        campaign,
        tree["job"],
        tree["status"],
        role,
        tuple(joints),
        known,
        misfit["final"],
        misfit["held_out_final"],
        cost["initial"],
        cost["final"],
        int(tree["evaluations"]),
        float(tree["seconds"]["total"]),
    )


def run_campaign(task: Task, draws: int | None) -> tuple[list[StateScore], float | None]:
    """Run a campaign and compare it with its truth; and the misfit of its calibration [dB]."""
    found = results_of(task)
    seen = {}
    if draws is not None:
        seen = {bolt.name: bolt.verdict == "detectable" for bolt in found.study.plan(draws=draws).bolts}
    before = found.trees[found.reference]
    scores = [score_state(task.name, tree, before, found.truth[job], found.roles[job], seen) for job, tree in found.trees.items()]
    return scores, None if found.calibration is None else found.calibration.misfit


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def figures(states: Sequence[StateScore]) -> list[Figure]:
    """All figures over these jobs, of one design or pooled."""
    judged = [s for s in states if s.role == "judged"]
    every = [joint for state in judged for joint in state.joints]
    found: list[Figure] = []

    def add(key: str, title: str, value: float | None, limit: float | None, at_least: bool = True, **counts: int) -> None:
        found.append(Figure(key, title, value, limit, at_least, counts))

    def caught(key: str, title: str, joints: Sequence[JointScore], limit: float | None) -> None:
        count = {word: sum(j.verdict == word for j in joints) for word in ("loose", "undecided", "tight")}
        add(key, title, _share(count["loose"], len(joints)), limit, **count)

    caught("caught", "lost a decade or more and detectable: judged loose", [j for j in every if j.lost >= FOUND and j.detectable], 0.95)
    caught("caught_any", "lost a decade or more: judged loose", [j for j in every if j.lost >= FOUND], None)
    caught("caught_half", "lost half a decade to one: judged loose", [j for j in every if LOOSE <= j.lost < FOUND], None)
    verdicts = [j for j in every if j.verdict in ("loose", "tight")]
    wrong = [j for j in verdicts if j.wrong]
    alarms = sum(j.verdict == "loose" for j in wrong)
    share = _share(len(wrong), len(verdicts))
    add("wrong", "wrong among verdicts", share, 0.005, False, wrong=len(wrong), verdicts=len(verdicts), tight_called_loose=alarms)
    tight = [j for j in every if not j.lost]
    decided = sum(j.verdict == "tight" for j in tight)
    add("tight", "tight joints judged tight", _share(decided, len(tight)), None, tight=decided, joints=len(tight))
    explained = [s for s in judged if s.reference_db <= EXPLAINED_DB]
    lost = sum(s.status in ("unexplained", "failed") for s in explained)
    add("unexplained", "unexplained beside an explained reference", _share(lost, len(explained)), 0.01, False, jobs=lost, of=len(explained))
    known = [j for s in judged if s.status != "unexplained" for j in s.joints if j.covered is not None]
    covered = sum(bool(j.covered) for j in known)
    add("coverage", "95 % intervals of the change that hold the truth", _share(covered, len(known)), 0.90, hold=covered, joints=len(known))
    add("coverage_most", "the same, at most", _share(covered, len(known)), 0.99, False, hold=covered, joints=len(known))
    loose = [j for j in known if j.lost]
    of_loose = sum(bool(j.covered) for j in loose)
    add("coverage_loose", "the same, loose joints", _share(of_loose, len(loose)), None, hold=of_loose, joints=len(loose))
    errors = [abs((j.change or 0.0) - j.truth) for j in known]
    add("error", "median error of the change [decades]", float(np.median(errors)) if errors else None, None, joints=len(errors))
    worse = sum(s.cost > s.cost_initial * (1 + 1e-9) for s in states if s.cost is not None and s.cost_initial is not None)
    add("worse", "jobs that end above their start", float(worse), 0.0, False, jobs=len(states))
    for key, title, values in (
        ("reference_db", "misfit of the reference jobs [dB]", [s.used_db for s in states if s.role == "reference"]),
        ("used_db", "misfit of the others [dB]", [s.used_db for s in states if s.role != "reference"]),
        ("held_out_db", "the same, held out [dB]", [s.held_out_db for s in states if s.role != "reference"]),
    ):
        numbers = [v for v in values if v is not None]
        add(key, title, float(np.mean(numbers)) if numbers else None, None, jobs=len(numbers))
    seconds = [s.seconds for s in states if s.seconds is not None]
    add("seconds", "longest identification [s]", max(seconds) if seconds else None, 4.0, False, jobs=len(seconds))
    return found


def job_table(states: Sequence[StateScore]) -> str:
    """One row a job."""
    heading = ["campaign", "job", "status", "lost", "dB used", "dB held out", "caught", "undecided", "wrong", "covered", "evaluations", "s"]
    lines = ["| " + " | ".join(heading) + " |", "|" + " --- |" * len(heading)]
    for s in states:
        gone = [j for j in s.joints if j.lost]
        cells = [s.campaign, s.job, s.status, ", ".join(f"{j.joint} {j.lost:.1f}" for j in gone), shown(s.used_db), shown(s.held_out_db)]
        cells += [f"{sum(j.verdict == 'loose' for j in gone)} of {len(gone)}" if gone else ""]
        cells += [str(sum(j.verdict == "undecided" for j in s.joints)) if s.role == "judged" else s.role]
        cells += [", ".join(f"{j.joint} {j.verdict} {shown(j.probability)}" for j in s.joints if j.wrong) if s.role == "judged" else ""]
        known = [j.covered for j in s.joints if j.covered is not None]
        lines.append("| " + " | ".join([*cells, f"{sum(known)} of {len(known)}", str(s.evaluations), shown(s.seconds)]) + " |")
    return "\n".join([*lines, *(f"\n{s.campaign}, {s.job}: {s.reason}" for s in states if s.reason)])


def exact_costs(task: Task, seed: int, count: int) -> list[dict[str, Any]]:
    """Identify states of the nominal model from its own FRFs, and compare the costs at the end and at the truth.

    One to half of the joints have lost 0.3 to 3 decades, in all components alike.
    """
    study = load(task.folder / "campaign.yaml", calibration=False, cache=task.cache, overrides=task.overrides)
    update, bolts = study.inputs.campaign.update, study.inputs.bolts
    assert bolts is not None
    low, high = study.inputs.campaign.reduction.band
    hz = np.arange(low, high + 0.5)
    parameters = study.parameters(hz)
    theta = np.array(parameters.initial)
    at = [np.concatenate(list(values.values())) for values in joints_of(parameters, bolts.xyz.shape[0])]
    name = str(update.reference)
    reference = study.identify(name, study.measurement(hz, study.frf(hz, theta)))
    rng = np.random.default_rng([seed, 13])
    found = []
    for k in range(count):
        loose = rng.choice(len(at), rng.integers(1, len(at) // 2 + 1), replace=False)
        truth = theta.copy()
        for joint in loose:
            truth[at[joint]] -= rng.uniform(0.3, 3.0)
        job = f"state-{k + 1}"
        measured = study.measurement(hz, study.frf(hz, truth))
        begin = time.perf_counter()
        fit = study.fit(job, measured, reference=reference)
        end = fit.misfit(_extended(fit, fit.solution.theta)).total
        ideal = fit.misfit(_extended(fit, truth, drifted=False)).total
        found.append({"campaign": task.name, "loose": len(loose), "ratio": end / ideal, "seconds": time.perf_counter() - begin})
    return found


def _extended(fit: Any, theta: np.ndarray, *, drifted: bool = True) -> np.ndarray:
    """Theta with what drifted: as found, or nothing."""
    values = fit.knowledge.values
    return np.concatenate([theta, values if drifted else np.zeros(len(values))])


def exact_figures(runs_: Sequence[Mapping[str, Any]]) -> list[Figure]:
    """Share of the states whose cost at the end is at most ``REACHED`` times that at the truth."""
    ratios = np.array([run["ratio"] for run in runs_])
    hit = int(np.sum(ratios <= REACHED))
    longest = max(run["seconds"] for run in runs_)
    return [
        Figure(
            "reached",
            f"cost at most {REACHED:g} times that at the truth",
            hit / ratios.size,
            0.995,
            True,
            {"hit": hit, "states": ratios.size},
        ),
        Figure("largest", "largest ratio of the costs", float(ratios.max()), None, False, {}),
        Figure("seconds", "longest identification [s]", longest, 4.0, False, {}),
    ]


def generated(wanted: Sequence[tuple[str, list[int]]], work: Path) -> list[tuple[str, Path]]:
    """Write the campaigns; names and folders."""
    found = []
    for design, seeds in wanted:
        out = work / "virtual" / design
        for first, last in runs(seeds):
            place = out if last > first else out / f"seed-{first}"
            if not all((out / f"seed-{seed}" / "campaign.yaml").is_file() for seed in range(first, last + 1)):
                options = ["--seed", f"{first}-{last}", "--out", str(place), "--model", str(out / "model")]
                script = [sys.executable, str(ROOT / "data_samples" / "virtual.py"), design, *options]
                subprocess.run(script, check=True, env=dict(os.environ), stdout=sys.stderr)
        found += [(f"{design}-{seed}", out / f"seed-{seed}") for seed in seeds]
    return found


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--virtual", type=designs, action="append", metavar="DESIGN:SEEDS", help="as cover:1-5 (seed 1 of every design)")
    parser.add_argument("--exact", action="store_true", help="states of the nominal models themselves, without noise")
    parser.add_argument("--states", type=int, default=75, metavar="N", help="of each campaign, with --exact (75)")
    parser.add_argument("--plan", type=int, nargs="?", const=0, metavar="DRAWS", help="detectable is what `lrbc plan` calls so (0 draws)")
    add_options(parser)
    arguments = parser.parse_args()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="lrbc-joints-") as scratch:
        work: Path = arguments.out or Path(scratch)
        wanted = arguments.virtual or [(design, [1]) for design in DESIGNS]
        override = tuple(arguments.override)
        tasks = [
            Task(name, folder, folder / "campaign.yaml", work / "results" / name, work / "cache", override, True, arguments.resume)
            for name, folder in generated(wanted, work)
        ]
        parts, document = [], {}
        if arguments.exact:
            calls = [(task, int(task.name.rsplit("-", 1)[1]), arguments.states) for task in tasks]
            exact, failures = in_processes(exact_costs, calls, arguments.workers)
            all_runs = [run for found in exact.values() for run in found]
            pooled = exact_figures(all_runs)
            by_campaign = {name: exact_figures(found) for name, found in exact.items()}
            document = {"states": all_runs}
        else:
            scored, failures = in_processes(run_campaign, [(task, arguments.plan) for task in tasks], arguments.workers)
            states = [state for found, _ in scored.values() for state in found]
            pooled = figures(states)
            names = dict.fromkeys(state.design for state in states)
            by_campaign = {name: figures([s for s in states if s.design == name]) for name in names}
            calibrated = {name: misfit for name, (_, misfit) in scored.items()}
            parts.append(job_table(states))
            parts.append("Misfit of the calibration [dB]: " + ", ".join(f"{name} {shown(misfit)}" for name, misfit in calibrated.items()))
            document = {"jobs": [asdict(state) for state in states], "calibrations": calibrated}
    parts.insert(0, pooled_table(pooled, by_campaign))
    if failures:
        parts.append("Campaigns that failed:\n\n" + "\n".join(f"- {name}: {reason}" for name, reason in failures.items()))
    text = "\n\n".join(parts) + "\n"
    print(f"{text}\n{time.perf_counter() - start:.0f} s in all")
    if arguments.markdown:
        arguments.markdown.write_text(text, encoding="utf-8", newline="\n")
    if arguments.json:
        document |= {
            "overrides": arguments.override,
            "pooled": [asdict(figure) | {"holds": figure.holds} for figure in pooled],
            "by_design": {name: [asdict(f) | {"holds": f.holds} for f in found] for name, found in by_campaign.items()},
            "failures": failures,
        }
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")
    return 1 if failures or any(figure.holds is False for figure in pooled) else 0


if __name__ == "__main__":
    raise SystemExit(main())
