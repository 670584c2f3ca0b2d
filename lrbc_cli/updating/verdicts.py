"""From the stiffness along an edge to the bolts: stiffness and change at each, and a verdict by these alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
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
    """

    xyz: Floats
    arc_length: Floats
    log10: Floats
    cap: float
    reference: Floats | None


@dataclass(frozen=True)
class BoltVerdict:
    """What the identification says of one bolt.

    Attributes
    ----------
    log10_stiffness : float
        Mean log10 stiffness within half a pitch along the edge.
    change : float or None
        Against the tight state, values above saturation counted as saturated [decades].
    verdict : str
        ``tight``, ``loose`` or ``undecided``.
    note : str or None
    far : bool
        No term lies within half a pitch.
    near : int array
        Which values of its edge were averaged.
    edge : int
        Which of the edges.
    change_std : float or None
        Standard deviation of the change, scatter of tight states included [decades].
    probability_loose : float or None
        That the change lies below the threshold.
    threshold : float or None
        Of the change [decades].
    """

    log10_stiffness: float
    change: float | None
    verdict: str
    note: str | None
    far: bool = False
    near: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64), repr=False)
    edge: int = 0
    change_std: float | None = None
    probability_loose: float | None = None
    threshold: float | None = None


def pitch_of(bolts: Floats) -> float:
    """Median distance of the bolts to their nearest neighbour [m]; 0 for a single bolt."""
    if bolts.shape[0] < 2:
        return 0.0
    distance = np.linalg.norm(bolts[:, None] - bolts[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    return float(np.median(distance.min(axis=1)))


def foot(edge: Edge, point: Floats) -> tuple[float, float]:
    """Arc length of the point of the edge nearest to a bolt, continued straight beyond the ends, and the distance to the edge [m]."""
    if edge.xyz.shape[0] == 1:
        return float(edge.arc_length[0]), float(np.linalg.norm(point - edge.xyz[0]))
    best = (0.0, np.inf)
    last = edge.xyz.shape[0] - 2
    for i in range(last + 1):
        start, segment = edge.xyz[i], edge.xyz[i + 1] - edge.xyz[i]
        length = float(np.linalg.norm(segment))
        if length == 0.0:
            continue
        t = float((point - start) @ segment) / length
        inside = np.clip(t, -np.inf if i == 0 else 0.0, np.inf if i == last else length)
        distance = float(np.linalg.norm(point - start - segment * (inside / length)))
        if distance < best[1]:
            best = (float(edge.arc_length[i]) + float(inside), distance)
    return best


def judge(edges: list[Edge], bolts: Floats, loose_change: float, is_reference: bool) -> list[BoltVerdict]:
    """Judge every bolt by the stiffness within half a pitch of it.

    Parameters
    ----------
    edges : list of Edge
        Stiffness groups with positions.
    bolts : (m, 3) float array
    loose_change : float
        Change in decades at which a bolt is loose (negative).
    is_reference : bool
        The job is the tight state itself.

    Returns
    -------
    list of BoltVerdict
    """
    pitch = pitch_of(bolts)
    found = []
    for bolt in bolts:
        feet = [foot(edge, bolt) for edge in edges]
        which = int(np.argmin([distance for _, distance in feet]))
        edge, at = edges[which], feet[which][0]
        away = np.abs(edge.arc_length - at)
        # A single bolt has no pitch: the terms on both sides of it count.
        half = 0.5 * pitch if pitch else float(np.median(np.diff(edge.arc_length))) if edge.arc_length.size > 1 else np.inf
        near = np.flatnonzero(away <= half * (1 + 1e-9))
        note = None
        if not near.size:
            near = np.array([int(np.argmin(away))])
            note = f"no term within half a pitch; the nearest is {1e3 * away[near[0]]:.0f} mm away along the edge"
        found.append((edge, near, note, which))
    capped = [float(np.mean(np.minimum(edge.log10[near], edge.cap))) for edge, near, *_ in found]
    level = float(np.quantile(capped, 0.75)) if capped else 0.0
    verdicts = []
    for (edge, near, note, which), value in zip(found, capped, strict=True):
        change = None
        contrast = False
        if edge.reference is not None:
            change = value - float(np.mean(np.minimum(edge.reference[near], edge.cap)))
        measure = change
        if measure is None and not is_reference:
            measure = value - level
            contrast = True
            note = note or "no tight state to compare with: loose by contrast with the other bolts, or undecided"
        if is_reference:
            change, measure = 0.0, 0.0
            note = note or "reference state, taken as tight"
        far = note is not None and note.startswith("no term")
        # Without a tight state nothing says that a bolt is tight: all may be loose.
        calm = "undecided" if contrast else "tight"
        verdict = "undecided" if far or measure is None else ("loose" if measure <= loose_change else calm)
        verdicts.append(BoltVerdict(float(np.mean(edge.log10[near])), change, verdict, note, far, near, which))
    return verdicts
