"""From settings and facts of a campaign to the method: frozen, all decided, with the reason of each choice.

Execution is no part of it: back end, workers, and which of two formulas that give the same FRFs serves (``formula``).
Values that depend on the FRFs themselves (``initial: auto``, ``bounds: auto``) follow from ``statistics.limits``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

from lrbc_cli.config.settings import UpdateConfig
from lrbc_cli.method.rule import rule_of
from lrbc_cli.updating.judging.rule import DecisionRule
from lrbc_cli.updating.statistics.model import STATISTICS, StatisticalModel
from lrbc_cli.updating.statistics.residuals import ResidualOptions

#: Why joints have a wider prior.
JOINTS = "nothing beside a joint holds what it held: one that is finger-tight loses two decades"

Approach = Literal["bolts", "paper"]
Noise = Literal["coherence", "scatter", "none"]


@dataclass(frozen=True)
class Facts:
    """What a resolution needs to know of a campaign besides its settings.

    Attributes
    ----------
    reference : bool
        There is a reference job, or one will be measured.
    bolts : bool
        The places of the bolts are known.
    joints : bool
        Some of them own their terms.
    """

    reference: bool
    bolts: bool
    joints: bool = False


@dataclass(frozen=True, kw_only=True)
class Method:
    """How jobs are identified.

    Attributes
    ----------
    approach : str
        ``bolts``: changes against the reference job, at bolts where they are known; ``paper``: values along the edge, drawn to their start
        values. The reference job itself is always identified by values along the edge.
    regularisation : float or str
        Weight eta of the penalty [dB² per decade²]; ``noise``: from the residuals and the priors; ``l-curve``: at its corner.
    optimiser : str
        ``gauss-newton`` or ``bfgs``.
    tolerance, max_iterations : float, int
        Its stop rule.
    relative : bool
        Measurements are corrected by the model discrepancy of the reference state.
    mixture : bool
        Bolts are judged by sampled changes, each tight or loose.
    weighted : bool
        Lines are weighted by what is known of their noise, see ``noise_source``, and by errors of predicted changes.
    residual : ResidualOptions
    lines : str or mapping
        As in the campaign file.
    responses : tuple of str or None
        Those that are fitted; all where None.
    nuisances : mapping of str to float
        Standard deviations of what may drift, by key of the campaign file.
    full_order : bool
        FRFs are those of the full model.
    statistics : StatisticalModel
    rule : DecisionRule
        Stands beside the method in a result, and is no part of the digest: it changes no identification.
    reasons : mapping of str to str
        Why each choice was made, by field; no part of the identity.
    warnings : tuple of str
        Settings that are not used.
    """

    approach: Approach
    regularisation: float | Literal["noise", "l-curve"]
    optimiser: Literal["gauss-newton", "bfgs"]
    tolerance: float
    max_iterations: int
    relative: bool
    mixture: bool
    weighted: bool
    residual: ResidualOptions
    lines: Any
    responses: tuple[str, ...] | None
    nuisances: Mapping[str, float]
    full_order: bool
    statistics: StatisticalModel = STATISTICS
    rule: DecisionRule = field(default_factory=DecisionRule, compare=False)
    reasons: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)
    warnings: tuple[str, ...] = field(default=(), compare=False, repr=False)

    @property
    def prior_std(self) -> str:
        """Standard deviations of the changes in words."""
        values = self.statistics.values
        return f"{values.joint_std:g} for joints" + ("" if values.joint_std == values.std else f", {values.std:g} along edges")

    @property
    def follows_noise(self) -> bool:
        """Whether the weight of the prior follows the noise of the residuals."""
        return self.regularisation == "noise"

    def tree(self) -> dict[str, Any]:
        """``method`` of ``result.json``: all fields but the rule as plain values, reasons included."""
        found = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name != "rule"}
        found |= {"residual": asdict(self.residual), "statistics": asdict(self.statistics)}
        return found | {"nuisances": dict(self.nuisances), "reasons": dict(self.reasons)}

    @property
    def digest(self) -> str:
        """Digest of everything but statistics, rule, reasons and warnings: what identifications rest on besides model and measurement."""
        tree = {key: value for key, value in self.tree().items() if key not in ("statistics", "reasons", "warnings")}
        return hashlib.sha256(json.dumps(tree, sort_keys=True).encode()).hexdigest()[:32]

    @property
    def choices(self) -> list[str]:
        """One line a choice: what, and why."""
        words = {True: "yes", False: "no"}
        shown = ((name, getattr(self, name), reason) for name, reason in self.reasons.items())
        return [f"{name}: {words[value] if isinstance(value, bool) else value} ({reason})" for name, value, reason in shown]


def resolve(update: UpdateConfig, facts: Facts, statistics: StatisticalModel = STATISTICS) -> Method:
    """Decide.

    Parameters
    ----------
    update : UpdateConfig
    facts : Facts
    statistics : StatisticalModel
        Its prior of values takes the standard deviation of the settings where one is given.

    Returns
    -------
    Method
    """
    approach, why = _approach(update, facts)
    by_bolts = approach == "bolts"
    reasons, warnings = {"approach": why}, list[str]()
    given = update.regularisation
    regularisation: float | Literal["noise", "l-curve"] = "noise" if by_bolts or given == "auto" else given
    if by_bolts:
        reasons["regularisation"] = "the weight of the prior follows the residuals"
        if given != "auto":
            warnings.append(f"update.regularisation: {given} is a weight of values along the edge, for approach: paper, and not used")
    else:
        reasons["regularisation"] = "no weight is given: it follows the residuals" if given == "auto" else "as given"
    optimiser = "gauss-newton" if by_bolts else update.method
    reasons["optimiser"] = "as given" if optimiser == update.method else "bfgs keeps to the nearest basin"
    if optimiser != update.method:
        warnings.append(f"update.method: {update.method} is for approach: paper, and not used")
    follows = regularisation == "noise"
    weighted = follows and update.weights == "auto"
    reasons["weighted"] = (
        "noise of the lines counts where coherence or repeats tell it, against the model discrepancy"
        if weighted
        else ("update.weights: none" if follows else "without a noise variance that follows the residuals nothing weighs against it")
    )
    mixture, relative = by_bolts and facts.bolts, by_bolts and facts.bolts and weighted
    reasons |= _comparison(mixture, relative)
    if by_bolts and facts.joints:
        reasons["prior_std"] = JOINTS if update.prior_std == "auto" else "as given"
    return Method(
        approach=approach,
        regularisation=regularisation,
        optimiser=optimiser,
        # Of the paper, on the log10 of the sum; of Gauss-Newton on the sum itself.
        tolerance=update.tolerance or (1e-4 if optimiser == "gauss-newton" else 1e-3),
        max_iterations=update.max_iterations,
        relative=relative,
        mixture=mixture,
        weighted=weighted,
        residual=ResidualOptions(update.residual, update.loss_scale if update.loss == "soft" else None, update.floor),
        lines=update.lines if isinstance(update.lines, str) else update.lines.model_dump(mode="json", by_alias=True),
        responses=update.responses,
        nuisances={name: value for name, value in update.nuisances if value is not None},
        full_order=update.evaluation == "full",
        statistics=_with_prior(update, statistics),
        rule=rule_of(update),
        reasons=reasons,
        warnings=(*warnings, *_without_effect(update, facts, follows)),
    )


def _with_prior(update: UpdateConfig, statistics: StatisticalModel) -> StatisticalModel:
    std = update.prior_std
    return statistics if std == "auto" else replace(statistics, values=replace(statistics.values, std=std, joint_std=std))


def _without_effect(update: UpdateConfig, facts: Facts, follows: bool) -> Iterator[str]:
    """Further settings that were given where nothing reads them."""
    given = update.model_fields_set
    if not follows and update.prior_std != "auto":
        yield f"update.prior_std: {update.prior_std:g} weighs no values, because update.regularisation: {update.regularisation} does"
    if not follows and "weights" in given and update.weights == "auto":
        yield f"update.weights: auto weighs no lines beside update.regularisation: {update.regularisation}, and is not used"
    if update.loss == "squares" and "loss_scale" in given:
        yield f"update.loss_scale: {update.loss_scale:g} is of loss: soft, and not used"
    if "room" in update.nuisances.model_fields_set and update.nuisances.temperature is None:
        yield f"update.nuisances.room: {update.nuisances.room:g} is what nuisances.temperature varies about; without that it is not used"
    if not facts.bolts:
        for key in ("baselines", "confidence", "loose_change"):
            if key in given and getattr(update, key):
                yield f"update.{key} is for verdicts on bolts, and not used: the campaign names none (`bolts`)"


def _comparison(mixture: bool, relative: bool) -> dict[str, str]:
    """Reasons of ``relative`` and ``mixture``."""
    if not mixture:
        return dict.fromkeys(("relative", "mixture"), "no changes at bolts are sought")
    why = "most of the model discrepancy is that of the reference state" if relative else "errors of changes need weights"
    return {"relative": why, "mixture": "each bolt is tight or loose"}


def _approach(update: UpdateConfig, facts: Facts) -> tuple[Approach, str]:
    if update.approach is not None:
        return update.approach, "as given"
    if not facts.reference:
        return "paper", "no reference job to compare with"
    if update.regularisation != "auto":
        return "paper", f"regularisation: {update.regularisation} is a weight of values along the edge"
    if update.method == "bfgs":
        return "paper", "method: bfgs is the paper's"
    return "bolts", "there is a reference job to compare with"


def noise_source(method: Method, *, coherent: bool, repeated: bool) -> Noise:
    """From what the noise of the lines of one measurement is known.

    Parameters
    ----------
    method : Method
    coherent : bool
        There are coherences of more than one average.
    repeated : bool
        There are repeated measurements.

    Returns
    -------
    str
        ``coherence``, ``scatter`` or ``none``.
    """
    if not method.weighted:
        return "none"
    return "coherence" if coherent else "scatter" if repeated else "none"


def formula(evaluation: str, terms: int, size: int) -> str:
    """By what FRFs are evaluated; ``auto`` takes the cheaper: a solve of order nt, or one of order r, each with its right-hand sides.

    Parameters
    ----------
    evaluation : str
        Of the settings.
    terms, size : int
        nt, and the order r of the reduced model.

    Returns
    -------
    str
        ``port``, ``reduced`` or ``full``.
    """
    return evaluation if evaluation != "auto" else "port" if terms <= size else "reduced"
