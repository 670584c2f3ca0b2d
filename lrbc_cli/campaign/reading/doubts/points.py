"""Points of hammer and sensors given by coordinates: beside nodes, in another unit, from another origin, or with axes exchanged."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.reading.places import AT_NODE, CLEARLY_NEARER, EXCHANGES, coordinates_file, extents
from lrbc_cli.config import Campaign
from lrbc_cli.errors import DataError, listing
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, DofTable
from lrbc_cli.model.selection import nearest, spacing


@dataclass(frozen=True, kw_only=True)
class NearPoint:
    """A point given by coordinates, and the nearest node.

    Attributes
    ----------
    key : str
        Its key in the campaign file.
    place : (3,) float array
        [m].
    component : str
    node : int
    distance, size : float
        Distance of that node, and node spacing there [m].
    others : tuple of int
        Other nodes at the place of that node.
    """

    key: str
    place: Floats
    component: str
    node: int
    distance: float
    size: float
    others: tuple[int, ...] = ()

    @property
    def away(self) -> float:
        """Distance over the node spacing; above 1 the coordinates are probably wrong."""
        return self.distance / self.size if self.size else 0.0

    @property
    def beside(self) -> bool:
        """Whether it is not at a node."""
        return self.distance > AT_NODE * self.size


def _beside_text(points: Sequence[NearPoint], *, several: int = 3) -> list[str]:
    """Warnings about points beside nodes: one for each, or one for ``several`` and more."""
    if len(points) < several:
        return [
            f"{point.key}: the nearest node {point.node} is {1e3 * point.distance:.1f} mm away (mesh size {1e3 * point.size:.0f} mm); such "
            "an offset can add 1 to 2 dB of misfit. Give an interpolated row ({matrix:} or {vector:})"
            for point in points
        ]
    away = listing([f"{point.key} {1e3 * point.distance:.1f} mm" for point in points], 6)
    sizes = [1e3 * point.size for point in points]
    ends = " to ".join(dict.fromkeys((f"{min(sizes):.0f}", f"{max(sizes):.0f}")))
    return [
        f"{len(points)} points of hammer and sensors lie beside the nodes: {away} (mesh size {ends}"
        " mm); such offsets can add 1 to 2 dB of misfit. If the coordinates are right, give interpolated rows ({matrix:} or {vector:})"
    ]


def _outside_air(dofs: DofTable, points: Sequence[NearPoint], *, share: float = 0.02) -> list[NearPoint]:
    """Microphones among the points outside the extents of the air of the model, by a ``share`` of its largest: walls have facets."""
    if not dofs.is_acoustic.any():
        return []
    low, high = np.array(_ends(dofs, ACOUSTIC_COMPONENT)).T
    margin = [max(AT_NODE * point.size, share * float((high - low).max())) for point in points]
    return [
        point
        for point, least in zip(points, margin, strict=True)
        if point.component == ACOUSTIC_COMPONENT and bool(((point.place < low - least) | (point.place > high + least)).any())
    ]


def _outside_text(dofs: DofTable, points: Sequence[NearPoint]) -> list[str]:
    """Warning about microphones outside the air of the model; none without them."""
    if not points:
        return []
    away = listing([f"{point.key} {1e3 * point.distance:.1f} mm" for point in points], 6)
    return [
        f"microphones lie outside the air of the model, which reaches over {extents(dofs.xyz[dofs.is_acoustic])}: {away} from its nearest "
        "node. Check the extents of the air in the FE model, such as the depth of the cavity, and the places of these microphones"
    ]


def shared_places(points: Iterable[NearPoint]) -> list[str]:
    """Warning if other nodes lie where ``near`` found one, as where two parts are joined; else empty."""
    shared: dict[tuple[int, ...], list[str]] = {}
    for point in points:
        if point.others:
            shared.setdefault((point.node, *point.others), []).append(point.key)
    if not shared:
        return []
    named = "; ".join(f"{listing(keys, 4)}: nodes {', '.join(map(str, nodes))}" for nodes, keys in shared.items())
    return [
        f"several nodes lie at one place, and `near` takes the first ({named}). If they belong to several parts, write {{node:, "
        "component:} for the part that is meant"
    ]


def beside_nodes(dofs: DofTable, points: Sequence[NearPoint], unit: float) -> tuple[list[str], bool]:
    """Warnings about points that are not at nodes; a single one if another origin, or one axis counted backwards, explains all of them.

    Parameters
    ----------
    dofs : DofTable
    points : sequence of NearPoint
    unit : float
        Length unit of the campaign [m].

    Returns
    -------
    list of str
    bool
        Whether another origin or an axis counted backwards explains all.
    """
    beside = [point for point in points if point.beside]
    outside = _outside_air(dofs, beside)
    named = {point.key for point in outside}
    told = [*_outside_text(dofs, outside), *_beside_text([point for point in beside if point.key not in named])]
    if len(beside) < 2 or 2 * len(beside) <= len(points):
        return told, False
    low, high = dofs.xyz.min(axis=0), dofs.xyz.max(axis=0)
    ways = [
        (shift, np.ones(3))
        for shift in product(*(sorted({0.0, a, 0.5 * (a + b), b}) for a, b in zip(low.tolist(), high.tolist(), strict=True)))
        if any(shift)
    ]
    for axis in range(3):
        ends = {_ends(dofs, point.component)[axis] for point in beside}
        ways += [(tuple(np.where(np.arange(3) == axis, sum(end), 0.0)), np.where(np.arange(3) == axis, -1.0, 1.0)) for end in ends]
    stated = max(point.away for point in beside)
    # Accept a way that puts all of them at nodes, or the only one that puts all within a mesh size and clearly nearer than as stated.
    fits: list[tuple[float, tuple[float, ...], Floats]] = []
    for shift, signs in ways:
        away = _away(dofs, beside, shift, signs)
        if away <= 1.0 and away < CLEARLY_NEARER * stated:
            fits.append((away, shift, signs))
    fits.sort(key=lambda fit: fit[0])
    if not fits or (fits[0][0] > AT_NODE and len(fits) > 1):
        along = _along_one_axis(dofs, beside)
        if along is None:
            return told, False
        fits = [(0.0, along, np.ones(3))]
    _, shift, signs = fits[0]
    start = f"{len(beside)} of {len(points)} points of hammer and sensors lie beside the nodes; "
    if (signs < 0.0).any():
        name = "xyz"[int(np.argmin(signs))]
        return [
            f"{start}with {name} counted from the other side they lie at nodes. Write {sum(shift) / unit:.6g} - {name} for {name} in "
            "`near` of these points"
        ], True
    added = ", ".join(f"{value / unit:g}" for value in shift)
    return [
        f"{start}with ({added}) added to each of them they lie at nodes. The coordinates were probably measured from another origin than "
        "that of the model: add this offset to `near` of these points"
    ], True


def _away(dofs: DofTable, points: Sequence[NearPoint], shift: Sequence[float], signs: Floats) -> float:
    """Largest distance from a node, over the node spacing there, of points after a reflection and a shift."""
    away = []
    for point in points:
        dof, distance = nearest(dofs, (signs * point.place + shift).tolist(), point.component) or (0, np.inf)
        size = spacing(dofs, dof)
        away.append(distance / size if size > 0.0 else np.inf)
    return max(away)


def _node_at(dofs: DofTable, point: NearPoint, shift: Sequence[float]) -> int | None:
    """The node nearest to a point after a shift."""
    found = nearest(dofs, (point.place + shift).tolist(), point.component)
    return None if found is None else int(dofs.node[found[0]])


def _along_one_axis(dofs: DofTable, points: Sequence[NearPoint], *, several: int = 3) -> tuple[float, ...] | None:
    """The only shift along one axis that puts all points at nodes; None if none does, or several, as in a regular mesh.

    Parameters
    ----------
    dofs : DofTable
    points : sequence of NearPoint
    several : int
        Least number of different coordinates along that axis; fewer come to nodes by chance. A shift after which all of them are still
        nearest to the same nodes needs no word.
    """
    first, found = points[0], list[tuple[float, ...]]()
    xyz = dofs.xyz[dofs.component == first.component]
    for axis in range(3):
        if np.unique(np.round([point.place[axis] / point.size for point in points if point.size], 2)).size < several:
            continue
        beside = np.delete(np.abs(xyz - first.place), axis, axis=1).max(axis=1)
        for shift in np.unique((xyz[beside <= AT_NODE * first.size] - first.place)[:, axis]).tolist():
            added = tuple(np.where(np.arange(3) == axis, shift, 0.0).tolist())
            if _away(dofs, points, added, np.ones(3)) <= AT_NODE and any(point.node != _node_at(dofs, point, added) for point in points):
                found.append(added)
    return found[0] if len(found) == 1 else None


def _ends(dofs: DofTable, component: str) -> list[tuple[float, float]]:
    """Least and largest coordinate along each axis of the nodes with a component [m]."""
    own = dofs.xyz[dofs.component == component]
    return list(zip(own.min(axis=0).tolist(), own.max(axis=0).tolist(), strict=True))


def exchanged_axes(dofs: DofTable, points: Sequence[NearPoint]) -> str:
    """The two axes (of ``EXCHANGES``) whose exchange brings the points to nodes, most of which lie beside them; empty if there are none.

    The farthest point comes to a node, or within a mesh size if points as stated are farther; clearly nearer than by any other exchange.
    """
    if len(points) < 2 or 2 * sum(point.beside for point in points) <= len(points):
        return ""
    ways = []
    for axes, order in EXCHANGES.items():
        found = [nearest(dofs, point.place[order].tolist(), point.component) for point in points]
        ways.append((max(np.inf if one is None else one[1] / (spacing(dofs, one[0]) or 1.0) for one in found), axes))
    (best, axes), (second, _), _ = sorted(ways)
    stated = max(point.away for point in points)
    near = best <= AT_NODE or (best <= 1.0 < stated)
    return axes if near and best < CLEARLY_NEARER * min(second, stated) else ""


def exchanged_text(axes: str, points: Sequence[NearPoint], campaign: Campaign, *, of_table: bool) -> str:
    """Warning about exchanged axes: of the DOF table if the bolts, too, fit with them exchanged, else of the points."""
    file = coordinates_file(campaign)
    table = "model.dofs" if file is None else file.name
    count = sum(point.beside for point in points)
    start = f"{count} of {len(points)} points of hammer and sensors lie beside the nodes; with {axes} exchanged all lie at nodes"
    if of_table:
        return f"{start}, and the bolts at their springs. {axes} are probably exchanged in the DOF table: exchange these columns of {table}"
    return f"{start}. Exchange {axes} in each `near` of excitation and responses or, if all else is right, these columns of {table}"


def require_unit(dofs: DofTable, points: Sequence[NearPoint], file: Path) -> None:
    """Refuse hammer and sensors whose nearest node is the same for all, if the ratio of two length units puts them at different nodes.

    Raises
    ------
    DataError
    """
    if len(points) < 2 or len(_nodes_at(dofs, points, 1.0, np.inf)) != 1:
        return
    for times in (1000.0, 100.0, 10.0, 25.4, 1.0 / 0.0254):
        if len(_nodes_at(dofs, points, times, AT_NODE)) > 1:
            raise DataError(
                f"all {len(points)} points of hammer and sensors fall on one node; multiplied by {times:.4g} they lie at nodes",
                file=file,
                place="excitation and responses",
                expected="places in the unit of length of the model and of `units`",
                found="probably places in a larger unit",
                hint=f"multiply each `near` of excitation and responses by {times:.4g}",
            )


def _nodes_at(dofs: DofTable, points: Sequence[NearPoint], times: float, share: float) -> set[int]:
    """Nodes at which the points times a factor lie, within ``share`` of the node spacing; empty if one point is at no node."""
    found = [nearest(dofs, (times * point.place).tolist(), point.component) for point in points]
    near = [dof for dof, distance in filter(None, found) if distance <= share * spacing(dofs, dof)]
    return {int(dofs.node[dof]) for dof in near} if len(near) == len(points) else set()
