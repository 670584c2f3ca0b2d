"""Matrices from every format, and what is said when a file is wrong."""

from __future__ import annotations

import contextlib
import gzip
import io
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from matrix_files import write_matrix_hdf5
from scipy.sparse import coo_array, csc_array, csr_array, random_array, save_npz

from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.io.hdf5 import tools
from lrbc_cli.io.hdf5.tools import SEAL
from lrbc_cli.io.matrices import columns
from lrbc_cli.io.matrices.read import FORMATS, detect_format, read_matrix, read_vectors
from lrbc_cli.io.sparse import stored_triangle

DATA = Path(__file__).parents[1] / "data"
REUSE_FOLDER = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def example(n=30, complex_values=False, seed=1):
    """Unsymmetric matrix with an empty row and column."""
    generator = np.random.default_rng(seed)
    matrix = random_array((n, n), density=0.1, rng=generator, format="lil")
    if complex_values:
        matrix = (matrix + 1j * random_array((n, n), density=0.1, rng=generator)).tolil()
    matrix[n // 2, :] = 0
    matrix[:, n // 2] = 0
    return csc_array(matrix)


def assert_canonical(matrix):
    assert isinstance(matrix, csc_array)
    assert matrix.dtype in (np.float64, np.complex128)
    assert matrix.has_sorted_indices
    assert matrix.has_canonical_format
    assert np.all(matrix.data != 0)


def write_mat73(path, name, matrix):
    """A file as MATLAB 7.3 lays it out, userblock and all."""
    with h5py.File(path, "w", userblock_size=512) as file:
        sparse = csc_array(matrix)
        group = file.create_group(name)
        group.attrs["MATLAB_class"] = np.bytes_("double")
        group.attrs["MATLAB_sparse"] = np.uint64(sparse.shape[0])
        group["jc"] = sparse.indptr.astype(np.uint64)
        if sparse.nnz:
            data = sparse.data
            if np.iscomplexobj(data):
                compound = np.empty(data.size, dtype=[("real", "f8"), ("imag", "f8")])
                compound["real"], compound["imag"] = data.real, data.imag
                data = compound
            group["data"], group["ir"] = data, sparse.indices.astype(np.uint64)
        dense = file.create_dataset("rows", data=np.arange(6.0).reshape(3, 2))
        dense.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan  1 00:00:00 2024 HDF5 schema 1.00 .")


def write_example(kind, path, matrix):
    if kind == "matrix-market":
        with path.open("wb") as stream:
            scipy.io.mmwrite(stream, matrix, symmetry="general", precision=17)
    elif kind == "matrix-market.gz":
        plain = io.BytesIO()
        scipy.io.mmwrite(plain, matrix, symmetry="general", precision=17)
        path.write_bytes(gzip.compress(plain.getvalue()))
    elif kind == "hdf5":
        write_matrix_hdf5(path, {"K": matrix})
    elif kind == "mat-v7.3":
        write_mat73(path, "K", matrix)
    elif kind == "mat-v5":
        scipy.io.savemat(path, {"K": matrix}, do_compression=True, appendmat=False)
    elif kind in ("npz", "npz-coo"):
        with path.open("wb") as stream:
            save_npz(stream, matrix.tocsr() if kind == "npz" else matrix.tocoo())


KINDS = ("matrix-market", "matrix-market.gz", "hdf5", "mat-v7.3", "mat-v5", "npz", "npz-coo")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("complex_values", [False, True])
def test_every_format_by_content(tmp_path, kind, complex_values):
    path = tmp_path / "matrix.dat"
    expected = example(complex_values=complex_values)
    write_example(kind, path, expected)
    group = "K" if kind in ("hdf5", "mat-v7.3", "mat-v5") else None
    found = read_matrix(path, group)
    assert_canonical(found.matrix)
    assert found.format == kind.removesuffix(".gz").removesuffix("-coo")
    assert found.matrix.shape == expected.shape
    assert found.matrix.dtype == expected.dtype
    assert abs(found.matrix - expected).max() == 0
    assert abs(read_matrix(path, group, found.format).matrix - expected).max() == 0


@REUSE_FOLDER
@given(
    rows=st.integers(1, 12),
    columns=st.integers(1, 12),
    density=st.floats(0, 1),
    seed=st.integers(0, 2**31),
    complex_values=st.booleans(),
    kind=st.sampled_from(KINDS),
)
def test_round_trip(tmp_path, rows, columns, density, seed, complex_values, kind):
    generator = np.random.default_rng(seed)
    expected = random_array((rows, columns), density=density, rng=generator, format="csc")
    if complex_values:
        expected = csc_array(expected * (1.0 - 2.0j))
    path = tmp_path / "matrix"
    write_example(kind, path, expected)
    found = read_vectors(path, "K" if kind in ("hdf5", "mat-v7.3", "mat-v5") else None)
    assert_canonical(found.matrix)
    assert found.matrix.shape == expected.shape
    np.testing.assert_array_equal(found.matrix.toarray(), expected.toarray())


def test_files_of_others():
    foundation = DATA / "nlevp" / "foundation.mat"
    stiffness, mass, damping = (read_matrix(foundation, name) for name in ("K", "M", "D"))
    assert stiffness.matrix.shape == (3627, 3627)
    assert stiffness.matrix.nnz == 201_121
    assert stiffness.matrix.dtype == np.complex128
    assert mass.matrix.dtype == np.float64
    assert mass.matrix.nnz == 3627
    assert damping.matrix.nnz == 211
    speaker = DATA / "nlevp" / "speaker_box.mat"
    a, b, c = (read_matrix(speaker, name) for name in "ABC")
    assert a.notes == ("'A' is stored dense",)
    for matrix in (a.matrix, b.matrix, c.matrix):
        assert matrix.shape == (107, 107)
        assert abs(matrix - matrix.T).max() <= 1e-12 * abs(matrix).max()
    reference = scipy.io.loadmat(speaker, spmatrix=False)
    np.testing.assert_array_equal(c.matrix.toarray(), reference["C"])


BANNERS = {
    "general": ([(1, 1, "2"), (2, 1, "3"), (1, 2, "4")], [[2, 4], [3, 0]]),
    "symmetric": ([(1, 1, "2"), (2, 1, "3")], [[2, 3], [3, 0]]),
    "skew-symmetric": ([(2, 1, "3")], [[0, -3], [3, 0]]),
}


@pytest.mark.parametrize("symmetry", BANNERS)
@pytest.mark.parametrize("field", ["real", "integer"])
def test_banner_is_honoured(tmp_path, symmetry, field):
    entries, expected = BANNERS[symmetry]
    path = tmp_path / "k.mtx"
    lines = "".join(f"{i} {j} {v}\n" for i, j, v in entries)
    path.write_text(f"%%MatrixMarket matrix coordinate {field} {symmetry}\n% a comment\n\n2 2 {len(entries)}\n{lines}")
    result = read_matrix(path)
    np.testing.assert_array_equal(result.matrix.toarray(), expected)
    assert any("filled in" in note for note in result.notes) == (symmetry != "general")


def test_hermitian_array_and_duplicates(tmp_path):
    path = tmp_path / "k.mtx"
    path.write_text("%%MatrixMarket matrix coordinate complex hermitian\n2 2 2\n1 1 2 0\n2 1 3 4\n")
    np.testing.assert_array_equal(read_matrix(path).matrix.toarray(), [[2, 3 - 4j], [3 + 4j, 0]])
    path.write_text("%%MatrixMarket matrix array real general\n2 3\n1\n2\n3\n4\n5\n6\n")
    np.testing.assert_array_equal(read_vectors(path).matrix.toarray(), [[1, 3, 5], [2, 4, 6]])
    path.write_text("%%MatrixMarket matrix array real symmetric\n2 2\n1\n2\n3\n")
    np.testing.assert_array_equal(read_matrix(path).matrix.toarray(), [[1, 2], [2, 3]])
    path.write_text("%%MatrixMarket matrix coordinate real general\n2 2 4\n1 1 1\n1 1 2\n1 2 1\n1 2 -1\n")
    matrix = read_matrix(path).matrix
    assert matrix.nnz == 1
    assert matrix[0, 0] == 3


def test_triangles_are_told_field_by_field():
    full = np.array([[2.0, 1, 0, 5], [1, 2, 0, 0], [0, 0, 3, 1], [0, 0, 1, 3]])
    field = np.array([0, 0, 1, 1])
    for matrix, plain, by_field in (
        (full, None, None),
        (np.triu(full), "upper", "upper"),
        (np.tril(full), "lower", "lower"),
        # Coupling alone is no half of anything; one field's half is, whatever the coupling.
        (np.diag(np.diag(full)) + 5 * np.eye(4, k=3), "upper", None),
        (full - np.tril(full, -1) + np.eye(4, k=-1) * [1, 0, 0, 0], None, "upper"),
        (np.diag(np.diag(full)), None, None),
    ):
        found = csc_array(matrix)
        assert stored_triangle(found) == plain
        assert stored_triangle(found, field) == by_field
    order = np.array([2, 0, 3, 1])
    assert stored_triangle(csc_array(np.tril(full)[np.ix_(order, order)]), field[order]) is not None


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ("1 1 2\n2 1 3\n1 2 3\n", "both triangles"),
        # Some pairs only: no longer the half of all entries.
        ("1 1 2\n2 1 3\n1 2 3\n3 1 4\n3 2 5\n", "both triangles(.|\n)*row 2, column 1"),
        ("1 1 2\n2 1 3\n3 1 4\n2 1 3\n", "row 2, column 1: an entry is given twice"),
        ("1 1 2\n2 1 3\n1 1 2\n", "row 1, column 1: an entry is given twice"),
    ],
)
@pytest.mark.parametrize("symmetry", ["symmetric", "hermitian"])
def test_entries_that_would_count_twice_are_refused(tmp_path, symmetry, entries, said):
    path = tmp_path / "k.mtx"
    path.write_text(f"%%MatrixMarket matrix coordinate real {symmetry}\n3 3 {len(entries.splitlines())}\n{entries}")
    with pytest.raises(DataError, match=said):
        read_matrix(path)


def test_one_triangle_or_the_other_entry_by_entry(tmp_path):
    path = tmp_path / "k.mtx"
    path.write_text("%%MatrixMarket matrix coordinate real symmetric\n3 3 3\n1 1 2\n2 1 3\n1 3 4\n")
    np.testing.assert_array_equal(read_matrix(path).matrix.toarray(), [[2, 3, 4], [3, 0, 0], [4, 0, 0]])


def test_doubles_of_a_general_file_are_told(tmp_path):
    path = tmp_path / "k.mtx"
    path.write_text("%%MatrixMarket matrix coordinate real general\n2 2 5\n1 1 1\n1 1 2\n1 2 1\n1 2 -1\n2 2 0\n")
    (warning,) = read_matrix(path).warnings
    assert warning.startswith("k.mtx: 2 of 5 entries have the row and column of an earlier entry")
    path.write_text("%%MatrixMarket matrix coordinate real general\n2 2 3\n1 1 1\n1 2 0\n2 1 4\n")
    assert read_matrix(path).warnings == ()


@pytest.mark.parametrize("chunk", [1, 7, 2**24])
def test_an_entry_has_a_line_of_its_own(tmp_path, monkeypatch, chunk):
    monkeypatch.setattr(columns, "_CHUNK", chunk)
    path = tmp_path / "k.mtx"
    banner = "%%MatrixMarket matrix coordinate real general\n2 2 3\n"
    path.write_text(banner + " 1 1 2.0 \n\n\t2  1 3\r\n2 2 4\n")
    np.testing.assert_array_equal(read_matrix(path).matrix.toarray(), [[2, 0], [3, 4]])
    # A number lost and one too many elsewhere: as many as there should be.
    for entries, line in (("1 1 2\n2 1\n1 2 2 4\n", 4), ("1 1 2 2 1 3\n2 2 4\n", 3), ("1 1\n2\n2 1 3\n2 2 4\n", 3)):
        path.write_text(banner + entries)
        with pytest.raises(DataError, match=f"line {line}: an entry cannot be read"):
            read_matrix(path)


def test_a_last_line_without_an_end_is_told(tmp_path):
    path = tmp_path / "k.mtx"
    path.write_text("%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 2.5")
    (warning,) = read_matrix(path).warnings
    assert "the last line has no line break" in warning
    path.with_suffix(".gz").write_bytes(gzip.compress(path.read_bytes()))
    assert read_matrix(path.with_suffix(".gz")).warnings == ()


def test_hdf5_layouts(tmp_path):
    path = tmp_path / "m.h5"
    expected = example()
    rows = csr_array(expected)
    with h5py.File(path, "w") as file:
        for name, kind, matrix in (("csr", "csr", rows), ("csc", "csc", expected)):
            group = file.create_group(f"model/{name}")
            group.attrs["h5sparse_format"], group.attrs["h5sparse_shape"] = kind, matrix.shape
            for key in ("data", "indices", "indptr"):
                group[key] = getattr(matrix, key)
        file["dense"] = expected.toarray()
        file["model/text"] = "not a matrix"
    for name in ("model/csr", "model/csc", "dense"):
        np.testing.assert_array_equal(read_matrix(path, name).matrix.toarray(), expected.toarray())
    with pytest.raises(DataError, match=r"dense, model/csc, model/csr"):
        read_matrix(path)
    with pytest.raises(DataError, match=r"dense, model/csc, model/csr"):
        read_matrix(path, "K")
    with pytest.raises(DataError, match="not a matrix that can be read"):
        read_matrix(path, "model")
    with pytest.raises(DataError, match="not a matrix that can be read"):
        read_matrix(path, "model/text")


def test_the_only_matrix_is_taken_and_noted(tmp_path):
    write_matrix_hdf5(tmp_path / "k.h5", {"K": example()})
    assert read_matrix(tmp_path / "k.h5").notes == ("using 'K', the only matrix in the file",)
    scipy.io.savemat(tmp_path / "k.mat", {"K": example(), "title": "a text"})
    assert "using 'K', the only matrix in the file" in read_matrix(tmp_path / "k.mat").notes


def test_matlab_stores_dense_arrays_transposed(tmp_path):
    write_mat73(tmp_path / "k.mat", "K", example())
    np.testing.assert_array_equal(read_vectors(tmp_path / "k.mat", "rows").matrix.toarray(), np.arange(6.0).reshape(3, 2).T)


def test_links_into_other_files_are_refused(tmp_path):
    write_matrix_hdf5(tmp_path / "secret.h5", {"K": example()})
    with h5py.File(tmp_path / "m.h5", "w") as file:
        file["K"] = h5py.ExternalLink("secret.h5", "/K")
        file.create_group("empty")
        file["through"] = h5py.SoftLink("/K")
        file["empty/up"] = h5py.SoftLink("deep/data")
        file["empty/deep"] = h5py.ExternalLink("secret.h5", "/K")
    for name in ("K", "through", "through/data", "empty/up"):
        with pytest.raises(DataError, match="another file"):
            read_matrix(tmp_path / "m.h5", name)
    with pytest.raises(DataError, match="contains no matrix"):
        read_matrix(tmp_path / "m.h5")


def test_links_inside_the_file(tmp_path):
    write_matrix_hdf5(tmp_path / "m.h5", {"a/K": example()})
    with h5py.File(tmp_path / "m.h5", "r+") as file:
        file["a/soft"] = h5py.SoftLink("./K")
        file["absolute"] = h5py.SoftLink("/a/soft")
        file["hard"] = file["a/K"]
        file["nowhere"] = h5py.SoftLink("/gone")
        file["self"] = h5py.SoftLink("/self")
        file["one"], file["two"] = h5py.SoftLink("/two/x"), h5py.SoftLink("/one/x")
    for name in ("a/soft", "absolute", "hard"):
        np.testing.assert_array_equal(read_matrix(tmp_path / "m.h5", name).matrix.toarray(), example().toarray())
    with pytest.raises(DataError, match="no such matrix"):
        read_matrix(tmp_path / "m.h5", "nowhere")
    for name in ("self", "one"):
        with pytest.raises(DataError, match="circle"):
            read_matrix(tmp_path / "m.h5", name)


def test_unknown_encoding_version(tmp_path):
    write_matrix_hdf5(tmp_path / "k.h5", {"K": example()})
    with h5py.File(tmp_path / "k.h5", "r+") as file:
        file["K"].attrs["encoding-version"] = "9.0"
    with pytest.raises(DataError, match=r"9\.0"):
        read_matrix(tmp_path / "k.h5")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"indices": np.array([0, 1, 7])}, "outside the matrix"),
        ({"indices": np.array([0, -1, 1])}, "outside the matrix"),
        ({"indices": np.array([0.5, 1, 1])}, "list of integers"),
        ({"indptr": np.array([0, 2, 1, 3])}, "does not ascend"),
        ({"indptr": np.array([1, 1, 2, 3])}, "does not ascend"),
        ({"indptr": np.array([0, 3])}, "wrong length"),
        ({"indptr": np.array([0, 1, 2, 4])}, "differ in length"),
        ({"data": np.array([1.0, 2.0])}, "differ in length"),
        ({"data": np.array([1.0, np.nan, 2.0])}, r"row 1, column 1 .counted from 0"),
        ({"data": np.array([1.0, 2.0, np.inf])}, r"row 2, column 2"),
        ({"shape": np.array([3, 10**12])}, "do not fit the file"),
        ({"shape": np.array([-3, 3])}, "not a matrix"),
        ({"shape": np.array([3, 3, 3])}, "not complete"),
    ],
)
def test_bad_compressed_arrays(tmp_path, change, message):
    parts = {"data": np.array([1.0, 2.0, 3.0]), "indices": np.array([0, 1, 2]), "indptr": np.array([0, 1, 2, 3]), "shape": np.array([3, 3])}
    parts |= change
    path = tmp_path / "k.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("K")
        group.attrs["encoding-type"], group.attrs["encoding-version"], group.attrs["shape"] = "csc_matrix", "0.1.0", parts["shape"]
        for key in ("data", "indices", "indptr"):
            group[key] = parts[key]
    with pytest.raises(DataError, match=message) as caught:
        read_matrix(path, "K")
    assert str(path) in str(caught.value)
    if parts["shape"].size == 2:
        np.savez(tmp_path / "k.npz", format=np.array(b"csc"), **parts)
        with pytest.raises(DataError, match=message):
            read_matrix(tmp_path / "k.npz")


MARKET = "%%MatrixMarket matrix coordinate real general\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("%%MatrixMarket matrix coordinate pattern general\n1 1 1\n1 1\n", "only a pattern"),
        ("%%MatrixMarket matrix coordinate real strange\n1 1 1\n1 1 1\n", "an unknown word"),
        ("%%MatrixMarket vector coordinate real general\n1 1 1\n1 1 1\n", "an unknown word"),
        ("%%MatrixMarket matrix coordinate real symmetric\n1 2 1\n1 1 1\n", "must be square"),
        (MARKET, "size line is missing"),
        (MARKET + "2 2\n", "size line is wrong"),
        (MARKET + "2 -2 1\n1 1 1\n", "size line is wrong"),
        (MARKET + "2 2 1000000000000\n1 1 1\n", "more data than the file contains"),
        (MARKET + "1000000000000 1000000000000 1\n1 1 1\n", "do not fit the file"),
        ("%%MatrixMarket matrix array real general\n1000000 1000000\n1\n", "more data than the file contains"),
        (MARKET + "2 2 2\n1 1 1\n", "line 3: the file ends early(.|\n)*2 entries(.|\n)*copy it again"),
        (MARKET + "2 2 1\n1 1 1\n1 2 2\n", "number of entries"),
        (MARKET + "2 2 1\n1 1 1e", "line 3"),
        (MARKET + "2 2 1\n1.5 1 1\n", "line 3"),
        (MARKET + "2 2 1\n3 1 1\n", "line 3"),
        (MARKET + "2 2 1\n0 1 1\n", "line 3"),
        (MARKET + "2 2 1\n1 1 x\n", "line 3"),
        (MARKET + "2 2 1\n1 1 nan\n", "row 0, column 0"),
        (MARKET + "2 2 1\n1 2 inf\n", "row 0, column 1"),
        (MARKET + "2 3 1\n1 2 1\n", "not square"),
        ("** Abaqus\n*MATRIX ASSEMBLE, STIFFNESS=K\n", "an input file of Abaqus"),
        ("hello\n", "not known"),
        ("\n\n", "not known"),
    ],
)
def test_bad_text(tmp_path, text, message):
    path = tmp_path / "k.mtx"
    path.write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        read_matrix(path)
    assert str(path) in str(caught.value)
    path.write_bytes(gzip.compress(text.encode()))
    with pytest.raises(DataError, match=message):
        read_matrix(path)


def test_file_level_errors(tmp_path):
    with pytest.raises(DataError, match="does not exist"):
        read_matrix(tmp_path / "none.mtx")
    with pytest.raises(DataError, match="not a file"):
        read_matrix(tmp_path)
    empty = tmp_path / "empty.mtx"
    empty.touch()
    with pytest.raises(DataError, match="is empty"):
        read_matrix(empty)
    garbage = tmp_path / "garbage.mat"
    garbage.write_bytes(np.random.default_rng(0).bytes(2000))
    with pytest.raises(DataError, match="binary data"):
        read_matrix(garbage)
    for kind in FORMATS:
        with pytest.raises(DataError):
            read_matrix(garbage, format=kind)
    with pytest.raises(ConfigError, match="format is not known"):
        read_matrix(garbage, format="xls")
    write_matrix_hdf5(tmp_path / "k.h5", {"K": example()})
    scipy.io.mmwrite(tmp_path / "k.mtx", example())
    with pytest.raises(DataError, match="#K"):
        read_matrix(tmp_path / "k.mtx", "K")


def test_pickles_are_never_loaded(tmp_path):
    path = tmp_path / "k.npz"
    np.savez(path, K=np.array([[1, "a"], [None, 2]], dtype=object))
    with pytest.raises(DataError, match="Python objects"):
        read_matrix(path)


def test_npz_of_dense_arrays(tmp_path):
    path = tmp_path / "b.npz"
    np.savez(path, left=np.eye(3), right=np.arange(3))
    np.testing.assert_array_equal(read_vectors(path, "left").matrix.toarray(), np.eye(3))
    assert read_vectors(path, "right").matrix.shape == (3, 1)
    with pytest.raises(DataError, match="left, right"):
        read_vectors(path)
    with pytest.raises(DataError, match="left, right"):
        read_vectors(path, "middle")


def test_detection(tmp_path):
    for kind in KINDS:
        path = tmp_path / "any.bin"
        write_example(kind, path, example())
        assert detect_format(path) == kind.removesuffix(".gz").removesuffix("-coo")


def test_coo_bounds(tmp_path):
    path = tmp_path / "k.npz"
    np.savez(path, format=np.array(b"coo"), shape=np.array([2, 2]), data=np.ones(1), row=np.array([2]), col=np.array([0]))
    with pytest.raises(DataError, match="row index lies outside"):
        read_matrix(path)
    assert coo_array((2, 2)).shape == (2, 2)


@pytest.fixture(scope="module")
def small_files(tmp_path_factory):
    """One small valid file of each format."""
    folder = tmp_path_factory.mktemp("small")
    for kind in KINDS:
        write_example(kind, folder / kind, example(6, complex_values=kind in ("mat-v7.3", "hdf5"), seed=3))
    # Without our checksum: as a file of somebody else's.
    return {kind: (folder / kind).read_bytes().partition(SEAL)[0] for kind in KINDS}


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_damage_gives_a_data_error_or_a_matrix(tmp_path, small_files, data):
    kind = data.draw(st.sampled_from(KINDS), label="file")
    damaged = bytearray(small_files[kind])
    for _ in range(data.draw(st.integers(0, 4), label="flips")):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans(), label="cut"):
        damaged = damaged[: data.draw(st.integers(0, len(damaged)))]
    path = tmp_path / "damaged"
    path.write_bytes(bytes(damaged))
    group = "K" if kind in ("hdf5", "mat-v7.3", "mat-v5") else None
    for selected in (None, kind.removesuffix(".gz").removesuffix("-coo")):
        with contextlib.suppress(DataError):
            result = read_vectors(path, group, selected)
            assert_canonical(result.matrix)
            assert np.all(np.isfinite(result.matrix.data))


def test_hdf5_files_that_were_read_before_are_read_at_once(tmp_path, monkeypatch):
    """Bytes that the library came through do not hang it; others go to the process apart, as ever."""
    path, matrix = tmp_path / "m.h5", example()
    write_mat73(path, "K", matrix)
    apart = []
    monkeypatch.setattr(tools, "read_apart", lambda reader, *arguments: apart.append(arguments[0]) or reader(*arguments))
    monkeypatch.setattr(tools, "_KNOWN", set())
    tools.came_through(["0" * 64])
    assert (read_matrix(path, group="K").matrix != matrix).nnz == 0
    assert apart == [path]
    tools.came_through([file_hash(path)])
    assert (read_matrix(path, group="K").matrix != matrix).nnz == 0
    assert apart == [path]
    path.write_bytes(path.read_bytes() + b"\0")
    read_matrix(path, group="K")
    assert apart == [path, path]
