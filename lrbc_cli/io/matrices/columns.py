"""Parses columns of numbers in large text files in one call, and checks the number of words of every line."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.errors import DataError
from lrbc_cli.io.common import ends_early

#: Bytes checked at a time: the masks for it take a few times as much memory.
_CHUNK = 2**24

#: An exponent of three digits, before which Fortran omits the letter.
_LONG_EXPONENT = re.compile(rb"(?<=[\d.])([-+]\d{3})(?= )")

#: Replaces what NumPy does not read: exponents with D, commas, semicolons, tabs.
_PLAIN = bytes.maketrans(b"Dd,;\t", b"EE   ")


def read_columns(body: bytes, width: int, path: Path, first_line: int, expected: str) -> Floats:
    """Read lines with `width` numbers each, separated by blanks, commas, semicolons or tabs.

    Parameters
    ----------
    body
        The lines; blank ones are skipped.
    width
        Numbers in each line.
    first_line
        Number of the first line of ``body`` in the file.
    expected
        Content of a line in words, for messages.

    Returns
    -------
    (m, width) float array

    Raises
    ------
    DataError
        For the first line with anything else.
    """
    plain = body.translate(_PLAIN).strip()
    numbers = parsed(plain)
    if numbers is None or numbers.size % width or not words_a_line(plain, width):
        raise _bad_line(body, width, path, first_line, expected)
    return numbers.reshape(-1, width)


def read_fixed(text: bytes, width: int) -> Floats | None:
    """Numbers in cells of `width` characters, with or without blanks between them; None if there is other text."""
    cells = np.frombuffer(text, dtype=np.uint8).reshape(-1, width)
    spaced = np.full((cells.shape[0], width + 1), ord(" "), dtype=np.uint8)
    spaced[:, :width] = cells
    plain = spaced.tobytes().translate(_PLAIN)
    numbers = parsed(plain)
    return parsed(_LONG_EXPONENT.sub(rb"E\1", plain)) if numbers is None else numbers


def parsed(text: bytes) -> Floats | None:
    """Numbers separated by blanks; None if there is other text."""
    # NumPy reads blanks alone as -1.
    if not text or text.isspace():
        return np.zeros(0)
    with warnings.catch_warnings():
        # Newer versions of NumPy raise an error, older ones only warn.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def words_a_line(body: bytes, width: int) -> bool:
    """Whether every line that is not blank has `width` words; otherwise numbers would be assigned to wrong entries."""
    begin = 0
    while begin < len(body):
        end = body.find(b"\n", begin + _CHUNK) + 1 or len(body)
        chunk = np.frombuffer(body, dtype=np.uint8, count=end - begin, offset=begin)
        blank = chunk <= ord(" ")
        words = ~blank
        words[1:] &= blank[:-1]
        lines = np.concatenate([[0], np.flatnonzero(chunk == ord("\n")) + 1])
        count = np.add.reduceat(words, lines[lines < chunk.size], dtype=np.int64)
        if np.any((count != 0) & (count != width)):
            return False
        begin = end
    return True


def is_number(word: bytes) -> bool:
    """Whether NumPy reads a word as a number."""
    try:
        float(word)
    except ValueError:
        return False
    return b"_" not in word


def _bad_line(body: bytes, width: int, path: Path, first_line: int, expected: str) -> DataError:
    lines = re.split(b"\r?\n", body.rstrip())
    for number, line in enumerate(lines, start=first_line):
        words = line.translate(_PLAIN).split()
        if words and (len(words) != width or not all(map(is_number, words))):
            if number == first_line + len(lines) - 1 > first_line and len(words) <= width and all(map(is_number, words[:-1])):
                return ends_early(path, f"line {number}", expected, repr(line[:60].decode("latin-1")))
            return DataError(
                "an entry cannot be read",
                file=path,
                place=f"line {number}",
                expected=expected,
                found=repr(line[:60].decode("latin-1")),
                hint="the file is truncated or of another layout; export it again",
            )
    return DataError("the numbers cannot be read", file=path, expected=expected, found="other text")
