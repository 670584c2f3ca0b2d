"""Lock file beside the results that allows one ``lrbc watch`` for each campaign.

The owner touches it regularly; a lock whose owner has ended, or on another machine has not touched it for ``GONE``, is taken over.
"""

from __future__ import annotations

import json
import os
import socket
import time
import uuid
from contextlib import suppress
from pathlib import Path

import psutil

from lrbc_cli.errors import ConfigError, room_or

NAME = ".watch.lock"

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
    """

    def __init__(self, output: Path) -> None:
        self.path = output / NAME
        self.token = uuid.uuid4().hex

    def take(self) -> None:
        """Acquire the lock.

        Raises
        ------
        ConfigError
            If another watcher holds it, or the folder cannot be written.
        """
        owner = {"token": self.token, "pid": os.getpid(), "host": socket.gethostname()}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            for _ in range(2):
                try:
                    self._create(json.dumps(owner))
                    return
                except FileExistsError:
                    other = self._other()
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
                self.path.write_text(json.dumps({"token": self.token, "pid": os.getpid(), "host": socket.gethostname()}), encoding="utf-8")
            else:
                os.utime(self.path)

    def release(self) -> None:
        """Remove the lock file if it is still this watcher's."""
        owner = _read(self.path)
        if owner is not None and owner.get("token") == self.token:
            with suppress(OSError):
                self.path.unlink()

    def _other(self) -> str | None:
        """Description of the watcher that holds the lock; None if it has ended."""
        owner = _read(self.path) or {}
        pid, host = owner.get("pid"), owner.get("host")
        with suppress(OSError):
            quiet = time.time() - self.path.stat().st_mtime
            if not owner:
                # The file is just being written, or was left empty by a full disk or a crash.
                return "one that is just starting" if quiet < BEGINS else None
            if host == socket.gethostname() and type(pid) is int:
                return f"process {pid}" if psutil.pid_exists(pid) else None
            return f"one on {host}" if quiet < GONE else None
        return None


def _read(path: Path) -> dict[str, object] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
