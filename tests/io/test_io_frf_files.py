"""FRFs in HDF5 and MATLAB files, and the choice of format."""

from __future__ import annotations

import contextlib

import h5py
import numpy as np
import pytest
import scipy.io
from damage import damaged, require_sound
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.frf import TextLayout, detect_frf_format, read_coherence, read_frf, write_frf
from lrbc_cli.io.hdf5.tools import SEAL
from lrbc_cli.model.frf import FrfRecord, FrfSet

REUSE_FOLDER = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
FREQUENCY = np.array([10.0, 10.1, 33.3])
H = np.array([1 - 2j, 3 + 4j, 5e-6 - 6e-6j])


def records():
    first = FrfRecord(
        name="mic01",
        frequency_hz=FREQUENCY,
        values=H,
        quantity="pressure",
        response_node=5,
        reference_node=9,
        reference_direction=3,
        coherence=np.array([0.1, 0.5, 1]),
    )
    return (
        first,
        FrfRecord(name="", frequency_hz=FREQUENCY, values=2 * H, quantity=None, response_direction=2),
        FrfRecord(name="ä", frequency_hz=FREQUENCY, values=-H, quantity="velocity"),
    )


@settings(max_examples=40, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(data=st.data())
def test_hdf5_round_trip(tmp_path, data):
    parts = st.floats(-1e300, 1e300)
    size = data.draw(st.integers(1, 6))
    frequency = np.cumsum(data.draw(st.lists(st.floats(1e-3, 1e3), min_size=size, max_size=size)))
    expected = []
    for _ in range(data.draw(st.integers(1, 4))):
        values = np.array([complex(data.draw(parts), data.draw(parts)) for _ in frequency])
        expected.append(
            FrfRecord(
                name=data.draw(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8)),
                frequency_hz=frequency,
                values=values,
                quantity=data.draw(st.sampled_from(["pressure", "displacement", "velocity", "acceleration", None])),
                response_node=data.draw(st.none() | st.integers(0, 2**40)),
                response_direction=data.draw(st.integers(0, 6)),
                reference_node=data.draw(st.none() | st.integers(0, 2**40)),
                reference_direction=data.draw(st.integers(0, 6)),
                coherence=data.draw(st.none() | st.just(np.linspace(0, 1, size))),
            )
        )
    path = tmp_path / "written.h5"
    write_frf(path, FrfSet(source="x", records=tuple(expected)))
    found = read_frf(path).records
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        for key in ("name", "quantity", "response_node", "response_direction", "reference_node", "reference_direction"):
            assert getattr(a, key) == getattr(b, key)
        for key in ("frequency_hz", "values", "coherence"):
            np.testing.assert_array_equal(getattr(a, key), getattr(b, key))


def test_several_inputs(tmp_path):
    path = tmp_path / "frf.h5"
    write_frf(path, FrfSet(source="x", records=records()))
    with h5py.File(path, "r+") as file:
        values = file["frf"][()]
        for name in ("frf", "reference_node", "reference_direction", "coherence"):
            del file[name]
        file["frf"] = np.concatenate([values, 10 * values], axis=2)
        file["reference_node"], file["reference_direction"] = np.array([7, 8]), np.array([1, 2])
    found = read_frf(path).records
    assert [(r.name, r.reference_node, r.reference_direction) for r in found[:2]] == [("mic01", 7, 1), ("mic01", 8, 2)]
    np.testing.assert_array_equal(found[1].values, 10 * H)


def change(name, value):
    def apply(file):
        if name in file:
            del file[name]
        if value is not None:
            file[name] = value

    return apply


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda file: file.attrs.__setitem__("encoding-version", "7"), "encoding-version 0.1.0"),
        (change("frf", None), "a dataset is missing"),
        (change("frf", np.zeros((2, 3, 1))), "do not fit together"),
        (change("frf", np.full((3, 3, 1), np.nan + 0j)), r"output 1 .mic01., line 1 .10 Hz."),
        (change("frf", np.array([["x"]], dtype=object)), "not numbers|cannot be read"),
        (change("frequency_hz", np.array([1.0, 1.0, 2.0])), "do not increase"),
        (change("frequency_hz", np.array([1.0, np.inf, 2.0])), "a frequency is wrong"),
        (change("name", np.array([1, 2, 3])), "name: the arrays do not fit"),
        (change("quantity", ["loudness", "", ""]), "loudness"),
        (change("response_node", np.array([1.5, 2, 3])), "response_node"),
        (change("coherence", np.full((3, 3, 1), 7.0)), "coherence is wrong"),
        (change("coherence", np.zeros((3, 1))), "do not fit together"),
    ],
)
def test_bad_hdf5(tmp_path, damage, message):
    path = tmp_path / "frf.h5"
    write_frf(path, FrfSet(source="x", records=records()))
    with h5py.File(path, "r+") as file:
        damage(file)
    with pytest.raises(DataError, match=message) as caught:
        read_frf(path)
    assert str(path) in str(caught.value)


def test_coherence_of_hdf5(tmp_path):
    path = tmp_path / "frf.h5"
    write_frf(path, FrfSet(source="x", records=records()))
    found = read_coherence(path)
    assert set(found) == {"mic01", (5, 0)}
    np.testing.assert_array_equal(found["mic01"][1], [0.1, 0.5, 1])


def test_matlab_frequency_in_the_first_column(tmp_path):
    path = tmp_path / "frf.mat"
    scipy.io.savemat(path, {"acc1": np.stack([FREQUENCY, H], axis=1), "two": np.stack([FREQUENCY, H, -H], axis=1), "title": "x", "n": 3.0})
    result = read_frf(path, TextLayout(unit="g/N"))
    assert [r.name for r in result.records] == ["acc1", "two_1", "two_2"]
    np.testing.assert_allclose(result.records[2].values, -9.80665 * H, rtol=1e-15)
    assert result.records[0].quantity == "acceleration"


@pytest.mark.parametrize("axis", ["f", "freq", "my_axis"])
def test_matlab_with_an_axis_of_its_own(tmp_path, axis):
    path = tmp_path / "frf.mat"
    scipy.io.savemat(path, {axis: FREQUENCY, "H": np.stack([H, 2 * H], axis=1), "row": H[None, :]})
    result = read_frf(path, TextLayout(frequency="my_axis") if axis == "my_axis" else None)
    assert [r.name for r in result.records] == ["H_1", "H_2", "row"]
    np.testing.assert_array_equal(result.records[1].values, 2 * H)
    np.testing.assert_array_equal(result.records[2].frequency_hz, FREQUENCY)


def test_bad_matlab(tmp_path):
    path = tmp_path / "frf.mat"
    scipy.io.savemat(path, {"x": 3.0})
    with pytest.raises(DataError, match="no FRF was recognised"):
        read_frf(path)
    scipy.io.savemat(path, {"f": FREQUENCY, "H": np.array([1, np.nan, 2j])[:, None]})
    with pytest.raises(DataError, match="H, row 2"):
        read_frf(path)
    scipy.io.savemat(path, {"f": FREQUENCY[::-1], "H": H[:, None]})
    with pytest.raises(DataError, match="do not increase"):
        read_frf(path)
    with pytest.raises(DataError, match="variable of frequencies was not found"):
        read_frf(path, TextLayout(frequency="omega"))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(DataError, match="cut off"):
        read_frf(path)


def test_format_is_found_by_content(tmp_path):
    frf = FrfSet(source="x", records=(FrfRecord(name="a", frequency_hz=FREQUENCY, values=H, quantity="pressure"),))
    for ending, kind in ((".csv", "text"), (".uff", "uff"), (".unv", "uff"), (".h5", "hdf5"), (".hdf5", "hdf5")):
        write_frf(tmp_path / f"a{ending}", frf)
        (tmp_path / f"a{ending}").rename(tmp_path / "unnamed")
        assert detect_frf_format(tmp_path / "unnamed") == kind
        np.testing.assert_allclose(read_frf(tmp_path / "unnamed").records[0].values, H, rtol=1e-12)
    with pytest.raises(ConfigError, match="ending"):
        write_frf(tmp_path / "a.xls", frf)


def test_file_level_errors(tmp_path):
    with pytest.raises(DataError, match="does not exist"):
        read_frf(tmp_path / "none")
    empty = tmp_path / "empty.uff"
    empty.touch()
    with pytest.raises(DataError, match="is empty"):
        read_frf(empty)
    empty.write_bytes(np.random.default_rng(0).bytes(3000))
    with pytest.raises(DataError, match="binary data"):
        read_frf(empty)


@pytest.fixture(scope="module")
def small_files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("small")
    write_frf(folder / "a.h5", FrfSet(source="x", records=records()))
    scipy.io.savemat(folder / "a.mat", {"f": FREQUENCY, "H": H[:, None]})
    scipy.io.savemat(folder / "b.mat", {"a": np.stack([FREQUENCY, H], axis=1)}, do_compression=True)
    # Without our checksum: as a file of somebody else's.
    return [(folder / name).read_bytes().partition(SEAL)[0] for name in ("a.h5", "a.mat", "b.mat")]


@settings(max_examples=150, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(data=st.data())
def test_damage_gives_a_data_error_or_frfs(tmp_path, small_files, data):
    path = tmp_path / "damaged"
    path.write_bytes(damaged(data, data.draw(st.sampled_from(small_files))))
    with contextlib.suppress(DataError):
        require_sound(read_frf(path).records)
