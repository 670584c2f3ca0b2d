"""All jobs of a campaign: plan, run, keep what is finished, resume by content."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lrbc_cli.campaign import cache
from lrbc_cli.campaign.documents import RESULT_FORMAT, read_json
from lrbc_cli.campaign.identify import identify
from lrbc_cli.campaign.inputs import Inputs
from lrbc_cli.campaign.judgement import scatter_of
from lrbc_cli.campaign.results import write_campaign, write_failure, write_reduction, write_result
from lrbc_cli.campaign.stage import FrfSource, ReductionStage, frf_source, obtain_reduction
from lrbc_cli.campaign.table import write_table
from lrbc_cli.errors import ConfigError, DataError, LrbcError, NumericalError
from lrbc_cli.io.atomic import file_hash

log = logging.getLogger(__name__)

#: Increased whenever the same input would be identified differently.
IDENTIFICATION_VERSION = 14


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
    """

    name: str
    run: bool
    reason: str
    identity: str


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

    def exit_code(self, fail_on_loose: bool) -> int:
        """The exit code of ``interface.md``."""
        if self.failed:
            kinds = {error.exit_code for error in self.errors.values()}
            if not self.results and len(kinds) == 1:
                return kinds.pop()
            return 5
        return 6 if fail_on_loose and self.loose else 0


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

    settings = {key: value for key, value in resolved["update"].items() if key not in ("reference", "baselines")}
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
        settings,
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


def plan(inputs: Inputs, parts: dict[str, str], names: Sequence[str], force: bool = False) -> list[JobPlan]:
    """Decide for each job whether it runs; changes nothing."""
    output = inputs.campaign.output
    reference = inputs.campaign.update.reference
    plans = []
    for name in names:
        own = identity(inputs, parts, name)
        if reference is not None and reference != name and reference in inputs.campaign.jobs:
            # Verdicts rest on the reference job too.
            rest = [] if name in inputs.campaign.update.baselines else [b for b in inputs.campaign.update.baselines if b != name]
            own = cache._digest(own, *[identity(inputs, parts, tight) for tight in (reference, *rest)])[:32]
        try:
            tree = read_json(output / name / "result.json", RESULT_FORMAT)
        except DataError as error:
            plans.append(JobPlan(name, True, f"the earlier result is unusable ({error.problem})", own))
            continue
        if tree is None:
            plans.append(JobPlan(name, True, "no result yet", own))
        elif tree["status"] == "failed":
            plans.append(JobPlan(name, True, "it failed before", own))
        elif tree.get("provenance", {}).get("identity") != own:
            plans.append(JobPlan(name, True, "its measurement, the model or the settings changed", own))
        elif not all((output / name / file).is_file() for file in ("frf.csv", "profile.csv", "fdac.csv")):
            plans.append(JobPlan(name, True, "a result file is missing", own))
        elif force:
            plans.append(JobPlan(name, True, "--force", own))
        else:
            plans.append(JobPlan(name, False, "nothing changed", own))
    return plans


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
    for name, p in plans.items():
        if not p.run:
            outcome.kept.append(name)
            outcome.results[name] = read_json(output / name / "result.json", RESULT_FORMAT) or {}
            progress(f"{name}: kept, {p.reason}")
    todo = [name for name in names if plans[name].run]
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

    def one(name: str) -> dict[str, Any]:
        before = tight_state(output, outcome, reference, stage) if reference is not None and reference != name else None
        result = identify(inputs, source, name, before)
        # A baseline does not know the others: its result must not rest on which of them is done.
        tight = 0.0 if name in campaign.update.baselines else scatter()
        return write_result(output, inputs, stage, result, plans[name].identity, before, tight)

    def scatter() -> float:
        return scatter_of(outcome.results[name] for name in campaign.update.baselines if name in outcome.results)

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
        if reference in todo:
            # The others are compared with it.
            done(str(reference), lambda: one(str(reference)))
            todo.remove(str(reference))
        # Their scatter sets the threshold of the others.
        first = [name for name in todo if name in campaign.update.baselines]
        _run_all(first, one, done, workers)
        todo = [name for name in todo if name not in first]
        _run_all(todo, one, done, workers)
    finally:
        write_table(output, list(campaign.jobs))
    return outcome, stage


def tight_state(output: Path, outcome: Outcome, reference: str, stage: ReductionStage | None) -> dict[str, Any] | None:
    """Result of the reference job: of this call, or where it failed now the one that it had before with the same reduced model."""
    if reference in outcome.results:
        return outcome.results[reference]
    try:
        before = read_json(output / reference / "result.previous.json", RESULT_FORMAT)
    except DataError:
        return None
    key = stage.decision.key if stage else None
    return before if before is not None and before["provenance"].get("certificate", {}).get("key") == key else None


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
