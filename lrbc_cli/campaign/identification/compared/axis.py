"""Detects measurements whose frequencies are those of the reference job times a factor, shifted by lines, or numbers of lines."""

from __future__ import annotations

import numpy as np

from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.updating.knots import evenly

#: Largest ratio of sampling rates that are confused (44.1 to 51.2 kHz), rounded up.
RATES = 1.25


def axis_fault(own: Measurement, tight: Measurement, reference: str, name: str) -> str:
    """Likely fault of the frequencies of job ``name``, by those of the reference job, and the fix; empty if there is none."""
    differ, recount = unlike(own.frequency_hz, tight.frequency_hz), "Check whether they were counted from another first line, and correct"
    if differ and (counted := numbered(own, tight)):
        return (
            f"its frequencies are probably the numbers of its lines, counted from {counted}: give the column of the frequencies under "
            f"jobs.{name}.format.frequency"
        )
    if aside := shifted(own, tight):
        return f"its file begins {aside} than that of {reference}, with as many lines. {recount} its frequencies"
    if differ and (other := clocked(own, tight)):
        return (
            f"its frequencies are {other:.5g} times those of {reference}, line by line. Check whether another sampling rate was entered. "
            f"Divide them by {other:.5g}, or measure again with the settings of {reference}"
        )
    return ""


def numbered(own: Measurement, other: Measurement) -> str:
    """First line number (0 or 1, in words) if the frequencies of a measurement are line numbers; else empty."""
    axes = [each.frequency_hz for each in (own, other)]
    if axes[0].size + sum(own.left_out) != axes[1].size + sum(other.left_out) or not np.all(np.diff(axes[0]) == 1.0):
        return ""
    first = float(axes[0][0]) - own.left_out[0]
    return f"{first:g}" if first in (0.0, 1.0) else ""


def clocked(own: Measurement, other: Measurement, *, least: float = 1e-3) -> float | None:
    """Constant ratio of the frequencies to those of another measurement with as many evenly spaced lines; None if there is none.

    Parameters
    ----------
    own, other : Measurement
    least : float
        The ratio must lie between ``1 / RATES`` and ``RATES``, and differ by more than this from 1.
    """
    axes = [each.frequency_hz for each in (own, other)]
    counts = [axis.size + sum(each.left_out) for axis, each in zip(axes, (own, other), strict=True)]
    steps = [np.diff(axis) for axis in axes]
    if counts[0] != counts[1] or any(not evenly(axis) for axis in axes):
        return None
    ratio = float(steps[0].mean() / steps[1].mean())
    first = [float(axis[0] - step.mean() * each.left_out[0]) for axis, step, each in zip(axes, steps, (own, other), strict=True)]
    alike = abs(first[0] - ratio * first[1]) < least * float(steps[1].mean()) * counts[1]
    return ratio if alike and 1.0 / RATES < ratio < RATES and abs(ratio - 1.0) > least else None


def shifted(own: Measurement, other: Measurement, *, most: float = 2.0) -> str:
    """Shift of the frequencies relative to another measurement with as many evenly spaced lines, in words; empty if none or too large.

    Parameters
    ----------
    own, other : Measurement
    most : float
        Largest shift in line spacings. Counting bins from 1, or leaving out 0 Hz, shifts by one line or by half of one.
    """
    axes = [each.frequency_hz for each in (own, other)]
    counts = [axis.size + sum(each.left_out) for axis, each in zip(axes, (own, other), strict=True)]
    steps = [np.diff(axis) for axis in axes]
    if counts[0] != counts[1] or any(not step.size or not np.allclose(step, steps[1].mean(), rtol=1e-3) for step in steps):
        return ""
    step = float(steps[1].mean())
    aside = float(axes[0][0] - axes[1][0]) - step * (own.left_out[0] - other.left_out[0])
    if not 1e-3 * step < abs(aside) <= (most + 1e-3) * step:
        return ""
    return f"{abs(aside):.3g} Hz {'higher' if aside > 0.0 else 'lower'}"
