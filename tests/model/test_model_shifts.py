"""Loads beside their nodes: the work of a force on fields whose gradient is known."""

from __future__ import annotations

import numpy as np
import pytest

from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.shifts import AXES, load_shifts, shift_columns

ROTATIONS = ("ROTX", "ROTY", "ROTZ")


def table(xyz: np.ndarray, components: tuple[str, ...]) -> DofTable:
    """Every node with all components."""
    n, c = xyz.shape[0], len(components)
    return DofTable(np.repeat(np.arange(1, n + 1), c), np.tile(np.array(components), n), np.repeat(xyz, c, axis=0))


def plane(normal: int, steps: int = 5, pitch: float = 0.02) -> np.ndarray:
    along = [a for a in range(3) if a != normal]
    grid = np.stack(np.meshgrid(pitch * np.arange(steps), pitch * np.arange(steps), indexing="ij"), axis=-1).reshape(-1, 2)
    xyz = np.zeros((grid.shape[0], 3))
    xyz[:, along] = grid
    return xyz


@pytest.mark.parametrize("normal", [0, 1, 2])
def test_rotations_of_a_rigid_motion(normal: int) -> None:
    """u = omega x r: the displacement beside the node is that at the node and its rotations times the offset."""
    dofs = table(plane(normal), ("UX", "UY", "UZ", *ROTATIONS))
    omega, origin = np.array([0.3, -0.7, 1.1]), np.array([0.01, 0.02, -0.03])
    motion = np.cross(omega, dofs.xyz - origin)
    x = np.array([motion[i, AXES.index(c[1])] if c.startswith("U") else omega[ROTATIONS.index(c)] for i, c in enumerate(dofs.component)])
    dof = int(np.flatnonzero((dofs.node == 13) & (dofs.component == f"U{AXES[normal]}"))[0])
    found = load_shifts(dofs, dof)
    assert found is not None
    columns, along = found
    assert along == tuple(a for a in AXES if a != AXES[normal])
    offset = np.array([0.004, -0.003])
    moved = np.array(dofs.xyz[dof])
    moved[[AXES.index(a) for a in along]] += offset
    expected = np.cross(omega, moved - origin)[normal]
    # The load there does the work of a unit force on the displacement there.
    assert x[dof] + x @ columns @ offset == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("normal", [0, 1, 2])
def test_a_gradient_through_the_neighbours(normal: int) -> None:
    """Without rotations: exact on linear fields, first order on curved ones."""
    component = f"U{AXES[normal]}"
    xyz = plane(normal)
    dofs = table(xyz, (component,))
    gradient = np.array([1.3, -0.4, 0.9])
    along = [a for a in range(3) if a != normal]
    found = load_shifts(dofs, 12)
    assert found is not None
    columns, _ = found
    np.testing.assert_allclose(columns.T @ (xyz @ gradient + 5.0), gradient[along], rtol=1e-10)
    # A rigid translation does no work on the shift.
    np.testing.assert_allclose(columns.sum(axis=0), 0.0, atol=1e-9)
    # In the middle of its neighbours the curvature drops out.
    curved = ((xyz[:, along] - xyz[12, along]) ** 2).sum(axis=1)
    np.testing.assert_allclose(columns.T @ curved, 0.0, atol=1e-12)


def test_units_do_not_matter_for_the_slope() -> None:
    """Per metre: a mesh twice as large has half the derivative."""
    one, two = (load_shifts(table(scale * plane(2), ("UZ",)), 12) for scale in (1.0, 2.0))
    assert one is not None
    assert two is not None
    np.testing.assert_allclose(one[0], 2.0 * two[0])


def test_nodes_of_another_sheet_count_less() -> None:
    """Two plates over each other: the gradient is that of the sheet that is hit."""
    lower = plane(2)
    upper = lower + np.array([0.0, 0.0, 0.5])
    dofs = table(np.vstack([lower, upper]), ("UZ",))
    found = load_shifts(dofs, 12)
    assert found is not None
    assert not found[0][lower.shape[0] :].any()


@pytest.mark.parametrize(
    ("xyz", "component"),
    [
        (np.zeros((1, 3)), "UZ"),
        (np.array([[0.0, 0, 0], [0.1, 0, 0]]), "UZ"),
        (np.column_stack([np.linspace(0, 1, 6), np.zeros(6), np.zeros(6)]), "UZ"),
        (plane(2), "ROTX"),
        (plane(2), "PRES"),
    ],
    ids=["one node", "two nodes", "a line", "a rotation", "a pressure"],
)
def test_nothing_where_there_is_no_gradient(xyz: np.ndarray, component: str) -> None:
    assert load_shifts(table(xyz, (component,)), 0) is None


def test_columns_side_by_side() -> None:
    dofs = table(plane(2), ("UZ",))
    found = [load_shifts(dofs, at) for at in (6, 12)]
    columns = shift_columns([f[0] for f in found if f is not None])
    assert columns.shape == (25, 4)
    np.testing.assert_array_equal(columns.toarray()[:, 2:], found[1][0])  # type: ignore[index]
