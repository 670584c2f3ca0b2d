"""``lrbc calibrate`` on small campaigns: what it finds, what is stored, when it is used, and when not."""

from __future__ import annotations

import csv
import gzip
import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from campaigns import ROOT, Folder, box, finished, frame, lrbc
from samples import reduced_cache

import lrbc_cli
from lrbc_cli.campaign import calibrate
from lrbc_cli.campaign.calibration import read_inputs
from lrbc_cli.config import load_campaign
from lrbc_cli.results.store import digest_of

FACTORS = {"job": "tight", "factors": ["stiffness.structure", "damping.structure"]}


def with_calibration(folder: Folder, calibration: dict[str, Any] | None = None) -> Folder:
    tree = folder.tree()
    tree["calibration"] = calibration or FACTORS
    folder.write(tree)
    return folder


def stored(folder: Folder) -> Any:
    return json.loads((folder.out / "calibration.json").read_text())


def add_noise(file: Path) -> None:
    """Errors of 1 % of each value."""
    rows = [line.split(",") for line in file.read_text().splitlines()]
    values = np.array(rows[1:], dtype=float)
    rng = np.random.default_rng(2)
    H = values[:, 1::2] + 1j * values[:, 2::2]
    H = H * (1 + 0.01 * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2))
    values[:, 1::2], values[:, 2::2] = H.real, H.imag
    file.write_text("\n".join([",".join(rows[0]), *(",".join(f"{x:.9e}" for x in row) for row in values)]) + "\n")


@pytest.fixture
def fresh(tmp_path: Path) -> Folder:
    """The frame, its measurement that of its own model, noise of 1 %, the model's files then 5 % too stiff and half as damped."""
    folder = with_calibration(frame(tmp_path / "frame"))
    file = folder.data / "frf" / "tight.csv"
    file.unlink()
    assert folder.run("simulate", "--lines", "30:500:1", "--set", "left_edge=6.0", "--out", folder.path / "own.csv").code == 0
    (folder.path / "own.csv").rename(file)
    add_noise(file)
    stiffness = folder.data / "model" / "stiffness.mtx"
    scipy.io.mmwrite(stiffness, scipy.io.mmread(stiffness, spmatrix=False) * 1.05, symmetry="symmetric", precision=17)
    damping = folder.data / "model" / "damping.mtx.gz"
    with gzip.open(damping) as f:
        matrix = scipy.io.mmread(f, spmatrix=False)
    plain = damping.with_suffix("")
    scipy.io.mmwrite(plain, matrix * 0.5, symmetry="symmetric", precision=17)
    damping.write_bytes(gzip.compress(plain.read_bytes()))
    return folder


@pytest.mark.slow
def test_python_uses_it_as_the_command_line_does(fresh: Folder) -> None:
    """There is no reading a campaign without saying whether its calibration is used."""
    assert fresh.run("calibrate").code == 0
    assert fresh.run("simulate", "--lines", "60:64:2", "--set", "left_edge=5.5", "--out", fresh.path / "y.csv").code == 0
    table = np.genfromtxt(fresh.path / "y.csv", delimiter=",", names=True)
    written = table["acc1_real"] + 1j * table["acc1_imag"]

    def from_python(calibration: bool) -> np.ndarray:
        study = lrbc_cli.load(fresh.config, calibration=calibration, cache=fresh.cache)
        return study.frf([60.0, 62.0, 64.0], left_edge=5.5)[:, 0]

    np.testing.assert_allclose(from_python(True), written, rtol=1e-6)
    assert np.linalg.norm(from_python(False) - written) > 1e-2 * np.linalg.norm(written)
    campaign = load_campaign(fresh.config)
    with pytest.raises(TypeError, match="calibration"):
        read_inputs(campaign)  # type: ignore[call-arg]
    used = [read_inputs(campaign, calibration=use).calibration for use in (True, False)]
    assert [use.used for use in used if use is not None] == [True, False]


@pytest.mark.slow
def test_from_end_to_end(fresh: Folder) -> None:
    """What was spoilt is found; every later command uses it and says so."""
    plan = fresh.run("calibrate", "--dry-run")
    assert plan.code == 0
    assert "runs (none yet)" in plan.stdout
    assert not fresh.out.exists()
    assert "none yet" in fresh.run("check").stdout

    done = fresh.run("calibrate", "--json")
    assert done.code == 0, done.stderr
    tree = done.json
    assert tree == stored(fresh)
    assert tree["status"] == "converged"
    stiffness, damping = tree["factors"]["stiffness.structure"], tree["factors"]["damping.structure"]
    assert stiffness["value"] == pytest.approx(1 / 1.05, rel=0.005)
    assert damping["value"] == pytest.approx(2.0, rel=0.2)
    for entry in (stiffness, damping):
        assert entry["lower95"] < entry["value"] < entry["upper95"]
        assert entry["initial"] == 1.0
    assert tree["misfit_db"]["initial"] > 2.0
    assert tree["misfit_db"]["final"] < 0.2
    assert tree["misfit_db"]["held_out_final"] < 0.3
    assert tree["reduction"]["worst"] <= tree["reduction"]["tolerance"]
    assert tree["rounds"][-1]["factors"] == {name: entry["value"] for name, entry in tree["factors"].items()}
    with (fresh.out / "calibration" / "frf.csv").open() as file:
        header = next(csv.reader(file))
    assert {"acc1_measured_db", "acc4_initial_db", "acc4_updated_phase_deg", "selected"} <= set(header)

    kept = fresh.run("calibrate")
    assert "kept: nothing changed" in kept.stdout
    assert "calibration\n  used (tight, 2 factors)\n" in fresh.run("check").stdout
    reduced = fresh.run("reduce", "--json")
    assert reduced.json["calibration"]["key"] == tree["key"]
    assert "calibration: used" in reduced.stderr
    files = []
    for name, args in (("used", ()), ("full", ("--full",)), ("exported", ("--no-calibration",))):
        files.append(fresh.path / f"{name}.csv")
        assert fresh.run("simulate", "--lines", "40:480:40", "--out", files[-1], *args).code == 0
    used, full, without = (np.genfromtxt(path, delimiter=",", skip_header=1)[:, 1:] for path in files)
    assert np.linalg.norm(used - full) < 1e-3 * np.linalg.norm(full)
    assert np.linalg.norm(without - full) > 0.1 * np.linalg.norm(full)
    updated = fresh.run("update", "--job", "tight", "--json")
    assert updated.code == 0, updated.stderr
    result = updated.json["results"]["tight"]
    assert result["provenance"]["calibration"]["factors"]["stiffness.structure"] == stiffness["value"]
    assert result["misfit_db"]["final"] < 0.2
    report = fresh.run("report")
    assert report.code == 0, report.stderr
    page = (fresh.out / "report.html").read_text()
    assert "All jobs use this model." in page
    assert "after calibration" in page

    # Without it, the model is as exported, and the jobs run again.
    exported = fresh.run("update", "--job", "tight", "--json", "--no-calibration")
    assert "left out" in exported.stderr
    assert exported.json["results"]["tight"]["provenance"]["calibration"] is None
    assert exported.json["results"]["tight"]["misfit_db"]["final"] > result["misfit_db"]["final"] + 0.2
    fresh.run("report")
    assert "The jobs of this report do NOT use it" in (fresh.out / "report.html").read_text()


@pytest.fixture
def copy(tmp_path: Path) -> Folder:
    """Calibrated on the sample's own measurement."""
    return finished("calibrated").copy(tmp_path / "frame")


class TestWhetherItFits:
    def test_copied_elsewhere(self, copy: Folder) -> None:
        """Contents count, not paths or time stamps."""
        assert "calibration: used" in copy.run("reduce", "--dry-run").stderr

    @pytest.mark.parametrize(
        "override",
        [
            "update.regularisation=3.0",
            "bolts=",
            "reduction.backend=superlu",
            "jobs.loose-2.frf=data/frf/tight.csv",
            "campaign=frame-left-edge",
        ],
    )
    def test_what_does_not_matter(self, copy: Folder, override: str) -> None:
        assert "calibration\n  used (" in copy.run("check", "--override", override).stdout

    @pytest.mark.parametrize(
        ("override", "words"),
        [
            ("calibration.boundary=held", "settings"),
            ("calibration.factors=[stiffness.structure]", "settings"),
            ("update.lines=all", "settings"),
            ("jobs.tight.frf=data/frf/loose-2.csv", "the measurement"),
            ("parameters.left_edge.initial=6.0", "parameter groups"),
            ("reduction.band=[30.0, 480.0]", "the band"),
            ("model.damping=data/model/damping.mtx.gz", "the damping"),
        ],
    )
    def test_what_does(self, copy: Folder, override: str, words: str) -> None:
        shutil.copy(copy.data / "model" / "mass.mtx.gz", copy.data / "model" / "damping.mtx.gz")
        outcome = copy.run("reduce", "--dry-run", "--override", override)
        assert outcome.code == 0
        assert "warning: calibration: ignored: changed since" in outcome.stderr
        assert words in outcome.stderr
        assert "runs (changed since" in copy.run("calibrate", "--dry-run", "--override", override).stdout

    def test_the_key_does_not_rest_on_calibrated_operators(self, copy: Folder) -> None:
        """A second calibration starts from the model as exported, and finds the same."""
        before = stored(copy)
        assert copy.run("calibrate", "--force").code == 0
        after = stored(copy)
        assert after["key"] == before["key"]
        assert after["factors"]["stiffness.structure"]["value"] == pytest.approx(
            before["factors"]["stiffness.structure"]["value"], rel=1e-9
        )

    def test_a_measurement_that_changes_during_the_run(self, copy: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
        """Replaced after the key was taken, and put back: the factors of the other content would count as those of this one."""
        before = (copy.out / "calibration.json").read_bytes()
        right, other = (copy.data / "frf" / f"{name}.csv" for name in ("tight", "loose-2"))
        content = right.read_bytes()

        def read(*args: Any, original: Any = calibrate.read_measurement) -> Any:
            right.write_bytes(other.read_bytes())
            return original(*args)

        with monkeypatch.context() as change:
            change.setattr(calibrate, "read_measurement", read)
            outcome = copy.run("calibrate", "--force")
        assert outcome.code == 3, outcome.stderr
        assert f"{right}: the file changed during the run" in outcome.stderr
        assert (copy.out / "calibration.json").read_bytes() == before
        right.write_bytes(content)
        assert "calibration: used" in copy.run("reduce", "--dry-run").stderr

    def test_without_the_block(self, copy: Folder) -> None:
        tree = copy.tree()
        del tree["calibration"]
        copy.write(tree)
        assert "the campaign file has no 'calibration'" in copy.run("check").stdout
        outcome = copy.run("calibrate")
        assert outcome.code == 2
        assert "no block 'calibration'" in outcome.stderr

    def test_damaged(self, copy: Folder) -> None:
        file = copy.out / "calibration.json"
        text = file.read_text()
        for spoilt in (
            text[: len(text) // 2],
            text.replace('"lrbc-calibration"', '"lrbc-result"'),
            text.replace('"value"', '"valeu"'),
            text.replace('"value": 0.', '"value": -0.'),
            text.replace('"key"', '"kee"'),
            # A number that nothing found.
            text.replace('"value": 0.', '"value": 0.9', 1),
            "[]",
        ):
            file.write_text(spoilt)
            outcome = copy.run("reduce", "--dry-run")
            assert outcome.code == 0
            assert "warning: calibration: ignored: unusable" in outcome.stderr
            assert "runs (" in copy.run("calibrate", "--dry-run").stdout
        assert copy.run("calibrate").code == 0
        assert "calibration: used" in copy.run("reduce", "--dry-run").stderr

    def test_no_measurement(self, copy: Folder) -> None:
        (copy.data / "frf" / "tight.csv").unlink()
        assert "not comparable" in copy.run("reduce", "--dry-run").stderr
        assert copy.run("calibrate").code == 3


#: Commands that compute with the model, and change nothing here.
COMPUTING = [
    ["check"],
    ["status"],
    ["plan", "--draws", "0"],
    ["simulate", "--lines", "100,110", "--out", "out.csv"],
    ["reduce", "--dry-run"],
    ["update", "--dry-run"],
]


@pytest.mark.parametrize("words", [pytest.param(words, id=words[0]) for words in COMPUTING])
def test_one_of_an_earlier_version_is_told(copy: Folder, words: list[str], tmp_path: Path) -> None:
    """The same by all commands: its inputs are the same, so it is used, and it is told."""
    tree = stored(copy)
    tree["parts"]["version"], tree["key"] = "0" * 64, "0" * 32
    (copy.out / "calibration.json").write_text(json.dumps(tree | {"digest": digest_of(tree)}))
    done = copy.run(*(str(tmp_path / word) if word == "out.csv" else word for word in words))
    assert done.code == 0, done.stderr
    assert "changed since: the code that calibrates; `lrbc calibrate` identifies it anew" in done.stdout + done.stderr
    assert "calibration: used (tight" in done.stdout + done.stderr


@pytest.mark.slow
def test_watch_tells_one_that_it_does_not_make(tmp_path: Path) -> None:
    folder = finished("two jobs").copy(tmp_path / "frame")
    tree = folder.tree()
    del tree["calibration"]
    folder.write(tree)
    (folder.out / "calibration.json").write_text("{}")
    done = folder.run("watch", "--once")
    assert done.code == 0, done.stderr
    assert "warning: calibration: ignored: the campaign file has no 'calibration'" in done.stderr


def test_rounds(tmp_path: Path) -> None:
    """A reduced model that is worse at the factors found than the tolerance is built anew there, until it is not."""
    folder = box(tmp_path / "box")
    K = scipy.io.mmread(folder.data / "K.mtx", spmatrix=False).tocsr()
    K[:8, :8] *= 1.06
    scipy.io.mmwrite(folder.data / "K.mtx", K, precision=17)
    with_calibration(folder, {"job": "tight", "factors": ["stiffness.structure"]})
    outcome = folder.run("calibrate", "--json", "--override", "reduction.tolerance=1e-9")
    assert outcome.code == 0, outcome.stderr
    tree = outcome.json
    assert tree["factors"]["stiffness.structure"]["value"] == pytest.approx(1 / 1.06, rel=1e-3)
    errors = [entry["error"] for entry in tree["rounds"]]
    assert errors[-1] <= 1e-9 or tree["status"] == "stopped"
    assert all(entry["size"] > 0 for entry in tree["rounds"])


class TestCampaignFile:
    @pytest.mark.parametrize(
        ("calibration", "place", "words"),
        [
            ({"job": "tihgt", "factors": ["stiffness.structure"]}, "calibration.job", "did you mean 'tight'?"),
            ({"job": "tight", "factors": ["stifness.structure"]}, "calibration.factors[0]", "did you mean 'stiffness.structure'?"),
            ({"job": "tight", "factors": ["alpha.structure"]}, "calibration.factors[0]", "needs model.damping.structure.alpha above 0"),
            ({"job": "tight", "factors": ["mass.acoustic"]}, "calibration.factors[0]", "scales nothing in this model"),
            ({"job": "tight", "factors": ["loss_factor.structure"]}, "calibration.factors[0]", "or a complex stiffness"),
            ({"job": "tight", "factors": ["stiffness.structure"] * 2}, "calibration.factors[1]", "is given twice"),
            ({"job": "tight"}, "calibration.factors", "at least one factor or group"),
            ({"factors": ["stiffness.structure"]}, "calibration.job", "missing"),
            ({"job": "tight", "factors": ["sound_speed", "stiffness.acoustic"]}, "calibration.factors[0]", "the same effect"),
            ({"job": "tight", "boundary": "hold", "factors": ["stiffness.structure"]}, "calibration.boundary", "'held'"),
            ({"job": "tight", "groups": {"rib": {}}}, "calibration.groups.rib", "without a matrix"),
            ({"job": "tight", "groups": {"mass.structure": {"mass": "m.mtx"}}}, "calibration.groups", "has the name of a factor"),
            ({"job": "tight", "groups": {"rib": {"stifness": "a.mtx"}}}, "calibration.groups.rib.stifness", "did you mean 'stiffness'?"),
        ],
    )  # fmt: skip
    def test_refused(self, tmp_path: Path, calibration: dict[str, Any], place: str, words: str) -> None:
        folder = with_calibration(frame(tmp_path / "frame"), calibration)
        outcome = folder.run("calibrate")
        assert outcome.code == 2
        assert place in outcome.stderr
        assert words in outcome.stderr

    @pytest.mark.slow
    def test_a_loss_factor(self, tmp_path: Path) -> None:
        """What was put in comes out: of the campaign, and of a complex matrix; the commands use it."""
        folder = with_calibration(frame(tmp_path / "frame"), {"job": "tight", "factors": ["loss_factor.structure"], "boundary": "held"})

        def damped(loss_factor: float) -> tuple[str, str]:
            return "--override", f"model.damping={{structure: {{beta: 2.0e-6, loss_factor: {loss_factor}}}}}"

        assert folder.run("simulate", "--lines", "30:500:1", *damped(0.03), "--out", folder.path / "own.csv").code == 0
        (folder.path / "own.csv").replace(folder.data / "frf" / "tight.csv")
        outcome = folder.run("calibrate", "--json", *damped(0.01))
        assert outcome.code == 0, outcome.stderr
        assert outcome.json["factors"]["loss_factor.structure"]["value"] == pytest.approx(3.0, rel=2e-3)
        assert "loss factor about 0.03" in folder.run("check", *damped(0.01)).stdout
        K = scipy.io.mmread(folder.data / "model" / "stiffness.mtx", spmatrix=False)
        scipy.io.mmwrite(folder.data / "model" / "stiffness.mtx", K * (1 + 0.02j), symmetry="general", precision=17)
        outcome = folder.run("calibrate", "--json", *damped(0))
        assert outcome.code == 0, outcome.stderr
        assert outcome.json["factors"]["loss_factor.structure"]["value"] == pytest.approx(1.5, rel=2e-3)

    @pytest.mark.slow
    def test_a_group(self, tmp_path: Path) -> None:
        """A share of the stiffness: what was put in comes out."""
        folder = frame(tmp_path / "frame")
        K = scipy.io.mmread(folder.data / "model" / "stiffness.mtx", spmatrix=False).tocsr()
        first = np.arange(K.shape[0]) < 120
        part = K.multiply(np.outer(first, first)).tocoo()
        scipy.io.mmwrite(folder.data / "model" / "part.mtx", part, symmetry="symmetric", precision=17)
        assert folder.run("simulate", "--lines", "30:500:1", "--out", folder.path / "own.csv").code == 0
        (folder.path / "own.csv").replace(folder.data / "frf" / "tight.csv")
        scipy.io.mmwrite(folder.data / "model" / "stiffness.mtx", K + 0.04 * part, symmetry="symmetric", precision=17)
        scipy.io.mmwrite(folder.data / "model" / "part.mtx", 1.04 * part, symmetry="symmetric", precision=17)
        with_calibration(folder, {"job": "tight", "groups": {"part": {"stiffness": "data/model/part.mtx"}}, "boundary": "held"})
        outcome = folder.run("calibrate", "--json")
        assert outcome.code == 0, outcome.stderr
        assert outcome.json["factors"]["part"]["value"] == pytest.approx(1 / 1.04, rel=2e-3)
        assert "calibration: used (tight, 1 factor)" in folder.run("reduce").stderr

    @pytest.mark.slow
    def test_two_groups_alike(self, tmp_path: Path) -> None:
        """In the file, on the console and in the report."""
        folder = frame(tmp_path / "frame")
        K = sp.csc_array(scipy.io.mmread(folder.data / "model" / "stiffness.mtx", spmatrix=False))
        scipy.io.mmwrite(folder.data / "model" / "part.mtx", sp.coo_array(0.3 * K), symmetry="general", precision=17)
        groups = {name: {"stiffness": "data/model/part.mtx"} for name in ("one", "two")}
        with_calibration(folder, {"job": "tight", "groups": groups, "boundary": "held"})
        outcome = folder.run("calibrate")
        assert outcome.code == 0, outcome.stderr
        words = "one and two cannot be distinguished by these FRFs: only their combination is determined"
        assert f"note: {words}" in outcome.stdout
        assert any(note.startswith(words) for note in stored(folder)["notes"])
        assert folder.run("update", "--job", "tight").code == 0
        assert folder.run("report").code == 0
        assert words in (folder.out / "report.html").read_text()

    @pytest.mark.parametrize(
        ("scale", "code", "words"),
        [(0.9, 0, ""), (1.2, 0, "exceeds that of the model"), (-0.3, 0, "opposite sign"), (1e3, 3, "1e+03 times")],
    )
    def test_a_share_of_another_size(self, tmp_path: Path, scale: float, code: int, words: str) -> None:
        """A part of the plate; a little more than the model has, or less than nothing, as prestress is; in other units."""
        folder = frame(tmp_path / "frame")
        K = sp.csc_array(scipy.io.mmread(folder.data / "model" / "stiffness.mtx", spmatrix=False)).tolil()
        K[60:, :] = 0.0
        K[:, 60:] = 0.0
        scipy.io.mmwrite(folder.data / "model" / "part.mtx", sp.coo_array(scale * K), symmetry="general", precision=17)
        with_calibration(folder, {"job": "tight", "groups": {"part": {"stiffness": "data/model/part.mtx"}}})
        outcome = folder.run("check")
        assert outcome.code == code, outcome.stderr
        said = outcome.stdout + outcome.stderr
        if words:
            assert said.count(words) == 1
            assert "part" in said
        else:
            assert "exceeds" not in said

    @pytest.mark.parametrize(("factors", "fix"), [(["stiffness.structure"], "stiffness.structure scales it already"), ([], "under calib")])
    def test_a_group_that_is_the_whole(self, tmp_path: Path, factors: list[str], fix: str) -> None:
        folder = frame(tmp_path / "frame")
        whole = {"job": "tight", "groups": {"E": {"stiffness": "data/model/stiffness.mtx"}}}
        with_calibration(folder, whole | ({"factors": factors} if factors else {"factors": ["mass.structure"]}))
        said = folder.run("check").stdout
        assert "calibration.groups.E.stiffness: stiffness.mtx is the whole stiffness matrix of the structure, not a share" in said
        assert fix in said

    def test_a_group_that_is_no_share(self, tmp_path: Path) -> None:
        folder = frame(tmp_path / "frame")
        n = scipy.io.mmread(folder.data / "model" / "stiffness.mtx", spmatrix=False).shape[0]
        foreign = np.zeros((n, n))
        foreign[0, n - 1] = foreign[n - 1, 0] = 1e3
        scipy.io.mmwrite(folder.data / "model" / "part.mtx", scipy.sparse.coo_array(foreign))
        with_calibration(folder, {"job": "tight", "groups": {"part": {"stiffness": "data/model/part.mtx"}}})
        outcome = folder.run("check")
        assert outcome.code == 3
        assert "not part of the model's matrix" in outcome.stderr


@pytest.mark.slow
def test_soundbox_from_afar(tmp_path: Path) -> None:
    """5 % of stiffness and a factor of 2 in all damping, from noisy FRFs of the model itself; from both sides on small models elsewhere."""
    config, file, stiffness = ROOT / "configs" / "soundbox.yaml", tmp_path / "tight.csv", 1.05
    common = ("--override", f"output={(tmp_path / 'out').as_posix()}")
    measure = ("simulate", config, "--cache", reduced_cache("soundbox"), *common, "--set", "left_edge=2.6", "--out", file)
    assert lrbc(*measure).code == 0
    add_noise(file)
    own = [
        f"model.damping.{field}={{alpha: {a}, beta: {b}}}"
        for field, a, b in (("structure", 2.56785, 5.108e-6), ("acoustic", 7.551, 2.5995e-7))
    ]
    own += [f"jobs.bolts-00={{frf: {file.as_posix()}}}", "calibration.groups={}"]
    # The exported model is the other one: its plate is 1/stiffness as stiff.
    model = tmp_path / "model.h5"
    shutil.copy(ROOT / "data_samples" / "soundbox" / "model.h5", model)
    with h5py.File(model, "r+") as f:
        data, indptr, indices = f["K/data"][:], f["K/indptr"][:], f["K/indices"][:]
        plate = np.repeat(np.arange(indptr.size - 1), np.diff(indptr))
        data[(plate < 5372) & (indices < 5372)] /= stiffness
        f["K/data"][:] = data
    own += [f"model.stiffness='{model.as_posix()}#K'", f"model.mass='{model.as_posix()}#M'"]
    outcome = lrbc(
        "calibrate", config, "--cache", tmp_path / "cache", *common, "--json", *(part for o in own for part in ("--override", o))
    )
    assert outcome.code == 0, outcome.stderr
    factors = {name: entry["value"] for name, entry in outcome.json["factors"].items()}
    assert factors["stiffness.structure"] == pytest.approx(stiffness, rel=0.005)
    assert factors["mass.acoustic"] == pytest.approx(1.0, rel=0.005)
    for name, value in {"alpha.structure": 2.0, "beta.structure": 0.5, "alpha.acoustic": 0.5, "beta.acoustic": 2.0}.items():
        assert factors[name] == pytest.approx(value, rel=0.2), name


@pytest.mark.slow
def test_soundbox_sample(tmp_path: Path) -> None:
    """The measured rig: mean misfit over all lines at most 1 dB on microphones used, 1.3 dB on the others."""
    config = ROOT / "configs" / "soundbox.yaml"
    cache, out = reduced_cache("soundbox"), tmp_path / "out"
    outcome = lrbc("calibrate", config, "--cache", cache, "--json", "--override", f"output={out.as_posix()}")
    assert outcome.code == 0, outcome.stderr
    misfit = outcome.json["misfit_db"]
    assert misfit["final"] < 0.5
    assert misfit["held_out_final"] < 0.6
