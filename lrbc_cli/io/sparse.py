"""Turns arrays of any matrix file into one canonical sparse matrix, with the checks that all matrix readers share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, issparse

from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.common import check_dimensions
from lrbc_cli.model.dofs import DofLabels


@dataclass(frozen=True, kw_only=True)
class MatrixFile:
    """A matrix read from a file, with what the reader found out about it.

    Attributes
    ----------
    matrix : scipy.sparse.csc_array
        float64 or complex128; indices sorted, duplicates summed, no explicit zeros.
    format : str
        One of the formats of ``matrices/read.py``.
    notes : tuple of str
        What the reader assumed or noticed; printed by ``lrbc check``.
    warnings : tuple of str
        What may be wrong with the file; printed by every command.
    labels : DofLabels or None
        Node and component of each row, if the file has them.
    sized : bool
        False if the file does not state the number of rows: empty rows at the end may be missing.
    """

    matrix: Any
    format: str
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    labels: DofLabels | None = None
    sized: bool = True


def numeric(array: Any, path: Path, place: str) -> NDArray[Any]:
    """Array as float64 or complex128.

    Raises
    ------
    DataError
        If the array holds no numbers.
    """
    array = np.asarray(array)
    if array.dtype.names is not None and set(array.dtype.names) == {"real", "imag"}:
        # MATLAB and some HDF5 writers store a complex number as a compound type.
        values = np.empty(array.shape, dtype=np.complex128)
        values.real, values.imag = numeric(array["real"], path, place), numeric(array["imag"], path, place)
        return values
    if array.dtype.kind == "c":
        return np.asarray(array, dtype=np.complex128)
    if array.dtype.kind in "fiub":
        return np.asarray(array, dtype=np.float64)
    raise DataError(
        "these are not numbers", file=path, place=place, expected="real or complex numbers", found=f"values of type {array.dtype}"
    )


def from_compressed(
    layout: Literal["csr", "csc"],
    data: Any,
    indices: Any,
    indptr: Any,
    shape: tuple[int, int],
    *,
    path: Path,
    place: str,
    file_size: int,
) -> Any:
    """Canonical CSC matrix from compressed arrays, which are checked before scipy uses them.

    Raises
    ------
    DataError
        If lengths, bounds or the order of ``indptr`` are wrong, or a value is not finite.
    """

    def refuse(problem: str, expected: object, found: object) -> DataError:
        return DataError(
            problem, file=path, place=place, expected=expected, found=found, hint="the file is damaged; export the matrix again"
        )

    check_dimensions(shape, file_size, path, place)
    values = numeric(data, path, place)
    pointers, positions = (_integers(array, name, path, place) for array, name in ((indptr, "indptr"), (indices, "indices")))
    major, minor = shape if layout == "csr" else shape[::-1]
    if values.ndim != 1 or pointers.size != major + 1:
        raise refuse(
            "the index pointer has the wrong length",
            f"{major + 1} pointers for {shape[0]} x {shape[1]} ({layout.upper()})",
            f"{pointers.size} pointers",
        )
    if pointers[0] != 0 or np.any(pointers[1:] < pointers[:-1]):
        raise refuse(
            "the index pointer does not ascend from 0", "0 <= p[0] <= p[1] <= ...", f"first fault at pointer {_first_fall(pointers)}"
        )
    if not pointers[-1] == positions.size == values.size:
        raise refuse(
            "the arrays differ in length",
            f"{int(pointers[-1])} entries by the index pointer",
            f"{positions.size} indices and {values.size} values",
        )
    outside = np.flatnonzero((positions < 0) | (positions >= minor))
    if outside.size:
        raise refuse("an index lies outside the matrix", f"0 to {minor - 1}", f"{int(positions[outside[0]])} at entry {int(outside[0])}")
    kind = np.int32 if max(values.size, *shape) < 2**31 else np.int64
    build = csr_array if layout == "csr" else csc_array
    return canonical(build((values, positions.astype(kind), pointers.astype(kind)), shape=shape), path, place)


def from_coordinates(data: Any, row: Any, column: Any, shape: tuple[int, int], *, path: Path, place: str, file_size: int) -> Any:
    """Canonical CSC matrix from coordinate arrays (0-based); duplicates are summed.

    Raises
    ------
    DataError
        If lengths or bounds are wrong, or a value is not finite.
    """
    check_dimensions(shape, file_size, path, place)
    values = numeric(data, path, place)
    rows, columns = (_integers(array, name, path, place) for array, name in ((row, "row"), (column, "column")))
    if values.ndim != 1 or not values.size == rows.size == columns.size:
        raise DataError(
            "the arrays differ in length",
            file=path,
            place=place,
            expected=f"{values.size} each",
            found=f"{rows.size} rows, {columns.size} columns",
        )
    for name, positions, limit in (("row", rows, shape[0]), ("column", columns, shape[1])):
        outside = np.flatnonzero((positions < 0) | (positions >= limit))
        if outside.size:
            found = f"{int(positions[outside[0]])} at entry {int(outside[0])}"
            raise DataError(f"a {name} index lies outside the matrix", file=path, place=place, expected=f"0 to {limit - 1}", found=found)
    return canonical(coo_array((values, (rows, columns)), shape=shape), path, place)


def canonical(matrix: Any, path: Path, place: str) -> Any:
    """Sparse or dense matrix in canonical form: CSC, float64 or complex128, indices sorted, duplicates summed, no explicit zeros.

    Raises
    ------
    DataError
        If an entry is NaN or infinite; the first such entry is named.
    """
    if not issparse(matrix):
        matrix = np.atleast_2d(numeric(matrix, path, place))
    result = csc_array(matrix)
    if result.dtype.kind not in "fc" or result.dtype.itemsize != (16 if result.dtype.kind == "c" else 8):
        result = result.astype(np.complex128 if result.dtype.kind == "c" else np.float64)
    result.sum_duplicates()
    result.eliminate_zeros()
    result.sort_indices()
    bad = np.flatnonzero(~np.isfinite(result.data))
    if bad.size:
        at = int(bad[0])
        column = int(np.searchsorted(result.indptr, at, side="right")) - 1
        raise DataError(
            "the matrix contains a value that is not a finite number",
            file=path,
            place=f"{place}, row {int(result.indices[at])}, column {column} (counted from 0)",
            expected="finite numbers",
            found=f"{result.data[at]} ({bad.size} such entries in all)",
            hint="export the matrix again, or correct the model that wrote it",
        )
    return result


def require_square(matrix: Any, path: Path, place: str) -> None:
    """Refuse a matrix that is not square.

    Raises
    ------
    DataError
        If the numbers of rows and columns differ, or are zero.
    """
    rows, columns = matrix.shape
    if rows != columns or rows == 0:
        raise DataError("the matrix is not square", file=path, place=place, expected="as many rows as columns", found=f"{rows} x {columns}")


def only_matrix(names: list[str], path: Path, notes: list[str], *, holder: str = "file", beside: list[str], hint: str | None) -> str:
    """Name of the only matrix of a file, used if the campaign names none; a note says so.

    Parameters
    ----------
    names : list of str
        Matrices of the file.
    path : Path
    notes : list of str
        The note is appended.
    holder : str
        Word for the file in messages.
    beside : list of str
        What the file holds instead, listed if it holds no matrix.
    hint : str or None
        What to do in that case.

    Raises
    ------
    DataError
        If there is none, or several.
    """
    if len(names) != 1:
        raise DataError(
            "it is not clear which matrix is meant" if names else f"the {holder} contains no matrix",
            file=path,
            expected="exactly one matrix, or its name after '#'",
            found=listing(names or beside),
            hint="write file#name" if names else hint,
        )
    notes.append(f"using {names[0]!r}, the only matrix in the file")
    return names[0]


def no_such_matrix(name: str, names: list[str], path: Path, holder: str = "file") -> DataError:
    """Error for a name that no matrix of a file has."""
    problem, hint = f"the {holder} contains no such matrix", "give one of these after '#'"
    return DataError(problem, file=path, place=name, expected=repr(name), found=listing(names), hint=hint)


def stored_triangle(matrix: Any, field: NDArray[Any] | None = None) -> str | None:
    """``"lower"`` or ``"upper"`` if the off-diagonal entries within a field all lie in that triangle, else None.

    Parameters
    ----------
    matrix : (n, n) csc_array
    field : (n,) array or None
        Field of each row; None: a single field. Entries between fields do not count: the coupling blocks of u-p models lie in one triangle.
    """
    if matrix.shape[0] != matrix.shape[1]:
        return None
    columns = np.repeat(np.arange(matrix.shape[1], dtype=matrix.indices.dtype), np.diff(matrix.indptr))
    lower, upper = matrix.indices > columns, matrix.indices < columns
    own = np.zeros(matrix.shape[0], dtype=np.int8) if field is None else np.unique(field, return_inverse=True)[1]
    of_row, of_column = own[matrix.indices], own[columns]
    for which in np.unique(own):
        inside = (of_row == which) & (of_column == which)
        below, above = bool(np.any(lower & inside)), bool(np.any(upper & inside))
        if below != above:
            return "lower" if below else "upper"
    return None


def mirrored(matrix: Any) -> tuple[Any, tuple[str, ...]]:
    """Complete a symmetric matrix of which half is stored: if no off-diagonal entry has its mirror image, all mirror images are added.

    Unlike ``stored_triangle``, this does not depend on the order of the rows.

    Returns
    -------
    csc_array, tuple of str
        The matrix, and notes on what was done.
    """
    entries = matrix.tocoo()
    off = entries.row != entries.col
    n = np.int64(matrix.shape[0])
    places, mirror = (a[off].astype(np.int64) * n + b[off] for a, b in ((entries.row, entries.col), (entries.col, entries.row)))
    if not off.any() or np.isin(mirror, places).any():
        return matrix, ()
    half = csc_array((entries.data[off], (entries.col[off], entries.row[off])), shape=matrix.shape)
    whole = csc_array(matrix + half)
    whole.sort_indices()
    return whole, ("stored as one triangle, the other was filled in",)


def _integers(array: Any, name: str, path: Path, place: str) -> NDArray[np.int64]:
    array = np.asarray(array)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        found = f"{array.ndim} dimensions of type {array.dtype}"
        raise DataError(f"{name!r} is not a list of integers", file=path, place=place, expected="one dimension of integers", found=found)
    return np.asarray(array.astype(np.int64))


def _first_fall(pointers: NDArray[np.int64]) -> int:
    falls = np.flatnonzero(pointers[1:] < pointers[:-1])
    return int(falls[0]) + 1 if pointers[0] == 0 and falls.size else 0
