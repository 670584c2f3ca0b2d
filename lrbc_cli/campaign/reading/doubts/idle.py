"""Detects bolts without effect in the model: beyond the end of a box in the middle of an edge, or beside nodes that the model holds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial import cKDTree

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.reading.groups import TermGroup
from lrbc_cli.campaign.reading.places import extents
from lrbc_cli.errors import listing
from lrbc_cli.model.dofs import COMPONENTS, DofTable, PointTable
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.selection import arc_length, edges_of, in_box, pitch
from lrbc_cli.model.units import UnitSystem
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


def partly_held(dofs: DofTable) -> dict[str, Floats]:
    """Places (k, 3) of the nodes of the structure that lack a component which most of them have, by component.

    Solids have no rotations; nodes that are held in all components are not in the table.
    """
    found = dict[str, Floats]()
    for kind in (COMPONENTS[:6], COMPONENTS[3:6]):
        own = np.isin(dofs.component, kind) & np.isfinite(dofs.xyz).all(axis=1)
        nodes, first = np.unique(dofs.node[own], return_index=True)
        for component in kind[:3]:
            lacking = ~np.isin(nodes, dofs.node[dofs.component == component])
            if 0 < 2 * lacking.sum() < nodes.size:
                found[component] = dofs.xyz[own][first[lacking]]
    return found


def clamped_beside(
    model: FeModel, groups: Sequence[TermGroup], bolts: PointTable | None, dofs: DofTable | None, unit: UnitSystem, *, share: float = 0.5
) -> Iterator[str]:
    """Warnings about bolts whose springs to ground act beside nodes that the model holds in the same component.

    A loss of such springs changes little in the model, whatever it changes in the structure. ``share``: of the distance of neighbouring
    bolts, within which a node is beside a bolt.
    """
    held = {} if dofs is None or bolts is None else partly_held(dofs)
    beside = dict[str, dict[str, float]]()
    for group in groups if held else ():
        assert dofs is not None
        assert bolts is not None
        if group.bolt is None:
            continue
        left = model.terms.left[:, group.terms].tocsc()
        reach = share * pitch(bolts.xyz)
        for k, owner in enumerate(group.bolt[group.parameter].tolist()):
            rows = left.indices[left.indptr[k] : left.indptr[k + 1]]
            component = str(dofs.component[rows[0]]) if rows.size == 1 else ""
            if owner >= 0 and component in held and np.isfinite(reach) and np.isfinite(dofs.xyz[rows[0]]).all():
                away = float(cKDTree(held[component]).query(dofs.xyz[rows[0]])[0])
                if away < reach:
                    beside.setdefault(component, {})[bolts.name[owner]] = away
    for component, own in beside.items():
        at, nodes = held[component], f"{len(held[component])} node{'s' if len(held[component]) > 1 else ''}"
        farthest = f"{max(own.values()) / unit.length:.3g} {unit.length_name}"
        yield (
            f"the model holds {component} of {nodes} ({extents(at, unit.length, unit.length_name)}), {farthest} or less from bolts whose "
            f"springs act on it ({listing(list(own), 6)}): their loss changes little there. "
            "If the structure is not clamped at these nodes, remove the boundary condition from the FE model and export the matrices again"
        )


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
