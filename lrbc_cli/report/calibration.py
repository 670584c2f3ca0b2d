"""Calibration of the reference model: what ``calibration.json`` says, and its part of the page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lrbc_cli.errors import DataError
from lrbc_cli.report import format as fmt
from lrbc_cli.report.chart import Chart
from lrbc_cli.report.figures import overlay_chart
from lrbc_cli.report.html import Cell, Markup, details, figure, table, tag
from lrbc_cli.report.reading import Node, read_document
from lrbc_cli.report.results import Campaign, Frf, read_frf_table
from lrbc_cli.report.svg import legend, svg

_HINT = "run `lrbc calibrate` to write it anew"


@dataclass(frozen=True)
class Factor:
    """A factor of the reference model with its 95 % interval; None where a limit is open or unknown."""

    name: str
    value: float
    std: float | None
    lower: float | None
    upper: float | None
    initial: float | None


@dataclass(frozen=True)
class Round:
    """One round of calibration: misfit [dB], values of the factors, measured error of the reduced model it rests on."""

    misfit_db: float | None
    factors: Mapping[str, float | None]
    error: float | None


@dataclass(frozen=True)
class Calibration:
    """The calibrated reference model; ``misfits`` holds pairs before and after, in dB."""

    job: str
    factors: tuple[Factor, ...]
    misfits: Mapping[str, tuple[float | None, float | None]]
    used: bool
    key: str
    rounds: tuple[Round, ...]
    size: float | None
    worst: float | None
    tolerance: float | None
    seconds: float | None
    frf: Frf | None
    status: str | None = None
    reason: str | None = None
    held: bool | None = None
    notes: tuple[str, ...] = ()

    def serves(self, campaign: Campaign) -> bool:
        """Whether the jobs of a campaign rest on it."""
        return self.used and campaign.calibration in (None, self.key)


def read_calibration(output: Path) -> Calibration | None:
    """Read ``calibration.json`` and its FRFs; None where there is none.

    Raises
    ------
    DataError
        Where one of them is damaged.
    """
    file = output / "calibration.json"
    if not file.exists():
        return None
    node = read_document(file, "lrbc-calibration")
    misfit, reduction = node.maybe_node("misfit_db"), node.maybe_node("reduction")
    place = node.maybe_text("frf")
    if place is not None and (Path(place).is_absolute() or ".." in Path(place).parts):
        raise DataError(
            "this result file is damaged", file=file, place="frf", expected="a file inside the output folder", found=place, hint=_HINT
        )
    return Calibration(
        job=node.text("job"),
        factors=tuple(_factor(name, entry) for name, entry in node.node("factors").items()),
        misfits={
            name: (misfit.maybe_number(f"{part}initial"), misfit.maybe_number(f"{part}final"))
            for name, part in (("responses used", ""), ("validation channels", "held_out_"))
        },
        used=node.flag("used"),
        key=node.maybe_text("key") or "",
        rounds=tuple(_round(entry) for entry in node.nodes("rounds")),
        size=reduction.maybe_number("size"),
        worst=reduction.maybe_number("worst"),
        tolerance=reduction.maybe_number("tolerance"),
        seconds=node.maybe_number("seconds"),
        frf=None if place is None else read_frf_table(output / place),
        status=node.maybe_text("status"),
        reason=node.maybe_text("reason"),
        held=node.maybe_flag("boundary_held"),
        notes=node.texts("notes") if node.has("notes") else (),
    )


def _factor(name: str, node: Node) -> Factor:
    value = node.number("value")
    if not 0 < value < float("inf"):
        raise node.wrong("value", "a positive number", value)
    return Factor(
        name,
        value,
        node.maybe_number("std"),
        node.maybe_number("lower95"),
        node.maybe_number("upper95"),
        node.maybe_number("initial"),
    )


def _round(node: Node) -> Round:
    factors = node.maybe_node("factors")
    names = node.raw("factors") or {}
    return Round(node.maybe_number("misfit_db"), {name: factors.maybe_number(name) for name in names}, node.maybe_number("error"))


def calibration_charts(calibration: Calibration, campaign: Campaign) -> list[Chart]:
    """Return measured, initial and calibrated FRF of each response, those used first."""
    if calibration.frf is None:
        return []
    names = sorted(calibration.frf.responses, key=lambda name: not campaign.response(name).used)
    labels = {"measured": "measured", "initial": "before calibration", "updated": "after calibration"}
    charts = []
    for name in names:
        response = campaign.response(name)
        note = "used" if response.used else "validation channel"
        charts.append(overlay_chart(response, calibration.frf, labels, f"{name} · {calibration.job}", note))
    return charts


def calibration_parts(calibration: Calibration, campaign: Campaign) -> list[Markup | None]:
    """Return the parts of the section: factors, misfit, FRFs, rounds, provenance."""
    state = (
        "The jobs rest on it."
        if calibration.serves(campaign)
        else "It is NOT used by the jobs of this report: its hash does not fit them, or it was left out on purpose."
    )
    boundary = {None: "", True: ", the boundary held at its start values", False: ", the boundary beside them"}[calibration.held]
    text = (
        f"Global factors of the reference model, identified from job {calibration.job}{boundary}. {state} "
        "They absorb errors of the model as well, so they need not be the true values of the materials."
    )
    charts = calibration_charts(calibration, campaign)
    used = [chart for chart in charts if chart.subtitle.startswith("used")]
    others = [chart for chart in charts if chart not in used]
    drawn = [figure(svg(chart), chart.title, chart.subtitle) for chart in used]
    rest = [figure(svg(chart), chart.title, chart.subtitle) for chart in others]
    parts: list[Markup | None] = [
        tag("p", text, class_=None if calibration.serves(campaign) else "warning"),
        _remarks(calibration),
        _factors(calibration),
        _misfits(calibration),
    ]
    if charts:
        parts.append(legend(charts[0]))
    parts.append(tag("div", *drawn, class_="grid pairs") if drawn else None)
    parts.append(details(f"Validation channels ({len(rest)})", tag("div", *rest, class_="grid pairs")) if rest else None)
    parts += [_rounds(calibration), tag("p", _provenance(calibration), class_="meta")]
    return parts


def _remarks(calibration: Calibration) -> Markup | None:
    """Return the status where it did not converge, and notes on bounds and starts."""
    lines = list(calibration.notes)
    if calibration.status not in (None, "converged"):
        lines.insert(0, f"{calibration.status}: {calibration.reason or 'no reason is given'}")
    return tag("ul", *(tag("li", line) for line in lines), class_="warning") if lines else None


def _digits(value: float | None, digits: int = 5) -> str:
    return fmt.figures(value, digits).replace("e−0", "e−")


def _factors(calibration: Calibration) -> Markup:
    rows: list[list[str | Cell]] = []
    for factor in calibration.factors:
        share = None if not factor.initial else 100.0 * (factor.value / factor.initial - 1.0)
        low, high = (_digits(side) for side in (factor.lower, factor.upper))
        interval = f"{'open' if factor.lower is None else low} … {'open' if factor.upper is None else high}"
        if factor.lower is None and factor.upper is None:
            interval = "undetermined"
        rows.append(
            [
                factor.name,
                _digits(factor.initial),
                _digits(factor.value),
                fmt.signed(share, 2),
                _digits(factor.std, 2),
                interval,
            ]
        )
    head = ["Factor", "Before", "After", "Change [%]", "Standard deviation", "95 % interval"]
    return table("Identified factors", head, rows)


def _misfits(calibration: Calibration) -> Markup | None:
    rows: list[list[str | Cell]] = [
        [name, fmt.fixed(before), fmt.fixed(after)] for name, (before, after) in calibration.misfits.items() if after is not None
    ]
    return table(f"Mean absolute misfit of job {calibration.job} [dB]", ["", "Before", "After"], rows) if rows else None


def _rounds(calibration: Calibration) -> Markup | None:
    if not calibration.rounds:
        return None
    names = list(dict.fromkeys(name for entry in calibration.rounds for name in entry.factors))
    rows: list[list[str | Cell]] = [
        [
            str(number),
            fmt.fixed(entry.misfit_db),
            fmt.small(entry.error),
            *(_digits(entry.factors.get(name)) for name in names),
        ]
        for number, entry in enumerate(calibration.rounds, start=1)
    ]
    head = ["Round", "Misfit [dB]", "Error of the reduced model", *names]
    return details(f"Rounds ({len(rows)})", table("Rounds of calibration", head, rows, text_columns=0))


def _provenance(calibration: Calibration) -> str:
    parts = [f"calibration.json, key {calibration.key}" if calibration.key else "calibration.json"]
    if calibration.size is not None:
        worst = f", measured error {fmt.small(calibration.worst)}" if calibration.worst is not None else ""
        limit = f" (tolerance {fmt.small(calibration.tolerance)})" if calibration.tolerance is not None else ""
        parts.append(f"reduced model of {fmt.count(calibration.size)} DOFs{worst}{limit}")
    if calibration.seconds is not None:
        parts.append(fmt.seconds(calibration.seconds))
    return " · ".join(parts)
