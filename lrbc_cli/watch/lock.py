"""Lock files beside the results: one ``lrbc watch`` for each campaign, and a note if two processes identify the same jobs.

The owner touches it regularly; a lock whose owner has ended, or on another machine has not touched it for ``GONE``, is taken over.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from lrbc_cli.errors import ConfigError, room_or
from lrbc_cli.io.atomic import atomic_write
from lrbc_cli.io.common import regular_bytes

NAME, AT_WORK = ".watch.lock", ".update.lock"

#: Seconds without a touch after which a watcher on another machine counts as ended.
GONE = 300.0

#: Seconds within which a starting watcher has written its name into the file.
BEGINS = 5.0


class Lock:
    """The lock of one results folder, held from ``take`` to ``release``.

    Parameters
    ----------
    output : Path
        Folder of the results.
    name : str
    """

    def __init__(self, output: Path, name: str = NAME) -> None:
        self.path = output / name
        self.token = uuid.uuid4().hex

    def take(self) -> None:
        """Acquire the lock.

        Raises
        ------
        ConfigError
            If another watcher holds it, or the folder cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            for _ in range(2):
                try:
                    self._create(self._owner)
                    return
                except FileExistsError:
                    if self.path.exists() and not self.path.is_file():
                        raise OSError(errno.EINVAL, "not a regular file") from None
                    other = self.other()
                    if other is not None:
                        break
                    self.path.unlink(missing_ok=True)
            else:
                other = "another"
        except OSError as error:
            raise ConfigError(
                f"the results cannot be written ({error.strerror or error})",
                file=self.path,
                hint=room_or(error, "choose another folder in `output`"),
            ) from error
        raise ConfigError(
            "another `lrbc watch` already watches these results",
            file=self.path,
            expected="one `lrbc watch` per campaign",
            found=other,
            hint="end the other one; if none is running, remove this file",
        )

    @property
    def _owner(self) -> str:
        """Text of the lock file: this process, with the time of its start, since numbers of processes are used again."""
        own = psutil.Process()
        return json.dumps({"token": self.token, "pid": own.pid, "started": own.create_time(), "host": socket.gethostname()})

    def _create(self, text: str) -> None:
        """Create the lock file with `text`, and remove it if writing fails; FileExistsError if there is one."""
        file = self.path.open("x", encoding="utf-8")
        try:
            with file:
                file.write(text)
        except OSError:
            self.path.unlink(missing_ok=True)
            raise

    def beat(self) -> None:
        """Touch the lock file, or write it again if it is missing or unreadable.

        Raises
        ------
        ConfigError
            If another watcher took over, for instance after the machine slept for hours.
        """
        owner = _read(self.path)
        if owner is not None and owner.get("token") != self.token:
            raise ConfigError("another `lrbc watch` took over these results", file=self.path, hint="use that one, or end it first")
        with suppress(OSError):
            if owner is None:
                with atomic_write(self.path) as file:
                    file.write(self._owner)
            else:
                os.utime(self.path)

    def release(self) -> None:
        """Remove the lock file if it is still this watcher's."""
        owner = _read(self.path)
        if owner is not None and owner.get("token") == self.token:
            with suppress(OSError):
                self.path.unlink()

    def other(self) -> str | None:
        """Description of the watcher that holds the lock; None if it has ended."""
        owner = _read(self.path) or {}
        pid, host = owner.get("pid"), owner.get("host")
        with suppress(OSError):
            quiet = time.time() - self.path.stat().st_mtime
            if not owner:
                # The file is just being written, or was left empty by a full disk or a crash.
                return "one that is just starting" if quiet < BEGINS else None
            if host == socket.gethostname() and type(pid) is int:
                return f"process {pid}" if _runs(pid, owner.get("started")) else None
            # A time in the future is that of another clock, by some seconds at most.
            return f"one on {host}" if abs(quiet) < GONE else None
        return None


@contextmanager
def at_work(output: Path, say: Callable[[str], None]) -> Iterator[None]:
    """Context in which results are written; ``say`` is called with a note if another process writes results of the same campaign."""
    lock, watcher = Lock(output, AT_WORK), Lock(output)
    other = f"lrbc watch ({named})" if watcher.path.is_file() and (named := watcher.other()) else ""
    try:
        lock.take()
    except ConfigError as error:
        # If the folder cannot be written, this is told when a result is.
        other = f"another lrbc ({error.found})" if error.found else other
    if other:
        say(f"{other} is at work on these results; what both identify is done twice, and each result is written whole")
    try:
        yield
    finally:
        lock.release()


def _runs(pid: int, started: object, *, near: float = 2.0) -> bool:
    """Whether the process with this number is the one that started at this time [s, within ``near``]; else the number was used again.

    If the clock was set meanwhile, a running watcher may count as ended; it then ends by itself (``beat``).
    """
    if not isinstance(started, float):
        return pid != os.getpid() and psutil.pid_exists(pid)
    try:
        return abs(psutil.Process(pid).create_time() - started) <= near
    except psutil.AccessDenied:
        return True
    except psutil.Error:
        return False


def _read(path: Path) -> dict[str, object] | None:
    try:
        found = json.loads(regular_bytes(path))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
