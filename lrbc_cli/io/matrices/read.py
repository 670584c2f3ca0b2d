"""Reads matrices of finite-element models: the entry point to the readers of all formats, which are recognised by content."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable
from pathlib import Path

from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.common import head, require_file
from lrbc_cli.io.hdf5.matrices import ArrayNames, hdf5_matrix_names, read_hdf5_matrix
from lrbc_cli.io.hdf5.tools import is_hdf5
from lrbc_cli.io.matlab.variables import is_mat5, list_variables, read_mat5_matrix
from lrbc_cli.io.matrices.ansys_full import is_ansys_full, read_ansys_full
from lrbc_cli.io.matrices.dmig import dmig_names, is_dmig, read_dmig
from lrbc_cli.io.matrices.foreign import written_by
from lrbc_cli.io.matrices.harwell_boeing import is_harwell_boeing, read_harwell_boeing
from lrbc_cli.io.matrices.matrix_market import is_matrix_market, read_matrix_market
from lrbc_cli.io.matrices.npz import SIGNATURE as NPZ_SIGNATURE
from lrbc_cli.io.matrices.npz import npz_matrix_names, read_npz_matrix
from lrbc_cli.io.matrices.op4 import is_op4, op4_names, read_op4
from lrbc_cli.io.matrices.triplets import read_triplets, triplets_format
from lrbc_cli.io.sparse import MatrixFile, require_square

#: Reader of each format; a new format is a module, a line here, one in ``detect_format`` and its name in ``config.fields.MatrixFormat``.
FORMATS: dict[str, Callable[[Path, str | None], MatrixFile]] = {
    "matrix-market": read_matrix_market,
    "hdf5": read_hdf5_matrix,
    "mat-v7.3": read_hdf5_matrix,
    "mat-v5": read_mat5_matrix,
    "npz": read_npz_matrix,
    "abaqus": read_triplets,
    "triplets": read_triplets,
    "sierra-sd": read_triplets,
    "harwell-boeing": read_harwell_boeing,
    "nastran-op4": read_op4,
    "nastran-dmig": read_dmig,
    "ansys-full": read_ansys_full,
}

#: Formats without a fixed mark, with the function that recognises each, in the order of the checks.
_TOLD: tuple[tuple[str, Callable[[bytes], bool]], ...] = (
    ("nastran-op4", is_op4),
    ("ansys-full", is_ansys_full),
    ("harwell-boeing", is_harwell_boeing),
    ("nastran-dmig", is_dmig),
)


def detect_format(path: Path) -> str:
    """Format of a matrix file (a key of ``FORMATS``), recognised by its content.

    Raises
    ------
    DataError
        If the file cannot be read or its content is in none of these formats.
    """
    require_file(path)
    start = head(path, 4096)
    if start[:2] == b"\x1f\x8b":
        start = _unpacked_head(path)
    if is_matrix_market(start):
        return "matrix-market"
    if is_hdf5(path):
        return "mat-v7.3" if start[:10] == b"MATLAB 7.3" else "hdf5"
    if is_mat5(start):
        return "mat-v5"
    if start[:4] == NPZ_SIGNATURE:
        return "npz"
    for name, told in _TOLD:
        if told(start):
            return name
    if listed := triplets_format(start):
        return listed
    program, hint = written_by(path, start)
    raise DataError(
        f"this is {program}" if program else "the format of this file is not known",
        file=path,
        expected="a matrix in one of the formats that `lrbc guide formats` lists",
        found=program or _describe(start),
        hint=hint,
    )


def read_matrix(path: Path, group: str | None = None, format: str | None = None, arrays: ArrayNames | None = None) -> MatrixFile:
    """Read a square matrix.

    Parameters
    ----------
    path
        The file.
    group
        Name of the HDF5 group, MATLAB variable or array; may be None if there is only one.
    format
        One of ``FORMATS``; None: recognised by content.
    arrays
        Names of the arrays of a compressed matrix in HDF5, if they are not the usual ones.

    Returns
    -------
    MatrixFile
        (n, n) matrix, with notes and warnings.

    Raises
    ------
    DataError
        If the file is missing, damaged or inconsistent, the matrix is not square, or a value is not finite.
    ConfigError
        If ``format`` is unknown.
    """
    result = read_vectors(path, group, format, arrays)
    require_square(result.matrix, path, group or "matrix")
    return result


def read_vectors(path: Path, group: str | None = None, format: str | None = None, arrays: ArrayNames | None = None) -> MatrixFile:
    """Read a matrix of any shape, such as excitation, response or parameter vectors.

    Parameters and errors are those of ``read_matrix``, except that the matrix may be rectangular.
    """
    path = Path(path)
    require_file(path)
    if format is None:
        format = detect_format(path)
    if format not in FORMATS:
        raise ConfigError("this matrix format is not known", file=path, expected=", ".join(FORMATS), found=format)
    if arrays is None:
        return FORMATS[format](path, group)
    if format != "hdf5":
        raise ConfigError("'arrays' is for HDF5 files only", file=path, place="arrays", expected="an HDF5 file", found=format)
    return read_hdf5_matrix(path, group, arrays)


#: Formats whose files may hold several named matrices, with the function that lists the names.
_SEVERAL: dict[str, Callable[[Path], list[str]]] = {
    "nastran-op4": op4_names,
    "nastran-dmig": dmig_names,
    "ansys-full": lambda _: ["K", "M"],
}


def matrix_names(path: Path) -> list[str | None]:
    """Names of the matrices of a file; a single None if it holds one without a name.

    Raises
    ------
    DataError
        If the format is not known, or the file is damaged.
    """
    path, format = Path(path), detect_format(Path(path))
    if format in ("hdf5", "mat-v7.3"):
        return [*hdf5_matrix_names(path)]
    if format == "mat-v5":
        return [name for name, shape, kind in list_variables(path) if kind in ("sparse", "double", "single") and len(shape) == 2]
    if format in _SEVERAL:
        names = _SEVERAL[format](path)
        return [*names] if len(names) > 1 else [None]
    return [*npz_matrix_names(path)] if format == "npz" else [None]


def _unpacked_head(path: Path) -> bytes:
    try:
        with gzip.open(path, "rb") as stream:
            return stream.read(4096)
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(
            "this gzip file cannot be read", file=path, found=str(error), hint="the file is damaged; export it again"
        ) from error


def _describe(start: bytes) -> str:
    if b"\0" in start or sum(byte > 126 for byte in start) > len(start) // 4:
        return f"binary data starting with {start[:8].hex(' ')}"
    return repr(start.splitlines()[0][:60].decode("latin-1")) if start.splitlines() else "blank lines"
