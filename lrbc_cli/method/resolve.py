"""``resolve`` decides from the settings and facts of a campaign how jobs are identified (``Method``), with the reason for each choice.

Execution is not part of the method: sparse solver, workers, and which of two formulas for the same FRFs is evaluated (``formula``).
Values that depend on the FRFs (``initial: auto``, ``bounds: auto``) are determined later, by ``statistics.limits``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

from lrbc_cli.config import Campaign
from lrbc_cli.config.settings import Lines, NuisanceConfig, UpdateConfig
from lrbc_cli.method.rule import rule_of
from lrbc_cli.updating.checked import Checked, Count, Inside, NotNegative
from lrbc_cli.updating.judging.rule import DecisionRule
from lrbc_cli.updating.own_code import code_of
from lrbc_cli.updating.statistics.model import STATISTICS, StatisticalModel
from lrbc_cli.updating.statistics.residuals import ResidualOptions

#: Why joints have a wider prior.
JOINTS = "nothing beside a joint takes over its stiffness: a finger-tight joint loses two decades"

Approach = Literal["bolts", "paper"]
Noise = Literal["coherence", "scatter", "none"]


@dataclass(frozen=True)
class Facts:
    """Facts about a campaign, besides its settings, on which the method depends.

    Attributes
    ----------
    reference : bool
        There is a reference job, or one will be measured.
    bolts : bool
        The campaign lists bolts.
    joints : bool
        Some bolts own their terms.
    """

    reference: bool
    bolts: bool
    joints: bool = False


@dataclass(frozen=True, kw_only=True)
class Method(Checked):
    """How jobs are identified: all settings resolved.

    Attributes
    ----------
    approach : str
        ``bolts``: changes against the reference job, at bolts if the campaign lists them; ``paper``: values along the edge, drawn to their
        start values. The reference job itself is always identified by values along the edge.
    regularisation : float or str
        Weight eta of the penalty [dB² per decade²]; ``noise``: from the residuals and the priors; ``l-curve``: at the L-curve's corner.
    optimiser : str
        ``gauss-newton`` or ``bfgs``.
    tolerance, max_iterations : float, int
        Stop rule of the optimiser.
    relative : bool
        Measurements are corrected by the model discrepancy of the reference state.
    mixture : bool
        The posterior of each bolt's change is sampled as a mixture of tight and loose.
    weighted : bool
        Lines are weighted by their noise, if known (``noise_source``), and by errors of predicted changes.
    residual : ResidualOptions
    lines : str, EveryLine or ListedLines
        Lines compared, as in the campaign file.
    responses : tuple of str or None
        Responses that are fitted; None: all.
    nuisances : NuisanceConfig
        Prior standard deviations of the nuisance parameters, as in the campaign file.
    full_order : bool
        FRFs are computed with the full model.
    statistics : StatisticalModel
    rule : DecisionRule
        Kept beside the method in a result; not part of the digest, since it changes no identification.
    reasons : mapping of str to str
        Reason for each choice, by field; ignored in comparisons.
    warnings : tuple of str
        Settings that have no effect; ignored in comparisons.
    """

    approach: Approach
    regularisation: NotNegative | Literal["noise", "l-curve"]
    optimiser: Literal["gauss-newton", "bfgs"]
    tolerance: Inside
    max_iterations: Count
    relative: bool
    mixture: bool
    weighted: bool
    residual: ResidualOptions
    lines: Lines
    responses: tuple[str, ...] | None
    nuisances: NuisanceConfig
    full_order: bool
    statistics: StatisticalModel = STATISTICS
    rule: DecisionRule = field(default_factory=DecisionRule, compare=False)
    reasons: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)
    warnings: tuple[str, ...] = field(default=(), compare=False, repr=False)

    @property
    def prior_std(self) -> str:
        """Prior standard deviations of the changes, as text."""
        values = self.statistics.values
        return f"{values.joint_std:g} for joints" + ("" if values.joint_std == values.std else f", {values.std:g} along edges")

    @property
    def follows_noise(self) -> bool:
        """Whether the weight of the prior follows the noise of the residuals."""
        return self.regularisation == "noise"

    def tree(self) -> dict[str, Any]:
        """The entry ``method`` of ``result.json``: all fields except the rule, including reasons, as plain values."""
        found = {entry.name: getattr(self, entry.name) for entry in fields(self) if entry.name != "rule"}
        lines = self.lines if isinstance(self.lines, str) else self.lines.model_dump(mode="json", by_alias=True)
        own = self.residual.loss
        loss = {} if own is None else {"loss": {"class": type(own).__qualname__, **asdict(own)}}
        residual = {key: value for key, value in asdict(self.residual).items() if key != "loss"} | loss
        found |= {"lines": lines, "residual": residual, "statistics": asdict(self.statistics)}
        return found | {"nuisances": self.nuisances.model_dump(exclude_none=True), "reasons": dict(self.reasons)}

    @property
    def identity(self) -> dict[str, Any]:
        """What identifications depend on: all fields except statistics, rule, reasons and warnings, with the code of an own loss."""
        tree = {key: value for key, value in self.tree().items() if key not in ("statistics", "reasons", "warnings")}
        own = self.residual.loss
        return tree if own is None else tree | {"residual": tree["residual"] | {"code": code_of(type(own))}}

    @property
    def digest(self) -> str:
        """Digest of ``identity``; if it changes, identifications are out of date."""
        return hashlib.sha256(json.dumps(self.identity, sort_keys=True, default=int).encode()).hexdigest()[:32]

    @property
    def choices(self) -> list[str]:
        """One line of text for each choice with its reason."""
        words = {True: "yes", False: "no"}
        shown = ((name, getattr(self, name), reason) for name, reason in self.reasons.items())
        return [f"{name}: {words[value] if isinstance(value, bool) else value} ({reason})" for name, value, reason in shown]


def resolve(update: UpdateConfig, facts: Facts) -> Method:
    """Resolve the settings ``update`` of a campaign into a ``Method``.

    Parameters
    ----------
    update : UpdateConfig
        ``prior_std``, if given, replaces the standard deviations of the prior of values.
    facts : Facts

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
        reasons["regularisation"] = "the weight of the prior follows from the residuals"
        if given != "auto":
            warnings.append(f"update.regularisation: {given} is not used: a weight of values along the edge needs approach: paper")
    else:
        reasons["regularisation"] = "no weight is given: it follows from the residuals" if given == "auto" else "as given"
    optimiser = "gauss-newton" if by_bolts else update.method
    kept = "that of the approach" if by_bolts else "as given"
    reasons["optimiser"] = kept if optimiser == update.method else "bfgs stays in the nearest minimum"
    if optimiser != update.method:
        warnings.append(f"update.method: {update.method} is not used: it needs approach: paper")
    follows = regularisation == "noise"
    weighted = follows and update.weights == "auto"
    reasons["weighted"] = (
        "lines are weighted by their noise, known from coherence or repeats, and by the model discrepancy"
        if weighted
        else ("update.weights: none" if follows else "weights need a noise variance that follows from the residuals")
    )
    mixture, relative = by_bolts and facts.bolts, by_bolts and facts.bolts and weighted
    reasons |= _comparison(mixture, relative)
    if by_bolts and facts.joints:
        reasons["prior_std"] = JOINTS if update.prior_std == "auto" else "as given"
    return Method(
        approach=approach,
        regularisation=regularisation,
        optimiser=optimiser,
        # BFGS: on the log10 of the sum, as in the paper; Gauss-Newton: on the sum itself.
        tolerance=update.tolerance or (1e-4 if optimiser == "gauss-newton" else 1e-3),
        max_iterations=update.max_iterations,
        relative=relative,
        mixture=mixture,
        weighted=weighted,
        residual=ResidualOptions(kind=update.residual, loss_scale=update.loss_scale if update.loss == "soft" else None, floor=update.floor),
        lines=update.lines,
        responses=update.responses,
        nuisances=update.nuisances,
        full_order=update.evaluation == "full",
        statistics=_with_prior(update),
        rule=rule_of(update),
        reasons=reasons,
        warnings=(*warnings, *_without_effect(update, facts, follows)),
    )


def _with_prior(update: UpdateConfig) -> StatisticalModel:
    """The statistical model; a standard deviation given in the settings replaces that of its prior of values."""
    std = update.prior_std
    return STATISTICS if std == "auto" else replace(STATISTICS, values=replace(STATISTICS.values, std=std, joint_std=std))


def _without_effect(update: UpdateConfig, facts: Facts, follows: bool) -> Iterator[str]:
    """Warnings about further settings that were given but have no effect."""
    given = update.model_fields_set
    if not follows and update.prior_std != "auto":
        yield f"update.prior_std: {update.prior_std:g} is not used: update.regularisation: {update.regularisation} weights the values"
    if not follows and "weights" in given and update.weights == "auto":
        yield f"update.weights: auto is not used: it weights no lines with update.regularisation: {update.regularisation}"
    if update.loss == "squares" and "loss_scale" in given:
        yield f"update.loss_scale: {update.loss_scale:g} is not used: it needs loss: soft"
    if "room" in update.nuisances.model_fields_set and update.nuisances.temperature is None:
        yield f"update.nuisances.room: {update.nuisances.room:g} is not used: it needs nuisances.temperature, which varies about it"
    if not facts.bolts:
        for key in ("baselines", "confidence", "loose_change"):
            if key in given and getattr(update, key):
                yield f"update.{key} is not used: it is for verdicts on bolts, and the campaign lists none (`bolts`)"


def _comparison(mixture: bool, relative: bool) -> dict[str, str]:
    """Reasons for ``relative`` and ``mixture``."""
    if not mixture:
        return dict.fromkeys(("relative", "mixture"), "no changes at bolts are identified")
    why = "most of the model discrepancy is the same as in the reference state" if relative else "errors of changes need weighted lines"
    return {"relative": why, "mixture": "each bolt is tight or loose"}


def approach_of(campaign: Campaign) -> Approach:
    """The approach of a campaign; before its first job, with the reference job that a plan assumes."""
    return _approach(campaign.update, Facts(campaign.update.reference is not None or not campaign.jobs, bolts=True))[0]


def _approach(update: UpdateConfig, facts: Facts) -> tuple[Approach, str]:
    """The approach and the reason for it."""
    if update.approach is not None:
        return update.approach, "as given"
    if not facts.reference:
        return "paper", "no reference job to compare with"
    if update.regularisation != "auto":
        return "paper", f"regularisation: {update.regularisation} is a weight of values along the edge"
    if update.method == "bfgs":
        return "paper", "method: bfgs is the method of the paper"
    return "bolts", "there is a reference job to compare with"


def noise_source(method: Method, *, coherent: bool, repeated: bool) -> Noise:
    """Source from which the noise of the lines of one measurement is estimated.

    Parameters
    ----------
    method : Method
    coherent : bool
        The measurement has coherences of more than one average.
    repeated : bool
        The measurement was repeated.

    Returns
    -------
    str
        ``coherence``, ``scatter`` or ``none``.
    """
    if not method.weighted:
        return "none"
    return "coherence" if coherent else "scatter" if repeated else "none"


def formula(evaluation: str, terms: int, size: int) -> str:
    """Formula by which FRFs of a reduced model are evaluated: port FRFs (solves of order nt) or eq. (28) (order r).

    Parameters
    ----------
    evaluation : str
        As in the settings; unless it names one of them, the cheaper one is used.
    terms, size : int
        Number of terms nt, and order r of the reduced model.

    Returns
    -------
    str
        ``port`` or ``reduced``.
    """
    if evaluation in ("port", "reduced"):
        return evaluation
    return "port" if terms <= size else "reduced"
