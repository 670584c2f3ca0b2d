"""Finds measurements whose frequency lines differ from those of the reference job, or from the model by a factor, and likely causes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.campaign.identification.compared.axis import RATES, axis_fault
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, MOST_LEFT, levels, spread
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.looking.causes.rescaled import both_text, far_text, scaled_text
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.updating.statistics.lines import MIN_BAND


def without_coherence(measurements: Mapping[str, Measurement]) -> list[str]:
    """Warning about measurements without coherence if most of the others have it."""
    lacking = [name for name, own in measurements.items() if not np.isfinite(own.coherence).any()]
    if not lacking or 2 * len(lacking) >= len(measurements):
        return []
    several = len(lacking) > 1
    return [
        f"job{'s' if several else ''} {', '.join(lacking)}: no coherence in {'their files' if several else 'its file'}, but the other jobs "
        "have it. Lines are not weighted by their noise then, and overload or a weak blow may stay unseen. Export it as in the "
        "other jobs, or give its file under jobs.NAME.coherence"
    ]


def other_lines(reference: str | None, measurements: Mapping[str, Measurement]) -> list[str]:
    """Warnings about measurements whose lines differ from those of the reference job, or whose files begin at another line.

    Parameters
    ----------
    reference : str or None
        Name of the reference job.
    measurements : mapping
        By job.
    """
    tight = measurements.get(reference or "")
    found = dict[str, list[str]]()
    for name, own in measurements.items() if tight is not None else ():
        if tight is None or _cut(own, tight):
            continue
        fault = axis_fault(own, tight, reference or "", name)
        # After a shift by whole lines, those in the band are the same.
        if not (difference := unlike(own.frequency_hz, tight.frequency_hz)):
            if fault:
                found.setdefault(fault, []).append(name)
            continue
        text = (
            f"its frequency lines differ from those of {reference} ({difference}). The model discrepancy of "
            f"{reference} is not known at its lines, so errors of the model may pass for loose bolts. "
            + (f"I{fault[1:]}" if fault else f"{_lacking(own, tight)}Measure or export it on the lines of {reference}")
        )
        found.setdefault(text, []).append(name)
    return [f"job {name}: {text}" + (f"; also found in {', '.join(others)}" if others else "") for text, (name, *others) in found.items()]


def _cut(own: Measurement, other: Measurement) -> bool:
    """Whether a measurement has the first lines of another and ends early; other warnings report such an incomplete file."""
    size = own.frequency_hz.size
    return size < MIN_BAND * other.frequency_hz.size and np.allclose(own.frequency_hz, other.frequency_hz[:size], rtol=1e-6)


def _lacking(own: Measurement, other: Measurement) -> str:
    """Clause about one gap of missing lines within a measurement, relative to another; empty if the difference is not such a gap."""
    axis, lines = own.frequency_hz, other.frequency_hz
    at = np.clip(np.searchsorted(axis, lines), 1, axis.size - 1)
    there = np.minimum(np.abs(axis[at] - lines), np.abs(axis[at - 1] - lines)) <= 1e-5 * lines
    gone = np.flatnonzero(~there & (lines > axis[0]) & (lines < axis[-1]))
    # With another resolution, lines are missing throughout.
    if not gone.size or gone[-1] - gone[0] + 1 != gone.size or there.sum() != axis.size:
        return ""
    return f"Its lines from {lines[gone[0]]:g} to {lines[gone[-1]]:g} Hz ({gone.size}) are missing. "


def _aside(measurement: Measurement, left: Callable[[Floats], float], frequency_hz: Floats, *, share: float = 0.15) -> tuple[float, float]:
    """Shift of all frequencies with the smallest misfit [Hz], in line spacings and at most a ``share`` of the band, and that misfit."""
    step = float(np.median(np.diff(measurement.frequency_hz)))
    count = int(share * float(np.ptp(frequency_hz)) / step)
    # Peaks are a few lines wide: first in steps of two lines, then of half a line about the best of these.
    coarse = min((step * k for k in range(-count, count + 1, 2)), key=lambda shift: left(frequency_hz + shift))
    return min((left(frequency_hz + shift), shift) for shift in coarse + step * np.arange(-1.5, 2.0, 0.5))[::-1]


def _read_at(
    measurement: Measurement, seen: Seen, which: Bools | slice = slice(None)
) -> tuple[Callable[[Floats], Floats], Callable[[Floats], float]]:
    """Measured levels (F, R) at other frequencies [dB], and the misfit of the model with them, of the responses ``which`` (mask (R,))."""
    own, here = levels(measurement.values), levels(seen.model)

    def read(there: Floats) -> Floats:
        return np.column_stack([np.interp(there, measurement.frequency_hz, level, np.nan, np.nan) for level in own.T])

    return read, lambda there: float(np.median(spread(read(there) - here, 0)[which]))


def _stretches(left: Callable[[Floats], float], frequency_hz: Floats, most: float, steps: int) -> tuple[Floats, Floats]:
    """Factors on the frequencies, and the misfits with them [dB]."""
    factors = most ** (np.arange(-steps, steps + 1) / steps)
    return factors, np.array([left(frequency_hz * factor) for factor in factors])


def out_of_reach_text(measurement: Measurement, seen: Seen, *, most: float = 2.0, steps: int = 280) -> str:
    """Warning if the stiffness of the model is so wrong that a calibration does not reach it, though one factor does not explain the FRFs.

    Parameters
    ----------
    measurement, seen, most, steps
        See ``stretched_text``.
    """
    # Resonances of the air stay where they are.
    moving = np.array(seen.quantities) != "pressure"
    left = _read_at(measurement, seen, moving if moving.any() else slice(None))[1]
    factors, found = _stretches(left, seen.measurement.frequency_hz, most, steps)
    return far_text(seen, measurement, float(factors[int(np.argmin(found))]))


def stretched_text(measurement: Measurement, seen: Seen, *, most: float = 2.0, steps: int = 280) -> str | None:
    """Warning with the factor or the shift between measured and computed frequencies, if one explains the measurement; else None.

    Parameters
    ----------
    measurement : Measurement
        Of the tight state, on all its lines.
    seen : Seen
        The same on the lines compared; the model does not explain it without a factor.
    most, steps : float, int
        Factors from ``1 / most`` to ``most`` are tried, ``steps`` on each side of 1, evenly spaced in their logarithm.
    """
    read, left = _read_at(measurement, seen)
    here, frequency_hz = levels(seen.model), seen.measurement.frequency_hz
    factors, found = _stretches(left, frequency_hz, most, steps)
    best, before = float(factors[int(np.argmin(found))]), float(found[steps])
    aside, after = _aside(measurement, left, frequency_hz)
    if min(found.min(), after) > min(MOST_LEFT, CLEARLY * before):
        return None
    if after < CLEARLY * found.min():
        return (
            f"all measured resonances are probably {abs(aside):.4g} Hz {'above' if aside > 0.0 else 'below'} those of the model: this "
            f"shift reduces the level misfit from {before:.1f} to {after:.1f} dB (mean level of each response removed). Check the start "
            "frequency in the headers of the files, and whether lines were left out; correct the frequencies"
        )
    wrong = (
        f"the model is too {'soft' if best > 1.0 else 'stiff'} or too {'heavy' if best > 1.0 else 'light'} (modulus, thickness, density)"
    )
    rate = "Check whether another sampling rate was entered or set (51.2 instead of 48 kHz is a factor of 1.067, 44.1 instead of 48 kHz "
    rate += "one of 0.919). If so, divide the "
    rate += f"frequencies by {best:.3g}; otherwise {wrong}"
    # Confused sampling rates have a smaller ratio than wrong materials.
    typed = 1.0 / RATES <= best <= RATES
    cause = f"{rate if typed else wrong[:1].upper() + wrong[1:]}; stiffness off by a factor of {best**2:.2g}, springs of bolts in addition"
    level = float(np.nanmedian(read(frequency_hz * best) - here))
    if both := both_text(seen, measurement, best, level):
        cause = both
    elif not typed and (scaled := scaled_text(seen, best, wrong[:1].upper() + wrong[1:])):
        cause = scaled
    return (
        f"all measured resonances are probably at {best:.3g} times the frequencies of the model: this factor reduces the level misfit "
        f"from {before:.1f} to {found.min():.1f} dB (mean level of each response removed). {cause}"
    )
