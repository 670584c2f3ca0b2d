"""Reads files by libraries that may hang or crash on damaged ones in another process, with a time limit: HDF5, meshes, Ansys ``.full``.

A few damaged bits can send the HDF5 library into an endless loop, or end its process. Its calls hold Python's global lock, so neither
another thread nor Ctrl-C can interrupt them. One process reads all files of a run; it starts with the first file and ends with the run.
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

#: Time limit of a file: seconds, far above what opening takes on a busy machine, plus its size over the bytes a second of a slow drive.
SECONDS, BYTES_A_SECOND = 30.0, 1e6

#: Seconds for the process to start: it imports NumPy and SciPy, perhaps from a slow disk or under a virus scanner.
START_SECONDS = 120.0

#: Seconds between two checks of the time limit; Windows delivers Ctrl-C only between them.
_POLL = 0.1

# The module search path is passed on, since the caller may find this package only by its working folder. All imports precede the first
# time limit.
_BOOT = """
import sys
sys.path[:] = sys.argv[1:]
import lrbc_cli.io.hdf5.frf, lrbc_cli.io.hdf5.matrices, lrbc_cli.io.reader_process
lrbc_cli.io.reader_process.serve()
"""


class _ReaderProcess:
    """Handle of the reading process: sends requests and receives replies as pickles over pipes."""

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
        """Queue every reply, and None at the end; a thread of its own, since Ctrl-C cannot interrupt a blocking read of the pipe."""
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
        """Next reply; None if the process has ended.

        Raises
        ------
        TimeoutError
            If there is none within `seconds`.
        """
        end = time.monotonic() + seconds
        while True:
            try:
                return self.replies.get(timeout=_POLL)
            except queue.Empty:
                if time.monotonic() > end:
                    raise TimeoutError from None

    def close(self) -> int:
        """Kill the process and return its exit code, negative for a signal; 0 in a fork, which does not own it."""
        if self.owner != os.getpid():
            return 0
        self.process.kill()
        code = self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            # Closing may try to send what is still buffered.
            with contextlib.suppress(OSError, ValueError):
                stream.close()  # type: ignore[union-attr]
        return code


_lock = threading.Lock()
_reader: _ReaderProcess | None = None
_told: list[str] = []


def read_apart(reader: Callable[..., T], path: Path, *arguments: object) -> T:
    """Return ``reader(path, *arguments)``, evaluated in the reading process.

    Parameters
    ----------
    reader
        A function at the top level of a module of this package.
    path
        The file; its size sets the time limit.
    arguments
        Further arguments; they and the result must be picklable.

    Raises
    ------
    DataError
        If the reader raises it, does not finish in time, or its process crashes.
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
                # Read the exit code before _stop kills the process.
                code = process.process.wait(timeout=_POLL * 100)
                _stop()
                raise _unreadable(
                    path, "the library of this format crashes on this file", "data or an error", f"the process ended (exit code {code})"
                )
        except TimeoutError:
            _stop()
            limit = f"an answer within {seconds:.0f} s"
            raise _unreadable(path, "the library of this format does not finish reading this file", limit, "none") from None
        except (OSError, subprocess.TimeoutExpired) as error:
            _stop()
            raise _unreadable(path, "the process that reads this file ended", "an answer", str(error)) from error
        except DataError:
            raise
        except BaseException:
            # After Ctrl-C the process may still hang and must not be left running.
            _stop()
            raise
    fine, value = reply
    if not fine:
        raise value
    return value  # type: ignore[no-any-return]


def _unreadable(path: Path, problem: str, expected: str, found: str) -> DataError:
    return DataError(problem, file=path, expected=expected, found=found, hint="the file is damaged; export it again")


def _running() -> _ReaderProcess | None:
    """The reading process, started if there is none; None if it cannot be started, with one warning."""
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
                log.warning("HDF5 and mesh files are read without a time limit: the reading process could not be started (%s)", *_told)
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
    """Answer requests until the caller ends; runs in the reading process."""
    # The terminal sends Ctrl-C to both processes. The default action ends this one even inside the library, so the caller need not wait.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    replies = os.fdopen(os.dup(1), "wb")
    # Keep what a library prints out of the replies.
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
        # Ends this process if the caller was killed meanwhile; this timer does not need Python's global lock.
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
