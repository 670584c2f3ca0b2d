"""``lrbc rehearse``: a campaign of the model's own measurements, which the other commands then run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from campaigns import ROOT, lrbc
from samples import reduced_cache

from lrbc_cli.campaign.identification import nuisances
from lrbc_cli.campaign.reading.inputs import read_as_exported
from lrbc_cli.config import load_campaign
from lrbc_cli.io.frf import read_frf
from lrbc_cli.results.rehearsal import RehearsalRecord
from lrbc_cli.results.store import read, results_schema
from lrbc_cli.virtual.campaign import declared_scatter, job_list

FRAME = ROOT / "configs" / "frame.yaml"


@pytest.fixture
def cache() -> Path:
    return reduced_cache("frame")


@pytest.mark.slow
def test_what_was_loosened_is_found(tmp_path: Path) -> None:
    """From the model to the verdict: two commands, the second as the first says."""
    out, cache = tmp_path / "rehearsal", tmp_path / "cache"
    done = lrbc("rehearse", FRAME, "--out", out, "--tight", "2", "--loose", "B3,B4", "--cache", cache)
    assert done.code == 0, done.stderr
    assert done.stdout.splitlines() == [
        "tight: all bolts tight",
        "tight-2: all bolts tight",
        "loose-B3-B4: B3, B4 loose",
        f"what was drawn: {out / 'rehearsal.json'}",
        f"next: lrbc run {out / 'campaign.yaml'}",
    ]
    result = lrbc("update", out / "campaign.yaml", "--fail-on-loose", "--cache", cache)
    assert result.code == 6, result.stdout
    tree = json.loads((out / "output" / "loose-B3-B4" / "result.json").read_text())
    assert {bolt["name"] for bolt in tree["bolts"] if bolt["verdict"] == "loose"} == {"B3", "B4"}
    assert tree["misfit_db"]["final"] < 0.5 * tree["misfit_db"]["initial"]
    record = read(out / "rehearsal.json", RehearsalRecord)
    assert record is not None
    assert record.digest
    drawn = json.loads((out / "rehearsal.json").read_text())
    jsonschema.validate(drawn, results_schema())
    assert (drawn["seed"], drawn["settings"]["noise"]) == (1, 0.004)
    assert drawn["factors"].keys() == {"stiffness.structure", "mass.structure", "damping.structure"}
    loose, tight = drawn["jobs"]["loose-B3-B4"], drawn["jobs"]["tight-2"]
    assert loose["removed"] == ["B3", "B4"]
    assert loose["decades"]["B3"] == -2.0
    assert min(loose["log10"]["left_edge"]) < 5.0 < min(tight["log10"]["left_edge"])


def test_the_campaign_is_that_of_the_model(tmp_path: Path, cache: Path) -> None:
    out = tmp_path / "out"
    done = lrbc("rehearse", FRAME, "--out", out, "--loose", "B1", "--lines", "30:500:10", "--json", "--cache", cache)
    assert done.code == 0, done.stderr
    assert done.json["file"] == (out / "campaign.yaml").as_posix()
    assert done.json["jobs"].keys() == {"tight", "loose-B1"}
    own, again = load_campaign(FRAME), load_campaign(out / "campaign.yaml")
    assert again.description.startswith("Rehearsal: no measurements")
    assert again.description.endswith(own.description)
    for part in ("model", "excitation", "responses", "parameters", "bolts", "reduction", "update", "calibration"):
        assert again.model_dump(mode="json")[part] == own.model_dump(mode="json")[part]
    assert {name: job.frf for name, job in again.jobs.items()} == {name: out / "frf" / f"{name}.uff" for name in ("tight", "loose-B1")}
    assert again.jobs["loose-B1"].removed == ("B1",)
    np.testing.assert_allclose(read_frf(again.jobs["tight"].frf).records[0].frequency_hz, np.arange(30.0, 501.0, 10.0), rtol=1e-9)
    assert lrbc("check", out / "campaign.yaml", "--cache", cache).code == 0


@pytest.mark.slow
def test_one_seed_one_measurement(tmp_path: Path, cache: Path) -> None:
    def measured(name: str, seed: int) -> np.ndarray:
        given = ["--lines", "30:500:10", "--seed", str(seed), "--tight", "1"]
        assert lrbc("rehearse", FRAME, "--out", tmp_path / name, *given, "--cache", cache).code == 0
        return np.array([record.values for record in read_frf(tmp_path / name / "frf" / "tight.uff").records])

    first = measured("a", 3)
    np.testing.assert_array_equal(measured("b", 3), first)
    assert np.linalg.norm(measured("c", 4) - first) > 1e-3 * np.linalg.norm(first)


def test_nothing_is_replaced_unasked(tmp_path: Path, cache: Path) -> None:
    def rehearse(out: Path, *more: str) -> tuple[int, str]:
        done = lrbc("rehearse", FRAME, "--out", out, "--loose", "B1", "--lines", "30:500:50", "--cache", cache, *more)
        return done.code, done.stderr

    out = tmp_path / "out"
    (out / "frf").mkdir(parents=True)
    own = out / "frf" / "loose-B1.uff"
    own.write_text("mine")
    code, said = rehearse(out)
    assert (code, own.read_text()) == (2, "mine")
    assert "already exists" in said
    assert "--force replaces it" in said
    assert rehearse(out, "--force")[0] == 0
    assert own.stat().st_size > 1000
    # An input is never replaced.
    override = ("--override", f"jobs.tight.frf={json.dumps(own.as_posix())}")
    before = own.read_bytes()
    code, said = rehearse(out, "--force", *override)
    assert (code, own.read_bytes()) == (2, before)
    assert "this is an input of the campaign" in said


def test_mistakes_are_told_before_anything_is_written(tmp_path: Path, cache: Path) -> None:
    out = tmp_path / "out"
    for given, words in (
        (["--loose", "B3,B77"], "B77"),
        (["--lines", "30:900:1"], "outside its band"),
        (["--temperature", "2"], "the model has no air DOFs"),
    ):
        done = lrbc("rehearse", FRAME, "--out", out, *given, "--cache", cache)
        assert done.code == 2
        assert words in done.stderr
        assert not out.exists()


def test_what_is_not_said_is_drawn_or_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs = read_as_exported(load_campaign(FRAME, ["update.nuisances={hammer: 0.003, gain: 0.2}"]))
    scatter = declared_scatter(inputs)
    assert (scatter.kelvin, scatter.hammer, scatter.gain) == (0.0, 0.003, 0.2)
    damping = nuisances.ModelFactor(name="damping.structure", std=0.2, reach=1.2)
    monkeypatch.setattr(nuisances, "DRIFTS", (*nuisances.DRIFTS, lambda *_: (damping,)))
    assert declared_scatter(inputs) == replace(scatter, factors={"damping.structure": 0.2})
    drawn = {bolt for seed in range(20) for names in job_list(inputs, (), None, seed).values() for bolt in names}
    assert len(drawn) > 3
    assert job_list(inputs, (), 2) == {"tight": [], "tight-2": []}
    assert list(job_list(inputs, ("B1", "B1"))) == ["tight", "loose-B1", "loose-2"]


def test_what_is_next_without_a_calibration(tmp_path: Path, cache: Path) -> None:
    config = tmp_path / "configs" / "frame.yaml"
    config.parent.mkdir()
    tree = yaml.safe_load(FRAME.read_text(encoding="utf-8").replace("../data_samples", (ROOT / "data_samples").as_posix()))
    del tree["calibration"]
    config.write_text(yaml.safe_dump(tree), encoding="utf-8")
    done = lrbc("rehearse", config, "--out", tmp_path / "out", "--loose", "B3", "--cache", cache)
    assert done.code == 0, done.stderr
    assert f"next: lrbc update {tmp_path / 'out' / 'campaign.yaml'}" in done.stdout
