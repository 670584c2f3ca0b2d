"""Jobs that a folder of measurements adds to a campaign: every file is one."""

from __future__ import annotations

from pathlib import Path

import pytest

from lrbc_cli.config.fields import check_name
from lrbc_cli.config.watch import RESERVED_JOBS, _job_name


@pytest.mark.parametrize(
    ("file", "taken", "name"),
    [
        ("loose-2.csv", [], "loose-2"),
        ("after service.csv", [], "after-service"),
        ("zwei gelöst (B3, B4).uff", [], "zwei-gelost-B3-B4"),
        ("tight.csv", ["tight"], "tight-csv"),
        ("report.html.csv", [], "report.html-csv"),
        ("NUL.csv", [], "NUL-csv"),
        ("測定.csv", [], "job"),
        ("x" * 240 + ".csv", [], "x" * 91),
    ],
)
def test_every_file_is_a_job(file: str, taken: list[str], name: str) -> None:
    found = _job_name(Path(file), taken)
    assert found.startswith(name)
    assert check_name(found) == found
    assert found.lower() not in (*taken, *RESERVED_JOBS)


def test_two_files_of_one_name_are_two_jobs() -> None:
    taken: dict[str, str] = {}
    for file in ("a b.csv", "a-b.csv", "a_b.csv", "a (b).csv", "A B.csv", "ä b.csv"):
        name = _job_name(Path(file), taken)
        assert name.lower() not in taken
        taken[name.lower()] = file
    # Whatever else is there, a file that comes later keeps its job.
    assert _job_name(Path("a (b).csv"), ["a-b", "a-b-csv"]) == next(name for name, file in taken.items() if file == "a (b).csv")
