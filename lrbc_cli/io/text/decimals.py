"""Detects tables that lost decimal points in some cells, as in a spreadsheet that takes 1.234 for 1234."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from lrbc_cli.errors import DataError
from lrbc_cli.io.encoding import read_lines
from lrbc_cli.io.text.sniff import TextTable, split

#: A number of four and more digits without decimal sign or exponent: phases in degrees, which noise scatters, have three at most.
_BARE = re.compile(r"[+-]?\d{4,}")


def require_decimals(table: TextTable, path: Path, *, least: int = 3) -> None:
    """Refuse a table with whole numbers ten times and more the numbers before and after them, which have a decimal sign.

    A lost point multiplies by ten or more. Programs that write few digits drop the sign of large numbers, too, but their neighbours are as
    large: a resonance that rises tenfold from one line to the next, and falls again, is not resolved.

    Parameters
    ----------
    table : TextTable
    path : Path
    least : int
        Number of such cells from which the table is refused.

    Raises
    ------
    DataError
    """
    size = np.abs(table.values)
    if len(size) < 3:
        return
    high = (0.1 * size[1:-1] >= size[:-2]) & (0.1 * size[1:-1] >= size[2:]) & (size[1:-1] >= 1000.0)
    high &= size[1:-1] == np.floor(size[1:-1])
    rows, columns = (at.tolist() for at in np.nonzero(high))
    if len(rows) < least:
        return
    lines = read_lines(path)

    def cell(row: int, column: int) -> str:
        cells = split(lines[int(table.lines[row]) - 1], table.delimiter)
        return cells[column] if column < len(cells) else ""

    lost = [
        (row + 1, column)
        for row, column in zip(rows, columns, strict=True)
        if _BARE.fullmatch(cell(row + 1, column)) and all(re.search("[.,]", cell(beside, column)) for beside in (row, row + 2))
    ]
    if len(lost) < least:
        return
    row, column = lost[0]
    raise DataError(
        "decimal points are missing",
        file=path,
        place=f"line {table.lines[row]}, column {table.called(column)}",
        expected=f"a number with a decimal sign, as {cell(row - 1, column)} and {cell(row + 1, column)} before and after",
        found=f"{cell(row, column)!r}, and {len(lost) - 1} such cells more",
        hint="the file was probably saved by a spreadsheet that takes the point for a separator of thousands: export it again, and do not "
        "save it there",
    )
