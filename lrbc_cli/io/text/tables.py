"""Reads CSV tables: DOFs, named points, lists of DOFs, positions of terms. Unknown columns are refused, so that none is ignored."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.common import ends_early, head, require_file
from lrbc_cli.io.encoding import decode, read_lines, unfinished
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, DofTable, PointTable


@dataclass(frozen=True)
class Positions:
    """Positions of the terms of a parameter group, with their parameters and bolts.

    Attributes
    ----------
    xyz : (m, 3) float array
        Coordinates in metres.
    parameter : tuple of str or None
        Name of the parameter of each term; terms with equal names share one. None without such a column.
    bolt : tuple of str or None
        Bolt that each term belongs to, empty where to none. None without such a column.
    """

    xyz: NDArray[np.float64]
    parameter: tuple[str, ...] | None = None
    bolt: tuple[str, ...] | None = None


@dataclass(frozen=True)
class DofList:
    """DOFs of the terms of a parameter group, with their parameters and bolts.

    Attributes
    ----------
    dof : (m,) int array
        0-based.
    parameter : tuple of str or None
        Name of the parameter of each term; terms with equal names share one. None without such a column.
    xyz : (m, 3) float array or None
        Coordinates in metres; None without such columns.
    bolt : tuple of str or None
        Bolt that each term belongs to, empty where to none. None without such a column.
    """

    dof: NDArray[np.int64]
    parameter: tuple[str, ...] | None = None
    xyz: NDArray[np.float64] | None = None
    bolt: tuple[str, ...] | None = None


#: Coordinates closer than this are the same place [m]: no two bolts are that close, and no table is rounded that finely.
ONE_PLACE = 1e-6

#: Coordinates of one node may differ by this fraction of the table's extent: tables of single precision keep seven digits.
ROUNDING = 1e-6


@dataclass(frozen=True)
class Table:
    """Cells of a table, and the line number of each row in the file."""

    path: Path
    columns: dict[str, int]
    rows: list[list[str]]
    lines: list[int]

    def text(self, name: str) -> list[str]:
        """Column as text."""
        at = self.columns[name]
        return [row[at] for row in self.rows]

    def integers(self, name: str) -> NDArray[np.int64]:
        """Column as whole numbers."""
        values = np.empty(len(self.rows), dtype=np.int64)
        for index, cell in enumerate(self.text(name)):
            try:
                number = float(cell) if not cell.lstrip("+-").isdigit() else int(cell)
                if number != int(number) or abs(number) > 2**53:
                    raise ValueError(cell)
                values[index] = int(number)
            except (ValueError, OverflowError):
                if not cell:
                    raise self._lacking(index, name) from None
                raise self.error(index, name, "a whole number", cell) from None
        return values

    def floats(self, *names: str) -> NDArray[np.float64]:
        """Columns as finite numbers, (rows, names)."""
        values = np.empty((len(self.rows), len(names)))
        for column, name in enumerate(names):
            for index, cell in enumerate(self.text(name)):
                try:
                    values[index, column] = float(cell)
                except ValueError:
                    if not cell:
                        raise self._lacking(index, name) from None
                    hint = "write the numbers of this table with decimal points" if "," in cell else "write a number there"
                    raise self.error(index, name, "a number with a decimal point", cell, hint=hint) from None
            bad = np.flatnonzero(~np.isfinite(values[:, column]))
            if bad.size:
                raise self.error(int(bad[0]), name, "a finite number", self.rows[bad[0]][self.columns[name]])
        return values

    def _lacking(self, index: int, name: str) -> DataError:
        """Error that a cell, or the whole column, is empty."""
        if any(self.text(name)):
            hint = "write the number that belongs there, or remove the line"
            return self.error(index, name, "a number in every line", "nothing (an empty cell)", "a cell is empty", hint)
        hint = "fill it in" + (
            "; if all points lie in one plane, write the same number, for instance 0, in every line" if name in "xyz" else ""
        )
        return DataError(
            f"the column {name!r} is empty",
            file=self.path,
            place=f"lines {self.lines[0]} to {self.lines[-1]}" if len(self.lines) > 1 else f"line {self.lines[0]}",
            expected="a number in every line",
            found="only a heading",
            hint=hint,
        )

    def error(
        self, index: int, name: str, expected: str, found: object, problem: str = "a value is wrong", hint: str | None = None
    ) -> DataError:
        """Error about one cell."""
        place = f"line {self.lines[index]}, column {name!r}"
        return DataError(problem, file=self.path, place=place, expected=expected, found=repr(found), hint=hint)

    def names(self, name: str) -> tuple[str, ...] | None:
        """Column of names, which must not be empty; None if there is no such column."""
        if name not in self.columns:
            return None
        names = tuple(self.text(name))
        for index, cell in enumerate(names):
            if not cell:
                raise self.error(index, name, "a name or number in every line", cell)
        return names

    def owners(self, known: Collection[str] | None) -> tuple[str, ...] | None:
        """Bolt of each row, empty if it names none; None without such a column. `known`: names in the bolts file."""
        if "bolt" not in self.columns:
            return None
        names = tuple(self.text("bolt"))
        for index, name in enumerate(names):
            if name and known is not None and name not in known:
                raise self.error(
                    index,
                    "bolt",
                    f"one of {listing(list(known))}",
                    name,
                    "this bolt is unknown",
                    "correct the name, or add the bolt to the bolts file",
                )
        return names

    def require_distinct(self, name: str, values: Sequence[object]) -> None:
        """Refuse a value that occurs in two rows."""
        seen: dict[object, int] = {}
        for index, value in enumerate(values):
            if value in seen:
                hint = self._twice(name, value, seen[value], index)
                raise self.error(index, name, "values that differ", value, "a value is given twice in the table", hint)
            seen[value] = index

    def _twice(self, name: str, value: object, first: int, second: int) -> str:
        """Advice for two rows with the same value: if they differ in other columns, removing one would lose data."""
        pairs = {key: (self.rows[first][at], self.rows[second][at]) for key, at in self.columns.items() if key != name}
        differ = {
            key: f"{key} {one or 'empty'} and {other or 'empty'}" for key, (one, other) in pairs.items() if _cell(one) != _cell(other)
        }
        lines = f"lines {self.lines[first]} and {self.lines[second]}"
        if not differ:
            return f"{lines} are identical: remove one of the two"
        how = "lie at different places" if differ.keys() <= {"x", "y", "z"} else "differ"
        what = value if name == "name" else f"{name} {value}"
        return f"{lines} are both {what} but {how} ({', '.join(differ.values())}): give one its own {name}"


def _cell(cell: str) -> str | float:
    """Cell as number or text for comparison, since a number can be written in several ways."""
    try:
        return float(cell)
    except ValueError:
        return cell


def is_dof_table(path: Path) -> bool:
    """Whether a file is a table with DOFs; otherwise it is a table, input file or mesh with nodes only."""
    require_file(path)
    lines = (line.strip() for line in decode(head(path, 1 << 16)).splitlines())
    header = next((line for line in lines if line and line[0] != "#"), "")
    cells = [cell.strip(" \"'").lower() for cell in re.split("[,;\t]", header)]
    return len(cells) > 2 and header[0] not in "*$" and ("node" not in cells or "dof" in cells or "component" in cells)


def read_dof_table(path: Path) -> DofTable:
    """Read the DOF of each matrix row: columns ``dof, node, component, x, y, z`` in any order.

    DOFs count from 0; each of 0 to n - 1 must occur in exactly one line, in any order.

    Raises
    ------
    DataError
        With the line number, if a column is missing or unknown, a value is wrong, missing or repeated, two DOFs have the same node and
        component, or a node of a field has two places.
    """
    table = read_table(path, ("dof", "node", "component", "x", "y", "z"))
    dof = table.integers("dof")
    n = dof.size
    order = np.full(n, -1, dtype=np.int64)
    for index, value in enumerate(dof.tolist()):
        if not 0 <= value < n:
            from_one = bool(dof.min() == 1 and dof.max() == n)
            hint = "DOFs count from 0, this table counts from 1" if from_one else "the table needs one line for every DOF"
            raise table.error(index, "dof", f"0 to {n - 1}, as the table has {n} lines of data", value, "a DOF is out of range", hint)
        order[value] = index
    table.require_distinct("dof", dof.tolist())
    component = [cell.upper() for cell in table.text("component")]
    for index, cell in enumerate(component):
        if not cell:
            raise table.error(index, "component", "UX, UY, UZ, ROTX, ROTY, ROTZ, PRES or another label", cell)
    labels, node, xyz = np.asarray(component, dtype=np.str_), table.integers("node"), table.floats("x", "y", "z")
    _require_one_dof(table, node, labels)
    # Nodes of structure and air may be numbered separately, each from 1.
    for field in (labels == ACOUSTIC_COMPONENT, labels != ACOUSTIC_COMPONENT):
        _require_one_place(table, np.flatnonzero(field), node, xyz)
    return DofTable(node=node[order], component=labels[order], xyz=xyz[order])


def _require_one_dof(table: Table, node: NDArray[np.int64], labels: NDArray[np.str_]) -> None:
    """Refuse two DOFs with the same node and component, since a selection by these would be ambiguous."""
    _, number = np.unique(labels, return_inverse=True)
    order = np.lexsort((number, node))
    again = np.flatnonzero((np.diff(node[order]) == 0) & (np.diff(number[order]) == 0))
    if again.size:
        first, second = sorted(order[[again[0], again[0] + 1]].tolist())
        raise table.error(
            second,
            "component",
            "one DOF for each node and component",
            f"{labels[second]} at node {node[second]}",
            "two DOFs have one node and component",
            f"line {table.lines[first]} already contains it; give internal DOFs their own nodes or labels",
        )


def _require_one_place(table: Table, rows: NDArray[np.int64], node: NDArray[np.int64], xyz: NDArray[np.float64]) -> None:
    """Refuse a node with two places."""
    order = rows[np.argsort(node[rows], kind="stable")]
    same = np.flatnonzero(np.diff(node[order]) == 0)
    if not same.size:
        return
    apart = np.abs(xyz[order[same + 1]] - xyz[order[same]]).max(axis=1)
    far = same[apart > ROUNDING * float(np.ptp(xyz, axis=0).max())]
    if far.size:
        first, second = int(order[far[0]]), int(order[far[0] + 1])
        raise table.error(
            second,
            "node",
            "one place for each node",
            f"node {node[second]} at {_place(xyz[second])}",
            "one node lies at two places",
            f"line {table.lines[first]} says {_place(xyz[first])}: correct one of them",
        )


def _place(point: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:.9g}" for value in point) + ")"


def read_points(path: Path) -> PointTable:
    """Read named points, such as bolts: columns ``name, x, y, z``; names and places must be distinct.

    Raises
    ------
    DataError
        With the line number, if a column is missing or unknown, a value is wrong, or a name or place is repeated.
    """
    table = read_table(path, ("name", "x", "y", "z"))
    names = table.text("name")
    for index, name in enumerate(names):
        if not name:
            raise table.error(index, "name", "a name", name)
    table.require_distinct("name", names)
    xyz = table.floats("x", "y", "z")
    near = min(cKDTree(xyz).query_pairs(ONE_PLACE), default=None)
    if near is not None:
        first, second = near
        raise table.error(
            second,
            "name",
            "one point at each place",
            f"{names[second]} at {_place(xyz[second])}",
            "two points lie at one place",
            f"line {table.lines[first]} already puts {names[first]} there; correct the coordinates of one, or remove the duplicate (of two "
            "joints that really lie at one place, as in a stack of plates, move one by 0.1 mm)",
        )
    return PointTable(name=tuple(names), xyz=xyz)


def read_dof_list(path: Path, bolts: Collection[str] | None = None) -> DofList:
    """Read the DOFs of terms in the order of the table: column ``dof`` (0-based), optionally ``parameter``, ``bolt`` and ``x, y, z``.

    Raises
    ------
    DataError
        With the line number, if the column is missing or another unknown, a value is wrong or repeated, or a bolt is not in ``bolts``.
    """
    table = read_table(path, ("dof",), ("parameter", "bolt", "x", "y", "z"))
    dof = table.integers("dof")
    for index, value in enumerate(dof.tolist()):
        if value < 0:
            raise table.error(index, "dof", "0 or more", value, "a DOF is out of range")
    table.require_distinct("dof", dof.tolist())
    axes = [axis for axis in "xyz" if axis in table.columns]
    if axes and len(axes) < 3:
        raise DataError("coordinates need three columns", file=path, expected="x, y and z, or none of them", found=listing(axes))
    return DofList(dof, table.names("parameter"), table.floats("x", "y", "z") if axes else None, table.owners(bolts))


def read_nodes(path: Path) -> tuple[int, ...]:
    """Read a column ``node`` in the order of the table.

    Raises
    ------
    DataError
        With the line number, if the column is missing or another unknown, or a value is wrong or repeated.
    """
    table = read_table(path, ("node",))
    nodes = table.integers("node")
    table.require_distinct("node", nodes.tolist())
    return tuple(nodes.tolist())


def read_positions(path: Path, bolts: Collection[str] | None = None) -> Positions:
    """Read positions of terms: columns ``x, y, z``, optionally ``parameter`` (terms may share one) and ``bolt`` (the owner).

    Raises
    ------
    DataError
        With the line number, if a column is missing or unknown, a value is wrong, or a bolt is not in ``bolts``.
    """
    table = read_table(path, ("x", "y", "z"), ("parameter", "bolt"))
    return Positions(xyz=table.floats("x", "y", "z"), parameter=table.names("parameter"), bolt=table.owners(bolts))


def read_table(path: Path, needed: Sequence[str], further: Sequence[str] = ()) -> Table:
    """Read a table with a header; columns `needed` must exist, those in `further` may, and others are refused."""
    require_file(path)
    numbered = [(number, line) for number, line in enumerate(read_lines(path), start=1) if line.strip() and line.lstrip()[0] != "#"]
    if not numbered:
        raise DataError("the table is empty", file=path, expected=f"a header with {listing(list(needed))}", found="no lines")
    first, header_line = numbered[0]
    delimiter = max(",;\t", key=header_line.count)
    header = [cell.lower() for cell in _cells(header_line, delimiter, path, first)]
    while header and not header[-1]:
        header.pop()
    place = f"line {first}"
    repeated = [name for name in dict.fromkeys(header) if header.count(name) > 1]
    if repeated:
        raise DataError(
            "a column is given twice in the header", file=path, place=place, expected="names that differ", found=listing(repeated)
        )
    missing = [name for name in needed if name not in header]
    if missing:
        raise DataError(
            f"the column{'s' if len(missing) > 1 else ''} {listing(missing)} {'are' if len(missing) > 1 else 'is'} missing",
            file=path,
            place=place,
            expected=f"a header with {listing(list(needed))}",
            found=listing([repr(cell) for cell in header]),
        )
    unknown = [name for name in header if name not in (*needed, *further)]
    if unknown:
        raise DataError(
            f"unknown column{'s' if len(unknown) > 1 else ''} {listing([repr(cell) for cell in unknown])}",
            file=path,
            place=place,
            expected=listing([*needed, *further]),
            found=listing([repr(cell) for cell in header]),
            hint="correct the name, or remove the column; write comments in lines that begin with #",
        )
    rows, lines = [], []
    for number, line in numbered[1:]:
        cells = _cells(line, delimiter, path, number)
        if len(cells) < len(header) or any(cells[len(header) :]):
            expected, found = f"{len(header)} values", f"{len(cells)} values"
            if number == numbered[-1][0] and len(cells) < len(header) and unfinished(path.read_bytes()):
                raise ends_early(path, f"line {number}", expected, found)
            raise DataError("the line does not fit the header", file=path, place=f"line {number}", expected=expected, found=found)
        rows.append(cells)
        lines.append(number)
    if not rows:
        raise DataError("the table has a header but no lines", file=path, place=place, expected="lines of data", found="none")
    return Table(path, {name: position for position, name in enumerate(header)}, rows, lines)


def _cells(line: str, delimiter: str, path: Path, number: int) -> list[str]:
    cells = line.split(delimiter)
    if '"' in line:
        try:
            cells = next(csv.reader([line], delimiter=delimiter, strict=True))
        except (csv.Error, StopIteration) as error:
            place = f"line {number}"
            raise DataError("the line cannot be split", file=path, place=place, expected="balanced quotes", found=str(error)) from error
    return [cell.strip() for cell in cells]
