from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

pytest.importorskip("skfem", reason="extra `samples`")

from lrbc_cli.campaign.reading.inputs import read_as_exported
from lrbc_cli.config import load_campaign
from lrbc_cli.io.frf import read_frf
from lrbc_cli.io.matrices.read import read_matrix
from lrbc_cli.virtual.drift import Drift, Scatter
from rigs.campaign import campaign_text, ensure_model, parse_jobs, write_campaign
from rigs.design import Design, Foundation, Mesh
from rigs.designs import DESIGNS, SINGLE, SOUNDBOX
from rigs.measure import FREQUENCIES, Laboratory
from rigs.nominal import bolt_table, build
from rigs.reduced import Basis
from rigs.truth import Air, Perturbations, Plate, Rig

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "data_samples" / "soundbox"

#: The SoundBox on meshes that are solved in a second.
COARSE = Design(
    name="coarse",
    title="Coarse box",
    plate_cells=(8, 7),
    plate_step=(0.0723, 0.072),
    hammer=(0.1 + 3 * 0.0723, 0.2 + 2 * 0.072),
    foundation=Foundation(patch_radius=0.03),
    nominal=Mesh((8, 7), (1, 1, 3, 2), (1, 6, 4, 3), 1),
    true=Mesh((4, 4), (1, 1, 1, 1), (1, 2, 2, 1), 2),
    jobs={"tight": (), "gap-07-10": (7, 8, 9, 10)},
)


@pytest.fixture(scope="module")
def shell() -> tuple[Plate, Air]:
    air = Air(COARSE)
    return Plate(COARSE, air), air


@pytest.mark.parametrize("design", DESIGNS.values(), ids=DESIGNS)
def test_design_is_consistent(design: Design) -> None:
    x0, y0, _ = design.plate_origin
    steps = (np.array(design.hammer) - (x0, y0)) / design.plate_step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert set(design.used) < set(design.microphones)
    assert design.removed(design.reference) == []
    assert all(set(design.removed(job)) <= set(design.bolts) for job in design.jobs)
    width, height = design.front[2]
    x1, y1 = design.plate_end
    assert 0 < x0 < x1 < width
    assert 0 < y0 < y1 < height
    assert all(0 < z <= design.depth for _, _, z in design.microphones.values())


def test_soundbox_is_the_sample() -> None:
    assert bolt_table(SOUNDBOX) == (SAMPLE / "bolts.csv").read_text()
    jobs = load_campaign(ROOT / "configs" / "soundbox.yaml").jobs
    assert {name: list(job.removed) for name, job in jobs.items()} == {job: SOUNDBOX.removed(job) for job in SOUNDBOX.jobs}
    model = build(SOUNDBOX)
    with h5py.File(SAMPLE / "model.h5") as file:
        for name, matrix in (("K", model.stiffness), ("M", model.mass)):
            stored = file[name]["data"][:]
            # Other versions of the libraries may round otherwise.
            np.testing.assert_allclose(matrix.data, stored, rtol=1e-9, atol=1e-9 * np.abs(stored).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in DESIGNS if name != "soundbox"])
def test_nominal_model_has_nodes_at_its_sensors(name: str) -> None:
    design = DESIGNS[name]
    model = build(design)
    n = model.structure_size
    assert model.mass.shape[0] <= 22_000
    for xyz in design.microphones.values():
        assert np.linalg.norm(model.xyz[n:] - xyz, axis=1).min() < 1e-9
    assert np.linalg.norm(model.xyz[:n][model.component[:n] == "UZ"] - design.hammer_point, axis=1).min() < 1e-9
    assert (model.stiffness[:n, n:] + model.mass[n:, :n].T).nnz == 0
    assert abs(model.stiffness[n:, n:] - model.stiffness[n:, n:].T).max() == 0.0


@pytest.mark.slow
def test_sample_is_measured_again(tmp_path: Path) -> None:
    Laboratory(SOUNDBOX, exact=True).campaign(2018, {"bolts-00": []}, tmp_path, tmp_path / "truth.json")
    stored, again = (read_frf(folder / "bolts-00.uff").records for folder in (SAMPLE / "frf", tmp_path))
    for a, b in zip(stored, again, strict=True):
        # Other kernels of OpenBLAS differ by up to 1.7e-4, at a peak.
        np.testing.assert_allclose(b.values, a.values, rtol=0, atol=3e-4 * np.abs(a.values).max())
    assert (
        json.loads((tmp_path / "truth.json").read_text())["perturbations"]
        == json.loads((SAMPLE / "frf" / "truth.json").read_text())["perturbations"]
    )


def test_shared_basis_gives_the_rig(shell: tuple[Plate, Air]) -> None:
    plate, air = shell
    rng = np.random.default_rng(3)
    perturbations = replace(Perturbations.draw(COARSE, rng), settling=0.3)
    basis = Basis(plate, air)
    drift = Drift(kelvin=2.0, hammer=(0.003, -0.002), gain={"mic01": 0.5})
    exact, fast = Rig(plate, air, perturbations), Rig(basis.plate, basis.air, perturbations)
    for removed in ([], ["B09"], ["B07", "B08", "B09", "B10"], list(COARSE.bolts)):
        factors = exact.factors(removed, rng)
        expected, found = (rig.frfs(factors, drift, FREQUENCIES[10::13]) for rig in (exact, fast))
        assert np.linalg.norm(found - expected) < 5e-3 * np.linalg.norm(expected)


def test_temperature_is_speed_and_density(shell: tuple[Plate, Air]) -> None:
    plate, air = shell
    none = Perturbations.none(COARSE)
    drift = Drift(kelvin=5.0)
    assert drift.warming == pytest.approx(1 + 5 / 293.15)
    rig = Rig(plate, air, none)
    materials = none.materials(COARSE)
    warm = replace(materials, sound_speed=materials.sound_speed * drift.warming**0.5, air_density=materials.air_density / drift.warming)
    other = Rig(plate, air, none)
    other.cavity = air.cavity(warm, np.array(list(COARSE.microphones.values())))
    lines = FREQUENCIES[10::13]
    cold, expected, found = rig.frfs(none.bolts, Drift(), lines), other.frfs(none.bolts, Drift(), lines), rig.frfs(none.bolts, drift, lines)
    # Not the same basis: its static parts belong to the air.
    assert np.linalg.norm(found - expected) < 1e-4 * np.linalg.norm(expected)
    assert np.linalg.norm(found - cold) > 1e-2 * np.linalg.norm(expected)


def test_drift_is_drawn_with_its_spread() -> None:
    assert Scatter().draw(["a"], np.random.default_rng(0)) == Drift()
    rng = np.random.default_rng(0)
    drawn = [Scatter(kelvin=2.0, hammer=0.003, gain=0.5).draw(["a", "b"], rng) for _ in range(2000)]
    assert np.std([d.kelvin for d in drawn]) == pytest.approx(2.0, rel=0.1)
    np.testing.assert_allclose(np.std([d.hammer for d in drawn], axis=0), 0.003, rtol=0.1)
    assert np.std([d.gain["b"] for d in drawn]) == pytest.approx(0.5, rel=0.1)
    # One kind of drift does not change what is drawn for another.
    assert (
        Scatter(kelvin=2.0).draw(["a"], np.random.default_rng(5)).kelvin
        == Scatter(kelvin=2.0, hammer=0.1).draw(["a"], np.random.default_rng(5)).kelvin
    )


def test_jobs_are_parsed() -> None:
    assert parse_jobs(SINGLE, None)["pair-04-13"] == ["B04", "B13"]
    assert parse_jobs(SINGLE, "tight:2,B03+B09") == {"tight-1": [], "tight-2": [], "loose-B03-B09": ["B03", "B09"]}
    assert list(parse_jobs(SINGLE, "single-07")) == ["tight", "single-07"]
    for wrong in ("tight:0", "B99", "all", ""):
        with pytest.raises(ValueError, match="is no job"):
            parse_jobs(SINGLE, wrong)


def test_baselines_are_tight_states_beside_the_reference() -> None:
    text = campaign_text(SINGLE, "x", "model", parse_jobs(SINGLE, "tight:3"), baselines=True)
    assert "\n  reference: tight-1\n  baselines: [tight-2]\n" in text
    assert "nuisances" not in text
    for jobs in ("tight:2", "tight,B03,B09"):
        with pytest.raises(ValueError, match="a second job with all bolts tight"):
            campaign_text(SINGLE, "x", "model", parse_jobs(SINGLE, jobs), baselines=True)


def test_campaign_is_ready(tmp_path: Path) -> None:
    model = tmp_path / "shared"
    jobs = parse_jobs(COARSE, None)
    ensure_model(COARSE, model)
    with pytest.raises(ValueError, match="not that of steel"):
        ensure_model(DESIGNS["steel"], model)
    folder = tmp_path / "seed-4"
    laboratory = Laboratory(COARSE)
    for at in (folder, tmp_path / "again"):
        laboratory.campaign(4, jobs, at / "frf", at / "truth.json", retorque=0.3, scatter=Scatter(kelvin=2.0, hammer=0.003))
    assert (folder / "frf" / "tight.uff").read_bytes() == (tmp_path / "again" / "frf" / "tight.uff").read_bytes()
    write_campaign(COARSE, folder, model, jobs, Scatter(kelvin=2.0, hammer=0.003))
    inputs = read_as_exported(load_campaign(folder / "campaign.yaml"))
    assert inputs.warnings == ()
    assert inputs.campaign.update.reference == "tight"
    assert inputs.campaign.update.baselines == ()
    assert inputs.campaign.update.nuisances.temperature == 2.0
    assert inputs.campaign.update.nuisances.hammer == 0.003
    assert inputs.campaign.update.nuisances.gain is None
    assert inputs.campaign.calibration is not None
    assert inputs.campaign.calibration.job == "tight"
    assert inputs.campaign.parameters["left_edge"].initial == "auto"
    assert inputs.groups[0].count == 6
    assert {r.name for r in read_frf(folder / "frf" / "gap-07-10.uff").records} == set(COARSE.microphones)
    truth = json.loads((folder / "truth.json").read_text())
    assert truth["jobs"]["gap-07-10"]["removed"] == ["B07", "B08", "B09", "B10"]
    assert truth["jobs"]["tight"]["drift"]["kelvin"] != truth["jobs"]["gap-07-10"]["drift"]["kelvin"]
    assert read_matrix(model / "model.h5", "K", None).matrix.shape[0] == inputs.model.size
