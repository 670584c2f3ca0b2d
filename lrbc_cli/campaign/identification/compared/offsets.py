"""Texts on constant factors, signs, delays and phases between measured FRFs and those of the model, and their likely causes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Complexes
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import LEAST_DIFFERENCE, MOST_LEFT
from lrbc_cli.campaign.identification.compared.sensors import same_sensor, sensors_among, sensors_of
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import listing
from lrbc_cli.io.units import parse_unit
from lrbc_cli.updating.comparison.scale import (
    LEAST_OFFSET,
    LEAST_REACH,
    MOST_REACH,
    Common,
    Known,
    Offset,
    grouped,
    moved,
    offsets_of,
    unit_near,
)

#: Least share of the band over which a constant factor can be distinguished from errors of the model.
LEAST_BAND = 0.8

#: Ratio of a factor to the half width of its interval that errors of a model do not reach, because they vary over the band.
EVIDENT_HALVES = 6.0


def factors_of(inputs: Inputs, measurement: Measurement, states: Sequence[Complexes]) -> tuple[Offset, ...]:
    """Constant factors between measured FRFs and those of the model in some states, for all measured responses.

    Parameters
    ----------
    inputs : Inputs
    measurement : Measurement
    states : sequence of (F, R) complex arrays
        FRFs of the model on all measured lines.

    Returns
    -------
    tuple of Offset
        Empty if the lines cover less than ``LEAST_BAND``: over one or two resonances, errors of the model look like a factor.
    """
    low, high = inputs.campaign.reduction.band
    if np.ptp(measurement.frequency_hz) < LEAST_BAND * (high - low):
        return ()
    found = offsets_of(measurement.frequency_hz, measurement.values, states, quantities_of(inputs))
    return _of_sensors(inputs, [replace(offset, uncalibrated=measurement.uncalibrated) for offset in found])


def _of_sensors(
    inputs: Inputs, offsets: Sequence[Offset], *, least: float = 3.0, times: float = 4.0, most: float = 2.0
) -> tuple[Offset, ...]:
    """The same, in which a factor counts as named if a sensor has it at several hammer points, and no other sensor has any like it.

    Beside a model that leaves as much as the factor, it does not explain most of the misfit of any response.

    Parameters
    ----------
    inputs : Inputs
    offsets : sequence of Offset
    least, times : float
        Least factor [dB], and ratio to the scatter of those of other sensors.
    most : float
        Largest difference between the factors at the hammer points [dB].
    """
    constant = {o.response: o for o in offsets if not o.power}
    points = {i: inputs.responses[i].input for i in constant}
    middle = {point: float(np.median([o.db for i, o in constant.items() if points[i] == point])) for point in points.values()}
    above = {i: o.db - middle[points[i]] for i, o in constant.items()}
    sensors = {frozenset(own & above.keys()) for own in map(set, sensors_of(inputs))}
    levels = {own: float(np.mean([above[i] for i in own])) for own in sensors if len(own) > 1}
    if len(levels) < 5:
        return tuple(offsets)
    scatter = 1.4826 * float(np.median(np.abs(list(levels.values()))))
    told = [own for own, db in levels.items() if abs(db) >= max(least, times * scatter)]
    clear = [own for own in told if max(above[i] for i in own) - min(above[i] for i in own) <= most]
    alone = {i for own in clear for i in own} if len(told) == 1 else set()
    return tuple(replace(o, named=o.named or o.response in alone) for o in offsets)


def late_together(inputs: Inputs, offsets: Sequence[Offset]) -> tuple[Offset, ...]:
    """The same without delays of single responses: a channel is late at every blow, and a blow at every channel."""
    late = {o.response for o in offsets if o.delay}
    struck = {i: set(np.flatnonzero(inputs.input_of == inputs.input_of[i]).tolist()) for i in late}
    alone = {i for i in late if not late >= {i, *same_sensor(inputs, i)} and not late >= struck[i]}
    return tuple(replace(o, delay=0.0) if o.response in alone else o for o in offsets)


def trusted(offset: Offset, offsets: Sequence[Offset]) -> bool:
    """Whether a factor is too clear to be an error of the model.

    Criteria: a narrow interval and a small remaining misfit, or the same factor in most responses; a power of the frequency must come
    without a further factor, or in most responses.
    """
    alike = sum(other.named and other.power == offset.power for other in offsets)
    # A factor many times its interval, which explains the whole misfit, needs no narrow interval; nor does such a power of the frequency.
    explained = {o.response: o.before - o.after if o.power else abs(o.db) if abs(o.db) - o.before <= o.half else 0.0 for o in offsets}
    reach = {response: db / EVIDENT_HALVES for response, db in explained.items()}
    firm = [o for o in offsets if o.named and o.half <= max(MOST_REACH, reach[o.response]) and o.after <= MOST_LEFT]
    shared = sum(other.power == offset.power and abs(other.db - offset.db) <= MOST_REACH for other in firm)
    # A factor that most other responses show, too, needs less evidence.
    if offset not in firm and 2 * shared <= len(offsets):
        return False
    return offset.power == 0 or abs(offset.db) <= max(offset.half, LEAST_REACH) or 2 * alike > max(len(offsets), 4)


def quantities_of(inputs: Inputs) -> list[str]:
    """Physical quantity of each response."""
    return [response.quantity for response in inputs.responses]


def _names(inputs: Inputs, responses: Sequence[int], of: int) -> str:
    names = listing([inputs.responses[i].name for i in responses], 12)
    return f"all responses ({names})" if len(responses) == of and of > 1 else names


def _factors(inputs: Inputs, job: str, responses: Sequence[int], factor: float) -> str:
    """Value of ``jobs.JOB.scale`` that multiplies the FRFs of these responses by a factor."""
    stated = inputs.campaign.jobs[job].factor
    found = {name: f"{factor * stated(name):.6g}" for name in (inputs.responses[i].name for i in responses)}
    if len(responses) == len(inputs.responses) > 1 == len(set(found.values())):
        return next(iter(found.values()))
    return "{" + ", ".join(f"{name}: {value}" for name, value in found.items()) + "}"


def by_hammer(inputs: Inputs, db: Mapping[int, float], half: Mapping[int, float]) -> set[int]:
    """Responses whose factor differs from that of the same sensor for another hammer point; empty if each hammer has one factor of its own.

    ``db`` and ``half`` are the factors, and half widths of their intervals, by response [dB]; beyond both intervals, factors that differ
    are ``LEAST_OFFSET`` apart.
    """

    def differing(values: Mapping[int, float]) -> set[int]:
        pairs = [(i, k) for i in values for k in same_sensor(inputs, i) if k in values]
        return {i for pair in pairs if abs(values[pair[0]] - values[pair[1]]) > LEAST_OFFSET + half[pair[0]] + half[pair[1]] for i in pair}

    hammers = {i: inputs.responses[i].input for i in db}
    own = {hammer: float(np.median([db[i] for i in db if hammers[i] == hammer])) for hammer in set(hammers.values())}
    return differing(db) if differing({i: db[i] - own[hammers[i]] for i in db}) else set()


def sizes_text(inputs: Inputs, responses: Collection[int], db: Mapping[int, float]) -> str:
    """Factors ``db`` of responses in words, at most six of them."""
    return listing([f"{inputs.responses[i].name} {db[i]:+.1f} dB" for i in sorted(responses)], 6)


def causes_of(inputs: Inputs, common: Common, compared: Sequence[int]) -> bool:
    """Whether a unit, a derivative or a digit too many or too few explains a factor that some of the compared responses share."""
    return _tenfold(common.offset) or any(known.cause for known in _recognised(inputs, common, compared))


def _of_chain(inputs: Inputs, common: Common, compared: Sequence[int], differing: set[int], *, largest: float = 15.0) -> bool:
    """Whether a unit, a sensitivity or a derivative explains a factor of some responses, of which some are ``differing`` (``by_hammer``).

    One sensor has hardly another unit at one hammer point alone: a factor is a known one by chance, up to the ``largest`` [dB] that another
    place or direction makes of it.
    """
    alone = set(common.responses) <= differing and sensors_among(inputs, common.responses) == 1 and abs(common.offset.db) < largest
    return _tenfold(common.offset) if alone else causes_of(inputs, common, compared)


def _tenfold(offset: Offset) -> bool:
    """Whether a factor is a power of the frequency, or a digit too many or too few."""
    return bool(offset.power) or abs(abs(offset.db) - 20.0) <= min(max(offset.half, LEAST_REACH), MOST_REACH)


def _recognised(inputs: Inputs, common: Common, compared: Sequence[int]) -> list[Known]:
    """Known factors near a common one; those that all responses of a kind share only if no compared response of that kind lacks it.

    A factor outside of the interval counts only where it explains the rest, too: otherwise the model may be wrong as a whole.
    """
    offset, reach = common.offset, max(common.offset.half, LEAST_REACH)
    kinds = [(response.quantity, response.input) for response in inputs.responses]
    shared = {kinds[i] for i in common.responses}.isdisjoint(kinds[i] for i in compared if i not in common.responses)
    near = [known for known in offset.known if offset.power or offset.after <= LEAST_DIFFERENCE or abs(known.db - offset.db) <= reach]
    return [known for known in near if (shared or not known.of_all) and not offset.uncalibrated]


def factor_text(inputs: Inputs, common: Common, compared: Sequence[int], job: str) -> tuple[str, str]:
    """Text on one factor that some of the compared responses share, and text on its likely cause with the key that corrects it."""
    offset, count, names = common.offset, len(compared), _names(inputs, common.responses, len(compared))
    recognised = _recognised(inputs, common, compared)
    b, quantity = offset.power, inputs.responses[offset.response].quantity
    frequency = "" if not b else f" times {'' if b > 0 else '1/'}(2 pi f){'²' if abs(b) == 2 else ''}"
    size = f"{offset.db:+.2f} dB" if not b or abs(offset.db) >= offset.half + 0.5 else "a factor"
    text = f"{names}: measured over computed {size}{frequency} at all lines (+-{offset.half:.2f} dB); without this factor the misfit falls "
    text += f"from {offset.before:.1f} to {offset.after:.1f} dB"
    # With a wider interval, parts of the band differ, and one factor is less likely.
    likely = "probable cause:" if offset.half <= MOST_REACH else "possible cause:"
    causes = [known.cause for known in recognised if known.cause]
    unit = None if _stated_unit(inputs, job) else next((known.unit for known in recognised if known.unit), None)
    other = moved(quantity, b)
    if b and other is not None:
        cause = f"{likely} {other}, not {quantity}{' and ' + causes[0] if causes else ''}. "
        keys = ", ".join(f"responses.{inputs.responses[i].name}.quantity: {other}" for i in common.responses)
        keys = f"quantity: {other} under each of these responses" if len(common.responses) > 4 else keys
        single = job != inputs.campaign.update.reference
        cause += f"Export {job} again as {quantity} or, if all jobs contain it, write " if single else "Write "
        whole = f"format.quantity: {other} in each job whose file states {quantity}"
        keys += f", and {whole if len(common.responses) == count else f'beside each labelled: {quantity}, if the files state that'}"
        return text, cause + keys + (f", and jobs.{job}.format.unit: {unit}" if unit else "")
    if b:
        return text, f"{likely} a derivative or an integral with respect to time, perhaps of the input. Convert the FRF file"
    if cause := _uncalibrated_text(offset) or _beside_unit(inputs, common, job, count):
        return text, f"{likely} {cause}"
    own = f"jobs.{job}.scale: {_factors(inputs, job, common.responses, 10.0 ** (-offset.db / 20.0))}"
    # A sensitivity with a digit too many or too few, of some sensors or in one job; a unit may explain the factor as well.
    tenfold = float(np.copysign(20.0, offset.db))
    some = len(common.responses) < count or job != inputs.campaign.update.reference
    if some and abs(offset.db - tenfold) <= min(max(offset.half, LEAST_REACH), MOST_REACH):
        every = len(common.responses) == count
        cause = "a sensitivity or a range ten times off" + (", that of the hammer for example" if every else "")
        options = [(abs(offset.db - tenfold), tenfold, cause)]
        options += [(abs(offset.db - known.db), known.db, known.cause) for known in recognised if known.cause]
        # Sensors rarely share a wrong sensitivity; a unit they do share, though 9.81 is hardly to be distinguished from 10. One sensor has
        # no unit of its own.
        several = every or sensors_among(inputs, common.responses) > 1
        options.sort(key=lambda option: ((option[1] == tenfold) == several, option[0]))
        # If all responses share the factor and a unit is nearer, the unit comes first, with its key (below).
        if not every or options[0][1] == tenfold:
            own = f"jobs.{job}.scale: {_factors(inputs, job, common.responses, 10.0 ** (-options[0][1] / 20.0))}"
            return text, f"{likely} {' or '.join(cause for *_, cause in options)}. Write {own}"
        causes.append(f"{cause} (then scale: {_factors(inputs, job, common.responses, 10.0 ** (-tenfold / 20.0))})")
    if not causes and some and abs(offset.db - tenfold) <= MOST_REACH:
        ten = _factors(inputs, job, common.responses, 10.0 ** (-tenfold / 20.0))
        return text, (
            f"{likely} a sensitivity or a range ten times off (then write jobs.{job}.scale: {ten}), or a sensitivity or a gain that is not "
            f"known here (then {own})"
        )
    if not causes:
        return text, f"{likely} {_unknown_text(offset, own, _air_text(inputs, common), some=some)}"
    known, every = next(known for known in recognised if known.cause), len(common.responses) == count
    return text, _known_text(inputs, common, job, known, causes, likely=likely, unit=unit if every else None, gain=own if some else None)


def _known_text(
    inputs: Inputs, common: Common, job: str, known: Known, causes: Sequence[str], *, likely: str, unit: str | None, gain: str | None
) -> str:
    """Text on known causes with the key that corrects them; ``gain`` is the key for the factor as it is, None in the reference job."""
    own = f"jobs.{job}.scale: {_factors(inputs, job, common.responses, 10.0 ** (-known.db / 20.0))}"
    if gain is not None and known.unit is None and abs(known.db - common.offset.db) > common.offset.half:
        # Conventions have small factors, which a gain meets by chance; errors of the model are in all jobs.
        return f"possible cause: {' or '.join(causes)} (then write {own}), or a sensitivity or a gain that is not known here (then {gain})"
    cause = f"{likely} {' or '.join(causes)}{_air_text(inputs, common)}. Write "
    if known.of_model:
        scales = (f"responses.{inputs.responses[i].name}.scale: {10.0 ** (known.db / 20.0):.6g}" for i in common.responses)
        return cause + ", ".join(scales)
    return cause + (f"jobs.{job}.format.unit: {unit}, or {own}" if unit else own)


def _uncalibrated_text(offset: Offset) -> str:
    """Cause and fix of a factor of FRFs whose file states volts (from data sheets, as the model has errors of its own); else empty."""
    if not offset.uncalibrated:
        return ""
    return (
        "the channels are not calibrated (unit in the file). Enter the sensitivities of sensors and hammer in the analyser, and "
        "export again; or write `scale` in each job: sensitivity of the hammer over that of the sensor, in SI (by this comparison about "
        f"{10.0 ** (-offset.db / 20.0):.2g}; take it from the data sheets)"
    )


def _air_text(inputs: Inputs, common: Common) -> str:
    """Causes in the air of the model, in a clause, of a factor that only pressures share; else empty."""
    if not all(inputs.responses[i].quantity == "pressure" for i in common.responses) or inputs.model.is_acoustic.all():
        return ""
    above, times = common.offset.db > 0.0, f"{10.0 ** (abs(common.offset.db) / 20.0):.3g} times too"
    dense, deep = ("small", "large") if above else ("large", "small")
    return (
        f"; if all microphones show it alike, a density of the air (its unit) that is {times} {dense} in the model, or a closed volume "
        f"(its depth) that is {times} {deep}"
    )


def _unknown_text(offset: Offset, own: str, air: str, *, some: bool) -> str:
    """Causes of a factor that no unit explains, and the fix (``own``: for a sensitivity), of all responses in all jobs unless ``some``."""
    unknown = f"a sensitivity, a gain or a unit that is not known here{air}"
    times = f"{10.0 ** (abs(offset.db) / 20.0):.2g} times too {'large' if offset.db > 0.0 else 'small'}"
    if some:
        return f"{unknown}. Check it, then write {own}"
    return (
        f"{unknown}, or modulus and density of the structure, both about {times} (steel and aluminium differ by 2.9). Compare the mass sum "
        "with the weight of the structure: if it is wrong by this factor, correct the material in the FE model and export it again; "
        f"otherwise check the sensitivities, then write {own}"
    )


def _beside_unit(inputs: Inputs, common: Common, job: str, count: int) -> str:
    """Cause and fix of a factor beside a unit that the campaign states: a scale as well, or another unit; empty if neither explains it.

    The factor must be that of all ``count`` responses.
    """
    offset, response, stated = common.offset, inputs.responses[common.offset.response], _stated_unit(inputs, job)
    if stated is None or len(common.responses) < count:
        return ""
    (label, decibels), scale, key = stated, inputs.campaign.jobs[job].factor(response.name), f"jobs.{job}.scale"
    reach, unit = min(max(offset.half, LEAST_REACH), MOST_REACH), f"jobs.{job}.format.unit: {label}"
    if abs(20.0 * np.log10(abs(scale)) - offset.db) <= reach:
        if abs(decibels - offset.db) <= reach:
            return f"converted twice, by {unit} and by {key}: {scale:g}. Delete {key}, or else {unit}"
        return f"{key}: {scale:g}, which FRFs with {unit} do not need. Delete {key}"
    # The key replaces the unit in force, so the factor beside that unit is not the one to write.
    right = unit_near(offset.db - decibels, offset.half, response.quantity)
    return "" if right in (None, label) else f"FRFs in {right}, not in {label}. Write jobs.{job}.format.unit: {right}"


def _stated_unit(inputs: Inputs, job: str) -> tuple[str, float] | None:
    """Unit that the campaign states for the FRFs of a job, and its factor to SI [dB]; None if it states none."""
    own = inputs.campaign.jobs[job]
    layout = own.format_of(own.first)
    unit = parse_unit(layout.unit) if layout is not None and layout.unit is not None else None
    return None if unit is None or layout is None else (str(layout.unit), 20.0 * float(np.log10(unit.factor)))


def _struck(inputs: Inputs, turned: Sequence[int], compared: Sequence[int]) -> str:
    """The hammer points to which all of the responses, two at least of each, belong; empty if these are not all of theirs."""
    of = {point: [i for i in compared if inputs.responses[i].input == point] for point in {inputs.responses[i].input for i in turned}}
    whole = all(len(own) > 1 and set(own) <= set(turned) for own in of.values())
    return f"the blow at {', '.join(inputs.excitations[point] for point in sorted(of))}" if whole else ""


def _with_sensor(inputs: Inputs, common: Common, known: Mapping[int, float], every: Sequence[Common]) -> Common:
    """The common factor with other FRFs of its sensors that have it, too, though there it may explain less than half of the misfit."""
    taken, db = {i for each in every for i in each.responses}, common.offset.db
    twins = {k for i in common.responses for k in same_sensor(inputs, i) if k in known and k not in taken}
    alike = [] if common.offset.power else [k for k in twins if abs(known[k] - db) < 0.5 * abs(db)]
    return replace(common, responses=tuple(sorted((*common.responses, *alike))))


def _fault(inputs: Inputs, common: Common, compared: Sequence[int]) -> str:
    known = any(known.unit for known in _recognised(inputs, common, compared))
    unit = known or len(common.responses) == len(compared) or common.offset.power
    return "probably not in the model's units: " if unit else "probably a wrong sensitivity: "


def offset_findings(inputs: Inputs, offsets: Sequence[Offset], job: str) -> list[Finding]:
    """Findings of factors, signs, delays and conjugates; may be empty."""
    firm = {offset.response for offset in offsets if offset.named and trusted(offset, offsets)}
    compared, known = [o.response for o in offsets], {o.response: o.db for o in offsets if not o.power}
    differing = by_hammer(inputs, known, {o.response: o.half for o in offsets if not o.power})
    # A factor without which most of the misfit remains is neither unit nor gain.
    shared = [common for common in grouped(offsets, quantities_of(inputs)) if firm.intersection(common.responses)]
    shared = [_with_sensor(inputs, common, known, shared) for common in shared]
    uneven = [common for common in shared if differing.intersection(common.responses)]
    placed = [common for common in uneven if not _of_chain(inputs, common, compared, differing)]
    struck = [] if placed else _of_one_hammer(inputs, shared, offsets, job)
    found = struck or [
        Finding(
            text=_fault(inputs, common, compared) + "; ".join(factor_text(inputs, common, compared, job)),
            kind=Kind.UNITS,
            responses=common.responses,
            detail="quantity" if common.offset.power else "",
        )
        for common in shared
        if common not in placed
    ]
    if placed:
        own = tuple(sorted(i for common in placed for i in common.responses))
        text = (
            f"FRFs are higher or lower than the model's at all lines ({sizes_text(inputs, differing, known)}), but not by one factor of "
            f"each sensor: no sensitivity depends on the hammer point. Check places and directions of {_names(inputs, own, len(offsets))}, "
            "and of the hammer points (lrbc check --picture)"
        )
        found.append(Finding(text=text, kind=Kind.PLACES, responses=own))
    tail = sign_tail(inputs)
    if turned := tuple(o.response for o in offsets if o.reversed):
        what = "the hammer or of all sensors" if len(turned) == len(offsets) else _struck(inputs, turned, compared) or "the sensor"
        text = (
            f"probably reversed sign: {_names(inputs, turned, len(offsets))}: measured phases are 180 degrees from the model's. Possible "
            f"cause: the direction of {what}. Write jobs.{job}.scale: {_factors(inputs, job, turned, -1.0)}{tail}"
        )
        found.append(Finding(text=text, kind=Kind.REVERSED, responses=turned))
    if late := [o for o in offsets if o.delay]:
        delay = float(np.median([o.delay for o in late]))
        word, side = ("late", "behind") if delay > 0 else ("early", "ahead of")
        delayed = tuple(o.response for o in late)
        text = (
            f"probably {word}: {_names(inputs, delayed, len(offsets))}: sensors {1e3 * abs(delay):.3g} ms {side} the hammer (measured "
            f"phases leave the model's by 360 degrees every {abs(1.0 / delay):.4g} Hz). Possible causes: another front end, filter or "
            "trigger. Let the analyser correct the delay of its channels, and export again; the calibration is sensitive to the delay"
        )
        found.append(Finding(text=text, kind=Kind.LATE if delay > 0 else Kind.EARLY, responses=delayed))
    if mirrored := tuple(o.response for o in offsets if o.conjugate):
        text = (
            f"phases probably of opposite sign: {_names(inputs, mirrored, len(offsets))}: measured is the complex conjugate of computed. "
            f"Possible cause: the convention exp(-i omega t). Conjugate the FRF file: imaginary parts, or phases, times -1{tail}"
        )
        found.append(Finding(text=text, kind=Kind.CONJUGATE, responses=mirrored))
    return found


def _of_one_hammer(inputs: Inputs, shared: Sequence[Common], offsets: Sequence[Offset], job: str, *, least: int = 3) -> list[Finding]:
    """Finding of factors that most sensors, ``least`` at least, have for one hammer point and none for others: that of the force."""
    points = {inputs.responses[i].input for common in shared for i in common.responses}
    constant = [o for o in offsets if not o.power]
    own = [o for o in constant if inputs.responses[o.response].input in points]
    others = [o.db for o in constant if inputs.responses[o.response].input not in points]
    firm = [o for o in own if any(o.response in common.responses for common in shared)]
    compared = [o.response for o in offsets]
    recognised = [known for common in shared for known in _recognised(inputs, common, compared) if known.cause]
    if len(points) != 1 or not others or any(known.unit for known in recognised) or any(common.offset.power for common in shared):
        return []
    db, usual, at = float(np.median([o.db for o in firm])), float(np.median(others)), points.pop()
    # Of many intervals some miss, as in ``grouped``.
    away = sum(abs(o.db - db) > max(MOST_REACH, o.half) for o in own)
    sensors = sensors_among(inputs, [o.response for o in firm])
    if sensors < least or 2 * len(firm) <= len(own) or 4 * away > len(own) or max(abs(usual), LEAST_OFFSET) > abs(db - usual):
        return []
    responses, name, factor = tuple(sorted(o.response for o in own)), inputs.excitations[at], 10.0 ** (db / 20.0)
    whole = f"excitation.{name}.scale: {factor * inputs.campaign.excitation[name].scale:.6g}"
    text = (
        f"probably not in the model's units: all FRFs of {name}: measured over computed {db:+.2f} dB at all lines (median; "
        f"{_names(inputs, [o.response for o in firm], len(offsets))}), those of other hammer points {usual:+.2f} dB. No sensor depends on "
        "the hammer point, so the force was wrong; probable cause: the sensitivity or the range of the force sensor during these "
        f"blows{''.join(f', or {cause}' for cause in dict.fromkeys(known.cause for known in recognised))}. "
        f"Check it, then write jobs.{job}.scale: {_factors(inputs, job, responses, 1.0 / factor)}, or {whole} if all jobs show it"
    )
    return [Finding(text=text, kind=Kind.UNITS, responses=responses)]


def sign_tail(inputs: Inputs) -> str:
    """End of warnings that concern phases only: they have no effect on a fit that uses magnitudes."""
    return "" if inputs.method.residual.phase else "; no effect on the fit, which uses magnitudes in dB"


def sideways_finding(inputs: Inputs, how: str, job: str) -> Finding:
    """Finding of phases 90 degrees from the model's; ``how`` as returned by ``likeness.sideways``, not empty."""
    tail = sign_tail(inputs)
    if how == "exchanged":
        return Finding(
            text="real and imaginary parts are probably exchanged: phases of all responses are 90 degrees minus the model's. Exchange the "
            f"two columns of each FRF in the file, or list them in their order under jobs.{job}.format.columns{tail}",
            kind=Kind.PARTS,
        )
    return Finding(
        text="all phases are probably 90 degrees from the model's, levels are not affected. Possible causes: phases that refer to a sine, "
        f"an integration of phases alone. Export the FRFs as real and imaginary parts of response over force{tail}",
        kind=Kind.SIDEWAYS,
    )
