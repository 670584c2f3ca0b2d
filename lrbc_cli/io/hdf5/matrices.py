"""Reads sparse and dense matrices from HDF5: CSR/CSC groups, two-dimensional data sets, and MATLAB 7.3 files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np

from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.common import head
from lrbc_cli.io.hdf5.layouts import MESH, ArrayNames, arrays_of, groups_in, holds_exodus
from lrbc_cli.io.hdf5.tools import load, lookup, open_hdf5, read_safely, shape_attribute, text_attribute
from lrbc_cli.io.sparse import MatrixFile, canonical, from_compressed, no_such_matrix, only_matrix

__all__ = ["ArrayNames", "hdf5_matrix_names", "read_hdf5_matrix"]

_VERSIONS = ("0.1.0",)


def read_hdf5_matrix(path: Path, group: str | None = None, arrays: ArrayNames | None = None) -> MatrixFile:
    """Read one matrix of an HDF5 or MATLAB 7.3 file.

    It may be a group ``data, indices, indptr`` with the attributes ``encoding-type`` (``csr_matrix`` or
    ``csc_matrix``) and ``shape``, or with the older ``h5sparse_format`` and ``h5sparse_shape``; a sparse group
    ``data, ir, jc`` of MATLAB with the attribute ``MATLAB_sparse``; or a two-dimensional dataset, which is transposed
    for MATLAB, since it stores columns first. Datasets of whole numbers are indices, never matrices.

    Parameters
    ----------
    path
        The file.
    group
        Name of the group or dataset; may be None if the file holds exactly one matrix. ``a.b`` also stands for ``a/b``.
    arrays
        Names of the arrays in a group without such attributes; their indices may count from 1.

    Raises
    ------
    DataError
        If the file is damaged, or the matrix is missing or not well formed.
    """
    return read_safely(_read, path, group, arrays)


def hdf5_matrix_names(path: Path) -> list[str]:
    """Names of the groups and datasets of a file that are matrices.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    return read_safely(_names, path)


def _names(path: Path) -> list[str]:
    with open_hdf5(path) as file:
        return _candidates(file)


def _read(path: Path, group: str | None, arrays: ArrayNames | None) -> MatrixFile:
    with open_hdf5(path) as file:
        matlab = _is_matlab(file, path)
        notes: list[str] = []
        if not group and arrays is not None:
            group = "/"
        if not group:
            if holds_exodus(file):
                raise DataError(
                    "this is an exodus mesh, not a matrix", file=path, expected="a matrix", found="nodes and elements", hint=MESH
                )
            beside = [f"{key!r}" for key in file]
            group = only_matrix(_candidates(file), path, notes, beside=beside, hint=_layouts(file))
        try:
            node = lookup(file, group if group in file else group.replace(".", "/"), path)
        except KeyError:
            raise no_such_matrix(group, _candidates(file), path) from None
        matrix = _read_node(node, group, path, matlab, notes) if arrays is None else _read_arrays(node, group, path, arrays, notes)
    return MatrixFile(matrix=matrix, format="mat-v7.3" if matlab else "hdf5", notes=tuple(notes))


def _is_matlab(file: h5py.File, path: Path) -> bool:
    if file.userblock_size and head(path, 10) == b"MATLAB 7.3":
        return True
    hard = (file[name] for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink))
    return any("MATLAB_class" in node.attrs or "MATLAB_sparse" in node.attrs for node in hard)


def _layout(node: Any) -> str | None:
    """Kind of matrix stored in an object; None if it is no matrix."""
    if isinstance(node, h5py.Dataset):
        return "dense" if len(node.shape or ()) == 2 and (node.dtype.kind in "fc" or node.dtype.names == ("real", "imag")) else None
    if "MATLAB_sparse" in node.attrs and "jc" in node:
        return "matlab"
    kind = text_attribute(node, "encoding-type") or ""
    if kind in ("csr_matrix", "csc_matrix"):
        return kind[:3]
    legacy = text_attribute(node, "h5sparse_format") or ""
    return legacy if legacy in ("csr", "csc") else None


def _layouts(file: h5py.File) -> str:
    """What to do with a file without a matrix."""
    for name, arrays in groups_in(file).items():
        return f"if {name} is a compressed matrix, write `{{file: FILE, group: {name}, {arrays.setting()}}}`"
    return "`lrbc guide formats` lists the layouts that are read"


def _candidates(file: h5py.File) -> list[str]:
    if holds_exodus(file):
        return []
    names: list[str] = []

    def visit(name: str, node: Any) -> None:
        if name.startswith("#"):
            return  # internal object of MATLAB
        if any(name.startswith(f"{parent}/") for parent in names):
            return
        if _layout(node):
            names.append(name)

    file.visititems(visit)
    return names


def _read_arrays(node: Any, name: str, path: Path, arrays: ArrayNames, notes: list[str]) -> Any:
    """Square matrix from compressed arrays of any names, with indices from 0 or 1."""
    missing = [key for key in (arrays.data, arrays.indices, arrays.indptr) if not isinstance(node, h5py.Group) or key not in node]
    if missing:
        inside = listing(list(node)) if isinstance(node, h5py.Group) else "a dataset"
        raise DataError("the group has no such array", file=path, place=name, expected=listing(missing), found=inside)
    data, indices, indptr = (load(lookup(node, key, path), path) for key in (arrays.data, arrays.indices, arrays.indptr))
    if np.size(indptr) and np.size(indices) and indptr[0] == 1:
        indices, indptr = indices - 1, indptr - 1
        notes.append("indices count from 1")
    n = int(np.size(indptr)) - 1
    return from_compressed(arrays.layout, data, indices, indptr, (n, n), path=path, place=name, file_size=path.stat().st_size)


def _read_node(node: Any, name: str, path: Path, matlab: bool, notes: list[str]) -> Any:
    size = path.stat().st_size
    layout = _layout(node)
    if layout is None:
        inside = listing(list(node)) if isinstance(node, h5py.Group) else f"a dataset of shape {node.shape}, type {node.dtype}"
        raise DataError(
            "this is not a matrix that can be read",
            file=path,
            place=name,
            expected="a group with 'encoding-type' csr_matrix or csc_matrix, a MATLAB sparse matrix, or a two-dimensional dataset of real "
            "or complex numbers",
            found=inside,
            hint=f"add `{arrays.setting()}` beside `file:` and `group:`" if (arrays := arrays_of(node)) else None,
        )
    if layout == "dense":
        values = load(node, path)
        notes.append(f"{name!r} is stored dense")
        return canonical(values.T if matlab else values, path, name)
    if layout == "matlab":
        indptr = load(lookup(node, "jc", path), path)
        empty = np.empty(0)
        data = load(lookup(node, "data", path), path) if "data" in node else empty
        rows = load(lookup(node, "ir", path), path) if "ir" in node else empty.astype(np.int64)
        shape = (int(np.asarray(node.attrs["MATLAB_sparse"]).ravel()[0]), int(np.size(indptr)) - 1)
        return from_compressed("csc", data, rows, indptr, shape, path=path, place=name, file_size=size)
    version = text_attribute(node, "encoding-version")
    # Arrays written by hand state no version; they are checked like all others.
    if version is not None and version not in _VERSIONS:
        raise DataError(
            "the encoding version is not known", file=path, place=name, expected=" or ".join(_VERSIONS), found=version or "none"
        )
    stated = shape_attribute(node, "shape", "h5sparse_shape")
    missing = [key for key in ("data", "indices", "indptr") if key not in node]
    if stated is None or missing:
        found = "no attribute 'shape'" if stated is None else f"no {listing(missing)}"
        raise DataError(
            "the matrix group is not complete",
            file=path,
            place=name,
            expected="data, indices, indptr and the attribute 'shape'",
            found=found,
        )
    data, indices, indptr = (load(lookup(node, key, path), path) for key in ("data", "indices", "indptr"))
    kind: Literal["csr", "csc"] = "csr" if layout == "csr" else "csc"
    return from_compressed(kind, data, indices, indptr, stated, path=path, place=name, file_size=size)
