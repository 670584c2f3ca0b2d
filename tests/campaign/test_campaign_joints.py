"""Joints: springs that bolts own, from tables of springs, DOFs or vectors, as one and the same thing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from campaigns import Folder
from grillage import BETA, BOLTS, NOMINAL, dof, grillage, matrices, node
from scipy.spatial.transform import Rotation

import lrbc_cli as lrbc
from lrbc_cli.campaign.reading.joints import aside_text, bushing_vectors
from lrbc_cli.errors import ConfigError, DataError, LrbcError
from lrbc_cli.io.text.bushings import AXES, read_bushings
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.updating.statistics.error_model import ERRORS

#: Two nodes at one place and one further on, six DOFs each; a pressure with the number of a node, which must not be taken for it.
TABLE = DofTable(
    node=np.array([*np.repeat([1, 2, 3], 6), 2]),
    component=np.array([*COMPONENTS * 3, "PRES"]),
    xyz=np.vstack([np.zeros((12, 3)), np.tile([0.0, 0.0, 0.01], (6, 1)), np.ones((1, 3))]),
)
STIFFNESS = np.array([3e6, 5e6, 2e7, 40.0, 70.0, 110.0])


def element(axes: np.ndarray) -> np.ndarray:
    """(6, 6) stiffness of a bushing in the axes of the model: Tᵀ diag(k) T."""
    T = np.kron(np.eye(2), axes)
    return T.T @ np.diag(STIFFNESS) @ T


@pytest.mark.parametrize("other", [None, 2])
@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.4, -1.1, 2.0)])
def test_springs_add_up_to_the_element(tmp_path: Path, other: int | None, angles: tuple[float, float, float]) -> None:
    axes = Rotation.from_euler("xyz", angles).as_matrix().T
    local = ",".join(repr(float(v)) for v in axes[:2].ravel())
    rows = [f"B1,1,{other or ''},{name},{k!r},{local}" for name, k in zip(COMPONENTS, STIFFNESS.tolist(), strict=True)]
    file = tmp_path / "b.csv"
    file.write_text("\n".join([f"bolt,node_a,node_b,component,stiffness,{','.join(AXES)}", *rows]) + "\n")
    vectors, places = bushing_vectors(read_bushings(file), TABLE)
    k, expected = element(axes), np.zeros((19, 19))
    expected[:6, :6] = k
    if other is not None:
        expected[6:12, 6:12], expected[:6, 6:12], expected[6:12, :6] = k, -k, -k
    B = vectors.toarray()
    np.testing.assert_allclose(B @ B.T, expected, rtol=1e-12, atol=1e-9 * STIFFNESS.max())
    assert not places.any()


def test_springs_that_hold_rigid_rotations_are_told(tmp_path: Path) -> None:
    file = tmp_path / "b.csv"
    rows = "B2,1,2,UX,1\nB1,1,3,UZ,1\nB1,1,3,ROTX,1\nB1,1,3,UX,1\n"
    file.write_text(f"bolt,node_a,node_b,component,stiffness\n{rows}")
    table = read_bushings(file)
    # Along the line that joins the nodes, and for rotations, a rigid piece turns freely.
    said = aside_text(table, TABLE)
    assert said.startswith("the nodes of 1 spring lie up to 10 mm off the spring axis; those of the other springs lie on it. ")
    assert "Check whether a node is mistyped: line 5, B1 with nodes 1 (also of B2) and 3." in said
    np.testing.assert_allclose(bushing_vectors(table, TABLE)[1], [[0, 0, 0], *[[0, 0, 0.005]] * 3])


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        ("B1,4,,UZ,1", "line 3, column 'node_a': node 4 does not exist"),
        ("B1,1,4,UZ,1", "line 3, column 'node_b': node 4 does not exist"),
        ("B1,7,,ROTX,1", "line 3, column 'component': node 7 has no DOF ROTX\n  expected: one of UX, UZ\n  found:    ROTX"),
    ],
)
def test_nodes_and_components_that_do_not_exist(tmp_path: Path, row: str, problem: str) -> None:
    table = replace(TABLE, node=np.array([*[1] * 6, *[7] * 2]), component=np.array([*COMPONENTS, "UX", "UZ"]), xyz=np.zeros((8, 3)))
    file = tmp_path / "b.csv"
    file.write_text(f"bolt,node_a,node_b,component,stiffness\nB1,7,,UZ,1\n{row}\n")
    with pytest.raises(DataError, match=problem):
        bushing_vectors(read_bushings(file), table)


def test_a_table_without_rotations_may_have_wrong_labels(tmp_path: Path) -> None:
    table = replace(TABLE, node=np.array([7, 7, 7]), component=np.array(["UX", "UY", "UZ"]), xyz=np.zeros((3, 3)))
    file = tmp_path / "b.csv"
    file.write_text("bolt,node_a,node_b,component,stiffness\nB1,7,,ROTX,1\n")
    with pytest.raises(DataError, match="of a plate in X and Y are UZ, ROTX, ROTY"):
        bushing_vectors(read_bushings(file), table)


def test_a_turned_axis_needs_the_components_that_it_acts_along(tmp_path: Path) -> None:
    table = replace(TABLE, node=np.array([7, 7]), component=np.array(["UX", "UZ"]), xyz=np.zeros((2, 3)))
    file = tmp_path / "b.csv"
    file.write_text(f"bolt,node_a,component,stiffness,{','.join(AXES)}\nB1,7,UX,1,1,1,0,0,1,0\n")
    with pytest.raises(DataError, match=r"node 7 has no DOF UY(.|\n)*found:    UX, which acts along UY there"):
        bushing_vectors(read_bushings(file), table)


@pytest.fixture(scope="module")
def joints(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    return grillage(tmp_path_factory.mktemp("joints") / "campaign", ())


@pytest.fixture
def folder(joints: Folder, tmp_path: Path) -> Folder:
    return joints.copy(tmp_path / "copy")


def with_groups(folder: Folder, groups: dict, **further: object) -> None:
    folder.write({**folder.tree(), "parameters": groups, **further})


class TestOwnership:
    def test_bushings_are_the_spring_of_each_bolt(self, folder: Folder) -> None:
        inputs = folder.inputs()
        assert inputs.bolts is not None
        assert inputs.bolts.name == tuple(BOLTS)
        np.testing.assert_allclose(inputs.bolts.xyz[:, :2], [(0.1 * i, 0.09 * j) for i, j in BOLTS.values()], atol=1e-9)
        left = inputs.model.terms.left.toarray()
        K = left @ left.T
        expected = np.zeros_like(K)
        for i, j in BOLTS.values():
            for component, stiffness in NOMINAL.items():
                expected[dof(i, j, component), dof(i, j, component)] = stiffness
        np.testing.assert_allclose(K, expected, rtol=1e-12)
        for group in inputs.groups:
            assert group.bolt is not None
            assert group.bolt.tolist() == list(range(9))
            assert group.arc_length is None
        assert any("joints: 9 bolts, 3 groups (axial, rocking_x, rocking_y), to ground" in note for note in inputs.notes)

    def test_springs_of_bolts_are_damped_as_the_structure(self, folder: Folder) -> None:
        """An undamped joint of a damped structure makes resonances sharper than any that is measured."""
        assert all(group.damping is not None and group.beta == BETA for group in folder.inputs().groups)
        groups = {name: {**group, "damping": "none"} for name, group in folder.tree()["parameters"].items()}
        with_groups(folder, groups)
        assert all(group.damping is None for group in folder.inputs().groups)
        undamped = folder.tree()
        undamped["model"].pop("damping")
        with_groups(folder, {name: {key: value for key, value in group.items() if key != "damping"} for name, group in groups.items()})
        folder.write({**folder.tree(), "model": undamped["model"]})
        assert all(group.damping is None for group in folder.inputs().groups)

    def test_one_group_for_all_components(self, folder: Folder) -> None:
        """The springs of a bolt in one group share its value."""
        with_groups(folder, {"all": {"select": {"bushings": "data/bushings.csv"}}})
        (group,) = folder.inputs().groups
        assert group.count == 9
        assert group.parameter.tolist() == np.repeat(np.arange(9), 3).tolist()

    def test_springs_in_two_tables_are_told_with_the_component_that_is_missing(self, folder: Folder) -> None:
        lines = (folder.data / "bushings.csv").read_text().splitlines()
        bolt, nodes = lines[1].split(",")[0], lines[1].split(",")[1]
        turned = [line for line in lines[1:] if ",ROTX," in line]
        tables = {"rest": [line for line in lines[1:] if line not in turned], "turned": turned}
        tables["turned"][0] = turned[0].replace("ROTX", "ROTY")
        for name, rows in tables.items():
            (folder.data / f"{name}.csv").write_text("\n".join([lines[0], *rows]) + "\n")
        with_groups(folder, {name: {"select": {"bushings": f"data/{name}.csv"}} for name in tables})
        (said,) = [text for text in folder.inputs().warnings if "contain the same" in text]
        assert said.startswith("parameters rest and turned contain the same 1 spring (rest.csv and turned.csv), which act twice")
        assert f"ROTY of {bolt} (node {nodes})" in said
        assert "These joints lack ROTX, which others have: correct the component of one of the two" in said

    def test_columns_bolt_and_parameter_say_the_same_as_bushings(self, folder: Folder) -> None:
        K, _ = matrices()
        bolts = "name,x,y,z\n" + "".join(f"{name},{0.1 * i},{0.09 * j},0\n" for name, (i, j) in BOLTS.items())
        (folder.data / "bolts.csv").write_text(bolts)
        wanted = {}
        for column in ("bolt", "parameter"):
            for name, component in {"axial": "UZ", "rocking_x": "ROTX", "rocking_y": "ROTY"}.items():
                rows = [f"dof,{column}", *(f"{dof(*at, component)},{bolt}" for bolt, at in BOLTS.items())]
                (folder.data / f"{column}_{name}.csv").write_text("\n".join(rows) + "\n")
                wanted.setdefault(f"dofs by {column}", {})[name] = {"select": {"dofs": f"data/{column}_{name}.csv"}}
                vectors = np.zeros((K.shape[0], 9))
                vectors[[dof(*at, component) for at in BOLTS.values()], np.arange(9)] = 1.0
                scipy.io.mmwrite(folder.data / f"{name}.mtx", vectors)
                places = [f"{0.1 * i},{0.09 * j},0,{bolt}" for bolt, (i, j) in BOLTS.items()]
                (folder.data / f"{column}_{name}_at.csv").write_text("\n".join([f"x,y,z,{column}", *places]) + "\n")
                select = {"vectors": f"data/{name}.mtx", "positions": f"data/{column}_{name}_at.csv"}
                wanted.setdefault(f"vectors by {column}", {})[name] = {"select": select}
        expected = folder.inputs()
        assert expected.bolts is not None
        for groups in wanted.values():
            with_groups(folder, groups, bolts="data/bolts.csv")
            found = folder.inputs()
            assert found.bolts is not None
            assert found.bolts.name == expected.bolts.name
            np.testing.assert_allclose(found.bolts.xyz, expected.bolts.xyz, atol=1e-12)
            for one, other in zip(found.groups, expected.groups, strict=True):
                np.testing.assert_array_equal(one.bolt, other.bolt)
                np.testing.assert_array_equal(one.parameter, other.parameter)
                np.testing.assert_array_equal(one.terms, other.terms)
                assert one.arc_length is None
            scale = np.repeat(np.sqrt(list(NOMINAL.values())), 9)
            np.testing.assert_allclose(found.model.terms.left.toarray() * scale, expected.model.terms.left.toarray(), rtol=1e-12)

    def test_terms_of_one_bolt_share_a_value_and_others_have_their_own(self, folder: Folder) -> None:
        (folder.data / "some.csv").write_text("dof,bolt\n0,A\n3,\n6,A\n9,\n12,B\n")
        with_groups(folder, {"some": {"select": {"dofs": "data/some.csv"}, "initial": 5.0, "bounds": [1.0, 8.0]}})
        inputs = folder.inputs()
        (group,) = inputs.groups
        assert group.parameter.tolist() == [0, 1, 0, 2, 3]
        assert group.bolt is not None
        assert group.bolt.tolist() == [0, -1, -1, 1]
        assert inputs.bolts is not None
        assert inputs.bolts.name == ("A", "B")
        # A stands in the middle of its two nodes.
        np.testing.assert_allclose(inputs.bolts.xyz[0], [0.1, 0.0, 0.0], atol=1e-12)

    @pytest.mark.parametrize(
        ("groups", "file", "error", "problem"),
        [
            ({"select": {"dofs": "data/t.csv"}}, "dof,bolt,parameter\n0,A,p\n3,B,p\n", DataError, "the parameter p belongs to two bolts"),
            (
                {"select": {"bushings": "data/t.csv", "component": "UX"}},
                "bolt,node_a,component,stiffness\nA,1,UZ,1\n",
                ConfigError,
                "no bus",
            ),
            (
                {"select": {"dofs": "data/t.csv"}, "smoothing": [0.3, 0.4, 0.3]},
                "dof,bolt\n0,A\n3,B\n",
                ConfigError,
                "smoothing couples values of different bolts",
            ),
        ],
    )
    def test_what_contradicts_itself_is_refused(
        self, folder: Folder, groups: dict, file: str, error: type[LrbcError], problem: str
    ) -> None:
        (folder.data / "t.csv").write_text(file)
        with_groups(folder, {"t": groups})
        with pytest.raises(error, match=problem):
            folder.inputs()

    def test_a_bolt_that_the_bolts_file_does_not_have(self, folder: Folder) -> None:
        (folder.data / "bolts.csv").write_text("name,x,y,z\nB1,0,0,0\nB2,0.3,0,0\n")
        folder.write({**folder.tree(), "bolts": "data/bolts.csv"})
        with pytest.raises(DataError, match=r"bushings.csv, line 5(.|\n)*unknown\n  expected: one of B1, B2\n  found:    'B5'"):
            folder.inputs()

    def test_bushings_need_a_dof_table(self, folder: Folder) -> None:
        tree = folder.tree()
        del tree["model"]["dofs"]
        tree["excitation"], tree["responses"] = {"hammer": {"dof": 0}}, {"a": {"dof": 3}}
        tree["update"].pop("responses")
        folder.write(tree)
        with pytest.raises(ConfigError, match="needs the DOF table"):
            folder.inputs()

    def test_nodes_that_lie_apart_are_told(self, folder: Folder) -> None:
        (folder.data / "t.csv").write_text(f"bolt,node_a,node_b,component,stiffness\nA,{node(0, 0)},{node(1, 0)},UZ,1e5\n")
        with_groups(folder, {"t": {"select": {"bushings": "data/t.csv"}}})
        assert any("the nodes of 1 spring lie up to 100 mm off the spring axis" in warning for warning in folder.inputs().warnings)


def test_a_plan_of_joints_counts_residuals_as_an_identification_does(joints: Folder) -> None:
    """With four residuals that count as one, the effects of a bolt are half as many standard deviations, but for the priors."""
    study = lrbc.load(joints.config, cache=joints.cache)
    assert study.inputs.statistics.errors.coarsening == 4.0
    alone = study.with_method(statistics=replace(study.inputs.statistics, errors=replace(ERRORS, coarsening=1.0)))
    coarse, fine = (each.plan(draws=0) for each in (study, alone))
    assert (coarse.noise.coarsening, fine.noise.coarsening) == (4.0, 1.0)
    assert coarse.noise.counted == 4.0 * coarse.noise.correlation_factor
    at, without = (np.array([bolt.losses[1].d_prime for bolt in record.bolts]) for record in (coarse, fine))
    assert without.min() > 1.0
    np.testing.assert_allclose(at, without / 2.0, rtol=0.2)
