"""States that a measurement is compared with: of the model, with bolts loosened or not, and the measured tight one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import apart, levels, spread
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.reduced.stage import FrfSource
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.comparison.scale import LEAST_LINES, POWERS
from lrbc_cli.updating.search.starts import LEVELS
from lrbc_cli.updating.unknowns.shapes import joints_of

#: Lines of a job that are looked at, and states of the model that it is compared with at most.
LINES, MOST_STATES = 200, 150


def few_lines(measurement: Measurement) -> Measurement:
    """On as many lines as are looked at."""
    lines = looked_at(measurement)
    return replace(measurement, frequency_hz=measurement.frequency_hz[lines], values=measurement.values[lines])


def looked_at(measurement: Measurement) -> Integers:
    """Lines of a measurement that are looked at."""
    size = measurement.frequency_hz.size
    found: Integers = np.unique(np.linspace(0, size - 1, min(size, LINES)).round().astype(np.int64))
    return found


def beside_model(measurement: Measurement, tight: Measurement | None, lines: Integers, model: Complexes) -> list[Complexes]:
    """(1, F, R) measured tight state, where it has the same lines: nearer than the model, by the model discrepancy.

    A response that was not measured there is the model's, ``model`` (F, R).
    """
    axis = measurement.frequency_hz
    if tight is None or axis.shape != tight.frequency_hz.shape or not np.allclose(axis, tight.frequency_hz, rtol=1e-6):
        return []
    values = tight.values[lines]
    held = (np.isfinite(values) & (values != 0)).sum(axis=0) >= 2 * LEAST_LINES
    return [np.where(held, values, model)[None]]


def states_of(source: FrfSource, parameters: Parameterisation, s: Complexes) -> tuple[Complexes, list[Integers]]:
    """(S, F, R) FRFs at the start values, and with values of stiffnesses at their lower bounds, and which."""
    states, loosened = values_of(parameters)
    key = b"states" + s.tobytes()
    if key not in source.known:
        source.known[key] = source.model(s, parameters).nearby(parameters.initial)(np.array(states))
    found: Complexes = source.known[key]
    return found, loosened


def reach_of_one(source: FrfSource, parameters: Parameterisation, s: Complexes, model: Complexes) -> tuple[Floats, Floats]:
    """(R,) how far one loosened bolt alone moves the median level of a response, and its levels, that constant taken out [dB].

    What stands on one joint may be as good as cut off by it, as a blade by its root. Zeros where no bolt owns its values.

    Parameters
    ----------
    source : FrfSource
    parameters : Parameterisation
    s : (F,) complex array
    model : (F, R) complex array
        At the start values.
    """
    if (key := b"reach" + s.tobytes()) in source.known:
        known: tuple[Floats, Floats] = source.known[key]
        return known
    owners = [group.bolt.max() for group in parameters.groups if group.bolt is not None and group.bolt.size]
    joints = [np.concatenate(list(own.values())) for own in joints_of(parameters, 1 + int(max(owners, default=-1))) if own]
    frf, steps = source.model(s, parameters).nearby(parameters.initial), np.array([*LEVELS, -np.inf])
    level, rest = np.zeros((2, model.shape[1]))
    for own in joints:
        theta = np.tile(parameters.initial, (len(steps), 1))
        theta[:, own] = np.maximum(theta[:, own] + steps[:, None], parameters.bounds[own, 0])
        loose = frf(theta)
        change = np.nan_to_num(np.median(levels(loose) - levels(model), axis=1))
        change -= np.median(change, axis=1, keepdims=True)
        level, rest = np.maximum(level, np.abs(change).max(axis=0)), np.maximum(rest, apart(loose, model).max(axis=0))
    source.known[key] = level, rest
    return level, rest


def values_of(parameters: Parameterisation) -> tuple[list[Floats], list[Integers]]:
    """The start values, and with values of stiffnesses at their lower bounds: one, neighbours, all; and which."""
    start = parameters.initial
    states, loosened = [start], [np.zeros(0, dtype=np.int64)]
    for group, where, _ in parameters.placed:
        width = 1
        while group.kind == "stiffness" and width < 2 * group.count:
            for first in range(0, max(group.count - width // 2, 1), max(width // 2, 1)):
                loose = start.copy()
                at = np.arange(where.start + first, min(where.start + first + width, where.stop))
                loose[at] = group.bounds[at - where.start, 0]
                states.append(loose)
                loosened.append(at)
            width *= 2
    return states[:MOST_STATES], loosened[:MOST_STATES]


def nearest_states(measurement: Measurement, states: Complexes, most: int = 1) -> list[Complexes]:
    """The start values, and the states that come nearest but for a factor, times a power of the frequency or not; so many of each."""
    omega = 20.0 * np.log10(2.0 * np.pi * measurement.frequency_hz)[:, None]
    level = levels(measurement.values) - levels(states)
    orders = [np.median(spread(level - b * omega, 1), axis=1).argsort() for b in (0, *POWERS)]
    nearest = {int(k) for order in orders for k in order[:most]}
    return [states[k] for k in sorted({0, *nearest})]
