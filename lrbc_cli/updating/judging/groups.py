"""What the data say on a joint's groups of springs, each alone, and on a joint whose loss they do not exclude."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lrbc_cli.updating.judging.evidence import Change, PartialChange
from lrbc_cli.updating.judging.rule import LOOSE, TIGHT, DecisionRule
from lrbc_cli.updating.normal import normal_cdf
from lrbc_cli.updating.unknowns.springs import LossAlone, SpringsOf


def of_its_groups(posterior: Change, whole: float, own: float, scatter: float, rule: DecisionRule) -> tuple[float, str | None]:
    """Probability that a joint is loose, from that of the whole and of the group that is most probably loose by itself; and a message."""
    part, alone = _most_changed(posterior, own, scatter, rule)
    if part is None or alone <= whole:
        return whole, None
    # Beside loose bolts an error of the model can look like a loose group; the data do not distinguish them.
    found = 0.5 * (whole + alone)
    if rule.word(alone) == rule.word(whole):
        return found, None
    # No standard deviation: the prior, that the groups of a joint change alike, draws the loss of one alone towards none.
    return found, f"only its springs of {part.group} changed, by about {part.mean:.2g} decades or more"


def _most_changed(posterior: Change, own: float, scatter: float, rule: DecisionRule) -> tuple[PartialChange | None, float]:
    """The group of a joint's springs that is most probably loose by itself, and its probability: a joint is no tighter than that.

    The rule is that for the whole joint, with ``hypot(scatter, deviation)`` as the scatter of a single group.
    """
    found: tuple[PartialChange | None, float] = (None, 0.0)
    for part in posterior.parts:
        between = float(np.hypot(scatter, part.deviation))
        limit = rule.limit(own, between, joint=True)
        probability = float(normal_cdf((limit - part.mean) / max(float(np.hypot(part.std, rule.joint_spread * between)), 1e-12)))
        if probability > found[1]:
            found = part, probability
    return found


def _even(ratio: float) -> float:
    """Probability for a log likelihood ratio at even prior odds."""
    return 0.5 + 0.5 * float(np.tanh(0.5 * ratio))


def hidden_groups(posterior: Change, rule: DecisionRule) -> tuple[str, ...]:
    """Groups of a joint's springs of which the data do not exclude, at even prior odds, that they alone are free or loose."""
    lost = (one.of for one in posterior.alone if rule.word(_even(one.ratio)) != TIGHT)
    return tuple(map(str, whole_groups([*map(SpringsOf, posterior.unfelt), *lost])))


def unclear_springs(posterior: Change, rule: DecisionRule) -> dict[SpringsOf, bool]:
    """Springs whose loss alone the data do not exclude; True if, with the rule's confidence, they exclude it less than of a tight joint."""
    return {one.of: _improbable(one, rule) for one in posterior.alone if rule.word(_even(one.ratio)) != TIGHT}


def excluded_groups(posterior: Change, rule: DecisionRule) -> tuple[str, ...]:
    """Groups of springs, and their translations and rotations, whose loss alone the data exclude."""
    return tuple(str(one.of) for one in posterior.alone if rule.word(_even(one.ratio)) == TIGHT)


def _improbable(loss: LossAlone, rule: DecisionRule) -> bool:
    """Whether its ratio is improbably large for a tight joint, where it is normal with mean ``shown`` and variance -2 ``shown``."""
    if loss.shown >= 0.0:
        return False
    return float(normal_cdf((loss.ratio - loss.shown) / np.sqrt(-2.0 * loss.shown))) >= rule.confidence


def whole_groups(springs: Sequence[SpringsOf]) -> tuple[SpringsOf, ...]:
    """The springs without the translations and rotations of a group that is among them."""
    return tuple(one for one in dict.fromkeys(springs) if not one.kind or SpringsOf(one.group) not in springs)


def lost_alone(posterior: Change, rule: DecisionRule) -> dict[str, float]:
    """Groups of springs that the data call loose alone at even prior odds, and log likelihood ratios, largest first."""
    told = {one.of: one.ratio for one in sorted(posterior.alone, key=lambda one: -one.ratio) if rule.word(_even(one.ratio)) == LOOSE}
    return {str(springs): told[springs] for springs in whole_groups(list(told))}


def lost_note(lost: Mapping[str, float]) -> str | None:
    """Message on a joint that is tight as a whole, while the data call some of its springs loose."""
    named = ", or ".join(f"{name} (log likelihood ratio {ratio:.1f})" for name, ratio in lost.items())
    return f"the data say that springs of it alone are loose: {named}" if lost else None


def by_prior(posterior: Change, limit: float, between: float, rule: DecisionRule) -> str | None:
    """Message on a joint that is tight only because few are loose beforehand: at even prior odds the data must say it, too.

    The share of loose joints beforehand is a choice, near enough to the limit of a verdict that a likelihood ratio of 2 would clear a joint
    that hardly affects the FRFs.
    """
    if posterior.ratio is None:
        return None
    even = _even(posterior.ratio) * posterior.below(limit, between, changed=True)
    if rule.word(even) == TIGHT:
        return None
    return f"the data do not exclude that it is loose: at even prior odds the probability is {even:.2g}"


def not_excluded(posterior: Change, rule: DecisionRule) -> str | None:
    """Message on a joint that is tight only if the model is right to within what its residuals show."""
    there = [one.of for one in posterior.alone if rule.word(_even(one.ratio)) != TIGHT]
    every, named = len(there) == len(posterior.alone), ", ".join(map(str, whole_groups(there)))
    if posterior.whole is not None and rule.word(_even(posterior.whole)) != TIGHT:
        found = "errors of the model, of its stiffness in the reference state too, may hide that it is loose"
        return found if every or not there else f"{found}, or that its springs of {named} alone are; the loss of others alone is excluded"
    return f"each of its groups of springs may be loose alone: {named}" if there and every else None
