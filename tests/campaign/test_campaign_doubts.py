"""Units, signs, fits that miss the data or end above their start: said by update and calibrate, and nothing said where all is well."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from campaigns import Folder

import lrbc_cli as lrbc
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.doubts import coarse_text, noise_level, own_fault_text, unreached, worsened
from lrbc_cli.campaign.identification.compared.offsets import offset_findings, trusted
from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.jobs.evidence import guessed_text
from lrbc_cli.campaign.looking.measured import unclear
from lrbc_cli.campaign.looking.unexplained import single_responses
from lrbc_cli.campaign.reading.doubts import springs
from lrbc_cli.config.settings import TextFormat
from lrbc_cli.model.units import SI
from lrbc_cli.results.job import JobRecord
from lrbc_cli.results.store import read_job
from lrbc_cli.updating.comparison.scale import Known, Offset
from lrbc_cli.updating.judging.clearance import loose_there
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.judging.rule import DecisionRule
from lrbc_cli.updating.statistics.saturation import Saturation

G = "{acc1: 0.1019716, acc2: 0.1019716, acc3: 0.1019716, acc4: 0.1019716}"


def update(folder: Folder, job: str, *overrides: str) -> Any:
    """That job and the reference job."""
    args = [word for text in overrides for word in ("--override", text)]
    outcome = folder.run("update", "--json", "--job", job, *args)
    assert outcome.code == 0, outcome.stderr
    return outcome


def test_a_power_that_explains_a_large_misfit_needs_no_narrow_interval() -> None:
    integrated = Offset(response=0, db=0.2, half=2.7, power=-1, known=(), before=67.6, after=3.8, named=True)
    sound = [Offset(response=i, db=0.1, half=0.2, power=0, known=(), before=1.0, after=1.0) for i in range(1, 14)]
    assert trusted(integrated, [integrated, *sound])
    little = replace(integrated, before=12.0)
    assert not trusted(little, [little, *sound])


def test_nothing_is_said_of_a_sound_campaign(frame_once: Folder) -> None:
    for job in ("tight", "loose-2", "loose-all"):
        assert frame_once.result(job)["warnings"] == []


def test_results_tell_with_which_reference_job_they_are_compared(frame_once: Folder) -> None:
    """What several jobs show together counts against the present reference job alone: stored results as they are, one stiffer bolt."""
    found = {}
    for name in ("tight", "loose-2", "loose-all"):
        record = read_job(frame_once.out, name)
        assert isinstance(record, JobRecord)
        found[name] = record.finding
    assert found["tight"].identity
    assert {found[name].against for name in ("loose-2", "loose-all")} == {found["tight"].identity}
    (bolt, *_) = [bolt for bolt in found["loose-2"].bolts if bolt.verdict == "tight"]
    assert bolt.threshold is not None
    stiffer = replace(found["loose-2"], bolts=[replace(bolt, change=0.2 - bolt.threshold, change_std=0.1)], content="")
    jobs = {"tight": found["tight"], **dict.fromkeys("abc", stiffer)}
    assert bolt.name in loose_there(jobs)["tight"]
    assert loose_there(jobs | {"tight": replace(found["tight"], identity="measured again")}) == {}


@pytest.mark.slow
def test_accelerances_in_g(frame: Folder) -> None:
    """The reference job and another in g/N: each is named with its likely cause and key, and no job is a bare `unexplained`."""
    results = update(frame, "loose-2", f"jobs.tight.scale={G}", f"jobs.loose-2.scale={G}").json["results"]
    for job in ("tight", "loose-2"):
        tree = results[job]
        assert tree["status"] == "unexplained"
        assert "compared were magnitudes in dB" in tree["reason"]
        assert "a constant factor explains most of the misfit" in tree["reason"]
        (why,) = [text for text in tree["warnings"] if text.startswith("the model does not explain the measurement")]
        assert "compared were" in why
        (unit,) = [text for text in tree["warnings"] if text.startswith("probably not in the model's units")]
        assert "all responses (acc1, acc2, acc3, acc4)" in unit
        assert "probable cause: FRFs in g/N" in unit
        assert f"Write jobs.{job}.format.unit: g/N" in unit
        assert not any(b["verdict"] == "loose" for b in tree["bolts"])


def test_a_factor_that_leaves_most_of_the_misfit_is_no_unit(frame: Folder) -> None:
    """A sensor at another place than the model's, say: it was told as in/s2/N, with a scale to write."""
    inputs = frame.inputs()

    def found(half: float, after: float) -> list[str]:
        wrong = Offset(response=2, db=31.1, half=half, power=0, known=(), before=27.4, after=after, named=True)
        sound = [Offset(response=i, db=0.1, half=0.2, power=0, known=(), before=1.0, after=1.0) for i in (0, 1, 3)]
        return list(map(str, offset_findings(inputs, [wrong, *sound], "tight")))

    assert found(8.7, 10.5) == []
    assert "acc3: measured over computed +31.10 dB" in found(0.5, 3.0)[0]


def hammered(
    *,
    unit: str | None = None,
    scale: float = 1.0,
    uncalibrated: bool = False,
    power: int = 0,
    turned: Collection[str] = (),
    name: str = "tight",
    known: tuple[Known, ...] = (),
    **db: float,
) -> list[Finding]:
    """Findings of four sensors under two hammer points with these factors, else none; of files with this unit and scale, or in volts."""
    names = [f"a{k}-h{h}" for h in (1, 2) for k in range(1, 5)]
    responses = [SimpleNamespace(name=n, node=int(n[1]), direction=3, quantity="acceleration", input=int(n[-1]) - 1) for n in names]
    job = SimpleNamespace(factor=lambda _: scale, first=Path("tight.uff"), format_of=lambda _: unit and TextFormat(unit=unit))
    blows = {h: SimpleNamespace(scale=1.0) for h in ("h1", "h2")}
    reference = SimpleNamespace(update=SimpleNamespace(reference="tight"), jobs={name: job}, excitation=blows)
    method = SimpleNamespace(residual=SimpleNamespace(phase=False))
    inputs: Any = SimpleNamespace(responses=responses, campaign=reference, method=method, excitations=("h1", "h2"))
    own = [db.get(name.replace("-", ""), 0.0) for name in names]
    found = [
        Offset(response=i, db=size, half=0.3, power=0, known=known, before=max(abs(size), 1.0), after=1.0, named=abs(size) > 2.0)
        for i, size in enumerate(own)
    ]
    found = [replace(offset, uncalibrated=uncalibrated, power=power, reversed=names[offset.response] in turned) for offset in found]
    return offset_findings(inputs, found, name)


def test_a_factor_of_one_sensor_is_told_with_all_its_records() -> None:
    """For one hammer point it explained less than half of the misfit, so `scale` was proposed for the other one only."""
    (one,) = hammered(a3h2=-2.5, a3h1=-1.9)
    assert one.responses == (2, 6)
    assert "a3-h1" in one.text.partition("scale: ")[2]
    (single,) = hammered(a3h2=-2.5, a3h1=-0.9)
    assert single.responses == (6,)


def test_a_factor_of_one_record_at_one_hammer_point_is_no_unit() -> None:
    """The sensor was turned, and its FRF for one of the hammer points 8 dB too low: that of g/lbf by chance."""
    pounds = (Known(20.0 * np.log10(0.453592), "FRFs in g/lbf", "g/lbf"),)
    (one,) = hammered(known=pounds, a2h1=-6.9)
    assert one.kind is Kind.PLACES
    assert "no sensitivity depends on the hammer point" in one.text
    assert "g/lbf" not in one.text
    (both,) = hammered(known=pounds, a2h1=-6.9, a2h2=-6.9)
    assert both.kind is Kind.UNITS
    assert "g/lbf" in both.text
    # A range ten times off is one of a single record, too.
    (tenfold,) = hammered(a2h1=-20.0)
    assert tenfold.kind is Kind.UNITS


def test_one_factor_of_all_sensors_for_one_hammer_point_is_that_of_the_force() -> None:
    (one,) = hammered(a1h1=6.6, a2h1=6.2, a3h1=6.5, a4h1=6.5)
    assert "all FRFs of h1: measured over computed +6.50 dB at all lines (median; a1-h1, a2-h1, a3-h1, a4-h1)" in one.text
    assert "those of other hammer points +0.00 dB. No sensor depends on the hammer point, so the force was wrong" in one.text
    fix = "{a1-h1: 0.473151, a2-h1: 0.473151, a3-h1: 0.473151, a4-h1: 0.473151}"
    assert one.text.endswith(f"write jobs.tight.scale: {fix}, or excitation.h1.scale: 2.11349 if all jobs show it")
    assert one.responses == (0, 1, 2, 3)
    # Nor the force alone, if other hammer points show it, or of two sensors.
    assert not any("the force was wrong" in each.text for each in hammered(**{f"a{k}h{h}": 6.5 for h in (1, 2) for k in range(1, 5)}))
    assert not any("the force was wrong" in each.text for each in hammered(a1h1=6.5, a2h1=6.5))
    assert not any("the force was wrong" in each.text for each in hammered(a1h1=6.5, a2h1=-6.5, a3h1=12.0))


@pytest.mark.parametrize(
    ("turned", "what"),
    [
        ([f"a{k}-h2" for k in range(1, 5)], "the direction of the blow at h2"),
        (["a1-h1", "a1-h2"], "the direction of the sensor"),
        (["a1-h1"], "the direction of the sensor"),
        ([f"a{k}-h{h}" for h in (1, 2) for k in range(1, 5)], "the direction of the hammer or of all sensors"),
    ],
)
def test_one_reversed_blow_is_no_reversed_sensor(turned: list[str], what: str) -> None:
    (found,) = hammered(turned=turned)
    assert f"Possible cause: {what}. Write jobs.tight.scale: " in found.text


@pytest.mark.parametrize(("db", "name", "sure"), [(3.3, "v1", True), (3.4, "v1", False), (3.4, "tight", True)])
def test_a_gain_near_the_factor_of_a_convention(db: float, name: str, sure: bool) -> None:
    """Another hammer with the sensitivity of the first one, 1.48 times: no root of two. In the reference job the model may err as much."""
    convention = Known(20.0 * np.log10(2.0**0.5), "rms and peak values mixed", of_all=True)
    every = {f"a{k}h{h}": db for h in (1, 2) for k in range(1, 5)}
    (found,) = hammered(name=name, known=(convention,), **every)
    fix = f"probable cause: rms and peak values mixed. Write jobs.{name}.scale: 0.707107"
    doubt = "possible cause: rms and peak values mixed (then write jobs.v1.scale: 0.707107), or a sensitivity or a gain that is"
    assert (fix in found.text) is sure
    assert (f"{doubt} not known here (then jobs.v1.scale: {10.0 ** (-db / 20.0):.6g})" in found.text) is not sure


def test_the_unit_to_write_replaces_the_one_that_is_stated() -> None:
    """And a scale beside a unit that converts already is one too many."""
    names = [f"a{k}h{h}" for h in (1, 2) for k in range(1, 5)]

    def told(db: float, **stated: Any) -> str:
        (found,) = hammered(**stated, **dict.fromkeys(names, db))
        return found.text

    twice = told(19.6, unit="g/N", scale=9.80665)
    assert "converted twice, by jobs.tight.format.unit: g/N and by jobs.tight.scale: 9.80665. Delete jobs.tight.scale, or else" in twice
    assert "FRFs in m/s2/N, not in g/N. Write jobs.tight.format.unit: m/s2/N" in told(19.8, unit="g/N")
    assert "FRFs in mm/s2/N, not in g/N. Write jobs.tight.format.unit: mm/s2/N" in told(79.8, unit="g/N")
    assert "jobs.tight.scale: 10, which FRFs with jobs.tight.format.unit: mm/s2/N do not need. Delete" in told(
        20.1, unit="mm/s2/N", scale=10.0
    )
    assert "Write jobs.tight.format.unit: m/s2/kgf" in told(19.8)


def test_a_factor_that_depends_on_the_hammer_point_is_no_sensitivity() -> None:
    """Sensors beside the model's nodes: each record was told as a sensitivity of its own, with a scale to write."""
    (found,) = hammered(a1h1=4.6, a1h2=-5.1, a2h1=7.0, a3h2=4.0)
    assert (found.kind, found.responses) == (Kind.PLACES, (0, 1, 4, 6))
    said = found.text
    assert "no sensitivity depends on the hammer point. Check places and directions of a1-h1, a2-h1, a1-h2, a3-h2" in said
    assert "scale" not in said


def test_factors_of_a_sensor_or_of_a_hammer_are_told_as_such() -> None:
    (sensor,) = hammered(a1h1=4.6, a1h2=4.7)
    assert (sensor.kind, sensor.responses) == (Kind.UNITS, (0, 4))
    assert "jobs.tight.scale: {a1-h1: " in sensor.text
    (hammer,) = hammered(**{f"a{k}h2": 4.6 for k in range(1, 5)})
    assert (hammer.kind, hammer.responses) == (Kind.UNITS, (4, 5, 6, 7))


def test_another_quantity_is_told_apart_from_a_unit() -> None:
    """Beside it, the frequencies of the modes are not doubted."""
    (unit,) = hammered(**{f"a{k}h{h}": 20.0 for k in range(1, 5) for h in (1, 2)})
    (velocity,) = hammered(power=-1, **{f"a{k}h{h}": 20.0 for k in range(1, 5) for h in (1, 2)})
    assert "velocity, not acceleration" in velocity.text
    assert (unit.detail, velocity.detail) == ("", "quantity")


def test_of_g_and_a_factor_of_ten_several_sensors_share_g() -> None:
    g = -20.0 * np.log10(9.80665)
    (several,) = hammered(**{f"a{k}h{h}": g - 0.1 for k in (1, 2) for h in (1, 2)})
    assert several.responses == (0, 1, 4, 5)
    assert "FRFs in g/N or a sensitivity or a range ten times off. Write jobs.tight.scale: {a1-h1: 9.80665" in several.text
    (alone,) = hammered(a1h1=g - 0.1, a1h2=g - 0.1)
    assert "a sensitivity or a range ten times off or FRFs in g/N. Write jobs.tight.scale: {a1-h1: 10" in alone.text


def test_nearly_ten_times_is_told_beside_another_sensitivity() -> None:
    """The model is off by a decibel, too: a scale of 0.11 alone would be advice to write its error into the file."""
    (near,) = hammered(a1h1=19.1, a1h2=19.1)
    assert "ten times off (then write jobs.tight.scale: {a1-h1: 0.1, a1-h2: 0.1}), or a sensitivity or a gain" in near.text
    assert "(then jobs.tight.scale: {a1-h1: 0.110917, a1-h2: 0.110917})" in near.text
    (far,) = hammered(a1h1=17.0, a1h2=17.0)
    assert "ten times" not in far.text


def test_no_unit_is_guessed_for_channels_without_sensitivities() -> None:
    """Sensitivities of sensors and hammer leave any factor: +13 dB came out as FRFs per lbf."""
    pounds = {f"a{k}h{h}": 20.0 * np.log10(4.4482) for k in range(1, 5) for h in (1, 2)}
    (unit,) = hammered(**pounds)
    assert "FRFs per lbf" in unit.text
    (volts,) = hammered(uncalibrated=True, **pounds)
    assert volts.text.endswith(
        "cause: the channels are not calibrated (unit in the file). Enter the sensitivities of sensors and hammer in the analyser, and "
        "export again; or write `scale` in each job: sensitivity of the hammer over that of the sensor, in SI (by this comparison about "
        "0.22; take it from the data sheets)"
    )


def test_several_single_responses_are_one_finding() -> None:
    inputs: Any = SimpleNamespace(responses=[SimpleNamespace(name=f"a{k}", node=k, direction="UZ") for k in range(8)])
    every = np.array([1.0, 9.0, 2.0, 11.0, 1.0, 10.0, 1.5, 2.0])
    told = single_responses(inputs, every, [1, 3, 5], "the model")
    assert [each.responses for each in told] == [(1, 3, 5)]
    assert told[0].text.startswith(
        "a1, a3, a5 differ from the model by 9.0 to 11.0 dB (mean level removed), the median of all responses is"
    )
    # One with a place of its own, and two without, remain sentences of their own.
    told = single_responses(inputs, every, [1, 3, 5], "its FRF in tight", "loose", better={3: "; at node 7"})
    assert [each.responses for each in told] == [(3,), (1,), (5,)]
    assert told[0].text.endswith(
        "Check whether the sensor was moved: at node 7. Measure it again, or remove its record from the file of loose"
    )
    # Of one sensor at one place the records are one sentence.
    told = single_responses(inputs, every, [1, 3, 5], "its FRF in tight", "loose", better={3: "; at node 7", 5: "; at node 7"})
    assert [each.responses for each in told] == [(3, 5), (1,)]


def test_what_is_found_is_told_apart_by_kind_and_responses(frame: Folder) -> None:
    """Not by its words: the same of several jobs is said once, whatever it reads like."""
    inputs = frame.inputs()
    sound = [Offset(response=i, db=0.1, half=0.2, power=0, known=(), before=1.0, after=1.0) for i in range(4)]
    turned = [replace(offset, reversed=offset.response in (1, 2)) for offset in sound]
    late = [replace(offset, delay=1e-3) for offset in sound]
    (first,), (second,) = (offset_findings(inputs, turned, job) for job in ("tight", "loose-2"))
    assert first.cause == second.cause
    assert first.text != second.text
    assert [(found.kind, found.responses) for found in offset_findings(inputs, late, "tight")] == [(Kind.LATE, (0, 1, 2, 3))]
    wrong = replace(sound[0], db=60.0, before=60.0, named=True)
    assert [(found.kind, found.responses) for found in offset_findings(inputs, [wrong, *sound[1:]], "tight")] == [(Kind.UNITS, (0,))]


def test_one_factor_of_all_responses_may_be_the_material_of_the_model(frame: Folder) -> None:
    inputs = frame.inputs()
    offsets = [Offset(response=i, db=-8.7, half=0.5, power=0, known=(), before=9.0, after=1.0, named=True) for i in range(4)]
    (one,) = offset_findings(inputs, offsets, "tight")
    assert "or modulus and density of the structure, both about 2.7 times too small (steel and aluminium differ by 2.9)" in one.text
    assert one.text.endswith("otherwise check the sensitivities, then write jobs.tight.scale: 2.7227")
    # Not of one job alone or of some responses.
    for told in (
        offset_findings(inputs, offsets, "loose-2"),
        offset_findings(inputs, [*offsets[:2], *(replace(offset, db=0.1, named=False) for offset in offsets[2:])], "tight"),
    ):
        assert "modulus and density" not in told[0].text


def test_one_sensor_among_others_has_no_unit_of_its_own() -> None:
    """Its factor of 9.8 is a sensitivity ten times off, that of several sensors a unit."""
    (one,) = hammered(a2h1=-19.80, a2h2=-19.80)
    assert "Write jobs.tight.scale: {a2-h1: 10, a2-h2: 10}" in one.text
    (several,) = hammered(a2h1=-19.80, a2h2=-19.80, a3h1=-19.82, a3h2=-19.82)
    assert "a2-h1: 9.80665" in several.text


@pytest.mark.parametrize(("db", "after", "unit"), [(10.5, 5.0, True), (11.6, 2.5, True), (11.6, 5.6, False)])
def test_a_unit_off_the_measured_factor_must_explain_the_rest(frame: Folder, db: float, after: float, unit: bool) -> None:
    """A model of steel for aluminium: 11.6 dB were told as ft/s2/N, which are 10.3 dB."""
    foot = Known(20.0 * np.log10(1.0 / 0.3048), "FRFs in ft/s2/N", "ft/s2/N")
    offsets = [Offset(response=i, db=db, half=0.5, power=0, known=(foot,), before=12.0, after=after, named=True) for i in range(4)]
    (one,) = offset_findings(frame.inputs(), offsets, "tight")
    assert ("FRFs in ft/s2/N" in one.text) == unit
    assert ("modulus and density of the structure" in one.text) != unit


@pytest.mark.parametrize(("first", "last", "told"), [(0, 395, True), (0, 399, False), (0, 410, False), (5, 395, False)])
def test_lines_from_zero_that_end_before_the_band(frame: Folder, first: int, last: int, told: bool) -> None:
    """An export without the first lines, and a start frequency of 0: all frequencies are too low."""
    inputs = frame.inputs()
    low, high = 20.0, 400.0
    inputs = replace(
        inputs,
        campaign=inputs.campaign.model_copy(update={"reduction": inputs.campaign.reduction.model_copy(update={"band": (low, high)})}),
    )
    every = np.arange(float(first), last + 1.0)
    hz = every[(every >= low) & (every <= high)]
    left_out = (int((every < low).sum()), int((every > high).sum()))
    values, unknown = np.ones((hz.size, len(inputs.responses)), dtype=complex), np.full((hz.size, len(inputs.responses)), np.nan)
    one: Any = SimpleNamespace(frequency_hz=hz, left_out=left_out, values=values, coherence=unknown, sigma_db=None, files=1)
    found = [each.text for each in unclear(inputs, {"tight": one}) if "begin at 0 Hz" in each.text]
    assert len(found) == told
    assert not told or "end at 395 Hz, 5 Hz below the end of reduction.band" in found[0]


def test_a_measurement_alone_that_is_not_explained(frame: Folder) -> None:
    """The reference job is: then model and units are right."""
    inputs = frame.inputs()
    one = own_fault_text(inputs, np.array([7.9, 1.9, 1.8, 2.0]), "tight")
    assert (
        "Only acc1 is far off (misfit 7.9 dB and more, 1.9 dB in the median of all): check whether a sensor was overloaded, moved, turned"
        in one
    )
    every = own_fault_text(inputs, np.array([9.0, 8.0, 10.0, 9.5]), "tight")
    assert "No response stands out: check whether the hammer was at another point" in every
    # What is known is said, and no more is guessed.
    known = own_fault_text(inputs, np.array([9.0, 8.0, 10.0, 9.5]), "tight", "probably noise")
    assert known.endswith("the fault is probably in this measurement: probably noise")


@pytest.mark.parametrize(
    ("far", "told"),
    [
        ({"a1": 5.0}, "All FRFs of one sensor (a1-h1, a1-h2, a1-h3, ... (4 in all)) are far off (misfit 5.0 dB, of the others 1.5 dB): "),
        ({"h2": 5.0}, "All FRFs of one hammer point (a1-h2, a2-h2, a3-h2) are far off"),
        ({"a1": 2.5}, "No response stands out"),
        ({"a1-h1": 9.0}, "Only a1-h1 is far off"),
    ],
)
def test_one_sensor_or_hammer_point_is_far_off_in_all_its_frfs(far: dict[str, float], told: str) -> None:
    """Three sensors at four hammer points; a moved sensor was called noise."""
    names = [(f"a{k}", f"h{h}") for h in range(1, 5) for k in range(1, 4)]
    responses = [SimpleNamespace(name=f"{a}-{h}", node=int(a[1]), direction=3, input=int(h[1]) - 1) for a, h in names]
    misfits = np.array([far.get(a, far.get(h, far.get(f"{a}-{h}", 1.5))) for a, h in names])
    inputs: Any = SimpleNamespace(responses=responses)
    assert told in own_fault_text(inputs, misfits, "tight")


@pytest.mark.parametrize(("used", "held_out", "said"), [(0.4, None, False), (2.0, 2.1, False), (1.0, 2.6, True), (2.6, None, True)])
def test_the_hammer_is_not_suspected_beside_a_reference_job_that_is_explained_coarsely(
    used: float, held_out: float | None, said: bool
) -> None:
    state = ReferenceState(job="tight", parameters={}, covariance=None, sigma_db=0.5, misfit_db=used, validation_db=held_out)
    text = coarse_text(state, DecisionRule())
    assert ("has a misfit of 2.60 dB: improve model" in text) == said == bool(text)


def test_one_sensor_in_another_unit_and_one_reversed(frame: Folder) -> None:
    outcome = update(frame, "tight", "jobs.tight.scale={acc4: 1000.0, acc1: -1.0}")
    warnings = outcome.json["results"]["tight"]["warnings"]
    (unit,) = [text for text in warnings if text.startswith("probably not in the model's units")]
    assert "units: acc4: measured over computed +60" in unit
    # The factor that is stated is the mistake.
    assert "jobs.tight.scale: {acc4: 1}" in unit
    (sign,) = [text for text in warnings if text.startswith("probably reversed sign")]
    assert "acc1" in sign
    assert "jobs.tight.scale: {acc1: 1}" in sign
    assert "no effect on the fit" in sign
    # Once on the console.
    assert outcome.stderr.count("reversed sign") == 1


def test_exchanged_sensors_are_told_by_update_too(frame: Folder) -> None:
    """The warning of check, through the same code; no verdict of that job is called well founded."""
    path = frame.data / "frf" / "loose-2.csv"
    head, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    path.write_text("\n".join([head, *(",".join([c[0], *c[3:5], *c[1:3], *c[5:]]) for c in cells)]) + "\n")
    tree = update(frame, "loose-2").json["results"]["loose-2"]
    (told,) = [text for text in tree["warnings"] if "are probably exchanged" in text]
    assert "jobs.loose-2.records: {acc2: acc1, acc1: acc2}" in told
    # Nor is the hammer blamed for it.
    assert not any("whether the hammer was at another point" in text for text in tree["warnings"])
    assert tree["validity"]["passed"] is not True


def test_one_response_without_phases_is_told_by_update_too(frame: Folder) -> None:
    path = frame.data / "frf" / "loose-2.csv"
    head, *rows = path.read_text().splitlines()
    values = np.array([row.split(",") for row in rows], dtype=float)
    values[:, 3:5] = np.column_stack([np.hypot(*values[:, 3:5].T), np.zeros(len(values))])
    np.savetxt(path, values, delimiter=",", header=head, comments="")
    tree = update(frame, "loose-2").json["results"]["loose-2"]
    (told,) = [text for text in tree["warnings"] if "no phases" in text]
    assert told.startswith("loose-2.csv: no phases: every value of acc2 is real")
    # Magnitudes are compared, so the verdicts stand.
    assert [bolt["name"] for bolt in tree["bolts"] if bolt["verdict"] == "loose"] == ["B3", "B4"]


@pytest.mark.slow
def test_velocities_for_accelerations(frame: Folder) -> None:
    tree = frame.tree()
    for response in tree["responses"].values():
        response["quantity"] = "displacement"
    frame.write(tree)
    for file in (frame.data / "frf").glob("*.csv"):
        # The file says nothing of quantities then.
        file.write_text(file.read_text().replace("m/s2/N", ""))
    told = update(frame, "tight").json["results"]["tight"]["warnings"]
    (unit,) = [text for text in told if text.startswith("probably not in the model's units")]
    assert "probable cause: acceleration, not displacement. Write responses.acc1.quantity: acceleration" in unit


@pytest.mark.slow
def test_a_misfit_that_is_no_factor(frame: Folder) -> None:
    held = ("parameters.left_edge.bounds=[7.9, 8.0]", "parameters.left_edge.initial=8.0")
    tree = update(frame, "loose-all", *held).json["results"]["loose-all"]
    assert tree["status"] == "unexplained"
    assert "the misfit is not a constant factor: the largest, " in tree["reason"]
    assert " would reduce the misfit of this response from " in tree["reason"]
    assert not any("units" in text for text in tree["warnings"])


def test_calibration_refuses_other_units(frame: Folder) -> None:
    refused = frame.run("calibrate", "--override", f"jobs.tight.scale={G}")
    assert refused.code == 3
    assert "measurement and model are probably in different units" in refused.stderr
    assert "probable cause: FRFs in g/N. Write jobs.tight.format.unit: g/N" in refused.stderr
    assert not (frame.out / "calibration.json").exists()


def test_calibration_warns_of_one_response(frame: Folder) -> None:
    done = frame.run("calibrate", "--json", "--override", "jobs.tight.scale={acc4: 0.1019716, acc2: -1.0}")
    assert done.code == 0, done.stderr
    assert any(
        "probable cause: a sensitivity or a range ten times off or FRFs in g/N. Write jobs.tight.scale: {acc4: 1.01972}" in text
        for text in done.json["warnings"]
    )
    assert any("probably reversed sign: acc2" in text for text in done.json["warnings"])
    assert done.stderr.count("reversed sign") == 1


def test_intervals_of_a_fit_that_misses_the_data(frame: Folder) -> None:
    """Bounds that keep the fit from the truth: values with narrow intervals, and a warning that they mean little."""
    held = ("parameters.left_edge.bounds=[5.5, 8.0]", "update.largest_misfit=100", "update.approach=paper")
    tree = update(frame, "loose-all", *held).json["results"]["loose-all"]
    assert tree["misfit_db"]["final"] > 1.5
    (text,) = [text for text in tree["warnings"] if "does not reach the data" in text]
    assert "understate" in text
    assert text in tree["notes"]


@pytest.mark.parametrize(
    ("misfit", "noise", "warned"), [(0.9, None, False), (1.1, None, True), (2.3, 0.1, True), (2.3, 0.9, False), (3.0, 0.9, True)]
)
def test_far_above_the_noise(misfit: float, noise: float | None, warned: bool) -> None:
    text = unreached(misfit, noise)
    assert (text is not None) == warned
    if text is not None:
        assert f"{misfit:.2f} dB" in text
        assert ("measurement not known" in text) == (noise is None)


def test_an_end_above_the_start() -> None:
    assert worsened(2.19, 2.0, None) is None
    assert worsened(2.19, 2.19, None) is None
    assert worsened(None, 2.0, None) is None
    # A fit that reaches the data: whatever the plain mean was before, nothing is wrong.
    assert worsened(0.53, 0.61, None) is None
    assert worsened(1.4, 1.5, 0.9) is None
    text = worsened(2.19, 3.71, None)
    assert text is not None
    assert "from 2.19 dB at the start values to 3.71 dB" in text


def test_noise_by_coherence(frame: Folder) -> None:
    inputs = frame.inputs()
    job = inputs.campaign.jobs["tight"]
    measurement = read_measurement(inputs, job, "tight")
    object.__setattr__(measurement, "coherence", np.full(measurement.values.shape, 0.9))
    # 8.69 sqrt(0.1 / (2 5 0.9)) is the standard deviation; its mean size is 0.8 of that.
    assert noise_level(inputs, measurement, job) == pytest.approx(0.7979 * 8.686 * np.sqrt(0.1 / 9.0), rel=1e-3)
    assert noise_level(inputs, measurement, job.model_copy(update={"averages": 1})) is None
    object.__setattr__(measurement, "coherence", np.full(measurement.values.shape, np.nan))
    assert noise_level(inputs, measurement, job) is None


def test_rotational_springs_as_the_table_says_are_in_no_other_unit(frame: Folder) -> None:
    """Kilonewton millimetres per radian are newton metres, but for rounding."""
    study = lrbc.load(frame.config, cache=frame.cache)
    campaign, group = study.inputs.campaign, study.inputs.groups[0]
    assert campaign.unit_system == SI
    assert springs._unit_text(campaign, group, [(True, np.ones(3))]) is None
    assert "translational springs are probably in N/mm" in str(springs._unit_text(campaign, group, [(False, np.full(3, 1e3))]))


def test_what_auto_stands_for_where_the_frfs_do_not_say() -> None:
    limits = Saturation(start=7.0, lower=2.0, upper=10.0, found=False)
    text = guessed_text("axial", limits, None)
    assert "guessed from the stiffness matrix (start 7, bounds 2 to 10, log10)" in text
    assert "write `initial` and `bounds` of parameters.axial instead of auto" in text
    stated = guessed_text("axial", limits, 0.0)
    assert "guessed from the stiffness matrix (bounds 2 to 10, log10)" in stated
    assert "write `bounds` of parameters.axial instead of auto" in stated
