"""Reads tables of springs between two nodes, or between a node and ground (the bushings of bolts)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.text.tables import Table, read_table
from lrbc_cli.model.dofs import COMPONENTS

#: Columns with the direction of the local x axis and of a vector in the local xy plane.
AXES = ("x_x", "x_y", "x_z", "y_x", "y_y", "y_z")

#: Advice for a stiffness that is not positive.
_NOT_ABOVE = "write the stiffness of the spring without the sign, or remove the line of a spring that does not exist"

#: Sine of the angle below which two directions count as parallel.
PARALLEL = 1e-6


@dataclass(frozen=True, kw_only=True)
class BushingTable:
    """Springs between two nodes, or to ground.

    Attributes
    ----------
    path : Path
    lines : (m,) tuple of int
        Line of each spring in the file.
    bolt : (m,) tuple of str
    node_a : (m,) int array
    node_b : (m,) tuple of int or None
        None: ground.
    component : (m,) tuple of str
        ``UX UY UZ ROTX ROTY ROTZ`` in local axes.
    stiffness : (m,) float array
        [N/m] or [N m/rad].
    axes : (m, 3, 3) float array
        Local unit vectors x, y and z as rows.
    """

    path: Path
    lines: tuple[int, ...]
    bolt: tuple[str, ...]
    node_a: NDArray[np.int64]
    node_b: tuple[int | None, ...]
    component: tuple[str, ...]
    stiffness: NDArray[np.float64]
    axes: NDArray[np.float64]

    def only(self, component: str) -> BushingTable:
        """The springs with one component."""
        at = np.flatnonzero(np.array(self.component) == component)
        return replace(
            self,
            lines=tuple(self.lines[k] for k in at),
            bolt=tuple(self.bolt[k] for k in at),
            node_a=self.node_a[at],
            node_b=tuple(self.node_b[k] for k in at),
            component=(component,) * at.size,
            stiffness=self.stiffness[at],
            axes=self.axes[at],
        )


def read_bushings(path: Path, bolts: Collection[str] | None = None) -> BushingTable:
    """Read springs: ``bolt, node_a, node_b (empty: ground), component, stiffness``, optionally ``x_x, x_y, x_z, y_x, y_y, y_z``.

    Raises
    ------
    DataError
        With the line number, if a column is missing or unknown, a value is wrong, both nodes are the same, a spring is repeated, or a
        bolt is not in ``bolts``.
    """
    table = read_table(path, ("bolt", "node_a", "component", "stiffness"), ("node_b", *AXES))
    table.names("bolt")
    owners = table.owners(bolts)
    assert owners is not None
    node_a, node_b = table.integers("node_a"), _second_nodes(table)
    component = tuple(cell.upper() for cell in table.text("component"))
    stiffness = table.floats("stiffness")[:, 0]
    axes = _local_axes(table)
    seen: dict[object, int] = {}
    for index, label in enumerate(component):
        if label not in COMPONENTS:
            raise table.error(index, "component", f"one of {listing(list(COMPONENTS))}", table.text("component")[index])
        if not stiffness[index] > 0:
            raise table.error(index, "stiffness", "a number above 0", table.text("stiffness")[index], hint=_NOT_ABOVE)
        first, second = int(node_a[index]), node_b[index]
        if first == second:
            raise table.error(index, "node_b", "another node, or nothing for ground", second, "the spring connects a node to itself")
        at = COMPONENTS.index(label)
        ends = frozenset((first, second))
        key = (ends, at // 3, tuple(np.round(np.outer(axes[index, at % 3], axes[index, at % 3]), 6).ravel().tolist()))
        if key in seen:
            raise table.error(
                index,
                "component",
                "each spring once",
                f"{label} between node {first} and {'ground' if second is None else f'node {second}'}",
                "a spring is given twice in the table",
                _twice(table, seen[key], index, owners, stiffness),
            )
        seen[key] = index
    return BushingTable(
        path=path, lines=tuple(table.lines), bolt=owners, node_a=node_a, node_b=node_b, component=component, stiffness=stiffness, axes=axes
    )


def _twice(table: Table, first: int, second: int, owners: Sequence[str], stiffness: NDArray[np.float64]) -> str:
    """Advice for two lines with the same spring: with different bolts or stiffnesses they are not just copies."""
    held = f"line {table.lines[first]} already contains it"
    if owners[first] != owners[second]:
        return f"{held}, for bolt {owners[first]}; this line is for {owners[second]}: correct the nodes or the bolt of one of the two"
    if stiffness[first] != stiffness[second]:
        values = f"with stiffness {stiffness[first]:g}; this line has {stiffness[second]:g}"
        return f"{held}, {values}: correct the nodes or component of one, or remove the wrong one"
    return f"{held}; remove one of the two"


def _second_nodes(table: Table) -> tuple[int | None, ...]:
    """Node b of each line; None for ground."""
    if "node_b" not in table.columns:
        return (None,) * len(table.rows)
    given = [index for index, cell in enumerate(table.text("node_b")) if cell]
    part = replace(table, rows=[table.rows[index] for index in given], lines=[table.lines[index] for index in given])
    nodes = dict(zip(given, part.integers("node_b").tolist(), strict=True))
    return tuple(nodes.get(index) for index in range(len(table.rows)))


def _local_axes(table: Table) -> NDArray[np.float64]:
    """Local unit vectors as rows, (m, 3, 3); the axes of the model if there are no such columns."""
    given = [name for name in AXES if name in table.columns]
    if not given:
        return np.tile(np.eye(3), (len(table.rows), 1, 1))
    if len(given) < len(AXES):
        raise DataError(
            "local axes need six columns", file=table.path, expected=f"{listing(list(AXES))}, or none of them", found=listing(given)
        )
    values = table.floats(*AXES).reshape(-1, 2, 3)
    length = np.linalg.norm(values, axis=2, keepdims=True)
    for index in np.flatnonzero(length.min(axis=1)[:, 0] == 0.0):
        name = AXES[0] if length[index, 0, 0] == 0.0 else AXES[3]
        raise table.error(int(index), name, "a direction", "(0, 0, 0)", "a local axis has no length")
    x, plane = (values / length).transpose(1, 0, 2)
    z = np.cross(x, plane)
    sine = np.linalg.norm(z, axis=1, keepdims=True)
    for index in np.flatnonzero(sine[:, 0] < PARALLEL):
        text = "(" + ", ".join(f"{value:g}" for value in values[index, 1]) + ")"
        raise table.error(int(index), AXES[3], "a vector that is not along local x", text, "the two vectors of the local axes are parallel")
    z = z / sine
    return np.stack([x, np.cross(z, x), z], axis=1)
