"""Where bolts lie: which values they own, or which values of an edge reach each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.model.selection import JUMP


@dataclass(frozen=True, kw_only=True)
class Edge:
    """Stiffness along one edge.

    Attributes
    ----------
    xyz : (k, 3) float array
        Positions, in order [m].
    arc_length : (k,) float array
    log10 : (k,) float array
        log10 of the effective stiffness.
    cap : float
        log10 stiffness above which the FRFs do not feel a difference: values above it count as equal.
    reference : (k,) float array or None
        The same of the tight state.
    std : (k,) float array or None
        Standard deviations of the tight state.
    """

    xyz: Floats
    arc_length: Floats
    log10: Floats
    cap: float
    reference: Floats | None
    std: Floats | None = None


@dataclass(frozen=True)
class Joints:
    """Stiffness of one group whose values belong to bolts.

    Attributes
    ----------
    log10, cap, reference, std
        See ``Edge``.
    bolt : (k,) int array
        Bolt that owns each value, -1 where none does.
    """

    log10: Floats
    cap: float
    reference: Floats | None
    bolt: Integers
    std: Floats | None = None


#: The values that speak for a bolt: those of one edge, or of one or more groups of joints, by the number of the group.
Spot = tuple[tuple[int, Integers], ...]


@dataclass(frozen=True)
class Place:
    """Where a bolt lies.

    Attributes
    ----------
    edge : int
        Which of the edges.
    at : float
        Arc length of its foot there, continued straight beyond the ends [m].
    near : int array
        Values of the edge within half a pitch of the foot.
    away : float
        Distance of the nearest value from the foot along the edge [m].
    aside : float or None
        Distance from the edge [m], where that is too far for a bolt of it.
    """

    edge: int
    at: float
    near: Integers
    away: float
    aside: float | None

    @property
    def reached(self) -> bool:
        """A term lies within half a pitch."""
        return self.aside is None and bool(self.near.size)

    @property
    def note(self) -> str | None:
        """Why no term reaches the bolt; None where one does."""
        if self.aside is not None:
            return (
                f"no term reaches it: it lies {1e3 * self.aside:.0f} mm beside the edge, more than a pitch further than bolts of that edge"
            )
        return None if self.near.size else f"no term within half a pitch; the nearest is {1e3 * self.away:.0f} mm away along the edge"


def pitch_of(bolts: Floats) -> float:
    """Median distance of the bolts to their nearest neighbour [m]; 0 for a single bolt."""
    if bolts.shape[0] < 2:
        return 0.0
    distance = np.linalg.norm(bolts[:, None] - bolts[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return float(np.median(distance.min(axis=1)))


def foot(xyz: Floats, arc_length: Floats, point: Floats) -> tuple[float, float]:
    """Arc length of the point of an edge nearest to a bolt, continued straight beyond the ends, and the distance to the edge [m].

    Parameters
    ----------
    xyz : (k, 3) float array
        Positions along the edge, in order.
    arc_length : (k,) float array
    point : (3,) float array
    """
    if xyz.shape[0] == 1:
        return float(arc_length[0]), float(np.linalg.norm(point - xyz[0]))
    best = (0.0, np.inf)
    last = xyz.shape[0] - 2
    for i in range(last + 1):
        start, segment = xyz[i], xyz[i + 1] - xyz[i]
        length = float(np.linalg.norm(segment))
        if length == 0.0:
            continue
        t = float((point - start) @ segment) / length
        inside = np.clip(t, -np.inf if i == 0 else 0.0, np.inf if i == last else length)
        distance = float(np.linalg.norm(point - start - segment * (inside / length)))
        if distance < best[1]:
            best = (float(arc_length[i]) + float(inside), distance)
    return best


def spots(groups: Sequence[Edge | Joints], bolts: Floats) -> list[Spot | str]:
    """The values that speak for each bolt: its own wherever they lie, else those of an edge that reach it; or why there are none.

    Parameters
    ----------
    groups : sequence of Edge or Joints
    bolts : (m, 3) float array

    Returns
    -------
    list of Spot or str
    """
    found: list[Spot | str] = []
    for b in range(bolts.shape[0]):
        own = [(i, np.flatnonzero(group.bolt == b)) for i, group in enumerate(groups) if isinstance(group, Joints)]
        found.append(tuple((i, at) for i, at in own if at.size) or "no term belongs to it")
    edges = [(i, group) for i, group in enumerate(groups) if isinstance(group, Edge)]
    rest = [b for b, spot in enumerate(found) if isinstance(spot, str)]
    if edges and rest:
        for b, place in zip(rest, places([edge for _, edge in edges], bolts[rest]), strict=True):
            found[b] = place.note or ((edges[place.edge][0], place.near),)
    return found


def misplaced(groups: Sequence[Edge | Joints], bolts: Floats, *, more: int = 3) -> tuple[str, int] | None:
    """How all bolts would be reached, or so many more of them, by other axes or another origin, and how many; None where by no such way.

    Bolts that go on beyond one end of an edge and leave the other one free would be.

    Parameters
    ----------
    groups : sequence of Edge or Joints
    bolts : (m, 3) float array
    more : int
        Two are gained where the row begins a pitch from the end of the edge, as many do, and goes on beyond the other one.
    """
    edges, now = [group for group in groups if isinstance(group, Edge)], _reached(groups, bolts)
    if not edges or now == len(bolts):
        return None
    terms = np.concatenate([edge.xyz for edge in edges])
    away = 0.5 * (terms.min(axis=0) + terms.max(axis=0) - bolts.min(axis=0) - bolts.max(axis=0))
    # What is nearer reaches a bolt anyway.
    least = 0.5 * pitch_of(bolts)
    others = [(np.array(order), np.zeros(3), f"{'XYZ'[i]} and {'XYZ'[j]} exchanged") for i, j, order in _EXCHANGES]
    for axes in ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)):
        shift = np.where(np.isin(np.arange(3), axes), away, 0.0)
        if np.abs(shift[list(axes)]).min() > least:
            added = " and ".join(f"{shift[k]:+.3g} m in {'XYZ'[k]}" for k in axes)
            others.append((np.arange(3), shift, f"{added} added"))
    # The first of those that reach most.
    found = [(_reached(groups, bolts[:, order] + shift), -k, text) for k, (order, shift, text) in enumerate(others)]
    best, _, text = max(found)
    return (text, best) if best == len(bolts) or best >= now + more else None


def _reached(groups: Sequence[Edge | Joints], bolts: Floats) -> int:
    """How many bolts terms reach."""
    return sum(isinstance(spot, tuple) for spot in spots(groups, bolts))


#: Two axes in each other's place, and the order then.
_EXCHANGES = ((0, 1, (1, 0, 2)), (0, 2, (2, 1, 0)), (1, 2, (0, 2, 1)))


def places(edges: Sequence[Edge], bolts: Floats) -> list[Place]:
    """Edge of every bolt, and what of it lies within half a pitch, or on both sides of a bolt between two terms.

    That is the nearest edge; where nothing of it reaches the bolt, another one with terms nearer to the bolt that do.

    Parameters
    ----------
    edges : sequence of Edge
        At least one.
    bolts : (m, 3) float array

    Returns
    -------
    list of Place
    """
    pitch = pitch_of(bolts)
    feet = [[foot(edge.xyz, edge.arc_length, bolt) for edge in edges] for bolt in bolts]
    nearest = [int(np.argmin([distance for _, distance in row])) for row in feet]
    # Bolts of one edge lie beside each other: of others, say along the next edge of a plate, its terms know nothing.
    least = [min((row[e][1] for row, own in zip(feet, nearest, strict=True) if own == e), default=np.inf) for e in range(len(edges))]

    def place(b: int, e: int) -> Place:
        edge, (at, distance) = edges[e], feet[b][e]
        away = np.abs(edge.arc_length - at)
        # A single bolt has no pitch: the terms on both sides of it count.
        half = 0.5 * pitch if pitch else float(np.median(np.diff(edge.arc_length))) if edge.arc_length.size > 1 else np.inf
        # What holds an edge stands by it: the nearest bolt up to two pitches aside (a wide flange, two rows), the others one further; a
        # single bolt up to the length of the edge.
        most = 2 * pitch or float(edge.arc_length[-1]) or np.inf
        beside = distance if distance > (min(least[e], most) + pitch) * (1 + 1e-9) else None
        near = np.flatnonzero(away <= half * (1 + 1e-9))
        return Place(e, at, near if near.size else _between(edge.arc_length, at), float(away.min()), beside)

    found = []
    for b, bolt in enumerate(bolts):
        own = place(b, nearest[b])
        if not own.reached and len(edges) > 1:
            # Beyond its end an edge goes on straight, perhaps along the next one; terms on the far side of a plate reach nothing here.
            apart = [float(np.linalg.norm(edge.xyz - bolt, axis=1).min()) for edge in edges]
            others = [place(b, int(e)) for e in np.argsort(apart, kind="stable") if apart[e] < apart[own.edge]]
            own = next((other for other in others if other.reached), own)
        found.append(own)
    return found


def _between(arc_length: Floats, at: float) -> Integers:
    """The terms on both sides of a place between them, which feel it whatever the pitch; none beyond the ends or in a gap of the edge."""
    after = int(np.searchsorted(arc_length, at))
    if not 0 < after < arc_length.size:
        return np.zeros(0, dtype=np.int64)
    steps = np.diff(arc_length)
    # As far apart as no terms of one edge are, see ``model.selection.jumps``.
    if steps[after - 1] > JUMP * float(np.median(steps)):
        return np.zeros(0, dtype=np.int64)
    return np.array([after - 1, after], dtype=np.int64)
