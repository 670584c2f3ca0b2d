"""Fill-reducing orderings of the union pattern for SuperLU: METIS, or a built-in graph bisection where METIS is not installed."""

from __future__ import annotations

import importlib.util

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components, dijkstra, reverse_cuthill_mckee

#: Parts of at most this many vertices are not divided further.
LEAF = 80


def nested_dissection(pattern: sp.csr_array, method: str = "auto") -> NDArray[np.int64]:
    """Nested-dissection permutation of a structurally symmetric pattern.

    Parameters
    ----------
    pattern : (n, n) csr_array
        Structurally symmetric; values do not matter.
    method : str
        ``metis``, ``bisection`` or ``auto`` (METIS where it is installed).

    Returns
    -------
    (n,) int array
        ``perm[i]`` is the DOF eliminated as the i-th.
    """
    if method == "auto":
        method = "metis" if importlib.util.find_spec("pymetis") else "bisection"
    if method == "metis":
        import pymetis

        graph = without_diagonal(pattern)
        if graph.nnz == 0:
            return np.arange(pattern.shape[0])
        perm, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(graph.indptr, graph.indices))
        return np.asarray(perm, dtype=np.int64)
    return bisection_order(pattern)


def without_diagonal(pattern: sp.csr_array) -> sp.csr_array:
    """The adjacency graph of a pattern: the pattern without its diagonal."""
    coo = pattern.tocoo()
    off = coo.row != coo.col
    ones = np.ones(int(off.sum()), dtype=np.int8)
    return sp.csr_array((ones, (coo.row[off].astype(np.int32), coo.col[off].astype(np.int32))), shape=pattern.shape)


def bisection_order(pattern: sp.csr_array) -> NDArray[np.int64]:
    """Nested dissection by level sets of a breadth-first search from a far-away vertex (George's automatic scheme).

    Parameters
    ----------
    pattern : (n, n) csr_array
        Structurally symmetric.

    Returns
    -------
    (n,) int array
        ``perm[i]`` is the DOF eliminated as the i-th: parts first, their separators last.
    """
    graph = without_diagonal(pattern)
    order = np.empty(graph.shape[0], dtype=np.int64)
    end = graph.shape[0]
    stack: list[tuple[NDArray[np.int64], int]] = []  # vertices, and the position just after the last one they fill

    def push(vertices: NDArray[np.int64], stop: int) -> None:
        if vertices.size:
            stack.append((vertices, stop))

    push(np.arange(graph.shape[0]), end)
    while stack:
        vertices, stop = stack.pop()
        local = graph[vertices][:, vertices].tocsr()
        if vertices.size <= LEAF:
            order[stop - vertices.size : stop] = vertices[reverse_cuthill_mckee(local, symmetric_mode=True)]
            continue
        count, label = connected_components(local, directed=False)
        if count > 1:
            for part in range(count):
                members = vertices[label == part]
                push(members, stop)
                stop -= members.size
            continue
        low, high, separator = _cut(local)
        if not low.any() or not high.any():
            order[stop - vertices.size : stop] = vertices[reverse_cuthill_mckee(local, symmetric_mode=True)]
            continue
        order[stop - int(separator.sum()) : stop] = vertices[separator]
        stop -= int(separator.sum())
        push(vertices[high], stop)
        push(vertices[low], stop - int(high.sum()))
    return order


def _cut(graph: sp.csr_array) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks of two parts of a connected graph, of similar size, and of a small separator between them."""
    level, count = _levels(graph), graph.shape[0]
    size = np.bincount(level)
    below = np.cumsum(size) - size
    # The smallest level with at least a quarter of the vertices on either side; without one, the middle level.
    inner = (below >= 0.25 * count) & (count - below - size >= 0.25 * count)
    cut = int(np.argmin(np.where(inner, size, count))) if inner.any() else int(np.searchsorted(np.cumsum(size), count / 2))
    # Vertices of the cut level without a neighbour above join the lower part, which makes the separator smaller.
    touches = (graph @ (level == cut + 1).astype(np.int32)) > 0
    separator = (level == cut) & touches
    return (level < cut) | ((level == cut) & ~touches), level > cut, separator


def _levels(graph: sp.csr_array) -> NDArray[np.int64]:
    """Breadth-first levels from a pseudo-peripheral vertex of a connected graph."""
    start = int(np.argmin(np.diff(graph.indptr)))
    distance = np.zeros(graph.shape[0])
    for _ in range(3):
        distance = dijkstra(graph, directed=False, indices=start, unweighted=True)
        last = int(np.argmax(distance))
        if last == start:
            break
        start = last
    return distance.astype(np.int64)
