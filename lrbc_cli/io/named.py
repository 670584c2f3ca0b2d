"""Recognises FRFs among named arrays: variables of MATLAB files, fields of their structures, data sets of HDF5 files, arrays of NumPy.

The readers of these formats turn a file into ``Named``; frequencies, FRFs, names, units and coherences are recognised here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats
from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.encoding import fold
from lrbc_cli.io.frf_common import (
    HERTZ,
    Notes,
    check_frequencies,
    clean_coherence,
    combined,
    conversion,
    first_bad,
    frequency_unit,
    not_finite,
    scaled,
)
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.sparse import numeric
from lrbc_cli.io.text.header import heading
from lrbc_cli.io.units import parse_unit
from lrbc_cli.model.frf import FrfRecord, FrfSet

_AXES = {"frequency_hz", "frequency", "freq", "f", "fhz", "f_hz", "freq_hz", "freqs", "frequencies", "hz", "frequenz", "omega"}
_COHERENCES = {"coherence", "coh", "gamma2", "cxy", "coherences", "mscohere", "kohaerenz"}
_NAMES = {"names", "name", "labels", "label", "channels", "channel_names", "channelnames", "responses", "response_names", "sensors"}
#: Most entries of a list of texts; they need far more memory than in the file, and no file has so many channels.
_MOST_TEXTS = 2**20
_UNITS = {"units", "unit", "y_unit", "yunit", "y_units"}


@dataclass(frozen=True)
class Named:
    """Arrays and texts of a file by their names; a name is a path through structures or groups, with dots between its parts.

    Attributes
    ----------
    arrays : mapping of str to array
        Numbers, of any shape.
    texts : mapping of str to tuple of str
        Lists of texts.
    """

    arrays: Mapping[str, NDArray[Any]]
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def _in(self, group: str, known: set[str]) -> dict[str, tuple[str, ...]]:
        return {key: texts for key, texts in self.texts.items() if _group(key) == group and fold(_last(key)) in known}

    def axis_unit(self, name: str) -> str:
        """Unit stated by an array of frequencies itself (an attribute of its own); empty if there is none."""
        return next((texts[0] for texts in self._in(name, _UNITS).values() if len(texts) == 1), "")

    def names_of(self, name: str, count: int) -> tuple[str, ...]:
        """Names of the `count` columns of an array, from the innermost structure that lists as many; empty if there is none."""
        return next((texts for texts in self.lists_of_names(name, count).values() if len(texts) == count), ())

    def lists_of_names(self, name: str, count: int) -> dict[str, tuple[str, ...]]:
        """Lists of any length that may name the columns of an array; outer structures are searched only for several columns."""
        groups = [name, *self._around(name)]
        return {key: texts for group in (groups if count > 1 else groups[:2]) for key, texts in self._in(group, _NAMES).items()}

    def _around(self, name: str) -> list[str]:
        """Names of the structures that contain an array, innermost first; the last one, the file, is empty."""
        parts = name.split(".")[:-1]
        return [".".join(parts[:count]) for count in range(len(parts), -1, -1)]

    def units_of(self, name: str, path: Path) -> tuple[str, ...]:
        """Units of an array: its own, else those of the innermost structure around it that states any.

        Raises
        ------
        DataError
            If units stated at several levels contradict each other.
        """
        found = {key: texts for group in (name, *self._around(name)) for key, texts in self._in(group, _UNITS).items()}
        known = {key: texts[0] for key, texts in found.items() if len(texts) == 1 and parse_unit(texts[0]) is not None}
        for key, text in known.items():
            first = next(iter(known))
            if parse_unit(text) != parse_unit(known[first]):
                raise DataError(
                    "two units are stated for one array",
                    file=path,
                    place=f"variable {name}",
                    expected="one unit",
                    found=f"{known[first]} ({first}) and {text} ({key})",
                    hint="set 'format: {unit: ...}' of the job",
                )
        return next(iter(found.values()), ())


def named_arrays(values: Mapping[str, NDArray[Any]], path: Path) -> Named:
    """Sort arrays of any type into numbers and texts; all others, and very long lists of texts, are left out."""
    arrays: dict[str, NDArray[Any]] = {}
    texts: dict[str, tuple[str, ...]] = {}
    for name, array in values.items():
        if array.dtype.kind in "fiubc" or set(array.dtype.names or ()) == {"real", "imag"}:
            arrays[name] = numeric(array, path, name)
        elif array.dtype.kind in "SUO" and array.size <= _MOST_TEXTS:
            found = [one.decode("utf-8", "replace") if isinstance(one, bytes) else one for one in array.ravel().tolist()]
            if all(isinstance(one, str) for one in found):
                texts[name] = tuple(found)
    return Named(arrays, texts)


def frf_set(named: Named, path: Path, layout: TextLayout) -> FrfSet:
    """All FRFs among named arrays, with their coherences.

    The frequencies are an array called ``f``, ``freq``, ``frequency`` and the like (or named by ``layout.frequency``). FRFs are complex
    arrays with one dimension of the same length, or pairs of real arrays ``NAME_real`` and ``NAME_imag`` in the same structure, or, if
    ``layout.representation`` is given, real arrays with both parts in the last dimension.
    ``names`` and ``units`` beside them describe the columns; ``coh`` or ``coherence`` (or what ``layout.coherence`` names) of the
    same size is their coherence. A complex matrix without frequencies has them in its first column. Structures of Simcenter
    Testlab (``x_values``, ``y_values``) are recognised.

    Raises
    ------
    DataError
        If no FRF is recognised, a value is not finite, or frequencies, units or coherences are wrong.
    """
    reader = _NamedFrfs(_spread(named), path, layout)
    for name, (array, axis) in reader.found().items():
        reader.read(name, array, axis)
    if not reader.records:
        pairs = [name for name, array in named.arrays.items() if array.ndim > 2 and array.shape[-1] == 2 and array.dtype.kind == "f"]
        raise DataError(
            "no FRF was recognised in the file",
            file=path,
            expected="a variable 'f' and complex arrays with as many rows, as variables or fields of one structure, or a complex "
            "matrix with the frequency in its first column",
            found=listing([f"{name} {array.shape} {array.dtype.kind}" for name, array in named.arrays.items()]),
            hint=f"if the last dimension of {pairs[0]} contains real and imaginary part, set 'format: {{representation: real-imag}}' of "
            "the job"
            if pairs
            else reader.cut()
            or "set 'format: {frequency: ...}' of the job to the variable of the frequencies, or export CSV or a universal file",
        )
    return FrfSet(
        source=str(path),
        records=tuple(reader.records),
        notes=(*reader.notes.lines(), *reader.left_out()),
        warnings=tuple(dict.fromkeys(reader.warnings)),
    )


def coherences(named: Named, path: Path, layout: TextLayout) -> dict[str, tuple[Floats, Floats]]:
    """Frequencies [Hz] and values, both (F,), of the columns of all arrays called coherence, by the name of the column.

    Raises
    ------
    DataError
        If ``layout.coherence`` names no array, or a value lies outside 0 to 1.
    """
    reader = _NamedFrfs(named, path, layout)
    reader.require_coherence()
    found: dict[str, tuple[Floats, Floats]] = {}
    for name, array in named.arrays.items():
        axis = reader.axis_of(name)
        if axis is None or axis.size not in array.shape or not reader.is_coherence(name):
            continue
        columns = _columns(array, axis.size)
        for label, column in zip(reader.labels(name, columns), columns, strict=True):
            found[label] = (axis, clean_coherence(column, path, label)[0])
    return found


class _NamedFrfs:
    """Sorts the arrays of one file into frequencies, FRFs and coherences, and collects records, notes and warnings."""

    def __init__(self, named: Named, path: Path, layout: TextLayout) -> None:
        self.named, self.path, self.layout = named, path, layout
        self.records: list[FrfRecord] = []
        self.notes = Notes()
        self.warnings: list[str] = []
        self._used: set[str] = set()

    def axis_of(self, name: str) -> Floats | None:
        """Frequencies [Hz] of an array: those in its own structure, else those at the top level of the file; None if there are none."""
        for group in (_group(name), ""):
            for key, array in self.named.arrays.items():
                if _group(key) == group and key != name and self._is_axis(key, array):
                    self._used.add(key)
                    told = self.layout.frequency_unit
                    unit = told or frequency_unit(_last(key), self.named.axis_unit(key), self.path, f"variable {key}")
                    return self._frequencies(array.ravel(), key, unit)
        return None

    def _is_axis(self, key: str, array: NDArray[Any]) -> bool:
        wanted = self.layout.frequency
        vector = array.size > 1 and array.size == max(array.shape)
        return vector and (key == str(wanted) or _last(key) == str(wanted) if wanted is not None else fold(_last(key)) in _AXES)

    def cut(self) -> str:
        """Hint if frequencies and FRFs differ in length by one or two lines, so that only one of them was cut; else empty."""
        for key, axis in self.named.arrays.items():
            for name, array in self.named.arrays.items() if self._is_axis(key, axis) else ():
                near = [size for size in array.shape if array.dtype.kind == "c" and 0 < abs(size - axis.size) <= 2]
                if near and _group(key) in (_group(name), ""):
                    return (
                        f"{key} has {axis.size} entries, {name} has {near[0]} lines: only one of them was cut, often by the line at 0 Hz. "
                        "Export both again, each line with its frequency"
                    )
        return ""

    def _frequencies(self, values: NDArray[Any], place: str, unit: str = "Hz") -> Floats:
        if values.dtype.kind == "c" and np.any(values.imag != 0):
            raise self._no_axis(place, values.size)
        unit = self.layout.frequency_unit or unit
        if unit != "Hz":
            self.notes.add(f"frequencies of {place} converted from {unit} to Hz")
        frequency = np.array(values.real, dtype=np.float64) * HERTZ[unit]
        check_frequencies(frequency, self.path, place)
        return frequency

    def _no_axis(self, place: str, count: int) -> DataError:
        """Error that no array is called a frequency, with a vector of `count` entries that may be one as a hint."""
        arrays = self.named.arrays
        vectors = [_last(key) for key, array in arrays.items() if count in array.shape and array.size == count and array.dtype.kind == "f"]
        name, unit = (vectors[0], frequency_unit(vectors[0], "", self.path, place)) if vectors else ("...", "...")
        return DataError(
            "no frequency variable was recognised",
            file=self.path,
            place=place,
            expected="one called f, freq, frequency or omega, or a matrix with the frequencies in its first column",
            found=listing([f"{key} {array.shape}" for key, array in arrays.items()]),
            hint=f"give the variable and its unit in the job: 'format: {{frequency: {name}, frequency_unit: {unit}}}'",
        )

    def is_coherence(self, name: str) -> bool:
        """Whether an array is a coherence by its name, or by ``layout.coherence``."""
        wanted, last = self.layout.coherence, _last(name)
        if wanted is not None:
            return str(wanted) in (name, last)
        return fold(last) in _COHERENCES or heading(last).part == "coherence"

    def found(self) -> dict[str, tuple[NDArray[Any], Floats]]:
        """Complex FRF arrays and their frequencies [Hz], by name."""
        arrays, found = self.named.arrays, {}
        wanted = self.layout.frequency
        if wanted is not None and not any(self._is_axis(key, array) for key, array in arrays.items()):
            raise self._not_there("frequency", "frequencies", str(wanted))
        self.require_coherence()
        for name, array in arrays.items():
            axis = self.axis_of(name)
            if axis is None:
                if array.dtype.kind == "c" and array.ndim == 2 and min(array.shape) > 1:
                    found[name] = (array[:, 1:], self._frequencies(array[:, 0], f"{name}, column 1"))
                continue
            if axis.size not in array.shape:
                continue
            if array.dtype.kind == "c":
                found[name] = (array, axis)
            elif self._holds_parts(name, array, axis.size):
                found[name] = (self._of_parts(array, name), axis)
            elif heading(_last(name)).part == "real":
                partner = next((key for key in arrays if _group(key) == _group(name) and _are_parts(_last(name), _last(key))), None)
                if partner is not None and arrays[partner].shape == array.shape:
                    self._used |= {name, partner}
                    base = heading(_last(name)).name or _last(_group(name))
                    found[".".join(part for part in (_group(name), base) if part)] = (array + 1j * arrays[partner], axis)
        self._used |= found.keys()
        return found

    def _holds_parts(self, name: str, array: NDArray[Any], count: int) -> bool:
        """Whether, by ``layout.representation``, the last dimension of a real array holds the two parts of complex numbers."""
        one_part = self.is_coherence(name) or heading(_last(name)).part in ("real", "imag")
        if self.layout.representation is None or array.shape[-1] != 2 or array.ndim < 2 or one_part:
            return False
        if list(array.shape).count(2) > 1 + (count == 2):
            raise DataError(
                "it is not clear which dimension contains the parts of the FRFs",
                file=self.path,
                place=f"variable {name}",
                expected="one dimension of 2",
                found=array.shape,
                hint="store complex values, or the parts as two arrays NAME_real and NAME_imag",
            )
        return True

    def _of_parts(self, array: NDArray[Any], name: str) -> NDArray[np.complex128]:
        representation, phase = self.layout.representation or "", self.layout.phase
        if phase is None and representation != "real-imag":
            raise DataError(
                "the unit of the phase is not known",
                file=self.path,
                place=f"variable {name}",
                expected="deg or rad",
                found="an array of numbers",
                hint="set 'format: {phase: ...}' of the job",
            )
        return combined(array[..., 0], array[..., 1], representation, phase or "rad")

    def _not_there(self, key: str, what: str, wanted: str) -> DataError:
        return DataError(
            f"the variable of {what} was not found",
            file=self.path,
            place=f"format.{key}",
            expected=wanted,
            found=listing(list(self.named.arrays)),
        )

    def require_coherence(self) -> None:
        """Raise a DataError if ``layout.coherence`` names no array."""
        if self.layout.coherence is not None and not any(map(self.is_coherence, self.named.arrays)):
            raise self._not_there("coherence", "the coherence", str(self.layout.coherence))

    def labels(self, name: str, columns: list[NDArray[Any]]) -> list[str]:
        """Names of the records from the columns of an array: a list of names, else the array's own name, numbered."""
        names = self.named.names_of(name, len(columns))
        if names:
            return [text.strip() for text in names]
        for key, texts in self.named.lists_of_names(name, len(columns)).items():
            # Warn only if the list fits no other array either.
            fits = any(array.ndim > 1 and len(texts) in array.shape for array in self.named.arrays.values())
            if len(columns) > 1 and len(texts) > 1 and not fits:
                self.warnings.append(
                    f"`{key}` has {len(texts)} entries for the {len(columns)} columns of {name} and was not used: correct it, or give "
                    "records: {RESPONSE: NUMBER, ...} in the job"
                )
        group, own = _group(name), heading(_last(name)).name
        # The only FRF array of a structure is named after the structure.
        alone = sum(array.dtype.kind == "c" and _group(key) == group for key, array in self.named.arrays.items()) == 1
        base = own if own and not (alone and group) else _last(group) or _last(name)
        return [base] if len(columns) == 1 else [f"{base}_{index + 1}" for index in range(len(columns))]

    def read(self, name: str, array: NDArray[Any], axis: Floats) -> None:
        """Append the records of one array, one for each column, converted to SI."""
        columns = _columns(array, axis.size)
        labels = self.labels(name, columns)
        units = self.named.units_of(name, self.path) if self.layout.unit is None else ()
        if len(units) not in (0, 1, len(columns)):
            raise DataError(
                "the units do not fit the channels",
                file=self.path,
                place=f"variable {name}",
                expected=f"one unit, or {len(columns)}",
                found=f"{len(units)}: {listing(units)}",
                hint="correct the list, or set 'format: {unit: ...}' of the job",
            )
        quality = self._coherence_of(name, array.shape, axis)
        for index, (label, column) in enumerate(zip(labels, columns, strict=True)):
            bad = first_bad(column)
            if bad is not None:
                raise not_finite(self.path, f"{label}, row {bad + 1}", column[bad])
            unit = units[index] if len(units) == len(columns) else next(iter(units), "")
            notes: list[str] = []
            factor, quantity, volts = conversion(unit, self.layout, self.path, f"variable {name}", notes, self.warnings)
            for note in notes:
                self.notes.add(note)
            coherence = None if quality is None else clean_coherence(quality[index], self.path, f"coherence of {label}")[0]
            place = f"variable {name}" + (f", column {index + 1}" if len(columns) > 1 else "")
            values = scaled(column, factor, self.path, label)
            known = FrfRecord(name=label, frequency_hz=axis, values=values, quantity=quantity, coherence=coherence, place=place)
            self.records.append(replace(known, uncalibrated=volts))

    def _coherence_of(self, name: str, shape: tuple[int, ...], axis: Floats) -> list[NDArray[Any]] | None:
        """Columns of the coherence of an array: the one with its name, else the only one of its structure and size."""
        fitting = [
            key
            for key, array in self.named.arrays.items()
            if self.is_coherence(key) and _group(key) == _group(name) and axis.size in array.shape and array.size == np.prod(shape)
        ]
        own = [key for key in fitting if heading(_last(key)).name and heading(_last(key)).name == _last(name)]
        chosen = own or ([key for key in fitting if not heading(_last(key)).name or len(fitting) == 1])
        if len(chosen) != 1:
            return None
        self._used.add(chosen[0])
        return _columns(self.named.arrays[chosen[0]], axis.size)

    def left_out(self) -> list[str]:
        """Note on the arrays that are part of no FRF."""
        names = [name for name, array in self.named.arrays.items() if name not in self._used and array.size > 1]
        return [f"left out: {listing(names, 6)} (no FRF)"] if names else []


def _group(name: str) -> str:
    return name.rpartition(".")[0]


def _last(name: str) -> str:
    return name.rpartition(".")[2]


def _are_parts(real: str, imag: str) -> bool:
    first, second = heading(real), heading(imag)
    return (first.name, first.part, second.part) == (second.name, "real", "imag")


def _columns(array: NDArray[Any], count: int) -> list[NDArray[Any]]:
    """Columns (F,) of an array along its frequency dimension: the first, else the last (outputs by inputs), of length `count`."""
    along = 0 if array.shape[0] == count else array.ndim - 1 if array.shape[-1] == count else list(array.shape).index(count)
    flat = np.moveaxis(array, along, 0).reshape(count, -1)
    return [flat[:, index] for index in range(flat.shape[1])]


def _spread(named: Named) -> Named:
    """Copy with Simcenter Testlab structures (start, increment and number of values of the axis) as arrays of frequencies and FRFs."""
    arrays, texts = dict(named.arrays), dict(named.texts)
    for key in named.arrays:
        group, _, last = key.rpartition(".x_values.")
        values = f"{group}.y_values.values"
        if last != "increment" or values not in arrays:
            continue
        start, step, count = (float(np.append(arrays.pop(f"{group}.x_values.{part}", ()), 0.0)[0].real) for part in _TESTLAB)
        if not (step > 0 and 1 < count <= arrays[values].size):
            continue
        arrays[f"{group}.f"] = start + step * np.arange(int(count))
        arrays[f"{group}.H"] = arrays.pop(values)
        for source, target in (("function_record.name", "names"), ("y_values.quantity.label", "units")):
            if f"{group}.{source}" in texts:
                texts[f"{group}.{target}"] = texts.pop(f"{group}.{source}")
    return Named(arrays, texts)


_TESTLAB = ("start_value", "increment", "number_of_values")
