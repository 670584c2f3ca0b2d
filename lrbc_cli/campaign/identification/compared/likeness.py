"""Compares measured and computed FRFs up to constant factors, to detect exchanged or reversed sensors, and misread or converted values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.identification.compared.sensors import same_sensor
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.comparison.correlation import measured_values
from lrbc_cli.updating.comparison.scale import ALIKE, LEAST_ALIKE, LEAST_LINES, POWERS, moved
from lrbc_cli.updating.knots import evenly
from lrbc_cli.updating.robust import medians
from lrbc_cli.updating.statistics.decibels import decibel

#: Another reading is reported if its difference is below this share of that as stated, and the latter is larger than this [dB].
CLEARLY, LEAST_DIFFERENCE = 0.5, 3.0

#: Misfit over the median misfit of all responses from which a response may be at another place than in the model.
ALONE = 3.0

#: Largest difference that another reading may leave [dB].
MOST_LEFT = 6.0

#: Difference from the level in the reference job that no bolt causes [dB]: a factor of ten in a range or sensitivity, or no signal.
OTHER_LEVEL_DB = 20.0

#: Ratio of imaginary to real parts up to which values count as real.
REAL = 1e-9


def levels(values: Complexes) -> Floats:
    """Levels [dB]; NaN where there is no value."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found = decibel(values)
    return np.where(np.isfinite(found), found, np.nan)


def spread(difference: Floats, axis: int, least: int = LEAST_LINES) -> Floats:
    """Mean absolute deviation from the median along an axis; zero with fewer than ``least`` finite values."""
    enough = np.isfinite(difference).sum(axis=axis, keepdims=True) >= least
    known = np.where(enough, difference, 0.0)
    found: Floats = np.nanmean(np.abs(known - medians(known, axis)), axis=axis)
    return found


def apart(measured: Complexes, model: Complexes) -> Floats:
    """(..., R) mean absolute differences of the levels of (..., F, R) FRFs, the median difference of each response removed [dB]."""
    return spread(levels(measured) - levels(model), -2)


def apart_there(measured: Complexes, computed: Complexes, largest: float) -> Floats:
    """(R,) ``apart`` of (F, R) FRFs computed at other places [dB]; infinite where these are rounding errors, as on a plane of symmetry.

    ``largest`` is the largest magnitude of the FRFs of the model.
    """
    felt = (np.abs(computed) > REAL * largest).sum(axis=0) >= LEAST_LINES
    return np.where(felt, apart(measured, computed), np.inf)


def outlying(misfits: Floats) -> list[int]:
    """Responses whose misfit [dB] is far above the median of all; empty if they are half of all or more."""
    typical = float(np.nanmedian(misfits))
    alone: list[int] = np.flatnonzero(misfits > max(ALONE * typical, typical + LEAST_DIFFERENCE)).tolist()
    return alone if 2 * len(alone) < misfits.size else []


def level_changes(measured: Complexes, other: Complexes) -> dict[int, float]:
    """Difference of the median level from other FRFs (F, R) by response, that of most responses removed [dB]; empty for fewer than two."""
    difference = levels(measured) - levels(other)
    held = np.flatnonzero(np.isfinite(difference).sum(axis=0) >= LEAST_LINES)
    if held.size < 2:
        return {}
    change = np.nanmedian(difference[:, held], axis=0)
    return dict(zip(held.tolist(), (change - np.median(change)).tolist(), strict=True))


def off_level(
    inputs: Inputs, measured: Complexes, tight: Complexes, reference: str, job: str, reach: Floats | float = 0.0
) -> dict[int, str]:
    """Warnings, by response, if its median level differs from the reference job by more than bolts explain, and those of others do not.

    Parameters
    ----------
    inputs : Inputs
    measured, tight : (F, R) complex arrays
        FRFs of a job and of the reference job, on the same lines.
    reference, job : str
        Names of the two jobs.
    reach : (R,) float array or float
        Largest change of the median level by one bolt [dB].
    """
    changes, limit = level_changes(measured, tight), np.maximum(OTHER_LEVEL_DB, np.broadcast_to(reach, measured.shape[1]))
    change = {i: db for i, db in changes.items() if abs(db) > limit[i]}
    told = dict[int, str]()
    for i in change:
        others = [k for k in same_sensor(inputs, i) if k in changes]
        # A faulty sensor is faulty for all hammer points; it is reported once.
        if not all(k in change for k in others) or any(k < i for k in others):
            continue
        names = " and ".join(inputs.responses[k].name for k in (i, *others))
        told[i] = (
            f"{names} {'are' if others else 'is'} {abs(change[i]):.0f} dB {'below' if change[i] < 0 else 'above'} "
            f"{'their' if others else 'its'} level in {reference}, the other responses are not. Check whether the sensor or its cable was "
            f"off, or another range or sensitivity was set. Measure it again, or remove its record from the file of {job}"
        )
    return told


def turned(measured: Complexes, states: Complexes) -> list[int]:
    """Responses whose phases are opposite to the model's, in the state whose phases fit all responses best up to signs.

    Phases find nearer states than levels do, because antiresonances, which move most, count no more than other lines.

    Parameters
    ----------
    measured : (F, R) complex array
    states : (S, F, R) complex array
        FRFs of the model in several states.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = measured / np.abs(measured), states / np.abs(states)
    own = _cosine(x, y, 1)
    best = int(np.argmax(np.abs(own).sum(axis=1)))
    if np.median(np.abs(own[best])) < ALIKE:
        return []
    # A sensor at another's place has the phases of that one; this is no reversed sign.
    others = np.abs(_cosine(x[:, :, None], y[best][:, None, :], 0)).max(axis=1)
    found: list[int] = np.flatnonzero((own[best] <= -ALIKE) & (-own[best] >= others)).tolist()
    return found


def sideways(measured: Complexes, states: Complexes) -> str:
    """Detects phases 90 degrees from the model's in nearly all responses, in the state that then fits best.

    If real and imaginary parts are exchanged, ``H`` becomes ``i conj(H)``.

    Parameters
    ----------
    measured : (F, R) complex array
    states : (S, F, R) complex array

    Returns
    -------
    str
        ``exchanged``: real and imaginary parts are; ``turned``: all phases are 90 degrees off; empty: neither.
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
    """Whether FRFs are complex conjugates: most energy of the impulse responses lies in the second half of the block, before the blow.

    No model is needed. On virtual rigs and samples the share is at most 0.05, for their conjugates at least 0.95.

    Parameters
    ----------
    frequency_hz : (F,) float array
        False is returned if it is not evenly spaced.
    values : (F, R) complex array
    most : float
        Share of the energy in the second half (median over the responses) above which they are conjugates.
    """
    steps = np.diff(frequency_hz)
    whole = np.isfinite(values).all(axis=0) & (np.abs(values) > 0.0).any(axis=0)
    if steps.size < 2 * LEAST_LINES or not whole.any() or not evenly(frequency_hz):
        return False
    energy = np.abs(np.fft.ifft(values[:, whole], axis=0)) ** 2
    share = energy[energy.shape[0] // 2 :].sum(axis=0) / energy.sum(axis=0)
    return bool(np.median(share) > most)


def _cosine(one: Complexes, other: Complexes, axis: int) -> Floats:
    """Mean over the lines of the cosine of the angle between values of magnitude 1, NaN left out; zero if all are NaN."""
    cosine = np.real(one * np.conj(other))
    known = np.isfinite(cosine)
    found: Floats = np.where(known, cosine, 0.0).sum(axis=axis) / np.maximum(known.sum(axis=axis), 1)
    return found


def exchanged(
    inputs: Inputs, measured: Complexes, states: Sequence[Complexes] | Complexes, known: Sequence[tuple[int, ...]] = ()
) -> list[tuple[int, ...]]:
    """Exchanged responses of one excitation, as cycles (i, j, ...): measured i fits computed j, measured j the next, the last computed i.

    Mean levels are removed, so channels of two quantities whose cables were exchanged at the front end are found, too.

    Parameters
    ----------
    inputs : Inputs
    measured : (F, R) complex array
    states : sequence of (F, R) complex arrays
        FRFs of the model in several states; the one that fits best counts.
    known : sequence of tuples of int
        Cycles of the reference job: for the same exchange weaker evidence is enough, and it counts before others of its responses.
    """
    count, limits = len(inputs.responses), inputs.statistics.validation
    other = inputs.input_of[:, None] != inputs.input_of[None]
    level = levels(measured)
    # (S, R, R): distance of measured i from computed j [dB].
    table = np.array([[spread(level[:, [i]] - levels(state), 0, limits.exchanged_lines) for i in range(count)] for state in states])
    table[:, np.isnan(level).all(axis=0)] = 0.0
    table[:, other] = 1e3
    # Imported here because few commands need it.
    from scipy.optimize import linear_sum_assignment

    orders = [linear_sum_assignment(each)[1] for each in table]
    order, nearest = min(zip(orders, table, strict=True), key=lambda pair: float(pair[1][np.arange(count), pair[0]].sum()))
    found = []
    for cycle in _cycles(order.tolist()):
        at, to = list(cycle), [int(order[i]) for i in cycle]
        stated, changed = float(table[:, at, at].sum(axis=1).min()), float(table[:, at, to].sum(axis=1).min())
        # Errors of the model remain wherever a sensor is: take them as large as those of the other responses; little may be left beyond.
        others = np.delete(np.diag(nearest), at)
        lacking = len(at) * float(np.median(others)) if others.size else 0.0
        ways = ((0.0, limits.exchanged_share), (lacking, limits.exchanged_share**2))
        if any(stated - own > len(at) * limits.exchanged_db and changed - own < share * (stated - own) for own, share in ways):
            found.append(cycle)
    if again := [cycle for cycle in known if (at := list(cycle)) and nearest[at, [*at[1:], at[0]]].sum() < nearest[at, at].sum()]:
        taken = {i for own in again for i in own}
        found = again + [cycle for cycle in found if not taken.intersection(cycle)]
    # Exchanged cables are exchanged for all hammer points: if this is clear for one, weaker evidence is enough for the others.
    for clear in tuple(found):
        for also in _elsewhere(inputs, clear):
            at, to = list(also), [*also[1:], also[0]]
            if not {i for own in found for i in own}.intersection(at) and nearest[at, to].sum() < nearest[at, at].sum():
                found.append(also)
    return found


def by_place(inputs: Inputs) -> dict[tuple[int | None, int | None, str, int], int]:
    """Index of each response by node, direction, quantity and excitation; responses without a node are left out."""
    return {(r.node, r.direction, r.quantity, r.input): i for i, r in enumerate(inputs.responses) if r.node is not None}


def _elsewhere(inputs: Inputs, cycle: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """The same cycle of sensors for each other hammer point for which all of them were measured."""
    places = by_place(inputs)
    own = [inputs.responses[i] for i in cycle]
    for at in sorted({r.input for r in inputs.responses} - {own[0].input}):
        others = [places.get((r.node, r.direction, r.quantity, at)) for r in own]
        if all(i is not None for i in others):
            yield tuple(i for i in others if i is not None)


def _cycles(order: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Cycles of a permutation with two or more members."""
    left = {i for i, to in enumerate(order) if i != to}
    while left:
        cycle = [min(left)]
        while order[cycle[-1]] != cycle[0]:
            cycle.append(order[cycle[-1]])
        left -= set(cycle)
        yield tuple(cycle)


def by_sensors(inputs: Inputs, cycles: Sequence[tuple[int, ...]]) -> list[tuple[tuple[int, ...], ...]]:
    """Groups of cycles of responses that are one exchange of sensors, seen from several hammer points."""
    found: list[list[tuple[int, ...]]] = []

    def sensors(cycle: Sequence[int]) -> list[tuple[int | None, int | None]]:
        return [(inputs.responses[i].node, inputs.responses[i].direction) for i in cycle]

    # Sorted, so that the same exchange gives the same result in all jobs.
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
    """Warning about exchanged sensors with its remedy; the record under the first name of a cycle fits the model's second."""
    records, said, places, pairs = list[str](), list[str](), list[str](), len(cycles[0]) == 2
    for cycle in cycles:
        names = [inputs.responses[i].name for i in cycle]
        following = [*names[1:], names[0]]
        # The record of a response is the one that fits its place in the model.
        records += [f"{to}: {name}" for name, to in zip(names, following, strict=True)]
        said.append(f"{', '.join(names[:-1])} and {names[-1]}")
        places.append(" and ".join(f"responses.{name}" for name in names))
    each = "each fits the model's FRF of the other" if pairs else "each fits the model's FRF of the next, the last that of the first"
    told = f"{'; '.join(said)} are probably exchanged: {each}"
    if len({inputs.responses[i].quantity for i in cycles[0]}) > 1:
        return (
            f"{told}. They measure different quantities, so their cables were probably exchanged at the front end, and each has the unit "
            "and the sensitivity of the other. Measure again with each cable at its channel, or exchange names, units and sensitivities of "
            "these channels in the analyser and export again"
        )
    exchange = f"exchange the places of {'; '.join(places)}" if pairs else "give each of these responses the place of the next"
    own = f"write jobs.{job}.records: {{{', '.join(records)}}}"
    # In one job the cables are probably wrong, in the reference job rather the campaign file.
    fix = f"{exchange}, or {own}" if job == inputs.campaign.update.reference else f"{own}, or, if all jobs are affected, {exchange}"
    return f"{told}. {fix[:1].upper()}{fix[1:]}"


@dataclass(frozen=True)
class Reading:
    """Another interpretation of the numbers of a measurement, with which they fit the model.

    Attributes
    ----------
    text : str
        Warning with its remedy.
    before, after : float
        Difference of the levels, constants removed, as stated and with this interpretation (median over the responses) [dB].
    """

    text: str
    before: float
    after: float


def other_reading(quantities: Sequence[str], frequency_hz: Floats, measured: Complexes, states: Complexes, job: str) -> Reading | None:
    """Interpretation of the numbers with which they fit the model; None if they fit as stated, or with no interpretation.

    Parameters
    ----------
    quantities : sequence of str
        Of the R responses.
    frequency_hz : (F,) float array
    measured : (F, R) complex array
    states : (S, F, R) complex array
    job : str
    """
    computed = levels(states)
    omega = decibel(2.0 * np.pi * frequency_hz)[:, None]

    def least(values: Complexes, motions: bool, *, sloped: bool = False) -> tuple[float, int]:
        """Least difference [dB] over states and powers of omega (``motions``: derivatives only; ``sloped``: all), and that power."""
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
        # The A-weighting is steep: it must fit better than any power of the frequency.
        ways += [(flat, _WEIGHTED, False)] if least(flat, False)[0] < least(measured, False, sloped=True)[0] else []
    found = [(*least(values, inverse), text, inverse) for values, text, inverse in ways]
    after, power, text, inverse = min(found)
    if _polar(measured):
        (after, power, text, inverse) = next(each for each in found if "magnitude-phase" in each[2])
    elif after >= min(CLEARLY * before, MOST_LEFT):
        return None
    if inverse:
        word = _INVERSE.get(moved(motion, power) or "", "force over response")
        text = f"probably inverse FRFs ({word}): export {motion} over force, or take the reciprocal of every value"
    change = f"from {before:.1f} to {after:.1f} dB (mean level of each response removed)"
    return Reading(f"{text}. Read this way, the level misfit falls {change}", before, after)


#: Warning if levels fit the model without the A-weighting.
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


def _polar(measured: Complexes, *, least: int = 20) -> bool:
    """Whether real parts are never negative and imaginary parts are angles in degrees: a resonance turns FRFs by half a turn."""
    valid = measured_values(measured)
    first, second = measured.real[valid], measured.imag[valid]
    return bool(first.size >= least and first.min() >= 0.0 and 90.0 < np.abs(second).max() <= 360.0 and np.ptp(second) > 180.0)


def _read_otherwise(measured: Complexes, job: str) -> Iterator[tuple[Complexes, str, bool]]:
    """Other interpretations of the numbers: (F, R) FRFs, remedy, and whether they are reciprocals."""
    valid = measured_values(measured)
    known = np.where(valid, measured, 1.0)

    def only(values: Complexes | Floats) -> Complexes:
        return np.where(valid, values.astype(np.complex128), np.nan)

    yield only(1.0 / known), "", True
    real = bool(np.abs(known.imag).max() <= REAL * np.abs(known).max())
    decibels = known.real if real else np.abs(known)
    # Resonances move the levels of FRFs by decibels.
    uneven = np.median(np.ptp(decibels, axis=0)) > LEAST_DIFFERENCE
    if np.abs(decibels).max() < 1000.0 and uneven:
        fix = f"levels in decibels probably read as magnitudes: set jobs.{job}.format: {{representation: db-phase}}"
        if real:
            fix = "levels in decibels probably read as real parts: export real and imaginary parts, or levels with a column of phases"
        yield only(10.0 ** (decibels / 20.0)), fix, False
    if not real:
        fix = (
            "magnitudes and phases probably read as real and imaginary parts: correct the titles of the columns, or set "
            f"jobs.{job}.format: {{representation: magnitude-phase}}"
        )
        yield only(known.real), fix, False
        if np.abs(known.real).max() < 1000.0 and uneven:
            fix = f"decibels and phases probably read as real and imaginary parts: set jobs.{job}.format: {{representation: db-phase}}"
            yield only(10.0 ** (known.real / 20.0)), fix, False
    fix = "probably squared magnitudes (power spectra): export the FRFs, response over force, with their phases"
    yield only(np.sqrt(np.abs(known))), fix, False
