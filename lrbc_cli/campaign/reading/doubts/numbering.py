"""Detects matrices that end early, and mass and damping matrices whose rows are numbered differently from those of the stiffness."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Bools, Integers, spaced
from lrbc_cli.campaign.reading.dof_source import LEAST_DOFS, MOST_FILLED
from lrbc_cli.config import Campaign
from lrbc_cli.errors import DataError
from lrbc_cli.io.sparse import MatrixFile
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, COMPONENTS, DofTable
from lrbc_cli.model.fem import FeModel

#: Largest number of nodes whose neighbours are examined.
_NODES = 2000


def require_whole(campaign: Campaign, stiffness: MatrixFile, mass: MatrixFile) -> None:
    """Refuse a list of entries that is shorter than the other matrix: without a stated size, a truncated file gives a smaller matrix.

    Raises
    ------
    DataError
    """
    source, sizes = campaign.model, [found.matrix.shape[0] for found in (stiffness, mass)]
    short, file = (stiffness, source.stiffness) if sizes[0] < sizes[1] else (mass, source.mass)
    # A lumped mass may have no entries at the rotations of the last node.
    if short.sized or short.labels is not None or max(sizes) - min(sizes) <= (len(COMPONENTS) if short is mass else 0):
        return
    raise DataError(
        f"the {'stiffness' if short is stiffness else 'mass'} matrix ends early",
        file=file.path,
        place=file.group,
        expected=f"entries of {max(sizes)} rows, as in {(source.mass if short is stiffness else source.stiffness).path.name}",
        found=f"the last row is {min(sizes)}",
        hint="check whether the file was cut off when it was copied. Copy or export it again; otherwise export all matrices of one model "
        "in one run",
    )


def numbering_doubts(model: FeModel, dofs: DofTable | None, *, own_damping: bool = True) -> Iterator[str]:
    """Warnings if mass or damping connect most nodes with nodes beyond the neighbours of their neighbours in the stiffness matrix.

    All matrices of one mesh connect nodes of common elements. Neighbours of neighbours are allowed, because an entry of the stiffness may
    vanish by chance, as between far corners of two right-angled triangles. Single masses and dampers may connect any nodes. Nodes without
    stiffness have no neighbours and say nothing.

    Parameters
    ----------
    model : FeModel
    dofs : DofTable or None
        None: each row is a node.
    own_damping : bool
        Whether damping is a matrix of its own, and not computed from the others.
    """
    if model.size < LEAST_DOFS:
        return
    node = node_of_rows(model.size, dofs)
    meshed = _graph(model.K, node)
    stiff = np.diff(meshed.indptr) > 0
    if not stiff.any():
        return
    some = np.flatnonzero(stiff)[spaced(int(stiff.sum()), _NODES)]
    reached = (meshed[some] @ meshed).tocoo()
    # In a small or dense model all nodes are neighbours.
    if reached.nnz > MOST_FILLED * reached.shape[0] * reached.shape[1]:
        return
    known = reached.row * np.int64(reached.shape[1]) + reached.col
    for name, matrix in (("mass", model.M), *((("damping", model.C),) if own_damping else ())):
        joined = _graph(_of_one_field(matrix, model.is_acoustic), node)[some].tocoo()
        # The flat index of each pair of nodes.
        pairs = joined.row * np.int64(joined.shape[1]) + joined.col
        beyond = (joined.col != some[joined.row]) & stiff[joined.col] & ~np.isin(pairs, known)
        strange = np.unique(joined.row[beyond]).size
        if 2 * strange > some.size:
            yield (
                f"model.{name}: the {name} matrix connects nodes that the stiffness matrix does not ({strange / some.size:.0%} of the "
                "nodes have a partner in it beyond the neighbours of their neighbours in the mesh): its rows are numbered differently, or "
                "it belongs to another mesh. Export stiffness, mass and damping of one model in one run, with one numbering"
            )


def node_of_rows(size: int, dofs: DofTable | None) -> Integers:
    """(n,) index of the node of each row; structure and air are separate, as they may use the same numbers."""
    if dofs is None:
        return np.arange(size)
    of = np.column_stack([dofs.node, dofs.component == ACOUSTIC_COMPONENT])
    found: Integers = np.unique(of, axis=0, return_inverse=True)[1].ravel()
    return found


def _of_one_field(matrix: sp.csc_array, air: Bools) -> sp.csc_array:
    """The matrix without what couples structure and air, which may stand in one of the matrices only."""
    entries = matrix.tocoo()
    own = air[entries.row] == air[entries.col]
    return sp.csc_array((entries.data[own], (entries.row[own], entries.col[own])), entries.shape)


def _graph(matrix: sp.csc_array, node: Integers) -> sp.csr_array:
    """(N, N) adjacency matrix of N nodes: 1 where a matrix connects two nodes in either direction."""
    entries = matrix.tocoo()
    there = entries.data != 0
    row, column, count = node[entries.row[there]], node[entries.col[there]], int(node.max()) + 1
    both = np.concatenate([row, column]), np.concatenate([column, row])
    graph = sp.coo_array((np.ones(both[0].size, dtype=np.int64), both), shape=(count, count)).tocsr()
    graph.data[:] = 1
    return graph
