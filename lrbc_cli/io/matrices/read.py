"""Reads matrices of finite-element models: the entry point to the readers of all formats, which are recognised by content."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.common import FileFormat, head, recognised, require_file
from lrbc_cli.io.hdf5.matrices import ArrayNames, hdf5_matrix_names, read_hdf5_matrix
from lrbc_cli.io.hdf5.tools import is_hdf5
from lrbc_cli.io.matlab.variables import is_mat5, mat5_matrix_names, read_mat5_matrix
from lrbc_cli.io.matrices.ansys_full import is_ansys_full, read_ansys_full
from lrbc_cli.io.matrices.dmig import dmig_names, is_dmig, read_dmig
from lrbc_cli.io.matrices.foreign import written_by
from lrbc_cli.io.matrices.harwell_boeing import is_harwell_boeing, read_harwell_boeing
from lrbc_cli.io.matrices.matrix_market import is_matrix_market, read_matrix_market
from lrbc_cli.io.matrices.op4 import is_op4, op4_names, read_op4
from lrbc_cli.io.matrices.triplets import read_triplets, triplets_format
from lrbc_cli.io.npz.archive import SIGNATURE as NPZ_SIGNATURE
from lrbc_cli.io.npz.matrices import npz_matrix_names, read_npz_matrix
from lrbc_cli.io.npz.others import other_archive
from lrbc_cli.io.sparse import MatrixFile, require_square


@dataclass(frozen=True)
class MatrixFileFormat(FileFormat):
    """A format of matrix files: the reader of a matrix with a given name, and that of all names, None for a matrix without name."""

    read: Callable[[Path, str | None], MatrixFile]
    names: Callable[[Path], Sequence[str | None]] = lambda _: [None]


def _if_several(names: Callable[[Path], list[str]]) -> Callable[[Path], Sequence[str | None]]:
    """Reader of names that leaves out the name of a single matrix."""
    return lambda path: found if len(found := names(path)) > 1 else [None]


#: Formats by their names, in the order of the checks; a new format is a module, a line here and its name in ``config.fields.MatrixFormat``.
FORMATS = {
    format.name: format
    for format in (
        MatrixFileFormat("matrix-market", lambda _, start: is_matrix_market(start), read_matrix_market),
        MatrixFileFormat(
            "mat-v7.3", lambda path, start: start[:10] == b"MATLAB 7.3" and is_hdf5(path), read_hdf5_matrix, hdf5_matrix_names
        ),
        MatrixFileFormat("hdf5", lambda path, _: is_hdf5(path), read_hdf5_matrix, hdf5_matrix_names),
        MatrixFileFormat("mat-v5", lambda _, start: is_mat5(start), read_mat5_matrix, mat5_matrix_names),
        MatrixFileFormat(
            "npz", lambda path, start: start[:4] == NPZ_SIGNATURE and not other_archive(path, start), read_npz_matrix, npz_matrix_names
        ),
        # Formats without a fixed mark.
        MatrixFileFormat("nastran-op4", lambda _, start: is_op4(start), read_op4, _if_several(op4_names)),
        MatrixFileFormat("ansys-full", lambda _, start: is_ansys_full(start), read_ansys_full, lambda _: ["K", "M"]),
        MatrixFileFormat("harwell-boeing", lambda _, start: is_harwell_boeing(start), read_harwell_boeing),
        MatrixFileFormat("nastran-dmig", lambda _, start: is_dmig(start), read_dmig, _if_several(dmig_names)),
        MatrixFileFormat("abaqus", lambda _, start: triplets_format(start) == "abaqus", read_triplets),
        MatrixFileFormat("triplets", lambda _, start: triplets_format(start) == "triplets", read_triplets),
        MatrixFileFormat("sierra-sd", lambda _, start: triplets_format(start) == "sierra-sd", read_triplets),
    )
}


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
    expected = "a matrix in one of the formats that `lrbc guide formats` lists"
    return recognised(FORMATS.values(), path, start, expected, written_by).name


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
        return FORMATS[format].read(path, group)
    if format != "hdf5":
        raise ConfigError("'arrays' is for HDF5 files only", file=path, place="arrays", expected="an HDF5 file", found=format)
    return read_hdf5_matrix(path, group, arrays)


def matrix_names(path: Path) -> list[str | None]:
    """Names of the matrices of a file; a single None if it holds one without a name.

    Raises
    ------
    DataError
        If the format is not known, or the file is damaged.
    """
    path = Path(path)
    return [*FORMATS[detect_format(path)].names(path)]


def _unpacked_head(path: Path) -> bytes:
    try:
        with gzip.open(path, "rb") as stream:
            return stream.read(4096)
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(
            "this gzip file cannot be read", file=path, found=str(error), hint="the file is damaged; export it again"
        ) from error
