"""No command writes to a file that is an input, nor to one that exists unless it is told to."""

from __future__ import annotations

from fnmatch import fnmatch
from pathlib import Path

import h5py
import pytest
from campaigns import Folder, chain_folder

from lrbc_cli.campaign import protect
from lrbc_cli.campaign.protect import IN_CALIBRATION, IN_JOB, IN_OUTPUT, input_files, same_file
from lrbc_cli.config import load_campaign

COMMANDS = [("check",), ("update",), ("update", "--dry-run"), ("report",), ("reduce",), ("plan",), ("simulate", "--out", "new.csv")]


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    folder = chain_folder(tmp_path_factory.mktemp("measured") / "chain")
    assert folder.run("simulate", "--lines", "20:500:10", "--out", folder.data / "one.csv").code == 0
    return folder


@pytest.fixture
def chain(measured: Folder, tmp_path: Path) -> Folder:
    """The chain with a measurement of its own model."""
    return measured.copy(tmp_path / "chain")


def run(folder: Folder, command: tuple[str, ...]) -> str:
    """What a command says, which must refuse with 2 and change nothing."""
    before = {path: path.read_bytes() for path in folder.path.rglob("*") if path.is_file()}
    result = folder.run(command[0], *(folder.path / arg if arg == "new.csv" else arg for arg in command[1:]))
    assert result.code == 2, result.stderr
    assert {path: path.read_bytes() for path in folder.path.rglob("*") if path.is_file()} == before
    return result.stderr


def place(folder: Folder, file: str, *keys: str) -> Path:
    """Move an input to a place below the campaign's folder, and say so in the file."""
    tree = folder.tree()
    part = tree
    for key in keys[:-1]:
        part = part[key]
    target = folder.path / file
    target.parent.mkdir(parents=True, exist_ok=True)
    (folder.path / part[keys[-1]]).rename(target)
    part[keys[-1]] = file
    folder.write(tree)
    return target


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_measurement_where_its_result_goes(chain: Folder, command: tuple[str, ...]) -> None:
    place(chain, "out/one/frf.csv", "jobs", "one", "frf")
    said = run(chain, command)
    for part in ("jobs.one.frf", "the results would replace this input", "out/one/frf.csv", "fix:"):
        assert part in said


@pytest.mark.parametrize(
    ("file", "keys"),
    [
        ("out/campaign.csv", ("bolts",)),
        ("out/one/profile.csv", ("bolts",)),
        ("out/calibration/frf.csv", ("jobs", "one", "frf")),
        ("out/plan.csv", ("parameters", "springs", "select", "dofs")),
        ("out/one/frf-a.png", ("model", "mass")),
        ("out/one/fdac.csv", ("jobs", "one", "coherence")),
    ],
)
def test_every_input_and_every_result(chain: Folder, file: str, keys: tuple[str, ...]) -> None:
    tree = chain.tree()
    tree["bolts"] = "data/bolts.csv"
    (chain.data / "bolts.csv").write_text("name,x,y,z\nB1,0,0,0\n")
    (chain.data / "coherence.csv").write_text("frequency_hz,a_coherence\n20,1\n30,1\n")
    tree["jobs"]["one"]["coherence"] = "data/coherence.csv"
    chain.write(tree)
    place(chain, file, *keys)
    assert ".".join(keys) in run(chain, ("check",))


def test_repeats_links_and_the_campaign_file(chain: Folder) -> None:
    result = chain.out / "one" / "frf.csv"
    result.parent.mkdir(parents=True)
    (chain.data / "one.csv").rename(result)
    (chain.data / "one.csv").symlink_to(result)
    assert "jobs.one.frf" in run(chain, ("update",))
    tree = chain.tree()
    result.rename(chain.data / "two.csv")
    (chain.data / "one.csv").unlink()
    # The folder of the job is the folder of the data.
    result.parent.rmdir()
    result.parent.symlink_to(chain.data)
    (chain.data / "two.csv").rename(chain.data / "frf.csv")
    tree["jobs"]["one"] = {"frf": "data/else.csv", "repeats": ["data/frf.csv"]}
    chain.write(tree)
    assert "jobs.one.repeats" in run(chain, ("update",))
    result.parent.unlink()
    chain.write(tree | {"output": "."})
    (chain.path / "report.html").write_text(chain.config.read_text())
    moved = Folder(chain.path)
    before = (chain.path / "report.html").read_bytes()
    from campaigns import lrbc

    refused = lrbc("report", moved.path / "report.html")
    assert refused.code == 2
    assert "the results would replace this input" in refused.stderr
    assert (chain.path / "report.html").read_bytes() == before


def test_names_beside_the_results_are_free(chain: Folder) -> None:
    """Data may lie in the output folder: only what is written is taken."""
    place(chain, "out/one/measured.csv", "jobs", "one", "frf")
    place(chain, "out/terms.csv", "parameters", "springs", "select", "dofs")
    assert chain.run("check").code == 0


def test_case_counts_as_the_file_system_has_it(chain: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    place(chain, "OUT/One/FRF.csv", "jobs", "one", "frf")
    assert chain.run("check").code == 0
    monkeypatch.setattr(protect, "folds_case", lambda folder: True)
    assert "jobs.one.frf" in run(chain, ("check",))
    assert not same_file(chain.data / "K.mtx", chain.data / "M.mtx")


def test_the_file_system_is_asked(tmp_path: Path) -> None:
    (tmp_path / "Name").mkdir()
    assert protect.folds_case(tmp_path / "Name") == (tmp_path / "nAME").exists()


@pytest.mark.slow
def test_all_results_are_known(frame: Folder) -> None:
    """What commands leave in the output folder is what the guard knows of."""
    assert frame.run("calibrate").code == 0
    assert frame.run("plan", "--draws", "0").code == 0
    assert frame.run("report", "--job", "loose-2", "--figures", "svg, pdf,svg").code == 0
    assert {path.suffix for path in frame.out.rglob("profile.*")} == {".csv", ".png", ".pdf", ".svg"}
    refused = frame.run("report", "--figures", "pdf,tiff")
    assert refused.code == 2
    assert "tiff: give pdf or svg" in refused.stderr
    (frame.data / "frf" / "loose-2.csv").write_bytes(b"")
    assert frame.run("update").code == 5
    for path in (path for path in frame.out.rglob("*") if path.is_file()):
        folder = path.parent.relative_to(frame.out).as_posix()
        names = {".": IN_OUTPUT, "calibration": IN_CALIBRATION}.get(folder, IN_JOB)
        assert any(fnmatch(path.name, name) for name in names), path


def test_every_path_of_a_campaign_is_an_input(frame: Folder) -> None:
    tree = frame.tree()
    tree["jobs"]["tight"] |= {"coherence": "a.csv", "repeats": ["b.csv", "c.csv"]}
    tree["calibration"]["groups"] = {"part": {"stiffness": "d.h5#K"}}
    tree["excitation"]["hammer"] = {"vector": "e.mtx"}
    frame.write(tree)
    campaign = load_campaign(frame.config, ())
    found = {path.name: ".".join(map(str, keys)) for path, keys in input_files(campaign)}
    assert found["campaign.yaml"] == ""
    assert found["c.csv"] == "jobs.tight.repeats.1"
    assert found["d.h5"] == "calibration.groups.part.stiffness.file"
    assert found["e.mtx"] == "excitation.hammer.vector.file"
    assert {"stiffness.mtx", "mass.mtx.gz", "damping.mtx.gz", "dofs.csv", "bolts.csv", "edge.mtx", "edge.csv", "sensors.mtx"} <= set(found)
    assert {"tight.csv", "loose-2.csv", "loose-all.csv", "a.csv", "b.csv"} <= set(found)
    assert "out" not in found


@pytest.mark.parametrize("name", ["one.csv", "link.csv", "terms.csv"])
@pytest.mark.parametrize("force", [(), ("--force",)])
def test_simulate_spares_inputs(chain: Folder, name: str, force: tuple[str, ...]) -> None:
    (chain.data / "link.csv").symlink_to(chain.data / "one.csv")
    said = run(chain, ("simulate", *force, "--out", str(chain.data / name)))
    for part in ("--out", "this is an input of the campaign", "jobs.one.frf" if name != "terms.csv" else "parameters.springs.select.dofs"):
        assert part in said


def test_simulate_asks_before_it_replaces(chain: Folder) -> None:
    out = chain.path / "mine.csv"
    out.write_text("mine")
    said = run(chain, ("simulate", "--out", str(out)))
    for part in ("--out", "this file already exists", "--force replaces it"):
        assert part in said
    assert chain.run("simulate", "--out", out, "--force").code == 0
    assert out.read_text().startswith("frequency_hz")


@pytest.mark.parametrize("ending", ["h5", "mat"])
def test_exports_replace_exports_only(chain: Folder, ending: str) -> None:
    out = chain.path / f"model.{ending}"
    for _ in range(2):
        assert chain.run("reduce", "--export", out).code == 0
    out.write_bytes(b"mine")
    for args in ((), ("--force",), ("--dry-run",)):
        said = run(chain, ("reduce", "--export", str(out), *args))
        for part in ("--export", "this file already exists", "--overwrite replaces it"):
            assert part in said
    with h5py.File(chain.path / "other.h5", "w") as file:
        file["K"] = [1.0]
    run(chain, ("reduce", "--export", str(chain.path / "other.h5")))
    assert chain.run("reduce", "--export", out, "--overwrite").code == 0
    assert out.read_bytes() != b"mine"


def test_exports_spare_measurements(chain: Folder) -> None:
    tree = chain.tree()
    (chain.data / "one.csv").rename(chain.data / "one.mat")
    tree["jobs"]["one"]["frf"] = "data/one.mat"
    chain.write(tree)
    said = run(chain, ("reduce", "--export", str(chain.data / "one.mat"), "--overwrite"))
    assert "this is an input of the campaign" in said
    assert "jobs.one.frf" in said
