"""A page that cannot be written anew says itself that it is old, in room that it keeps for that: on a full disk there is no other."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from html import escape, unescape
from pathlib import Path

from lrbc_cli.errors import LrbcError, unwritten
from lrbc_cli.report.html import Markup

#: Bytes that a page keeps for it.
ROOM = 600

_PLACE = re.compile(rb'<p id="old"( hidden)?>([^<]*)</p>')


def room() -> Markup:
    """Return the place for it, which nobody sees."""
    return Markup(f'<p id="old" hidden>{" " * ROOM}</p>')


def outdate(page: Path, why: str) -> None:
    """Have a page say that it is old, and why; its time of change stays. Nothing where there is no such page or it cannot be changed."""
    with suppress(OSError):
        before, found = page.stat(), _PLACE.search(page.read_bytes())
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
    """What a page says of its being old; nothing where it does not."""
    with suppress(OSError):
        found = _PLACE.search(page.read_bytes())
        if found is not None and not found[1]:
            return unescape(found[2].decode()).strip()
    return ""


@contextmanager
def outdating(page: Path) -> Iterator[None]:
    """Have the page say that it is old where what it shows, or it itself, cannot be written."""
    try:
        yield
    except (LrbcError, OSError) as error:
        if unwritten(error) is not None:
            outdate(page, f"{error.problem}; {error.hint}" if isinstance(error, LrbcError) else str(error))
        raise
