"""CSV tables beside the JSON result files: written atomically, and read again for the report."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.errors import DataError
from lrbc_cli.io.common import regular_bytes
from lrbc_cli.remembered import Remembered
from lrbc_cli.results.fields import StoredRecord
from lrbc_cli.results.store import write_bytes

HINT = StoredRecord.HINT

#: Cache of the last tables read.
_tables = Remembered[dict[str, Floats]](256)

FRF_COLUMNS = (*(f"{state}_{part}" for state in ("measured", "initial", "updated") for part in ("db", "phase_deg")), "coherence")


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a table atomically; NaN and None become empty cells.

    Returns
    -------
    str
        SHA-256 of the bytes written.

    Raises
    ------
    ConfigError
        If the output folder cannot be written.
    """

    def cell(value: Any) -> Any:
        if value is None or (isinstance(value, float | np.floating) and not math.isfinite(value)):
            return ""
        return f"{value:.9g}" if isinstance(value, float | np.floating) else value

    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([cell(value) for value in row] for row in rows)
    return write_bytes(path, text.getvalue().encode("utf-8"))


@dataclass(frozen=True)
class Frf:
    """The FRFs of one job: magnitudes in dB, phases in degrees, NaN for missing values.

    Attributes
    ----------
    frequency_hz : (F,) float array
    responses : mapping of response name to mapping of column to (F,) float array
        Columns ``measured_db``, ``measured_phase_deg``, ``initial_db``, ..., ``coherence``.
    """

    frequency_hz: Floats
    responses: Mapping[str, Mapping[str, Floats]]


@dataclass(frozen=True)
class Fdac:
    """FDAC maps before and after updating, (g, g): rows are measured lines, columns lines of the model; NaN if unknown."""

    frequency_hz: Floats
    initial: Floats
    updated: Floats


def read_frf(file: Path) -> Frf:
    """Read a table of measured, initial and updated FRFs.

    Raises
    ------
    DataError
        If it is missing or damaged.
    """
    table = _read(file)
    frequency = table.pop("frequency_hz", None)
    if frequency is None or not len(frequency):
        raise _damaged(file, expected="a column frequency_hz with at least one line")
    responses: dict[str, dict[str, Floats]] = {}
    for column, values in table.items():
        for suffix in FRF_COLUMNS:
            if column.endswith("_" + suffix):
                responses.setdefault(column[: -len(suffix) - 1], {})[suffix] = values
                break
    return Frf(frequency, responses)


def read_fdac(file: Path) -> Fdac | None:
    """Read ``fdac.csv``; None if there is no such file or it holds no map.

    Raises
    ------
    DataError
        If it is damaged.
    """
    if not file.exists():
        return None
    table = _read(file)
    columns = ("measured_hz", "model_hz", "initial", "updated")
    measured, model, initial, updated = (table.get(name, np.empty(0)) for name in columns)
    frequency = np.unique(measured)
    size = len(frequency)
    whole = set(columns) <= set(table) and len(measured) == size**2
    if not whole or not np.array_equal(measured, np.repeat(frequency, size)) or not np.array_equal(model, np.tile(frequency, size)):
        found = f"{len(measured)} rows of {', '.join(table)}"[:100]
        raise _damaged(file, expected=f"columns {', '.join(columns)} with every pair of lines", found=found)
    if size < 2 or not np.isfinite(initial).any():
        return None
    return Fdac(frequency, initial.reshape(size, size), updated.reshape(size, size))


def require_files(folder: Path, hashes: Mapping[str, str]) -> None:
    """Refuse tables that were not written with the result beside them, so that two runs are not shown as one.

    Parameters
    ----------
    folder
        Folder of the job.
    hashes
        SHA-256 by file name, as the result states them.

    Raises
    ------
    DataError
        If a file is missing or differs.
    """
    hint = "files of two runs are mixed, or the file was changed: run `lrbc update` to identify this job again"
    for name, digest in hashes.items():
        file = folder / name
        if Path(name).name != name or name in ("", ".", ".."):
            raise DataError("this result file is damaged", file=folder / "result.json", place="provenance.files", found=name, hint=HINT)
        found = hashlib.sha256(_content(file)).hexdigest()
        if found != digest:
            problem = "this file was not written with the result.json beside it"
            raise DataError(problem, file=file, expected=f"SHA-256 {digest}", found=f"SHA-256 {found}", hint=hint)


def _read(file: Path) -> dict[str, Floats]:
    """Columns of a CSV file of numbers by the names in its header line; empty cells become NaN."""
    content = _content(file)
    return dict(_tables.of(content, lambda: _columns(file, content)))


def _content(file: Path) -> bytes:
    try:
        return regular_bytes(file)
    except FileNotFoundError:
        raise DataError("this result file is missing", file=file, hint=HINT) from None
    except OSError as error:
        raise DataError(f"this result file cannot be read: {error.strerror}", file=file, hint=HINT) from None


def _columns(file: Path, content: bytes) -> dict[str, Floats]:
    try:
        lines = content.decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise _damaged(file, f"byte {error.start}", "UTF-8 text") from None
    header = [name.strip() for name in lines[0].split(",")] if lines else []
    if len(set(header)) != len(header) or not all(header):
        raise _damaged(file, "line 1", "distinct column names")
    values = np.empty((0, 0))
    with suppress(ValueError):
        if any(line.strip() for line in lines[1:]):
            values = np.loadtxt(lines[1:], delimiter=",", ndmin=2, comments=None)
    if values.shape[1] != len(header):
        values = _with_gaps(file, lines, len(header))
    columns = np.ascontiguousarray(values.T)
    columns.flags.writeable = False
    return dict(zip(header, columns, strict=True))


def _with_gaps(file: Path, lines: Sequence[str], columns: int) -> Floats:
    """Rows of numbers in which cells may be empty (NaN); a wrong cell raises an error that names its line."""
    rows = []
    for count, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != columns:
            raise _damaged(file, f"line {count}", f"{columns} cells", len(cells))
        try:
            rows.append([float(cell) if cell.strip() else np.nan for cell in cells])
        except ValueError as error:
            raise _damaged(file, f"line {count}", "numbers", str(error)[:80]) from None
    return np.array(rows, dtype=float).reshape(len(rows), columns)


def _damaged(file: Path, place: str | None = None, expected: object = None, found: object = None) -> DataError:
    return DataError("this result file is damaged", file=file, place=place, expected=expected, found=found, hint=HINT)
