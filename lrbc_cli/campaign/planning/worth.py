"""What a set of responses is worth: bolts, responses and excitations as in ``plan.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lrbc_cli.arrays import Bools, Floats, Integers
from lrbc_cli.campaign.planning.rehearsal import Draw, promised, threshold
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.confidence import NORMAL_95
from lrbc_cli.updating.information import Experiment, Outlook, bits_of, distances, expectation, greedy, outlook, verdict

#: Why nothing can be said of a bolt.
_NOT_FELT = "no identified spring near this bolt: it lies beyond the ends of the edge"
_HELD = "the bounds of the values leave no room for a change"


@dataclass(frozen=True)
class Target:
    """A bolt, or a value along an edge where there are no bolts; its group, arc length of its foot there and unknown (-1: none)."""

    name: str
    position: Floats | None
    group: str | None
    arc_length: float | None
    column: int


def judged(inputs: Inputs, found: Experiment, targets: Sequence[Target], draws: Mapping[int, Sequence[Draw]]) -> dict[str, Any]:
    """Bolts, responses and excitations of ``plan.json``.

    What an identification would say of a bolt is counted where it was rehearsed, else linearised.
    """
    update, used = inputs.campaign.update, inputs.used
    every = np.arange(found.responses)
    now, best = outlook(found, used, update.confidence), outlook(found, every, update.confidence)
    expected, loose = expectation(found, threshold(inputs))
    bolts, words = [], []
    for n, target in enumerate(targets):
        felt = target.column >= 0
        own = draws.get(n, ())
        correct = promised(own) if own else float(now.correct[n])
        words.append(verdict(correct))
        note = None if felt and found.change[n] else (_HELD if felt else _NOT_FELT)
        bolts.append(
            {
                "name": target.name,
                "position": target.position,
                "group": target.group,
                "arc_length": target.arc_length,
                "verdict": words[-1],
                "d_prime": now.distance[n],
                "probability_correct": correct,
                "std": now.std[n],
                "lower95": -NORMAL_95 * now.std[n],
                "upper95": NORMAL_95 * now.std[n],
                "variance_removed": now.removed[n],
                "change": found.change[n],
                "expected_change": _mean([draw.change for draw in own]) if own else expected[n],
                "expected_probability_loose": _mean([draw.probability for draw in own]) if own else loose[n],
                "rehearsal": _counted(own) if own else None,
                "linearised": {
                    "probability_correct": now.correct[n],
                    "expected_change": expected[n],
                    "expected_probability_loose": loose[n],
                },
                "all_responses": {"verdict": verdict(best.correct[n]), "d_prime": best.distance[n], "std": best.std[n]},
                "note": note,
            }
        )
    # Bolts that no set of these responses can see would hide what a response does for the others.
    seen = np.array([verdict(value) != "blind" for value in best.correct])
    tree: dict[str, Any] = {"bolts": bolts, "planned": _sum(now, words, seen, targets)}
    tree["all_responses"] = _sum(best, [verdict(value) for value in best.correct], seen, targets)
    tree["responses"] = _responses(inputs, found, now, seen, targets)
    chosen: list[dict[str, Any]] = []
    for r, distance in greedy(found):
        chosen.append({"name": inputs.responses[r].name, "bits": bits_of(distance), "worst": _worst(distance, seen, targets)})
    tree["order"] = chosen
    tree["excitations"] = [
        _set(inputs, found, now, seen, targets, name, np.flatnonzero(inputs.input_of == load))
        for load, name in enumerate(inputs.excitations)
        if len(inputs.excitations) > 1
    ]
    return tree


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def _counted(draws: Sequence[Draw]) -> dict[str, Any]:
    """What the rehearsals of one bolt said of it, and which tight bolts they called loose."""
    others = [name for draw in draws for name in draw.others]
    return {
        "draws": len(draws),
        **{word: sum(draw.verdict == word for draw in draws) for word in ("loose", "undecided", "tight")},
        "right": sum(draw.right for draw in draws),
        "wrong": sum(draw.wrong for draw in draws),
        "others_loose": {name: others.count(name) for name in dict.fromkeys(others)},
        "change": [draw.change for draw in draws],
        "probability_loose": [draw.probability for draw in draws],
    }


def _sum(what: Outlook, words: Sequence[str], seen: Bools, targets: Sequence[Target]) -> dict[str, Any]:
    counts = {word: words.count(word) for word in ("seen", "weak", "blind")}
    return counts | {"bits": what.bits, "worst": _worst(what.distance, seen, targets)}


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


def _set(
    inputs: Inputs,
    found: Experiment,
    now: Outlook,
    seen: Bools,
    targets: Sequence[Target],
    name: str,
    members: Integers,
) -> dict[str, Any]:
    """What the planned responses of one excitation tell alone, and what is lost without them."""
    used = inputs.used
    own = np.intersect1d(used, members)
    alone = distances(found, own)
    return {
        "name": name,
        "responses": [inputs.responses[r].name for r in own],
        "alone_bits": bits_of(alone),
        "gain_bits": now.bits - bits_of(distances(found, np.setdiff1d(used, members))),
        "all_bits": bits_of(distances(found, members)),
        "worst": _worst(alone, seen, targets),
    }
