"""Runs the jobs of a campaign for ``lrbc update``: identifies, judges anew or keeps each, reference job and baselines first."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import replace
from functools import partial
from pathlib import Path

from lrbc_cli.campaign.beside import unnamed, unseen
from lrbc_cli.campaign.identification.compared.copies import Originals
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.identification.unknowns import layout, theta_of
from lrbc_cli.campaign.jobs.finished import finish, origin_of
from lrbc_cli.campaign.jobs.identity import Copied, compared_jobs, measured
from lrbc_cli.campaign.jobs.judging import ComparedWith
from lrbc_cli.campaign.jobs.plans import JobPlan, choose_jobs, needs, other_findings, plan, settled
from lrbc_cli.campaign.jobs.rejudge import judge_one, keep
from lrbc_cli.campaign.jobs.remote import Cluster
from lrbc_cli.campaign.jobs.results import write_campaign, write_failure, write_reduction, write_result
from lrbc_cli.campaign.jobs.standing import Outcome, rests_on
from lrbc_cli.campaign.jobs.table import write_table
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.stage import FrfSource, ReductionStage, obtain_source, with_rows
from lrbc_cli.campaign.structure import structure_of
from lrbc_cli.errors import DataError, LrbcError, NumericalError, on_one_line
from lrbc_cli.io.atomic import changed_meanwhile, remove_leftovers
from lrbc_cli.reduction.threads import sharing
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.store import read_job, sealed, write

log = logging.getLogger(__name__)


def run_jobs(
    inputs: Inputs,
    folder: Path,
    *,
    wanted: Sequence[str] = (),
    missing: Collection[str] = (),
    source: FrfSource | None = None,
    force: bool = False,
    accept: bool = False,
    workers: int = 1,
    remote: Cluster | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Outcome, ReductionStage | None]:
    """Run the jobs of a campaign; a job that fails is recorded, and the others go on.

    Parameters
    ----------
    inputs : Inputs
    folder : Path
        Folder of the cache of reduced models.
    wanted : sequence of str
        Jobs to run, with the reference job and the baselines added; all if empty.
    missing : collection of str
        Jobs that are not measured yet: they are left out, even if others depend on them.
    source : FrfSource or None
        FRFs of this model from an earlier call; None: from the cache, or reduced now.
    force : bool
        Identify finished jobs again.
    accept : bool
        Accept a reduced model that misses its tolerance.
    workers : int
        Number of jobs at a time.
    remote : Cluster or None
        Its workers identify the jobs, as many at a time as it has slots; None: this process.
    progress : callable
        Receives one line of text per step.

    Returns
    -------
    Outcome
    ReductionStage or None
        None if nothing had to run, or for full-order evaluation.
    """
    names = [name for name in choose_jobs(inputs.campaign, wanted) if name not in missing]
    parts = cache.key_parts(inputs) if source is None else source.parts
    outcome, stage = _Run(inputs, folder, plan(inputs, parts, names, force), progress, remote).all(accept, workers, source)
    outcome.unseen = unseen(inputs.campaign)
    outcome.beside = [] if wanted else unnamed(inputs.campaign)
    if source is None:
        # `lrbc watch`, which calls this for each job, knows the findings of the others.
        outcome.others = other_findings(inputs.campaign, outcome.findings)
    return outcome, stage


class _Run:
    """State that the jobs of one call share: plans, outcome so far, reduced model, seconds taken."""

    def __init__(
        self, inputs: Inputs, folder: Path, plans: Sequence[JobPlan], progress: Callable[[str], None], remote: Cluster | None
    ) -> None:
        self.inputs, self.folder, self.progress, self.remote = inputs, folder, progress, remote
        self.output = inputs.campaign.output
        self.names = [p.name for p in plans]
        self.plans = {p.name: p for p in plans}
        self.originals = Originals(inputs)
        self.outcome = Outcome()
        self.stage: ReductionStage | None = None
        self.workers = 1
        self.taken: list[float] = []
        self.told = False

    def all(self, accept: bool, workers: int, source: FrfSource | None) -> tuple[Outcome, ReductionStage | None]:
        """Run, judge anew or keep all jobs, those first on which others depend."""
        self.workers = workers if self.remote is None else self.remote.slots
        campaign, outcome = self.inputs.campaign, self.outcome
        for p in self.plans.values():
            if p.kept:
                keep(p, outcome, self.progress)
        todo = [name for name in self.names if name not in outcome.results]
        for folder in (self.output, self.output / "calibration", *(self.output / name for name in campaign.jobs)):
            remove_leftovers(folder)
        # campaign.json is written last: it holds the hash of structure.json.
        drawn = write(self.output / "structure.json", sealed(structure_of(self.inputs)))
        write_campaign(self.output, self.inputs, {"structure.json": drawn})
        if source is not None:
            source = replace(source, inputs=self.inputs, progress=self.progress)
        elif any(self.plans[name].run or self.plans[name].waits for name in todo) or not (self.output / "reduction.json").is_file():
            source = obtain_source(self.inputs, self.folder, accept=accept, progress=self.progress)
        self.stage = None if source is None else source.stage
        if self.stage is not None:
            write_reduction(self.output, self.inputs, self.stage)
            self.stage, lacking = with_rows(self.inputs, self.stage)
            if lacking:
                log.warning("no deflection shapes: %s (`lrbc reduce --force` keeps it)", lacking)
        try:
            # All others are compared with the reference job; the scatter of the baselines sets the threshold of the rest.
            first = [name for name in todo if name == campaign.update.reference]
            second = [name for name in todo if name in campaign.update.baselines]
            for wanted_now in (first, second, [name for name in todo if name not in (*first, *second)]):
                run = [name for name in wanted_now if self._still_to_run(name)]
                if wanted_now is not first and run:
                    self._tell_unexplained()
                if source is not None:
                    self._run(run, source)
            outcome.kept.sort(key=self.names.index)
        finally:
            write_table(self.output, list(campaign.jobs), outcome.results)
        return outcome, self.stage

    def _tell_unexplained(self) -> None:
        """Warn, before minutes are spent on further jobs, that none of them will be judged."""
        name = self.inputs.campaign.update.reference
        tight = None if name is None else self.outcome.results.get(name)
        if tight is not None and tight.status == "unexplained" and not self.told:
            self.told, misfit = True, tight.misfit_db
            log.warning(
                "the reference job %s is unexplained (misfit %.2f dB), so no job will be judged: interrupt, and improve the model or its "
                "calibration first",
                *(name, max(misfit.final, misfit.held_out_final or 0.0)),
            )

    def _compared_with(self, name: str) -> ComparedWith:
        known, baselines = needs(self.inputs.campaign, name)
        before = None if known is None else reference_result(self.inputs, self.outcome, known, self.stage)
        results = {other: self.outcome.results[other] for other in baselines if other in self.outcome.results}
        return ComparedWith(None if before is None else before.state, results)

    def _still_to_run(self, name: str) -> bool:
        """Whether a job must be identified, now that those it depends on have run; if not, judge it anew or keep it."""
        p = self.plans[name]
        if p.run and not p.waits:
            return True
        tight, campaign = self._compared_with(name), self.inputs.campaign
        p = self.plans[name] = settled(p, self.output, rests_on(tight), campaign.update.reference)
        if p.run:
            return True
        if p.judge:
            copied = p.copied if p.knows_copies else self._copied(name)
            rule, come_from = self.inputs.method.rule, origin_of(self.inputs)
            judge_one(campaign, rule, p, tight, self.outcome, come_from=come_from, copied=copied, progress=self.progress)
        else:
            keep(p, self.outcome, self.progress)
        return False

    def _identified(self, source: FrfSource, name: str) -> JobRecord:
        # Imported here because judging anew does not need it.
        from lrbc_cli.campaign.identification.identify import identify

        p, tight = self.plans[name], self._compared_with(name)
        result = (identify if self.remote is None else self.remote.identify)(self.inputs, source, name, tight.reference)
        for other, own in ((name, result.measurement), (self.inputs.campaign.update.reference, result.tight)):
            self._require_as_planned(other, own)
        copied = self._copied(name, result.measurement)
        return write_result(self.output, finish(self.inputs, self.stage, result, tight, (p.identity, p.judgement), copied))

    def _copied(self, name: str, own: Measurement | None = None) -> Copied | None:
        """Whether the measurement of a job is a copy of that of another one, as far as they are there."""
        original, text = self.originals.copied(name, compared_jobs(self.inputs.campaign, name), own)
        return Copied(text, original, measured(self.inputs.campaign, original)) if text else None

    def _require_as_planned(self, name: str | None, own: Measurement | None) -> None:
        """Refuse a measurement whose content is no longer that on which the identity rests.

        Otherwise a result of half a file would count as that of the whole one, as soon as this is complete.
        """
        if name is None or own is None or name not in self.plans:
            return
        campaign = self.inputs.campaign
        if self.plans[name].identity.parts["measurement"] != measured(campaign, name, lambda file: own.hashes.get(file.as_posix())):
            raise changed_meanwhile(campaign.jobs[name].first)

    def _run(self, names: list[str], source: FrfSource) -> None:
        """Identify jobs that do not depend on each other, as many at a time as there are workers."""
        if self.workers < 2 or len(names) < 2:
            for name in names:
                self._done(name, partial(self._identified, source, name))
            return
        # Threads suffice: most time is spent in dense linear algebra, which releases the interpreter lock.
        pool = sharing(min(self.workers, len(names)))
        pending: dict[Future[JobRecord], str] = {pool.submit(self._identified, source, name): name for name in names}
        try:
            while pending:
                finished, _ = wait(pending, return_when=FIRST_COMPLETED)
                for future in finished:
                    self._done(pending.pop(future), future.result)
        except BaseException:
            # Without this, the pool would wait for jobs on other machines.
            if self.remote is not None:
                self.remote.close()
            raise
        finally:
            pool.shutdown(cancel_futures=True)

    def _done(self, name: str, work: Callable[[], JobRecord]) -> None:
        if self.workers < 2:
            self.progress(f"{name}: identifying, {self._ahead(1)}")
        try:
            record = work()
        except LrbcError as error:
            self._failed(name, error)
        except Exception as error:
            # A program error in one job must not stop the others; the traceback is in the log.
            log.debug("job %s", name, exc_info=True)
            self._failed(name, NumericalError(f"job {name}: {type(error).__name__}: {error}"))
        else:
            self.outcome.results[name] = record
            misfit, seconds = record.misfit_db, record.seconds["total"]
            self.taken.append(seconds)
            text = f"{record.status}, misfit {misfit.initial:.2f} -> {misfit.final:.2f} dB, {seconds:.1f} s"
            self.progress(f"{name}: {text}; {self._ahead(0)}")

    def _ahead(self, begun: int) -> str:
        """Number of jobs done, and the time left estimated from the jobs that ran [s]."""
        through = len(self.outcome.results) + len(self.outcome.failed)
        text = f"{through + begun} of {len(self.names)} jobs"
        rest = len(self.names) - through
        if not rest or not self.taken:
            return text
        return f"{text}, about {rest * sum(self.taken) / len(self.taken) / min(self.workers, rest):.0f} s left"

    def _failed(self, name: str, error: LrbcError) -> None:
        self.outcome.failed.append(name)
        self.outcome.errors[name] = error
        try:
            write_failure(self.output, self.inputs, name, error, self.plans[name].identity.digest)
        except (LrbcError, OSError) as lack:
            # The other jobs run.
            log.warning("job %s: its failure cannot be noted in %s (%s)", name, self.output / name, on_one_line(lack))
        self.progress(f"{name}: failed")


def reference_result(inputs: Inputs, outcome: Outcome, reference: str, stage: ReductionStage | None) -> JobRecord | None:
    """Result of the reference job: of this call or, if it failed, its previous one with the same reduced model; else None."""
    if reference in outcome.results:
        return outcome.results[reference]
    output = inputs.campaign.output
    try:
        before = read_job(output, reference)
        # It is still in its place if only the new one could not be written.
        if not isinstance(before, JobRecord):
            before = read_job(output, reference, "result.previous.json")
    except DataError:
        return None
    # With other parameter groups its state cannot be compared with.
    if not isinstance(before, JobRecord) or theta_of(layout(inputs), before.parameters) is None:
        return None
    certificate = before.provenance.certificate
    return before if (certificate.key if certificate else None) == (stage.decision.key if stage else None) else None
