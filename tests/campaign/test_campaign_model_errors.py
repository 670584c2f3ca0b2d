"""Errors of the model that ``lrbc check`` names by themselves: a part, some joints, a constraint at a bolt, the damping, the masses."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import grillage
import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse as sp
from campaigns import Folder
from systems import csc

from lrbc_cli.campaign.findings import Finding
from lrbc_cli.campaign.identification.compared.offsets import factors_of
from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.looking.causes import damped
from lrbc_cli.campaign.looking.causes.parts import _cause
from lrbc_cli.campaign.looking.first_look import _source, _without_sensors
from lrbc_cli.campaign.reading.doubts.materials import too_heavy
from lrbc_cli.campaign.reading.inputs import read_as_exported
from lrbc_cli.config import load_campaign
from lrbc_cli.io.frf import write_frf
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.frf import FrfRecord, FrfSet
from lrbc_cli.model.units import SI

#: Places (i, j) of the springs between base and lid, and of those from base to ground; three components each.
LID = {"L1": (0, 0), "L2": (6, 0), "L3": (0, 4), "L4": (6, 4), "L5": (3, 2)}
FEET = {"F1": (1, 0), "F2": (5, 0), "F3": (1, 4), "F4": (5, 4)}
STIFFNESS = {"UZ": 2e5, "ROTX": 80.0, "ROTY": 80.0}
SENSORS = {"a1": (0, (1, 1)), "a2": (1, (5, 3)), "a3": (1, (4, 1)), "a4": (0, (2, 3)), "a5": (1, (1, 3)), "a6": (0, (5, 1))}
ALPHA, BETA = 15.0, 1e-5


def at(part: int, place: tuple[int, int], component: str) -> int:
    """Number of a DOF of base (0) or lid (1)."""
    return 105 * part + grillage.dof(*place, component)


def assembled(stiffness: float, mass: float, springs: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """K with springs, and M, of base and lid, two grillages, the lid's times these factors."""
    K, M = grillage.matrices()
    K, M = scipy.linalg.block_diag(K, stiffness * K), scipy.linalg.block_diag(M, mass * M)
    for name, place in (LID | FEET).items():
        for component, size in STIFFNESS.items():
            b = np.zeros(K.shape[0])
            b[at(0, place, component)] = 1.0
            if name in LID:
                b[at(1, place, component)] = -1.0
            K += springs.get(name, 1.0) * size * np.outer(b, b)
    return K, M


def two_parts(path: Path, *, stiffness: float = 1.0, mass: float = 1.0, springs: dict[str, float] | None = None) -> Folder:
    """A campaign of base and lid; the structure differs from the model by these factors on the lid and on springs."""
    data = path / "data"
    data.mkdir(parents=True)
    K, M = assembled(1.0, 1.0, dict.fromkeys(LID | FEET, 0.0))
    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(data / f"{name}.mtx", sp.coo_array(matrix), symmetry="symmetric", precision=17)
    rows = ["dof,node,component,x,y,z"]
    for part in (0, 1):
        for j in range(grillage.NY):
            for i in range(grillage.NX):
                xyz = f"{grillage.DX * i:.6f},{grillage.DY * j:.6f},{0.05 * part:g}"
                rows += [f"{at(part, (i, j), c)},{1000 * part + grillage.node(i, j)},{c},{xyz}" for c in STIFFNESS]
    (data / "dofs.csv").write_text("\n".join(rows) + "\n")
    rows = ["bolt,node_a,node_b,component,stiffness"]
    for name, place in (LID | FEET).items():
        other = str(1000 + grillage.node(*place)) if name in LID else ""
        rows += [f"{name},{grillage.node(*place)},{other},{c},{size:g}" for c, size in STIFFNESS.items()]
    (data / "bushings.csv").write_text("\n".join(rows) + "\n")
    rng, hz = np.random.default_rng(5), np.arange(20.0, 401.0, 2.0)
    joints = {name: (springs or {}).get(name, 1.0) * 10.0 ** (0.04 * rng.standard_normal()) for name in LID | FEET}
    K, M = assembled(stiffness, mass, joints)
    force = np.zeros(K.shape[0])
    force[at(0, (2, 1), "UZ")] = 1.0
    own = [at(part, place, "UZ") for part, place in SENSORS.values()]
    s = 2j * np.pi * hz
    y = np.array([each**2 * np.linalg.solve(each**2 * M + each * (ALPHA * M + BETA * K) + K, force)[own] for each in s])
    y *= 1.0 + 0.01 * (rng.standard_normal(y.shape) + 1j * rng.standard_normal(y.shape))
    records = tuple(FrfRecord(name=name, frequency_hz=hz, values=y[:, k], quantity="acceleration") for k, name in enumerate(SENSORS))
    write_frf(data / "tight.uff", FrfSet(source="tight", records=records))
    folder = Folder(path)
    folder.write(
        {
            "campaign": "two parts",
            "output": "out",
            "model": {
                "stiffness": "data/K.mtx",
                "mass": "data/M.mtx",
                "damping": {"structure": {"alpha": ALPHA, "beta": BETA}},
                "dofs": "data/dofs.csv",
            },
            "excitation": {"hammer": {"node": grillage.node(2, 1), "component": "UZ"}},
            "responses": {
                name: {"node": 1000 * part + grillage.node(*place), "component": "UZ", "quantity": "acceleration"}
                for name, (part, place) in SENSORS.items()
            },
            "parameters": {"joints": {"select": {"bushings": "data/bushings.csv"}}},
            "reduction": {"band": [20.0, 400.0], "tolerance": 1e-4},
            "update": {"responses": list(SENSORS)[:5], "lines": "all", "reference": "tight"},
            "calibration": {"job": "tight", "factors": ["stiffness.structure", "mass.structure"]},
            "jobs": {"tight": {"frf": "data/tight.uff"}},
        }
    )
    return folder


def told(folder: Folder) -> str:
    """Warnings of ``lrbc check``."""
    done = folder.run("check")
    assert done.code == 0, done.stderr
    return done.stdout.partition("\nwarnings\n")[2]


def test_a_right_model_of_two_parts_is_no_finding(tmp_path: Path) -> None:
    assert "job tight" not in told(two_parts(tmp_path / "right"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness", "mass", "cause"),
    [
        (1.95, 1.25, r"The thickness of plates, or the height of beams, is probably 1\.2\d? times too small"),
        (0.55, 1.0, r"The modulus is probably 1\.[6-9] times too large"),
    ],
)
def test_a_part_that_is_wrong_by_any_factor_is_named(tmp_path: Path, stiffness: float, mass: float, cause: str) -> None:
    """Here the lid; the base is right."""
    text = told(two_parts(tmp_path / "wrong", stiffness=stiffness, mass=mass))
    assert re.search(r"with the stiffness of the part of \d+ nodes at x 0 to 0\.6, y 0 to 0\.36, z 0\.05 m times", text), text
    assert re.search(cause, text), text


def test_joints_a_decade_too_soft_are_named(tmp_path: Path) -> None:
    """With a calibration or without."""
    folder = two_parts(tmp_path / "joints", springs=dict.fromkeys(FEET, 30.0))
    text = told(folder)
    assert "a rough calibration from this job raises the stiffness of F1 (by 1.4 decades, a factor of 2" in text
    assert "F4 (by 1.5 decades" in text
    assert "L1" not in text
    tree = folder.tree()
    del tree["calibration"]
    folder.write(tree)
    text = told(folder)
    found = re.search(r"with those of (.*?) about (\S+) times as stiff, and the others nearly as stated", text)
    assert found is not None, text
    assert found[1] == ", ".join(FEET)
    assert float(found[2]) == pytest.approx(30.0, rel=0.1)
    assert "Check their stiffnesses and units in bushings.csv and in the FE model" in text


def test_two_loose_bolts_in_the_reference_job_are_told_before_a_calibration_takes_them_up(tmp_path: Path) -> None:
    """Four decibels: less than a model that has little in common with the structure leaves."""
    text = told(two_parts(tmp_path / "loose", springs={"L1": 0.01, "L2": 0.01}))
    assert "With L1, L2 free the level misfit is 0.5 dB: check whether all bolts were tight. If they were not, set update.reference" in text


def test_a_constraint_at_one_bolt_is_told_without_a_measurement(tmp_path: Path) -> None:
    folder = two_parts(tmp_path / "held")
    K = scipy.io.mmread(folder.data / "K.mtx").tolil()
    K[at(0, FEET["F2"], "UZ"), at(0, FEET["F2"], "UZ")] += 1e9
    scipy.io.mmwrite(folder.data / "K.mtx", K.tocoo(), symmetry="symmetric", precision=17)
    text = told(folder)
    assert "contains 0 times the springs of bushings.csv, as the baseline says, but more at F2 (UZ 5e+03 times)" in text
    assert "Check whether a boundary condition or a contact was left in the FE model there" in text


@pytest.mark.parametrize(
    ("stiffness", "mass", "words"),
    [
        (0.512, 0.8, "thickness of plates, or the height of beams, is probably 1.2 times too large"),
        (2.9, 2.9, "Modulus and density are probably both 2.9 times too small"),
        (1.0, 1.4, "density is probably 1.4 times too small, or a mass there is missing in the model"),
        (1.0, 0.5, "density is probably 2 times too large, or a mass there is not on the structure"),
        (0.5, 1.0, "modulus is probably 2 times too large"),
    ],
)
def test_what_multiplies_stiffness_and_mass(stiffness: float, mass: float, words: str) -> None:
    assert words in _cause(float(np.log(stiffness)), float(np.log(mass)))


@pytest.mark.parametrize(
    ("mass", "flat", "one", "doubt"), [(2.0, 1.0, 0.0, False), (2000.0, 1.0, 0.0, True), (0.02, 0.01, 0.0, False), (2.0, 1.0, 1e9, False)]
)
def test_masses_that_no_material_has(mass: float, flat: float, one: float, doubt: bool) -> None:
    """Eight times two kilograms in a litre, a thousand times as much, the same in a plate, and one mass that only fixes a motion."""
    xyz = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1 * flat)])
    node, component = np.repeat(np.arange(8), 3), np.tile(["UX", "UY", "UZ"], 8)
    dofs = DofTable(node=node, component=component, xyz=np.repeat(xyz, 3, axis=0))
    weights = np.full(24, mass)
    weights[:3] += one
    model: Any = SimpleNamespace(M=csc(np.diag(weights)))
    found = list(too_heavy(model, dofs, SI))
    assert bool(found) is doubt
    # A plate counts as thick as a twentieth of its length.
    sheet = replace(dofs, xyz=dofs.xyz * [1.0, 1.0, 0.01])
    assert bool(list(too_heavy(model, sheet, SI))) is (mass > 1.0)
    if doubt:
        assert "1.4e+04 kg in a box of 0.1 x 0.1 x 0.1 m: 1.4e+07 kg/m³ on average, more than any material" in found[0]
        assert "SI requires kg/m³, 7850 for steel" in found[0]


@pytest.mark.parametrize(("times", "doubt"), [(1.5, False), (8.0, True), (0.1, True), (40.0, False)])
def test_damping_off_by_a_factor_that_no_calibration_corrects(
    frame: Folder, monkeypatch: pytest.MonkeyPatch, times: float, doubt: bool
) -> None:
    """More than 30 times is another message."""
    omega = 2.0 * np.pi * np.array([50.0, 80.0, 120.0, 190.0, 260.0])
    modes = SimpleNamespace(frequency_hz=omega / (2.0 * np.pi), decay=0.01 * omega)
    monkeypatch.setattr(damped, "fitted_modes", lambda *_: modes)
    tree = frame.tree()
    tree["model"]["damping"] = {"structure": {"alpha": 0.0, "beta": 0.0, "loss_factor": 0.02 * times}}
    tree["calibration"]["factors"] = ["stiffness.structure"]
    joints = tree["parameters"]["left_edge"].pop("damping")
    frame.write(tree)
    measurement: Any = SimpleNamespace(frequency_hz=None, values=None)
    text = damped.uncalibrated_text(frame.inputs(), measurement)
    assert bool(text) is doubt
    if text:
        side = "large" if times > 1.0 else "small"
        assert f"the damping of the model is {max(times, 1.0 / times):.2g} times too {side}: damping ratios of" in text
        assert "those of 5 measured resonances 1 to 1 %. Write about loss_factor: 0.02 under model.damping.structure" in text
    # Damping of joints adds to that of the structure.
    tree["parameters"]["left_edge"]["damping"] = joints
    frame.write(tree)
    assert bool(damped.uncalibrated_text(frame.inputs(), measurement)) is (doubt and times > 1.0)
    tree["calibration"]["factors"].append("loss_factor.structure")
    frame.write(tree)
    assert damped.uncalibrated_text(frame.inputs(), measurement) is None


def test_the_gain_of_one_sensor_stands_out_at_two_hammer_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """4 dB beside a model that leaves as much: it explains less than half of the misfit of any response."""
    names = [(f"a{k}-h{h}", k, h) for h in (0, 1) for k in range(6)]
    responses = [SimpleNamespace(name=name, node=k, direction=3, quantity="acceleration", input=h) for name, k, h in names]
    campaign = SimpleNamespace(reduction=SimpleNamespace(band=(20.0, 220.0)))
    inputs: Any = SimpleNamespace(responses=responses, campaign=campaign)
    rng, hz = np.random.default_rng(3), np.linspace(20.0, 220.0, 300)
    model = np.exp(rng.normal(0.0, 1.0, (300, 12)) + 1j * rng.uniform(0.0, 6.0, (300, 12)))
    measured = model * 10.0 ** (rng.normal(0.0, 5.0, (300, 12)) / 20.0)
    measured[:, [4, 10]] *= 1.6

    def named(values: np.ndarray) -> list[str]:
        measurement: Any = SimpleNamespace(frequency_hz=hz, values=values, uncalibrated=False)
        return [responses[o.response].name for o in factors_of(inputs, measurement, [model]) if o.named]

    assert named(measured) == ["a4-h0", "a4-h1"]
    # At one hammer point only it is a place; two sensors are a model.
    once, twice = measured.copy(), measured.copy()
    once[:, 10] /= 1.6
    twice[:, [2, 8]] *= 1.6
    assert named(once) == named(twice) == []


@pytest.mark.parametrize(("stiffness", "fits"), [(1.0, True), (2.2, False)], ids=["one sensor is wrong", "a part is wrong"])
def test_a_wrong_sensor_that_spoils_a_calibration_is_left_out_of_it(tmp_path: Path, stiffness: float, fits: bool) -> None:
    """If all others fit then, no part of the model is looked for."""
    folder = two_parts(tmp_path, stiffness=stiffness)
    inputs = read_as_exported(load_campaign(folder.config))
    whole = read_measurement(inputs, inputs.campaign.jobs["tight"], "tight")
    values = whole.values.copy()
    values[:, 1] = values[::-1, 1]
    source = _source(inputs, tmp_path / "none", lambda _: None)
    assert source is not None
    others = _without_sensors(source, replace(whole, values=values), "tight", [Finding(text="a2 is far", responses=(1,))])
    assert (others is not None) is fits
    if others is not None:
        assert others.note.startswith("compared with a rough calibration from tight without a2, not stored: level misfit ")
        assert others.fitted_to == "tight"
    assert _without_sensors(source, whole, "tight", [Finding(text="all", responses=tuple(range(6)))]) is None
    assert _without_sensors(source, whole, "tight", []) is None
