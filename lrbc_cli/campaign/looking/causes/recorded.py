"""Faults of recording, by comparison with the model: the first milliseconds are lost, a filter was on, a mounting has a resonance."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import LEAST_DIFFERENCE, apart, other_reading
from lrbc_cli.campaign.identification.compared.sensors import sensors_of
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.states import Seen, nearest_states
from lrbc_cli.campaign.looking.trials import UNLIKE
from lrbc_cli.updating.knots import evenly
from lrbc_cli.updating.statistics.chain.filters import Filter, filtered, filters
from lrbc_cli.updating.statistics.chain.start import starting


def field_reading_text(seen: Seen, *, several: int = 3) -> str:
    """Warning if the numbers of the pressures alone, or of the motions alone, fit the model when read otherwise; else empty.

    Parameters
    ----------
    seen : Seen
    several : int
        Least number of responses of a field, as few fit by chance. The other field must fit as stated.
    """
    air = np.array(seen.quantities) == "pressure"
    for own, field in ((air, "pressures"), (~air, "motions")):
        if not several <= own.sum() < own.size:
            continue
        rest = float(np.median(apart(seen.measured[:, ~own], seen.states[:, :, ~own]), axis=1).min())
        if rest > LEAST_DIFFERENCE:
            continue
        quantities = [quantity for quantity, there in zip(seen.quantities, own, strict=True) if there]
        reading = other_reading(quantities, seen.measurement.frequency_hz, seen.measured[:, own], seen.states[:, :, own], seen.job)
        if reading is not None:
            return f"{field} alone: {reading.text}. A key for a whole file would spoil its other records: give these a file of their own"
    return ""


def cut_text(seen: Seen, whole: Measurement, *, least: float = 0.15, share: float = 0.5) -> str:
    """Warning if the impulse responses begin some milliseconds after the blow, those of the model do not; else empty.

    Parameters
    ----------
    seen : Seen
    whole : Measurement
        On all its lines.
    least : float
        Energy up to some time over that of as long a time after it, below which nothing was recorded there. On virtual rigs and samples it
        is above 0.18 at all times; without the first 3 ms of the responses it is mostly below 0.15, without 6 ms below 0.1.
    share : float
        The same relative to the model: sensors far from the hammer, or in air, respond late.
    """
    hz = whole.frequency_hz
    if not evenly(hz):
        return ""
    times, own = starting(hz, whole.values)
    if not (lost := own < least).any():
        return ""
    s = 2j * np.pi * hz
    parameters = seen.source.parameters(s)
    lost &= own < share * starting(hz, seen.source.model(s, parameters).frf(parameters.initial))[1]
    if not lost.any():
        return ""
    first = 1e3 * float(times[np.where(lost, own, np.inf).argmin()])
    return (
        f"the responses begin about {first:.2g} ms after the blow, those of the model at once: their first milliseconds are probably "
        "lost. Check whether the recording started at the trigger, or a window cut off the beginning. Set a pretrigger (5 % of the "
        "record), start the window of the responses before the blow, and measure again"
    )


def filter_findings(seen: Seen, late: Collection[int] = ()) -> list[Finding]:
    """Findings of a filter of all responses, of single sensors in the reference job, or of those of ``late`` responses in another one."""
    hz, measured = seen.measurement.frequency_hz, seen.measured
    # Beside loosened bolts the nearest state.
    model = seen.model if seen.reference else min(nearest_states(seen), key=lambda state: float(np.median(apart(measured, state))))
    every = tuple(range(measured.shape[1]))
    if found := filtered(hz, measured, seen.model, filters(hz, inverse=True)):
        return [Finding(text=_filter_text("all responses", [found]), kind=Kind.FILTERED, responses=every)]
    asked = set(every if seen.reference else late)
    sensors = [own for each in sensors_of(seen.inputs) if (own := [i for i in each if i in asked])]
    alike: dict[tuple[object, ...], list[tuple[list[int], Filter]]] = {}
    tried, away = filters(hz, inverse=False), apart(measured, model)
    for own in sensors:
        others = np.delete(away, own)
        # Where the model does not explain the other sensors, one filter more or less is no evidence.
        if not others.size or float(np.median(others)) > UNLIKE:
            continue
        if found := filtered(hz, measured[:, own], model[:, own], tried):
            # Resonances of mountings differ; filters of several channels are one setting.
            alike.setdefault((found.high, found.order, own[0] if found.q else 0.0), []).append((own, found))
    return [_of_sensors(seen, each) for each in alike.values()]


def _of_sensors(seen: Seen, each: Sequence[tuple[list[int], Filter]]) -> Finding:
    """Finding of sensors whose channels have filters of one kind."""
    concerned = tuple(sorted(i for own, _ in each for i in own))
    text = _filter_text(", ".join(seen.inputs.responses[i].name for i in concerned), [found for _, found in each])
    # The model does not show it in each of them.
    more = "" if len(each) == 1 else ". Probably the channels of the other sensors have the same filter: check them, too"
    return Finding(text=text + more, kind=Kind.FILTERED, responses=concerned)


def _filter_text(names: str, every: Sequence[Filter]) -> str:
    """Text on responses that passed a filter, or filters of one kind with different corners."""
    found, corners = every[0], sorted({f"{each.corner_hz:.3g}" for each in every}, key=float)
    corner = " to ".join(corners[:: max(len(corners) - 1, 1)])
    if found.q:
        return (
            f"{names}: levels rise towards {found.corner_hz:.3g} Hz and fall beyond, and the phases lag by up to 180 degrees there: the "
            f"sensor probably moved on its mounting, with a resonance near {found.corner_hz:.3g} Hz (amplification about {found.q:.2g}). "
            "Screw or glue the sensor on, without a soft magnet, wax or a long stud, and measure again; or let reduction.band end below "
            f"{found.corner_hz / 3.0:.3g} Hz. Check the other jobs, too: loosened bolts may hide it there"
        )
    kind, side, end = ("high", "below", "begin") if found.high else ("low", "above", "end")
    whose = "the force" if found.inverse else "the signals"
    change = "rise" if found.inverse else "fall"
    return (
        f"levels of {names} {change} {side} {corner} Hz relative to the model, and their phases turn gradually: {whose} "
        f"probably passed a {kind}-pass filter of order {found.order} with its corner near {corner} Hz. Check AC coupling, "
        f"filters and conditioners of {'its channel' if found.inverse else 'these channels'}. Switch the filter off, or set the same one "
        f"for force and responses, and measure again; or let reduction.band {end} far from it"
    )
