"""Picking DOFs from the DOF table, and ordering terms along an edge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.model.dofs import DofTable

#: Spacings beyond which the next term is on another edge: one or two nodes that are missing, as fixed ones are, leave gaps of two or three.
JUMP = 3.5


def at_node(table: DofTable, node: int, component: str) -> Integers:
    """DOFs of a node with a component; empty where there is none."""
    return np.flatnonzero((table.node == node) & (table.component == component))


def nearest(table: DofTable, point: Sequence[float], component: str) -> tuple[int, float] | None:
    """The DOF with a component that is nearest to a point, and its distance in metres; None where no DOF has the component."""
    candidates = np.flatnonzero(table.component == component)
    if not candidates.size:
        return None
    distance = np.linalg.norm(table.xyz[candidates] - np.asarray(point, dtype=float), axis=1)
    best = int(np.argmin(distance))
    return int(candidates[best]), float(distance[best])


def spacing(table: DofTable, dof: int) -> float:
    """Distance from a DOF to the nearest other node with the same component: the local mesh size in metres."""
    same = np.flatnonzero((table.component == table.component[dof]) & (table.node != table.node[dof]))
    if not same.size:
        return 0.0
    return float(np.linalg.norm(table.xyz[same] - table.xyz[dof], axis=1).min())


def in_box(table: DofTable, component: str, box: Sequence[Sequence[float]]) -> Integers:
    """DOFs with a component inside a box (borders included), in their order along the edge."""
    low, high = (np.array([axis[side] for axis in box], dtype=float) for side in (0, 1))
    inside = np.all((table.xyz >= low) & (table.xyz <= high), axis=1) & (table.component == component)
    dofs = np.flatnonzero(inside)
    return dofs[along(table.xyz[dofs])] if dofs.size else dofs


def along(xyz: Floats) -> Integers:
    """Order of points along their principal direction; of a ring or a hook, where that jumps to and fro, from neighbour to neighbour."""
    if xyz.shape[0] < 3:
        return np.lexsort(xyz.T[::-1])
    centred = xyz - xyz.mean(axis=0)
    direction = np.linalg.svd(centred, full_matrices=False)[2][0]
    direction = direction * np.sign(direction[int(np.argmax(np.abs(direction)))])
    order = np.argsort(np.round(centred @ direction, 12), kind="stable")
    if not jumps(xyz[order]).size:
        return order
    chain = _chain(xyz, int(order[0]))
    stop = jumps(xyz[chain])
    if stop.size:
        # It began inside: what it came to first is an end.
        chain = _chain(xyz, int(chain[stop[0]]))
    # An uneven straight edge has steps that look like jumps too; there the projection is the shortest way.
    shorter = arc_length(xyz[chain])[-1] < arc_length(xyz[order])[-1] * (1.0 - 1e-9)
    return chain if shorter and not jumps(xyz[chain]).size else order


def _chain(xyz: Floats, start: int) -> Integers:
    """Points from one to the nearest that is left."""
    left = np.ones(xyz.shape[0], dtype=bool)
    chain = [start]
    left[start] = False
    while left.any():
        away = np.where(left, np.linalg.norm(xyz - xyz[chain[-1]], axis=1), np.inf)
        chain.append(int(np.argmin(away)))
        left[chain[-1]] = False
    return np.array(chain)


def jumps(xyz: Floats) -> Integers:
    """Steps between successive points that are no steps along an edge.

    Parameters
    ----------
    xyz : (k, 3) float array

    Returns
    -------
    (j,) int array
        Index of the point before each: the next one is ``JUMP`` times farther away than either has a neighbour.
    """
    if xyz.shape[0] < 3:
        return np.zeros(0, dtype=np.int64)
    places, at = np.unique(xyz, axis=0, return_inverse=True)
    if places.shape[0] < 3:
        return np.zeros(0, dtype=np.int64)
    # Graded meshes have large steps beside small ones, but then one of the two has its nearest neighbour that far.
    nearest = cKDTree(places).query(places, k=2)[0][:, 1][at.ravel()]
    steps = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    return np.flatnonzero(steps > JUMP * np.maximum(nearest[1:], nearest[:-1]))


def arc_length(xyz: Floats) -> Floats:
    """Length along a polygon from its first point [m]."""
    steps = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)]) if xyz.shape[0] else np.zeros(0)


def unit_columns(dofs: Sequence[int] | Integers, n: int, scale: float = 1.0) -> sp.csc_array:
    """(n, m) matrix of unit vectors."""
    index = np.asarray(dofs, dtype=np.int64)
    return sp.csc_array((np.full(index.size, scale), (index, np.arange(index.size))), shape=(n, index.size))
