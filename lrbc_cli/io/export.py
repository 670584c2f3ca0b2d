"""A tree of arrays and texts for other programs: HDF5 or MATLAB v5, by the file's ending.

HDF5: groups carry ``encoding-type`` = ``dict`` and datasets ``array``, ``string-array``, ``string`` or ``numeric-scalar``, each with an
``encoding-version``; the root says what the tree is. MATLAB: groups are structures, lists of texts cells, vectors columns.
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
    """Write a tree; the file is replaced as a whole.

    Parameters
    ----------
    path : Path
        Its ending says the format.
    tree : mapping
        Of mappings, of real or complex arrays, of text arrays (one axis), of texts, numbers and booleans.
    encoding : str
        What the tree is: ``encoding-type`` of the file.

    Raises
    ------
    ConfigError
        If the ending is not known.
    OSError
        If the file cannot be written; an earlier file is kept then.
    """
    image = FORMATS[check_ending(path)].image(tree, encoding)
    with atomic_write(path, "wb") as stream:
        stream.write(image)


def is_export(path: Path, encoding: str) -> bool:
    """Whether a file is an earlier export; False where there is none, or it cannot be read."""
    try:
        if not path.is_file():
            return False
        return FORMATS[check_ending(path)].is_own(path, encoding)
    except Exception:
        # Libraries answer damage with errors of many kinds; a damaged file is somebody else's all the same.
        return False


def check_ending(path: Path) -> str:
    """The ending, in lower case.

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
    # Texts stand in the file as they are: what HDF5 makes of a foreign file need not be known.
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return content[:8] == SIGNATURE and content.find(encoding.encode()) >= 0


def _is_own_mat5(path: Path, encoding: str) -> bool:
    return str(np.squeeze(scipy.io.loadmat(path, variable_names=["encoding_type"])["encoding_type"])) == encoding


@dataclass(frozen=True)
class ExportFormat:
    """How a tree is written, and how a file with such a tree is known.

    Attributes
    ----------
    image : callable
        From a tree and its encoding to the content of a file.
    is_own : callable
        Whether a file holds a tree of an encoding; raises what it likes where it is damaged.
    """

    image: Callable[[Mapping[str, Any], str], bytes]
    is_own: Callable[[Path, str], bool]


_HDF5, _MAT5 = ExportFormat(_hdf5, _is_own_hdf5), ExportFormat(_mat5, _is_own_mat5)

#: By the ending of the file: a further format is a line here.
FORMATS = {".h5": _HDF5, ".hdf5": _HDF5, ".mat": _MAT5}
