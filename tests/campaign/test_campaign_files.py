"""Several files a job, records by number and file, roving hammer, a response that one job lacks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import Folder

from lrbc_cli.campaign.identification.matching import parted as parted_names
from lrbc_cli.campaign.identification.records import Measurement, read_measurement
from lrbc_cli.errors import LrbcError
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet

NAMES = ("mic1", "mic2", "mic3", "acc1")


def measured(folder: Folder, job: str = "loose") -> Measurement:
    inputs = folder.inputs()
    return read_measurement(inputs, inputs.campaign.jobs[job], job)


def refused(folder: Folder, job: str = "loose") -> str:
    with pytest.raises(LrbcError) as caught:
        measured(folder, job)
    return str(caught.value)


def records_of(folder: Folder, job: str = "loose") -> list[FrfRecord]:
    return list(read_frf(folder.data / f"{job}.uff").records)


def put(folder: Folder, name: str, *records: FrfRecord) -> str:
    """Write a file into the data; its path as a campaign file says it."""
    write_frf(folder.data / name, FrfSet(source=name, records=records))
    return f"data/{name}"


def set_job(folder: Folder, name: str = "loose", **keys: object) -> None:
    tree = folder.tree()
    tree["jobs"][name] = {**tree["jobs"][name], **keys}
    folder.write(tree)


def parted(folder: Folder, job: str = "loose") -> list[str]:
    """The four records of a job in three files of three formats."""
    a, b, c, d = records_of(folder, job)
    return [put(folder, f"{job}-a.uff", a, b), put(folder, f"{job}-b.csv", replace(c, name="mic3")), put(folder, f"{job}-c.h5", d)]


def test_several_files_are_one_measurement(box: Folder) -> None:
    whole = measured(box)
    set_job(box, frf=parted(box))
    found = measured(box)
    np.testing.assert_allclose(found.values, whole.values, rtol=1e-11)
    assert {Path(path).name for path in found.hashes} == {"loose-a.uff", "loose-b.csv", "loose-c.h5"}
    assert [line.split(":")[1].strip() for line in found.records] == [
        "loose-a.uff record 1",
        "loose-a.uff record 2",
        "loose-b.csv record 1 (column mic3_real)",
        "loose-c.h5 record 1 (output 1 (acc1))",
    ]
    assert "4 of 4 responses matched" in box.run("check").stdout
    assert box.run("update", "--job", "loose").code == 0
    assert "loose: kept" in box.run("update", "--job", "loose", "--dry-run").stdout
    # Any of the files is part of what a result rests on.
    _, _, c, _ = records_of(box)
    put(box, "loose-b.csv", replace(c, name="mic3", values=1.01 * c.values))
    assert "its measurement" in box.run("update", "--job", "loose", "--dry-run").stdout


def test_no_command_writes_to_one_of_several_files(box: Folder) -> None:
    set_job(box, frf=parted(box))
    result = box.run("simulate", "--out", str(box.data / "loose-b.csv"), "--force")
    assert result.code == 2
    assert "this is an input of the campaign" in result.stderr
    assert "jobs.loose.frf" in result.stderr


def test_files_that_clash_are_named(box: Folder) -> None:
    a, b, c, d = records_of(box)
    first = put(box, "a.uff", a, b, c, d)
    set_job(box, frf=[first, put(box, "b.uff", replace(b, values=2 * b.values))])
    text = refused(box)
    assert "the files a.uff and b.uff both contain response mic2" in text
    assert "records: {mic2: {file: a.uff}}" in text
    set_job(box, frf=[first, put(box, "b.uff", replace(b, values=2 * b.values))], records={"mic2": {"file": "data/b.uff"}})
    np.testing.assert_allclose(measured(box).values[:, 1], 2 * b.values, rtol=1e-11)
    (box.data / "copy.uff").write_bytes((box.data / "a.uff").read_bytes())
    set_job(box, frf=[first, "data/copy.uff"], records={})
    text = refused(box)
    assert "copy.uff" in text
    assert "the content of a.uff once more" in text
    coarse = replace(d, frequency_hz=d.frequency_hz[::2], values=d.values[::2])
    set_job(box, frf=[put(box, "a.uff", a, b, c), put(box, "d.uff", coarse)])
    text = refused(box)
    assert "two files of one job have different frequency lines, a.uff and d.uff" in text
    assert "191 lines from 20 to 400 Hz" in text
    assert "96 lines from 20 to 400 Hz" in text
    # Lines outside the band do not matter: a text export may leave out what it cannot print.
    longer = replace(d, frequency_hz=np.append(d.frequency_hz, 402.0), values=np.append(d.values, 1.0))
    set_job(box, frf=["data/a.uff", put(box, "d.uff", longer)])
    assert measured(box).frequency_hz.size == 191


def test_records_by_number_file_and_the_name_of_the_file(box: Folder) -> None:
    a, b, c, d = (replace(r, name="", response_node=None) for r in records_of(box))
    whole = measured(box).values
    set_job(box, frf=put(box, "all.uff", d, c, b, a), records={"mic1": 4, "mic2": 3, "mic3": 2, "acc1": 1})
    np.testing.assert_allclose(measured(box).values, whole, rtol=1e-11)
    # Files of one nameless record are called by their names.
    files = [put(box, f"{name}.uff", record) for name, record in zip(NAMES, (a, b, c, d), strict=True)]
    set_job(box, frf=files, records={})
    found = measured(box)
    np.testing.assert_allclose(found.values, whole, rtol=1e-11)
    assert "no name in the file, named after the file: mic1, mic2, mic3, acc1" in found.notes
    set_job(box, frf=[put(box, "x.uff", b, a), put(box, "y.uff", c), put(box, "z.uff", d)])
    places = {
        "mic1": {"file": "data/x.uff", "number": 2},
        "mic2": {"file": "data/x.uff", "number": 1},
        "mic3": {"file": "data/y.uff"},
        "acc1": {"file": "data/z.uff", "number": 1},
    }
    set_job(box, records=places)
    np.testing.assert_allclose(measured(box).values, whole, rtol=1e-11)
    set_job(box, records=places | {"mic1": {"file": "data/x.uff"}})
    assert "several records fit response mic1 (the one record of x.uff)" in refused(box)
    set_job(box, records=places | {"mic1": 1})
    assert "both contain response mic1 (number 1)" in refused(box)
    set_job(box, records=places | {"mic1": {"file": "data/tight.uff"}})
    text = refused(box)
    assert "this is not one of the job's files" in text
    assert "jobs.loose.records.mic1.file" in text


@pytest.mark.parametrize("pattern", ["loose_{}.uff", "{}-loose.uff", "{}.uff"])
def test_records_of_the_same_name_in_several_files(pattern: str, box: Folder) -> None:
    """A roving hammer without node numbers: the file says where it hit."""
    a, b, c, d = (replace(r, name=name, response_node=None) for r, name in zip(records_of(box), ("mic", "mic", "mic", "acc"), strict=True))
    whole = measured(box).values
    files = [put(box, pattern.format(k), *own) for k, own in enumerate(((a, d), (b,), (c,)), start=1)]
    set_job(box, frf=files, records={"acc1": "acc"})
    np.testing.assert_allclose(measured(box).values, whole, rtol=1e-11)
    assert box.run("update", "--job", "loose").code == 0
    # Files of exchanged names are other records.
    one, two = (box.path / file for file in files[:2])
    content = one.read_bytes(), two.read_bytes()
    one.write_bytes(content[1])
    two.write_bytes(content[0])
    set_job(box, frf=[files[1], files[0], files[2]])
    assert "loose: runs (changed: its measurement)" in box.run("update", "--job", "loose", "--dry-run").stdout
    np.testing.assert_allclose(measured(box).values, whole[:, [1, 0, 2, 3]], rtol=1e-11)
    # The only one that was measured in a state.
    set_job(box, frf=put(box, "half_1.uff", a, replace(b, name="mic2"), replace(c, name="mic3"), d), records={"acc1": "acc"})
    np.testing.assert_allclose(measured(box).values, whole, rtol=1e-11)
    # Of one that is lacking, those without a response are named so that they can be copied.
    set_job(box, frf=files, records={"acc1": "acc", "mic1": "mic-4"})
    assert "expected: name mic-4" in refused(box)


@pytest.mark.parametrize(
    ("names", "parts"),
    [
        (["tight_H01", "tight_H02"], ["H01", "H02"]),
        (["H01 tight", "H02 tight"], ["H01", "H02"]),
        (["a-1-x", "a-2-x"], ["1", "2"]),
        (["H1", "H2"], ["H1", "H2"]),
        (["run_1", "run_1_h2"], ["", "h2"]),
    ],
)
def test_the_part_that_files_do_not_share(names: list[str], parts: list[str]) -> None:
    files = [f"data/{name}.csv" for name in names]
    assert list(parted_names(files).values()) == parts


def test_results_do_not_rest_on_the_paths_of_files(box: Folder) -> None:
    files = parted(box)
    set_job(box, frf=files, records={"mic3": {"file": files[1], "number": 1}})
    assert box.run("update", "--job", "loose").code == 0
    moved = [f"data/moved{Path(file).suffix}" for file in files]
    for old, new in zip(files, moved, strict=True):
        (box.path / old).rename(box.path / new)
    set_job(box, frf=moved, records={"mic3": {"file": moved[1], "number": 1}})
    assert "loose: kept" in box.run("update", "--job", "loose", "--dry-run").stdout


def test_a_response_that_one_job_lacks(box: Folder) -> None:
    a, _, c, d = records_of(box)
    put(box, "loose.uff", a, c, d)
    missing = "loose.uff: no record of mic2: identified from the other 3 responses, so this job gives no all-clear"
    missing += "; measure mic2 again if one is wanted"
    assert tuple(map(str, measured(box).warnings)) == (missing,)
    assert missing in box.run("check").stdout
    result = box.run("update", "--job", "loose", "--fail-on-loose")
    assert result.code == 6
    tree = box.result("loose")
    assert [bolt["verdict"] for bolt in tree["bolts"]].count("loose") == 2
    assert tree["misfit_db"]["responses"]["mic2"] == {"initial": None, "final": None, "used": True}
    assert box.run("report", "--job", "loose").code == 0
    # A job of tight bolts that lacks one is no all-clear.
    a, _, c, d = records_of(box, "tight")
    set_job(box, frf=put(box, "again.uff", *(replace(r, values=1.001 * r.values) for r in (a, c, d))), removed=[])
    result = box.run("update", "--job", "loose", "--fail-on-loose", "--json")
    assert result.code == 7
    assert "no record of mic2" in result.json["not_clear"]["loose"]
    # More than half, the reference job and what the job itself names are not missed.
    put(box, "loose.uff", a)
    set_job(box, frf="data/loose.uff")
    assert "no record of response mic2, nor of mic3, acc1" in refused(box)
    put(box, "loose.uff", a, c, d)
    set_job(box, records={"mic2": "nothing"})
    assert "no record of response mic2" in refused(box)
    put(box, "tight.uff", a, c, d)
    assert "no record of response mic2" in refused(box, "tight")


def test_roving_hammer_by_reciprocity(box: Folder) -> None:
    """A fixed sensor and a hammer that moves: the sensor is the excitation, each hammer point a response."""
    tree = box.tree()
    tree["excitation"] = {"sensor": {"node": 7, "component": "UZ"}}
    tree["responses"] = {f"p{node}": {"node": node, "component": "UZ", "quantity": "acceleration"} for node in (1, 4, 8)}
    box.write(tree)
    *_, acc = records_of(box)
    acc = replace(acc, name="acc", response_node=7, response_direction=3, reference_direction=3)
    hits = [replace(acc, reference_node=node, values=node * acc.values) for node in (1, 4, 8)]
    set_job(box, frf=[put(box, f"hit{record.reference_node}.uff", record) for record in hits])
    found = measured(box)
    np.testing.assert_allclose(found.values, np.stack([record.values for record in hits], axis=1), rtol=1e-11)
    assert "hammer and sensor exchanged, by reciprocity: p1, p4, p8" in found.notes
    # The model agrees, with air beside the structure too.
    model = box.inputs().model
    s = 2j * np.pi * 123.0
    dynamic = (model.K + s * model.C + s**2 * model.M).toarray()
    sensor, points = model.B.toarray()[:, 0], model.L.toarray()
    assert model.is_acoustic.any()
    np.testing.assert_allclose(points @ np.linalg.solve(dynamic, sensor), np.linalg.solve(dynamic, points.T).T @ sensor, rtol=1e-9)


def test_roving_hammer_with_several_excitations(box: Folder) -> None:
    """A fixed microphone: each hammer point is an excitation with a response of its own."""
    tree = box.tree()
    tree["excitation"] = {f"hit{node}": {"node": node, "component": "UZ"} for node in (7, 8)}
    tree["responses"] = {f"mic-{node}": {"node": 103, "component": "PRES", "excitation": f"hit{node}"} for node in (7, 8)}
    box.write(tree)
    mic, *_ = records_of(box)
    hits = [replace(mic, name="mic", reference_node=node, reference_direction=3, values=node * mic.values) for node in (7, 8)]
    set_job(box, frf=[put(box, f"hit{record.reference_node}.uff", record) for record in hits])
    np.testing.assert_allclose(measured(box).values, np.stack([record.values for record in hits], axis=1), rtol=1e-11)
    # By reference where the campaign names the record itself.
    sides = {f"mic-{node}": {"node": 103, "direction": 0, "reference_node": 15 - node} for node in (7, 8)}
    set_job(box, records=sides)
    np.testing.assert_allclose(measured(box).values[:, 0], hits[1].values, rtol=1e-11)
