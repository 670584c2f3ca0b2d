"""Figures of ``plan.json``: how well each bolt is detected, and what each response and excitation contributes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lrbc_cli.arrays import Bools, Floats
from lrbc_cli.campaign.planning.draws import Draw, TightDraw, estimates
from lrbc_cli.campaign.planning.rehearsal import by_rule
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.results import plan
from lrbc_cli.updating.judging.rule import LOOSE, TIGHT, UNDECIDED
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


def judged(
    inputs: Inputs, prospects: Sequence[Prospect], targets: Sequence[Target], doubt: str = "", *, joints: bool | None = None
) -> dict[str, Any]:
    """The fields of ``PlanRecord`` on bolts, responses and excitations; no bolt is detectable with a ``doubt``, why none would be judged.

    Probabilities of bolts are counted from rehearsals if there are any, else linearised. Contributions of responses are linearised, at the
    loss ``LOSS`` on which the verdicts detectable, marginal and not detectable rest. With ``joints`` (whether all bolts are joints) a
    linearised probability is no larger than what the rule of a verdict allows; None if no bolt is judged.
    """
    confidence, used = inputs.method.rule.confidence, inputs.used
    main = next(one for one in prospects if one.decades == LOSS)
    found, every = main.experiment, np.arange(main.experiment.responses)
    now, best = outlook(found, used, confidence), outlook(found, every, confidence)
    said = {}
    for one in prospects:
        linear = outlook(one.experiment, used, confidence)
        if joints is not None:
            allowed = by_rule(inputs, one.experiment.change, now.std, joints=joints)
            linear = replace(linear, correct=np.where(np.isfinite(allowed), np.minimum(linear.correct, allowed), 0.0))
        said[one.decades] = _losses(one, linear)
    words = [verdict(0.0 if doubt else loss.right) for loss in said[LOSS]]
    bolts = tuple(
        plan.PlannedBolt.like(
            target,
            verdict=words[n],
            std=now.std[n],
            variance_removed=now.removed[n],
            losses=tuple(losses[n] for losses in said.values()),
            all_responses=plan.WithAll(d_prime=best.distance[n], std=best.std[n]),
            note=(doubt or None) if target.column >= 0 and found.change[n] else _HELD if target.column >= 0 else _NOT_FELT,
        )
        for n, target in enumerate(targets)
    )
    # Bolts that all responses together cannot detect are left out of the worst case: they would hide what a response contributes.
    seen = best.correct >= HIDDEN
    return {
        "bolts": bolts,
        "by_loss": tuple(_by_loss(decades, losses) for decades, losses in said.items()),
        "planned": plan.PlannedSum(
            bits=now.bits,
            worst=_worst(now.distance, seen, targets),
            detectable=words.count("detectable"),
            marginal=words.count("marginal"),
            not_detectable=words.count("not detectable"),
        ),
        "all_responses": plan.Sum(bits=best.bits, worst=_worst(best.distance, seen, targets)),
        "responses": _responses(inputs, found, now, seen, targets),
        "order": tuple(
            plan.Chosen(name=inputs.responses[r].name, bits=bits_of(distance), worst=_worst(distance, seen, targets))
            for r, distance in greedy(found)
        ),
        "excitations": _excitations(inputs, found, now, seen, targets) if len(inputs.excitations) > 1 else (),
    }


def _losses(prospect: Prospect, linear: Outlook) -> list[plan.PlannedLoss]:
    """Predictions for all bolts of one loss: probabilities from rehearsals where there are any."""
    counted = {n: _counted(draws) for n, draws in enumerate(prospect.draws) if draws}
    draws = [one.draws for one in counted.values()]
    right, missed, alarm = (estimates([getattr(one, count) for one in counted.values()], draws) for count in ("loose", "tight", "alarms"))
    at = {n: k for k, n in enumerate(counted)}
    return [
        plan.PlannedLoss(
            decades=prospect.decades,
            change=change,
            d_prime=distance,
            right=right[0][at[n]] if n in at else correct,
            right95=tuple(right[1][at[n]]) if n in at else None,
            missed=missed[0][at[n]] if n in at else float("nan"),
            alarm=alarm[0][at[n]] if n in at else float("nan"),
            linearised=correct,
            rehearsal=counted.get(n),
        )
        for n, (change, distance, correct) in enumerate(zip(prospect.experiment.change, linear.distance, linear.correct, strict=True))
    ]


def _counted(draws: Sequence[Draw]) -> plan.Rehearsals:
    """Counts of the verdicts in the rehearsals of one bolt, and of the tight bolts that were called loose."""
    alarms = [name for draw in draws for name in draw.alarms]
    words = [draw.verdict for draw in draws]
    return plan.Rehearsals(
        draws=len(draws),
        loose=words.count("loose"),
        undecided=words.count("undecided"),
        tight=words.count("tight"),
        alarms=sum(bool(draw.alarms) for draw in draws),
        alarmed={name: alarms.count(name) for name in dict.fromkeys(alarms)},
        judged=sum(draw.judged for draw in draws),
        change=np.array([draw.change for draw in draws]),
        probability_loose=np.array([draw.probability for draw in draws]),
    )


def tightened(draws: Sequence[TightDraw]) -> plan.PlannedTight | None:
    """Counts of the verdicts in rehearsals with all bolts tight; None if there are none."""
    if not draws:
        return None
    words = [(name, word) for draw in draws for name, word in draw.verdicts.items()]
    said = [word for _, word in words]
    undecided = [name for name, word in words if word == UNDECIDED]
    return plan.PlannedTight(
        draws=len(draws),
        clear=sum(draw.clear for draw in draws),
        validated=sum(draw.validated for draw in draws),
        verdicts=len(words),
        tight=said.count(TIGHT),
        loose=said.count(LOOSE),
        undecided={name: undecided.count(name) for name in sorted(set(undecided), key=lambda one: -undecided.count(one))},
    )


def _by_loss(decades: float, losses: Sequence[plan.PlannedLoss]) -> plan.LossSum:
    counted = [loss.rehearsal for loss in losses if loss.rehearsal is not None]
    missed = sum(one.tight for one in counted)
    return plan.LossSum(
        decades=decades,
        right=float(np.mean([loss.right for loss in losses])) if losses else float("nan"),
        draws=sum(one.draws for one in counted),
        verdicts=missed + sum(one.loose + one.judged for one in counted),
        missed=missed,
        alarms=sum(sum(one.alarmed.values()) for one in counted),
    )


def _worst(distance: Floats, among: Bools, targets: Sequence[Target]) -> plan.Worst | None:
    at = np.flatnonzero(among)
    if not at.size:
        return None
    n = int(at[np.argmin(distance[at])])
    return plan.Worst(bolt=targets[n].name, d_prime=distance[n])


def _responses(inputs: Inputs, found: Experiment, now: Outlook, seen: Bools, targets: Sequence[Target]) -> tuple[plan.Worth, ...]:
    """Bits that each candidate adds to the planned responses, or that are lost without a planned one; candidates first, by gain."""
    used = inputs.used
    rows = []
    for r, response in enumerate(inputs.responses):
        planned = bool(r in used)
        changed = distances(found, used[used != r] if planned else np.append(used, r))
        rows.append(
            plan.Worth.like(
                response,
                planned=planned,
                excitation=inputs.excitations[response.input],
                gain_bits=now.bits - bits_of(changed) if planned else bits_of(changed) - now.bits,
                alone_bits=bits_of(distances(found, [r])),
                worst=_worst(changed, seen, targets),
            )
        )
    return tuple(sorted(rows, key=lambda row: (row.planned, -row.gain_bits)))


def _excitations(inputs: Inputs, found: Experiment, now: Outlook, seen: Bools, targets: Sequence[Target]) -> tuple[plan.Excitation, ...]:
    """Bits of the planned responses of each excitation alone, and bits that are lost without them."""
    rows = []
    for load, name in enumerate(inputs.excitations):
        members = np.flatnonzero(inputs.input_of == load)
        own = np.intersect1d(inputs.used, members)
        alone = distances(found, own)
        rows.append(
            plan.Excitation(
                name=name,
                responses=tuple(inputs.responses[r].name for r in own),
                alone_bits=bits_of(alone),
                gain_bits=now.bits - bits_of(distances(found, np.setdiff1d(inputs.used, members))),
                all_bits=bits_of(distances(found, members)),
                worst=_worst(alone, seen, targets),
            )
        )
    return tuple(rows)
