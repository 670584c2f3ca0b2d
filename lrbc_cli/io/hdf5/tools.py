"""Opens HDF5 files of unknown origin safely (links, sizes, damage), and builds new files with a checksum."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.io.common import SMALL_ALLOCATION, check_allocation, damaged, require_file
from lrbc_cli.io.reader_process import read_apart

T = TypeVar("T")

SIGNATURE = b"\x89HDF\r\n\x1a\n"

#: Marker after the content of our own files, followed by its SHA-256. Other programs ignore it, and the library removes it when a file is
#: opened for writing: a changed file then counts as a foreign one.
SEAL = b"\nlrbc-sha256:"
_SEAL_BYTES = len(SEAL) + 64 + 1

#: Most links that lead to further links: as many as file systems follow.
MOST_LINKS = 40

#: SHA-256 of files that are read in this process, see ``came_through``.
_KNOWN: set[str] = set()


def is_hdf5(path: Path) -> bool:
    """Whether a file has the HDF5 signature at one of the allowed offsets (0, 512, 1024, 2048, ...)."""
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
    """HDF5 file open for reading; any error inside the block becomes a DataError.

    The library may hang on a damaged file: see ``read_safely``.
    """
    require_file(path)
    with damaged(path, "HDF5 file"), h5py.File(path, "r") as file:
        yield file


def hdf5_image(fill: Callable[[h5py.File], None]) -> bytes:
    """Content of a new HDF5 file, built in memory.

    The HDF5 library may end the process if the disk is full. The caller writes the bytes instead, for which a full disk
    is a plain OSError.

    Parameters
    ----------
    fill
        Called with the open file.
    """
    # The library distinguishes files in memory by their names.
    with h5py.File(f"{uuid.uuid4().hex}.h5", "w", driver="core", backing_store=False, block_size=1 << 20) as file:
        fill(file)
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def fixed_texts(texts: Any) -> NDArray[np.bytes_]:
    """Texts as UTF-8 of a common fixed length: damaged texts of variable length can hang the library."""
    array = np.asarray(texts)
    raw = [str(text).encode("utf-8") for text in array.ravel().tolist()]
    dtype = h5py.string_dtype("utf-8", max([1, *map(len, raw)]))
    return np.array(raw, dtype=dtype).reshape(array.shape)


def sealed(image: bytes) -> bytes:
    """Content of a file followed by its checksum."""
    return image + SEAL + hashlib.sha256(image).hexdigest().encode("ascii") + b"\n"


def seal_fits(path: Path) -> bool | None:
    """Whether a file fits its checksum, as this package wrote it; None for files without a checksum.

    This finds accidental damage only; deliberate changes can include a new checksum.
    """
    size = path.stat().st_size - _SEAL_BYTES
    if size < 0:
        return None
    with path.open("rb") as stream:
        stream.seek(size)
        seal = stream.read(_SEAL_BYTES)
        if not seal.startswith(SEAL):
            return None
        stream.seek(0)
        digest = hashlib.sha256()
        while size > 0 and (part := stream.read(min(size, 1 << 20))):
            digest.update(part)
            size -= len(part)
    return size == 0 and seal == SEAL + digest.hexdigest().encode("ascii") + b"\n"


def came_through(digests: Iterable[str]) -> None:
    """Register files that the same version of the library has read completely before, so that it will not hang on them.

    Parameters
    ----------
    digests : iterable of str
        SHA-256 of the contents.
    """
    _KNOWN.update(digests)


def read_safely(reader: Callable[..., T], path: Path, *arguments: object) -> T:
    """Return ``reader(path, *arguments)``: evaluated in this process if the file fits its checksum or is registered, else in another.

    Parameters
    ----------
    reader
        A function of a module of this package, which opens the file with ``open_hdf5``.
    path
        The file.
    arguments
        Further arguments; they and the result must be picklable.

    Raises
    ------
    DataError
        If the reader raises it, the file does not fit its checksum, or the HDF5 library hangs or crashes on it.
    """
    require_file(path)
    fits = seal_fits(path)
    if fits is False:
        raise changed(path)
    known = fits or (_KNOWN and file_hash(path) in _KNOWN)
    return reader(path, *arguments) if known else read_apart(reader, path, *arguments)


def changed(path: Path) -> DataError:
    """Error for a file that does not fit its checksum."""
    return DataError(
        "this HDF5 file was damaged after it was written",
        file=path,
        expected="content that fits its checksum",
        found="other content",
        hint="write it again",
    )


def lookup(file: h5py.Group, name: str, path: Path) -> Any:
    """Object with a name inside this file; soft links are followed step by step.

    Raises
    ------
    KeyError
        If there is no such object.
    DataError
        If a link on the way leads into another file, or links lead in a circle.
    """
    node: Any = file
    steps = [part for part in name.split("/") if part]
    links = 0
    while steps:
        part = steps.pop(0)
        if part == ".":
            continue
        if not isinstance(node, h5py.Group) or not node.id.links.exists(part.encode()):
            raise KeyError(name)
        kind = node.id.links.get_info(part.encode()).type
        if kind == h5py.h5l.TYPE_HARD:
            node = node[part]
            continue
        links += 1
        if kind != h5py.h5l.TYPE_SOFT:
            raise DataError(
                "a link leads into another file", file=path, place=name, expected="data inside this file", found="an external link"
            )
        if links > MOST_LINKS:
            raise DataError("links lead in a circle", file=path, place=name, expected="data", found=f"more than {MOST_LINKS} links")
        target = node.id.links.get_val(part.encode()).decode("utf-8", "replace")
        steps = [step for step in target.split("/") if step] + steps
        if target.startswith("/"):
            node = node.file["/"]
    return node


def load(dataset: Any, path: Path) -> Any:
    """Read a whole dataset, after comparing its stated size with the bytes of the file.

    Raises
    ------
    DataError
        If it is no dataset, lies outside this file, or states more data than the file can hold.
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
    stored = min(int(dataset.id.get_storage_size()), path.stat().st_size)
    nominal = int(np.prod([float(n) for n in dataset.shape])) * dataset.dtype.itemsize
    if nominal > stored and nominal > SMALL_ALLOCATION // 64:
        check_allocation(nominal, stored, path, place, compressed=dataset.compression is not None or dataset.chunks is not None)
    return dataset[()]


def text_attribute(node: Any, name: str) -> str | None:
    """Attribute as text; None if it is missing or not a text."""
    value = node.attrs.get(name)
    if isinstance(value, bytes | np.bytes_):
        return value.decode("utf-8", "replace")
    return str(value) if isinstance(value, str) else None


def shape_attribute(node: Any, *names: str) -> tuple[int, int] | None:
    """First existing one of these attributes as (rows, columns); None if there is none."""
    for name in names:
        value = node.attrs.get(name)
        if value is not None:
            numbers = np.asarray(value).ravel()
            if numbers.size == 2 and numbers.dtype.kind in "iu":
                return int(numbers[0]), int(numbers[1])
    return None
