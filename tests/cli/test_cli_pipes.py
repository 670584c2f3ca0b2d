"""A named pipe in the place of a file: reading it would wait without end, so it is refused, or replaced like any other file."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import pytest
from campaigns import Folder

from lrbc_cli.errors import ConfigError
from lrbc_cli.io.common import regular_bytes
from lrbc_cli.watch.lock import Lock

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")


@pytest.fixture(autouse=True)
def _not_for_ever() -> Iterator[None]:
    def end(number: int, frame: FrameType | None) -> None:
        raise AssertionError("waits for the writer of a pipe")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def pipe(path: Path) -> Path:
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    return path


def test_only_regular_files_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in (pipe(tmp_path / "pipe"), Path(os.devnull)):
        with pytest.raises(OSError, match="not a regular file"):
            regular_bytes(path)
    with socket.socket(socket.AF_UNIX) as found:
        monkeypatch.chdir(tmp_path)
        found.bind("socket")
        with pytest.raises(OSError, match=r"(?i)no such device|not supported"):
            regular_bytes(tmp_path / "socket")
    (tmp_path / "file").write_bytes(b"lrbc")
    assert regular_bytes(tmp_path / "file") == b"lrbc"
    assert regular_bytes(tmp_path / "file", 2) == b"lr"


@pytest.mark.parametrize("file", ["data/K.mtx", "data/tight.uff"])
def test_inputs(box: Folder, file: str) -> None:
    path = pipe(box.path / file)
    for command in ("check", "update"):
        outcome = box.run(command)
        assert outcome.code in (3, 5), outcome.stderr
        assert f"{path}: this is not a file" in outcome.stderr
        assert "a pipe, a socket or a device" in outcome.stderr


@pytest.mark.parametrize("file", ["campaign.json", "loose/result.json", "plan.json", "calibration.json"])
def test_results(box: Folder, file: str) -> None:
    path = pipe(box.out / file)
    outcome = box.run("report")
    assert outcome.code == 2, outcome.stderr
    assert f"{path}: the results cannot be read (not a regular file)" in outcome.stderr


@pytest.mark.parametrize("file", ["frf.csv", "evidence.json"])
def test_tables(box: Folder, file: str) -> None:
    path = pipe(box.out / "loose" / file)
    outcome = box.run("report")
    assert outcome.code == 3, outcome.stderr
    assert f"{path}: this result file cannot be read: not a regular file" in outcome.stderr
    assert box.run("update").code == 0
    assert path.is_file()


@pytest.mark.parametrize("file", ["report.html", "verdicts.png"])
def test_the_page_and_its_figures(box: Folder, file: str) -> None:
    pipe(box.out / file)
    outcome = box.run("report")
    assert outcome.code == 0, outcome.stderr
    assert (box.out / file).is_file()


@pytest.mark.parametrize("file", ["model.h5", "rows.h5", "key.json"])
def test_the_cache(box: Folder, file: str) -> None:
    for folder in box.cache.iterdir():
        pipe(folder / file)
    outcome = box.run("reduce")
    assert outcome.code == 0, outcome.stderr


def test_a_lock(tmp_path: Path) -> None:
    lock = Lock(tmp_path)
    pipe(lock.path)
    with pytest.raises(ConfigError, match="not a regular file"):
        lock.take()
    lock.path.unlink()
    lock.take()
    pipe(lock.path)
    lock.beat()
    assert lock.path.is_file()
    lock.release()
