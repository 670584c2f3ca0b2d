"""Reads matrices of Ansys ``.full`` files by the package ansys-mapdl-reader, if it is installed."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import damaged, head, require_file
from lrbc_cli.io.reader_process import read_apart
from lrbc_cli.io.sparse import MatrixFile, canonical, mirrored
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, COMPONENTS, DofLabels

#: Length of the first record of Ansys' binary files in words, and the number that marks a ``.full`` file.
_RECORD, _FULL = 100, 4
_PRESSURE = 18


def is_ansys_full(start: bytes) -> bool:
    """Whether the first bytes of a file are the standard header of an Ansys ``.full`` file."""
    return len(start) > 12 and struct.unpack_from("<iIi", start) == (_RECORD, 0x80000000, _FULL)


def read_ansys_full(path: Path, group: str | None = None) -> MatrixFile:
    """Read ``K`` or ``M``, with node and component of each row; rows of fixed DOFs are zero.

    Raises
    ------
    DataError
        If no such matrix is named, the package is not installed or it cannot read the file.
    """
    require_file(path)
    if group not in ("K", "M"):
        raise DataError(
            "an Ansys .full file contains several matrices", file=path, place=group, expected="file.full#K or file.full#M", found=group
        )
    if not is_ansys_full(head(path, 16)):
        raise DataError("this is not an Ansys .full file", file=path, expected="its standard header", found="other data")
    # Read in another process: the package is written in C and does not check what it reads.
    return read_apart(_read, path, group)


def _read(path: Path, group: str) -> MatrixFile:
    try:
        from ansys.mapdl.reader.full import FullFile
    except ImportError:
        raise DataError(
            "reading Ansys .full files needs the package ansys-mapdl-reader",
            file=path,
            hint="pip install lrbc[ansys]; or export with HBMAT, see `lrbc guide export`",
        ) from None
    with damaged(path, "Ansys .full file"):
        references, stiffness, mass = FullFile(str(path)).load_km(as_sparse=True, sort=False)
    matrix: Any = canonical(coo_array(stiffness if group == "K" else mass), path, group)
    names = {**dict(enumerate(COMPONENTS)), _PRESSURE: ACOUSTIC_COMPONENT}
    node, dof = np.asarray(references, dtype=np.int64).T
    component = np.array([names.get(d, f"DOF{d + 1}") for d in dof.tolist()], dtype=np.str_)
    matrix, notes = mirrored(matrix)
    return MatrixFile(matrix=matrix, format="ansys-full", notes=notes, labels=DofLabels(node, component))
