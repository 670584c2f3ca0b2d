"""Choice of the lines that enter the cost: around the resonances, where noise matters least (Sec. 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers
from lrbc_cli.updating.peaks import peaks_of
from lrbc_cli.updating.robust import medians
from lrbc_cli.updating.statistics.decibels import DB, decibel

#: Share of the band that the lines should cover.
MIN_BAND = 0.9


def covers(frequency_hz: Floats, band_hz: tuple[float, float]) -> bool:
    """Whether rising lines, each of which stands for its surroundings, cover the band but for a tenth of it."""
    step = float(np.median(np.diff(frequency_hz))) if frequency_hz.size > 1 else 0.0
    return bool(frequency_hz[-1] - frequency_hz[0] + step >= MIN_BAND * (band_hz[1] - band_hz[0]))


@dataclass(frozen=True)
class Resonances:
    """Which lines belong to a resonance.

    Attributes
    ----------
    prominence_db : float
        A resonance stands out of the mean spectrum by at least this [dB]. A choice: twice the first model discrepancy.
    depth_db : float
        Lines within this of the peak belong to it [dB] ... By trial on virtual rigs.
    half_width : float
        ... as long as they are within this fraction of its frequency, or two lines, or its half-power bandwidth. By trial on virtual rigs.
    """

    prominence_db: float = 2.0
    depth_db: float = 15.0
    half_width: float = 0.06


#: The default, for those who call a part alone.
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
        Sorted; all lines where no resonance stands out.
    """
    chosen = np.flatnonzero(around_resonances(frequency_hz, measured, rule))
    return chosen if chosen.size else np.arange(frequency_hz.size)


def around_resonances(frequency_hz: Floats, H: Complexes, rule: Resonances = RESONANCES) -> Bools:
    """(F,) whether a line belongs to a resonance of these (F, R) FRFs."""
    valid = np.isfinite(H) & (np.abs(H) > 0)
    level = np.where(valid, decibel(np.where(valid, H, 1.0)), np.nan)
    keep: Bools = np.zeros(frequency_hz.size, dtype=bool)
    half_power_db = 10.0 * np.log10(2.0)
    # Each response shows other resonances; the mean spectrum shows those that several share without the noise of each. A mean of
    # decibels also takes in some lines between antiresonances; with the mean power instead, fewer rigs were identified well.
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
                    # Where damping is heavy a few lines at the top of a peak tell less than there are unknowns.
                    half = filled[peak] - half_power_db <= filled[at] <= filled[peak]
                    if not (near or half):
                        break
                    keep[at] = True
                    at += direction
    return keep


def missed(frequency_hz: Floats, measured: Complexes, selected: Integers, rule: Resonances = RESONANCES) -> tuple[int, int]:
    """How many resonances of (F, R) FRFs have none of the selected lines, and how many there are."""
    near = around_resonances(frequency_hz, measured, rule)
    ends = np.flatnonzero(np.diff(near.astype(np.int8), prepend=0, append=0))
    lines = np.sort(selected)
    empty = np.searchsorted(lines, ends[::2]) == np.searchsorted(lines, ends[1::2])
    return int(empty.sum()), empty.size


def few_resonances(frequency_hz: Floats, measured: Complexes, rule: Resonances = RESONANCES, *, least: int = 3) -> int | None:
    """How many resonances stand out of (F, R) FRFs where they are fewer than the least that tell bolts from one another; else None.

    A loosened bolt moves each resonance by another amount: one or two of them have as many causes as there are bolts.
    """
    ends = np.diff(around_resonances(frequency_hz, measured, rule).astype(np.int8), prepend=0)
    count = int((ends == 1).sum())
    return count if count < least else None


@dataclass(frozen=True)
class Sharp:
    """Peaks of FRFs, those of them that fall far to both neighbouring lines, and whether responses have these at the same lines.

    Attributes
    ----------
    peaks : (p,) float array
        Frequencies, of all responses [Hz].
    sharp : (q,) float array
        Of those that fall so far [Hz].
    together : float
        How many pairs of two responses' sharp peaks stand at one line.
    chance : float
        How many stand some lines apart, in the mean over the distances: as many stand together by chance.
    """

    peaks: Floats
    sharp: Floats
    together: float
    chance: float


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """From when on lines do not resolve the peaks of FRFs, or noise makes peaks of its own: then no job is validated.

    Attributes
    ----------
    prominence_db : float
        Of what counts as a peak [dB]. A choice: twice the half-power points.
    drop_db : float
        Peaks that fall by more to both neighbouring lines are sharp [dB]. A choice, that noise and the place of the peak between two lines
        do not reach where it is resolved.
    most : float
        Share of the peaks that may be sharp. Of resonances anywhere between the lines a quarter are where these lie as far apart as the
        half-power points, and half of them at 1.6 times that.
    noisy : float
        Share of the peaks that may be sharp where each response has them at other lines. Of noise alone a third are: from here on half of
        the peaks are noise's.
    aside : tuple of int
        Distances in lines at which pairs of sharp peaks stand together by chance. A choice: near enough that peaks are as many there.
    together : float
        Sharp peaks of resonances stand together this many times as often as by chance. A choice: half of what stands together is chance's.
    """

    prominence_db: float = 6.0
    drop_db: float = 6.0
    most: float = 1 / 3
    noisy: float = 1 / 6
    aside: tuple[int, ...] = (2, 3, 4, 5, 6, 7, 8)
    together: float = 2.0


#: The default, for those who call a part alone.
RESOLUTION = Resolution()


def unresolved(frequency_hz: Floats, measured: Complexes, rule: Resolution = RESOLUTION) -> Sharp:
    """Peaks of FRFs, and those that fall far to both neighbouring lines.

    At the half-power points a resonance lies 3 dB below its peak: where lines are no further apart than those, one of the two lines beside
    a peak lies within that.

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
    return Sharp(frequency_hz[np.nonzero(peaks)[0]], frequency_hz[np.nonzero(sharp)[0]], pairs(0), chance)


@dataclass(frozen=True, kw_only=True)
class Unclear:
    """Why peaks of FRFs say little: hum, lines that lie too far apart, or noise.

    Attributes
    ----------
    cause : str
        In words, the same for all jobs that have it.
    fall, where, fix : str
        How many of the peaks say little, where these are, and what to do.
    """

    cause: str
    fall: str
    where: str
    fix: str

    @property
    def text(self) -> str:
        """What to say of it."""
        return f"{self.cause}: {self.fall}{self.where}; {self.fix}"


def too_wide(*measured: tuple[Floats, Complexes], rule: Resolution = RESOLUTION) -> Unclear | None:
    """Lines that do not resolve the peaks of FRFs, or noise that makes peaks of its own; None where neither is so.

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
        return Unclear(cause=f"{hum}, it seems", fall=fall, where=", most of them at its multiples", fix=fix)
    if not noise:
        return Unclear(cause="lines too far apart", fall=fall, where="", fix="measure with closer lines")
    where, cut = _where(np.sort(np.concatenate([axis for axis, _ in measured])), peaks, sharp, rule.noisy)
    where = f", each response has them at other lines{where}"
    return Unclear(cause="noise, it seems", fall=fall, where=where, fix=f"{cut}measure with more averages, a harder tip or a stronger blow")


def resolved(frequency_hz: Floats, measured: Complexes, rule: Resolution = RESOLUTION) -> bool:
    """Whether lines resolve the peaks of (F, R) FRFs, whatever peaks noise makes."""
    found = unresolved(frequency_hz, measured, rule)
    return bool(found.sharp.size <= rule.most * found.peaks.size or _of_noise([found], rule))


def _of_noise(found: Sequence[Sharp], rule: Resolution) -> bool:
    """Whether sharp peaks are noise's: resonances show in several responses at the same line, noise there as often as at others."""
    # Where chance alone would hardly bring two together, that none are together says nothing.
    chance = sum(each.chance for each in found)
    return chance >= 1.0 and sum(each.together for each in found) < rule.together * chance


def _hum(sharp: Floats, *axes: Floats, most: float = 0.5, chance: float = 0.1) -> str:
    """Mains hum, in words, where most sharp peaks stand at multiples of 50 or 60 Hz; empty where few do, or many lines are there."""
    for mains in (50.0, 60.0):

        def near(hz: Floats, step: float, mains: float = mains) -> float:
            return float((np.abs((hz + 0.5 * mains) % mains - 0.5 * mains) <= 0.5 * step).mean()) if hz.size else 0.0

        step = max(float(np.median(np.diff(axis))) for axis in axes if axis.size > 1)
        if near(sharp, step) > most and near(np.concatenate(axes), step) < chance:
            return f"mains hum of {mains:g} Hz"
    return ""


def interpolated(measured: Complexes, *, most: int = 16, least: int = 8, straight: float = 0.05) -> str | None:
    """What to say of FRFs most lines of which lie on straight lines between those that were measured; None where all were.

    Straight lines bend at the measured lines only. Whatever was measured, smooth or noisy, bends at one line as much as at another.

    Parameters
    ----------
    measured : (F, R) complex array
        On evenly spaced lines; NaN where a response was not measured.
    most : int
        Lines for a measured one that are looked for.
    least : int
        Bends at measured lines that are needed to tell.
    straight : float
        How much less nearly all others bend than nearly all of these; rounding to few digits leaves them so much.
    """
    known = measured[:, np.isfinite(measured).all(axis=0)]
    bend = (np.abs(np.diff(known, n=2, axis=0)) / np.maximum(np.abs(known).mean(axis=0), np.finfo(float).tiny)).sum(axis=1)
    for every in range(2, min(most, bend.size // least) + 1):
        for first in range(every):
            at = np.arange(bend.size) % every == first
            if np.quantile(bend[~at], 0.9) < straight * np.quantile(bend[at], 0.25):
                return (
                    f"one of {every} lines was measured, it seems, the others are interpolated between them: peaks are cut off, and more "
                    "lines count than were measured; export the lines as they were measured"
                )
    return None


def few_digits(measured: Complexes, *, least_db: float = 0.3, whole: float = 1e-3, least: int = 20, several: int = 4) -> dict[int, float]:
    """Responses whose real and imaginary parts were written with so few digits that it shows, and their error by that [dB].

    Parameters
    ----------
    measured : (F, R) complex array
    least_db : float
        Less shows in no verdict: a tenth of what a measuring chain is calibrated to, squared and added, is nothing.
    whole : float
        Parts that lie this near to whole multiples of the smallest were rounded to it.
    least : int
        Number of parts that tell.
    several : int
        Different multiples that tell: a constant is none that was rounded.
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
        # Rounding errors are equal between both neighbours.
        error = DB * float(parts.min()) / np.sqrt(12.0) / float(np.median(np.abs(known)) or parts.min())
        if error > least_db:
            found[r] = float(error)
    return found


def line_noise(measured: Complexes, *, least: int = 20) -> float:
    """Noise of single lines over their size, in the median over lines and responses; NaN where there are too few.

    What a cubic through the two lines on each side lacks: between resonances FRFs are smooth. Peaks between two lines are few.

    Parameters
    ----------
    measured : (F, R) complex array
        On evenly spaced lines; NaN where a response was not measured.
    least : int
        Lines of a response.
    """
    share = noise_shares(measured)
    enough = np.isfinite(share).sum(axis=0) >= least
    return float(np.median(np.nanmedian(share[:, enough], axis=0))) if enough.any() else float("nan")


def neighbour_sigma(measured: Complexes, window: int) -> Floats:
    """Standard deviation of measured magnitudes by what single lines scatter about their neighbours [dB], where nothing else tells it.

    The median over a window: single peaks and antiresonances do not count. On virtual rigs whose coherence is known both agree within a
    factor of two from 0.05 to 4 dB. Where lines do not resolve the peaks, it is too much.

    Parameters
    ----------
    measured : (F, R) complex array
        On evenly spaced lines, four more than the window at least; NaN where a response was not measured.
    window : int
        Lines, an odd number.

    Returns
    -------
    (F, R) float array
        NaN where a response was not measured on any line about one.
    """
    around = medians(np.lib.stride_tricks.sliding_window_view(noise_shares(measured), window, axis=0))[..., 0]
    # Real and imaginary parts have half the variance each; along the magnitude there is one of them.
    return np.asarray(DB / np.sqrt(2.0) * np.pad(around, ((2 + window // 2,) * 2, (0, 0)), mode="edge"))


def noise_shares(measured: Complexes) -> Floats:
    """(F - 4, R) by what lines differ from a cubic through the two on each side, over their size; 1 in the median if all is noise."""
    with np.errstate(divide="ignore", invalid="ignore"):
        middle = (4.0 * (measured[1:-3] + measured[3:-1]) - measured[:-4] - measured[4:]) / 6.0
        share = np.abs(measured[2:-2] - middle) / np.abs(measured[2:-2])
    # The squares of the weights, and the median of the size of a Gaussian complex number over its standard deviation.
    of_one = np.sqrt((1.0 + 34.0 / 36.0) * np.log(2.0))
    return np.where(np.isfinite(share), share / of_one, np.nan)


def normalised(measured: Complexes, *, least: int = 3, same: float = 1e-3) -> float:
    """Largest magnitude of every response, where it is the same of all; 0 where it is not, or of too few responses to be no chance.

    Parameters
    ----------
    measured : (F, R) complex array
    least : int
        Responses.
    same : float
        Share by which the largest magnitudes may differ: what four digits leave.
    """
    tops = np.nanmax(np.abs(measured[:, np.isfinite(measured).any(axis=0)]), axis=0, initial=0.0)
    alike = tops.size >= least and np.ptp(tops) <= same * tops.max()
    return float(np.median(tops)) if alike else 0.0


def phaseless(measured: Complexes, rule: Resolution = RESOLUTION) -> list[int]:
    """Responses with peaks whose values are all above zero: magnitudes, whose phases are lost.

    An FRF without damping is real, and changes its sign at each resonance.

    Parameters
    ----------
    measured : (F, R) complex array
    rule : Resolution
        What counts as a peak.
    """
    found = []
    for r, response in enumerate(measured.T):
        known = response[np.isfinite(response) & (response != 0)]
        if known.size and np.all(known.imag == 0.0) and np.all(known.real > 0.0):
            found += [r] if peaks_of(decibel(known), prominence=rule.prominence_db).size else []
    return found


def _where(axis: Floats, peaks: Floats, sharp: Floats, noisy: float) -> tuple[str, str]:
    """Where in the band noise lies, and what to do, in clauses; empty where it lies all along it. All frequencies are sorted."""
    lines, count = np.searchsorted(axis, sharp) / axis.size, np.arange(sharp.size)
    # The edge that parts few and many such peaks is where their share of all runs farthest from that of the lines.
    above, below = lines - count / sharp.size, (count + 1) / sharp.size - lines
    upward = above.max() > below.max()
    edge = float(sharp[np.argmax(above) if upward else np.argmax(below)])
    inside, rest = (sharp >= edge, peaks < edge) if upward else (sharp <= edge, peaks > edge)
    others = int((~inside).sum())
    # Half as many of the peaks elsewhere, or all along the band.
    if not rest.any() or 2 * others * (peaks.size - rest.sum()) > rest.sum() * inside.sum():
        return "", ""
    where = f", {inside.sum()} of them {'from' if upward else 'up to'} {edge:.4g} Hz"
    return where, f"let reduction.band {'end' if upward else 'begin'} there, or " if others <= noisy * rest.sum() else ""
