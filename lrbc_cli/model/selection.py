"""Selects DOFs by position, and finds edges among points and the order along each, from coordinates only, not from node numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial import Delaunay, cKDTree

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.model.dofs import DofTable

#: A step of more than this many spacings leads to another edge. One or two missing (e.g. fixed) nodes leave gaps of two or three spacings.
JUMP = 3.5

#: Two nodes up to this many spacings apart are neighbours in any direction, also across a missing corner; beyond, only straight ahead.
STEP = 1.9
#: Cosine of the largest turn across such a gap, and the number of nearest nodes among which neighbours are sought.
STRAIGHT, NEIGHBOURS = 0.34, 12

#: ``is_line``: points within BESIDE times the nearest distance are counted, at most CROWD (typically four) on a line; and the largest
#: ratio of the path through all points to their shortest spanning tree.
BESIDE, CROWD, DETOUR = 2.1, 5, 1.3

#: Points closer than this count as one [m].
ONE_PLACE = 1e-9

#: ``outline``: longest side of a triangle between neighbouring nodes, in spacings; smallest area over longest side squared; and largest
#: distance from a plane over the extent.
LONGEST_SIDE, SLIVER, FLAT = 1.9, 1e-4, 1e-3


def at_node(table: DofTable, node: int, component: str) -> Integers:
    """DOFs of a node with the given component; empty if there is none."""
    return np.flatnonzero((table.node == node) & (table.component == component))


def nearest(table: DofTable, point: Sequence[float], component: str) -> tuple[int, float] | None:
    """The nearest DOF to a point among those with the given component, and its distance [m]; None if there is none."""
    candidates = np.flatnonzero(table.component == component)
    if not candidates.size:
        return None
    distance = np.linalg.norm(table.xyz[candidates] - np.asarray(point, dtype=float), axis=1)
    best = int(np.argmin(distance))
    return int(candidates[best]), float(distance[best])


def coincident(table: DofTable, dof: int) -> list[int]:
    """Numbers of the other nodes at the place of a DOF that have its component, as of another part at a joint; ascending."""
    same = (table.component == table.component[dof]) & (table.xyz == table.xyz[dof]).all(axis=1) & (table.node != table.node[dof])
    return sorted(int(node) for node in table.node[same])


def spacing(table: DofTable, dof: int) -> float:
    """Local mesh size [m]: distance from a DOF to the nearest node elsewhere with the same component; 0 if there is none."""
    away = np.linalg.norm(table.xyz[table.component == table.component[dof]] - table.xyz[dof], axis=1)
    # Nodes of two parts may coincide, as at both ends of a bushing.
    away = away[away > 0.0]
    return float(away.min()) if away.size else 0.0


def in_box(table: DofTable, component: str, box: Sequence[Sequence[float]]) -> Integers:
    """DOFs with the given component inside a box (including its faces), edge by edge and ordered along each edge."""
    low, high = (np.array([axis[side] for axis in box], dtype=float) for side in (0, 1))
    inside = np.all((table.xyz >= low) & (table.xyz <= high), axis=1) & (table.component == component)
    return in_order(table, np.flatnonzero(inside))


def in_order(table: DofTable, dofs: Integers) -> Integers:
    """DOFs edge by edge, ordered along each edge."""
    return dofs[np.concatenate(edges_of(table.xyz[dofs]))] if dofs.size else dofs


def near_line(table: DofTable, component: str, corners: Floats, tolerance: float) -> Integers:
    """DOFs with the given component within ``tolerance`` [m] of a polyline with (m, 3) corners, ordered along it."""
    dofs = np.flatnonzero(table.component == component)
    side = np.diff(corners, axis=0)
    length = np.linalg.norm(side, axis=1)
    before = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    square = np.where(length > 0, length, 1.0) ** 2
    # (dofs, sides): foot of the perpendicular on each side, from 0 to 1 along the side.
    foot = np.clip(np.einsum("ijk,jk->ij", table.xyz[dofs][:, None] - corners[:-1], side) / square, 0.0, 1.0)
    distance = np.linalg.norm(table.xyz[dofs][:, None] - (corners[:-1] + foot[:, :, None] * side), axis=2)
    nearest = np.argmin(np.round(distance, 12), axis=1)
    rows = np.arange(dofs.size)
    position = np.round(before[nearest] + foot[rows, nearest] * length[nearest], 12)
    near = np.flatnonzero(distance[rows, nearest] <= tolerance)
    return dofs[near[np.lexsort((*np.round(table.xyz[dofs[near]], 12).T, position[near]))]]


def near_points(table: DofTable, component: str, points: Floats, radius: float) -> tuple[Integers, Integers]:
    """DOFs with the given component within ``radius`` [m] of points, and their nearest point; sorted by point, then by distance."""
    dofs = np.flatnonzero(table.component == component)
    distance = np.linalg.norm(table.xyz[dofs][:, None] - points, axis=2)
    nearest = np.argmin(distance, axis=1) if points.size else np.zeros(dofs.size, dtype=np.int64)
    away = np.round(distance[np.arange(dofs.size), nearest], 12)
    near = np.flatnonzero(away <= radius)
    near = near[np.lexsort((*np.round(table.xyz[dofs[near]], 12).T, away[near], nearest[near]))]
    return dofs[near], nearest[near]


def outline(xyz: Floats) -> Integers:
    """Indices of points on the border of a plane mesh and of its holes; nodes in re-entrant corners may be missing.

    Parameters
    ----------
    xyz : (k, 3) float array

    Raises
    ------
    ValueError
        If the points do not lie in a plane, lie on a line, or are spaced so unevenly that holes and elements cannot be distinguished.
    """
    centred = xyz - xyz.mean(axis=0)
    _, size, axes = np.linalg.svd(centred, full_matrices=False)
    extent = float(np.abs(centred).max())
    if xyz.shape[0] < 4 or size[1] <= FLAT * size[0]:
        raise ValueError("they lie on a line")
    if np.abs(centred @ axes[2]).max() > FLAT * extent:
        raise ValueError("they do not lie in a plane")
    flat, at = np.unique(np.round(centred @ axes[:2].T, 9), axis=0, return_inverse=True)
    triangles = Delaunay(flat).simplices
    nearest = cKDTree(flat).query(flat, k=2)[0][:, 1]
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    sides = np.stack([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))])
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    # Rounding makes slivers along a straight border; triangles across a hole or a notch are larger than elements.
    longest = sides.max(axis=0)
    triangles = triangles[(longest <= LONGEST_SIDE * nearest[triangles].max(axis=1)) & (area > SLIVER * longest**2)]
    if np.unique(triangles).size < flat.shape[0]:
        raise ValueError("their distances are too unequal to tell holes from elements")
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    found, count = np.unique(edges, axis=0, return_counts=True)
    border = np.zeros(flat.shape[0], dtype=bool)
    border[found[count == 1].ravel()] = True
    return np.flatnonzero(border[at.ravel()])


def edges_of(xyz: Floats) -> list[Integers]:
    """Split points into edges, each ordered along its length; the result does not depend on the order of the points.

    Parameters
    ----------
    xyz : (k, 3) float array

    Returns
    -------
    list of int arrays
        Indices of the points of each edge. A missing corner node, or a gap of one or two nodes straight ahead (``STEP``, ``JUMP``), does
        not end an edge; parallel rows that far apart are separate edges.
    """
    places, at = np.unique(np.round(xyz / ONE_PLACE).astype(np.int64), axis=0, return_inverse=True)
    points = [np.flatnonzero(at.ravel() == k) for k in range(places.shape[0])] if xyz.shape[0] > places.shape[0] else None
    first = np.argsort(at.ravel(), kind="stable")
    where = xyz[first] if points is None else np.stack([xyz[same[0]] for same in points])
    label = _pieces(where)
    found = []
    for k in dict.fromkeys(label.tolist()):
        inside = np.flatnonzero(label == k)
        order = inside[along(where[inside])]
        found.append(first[order] if points is None else np.concatenate([points[i] for i in order]))
    return found


def _pieces(xyz: Floats) -> Integers:
    """(m,) index of the edge of each of m distinct points."""
    m = xyz.shape[0]
    if m < 3:
        return np.zeros(m, dtype=np.int64)
    away, tree = _spanned(xyz)
    nearest = away[:, 1]
    ratio = tree.data / np.maximum(nearest[tree.row], nearest[tree.col])
    neighbours: list[list[int]] = [[] for _ in range(m)]

    def straight(a: int, b: int) -> bool:
        """Whether a is the end of a row (or alone) and b lies straight ahead of it."""
        if len(neighbours[a]) != 1:
            return not neighbours[a]
        before, after = xyz[a] - xyz[neighbours[a][0]], xyz[b] - xyz[a]
        return bool(before @ after >= STRAIGHT * np.linalg.norm(before) * np.linalg.norm(after))

    for k in np.argsort(tree.data, kind="stable"):
        a, b = int(tree.row[k]), int(tree.col[k])
        if ratio[k] <= STEP or (ratio[k] <= JUMP and straight(a, b) and straight(b, a)):
            neighbours[a].append(b)
            neighbours[b].append(a)
    pairs = [(a, b) for a, others in enumerate(neighbours) for b in others]
    joined = sp.coo_array((np.ones(len(pairs)), tuple(np.array(pairs, dtype=np.int32).reshape(-1, 2).T)), shape=(m, m))
    label: Integers = connected_components(joined.tocsr(), directed=False)[1].astype(np.int64)
    return label


def is_line(xyz: Floats) -> bool:
    """Whether ordered points follow one line (straight or curved), rather than fill a face or a body.

    Parameters
    ----------
    xyz : (k, 3) float array
        Points of one edge.
    """
    places: Floats = np.asarray(np.unique(np.round(xyz / ONE_PLACE).astype(np.int64), axis=0) * ONE_PLACE, dtype=float)
    m = places.shape[0]
    if m < 4:
        return True
    away, tree = _spanned(places)
    if np.median((away[:, 1:] <= BESIDE * away[:, [1]]).sum(axis=1)) > CROWD:
        return False
    return bool(arc_length(xyz)[-1] <= DETOUR * tree.data.sum())


def _spanned(xyz: Floats) -> tuple[Floats, sp.coo_array]:
    """Distances of each point to its nearest points (itself first), and the shortest spanning tree of all points."""
    m = xyz.shape[0]
    away, index = cKDTree(xyz).query(xyz, k=min(m, NEIGHBOURS + 1))
    # Graphs of older SciPy take 32-bit indices only.
    pairs = (np.repeat(np.arange(m, dtype=np.int32), away.shape[1] - 1), index[:, 1:].ravel().astype(np.int32))
    tree = minimum_spanning_tree(sp.coo_array((away[:, 1:].ravel(), pairs), shape=(m, m)).tocsr())
    return away, sp.coo_array(tree)


def along(xyz: Floats) -> Integers:
    """Order of points along their principal direction, or, where that jumps to and fro (ring, hook), from neighbour to neighbour."""
    if xyz.shape[0] < 3:
        return np.lexsort(xyz.T[::-1])
    centred = xyz - xyz.mean(axis=0)
    direction = np.linalg.svd(centred, full_matrices=False)[2][0]
    direction = direction * np.sign(direction[int(np.argmax(np.abs(direction)))])
    order = np.argsort(np.round(centred @ direction, 12), kind="stable")
    chain = _chain(xyz, int(order[0]))
    stop = jumps(xyz[chain])
    if stop.size:
        # The chain started between the ends: the point before its first jump is an end.
        chain = _chain(xyz, int(chain[stop[0]]))
    # A straight edge with uneven spacing has steps that look like jumps; its projection is the shorter path then.
    shorter = arc_length(xyz[chain])[-1] < arc_length(xyz[order])[-1] * (1.0 - 1e-9)
    return chain if shorter and not jumps(xyz[chain]).size else order


def _chain(xyz: Floats, start: int) -> Integers:
    """Order of points from ``start``, each time to the nearest point not yet visited."""
    left = np.ones(xyz.shape[0], dtype=bool)
    chain = [start]
    left[start] = False
    while left.any():
        away = np.where(left, np.linalg.norm(xyz - xyz[chain[-1]], axis=1), np.inf)
        chain.append(int(np.argmin(away)))
        left[chain[-1]] = False
    return np.array(chain)


def jumps(xyz: Floats) -> Integers:
    """Steps between successive points that are too long to be steps along one edge.

    Parameters
    ----------
    xyz : (k, 3) float array

    Returns
    -------
    (j,) int array
        Index of the point before each jump: the step is more than ``JUMP`` times the nearest distance of either point.
    """
    if xyz.shape[0] < 3:
        return np.zeros(0, dtype=np.int64)
    places, at = np.unique(xyz, axis=0, return_inverse=True)
    if places.shape[0] < 3:
        return np.zeros(0, dtype=np.int64)
    # In a graded mesh a large step follows a small one, but then one of the two points has no nearer neighbour.
    nearest = cKDTree(places).query(places, k=2)[0][:, 1][at.ravel()]
    steps = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    return np.flatnonzero(steps > JUMP * np.maximum(nearest[1:], nearest[:-1]))


def pitch(xyz: Floats) -> float:
    """Median distance of distinct points (m, 3) to their nearest neighbours; infinite for fewer than two."""
    places = np.unique(xyz, axis=0)
    if places.shape[0] < 2:
        return float("inf")
    return float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))


def arc_length(xyz: Floats) -> Floats:
    """(k,) length along a polyline from its first point [m]."""
    steps = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)]) if xyz.shape[0] else np.zeros(0)


def unit_columns(dofs: Sequence[int] | Integers, n: int, scale: float = 1.0) -> sp.csc_array:
    """(n, m) matrix with one column for each of m DOFs: a unit vector times ``scale``."""
    index = np.asarray(dofs, dtype=np.int64)
    return sp.csc_array((np.full(index.size, scale), (index, np.arange(index.size))), shape=(n, index.size))
