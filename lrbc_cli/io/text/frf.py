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
from lrbc_cli.io.frf_common import check_frequencies, clean_coherence, conversion, not_finite, scaled
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.text.header import fold
from lrbc_cli.io.text.sniff import TextTable, read_table
from lrbc_cli.io.units import decibel
from lrbc_cli.model.frf import FrfRecord, FrfSet

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
    columns = [_classify(table, index, layout) for index in _data_columns(table, at, path)]
    units = {column.at: column.unit for column in columns}
    pairs, representation = _chosen_pairs(table, layout, path), layout.representation or "real-imag"
    coherences: dict[str, _Column] = {}
    if not pairs:
        pairs, representation = _pairs(columns, layout, path, notes)
        coherences = {column.name: column for column in columns if column.part == "coherence"}
    records = []
    warnings: list[str] = []
    for name, first, second in pairs:
        about = f"column {table.called(first)}"
        parts = _parts(table, first, second, representation, path)
        values = _combine(*parts, representation, _phase(table, second, representation, layout, notes))
        scale, quantity = conversion(units.get(first, ""), layout, path, about, notes, warnings)
        coherence = None
        if name in coherences:
            at = coherences[name].at
            coherence, undefined = clean_coherence(table.values[:, at], path, f"column {table.called(at)}")
            if undefined:
                notes.append(f"coherence of {name} undefined at some lines; 0 taken there")
        records.append(FrfRecord(name, frequency, scaled(values, scale, path, about), quantity, coherence=coherence, place=about))
    if unfinished(path.read_bytes()):
        warnings.append("the last line has no end; if the file was cut there, its last number is wrong")
    return FrfSet(str(path), tuple(records), tuple(dict.fromkeys(notes)), tuple(dict.fromkeys(warnings)))


def _parts(table: TextTable, first: int, second: int, representation: str, path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The two columns of an FRF.

    Raises
    ------
    DataError
        If a value is not finite, or a magnitude negative.
    """
    for index in (first, second):
        bad = np.flatnonzero(~np.isfinite(table.values[:, index]))
        if bad.size:
            row = int(bad[0])
            raise not_finite(path, f"line {table.lines[row]}, column {table.called(index)}", table.values[row, index])
    values = table.values[:, first]
    if representation == "magnitude-phase" and (negative := np.flatnonzero(values < 0)).size:
        raise DataError(
            "a magnitude is negative",
            file=path,
            place=f"line {table.lines[negative[0]]}, column {table.called(first)}",
            expected="magnitudes from 0 on",
            found=f"{values[negative[0]]:g} ({negative.size} such lines)",
            hint="are these dB (representation: db-phase), or real and imaginary parts (real-imag)?",
        )
    return values, table.values[:, second]


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
    columns = [_classify(table, index, layout) for index in _data_columns(table, at, path)]
    chosen = [column for column in columns if column.part == "coherence"] or [column for column in columns if column.part is None]
    if not chosen:
        found = listing([one.text for one in table.headings if one.text])
        raise DataError("the file holds no coherence", file=path, expected="columns NAME_coherence", found=found)
    return {c.name: (frequency, clean_coherence(table.values[:, c.at], path, f"column {table.called(c.at)}")[0]) for c in chosen}


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
    named = [index for index, one in enumerate(table.headings) if one.is_frequency]
    if named:
        return named[0]
    if table.headings[0].is_time:
        raise DataError(
            "this is a time history",
            file=path,
            place=f"column {table.called(0)}",
            expected="FRFs over a frequency",
            found=f"values over time, {table.values[0, 0]:g} to {table.values[-1, 0]:g}",
            hint="let the analyser average FRFs from it (H1, response over hammer force), and export these",
        )
    # A count of the lines comes before the frequency: then columns and pairs do not come out even without it.
    counts = np.array_equal(np.diff(table.values[:, 0]), np.ones(len(table.values) - 1))
    nameless = not any(one.text for one in table.headings)
    return int(counts and len(table.headings) > 3 and (table.headings[0].is_index or (nameless and len(table.headings) % 2 == 0)))


def _data_columns(table: TextTable, at: int, path: Path) -> list[int]:
    """Columns of values: neither the frequency, which some programs repeat before each FRF, nor a count of the lines.

    Raises
    ------
    DataError
        If such a repeated axis is another one.
    """
    chosen = []
    for index, one in enumerate(table.headings):
        again = index != at and one.is_frequency and one.text == table.headings[at].text
        if again and not np.array_equal(table.values[:, index], table.values[:, at]):
            raise DataError(
                "another frequency axis in the same table",
                file=path,
                place=f"column {index + 1}",
                expected=f"the frequencies of column {at + 1}",
                found=f"{table.values[0, index]:.10g} to {table.values[-1, index]:.10g}",
                hint="export each FRF to a file of its own, and list these under frf of the job",
            )
        count = index < at and (one.is_index or not one.text)
        if index != at and not again and not count:
            chosen.append(index)
    return chosen


def _frequencies(table: TextTable, at: int, layout: TextLayout, path: Path, notes: list[str]) -> NDArray[np.float64]:
    unit = layout.frequency_unit or table.headings[at].unit
    text = f"{table.headings[at].text} {unit}".lower()
    scale = 1.0
    if "khz" in text:
        scale = 1e3
    elif "rad" in text:
        scale = 1.0 / (2.0 * np.pi)
    if scale != 1.0:
        notes.append(f"frequencies converted from {unit or table.called(at)} to Hz")
    frequency = np.array(table.values[:, at] * scale)
    check_frequencies(frequency, path, f"column {table.called(at)}")
    return frequency


def _find(table: TextTable, column: str | int, path: Path, place: str) -> int:
    """Index of a column by its name or its number from 1."""
    if isinstance(column, int):
        if 1 <= column <= len(table.headings):
            return column - 1
        found = f"{len(table.headings)} columns"
    else:
        fitting = [index for index, one in enumerate(table.headings) if one.text == column]
        if len(fitting) == 1:
            return fitting[0]
        found = listing([one.text for one in table.headings if one.text]) if not fitting else f"{len(fitting)} columns of that name"
    raise DataError("there is no such column", file=path, place=place, expected=repr(column), found=found)


def _classify(table: TextTable, index: int, layout: TextLayout) -> _Column:
    one = table.headings[index]
    unit = one.unit or (table.unit if one.part in (None, "real", "imag", "magnitude", "db") else "")
    told = layout.representation == "db-phase" and one.part == "magnitude"
    in_db = told or (one.part in (None, "magnitude", "db") and decibel(unit) is not None)
    return _Column(index, one.name.strip(), "db" if in_db else one.part, unit)


def _chosen_pairs(table: TextTable, layout: TextLayout, path: Path) -> list[tuple[str, int, int]]:
    return [
        (name, _find(table, first, path, f"format.columns.{name}"), _find(table, second, path, f"format.columns.{name}"))
        for name, (first, second) in layout.columns.items()
    ]


def _pairs(columns: list[_Column], layout: TextLayout, path: Path, notes: list[str]) -> tuple[list[tuple[str, int, int]], str]:
    """Pairs of columns and what they hold; pairs that share a name, or have none, by their order."""
    seen: dict[tuple[str, str], int] = {}
    parts: dict[tuple[str, int], dict[str, int]] = {}
    for column in columns:
        if column.part is not None:
            at = seen[column.name, column.part] = seen.get((column.name, column.part), -1) + 1
            parts.setdefault((column.name, at), {})[column.part] = column.at
    for (name, at), group in parts.items():
        lacking = parts[name, 0].keys() - group.keys() - {"coherence"}
        if at and lacking:
            raise DataError(
                "two columns hold the same part of one FRF",
                file=path,
                place=f"column {next(iter(group.values())) + 1}",
                expected="names that differ, or as many columns of each part",
                found=name or "no names",
            )
    complete = {
        kind: [(name, group[first], group[second]) for (name, _), group in parts.items() if first in group and second in group]
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
    alike = all(second.name in ("", first.name) for first, second in zip(plain[::2], plain[1::2], strict=False))
    if len(plain) % 2 or not plain or any(column.part for column in plain) or not (alike or layout.representation):
        magnitudes = {column.part for column in plain} <= {"magnitude", "db"} and bool(plain)
        raise DataError(
            "magnitudes without a phase" if magnitudes else "the columns do not pair up",
            file=path,
            expected="a frequency, then two columns an FRF (NAME_real and NAME_imag, or magnitude and phase)",
            found=listing([f"{column.name or column.at + 1}{f' ({column.part})' if column.part else ''}" for column in columns]),
            hint="export real and imaginary part"
            if magnitudes
            else "name them under 'format: {columns: {NAME: [first, second]}}' of the job",
        )
    representation = layout.representation or "real-imag"
    notes.append(f"columns taken as pairs of {' and '.join(_PAIRS[representation])}")
    pairs = list(zip(plain[::2], plain[1::2], strict=True))
    return [(first.name, first.at, second.at) for first, second in pairs], representation


def _phase(table: TextTable, at: int, representation: str, layout: TextLayout, notes: list[str]) -> str:
    if representation == "real-imag":
        return "rad"
    text = fold(f"{table.headings[at].text} {table.headings[at].unit}")
    if layout.phase:
        return layout.phase
    if re.search(r"deg|°|grad", text):
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
