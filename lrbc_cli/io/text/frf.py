"""FRFs in CSV and other text, of this package and of others."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.atomic import atomic_write
from lrbc_cli.io.common import listing
from lrbc_cli.io.encoding import unfinished
from lrbc_cli.io.frf_common import check_frequencies, clean_coherence, not_finite, scaled
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.text.sniff import TextTable, read_table
from lrbc_cli.io.units import Unit, numerator_quantity, parse_unit, response_quantity
from lrbc_cli.model.frf import FrfRecord, FrfSet

# Words at the end (mic_real), at the start (Re mic) or around a name (Re(mic)) that tell what a column holds.
_WORDS = {
    "real": "real",
    "re": "real",
    "imag": "imag",
    "im": "imag",
    "imaginary": "imag",
    "magnitude": "magnitude",
    "mag": "magnitude",
    "amplitude": "magnitude",
    "amp": "magnitude",
    "abs": "magnitude",
    "db": "db",
    "magnitude_db": "db",
    "mag_db": "db",
    "phase": "phase",
    "phase_deg": "phase-deg",
    "phase_rad": "phase-rad",
    "ph": "phase",
    "arg": "phase",
    "coherence": "coherence",
    "coh": "coherence",
}
_LONGEST_FIRST = sorted(_WORDS, key=len, reverse=True)
_PATTERN = "|".join(_LONGEST_FIRST)
_PREFIX = re.compile(rf"({_PATTERN})\.?[\s_:-]+(.*)", re.IGNORECASE)
_AROUND = re.compile(rf"({_PATTERN})\.?\s*[(\[](.*)[)\]]", re.IGNORECASE)
_FREQUENCY = re.compile(r"(freq|frequency|frequenz|f|hz|omega|w)([\s_].*|\W.*)?", re.IGNORECASE)
_PAIRS = {"real-imag": ("real", "imag"), "magnitude-phase": ("magnitude", "phase"), "db-phase": ("db", "phase")}


@dataclass(frozen=True)
class _Column:
    at: int
    name: str
    part: str | None
    unit: str


def read_frf_text(path: Path, layout: TextLayout | None = None) -> FrfSet:
    """Read FRFs from columns of text.

    What the layout does not say is found out: separator, decimal sign, header, columns (``NAME_real``, ``Re(NAME)``,
    ``NAME_mag``, ``NAME_phase``, ``NAME_coherence`` and the like), degrees or radians. Without a header, columns after
    the frequency are taken as pairs of real and imaginary part. All of it stands in the notes.

    Raises
    ------
    DataError
        If there is no such table, columns do not pair up, or a value is not finite.
    """
    layout = layout or TextLayout()
    table = read_table(path, layout)
    notes = list(table.notes)
    at = _frequency_column(table, layout, path)
    frequency = _frequencies(table, at, layout, path, notes)
    columns = [_classify(table, index) for index in range(len(table.names)) if index != at]
    pairs, representation = _chosen_pairs(table, layout, path), layout.representation or "real-imag"
    coherences: dict[str, _Column] = {}
    if not pairs:
        pairs, representation = _pairs(columns, layout, path, notes)
        coherences = {column.name: column for column in columns if column.part == "coherence"}
    records = []
    for name, first, second in pairs:
        parts = []
        for index in (first, second):
            bad = np.flatnonzero(~np.isfinite(table.values[:, index]))
            if bad.size:
                row = int(bad[0])
                raise not_finite(path, f"line {table.lines[row]}, column {table.names[index] or index + 1}", table.values[row, index])
            parts.append(table.values[:, index])
        if representation == "magnitude-phase" and (negative := np.flatnonzero(parts[0] < 0)).size:
            raise DataError(
                "a magnitude is negative",
                file=path,
                place=f"line {table.lines[negative[0]]}, column {table.names[first] or first + 1}",
                expected="magnitudes from 0 on",
                found=f"{parts[0][negative[0]]:g} ({negative.size} such lines)",
                hint="are these dB (representation: db-phase), or real and imaginary parts (real-imag)?",
            )
        values = _combine(parts[0], parts[1], representation, _phase_unit(table, second, representation, layout, notes))
        scale, quantity = _unit(table.units[first], layout, representation, notes, name, path)
        coherence = None
        if name in coherences:
            coherence, undefined = clean_coherence(table.values[:, coherences[name].at], path, f"column {table.names[coherences[name].at]}")
            if undefined:
                notes.append(f"coherence of {name} undefined at some lines; 0 taken there")
        place = f"column {table.names[first] or first + 1}"
        records.append(FrfRecord(name, frequency, scaled(values, scale, path, place), quantity, coherence=coherence, place=place))
    cut = ("the last line has no end; if the file was cut there, its last number is wrong",) if unfinished(path.read_bytes()) else ()
    return FrfSet(str(path), tuple(records), tuple(dict.fromkeys(notes)), cut)


def read_text_coherence(path: Path, layout: TextLayout | None = None) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Read coherences from columns ``NAME_coherence``, or from all columns after the frequency where none is called so.

    Returns
    -------
    dict
        Name to frequencies in Hz and coherences, both (F,).

    Raises
    ------
    DataError
        If there is no such table or a value is no coherence.
    """
    layout = layout or TextLayout()
    table = read_table(path, layout)
    at = _frequency_column(table, layout, path)
    frequency = _frequencies(table, at, layout, path, [])
    columns = [_classify(table, index) for index in range(len(table.names)) if index != at]
    chosen = [column for column in columns if column.part == "coherence"] or [column for column in columns if column.part is None]
    if not chosen:
        found = listing([name for name in table.names if name])
        raise DataError("the file holds no coherence", file=path, expected="columns NAME_coherence", found=found)
    return {c.name: (frequency, clean_coherence(table.values[:, c.at], path, f"column {table.names[c.at] or c.at + 1}")[0]) for c in chosen}


def write_frf_csv(path: Path, frf: FrfSet) -> None:
    """Write FRFs in SI: ``frequency_hz``, then ``NAME_real``, ``NAME_imag`` (and ``NAME_coherence``) a response.

    Raises
    ------
    DataError
        If the records have different lines, or names that are double or empty.
    """
    names = [record.name for record in frf.records]
    if not names or not all(name and name.isprintable() for name in names) or len(set(names)) != len(names):
        raise DataError("a CSV file needs a different name for every FRF", file=path, expected="names that differ", found=listing(names))
    frequency = frf.records[0].frequency_hz
    header, columns = ["frequency_hz"], [frequency]
    for record in frf.records:
        if not np.array_equal(record.frequency_hz, frequency):
            found = f"{record.frequency_hz.size} lines in {record.name}, {frequency.size} in {names[0]}"
            raise DataError("a CSV file needs the same lines for every FRF", file=path, expected="one axis", found=found, hint="write .uff")
        header += [f"{record.name}_real", f"{record.name}_imag"]
        columns += [record.values.real, record.values.imag]
        if record.coherence is not None:
            header.append(f"{record.name}_coherence")
            columns.append(record.coherence)
    with atomic_write(path) as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([repr(float(value)) for value in row] for row in np.stack(columns, axis=1))


def _frequency_column(table: TextTable, layout: TextLayout, path: Path) -> int:
    if layout.frequency is not None:
        return _find(table, layout.frequency, path, "format.frequency")
    named = [index for index, name in enumerate(table.names) if name and _FREQUENCY.fullmatch(name)]
    return named[0] if named else 0


def _frequencies(table: TextTable, at: int, layout: TextLayout, path: Path, notes: list[str]) -> NDArray[np.float64]:
    unit = layout.frequency_unit or table.units[at]
    text = f"{table.names[at]} {unit}".lower()
    scale = 1.0
    if "khz" in text:
        scale = 1e3
    elif "rad" in text:
        scale = 1.0 / (2.0 * np.pi)
    if scale != 1.0:
        notes.append(f"frequencies converted from {unit or table.names[at]} to Hz")
    frequency = np.array(table.values[:, at] * scale)
    check_frequencies(frequency, path, f"column {table.names[at] or at + 1}")
    return frequency


def _find(table: TextTable, column: str | int, path: Path, place: str) -> int:
    """Index of a column by its name or its number from 1."""
    if isinstance(column, int):
        if 1 <= column <= len(table.names):
            return column - 1
        found = f"{len(table.names)} columns"
    else:
        fitting = [index for index, name in enumerate(table.names) if name == column]
        if len(fitting) == 1:
            return fitting[0]
        found = listing([name for name in table.names if name]) if not fitting else f"{len(fitting)} columns of that name"
    raise DataError("there is no such column", file=path, place=place, expected=repr(column), found=found)


def _classify(table: TextTable, index: int) -> _Column:
    name, unit = table.names[index], table.units[index]
    base, part = name, None
    around, suffix, prefix = _AROUND.fullmatch(name), _suffix(name), _PREFIX.fullmatch(name)
    if name.lower() in _WORDS:
        base, part = "", _WORDS[name.lower()]
    # Case-insensitive patterns take letters of other alphabets for "i", "k" and "s" too.
    elif around and around.group(1).lower() in _WORDS:
        base, part = around.group(2), _WORDS[around.group(1).lower()]
    elif suffix:
        base, part = suffix
    elif prefix and prefix.group(1).lower() in _WORDS:
        base, part = prefix.group(2), _WORDS[prefix.group(1).lower()]
    part = part and part.split("-")[0]
    if unit.lower() == "db" and part in (None, "magnitude"):
        part, unit = "db", ""
    return _Column(index, base.strip(), part, unit)


def _suffix(name: str) -> tuple[str, str] | None:
    """Divide ``mic01_real`` into name and part; by hand, as a pattern takes quadratic time on long runs of separators."""
    text = name.removesuffix(".")
    for word in _LONGEST_FIRST:
        head, tail = text[: -len(word)], text[-len(word) :]
        if head and tail.lower() == word and (head[-1] in "_.:-" or head[-1].isspace()):
            end = len(head)
            while end and (head[end - 1] in "_.:-" or head[end - 1].isspace()):
                end -= 1
            return head[:end], _WORDS[word]
    return None


def _chosen_pairs(table: TextTable, layout: TextLayout, path: Path) -> list[tuple[str, int, int]]:
    return [
        (name, _find(table, first, path, f"format.columns.{name}"), _find(table, second, path, f"format.columns.{name}"))
        for name, (first, second) in layout.columns.items()
    ]


def _pairs(columns: list[_Column], layout: TextLayout, path: Path, notes: list[str]) -> tuple[list[tuple[str, int, int]], str]:
    """Pairs of columns and what they hold."""
    parts: dict[str, dict[str, int]] = {}
    for column in columns:
        if column.part is not None:
            group = parts.setdefault(column.name, {})
            if column.part in group:
                place = f"column {column.at + 1}"
                raise DataError(
                    "two columns hold the same part of one FRF", file=path, place=place, expected="names that differ", found=column.name
                )
            group[column.part] = column.at
    complete = {
        kind: [(name, group[first], group[second]) for name, group in parts.items() if first in group and second in group]
        for kind, (first, second) in _PAIRS.items()
    }
    wanted = [layout.representation] if layout.representation else list(_PAIRS)
    for kind in wanted:
        if complete[kind]:
            used = {name for name, _, _ in complete[kind]}
            left = [column for column in columns if column.name not in used or column.part is None]
            if left:
                notes.append(f"columns without a partner left out: {listing([column.name or str(column.at + 1) for column in left])}")
            notes.append(f"{len(complete[kind])} FRF{'s' if len(complete[kind]) > 1 else ''}, {kind}")
            return complete[kind], kind
    plain = [column for column in columns if column.part != "coherence"]
    if len(plain) % 2 or not plain or any(column.part for column in plain):
        raise DataError(
            "the columns do not pair up",
            file=path,
            expected="a frequency, then two columns an FRF (NAME_real and NAME_imag, or magnitude and phase)",
            found=listing([f"{column.name or column.at + 1}{f' ({column.part})' if column.part else ''}" for column in columns]),
            hint="name them under 'format: {columns: {NAME: [first, second]}}' of the job",
        )
    representation = layout.representation or "real-imag"
    notes.append(f"columns taken as pairs of {' and '.join(_PAIRS[representation])}")
    pairs = list(zip(plain[::2], plain[1::2], strict=True))
    return [(first.name or f"column {first.at + 1}", first.at, second.at) for first, second in pairs], representation


def _phase_unit(table: TextTable, at: int, representation: str, layout: TextLayout, notes: list[str]) -> str:
    if representation == "real-imag":
        return "rad"
    text = f"{table.names[at]} {table.units[at]}".lower()
    if layout.phase:
        return layout.phase
    if "deg" in text or "°" in text:
        return "deg"
    if re.search(r"(?<![a-z])rad", text):
        return "rad"
    found = "deg" if float(np.max(np.abs(table.values[:, at]))) > 2.0 * np.pi * 1.01 else "rad"
    notes.append(f"phase taken in {found}, by its range; say 'phase:' in the format if that is wrong")
    return found


def _combine(first: NDArray[np.float64], second: NDArray[np.float64], representation: str, phase: str) -> NDArray[np.complex128]:
    if representation == "real-imag":
        values = np.empty(first.size, dtype=np.complex128)
        values.real, values.imag = first, second
        return values
    magnitude = 10.0 ** (np.clip(first, -6000.0, 6000.0) / 20.0) if representation == "db-phase" else first
    return np.asarray(magnitude * np.exp(1j * (np.deg2rad(second) if phase == "deg" else second)), dtype=np.complex128)


def _unit(label: str, layout: TextLayout, representation: str, notes: list[str], name: str, path: Path) -> tuple[float, str | None]:
    """Factor to SI and quantity, from the layout or the column's own unit."""
    stated = layout.si_unit
    unit = stated or parse_unit(label)
    if stated is None and unit is not None and response_quantity(unit) is None:
        unit = unit / Unit(1.0, force=1) if numerator_quantity(unit) is not None else None
    if unit is None or response_quantity(unit) is None:
        if label:
            notes.append(f"unit {label!r} not understood; SI taken")
        return 1.0, layout.quantity
    quantity = layout.quantity or response_quantity(unit)
    if quantity != response_quantity(unit):
        expected = f"a unit of {quantity} over force"
        raise DataError("unit and quantity do not fit", file=path, place=f"column of {name}", expected=expected, found=label)
    if unit.factor != 1.0:
        notes.append(f"values in {layout.unit or label} multiplied by {unit.factor:.9g} to give SI")
    return unit.factor, quantity
