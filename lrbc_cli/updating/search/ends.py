"""Ends of a search that are nearly as good as the best one: alternatives for the posterior, and ties to warn about."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.search.optimise import Start


def other_ends(
    parameters: Parameterisation, starts: Sequence[Start], *, tie: float = 0.05, distance: float = 0.25, kept: int = 3
) -> list[Floats]:
    """Theta at up to ``kept`` ends nearly as good as the best one and clearly different from it and from each other, best first.

    Nearly as good: within ``tie`` in cost (log10). Different: some value differs by at least ``distance`` decades, p_damp ignored.
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
    """The two best ends and their distance [decades], if within ``tie`` in cost (log10) and at least ``distance`` apart; else None.

    Also None if the best end is not the result, because the fit went on elsewhere. The distance is the rms over the terms of the difference
    of log10(W 10^p), so that differences which the smoothing W hides do not count.
    """
    if len(starts) < 2:
        return None
    best, second = sorted(starts, key=lambda start: start.total)[:2]
    apart = float(np.sqrt(np.mean((np.log10(parameters.scales(best.theta)) - np.log10(parameters.scales(second.theta))) ** 2)))
    return (best, second, apart) if best.kept and second.cost - best.cost <= tie and apart >= distance else None
