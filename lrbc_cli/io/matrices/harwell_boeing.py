"""Reads Harwell-Boeing (Ansys HBMAT) and Rutherford-Boeing files: assembled matrices in ASCII, symmetric ones as one triangle."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.errors import DataError
from lrbc_cli.io.common import check_allocation, damaged, whole
from lrbc_cli.io.matrices.columns import read_fixed
from lrbc_cli.io.sparse import MatrixFile, from_compressed, mirrored

#: Type of a matrix. First letter: real, complex, integer, pattern, values in another file; second: symmetry; third: assembled or elements.
_TYPE = re.compile(rb"\s*([RCIPQ])([SUHZR])([AE])\b\s+(.*)", re.IGNORECASE)
_FORMAT = re.compile(rb"\(\s*(?:(\d+)\s*P\s*,?\s*)?(\d*)\s*([IEDFG])\s*(\d+)", re.IGNORECASE)

#: Most characters of a line, since the stated format determines how much memory is allocated.
_LONGEST_LINE = 1000


@dataclass(frozen=True, kw_only=True)
class _HbHeader:
    cards: tuple[int, int, int]
    kind: str
    shape: tuple[int, int]
    entries: int
    formats: tuple[tuple[int, int], ...]
    scale: int
    lines: int


def is_harwell_boeing(start: bytes) -> bool:
    """Whether the first bytes of a file are the header of a Harwell-Boeing matrix."""
    lines = start.split(b"\n")
    return len(lines) > 3 and bool(_TYPE.match(lines[2])) and lines[3].lstrip().startswith(b"(") and b"\0" not in start


def read_harwell_boeing(path: Path, group: str | None = None) -> MatrixFile:
    """Read a matrix; the second triangle of symmetric ones is filled in.

    Raises
    ------
    DataError
        If the header is wrong, the matrix is not assembled or has no values, or a number cannot be read.
    """
    if group:
        raise DataError("a Harwell-Boeing file contains one matrix", file=path, place=group, hint=f"leave out '#{group}'")
    with damaged(path, "Harwell-Boeing file"):
        return _read(path)


def _read(path: Path) -> MatrixFile:
    content = whole(path)
    lines = content.replace(b"\r", b"").split(b"\n")
    header = _header(lines, path)
    counts = (header.shape[1] + 1, header.entries, header.entries * (2 if header.kind[0] == "C" else 1))
    # Each number takes at least one byte.
    check_allocation(sum(counts), len(content), path, "line 2")
    parts, at = [], header.lines
    for what, cards, count, layout in zip(("pointers", "rows", "values"), header.cards, counts, header.formats, strict=True):
        parts.append(_numbers(lines[at : at + cards], count, layout, path, f"{what}, lines {at + 1} to {at + cards}"))
        at += cards
    pointers, rows = (_integers(part, path) - 1 for part in parts[:2])
    if header.scale:
        # The scale factor 1P makes numbers without an exponent ten times as large.
        parts[2] /= 10.0**header.scale
    values = parts[2].view(np.complex128) if header.kind[0] == "C" else parts[2]
    matrix = from_compressed("csc", values, rows, pointers, header.shape, path=path, place="matrix", file_size=len(content))
    notes: tuple[str, ...] = ()
    if header.kind[1] == "S":
        matrix, notes = mirrored(matrix)
    return MatrixFile(matrix=matrix, format="harwell-boeing", notes=notes)


def _header(lines: list[bytes], path: Path) -> _HbHeader:
    def wrong(line: int, expected: str) -> DataError:
        found = repr(lines[line - 1][:60].decode("latin-1")) if line <= len(lines) else "the end of the file"
        return DataError("the header is wrong", file=path, place=f"line {line}", expected=expected, found=found)

    if len(lines) < 5:
        raise wrong(len(lines), "five lines of header")
    found = _TYPE.match(lines[2])
    numbers = found[4].split() if found else []
    if not found or len(numbers) < 3 or not all(map(bytes.isdigit, numbers[:3])):
        raise wrong(3, "a type such as RSA, rows, columns and entries")
    kind = (found[1] + found[2] + found[3]).decode().upper()
    if kind[0] in "PQ" or kind[1] in "HZ" or kind[2] == "E":
        raise DataError(
            "the matrix has no values" if kind[0] in "PQ" else "the matrix is not assembled" if kind[2] == "E" else "this type is not read",
            file=path,
            place="line 3",
            expected="RSA, RUA, CSA or CUA (ISA, IUA of integers)",
            found=kind,
            hint="export the assembled matrix with its values",
        )
    cards = lines[1].split()
    if len(cards) < 4 or not all(map(bytes.isdigit, cards[:4])):
        raise wrong(2, "the number of lines of each part")
    described = _FORMAT.findall(lines[3])
    formats = [(int(count or 1), int(width)) for _, count, _, width in described]
    if len(formats) < 3 or any(not 0 < count * width <= _LONGEST_LINE for count, width in formats):
        raise wrong(4, "Fortran formats of pointers, rows and values")
    scale, _, letter, _ = described[2]
    # Some programs write the line on right-hand sides even if there are none; lines of pointers have no letter.
    with_rhs = bool(re.match(rb"\s*[FM]", lines[4], re.IGNORECASE))
    counts = [int(card) for card in cards]
    return _HbHeader(
        cards=(counts[1], counts[2], counts[3]),
        kind=kind,
        shape=(int(numbers[0]), int(numbers[1])),
        entries=int(numbers[2]),
        formats=tuple(formats[:3]),
        scale=int(scale or 0) if letter in b"Ff" else 0,
        lines=5 if with_rhs else 4,
    )


def _numbers(lines: list[bytes], count: int, layout: tuple[int, int], path: Path, place: str) -> Floats:
    """Read `count` numbers in columns of fixed width."""
    a_line, width = layout
    text = b"".join(line.ljust(a_line * width)[: a_line * width] for line in lines)
    numbers = read_fixed(text[: count * width], width)
    if numbers is None or numbers.size != count:
        # SciPy writes cells narrower than the stated format, with a blank between them.
        words = [line.split() for line in lines]
        spaced = all(len(row) <= a_line for row in words) and sum(map(len, words)) == count
        numbers = read_fixed(b"".join(word.ljust(width)[:width] for row in words for word in row), width) if spaced else None
    if numbers is None or numbers.size != count:
        raise DataError(
            "the numbers cannot be read",
            file=path,
            place=place,
            expected=f"{count} numbers of {width} characters",
            found="other text" if numbers is None else f"{numbers.size} numbers",
            hint="the file is truncated or damaged; export it again",
        )
    return numbers


def _integers(numbers: Floats, path: Path) -> Integers:
    if np.any((numbers != np.floor(numbers)) | (np.abs(numbers) > 2**53)):
        raise DataError("a pointer or row is not a whole number", file=path, expected="whole numbers")
    return np.asarray(numbers.astype(np.int64))
