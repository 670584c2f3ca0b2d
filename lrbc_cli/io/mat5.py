"""Matrices in MATLAB files up to version 7 (level 5)."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat
from scipy.sparse import issparse

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import check_allocation, check_dimensions, damaged, listing, require_file
from lrbc_cli.io.sparse import MatrixFile, canonical, from_compressed

_SPARSE_ARRAYS: dict[str, Any] = {"spmatrix": False} if "spmatrix" in inspect.signature(loadmat).parameters else {}
_NUMERIC = {
    "double": 8,
    "single": 4,
    "int8": 1,
    "uint8": 1,
    "int16": 2,
    "uint16": 2,
    "int32": 4,
    "uint32": 4,
    "int64": 8,
    "uint64": 8,
    "logical": 1,
}


def is_mat5(start: bytes) -> bool:
    """Whether the first bytes of a file are the header of a MATLAB level 5 file."""
    return start[:10] == b"MATLAB 5.0" or (
        len(start) >= 128 and start[:6] == b"MATLAB" and start[126:128] in (b"IM", b"MI") and start[7:10] != b"7.3"
    )


def list_variables(path: Path) -> list[tuple[str, tuple[int, ...], str]]:
    """Name, shape and class of every variable, without reading the values.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    require_file(path)
    with damaged(path, "MATLAB file"):
        return [(str(name), tuple(int(n) for n in shape), str(kind)) for name, shape, kind in whosmat(str(path), appendmat=False)]


def load_variables(path: Path, names: list[str]) -> dict[str, Any]:
    """Values of numeric variables; sparse ones are not checked yet.

    Raises
    ------
    DataError
        If the file is damaged or claims more than it holds.
    """
    size = require_file(path)
    for name, shape, kind in list_variables(path):
        if name in names and kind in _NUMERIC:
            check_allocation(int(np.prod([float(n) for n in shape])) * _NUMERIC[kind], size, path, name, compressed=True)
        elif name in names and kind == "sparse":
            check_dimensions(shape, size, path, name)
    with damaged(path, "MATLAB file"):
        found = loadmat(str(path), variable_names=names, appendmat=False, **_SPARSE_ARRAYS)
    return {name: found[name] for name in names if name in found}


def read_mat5_matrix(path: Path, group: str | None = None) -> MatrixFile:
    """Read one sparse or dense matrix.

    Parameters
    ----------
    path
        The file.
    group
        Name of the variable; may be left out where the file holds exactly one matrix.

    Raises
    ------
    DataError
        If the file is damaged, the variable is not there or it is not a matrix.
    """
    variables = list_variables(path)
    names = [name for name, shape, kind in variables if (kind == "sparse" or kind in _NUMERIC) and len(shape) == 2]
    notes: list[str] = []
    if not group:
        if len(names) != 1:
            raise DataError(
                "it is not clear which matrix is meant" if names else "the file holds no matrix",
                file=path,
                expected="exactly one matrix, or its name after '#'",
                found=listing(names or [f"{name} ({kind})" for name, _, kind in variables]),
                hint="write file#name" if names else None,
            )
        group = names[0]
        notes.append(f"took {group!r}, the only matrix in the file")
    if group not in names:
        raise DataError(
            "the file holds no such matrix",
            file=path,
            place=group,
            expected=repr(group),
            found=listing(names),
            hint="name one of these after '#'",
        )
    value = load_variables(path, [group]).get(group)
    if value is None:
        raise DataError("the variable cannot be read", file=path, place=group, hint="the file is damaged; export it again")
    with damaged(path, "MATLAB variable", group):
        if issparse(value):
            csc = value.tocsc() if value.format != "csc" else value
            matrix = from_compressed(
                "csc", csc.data, csc.indices, csc.indptr, csc.shape, path=path, place=group, file_size=require_file(path)
            )
        else:
            notes.append(f"{group!r} is stored dense")
            matrix = canonical(value, path, group)
    return MatrixFile(matrix, "mat-v5", tuple(notes))
