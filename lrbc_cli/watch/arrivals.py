"""Which jobs have new files that nobody writes to any more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

#: Size [bytes] and time of change [ns] of each file of a job.
Signature = tuple[tuple[str, int, int], ...]


@dataclass
class _Arrival:
    """What is known of the files of a job: how they are, since when, when they are looked at again, and whether that is over."""

    signature: Signature
    since: float
    again: float
    done: bool = False
    told: bool = False


class Arrivals:
    """Files by job, seen now and then; events may be missed, nothing but what is there counts.

    Parameters
    ----------
    settle : float
        Seconds for which size and time of change of all files of a job must have stayed.
    """

    def __init__(self, settle: float) -> None:
        self.settle = settle
        self._jobs: dict[str, _Arrival] = {}

    def look(self, files: Mapping[str, Sequence[Path]], now: float) -> list[str]:
        """Jobs whose files are all there, stay as they are, and were not done with yet; those that wait longest first.

        Parameters
        ----------
        files : mapping
            All files of each job.
        now : float
            A clock that never runs backwards [s].
        """
        for name, paths in files.items():
            found, known = signature(paths), self._jobs.get(name)
            if found is None:
                # A file that was renamed is another job's; one that comes back is new.
                self._jobs.pop(name, None)
            elif known is None or known.signature != found:
                self._jobs[name] = _Arrival(found, now, now + self.settle)
        for name in set(self._jobs) - set(files):
            del self._jobs[name]
        ready = [name for name, job in self._jobs.items() if not job.done and now >= job.again]
        return sorted(ready, key=lambda name: self._jobs[name].since)

    @property
    def next(self) -> float | None:
        """When the next job is to be looked at again, by the clock of ``look``; None where all are done with."""
        return min((job.again for job in self._jobs.values() if not job.done), default=None)

    def there(self, name: str) -> bool:
        """Whether all files of a job are there."""
        return name in self._jobs

    def through(self, name: str) -> bool:
        """Whether all files of a job are there and were done with."""
        return name in self._jobs and self._jobs[name].done

    def done(self, name: str) -> None:
        """Its files are done with, until one of them changes."""
        if name in self._jobs:
            self._jobs[name].done = True

    def anew(self, name: str) -> None:
        """What it rests on has changed: it is looked at once more."""
        if name in self._jobs:
            self._jobs[name].done = False

    def later(self, name: str, now: float, seconds: float) -> bool:
        """Look at it again after some time; whether that has to be told, once for each state of its files."""
        job = self._jobs[name]
        first, job.again, job.told = not job.told, now + seconds, True
        return first

    def age(self, name: str, now: float) -> float:
        """Seconds for which its files have stayed as they are."""
        return now - self._jobs[name].since


def signature(paths: Sequence[Path]) -> Signature | None:
    """What changes when files do; None where one is missing or out of reach."""
    found = []
    try:
        for path in paths:
            stat = path.stat()
            found.append((str(path), stat.st_size, stat.st_mtime_ns))
    except OSError:
        return None
    return tuple(found)
