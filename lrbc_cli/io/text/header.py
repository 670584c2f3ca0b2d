"""Interprets headings of columns: name, part of a complex number and unit, in the words and layouts of common analysers."""

from __future__ import annotations

import csv
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from lrbc_cli.io.encoding import fold
from lrbc_cli.io.units import decibel, numerator_quantity, parse_unit, response_quantity

#: Words for the part of a complex number, in lower case without accents: English, German, French, Italian, Spanish.
WORDS = {
    word: part
    for part, words in {
        "real": "real, re, real part, realteil, reel, reelle, partie reelle, parte reale, parte real",
        "imag": "imag, im, imaginary, imaginary part, imaginarteil, imaginaerteil, imaginar, imaginaer, imaginaire, partie imaginaire, "
        "parte immaginaria, parte imaginaria",
        "magnitude": "magnitude, mag, amplitude, amp, abs, betrag, modul, module, modulus, modulo, gain, level, pegel, niveau",
        "db": "db, magnitude_db, mag_db",
        "phase": "phase, ph, phi, arg, phasenwinkel, phase angle, fase, winkel, angle, angolo, angulo",
        "phase-deg": "phase_deg",
        "phase-rad": "phase_rad",
        "coherence": "coherence, coh, koharenz, kohaerenz, coherenz, coerenza, coherencia",
    }.items()
    for word in words.split(", ")
}
_LONGEST_FIRST = sorted(WORDS, key=len, reverse=True)
_FREQUENCY = re.compile(r"(freq|frequency|frequenz|frequence|frequenza|frecuencia|f|hz|omega|w)([\s_].*|\W.*)?", re.IGNORECASE)
_INDEX = {"index", "nr", "no", "#", "n", "line", "linie", "zeile", "ligne", "point", "punkt", "number", "nummer", "bin", "i"}
#: Units of an angle or a frequency that may follow a heading without brackets.
_PLAIN = {"hz", "khz", "rad/s", "db", "deg", "degree", "degrees", "degre", "degres", "grad", "°", "rad"}
_ANGLE = re.compile(r"(.+)_(deg|rad)", re.IGNORECASE)
#: Keys above a table that state the unit of its values, reduced to letters.
_UNIT_KEYS = {
    *("amplitudeunit", "unit", "units", "yaxisunit", "yunit", "yunits", "unity", "ordinateunit"),
    *("einheit", "yeinheit", "einheity", "yachseneinheit", "einheityachse", "einheitordinate", "amplitudeneinheit"),
    *("unite", "uniteordonnee", "unitey", "uniteamplitude"),
}
#: Those of these keys that may refer to something else.
_VAGUE_KEYS = {"unit", "units", "einheit", "unite"}
#: Keys that state the unit of the frequencies.
_AXIS_KEYS = {"xaxisunit", "xunit", "xunits", "unitx", "abscissaunit", "xeinheit", "einheitx", "xachseneinheit", "einheitabszisse"}
_KEY = re.compile(r"[\s\"#%]*([^:=;\t]{2,40}?)\"?\s*[:=;\t]+\s*\"?([^;\t]*?)[\"\s;]*")
#: Most characters of a heading or a line with a key that are interpreted; a longer heading is a name.
_LONGEST = 300
#: Lines above the numbers that may belong to a heading.
_ROWS = 5


@dataclass(frozen=True, kw_only=True)
class Heading:
    """Heading of one column: its text without unit, split into name and part of an FRF (None if not stated), and its unit."""

    text: str = ""
    name: str = ""
    part: str | None = None
    unit: str = ""

    @property
    def is_frequency(self) -> bool:
        """Whether the column holds frequencies by its name."""
        return self.part is None and _FREQUENCY.fullmatch(fold(self.text)) is not None

    @property
    def is_time(self) -> bool:
        """Whether the column holds times by its name."""
        return (
            self.part is None
            and re.fullmatch(r"(time|zeit|temps|tempo|tiempo|t)(_(s|ms|sec))?", fold(self.text)) is not None
            and self.unit in ("", "s", "ms", "sec")
        )

    @property
    def is_index(self) -> bool:
        """Whether the column counts the lines by its name."""
        return self.part is None and fold(self.text).rstrip(".") in _INDEX


def read_headings(lines: Sequence[str], delimiter: str, width: int) -> tuple[Heading, ...]:
    """Headings of the columns from the lines right above the numbers, with names, parts and units in one row or in several."""
    rows = _rows(lines, delimiter, width)
    units = [""] * width
    if len(rows) > 1 and _is_unit_row(rows[0]):
        units = [_bare(cell) for cell in rows.pop(0)]
    if not rows:
        return (Heading(),) * width
    found = [heading(cell) for cell in rows.pop(0)]
    if rows and not any(units) and _is_unit_row(rows[0]):
        units = [_bare(cell) for cell in rows.pop(0)]
    if rows:
        found = _with_titles(found, rows[0])
    return tuple(replace(one, unit=one.unit or unit) for one, unit in zip(found, units, strict=True))


def stated_unit(lines: Sequence[str]) -> str:
    """Unit of an FRF from a line above the table (``AmplitudeUnit: (m/s²)/N``), even if not understood; empty if not stated."""
    stated = [(key, value) for key, value in _stated(lines) if key in _UNIT_KEYS]
    known = [value for _, value in stated if decibel(value) is not None or _is_response(value)]
    return next(iter(known or [value for key, value in stated if key not in _VAGUE_KEYS]), "")


def stated_axis_unit(lines: Sequence[str]) -> str:
    """Unit of the frequencies from a line above the table (``X-Axis unit: kHz``); empty if not stated."""
    return next((value for key, value in _stated(lines) if key in _AXIS_KEYS), "")


def _stated(lines: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the keys above a table, reduced to letters, with their values."""
    for line in lines:
        match = _KEY.fullmatch(line) if len(line) <= _LONGEST else None
        if match is not None and (value := match.group(2).strip()):
            yield "".join(filter(str.isalpha, fold(match.group(1)))), value


def heading(cell: str) -> Heading:
    """Split ``Re(mic01) [Pa/N]``, ``mic01_real``, ``Realteil mic01 / (Pa/N)`` and the like into name, part and unit."""
    if len(cell) > _LONGEST:
        return Heading(text=cell, name=cell)
    text, unit = split_unit(cell)
    part = WORDS.get(fold(unit).rstrip("."))
    if part not in (None, "db"):
        return Heading(text=text, name=text, part=part)
    name, part = _split_part(text)
    if part is None and (end := _ANGLE.fullmatch(f"{text}_{unit}" if unit else text)):
        # Only the unit says that these are phases: acc1_deg, acc1 [rad].
        return Heading(text=text, name=end.group(1), part="phase", unit=end.group(2))
    kind, _, angle = (part or "").partition("-")
    return Heading(text=text, name=name, part=kind or None, unit=unit or angle)


def split_unit(cell: str) -> tuple[str, str]:
    """Split ``mic01 [Pa/N]``, ``mic01 ((m/s²)/N)`` or ``mic01 / Pa/N`` into name and unit."""
    at = _opening(cell)
    if at > 0:
        name, inside = cell[:at].rstrip(" /,"), cell[at + 1 : -1].strip()
        known = decibel(inside) is not None or (parse_unit(inside) is not None and not inside.isdigit()) or fold(inside) in _PLAIN
        if name and inside and (cell[-1] == "]" or known):
            return name, inside
    for index, letter in enumerate(cell):
        if letter not in " /,([;":
            continue
        name, rest = cell[:index].rstrip(" /,"), cell[index:].strip(" /,;")
        if name.endswith(" in"):
            name = name[:-3].rstrip()
        if name and (fold(rest) in _PLAIN or ("/" in rest and _is_response(rest)) or (len(rest) > 2 and decibel(rest) is not None)):
            return name, rest
    return cell, ""


def _opening(cell: str) -> int:
    """Index of the opening bracket of the pair that ends a text; -1 if there is none."""
    depth = 0
    for index in range(len(cell) - 1, -1, -1):
        depth += (cell[index] in ")]") - (cell[index] in "([")
        if depth == 0:
            return index if index < len(cell) - 1 else -1
    return -1


def _bare(cell: str) -> str:
    """Unit without the brackets around it."""
    text = cell.strip()
    return text[1:-1].strip() if len(text) > 1 and _opening(text) == 0 else text


def _is_response(label: str) -> bool:
    unit = parse_unit(label)
    return unit is not None and (response_quantity(unit) is not None or numerator_quantity(unit) is not None)


def _split_part(text: str) -> tuple[str, str | None]:
    """Name and part of a heading without unit; a word for a part at the end takes precedence over one at the start."""
    folded = fold(text)
    if len(folded) != len(text):
        text = unicodedata.normalize("NFC", text)
    if folded in WORDS:
        return "", WORDS[folded]
    if folded.startswith("|") and folded.endswith("|") and len(folded) > 2:
        return text[1:-1].strip(), "magnitude"
    at = _opening(folded)
    if at > 0:
        outside, inside = folded[:at].rstrip(" ."), folded[at + 1 : -1].strip()
        if outside in WORDS:
            return text[at + 1 : -1].strip(), WORDS[outside]
        if inside in WORDS:
            return text[:at].rstrip(" _.:,-"), WORDS[inside]
    # Without a regular expression, which would take quadratic time on long runs of separators.
    whole = folded.removesuffix(".")
    for word in _LONGEST_FIRST:
        if whole.endswith(word) and len(whole) > len(word) and _separates(whole[-len(word) - 1]):
            return text[: len(whole) - len(word)].rstrip(" \t_.:,/-"), WORDS[word]
    for word in _LONGEST_FIRST:
        rest = folded[len(word) :]
        if folded.startswith(word) and rest.strip(" _.:,-") and _separates(rest[0]):
            return text[len(word) :].strip(" \t_.:,/-"), WORDS[word]
    return text, None


def _separates(letter: str) -> bool:
    return letter in "_.:,/-" or letter.isspace()


def _rows(lines: Sequence[str], delimiter: str, width: int) -> list[list[str]]:
    """Cells of the lines that may belong to the heading, the lowest line first."""
    found: list[list[str]] = []
    for line in reversed(lines[-_ROWS:]):
        text = line.strip(" \r#%") if delimiter == "\t" else line.strip().lstrip("#%").strip()
        if not text:
            continue
        cells = _cells(text, delimiter)
        while len(cells) > width and not cells[-1]:
            cells.pop()
        # A row of titles may be shorter than the table if its first cell is empty or names the frequency.
        if found and 1 < len(cells) < width and (not cells[0] or heading(cells[0]).is_frequency):
            cells += [""] * (width - len(cells))
        if len(cells) != width:
            break
        found.append(cells)
    return found


def _cells(text: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return text.split()
    try:
        return [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter), [])]
    except csv.Error:
        return text.split(delimiter)


def _is_unit_row(cells: Sequence[str]) -> bool:
    def is_unit(cell: str) -> bool:
        label = _bare(cell)
        return decibel(label) is not None or fold(label) in _PLAIN or parse_unit(label) is not None

    return any(cells) and all(not cell or is_unit(cell) for cell in cells)


def _with_titles(found: list[Heading], cells: Sequence[str]) -> list[Heading]:
    """Headings completed by names or parts from the row above; a name also applies to the empty cells after it."""
    titles = [heading(cell) for cell in cells]
    if sum(title.part is not None for title in titles) > 1 and not any(one.part for one in found):
        return [replace(one, part=title.part, unit=one.unit or title.unit) for one, title in zip(found, titles, strict=True)]
    named, last = [], ""
    for one, title in zip(found, titles, strict=True):
        last = title.name if title.name and not title.is_frequency else last
        named.append(replace(one, name=last, unit=one.unit or title.unit) if one.part is not None and not one.name else one)
    return named
