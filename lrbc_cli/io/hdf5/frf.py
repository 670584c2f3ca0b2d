"""FRFs in HDF5: reads and writes this package's own layout, and reads files of other origin by the names of their data sets.

In the own layout, the root of the file carries ``encoding-type`` = ``lrbc-frf`` and ``encoding-version``. It holds ``frequency_hz`` (F,),
``frf`` (F, n_out, n_in) complex in SI, optionally ``coherence`` of the same shape (NaN if unknown), and for the
outputs ``name``, ``quantity`` (empty if unknown), ``unit``, ``response_node`` (-1 if unknown), ``response_direction``, all
(n_out,), and for the inputs ``reference_node`` and ``reference_direction``, (n_in,) or (n_out, n_in).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.atomic import atomic_write
from lrbc_cli.io.frf_common import check_frequencies, clean_coherence, first_bad, not_finite, scaled
from lrbc_cli.io.hdf5.tools import fixed_texts, hdf5_image, load, lookup, open_hdf5, read_safely, sealed, text_attribute
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.named import Named, frf_set, named_arrays
from lrbc_cli.io.sparse import numeric
from lrbc_cli.model.frf import QUANTITIES, FrfRecord, FrfSet

ENCODING = "lrbc-frf"
VERSION = "0.1.0"
#: Limits for a file of unknown origin: number of objects, and levels of nested groups.
_MOST_OBJECTS, _DEEPEST = 20_000, 5
_UNITS = {"pressure": "Pa/N", "displacement": "m/N", "velocity": "m/s/N", "acceleration": "m/s^2/N", "": ""}


def read_frf_hdf5(path: Path, layout: TextLayout) -> FrfSet:
    """Read the FRFs of a file of ``write_frf_hdf5``, or of one of other origin by the names of its data sets, see ``io.named``.

    Parameters
    ----------
    path
        The file.
    layout
        For files of the own layout only ``unit`` and ``quantity`` apply.

    Raises
    ------
    DataError
        If the version is not known, no FRF is recognised, sizes differ, or a value is not finite.
    """
    return read_safely(_read, path, layout)


def _read(path: Path, layout: TextLayout) -> FrfSet:
    with open_hdf5(path) as file:
        kind, version = text_attribute(file, "encoding-type"), text_attribute(file, "encoding-version")
        if kind != ENCODING:
            return frf_set(_named(file, path), path, layout)
        if version != VERSION:
            raise DataError(
                "this HDF5 file contains no FRFs in a known layout",
                file=path,
                expected=f"encoding-type {ENCODING}, encoding-version {VERSION}",
                found=f"{kind or 'none'}, {version or 'none'}; it contains {listing(list(file))}",
            )
        frequency = numeric(_dataset(file, "frequency_hz", path), path, "frequency_hz")
        values = numeric(_dataset(file, "frf", path), path, "frf")
        if frequency.ndim != 1 or values.ndim != 3 or values.shape[0] != frequency.size or frequency.dtype.kind == "c":
            expected = "frequency_hz (F,) and frf (F, n_out, n_in)"
            raise DataError(
                "the arrays do not fit together", file=path, place="frf", expected=expected, found=f"{frequency.shape} and {values.shape}"
            )
        check_frequencies(frequency, path, "frequency_hz")
        _, n_out, n_in = values.shape
        names = _texts(file, "name", n_out, path)
        quantities = _texts(file, "quantity", n_out, path)
        response_node, response_direction = (_integers(file, f"response_{part}", (n_out, 1), path)[:, 0] for part in ("node", "direction"))
        reference_node, reference_direction = (_integers(file, f"reference_{part}", (n_out, n_in), path) for part in ("node", "direction"))
        coherence = numeric(_dataset(file, "coherence", path), path, "coherence") if "coherence" in file else None
    if coherence is not None and (coherence.shape != values.shape or coherence.dtype.kind == "c"):
        raise DataError("the arrays do not fit together", file=path, place="coherence", expected=values.shape, found=coherence.shape)
    unknown = [quantity for quantity in quantities if quantity and quantity not in QUANTITIES]
    if unknown:
        raise DataError("a quantity is not known", file=path, place="quantity", expected=", ".join(QUANTITIES), found=listing(unknown))
    factor = layout.si_unit.factor if layout.si_unit is not None else 1.0
    records = []
    for i in range(n_out):
        for j in range(n_in):
            place = f"output {i + 1} ({names[i]})" + (f", input {j + 1}" if n_in > 1 else "")
            bad = first_bad(values[:, i, j])
            if bad is not None:
                raise not_finite(path, f"{place}, line {bad + 1} ({frequency[bad]:.10g} Hz)", values[bad, i, j])
            quality = None
            if coherence is not None and not np.isnan(coherence[:, i, j]).all():
                quality, _ = clean_coherence(coherence[:, i, j], path, place)
            records.append(
                FrfRecord(
                    name=names[i],
                    frequency_hz=frequency,
                    values=scaled(values[:, i, j], factor, path, place),
                    quantity=layout.stated_quantity or quantities[i] or None,
                    response_node=_known(response_node[i]),
                    response_direction=int(response_direction[i]),
                    reference_node=_known(reference_node[i, j]),
                    reference_direction=int(reference_direction[i, j]),
                    coherence=quality,
                    place=place,
                )
            )
    if not records:
        raise DataError("the file contains no FRF", file=path, place="frf", expected="at least one output and input", found=values.shape)
    return FrfSet(source=str(path), records=tuple(records))


def named_hdf5(path: Path) -> Named:
    """Arrays and texts of an HDF5 file of any origin, such as MATLAB v7.3, by name.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    return read_safely(_read_named, path)


def _read_named(path: Path) -> Named:
    with open_hdf5(path) as file:
        return _named(file, path)


def _named(file: h5py.File, path: Path) -> Named:
    arrays: dict[str, NDArray[Any]] = {}
    texts: dict[str, tuple[str, ...]] = {}

    def attributes(node: Any, above: str, *known: str) -> None:
        for attribute in ("unit", "units", *known):
            values = np.ravel(node.attrs.get(attribute, ())).tolist()
            found = tuple(one.decode("utf-8", "replace") if isinstance(one, bytes) else one for one in values)
            if found and all(isinstance(one, str) for one in found):
                texts.setdefault(f"{above}{attribute}", found)

    def put(node: Any, name: str, depth: int) -> None:
        if len(arrays) + len(texts) >= _MOST_OBJECTS:
            # Reading only a part could miss a unit or a coherence.
            raise DataError(
                "the file contains more data sets than are read",
                file=path,
                place=name,
                expected=f"at most {_MOST_OBJECTS}",
                found="more",
                hint="export only the FRFs, with the responses as columns of one array",
            )
        if isinstance(node, h5py.Group):
            attributes(node, f"{name}.")
            if depth < _DEEPEST and "MATLAB_sparse" not in node.attrs:
                walk(node, f"{name}.", depth + 1)
        elif h5py.check_ref_dtype(node.dtype) and text_attribute(node, "MATLAB_class") != "cell":
            # A field of an array of structures, which MATLAB 7.3 stores field by field.
            owner, _, field = name.rpartition(".")
            for at, one in enumerate(np.asarray(load(node, path)).ravel().tolist()):
                put(file[one], f"{owner}({at + 1}).{field}", depth)
        elif "MATLAB_empty" not in node.attrs:
            _put(node, name, path, arrays, texts)
            attributes(node, f"{name}.", "name", "names")

    def walk(group: h5py.Group, above: str, depth: int) -> None:
        for key in group:
            # Internal objects of MATLAB begin with a hash.
            if not key.startswith("#"):
                put(lookup(group, key, path), f"{above}{key}", depth)

    attributes(file, "")
    walk(file, "", 0)
    return Named(arrays, texts)


def _put(node: Any, name: str, path: Path, arrays: dict[str, NDArray[Any]], texts: dict[str, tuple[str, ...]]) -> None:
    """Read one data set as numbers or texts; arrays of MATLAB are stored transposed."""
    kind = text_attribute(node, "MATLAB_class")
    values = np.asarray(load(node, path))
    if kind == "char":
        texts[name] = ("".join(map(chr, values.ravel().tolist())).strip(),)
    elif kind == "cell" and values.dtype == h5py.ref_dtype:
        cells = [np.asarray(load(node.file[one], path)) for one in values.T.ravel().tolist()[:_MOST_OBJECTS]]
        if all(cell.dtype.kind == "u" for cell in cells):
            texts[name] = tuple("".join(map(chr, cell.ravel().tolist())).strip() for cell in cells)
    else:
        found = named_arrays({name: values.T if kind is not None else values}, path)
        arrays.update(found.arrays)
        texts.update(found.texts)


def write_frf_hdf5(path: Path, frf: FrfSet) -> None:
    """Write FRFs in SI, one output for each record.

    Raises
    ------
    DataError
        If the records have different lines.
    """
    records = frf.records
    if not records:
        raise DataError("there is no FRF to write", file=path, expected="at least one", found="none")
    frequency = records[0].frequency_hz
    for record in records:
        if not np.array_equal(record.frequency_hz, frequency):
            found = f"{record.frequency_hz.size} lines in {record.name}, {frequency.size} in {records[0].name}"
            raise DataError(
                "this layout needs the same lines for every FRF", file=path, expected="one axis", found=found, hint="write .uff"
            )
    quantities = [record.quantity or "" for record in records]

    def fill(file: h5py.File) -> None:
        file.attrs["encoding-type"], file.attrs["encoding-version"] = np.bytes_(ENCODING), np.bytes_(VERSION)
        arrays: dict[str, NDArray[Any]] = {
            "frequency_hz": np.asarray(frequency, dtype=np.float64),
            "frf": np.stack([record.values for record in records], axis=1)[:, :, None],
            "response_node": _nodes([record.response_node for record in records]),
            "response_direction": np.array([record.response_direction for record in records]),
            "reference_node": _nodes([record.reference_node for record in records])[:, None],
            "reference_direction": np.array([record.reference_direction for record in records])[:, None],
        }
        if any(record.coherence is not None for record in records):
            missing = np.full(frequency.size, np.nan)
            parts = [missing if record.coherence is None else record.coherence for record in records]
            arrays["coherence"] = np.stack(parts, axis=1)[:, :, None]
        for name, array in arrays.items():
            file.create_dataset(name, data=array, track_times=False)
        for name, texts in (
            ("name", [record.name for record in records]),
            ("quantity", quantities),
            ("unit", [_UNITS[q] for q in quantities]),
        ):
            file.create_dataset(name, data=fixed_texts(texts), track_times=False)

    with atomic_write(path, "wb") as stream:
        stream.write(sealed(hdf5_image(fill)))


def _nodes(nodes: list[int | None]) -> NDArray[np.int64]:
    return np.array([-1 if node is None else node for node in nodes], dtype=np.int64)


def _known(node: np.int64) -> int | None:
    return int(node) if node >= 0 else None


def _dataset(file: h5py.File, name: str, path: Path) -> Any:
    try:
        return load(lookup(file, name, path), path)
    except KeyError:
        raise DataError("a dataset is missing", file=path, place=name, expected=repr(name), found=listing(list(file))) from None


def _texts(file: h5py.File, name: str, count: int, path: Path) -> list[str]:
    values = np.ravel(_dataset(file, name, path))
    texts = [value.decode("utf-8", "replace") if isinstance(value, bytes) else value for value in values.tolist()]
    if len(texts) != count or not all(isinstance(text, str) for text in texts):
        raise DataError("the arrays do not fit together", file=path, place=name, expected=f"{count} texts", found=f"{len(texts)} values")
    return texts


def _integers(file: h5py.File, name: str, shape: tuple[int, int], path: Path) -> NDArray[np.int64]:
    values = np.asarray(_dataset(file, name, path))
    fits = values.dtype.kind in "iu" and (values.shape == shape or values.shape == shape[:1] or values.shape == shape[1:])
    if not fits:
        expected = f"whole numbers, {shape}"
        raise DataError("the arrays do not fit together", file=path, place=name, expected=expected, found=f"{values.dtype}, {values.shape}")
    if values.shape == shape[:1] and shape[1] == 1:
        values = values[:, None]
    return np.broadcast_to(values, shape).astype(np.int64)
