"""Nodes of exodus meshes: netCDF files, classic ones by SciPy, those in HDF5 by h5py. meshio drops the numbers of the nodes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import netcdf_file

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.errors import DataError
from lrbc_cli.io.common import damaged, head
from lrbc_cli.io.hdf5.tools import load, lookup, open_hdf5


def read_exodus(path: Path) -> tuple[Integers, Floats]:
    """Numbers (``node_num_map``, else from 1 in order) and coordinates of the nodes of an exodus mesh.

    Returns
    -------
    (m,) int array
    (m, 3) float array

    Raises
    ------
    DataError
        If the file is damaged or no exodus mesh.
    """
    if head(path, 3) == b"CDF":
        with damaged(path, "exodus mesh"), netcdf_file(path, "r", mmap=False) as file:
            return _nodes(lambda name: file.variables[name][:] if name in file.variables else None, path)
    with open_hdf5(path) as file, damaged(path, "exodus mesh"):
        return _nodes(lambda name: load(lookup(file, name, path), path) if name in file else None, path)


def _nodes(get: Callable[[str], Any], path: Path) -> tuple[Integers, Floats]:
    whole = get("coord")
    axes = [get(name) for name in ("coordx", "coordy", "coordz")] if whole is None else list(np.asarray(whole))
    present = [np.asarray(axis, dtype=np.float64).ravel() for axis in axes if axis is not None]
    if not present or len(present) > 3 or len({axis.size for axis in present}) > 1:
        raise DataError("this netCDF file contains no nodes", file=path, expected="coordx, coordy, coordz of an exodus mesh", found="none")
    xyz = np.zeros((present[0].size, 3))
    xyz[:, : len(present)] = np.stack(present, axis=1)
    numbers = get("node_num_map")
    node = np.arange(1, xyz.shape[0] + 1) if numbers is None else np.asarray(numbers, dtype=np.int64).ravel()
    if node.size != xyz.shape[0]:
        raise DataError(
            "the numbers of the nodes do not match their coordinates",
            file=path,
            place="node_num_map",
            expected=f"{xyz.shape[0]} numbers",
            found=str(node.size),
            hint="export the mesh again",
        )
    return node, xyz
