"""Opening HDF5 files of unknown origin with care, and building new ones."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import SMALL_ALLOCATION, check_allocation, damaged, require_file

SIGNATURE = b"\x89HDF\r\n\x1a\n"


def is_hdf5(path: Path) -> bool:
    """Whether the HDF5 signature stands at one of the places where it may (0, 512, 1024, 2048, ...)."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        offset = 0
        while offset + 8 <= size and offset <= 2**16:
            stream.seek(offset)
            if stream.read(8) == SIGNATURE:
                return True
            offset = 512 if offset == 0 else 2 * offset
    return False


@contextmanager
def open_hdf5(path: Path) -> Iterator[h5py.File]:
    """HDF5 file open for reading; whatever goes wrong with it inside the block becomes a DataError."""
    require_file(path)
    with damaged(path, "HDF5 file"), h5py.File(path, "r") as file:
        yield file


def hdf5_image(fill: Callable[[h5py.File], None]) -> bytes:
    """Content of a new HDF5 file, built in memory.

    The HDF5 library does not survive a disk that is full: it may end the process. Bytes are written by the caller,
    where a full disk is a plain OSError.

    Parameters
    ----------
    fill
        Called with the open file.
    """
    # The library tells files without a disk apart by their names.
    with h5py.File(f"{uuid.uuid4().hex}.h5", "w", driver="core", backing_store=False, block_size=1 << 20) as file:
        fill(file)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def lookup(file: h5py.Group, name: str, path: Path) -> Any:
    """Object of that name, inside this file.

    Raises
    ------
    DataError
        If there is none, or it is a link into another file.
    """
    node: Any = file
    for part in [part for part in name.split("/") if part]:
        if not isinstance(node, h5py.Group) or part not in node:
            raise KeyError(name)
        if isinstance(node.get(part, getlink=True), h5py.ExternalLink):
            raise DataError(
                "a link leads into another file", file=path, place=name, expected="data inside this file", found="an external link"
            )
        node = node[part]
    return node


def load(dataset: Any, path: Path, *, file_size: int | None = None) -> Any:
    """Read a dataset whole, after checking its claimed size against the bytes that are there.

    Raises
    ------
    DataError
        If it is no dataset, lies outside this file, or claims more than it can hold.
    """
    place = str(getattr(dataset, "name", "") or "").lstrip("/")
    if not isinstance(dataset, h5py.Dataset):
        raise DataError("this is not a dataset", file=path, place=place, expected="a dataset", found="a group")
    if dataset.external or dataset.is_virtual:
        raise DataError(
            "the dataset lies outside this file", file=path, place=place, expected="data inside this file", found="external storage"
        )
    if dataset.shape is None:
        return np.empty((0,))
    size = path.stat().st_size if file_size is None else file_size
    stored = min(int(dataset.id.get_storage_size()), size)
    nominal = int(np.prod([float(n) for n in dataset.shape])) * dataset.dtype.itemsize
    if nominal > stored and nominal > SMALL_ALLOCATION // 64:
        check_allocation(nominal, stored, path, place, compressed=dataset.compression is not None or dataset.chunks is not None)
    return dataset[()]


def text_attribute(node: Any, name: str) -> str | None:
    """Attribute as text; None where it is missing or no text."""
    value = node.attrs.get(name)
    if isinstance(value, bytes | np.bytes_):
        return value.decode("utf-8", "replace")
    return str(value) if isinstance(value, str) else None


def shape_attribute(node: Any, *names: str) -> tuple[int, int] | None:
    """First of these attributes as (rows, columns); None where none is there."""
    for name in names:
        value = node.attrs.get(name)
        if value is not None:
            numbers = np.asarray(value).ravel()
            if numbers.size == 2 and numbers.dtype.kind in "iu":
                return int(numbers[0]), int(numbers[1])
    return None
