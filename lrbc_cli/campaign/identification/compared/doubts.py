"""Warnings that put a result in doubt: units, signs, exchanged sensors, gains, or a fit that stays above the noise or above its start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import MOST_LEFT, by_sensors, exchanged, exchanged_text, off_level, outlying
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.identification.gains import Gains
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.errors import DataError
from lrbc_cli.updating.comparison.scale import LEAST_REACH, MOST_REACH, Common, Offset, grouped, misses_unit, moved, offsets_of
from lrbc_cli.updating.judging.evidence import Doubt
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.judging.rule import DecisionRule
from lrbc_cli.updating.statistics.decibels import coherence_sigma
from lrbc_cli.updating.statistics.lines import too_wide

#: Misfit over noise that is no chance with hundreds of lines: with the right model and optimum, the misfit is the noise.
FAR_ABOVE_NOISE = 3.0

#: Largest misfit of a calibrated model, as `lrbc plan` assumes it [dB]; the limit if the noise is unknown or smaller.
LARGE_MISFIT = 1.0

#: Least share of the band over which a constant factor can be distinguished from errors of the model.
LEAST_BAND = 0.8

#: Ratio of a factor to the half width of its interval that errors of a model do not reach, because they vary over the band.
EVIDENT_HALVES = 6.0

#: Least difference of misfits, which are shown to two decimals [dB].
SHOWN = 0.01


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
    return offsets_of(measurement.frequency_hz, measurement.values, states, _quantities(inputs))


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


def _quantities(inputs: Inputs) -> list[str]:
    return [response.quantity for response in inputs.responses]


def _names(inputs: Inputs, responses: Sequence[int], of: int) -> str:
    names = ", ".join(inputs.responses[i].name for i in responses)
    return f"all responses ({names})" if len(responses) == of and of > 1 else names


def _factors(inputs: Inputs, job: str, responses: Sequence[int], factor: float) -> str:
    """Value of ``jobs.JOB.scale`` that multiplies the FRFs of these responses by a factor."""
    stated = inputs.campaign.jobs[job].factor
    found = {name: f"{factor * stated(name):.6g}" for name in (inputs.responses[i].name for i in responses)}
    if len(responses) == len(inputs.responses) > 1 == len(set(found.values())):
        return next(iter(found.values()))
    return "{" + ", ".join(f"{name}: {value}" for name, value in found.items()) + "}"


def _factor_text(inputs: Inputs, common: Common, compared: Sequence[int], job: str) -> tuple[str, str]:
    """Text on one factor that some of the compared responses share, and text on its likely cause with the key that corrects it."""
    offset, count, names = common.offset, len(compared), _names(inputs, common.responses, len(compared))
    kinds = [(response.quantity, response.input) for response in inputs.responses]
    shared = {kinds[i] for i in common.responses}.isdisjoint(kinds[i] for i in compared if i not in common.responses)
    recognised = [known for known in offset.known if shared or not known.of_all]
    b, quantity = offset.power, inputs.responses[offset.response].quantity
    frequency = "" if not b else f" times {'' if b > 0 else '1/'}(2 pi f){'²' if abs(b) == 2 else ''}"
    size = f"{offset.db:+.2f} dB" if not b or abs(offset.db) >= offset.half + 0.5 else "a factor"
    text = f"{names}: measured over computed {size}{frequency} at all lines (+-{offset.half:.2f} dB); without this factor the misfit falls "
    text += f"from {offset.before:.1f} to {offset.after:.1f} dB"
    # With a wider interval, parts of the band differ, and one factor is less likely.
    likely = "probable cause:" if offset.half <= MOST_REACH else "possible cause:"
    causes = [known.cause for known in recognised if known.cause]
    unit = next((known.unit for known in recognised if known.unit), None)
    other = moved(quantity, b)
    if b and other is not None:
        cause = f"{likely} {other}, not {quantity}{' and ' + causes[0] if causes else ''}. Write "
        keys = ", ".join(f"responses.{inputs.responses[i].name}.quantity: {other}" for i in common.responses)
        if job != inputs.campaign.update.reference:
            keys += f" (if all jobs contain it; otherwise export {job} again as {quantity})"
        whole = f"format.quantity: {other} in each job whose file states {quantity}"
        keys += f", and {whole if len(common.responses) == count else f'beside each labelled: {quantity}, if the files state that'}"
        return text, cause + keys + (f", and jobs.{job}.format.unit: {unit}" if unit else "")
    if b:
        return text, f"{likely} a derivative or an integral with respect to time, perhaps of the input. Convert the FRF file"
    own = f"jobs.{job}.scale: {_factors(inputs, job, common.responses, 10.0 ** (-offset.db / 20.0))}"
    # A sensitivity with a digit too many or too few, of some sensors or in one job; a unit may explain the factor as well.
    tenfold = float(np.copysign(20.0, offset.db))
    some = len(common.responses) < count or job != inputs.campaign.update.reference
    if some and abs(offset.db - tenfold) <= min(max(offset.half, LEAST_REACH), MOST_REACH):
        every = len(common.responses) == count
        cause = "a sensitivity or a range ten times off" + (", that of the hammer for example" if every else "")
        options = [(abs(offset.db - tenfold), tenfold, cause)]
        options += [(abs(offset.db - known.db), known.db, known.cause) for known in recognised if known.cause]
        options.sort(key=lambda option: option[0])
        # If all responses share the factor and a unit is nearer, the unit comes first, with its key (below).
        if not every or options[0][1] == tenfold:
            own = f"jobs.{job}.scale: {_factors(inputs, job, common.responses, 10.0 ** (-options[0][1] / 20.0))}"
            return text, f"{likely} {' or '.join(cause for *_, cause in options)}. Write {own}"
        causes.append(f"{cause} (then scale: {_factors(inputs, job, common.responses, 10.0 ** (-tenfold / 20.0))})")
    if not causes:
        return text, f"{likely} a sensitivity, a gain or a unit that is not known here. Check it, then write {own}"
    known = next(known for known in recognised if known.cause)
    own = f"jobs.{job}.scale: {_factors(inputs, job, common.responses, 10.0 ** (-known.db / 20.0))}"
    cause = f"{likely} {' or '.join(causes)}. Write "
    if known.of_model:
        scales = (f"responses.{inputs.responses[i].name}.scale: {10.0 ** (known.db / 20.0):.6g}" for i in common.responses)
        return text, cause + ", ".join(scales)
    return text, cause + (f"jobs.{job}.format.unit: {unit}, or {own}" if unit and len(common.responses) == count else own)


def offset_texts(inputs: Inputs, offsets: Sequence[Offset], job: str) -> dict[tuple[object, ...], str]:
    """Warnings about factors, signs, delays and conjugates, by kind and responses (to merge equal ones of several jobs); may be empty."""
    firm = {offset.response for offset in offsets if offset.named and trusted(offset, offsets)}
    found: dict[tuple[object, ...], str] = {
        ("units", *common.responses): "probably not in the model's units: "
        + "; ".join(_factor_text(inputs, common, [o.response for o in offsets], job))
        for common in grouped(offsets, _quantities(inputs))
        # A factor without which most of the misfit remains is neither unit nor gain.
        if firm.intersection(common.responses)
    }
    tail = sign_tail(inputs)
    turned = [o.response for o in offsets if o.reversed]
    if turned:
        what = "the hammer or of all sensors" if len(turned) == len(offsets) else "the sensor"
        found["reversed", *turned] = (
            f"probably reversed sign: {_names(inputs, turned, len(offsets))}: measured phases are 180 degrees from the model's. Possible "
            f"cause: the direction of {what}. Write jobs.{job}.scale: {_factors(inputs, job, turned, -1.0)}{tail}"
        )
    late = [o for o in offsets if o.delay]
    if late:
        delay = float(np.median([o.delay for o in late]))
        word, side = ("late", "behind") if delay > 0 else ("early", "ahead of")
        delayed = [o.response for o in late]
        names = _names(inputs, delayed, len(offsets))
        found[word, *delayed] = (
            f"probably {word}: {names}: sensors {1e3 * abs(delay):.3g} ms {side} the hammer (measured phases leave the model's by 360 "
            f"degrees every {abs(1.0 / delay):.3g} Hz). Possible causes: another front end, filter or trigger. Let the analyser correct "
            "the delay of its channels, and export again; the calibration is sensitive to the delay"
        )
    mirrored = [o.response for o in offsets if o.conjugate]
    if mirrored:
        found["conjugate", *mirrored] = (
            f"phases probably of opposite sign: {_names(inputs, mirrored, len(offsets))}: measured is the complex conjugate of computed. "
            f"Possible cause: the convention exp(-i omega t). Conjugate the FRF file: imaginary parts, or phases, times -1{tail}"
        )
    return found


def sign_tail(inputs: Inputs) -> str:
    """End of warnings that concern phases only: they have no effect on a fit that uses magnitudes."""
    return "" if inputs.method.residual.phase else "; no effect on the fit, which uses magnitudes in dB"


def sideways_text(inputs: Inputs, how: str, job: str) -> str:
    """Warning about phases 90 degrees from the model's; ``how`` as returned by ``likeness.sideways``, not empty."""
    tail = sign_tail(inputs)
    if how == "exchanged":
        return (
            "real and imaginary parts are probably exchanged: phases of all responses are 90 degrees minus the model's. Exchange the two "
            f"columns of each FRF in the file, or list them in their order under jobs.{job}.format.columns{tail}"
        )
    return (
        "all phases are probably 90 degrees from the model's, levels are not affected. Possible causes: phases that refer to a sine, an "
        f"integration of phases alone. Export the FRFs as real and imaginary parts of response over force{tail}"
    )


def largest_text(inputs: Inputs, offsets: Sequence[Offset]) -> str:
    """Whether a constant factor explains the misfit, in a clause."""
    if not offsets:
        return "too few lines, or too little of the band, to look for a constant factor"
    groups = grouped(offsets, _quantities(inputs))
    if groups:
        worst = max(groups, key=lambda common: common.offset.before - common.offset.after).offset
        what = f"{worst.db:+.2f} dB" + (f" and (2 pi f)^{worst.power}" if worst.power else "")
        left = f"{worst.before:.1f} dB, {worst.after:.1f} dB without it"
        return f"a constant factor explains most of the misfit of {inputs.responses[worst.response].name}: {what} ({left})"
    constant = [offset for offset in offsets if not offset.power]
    if not constant:
        return "the misfit is not a constant factor"
    worst = max(constant, key=lambda offset: abs(offset.db))
    return (
        f"the misfit is not a constant factor: without the largest, {worst.db:+.2f} dB in {inputs.responses[worst.response].name}, "
        f"{worst.after:.1f} of {worst.before:.1f} dB remain"
    )


def compared_text(inputs: Inputs, result: Identification) -> str:
    """What was compared in the cost, in a clause: magnitudes or phases, correction, responses, lines."""
    residual = "magnitudes in dB" + (" and phases" if inputs.method.residual.phase else "")
    against = f"corrected by the model discrepancy of {inputs.campaign.update.reference}" if result.relative else "as measured"
    names = ", ".join(inputs.responses[i].name for i in inputs.used)
    lines = result.measurement.frequency_hz[result.selected]
    band = f"{lines.size} lines from {lines[0]:g} to {lines[-1]:g} Hz"
    return f"compared were {residual} {against} of {names} at {band}"


def own_fault_text(inputs: Inputs, misfits: Floats, reference: str, known: str = "") -> str:
    """What to check in the measurement if the model explains the reference job but not this one, in a clause.

    ``misfits`` (R,) are mean misfits of the responses [dB], ``known`` a fault that was found already, if any.
    """
    if known:
        return f"{reference} is explained, so the fault is probably in this measurement: {known}"
    alone = outlying(misfits)
    names = ", ".join(inputs.responses[i].name for i in alone)
    typical = float(np.nanmedian(misfits))
    if not alone:
        what = "No response stands out: check whether the hammer was at another point or in another direction, or a window was applied."
    else:
        lie, far = "is" if len(alone) == 1 else "are", misfits[alone].min()
        what = f"Only {names} {lie} far off (misfit {far:.1f} dB and more, {typical:.1f} dB in the median of all): check whether a sensor "
        what += "was overloaded, moved, turned or exchanged."
    return (
        f"{reference} is explained, so the fault is probably in this measurement. {what} Measure it again. If the result is the same, the "
        "structure changed by more than the model can follow: joints that hardly hold, a part that is missing"
    )


def coarse_text(reference: ReferenceState, rule: DecisionRule) -> str:
    """Text that the model may be wrong, if the misfit of the reference job itself is large; else empty."""
    before = max(reference.misfit_db, reference.validation_db or 0.0)
    # The rule for the all-clear: a change is the difference of two states, each as wrong as this one.
    if np.hypot(before, before) <= rule.validated_misfit:
        return ""
    return f"{reference.job} itself has a misfit of {before:.2f} dB: improve model or calibration before you doubt the measurement"


def _levels_off(inputs: Inputs, result: Identification, reference: str) -> str:
    """Text on responses whose level differs from the reference job (``likeness.off_level``); empty if none, or if the lines differ.

    A response whose level the identified bolts change as much is left out.
    """
    own, tight, expected = result.measurement, result.tight, result.expected
    if tight is None or own.values.shape != tight.values.shape:
        return ""
    away = off_level(inputs, own.values, tight.values, reference, result.name)
    beside = away if expected is None else off_level(inputs, own.values, expected, reference, result.name)
    return "; ".join(text for i, text in away.items() if i in beside)


def noise_level(measurement: Measurement, job: JobConfig, responses: Integers) -> float | None:
    """Mean absolute error of the measured levels, from repeats or else from coherence [dB]; None if neither gives it."""
    sigma, averages = measurement.sigma_db, job.averages * measurement.files
    if sigma is None or not np.isfinite(sigma).any():
        # The coherence of a single average is 1, whatever the noise.
        if averages < 2:
            return None
        sigma = coherence_sigma(np.where(measurement.coherence > 0.0, measurement.coherence, np.nan), averages)
    chosen = sigma[:, responses]
    chosen = chosen[np.isfinite(chosen)]
    # Mean absolute value of a Gaussian error.
    return float(np.sqrt(2.0 / np.pi) * chosen.mean()) if chosen.size else None


def _wanted(noise_db: float | None) -> float:
    """Misfit [dB] below which a fit counts as reaching the data."""
    return max(LARGE_MISFIT, FAR_ABOVE_NOISE * (noise_db or 0.0))


def unreached(misfit_db: float, noise_db: float | None, reference: ReferenceState | None = None) -> str | None:
    """Warning if the misfit of a fit is far above the noise [dB]; else None.

    Intervals assume that the residuals are noise about the right optimum. Far above the noise, the fit may be in another valley, or the
    model may lack something: then the curvature does not say how far the truth is.
    """
    limit = _wanted(noise_db)
    if misfit_db <= limit:
        return None
    noise = "noise of the measurement not known" if noise_db is None else f"noise of the measurement {noise_db:.2f} dB"
    other = "" if reference is None else f", reference job {reference.misfit_db:.2f} dB"
    return (
        f"the fit does not reach the data: misfit of {misfit_db:.2f} dB over all lines of the responses used, expected below "
        f"{limit:.2g} dB ({noise}{other}). Intervals rest on the curvature at this fit and understate the uncertainty"
    )


def worsened(initial_db: float | None, final_db: float | None, noise_db: float | None) -> str | None:
    """Warning if the misfit over all lines of the responses used rose and the fit does not reach the data; else None. All in [dB].

    The cost weights lines, so the plain mean over all lines may rise slightly, within noise and model error, without anything wrong.
    """
    if initial_db is None or final_db is None or not final_db > max(initial_db + SHOWN, _wanted(noise_db)):
        return None
    return f"the mean misfit of the responses used rose from {initial_db:.2f} dB at the start values to {final_db:.2f} dB over all lines"


def doubts(inputs: Inputs, result: Identification, misfit: tuple[float | None, float | None]) -> tuple[list[str], str, list[Doubt]]:
    """Warnings of a job, text on what was compared and on constant factors, and doubts that prevent its validation.

    Parameters
    ----------
    inputs : Inputs
    result : Identification
    misfit : pair of float or None
        Mean misfit of the responses used at the start values and at the end [dB].
    """
    # Factors are looked for without the identified gains.
    gains = result.gains
    states = result.initial, result.updated / (1.0 if gains is None else gains.factors(inputs))
    reference, exchanges = result.reference, exchanged(inputs, result.measurement.values, states)
    involved = {i for cycle in exchanges for i in cycle}
    offsets = factors_of(inputs, result.measurement, states)
    offsets = tuple(offset for offset in offsets if offset.response not in involved)
    swapped = "; ".join(exchanged_text(inputs, cycles, result.name) for cycles in by_sensors(inputs, exchanges))
    units = offset_texts(inputs, offsets, result.name)
    compared = f"{compared_text(inputs, result)}; {largest_text(inputs, offsets)}"
    if reference is not None and reference.explained:
        wide = too_wide((result.measurement.frequency_hz, result.measurement.values[:, inputs.used]), rule=inputs.statistics.resolution)
        fault = "exchanged sensors" if swapped else "a factor or a phase, see the warnings" if units else wide and wide.text
        fault = fault or _levels_off(inputs, result, reference.job)
        coarse = "" if fault else coarse_text(reference, inputs.method.rule)
        compared += f"; {coarse or own_fault_text(inputs, result.misfit_final, reference.job, fault)}"
    job = inputs.campaign.jobs[result.name]
    found = [*([swapped] if swapped else []), *units.values()]
    if gains is not None and not any(kind == "units" for kind, *_ in units):
        found.append((gain_text if gains.shared else level_text)(inputs, result.name, gains))
    noise = noise_level(result.measurement, job, inputs.used)
    # In a relative comparison the model discrepancy cancels, so the misfit need not reach the noise.
    further = [None if result.relative or misfit[1] is None else unreached(misfit[1], noise, reference), worsened(*misfit, noise)]
    untrusted = [Doubt(kind="exchanged", text=swapped)] if swapped else []
    if gains is not None and gains.shared:
        untrusted.append(Doubt(kind="gain", text=f"all FRFs are {gain_size(*gains.mean)} than expected from the reference job"))
    return found + [text for text in further if text is not None], compared, untrusted


def gain_size(gain: float, std: float) -> str:
    """A gain and its 95 % interval in words, from gain and standard deviation [dB]."""
    return f"{abs(10.0 ** (gain / 20.0) - 1.0):.0%} {'higher' if gain > 0 else 'lower'} ({gain:+.1f} +-{2.0 * std:.1f} dB)"


def _scales(inputs: Inputs, job: str, gains: Gains) -> str:
    """Values of ``scale`` of a job that remove its gains."""
    own, factors = inputs.campaign.jobs[job], gains.factors(inputs)
    both = zip(inputs.responses, factors.tolist(), strict=True)
    return ", ".join(f"{response.name}: {own.factor(response.name) / factor:.4g}" for response, factor in both)


def gain_text(inputs: Inputs, job: str, gains: Gains) -> str:
    """Warning about a gain that all responses of a job share relative to the reference job."""
    reference, own = inputs.campaign.update.reference, inputs.campaign.jobs[job]
    return (
        f"{own.first.name}: all FRFs are {gain_size(*gains.mean)} than expected from those of {reference}, at all lines of all responses; "
        "no bolt does that. Expected: one hammer with one sensitivity in both jobs. Verdicts, if any, allow for it, but there is no "
        f"all-clear. Fix: compare the sensitivities entered for {job} and for {reference} (if all jobs say this, those of {reference} "
        f"are wrong), and export again, or write jobs.{job}.scale: {{{_scales(inputs, job, gains)}}}"
    )


def level_text(inputs: Inputs, job: str, gains: Gains) -> str:
    """Warning about gains of the reference job, or of the job of the calibration, relative to the model."""
    errors = inputs.statistics.errors
    seen = gains.seen(errors)
    each = zip(inputs.used.tolist(), gains.values.tolist(), gains.stds.tolist(), seen.tolist(), strict=True)
    named = ", ".join(f"{inputs.responses[at].name} {gain_size(value, std)}" for at, value, std, one in each if one)
    if gains.alike(errors):
        size, likely = f"all FRFs are {gain_size(*gains.mean)}", "the hammer or of the sensors, or the mass of the model"
    else:
        size, likely = f"FRFs are higher or lower ({named})", "the sensors"
    return (
        f"{inputs.campaign.jobs[job].first.name}: {size} than expected from the model, at all lines. Probable cause: the sensitivity of "
        f"{likely}. It is allowed for: changes and verdicts do not rest on it, absolute stiffnesses do. Fix: compare the sensitivities "
        "entered for hammer and sensors, and the weight of the structure with that of the model; then correct the model, or write scale: "
        f"{{{_scales(inputs, job, gains)}}} in every job"
    )


def refuse_units(inputs: Inputs, measurement: Measurement, model: Complexes, job: str) -> None:
    """Refuse a measurement in other units than the model, before a calibration compensates for them by factors of the model.

    Raises
    ------
    DataError
        If every response differs from the model by a unit or by a derivative.
    """
    offsets = factors_of(inputs, measurement, (model,))
    if not misses_unit(offsets):
        return
    texts = [_factor_text(inputs, common, [o.response for o in offsets], job) for common in grouped(offsets, _quantities(inputs))]
    raise DataError(
        "measurement and model are probably in different units",
        file=inputs.campaign.jobs[job].first,
        place=f"job {job}",
        expected="FRFs that differ from the model's by its errors, not by one factor at all lines",
        found="; ".join(found for found, _ in texts),
        hint="; ".join(remedy for _, remedy in texts),
    )


def calibration_doubts(
    inputs: Inputs,
    measurement: Measurement,
    states: Sequence[Complexes],
    job: str,
    misfit: tuple[float, float],
    gains: Gains | None,
) -> list[str]:
    """Warnings of a calibration; ``misfit`` of the responses used before and after, over all lines [dB].

    The states (F, R) are FRFs of the model without the identified gains.
    """
    units = offset_texts(inputs, factors_of(inputs, measurement, states), job)
    found = list(units.values())
    if gains is not None and not any(kind == "units" for kind, *_ in units):
        found.append(level_text(inputs, job, gains))
    noise = noise_level(measurement, inputs.campaign.jobs[job], inputs.used)
    further = [unreached(misfit[1], noise), worsened(*misfit, noise)]
    return found + [text for text in further if text is not None]
