"""Whether the terms of a group follow one another along one edge, where that matters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.campaign.reading.groups import TermGroup
from lrbc_cli.config import Campaign
from lrbc_cli.model.dofs import PointTable
from lrbc_cli.model.selection import JUMP, jumps


def require_edges(campaign: Campaign, groups: Sequence[TermGroup], bolts: PointTable | None) -> list[str]:
    """Refuse groups of several edges, or in no order, whose neighbours are tied across the jumps.

    Returns
    -------
    list of str
        Jumps that do no harm, in words: discrete bolts, one parameter each.

    Raises
    ------
    ConfigError
        Where smoothing, differences along the edge, or the hat of a bolt reach across a jump.
    """
    notes = []
    for group in groups:
        if group.xyz is None or group.arc_length is None:
            continue
        at = jumps(group.xyz)
        if not at.size:
            continue
        steps = np.diff(group.arc_length)
        worst = int(at[np.argmax(steps[at])])
        before, after = (f"value {k} at {_place(group.xyz[k])}" for k in (worst, worst + 1))
        usual = np.median(np.delete(steps, at)) if at.size < steps.size else np.median(steps)
        found = (
            f"{at.size} jump{'s' if at.size > 1 else ''}, the largest {steps[worst]:.3g} m from {before} to {after}; "
            f"other steps are {usual:.3g} m, all make {group.arc_length[-1]:.3g} m"
        )
        tied = _tied(campaign, group, at, bolts)
        if tied is None:
            notes.append(f"parameters {group.name}: {found}; nothing ties the values across them")
            continue
        raise campaign.error(
            f"the terms of {group.name} do not lie along one edge, and {tied} across the jumps",
            "parameters",
            group.name,
            "select",
            expected=f"each term next to the one before, within {JUMP:g} times the distance of neighbours",
            found=found,
            hint="make one group of each edge, and list its terms in their order along it",
        )
    return notes


def _tied(campaign: Campaign, group: TermGroup, at: Integers, bolts: PointTable | None) -> str | None:
    """What ties values on both sides of a jump, in words."""
    smoothing = group.config.smoothing
    if smoothing is not None and any(weight > 0 for i, weight in enumerate(smoothing) if i != len(smoothing) // 2):
        return "smoothing mixes values"
    if bolts is None or group.config.kind != "stiffness" or campaign.update.approach == "paper":
        return None
    assert group.xyz is not None
    steps = np.linalg.norm(np.diff(group.xyz, axis=0), axis=1)
    # The hat of a bolt ends at the next bolt: a jump between two bolts at its very ends is in none.
    distance = np.linalg.norm(group.xyz[None] - bolts.xyz[:, None], axis=2)
    # Bolts of other edges do not count.
    nearest = np.argmin(distance, axis=1)[distance.min(axis=1) <= np.median(steps)]
    return None if np.isin(at, nearest).all() and np.isin(at + 1, nearest).all() else "changes at bolts reach"


def _place(point: Floats) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in point) + ")"
