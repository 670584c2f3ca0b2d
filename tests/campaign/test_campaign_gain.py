"""A job whose hammer was 12 % off, or a campaign: bolts were called loose; and a plane of symmetry."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import frame as make_frame
from campaigns import lrbc
from samples import ROOT, reduced_cache

from lrbc_cli import load
from lrbc_cli.campaign.identification.compared.astray import astray
from lrbc_cli.campaign.identification.gains import Gains, everything, kept, sharers
from lrbc_cli.campaign.reading.doubts.rigid import symmetry_doubt
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.updating.statistics.error_model import ErrorModel


@pytest.mark.parametrize("decibels", [0.0, 1.0, -1.0])
@pytest.mark.slow
def test_a_gain_of_all_responses_makes_no_bolt_loose(tmp_path: Path, decibels: float) -> None:
    folder = make_frame(tmp_path)
    factor = f"{10.0 ** (decibels / 20.0):.6f}"
    scale = "{" + ", ".join(f"acc{k}: {factor}" for k in range(1, 5)) + "}"
    line = ["--job", "tight", "--job", "loose-2"] + (["--override", f"jobs.loose-2.scale={scale}"] if decibels else [])
    assert lrbc("update", folder.config, "--cache", reduced_cache("frame"), *line).code == 0
    result = folder.result("loose-2")
    assert {bolt["name"] for bolt in result["bolts"] if bolt["verdict"] == "loose"} == {"B3", "B4"}
    assert result["misfit_db"]["final"] < 0.7
    told = [text for text in result["warnings"] if "no bolt does" in text]
    gain = result["nuisances"].get("common_gain_db")
    if not decibels:
        assert not told
        assert gain is None
        return
    assert abs(gain["value"] - decibels) < 0.1
    # Bolts are judged, but such a job is no all-clear.
    assert result["validity"]["passed"] is None
    assert "than expected from the reference job" in result["validity"]["reason"]
    assert "higher" in told[0] if decibels > 0 else "lower" in told[0]
    # What stands there already is kept.
    assert "jobs.loose-2.scale: {acc1: " in told[0]
    assert abs(float(told[0].partition("acc1: ")[2].partition(",")[0]) - 1.0) < 0.02


@pytest.mark.parametrize("times", [1.2, 0.8, 1.5])
@pytest.mark.slow
def test_a_gain_of_one_sensor_is_told_and_makes_no_bolt_loose(tmp_path: Path, times: float) -> None:
    """A factor of 1.2 of one sensor in one job had passed as an all-clear, without a word."""
    folder = make_frame(tmp_path)
    line = ["--job", "tight", "--job", "loose-2", "--override", f"jobs.loose-2.scale={{acc2: {times}}}"]
    assert lrbc("update", folder.config, "--cache", reduced_cache("frame"), *line).code == 0
    result = folder.result("loose-2")
    assert {bolt["name"] for bolt in result["bolts"] if bolt["verdict"] == "loose"} == {"B3", "B4"}
    assert "common_gain_db" not in result["nuisances"]
    ((name, gain),) = result["nuisances"]["gain_db"].items()
    assert name == "acc2"
    assert abs(gain["value"] - 20.0 * np.log10(times)) < 0.2
    assert result["validity"]["passed"] is None
    (text,) = [text for text in result["warnings"] if "no bolt does" in text]
    size = abs(10.0 ** (gain["value"] / 20.0) - 1.0)
    assert f"the FRF acc2 is {size:.0%} {'higher' if times > 1.0 else 'lower'} (" in text
    assert abs(float(text.partition("scale: {acc2: ")[2].partition("}")[0]) - 1.0) < 0.03


@pytest.mark.slow
def test_right_jobs_of_the_plate_have_no_gain(tmp_path: Path) -> None:
    """Where two bolts change much, errors of predicted changes alone allowed for 1.5 dB, which left three times as much as without."""
    study = load(ROOT / "configs" / "plate.yaml", cache=tmp_path, calibration=False)
    reference = study.identify("tight-1")
    for job in ("tight-2", "b5-loose", "b3-half-b4-loose"):
        found = study.identify(job, reference=reference)
        assert found.identification.gains is None
        assert found.misfit_db < 1.0


@pytest.mark.parametrize(("elsewhere", "told"), [([0.9, 1.1, 1.0], True), ([0.1, 0.2, 0.0], False), ([], True), ([np.nan], True)])
def test_a_gain_shows_where_damping_does_not(elsewhere: list[float], told: bool) -> None:
    """About resonances a change of the damping is a gain, too; without other lines nothing tells them apart."""
    inputs = load(ROOT / "configs" / "frame.yaml", calibration=False).inputs
    above = np.repeat(np.array(elsewhere)[:, None], 3, axis=1)
    for shared in (everything(inputs), None):
        gains = Gains(np.full(3, 1.0), np.full(3, 0.1), shared)
        assert kept(inputs, gains, (1.2, 0.8), above) is told
        # What leaves more is none, nor is one that a measuring chain may have.
        assert not kept(inputs, gains, (0.8, 1.2), above)
        assert kept(inputs, gains, (0.82, 0.8), above) is (told and shared is not None)
        assert not kept(inputs, Gains(np.full(3, 0.35), np.full(3, 0.1), shared), (1.2, 0.8), above)
    assert not kept(inputs, None, (1.2, 0.8), above)


def test_the_sensor_or_hammer_whose_levels_alone_differ_is_asked_for() -> None:
    # Two sensors and two hammer points, and a third sensor for one of them.
    near = {"acc1": "[20, 100, 4]", "acc2": "[106.667, 180, 4]"}
    again = [f"responses.{name}b={{near: {place}, component: UZ, quantity: acceleration, excitation: h2}}" for name, place in near.items()]
    first = [f"responses.acc{k}.excitation=hammer" for k in range(1, 6)]
    hammer = "excitation.h2={near: [236.667, 60, 4], component: UZ}"
    names = "[acc1, acc1b, acc2, acc2b, acc3]"
    overrides = [hammer, *again, *first, f"update.responses={names}"]
    inputs = load(ROOT / "configs" / "plate.yaml", overrides=overrides, calibration=False).inputs

    def asked(*levels: float) -> list[tuple[str, set[str]]]:
        placed = dict(zip(("acc1", "acc1b", "acc2", "acc2b", "acc3"), levels, strict=True))
        found = sharers(inputs, np.array([[placed[inputs.responses[at].name] for at in inputs.used]]))
        return [(group.kind, {inputs.responses[at].name for at in group.responses}) for group in found]

    every = ("all", {response.name for response in inputs.responses})
    assert asked(1.5, 1.4, 0.1, -0.2, 0.0) == [("sensor", {"acc1", "acc1b"}), every]
    assert asked(0.0, 0.1, 0.1, -0.2, -1.5) == [("sensor", {"acc3"}), every]
    assert asked(0.1, -1.5, 0.0, -1.2, 0.1) == [("hammer point", {"acc1b", "acc2b"}), every]
    # A response without values says nothing.
    assert asked(1.5, 1.4, 0.1, np.nan, 0.0) == [("sensor", {"acc1", "acc1b"}), every]
    # Below the accuracy of a measuring chain, in two directions, of others as well, or of all.
    for levels in ((0.28, 0.25, 0.0, 0.0, 0.0), (1.5, -1.5, 0.0, 0.0, 0.0), (1.5, 1.4, 0.9, 0.0, 0.0), (1.5, 1.5, 1.5, 1.5, 1.5)):
        assert asked(*levels) == [every]


@pytest.mark.parametrize("beyond", [1.6, 1.4])
def test_a_sensor_or_hammer_point_that_alone_does_not_fit_is_named(beyond: float) -> None:
    """A sensor turned to another axis had a misfit of 12 dB beside an all-clear: the robust cost leaves out what does not fit."""
    responses = [
        SimpleNamespace(name=f"a{k}-h{h + 1}", node=k, direction="UZ", input=h, excitation=f"h{h + 1}") for h in range(2) for k in range(4)
    ]
    campaign = SimpleNamespace(update=SimpleNamespace(reference="tight"))
    statistics = SimpleNamespace(errors=ErrorModel())
    inputs: Any = SimpleNamespace(responses=responses, excitations=("h1", "h2"), campaign=campaign, statistics=statistics)

    def told(*excess: float) -> str:
        updated = np.ones((30, 8), dtype=complex)
        measured = updated * 10.0 ** ((1.0 + np.array(excess)) / 20.0)
        expected = updated * 10.0 ** (1.0 / 20.0)
        result: Any = SimpleNamespace(updated=updated, expected=expected, measurement=SimpleNamespace(values=measured))
        text, remedy = astray(inputs, result)
        assert remedy.startswith(text)
        return text

    assert told(*[0.1] * 8) == ""
    moved = told(0.1, 0.2, beyond + 3.0, 0.0, 0.1, 0.2, beyond + 0.1, 0.0)
    assert moved.startswith("the FRFs of one sensor (a2-h1, a2-h2) do not fit: misfit") if beyond > 1.5 else moved == ""
    # One of its two FRFs alone may be an error of the model there.
    assert told(0.1, 0.2, 8.0, 0.0, 0.1, 0.2, 0.1, 0.0) == ""
    struck = told(*[0.0] * 4, beyond, beyond + 0.5, beyond + 1.0, 0.3)
    assert struck.startswith("the FRFs of hammer point h2 do not fit: misfit") if beyond > 1.5 else struck == ""
    # If all are worse, it is no single sensor.
    assert told(*[2.0] * 8) == ""


def test_a_response_that_is_not_used_has_what_the_others_share() -> None:
    inputs = load(ROOT / "configs" / "frame.yaml", calibration=False).inputs
    np.testing.assert_allclose(Gains(np.array([1.0, 2.0, 3.0]), np.ones(3), None).over(inputs), [1.0, 2.0, 3.0, 1.5])
    np.testing.assert_allclose(Gains(np.ones(3), np.ones(3), everything(inputs)).over(inputs), np.ones(4))


@pytest.mark.parametrize(
    "decibels",
    [(1.0,) * 4, pytest.param((-1.0,) * 4, marks=pytest.mark.slow), pytest.param((1.2, -1.5, 0.3, -0.3), marks=pytest.mark.slow)],
)
@pytest.mark.slow
def test_sensitivities_that_are_off_in_all_jobs_make_no_bolt_loose(tmp_path: Path, decibels: tuple[float, ...]) -> None:
    """The levels of the reference job and the damping made up for them, and tight neighbours of loose bolts were called loose."""
    folder = make_frame(tmp_path)
    scale = "{" + ", ".join(f"acc{k}: {10.0 ** (db / 20.0):.6f}" for k, db in enumerate(decibels, 1)) + "}"
    names = ("tight", "loose-2")
    more = [part for name in names for part in ("--override", f"jobs.{name}.scale={scale}")]
    line = [*more, "--cache", reduced_cache("frame")]
    assert lrbc("calibrate", folder.config, *line).code == 0
    calibration = json.loads((folder.out / "calibration.json").read_text())
    assert lrbc("update", folder.config, *line, *(part for name in names for part in ("--job", name))).code == 0
    tight, loose = folder.result("tight"), folder.result("loose-2")
    for found in (calibration["gain_db"], tight["nuisances"]["gain_db"]):
        assert all(abs(found[f"acc{k}"]["value"] - db) < 0.4 for k, db in enumerate(decibels[:3], 1))
        assert found["acc4"]["std"] is None
    told = "all FRFs are " if decibels[0] == decibels[1] else "FRFs are higher or lower (acc1 "
    for warnings in (calibration["warnings"], tight["warnings"]):
        (text,) = [text for text in warnings if "than expected from the model" in text]
        assert told in text
    assert abs(calibration["factors"]["damping.structure"]["value"] - 1.0) < 0.1
    # All jobs share them: nothing is said of the others, and they are judged and validated.
    assert not loose["nuisances"].get("common_gain_db")
    assert not loose["warnings"]
    assert {bolt["name"] for bolt in loose["bolts"] if bolt["verdict"] == "loose"} == {"B3", "B4"}
    assert loose["validity"]["passed"] is True
    for result in (calibration, tight, loose):
        assert result["misfit_db"]["final"] < 0.7


def table(*held: str) -> tuple[sp.csc_array, DofTable]:
    """Nodes of a block; those at its end lack some components."""
    xyz = np.array([[x, y, z] for x in (0.0, 0.1, 0.2) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    rows = [(k, c, p) for k, p in enumerate(xyz) for c in ("UX", "UY", "UZ") if not (p[0] == 0.2 and c in held)]
    dofs = DofTable(
        node=np.array([k for k, _, _ in rows]), component=np.array([c for _, c, _ in rows]), xyz=np.array([p for _, _, p in rows])
    )
    return sp.eye_array(dofs.size, format="csc"), dofs


def test_a_plane_of_symmetry_is_told_from_a_support():
    assert "at the nodes of an outer plane, x = 0.2 m, only UX is held" in str(symmetry_doubt(*table("UX")))
    for held in ((), ("UX", "UY", "UZ"), ("UY",), ("UX", "UY")):
        assert symmetry_doubt(*table(*held)) is None
