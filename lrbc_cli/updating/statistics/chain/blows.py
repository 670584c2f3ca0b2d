"""Detection of faulty blows: a double hit (a periodic factor common to all responses of a job), blows that differ, and too few."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.checked import Checked, Count, Positive, Share
from lrbc_cli.updating.knots import evenly
from lrbc_cli.updating.statistics.chain.damping import beside_damping, damping_pattern
from lrbc_cli.updating.statistics.decibels import DB, coherence_sigma, decibel
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel
from lrbc_cli.updating.statistics.lines import noise_shares


@dataclass(frozen=True, kw_only=True)
class BlowRule(Checked):
    """Limits from which a job is taken to have been hit twice, or its blows to differ from each other.

    Attributes
    ----------
    left : float
        Largest share of the mean change of the levels that is left when the factor is taken out. 0.85 and more is left in correct jobs of
        the samples and of virtual rigs; 0.39 to 0.77 where a second blow of 0.3 to 0.5 was simulated in jobs with few loose bolts.
    shared : float
        Least share of the responses whose own change the factor reduces: it is in all of them alike, while a wave that a loose joint
        reflects changes some. 0.92 to 1 where a second blow was simulated on rigs of five designs, 0.74 and 0.81 in two jobs of a rail.
    sizes : tuple of float
        Ratios of the second blow to the first that are tried. A choice: smaller ones change little.
    periods : float
        Least number of periods of the factor in the band. A choice: bolts cause slopes as slow as fewer periods.
    point_periods, point_responses : float, int
        The same for one hammer point, and the least number of its responses, by which it alone is taken to have been hit twice. With fewer
        responses a loose bolt has slower slopes in common: with 1.5 periods one of 300 right jobs was told (1.9 periods), with 3 none.
    lines : float
        Least number of lines in a period. A choice.
    steps : int
        Number of delays of the cepstrum for each further period in the band. A choice.
    closely : int
        Number of the highest values of the cepstrum that are tried with all sizes. A choice.
    differing, differing_alone, noise : float
        Least ratio of the noise by the coherence to that by neighbouring lines, over that of the reference job or without one, and least
        noise by the coherence over the magnitude, at the half of the lines with the lower coherence. The ratio was 0.7 to 1.1 in 200 jobs
        of virtual rigs, 2.0 to 7.8 where two or three of five blows were those of another state, 8.8 where one was, with noise of 0.06
        by the coherence. Choices.
    scattered : float
        Least ratio of the variance of neighbouring lines to that by the coherence from which the stated number of blows is too large. It
        was 1.2 to 1.9 in 120 jobs of virtual rigs and samples with the right number. A choice.
    """

    left: Share = 0.75
    shared: Share = 0.9
    sizes: tuple[Positive, ...] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
    periods: Positive = 1.5
    point_periods: Positive = 3.0
    point_responses: Count = 3
    lines: Positive = 4.0
    steps: Count = 8
    closely: Count = 10
    differing: Positive = 1.5
    differing_alone: Positive = 3.0
    noise: Share = 0.05
    scattered: Positive = 10.0


#: The default, for callers that use a part of the package by itself.
BLOWS = BlowRule()


def second_blow(
    frequency_hz: Floats, own: Complexes, tight: Complexes, reference: str, rule: BlowRule = BLOWS, *, point: str = ""
) -> str | None:
    """Message on a job whose FRFs, or those of the reference job, contain the factor of a second blow; None if neither do.

    A blow followed by a share a of it after the time T has ``1 + a exp(-i omega T)`` times the spectrum of the first. If the force window
    cuts off the second blow, the FRFs contain that factor. The median of the level changes over the responses is compared with it, since
    bolts change levels about resonances only; the cepstrum gives the delays T to try.

    Parameters
    ----------
    frequency_hz : (F,) float array
        Must be evenly spaced, otherwise None is returned.
    own, tight : (F, R) complex arrays
        NaN where a response was not measured.
    reference : str
        Name of the reference job.
    rule : BlowRule
    point : str
        Name of the hammer point, if the responses are those of one of several.
    """
    steps, periods = np.diff(frequency_hz), rule.point_periods if point else rule.periods
    held = (np.isfinite(own) & np.isfinite(tight) & (own != 0) & (tight != 0)).all(axis=0)
    if steps.size < 2 * rule.lines * periods or not held.any() or not evenly(frequency_hz):
        return None
    levels, spacing = decibel(own[:, held]) - decibel(tight[:, held]), float(steps.mean())

    def changed(other: Complexes) -> Floats:
        """(F,) median level change without that of damping, by the phases of the job that was hit once, which lack the factor."""
        turned = np.gradient(np.unwrap(np.angle(other[:, held]), axis=0), spacing, axis=0)
        return np.asarray(np.median(beside_damping(levels, damping_pattern(frequency_hz, 1j * turned)), axis=1))

    changes = {1.0: changed(tight), -1.0: changed(own)}
    before = {sign: float(_apart(change)) for sign, change in changes.items()}
    if not all(before.values()):
        return None
    band, sizes = float(np.ptp(frequency_hz)), np.array(rule.sizes)
    delays = np.asarray(np.fft.rfftfreq(rule.steps * steps.size, spacing), dtype=float)
    possible = np.flatnonzero((delays >= periods / band) & (delays < 1.0 / (rule.lines * spacing)))
    # A second blow in the reference job shows in all other jobs with the opposite sign.
    found: tuple[float, float, float, float] = (np.inf, 0.0, 0.0, 1.0)
    for sign, change in changes.items():
        cepstrum = _cepstrum(sign * change, rule.steps * steps.size, delays, frequency_hz[0])
        for delay in delays[possible[np.argsort(-cepstrum[possible], kind="stable")[: rule.closely]]].tolist():
            factor = 1.0 + sizes[:, None] * np.exp(-2j * np.pi * frequency_hz * delay)
            left = _apart(sign * change - decibel(factor)) / before[sign]
            k = int(np.argmin(left))
            found = min(found, (float(left[k]), delay, rule.sizes[k], sign))
    share, delay, size, sign = found
    factor = decibel(1.0 + size * np.exp(-2j * np.pi * frequency_hz * delay))
    reduced = _apart(sign * levels.T - factor) < _apart(levels.T)
    if share > rule.left or np.mean(reduced) < rule.shared:
        return None
    job, other = ("this job", reference) if sign > 0.0 else (reference, "this job")
    where, whose = (f" at {point}", f" of {point}") if point else ("", "")
    return (
        f"the hammer probably hit a second time{where} in {job}, {1e3 * delay:.3g} ms later and {size:.0%} as hard, and a window cut that "
        f"blow from the force: the levels of all responses{whose} rise and fall every {1.0 / delay:.3g} Hz relative to {reference}; no "
        f"bolt does that. Expected: one blow in each record, as in {other}. Look at the force over time, and measure {job} again"
    )


def _cepstrum(levels: Floats, count: int, delays: Floats, first_hz: float) -> Floats:
    """Cepstrum of levels on evenly spaced lines, padded with zeros to ``count``: amplitude of the cosine of each delay.

    An echo is a peak in it (Bogert, Healy and Tukey, Proc. Symp. Time Series Analysis, 1963). Levels are clipped to 6 dB, because a second
    blow weaker than the first raises none by more and lowers few by more; changes by bolts about resonances can be larger.
    """
    most = 20.0 * np.log10(2.0)
    clipped = np.clip(levels - np.median(levels), -most, most)
    return np.asarray((np.fft.rfft(clipped, count) * np.exp(-2j * np.pi * first_hz * delays)).real)


def _apart(values: Floats) -> Floats:
    """Mean absolute deviation of levels from their median over the lines (last axis) [dB]."""
    return np.asarray(np.abs(values - np.median(values, axis=-1, keepdims=True)).mean(axis=-1))


@dataclass(frozen=True)
class _Noise:
    """Noise of the half of the lines with the lower coherence, in the median.

    Attributes
    ----------
    coherence : float
    stated : float
        Standard deviation of the magnitude by the coherence, over the magnitude.
    scatter : float
        Ratio of the variance by neighbouring lines to that by the coherence.
    """

    coherence: float
    stated: float
    scatter: float


def _noise_of(values: Complexes, coherence: Floats, averages: int, errors: ErrorModel) -> _Noise | None:
    """None without lines or coherence. In the other half of the lines, the curvature of the FRF is more than the noise."""
    if averages < 2 or len(values) < 5:
        return None
    told, shares = coherence[2:-2], noise_shares(values)
    told = np.where(np.isfinite(shares) & (told > 0.0) & (told < 1.0), told, np.nan)
    known = np.isfinite(told).any(axis=0)
    if not known.any():
        return None
    told, shares = told[:, known], shares[:, known]
    noisy = told <= np.nanmedian(told, axis=0)
    stated = coherence_sigma(told[noisy], averages, errors) / DB
    # Of real and imaginary part together.
    scatter = np.median(shares[noisy] ** 2 / (2.0 * stated**2))
    return _Noise(float(np.median(told[noisy])), float(np.median(stated)), float(scatter))


def blow_spread(values: Complexes, coherence: Floats, averages: int, errors: ErrorModel = ERRORS) -> float | None:
    """How many times the noise of neighbouring lines the coherence states, of at least one; None if either is unknown.

    See ``differing_blows`` for the parameters. Blows that differ from each other lower the coherence, and leave lines smooth.
    """
    found = _noise_of(values, coherence, averages, errors)
    return None if found is None or not found.scatter > 0.0 else max(1.0, found.scatter**-0.5)


def differing_blows(
    values: Complexes,
    coherence: Floats,
    averages: int,
    rule: BlowRule = BLOWS,
    errors: ErrorModel = ERRORS,
    *,
    usual: float | None = None,
) -> str | None:
    """Message on an average of blows that differ from each other; None if they do not, or if the coherence is unknown.

    Noise that lowers the coherence differs from line to line, so neighbouring lines scatter by as much. Averages of two states, or of two
    hammer points, and bolts that rattle, have a low coherence although their lines are smooth.

    Parameters
    ----------
    values : (F, R) complex array
        On evenly spaced lines; NaN where a response was not measured.
    coherence : (F, R) float array
        NaN where it is unknown.
    averages : int
        Number of blows.
    rule : BlowRule
    errors : ErrorModel
    usual : float or None
        ``blow_spread`` of the reference job: blows of one operator differ a little in all jobs, but by no more than ``differing_alone``.
        None if it is not known.
    """
    noise, spread = _noise_of(values, coherence, averages, errors), blow_spread(values, coherence, averages, errors)
    most = rule.differing_alone if usual is None else min(rule.differing * usual, rule.differing_alone)
    if noise is None or spread is None or not (noise.stated > rule.noise and spread > most):
        return None
    return (
        f"by the coherence, {noise.coherence:.2f} at the noisier half of the lines, each of these has noise of {noise.stated:.0%} of its "
        f"size, but neighbouring lines agree within {noise.stated / spread:.0%}: the blows probably differ from each other. Check whether "
        "the average still held blows of another state or of another hammer point, or a sensor came loose between them. Reset the average, "
        "and measure it again. If it stays so, a loose bolt probably rattles: then FRFs depend on the force of the blow"
    )


def too_many_blows(values: Complexes, coherence: Floats, averages: int, rule: BlowRule = BLOWS, errors: ErrorModel = ERRORS) -> str | None:
    """Message on a stated number of blows by which lines would scatter much less than they do; None if it fits the coherence.

    Parameters
    ----------
    values : (F, R) complex array
        On evenly spaced lines; NaN where a response was not measured.
    coherence : (F, R) float array
        NaN where it is unknown.
    averages : int
        Stated number of blows.
    rule : BlowRule
    errors : ErrorModel
    """
    noise = _noise_of(values, coherence, averages, errors)
    ratio = 0.0 if noise is None else noise.scatter
    if not rule.scattered < ratio <= averages:
        return None
    return (
        f"averages: {averages} is too large: neighbouring lines scatter with {float(f'{ratio:.1g}'):g} times the variance that the "
        f"coherence allows after {averages} blows; about {max(round(averages / ratio), 1)} would fit. Write the number of blows that each "
        "FRF is the mean of"
    )
