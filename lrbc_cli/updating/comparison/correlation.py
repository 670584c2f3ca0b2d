"""Correlation of measured and computed FRFs by the figures of experimental modal analysis: FRAC, FDAC and shifts of matched peaks.

For reports only; no verdict rests on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers
from lrbc_cli.updating.peaks import peaks_of

#: Least prominence of a peak [dB]; below it peaks are noise as often as resonances.
PROMINENCE_DB = 3.0

#: Largest relative distance of two peaks that may be the same resonance.
TOLERANCE = 0.05

#: Least |FDAC| of the values at two peaks that may be the same resonance, if there are several responses.
SIMILARITY = 0.5


def measured_values(H: Complexes) -> Bools:
    """Mask of measured values: finite and not zero."""
    return np.isfinite(H) & (np.abs(H) > 0)


def frac(measured: Complexes, model: Complexes) -> Floats:
    """(R,) frequency response assurance criterion of each response.

    ``|sum conj(Hm) Ha|² / (sum |Hm|² sum |Ha|²)`` over the lines where both have values (Heylen and Lammens, *FRAC: a consistent way of
    comparing frequency response functions*, Swansea, 1996): 1 if the two differ by a complex factor only, else less. Lines count by their
    magnitude, so the highest peaks dominate, and a shift by one peak width makes it small.

    Parameters
    ----------
    measured, model : (F, R) complex arrays
        NaN where there is no value.

    Returns
    -------
    (R,) float array
        In [0, 1]; NaN without a common line.
    """
    both = measured_values(measured) & np.isfinite(model)
    a, b = _normalised(np.where(both, measured, 0.0), 0), _normalised(np.where(both, model, 0.0), 0)
    product = np.abs(np.sum(a.conj() * b, axis=0)) ** 2
    known = np.asarray(np.any(a != 0.0, axis=0) & np.any(b != 0.0, axis=0))
    return np.where(known, np.minimum(product, 1.0), np.nan)


def _normalised(H: Complexes, axis: int) -> Complexes:
    """Columns or rows scaled to norm 1 without overflow or underflow of their squares; zeros stay."""
    largest = np.max(np.abs(H), axis=axis, keepdims=True)
    scaled = H / np.where(largest > 0.0, largest, 1.0)
    norm = np.linalg.norm(scaled, axis=axis, keepdims=True)
    return np.asarray(scaled / np.where(norm > 0.0, norm, 1.0))


def fdac(measured: Complexes, model: Complexes, weights: Floats | None = None) -> Floats:
    """(F, G) frequency domain assurance criterion of every measured line with every line of the model.

    ``Re(Hm(f)ᴴ Ha(g)) / (|Hm(f)| |Ha(g)|)`` with the vectors of all responses: the cosine between two operating shapes, like the modal
    assurance criterion for mode shapes (Pascual, Golinval and Razeto, *A frequency domain correlation technique for model correlation and
    updating*, IMAC XV, 1997). The real part keeps the sign, so that a shape in opposite phase gives -1, which the square would hide. If
    model and measurement agree, the diagonal is 1; a ridge beside the diagonal is a shift in frequency.

    Parameters
    ----------
    measured : (F, R) complex array
        NaN where a response was not measured.
    model : (G, R) complex array
    weights : (R,) float array or None
        Factors that bring responses of different quantities to the same scale.

    Returns
    -------
    (F, G) float array
        In [-1, 1]; NaN at lines with fewer than two responses, where there is no shape to compare.
    """
    valid = measured_values(measured)
    scale = np.ones(measured.shape[1]) if weights is None else weights
    whole = np.asarray(np.isfinite(model).all(axis=1))
    a = _normalised(np.where(valid, measured * scale, 0.0), 1)
    b = _normalised(np.where(whole[:, None], model * scale, 0.0), 1)
    # Responses missing at a line are left out of the model's vector, too.
    size = np.sqrt(valid.astype(float) @ (np.abs(b) ** 2).T)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = (a.conj() @ b.T).real / size
    cosine[(valid.sum(axis=1) < 2)[:, None] | (size <= 1e-12) | ~whole[None, :]] = np.nan
    return np.asarray(np.clip(cosine, -1.0, 1.0))


def quantity_weights(measured: Complexes, quantities: tuple[str, ...]) -> Floats:
    """(R,) factors 1 / RMS of each physical quantity, so that pressures and accelerations count alike; all 1 for a single quantity."""
    weights = np.ones(len(quantities))
    if len(set(quantities)) > 1:
        size = np.abs(np.where(measured_values(measured), measured, np.nan))
        for quantity in set(quantities):
            chosen = np.array([entry == quantity for entry in quantities])
            known = size[:, chosen][np.isfinite(size[:, chosen])]
            weights[chosen] = 1.0 / float(np.sqrt(np.mean(known**2))) if known.size else 1.0
    return weights


@dataclass(frozen=True)
class Peaks:
    """Peaks of a spectrum.

    Attributes
    ----------
    frequency_hz : (k,) float array
        Interpolated between lines by a parabola through the highest line and its neighbours.
    line : (k,) int array
        Index of the highest line of each peak.
    """

    frequency_hz: Floats
    line: Integers


def spectrum_peaks(frequency_hz: Floats, level_db: Floats) -> Peaks:
    """Peaks of one spectrum in dB; a peak beside a line without a value does not count.

    Parameters
    ----------
    frequency_hz : (F,) float array
    level_db : (F,) float array
        NaN where there is no value.
    """
    known = np.flatnonzero(np.isfinite(level_db))
    level, f = level_db[known], frequency_hz[known]
    at = peaks_of(level, prominence=PROMINENCE_DB)
    # Both neighbouring lines must have values.
    at = at[(known[at + 1] - known[at - 1]) == 2]
    refined = np.array([_vertex(f[i - 1 : i + 2], level[i - 1 : i + 2]) for i in at])
    return Peaks(refined.reshape(-1), known[at].astype(np.int64))


def _vertex(x: Floats, y: Floats) -> float:
    """Abscissa of the maximum of the parabola through three points, of which the middle one is the highest."""
    left, right = x[0] - x[1], x[2] - x[1]
    below, above = (y[0] - y[1]) / left, (y[2] - y[1]) / right
    curvature = (above - below) / (right - left)
    if curvature >= 0.0:
        return float(x[1])
    slope = above - curvature * right
    return float(x[1] + np.clip(-slope / (2.0 * curvature), left, right))


def mean_spectrum(H: Complexes, valid: Bools) -> Floats:
    """(F,) level of the mean power over the responses, each scaled to the same power [dB]; NaN at lines where one of them is missing.

    Responses without any value are left out.
    """
    some = valid.any(axis=0)
    if not some.any():
        return np.full(H.shape[0], np.nan)
    power = np.where(valid[:, some], np.abs(H[:, some]) ** 2, np.nan)
    power = power / np.nanmean(power, axis=0)
    with np.errstate(divide="ignore"):
        level = 10.0 * np.log10(power.mean(axis=1))
    return np.where(np.isfinite(level), level, np.nan)


def match_peaks(measured_hz: Floats, model_hz: Floats, similarity: Floats | None = None) -> Integers:
    """For each measured peak the peak of the model that is probably the same resonance, by an optimal assignment.

    It has as many pairs as the limits allow, and among such assignments the least sum of relative distance over ``TOLERANCE`` and 1 -
    similarity.

    Parameters
    ----------
    measured_hz : (k,) float array
    model_hz : (m,) float array
    similarity : (k, m) float array or None
        In [0, 1], of the shapes at the peaks; pairs below ``SIMILARITY`` are excluded, NaN counts as 1.

    Returns
    -------
    (k,) int array
        Index into ``model_hz``; -1 without a match.
    """
    found = np.full(measured_hz.size, -1, dtype=np.int64)
    if not measured_hz.size or not model_hz.size:
        return found
    distance = np.abs(model_hz[None, :] - measured_hz[:, None]) / (TOLERANCE * measured_hz[:, None])
    alike = np.ones_like(distance) if similarity is None else np.where(np.isnan(similarity), 1.0, similarity)
    allowed = (distance <= 1.0) & (alike >= SIMILARITY)
    # An allowed pair costs at most 1.5; an excluded one more than all allowed pairs together.
    cost = np.where(allowed, distance + 1.0 - alike, 2.0 * (min(distance.shape) + 1))
    # Imported here: most commands do not need it.
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(cost)
    kept = allowed[rows, columns]
    found[rows[kept]] = columns[kept]
    return found


@dataclass(frozen=True)
class PeakTable:
    """Measured peaks and the matching peaks of the model before (initial) and after (final) the updating.

    Attributes
    ----------
    measured_hz, initial_hz, final_hz : (k,) float arrays
        NaN where the model has no matching peak.
    """

    measured_hz: Floats
    initial_hz: Floats
    final_hz: Floats

    def shifts_percent(self) -> tuple[float, float]:
        """Mean absolute shift before and after, of the peaks that are matched in both cases [%]; NaN if there are none."""
        both = np.isfinite(self.initial_hz) & np.isfinite(self.final_hz)
        if not both.any():
            return float("nan"), float("nan")
        reference = self.measured_hz[both]
        before, after = (np.abs(model[both] / reference - 1.0) for model in (self.initial_hz, self.final_hz))
        return 100.0 * float(before.mean()), 100.0 * float(after.mean())


@dataclass(frozen=True, kw_only=True)
class Correlation:
    """Agreement of measured with initial and updated FRFs.

    Attributes
    ----------
    frac_initial, frac_final : (R,) float arrays
        See ``frac``.
    peaks : tuple of R PeakTable
        Peaks of each response.
    mean_peaks : PeakTable
        Peaks of the mean spectrum.
    lines : (g,) int array
        Indices of the lines of the FDAC maps.
    fdac_initial, fdac_final : (g, g) float arrays
        Rows are measured lines, columns lines of the model.
    """

    frac_initial: Floats
    frac_final: Floats
    peaks: tuple[PeakTable, ...]
    mean_peaks: PeakTable
    lines: Integers
    fdac_initial: Floats
    fdac_final: Floats


def correlate(
    frequency_hz: Floats,
    measured: Complexes,
    initial: Complexes,
    updated: Complexes,
    quantities: tuple[str, ...] | None = None,
    grid: int = 64,
) -> Correlation:
    """Compare measured with initial and updated FRFs.

    Peaks are matched by frequency and, at lines with two responses or more, by the shape.

    Parameters
    ----------
    frequency_hz : (F,) float array
    measured, initial, updated : (F, R) complex arrays
        The measured ones are NaN where there is no value.
    quantities : tuple of R str or None
        Physical quantity of each response; None if all have the same.
    grid : int
        Largest number of lines of the FDAC maps, evenly spaced.

    Returns
    -------
    Correlation
    """
    valid = measured_values(measured)
    weights = quantity_weights(measured, quantities or ("",) * measured.shape[1])

    def table(level: list[Floats]) -> PeakTable:
        own = spectrum_peaks(frequency_hz, level[0])
        columns = []
        for model, values in ((initial, level[1]), (updated, level[2])):
            other = spectrum_peaks(frequency_hz, values)
            alike = np.abs(fdac(measured[own.line], model[other.line], weights))
            which = match_peaks(own.frequency_hz, other.frequency_hz, alike)
            padded = np.append(other.frequency_hz, np.nan)
            columns.append(padded[which])
        return PeakTable(own.frequency_hz, columns[0], columns[1])

    def decibels(H: Complexes, r: int) -> Floats:
        # The model is used on the measured lines only, so that both can show the same peaks.
        with np.errstate(divide="ignore"):
            level = 20.0 * np.log10(np.abs(np.where(valid[:, r], H[:, r], 1.0)))
        return np.where(valid[:, r] & np.isfinite(level), level, np.nan)

    lines = np.unique(np.linspace(0, frequency_hz.size - 1, min(grid, frequency_hz.size)).round().astype(np.int64))
    return Correlation(
        frac_initial=frac(measured, initial),
        frac_final=frac(measured, updated),
        peaks=tuple(table([decibels(H, r) for H in (measured, initial, updated)]) for r in range(measured.shape[1])),
        mean_peaks=table([mean_spectrum(H, valid) for H in (measured, initial, updated)]),
        lines=lines,
        fdac_initial=fdac(measured[lines], initial[lines], weights),
        fdac_final=fdac(measured[lines], updated[lines], weights),
    )
