"""Parses record 7 of a function in a universal file: number of points, precision and abscissa of its data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lrbc_cli.errors import DataError

_COLUMNS = ((0, 10), (10, 20), (20, 30), (30, 43), (43, 56))


@dataclass(frozen=True, kw_only=True)
class DataForm:
    """Form of the data of a function.

    Attributes
    ----------
    count : int
        Number of points.
    even : bool
        Whether the abscissa is given by minimum and increment.
    is_complex, double : bool
    minimum, increment : str
        As printed, with E as the letter of the exponent.
    """

    count: int
    even: bool
    is_complex: bool
    double: bool
    minimum: str
    increment: str


def data_form(line: str, path: Path, place: str) -> DataForm:
    """Read record 7, by words or else by columns.

    Raises
    ------
    DataError
        If a field is impossible; it is named.
    """
    for words in (line.split(), _by_column(line)):
        try:
            kind, count, spacing = (int(word) for word in words[:3])
            minimum, increment = (word.strip().upper().replace("D", "E") for word in words[3:5])
            even = np.isfinite(float(minimum)) and 0 < float(increment) < np.inf
        except ValueError:
            continue
        if kind in (2, 4, 5, 6) and count > 0 and (spacing == 0 or (spacing == 1 and even)):
            return DataForm(
                count=count, even=spacing == 1, is_complex=kind in (5, 6), double=kind in (4, 6), minimum=minimum, increment=increment
            )
    field, expected, found = _wrong_field(line)
    raise DataError(
        f"record 7 of a function is wrong: {field}", file=path, place=place, expected=expected, found=f"{found!r} in {line[:80]!r}"
    )


def _by_column(line: str) -> list[str]:
    return [line[start:stop].strip() for start, stop in _COLUMNS]


def _wrong_field(line: str) -> tuple[str, str, str]:
    """Name, allowed values and found value of the first impossible field."""
    words = line.split() if len(line.split()) >= len(_COLUMNS) else _by_column(line)
    kind, count, spacing = (_number(word, int) for word in words[:3])
    minimum, increment = (_number(word.upper().replace("D", "E"), float) for word in words[3:5])
    even = spacing == 1
    checks = (
        ("ordinate data type", "2, 4, 5 or 6", kind in (2, 4, 5, 6)),
        ("number of points", "a whole number above 0", count is not None and count > 0),
        ("abscissa spacing", "0 (uneven) or 1 (even)", spacing in (0, 1)),
        ("abscissa minimum", "a number", minimum is not None and (not even or np.isfinite(minimum))),
        ("abscissa increment", "a number above 0", increment is not None and (not even or 0 < increment < np.inf)),
    )
    for word, (name, expected, right) in zip(words, checks, strict=False):
        if not right:
            return name, expected, word
    return "its columns", "fields of 10, 10, 10, 13 and 13 characters", line.strip()[:60]


def _number(word: str, kind: type[int] | type[float]) -> float | None:
    try:
        return kind(word)
    except ValueError:
        return None
