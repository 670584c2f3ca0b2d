"""Reads Nastran OP4 files (``OUTPUT4``), binary and ASCII, dense and sparse; they do not contain the DOFs of the rows."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import damaged, whole
from lrbc_cli.io.matrices.columns import read_fixed
from lrbc_cli.io.sparse import MatrixFile, from_coordinates, mirrored, no_such_matrix, only_matrix

#: First line of a matrix in ASCII: columns, rows (negative: BIGMAT), form, type, name, numbers a line, characters of each.
_LINE = re.compile(rb"([ \d]{8})([- \d]{8})([ \d]{8})([ \d]{8})(.{8})1P,\s*(\d+)[ED](\d+)\.\d+")

#: Bytes of the first record of a matrix, and the form number of symmetric ones.
_HEADER, _SYMMETRIC = 24, 6

#: Row and length of a string of numbers are packed into one word with this factor, except in BIGMAT.
_PACK = 65536

_DTYPES = {1: "f4", 2: "f8", 3: "c8", 4: "c16"}


@dataclass(kw_only=True)
class _Op4Matrix:
    """A matrix while its strings of numbers are collected.

    ``strings`` has column, first row (both from 1) and length of each; ``cell`` is the width of a number in ASCII, 0 in binary.
    """

    name: str
    columns: int
    rows: int
    form: int
    type: int
    cell: int = 0
    strings: list[tuple[int, int, int]] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)

    @property
    def parts(self) -> int:
        """Numbers in each value: 2 if complex, else 1."""
        return 2 if self.type > 2 else 1

    @property
    def words(self) -> int:
        """Words in each value."""
        return self.parts * (2 if self.type in (2, 4) else 1)

    def values(self, order: str) -> Any:
        """Values of all strings; None if there is other text."""
        joined = b"".join(self.data)
        if not self.cell:
            return np.frombuffer(joined, dtype=order + _DTYPES[self.type])
        numbers = read_fixed(joined, self.cell)
        return numbers if numbers is None or self.parts == 1 or numbers.size % 2 else numbers.view(np.complex128)


def is_op4(start: bytes) -> bool:
    """Whether the first bytes of a file are the header of a matrix in OP4."""
    return bool(_LINE.match(start)) or _order(start) is not None


def _order(start: bytes) -> str | None:
    """Byte order of a binary file; None for other files."""
    if len(start) < _HEADER + 8:
        return None
    for order in "<>":
        first, columns, rows, form, kind = struct.unpack_from(order + "5i", start)
        last = struct.unpack_from(order + "i", start, _HEADER + 4)[0]
        if first == last == _HEADER and columns > 0 and rows != 0 and 0 < form < 16 and kind in _DTYPES:
            return order
    return None


def read_op4(path: Path, group: str | None = None) -> MatrixFile:
    """Read one matrix.

    Parameters
    ----------
    path
        The file.
    group
        Name of the matrix; may be None if the file holds only one.

    Raises
    ------
    DataError
        If the file is damaged or holds no such matrix.
    """
    content = whole(path)
    order = _order(content[:64])
    found, told = _matrices(path, content), list[str]()
    names = [matrix.name for matrix in found]
    name = group or only_matrix(names, path, told, beside=[], hint=None)
    chosen = [matrix for matrix in found if matrix.name.upper() == name.upper()]
    if len(chosen) != 1:
        raise no_such_matrix(name, names, path)
    matrix = chosen[0]
    strings = np.array(matrix.strings, dtype=np.int64).reshape(-1, 3)
    values = matrix.values(order or "<")
    if values is None or values.size != strings[:, 2].sum():
        raise DataError("a number cannot be read", file=path, place=matrix.name, expected="numbers as the header says", found="other data")
    column = np.repeat(strings[:, 0] - 1, strings[:, 2])
    begin = np.cumsum(strings[:, 2]) - strings[:, 2]
    row = np.arange(column.size) - np.repeat(begin - strings[:, 1] + 1, strings[:, 2])
    result = from_coordinates(values, row, column, (matrix.rows, matrix.columns), path=path, place=matrix.name, file_size=len(content))
    result, notes = mirrored(result) if matrix.form == _SYMMETRIC else (result, ())
    return MatrixFile(matrix=result, format="nastran-op4", notes=(*told, *notes))


def op4_names(path: Path) -> list[str]:
    """Names of the matrices of a file; raises as ``read_op4``."""
    return [matrix.name for matrix in _matrices(path, whole(path))]


def _matrices(path: Path, content: bytes) -> list[_Op4Matrix]:
    order = _order(content[:64])
    with damaged(path, "OP4 file"):
        return list(_ascii(content) if order is None else _binary(content, order))


def _strings(matrix: _Op4Matrix, column: int, row: int, words: int, take: Any, integers: Any, big: bool) -> None:
    """Append the strings of one column of `words` words; ``take(n)`` returns the data of n values, ``integers(n)`` n whole numbers."""
    if row > 0:
        # Lengths count numbers in dense columns of ASCII files, words in all others.
        count = words // (matrix.parts if matrix.cell else matrix.words)
        matrix.strings.append((column, row, count))
        matrix.data.append(take(count))
        return
    while words > 0:
        if big:
            length, first = integers(2)
            length -= 1
        else:
            length, first = divmod(integers(1)[0], _PACK)
            length -= 1
        words -= length + (2 if big else 1)
        if length <= 0 or words < 0:
            raise ValueError(f"a string of {length} words in column {column}")
        matrix.strings.append((column, first, length // matrix.words))
        matrix.data.append(take(length // matrix.words))


def _binary(content: bytes, order: str) -> Iterator[_Op4Matrix]:
    at = 0
    while at + _HEADER + 8 <= len(content):
        _, columns, rows, form, kind = struct.unpack_from(order + "5i", content, at)
        name = content[at + 20 : at + 28].decode("latin-1").strip()
        if kind not in _DTYPES:
            raise ValueError(f"type {kind} of {name!r}")
        matrix, big = _Op4Matrix(name=name, columns=columns, rows=abs(rows), form=form, type=kind), rows < 0
        at += _HEADER + 8
        column = 0
        while column <= columns:
            if at + 16 > len(content):
                raise ValueError(f"{name!r} is cut off in column {column}")
            size, column, row, words = struct.unpack_from(order + "4i", content, at)
            record = content[at + 16 : at + 4 + size]
            if size < 12 or at + size + 8 > len(content):
                raise ValueError(f"a record of {size} bytes in column {column}")
            at += size + 8
            if column > columns:
                break
            position = 0

            def advance(count: int, record: bytes = record) -> bytes:
                nonlocal position
                part = record[position : position + count]
                position += count
                if len(part) < count:
                    raise ValueError(f"a record of {len(record)} bytes is too short")
                return part

            _strings(
                matrix,
                column,
                row,
                words,
                lambda count, advance=advance, m=matrix: advance(4 * m.words * count),
                lambda count, advance=advance: struct.unpack(f"{order}{count}i", advance(4 * count)),
                big,
            )
        yield matrix


def _ascii(content: bytes) -> Iterator[_Op4Matrix]:
    lines = content.replace(b"\r", b"").split(b"\n")
    at = 0

    def integers(count: int) -> list[int]:
        nonlocal at
        at += 1
        return [int(word) for word in lines[at - 1].split()[:count]]

    while at < len(lines) and lines[at].strip():
        found = _LINE.match(lines[at])
        if not found:
            raise ValueError(f"line {at + 1} begins no matrix")
        columns, rows, form, kind, a_line, cell = (int(found[k]) for k in (1, 2, 3, 4, 6, 7))
        if kind not in _DTYPES or not 0 < a_line * cell < 1000:
            raise ValueError(f"type {kind}, {a_line} numbers of {cell} characters in line {at + 1}")
        matrix = _Op4Matrix(name=found[5].decode("latin-1").strip(), columns=columns, rows=abs(rows), form=form, type=kind, cell=cell)
        at += 1

        def take(count: int, matrix: _Op4Matrix = matrix, a_line: int = a_line) -> bytes:
            nonlocal at
            numbers = count * matrix.parts
            height = -(-numbers // a_line)
            part = lines[at : at + height]
            at += height
            return b"".join(line.ljust(a_line * matrix.cell) for line in part)[: numbers * matrix.cell]

        while True:
            column, row, words = integers(3)
            if column > columns:
                # The matrix ends with a column beyond the last one, which has one number.
                take(1)
                break
            _strings(matrix, column, row, words, take, integers, rows < 0)
        yield matrix
