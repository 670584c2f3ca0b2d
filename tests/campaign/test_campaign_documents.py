"""Result files that are read back: whatever is wrong with one is a DataError."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jsonschema
import numpy as np
import pytest
from campaigns import Folder, lrbc
from pydantic import ValidationError

from lrbc_cli.errors import ConfigError, DataError, NumericalError
from lrbc_cli.results.job import Certificate, FailedJob, JobRecord, Lines, Provenance
from lrbc_cli.results.nuisances import Estimate
from lrbc_cli.results.store import FILES, digest_of, read_job, results_schema
from lrbc_cli.updating.statistics.model import StatisticalModel

Spoil = Callable[[dict[str, Any]], Any]


def test_results_as_written_are_read(frame_once: Folder, tmp_path: Path) -> None:
    job = read_job(frame_once.out, "loose-2")
    assert isinstance(job, JobRecord)
    assert json.loads(json.dumps(job.tree())) == frame_once.result("loose-2")
    assert job.names("loose") == ["B3", "B4"]
    assert job.parameters["left_edge"].log10.shape == (10,)
    for name in ("campaign.json", "reduction.json", "structure.json", "loose-2/result.json"):
        tree = json.loads((frame_once.out / name).read_text(encoding="utf-8"))
        assert tree["digest"] == digest_of(tree), name
    assert read_job(tmp_path, "a") is None
    store(tmp_path, {"format": "lrbc-result", "version": 1, "job": "a", "status": "failed", "reason": "r", "provenance": {}, "digest": ""})
    failed = read_job(tmp_path, "a")
    assert isinstance(failed, FailedJob)
    assert failed.finding.status == "failed"


def store(folder: Path, tree: dict[str, Any] | str) -> Path:
    """Of a tree that has a digest, with the right one."""
    path = folder / "a" / "result.json"
    path.parent.mkdir()
    if isinstance(tree, dict) and "digest" in tree:
        tree["digest"] = digest_of(tree)
    path.write_text(tree if isinstance(tree, str) else json.dumps(tree))
    return path


@pytest.mark.slow
def test_every_file_fits_the_printed_schema(frame: Folder) -> None:
    """Those of a whole campaign, a failed job among them; no file has a key that the schema does not name."""
    tree = frame.tree()
    frame.write(tree | {"calibration": {"job": "tight", "factors": ["stiffness.structure"]}})
    (frame.data / "frf" / "loose-all.csv").unlink()
    for words, code in ((["calibrate"], 0), (["plan", "--draws", "1"], 0), (["update"], 5)):
        done = frame.run(*words)
        assert done.code == code, done.stderr
    printed = lrbc("schema", "--results").json
    assert printed == results_schema()
    files = sorted(frame.out.rglob("*.json"))
    assert {file.name for file in files} == {*FILES, "result.previous.json"} - {"rehearsal.json"}
    # A result vouches for what is in its folder.
    assert {file.name for file in files if "digest" not in json.loads(file.read_text(encoding="utf-8"))} == {"evidence.json", "shapes.json"}
    jsonschema.Draft202012Validator.check_schema(printed)
    named = json.loads(json.dumps(printed).replace('"additionalProperties": true', '"additionalProperties": false'))
    for below in named["$defs"].values():
        # These are quoted whole: the campaign file, the resolved method, the machine.
        for name in {"configuration", "method", "identification", "machine"} & set(below.get("properties", ())):
            below["properties"][name] = {}
    for file in files:
        tree = json.loads(file.read_text())
        jsonschema.Draft202012Validator(printed).validate(tree)
        name = file.name.replace(".previous", "")
        jsonschema.Draft202012Validator({**named, "$ref": f"#/$defs/{name}", "oneOf": [{}]}).validate(tree)
        tree["version"] = 2
        assert not jsonschema.Draft202012Validator(printed).is_valid(tree)


def test_keys_of_a_later_release_are_kept(frame_once: Folder, tmp_path: Path) -> None:
    tree = frame_once.result("loose-2") | {"job": "a", "later": [1, None]}
    tree["bolts"][0]["torque"] = 3.5
    store(tmp_path, tree)
    job = read_job(tmp_path, "a")
    assert job is not None
    assert json.loads(json.dumps(job.tree())) == tree


def test_no_covariance_is_read(frame_once: Folder, tmp_path: Path) -> None:
    """Of an identification without unknowns."""
    store(tmp_path, frame_once.result("loose-2") | {"job": "a", "covariance": []})
    job = read_job(tmp_path, "a")
    assert isinstance(job, JobRecord)
    assert job.covariance is not None
    assert job.covariance.shape == (0, 0)


def test_what_is_not_finite_is_null_or_refused(frame_once: Folder) -> None:
    """Before it is written: a file that could not be read back would be identified anew for ever."""
    tree = frame_once.result("loose-2")
    tree["misfit_db"]["initial"] = float("nan")
    assert JobRecord.checked(tree).tree()["misfit_db"]["initial"] is None
    tree["misfit_db"]["final"] = float("inf")
    with pytest.raises(NumericalError, match="cannot be written") as caught:
        JobRecord.checked(tree)
    assert (caught.value.place, caught.value.expected) == ("misfit_db.final", "a number")


def test_records_are_built_of_computed_values() -> None:
    """Values of numpy, not finite ones and None among them, or the attributes of another object; only reading tells of damage."""
    lines = Lines(frequency_hz=np.array([1, 2]), count=np.int64(2))
    assert lines.tree() == {"frequency_hz": [1.0, 2.0], "count": 2}
    certificate = Certificate.like(SimpleNamespace(worst=np.float64("nan"), reached=np.True_, more=1), key="k", size=3)
    assert certificate.tree() == {"key": "k", "size": 3, "worst": None, "reached": True}
    assert Provenance(certificate=certificate, calibration=None).tree() == {"calibration": None, "certificate": certificate.tree()}
    assert Provenance(certificate=None).tree() == {}
    with pytest.raises(NumericalError, match="cannot be written") as caught:
        Estimate(value=np.inf)
    assert (caught.value.place, caught.value.expected) == ("value", "a number")
    with pytest.raises(ValidationError):
        Lines.model_validate({"frequency_hz": [None], "count": 1})


def test_the_schema_names_the_numbers_of_the_statistical_model() -> None:
    found = results_schema()["$defs"]
    for record, name in (("JobRecord", "method"), ("PlanRecord", "identification")):
        parts = found[record]["properties"][name]["anyOf"][0]["properties"]
        statistics = parts["statistics"]
        # Releases of pydantic differ in whether they refer to it.
        statistics = found[statistics["$ref"].rpartition("/")[2]] if "$ref" in statistics else statistics
        assert set(statistics["properties"]) == {entry.name for entry in fields(StatisticalModel)}
    assert "loose_share" in found["BoltPrior"]["properties"]


@pytest.mark.parametrize(
    ("spoil", "place", "found"),
    [
        (lambda t: t.update(version=99), "version", "99"),
        (lambda t: t.pop("version"), "version", "none"),
        (lambda t: t.update(version=True), "version", "True"),
        (lambda t: t.pop("status"), "status", "no such key"),
        (lambda t: t.pop("job"), "job", "no such key"),
        (lambda t: t.update(status=None), "status", "None"),
        (lambda t: t.pop("parameters"), "parameters", "no such key"),
        (lambda t: t.update(parameters=[]), "parameters", "[]"),
        (lambda t: t.update(parameters={"left_edge": {}}), "parameters.left_edge.kind", "no such key"),
        (lambda t: t["parameters"]["left_edge"].update(log10=[1.0, None]), "parameters.left_edge.log10[1]", "None"),
        (lambda t: t.update(bolts=[{}]), "bolts[0].name", "no such key"),
        (lambda t: t.update(bolts=None), "bolts", "None"),
        (lambda t: t.update(misfit_db=3), "misfit_db", "3"),
        (lambda t: t.update(cost={"initial": "x", "final": 1}), "cost.initial", "'x'"),
        (lambda t: t.update(provenance=[]), "provenance", "[]"),
        (lambda t: t.update(seconds={}), "seconds.total", "no such key"),
        (lambda t: t.pop("noise"), "noise", "no such key"),
        (lambda t: t["noise"].pop("sigma_db"), "noise.sigma_db", "no such key"),
        (lambda t: t["noise"].update(sigma_db=None), "noise.sigma_db", "None"),
        (lambda t: t["misfit_db"].update(final=None), "misfit_db.final", "None"),
        (lambda t: t.update(status="fine"), "status", "fine"),
        (lambda t: t["bolts"][2].update(verdict="Tight"), "bolts[2].verdict", "Tight"),
        (lambda t: t["bolts"][2].update(probability_loose="0.9"), "bolts[2].probability_loose", "'0.9'"),
        (lambda t: t.update(removed=["B3", 4]), "removed[1]", "4"),
        (lambda t: t.update(covariance=[[1.0, 0.0], [0.0]]), "covariance[1]", "1 values"),
        (lambda t: t.update(covariance=3), "covariance", "3"),
        (lambda t: t["parameters"]["left_edge"].update(damping_exponent=None), "parameters.left_edge.damping_exponent", "none"),
        (lambda t: t["parameters"]["left_edge"]["std"].pop(), "parameters.left_edge.std", "9 values"),
        (lambda t: t.update(nuisances={"hammer_offset_mm": {"hammer x": 1.0}}), "nuisances.hammer_offset_mm.hammer x", "1.0"),
        (lambda t: t.update(correlation=[]), "correlation", "[]"),
        (lambda t: t.update(warnings=[3]), "warnings[0]", "3"),
        (lambda t: t["provenance"].update(certificate=3), "provenance.certificate", "3"),
        (lambda t: t["provenance"].update(files=["frf.csv"]), "provenance.files", "['frf.csv']"),
        (lambda t: t["provenance"].update(rests_on={}), "provenance.rests_on.baselines", "no such key"),
        (lambda t: t["validity"].update(passed="yes"), "validity.passed", "'yes'"),
    ],
)
def test_damage_is_named(frame_once: Folder, tmp_path: Path, spoil: Spoil, place: str, found: str) -> None:
    tree = copy.deepcopy(frame_once.result("loose-2"))
    spoil(tree)
    tree["job"] = "a" if tree.get("job") == "loose-2" else tree.get("job")
    if tree["job"] is None:
        del tree["job"]
    store(tmp_path, tree)
    with pytest.raises(DataError) as caught:
        read_job(tmp_path, "a")
    assert (caught.value.place, str(caught.value.found)) == (place, found)
    assert "--force" in caught.value.message


@pytest.mark.parametrize("text", ["", "[]", "{}", "nonsense", "[" * 100_000, '{"format": NaN}', '{"format": "lrbc-campaign"}'])
def test_what_is_no_result(tmp_path: Path, text: str) -> None:
    store(tmp_path, text)
    with pytest.raises(DataError):
        read_job(tmp_path, "a")


def test_a_path_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="the results cannot be read"):
        read_job(tmp_path, "x" * 5000)


@pytest.mark.parametrize("text", ['{"format": "lrbc-result"}', '{"format": "lrbc-result", "version": 99, "status": "converged"}'])
def test_commands_with_damaged_results(frame: Folder, text: str) -> None:
    (frame.out / "loose-2" / "result.json").write_text(text)
    result = frame.run("simulate", "--job", "loose-2", "--out", frame.path / "x.csv")
    assert result.code == 3, result.stderr
    assert str(frame.out / "loose-2" / "result.json") in result.stderr
    assert not (frame.path / "x.csv").exists()
    (frame.out / "tight" / "result.json").write_text(text)
    result = frame.run("update", "--job", "loose-2")
    assert result.code == 0, result.stderr
    assert frame.result("loose-2")["status"] == frame.result("tight")["status"] == "converged"


#: Documents that JSON allows and no result is; each once ended a command with exit code 1, or a job with a KeyError.
FLOODS = {
    "400 digits": lambda text: text.replace('"iterations": ', '"iterations": ' + "1" * 400, 1),
    "5000 digits": lambda text: text.replace('"iterations": ', '"iterations": ' + "1" * 5000, 1),
    "brackets": lambda text: text.replace("{", '{"deep": ' + "[" * 200_000 + "]" * 200_000 + ",", 1),
    "levels": lambda text: text.replace("{", '{"deep": ' + "[" * 900 + "]" * 900 + ",", 1),
    "no noise": lambda text: text.replace('"noise"', '"nose"', 1),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(FLOODS))
def test_commands_with_a_result_that_floods(frame: Folder, name: str) -> None:
    path = frame.out / "tight" / "result.json"
    path.write_text(FLOODS[name](path.read_text()))
    (frame.out / "loose-2" / "result.json").unlink()
    for words in (["simulate", "--job", "tight", "--out", str(frame.path / "x.csv")], ["report"]):
        result = frame.run(*words)
        assert result.code == 3, result.stderr
        assert str(path) in result.stderr
        assert result.stderr.count("damaged") == 1
        assert "fix:" in result.stderr
    assert frame.run("check").code == 0
    planned = frame.run("update", "--dry-run", "--json")
    assert planned.code == 0, planned.stderr
    assert [job for job, plan in planned.json["jobs"].items() if plan["run"]] == ["tight", "loose-2"]
    if name not in ("brackets", "no noise"):
        return
    result = frame.run("update", "--json")
    assert result.code == 0, result.stderr
    assert result.json["kept"] == ["loose-all"]
    assert {b["name"] for b in frame.result("loose-2")["bolts"] if b["verdict"] == "loose"} == {"B3", "B4"}


@pytest.mark.parametrize("file", ["campaign.json", "reduction.json"])
@pytest.mark.parametrize("name", ["brackets", "levels"])
def test_files_of_the_campaign_that_flood(frame: Folder, file: str, name: str) -> None:
    path = frame.out / file
    path.write_text(FLOODS[name](path.read_text()))
    result = frame.run("report")
    assert result.code == 3, result.stderr
    assert str(path) in result.stderr
    assert frame.run("update").code == 0


@pytest.mark.parametrize("command", ["check", "reduce", "update"])
def test_a_cache_that_cannot_be(frame: Folder, command: str) -> None:
    result = frame.run(command, "--cache", "x" * 5000)
    assert result.code == 2, result.stderr
    assert "the cache cannot be used" in result.stderr
    assert len(result.stderr) < 2000


@pytest.mark.parametrize("args", [["check"], ["reduce"], ["update"], ["update", "--dry-run"], ["report"], ["simulate", "--job", "tight"]])
def test_the_output_of_another_campaign_is_refused(frame: Folder, args: list[str]) -> None:
    frame.replace("campaign: frame-left-edge", "campaign: frame-right-edge")
    before = frame.listing()
    result = frame.run(*args, *(["--out", frame.path / "x.csv"] if args[0] == "simulate" else []))
    assert result.code == 2, result.stderr
    for part in ("line ", ", output: ", "'frame-right-edge'", "'frame-left-edge'", str(frame.out), "another `output`"):
        assert part in result.stderr
    assert frame.listing() == before


@pytest.mark.slow
def test_ways_out_of_a_foreign_output(frame: Folder) -> None:
    frame.replace("campaign: frame-left-edge", "campaign: frame-right-edge")
    assert frame.run("simulate", "--out", frame.path / "x.csv").code == 0
    assert frame.run("check", "--override", "output=other").code == 0
    (frame.out / "campaign.json").write_text("damaged")
    assert frame.run("check").code == 0
    (frame.out / "campaign.json").unlink()
    result = frame.run("update", "-v")
    assert result.code == 0
    assert "tight: kept, nothing changed" in result.stderr
    assert frame.run("report", "--job", "tight").code == 0
