"""What all file readers share: recognition of formats, and checks for files that are missing, damaged, or claim implausibly much data."""

from __future__ import annotations

import errno
import gzip
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TypeVar

from lrbc_cli.errors import DataError, LrbcError

#: Deflate cannot compress better than about 1032:1, so a file cannot hold more than this many times its size.
MAX_COMPRESSION = 1100

#: Large arrays must not unpack to more than this many times the file. Numbers that differ take at least half a byte each when packed, a
#: sixteenth of their unpacked size. Only arrays with at least six zeros in seven entries (sparse matrices), or a bomb, pack better.
MAX_EXPANSION = 100

#: Bytes up to which any expansion is allowed: a dense diagonal matrix of 5800 DOFs, which fits into the memory of any machine.
ROOM = 256 * 2**20

#: Most characters of one number in a text file: a double with all of its digits and padding takes 30.
LONGEST_NUMBER = 100

#: Exponent that Fortran writes without a letter.
_BARE = re.compile(r"(?<=[\d.])([+-]\d+)$")

#: Arrays up to this size in bytes are not compared with the size of the file.
SMALL_ALLOCATION = 64 * 2**20


@dataclass(frozen=True)
class FileFormat:
    """A file format, and whether a file has it by its path and its first bytes (unpacked); sub-classes add the readers."""

    name: str
    told: Callable[[Path, bytes], bool]


F = TypeVar("F", bound=FileFormat)


def recognised(
    formats: Iterable[F], path: Path, start: bytes, expected: str, foreign: Callable[[Path, bytes], tuple[str | None, str]]
) -> F:
    """First of the formats that a file has by its path and its first bytes.

    Parameters
    ----------
    formats, path, start
        As named.
    expected
        The formats in words.
    foreign
        Program or format of any other file, None if unknown, and what to do instead.

    Raises
    ------
    DataError
        If it has none of them.
    """
    found = next((format for format in formats if format.told(path, start)), None)
    if found is None:
        program, hint = foreign(path, start)
        problem = f"this is {program}" if program else "the format of this file is not known"
        raise DataError(problem, file=path, expected=expected, found=program or _described(start), hint=hint)
    return found


def _described(start: bytes) -> str:
    if b"\0" in start or sum(byte > 126 for byte in start) > len(start) // 4:
        return f"binary data starting with {start[:8].hex(' ')}"
    return repr(start.splitlines()[0][:60].decode("latin-1")) if start.splitlines() else "blank lines"


def require_file(path: Path) -> int:
    """Size in bytes of a readable, non-empty file.

    Raises
    ------
    DataError
        If the file is missing, a folder, empty or unreadable.
    """
    try:
        if not path.exists():
            raise DataError("the file does not exist", file=path, hint=_other_path(path))
        if not path.is_file():
            hint = "give a file in it, or several as a list [first, second]" if path.is_dir() else None
            found = "a folder" if path.is_dir() else "a pipe, a socket or a device"
            raise DataError("this is not a file", file=path, expected="a file", found=found, hint=hint)
        with path.open("rb") as stream:
            stream.read(1)
        size = path.stat().st_size
    except (OSError, ValueError) as error:
        raise DataError("the file cannot be opened", file=path, found=str(error), hint="check the path and its permissions") from error
    if size == 0:
        raise DataError("the file is empty", file=path, expected="data", found="0 bytes", hint="export it again")
    return size


def _other_path(path: Path) -> str:
    """Hint for the path of a missing file: a slash, a missing folder or a similar name."""
    if "\\" in path.name:
        return "write paths with /, which works on every system"
    parent = path.parent
    if not parent.is_dir():
        return f"there is no folder {parent}; relative paths start at the campaign file's folder"
    near = get_close_matches(path.name, [other.name for other in parent.iterdir() if other.name != path.name], n=1, cutoff=0.75)
    return (f"did you mean '{near[0]}'? " if near else "") + "check the path; relative paths start at the campaign file's folder"


def regular_bytes(path: Path, most: int = -1) -> bytes:
    """Content of a regular file, up to ``most`` bytes.

    Raises
    ------
    OSError
        If it cannot be read, or is something else: reading a pipe or a device may never end.
    """

    def at_once(name: str, flags: int) -> int:
        # Otherwise opening a pipe would wait for its writer.
        return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))

    with open(path, "rb", opener=at_once) as stream:
        if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        return stream.read(most)


def head(path: Path, count: int = 1024) -> bytes:
    """Return the first bytes of a file."""
    with path.open("rb") as stream:
        return stream.read(count)


def whole(path: Path) -> bytes:
    """Content of a file, unpacked if it is compressed with gzip.

    Raises
    ------
    DataError
        If it is missing or damaged, or unpacks to implausibly much (see ``check_expansion``).
    """
    size = require_file(path)
    if head(path, 2) != b"\x1f\x8b":
        return path.read_bytes()
    limit = max(MAX_EXPANSION * size, ROOM)
    with damaged(path, "gzip file"), gzip.open(path, "rb") as stream:
        content = stream.read(limit + 1)
    check_expansion(len(content), size, path, "gzip")
    return content


def ends_early(path: Path, place: str, expected: object, found: object) -> DataError:
    """Error for a file that stops in the middle of a line, or before it holds all that its header states."""
    hint = "the file was truncated when it was copied or written: copy it again, or export it again"
    return DataError("the file ends early", file=path, place=place, expected=expected, found=found, hint=hint)


def check_allocation(needed: int, file_size: int, path: Path, place: str, *, compressed: bool = False) -> None:
    """Refuse an array that is larger than the file can hold.

    Parameters
    ----------
    needed
        Bytes of the array by its header.
    file_size
        Bytes of the file.
    compressed
        Whether the array may be compressed in the file.

    Raises
    ------
    DataError
        If the file cannot hold the array or, compressed, unpacks to implausibly much (see ``check_expansion``).
    """
    limit = file_size * MAX_COMPRESSION if compressed else file_size
    if needed > max(limit, 0):
        raise DataError(
            "the header states more data than the file contains",
            file=path,
            place=place,
            expected=f"{needed} bytes",
            found=f"{file_size} bytes",
            hint="the file is damaged or truncated; export it again",
        )
    if compressed:
        check_expansion(needed, file_size, path, place)


def check_expansion(needed: int, packed: int, path: Path, place: str) -> None:
    """Refuse compressed data that unpack to implausibly much.

    Parameters
    ----------
    needed
        Bytes of the unpacked data.
    packed
        Bytes in the file.

    Raises
    ------
    DataError
        If `needed` exceeds both ``MAX_EXPANSION`` times `packed` and ``ROOM``.
    """
    if needed > max(packed * MAX_EXPANSION, ROOM):
        raise DataError(
            "the compressed data unpack to far more than is plausible for such a file",
            file=path,
            place=place,
            expected=f"at most {MAX_EXPANSION} times the {packed} bytes of the file, or {ROOM // 2**20} MB",
            found=f"{needed} bytes",
            hint="store the matrix as a sparse matrix, or without compression",
        )


def check_dimensions(shape: tuple[int, ...], file_size: int, path: Path, place: str) -> None:
    """Refuse dimensions of a sparse matrix whose index pointers alone would be far larger than the file.

    Raises
    ------
    DataError
        If there are not two dimensions, one is negative, or one is out of proportion to the file.
    """
    if len(shape) != 2 or min(shape) < 0:
        raise DataError("this is not a matrix", file=path, place=place, expected="two dimensions", found=shape)
    if 8 * max(shape) > max(file_size * MAX_EXPANSION, SMALL_ALLOCATION):
        raise DataError(
            "the dimensions in the header do not fit the file",
            file=path,
            place=place,
            expected="dimensions in proportion to the data",
            found=f"{shape[0]} x {shape[1]} in a file of {file_size} bytes",
            hint="the file is damaged or truncated; export it again",
        )


@contextmanager
def damaged(path: Path, what: str, place: str | None = None) -> Iterator[None]:
    """Turn any error that a library raises on a damaged file into a DataError.

    Libraries raise errors of many kinds on damaged files (zlib, struct, OverflowError, MemoryError ...), so all
    are caught here; an LrbcError passes unchanged.
    """
    try:
        yield
    except LrbcError:
        raise
    except Exception as error:
        found = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        if isinstance(error, EOFError):
            raise ends_early(path, place or what, f"a whole {what}", found) from error
        raise DataError(
            f"this {what} cannot be read",
            file=path,
            place=place,
            expected=f"a valid {what}",
            found=found,
            hint="the file is damaged; export it again",
        ) from error


def fortran_number(cell: str) -> float:
    """Number in Fortran notation, with D for E or an exponent without a letter (1.5-3); zero for an empty cell."""
    text = cell.strip().upper().replace("D", "E")
    return float(text if "E" in text else _BARE.sub(r"E\1", text)) if text else 0.0
