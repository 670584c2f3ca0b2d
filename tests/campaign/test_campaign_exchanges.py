"""Findings that rest on several jobs: the order of those whose removed bolts are nested, and what the reference job explains of others."""

from __future__ import annotations

from dataclasses import replace

import pytest
from samples import sample

from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.looking.all_jobs import each_once, pooled
from lrbc_cli.campaign.looking.exchanges import _exchange, _nested, exchanged_files, mistitled


@pytest.mark.parametrize(
    ("far", "expected"),
    [
        ((5.68, 3.84, 5.35, 5.59, 2.35, 5.69), (0, 4)),
        ((2.35, 3.84, 5.35, 5.59, 5.68, 5.69), None),
        # Distances of jobs with nearly all bolts removed differ by tenths.
        ((2.35, 3.84, 5.75, 5.59, 5.68, 5.60), None),
        # Two exchanges, or neither of two alone.
        ((6.0, 5.0, 2.0, 1.0), None),
        ((6.5, 3.5), (0, 1)),
        ((6.5,), None),
        ((), None),
    ],
)
def test_one_exchange_that_puts_all_in_order(far: tuple[float, ...], expected: tuple[int, int] | None) -> None:
    assert _exchange(far) == expected


def test_jobs_that_are_not_nested_have_no_order() -> None:
    a, b, c = frozenset({"B1"}), frozenset({"B1", "B2"}), frozenset({"B2", "B3", "B4"})
    assert _nested({"two": b, "one": a}) == ["one", "two"]
    assert _nested({"two": b, "other": c}) == []
    assert _nested({"one": a, "again": a}) == []


def test_files_of_two_jobs_of_the_frame() -> None:
    inputs = sample("frame")
    jobs = inputs.campaign.jobs
    measured = {name: read_measurement(inputs, job, name) for name, job in jobs.items()}
    assert exchanged_files(inputs, measured) is None
    told = exchanged_files(inputs, measured | {"loose-2": measured["loose-all"], "loose-all": measured["loose-2"]})
    assert told is not None
    assert told.startswith("the files of loose-2 and loose-all may be exchanged: loose-2 (2 bolts removed) differs")
    assert told.endswith("Check jobs.loose-2.frf and jobs.loose-all.frf")
    assert exchanged_files(inputs, {name: measured[name] for name in ("loose-2", "loose-all")}) is None


@pytest.mark.parametrize(
    ("titles", "expected"),
    [
        (
            {"tight": "Frame loose-2", "loose-2": "Frame tight"},
            ["tight.csv is titled 'Frame loose-2', and loose-2.csv, the file of loose-2"],
        ),
        ({"tight": "from loose-2.uff", "loose-2": ""}, ["tight.csv is titled 'from loose-2.uff', and"]),
        ({"tight": "Frame LOOSE-2, run 3", "loose-2": ""}, ["tight.csv is titled 'Frame LOOSE-2, run 3', and"]),
        ({"tight": "Frame tight", "loose-2": "Frame loose-2"}, []),
        # A title that nobody changed, one that is not a job's name, one that says both.
        ({"tight": "Frame tight", "loose-2": "Frame tight", "loose-all": "Frame tight"}, []),
        ({"tight": "Frame loose-2b", "loose-2": "Frame tight-2"}, []),
        ({"tight": "loose-2, put back tight", "loose-2": "loose-2"}, []),
        ({"loose-2": "all tight but loose-2", "tight": ""}, []),
    ],
)
def test_what_files_say_of_themselves(titles: dict[str, str], expected: list[str]) -> None:
    inputs = sample("frame")
    measured = {name: read_measurement(inputs, job, name) for name, job in inputs.campaign.jobs.items()}
    told = mistitled(inputs, {name: replace(own, titles=(titles.get(name, ""),)) for name, own in measured.items()})
    assert len(told) == len(expected)
    assert all(part in text for part, text in zip(expected, told, strict=True))


def test_a_sensor_that_is_reversed_is_told_once() -> None:
    """In jobs with loose bolts one of its two FRFs shows, or neither."""
    found: dict[str, dict[tuple[object, ...], str]] = {
        "tight": {("reversed", 2, 5): "a3 is reversed"},
        "one": {("reversed", 5): "a3-h2 is reversed"},
        "two": {("reversed", 5, 7): "two are reversed"},
    }
    told = each_once(pooled(found, "tight"))
    assert told == ["job tight: a3 is reversed; the same in one", "job two: two are reversed"]
    assert pooled(found, None) == found


def test_phases_alone_say_nothing_beside_another_unit() -> None:
    found: dict[str, dict[tuple[object, ...], str]] = {
        "tight": {("units", 0, 1): "velocity, not acceleration"},
        "one": {("sideways", "up"): "90 degrees", ("alone", 1): "far off"},
    }
    assert pooled(found, "tight")["one"] == {("alone", 1): "far off"}
    assert pooled({"tight": {}, "one": found["one"]}, "tight")["one"] == found["one"]
