"""Smoothed spectra for the search: if peaks of model and measurement are many line widths apart, the cost (29) has many local minima.

FRFs at ``s = sigma + i omega`` have peaks that are sigma wider. FRFs are analytic for Re s > 0, so the measured ones follow from Poisson's
integral, and those of the model from the same reduced dynamic stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import FrfModel
from lrbc_cli.updating.search.descent import over_smoothed
from lrbc_cli.updating.statistics.priors import CALIBRATION_PRIOR, CalibrationPrior


def smoothed(
    frequency_hz: Floats, values: Complexes, width_hz: float, at_hz: Floats, covered: float = CALIBRATION_PRIOR.covered
) -> Complexes:
    """FRFs on the line ``s = 2 pi (width + i f)`` from those on the imaginary axis, by Poisson's integral.

    ``H(sigma + i omega) = 1/pi int sigma / (sigma² + (omega - nu)²) H(i nu) d nu`` for an H that is analytic and bounded in the right
    half-plane; values at negative frequencies are the conjugates. The kernel is normalised over the measured lines.

    Parameters
    ----------
    frequency_hz : (F,) float array
    values : (F, R) complex array
        NaN where not measured.
    width_hz : float
        sigma / (2 pi).
    at_hz : (m,) float array
        Frequencies of the result.
    covered : float
        Least share of the kernel on measured lines.

    Returns
    -------
    (m, R) complex array
        NaN where less of the kernel is on measured lines.
    """
    out = np.full((at_hz.size, values.shape[1]), np.nan + 0j)
    for r in range(values.shape[1]):
        good = np.isfinite(values[:, r])
        f, h = frequency_hz[good], values[good, r]
        if f.size < 2:
            continue
        # Gaps wider than the kernel are not bridged, and so reduce the share.
        step = np.diff(f)
        step = np.where(step <= width_hz, step, 0.0)
        span = 0.5 * (np.append(step, 0.0) + np.insert(step, 0, 0.0))
        direct = span * width_hz / np.pi / (width_hz**2 + (at_hz[:, None] - f) ** 2)
        mirror = span * width_hz / np.pi / (width_hz**2 + (at_hz[:, None] + f) ** 2)
        share = (direct + mirror).sum(axis=1)
        keep = share >= covered
        out[keep, r] = (direct @ h + mirror @ h.conj())[keep] / share[keep]
    return out


def smoothed_lines(frequency_hz: Floats, values: Complexes, width_hz: float, covered: float) -> tuple[Complexes, Complexes] | None:
    """Smoothed FRFs on lines with the spacing of their width, see ``smoothed``.

    Parameters
    ----------
    frequency_hz, values, width_hz, covered
        See ``smoothed``.

    Returns
    -------
    tuple or None
        (m,) complex ``s`` and (m, R) FRFs; None if fewer than half of the lines have values, as the measured ones are too far apart.
    """
    low, high = frequency_hz[0], frequency_hz[-1]
    at = np.linspace(low, high, max(int(np.ceil((high - low) / width_hz)), 2) + 1)
    found = smoothed(frequency_hz, values, width_hz, at, covered)
    keep = np.isfinite(found).any(axis=1)
    return None if keep.sum() < 0.5 * at.size else (2 * np.pi * (width_hz + 1j * at[keep]), found[keep])


def smoothed_costs(
    misfit: Misfit,
    model: Callable[[Complexes], FrfModel],
    frequency_hz: Floats,
    measured: Complexes,
    tight: Complexes | None,
    prior: CalibrationPrior = CALIBRATION_PRIOR,
) -> list[Misfit]:
    """Costs over smoothed spectra, widest first.

    Parameters
    ----------
    misfit : Misfit
        Cost over the measured spectra.
    model : callable
        From ``s`` of lines (m,) to the model there.
    frequency_hz : (F,) float array
    measured : (F, R) complex array
    tight : (F, R) complex array or None
        Measurement of the reference state, which is the prior of ``misfit``: if given, the smoothed measurement is corrected by the ratio
        of model and measurement in that state.
    prior : CalibrationPrior
        Gives ``widths`` and ``covered``.

    Returns
    -------
    list of Misfit
        Empty if the measured lines are too far apart, or both measurements have no smoothed lines in common.
    """
    found = []
    for width in (share * float(frequency_hz[-1]) for share in prior.widths):
        lines = smoothed_lines(frequency_hz, measured, width, prior.covered)
        if lines is None:
            return []
        s, target = lines
        frf = model(s)
        if tight is not None:
            known = smoothed(frequency_hz, tight, width, np.asarray(s.imag / (2 * np.pi), dtype=float), prior.covered)
            with np.errstate(divide="ignore", invalid="ignore"):
                target = target * frf.frf(misfit.prior) / known
        if not np.isfinite(target).any():
            return []
        found.append(misfit.on(frf, target))
    return found


def narrowed(wide: Sequence[Misfit], places: Mapping[str, Floats], bounds: Floats, span: Floats) -> tuple[dict[str, Floats], int]:
    """Ends of descents over smoothed spectra, widest first, as starts on the measured lines.

    Parameters
    ----------
    wide : sequence of Misfit
        See ``smoothed_costs``.
    places : mapping of str to (size,) float array
        Starts by description; the prior is added to them.
    bounds : (size, 2) float array
    span : (size, m) float array
        Unknowns ``prior + span z``.

    Returns
    -------
    dict of str to (size,) float array
        The ends by description.
    int
        Number of evaluations.
    """
    begun = {"the reference job": wide[0].prior, **places}
    ends = side_by_side(lambda theta: over_smoothed(wide, theta, bounds, span), list(begun.values()))
    led = {f"{text}, over smoothed spectra": end.theta for text, end in zip(begun, ends, strict=True)}
    return led, sum(end.evaluations for end in ends)
