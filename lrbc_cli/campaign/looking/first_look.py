"""Measurements beside the model before anything is identified: units, signs, sensors in each other's place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Complexes
from lrbc_cli.campaign.identification.doubts import LEAST_BAND, factors_of, offset_texts, trusted
from lrbc_cli.campaign.identification.likeness import (
    LEAST_DIFFERENCE,
    apart,
    exchanged,
    exchanged_text,
    levels,
    other_reading,
    outlying,
    spread,
)
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.identification.unknowns import parameterise
from lrbc_cli.campaign.looking.rescaled import rescaled_text
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.memory import options_of, reduction_cost
from lrbc_cli.campaign.reduced.stage import FrfSource, ReductionStage, require_baselines
from lrbc_cli.errors import DataError, LrbcError
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.build import reduce_model
from lrbc_cli.reduction.ports import PortFrf
from lrbc_cli.updating.scale import POWERS

#: Lines of a job that are looked at.
LINES = 200

#: From so much on, in the median over the responses used, the tight state is no model's with small errors [dB].
UNLIKE = 6.0

#: Predicted operations up to which a reduced model is built for this where none is in the cache: some seconds, and counted, not timed, so
#: that what `check` finds does not depend on what else the machine does.
MOST_WORK = 2e11

#: Tolerance of that model.
COARSE = 3e-2

#: States of the model that a measurement is compared with, and how many of the nearest with all sensors in each other's place.
MOST_STATES, NEAREST = 150, 4


@dataclass
class _Looking(FrfSource):
    """FRFs that are kept nowhere."""

    def _compute(self, s: Complexes) -> PortFrf:
        assert self.stage is not None
        return self.stage.reduction.model.ports(s)


def first_look(inputs: Inputs, folder: Path, measurements: Mapping[str, Measurement]) -> tuple[list[str], str]:
    """Warnings of what is the same at all lines between measurement and model, and a note where they were not compared.

    Parameters
    ----------
    inputs : Inputs
    folder : Path
        Of the cache; nothing is written to it.
    measurements : mapping
        By job, the reference job wherever it stands.
    """
    try:
        source = _source(inputs, folder)
        if source is None:
            return [], "measured and computed FRFs are compared once `lrbc reduce` has been run: units, signs, exchanged sensors"
        reference = inputs.campaign.update.reference
        low, high = inputs.campaign.reduction.band
        whole = [name for name, found in measurements.items() if np.ptp(found.frequency_hz) > LEAST_BAND * (high - low)]
        order = sorted(whole, key=lambda name: name != reference)
        # A matrix without what is subtracted from it is none to compare with.
        lacking = _lacking(inputs, source)
        told = [] if lacking else _told({name: _looked_at(inputs, source, measurements[name], name) for name in order})
        return lacking + told, ""
    except LrbcError as error:
        return [], f"measured and computed FRFs were not compared: {error.problem}"


def _source(inputs: Inputs, folder: Path) -> FrfSource | None:
    """The reduced model of the cache, else a coarse one that is built here where that is cheap; None where it is not."""
    decision = cache.look_up(folder, cache.key_parts(inputs))
    if not decision.hit and reduction_cost(inputs)[0].work > MOST_WORK:
        return None
    options = replace(options_of(inputs), tolerance=max(COARSE, inputs.campaign.reduction.tolerance), held_out=1)
    backend = inputs.campaign.reduction.backend
    found = cache.load(decision, inputs) if decision.hit else reduce_model(inputs.model, inputs.input_of, options, backend=backend)
    return _Looking(inputs, ReductionStage(found, decision, 0.0), "port")


def _lacking(inputs: Inputs, source: FrfSource) -> list[str]:
    """What `lrbc reduce` will refuse: baselines that the stiffness does not hold."""
    try:
        if source.stage is not None:
            require_baselines(inputs, source.stage.reduction.model)
    except DataError as error:
        return [f"{error.problem}: {error.hint}"]
    return []


def _looked_at(inputs: Inputs, source: FrfSource, measurement: Measurement, name: str) -> dict[tuple[object, ...], str]:
    """What is found of one job, each under what tells whether another job has it, too."""
    size = measurement.frequency_hz.size
    lines = np.unique(np.linspace(0, size - 1, min(size, LINES)).round().astype(np.int64))
    few = replace(measurement, frequency_hz=measurement.frequency_hz[lines], values=measurement.values[lines])
    s = 2j * np.pi * few.frequency_hz
    parameters, _ = parameterise(inputs, source, s)
    states = _states(source, parameters, s)
    reading = other_reading(inputs, few.frequency_hz, few.values, states, name)
    if reading is not None:
        return {("read",): reading.text}
    near = _nearest(few, states)
    told: dict[tuple[object, ...], str] = {}
    exchanges = exchanged(inputs, few.values, _nearest(few, states, NEAREST))
    offsets = factors_of(inputs, few, near)
    involved = {i for cycle in exchanges for i in cycle}
    offsets = tuple(replace(o, named=o.named and trusted(o, offsets)) for o in offsets if o.response not in involved)
    for text in offset_texts(inputs, offsets, name):
        # The words up to the numbers: the same of several jobs is said once.
        told[tuple(text.split(":")[:2])] = text
    for cycle in exchanges:
        told["exchanged", cycle] = exchanged_text(inputs, cycle, name)
    if not told and name == inputs.campaign.update.reference:
        told |= _unlike(inputs, few.values, s, states[0], parameters)
    return told


def _states(source: FrfSource, parameters: Parameterisation, s: Complexes) -> Complexes:
    """(S, F, R) FRFs at the start values, and with values of stiffnesses at their lower bounds: each, neighbours together, all."""
    start = parameters.initial
    states = [start]
    for group, (where, _) in zip(parameters.groups, parameters.slices, strict=True):
        width = 1
        while group.kind == "stiffness" and width < 2 * group.count:
            for first in range(0, max(group.count - width // 2, 1), max(width // 2, 1)):
                loose = start.copy()
                at = np.arange(where.start + first, min(where.start + first + width, where.stop))
                loose[at] = group.bounds[at - where.start, 0]
                states.append(loose)
            width *= 2
    key = b"states" + s.tobytes()
    if key not in source.known:
        source.known[key] = source.model(s, parameters).nearby(start)(np.array(states[:MOST_STATES]))
    found: Complexes = source.known[key]
    return found


def _nearest(measurement: Measurement, states: Complexes, most: int = 1) -> list[Complexes]:
    """The start values, and the states that come nearest but for a factor, times a power of the frequency or not; so many of each."""
    omega = 20.0 * np.log10(2.0 * np.pi * measurement.frequency_hz)[:, None]
    level = levels(measurement.values) - levels(states)
    orders = [np.median(spread(level - b * omega, 1), axis=1).argsort() for b in (0, *POWERS)]
    nearest = {int(k) for order in orders for k in order[:most]}
    return [states[k] for k in sorted({0, *nearest})]


def _unlike(
    inputs: Inputs, measured: Complexes, s: Complexes, model: Complexes, parameters: Parameterisation
) -> dict[tuple[object, ...], str]:
    """What is said of a tight state that is not explained, though no factor and no sensor in another's place is to blame."""
    every = apart(measured, model)
    own = every[inputs.used]
    typical = float(np.median(every))
    told: dict[tuple[object, ...], str] = {}
    if typical > LEAST_DIFFERENCE:
        text = rescaled_text(inputs, s, measured, model, parameters.dynamic(parameters.initial, s), typical)
        if text is not None:
            return {("rescaled",): text}
    if float(np.median(own)) > UNLIKE:
        told["unlike",] = (
            f"measured and computed FRFs have little in common, it seems: {min(own):.1f} to {max(own):.1f} dB apart at the start "
            "values, constants taken out: check the mass sum (units of the model), damping, start values, places and directions "
            "of hammer and sensors (lrbc check --picture); errors of some per cent are what `lrbc calibrate` is for"
        )
    alone = outlying(every)
    for i in alone:
        response = inputs.responses[i].name
        told["alone", i] = (
            f"{response} lies {every[i]:.1f} dB from the model, constants taken out, where the median of all responses is "
            f"{typical:.1f} dB: check the place and the component of responses.{response} (lrbc check --picture), and that the "
            "channel is not another sensor's"
        )
    return told


def _told(found: Mapping[str, Mapping[tuple[object, ...], str]]) -> list[str]:
    """Each finding once, with the jobs that share it."""
    jobs: dict[str, list[str]] = {}
    first: dict[str, str] = {}
    for name, told in found.items():
        for kind, text in told.items():
            at = first.setdefault(repr(kind), f"job {name}: {text}")
            jobs.setdefault(at, []).append(name)
    return [text + (f"; the same in {', '.join(names[1:])}" if len(names) > 1 else "") for text, names in jobs.items()]
