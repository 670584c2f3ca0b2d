"""Opens ``.npz`` archives of NumPy and SciPy of unknown origin safely: sizes, damage, and no unpickling."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.io.common import check_allocation, damaged, require_file

SIGNATURE = b"PK\x03\x04"

# The limit of NumPy, which would read a longer header before it refuses it.
_LONGEST_HEADER = 10_000


def is_npz(start: bytes) -> bool:
    """Whether the first bytes of a file are those of a zip archive whose first member is an array of NumPy."""
    return start[:4] == SIGNATURE and start[30 : 30 + int.from_bytes(start[26:28], "little")].endswith(b".npy")


@contextmanager
def open_npz(path: Path) -> Iterator[Archive]:
    """Archive open for reading; any error inside the block becomes a DataError."""
    size = require_file(path)
    with damaged(path, ".npz archive"), zipfile.ZipFile(path) as archive:
        yield Archive(archive, path, size)


class Archive:
    """Arrays of an open archive.

    Attributes
    ----------
    names : list of str
        Names of the arrays.
    packed : list of str
        Names of all files in the archive.
    size : int
        Bytes of the archive.
    """

    def __init__(self, archive: zipfile.ZipFile, path: Path, size: int) -> None:
        self.packed = [name for name in archive.namelist() if not name.endswith("/")]
        self.names = list(dict.fromkeys(name.removesuffix(".npy") for name in self.packed if name.endswith(".npy")))
        self.size = size
        self._archive, self._path = archive, path
        # Of all arrays loaded so far: members may overlap, and many may each stay below the limits.
        self._needed, self._compressed = 0, False

    def load(self, name: str) -> NDArray[Any]:
        """Read one array, after comparing its stated size, with that of those read before, with the bytes of the archive.

        Raises
        ------
        DataError
            If it contains Python objects, or states more data than the archive can hold.
        """
        info = self._archive.getinfo(f"{name}.npy")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            # Other methods unpack to any size at once.
            raise DataError(
                "the array is compressed by a method that is not read",
                file=self._path,
                place=name,
                expected="no compression, or deflate",
                found=f"method {info.compress_type} of zip archives",
                hint="write the archive with numpy.savez or numpy.savez_compressed",
            )
        with self._archive.open(info) as stream:
            shape, dtype = self._header(stream, name)
        if dtype.hasobject:
            raise DataError(
                "the array contains Python objects, which are never loaded",
                file=self._path,
                place=name,
                expected="numbers or texts",
                found="objects",
                hint=f"write a list of texts as numpy.array({name}, dtype=str); if it is a sparse matrix, write it with "
                f"scipy.sparse.save_npz({self._path.name!r}, {name}) to a separate file",
            )
        needed = math.prod(shape) * dtype.itemsize
        check_allocation(needed, info.file_size, self._path, name)
        self._needed += needed
        self._compressed |= info.compress_type != zipfile.ZIP_STORED
        check_allocation(self._needed, self.size, self._path, name, compressed=self._compressed)
        with self._archive.open(info) as stream:
            values: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
        return values

    def _header(self, stream: Any, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
        start = stream.read(12)
        length = int.from_bytes(start[8:10] if start[6:7] == b"\x01" else start[8:12], "little")
        if length > _LONGEST_HEADER:
            raise DataError(
                "the header of an array is wrong", file=self._path, place=name, expected=f"{_LONGEST_HEADER} bytes", found=f"{length}"
            )
        stream.seek(0)
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = header(stream)
        return shape, dtype
