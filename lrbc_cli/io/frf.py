"""Reads and writes FRF and coherence files: the entry point to the readers of all formats, which are recognised by content."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from lrbc_cli.arrays import Floats
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.common import FileFormat, head, recognised, require_file
from lrbc_cli.io.hdf5.frf import named_hdf5, read_frf_hdf5, write_frf_hdf5
from lrbc_cli.io.hdf5.tools import is_hdf5
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.matlab.frf import named_mat
from lrbc_cli.io.matlab.variables import is_mat5
from lrbc_cli.io.named import Named, coherences, frf_set
from lrbc_cli.io.npz.archive import is_npz
from lrbc_cli.io.npz.frf import named_npz
from lrbc_cli.io.npz.others import other_archive
from lrbc_cli.io.text.frf import read_frf_text, read_text_coherence, write_frf_csv
from lrbc_cli.io.uff.datasets import is_uff
from lrbc_cli.io.uff.read import read_uff, read_uff_coherence
from lrbc_cli.io.uff.write import write_uff
from lrbc_cli.model.frf import FrfSet

__all__ = ["FORMATS", "WRITERS", "CoherenceKey", "TextLayout", "detect_frf_format", "read_coherence", "read_frf", "write_frf"]

#: Name of a record, or (node, direction) of its response.
CoherenceKey = str | tuple[int, int]

#: Keys of one coherence, its frequencies [Hz] and its values, both (F,).
CoherenceEntry = tuple[tuple[CoherenceKey, ...], Floats, Floats]
CoherenceReader = Callable[[Path, TextLayout], list[CoherenceEntry]]


@dataclass(frozen=True)
class FrfFormat(FileFormat):
    """A format of FRF files: the reader of all FRFs of a file, and that of all coherences."""

    read: Callable[[Path, TextLayout], FrfSet]
    coherences: CoherenceReader


def _keys(name: str, node: int | None, direction: int) -> tuple[CoherenceKey, ...]:
    return (*([name] if name else []), *([(node, direction)] if node else []))


def _by_name(found: dict[str, tuple[Floats, Floats]]) -> list[CoherenceEntry]:
    return [((name,), *pair) for name, pair in found.items()]


def _of_functions(path: Path, _: TextLayout) -> list[CoherenceEntry]:
    return [(_keys(c.name, *c.dof[:2]), c.frequency_hz, c.values) for c in read_uff_coherence(path)]


def _of_arrays(named: Callable[[Path], Named]) -> Callable[[Path, TextLayout], FrfSet]:
    """Reader of the FRFs among the arrays of a file."""
    return lambda path, layout: frf_set(named(path), path, layout)


def _among_arrays(read: Callable[[Path, TextLayout], FrfSet], named: Callable[[Path], Named]) -> CoherenceReader:
    """Reader of the coherences that belong to FRFs of a file, or, if it has no FRFs, of its arrays called coherence."""

    def coherence(path: Path, layout: TextLayout) -> list[CoherenceEntry]:
        try:
            records = read(path, layout).records
        except DataError:
            if found := coherences(named(path), path, layout):
                return _by_name(found)
            raise
        known = [(r, r.coherence) for r in records if r.coherence is not None]
        return [(_keys(r.name, r.response_node, r.response_direction), r.frequency_hz, values) for r, values in known]

    return coherence


#: Formats by their names, in the order of the checks; a new format is a module and a line here.
FORMATS = {
    format.name: format
    for format in (
        FrfFormat("hdf5", lambda path, _: is_hdf5(path), read_frf_hdf5, _among_arrays(read_frf_hdf5, named_hdf5)),
        FrfFormat("mat-v5", lambda _, start: is_mat5(start), _of_arrays(named_mat), _among_arrays(_of_arrays(named_mat), named_mat)),
        FrfFormat("npz", lambda _, start: is_npz(start), _of_arrays(named_npz), _among_arrays(_of_arrays(named_npz), named_npz)),
        FrfFormat("uff", lambda _, start: is_uff(start), read_uff, _of_functions),
        FrfFormat(
            "text", lambda _, start: _is_text(start), read_frf_text, lambda path, layout: _by_name(read_text_coherence(path, layout))
        ),
    )
}

#: First bytes of other files that measurement programs write, to name them in the error.
_FOREIGN = {
    b"PK\3\4": "an Excel workbook or a zip archive",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook or another compound document",
    b"TDSm": "a TDMS file (time histories of LabVIEW, FlexLogger)",
    b"RIFF": "a sound file",
    b"%%MatrixMarket": "a matrix, in the format Matrix Market",
}


def _foreign(path: Path, start: bytes) -> tuple[str | None, str]:
    archive = other_archive(path, start)
    if archive is not None:
        return archive.program, archive.frf
    known = next((text for mark, text in _FOREIGN.items() if start.startswith(mark)), None)
    return known, "export one of these; a universal file is the best choice"


def _is_text(start: bytes) -> bool:
    return not start.startswith(tuple(_FOREIGN)) and (b"\0" not in start or start[:2] in (b"\xff\xfe", b"\xfe\xff"))


#: Writer by the file's ending.
WRITERS: dict[str, Callable[[Path, FrfSet], None]] = {
    ".csv": write_frf_csv,
    ".uff": write_uff,
    ".unv": write_uff,
    ".h5": write_frf_hdf5,
    ".hdf5": write_frf_hdf5,
}


def detect_frf_format(path: Path) -> str:
    """Format of an FRF file (a key of ``FORMATS``), recognised by its content.

    Raises
    ------
    DataError
        If the file cannot be read or its content is in none of these formats.
    """
    require_file(path)
    expected = "a universal file (dataset 58), CSV or other text, HDF5, MATLAB or NumPy (.npz)"
    return recognised(FORMATS.values(), path, head(path, 4096), expected, _foreign).name


def read_frf(path: Path, layout: TextLayout | None = None) -> FrfSet:
    """Read all FRFs of a measurement file, converted to SI, signs applied.

    Parameters
    ----------
    path
        Universal file (58, 58b), CSV or other text, HDF5, MATLAB or ``.npz`` of NumPy.
    layout
        What the file does not state itself; ``unit`` and ``quantity`` apply to every format.

    Raises
    ------
    DataError
        If the file is missing or damaged, holds no FRF, or a value or frequency is wrong.
    """
    path = Path(path)
    found = FORMATS[detect_frf_format(path)].read(path, layout or TextLayout())
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


def read_coherence(path: Path, layout: TextLayout | None = None) -> dict[CoherenceKey, tuple[Floats, Floats]]:
    """Read all coherence functions of a file.

    Parameters
    ----------
    path
        Universal file with functions of type 6, HDF5, MATLAB, ``.npz`` of NumPy, or text with one column for each coherence.
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
    path = Path(path)
    found: dict[CoherenceKey, tuple[Floats, Floats]] = {}
    shared: set[CoherenceKey] = set()
    entries = list(FORMATS[detect_frf_format(path)].coherences(path, layout or TextLayout()))
    for keys, frequency, values in entries:
        shared.update(key for key in keys if key in found)
        found.update(dict.fromkeys(keys, (frequency, values)))
    result = {key: value for key, value in found.items() if key not in shared}
    if not result:
        raise DataError(
            "the coherences in the file cannot be distinguished" if entries else "the file contains FRFs, but no coherence",
            file=path,
            expected="names or nodes that differ" if entries else "coherences beside the FRFs, called coherence, coh or similar",
            found=f"{len(entries)} functions",
            hint="give them names" if entries else "set 'format: {coherence: ...}' of the job to the variable that contains them",
        )
    return result
