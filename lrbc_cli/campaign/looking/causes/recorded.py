"""Faults of recording, by comparison with the model: the first milliseconds are lost, a filter was on, a mounting has a resonance."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import apart, levels
from lrbc_cli.campaign.identification.compared.offsets import sensor_of
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.tightness import UNLIKE
from lrbc_cli.campaign.looking.states import Ripple, Seen, nearest_states
from lrbc_cli.updating.comparison.scale import LEAST_LINES
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


def ripples(seen: Seen, *, records: int = 3) -> list[Ripple]:
    """Largest ripple of each excitation with at least so many records.

    Of a second blow of the share a after the time t, which the window of the force cuts off, ``1 + a exp(-2 pi i f t)`` remains.
    """
    hz, inputs, found = seen.measurement.frequency_hz, seen.inputs, list[Ripple]()
    state = min(seen.states, key=lambda each: float(np.median(apart(seen.measured, each))))
    for at, name in enumerate(inputs.excitations):
        own = np.flatnonzero(inputs.input_of == at)
        away = levels(seen.measured[:, own]) - levels(state[:, own])
        held = np.isfinite(away).all(axis=1)
        if own.size < records or held.sum() < LEAST_LINES:
            continue
        common = np.mean(away[held] - np.median(away[held], axis=0), axis=1)
        common -= common.mean()
        # From two periods in the band to four lines a period.
        times = np.arange(2.0, held.size / 4.0, 0.25) / np.ptp(hz)
        size = 2.0 * np.abs(np.exp(-2j * np.pi * times[:, None] * hz[held]) @ common) / held.sum()
        best = int(np.argmax(size))
        share = 0.5 * float(size[best]) ** 2 / max(float(np.mean(common**2)), np.finfo(float).tiny)
        found.append(Ripple(name, float(size[best]), share, 1.0 / float(times[best])))
    return found


def double_hits(
    found: Mapping[str, Sequence[Ripple]],
    reference: str,
    *,
    alone: tuple[float, float] = (1.5, 0.3),
    together: tuple[float, float] = (1.2, 0.15),
    alike: float = 0.1,
    most: float = 0.75,
    jobs: int = 4,
) -> dict[str, Finding]:
    """Findings of double hits by job: of one job, or of the reference job if most others show them relative to it.

    Parameters
    ----------
    found : mapping
        Ripples of each job.
    reference : str
    alone, together : (float, float)
        Least ripple [dB] and share of it in one job, and in the median over jobs that have it in common. On right campaigns shares were
        0.17 at most in one job, and 0.15 where most jobs had one period.
    alike : float
        Largest relative difference of periods that count as one.
    most, jobs : float, int
        Least share and number of the other jobs that have it in common.
    """
    told: dict[str, Finding] = {}
    others = {name: own for name, own in found.items() if name != reference}
    here = {each.excitation: each for each in found.get(reference, ())}
    for name in dict.fromkeys(each.excitation for own in others.values() for each in own):
        every = {job: each for job, own in others.items() for each in own if each.excitation == name}
        period = float(np.median([each.period_hz for each in every.values()]))
        same = [each for each in every.values() if abs(each.period_hz / period - 1.0) <= alike]
        median = Ripple(name, *np.median([each[1:] for each in same], axis=0).tolist()) if same else Ripple(name, 0.0, 0.0, 1.0)
        # Beside the model, the reference job shows it, too.
        own_too = name in here and abs(here[name].period_hz / period - 1.0) <= alike
        if own_too and len(same) >= max(jobs, most * len(every)) and median.db >= together[0] and median.share >= together[1]:
            told[reference] = _double_hit(median, " compared with the other jobs")
            continue
        for job, each in every.items():
            if each.db >= alone[0] and each.share >= alone[1]:
                told.setdefault(job, _double_hit(each))
    return told


def _double_hit(found: Ripple, where: str = "") -> Finding:
    """Finding of one ripple."""
    text = (
        f"the levels of all records of {found.excitation} rise and fall by about {found.db:.1f} dB every {found.period_hz:.3g} Hz{where}, "
        f"as after a second blow {1e3 / found.period_hz:.2g} ms after the first that the window of the force cut off. Check for double "
        "hits, let the analyser reject them, and measure again"
    )
    return Finding(text=text, kind=Kind.CUT)


def filter_findings(seen: Seen, late: Collection[int] = ()) -> list[Finding]:
    """Findings of a filter of all responses, of single sensors in the reference job, or of those of ``late`` responses in another one."""
    hz, measured = seen.measurement.frequency_hz, seen.measured
    # Beside loosened bolts the nearest state.
    model = seen.model if seen.reference else min(nearest_states(seen), key=lambda state: float(np.median(apart(measured, state))))
    every = tuple(range(measured.shape[1]))
    if found := filtered(hz, measured, seen.model, filters(hz, inverse=True)):
        return [Finding(text=_filter_text("all responses", [found]), kind=Kind.FILTERED, responses=every)]
    sensors: dict[tuple[object, ...], list[int]] = {}
    for i in every if seen.reference else sorted(late):
        sensors.setdefault(sensor_of(seen.inputs, i), []).append(i)
    alike: dict[tuple[object, ...], list[tuple[list[int], Filter]]] = {}
    tried, away = filters(hz, inverse=False), apart(measured, model)
    for own in sensors.values():
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
