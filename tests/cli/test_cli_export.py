"""Exported reduced models, read without any code of the package: FRFs, time domain, layout, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.signal
import scipy.sparse as sp
from campaigns import BOX_TRUTH, ROOT, Folder, lrbc
from samples import reduced_cache
from systems import direct_frf

from lrbc_cli.io import export as io_export
from lrbc_cli.io.frf import read_frf

LINES = "31:399:6"
GROUPS = {"second_order", "terms", "parameters", "damping_exponents", "responses", "excitations", "reduction", "provenance"}


def read_h5(path: Path) -> dict[str, Any]:
    """Nested dictionaries from HDF5, texts decoded."""

    def convert(node):
        if isinstance(node, h5py.Group):
            assert node.attrs["encoding-version"] == "0.1.0"
            return {name: convert(item) for name, item in node.items()}
        kind, value = node.attrs["encoding-type"], node[()]
        if kind == "string":
            return value.decode()
        if kind == "string-array":
            return [text.decode() for text in value]
        assert kind == ("array" if node.shape else "numeric-scalar")
        return value

    with h5py.File(path, "r") as file:
        assert file.attrs["encoding-type"] == "lrbc-reduced-model"
        return convert(file)


def read_mat(path: Path) -> dict[str, Any]:
    """The same from MATLAB."""

    def convert(value):
        if isinstance(value, np.ndarray) and value.dtype.names:
            assert value.shape == (1, 1)
            return {name: convert(value[0, 0][name]) for name in value.dtype.names}
        if isinstance(value, np.ndarray) and value.dtype == object:
            return [str(item[0]) if item.size else "" for item in value[:, 0]] if value.size else []
        if value.dtype.kind == "U":
            return str(value[0]) if value.size else ""
        return value

    tree = scipy.io.loadmat(path, spmatrix=False)
    assert str(tree["encoding_type"][0]) == "lrbc-reduced-model"
    return {name: convert(value) for name, value in tree.items() if name[0] != "_" and not name.startswith("encoding")}


READERS = {".h5": read_h5, ".hdf5": read_h5, ".mat": read_mat}


def exported(folder: Folder, *args: str, out: str = "model.h5") -> dict[str, Any]:
    path = folder.path / out
    result = folder.run("reduce", "--export", str(path), *args)
    assert result.code == 0, result.stderr
    return READERS[path.suffix](path)


def simulated(folder: Folder, *args: str) -> tuple[np.ndarray, np.ndarray]:
    """S and (F, R) FRFs of ``lrbc simulate``."""
    path = folder.path / "simulated.h5"
    result = folder.run("simulate", "--force", "--out", str(path), "--lines", LINES, *args)
    assert result.code == 0, result.stderr
    records = read_frf(path).records
    return 2j * np.pi * records[0].frequency_hz, np.stack([record.values for record in records], axis=1)


def transfer(tree: dict[str, Any], s: np.ndarray) -> np.ndarray:
    """(F, n_out, n_in) of the exported state space."""
    ss = tree["state_space"]
    E = ss.get("E", np.eye(ss["A"].shape[0]))
    return np.array([ss["C"] @ np.linalg.solve(z * E - ss["A"], ss["B"]) + ss["D"] for z in s])


def off(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest error of a response relative to its largest magnitude."""
    return float(np.max(np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)))


@pytest.mark.parametrize("ending", [".h5", ".hdf5", ".mat"])
@pytest.mark.parametrize("sample", ["box", "frame"])
def test_the_second_order_form_by_its_documented_layout(request: pytest.FixtureRequest, sample: str, ending: str) -> None:
    """From the arrays alone, as the README says it: any parameter value gives the FRFs of ``lrbc simulate``."""
    folder = request.getfixturevalue(sample)
    if sample == "box":
        tree = folder.tree()
        tree["parameters"]["springs"]["damping"] = {"loss_factor": 0.004}
        folder.write(tree)
    tree = exported(folder, out=f"new/model{ending}")
    assert set(tree) == GROUPS
    model, terms = tree["second_order"], tree["terms"]
    group = "left_edge" if sample == "frame" else "springs"
    s, y = simulated(folder, f"--set={group}=3.3", f"--set={group}.damping=1.5")
    count = len(tree["parameters"]["name"])
    k = terms["weights"] @ np.full(count, 10.0**3.3)
    found = []
    for z in s:
        damping = (z * terms["damping_beta"].ravel() + 1j * terms["damping_loss_factor"].ravel()) * 10.0**1.5
        D = (k * (1 + damping) - terms["baseline"].ravel()) * z ** terms["power"].ravel()
        Z = z**2 * model["M"] + z * model["C"] + model["K"] + (terms["left"] * D) @ terms["right"].T
        found.append(z ** model["output_power"].ravel() * (model["L"] @ np.linalg.solve(Z, model["B"]))[:, 0])
    assert off(np.array(found), y) < 1e-8
    assert tree["excitations"]["name"] == ["hammer"]
    assert set(terms["group"]) == {group}
    assert set(terms["kind"]) == {"stiffness"}
    assert tree["parameters"]["name"][0] == f"{group}.1"


def test_the_two_formats_agree(box: Folder) -> None:
    files = [box.path / "a.h5", box.path / "a.mat"]
    options = [part for file in files for part in ("--export", str(file))]
    result = box.run("reduce", *options, "--state-space", "--json")
    assert result.code == 0, result.stderr
    assert [item["file"] for item in result.json["exports"]] == [file.as_posix() for file in files]
    told = result.json["exports"][0]["state_space"]
    assert told["form"] == "explicit"
    assert told["states"] == 2 * result.json["size"]
    assert told["unstable_poles"] == 0
    one, two = read_h5(files[0]), read_mat(files[1])
    assert set(one) == set(two) == GROUPS | {"state_space"}

    def same(a, b):
        if isinstance(a, dict):
            assert set(a) == set(b)
            for name in a:
                same(a[name], b[name])
        elif isinstance(a, str | list):
            assert a == b
        else:
            np.testing.assert_array_equal(np.ravel(a, order="F"), np.ravel(b, order="F"))

    same(one, two)
    assert one["responses"]["name"] == ["mic1", "mic2", "mic3", "acc1"]
    assert one["responses"]["quantity"] == ["pressure"] * 3 + ["acceleration"]
    assert one["responses"]["unit"] == ["Pa"] * 3 + ["m/s²"]
    assert one["responses"]["component"] == ["PRES"] * 3 + ["UZ"]
    assert one["responses"]["node"].tolist() == [103, 112, 124, 7]
    assert one["responses"]["excitation"] == ["hammer"] * 4
    assert one["excitations"] == {
        "name": ["hammer"],
        "quantity": ["force"],
        "unit": ["N"],
        "node": one["excitations"]["node"],
        "component": ["UZ"],
        "place": ["node 8 UZ"],
    }
    reduction = one["reduction"]
    assert reduction["size_structure"] + reduction["size_acoustic"] == reduction["size"] == one["second_order"]["K"].shape[0]
    assert reduction["worst_error"] == result.json["certificate"]["worst"]
    assert one["provenance"]["key"] == result.json["cache"]["key"]
    assert "K.mtx" in one["provenance"]["inputs"]


@pytest.mark.parametrize(
    ("sample", "options"),
    [
        ("box", []),
        ("box", ["--set=springs=3"]),
        ("box", ["--set=springs=-inf"]),
        ("box", ["--set=springs=inf"]),
        ("box", ["--set=springs=inf,2,7,inf,1,4"]),
        ("box", ["--job", "loose"]),
        ("box", ["--job", "loose", "--set=springs=6.5"]),
        ("box", ["--override", "responses.acc1.quantity=velocity"]),
        ("box", ["--override", "parameters.springs.baseline=500.0"]),
        ("box", ["--override", "parameters.springs.initial=auto", "--override", "parameters.springs.bounds=auto"]),
        ("frame", []),
        ("frame", ["--set=left_edge=6", "--set=left_edge.damping=2"]),
        ("frame", ["--set=left_edge=inf"]),
        ("frame", ["--job", "tight"]),
    ],
)
def test_frfs_of_the_state_space_are_those_of_simulate(request: pytest.FixtureRequest, sample: str, options: list[str]) -> None:
    folder = request.getfixturevalue(sample)
    if "--job" in options and sample == "frame":
        options = ["--job", next(path.parent.name for path in sorted(folder.out.glob("*/result.json")))]
    tree = exported(folder, "--state-space", *options)
    s, y = simulated(folder, *options)
    assert off(transfer(tree, s)[:, :, 0], y) < 1e-8
    ss = tree["state_space"]
    assert ss["poles"].real.max() == ss["spectral_abscissa"] < 1e-5
    assert ss["unstable_poles"] == 0
    if options == ["--job", "loose"]:
        assert ss["source"] == "job loose"
        np.testing.assert_allclose(ss["log10"], BOX_TRUTH["loose"], atol=1e-3)


def test_several_excitations_and_shifts(box: Folder) -> None:
    """Every response for every load; derivatives to a shift of the hammer are no loads."""
    tree = box.tree()
    tree["excitation"]["other"] = {"node": 7, "component": "UZ", "scale": 2.0}
    for name in ("mic1", "mic2", "mic3"):
        tree["responses"][name]["excitation"] = "hammer"
    tree["responses"]["acc1"]["excitation"] = "other"
    box.write(tree)
    found = exported(box, "--state-space")
    assert found["second_order"]["B"].shape[1] == found["state_space"]["B"].shape[1] == 2
    assert found["responses"]["excitation"] == ["hammer", "hammer", "hammer", "other"]
    s, y = simulated(box)
    h = transfer(found, s)
    assert off(np.stack([h[:, 0, 0], h[:, 1, 0], h[:, 2, 0], h[:, 3, 1]], axis=1), y) < 1e-8


def test_time_domain(box: Folder) -> None:
    """A short blow marched in time is the inverse transform of the full model's FRFs: pressures and an acceleration."""
    tree = exported(box, "--state-space", "--set=springs=5", out="model.mat")
    ss = tree["state_space"]
    dt, count, centre, peak = 1e-4, 1 << 15, 0.05, 120.0
    t = dt * np.arange(count)
    # No mean and no drift: a sealed cavity keeps its constant pressure for ever.
    a = (np.pi * peak * (t - centre)) ** 2
    u = (1 - 2 * a) * np.exp(-a)
    system = scipy.signal.StateSpace(ss["A"], ss["B"], ss["C"], ss["D"])
    _, y, _ = scipy.signal.lsim(system, u, t)
    spectrum, frequency = np.fft.rfft(u), np.fft.rfftfreq(count, dt)
    used = (frequency > 0.5) & (np.abs(spectrum) > 1e-9 * np.abs(spectrum).max())
    s = 2j * np.pi * frequency[used]
    inputs = box.inputs()
    H = direct_frf(inputs.model, s, np.full((s.size, 6), 1e5 + 0j), inputs.input_of)
    Y = np.zeros((frequency.size, 4), dtype=complex)
    Y[used] = H * spectrum[used, None]
    expected = np.fft.irfft(Y, n=count, axis=0)
    assert frequency[used].max() < 900.0
    for i in range(4):
        assert np.abs(y[:, i] - expected[:, i]).max() < 2e-3 * np.abs(expected[:, i]).max()
        # It rings long after the blow, and has died away at the end.
        assert np.abs(y[2000:, i]).max() > 1e-2 * np.abs(y[:, i]).max()
        assert np.abs(y[-1000:, i]).max() < 2e-3 * np.abs(y[:, i]).max()


def test_hysteretic_damping_has_no_state_space(box: Folder) -> None:
    K = scipy.io.mmread(box.data / "K.mtx", spmatrix=False) * (1 + 0.01j)
    scipy.io.mmwrite(box.data / "K.mtx", K, symmetry="general", precision=17)
    out = box.path / "model.h5"
    box.replace("alpha: 200.0", "alpha: 0.0")
    box.replace("beta: 2.0e-05", "beta: 0.0")
    refused = box.run("reduce", "--export", str(out), "--state-space")
    assert refused.code == 3, refused.stderr
    assert "no real first-order form" in refused.stderr
    assert "export without --state-space" in refused.stderr
    assert not out.exists()
    assert np.iscomplexobj(exported(box)["second_order"]["K"])


@pytest.mark.parametrize("place", ["model.damping", "parameters.springs.damping"])
def test_loss_factors_have_no_state_space(box: Folder, place: str) -> None:
    key = "model.damping.structure.loss_factor=0.02" if place == "model.damping" else f"{place}={{loss_factor: 0.02}}"
    refused = box.run("reduce", "--export", str(box.path / "model.h5"), "--state-space", "--override", key)
    assert refused.code == 3, refused.stderr
    for part in ("no real first-order form", f"a loss factor in {place}", "export without --state-space"):
        assert part in refused.stderr
    assert not (box.path / "model.h5").exists()


def test_a_state_space_that_grows_is_told(box: Folder) -> None:
    # A matrix with a motion of negative stiffness, which no spring holds.
    K = scipy.io.mmread(box.data / "K.mtx", spmatrix=False).toarray()
    K[np.arange(6), np.arange(6)] -= 1e5
    scipy.io.mmwrite(box.data / "K.mtx", sp.coo_array(K), symmetry="general", precision=17)
    result = box.run("reduce", "--export", str(box.path / "m.mat"), "--state-space", "--set=springs=-inf", "--accept-tolerance")
    assert result.code == 0, result.stderr
    assert "right half plane" in result.stderr
    assert read_mat(box.path / "m.mat")["state_space"]["unstable_poles"] > 0


@pytest.mark.parametrize("name", ["m.xlsx", "m", "m.h5.gz", "m.npz"])
def test_unknown_endings(box: Folder, name: str) -> None:
    stamps = box.listing()
    result = box.run("reduce", "--export", str(box.path / "good.h5"), "--export", str(box.path / name))
    assert result.code == 2
    for part in ("--export", "ending", ".h5, .hdf5, .mat", "found:"):
        assert part in result.stderr
    assert box.listing() == stamps


def test_places_that_cannot_be_written(box: Folder) -> None:
    (box.path / "file").write_text("mine")
    (box.path / "folder.h5").mkdir()
    for name, problem in (("file/m.h5", "below a file"), ("folder.h5", "is a folder")):
        result = box.run("reduce", "--export", str(box.path / name))
        assert result.code == 2
        assert problem in result.stderr
        assert "--export" in result.stderr
    assert (box.path / "file").read_text() == "mine"


def test_inputs_are_not_overwritten(box: Folder) -> None:
    K = scipy.io.mmread(box.data / "K.mtx", spmatrix=False)
    scipy.io.savemat(box.data / "K.mat", {"K": K})
    box.replace("data/K.mtx", "data/K.mat")
    before = (box.data / "K.mat").read_bytes()
    result = box.run("reduce", "--export", str(box.data / "K.mat"))
    assert result.code == 2
    assert "this is an input of the campaign" in result.stderr
    assert (box.data / "K.mat").read_bytes() == before


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--state-space"], "--state-space needs --export"),
        (["--export", "m.h5", "--set", "springs=3"], "--set needs --state-space"),
        (["--export", "m.h5", "--job", "loose"], "--job needs --state-space"),
        (["--export", "m.h5", "--state-space", "--set", "spring=3"], "GROUP one of springs"),
        (["--export", "m.h5", "--state-space", "--job", "none"], "no job 'none'"),
    ],
)
def test_options_that_do_not_fit(box: Folder, monkeypatch: pytest.MonkeyPatch, options: list[str], part: str) -> None:
    monkeypatch.chdir(box.path)
    result = box.run("reduce", *options)
    assert result.code == 2
    assert part in result.stderr
    assert not (box.path / "m.h5").exists()


def test_a_dry_run_writes_nothing(box: Folder) -> None:
    stamps = box.listing()
    out = box.path / "new" / "m.mat"
    text = box.run("reduce", "--dry-run", "--export", str(out), "--state-space")
    assert text.code == 0
    assert f"writes {out}" in text.stdout
    assert box.run("reduce", "--dry-run", "--export", str(out), "--json").json["exports"] == [{"file": out.as_posix()}]
    assert box.listing() == stamps


@pytest.mark.parametrize("ending", [".h5", ".mat"])
def test_an_earlier_file_is_replaced_only_by_a_whole_one(box: Folder, monkeypatch: pytest.MonkeyPatch, ending: str) -> None:
    out = box.path / "there" / f"m{ending}"
    exported(box, out=f"there/m{ending}")
    before = out.read_bytes()

    class Full:
        def __enter__(self):
            raise OSError(28, "No space left on device")

        def __exit__(self, *args):
            return None

    with monkeypatch.context() as patch:
        patch.setattr(io_export, "atomic_write", lambda *args: Full())
        failed = box.run("reduce", "--export", str(out), "--state-space")
    assert failed.code == 2
    assert "No space left on device" in failed.stderr
    assert out.read_bytes() == before
    assert "state_space" in exported(box, "--state-space", out=f"there/m{ending}")
    assert [path for path in out.parent.iterdir()] == [out]


@pytest.mark.slow
@pytest.mark.parametrize("value", ["-inf", "2.5", "7", "inf"])
def test_the_soundbox(tmp_path: Path, value: str) -> None:
    config, out = ROOT / "configs" / "soundbox.yaml", tmp_path / "soundbox.mat"
    common = ["--cache", reduced_cache("soundbox"), "--override", f"output={(tmp_path / 'out').as_posix()}", f"--set=left_edge={value}"]
    result = lrbc("reduce", config, *common, "--export", out, "--state-space", "--set=left_edge.damping=2")
    assert result.code == 0, result.stderr
    simulation = tmp_path / "soundbox.h5"
    done = lrbc("simulate", "--force", config, *common, "--set=left_edge.damping=2", "--out", simulation, "--lines", LINES)
    assert done.code == 0, done.stderr
    records = read_frf(simulation).records
    y = np.stack([record.values for record in records], axis=1)
    tree = read_mat(out)
    assert off(transfer(tree, 2j * np.pi * records[0].frequency_hz)[:, :, 0], y) < 1e-8
    assert tree["state_space"]["unstable_poles"] == 0
    assert tree["state_space"]["spectral_abscissa"] < 1e-2
