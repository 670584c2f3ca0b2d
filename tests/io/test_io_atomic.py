"""Files appear whole or not at all."""

from __future__ import annotations

import hashlib
import os
import time

import pytest

from lrbc_cli.errors import DataError
from lrbc_cli.io.atomic import atomic_path, atomic_write, file_hash, remove_leftovers, together


def names(folder):
    return [path.name for path in folder.iterdir()]


def test_creates_folders_and_replaces(tmp_path):
    target = tmp_path / "a" / "b" / "result.csv"
    with atomic_write(target) as stream:
        stream.write("ä\n")
    assert target.read_bytes() == "ä\n".encode()
    with atomic_write(target, "wb") as stream:
        stream.write(b"\r\n\0")
    assert target.read_bytes() == b"\r\n\0"
    assert names(target.parent) == ["result.csv"]


@pytest.mark.parametrize("interruption", [ValueError, KeyboardInterrupt, SystemExit])
def test_failure_leaves_the_old_file_and_nothing_else(tmp_path, interruption):
    target = tmp_path / "result.json"
    target.write_text("old")

    def write_half() -> None:
        with atomic_write(target) as stream:
            stream.write("new")
            stream.flush()
            raise interruption

    with pytest.raises(interruption):
        write_half()
    assert target.read_text() == "old"
    assert names(tmp_path) == ["result.json"]


def test_temporary_path_lies_beside_the_target(tmp_path):
    target = tmp_path / "model.h5"
    with atomic_path(target) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".h5"
        assert not temporary.exists()
        temporary.write_bytes(b"x")
        assert not target.exists()
    assert target.read_bytes() == b"x"


def test_a_block_that_writes_nothing_fails(tmp_path):
    def write_nothing() -> None:
        with atomic_path(tmp_path / "x.bin"):
            pass

    with pytest.raises(FileNotFoundError):
        write_nothing()
    assert names(tmp_path) == []


def test_permissions_are_the_users(tmp_path):
    with atomic_write(tmp_path / "a") as stream:
        stream.write("x")
    (tmp_path / "b").write_text("x")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_hash(tmp_path):
    path = tmp_path / "data"
    path.write_bytes(b"lrbc" * 100_000)
    assert file_hash(path) == hashlib.sha256(b"lrbc" * 100_000).hexdigest()
    with pytest.raises(DataError, match="does not exist"):
        file_hash(tmp_path / "none")


def test_files_are_replaced_together_or_not_at_all(tmp_path):
    first, second = tmp_path / "a" / "first.csv", tmp_path / "b" / "second.json"

    def write(text):
        with together():
            for path in (first, second):
                with atomic_write(path) as file:
                    file.write(text)
            if text == "broken":
                raise OSError("full")

    write("old")
    with pytest.raises(OSError, match="full"):
        write("broken")
    assert (first.read_text(), second.read_text()) == ("old", "old")
    write("new")
    assert (first.read_text(), second.read_text()) == ("new", "new")
    assert (names(first.parent), names(second.parent)) == (["first.csv"], ["second.json"])
    # Afterwards each file is replaced at once again.
    with atomic_write(first) as file:
        file.write("alone")
    assert first.read_text() == "alone"


def test_only_old_temporary_files_of_this_program_are_removed(tmp_path, monkeypatch):
    endings = ("json", "csv", "h5", "html", "png", "svg", "pdf")
    old = [tmp_path / f".a-b-0123456789ab.{ending}" for ending in endings]
    foreign = ("x-0123456789ab.json", ".x-0123456789AB.json", ".x-0123456789ab.uff", ".x-0123456789a.csv", ".0123456789ab.h5", ".x.json")
    others = [tmp_path / name for name in (*foreign, ".watch.lock", "job/.x-0123456789ab.json")]
    young = tmp_path / ".y-0123456789ab.json"
    (tmp_path / "job").mkdir()
    (tmp_path / ".z-0123456789ab.json").mkdir()
    target = tmp_path / "target"
    for path in (*old, *others, young, target):
        path.write_text("x")
        long_ago = time.time() - (3600 if path == young else 100_000)
        os.utime(path, (long_ago, long_ago))
    (tmp_path / ".l-0123456789ab.json").symlink_to(target)
    kept = {*others, young, target, tmp_path / ".z-0123456789ab.json", tmp_path / ".l-0123456789ab.json"}
    remove_leftovers(tmp_path)
    assert not any(path.exists() for path in old)
    assert all(path.exists() for path in kept)
    # Neither a missing folder nor a file that cannot be removed is an error.
    remove_leftovers(tmp_path / "none")
    old[0].write_text("x")
    os.utime(old[0], (1.0, 1.0))

    def denied(self, missing_ok=False):
        raise PermissionError("denied")

    monkeypatch.setattr(type(tmp_path), "unlink", denied)
    remove_leftovers(tmp_path)
    assert old[0].exists()


def test_the_temporary_name_is_one_that_is_removed_later(tmp_path):
    """In the longest case too."""
    for name in ("result.json", "b" * 200 + ".csv", "result.previous.json", ".watch.svg"):
        with atomic_path(tmp_path / name) as temporary:
            temporary.write_text("x")
            os.utime(temporary, (1.0, 1.0))
            remove_leftovers(tmp_path)
            assert not temporary.exists()
            temporary.write_text("x")
