"""Figures of ``plan.json``: how well each bolt is detected, and what each response and excitation contributes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.campaign.planning.rehearsal import Draw, estimates
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.posterior.information import HIDDEN, LOSS, Experiment, Outlook, bits_of, distances, greedy, outlook, verdict

#: Reasons why a bolt cannot be judged.
_NOT_FELT = "no identified stiffness at this bolt: it owns no terms, and lies beyond the ends of every edge"
_HELD = "the bounds of the values leave no room for a change"


@dataclass(frozen=True)
class Target:
    """A bolt, or a value along an edge if there are no bolts: position and arc length of its foot [m], column of T (-1: none)."""

    name: str
    position: Floats | None
    group: str | None
    arc_length: float | None
    column: int


@dataclass(frozen=True)
class Prospect:
    """One loss of all targets [decades]: linearised experiment, and rehearsals of each target (empty if not rehearsed)."""

    decades: float
    experiment: Experiment
    draws: Sequence[Sequence[Draw]]


def judged(inputs: Inputs, prospects: Sequence[Prospect], targets: Sequence[Target], doubt: str = "") -> dict[str, Any]:
    """Bolts, responses and excitations of ``plan.json``; with a ``doubt`` (why nothing would be judged) no bolt is detectable.

    Probabilities of bolts are counted from rehearsals if there are any, else linearised. Contributions of responses are linearised, at the
    loss ``LOSS`` on which the verdicts detectable, marginal and not detectable rest.
    """
    update, used = inputs.campaign.update, inputs.used
    main = next(one for one in prospects if one.decades == LOSS)
    found, every = main.experiment, np.arange(main.experiment.responses)
    now, best = outlook(found, used, update.confidence), outlook(found, every, update.confidence)
    said = {one.decades: _losses(one, outlook(one.experiment, used, update.confidence)) for one in prospects}
    words = [verdict(0.0 if doubt else entry["right"]) for entry in said[LOSS]]
    bolts = [
        {
            "name": target.name,
            "position": target.position,
            "group": target.group,
            "arc_length": target.arc_length,
            "verdict": words[n],
            "std": now.std[n],
            "variance_removed": now.removed[n],
            "losses": [entries[n] for entries in said.values()],
            "all_responses": {"d_prime": best.distance[n], "std": best.std[n]},
            "note": (doubt or None) if target.column >= 0 and found.change[n] else _HELD if target.column >= 0 else _NOT_FELT,
        }
        for n, target in enumerate(targets)
    ]
    # Bolts that all responses together cannot detect are left out of the worst case: they would hide what a response contributes.
    seen = best.correct >= HIDDEN
    counts = {word.replace(" ", "_"): words.count(word) for word in ("detectable", "marginal", "not detectable")}
    tree: dict[str, Any] = {"bolts": bolts, "by_loss": [_by_loss(one.decades, said[one.decades]) for one in prospects]}
    tree["planned"] = counts | {"bits": now.bits, "worst": _worst(now.distance, seen, targets)}
    tree["all_responses"] = {"bits": best.bits, "worst": _worst(best.distance, seen, targets)}
    tree["responses"] = _responses(inputs, found, now, seen, targets)
    tree["order"] = [
        {"name": inputs.responses[r].name, "bits": bits_of(distance), "worst": _worst(distance, seen, targets)}
        for r, distance in greedy(found)
    ]
    tree["excitations"] = _excitations(inputs, found, now, seen, targets) if len(inputs.excitations) > 1 else []
    return tree


def _losses(prospect: Prospect, linear: Outlook) -> list[dict[str, Any]]:
    """Entries of all bolts for one loss."""
    entries: list[dict[str, Any]] = [
        {
            "decades": prospect.decades,
            "change": change,
            "d_prime": distance,
            "right": correct,
            "linearised": correct,
            "missed": None,
            "alarm": None,
        }
        for change, distance, correct in zip(prospect.experiment.change, linear.distance, linear.correct, strict=True)
    ]
    at = [n for n, draws in enumerate(prospect.draws) if draws]
    counted = [_counted(prospect.draws[n]) for n in at]
    draws = [one["draws"] for one in counted]
    figures = {key: estimates([one[what] for one in counted], draws) for key, what in _COUNTS.items()}
    for k, n in enumerate(at):
        entries[n] |= {key: value[k] for key, (value, _) in figures.items()}
        entries[n] |= {"right95": figures["right"][1][k], "rehearsal": counted[k]}
    return entries


#: Probabilities, and the counts from which they are estimated.
_COUNTS = {"right": "loose", "missed": "tight", "alarm": "alarms"}


def _counted(draws: Sequence[Draw]) -> dict[str, Any]:
    """Counts of the verdicts in the rehearsals of one bolt, and of the tight bolts that were called loose."""
    alarms = [name for draw in draws for name in draw.alarms]
    return {
        "draws": len(draws),
        **{word: sum(draw.verdict == word for draw in draws) for word in ("loose", "undecided", "tight")},
        "alarms": sum(bool(draw.alarms) for draw in draws),
        "alarmed": {name: alarms.count(name) for name in dict.fromkeys(alarms)},
        "judged": sum(draw.judged for draw in draws),
        "change": [draw.change for draw in draws],
        "probability_loose": [draw.probability for draw in draws],
    }


def _by_loss(decades: float, entries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    counted = [entry["rehearsal"] for entry in entries if "rehearsal" in entry]
    missed = sum(one["tight"] for one in counted)
    return {
        "decades": decades,
        "right": float(np.mean([entry["right"] for entry in entries])) if entries else float("nan"),
        "draws": sum(one["draws"] for one in counted),
        "verdicts": missed + sum(one["loose"] + one["judged"] for one in counted),
        "missed": missed,
        "alarms": sum(sum(one["alarmed"].values()) for one in counted),
    }


def _worst(distance: Floats, among: Bools, targets: Sequence[Target]) -> dict[str, Any] | None:
    at = np.flatnonzero(among)
    if not at.size:
        return None
    n = int(at[np.argmin(distance[at])])
    return {"bolt": targets[n].name, "d_prime": distance[n]}


def _responses(inputs: Inputs, found: Experiment, now: Outlook, seen: Bools, targets: Sequence[Target]) -> list[dict[str, Any]]:
    """Bits that each candidate adds to the planned responses, or that are lost without a planned one; candidates first, by gain."""
    used = inputs.used
    rows = []
    for r, response in enumerate(inputs.responses):
        planned = bool(r in used)
        changed = distances(found, used[used != r] if planned else np.append(used, r))
        rows.append(
            {
                "name": response.name,
                "planned": planned,
                "excitation": inputs.excitations[response.input],
                "quantity": response.quantity,
                "gain_bits": now.bits - bits_of(changed) if planned else bits_of(changed) - now.bits,
                "alone_bits": bits_of(distances(found, [r])),
                "worst": _worst(changed, seen, targets),
            }
        )
    return sorted(rows, key=lambda row: (row["planned"], -row["gain_bits"]))


def _excitations(inputs: Inputs, found: Experiment, now: Outlook, seen: Bools, targets: Sequence[Target]) -> list[dict[str, Any]]:
    """Bits of the planned responses of each excitation alone, and bits that are lost without them."""
    rows = []
    for load, name in enumerate(inputs.excitations):
        members = np.flatnonzero(inputs.input_of == load)
        own = np.intersect1d(inputs.used, members)
        alone = distances(found, own)
        rows.append(
            {
                "name": name,
                "responses": [inputs.responses[r].name for r in own],
                "alone_bits": bits_of(alone),
                "gain_bits": now.bits - bits_of(distances(found, np.setdiff1d(inputs.used, members))),
                "all_bits": bits_of(distances(found, members)),
                "worst": _worst(alone, seen, targets),
            }
        )
    return rows
