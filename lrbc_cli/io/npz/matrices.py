"""Reads matrices from ``.npz`` archives of SciPy and NumPy."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.npz.archive import Archive, open_npz
from lrbc_cli.io.sparse import MatrixFile, canonical, from_compressed, from_coordinates, no_such_matrix, only_matrix


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
    with open_npz(path) as archive:
        if _is_sparse(archive):
            if group:
                raise DataError(
                    "the archive contains one sparse matrix without a name", file=path, place=group, hint=f"leave out '#{group}'"
                )
            return MatrixFile(matrix=_sparse(archive, path), format="npz")
        notes = ["stored dense"]
        if not group:
            hint = f"unpack it, and give the matrix file that it contains: {listing(archive.packed, 4)}"
            group = only_matrix(archive.names, path, notes, holder="archive", beside=[], hint=hint)
        if group not in archive.names:
            raise no_such_matrix(group, archive.names, path, holder="archive")
        values = archive.load(group)
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
    with open_npz(path) as archive:
        return [None] if _is_sparse(archive) else [*archive.names]


def _is_sparse(archive: Archive) -> bool:
    return {"format", "shape"} <= set(archive.names)


def _sparse(archive: Archive, path: Path) -> Any:
    stated = archive.load("format")[()]
    layout = stated.decode("ascii", "replace") if isinstance(stated, bytes) else str(stated)
    numbers = np.asarray(archive.load("shape")).ravel()
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
    missing = [key for key in needed if key not in archive.names]
    if missing:
        raise DataError("the archive is not complete", file=path, expected=listing(needed), found=f"no {listing(missing)}")
    data, first, second = (archive.load(key) for key in needed)
    if layout == "coo":
        return from_coordinates(data, first, second, shape, path=path, place="matrix", file_size=archive.size)
    kind: Literal["csr", "csc"] = "csr" if layout == "csr" else "csc"
    return from_compressed(kind, data, first, second, shape, path=path, place="matrix", file_size=archive.size)
