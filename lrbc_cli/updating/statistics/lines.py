"""Choice of the lines that are compared, around the resonances (Sec. 3 of the paper), and faults of FRFs that show in their lines.

The faults are lines that do not resolve the peaks, noise, mains hum, interpolated lines, few digits, normalised or phaseless FRFs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers
from lrbc_cli.updating.checked import Checked, Count, Positive, Share
from lrbc_cli.updating.peaks import peaks_of
from lrbc_cli.updating.robust import medians
from lrbc_cli.updating.statistics.decibels import DB, decibel

#: Least share of the band that the lines should cover.
MIN_BAND = 0.9


def covers(frequency_hz: Floats, band_hz: tuple[float, float]) -> bool:
    """Whether ascending lines (F,) span at least ``MIN_BAND`` of the band; half a step is added at either end."""
    step = float(np.median(np.diff(frequency_hz))) if frequency_hz.size > 1 else 0.0
    return bool(frequency_hz[-1] - frequency_hz[0] + step >= MIN_BAND * (band_hz[1] - band_hz[0]))


@dataclass(frozen=True, kw_only=True)
class Resonances(Checked):
    """Which lines belong to a resonance.

    Attributes
    ----------
    prominence_db : float
        Least prominence of a resonance in the mean spectrum [dB]. A choice: twice the first model discrepancy.
    depth_db : float
        Lines within this level of the peak belong to it [dB] ... By trial on virtual rigs.
    half_width : float
        ... if they are within this fraction of its frequency, two lines, or its half-power bandwidth. By trial on virtual rigs.
    followed : float
        Lines of a resonance are not compared if linear interpolation between others gives each FRF within this fraction of its largest
        magnitude there, at lower peaks of theirs (``thinning.thinned``). 0.1 leaves three lines in a half-power bandwidth.
    least_lines : int
        ... and this number of lines is left. A choice.
    """

    prominence_db: Positive = 2.0
    depth_db: Positive = 15.0
    half_width: Positive = 0.06
    followed: Share = 0.1
    least_lines: Count = 5


#: The default, for callers that use a part of the package by itself.
RESONANCES = Resonances()


def resonance_lines(frequency_hz: Floats, measured: Complexes, rule: Resonances = RESONANCES) -> Integers:
    """Indices of the lines around the resonances of FRFs.

    Parameters
    ----------
    frequency_hz : (F,) float array
    measured : (F, R) complex array
        NaN where a response was not measured.
    rule : Resonances

    Returns
    -------
    (m,) int array
        Sorted; all lines if there is no resonance.
    """
    chosen = np.flatnonzero(around_resonances(frequency_hz, measured, rule))
    return chosen if chosen.size else np.arange(frequency_hz.size)


def around_resonances(frequency_hz: Floats, H: Complexes, rule: Resonances = RESONANCES) -> Bools:
    """(F,) whether a line belongs to a resonance of the FRFs H (F, R); the peaks are those of the mean of their levels."""
    valid = np.isfinite(H) & (np.abs(H) > 0)
    level = np.where(valid, decibel(np.where(valid, H, 1.0)), np.nan)
    keep: Bools = np.zeros(frequency_hz.size, dtype=bool)
    half_power_db = 10.0 * np.log10(2.0)
    # The mean spectrum shows the resonances of all responses with less noise than each. A mean of decibels also selects some lines
    # between antiresonances; with the mean power instead, fewer rigs were identified well.
    spectra = [level[:, r] for r in range(level.shape[1]) if valid[:, r].any()]
    if len(spectra) > 1:
        centred = np.stack([spectrum - np.nanmean(spectrum) for spectrum in spectra])
        spectra = [
            np.where(
                np.isfinite(centred).any(axis=0), np.nansum(centred, axis=0) / np.maximum(np.isfinite(centred).sum(axis=0), 1), -np.inf
            )
        ]
    for spectrum in spectra:
        filled = np.where(np.isfinite(spectrum), spectrum, np.nanmin(spectrum[np.isfinite(spectrum)]))
        peaks = peaks_of(filled, prominence=rule.prominence_db)
        for peak in peaks:
            for direction in (-1, 1):
                at = peak
                while 0 <= at < filled.size and filled[at] > filled[peak] - rule.depth_db:
                    near = abs(frequency_hz[at] - frequency_hz[peak]) <= rule.half_width * frequency_hz[peak] or abs(at - peak) <= 2
                    # With heavy damping the few lines at the top of a peak would be fewer data than unknowns.
                    half = filled[peak] - half_power_db <= filled[at] <= filled[peak]
                    if not (near or half):
                        break
                    keep[at] = True
                    at += direction
    return keep


def missed(frequency_hz: Floats, measured: Complexes, selected: Integers, rule: Resonances = RESONANCES) -> tuple[int, int]:
    """Number of resonances of FRFs (F, R) without any of the selected lines, and number of all resonances."""
    near = around_resonances(frequency_hz, measured, rule)
    ends = np.flatnonzero(np.diff(near.astype(np.int8), prepend=0, append=0))
    lines = np.sort(selected)
    empty = np.searchsorted(lines, ends[::2]) == np.searchsorted(lines, ends[1::2])
    return int(empty.sum()), empty.size


def few_resonances(frequency_hz: Floats, measured: Complexes, rule: Resonances = RESONANCES, *, least: int = 3) -> int | None:
    """Number of resonances of FRFs (F, R) if it is below ``least``, too few to distinguish bolts; else None.

    A loosened bolt is recognised by how far it shifts each resonance; the shifts of one or two can be caused by any bolt.
    """
    ends = np.diff(around_resonances(frequency_hz, measured, rule).astype(np.int8), prepend=0)
    count = int((ends == 1).sum())
    return count if count < least else None


@dataclass(frozen=True, kw_only=True)
class Sharp:
    """Peaks of FRFs, the sharp ones among them (which fall far to both neighbouring lines), and whether responses share these.

    Attributes
    ----------
    peaks : (p,) float array
        Frequencies of the peaks of all responses [Hz].
    sharp : (q,) float array
        Frequencies of the sharp peaks [Hz].
    together : float
        Number of pairs of sharp peaks of two responses at the same line.
    chance : float
        Mean number of such pairs at several distances of some lines: as many are at the same line by chance.
    """

    peaks: Floats
    sharp: Floats
    together: float
    chance: float


@dataclass(frozen=True, kw_only=True)
class Resolution(Checked):
    """Limits from which lines are interpolated or do not resolve the peaks of FRFs, or peaks are noise; a job is then not validated.

    Attributes
    ----------
    prominence_db : float
        Least prominence of a peak [dB]. A choice: twice the half-power points.
    drop_db : float
        A peak that falls by more to both neighbouring lines is sharp [dB]. A choice: resolved peaks do not fall as far, by noise or by
        their position between two lines.
    most : float
        Largest share of sharp peaks. Of resonances anywhere between the lines a quarter are sharp if the lines are as far apart as the
        half-power points, and half of them at 1.6 times that.
    noisy : float
        Largest share of sharp peaks if each response has them at other lines. Of noise alone a third of the peaks are sharp, so at this
        share half of the peaks are noise.
    aside : tuple of int
        Distances in lines at which pairs of sharp peaks are counted as chance. A choice: near enough for the same density of peaks.
    together : float
        Sharp peaks of resonances coincide at least this many times as often as by chance. A choice: half of the coincidences are by chance.
    interpolated, measured : int
        Largest spacing of measured lines for which interpolated ones are looked for [lines], and least number of them. Choices.
    straight : float
        Largest ratio of second differences between measured lines to those at them; rounding to few digits leaves as much.
    """

    prominence_db: Positive = 6.0
    drop_db: Positive = 6.0
    most: Share = 1 / 3
    noisy: Share = 1 / 6
    aside: tuple[Count, ...] = (2, 3, 4, 5, 6, 7, 8)
    together: Positive = 2.0
    interpolated: Count = 16
    measured: Count = 8
    straight: Positive = 0.05


#: The default, for callers that use a part of the package by itself.
RESOLUTION = Resolution()


def unresolved(frequency_hz: Floats, measured: Complexes, rule: Resolution = RESOLUTION) -> Sharp:
    """Peaks of FRFs, and the sharp ones among them.

    A resonance is 3 dB below its peak at the half-power points. If lines are no further apart than these, one of the two lines beside a
    peak is within 3 dB of it.

    Parameters
    ----------
    frequency_hz : (F,) float array
    measured : (F, R) complex array
        NaN where a response was not measured.
    rule : Resolution
    """
    peaks, sharp = np.zeros((2, *measured.shape), dtype=bool)
    for r, response in enumerate(measured.T):
        at = np.flatnonzero(np.isfinite(response) & (np.abs(response) > 0))
        if at.size < 3:
            continue
        level = decibel(response[at])
        tops = peaks_of(level, prominence=rule.prominence_db)
        peaks[at[tops], r] = True
        sharp[at[tops], r] = level[tops] - np.maximum(level[tops - 1], level[tops + 1]) > rule.drop_db

    def pairs(distance: int) -> float:
        one, other = sharp[distance:].astype(float), sharp[: len(sharp) - distance].astype(float)
        return float((one.sum(axis=1) * other.sum(axis=1) - (one * other).sum(axis=1)).sum())

    chance = float(np.mean([pairs(d) for d in rule.aside if d < len(sharp)] or [0.0]))
    return Sharp(peaks=frequency_hz[np.nonzero(peaks)[0]], sharp=frequency_hz[np.nonzero(sharp)[0]], together=pairs(0), chance=chance)


@dataclass(frozen=True, kw_only=True)
class Unclear:
    """Why the peaks of FRFs are unreliable (mains hum, lines too far apart, or noise), as parts of a message.

    Attributes
    ----------
    cause : str
        The same words for all jobs with this cause.
    fall, where, fix : str
        How many peaks are sharp, where they are, and what to do.
    noise : bool
        Whether the cause is noise.
    """

    cause: str
    fall: str
    where: str
    fix: str
    noise: bool = False

    @property
    def text(self) -> str:
        """The whole message."""
        return f"{self.cause}: {self.fall}{self.where}; {self.fix}"


def too_wide(*measured: tuple[Floats, Complexes], rule: Resolution = RESOLUTION) -> Unclear | None:
    """Message on lines that do not resolve the peaks of FRFs, or on peaks of noise or mains hum; None if there is nothing to report.

    Parameters
    ----------
    measured : pairs of an (F,) float array and an (F, R) complex array
        Frequencies and FRFs of one job, or of those that are compared.
    rule : Resolution
    """
    found = [unresolved(*each, rule) for each in measured]
    peaks, sharp = (np.sort(np.concatenate([getattr(each, name) for each in found])) for name in ("peaks", "sharp"))
    noise = _of_noise(found, rule)
    if sharp.size <= (rule.noisy if noise else rule.most) * peaks.size:
        return None
    fall = f"{sharp.size} of {peaks.size} peaks fall by more than {rule.drop_db:g} dB to both neighbouring lines"
    if hum := _hum(sharp, *(axis for axis, _ in measured)):
        fix = "earth the whole chain at one point, or feed it from batteries"
        return Unclear(cause=f"probably {hum}", fall=fall, where=", most of them at its multiples", fix=fix)
    if not noise:
        return Unclear(cause="lines too far apart", fall=fall, where="", fix="measure with closer lines")
    where, cut = _where(np.sort(np.concatenate([axis for axis, _ in measured])), peaks, sharp, rule.noisy)
    where, fix = f", each response has them at other lines{where}", f"{cut}measure with more averages, a harder tip or a stronger blow"
    return Unclear(cause="probably noise", fall=fall, where=where, fix=fix, noise=True)


def resolved(frequency_hz: Floats, measured: Complexes, rule: Resolution = RESOLUTION) -> bool:
    """Whether lines resolve the peaks of FRFs (F, R); sharp peaks of noise do not count against it."""
    found = unresolved(frequency_hz, measured, rule)
    return bool(found.sharp.size <= rule.most * found.peaks.size or _of_noise([found], rule))


def _of_noise(found: Sequence[Sharp], rule: Resolution) -> bool:
    """Whether sharp peaks are caused by noise: those of resonances coincide in several responses, those of noise only by chance."""
    # If fewer than one coincidence is expected by chance, their absence is no evidence.
    chance = sum(each.chance for each in found)
    return chance >= 1.0 and sum(each.together for each in found) < rule.together * chance


def _hum(sharp: Floats, *axes: Floats, most: float = 0.5, chance: float = 0.1) -> str:
    """Mains hum, in words, if most sharp peaks are at multiples of 50 or 60 Hz; empty otherwise, or if many of the lines are there."""
    for mains in (50.0, 60.0):

        def near(hz: Floats, step: float, mains: float = mains) -> float:
            return float((np.abs((hz + 0.5 * mains) % mains - 0.5 * mains) <= 0.5 * step).mean()) if hz.size else 0.0

        step = max(float(np.median(np.diff(axis))) for axis in axes if axis.size > 1)
        if near(sharp, step) > most and near(np.concatenate(axes), step) < chance:
            return f"mains hum of {mains:g} Hz"
    return ""


def interpolated(measured: Complexes, rule: Resolution = RESOLUTION) -> str | None:
    """Message on FRFs with lines that were interpolated linearly between the measured ones; None if all were measured.

    Interpolated FRFs have second differences at the measured lines only; measured ones, smooth or noisy, have them at all lines alike.

    Parameters
    ----------
    measured : (F, R) complex array
        On evenly spaced lines; NaN where a response was not measured.
    rule : Resolution
    """
    known = measured[:, np.isfinite(measured).all(axis=0)]
    bend = (np.abs(np.diff(known, n=2, axis=0)) / np.maximum(np.abs(known).mean(axis=0), np.finfo(float).tiny)).sum(axis=1)
    for every in range(2, min(rule.interpolated, bend.size // rule.measured) + 1):
        for first in range(every):
            at = np.arange(bend.size) % every == first
            if np.quantile(bend[~at], 0.9) < rule.straight * np.quantile(bend[at], 0.25):
                return (
                    f"probably only one of {every} lines was measured and the others are interpolated: peaks are cut off, and more lines "
                    "count than were measured. Export the lines as they were measured"
                )
    return None


def few_digits(measured: Complexes, *, least_db: float = 0.3, whole: float = 1e-3, least: int = 20, several: int = 4) -> dict[int, float]:
    """Responses whose real and imaginary parts were written with too few digits, and their rounding error [dB].

    Parameters
    ----------
    measured : (F, R) complex array
    least_db : float
        Smaller errors affect no verdict [dB]: squared and added to the calibration error of a measuring chain they are negligible.
    whole : float
        Parts count as rounded if all are this near to integer multiples of the smallest one.
    least : int
        Least number of parts.
    several : int
        Least number of different multiples: a constant was not rounded.
    """
    found: dict[int, float] = {}
    for r, response in enumerate(measured.T):
        known = response[np.isfinite(response)]
        parts = np.abs(np.concatenate([known.real, known.imag]))
        parts = parts[parts > 0.0]
        if parts.size < least:
            continue
        times = np.round(parts / parts.min())
        if np.abs(parts / parts.min() - times).max() > whole or np.unique(times).size < several:
            continue
        # Rounding errors are uniformly distributed: standard deviation of one step over sqrt(12).
        error = DB * float(parts.min()) / np.sqrt(12.0) / float(np.median(np.abs(known)) or parts.min())
        if error > least_db:
            found[r] = float(error)
    return found


def line_noise(measured: Complexes, *, least: int = 20) -> float:
    """Noise of single lines over their magnitude, median over lines and responses; NaN if there are too few lines.

    The noise is the difference of a line from a cubic through the two lines on either side: except at few peaks, FRFs are smooth.

    Parameters
    ----------
    measured : (F, R) complex array
        On evenly spaced lines; NaN where a response was not measured.
    least : int
        Least number of lines of a response.
    """
    share = noise_shares(measured)
    enough = np.isfinite(share).sum(axis=0) >= least
    return float(np.median(np.nanmedian(share[:, enough], axis=0))) if enough.any() else float("nan")


def neighbour_sigma(measured: Complexes, window: int) -> Floats:
    """Standard deviation of measured magnitudes from the scatter of lines about their neighbours [dB], if no coherence is known.

    The median over a window excludes single peaks and antiresonances. On virtual rigs it agrees with the coherence within a factor of two
    from 0.05 to 4 dB. It is too large if the lines do not resolve the peaks.

    Parameters
    ----------
    measured : (F, R) complex array
        On at least ``window + 4`` evenly spaced lines; NaN where a response was not measured.
    window : int
        Number of lines, odd.

    Returns
    -------
    (F, R) float array
        NaN where a response has no value in the window.
    """
    around = medians(np.lib.stride_tricks.sliding_window_view(noise_shares(measured), window, axis=0))[..., 0]
    # Of the complex noise half of the variance is along the magnitude.
    return np.asarray(DB / np.sqrt(2.0) * np.pad(around, ((2 + window // 2,) * 2, (0, 0)), mode="edge"))


def noise_shares(measured: Complexes) -> Floats:
    """(F - 4, R) difference of lines from a cubic through the two on either side, over their magnitude; median 1 for pure noise."""
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = (4.0 * (measured[1:-3] + measured[3:-1]) - measured[:-4] - measured[4:]) / 6.0
        share = np.abs(measured[2:-2] - middle) / np.abs(measured[2:-2])
    # Sum of the squares of the weights, and median magnitude of a complex Gaussian variable over its standard deviation.
    of_one = np.sqrt((1.0 + 34.0 / 36.0) * np.log(2.0))
    return np.where(np.isfinite(share), share / of_one, np.nan)


def normalised(measured: Complexes, *, least: int = 3, same: float = 1e-3) -> float:
    """Largest magnitude of every response if it is the same in all of them, so that FRFs were normalised; else 0.

    Parameters
    ----------
    measured : (F, R) complex array
    least : int
        Least number of responses, so that it is no coincidence.
    same : float
        Relative difference that the largest magnitudes may have: the rounding of four digits.
    """
    tops = np.nanmax(np.abs(measured[:, np.isfinite(measured).any(axis=0)]), axis=0, initial=0.0)
    alike = tops.size >= least and np.ptp(tops) <= same * tops.max()
    return float(np.median(tops)) if alike else 0.0


def phaseless(measured: Complexes, rule: Resolution = RESOLUTION) -> list[int]:
    """Indices of responses with peaks whose values are all real and positive, magnitudes without phase, or real unlike those of others.

    An FRF without damping is real, too, but changes its sign at each resonance; all responses are real then.
    """
    found, damped = [], bool((np.isfinite(measured) & (measured.imag != 0.0)).any())
    for r, response in enumerate(measured.T):
        known = response[np.isfinite(response) & (response != 0)]
        if known.size and np.all(known.imag == 0.0) and (damped or np.all(known.real > 0.0)):
            found += [r] if peaks_of(decibel(known), prominence=rule.prominence_db).size else []
    return found


def _where(axis: Floats, peaks: Floats, sharp: Floats, noisy: float) -> tuple[str, str]:
    """Part of the band with noise, and what to do, as clauses of a message; empty if noise is everywhere. All frequencies are sorted."""
    lines, count = np.searchsorted(axis, sharp) / axis.size, np.arange(sharp.size)
    # The edge between few and many sharp peaks is where their cumulative share is furthest from that of the lines.
    above, below = lines - count / sharp.size, (count + 1) / sharp.size - lines
    upward = above.max() > below.max()
    edge = float(sharp[np.argmax(above) if upward else np.argmax(below)])
    inside, rest = (sharp >= edge, peaks < edge) if upward else (sharp <= edge, peaks > edge)
    others = int((~inside).sum())
    # Noise everywhere: outside the part the share of sharp peaks is more than half of that inside.
    if not rest.any() or 2 * others * (peaks.size - rest.sum()) > rest.sum() * inside.sum():
        return "", ""
    where = f", {inside.sum()} of them {'from' if upward else 'up to'} {edge:.4g} Hz"
    return where, f"let reduction.band {'end' if upward else 'begin'} there, or " if others <= noisy * rest.sum() else ""
