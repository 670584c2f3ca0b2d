"""The package's own store."""

from __future__ import annotations

import contextlib

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.sparse import csc_array, random_array

from lrbc_cli.errors import DataError
from lrbc_cli.io.store import read_store, write_store

REUSE_FOLDER = [HealthCheck.function_scoped_fixture]
KEYS = st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), min_size=1, max_size=6).filter(
    lambda key: key not in (".", "..")
)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
PLAIN = st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False) | TEXT
DTYPES = st.sampled_from([np.float64, np.float32, np.complex128, np.complex64, np.int64, np.int32, np.uint8, np.bool_])
ARRAYS = hnp.arrays(DTYPES, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))
TEXTS = hnp.arrays(np.dtype("U4"), hnp.array_shapes(min_dims=1, max_dims=2, min_side=0, max_side=3), elements=st.text("abä ", max_size=4))
SPARSE = st.builds(
    lambda rows, columns, seed, factor: csc_array(random_array((rows, columns), density=0.4, rng=np.random.default_rng(seed)) * factor),
    st.integers(0, 6),
    st.integers(0, 6),
    st.integers(0, 99),
    st.sampled_from([1.0, 1 - 2j]),
)
LEAVES = PLAIN | ARRAYS | TEXTS | SPARSE | st.lists(PLAIN, max_size=4) | st.lists(ARRAYS, max_size=3)
TREES = st.dictionaries(
    KEYS,
    st.recursive(LEAVES, lambda inner: st.dictionaries(KEYS, inner, max_size=3) | st.lists(inner, max_size=3), max_leaves=6),
    max_size=4,
)


def assert_same(found, expected):
    if isinstance(expected, dict):
        assert set(found) == set(expected)
        for key, value in expected.items():
            assert_same(found[key], value)
    elif isinstance(expected, list):
        assert len(found) == len(expected)
        for a, b in zip(found, expected, strict=True):
            assert_same(a, b)
    elif isinstance(expected, csc_array):
        assert isinstance(found, csc_array)
        assert found.shape == expected.shape
        np.testing.assert_array_equal(found.toarray(), expected.toarray())
    elif isinstance(expected, np.ndarray):
        assert isinstance(found, np.ndarray)
        assert found.shape == expected.shape
        assert found.dtype == expected.dtype or expected.dtype.kind == "U"
        np.testing.assert_array_equal(found, expected)
    else:
        assert type(found) is type(expected)
        assert found == expected


@settings(max_examples=60, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(tree=TREES)
def test_round_trip(tmp_path, tree):
    write_store(tmp_path / "tree.h5", tree)
    assert_same(read_store(tmp_path / "tree.h5"), tree)


def test_numpy_scalars_tuples_and_specials(tmp_path):
    path = tmp_path / "tree.h5"
    write_store(
        path, {"n": np.int64(3), "x": np.float32(0.5), "b": np.True_, "t": (1, "a"), "z": 1 + 2j, "inf": float("inf"), "nan": float("nan")}
    )
    found = read_store(path)
    assert (found["n"], found["x"], found["b"], found["t"], found["inf"]) == (3, 0.5, True, [1, "a"], float("inf"))
    assert np.isnan(found["nan"])
    assert found["z"] == np.array(1 + 2j)


@pytest.mark.parametrize("tree", [{"a": object()}, {"a": np.array([object()])}, {"a/b": 1}, {"": 1}, {1: 2}, {"a": {"..": 1}}, [1]])
def test_what_a_store_cannot_hold_leaves_the_old_file(tmp_path, tree):
    path = tmp_path / "tree.h5"
    write_store(path, {"old": 1})
    with pytest.raises((TypeError, ValueError)):
        write_store(path, tree)
    assert read_store(path) == {"old": 1}
    assert [entry.name for entry in tmp_path.iterdir()] == ["tree.h5"]


def test_unknown_layouts_are_refused(tmp_path):
    path = tmp_path / "tree.h5"
    write_store(path, {"a": {"x": np.eye(2)}, "k": csc_array(np.eye(3))})
    with h5py.File(path, "r+") as file:
        file["a/x"].attrs["encoding-version"] = "0.2.0"
    with pytest.raises(DataError, match=r"a/x.*another layout(.|\n)*0\.2\.0"):
        read_store(path)
    with h5py.File(path, "r+") as file:
        file["a/x"].attrs["encoding-version"] = "0.1.0"
        file["k/indices"][0] = 7
    with pytest.raises(DataError, match="k: a sparse matrix in the store is damaged"):
        read_store(path)
    with h5py.File(path, "w") as file:
        file["x"] = 1
    with pytest.raises(DataError, match="not a store"):
        read_store(path)
    path.write_text("no HDF5")
    with pytest.raises(DataError, match="cannot be read"):
        read_store(path)


@settings(max_examples=80, deadline=None, suppress_health_check=REUSE_FOLDER)
@given(data=st.data())
def test_damage_gives_a_data_error_or_a_tree(tmp_path, data):
    path = tmp_path / "tree.h5"
    if not path.exists():
        write_store(
            tmp_path / "valid.h5",
            {"V": np.arange(12.0).reshape(4, 3) * 1j, "K": csc_array(np.eye(4)), "meta": {"name": "x", "points": [1.5, 2.5]}},
        )
    content = bytearray((tmp_path / "valid.h5").read_bytes())
    for _ in range(data.draw(st.integers(0, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content)))]
    path.write_bytes(bytes(content))
    with contextlib.suppress(DataError):
        assert isinstance(read_store(path), dict)
