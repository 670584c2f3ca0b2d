"""Reads FRFs from ``.npz`` archives of NumPy: from arrays by their names, see ``io.named``."""

from __future__ import annotations

from pathlib import Path

from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.named import Named, frf_set, named_arrays
from lrbc_cli.io.npz.archive import open_npz
from lrbc_cli.model.frf import FrfSet


def read_frf_npz(path: Path, layout: TextLayout) -> FrfSet:
    """Read FRFs from the arrays of an archive.

    Raises
    ------
    DataError
        If none is found, or a value is not finite.
    """
    return frf_set(named_npz(path), path, layout)


def named_npz(path: Path) -> Named:
    """Arrays and texts of an archive by name; a slash in a name separates structures.

    Raises
    ------
    DataError
        If the archive is damaged, or contains Python objects.
    """
    with open_npz(path) as archive:
        return named_arrays({name.replace("/", "."): archive.load(name) for name in archive.names}, path)
