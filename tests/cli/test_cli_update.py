"""Jobs: what is run and what is kept, failures beside successes, exit codes, output for programs."""

from __future__ import annotations

import csv
import errno
import json
import logging
import math
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import BOX_TRUTH, Folder, frame, lrbc, with_a_tight_job
from campaigns import box as make_box

from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.identification.weights import mostly_noise
from lrbc_cli.campaign.jobs.table import CAMPAIGN_COLUMNS
from lrbc_cli.io import atomic, json_text
from lrbc_cli.io.frf import read_frf
from lrbc_cli.results.store import digest_of


def plans(folder: Folder, *args: str) -> dict[str, tuple[bool, str]]:
    """Which jobs would run, and why."""
    result = folder.run("update", "--dry-run", "--json", *args)
    assert result.code == 0, result.stderr
    return {name: (plan["run"], plan["reason"]) for name, plan in result.json["jobs"].items()}


def runs(folder: Folder, *args: str) -> list[str]:
    return [name for name, (run, _) in plans(folder, *args).items() if run]


def table(folder: Folder) -> dict[str, dict[str, str]]:
    with (folder.out / "campaign.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == CAMPAIGN_COLUMNS
    return {row["job"]: row for row in rows}


def scaled_csv(path: Path, factor: float) -> None:
    lines = path.read_text().splitlines()
    cells = lines[20].split(",")
    cells[1] = repr(float(cells[1]) * factor)
    lines[20] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")


# -- results ------------------------------------------------------------------------------------------------------------


def test_the_truth_is_found(box: Folder) -> None:
    for job, truth in BOX_TRUTH.items():
        tree = box.result(job)
        assert tree["status"] == "converged"
        np.testing.assert_allclose(tree["parameters"]["springs"]["log10"], truth, atol=1e-6)
        assert tree["misfit_db"]["final"] < 1e-6 < 1.0 < tree["misfit_db"]["initial"]
    verdicts = {bolt["name"]: bolt["verdict"] for bolt in box.result("loose")["bolts"]}
    assert verdicts == {"B1": "tight", "B2": "tight", "B3": "loose", "B4": "loose", "B5": "tight", "B6": "tight"}
    changes = [bolt["change"] for bolt in box.result("loose")["bolts"]]
    cap = box.result("tight")["parameters"]["springs"]["saturation"]["start"]
    expected = np.minimum(BOX_TRUTH["loose"], cap) - np.minimum(BOX_TRUTH["tight"], cap)
    np.testing.assert_allclose(changes, expected, atol=1e-6)


def finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


@pytest.mark.parametrize("job", ["tight", "loose-2", "loose-all"])
def test_every_result_file_is_there(frame_once: Folder, job: str) -> None:
    folder = frame_once.out / job
    assert sorted(p.name for p in folder.iterdir()) == [
        *("evidence.json", "fdac.csv", "frf.csv", "profile.csv", "result.json", "shapes.json")
    ]
    tree = frame_once.result(job)
    assert tree["job"] == job
    assert tree["status"] == "converged"
    assert tree["reason"]
    group = tree["parameters"]["left_edge"]
    assert len(group["log10"]) == len(group["positions"]) == len(group["arc_length"]) == 10
    assert all(finite(v) for v in group["log10"] + group["log10_effective"])
    assert np.shape(group["positions"]) == (10, 3)
    smoothing = np.eye(10) * 2 / 3 + (np.eye(10, k=1) + np.eye(10, k=-1)) / 3
    np.testing.assert_allclose(group["log10_effective"], np.log10(smoothing @ 10.0 ** np.array(group["log10"])), atol=1e-5)
    assert group["damping_factor"] == pytest.approx(10 ** group["damping_exponent"])
    assert group["bounds"] == [2.0, 8.0]
    assert min(group["log10"]) >= 2.0
    assert max(group["log10"]) <= 8.0
    assert tree["cost"]["final"] < tree["cost"]["initial"]
    assert tree["misfit_db"]["final"] < tree["misfit_db"]["initial"]
    responses = tree["misfit_db"]["responses"]
    assert {name: entry["used"] for name, entry in responses.items()} == {"acc1": True, "acc2": True, "acc3": True, "acc4": False}
    used = [entry["final"] for entry in responses.values() if entry["used"]]
    assert tree["misfit_db"]["final"] == pytest.approx(np.mean(used))
    assert tree["misfit_db"]["held_out_final"] == pytest.approx(responses["acc4"]["final"])
    assert [bolt["name"] for bolt in tree["bolts"]] == [f"B{i}" for i in range(1, 7)]
    for bolt in tree["bolts"]:
        assert {"name", "position", "log10_stiffness", "change", "verdict"} <= set(bolt)
        assert bolt["verdict"] in ("tight", "loose", "undecided")
        assert finite(bolt["log10_stiffness"])
        assert finite(bolt["change"])
    for key in ("iterations", "evaluations", "line_evaluations"):
        assert isinstance(tree[key], int)
        assert tree[key] > 0
    assert tree["line_evaluations"] == tree["evaluations"] * tree["lines"]["count"]
    assert len(tree["lines"]["frequency_hz"]) == tree["lines"]["count"]
    assert tree["history"][-1]["cost"] >= tree["cost"]["final"] - 1e-9
    assert all(finite(v) and v >= 0 for v in tree["seconds"].values())
    assert tree["seconds"]["total"] > 0
    provenance = tree["provenance"]
    assert {"lrbc", "python", "numpy", "scipy", "h5py"} <= set(provenance["versions"])
    names = {Path(path).name for path in provenance["inputs"]}
    assert names == {
        "stiffness.mtx",
        "mass.mtx.gz",
        "damping.mtx.gz",
        "dofs.csv",
        "sensors.mtx",
        "edge.mtx",
        "edge.csv",
        "bolts.csv",
        f"{job}.csv",
    }
    assert all(len(digest) == 64 for digest in provenance["inputs"].values())
    certificate = provenance["certificate"]
    assert certificate["reached"] is True
    assert certificate["worst"] <= certificate["tolerance"] == 1e-3
    assert provenance["configuration"]["update"]["max_iterations"] == 100


def test_profile_and_frf_tables(frame_once: Folder) -> None:
    tree = frame_once.result("loose-2")
    with (frame_once.out / "loose-2" / "profile.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["log10"]) for row in rows] == pytest.approx(tree["parameters"]["left_edge"]["log10"])
    assert [float(row["y"]) for row in rows] == pytest.approx(np.arange(0.02, 0.4, 0.04))
    assert [float(row["log10_reference"]) for row in rows] == pytest.approx(
        frame_once.result("tight")["parameters"]["left_edge"]["log10_effective"]
    )
    with (frame_once.out / "loose-2" / "frf.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 471
    assert sum(int(row["selected"]) for row in rows) == tree["lines"]["count"]
    measured = {record.name: record for record in read_frf(frame_once.data / "frf" / "loose-2.csv").records}
    inputs = frame_once.inputs()
    tight = read_measurement(inputs, inputs.campaign.jobs["tight"], "tight")
    noisy = dict(zip(measured, mostly_noise(inputs, tight, inputs.campaign.jobs["tight"], known=True).T, strict=True))
    assert 0 < sum(lines.sum() for lines in noisy.values()) < 20
    for name, record in measured.items():
        compared = ~noisy[name]
        level = np.array([float(row[f"{name}_measured_db"]) for row in rows])
        np.testing.assert_allclose(level, 20 * np.log10(np.abs(record.values)), atol=1e-6)
        phase = np.array([float(row[f"{name}_measured_phase_deg"]) for row in rows])
        np.testing.assert_allclose(phase, np.degrees(np.angle(record.values)), atol=1e-5)
        updated = np.array([float(row[f"{name}_updated_db"]) for row in rows])
        assert np.mean(np.abs(updated - level)[compared]) == pytest.approx(tree["misfit_db"]["responses"][name]["final"], abs=1e-6)
        initial = np.array([float(row[f"{name}_initial_db"]) for row in rows])
        assert np.mean(np.abs(initial - level)[compared]) == pytest.approx(tree["misfit_db"]["responses"][name]["initial"], abs=1e-6)


def test_campaign_table(frame_once: Folder) -> None:
    rows = table(frame_once)
    assert list(rows) == ["tight", "loose-2", "loose-all"]
    for job, row in rows.items():
        tree = frame_once.result(job)
        assert row["status"] == tree["status"]
        assert row["loose"].split() == [b["name"] for b in tree["bolts"] if b["verdict"] == "loose"]
        assert row["undecided"].split() == [b["name"] for b in tree["bolts"] if b["verdict"] == "undecided"]
        assert float(row["damping_exponent"]) == pytest.approx(tree["parameters"]["left_edge"]["damping_exponent"], rel=1e-5)
        assert float(row["misfit_initial_db"]) == pytest.approx(tree["misfit_db"]["initial"])
        assert float(row["misfit_final_db"]) == pytest.approx(tree["misfit_db"]["final"])
        assert int(row["evaluations"]) == tree["evaluations"]
    assert rows["loose-all"]["removed"] == "B1 B2 B3 B4 B5 B6"


def test_loose_bolts_of_the_frame(frame_once: Folder) -> None:
    """What was loosened is found; the other tight bolts lie well above."""
    loose = {b["name"] for b in frame_once.result("loose-2")["bolts"] if b["verdict"] == "loose"}
    assert {"B3", "B4"} <= loose
    assert {b["verdict"] for b in frame_once.result("tight")["bolts"]} == {"tight"}
    everywhere = frame_once.result("loose-all")["bolts"]
    assert sum(b["verdict"] == "loose" for b in everywhere) >= 5
    assert max(frame_once.result(job)["misfit_db"]["final"] for job in ("tight", "loose-2", "loose-all")) < 1.0


# -- kept or run --------------------------------------------------------------------------------------------------------


def test_finished_jobs_are_kept(frame: Folder) -> None:
    before = {path: path.stat().st_mtime_ns for path in frame.out.glob("*/*")}
    result = frame.run("update", "--json")
    assert result.code == 0
    assert result.json["kept"] == ["tight", "loose-2", "loose-all"]
    assert result.json["failed"] == {}
    assert {path: path.stat().st_mtime_ns for path in frame.out.glob("*/*")} == before


def moved(folder: Folder) -> tuple[str, ...]:
    (folder.data / "frf").rename(folder.path / "measured")
    (folder.path / "measured" / "tight.csv").rename(folder.path / "measured" / "first.csv")
    (folder.data / "model" / "stiffness.mtx").rename(folder.data / "k")
    text = folder.config.read_text().replace("data/frf", "./measured").replace("tight.csv", "first.csv")
    folder.config.write_text(text.replace("data/model/stiffness.mtx", "data/./k"))
    return ()


def touched(folder: Folder) -> tuple[str, ...]:
    for path in folder.data.rglob("*.csv"):
        path.touch()
    return ()


def retitled(folder: Folder) -> tuple[str, ...]:
    (folder.out / "campaign.json").unlink()
    return ("--override", "campaign=another title")


def described(folder: Folder) -> tuple[str, ...]:
    said = {"description": "Another word.", "operator": "A. Nobody", "test_article": "plate 2", "compare_with": "paper"}
    return tuple(part for key, value in said.items() for part in ("--override", f"{key}={value}"))


def commented(folder: Folder) -> tuple[str, ...]:
    folder.config.write_text("# a remark\n" + folder.config.read_text())
    return ()


@pytest.mark.parametrize(
    "change",
    [
        moved,
        touched,
        commented,
        lambda _: ("--override", "reduction.backend=superlu"),
        lambda _: ("--workers", "2"),
        retitled,
        described,
        lambda _: ("--accept-tolerance",),
        lambda folder: ("--override", f"output={folder.path.as_posix()}/x/../out"),
    ],
    ids=["paths", "time-stamps", "comments", "back-end", "workers", "title", "description", "accept", "output-path"],
)
def test_what_does_not_decide_about_a_result_keeps_it(frame: Folder, change: Callable[[Folder], tuple[str, ...]]) -> None:
    assert runs(frame, *change(frame)) == []


def one_measurement(folder: Folder) -> tuple[str, ...]:
    scaled_csv(folder.data / "frf" / "loose-2.csv", 1.01)
    return ()


def reference_measurement(folder: Folder) -> tuple[str, ...]:
    scaled_csv(folder.data / "frf" / "tight.csv", 1.01)
    return ()


def mass(folder: Folder) -> tuple[str, ...]:
    path = folder.data / "model" / "stiffness.mtx"
    path.write_text(path.read_text().replace("2.010997600000e+02", "2.010997600001e+02", 1))
    return ()


def positions(folder: Folder) -> tuple[str, ...]:
    path = folder.data / "model" / "bolts.csv"
    path.write_text(path.read_text().replace("B1,-0.01", "B1,-0.02"))
    return ()


ALL = ["tight", "loose-2", "loose-all"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (one_measurement, ["loose-2"]),
        (reference_measurement, ALL),
        (mass, ALL),
        (positions, ALL),
        (lambda _: ("--override", "update.regularisation=0.05"), ALL),
        (lambda _: ("--override", "update.lines=all"), ALL),
        (lambda _: ("--override", "update.responses=[acc1, acc2]"), ALL),
        (lambda _: ("--override", "update.method=bfgs"), ALL),
        (lambda _: ("--override", "parameters.left_edge.initial=6.0"), ALL),
        (lambda _: ("--override", "parameters.left_edge.smoothing=[1.0]"), ALL),
        (lambda _: ("--override", "parameters.left_edge.damping.beta=3e-6"), ALL),
        (lambda _: ("--override", "reduction.tolerance=1e-4"), ALL),
        (lambda _: ("--override", "reduction.band=[30.0, 400.0]"), ALL),
        (lambda _: ("--override", "jobs.loose-2.scale={acc1: 2.0}"), ["loose-2"]),
        (lambda _: ("--override", "jobs.loose-2.records={acc1: acc2, acc2: acc1}"), ["loose-2"]),
        (lambda _: ("--override", "jobs.loose-2.coherence=data/frf/loose-2.csv"), ["loose-2"]),
        (lambda _: ("--override", "update.reference="), ALL),
        (lambda _: ("--force",), ALL),
    ],
    ids=lambda value: "" if isinstance(value, list) else getattr(value, "__name__", "").replace("<lambda>", "override"),
)
def test_what_decides_runs_the_job_again(frame: Folder, change: Callable[[Folder], tuple[str, ...]], expected: list[str]) -> None:
    found = plans(frame, *change(frame))
    assert [name for name, (run, _) in found.items() if run] == expected
    reasons = {reason for run, reason in found.values() if run}
    assert all(reason == "--force" or reason.startswith("changed: ") for reason in reasons)


def test_a_changed_measurement_alone_is_identified_again(box: Folder) -> None:
    before = box.results()
    shutil.copy(box.data / "tight.uff", box.data / "loose.uff")
    result = box.run("update", "--json")
    assert result.json["kept"] == ["tight"]
    after = box.results()
    assert after["tight"] == before["tight"]
    np.testing.assert_allclose(after["loose"]["parameters"]["springs"]["log10"], BOX_TRUTH["tight"], atol=1e-6)
    assert table(box)["loose"]["loose"] == ""


def test_damaged_and_missing_results_are_made_anew(box: Folder) -> None:
    before = box.results()
    folder = box.out / "loose"
    path = folder / "result.json"
    whole = {file: file.read_bytes() for file in folder.iterdir()}
    texts = (path.read_bytes()[:100], b"{}", b"\xff\x00", b'{"format": "lrbc-result"}', b'{"format": "lrbc-result", "version": 1}')
    for reason, damages in {
        "the earlier result is unusable": [partial(path.write_bytes, text) for text in texts],
        "no result yet": [path.unlink],
        "a result file is missing": [(folder / name).unlink for name in ("profile.csv", "frf.csv", "fdac.csv")],
    }.items():
        for damage in damages:
            for file, content in whole.items():
                file.write_bytes(content)
            damage()
            found = plans(box)
            assert found["tight"] == (False, "nothing changed")
            assert found["loose"][0]
            assert found["loose"][1].startswith(reason)
        assert box.run("update").code == 0
        assert box.results() == before


def test_the_files_of_the_campaign_are_written_anew(box: Folder) -> None:
    for name in ("reduction.json", "campaign.json", "structure.json", "campaign.csv"):
        before = (box.out / name).read_bytes()
        (box.out / name).unlink()
        assert box.run("update", "--json").json["kept"] == ["tight", "loose"]
        assert (box.out / name).stat().st_size == pytest.approx(len(before), rel=0.05)


@pytest.mark.slow
def test_any_folder_will_do(box: Folder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blanks and letters of any kind; paths are relative to the campaign file, not to where the command runs."""
    folder = make_box(tmp_path / "Prüfstand 1 – Δ")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    monkeypatch.setenv("LRBC_CACHE", "../my cache")
    config = Path("..") / folder.path.name / "campaign.yaml"
    for command in ("check", "reduce", "update", "report"):
        result = lrbc(command, config)
        assert result.code == 0, result.stderr
    assert lrbc("simulate", config, "--job", "loose", "--out", "Δ.csv").code == 0
    assert (tmp_path / "elsewhere" / "Δ.csv").is_file()
    assert list((tmp_path / "my cache").glob("*/model.h5"))
    assert (folder.out / "report.html").is_file()
    for job, tree in box.results().items():
        assert folder.results()[job]["parameters"] == tree["parameters"]


@pytest.mark.slow
def test_force_and_workers_give_the_same(frame: Folder) -> None:
    before = frame.results()
    for args in (["--force", "--workers", "2"], ["--force", "--workers", "3", "--job", "loose-2"]):
        result = frame.run("update", "--json", *args)
        assert result.code == 0
        assert ("loose-all" in result.json["results"]) == ("--job" not in args)
        assert result.json["kept"] == []
        assert frame.results() == before


def test_one_job_brings_its_reference(tmp_path: Path) -> None:
    folder = make_box(tmp_path / "new")
    result = folder.run("update", "--job", "loose", "--json")
    assert list(result.json["results"]) == ["tight", "loose"]
    assert result.json["results"]["loose"]["bolts"][2]["change"] < -1
    again = folder.run("update", "--job", "tight", "--json")
    assert again.json["kept"] == ["tight"]
    assert list(table(folder)) == ["tight", "loose"]


def test_stopped_is_not_failed(box: Folder) -> None:
    result = box.run("update", "--override", "update.max_iterations=1", "--override", "update.method=bfgs", "--json")
    assert result.code == 0
    for tree in result.json["results"].values():
        assert tree["status"] == "stopped"
        assert "iteration" in tree["reason"]
        assert tree["parameters"]["springs"]["log10"]


# -- failures -----------------------------------------------------------------------------------------------------------


def test_one_failing_job_leaves_the_others(tmp_path: Path) -> None:
    folder = frame(tmp_path / "new")
    (folder.data / "frf" / "loose-2.csv").write_text("frequency_hz,acc1_real\n30,nan\n")
    result = folder.run("update")
    assert result.code == 5
    assert "job loose-2 failed" in result.stderr
    assert "loose-2.csv" in result.stderr
    tree = folder.result("loose-2")
    assert tree["status"] == "failed"
    assert "loose-2.csv" in tree["reason"]
    assert {"identity", "versions", "inputs", "configuration"} <= set(tree["provenance"])
    assert folder.result("tight")["status"] == folder.result("loose-all")["status"] == "converged"
    rows = table(folder)
    assert [row["status"] for row in rows.values()] == ["converged", "failed", "converged"]
    assert "loose-2.csv" in rows["loose-2"]["reason"]
    assert "\nloose-2: no verdict: failed\n" in result.stdout
    assert rows["loose-2"]["finding"] == "no verdict: failed"
    assert folder.run("report", "--job", "loose-2").code == 0
    assert "loose-2.csv" in (folder.out / "report.html").read_text()
    # 5 comes before 6, and stays until the file is fixed.
    assert folder.run("update", "--fail-on-loose").code == 5
    told = folder.run("update", "--json")
    assert told.code == told.json["exit_code"] == 5
    assert list(told.json["failed"]) == ["loose-2"]
    assert told.json["kept"] == ["tight", "loose-all"]
    shutil.copy(frame(tmp_path / "fresh").data / "frf" / "loose-2.csv", folder.data / "frf")
    assert folder.run("update").code == 0
    assert folder.result("loose-2")["status"] == "converged"


@pytest.mark.slow
def test_failures_with_several_workers(tmp_path: Path) -> None:
    folder = frame(tmp_path / "new")
    (folder.data / "frf" / "loose-2.csv").unlink()
    assert folder.run("update", "--workers", "3").code == 5
    assert [row["status"] for row in table(folder).values()] == ["converged", "failed", "converged"]


def test_a_defect_in_one_job_is_its_failure(box: Folder, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    from lrbc_cli.campaign.identification import identify as step

    original = step.identify

    def identify(inputs: Any, source: Any, name: str, *more: Any) -> Any:
        if name == "loose":
            raise ZeroDivisionError("division by zero")
        return original(inputs, source, name, *more)

    monkeypatch.setattr(step, "identify", identify)
    result = box.run("update", "--force")
    assert result.code == 5
    assert "ZeroDivisionError: division by zero" in result.stderr
    assert "Traceback" not in result.stderr
    assert box.result("loose")["status"] == "failed"
    assert box.result("tight")["status"] == "converged"
    with caplog.at_level(logging.DEBUG, "lrbc_cli"):
        assert "Traceback" in box.run("update", "--force", "-vv").stderr


def test_all_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_box(tmp_path / "new")
    for name in ("tight", "loose"):
        (folder.data / f"{name}.uff").unlink()
    result = folder.run("update", "--fail-on-loose")
    assert result.code == 3
    assert result.stderr.count("does not exist") == 2
    assert [row["status"] for row in table(folder).values()] == ["failed", "failed"]

    from lrbc_cli.campaign.identification import identify as step
    from lrbc_cli.errors import NumericalError

    def identify(*_: Any) -> Any:
        raise NumericalError("no step reduces the cost")

    monkeypatch.setattr(step, "identify", identify)
    assert folder.run("update").code == 4
    assert folder.result("loose")["reason"] == "no step reduces the cost"


def test_the_earlier_result_of_a_failing_job_is_kept(box: Folder) -> None:
    before = (box.out / "loose" / "result.json").read_bytes()
    tables = {name: (box.out / "loose" / name).read_bytes() for name in ("profile.csv", "frf.csv")}
    good = (box.data / "loose.uff").read_bytes()
    (box.data / "loose.uff").write_bytes(good[:1000])
    for _ in range(2):
        assert box.run("update").code == 5
        assert box.result("loose")["status"] == "failed"
        assert (box.out / "loose" / "result.previous.json").read_bytes() == before
        assert {name: (box.out / "loose" / name).read_bytes() for name in tables} == tables
    (box.data / "loose.uff").write_bytes(good)
    assert box.run("update").code == 0
    assert box.results()["loose"]["parameters"] == json.loads(before)["parameters"]


def disk_full_at(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """The disk is full when one of these files of the job loose is written."""

    def flush(path: Path, original: Any = atomic._flush) -> None:
        if path.parent.name == "loose" and path.name.startswith(tuple(f".{name}-" for name in names)):
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        original(path)

    monkeypatch.setattr(atomic, "_flush", flush)


@pytest.mark.parametrize("name", ["profile", "frf", "result"])
def test_a_full_disk_takes_no_result_back(box: Folder, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Nothing speaks against the earlier result, of which no file is replaced; the job is reported as failed all the same."""
    before = {path: path.read_bytes() for path in (box.out / "loose").iterdir()}
    with monkeypatch.context() as full:
        disk_full_at(full, name)
        outcome = box.run("update", "--force")
    assert outcome.code == 5, outcome.stderr
    assert "finished results are kept" in outcome.stderr
    assert "\nloose: no verdict" in outcome.stdout
    assert {path: path.read_bytes() for path in (box.out / "loose").iterdir()} == before
    assert box.run("report").code == 0
    assert box.run("update", "--json").json["kept"] == ["tight", "loose"]


def test_a_full_disk_lets_no_outdated_result_stand(box: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """The result is that of another measurement: no verdict is shown for this one. Its tables are still those of the result before."""
    before = {path.name: path.read_bytes() for path in (box.out / "loose").iterdir()}
    shutil.copy(box.data / "tight.uff", box.data / "loose.uff")
    disk_full_at(monkeypatch, "frf")
    assert box.run("update").code == 5
    assert "No space left" in box.result("loose")["reason"]
    after = {path.name: path.read_bytes() for path in (box.out / "loose").iterdir()}
    assert after.pop("result.previous.json") == before.pop("result.json")
    assert after.pop("result.json")
    assert after == before


@pytest.mark.parametrize("before", ["a result", "no result"])
def test_a_failure_that_cannot_be_noted_ends_no_other_job(box: Folder, monkeypatch: pytest.MonkeyPatch, before: str) -> None:
    result = box.out / "loose" / "result.json"
    content = result.read_bytes()
    (box.out / "tight" / "result.json").unlink()
    shutil.copy(box.data / "tight.uff", box.data / "loose.uff")
    if before == "no result":
        result.unlink()
    disk_full_at(monkeypatch, "result", "result.previous")
    outcome = box.run("update")
    assert outcome.code == 5, outcome.stderr
    assert "internal error" not in outcome.stderr
    assert "job loose: its failure cannot be noted" in outcome.stderr
    assert "\nloose: no verdict" in outcome.stdout
    assert box.result("tight")["status"] == "converged"
    assert result.read_bytes() == content if before == "a result" else not result.exists()


def test_a_job_folder_that_cannot_be_read(box: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(original: Any, self: Path, *args: Any, **options: Any) -> Any:
        if self.parent == box.out / "loose":
            raise PermissionError(errno.EACCES, "Permission denied", str(self))
        return original(self, *args, **options)

    real = Path.stat
    monkeypatch.setattr(Path, "stat", lambda self, **options: denied(real, self, **options))
    monkeypatch.setattr(json_text, "regular_bytes", partial(denied, json_text.regular_bytes))
    outcome = box.run("report")
    assert outcome.code == 2, outcome.stderr
    assert "internal error" not in outcome.stderr
    assert "job loose is not shown" in outcome.stderr
    assert "Permission denied" in outcome.stderr
    assert "loose: no verdict: its result cannot be read" in (box.out / "report.html").read_text(encoding="utf-8")


# -- verdicts in the exit code ------------------------------------------------------------------------------------------


def test_fail_on_loose(frame: Folder) -> None:
    assert frame.run("update", "--fail-on-loose").code == 6
    told = frame.run("update", "--fail-on-loose", "--json")
    assert told.code == told.json["exit_code"] == 6
    assert frame.run("update").code == 0
    assert frame.run("update", "--fail-on-loose", "--job", "loose-2").code == 6
    told = frame.run("update", "--fail-on-loose")
    # Beside two missing bolts the others hardly affect the FRFs.
    assert "\nloose-2: B3, B4 loose; 2 tight, 2 inconclusive\n" in told.stdout
    assert "\na bolt is loose\n" in told.stdout
    wide = frame.run("update", "--fail-on-loose", "--override", "update.loose_change=-3")
    assert "update.loose_change: -3 calls a bolt tight that lost up to 99.9 % of its stiffness" in wide.stderr


def test_an_all_clear(frame: Folder) -> None:
    """Only where every bolt was compared and found tight."""
    folder = with_a_tight_job(frame)
    for _ in range(2):
        told = folder.run("update", "--fail-on-loose", "--json")
        assert told.code == told.json["exit_code"] == 0
        assert told.json["not_clear"] == {}
        assert told.json["findings"] == {"tight": "the reference job, taken as tight", "again": "no loose bolt found: 6 tight"}
    assert "\nall clear: every observable bolt is tight\n" in folder.run("update", "--fail-on-loose").stdout
    assert table(folder)["again"]["finding"] == "no loose bolt found: 6 tight"
    assert folder.run("update", "--fail-on-loose", "--job", "again").code == 0

    # The reference job shows nothing by itself.
    alone = folder.run("update", "--fail-on-loose", "--job", "tight", "--json")
    assert (alone.code, alone.json["not_clear"]) == (7, {"": ["no job was compared with the reference job"]})
    # Kept results count with what they say now.
    path = folder.out / "again" / "result.json"
    whole = path.read_text()
    for old, new in [('"verdict": "tight"', '"verdict": "undecided"'), ('"status": "converged"', '"status": "unexplained"')]:
        tree = json.loads(whole.replace(old, new, 1))
        path.write_text(json.dumps(tree | {"digest": digest_of(tree)}))
        told = folder.run("update", "--fail-on-loose", "--json")
        assert (told.code, told.json["kept"], list(told.json["not_clear"])) == (7, ["tight", "again"], ["again"])
        said = folder.run("update", "--fail-on-loose").stdout
        assert "no bolt is judged loose, but this is no all-clear (again: " in said
        assert "all clear:" not in said
    path.write_text(whole)
    assert folder.run("update").code == 0


def test_an_old_measurement_in_other_clothes_is_no_all_clear(frame: Folder) -> None:
    """Every other line, times a factor: none of the figures of the file are those of the other one."""
    folder = with_a_tight_job(frame)
    header, *rows = (folder.data / "frf" / "again.csv").read_text().splitlines()
    numbers = np.array([row.split(",") for row in rows], dtype=float)[::2]
    numbers[:, 1:] *= 1.02
    later = folder.data / "frf" / "later.csv"
    later.write_text("\n".join([header, *(",".join(f"{value:.9g}" for value in row) for row in numbers)]) + "\n")
    tree = folder.tree()
    tree["jobs"]["later"] = {"frf": "data/frf/later.csv"}
    folder.write(tree)
    told = folder.run("update", "--fail-on-loose", "--json")
    assert told.code == 7
    for name, other in (("later", "again"), ("again", "later")):
        assert f"it has the numbers of the measurement of {other}" in str(told.json["not_clear"][name])
        assert folder.run("update", "--fail-on-loose", "--job", name).code == 7
    # While the other file is away, nothing shows that it is another measurement now.
    away = later.rename(folder.data / "away")
    assert "it has the numbers of the measurement of later" in folder.run("update", "--fail-on-loose", "--job", "again").stdout
    away.rename(later)
    # Nothing else changes for a job whose file was right, once the other one is corrected.
    numbers[:, 1:] *= 1.0 + 0.3 * np.sin(np.arange(len(numbers)))[:, None]
    later.write_text("\n".join([header, *(",".join(f"{value:.9g}" for value in row) for row in numbers)]) + "\n")
    plans = folder.run("update", "--dry-run", "--json").json["jobs"]
    assert (plans["again"]["run"], plans["again"]["judge"], plans["again"]["reason"]) == (False, True, "changed: the measurement of later")
    told = folder.run("update", "--fail-on-loose", "--json")
    assert "again" in told.json["judged"]
    assert "again" not in told.json["not_clear"]
    assert not any(plan["run"] or plan["judge"] for plan in folder.run("update", "--dry-run", "--json").json["jobs"].values())


def test_measurements_that_nobody_took_are_no_all_clear(frame: Folder) -> None:
    """A file copied under the name of another state, and a folder that is out of reach: neither shows that the bolts are tight."""
    folder = with_a_tight_job(frame)
    # The same numbers with fewer digits: another export of what was measured before.
    header, *rows = (folder.data / "frf" / "again.csv").read_text().splitlines()
    fewer = [",".join(f"{float(value):.7g}" for value in row.split(",")) for row in rows]
    (folder.data / "frf" / "later.csv").write_text("\n".join([header, *fewer]) + "\n")
    tree = folder.tree()
    tree["jobs"]["later"] = {"frf": "data/frf/later.csv"}
    folder.write(tree)
    told = folder.run("update", "--fail-on-loose", "--json")
    assert (told.code, sorted(told.json["not_clear"])) == (7, ["again", "later"])
    assert "job later: the same measurement as again: check whether another file was meant" in folder.run("update").stderr
    # Which of the two is the copy, nobody knows.
    told = folder.run("update", "--fail-on-loose", "--json", "--job", "again")
    assert (told.code, list(told.json["not_clear"])) == (7, ["again"])

    del tree["jobs"]["later"]
    folder.write(tree | {"watch": {"folder": "measured"}})
    told = folder.run("update", "--fail-on-loose", "--json")
    assert told.code == 7
    assert told.json["not_clear"] == {"": [f"the watched folder {folder.path / 'measured'} is not there"]}
    assert "measured is not there" in folder.run("update").stderr
    (folder.path / "measured").mkdir()
    assert folder.run("update", "--fail-on-loose").code == 0
    shutil.copy(folder.data / "frf" / "again.csv", folder.path / "measured" / "again.dat")
    told = folder.run("update", "--fail-on-loose", "--json")
    assert told.code == 7
    assert "again.dat in " in told.json["not_clear"][""][0]
    told = folder.run("update", "--fail-on-loose", "--json", "--job", "again")
    assert told.code == 7
    assert "again.dat in " in told.json["not_clear"][""][0]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("update.responses=[acc1, acc2, acc3, acc4]",), "not validated"),
        (("update.reference=",), "inconclusive"),
        (("update.largest_misfit=0.01",), "does not explain"),
        (("bolts=",), "no bolts to judge"),
    ],
    ids=["no channel held out", "no reference", "not explained", "no bolts"],
)
def test_no_all_clear(frame: Folder, words: tuple[str, ...], why: str) -> None:
    folder = with_a_tight_job(frame)
    told = folder.run("update", "--fail-on-loose", "--json", *[part for word in words for part in ("--override", word)])
    assert told.code == 7, told.stderr
    assert why in " ".join(told.json["not_clear"]["again"])
    assert why in told.json["findings"]["again"]


def test_a_plan_is_no_all_clear(frame: Folder) -> None:
    told = frame.run("update", "--fail-on-loose", "--dry-run")
    assert told.code == 2
    assert "--dry-run judges no bolt" in told.stderr


def test_the_help_tells_the_codes() -> None:
    text = " ".join(lrbc("update", "--help").stdout.split())
    assert "with 7 if no bolt is judged loose" in text
    assert "7 none is judged loose but not every observable bolt is judged tight" in text


# -- changes nothing, says nothing --------------------------------------------------------------------------------------


@pytest.mark.parametrize("args", [[], ["--json"], ["--force"], ["--job", "loose"]])
def test_dry_run_changes_nothing(box: Folder, tmp_path: Path, args: list[str]) -> None:
    for folder in (box, make_box(tmp_path / "new")):
        before = folder.listing()
        for command in ("update", "reduce"):
            if "--job" in args and command == "reduce":
                continue
            result = folder.run(command, "--dry-run", *args)
            assert result.code == 0
            assert result.stdout
            assert result.stderr == ""
            if "--json" in args:
                assert result.json
        assert folder.run("check").code == 0
        assert folder.listing() == before
    assert "no result yet" in folder.run("update", "--dry-run").stdout
    assert "the cache is empty" in folder.run("update", "--dry-run").stdout
    assert "kept (nothing changed)" in box.run("update", "--dry-run").stdout


def test_other_libraries_keep_results_and_are_told(box: Folder) -> None:
    path = box.out / "loose" / "result.json"
    tree = json.loads(path.read_text(encoding="utf-8"))
    tree["provenance"]["versions"]["scipy"] = "1.0"
    path.write_text(json.dumps(tree | {"digest": digest_of(tree)}), encoding="utf-8")
    told = box.run("update", "--dry-run").stdout
    assert "loose: kept (its inputs did not change, but Python or its libraries did; --force identifies it again)" in told
    assert "tight: kept (nothing changed)" in told


def test_quiet_and_verbose(box: Folder) -> None:
    quiet = box.run("update", "--force", "-q")
    assert (quiet.code, quiet.stderr) == (0, "")
    plain = box.run("update", "--force")
    assert (plain.code, plain.stderr) == (0, "")
    verbose = box.run("update", "--force", "-v", "--json")
    assert verbose.code == 0
    assert re.search(r"^loose: converged, misfit \d\.\d\d -> 0\.00 dB, \d\.\d s; 2 of 2 jobs$", verbose.stderr, re.MULTILINE)
    assert verbose.json["exit_code"] == 0
    kept = box.run("update", "-v", "--json")
    assert "loose: kept, nothing changed" in kept.stderr
    assert set(kept.json) == {"exit_code", "output", "kept", "judged", "failed", "findings", "not_clear", "results"}


def test_warnings_do_not_enter_the_json(box: Folder) -> None:
    box.replace("- 2.0\n    - 0.0\n    - 0.1", "- 2.0\n    - 0.0\n    - 0.15")
    for command in ("check", "reduce", "update"):
        result = box.run(command, "--json")
        assert result.code == 0
        # What check says of the data is part of what was asked for.
        said = result.json["warnings"] if command == "check" else result.stderr.splitlines()
        assert any("responses.mic3" in line for line in said)
        assert (command == "check") == (result.stderr == "")
        assert box.run(command, "-q").stderr == ""


# -- folders that cannot be written -------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["reduce", "update"])
def test_output_that_cannot_be_written(box: Folder, command: str) -> None:
    (box.path / "file").write_text("no folder")
    for output in ("file", "file/below"):
        result = box.run(command, "--override", f"output={box.path.as_posix()}/{output}")
        assert result.code == 2, result.stderr
        assert "the results cannot be written" in result.stderr
        assert "fix:" in result.stderr
        assert "Traceback" not in result.stderr
    assert (box.path / "file").read_text() == "no folder"


@pytest.mark.parametrize("command", ["reduce", "update", "simulate"])
def test_cache_that_cannot_be_written(tmp_path: Path, command: str) -> None:
    folder = make_box(tmp_path / "new")
    (folder.path / "file").write_text("no folder")
    args = ["--out", str(tmp_path / "x.csv")] if command == "simulate" else []
    for cache in ("file", "file/below"):
        result = folder.run(command, "--cache", str(folder.path / cache), *args)
        assert result.code == 2, result.stderr
        assert "Traceback" not in result.stderr
        assert "cache" in result.stderr
    assert not (tmp_path / "x.csv").exists()


def test_results_of_another_program_are_not_overwritten_in_silence(box: Folder) -> None:
    """A job folder that is a file."""
    shutil.rmtree(box.out / "loose")
    (box.out / "loose").write_text("mine")
    result = box.run("update")
    assert result.code == 5, result.stderr
    assert "the results cannot be written" in result.stderr
    assert "job loose: its failure cannot be noted" in result.stderr
    assert (box.out / "loose").read_text() == "mine"
