"""Reads matrices that Nastran writes as DMIG entries (punch files), with grid point and component of each row."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import fortran_number, whole
from lrbc_cli.io.sparse import MatrixFile, from_coordinates, mirrored, no_such_matrix, only_matrix
from lrbc_cli.model.dofs import COMPONENTS, DofLabels

_SQUARE = (1, 6)
_COMPLEX = (3, 4)


@dataclass(kw_only=True)
class _Entries:
    """Entries of one matrix: column, row, and value."""

    form: int
    type: int
    columns: list[tuple[int, int]] = field(default_factory=list)
    rows: list[tuple[int, int]] = field(default_factory=list)
    values: list[complex] = field(default_factory=list)


def is_dmig(start: bytes) -> bool:
    """Whether there are DMIG entries among the first bytes of a file."""
    return re.search(rb"^DMIG[* ]", start, re.MULTILINE) is not None


def read_dmig(path: Path, group: str | None = None) -> MatrixFile:
    """Read one square matrix; the second triangle of symmetric ones is filled in.

    Parameters
    ----------
    path
        A punch file.
    group
        Name of the matrix, such as KAAX; may be None if there is exactly one square matrix.

    Raises
    ------
    DataError
        If an entry cannot be read or there is no such matrix.
    """
    found = _parse(path)
    square, told = _square(found), list[str]()
    name = group.upper() if group else only_matrix(square, path, told, beside=list(found), hint="only square matrices are read")
    if name not in square:
        raise no_such_matrix(name, square, path)
    entries = found[name]
    keys = sorted({*entries.columns, *entries.rows})
    at = {key: k for k, key in enumerate(keys)}
    values = np.array(entries.values)
    row, column = (np.array([at[key] for key in side], dtype=np.int64) for side in (entries.rows, entries.columns))
    data = values if entries.type in _COMPLEX else values.real
    matrix = from_coordinates(data, row, column, (len(keys), len(keys)), path=path, place=name, file_size=path.stat().st_size)
    matrix, notes = mirrored(matrix) if entries.form == _SQUARE[1] else (matrix, ())
    component = [COMPONENTS[c - 1] if 0 < c <= len(COMPONENTS) else "SCALAR" for _, c in keys]
    labels = DofLabels(np.array([node for node, _ in keys], dtype=np.int64), np.array(component, dtype=np.str_))
    return MatrixFile(matrix=matrix, format="nastran-dmig", notes=(*told, *notes), labels=labels)


def dmig_names(path: Path) -> list[str]:
    """Names of the square matrices of a file; raises as ``read_dmig``."""
    return _square(_parse(path))


def _square(found: Mapping[str, _Entries]) -> list[str]:
    return [name for name, entries in found.items() if entries.form in _SQUARE]


def _parse(path: Path) -> dict[str, _Entries]:
    """All matrices of a file, from lines with fields of 8 and four times 16 characters."""
    found: dict[str, _Entries] = {}
    current, column, begun = None, (0, 0), -1
    for number, raw in enumerate(whole(path).decode("latin-1").splitlines(), start=1):
        line = raw.rstrip()
        try:
            if line.startswith("DMIG*") and line[24:40].strip() == "0":
                found[line[8:24].strip().upper()], current = _Entries(form=int(line[40:56]), type=int(line[56:72])), None
                begun = number
            elif line.startswith("DMIG*"):
                name = line[8:24].strip().upper()
                current, column = found[name], (int(line[24:40]), int(line[40:56] or 0))
            elif line.startswith("DMIG"):
                name, rest = line[8:16].strip().upper(), [line[k : k + 8].strip() for k in range(16, 72, 8)]
                if rest[0] != "0":
                    raise ValueError("entries in small fields")
                found[name], current = _Entries(form=int(rest[1]), type=int(rest[2])), None
                _require_parts(rest[4])
            elif line.startswith("*") and begun == number - 1:
                _require_parts(line[24:40])
            elif line.startswith("*") and current is not None:
                current.rows.append((int(line[8:24]), int(line[24:40])))
                current.columns.append(column)
                current.values.append(complex(fortran_number(line[40:56]), fortran_number(line[56:72])))
        except (ValueError, KeyError) as error:
            raise DataError(
                "an entry cannot be read",
                file=path,
                place=f"line {number}",
                expected="DMIG entries in large fields, as EXTSEOUT(DMIGPCH) writes them",
                found=repr(line[:72]),
                hint=f"export them again ({error})",
            ) from None
    return found


def _require_parts(polar: str) -> None:
    """Refuse complex numbers given as magnitude and phase."""
    if polar.strip() not in ("", "0"):
        raise ValueError("complex numbers as real and imaginary part, POLAR 0")
