"""Findings that rest on several jobs: the order of those whose removed bolts are nested, and what the reference job explains of others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from looking import measurement, seen
from samples import sample

from lrbc_cli.campaign import check
from lrbc_cli.campaign.findings import Finding, Kind, once
from lrbc_cli.campaign.identification.compared.sensors import sensors_of
from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.looking import all_jobs
from lrbc_cli.campaign.looking.all_jobs import OfJob, odd_sensors, pooled, tight_state, without_sensors
from lrbc_cli.campaign.looking.exchanges import _exchange, _nested, _whole, exchanged_files, foreign_titles, mistitled
from lrbc_cli.campaign.looking.first_look import FirstLook
from lrbc_cli.campaign.looking.unexplained import many_loosened, without_repeated


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
    assert all(part in text for part, text in zip(expected, told.values(), strict=True))


@pytest.mark.parametrize(("pair", "kept"), [(("tight", "loose-2"), {Kind.UNITS}), (("loose-2", "loose-all"), {Kind.UNITS, Kind.FREED})])
def test_beside_the_file_of_another_state_for_the_tight_one_no_bolt_is_told(
    monkeypatch: pytest.MonkeyPatch, pair: tuple[str, str], kept: set[Kind]
) -> None:
    """A right tight job that differs from the wrong file is not to be removed."""
    inputs = sample("frame")
    seen = [Finding(text="taken as tight", kind=Kind.FREED), Finding(text="g", kind=Kind.UNITS), Finding(text="removed", kind=Kind.REMOVED)]
    monkeypatch.setattr(check, "_looks", lambda *_: FirstLook(seen))
    monkeypatch.setattr(check, "mistitled", lambda *_: {pair: "files may be exchanged"})
    out = check.Findings()
    check._compared(inputs, Path(), {}, out, lambda _: None)
    assert {each.kind for each in out.found if each.kind is not None} == kept


@pytest.mark.parametrize(("detail", "kept"), [("window", {"chain"}), ("blow", {"chain"}), ("filter", {"struck"})])
def test_a_window_in_one_job_is_no_hammer_beside_its_place(monkeypatch: pytest.MonkeyPatch, detail: str, kept: set[str]) -> None:
    """What one window or a second blow leaves beside the fitted state may look like another hammer point."""
    inputs = sample("frame")
    struck = Finding(text="struck", job="loose-2", kind=Kind.HAMMER)
    measured = {name: read_measurement(inputs, inputs.campaign.jobs[name], name) for name in ("tight", "loose-2")}
    monkeypatch.setattr(check, "_looks", lambda *_: FirstLook([struck], doubted=frozenset({"loose-2"})))
    asked: list[str] = []

    def chains(_: Any, names: dict[str, Any], *__: Any) -> list[Finding]:
        asked.extend(names)
        return [Finding(text="chain", job="loose-2", kind=Kind.CHAIN, detail=detail)]

    monkeypatch.setattr(check, "other_chains", chains)
    out = check.Findings()
    check._compared(inputs, Path(), measured, out, lambda _: None)
    assert set(asked) == {"tight", "loose-2"}
    assert {each.text for each in out.found if each.job == "loose-2"} == kept


@pytest.mark.parametrize(
    ("title", "told"),
    [
        ("Cover plate, loose-2", True),
        ("", False),
        ("Frame on the stand loose-2, B07 by hand", False),
        ("frame on the bench  loose-2", False),
    ],
)
def test_the_title_of_another_structure(title: str, told: bool) -> None:
    inputs = sample("frame")
    first = read_measurement(inputs, inputs.campaign.jobs["tight"], "tight")
    names = ["tight", "loose-2", "loose-all", "loose-4", "loose-5"]
    jobs = {name: inputs.campaign.jobs["tight"] for name in names}
    inputs = replace(inputs, campaign=inputs.campaign.model_copy(update={"jobs": jobs}))
    titles = {name: f"Frame on the stand {name}" for name in names} | {"loose-2": title}
    found = foreign_titles(inputs, {name: replace(first, titles=(titles[name],)) for name in names})
    assert ([text.partition(":")[0] for text in found] == ["job loose-2"]) == told
    # Each file has a title of its own: nothing to compare with.
    assert foreign_titles(inputs, {name: replace(first, titles=(f"{number} of May",)) for number, name in enumerate(names)}) == []


def sensors() -> Any:
    """Three sensors and two hammer points: responses 0 to 2 and 3 to 5."""
    responses = [SimpleNamespace(name=f"a{i % 3 + 1}-h{i // 3 + 1}", node=i % 3, direction="UZ", quantity="acceleration") for i in range(6)]
    return SimpleNamespace(responses=responses)


def test_a_sensor_that_is_far_off_in_one_job_alone() -> None:
    """Each with itself in the other jobs: errors of the model are large at the second sensor in all of them."""
    rng = np.random.default_rng(4)
    usual = np.array([1.2, 4.5, 1.6, 1.5, 5.0, 1.3])
    away = {f"job-{k}": usual * rng.uniform(0.8, 1.25, 6) for k in range(6)}
    assert odd_sensors(sensors(), away) == {}
    away["job-3"] = usual * 1.3
    away["job-3"][[2, 5]] = 7.0
    found = odd_sensors(sensors(), away)
    assert [(name, [each.responses for each in told]) for name, told in found.items()] == [("job-3", [(2, 5)])]
    assert "a3-h1, a3-h2: 7.0 dB from the state of the bolts that fits best" in found["job-3"][0].text
    # With few jobs nothing is usual.
    assert odd_sensors(sensors(), {name: away[name] for name in ("job-1", "job-2", "job-3")}) == {}


@pytest.mark.parametrize(
    ("opposite", "kept"),
    [
        ({0, 3}, {0, 3}),
        ({0}, set()),
        # A blow of the other direction; at the other hammer point one record is left of it.
        ({0, 1, 2}, {0, 1, 2}),
        ({0, 1, 2, 4}, {0, 1, 2, 4}),
        (set(), set()),
    ],
)
def test_signs_belong_to_sensors_or_hammer_points(opposite: set[int], kept: set[int]) -> None:
    inputs = sensors()
    for i, response in enumerate(inputs.responses):
        response.input = i // 3
    assert _whole(inputs, opposite, set(range(6))) == kept
    # Of a sensor with one record that record counts.
    assert _whole(inputs, {0}, {0, 1, 2, 4, 5}) == {0}


def test_responses_of_one_row_are_one_sensor() -> None:
    texts = ("row 0 of a.mtx", "row 1 of a.mtx", "row 0 of a.mtx", "", "")
    inputs: Any = SimpleNamespace(responses=[SimpleNamespace(node=None, direction=None, text=text) for text in texts])
    assert sensors_of(inputs) == [(0, 2), (1,), (3,), (4,)]


def test_consequences_of_a_far_model_in_other_jobs_are_not_told() -> None:
    """Those that the reference job has, too, are."""
    campaign = SimpleNamespace(update=SimpleNamespace(reference="tight"))
    inputs = SimpleNamespace(campaign=campaign, springs_doubt=False, responses=sensors().responses)
    source: Any = SimpleNamespace(inputs=inputs, away={}, near={}, left={}, changes={})
    level = of(Kind.UNITS, "a1 is too high", 0, 3)

    def told(left: float, *first: Finding) -> list[tuple[str, str]]:
        source.left["tight"] = left
        found = {"tight": OfJob(list(first)), "one": OfJob([level, of(Kind.HAMMER, "h2 differs")])}
        return [(each.job, each.text) for each in all_jobs.together(source, {}, found) if each.job == "one"]

    assert told(2.0, of(Kind.ALONE, "a2 is far off", 1)) == [("one", "a1 is too high"), ("one", "h2 differs")]
    assert told(7.0, of(Kind.ALONE, "a2 is far off", 1)) == []
    assert told(2.0, of(Kind.SPRINGS, "springs are wrong")) == []
    assert told(2.0, of(Kind.UNLIKE, "little in common"), level) == [("one", "a1 is too high")]


@pytest.mark.parametrize(("change", "many"), [([-1.0, -0.6, 0.1], True), ([-1.0, 0.0, 0.1], False), ([-1.0, np.nan, np.nan], False)])
def test_many_loosened_bolts(change: list[float], many: bool) -> None:
    assert many_loosened(np.array(change)) == many
    assert not many_loosened(None)


def test_a_sensor_in_doubt_in_the_reference_job_is_not_told_again() -> None:
    alone = of(Kind.ALONE, "a1-h2 is far off", 3)
    found = {"tight": OfJob([alone]), "one": OfJob([of(Kind.ALONE, "a1 is far off", 0, 3), of(Kind.ALONE, "a2 is far off", 1)])}
    assert [each.text for each in without_sensors(sensors(), found, "tight")["one"].told] == ["a2 is far off"]
    assert without_sensors(sensors(), found, "tight")["tight"].told == [alone]


def test_single_records_in_doubt_are_not_part_of_the_tight_state() -> None:
    """Before, the other jobs were then compared with the model alone, and exchanged hammer points in one of them were not found."""
    own = measurement(np.arange(5.0), np.ones((5, 6), dtype=complex))
    tight = tight_state(own, [of(Kind.ALONE, "a1-h2 is far off", 3), of(Kind.LOWERED, "B2 is lower")])
    assert tight is not None
    assert np.isnan(tight.values).all(axis=0).tolist() == [False, False, False, True, False, False]
    assert not np.isnan(own.values).any()
    assert tight_state(own, [of(Kind.UNITS, "all in g", 0)]) is None
    assert tight_state(None, []) is None


def test_a_record_far_from_the_model_in_all_tight_jobs_is_an_error_of_the_model() -> None:
    rng = np.random.default_rng(8)
    model = 10.0 ** (rng.normal(0.0, 10.0, (150, 6)) / 20.0) + 0j
    off = np.full(6, 1.0)
    off[3] = 8.0
    one, again, right = (model * 10.0 ** (rng.laplace(0.0, 1.0, model.shape) * sizes / 20.0) for sizes in (off, off, np.ones(6)))
    job = seen(one, model[None], hz=np.linspace(20.0, 400.0, 150), inputs=sensors())
    told = [of(Kind.ALONE, "a1-h2 is far off", 3), of(Kind.LATE, "late", 1)]
    assert without_repeated(job, told, [again]) == told[1:]
    # An overloaded record does not repeat; a place explains it; nothing is known without another tight job, or if all of a sensor are off.
    assert without_repeated(job, told, [right]) == without_repeated(job, told, []) == told
    placed = [replace(told[0], detail="at or near node 7")]
    assert without_repeated(job, placed, [again]) == placed
    both = [of(Kind.ALONE, "a1 is far off", 0, 3)]
    assert without_repeated(job, both, [again]) == both


@pytest.mark.parametrize(("single", "cause"), [((4, 5), "the sign of the coupling"), ((4,), "the polarity of"), ((1,), "the direction of")])
def test_the_cause_of_a_reversed_sign(single: tuple[int, ...], cause: str) -> None:
    inputs = sensors()
    for i in (4, 5):
        inputs.responses[i].quantity = "pressure"
    scales = {response.name: SimpleNamespace(scale=1.0) for response in inputs.responses}
    inputs.campaign = SimpleNamespace(excitation={}, responses=scales)
    inputs.method = SimpleNamespace(residual=SimpleNamespace(phase=False))
    (found,) = all_jobs._sign_findings(inputs, all_jobs._Reversed(single=single, responses=frozenset(single)), 6)
    assert f"Possible cause: {cause}" in found.text


def of(kind: Kind, text: str, *responses: int) -> Finding:
    return Finding(kind=kind, text=text, responses=responses)


def test_a_sensor_that_is_reversed_is_told_once() -> None:
    """In jobs with loose bolts one of its two FRFs shows, or neither."""
    found = {
        "tight": [of(Kind.REVERSED, "a3 is reversed", 2, 5)],
        "one": [of(Kind.REVERSED, "a3-h2 is reversed", 5)],
        "two": [of(Kind.REVERSED, "two are reversed", 5, 7)],
    }
    told = once(pooled(found, "tight"))
    assert told == ["job tight: a3 is reversed; also found in one", "job two: two are reversed"]
    assert len(once(pooled(found, None))) == 3


def test_a_reversed_hammer_is_no_reversed_sensor_of_its_number() -> None:
    """The first hammer point and the first response have the same number."""
    found = {"tight": [of(Kind.REVERSED, "the hammer is reversed", 4, 5)], "one": [of(Kind.REVERSED, "a1 is reversed", 0)]}
    assert once(pooled(found, "tight")) == ["job tight: the hammer is reversed", "job one: a1 is reversed"]


def test_a_sensor_of_another_quantity_is_told_once() -> None:
    """With loose bolts its FRFs show as a factor, or one of them as another quantity; a factor of the reference job is none of a job."""

    def units(text: str, *responses: int, detail: str = "") -> Finding:
        return Finding(kind=Kind.UNITS, text=text, responses=responses, detail=detail)

    found = {
        "tight": [units("a3 is a velocity", 2, 5, detail="quantity"), units("a4 is ten times off", 3, 6)],
        "one": [units("a3-h1 is a velocity", 2, detail="quantity"), units("a3-h2 is -60 dB", 5), units("a4-h1 is 100 times off", 3)],
        "two": [units("a3 and a4 are -60 dB", 2, 3)],
    }
    assert once(pooled(found, "tight")) == [
        *("job tight: a3 is a velocity; also found in one", "job tight: a4 is ten times off"),
        *("job one: a4-h1 is 100 times off", "job two: a3 and a4 are -60 dB"),
    ]


def test_phases_alone_say_nothing_beside_another_unit() -> None:
    found = {
        "tight": [of(Kind.UNITS, "velocity, not acceleration", 0, 1)],
        "one": [of(Kind.SIDEWAYS, "90 degrees"), of(Kind.ALONE, "far off", 1)],
    }
    assert once(pooled(found, "tight"))[1:] == ["job one: far off"]
    assert once(pooled({"tight": [], "one": found["one"]}, "tight")) == ["job one: 90 degrees", "job one: far off"]


def test_one_cause_at_several_places_is_one_line() -> None:
    """Its numbers differ from job to job; other causes, and equal texts of files, stay what they are."""
    windows = [Finding(kind=Kind.CHAIN, detail="window", job=k, text=f"decays by {k}/s") for k in "123"]
    clock = Finding(kind=Kind.CHAIN, detail="clock", job="1", text="2 % higher")
    files = [Finding(place=name, text="ends early") for name in ("a.uff", "b.uff", "a.uff")]
    assert once([*windows, clock, *files, Finding(text="no place")]) == [
        "job 1: decays by 1/s; also found in 2, 3",
        "job 1: 2 % higher",
        "a.uff: ends early; also found in b.uff",
        "no place",
    ]
    # The key of one job mends that job alone.
    keyed = [replace(clock, job=k, text=f"twice. Write jobs.{k}.scale: {k}") for k in "12"]
    assert once(keyed) == ["job 1: twice. Write jobs.1.scale: 1; also found in 2 (each needs its own key)"]


@pytest.mark.parametrize(
    ("cosines", "hammer", "sensors"),
    [
        ([0.9, 0.9, 0.9, -0.9, -0.9, 0.2], (1,), (3, 4, 5)),
        ([0.9, 0.9, 0.9, -0.9, -0.9, 0.9], (), (3, 4)),
        ([0.9, 0.9, -0.9, 0.9, 0.9, -0.9], (), (2, 5)),
        ([0.9, 0.9, 0.9, 0.9, -0.9, 0.1], (), (4,)),
    ],
    ids=["a hammer, one record unlike the model", "two records", "a sensor", "one record"],
)
def test_reversed_hammers_and_sensors(cosines: list[float], hammer: tuple[int, ...], sensors: tuple[int, ...]) -> None:
    """Of three sensors and two hammer points."""
    responses = [SimpleNamespace(node=k % 3, direction=3, quantity="acceleration", input=k // 3) for k in range(6)]
    inputs: Any = SimpleNamespace(responses=responses, campaign=SimpleNamespace(excitation={"H1": None, "H2": None}))
    found = all_jobs._reversed(inputs, dict(enumerate(cosines)))
    assert found.excitations == hammer
    assert set(found.responses) == set(sensors)
