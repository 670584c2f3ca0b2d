from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import lrbc
from samples import reduced_cache, sample
from systems import csc

import rehearse as command
from lrbc_cli.campaign.inputs import Inputs, read_as_exported
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import ConfigError
from lrbc_cli.io.frf import read_frf
from rigs.drift import Drift, Scatter
from rigs.rehearsal import Rehearsal, Settings, campaign_tree, job_list, moved_load, patches, rehearse, scaled

ROOT = Path(__file__).parents[2]
FRAME = ROOT / "configs" / "frame.yaml"
EXACT = Settings(noise=0.0, retorque=0.0, perturb=0.0, damping=0.0)
LINES = np.arange(30.0, 500.0, 7.0)


def rehearsal(path: Path, settings: Settings, *overrides: str, seed: int = 1) -> Rehearsal:
    inputs = read_as_exported(load_campaign(FRAME, overrides))
    return Rehearsal(inputs, settings, seed, path / "cache", LINES, lambda _: None)


def linear_field(inputs: Inputs, a: float, b: float, c: float) -> np.ndarray:
    """DOFs of the deflection a + b x + c y."""
    table = inputs.dofs
    assert table is not None
    x, y, _ = table.xyz.T
    values = {"UZ": a + b * x + c * y, "ROTX": np.full(x.size, c), "ROTY": np.full(x.size, -b), "TWIST": np.zeros(x.size)}
    return np.select([table.component == name for name in values], list(values.values()))


def test_scaling_leaves_the_coupling() -> None:
    acoustic = np.array([False, False, True])
    matrix = csc(np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]))
    expected = [[2.0, 4.0, 3.0], [8.0, 10.0, 6.0], [7.0, 8.0, 27.0]]
    np.testing.assert_array_equal(scaled(matrix, acoustic, 2.0, 3.0).toarray(), expected)


@pytest.mark.parametrize("rotations", [True, False], ids=["moment", "gradient"])
def test_moved_hit_works_on_the_moved_deflection(rotations: bool) -> None:
    inputs = sample("frame")
    table = inputs.dofs
    assert table is not None
    if not rotations:
        inputs = replace(inputs, dofs=replace(table, component=np.where(table.component == "UZ", "UZ", "OTHER")))
    load = moved_load(inputs, (0.004, -0.003)).toarray()[:, 0]
    field = linear_field(sample("frame"), 0.2, 1.5, -0.7)
    x, y = 0.16, 0.12
    assert load @ field == pytest.approx(0.2 + 1.5 * (x + 0.004) - 0.7 * (y - 0.003), rel=1e-9)


def test_patches_share_the_edge() -> None:
    inputs = sample("frame")
    found = patches(inputs, None)
    total = np.sum([w["left_edge"] for w in found.values()], axis=0)
    assert np.all(total <= 1 + 1e-12)
    assert np.all(total > 0.3)
    arc = inputs.groups[0].arc_length
    assert arc is not None
    centres = [float(arc @ w["left_edge"] / w["left_edge"].sum()) for w in found.values()]
    assert np.all(np.diff(centres) > 0.04)
    with pytest.raises(ConfigError, match="the campaign has none"):
        patches(replace(inputs, bolts=None), None)


def test_nothing_wrong_and_nothing_loose_is_the_model(tmp_path: Path) -> None:
    plain = "parameters.left_edge.smoothing=null"
    done = rehearsal(tmp_path, EXACT, plain)
    frf, _ = done.measure([])
    out = tmp_path / "model.uff"
    code = lrbc("simulate", FRAME, "--override", plain, "--cache", tmp_path / "cache", "--out", out, "--lines", "30:500:7", "--full").code
    assert code == 0
    for found, expected in zip(frf.records, read_frf(out).records, strict=True):
        assert found.name == expected.name
        np.testing.assert_allclose(found.values, expected.values, rtol=0, atol=1e-3 * np.abs(expected.values).max())


def test_drift_and_faults_change_the_measurement(tmp_path: Path) -> None:
    def values(settings: Settings, removed: tuple[str, ...] = ()) -> np.ndarray:
        return np.array([r.values for r in rehearsal(tmp_path, settings).measure(removed)[0].records])

    plain = values(EXACT)
    for other in (
        values(replace(EXACT, perturb=0.005)),
        values(replace(EXACT, damping=0.1)),
        values(replace(EXACT, noise=0.01)),
        values(replace(EXACT, retorque=0.3)),
        values(replace(EXACT, level=7.0)),
        values(replace(EXACT, scatter=Scatter(hammer=0.003))),
        values(replace(EXACT, scatter=Scatter(gain=0.5))),
        values(EXACT, ("B3",)),
    ):
        assert np.linalg.norm(other - plain) > 1e-3 * np.linalg.norm(plain)
    with pytest.raises(ConfigError, match="no air to warm"):
        rehearsal(tmp_path, replace(EXACT, scatter=Scatter(kelvin=2.0)))


@pytest.mark.slow
def test_warm_air_of_a_coupled_model() -> None:
    inputs = sample("soundbox")
    cache = reduced_cache("soundbox")
    model = Rehearsal(inputs, EXACT, 1, cache, np.arange(20.0, 401.0), lambda _: None).model(Drift(kelvin=5.0))
    field, factor = inputs.model.is_acoustic, 1 + 5 / 293.15
    air = np.ix_(field, field)
    assert abs(model.K[air] - factor * inputs.model.K[air]).max() <= 1e-12 * abs(inputs.model.K[air]).max()
    other = np.ix_(~field, field)
    assert abs(model.K[other] - inputs.model.K[other]).max() == 0.0
    assert abs(model.M - inputs.model.M).max() == 0.0


def test_rehearsed_campaign_is_identified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "rehearsal"
    arguments = [FRAME, "--out", out, "--tight", "2", "--loose", "B3,B4", "--hammer", "0.002", "--cache", tmp_path / "cache"]
    monkeypatch.setattr(sys, "argv", ["rehearse.py", *map(str, arguments)])
    assert command.main() == 0
    result = lrbc("update", out / "campaign.yaml", "--cache", tmp_path / "cache", "--json")
    assert result.code == 0
    tree = json.loads((out / "output" / "loose-B3-B4" / "result.json").read_text())
    loose = {bolt["name"] for bolt in tree["bolts"] if bolt["verdict"] == "loose"}
    assert {"B3", "B4"} <= loose
    assert tree["misfit_db"]["final"] < 0.5 * tree["misfit_db"]["initial"]
    truth = json.loads((out / "truth.json").read_text())
    assert truth["jobs"]["loose-B3-B4"]["removed"] == ["B3", "B4"]
    assert min(truth["jobs"]["loose-B3-B4"]["log10"]["left_edge"]) < 5.0 < min(truth["jobs"]["tight-2"]["log10"]["left_edge"])


def test_command_refuses_unknown_bolts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["rehearse.py", str(FRAME), "--out", str(tmp_path / "out"), "--loose", "B3,B77"])
    assert command.main() == 2
    assert "B77" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_campaign_file_keeps_the_model(tmp_path: Path) -> None:
    done = rehearsal(tmp_path, EXACT)
    jobs = job_list(done.inputs, 1, ["B1"])
    assert jobs == {"tight": [], "loose-B1": ["B1"]}
    rehearse(done, jobs, tmp_path / "out")
    again = load_campaign(tmp_path / "out" / "campaign.yaml")
    for part in ("model", "excitation", "responses", "parameters", "bolts", "reduction"):
        assert again.model_dump(mode="json")[part] == done.inputs.campaign.model_dump(mode="json")[part]
    assert campaign_tree(read_as_exported(again), jobs)["jobs"] == {
        "tight": {"frf": "frf/tight.uff"},
        "loose-B1": {"frf": "frf/loose-B1.uff", "removed": ["B1"]},
    }
