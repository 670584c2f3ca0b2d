"""Picking DOFs and ordering them along an edge."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.selection import along, arc_length, at_node, in_box, jumps, nearest, spacing, unit_columns


def table(xyz, components=("UZ", "ROTY")):
    """Every node with every component, and one pressure node beside node 1."""
    xyz = np.asarray(xyz, dtype=float)
    node = np.repeat(np.arange(1, len(xyz) + 1), len(components))
    component = np.tile(components, len(xyz))
    return DofTable(
        np.append(node, 900),
        np.append(component, "PRES").astype(str),
        np.vstack([np.repeat(xyz, len(components), axis=0), xyz[:1] + 0.001]),
    )


# The nodes of an edge along y, numbered out of order, and one node off the edge.
NODES = np.array([[0.0, 0.3, 0.0], [0.0, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.1, 0.0], [0.5, 0.1, 0.0]])


def test_at_node():
    dofs = table(NODES)
    np.testing.assert_array_equal(at_node(dofs, 3, "ROTY"), [5])
    assert at_node(dofs, 3, "PRES").size == 0
    assert at_node(dofs, 44, "UZ").size == 0


def test_nearest_looks_at_the_component_only():
    dofs = table(NODES)
    found = nearest(dofs, [0.001, 0.301, 0.001], "UZ")
    assert found is not None
    assert found[0] == 0
    assert found[1] == pytest.approx(np.sqrt(3) * 1e-3)
    assert nearest(dofs, [0.5, 0.1, 0.0], "PRES")[0] == dofs.size - 1
    assert nearest(dofs, [0, 0, 0], "UX") is None


def test_spacing_is_the_distance_to_another_node():
    dofs = table(NODES)
    assert spacing(dofs, 0) == pytest.approx(0.1)
    assert spacing(dofs, 8) == pytest.approx(0.5)
    assert spacing(dofs, dofs.size - 1) == 0.0


def test_box_includes_its_borders_and_orders_along_the_edge():
    dofs = table(NODES)
    found = in_box(dofs, "ROTY", [[-0.01, 0.01], [0.0, 0.3], [0.0, 0.0]])
    np.testing.assert_allclose(dofs.xyz[found, 1], [0.0, 0.1, 0.2, 0.3])
    assert set(dofs.component[found]) == {"ROTY"}
    assert in_box(dofs, "ROTY", [[1.0, 2.0], [0.0, 0.3], [0.0, 0.0]]).size == 0
    assert in_box(dofs, "UX", [[-1, 1], [-1, 1], [-1, 1]]).size == 0


@given(st.integers(1, 15), st.tuples(*[st.floats(-1, 1)] * 3), st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
@example(9, (0.0, 0.0, -1.0), 1779)  # uneven: begun anew from the point before a large step, it went to and fro
def test_along_orders_any_straight_edge_in_one_direction(count, direction, seed):
    direction = np.asarray(direction)
    if np.linalg.norm(direction) < 0.1:
        direction = np.array([1.0, 0.0, 0.0])
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.uniform(0.01, 0.1, size=count))
    xyz = rng.permutation(at)[:, None] * direction + rng.uniform(-5, 5, size=3)
    order = along(xyz)
    assert sorted(order) == list(range(count))
    position = xyz[order] @ direction
    assert np.all(np.diff(position) > 0) or np.all(np.diff(position) < 0)


def test_along_runs_with_the_largest_axis():
    assert along(np.array([[0, 0.2, 0], [0, 0.1, 0], [0, 0.4, 0.0]])).tolist() == [1, 0, 2]
    assert along(np.array([[0.2, 0, 0], [0.1, 0, 0]])).tolist() == [1, 0]


def test_arc_length_follows_the_corner():
    np.testing.assert_allclose(arc_length(np.array([[0.0, 0, 0], [3.0, 0, 0], [3.0, 4.0, 0], [3.0, 4.0, 0.5]])), [0, 3, 7, 7.5])
    assert arc_length(np.zeros((0, 3))).shape == (0,)
    assert arc_length(np.ones((1, 3))).tolist() == [0.0]


def test_unit_columns():
    np.testing.assert_array_equal(unit_columns([3, 1], 4, -2.0).toarray(), -2.0 * np.eye(4)[:, [3, 1]])


def ring(width, height, step):
    """Nodes round a rectangle, its corners left out, as exporters of clamped corners leave them."""
    x, y = np.arange(step, width - step / 2, step), np.arange(step, height - step / 2, step)
    sides = [
        np.column_stack([x, 0 * x]),
        np.column_stack([0 * y + width, y]),
        np.column_stack([x, 0 * x + height]),
        np.column_stack([0 * y, y]),
    ]
    return np.column_stack([np.vstack(sides), np.zeros(2 * (x.size + y.size))])


@pytest.mark.parametrize("seed", range(3))
def test_along_goes_round_a_ring(seed):
    xyz = np.random.default_rng(seed).permutation(ring(1.0, 0.5, 0.05))
    order = along(xyz)
    assert sorted(order) == list(range(len(xyz)))
    steps = np.linalg.norm(np.diff(xyz[order], axis=0), axis=1)
    # Steps along the sides and round three corners: the whole way but the one that would close it.
    assert steps.max() == pytest.approx(0.05 * np.sqrt(2))
    assert steps.sum() <= 3.0


@pytest.mark.parametrize("seed", range(3))
def test_along_follows_a_hook_from_an_end(seed):
    at = 0.1 * np.arange(12)
    hook = np.vstack(
        [np.column_stack([at, 0 * at]), [[1.1, 0.1], [1.1, 0.2], [1.1, 0.3], [1.1, 0.4]], np.column_stack([at[::-1], 0 * at + 0.5])]
    )
    xyz = np.random.default_rng(seed).permutation(np.column_stack([hook, np.zeros(len(hook))]))
    steps = np.linalg.norm(np.diff(xyz[along(xyz)], axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.1, rtol=1e-9)


def line(*x):
    return np.column_stack([x, np.zeros((len(x), 2))])


@pytest.mark.parametrize(
    ("xyz", "expected"),
    [
        (line(0, 1, 2, 3, 4), []),
        # One or two nodes are missing; then a whole piece is.
        (line(0, 1, 3, 4, 7, 8), []),
        (line(0, 1, 2, 6, 7, 8), [2]),
        # Graded: the step is large, but so is the next.
        (line(0, 1, 2, 12, 22, 32), []),
        (line(0, 10, 1, 11, 2, 12), [0, 1, 2, 3, 4]),
        # Two components of each node.
        (line(0, 0, 1, 1, 2, 2, 9, 9, 10, 10), [5]),
        (line(0, 9), []),
        (np.zeros((4, 3)), []),
    ],
)
def test_jumps(xyz, expected):
    assert jumps(xyz).tolist() == expected
