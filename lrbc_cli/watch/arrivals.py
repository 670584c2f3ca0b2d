"""Finds the jobs whose files are new and no longer being written, by polling their sizes and modification times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

#: Path, size [bytes] and modification time [ns] of each file of a job.
Signature = tuple[tuple[str, int, int], ...]


@dataclass(kw_only=True)
class _Arrival:
    """State of a job's files: signature, since when [s], when to check again [s], whether processed, whether a delay was reported."""

    signature: Signature
    since: float
    again: float
    done: bool = False
    told: bool = False


class Arrivals:
    """Tracks the files of all jobs by polling; file events are not needed, so none can be missed.

    Parameters
    ----------
    settle : float
        Seconds for which the signature of a job's files must not have changed.
    """

    def __init__(self, settle: float) -> None:
        self.settle = settle
        self._jobs: dict[str, _Arrival] = {}

    def look(self, files: Mapping[str, Sequence[Path]], now: float) -> list[str]:
        """Jobs whose files all exist, no longer change and are not processed yet, in the order in which their files settled.

        Parameters
        ----------
        files : mapping
            All files of each job.
        now : float
            Time of a monotonic clock [s].
        """
        for name, paths in files.items():
            found, known = signature(paths), self._jobs.get(name)
            if found is None:
                # A renamed file belongs to another job; a file that comes back counts as new.
                self._jobs.pop(name, None)
            elif known is None or known.signature != found:
                self._jobs[name] = _Arrival(signature=found, since=now, again=now + self.settle)
        for name in set(self._jobs) - set(files):
            del self._jobs[name]
        ready = [name for name, job in self._jobs.items() if not job.done and now >= job.again]
        return sorted(ready, key=lambda name: self._jobs[name].since)

    @property
    def next(self) -> float | None:
        """Time at which the next job is to be checked, by the clock of ``look``; None if all are processed."""
        return min((job.again for job in self._jobs.values() if not job.done), default=None)

    def there(self, name: str) -> bool:
        """Whether all files of a job exist."""
        return name in self._jobs

    def through(self, name: str) -> bool:
        """Whether all files of a job exist and are processed."""
        return name in self._jobs and self._jobs[name].done

    def done(self, name: str) -> None:
        """Mark a job as processed, until one of its files changes."""
        if name in self._jobs:
            self._jobs[name].done = True

    def anew(self, name: str) -> None:
        """Mark a job as not processed, since what its result rests on has changed."""
        if name in self._jobs:
            self._jobs[name].done = False

    def later(self, name: str, now: float, seconds: float) -> bool:
        """Check a job again after `seconds`; True for the first delay of these files, which is reported."""
        job = self._jobs[name]
        first, job.again, job.told = not job.told, now + seconds, True
        return first

    def age(self, name: str, now: float) -> float:
        """Seconds since the last change of a job's files."""
        return now - self._jobs[name].since


def signature(paths: Sequence[Path]) -> Signature | None:
    """Path, size and modification time of each file; None if one is missing or cannot be reached."""
    found = []
    try:
        for path in paths:
            stat = path.stat()
            found.append((str(path), stat.st_size, stat.st_mtime_ns))
    except OSError:
        return None
    return tuple(found)
