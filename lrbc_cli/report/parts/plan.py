"""The plan of a measurement: its figure, its table in the terminal and its part of the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Axis, Chart, Item, LevelLine, Marks, Panel, Tiles, Word, linear_axis, number
from lrbc_cli.report.drawing.layout import BOTTOM, RIGHT, SMALL, TOP
from lrbc_cli.report.drawing.svg import legend, own_size, svg
from lrbc_cli.report.html import Cell, Markup, figure, table, tag
from lrbc_cli.results.plan import Excitation, PlannedBolt, PlanRecord, Visibility, Worst, Worth
from lrbc_cli.results.store import read

VERDICTS: tuple[Visibility, ...] = ("seen", "weak", "blind")
#: What people read for the keys of ``plan.json``.
WORDS: dict[Visibility, str] = {"seen": "detectable", "weak": "marginal", "blind": "not detectable"}

#: Height of the panel of bolts and of a bar of the ranking [points]; bars beyond this number are left to the table.
_BOLTS, _BAR, _BARS = 190.0, 15.0, 40
#: Room to the right of the bolts for what the lines stand for [points].
_LABEL = 26.0
_GLYPH = 0.6
#: Bars are cut at this many times the limit of what is seen.
_CUT = 5.0


def _along(plan: PlanRecord) -> list[list[PlannedBolt]]:
    """Bolts edge by edge, in order along each."""
    edges: dict[str | None, list[PlannedBolt]] = {}
    for bolt in plan.bolts:
        edges.setdefault(bolt.group, []).append(bolt)
    return [sorted(bolts, key=lambda bolt: math.inf if bolt.arc_length is None else bolt.arc_length) for bolts in edges.values()]


def _rehearsed(bolt: PlannedBolt) -> str:
    """Right verdicts, of how many."""
    return "" if bolt.rehearsal is None else f"{bolt.rehearsal.right}/{bolt.rehearsal.draws}"


def _others(bolt: PlannedBolt) -> tuple[str, ...]:
    """Tight bolts that its rehearsals called loose."""
    return () if bolt.rehearsal is None else tuple(bolt.rehearsal.others_loose)


def plan_chart(plan: PlanRecord) -> Chart:
    """Return d' of every bolt along the edges, and below it what every response is worth."""
    shown = plan.responses[:_BARS]
    left = max(50.0, 16.0 + _GLYPH * SMALL * max((len(_cut(entry.name)) for entry in shown), default=1))
    count = sum(len(edge) for edge in _along(plan)) + 0.5 * (len(_along(plan)) - 1)
    width = float(np.clip(left + RIGHT + _LABEL + 30.0 * count, 560.0, 900.0))
    ranked = 20.0 + _BAR * max(len(shown), 1)
    panels = (_bolts(plan, (width - left - RIGHT - _LABEL) / count, _BOLTS), _ranking(shown, ranked))
    counts = f"{plan.planned.seen} detectable, {plan.planned.weak} marginal, {plan.planned.blind} not detectable"
    planned = sum(entry.planned for entry in plan.responses)
    subtitle = f"{_state(plan)} · {number(plan.noise.sigma_db, 3)} dB a line · {counts} with {planned} planned responses"
    alt = " ".join(f"{WORDS[word]}: {', '.join(b.name for b in plan.bolts if b.verdict == word) or 'none'}." for word in VERDICTS)
    return Chart(f"Detectable loosening · {plan.campaign}", subtitle, alt, panels, width, _BOLTS + ranked + TOP + 2 * BOTTOM, left=left)


def _cut(name: str, limit: int = 24) -> str:
    return name if len(name) <= limit else name[: limit - 1] + "…"


def _state(plan: PlanRecord) -> str:
    if plan.state_job is not None:
        return f"about the result of {plan.state_job}"
    words = {"initial": "about the start values", "clamped": "about the upper bounds", "free": "about the lower bounds"}
    return words.get(plan.state, f"about {plan.state}")


def _bolts(plan: PlanRecord, cell: float, weight: float) -> Panel:
    highest = max(
        [1.25 * plan.limits.seen.d_prime, *(1.12 * value for bolt in plan.bolts for value in (bolt.d_prime, bolt.all_responses.d_prime))]
    )
    high = min(highest, _CUT * plan.limits.seen.d_prime)
    boxes: dict[str, list[tuple[tuple[float, ...], str]]] = {word: [] for word in VERDICTS}
    words: list[Item] = []
    rings: list[tuple[float, float]] = []
    ticks: list[tuple[float, str]] = []
    at = 0.0
    edges = _along(plan)
    for edge in edges:
        every = max(1, math.ceil((_GLYPH * SMALL * max(len(bolt.name) for bolt in edge) + 3.0) / cell))
        for index, bolt in enumerate(edge):
            top = min(bolt.d_prime, high)
            correct = fmt.probability(bolt.probability_correct)
            text = f"{bolt.name}, {WORDS[bolt.verdict]}: d' {number(bolt.d_prime, 3)}, correct verdict {correct}"
            # A blind bolt keeps a visible foot.
            boxes[bolt.verdict].append(((at + 0.17, at + 0.83, 0.0, max(top, 0.012 * high)), text))
            if bolt.all_responses.d_prime > bolt.d_prime + 0.005 * high:
                rings.append((at + 0.5, min(bolt.all_responses.d_prime, high)))
            if cell >= 18.0:
                inside = top > 0.12 * high
                # Above a ring that would cover it.
                above = min(bolt.all_responses.d_prime, high) if bolt.all_responses.d_prime < bolt.d_prime + 0.09 * high else top
                level = top - 0.05 * high if inside else above + 0.05 * high
                # Clear of the lines.
                for limit in sorted((plan.limits.seen.d_prime, plan.limits.blind.d_prime), reverse=True):
                    if abs(level - limit) < 0.035 * high:
                        level = limit - 0.04 * high if inside else limit + 0.04 * high
                role = f"on-{bolt.verdict}" if inside else "text"
                words.append(Word(role, at + 0.5, level, f"{bolt.d_prime:.{1 if bolt.d_prime < 99.95 else 0}f}", 7.0))
            if index % every == 0:
                ticks.append((at + 0.5, bolt.name))
            at += 1.0
        at += 0.5
    how = "right verdict when rehearsed" if plan.rehearsed else "verdict correct"
    labels = {
        "seen": f"detectable: {how}, {100 * plan.limits.seen.probability:.0f} % or more",
        "weak": "marginal",
        "blind": f"not detectable: below {100 * plan.limits.blind.probability:.0f} %",
    }
    items: list[Item] = [
        Tiles(f"plan-{word}", np.array([box for box, _ in found]).reshape(-1, 4), labels[word], tuple(text for _, text in found))
        for word, found in boxes.items()
    ]
    # What is rehearsed does not follow from d': there are no limits to draw.
    drawn = [] if plan.rehearsed else [(limit.d_prime, limit.probability) for limit in (plan.limits.seen, plan.limits.blind)]
    items += [LevelLine("plan-limit", limit) for limit, _ in drawn]
    room = _LABEL / cell
    # What the lines stand for, beyond the last bolt where nothing covers it.
    words += [
        Word("text", at - 0.5 + 0.96 * room, limit + 0.035 * high, f"{100 * chance:.0f} %", 7.0, anchor="end") for limit, chance in drawn
    ]
    if rings:
        items.append(Marks("plan-all", np.array([x for x, _ in rings]), np.array([y for _, y in rings]), "with all responses"))
    axis = Axis("", 0.0, at - 0.5 + room, tuple(ticks))
    return Panel(axis, linear_axis("d' of a loosened bolt", 0.0, high, 5), (*items, *words), weight)


def _ranking(shown: Sequence[Worth], weight: float) -> Panel:
    top = max([entry.gain_bits for entry in shown] + [1e-3])
    boxes: dict[bool, list[tuple[float, ...]]] = {True: [], False: []}
    words: list[Item] = []
    for row, entry in enumerate(shown):
        end = max(entry.gain_bits, 0.0)
        boxes[entry.planned].append((0.0, max(end, 0.002 * top), row + 0.82, row + 0.18))
        words.append(Word("text", end + 0.012 * top, row + 0.5, f"{entry.gain_bits:.2f}", 7.5, anchor="start"))
    items: list[Item] = [
        Tiles("plan-candidate", np.array(boxes[False]).reshape(-1, 4), "candidate: what it would add" if boxes[False] else ""),
        Tiles("plan-planned", np.array(boxes[True]).reshape(-1, 4), "planned: what is lost without it" if boxes[True] else ""),
    ]
    x_axis = linear_axis("information about the bolts [bits]", 0.0, 1.12 * top, 6)
    y_axis = Axis("", float(max(len(shown), 1)), 0.0, tuple((row + 0.5, _cut(entry.name)) for row, entry in enumerate(shown)))
    return Panel(x_axis, y_axis, (*items, *words), weight)


def draw_plan(output: Path) -> Path | None:
    """Draw ``plan.png`` from ``plan.json``; None where there is none.

    Raises
    ------
    DataError
        Where the plan is damaged, or the figure cannot be written.
    """
    # matplotlib takes a second to import.
    from lrbc_cli.report.drawing.png import draw

    plan = read(output / "plan.json", PlanRecord)
    if plan is None:
        return None
    file = output / "plan.png"
    draw(plan_chart(plan), file)
    return file


def plan_text(output: Path) -> str:
    """Return the plan as tables in plain ASCII; nothing where there is none."""
    plan = read(output / "plan.json", PlanRecord)
    if plan is None:
        return ""
    planned = [entry.name for entry in plan.responses if entry.planned]
    moved = "loosened" if plan.change < 0 else "tightened"
    lines = [
        f"{_state(plan)}, {plan.lines.count} lines; one bolt at a time {moved} by {abs(plan.change):g} decades",
        f"noise {plan.noise.sigma_db:.2g} dB a line, correlation factor {plan.noise.correlation_factor:.2g} ({plan.noise.source})",
        "",
    ]
    head = ["bolt", "verdict", "d'", "correct", "d' all", "std", "95 % interval", "found", "p(loose)"]
    head += ["right"] if plan.rehearsed else []
    rows = [
        [
            bolt.name,
            WORDS[bolt.verdict],
            _plain(bolt.d_prime, 1),
            _plain(bolt.probability_correct, 2),
            _plain(bolt.all_responses.d_prime, 1),
            _plain(bolt.std, 2),
            "" if math.isnan(bolt.std) else f"+-{1.96 * bolt.std:.2f}",
            _plain(bolt.expected_change, 2) if bolt.note is None else "",
            _plain(bolt.expected_probability_loose, 2),
            *([_rehearsed(bolt)] if plan.rehearsed else []),
        ]
        for bolt in plan.bolts
    ]
    lines += _columns(head, rows, left=2)
    lines += [
        f"with {bolt.name} loosened a tight bolt was called loose: {', '.join(_others(bolt))}" for bolt in plan.bolts if _others(bolt)
    ]
    notes: dict[str, list[str]] = {}
    for bolt in plan.bolts:
        if bolt.note is not None:
            notes.setdefault(bolt.note, []).append(bolt.name)
    lines += [f"{', '.join(names)}: {note}" for note, names in notes.items()]
    lines.append(
        f"{plan.planned.seen} detectable, {plan.planned.weak} marginal, {plan.planned.blind} not detectable with {', '.join(planned)}"
    )
    lines += ["", *_worths("response", plan.responses, plan.planned.worst)]
    if plan.excitations:
        lines += ["", *_worths("excitation", plan.excitations, None)]
    best = ", ".join(f"{entry.name} ({entry.bits:.1f})" for entry in plan.order[:8])
    lines += ["", f"chosen one after another (bits in all): {best}"]
    lines += ["", "assumes:", *(f"- {text}" for text in plan.assumes)] if plan.assumes else []
    lines += [f"note: {note}" for note in plan.notes]
    return "\n".join(lines)


def _plain(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""


def _worths(title: str, entries: Sequence[Worth | Excitation], before: Worst | None) -> list[str]:
    rows = []
    for entry in entries:
        planned = isinstance(entry, Worth) and entry.planned
        word = ("loses" if planned else "adds") if isinstance(entry, Worth) else f"of {len(entry.responses)} planned"
        change = "" if entry.worst is None else f"{entry.worst.bolt} {entry.worst.d_prime:.1f}"
        if title == "response" and before is not None and change:
            change += f" (now {before.bolt} {before.d_prime:.1f})"
        rows.append(
            [
                entry.name,
                "planned" if planned else "",
                word,
                f"{entry.gain_bits:.2f}",
                f"{entry.alone_bits:.1f}",
                change,
            ]
        )
    worst = "worst bolt then, d'" if title == "response" else "worst bolt alone, d'"
    return _columns([title, "", "", "bits", "alone", worst], rows, left=3, last=True)


def _columns(head: Sequence[str], rows: Sequence[Sequence[str]], left: int, last: bool = False) -> list[str]:
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    text = []
    for row in [head, *rows]:
        cells = [
            cell.ljust(width) if k < left or (last and k == len(head) - 1) else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
            if width
        ]
        text.append("  ".join(cells).rstrip())
    return text


def _how(plan: PlanRecord) -> str:
    """What the probability of a correct verdict rests on."""
    if plan.rehearsed:
        draws = max(bolt.rehearsal.draws for bolt in plan.bolts if bolt.rehearsal is not None)
        return f", counted in {draws} rehearsals of each bolt: the bolt called loose, and no other"
    return ", by the likelihood ratio" if plan.assumes else ""


def plan_parts(plan: PlanRecord) -> list[Markup | None]:
    """Return the parts of the section: what it means, the figure, bolts, responses, excitations."""
    chart = plan_chart(plan)
    text = (
        f"From the model alone, {_state(plan)}, with {number(plan.noise.sigma_db, 3)} dB of noise a line (correlation factor "
        f"{number(plan.noise.correlation_factor, 3)}, {plan.noise.source}) on {plan.lines.count} lines: each bolt in turn is "
        f"{'loosened' if plan.change < 0 else 'tightened'} by {number(abs(plan.change), 3)} decades. d' tells how many standard "
        "deviations the FRFs then lie from what the other unknowns can imitate. A verdict with "
        f"{100 * plan.confidence:.0f} % confidence is correct with the probability of the table, and missing or wrong otherwise"
        f"{_how(plan)}. The standard deviation is that of the change in the present state, prior included."
    )
    rows: list[list[str | Cell]] = [
        [
            bolt.name,
            WORDS[bolt.verdict],
            fmt.fixed(bolt.d_prime, 1),
            fmt.probability(bolt.probability_correct),
            fmt.fixed(bolt.all_responses.d_prime, 1),
            fmt.fixed(bolt.std, 2),
            fmt.probability(bolt.variance_removed),
            fmt.fixed(bolt.expected_change, 2) if bolt.note is None else fmt.MISSING,
            fmt.MISSING if math.isnan(bolt.expected_probability_loose) else fmt.probability(bolt.expected_probability_loose),
            _rehearsed(bolt) or fmt.MISSING,
            bolt.note or (f"called loose with it: {', '.join(_others(bolt))}" if _others(bolt) else ""),
        ]
        for bolt in plan.bolts
    ]
    head = ["Bolt", "", "d'", "Correct verdict", "d' with all responses", "Std [decades]", "Prior variance removed"]
    head += ["Change found where loosened", "Probability stated then", "Rehearsals with a right verdict", "Note"]
    worth: list[list[str | Cell]] = [
        [
            entry.name,
            "planned" if entry.planned else "candidate",
            fmt.signed(-entry.gain_bits if entry.planned else entry.gain_bits, 2),
            fmt.fixed(entry.alone_bits, 1),
            fmt.MISSING if entry.worst is None else f"{entry.worst.bolt}, d' {fmt.fixed(entry.worst.d_prime, 1)}",
        ]
        for entry in plan.responses
    ]
    titles = ["Response", "", "Bits when added, or left out", "Bits alone", "Worst bolt then"]
    parts: list[Markup | None] = [
        tag("p", text),
        legend(chart),
        tag("div", figure(svg(chart), chart.title, chart.subtitle), style=own_size(chart)),
        table("What the planned responses can tell of each bolt", head, rows, text_columns=2),
        table("What each response is worth", titles, worth, text_columns=2),
    ]
    if plan.excitations:
        points: list[list[str | Cell]] = [
            [entry.name, ", ".join(entry.responses), fmt.signed(-entry.gain_bits, 2), fmt.fixed(entry.alone_bits, 1)]
            for entry in plan.excitations
        ]
        parts.append(table("Excitations", ["Excitation", "Planned responses", "Bits without it", "Bits alone"], points, text_columns=2))
    if plan.assumes:
        parts.append(tag("p", "These figures assume: " + "; ".join(plan.assumes) + ".", class_="meta"))
    parts += [tag("p", note, class_="meta") for note in plan.notes]
    return parts
