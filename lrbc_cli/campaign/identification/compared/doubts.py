"""Warnings that put a result in doubt: units, signs, exchanged sensors, gains, or a fit that stays above the noise or above its start."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.findings import Finding, Kind, kinds_of
from lrbc_cli.campaign.identification.compared.astray import astray
from lrbc_cli.campaign.identification.compared.likeness import by_sensors, exchanged, exchanged_text, off_level, outlying
from lrbc_cli.campaign.identification.compared.offsets import (
    by_hammer,
    factor_text,
    factors_of,
    offset_findings,
    quantities_of,
    sizes_text,
)
from lrbc_cli.campaign.identification.compared.sensors import ends_of
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.identification.gains import Gains, Sharers
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.errors import DataError, listing
from lrbc_cli.updating.comparison.scale import Offset, grouped, misses_unit
from lrbc_cli.updating.judging.evidence import Doubt
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.judging.rule import DecisionRule
from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.statistics.decibels import coherence_sigma
from lrbc_cli.updating.statistics.lines import phaseless, too_wide

#: Misfit over noise that is no chance with hundreds of lines: with the right model and optimum, the misfit is the noise.
FAR_ABOVE_NOISE = 3.0

#: Largest misfit of a calibrated model, as `lrbc plan` assumes it [dB]; the limit if the noise is unknown or smaller.
LARGE_MISFIT = 1.0

#: Least difference of misfits, which are shown to two decimals [dB].
SHOWN = 0.01


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
    if end := _one_end(inputs, misfits):
        what = end
    elif not alone:
        what = "No response stands out: check whether the hammer was at another point or in another direction, or a window was applied."
    else:
        lie, far = "is" if len(alone) == 1 else "are", misfits[alone].min()
        what = f"Only {names} {lie} far off (misfit {far:.1f} dB and more, {typical:.1f} dB in the median of all): check whether a sensor "
        what += "was overloaded, moved, turned or exchanged."
    return (
        f"{reference} is explained, so the fault is probably in this measurement. {what} Measure it again. If the result is the same, the "
        "structure changed by more than the model can follow: joints that rattle or hardly hold, a part that is missing or was added"
    )


def _one_end(inputs: Inputs, misfits: Floats, *, least: int = 3, times: float = 2.0) -> str:
    """Text on a sensor, or a hammer point, all of whose FRFs are far off, from mean misfits [dB]; empty if there is none.

    It and the others need ``least`` FRFs; half of its own are ``times`` as far off as the others are in the median, the rest farther than
    these.
    """
    advice = {
        "sensor": "check whether it was overloaded, moved, turned or exchanged",
        "hammer point": "check whether the hammer hit elsewhere or twice",
    }
    known = np.isfinite(misfits)
    for kind, responses in ends_of(inputs):
        own = known & np.isin(np.arange(misfits.size), responses)
        others = known & ~own
        if min(own.sum(), others.sum()) < least:
            continue
        far, usual = float(np.median(misfits[own])), float(np.median(misfits[others]))
        if far >= times * usual and misfits[own].min() > usual:
            names = listing([inputs.responses[i].name for i in np.flatnonzero(own)], 3)
            return f"All FRFs of one {kind} ({names}) are far off (misfit {far:.1f} dB, of the others {usual:.1f} dB): {advice[kind]}."
    return ""


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


def noise_level(inputs: Inputs, measurement: Measurement, job: JobConfig) -> float | None:
    """Mean absolute error of the measured levels of the responses used, from repeats or else from coherence [dB]; None without either."""
    sigma, averages = measurement.sigma_db, job.averages * measurement.files
    if sigma is None or not np.isfinite(sigma).any():
        # The coherence of a single average is 1, whatever the noise.
        if averages < 2:
            return None
        # Without lines that are noise only: these would excuse any misfit.
        sigma = coherence_sigma(np.where(measurement.coherence > 0.0, measurement.coherence, np.nan), averages, inputs.statistics.errors)
    chosen = sigma[:, inputs.used]
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
        f"the fit does not reach the data: it leaves {misfit_db:.2f} dB over all lines of the responses used, above {limit:.2g} dB "
        f"({noise}{other}). Intervals of stiffness and damping rest on the curvature at this fit and understate the uncertainty. "
        "Calibrated models mostly leave 1 to 2 dB, and verdicts by comparison with the reference job allow for that; a better model or "
        "calibration leaves less"
    )


def worsened(initial_db: float | None, final_db: float | None, noise_db: float | None) -> str | None:
    """Warning if the misfit over all lines of the responses used rose and the fit does not reach the data; else None. All in [dB].

    The cost weights lines, so the plain mean over all lines may rise slightly, within noise and model error, without anything wrong.
    """
    if initial_db is None or final_db is None or not final_db > max(initial_db + SHOWN, _wanted(noise_db)):
        return None
    return f"the mean misfit of the responses used rose from {initial_db:.2f} dB at the start values to {final_db:.2f} dB over all lines"


def phaseless_text(names: Iterable[str]) -> str:
    """Text on responses without phases, by their names."""
    return (
        f"no phases: every value of {', '.join(names)} is real. Check whether columns are shifted, and export complex FRFs (real and "
        "imaginary parts, or magnitudes with phases): without phases, reversed or exchanged sensors, delays and windows are not found"
    )


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
    units = offset_findings(inputs, offsets, result.name)
    if gains is not None and gains.shared is not None and gains.shared.kind != "all":
        # The gain says it better.
        units = [each for each in units if each.kind is not Kind.UNITS or not set(each.responses) <= set(gains.shared.responses)]
    compared = f"{compared_text(inputs, result)}; {_largest_text(inputs, offsets, result.misfit_final)}"
    job = inputs.campaign.jobs[result.name]
    noise = noise_level(inputs, result.measurement, job)
    if reference is not None and reference.explained:
        wide = too_wide((result.measurement.frequency_hz, result.measurement.values[:, inputs.used]), rule=inputs.statistics.resolution)
        # What the reference job shows, too, is no fault of this measurement alone.
        known = None if result.tight is None else (result.tight.frequency_hz, result.tight.values[:, inputs.used])
        alike = known is not None and too_wide(known, rule=inputs.statistics.resolution) is not None
        # Nor is noise, by its coherence or repeats, of that size.
        if alike or (noise is not None and float(np.nanmedian(result.misfit_final)) > _wanted(noise)):
            wide = None
        fault = "exchanged sensors" if swapped else "a factor or a phase, see the warnings" if units else wide and wide.text
        fault = fault or _levels_off(inputs, result, reference.job)
        coarse = "" if fault else coarse_text(reference, inputs.method.rule)
        compared += f"; {coarse or own_fault_text(inputs, result.misfit_final, reference.job, fault)}"
    found = [*([swapped] if swapped else []), *map(str, units)]
    if gains is not None and kinds_of(units).isdisjoint({Kind.UNITS, Kind.PLACES}):
        found.append((gain_text if gains.shared else level_text)(inputs, result.name, gains))
    if bare := phaseless(result.measurement.values, inputs.statistics.resolution):
        found.append(f"{job.first.name}: {phaseless_text(inputs.responses[i].name for i in bare)}")
    # In a relative comparison the model discrepancy cancels, so the misfit need not reach the noise.
    further = [None if result.relative or misfit[1] is None else unreached(misfit[1], noise, reference), worsened(*misfit, noise)]
    untrusted = [Doubt(kind="exchanged", text=swapped)] if swapped else []
    if gains is not None and gains.shared:
        text = f"{_sharing(inputs, gains.shared)} {gain_size(*gains.mean)} than expected from the reference job"
        untrusted.append(Doubt(kind="gain", text=text))
    wrong = sorted({i for finding in units if finding.kind is Kind.UNITS for i in finding.responses} - _always(inputs, result, units))
    if reference is not None and wrong:
        # Beside a structure that came apart, levels that the model misses look like factors.
        named = listing([inputs.responses[i].name for i in wrong], 4)
        untrusted.append(Doubt(kind="factor", text=f"units or sensitivities of {named} are probably wrong", explained=True))
    elif reference is not None and not swapped:
        text, remedy = astray(inputs, result)
        untrusted += [Doubt(kind="astray", text=text)] if text else []
        found += [f"{job.first.name}: {remedy}"] if text else []
    return found + [text for text in further if text is not None], compared, untrusted


def _largest_text(inputs: Inputs, offsets: Sequence[Offset], misfits: Floats) -> str:
    """Whether a constant factor explains the misfit, and which responses stand out by their mean misfits (R,) [dB], in a clause."""
    if not offsets:
        return "too few lines, or too little of the band, to look for a constant factor"
    groups = grouped(offsets, quantities_of(inputs))
    if groups:
        worst = max(groups, key=lambda common: common.offset.before - common.offset.after).offset
        what = f"{worst.db:+.2f} dB" + (f" and (2 pi f)^{worst.power}" if worst.power else "")
        left = f"{worst.before:.1f} dB, {worst.after:.1f} dB without it"
        return f"a constant factor explains most of the misfit of {inputs.responses[worst.response].name}: {what} ({left})"
    constant = [offset for offset in offsets if not offset.power]
    text = "the misfit is not a constant factor"
    if constant:
        worst = max(constant, key=lambda offset: abs(offset.db))
        text += f": the largest, {worst.db:+.2f} dB of {inputs.responses[worst.response].name}, would reduce the misfit of this response "
        text += f"from {worst.before:.1f} to {worst.after:.1f} dB only"
    if alone := outlying(misfits):
        names = ", ".join(inputs.responses[i].name for i in alone)
        text += f"; {names} {'stands' if len(alone) == 1 else 'stand'} out ({misfits[alone].min():.1f} dB and more, "
        text += f"{float(np.nanmedian(misfits)):.1f} dB in the median of all): check these sensors, or leave them out of update.responses"
    return text


def _always(inputs: Inputs, result: Identification, units: Sequence[Finding]) -> set[int]:
    """Responses whose factor the reference job shows, too, so that it cancels; empty if there are no findings ``units``."""
    if not units or result.tight is None or result.expected is None:
        return set()
    with np.errstate(divide="ignore", invalid="ignore"):
        there = result.tight.values * result.updated / result.expected
    return {offset.response for offset in factors_of(inputs, result.tight, (there,)) if offset.named}


def gain_size(gain: float, std: float) -> str:
    """A gain and its 95 % interval in words, from gain and standard deviation [dB]."""
    return f"{abs(10.0 ** (gain / 20.0) - 1.0):.0%} {'higher' if gain > 0 else 'lower'} ({gain:+.1f} +-{2.0 * std:.1f} dB)"


def _scales(inputs: Inputs, job: str, gains: Gains) -> str:
    """Values of ``scale`` of a job that remove its gains; what has no gain keeps the value that it has."""
    own, having = inputs.campaign.jobs[job], None if gains.shared is None else gains.shared.responses
    both = [(inputs.responses[at].name, factor) for at, factor in enumerate(gains.factors(inputs).tolist())]
    scales = {name: own.factor(name) / factor for at, (name, factor) in enumerate(both) if having is None or at in having}
    stated = {name: own.factor(name) for name, _ in both if name not in scales and own.factor(name) != 1.0}
    return ", ".join(f"{name}: {factor:.4g}" for name, factor in (scales | stated).items())


def _sharing(inputs: Inputs, shared: Sharers) -> str:
    """The FRFs that share a gain, in words, with the verb."""
    if shared.kind == "all":
        return "all FRFs are"
    names = [inputs.responses[at].name for at in shared.responses]
    if shared.kind == "sensor":
        return f"the FRFs of one sensor ({listing(names, 4)}) are" if len(names) > 1 else f"the FRF {names[0]} is"
    return f"the FRFs of hammer point {inputs.excitations[inputs.responses[shared.responses[0]].input]} are"


def gain_text(inputs: Inputs, job: str, gains: Gains) -> str:
    """Warning about a gain that responses of a job share relative to the reference job."""
    reference, own, shared = inputs.campaign.update.reference, inputs.campaign.jobs[job], gains.shared
    assert shared is not None
    every = " of all responses" if shared.kind == "all" else ", and the others are not"
    chain = "sensor, in the same place," if shared.kind == "sensor" else "hammer"
    more = "" if shared.kind == "all" else " and the sensor's mounting and cable" if shared.kind == "sensor" else " at this hammer point"
    fault = "the sensor was moved or turned, or its" if shared.kind == "sensor" else "the hammer hit elsewhere, or its"
    again = f"; if they are right, {fault} channel overloaded: measure again, as a scale would only hide it" if more else ""
    return (
        f"{own.first.name}: {_sharing(inputs, shared)} {gain_size(*gains.mean)} than expected from those of {reference}, at all lines"
        f"{every}; no bolt does that. Expected: one {chain} with one sensitivity in both jobs. Verdicts, if any, allow for it, but there "
        f"is no all-clear. Fix: compare the sensitivities entered for {job} and for {reference}{more} (if all jobs say this, those of "
        f"{reference} are wrong), and export again, or write jobs.{job}.scale: {{{_scales(inputs, job, gains)}}}{again}"
    )


def level_text(inputs: Inputs, job: str, gains: Gains) -> str:
    """Warning about gains of the reference job, or of the job of the calibration, relative to the model."""
    errors = inputs.statistics.errors
    db, stds = (dict(zip(inputs.used.tolist(), own.tolist(), strict=True)) for own in (gains.values, gains.stds))
    seen = inputs.used[gains.seen(errors)].tolist()
    named = ", ".join(f"{inputs.responses[at].name} {gain_size(db[at], stds[at])}" for at in seen)
    told = f"{inputs.campaign.jobs[job].first.name}: "
    differing = by_hammer(inputs, db, {at: NORMAL_95 * std for at, std in stds.items()})
    if differing.intersection(seen):
        return (
            f"{told}FRFs are higher or lower ({named}) than expected from the model, at all lines, but not by one factor of each sensor "
            f"({sizes_text(inputs, differing, db)}): no sensitivity depends "
            "on the hammer point. It is allowed for: changes and verdicts do not rest on it, absolute stiffnesses do. Check places and "
            "directions of these sensors and of the hammer points (lrbc check --picture)"
        )
    if gains.alike(errors):
        size, likely = f"all FRFs are {gain_size(*gains.mean)}", "the hammer or of the sensors, or the mass of the model"
    else:
        size, likely = f"FRFs are higher or lower ({named})", "the sensors"
    return (
        f"{told}{size} than expected from the model, at all lines. Probable cause: the sensitivity of "
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
    texts = [factor_text(inputs, common, [o.response for o in offsets], job) for common in grouped(offsets, quantities_of(inputs))]
    raise DataError(
        "measurement and model are probably in different units",
        file=inputs.campaign.jobs[job].first,
        place=f"job {job}",
        expected="FRFs that differ from the model's by its errors, not by one factor at all lines",
        found="; ".join(found for found, _ in texts),
        hint="; ".join(remedy for _, remedy in texts),
    )


def calibration_doubts(
    inputs: Inputs, measurement: Measurement, states: Sequence[Complexes], job: str, misfit: tuple[float, float], gains: Gains | None
) -> list[str]:
    """Warnings of a calibration; ``misfit`` of the responses used before and after, over all lines [dB].

    The states (F, R) are FRFs of the model without the identified gains.
    """
    units = offset_findings(inputs, factors_of(inputs, measurement, states), job)
    found = list(map(str, units))
    if gains is not None and kinds_of(units).isdisjoint({Kind.UNITS, Kind.PLACES}):
        found.append(level_text(inputs, job, gains))
    noise = noise_level(inputs, measurement, inputs.campaign.jobs[job])
    further = [unreached(misfit[1], noise), worsened(*misfit, noise)]
    return found + [text for text in further if text is not None]
