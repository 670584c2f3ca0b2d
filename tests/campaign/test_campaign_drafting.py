"""``lrbc init --from``: what the files of a folder are, which roles they play, and a campaign file that holds."""

from __future__ import annotations

import gzip
import re
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import yaml
from campaigns import ROOT, Folder, Result, box, lrbc
from systems import chain, csc

from lrbc_cli import load
from lrbc_cli.campaign.drafting.channels import measured_band
from lrbc_cli.campaign.drafting.draft import Draft, draft, quoted
from lrbc_cli.campaign.drafting.recognise import recognise
from lrbc_cli.campaign.drafting.roles import edge_near, tight_states
from lrbc_cli.campaign.jobs.identity import identification
from lrbc_cli.campaign.reduced.cache import key_parts
from lrbc_cli.config import load_campaign
from lrbc_cli.config.document import parse
from lrbc_cli.config.fields import plain_name
from lrbc_cli.io.layout import TextLayout
from lrbc_cli.io.matrices.read import read_matrix
from lrbc_cli.io.uff.read import read_uff
from lrbc_cli.io.uff.write import write_uff
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.frf import FrfRecord


def drafted(files: Path, folder: Path) -> tuple[Folder, Result]:
    result = lrbc("init", "--from", files, folder)
    assert result.code == 0, result.stderr
    return Folder(folder), result


def test_universal_files_and_a_list_of_dofs(tmp_path: Path) -> None:
    """Hammer and responses are those of the FRF files' nodes, which are the model's."""
    files = box(tmp_path / "box").data
    (files / "springs.csv").write_text("dof,bolt\n" + "".join(f"{i},B{i + 1}\n" for i in range(6)))
    (files / "note.txt").write_text("measured on a Monday\n")
    folder, told = drafted(files, tmp_path / "new")
    campaign = load_campaign(folder.config)
    hammer, mic = campaign.excitation["hammer"], campaign.responses["mic2"]
    assert (hammer.node, hammer.component) == (8, "UZ")
    assert (mic.node, mic.component, mic.quantity) == (112, "PRES", "pressure")
    assert list(campaign.responses) == ["mic1", "mic2", "mic3", "acc1"]
    assert campaign.update.responses == ("mic1", "mic2", "mic3")
    assert campaign.update.reference == "tight"
    assert list(campaign.jobs) == ["tight", "loose"]
    assert campaign.model.stiffness.path == files / "K.mtx"
    assert campaign.parameters["springs"].select.dofs == files / "springs.csv"
    assert campaign.bolts == files / "bolts.csv"
    assert campaign.calibration is not None
    assert "mass.acoustic" in campaign.calibration.factors
    assert "note.txt was not read" in told.stdout
    assert "note.txt was not read" in folder.config.read_text()
    checked = folder.run("check")
    assert checked.code == 0, checked.stderr
    # Until somebody confirms it.
    guessed = "update.reference: tight was guessed from names by `lrbc init --from`"
    assert checked.stdout.count(guessed) == 1
    folder.replace("  reference_guessed: true             # remove this line once all bolts are known to be tight there\n", "")
    assert guessed not in folder.run("check").stdout
    assert folder.config.read_text().startswith("# yaml-language-server: $schema=campaign.schema.json\n")
    assert (folder.path / "campaign.schema.json").is_file()


def rewritten(files: Path, change: Callable[[tuple[FrfRecord, ...]], Iterable[FrfRecord]]) -> None:
    """The measurements with other records."""
    for path in files.glob("*.uff"):
        frf = read_uff(path, TextLayout())
        write_uff(path, replace(frf, records=tuple(change(frf.records))))


def struck_twice(files: Path, *, known: bool) -> None:
    """The measurements of the box with a second hammer point, at node 6 or at a node that the model lacks; and a list of terms."""
    (files / "springs.csv").write_text("dof,bolt\n" + "".join(f"{i},B{i + 1}\n" for i in range(6)))
    node = 6 if known else 9999
    rewritten(files, lambda own: (*own, *(replace(record, reference_node=node, values=2.0 * record.values) for record in own)))


def test_several_hammer_points_by_their_nodes(tmp_path: Path) -> None:
    files = box(tmp_path / "box").data
    struck_twice(files, known=True)
    folder, told = drafted(files, tmp_path / "new")
    campaign = load_campaign(folder.config)
    assert [(name, at.node, at.component) for name, at in campaign.excitation.items()] == [("h1", 8, "UZ"), ("h2", 6, "UZ")]
    assert "2 hammer points: h1, h2" in told.stdout
    assert list(campaign.responses) == [f"{name}-h{k}" for k in (1, 2) for name in ("mic1", "mic2", "mic3", "acc1")]
    assert {response.excitation for response in campaign.responses.values()} == {"h1", "h2"}
    assert campaign.update.responses == tuple(f"{name}-h{k}" for k in (1, 2) for name in ("mic1", "mic2", "mic3"))
    assert "acc1-h1, acc1-h2 are left out as validation channels" in told.stdout
    study = load(folder.config)
    measured = dict(zip(study.responses, study.read("tight").values.T, strict=True))
    np.testing.assert_allclose(measured["mic1-h2"], 2.0 * measured["mic1-h1"], rtol=1e-5)


@pytest.mark.parametrize("names", [("H1", "H2"), ("H:1", "H:2"), ("P1 +Z", "P1 -Z"), ("Stoß 1", "Stoß 2")])
@pytest.mark.parametrize("numbered", [True, False], ids=["nodes of the analyser", "no nodes"])
def test_several_hammer_points_by_their_names_in_the_table_of_points(numbered: bool, names: tuple[str, str], tmp_path: Path) -> None:
    """The numbers in the files are channels, not nodes of the model, but the table has the names of sensors and hammer points."""
    files = box(tmp_path / "box").data
    struck_twice(files, known=True)
    lines = [line.split(",") for line in (files / "dofs.csv").read_text().splitlines()[1:]]
    table = {int(node): tuple(map(float, place)) for _, node, _, *place in lines}
    rows_of = ("H 1", "h2") if names[0] == "H1" else names
    nodes = {"mic1": 103, "mic2": 112, "mic3": 124, "acc1": 7, rows_of[0]: 8, rows_of[1]: 6}
    kinds = {name: "PRES" if name.startswith("mic") else "UZ" for name in nodes}
    rows = [f"{name},{','.join(map(repr, table[node]))},{kinds[name]}" for name, node in nodes.items()]
    (files / "points.csv").write_text("\n".join(["name,x,y,z,component", *rows]) + "\n")

    def renumbered(own: tuple[FrfRecord, ...]) -> Iterable[FrfRecord]:
        for k, record in enumerate(own):
            hammer = {8: names[0], 6: names[1]}[record.reference_node or 0]
            at = (201 + k % 4, 900 + (record.reference_node or 0)) if numbered else (None, None)
            yield replace(record, response_node=at[0], reference_node=at[1], reference_name=hammer)

    rewritten(files, renumbered)
    folder, told = drafted(files, tmp_path / "new")
    campaign = load_campaign(folder.config)
    one, two = map(plain_name, names)
    assert f"2 hammer points: {one}, {two}" in told.stdout
    near = {name: at.near for name, at in campaign.excitation.items()}
    assert near == {one: pytest.approx(table[8]), two: pytest.approx(table[6])}
    assert list(campaign.responses) == [f"{name}-{hammer}" for hammer in (one, two) for name in ("mic1", "mic2", "mic3", "acc1")]
    assert "to do: its place" not in folder.config.read_text()
    study = load(folder.config)
    measured = dict(zip(study.responses, study.read("tight").values.T, strict=True))
    np.testing.assert_allclose(measured[f"mic1-{two}"], 2.0 * measured[f"mic1-{one}"], rtol=1e-5)
    np.testing.assert_allclose(measured[f"acc1-{two}"], 2.0 * measured[f"acc1-{one}"], rtol=1e-5)


def test_exchanged_names_of_hammer_points_are_another_measurement(tmp_path: Path) -> None:
    """Records are told apart by these names, so that results with the names before are out of date."""
    files = box(tmp_path / "box").data
    struck_twice(files, known=True)
    hammers = {8: "H1", 6: "H2"}
    rewritten(files, lambda own: (replace(r, reference_name=hammers[r.reference_node or 0], reference_node=None) for r in own))
    (files / "points.csv").write_text("name,x,y,z,component\nH1,2.1,0,0,UZ\nH2,1.5,0,0,UZ\n")
    folder, _ = drafted(files, tmp_path / "new")
    inputs = folder.inputs()
    before, first = identification(inputs, key_parts(inputs), "tight"), load(folder.config).read("tight").values
    text = folder.config.read_text()
    for one, other in (("H1: {near", "HX: {near"), ("H2: {near", "H1: {near"), ("HX: {near", "H2: {near")):
        text = text.replace(one, other)
    for one, other in (("excitation: H1", "excitation: HX"), ("excitation: H2", "excitation: H1"), ("excitation: HX", "excitation: H2")):
        text = text.replace(one, other)
    folder.config.write_text(text)
    inputs = folder.inputs()
    assert not np.allclose(load(folder.config).read("tight").values, first, rtol=1e-3)
    assert identification(inputs, key_parts(inputs), "tight").digest != before.digest


def test_one_name_of_all_blows_is_no_name_of_a_hammer_point(tmp_path: Path) -> None:
    """Analysers write ``Hammer`` as the reference of every record; the nodes tell the points apart."""
    files = box(tmp_path / "box").data
    struck_twice(files, known=True)
    (files / "points.csv").write_text("name,x,y,z,component\nhammer,2.1,0,0,UZ\n")
    rewritten(files, lambda own: (replace(record, reference_name="Hammer") for record in own))
    folder, told = drafted(files, tmp_path / "new")
    assert "2 hammer points: h1, h2" in told.stdout
    assert [at.node for at in load_campaign(folder.config).excitation.values()] == [8, 6]


@pytest.mark.parametrize("pattern", ["{state}/H{k}.uff", "{state}_H{k}.uff", "H{k}-{state}.uff"])
def test_files_of_one_hammer_point_each_are_a_job_together(pattern: str, tmp_path: Path) -> None:
    """Three sensors, four points of a roving hammer; one point is missing in one state."""
    files = box(tmp_path / "box").data
    struck_twice(files, known=True)
    for path in list(files.rglob("*.uff")):
        frf, state = read_uff(path, TextLayout()), path.stem
        path.unlink()
        for k, node in enumerate((8, 6, 5, 7), start=1):
            own = tuple(replace(record, reference_node=node, values=k * record.values) for record in frf.records[:3])
            to = path.parent / pattern.format(state=state, k=k)
            if (state, k) != ("loose", 3):
                to.parent.mkdir(exist_ok=True)
                write_uff(to, replace(frf, records=own))
    folder, told = drafted(files, tmp_path / "new")
    campaign = load_campaign(folder.config)
    assert {name: len(job.all_files) for name, job in campaign.jobs.items()} == {"tight": 4, "loose": 3}
    assert [at.node for at in campaign.excitation.values()] == [8, 6, 5, 7]
    assert campaign.update.reference == "tight"
    # No sensor can be spared, but a hammer point.
    assert campaign.update.responses == tuple(f"mic{i}-h{k}" for k in (1, 2, 3) for i in (1, 2, 3))
    assert "mic1-h4, mic2-h4, mic3-h4 are left out as validation channels" in told.stdout
    assert re.search(r"jobs: files such as \S+, \S+ are taken as one state", told.stdout)
    study = load(folder.config)
    measured = dict(zip(study.responses, study.read("tight").values.T, strict=True))
    np.testing.assert_allclose(measured["mic1-h4"], 4.0 * measured["mic1-h1"], rtol=1e-5)
    assert study.read("loose").values.shape[1] == 12


@pytest.mark.parametrize("names", [("loose", "tight"), ("box_tight", "box_loose"), ("loose_b4", "loose_b5"), ("B4", "B5")])
def test_states_of_one_folder_that_name_different_hammer_points_stay_jobs(names: tuple[str, str], tmp_path: Path) -> None:
    files = box(tmp_path / "box").data
    for path, node, name in zip(sorted(files.rglob("*.uff")), (8, 6), names, strict=True):
        frf = read_uff(path, TextLayout())
        path.unlink()
        write_uff(path.with_stem(name), replace(frf, records=tuple(replace(record, reference_node=node) for record in frf.records)))
    made = draft(tmp_path / "new", recognise(files))
    assert set(yaml.safe_load(made.text())["jobs"]) == set(names)


def test_a_hammer_point_that_the_model_lacks_leaves_its_records_out(tmp_path: Path) -> None:
    files = box(tmp_path / "box").data
    struck_twice(files, known=False)
    folder, told = drafted(files, tmp_path / "new")
    assert list(load_campaign(folder.config).responses) == ["mic1", "mic2", "mic3", "acc1"]
    assert "the files contain 2 hammer points; only the first is used, give the others" in told.stdout


def test_records_without_names_keep_their_numbers_in_the_file(tmp_path: Path) -> None:
    """Records 1, 3, 5 ... are those of the first hammer point, and were numbered 1, 2, 3 ... where only that one is used."""
    files = box(tmp_path / "box").data
    struck_twice(files, known=False)
    rewritten(files, lambda own: (replace(own[k], name="", response_node=None) for k in np.arange(8).reshape(2, 4).T.ravel()))
    folder, told = drafted(files, tmp_path / "new")
    assert re.findall(r"record: (\d+)", folder.config.read_text()) == ["1", "3", "5", "7"]
    assert "only the first is used" in told.stdout


def test_a_record_that_is_there_twice_is_addressed_by_its_number(tmp_path: Path) -> None:
    files = box(tmp_path / "box").data
    struck_twice(files, known=True)
    rewritten(files, lambda own: (*own, own[0]))
    folder, _ = drafted(files, tmp_path / "new")
    campaign = load_campaign(folder.config)
    assert list(campaign.responses)[-1] == "mic1-h1-9"
    # The last sensor is that of the copy, too.
    assert campaign.update.responses == tuple(f"{name}-h{k}" for k in (1, 2) for name in ("mic2", "mic3", "acc1"))
    study = load(folder.config)
    measured = dict(zip(study.responses, study.read("tight").values.T, strict=True))
    np.testing.assert_allclose(measured["mic1-h1-9"], measured["mic1-h1"], rtol=1e-12)


def test_a_model_of_calculix_in_millimetres(tmp_path: Path) -> None:
    """All that the sample's own campaign file says of its files is found, but the damping."""
    made = draft(tmp_path / "new", recognise(ROOT / "data_samples" / "plate"))
    tree, own = yaml.safe_load(made.text()), load_campaign(ROOT / "configs" / "plate.yaml")
    assert (tree["units"], tree["update"]["reference"], tree["update"]["baselines"]) == ("mm-N-t", "tight-1", ["tight-2"])
    assert set(tree["jobs"]) == set(own.jobs)
    assert {Path(tree["model"][role]).name for role in ("stiffness", "mass")} == {"plate.sti.gz", "plate.mas.gz"}
    assert tree["model"]["stiffness"].endswith("sti.gz")
    assert {key: Path(value).name for key, value in tree["model"]["dofs"].items()} == {"map": "plate.dof", "nodes": "plate.inp"}
    (springs,) = tree["parameters"].values()
    assert springs["baseline"] == 1.0
    assert made.table is not None
    for name, point in {**own.responses, **own.excitation}.items():
        found = (tree["responses"] | tree["excitation"])[name]
        at = (made.table.node == found["node"]) & (made.table.component == found["component"])
        np.testing.assert_allclose(made.table.xyz[at], [point.near], atol=1e-2)


@pytest.mark.parametrize("pattern", ["{state}_{channel}.csv", "{state}/{channel}.csv"])
def test_files_of_one_channel_each_are_a_job_together(tmp_path: Path, pattern: str) -> None:
    for state in ("tight", "loose"):
        for channel in ("acc1", "acc2"):
            file = tmp_path / pattern.format(state=state, channel=channel)
            file.parent.mkdir(exist_ok=True)
            file.write_text(f"frequency_hz,{channel}_real,{channel}_imag\n" + "".join(f"{f},1.5,0.5\n" for f in range(20, 90)))
    made = draft(tmp_path / "new", recognise(tmp_path))
    tree = yaml.safe_load(made.text())
    expected = {
        state: [f"../{pattern.format(state=state, channel=channel)}" for channel in ("acc1", "acc2")] for state in ("tight", "loose")
    }
    assert {name: job["frf"] for name, job in tree["jobs"].items()} == expected
    assert list(tree["responses"]) == ["acc1", "acc2"]
    assert tree["update"]["reference"] == "tight"
    assert tree["reduction"]["band"] == [20, 89]


def test_a_band_ends_where_the_coherence_does() -> None:
    axis = np.arange(0.0, 501.0)

    def records(coherence: np.ndarray | None, count: int = 3) -> list[FrfRecord]:
        return [FrfRecord(name="", frequency_hz=axis, values=np.ones(axis.size, dtype=complex), coherence=coherence) for _ in range(count)]

    good = np.where((axis < 30) | (axis > 400) | (axis % 20 == 0), 0.3, 0.98)
    band, why = measured_band(records(good))
    assert band == (30.0, 399.0)
    assert why == "30 to 399 Hz, where the coherence is mostly 0.75 or more; the lines reach from 1 to 500 Hz"
    # Two of three records decide.
    assert measured_band([*records(good, 2), *records(np.ones(axis.size), 1)])[0] == band
    assert measured_band(records(None)) == measured_band(records(np.ones(axis.size))) == ((1.0, 500.0), "")
    assert measured_band(records(np.zeros(axis.size))) == ((1.0, 500.0), "")
    assert measured_band([]) == ((20.0, 400.0), "")


STATES, SENSORS = ("fest", "lose-2"), ("acc1", "acc2", "acc3")


def unnamed(folder: Path, names: list[str], sensors: str = "") -> Draft:
    """Draft for files of one FRF each, without its name; `sensors`: names in a table of points."""
    for k, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        rows = "".join(f"{f},{1.5 + k},0.5\n" for f in range(20, 90))
        (folder / name).write_text("Frequenz,Realteil,Imaginärteil\n" + rows, encoding="utf-8")
    if sensors:
        rows = "".join(f"{name},{0.1 * k},0,0,UZ\n" for k, name in enumerate(["hammer", *sensors.split()]))
        (folder / "points.csv").write_text("name,x,y,z,component\n" + rows)
    return draft(folder / "new", recognise(folder))


def named_in(made: Draft) -> dict[str, dict[str, str]]:
    """File of each response, for each job: by its name, or as its records say."""
    tree = yaml.safe_load(made.text())
    found = {}
    for name, job in tree["jobs"].items():
        files = [job["frf"]] if isinstance(job["frf"], str) else job["frf"]
        records = {key: record["file"] for key, record in job.get("records", {}).items()}
        assert set(records.values()) <= set(files)
        by_stem = {Path(file).stem: file for file in files if file not in records.values()}
        found[name] = {key: file.removeprefix("../") for key, file in {**by_stem, **records}.items()}
    return found


@pytest.mark.parametrize(
    ("pattern", "sensors"),
    [
        ("{state}/{sensor}.txt", SENSORS),
        ("{state}/{sensor}.txt", ("links", "rechts")),
        ("{sensor}/{state}.txt", SENSORS),
        ("{state}_{sensor}.txt", SENSORS),
        ("{sensor}-{state}.txt", SENSORS),
        ("day/{state} {sensor}.txt", SENSORS),
    ],
)
def test_frfs_without_a_name_are_named_after_their_files(tmp_path: Path, pattern: str, sensors: tuple[str, ...]) -> None:
    """Every file was a job of its own, with one response r1, and the run refused the campaign file."""
    made = unnamed(tmp_path, [pattern.format(state=state, sensor=sensor) for state in STATES for sensor in sensors])
    expected = {state: {sensor: pattern.format(state=state, sensor=sensor) for sensor in sensors} for state in STATES}
    assert named_in(made) == expected
    tree = yaml.safe_load(made.text())
    assert list(tree["responses"]) == list(sensors)
    assert tree["update"]["reference"] == "fest"
    assert any(f"{2 * len(sensors)} FRFs have no name in their files" in item for item in made.todo)


@pytest.mark.parametrize("pattern", ["{state}/{sensor}.txt", "{sensor}/{state}.txt", "{state}_{sensor}.txt", "{sensor}_{state}.txt"])
def test_names_of_the_table_of_points_tell_files_of_sensors(tmp_path: Path, pattern: str) -> None:
    """Also where a file of one state is missing in folders, or one state was measured."""
    names = [pattern.format(state=state, sensor=sensor) for state in ("day1", "day2") for sensor in ("left", "right")]
    made = unnamed(tmp_path, names, "Left right")
    assert {name: set(of) for name, of in named_in(made).items()} == {"day1": {"left", "right"}, "day2": {"left", "right"}}
    assert "near: [0.1, 0, 0]" in made.text()


def test_sensors_of_one_state_are_one_job(tmp_path: Path) -> None:
    assert named_in(unnamed(tmp_path, ["fest/acc1.txt", "fest/acc2.txt"])) == {"fest": {"acc1": "fest/acc1.txt", "acc2": "fest/acc2.txt"}}


@pytest.mark.parametrize(
    "names",
    [
        ["tight.txt", "loose.txt"],
        ["day1/tight.txt", "day1/loose.txt", "day2/tight.txt", "day2/loose.txt"],
        ["tight-1.txt", "tight-2.txt", "loose-1.txt", "loose-2.txt"],
        ["b1-loose.txt", "b1-half.txt", "b2-loose.txt", "b2-half.txt"],
        ["fest_acc1.txt", "fest_acc2.txt", "lose_acc1.txt"],
    ],
)
def test_files_of_states_are_not_taken_for_sensors(tmp_path: Path, names: list[str]) -> None:
    tree = yaml.safe_load(unnamed(tmp_path, names).text())
    assert sorted(job["frf"] for job in tree["jobs"].values()) == sorted(f"../{name}" for name in names)
    assert list(tree["responses"]) == ["r1"]


def test_folders_of_the_same_name_are_states_of_their_own(tmp_path: Path) -> None:
    names = [f"{day}/run/acc{k}.txt" for day in ("mon", "tue") for k in (1, 2)]
    assert named_in(unnamed(tmp_path, names)) == {
        f"{day}-run": {f"acc{k}": f"{day}/run/acc{k}.txt" for k in (1, 2)} for day in ("mon", "tue")
    }


def test_coherences_belong_to_the_files_of_their_own_folder(tmp_path: Path) -> None:
    for state in STATES:
        (tmp_path / state).mkdir()
        (tmp_path / state / "acc1_coh.csv").write_text("frequency_hz,coherence\n" + "".join(f"{f},0.99\n" for f in range(20, 90)))
    made = unnamed(tmp_path, [f"{state}/acc1.txt" for state in STATES])
    jobs = yaml.safe_load(made.text())["jobs"]
    assert {name: job["coherence"] for name, job in jobs.items()} == {state: f"../{state}/acc1_coh.csv" for state in STATES}


def test_points_are_found_by_names_that_are_alike(tmp_path: Path) -> None:
    rows = "".join(f"{f},1.5,0.5\n" for f in range(20, 90))
    (tmp_path / "tight.csv").write_text("frequency_hz,H1(Acc 1/hammer) real,H1(Acc 1/hammer) imag\n" + rows)
    (tmp_path / "points.csv").write_text("name,x,y,z,component\nhammer,0,0,0,UZ\nacc1,0.1,0,0,UX\n")
    tree = yaml.safe_load(draft(tmp_path / "new", recognise(tmp_path)).text())
    expected = {"near": [0.1, 0, 0], "component": "UX", "record": "H1(Acc 1/hammer)", "quantity": "acceleration"}
    assert tree["responses"] == {"Acc-1": expected}


def test_no_measurement_is_dropped_whose_name_is_taken(tmp_path: Path) -> None:
    rows = "".join(f"{f},1.5,0.5\n" for f in range(20, 90))
    names = ["a/state 1.csv", "a/state-1.csv", "b/state_1.csv", "b/state-1.csv", "tight.csv", "tight-2.csv"]
    for k, name in enumerate(names):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("frequency_hz,acc1_real,acc1_imag\n" + rows.replace("1.5", str(k + 0.25)))
    (tmp_path / "tight-2 coherence.csv").write_text("frequency_hz,acc1\n" + "".join(f"{f},0.99\n" for f in range(20, 90)))
    jobs = yaml.safe_load(draft(tmp_path / "new", recognise(tmp_path)).text())["jobs"]
    assert sorted(job["frf"] for job in jobs.values()) == sorted(f"../{name}" for name in names)
    assert len({name.lower() for name in jobs}) == len(names)
    assert {name: job["coherence"] for name, job in jobs.items() if "coherence" in job} == {"tight-2": "../tight-2 coherence.csv"}


def test_archives_of_numpy(tmp_path: Path) -> None:
    """Matrices, FRFs and coherences of one kind of file; of a file with a wrong value no part is taken for a matrix."""
    K, M = chain(12)
    frequency = np.arange(20.0, 90.0)
    H, coherence = np.full((frequency.size, 2), 1.5 + 0.5j), np.full((frequency.size, 2), 0.99)
    axis = {"freq": frequency, "names": ["acc1", "acc2"], "unit": "m/s^2/N"}
    np.savez(tmp_path / "model.npz", K=K.toarray(), M=M.toarray())
    np.savez(tmp_path / "tight.npz", **axis, H=H)
    np.savez_compressed(tmp_path / "loose.npz", **axis, H=2 * H, coherence=coherence)
    np.savez(tmp_path / "tight coherence.npz", **axis, coherence=coherence)
    np.savez(tmp_path / "bad.npz", **axis, H=np.where(frequency[:, None] > 50, np.nan, H))
    found = recognise(tmp_path)
    assert [(one.path.name, one.group) for one in found.matrices] == [("model.npz", "K"), ("model.npz", "M")]
    assert [(path.name, why.partition(";")[0]) for path, why in found.rest.items()] == [
        ("bad.npz", "the FRF contains a value that is not a finite number")
    ]
    tree = yaml.safe_load(draft(tmp_path / "new", found).text())
    assert tree["jobs"]["tight"] == {"frf": "../tight.npz", "coherence": "../tight coherence.npz"}
    assert tree["jobs"]["loose"]["frf"] == "../loose.npz"
    assert tree["model"]["stiffness"] == {"file": "../model.npz", "group": "K"}
    assert list(tree["responses"]) == ["acc1", "acc2"]


def test_one_matrix_in_two_formats_is_no_stiffness_and_mass(tmp_path: Path) -> None:
    K = csc(chain(12)[0])
    scipy.io.mmwrite(tmp_path / "a.mtx", K)
    scipy.io.savemat(tmp_path / "b.mat", {"x": K * (1 + 1e-9)})
    roles = draft(tmp_path / "new", recognise(tmp_path)).roles
    assert list(roles.operators) == ["stiffness"]
    assert any("contains the same matrix as" in text for text in roles.doubts)


@pytest.mark.parametrize(("file", "names"), [("dmig.pch", ["KAAX", "MAAX"]), ("se_test_n11.op4.gz", ["KAA", "MAA"])])
def test_matrices_by_the_names_that_nastran_gives_them(file: str, names: list[str], tmp_path: Path) -> None:
    content = (ROOT / "tests" / "data" / "nastran" / file).read_bytes()
    (tmp_path / file.removesuffix(".gz")).write_bytes(gzip.decompress(content) if file.endswith(".gz") else content)
    roles = draft(tmp_path / "new", recognise(tmp_path)).roles
    assert [roles.operators[role].group for role in ("stiffness", "mass")] == names


def test_a_matrix_of_another_model_is_named(tmp_path: Path) -> None:
    K, M = (csc(matrix) for matrix in chain(12))
    for name, matrix in (("K", K), ("M", M), ("other", csc(chain(5)[1]))):
        scipy.io.mmwrite(tmp_path / f"{name}.mtx", matrix)
    assert any(text.startswith("other.mtx") for text in draft(tmp_path / "new", recognise(tmp_path)).roles.spare)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    files = box(tmp_path / "box").data
    folder, _ = drafted(files, tmp_path / "new")
    folder.config.write_text("mine")
    before = folder.listing()
    assert lrbc("init", "--from", files, folder.path).code == 2
    assert lrbc("init", "--from", tmp_path / "none", tmp_path / "other").code == 2
    assert folder.listing() == before
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("first", "second", "said"), [("a", "b", "by the size of its entries"), ("mass", "stiffness", "against their names")]
)
def test_roles_by_content(tmp_path: Path, first: str, second: str, said: str) -> None:
    K, M = (csc(matrix) for matrix in chain(12))
    for name, matrix in ((first, K), (second, M)):
        scipy.io.mmwrite(tmp_path / f"{name}.mtx", matrix, symmetry="general", precision=17)
    made = draft(tmp_path / "new", recognise(tmp_path))
    tree = yaml.safe_load(made.text())
    assert tree["model"]["stiffness"] == f"../{first}.mtx"
    assert tree["model"]["mass"] == f"../{second}.mtx"
    assert any(said in item for item in made.todo)


def test_matrices_of_one_file_and_a_share_of_one(tmp_path: Path) -> None:
    K, M = (csc(matrix) for matrix in chain(12))
    scipy.io.savemat(tmp_path / "model.mat", {"K": K, "M": M, "K_x": 0.1 * K, "hammer": np.eye(12)[:, [11]]})
    made = draft(tmp_path / "new", recognise(tmp_path))
    tree = yaml.safe_load(made.text())
    groups = {role: tree["model"][role]["group"] for role in ("stiffness", "mass")}
    assert groups == {"stiffness": "K", "mass": "M"}
    assert tree["model"]["damping"]["structure"]["beta"] > 0
    assert tree["excitation"]["hammer"]["vector"] == {"file": "../model.mat", "group": "hammer"}
    assert any("K_x" in item and "no role" in item for item in made.todo)


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    folder, told = drafted(tmp_path / "files", tmp_path / "new")
    for key in ("model.stiffness", "model.dofs", "excitation.hammer", "responses", "parameters"):
        assert f"to do       {key}" in told.stdout
    checked = folder.run("check")
    assert checked.code == 2
    for place in ("excitation.hammer.near", "responses.response1.near", "parameters.edge.select.box"):
        assert f"{place}: these coordinates are not filled in yet" in checked.stderr
    text = folder.config.read_text()
    for place, filled in (("[[x0, x1], [y0, y1], [z0, z1]]", "[[0, 1], [0, 1], [0, 1]]"), ("[x, y, z]", "[0, 0, 0]")):
        text = text.replace(place, filled)
    folder.config.write_text(text)
    load_campaign(folder.config)
    assert folder.run("check").code == 3


def test_names_that_yaml_would_read_otherwise(tmp_path: Path) -> None:
    files = box(tmp_path / "box").data
    (files / "tight.uff").rename(files / "00.uff")
    (files / "loose.uff").rename(files / "no, #1: 'loose'.uff")
    (files / "springs.csv").write_text("dof\n0\n1\n")
    folder, _ = drafted(files, tmp_path / "a: new #2")
    campaign = load_campaign(folder.config)
    assert campaign.name == "a: new #2"
    assert campaign.update.reference == "00"
    assert {job.frf.name for job in campaign.jobs.values()} == {"00.uff", "no, #1: 'loose'.uff"}


@pytest.mark.parametrize("text", ["plain", "00", "1e3", "no", "true", "~", "a: b", "a #b", "-x", "ä/ö", "x, y", '"q"', "a\\b"])
def test_quoted_texts_are_read_back(text: str) -> None:
    node = parse(f"{{key: {quoted(text)}}}")
    assert node is not None
    assert node.plain() == {"key": text}


@pytest.mark.parametrize(
    ("names", "reference", "baselines"),
    [
        (["loose-2", "tight", "x"], "tight", []),
        (["bolts-04", "bolts-00"], "bolts-00", []),
        (["Messung_fest_1", "Messung_lose"], "Messung_fest_1", []),
        (["tightening", "a"], None, []),
        (["B3-B4-loose-rest-tight", "tight"], "tight", []),
        (["tight-2-repeated-later", "tight-1", "unit-tight"], "tight-1", ["unit-tight", "tight-2-repeated-later"]),
        (["fixed-plate", "ref-plate", "tight"], "tight", ["ref-plate", "fixed-plate"]),
        (["tight", "tight-but-flange-left"], "tight", []),
        (["tight1", "tight2"], "tight1", ["tight2"]),
        (["non-linear-sweep-tight", "canon-shot-tight-2-x"], "non-linear-sweep-tight", ["canon-shot-tight-2-x"]),
        (["ref-nonlinear", "ref-non-contact-laser"], "ref-nonlinear", ["ref-non-contact-laser"]),
    ],
)
def test_the_tight_state_by_its_name(names: list[str], reference: str | None, baselines: list[str]) -> None:
    worded, numbered = tight_states({name: name for name in names}, ["flange left", "1"])
    first = next(iter([*worded, *numbered]), None)
    assert first == reference
    assert [name for name in worded if name != first] == baselines


@pytest.mark.parametrize(
    "name",
    [
        "not-tight",
        "un-tight",
        "B3-tight",
        "bolt_7_tight",
        "rest-tight-B3-loosened",
        "tight-gelöst",
        "fest_los",
        "Schraube-3-lose-Rest-fest",
        "tight-without-b4",
        "ohne-B2-fest",
        "half-tight",
        "tight-coh",
        "coh_tight",
        "koh-fest",
        "B3frei-fest",
        "tight-defekt",
        "tight-damaged",
        "ref-one-removed",
        "open-ref00",
        "ref-non-serré",
        "ref_nonserre_2",
        "ref-desserré",
        "tight-non",
        "non2-tight",
    ],
)
def test_what_is_loose_by_its_name_is_no_tight_state(name: str) -> None:
    assert tight_states({name: name}) == ([], [])


def loose(files: Path, *names: str) -> dict[str, object]:
    """The campaign drafted for measurements of one channel."""
    for name in names:
        file = files / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("frequency_hz,acc1_real,acc1_imag\n" + "".join(f"{f},1.5,0.5\n" for f in range(20, 90)))
    made = draft(files.parent / "new", recognise(files))
    return {"todo": made.todo, **yaml.safe_load(made.text())} | {"todo": made.todo}


def test_a_loose_measurement_is_never_the_reference(tmp_path: Path) -> None:
    tree = loose(tmp_path / "a", "B3-B4-loose-rest-tight.csv", "tight.csv")
    assert tree["update"]["reference"] == tree["calibration"]["job"] == "tight"
    assert "baselines" not in tree["update"]
    for item in ("update.reference: tight, chosen by its name; check that all bolts are tight there", "calibration.job: tight too"):
        assert item in tree["todo"]
    assert any(item.startswith("model.damping: ") for item in tree["todo"])
    tree = loose(tmp_path / "b", "not-tight.csv", "gelöst.csv")
    assert "reference" not in tree["update"]
    assert "calibration" not in tree
    assert any("give the job of the tight state" in item for item in tree["todo"])
    assert list(tree["responses"]) == ["acc1"]
    # The folder says it as well.
    assert loose(tmp_path / "c", "loose/ref.csv", "run/first.csv")["update"]["reference"] == "first"


def test_bolts_are_those_that_terms_name_too(tmp_path: Path) -> None:
    """A state that is called after one of them is no tight one."""
    files = box(tmp_path / "box").data
    (files / "bolts.csv").unlink()
    (files / "springs.csv").write_text("dof,bolt\n" + "".join(f"{i},north {i}\n" for i in range(6)))
    (files / "tight.uff").rename(files / "north-2-tight.uff")
    (files / "loose.uff").rename(files / "zero.uff")
    folder, _ = drafted(files, tmp_path / "new")
    assert load_campaign(folder.config).update.reference == "zero"


def test_a_file_that_is_not_recognised_says_what_to_do(tmp_path: Path) -> None:
    """In the words of the reader that its ending promises."""
    files = box(tmp_path / "box").data
    (files / "time.csv").write_text("time_s,acc1\n" + "".join(f"{i / 1000},{i}\n" for i in range(200)))
    (files / "M2.mtx.gz").write_bytes(gzip.compress((files / "M.mtx").read_bytes())[:300])
    _, told = drafted(files, tmp_path / "new")
    assert "time.csv was not read: this is a time history; let the analyser average FRFs" in told.stdout
    assert re.search("M2.mtx.gz was not read: .*damaged", told.stdout), told.stdout


def test_files_of_two_models_are_refused(tmp_path: Path) -> None:
    for size in (12, 20):
        K, M = (csc(matrix) for matrix in chain(size))
        for name, matrix in (("stiffness", K), ("mass", M)):
            file = tmp_path / "files" / f"model{size}" / f"{name}.mtx"
            file.parent.mkdir(parents=True, exist_ok=True)
            scipy.io.mmwrite(file, matrix, symmetry="general", precision=17)
    refused = lrbc("init", "--from", tmp_path / "files", tmp_path / "new")
    assert refused.code == 3
    for text in ("two stiffness matrices, 12 and 20 DOFs", "model12/stiffness.mtx (12 DOFs)", "give --from one of them"):
        assert text in refused.stderr
    assert not (tmp_path / "new").exists()
    one = lrbc("init", "--from", tmp_path / "files" / "model12", tmp_path / "new")
    assert one.code == 0
    assert "recognised  stiffness: stiffness.mtx, 12 DOFs" in one.stdout
    file = lrbc("init", "--from", tmp_path / "files" / "model12" / "mass.mtx", tmp_path / "other")
    assert file.code == 2
    assert "a file, not a folder" in file.stderr
    assert f"--from {tmp_path / 'files' / 'model12'}" in file.stderr


def test_a_reduced_model_beside_its_full_one_is_no_second_model(tmp_path: Path) -> None:
    (K, M), (Kr, Mr) = chain(12), chain(4)
    scipy.io.savemat(tmp_path / "model.mat", {"K": csc(K), "M": csc(M), "K_red": csc(Kr), "M_red": csc(Mr)})
    made = draft(tmp_path / "new", recognise(tmp_path))
    assert yaml.safe_load(made.text())["model"]["stiffness"]["group"] == "K"


def test_places_to_fill_in_are_refused_until_they_are(tmp_path: Path) -> None:
    """At the origin they would be taken for places of the model."""
    files = box(tmp_path / "box").data
    (files / "tight.uff").unlink()
    (files / "loose.uff").unlink()
    (files / "springs.csv").write_text("dof,bolt\n" + "".join(f"{i},B{i + 1}\n" for i in range(6)))
    columns = ("acc1", "acc2", "acc3", "acc4")
    (files / "tight.csv").write_text(
        "frequency_hz,"
        + ",".join(f"{name}_{part}" for name in columns for part in ("real", "imag"))
        + "\n"
        + "".join(",".join([str(f), *["1.0"] * 8]) + "\n" for f in range(20, 200))
    )
    folder, _ = drafted(files, tmp_path / "new")
    refused = folder.run("update")
    assert refused.code == 2
    for text in (".near: coordinates are not filled in yet", "excitation hammer", "responses acc1, acc2, acc3, acc4", "fix:"):
        assert text in refused.stderr
    # All that is to be fixed, in the files too.
    (files / "tight.csv").write_text("nothing\n")
    told = folder.run("check")
    assert told.code == 2
    for name in ("excitation.hammer", *(f"responses.{name}" for name in columns)):
        assert told.stderr.count(f"{name}.near: these coordinates are not filled in yet") == 1
    assert told.stderr.count("tight.csv") == told.stderr.count("fix:") - 1 == 1
    tree = folder.run("check", "--json").json
    assert (tree["exit_code"], len(tree["others"]), list(tree["errors"])) == (2, 4, ["tight"])
    # The rest of the file is looked at as ever.
    assert "did you mean" in folder.run("check", "--override", "reductoin.band=[1, 2]").stderr


def test_the_edge_beside_a_row_of_bolts() -> None:
    y = np.linspace(0.0, 1.0, 11)
    grid = np.array([[x, b, 0.0] for x in (0.0, 0.1, 0.2) for b in y])
    table = DofTable(node=np.arange(33), component=np.full(33, "ROTY"), xyz=grid)
    bolts = np.array([[-0.02, b, 0.0] for b in (0.3, 0.5, 0.7)])
    found = edge_near(bolts, table)
    assert found is not None
    component, limits = found
    assert component == "ROTY"
    low, high = np.array(limits).T
    inside = np.all((grid >= low) & (grid <= high), axis=1)
    np.testing.assert_allclose(grid[inside], [[0.0, b, 0.0] for b in y if 0.09 < b < 0.91])
    assert edge_near(bolts[:, [1, 0, 2]], table) is None


def exodus(path: Path) -> None:
    """An exodus mesh as netCDF-4 stores it: coordinates in one array, as whole numbers of nodes in a dimension."""
    with h5py.File(path, "w") as file:
        file["num_nodes"], file["coord"] = np.zeros(12), np.arange(36.0).reshape(3, 12)
        file["connect1"] = np.arange(1, 13).reshape(3, 4)


@pytest.mark.parametrize("name", ["plate.e", "plate.exo"])
def test_an_exodus_mesh_is_no_matrix(tmp_path: Path, name: str) -> None:
    """Its coordinates were a matrix without a role, and no mesh was found."""
    exodus(tmp_path / name)
    found = recognise(tmp_path)
    assert found.matrices == []
    assert found.of("nodes") == [tmp_path / name]
    (tmp_path / name).write_bytes(b"CDF\x02" + bytes(60))
    assert "no nodes" in recognise(tmp_path).rest[tmp_path / name]


def test_results_of_an_earlier_run_are_no_measurements(tmp_path: Path) -> None:
    """The curves in ``output/JOB/frf.csv`` became jobs of the draft."""
    curves = "frequency_hz,acc1_measured_db,acc1_measured_phase_deg\n" + "".join(f"{f},{-f},{f + 5}\n" for f in range(10, 40))
    for place in ("output/tight", "output/calibration", "frf"):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "frf.csv").write_text(curves)
    (tmp_path / "output/reduction.json").write_text("{}")
    found = recognise(tmp_path)
    assert list(found.measurements) == [tmp_path / "frf/frf.csv"]
    assert found.rest == {}


@pytest.mark.parametrize("layout", ["csr", "csc"])
def test_compressed_arrays_of_other_names_are_matrices(tmp_path: Path, layout: str) -> None:
    """The files of elPaSo were `no FRF was recognised`."""
    K, M, *_ = (csc(matrix) for matrix in chain(12))
    with h5py.File(tmp_path / "system.h5", "w") as file:
        for name, matrix in (("stiffness", K + csc(np.triu(np.ones(K.shape), 9))), ("mass", M)):
            stored, group = matrix.asformat(layout), file.create_group(f"SystemMatrices/{name}")
            group[f"cmp{layout.title()}Val"], group["vec,Ia"], group["vecJa"] = stored.data.astype(complex), stored.indptr, stored.indices
        # These are no matrix, whatever their sizes.
        file["curve/at"], file["curve/of"], file["curve/y"] = np.array([3, 1, 7]), np.array([9, 5]), np.array([1.0, 2.0, 3.0])
    made = draft(tmp_path / "new", recognise(tmp_path))
    names = {"data": f"cmp{layout.title()}Val", "indices": "vecJa", "indptr": "vec,Ia", **({"layout": "csc"} if layout == "csc" else {})}
    expected = {role: {"file": "../system.h5", "group": f"SystemMatrices/{role}", "arrays": names} for role in ("stiffness", "mass")}
    assert {role: yaml.safe_load(made.text())["model"][role] for role in expected} == expected
    found = made.roles.operators["stiffness"]
    assert found.arrays is not None
    again = read_matrix(found.path, found.group, arrays=found.arrays).matrix
    assert abs(again - (K + csc(np.triu(np.ones(K.shape), 9)))).max() == 0.0


def test_a_model_of_another_program_says_how_to_export_its_matrices(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "plate.mph", "w") as archive:
        archive.writestr("dmodel.xml", "<model/>")
    assert recognise(tmp_path).rest == {
        tmp_path / "plate.mph": "this is a model of COMSOL; in COMSOL: mphmatrix and save in LiveLink for MATLAB"
    }
