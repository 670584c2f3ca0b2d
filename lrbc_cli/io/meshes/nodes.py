"""Reads coordinates of nodes from tables, input files of FE programs, and meshes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.errors import DataError
from lrbc_cli.io.common import damaged, fortran_number, head, require_file
from lrbc_cli.io.encoding import read_lines
from lrbc_cli.io.hdf5.layouts import is_exodus
from lrbc_cli.io.meshes.exodus import read_exodus
from lrbc_cli.io.meshes.gmsh import SIGNATURE, read_gmsh
from lrbc_cli.io.reader_process import read_apart
from lrbc_cli.io.text.tables import read_table

#: Line number of a node, and its number and coordinates as text.
_Cells = tuple[int, list[str]]

_KEYWORD = re.compile(r"\*NODE\s*(,|$)")
_GRID = re.compile(r"GRID[*,\s]")
_FORMAT = re.compile(r"\s*\((\d+)I(\d+),\s*\d+E(\d+)")


def read_nodes(path: Path) -> tuple[Integers, Floats, str]:
    """Node numbers and coordinates in the unit of the file.

    Formats: CSV tables ``node,x,y,z``; ``*NODE`` blocks of Abaqus and CalculiX; ``GRID`` entries of Nastran; ``NBLOCK`` (``CDWRITE``),
    ``NLIST`` and ``NWRITE`` listings of Ansys; ``.frd`` of CalculiX; meshes of gmsh and exodus; other meshes by the package meshio, their
    nodes numbered from 1 in their order.

    Returns
    -------
    (m,) int array
    (m, 3) float array
    str
        Kind of file.

    Raises
    ------
    DataError
        If no node is found, a line cannot be read, or a node is given twice at different places.
    """
    require_file(path)
    start = head(path, 1 << 16)
    if b"\0" in start or start.lstrip().startswith((SIGNATURE, b"<?xml", b"# vtk")):
        # In another process: the libraries of these formats may hang or crash on damaged files, and print.
        return _checked(*read_apart(_mesh, path), path, "mesh")
    lines = read_lines(path)
    what, nodes = _nodes(lines, path)
    if nodes is None:
        table = read_table(path, ("node", "x", "y", "z"))
        return _checked(table.integers("node"), table.floats("x", "y", "z"), path, what)
    numbers, places = [], []
    for line, cells in nodes:
        try:
            numbers.append(np.int64(int(cells[0])))
            places.append([fortran_number(cell) for cell in (*cells[1:4], "", "", "")[:3]])
        except (ValueError, OverflowError):
            raise _wrong(path, line, what, "a node number and three coordinates", repr(lines[line - 1][:72])) from None
    if not numbers:
        raise DataError(f"this {what} contains no nodes", file=path, expected="nodes with coordinates", found="none")
    return _checked(np.array(numbers, dtype=np.int64), np.array(places), path, what)


def _wrong(path: Path, line: int, what: str, expected: str, found: str, hint: str | None = None) -> DataError:
    return DataError(f"a node of this {what} cannot be read", file=path, place=f"line {line}", expected=expected, found=found, hint=hint)


def _checked(node: Integers, xyz: Floats, path: Path, what: str) -> tuple[Integers, Floats, str]:
    unique, first = np.unique(node, return_index=True)
    again = np.flatnonzero(np.abs(xyz - xyz[first[np.searchsorted(unique, node)]]).max(axis=1) > 0.0)
    if again.size:
        k = int(again[0])
        raise DataError(
            "one node lies at two places",
            file=path,
            expected="one place for each node",
            found=f"node {node[k]}",
            hint="the parts have separate node numbers: write the assembly flat, with one numbering, and export the matrices from it",
        )
    return unique, xyz[first], what


def _nodes(lines: list[str], path: Path) -> tuple[str, Iterator[_Cells] | None]:
    """Kind of a text file, and its nodes as cells with their lines; None for a table with a header."""
    begins = [line.lstrip().upper() for line in lines]
    if any(_KEYWORD.match(line) for line in begins):
        return "input file of Abaqus or CalculiX", _keyword_nodes(lines, path)
    if any(_GRID.match(line) for line in begins):
        return "input file of Nastran", _grids(lines, path)
    at = next((k for k, line in enumerate(begins) if line.startswith("NBLOCK")), None)
    if at is not None:
        return "archive of Ansys", _nblock(lines, at, path)
    if begins[0].startswith("1C") or any(re.match("2C +\\d", line) for line in begins[:500]):
        return "result file of CalculiX", _frd(lines)
    header = next((line for line in begins if line and line[0] not in "#!"), "")
    if re.match("[\"'A-Z]", header) and re.search("[,;\t]", header):
        return "table of nodes", None
    listed = ((k, line.replace(",", " ").split()) for k, line in enumerate(lines, start=1) if re.match(r"\s*\d+[\s,]", line))
    return "list of nodes", listed


def _keyword_nodes(lines: list[str], path: Path) -> Iterator[_Cells]:
    inside = False
    for k, line in enumerate(lines, start=1):
        text = line.strip().upper()
        moved = k < len(lines) and re.match(r"\s*[-+.\d]", lines[k]) is not None
        if text.startswith("*INSTANCE") and moved and any(cell.strip(" +-0.eE") for cell in lines[k].split(",")):
            raise _wrong(path, k + 1, "input file", "an instance at the place of its part", lines[k].strip(), "write the assembly flat")
        if text.startswith("*") and not text.startswith("**"):
            inside = _KEYWORD.match(text) is not None
            if inside and re.search(r"SYSTEM\s*=\s*[CS]", text):
                raise _wrong(path, k, "input file", "rectangular coordinates", text, "write the nodes in the global system")
        elif inside and text and not text.startswith("**"):
            yield k, text.split(",")


def _grids(lines: list[str], path: Path) -> Iterator[_Cells]:
    """Yield nodes of GRID entries in free, small or large fields: number, coordinate system, coordinates."""
    for k, line in enumerate(lines, start=1):
        if not _GRID.match(line.upper()):
            continue
        if "," in line:
            cells = [part.strip() for part in line.split(",")][1:7]
        elif line[:8].rstrip().endswith("*"):
            cells = [line[at : at + 16] for at in range(8, 72, 16)] + [lines[k][at : at + 16] if k < len(lines) else "" for at in (8, 24)]
        else:
            cells = [line[at : at + 8] for at in range(8, 56, 8)]
        for at, what in ((1, "coordinates"), (5, "displacements")):
            if cells[at:] and cells[at].strip() not in ("", "0"):
                found = f"{what} in system {cells[at].strip()}"
                raise _wrong(path, k, "input file of Nastran", f"{what} in the basic system", found, f"export {what} in the basic system")
        yield k, [cells[0], *cells[2:5]]


def _nblock(lines: list[str], at: int, path: Path) -> Iterator[_Cells]:
    """Yield nodes after ``NBLOCK`` and a Fortran format such as ``(3i9,6e21.13e3)``."""
    form = _FORMAT.match(lines[at + 1].upper()) if at + 1 < len(lines) else None
    if form is None:
        raise _wrong(
            path, at + 2, "archive of Ansys", "a format such as (3i9,6e21.13e3)", repr(lines[at + 1][:40]) if at + 1 < len(lines) else ""
        )
    count, whole, real = (int(form[k]) for k in (1, 2, 3))
    for k, line in enumerate(lines[at + 2 :], start=at + 3):
        if not re.match(r"\s*\d", line):
            break
        yield k, [line[:whole], *(line[count * whole + j * real : count * whole + (j + 1) * real] for j in range(3))]


def _frd(lines: list[str]) -> Iterator[_Cells]:
    """Yield nodes of the block ``2C``, with those of expanded shells and beams."""
    begin = next((k for k, line in enumerate(lines) if line.startswith("    2C")), len(lines)) + 1
    for k, line in enumerate(lines[begin:], start=begin + 1):
        if not line.startswith(" -1"):
            break
        at = len(line.rstrip()) - 36
        yield k, [line[3:at], *(line[at + 12 * j : at + 12 * j + 12] for j in range(3))]


def _mesh(path: Path) -> tuple[Integers, Floats]:
    start = head(path, 1 << 10)
    if start.lstrip().startswith(SIGNATURE):
        return read_gmsh(path)
    if start.startswith(b"CDF") or is_exodus(path):
        return read_exodus(path)
    try:
        import meshio
    except ImportError:
        raise DataError(
            "reading this mesh needs the package meshio",
            file=path,
            hint="pip install lrbc[meshes]; or give a table node,x,y,z",
        ) from None
    with damaged(path, "mesh"):
        mesh: Any = meshio.read(path)
        points = np.asarray(mesh.points, dtype=np.float64)
    xyz = np.zeros((points.shape[0], 3))
    xyz[:, : points.shape[1]] = points
    return np.arange(1, xyz.shape[0] + 1), xyz
