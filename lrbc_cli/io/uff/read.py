"""Reads FRFs and coherences of universal files (dataset 58 and 58b) and converts them to SI.

Units. Dataset 164 gives factors for length and force; a value of the file *divided* by the factor is in SI. This is
what the text of the format says (Structural Dynamics Research Laboratory, University of Cincinnati, dataset 164), and its
unambiguous example: ``Foot (pound f)`` with the factors 3.28084 (feet in a metre) and 0.224809 (pounds in
a newton). The Julia library UFFFiles (``convert_to_si!``) divides as well, and the multiplication in SALOME was reported to it
as a bug; millimetres have the factor 1e3. A function is
converted with the exponents of length and force that belong to its data type (dataset 58, Addendum A: acceleration,
velocity, displacement 1 and 0, pressure -2 and 1, force 0 and 1, moment 1 and 1); the exponents in the
file count only for the data type *general* and for scalar directions. A unit label that is understood is used
too: it is needed for ``g``, which factors of length and force cannot express, and it must agree with 164.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.frf_common import Notes, check_frequencies, clean_coherence, first_bad, not_finite, scaled, unread_text
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.uff.datasets import UffAxis, UffFunction, UffUnits, dataset_numbers, read_datasets
from lrbc_cli.io.units import Unit, is_voltage, numerator_quantity, parse_unit, response_quantity
from lrbc_cli.model.frf import FrfRecord, FrfSet

FUNCTION_TYPES = {
    1: "time response",
    2: "auto spectrum",
    3: "cross spectrum",
    4: "frequency response function",
    5: "transmissibility",
    6: "coherence",
    9: "power spectral density",
    10: "energy spectral density",
    12: "spectrum",
    26: "multiple coherence",
}
_QUANTITY_OF = {8: "displacement", 11: "velocity", 12: "acceleration", 15: "pressure"}
_DATA_TYPES = {2: "stress", 3: "strain", 5: "temperature", 9: "reaction force", 13: "excitation force", 16: "mass", **_QUANTITY_OF}
#: What to export instead of a function of this type.
_INSTEAD = {
    1: "time histories are not read: let the analyser average FRFs from them (H1, response over hammer force), and export the FRFs",
    5: "a transmissibility has no force: export the response over the hammer force",
    6: "a coherence alone is not a measurement: export the FRFs with it",
}
_SPECTRA = "a spectrum has no phase relative to the force: export the complex FRF (H1, response over hammer force)"
_NO_PHASE = "export the complex FRF (real and imaginary part), not its magnitude"
_INVERSE = (
    "response and reference are exchanged: force over a motion (apparent mass, impedance, dynamic stiffness); set the hammer as reference "
    "in the analyser, and export the response over its force (the reciprocal is the same only if one record was measured alone)"
)
_DATASETS = {15: "nodes", 18: "coordinate systems", 55: "mode shapes", 82: "trace lines", 151: "header", 164: "units", 2411: "nodes"}
_UNKNOWN, _GENERAL, _FORCE, _FREQUENCY = 0, 1, 13, 18


@dataclass(frozen=True, kw_only=True)
class Coherence:
    """A coherence function and the DOFs it belongs to (directions without sign)."""

    name: str
    dof: tuple[int, int, int, int]
    frequency_hz: NDArray[np.float64]
    values: NDArray[np.float64]
    record: int


def read_uff(path: Path, layout: TextLayout) -> FrfSet:
    """Read all FRFs (function type 4) with their coherences (type 6); other functions are noted and left out.

    Parameters
    ----------
    path
        A universal file.
    layout
        Only its ``unit`` and ``quantity`` apply; they take precedence over the file.

    Raises
    ------
    DataError
        If the file holds no FRF, or a record cannot be read or is no FRF over force.
    """
    if layout.coherence is not None:
        raise DataError(
            "a universal file itself states which functions are coherences",
            file=path,
            place="format.coherence",
            expected="no such key, and functions of type 6 with the DOFs of their FRFs",
            found=layout.coherence,
            hint="remove it, or give it to another file of the job: {file:, format: {coherence: ...}}",
        )
    functions, units, warnings = read_datasets(path)
    notes = Notes()
    for warning in warnings:
        notes.add(warning)
    coherences = [_coherence(function, path, notes) for function in functions if function.function_type == 6]
    records: list[FrfRecord] = []
    for function, unit in zip(functions, units, strict=True):
        if function.function_type == 4 or _unnamed_frf(function, notes):
            record = _frf(function, unit, layout, path, notes)
            if record is not None:
                records.append(record)
        elif function.function_type != 6:
            notes.leave_out(FUNCTION_TYPES.get(function.function_type, f"function type {function.function_type}"), function.record)
    if not records:
        raise _no_frf(path, functions, notes)
    # The fifth ID line may be a name, see `_name`.
    said = dict.fromkeys(line.strip() for function in functions for line in function.id_lines[:4])
    titles = tuple(line for line in said if line not in ("", "NONE"))
    return FrfSet(
        source=str(path), records=tuple(_attach(records, coherences, notes)), notes=notes.lines(), warnings=notes.warnings(), titles=titles
    )


def _unnamed_frf(function: UffFunction, notes: Notes) -> bool:
    """Whether a function without a type is an FRF, judged by its axes."""
    by_axes = function.numerator.kind in _QUANTITY_OF and function.denominator.kind == _FORCE and function.abscissa_axis.kind == _FREQUENCY
    found = function.function_type == 0 and by_axes and function.values.dtype.kind == "c"
    if found:
        notes.add("function type 0, read as an FRF because of its axes", function.record)
    return found


def _no_frf(path: Path, functions: list[UffFunction], notes: Notes) -> DataError:
    """Error for a file without FRFs, with the functions that it holds instead and what to export."""
    expected = "dataset 58 with function type 4 and complex values"
    if not functions:
        there = ", ".join(f"{number}{f' ({_DATASETS[number]})' if number in _DATASETS else ''}" for number in dataset_numbers(path))
        hint = "export the measured functions too, not the geometry or the modes alone"
        return DataError("the file contains no FRF", file=path, expected=expected, found=f"no dataset 58, but {there or 'none'}", hint=hint)
    kinds = {function.function_type for function in functions}
    instead = [_INSTEAD[kind] for kind in (1, 5) if kind in kinds] + ([_INSTEAD[6]] if kinds == {6} else [])
    inverse = all(function.numerator.kind == _FORCE for function in functions if function.function_type == 4)
    hint = (_INVERSE if inverse else _NO_PHASE) if 4 in kinds else [*instead, _SPECTRA][0]
    found = notes.left_out or "coherence only"
    return DataError("the file contains no FRF", file=path, expected=expected, found=found, hint=hint)


def read_uff_coherence(path: Path) -> list[Coherence]:
    """Read the coherence functions of a universal file.

    Raises
    ------
    DataError
        If the file holds none.
    """
    functions, _, _ = read_datasets(path)
    found = [_coherence(function, path, Notes()) for function in functions if function.function_type == 6]
    if not found:
        raise DataError(
            "the file contains no coherence",
            file=path,
            expected="dataset 58 with function type 6",
            found=f"{len(functions)} other functions",
        )
    return found


def _frf(function: UffFunction, unit: UffUnits | None, layout: TextLayout, path: Path, notes: Notes) -> FrfRecord | None:
    if function.values.dtype.kind != "c":
        notes.leave_out("FRF without phase, real values", function.record)
        return None
    if function.numerator.kind not in (_UNKNOWN, _GENERAL, *_QUANTITY_OF):
        what = _DATA_TYPES.get(function.numerator.kind, f"data type {function.numerator.kind}")
        notes.leave_out(f"FRF of {what}", function.record)
        return None
    frequency = _frequency(function, path)
    bad = first_bad(function.values)
    if bad is not None:
        raise not_finite(path, function.point_place(bad), function.values[bad])
    scale, quantity = _conversion(function, unit, layout, path, notes)
    if scale != 1.0:
        notes.add(f"values multiplied by {scale:.9g} to give SI", function.record)
    if function.response_direction < 0 or function.reference_direction < 0:
        notes.add("negative direction: sign reversed", function.record)
    sign = (-1 if function.response_direction < 0 else 1) * (-1 if function.reference_direction < 0 else 1)
    for note in function.notes:
        notes.add(note, function.record)
    return FrfRecord(
        name=_name(function),
        frequency_hz=frequency,
        values=scaled(function.values, sign * scale, path, f"record {function.record}"),
        quantity=quantity,
        response_node=function.response_node or None,
        response_direction=abs(function.response_direction),
        reference_node=function.reference_node or None,
        reference_direction=abs(function.reference_direction),
        reference_name=function.reference_name,
        place=f"record {function.record}",
        number=function.record,
        uncalibrated=layout.si_unit is None and _in_volts(function),
    )


def _name(function: UffFunction) -> str:
    """Name of the response; in files of this package, names above ten characters are on ID line 5."""
    line, name = function.id_lines[4], function.response_name
    if name and line.startswith("name: ") and line[6:].startswith(name):
        return line[6:].strip()
    return name


def _frequency(function: UffFunction, path: Path) -> NDArray[np.float64]:
    axis = function.abscissa_axis
    place = f"record {function.record}"
    unit = parse_unit(axis.unit)
    is_frequency = axis.kind == _FREQUENCY or (axis.kind in (_UNKNOWN, _GENERAL) and (unit is None or unit.time == -1))
    if not is_frequency or (unit is not None and unit.dimension != (0, 0, -1)):
        found = f"data type {axis.kind}, {axis.label or 'no label'} [{axis.unit or 'no unit'}]"
        hint = _INSTEAD[1] if unit is not None and unit.time == 1 else "export FRFs over the frequency"
        raise DataError(
            "the abscissa of an FRF is not a frequency", file=path, place=place, expected="frequency in Hz", found=found, hint=hint
        )
    frequency = function.abscissa * (unit.factor if unit is not None else 1.0)
    if "rad" in axis.unit.lower():
        frequency = frequency / (2 * np.pi)
    check_frequencies(frequency, path, place)
    return frequency


def _conversion(function: UffFunction, units: UffUnits | None, layout: TextLayout, path: Path, notes: Notes) -> tuple[float, str | None]:
    """Factor to SI and quantity of one FRF."""
    record = function.record
    _require_force(function, path, notes)
    quantity = _QUANTITY_OF.get(function.numerator.kind)
    stated = layout.si_unit
    if stated is not None:
        notes.add(f"unit {layout.unit} from the campaign file")
        return stated.factor, layout.stated_quantity
    label = _label_unit(function)
    if label is not None and quantity not in (None, response_quantity(label)):
        expected = f"a unit of {quantity} over force"
        raise DataError(
            "unit label and data type contradict each other",
            file=path,
            place=f"record {record}",
            expected=expected,
            found=function.numerator.unit,
            hint="set 'format: {unit: ...}' of the job",
        )
    quantity = layout.quantity or quantity or (response_quantity(label) if label is not None else None)
    table = None
    if units is not None:
        above = _exponents(function.numerator, function.response_direction, quantity)
        below = _exponents(function.denominator, function.reference_direction, "force")
        table = units.length ** (below[0] - above[0]) * units.force ** (below[1] - above[1])
        if label is None and quantity is None and above == (0, 0) and (units.length, units.force) != (1.0, 1.0):
            raise DataError(
                "the unit of an FRF cannot be determined",
                file=path,
                place=f"record {record}",
                expected="a data type (8, 11, 12 or 15) or a unit label",
                found=f"data type {function.numerator.kind}, unit {function.numerator.unit!r}, and units other than SI in dataset 164",
                hint="set 'format: {unit: ...}' of the job",
            )
    if label is not None and table is not None and abs(label.factor / table - 1) > 1e-3:
        raise DataError(
            "unit label and dataset 164 contradict each other",
            file=path,
            place=f"record {record}",
            expected=f"one unit; dataset 164 ({units.description if units else ''}) gives the factor to SI {table:.6g}",
            found=f"{function.numerator.unit!r} over {function.denominator.unit or 'N'!r}, which gives {label.factor:.6g}",
            hint="set 'format: {unit: ...}' of the job",
        )
    unread = _unread(function) if label is None else ""
    if unread:
        meant = "SI assumed" if table is None else f"factor {table:.6g} to SI taken from dataset 164"
        notes.warn(unread_text(unread, meant, volts=_in_volts(function)), record)
    elif label is None and table is None:
        notes.add("no units (no dataset 164, no labels); SI assumed", record)
    if quantity is None:
        notes.add("the file does not state the quantity of the FRF", record)
    return (label.factor if label is not None else table if table is not None else 1.0), quantity


def _label_unit(function: UffFunction) -> Unit | None:
    """Unit over force by the labels of the axes; None if they do not state it."""
    above = parse_unit(function.numerator.unit)
    if above is None:
        return None
    if response_quantity(above) is not None:
        return above
    if numerator_quantity(above) is None:
        return None
    below = parse_unit(function.denominator.unit)
    if below is None:
        return above / Unit(1.0, force=1) if not function.denominator.unit else None
    return above / below if response_quantity(above / below) is not None else None


def _unread(function: UffFunction) -> str:
    """Unit labels of the axes for messages, where they do not state the unit of an FRF; empty if there are none."""
    above, below = (
        "" if axis.unit.strip("- ").upper() in ("", "NONE") else axis.unit for axis in (function.numerator, function.denominator)
    )
    if not above and (not below or parse_unit(below) is not None):
        return ""
    return f"{above!r} over {below!r}" if below else repr(above)


def _in_volts(function: UffFunction) -> bool:
    """Whether the labels of the axes state voltages, or numbers over numbers: sensitivities were not entered in the analyser."""
    labels = [axis.unit.strip() for axis in (function.numerator, function.denominator)]
    return any(map(is_voltage, labels)) or labels == ["1", "1"]


def _require_force(function: UffFunction, path: Path, notes: Notes) -> None:
    axis = function.denominator
    unit = parse_unit(axis.unit)
    over_force = axis.kind == _FORCE or (axis.kind == _GENERAL and (axis.length, axis.force) in ((0, 1), (1, 1)))
    if not over_force and axis.kind in (_UNKNOWN, _GENERAL):
        above = parse_unit(function.numerator.unit)
        by_label = (
            unit.dimension in ((0, 1, 0), (1, 1, 0)) if unit is not None else above is not None and response_quantity(above) is not None
        )
        if unit is None and not by_label:
            notes.add("the file does not state what the response is divided by; force assumed", function.record)
        over_force = by_label or unit is None
    if not over_force:
        what = _DATA_TYPES.get(axis.kind, f"data type {axis.kind}")
        raise DataError(
            "this is not an FRF over force",
            file=path,
            place=f"record {function.record}",
            expected="a force in the denominator (data type 13)",
            found=f"{what} [{axis.unit or 'no unit'}]",
            hint="export FRFs with the force as reference",
        )


def _exponents(axis: UffAxis, direction: int, quantity: str | None) -> tuple[int, int]:
    """Exponents of length and force of an ordinate (dataset 58, Addendum A)."""
    rotation = abs(direction) >= 4
    if (axis.kind == _GENERAL or (direction == 0 and axis.kind != _UNKNOWN)) and (axis.length, axis.force) != (0, 0):
        return axis.length, axis.force
    if quantity == "force":
        return (1, 1) if rotation else (0, 1)
    if quantity == "pressure":
        return -2, 1
    return (0, 0) if rotation or quantity is None else (1, 0)


def _coherence(function: UffFunction, path: Path, notes: Notes) -> Coherence:
    place = f"record {function.record}"
    frequency = _frequency(function, path)
    values, undefined = clean_coherence(function.values, path, place)
    if undefined:
        notes.add("coherence undefined at some lines; 0 used there", function.record)
    dof = (function.response_node, abs(function.response_direction), function.reference_node, abs(function.reference_direction))
    return Coherence(name=_name(function), dof=dof, frequency_hz=frequency, values=values, record=function.record)


def _attach(records: list[FrfRecord], coherences: list[Coherence], notes: Notes) -> list[FrfRecord]:
    """FRFs with the coherence of the same DOFs; if several have these DOFs, the name decides."""
    result = []
    used: set[int] = set()
    for record in records:
        dof = (record.response_node or 0, record.response_direction, record.reference_node or 0, record.reference_direction)
        fitting = [c for c in coherences if c.dof == dof] or [c for c in coherences if c.dof[:2] == dof[:2] and c.dof[2:] == (0, 0)]
        if len(fitting) > 1 or not dof[0]:
            fitting = [c for c in fitting if c.name == record.name]
        if len(fitting) > 1:
            # Repeated measurements of one DOF: FRFs and coherences have the same order.
            twins = [
                r
                for r in records
                if (r.name, r.response_node, r.response_direction) == (record.name, record.response_node, record.response_direction)
            ]
            position = next(index for index, twin in enumerate(twins) if twin is record)
            fitting = [fitting[position]] if len(twins) == len(fitting) else []
        if fitting and np.array_equal(fitting[0].frequency_hz, record.frequency_hz):
            used.add(fitting[0].record)
            record = replace(record, coherence=fitting[0].values)
        elif fitting:
            notes.add("the coherence has different lines; left out", record.number)
        result.append(record)
    for coherence in coherences:
        if coherence.record not in used:
            notes.leave_out("coherence without an FRF of the same DOFs and lines", coherence.record)
    return result
