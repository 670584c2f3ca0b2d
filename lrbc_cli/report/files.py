"""Writing files whole or not at all, and names for them."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from lrbc_cli.errors import DataError


@contextmanager
def replace(file: Path) -> Iterator[BinaryIO]:
    """Open a file for writing that takes its place only when it is complete.

    Raises
    ------
    DataError
        Where the folder cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.stem[:40]}-", suffix=".part")
    except OSError as error:
        raise DataError(f"the file cannot be written: {error.strerror}", file=file, hint="check the folder and its permissions") from None
    part = Path(name)
    try:
        with os.fdopen(handle, "wb") as sink:
            yield sink
        part.chmod(0o666 & ~_umask())
        part.replace(file)
    except OSError as error:
        raise DataError(f"the file cannot be written: {error.strerror}", file=file, hint="check free space and permissions") from None
    finally:
        part.unlink(missing_ok=True)


def _umask() -> int:
    # The only way to read it is to set it.
    mask = os.umask(0)
    os.umask(mask)
    return mask


def frf_file(response: str) -> str:
    """Return the file name of a response's figure; characters that no file system likes are replaced, and a hash keeps names apart."""
    safe = re.sub(r"[^\w.+-]", "_", response)[:80]
    if safe != response:
        safe += "-" + hashlib.sha256(response.encode()).hexdigest()[:8]
    return f"frf-{safe}.png"
