"""Reads and writes FRF and coherence files: the entry point to the readers of all formats, which are recognised by content."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.common import head, require_file
from lrbc_cli.io.hdf5.frf import named_hdf5, read_frf_hdf5, write_frf_hdf5
from lrbc_cli.io.hdf5.tools import is_hdf5
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.matlab.frf import named_mat, read_frf_mat
from lrbc_cli.io.matlab.variables import is_mat5
from lrbc_cli.io.named import coherences
from lrbc_cli.io.text.frf import read_frf_text, read_text_coherence, write_frf_csv
from lrbc_cli.io.uff.datasets import is_uff
from lrbc_cli.io.uff.read import read_uff, read_uff_coherence
from lrbc_cli.io.uff.write import write_uff
from lrbc_cli.model.frf import FrfSet

__all__ = ["READERS", "WRITERS", "CoherenceKey", "TextLayout", "detect_frf_format", "read_coherence", "read_frf", "write_frf"]

#: Name of a record, or (node, direction) of its response.
CoherenceKey = str | tuple[int, int]

#: Reader of each format; a new format is a module, a line here and a line in ``detect_frf_format``.
READERS: dict[str, Callable[[Path, TextLayout], FrfSet]] = {
    "uff": read_uff,
    "hdf5": read_frf_hdf5,
    "mat-v5": read_frf_mat,
    "text": read_frf_text,
}

#: First bytes of other files that measurement programs write, to name them in the error.
_FOREIGN = {
    b"PK\3\4": "an Excel workbook or a zip archive",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook or another compound document",
    b"TDSm": "a TDMS file (time histories of LabVIEW, FlexLogger)",
    b"RIFF": "a sound file",
    b"%%MatrixMarket": "a matrix, in the format Matrix Market",
}

#: Writer by the file's ending.
WRITERS: dict[str, Callable[[Path, FrfSet], None]] = {
    ".csv": write_frf_csv,
    ".uff": write_uff,
    ".unv": write_uff,
    ".h5": write_frf_hdf5,
    ".hdf5": write_frf_hdf5,
}


def detect_frf_format(path: Path) -> str:
    """Format of an FRF file (a key of ``READERS``), recognised by its content.

    Raises
    ------
    DataError
        If the file cannot be read or its content is in none of these formats.
    """
    require_file(path)
    start = head(path, 4096)
    if is_hdf5(path):
        return "hdf5"
    if is_mat5(start):
        return "mat-v5"
    if is_uff(start):
        return "uff"
    known = next((text for mark, text in _FOREIGN.items() if start.startswith(mark)), None)
    if known is not None:
        expected = "a universal file (dataset 58), CSV or other text, HDF5 or MATLAB"
        raise DataError(f"this is {known}", file=path, expected=expected, found="no FRFs that can be read", hint="export one of these")
    if b"\0" not in start or start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "text"
    raise DataError(
        "the format of this file is not known",
        file=path,
        expected="a universal file (dataset 58), CSV or other text, HDF5 or MATLAB",
        found=f"binary data starting with {start[:8].hex(' ')}",
        hint="export a universal file or CSV",
    )


def read_frf(path: Path, layout: TextLayout | None = None) -> FrfSet:
    """Read all FRFs of a measurement file, converted to SI, signs applied.

    Parameters
    ----------
    path
        Universal file (58, 58b), CSV or other text, HDF5 in the package's own layout, or MATLAB v5.
    layout
        What the file does not state itself; ``unit`` and ``quantity`` apply to every format.

    Raises
    ------
    DataError
        If the file is missing or damaged, holds no FRF, or a value or frequency is wrong.
    """
    path = Path(path)
    found = READERS[detect_frf_format(path)](path, layout or TextLayout())
    records = [replace(record, number=record.number or at + 1, file=str(path)) for at, record in enumerate(found.records)]
    return replace(found, records=tuple(records))


def write_frf(path: Path, frf: FrfSet) -> None:
    """Write FRFs as CSV, universal file (dataset 58) or HDF5, by the ending of the file; an existing file is replaced as a whole.

    Raises
    ------
    ConfigError
        If the ending is not known.
    DataError
        If the format cannot hold these records.
    """
    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ConfigError("this file ending is not known for FRFs", file=path, expected=", ".join(WRITERS), found=path.suffix or "none")
    writer(path, frf)


def read_coherence(path: Path, layout: TextLayout | None = None) -> dict[CoherenceKey, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Read all coherence functions of a file.

    Parameters
    ----------
    path
        Universal file with functions of type 6, HDF5, MATLAB v5, or text with one column for each coherence.
    layout
        What the file does not state itself.

    Returns
    -------
    dict
        Frequencies [Hz] and coherences, both (F,), by name and, if the file states nodes, also by (node, direction). A key
        that several functions share is left out.

    Raises
    ------
    DataError
        If the file holds no coherence, a value lies outside 0 to 1, or no key is unique.
    """
    path, layout = Path(path), layout or TextLayout()
    kind = detect_frf_format(path)
    if kind == "text":
        return {name: pair for name, pair in read_text_coherence(path, layout).items()}
    if kind == "uff":
        entries = [(c.name, c.dof[:2], c.frequency_hz, c.values) for c in read_uff_coherence(path)]
    else:
        try:
            records = READERS[kind](path, layout).records
        except DataError:
            # The file may hold coherences only.
            found_named = coherences(named_mat(path) if kind == "mat-v5" else named_hdf5(path), path, layout)
            if not found_named:
                raise
            return {name: pair for name, pair in found_named.items()}
        entries = [
            (r.name, (r.response_node or 0, r.response_direction), r.frequency_hz, r.coherence) for r in records if r.coherence is not None
        ]
    found: dict[CoherenceKey, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    shared: set[CoherenceKey] = set()
    for name, (node, direction), frequency, values in entries:
        keys: list[CoherenceKey] = ([name] if name else []) + ([(node, direction)] if node else [])
        for key in keys:
            if key in found:
                shared.add(key)
            found[key] = (frequency, values)
    result = {key: value for key, value in found.items() if key not in shared}
    if not result:
        raise DataError(
            "the coherences in the file cannot be distinguished",
            file=path,
            expected="names or nodes that differ",
            found=f"{len(entries)} functions",
        )
    return result
