"""The loop of ``lrbc watch``: wait for files, judge what is complete, tell it, write the page."""

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
from lrbc_cli.results.store import read_job
from lrbc_cli.updating.judging.clearance import JobFinding, once_more
from lrbc_cli.watch.arrivals import Arrivals, signature
from lrbc_cli.watch.lock import Lock
from lrbc_cli.watch.session import Session
from lrbc_cli.watch.verdict import Verdict, unusable, verdict_of

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Pace:
    """Seconds: between looks without an event, that files must stay as they are, that a cut one is waited for, until a retry."""

    interval: float = 2.0
    settle: float = 0.3
    patience: float = 15.0
    retry: float = 20.0


class Wake:
    """Waits for changes in folders, or a time, whichever comes first.

    Events only save time: they get lost on network drives and while a machine sleeps, so what is there is looked at anyway.
    """

    def __init__(self) -> None:
        self._changed, self._stop = threading.Event(), threading.Event()
        self._folders: set[Path] = set()

    def watch(self, folders: Iterable[Path]) -> None:
        """Events of these folders from now on."""
        there = {folder for folder in folders if folder.is_dir()}
        if there == self._folders:
            return
        self.stop()
        self._folders, self._stop = there, threading.Event()
        if there:
            threading.Thread(target=self._listen, args=(there, self._stop), daemon=True).start()

    def wait(self, seconds: float) -> None:
        """Until something changed, or so long."""
        self._changed.wait(seconds)
        self._changed.clear()

    def due(self) -> bool:
        """Whether something changed since the last wait."""
        return self._changed.is_set()

    def stop(self) -> None:
        """No more events."""
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
        Gets each verdict, once its page is written.
    say : callable
        Gets a line on what is not a verdict.
    pace : Pace
    findings : dict
        What is known of each job that was measured, for an exit code.
    failed : set
        Jobs without a verdict, though they were measured.
    unusable : dict
        Of these what is wrong with their files, for the page, until they are fixed or taken away.
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
        # The page of earlier results is to refresh itself too.
        self._page_again, self._undrawn = 0.0, any(self.session.output.glob("*/result.json"))
        # Results that no page shows were told to nobody: whoever found them was killed before.
        self._shown = _written(self.session.output / "report.html")
        self._told: set[str] = set()

    def run(self, once: bool = False) -> None:
        """Until interrupted; or, once, until everything that is there is judged.

        Raises
        ------
        LrbcError
            Where another watcher has these results, the reduced model cannot be had, or it is interrupted.
        """
        self.lock.take()
        try:
            self.session.prepare()
            while True:
                # Before the look: what changes after it wakes the next one.
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
            # As it stays, it does not refresh itself; interrupted, its image files are left to `lrbc report`.
            self._page_again = 0.0
            if any(self.session.output.glob("*/result.json")):
                self._page(figures=once, live=False)
            self.lock.release()

    def _idle(self) -> None:
        """What need not be done while somebody waits for a verdict."""
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
        """Read the campaign file again where it, or what lies in the folder, is not what it was."""
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
            # Renamed or taken away: what it was is another job's, or nobody's.
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
        """Jobs that can be judged now, those that others rest on first."""
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
        """Judge a job, unless its files are not complete yet or a tight state is missing."""
        # One whose file is still being copied is no failure of this job.
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
                self._without(name, error, Verdict(name, "failed", 5, f"{name}: failed: {error}"))
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
                self._out(verdict_of(record, self.findings))
        for other, problem in once_more(self.findings).items():
            self._once(f"{other}: {problem}")
        if name in session.tight:
            self._cold = True
            # What changed for the others is found where they are planned; those that nothing concerns are kept.
            for other in session.campaign.jobs:
                if other not in session.tight[: session.tight.index(name) + 1]:
                    self.arrivals.anew(other)

    def _untold(self, name: str) -> bool:
        """Whether a result that still holds was written after the page that was there at the start, and not told since."""
        return name not in self._told and _written(self.session.output / name / "result.json") > self._shown

    def _without(self, name: str, error: Exception, verdict: Verdict) -> None:
        """Tell of a job that has no verdict, on the page too."""
        self.arrivals.done(name)
        self.unusable[name] = on_one_line(error)
        self._show()
        self._out(verdict)

    def _show(self) -> None:
        """Write the page for what is said beside the verdicts, where there is one."""
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
        """Write the page; where that fails the results are there all the same, and it is tried again."""
        if time.monotonic() < self._page_again:
            return
        try:
            # Image files are drawn while nobody waits for a verdict.
            halt = self.wake.due if live and figures else lambda: False
            self.session.report(live=live, figures=figures, halt=halt, unusable=self.unusable, passed_over=self._passed_over)
            self._undrawn = not figures or halt()
        except (LrbcError, OSError) as error:
            self._undrawn, self._page_again = True, time.monotonic() + self.pace.retry
            self._once(f"the page cannot be written: {error}")
            problem = error.problem if isinstance(error, LrbcError) else str(error)
            self._outdate(f"{problem}; it is written again once this is fixed, while lrbc watch runs")

    def _outdate(self, why: str) -> None:
        outdate(self.session.output / "report.html", why)


def _written(path: Path) -> float:
    """When a file was written [s]; zero where there is none."""
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
