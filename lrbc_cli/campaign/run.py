"""All jobs of a campaign: plan, run, keep what is finished, resume by content."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lrbc_cli.campaign import cache
from lrbc_cli.campaign.documents import RESULT_FORMAT, read_json
from lrbc_cli.campaign.identify import identify
from lrbc_cli.campaign.inputs import Inputs
from lrbc_cli.campaign.judgement import scatter_of
from lrbc_cli.campaign.results import write_campaign, write_failure, write_reduction, write_result
from lrbc_cli.campaign.stage import FrfSource, ReductionStage, frf_source, obtain_reduction
from lrbc_cli.campaign.standing import TightStates, altered, findings_of, other_rests
from lrbc_cli.campaign.table import write_table
from lrbc_cli.campaign.unknowns import layout, stored_theta
from lrbc_cli.errors import ConfigError, DataError, LrbcError, NumericalError
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.updating.clearance import not_clear

log = logging.getLogger(__name__)

#: Increased whenever the same input would be identified differently.
IDENTIFICATION_VERSION = 16


@dataclass(frozen=True)
class JobPlan:
    """What would be done for one job, and why.

    Attributes
    ----------
    name : str
    run : bool
    reason : str
    identity : str
        Digest of everything the identification rests on.
    waits : bool
        What it rests on runs before it: whether it runs is decided then.
    tree : dict or None
        The finished result, where there is one to keep.
    """

    name: str
    run: bool
    reason: str
    identity: str
    waits: bool = False
    tree: dict[str, Any] | None = field(default=None, repr=False, compare=False)


@dataclass
class Outcome:
    """What happened to the jobs of one call.

    Attributes
    ----------
    results : dict
        Result tree by job, kept ones included.
    kept, failed : lists of str
    errors : dict
        The error of each failed job.
    """

    results: dict[str, dict[str, Any]] = field(default_factory=dict)
    kept: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    errors: dict[str, LrbcError] = field(default_factory=dict)

    @property
    def loose(self) -> bool:
        """Whether a bolt is judged loose in any job."""
        return any(b["verdict"] == "loose" for tree in self.results.values() for b in tree.get("bolts", []))

    @property
    def not_clear(self) -> dict[str, list[str]]:
        """What keeps these jobs from being an all-clear, by job; empty where they are one."""
        return not_clear(findings_of(self.results, [*self.results, *self.failed]))

    def exit_code(self, fail_on_loose: bool) -> int:
        """The exit code of ``interface.md``."""
        if self.failed:
            kinds = {error.exit_code for error in self.errors.values()}
            if not self.results and len(kinds) == 1:
                return kinds.pop()
            return 5
        if not fail_on_loose:
            return 0
        return 6 if self.loose else 7 if self.not_clear else 0


def identity(inputs: Inputs, parts: dict[str, str], name: str) -> str:
    """Digest of what a job's identification and verdicts rest on: model, measurement, settings; not paths, back end or workers."""
    campaign = inputs.campaign
    resolved = campaign.resolved()
    job = campaign.jobs[name]

    def contents(path: Path | None) -> str | None:
        # A file that cannot be read is the failure of its own job, when that is run.
        try:
            return None if path is None else file_hash(path)
        except DataError:
            return None

    decision = {key: resolved["update"][key] for key in ("loose_change", "confidence", "largest_misfit")}
    about = {key: value for key, value in resolved["jobs"][name].items() if key not in ("frf", "coherence", "repeats")}
    records = {key: value.get("record") for key, value in resolved["responses"].items()}
    names = [[r.name, r.quantity] for r in inputs.responses]
    groups = [{key: value for key, value in group.items() if key != "select"} for group in resolved["parameters"].values()]
    beta = [group.beta for group in inputs.groups]
    positions = [group.xyz for group in inputs.groups]
    bolts = None if inputs.bolts is None else (inputs.bolts.name, inputs.bolts.xyz.tolist())
    return cache._digest(
        IDENTIFICATION_VERSION,
        sorted(parts.items()),
        list(resolved["parameters"]),
        groups,
        beta,
        *[p for p in positions if p is not None],
        # Which terms share a value: nothing else tells where terms have no positions.
        *[group.parameter for group in inputs.groups if group.count < group.parameter.size],
        inputs.method.digest,
        decision,
        about,
        records,
        names,
        bolts,
        contents(job.frf),
        contents(job.coherence),
        [contents(file) for file in job.repeats],
        campaign.update.reference == name,
        name in campaign.update.baselines,
    )[:32]


def needs(inputs: Inputs, name: str) -> tuple[str | None, tuple[str, ...]]:
    """The reference job and the baselines that the verdicts of a job rest on."""
    update = inputs.campaign.update
    if update.reference in (None, name):
        return None, ()
    # A baseline does not know the others: its result must not rest on which of them is done.
    return update.reference, () if name in update.baselines else update.baselines


def plan(inputs: Inputs, parts: dict[str, str], names: Sequence[str], force: bool = False) -> list[JobPlan]:
    """Decide for each job whether it runs; changes nothing. Jobs come after those that they rest on, as ``choose_jobs`` orders them."""
    output = inputs.campaign.output
    plans: dict[str, JobPlan] = {}
    states = TightStates()
    for name in names:
        own = identity(inputs, parts, name)
        reference, baselines = needs(inputs, name)
        tight = [] if reference is None else [reference, *baselines]
        if tight:
            # Verdicts rest on the reference job too.
            own = cache._digest(own, *[identity(inputs, parts, other) for other in tight])[:32]
        plans[name] = JobPlan(name, True, "no result yet", own)
        try:
            tree = read_json(output / name / "result.json", RESULT_FORMAT)
        except DataError as error:
            plans[name] = replace(plans[name], reason=f"the earlier result is unusable ({error.problem})")
            continue
        if tree is not None:
            reason = _outdated(tree, name, own, output / name) or ("--force" if force else None)
            plans[name] = replace(plans[name], run=reason is not None, reason=reason or "nothing changed", tree=None if reason else tree)
        if plans[name].run or not tight:
            continue
        first = [other for other in tight if other not in plans or plans[other].run or plans[other].waits]
        if first:
            plans[name] = _waiting(plans[name], first, reference)
        else:
            kept = {other: plans[other].tree or {} for other in tight}
            plans[name] = settled(plans[name], states.rests_on(reference, kept.pop(tight[0]), kept), reference)
    return list(plans.values())


def _outdated(tree: dict[str, Any], name: str, own: str, folder: Path) -> str | None:
    """Why a stored result does not count any more by itself."""
    if tree["job"] != name:
        return f"the earlier result is unusable (it is that of job {tree['job']})"
    if tree["status"] == "failed":
        return "it failed before"
    if not tree["provenance"].get("files"):
        return "the earlier result is of an older version, without hashes of its files"
    if tree["provenance"].get("identity") != own:
        return "its measurement, the model or the settings changed"
    return altered(folder, tree)


def _waiting(job: JobPlan, first: Sequence[str], reference: str | None) -> JobPlan:
    """A finished job whose tight states run first."""
    stored = (job.tree or {})["provenance"].get("rests_on") or {"baselines": {}}
    known = {first[0]: stored.get("reference")} | stored["baselines"] if first[0] == reference else stored["baselines"]
    without = [other for other in first if known.get(other) is None]
    if without:
        return replace(job, run=True, reason=f"identified without {', '.join(without)}, which runs before it", waits=True)
    return replace(job, reason=f"unless {', '.join(first)}, which runs before it, comes out otherwise", waits=True)


def settled(job: JobPlan, now: Mapping[str, Any], reference: str | None) -> JobPlan:
    """A finished job with the tight states that there are now: kept exactly where its verdicts rest on these."""
    reason = other_rests((job.tree or {})["provenance"].get("rests_on"), now, reference)
    return replace(job, run=reason is not None, reason=reason or "nothing changed", waits=False)


def choose_jobs(inputs: Inputs, wanted: Sequence[str]) -> list[str]:
    """The jobs to run, in the campaign's order, the reference job first and added where a wanted job is compared with it.

    Raises
    ------
    ConfigError
        Where a job is unknown or there is none.
    """
    campaign = inputs.campaign
    for name in wanted:
        if name not in campaign.jobs:
            raise ConfigError(
                f"no job '{name}' in this campaign",
                file=campaign.path,
                place="--job",
                expected=", ".join(campaign.jobs) or "a job",
                found=name,
            )
    if not campaign.jobs:
        raise campaign.error("this campaign has no jobs", "jobs", expected="at least one measurement", hint="add a job: NAME: {frf: file}")
    names = [name for name in campaign.jobs if not wanted or name in wanted]
    reference = campaign.update.reference
    if reference is not None:
        baselines = [name for name in campaign.jobs if name in campaign.update.baselines]
        names = list(dict.fromkeys([reference, *baselines, *names]))
    return names


def run_jobs(
    inputs: Inputs,
    folder: Path,
    *,
    wanted: Sequence[str] = (),
    force: bool = False,
    accept: bool = False,
    workers: int = 1,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Outcome, ReductionStage | None]:
    """Run the updating jobs; a job that fails is a record, not the end.

    Parameters
    ----------
    inputs : Inputs
    folder : Path
        Of the cache.
    wanted : sequence of str
        Jobs; all where empty.
    force : bool
        Run finished jobs again.
    accept : bool
        Accept a reduced model that misses its tolerance.
    workers : int
        Jobs at a time.
    progress : callable

    Returns
    -------
    Outcome
    ReductionStage or None
        None where nothing had to run, or for full-order evaluation.
    """
    campaign = inputs.campaign
    output = campaign.output
    names = choose_jobs(inputs, wanted)
    parts = cache.key_parts(inputs)
    plans = {p.name: p for p in plan(inputs, parts, names, force)}
    outcome = Outcome()
    states = TightStates()

    def keep(p: JobPlan) -> None:
        outcome.kept.append(p.name)
        outcome.results[p.name] = p.tree or {}
        progress(f"{p.name}: kept, {p.reason}")

    for p in plans.values():
        if not p.run and not p.waits:
            keep(p)
    todo = [name for name in names if name not in outcome.results]
    write_campaign(output, inputs)
    stage: ReductionStage | None = None
    if not todo and (output / "reduction.json").is_file():
        write_table(output, list(campaign.jobs))
        return outcome, None
    if campaign.update.evaluation != "full":
        stage = obtain_reduction(inputs, folder, accept=accept, progress=progress)
        write_reduction(output, inputs, stage)
    source = frf_source(inputs, stage, progress)
    reference = campaign.update.reference

    def tight_states(name: str) -> tuple[dict[str, Any] | None, dict[str, dict[str, Any]]]:
        known, baselines = needs(inputs, name)
        before = None if known is None else tight_state(inputs, outcome, known, stage)
        return before, {other: outcome.results[other] for other in baselines if other in outcome.results}

    def one(name: str) -> dict[str, Any]:
        before, baselines = tight_states(name)
        result = identify(inputs, source, name, before)
        rests = states.rests_on(reference, before, baselines)
        return write_result(output, inputs, stage, result, plans[name].identity, before, scatter_of(baselines.values()), rests)

    def still_to_run(wanted: Sequence[str]) -> list[str]:
        """Those of them that run, now that what they rest on has run."""
        for name in wanted:
            if plans[name].waits:
                before, baselines = tight_states(name)
                plans[name] = settled(plans[name], states.rests_on(reference, before, baselines), reference)
                if not plans[name].run:
                    keep(plans[name])
        return [name for name in wanted if plans[name].run]

    def done(name: str, work: Callable[[], dict[str, Any]]) -> None:
        try:
            tree = work()
        except LrbcError as error:
            outcome.failed.append(name)
            outcome.errors[name] = error
            write_failure(output, inputs, name, error.message, plans[name].identity)
            progress(f"{name}: failed")
        except Exception as error:
            # A defect in one job must not take the others with it; the traceback is in the log.
            log.debug("job %s", name, exc_info=True)
            failure = NumericalError(f"job {name}: {type(error).__name__}: {error}")
            outcome.failed.append(name)
            outcome.errors[name] = failure
            write_failure(output, inputs, name, failure.message, plans[name].identity)
            progress(f"{name}: failed")
        else:
            outcome.results[name] = tree
            misfit = tree["misfit_db"]
            progress(
                f"{name}: {tree['status']}, misfit {misfit['initial']:.2f} -> {misfit['final']:.2f} dB, {tree['seconds']['total']:.1f} s"
            )

    try:
        # The others are compared with it; then the baselines, whose scatter sets the threshold of the others.
        first = [name for name in todo if name == reference]
        second = [name for name in todo if name in campaign.update.baselines]
        for wanted_now in (first, second, [name for name in todo if name not in (*first, *second)]):
            _run_all(still_to_run(wanted_now), one, done, workers)
        outcome.kept.sort(key=names.index)
    finally:
        write_table(output, list(campaign.jobs))
    return outcome, stage


def tight_state(inputs: Inputs, outcome: Outcome, reference: str, stage: ReductionStage | None) -> dict[str, Any] | None:
    """Result of the reference job: of this call, or where it failed now the one that it had before with the same reduced model."""
    if reference in outcome.results:
        return outcome.results[reference]
    try:
        before = read_json(inputs.campaign.output / reference / "result.previous.json", RESULT_FORMAT)
    except DataError:
        return None
    # Of other parameter groups it has no state to compare with, and a change of which nothing is known is not zero.
    if before is None or stored_theta(layout(inputs), before) is None:
        return None
    key = stage.decision.key if stage else None
    return before if (before["provenance"].get("certificate") or {}).get("key") == key else None


def _run_all(
    names: list[str], one: Callable[[str], dict[str, Any]], done: Callable[[str, Callable[[], dict[str, Any]]], None], workers: int
) -> None:
    if workers < 2 or len(names) < 2:
        for name in names:
            done(name, lambda name=name: one(name))  # type: ignore[misc]
        return
    # Threads serve: the time goes into dense linear algebra, which releases the interpreter.
    pool = ThreadPoolExecutor(min(workers, len(names)))
    pending: dict[Future[dict[str, Any]], str] = {pool.submit(one, name): name for name in names}
    try:
        while pending:
            finished, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in finished:
                done(pending.pop(future), future.result)
    finally:
        pool.shutdown(cancel_futures=True)


__all__ = ["FrfSource", "JobPlan", "Outcome", "choose_jobs", "identity", "plan", "run_jobs"]
