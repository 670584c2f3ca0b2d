"""Nodes of meshes keep the numbers that the mesh gives them: maps of matrices refer to these."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import netcdf_file

from lrbc_cli.errors import DataError
from lrbc_cli.io.meshes.nodes import read_nodes

GMSH = Path(__file__).parents[1] / "data" / "gmsh"

#: The plate that gmsh saved: corners and middles of its edges (x 2..3, y 0..0.5, z 0.25).
PLATE = {(x, y) for x in (2.0, 2.5, 3.0) for y in (0.0, 0.5)}


@pytest.mark.parametrize("name", ["box-and-plate-41", "box-and-plate-41-binary", "box-and-plate-parametric", "plate-22", "plate-22-binary"])
def test_gmsh(name: str) -> None:
    """Written by gmsh: only the plate was saved, and format 4.1 keeps the numbers beside the box, which was not."""
    node, xyz, what = read_nodes(GMSH / f"{name}.msh")
    assert what == "mesh"
    assert node.size == 8
    assert {(round(x, 9), round(y, 9)) for x, y, _ in xyz.tolist()} >= PLATE
    assert np.all(xyz[:, 2] == 0.25)
    assert node.tolist() == (list(range(1, 9)) if "22" in name else [9, 10, 11, 12, 25, 26, 51, 52])


def test_gmsh_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"this version of gmsh meshes is not read(.|\n)*-format msh41"):
        read_nodes(GMSH / "box-and-plate-40.msh")
    path = tmp_path / "short.msh"
    for name in ("box-and-plate-41", "box-and-plate-41-binary", "plate-22-binary"):
        content = (GMSH / f"{name}.msh").read_bytes()
        start = content.index(b"$Nodes")
        for cut in (start + 20, start + 100, start + 180):
            path.write_bytes(content[:cut])
            with pytest.raises(DataError, match="mesh"):
                read_nodes(path)
            path.write_bytes(content[:cut] + b"\n$EndNodes\n")
            with pytest.raises(DataError, match="mesh"):
                read_nodes(path)


@pytest.mark.parametrize("kind", ["classic", "hdf5"])
@pytest.mark.parametrize("numbered", [True, False])
def test_exodus(tmp_path: Path, kind: str, numbered: bool) -> None:
    path, xyz, numbers = tmp_path / "plate.exo", np.arange(12.0).reshape(3, 4), np.array([7, 3, 12, 100], dtype=np.int32)
    if kind == "classic":
        with netcdf_file(path, "w") as file:
            file.createDimension("num_nodes", 4)
            for name, values in zip(("coordx", "coordy", "coordz"), xyz, strict=True):
                file.createVariable(name, "d", ("num_nodes",))[:] = values
            if numbered:
                file.createVariable("node_num_map", "i", ("num_nodes",))[:] = numbers
    else:
        with h5py.File(path, "w") as file:
            file["num_nodes"], file["coord"] = np.zeros(4), xyz
            if numbered:
                file["node_num_map"] = numbers
    node, places, _ = read_nodes(path)
    assert node.tolist() == (sorted(numbers.tolist()) if numbered else [1, 2, 3, 4])
    np.testing.assert_array_equal(places, xyz.T[np.argsort(numbers)] if numbered else xyz.T)


def test_exodus_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "plate.exo"
    path.write_bytes(b"CDF\x02" + bytes(60))
    with pytest.raises(DataError, match=r"exodus mesh|no nodes"):
        read_nodes(path)
    with h5py.File(path, "w") as file:
        file["num_nodes"], file["coord"], file["node_num_map"] = np.zeros(4), np.zeros((3, 4)), np.arange(3)
    with pytest.raises(DataError, match="node_num_map"):
        read_nodes(path)
