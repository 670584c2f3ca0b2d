"""A second blow of the hammer: a factor over the frequency that all responses of a job have and those of the reference job have not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.updating.statistics.chain.damping import beside_damping, damping_pattern
from lrbc_cli.updating.statistics.decibels import decibel


@dataclass(frozen=True, kw_only=True)
class EchoRule:
    """From when on a job is taken to have been hit twice.

    Attributes
    ----------
    left : float
        At most so much is left of the mean change of the levels without the factor. 0.85 and more is left in right jobs of the samples and
        of virtual rigs; 0.39 to 0.77 where a blow of 0.3 to 0.5 was put into those in which few bolts are loose.
    sizes : tuple of float
        Second blows over the first that are tried. A choice: smaller ones change little.
    periods : float
        Least number of periods in the band. A choice: fewer are slopes that bolts have, too.
    lines : float
        Least number of lines a period. A choice.
    steps : int
        Times of the cepstrum for each further period in the band. A choice.
    closely : int
        How many of its highest are tried with all sizes. A choice.
    """

    left: float = 0.75
    sizes: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
    periods: float = 1.5
    lines: float = 4.0
    steps: int = 8
    closely: int = 10


#: The default, for those who call a part alone.
ECHO = EchoRule()


def second_blow(frequency_hz: Floats, own: Complexes, tight: Complexes, reference: str, rule: EchoRule = ECHO) -> str | None:
    """What to say of a job whose FRFs have the factor of a second blow beside those of the reference job; None where they have none.

    A blow and a share a of it after the time T are ``1 + a exp(-i omega T)`` times the force of the first. Where the window of the force
    ends between the two, the FRFs hold that factor. Bolts change levels about resonances, so that the median over the responses and mean
    absolute differences are compared; the cepstrum says at which times.

    Parameters
    ----------
    frequency_hz : (F,) float array
        Evenly spaced, or nothing is compared.
    own, tight : (F, R) complex arrays
        NaN where a response was not measured.
    reference : str
        Name of the reference job.
    rule : EchoRule
    """
    steps = np.diff(frequency_hz)
    held = (np.isfinite(own) & np.isfinite(tight) & (own != 0) & (tight != 0)).all(axis=0)
    if steps.size < 2 * rule.lines * rule.periods or not held.any() or not np.allclose(steps, steps.mean(), rtol=1e-3):
        return None
    levels, spacing = decibel(own[:, held]) - decibel(tight[:, held]), float(steps.mean())

    def changed(other: Complexes) -> Floats:
        """Beside another damping, by the phases of the job that was hit once: those of the other have the factor as well."""
        turned = np.gradient(np.unwrap(np.angle(other[:, held]), axis=0), spacing, axis=0)
        return np.asarray(np.median(beside_damping(levels, damping_pattern(frequency_hz, 1j * turned)), axis=1))

    changes = {1.0: changed(tight), -1.0: changed(own)}
    before = {sign: float(_apart(change)) for sign, change in changes.items()}
    if not all(before.values()):
        return None
    band, sizes = float(np.ptp(frequency_hz)), np.array(rule.sizes)
    delays = np.asarray(np.fft.rfftfreq(rule.steps * steps.size, spacing), dtype=float)
    possible = np.flatnonzero((delays >= rule.periods / band) & (delays < 1.0 / (rule.lines * spacing)))
    # One in the reference job is in all others, the other way round.
    found: tuple[float, float, float, float] = (np.inf, 0.0, 0.0, 1.0)
    for sign, change in changes.items():
        cepstrum = _cepstrum(sign * change, rule.steps * steps.size, delays, frequency_hz[0])
        for delay in delays[possible[np.argsort(-cepstrum[possible], kind="stable")[: rule.closely]]].tolist():
            factor = 1.0 + sizes[:, None] * np.exp(-2j * np.pi * frequency_hz * delay)
            left = _apart(sign * change - decibel(factor)) / before[sign]
            k = int(np.argmin(left))
            found = min(found, (float(left[k]), delay, rule.sizes[k], sign))
    share, delay, size, sign = found
    if share > rule.left:
        return None
    job, other = ("this job", reference) if sign > 0.0 else (reference, "this job")
    return (
        f"the levels of all responses rise and fall every {1.0 / delay:.3g} Hz beside those of {reference}. No bolt does that: as if "
        f"in {job} the hammer had hit a second time, {1e3 * delay:.3g} ms later and {size:.0%} as hard, and a window had cut that blow "
        f"from the force; expected: one blow in each record, as in {other}. Look at the force over time, and measure {job} again"
    )


def _cepstrum(levels: Floats, count: int, delays: Floats, first_hz: float) -> Floats:
    """Amplitude of each delay's cosine in levels along evenly spaced lines, zeros added up to ``count``.

    An echo is a peak there (Bogert, Healy and Tukey, Proc. Symp. Time Series Analysis, 1963). No second blow that is weaker than the first
    raises a level by more than 6 dB, or lowers most of them by more: what bolts change about resonances counts up to there.
    """
    most = 20.0 * np.log10(2.0)
    clipped = np.clip(levels - np.median(levels), -most, most)
    return np.asarray((np.fft.rfft(clipped, count) * np.exp(-2j * np.pi * first_hz * delays)).real)


def _apart(values: Floats) -> Floats:
    """Mean absolute distance of levels from their median, along the lines [dB]."""
    return np.asarray(np.abs(values - np.median(values, axis=-1, keepdims=True)).mean(axis=-1))
