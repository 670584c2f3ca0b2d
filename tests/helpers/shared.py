"""What is dear to make and only read: one test process makes it, all of a run read it."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

#: Seconds to wait for another process; what takes longest is made in half a minute on an idle core.
PATIENCE = 900.0


def shared(name: str, make: Callable[[Path], object]) -> Path:
    """Folder of that name, made by the first process that asks; the others wait."""
    base = Path(os.environ["LRBC_TESTS_SHARED"])
    folder, done, busy = base / name, base / f"{name}.done", base / f"{name}.busy"
    end = time.monotonic() + PATIENCE
    while not done.exists():
        try:
            busy.touch(exist_ok=False)
        except FileExistsError:
            if time.monotonic() > end:
                raise TimeoutError(f"{folder} is still being made by another test process") from None
            time.sleep(0.05)
            continue
        try:
            if not done.exists():
                make(folder)
                done.touch()
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        finally:
            busy.unlink()
    return folder
