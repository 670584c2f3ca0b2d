"""What tells an open page of ``lrbc watch`` that there is a newer one, or that nobody watches any more.

A page from a folder may read no other file, but it may show pictures: the width of ``.watch.svg`` is the version of the page, and its
height changes as long as the watcher lives.
"""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from lrbc_cli.io.common import regular_bytes
from lrbc_cli.report.html import Markup, tag

#: Name of the picture beside the page.
SIGN = ".watch.svg"

#: Largest number of a page; the times of writing differ by 0.1 s or more.
_STAMPS = 1_000_000

#: Bytes of a page that hold its number and the note that it is out of date.
_HEAD = 100_000

_STAMP = re.compile(rb' id="live" data-stamp="(\d+)"')


def live_note(written: datetime) -> Markup:
    """Return the hidden paragraph with the number of a page, which says later since when it has not been updated."""
    stamp = int(10 * written.timestamp()) % _STAMPS + 1
    return tag(
        "p", id="live", data_stamp=str(stamp), data_written=f"{written:%d %B %Y, %H:%M}", role="status", class_="warning", hidden=True
    )


def version_of(page: Path) -> int:
    """Return twice the number of a page, plus one if it is marked as out of date; 1 if there is no page that refreshes itself."""
    with suppress(OSError):
        head = regular_bytes(page, _HEAD)
        found = _STAMP.search(head)
        if found is not None:
            return 2 * int(found[1]) + (b'<p id="old">' in head)
    return 1


def sign(version: int, beat: int) -> str:
    """Return the picture with a version as its width and a count as its height."""
    return f'<svg xmlns="http://www.w3.org/2000/svg" width="{version}" height="{beat % 1000 + 1}"/>\n'
