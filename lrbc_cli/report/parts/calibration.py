"""Section of the page on the calibration of the reference model: factors, misfit, FRFs, rounds."""

from __future__ import annotations

import math

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Chart
from lrbc_cli.report.drawing.svg import drawn, legend
from lrbc_cli.report.html import Cell, Markup, beside, details, table, tag
from lrbc_cli.report.parts.figures import overlay_chart
from lrbc_cli.results.model import CalibrationRecord, CampaignRecord
from lrbc_cli.results.tables import Frf


def serves(calibration: CalibrationRecord, campaign: CampaignRecord) -> bool:
    """Whether the jobs of a campaign rest on this calibration."""
    return calibration.used and campaign.calibration in (None, calibration.key)


def calibration_charts(calibration: CalibrationRecord, frf: Frf | None, campaign: CampaignRecord) -> list[Chart]:
    """Return a chart of measured, initial and calibrated FRF for each response, used ones first; empty without FRFs."""
    if frf is None:
        return []
    names = sorted(frf.responses, key=lambda name: not campaign.response(name).used)
    labels = {"measured": "measured", "initial": "before calibration", "updated": "after calibration"}
    charts = []
    for name in names:
        response = campaign.response(name)
        note = "used" if response.used else "validation channel"
        charts.append(overlay_chart(response, frf, labels, f"{name} · {calibration.job}", note))
    return charts


def calibration_parts(calibration: CalibrationRecord, frf: Frf | None, campaign: CampaignRecord) -> list[Markup | None]:
    """Return the parts of the section: factors, misfit, FRFs, rounds, provenance."""
    state = (
        "All jobs use this model."
        if serves(calibration, campaign)
        else "The jobs of this report do NOT use it: its hash does not match theirs, or it was left out on purpose."
    )
    boundary = ", with the boundary held at its start values" if calibration.boundary_held else " together with the boundary stiffness"
    text = (
        f"Global factors of the reference model, identified from job {calibration.job}{boundary}. {state} "
        "The factors also absorb errors of the model, so they need not be the true material values."
    )
    charts = calibration_charts(calibration, frf, campaign)
    figures = [drawn(chart) for chart in charts]
    count = 0 if frf is None else sum(campaign.response(name).used for name in frf.responses)
    first, rest = figures[:count], figures[count:]
    parts: list[Markup | None] = [
        tag("p", text, class_=None if serves(calibration, campaign) else "warning"),
        _remarks(calibration),
        _factors(calibration),
        _misfits(calibration),
    ]
    if charts:
        parts += [legend(charts[0]), tag("p", beside(("", calibration.frf), text="CSV of these FRFs"), class_="files")]
    parts.append(tag("div", *first, class_="grid pairs") if first else None)
    parts.append(details(f"Validation channels ({len(rest)})", tag("div", *rest, class_="grid pairs")) if rest else None)
    parts += [_rounds(calibration), tag("p", _provenance(calibration), class_="meta")]
    return parts


def _remarks(calibration: CalibrationRecord) -> Markup | None:
    """Return the status if the calibration did not converge, and notes on bounds and starts."""
    lines = list(calibration.notes)
    if calibration.status != "converged":
        lines.insert(0, f"{calibration.status}: {calibration.reason or 'no reason is given'}")
    return tag("ul", *(tag("li", line) for line in lines), class_="warning") if lines else None


def _digits(value: float | None, digits: int = 5) -> str:
    return fmt.figures(value, digits).replace("e−0", "e−")


def _factors(calibration: CalibrationRecord) -> Markup:
    rows: list[list[str | Cell]] = []
    for name, factor in calibration.factors.items():
        share = None if not factor.initial else 100.0 * (factor.value / factor.initial - 1.0)
        low, high = (_digits(side) for side in (factor.lower95, factor.upper95))
        interval = f"{'open' if factor.lower95 is None else low} … {'open' if factor.upper95 is None else high}"
        if factor.lower95 is None and factor.upper95 is None:
            interval = "undetermined"
        rows.append([name, _digits(factor.initial), _digits(factor.value), fmt.signed(share, 2), _digits(factor.std, 2), interval])
    head = ["Factor", "Before", "After", "Change [%]", "Standard deviation", "95 % interval"]
    return table("Identified factors", head, rows)


def _misfits(calibration: CalibrationRecord) -> Markup | None:
    misfit = calibration.misfit_db
    rows: list[list[str | Cell]] = [
        [name, fmt.fixed(before), fmt.fixed(after)]
        for name, before, after in (
            ("responses used", misfit.initial, misfit.final),
            ("validation channels", misfit.held_out_initial, misfit.held_out_final),
        )
        if not math.isnan(after)
    ]
    return table(f"Mean absolute misfit of job {calibration.job} [dB]", ["Channels", "Before", "After"], rows) if rows else None


def _rounds(calibration: CalibrationRecord) -> Markup | None:
    if not calibration.rounds:
        return None
    names = list(dict.fromkeys(name for entry in calibration.rounds for name in entry.factors))
    rows: list[list[str | Cell]] = [
        [str(number), fmt.fixed(entry.misfit_db), fmt.small(entry.error), *(_digits(entry.factors.get(name)) for name in names)]
        for number, entry in enumerate(calibration.rounds, start=1)
    ]
    head = ["Round", "Misfit [dB]", "Error of the reduced model", *names]
    return details(f"Rounds ({len(rows)})", table("Rounds of calibration", head, rows, text_columns=0))


def _provenance(calibration: CalibrationRecord) -> str:
    measured = calibration.reduction
    parts = [
        f"calibration.json, key {calibration.key}",
        f"reduced model of {fmt.count(measured.size)} DOFs, measured error {fmt.small(measured.worst)} "
        f"(tolerance {fmt.small(measured.tolerance)})",
        fmt.seconds(calibration.seconds),
    ]
    return " · ".join(parts)
