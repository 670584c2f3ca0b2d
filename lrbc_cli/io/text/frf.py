"""Reads FRFs and coherences from CSV and other text files of any origin, and writes FRFs as CSV."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.atomic import atomic_write
from lrbc_cli.io.encoding import fold, read_lines, unfinished
from lrbc_cli.io.frf_common import (
    HERTZ,
    Notes,
    check_frequencies,
    clean_coherence,
    combined,
    conversion,
    frequency_unit,
    not_finite,
    scaled,
)
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.text.angles import PhaseColumn, angle_units
from lrbc_cli.io.text.blocks import Block, blocks
from lrbc_cli.io.text.decimals import require_decimals
from lrbc_cli.io.text.sniff import TextTable, read_table
from lrbc_cli.io.units import decibel, parse_unit
from lrbc_cli.model.frf import FrfRecord, FrfSet

_PAIRS = {"real-imag": ("real", "imag"), "magnitude-phase": ("magnitude", "phase"), "db-phase": ("db", "phase")}

_ANGLES = {"deg", "degree", "degrees", "degre", "degres", "grad", "°", "rad"}


@dataclass(frozen=True)
class _Column:
    at: int
    name: str
    part: str | None
    unit: str


@dataclass(frozen=True, kw_only=True)
class _Pair:
    """The two columns of one FRF, and how they represent its complex values."""

    name: str
    first: int
    second: int
    kind: str


def read_frf_text(path: Path, layout: TextLayout) -> FrfSet:
    """Read FRFs from columns of text.

    What the layout does not state is recognised: separator, decimal sign, header, columns (``NAME_real``, ``Re(NAME)``,
    ``NAME_mag``, ``NAME_phase``, ``NAME_coherence`` and the like), degrees or radians. Without a header, columns after
    the frequency are read as pairs of real and imaginary part. The notes list all of these assumptions.

    Raises
    ------
    DataError
        If there is no such table, columns do not form pairs, or a value is not finite.
    """
    lines = read_lines(path)
    several = blocks(lines, path)
    found = _of_blocks(several, path, layout) if several else _of_table(read_table(path, layout, lines), path, layout)
    if unfinished(path.read_bytes()):
        found = replace(
            found, warnings=(*found.warnings, "the last line has no line break; if the file was truncated there, its last number is wrong")
        )
    return found


def _of_table(table: TextTable, path: Path, layout: TextLayout, within: str = "") -> FrfSet:
    """All FRFs of one table; `within` names it if the file has several."""
    notes = [*table.notes] if within else [*table.notes, table.begins]
    at = _frequency_column(table, layout, path)
    frequency = _frequencies(table, at, layout, path, notes)
    require_decimals(table, path)
    named = None if layout.coherence is None else _find(table, layout.coherence, path, "format.coherence")
    columns = _by_angles([_classify(table, index, layout) for index in _data_columns(table, at, path) if index != named])
    units = {column.at: column.unit for column in columns}
    pairs = _chosen_pairs(table, columns, layout, path) or _pairs(table, columns, layout, path, notes)
    coherences = {column.name: column.at for column in columns if column.part == "coherence"}
    if named is not None:
        coherences = {_only(pairs, table.called(named), path).name: named}
    records = []
    warnings: list[str] = []
    polar = [PhaseColumn(magnitude=p.first, phase=p.second, in_db=p.kind == "db-phase") for p in pairs if p.kind != "real-imag"]
    angles = dict(zip((column.phase for column in polar), angle_units(table, polar, layout, notes, warnings), strict=True))
    for pair in pairs:
        name, about = pair.name, f"{within}column {table.called(pair.first)}"
        values = combined(*_parts(table, pair, path), pair.kind, angles.get(pair.second, "rad"))
        scale, quantity, volts = conversion(_unit(table, pair, units, layout, path), layout, path, about, notes, warnings)
        coherence = _coherence(table, coherences[name], path, name, notes) if name in coherences else None
        values = scaled(values, scale, path, about)
        known = FrfRecord(name=name, frequency_hz=frequency, values=values, quantity=quantity, coherence=coherence, place=about)
        records.append(replace(known, uncalibrated=volts))
    return FrfSet(source=str(path), records=tuple(records), notes=tuple(dict.fromkeys(notes)), warnings=tuple(dict.fromkeys(warnings)))


def _coherence(table: TextTable, at: int, path: Path, name: str, notes: list[str]) -> NDArray[np.float64]:
    coherence, undefined = clean_coherence(table.values[:, at], path, f"column {table.called(at)}")
    if undefined:
        notes.append(f"coherence of {name} undefined at some lines; 0 used there")
    return coherence


def _only(pairs: list[_Pair], column: str, path: Path) -> _Pair:
    """The only FRF of a table, to which a single column of coherence belongs."""
    if len(pairs) != 1:
        raise DataError(
            "it is not clear which FRF the coherence belongs to",
            file=path,
            place="format.coherence",
            expected="one FRF in the file",
            found=listing([pair.name or "(no name)" for pair in pairs]),
            hint=f"call the columns NAME_coherence instead of {column}, or give a file with the coherences under `coherence` of the job",
        )
    return pairs[0]


def _of_blocks(several: list[Block], path: Path, layout: TextLayout) -> FrfSet:
    """FRFs of a file with functions below each other, with the coherences of the same signals."""
    records: list[tuple[Block, FrfRecord]] = []
    coherences: list[tuple[Block, NDArray[np.float64], NDArray[np.float64]]] = []
    notes, told, warnings = Notes(), list[str](), list[str]()
    for number, block in enumerate(several, start=1):
        table = read_table(path, layout if number == 1 else replace(layout, skip=None), list(block.lines), block.before)
        if block.is_coherence and len(table.headings) > 2:
            # The columns are index, frequency and value.
            frequency = _frequencies(table, len(table.headings) - 2, layout, path, told)
            coherences.append((block, frequency, _coherence(table, len(table.headings) - 1, path, block.title, told)))
        elif not block.is_frf:
            notes.leave_out(block.alone, number)
        elif block.is_spectrum and layout.unit is None:
            notes.leave_out(f"{block.title} in {block.unit}, not over a force", number)
        else:
            if layout.representation is None and not layout.columns:
                table = replace(table, headings=block.stated(table.headings))
            found = _of_table(table, path, layout, f"{block.place}, ")
            told += found.notes
            warnings += found.warnings
            records += [(block, replace(record, number=number, place=block.place)) for record in found.records]
    if not records:
        hint = "export complex FRFs (H1, response over hammer force); or set 'format: {unit: ...}' of the job if the unit is wrong"
        raise DataError(
            "the file contains no FRF", file=path, expected="complex values", found=notes.left_out or "coherence only", hint=hint
        )
    result = []
    for block, record in records:
        fitting = [values for other, lines, values in coherences if other.signals == block.signals and _same(lines, record)]
        # The only FRF of a file stays without a name and is called by the file.
        name = record.name or ((block.signals[0] or block.title) if len(records) > 1 else "")
        coherence = fitting[0] if len(fitting) == 1 and block.signals[0] else record.coherence
        result.append(replace(record, name=name, coherence=coherence))
    told += [f"{len(several)} functions, one below the other"] * (len(several) > 1)
    return FrfSet(
        source=str(path), records=tuple(result), notes=(*dict.fromkeys(told), *notes.lines()), warnings=tuple(dict.fromkeys(warnings))
    )


def _same(lines: NDArray[np.float64], record: FrfRecord) -> bool:
    return np.array_equal(lines, record.frequency_hz)


def _unit(table: TextTable, pair: _Pair, units: dict[int, str], layout: TextLayout, path: Path) -> str:
    """Unit of an FRF: that of its first column, which the imaginary part must share.

    Raises
    ------
    DataError
        If real and imaginary part have different units.
    """
    first, second = units.get(pair.first, ""), units.get(pair.second, "")
    if pair.kind != "real-imag" or not (first and second) or layout.unit is not None:
        return first or (second if pair.kind == "real-imag" else "")
    if first != second and (parse_unit(first) is None or parse_unit(first) != parse_unit(second)):
        raise DataError(
            "real and imaginary part have different units",
            file=path,
            place=f"columns {table.called(pair.first)} and {table.called(pair.second)}",
            expected="one unit",
            found=f"{first} and {second}",
            hint="correct the heading, or set 'format: {unit: ...}' of the job",
        )
    return first


def _parts(table: TextTable, pair: _Pair, path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values of the two columns of an FRF.

    Raises
    ------
    DataError
        If a value is not finite, or a magnitude negative.
    """
    for index in (pair.first, pair.second):
        bad = np.flatnonzero(~np.isfinite(table.values[:, index]))
        if bad.size:
            row = int(bad[0])
            if bad.size == len(table.values):
                raise DataError(
                    f"the column {table.called(index)} is empty",
                    file=path,
                    place=f"lines {table.lines[0]} to {table.lines[-1]}",
                    expected="a finite number in every line",
                    found=f"none, the first is {table.cell(path, row, index)}",
                    hint="check whether its channel was left out of the export; export it again, or remove both columns of this FRF",
                )
            raise not_finite(path, f"line {table.lines[row]}, column {table.called(index)}", table.cell(path, row, index))
    values = table.values[:, pair.first]
    if pair.kind == "magnitude-phase" and (negative := np.flatnonzero(values < 0)).size:
        raise DataError(
            "a magnitude is negative",
            file=path,
            place=f"line {table.lines[negative[0]]}, column {table.called(pair.first)}",
            expected="magnitudes from 0 on",
            found=f"{values[negative[0]]:g} ({negative.size} such lines)",
            hint="check whether these are dB (representation: db-phase) or real and imaginary parts (real-imag)",
        )
    return values, table.values[:, pair.second]


def read_text_coherence(path: Path, layout: TextLayout) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Read coherences from columns ``NAME_coherence``, or from all columns after the frequency if none has such a name.

    Returns
    -------
    dict
        Frequencies [Hz] and coherences, both (F,), by name.

    Raises
    ------
    DataError
        If there is no such table or a value lies outside 0 to 1.
    """
    table = read_table(path, layout, read_lines(path))
    at = _frequency_column(table, layout, path)
    frequency = _frequencies(table, at, layout, path, [])
    if layout.coherence is not None:
        named = _find(table, layout.coherence, path, "format.coherence")
        column = _classify(table, named, layout)
        return {column.name if column.part == "coherence" else "": (frequency, _coherence(table, named, path, column.name, []))}
    columns = [_classify(table, index, layout) for index in _data_columns(table, at, path)]
    chosen = [column for column in columns if column.part == "coherence"] or [column for column in columns if column.part is None]
    if not chosen:
        found = listing([one.text for one in table.headings if one.text])
        raise DataError("the file contains no coherence", file=path, expected="columns NAME_coherence", found=found)
    return {c.name: (frequency, clean_coherence(table.values[:, c.at], path, f"column {table.called(c.at)}")[0]) for c in chosen}


def write_frf_csv(path: Path, frf: FrfSet) -> None:
    """Write FRFs in SI: ``frequency_hz``, then ``NAME_real``, ``NAME_imag`` (and ``NAME_coherence``) for each response.

    Raises
    ------
    DataError
        If the records have different lines, or repeated or empty names.
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
            hint="let the analyser average FRFs from it (H1, response over hammer force), and export the FRFs",
        )
    # Frequency and pairs are an odd number of columns; an index before the frequency makes it even.
    counts = np.array_equal(np.diff(table.values[:, 0]), np.ones(len(table.values) - 1))
    nameless = not any(one.text for one in table.headings)
    return int(counts and len(table.headings) > 3 and (table.headings[0].is_index or (nameless and len(table.headings) % 2 == 0)))


def _data_columns(table: TextTable, at: int, path: Path) -> list[int]:
    """Indices of the columns of values, without the frequency, which some programs repeat before each FRF, and a count of the lines.

    Raises
    ------
    DataError
        If a repeated frequency column differs from the first one.
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
                hint="export each FRF to a separate file, and list the files under frf of the job",
            )
        count = index < at and (one.is_index or not one.text)
        if index != at and not again and not count:
            chosen.append(index)
    return chosen


def _frequencies(table: TextTable, at: int, layout: TextLayout, path: Path, notes: list[str]) -> NDArray[np.float64]:
    place, one = f"column {table.called(at)}", table.headings[at]
    unit = layout.frequency_unit or frequency_unit(one.text, one.unit or table.axis_unit, path, place)
    if unit != "Hz":
        notes.append(f"frequencies of {place} converted from {unit} to Hz")
    frequency = np.array(table.values[:, at] * HERTZ[unit])
    check_frequencies(frequency, path, place)
    return frequency


def _find(table: TextTable, column: str | int, path: Path, place: str) -> int:
    """Index of a column from its name or its number (from 1)."""
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


def _by_angles(columns: list[_Column]) -> list[_Column]:
    """Mark columns in degrees or radians as phases, and the columns before them or of the same name as their magnitudes."""
    found: list[_Column] = []
    for column in columns:
        if column.part is None and fold(column.unit).strip("[](). ") in _ANGLES:
            before = found[-1].name if found and found[-1].part in (None, "magnitude", "db") else ""
            column = replace(column, name=column.name or before, part="phase")
        found.append(column)
    phases = {column.name for column in found if column.part == "phase"}
    return [replace(one, part="magnitude") if one.part is None and one.name in phases else one for one in found]


def _chosen_pairs(table: TextTable, columns: list[_Column], layout: TextLayout, path: Path) -> list[_Pair]:
    """Pairs that the layout names; their representation follows from the layout, else from their headings."""
    parts = {column.at: column.part for column in columns}
    pairs = []
    for name, chosen in layout.columns.items():
        first, second = (_find(table, column, path, f"format.columns.{name}") for column in chosen)
        known = [kind for kind, needed in _PAIRS.items() if (parts.get(first), parts.get(second)) == needed]
        pairs.append(_Pair(name=name, first=first, second=second, kind=layout.representation or next(iter(known), "real-imag")))
    return pairs


def _pairs(table: TextTable, columns: list[_Column], layout: TextLayout, path: Path, notes: list[str]) -> list[_Pair]:
    """Pairs of columns with their representation; columns that share a name, or have none, are paired in order."""
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
                "two columns contain the same part of one FRF",
                file=path,
                place=f"column {next(iter(group.values())) + 1}",
                expected="names that differ, or as many columns of each part",
                found=name or "no names",
            )
    complete: list[_Pair] = []
    # Titles may be wrong; what the layout says holds.
    wanted = sorted(_PAIRS, key=lambda kind: kind != layout.representation)
    for (name, _), group in parts.items():
        titled = next((kind for kind in wanted if set(_PAIRS[kind]) <= group.keys()), None)
        if titled is not None:
            first, second = _PAIRS[titled]
            complete.append(_Pair(name=name, first=group[first], second=group[second], kind=layout.representation or titled))
    if complete:
        used = {pair.name for pair in complete}
        left = [column for column in columns if column.name not in used or column.part is None]
        if left:
            notes.append(f"columns without a partner left out: {listing([column.name or str(column.at + 1) for column in left])}")
        for kind in dict.fromkeys(pair.kind for pair in complete):
            count = sum(pair.kind == kind for pair in complete)
            notes.append(f"{count} FRF{'s' if count > 1 else ''}, {kind}")
        return complete
    plain = [column for column in columns if column.part != "coherence"]
    alike = all(second.name in ("", first.name) for first, second in zip(plain[::2], plain[1::2], strict=False))
    if len(plain) % 2 or not plain or any(column.part for column in plain) or not (alike or layout.representation):
        magnitudes = {column.part for column in plain} <= {"magnitude", "db"} and bool(plain)
        raise DataError(
            "magnitudes without a phase" if magnitudes else "the columns cannot be paired",
            file=path,
            expected="a frequency, then two columns per FRF (NAME_real and NAME_imag, or magnitude and phase)",
            found=listing([f"{column.name or column.at + 1}{f' ({column.part})' if column.part else ''}" for column in columns]),
            hint="export real and imaginary part" if magnitudes else _instead(table, columns),
        )
    representation = layout.representation or "real-imag"
    notes.append(f"columns read as pairs of {' and '.join(_PAIRS[representation])}")
    pairs = list(zip(plain[::2], plain[1::2], strict=True))
    return [_Pair(name=first.name, first=first.at, second=second.at, kind=representation) for first, second in pairs]


def _instead(table: TextTable, columns: Sequence[_Column]) -> str:
    """What columns without a partner may be, and advice."""
    values = table.values[:, [column.at for column in columns]]
    known = values[np.isfinite(values)]
    plain = "give the pairs under 'format: {columns: {NAME: [first, second]}}' of the job"
    if known.size and known.min() >= 0.0 and known.max() <= 1.0 and np.median(known) > 0.5:
        return f"check whether these are coherences; if so, give them under `coherence` of the job and the FRFs under `frf`; else {plain}"
    if known.size and known.min() >= 0.0:
        return f"check whether these are magnitudes without phases; if so, export real and imaginary part; else {plain}"
    return plain
