"""Writes FRFs as a universal file: units (dataset 164) and functions (58) in ASCII, double precision."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.atomic import atomic_write
from lrbc_cli.io.uff.axis import even_axis
from lrbc_cli.model.frf import FrfRecord, FrfSet

_NUMERATORS = {"displacement": (8, "m"), "velocity": (11, "m/s"), "acceleration": (12, "m/s^2"), "pressure": (15, "Pa"), None: (0, "NONE")}
_ROTATIONS = {"m": "rad", "m/s": "rad/s", "m/s^2": "rad/s^2"}
_NAME_WIDTH = 10

log = logging.getLogger(__name__)


def write_uff(path: Path, frf: FrfSet) -> None:
    """Write FRFs, each followed by its coherence if it has one.

    An evenly spaced axis is written by its first value and increment; any other axis with six digits, as the
    format prescribes. Names above ten characters are written in full on ID line 5.

    Parameters
    ----------
    path
        The file, replaced as a whole.
    frf
        FRFs in SI units.

    Raises
    ------
    DataError
        If two lines of a record are equal when written with six digits.
    """
    blocks = [_block(164, [f"{1:10d}{'SI: Meter (newton)':<20}{2:10d}", f"{_d(1.0)}{_d(1.0)}{_d(1.0)}", _d(273.15)])]
    for number, record in enumerate(frf.records, start=1):
        blocks.append(_block(58, _function(path, record, number, 4, record.values)))
        if record.coherence is not None:
            blocks.append(_block(58, _function(path, record, number, 6, record.coherence)))
    with atomic_write(path) as stream:
        stream.write("".join(blocks))


def _block(number: int, lines: list[str]) -> str:
    return "\n".join(["    -1", f"{number:6d}", *lines, "    -1", ""])


def _d(value: float) -> str:
    return f"{value:25.17E}".replace("E", "D")


def _function(path: Path, record: FrfRecord, number: int, kind: int, values: NDArray[np.generic]) -> list[str]:
    complex_values = kind == 4
    even, minimum, increment = _spacing(path, record)
    title = "Frequency response function" if complex_values else "Coherence"
    full_name = f"name: {record.name}"[:80] if len(record.name) > _NAME_WIDTH else "NONE"
    response = (record.response_node or 0, record.response_direction)
    reference = (record.reference_node or 0, record.reference_direction)
    hammer = record.reference_name[:_NAME_WIDTH] or "NONE"
    lines = [f"{title} {record.name}"[:80].rstrip(), "NONE", "NONE", "NONE", full_name]
    lines.append(
        f"{kind:5d}{number:10d}{1:5d}{0:10d} {record.name[:_NAME_WIDTH] or 'NONE':<10}{response[0]:10d}{response[1]:4d}"
        f" {hammer:<10}{reference[0]:10d}{reference[1]:4d}"
    )
    lines.append(f"{6 if complex_values else 4:10d}{values.size:10d}{int(even):10d}{minimum:>13}{increment:>13}{0.0:13.5E}")
    lines.append(_axis(18, "Frequency", "Hz"))
    if complex_values:
        code, unit = _NUMERATORS[record.quantity]
        rotation = record.response_direction >= 4
        lines.append(_axis(code, record.quantity or "NONE", _ROTATIONS.get(unit, unit) if rotation else unit))
        lines.append(_axis(13, "Moment", "Nm") if record.reference_direction >= 4 else _axis(13, "Force", "N"))
    else:
        lines += [_axis(0, "Coherence", "NONE"), _axis(0, "NONE", "NONE")]
    lines.append(_axis(0, "NONE", "NONE"))
    numbers = np.stack([values.real, values.imag], axis=1) if complex_values else np.asarray(values.real)[:, None]
    if even:
        texts = [f"{number:20.12E}" for number in numbers.ravel()]
        return lines + ["".join(texts[start : start + 4]) for start in range(0, len(texts), 4)]
    rows = [f"{x:13.5E}" + "".join(f"{y:20.12E}" for y in row) for x, row in zip(record.frequency_hz, numbers, strict=True)]
    per_line = 1 if complex_values else 2
    return lines + ["".join(rows[start : start + per_line]) for start in range(0, len(rows), per_line)]


def _axis(kind: int, label: str, unit: str) -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {label:<20} {unit:<20}"


def _spacing(path: Path, record: FrfRecord) -> tuple[bool, str, str]:
    """Whether an even axis reproduces the lines, and its first value and increment as printed."""
    frequency = record.frequency_hz
    if frequency.size > 1:
        minimum, increment = f"{frequency[0]:.5E}", f"{(frequency[-1] - frequency[0]) / (frequency.size - 1):.5E}"
        restored, _ = even_axis(frequency.size, minimum, increment)
        if np.allclose(restored, frequency, rtol=1e-12, atol=1e-9 * float(increment)):
            return True, minimum, increment
    printed = np.array([float(f"{x:.5E}") for x in frequency])
    if np.any(printed[1:] <= printed[:-1]):
        raise DataError(
            "the frequencies need more digits than a universal file has",
            file=path,
            place=record.place or record.name,
            expected="lines that differ in six digits, or are evenly spaced",
            found=f"{frequency.size} lines from {frequency[0]:.10g} to {frequency[-1]:.10g} Hz",
            hint="write .csv or .h5",
        )
    if not np.allclose(printed, frequency, rtol=1e-12, atol=0.0):
        log.warning("%s: frequencies are rounded to the six digits that a universal file has; .csv and .h5 keep all", path)
    return False, f"{0.0:.5E}", f"{0.0:.5E}"
