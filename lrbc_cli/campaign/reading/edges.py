"""Checks that the terms of a group follow each other along one edge, and splits groups of several edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.campaign.reading.groups import TermGroup
from lrbc_cli.campaign.reading.model_doubts import require_known_bolts
from lrbc_cli.config import Campaign
from lrbc_cli.method.resolve import approach_of
from lrbc_cli.model.dofs import PointTable
from lrbc_cli.model.selection import JUMP, arc_length, edges_of, is_line, jumps


def by_edges(campaign: Campaign, groups: Sequence[TermGroup], bolts: PointTable | None) -> tuple[list[TermGroup], list[str], list[str]]:
    """Groups split into one per edge if their values are coupled to neighbours, notes on the edges, and warnings on groups without line.

    Raises
    ------
    ConfigError
        If coupled values are not on a line; if terms in an order that the campaign states jump between edges, and smoothing or the hat of
        a bolt extends across a jump; or if a removed bolt is unknown.
    """
    require_known_bolts(campaign, bolts)
    found, notes, doubts = list[TermGroup](), list[str](), list[str]()
    if approach_of(campaign) == "bolts":
        _require_own_weight(campaign)
    for group in groups:
        if group.xyz is None or group.arc_length is None:
            found.append(group)
            continue
        at = _breaks(group)
        if (doubt := _no_line(campaign, group, at, bolts)) is not None:
            found.append(group)
            doubts.append(doubt)
            continue
        tied = _tied(campaign, group, at, bolts) if at.size else None
        if tied is None:
            if at.size:
                notes.append(f"parameters {group.name}: {_jumps(group, at)}; the values across them are not coupled")
            parts = [group]
        elif _ordered_here(group) and at.size + 1 == len(edges_of(group.xyz)):
            parts = _split(campaign, group, at)
            notes.append(f"parameters {group.name}: {len(parts)} edges, made into separate groups: their values are not coupled")
        else:
            raise campaign.error(
                f"the terms of {group.name} do not lie along one edge, but {tied} across the jumps",
                "parameters",
                group.name,
                "select",
                expected=f"each term next to the one before, within {JUMP:g} times the distance of neighbours",
                found=_jumps(group, at),
                hint="make one group for each edge, and list its terms in order along the edge; or select by `box`, which orders them",
            )
        notes += [line for part in parts if (line := _preview(part))]
        found += parts
    return found, notes, doubts


def _require_own_weight(campaign: Campaign, *, rounding: float = 1e-3) -> None:
    """Refuse smoothing in which the neighbours of a value have more weight than the value itself.

    A gap would be filled from its tight neighbours, and these would be loosened to compensate: on the frame sample with three equal
    weights, a tight bolt was called loose.

    Raises
    ------
    ConfigError
    """
    for name, group in campaign.parameters.items():
        weights = group.smoothing or (1.0,)
        own = weights[len(weights) // 2]
        if own >= (1.0 - rounding) * (sum(weights) - own):
            continue
        raise campaign.error(
            "smoothing so wide that bolts beside a loose bolt come out loose too",
            "parameters",
            name,
            "smoothing",
            expected="a middle weight that is at least as large as all others together",
            found=f"{own:g} in the middle, {sum(weights) - own:g} beside it",
            hint="remove smoothing (changes at bolts extend from bolt to bolt anyway), or write [0.333333, 0.666667, 0.333333]; "
            "update.approach: paper accepts any weights",
        )


def _no_line(campaign: Campaign, group: TermGroup, at: Integers, bolts: PointTable | None) -> str | None:
    """Warning if terms that were ordered by this program fill a face or a body; None if they follow lines.

    Raises
    ------
    ConfigError
        If they do not follow lines and are coupled to their neighbours.
    """
    assert group.xyz is not None
    if not _ordered_here(group) or all(map(is_line, np.split(group.xyz, at + 1))):
        return None
    smoothed = sum(weight > 0 for weight in group.config.smoothing or ()) > 1
    at_bolts = bolts is not None and group.config.kind == "stiffness" and approach_of(campaign) == "bolts"
    low, high = group.xyz.min(axis=0), group.xyz.max(axis=0)
    found = f"{group.count} values from {_place(low)} to {_place(high)} that fill a face or a body"
    hint = "select the border of a flat field with `boundary: true`, make the box smaller, or select by `along`"
    if smoothed or at_bolts:
        tied = "smoothing mixes neighbours" if smoothed else "changes at bolts extend"
        raise campaign.error(
            f"the terms of {group.name} do not lie on a line, but {tied} along it",
            "parameters",
            group.name,
            "select",
            expected="nodes of one edge, or of several",
            found=found,
            hint=hint,
        )
    return f"parameters {group.name}: {found}, not an edge: {hint}"


def _ordered_here(group: TermGroup) -> bool:
    """Whether the order of the terms was determined by this program, not by the user."""
    select = group.config.select
    return select.box is not None or select.along is not None or select.boundary is not None


def _breaks(group: TermGroup) -> Integers:
    """Index of the value before each step to another edge."""
    assert group.xyz is not None
    if not _ordered_here(group):
        return jumps(group.xyz)
    label = np.zeros(group.count, dtype=np.int64)
    for k, edge in enumerate(edges_of(group.xyz)):
        label[edge] = k
    return np.flatnonzero(np.diff(label))


def _split(campaign: Campaign, group: TermGroup, at: Integers) -> list[TermGroup]:
    """The terms of a group as one group per edge; ``at`` as of ``_breaks``."""
    assert group.xyz is not None
    parts = []
    for k, (a, b) in enumerate(pairwise([0, *(at + 1), group.count]), start=1):
        inside = (group.parameter >= a) & (group.parameter < b)
        name, xyz = f"{group.name}-{k}", group.xyz[a:b]
        if name in campaign.parameters:
            raise campaign.error("an edge of another group would have this name", "parameters", name, hint="rename this group")
        own = group.parameter[inside] - a
        parts.append(replace(group, name=name, terms=group.terms[inside], parameter=own, xyz=xyz, arc_length=arc_length(xyz)))
    return parts


def _preview(group: TermGroup) -> str:
    """Note on ends and term spacing of an edge; empty for a single value."""
    assert group.xyz is not None
    assert group.arc_length is not None
    if group.count < 2:
        return ""
    steps = np.diff(group.arc_length)
    low, high = float(steps.min()), float(steps.max())
    apart = f"every {high:.3g} m" if high - low < 0.01 * high else f"{low:.3g} to {high:.3g} m apart"
    ends = f"from {_place(group.xyz[0])} to {_place(group.xyz[-1])}"
    return f"parameters {group.name}: {group.count} values {apart}, {group.arc_length[-1]:.3g} m {ends}"


def _jumps(group: TermGroup, at: Integers) -> str:
    """Text on the jumps between values."""
    assert group.xyz is not None
    assert group.arc_length is not None
    steps = np.diff(group.arc_length)
    worst = int(at[np.argmax(steps[at])])
    before, after = (f"value {k} at {_place(group.xyz[k])}" for k in (worst, worst + 1))
    usual = np.median(np.delete(steps, at)) if at.size < steps.size else np.median(steps)
    return (
        f"{at.size} jump{'s' if at.size > 1 else ''}, the largest {steps[worst]:.3g} m from {before} to {after}; "
        f"other steps are {usual:.3g} m, the total is {group.arc_length[-1]:.3g} m"
    )


def _tied(campaign: Campaign, group: TermGroup, at: Integers, bolts: PointTable | None) -> str | None:
    """What couples values across a jump, in words; None if nothing does."""
    smoothing = group.config.smoothing
    if smoothing is not None and any(weight > 0 for i, weight in enumerate(smoothing) if i != len(smoothing) // 2):
        return "smoothing mixes values"
    if bolts is None or group.config.kind != "stiffness" or approach_of(campaign) == "paper":
        return None
    assert group.xyz is not None
    steps = np.linalg.norm(np.diff(group.xyz, axis=0), axis=1)
    # The hat of a bolt ends at the next bolt, so a jump whose two ends are bolts is in no hat.
    distance = np.linalg.norm(group.xyz[None] - bolts.xyz[:, None], axis=2)
    # Bolts of other edges do not count.
    nearest = np.argmin(distance, axis=1)[distance.min(axis=1) <= np.median(steps)]
    return None if np.isin(at, nearest).all() and np.isin(at + 1, nearest).all() else "changes at bolts extend"


def _place(point: Floats) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in point) + ")"
