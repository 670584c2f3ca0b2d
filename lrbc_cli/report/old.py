"""Marks an existing page as out of date if it cannot be written again.

The note is written over blanks that every page reserves for it, since a full disk has no room for more.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from html import escape, unescape
from pathlib import Path

from lrbc_cli.errors import LrbcError, unwritten
from lrbc_cli.io.common import regular_bytes
from lrbc_cli.report.html import Markup

#: Bytes that a page reserves for the note.
ROOM = 600

_PLACE = re.compile(rb'<p id="old"( hidden)?>([^<]*)</p>')


def room() -> Markup:
    """Return the hidden paragraph that reserves room for the note."""
    return Markup(f'<p id="old" hidden>{" " * ROOM}</p>')


def outdate(page: Path, why: str) -> None:
    """Write into a page that it is out of date, and why; keeps its modification time. No effect if there is no page or it is read-only."""
    with suppress(OSError):
        before, found = page.stat(), _PLACE.search(regular_bytes(page))
        if found is None:
            return
        text = f"This page is out of date ({datetime.now().astimezone():%d %B %Y, %H:%M}): {why}"
        size = found.end() - found.start() - len('<p id="old"></p>')
        while len(escape(text).encode()) > size:
            text = text[:-2] + "…"
        with page.open("r+b") as file:
            file.seek(found.start())
            file.write(b'<p id="old">' + escape(text).encode().ljust(size) + b"</p>")
        os.utime(page, ns=(before.st_atime_ns, before.st_mtime_ns))


def outdated(page: Path) -> str:
    """Note that a page is out of date; empty if it has none."""
    with suppress(OSError):
        found = _PLACE.search(regular_bytes(page))
        if found is not None and not found[1]:
            return unescape(found[2].decode()).strip()
    return ""


@contextmanager
def outdating(page: Path) -> Iterator[None]:
    """Mark the page as out of date if the block fails because a file cannot be written; the error is raised all the same."""
    try:
        yield
    except (LrbcError, OSError) as error:
        if unwritten(error) is not None:
            outdate(page, f"{error.problem}; {error.hint}" if isinstance(error, LrbcError) else str(error))
        raise
