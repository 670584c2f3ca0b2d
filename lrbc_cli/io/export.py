"""Writes a tree of arrays and texts (the exported reduced model) for other programs: HDF5 or MATLAB v5, by the ending of the file.

HDF5: groups carry ``encoding-type`` = ``dict`` and datasets ``array``, ``string-array``, ``string`` or ``numeric-scalar``, each with an
``encoding-version``; that of the root names the kind of tree. MATLAB: groups are structures, lists of texts cells, vectors columns.
"""

from __future__ import annotations

import io
import mmap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

from lrbc_cli.errors import ConfigError
from lrbc_cli.io.atomic import atomic_write
from lrbc_cli.io.hdf5.tools import SIGNATURE, hdf5_image

VERSION = "0.1.0"


def write_export(path: Path, tree: Mapping[str, Any], encoding: str) -> None:
    """Write a tree to a file; an existing file is replaced as a whole.

    Parameters
    ----------
    path : Path
        Its ending selects the format.
    tree : mapping
        Values are mappings, real or complex arrays, text arrays with one axis, texts, numbers or booleans.
    encoding : str
        Kind of tree: ``encoding-type`` of the root.

    Raises
    ------
    ConfigError
        If the ending is not known.
    OSError
        If the file cannot be written; an existing file is then kept.
    """
    image = FORMATS[check_ending(path)].image(tree, encoding)
    with atomic_write(path, "wb") as stream:
        stream.write(image)


def is_export(path: Path, encoding: str) -> bool:
    """Whether a file is an export of this kind, which may be replaced; False if it does not exist or cannot be read."""
    try:
        if not path.is_file():
            return False
        return FORMATS[check_ending(path)].is_own(path, encoding)
    except Exception:
        # Libraries raise errors of many kinds on damaged files; such a file counts as foreign and is not replaced.
        return False


def check_ending(path: Path) -> str:
    """Ending of a file in lower case.

    Raises
    ------
    ConfigError
        If it is not known.
    """
    ending = path.suffix.lower()
    if ending not in FORMATS:
        raise ConfigError(
            "this file ending is not known for an exported model",
            file=path,
            place="--export",
            expected=", ".join(FORMATS),
            found=path.suffix or "none",
        )
    return ending


def _hdf5(tree: Mapping[str, Any], encoding: str) -> bytes:
    def fill(node: h5py.Group, part: Mapping[str, Any], kind: str) -> None:
        node.attrs["encoding-type"], node.attrs["encoding-version"] = kind, VERSION
        for name, value in part.items():
            if isinstance(value, Mapping):
                fill(node.create_group(name), value, "dict")
                continue
            array = np.asarray(value)
            if array.dtype.kind == "U":
                kind_of, dtype = ("string-array" if array.ndim else "string"), h5py.string_dtype("utf-8")
                data: Any = array.astype(object) if array.ndim else str(value)
                dataset = node.create_dataset(name, shape=array.shape, data=data if array.size else None, dtype=dtype, track_times=False)
            else:
                kind_of = "array" if array.ndim else "numeric-scalar"
                dataset = node.create_dataset(name, data=array, track_times=False)
            dataset.attrs["encoding-type"], dataset.attrs["encoding-version"] = kind_of, VERSION

    return hdf5_image(lambda file: fill(file, tree, encoding))


def _mat5(tree: Mapping[str, Any], encoding: str) -> bytes:
    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {name: plain(item) for name, item in value.items()}
        array = np.asarray(value)
        if array.dtype.kind == "U" and array.ndim:
            cell = np.empty((array.size, 1), dtype=object)
            cell[:, 0] = array.tolist()
            return cell
        return value if array.dtype.kind == "U" else array

    stream = io.BytesIO()
    content = {"encoding_type": encoding, "encoding_version": VERSION} | plain(tree)
    scipy.io.savemat(stream, content, long_field_names=True, do_compression=True, oned_as="column")
    return stream.getvalue()


def _is_own_hdf5(path: Path, encoding: str) -> bool:
    # HDF5 stores texts as plain bytes, so a search is enough and the library need not open a foreign file.
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return content[:8] == SIGNATURE and content.find(encoding.encode()) >= 0


def _is_own_mat5(path: Path, encoding: str) -> bool:
    return str(np.squeeze(scipy.io.loadmat(path, variable_names=["encoding_type"])["encoding_type"])) == encoding


@dataclass(frozen=True)
class ExportFormat:
    """Writer and recogniser of one file format.

    Attributes
    ----------
    image : callable
        Maps a tree and its encoding to the bytes of a file.
    is_own : callable
        Whether a file holds a tree of an encoding; may raise any error on a damaged file.
    """

    image: Callable[[Mapping[str, Any], str], bytes]
    is_own: Callable[[Path, str], bool]


_HDF5, _MAT5 = ExportFormat(_hdf5, _is_own_hdf5), ExportFormat(_mat5, _is_own_mat5)

#: Format by the ending of the file; a new format is a line here.
FORMATS = {".h5": _HDF5, ".hdf5": _HDF5, ".mat": _MAT5}
