"""Matrices, DOF maps and coordinates as FE programs write them."""

from __future__ import annotations

import contextlib
import gzip
import re
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.sparse as sp
from foreign_files import write_abaqus, write_dmig, write_harwell_boeing, write_op4, write_sierra

from lrbc_cli.errors import ConfigError, DataError
from lrbc_cli.io.frf import read_frf
from lrbc_cli.io.hdf5.matrices import ArrayNames
from lrbc_cli.io.matrices.read import detect_format, read_matrix
from lrbc_cli.io.meshes.nodes import read_nodes
from lrbc_cli.io.text.dof_maps import read_dof_map

DATA = Path(__file__).parents[1] / "data"
NODE, COMPONENT = [7, 7, 12, 12, 3, 3], ["UX", "ROTZ"] * 3


def example() -> Any:
    """Symmetric, with rows in no order of their nodes."""
    values = np.random.default_rng(3).normal(size=(6, 6)) * 1e5
    values[np.abs(values) < 3e4] = 0.0
    return sp.csc_array(values + values.T)


def frequencies(K: Any, M: Any, count: int) -> Any:
    """Lowest ones [Hz]; the mass matrix may be singular."""
    mu = scipy.linalg.eigh(M.toarray(), K.toarray(), eigvals_only=True)[::-1][:count]
    return np.sqrt(1.0 / mu) / (2 * np.pi)


def test_calculix_by_its_own_frequencies() -> None:
    """A plate on springs: matrices read, frequencies as CalculiX itself states them."""
    folder = DATA / "calculix"
    K, M = read_matrix(folder / "plate.sti.gz"), read_matrix(folder / "plate.mas.gz")
    assert K.format == M.format == "triplets"
    stated = [float(line.split()[3]) for line in (folder / "plate.dat").read_text().splitlines()[7:15]]
    np.testing.assert_allclose(frequencies(K.matrix, M.matrix, 8), stated, rtol=1e-6)
    labels, _ = read_dof_map(folder / "plate.dof", K.matrix.shape[0])
    assert (labels.node[:3].tolist(), labels.component[:3].tolist()) == ([12] * 3, ["UX", "UY", "UZ"])
    node, xyz, what = read_nodes(folder / "plate.inp")
    assert what == "input file of Abaqus or CalculiX"
    assert node.size == 60
    np.testing.assert_allclose(xyz.max(axis=0), [400.0, 300.0, 4.0])


def test_op4_of_nastran_in_binary_and_ascii() -> None:
    binary = read_matrix(DATA / "nastran" / "testplate_kgg.op4")
    text = read_matrix(DATA / "nastran" / "testplate_kgg_ascii.op4.gz", "kgg")
    assert binary.format == text.format == "nastran-op4"
    assert binary.matrix.shape == (726, 726)
    assert binary.matrix.nnz == text.matrix.nnz == 12196
    # ASCII has ten digits.
    assert abs(binary.matrix - text.matrix).max() < 1e-9 * abs(binary.matrix).max()
    # A plate moves as a rigid body without force.
    assert abs(binary.matrix - binary.matrix.T).max() == 0.0
    np.testing.assert_allclose(binary.matrix @ np.tile([1.0, 0, 0, 0, 0, 0], 121), 0.0, atol=1e-6)
    with pytest.raises(DataError, match="KGG"):
        read_matrix(DATA / "nastran" / "testplate_kgg.op4", "MGG")


def test_dmig_of_nastran() -> None:
    path = DATA / "nastran" / "dmig.pch"
    K, M = read_matrix(path, "KAAX"), read_matrix(path, "MAAX")
    assert K.labels is not None
    assert K.labels.node[:4].tolist() == [101, 102, 105, 106]
    assert set(K.labels.component.tolist()) == {"UX"}
    assert (K.matrix[0, 0], K.matrix[0, 1], K.matrix[1, 0], K.matrix[1, 1]) == (155.6, -155.6, -155.6, 381.5)
    assert M.matrix.shape == (15, 15)
    with pytest.raises(DataError, match="KAAX, MAAX, BAAX"):
        read_matrix(path)
    with pytest.raises(DataError, match="KAAX, MAAX, BAAX"):
        read_matrix(path, "VAX")


def test_ansys_full_by_its_frequency() -> None:
    path = DATA / "ansys" / "sparse.full"
    assert detect_format(path) == "ansys-full"
    with pytest.raises(DataError, match=r"file\.full#K"):
        read_matrix(path)
    try:
        import ansys.mapdl.reader  # noqa: F401
    except ImportError:
        with pytest.raises(DataError, match=re.escape("pip install lrbc[ansys]")):
            read_matrix(path, "K")
        return
    K, M = read_matrix(path, "K"), read_matrix(path, "M")
    assert K.labels is not None
    assert K.labels.component[:3].tolist() == ["UX", "UY", "UZ"]
    elastic = np.sqrt(scipy.linalg.eigh(K.matrix.toarray(), M.matrix.toarray(), eigvals_only=True)[6]) / (2 * np.pi)
    np.testing.assert_allclose(elastic, 116.73, rtol=1e-4)


@pytest.mark.parametrize("half", [True, False])
@pytest.mark.parametrize("layout", ["matrix input", "labels", "coordinate"])
def test_abaqus(tmp_path: Path, layout: str, half: bool) -> None:
    path, K = tmp_path / "job_STIF2.mtx", example()
    write_abaqus(path, K, NODE, COMPONENT, layout, half)
    found = read_matrix(path)
    assert found.format == ("triplets" if layout == "coordinate" else "abaqus")
    order = list(range(6))
    if layout != "coordinate":
        assert found.labels is not None
        assert found.labels.node.tolist() == [3, 3, 7, 7, 12, 12]
        assert found.labels.component.tolist() == ["UX", "ROTZ"] * 3
        order = [4, 5, 0, 1, 2, 3]
    np.testing.assert_allclose(found.matrix.toarray(), K.toarray()[np.ix_(order, order)], rtol=1e-15)
    assert ("stored as one triangle, the other was filled in" in found.notes) == half


def test_labels_of_abaqus(tmp_path: Path) -> None:
    """Internal nodes are negative; 8 is the pressure."""
    path = tmp_path / "k.mtx"
    path.write_text("-4,1, -4,1, 2.0\n5,8, 5,8, 3.0\n5,7, -4,1, 1.0\n")
    labels = read_matrix(path).labels
    assert labels is not None
    assert list(zip(labels.node.tolist(), labels.component.tolist(), strict=True)) == [(-4, "INNER1"), (5, "WARP"), (5, "PRES")]


@pytest.mark.parametrize("kind", ["sierra-sd", "harwell-boeing", "nastran-dmig", "op4 <", "op4 > packed"])
def test_round_trips(tmp_path: Path, kind: str) -> None:
    path, K, order, rtol = tmp_path / "k.any", example(), list(range(6)), 1e-15
    if kind == "sierra-sd":
        write_sierra(path, K)
    elif kind == "harwell-boeing":
        write_harwell_boeing(path, K)
    elif kind == "nastran-dmig":
        write_dmig(path, "KAAX", K, NODE, COMPONENT)
        order, rtol = [4, 5, 0, 1, 2, 3], 1e-9
    else:
        write_op4(path, "KAA", K, kind[4], "packed" not in kind)
    found = read_matrix(path)
    assert found.format == ("nastran-op4" if kind.startswith("op4") else kind)
    np.testing.assert_allclose(found.matrix.toarray(), K.toarray()[np.ix_(order, order)], rtol=rtol)
    packed = tmp_path / "k.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    if not kind.startswith("op4"):
        assert abs(read_matrix(packed).matrix - found.matrix).max() == 0.0


@pytest.mark.parametrize(
    "text",
    [
        "function K = Kaa()\nKaa = [\n1 1 2.0\n2 1 -1.0\n2 2 3.0\n];\nK = spconvert(Kaa);\n",
        "function [k] = Kssr\r\nk = [ ...\r\n1 1 2.0\r\n2 1 -1.0\r\n2 2 3.0 ];\r\nk = spconvert(k);\r\n",
        "% lower triangle\nKaa=[1 1 2.0e+00;\n2 1 -1.0e+00;\n2 2 3.0e+00];\n",
    ],
)
def test_functions_of_sierra(tmp_path: Path, text: str) -> None:
    """Its MATLAB tools call the files as functions, and complete the lower triangle that they give."""
    path = tmp_path / "Kaa.m"
    path.write_bytes(text.encode())
    found = read_matrix(path)
    assert (found.format, found.notes) == ("sierra-sd", ("stored as one triangle, the other was filled in",))
    np.testing.assert_array_equal(found.matrix.toarray(), [[2.0, -1.0], [-1.0, 3.0]])


def test_harwell_boeing_as_scipy_writes_it(tmp_path: Path) -> None:
    matrix = sp.random_array((40, 40), density=0.2, rng=np.random.default_rng(1), format="csc")
    for values in (matrix, (100 * matrix).astype(np.int64)):
        scipy.io.hb_write(tmp_path / "k.hb", sp.csc_matrix(values))
        np.testing.assert_allclose(read_matrix(tmp_path / "k.hb").matrix.toarray(), values.toarray(), rtol=1e-14)


HB = {
    "values": ("(3E8.1)", " 2.0E+00 1.0E+00 3.0E+00"),
    "without a letter before a long exponent": ("(3E11.3)", "  0.200E+01  0.100+001  300.0-002"),
    "D, two a line": ("(1P,2D9.1)", "  2.0D+00  1.0D+00\n  3.0D+00"),
    "1P without exponent": ("(1P3F6.1)", "  20.0  10.0  30.0"),
    "one a line": ("(F5.1)", "  2.0\n  1.0\n  3.0"),
}


@pytest.mark.parametrize("layout", HB)
@pytest.mark.parametrize("kind", ["RSA", "isa"])
@pytest.mark.parametrize("right", ["", "F              1             0\n"], ids=["", "right-hand side"])
@pytest.mark.parametrize("cards", [" 5 1 1 3", "             5             1             1             3             1"])
def test_numbers_and_headers_of_harwell_boeing(tmp_path: Path, layout: str, kind: str, right: str, cards: str) -> None:
    """A line on right-hand sides stands where the counts say none, and the other way round; files of Rutherford-Boeing have four counts."""
    form, values = HB[layout]
    path = tmp_path / "k.rsa"
    path.write_text(f"title\n{cards}\n{kind}     2     2     3     0\n(3I3) (3I2) {form}\n{right}  1  3  4\n 1 2 2\n{values}\n")
    found = read_matrix(path)
    assert found.format == "harwell-boeing"
    np.testing.assert_allclose(found.matrix.toarray(), [[2.0, 1.0], [1.0, 3.0]], rtol=1e-15)


def test_rows_at_the_end_may_be_missing(tmp_path: Path) -> None:
    """Massless DOFs have no entry in a list of entries: its order is known from the stiffness only."""
    (tmp_path / "m").write_text("1 1 2.0\n2 2 2.0\n")
    found = read_matrix(tmp_path / "m")
    assert not found.sized
    assert found.matrix.shape == (2, 2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,1, 1,1, 2.0\n1,1, 1,x, 2.0\n", "line 2"),
        ("1,1, 1,1, 2.0\n1,1, 1,1\n", "line 2"),
        ("1,1, 1,1.5, 2.0\n2,1, 2,1, 2.0\n", "not known"),
        ("1 1 2.0\n1 2 2.0 3.0\n", "line 2"),
        ("1 1 2.0\n1.5 2 2.0\n", "whole number"),
        ("1 1 2.0\n99999999999 1 2.0\n", "do not fit the file"),
        ("1,1, 1,1, nan\n", "not a finite number"),
        ("Kaa = [\n1 1 2.0\n1 2\n];\n", "line 3"),
        (f"DMIG    K              0       6       2       0\nDMIG*   K{'x':>31}{1:16d}\n", "line 2"),
        ("DMIG    K              0       6       4       0       1               2\n", "POLAR 0"),
        (f"DMIG*   {'K':16}{0:16d}{6:16d}{4:16d}\n*       {0:16d}{1:16d}{'':16}{2:16d}\n", "line 2(.|\\n)*POLAR 0"),
        ("title\n 1 1 1 1 0\nRSA 2 2 99999999999 0\n(1I14) (1I14) (3E25.17)\n1\n", "more data than the file contains"),
        (f"title\n 3 1 1 1 0\nRSA {'9' * 5000} 2 1 0\n(1I14) (1I14) (3E25.17)\n1\n", "cannot be read"),
        ("title\n 3 1 1 1 0\nRSE 2 2 1 0\n(1I14) (1I14) (3E25.17)\n1\n", "not assembled"),
        ("title\n 3 1 1 1\nqsa 2 2 1 0\n(1I14) (1I14) (3E25.17)\n1\n", "has no values"),
        ("title\n 3 1 1 1 0\nRSA 2 2 1 0\n(9999I9999) (1I14) (3E25.17)\n1\n", "line 4"),
        ("       2       2       6       2K       1P,5E16.9\n       1       1       4\n 1.0 x\n", "cannot be read"),
        ("$MeshFormat\n4.1 0 8\n", "a mesh of gmsh"),
        ("*HEADING\n*NODE\n1, 0, 0, 0\n", "MATRIX GENERATE"),
        (
            "**\n** GENERATION OF SUBSTRUCTURE Z1\n*USER ELEMENT, NODES=2, LINEAR\n  1, 2\n   1, 2, 3\n*MATRIX,TYPE=STIFFNESS\n 2.0,\n",
            "substructure",
        ),
        ("11, 101,1, 101,1,  9.89e+01\n11, 101,2, 101,1,  3.57e+01\n", "single elements"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "k.txt"
    path.write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        read_matrix(path)
    assert str(path) in str(caught.value)


def damaged_copies(content: bytes) -> list[bytes]:
    """The file cut anywhere, and every byte of it inverted or made a digit in turn; a third of them."""
    cut = [content[:k] for k in range(len(content))]
    changed = [content[:k] + bytes([new]) + content[k + 1 :] for k in range(len(content)) for new in (content[k] ^ 255, ord("9"))]
    return (cut + changed)[::3]


@pytest.mark.parametrize("kind", ["nastran-op4", "harwell-boeing", "nastran-dmig", "abaqus"])
def test_damaged_files_end_in_a_message(tmp_path: Path, kind: str) -> None:
    """A matrix or a DataError, never anything else."""
    path, K = tmp_path / "k.any", example()[:4, :4]
    if kind == "nastran-op4":
        write_op4(path, "KAA", K)
    elif kind == "harwell-boeing":
        write_harwell_boeing(path, K)
    elif kind == "nastran-dmig":
        write_dmig(path, "KAAX", K, NODE[:4], COMPONENT[:4])
    else:
        write_abaqus(path, K, NODE, COMPONENT, "matrix input")
    refused = 0
    for part in damaged_copies(path.read_bytes()):
        path.write_bytes(part)
        try:
            read_matrix(path, format=kind)
        except DataError:
            refused += 1
    assert refused > 100


@pytest.mark.parametrize(
    "text",
    ["12.1\n12.2\n7.3\n", "eqn node dof\n1 4 UX\n2 4 UY\n3 9 PRES\n", "%%\n3 1\n4\n5\n9\n", "dof,node,component\n0,1,UX\n1,1,UY\n2,1,UZ\n"],
)
def test_damaged_maps_end_in_a_message(tmp_path: Path, text: str) -> None:
    path = tmp_path / "map"
    for part in damaged_copies(text.encode()):
        path.write_bytes(part)
        with contextlib.suppress(DataError):
            assert read_dof_map(path, 3, None)[0].size == 3


def test_maps_of_ansys(tmp_path: Path) -> None:
    (tmp_path / "mapping").write_text(
        "  Matrix Eqn       Node      DOF\n     2     12     UY\n     1     12     UX\n     3      4     PRES\n"
    )
    labels, _ = read_dof_map(tmp_path / "mapping", 3)
    assert list(zip(labels.node.tolist(), labels.component.tolist(), strict=True)) == [(12, "UX"), (12, "UY"), (4, "PRES")]
    vector = tmp_path / "mapback.txt"
    vector.write_text("%%MatrixMarket matrix array integer general\n3 1\n8\n2\n5\n")
    labels, notes = read_dof_map(vector, 9)
    assert labels.node.tolist() == [8, 8, 8, 2, 2, 2, 5, 5, 5]
    assert labels.component.tolist() == ["UX", "UY", "UZ"] * 3
    assert "3 nodes, each UX, UY, UZ" in notes[0]
    labels, _ = read_dof_map(vector, 6, ["UZ", "ROTX"])
    assert labels.component.tolist() == ["UZ", "ROTX"] * 3
    for n, components, message in ((10, None, "does not fit"), (3, None, "which DOFs"), (9, ["UX"], "which DOFs")):
        with pytest.raises(DataError, match=message):
            read_dof_map(vector, n, components)


@pytest.mark.parametrize(
    "text",
    [
        "node,x,y,z\n4,1.5,0,-2\n9,0.001,2,0\n",
        "*HEADING\nplate\n** comment\n*Node, nset=all\n4, 1.5, 0, -2\n9, 1.0D-3, 2\n*ELEMENT, TYPE=S4\n1, 4, 9, 4, 9\n",
        "CEND\nBEGIN BULK\nGRID           4             1.5      0.     -2.\nGRID    9               1.0-3     2.      0.       0\n",
        "GRID,4,,1.5,0.,-2.\nGRID*                  9                            .001             2.0\n*                    0.0\n",
        "/PREP7\nNBLOCK,6,SOLID,     9,     2\n(3i9,6e21.13e3)\n"
        "        4        0        0 1.5000000000000E+000 0.0000000000000E+000-2.0000000000000E+000\n"
        "        9        0        0 1.0000000000000E-003 2.0000000000000E+000\nN,R5.3,LOC,       -1,\n",
        " LIST ALL SELECTED NODES.   DSYS=      0\n    NODE   X    Y    Z\n      4  1.5  0  -2\n      9  0.001 2.0 0.0\n",
        "    1C\n    2C                             2                                     1\n"
        " -1         4 1.50000E+00 0.00000E+00-2.00000E+00\n -1         9 1.00000E-03 2.00000E+00 0.00000E+00\n -3\n",
    ],
    ids=["csv", "abaqus", "nastran small", "nastran free, large", "ansys nblock", "ansys nlist", "calculix frd"],
)
def test_coordinates(tmp_path: Path, text: str) -> None:
    path = tmp_path / "nodes.any"
    path.write_text(text)
    node, xyz, _ = read_nodes(path)
    assert node.tolist() == [4, 9]
    np.testing.assert_allclose(xyz, [[1.5, 0, -2], [0.001, 2, 0]])


def test_coordinates_that_cannot_be_used(tmp_path: Path) -> None:
    path = tmp_path / "nodes.inp"
    for text, message in (
        ("*NODE\n1, 0, 0, 0\n1, 1, 0, 0\n", "two places"),
        ("*NODE\n1, 0, x, 0\n", "line 2"),
        (f"*NODE\n{'9' * 30}, 0, 0, 0\n", "line 2"),
        ("*NODE, SYSTEM=C\n1, 0, 0, 0\n", "rectangular"),
        ("GRID    1       7       0.0     0.0     0.0\n", "basic system"),
        ("GRID,1,,0.,0.,0.,5\n", "displacements in the basic system"),
        ("GRID    1               0.0     0.0     0.0            5\n", "displacements in the basic system"),
        ("*PART, NAME=A\n*NODE\n1, 0, 0, 0\n*END PART\n*INSTANCE, NAME=A1, PART=A\n500., 0., 0.\n", "at the place of its part"),
        ("*NODE, NSET=ALL\n*ELEMENT\n", "contains no nodes"),
    ):
        path.write_text(text)
        with pytest.raises(DataError, match=message):
            read_nodes(path)


def test_what_stands_twice(tmp_path: Path) -> None:
    """Two runs in one file would be added; a map with one DOF twice leaves another out."""
    matrix, dofs = tmp_path / "K.mtx", tmp_path / "K.dof"
    entries = "1,1,1,1,2.\n1,1,2,1,-1.\n2,1,2,1,3.\n"
    matrix.write_text(entries)
    assert read_matrix(matrix).matrix.shape == (2, 2)
    matrix.write_text(2 * entries)
    with pytest.raises(DataError, match="are given twice"):
        read_matrix(matrix)
    dofs.write_text("1.1\n1.2\n1.1\n")
    with pytest.raises(DataError, match="a DOF is given twice"):
        read_dof_map(dofs, 3)


def test_other_meshes_by_meshio(tmp_path: Path) -> None:
    path = tmp_path / "plate.vtk"
    path.write_text(
        "# vtk DataFile Version 3.0\nplate\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 3 double\n0 0 0\n1 0 0\n0 1 0\n"
        "CELLS 1 4\n3 0 1 2\nCELL_TYPES 1\n5\n"
    )
    try:
        import meshio  # noqa: F401
    except ImportError:
        with pytest.raises(DataError, match=re.escape("pip install lrbc[meshes]")):
            read_nodes(path)
        return
    node, xyz, _ = read_nodes(path)
    assert node.tolist() == [1, 2, 3]
    np.testing.assert_allclose(xyz[1], [1.0, 0.0, 0.0])


@pytest.mark.parametrize("base", [0, 1])
def test_compressed_arrays_of_other_names(tmp_path: Path, base: int) -> None:
    """As elPaSo writes them: complex pairs, indices beside them, no attribute that says how many rows there are."""
    path, K = tmp_path / "system.h5", sp.csr_array(example())
    pairs = np.zeros(K.nnz, dtype=[("real", "f8"), ("imag", "f8")])
    pairs["real"] = K.data
    with h5py.File(path, "w") as file:
        group = file.create_group("SystemMatrices/stiffness")
        group["vecCsrIa"], group["vecCsrJa"], group["cmpCsrVal"] = K.indptr + base, K.indices + base, pairs
    found = read_matrix(
        path, "SystemMatrices/stiffness", None, ArrayNames(data="cmpCsrVal", indices="vecCsrJa", indptr="vecCsrIa", layout="csr")
    )
    np.testing.assert_array_equal(found.matrix.toarray(), K.toarray())
    assert found.notes == (("indices count from 1",) if base else ())
    with pytest.raises(DataError, match=r"arrays: \{data: cmpCsrVal, indices: vecCsrJa, indptr: vecCsrIa\}"):
        read_matrix(path, "SystemMatrices/stiffness")
    with pytest.raises(DataError, match="no such array"):
        read_matrix(path, "SystemMatrices/stiffness", None, ArrayNames(data="cmpCsrVal", indices="ja", indptr="vecCsrIa", layout="csr"))
    (tmp_path / "k.mtx").write_text("1 1 2.0\n")
    with pytest.raises(ConfigError, match="HDF5"):
        read_matrix(tmp_path / "k.mtx", None, None, ArrayNames(data="cmpCsrVal", indices="ja", indptr="vecCsrIa", layout="csr"))


@pytest.mark.parametrize(
    ("name", "members", "program", "matrix", "frf"),
    [
        ("a.mph", ["fileversion", "dmodel.xml", "geometry1.mphbin"], "a model of COMSOL", "mphmatrix", "Export, Table"),
        ("a.bin", ["modelinfo.xml"], "a model of COMSOL", "mphmatrix", "Export, Table"),
        ("a.wbpz", ["p.wbpj", "p_files/dp0/SYS/MECH/file.full"], "a project of Ansys Workbench", "HBMAT", "export the frequency response"),
        ("a.xlsx", ["[Content_Types].xml", "xl/workbook.xml"], "an Excel workbook", "row, column and value", "CSV"),
        ("a.ods", ["mimetype", "content.xml"], "a document of LibreOffice", "row, column and value", "CSV"),
        ("a.zip", ["data/K.mtx", "acc1.uff"], "a zip archive", "unpack it(.|\n)*K.mtx", "unpack it(.|\n)*acc1.uff"),
        ("broken.mph", None, "a model of COMSOL", "mphmatrix", "Export, Table"),
    ],
)
def test_archives_of_other_programs_are_named(
    tmp_path: Path, name: str, members: list[str] | None, program: str, matrix: str, frf: str
) -> None:
    """They were archives without a matrix, to be unpacked, or `an Excel workbook or a zip archive`."""
    path = tmp_path / name
    if members is None:
        path.write_bytes(b"PK\3\4" + bytes(100))
    else:
        with zipfile.ZipFile(path, "w") as archive:
            for member in members:
                archive.writestr(member, b"content")
    with pytest.raises(DataError, match=f"this is {program}(.|\\n)*{matrix}"):
        read_matrix(path)
    with pytest.raises(DataError, match=f"this is {program}(.|\\n)*{frf}"):
        read_frf(path)


def test_a_file_without_a_matrix_says_what_to_do(tmp_path: Path) -> None:
    """The error referred to a README that no longer lists the layouts."""
    path = tmp_path / "system.h5"
    with h5py.File(path, "w") as file:
        file["title"] = 1
    with pytest.raises(DataError, match="lrbc guide formats"):
        read_matrix(path)
    K = sp.csr_array(example())
    with h5py.File(path, "a") as file:
        file["a/K/v"], file["a/K/i"], file["a/K/p"] = K.data, K.indices, K.indptr
    with pytest.raises(DataError, match=r"group: a/K, arrays: \{data: v, indices: i, indptr: p\}"):
        read_matrix(path)
    with h5py.File(path, "a") as file:
        file["num_nodes"], file["coord"] = np.zeros(4), np.zeros((3, 4))
    with pytest.raises(DataError, match=r"exodus mesh(.|\n)*dofs: \{nodes: FILE\}"):
        read_matrix(path)


def test_whole_numbers_are_no_matrix(tmp_path: Path) -> None:
    """Maps and indices beside a matrix: it is the only one, and what is asked for by name is refused by name."""
    path = tmp_path / "k.h5"
    with h5py.File(path, "w") as file:
        file["map/dofs"] = np.arange(12).reshape(6, 2)
        file["K"] = example().toarray()
    assert read_matrix(path).notes[0] == "using 'K', the only matrix in the file"
    with pytest.raises(DataError, match=r"map/dofs(.|\n)*int64"):
        read_matrix(path, "map/dofs")
    path = tmp_path / "k.mat"
    scipy.io.savemat(path, {"K": example(), "dofs": np.arange(12, dtype=np.int32).reshape(6, 2)})
    assert read_matrix(path).notes[0] == "using 'K', the only matrix in the file"
    with pytest.raises(DataError, match="dofs"):
        read_matrix(path, "dofs")


@pytest.mark.parametrize("packed", [True, False])
def test_structures_of_comsol(tmp_path: Path, packed: bool) -> None:
    """``str = mphmatrix(...)``, saved whole in MATLAB v5 and v7.3: fields by name."""
    path, K = tmp_path / "v5.mat", example()
    fields = {"K": K, "E": 2.0 * K, "Kc": 1j * K.toarray(), "label": "sol1", "inner": {"D": K.toarray()}, "none": np.zeros((0, 0))}
    scipy.io.savemat(path, {"str": fields}, do_compression=packed)
    for name, factor in (("str.K", 1.0), ("str.E", 2.0), ("str.Kc", 1j), ("str.inner.D", 1.0)):
        np.testing.assert_array_equal(read_matrix(path, name).matrix.toarray(), factor * K.toarray())
    with pytest.raises(DataError, match=r"str\.K, str\.E"):
        read_matrix(path)
    content = path.read_bytes()
    for cut in range(200, len(content), 97):
        path.write_bytes(content[:cut])
        with pytest.raises(DataError):
            read_matrix(path, "str.K")
    path = tmp_path / "v73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("str/K")
        group.attrs["MATLAB_class"], group.attrs["MATLAB_sparse"] = np.bytes_("double"), np.uint64(6)
        group["jc"], group["ir"], group["data"] = K.indptr.astype("u8"), K.indices.astype("u8"), K.data
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file")
    for name in ("str.K", "str/K"):
        np.testing.assert_array_equal(read_matrix(path, name).matrix.toarray(), K.toarray())
