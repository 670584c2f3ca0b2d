"""The package's own store."""

from __future__ import annotations

import contextlib

import h5py
import numpy as np
import pytest
from damage import damaged
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lrbc_cli.errors import DataError
from lrbc_cli.io.hdf5.store import read_store, write_store
from lrbc_cli.io.hdf5.tools import SEAL, sealed

REUSE_FOLDER = [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
KEYS = st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), min_size=1, max_size=6).filter(
    lambda key: key not in (".", "..")
)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
PLAIN = st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False) | TEXT
DTYPES = st.sampled_from([np.float64, np.float32, np.complex128, np.complex64, np.int64, np.int32, np.uint8, np.bool_])
ARRAYS = hnp.arrays(DTYPES, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))
LEAVES = PLAIN | ARRAYS | st.lists(PLAIN, max_size=4) | st.lists(ARRAYS, max_size=3)
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
    elif isinstance(expected, np.ndarray):
        assert isinstance(found, np.ndarray)
        assert found.shape == expected.shape
        assert found.dtype == expected.dtype
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


@pytest.mark.parametrize(
    "tree", [{"a": object()}, {"a": np.array([object()])}, {"a": np.array(["text"])}, {"a/b": 1}, {"": 1}, {1: 2}, {"a": {"..": 1}}, [1]]
)
def test_what_a_store_cannot_hold_leaves_the_old_file(tmp_path, tree):
    path = tmp_path / "tree.h5"
    write_store(path, {"old": 1})
    with pytest.raises((TypeError, ValueError)):
        write_store(path, tree)
    assert read_store(path) == {"old": 1}
    assert [entry.name for entry in tmp_path.iterdir()] == ["tree.h5"]


def seal_again(path):
    """What nobody does by accident."""
    path.write_bytes(sealed(path.read_bytes()))


def test_texts_have_a_fixed_length(tmp_path):
    """Those of variable length lie on a heap, on which damaged bits send the HDF5 library into an endless loop."""
    path = tmp_path / "tree.h5"
    write_store(path, {"a": {"x": ["one", "two ä"], "n": np.array([])}, "t": "text", "l": [1]})
    variable = []

    def visit(name, node):
        found = [node.attrs.get_id(key).dtype for key in node.attrs] + ([node.dtype] if isinstance(node, h5py.Dataset) else [])
        variable.extend(name for dtype in found if h5py.check_vlen_dtype(dtype) is not None)

    with h5py.File(path) as file:
        visit("/", file)
        file.visititems(visit)
    assert variable == []
    assert b"GCOL" not in path.read_bytes()


def test_only_what_fits_its_checksum_is_opened(tmp_path, monkeypatch):
    path = tmp_path / "tree.h5"
    write_store(path, {"a": np.eye(2)})
    content = path.read_bytes()
    monkeypatch.setattr(h5py, "File", None)
    for at in (0, len(content) // 2, len(content) - len(SEAL) - 66):
        path.write_bytes(content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :])
        with pytest.raises(DataError, match="damaged after it was written"):
            read_store(path)
    for whole in (content[:-1], content + b"x", content.replace(SEAL, SEAL.upper())):
        path.write_bytes(whole)
        with pytest.raises(DataError, match="checksum"):
            read_store(path)


def test_a_part_of_a_tree(tmp_path):
    path = tmp_path / "tree.h5"
    write_store(path, {"a": 1, "b": {"c": "x"}, "d": np.eye(2)})
    assert read_store(path, ("a", "b", "z")) == {"a": 1, "b": {"c": "x"}}


def test_unknown_layouts_are_refused(tmp_path):
    path = tmp_path / "tree.h5"
    write_store(path, {"a": {"x": np.eye(2)}})
    with h5py.File(path, "r+") as file:
        file["a/x"].attrs["encoding-version"] = "0.2.0"
    seal_again(path)
    with pytest.raises(DataError, match=r"a/x.*another layout(.|\n)*0\.2\.0"):
        read_store(path)
    with h5py.File(path, "w") as file:
        file["x"] = 1
    seal_again(path)
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
            {"V": np.arange(12.0).reshape(4, 3) * 1j, "K": np.eye(4), "meta": {"name": "x", "points": [1.5, 2.5]}},
        )
    valid = (tmp_path / "valid.h5").read_bytes()
    content = damaged(data, valid)
    path.write_bytes(content)
    with contextlib.suppress(DataError):
        assert read_store(path)["meta"] == {"name": "x", "points": [1.5, 2.5]}
        assert content == valid
