"""What a result says of the bolts, and whether it may say anything: bands, verdicts, and the gate of validity."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.campaign.identification import Identification
from lrbc_cli.campaign.inputs import Inputs
from lrbc_cli.campaign.records import MIN_LINES
from lrbc_cli.config import UpdateConfig
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.model.terms import LN10, ParameterGroup
from lrbc_cli.updating.confidence import Band, Rule, band, weigh
from lrbc_cli.updating.levels import near_tie
from lrbc_cli.updating.verdicts import BoltVerdict, Edge, judge

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]

#: A rise of the stiffness by this many standard deviations of the prior is an error of the model.
IMPLAUSIBLE = 2.5

#: What a baseline is, and what is said of a bolt of it that would be loose in another job.
BASELINE, DOUBTFUL = "a baseline, taken as tight", "a baseline, taken as tight, but against the reference job it comes out loose"

#: Which channels a misfit was taken over.
VALIDATION, USED = "validation channels", "channels used"

#: Relative difference below which two records are one: no file has more digits than that, and no two sensors as many in common.
COPIED = 1e-6

#: Status of a job whose measurement the model does not explain.
UNEXPLAINED = "unexplained"


def effective(group: ParameterGroup, p: Floats) -> Floats:
    """log10(W 10^p)."""
    return np.asarray(np.log10(group.values(p)))


def _stored(reference: Mapping[str, Any] | None, group: ParameterGroup, key: str) -> Floats | None:
    """A list of the reference job's group, where it fits."""
    found = reference["parameters"].get(group.name, {}).get(key) if reference else None
    if found is None or len(found) != group.count:
        return None
    return np.array([np.nan if value is None else value for value in found], dtype=float)


def bands(result: Identification) -> dict[str, Band]:
    """Confidence of the effective values of every group."""
    covariance = result.posterior.boundary
    found = {}
    for group, (values, _) in zip(result.parameters.groups, result.parameters.slices, strict=True):
        opens = (result.opens[0][values], result.opens[1][values])
        found[group.name] = band(group, result.solution.theta[values], covariance[values, values], opens)
    return found


@dataclass(frozen=True)
class Validity:
    """Whether the model explains the measurement.

    Attributes
    ----------
    passed : bool or None
        By the validation channels; None where there are none and nothing speaks against it: then it is not validated.
    compared : str or None
        The channels whose misfit was compared: ``validation channels`` or ``channels used``.
    misfit_db : float or None
        Their mean misfit.
    limit_db : float
    reason : str
    """

    passed: bool | None
    compared: str | None
    misfit_db: float | None
    limit_db: float
    reason: str

    @property
    def explained(self) -> bool:
        """Whether bolts may be judged."""
        return self.passed is not False

    def tree(self) -> dict[str, Any]:
        """``validity`` of ``result.json``."""
        return {
            "passed": self.passed,
            "compared": self.compared,
            "misfit_db": self.misfit_db,
            "held_out_db": self.misfit_db if self.compared == VALIDATION else None,
            "limit_db": self.limit_db,
            "reason": self.reason,
        }


def validity(inputs: Inputs, result: Identification) -> Validity:
    """Compare the misfit of the validation channels with ``update.largest_misfit``.

    Where there are none, the channels used must stay below it, which is necessary and shows nothing: they were fitted.
    """
    limit = inputs.campaign.update.largest_misfit
    independent, why = validation_channels(result.measurement.values, inputs.used, inputs.held_out)
    for at, compared in ((independent, VALIDATION), (inputs.used, USED)):
        values = result.misfit_final[at]
        values = values[np.isfinite(values)]
        if values.size:
            misfit = float(values.mean())
            within = misfit <= limit
            text = f"mean misfit of the {compared} {misfit:.2f} dB, {'within' if within else 'above'} the limit of {limit:g} dB"
            if compared == VALIDATION or not within:
                return Validity(within, compared, misfit, limit, text)
            return Validity(None, compared, misfit, limit, f"not validated: {why}; {text}")
    return Validity(False, None, None, limit, "no response can be compared")


def repeated(valid: Validity, result: Identification, job: JobConfig, reference: Mapping[str, Any] | None) -> Validity:
    """Not validated where the file is that of the reference job: a measurement that was not exchanged tells nothing of the bolts."""
    own = result.measurement.hashes.get(job.frf.as_posix())
    if reference is None or own is None or own not in reference["provenance"]["inputs"].values():
        return valid
    reason = f"not validated: {job.frf.name} holds the measurement of {reference['job']} once more; was another file meant?"
    return replace(valid, passed=None if valid.passed else valid.passed, reason=reason if valid.explained else valid.reason)


def validation_channels(values: Complexes, used: NDArray[np.int64], held_out: NDArray[np.int64]) -> tuple[NDArray[np.int64], str]:
    """Responses that can test an identification which did not see them, and why there is none.

    Parameters
    ----------
    values : (F, R) complex array
        As measured; NaN where there is no value.
    used, held_out : int arrays

    Returns
    -------
    int array, str
        Those of the held-out ones with values on most lines that are no copy of a response used.
    """
    if not held_out.size:
        return held_out, "there are no validation channels"
    finite = np.isfinite(values)
    share = finite[:, held_out].mean(axis=0)
    if not share.any():
        return held_out[:0], "the validation channels have no values"
    told = held_out[share >= MIN_LINES]
    if not told.size:
        return told, f"the validation channels have values on {share.max():.0%} of the lines only"

    def copied(i: int, j: int) -> bool:
        """Whether a record is another one but for a constant factor: two sensors never are."""
        both = finite[:, i] & finite[:, j] & (values[:, j] != 0)
        if not both.any():
            return False
        ratio = values[both, i] / values[both, j]
        return bool(np.all(np.abs(ratio - ratio[0]) <= COPIED * abs(ratio[0])))

    own = np.array([i for i in told if not any(copied(int(i), int(j)) for j in used)], dtype=np.int64)
    return own, "" if own.size else "the validation channels are records that were fitted too"


def scatter_of(baselines: Iterable[Mapping[str, Any]]) -> float:
    """Root mean square of the changes at the bolts of further tight jobs [decades]; 0 without any."""
    changes = [
        bolt["change"]
        for tree in baselines
        for bolt in tree.get("bolts", [])
        if bolt.get("change") is not None and bolt.get("change_std") is not None and bolt["verdict"] != "undecided"
    ]
    return float(np.sqrt(np.mean(np.square(changes)))) if changes else 0.0


def verdicts(
    inputs: Inputs, result: Identification, reference: Mapping[str, Any] | None, scatter: float, valid: Validity
) -> list[BoltVerdict]:
    """Judge the bolts of a job against the stored result of the reference job.

    Parameters
    ----------
    inputs : Inputs
    result : Identification
    reference : mapping or None
    scatter : float
        See ``scatter_of``.
    valid : Validity

    Returns
    -------
    list of BoltVerdict
        Empty without bolts or groups along which they could lie.
    """
    if inputs.bolts is None:
        return []
    update = inputs.campaign.update
    edges, where = [], []
    for group, (values, _) in zip(result.parameters.groups, result.parameters.slices, strict=True):
        if group.kind != "stiffness" or group.xyz is None or group.arc_length is None:
            continue
        log10 = effective(group, result.solution.theta[values])
        tight = _stored(reference, group, "log10_effective")
        edges.append(Edge(group.xyz, group.arc_length, log10, result.saturations[group.name].start, tight))
        where.append((group, values))
    if not edges:
        return []
    found = judge(edges, inputs.bolts.xyz, update.threshold, update.reference == result.name)
    missing = reference is None and update.reference not in (None, result.name)
    if missing:
        # Changes were wanted: a contrast between bolts is no answer.
        note = f"no result of {update.reference} to compare with"
        found = [v if v.outside else replace(v, verdict="undecided", note=note) for v in found]
    if reference is not None and update.reference != result.name:
        found = [v if v.outside else _weighed(result, i, v, where, reference, update, scatter) for i, v in enumerate(found)]
    if result.name in update.baselines:
        found = [v if v.outside else _as_tight(v) for v in found]
    if not valid.explained:
        note = "the model does not explain the measurement"
        found = [v if v.outside else replace(v, verdict="undecided", probability_loose=None, note=note) for v in found]
    return found


def _as_tight(verdict: BoltVerdict) -> BoltVerdict:
    """A bolt of a baseline."""
    note = DOUBTFUL if verdict.verdict == "loose" else verdict.note or BASELINE
    return replace(verdict, verdict="tight", probability_loose=None, note=note)


def doubtful(inputs: Inputs, found: Sequence[BoltVerdict]) -> list[str]:
    """A warning where bolts of a baseline come out loose: their changes count as scatter of tight states, which hides loose bolts."""
    if inputs.bolts is None:
        return []
    named = [(name, v.change or 0.0) for name, v in zip(inputs.bolts.name, found, strict=False) if v.note == DOUBTFUL]
    if not named:
        return []
    return [
        f"not all tight, it seems: {', '.join(f'{name} ({change:+.2f} decades)' for name, change in named)} come out loose against the "
        "reference job; as a baseline it lowers the change at which bolts of the other jobs count as loose: take it out of "
        "update.baselines, or measure it again"
    ]


def _sampled(result: Identification, bolt: int) -> int | None:
    """Position of a bolt among the sampled changes."""
    if result.changes is None or not result.posterior.shapes.by_bolt:
        return None
    at = np.flatnonzero(result.changes.bolts == result.posterior.shapes.bolts[bolt])
    return int(at[0]) if at.size else None


def _weighed(
    result: Identification,
    bolt: int,
    verdict: BoltVerdict,
    where: Sequence[tuple[ParameterGroup, slice]],
    reference: Mapping[str, Any],
    update: UpdateConfig,
    scatter: float,
) -> BoltVerdict:
    """Judge by the sampled change where there is one, else by the Gaussian about the optimum."""
    rule = Rule(update.threshold, update.confidence, scatter)
    change, std, ceiling = _change(result, bolt, verdict, where, reference)
    at = _sampled(result, bolt)
    if result.changes is None or at is None:
        return weigh(verdict, change, std, rule, ceiling)
    group, values = where[verdict.edge]
    excess, ceiling = _saturated(result, int(result.changes.bolts[at]), group, values, reference)
    # Beside a gap a tight bolt takes part of it: what is below the threshold for that says nothing.
    rule = replace(rule, threshold=min(update.mixture_threshold, float(result.changes.smeared[at])))
    below = float(result.changes.below(rule.limit - excess, float(np.hypot(scatter, excess)))[at])
    mean, spread = float(result.changes.mean[at]) + excess, float(np.hypot(result.changes.std[at], excess))
    return weigh(verdict, mean, spread, rule, ceiling, below)


def _change(
    result: Identification,
    bolt: int,
    verdict: BoltVerdict,
    where: Sequence[tuple[ParameterGroup, slice]],
    reference: Mapping[str, Any],
) -> tuple[float, float, float]:
    """Change at a bolt against the reference state, its standard deviation, and the largest that the FRFs would feel [decades]."""
    knowledge = result.posterior
    column = knowledge.shapes.bolts[bolt] if knowledge.shapes.by_bolt else -1
    group, values = where[verdict.edge]
    if column >= 0:
        excess, ceiling = _saturated(result, int(column), group, values, reference)
        return float(knowledge.z[column]) + excess, float(np.hypot(knowledge.std[column], excess)), ceiling
    p = result.solution.theta[values]
    # Mean of log10(W 10^p) over the values near the bolt.
    row = (group.value_jacobian(p) / (LN10 * group.values(p)[:, None]))[verdict.near].mean(axis=0)
    covariance = knowledge.boundary
    if result.against_reference:
        # Of the change, not of the value.
        covariance = knowledge.shapes.T @ knowledge.covariance[: knowledge.z.size, : knowledge.z.size] @ knowledge.shapes.T.T
    variance = float(row @ covariance[values, values] @ row)
    if not result.against_reference:
        before = _stored(reference, group, "std")
        variance += 0.0 if before is None else float(np.mean(before[verdict.near] ** 2))
    return float(verdict.change or 0.0), float(np.sqrt(max(variance, 0.0))), np.inf


def _saturated(
    result: Identification, column: int, group: ParameterGroup, values: slice, reference: Mapping[str, Any]
) -> tuple[float, float]:
    """How far the reference state lies above saturation at a bolt, and how far below it, of which a rise would be felt [decades].

    How far above says the prior of the reference job alone: a change counts from saturation, and that much is uncertain too.
    """
    tight = _stored(reference, group, "log10_effective")
    hat = result.posterior.shapes.T[values, column]
    if tight is None or not hat.any():
        return 0.0, np.inf
    above = float(hat @ tight / hat.sum()) - result.saturations[group.name].start
    return max(above, 0.0), max(-above, 0.0)


def rises(inputs: Inputs, found: Sequence[BoltVerdict]) -> list[str]:
    """A warning where bolts seem tighter than in the reference state by more than the prior allows: nothing but errors does that."""
    if inputs.bolts is None:
        return []
    limit = IMPLAUSIBLE * inputs.campaign.update.prior_std
    names = [name for name, v in zip(inputs.bolts.name, found, strict=False) if v.change_std is not None and (v.change or 0.0) > limit]
    if not names:
        return []
    return [f"{', '.join(names)}: tighter than in the reference job by more than {limit:.2g} decades, which errors of the model explain"]


def bolt_trees(inputs: Inputs, result: Identification, found: Sequence[BoltVerdict]) -> list[dict[str, Any]]:
    """``bolts`` of ``result.json``."""
    if inputs.bolts is None:
        return []
    removed = inputs.campaign.jobs[result.name].removed
    stated = states_removed(inputs)
    trees = []
    for i, (name, position) in enumerate(zip(inputs.bolts.name, inputs.bolts.xyz, strict=True)):
        verdict = found[i] if found else BoltVerdict(None, None, "undecided", "no stiffness group with positions")
        at = None if verdict.outside else _sampled(result, i)
        trees.append(
            {
                "name": name,
                "position": position,
                "log10_stiffness": verdict.log10_stiffness,
                "change": verdict.change,
                "change_std": verdict.change_std,
                "threshold": verdict.threshold,
                "probability_loose": verdict.probability_loose,
                "probability_changed": None if at is None or result.changes is None else result.changes.inclusion[at],
                "verdict": verdict.verdict,
                "removed": name in removed if stated else None,
                "note": verdict.note,
            }
        )
    return trees


def states_removed(inputs: Inputs) -> bool:
    """Whether the campaign says which bolts are removed: then a job without that key has none removed."""
    return any(job.removed for job in inputs.campaign.jobs.values())


def remarks(result: Identification) -> list[str]:
    """What a reader of the result should know: limits that do not exist, values at their bounds."""
    found = []
    for group, (values, at) in zip(result.parameters.groups, result.parameters.slices, strict=True):
        limits = result.saturations.get(group.name)
        if limits is not None and not limits.found:
            found.append(f"{group.name}: the FRFs reach no free or clamped limit; auto values are decades from the local stiffness")
        p, bounds = result.solution.theta[values], group.bounds
        low, high = int(np.sum(p <= bounds[:, 0])), int(np.sum(p >= bounds[:, 1]))
        if low or high:
            found.append(f"{group.name}: {low} of {group.count} values at the lower and {high} at the upper bound")
        if (
            at is not None
            and group.damping is not None
            and not group.damping.bounds[0] < result.solution.theta[at] < group.damping.bounds[1]
        ):
            found.append(
                f"{group.name}: the damping exponent lies at its bound {result.solution.theta[at]:g}: the FRFs do not determine it"
            )
    tie = near_tie(result.parameters, result.solution.starts)
    if tie is not None:
        best, second, apart = tie
        found.append(
            f"near tie: the ends from '{best.description}' and '{second.description}' differ by {second.cost - best.cost:.3f} in cost "
            f"and by {apart:.2f} decades (rms) in what they identify"
        )
    if result.relative:
        found.append("compared after correcting the measurement by what the model lacks in the reference job")
    return found
