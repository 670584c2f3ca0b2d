"""Faults of recording, by comparison with the model: the first milliseconds are lost, a filter was on, a mounting has a resonance."""

from __future__ import annotations

import numpy as np

from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import apart
from lrbc_cli.campaign.identification.compared.offsets import sensor_of
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.tightness import UNLIKE
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.updating.knots import evenly
from lrbc_cli.updating.statistics.chain.filters import Filter, filtered, filters
from lrbc_cli.updating.statistics.chain.start import starting


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


def filter_findings(seen: Seen) -> list[Finding]:
    """Findings of a filter of all responses or, in the reference job, of single sensors; empty if there is none."""
    hz, measured, model = seen.measurement.frequency_hz, seen.measured, seen.model
    every = tuple(range(measured.shape[1]))
    if found := filtered(hz, measured, model, filters(hz, inverse=True)):
        return [Finding(text=_filter_text("all responses", found), kind=Kind.FILTERED, responses=every)]
    if not seen.reference:
        return []
    sensors: dict[tuple[object, ...], list[int]] = {}
    for i in every:
        sensors.setdefault(sensor_of(seen.inputs, i), []).append(i)
    told, tried, away = list[Finding](), filters(hz, inverse=False), apart(measured, model)
    for own in sensors.values():
        others = np.delete(away, own)
        # Where the model does not explain the other sensors, one filter more or less is no evidence.
        if not others.size or float(np.median(others)) > UNLIKE:
            continue
        if found := filtered(hz, measured[:, own], model[:, own], tried):
            names = ", ".join(seen.inputs.responses[i].name for i in own)
            told.append(Finding(text=_filter_text(names, found), kind=Kind.FILTERED, responses=tuple(own)))
    return told


def _filter_text(names: str, found: Filter) -> str:
    """Text on responses that passed a filter."""
    if found.q:
        return (
            f"{names}: levels rise towards {found.corner_hz:.3g} Hz and fall beyond, and the phases lag by up to 180 degrees there: the "
            f"sensor probably moved on its mounting, with a resonance near {found.corner_hz:.3g} Hz (amplification about {found.q:.2g}). "
            "Screw or glue the sensor on, without a soft magnet, wax or a long stud, and measure again; or let reduction.band end below "
            f"{found.corner_hz / 3.0:.2g} Hz"
        )
    kind, side, end = ("high", "below", "begin") if found.high else ("low", "above", "end")
    whose = "the force" if found.inverse else names
    change = "rise" if found.inverse else "fall"
    return (
        f"levels of {names} {change} {side} {found.corner_hz:.3g} Hz relative to the model, and their phases turn gradually: {whose} "
        f"probably passed a {kind}-pass filter of order {found.order} with its corner near {found.corner_hz:.3g} Hz. Check AC coupling, "
        f"filters and conditioners of {'its channel' if found.inverse else 'these channels'}. Switch the filter off, or set the same one "
        f"for force and responses, and measure again; or let reduction.band {end} far from it"
    )
