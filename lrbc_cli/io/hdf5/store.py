"""Store of the cache (reduced models): nested dictionaries of arrays and plain values in HDF5, without pickles.

Every group and dataset carries ``encoding-type`` and ``encoding-version``; unknown ones are refused. A checksum follows the content and is
compared before the HDF5 library opens the file, since the library hangs on some damaged files.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lrbc_cli.errors import DataError
from lrbc_cli.io.atomic import atomic_path
from lrbc_cli.io.common import require_file
from lrbc_cli.io.hdf5.tools import changed, hdf5_image, load, lookup, open_hdf5, seal_fits, sealed, text_attribute

VERSION = "0.1.0"
_ROOT = "lrbc-store"
_KINDS = ("dict", "list", "array", "json")
_PLAIN = (str, int, float, bool, type(None))


def write_store(path: Path, tree: dict[str, Any]) -> None:
    """Write a tree to a file, which is replaced as a whole after it was read back and its structure compared.

    Parameters
    ----------
    path
        The file.
    tree
        Nested dictionaries with text keys; leaves are arrays (real, complex, integer or bool), text, numbers, bool, None, and lists of any
        of these.

    Raises
    ------
    TypeError, ValueError
        If the tree holds something else, or a key is empty or contains ``/``.
    DataError
        If the written file cannot be read back.
    OSError
        If the file cannot be written, for instance on a full disk; no partial file is left.
    """
    if not isinstance(tree, dict):
        raise TypeError(f"a store contains a dictionary, not {type(tree).__name__}")

    def fill(file: h5py.File) -> None:
        file.attrs["store"] = np.bytes_(_ROOT)
        _write_group(file, tree)

    with atomic_path(path) as temporary:
        temporary.write_bytes(sealed(hdf5_image(fill)))
        with open_hdf5(temporary) as file:
            _verify(file, tree, path)


def read_store(path: Path, keys: Collection[str] | None = None) -> dict[str, Any]:
    """Read a tree written by ``write_store``; tuples are returned as lists.

    Parameters
    ----------
    path
        The file.
    keys
        Entries of the tree to read, if they exist; None: all.

    Raises
    ------
    DataError
        If the file is damaged or was changed, is no such store, or has an unknown version.
    """
    require_file(path)
    fits = seal_fits(path)
    if fits is None:
        raise DataError(
            "this store cannot be read: it does not end with its checksum",
            file=path,
            expected="a file as this version writes it",
            found="a file that was truncated, changed or written by another program",
            hint="delete the file; it will be built again",
        )
    if not fits:
        raise changed(path)
    with open_hdf5(path) as file:
        if text_attribute(file, "store") != _ROOT:
            raise DataError(
                "this is not a store of this package",
                file=path,
                expected=f"attribute store = {_ROOT}",
                found=text_attribute(file, "store") or "none",
            )
        if keys is not None and text_attribute(file, "encoding-type") == "dict":
            return {key: _read(lookup(file, key, path), path) for key in keys if key in file}
        tree = _read(file, path)
    if not isinstance(tree, dict):
        raise DataError("this store contains no dictionary", file=path, expected="a dictionary", found=type(tree).__name__)
    return tree


def _mark(node: Any, kind: str) -> None:
    node.attrs["encoding-type"], node.attrs["encoding-version"] = np.bytes_(kind), np.bytes_(VERSION)


def _write_group(node: h5py.Group, tree: dict[str, Any]) -> None:
    _mark(node, "dict")
    for key, value in tree.items():
        if not isinstance(key, str) or not key or "/" in key or "\0" in key or key in (".", ".."):
            raise ValueError(f"a key of a store must be a text without '/', not {key!r}")
        _write(node, key, value)


def _write(parent: h5py.Group, key: str, value: Any) -> None:
    if isinstance(value, dict):
        _write_group(parent.create_group(key), value)
    elif isinstance(value, np.ndarray) or (isinstance(value, np.generic) and value.dtype.kind == "c") or isinstance(value, complex):
        _write_array(parent, key, np.asarray(value))
    elif isinstance(value, list | tuple) and not _is_plain(value):
        node = parent.create_group(key)
        _mark(node, "list")
        for index, item in enumerate(value):
            _write(node, str(index), item)
    else:
        value = value.item() if isinstance(value, np.generic) else value
        if not _is_plain(value):
            raise TypeError(f"a store cannot contain {type(value).__name__} ({key!r})")
        # json.dumps writes ASCII only.
        node = parent.create_dataset(key, data=np.bytes_(json.dumps(value)), track_times=False)
        _mark(node, "json")


def _write_array(parent: h5py.Group, key: str, array: Any) -> None:
    if array.dtype.kind not in "fiubc":
        raise TypeError(f"a store cannot contain an array of type {array.dtype} ({key!r})")
    _mark(parent.create_dataset(key, data=array, track_times=False), "array")


def _is_plain(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(_is_plain(item) for item in value)
    return isinstance(value, _PLAIN) and not isinstance(value, np.generic)


def _read(node: Any, path: Path) -> Any:
    kind, version = text_attribute(node, "encoding-type"), text_attribute(node, "encoding-version")
    place = str(node.name).lstrip("/")
    if kind not in _KINDS or version != VERSION:
        raise DataError(
            "this store was written in another layout",
            file=path,
            place=place or None,
            expected=f"one of {', '.join(_KINDS)}, version {VERSION}",
            found=f"{kind or 'none'}, version {version or 'none'}",
            hint="delete the file; it will be built again",
        )
    is_group = isinstance(node, h5py.Group)
    if is_group != (kind in ("dict", "list")):
        raise DataError("this store is damaged", file=path, place=place, expected=kind, found="a group" if is_group else "a dataset")
    if kind == "dict":
        return {key: _read(lookup(node, key, path), path) for key in node}
    if kind == "list":
        return [_read(lookup(node, str(index), path), path) for index in range(len(node))]
    value = load(node, path)
    if kind == "json":
        return json.loads(value)
    return np.asarray(value)


def _verify(node: Any, value: Any, path: Path) -> None:
    """Compare structure, shapes and types in the written file with the tree."""
    if isinstance(value, dict):
        if set(node) != set(value):
            raise DataError("the store could not be written", file=path, place=node.name, expected=sorted(value), found=sorted(node))
        for key, item in value.items():
            _verify(node[key], item, path)
    elif isinstance(value, np.ndarray) and (node.shape != value.shape or node.dtype != value.dtype):
        expected, found = f"{value.shape} {value.dtype}", f"{node.shape} {node.dtype}"
        raise DataError("the store could not be written", file=path, place=node.name, expected=expected, found=found)
