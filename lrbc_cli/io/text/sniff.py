"""Finds the table of numbers in a text file: its first line, separator, decimal sign and headings."""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import LONGEST_NUMBER, ends_early
from lrbc_cli.io.encoding import read_lines
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.text.header import Heading, read_headings, stated_axis_unit, stated_unit

# Each digit can match in one way only, so that text which is no number is rejected in linear time.
# By the decimal sign; a comma has digits behind it.
_NUMBER = {
    ".": re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eEdD][-+]?\d+)?|[-+]?(?:nan|inf(?:inity)?)|", re.IGNORECASE),
    ",": re.compile(r"[-+]?(?:\d+(?:,\d+)?|,\d+)(?:[eEdD][-+]?\d+)?|[-+]?(?:nan|inf(?:inity)?)|", re.IGNORECASE),
}
_CANDIDATES = (("\t", "."), (";", "."), (",", "."), (" ", "."), ("\t", ","), (";", ","), (" ", ","))
# A quoted number with a decimal comma: only with such cells may commas separate the columns, too.
_QUOTED_COMMA = re.compile(r'"\s*[-+]?\d*,\d+(?:[eEdD][-+]?\d+)?\s*"')
# Number of lines at the end of a file from which its separators are determined.
_SAMPLE = 200
# A complex number in one cell, recognised by its imaginary unit.
_COMPLEX = re.compile(r"\d\s*\*?\s*[ij](?![a-z])|[-+*]\s*[ij]\s*\*?\s*\d", re.IGNORECASE)
# A number with thousands separators.
_GROUPED = re.compile(r"[-+]?\d{1,3}(?:(?:\.\d{3})+,\d+|(?:,\d{3})+\.\d+|(?:['\u2019\u00a0\u202f]\d{3})+(?:[.,]\d+)?|(?:\.\d{3}){2,})")
_NAMES = {"\t": "tab", " ": "blanks", ",": "comma", ";": "semicolon"}


@dataclass(frozen=True, kw_only=True)
class TextTable:
    """Table of numbers in a text file, with the names and units of its columns.

    Attributes
    ----------
    values : (lines, columns) float array
        Values, without unreadable lines at the beginning.
    lines : (lines,) int array
        Line number of each row in the file.
    headings : tuple of Heading
        One for each column.
    unit : str
        Unit of the values, if a line above the table states it.
    axis_unit : str
        Unit of the frequencies, likewise.
    notes : tuple of str
        What was recognised and not stated by the layout.
    begins : str
        Note on where the numbers begin, for a file of one table.
    delimiter : str
        Separator of the cells.
    """

    values: NDArray[np.float64]
    lines: NDArray[np.int64]
    headings: tuple[Heading, ...]
    unit: str
    axis_unit: str
    notes: tuple[str, ...]
    begins: str
    delimiter: str

    def called(self, at: int) -> str:
        """Name or number of a column, for messages."""
        return self.headings[at].text or str(at + 1)

    def cell(self, path: Path, row: int, at: int) -> str:
        """Text of a cell in the file, for messages."""
        cells = split(read_lines(path)[int(self.lines[row]) - 1], self.delimiter)
        return (cells[at] if at < len(cells) else "") or "nothing (an empty cell)"


def read_table(path: Path, layout: TextLayout, lines: list[str], before: int = 0) -> TextTable:
    """Find the block of numbers and its header in lines of a file, which follow `before` other lines.

    Raises
    ------
    DataError
        If there is no such block, or a line in it does not fit.
    """
    skip = layout.skip or 0
    known = [*_CANDIDATES, *([(",", ",")] if any(map(_QUOTED_COMMA.search, lines[-_SAMPLE:])) else [])]
    candidates = [(d, p) for d, p in known if layout.delimiter in (None, d) and layout.decimal in (None, p)]
    best, parts = _best(lines[skip:], candidates), None
    if best is None and (halved := _halved(lines, candidates)) is not None:
        lines, parts = halved
        best = _best(lines[skip:], candidates)
    if best is None:
        raise _no_table(lines, before, path)
    width, delimiter, decimal = best
    start = next(index for index in range(skip, len(lines)) if _fits(lines[index], delimiter, decimal, width))
    unusable = _unusable(lines, skip, start, delimiter, decimal, width)
    above = lines[skip : start - unusable]
    for names in (len(split(line, ",")) for line in above[-2:] if parts is None and delimiter == ","):
        if names < width <= 2 * names:
            _refuse_decimal_commas(lines[start], start + 1, names, path)
    rows, numbers = _rows(lines, start, before, delimiter, decimal, width, path)
    headings = read_headings(above, delimiter, width if parts is None else len(parts))
    notes = []
    if parts is not None:
        notes.append("complex cells read as real and imaginary part")
        headings = tuple(replace(one, part=part or one.part) for one, two in zip(headings, parts, strict=True) for part in two)
    if layout.delimiter is None or layout.decimal is None:
        notes.append(f"columns separated by {_NAMES[delimiter]}, decimal {'point' if decimal == '.' else 'comma'}")
    usable = np.isfinite(rows).all(axis=1)
    first = int(np.argmax(usable)) if usable.any() else 0
    if first or unusable:
        several = f"{first + unusable} lines" if first + unusable > 1 else "line"
        notes.append(f"left out: the first {several} of numbers (empty or not finite)")
    return TextTable(
        values=rows[first:],
        lines=numbers[first:],
        headings=headings,
        unit=stated_unit(above),
        axis_unit=stated_axis_unit(above),
        notes=tuple(notes),
        begins=f"numbers from line {before + start + 1} on, {'header found' if any(one != Heading() for one in headings) else 'no header'}",
        delimiter=delimiter,
    )


def _no_table(lines: list[str], before: int, path: Path) -> DataError:
    """Error for lines (after `before` others) without any line of numbers."""
    place, found = None, next((line for line in lines if line.strip()), "")
    hint = "describe the layout under 'format:' of the job"
    grouped = next((at for at, line in enumerate(lines) if _grouped(line)), None)
    if grouped is not None:
        place, found, hint = f"line {before + grouped + 1}", lines[grouped], _ungroup(_grouped(lines[grouped]))
    elif any(_COMPLEX.search(line) for line in lines[-_SAMPLE:]):
        hint = "complex numbers in one cell are not read in this form: export real and imaginary part in two columns"
    expected = "lines with a frequency and values, separated by tab, semicolon, comma or blanks"
    return DataError("no table of numbers was found", file=path, place=place, expected=expected, found=repr(found[:80]), hint=hint)


def _grouped(line: str) -> str:
    """First cell of a line that is a number with thousands separators; empty if there is none."""
    cells = (cell for delimiter in "\t; " for cell in split(line, delimiter))
    return next((cell for cell in cells if len(cell) <= LONGEST_NUMBER and _GROUPED.fullmatch(cell)), "")


def _ungroup(cell: str) -> str:
    """Advice on thousands separators."""
    return f"{cell!r} has thousands separators: export without them (in a spreadsheet: format the cells as numbers without grouping)"


def _refuse_decimal_commas(line: str, number: int, names: int, path: Path) -> None:
    """Refuse a line with up to twice as many cells as the header has names, if every second cell can be decimals of the one before.

    The first columns may be whole numbers, as frequencies often are.
    """
    cells = split(line, ",")
    if "." not in line and all(cell[:1].isdigit() for cell in cells[2 * names - len(cells) :][1::2]):
        raise DataError(
            "the comma is both decimal sign and column separator",
            file=path,
            place=f"line {number}",
            expected=f"{names} columns, as in the header",
            found=f"{len(cells)} cells: {line[:60]}",
            hint="export with semicolons or tabs between the columns, or with decimal points",
        )


def split(line: str, delimiter: str) -> list[str]:
    """Cells of a line, without quotes and blanks around them."""
    if delimiter == " ":
        return line.split()
    if '"' in line:
        # Quotes protect separators, unless they surround the whole line.
        if len(cells := _quoted(line, delimiter)) > 1:
            return cells
        line = line.replace('"', "")
    return [cell.strip() for cell in line.split(delimiter)]


def _quoted(line: str, delimiter: str) -> list[str]:
    """Cells of a line, some of them in quotes; empty if the quotes are unusable."""
    try:
        return [cell.replace('"', "").strip() for cell in next(csv.reader([line.strip()], delimiter=delimiter), [])]
    except csv.Error:
        return []


def _fits(line: str, delimiter: str, decimal: str, width: int | None) -> bool:
    """Whether a line consists of numbers; empty cells are allowed if the first cell and another one are numbers."""
    cells = _filled(line, delimiter, width or 0)
    if len(cells) < 2 or not cells[0] or (width is not None and len(cells) != width) or max(map(len, cells)) > LONGEST_NUMBER:
        return False
    return all(_NUMBER[decimal].fullmatch(cell) for cell in cells)


def _filled(line: str, delimiter: str, least: int = 0) -> list[str]:
    """Cells of a line without empty ones at its end, as long as ``least`` and two are left."""
    cells = split(line, delimiter)
    while len(cells) > max(2, least) and not cells[-1]:
        cells.pop()
    return cells


def _unusable(lines: list[str], skip: int, start: int, delimiter: str, decimal: str, width: int) -> int:
    """Number of lines above the numbers with a frequency and no other numbers: near 0 Hz some programs write words."""
    count = 0
    while start - count > skip:
        cells = split(lines[start - count - 1], delimiter)
        if len(cells) != width or not cells[0] or not _NUMBER[decimal].fullmatch(cells[0]):
            break
        count += 1
    return count


def _best(lines: list[str], candidates: list[tuple[str, str]]) -> tuple[int, str, str] | None:
    """Number of columns, separator and decimal sign with which most lines are numbers; None if none are."""
    tail = [line for line in lines if line.strip()][-_SAMPLE:]
    best, most = None, 0
    for delimiter, decimal in candidates:
        count, width = _extent(tail, delimiter, decimal)
        if width >= 2 and count > most:
            best, most = (width, delimiter, decimal), count
    return best


def _halved(lines: list[str], candidates: list[tuple[str, str]]) -> tuple[list[str], tuple[tuple[str | None, ...], ...]] | None:
    """Lines with complex cells (``1.2+3.4j``) split in two, and the part in each new column; None if no cell is complex."""
    tail = [line for line in lines if line.strip()][-_SAMPLE:]
    for delimiter, decimal in candidates:
        number = rf"(?:\d+(?:{re.escape(decimal)}\d*)?|{re.escape(decimal)}\d+)(?:e[-+]?\d+)?"
        pattern = re.compile(rf"\(?([-+]?{number})(?:\s*([-+])\s*({number})\s*\*?\s*[ij])?\)?", re.IGNORECASE)

        def divided(line: str, delimiter: str = delimiter, pattern: re.Pattern[str] = pattern) -> list[re.Match[str] | None]:
            return [pattern.fullmatch(cell) if len(cell) <= 2 * LONGEST_NUMBER else None for cell in split(line, delimiter)]

        rows = [row for row in map(divided, tail) if len(row) > 1 and all(row)]
        width = len(rows[-1]) if rows else 0
        # The first column is the frequency; some programs write it as a complex number with a zero imaginary part.
        two = [any(len(row) == width and (cell := row[at]) and cell[3] for row in rows) for at in range(width)]
        if not any(two[1:]):
            continue
        found = []
        for line in lines:
            row = divided(line)
            if len(row) == width and all(row):
                cells = zip(row, two, strict=True)
                line = delimiter.join(
                    f"{m[1]}{delimiter}{m[2] or ''}{m[3] or 0}" if both and at else m[1] for at, (m, both) in enumerate(cells) if m
                )
            found.append(line)
        return found, tuple(("real", "imag") if both and at else (None,) for at, both in enumerate(two))
    return None


def _extent(lines: list[str], delimiter: str, decimal: str) -> tuple[int, int]:
    """Number of lines of numbers with the most frequent width, and this width."""
    widths = Counter(len(_filled(line, delimiter)) for line in lines if _fits(line, delimiter, decimal, None))
    return max(((count, width) for width, count in widths.items()), default=(0, 0))


def _misfit(line: str, delimiter: str, decimal: str, width: int) -> str:
    """Description of what is wrong with a line: its number of cells, else its first cell that is no number."""
    cells = split(line, delimiter)
    wrong = [index for index, cell in enumerate(cells) if len(cell) > LONGEST_NUMBER or not _NUMBER[decimal].fullmatch(cell)]
    if len(cells) != width or not wrong:
        return f"{len(cells)} cells: {line[:80]!r}"
    return f"{cells[wrong[0]][:80]!r} in column {wrong[0] + 1}"


def _begins(line: str, delimiter: str, decimal: str) -> bool:
    """Whether all cells but the last are numbers, so that the line belongs to the table and is not text below it."""
    cells = split(line, delimiter)[:-1]
    return bool(cells) and _fits(delimiter.join(cells), delimiter, decimal, len(cells))


def _rows(
    lines: list[str], start: int, before: int, delimiter: str, decimal: str, width: int, path: Path
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    cells: list[str] = []
    numbers: list[int] = []
    for index in range(start, len(lines)):
        line = lines[index]
        if not line.strip() or line.lstrip()[0] in "#%":
            continue
        if not _fits(line, delimiter, decimal, width):
            last = numbers and not any(map(str.strip, lines[index + 1 :]))
            if last and len(split(line, delimiter)) <= width and _begins(line, delimiter, decimal):
                raise ends_early(path, f"line {before + index + 1}", f"{width} numbers", _misfit(line, delimiter, decimal, width))
            raise DataError(
                "a line does not fit the table",
                file=path,
                place=f"line {before + index + 1}",
                expected=f"{width} numbers",
                found=_misfit(line, delimiter, decimal, width),
                hint=_ungroup(grouped)
                if (grouped := _grouped(line))
                else "correct the line, or set 'format: {skip: ...}' of the job to the number of lines before the table",
            )
        cells += split(line, delimiter)[:width]
        numbers.append(before + index + 1)
    texts = [(cell.replace(",", ".") if decimal == "," else cell).upper().replace("D", "E") or "nan" for cell in cells]
    values = np.array(texts, dtype=np.str_).astype(np.float64)
    return values.reshape(len(numbers), width), np.asarray(numbers, dtype=np.int64)
