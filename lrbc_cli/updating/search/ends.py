"""Ends of a search that are about as good as the best one: alternatives, or ties."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.search.optimise import Start


def other_ends(
    parameters: Parameterisation, starts: Sequence[Start], *, tie: float = 0.05, distance: float = 0.25, kept: int = 3
) -> list[Floats]:
    """Theta at the ends that are about as good as the best one and clearly different from it and from each other, the best of them first.

    As good are ends within ``tie`` in cost (log10), different ones where some value lies at least ``distance`` decades apart.
    """
    found: list[Start] = []
    for start in sorted(starts, key=lambda start: start.total):
        if found and not start.cost - found[0].cost <= tie:
            break
        apart = [np.abs(start.theta - other.theta)[~parameters.is_damping].max() for other in found]
        if all(far >= distance for far in apart):
            found.append(start)
    return [start.theta for start in found[1 : kept + 1]]


def near_tie(
    parameters: Parameterisation, starts: Sequence[Start], *, tie: float = 0.05, distance: float = 0.25
) -> tuple[Start, Start, float] | None:
    """The two best ends where they are as good as each other and clearly different; and how different, in decades.

    The difference is the rms over the terms of log10(W 10^p): what the smoothing hides does not count. As good are ends within ``tie`` in
    cost (log10), different ones at least ``distance`` decades apart.
    """
    if len(starts) < 2:
        return None
    best, second = sorted(starts, key=lambda start: start.total)[:2]
    apart = float(np.sqrt(np.mean((np.log10(parameters.scales(best.theta)) - np.log10(parameters.scales(second.theta))) ** 2)))
    return (best, second, apart) if second.cost - best.cost <= tie and apart >= distance else None
