"""Measurements beside the model before anything is identified: units, signs, sensors in each other's place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.identification.doubts import factors_of, offset_texts
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.identification.unknowns import parameterise
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.memory import options_of, reduction_cost
from lrbc_cli.campaign.reduced.stage import FrfSource, ReductionStage
from lrbc_cli.errors import LrbcError
from lrbc_cli.reduction.build import reduce_model
from lrbc_cli.reduction.ports import PortFrf
from lrbc_cli.updating.scale import LEAST_REACH, MOST_REACH, Offset

#: Lines of a job that are looked at.
LINES = 200

#: Share of the band that its lines have to cover.
LEAST_BAND = 0.8

#: What may be left of the misfit at start values where a factor is taken out [dB].
MOST_LEFT = 6.0

#: From so much on, in the median over the responses used, the tight state is no model's with small errors [dB].
UNLIKE = 6.0

#: A response that lies so many times farther from the model than the median of all may not be where the model has it.
ALONE = 3.0

#: Predicted seconds up to which a reduced model is built for this where none is in the cache, and its tolerance.
MOST_SECONDS, COARSE = 3.0, 3e-2

#: Two sensors are exchanged where the levels of both differ by less than this share of what they do as stated, and by this much then [dB].
EXCHANGED, LEAST_DIFFERENCE = 0.5, 3.0


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
        # Another axis, or another unit of it, looks like anything.
        whole = [name for name, found in measurements.items() if np.ptp(found.frequency_hz) > LEAST_BAND * (high - low)]
        order = sorted(whole, key=lambda name: name != reference)
        return _told({name: _looked_at(inputs, source, measurements[name], name) for name in order}), ""
    except LrbcError as error:
        return [], f"measured and computed FRFs were not compared: {error.problem}"


def _source(inputs: Inputs, folder: Path) -> FrfSource | None:
    """The reduced model of the cache, else a coarse one that is built here where that is cheap; None where it is not."""
    decision = cache.look_up(folder, cache.key_parts(inputs))
    if not decision.hit and reduction_cost(inputs)[0].seconds > MOST_SECONDS:
        return None
    options = replace(options_of(inputs), tolerance=max(COARSE, inputs.campaign.reduction.tolerance), held_out=1)
    backend = inputs.campaign.reduction.backend
    found = cache.load(decision, inputs) if decision.hit else reduce_model(inputs.model, inputs.input_of, options, backend=backend)
    return _Looking(inputs, ReductionStage(found, decision, 0.0), "port")


def _looked_at(inputs: Inputs, source: FrfSource, measurement: Measurement, name: str) -> dict[tuple[object, ...], str]:
    """What is found of one job, each under what tells whether another job has it, too."""
    size = measurement.frequency_hz.size
    lines = np.unique(np.linspace(0, size - 1, min(size, LINES)).round().astype(np.int64))
    few = replace(measurement, frequency_hz=measurement.frequency_hz[lines], values=measurement.values[lines])
    s = 2j * np.pi * few.frequency_hz
    parameters, _ = parameterise(inputs, source, s)
    model = source.model(s, parameters).frf(parameters.initial)
    offsets = factors_of(inputs, few, (model,))
    exchanged = _exchanged(inputs, few.values, model)
    involved = {i for pair in exchanged for i in pair}
    offsets = tuple(replace(o, named=o.named and _trusted(o, offsets)) for o in offsets if o.response not in involved)
    told: dict[tuple[object, ...], str] = {}
    for text in offset_texts(inputs, offsets, name):
        # The words up to the numbers: the same of several jobs is said once.
        told[tuple(text.split(":")[:2])] = text
    for i, j in exchanged:
        one, two = inputs.responses[i].name, inputs.responses[j].name
        told["exchanged", i, j] = (
            f"{one} and {two} in each other's place, it seems: each fits the model's FRF of the other: exchange the places of "
            f"responses.{one} and responses.{two}, or jobs.{name}.records: {{{one}: {two}, {two}: {one}}}"
        )
    if not told and name == inputs.campaign.update.reference:
        every = np.array([_apart(few.values[:, i], model[:, i]) for i in range(len(inputs.responses))])
        apart = every[inputs.used]
        typical = float(np.median(every))
        alone = np.flatnonzero(every > max(ALONE * typical, typical + LEAST_DIFFERENCE)).tolist()
        for i in alone if 2 * len(alone) < every.size else ():
            response = inputs.responses[i].name
            told["alone", i] = (
                f"{response} lies {every[i]:.1f} dB from the model, constants taken out, where the median of all responses is "
                f"{typical:.1f} dB: check the place and the component of responses.{response} (lrbc check --picture), and that the "
                "channel is not another sensor's"
            )
        if float(np.median(apart)) > UNLIKE:
            told["unlike",] = (
                f"measured and computed FRFs have little in common, it seems: {min(apart):.1f} to {max(apart):.1f} dB apart at the start "
                "values, constants taken out: check the mass sum (units of the model), damping, start values, places and directions "
                "of hammer and sensors (lrbc check --picture); errors of some per cent are what `lrbc calibrate` is for"
            )
    return told


def _trusted(offset: Offset, offsets: Sequence[Offset]) -> bool:
    """Whether a factor is none of the errors that a model has at its start values.

    Then its interval is narrow and little is left; a power of the frequency comes alone, or most responses share it.
    """
    if offset.half > MOST_REACH or offset.after > MOST_LEFT:
        return False
    alike = sum(other.named and other.power == offset.power for other in offsets)
    return offset.power == 0 or abs(offset.db) <= max(offset.half, LEAST_REACH) or 2 * alike > max(len(offsets), 4)


def _told(found: Mapping[str, Mapping[tuple[object, ...], str]]) -> list[str]:
    """Each finding once, with the jobs that share it."""
    jobs: dict[str, list[str]] = {}
    first: dict[str, str] = {}
    for name, told in found.items():
        for kind, text in told.items():
            at = first.setdefault(repr(kind), f"job {name}: {text}")
            jobs.setdefault(at, []).append(name)
    return [text + (f"; the same in {', '.join(names[1:])}" if len(names) > 1 else "") for text, names in jobs.items()]


def _exchanged(inputs: Inputs, measured: Complexes, model: Complexes) -> list[tuple[int, int]]:
    """Pairs of responses of one quantity whose levels follow the model's of each other."""
    found = []
    for i, j in combinations(range(len(inputs.responses)), 2):
        one, two = inputs.responses[i], inputs.responses[j]
        if (one.quantity, one.input) != (two.quantity, two.input):
            continue
        stated = _apart(measured[:, i], model[:, i]) + _apart(measured[:, j], model[:, j])
        other = _apart(measured[:, i], model[:, j]) + _apart(measured[:, j], model[:, i])
        if stated > 2.0 * LEAST_DIFFERENCE and other < EXCHANGED * stated:
            found.append((i, j))
    return found


def _apart(measured: Complexes, model: Complexes) -> float:
    """Mean absolute difference of two levels but for a constant [dB]; zero where nothing can be compared."""
    valid = np.isfinite(measured) & (np.abs(measured) > 0) & (np.abs(model) > 0)
    if not valid.any():
        return 0.0
    level: Floats = 20.0 * np.log10(np.abs(measured[valid] / model[valid]))
    return float(np.mean(np.abs(level - np.median(level))))
