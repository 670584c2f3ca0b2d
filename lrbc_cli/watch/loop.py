"""The loop of ``lrbc watch``: wait for files, identify and judge complete jobs, write the page, report the verdicts."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from lrbc_cli.campaign.beside import passed_over
from lrbc_cli.errors import LrbcError, disk_is_full, on_one_line, unwritten
from lrbc_cli.report.old import outdate
from lrbc_cli.report.reading import read_results
from lrbc_cli.results.store import read_job
from lrbc_cli.updating.judging.clearance import JobFinding, across
from lrbc_cli.watch.arrivals import Arrivals, signature
from lrbc_cli.watch.lock import Lock
from lrbc_cli.watch.pulse import Pulse
from lrbc_cli.watch.session import Session
from lrbc_cli.watch.verdict import Verdict, unusable, verdict_of

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Pace:
    """Times [s]: between checks without an event, for files to settle, to wait for an incomplete file, between retries of writing."""

    interval: float = 2.0
    settle: float = 0.3
    patience: float = 15.0
    retry: float = 20.0


class Wake:
    """Waits until files in folders change or a time is over.

    Events only save time: they get lost on network drives and while a machine sleeps, so the files are polled as well.
    """

    def __init__(self) -> None:
        self._changed, self._stop = threading.Event(), threading.Event()
        self._folders: set[Path] = set()

    def watch(self, folders: Iterable[Path]) -> None:
        """Listen to changes in these folders from now on, in place of those before."""
        there = {folder for folder in folders if folder.is_dir()}
        if there == self._folders:
            return
        self.stop()
        self._folders, self._stop = there, threading.Event()
        if there:
            threading.Thread(target=self._listen, args=(there, self._stop), daemon=True).start()

    def wait(self, seconds: float) -> None:
        """Wait for a change, for at most `seconds`."""
        self._changed.wait(seconds)
        self._changed.clear()

    def due(self) -> bool:
        """Whether something changed since the last wait."""
        return self._changed.is_set()

    def stop(self) -> None:
        """Stop listening."""
        self._stop.set()

    def _listen(self, folders: set[Path], stop: threading.Event) -> None:
        try:
            from watchfiles import watch

            for _ in watch(*folders, stop_event=stop, watch_filter=None, debounce=200, rust_timeout=500, recursive=False):
                self._changed.set()
        except Exception as error:
            log.debug("no file events from %s (%s): scanned at intervals instead", ", ".join(map(str, folders)), error)
            self._folders = set()


@dataclass(kw_only=True)
class Watch:
    """Judges jobs as their files arrive.

    Attributes
    ----------
    session : Session
    tell : callable
        Called with each verdict, after the page is written.
    say : callable
        Called with each message that is not a verdict.
    pace : Pace
    findings : dict
        Finding of each measured job, for the exit code.
    failed : set
        Measured jobs without a verdict.
    unusable : dict
        Error of each job that failed or cannot be read, for the page, until its files are fixed or removed.
    """

    session: Session
    tell: Callable[[Verdict], None]
    say: Callable[[str], None]
    pace: Pace = field(default_factory=Pace)
    findings: dict[str, JobFinding] = field(default_factory=dict)
    failed: set[str] = field(default_factory=set)
    unusable: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.lock, self.wake = Lock(self.session.output), Wake()
        self.arrivals = Arrivals(self.pace.settle)
        self._said: set[str] = set()
        self._passed_over: list[str] = []
        self._cold = True
        self._known: object = None
        # A page of earlier results is written again, so that it refreshes itself.
        self._page_again, self._undrawn = 0.0, any(self.session.output.glob("*/result.json"))
        # Results newer than the page were not reported yet: the process that found them was killed before.
        self._shown = _written(self.session.output / "report.html")
        self._told: set[str] = set()

    def run(self, once: bool = False) -> None:
        """Run until interrupted; with `once`, until all complete jobs are judged.

        Raises
        ------
        LrbcError
            If another watcher has or takes over these results, or the reduced model cannot be built.
        """
        self.lock.take()
        pulse = Pulse(self.session.output)
        pulse.start()
        try:
            self.session.prepare()
            while True:
                # Listen before checking the files, so that a change in between ends the next wait.
                self.wake.watch(self._folders())
                self._reload()
                for name in self._look():
                    self._one(name, once)
                soon = self.arrivals.next
                if once and soon is None:
                    return
                if soon is None:
                    self._idle()
                self.wake.wait(self.pace.interval if soon is None else min(max(soon - time.monotonic(), 0.01), self.pace.interval))
                self.lock.beat()
        finally:
            self.wake.stop()
            # The last page does not refresh itself; after an interruption its image files are left to `lrbc report`.
            self._page_again = 0.0
            if any(self.session.output.glob("*/result.json")):
                self._page(figures=once, live=False)
            pulse.stop()
            self.lock.release()

    def _idle(self) -> None:
        """Work for idle times: prepare the next job, draw the image files."""
        reference = self.session.campaign.update.reference
        if self._cold and reference is not None and self.arrivals.there(reference) and reference not in self.failed:
            self._cold = False
            with suppress(LrbcError, OSError):
                self.session.warm(reference)
        if self._undrawn:
            self._page(figures=True)

    def _files(self) -> set[Path]:
        return {path for job in self.session.campaign.jobs.values() for path in job.all_files}

    def _folders(self) -> set[Path]:
        campaign = self.session.campaign
        own = {path.parent for path in self._files()}
        return own | ({campaign.watch.folder} if campaign.watch is not None else set())

    def _reload(self) -> None:
        """Read the campaign file again if it or the list of files in the watched folder has changed."""
        watch = self.session.campaign.watch
        before, self._passed_over = self._passed_over, passed_over(self.session.campaign)
        for text in self._passed_over:
            self._once(text)
        if self._passed_over != before:
            self._show()
        now = (signature([self.session.settings.config]), None if watch is None else tuple(watch.files()))
        if now == self._known:
            return
        old = self.session.campaign
        try:
            self.session.reload()
        except (LrbcError, OSError) as error:
            self._once(f"the campaign is not read again, its earlier state is kept: {error}")
            return
        self._known, campaign = now, self.session.campaign
        for name in old.jobs.keys() - campaign.jobs.keys():
            # A job that is gone was renamed or removed; its finding no longer counts.
            self.findings.pop(name, None)
            self.failed.discard(name)
        other = campaign.model_dump(exclude={"jobs"}) != old.model_dump(exclude={"jobs"})
        self._cold |= other
        for name, job in campaign.jobs.items():
            if other or old.jobs.get(name) != job:
                self.arrivals.anew(name)

    def _once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self.say(text)

    def _look(self) -> list[str]:
        """Jobs that can be judged now; tight states, on which others rest, come first."""
        ready = self.arrivals.look({name: job.all_files for name, job in self.session.campaign.jobs.items()}, time.monotonic())
        gone = [name for name in self.unusable if not self.arrivals.there(name)]
        for name in gone:
            del self.unusable[name]
            self.findings.pop(name, None)
            self.failed.discard(name)
        if gone:
            self._show()
        tight = self.session.tight
        return sorted(ready, key=lambda name: tight.index(name) if name in tight else len(tight))

    def _one(self, name: str, once: bool) -> None:
        """Judge a job if its files are complete and the tight states that it needs are there; else let it wait."""
        # A tight state whose file is still being copied makes this job wait, not fail.
        lacking = [other for other in self.session.needed(name) if not self.arrivals.through(other) or other in self.failed]
        if lacking:
            self.findings[name] = JobFinding(status="waiting")
            self._once(f"{name}: waiting for {', '.join(lacking)}, which gives the tight state")
            self.arrivals.done(name)
            return
        now, patience = time.monotonic(), 2 * self.pace.settle if once else self.pace.patience
        try:
            if not self.session.complete(name) and self.arrivals.age(name, now) < patience:
                self.arrivals.later(name, now, self.pace.settle)
                return
        except (LrbcError, OSError) as error:
            if self.arrivals.age(name, now) < patience:
                self.arrivals.later(name, now, self.pace.settle)
                return
            self._without(name, error, unusable(name, error))
            return
        self._judge(name, once)

    def _judge(self, name: str, once: bool) -> None:
        session = self.session
        missing = [other for other in session.campaign.jobs if not self.arrivals.there(other)]
        try:
            outcome = session.judge(name, missing)
            trouble: BaseException | None = next((error for error in outcome.errors.values() if unwritten(error)), None)
        except (LrbcError, OSError) as error:
            trouble = error
            if unwritten(error) is None:
                self._without(name, error, Verdict(job=name, verdict="failed", exit_code=5, sentence=f"{name}: failed: {error}"))
                return
        if trouble is not None:
            self._postponed(name, trouble, once)
            return
        self.arrivals.done(name)
        new = [other for other in (*outcome.results, *outcome.failed) if other not in outcome.kept or self._untold(other)]
        self.findings |= {other: record.finding for other, record in outcome.results.items()}
        self.failed -= set(outcome.results)
        fixed = [other for other in (name, *outcome.results) if self.unusable.pop(other, None) is not None]
        if new or fixed:
            self._page(figures=False)
        for other in new:
            record = outcome.results.get(other) or read_job(session.output, other)
            if record is not None:
                self._out(verdict_of(record, self.findings, session.rests_on(other), unseen=bool(self._passed_over)))
        for other, problem in across(self.findings).items():
            self._once(f"{other}: {problem}")
        if name in session.tight:
            self._cold = True
            # The other jobs are checked again; `run_jobs` keeps the results that are still valid.
            for other in session.campaign.jobs:
                if other not in session.tight[: session.tight.index(name) + 1]:
                    self.arrivals.anew(other)

    def _untold(self, name: str) -> bool:
        """Whether a kept result is newer than the page at the start and was not reported since."""
        return name not in self._told and _written(self.session.output / name / "result.json") > self._shown

    def _without(self, name: str, error: Exception, verdict: Verdict) -> None:
        """Report a job that cannot be judged, on the page too."""
        self.arrivals.done(name)
        self.unusable[name] = on_one_line(error)
        self._show()
        self._out(verdict)

    def _show(self) -> None:
        """Write the page again for changed messages beside the verdicts, if there are results to show."""
        if any(self.session.output.glob("*/result.json")):
            self._page(figures=False)

    def _postponed(self, name: str, error: BaseException, once: bool) -> None:
        cause = unwritten(error)
        assert cause is not None
        what = "the disk is full" if disk_is_full(cause) else f"the results cannot be written ({cause.strerror or cause})"
        if self.arrivals.later(name, time.monotonic(), self.pace.retry):
            do = f"make room on the disk of {self.session.output}" if disk_is_full(cause) else f"fix this in {self.session.output}"
            self.say(f"{name}: {what}; {do}. The measurement is kept where it is, and judged as soon as possible")
            self._outdate(f"{name} is measured but not judged, {what}: {do}; it is judged as soon as possible while lrbc watch runs")
        if once:
            self.arrivals.done(name)
            self.failed.add(name)

    def _out(self, verdict: Verdict) -> None:
        if verdict.verdict in ("failed", "unusable"):
            self.failed.add(verdict.job)
            self.findings[verdict.job] = JobFinding(status="failed")
        self._told.add(verdict.job)
        self.tell(verdict)

    def _page(self, *, figures: bool, live: bool = True) -> None:
        """Write the page; if that fails, the results are kept all the same and it is tried again after ``pace.retry``."""
        if time.monotonic() < self._page_again:
            return
        try:
            # Drawing stops as soon as a file changes: verdicts come first.
            halt = self.wake.due if live and figures else lambda: False
            self.session.report(live=live, figures=figures, halt=halt, unusable=self.unusable, passed_over=self._passed_over)
            self._undrawn = not figures or halt()
            for name, unread in read_results(self.session.output).unreadable.items():
                self._once(f"job {name} is not shown: {unread}")
        except (LrbcError, OSError) as error:
            self._undrawn, self._page_again = True, time.monotonic() + self.pace.retry
            problem, cause = error.problem if isinstance(error, LrbcError) else str(error), unwritten(error)
            full = f"{problem}; make room on the disk of {self.session.output}, then it is written by itself"
            self._once(f"the page cannot be written: {full if cause is not None and disk_is_full(cause) else error}")
            self._outdate(f"{problem}; it is written again once this is fixed, while lrbc watch runs")

    def _outdate(self, why: str) -> None:
        outdate(self.session.output / "report.html", why)


def _written(path: Path) -> float:
    """Modification time of a file [s]; zero if it cannot be reached."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
