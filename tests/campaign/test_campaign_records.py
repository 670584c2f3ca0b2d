"""Records of FRF files find their responses: by what the campaign says, by name, by node and direction."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from campaigns import Folder

from lrbc_cli.campaign.digests import about_measurement
from lrbc_cli.campaign.identification.matching import coherences_of, keys_of, with_files
from lrbc_cli.campaign.identification.records import Measurement, read_measurement, unlike
from lrbc_cli.campaign.identification.weights import validation_channels
from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.frf import read_frf, write_frf
from lrbc_cli.io.frf_common import alike
from lrbc_cli.model.frf import FrfRecord, FrfSet


def measured(folder: Folder, *overrides: str, job: str = "loose") -> Measurement:
    inputs = folder.inputs(*overrides)
    return read_measurement(inputs, inputs.campaign.jobs[job], job)


def told(found: Measurement) -> tuple[str, ...]:
    return tuple(map(str, found.warnings))


def rewrite(folder: Folder, change: Any, name: str = "loose.uff") -> list[FrfRecord]:
    """Write the FRFs anew after a change of each record; the records before."""
    path = folder.data / name
    before = list(read_frf(path).records)
    write_frf(path, FrfSet(source=name, records=tuple(change(record) for record in before)))
    return before


def anonymous(record: FrfRecord) -> FrfRecord:
    return replace(record, name="")


def refused(folder: Folder, *overrides: str, job: str = "loose") -> DataError:
    with pytest.raises(DataError) as caught:
        measured(folder, *overrides, job=job)
    return caught.value


def test_by_name(box: Folder) -> None:
    before = rewrite(box, lambda r: replace(r, name=r.name.upper(), response_node=None))
    found = measured(box)
    np.testing.assert_allclose(found.values, np.stack([r.values for r in before], axis=1), rtol=1e-11)
    np.testing.assert_allclose(found.frequency_hz, before[0].frequency_hz)
    assert found.lines == "191 lines from 20 to 400 Hz"
    assert found.warnings == ()
    assert np.isnan(found.coherence).all()


@pytest.mark.parametrize(
    "written", ["H1({}/hammer)", "h1({},hammer:+Z)", "FRF ({} / hammer)", "{0[0]} {0[1]}", "{0[0]}_{0[1]}", "{0[0]}-{0[1]}"]
)
def test_by_a_name_that_is_alike(box: Folder, written: str) -> None:
    """A response called acc1 did not find `H1(acc1/hammer)` nor `Acc 1`."""

    def name(record: FrfRecord) -> str:
        parts = record.name[:-1].capitalize(), record.name[-1]
        return written.format(parts if "0[" in written else record.name)

    before = rewrite(box, lambda r: replace(r, name=name(r), response_node=None))
    np.testing.assert_allclose(measured(box).values, np.stack([r.values for r in before], axis=1), rtol=1e-11)


@pytest.mark.parametrize("other", ["H1(mic1/shaker)", "MIC 1"])
def test_names_that_are_alike_must_not_be_ambiguous(box: Folder, other: str) -> None:
    path = box.data / "loose.uff"
    first, *rest = (replace(record, response_node=None) for record in read_frf(path).records)
    write_frf(path, FrfSet(source="", records=(replace(first, name="H1(mic1/hammer)"), replace(first, name=other), *rest)))
    error = refused(box, "jobs.tight.frf=data/loose.uff", "jobs.loose.frf=data/tight.uff", job="tight")
    assert "no record of response mic1" in str(error)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("Acc 1", "acc1", True),
        ("acc1.1", "acc11", False),
        ("acc1:-Z", "acc1:Z", False),
        ("H1(a/b", "a", False),
        ("acc 1.1", "Acc1_1", True),
    ],
)
def test_names_that_are_alike(one: str, other: str, same: bool) -> None:
    assert (alike(one) == alike(other)) is same


def test_by_node_and_direction(box: Folder) -> None:
    before = rewrite(box, anonymous)
    np.testing.assert_allclose(measured(box).values, np.stack([r.values for r in before], axis=1), rtol=1e-11)


def test_names_come_before_nodes(box: Folder) -> None:
    """Two names exchanged: the file calls them so."""
    exchange = {"mic1": "mic2", "mic2": "mic1"}
    before = rewrite(box, lambda r: replace(r, name=exchange.get(r.name, r.name)))
    found = measured(box).values
    np.testing.assert_allclose(found[:, [1, 0]], np.stack([r.values for r in before[:2]], axis=1), rtol=1e-11)


def test_what_the_campaign_says_comes_first(box: Folder) -> None:
    before = list(read_frf(box.data / "loose.uff").records)
    found = measured(box, "responses.mic1.record=mic3", "responses.mic3.record=mic1").values
    np.testing.assert_allclose(found[:, 0], before[2].values, rtol=1e-11)
    found = measured(box, "responses.mic1.record={node: 112, direction: 0}", "responses.mic2.record=mic1").values
    np.testing.assert_allclose(found[:, 0], before[1].values, rtol=1e-11)
    # The job's own word comes before that of the response.
    found = measured(box, "responses.mic1.record=nothing", "jobs.loose.records={mic1: mic2, mic2: mic1}").values
    np.testing.assert_allclose(found[:, 0], before[1].values, rtol=1e-11)
    # Where a name is given that does not exist, nodes are no way out.
    error = refused(box, "responses.mic1.record=nothing", job="tight")
    assert error.expected == "name nothing"
    assert "record 1: mic1, node 103 direction 0, over node 8 direction 3, pressure" in str(error.found)


def test_a_file_of_another_job_is_said_before_other_records_are_offered(box: Folder) -> None:
    """Copied and pasted; the records that were offered instead would have hidden it."""
    records = read_frf(box.data / "tight.uff").records
    for part, own in (("a", records[:2]), ("b", records[2:])):
        write_frf(box.data / f"tight_{part}.uff", FrfSet(source="", records=tuple(own)))
        other = [replace(record, values=2.0 * record.values, name=f"{record.name} again") for record in own]
        write_frf(box.data / f"loose_{part}.uff", FrfSet(source="", records=tuple(other)))
    files = "jobs.loose.frf=[data/loose_a.uff, data/loose_b.uff]", "jobs.tight.frf=[data/tight_a.uff, data/loose_a.uff]"
    hint = str(refused(box, *files, job="tight").hint)
    assert hint.startswith("loose_a.uff belongs to job loose, too: check whether another file was meant; ")


def test_names_stand_for_nodes_in_files_that_have_none(box: Folder) -> None:
    """As a text file beside a campaign that `init` drafted from universal files; what a job itself states holds."""
    before = list(read_frf(box.data / "tight.uff").records)
    node = "responses.mic1.record={node: 901, direction: 0}"
    assert "no record of response mic1" in str(refused(box, node, job="tight"))
    rewrite(box, lambda record: replace(record, response_node=None, reference_node=None), "tight.uff")
    np.testing.assert_allclose(measured(box, node, job="tight").values[:, 0], before[0].values, rtol=1e-11)
    assert "no record of response mic1" in str(refused(box, "jobs.tight.records={mic1: {node: 901, direction: 0}}", job="tight"))
    rewrite(box, lambda record: replace(record, name=""), "tight.uff")
    assert "no record of response mic1" in str(refused(box, node, job="tight"))


def test_records_that_are_left_are_offered(box: Folder) -> None:
    """Where several responses have none, in their order; where another number of them is left, which is whose is not known."""

    rewrite(box, lambda r: replace(r, name="ch 2", response_node=0) if r.name == "mic2" else r, "tight.uff")
    assert "if it is ch 2, write responses.mic2.record: ch 2; otherwise give" in str(refused(box, job="tight").hint)
    rewrite(box, lambda r: replace(r, name="ch 3", response_node=0) if r.name == "mic3" else r, "tight.uff")
    offered = "if they are ch 2, ch 3, in this order, write responses.mic2.record: ch 2, responses.mic3.record: ch 3; otherwise give"
    assert offered in str(refused(box, job="tight").hint)
    left = tuple(record for record in read_frf(box.data / "tight.uff").records if record.name != "ch 3")
    write_frf(box.data / "tight.uff", FrfSet(source="tight.uff", records=left))
    assert str(refused(box, job="tight").hint).startswith("give the record in responses.mic2.record or in the job's records")


def test_a_record_that_is_not_there_is_measured_again(box: Folder) -> None:
    """If every record belongs to another response: the file named holds the others of the hammer point."""
    path = box.data / "tight.uff"
    records = tuple(record for record in read_frf(path).records if record.name != "mic2")
    write_frf(path, FrfSet(source="", records=records))
    error = refused(box, job="tight")
    assert (str(error.file), str(error.hint)) == (
        str(path),
        "measure or export it again, or remove mic2 from the campaign file; records with other names are given in the job's records",
    )
    parts = [box.data / f"tight_{name}.uff" for name in "abc"]
    for part, own in zip(parts, (records[:1], records[1:2], records[2:]), strict=True):
        write_frf(part, FrfSet(source="", records=own))
    apart = refused(box, f"jobs.tight.frf=[{', '.join(f'data/{part.name}' for part in parts)}]", job="tight")
    assert all(record.name in str(apart.found) for record in records)
    # A stated record is another matter.
    assert str(refused(box, "jobs.tight.records={mic2: nothing}", job="tight").hint).startswith("give the record in")


@pytest.mark.parametrize("direction", [1, 2, 5])
def test_another_direction_is_another_record(box: Folder, direction: int) -> None:
    rewrite(box, lambda r: replace(anonymous(r), response_direction=direction if r.name == "acc1" else 0), "tight.uff")
    error = refused(box, job="tight")
    assert "no record of response acc1" in str(error)
    assert "node 7 direction 3" in str(error)
    assert f"node 7 direction {direction}" in str(error)


def test_triaxial_sensors(box: Folder) -> None:
    path = box.data / "loose.uff"
    records = [anonymous(r) for r in read_frf(path).records]
    others = [replace(records[3], response_direction=d, values=d * records[3].values) for d in (1, 2, 3, 6)]
    write_frf(path, FrfSet(source="", records=(*records[:3], *others)))
    np.testing.assert_allclose(measured(box).values[:, 3], 3 * records[3].values, rtol=1e-11)


def test_a_file_to_which_the_analyser_appended(box: Folder) -> None:
    path = box.data / "loose.uff"
    records, before = read_frf(path).records, read_frf(box.data / "tight.uff").records
    write_frf(path, FrfSet(source="", records=(*before, *records)))
    error = refused(box)
    assert "the file holds 2 measurements, one after the other" in str(error)
    first = len(read_frf(path).records) // 2
    last = read_frf(path).records[first].number - 1
    assert f"records 1 to {last} with the numbers of tight.uff; records {last + 1} to the last: the same {first} FRFs each" in error.found
    assert f"delete records 1 to {last} from the file" in str(error.hint)
    write_frf(path, FrfSet(source="", records=(*(replace(r, values=2 * r.values) for r in records), *records)))
    assert "delete the records of the other measurements from the file" in str(refused(box).hint)


def test_ambiguous_records(box: Folder) -> None:
    path = box.data / "loose.uff"
    records = list(read_frf(path).records)
    write_frf(path, FrfSet(source="", records=(records[0], *records)))
    error = refused(box)
    assert "several records fit response mic1 (name mic1)" in str(error)
    assert "record 1: mic1" in str(error.found)
    assert "record 2: mic1" in str(error.found)
    assert "responses.mic1.record" in str(error.hint)
    write_frf(path, FrfSet(source="", records=tuple(anonymous(r) for r in (records[0], *records))))
    assert "several records fit response mic1 (node 103 direction 0)" in str(refused(box))


def test_the_record_over_the_own_hammer_point(box: Folder) -> None:
    """Two roving hammer points under the same names."""
    path = box.data / "loose.uff"
    records = list(read_frf(path).records)
    others = [replace(r, reference_node=4, values=2 * r.values) for r in records]
    write_frf(path, FrfSet(source="", records=(*others, *records)))
    np.testing.assert_allclose(measured(box).values, np.stack([r.values for r in records], axis=1), rtol=1e-11)


def test_a_record_over_another_hammer_point_is_no_substitute(box: Folder) -> None:
    rewrite(box, anonymous, "tight.uff")
    tree = box.tree()
    tree["excitation"]["other"] = {"node": 4, "component": "UZ"}
    for name, response in tree["responses"].items():
        response["excitation"] = "other" if name == "mic1" else "hammer"
    box.write(tree)
    assert "no record of response mic1" in str(refused(box, job="tight"))


def test_scale(box: Folder) -> None:
    plain = measured(box).values
    scaled = measured(box, "jobs.loose.scale={mic2: -0.5, acc1: 9.81}").values
    np.testing.assert_allclose(scaled, plain * [1, -0.5, 1, 9.81], rtol=1e-12)


def test_quantities_must_agree(box: Folder) -> None:
    wrong = ("responses.acc1.quantity=velocity", "responses.acc1.labelled=acceleration")
    np.testing.assert_array_equal(measured(box, *wrong).values, measured(box).values)
    assert refused(box, wrong[0], "responses.acc1.labelled=displacement").found == "acceleration"
    error = refused(box, "responses.acc1.quantity=velocity")
    assert error.exit_code == 3
    assert (error.expected, error.found, error.place) == ("velocity", "acceleration", "record 4")
    assert "responses.acc1.quantity" in str(error.hint)
    assert "pressure" in str(refused(box, "jobs.loose.records={acc1: mic1}").found)


def test_a_file_that_does_not_say_its_quantity(box: Folder) -> None:
    write_frf(box.data / "loose.csv", read_frf(box.data / "loose.uff"))
    found = measured(box, "jobs.loose.frf=data/loose.csv")
    stated = "quantities not stated in the file, taken as in the campaign: mic1, mic2, mic3, acc1"
    assert found.lines == "191 lines from 20 to 400 Hz"
    assert found.notes[-1] == stated
    assert not [note for note in found.notes[:-1] if "acc1" in note]
    assert [line.partition(": ")[0] for line in found.records] == ["mic1", "mic2", "mic3", "acc1"]
    assert found.records[3].endswith("acc1, quantity unknown")
    # The layout says it for the whole file, in a unit of its own.
    error = refused(box, "jobs.loose.frf=data/loose.csv", "jobs.loose.format={unit: g/N}")
    assert "another quantity" in str(error)
    found = measured(
        box,
        "jobs.loose.frf=data/loose.csv",
        "jobs.loose.format={unit: g/N}",
        "update.responses=[acc1]",
        "responses={acc1: {node: 7, component: UZ, quantity: acceleration}}",
    )
    np.testing.assert_allclose(found.values[:, 0], 9.80665 * read_frf(box.data / "loose.uff").records[3].values, rtol=1e-9)


def test_a_layout_for_one_of_several_files(box: Folder) -> None:
    """Microphones in SI from a table that says nothing, an accelerometer in g, dB and degrees from another, its coherence in a third."""
    records = read_frf(box.data / "loose.uff").records
    expected = np.stack([record.values for record in records], axis=1)
    write_frf(box.data / "mics.csv", FrfSet(source="", records=records[:3]))
    acc, hz = records[3].values / 9.80665, records[3].frequency_hz
    np.savetxt(box.data / "acc1.txt", np.column_stack([hz, 20 * np.log10(np.abs(acc)), np.angle(acc, deg=True)]), delimiter=";")
    np.savetxt(box.data / "c.txt", np.column_stack([np.full(hz.size, 0.75), hz]), delimiter=";", header="gamma2;axis", comments="")
    stated = "{file: data/acc1.txt, format: {representation: db-phase, phase: deg, unit: g/N}}"
    files = f"jobs.loose.frf=[data/mics.csv, {stated}]"
    quality = "jobs.loose.coherence={file: data/c.txt, format: {frequency: axis, coherence: gamma2}}"
    found = measured(box, files, quality, "jobs.loose.records={acc1: {file: data/acc1.txt}}")
    np.testing.assert_allclose(found.values, expected, rtol=1e-9)
    assert any("no coherence of the job belongs to a response (c)" in finding.text for finding in found.warnings)
    (box.data / "c.txt").rename(box.data / "acc1.coh")
    quality = quality.replace("c.txt", "acc1.coh")
    found = measured(box, files, quality, "jobs.loose.records={acc1: {file: data/acc1.txt}}")
    np.testing.assert_allclose(found.coherence[:, 3], 0.75)
    assert found.warnings == ()
    # A result that was made with another layout is made anew.
    one, other = (box.inputs(files.replace("g/N", unit)) for unit in ("g/N", "m/s^2/N"))
    told = [about_measurement(i.campaign.resolved(), i.campaign.jobs["loose"], "loose") for i in (one, other)]
    assert told[0] != told[1]


def test_keys_of_the_job_hold_where_the_file_says_nothing(box: Folder) -> None:
    job = box.inputs(
        "jobs.loose.frf=[data/a.csv, {file: data/b.csv, format: {unit: g/N, phase: null}}]",
        "jobs.loose.format={unit: Pa/N, decimal: ',', phase: deg, coherence: c}",
        "jobs.loose.repeats=[{file: data/c.csv, format: {decimal: '.'}}]",
    ).campaign.jobs["loose"]
    a, b, c = (job.format_of(file) for files in job.measurements for file in files)
    assert a == job.format
    assert b is not None
    assert c is not None
    assert (b.unit, b.decimal, b.phase, b.coherence) == ("g/N", ",", None, "c")
    assert (c.unit, c.decimal, c.phase) == ("Pa/N", ".", "deg")
    assert [path.name for path in job.all_files] == ["a.csv", "b.csv", "c.csv"]
    with pytest.raises(ConfigError, match="the repeat uses a file that this job already contains"):
        box.inputs("jobs.loose.frf=data/a.csv", "jobs.loose.repeats=[data/c.csv, {file: data/c.csv, format: {unit: g/N}}]")


def test_coherences_of_one_name_in_several_files_go_with_the_part_of_their_file(box: Folder) -> None:
    """A file for each hammer point, whose columns are the sensors: as for the FRFs themselves."""
    for part, value in (("H1", 0.9), ("H2", 0.8)):
        (box.data / f"c_{part}.csv").write_text(f"frequency_hz,mic1_coherence\n20,{value}\n30,{value}\n")
    files = "jobs.loose.coherence=[data/c_H1.csv, data/c_H2.csv]"
    found = coherences_of(box.inputs(files).campaign.jobs["loose"], {})
    assert {key: pair[1].tolist() for key, pair in found.items()} == {"mic1-H1": [0.9, 0.9], "mic1-H2": [0.8, 0.8]}
    one = coherences_of(box.inputs("jobs.loose.coherence=data/c_H1.csv").campaign.jobs["loose"], {})
    assert list(one) == ["mic1"]
    # Records of two files with one name; a name that stands in one of the files only belongs to no record of both.
    first, second = (FrfRecord(name="mic1", frequency_hz=np.array([20.0]), values=np.ones(1, complex), file=f"f_H{k}.uff") for k in (1, 2))
    full = with_files(FrfSet(source="", records=(first, second)))
    response = box.inputs().responses[0]
    assert keys_of(response, first, full)[:2] == (response.name, "mic1-H1")
    assert "mic1" not in keys_of(replace(response, name="a"), second, full)
    assert keys_of(replace(response, name="a"), first, {})[1] == "mic1"


def test_coherence_in_the_file_and_beside_it(box: Folder) -> None:
    frequency = read_frf(box.data / "loose.uff").records[0].frequency_hz
    own = np.linspace(0.5, 1.0, frequency.size)
    rewrite(box, lambda r: replace(r, coherence=own) if r.name == "mic1" else r)
    found = measured(box)
    np.testing.assert_allclose(found.coherence[:, 0], own, atol=1e-9)
    assert np.isnan(found.coherence[:, 1:]).all()
    table = np.column_stack([frequency[10:], np.full(frequency.size - 10, 0.9), np.full(frequency.size - 10, 0.25)])
    np.savetxt(box.data / "coherence.csv", table, delimiter=",", header="frequency_hz,mic1_coherence,acc1_coherence", comments="")
    found = measured(box, "jobs.loose.coherence=data/coherence.csv")
    # What the separate file says takes precedence where it says something.
    np.testing.assert_allclose(found.coherence[:10, 0], own[:10], atol=1e-9)
    np.testing.assert_allclose(found.coherence[10:, 0], 0.9)
    assert np.isnan(found.coherence[:10, 3]).all()
    np.testing.assert_allclose(found.coherence[10:, 3], 0.25)
    assert {path.rsplit("/", 1)[1] for path in found.hashes} == {"loose.uff", "coherence.csv"}
    (box.data / "coherence.csv").write_text("frequency_hz,mic1_coherence\n20,2.0\n")
    assert "0 to 1" in str(refused(box, "jobs.loose.coherence=data/coherence.csv"))


def test_lines_of_the_records_are_merged(box: Folder) -> None:
    """Responses measured on other lines: NaN where one has no value."""

    def thin(record: FrfRecord) -> FrfRecord:
        step = slice(0, None, 2) if record.name == "mic2" else slice(None)
        return replace(record, frequency_hz=record.frequency_hz[step], values=record.values[step])

    before = rewrite(box, thin)
    found = measured(box)
    assert found.frequency_hz.size == 191
    np.testing.assert_allclose(found.values[::2, 1], before[1].values[::2], rtol=1e-11)
    assert np.isnan(found.values[1::2, 1]).all()
    assert np.isfinite(found.values[:, [0, 2, 3]]).all()
    # It is identified all the same, from the values that are there.
    assert box.run("update", "--job", "loose").code == 0
    np.testing.assert_allclose(box.result("loose")["parameters"]["springs"]["log10"], [4.6, 4.4, 2.6, 2.8, 4.5, 4.6], atol=1e-6)


def test_lines_that_differ_by_rounding_are_the_same(box: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Records whose axes were written with other precision."""
    records = list(read_frf(box.data / "loose.uff").records)
    records[1] = replace(records[1], frequency_hz=records[1].frequency_hz * (1 + 2e-8))
    records[2] = replace(records[2], frequency_hz=records[2].frequency_hz * (1 - 5e-7))
    monkeypatch.setattr("lrbc_cli.campaign.identification.records.read_frf", lambda *_: FrfSet(source="", records=tuple(records)))
    found = measured(box, "reduction.band=[19.0, 401.0]")
    assert found.frequency_hz.size == 191
    assert np.isfinite(found.values).all()


def test_a_single_line(box: Folder) -> None:
    rewrite(box, lambda r: replace(r, frequency_hz=r.frequency_hz[30:31], values=r.values[30:31]))
    error = refused(box)
    assert error.problem == "only one frequency line of this measurement lies in the band of the reduced model"
    assert error.found == "one line, 80 Hz (of 1 from 80 to 80 Hz)"


def test_one_record_for_two_responses(box: Folder) -> None:
    for records in ("{mic1: 2, mic2: 2}", "{mic1: 2}", "{mic2: 1}"):
        error = refused(box, f"jobs.loose.records={records}")
        assert error.problem == "responses mic1 and mic2 have the same record"
        assert "record" in str(error.found)


def test_a_coherence_of_few_lines(box: Folder) -> None:
    table = np.column_stack([np.arange(20.0, 202.0, 2.0), np.full(91, 0.9)])
    np.savetxt(box.data / "coherence.csv", table, delimiter=",", header="frequency_hz,mic1_coherence", comments="")
    found = measured(box, "jobs.loose.coherence=data/coherence.csv")
    assert told(found) == ("loose.uff: the coherence of mic1 has values on 91 of 191 lines of the band only",)
    assert told(measured(box, "jobs.loose.coherence=data/coherence.csv", "reduction.band=[20.0, 220.0]")) == ()


def test_a_validation_channel_that_was_off_is_told(box: Folder) -> None:
    """It was said to have the numbers of every other channel, and the validation channels to be copies of what was fitted."""
    own = "update.responses=[mic1, mic2, acc1]"
    rewrite(box, lambda r: replace(r, values=0.0 * r.values) if r.name == "mic3" else r)
    found, inputs = measured(box, own), box.inputs(own)
    (warning,) = told(found)
    assert warning.startswith("loose.uff: the record of response mic3 is zero on the whole band, so it validates nothing: check whether")
    channels, why = validation_channels(found.values, inputs.used, inputs.validation, inputs.statistics.validation)
    assert (channels.size, why) == (0, "the validation channels have no values")
    assert warning in box.run("check", "--override", own).stdout


def test_a_measurement_that_was_cut_off(box: Folder) -> None:
    rewrite(box, lambda r: replace(r, frequency_hz=r.frequency_hz[:93], values=r.values[:93]))
    warning = "loose.uff: the lines from 20 to 204 Hz cover 48% of the band from 20 to 400 Hz. Check whether the file is complete. "
    warning += "Otherwise measure again over the whole band, or end the band of all jobs there: reduction.band: [20, 204]"
    assert told(measured(box)) == (warning,)
    assert measured(box, "reduction.band=[20.0, 210.0]").warnings == ()
    assert warning in box.run("check").stdout
    result = box.run("update", "--job", "loose", "--override", "update.regularisation=auto")
    assert result.code == 0
    lines = "93 lines from 20 to 204 Hz instead of 191 lines from 20 to 400 Hz"
    others = f"its frequency lines differ from those of tight ({lines}): compared without correction by it"
    assert result.stderr == f"warning: job loose: {warning}\nwarning: job loose: {others}\n"
    assert box.result("loose")["notes"][0] == warning


def test_lines_that_differ_are_named() -> None:
    axis = np.arange(20.0, 30.0)
    assert unlike(axis[:5], axis) == "5 lines from 20 to 24 Hz instead of 10 lines from 20 to 29 Hz"
    assert unlike(np.where(axis == 22, 22.25, axis), axis) == "line 3 at 22.25 Hz instead of 22 Hz"


def test_a_response_that_was_cut_off(box: Folder) -> None:
    rewrite(box, lambda r: replace(r, frequency_hz=r.frequency_hz[:150], values=r.values[:150]) if r.name == "mic2" else r)
    warning = "loose.uff: response mic2 has values on 150 of 191 lines only, from 20 to 318 Hz. Check whether the file is complete. "
    warning += "Otherwise measure it again, or remove the response"
    assert told(measured(box)) == (warning,)
    # A validation channel, too, tests only what it holds.
    assert told(measured(box, "update.responses=[mic1, acc1]")) == (warning,)
    assert measured(box, "reduction.band=[20.0, 380.0]").warnings == ()


def test_band_ends_are_inside(box: Folder) -> None:
    found = measured(box, "reduction.band=[20.0, 100.0]")
    assert (found.frequency_hz[0], found.frequency_hz[-1]) == (20.0, 100.0)
    assert found.lines == "41 lines from 20 to 100 Hz (0 below and 150 above the band left out)"
