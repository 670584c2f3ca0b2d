"""``run`` in one go, ``status`` at any time, and what a terminal or a program is shown."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import webbrowser
from pathlib import Path

import pytest
from campaigns import ROOT, Folder, environment, frame, lrbc

from lrbc_cli.cli import terminal

pytestmark = pytest.mark.usefixtures("plain")

SAMPLE = ROOT / "data_samples" / "frame"


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def small(frame_once: Folder, tmp_path: Path) -> Folder:
    """The finished frame campaign without its dearest job."""
    folder = frame_once.copy(tmp_path / "small")
    tree = folder.tree()
    del tree["jobs"]["loose-all"]
    folder.write(tree)
    return folder


def test_from_files_to_the_page_without_an_edit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files, seen = tmp_path / "files", []
    for part in ("points.csv", "model", "frf/tight.csv", "frf/loose-2.csv"):
        source, to = SAMPLE / part, files / part
        to.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, to)
    monkeypatch.setattr(webbrowser, "open", lambda url: seen.append(url) or True)
    folder, out = Folder(tmp_path / "new"), tmp_path / "new" / "output"
    assert lrbc("init", "--from", files, folder.path).code == 0
    checked = folder.run("check")
    assert (checked.code, checked.stderr) == (0, "")
    first = folder.run("run", "--open", "--fail-on-loose")
    assert first.code == 6, first.stderr
    assert seen == [(out / "report.html").as_uri()]
    assert "<html" in (out / "report.html").read_text()
    assert (out / "calibration.json").is_file()
    tight, loose, page, verdict = first.stdout.splitlines()
    assert tight.startswith("tight: the reference job, taken as tight")
    assert loose.startswith("loose-2: B3, B4 loose")
    assert page == f"report: {out / 'report.html'}"
    assert verdict == "a bolt is loose"
    with folder.config.open("a") as file:
        file.write("  lost: {frf: lost.csv}\n")
    stamps = {name: (out / name).stat().st_mtime_ns for name in ("calibration.json", "loose-2/result.json")}
    again = folder.run("run")
    # A job failed; what is finished is kept, and the report is written.
    assert again.code == 5
    assert again.stdout.splitlines()[2].startswith("lost: failed:")
    assert again.stderr.count("the file does not exist") == 1
    assert "lost" in (out / "report.html").read_text()
    assert {name: (out / name).stat().st_mtime_ns for name in stamps} == stamps
    assert len(seen) == 1


def test_exit_codes_are_those_of_update(small: Folder) -> None:
    result = small.run("run", "--no-calibration", "--fail-on-loose")
    assert result.code == 6
    assert result.stdout.splitlines()[-1] == "a bolt is loose"
    assert not (small.out / "calibration.json").exists()
    assert small.run("run", "--no-calibration").code == 0
    # Drawn over a folder the page cannot be written: the worst of the steps counts.
    (small.out / "report.html").unlink()
    (small.out / "report.html").mkdir()
    broken = small.run("run", "--no-calibration", "--fail-on-loose")
    assert broken.code in (2, 3)
    assert "loose-2: B3, B4 loose" in broken.stdout
    assert "report:" not in broken.stdout


def test_a_job_that_does_not_exist_suggests_the_nearest(frame: Folder) -> None:
    before = frame.listing()
    for name in ("run", "update"):
        result = frame.run(name, "--job", "lose-2")
        assert result.code == 2
        assert "did you mean 'loose-2'?" in result.stderr
    assert frame.listing() == before


def test_status_tells_every_state(small: Folder) -> None:
    def states(*args: str) -> dict[str, str]:
        found = small.run("status", "--json", *args)
        assert found.code == 0
        assert sum(found.json["counts"].values()) == len(found.json["jobs"])
        return {name: job["state"] for name, job in found.json["jobs"].items()}

    # A job less changes nothing for the others.
    assert states() == {"tight": "done", "loose-2": "done"}
    assert small.run("status", "--json").json["seconds_left"] == 0
    tree = small.tree()
    tree["jobs"] |= {"next": {"frf": "data/frf/loose-all.csv"}, "later": {"frf": "data/frf/later.csv"}}
    small.write(tree)
    bad = small.data / "frf" / "bad.csv"
    bad.write_text("nothing\n")
    tree["jobs"]["bad"] = {"frf": "data/frf/bad.csv"}
    small.write(tree)
    assert small.run("update", "--job", "bad").code == 5
    # The message has several lines, its row has one.
    rows = (small.out / "campaign.csv").read_text(encoding="utf-8").splitlines()
    assert [row.partition(",")[0] for row in rows] == ["job", "tight", "loose-2", "bad"]
    measured = small.data / "frf" / "loose-2.csv"
    measured.write_text(measured.read_text().replace("30,", "30.0,", 1))
    before = small.listing()
    assert states() == {"tight": "done", "loose-2": "stale", "next": "new", "later": "missing", "bad": "failed"}
    tree = small.run("status", "--json").json
    assert tree["jobs"]["loose-2"]["reason"] == "changed: its measurement"
    assert "no table of numbers" in tree["jobs"]["bad"]["reason"]
    assert tree["jobs"]["later"]["reason"].endswith("later.csv")
    times = [json.loads((small.out / name / "result.json").read_text())["seconds"]["total"] for name in ("tight", "loose-2")]
    # Three jobs run, the one without a file does not.
    assert tree["seconds_left"] == pytest.approx(3 * sum(times) / 2)
    text = small.run("status").stdout
    assert text.startswith("frame-left-edge: 1 done, 1 out of date, 1 no FRF file, 1 failed, 1 not run yet\n")
    assert f"next: lrbc run {small.config}\n" in text
    as_named = small.run("status", "--override", "update.confidence=0.9").stdout
    assert f"next: lrbc run {small.config} --override update.confidence=0.9\n" in as_named
    assert small.listing() == before
    assert tree["jobs"]["next"]["reason"] == ""
    (small.out / "loose-2" / "result.json").write_text("{")
    damaged = small.run("status", "--json").json["jobs"]["loose-2"]
    assert damaged["state"] == "new"
    assert damaged["reason"].startswith("the earlier result is unusable (")


def test_check_reads_on(tmp_path: Path) -> None:
    folder = frame(tmp_path / "new")
    model = folder.data / "model"
    (model / "stiffness.mtx").unlink()
    (model / "bolts.csv").write_text("name,x,y\nB1,0,0\n")
    (folder.data / "frf" / "tight.csv").unlink()
    result = folder.run("check")
    assert result.code == 3
    for said in (
        "stiffness.mtx: the file does not exist",
        "bolts.csv, line 1: the column z is missing",
        "tight.csv: the file does not exist",
    ):
        assert result.stderr.count(said) == 1
    assert result.stderr.count("fix:") == 2
    tree = folder.run("check", "--json").json
    assert (tree["exit_code"], tree["error"]["kind"]) == (3, "data")
    assert set(tree["errors"]) == {"model.stiffness", "bolts", "tight"}


def test_check_reads_on_in_the_campaign_file(tmp_path: Path) -> None:
    folder = frame(tmp_path / "new")
    folder.replace("hammer: {near: [0.16, 0.12, 0.0], component: UZ}", "hammer: {node: 48, component: UX}")
    folder.replace("acc1: {near: [0.32, 0.28, 0.0]", "acc1: {near: [320, 280, 0]")
    (folder.data / "model" / "edge.csv").unlink()
    result = folder.run("check")
    assert result.code == 2
    for said in ("node 48 has no DOF UX", "these are probably millimetres", "edge.csv: the file does not exist"):
        assert result.stderr.count(said) == 1
    # Others stop at the first.
    assert folder.run("reduce").stderr.count("fix:") == 1


@pytest.mark.parametrize("name", ["check", "update", "plan"])
def test_stiffness_and_mass_exchanged(tmp_path: Path, name: str) -> None:
    folder = frame(tmp_path / "new")
    tree = folder.tree()
    model = tree["model"]
    model["stiffness"], model["mass"] = model["mass"], model["stiffness"]
    folder.write(tree)
    result = folder.run(name)
    assert result.code == 3
    assert result.stderr.count("the stiffness and the mass matrix are exchanged") == 1
    assert "exchange model.stiffness and model.mass" in result.stderr


def test_errors_for_programs(frame: Folder) -> None:
    for args, code, kind in (((), 2, "usage"), (("--nonsense",), 2, "usage")):
        result = lrbc("update", frame.path / "none.yaml", "--json", *args)
        assert (result.code, result.json["exit_code"], result.json["error"]["kind"]) == (code, code, kind)
        assert result.stderr
    (frame.data / "model" / "edge.csv").unlink()
    error = frame.run("update", "--json").json["error"]
    assert (error["kind"], error["problem"]) == ("data", "the file does not exist")
    assert error["file"].endswith("edge.csv")


RED, AMBER, GREEN = "\x1b[31m", "\x1b[33m", "\x1b[32m"


def test_colours_are_for_terminals(frame: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = frame.run("status")
    assert "\x1b" not in plain.stdout + plain.stderr
    monkeypatch.setenv("FORCE_COLOR", "1")
    text = frame.run("status").stdout
    for colour, word in ((RED, "loose"), (GREEN, "tight")):
        assert f"{colour}{word}\x1b[0m" in text
    assert terminal.painted("a: B3 loose, B2 probably; 1 inconclusive").count(AMBER) == 2
    # Names are no verdicts.
    assert f"{RED}loose\x1b[0m-2" not in text
    assert f"taken as {GREEN}" not in text
    assert frame.run("update", "--job", "none").stderr.startswith(RED)
    for name in ("update", "status", "check"):
        assert "\x1b" not in frame.run(name, "--json").stdout
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b" not in frame.run("status").stdout


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal")
def test_progress_is_cleared_before_a_result(frame: Folder) -> None:
    import pty

    (frame.out / "loose-2" / "result.json").unlink()
    parent, child = pty.openpty()
    line = [sys.executable, "-m", "lrbc_cli", "update", str(frame.config), "--cache", str(frame.cache)]
    process = subprocess.Popen(line, stdout=child, stderr=child, env=environment())
    os.close(child)
    text = b""
    try:
        while part := os.read(parent, 65536):
            text += part
    except OSError:
        pass  # the terminal closes with its last writer
    os.close(parent)
    assert process.wait(60) == 0
    shown = text.decode().replace("\r\n", "\n")
    assert "of 3 jobs" in shown
    results = [line for line in shown.split("\n") if "results in" in line or "loose bolts" in line]
    assert len(results) == 2
    for result in results:
        # What stands before the last return is overwritten: by blanks, then by the result.
        *before, last = result.split("\r")
        assert last.startswith(("results in", "job "))
        assert not before or not before[-1].strip()


def test_status_tells_why_a_file_cannot_be_used(small: Folder) -> None:
    """As `watch` does; it is no job that only waits for its turn."""
    tree = small.tree()
    tree["jobs"]["half"] = {"frf": "data/frf/half.csv"}
    small.write(tree)
    (small.data / "frf" / "half.csv").write_text("frequency_hz,mic1\n")
    told = small.run("status", "--json").json
    assert told["jobs"]["half"]["state"] == "unusable"
    assert "half.csv" in told["jobs"]["half"]["reason"]
    assert "\n" not in told["jobs"]["half"]["reason"]
    assert (told["counts"]["unusable"], told["counts"]["new"], told["seconds_left"]) == (1, 0, 0)
    assert "nothing to run, but FRF files are unusable" in small.run("status").stdout
    # A result of an earlier measurement is told.
    (small.data / "frf" / "loose-2.csv").write_text("frequency_hz,mic1\n")
    again = small.run("status", "--json").json["jobs"]["loose-2"]
    assert again["state"] == "unusable"
    assert again["reason"].endswith("there is a result of an earlier measurement")


@pytest.mark.slow
def test_status_tells_of_the_page(small: Folder) -> None:
    def told() -> str | None:
        trouble = small.run("status", "--json").json["report"]["trouble"]
        assert (trouble is None) == ("report.html:" not in small.run("status").stdout)
        return trouble

    assert told() == "missing"
    assert small.run("report").code == 0
    assert told() is None
    page = (small.out / "report.html").stat().st_mtime_ns
    os.utime(small.out / "loose-2" / "result.json", ns=(page + 10**9, page + 10**9))
    assert told() == "older than the results of loose-2"


def test_a_line_is_cleared_once(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.line.show("at work")
    terminal.say("done")
    terminal.say("done")
    out, err = capsys.readouterr()
    assert out == "done\ndone\n"
    assert err.count("\r") == 3


@pytest.mark.slow
def test_a_result_that_outlived_its_measurement_is_told(small: Folder) -> None:
    """The page still shows it: of which measurement, or of which campaign, nobody sees any more."""
    assert small.run("update").code == 0
    assert "any more" not in small.run("report").stdout
    (small.data / "frf" / "loose-2.csv").unlink()
    told = small.run("report").stdout
    assert "loose-2: loose-2.csv no longer exists; the result is that of an earlier measurement\n" in told
    assert "loose-2.csv no longer exists" in (small.out / "report.html").read_text(encoding="utf-8")
    tree = small.tree()
    del tree["jobs"]["loose-2"]
    small.write(tree)
    told = small.run("report").stdout
    assert "loose-2: no longer a job of campaign.yaml; the result is that of an earlier job. `lrbc update` leaves it out\n" in told
    assert small.run("update").code == 0
    assert "loose-2" not in small.run("report").stdout
