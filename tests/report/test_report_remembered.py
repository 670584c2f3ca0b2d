"""What a process keeps of results that it has read: by content, never by name or time."""

import os
from pathlib import Path

import numpy as np
import pytest

from lrbc_cli.errors import DataError
from lrbc_cli.remembered import Remembered
from lrbc_cli.results.store import read_job
from lrbc_cli.results.tables import read_frf


def test_a_content_is_worked_on_once_and_by_kind() -> None:
    known, made = Remembered[str](2), []

    def value(text: str) -> str:
        made.append(text)
        return text

    assert [known.of(b"a", lambda: value("first")), known.of(b"a", lambda: value("again"))] == ["first", "first"]
    assert known.of(b"a", lambda: value("other"), "kind") == "other"
    assert known.of(b"b", lambda: value("b")) == "b"  # the oldest goes
    assert known.of(b"a", lambda: value("anew")) == "anew"
    assert made == ["first", "other", "b", "anew"]


def test_what_fails_is_tried_again() -> None:
    known = Remembered[int](2)
    with pytest.raises(ZeroDivisionError):
        known.of(b"", lambda: 1 // 0)
    assert known.of(b"", lambda: 3) == 3


def test_a_table_of_other_numbers_at_the_same_time_is_read(tmp_path: Path) -> None:
    file = tmp_path / "frf.csv"
    file.write_text("frequency_hz,a_measured_db\n1,2\n")
    first, stamp = read_frf(file), file.stat()
    first.responses["a"].clear()
    assert read_frf(file).responses["a"]["measured_db"] == 2
    file.write_text("frequency_hz,a_measured_db\n1,3\n")
    os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    now = read_frf(file).responses["a"]["measured_db"]
    assert now == 3
    with pytest.raises(ValueError, match="read-only"):
        np.add(now, 1, out=now)


def test_a_result_that_was_damaged_after_it_was_read_is_refused(output: Path) -> None:
    assert read_job(output, "bolts-00") is not None
    file = output / "bolts-00" / "result.json"
    file.write_text(file.read_text().replace('"status"', '"statu"', 1))
    with pytest.raises(DataError, match="damaged"):
        read_job(output, "bolts-00")
