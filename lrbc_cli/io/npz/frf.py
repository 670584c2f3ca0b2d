"""Reads the arrays of ``.npz`` archives of NumPy, in which ``io.named`` finds FRFs by their names."""

from __future__ import annotations

from pathlib import Path

from lrbc_cli.io.named import Named, named_arrays
from lrbc_cli.io.npz.archive import open_npz


def named_npz(path: Path) -> Named:
    """Arrays and texts of an archive by name; a slash in a name separates structures.

    Raises
    ------
    DataError
        If the archive is damaged, or contains Python objects.
    """
    with open_npz(path) as archive:
        return named_arrays({name.replace("/", "."): archive.load(name) for name in archive.names}, path)
