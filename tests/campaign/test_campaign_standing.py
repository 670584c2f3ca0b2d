"""What a result stands on: the tight states behind its verdicts, and the tables that were written with it."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from campaigns import Folder, environment, finished, two_jobs

from lrbc_cli.campaign.jobs.identity import Identity
from lrbc_cli.campaign.jobs.rejudge import Standing, unchanged
from lrbc_cli.campaign.jobs.standing import changes_of, other_baselines, other_reference, state_of
from lrbc_cli.config import load_campaign
from lrbc_cli.results.job import JobRecord, RestsOn
from lrbc_cli.results.store import digest_of, read_before, read_job

OTHERS = ["loose-2"]

#: The command on a disk that is full while one job is written: a limit of the size of files, of which the record of a failure has less.
FULL = """
import resource, sys
from lrbc_cli.campaign.jobs import run

name = sys.argv.pop(1)
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]

def write_result(output, finished, original=run.write_result):
    if finished.record.job != name:
        return original(output, finished)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        return original(output, finished)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))

run.write_result = write_result
from lrbc_cli.cli.main import main
main()
"""


def on_a_full_disk(folder: Folder, job: str, *args: str) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-c", FULL, job, "update", str(folder.config), "--cache", str(folder.cache), *args]
    return subprocess.run(line, capture_output=True, text=True, check=False, timeout=120, env=environment())


def plans(folder: Folder, *args: str) -> dict[str, tuple[bool, str]]:
    outcome = folder.run("update", "--dry-run", "--json", *args)
    assert outcome.code == 0, outcome.stderr
    return {name: (job["run"], job["reason"]) for name, job in outcome.json["jobs"].items()}


def change(path: Path, edit: Any) -> None:
    """As if it had been written like that: a result vouches for itself."""
    tree = json.loads(path.read_text())
    edit(tree)
    path.write_text(json.dumps(tree | {"digest": digest_of(tree)} if "digest" in tree else tree))


@pytest.fixture(scope="module")
def frame_once() -> Folder:
    """Two jobs of the frame, done; read only."""
    return finished("two jobs")


needs_limits = pytest.mark.skipif(sys.platform == "win32", reason="no limit of the size of a file")


# -- the reference job --------------------------------------------------------------------------------------------------


@needs_limits
@pytest.mark.slow
def test_a_passing_failure_of_the_reference_job(frame_once: Folder, tmp_path: Path) -> None:
    """Verdicts without it are given again as soon as it is there."""
    folder = two_jobs(tmp_path / "frame")
    full = on_a_full_disk(folder, "tight", "--fail-on-loose")
    assert full.returncode == 5, full.stderr
    assert "cannot be written" in folder.result("tight")["reason"]
    for name in OTHERS:
        tree = folder.result(name)
        assert tree["provenance"]["rests_on"] == {"reference": None, "baselines": {}}
        assert {bolt["verdict"] for bolt in tree["bolts"]} == {"undecided"}
    assert plans(folder) == {
        "tight": (True, "it failed before"),
        **{name: (True, "identified without tight, which runs before it") for name in OTHERS},
    }
    outcome = folder.run("update", "--fail-on-loose", "--json")
    assert (outcome.code, outcome.json["kept"]) == (6, [])
    for name, tree in frame_once.results().items():
        assert folder.result(name)["bolts"] == tree["bolts"]


@needs_limits
@pytest.mark.slow
def test_a_full_disk_takes_no_verdict_back(frame: Folder) -> None:
    """The job is reported as failed, but nothing speaks against its earlier result."""
    before = {path: path.read_bytes() for path in (frame.out / "loose-2").iterdir()}
    full = on_a_full_disk(frame, "loose-2", "--force")
    assert full.returncode == 5, full.stderr
    assert "finished results are kept" in full.stderr
    assert {path: path.read_bytes() for path in (frame.out / "loose-2").iterdir()} == before
    assert "loose-2" in frame.run("update", "--json").json["kept"]
    assert frame.run("report").code == 0


@pytest.mark.slow
def test_a_reference_job_that_fails_for_good(frame: Folder) -> None:
    """Its measurement is gone: what was identified with its earlier result, or without any, is kept while nothing changes."""
    (frame.data / "frf" / "tight.csv").unlink()
    for earlier in (True, False):
        if not earlier:
            (frame.out / "tight" / "result.previous.json").unlink()
        first = frame.run("update", "--json", "--fail-on-loose")
        assert (first.code, list(first.json["failed"]), first.json["kept"]) == (5, ["tight"], [])
        rests = {name: frame.result(name)["provenance"]["rests_on"]["reference"] for name in OTHERS}
        assert all((digest is not None) == earlier for digest in rests.values())
        again = frame.run("update", "--json", "--fail-on-loose")
        assert (again.code, again.json["kept"]) == (5, OTHERS)


def test_the_same_reference_again(frame: Folder) -> None:
    """Identified anew with the same end, it is no reason to identify the others."""
    (frame.out / "tight" / "fdac.csv").unlink()
    found = plans(frame)
    assert found["tight"][0]
    assert found["loose-2"] == (False, "unless tight, which runs before it, gives another result")
    assert frame.run("update", "--json").json["kept"] == OTHERS


def test_another_reference(frame: Folder) -> None:
    """However it came there."""
    change(frame.out / "tight" / "result.json", lambda tree: tree["parameters"]["left_edge"]["log10"].__setitem__(3, 5.0))
    found = plans(frame)
    assert not found["tight"][0]
    for name in OTHERS:
        assert found[name] == (True, "it rests on a result of tight that is no longer there")
    assert frame.run("update", "--json").json["kept"] == ["tight"]
    assert not any(run for run, _ in plans(frame).values())


@pytest.mark.slow
@needs_limits
def test_the_earlier_reference_stands_in(frame: Folder) -> None:
    before = frame.results()
    full = on_a_full_disk(frame, "tight", "--force")
    assert full.returncode == 5, full.stderr
    for name in OTHERS:
        assert frame.result(name)["bolts"] == before[name]["bolts"]
    outcome = frame.run("update", "--json")
    assert (outcome.code, outcome.json["kept"]) == (0, ["tight", *OTHERS])


def test_an_earlier_reference_of_other_groups_does_not_stand_in(frame: Folder) -> None:
    """Of a change that nothing is known of, zero is not a value."""
    change(frame.out / "tight" / "result.json", lambda tree: tree.update(parameters={"another": tree["parameters"]["left_edge"]}))
    (frame.data / "frf" / "tight.csv").unlink()
    assert frame.run("update").code == 5
    for name in OTHERS:
        assert frame.result(name)["provenance"]["rests_on"]["reference"] is None
        assert {bolt["verdict"] for bolt in frame.result(name)["bolts"]} == {"undecided"}


@pytest.mark.slow
def test_a_baseline_that_was_missing(tmp_path: Path) -> None:
    """Its scatter decides what counts as loose: what was judged without it is judged again."""
    folder = two_jobs(tmp_path / "frame")
    measured = folder.data / "frf" / "tight.csv"
    (folder.data / "frf" / "again.csv").write_bytes(measured.read_bytes())
    tree = folder.tree()
    tree["jobs"] = {name: {"frf": tree["jobs"][name]["frf"]} for name in ("tight", "loose-2")} | {"again": {"frf": "data/frf/again.csv"}}
    tree["update"]["baselines"] = ["again"]
    folder.write(tree)
    full = on_a_full_disk(folder, "again")
    assert full.returncode == 5, full.stderr
    assert folder.result("loose-2")["provenance"]["rests_on"]["baselines"] == {}
    assert plans(folder)["loose-2"] == (False, "unless again, which runs before it, gives another result")
    outcome = folder.run("update", "--json")
    assert (outcome.json["kept"], outcome.json["judged"]) == (["tight"], ["loose-2"])
    assert list(folder.result("loose-2")["provenance"]["rests_on"]["baselines"]) == ["again"]
    assert folder.run("update", "--json").json["kept"] == ["tight", "again", "loose-2"]
    # Tight by assumption, both, so that nothing is shown without the third.
    assert folder.run("update", "--fail-on-loose", "--job", "again").code == 7


@pytest.mark.slow
def test_a_baseline_that_was_a_copy(frame: Folder) -> None:
    """Whether a measurement has the numbers of a baseline's is looked for when judging, in the files that there are then."""
    own, other = (frame.data / "frf" / f"{name}.csv" for name in ("loose-2", "again"))
    header, *rows = own.read_text().splitlines()
    rounded = [",".join(f"{float(cell):.5g}" for cell in row.split(",")) for row in rows]
    other.write_text("\n".join([header, *rounded]) + "\n")
    tree = frame.tree()
    tree["jobs"]["again"] = {"frf": "data/frf/again.csv"}
    tree["update"]["baselines"] = ["again"]
    frame.write(tree)
    assert plans(frame)["loose-2"] == (False, "changed: the measurements of the baselines")
    assert frame.run("update", "--json").json["judged"] == ["loose-2"]
    assert "it has the numbers of the measurement of again" in frame.result("loose-2")["validity"]["reason"]
    other.write_bytes((frame.data / "frf" / "loose-all.csv").read_bytes())
    assert "it has the numbers of the measurement of again" in frame.result("loose-2")["validity"]["reason"]
    assert plans(frame)["loose-2"] == (False, "changed: the measurements of the baselines")
    outcome = frame.run("update", "--json")
    assert (outcome.json["kept"], outcome.json["judged"]) == (["tight"], ["loose-2"])
    assert "it has the numbers" not in frame.result("loose-2")["validity"]["reason"]


def test_what_others_rest_on(frame_once: Folder) -> None:
    """The state, however it is judged; of a baseline its changes, the losses that it excludes, and its misfit."""
    record, other = read_job(frame_once.out, "loose-2"), read_job(frame_once.out, "tight")
    assert isinstance(record, JobRecord)
    assert isinstance(other, JobRecord)
    same = {"seconds": {"total": 99.0}, "notes": ("x",), "bolts": (), "validity": None, "status": "unexplained"}
    assert state_of(record.model_copy(update=same).state) == state_of(record.state)
    assert state_of(JobRecord.checked(record.tree()).state) == state_of(record.state)
    for key in ("parameters", "covariance", "noise", "misfit_db"):
        assert state_of(record.model_copy(update={key: getattr(other, key)}).state) != state_of(record.state), key
    assert changes_of(record.model_copy(update={"notes": ("x",)})) == changes_of(record)
    for key, different in (("misfit_db", other.misfit_db), ("status", "unexplained")):
        assert changes_of(record.model_copy(update={key: different})) != changes_of(record), key
    for key, value in (("change", 0.1), ("change_std", 0.1), ("verdict", "undecided"), ("excluded_groups", ("axial",))):
        bolt = record.bolts[0].model_copy(update={key: value})
        assert changes_of(record.model_copy(update={"bolts": (bolt, *record.bolts[1:])})) != changes_of(record), key


def test_why_a_result_does_not_rest_on_what_there_is() -> None:
    now = RestsOn(reference="r", baselines={"b": "s"})
    without = RestsOn(reference=None, baselines=now.baselines)
    assert other_reference(now, now, "tight") is None
    assert other_reference(without, now, "tight") == "it was identified without a result of tight"
    assert "no longer there" in str(other_reference(now, without, "tight"))
    assert other_baselines(now, now) is None
    for baselines in ({}, {"b": "another"}, {"b": "s", "c": "x"}):
        assert "baselines (" in str(other_baselines(now, RestsOn(reference="r", baselines=baselines)))


# -- judged anew --------------------------------------------------------------------------------------------------------

#: A rule that decides otherwise on the frame: with its own of 95 % all bolts of loose-2 are judged.
STRICT = ("--override", "update.confidence=0.999")


def test_another_rule_judges_anew(frame: Folder, tmp_path: Path) -> None:
    """As if run anew, from what is stored, and back again."""
    before = frame.results()
    stored = {name: frame.result(name)["provenance"] for name in before}
    found = plans(frame, *STRICT)
    assert all(found[name] == (False, "changed: the decision rule") for name in ("tight", *OTHERS))
    outcome = frame.run("update", "--json", *STRICT)
    assert (outcome.code, outcome.json["kept"], outcome.json["judged"]) == (0, [], ["tight", *OTHERS])
    after = frame.results()
    verdicts = {name: [bolt["verdict"] for bolt in tree["bolts"]] for name, tree in after.items()}
    assert verdicts["loose-2"].count("undecided") > [bolt["verdict"] for bolt in before["loose-2"]["bolts"]].count("undecided")
    for name in after:
        own = frame.result(name)["provenance"]
        assert own["files"] == stored[name]["files"]
        assert own["identity"] == stored[name]["identity"]
        assert own["configuration"]["update"]["confidence"] == 0.999
    anew = frame.run("update", "--json", "--force", *STRICT, "--override", f"output={tmp_path / 'anew'}")
    assert anew.code == 0
    for name, tree in anew.json["results"].items():
        for key in ("status", "reason", "bolts", "validity", "taken_as_tight", "warnings", "notes", "prior", "parameters", "removed"):
            assert after[name][key] == tree[key], (name, key)
        assert frame.result(name)["provenance"]["judgement"] == tree["provenance"]["judgement"]
    assert frame.run("report", *STRICT).code == 0
    assert frame.run("update", "--json").json["judged"] == ["tight", *OTHERS]
    for name, tree in frame.results().items():
        assert tree["bolts"] == before[name]["bolts"]
    assert frame.run("update", "--json").json["kept"] == ["tight", *OTHERS]


#: The command, which says on the last line of stdout what it loaded.
LOADED = "import sys; from lrbc_cli.cli.main import main; main(sys.argv[1:], standalone_mode=False); print(*sys.modules)"

#: What reads models, identifies and draws.
IDLE = {"scipy", "h5py", "matplotlib", "dask", "lrbc_cli.io.matrices.read"}
IDLE |= {"lrbc_cli.campaign.reading.inputs", "lrbc_cli.campaign.identification.identify", "lrbc_cli.method.resolve"}


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """Two jobs that were done where they lie: of a copy, the files that its results name are others."""
    folder = two_jobs(tmp_path_factory.mktemp("here") / "frame")
    assert folder.run("update").code == 0
    return folder


def standing(folder: Folder, *overrides: str) -> Standing | None:
    return unchanged(load_campaign(folder.config, overrides), (), calibration=True)


@pytest.mark.slow
def test_judging_anew_loads_no_more_than_it_needs(here: Folder) -> None:
    """It takes seconds of waiting otherwise: no model is read where the bytes of all files are known."""
    line = [sys.executable, "-c", LOADED, "update", str(here.config), "--cache", str(here.cache), "--json"]
    for confidence, judged in (("0.999", ["tight", *OTHERS]), ("0.999", []), ("0.95", ["tight", *OTHERS])):
        more = ["--override", f"update.confidence={confidence}"]
        done = subprocess.run([*line, *more], capture_output=True, text=True, check=True, env=environment())
        tree, modules = done.stdout.rstrip().rsplit("\n", 1)
        assert json.loads(tree)["judged"] == judged
        assert not IDLE & set(modules.split())
        # The model at hand, the same is to be done.
        assert not any(run for run, _ in plans(here, *more).values())


@pytest.mark.slow
def test_without_a_model_the_same_is_said_and_written(here: Folder) -> None:
    """Byte for byte, back and forth, and to the ear."""
    output, other = here.out, ("--override", "update.confidence=0.98", "--override", "update.nuisances.room=21")
    assert here.run("update", *other[2:]).code == 0
    assert standing(here, other[-1]) is not None
    quick = here.run("update", *other)
    written = {path.relative_to(output): path.read_bytes() for path in output.rglob("*.*")}
    assert here.run("update", *other[2:]).code == 0
    # What was said of the inputs is not known: a model is read.
    change(output / "campaign.json", lambda tree: tree.pop("reading"))
    assert standing(here, other[-1]) is None
    slow = here.run("update", *other)
    assert (quick.stdout, quick.stderr) == (slow.stdout, slow.stderr)
    assert "update.nuisances.room: 21 is not used" in quick.stderr
    assert {path.relative_to(output): path.read_bytes() for path in output.rglob("*.*")} == written
    assert here.run("update").code == 0


def test_a_change_besides_the_rule_needs_the_model(here: Folder) -> None:
    assert standing(here, "update.confidence=0.9", "update.loose_change=-0.5", "update.largest_misfit=2.0") is not None
    for override in ("update.loss_scale=2.0", "reduction.tolerance=2e-3", "jobs.loose-2.removed=[B1]", "description=x", "output=other"):
        assert standing(here, override) is None, override
    assert unchanged(load_campaign(here.config, ()), (), calibration=False) is None
    files = [*here.data.rglob("*.csv"), here.data / "model" / "mass.mtx.gz", here.out / "structure.json", here.out / "reduction.json"]
    for file in [file for file in files if file.name not in ("loose-all.csv",)]:
        content = file.read_bytes()
        file.write_bytes(content + b" ")
        told = None if file.name == "reduction.json" else standing(here)
        file.unlink()
        assert told is None, file
        assert standing(here) is None, file
        file.write_bytes(content)
    (here.out / "calibration.json").write_text("{}")
    assert standing(here) is None
    (here.out / "calibration.json").unlink()
    assert standing(here) is not None


def test_a_result_that_was_changed_needs_the_model(here: Folder) -> None:
    for name in ("result.json", "evidence.json", "frf.csv"):
        file = here.out / "loose-2" / name
        content = file.read_bytes()
        file.write_bytes(content.replace(b"1", b"2", 1))
        assert standing(here) is None, name
        file.write_bytes(content)
    file = here.out / "loose-2" / "result.json"
    content = file.read_bytes()
    change(file, lambda tree: tree["provenance"].pop("origin"))
    assert standing(here) is None
    file.write_bytes(content)
    # Of the reference job another measurement was identified since.
    reference = here.out / "tight" / "result.json"
    before = reference.read_bytes()
    parts = here.result("tight")["provenance"]["parts"] | {"measurement": "0" * 64}
    change(reference, lambda tree: tree["provenance"].update(parts=parts, identity=Identity.of(parts).digest))
    assert standing(here) is None
    reference.write_bytes(before)
    assert standing(here) is not None


def test_files_that_a_finished_job_was_made_from(frame_once: Folder, frame: Folder) -> None:
    """They are known to the HDF5 library that there is, which read them whole."""
    known = read_before(frame_once.out, ["none", "loose-2", "tight"])
    assert set(known) == set(frame_once.result("loose-2")["provenance"]["inputs"].values())
    change(frame.out / "loose-2" / "result.json", lambda tree: tree["provenance"]["versions"].update(h5py="0.1"))
    assert read_before(frame.out, ["loose-2", "tight"]) == []
    (frame.out / "loose-2" / "result.json").write_text("{")
    assert set(read_before(frame.out, ["loose-2", "tight"])) == set(frame.result("tight")["provenance"]["inputs"].values())


@pytest.mark.parametrize(
    ("override", "part"),
    [
        ("update.loose_change=-0.9", "the decision rule"),
        ("update.largest_misfit=0.1", "the decision rule"),
        ("jobs.loose-2.removed=[B1]", "the bolts stated as removed"),
        ("update.baselines=[loose-2]", "its role in the campaign"),
    ],
)
def test_what_only_judges(frame: Folder, override: str, part: str) -> None:
    found = plans(frame, "--override", override)
    assert not any(run for run, _ in found.values())
    assert found["loose-2"][1] == f"changed: {part}"


@pytest.mark.parametrize("damage", [lambda tree: tree.update(version=2), lambda tree: tree["evidence"]["bolts"][0].update(change="much")])
def test_evidence_that_cannot_be_read_is_identified_anew(frame: Folder, damage: Callable[[dict[str, Any]], None]) -> None:
    path = frame.out / "loose-2" / "evidence.json"
    change(path, damage)
    hashed = hashlib.sha256(path.read_bytes()).hexdigest()
    change(frame.out / "loose-2" / "result.json", lambda tree: tree["provenance"]["files"].update({"evidence.json": hashed}))
    assert not plans(frame)["loose-2"][0]
    run, reason = plans(frame, *STRICT)["loose-2"]
    assert run
    assert "evidence is unusable" in reason
    assert frame.run("update", "--json", *STRICT).json["judged"] == ["tight"]


# -- the files of a job -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", [*(pytest.param(name, marks=pytest.mark.slow) for name in ("profile.csv", "frf.csv", "fdac.csv")), "evidence.json"]
)
def test_a_table_of_another_run(frame: Folder, name: str) -> None:
    path = frame.out / "loose-2" / name
    whole = path.read_bytes()
    for content in (whole.replace(b"1", b"2", 1), b"", (frame.out / "tight" / name).read_bytes()):
        path.write_bytes(content)
        report = frame.run("report")
        assert report.code == 3
        assert str(path) in report.stderr
        assert "lrbc update" in report.stderr
        assert "loose-2: no verdict: its result cannot be read" in (frame.out / "report.html").read_text(encoding="utf-8")
        assert plans(frame)["loose-2"][0]
        assert name in plans(frame)["loose-2"][1]
    outcome = frame.run("update", "--json")
    assert outcome.json["kept"] == ["tight"]
    assert path.read_bytes() == whole


def test_a_result_that_was_edited(frame: Folder) -> None:
    """A verdict that nothing was found for is shown by no command, and is no all-clear."""
    path = frame.out / "loose-2" / "result.json"
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b'"verdict": "loose"', b'"verdict": "tight"'))
    assert path.read_bytes() != whole
    for words in (["report"], ["simulate", "--job", "loose-2", "--out", str(frame.path / "x.csv")]):
        outcome = frame.run(*words)
        assert outcome.code == 3
        assert str(path) in outcome.stderr
        assert "changed after it was written" in outcome.stderr
        assert "lrbc update" in outcome.stderr
    assert plans(frame) == {
        "tight": (False, "nothing changed"),
        "loose-2": (True, "the earlier result is unusable (this result file was changed after it was written)"),
    }
    assert frame.run("status", "--json").json["jobs"]["loose-2"]["state"] == "new"
    outcome = frame.run("update", "--json", "--fail-on-loose")
    assert (outcome.code, outcome.json["kept"]) == (6, ["tight"])
    # The layout and the order of the keys say nothing.
    tree = json.loads(path.read_text())
    path.write_text(json.dumps(dict(reversed(tree.items()))))
    assert not any(run for run, _ in plans(frame).values())


@pytest.mark.parametrize("without", ["digest", "files"])
def test_a_result_that_lost_what_vouches_for_it_is_identified_again(frame: Folder, without: str) -> None:
    before = frame.result("loose-2")

    def edit(tree: dict[str, Any]) -> None:
        del (tree if without == "digest" else tree["provenance"])[without]
        tree.update(bolts=[bolt | {"verdict": "tight"} for bolt in tree["bolts"]])

    change(frame.out / "loose-2" / "result.json", edit)
    assert frame.run("report", "--job", "loose-2").code == (3 if without == "digest" else 0)
    outcome = frame.run("update", "--json", "--fail-on-loose")
    assert (outcome.code, outcome.json["judged"], outcome.json["kept"]) == (6, [], ["tight"])
    assert frame.result("loose-2")["bolts"] == before["bolts"]


def test_a_confirmed_reference_changes_no_result(frame: Folder) -> None:
    tree = frame.tree()
    frame.write(tree | {"update": tree["update"] | {"reference_guessed": True}})
    outcome = frame.run("update", "--json")
    assert outcome.json["kept"] == ["tight", "loose-2"]
    assert "was guessed from names" in outcome.stderr
    assert json.loads((frame.out / "campaign.json").read_text(encoding="utf-8"))["reference_guessed"]
    frame.write(tree)
    outcome = frame.run("update", "--json")
    assert outcome.json["kept"] == ["tight", "loose-2"]
    assert "was guessed from names" not in outcome.stderr
    assert not json.loads((frame.out / "campaign.json").read_text(encoding="utf-8"))["reference_guessed"]


def test_the_result_of_another_job(frame: Folder) -> None:
    change(frame.out / "loose-2" / "result.json", lambda tree: tree.update(job="loose-all"))
    assert plans(frame)["loose-2"] == (True, "the earlier result is unusable (this result belongs to job loose-all)")


def test_results_of_other_libraries_are_told(tmp_path: Path) -> None:
    """Kept, since new versions of libraries hardly change them; not without a word."""
    folder = two_jobs(tmp_path)
    assert folder.run("update").code == 0
    assert "note:" not in folder.run("update").stderr
    path = folder.out / "loose-2" / "result.json"
    tree = json.loads(path.read_text())
    tree["provenance"]["versions"]["numpy"] = "1.0"
    path.write_text(json.dumps(tree | {"digest": digest_of(tree)}))
    told = folder.run("update").stderr
    assert "note: loose-2: kept, but Python or its libraries changed since; --force identifies again" in told
