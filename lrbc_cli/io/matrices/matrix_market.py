"""Reads Matrix Market files, plain or compressed with gzip.

The numbers are parsed with NumPy: the reader of scipy (1.17) ends the whole process on some truncated files, and reads
a damaged number such as ``1e`` as 1.
"""

from __future__ import annotations

import gzip
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import (
    LONGEST_NUMBER,
    MAX_EXPANSION,
    ROOM,
    check_allocation,
    check_dimensions,
    check_expansion,
    damaged,
    ends_early,
    head,
    require_file,
)
from lrbc_cli.io.encoding import unfinished
from lrbc_cli.io.matrices.columns import is_number, parsed, words_a_line
from lrbc_cli.io.sparse import MatrixFile, canonical, from_coordinates

BANNER = b"%%matrixmarket"
_FIELDS = ("real", "complex", "integer", "unsigned-integer", "double")
# Bytes of a compressed file that are unpacked to read its header: room for some thousand lines of comment.
_HEADER_ROOM = 1 << 20
_SYMMETRIES = ("general", "symmetric", "skew-symmetric", "hermitian")


@dataclass(frozen=True, kw_only=True)
class _Header:
    layout: str
    field: str
    symmetry: str
    shape: tuple[int, int]
    entries: int
    line: int
    offset: int

    @property
    def parts(self) -> int:
        """Numbers in each value: 2 if complex, else 1."""
        return 2 if self.field == "complex" else 1

    @property
    def width(self) -> int:
        """Numbers in each line."""
        return self.parts + (2 if self.layout == "coordinate" else 0)


def is_matrix_market(start: bytes) -> bool:
    """Whether the first bytes of a file (unpacked) are a Matrix Market banner."""
    return start[: len(BANNER)].lower() == BANNER


def read_matrix_market(path: Path, group: str | None = None) -> MatrixFile:
    """Read a matrix in coordinate or array layout, completed by the symmetry that the banner states.

    Parameters
    ----------
    path
        A ``.mtx`` file, or one compressed with gzip.
    group
        Must be None.

    Raises
    ------
    DataError
        If the banner, sizes or entries are wrong, or the file holds a pattern without values.
    """
    if group:
        raise DataError("a Matrix Market file contains one matrix without a name", file=path, place=group, hint=f"leave out '#{group}'")
    size = require_file(path)
    packed = head(path, 2) == b"\x1f\x8b"
    with damaged(path, "gzip file" if packed else "Matrix Market file"):
        content = _unpacked(path, size) if packed else path.read_bytes()
    header = _header(content, path)
    body = content[header.offset :].strip()
    # A number takes at least one digit and a blank.
    check_allocation(2 * header.width * header.entries - 1, len(content), path, f"line {header.line}")
    numbers = _numbers(body, header, path)
    warnings = []
    if not packed and unfinished(content):
        # A compressed file has a checksum of its own.
        warnings.append(f"{path.name}: the last line has no line break; if the file was truncated there, its last number is wrong")
    if header.layout == "array":
        values = numbers.view(np.complex128) if header.parts == 2 else numbers
        matrix = canonical(_unpack(values.ravel(), header), path, "matrix")
    else:
        check_dimensions(header.shape, size, path, f"line {header.line}")
        if not words_a_line(body, header.width):
            raise _bad_line(body, header, path)
        matrix = _assemble(numbers, body, header, path, size)
        if header.symmetry == "general" and (double := _doubles(numbers, matrix, header)):
            warnings.append(
                f"{path.name}: {double} of {header.entries} entries have the row and column of an earlier entry and are added to it"
            )
    return MatrixFile(matrix=matrix, format="matrix-market", notes=_notes(header), warnings=tuple(warnings))


def _unpacked(path: Path, size: int) -> bytes:
    """Content of a gzip file, unpacked no further than its header requires."""
    with gzip.open(path, "rb") as stream:
        start = stream.read(_HEADER_ROOM)
        if len(start) < _HEADER_ROOM:
            return start
        header = _header(start, path)
        place = f"line {header.line}"
        # Checks the size of the numbers before they are unpacked.
        check_expansion(8 * header.width * header.entries, size, path, place)
        most = header.offset + header.width * header.entries * (LONGEST_NUMBER + 1) + _HEADER_ROOM
        limit = min(most, max(MAX_EXPANSION * size, ROOM))
        rest = stream.read(max(limit - len(start), 0) + 1)
        if len(start) + len(rest) > limit:
            check_expansion(len(start) + len(rest), size, path, place)
            raise DataError(
                "the file contains more than its header states",
                file=path,
                place=place,
                expected=f"{header.entries} entries",
                found="more text",
            )
        return start + rest


def _numbers(body: bytes, header: _Header, path: Path) -> NDArray[np.float64]:
    """Numbers after the size line, (entries, width)."""
    numbers = parsed(body)
    if numbers is None or numbers.size != header.width * header.entries:
        raise _bad_line(body, header, path)
    return numbers.reshape(header.entries, header.width)


def _doubles(numbers: NDArray[np.float64], matrix: Any, header: _Header) -> int:
    """Number of entries of a general file with the same row and column as another one."""
    if matrix.nnz + int((~numbers[:, 2:].any(axis=1)).sum()) == header.entries:
        return 0
    places = (numbers[:, 0].astype(np.int64) - 1) * header.shape[1] + numbers[:, 1].astype(np.int64)
    return int(places.size - np.unique(places).size)


def _bad_line(body: bytes, header: _Header, path: Path) -> DataError:
    """Error for the first wrong line, or for too many or too few lines."""
    expected = "row, column, " + ("real and imaginary part" if header.parts == 2 else "value")
    if header.layout == "array":
        expected = "real and imaginary part" if header.parts == 2 else "a value"
    lines = _entry_lines(body, header)
    for count, (number, line) in enumerate(lines, start=1):
        words = line.split()
        if len(words) != header.width or not all(is_number(word) for word in words):
            found = repr(line[:60].decode("latin-1"))
            if count == len(lines) <= header.entries and len(words) <= header.width and all(map(is_number, words[:-1])):
                return ends_early(path, f"line {number}", f"{header.entries} entries", f"{count - 1} entries, then {found}")
            return DataError("an entry cannot be read", file=path, place=f"line {number}", expected=expected, found=found)
    found = f"{len(lines)} entries"
    expected = f"{header.entries} entries"
    if len(lines) < header.entries:
        return ends_early(path, f"line {lines[-1][0]}" if lines else f"line {header.line}", expected, found)
    hint = "the header is wrong, or something was added: export it again"
    return DataError("the number of entries is wrong", file=path, place=f"line {header.line}", expected=expected, found=found, hint=hint)


def _entry_lines(body: bytes, header: _Header) -> list[tuple[int, bytes]]:
    return [(header.line + 1 + number, line) for number, line in enumerate(body.split(b"\n")) if line.strip()]


def _assemble(numbers: NDArray[np.float64], body: bytes, header: _Header, path: Path, size: int) -> Any:
    """Matrix of a coordinate file, completed by the symmetry of the banner."""
    for column, (name, limit) in enumerate(zip(("row", "column"), header.shape, strict=True)):
        index = numbers[:, column]
        bad = np.flatnonzero(~((index >= 1) & (index <= limit)) | (index != np.floor(index)))
        if bad.size:
            lines = _entry_lines(body, header)
            place = f"line {lines[int(bad[0])][0]}" if len(lines) == header.entries else f"entry {int(bad[0]) + 1}"
            found = f"{index[bad[0]]:.10g}"
            raise DataError(f"a {name} is outside the matrix", file=path, place=place, expected=f"1 to {limit}", found=found)
    row, column_ = (numbers[:, at].astype(np.int64) - 1 for at in (0, 1))
    values = numbers[:, 2:].copy().view(np.complex128).ravel() if header.parts == 2 else numbers[:, 2]
    if header.symmetry != "general":
        off = row != column_
        _refuse_doubles(row, column_, header, path)
        values = np.concatenate([values, _mirror(values[off], header.symmetry)])
        row, column_ = np.concatenate([row, column_[off]]), np.concatenate([column_, row[off]])
    return from_coordinates(values, row, column_, header.shape, path=path, place="matrix", file_size=size)


def _mirror(values: NDArray[Any], symmetry: str) -> NDArray[Any]:
    if symmetry == "hermitian":
        return np.asarray(np.conj(values))
    return np.negative(values) if symmetry == "skew-symmetric" else values


def _unpack(values: NDArray[Any], header: _Header) -> NDArray[Any]:
    """Dense matrix of an array file, stored by columns; symmetric ones by the lower triangle only."""
    rows, columns = header.shape
    if header.symmetry == "general":
        return values.reshape((rows, columns), order="F")
    matrix = np.zeros((rows, columns), dtype=values.dtype)
    column, row = np.triu_indices(rows, 1 if header.symmetry == "skew-symmetric" else 0)
    matrix[row, column] = values
    off = row != column
    matrix[column[off], row[off]] = _mirror(values[off], header.symmetry)
    return matrix


def _header(content: bytes, path: Path) -> _Header:
    stream = io.BytesIO(content)
    banner = stream.readline(1024).decode("latin-1").lower().split()
    if not banner or banner[0] != BANNER.decode():
        raise DataError(
            "this is not a Matrix Market file",
            file=path,
            place="line 1",
            expected="a banner '%%MatrixMarket matrix coordinate real general'",
            found="another first line",
            hint="leave out `format:`, so that the format is recognised by the content",
        )
    words = (*banner[1:], "", "", "", "")[:4]
    kind, layout, field, symmetry = words
    if kind != "matrix" or layout not in ("coordinate", "array") or field not in (*_FIELDS, "pattern") or symmetry not in _SYMMETRIES:
        raise DataError(
            "the banner contains an unknown word",
            file=path,
            place="line 1",
            expected=f"matrix, coordinate or array, {' or '.join(_FIELDS)}, {' or '.join(_SYMMETRIES)}",
            found=" ".join(banner[1:]),
        )
    if field == "pattern":
        raise DataError(
            "the file contains only a pattern, no values",
            file=path,
            place="line 1",
            expected="real or complex values",
            found="pattern",
            hint="export values",
        )
    number = 1
    while line := stream.readline(4096):
        number += 1
        text = line.decode("latin-1").strip()
        if text and not text.startswith("%"):
            break
    else:
        raise DataError(
            "the size line is missing", file=path, place=f"line {number}", expected="rows, columns and entries", found="the end of the file"
        )
    count = 3 if layout == "coordinate" else 2
    numbers = text.split()
    if len(numbers) != count or not all(part.isascii() and part.isdigit() and len(part) < 19 for part in numbers):
        raise DataError("the size line is wrong", file=path, place=f"line {number}", expected=f"{count} whole numbers", found=text[:80])
    rows, columns = int(numbers[0]), int(numbers[1])
    entries = int(numbers[2]) if layout == "coordinate" else rows * columns
    if symmetry != "general":
        if rows != columns:
            raise DataError(
                f"a {symmetry} matrix must be square",
                file=path,
                place=f"line {number}",
                expected="rows = columns",
                found=f"{rows} x {columns}",
            )
        if layout == "array":
            entries = rows * (rows - 1) // 2 if symmetry == "skew-symmetric" else rows * (rows + 1) // 2
    return _Header(layout=layout, field=field, symmetry=symmetry, shape=(rows, columns), entries=entries, line=number, offset=stream.tell())


def _refuse_doubles(row: NDArray[np.int64], column: NDArray[np.int64], header: _Header, path: Path) -> None:
    """Refuse a symmetric banner if entries would count twice: a full matrix, pairs in both triangles, repeated places."""
    low, high = np.minimum(row, column), np.maximum(row, column)
    places = low * header.shape[1] + high
    unique, first, count = np.unique(places, return_index=True, return_counts=True)
    if unique.size == places.size:
        return
    at = int(first[count > 1].min())
    same = np.flatnonzero(places == places[at])
    mirrored = np.unique(row[same]).size > 1
    raise DataError(
        "both triangles are stored, but the banner says that only one is"
        if mirrored
        else "an entry is given twice under a symmetric banner",
        file=path,
        place="line 1" if mirrored else f"row {row[at] + 1}, column {column[at] + 1}",
        expected="entries of one triangle, each once, or the word 'general'",
        found=f"{places.size} entries in {unique.size} places, the first duplicate at row {row[at] + 1}, column {column[at] + 1}",
        hint="change the last word of the banner to 'general' if the file contains the whole matrix, or export one triangle, each entry "
        "once",
    )


def _notes(header: _Header) -> tuple[str, ...]:
    return () if header.symmetry == "general" else (f"{header.symmetry} banner: the other triangle was filled in",)
