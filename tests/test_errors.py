"""The form of a message."""

from __future__ import annotations

from pathlib import Path

from lrbc_cli.errors import LONGEST, ConfigError, DataError, from_folder


def test_all_parts() -> None:
    error = DataError("wrong", file=Path("a") / "b", place="line 3", expected=3, found=[1, 2], hint="put it right")
    assert str(error) == f"{Path('a') / 'b'}, line 3: wrong\n  expected: 3\n  found:    [1, 2]\n  fix:      put it right"
    assert str(DataError("wrong")) == "wrong"
    assert ConfigError("wrong", place="--job").message == "--job: wrong"


def test_long_parts_are_shortened() -> None:
    whole = "x" * 2_000_000
    error = DataError(whole, file=whole, place=whole, expected=whole, found=[whole], hint=whole)
    assert error.found == [whole]
    lines = error.message.splitlines()
    assert len(lines) == 4
    assert len(error.message) < 9 * LONGEST
    assert lines[2] == "  found:    ['" + "x" * (LONGEST - 6) + " ..."
    advice = "correct it in the FE model and export again, " * 60
    shown = DataError("wrong", found=advice, hint=advice).message.splitlines()
    assert shown[2] == f"  fix:      {advice[: len(shown[2]) - 16]} ..."
    assert len(shown[2]) > 2 * len(shown[1])
    assert shown[1].split()[-2] in advice.split()
    assert shown[2].split()[-2] in advice.split()
    whole = "y" * LONGEST
    assert DataError("wrong", found=whole).message == f"wrong\n  found:    {whole}"


def test_paths_are_those_seen_from_the_folder() -> None:
    folder = Path("/home") / "me" / "box"
    assert from_folder(f"{folder / 'frf' / 'a.uff'}, record 3: {Path('/home') / 'b.uff'}", folder) == (
        f"{Path('frf') / 'a.uff'}, record 3: {Path('/home') / 'b.uff'}"
    )
