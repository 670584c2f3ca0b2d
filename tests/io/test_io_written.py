"""Models from files that other programs wrote: natural frequencies as those programs state them."""

from __future__ import annotations

import gzip
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse as sp

from lrbc_cli.campaign.reading.model_doubts import fixed_dofs
from lrbc_cli.errors import DataError
from lrbc_cli.io.matrices.read import read_matrix
from lrbc_cli.io.text.dof_maps import read_dof_map

DATA = Path(__file__).parents[1] / "data"
BLOCK = DATA / "block"


def frequencies(K: Any, M: Any, first: int, last: int) -> Any:
    """Some of them [Hz], of the DOFs with stiffness."""
    free = np.flatnonzero(abs(K).sum(axis=0))
    stiffness, mass = (A.toarray()[np.ix_(free, free)] for A in (K, M))
    shift = 1e-6 * stiffness.trace() / mass.trace()
    # With a share of the mass the stiffness of a free body is regular, and the mass may be singular.
    values = 1.0 / scipy.linalg.eigh(mass, stiffness + shift * mass, eigvals_only=True)[::-1][first:last] - shift
    return np.sqrt(values) / (2 * np.pi)


def stated() -> Any:
    """Frequencies of a clamped block of three elements, from the output of CalculiX."""
    return [float(line.split()[3]) for line in (BLOCK / "block.dat").read_text().splitlines()[7:11]]


@pytest.mark.parametrize(
    ("files", "kind"),
    [
        (("block.sti.gz", "block.mas.gz"), "triplets"),
        (("matio_v5.mat#K", "matio_v5.mat#M"), "mat-v5"),
        (("matio_v73.mat#K", "matio_v73.mat#M"), "mat-v7.3"),
        (("hdf5storage.mat#K", "hdf5storage.mat#M"), "mat-v7.3"),
        (("anndata.h5#K", "anndata.h5#M"), "hdf5"),
        (("h5sparse.h5#K", "h5sparse.h5#M"), "hdf5"),
        (("pyyeti_dense_ascii.op4.gz#KGG", "pyyeti_dense_ascii.op4.gz#MGG"), "nastran-op4"),
        (("pyyeti_bigmat_ascii.op4.gz#KGG", "pyyeti_bigmat_ascii.op4.gz#MGG"), "nastran-op4"),
        (("pyyeti_dense_binary.op4#KGG", "pyyeti_dense_binary.op4#MGG"), "nastran-op4"),
        (("pyyeti_nonbigmat_binary.op4#KGG", "pyyeti_nonbigmat_binary.op4#MGG"), "nastran-op4"),
        (("pynastran.op4.gz#KGG", "pynastran.op4.gz#MGG"), "nastran-op4"),
        (("pynastran.bdf.gz#KAAX", "pynastran.bdf.gz#MAAX"), "nastran-dmig"),
        (("sparskit_K.rsa.gz", "sparskit_M.rsa.gz"), "harwell-boeing"),
        (("rbio_K.rb.gz", "rbio_M.rb.gz"), "harwell-boeing"),
    ],
    ids=lambda value: value[0].partition("#")[0] if isinstance(value, tuple) else value,
)
def test_a_block_of_calculix_from_every_library(files: tuple[str, str], kind: str) -> None:
    found = []
    for file in files:
        name, _, group = file.partition("#")
        found.append(read_matrix(BLOCK / name, group or None))
    assert {one.format for one in found} == {kind}
    np.testing.assert_allclose(frequencies(*(one.matrix for one in found), 0, 4), stated(), rtol=1e-6)


def write(way: str, path: Path, name: str, matrix: Any) -> str | None:
    """The matrix written by SciPy or h5py; the group to read."""
    if way.startswith("matrix-market"):
        _, kind, packed = way.split()
        with gzip.open(path, "wb") if packed == "gz" else path.open("wb") as stream:
            scipy.io.mmwrite(
                stream, matrix.toarray() if kind == "array" else matrix, symmetry=None if kind == "array" else kind, precision=17
            )
        return None
    if way.startswith("mat-v5"):
        scipy.io.savemat(path, {name: matrix.toarray() if "dense" in way else matrix}, do_compression="packed" in way, appendmat=False)
        return name
    if way.startswith("npz"):
        with path.open("wb") as stream:
            sp.save_npz(stream, getattr(matrix, f"to{way[4:]}")())
        return None
    if way == "harwell-boeing":
        with path.open("w") as stream:
            scipy.io.hb_write(stream, sp.csc_matrix(matrix))
        return None
    with h5py.File(path, "w") as file:
        file[f"model/{name}"] = matrix.toarray()
    return f"model/{name}"


@pytest.mark.parametrize(
    "way",
    [
        *("matrix-market general plain", "matrix-market symmetric plain", "matrix-market symmetric gz", "matrix-market array plain"),
        *("mat-v5 sparse", "mat-v5 packed", "mat-v5 dense", "npz csr", "npz csc", "npz coo", "harwell-boeing", "hdf5 dense"),
    ],
)
def test_the_same_as_scipy_and_h5py_write_it(tmp_path: Path, way: str) -> None:
    found = []
    for name, ending in (("K", "sti"), ("M", "mas")):
        path = tmp_path / name
        group = write(way, path, name, read_matrix(BLOCK / f"block.{ending}.gz").matrix)
        found.append(read_matrix(path, group))
    assert found[0].format == way.split()[0]
    np.testing.assert_allclose(frequencies(found[0].matrix, found[1].matrix, 0, 4), stated(), rtol=1e-6)


def test_op4_of_nastran_in_single_precision(tmp_path: Path) -> None:
    """A superelement: matrices and frequencies as pyYeti 1.4.7 reads them; six rigid motions, 15 DOFs without stiffness and mass."""
    path = tmp_path / "se.op4"
    path.write_bytes(gzip.decompress((DATA / "nastran" / "se_test_n11.op4.gz").read_bytes()))
    K, M = read_matrix(path, "KAA").matrix, read_matrix(path, "MAA").matrix
    assert K.shape == (105, 105)
    np.testing.assert_allclose(frequencies(K, M, 6, 9), [113.131211, 117.038021, 191.489288], rtol=1e-6)


def test_dmig_as_nastran_punches_it() -> None:
    """Frequencies as pyNastran 1.4.1 reads that file; one rigid motion."""
    path = DATA / "nastran" / "dmig.pch"
    K, M = read_matrix(path, "KAAX").matrix, read_matrix(path, "MAAX").matrix
    expected = np.sqrt([4.21669660e01, 1.79226426e02, 3.35052010e02, 1.08371590e04]) / (2 * np.pi)
    np.testing.assert_allclose(frequencies(K, M, 1, 5), expected, rtol=1e-6)


def ansys(path: Path, group: str) -> Any:
    """A matrix of a .full file; without the extra that reads it, the message that names the extra."""
    try:
        import ansys.mapdl.reader  # noqa: F401
    except ImportError:
        with pytest.raises(DataError, match=re.escape("pip install lrbc[ansys]")):
            read_matrix(path, group)
        pytest.skip("the extra [ansys] is not installed")
    return read_matrix(path, group)


def test_a_full_file_with_fixed_dofs(tmp_path: Path) -> None:
    """63 DOFs are fixed: rows of zeros."""
    path = tmp_path / "file.full"
    path.write_bytes(gzip.decompress((DATA / "ansys" / "file.full.gz").read_bytes()))
    K, M = ansys(path, "K").matrix, ansys(path, "M").matrix
    assert K.shape == (963, 963)
    assert int((abs(K).sum(axis=0) == 0).sum()) == 63
    np.testing.assert_allclose(frequencies(K, M, 0, 4), [1283.200, 1283.200, 5781.975, 6919.399], rtol=1e-6)


def test_matrix_market_of_ansys_with_its_mapping() -> None:
    """A lumped mass matrix and the mapping vector as Ansys writes them; one model with the .full file beside them."""
    mass = read_matrix(DATA / "ansys" / "rotor_mass.mmf").matrix
    labels, notes = read_dof_map(DATA / "ansys" / "rotor_map.mmf", 345)
    assert notes == ("DOF map: 115 nodes, each UX, UY, UZ",)
    np.testing.assert_allclose(mass.trace() / 3, 77.966047, rtol=1e-7)
    full = ansys(DATA / "ansys" / "sparse.full", "M")
    np.testing.assert_array_equal(full.labels.node, labels.node)
    np.testing.assert_array_equal(full.labels.component, labels.component)
    np.testing.assert_allclose(full.matrix.sum(axis=0), mass.diagonal(), rtol=1e-9)


def test_matrix_input_of_abaqus(tmp_path: Path) -> None:
    """A beam B33, 5 long, 0.5 x 0.5, E = 3e7, its turns held at one node and its place at the other; frequencies by the beam's theory."""
    stiffness = read_matrix(DATA / "abaqus" / "eb3arxs4_STIF1.mtx")
    assert stiffness.format == "abaqus"
    labels = stiffness.labels
    assert labels is not None
    assert labels.node.tolist() == [-1] * 2 + [1] * 6 + [2] * 6
    assert labels.component.tolist() == ["INNER1", "INNER2", *2 * ["UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ"]]
    weights = {("UX", 1): 0.3, ("UY", 1): 0.5, ("UZ", 1): 0.7, ("ROTX", 2): 0.9}
    of_row = [weights.get((c, k), 0.0) for c, k in zip(labels.component.tolist(), labels.node.tolist(), strict=True)]
    held, told = fixed_dofs(stiffness.matrix, sp.csc_array(np.diag(of_row)))
    assert told == "fixed DOFs left out: 6 with a penalty on the diagonal"
    assert {labels.component[k] + str(labels.node[k]) for k in np.flatnonzero(held)} == {"ROTX1", "ROTY1", "ROTZ1", "UX2", "UY2", "UZ2"}
    free = np.flatnonzero(~held)
    found = frequencies(stiffness.matrix[free][:, free], sp.csc_array(np.diag(of_row))[free][:, free], 0, 4)
    E, side, length, shear = 3e7, 0.5, 5.0, 3e7 / 2.6
    bending, pull, twist = 3 * E * side**4 / 12 / length**3, E * side**2 / length, 0.1408333 * side**4 * shear / length
    expected = np.sqrt([bending / 0.7, bending / 0.5, twist / 0.9, pull / 0.3]) / (2 * np.pi)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_coordinates_of_abaqus_with_both_triangles(tmp_path: Path) -> None:
    """The first rows of a block of C3D4 as ``FORMAT=COORDINATE`` writes them."""
    path = tmp_path / "block_STIF1.mtx"
    path.write_text(
        "1 1  3.582994033916093e+10\n1 2  7.850217128178634e+09\n2 1  7.850217128178634e+09\n1 3  7.209566551255555e+09\n"
        "3 1  7.209566551255555e+09\n2 2  3.968518284007154e+10\n2 3 -7.569286015649425e+09\n3 2 -7.569286015649425e+09\n"
        "3 3  3.812372686790643e+10\n"
    )
    found = read_matrix(path)
    assert found.format == "triplets"
    assert found.notes == ()
    np.testing.assert_array_equal(
        found.matrix.toarray(),
        [
            [3.582994033916093e10, 7.850217128178634e09, 7.209566551255555e09],
            [7.850217128178634e09, 3.968518284007154e10, -7.569286015649425e09],
            [7.209566551255555e09, -7.569286015649425e09, 3.812372686790643e10],
        ],
    )
