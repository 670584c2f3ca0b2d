"""Symbolic factorisation: the fill of a sparse Cholesky factor from its elimination tree and column counts, vectorised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import depth_first_order, minimum_spanning_tree

from lrbc_cli.arrays import Integers


@dataclass(frozen=True)
class FactorFill:
    """Size of a Cholesky factor.

    Attributes
    ----------
    counts : (n,) int array
        Entries of each column of the factor, including the diagonal.
    """

    counts: Integers

    @property
    def nonzeros(self) -> int:
        """Entries of one triangular factor, including the diagonal."""
        return int(self.counts.sum())

    @property
    def operations(self) -> float:
        """Multiplications and additions of one factorisation LDLᵀ; LU takes twice as many."""
        return float(np.sum(self.counts.astype(float) ** 2))


def elimination_tree(pattern: sp.csr_array) -> Integers:
    """Parent of every column in the elimination tree, -1 for roots.

    The tree is built by merging components: column i becomes the parent of all components that contain an earlier neighbour of it. This is
    Kruskal's algorithm with max(i, k) as the weight of edge (i, k), so a minimum spanning forest (at most n - 1 edges) has the same tree.

    Parameters
    ----------
    pattern : (n, n) csr_array
        Structurally symmetric, in the order of elimination.

    Returns
    -------
    (n,) int array
    """
    n = pattern.shape[0]
    coo = pattern.tocoo()
    lower = coo.row > coo.col
    row, col = coo.row[lower], coo.col[lower]
    graph: Any = sp.csr_array(((row + 1).astype(float), (row, col)), shape=(n, n))
    forest = minimum_spanning_tree(graph).tocoo()
    last = np.maximum(forest.row, forest.col)
    order = np.argsort(last, kind="stable")
    # Union-find with path halving; the root of a component is its last column.
    parent = [-1] * n
    ancestor = list(range(n))
    for i, k in zip(last[order].tolist(), np.minimum(forest.row, forest.col)[order].tolist(), strict=True):
        while ancestor[k] != k:
            ancestor[k] = ancestor[ancestor[k]]
            k = ancestor[k]
        if k != i:
            parent[k] = i
            ancestor[k] = i
    return np.array(parent, dtype=np.int64)


def column_counts(pattern: sp.csr_array) -> FactorFill:
    """Fill of the Cholesky factor of a pattern, eliminated in its given order.

    The count of column j is the number of row subtrees that contain it; the subtree of row i consists of the tree paths from its neighbours
    k < i up to i. Only its leaves matter: each further leaf adds its path up to the point where it meets that of the leaf before (Gilbert,
    Ng and Peyton, SIAM J. Matrix Anal. Appl. 15, 1994). In postorder, sums over subtrees are differences of one cumulative sum.

    Parameters
    ----------
    pattern : (n, n) csr_array
        Structurally symmetric.

    Returns
    -------
    FactorFill
    """
    n = pattern.shape[0]
    parent = elimination_tree(pattern)
    post = _postorder(parent)
    rank = np.empty(n, dtype=np.int64)
    rank[post] = np.arange(n)
    # Parents in postorder; n is a common parent of all roots.
    above = np.full(n + 1, n, dtype=np.int64)
    known = parent >= 0
    above[rank[known]] = rank[parent[known]]
    size = [1] * (n + 1)
    for j, up in enumerate(above[:n].tolist()):
        size[up] += size[j]
    first = np.arange(n) - np.array(size[:n], dtype=np.int64) + 1

    coo = pattern.tocoo()
    lower = coo.row > coo.col
    row, col = rank[coo.row[lower]], rank[coo.col[lower]]
    # Each edge joins a column (smaller rank) and one of its ancestors.
    row, col = np.maximum(row, col), np.minimum(row, col)
    key = np.sort(row * n + col)
    row, col = key // n, key % n
    fresh = np.ones(row.size, dtype=bool)
    fresh[1:] = row[1:] != row[:-1]
    before = np.where(fresh, -1, np.concatenate([[-1], col[:-1]]))
    leaf = before < first[col]
    row, col = row[leaf], col[leaf]
    alone = np.ones(row.size, dtype=bool)
    alone[1:] = row[1:] != row[:-1]
    delta = np.zeros(n + 1, dtype=np.int64)
    # The subtree of a row without earlier neighbours is the row itself.
    own = np.ones(n, dtype=bool)
    own[row] = False
    np.add.at(delta, np.flatnonzero(own), 1)
    np.add.at(delta, col, 1)
    np.add.at(delta, _meeting(above, col[:-1][~alone[1:]], col[1:][~alone[1:]]), -1)
    np.add.at(delta, above[:n], -1)
    total = np.concatenate([[0], np.cumsum(delta[:n])])
    counts = total[1:] - total[first]
    return FactorFill(counts[rank])


def _postorder(parent: Integers) -> Integers:
    """(n,) columns in postorder (children before parents, subtrees contiguous): the reversed preorder from a common root."""
    n = parent.size
    up = np.where(parent < 0, n, parent)
    tree = sp.csr_array((np.ones(n), (up, np.arange(n))), shape=(n + 1, n + 1))
    order = depth_first_order(tree, n, directed=True, return_predecessors=False)
    return np.asarray(order[:0:-1], dtype=np.int64)


def _meeting(above: Integers, a: Integers, b: Integers) -> Integers:
    """Lowest common ancestors of columns a < b in postorder: the first ancestor of a that does not precede b."""
    jumps = [above]
    while np.any(jumps[-1] != jumps[-1][-1]):
        jumps.append(jumps[-1][jumps[-1]])
    at = a.copy()
    for jump in reversed(jumps):
        further = jump[at]
        at = np.where(further < b, further, at)
    return np.asarray(above[at])
