"""Data for the picture of a structure: its nodes, thinned if there are many, its edges, and bolts, loads, sensors and terms."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from lrbc_cli.arrays import Bools, Floats, Integers
from lrbc_cli.campaign.reading.groups import TermGroup
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.results.structure import StructureRecord

#: Largest number of nodes drawn.
MOST = {"structure": 2200, "acoustic": 700}

#: Largest distance of a mid-side node from the middle of its edge, as a share of the edge.
_BESIDE = 0.15

#: Number of edges that are processed at a time.
_CHUNK = 4096


def structure_of(inputs: Inputs) -> StructureRecord:
    """Structure as it is drawn, or the reason why there is no picture.

    Parameters
    ----------
    inputs : Inputs

    Returns
    -------
    StructureRecord
        Coordinates in metres, rounded to a millionth of the model's size.
    """
    table, name = inputs.dofs, inputs.campaign.name
    if table is None:
        return StructureRecord.checked({"campaign": name, "reason": "the campaign gives no coordinates of nodes (`model.dofs`)"})
    inner = np.char.startswith(table.component.astype(np.str_), "INNER")
    size = float(np.ptp(table.xyz[~inner], axis=0).max()) if not inner.all() else 0.0
    if size == 0.0:
        return StructureRecord.checked({"campaign": name, "reason": "all nodes of `model.dofs` lie at one point"})
    digits = int(np.ceil(-np.log10(1e-6 * size)))
    fields, notes = [], []
    for field, mask in (("structure", ~table.is_acoustic & ~inner), ("acoustic", table.is_acoustic & ~inner)):
        if mask.any():
            drawn, note = _field(inputs.model.K, table, mask, field)
            fields.append(drawn | {"xyz": np.round(drawn["xyz"], digits)})
            notes += [note] if note else []
    bolts = inputs.bolts
    tree = {
        "campaign": name,
        "fields": fields,
        "bolts": [] if bolts is None else [{"name": n, "position": p} for n, p in zip(bolts.name, bolts.xyz, strict=True)],
        "excitations": [
            {"name": load, "quantity": "force", **_place(table, inputs.model.B[:, [k]])} for k, load in enumerate(inputs.excitations)
        ],
        "responses": [
            {"name": r.name, "quantity": r.quantity, "used": bool(i in inputs.used), **_place(table, inputs.model.L[[i]].T.tocsc())}
            for i, r in enumerate(inputs.responses)
        ],
        "terms": [_terms(inputs, table, group) for group in inputs.groups if group.xyz is not None],
        "notes": notes,
    }
    return StructureRecord.checked(tree)


def drawn_dofs(inputs: Inputs) -> Integers:
    """(n, 3) translational DOFs of the n drawn nodes of the structure, -1 if a node lacks one; empty without a picture."""
    table = inputs.dofs
    none = np.zeros((0, 3), dtype=np.int64)
    if table is None:
        return none
    dofs = np.flatnonzero(~table.is_acoustic & ~np.char.startswith(table.component.astype(np.str_), "INNER"))
    if not dofs.size or not np.ptp(table.xyz[dofs], axis=0).any():
        return none
    nodes, first = np.unique(table.node[dofs], return_index=True)
    drawn = nodes[thinned(table.xyz[dofs][first], MOST["structure"])[1]]
    found = np.full((drawn.size, 3), -1, dtype=np.int64)
    order = np.argsort(drawn)
    for axis, component in enumerate(COMPONENTS[:3]):
        moving = dofs[table.component[dofs] == component]
        at = order[np.searchsorted(drawn, table.node[moving], sorter=order).clip(max=drawn.size - 1)]
        own = drawn[at] == table.node[moving]
        found[at[own], axis] = moving[own]
    return found if (found >= 0).any() else none


def _field(K: sp.csc_array, table: DofTable, mask: Bools, field: str) -> tuple[dict[str, Any], str]:
    """Nodes and lines of one field (DOFs of ``mask``), and a note if nodes were left out."""
    dofs = np.flatnonzero(mask)
    _, first, node = np.unique(table.node[dofs], return_index=True, return_inverse=True)
    xyz = table.xyz[dofs][first]
    group, kept = thinned(xyz, MOST[field])
    drawn = xyz[kept]
    note = "" if kept.size == xyz.shape[0] else f"{kept.size} of {xyz.shape[0]} {field} nodes are drawn"
    lines = np.zeros((0, 2), dtype=np.int64)
    if field == "structure":
        # Neighbours are nodes coupled by the stiffness, for models of any program; lines through the air would hide the structure.
        row_of = np.full(table.size, -1)
        row_of[dofs] = group[node]
        entries = K.tocoo()
        a, b = row_of[entries.row], row_of[entries.col]
        pairs = np.unique((a * kept.size + b)[(a >= 0) & (a < b)])
        coupled = np.column_stack([pairs // kept.size, pairs % kept.size])
        lines = without_chords(drawn, neighbours(drawn, coupled), coupled)
    return {"field": field, "count": int(xyz.shape[0]), "xyz": drawn, "lines": lines.ravel().tolist()}, note


def thinned(xyz: Floats, most: int) -> tuple[Integers, Integers]:
    """Thin out nodes on a coarser raster if there are too many.

    Parameters
    ----------
    xyz : (n, 3) float array
    most : int
        Largest number of nodes kept.

    Returns
    -------
    (n,) int array
        Position in the second array of the node that represents each node.
    (m,) int array
        Indices of the nodes kept, m at most ``most``: in each cell the one nearest to its centre. End cells are centred on the ends of
        the model.
    """
    n = xyz.shape[0]
    group = np.arange(n)
    if n <= most:
        return group, group
    low, extent = xyz.min(axis=0), np.ptp(xyz, axis=0)
    sample = xyz[:: max(1, n // 500)]
    step = float(np.median(cKDTree(xyz).query(sample, k=2)[0][:, 1])) or 1e-3 * float(extent.max())
    times, kept = 1, group
    while kept.size > most:
        times = max(times + 1, int(times * (kept.size / most) ** (1 / 3)))
        count = np.rint(extent / (times * step))
        size = np.where(count > 0, extent / np.maximum(count, 1), np.inf)
        at = (xyz - low) / size
        cell = np.rint(at)
        key = (cell[:, 0] * (count[1] + 1) + cell[:, 1]) * (count[2] + 1) + cell[:, 2]
        # Sorted so that the node nearest to the centre comes first in its cell.
        order = np.lexsort((np.round(((at - cell) ** 2).sum(axis=1), 6), key))
        _, first, inverse = np.unique(key[order], return_index=True, return_inverse=True)
        kept = order[first]
        group[order] = inverse
    return group, kept


def neighbours(xyz: Floats, pairs: Integers) -> Integers:
    """Pairs of coupled nodes without a common neighbour nearer to both (relative neighbours): sides of elements without diagonals.

    Parameters
    ----------
    xyz : (n, 3) float array
    pairs : (m, 2) int array
        Coupled nodes, each pair once.

    Returns
    -------
    (k, 2) int array
    """
    length = np.linalg.norm(xyz[pairs[:, 0]] - xyz[pairs[:, 1]], axis=1)
    pairs, length = pairs[length > 0], length[length > 0]
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    begin = np.searchsorted(both[:, 0], np.arange(xyz.shape[0] + 1))
    degree = np.diff(begin)
    swap = degree[pairs[:, 0]] > degree[pairs[:, 1]]
    ends = np.where(swap[:, None], pairs[:, ::-1], pairs)
    keep = np.ones(len(ends), dtype=bool)
    for start in range(0, len(ends), _CHUNK):
        own = ends[start : start + _CHUNK]
        count = degree[own[:, 0]]
        of = np.repeat(np.arange(len(own)), count)
        offset = np.arange(of.size) - np.repeat(np.cumsum(count) - count, count)
        third = xyz[both[begin[own[of, 0]] + offset, 1]]
        far = np.maximum(np.linalg.norm(third - xyz[own[of, 0]], axis=1), np.linalg.norm(third - xyz[own[of, 1]], axis=1))
        keep[start + of[far < (1.0 - 1e-6) * length[start + of]]] = False
    return np.asarray(pairs[keep])


def without_chords(xyz: Floats, lines: Integers, coupled: Integers) -> Integers:
    """Lines without those between two mid-side nodes of quadratic elements, which would end as stubs at the rim of the structure.

    A mid-side node stands near the middle of two coupled nodes (in linear elements there is none), with lines to both.

    Parameters
    ----------
    xyz : (n, 3) float array
    lines : (k, 2) int array
        Those of ``neighbours``.
    coupled : (m, 2) int array
        Coupled nodes, each pair once, the smaller number first.

    Returns
    -------
    (j, 2) int array
    """
    if not len(lines):
        return lines
    ends = xyz[coupled]
    far, between = cKDTree(xyz).query(ends.mean(axis=1))
    keys = np.sort(lines.min(axis=1) * len(xyz) + lines.max(axis=1))

    def joined(a: Integers, b: Integers) -> Bools:
        return np.isin(np.minimum(a, b) * len(xyz) + np.maximum(a, b), keys)

    found = far <= _BESIDE * np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    found &= joined(between, coupled[:, 0]) & joined(between, coupled[:, 1])
    first = np.zeros(len(xyz), dtype=bool)
    first[between[found]] = True
    # A node in the middle of a face stands between mid-side nodes: its lines stay.
    middle = np.zeros(len(xyz), dtype=bool)
    middle[between[found & ~first[coupled].any(axis=1)]] = True
    return np.asarray(lines[~middle[lines].all(axis=1)])


def _place(table: DofTable, vector: sp.csc_array) -> dict[str, Any]:
    """Position of a load or output row (mean of its nodes, weighted by the entries) and direction of its displacements (or None)."""
    rows, values = vector.indices, np.real(vector.data)
    moving = np.isin(table.component[rows], COMPONENTS[:3])
    if moving.any():
        rows, values = rows[moving], values[moving]
    weights = np.abs(values) / np.abs(values).sum()
    axes = np.array([values[table.component[rows] == axis].sum() for axis in COMPONENTS[:3]])
    length = float(np.linalg.norm(axes))
    return {"position": weights @ table.xyz[rows], "direction": axes / length if moving.any() and length > 0 else None}


def _terms(inputs: Inputs, table: DofTable, group: TermGroup) -> dict[str, Any]:
    """Terms of a group as drawn; ``springs`` holds the two ends of each spring of a table that joins two nodes."""
    springs = []
    if group.config.select.bushings is not None:
        left = inputs.model.terms.left
        for k in group.terms:
            rows = left.indices[left.indptr[k] : left.indptr[k + 1]]
            ends, first = np.unique(table.node[rows], return_index=True)
            springs += [*table.xyz[rows[first]]] if ends.size == 2 else []
    return {
        "name": group.name,
        "kind": group.config.kind,
        "along_edge": group.arc_length is not None and group.count > 1,
        "positions": group.xyz,
        "springs": np.array(springs).reshape(-1, 3),
    }
