"""The first, coarse fit of loosened bolts, and what shows beside it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from looking import measurement, seen
from samples import reduced_cache, sample

from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared import offsets
from lrbc_cli.campaign.identification.compared.likeness import apart
from lrbc_cli.campaign.identification.unknowns import parameterise
from lrbc_cli.campaign.looking import all_jobs, first_look, unexplained
from lrbc_cli.campaign.looking.all_jobs import OfJob, together
from lrbc_cli.campaign.looking.fitted import _without_worst, expected_frf, fitted_theta, strike_text
from lrbc_cli.campaign.looking.states import Looking, Seen
from lrbc_cli.campaign.reduced.stage import obtain_reduction
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.updating.comparison.scale import Offset

HZ = np.arange(40.0, 500.0, 2.0)
S = 2j * np.pi * HZ


@cache
def plate() -> tuple[Any, Looking, Any]:
    inputs = sample("plate")
    source = Looking(inputs=inputs, stage=obtain_reduction(inputs, reduced_cache("plate")), kind="port")
    return inputs, source, parameterise(inputs, source, S)[0]


def state(*loose: tuple[str, float]) -> np.ndarray:
    """Theta with the values of some bolts lowered by so many decades."""
    inputs, _, parameters = plate()
    theta = parameters.initial
    for group, where, _ in parameters.placed:
        if group.bolt is None:
            continue
        for name, change in loose:
            theta[where][group.bolt == list(inputs.bolts.name).index(name)] -= change
    return theta


def measured(theta: np.ndarray, error: np.ndarray) -> np.ndarray:
    """FRFs that the model errs from, with 2 % noise."""
    _, source, parameters = plate()
    y = source.model(S, parameters).frf(theta)
    noise = np.random.default_rng(5).normal(size=(2, *y.shape))
    return np.asarray(y * error * (1.0 + 0.02 * (noise[0] + 1j * noise[1])))


def loosened(own: np.ndarray, tight: np.ndarray) -> Seen:
    _, source, parameters = plate()
    states = source.model(S, parameters).frf(parameters.initial)[None]
    return seen(own, states, hz=HZ, job="loose", source=source, parameters=parameters, tight=tight)


def test_it_finds_bolts_though_sensors_are_exchanged() -> None:
    inputs, _, parameters = plate()
    rng = np.random.default_rng(4)
    error = 10.0 ** (rng.normal(0.0, 1.0, (1, len(inputs.responses))) / 20.0) * np.ones((S.size, 1))
    names = list(inputs.bolts.name)
    tight, own = measured(parameters.initial, error), measured(state((names[1], 1.5), (names[4], 1.0)), error)
    assert np.median(apart(own, tight)) > 4.0
    order = np.arange(own.shape[1])
    order[[0, 3]] = 3, 0
    exchanged = loosened(own[:, order], tight)
    theta = fitted_theta(exchanged)
    assert theta is not None
    left = apart(own, expected_frf(exchanged, theta))
    # What each sensor would have measured at its own place.
    assert left.max() < 2.0, left
    wrong = apart(own[:, order], expected_frf(exchanged, theta))
    assert wrong[[0, 3]].min() > 5.0, wrong


def test_a_response_that_the_tight_state_lacks_is_expected_as_computed() -> None:
    inputs, source, parameters = plate()
    tight = measured(parameters.initial, np.ones((1, len(inputs.responses))))
    tight[:, 2] = np.nan
    expected = expected_frf(loosened(tight, tight), parameters.initial)
    np.testing.assert_allclose(expected[:, 2], source.model(S, parameters).frf(parameters.initial)[:, 2])
    np.testing.assert_allclose(expected[:, [0, 1, 3]], tight[:, [0, 1, 3]], rtol=1e-12)


def struck(inputs: Any, own: np.ndarray, expected: np.ndarray) -> str:
    return strike_text(seen(own, expected[None], job="loose", inputs=inputs), expected)


def two_hammers(seed: int = 1) -> tuple[Any, np.ndarray, np.ndarray]:
    """Four sensors under two hammers; measured and expected FRFs, levels half a decibel apart."""
    rng = np.random.default_rng(seed)
    responses = [SimpleNamespace(name=f"a{k}-{hammer}") for hammer in ("h1", "h2") for k in range(4)]
    campaign = SimpleNamespace(jobs={"loose": JobConfig.model_construct()})
    inputs = SimpleNamespace(campaign=campaign, responses=responses, excitations=("h1", "h2"), input_of=np.repeat([0, 1], 4))
    expected = 10.0 ** rng.normal(0.0, 0.5, (200, 8)) + 0j
    return inputs, expected * 10.0 ** (rng.normal(0.0, 1.0, (200, 8)) / 20.0 + rng.normal(0.0, 0.5, 8) / 20.0), expected


def test_a_hammer_that_read_too_little_force() -> None:
    inputs, own, expected = two_hammers()
    assert struck(inputs, own, expected) == ""
    own[:, :4] *= 10.0 ** (4.0 / 20.0)
    text = struck(inputs, own, expected)
    assert text.startswith("all FRFs of h1 are ")
    assert " dB above " in text
    factor = float(text.rpartition("a3-h1: ")[2].rstrip("}"))
    assert abs(20.0 * np.log10(factor) + 4.0) < 1.0


def test_a_sensor_alone_is_no_hammer() -> None:
    inputs, own, expected = two_hammers()
    own[:, [1, 5]] *= 2.0
    assert struck(inputs, own, expected) == ""
    # Nor is anything said where one sensor is all that a hammer has.
    inputs.input_of = np.array([0] * 7 + [1])
    own[:, 7] *= 4.0
    assert struck(inputs, own, expected) == ""


def calibrated(
    monkeypatch: pytest.MonkeyPatch, first: OfJob, left: dict[int, float], misfit: float = 6.5, at_bounds: dict[str, float] | None = None
) -> OfJob:
    """Findings of the reference job, ``first`` as exported, after a rough calibration with which nothing is found."""
    stand_in: Any = SimpleNamespace(
        misfit=misfit,
        by_excitation=left,
        parameters=SimpleNamespace(placed=()),
        inputs=SimpleNamespace(bolts=None, model=SimpleNamespace(is_acoustic=np.zeros(1, dtype=bool))),
    )
    monkeypatch.setattr(first_look, "Seen", SimpleNamespace(of=lambda *_: stand_in))
    monkeypatch.setattr(first_look, "roughly_calibrated", lambda *_: SimpleNamespace(at_bounds=at_bounds or {}))
    monkeypatch.setattr(first_look, "_looked_at", lambda *_: OfJob())
    for text in ("tighter_text", "looser", "loaded_text"):
        monkeypatch.setattr(first_look, text, lambda *_: "")
    monkeypatch.setattr(first_look, "of_a_part", lambda *_, **__: [])
    source: Any = SimpleNamespace(inputs=SimpleNamespace(campaign=SimpleNamespace(calibration=SimpleNamespace(job="tight"))))
    measurement: Any = None
    return first_look._calibrated(
        source, {"tight": measurement}, "tight", first, lambda: first_look.roughly_calibrated(source, measurement)
    )[1]


@pytest.mark.parametrize(("left", "kept"), [({0: 0.8, 1: 7.0}, True), ({0: 0.8, 1: 2.0}, False)])
def test_an_excitation_that_no_calibration_fits_keeps_its_warning(
    monkeypatch: pytest.MonkeyPatch, left: dict[int, float], kept: bool
) -> None:
    """The FRFs of one hammer point are fitted alone; while those of the other are not, nothing found is no all-clear."""
    first = OfJob([Finding(kind=Kind.UNLIKE, text="little in common")])
    assert (calibrated(monkeypatch, first, left) is first) == kept


def test_a_model_that_a_calibration_leaves_far_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a part was missing, the level of one sensor was off by chance, and was told instead."""
    first = OfJob([Finding(kind=Kind.PLACES, text="levels differ")])
    (told,) = calibrated(monkeypatch, first, {0: 4.4, 1: 4.0}, misfit=4.4).told
    assert told.kind is Kind.UNLIKE
    assert told.text.startswith("a rough calibration leaves 4.4 dB between measured and computed FRFs, of 4.4 dB")
    assert "A stiffener, another part or a support may be missing" in told.text
    assert calibrated(monkeypatch, first, {0: 1.0, 1: 3.5}, misfit=2.0) is first


@pytest.mark.parametrize(
    ("after", "explained"),
    [
        ({}, True),
        ({"misfit": 3.1}, False),
        # One hammer point that no calibration fits.
        ({"by_excitation": {0: 0.8, 1: 3.5}}, False),
        ({"at_bounds": {"stiffness.structure": 2.0}}, False),
        ({"job": "tight-2"}, False),
        ({"found": None}, False),
    ],
)
def test_what_a_calibration_within_its_bounds_explains_needs_no_other_cause(
    monkeypatch: pytest.MonkeyPatch, after: dict[str, Any], explained: bool
) -> None:
    """Before, full solves for each cause took minutes beside a model that was right within some per cent."""
    calibrations: list[object] = []
    found: Any = SimpleNamespace(at_bounds=after.get("at_bounds", {}))

    def rough(*_: object) -> Any:
        calibrations.append(found)
        return after.get("found", found)

    def of(source: object, *_: object) -> Any:
        far = SimpleNamespace(misfit=6.6, by_excitation={0: 6.6})
        near = SimpleNamespace(misfit=after.get("misfit", 1.9), by_excitation=after.get("by_excitation", {0: 1.9}))
        return near if source is found else far

    asked: list[bool] = []

    def looked_at(*_: object, explained: Any) -> OfJob:
        asked.extend([explained(), explained()])
        return OfJob()

    monkeypatch.setattr(first_look, "Seen", SimpleNamespace(of_model=of))
    monkeypatch.setattr(first_look, "roughly_calibrated", rough)
    monkeypatch.setattr(first_look, "_looked_at", looked_at)
    monkeypatch.setattr(first_look, "_calibrated", lambda source, _, __, told, calibrate: (calibrate(), told))
    calibration = SimpleNamespace(job=after.get("job", "tight"))
    source: Any = SimpleNamespace(inputs=SimpleNamespace(campaign=SimpleNamespace(calibration=calibration)))
    first_look._seen_and_calibrated(source, {"tight": source}, "tight")
    assert asked == [explained] * 2
    # Calibrated once, whoever asks.
    assert len(calibrations) == 1


def test_many_hammer_points_are_calibrated_without_the_worst_half() -> None:
    assert _without_worst({0: 2.0, 1: 9.0}) == [[0], [1]]
    assert _without_worst({0: 2.0, 1: 9.0, 2: 1.0, 3: 3.0, 4: 8.0}) == [[2, 0]]


@pytest.mark.parametrize(("misfit", "factors", "told"), [(2.6, {"part_2": 1.35}, True), (1.4, {"part_2": 1.35}, False), (2.6, {}, False)])
def test_a_calibration_that_ends_at_a_bound_is_told_unless_the_model_then_fits(
    monkeypatch: pytest.MonkeyPatch, misfit: float, factors: dict[str, float], told: bool
) -> None:
    found = calibrated(monkeypatch, OfJob(), {0: 1.0}, misfit, factors)
    assert [each.kind for each in found.told] == ([Kind.MATERIAL] if told else [])
    assert not told or "a rough calibration moves part_2 to 1.35" in found.told[0].text


@pytest.mark.parametrize(
    ("misfit", "held", "told"),
    [
        (4.6, ". The model is held to the ground in addition to the bolts (at x = 0.74)", "differ by 4.6 dB (median of the responses"),
        # Without supports, or near the model, there is nothing to name.
        (4.6, "", ""),
        (2.1, ". The model is held to the ground in addition to the bolts (at x = 0.74)", ""),
    ],
)
def test_supports_of_a_model_that_no_calibration_brings_near(monkeypatch: pytest.MonkeyPatch, misfit: float, held: str, told: str) -> None:
    """Nodes held by leaving out their rows cannot be freed, so that no model shows what is behind them; they are named all the same."""
    stand_in: Any = SimpleNamespace(misfit=misfit, job="tight")
    monkeypatch.setattr(unexplained, "supports_text", lambda _: held)
    monkeypatch.setattr(unexplained, "tighter_text", lambda *_, **__: "")
    unused: Any = {"tight": None}
    found = unexplained.uncalibrated(stand_in, unused, [])
    assert [each.kind for each in found] == ([Kind.UNLIKE] if told else [])
    assert not told or (told in found[0].text and "remove the constraint where the test bench has none" in found[0].text)
    # A baseline that fits the tight model far better: the reference job is not tight, whatever holds the model.
    monkeypatch.setattr(unexplained, "tighter_text", lambda *_, **__: "again (2.5 dB) fits far better")
    loose = unexplained.uncalibrated(stand_in, unused, [])
    assert [each.kind for each in loose] == ([Kind.NOT_TIGHT] if misfit > 3.0 else [])


@pytest.mark.parametrize(("late", "kept"), [({1}, set()), ({1, 4}, {1, 4}), ({3, 4, 5}, {3, 4, 5}), ({0, 2, 5}, {2, 5})])
def test_a_channel_is_late_at_every_blow(monkeypatch: pytest.MonkeyPatch, late: set[int], kept: set[int]) -> None:
    """Three sensors and two hammer points; a blow is late at all sensors."""
    monkeypatch.setattr(offsets, "same_sensor", lambda _, i: [(i + 3) % 6])
    inputs: Any = SimpleNamespace(input_of=np.array([0, 0, 0, 1, 1, 1]))
    plain = Offset(response=0, db=0.0, half=0.0, power=0, known=(), before=0.0, after=0.0)
    stated = [replace(plain, response=i, delay=3.5e-4 * (i in late)) for i in range(6)]
    assert {o.response for o in offsets.late_together(inputs, stated) if o.delay} == kept


def test_nothing_is_compared_beyond_a_soft_tip() -> None:
    inputs = sample("plate")
    own = measurement(HZ, np.ones((HZ.size, len(inputs.responses)), dtype=complex))
    coherent = np.where(HZ[:, None] < 300.0, 0.99, 0.1) * np.ones(own.values.shape)
    heard = first_look._heard(inputs, "tight-1", replace(own, coherence=coherent), None)
    assert np.array_equal(np.isfinite(heard).all(axis=1), HZ < 300.0)
    assert np.isfinite(first_look._heard(inputs, "tight-1", replace(own, coherence=np.full(own.values.shape, 0.99)), None)).all()


@pytest.mark.parametrize("doubt", [True, False])
def test_with_springs_at_wrong_nodes_exchanged_sensors_of_other_jobs_are_not_told(doubt: bool) -> None:
    campaign = SimpleNamespace(update=SimpleNamespace(reference="tight"))
    responses = [SimpleNamespace(node=i, direction="UZ") for i in range(4)]
    source: Any = SimpleNamespace(
        inputs=SimpleNamespace(campaign=campaign, springs_doubt=doubt, responses=responses), away={}, near={}, left={}
    )
    exchanged = [Finding(text="exchanged", kind=Kind.EXCHANGED, cycles=((0, 1),))]
    found = {"tight": OfJob([Finding(text="alone", kind=Kind.ALONE, responses=(3,))]), "loose": OfJob(exchanged)}
    assert [each.job for each in together(source, {}, found)] == ["tight", *([] if doubt else ["loose"])]
    # Nor beside a model that has little in common with the reference job.
    found["tight"] = OfJob([Finding(text="little in common", kind=Kind.UNLIKE)])
    assert [each.job for each in together(source, {}, found)] == ["tight"]


def test_a_baseline_that_differs_from_a_reference_job_with_a_loose_bolt_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(all_jobs, "_levels", lambda *_: np.zeros(1))
    monkeypatch.setattr(all_jobs, "misplaced_sensor", lambda *_: [])
    settings = SimpleNamespace(update=SimpleNamespace(reference="tight", baselines=("tight-2",)), calibration=None)
    inputs = SimpleNamespace(
        campaign=settings, springs_doubt=False, bolts=SimpleNamespace(name=["B1"], xyz=np.zeros((1, 3))), odd_bolts=(), responses=()
    )
    freed = Finding(text="differs", kind=Kind.FREED)

    def told(change: float) -> list[str]:
        found = {"tight": OfJob(), "tight-2": OfJob([freed])}
        source: Any = SimpleNamespace(inputs=inputs, changes={f"job-{k}": np.array([change]) for k in range(5)}, away={}, near={}, left={})
        return [each.job for each in together(source, {}, found)]

    assert told(0.9) == ["tight"]
    assert told(0.1) == ["tight-2"]
