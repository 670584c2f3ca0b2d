"""Detects jobs that were measured with another measuring chain than the reference job, or with more noise; returns texts for the user."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Bools, Complexes
from lrbc_cli.campaign.identification.compared.doubts import FAR_ABOVE_NOISE
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.model.factors import SOUND_SPEED
from lrbc_cli.updating.robust import medians
from lrbc_cli.updating.statistics.chain.blows import blow_spread, differing_blows, second_blow
from lrbc_cli.updating.statistics.chain.modal import ChainFault, other_chain
from lrbc_cli.updating.statistics.lines import line_noise, noise_shares


def noise_doubt(own: Measurement, tight: Measurement, reference: str, *, least: float = 0.1, part: float = 0.5) -> str | None:
    """Warning if the lines of a job scatter far more than those of the reference job, in the whole band or in one part of it; else None.

    Parameters
    ----------
    own, tight : Measurement
        Measurements of the job and of the reference job; None is returned if their lines differ.
    reference : str
        Name of the reference job.
    least : float
        Least ratio of noise to magnitude (median over all lines): half a decibel on average, half of the misfit that a fit should leave.
    part : float
        The same for one part of the band. On 24 structures loosened bolts, which lower signals and sharpen peaks, reached 0.22.
    """
    if own.values.shape != tight.values.shape or unlike(own.frequency_hz, tight.frequency_hz):
        return None

    def risen(lines: slice, least: float) -> tuple[float, float] | None:
        noise, other = line_noise(own.values[lines]), line_noise(tight.values[lines])
        return (noise, other) if noise > max(least, FAR_ABOVE_NOISE * other) else None

    at = _edge(own, part)
    below, above = risen(slice(at), part), risen(slice(at, None), part)
    if at and (below is None) != (above is None):
        noise, other = above or below or (0.0, 0.0)
        side, end, cause = (
            ("from", "end", "the tip of the hammer was too soft") if above else ("up to", "begin", "blow or sensors were too weak there")
        )
        return (
            f"noise of {noise:.0%} of the size of each line {side} {own.frequency_hz[at]:.4g} Hz (median), {other:.1%} in {reference}, "
            f"and no such noise elsewhere. Check whether {cause}. Measure it again, or let reduction.band {end} there"
        )
    if (found := risen(slice(None), least)) is None:
        return None
    return (
        f"noise of {found[0]:.0%} of the size of each line (median over all lines), {found[1]:.1%} in {reference}. Possible causes: too "
        "few averages, a weak or a double blow, noise of the surroundings. Expected: as in the other jobs. Measure it again with more "
        "averages, and look at each blow"
    )


def _edge(own: Measurement, least: float) -> int:
    """Index of the line that best separates noisy lines from others; 0 if no line is noisy."""
    # NaN on lines on which no response has a value.
    noisy = medians(noise_shares(own.values), 1)[:, 0] > least
    if noisy.size < 2:
        return 0
    count, before = np.arange(1, noisy.size), np.cumsum(noisy)[:-1]
    apart = np.abs(before / count - (noisy.sum() - before) / (noisy.size - count)) * np.sqrt(count * (noisy.size - count))
    # Two lines at each end have no neighbours on both sides.
    return int(np.argmax(apart)) + 3 if noisy.any() else 0


def blows_doubt(inputs: Inputs, job: str, own: Measurement, tight: Measurement | None = None) -> str | None:
    """Message on blows that differ from each other more than in the reference job, if that is given; else None."""
    statistics, reference = inputs.statistics, str(inputs.campaign.update.reference)

    def blows(name: str, measurement: Measurement) -> int:
        return inputs.campaign.jobs[name].averages * measurement.files

    def differing(at: Bools) -> str | None:
        usual = None
        if tight is not None:
            usual = blow_spread(tight.values[:, at], tight.coherence[:, at], blows(reference, tight), statistics.errors)
        values, coherence = own.values[:, at], own.coherence[:, at]
        return differing_blows(values, coherence, blows(job, own), statistics.blows, statistics.errors, usual=usual)

    points = [(name, inputs.input_of == number) for number, name in enumerate(inputs.excitations)]
    if text := differing(np.ones(inputs.input_of.size, dtype=bool)):
        return text
    # A bolt that came loose between the blows at one hammer point shows in its FRFs alone.
    found = ((name, differing(at)) for name, at in points if len(points) > 1 and at.any())
    return next((f"FRFs of {name}: {text}" for name, text in found if text), None)


def coherence_doubt(
    inputs: Inputs, own: Measurement, tight: Measurement, reference: str, *, least: float = 0.01, times: float = 80.0
) -> str | None:
    """Warning if the noise of a few responses, by their coherence, has risen relative to the reference job; else None.

    The ratio of noise to signal also rises if a loosened bolt lowers a response, so the noise itself must have risen, too.

    Parameters
    ----------
    inputs : Inputs
    own, tight : Measurement
        Measurements of the job and of the reference job; None is returned if their lines differ.
    reference : str
        Name of the reference job.
    least : float
        Least ratio of noise to signal power, ``(1 - g²) / g²``, in the median over the lines.
    times : float
        Least factor by which this ratio, and the noise, have risen, relative to the median factor of all responses. On 24 virtual rigs
        loosened bolts reached 43, clipping at half or a third of the peak 107 and 117.
    """
    if own.coherence.shape != tight.coherence.shape or unlike(own.frequency_hz, tight.frequency_hz):
        return None
    known = [np.isfinite(each.coherence * np.abs(each.values)).any(axis=0) for each in (own, tight)]
    told = np.flatnonzero(known[0] & known[1])
    if told.size < 3:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = [(1.0 - each.coherence[:, told]) / each.coherence[:, told] for each in (own, tight)]
        sizes = [share * np.abs(each.values[:, told]) ** 2 for share, each in zip(shares, (own, tight), strict=True)]
        noise, risen = np.nanmedian(shares[0], axis=0), []
        for now, before in (shares, sizes):
            ratio = np.nanmedian(now, axis=0) / np.nanmedian(before, axis=0)
            risen.append(ratio / np.nanmedian(ratio))
        far = told[(noise >= least) & (np.minimum(*risen) > times)]
    if not far.size or 2 * far.size > told.size:
        return None
    names = ", ".join(inputs.responses[i].name for i in far)
    here, there = (", ".join(f"{np.nanmedian(g[:, i]):.4g}" for i in far) for g in (own.coherence, tight.coherence))
    return (
        f"the coherence of {names} is {here} (median over the lines), {there} in {reference}; that of no other response fell as far. Check "
        "whether a channel was overloaded, or a sensor or its cable was loose. Look at the time signals, raise the range, and measure it "
        "again, or leave the response out of this job"
    )


def second_blow_text(inputs: Inputs, own: Measurement, expected: Complexes, reference: str) -> str:
    """Warning if a job was hit twice, at all hammer points or at one, beside ``expected`` FRFs (F, R); else empty."""
    rule = inputs.statistics.blows
    if blow := second_blow(own.frequency_hz, own.values, expected, reference, rule):
        return blow
    for at, point in enumerate(inputs.excitations):
        which = inputs.input_of == at
        if rule.point_responses <= which.sum() < which.size:
            values = own.values[:, which], expected[:, which]
            if blow := second_blow(own.frequency_hz, *values, reference, rule, point=point):
                return blow
    return ""


def chain_doubt(inputs: Inputs, own: Measurement, tight: Measurement, reference: str, *, job: str = "") -> ChainFault | None:
    """Fault if a job was measured with another window, filter or clock than the reference job, or hit twice; else None.

    Parameters
    ----------
    inputs : Inputs
    own, tight : Measurement
        Measurements of the job and of the reference job; None is returned if their lines differ.
    reference, job : str
        Names of the reference job, and of the job, which may be a baseline.
    """
    if own.values.shape != tight.values.shape or unlike(own.frequency_hz, tight.frequency_hz):
        return None
    if blow := second_blow_text(inputs, own, tight.values, reference):
        return ChainFault("blow", blow)
    names, air = [response.name for response in inputs.responses], SOUND_SPEED in inputs.recipe.names
    loosened = job not in inputs.campaign.update.baselines
    return other_chain(own.frequency_hz, own.values, tight.values, reference, names, inputs.statistics.modal, air=air, loosened=loosened)


def soft_tip(own: Measurement, *, low: float = 0.75, share: float = 0.8, least: float = 0.1) -> tuple[float, float] | None:
    """Frequency above which the coherence of a job is low [Hz], and its median there; None if there is none, or if it is unknown.

    Parameters
    ----------
    own : Measurement
    low : float
        Coherence (median over the responses) below which a line is mostly noise with the usual number of averages.
    share : float
        Least share of the lines above that frequency that are low, and of those below that are not.
    least : float
        Least share of all lines on either side.
    """
    known = np.isfinite(own.coherence).any(axis=1)
    if 2 * known.sum() < known.size:
        return None
    hz, typical = own.frequency_hz[known], np.nanmedian(own.coherence[known], axis=1)
    bad, count = np.concatenate([[0], np.cumsum(typical < low)]), np.arange(hz.size + 1)
    rest = hz.size - count
    above, below = bad[-1] - bad, count - bad
    split = (above >= share * rest) & (below >= share * count) & (np.minimum(rest, count) >= least * hz.size)
    if not split.any():
        return None
    at = int(np.flatnonzero(split)[np.argmax((above + below)[split])])
    return float(hz[at]), float(np.median(typical[at:]))
