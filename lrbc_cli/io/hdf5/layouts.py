"""Recognises what HDF5 files of other programs contain: exodus meshes, and compressed matrices with arrays of any names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import h5py

from lrbc_cli.io.hdf5.tools import is_hdf5, open_hdf5, read_safely

#: What to do with a mesh.
MESH = "a mesh goes to `dofs: {nodes: FILE}`"


@dataclass(frozen=True, kw_only=True)
class ArrayNames:
    """Names of the arrays of a compressed matrix, and whether rows (``csr``) or columns (``csc``) are compressed."""

    data: str
    indices: str
    indptr: str
    layout: Literal["csr", "csc"]

    def setting(self, written: Callable[[str], str] = str) -> str:
        """The setting ``arrays`` of the campaign file; rows are the default.

        Parameters
        ----------
        written
            Turns a name into its form in the campaign file.
        """
        layout = "" if self.layout == "csr" else f", layout: {self.layout}"
        return f"arrays: {{data: {written(self.data)}, indices: {written(self.indices)}, indptr: {written(self.indptr)}{layout}}}"


def is_exodus(path: Path) -> bool:
    """Whether a file is an exodus mesh in HDF5 (netCDF-4).

    Raises
    ------
    DataError
        If the file is damaged.
    """
    return is_hdf5(path) and read_safely(_is_exodus, path)


def compressed_groups(path: Path) -> dict[str, ArrayNames]:
    """Groups of an HDF5 file with the arrays of a compressed matrix, but without attributes that say so, by name.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    return read_safely(_compressed_groups, path) if is_hdf5(path) else {}


def holds_exodus(file: h5py.File) -> bool:
    """Whether an open file has the dimension and the coordinates of nodes of exodus."""
    return "num_nodes" in file and ("coord" in file or "coordx" in file)


def arrays_of(node: Any) -> ArrayNames | None:
    """Arrays of a group, if its only three look like those of a compressed matrix: values, as many indices, and other whole numbers."""
    if not isinstance(node, h5py.Group):
        return None
    arrays = {name: item for name in node if isinstance(item := _own(node, name), h5py.Dataset) and len(item.shape or ()) == 1}
    whole = [name for name, item in arrays.items() if item.dtype.kind in "iu"]
    rest = [name for name in arrays if name not in whole]
    if len(whole) != 2 or len(rest) != 1:
        return None
    fitting = [name for name in whole if arrays[name].size == arrays[rest[0]].size]
    if len(fitting) != 1:
        return None
    (indptr,) = (name for name in whole if name != fitting[0])
    return ArrayNames(
        data=rest[0], indices=fitting[0], indptr=indptr, layout="csc" if any("csc" in name.lower() for name in arrays) else "csr"
    )


def _own(group: h5py.Group, name: str) -> Any:
    """Member of a group; None for links, which may be broken or lead into other files."""
    return group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None


def _is_exodus(path: Path) -> bool:
    with open_hdf5(path) as file:
        return holds_exodus(file)


def _compressed_groups(path: Path) -> dict[str, ArrayNames]:
    with open_hdf5(path) as file:
        return groups_in(file)


def groups_in(file: h5py.File) -> dict[str, ArrayNames]:
    """Groups of an open file with the arrays of a compressed matrix and without attributes of their own."""
    found: dict[str, ArrayNames] = {}

    def visit(name: str, node: Any) -> None:
        arrays = arrays_of(node) if not name.startswith("#") and not node.attrs.keys() else None
        if arrays is not None:
            found[name] = arrays

    file.visititems(visit)
    return found
