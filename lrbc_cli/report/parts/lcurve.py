"""The chart of an L-curve: sums of squares of residuals and penalty for the weights tried, and the corner."""

from __future__ import annotations

import numpy as np

from lrbc_cli.report.drawing.chart import Axis, Chart, Curve, Item, Marks, Note, Panel, decade_axis, number, span_of
from lrbc_cli.results.job import JobRecord


def l_curve_chart(job: JobRecord) -> Chart | None:
    """Return the L-curve of a job with its corner marked; None if the weight was given."""
    curve = job.l_curve
    if curve is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = np.log10(curve.data), np.log10(curve.penalty)
    known = np.isfinite(x) & np.isfinite(y)
    x, y, eta = x[known], y[known], curve.eta[known]
    labels = tuple(f"η = {number(float(value), 3)}" for value in eta)
    items: list[Item] = [Curve("identified", x, y, "weights tried"), Marks(role="series0", x=x, y=y, names=labels)]
    (x_low, x_high), (y_low, y_high) = span_of([x]), span_of([y])
    if curve.at is not None:
        at, up = np.log10(curve.at.data), np.log10(curve.at.penalty)
        items.append(Marks(role="corner", x=np.array([at]), y=np.array([up]), label="corner", names=(f"η = {number(curve.chosen, 3)}",)))
        subtitle = f"corner at η = {number(curve.chosen, 3)}"
    else:
        subtitle = f"no corner: η = {number(curve.chosen, 3)} was used"
    margin = 0.12 * max(y_high - y_low, 1.0)
    y_axis = _axis("departures, Σ decades²", y_low - margin, y_high + margin)
    # Labels at both ends show in which direction the weight grows.
    for end, shift in ((0, 0.05), (len(eta) - 1, -0.05)) if len(eta) > 1 else ():
        height = float((y[end] - y_axis.low) / (y_axis.high - y_axis.low))
        items.append(Note("text", float(x[end]), height + shift, labels[end]))
    side = 0.12 * max(x_high - x_low, 0.2)
    x_axis = _axis("data, Σ dB²", x_low - side, x_high + side)
    alt = f"L-curve of job {job.job}: departures over data for {len(eta)} weights from {number(float(curve.eta.min()), 3)} to "
    alt += f"{number(float(curve.eta.max()), 3)}; {subtitle}."
    return Chart(
        title=f"L-curve · {job.job}",
        subtitle=subtitle,
        alt=alt,
        panels=(Panel(x=x_axis, y=y_axis, items=tuple(items)),),
        width=430.0,
        height=260.0,
    )


def _axis(label: str, low: float, high: float) -> Axis:
    """Return a logarithmic axis; 1, 2 and 5 are marked if there are few decades."""
    if not np.isfinite([low, high]).all() or high - low > 2.0:
        return decade_axis(label, low, high)
    values = [digit * 10.0**k for k in range(int(np.floor(low)), int(np.ceil(high)) + 1) for digit in (1, 1.5, 2, 3, 5, 7)]
    ticks = tuple(
        (float(np.log10(value)), f"{value:,.0f}".replace(",", "\u202f") if value >= 10 else number(value, 2))
        for value in values
        if low <= np.log10(value) <= high
    )
    return Axis(label, low, high, _spread(ticks, (high - low) / 9.0), powers=True)


def _spread(ticks: tuple[tuple[float, str], ...], least: float) -> tuple[tuple[float, str], ...]:
    kept: list[tuple[float, str]] = []
    for tick in ticks:
        if not kept or tick[0] - kept[-1][0] >= least:
            kept.append(tick)
    return tuple(kept)
