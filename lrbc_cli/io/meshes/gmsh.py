"""Nodes of gmsh meshes, formats 2 and 4.1, as text or binary. The package meshio reads these files, but drops the numbers of the nodes."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.errors import DataError
from lrbc_cli.io.common import damaged, whole

SIGNATURE = b"$MeshFormat"


class _Values:
    """Values of a section, read one after another: text separated by white space, or packed."""

    def __init__(self, content: bytes, order: str | None, path: Path) -> None:
        self.order, self.path, self.at = order, path, 0
        self.content: bytes | list[bytes] = content.split() if order is None else content

    def take(self, kinds: str, count: int) -> list[NDArray[Any]]:
        """``count`` rows of values, as one array for each kind: i int32, q size, d double."""
        size = sum({"i": 4, "q": 8, "d": 8}[kind] for kind in kinds)
        left = len(self.content) - self.at
        if not 0 <= count * (size if self.order else len(kinds)) <= left:
            raise DataError("this mesh ends early", file=self.path, place="$Nodes", expected=f"{count} rows", hint="export it again")
        if self.order is None:
            cells = self.content[self.at : self.at + count * len(kinds)]
            self.at += count * len(kinds)
            rows = np.array(cells, dtype=np.bytes_).reshape(count, len(kinds))
            return [rows[:, k].astype(np.float64 if kind == "d" else np.int64) for k, kind in enumerate(kinds)]
        assert isinstance(self.content, bytes)
        packed = {"i": "i4", "q": "i8", "d": "f8"}
        fields = np.dtype([(f"f{k}", self.order + packed[kind]) for k, kind in enumerate(kinds)])
        records = np.frombuffer(self.content, dtype=fields, count=count, offset=self.at)
        self.at += count * size
        return [records[f"f{k}"] for k in range(len(kinds))]


def read_gmsh(path: Path) -> tuple[Integers, Floats]:
    """Numbers and coordinates of the nodes of a gmsh mesh.

    Returns
    -------
    (m,) int array
    (m, 3) float array

    Raises
    ------
    DataError
        If the file is damaged, or of another version.
    """
    content = whole(path)
    with damaged(path, "mesh of gmsh"):
        header = content.split(SIGNATURE, 1)[1].lstrip().split(None, 3)
        version, order = header[0].decode("ascii"), None
        if header[1] == b"1":
            order = "<" if struct.unpack("<i", header[3][:4]) == (1,) else ">"
        start = content.index(b"$Nodes") + len(b"$Nodes")
        section = content[content.index(b"\n", start) + 1 : content.index(b"$EndNodes", start)]
    if version not in ("2", "2.0", "2.1", "2.2", "4.1"):
        raise DataError(
            "this version of gmsh meshes is not read",
            file=path,
            place="$MeshFormat",
            expected="version 2, 2.1, 2.2 or 4.1",
            found=version[:20],
            hint="save it again with `gmsh FILE -save -format msh41`",
        )
    with damaged(path, "mesh of gmsh", "$Nodes"):
        if version == "4.1":
            return _version_4(_Values(section, order, path))
        # The number of nodes is text in both layouts.
        count, _, rows = section.partition(b"\n")
        node, x, y, z = _Values(rows, order, path).take("iddd", int(count))
        return np.asarray(node, dtype=np.int64), np.stack([x, y, z], axis=1).astype(np.float64)


def _version_4(values: _Values) -> tuple[Integers, Floats]:
    blocks = int(values.take("qqqq", 1)[0][0])
    nodes, places = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for _block in range(blocks):
        dimension, _tag, parametric = (int(one[0]) for one in values.take("iii", 1))
        count = int(values.take("q", 1)[0][0])
        nodes.append(np.asarray(values.take("q", count)[0], dtype=np.int64))
        # Parametric coordinates follow those in space.
        xyz = values.take("d" * (3 + (dimension if parametric else 0)), count)
        places.append(np.stack(xyz[:3], axis=1).astype(np.float64))
    return np.concatenate(nodes), np.concatenate(places)
