"""What a set of responses is worth: bolts, responses and excitations as in ``plan.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.campaign.planning.rehearsal import Draw, estimates
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.posterior.information import HIDDEN, LOSS, Experiment, Outlook, bits_of, distances, greedy, outlook, verdict

#: Why nothing can be said of a bolt.
_NOT_FELT = "no identified stiffness at this bolt: it owns no terms, and lies beyond the ends of every edge"
_HELD = "the bounds of the values leave no room for a change"


@dataclass(frozen=True)
class Target:
    """A bolt, or a value along an edge where there are no bolts; its group, arc length of its foot there and unknown (-1: none)."""

    name: str
    position: Floats | None
    group: str | None
    arc_length: float | None
    column: int


@dataclass(frozen=True)
class Prospect:
    """What is asked of the targets at one loss, and what its rehearsals said of each; empty where it was not rehearsed."""

    decades: float
    experiment: Experiment
    draws: Sequence[Sequence[Draw]]


def judged(inputs: Inputs, prospects: Sequence[Prospect], targets: Sequence[Target], doubt: str = "") -> dict[str, Any]:
    """Bolts, responses and excitations of ``plan.json``; with a doubt, why nothing would be judged, no bolt is detectable.

    What an identification would say of a bolt is counted where it was rehearsed, else linearised. What responses are worth is linearised,
    at the loss on which the words rest.
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
    # Bolts that no set of these responses can see would hide what a response does for the others.
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
    """Each bolt at one loss."""
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


#: Probabilities, and the counts that they are estimated from.
_COUNTS = {"right": "loose", "missed": "tight", "alarm": "alarms"}


def _counted(draws: Sequence[Draw]) -> dict[str, Any]:
    """What the rehearsals of one bolt said of it, and which tight bolts they called loose."""
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
    """What each response adds to the planned ones, or what they lose without it; candidates and planned ones each by that."""
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
    """What the planned responses of each excitation tell alone, and what is lost without them."""
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
