"""FRFs in MATLAB files (level 5): a simple reader for the two usual ways to store them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import issparse

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import damaged, listing
from lrbc_cli.io.frf_common import check_frequencies, first_bad, not_finite, scaled
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.matlab.variables import list_variables, load_variables
from lrbc_cli.io.sparse import numeric
from lrbc_cli.model.frf import FrfRecord, FrfSet

_AXES = ("frequency_hz", "frequency", "freq", "f", "fhz", "f_hz", "freqs", "frequencies")


def read_frf_mat(path: Path, layout: TextLayout | None = None) -> FrfSet:
    """Read FRFs from variables of a MATLAB file.

    Either each variable is a matrix with the frequency in its first column and FRFs in the others, or one variable
    holds the frequencies (named in ``layout.frequency``, or ``f``, ``freq``, ``frequency`` and the like) and complex arrays
    have a row for each line. Records are called by the variable, with a number where it holds several.

    Raises
    ------
    DataError
        If neither is found, or a value is not finite.
    """
    layout = layout or TextLayout()
    variables = list_variables(path)
    names = [name for name, shape, kind in variables if kind in ("double", "single") and len(shape) == 2]
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in load_variables(path, names).items():
        with damaged(path, "MATLAB variable", name):
            if not issparse(value):
                arrays[name] = numeric(value, path, name)
    wanted = str(layout.frequency) if layout.frequency is not None else None
    axis = next((name for name in arrays if name == wanted or (wanted is None and name.lower() in _AXES and 1 in arrays[name].shape)), None)
    if wanted is not None and axis is None:
        raise DataError(
            "the variable of frequencies is not there", file=path, place="format.frequency", expected=wanted, found=listing(names)
        )
    records: list[FrfRecord] = []
    notes: list[str] = []
    if axis is not None:
        frequency = _real(arrays[axis].ravel(), path, axis)
        check_frequencies(frequency, path, axis)
        for name, array in arrays.items():
            if name == axis:
                continue
            columns = array if array.shape[0] == frequency.size else array.T if array.shape == (1, frequency.size) else None
            if columns is None or columns.dtype.kind != "c":
                notes.append(f"variable {name} left out: not complex with {frequency.size} rows")
            else:
                records += _records(name, frequency, columns, layout, path)
        notes.append(f"frequencies from variable {axis}")
    else:
        for name, array in arrays.items():
            if array.shape[1] < 2 or array.shape[0] < 2 or array.dtype.kind != "c":
                notes.append(f"variable {name} left out: not a complex matrix with the frequency in its first column")
                continue
            frequency = _real(array[:, 0], path, name)
            check_frequencies(frequency, path, f"{name}, column 1")
            records += _records(name, frequency, array[:, 1:], layout, path)
        notes.append("frequencies from the first column of each variable")
    if not records:
        raise DataError(
            "the file holds no FRF that is understood",
            file=path,
            expected="a complex matrix with the frequency in its first column, or a variable 'f' and complex arrays with as many rows",
            found=listing([f"{name} {shape} {kind}" for name, shape, kind in variables]),
            hint="export CSV or a universal file",
        )
    return FrfSet(str(path), tuple(records), tuple(notes))


def _real(values: NDArray[Any], path: Path, place: str) -> NDArray[np.float64]:
    if values.dtype.kind == "c" and np.any(values.imag != 0):
        raise DataError("the frequencies are complex", file=path, place=place, expected="real numbers", found="complex numbers")
    return np.array(values.real, dtype=np.float64)


def _records(name: str, frequency: NDArray[np.float64], columns: NDArray[Any], layout: TextLayout, path: Path) -> list[FrfRecord]:
    factor = layout.si_unit.factor if layout.si_unit is not None else 1.0
    records = []
    for index in range(columns.shape[1]):
        label = name if columns.shape[1] == 1 else f"{name}_{index + 1}"
        bad = first_bad(columns[:, index])
        if bad is not None:
            raise not_finite(path, f"{label}, row {bad + 1}", columns[bad, index])
        values = scaled(columns[:, index], factor, path, label)
        records.append(FrfRecord(label, frequency, values, layout.stated_quantity, place=f"variable {label}"))
    return records
