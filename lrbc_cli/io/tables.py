"""Tables in CSV: DOFs, named points, lists of DOFs, positions of terms."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import listing, require_file
from lrbc_cli.io.text import read_lines
from lrbc_cli.model.dofs import DofTable, PointTable


@dataclass(frozen=True)
class Positions:
    """Where the terms of a parameter group lie.

    Attributes
    ----------
    xyz : (m, 3) float array
        Coordinates in metres.
    parameter : tuple of str or None
        Name of the parameter of each term; terms with equal names share one. None without such a column.
    """

    xyz: NDArray[np.float64]
    parameter: tuple[str, ...] | None = None


@dataclass(frozen=True)
class _Table:
    path: Path
    columns: dict[str, int]
    rows: list[list[str]]
    lines: list[int]

    def text(self, name: str) -> list[str]:
        """One column as text."""
        at = self.columns[name]
        return [row[at] for row in self.rows]

    def integers(self, name: str) -> NDArray[np.int64]:
        """One column as whole numbers."""
        values = np.empty(len(self.rows), dtype=np.int64)
        for index, cell in enumerate(self.text(name)):
            try:
                number = float(cell) if not cell.lstrip("+-").isdigit() else int(cell)
                if number != int(number) or abs(number) > 2**53:
                    raise ValueError(cell)
                values[index] = int(number)
            except (ValueError, OverflowError):
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
                    raise self.error(index, name, "a number with a decimal point", cell) from None
            bad = np.flatnonzero(~np.isfinite(values[:, column]))
            if bad.size:
                raise self.error(int(bad[0]), name, "a finite number", self.rows[bad[0]][self.columns[name]])
        return values

    def error(
        self, index: int, name: str, expected: str, found: object, problem: str = "a value is wrong", hint: str | None = None
    ) -> DataError:
        place = f"line {self.lines[index]}, column {name!r}"
        return DataError(problem, file=self.path, place=place, expected=expected, found=repr(found), hint=hint)

    def require_distinct(self, name: str, values: Sequence[object]) -> None:
        """Refuse a value that stands in two lines."""
        seen: dict[object, int] = {}
        for index, value in enumerate(values):
            if value in seen:
                hint = f"line {self.lines[seen[value]]} holds it already; remove one of the two"
                raise self.error(index, name, "values that differ", value, "a value stands in the table twice", hint)
            seen[value] = index


def read_dof_table(path: Path) -> DofTable:
    """Read what each row of the matrices stands for: columns ``dof, node, component, x, y, z`` in any order.

    DOFs count from 0; each of 0 to n - 1 must stand in exactly one line, in any order. Other columns are ignored.

    Raises
    ------
    DataError
        With the line number, if a column is missing or a value is wrong, missing or double.
    """
    table = _read(path, ("dof", "node", "component", "x", "y", "z"))
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
    return DofTable(
        node=table.integers("node")[order], component=np.asarray(component, dtype=np.str_)[order], xyz=table.floats("x", "y", "z")[order]
    )


def read_points(path: Path) -> PointTable:
    """Read named points, such as bolts: columns ``name, x, y, z``; names must differ.

    Raises
    ------
    DataError
        With the line number, if a column is missing, a value is wrong or a name is double.
    """
    table = _read(path, ("name", "x", "y", "z"))
    names = table.text("name")
    for index, name in enumerate(names):
        if not name:
            raise table.error(index, "name", "a name", name)
    table.require_distinct("name", names)
    return PointTable(name=tuple(names), xyz=table.floats("x", "y", "z"))


def read_dof_list(path: Path) -> NDArray[np.int64]:
    """Read DOFs (0-based) from the column ``dof`` of a table, in its order.

    Raises
    ------
    DataError
        With the line number, if the column is missing, or a value is wrong or double.
    """
    table = _read(path, ("dof",))
    dof = table.integers("dof")
    for index, value in enumerate(dof.tolist()):
        if value < 0:
            raise table.error(index, "dof", "0 or more", value, "a DOF is out of range")
    table.require_distinct("dof", dof.tolist())
    return dof


def read_positions(path: Path) -> Positions:
    """Read positions of terms: columns ``x, y, z`` and, where terms share a parameter, ``parameter``.

    Raises
    ------
    DataError
        With the line number, if a column is missing or a value is wrong.
    """
    table = _read(path, ("x", "y", "z"))
    parameter = None
    if "parameter" in table.columns:
        parameter = tuple(table.text("parameter"))
        for index, name in enumerate(parameter):
            if not name:
                raise table.error(index, "parameter", "a name or number in every line", name)
    return Positions(xyz=table.floats("x", "y", "z"), parameter=parameter)


def _read(path: Path, needed: Sequence[str]) -> _Table:
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
            "a column stands in the header twice", file=path, place=place, expected="names that differ", found=listing(repeated)
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
    rows, lines = [], []
    for number, line in numbered[1:]:
        cells = _cells(line, delimiter, path, number)
        if len(cells) < len(header) or any(cells[len(header) :]):
            expected, found = f"{len(header)} values", f"{len(cells)} values"
            raise DataError("the line does not fit the header", file=path, place=f"line {number}", expected=expected, found=found)
        rows.append(cells)
        lines.append(number)
    if not rows:
        raise DataError("the table has a header but no lines", file=path, place=place, expected="lines of data", found="none")
    return _Table(path, {name: position for position, name in enumerate(header)}, rows, lines)


def _cells(line: str, delimiter: str, path: Path, number: int) -> list[str]:
    cells = line.split(delimiter)
    if '"' in line:
        try:
            cells = next(csv.reader([line], delimiter=delimiter, strict=True))
        except (csv.Error, StopIteration) as error:
            place = f"line {number}"
            raise DataError("the line cannot be split", file=path, place=place, expected="balanced quotes", found=str(error)) from error
    return [cell.strip() for cell in cells]
