"""Files that the HDF5 library may hang or crash on, read in another process with a deadline.

A few damaged bits can send the library into an endless loop, or end its process. Its calls hold Python's lock, so that neither another
thread nor Ctrl-C comes through. One process reads all files of a run; it is started with the first of them and ends with the run.
"""

from __future__ import annotations

import atexit
import contextlib
import faulthandler
import logging
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from lrbc_cli.errors import DataError

log = logging.getLogger(__name__)

T = TypeVar("T")

#: Seconds for any file, far above what opening takes on a busy machine; and bytes a second of a slow network drive, for large ones.
SECONDS, BYTES_A_SECOND = 30.0, 1e6

#: Seconds for the process to start: it imports NumPy and SciPy, from a slow disk and under a virus scanner too.
START_SECONDS = 120.0

#: Between two looks at the deadline; Windows delivers Ctrl-C only between them.
_POLL = 0.1

# The path of the modules is handed over: the caller may know this package from its working folder only. All of it is imported before a
# deadline begins.
_BOOT = """
import sys
sys.path[:] = sys.argv[1:]
import lrbc_cli.io.hdf5.frf, lrbc_cli.io.hdf5.matrices, lrbc_cli.io.reader_process
lrbc_cli.io.reader_process.serve()
"""


class _ReaderProcess:
    """The other process."""

    def __init__(self) -> None:
        flags = 0
        if sys.platform == "win32":
            flags = subprocess.CREATE_NO_WINDOW
        command = [sys.executable, "-P", "-c", _BOOT, *sys.path]
        self.owner = os.getpid()
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, creationflags=flags
        )
        self.replies: queue.SimpleQueue[tuple[bool, Any] | None] = queue.SimpleQueue()
        threading.Thread(target=self._receive, daemon=True).start()

    def _receive(self) -> None:
        """Hand on every reply, at last None: a thread waits where Ctrl-C would not come through."""
        assert self.process.stdout is not None
        try:
            while True:
                self.replies.put(pickle.load(self.process.stdout))
        except Exception:
            self.replies.put(None)

    def send(self, request: object) -> None:
        assert self.process.stdin is not None
        pickle.dump(request, self.process.stdin)
        self.process.stdin.flush()

    def reply(self, seconds: float) -> tuple[bool, Any] | None:
        """Next reply; None where the process ended.

        Raises
        ------
        TimeoutError
        """
        end = time.monotonic() + seconds
        while True:
            try:
                return self.replies.get(timeout=_POLL)
            except queue.Empty:
                if time.monotonic() > end:
                    raise TimeoutError from None

    def close(self) -> int:
        """End the process at once; its exit code, negative for a signal."""
        if self.owner != os.getpid():
            return 0
        self.process.kill()
        code = self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            # What was not sent yet is of no use to anybody.
            with contextlib.suppress(OSError, ValueError):
                stream.close()  # type: ignore[union-attr]
        return code


_lock = threading.Lock()
_reader: _ReaderProcess | None = None
_told: list[str] = []


def read_apart(reader: Callable[..., T], path: Path, *arguments: object) -> T:
    """Give ``reader(path, *arguments)``, found in another process.

    Parameters
    ----------
    reader
        A function of a module of this package.
    path
        The file; its size decides about the deadline.
    arguments
        What can be pickled, as the result.

    Raises
    ------
    DataError
        What the reader raises; and where it does not come to an end or its process does not survive.
    """
    with _lock:
        process = _running()
        if process is None:
            return reader(path, *arguments)
        seconds = SECONDS + path.stat().st_size / BYTES_A_SECOND
        try:
            process.send((reader, str(Path.cwd()), (path, *arguments), seconds))
            reply = process.reply(seconds)
            if reply is None:
                # Its own code, before it is killed.
                code = process.process.wait(timeout=_POLL * 100)
                _stop()
                raise _unreadable(
                    path, "the HDF5 library crashes on this file", "data or an error", f"the process ended (exit code {code})"
                )
        except TimeoutError:
            _stop()
            raise _unreadable(
                path, "the HDF5 library does not finish reading this file", f"an answer within {seconds:.0f} s", "none"
            ) from None
        except (OSError, subprocess.TimeoutExpired) as error:
            _stop()
            raise _unreadable(path, "the process that reads HDF5 files ended", "an answer", str(error)) from error
        except DataError:
            raise
        except BaseException:
            # Ctrl-C: a process that hangs must not stay behind.
            _stop()
            raise
    fine, value = reply
    if not fine:
        raise value
    return value  # type: ignore[no-any-return]


def _unreadable(path: Path, problem: str, expected: str, found: str) -> DataError:
    return DataError(problem, file=path, expected=expected, found=found, hint="the file is damaged; export it again")


def _running() -> _ReaderProcess | None:
    """The process, started where there is none; None where none can be started, which is told once."""
    global _reader
    if _reader is not None and (_reader.owner != os.getpid() or _reader.process.poll() is not None):
        _stop()
    if _reader is None:
        try:
            _reader = _ReaderProcess()
            if _reader.reply(START_SECONDS) is None:
                raise OSError(f"it ends with exit code {_stop()}")
        except (OSError, TypeError, TimeoutError) as error:
            _stop()
            if not _told:
                _told.append(str(error) or type(error).__name__)
                log.warning("HDF5 files are read without a time limit: the reading process could not be started (%s)", *_told)
            return None
        except BaseException:
            _stop()
            raise
    return _reader


def _stop() -> int:
    global _reader
    reader, _reader = _reader, None
    return reader.close() if reader is not None else 0


atexit.register(_stop)


def serve() -> None:
    """Answer requests until the caller ends; called in the other process."""
    # The terminal sends Ctrl-C to both processes: ended by the system, inside the library too, so that no thread of the caller waits on.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    replies = os.fdopen(os.dup(1), "wb")
    # What a library prints is no reply.
    os.dup2(2, 1)

    def answer(fine: bool, value: object) -> None:
        pickle.dump((fine, value), replies, protocol=pickle.HIGHEST_PROTOCOL)
        replies.flush()

    answer(True, None)
    while True:
        try:
            reader, folder, arguments, seconds = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        # Where the caller was killed meanwhile: this timer needs no lock of Python's.
        faulthandler.dump_traceback_later(seconds + 10.0, exit=True)
        with contextlib.suppress(OSError):
            os.chdir(folder)
        try:
            fine, value = True, reader(*arguments)
        except Exception as error:
            fine, value = False, error
        faulthandler.cancel_dump_traceback_later()
        answer(fine, value)
        del value
