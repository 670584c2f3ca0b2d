"""Parts of a mesh that share nodes, such as a sheet and the ribs on it: where they end, and their shares of the matrices.

An export holds assembled matrices only. A part ends where a plane of nodes has far fewer neighbours on one side. It owns all elements that
touch a node of its own, so only the entries between the nodes on its border are unknown: rigid motions strain no part, which leaves them
free to an extent that a least-norm solution settles. With one part of another material, natural frequencies of plates, ribs and blocks of
solid elements come out within 0.1 to 3 %, those of a box of shells, whose walls share edges, within 1 to 7 % on a regular mesh. If sizes of
neighbouring elements differ by a factor of three, single modes may be far off: what a factor on a share finds has to explain a measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import lsmr

from lrbc_cli.arrays import Bools, Floats, Integers
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.model.fem import FeModel


@dataclass(frozen=True)
class MeshPart:
    """A part of a mesh.

    Attributes
    ----------
    own : (n,) bool array
        DOFs of its own nodes, without those on its border, which belong to the part that carries it.
    K, M : (n, n) csc_array
        Its shares of stiffness and mass; the shares of all parts add up to those of the structure.
    """

    own: Bools
    K: sp.csc_array
    M: sp.csc_array


def mesh_parts(model: FeModel, dofs: DofTable, *, least: float = 0.02, most: int = 24) -> list[MeshPart]:
    """Parts of the structure, joined or not; empty if there is one only, or more than ``most``.

    Parameters
    ----------
    model : FeModel
    dofs : DofTable
        Borders are looked for across the axes of its coordinates.
    least : float
        Share of the nodes that a part has at least.
    most : int
    """
    at = np.flatnonzero(~model.is_acoustic & np.isin(dofs.component, COMPONENTS))
    if not at.size:
        return []
    _, first, node = np.unique(dofs.node[at], return_index=True, return_inverse=True)
    xyz, pairs, few = dofs.xyz[at][first], _joined(model.K, at, node), max(least * first.size, 1.0)
    bodies = [body for body in _connected(pairs, np.arange(first.size)) if body.size >= few]
    parts = [part for body in bodies for part in _split(xyz, _within(pairs, body), body, few)]
    if not 1 < len(parts) <= most:
        return []
    label, own = np.full(first.size, -1), np.full(model.size, -1)
    for k, part in enumerate(parts):
        label[part] = k
    own[at] = label[node]
    whole, K, M, found = model.K.tocsr(), sp.csr_array(model.K.real), model.M.tocsr(), list[MeshPart]()
    for k in range(len(parts)):
        stiffness, mass = _share(K, M, dofs, own == k, own > k)
        K, M = sp.csr_array(K - stiffness), sp.csr_array(M - mass)
        found.append(MeshPart(own == k, _with_loss(stiffness, whole), sp.csc_array(mass)))
    return found


def _joined(K: sp.csc_array, at: Integers, node: Integers, *, least: float = 1e-12) -> Integers:
    """(2, p) numbers of nodes that the stiffness matrix joins, from those of the DOFs ``at``; rounding errors join none."""
    upper, place = sp.triu(K, 1).tocoo(), np.full(K.shape[0], -1)
    place[at] = node
    i, j, diagonal = place[upper.row], place[upper.col], np.sqrt(np.abs(K.diagonal()))
    joined = (i >= 0) & (j >= 0) & (i != j) & (np.abs(upper.data) > least * diagonal[upper.row] * diagonal[upper.col])
    found: Integers = np.unique(np.sort(np.stack([i[joined], j[joined]]), axis=0), axis=1)
    return found


def _with_loss(stiffness: sp.csr_array, K: sp.csr_array) -> sp.csc_array:
    """A share of the real part of a complex stiffness matrix, with the loss factors that its diagonal shows."""
    if K.dtype.kind != "c":
        return sp.csc_array(stiffness)
    diagonal = K.diagonal()
    real = np.where(diagonal.real == 0.0, 1.0, diagonal.real)
    loss = sp.diags_array(diagonal.imag / real)
    return sp.csc_array(stiffness + 0.5j * (loss @ stiffness + stiffness @ loss))


def _split(xyz: Floats, pairs: Integers, nodes: Integers, least: float) -> list[Integers]:
    """Nodes of each part, in an order in which each stands on later ones only.

    Parameters
    ----------
    xyz : (n, 3) float array
        Coordinates of the nodes [m].
    pairs : (2, p) int array
        Nodes of these that the stiffness matrix joins.
    nodes : (m,) int array
        Numbers of the nodes to be split.
    least : float
        Least number of nodes of a part.
    """
    for beyond in _borders(xyz, pairs, nodes, 0.25 * least):
        parts = [part for part in _connected(pairs, beyond) if part.size >= least]
        rest = np.setdiff1d(nodes, np.concatenate([nodes[:0], *parts]))
        if parts and rest.size >= least:
            return [each for part in (*parts, rest) for each in _split(xyz, _within(pairs, part), part, least)]
    return [nodes]


def _within(pairs: Integers, nodes: Integers) -> Integers:
    """(2, k) those of the pairs of which both are among some nodes."""
    found: Integers = pairs[:, np.isin(pairs, nodes).all(axis=0)]
    return found


def _connected(pairs: Integers, nodes: Integers) -> list[Integers]:
    """The connected parts of some nodes."""
    inside = np.searchsorted(nodes, _within(pairs, nodes))
    graph = sp.csr_array((np.ones(inside.shape[1]), (inside[0], inside[1])), shape=(nodes.size, nodes.size))
    label = connected_components(graph, directed=False)[1]
    return [nodes[label == k] for k in range(label.max() + 1)]


def _borders(xyz: Floats, pairs: Integers, nodes: Integers, wide: float, *, fewer: float = 0.5, near: float = 1e-5) -> list[Integers]:
    """Nodes beyond each plane across an axis that has few neighbours there, the fewest first.

    Parameters
    ----------
    xyz, pairs, nodes
        See ``_split``.
    wide : float
        Least number of nodes in such a plane.
    fewer : float
        Largest number of neighbours on one side, as a share of the nodes in the plane.
    near : float
        Nodes whose coordinates differ by this share of the extent lie in one plane.
    """
    found = list[tuple[float, int, Integers]]()
    for axis in range(3):
        x = xyz[nodes, axis]
        order, extent = np.argsort(x), float(np.ptp(x))
        if extent == 0.0:
            continue
        level = np.empty(x.size, dtype=np.int64)
        level[order] = np.concatenate([[0], np.cumsum(np.diff(x[order]) > near * extent)])
        counts, ends = np.bincount(level), level[np.searchsorted(nodes, pairs)]
        both = np.take_along_axis(pairs, np.argsort(ends, axis=0, kind="stable"), axis=0)
        low, high = np.sort(ends, axis=0)
        for k in np.flatnonzero(counts >= max(wide, 3.0)):
            upward, downward = (low <= k) & (high > k), (high >= k) & (low < k)
            for across, far, beyond in ((upward, both[1], level > k), (downward, both[0], level < k)):
                share = np.unique(far[across]).size / counts[k]
                if 0.0 < share <= fewer:
                    found.append((share, len(found), nodes[beyond]))
    return [beyond for *_, beyond in sorted(found, key=lambda each: each[:2])]


def _share(K: sp.csr_array, M: sp.csr_array, dofs: DofTable, mine: Bools, rest: Bools) -> tuple[sp.csr_array, sp.csr_array]:
    """Shares of stiffness (real) and mass of the part with the DOFs ``mine``, which stands on the DOFs ``rest``."""
    own, other = (sp.diags_array(each.astype(float)) for each in (mine, rest))
    across, beside = sp.csr_array(other @ K @ own), sp.csr_array(other @ M @ own)
    stiffness = sp.csr_array(own @ K @ own + across + across.T)
    mass = sp.csr_array(own @ M @ own + beside + beside.T)
    border = np.flatnonzero(np.diff(across.indptr))
    if not border.size:
        return stiffness, mass
    entries, tiny = _on_border(K, across, dofs, border), np.finfo(float).tiny
    # Across a linear element, a consistent mass joins its two sides by half of what each has; lumped masses are shared as the stiffness is.
    coupled, there = beside[border].sum(axis=1), M[border][:, border].sum(axis=1)
    alike = entries.diagonal()[border] / np.maximum(K.diagonal()[border], tiny)
    share, root = np.where((coupled > 0.0) & (there > 0.0), 2.0 * coupled / np.maximum(there, tiny), alike), np.zeros(dofs.size)
    root[border] = np.sqrt(np.clip(share, 0.0, 1.0))
    part = sp.diags_array(root)
    return sp.csr_array(stiffness + entries), sp.csr_array(mass + part @ M @ part)


def _on_border(K: sp.csr_array, across: sp.csr_array, dofs: DofTable, border: Integers, *, free: float = 100.0) -> sp.csr_array:
    """(n, n) entries between the DOFs of a border that belong to a part whose other entries there are ``across``.

    They are the same share of all entries, with a least change by which no rigid motion leaves a force. Changes of entries between the
    DOFs of one node, which follow from the others, count less by the factor ``free``.
    """
    # All components of nodes that are joined: on a regular mesh, entries of the part and of the rest may cancel.
    inner, node = K[border][:, border], np.unique(dofs.node[border], return_inverse=True)[1]
    of_node = sp.csr_array((np.ones(border.size), (np.arange(border.size), node)))
    row, col = sp.triu(of_node @ ((of_node.T @ abs(inner) @ of_node) @ of_node.T)).nonzero()
    diagonal, off = np.sqrt(np.maximum(np.abs(K.diagonal()[border]), np.finfo(float).tiny)), row != col
    unit = diagonal[row] * diagonal[col] * np.where(dofs.node[border[row]] == dofs.node[border[col]], free, 1.0)
    known = across[border].tocoo()
    length = float(np.median(np.linalg.norm(dofs.xyz[border[known.row]] - dofs.xyz[known.col], axis=1))) or 1.0
    force = np.zeros((border.size, 6))
    np.add.at(force, known.row, known.data[:, None] * _rigid(dofs, border[known.row], known.col, length))
    # Of each entry, the forces in its row, and in its column below the diagonal.
    lines, of = np.concatenate([row, col[off]]), np.concatenate([np.arange(row.size), np.flatnonzero(off)])
    moved = np.concatenate([border[col], border[row[off]]])
    values = (unit[of] / diagonal[lines])[:, None] * _rigid(dofs, border[lines], moved, length)
    A = sp.csr_array(sp.vstack([sp.csr_array((each, (lines, of)), shape=(border.size, row.size)) for each in values.T]))
    b, whole = -(force / diagonal[:, None]).T.ravel(), inner[row, col] / unit
    alike = A @ whole
    share = float(np.clip(alike @ b / max(alike @ alike, np.finfo(float).tiny), 0.0, 1.0))
    x = unit * (share * whole + lsmr(A, b - share * alike, atol=1e-12, btol=1e-12, maxiter=10_000)[0])
    i, j = np.concatenate([border[row], border[col[off]]]), np.concatenate([border[col], border[row[off]]])
    return sp.csr_array((np.concatenate([x, x[off]]), (i, j)), shape=K.shape)


def _rigid(dofs: DofTable, about: Integers, at: Integers, length: float) -> Floats:
    """(k, 6) rigid motions at DOFs ``at``: translations, and rotations by 1/``length`` about the places of DOFs ``about``."""
    component, R = dofs.component[at], np.zeros((len(at), 6))
    for k, label in enumerate(COMPONENTS[:3]):
        R[component == label, k] = 1.0
        R[component == COMPONENTS[3 + k], 3 + k] = 1.0 / length
    x, y, z = ((dofs.xyz[at] - dofs.xyz[about]) / length).T
    for label, turns in (("UX", (0.0 * x, z, -y)), ("UY", (-z, 0.0 * x, x)), ("UZ", (y, -x, 0.0 * x))):
        own = component == label
        R[own, 3:] = np.stack(turns, axis=1)[own]
    return R
