"""Rigs with joints: their elements, their designs, what is measured, and the files of a campaign."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

pytest.importorskip("skfem", reason="extra `samples`")

from lrbc_cli.campaign.reading.inputs import read_as_exported
from lrbc_cli.config import load_campaign
from lrbc_cli.virtual.drift import Drift, Scatter
from rigs.coupled import factorise, lowest_modes
from rigs.joints.beams import Frame, Member, Section
from rigs.joints.campaign import jobs_of, measure_campaign, write_campaign
from rigs.joints.design import JointDesign
from rigs.joints.designs import ALUMINIUM, JOINT_DESIGNS, STEEL
from rigs.joints.nominal import ensure_model
from rigs.joints.plates import Sheet, plate
from rigs.joints.system import System
from rigs.joints.truth import Rig, State, draw_state

SHEET = Sheet((0.0, 0.0), (0.5, 0.4), 0.0, 0.003, (12, 10), (24, 20))
RING = Sheet((0.15, 0.0), (0.25, 2 * np.pi), 0.0, 0.005, (4, 32), (6, 64), ring=True)

#: The smallest of the four.
FRAME = JOINT_DESIGNS["space-frame"]


def frequencies(system: System, free: np.ndarray, count: int) -> np.ndarray:
    K, M = (m.toarray()[np.ix_(free, free)] for m in (system.stiffness, system.mass))
    values = sl.eigh(K, M, eigvals_only=True, subset_by_index=[0, count - 1])
    return np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)


@pytest.mark.parametrize("true", [False, True], ids=["triangles", "quadrilaterals"])
@pytest.mark.parametrize("sheet", [SHEET, RING], ids=["rectangle", "ring"])
def test_free_plate_has_three_rigid_motions(sheet: Sheet, true: bool) -> None:
    system = plate(sheet, ALUMINIUM, true=true)
    K, M = system.stiffness.toarray(), system.mass.toarray()
    assert np.array_equal(K, K.T)
    assert np.array_equal(M, M.T)
    assert np.linalg.eigvalsh(M)[0] > 0
    found = frequencies(system, np.arange(K.shape[0]), 4)
    assert np.all(found[:3] < 1e-3 * found[3])
    up = (system.component == "UZ").astype(float)
    (r0, _), (r1, _) = sheet.start, sheet.end
    area = np.pi * (r1**2 - r0**2) if sheet.ring else 0.2
    assert up @ M @ up == pytest.approx(2700 * sheet.thickness * area, rel=1e-2 if sheet.ring else 1e-12)


@pytest.mark.parametrize("true", [False, True], ids=["triangles", "quadrilaterals"])
def test_simply_supported_plate(true: bool) -> None:
    system = plate(SHEET, ALUMINIUM, true=true)
    (x, y, _), (a, b) = system.xyz.T, SHEET.end
    edge = (x < 1e-9) | (x > a - 1e-9) | (y < 1e-9) | (y > b - 1e-9)
    rigidity = 70e9 * 0.003**3 / 12 / (1 - 0.33**2)
    waves = np.array([(1, 1), (2, 1), (1, 2), (2, 2)]) * np.pi / SHEET.end
    expected = (waves**2).sum(axis=1) * np.sqrt(rigidity / (2700 * 0.003)) / (2 * np.pi)
    np.testing.assert_allclose(frequencies(system, np.flatnonzero(~(edge & (system.component == "UZ"))), 4), expected, rtol=0.015)


def test_both_elements_agree_on_a_ring() -> None:
    nominal, true = (frequencies(plate(RING, ALUMINIUM, true=t), np.arange(n), 8)[3:] for t, n in ((False, 480), (True, 1344)))
    np.testing.assert_allclose(nominal, true, rtol=0.02)


@pytest.mark.parametrize("true", [False, True], ids=["Euler", "Timoshenko"])
def test_cantilever(true: bool) -> None:
    section = Section(0.02, 0.04, 0.002)
    frame = Frame({"wall": (0, 0, 0), "tip": (1.0, 0.3, 0.2)}, ("wall",), (Member("wall", "tip", section, (True, False)),), 0.0)
    system, [(hub, member)] = frame.assembled(STEEL, 16, true=true)
    assert np.all(hub == -1)
    everything = np.arange(system.node.size)
    assert np.sum(frequencies(system, everything, 6) < 1e-2) == 3  # it turns about the wall
    length = np.linalg.norm([1.0, 0.3, 0.2])
    shapes = np.outer([1.8751, 4.6941], np.sqrt([section.about_z, section.about_y]) ** 0.5).ravel()
    expected = shapes**2 / length**2 * np.sqrt(STEEL.young / (STEEL.density * section.area)) / (2 * np.pi)
    found = frequencies(system, np.setdiff1d(everything, member), 4)
    np.testing.assert_allclose(found, expected, rtol=0.02 if true else 1e-3)
    assert not true or np.all(found < expected)


@pytest.mark.parametrize("design", JOINT_DESIGNS.values(), ids=JOINT_DESIGNS)
def test_design_is_consistent(design: JointDesign) -> None:
    nominal = design.system(None)
    assert 200 <= nominal.node.size <= 2000
    assert set(design.held_out) < set(design.sensors)
    assert max(design.loosened) == len(design.bolts) // 2
    for place in (*design.hammers.values(), *design.sensors.values()):
        at = np.flatnonzero(design.row(nominal, place, true=False))
        assert np.linalg.norm(nominal.xyz[at[0], :2] - place.point[:2]) < 1e-6
    for spring in design.springs:
        a, b = design.nodes(nominal, spring)
        assert nominal.component[a] == spring.component
        assert b < 0 or (nominal.component[b] == spring.component and np.allclose(nominal.xyz[a, :2], nominal.xyz[b, :2]))


@pytest.mark.parametrize("design", JOINT_DESIGNS.values(), ids=JOINT_DESIGNS)
def test_rig_and_nominal_model_are_alike_but_not_equal(design: JointDesign) -> None:
    nominal, stiffness = design.system(None), np.array([s.stiffness for s in design.springs])
    vectors = np.stack([design.vector(nominal, s) for s in design.springs], axis=1)
    springs = sp.csr_array(vectors)
    tight = sp.csr_array(nominal.stiffness + (springs * stiffness) @ springs.T)
    shift = -((2 * np.pi * 5.0) ** 2)
    values, _ = lowest_modes(tight, nominal.mass, 13, shift, factorise(sp.csr_array(tight - shift * nominal.mass)))
    expected = np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)
    rig = Rig(design, design.as_designed())
    terms = rig.rows[:, : stiffness.size]
    found = np.sqrt(np.maximum(np.linalg.eigvalsh(np.diag(rig.values) + (terms * stiffness) @ terms.T), 0.0)) / (2 * np.pi)
    elastic = expected > 0.5 * design.band[0]
    np.testing.assert_allclose(found[:13][elastic], expected[elastic], rtol=0.05)
    assert np.abs(found[:13][elastic] / expected[elastic] - 1).max() > 1e-3


def test_basis_gives_the_rig() -> None:
    """Against the full rig in one state, hysteresis and rubbing joints included."""
    design = replace(FRAME, loss=0.01)
    specimen = design.draw(np.random.default_rng(5))
    state = draw_state(design, specimen, 4, 0.3, np.random.default_rng(6))
    rig = Rig(design, specimen)
    system = design.system(specimen)
    terms = np.stack([design.term(system, s) for s in design.springs], axis=1)
    ends = [design.row(system, rig._moved(n, p), true=True) for n, p in {**design.hammers, **design.sensors}.items()]
    rows = np.stack(ends, axis=1)
    lines = np.array([12.0, 45.0, 126.0, 203.0, 441.0])
    K = system.stiffness.toarray() * (1 + 0.01j * specimen.loss) + (terms * rig.stiffness(state)) @ terms.T
    for line, found in zip(lines, rig.frfs(state, Drift(), lines), strict=True):
        omega = 2 * np.pi * line
        whole = -(omega**2) * rows.T @ np.linalg.solve(K - omega**2 * system.mass.toarray(), rows)
        expected = whole[:3, 3:]
        assert np.linalg.norm(found - expected) < 2e-3 * np.linalg.norm(expected)


def test_states_are_drawn_with_their_spread() -> None:
    rng = np.random.default_rng(0)
    states = [draw_state(FRAME, FRAME.as_designed(), 6, 0.3, rng) for _ in range(200)]
    losses = np.array([loss for state in states for loss in state.loss.values()])
    assert losses.size == 1200
    assert 0.3 <= losses.min() < 0.35
    assert 2.95 < losses.max() <= 3.0
    tight = [value for state in states for name, value in state.log10.items() if name not in state.loss]
    assert np.std(tight) == pytest.approx(0.3 / np.log(10), rel=0.1)


def test_a_loose_joint_is_heard() -> None:
    rig = Rig(FRAME, FRAME.as_designed())
    tight = State(dict.fromkeys(FRAME.bolts, 0.0), {}, {})
    lines = FRAME.frequencies
    before = rig.frfs(tight, Drift(), lines)
    for name in FRAME.bolts:
        after = rig.frfs(State(tight.log10 | {name: -1.0}, {name: 1.0}, {}), Drift(), lines)
        assert np.abs(20 * np.log10(np.abs(after / before))).mean() > 3.0


def test_campaign_is_ready(tmp_path: Path) -> None:
    model, design = tmp_path / "model", replace(FRAME, loosened=(0, 6))
    ensure_model(design, model)
    with pytest.raises(ValueError, match="not that of cover"):
        ensure_model(JOINT_DESIGNS["cover"], model)
    scatter = Scatter(kelvin=2.0)
    for folder in (tmp_path / "seed-4", tmp_path / "again"):
        measure_campaign(design, 4, folder, retorque=0.3, scatter=scatter)
    for file in ("truth.json", "frf/tight.uff", "frf/state-2.uff"):
        assert (tmp_path / "seed-4" / file).read_bytes() == (tmp_path / "again" / file).read_bytes()
    write_campaign(design, tmp_path / "seed-4", model, scatter)
    inputs = read_as_exported(load_campaign(tmp_path / "seed-4" / "campaign.yaml"))
    assert inputs.warnings == ()
    assert inputs.model.size == 252
    assert inputs.model.terms.size == 36
    assert [group.name for group in inputs.groups] == ["bending", "torsion"]
    assert inputs.campaign.update.baselines == ("tight-2",)
    assert list(inputs.campaign.jobs) == list(jobs_of(design)) == ["tight", "tight-2", "state-1", "state-2"]
    assert not any(job.removed for job in inputs.campaign.jobs.values())
    truth = json.loads((tmp_path / "seed-4" / "truth.json").read_text())["jobs"]
    for job, count in jobs_of(design).items():
        assert len(truth[job]["loose"]) == count
        assert set(truth[job]["change"]) == set(FRAME.bolts)
    assert set(truth["tight"]["change"].values()) == {0.0}
