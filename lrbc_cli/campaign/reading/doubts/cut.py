"""Detects a box that ends in the middle of an edge, so that bolts beyond its end have no terms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.reading.groups import TermGroup
from lrbc_cli.errors import listing
from lrbc_cli.model.dofs import DofTable, PointTable
from lrbc_cli.model.selection import arc_length, edges_of, in_box
from lrbc_cli.updating.unknowns.places import Edge, places


def cut_edges(groups: Sequence[TermGroup], bolts: PointTable, lost: Sequence[int], dofs: DofTable, unit: float) -> dict[int, str]:
    """Bolts that get terms once the box of an edge is extended to them, with a warning for each box.

    The nodes of the edge decide: a row of bolts may be longer than its edge.

    Parameters
    ----------
    groups : sequence of TermGroup
    bolts : PointTable
    lost : sequence of int
        Bolts that no term reaches.
    dofs : DofTable
    unit : float
        Length unit of the campaign file [m].
    """
    found = dict[int, str]()
    edges = [group for group in groups if group.config.kind == "stiffness" and group.xyz is not None and group.arc_length is not None]
    if not edges or not lost:
        return found
    lines = [_edge(group.xyz) for group in edges if group.xyz is not None]
    at = places(lines, bolts.xyz)
    for k, group in enumerate(edges):
        select = group.config.select
        feet = {b: _continued(lines[k], at[b].at) for b in lost if at[b].edge == k and at[b].aside is None}
        if select.box is None or select.boundary or select.component is None or group.count < 2 or not feet:
            continue
        box = np.array(select.box) * unit
        nodes = dofs.xyz[in_box(dofs, select.component, _hull(box, list(feet.values())).tolist())]
        longer = next((nodes[edge] for edge in edges_of(nodes) if np.any(np.all(nodes[edge] == lines[k].xyz[0], axis=1))), None)
        if longer is None:
            continue
        then = places([*lines[:k], _edge(longer), *lines[k + 1 :]], bolts.xyz)
        reached = [b for b in feet if then[b].edge == k and then[b].reached]
        if reached:
            wider = _hull(box, [feet[b] for b in reached])
            text = _text(group.name, bolts, reached, box / unit, wider / unit)
            found |= dict.fromkeys(reached, text)
    return found


def _edge(xyz: Floats) -> Edge:
    return Edge(xyz=xyz, arc_length=arc_length(xyz), log10=np.zeros(len(xyz)), cap=np.inf, reference=None)


def _continued(edge: Edge, at: float) -> Floats:
    """Place at an arc length beyond an end of an edge, which continues straight there [m]; the end if it is within the edge."""
    last, beside, over = (0, 1, -at) if at < 0.0 else (-1, -2, at - edge.arc_length[-1])
    outward = edge.xyz[last] - edge.xyz[beside]
    place: Floats = edge.xyz[last] + outward / np.linalg.norm(outward) * max(over, 0.0)
    return place


def _hull(box: Floats, points: Sequence[Floats]) -> Floats:
    """The (3, 2) box extended to points, rounded to a nanometre."""
    both = np.vstack([box.T, *points])
    return np.column_stack([both.min(axis=0), both.max(axis=0)]).round(9)


def _text(name: str, bolts: PointTable, reached: Sequence[int], box: Floats, wider: Floats) -> str:
    named = listing([bolts.name[b] for b in reached], 8)
    ends, write = [], []
    for axis, old, new in zip("xyz", box.tolist(), wider.tolist(), strict=True):
        ends += [f"{axis} = {a:.6g}" for a, b in zip(old, new, strict=True) if a != b]
        write += [f"[{new[0]:.6g}, {new[1]:.6g}] for {axis}"] if old != new else []
    lie = "lies" if len(reached) == 1 else "lie"
    return (
        f"parameters.{name}.select.box ends at {' and '.join(ends)} in the middle of the edge: {named} {lie} beyond it, without terms, and "
        f"cannot be judged. Write {' and '.join(write)}"
    )
