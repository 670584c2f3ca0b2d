"""Parses MATLAB files up to version 7 (level 5): numeric and sparse arrays, and texts.

Arrays in fields of structures are named ``name.field``. The format is that of "MAT-File Format", MathWorks; it is parsed here, because the
reader of scipy (1.17) ends the whole process on some damaged files.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import issparse

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import check_allocation, damaged, require_file
from lrbc_cli.io.sparse import MatrixFile, canonical, from_compressed, no_such_matrix, only_matrix

_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_KINDS = {1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 6: "double", 7: "single", 16: "function", 17: "opaque"} | {
    8 + 2 * index + unsigned: f"{'u' * unsigned}int{8 << index}" for index in range(4) for unsigned in (0, 1)
}
_NUMERIC = {"double", "single", *(kind for kind in _KINDS.values() if "int" in kind)}
# Bytes unpacked for array flags, dimensions and name, which precede the values of a variable.
_PREFIX_BYTES = 4096

#: Most bytes of the texts of one variable.
_MOST_TEXT = 2**20

#: Most structures in one array.
_MOST_STRUCTURES = 1000

#: Most levels of nested structures.
_DEEPEST = 4


@dataclass(frozen=True, kw_only=True)
class _Variable:
    name: str
    shape: tuple[int, ...]
    kind: str
    is_complex: bool
    order: str
    compressed: bool
    element: bytes
    values_at: int
    unpacked: int


def is_mat5(start: bytes) -> bool:
    """Whether the first bytes of a file are the header of a MATLAB level 5 file."""
    return start[:6] == b"MATLAB" and start[7:10] != b"7.3" and start[126:128] in (b"IM", b"MI")


def list_variables(path: Path, elements: bool = False) -> list[tuple[str, tuple[int, ...], str]]:
    """Name, shape and class of every variable, without its values; with `elements` also ``name(1).field`` in arrays of structures.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    return [(variable.name, variable.shape, variable.kind) for variable in _variables(path, elements)]


def load_variables(path: Path, names: list[str], elements: bool = False) -> dict[str, Any]:
    """Values of numeric variables: dense arrays as stored, sparse ones as checked ``csc_array``.

    Raises
    ------
    DataError
        If the file is damaged or states more data than it can hold.
    """
    found = {}
    wanted = [variable for variable in _variables(path, elements) if variable.name in names]
    packed = [variable for variable in wanted if variable.compressed]
    # Checked in sum, since many variables may each stay below the limit.
    total = sum(variable.unpacked for variable in packed)
    check_allocation(total, sum(len(variable.element) for variable in packed), path, ", ".join(v.name for v in packed), compressed=True)
    for variable in wanted:
        with damaged(path, "MATLAB variable", variable.name):
            found[variable.name] = _values(variable, path)
    return found


def load_texts(path: Path) -> dict[str, tuple[str, ...]]:
    """Texts of every variable with any: rows of characters, or cells of texts.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    found = {}
    for variable in _variables(path, elements=True):
        if variable.kind in ("char", "cell") and 0 not in variable.shape and variable.unpacked <= _MOST_TEXT:
            with damaged(path, "MATLAB variable", variable.name):
                texts = _cells(variable) if variable.kind == "cell" else _rows_of_text(variable)
                if texts:
                    found[variable.name] = texts
    return found


def _cells(variable: _Variable) -> tuple[str, ...]:
    """Texts of a cell array; empty if a cell holds anything else."""
    data, order, position = _plain(variable), variable.order, variable.values_at
    texts: list[str] = []
    for _ in range(math.prod(variable.shape)):
        kind, count = struct.unpack_from(order + "II", data, position)
        inner = _describe(data[position + 8 : position + 8 + count], False, order, variable.name) if kind == _MATRIX and count else None
        if inner is None or inner.kind != "char":
            return ()
        texts.append("".join(_rows_of_text(inner)[:1]))
        position += 8 + count + -count % 8
    return tuple(texts)


def _rows_of_text(variable: _Variable) -> tuple[str, ...]:
    """Rows of an array of characters."""
    data, order = _plain(variable), variable.order
    kind, size = struct.unpack_from(order + "II", data, variable.values_at)
    start = variable.values_at + 8
    if kind >> 16:
        kind, size, start = kind & 0xFFFF, kind >> 16, variable.values_at + 4
    wide = {4: "utf-16", 17: "utf-16", 18: "utf-32"}.get(kind)
    encoding = f"{wide}-{'le' if order == '<' else 'be'}" if wide else "utf-8" if kind == 16 else "latin-1"
    text = data[start : start + size].decode(encoding, "replace")
    rows, columns = variable.shape[0], math.prod(variable.shape[1:])
    if rows == 1 or len(text) != rows * columns:
        return (text.strip(),)
    return tuple("".join(text[row::rows]).strip() for row in range(rows))


def _plain(variable: _Variable) -> bytes:
    """Unpacked element of a variable."""
    return _unpack(variable.element, 8 + variable.unpacked)[8:] if variable.compressed else variable.element


def read_mat5_matrix(path: Path, group: str | None = None) -> MatrixFile:
    """Read one sparse or dense matrix.

    Parameters
    ----------
    path
        The file.
    group
        Name of the variable; may be None if the file holds exactly one matrix.

    Raises
    ------
    DataError
        If the file is damaged, or the variable is missing or not a matrix.
    """
    variables = list_variables(path)
    names = _matrices_of(variables)
    notes: list[str] = []
    if not group:
        group = only_matrix(names, path, notes, beside=[f"{name} ({kind})" for name, _, kind in variables], hint=None)
    if group not in names:
        raise no_such_matrix(group, names, path)
    value = load_variables(path, [group])[group]
    if not issparse(value):
        notes.append(f"{group!r} is stored dense")
        value = canonical(value, path, group)
    return MatrixFile(matrix=value, format="mat-v5", notes=tuple(notes))


def mat5_matrix_names(path: Path) -> list[str]:
    """Names of the sparse and dense matrices of a file.

    Raises
    ------
    DataError
        If the file is damaged.
    """
    return _matrices_of(list_variables(path))


def _matrices_of(variables: list[tuple[str, tuple[int, ...], str]]) -> list[str]:
    # Arrays of whole numbers are indices and maps, not matrices.
    return [name for name, shape, kind in variables if kind in ("sparse", "double", "single") and len(shape) == 2]


def _variables(path: Path, elements: bool = False) -> list[_Variable]:
    require_file(path)
    content = path.read_bytes()
    if not is_mat5(content):
        raise DataError("this is not a MATLAB level 5 file", file=path, expected="a header 'MATLAB 5.0 MAT-file'", found=repr(content[:20]))
    order = "<" if content[126:128] == b"IM" else ">"
    variables = []
    with damaged(path, "MATLAB file"):
        for element, compressed in _elements(content, order, path):
            variable = _describe(element, compressed, order)
            if variable is not None:
                variables += [variable, *_fields(variable, path, elements)]
    return variables


def _fields(variable: _Variable, path: Path, elements: bool, depth: int = 1) -> Iterator[_Variable]:
    """Variables in the fields of a structure; with `elements` also those of each structure of an array."""
    count = math.prod(variable.shape) if variable.kind == "struct" else 0
    if depth > _DEEPEST or not (count == 1 or (elements and 1 < count <= _MOST_STRUCTURES)):
        return
    order = variable.order
    if variable.compressed:
        check_allocation(variable.unpacked, len(variable.element), path, variable.name, compressed=True)
    data = _plain(variable)
    width, position = _read_element(data, variable.values_at, order)
    names, position = _read_element(data, position, order)
    size = int(width[0])
    if size <= 0:
        raise ValueError(f"field names of {size} characters")
    called = [bytes(names[k : k + size].tobytes()).split(b"\0")[0].decode("latin-1") for k in range(0, names.size, size)]
    for at, name in ((at, name) for at in range(count) for name in called):
        kind, length = struct.unpack_from(order + "II", data, position)
        element = data[position + 8 : position + 8 + length]
        if kind != _MATRIX or len(element) < length:
            raise ValueError(f"a field of {variable.name} is not an array")
        position += 8 + length + -length % 8
        owner = variable.name if count == 1 else f"{variable.name}({at + 1})"
        found = _describe(element, False, order, f"{owner}.{name}") if length else None
        if found is not None:
            yield found
            yield from _fields(found, path, elements, depth + 1)


def _elements(content: bytes, order: str, path: Path) -> Iterator[tuple[bytes, bool]]:
    """Yield each variable of the file: its element, or its packed bytes, and whether they are compressed."""
    position = _HEADER_BYTES
    while position + 8 <= len(content):
        kind, size = struct.unpack_from(order + "II", content, position)
        start = position + 8
        if start + size > len(content):
            place = f"byte {position}"
            hint = "the file is truncated; export it again"
            raise DataError(
                "a variable is cut off", file=path, place=place, expected=f"{size} bytes", found=f"{len(content) - start} bytes", hint=hint
            )
        if kind in (_MATRIX, _COMPRESSED):
            yield content[start : start + size], kind == _COMPRESSED
        position = start + size + (-size % 8 if kind != _COMPRESSED else 0)


def _describe(element: bytes, compressed: bool, order: str, called: str = "") -> _Variable | None:
    """Name, shape and class from the first bytes of a variable; `called` names a field, which has no name itself. None without a name."""
    start = zlib.decompressobj().decompress(element, _PREFIX_BYTES) if compressed else element[:_PREFIX_BYTES]
    unpacked = len(element)
    if compressed:
        kind, unpacked = struct.unpack_from(order + "II", start)
        if kind != _MATRIX:
            return None
        start = start[8:]
    if not start:
        return None
    flags, position = _read_element(start, 0, order)
    dimensions, position = _read_element(start, position, order)
    name, position = _read_element(start, position, order)
    code = int(flags[0])
    shape = tuple(int(n) for n in dimensions)
    if len(shape) < 2 or min(shape) < 0:
        raise ValueError(f"dimensions {shape}")
    text = called or name.astype(np.uint8).tobytes().decode("latin-1")
    return (
        _Variable(
            name=text,
            shape=shape,
            kind=_KINDS.get(code & 0xFF, "unknown"),
            is_complex=bool(code & 0x0800),
            order=order,
            compressed=compressed,
            element=element,
            values_at=position,
            unpacked=unpacked,
        )
        if text
        else None
    )


def _unpack(packed: bytes, size: int) -> bytes:
    """Unpack the stated number of bytes and no more than it takes to reach the checksum."""
    stream = zlib.decompressobj()
    data = stream.decompress(packed, size)
    stream.decompress(stream.unconsumed_tail, _PREFIX_BYTES)
    if not stream.eof:
        raise ValueError(f"the compressed data do not end after {size} bytes")
    return data


def _read_element(data: bytes, position: int, order: str) -> tuple[NDArray[Any], int]:
    """One numeric element and the offset of the next one; small elements hold their values in the tag."""
    kind, size = struct.unpack_from(order + "II", data, position)
    start, step = position + 8, 8 + size + -size % 8
    if kind >> 16:
        kind, size, start, step = kind & 0xFFFF, kind >> 16, position + 4, 8
    if kind not in _TYPES:
        raise ValueError(f"unknown data type {kind}")
    dtype = np.dtype(order + _TYPES[kind])
    if (step == 8 and size > 4) or start + size > len(data) or size % dtype.itemsize:
        raise ValueError(f"an element of {size} bytes does not fit")
    return np.frombuffer(data, dtype, size // dtype.itemsize, start), position + step


def _values(variable: _Variable, path: Path) -> Any:
    data, position = _plain(variable), variable.values_at

    def next_array() -> NDArray[Any]:
        nonlocal position
        array, position = _read_element(data, position, variable.order)
        return array

    if variable.kind == "sparse":
        rows, pointers = next_array(), next_array()
        entries = int(pointers[-1]) if pointers.size else 0
        # MATLAB may reserve room after the last entry.
        values = _complex(next_array(), next_array() if variable.is_complex else None)[:entries]
        shape = (variable.shape[0], variable.shape[1])
        size = path.stat().st_size
        return from_compressed("csc", values, rows[:entries], pointers, shape, path=path, place=variable.name, file_size=size)
    if variable.kind not in _NUMERIC:
        raise DataError("this variable contains no numbers", file=path, place=variable.name, expected="a matrix", found=variable.kind)
    values = _complex(next_array(), next_array() if variable.is_complex else None)
    count = math.prod(variable.shape)
    if values.size != count:
        check_allocation(count, values.size, path, variable.name)
        raise DataError(
            "the array has the wrong length", file=path, place=variable.name, expected=f"{count} values", found=f"{values.size}"
        )
    return values.reshape(variable.shape, order="F")


def _complex(real: NDArray[Any], imaginary: NDArray[Any] | None) -> NDArray[Any]:
    if imaginary is None:
        return real.astype(real.dtype.newbyteorder("="))
    if real.size != imaginary.size:
        raise ValueError(f"{real.size} real parts, {imaginary.size} imaginary parts")
    values = np.empty(real.size, dtype=np.complex128)
    values.real, values.imag = real, imaginary
    return values
