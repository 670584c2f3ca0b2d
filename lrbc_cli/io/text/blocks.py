"""Splits text files of B&K PULSE into functions, which follow each other under keys such as ``Data Type:`` and ``Title1:``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from lrbc_cli.errors import DataError
from lrbc_cli.io.encoding import fold
from lrbc_cli.io.text.header import Heading, heading
from lrbc_cli.io.units import numerator_quantity, parse_unit, response_quantity

_KEY = re.compile(r"\s*\"?([A-Za-z][^:\t]{1,39}?)\s*:\s*(.*?)[\"\s]*")
_NUMBERS = re.compile(r"\s*[-+]?[\d.,]+(?:[eE][-+]?\d+)?\t.*")
#: Title of a function: its kind, then its response and reference in parentheses.
_TITLE = re.compile(r"(.*?)\(([^(),]+),([^(),]+)\).*")
#: Lines at the start of a file that must contain its first key.
_FIRST_LINES = 5


@dataclass(frozen=True)
class Block:
    """One function: its lines, the number of lines before them in the file, and its keys in lower case."""

    lines: tuple[str, ...]
    before: int
    keys: dict[str, str]

    @property
    def title(self) -> str:
        """Title of the function."""
        return self.keys.get("title1", "")

    @property
    def signals(self) -> tuple[str, str]:
        """Response and reference from a title such as ``Frequency Response H1(acc1,hammer)``; empty if not stated."""
        match = _TITLE.fullmatch(self.title)
        return (match[2].strip(), match[3].strip()) if match else ("", "")

    @property
    def is_frf(self) -> bool:
        """Whether it may be an FRF: it has two parts and is not called a spectrum or correlation (a cross spectrum is complex too)."""
        return len(self.parts) != 1 and not re.search("spe[ck]tr|[ck]orrelation|^fft", fold(self.title))

    @property
    def parts(self) -> tuple[Heading, ...]:
        """Parts in its columns by its data type (``Magnitude/Phase``, ``Real``); empty for ``Complex``."""
        said = [heading(word) for word in re.split(r"\s*[-/,;&+]\s*|\s+and\s+", self.keys.get("data type", "").strip())]
        known = all(one.part is not None and not one.name for one in said)
        return tuple(Heading(part=one.part, unit=one.unit) for one in said) if known else ()

    def stated(self, headings: tuple[Heading, ...]) -> tuple[Heading, ...]:
        """Headings of its columns (index and frequency first), completed by the parts that they do not state themselves."""
        axes = len(headings) - 2
        if len(self.parts) != 2 or axes not in (1, 2) or any(one.part for one in headings):
            return headings
        return (*headings[:axes], *self.parts)

    @property
    def alone(self) -> str:
        """Title and part, for a function with only one part."""
        part = next((one.part for one in self.parts), None)
        if part in (None, "real"):
            return self.title or "real values"
        return f"{self.title or 'a function'}, {part} only"

    @property
    def unit(self) -> str:
        """Unit of its values as written."""
        return self.keys.get("amplitudeunit", "")

    @property
    def is_spectrum(self) -> bool:
        """Whether its unit is that of a response or a force alone."""
        unit = parse_unit(self.unit)
        if unit is None or response_quantity(unit) is not None:
            return False
        return numerator_quantity(unit) is not None or unit.dimension == (0, 1, 0)

    @property
    def is_coherence(self) -> bool:
        """Whether it is a coherence by its title."""
        return not self.is_frf and fold(self.title).startswith(("coherence", "koharenz", "kohaerenz"))

    @property
    def place(self) -> str:
        """Place in the file, for messages."""
        return f"lines {self.before + 1} to {self.before + len(self.lines)}"


def blocks(lines: list[str], path: Path) -> list[Block]:
    """Functions of a PULSE file; empty for any other file.

    Raises
    ------
    DataError
        If the number of lines of a function differs from its ``X-Axis size``.
    """
    if not any(fold(line).lstrip('"\ufeff ').startswith("header size:") for line in lines[:_FIRST_LINES]):
        return []
    starts = [0]
    numbers = 0
    found: list[Block] = []
    sizes: list[int] = []
    for index, line in enumerate(lines):
        if _NUMBERS.fullmatch(line):
            numbers += 1
        elif numbers and _KEY.fullmatch(line):
            starts.append(index)
            sizes.append(numbers)
            numbers = 0
    sizes.append(numbers)
    for start, end, size in zip(starts, [*starts[1:], len(lines)], sizes, strict=True):
        part = tuple(lines[start:end])
        keys = {fold(match[1]): match[2] for line in part if (match := _KEY.fullmatch(line))}
        block = Block(part, start, keys)
        stated = keys.get("x-axis size", "")
        if size and stated.isdecimal() and int(stated) != size:
            raise DataError(
                "a function is not complete", file=path, place=block.place, expected=f"{stated} lines, as its X-Axis size says", found=size
            )
        found.append(block)
    return found
