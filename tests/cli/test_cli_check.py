"""``check``: what it says of the model, the measurements and the plan; it changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from campaigns import Folder, Matrices, box, chain_folder, frame, spoil

from lrbc_cli import load
from lrbc_cli.campaign.check import _moves_levels, _partly_held
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.units import SI


def section(text: str, title: str) -> list[str]:
    """Lines below a title."""
    lines = text.splitlines()
    start = lines.index(title) + 1
    stop = next((i for i in range(start, len(lines)) if not lines[i].startswith(" ")), len(lines))
    return [line.strip() for line in lines[start:stop]]


def warnings(folder: Folder) -> list[str]:
    result = folder.run("check")
    assert result.code == 0, result.stderr
    return section(result.stdout, "warnings") if "warnings" in result.stdout.splitlines() else []


@pytest.mark.slow
def test_the_plan_of_the_frame(tmp_path: Path) -> None:
    folder = frame(tmp_path / "new")
    before = folder.listing()
    result = folder.run("check")
    assert (result.code, result.stderr) == (0, "")
    assert folder.listing() == before
    files = section(result.stdout, "files")
    assert "stiffness: symmetric banner: the other triangle was filled in" in files
    assert "stiffness: 414 x 414, 9070 non-zeros, matrix-market, float64" in files
    assert "response acc3: row 0 of sensors.mtx, acceleration" in files
    assert "excitation hammer: node 48 UZ, 0.00 mm from the given point" in files
    assert "parameters left_edge: stiffness, 10 terms, 10 parameters, 0.360 m along the edge" in files
    model = section(result.stdout, "model")
    assert model[0] == "414 DOFs: 414 structural, 0 acoustic"
    assert "symmetry: symmetric" in model
    assert any(line.startswith("mass sum over translations: UZ 0.8") for line in model)
    assert "10 rank-one terms (same left and right vectors), 1 excitation(s), 4 response(s), 3 used" in model
    reduced = section(result.stdout, "reduced model")
    assert reduced[0].startswith("band 30 to 500 Hz, tolerance 0.001, back end ")
    assert "cache: miss (the cache is empty); `lrbc reduce` stores the model, and check is faster then" in reduced
    estimate = next(line for line in reduced if line.startswith("estimate:"))
    for part in (" s, a peak of ", " GB", "entries of the factors", "available on this machine"):
        assert part in estimate
    predicted = folder.run("check", "--json").json["reduction"]
    assert predicted["peak_bytes"] > sum(predicted["parts_bytes"].values()) > 0
    assert predicted["seconds"] > 0
    # Non-zeros of this small model: more than its matrix has, less than a full one would.
    assert 9070 / 2 < predicted["factor_nonzeros"] < 414**2
    jobs = section(result.stdout, "jobs")
    assert any(line.startswith("tight: 471 lines from 30 to 500 Hz") and "4 of 4 responses matched" in line for line in jobs)
    # What all of the three share is told once.
    stated = "all jobs: quantities not stated in the file, taken as in the campaign: acc1, acc2, acc3, acc4"
    assert jobs.count(stated) == 1
    assert len(jobs) == 6
    assert jobs[-1].startswith("level misfit with the nearest of the states compared, after a coarse fit of the bolts [dB]: tight ")
    mapping = "all jobs: acc1: record 1 (column acc1_real): acc1, quantity unknown"
    assert mapping not in jobs
    assert section(folder.run("check", "-v").stdout, "jobs").count(mapping) == 1
    assert sum(line.endswith("4 of 4 responses matched; runs (no result yet)") for line in jobs) == 3
    assert "warnings" not in result.stdout.splitlines()


def test_the_plan_for_programs(frame: Folder) -> None:
    before = frame.listing()
    tree = frame.run("check", "--json").json
    assert frame.listing() == before
    assert (tree["dofs"], tree["acoustic_dofs"], tree["terms"]) == (414, 0, 10)
    assert tree["parameters"] == {"left_edge": 10}
    assert tree["responses"] == ["acc1", "acc2", "acc3", "acc4"]
    assert tree["cache"]["hit"] is True
    # Nothing is to be built.
    assert tree["reduction"] is None
    assert tree["jobs"] == {job: {"run": False, "judge": False, "reason": "nothing changed"} for job in ("tight", "loose-2", "loose-all")}
    assert tree["errors"] == {}
    assert tree["warnings"] == []
    assert "model" in tree["text"]


def test_the_picture(frame: Folder) -> None:
    before = frame.listing()
    result = frame.run("check", "--picture")
    assert result.code == 0
    names = ["structure.png", "structure.html"]
    assert section(result.stdout, "picture") == [str(frame.out / name) for name in names]
    assert result.stdout.startswith("picture\n")
    assert "--picture" not in result.stdout
    assert "lrbc check --picture draws" in frame.run("check").stdout
    assert {frame.path / name for name in frame.listing().keys() - before.keys()} == {frame.out / name for name in names}
    assert (frame.out / "structure.png").read_bytes().startswith(b"\x89PNG")
    assert frame.run("check", "--picture", "--json").json["picture"] == [str(frame.out / name) for name in names]
    assert "picture" not in frame.run("check", "--json").json


def test_no_picture_of_a_campaign_without_coordinates(tmp_path: Path) -> None:
    folder = chain_folder(tmp_path / "chain")
    assert section(folder.run("check", "--picture").stdout, "picture") == [
        "none: the campaign gives no coordinates of nodes (`model.dofs`)"
    ]
    assert not list(folder.out.glob("*.png"))


def test_coupling_of_the_box(box: Folder) -> None:
    model = section(box.run("check").stdout, "model")
    assert model[0] == "32 DOFs: 8 structural, 24 acoustic"
    assert any("u-p coupled, M_as = -kappa K_saᵀ with kappa = 1" in line and "symmetrised" in line for line in model)

    def mismatch(matrices: Matrices) -> None:
        A = matrices["K"][:8, 8:]
        A[np.nonzero(A)] *= np.linspace(0.9, 1.1, np.count_nonzero(A))

    spoil(box, mismatch)
    model = section(box.run("check").stdout, "model")
    found = next(line for line in model if line.startswith("symmetry:"))
    assert "not transposes of each other" in found
    assert "LU" in found
    defect = float(found.split("defect ")[1].split(")")[0])
    assert 0.02 < defect < 0.1
    # It still serves: LU takes over.
    assert box.run("reduce").code == 0


def measured_chain(path: Path) -> Folder:
    """The chain with a measurement: flat, but readable."""
    folder = chain_folder(path)
    lines = "".join(f"{f},1,0,1,0\n" for f in range(20, 501, 10))
    (folder.data / "one.csv").write_text("frequency_hz,a_real,a_imag,b_real,b_imag\n" + lines)
    return folder


COMMANDS = [("check",), ("reduce",), ("update",), ("simulate", "--out", "x.csv"), ("plan",)]


@pytest.mark.parametrize("triangle", [np.tril, np.triu])
def test_half_a_symmetric_matrix(tmp_path: Path, triangle: Callable[[np.ndarray], np.ndarray]) -> None:
    folder = measured_chain(tmp_path / "new")
    assert warnings(folder) == []
    whole = folder.inputs().model.K
    spoil(folder, lambda matrices: matrices.update(K=triangle(matrices["K"])))
    side = "lower" if triangle is np.tril else "upper"
    for command, *args in COMMANDS:
        result = folder.run(command, *(tmp_path / arg if arg == "x.csv" else arg for arg in args))
        assert result.code == 3
        assert f"K.mtx: only the {side} triangle of the stiffness matrix is stored" in result.stderr
        assert "symmetric: true" in result.stderr
    tree = folder.tree()
    tree["model"]["stiffness"] = {"file": "data/K.mtx", "symmetric": True}
    folder.write(tree)
    assert warnings(folder) == []
    assert "stiffness: the other triangle was filled in (symmetric: true)" in section(folder.run("check").stdout, "files")
    np.testing.assert_array_equal(folder.inputs().model.K.toarray(), whole.toarray())
    tree["model"]["stiffness"]["symmetric"] = False
    folder.write(tree)
    np.testing.assert_array_equal(folder.inputs().model.K.toarray(), triangle(whole.toarray()))
    assert "relative asymmetry" in folder.run("check").stdout


def test_what_is_called_symmetric_must_be(tmp_path: Path) -> None:
    folder = measured_chain(tmp_path / "new")
    tree = folder.tree()
    tree["model"]["stiffness"] = {"file": "data/K.mtx", "symmetric": True}
    folder.write(tree)
    assert folder.run("check").code == 0

    def unsymmetric(matrices: Matrices) -> None:
        matrices["K"][1, 0] *= 1.01

    spoil(folder, unsymmetric)
    result = folder.run("check")
    assert result.code == 3
    assert "the stiffness matrix is not symmetric" in result.stderr
    # Vectors have no triangles.
    tree["excitation"] = {"hammer": {"vector": {"file": "data/b.mtx", "symmetric": True}}}
    folder.write(tree)
    assert folder.run("check").code == 2


def test_triangles_of_a_coupled_model(tmp_path: Path) -> None:
    """The coupling lies in one triangle of K and in the other of M; lumped masses leave nothing else there."""
    folder = box(tmp_path / "new")
    whole = {name: scipy.io.mmread(folder.data / f"{name}.mtx", spmatrix=False).toarray() for name in "KM"}

    def lumped(matrices: Matrices) -> None:
        for field in (slice(0, 8), slice(8, None)):
            matrices["M"][field, field] = np.diag(matrices["M"][field, field].sum(axis=1))

    spoil(folder, lumped)
    assert folder.run("check").code == 0

    def half(matrices: Matrices) -> None:
        matrices["K"][8:, 8:] = np.tril(whole["K"][8:, 8:])

    spoil(folder, half)
    for symmetric, said in ((None, "only the lower triangle of the stiffness matrix is stored"), (True, "pressures and displacements")):
        tree = folder.tree()
        tree["model"]["stiffness"] = {"file": "data/K.mtx"} | ({"symmetric": True} if symmetric else {})
        folder.write(tree)
        result = folder.run("check")
        assert result.code == 3
        assert said in result.stderr


def test_nothing_is_compared_beside_a_coupling_of_the_wrong_sign(tmp_path: Path) -> None:
    folder = box(tmp_path / "new")

    def turned(matrices: Matrices) -> None:
        matrices["M"][8:, :8] *= -1.0

    spoil(folder, turned)
    result = folder.run("check")
    warnings = section(result.stdout, "warnings")
    assert any("structure and air gain energy from their coupling" in line for line in warnings)
    assert not any("reversed sign" in line for line in warnings)


@pytest.mark.parametrize("command", COMMANDS[:3])
def test_warnings_about_the_model_come_from_every_command_once(tmp_path: Path, command: tuple[str, ...]) -> None:
    folder = measured_chain(tmp_path / "new")

    def held(matrices: Matrices) -> None:
        matrices["K"][0, 0] *= 1e12

    spoil(folder, held)
    result = folder.run(*command)
    assert (result.stdout + result.stderr).count("1 structural DOF has a huge diagonal") == 1


def test_a_table_that_may_have_been_cut_is_told(tmp_path: Path) -> None:
    folder = measured_chain(tmp_path / "new")
    for name in ("terms.csv", "one.csv"):
        file = folder.data / name
        file.write_bytes(file.read_bytes().rstrip(b"\n"))
    found = warnings(folder)
    assert len(found) == 2
    for name in ("terms.csv", "one.csv"):
        assert any(line.startswith(f"{name}: the last line has no line break; if the file was truncated there") for line in found)
    assert folder.run("update", "--dry-run").stderr.count("terms.csv: the last line has no line break") == 1


def test_terms_of_a_list_share_parameters(tmp_path: Path) -> None:
    folder = measured_chain(tmp_path / "new")
    (folder.data / "terms.csv").write_text("dof,parameter\n0,left\n1,left\n2,right\n3,left\n")
    (group,) = folder.inputs().groups
    assert group.parameter.tolist() == [0, 0, 1, 0]
    assert group.xyz is None
    (folder.data / "terms.csv").write_text("dof,parameter,x,y,z\n0,left,0,0,0\n1,left,0.2,0,0\n2,right,0.5,0,0\n3,right,0.7,0,0\n")
    np.testing.assert_allclose(folder.inputs().groups[0].xyz, [[0.1, 0, 0], [0.6, 0, 0]])
    (folder.data / "terms.csv").write_text("dof,screw\n0,B1\n1,B2\n")
    result = folder.run("check")
    assert result.code == 3
    for part in ("terms.csv", "'screw'", "unknown column", "dof, parameter", "x, y, z"):
        assert part in result.stderr


def test_a_list_must_agree_with_the_dof_table(tmp_path: Path) -> None:
    folder = box(tmp_path / "new")
    tree = folder.tree()
    tree["parameters"]["springs"]["select"] = {"dofs": "data/terms.csv"}
    folder.write(tree)
    (folder.data / "terms.csv").write_text("dof,x,y,z\n0,0,0,0\n1,0.3,0,0\n")
    assert folder.run("check").code == 0
    (folder.data / "terms.csv").write_text("dof,x,y,z\n0,0,0,0\n2,0.3,0,0\n")
    result = folder.run("check")
    assert result.code == 3
    assert "DOF 2 has other coordinates than in the DOF table" in result.stderr


def millimetres(text: str, columns: range) -> str:
    """Some columns of a table times 1000."""
    header, *rows = text.splitlines()
    cells = [row.split(",") for row in rows]
    return "\n".join([header, *(",".join(str(1e3 * float(c)) if i in columns else c for i, c in enumerate(row)) for row in cells)]) + "\n"


def test_points_in_millimetres(tmp_path: Path) -> None:
    folder = box(tmp_path / "new")
    tree = folder.tree()
    plain = (folder.data / "bolts.csv").read_text()
    assert folder.run("check").code == 0
    assert "DOF table: x 0 to 2.1, y 0, z 0 to 0.1 m" in section(folder.run("check").stdout, "files")
    (folder.data / "bolts.csv").write_text(millimetres(plain, range(1, 4)))
    result = folder.run("check")
    assert result.code == 3
    for part in (
        "bolts.csv",
        "all 6 bolts lie outside the model by more than its size",
        "B6 at (1500, 10, 0)",
        "these are probably millimetres: divided by 1000 they fit",
        "2.1 m",
    ):
        assert part in result.stderr
    (folder.data / "bolts.csv").write_text(plain)
    tree["excitation"]["hammer"] = {"near": [2100.0, 0.0, 0.0], "component": "UZ"}
    folder.write(tree)
    for command in ("check", "reduce"):
        result = folder.run(command)
        assert result.code == 3
        for part in ("excitation.hammer", "more than its size", "these are probably millimetres"):
            assert part in result.stderr
    # Within its size a point is the user's own affair.
    tree["excitation"]["hammer"]["near"] = [4.0, 0.0, 0.0]
    folder.write(tree)
    assert folder.run("check").code == 0
    tree["excitation"]["hammer"]["near"] = [0.0, 0.0, 7000.0]
    folder.write(tree)
    result = folder.run("check")
    assert result.code == 3
    assert "millimetres" not in result.stderr.split("fix:")[1]


def test_a_dof_table_in_millimetres(tmp_path: Path) -> None:
    folder = frame(tmp_path / "new")
    file = folder.data / "model" / "dofs.csv"
    file.write_text(millimetres(file.read_text(), range(3, 6)))
    result = folder.run("check")
    assert result.code == 3
    for part in ("dofs.csv", "the coordinates do not fit the matrices", "7e+05 m/s", "the coordinates of the DOF table are in millimetres"):
        assert part in result.stderr


RING = [(0.1 * i, 0.0) for i in range(10)] + [(1.0, 0.1 * i) for i in range(6)]


def listed(folder: Folder, places: list[tuple[float, float]], **keys: object) -> Folder:
    """The chain with terms at places of one's own."""
    rows = "".join(f"{i},{x},{y},0\n" for i, (x, y) in enumerate(places))
    (folder.data / "terms.csv").write_text("dof,x,y,z\n" + rows)
    tree = folder.tree()
    tree["parameters"]["springs"] |= keys
    folder.write(tree)
    return folder


SMOOTH = [0.333333, 0.666667, 0.333333]


def test_several_edges_in_one_list(tmp_path: Path) -> None:
    folder = measured_chain(tmp_path / "new")
    sides = [[(0.1 * i, 0.0) for i in range(5)], [(0.1 * i, 2.0) for i in range(5)]]
    # One after the other, to and fro between them, and one that goes on round a corner.
    for places, jumps in (([*sides[0], *sides[1]], 1), ([p for pair in zip(*sides, strict=True) for p in pair], 9), (RING[5:15], 0)):
        listed(folder, places, smoothing=SMOOTH)
        result = folder.run("check")
        assert result.code == (2 if jumps else 0), result.stderr
        if jumps:
            for part in ("parameters.springs.select", "do not lie along one edge", f"{jumps} jump", "one group for each edge"):
                assert part in result.stderr
    # A hat of a bolt reaches across just as smoothing does.
    listed(folder, [*sides[0], *sides[1]], smoothing=None)
    assert folder.run("check").code == 0
    (folder.data / "bolts.csv").write_text("name,x,y,z\nB1,0.1,0,0\nB2,0.3,0,0\nB3,0.1,2,0\nB4,0.3,2,0\n")
    tree = folder.tree() | {"bolts": "data/bolts.csv"}
    # With a weight of values along the edge no changes at bolts are identified.
    folder.write(tree)
    assert folder.run("check").code == 0
    folder.write(tree | {"update": {"reference": "one"}})
    result = folder.run("check")
    assert result.code == 2
    assert "changes at bolts extend across the jumps" in result.stderr


def plate(path: Path) -> Folder:
    """The chain, its DOFs at the nodes of a field of 4 by 3, numbered at random, with two rows of two bolts."""
    folder = measured_chain(path)
    places = [(0.1 * (k % 4), 0.15 * (k // 4)) for k in (7, 2, 9, 0, 11, 4, 6, 1, 10, 3, 8, 5)]
    rows = "".join(f"{i},{100 + i},UZ,{x:.3f},{y:.3f},0\n" for i, (x, y) in enumerate(places))
    (folder.data / "dofs.csv").write_text("dof,node,component,x,y,z\n" + rows)
    (folder.data / "bolts.csv").write_text("name,x,y,z\nB1,0.05,0,0\nB2,0.25,0,0\nB3,0.05,0.3,0\nB4,0.25,0.3,0\n")
    tree = folder.tree()
    tree["model"]["dofs"] = "data/dofs.csv"
    tree["bolts"] = "data/bolts.csv"
    folder.write(tree)
    return folder


ROWS = {"component": "UZ", "along": [[0, 0, 0], [0.3, 0, 0], [5, 0, 0], [5, 0.3, 0], [0.3, 0.3, 0], [0, 0.3, 0]], "tolerance": 0.01}


def test_selecting(tmp_path: Path) -> None:
    folder = plate(tmp_path / "new")
    (folder.data / "nodes.csv").write_text("node\n103\n107\n101\n109\n")

    def selected(**select: object) -> tuple[Inputs, list[str]]:
        tree = folder.tree()
        tree["parameters"]["springs"] |= {"select": select, "smoothing": None if "near_bolts" in select else SMOOTH}
        folder.write(tree)
        inputs = folder.inputs()
        return inputs, [note for note in inputs.notes if note.startswith("parameters springs")]

    nodes, notes = selected(component="UZ", nodes="data/nodes.csv")
    assert notes[1] == "parameters springs: 4 values every 0.1 m, 0.3 m from (0, 0, 0) to (0.3, 0, 0)"
    border, notes = selected(component="UZ", boundary=True)
    assert border.groups[0].count == 10
    assert notes[1].startswith("parameters springs: 10 values 0.1 to 0.15 m apart, ")
    # Two rows on one line: each is a group of its own, and what smooths one does not know the other.
    rows, notes = selected(**ROWS)
    assert [group.name for group in rows.groups] == ["springs-1", "springs-2"]
    assert notes[1] == "parameters springs: 2 edges, made into separate groups: their values are not coupled"
    assert notes[0] == "parameters springs: stiffness, 8 terms, 8 parameters"
    assert notes[3] == "parameters springs-2: 4 values every 0.1 m, 0.3 m from (0.3, 0.3, 0) to (0, 0.3, 0)"
    first, second = rows.groups
    dof = rows.model.terms.left.argmax(axis=0)
    assert nodes.dofs is not None
    np.testing.assert_array_equal(nodes.dofs.node[dof[first.terms]], [103, 107, 101, 109])
    np.testing.assert_array_equal(nodes.dofs.node[dof[second.terms]], [104, 108, 102, 110])
    for group in load(folder.config, cache=folder.cache).parameters([30.0, 40.0]).groups:
        # The row of an end lacks the neighbour that it does not have.
        np.testing.assert_allclose(group.smoothing.sum(axis=1), [1.0, 4 / 3, 4 / 3, 1.0], atol=1e-5)
    bolts, _ = selected(component="UZ", near_bolts=0.06)
    assert bolts.groups[0].bolt is not None
    assert bolts.groups[0].bolt.tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(np.bincount(bolts.groups[0].parameter), [2, 2, 2, 2])


def test_a_face_is_no_edge(tmp_path: Path) -> None:
    """Values that nothing ties may fill one, and every command says so; what ties them to neighbours is refused."""
    folder = plate(tmp_path / "new")
    tree = folder.tree()
    tree["parameters"]["springs"]["select"] = {"component": "UZ", "box": [[0, 1], [0, 1], [0, 0]]}
    tree["parameters"]["springs"]["smoothing"] = SMOOTH
    folder.write(tree)
    refused = folder.run("check")
    assert refused.code == 2
    said = ("springs do not lie on a line, but smoothing mixes", "12 values from (0, 0, 0) to (0.3, 0.3, 0)", "`boundary: true`", "`along`")
    for text in said:
        assert text in refused.stderr, refused.stderr
    tree["parameters"]["springs"]["smoothing"] = None
    update = {"reference": "one"}
    folder.write(tree | {"update": update})
    refused = folder.run("check")
    assert refused.code == 2
    assert "changes at bolts extend along it" in refused.stderr
    # Whatever leads to the approach of the paper: nothing extends along the values then.
    for settings in ({"approach": "paper"}, {"regularisation": 0.04}, {"reference": None}):
        folder.write(tree | {"update": update | settings})
        assert any("not an edge" in line for line in folder.inputs().warnings)
    del tree["bolts"]
    folder.write(tree)
    inputs = folder.inputs()
    assert [line for line in inputs.warnings if "not an edge: select the border of a flat field with `boundary: true`" in line]
    assert "parameters springs: stiffness, 12 terms, 12 parameters" in inputs.notes


def test_selecting_nothing(tmp_path: Path) -> None:
    folder = plate(tmp_path / "new")
    for select, words in (
        ({"component": "UZ", "near_bolts": 15}, ("near_bolts", "less than the distance of neighbouring bolts, 0.2", "in metres")),
        ({"component": "UZ", "boundary": False}, ("expected: true\n", "found:    false")),
        ({"component": "UZ", "box": [[0.01, 0.02], [0, 1], [0, 0]]}, ("box", "x 0 to 0.3", "export the edge pinned")),
        ({"component": "UZ", "near_bolts": 0.01}, ("none for 4, and the nearest node to B1 is 0.05 away", "each of 4 bolts")),
        ({"component": "UZ", "near_bolts": 0.01}, ("near_bolts", "within this radius of B1, B2, B3, B4")),
        ({"component": "UZ", "along": [[0, 0, 1], [1, 0, 1]], "tolerance": 0.1}, ("along", "x 0 to 0.3")),
        ({"component": "UZ", "boundary": True, "box": [[0, 1], [0, 0], [0, 0]]}, ("boundary", "on a line")),
        (
            {"component": "UZ", "along": [[0, 0, 1], [1, 0, 1]]},
            ("the key 'tolerance' must be given too", "expected: {component:, along:, tolerance:}\n"),
        ),
        ({"component": "UZ", "nodes": "data/bolts.csv"}, ("bolts.csv", "node")),
    ):
        tree = folder.tree()
        tree["parameters"]["springs"]["select"] = select
        folder.write(tree)
        result = folder.run("check")
        assert result.code in (2, 3)
        for word in words:
            assert word in result.stderr, result.stderr
        # Nothing was eliminated where the model is not.
        assert "pinned" not in result.stderr or "along" not in select


def test_discrete_bolts_may_lie_apart(tmp_path: Path) -> None:
    folder = measured_chain(tmp_path / "new")
    places = [(0.0, 0.0), (0.1, 0.0), (0.25, 0.0), (2.0, 0.0), (2.1, 0.0), (2.1, 3.0), (2.0, 3.0)]
    listed(folder, places)
    (folder.data / "bolts.csv").write_text("name,x,y,z\n" + "".join(f"B{i},{x},{y},0\n" for i, (x, y) in enumerate(places)))
    folder.write(folder.tree() | {"bolts": "data/bolts.csv"})
    result = folder.run("check")
    assert result.code == 0, result.stderr
    assert any("2 jumps" in line and "the values across them are not coupled" in line for line in section(result.stdout, "files"))
    assert "warnings" not in result.stdout.splitlines()


def test_singular_mass_and_orphans(tmp_path: Path) -> None:
    folder = chain_folder(tmp_path / "new")
    (folder.data / "one.csv").write_text(
        "frequency_hz,a_real,a_imag,b_real,b_imag\n" + "".join(f"{f},1,0,1,0\n" for f in range(20, 501, 10))
    )

    def massless(matrices: Matrices) -> None:
        matrices["M"][4:6] = 0.0

    spoil(folder, massless)
    assert "2 massless DOFs (singular mass matrix): allowed" in folder.run("check").stdout
    assert warnings(folder) == []

    def orphan(matrices: Matrices) -> None:
        matrices["K"] = np.pad(matrices["K"], (0, 1))
        matrices["M"] = np.pad(matrices["M"], (0, 1))

    spoil(folder, orphan)
    assert "fixed DOFs left out: 1 with empty rows in both matrices" in folder.run("check").stdout
    assert warnings(folder) == []


@pytest.mark.parametrize("loss", [0.02, -0.02])
def test_hysteretic_damping(box: Folder, loss: float) -> None:
    def complex_stiffness(matrices: Matrices) -> None:
        matrices["K"] = matrices["K"].astype(complex)
        matrices["K"][:8, :8] *= 1 + 1j * loss

    spoil(box, complex_stiffness)
    result = box.run("check")
    assert result.code == 0
    model = section(result.stdout, "model")
    assert any("stiffness is complex (hysteretic damping), loss factor about" in line for line in model)
    assert any("imaginary part of the stiffness is negative" in line for line in warnings(box)) == (loss < 0)


def test_penalties_are_told(box: Folder) -> None:
    def penalty(matrices: Matrices) -> None:
        matrices["K"][7, 7] *= 1e12

    spoil(box, penalty)
    assert any("1 structural DOF has a huge diagonal" in line for line in warnings(box))


def test_a_distant_node_is_told(box: Folder) -> None:
    box.replace("- 2.0\n    - 0.0\n    - 0.1", "- 1.98\n    - 0.0\n    - 0.1")
    found = [line for line in warnings(box) if "none is left to test" not in line]
    assert len(found) == 1
    assert "responses.mic3: the nearest node 124 is 20.0 mm away (mesh size 87 mm)" in found[0]
    # Once: here it is a finding, elsewhere a word on the way.
    assert "mm away" not in box.run("check").stderr
    assert box.run("update", "--dry-run").stderr.count("warning: responses.mic3: the nearest node 124") == 1
    assert "response mic3: node 124 PRES, 20.00 mm from the given point, pressure" in box.run("check").stdout


def test_a_response_that_is_only_reported_may_be_missing(box: Folder) -> None:
    words = ("update.responses=[mic1, mic2, acc1]", "responses.mic3.record=nothing")
    overrides = tuple(part for word in words for part in ("--override", word))
    result = box.run("check", *overrides)
    assert result.code == 0
    assert "3 of 4 responses matched" in result.stdout
    assert "tight.uff: no record of response mic3, which is only reported; also found in loose.uff" in section(result.stdout, "warnings")
    assert box.run("update", *overrides).code == 0
    tree = box.result("loose")
    assert tree["misfit_db"]["responses"]["mic3"]["final"] is None
    assert tree["misfit_db"]["held_out_final"] is None
    missing, unvalidated = tree["notes"]
    assert missing == "loose.uff: no record of response mic3, which is only reported"
    assert unvalidated.startswith("not validated: the validation channels have no values")
    assert box.run("report").code == 0


def test_lines_beyond_the_band_are_left_out_and_noted(box: Folder) -> None:
    band = ("--override", "reduction.band=[101.0, 301.0]")
    result = box.run("check", *band)
    assert result.code == 0
    assert "tight: 100 lines from 102 to 300 Hz (41 below and 50 above the band left out)" in result.stdout
    assert box.run("update", *band).code == 0
    assert len(box.result("tight")["lines"]["frequency_hz"]) == 100


def test_unusable_measurements_leave_the_rest_of_the_plan(frame: Folder) -> None:
    (frame.data / "frf" / "loose-2.csv").write_bytes(b"")
    before = frame.listing()
    result = frame.run("check")
    assert result.code == 3
    assert frame.listing() == before
    jobs = section(result.stdout, "jobs")
    assert "loose-2: unusable, see its error" in jobs
    for kept in ("tight", "loose-all"):
        assert any(line.startswith(f"{kept}: ") and line.endswith("; kept (nothing changed)") for line in jobs)
    assert (result.stdout + result.stderr).count("loose-2.csv: the file is empty") == 1


def test_no_jobs_yet(tmp_path: Path) -> None:
    folder = box(tmp_path / "new")
    result = folder.run("check", "--override", "jobs={}", "--override", "update.reference=")
    assert result.code == 0
    assert section(result.stdout, "jobs") == ["none"]
    assert folder.run("reduce", "--override", "jobs={}", "--override", "update.reference=").code == 0


def test_check_of_a_fresh_clone_writes_nothing(tmp_path: Path) -> None:
    folder = box(tmp_path / "new")
    before = folder.listing()
    for args in ([], ["--json"], ["-v"], ["-q"]):
        assert folder.run("check", *args).code == 0
    assert folder.listing() == before


def test_alpha_and_beta_exchanged(box: Folder) -> None:
    """Nothing would oscillate; the other way round it does."""
    tree = box.tree()
    tree["model"]["damping"]["structure"] = {"alpha": 2e-5, "beta": 200.0}
    box.write(tree)
    told = " ".join(box.run("check").stdout.split())
    assert "model.damping.structure: with alpha: 2e-05 and beta: 200 nothing in the band oscillates" in told
    assert "they are probably exchanged: write alpha: 200, beta: 2e-05" in told


def test_progress(tmp_path):
    """Each job is told as it is read and compared: a campaign of many keeps nobody waiting without a word."""
    folder = frame(tmp_path)
    jobs = load(folder.config).jobs
    result = folder.run("check", "-v")
    told = [line for line in result.stderr.splitlines() if line.startswith(("reading the measurement of", "comparing"))]
    assert told == [
        *(f"reading the measurement of {name}" for name in jobs),
        *(f"comparing {name} with the model, job {k} of {len(jobs)}" for k, name in enumerate(jobs, 1)),
    ]
    assert not folder.run("check").stderr


def test_the_last_line_says_whether_frfs_were_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clean check is an answer, and one without a comparison is none."""
    folder = frame(tmp_path)
    assert folder.run("check").stdout.splitlines()[-1] == "no warnings"
    with monkeypatch.context() as patch:
        # More is left than usual, and no cause was found.
        patch.setattr("lrbc_cli.campaign.check.NEAR", 0.01)
        last = folder.run("check").stdout.splitlines()[-1]
        assert last.startswith("no warnings, but the reference job is ")
        assert last.endswith("an error of the model may hide loose bolts")
        tree = folder.run("check", "--json").json
        assert (f"no warnings, but {tree['unexplained']}", list(tree["far_db"])) == (last, ["tight"])
        # A warning that says nothing of it leaves that as it is.
        every = f"update.responses=[{', '.join(folder.tree()['responses'])}]"
        told = folder.run("check", "--override", every).stdout
        assert "\nwarnings\n" in told
        assert told.splitlines()[-1].startswith("The reference job is ")
    with monkeypatch.context() as patch:
        # The same of other jobs.
        patch.setattr("lrbc_cli.campaign.check.LEAST_DIFFERENCE", 0.01)
        last = folder.run("check").stdout.splitlines()[-1]
        assert last.startswith("no warnings, but the coarse fit of the bolts leaves much of ")
        assert last.endswith("an error of the model, or more than bolts changed")
    monkeypatch.setattr("lrbc_cli.campaign.looking.first_look.BUILT_WORK", 0.0)
    last = folder.run("check").stdout.splitlines()[-1]
    assert last == "no warnings, but measured and computed FRFs were not compared: see jobs"


@pytest.mark.parametrize(
    ("kind", "detail", "moves"),
    [
        (Kind.UNITS, "", False),
        (Kind.UNITS, "velocity", True),
        (Kind.REVERSED, "", False),
        (Kind.ALONE, "", False),
        (Kind.MATERIAL, "", True),
        (Kind.HAMMER, "", True),
    ],
)
def test_what_leaves_the_levels_as_they_are_explains_no_misfit(kind: Kind, detail: str, moves: bool) -> None:
    """Beside a reversed sign, nothing was said of a model 2.4 dB off, nor of jobs 6 dB away."""
    assert _moves_levels(Finding(text="", kind=kind, detail=detail)) is moves


def test_components_that_the_model_holds_are_listed() -> None:
    """Shells with a held edge and a held corner, beside a solid, which has no rotations; a node without coordinates."""
    names = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")
    held = {(1, "UZ"), (2, "UZ"), (3, "ROTX")}
    rows = [(node, name) for node in range(1, 11) for name in names if (node, name) not in held]
    rows += [(node, name) for node in range(11, 14) for name in names[:3]]
    xyz = np.array([[0.1 * node, 0.2, 0.0] for node, _ in rows])
    xyz[[node == 10 for node, _ in rows]] = np.nan
    dofs = DofTable(node=np.array([node for node, _ in rows]), component=np.array([name for _, name in rows]), xyz=xyz)
    assert _partly_held(dofs, SI) == [
        "partly held: 2 nodes without UZ, x 0.1 to 0.2, y 0.2, z 0 m",
        "partly held: 1 node without ROTX, x 0.3, y 0.2, z 0 m",
    ]
