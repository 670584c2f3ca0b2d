"""Reads matrices from ``.npz`` archives of SciPy and NumPy, without unpickling."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import check_allocation, damaged, listing, require_file
from lrbc_cli.io.sparse import MatrixFile, canonical, from_compressed, from_coordinates, no_such_matrix, only_matrix

SIGNATURE = b"PK\x03\x04"

# The limit of NumPy, which would read a longer header before it refuses it.
_LONGEST_HEADER = 10_000


def read_npz_matrix(path: Path, group: str | None = None) -> MatrixFile:
    """Read a matrix of ``scipy.sparse.save_npz``, or a two-dimensional array of ``numpy.savez``.

    Nothing is unpickled.

    Parameters
    ----------
    path
        The archive.
    group
        Name of the array, if the archive holds several dense ones.

    Raises
    ------
    DataError
        If the archive is damaged, or holds no such matrix.
    """
    size = require_file(path)
    with damaged(path, ".npz archive"), zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
        if "format" in names and "shape" in names:
            if group:
                raise DataError(
                    "the archive contains one sparse matrix without a name", file=path, place=group, hint=f"leave out '#{group}'"
                )
            return MatrixFile(matrix=_sparse(archive, names, path, size), format="npz")
        notes = ["stored dense"]
        if not group:
            packed = [name for name in archive.namelist() if not name.endswith("/")]
            hint = f"unpack it, and give the matrix file that it contains: {listing(packed, 4)}"
            group = only_matrix(names, path, notes, holder="archive", beside=[], hint=hint)
        if group not in names:
            raise no_such_matrix(group, names, path, holder="archive")
        values = _member(archive, group, path, size)
        if values.ndim not in (1, 2):
            raise DataError("this is not a matrix", file=path, place=group, expected="two dimensions", found=f"shape {values.shape}")
        return MatrixFile(matrix=canonical(values if values.ndim == 2 else values[:, None], path, group), format="npz", notes=tuple(notes))


def npz_matrix_names(path: Path) -> list[str | None]:
    """Names of the dense arrays of an archive; a single None for one sparse matrix.

    Raises
    ------
    DataError
        If the archive is damaged.
    """
    require_file(path)
    with damaged(path, ".npz archive"), zipfile.ZipFile(path) as archive:
        names: list[str | None] = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
    return [None] if "format" in names and "shape" in names else names


def _sparse(archive: zipfile.ZipFile, names: list[str], path: Path, size: int) -> Any:
    layout = _member(archive, "format", path, size)[()]
    layout = layout.decode("ascii", "replace") if isinstance(layout, bytes) else str(layout)
    numbers = np.asarray(_member(archive, "shape", path, size)).ravel()
    if numbers.size != 2 or numbers.dtype.kind not in "iu":
        raise DataError(
            "the shape is not two whole numbers", file=path, place="shape", expected="rows, columns", found=numbers[:4].tolist()
        )
    shape = (int(numbers[0]), int(numbers[1]))
    needed = {"csr": ("data", "indices", "indptr"), "csc": ("data", "indices", "indptr"), "coo": ("data", "row", "col")}.get(layout)
    if needed is None:
        raise DataError(
            "the sparse format is not read", file=path, place="format", expected="csr, csc or coo", found=layout, hint="save matrix.tocsr()"
        )
    missing = [key for key in needed if key not in names]
    if missing:
        raise DataError("the archive is not complete", file=path, expected=listing(needed), found=f"no {listing(missing)}")
    data, first, second = (_member(archive, key, path, size) for key in needed)
    if layout == "coo":
        return from_coordinates(data, first, second, shape, path=path, place="matrix", file_size=size)
    return from_compressed("csr" if layout == "csr" else "csc", data, first, second, shape, path=path, place="matrix", file_size=size)


def _member(archive: zipfile.ZipFile, name: str, path: Path, size: int) -> Any:
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as stream:
        start = stream.read(12)
        length = int.from_bytes(start[8:10] if start[6:7] == b"\x01" else start[8:12], "little")
        if length > _LONGEST_HEADER:
            raise DataError(
                "the header of an array is wrong", file=path, place=name, expected=f"{_LONGEST_HEADER} bytes", found=f"{length}"
            )
        stream.seek(0)
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = header(stream)
    if dtype.hasobject:
        raise DataError(
            "the array contains Python objects, which are never loaded",
            file=path,
            place=name,
            expected="numbers",
            found="objects",
            hint=f"if it is a sparse matrix, write it with scipy.sparse.save_npz({path.name!r}, {name}) to a separate file",
        )
    needed = math.prod(shape) * dtype.itemsize
    check_allocation(needed, info.file_size, path, name)
    # Members may overlap, so none can hold more than the file; if nothing is compressed, the first check is enough.
    packed = min(info.compress_size, size)
    check_allocation(needed, packed, path, name, compressed=info.compress_type != zipfile.ZIP_STORED)
    with archive.open(info) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)
