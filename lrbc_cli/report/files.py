"""Atomic writing of report files, and the file names of FRF figures."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from lrbc_cli.errors import DataError, room_or
from lrbc_cli.io.atomic import atomic_write


@contextmanager
def replace(file: Path) -> Iterator[IO[bytes]]:
    """Open a file for writing; it replaces an existing file only when it is complete.

    Raises
    ------
    DataError
        If it cannot be written.
    """
    try:
        with atomic_write(file, "wb") as sink:
            yield sink
    except OSError as error:
        hint = room_or(error, "check the folder and its permissions")
        raise DataError(f"the file cannot be written: {error.strerror or error}", file=file, hint=hint) from None


def frf_file(response: str) -> str:
    """Return the file name of the figure of a response; unsafe characters are replaced, and a hash then keeps names distinct."""
    safe = re.sub(r"[^\w.+-]", "_", response)[:80]
    if safe != response:
        safe += "-" + hashlib.sha256(response.encode()).hexdigest()[:8]
    return f"frf-{safe}.png"
