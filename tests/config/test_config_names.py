"""Names that jobs get from their files: every file can be a job, and no two are one."""

from __future__ import annotations

import pytest

from lrbc_cli.config.fields import RESERVED_JOBS, check_name, job_name


@pytest.mark.parametrize(
    ("text", "taken", "name"),
    [
        ("loose-2", [], "loose-2"),
        ("after service", [], "after-service"),
        ("zwei gelöst (B3, B4)", [], "zwei-gelost-B3-B4"),
        ("Tight", ["tight"], "Tight-csv"),
        ("report.html", [], "report.html-csv"),
        ("NUL", [], "NUL-csv"),
        ("測定", [], "csv"),
        ("x" * 240, [], "x" * 100),
        ("...", ["csv"], "csv-"),
        ("a", ["a", "a-csv"], "a-"),
    ],
)
def test_every_text_gives_a_name(text: str, taken: list[str], name: str) -> None:
    found = job_name([text, f"{text}-csv"], taken, "key")
    assert found.startswith(name)
    assert check_name(found) == found
    assert found.lower() not in (*taken, *RESERVED_JOBS)


def test_as_many_names_as_files() -> None:
    taken: list[str] = []
    for text in ("a b", "a-b", "a (b)", "A B", "ä b"):
        taken.append(job_name([text, f"{text}-csv"], taken, text))
    assert len({name.lower() for name in taken}) == 5
    # The digest is that of the key, whatever else is there.
    assert job_name(["A B"], ["a-b", "more"], "A B") == taken[3]
