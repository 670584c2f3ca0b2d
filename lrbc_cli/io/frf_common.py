"""Checks, conversions and notes that the readers of all FRF formats share."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.encoding import fold
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.units import Unit, decibel, is_voltage, numerator_quantity, parse_unit, response_quantity

_CIRCULAR = re.compile(r"(omega|w|\u03c9)(?![a-z])|(angular|circular) freq|kreisfreq|pulsation")
_FREQUENCY_UNITS = re.compile(r"(?<![a-z])(k?hz|hertz|cps|rad(s|ians?)?)(?![a-z])|^(1/s(ec)?|s(\^?-|⁻)[1¹])$")
#: Name of a function with its response and its reference.
_FUNCTION = re.compile(r"\s*(?:H[0-9v]?|FRF|TF)\s*\(\s*([^(),;/|\s][^(),;/|]{0,80}?)\s*[,;/|]\s*[^(),;/|]{1,80}\)\s*", re.IGNORECASE)
#: Value of each frequency unit in Hz.
HERTZ = {"Hz": 1.0, "kHz": 1e3, "rad/s": 1.0 / (2.0 * np.pi)}


def response_of(name: str) -> str:
    """Response in the name of a function such as ``H1(acc1/hammer)``; any other name is returned as it is."""
    match = _FUNCTION.fullmatch(name)
    return match[1] if match else name


#: Separators of the words in the name of a file.
WORDS = re.compile(r"[\s_.-]+")


def alike(name: str) -> str:
    """Name for comparison: the response only, without case and separators, so that ``Acc 1`` is ``acc1``.

    Separators between digits stay (``1.1`` is not ``11``), and so does a sign before a direction (``1:-Z``).
    """
    text = re.sub(r"[\s_.]+", " ", response_of(name).strip().casefold())
    return re.sub(r"(?<!\d) | (?!\d)|(?<=[^\W\d])-(?=\d)", "", text)


def frequency_unit(name: str, unit: str, path: Path, place: str) -> str:
    """Unit of frequencies (a key of ``HERTZ``): as stated, else by their name: ``omega``, ``w`` and the like are rad/s, others Hz.

    Raises
    ------
    DataError
        If a unit is stated that is none of ``HERTZ``.
    """
    said = fold(unit).strip("[](). -")
    if said and not _FREQUENCY_UNITS.search(said):
        raise DataError(
            "the unit of the frequencies is not understood",
            file=path,
            place=place,
            expected=", ".join(HERTZ),
            found=unit,
            hint="convert them; or set 'format: {frequency_unit: ...}' of the job if the label is wrong",
        )
    for text in (said, fold(name)):
        if "hz" in text or "hertz" in text:
            return "kHz" if "khz" in text else "Hz"
        if re.search(r"(?<![a-z])rad(s|ians?)?(?![a-z])", text):
            return "rad/s"
    return "rad/s" if _CIRCULAR.match(fold(name).strip()) else "Hz"


class Notes:
    """Notes and warnings on the records of a file; one that several records share becomes one line."""

    def __init__(self) -> None:
        self._about: dict[str, list[int]] = {}
        self._left: dict[str, list[int]] = {}
        self._doubts: dict[str, list[int]] = {}

    def add(self, text: str, record: int | None = None) -> None:
        """Add a note about a record (its number), or about the whole file (None)."""
        places = self._about.setdefault(text, [])
        if record is not None:
            places.append(record)

    def warn(self, text: str, record: int) -> None:
        """Add a warning about a record."""
        self._doubts.setdefault(text, []).append(record)

    def leave_out(self, what: str, record: int) -> None:
        """Note a record that is not used, and what it is."""
        self._left.setdefault(what, []).append(record)

    @property
    def left_out(self) -> str:
        """Records that are not used, in one line; empty if there are none."""
        return ", ".join(f"{_ranges(records)} ({what})" for what, records in self._left.items())

    def lines(self) -> tuple[str, ...]:
        """All notes in the order of their first record, then one line with the records that are not used."""
        told = [f"{_ranges(records)}: {text}" if records else text for text, records in self._about.items()]
        return (*told, *([f"left out: {self.left_out}"] if self._left else []))

    def warnings(self) -> tuple[str, ...]:
        """All warnings in the order of their first record."""
        return tuple(f"{_ranges(records)}: {text}" for text, records in self._doubts.items())


def check_frequencies(frequency: NDArray[np.float64], path: Path, place: str) -> None:
    """Refuse frequency lines [Hz], (F,), unless they are finite, not negative and strictly increasing.

    Raises
    ------
    DataError
        If there are no lines or one is wrong; the first such line is named.
    """
    if frequency.size == 0:
        raise DataError("there is no frequency line", file=path, place=place, expected="at least one line", found="none")
    bad = np.flatnonzero(~np.isfinite(frequency) | (frequency < 0))
    if bad.size:
        at = int(bad[0])
        found = f"{frequency[at]:.10g} at point {at + 1}"
        hint = "remove the lines that have no frequency"
        if np.isfinite(frequency[at]):
            hint = "export one-sided spectra, or remove the lines below 0 Hz (complex conjugates of those above)"
        raise DataError("a frequency is wrong", file=path, place=place, expected="finite numbers from 0 Hz", found=found, hint=hint)
    fall = np.flatnonzero(frequency[1:] <= frequency[:-1])
    if fall.size:
        at = int(fall[0])
        found = f"{frequency[at]:.10g} Hz, then {frequency[at + 1]:.10g} Hz at point {at + 2}"
        hint = "remove the duplicate line" if frequency[at] == frequency[at + 1] else "sort the lines"
        if (
            fall.size == 1
            and frequency[at + 1] < frequency[at]
            and at + 2 < frequency.size
            and frequency[at + 1] <= np.median(frequency[: at + 1])
        ):
            hint = f"probably two measurements in one file: keep one of them, the points up to {at + 1} or those from {at + 2} on"
        hint += ", or give the column with the frequencies: 'format: {frequency: ...}'" if "column" in place else ""
        raise DataError(
            "the frequencies do not increase", file=path, place=place, expected="each above the one before", found=found, hint=hint
        )


def first_bad(values: NDArray[Any]) -> int | None:
    """Index of the first value that is NaN or infinite."""
    bad = np.flatnonzero(~np.isfinite(values))
    return int(bad[0]) if bad.size else None


def not_finite(path: Path, place: str, value: object) -> DataError:
    """Error for a value that is NaN or infinite."""
    hint = "leave out this line or measure it again"
    return DataError(
        "the FRF contains a value that is not a finite number", file=path, place=place, expected="finite numbers", found=value, hint=hint
    )


def combined(first: NDArray[np.float64], second: NDArray[np.float64], representation: str, phase: str) -> NDArray[np.complex128]:
    """Complex values from real and imaginary part, or magnitude (``db-phase``: in dB) and phase in ``deg`` or ``rad``."""
    if representation == "real-imag":
        values = np.empty(first.shape, dtype=np.complex128)
        values.real, values.imag = first, second
        return values
    magnitude = 10.0 ** (np.clip(first, -6000.0, 6000.0) / 20.0) if representation == "db-phase" else first
    return np.asarray(magnitude * np.exp(1j * (np.deg2rad(second) if phase == "deg" else second)), dtype=np.complex128)


def scaled(values: NDArray[Any], factor: float, path: Path, place: str) -> NDArray[np.complex128]:
    """Values multiplied by a factor.

    Raises
    ------
    DataError
        If a product overflows.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        product = np.asarray(values * factor, dtype=np.complex128)
    bad = first_bad(product)
    if bad is not None:
        raise not_finite(path, f"{place}, point {bad + 1}", f"{values[bad]} times {factor:.6g}")
    return product


def clean_coherence(values: NDArray[Any], path: Path, place: str) -> tuple[NDArray[np.float64], bool]:
    """Coherence clipped to 0 to 1, undefined values (0/0) set to 0; and whether there were undefined values.

    Raises
    ------
    DataError
        If a value lies outside 0 to 1 by more than rounding.
    """
    real = np.array(values.real, dtype=np.float64)
    undefined = np.isnan(real)
    real[undefined] = 0.0
    outside = np.flatnonzero((real < -1e-3) | (real > 1.0 + 1e-3))
    if outside.size:
        at, percent = int(outside[0]), real.min() >= 0.0 and real.max() <= 100.1
        raise DataError(
            "a coherence is wrong",
            file=path,
            place=place,
            expected="0 to 1",
            found=f"{real[at]:.6g} at point {at + 1}",
            hint="probably in per cent: divide all values by 100"
            if percent
            else "check whether this is the coherence; give the column, variable or file that contains it, or leave it out",
        )
    return np.clip(real, 0.0, 1.0), bool(undefined.any())


def unread_text(label: str, meant: str, *, volts: bool) -> str:
    """Warning about a unit that is not understood, and counts as ``meant``; ``volts``: because its channels are not calibrated."""
    if not volts:
        return f"unit {label} not understood, {meant}: set 'format: {{unit: ...}}' of the job"
    return (
        f"unit {label} is that of channels that are not calibrated, {meant}. Enter the sensitivities of sensors and hammer in the "
        "analyser, and export again; or write `scale` in the job: sensitivity of the hammer [V/N] over that of the sensor [V/(m/s2) or "
        "V/Pa], 100 mV/g being 0.0102 V/(m/s2)"
    )


def conversion(
    label: str, layout: TextLayout, path: Path, place: str, notes: list[str], warnings: list[str]
) -> tuple[float, str | None, bool]:
    """Factor to SI and quantity of an FRF, from the layout or a label such as ``(m/s²)/N`` or ``dB re 1 g/N``; and whether it is in volts.

    A label of the response alone is taken over newtons. A label that is not understood counts as SI, with a warning.

    Raises
    ------
    DataError
        If the unit is not that of a pressure or motion over a force, or contradicts the stated quantity.
    """
    stated, reference = layout.si_unit, 1.0
    if (in_db := decibel(label)) is not None:
        reference, label = in_db
    unit = stated or parse_unit(label)
    if stated is None and unit is not None and response_quantity(unit) is None:
        unit = unit / Unit(1.0, force=1) if numerator_quantity(unit) is not None else None
    if unit is None or response_quantity(unit) is None:
        other = parse_unit(label)
        # A dimensionless quotient such as g/g is a transmissibility; a bare "1" states no unit.
        if other is not None and (other.dimension != (0, 0, 0) or label.strip("[] ") != "1"):
            raise DataError(
                "this is not the unit of an FRF" if any(other.dimension) else "this is a transmissibility, not an FRF over a force",
                file=path,
                place=place,
                expected="a pressure or a motion over a force, such as Pa/N or (m/s²)/N",
                found=label,
                hint="export FRFs (H1, response over hammer force), not spectra; or set 'format: {unit: ...}' of the job if the label is "
                "wrong",
            )
        if label.strip("- "):
            warnings.append(unread_text(repr(label), "SI assumed", volts=is_voltage(label)))
        return reference, layout.quantity, is_voltage(label)
    quantity = layout.quantity or response_quantity(unit)
    if quantity != response_quantity(unit):
        expected = f"a unit of {quantity} over force"
        raise DataError("unit and quantity do not fit", file=path, place=place, expected=expected, found=label)
    factor = unit.factor * (reference if stated is None else 1.0)
    if factor != 1.0:
        notes.append(f"values in {layout.unit or label} multiplied by {factor:.9g} to give SI")
    return factor, quantity, False


def _ranges(numbers: list[int]) -> str:
    numbers = sorted(set(numbers))
    parts: list[tuple[int, int]] = []
    for number in numbers:
        if parts and number == parts[-1][1] + 1:
            parts[-1] = (parts[-1][0], number)
        else:
            parts.append((number, number))
    shown = ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in parts)
    return f"record{'s' if len(numbers) > 1 else ''} {shown}"
