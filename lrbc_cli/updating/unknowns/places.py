"""Assignment of bolts to stiffness values: the values that a joint owns, or those of an edge within half a pitch of a bolt.

Used before the fit, to build the unknowns (``shapes``) and to warn of misplaced bolts, and after it, to judge each bolt by its values.
"""

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
        Positions of the values, in order along the edge [m].
    arc_length : (k,) float array
        [m]
    log10 : (k,) float array
        log10 of the effective stiffness.
    cap : float
        log10 stiffness at saturation: above it the FRFs do not change, and values count as equal.
    reference : (k,) float array or None
        ``log10`` of the tight state.
    std : (k,) float array or None
        Standard deviations of the tight state [decades].
    """

    xyz: Floats
    arc_length: Floats
    log10: Floats
    cap: float
    reference: Floats | None
    std: Floats | None = None


@dataclass(frozen=True)
class Joints:
    """Stiffness of one group of joints: bolts own its values.

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


#: The values by which a bolt is judged: pairs of a group's index and indices of its values; one edge, or one or more groups of joints.
Spot = tuple[tuple[int, Integers], ...]


@dataclass(frozen=True)
class Place:
    """Position of a bolt relative to its edge. Its foot is the nearest point of the edge, which continues straight beyond its ends.

    Attributes
    ----------
    edge : int
        Index of the edge.
    at : float
        Arc length of the foot [m].
    near : int array
        Indices of the values within half a pitch of the foot, or of the two on either side of it if these are further away.
    away : float
        Distance along the edge from the foot to the nearest value [m].
    aside : float or None
        Distance of the bolt from the edge [m] if it is too large for a bolt of this edge, else None.
    """

    edge: int
    at: float
    near: Integers
    away: float
    aside: float | None

    @property
    def reached(self) -> bool:
        """Whether the edge has values near the bolt, so that it can be judged."""
        return self.aside is None and bool(self.near.size)

    @property
    def note(self) -> str | None:
        """Message why no term reaches the bolt; None if one does."""
        if self.aside is not None:
            return (
                f"no term reaches it: it is {1e3 * self.aside:.0f} mm from the edge, more than a pitch further than the bolts of that edge"
            )
        return None if self.near.size else f"no term within half a pitch; the nearest is {1e3 * self.away:.0f} mm away along the edge"


def pitch_of(bolts: Floats) -> float:
    """Median distance of the bolts (m, 3) to their nearest neighbour [m]; 0 for a single bolt."""
    if bolts.shape[0] < 2:
        return 0.0
    distance = np.linalg.norm(bolts[:, None] - bolts[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return float(np.median(distance.min(axis=1)))


def foot(xyz: Floats, arc_length: Floats, point: Floats) -> tuple[float, float]:
    """Arc length of a bolt's foot, the nearest point of an edge continued straight beyond its ends, and its distance from there [m].

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
    """The values by which each bolt is judged: those it owns, else those of an edge near it.

    Parameters
    ----------
    groups : sequence of Edge or Joints
    bolts : (m, 3) float array
        Positions [m].

    Returns
    -------
    list of Spot or str
        One for each bolt; a string says why no value belongs to it.
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
    """Exchange of axes or shift of the origin by which terms would reach more bolts: a hint at wrong bolt coordinates.

    Parameters
    ----------
    groups : sequence of Edge or Joints
    bolts : (m, 3) float array
        Positions [m].
    more : int
        Least gain in bolts, unless all are reached. Correct coordinates can gain two: of a row that begins a pitch from one end of its edge
        and continues beyond the other end.

    Returns
    -------
    (str, int) or None
        What to change in the coordinates, in words, and how many bolts are reached then; None if nothing helps or all are reached now.
    """
    edges, now = [group for group in groups if isinstance(group, Edge)], _reached(groups, bolts)
    if not edges or now == len(bolts):
        return None
    terms = np.concatenate([edge.xyz for edge in edges])
    away = 0.5 * (terms.min(axis=0) + terms.max(axis=0) - bolts.min(axis=0) - bolts.max(axis=0))
    # Terms reach bolts within half a pitch, so a smaller shift gains none.
    least = 0.5 * pitch_of(bolts)
    others = [(np.array(order), np.zeros(3), f"{'XYZ'[i]} and {'XYZ'[j]} exchanged") for i, j, order in _EXCHANGES]
    for axes in ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)):
        shift = np.where(np.isin(np.arange(3), axes), away, 0.0)
        if np.abs(shift[list(axes)]).min() > least:
            added = " and ".join(f"{shift[k]:+.3g} m in {'XYZ'[k]}" for k in axes)
            others.append((np.arange(3), shift, f"{added} added"))
    # -k: of several that reach as many bolts, the first.
    found = [(_reached(groups, bolts[:, order] + shift), -k, text) for k, (order, shift, text) in enumerate(others)]
    best, _, text = max(found)
    return (text, best) if best == len(bolts) or best >= now + more else None


def _reached(groups: Sequence[Edge | Joints], bolts: Floats) -> int:
    """Number of bolts that terms reach."""
    return sum(isinstance(spot, tuple) for spot in spots(groups, bolts))


#: Exchanges of two axes: these axes, and the resulting order.
_EXCHANGES = ((0, 1, (1, 0, 2)), (0, 2, (2, 1, 0)), (1, 2, (0, 2, 1)))


def places(edges: Sequence[Edge], bolts: Floats) -> list[Place]:
    """Edge of every bolt, and the values of the edge within half a pitch of it, or else the two between which it is.

    The edge is the nearest one. If none of its terms reaches the bolt, it is the first other edge that reaches it with nearer terms.

    Parameters
    ----------
    edges : sequence of Edge
        At least one.
    bolts : (m, 3) float array
        Positions [m].

    Returns
    -------
    list of Place
        One for each bolt.
    """
    pitch = pitch_of(bolts)
    feet = [[foot(edge.xyz, edge.arc_length, bolt) for edge in edges] for bolt in bolts]
    nearest = [int(np.argmin([distance for _, distance in row])) for row in feet]
    # Bolts of one edge have similar distances from it. Bolts much further away belong elsewhere, for example to the next edge of a plate.
    least = [min((row[e][1] for row, own in zip(feet, nearest, strict=True) if own == e), default=np.inf) for e in range(len(edges))]

    def place(b: int, e: int) -> Place:
        edge, (at, distance) = edges[e], feet[b][e]
        away = np.abs(edge.arc_length - at)
        # A single bolt has no pitch: the median distance of the values replaces half of it.
        half = 0.5 * pitch if pitch else float(np.median(np.diff(edge.arc_length))) if edge.arc_length.size > 1 else np.inf
        # A bolt may be one pitch further away than the nearest bolt of the edge. The distance of that one counts as at most two pitches
        # (a wide flange, two rows), of a single bolt as the length of the edge.
        most = 2 * pitch or float(edge.arc_length[-1]) or np.inf
        beside = distance if distance > (min(least[e], most) + pitch) * (1 + 1e-9) else None
        near = np.flatnonzero(away <= half * (1 + 1e-9))
        return Place(e, at, near if near.size else _between(edge.arc_length, at), float(away.min()), beside)

    found = []
    for b, bolt in enumerate(bolts):
        own = place(b, nearest[b])
        if not own.reached and len(edges) > 1:
            # The straight continuation of an edge may run along the next edge. Only edges with terms nearer than its own are considered.
            apart = [float(np.linalg.norm(edge.xyz - bolt, axis=1).min()) for edge in edges]
            others = [place(b, int(e)) for e in np.argsort(apart, kind="stable") if apart[e] < apart[own.edge]]
            own = next((other for other in others if other.reached), own)
        found.append(own)
    return found


def _between(arc_length: Floats, at: float) -> Integers:
    """Indices of the two values on either side of an arc length; none beyond the ends or in a gap of the edge."""
    after = int(np.searchsorted(arc_length, at))
    if not 0 < after < arc_length.size:
        return np.zeros(0, dtype=np.int64)
    steps = np.diff(arc_length)
    # A gap: further apart than neighbouring terms of one edge, see ``model.selection.jumps``.
    if steps[after - 1] > JUMP * float(np.median(steps)):
        return np.zeros(0, dtype=np.int64)
    return np.array([after - 1, after], dtype=np.int64)
