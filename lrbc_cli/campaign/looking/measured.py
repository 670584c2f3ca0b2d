"""Findings of measurements alone for ``lrbc check``: lines, digits, coherence, phases, and the measuring chain of each job."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.chains import (
    blows_doubt,
    chain_doubt,
    coherence_doubt,
    noise_doubt,
    second_blow_text,
    soft_tip,
)
from lrbc_cli.campaign.identification.compared.doubts import phaseless_text
from lrbc_cli.campaign.identification.compared.sensors import sensors_of
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.identification.weights import beside_noise, weighted_down
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import listing
from lrbc_cli.updating.knots import evenly
from lrbc_cli.updating.statistics.chain.modal import ChainFault, fitted_modes
from lrbc_cli.updating.statistics.chain.runs import other_run
from lrbc_cli.updating.statistics.lines import covers, few_digits, few_resonances, normalised, phaseless, too_wide, unresolved


def of_file(inputs: Inputs, name: str, measurement: Measurement) -> Iterator[Finding]:
    """Findings of few resonances in the band (reference job only), few digits, normalised FRFs, and single blows."""
    few = few_resonances(measurement.frequency_hz, measurement.values[:, inputs.used], inputs.statistics.resonances)
    if few is not None and name == inputs.campaign.update.reference and covers(measurement.frequency_hz, inputs.campaign.reduction.band):
        yield Finding(job=name, text=_few_text(inputs, measurement, few))
    file = inputs.campaign.jobs[name].first.name
    if rounded := few_digits(measurement.values):
        which = ", ".join(f"{inputs.responses[i].name} ({error:.1f} dB)" for i, error in rounded.items())
        text = (
            f"numbers with too few digits; errors of the levels: {which}. Export it again in exponential format with five digits of each "
            "number, also of small ones (1.2345e-03)"
        )
        yield Finding(place=file, text=text, kind=Kind.DIGITS, responses=tuple(rounded))
    # Magnitudes and phases in degrees that are read as real and imaginary parts have the same largest value, too: half a turn.
    if (top := normalised(measurement.values)) and not 0.99 * 180.0 <= top <= 180.5:
        text = (
            f"every record has its largest magnitude at {top:.6g}: each was normalised to its own peak, so the levels between sensors are "
            "lost. Export the FRFs as response over force, without normalisation"
        )
        yield Finding(place=file, text=text, kind=Kind.NORMALISED)
    yield from _single(inputs, name, measurement)
    if differing := blows_doubt(inputs, name, measurement):
        yield Finding(job=name, text=differing)


def _single(inputs: Inputs, name: str, measurement: Measurement) -> Iterator[Finding]:
    """Finding of a coherence of 1 at every line, as of a single blow, whatever the noise."""
    table, told = measurement.coherence, np.isfinite(measurement.coherence)
    ones = np.flatnonzero(told.any(axis=0) & (~told | (table == 1.0)).all(axis=0))
    if ones.size and inputs.campaign.jobs[name].averages > 1:
        text = (
            f"the coherence of {listing([inputs.responses[i].name for i in ones], 6)} is 1 at every line, as for a single blow, and says "
            "nothing about the noise. Average three blows or more, or remove the coherence from the file; for one blow write "
            f"jobs.{name}.averages: 1"
        )
        yield Finding(place=inputs.campaign.jobs[name].first.name, text=text, kind=Kind.BLOW, responses=tuple(ones.tolist()))


def _few_text(inputs: Inputs, measurement: Measurement, count: int) -> str:
    """Text that the band is too narrow for verdicts, with the range of the file; ``count`` is the number of resonances."""
    axis, (low, high) = measurement.frequency_hz, inputs.campaign.reduction.band
    step = float(np.median(np.diff(axis))) if axis.size > 1 else 0.0
    ends = axis[0] - step * measurement.left_out[0], axis[-1] + step * measurement.left_out[1]
    wider = f"the file contains {ends[0]:.6g} to {ends[1]:.6g} Hz" if sum(measurement.left_out) else "measure a wider band"
    return (
        f"{count or 'no'} resonance{'' if count == 1 else 's'} in the band from {low:g} to {high:g} Hz, at least three are needed: a "
        f"loosened bolt shifts each one differently, and so few do not show which bolt it was. Widen reduction.band ({wider})"
    )


def unclear(inputs: Inputs, readable: Mapping[str, Measurement]) -> list[Finding]:
    """Findings of jobs whose lines do not resolve the peaks, end early, or have a low coherence from some frequency on; one per cause."""
    causes, told = dict[str, list[str]](), list[Finding]()
    if early := [name for name, found in readable.items() if _from_zero(found, inputs.campaign.reduction.band[1])]:
        last, high = float(readable[early[0]].frequency_hz[-1]), inputs.campaign.reduction.band[1]
        text = (
            f"the lines begin at 0 Hz and end at {last:g} Hz, {high - last:g} Hz below the end of reduction.band. If the export left out "
            "the first lines, all frequencies are too low by the first one that was measured: correct the start frequency in the files. "
            f"Otherwise let reduction.band end at {last:g}"
        )
        told.append(Finding(place=_jobs(early), text=text))
    if soft := {name: edge for name, found in readable.items() if (edge := soft_tip(found)) is not None}:
        ends, worst = [hz for hz, _ in soft.values()], max(own for _, own in soft.values())
        text = (
            f"the coherence is {worst:.2f} or less from {min(ends):.4g} Hz on: the force of the hammer probably does not reach that far. "
            "Measure with a harder tip, or let reduction.band end there"
        )
        told.append(Finding(place=_jobs(list(soft)), text=text))
    reference = inputs.campaign.update.reference
    tight = readable.get(reference or "")
    peaks = {name: (found.frequency_hz, found.values[:, inputs.used]) for name, found in readable.items() if name not in soft}
    quiet = {
        name: (hz, weighted_down(inputs, name, readable[name], None if name == reference else tight)[:, inputs.used])
        for name, (hz, _) in peaks.items()
    }
    for name, own in peaks.items():
        # If the lines cover part of the band only, another warning says so, and consequences (as of rad/s for Hz) are omitted.
        if covers(own[0], inputs.campaign.reduction.band) and (wide := beside_noise(inputs, [own], [quiet[name]])):
            causes.setdefault(wide.cause, []).append(name)
    for names in causes.values():
        those = [peaks[name] for name in names]
        if together := beside_noise(inputs, those, [quiet[name] for name in names]):
            those = [quiet[name] for name in names] if together.noise else those
            text = together.text
            if few := _few(inputs, those):
                text = f"probably noise of {few}: {together.fall}, most of them there; check the channel, and measure it again"
            told.append(Finding(place=_jobs(names), text=f"{text}, or expect wide intervals and no all-clear"))
    return told


def _from_zero(measurement: Measurement, high: float) -> bool:
    """Whether evenly spaced lines begin at 0 Hz exactly and end by more than one line below ``high`` [Hz]."""
    axis, (below, above) = measurement.frequency_hz, measurement.left_out
    step = float(np.median(np.diff(axis)))
    return abs(axis[0] - step * below) < 1e-6 * step and not above and bool(axis[-1] < high - 1.5 * step)


def _jobs(names: Sequence[str]) -> str:
    return f"job{'s' if len(names) > 1 else ''} {', '.join(names)}"


def _few(inputs: Inputs, those: Sequence[tuple[Floats, Complexes]]) -> str:
    """Names of the responses (at most a third) without which the peaks of the others are resolved; empty if there are none."""
    rule = inputs.statistics.resolution
    sharp = np.sum([[unresolved(hz, own[:, [r]], rule).sharp.size for r in range(inputs.used.size)] for hz, own in those], axis=0)
    order = np.argsort(-sharp, kind="stable")
    for count in range(1, order.size // 3 + 1):
        if (
            2 * sharp[order[:count]].sum() > sharp.sum()
            and too_wide(*((hz, own[:, order[count:]]) for hz, own in those), rule=rule) is None
        ):
            return ", ".join(inputs.responses[inputs.used[r]].name for r in sorted(order[:count]))
    return ""


def without_phases(inputs: Inputs, readable: Mapping[str, Measurement]) -> list[Finding]:
    """Finding of jobs whose FRFs have no phases; else empty."""
    bare = {name: found for name, own in readable.items() if (found := phaseless(own.values, inputs.statistics.resolution))}
    if not bare:
        return []
    names = [inputs.responses[i].name for i in sorted({i for found in bare.values() for i in found})]
    files = [inputs.campaign.jobs[name].first.name for name in bare]
    return [Finding(place=", ".join(files), text=phaseless_text(names))]


def other_chains(
    inputs: Inputs,
    readable: Mapping[str, Measurement],
    other_quantity: Collection[str] = (),
    reversed_sign: Collection[str] = (),
    expected: Callable[[str], Complexes | None] = lambda _: None,
) -> list[Finding]:
    """Findings of jobs measured with another chain than the reference job, or with more noise.

    Loosened bolts may hide a second blow; it then shows beside the FRFs (F, R) ``expected`` of a job in the state that fits it best.

    In jobs whose FRFs are of an ``other_quantity`` than stated, an integration weights down the highest modes, and from few modes loosened
    bolts look like another clock: nothing is said of their frequencies until the quantity is corrected. In jobs with a reversed sign
    (``reversed_sign``) phases have turned by that.
    """
    reference = inputs.campaign.update.reference or ""
    tight, found = readable.get(reference), list[Finding]()
    for name, own in readable.items():
        if tight is None or name == reference:
            continue
        doubtful = not {name, reference}.isdisjoint(other_quantity)
        fault = chain_doubt(inputs, own, tight, reference, job=name)
        same = own.values.shape == tight.values.shape and not unlike(own.frequency_hz, tight.frequency_hz)
        if fault is None and same and (fitted := expected(name)) is not None:
            blow = second_blow_text(inputs, own, fitted, reference)
            fault = ChainFault("blow", blow) if blow else None
        turned = name in reversed_sign and fault is not None and fault.kind == "filter"
        if fault is not None and not turned and not (doubtful and fault.kind in ("lines", "clock")):
            text = f"{fault.text} (lrbc update says it again unless loose bolts explain it)"
            found.append(Finding(job=name, text=text, kind=Kind.CHAIN, detail=fault.kind))
        if noise := noise_doubt(own, tight, reference):
            found.append(Finding(job=name, text=noise, kind=Kind.NOISE))
        if incoherent := coherence_doubt(inputs, own, tight, reference):
            found.append(Finding(job=name, text=incoherent))
        # Noise of a part of the band lowers the coherence there, too.
        if not noise and not blows_doubt(inputs, name, own) and (differing := blows_doubt(inputs, name, own, tight)):
            found.append(Finding(job=name, text=differing))
    return found


def other_runs(inputs: Inputs, readable: Mapping[str, Measurement]) -> list[Finding]:
    """Finding of sensors whose records show all modes at other frequencies than those of the others; else empty."""
    named = {", ".join(inputs.responses[i].name for i in own): list(own) for own in sensors_of(inputs)}
    rule, modes = inputs.statistics.modal, list[dict[str, Floats]]()
    for found in readable.values():
        axis, values = found.frequency_hz, found.values
        modes.append({name: fitted_modes(axis, values[:, own], rule).frequency_hz for name, own in named.items()} if evenly(axis) else {})
    run = other_run(modes, rule)
    if run is None:
        return []
    text = (
        f"resonances in the records of {', '.join(run.lower)} are {run.shift:.2%} lower than in those of {', '.join(run.higher)} in the "
        "same jobs, although a structure has the same resonances at all sensors. Check whether these were measured in another run, "
        "with the mass of sensors at other places, at another temperature, or with another sampling rate. Measure all sensors in one run, "
        "or with dummy masses at the places of the others; else remove the records of one run from the responses"
    )
    return [Finding(text=text)]
