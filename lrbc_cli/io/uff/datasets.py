"""Parses universal files: splits them into datasets, and reads datasets 58 and 58b (functions) and 164 (units) in full.

The layout follows the descriptions of datasets 58, 58b and 164 by the Structural Dynamics Research Laboratory,
University of Cincinnati. Real files differ from it, so the reader takes fields by column and, if that fails, by
words; it trusts the byte count of a binary dataset and, if no dataset ends there, the number of values; and it accepts
line ends of any kind.

Why not pyuff (2.5): it silently drops a truncated record, while this reader names record, line and both counts; units (dataset 164),
digits of the axis and pairs of FRF and coherence would have to be added to it all the same.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import LONGEST_NUMBER, ends_early
from lrbc_cli.io.encoding import decode, unfinished
from lrbc_cli.io.uff.axis import even_axis
from lrbc_cli.io.uff.form import DataForm, data_form

_DELIMITER = re.compile(rb"^[ \t]*-1[ \t]*\r?(?:\n|\Z)", re.MULTILINE)
_IDENTIFIER = re.compile(r"\s*(\d{1,6})([bB])?(?![\w.])(.*)")
_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][-+]?\d{1,3}|[-+]\d{3})?")
_HEADER_LINES = 11
# Most digits of a whole number in a header, so that it fits into 64 bits.
_DIGITS = 18


@dataclass(frozen=True, kw_only=True)
class UffAxis:
    """Records 8 to 10 of a function: specific data type, exponents of (length, force), label and unit."""

    kind: int
    length: int
    force: int
    label: str
    unit: str


@dataclass(frozen=True, kw_only=True)
class UffUnits:
    """Dataset 164: a value of the file divided by the factor is in SI (see ``uff/read.py``)."""

    description: str
    length: float
    force: float


@dataclass(frozen=True, kw_only=True)
class UffFunction:
    """One dataset 58 or 58b with the values of the file, not converted.

    Attributes
    ----------
    record : int
        Number among the functions of the file, from 1.
    function_type : int
        4 is a frequency response function, 6 a coherence.
    abscissa : (F,) float array
    values : (F,) float or complex array
    point_lines : (F,) int array or None
        Line on which each point starts; None for binary data.
    """

    record: int
    id_lines: tuple[str, ...]
    function_type: int
    response_name: str
    response_node: int
    response_direction: int
    reference_name: str
    reference_node: int
    reference_direction: int
    abscissa: NDArray[np.float64]
    values: NDArray[Any]
    abscissa_axis: UffAxis
    numerator: UffAxis
    denominator: UffAxis
    notes: tuple[str, ...] = ()
    point_lines: NDArray[np.int64] | None = None

    def point_place(self, index: int) -> str:
        """Place of a point for messages."""
        line = "" if self.point_lines is None else f" (line {self.point_lines[index]})"
        return f"record {self.record}, point {index + 1}{line}"


@dataclass(frozen=True, kw_only=True)
class _Dataset:
    number: int
    binary: bool
    identifier: str
    start: int
    place: str
    line: int | None


def is_uff(start: bytes) -> bool:
    """Whether the first bytes of a file look like a universal file: a line ``-1``, then a dataset number."""
    lines = [line.strip() for line in start.splitlines()[:20]]
    first = next((line for line in lines if line not in (b"", b"-1")), b"")
    return b"-1" in lines[: lines.index(first)] and _IDENTIFIER.fullmatch(decode(first[:100])) is not None if first else False


def read_datasets(path: Path) -> tuple[list[UffFunction], list[UffUnits | None], list[str]]:
    """Read all functions of a universal file, the units that apply to each (None if not stated), and notes.

    Raises
    ------
    DataError
        If the file is no universal file, or a dataset cannot be read; its number is named.
    """
    content = path.read_bytes()
    functions: list[UffFunction] = []
    units: list[UffUnits | None] = []
    notes: list[str] = []
    current: UffUnits | None = None
    for dataset, end in _split(content, path, notes, functions):
        if dataset.number == 164:
            current = _units(content[dataset.start : end], path, dataset.place)
            units = [current if unit is None else unit for unit in units]
        elif dataset.number == 58 and not dataset.binary:
            functions.append(_function(dataset, content[dataset.start : end], path, len(functions) + 1))
        while len(units) < len(functions):
            units.append(current)
    return functions, units, notes


def dataset_numbers(path: Path) -> list[int]:
    """Numbers of the datasets in a universal file, each once."""
    return sorted({dataset.number for dataset, _ in _split(path.read_bytes(), path, [], [])})


def _split(content: bytes, path: Path, notes: list[str], functions: list[UffFunction]) -> Iterator[tuple[_Dataset, int]]:
    """Yield each dataset with the end of its body; binary functions are read here, since only their header tells their end."""
    position, binary_seen, count = 0, False, 0
    opening = _DELIMITER.search(content)
    if opening is None:
        raise DataError("this is not a universal file", file=path, expected="datasets between lines '-1'", found="no such line")
    position = opening.end()
    lines_before, counted_to = 0, 0
    while position < len(content):
        text, body = _line(content, position)
        if text.strip() in ("", "-1"):
            position = body
            continue
        if not binary_seen:
            lines_before, counted_to = lines_before + content.count(b"\n", counted_to, position), position
        place = f"dataset {count + 1}, byte {position}" if binary_seen else f"dataset {count + 1}, line {lines_before + 1}"
        match = _IDENTIFIER.fullmatch(text)
        if match is None:
            raise DataError(
                "a dataset does not start with its number", file=path, place=place, expected="a number such as 58", found=repr(text[:60])
            )
        count += 1
        dataset = _Dataset(
            number=int(match.group(1)),
            binary=bool(match.group(2)),
            identifier=match.group(3),
            start=body,
            place=place,
            line=None if binary_seen else lines_before + 1,
        )
        if dataset.number == 58 and dataset.binary:
            binary_seen = True
            function, position = _binary_function(dataset, content, path, len(functions) + 1)
            functions.append(function)
            yield dataset, position
            continue
        closing = _DELIMITER.search(content, body)
        if closing is None:
            notes.append(f"{place}: the closing line '-1' is missing")
        yield dataset, closing.start() if closing else len(content)
        position = closing.end() if closing else len(content)


def _line(content: bytes, position: int) -> tuple[str, int]:
    end = content.find(b"\n", position)
    end = len(content) if end < 0 else end
    return decode(content[position:end]).rstrip("\r"), end + 1


def _units(body: bytes, path: Path, place: str) -> UffUnits:
    lines = decode(body).splitlines()
    try:
        int(lines[0][:10])
        length, force = (float(word) for word in lines[1].upper().replace("D", "E").split()[:2])
        if not (1e-30 < length < 1e30 and 1e-30 < force < 1e30):
            raise ValueError("factors out of range")
    except (IndexError, ValueError) as error:
        found = " / ".join(line.strip() for line in lines[:2])[:120]
        raise DataError(
            "the units (dataset 164) cannot be read", file=path, place=place, expected="a code and four factors", found=found
        ) from error
    return UffUnits(description=lines[0][10:30].strip(), length=length, force=force)


def _header(content: bytes, start: int, count: int, path: Path, place: str) -> tuple[list[str], int]:
    lines, position = [], start
    for number in range(count):
        if position >= len(content):
            expected, found = f"{count} header lines", f"{number} lines"
            raise DataError("the header of a function is cut off", file=path, place=place, expected=expected, found=found)
        text, position = _line(content, position)
        lines.append(text)
    return lines, position


def _function(dataset: _Dataset, body: bytes, path: Path, record: int) -> UffFunction:
    place = f"record {record} ({dataset.place})"
    lines, start = _header(body, 0, _HEADER_LINES, path, place)
    form = data_form(lines[6], path, place)
    per_point = (2 if form.is_complex else 1) + (0 if form.even else 1)
    data = body[start:]
    tokens = data.split()
    if len(tokens) != form.count * per_point and not _NUMBER.sub(b"", data).strip():
        # In fixed columns, blanks between numbers and the letter of an exponent may be missing.
        tokens = [re.sub(rb"(?<=[\d.])([-+]\d{3})$", rb"E\1", token) for token in _NUMBER.findall(data)]
    if len(tokens) != form.count * per_point:
        if len(tokens) < form.count * per_point and unfinished(path.read_bytes()):
            expected = f"{form.count} points, {form.count * per_point} numbers, then a line '-1'"
            raise ends_early(path, place, expected, f"{len(tokens)} numbers")
        raise DataError(
            "the function does not contain the number of values that its header states",
            file=path,
            place=place,
            expected=f"{form.count} points, {form.count * per_point} numbers",
            found=f"{len(tokens)} numbers",
            hint="the file is damaged or truncated; export it again",
        )
    lines_of_points = None
    if dataset.line is not None:
        starts = np.cumsum([0, *(len(line.split()) for line in data.split(b"\n"))])
        lines_of_points = np.searchsorted(starts, per_point * np.arange(form.count), side="right") + dataset.line + _HEADER_LINES
    tokens = [token.replace(b"D", b"E").replace(b"d", b"e") for token in tokens]
    try:
        # NumPy gives every text the room of the longest one, so one long text could exhaust the memory.
        if max(map(len, tokens), default=0) > LONGEST_NUMBER:
            raise ValueError
        numbers = np.array(tokens, dtype=np.bytes_).astype(np.float64)
    except ValueError as error:
        bad = next(index for index, token in enumerate(tokens) if not _is_number(token))
        line = f", line {lines_of_points[bad // per_point]}" if lines_of_points is not None else ""
        found = repr(tokens[bad].decode("latin-1")[:30])
        raise DataError("a value is not a number", file=path, place=f"{place}{line}", expected="a number", found=found) from error
    values = numbers.reshape(form.count, per_point)
    return _build(form, lines, values, path=path, place=place, record=record, point_lines=lines_of_points)


def _is_number(token: bytes) -> bool:
    if len(token) > LONGEST_NUMBER:
        return False
    try:
        float(token)
    except ValueError:
        return False
    return True


def _binary_function(dataset: _Dataset, content: bytes, path: Path, record: int) -> tuple[UffFunction, int]:
    place = f"record {record} ({dataset.place})"
    words = dataset.identifier.split()
    try:
        order, floats, header_lines, stated = (int(word) for word in words[:4])
    except ValueError as error:
        expected = "byte order, float format, header lines, bytes"
        raise DataError(
            "the identifier of a binary function is wrong", file=path, place=place, expected=expected, found=dataset.identifier[:60]
        ) from error
    if order not in (1, 2) or floats != 2 or not _HEADER_LINES <= header_lines <= 100:
        expected = "byte order 1 or 2, float format 2 (IEEE), 11 header lines"
        found = f"{order}, {floats}, {header_lines}"
        raise DataError(
            "this form of binary function is not read", file=path, place=place, expected=expected, found=found, hint="export as ASCII"
        )
    lines, start = _header(content, dataset.start, header_lines, path, place)
    form = data_form(lines[6], path, place)
    width = 8 if form.double else 4
    value_bytes = width * (2 if form.is_complex else 1)
    # The format prescribes single precision for the abscissa; several programs write double.
    abscissa_widths = (0,) if form.even else ((8, 4) if form.double else (4,))
    sizes = {form.count * (value_bytes + extra): extra for extra in reversed(abscissa_widths)}
    notes: tuple[str, ...] = ()
    for size in (stated, *sizes):
        after = _closing(content, start + size)
        fitting = [needed for needed in sizes if needed <= size]
        if after is not None and fitting and start + max(fitting) <= len(content):
            needed = max(fitting)
            if size != stated:
                notes = (f"the byte count is {stated}, but there are {size} bytes of values; they were read",)
            elif needed != size:
                notes = (f"{size - needed} bytes after the last value were left out",)
            break
    else:
        raise DataError(
            "the function does not contain the number of values that its header states",
            file=path,
            place=place,
            expected=f"{form.count} points, {' or '.join(str(size) for size in sizes)} bytes, then a line '-1'",
            found=f"a byte count of {stated}, {len(content) - start} bytes to the end of the file",
            hint="the file is damaged or truncated; export it again, or as ASCII",
        )
    kinds = [("x", f"{'<' if order == 1 else '>'}f{sizes[needed]}")] if sizes[needed] else []
    kinds.append(("y", f"{'<' if order == 1 else '>'}f{width}", (2 if form.is_complex else 1,)))  # type: ignore[arg-type]
    raw = np.frombuffer(content, dtype=np.dtype(kinds), count=form.count, offset=start)
    columns = ([raw["x"][:, None]] if sizes[needed] else []) + [raw["y"]]
    numbers = np.concatenate([np.asarray(column, dtype=np.float64) for column in columns], axis=1)
    return _build(form, lines, numbers, path=path, place=place, record=record, notes=notes), after


def _closing(content: bytes, end: int) -> int | None:
    """Offset after the closing ``-1`` if only blanks precede it after `end`, or at the end of the file; else None."""
    if not 0 <= end <= len(content):
        return None
    match = re.compile(rb"[\s\0]{0,8}-1[ \t]*(?:\r?\n|\Z)").match(content, end)
    if match:
        return match.end()
    return len(content) if not content[end : end + 100].strip(b" \t\r\n\0\x1a") and len(content) - end < 100 else None


def _build(
    form: DataForm,
    lines: list[str],
    numbers: NDArray[np.float64],
    *,
    path: Path,
    place: str,
    record: int,
    point_lines: NDArray[np.int64] | None = None,
    notes: tuple[str, ...] = (),
) -> UffFunction:
    first = 0 if form.even else 1
    if form.is_complex:
        values: NDArray[Any] = np.empty(form.count, dtype=np.complex128)
        values.real, values.imag = numbers[:, first], numbers[:, first + 1]
    else:
        values = numbers[:, first].copy()
    if form.even:
        abscissa, note = even_axis(form.count, form.minimum, form.increment)
        notes = (*notes, note) if note else notes
    else:
        abscissa = numbers[:, 0].copy()
        steps = np.diff(abscissa)
        if steps.size and np.ptp(steps) > 1e-3 * abs(float(np.median(steps))):
            notes = (*notes, "uneven spacing, lines taken as given")
    abscissa_axis, numerator, denominator = (_axis(line, path, place) for line in lines[7:10])
    return UffFunction(
        record=record,
        id_lines=tuple(line.rstrip() for line in lines[:5]),
        **_identification(lines[5], path, place),
        abscissa=abscissa,
        values=values,
        abscissa_axis=abscissa_axis,
        numerator=numerator,
        denominator=denominator,
        notes=notes,
        point_lines=point_lines,
    )


def _identification(line: str, path: Path, place: str) -> dict[str, Any]:
    """Record 6: function type, response and reference (name, node, direction)."""
    cells = [line[a:b] for a, b in ((0, 5), (31, 41), (41, 51), (51, 55), (56, 66), (66, 76), (76, 80))]
    try:
        cells[5:] = [cell.strip() or "0" for cell in cells[5:]]
        numbers = [int(cells[i]) for i in (0, 2, 3, 5, 6)]
        names = [cells[1].strip(), cells[4].strip()]
    except ValueError:
        free = _free_identification(line.split())
        if free is None:
            expected = "function type, response name, node and direction, reference name, node and direction"
            raise DataError("record 6 of a function is wrong", file=path, place=place, expected=expected, found=repr(line[:90])) from None
        numbers, names = free
    if max(abs(numbers[2]), abs(numbers[4])) > 6:
        found = f"{numbers[2]} and {numbers[4]}"
        raise DataError("a direction in record 6 of a function is wrong", file=path, place=place, expected="-6 to 6", found=found)
    names = ["" if name.upper() == "NONE" else name for name in names]
    return {
        "function_type": numbers[0],
        "response_name": names[0],
        "response_node": numbers[1],
        "response_direction": numbers[2],
        "reference_name": names[1],
        "reference_node": numbers[3],
        "reference_direction": numbers[4],
    }


def _free_identification(words: list[str]) -> tuple[list[int], list[str]] | None:
    """Numbers and names of a record 6 that ignores the prescribed columns; names may contain blanks, the reference may be missing."""
    rest = words[4:]

    def is_point(at: int) -> bool:
        node, direction = rest[at : at + 2]
        sign_less = direction.removeprefix("-")
        return node.isdecimal() and len(node) <= _DIGITS and sign_less.isdecimal() and len(sign_less) == 1

    if len(rest) < 2 or not words[0].isdecimal() or not all(_is_whole(word) for word in words[:4]):
        return None
    # The first word is a name if it can be one; four numbers are two points without names.
    nameless = len(rest) == 4 and is_point(0) and is_point(2)
    for at in (0,) if nameless else (*range(1, len(rest) - 1), 0):
        if not is_point(at):
            continue
        if at + 2 == len(rest):
            return [int(words[0]), int(rest[at]), int(rest[at + 1]), 0, 0], [" ".join(rest[:at]), ""]
        if at + 4 <= len(rest) and is_point(len(rest) - 2):
            numbers = [int(word) for word in (words[0], *rest[at : at + 2], *rest[-2:])]
            return numbers, [" ".join(rest[:at]), " ".join(rest[at + 2 : -2])]
    return None


def _is_whole(word: str) -> bool:
    return word.removeprefix("-").isdecimal() and len(word) <= _DIGITS


def _axis(line: str, path: Path, place: str) -> UffAxis:
    """Read one of records 8 to 10; a blank line stands for zeros."""
    if not line.strip():
        return UffAxis(kind=0, length=0, force=0, label="", unit="")
    try:
        kind, length, force = (int(line[a:b]) for a, b in ((0, 10), (10, 15), (15, 20)))
        texts = [line[26:46], line[47:67]]
    except ValueError:
        match = re.match(r"\s*(-?\d{1,9})(?!\d)(?:\s+(-?\d{1,9})\s+(-?\d{1,9})(?!\d)(?:\s+(-?\d+))?)?\s*(.*)", line)
        if match is None:
            raise DataError(
                "an axis of a function is wrong", file=path, place=place, expected="a data type", found=repr(line[:70])
            ) from None
        kind, length, force = int(match.group(1)), int(match.group(2) or 0), int(match.group(3) or 0)
        texts = [*re.split(r"\s{2,}", match.group(5).strip()), "", ""][:2]
    label, unit = ("" if text.strip().upper() == "NONE" else text.strip() for text in texts)
    return UffAxis(kind=kind, length=length, force=force, label=label, unit=unit)
