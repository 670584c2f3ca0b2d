"""Reads text files of Abaqus, CalculiX and Sierra/SD that list the entries of a matrix."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats
from lrbc_cli.errors import DataError
from lrbc_cli.io.common import whole
from lrbc_cli.io.encoding import unfinished
from lrbc_cli.io.matrices.columns import is_number, read_columns
from lrbc_cli.io.matrices.foreign import of_elements
from lrbc_cli.io.sparse import MatrixFile, from_coordinates, mirrored
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, COMPONENTS, DofLabels

#: Labels by the number of a DOF in Abaqus; other DOFs are labelled by their number.
_ABAQUS = {**dict(enumerate(COMPONENTS, start=1)), 7: "WARP", 8: ACOUSTIC_COMPONENT, 11: "TEMP"}

#: Text before the entries: blank lines, keywords, comments, words.
_HEAD = re.compile(rb"\A(?:[ \t]*(?:[*%#!A-Za-z][^\r\n]*)?\r?\n)*")

#: Beginning of a matrix in MATLAB notation, where dots continue a line.
_SIERRA = re.compile(rb"^[ \t]*(\w+)[ \t]*=[ \t]*\[(?:[ \t]*\.\.\.)?", re.MULTILINE)

#: Most DOFs of one node: node and DOF are sorted as one combined number.
_MOST = 2**16


def triplets_format(start: bytes) -> str | None:
    """Format by the first bytes: ``abaqus`` (node, DOF, node, DOF, value), ``triplets`` (row, column, value), ``sierra-sd`` or None."""
    if b"\0" in start or of_elements(start):
        return None
    found = _SIERRA.search(start)
    if found and _row(start[found.end() :]) == 3:
        return "sierra-sd"
    head = _HEAD.match(start)
    return {5: "abaqus", 3: "triplets"}.get(_row(start[head.end() if head else 0 :]))


def _row(start: bytes) -> int:
    """Number of words in the first line that is not blank, if all but the last are whole numbers; else 0."""
    line = start.lstrip().split(b"\n")[0]
    words = line.replace(b",", b" ").replace(b";", b" ").split()
    whole = all(re.fullmatch(rb"-?\d+", word) for word in words[:-1])
    return len(words) if len(words) > 1 and whole and is_number(words[-1].upper().replace(b"D", b"E")) else 0


def read_triplets(path: Path, group: str | None = None) -> MatrixFile:
    """Read the entries of a square matrix; if no entry has its mirror image, the matrix is assumed to be symmetric.

    Parameters
    ----------
    path
        A file of Abaqus ``*MATRIX OUTPUT`` (any of its formats), of CalculiX ``SOLVER=MATRIXSTORAGE``, or of Sierra/SD.
    group
        Must be None.

    Returns
    -------
    MatrixFile
        With labels if the lines state nodes and DOFs; rows are sorted by them.

    Raises
    ------
    DataError
        If a line cannot be read, or the numbers are not rows and columns.
    """
    if group:
        raise DataError("the file contains one matrix without a name", file=path, place=group, hint=f"leave out '#{group}'")
    content = whole(path)
    kind = triplets_format(content[:65536])
    if kind is None:
        raise DataError(
            "this is not a list of entries",
            file=path,
            expected="lines of row, column, value or of node, DOF, node, DOF, value",
            found=repr(content[:40].decode("latin-1")),
        )
    begin, end = _HEAD.match(content).end(), len(content)  # type: ignore[union-attr]
    if kind == "sierra-sd":
        begin = _SIERRA.search(content).end()  # type: ignore[union-attr]
        end = content.find(b"]", begin)
        end = len(content) if end < 0 else end
    first = content.count(b"\n", 0, begin) + 1
    warnings = (
        [f"{path.name}: the last line has no line break; if the file was truncated there, its last number is wrong"]
        if unfinished(content)
        else []
    )
    if kind == "abaqus":
        numbers = read_columns(content[begin:end], 5, path, first, "row node, row DOF, column node, column DOF, value")
        labels, row, column = _labelled(numbers, path)
        n = labels.size
    else:
        numbers = read_columns(content[begin:end], 3, path, first, "row, column, value")
        index = _whole(numbers[:, :2], path)
        base = min(int(index.min(initial=1)), 1)
        labels, row, column = None, index[:, 0] - base, index[:, 1] - base
        n = int(index.max(initial=0)) - base + 1
        if base < 0:
            raise DataError("a row is negative", file=path, expected="rows and columns from 1", found=base)
    _once(row, column, n, path)
    matrix, notes = mirrored(from_coordinates(numbers[:, -1], row, column, (n, n), path=path, place="matrix", file_size=len(content)))
    if labels is None and base == 0:
        notes = (*notes, "rows and columns count from 0")
    return MatrixFile(matrix=matrix, format=kind, notes=notes, warnings=tuple(warnings), labels=labels, sized=labels is not None)


def _once(row: NDArray[np.int64], column: NDArray[np.int64], n: int, path: Path) -> None:
    """Refuse repeated entries: the matrices of two runs or steps in one file would be added."""
    place, count = np.unique(row * n + column, return_counts=True)
    again = np.flatnonzero(count > 1)
    if again.size:
        first = int(place[again[0]])
        raise DataError(
            "entries are given twice in the file",
            file=path,
            expected="each entry of an assembled matrix once",
            found=f"{again.size} that are given twice or more, the first at row {first // n + 1}, column {first % n + 1}",
            hint="keep the matrix of one step and one run; element matrices (MATRIX OUTPUT of elements) have to be assembled",
        )


def _labelled(numbers: Floats, path: Path) -> tuple[DofLabels, NDArray[np.int64], NDArray[np.int64]]:
    """Labels of the rows, sorted by node and DOF, and the row and column of each entry."""
    index = _whole(numbers[:, :4], path)
    pairs = np.concatenate([index[:, :2], index[:, 2:4]])
    if pairs.size and (pairs[:, 1].min() < 0 or pairs[:, 1].max() >= _MOST):
        raise DataError("a number of a DOF is out of range", file=path, expected="1 to 6, 8 for a pressure", found=int(pairs[:, 1].max()))
    keys, at = np.unique(pairs[:, 0] * _MOST + pairs[:, 1], return_inverse=True)
    node, dof = np.divmod(keys, _MOST)
    # DOFs that Abaqus adds itself, such as Lagrange multipliers, have neither a place nor a direction.
    component = [_ABAQUS.get(d, f"DOF{d}") if k > 0 else f"INNER{d}" for k, d in zip(node.tolist(), dof.tolist(), strict=True)]
    half = index.shape[0]
    return DofLabels(node, np.array(component, dtype=np.str_)), at[:half].astype(np.int64), at[half:].astype(np.int64)


def _whole(numbers: Floats, path: Path) -> NDArray[np.int64]:
    wrong = np.argwhere((numbers != np.floor(numbers)) | (np.abs(numbers) > 2**40))
    if wrong.size:
        entry, column = wrong[0]
        raise DataError(
            "a label is not a whole number", file=path, place=f"entry {entry + 1}", expected="a whole number", found=numbers[entry, column]
        )
    return np.asarray(numbers.astype(np.int64))
