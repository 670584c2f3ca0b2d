"""Models as FE programs export them: the same model from every layout, in any unit, with fixed DOFs and DOF maps of their own."""

from __future__ import annotations

import csv
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from campaigns import Folder
from foreign_files import write_abaqus, write_dmig, write_harwell_boeing
from systems import beam_element, csc

from lrbc_cli.campaign.reading import dof_source
from lrbc_cli.campaign.reading.dof_source import order_doubt
from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import DataError, LrbcError
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.units import parse_system

DATA = Path(__file__).parents[1] / "data"
N, PITCH = 6, 0.05


def beam() -> tuple[Any, Any, list[int], list[str]]:
    """A free steel beam of 20 x 5 mm on soft springs: deflection and slope of seven nodes, numbered from 10 in steps of 5."""
    k, m = beam_element(PITCH, 2.1e11 * 0.02 * 0.005**3 / 12, 7850 * 0.02 * 0.005)
    n = 2 * (N + 1)
    K, M = np.zeros((n, n)), np.zeros((n, n))
    for e in range(N):
        at = slice(2 * e, 2 * e + 4)
        K[at, at] += k
        M[at, at] += m
    K[0, 0] += 5e4
    K[-2, -2] += 5e4
    return K, M, [10 + 5 * (i // 2) for i in range(n)], ["UZ", "ROTY"] * (N + 1)


def in_millimetres(K: Any, M: Any, component: list[str]) -> tuple[Any, Any]:
    """The same in mm, N and t, entry by entry from the units: N/mm, N, N mm; t, t mm, t mm²."""
    turns = np.array([name.startswith("ROT") for name in component], dtype=int)
    power = turns[:, None] + turns[None, :]
    return K * 1e-3 * 1e3**power, M * 1e-3 * 1e3**power


def write_nodes(path: Path, scale: float = 1.0) -> None:
    rows = [f"{10 + 5 * i},{scale * PITCH * i:.9g},0,0" for i in range(N + 1)]
    path.write_text("node,x,y,z\n" + "\n".join(rows) + "\n")


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    """The beam in SI units, Matrix Market and a DOF table."""
    K, M, node, component = beam()
    (tmp_path / "data").mkdir()
    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(tmp_path / "data" / f"{name}.mtx", csc(matrix), symmetry="general", precision=17)
    rows = [f"{i},{node[i]},{component[i]},{PITCH * (i // 2):.9g},0,0" for i in range(len(node))]
    (tmp_path / "data" / "dofs.csv").write_text("dof,node,component,x,y,z\n" + "\n".join(rows) + "\n")
    (tmp_path / "data" / "bushings.csv").write_text("bolt,node_a,component,stiffness\nB1,15,UZ,1e5\nB1,15,ROTY,20\nB2,30,UZ,1e5\n")
    found = Folder(tmp_path)
    found.write(
        {
            "campaign": "beam",
            "output": "out",
            "model": {
                "stiffness": "data/K.mtx",
                "mass": "data/M.mtx",
                "damping": {"structure": {"alpha": 3.0, "beta": 1e-6}},
                "dofs": "data/dofs.csv",
            },
            "excitation": {"hammer": {"near": [0.1, 0, 0], "component": "UZ"}},
            "responses": {"tip": {"node": 40, "component": "UZ", "quantity": "acceleration"}, "slope": {"node": 20, "component": "ROTY"}},
            "parameters": {"bolts": {"select": {"bushings": "data/bushings.csv"}}},
            "reduction": {"band": [20.0, 800.0]},
        }
    )
    return found


def read(folder: Folder, **model: Any) -> Inputs:
    """The model of a campaign with other keys in ``model``, ``units`` at the top."""
    tree = folder.tree()
    if "units" in model:
        tree["units"] = model.pop("units")
    tree["model"].update(model)
    folder.write(tree)
    return read_as_exported(load_campaign(folder.config))


def frf(inputs: Inputs, kappa: float = 0.3) -> Any:
    """FRFs of both responses at three frequencies, the bolts at a part of their nominal stiffness."""
    m, out = inputs.model, []
    for hz in (35.0, 140.0, 560.0):
        s = 2j * np.pi * hz
        Z = (s**2 * m.M + s * m.C + m.K + kappa * m.terms.left @ m.terms.right.T).toarray()
        out.append((s**m.output_power) * (m.L @ np.linalg.solve(Z, m.B.toarray()))[:, 0])
    return np.array(out)


LAYOUTS = ("abaqus matrix input", "abaqus labels", "abaqus coordinate", "dmig", "harwell-boeing", "calculix")


@pytest.mark.parametrize("units", ["SI", "mm-N-t"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_model(folder: Folder, layout: str, units: str) -> None:
    expected = frf(read(folder))
    K, M, node, component = beam()
    if units != "SI":
        K, M = in_millimetres(K, M, component)
        tree = folder.tree()
        tree["excitation"]["hammer"]["near"] = [100.0, 0, 0]
        folder.write(tree)
        # N/mm and N mm/rad.
        (folder.data / "bushings.csv").write_text("bolt,node_a,component,stiffness\nB1,15,UZ,1e2\nB1,15,ROTY,2e4\nB2,30,UZ,1e2\n")
    write_nodes(folder.data / "nodes.csv", 1.0 if units == "SI" else 1e3)
    dofs: Any = "data/nodes.csv"
    kind, _, detail = layout.partition(" ")
    for name, matrix in (("K", K), ("M", M)):
        path = folder.data / f"{name}.mtx"
        if kind == "abaqus":
            write_abaqus(path, csc(matrix), node, component, detail)
        elif kind == "dmig":
            write_dmig(path, f"{name}AAX", csc(matrix), node, component)
        elif kind == "harwell-boeing":
            write_harwell_boeing(path, csc(matrix))
        else:
            write_abaqus(path, csc(matrix), node, component, "coordinate")
    if kind == "harwell-boeing":
        lines = [f"{i + 1:12d}{node[i]:12d}      {component[i]}" for i in range(len(node))]
        (folder.data / "map").write_text("   Matrix Eqn        Node      DOF\n" + "\n".join(lines) + "\n")
        dofs = {"map": "data/map", "nodes": dofs}
    elif detail == "coordinate":
        dofs = {"nodes": dofs, "components": ["UZ", "ROTY"]}
    elif kind == "calculix":
        numbers = {"UZ": 3, "ROTY": 5}
        (folder.data / "map").write_text("".join(f"{node[i]}.{numbers[component[i]]}\n" for i in range(len(node))))
        dofs = {"map": "data/map", "nodes": dofs}
    inputs = read(folder, dofs=dofs, units=units)
    # DMIG has ten digits.
    np.testing.assert_allclose(frf(inputs), expected, rtol=1e-6 if kind == "dmig" else 1e-10)
    assert inputs.dofs is not None
    np.testing.assert_allclose(inputs.dofs.xyz[:, 0].max(), 0.3)
    assert inputs.groups[0].xyz is not None
    np.testing.assert_allclose(inputs.groups[0].xyz[:, 0], [0.05, 0.2])


@pytest.mark.parametrize("units", ["mm-N-kg", "mm-kN-t"])
def test_a_slip_gives_a_unit_of_time_that_nobody_has(units: str) -> None:
    with pytest.raises(ValueError, match="unit of time"):
        parse_system(units)


@pytest.mark.parametrize("units", ["mm-kg-ms", "in-lbf-s", "kN-m-ms"])
def test_other_systems_follow_from_their_units(folder: Folder, units: str) -> None:
    """Matrices written in another system by dimension: the same FRFs."""
    expected = frf(read(folder))
    length, force, time = {"mm-kg-ms": (1e-3, 1e3, 1e-3), "in-lbf-s": (0.0254, 4.4482216152605, 1.0), "kN-m-ms": (1.0, 1e3, 1e-3)}[units]
    K, M, _, component = beam()
    turns = np.array([name.startswith("ROT") for name in component])
    motion, source = np.where(turns, 1.0, length), np.where(turns, force * length, force)
    for name, matrix in (("K", K * motion / source[:, None]), ("M", M * motion / source[:, None] / time**2)):
        scipy.io.mmwrite(folder.data / f"{name}.mtx", csc(matrix), symmetry="general", precision=17)
    table = [row.split(",") for row in (folder.data / "dofs.csv").read_text().splitlines()]
    rows = [",".join([*row[:3], repr(float(row[3]) / length), "0", "0"]) for row in table[1:]]
    (folder.data / "dofs.csv").write_text(",".join(table[0]) + "\n" + "\n".join(rows) + "\n")
    stiffness = [1e5 / force * length, 20.0 / force / length]
    (folder.data / "bushings.csv").write_text(
        f"bolt,node_a,component,stiffness\nB1,15,UZ,{stiffness[0]!r}\nB1,15,ROTY,{stiffness[1]!r}\nB2,30,UZ,{stiffness[0]!r}\n"
    )
    tree = folder.tree()
    tree["excitation"]["hammer"]["near"] = [0.1 / length, 0, 0]
    folder.write(tree)
    np.testing.assert_allclose(frf(read(folder, units=units)), expected, rtol=1e-9)


@pytest.mark.parametrize("divided", [False, True])
def test_pressures_in_millimetres(box: Folder, divided: bool) -> None:
    """A u-p model: coupling blocks keep their form, and FRFs of pressures over forces stay what they are."""
    expected = frf(read(box), 1e4)
    K, M = (scipy.io.mmread(box.data / f"{name}.mtx", spmatrix=False).toarray() for name in "KM")
    acoustic = np.arange(32) >= 8
    if not divided:
        # The sample has a density of one: of another fluid the blocks differ by it.
        M[np.ix_(acoustic, ~acoustic)] *= 1.2
        scipy.io.mmwrite(box.data / "M.mtx", csc(M), symmetry="general", precision=17)
        expected = frf(read(box), 1e4)
    pressure = 1e6
    motion = np.where(acoustic, pressure, 1e-3)
    source = np.where(acoustic, 1e-9 if divided else pressure * 1e-3, 1.0)
    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(box.data / f"{name}.mtx", csc(matrix * motion / source[:, None]), symmetry="general", precision=17)
    with (box.data / "dofs.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    lines = [f"{r['dof']},{r['node']},{r['component']},{1e3 * float(r['x'])},0,{1e3 * float(r['z'])}" for r in rows]
    (box.data / "dofs.csv").write_text("dof,node,component,x,y,z\n" + "\n".join(lines) + "\n")
    bolts = (box.data / "bolts.csv").read_text().splitlines()
    moved = [(name, float(x), float(y)) for name, x, y, _ in (line.split(",") for line in bolts[1:])]
    (box.data / "bolts.csv").write_text("name,x,y,z\n" + "".join(f"{name},{1e3 * x},{1e3 * y},0\n" for name, x, y in moved))
    tree = box.tree()
    tree["responses"]["mic3"]["near"] = [2000.0, 0.0, 100.0]
    tree["parameters"]["springs"]["select"]["box"] = [[0, 1500], [0, 0], [0, 0]]
    box.write(tree)
    found = read(box, units="mm-N-t")
    np.testing.assert_allclose(frf(found, 1e4), expected, rtol=1e-9)
    assert found.bolts is not None
    np.testing.assert_allclose(found.bolts.xyz[1], [0.3, 0.01, 0.0])


def test_signs_of_other_conventions(folder: Folder) -> None:
    """Matrices of ``w² M + w D + K``, K with the loss of exp(-i w t): the same model by `scale` and `conjugate`."""
    K = beam()[0]
    lossy = K * (1 + 0.05j)
    for name, matrix in (("K", lossy), ("C", 1e-5 * K)):
        scipy.io.mmwrite(folder.data / f"{name}.mtx", csc(matrix), symmetry="general", precision=17)
    inputs = read(folder, damping="data/C.mtx")
    expected, notes = frf(inputs), " ".join(inputs.warnings)
    assert "negative" not in notes
    for name, matrix in (("K", -lossy.conj()), ("C", -1e-5j * K)):
        scipy.io.mmwrite(folder.data / f"{name}.mtx", csc(matrix), symmetry="general", precision=17)
    stiffness, damping = {"file": "data/K.mtx", "scale": -1}, {"file": "data/C.mtx", "scale": [0, 1]}
    warnings = read(folder, stiffness=stiffness, damping=damping).warnings
    assert any("imaginary part of the stiffness is negative" in text and "`conjugate: true`" in text for text in warnings)
    inputs = read(folder, stiffness=stiffness | {"conjugate": True}, damping=damping)
    np.testing.assert_allclose(frf(inputs), expected, rtol=1e-12)
    assert not np.iscomplexobj(inputs.model.C.data)


def test_units_are_proposed(folder: Folder) -> None:
    """Files in mm, N and t read as SI: speeds of waves tell; in mm, kg and ms masses do."""
    K, M, _, component = beam()
    write_nodes(folder.data / "nodes.csv", 1e3)
    for name, matrix in zip("KM", in_millimetres(K, M, component), strict=True):
        write_abaqus(folder.data / f"{name}.mtx", csc(matrix), beam()[2], component, "labels")
    tree = folder.tree()
    tree["excitation"]["hammer"]["near"] = [100.0, 0, 0]
    folder.write(tree)
    with pytest.raises(DataError, match="units: mm-N-t"):
        read(folder, dofs="data/nodes.csv")
    read(folder, units="mm-N-t")
    for name in "KM":
        turns = np.array([label.startswith("ROT") for label in component])
        motion, source = np.where(turns, 1.0, 1e-3), np.where(turns, 1.0, 1e3)
        matrix = (K if name == "K" else M * 1e6) * motion / source[:, None]
        write_abaqus(folder.data / f"{name}.mtx", csc(matrix), beam()[2], component, "labels")
    tree["reduction"]["band"] = [0.02, 0.8]
    tree["model"]["dofs"] = "data/nodes.csv"
    folder.write(tree)
    (warning,) = [text for text in read(folder).warnings if "units" in text]
    assert "`units: mm-kg-ms" in warning


def test_fixed_rows_are_left_out(folder: Folder) -> None:
    """Rows of zeros and penalties: the model is that of the free DOFs; numbers in the campaign count all of them."""
    K, M, node, component = beam()
    free = np.array([k not in (4, 13) for k in range(14)])
    write_nodes(folder.data / "nodes.csv")
    tree = folder.tree()
    tree["excitation"]["hammer"] = {"dof": 6}
    tree["responses"] = {"tip": {"dof": 12, "quantity": "acceleration"}}
    tree["parameters"]["bolts"]["select"] = {"dofs": "data/terms.csv"}
    (folder.data / "terms.csv").write_text("dof\n8\n")
    tree["parameters"]["bolts"] |= {"initial": 4.0, "bounds": [1.0, 7.0]}
    folder.write(tree)
    found = []
    for way in ("removed", "zero", "penalty"):
        A, B = K.copy(), M.copy()
        if way == "zero":
            for matrix in (A, B):
                matrix[~free] = matrix[:, ~free] = 0.0
        elif way == "penalty":
            A[~free] = A[:, ~free] = 0.0
            A[~free, ~free] = 1e36
        for name, matrix in (("K", A), ("M", B)):
            path = folder.data / f"{name}.mtx"
            if way == "removed":
                scipy.io.mmwrite(path, csc(matrix[np.ix_(free, free)]), symmetry="general", precision=17)
            else:
                write_abaqus(path, csc(matrix), node, component, "matrix input")
        if way == "removed":
            tree["model"].pop("dofs")
            shifted = tree | {"excitation": {"hammer": {"dof": 5}}, "responses": {"tip": {"dof": 11, "quantity": "acceleration"}}}
            (folder.data / "terms.csv").write_text("dof\n7\n")
            folder.write(shifted)
            found.append(frf(read(folder), 1e4))
            (folder.data / "terms.csv").write_text("dof\n8\n")
            folder.write(tree)
            continue
        inputs = read(folder, dofs="data/dofs.csv" if way == "zero" else "data/nodes.csv")
        assert inputs.model.size == 12
        assert any(note.startswith("fixed DOFs left out: 2 with") for note in inputs.notes)
        found.append(frf(inputs, 1e4))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-12)
    np.testing.assert_allclose(found[2], found[0], rtol=1e-12)
    tree["excitation"]["hammer"] = {"dof": 4}
    folder.write(tree)
    with pytest.raises(LrbcError, match="this DOF is fixed"):
        read(folder, dofs="data/nodes.csv")


def test_labelled_matrices_may_differ_in_their_rows(folder: Folder) -> None:
    """A mass matrix without rotations, as lumped ones are; one with a node that the stiffness lacks is refused."""
    K, M, node, component = beam()
    lumped = np.diag(np.where(np.arange(14) % 2 == 0, M.sum(axis=0), 0.0))
    write_nodes(folder.data / "nodes.csv")
    write_abaqus(folder.data / "K.mtx", csc(K), node, component, "labels")
    write_abaqus(folder.data / "M.mtx", csc(lumped), node, component, "labels")
    inputs = read(folder, dofs="data/nodes.csv")
    np.testing.assert_allclose(inputs.model.M.toarray(), lumped, rtol=1e-12)
    # Without names, the last rotation is a row that the file does not know of.
    for name, matrix in (("K", K), ("M", lumped)):
        write_abaqus(folder.data / f"{name}.mtx", csc(matrix), node, component, "coordinate")
    np.testing.assert_allclose(read(folder, dofs="data/dofs.csv").model.M.toarray(), lumped, rtol=1e-12)
    write_abaqus(folder.data / "K.mtx", csc(K), node, component, "labels")
    write_abaqus(folder.data / "M.mtx", csc(lumped), [99 if k == 10 else k for k in node], component, "labels")
    with pytest.raises(DataError, match="node 99 UZ"):
        read(folder, dofs="data/nodes.csv")
    (folder.data / "nodes.csv").write_text("node,x,y,z\n10,0,0,0\n40,1,0,0\n")
    with pytest.raises(DataError, match="5 nodes of the matrices have no coordinates"):
        read(folder)
    scipy.io.mmwrite(folder.data / "K.mtx", csc(K))
    with pytest.raises(DataError, match="the DOF of each matrix row is not given"):
        read(folder)


def plate(path: Path) -> Folder:
    """Files of CalculiX as they are, in mm, N and t; its springs are bolts."""
    folder = Folder(path)
    for file in (DATA / "calculix").iterdir():
        (path / file.name).write_bytes(file.read_bytes())
    springs = "".join(f"B{k},{node},UZ,2000\n" for k, node in enumerate((16, 22, 34, 40)))
    (path / "bushings.csv").write_text("bolt,node_a,component,stiffness\n" + springs)
    places = {"acc1": [400.0, 150.0, 4.0], "acc2": [160.0, 300.0, 4.0], "acc3": [320.0, 0.0, 4.0]}
    folder.write(
        {
            "campaign": "plate",
            "output": "out",
            "units": "mm-N-t",
            "model": {
                "stiffness": "plate.sti.gz",
                "mass": "plate.mas.gz",
                "damping": {"structure": {"alpha": 20.0, "beta": 5e-6}},
                "dofs": {"map": "plate.dof", "nodes": "plate.inp"},
            },
            "excitation": {"hammer": {"near": [240.0, 75.0, 4.0], "component": "UZ"}},
            "responses": {name: {"near": place, "component": "UZ", "quantity": "acceleration"} for name, place in places.items()},
            "parameters": {"springs": {"select": {"bushings": "bushings.csv"}, "baseline": 1.0}},
            "reduction": {"band": [50.0, 800.0]},
        }
    )
    return folder


def test_solver_order_of_ansys(folder: Folder) -> None:
    """Matrices in another order without a fixed DOF, a nodal mapping vector, and the matrix that takes one to the other."""
    K, M, node, component = beam()
    nodal = np.random.default_rng(2).permutation(7)
    # Internal order: the nodes mixed, all DOFs of one together. The solver's: mixed once more, and one is missing.
    internal = np.array([2 * k + d for k in nodal for d in (0, 1)])
    solver = np.random.default_rng(3).permutation([k for k in range(14) if internal[k] != 13])
    rows = internal[solver]
    for name, matrix in (("K", K), ("M", M)):
        scipy.io.mmwrite(folder.data / f"{name}.mtx", csc(matrix[np.ix_(rows, rows)]), symmetry="symmetric", precision=17)
    scipy.io.mmwrite(folder.data / "P.mtx", sp.csc_array((np.ones(13), (np.arange(13), solver)), shape=(13, 14)))
    vector = "".join(f"{node[2 * k]}\n" for k in nodal)
    (folder.data / "V.mtx").write_text("%%MatrixMarket matrix array integer general\n7 1\n" + vector)
    write_nodes(folder.data / "nodes.csv")
    dofs = {"map": "data/V.mtx", "order": "data/P.mtx", "nodes": "data/nodes.csv", "components": ["UZ", "ROTY"]}
    found = frf(read(folder, dofs=dofs))
    free = np.arange(14) != 13
    for name, matrix in (("K", K), ("M", M)):
        write_abaqus(folder.data / f"{name}.mtx", csc(matrix * np.outer(free, free)), node, component, "labels")
    np.testing.assert_allclose(found, frf(read(folder, dofs="data/nodes.csv")), rtol=1e-10)
    with pytest.raises(DataError, match=r"the order matrix \(`order:`\) does not fit"):
        read(folder, dofs=dofs | {"order": "data/V.mtx"})


def test_plate_of_calculix_in_a_campaign(tmp_path: Path) -> None:
    """`check` runs, and the frequencies are those that CalculiX states."""
    folder = plate(tmp_path)
    outcome = folder.run("check")
    assert outcome.code == 0, outcome.stderr
    # 3.768 kg in all, two thirds of one of the five columns of elements with the fixed edge.
    assert "mass sum over translations: UX 3.266 kg, UY 3.266 kg, UZ 3.266 kg" in outcome.stdout
    assert "180 DOFs of 60 nodes that are not in plate.inp are internal DOFs of the FE program" in outcome.stdout
    inputs = read_as_exported(load_campaign(folder.config))
    # The springs, which the matrix held, are terms now.
    left = inputs.model.terms.left
    mu = sp.linalg.eigsh(inputs.model.M, 4, (inputs.model.K + left @ left.T).tocsc(), which="LM", return_eigenvectors=False)[::-1]
    stated = [float(line.split()[3]) for line in (tmp_path / "plate.dat").read_text().splitlines()[7:11]]
    np.testing.assert_allclose(np.sqrt(1.0 / mu) / (2 * np.pi), stated, rtol=1e-6)
    assert not inputs.warnings


@pytest.mark.slow
def test_a_loosened_spring_of_that_plate_is_found(tmp_path: Path) -> None:
    """The local stiffness of its solid elements is decades above that of the springs: bounds leave them room all the same."""
    folder = plate(tmp_path)
    outcome = folder.run("rehearse", "--out", str(tmp_path / "rehearsal"), "--loose", "B1")
    assert outcome.code == 0, outcome.stderr
    rehearsal = Folder(tmp_path / "rehearsal")
    outcome = rehearsal.run("update", "--json")
    assert outcome.code == 0, outcome.stderr
    found = outcome.json["results"]["loose-B1"]
    assert found["parameters"]["springs"]["bounds"][0] <= -3.0
    assert {bolt["name"]: bolt["verdict"] for bolt in found["bolts"]} == {"B0": "tight", "B1": "loose", "B2": "tight", "B3": "tight"}


MODELS_OF_OTHERS: dict[str, tuple[dict[str, Any], list[float], tuple[int, int, int]]] = {
    "speaker_box": (
        {
            "stiffness": f"{DATA}/nlevp/speaker_box.mat#C",
            "mass": f"{DATA}/nlevp/speaker_box.mat#A",
            "damping": f"{DATA}/nlevp/speaker_box.mat#B",
        },
        [20.0, 700.0],
        (10, 0, 3),
    ),
    "foundation": (
        {
            "stiffness": {"file": f"{DATA}/nlevp/foundation.mat", "group": "K", "scale": -1},
            "mass": f"{DATA}/nlevp/foundation.mat#M",
            "damping": {"file": f"{DATA}/nlevp/foundation.mat", "group": "D", "scale": [0, 1]},
        },
        [5.0, 60.0],
        (1801, 0, 900),
    ),
    "superelement": ({"stiffness": "se.op4#KAA", "mass": "se.op4#MAA"}, [50.0, 300.0], (10, 5, 20)),
    "punch": ({"stiffness": f"{DATA}/nastran/dmig.pch#KAAX", "mass": f"{DATA}/nastran/dmig.pch#MAAX"}, [0.5, 10.0], (10, 5, 2)),
    "full": ({"stiffness": "file.full#K", "mass": "file.full#M"}, [500.0, 3000.0], (500, 600, 300)),
}


@pytest.mark.parametrize("name", MODELS_OF_OTHERS)
def test_models_of_others_need_a_campaign_file_only(tmp_path: Path, name: str) -> None:
    """Every model that others wrote, by keys of the campaign: `check` says nothing against it, and the matrices are theirs."""
    model, band, (load, output, term) = MODELS_OF_OTHERS[name]
    if name == "full":
        try:
            import ansys.mapdl.reader  # noqa: F401
        except ImportError:
            pytest.skip("the extra [ansys] is not installed")
    for target, source in (("se.op4", "nastran/se_test_n11.op4.gz"), ("file.full", "ansys/file.full.gz")):
        (tmp_path / target).write_bytes(gzip.decompress((DATA / source).read_bytes()))
    (tmp_path / "terms.csv").write_text(f"dof\n{term}\n")
    folder = Folder(tmp_path)
    folder.write(
        {
            "campaign": name,
            "output": "out",
            "model": model,
            "excitation": {"hammer": {"dof": load}},
            "responses": {"r1": {"dof": output, "quantity": "displacement"}},
            "parameters": {"springs": {"select": {"dofs": "terms.csv"}, "initial": 4.0, "bounds": [1.0, 7.0]}},
            "reduction": {"band": band},
        }
    )
    outcome = folder.run("check")
    assert (outcome.code, outcome.stderr) == (0, "")
    inputs = read_as_exported(load_campaign(folder.config))
    if name == "foundation":
        theirs = scipy.io.loadmat(DATA / "nlevp" / "foundation.mat", spmatrix=False)
        assert abs(inputs.model.K + theirs["K"]).max() == 0.0
        assert abs(inputs.model.C - (1j * theirs["D"]).real).max() == 0.0
        # A spring consumes energy.
        assert inputs.model.K.diagonal().imag.min() > 0.0
    assert inputs.model.size == {"speaker_box": 107, "foundation": 3627, "superelement": 90, "punch": 15, "full": 900}[name]


@pytest.mark.parametrize("entries", [200, 10**6])
def test_a_table_in_another_order_is_seen_in_some_entries(monkeypatch: pytest.MonkeyPatch, entries: int) -> None:
    """Of very many entries of a matrix some tell as much as all."""
    monkeypatch.setattr(dof_source, "ENTRIES", entries)
    n, rng = 600, np.random.default_rng(1)
    K = sp.diags_array([-np.ones(n - 1), 2.0 * np.ones(n) + 1e-3, -np.ones(n - 1)], offsets=[-1, 0, 1], format="csc")
    xyz = np.column_stack([np.linspace(0.0, 6.0, n), np.zeros((n, 2))])
    assert order_doubt(K, DofTable(np.arange(n), np.full(n, "UZ"), xyz)) is None
    anew = DofTable(np.arange(n), np.full(n, "UZ"), rng.permutation(xyz))
    assert "sorted by x, but the DOF table is not" in str(order_doubt(K, anew))


def test_rows_in_the_order_of_a_solver_are_told_by_forces_that_no_support_causes() -> None:
    """Neighbours stay near in it, so distances say nothing; a bed of springs, which loads every row, is no reason for a warning."""
    table, K = _beam(300)
    assert order_doubt(K, table) is None
    bed = K + sp.diags_array(np.where(table.component == "UZ", 0.1 * K.diagonal(), 0.0))
    assert order_doubt(sp.csc_array(bed), table) is None
    # Nodes are met in their order, but the two DOFs of each at different times, as by a profile minimiser.
    order = np.argsort(np.arange(600) + np.random.default_rng(1).integers(-4, 5, 600), kind="stable")
    text = str(order_doubt(sp.csc_array(K[order][:, order]), table))
    assert "in another order than the DOF table" in text
    assert "{map: FILE, nodes: FILE}" in text


def _beam(elements: int) -> tuple[DofTable, sp.csc_array]:
    """A slender beam of two DOFs a node, and its stiffness."""
    length = 0.02
    own = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) * length ** np.array([0, 1, 0, 1])
    own = own * length ** np.array([0, 1, 0, 1])[:, None]
    K = sp.lil_array((2 * elements, 2 * elements))
    for k in range(elements - 1):
        at = np.arange(2 * k, 2 * k + 4)
        K[at[:, None], at] += own
    node = np.repeat(np.arange(elements), 2)
    xyz = np.column_stack([length * node, np.zeros((node.size, 2))])
    return DofTable(node, np.tile(np.array(["UZ", "ROTY"]), elements), xyz), sp.csc_array(K)
