"""The plan of a measurement: its chart, its tables on the terminal and its section of the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.drawing.chart import Axis, Chart, Curve, Item, LevelLine, Marks, Panel, Tiles, Word, linear_axis, number
from lrbc_cli.report.drawing.layout import BOTTOM, RIGHT, SMALL, TOP
from lrbc_cli.report.drawing.names import GLYPH
from lrbc_cli.report.drawing.svg import drawn, legend, own_size
from lrbc_cli.report.html import Cell, Markup, beside, table, tag
from lrbc_cli.results.plan import Excitation, PlannedBolt, PlannedLoss, PlanRecord, Visibility, Worst, Worth
from lrbc_cli.results.store import read

VERDICTS: tuple[Visibility, ...] = ("detectable", "marginal", "not detectable")

#: Height of the panel of bolts and of a bar of the ranking [points]; most bars, further responses are in the table only.
_BOLTS, _BAR, _BARS = 190.0, 15.0, 40
#: Most characters of the name of a response beside its bar.
_NAME = 24
_ALL = "with the planned responses and with all"
#: What the columns of responses are.
_BITS = "bits: information about the bolts that a response adds to the planned ones, or that is lost without it; alone: by itself"
#: Most bolts that are named as inconclusive with all bolts tight.
_OPEN = 6
#: Share of the width of a bolt's place that its bars fill.
_FILLED = 0.78


def _along(plan: PlanRecord) -> list[list[PlannedBolt]]:
    """Bolts edge by edge, ordered along each edge; joints group by group."""
    edges: dict[str | None, list[PlannedBolt]] = {}
    for bolt in plan.bolts:
        edges.setdefault(bolt.group, []).append(bolt)
    return [sorted(bolts, key=lambda bolt: math.inf if bolt.arc_length is None else bolt.arc_length) for bolts in edges.values()]


def _moved(plan: PlanRecord) -> str:
    return "tightened" if plan.tightened else "loosened"


def _decades(value: float) -> str:
    return f"{value:g} decade{'' if value == 1.0 else 's'}"


def _draws(count: int) -> str:
    return f"{count} draw{'' if count == 1 else 's'}"


def _counts(plan: PlanRecord) -> str:
    """Numbers of bolts that are detectable, marginal and not detectable, as text."""
    return f"{plan.planned.detectable} detectable, {plan.planned.marginal} marginal, {plan.planned.not_detectable} not detectable"


def _right(loss: PlannedLoss) -> str:
    """Probability of a right verdict as text, with its 95 % interval and the number of draws with this verdict if rehearsed."""
    if loss.rehearsal is None or loss.right95 is None:
        return _plain(loss.right, 2)
    low, high = loss.right95
    return f"{loss.right:.2f} ({low:.2f} to {high:.2f}) {loss.rehearsal.loose}/{loss.rehearsal.draws}"


def _wrong_draws(bolt: PlannedBolt) -> tuple[str, str]:
    """Numbers of draws, over all losses, in which the bolt was called tight and in which a tight bolt was called loose."""
    own = [loss.rehearsal for loss in bolt.losses if loss.rehearsal is not None]
    draws = sum(one.draws for one in own)
    return (f"{sum(one.tight for one in own)}/{draws}", f"{sum(one.alarms for one in own)}/{draws}") if draws else ("", "")


def _alarmed(bolt: PlannedBolt) -> tuple[str, ...]:
    """Tight bolts that were called loose in the rehearsals of this bolt."""
    return tuple(dict.fromkeys(name for loss in bolt.losses if loss.rehearsal is not None for name in loss.rehearsal.alarmed))


def _wrong(plan: PlanRecord) -> str:
    """Text on the number of wrong verdicts among all."""
    missed, alarms = sum(one.missed for one in plan.by_loss), sum(one.alarms for one in plan.by_loss)
    verdicts = sum(one.verdicts for one in plan.by_loss)
    wrong = f"{missed + alarms} of {verdicts} verdicts of the rehearsals wrong"
    return f"{wrong}: {missed} missed (loose, called tight), {alarms} false alarms (tight, called loose)"


def _tight(plan: PlanRecord) -> str:
    """Text on the verdicts if all bolts are tight; empty if that was not rehearsed."""
    found = plan.tight
    if found is None:
        return ""
    open_ = ", ".join(f"{name} in {count}" for name, count in list(found.undecided.items())[:_OPEN])
    more = f" and {len(found.undecided) - _OPEN} others" if len(found.undecided) > _OPEN else ""
    undecided = found.verdicts - found.tight - found.loose
    unvalidated = found.draws - found.validated
    words = [f"{found.tight} tight", f"{undecided} inconclusive{f' ({open_}{more})' if open_ else ''}", f"{found.loose} loose"]
    clear = f"all bolts tightened again: an all-clear in {found.clear} of {_draws(found.draws)}"
    text = f"{clear}; of {found.verdicts} verdicts {', '.join(words)}"
    return f"{text}; not validated in {unvalidated}" if unvalidated else text


def plan_chart(plan: PlanRecord) -> Chart:
    """Return the probability of a right verdict on every bolt at each loss, and below it the information of every response."""
    shown = plan.responses[:_BARS]
    left = max(50.0, 16.0 + GLYPH * SMALL * max((len(fmt.shortened(entry.name, _NAME)) for entry in shown), default=1))
    count = sum(len(edge) for edge in _along(plan)) + 0.5 * (len(_along(plan)) - 1)
    width = float(np.clip(left + RIGHT + 36.0 * count, 560.0, 900.0))
    ranked = 20.0 + _BAR * max(len(shown), 1)
    panels = (_bolts(plan, (width - left - RIGHT) / count, _BOLTS), _ranking(shown, ranked))
    how = f"{_draws(plan.draws)} each" if plan.rehearsed else "linearised"
    subtitle = f"{_counts(plan)} · {how} · errors of {number(plan.noise.sigma_db, 2)} dB per line"
    alt = " ".join(f"{word}: {', '.join(b.name for b in plan.bolts if b.verdict == word) or 'none'}." for word in VERDICTS)
    title = f"Each bolt {_moved(plan)} alone: right verdicts · {fmt.shortened(plan.campaign, 40)}"
    return Chart(title=title, subtitle=subtitle, alt=alt, panels=panels, width=width, height=_BOLTS + ranked + TOP + 2 * BOTTOM, left=left)


def _state(plan: PlanRecord) -> str:
    if plan.state_job is not None:
        return f"around the result of {plan.state_job}"
    words = {"initial": "around the start values", "clamped": "around the upper bounds", "free": "around the lower bounds"}
    return words.get(plan.state, f"around {plan.state}")


def _bolts(plan: PlanRecord, cell: float, weight: float) -> Panel:
    boxes: dict[float, list[tuple[tuple[float, ...], str]]] = {decades: [] for decades in plan.losses}
    wrong: dict[str, list[tuple[float, float]]] = {"missed": [], "alarm": []}
    spans: list[tuple[float, ...]] = []
    ticks: list[tuple[float, str]] = []
    bar, at = _FILLED / len(plan.losses), 0.0
    for edge in _along(plan):
        every = max(1, math.ceil((GLYPH * SMALL * max(len(bolt.name) for bolt in edge) + 3.0) / cell))
        for index, bolt in enumerate(edge):
            for k, loss in enumerate(bolt.losses):
                x = at + 0.5 * (1.0 - _FILLED) + k * bar
                # A bar of height zero stays visible.
                height = max(0.0 if math.isnan(loss.right) else loss.right, 0.012)
                boxes[loss.decades].append(((x, x + 0.92 * bar, 0.0, height), f"{bolt.name}, {_decades(loss.decades)}: {_right(loss)}"))
                if loss.right95 is not None:
                    spans.append((x + 0.46 * bar, *loss.right95))
                if loss.rehearsal is not None:
                    for kind, count in (("missed", loss.rehearsal.tight), ("alarm", loss.rehearsal.alarms)):
                        wrong[kind] += [(x + 0.46 * bar, count / loss.rehearsal.draws)] if count else []
            if index % every == 0:
                ticks.append((at + 0.5, bolt.name))
            at += 1.0
        at += 0.5
    end = at - 0.5
    limit = f" (detectable from {100 * plan.limits.detectable:.0f} %)"
    items: list[Item] = [
        Tiles(
            f"plan-loss{k}",
            np.array([box for box, _ in found]).reshape(-1, 4),
            f"{_decades(decades)} {'gained' if plan.tightened else 'lost'}{limit if decades == plan.loss else ''}",
            tuple(text for _, text in found),
        )
        for k, (decades, found) in enumerate(boxes.items())
    ]
    if spans:
        x, low, high = np.array(spans).T
        gap = np.full(x.size, np.nan)
        items.append(Curve("plan-interval", np.ravel([x, x, x], "F"), np.ravel([low, high, gap], "F"), "95 % interval of these draws"))
    labels = {"missed": "missed (share of draws)", "alarm": "alarm (share of draws)"}
    for kind, places in wrong.items():
        if places:
            x, y = np.array(places).T
            items.append(Marks(role=f"plan-{kind}", x=x, y=y, label=labels[kind]))
    items.append(LevelLine("plan-limit", plan.limits.detectable))
    return Panel(
        x=Axis("", 0.0, end, tuple(ticks)), y=linear_axis("probability of a right verdict", 0.0, 1.0, 5), items=tuple(items), weight=weight
    )


def _ranking(shown: Sequence[Worth], weight: float) -> Panel:
    top = max([entry.gain_bits for entry in shown] + [1e-3])
    boxes: dict[bool, list[tuple[float, ...]]] = {True: [], False: []}
    words: list[Item] = []
    for row, entry in enumerate(shown):
        end = max(entry.gain_bits, 0.0)
        boxes[entry.planned].append((0.0, max(end, 0.002 * top), row + 0.82, row + 0.18))
        words.append(Word(role="text", x=end + 0.012 * top, y=row + 0.5, text=f"{entry.gain_bits:.2f}", size=7.5, anchor="start"))
    items: list[Item] = [
        Tiles("plan-candidate", np.array(boxes[False]).reshape(-1, 4), "below: a candidate, bits it would add" if boxes[False] else ""),
        Tiles("plan-planned", np.array(boxes[True]).reshape(-1, 4), "below: a planned one, bits lost without it" if boxes[True] else ""),
    ]
    x_axis = linear_axis("worth of each response: information about the bolts [bits]", 0.0, 1.12 * top, 6)
    y_axis = Axis(
        "", float(max(len(shown), 1)), 0.0, tuple((row + 0.5, fmt.shortened(entry.name, _NAME)) for row, entry in enumerate(shown))
    )
    return Panel(x=x_axis, y=y_axis, items=(*items, *words), weight=weight)


def draw_plan(output: Path) -> Path | None:
    """Draw ``plan.png`` from ``plan.json``; None if there is no plan.

    Raises
    ------
    DataError
        If the plan is damaged, or the figure cannot be written.
    """
    # Imported here, since matplotlib takes a second to import.
    from lrbc_cli.report.drawing.png import draw

    plan = read(output / "plan.json", PlanRecord)
    if plan is None:
        return None
    file = output / "plan.png"
    draw(plan_chart(plan), file)
    return file


def plan_text(output: Path) -> str:
    """Return the plan as tables in plain ASCII; empty if there is no plan."""
    plan = read(output / "plan.json", PlanRecord)
    if plan is None:
        return ""
    planned = [entry.name for entry in plan.responses if entry.planned]
    asked = ", ".join(f"{decades:g}" for decades in plan.losses)
    lines = [
        f"{_state(plan)}, {plan.lines.count} lines; one bolt at a time {_moved(plan)} by {asked} decades",
        f"errors of {plan.noise.sigma_db:.2g} dB per line, {plan.noise.counted:.2g} lines count as one ({plan.noise.source})",
        _means(plan),
        f"d': distance of the changed FRFs from what other bolts can imitate [standard deviations], {_ALL}",
        "std: standard deviation of a small change [decades]",
        "",
    ]
    head = ["bolt", "verdict", *(f"right at {decades:g}" for decades in plan.losses)]
    head += [*(["missed", "alarm"] if plan.rehearsed else []), f"d' at {plan.loss:g}", "with all", "std"]
    rows = [
        [
            bolt.name,
            bolt.verdict,
            *(_right(loss) for loss in bolt.losses),
            *(_wrong_draws(bolt) if plan.rehearsed else ()),
            _plain(bolt.at(plan.loss).d_prime, 1),
            _plain(bolt.all_responses.d_prime, 1),
            _plain(bolt.std, 2),
        ]
        for bolt in plan.bolts
    ]
    lines += _columns(head, rows, left=2)
    lines += [
        f"with {bolt.name} loosened, a tight bolt was called loose: {', '.join(_alarmed(bolt))}" for bolt in plan.bolts if _alarmed(bolt)
    ]
    notes: dict[str, list[str]] = {}
    for bolt in plan.bolts:
        if bolt.note is not None:
            notes.setdefault(bolt.note, []).append(bolt.name)
    lines += [f"{', '.join(names)}: {note}" for note, names in notes.items()]
    lines += [f"{_counts(plan)} with {', '.join(planned)}", *([_wrong(plan)] if plan.rehearsed else [])]
    lines += [_tight(plan)] if plan.tight is not None else []
    lines += ["", _BITS, *_worths("response", plan.responses, plan.planned.worst)]
    if plan.excitations:
        lines += ["", *_worths("excitation", plan.excitations, None)]
    best = ", ".join(f"{entry.name} ({entry.bits:.1f})" for entry in plan.order[:8])
    lines += ["", f"best response, then the best addition to it, and so on (bits of all so far): {best}"]
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
        rows.append([entry.name, "planned" if planned else "", word, f"{entry.gain_bits:.2f}", f"{entry.alone_bits:.1f}", change])
    worst = "hardest bolt then, d'" if title == "response" else "hardest bolt alone, d'"
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


def _means(plan: PlanRecord) -> str:
    """Explanation of the numbers."""
    asked = f"right: probability that the bolt is called {'tight' if plan.tightened else 'loose'} if it alone has changed by this much"
    if not plan.rehearsed:
        return f"{asked}, by d' (linearised, not rehearsed)"
    return f"{asked} (95 % interval), and draws in which it was; missed: draws with it called tight; alarm: with a tight bolt called loose"


def _explained(plan: PlanRecord) -> str:
    return (
        f"Predicted from the model alone, {_state(plan)}, with errors of {number(plan.noise.sigma_db, 3)} dB per line "
        f"({number(plan.noise.counted, 3)} lines count as one; {plan.noise.source}) on {plan.lines.count} lines. "
        f"Each bolt in turn is {_moved(plan)} alone. {_means(plan)[0].upper()}{_means(plan)[1:]}. "
        "A bolt is detectable if a right verdict has a "
        f"probability of at least {100 * plan.limits.detectable:.0f} % at {_decades(plan.loss)}. d': distance of the "
        "changed FRFs from what the other unknowns can imitate, in standard deviations. Std: that of a small change in the present state, "
        "prior included. "
        f"{_BITS[0].upper()}{_BITS[1:]}."
        + (f" {_wrong(plan)}." if plan.rehearsed else "")
        + (f" {_tight(plan)[0].upper()}{_tight(plan)[1:]}." if plan.tight is not None else "")
    )


def plan_parts(plan: PlanRecord) -> list[Markup | None]:
    """Return the parts of the section: explanation, chart, bolts, responses, excitations."""
    chart = plan_chart(plan)
    rows: list[list[str | Cell]] = [
        [
            bolt.name,
            bolt.verdict,
            *(_right(loss) for loss in bolt.losses),
            *(_wrong_draws(bolt) if plan.rehearsed else ()),
            fmt.fixed(bolt.at(plan.loss).d_prime, 1),
            fmt.fixed(bolt.all_responses.d_prime, 1),
            fmt.fixed(bolt.std, 2),
            bolt.note or (f"called loose with it: {', '.join(_alarmed(bolt))}" if _alarmed(bolt) else ""),
        ]
        for bolt in plan.bolts
    ]
    head = [
        "Bolt",
        "Verdict",
        *(f"Right at {_decades(decades)}" for decades in plan.losses),
        *(["Missed", "Alarm"] if plan.rehearsed else []),
    ]
    head += ["d'", "d' with all responses", "Std [decades]", "Note"]
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
    titles = ["Response", "Role", "Bits added, or lost without it", "Bits alone", "Hardest bolt then"]
    parts: list[Markup | None] = [
        tag("p", _explained(plan)),
        legend(chart),
        tag("div", drawn(chart, beside(("", "plan.png"), ("", "plan.csv"))), style=own_size(chart)),
        table("Detectability of each bolt with the planned responses", head, rows, text_columns=2),
        table("Information from each response", titles, worth, text_columns=2),
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
