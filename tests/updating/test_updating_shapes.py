"""Changes at bolts as shapes along edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lrbc_cli.model.terms import EdgeDamping, ParameterGroup, Parameterisation
from lrbc_cli.updating.statistics.priors import BOLT_PRIOR, VALUE_PRIOR
from lrbc_cli.updating.unknowns.shapes import Shapes, bolt_shapes, neighbours, node_shapes

Y = np.linspace(0.0, 0.5, 21)
STD = 0.35


def group(name: str = "edge", x: float = 0.0, first: int = 0, kind: str = "stiffness", damping: bool = False, places: bool = True):
    terms = first + np.arange(Y.size)
    xyz = np.column_stack([np.full(Y.size, x), Y, 0 * Y])
    return ParameterGroup(
        name=name,
        kind=kind,
        terms=terms,
        parameter=np.arange(Y.size),
        initial=np.full(Y.size, 4.0),
        bounds=np.tile([0.0, 7.0], (Y.size, 1)),
        smoothing=np.eye(Y.size),
        damping=EdgeDamping(beta=1e-6) if damping else None,
        xyz=xyz if places else None,
        arc_length=Y if places else None,
    )


def along(*y: float, x: float = -0.01) -> np.ndarray:
    return np.array([[x, value, 0.0] for value in y])


def of(shapes: Shapes, size: int = Y.size) -> np.ndarray:
    """(size, bolts) hats of the bolts."""
    return shapes.T[:size, shapes.bolts]


BOLTS = (0.05, 0.15, 0.25, 0.35, 0.45)


def test_every_value_for_itself() -> None:
    parameters = Parameterisation((group(damping=True),))
    found = node_shapes(parameters, STD)
    np.testing.assert_array_equal(found.T, np.eye(Y.size + 1))
    assert np.isinf(found.std[-1])
    np.testing.assert_array_equal(found.std[:-1], STD)
    assert not found.by_bolt
    assert found.bolts.size == 0


class TestHats:
    def test_they_add_up_to_one(self) -> None:
        found = bolt_shapes(Parameterisation((group(),)), along(*BOLTS))
        assert found.by_bolt
        hats = of(found)
        np.testing.assert_allclose(hats.sum(axis=1), 1.0)
        assert hats.min() >= 0.0

    def test_each_is_one_at_its_bolt_and_nothing_at_the_others(self) -> None:
        hats = of(bolt_shapes(Parameterisation((group(),)), along(*BOLTS)))
        at = [int(np.argmin(np.abs(Y - b))) for b in BOLTS]
        np.testing.assert_allclose(hats[at], np.eye(5), atol=1e-12)
        # Between two bolts linear: halfway half.
        np.testing.assert_allclose(hats[int(np.argmin(np.abs(Y - 0.2)))], [0, 0.5, 0.5, 0, 0], atol=1e-12)
        # Beyond the outer bolts the edge goes with them.
        np.testing.assert_allclose(hats[[0, -1]], np.eye(5)[[0, 4]], atol=1e-12)

    def test_the_order_of_the_bolts_does_not_matter(self) -> None:
        order = np.array([3, 0, 4, 1, 2])
        bolts = along(*BOLTS)
        one, other = (of(bolt_shapes(Parameterisation((group(),)), b)) for b in (bolts, bolts[order]))
        np.testing.assert_allclose(other, one[:, order])

    def test_a_bolt_that_no_term_feels_has_no_column(self) -> None:
        found = bolt_shapes(Parameterisation((group(),)), along(*BOLTS, 0.52, 0.60, -0.02, -0.2))
        np.testing.assert_array_equal(found.bolts[[6, 8]], -1)
        assert (found.bolts[[0, 1, 2, 3, 4]] >= 0).all()
        # Just beyond the end it shares the last terms with its neighbour.
        assert found.bolts[5] >= 0
        np.testing.assert_allclose(found.T.sum(axis=1), 1.0)

    def test_a_single_bolt_moves_the_whole_edge(self) -> None:
        found = bolt_shapes(Parameterisation((group(),)), along(0.11))
        np.testing.assert_array_equal(found.T, np.ones((Y.size, 1)))

    def test_bolts_in_one_place_share(self) -> None:
        found = bolt_shapes(Parameterisation((group(),)), along(0.05, 0.25, 0.25, 0.45))
        hats = of(found)
        np.testing.assert_allclose(hats.sum(axis=1), 1.0)
        np.testing.assert_allclose(hats[:, 1], hats[:, 2])
        assert hats.max(axis=0) == pytest.approx([1.0, 0.5, 0.5, 1.0])


class TestGroups:
    def test_several_edges(self) -> None:
        """Each bolt belongs to the nearest edge; an edge without bolts, a damping group and one without places stay values."""
        groups = (
            group("left"),
            group("right", 0.4, Y.size, damping=True),
            group("far", 9.0, 2 * Y.size),
            group("pads", 0.4, 3 * Y.size, kind="damping"),
            group("nowhere", 0.0, 4 * Y.size, places=False),
        )
        parameters = Parameterisation(groups)
        bolts = np.vstack([along(*BOLTS), along(0.1, 0.4, x=0.41)])
        found = bolt_shapes(parameters, bolts)
        slices = {group.name: (values, at) for group, values, at in parameters.placed}
        left, right = slices["left"][0], slices["right"][0]
        np.testing.assert_allclose(found.T[left, :][:, found.bolts[:5]].sum(axis=1), 1.0)
        np.testing.assert_allclose(found.T[right, :][:, found.bolts[5:]].sum(axis=1), 1.0)
        assert not found.T[left, :][:, found.bolts[5:]].any()
        assert not found.T[right, :][:, found.bolts[:5]].any()
        for name in ("far", "pads", "nowhere"):
            block = found.T[slices[name][0], :]
            np.testing.assert_array_equal(block[:, block.any(axis=0)], np.eye(Y.size))
        at = slices["right"][1]
        column = int(np.flatnonzero(found.T[at])[0])
        assert found.T[:, column].sum() == 1.0
        assert found.std[column] == VALUE_PRIOR.damping_std
        np.testing.assert_array_equal(np.delete(found.std, column), STD)
        assert found.T.shape[1] == 7 + 1 + 3 * Y.size

    def test_an_edge_in_two_groups(self) -> None:
        """The second goes on where the first ends: its bolts move its own values."""
        low, high = group("low"), group("high", first=Y.size)
        assert high.xyz is not None
        parameters = Parameterisation((low, replace(high, xyz=high.xyz + np.array([0.0, 0.525, 0.0]))))
        found = bolt_shapes(parameters, along(*BOLTS, 0.57, 0.67, 0.77, 0.87, 0.97))
        np.testing.assert_allclose(found.T[: Y.size, found.bolts[:5]].sum(axis=1), 1.0)
        np.testing.assert_allclose(found.T[Y.size :, found.bolts[5:]].sum(axis=1), 1.0)

    def test_bolts_of_an_edge_that_is_not_identified(self) -> None:
        """They move nothing, and take nothing from the bolts that do."""
        one, parameters = along(*BOLTS), Parameterisation((group(),))
        found = bolt_shapes(parameters, np.vstack([one, along(*BOLTS, x=0.5)]))
        np.testing.assert_array_equal(found.bolts[5:], -1)
        np.testing.assert_array_equal(found.T, bolt_shapes(parameters, one).T)


class TestPenalty:
    @pytest.mark.parametrize("bolts", [BOLTS, (0.25,), (0.05, 0.6), (0.0, 0.5)])
    def test_standard_deviations_of_what_the_shapes_span(self, bolts: tuple[float, ...]) -> None:
        found = bolt_shapes(Parameterisation((group(damping=True),)), along(*bolts))
        z = np.random.default_rng(0).normal(size=found.T.shape[1])
        np.testing.assert_allclose(found.penalty() @ (found.T @ z), z / found.std, atol=1e-10)

    def test_no_prior_no_row(self) -> None:
        rows = node_shapes(Parameterisation((group(damping=True),)), STD).penalty()
        np.testing.assert_allclose(rows[:-1, :-1], np.eye(Y.size) / STD, atol=1e-12)
        assert not rows[-1].any()

    def test_bolts_in_one_place_count_as_their_mean(self) -> None:
        """Two changes of variance v in one place: the edge there moves by their mean, of variance v/2."""
        found = bolt_shapes(Parameterisation((group(),)), along(0.05, 0.25, 0.25, 0.45))
        move = found.T[:, found.bolts[1]] * 2.0
        cost = float(np.sum((found.penalty() @ move) ** 2))
        assert cost == pytest.approx(1.0 / (STD**2 / 2))


def joint_group(name: str, owners: list[int], first: int = 0, kind: str = "stiffness") -> ParameterGroup:
    count = len(owners)
    at = np.arange(count)
    limits = np.tile([-3.0, 3.0], (count, 1))
    return ParameterGroup(
        name=name,
        kind=kind,
        terms=first + at,
        parameter=at,
        initial=np.zeros(count),
        bounds=limits,
        smoothing=np.eye(count),
        bolt=np.array(owners),
    )


class TestJoints:
    def test_one_change_for_all_values_of_a_bolt_wherever_they_lie(self) -> None:
        parameters = Parameterisation((joint_group("axial", [0, 1, 2]), joint_group("rocking", [2, 0], 3)))
        found = bolt_shapes(parameters, np.zeros((3, 3)))
        assert found.joint.all()
        common = found.T[:, found.bolts]
        np.testing.assert_array_equal(common, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [1, 0, 0]])
        np.testing.assert_array_equal(found.std[found.bolts], VALUE_PRIOR.joint_std)
        # B1 has one group only: nothing can deviate.
        assert found.T.shape == (5, 5)
        np.testing.assert_array_equal(np.delete(found.std, found.bolts), BOLT_PRIOR.deviation_std)

    @pytest.mark.parametrize("groups", [2, 3, 5])
    def test_deviations_are_as_if_each_group_had_its_own(self, groups: int) -> None:
        """Independent deviations about a common change, their mean left to it: variance s² (I - 1/g)."""
        parameters = Parameterisation(tuple(joint_group(f"g{i}", [0], i) for i in range(groups)))
        found = bolt_shapes(parameters, np.zeros((1, 3)))
        rest = np.delete(found.T, found.bolts[0], axis=1)
        spread = rest @ np.diag(np.delete(found.std, found.bolts[0]) ** 2) @ rest.T
        np.testing.assert_allclose(spread, BOLT_PRIOR.deviation_std**2 * (np.eye(groups) - 1.0 / groups), atol=1e-15)
        np.testing.assert_allclose(rest.T @ found.T[:, found.bolts[0]], 0.0, atol=1e-15)
        z = np.random.default_rng(0).normal(size=groups)
        np.testing.assert_allclose(found.penalty() @ (found.T @ z), z / found.std, atol=1e-12)

    def test_joints_and_an_edge_in_one_campaign(self) -> None:
        """Hats reach across a bolt that owns its terms as if it were not there; values without a bolt stay values."""
        parameters = Parameterisation((group(), joint_group("joints", [2, -1], Y.size), joint_group("pots", [0], Y.size + 2, "damping")))
        bolts = along(*BOLTS)
        found = bolt_shapes(parameters, bolts)
        assert found.joint.tolist() == [False, False, True, False, False]
        hats = found.T[: Y.size][:, found.bolts[[0, 1, 3, 4]]]
        np.testing.assert_array_equal(hats, of(bolt_shapes(Parameterisation((group(),)), bolts[[0, 1, 3, 4]])))
        assert np.flatnonzero(found.T[:, found.bolts[2]]).tolist() == [Y.size]
        np.testing.assert_array_equal(found.std[found.bolts], [STD, STD, VALUE_PRIOR.joint_std, STD, STD])
        for value in (Y.size + 1, Y.size + 2):
            column = np.flatnonzero(found.T[value])
            assert column.size == 1
            assert found.T[:, column[0]].sum() == 1.0
        assert neighbours(parameters, bolts, found) == [(0, 1), (1, 3), (3, 4)]

    def test_bolts_without_terms(self) -> None:
        found = bolt_shapes(Parameterisation((joint_group("axial", [1]),)), np.zeros((3, 3)))
        assert (found.bolts >= 0).tolist() == [False, True, False]
        assert found.joint.tolist() == [False, True, False]
        # What no term feels makes no edge of a structure that has none.
        assert found.joints_only
        assert not bolt_shapes(Parameterisation((group(),)), along(*BOLTS)).joints_only

    @pytest.mark.parametrize(
        ("places", "expected"),
        [
            ([[np.cos(a), np.sin(a), 0] for a in np.arange(8) * np.pi / 4], {(i, (i + 1) % 8) for i in range(8)}),
            (
                [[x, 2 * y, 0] for y in range(2) for x in range(4)],
                {(0, 1), (1, 2), (2, 3), (4, 5), (5, 6), (6, 7), (0, 4), (1, 5), (2, 6), (3, 7)},
            ),
            ([[0, 0, 0]], set()),
            ([[0, 0, 0], [5, 0, 0]], {(0, 1)}),
        ],
        ids=["ring", "grid", "single", "two"],
    )
    def test_neighbours_come_from_distances(self, places: list, expected: set) -> None:
        xyz = np.array(places, dtype=float)
        order = np.random.default_rng(1).permutation(len(places))
        parameters = Parameterisation((joint_group("axial", list(range(len(places)))),))
        found = neighbours(parameters, xyz[order], bolt_shapes(parameters, xyz[order]))
        assert {tuple(sorted((int(order[a]), int(order[b])))) for a, b in found} == {tuple(sorted(pair)) for pair in expected}


class TestMirrored:
    def of(self, xyz: np.ndarray, one: int, other: int) -> set[tuple[int, int]]:
        count = len(xyz)
        shapes = Shapes(T=np.eye(count + 1), std=np.ones(count + 1), bolts=np.arange(count) + 1, joint=np.ones(count, dtype=bool))
        return {tuple(sorted(pair)) for pair in shapes.mirrored(xyz, one, other)}

    def test_a_row(self) -> None:
        row = along(0.0, 0.1, 0.3, 0.4)
        assert self.of(row, 1, 4) == {(1, 4), (2, 3)}
        assert self.of(row, 4, 1) == {(1, 4), (2, 3)}
        # Not symmetric about the middle of these two.
        assert self.of(row, 1, 2) == {(1, 2)}
        assert self.of(along(0.0, 0.1, 0.33, 0.4), 1, 4) == {(1, 4)}

    def test_a_ring_is_mirrored_between_any_two(self) -> None:
        angle = 2 * np.pi * np.arange(6) / 6
        ring = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
        assert self.of(ring, 1, 2) == {(1, 2), (3, 6), (4, 5)}
        # Two bolts lie in the plane and stay.
        assert self.of(ring, 2, 6) == {(2, 6), (3, 5)}

    def test_two_in_one_place(self) -> None:
        assert self.of(along(0.1, 0.1, 0.3), 1, 2) == {(1, 2)}
