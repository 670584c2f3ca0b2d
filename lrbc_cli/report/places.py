"""Places of the bolts along the edges: nearest edge, arc length and order, for charts and lists."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.results.job import Bolt, JobRecord, Parameter
from lrbc_cli.updating.unknowns.places import foot


def bolts_of(group: Parameter, groups: Sequence[Parameter], bolts: Sequence[Bolt]) -> list[tuple[Bolt, float]]:
    """Return the bolts to which this group is the nearest, with their arc lengths [m] (beyond the ends: along the last segment)."""
    if group.positions is None or group.arc_length is None or len(group.positions) < 2:
        return []
    found = []
    for bolt in bolts:
        nearest = min(
            (entry for entry in groups if entry.positions is not None and len(entry.positions)), key=lambda entry: _distance(entry, bolt)
        )
        if nearest is group and np.isfinite(bolt.position).all():
            order = np.argsort(group.arc_length)
            along, _ = foot(group.positions[order], group.arc_length[order], np.asarray(bolt.position))
            found.append((bolt, along))
    return found


def along_the_edges(names: Sequence[str], jobs: Sequence[JobRecord]) -> list[list[str]]:
    """Return the names of the bolts edge by edge, ordered along each edge; bolts at no edge come last, in the given order."""
    left = list(names)
    rows: list[list[str]] = []
    for job in jobs:
        groups = [*job.parameters.values()]
        for group in groups:
            found = [(where, bolt.name) for bolt, where in bolts_of(group, groups, job.bolts) if bolt.name in left]
            if found:
                rows.append([name for _, name in sorted(found, key=lambda pair: pair[0])])
                left = [name for name in left if name not in rows[-1]]
    return [*rows, left] if left else rows


def _distance(group: Parameter, bolt: Bolt) -> float:
    positions = np.empty((0, 3)) if group.positions is None else group.positions
    return float(np.linalg.norm(positions - bolt.position, axis=1).min())
