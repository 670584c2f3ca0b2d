"""Jobs that no state of the bolts explains, records that are wrong in one job alone, and models that nothing can be compared with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import BOX_TRUTH, box, frame
from looking import measurement, modal, seen

from lrbc_cli.campaign.check import check
from lrbc_cli.campaign.identification.compared.chains import chain_doubt
from lrbc_cli.campaign.identification.compared.likeness import apart
from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.campaign.looking import all_jobs, fitted
from lrbc_cli.campaign.looking.all_jobs import misplaced_sensor, of_one_sensor
from lrbc_cli.campaign.looking.causes.damped import windowed_text
from lrbc_cli.campaign.looking.causes.held import idle_text
from lrbc_cli.campaign.looking.causes.parts import at_bounds_text
from lrbc_cli.campaign.looking.first_look import _source
from lrbc_cli.campaign.looking.fitted import multiplied
from lrbc_cli.campaign.looking.odd import left_on
from lrbc_cli.campaign.looking.odd.jobs import _airborne, _of_model, own_air_text
from lrbc_cli.campaign.looking.states import Looking, Seen
from lrbc_cli.campaign.looking.trials import NEARER, at_values, picking
from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.config import load_campaign
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.model.factors import SOUND_SPEED
from lrbc_cli.reduction.problem.full import full_frfs
from lrbc_cli.updating.statistics.chain.blows import BLOWS
from lrbc_cli.updating.statistics.chain.modal import ModalRule
from lrbc_cli.updating.statistics.error_model import ErrorModel
from lrbc_cli.updating.unknowns.shapes import bolt_shapes

HZ = np.arange(30.0, 500.0, 2.0)


def told(folder: Path) -> list[str]:
    inputs = read_as_exported(load_campaign(folder / "campaign.yaml"))
    return check(inputs, folder / "cache").warnings


@pytest.mark.parametrize(("speed", "which"), [(1.0, None), (1.05, "above"), (0.94, "below")])
def test_warmer_and_colder_air_is_told_with_its_temperature(tmp_path: Path, speed: float, which: str | None) -> None:
    lost = np.array([0.0, 1.5, 0.0, 0.0, 0.0, 0.0])
    folder = box(tmp_path, {"other": (BOX_TRUTH["tight"] - lost, speed)})
    said = [text for text in told(folder.path) if "speed of sound" in text]
    if which is None:
        assert said == []
        return
    (text,) = said
    assert text.startswith("job other: no state of the bolts explains it")
    percent = float(text.partition("speed of sound about ")[2].partition("%")[0])
    assert percent == pytest.approx(100.0 * abs(speed - 1.0), rel=0.4)
    assert f"% {which} that of the reference job" in text


def on_feet(path: Path, stiffness: float) -> tuple[Inputs, Looking, np.ndarray]:
    """The frame, on soft springs in its middle if there is a ``stiffness``, its reduced model, and the DOFs of these springs."""
    inputs = read_as_exported(load_campaign(frame(path).path / "campaign.yaml"))
    assert inputs.dofs is not None
    at = np.flatnonzero((inputs.dofs.component == "UZ") & np.isin(inputs.dofs.node, [40, 59, 80]))
    held = sp.csc_array((np.full(at.size, stiffness), (at, at)), inputs.model.K.shape)
    inputs = replace(inputs, model=replace(inputs.model, K=sp.csc_array(inputs.model.K + held), extras={}))
    source = _source(inputs, path / "none", lambda _: None)
    assert source is not None
    return inputs, source, at


@pytest.mark.parametrize(
    ("kg", "node", "times", "loose", "said"),
    [
        (0.071, 108, 1.0, (1, 2, 4, 5), "kg"),
        (0.047, 27, 1.0, (0, 1, 2), "kg"),
        (0.0, 108, 1.0, (1, 2, 4, 5), ""),
        (0.0, 108, 60.0, (1, 2, 4, 5), "times as stiff"),
    ],
    ids=["a tool", "another", "nothing", "blocks under the feet"],
)
def test_what_changed_beside_loosened_bolts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kg: float, node: int, times: float, loose: tuple[int, ...], said: str
) -> None:
    """Bolts and mass hide each other: a fit of the bolts leaves much, and so does a mass with all bolts tight."""
    inputs, source, feet = on_feet(tmp_path, 1e3 if times > 1.0 else 0.0)
    stiffness = np.full(feet.size, 1e3)
    # Its edges are held, too, by DOFs that it does not have.
    monkeypatch.setattr(left_on, "supports_of", lambda _: (feet, stiffness))
    assert inputs.dofs is not None
    assert inputs.bolts is not None
    model, band = inputs.model, inputs.campaign.reduction.band
    hz = np.arange(band[0], band[1], 2.0)
    s = 2j * np.pi * hz
    parameters = source.parameters(s)
    shapes = bolt_shapes(parameters, inputs.bolts.xyz, inputs.statistics.values, inputs.statistics.bolts)
    lump = picking(np.flatnonzero((inputs.dofs.node == node) & (inputs.dofs.component == "UZ")), model.size)
    blocks = picking(feet, model.size)

    def measured(kg: float, times: float, theta: np.ndarray) -> Measurement:
        K = model.K + (times - 1.0) * (blocks.T @ sp.diags_array(stiffness) @ blocks)
        there = replace(model, K=sp.csc_array(K), M=sp.csc_array(model.M + kg * (lump.T @ lump)))
        H, D_ref = full_frfs(there, s, band, refine=0)
        G = at_values(H, parameters.dynamic(theta, s) - D_ref)
        return measurement(hz, G[:, np.arange(G.shape[1]), inputs.input_of] * s[:, None] ** model.output_power)

    theta = np.clip(parameters.initial - 3.0 * shapes.T[:, shapes.bolts[list(loose)]].sum(axis=1), *parameters.bounds.T)
    job = Seen.of(source, "loose", measured(kg, times, theta), measured(0.0, 1.0, parameters.initial))
    expected = fitted.fitted_frf(job)
    assert expected is not None
    text = left_on.left_on_text(job, float(np.median(apart(job.measured, expected))))
    if not said:
        assert text == ""
        return
    assert said in text
    assert ", with the bolts fitted beside it, " in text
    assert float(text.partition("level misfit is ")[2].split()[0]) < 1.0
    if kg:
        assert f" kg more near node {node} at " in text
        assert float(text.split()[2]) == pytest.approx(kg, rel=0.15)
    else:
        assert float(text.partition(" times as stiff")[0].split()[-1]) == pytest.approx(times, rel=0.4)


@pytest.mark.parametrize(("rate", "is_told"), [(12.0, True), (0.0, False)])
def test_a_window_in_all_jobs_is_no_damping_of_the_material(tmp_path: Path, rate: float, is_told: bool) -> None:
    """It moves the axis from s to s + rate; a loss factor that a calibration found instead is taken back."""
    _, source, _ = on_feet(tmp_path, 0.0)
    hz = np.arange(20.0, 400.0, 0.5)
    s = 2j * np.pi * hz + rate
    parameters = source.parameters(s)
    own = measurement(hz, source.model(s, parameters).frf(parameters.initial))
    text = windowed_text(source, "tight", own, {})
    assert bool(text) is is_told
    if is_told:
        assert text.startswith("job tight: all ")
        assert float(text.partition("by the same ")[2].split()[0]) == pytest.approx(rate, rel=0.15)
        assert "model.damping.structure: alpha: " in text
        assert source.stage is not None
        beta = {"beta.structure": 3.0}
        assert windowed_text(multiplied(source, affine_model(source.inputs, source.stage), beta), "tight", own, beta) == text


@pytest.mark.parametrize(("speed", "is_told"), [(1.0, True), (1.05, False)], ids=["others as the model", "others as the reference"])
def test_air_of_the_calibration_job_alone_is_no_error_of_the_model(tmp_path: Path, speed: float, is_told: bool) -> None:
    lost = np.array([0.0, 1.5, 0.0, 0.0, 0.0, 0.0])
    folder = box(tmp_path, {"other": (BOX_TRUTH["tight"] - lost, speed), "again": (BOX_TRUTH["tight"], speed)})
    inputs = read_as_exported(load_campaign(folder.path / "campaign.yaml"))
    source = _source(inputs, tmp_path / "none", lambda _: None)
    assert source is not None
    assert source.stage is not None
    jobs = {name: read_measurement(inputs, job, name) for name, job in inputs.campaign.jobs.items()}
    for factors in ({SOUND_SPEED: 1.05}, {"stiffness.acoustic": 1.05**2}):
        calibrated = multiplied(source, affine_model(inputs, source.stage), factors)
        text = own_air_text(calibrated, jobs, factors, "tight")
        assert bool(text) is is_told
        if is_told:
            assert text.startswith("job tight: probably measured in air about 30 K warmer than the other jobs: its calibration ")
            assert " other jobs are nearer to the model without that (" in text
    # A usual factor is no doubt.
    assert own_air_text(calibrated, jobs, {SOUND_SPEED: 1.02}, "tight") == ""


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, ""),
        ({"air": 20.0}, "With a damping of the air of about 10 times that of the reference job a coarse fit leaves"),
        ({"clock": 1.09}, "With all its frequencies times about "),
        ({"clock": 0.92}, "With all its frequencies times about "),
        ({"mass": 30.0}, "Check whether more changed than the bolts: something added, removed or in contact"),
    ],
    ids=["nothing", "absorber", "slow clock", "fast clock", "mass"],
)
def test_what_else_changed_in_a_job_is_told(tmp_path: Path, changed: dict[str, float], said: str) -> None:
    lost = np.array([0.0, 1.5, 0.0, 0.0, 0.0, 0.0])
    folder = box(tmp_path, {"other": (BOX_TRUTH["tight"] - lost, 1.0)}, {"other": changed})
    found = [text for text in told(folder.path) if text.startswith("job other")]
    if not said:
        assert found == []
        return
    (text,) = found
    assert text.startswith("job other: no state of the bolts explains it: ")
    assert said in text
    if "clock" in changed:
        assert float(text.partition("times about ")[2].partition(" ")[0]) == pytest.approx(changed["clock"], rel=4e-3)


def test_a_sensor_moved_in_a_job_with_a_loose_bolt_is_found_where_it_was(tmp_path: Path) -> None:
    lost = np.array([0.0, 1.5, 0.0, 0.0, 0.0, 0.0])
    folder = box(tmp_path, {"other": (BOX_TRUTH["tight"] - lost, 1.0)}, {"other": {"moved": 5}})
    (text,) = (text for text in told(folder.path) if text.startswith("job other"))
    assert text.startswith("job other: mic2 differs from ")
    assert "Check whether the sensor was moved: at or near node 117, " in text
    assert text.endswith("Measure it again, or remove its record from the file of other")


@pytest.mark.parametrize(
    ("pressures", "motions", "is_told"),
    [(4.2, 2.4, True), (4.2, 2.9, False), (2.9, 1.0, False), (4.2, 3.5, False)],
    ids=["the air alone", "hardly better", "small", "both"],
)
def test_pressures_alone_that_no_bolt_explains(pressures: float, motions: float, is_told: bool) -> None:
    campaign = SimpleNamespace(update=SimpleNamespace(reference="tight"))
    own, usual, air = np.array([pressures, pressures, motions]), np.array([1.5, 1.5, 1.2]), np.array([True, True, False])
    left = {"tight": 1.0, "a": 1.4, "own": float(np.median(own))}
    source: Any = SimpleNamespace(inputs=SimpleNamespace(campaign=campaign), away={"a": usual, "own": own}, left=left)
    text = _airborne(source, "own", own, air, 2.0)
    assert bool(text) is is_told
    assert not text or text.startswith(
        "no state of the bolts explains its pressures: 4.2 dB are left (mean level of each response removed), 1.5"
    )
    # Jobs that a state of the table explains are not fitted; what was not measured is not explained.
    assert bool(_airborne(replaced(source, away={"own": own}), "own", own, air, 2.0)) is is_told
    assert _airborne(source, "own", np.array([pressures, pressures, 0.0]), air, 2.0) == ""
    # A model with errors of this size in all jobs says nothing of one.
    assert _airborne(replaced(source, away={"a": own, "own": own}), "own", own, air, 2.0) == ""


@pytest.mark.parametrize(
    ("left", "words"), [(1.2, ""), (3.8, ". But tight itself is 3.8 dB from the model: look first for an error of the model")]
)
def test_an_error_of_the_model_is_named_first_where_the_tight_state_is_not_explained(left: float, words: str) -> None:
    """A joint at a wrong place showed in one job only, whose measurement was right."""
    source: Any = SimpleNamespace(left={"tight": left})
    text = _of_model(source, "tight")
    assert text.startswith(words)
    assert bool(text) is bool(words)


def replaced(source: Any, **given: Any) -> Any:
    return SimpleNamespace(**{**vars(source), **given})


@pytest.mark.parametrize("coarse", [("mic1", "mic2", "mic3"), ("mic1",), ("acc1",)])
@pytest.mark.slow
def test_lines_that_some_records_lack_are_no_clock(tmp_path: Path, coarse: tuple[str, ...]) -> None:
    """Records on every second line: a factor that moves them off all lines would leave nothing, and so explain everything."""
    lost = np.array([0.0, 1.5, 0.0, 0.0, 0.0, 0.0])
    folder = box(tmp_path, {"other": (BOX_TRUTH["tight"] - lost, 1.0)}, {"other": {"mass": 30.0}})
    path = tmp_path / "data" / "other.uff"
    found = read_frf(path)
    records = tuple(
        replace(one, frequency_hz=one.frequency_hz[::2], values=one.values[::2]) if one.name in coarse else one for one in found.records
    )
    write_frf(path, replace(found, records=records))
    said = [text for text in told(folder.path) if text.startswith("job other")]
    assert said
    assert not any("all its frequencies" in text for text in said)
    assert not any("not compared" in text for text in told(folder.path))


def test_a_record_wrong_in_the_reference_job_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sensor at a wrong place is far off in all jobs; one that was overloaded in one job only there."""
    campaign = SimpleNamespace(update=SimpleNamespace(reference="tight"))
    inputs: Any = SimpleNamespace(
        campaign=campaign, responses=[SimpleNamespace(name=f"a{k}", input=0, node=k, direction=3) for k in range(6)]
    )
    model = modal(HZ, responses=6)
    values = model.copy()
    values[:, 2] = modal(HZ, 7, 6)[:, 2]
    monkeypatch.setattr(all_jobs.Seen, "of", lambda *_: seen(values, model[None], hz=HZ, inputs=inputs))
    (alone,) = all_jobs.single_responses(inputs, np.array([1.0, 1, 9, 1, 1, 1]), [2], "the model")
    for others, right in ((1.2, True), (9.0, False)):
        usual = np.array([1.0, 1.0, others, 1.0, 1.0, 1.0])
        source: Any = SimpleNamespace(inputs=inputs, away={f"s{k}": usual for k in range(5)})
        (found,) = of_one_sensor(source, {"tight": None}, [alone])  # type: ignore[dict-item]
        assert ("the model in this job alone" in found.text) is right
        assert ("overloaded" in found.text) is right
        assert ("the place and the component" in found.text) is not right


def test_other_places_of_the_sensors_that_fit_worst_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pump casing, a sensor 50 mm from its stated place: 3.4 dB there and 2.1 dB at the true node, and nothing was said."""
    responses = [SimpleNamespace(name=f"a{k}-h{h}", input=h, node=k, direction=3) for h in range(2) for k in range(4)]
    inputs: Any = SimpleNamespace(campaign=SimpleNamespace(update=SimpleNamespace(reference="tight")), responses=responses)
    every, asked = np.array([1.0, 2.6, 2.9, 2.2, 1.2, 2.5, 2.5, 2.1]), list[int]()
    monkeypatch.setattr(all_jobs.Seen, "of", lambda *_: SimpleNamespace(measured=None, model=None))
    monkeypatch.setattr(all_jobs, "apart", lambda *_: every)

    def place(_: Any, response: int, share: float) -> str:
        asked.append(response)
        assert share == NEARER
        return "; at node 7 it would differ by 1.0 dB" if response == 1 else ""

    monkeypatch.setattr(all_jobs, "sensor_text", place)
    source: Any = SimpleNamespace(inputs=inputs)
    found = misplaced_sensor(source, {"tight": None})  # type: ignore[dict-item]
    assert asked == [2, 1]
    assert [(each.responses, each.job) for each in found] == [((1,), "tight"), ((5,), "tight")]
    assert all(each.text.endswith("at node 7 it would differ by 1.0 dB") for each in found)
    # A record without values does not count, and near enough to the model none is asked.
    every[5] = 0.0
    assert len(misplaced_sensor(source, {"tight": None})) == 2  # type: ignore[dict-item]
    every -= 1.0
    assert misplaced_sensor(source, {"tight": None}) == []  # type: ignore[dict-item]
    assert asked == [2, 1, 2, 1]


def test_a_sensor_that_alone_is_far_off_in_a_job_near_the_tight_state() -> None:
    """Turned or moved in one job: nothing was said, as the median over all responses is near."""
    responses = [SimpleNamespace(name=f"a{k}-h{h}", input=h, node=k, direction=3) for h in range(2) for k in range(4)]
    inputs: Any = SimpleNamespace(responses=responses, statistics=SimpleNamespace(errors=ErrorModel()))
    usual = np.array([0.8, 0.7, 4.0, 0.9, 0.8, 0.6, 3.0, 0.9])
    others = {f"s{k}": usual for k in range(4)}
    moved = usual.copy()
    moved[[1, 5]] = 4.0, 3.0
    (found,) = all_jobs.astray_sensor(inputs, "own", others | {"own": moved})
    assert found.responses == (1, 5)
    assert found.text.startswith("the FRFs of one sensor (a1-h0, a1-h1) are 3.5 dB from")
    # An error of the model is in all jobs; one FRF alone, or a state in which all are far, is no sensor.
    alone, far = usual.copy(), usual + 3.0
    alone[1] = 9.0
    for own in (usual, alone, far):
        assert not all_jobs.astray_sensor(inputs, "own", others | {"own": own})
    # With few jobs there is nothing to compare with but the other sensors.
    assert all_jobs.astray_sensor(inputs, "own", {"own": np.where(usual > 2.0, 0.9, moved)})


def test_a_record_that_was_overloaded_in_one_job() -> None:
    """Its sensor is right at the other hammer point, the hammer at the other sensors, and the record in the other jobs."""
    responses = [SimpleNamespace(name=f"a{k}-h{h}", input=h, node=k, direction=3) for h in range(2) for k in range(4)]
    inputs: Any = SimpleNamespace(responses=responses, input_of=np.repeat([0, 1], 4))
    usual = np.array([1.3, 1.2, 1.4, 1.3, 1.2, 1.3, 1.2, 1.4])
    others, clipped = {f"s{k}": usual for k in range(4)}, usual.copy()
    clipped[1] = 4.0
    assert all_jobs.odd_records(inputs, "own", others | {"own": clipped}) == [1]
    moved, struck, modelled = clipped.copy(), clipped.copy(), {name: clipped for name in others}
    moved[5], struck[[0, 2, 3]] = 4.0, 4.0
    for away in (others | {"own": moved}, others | {"own": struck}, modelled | {"own": clipped}, {"own": clipped}):
        assert all_jobs.odd_records(inputs, "own", away) == []


def test_springs_without_any_effect() -> None:
    """Two groups: beside one that has an effect the other may be without."""
    model = modal(HZ, responses=6)
    groups = [SimpleNamespace(name=name, kind="stiffness") for name in ("axial", "rocking")]
    parameters: Any = SimpleNamespace(
        initial=np.zeros(2), bounds=np.array([[-3.0, 3.0]] * 2), placed=[(groups[0], slice(0, 1), None), (groups[1], slice(1, 2), None)]
    )

    def text(effect: np.ndarray, *, every: bool) -> str:
        other = model * 10.0 ** (np.random.default_rng(3).normal(0.0, 3.0, model.shape) / 20.0)
        frf = lambda theta: other if (effect * theta).any() else model  # noqa: E731
        source: Any = SimpleNamespace(model=lambda *_: SimpleNamespace(frf=frf), inputs=None, known={})
        return idle_text(seen(model, model[None], hz=HZ, source=source, parameters=parameters), every=every)

    assert text(np.array([1.0, 1.0]), every=False) == ""
    assert text(np.array([1.0, 0.0]), every=True) == ""
    assert "the springs of parameters.rocking have no effect" in text(np.array([1.0, 0.0]), every=False)
    assert "the springs of parameters.axial and parameters.rocking have no effect" in text(np.zeros(2), every=True)


def test_factors_at_their_bounds_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not those of the damping, which a measurement often leaves open."""
    monkeypatch.setattr(fitted, "multiplied", lambda source, *_: source)
    monkeypatch.setattr(fitted, "moves_resonances", lambda _, name: not name.startswith("alpha"))
    names, source = ("part_2", "alpha.structure"), Looking(inputs=SimpleNamespace(), stage=None, kind="port")  # type: ignore[arg-type]
    known: dict[str, Any] = {"names": names, "model": SimpleNamespace(recipe=None), "bounds": np.log([[0.74, 1.35], [0.1, 10.0]])}
    problem: Any = SimpleNamespace(parameters=SimpleNamespace(size=0, by_group=lambda _: {}), **known)
    assert at_bounds_text(fitted._calibrated_by(source, problem, np.log([1.2, 10.0])), 2.6) == ""
    far = fitted._calibrated_by(source, problem, np.log([1.35, 10.0]))
    assert at_bounds_text(far, 2.6).startswith("a rough calibration moves part_2 to 1.35, the most that it allows, and 2.6 dB are left")


def test_the_hammer_hit_twice_at_one_point_only() -> None:
    """Sensors of one hammer point alone show it, so not all responses of the job do."""
    twice, right = 1.0 + 0.4 * np.exp(-2j * np.pi * HZ * 0.018), modal(HZ, responses=6)
    statistics = SimpleNamespace(blows=BLOWS, modal=ModalRule())
    responses = [SimpleNamespace(name=f"a{k}") for k in range(6)]
    campaign = SimpleNamespace(update=SimpleNamespace(baselines=()))
    known: dict[str, Any] = {"responses": responses, "recipe": SimpleNamespace(names=()), "statistics": statistics, "campaign": campaign}
    inputs: Any = SimpleNamespace(excitations=("h1", "h2"), input_of=np.repeat([0, 1], 3), **known)
    noise = 10.0 ** (np.random.default_rng(3).normal(0.0, 0.5, right.shape) / 20.0)
    struck = right.copy()
    struck[:, 3:] *= twice[:, None]
    assert chain_doubt(inputs, measurement(HZ, right * noise), measurement(HZ, right), "tight") is None
    for own, tight, where in ((struck, right, "this job"), (right, struck, "tight")):
        fault = chain_doubt(inputs, measurement(HZ, own * noise), measurement(HZ, tight), "tight")
        assert fault is not None
        assert fault.kind == "blow"
        assert fault.text.startswith(f"the hammer probably hit a second time at h2 in {where}, 1")
