"""Which responses belong to one sensor or to one hammer point, and whether one of these stands out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.reading.inputs import Inputs


def sensors_of(inputs: Inputs) -> list[tuple[int, ...]]:
    """Responses of each sensor: those at one DOF, or of one row or vector; a response without a place is a sensor of its own."""
    found: dict[tuple[object, ...], list[int]] = {}
    for i, own in enumerate(inputs.responses):
        found.setdefault((own.text or i,) if own.node is None else (own.node, own.direction), []).append(i)
    return [tuple(own) for own in found.values()]


def same_sensor(inputs: Inputs, response: int) -> list[int]:
    """Other responses of the sensor of one, for other hammer points."""
    return [i for own in sensors_of(inputs) if response in own for i in own if i != response]


def sensors_among(inputs: Inputs, responses: Iterable[int]) -> int:
    """Number of sensors to which some responses belong."""
    return sum(not set(own).isdisjoint(responses) for own in sensors_of(inputs))


def ends_of(inputs: Inputs) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Responses of each ``sensor``, then those of each ``hammer point``."""
    yield from (("sensor", own) for own in sensors_of(inputs))
    for point in dict.fromkeys(own.input for own in inputs.responses):
        yield "hammer point", tuple(i for i, own in enumerate(inputs.responses) if own.input == point)


def standing_out(excess: Floats, groups: Sequence[Sequence[int]], least_db: float) -> int | None:
    """Index of the group whose excess is farthest above that of all others; None if none is more than ``least_db`` above.

    One FRF alone may differ because the model errs there, so the group and the others need two or more: their (lower) median is compared
    with the median of the others.

    Parameters
    ----------
    excess : (R,) float array
        NaN where a response cannot be compared [dB].
    groups : sequence of sequences of int
        Responses of each.
    least_db : float
    """
    worst, found = least_db, None
    for k, group in enumerate(groups):
        own = np.isfinite(excess) & np.isin(np.arange(excess.size), group)
        others = np.isfinite(excess) & ~own
        if min(own.sum(), others.sum()) < 2:
            continue
        beyond = float(np.quantile(excess[own], 0.5, method="lower") - np.median(excess[others]))
        if beyond > worst:
            worst, found = beyond, k
    return found
