"""Tells open pages that the watcher still runs, also while it computes, and which page is the newest."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path

from lrbc_cli.report.live import SIGN, sign, version_of

#: Seconds between two signs; pages look for them every three seconds.
EVERY = 2.0


class Pulse:
    """Writes the sign beside the page from ``start`` to ``stop``.

    Parameters
    ----------
    output : Path
        Folder of the results.
    """

    def __init__(self, output: Path) -> None:
        self.path, self.page = output / SIGN, output / "report.html"
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End, and remove the sign: pages that are still open load the last page."""
        self._stop.set()
        self._thread.join()
        with suppress(OSError):
            self.path.unlink(missing_ok=True)

    def _beat(self) -> None:
        beat = 0
        while not self._stop.is_set():
            beat += 1
            with suppress(OSError):
                self.path.write_text(sign(version_of(self.page), beat), encoding="utf-8")
            self._stop.wait(EVERY)
