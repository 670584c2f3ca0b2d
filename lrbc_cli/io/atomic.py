"""Atomic writing: a file is written under a temporary name and renamed when it is complete, so that it appears whole or not at all."""

from __future__ import annotations

import hashlib
import os
import re
import stat
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any, Literal, TypeVar

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import require_file

T = TypeVar("T")

#: Names that ``atomic_path`` gives to temporary files, with the endings of results and of the cache.
_TEMPORARY = re.compile(r"\..+-[0-9a-f]{12}\.(json|csv|h5|html|png|svg|pdf)")

#: Complete files of a block ``together`` in this context that wait for the others: temporary and final path.
_waiting: ContextVar[list[tuple[Path, Path]] | None] = ContextVar("_waiting", default=None)


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Temporary path beside ``path`` that replaces it when the block ends without an error.

    The temporary file has the same ending, is flushed to disk before it is renamed, and is removed when
    the block raises, an interruption from the keyboard included. Missing parent folders are created.

    Parameters
    ----------
    path
        The file to write or replace.

    Yields
    ------
    Path
        A path in the same folder that does not exist yet; the block must create it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.parent / f".{path.stem[:80]}-{uuid.uuid4().hex[:12]}{path.suffix}"
    waiting = _waiting.get()
    try:
        yield temporary
        _flush(temporary)
        if waiting is not None:
            waiting.append((temporary, path))
            return
        temporary.replace(path)
    except BaseException:
        _remove(temporary)
        raise
    _flush_folder(path.parent)


@contextmanager
def together() -> Iterator[None]:
    """The files written in the block replace the earlier ones when it ends without an error, in their order; otherwise none does.

    So a disk that becomes full leaves no files of two runs beside each other.
    """
    files: list[tuple[Path, Path]] = []
    token = _waiting.set(files)
    try:
        yield
        for temporary, path in files:
            temporary.replace(path)
    except BaseException:
        for temporary, _ in files:
            _remove(temporary)
        raise
    finally:
        _waiting.reset(token)
    for folder in {path.parent for _, path in files}:
        _flush_folder(folder)


@contextmanager
def atomic_write(path: Path, mode: Literal["w", "wb"] = "w") -> Iterator[IO[Any]]:
    r"""File object whose content replaces ``path`` when the block ends without an error.

    Text is UTF-8 with ``\n`` line ends on every system.

    Parameters
    ----------
    path
        The file to write or replace.
    mode
        ``"w"`` for text, ``"wb"`` for bytes.
    """
    if mode not in ("w", "wb"):
        raise ValueError(f"mode must be 'w' or 'wb', not {mode!r}")
    with atomic_path(path) as temporary:
        if mode == "w":
            with temporary.open("x", encoding="utf-8", newline="\n") as text:
                yield text
        else:
            with temporary.open("xb") as binary:
                yield binary


def remove_leftovers(folder: Path, *, age: float = 86400.0) -> None:
    """Remove temporary files of killed processes from a folder that only this program writes; what cannot be removed stays.

    Parameters
    ----------
    folder
        Folders below it are left alone.
    age
        Seconds since the last change; a younger file may still be written by another process.
    """
    with suppress(OSError):
        for path in list(folder.glob(".*")):
            with suppress(OSError):
                found = path.lstat()
                if _TEMPORARY.fullmatch(path.name) and stat.S_ISREG(found.st_mode) and time.time() - found.st_mtime > age:
                    path.unlink()


def file_hash(path: Path) -> str:
    """SHA-256 of a file's content, as 64 hexadecimal digits.

    Raises
    ------
    DataError
        If the file is missing, empty or unreadable.
    """
    require_file(path)
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def unchanged(file: Path, digest: str, reader: Callable[[], T]) -> T:
    """What a reader returns of a file with this digest.

    Raises
    ------
    DataError
        If the content changed meanwhile.
    """
    found = reader()
    if file_hash(file) != digest:
        raise changed_meanwhile(file)
    return found


def changed_meanwhile(file: Path) -> DataError:
    """Error for a measurement that changed during the run, as while it is copied."""
    return DataError(
        "the file changed during the run",
        file=file,
        expected="the same content from the beginning to the end",
        hint="run again when the file is complete",
    )


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    with path.open("rb+") as stream:
        os.fsync(stream.fileno())


def _flush_folder(folder: Path) -> None:
    # Makes the rename itself durable; Windows cannot open folders.
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
