"""FRFs of the model: files that are read again, lines, parameters, reduced against full order."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from campaigns import BOX_TRUTH, Folder
from systems import direct_frf, relative

from lrbc_cli.io.frf import read_frf

ENDINGS = [".csv", ".uff", ".unv", ".h5", ".hdf5"]


def frfs(folder: Folder, *args: str, out: str = "sim.h5") -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and (F, R) FRFs of one call."""
    path = folder.path / out
    result = folder.run("simulate", "--force", "--out", str(path), *args)
    assert result.code == 0, result.stderr
    records = read_frf(path).records
    return records[0].frequency_hz, np.stack([record.values for record in records], axis=1)


def expected(folder: Folder, frequency: np.ndarray, log10: np.ndarray) -> np.ndarray:
    """The same by dense solves of the assembled matrices."""
    inputs = folder.inputs()
    s = 2j * np.pi * frequency
    D = np.tile(10.0 ** np.asarray(log10, dtype=float) + 0j, (s.size, 1))
    return direct_frf(inputs.model, s, D, inputs.input_of)


@pytest.mark.parametrize("ending", ENDINGS)
def test_files_are_read_again(box: Folder, ending: str) -> None:
    out = box.path / f"new/folder/sim{ending}"
    result = box.run("simulate", "--out", str(out), "--lines", "20:400:2", "--json")
    assert result.code == 0
    assert result.json == {"file": out.as_posix(), "lines": 191, "responses": ["mic1", "mic2", "mic3", "acc1"]}
    records = read_frf(out).records
    assert [record.name for record in records] == ["mic1", "mic2", "mic3", "acc1"]
    np.testing.assert_allclose(records[0].frequency_hz, np.arange(20.0, 401.0, 2.0), rtol=1e-12)
    values = np.stack([record.values for record in records], axis=1)
    assert relative(values, expected(box, records[0].frequency_hz, np.full(6, 4.5))) < 1e-6
    if ending != ".csv":
        assert [record.quantity for record in records] == ["pressure"] * 3 + ["acceleration"]
        assert [(r.response_node, r.response_direction) for r in records] == [(103, 0), (112, 0), (124, 0), (7, 3)]
        assert {(r.reference_node, r.reference_direction) for r in records} == {(8, 3)}
    assert not [path for path in out.parent.iterdir() if path != out]


def test_the_csv_is_that_of_the_interface(box: Folder) -> None:
    out = box.path / "sim.csv"
    assert box.run("simulate", "--out", str(out), "--lines", "33.3,71.7").code == 0
    with out.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["frequency_hz"] + [f"{name}_{part}" for name in ("mic1", "mic2", "mic3", "acc1") for part in ("real", "imag")]
    assert [float(row[0]) for row in rows[1:]] == [33.3, 71.7]
    assert len(rows) == 3


@pytest.mark.parametrize(
    ("lines", "frequency"),
    [
        (None, np.arange(20.0, 401.0)),
        ("20:400:1", np.arange(20.0, 401.0)),
        ("100:110", np.arange(100.0, 111.0)),
        ("30:31:0.25", [30.0, 30.25, 30.5, 30.75, 31.0]),
        ("30:31:0.3", [30.0, 30.3, 30.6, 30.9]),
        ("71.7", [71.7]),
        ("71.7,33.3, 33.3", [33.3, 71.7]),
        ("1e2:1.02e2:1", [100.0, 101.0, 102.0]),
        ("20:400:380", [20.0, 400.0]),
    ],
)
def test_lines(box: Folder, lines: str | None, frequency: list[float]) -> None:
    found, values = frfs(box, *(["--lines", lines] if lines else []))
    np.testing.assert_allclose(found, frequency, rtol=1e-12)
    assert values.shape == (len(frequency), 4)
    assert np.all(np.isfinite(values))


@pytest.mark.parametrize(
    ("lines", "parts"),
    [
        ("abc", ["these are not frequency lines"]),
        ("20:400:1:2", ["these are not frequency lines"]),
        ("", ["these are not frequency lines"]),
        ("20,", ["these are not frequency lines"]),
        ("nan", ["these are not frequency lines"]),
        ("20:inf", ["these are not frequency lines"]),
        ("20:400:0", ["holds no line"]),
        ("20:400:-1", ["holds no line"]),
        ("400:20:1", ["holds no line"]),
        ("20:400:1e-9", ["more than 200000 lines"]),
        ("1:1e308:1e-308", ["line"]),
        ("0:100:1", ["above 0 Hz"]),
        ("-5:100:1", ["above 0 Hz"]),
        ("10:100:1", ["outside its band", "20 to 400 Hz", "10 to 100 Hz", "--full"]),
        ("100,400.5", ["outside its band", "100 to 400.5 Hz"]),
    ],
)
def test_lines_that_are_refused(box: Folder, lines: str, parts: list[str]) -> None:
    out = box.path / "sim.csv"
    result = box.run("simulate", "--out", str(out), f"--lines={lines}")
    assert result.code == 2
    assert f"--lines {lines}" in result.stderr
    for part in parts:
        assert part in result.stderr
    assert not out.exists()


def test_full_order_goes_beyond_the_band(box: Folder) -> None:
    frequency, values = frfs(box, "--full", "--lines", "5:600:35")
    assert relative(values, expected(box, frequency, np.full(6, 4.5))) < 1e-9


@pytest.mark.parametrize(
    ("assignment", "log10"),
    [
        ("springs=3", np.full(6, 3.0)),
        ("springs=inf", np.full(6, np.inf)),
        ("springs=-inf", np.full(6, -np.inf)),
        ("springs=4.6,4.4,2.6,2.8,4.5,4.6", BOX_TRUTH["loose"]),
        ("springs=4,inf,-inf,3e0,-2,20", [4, np.inf, -np.inf, 3, -2, 20]),
    ],
)
def test_given_values(box: Folder, assignment: str, log10: np.ndarray) -> None:
    with np.errstate(over="ignore"):
        for order in ([], ["--full"]):
            frequency, values = frfs(box, f"--set={assignment}", "--lines", "21:399:7", *order)
            assert relative(values, expected(box, frequency, log10)) < 1e-6


@pytest.mark.parametrize(
    ("assignment", "parts"),
    [
        ("spring=3", ["GROUP", "springs", "spring=3"]),
        ("springs", ["GROUP=LOG10"]),
        ("springs.stiffness=3", ["GROUP.damping=LOG10"]),
        ("springs=three", ["not a number", "three"]),
        ("springs=nan", ["cannot be used", "nan"]),
        ("springs=1,2", ["does not fit", "1 or 6 values", "2"]),
        ("springs=", ["not a number"]),
        ("springs=31", ["out of range", "between -30 and 30"]),
        ("springs=4,4,4,4,4,-1e300", ["out of range"]),
        ("springs.damping=1", ["has no damping exponent"]),
    ],
)
def test_values_that_are_refused(box: Folder, assignment: str, parts: list[str]) -> None:
    out = box.path / "sim.csv"
    result = box.run("simulate", "--out", str(out), "--set", assignment)
    assert result.code == 2
    assert f"--set {assignment}" in result.stderr
    for part in parts:
        assert part in result.stderr
    assert not out.exists()


def test_damping_of_a_group(frame: Folder) -> None:
    _, at_start = frfs(frame, "--lines", "60:200:10")
    _, damped = frfs(frame, "--lines", "60:200:10", "--set", "left_edge.damping=2.0", "--set", "left_edge=5.5")
    _, full = frfs(frame, "--lines", "60:200:10", "--set", "left_edge.damping=2.0", "--set", "left_edge=5.5", "--full")
    assert relative(damped, full) < 1e-3
    # eq. (33): the terms carry k (1 + s beta 10^p).
    inputs = frame.inputs()
    s = 2j * np.pi * np.arange(60.0, 201.0, 10.0)
    W = np.eye(10) * 0.666667 + (np.eye(10, k=1) + np.eye(10, k=-1)) * 0.333333
    D = (W @ np.full(10, 10.0**5.5))[None, :] * (1 + s * 2e-6 * 1e2)[:, None]
    assert relative(full, direct_frf(inputs.model, s, D, inputs.input_of)) < 1e-8
    assert relative(at_start, full) > 0.01
    for bad in ("inf", "1,2"):
        result = frame.run("simulate", "--out", "x.csv", "--set", f"left_edge.damping={bad}")
        assert result.code == 2
        assert "the damping exponent is one" in result.stderr


def test_loss_factors(box: Folder) -> None:
    """Of a field, a joint, and in the matrix: K (1 + i eta), p (1 + i eta 10^p_damp), reduced and in full."""
    frequency = np.arange(30.0, 301.0, 30.0)
    s, lines = 2j * np.pi * frequency, ("--lines", "30:300:30", "--set", "springs=4.2")
    inputs = box.inputs()
    model, own = inputs.model, ~inputs.model.is_acoustic
    K = model.K.toarray()
    K = K + 0.03j * K * np.outer(own, own)
    D = np.full((s.size, 6), 10.0**4.2 + 0j)
    lossy = direct_frf(replace(model, K=sp.csc_array(K)), s, D, inputs.input_of)
    assert relative(lossy, expected(box, frequency, np.full(6, 4.2))) > 0.05
    of_field = ("--override", "model.damping.structure.loss_factor=0.03")
    for full in ((), ("--full",)):
        assert relative(frfs(box, *lines, *of_field, *full)[1], lossy) < 1e-6
    tied = ("--override", "parameters.springs.damping={beta: 0, loss_factor: 0.2}", "--set", "springs.damping=0.3")
    D = D * (1 + 0.2j * 10**0.3)
    both = direct_frf(replace(model, K=sp.csc_array(K)), s, D, inputs.input_of)
    assert relative(both, lossy) > 0.05
    assert relative(frfs(box, *lines, *of_field, *tied)[1], both) < 1e-6
    # The exporter's own complex matrix.
    scipy.io.mmwrite(box.data / "K.mtx", sp.coo_array(K), symmetry="general", precision=17)
    assert relative(frfs(box, *lines)[1], lossy) < 1e-6


def test_a_group_whose_name_holds_dots(box: Folder) -> None:
    box.replace("springs:", "springs.low:")
    frequency, values = frfs(box, "--set", "springs.low=3", "--lines", "30:300:30")
    assert relative(values, expected(box, frequency, np.full(6, 3.0))) < 1e-6
    assert "no damping exponent" in box.run("simulate", "--out", "x.csv", "--set", "springs.low.damping=3").stderr


def test_identified_parameters(box: Folder) -> None:
    for job, truth in BOX_TRUTH.items():
        frequency, values = frfs(box, "--job", job, "--lines", "20:400:2")
        assert relative(values, expected(box, frequency, truth)) < 1e-6
        # They are the updated FRFs of the result file.
        with (box.out / job / "frf.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        for i, name in enumerate(("mic1", "mic2", "mic3", "acc1")):
            level = [float(row[f"{name}_updated_db"]) for row in rows]
            np.testing.assert_allclose(20 * np.log10(np.abs(values[:, i])), level, atol=1e-6)
    # --set acts on top of the job.
    frequency, values = frfs(box, "--job", "loose", "--set", "springs=inf", "--lines", "30:300:30")
    assert relative(values, expected(box, frequency, np.full(6, np.inf))) < 1e-6


def test_jobs_without_parameters(box: Folder) -> None:
    path = box.out / "loose" / "result.json"
    kept = path.read_bytes()
    out = str(box.path / "sim.csv")
    (box.data / "loose.uff").write_bytes(b"")
    box.run("update")
    failed = box.run("simulate", "--out", out, "--job", "loose")
    assert failed.code == 3
    assert "no identified parameters" in failed.stderr
    path.unlink()
    missing = box.run("simulate", "--out", out, "--job", "loose")
    assert missing.code == 3
    assert "--job loose" in missing.stderr
    path.write_bytes(kept[:300])
    damaged = box.run("simulate", "--out", out, "--job", "loose")
    assert damaged.code == 3
    assert "damaged" in damaged.stderr
    path.write_bytes(kept)
    box.replace("- 1.5\n", "- 1.2\n")
    other = box.run("simulate", "--out", out, "--job", "loose")
    assert other.code == 3
    assert "the result of job loose does not match" in other.stderr
    assert not Path(out).exists()


@pytest.mark.parametrize(("sample", "tolerance"), [("box", 1e-6), ("frame", 1e-3)])
@pytest.mark.parametrize("value", ["-inf", "3.7", "inf"])
def test_reduced_order_holds_its_tolerance(request: pytest.FixtureRequest, sample: str, tolerance: float, value: str) -> None:
    folder = request.getfixturevalue(sample)
    group = "springs" if sample == "box" else "left_edge"
    lines = "31:399:8"
    _, reduced = frfs(folder, f"--set={group}={value}", "--lines", lines)
    _, full = frfs(folder, f"--set={group}={value}", "--lines", lines, "--full")
    for columns in ([0, 1, 2], [3]) if sample == "box" else ([0, 1, 2, 3],):
        assert relative(reduced[:, columns], full[:, columns]) <= tolerance


def test_quantities_are_powers_of_s(box: Folder) -> None:
    found = {}
    for quantity in ("displacement", "velocity", "acceleration"):
        frequency, values = frfs(box, "--override", f"responses.acc1.quantity={quantity}", "--lines", "20:400:20")
        found[quantity] = values[:, 3]
    omega = 2 * np.pi * frequency
    np.testing.assert_allclose(found["velocity"], 1j * omega * found["displacement"], rtol=1e-9)
    np.testing.assert_allclose(found["acceleration"], -(omega**2) * found["displacement"], rtol=1e-9)


def test_the_scale_of_points(box: Folder) -> None:
    _, plain = frfs(box, "--lines", "50:300:50")
    _, turned = frfs(box, "--lines", "50:300:50", "--override", "excitation.hammer.scale=-2", "--override", "responses.mic1.scale=3")
    np.testing.assert_allclose(turned[:, 0], -6 * plain[:, 0], rtol=1e-7)
    np.testing.assert_allclose(turned[:, 1:], -2 * plain[:, 1:], rtol=1e-7)


def test_start_values_do_not_depend_on_the_lines_asked_for(box: Folder) -> None:
    """`auto` is resolved on the band."""
    auto = ("--override", "parameters.springs.initial=auto", "--override", "parameters.springs.bounds=auto")
    frequency, whole = frfs(box, *auto)
    _, some = frfs(box, *auto, "--lines", "50,100,333")
    np.testing.assert_allclose(some, whole[np.isin(frequency, [50, 100, 333])], rtol=1e-9)


@pytest.mark.parametrize("name", ["sim.xlsx", "sim", "sim.csv.gz", "sim.npz"])
def test_unknown_endings(box: Folder, name: str) -> None:
    result = box.run("simulate", "--out", str(box.path / name))
    assert result.code == 2
    for part in ("--out", "ending", ".csv", ".uff", ".h5", "found:"):
        assert part in result.stderr
    assert not (box.path / name).exists()


def test_out_that_cannot_be_written(box: Folder) -> None:
    (box.path / "file").write_text("mine")
    (box.path / "folder.csv").mkdir()
    for name in ("file/sim.csv", "folder.csv"):
        result = box.run("simulate", "--out", str(box.path / name))
        assert result.code == 2
        assert "Traceback" not in result.stderr
        assert "--out" in result.stderr
    assert box.run("simulate").code == 2


@pytest.mark.slow
def test_a_model_measures_itself(box: Folder) -> None:
    """Simulated FRFs are a measurement of a job: the values that made them come back."""
    for ending in (".csv", ".uff", ".h5"):
        out = box.data / f"self{ending}"
        assert box.run("simulate", "--out", str(out), "--set", "springs=4.2,4.8,3.1,4.4,2.9,4.5", "--lines", "20:400:2").code == 0
        result = box.run("update", "--job", "loose", "--override", f"jobs.loose.frf=data/self{ending}", "--json")
        assert result.code == 0
        log10 = result.json["results"]["loose"]["parameters"]["springs"]["log10"]
        np.testing.assert_allclose(log10, [4.2, 4.8, 3.1, 4.4, 2.9, 4.5], atol=1e-6)
