"""How alike measured and computed FRFs are but for a constant: whose sensor is whose, and what would turn one into the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.comparison.correlation import measured_values
from lrbc_cli.updating.comparison.scale import ALIKE, LEAST_ALIKE, LEAST_LINES, POWERS, moved
from lrbc_cli.updating.robust import medians

#: Another reading counts where levels differ by less than this share of what they do as stated, and by this much then [dB].
CLEARLY, LEAST_DIFFERENCE = 0.5, 3.0

#: A response that lies so many times farther from the model than the median of all may not be where the model has it.
ALONE = 3.0

#: What may be left then [dB].
MOST_LEFT = 6.0

#: A response that lies so much below its level in the reference job has no signal [dB]; a gain of ten is as much.
OTHER_LEVEL_DB = 20.0

#: Numbers whose imaginary parts are smaller by this factor have none.
REAL = 1e-9


def levels(values: Complexes) -> Floats:
    """Levels [dB]; NaN where there is no value."""
    size = np.abs(values)
    with np.errstate(divide="ignore", invalid="ignore"):
        found: Floats = 20.0 * np.log10(size)
    return np.where(np.isfinite(found), found, np.nan)


def spread(difference: Floats, axis: int, least: int = LEAST_LINES) -> Floats:
    """Mean distance from the median along an axis; zero where fewer lines than the least can be compared."""
    enough = np.isfinite(difference).sum(axis=axis, keepdims=True) >= least
    known = np.where(enough, difference, 0.0)
    found: Floats = np.nanmean(np.abs(known - medians(known, axis)), axis=axis)
    return found


def apart(measured: Complexes, model: Complexes) -> Floats:
    """(..., R) mean absolute differences of levels, (..., F, R), but for a constant each [dB]."""
    return spread(levels(measured) - levels(model), -2)


def apart_there(measured: Complexes, computed: Complexes, largest: float) -> Floats:
    """(R,) the same at other places, (F, R) each; infinite where the model has rounding only, as across a plane of symmetry.

    ``largest`` is the size of the largest FRF of the model that there is.
    """
    felt = (np.abs(computed) > REAL * largest).sum(axis=0) >= LEAST_LINES
    return np.where(felt, apart(measured, computed), np.inf)


def outlying(misfits: Floats) -> list[int]:
    """Responses that lie alone far from the model, by the misfit of each [dB]: none where they are not the fewer."""
    typical = float(np.nanmedian(misfits))
    alone: list[int] = np.flatnonzero(misfits > max(ALONE * typical, typical + LEAST_DIFFERENCE)).tolist()
    return alone if 2 * len(alone) < misfits.size else []


def off_level(
    inputs: Inputs, measured: Complexes, tight: Complexes, reference: str, job: str, reach: Floats | float = 0.0
) -> dict[int, str]:
    """Responses whose level has left that of the reference job, the others' not, in words: bolts hardly move the median of a band so far.

    Parameters
    ----------
    inputs : Inputs
    measured, tight : (F, R) complex arrays
        Of a job and of the reference job, on the same lines.
    reference, job : str
    reach : (R,) float array or float
        How far one bolt alone may move it [dB].
    """
    held = np.isfinite(levels(measured) - levels(tight)).sum(axis=0) >= LEAST_LINES
    if held.sum() < 2:
        return {}
    change = np.zeros(held.size)
    change[held] = np.nanmedian(levels(measured[:, held]) - levels(tight[:, held]), axis=0)
    change[held] -= np.median(change[held])
    off, told = np.abs(change) > np.maximum(OTHER_LEVEL_DB, reach), dict[int, str]()
    for i in np.flatnonzero(off).tolist():
        others = [k for k in same_sensor(inputs, i) if held[k]]
        # A sensor that is off is off wherever the hammer hits, and is told once.
        if not all(off[k] for k in others) or any(k < i for k in others):
            continue
        names = " and ".join(inputs.responses[k].name for k in (i, *others))
        told[i] = (
            f"{names} {'are' if others else 'is'} {abs(change[i]):.0f} dB {'below' if change[i] < 0 else 'above'} "
            f"{'their' if others else 'its'} level in {reference}, the other responses are not. Check whether the sensor or its cable was "
            f"off, or another range or sensitivity was set. Measure it again, or remove its record from the file of {job}"
        )
    return told


def same_sensor(inputs: Inputs, response: int) -> list[int]:
    """Other responses at the same DOF, hit elsewhere."""
    own = inputs.responses[response]
    return [
        k
        for k, other in enumerate(inputs.responses)
        if k != response and own.node is not None and (other.node, other.direction) == (own.node, own.direction)
    ]


def turned(measured: Complexes, states: Complexes) -> list[int]:
    """Responses whose phases are the opposite of the model's, in the state in which those of all are most alike but for the sign.

    Nearer states than those that levels find: antiresonances, which move most, weigh no more than other lines.

    Parameters
    ----------
    measured : (F, R) complex array
    states : (S, F, R) complex array
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = measured / np.abs(measured), states / np.abs(states)
    own = _cosine(x, y, 1)
    best = int(np.argmax(np.abs(own).sum(axis=1)))
    if np.median(np.abs(own[best])) < ALIKE:
        return []
    # Of a sensor in another's place the phases are the other's.
    others = np.abs(_cosine(x[:, :, None], y[best][:, None, :], 0)).max(axis=1)
    found: list[int] = np.flatnonzero((own[best] <= -ALIKE) & (-own[best] >= others)).tolist()
    return found


def sideways(measured: Complexes, states: Complexes) -> str:
    """How phases of nearly all responses stand across those of the model, in the state in which they are most alike then.

    Real and imaginary parts in each other's place make ``i conj(H)`` of ``H``.

    Parameters
    ----------
    measured : (F, R) complex array
    states : (S, F, R) complex array

    Returns
    -------
    str
        ``exchanged``: the parts are; ``turned``: all phases are 90 degrees off; empty: neither.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = measured / np.abs(measured), states / np.abs(states)
    # Sensors may be reversed one by one.
    scores = [np.median(np.abs(_cosine(x, other, 1)), axis=1) for other in (y, 1j * y, 1j * np.conj(y))]
    best = int(np.argmax(np.maximum(scores[1], scores[2])))
    plain, turned_, exchanged_ = (float(score[best]) for score in scores)
    if max(turned_, exchanged_) < ALIKE or max(turned_, exchanged_) - max(plain, float(scores[0].max())) < LEAST_ALIKE:
        return ""
    return "exchanged" if exchanged_ >= turned_ else "turned"


def run_backwards(frequency_hz: Floats, values: Complexes, *, most: float = 0.8) -> bool:
    """Whether a structure would answer before the blow: most of the impulse responses lies in the second half of the block.

    No model is needed: of complex conjugates time runs the other way. On virtual rigs and samples the share is 0.05 at the most, of their
    conjugates 0.95 at least.

    Parameters
    ----------
    frequency_hz : (F,) float array
        Evenly spaced, or nothing can be said.
    values : (F, R) complex array
    most : float
        Share of the energy in the second half, in the median over the responses.
    """
    steps = np.diff(frequency_hz)
    whole = np.isfinite(values).all(axis=0) & (np.abs(values) > 0.0).any(axis=0)
    if steps.size < 2 * LEAST_LINES or not whole.any() or not np.allclose(steps, steps.mean(), rtol=1e-3):
        return False
    energy = np.abs(np.fft.ifft(values[:, whole], axis=0)) ** 2
    share = energy[energy.shape[0] // 2 :].sum(axis=0) / energy.sum(axis=0)
    return bool(np.median(share) > most)


def _cosine(one: Complexes, other: Complexes, axis: int) -> Floats:
    """Mean over the lines of the cosine of the angle between values of size one, without those that are none; zero where all are."""
    cosine = np.real(one * np.conj(other))
    known = np.isfinite(cosine)
    found: Floats = np.where(known, cosine, 0.0).sum(axis=axis) / np.maximum(known.sum(axis=axis), 1)
    return found


def exchanged(inputs: Inputs, measured: Complexes, states: Sequence[Complexes] | Complexes) -> list[tuple[int, ...]]:
    """Responses of one quantity in each other's place: measured i is computed j, j is the next, and so on round.

    Parameters
    ----------
    inputs : Inputs
    measured : (F, R) complex array
    states : sequence of (F, R) complex arrays
        FRFs of the model; the one counts that comes nearest.
    """
    count, limits = len(inputs.responses), inputs.statistics.validation
    kinds = [(response.quantity, response.input) for response in inputs.responses]
    other = np.array([[one != two for two in kinds] for one in kinds])
    level = levels(measured)
    # (S, R, R): measured i less computed j.
    table = np.array([[spread(level[:, [i]] - levels(state), 0, limits.exchanged_lines) for i in range(count)] for state in states])
    table[:, np.isnan(level).all(axis=0)] = 0.0
    table[:, other] = 1e3
    # Loaded here: most commands do without.
    from scipy.optimize import linear_sum_assignment

    orders = [linear_sum_assignment(each)[1] for each in table]
    order, nearest = min(zip(orders, table, strict=True), key=lambda pair: float(pair[1][np.arange(count), pair[0]].sum()))
    found = []
    for cycle in _cycles(order.tolist()):
        at, to = list(cycle), [int(order[i]) for i in cycle]
        stated, changed = float(table[:, at, at].sum(axis=1).min()), float(table[:, at, to].sum(axis=1).min())
        # What the model lacks stays, wherever a sensor is: as much as of the others. Beyond that hardly anything may be left.
        others = np.delete(np.diag(nearest), at)
        lacking = len(at) * float(np.median(others)) if others.size else 0.0
        ways = ((0.0, limits.exchanged_share), (lacking, limits.exchanged_share**2))
        if any(stated - own > len(at) * limits.exchanged_db and changed - own < share * (stated - own) for own, share in ways):
            found.append(cycle)
    # Cables in each other's place are so wherever the hammer hits: where that is clear of one point, it need not be of the others.
    for clear in tuple(found):
        for also in _elsewhere(inputs, clear):
            at, to = list(also), [*also[1:], also[0]]
            if not {i for own in found for i in own}.intersection(at) and nearest[at, to].sum() < nearest[at, at].sum():
                found.append(also)
    return found


def by_place(inputs: Inputs) -> dict[tuple[int | None, int | None, str, int], int]:
    """Responses by their node, direction, quantity and excitation; those without a node are left out."""
    return {(r.node, r.direction, r.quantity, r.input): i for i, r in enumerate(inputs.responses) if r.node is not None}


def _elsewhere(inputs: Inputs, cycle: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """The same sensors hit at each of the other points, where all of them were measured there."""
    places = by_place(inputs)
    own = [inputs.responses[i] for i in cycle]
    for at in sorted({r.input for r in inputs.responses} - {own[0].input}):
        others = [places.get((r.node, r.direction, r.quantity, at)) for r in own]
        if all(i is not None for i in others):
            yield tuple(i for i in others if i is not None)


def _cycles(order: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Those of a permutation that move anything."""
    left = {i for i, to in enumerate(order) if i != to}
    while left:
        cycle = [min(left)]
        while order[cycle[-1]] != cycle[0]:
            cycle.append(order[cycle[-1]])
        left -= set(cycle)
        yield tuple(cycle)


def by_sensors(inputs: Inputs, cycles: Sequence[tuple[int, ...]]) -> list[tuple[tuple[int, ...], ...]]:
    """Cycles of responses that are the same cycle of sensors, hit by another hammer each, beside each other: one exchange of cables."""
    found: list[list[tuple[int, ...]]] = []

    def sensors(cycle: Sequence[int]) -> list[tuple[int | None, int | None]]:
        return [(inputs.responses[i].node, inputs.responses[i].direction) for i in cycle]

    # In one order, so that it is one finding in all jobs.
    for cycle in sorted(cycles):
        turns = [(*cycle[k:], *cycle[:k]) for k in range(len(cycle))]
        known = all(inputs.responses[i].node is not None for i in cycle)
        same = ((several, turn) for several in found for turn in turns if known and sensors(turn) == sensors(several[0]))
        several, turn = next(same, (None, cycle))
        if several is None:
            found.append([turn])
        else:
            several.append(turn)
    return [tuple(several) for several in found]


def exchanged_text(inputs: Inputs, cycles: Sequence[Sequence[int]], job: str) -> str:
    """What was found of sensors, and what to write: measured under the first name is the one that the model has as the second."""
    records, said, places, fits = list[str](), list[str](), list[str](), list[str]()
    for cycle in cycles:
        names = [inputs.responses[i].name for i in cycle]
        following = [*names[1:], names[0]]
        # The record that holds a response is the one that was measured in its place.
        records += [f"{to}: {name}" for name, to in zip(names, following, strict=True)]
        said.append(f"{', '.join(names[:-1])} and {names[-1]}")
        if len(names) == 2:
            places.append(" and ".join(f"responses.{name}" for name in names))
        else:
            places.append(", ".join(f"responses.{name} the place of responses.{to}" for name, to in zip(names, following, strict=True)))
        fits.append(", ".join(f"{name} fits the model's {to}" for name, to in zip(names, following, strict=True)))
    each = "each fits the model's FRF of the other" if len(cycles[0]) == 2 else "; ".join(fits)
    exchange = f"{'exchange the places of' if len(cycles[0]) == 2 else 'give'} {'; '.join(places)}"
    own = f"write jobs.{job}.records: {{{', '.join(records)}}}"
    # Of one job alone the cables are wrong, of the reference job rather the campaign file.
    fix = f"{exchange}, or {own}" if job == inputs.campaign.update.reference else f"{own}, or, if all jobs are affected, {exchange}"
    return f"{'; '.join(said)} are probably exchanged: {each}. {fix[:1].upper()}{fix[1:]}"


@dataclass(frozen=True)
class Reading:
    """Another way to read the numbers of a measurement, under which they are FRFs of the model.

    Attributes
    ----------
    text : str
        What was found, and what to do.
    before, after : float
        Median over the responses of how far levels are apart, constants taken out, as stated and read so [dB].
    """

    text: str
    before: float
    after: float


def other_reading(inputs: Inputs, frequency_hz: Floats, measured: Complexes, states: Complexes, job: str) -> Reading | None:
    """How the numbers have to be read to be FRFs of the model; None where they are, or where no reading makes them so.

    Parameters
    ----------
    inputs : Inputs
    frequency_hz : (F,) float array
    measured : (F, R) complex array
    states : (S, F, R) complex array
    job : str
    """
    computed = levels(states)
    omega = 20.0 * np.log10(2.0 * np.pi * frequency_hz)[:, None]
    quantities = [response.quantity for response in inputs.responses]

    def least(values: Complexes, motions: bool, *, sloped: bool = False) -> tuple[float, int]:
        """Over derivatives, or all powers of the frequency, and states."""
        powers = [b for b in (0, *POWERS) if b == 0 or sloped or (motions and all(moved(quantity, b) for quantity in quantities))]
        scores = [float(np.median(spread(levels(values) - computed - b * omega, 1), axis=1).min()) for b in powers]
        return min(zip(scores, powers, strict=True))

    before, _ = least(measured, True)
    if before <= LEAST_DIFFERENCE:
        return None
    motion = quantities[0]
    ways = [*_read_otherwise(measured, job)]
    if set(quantities) == {"pressure"}:
        flat = _unweighted(frequency_hz, measured)
        # The curve is steep: a power of the frequency must not leave less.
        ways += [(flat, _WEIGHTED, False)] if least(flat, False)[0] < least(measured, False, sloped=True)[0] else []
    found = [(*least(values, inverse), text, inverse) for values, text, inverse in ways]
    after, power, text, inverse = min(found)
    if after >= min(CLEARLY * before, MOST_LEFT):
        return None
    if inverse:
        word = _INVERSE.get(moved(motion, power) or "", "force over response")
        text = f"probably inverse FRFs ({word}): export {motion} over force, or take the reciprocal of every value"
    change = f"from {before:.1f} to {after:.1f} dB (mean level of each response removed)"
    return Reading(f"{text}. Read this way, the level misfit falls {change}", before, after)


#: What to say of levels that are the model's without the weighting.
_WEIGHTED = "levels probably follow the A-weighting: switch the weighting of the microphones off in the analyser, and export again"

_INVERSE = {
    "displacement": "dynamic stiffness, force over displacement",
    "velocity": "mechanical impedance, force over velocity",
    "acceleration": "apparent mass, force over acceleration",
}


def _unweighted(frequency_hz: Floats, measured: Complexes) -> Complexes:
    """(F, R) pressures without the A-weighting of IEC 61672-1, Annex E; the constant that makes it 0 dB at 1 kHz is a factor."""
    f = frequency_hz**2
    weight = f**2 / ((f + 20.598997**2) * (f + 12194.217**2) * np.sqrt((f + 107.65265**2) * (f + 737.86223**2)))
    return np.asarray(measured / np.where(weight > 0.0, weight, np.nan)[:, None])


def _read_otherwise(measured: Complexes, job: str) -> Iterator[tuple[Complexes, str, bool]]:
    """The numbers read in other ways, what to do then, and whether they are reciprocals."""
    valid = measured_values(measured)
    known = np.where(valid, measured, 1.0)

    def only(values: Complexes | Floats) -> Complexes:
        return np.where(valid, values.astype(np.complex128), np.nan)

    yield only(1.0 / known), "", True
    real = bool(np.abs(known.imag).max() <= REAL * np.abs(known).max())
    decibels = known.real if real else np.abs(known)
    if np.abs(decibels).max() < 1000.0:
        fix = f"levels in decibels probably read as magnitudes: set jobs.{job}.format: {{representation: db-phase}}"
        if real:
            fix = "levels in decibels probably read as real parts: export real and imaginary parts, or levels with a column of phases"
        yield only(10.0 ** (decibels / 20.0)), fix, False
    if not real:
        fix = f"magnitudes and phases probably read as real and imaginary parts: set jobs.{job}.format: {{representation: magnitude-phase}}"
        yield only(known.real), fix, False
        if np.abs(known.real).max() < 1000.0:
            fix = f"decibels and phases probably read as real and imaginary parts: set jobs.{job}.format: {{representation: db-phase}}"
            yield only(10.0 ** (known.real / 20.0)), fix, False
    fix = "probably squared magnitudes (power spectra): export the FRFs, response over force, with their phases"
    yield only(np.sqrt(np.abs(known))), fix, False
