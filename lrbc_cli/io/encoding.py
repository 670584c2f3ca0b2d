"""Decodes text files of unknown encoding, and folds letters (case, accents) so that names can be compared."""

from __future__ import annotations

import codecs
import unicodedata
from pathlib import Path

from lrbc_cli.errors import DataError


def decode(content: bytes) -> str:
    """Bytes as text: UTF-8 (with or without byte-order mark), UTF-16 with mark, else Windows-1252, which instruments write."""
    for mark, encoding in ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16")):
        if content.startswith(mark):
            return content.decode(encoding, "replace")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def unfinished(content: bytes) -> bool:
    """Whether the last line of a text has no line end: the file was truncated, or written by hand."""
    # In UTF-16 the line end is followed by a zero byte.
    return bool(content) and not content.rstrip(b"\0").endswith((b"\n", b"\r"))


def read_lines(path: Path) -> list[str]:
    """Lines of a text file without line ends.

    Raises
    ------
    DataError
        If the file is binary.
    """
    text = decode(path.read_bytes())
    if "\0" in text:
        raise DataError("this is not a text file", file=path, expected="text", found="binary data")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def fold(text: str) -> str:
    """Text in lower case without accents, one character for each; letters of other scripts that only look alike are kept."""
    letters = unicodedata.normalize("NFC", text)
    return "".join(unicodedata.normalize("NFD", letter)[0].lower() if len(letter.lower()) == 1 else letter for letter in letters)
