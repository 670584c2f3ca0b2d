"""Matrix Market files, plain or compressed with gzip."""

from __future__ import annotations

import gzip
import inspect
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import mmread
from scipy.sparse import coo_array
from threadpoolctl import threadpool_limits

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import check_allocation, check_dimensions, damaged, require_file
from lrbc_cli.io.sparse import MatrixFile, canonical, stored_triangle

BANNER = b"%%matrixmarket"
_FIELDS = ("real", "complex", "integer", "unsigned-integer", "double")
_SYMMETRIES = ("general", "symmetric", "skew-symmetric", "hermitian")
# Sparse arrays, not the older sparse matrices, wherever scipy lets one ask for them.
_SPARSE_ARRAYS: dict[str, Any] = {"spmatrix": False} if "spmatrix" in inspect.signature(mmread).parameters else {}


@dataclass(frozen=True)
class _Header:
    layout: str
    field: str
    symmetry: str
    shape: tuple[int, int]
    entries: int


def is_matrix_market(start: bytes) -> bool:
    """Whether the first bytes of a file (unpacked) are a Matrix Market banner."""
    return start[: len(BANNER)].lower() == BANNER


def read_matrix_market(path: Path, *, threads: int = 1) -> MatrixFile:
    """Read a matrix in coordinate or array layout; the banner's symmetry is honoured.

    Parameters
    ----------
    path
        A ``.mtx`` file, or one compressed with gzip.
    threads
        Number of threads that may parse the text.

    Raises
    ------
    DataError
        If the banner, sizes or entries are wrong, or the file holds a pattern without values.
    """
    size = require_file(path)
    with path.open("rb") as stream:
        packed = stream.read(2) == b"\x1f\x8b"
    with damaged(path, "gzip file" if packed else "Matrix Market file"):
        content = gzip.decompress(path.read_bytes()) if packed else path.read_bytes()
    header = _header(content, path)
    # The shortest entry is "1 1 0" and a line end; of the array layout, one digit and a line end.
    if header.layout == "coordinate":
        check_allocation(6 * header.entries - 1, len(content), path, "size line")
        check_dimensions(header.shape, size, path, "size line")
    else:
        check_allocation(2 * header.entries - 1, len(content), path, "size line")
    try:
        with threadpool_limits(limits=threads, user_api="scipy"):
            raw = mmread(io.BytesIO(content), **_SPARSE_ARRAYS)
    except (ValueError, OverflowError, MemoryError, EOFError) as error:
        line = re.match(r"Line (\d+): *(.*)", str(error))
        raise DataError(
            "an entry of the Matrix Market file cannot be read",
            file=path,
            place=f"line {line.group(1)}" if line else None,
            expected=f"{header.entries} entries of a {header.shape[0]} x {header.shape[1]} {header.field} matrix",
            found=line.group(2) if line else str(error),
            hint="the file is damaged or truncated; export it again",
        ) from error
    if header.layout == "coordinate" and header.symmetry != "general":
        _refuse_both_triangles(raw, path)
    with damaged(path, "Matrix Market file"):
        matrix = canonical(raw, path, "matrix")
    return MatrixFile(matrix, "matrix-market", _notes(header, matrix))


def explain_text(start: bytes) -> str | None:
    """Say what a text file that is no Matrix Market file looks like, or None."""
    lines = [line.strip() for line in start.decode("latin-1").splitlines()]
    lines = [line for line in lines if line]
    if any(re.match(r"\*(MATRIX|USER ELEMENT|\*)", line, re.IGNORECASE) for line in lines[:20]):
        return "an Abaqus matrix (its keywords start with *), not a Matrix Market file"
    if lines and re.fullmatch(r"-?\d+\s*,\s*-?\d+\s*,\s*-?\d+\s*,\s*-?\d+\s*,\s*[-+\d.eEdD]+\s*,?", lines[0]):
        return "an Abaqus matrix (row node, row DOF, column node, column DOF, value), not a Matrix Market file"
    if lines and re.fullmatch(r"\d+\s*[\s,]\s*\d+\s*[\s,]\s*[-+\d.eEdD]+\s*,?", lines[0]):
        return "a list of row, column, value without a header (Abaqus COORDINATE or CalculiX), not a Matrix Market file"
    return None


def _header(content: bytes, path: Path) -> _Header:
    stream = io.BytesIO(content)
    banner = stream.readline(1024).decode("latin-1").lower().split()
    if not banner or banner[0] != BANNER.decode():
        found = explain_text(content[:4096]) or "another first line"
        raise DataError(
            "this is not a Matrix Market file",
            file=path,
            place="line 1",
            expected="a banner '%%MatrixMarket matrix coordinate real general'",
            found=found,
            hint="convert the matrix to Matrix Market, HDF5, MATLAB or .npz",
        )
    words = (*banner[1:], "", "", "", "")[:4]
    kind, layout, field, symmetry = words
    if kind != "matrix" or layout not in ("coordinate", "array") or field not in (*_FIELDS, "pattern") or symmetry not in _SYMMETRIES:
        raise DataError(
            "the banner names something unknown",
            file=path,
            place="line 1",
            expected=f"matrix, coordinate or array, {' or '.join(_FIELDS)}, {' or '.join(_SYMMETRIES)}",
            found=" ".join(banner[1:]),
        )
    if field == "pattern":
        raise DataError(
            "the file holds only a pattern, no values",
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
    return _Header(layout, field, symmetry, (rows, columns), entries)


def _refuse_both_triangles(raw: Any, path: Path) -> None:
    """Refuse a symmetric banner over a full matrix: its off-diagonal entries would count twice."""
    entries = coo_array(raw)
    row, column = entries.coords
    off = row != column
    if not np.any(off):
        return
    places = row[off].astype(np.int64) * entries.shape[1] + column[off]
    unique = np.unique(places).size
    if 2 * unique <= places.size:
        raise DataError(
            "both triangles are stored though the banner says that one is",
            file=path,
            place="line 1",
            expected="entries of one triangle, or the word 'general'",
            found=f"{places.size // 2} off-diagonal entries at {unique} places",
            hint="change the banner's last word to 'general', or export one triangle",
        )


def _notes(header: _Header, matrix: Any) -> tuple[str, ...]:
    notes = []
    triangle = stored_triangle(matrix)
    if header.symmetry == "general" and triangle:
        notes.append(
            f"only the {triangle} triangle is stored though the banner says general; the matrix is used as it stands, "
            "write 'symmetric' in the banner if the other triangle is its mirror image"
        )
    if header.symmetry != "general":
        notes.append(f"{header.symmetry} banner: the other triangle was filled in")
    return tuple(notes)
