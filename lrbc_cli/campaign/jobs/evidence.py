"""Makes the evidence that is judged (changes at bolts, misfits, doubts) from an identification; also intervals and notes for readers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification.compared.axis import axis_fault
from lrbc_cli.campaign.identification.compared.chains import blows_doubt, chain_doubt, coherence_doubt, noise_doubt
from lrbc_cli.campaign.identification.compared.complete import shares
from lrbc_cli.campaign.identification.compared.copies import copied_text, pasted
from lrbc_cli.campaign.identification.compared.doubts import doubts
from lrbc_cli.campaign.identification.correlate import mean_of
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.identification.weights import lines_doubt, validation_channels
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reading.model_doubts import misplaced_bolts
from lrbc_cli.errors import listing
from lrbc_cli.model.terms import LN10, ParameterGroup
from lrbc_cli.updating.calibration.apart import damping_at_bounds
from lrbc_cli.updating.judging.evidence import (
    USED,
    VALIDATION,
    BoltEvidence,
    Change,
    Doubt,
    Evidence,
    PartialChange,
    SampledChange,
    at_bolts,
    carried,
)
from lrbc_cli.updating.judging.reference import ReferenceState
from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.posterior.confidence import Band, band
from lrbc_cli.updating.search.ends import near_tie
from lrbc_cli.updating.statistics.lines import interpolated
from lrbc_cli.updating.statistics.saturation import Saturation
from lrbc_cli.updating.unknowns.places import Edge, Joints, Spot
from lrbc_cli.updating.unknowns.springs import LossAlone

#: Why there is no validation channel, if all of their values are noise.
SILENT = "no value of the validation channels stands out of the noise"


def effective(group: ParameterGroup, p: Floats) -> Floats:
    """(k,) log10 of the effective values ``W 10^p`` of a group."""
    return np.asarray(np.log10(group.values(p)))


def bands(result: Identification, level_error: float) -> dict[str, Band]:
    """Standard deviation and 95 % limits of the effective values of every group.

    Limits of joints are no narrower than those of their changes, and contain errors of the model that their level takes up, with the
    standard deviation ``level_error`` (``ErrorModel``) [decades].
    """
    covariance = result.posterior.boundary
    found = {}
    for group, values, _ in result.parameters.placed:
        opens = (result.opens[0][values], result.opens[1][values])
        own = band(group, result.solution.theta[values], covariance[values, values], opens)
        own = _with_changes(result, group, values, own)
        if group.kind == "stiffness" and group.bolt is not None:
            reach, centre = np.where(group.bolt >= 0, NORMAL_95 * level_error, 0.0), effective(group, result.solution.theta[values])
            own = replace(own, lower=centre - np.hypot(centre - own.lower, reach), upper=centre + np.hypot(own.upper - centre, reach))
        found[group.name] = own
    return found


def _with_changes(result: Identification, group: ParameterGroup, values: slice, own: Band) -> Band:
    """Limits of joints' values, widened to the intervals of their changes, which contain errors of the model that curvature does not."""
    tight = _stored(result.reference, group, "log10_effective")
    if tight is None or group.bolt is None or result.changes is None:
        return own
    lower, upper = own.lower.copy(), own.upper.copy()
    for bolt in np.unique(group.bolt[group.bolt >= 0]).tolist():
        at = np.flatnonzero(group.bolt == bolt)
        if (found := _change(result, bolt, [(group, values, at)], None)) is None:
            continue
        low, high = (np.inf if side is None else abs(side - found.mean) for side in found.interval(found.mean, found.std))
        lower[at] = np.minimum(lower[at], tight[at] + found.mean - low)
        upper[at] = np.maximum(upper[at], tight[at] + found.mean + high)
    return replace(own, lower=lower, upper=upper)


def evidence_of(inputs: Inputs, result: Identification) -> Evidence:
    """Evidence from which an identification is judged."""
    update = inputs.campaign.update
    compared, misfit, unvalidated = _misfit(inputs, result)
    used = inputs.used
    warnings, setting, untrusted = doubts(inputs, result, (mean_of(result.misfit_initial[used]), mean_of(result.misfit_final[used])))
    edges, bolts = _bolts(inputs, result)
    wanted = update.reference not in (None, result.name)
    places = misplaced_bolts(inputs.groups, inputs.bolts)
    found = (
        *_doubts(inputs, result),
        *untrusted,
        *([] if places is None else [Doubt(kind="places", text=places)]),
        *([] if compared == VALIDATION else [Doubt(kind="channels", text=unvalidated)]),
    )
    return Evidence(
        job=result.name,
        status=result.solution.status,
        reason=result.solution.reason,
        along_edges=edges,
        bolts=bolts,
        missing_reference=update.reference if wanted and result.reference is None else None,
        compared=compared,
        misfit_db=misfit,
        used_misfit_db=mean_of(result.misfit_final[used]),
        against_reference=result.against_reference,
        setting=setting,
        doubts=found,
        data_warnings=tuple(map(str, result.measurement.warnings)),
        warnings=(*result.warnings, *warnings),
        notes=(*result.notes, *remarks(inputs, result)),
        alternatives=_alternatives(inputs, result),
    )


def _misfit(inputs: Inputs, result: Identification) -> tuple[str | None, float | None, str]:
    """Channels on which validation rests, their mean misfit [dB], and why these are no validation channels, if so."""
    independent, why = validation_channels(result.measurement.values, inputs.used, inputs.validation, inputs.statistics.validation)
    for at, compared in ((independent, VALIDATION), (inputs.used, USED)):
        misfit = mean_of(result.misfit_final[at])
        if misfit is not None:
            return compared, misfit, why or SILENT
    return None, None, why or SILENT


def _doubts(inputs: Inputs, result: Identification) -> Iterator[Doubt]:
    """Faults of a measurement: a copy of the reference job, incomplete, interpolated, too coarse, of unlike blows or another chain."""
    reference, own, tight = result.reference, result.measurement, result.tight
    if reference is None:
        return
    again = [file for file in inputs.campaign.jobs[result.name].measurements[0] if own.hashes.get(file.as_posix()) in reference.inputs]
    if again:
        files = f"{', '.join(file.name for file in again)} contain{'s' if len(again) == 1 else ''}"
        yield Doubt(kind="copy", text=f"{files} the measurement of {reference.job} again; check whether another file was meant")
    if tight is None:
        return
    # With the same lines in the band, the file may only leave out a line at its begin.
    if unlike(axis := own.frequency_hz, tight.frequency_hz) and (fault := axis_fault(own, tight, reference.job, result.name)):
        yield Doubt(kind="chain", text=fault)
    limits, every = inputs.statistics.validation, [response.name for response in inputs.responses]
    copied = copied_text(own, tight, reference.job, every, limits)
    if copied and not again:
        yield Doubt(kind="copy", text=copied)
    # Two names of one place, and reciprocal FRFs, share a record in the reference job, too.
    always = set(pasted(tight, every, limits))
    yield from (Doubt(kind="copy", text=text) for text in pasted(own, every, limits) if text not in always)
    same = limits.same_line
    within = (tight.frequency_hz >= axis[0] * (1 - same)) & (tight.frequency_hz <= axis[-1] * (1 + same))
    if within.mean() < limits.least_span:
        whole = f"{tight.frequency_hz[0]:g} to {tight.frequency_hz[-1]:g} Hz"
        text = f"its lines reach from {axis[0]:g} to {axis[-1]:g} Hz, those of {reference.job} from {whole}; check whether it is complete"
        yield Doubt(kind="incomplete", text=text)
    elif (cut := np.flatnonzero(shares(own, tight, 1.0 - limits.least_span)[inputs.used] < limits.least_span)).size:
        names = listing([inputs.responses[i].name for i in inputs.used[cut]])
        text = f"{names} lack{'s' if cut.size == 1 else ''} a part of the lines of {reference.job}; check whether the files are complete"
        yield Doubt(kind="incomplete", text=text)
    if strange := interpolated(own.values, inputs.statistics.resolution):
        yield Doubt(kind="interpolated", text=strange)
    if differing := blows_doubt(inputs, result.name, own, tight):
        yield Doubt(kind="blows", text=differing)
    for noisy in (noise_doubt(own, tight, reference.job), coherence_doubt(inputs, own, tight, reference.job)):
        if noisy:
            yield Doubt(kind="noise", text=noisy, explained=True)
    # What is mostly noise is not compared, or has little weight, so its peaks do not count.
    if (wide := lines_doubt(inputs, (result.name, own, tight), (reference.job, tight, tight))) is not None:
        yield Doubt(kind="resolution", text=f"in {result.name} and {reference.job} {wide.text}")
    if (chain := _chain(inputs, own, tight, result, reference.job)) is not None:
        yield chain


def _chain(inputs: Inputs, own: Measurement, tight: Measurement, result: Identification, reference: str) -> Doubt | None:
    """Another measuring chain, by comparison with the reference job and with what the identified change makes of it; else None.

    Bolts that change much, or that hold a structure of few modes, move all resonances nearly alike; their change explains such a sign. It
    may also hide a second blow, which then shows in what is left.
    """
    told, beside = chain_doubt(inputs, own, tight, reference, job=result.name), None
    if result.expected is not None:
        beside = chain_doubt(inputs, own, replace(tight, values=result.expected), reference, job=result.name)
    if told is not None:
        return Doubt(kind="chain", text=told.text, explained=result.expected is not None and beside is None)
    return Doubt(kind="chain", text=beside.text) if beside is not None and beside.kind == "blow" else None


def _stored(reference: ReferenceState | None, group: ParameterGroup, key: str) -> Floats | None:
    """Stored values of a group in the reference job, by key; None if there are none or their number differs."""
    stored = None if reference is None else reference.parameters.get(group.name)
    found: Floats | None = None if stored is None else getattr(stored, key)
    return found if found is not None and len(found) == group.count else None


def _bolts(inputs: Inputs, result: Identification) -> tuple[bool, tuple[BoltEvidence, ...]]:
    """Whether any stiffness belongs to bolts (joints or edges), and the evidence on each bolt."""
    if inputs.bolts is None:
        return False, ()
    names, xyz, reference = inputs.bolts.name, inputs.bolts.xyz, result.reference
    itself = inputs.campaign.update.reference == result.name
    confidence = bands(result, inputs.statistics.errors.level_error) if itself else {}

    def tight_std(group: ParameterGroup) -> Floats | None:
        """Standard deviation of the values in the tight state; infinite where the data allow them to be clamped."""
        own = confidence.get(group.name)
        std, upper = (own.std, own.upper) if own is not None else (_stored(reference, group, key) for key in ("std", "upper95"))
        return None if std is None or upper is None else np.where(np.isfinite(upper), std, np.inf)

    groups: list[Edge | Joints] = []
    where: list[tuple[ParameterGroup, slice]] = []
    for group, values, _ in result.parameters.placed:
        if group.kind != "stiffness":
            continue
        log10, cap = effective(group, result.solution.theta[values]), result.saturations[group.name].start
        tight = _stored(reference, group, "log10_effective")
        std = tight_std(group)
        if group.bolt is not None:
            groups.append(Joints(log10, cap, tight, group.bolt, std))
        elif group.xyz is not None and group.arc_length is not None:
            groups.append(Edge(xyz=group.xyz, arc_length=group.arc_length, log10=log10, cap=cap, reference=tight, std=std))
        else:
            continue
        where.append((group, values))
    if not groups:
        places = [(float(x), float(y), float(z)) for x, y, z in xyz]
        return False, tuple(BoltEvidence(name=name, position=position) for name, position in zip(names, places, strict=True))
    if reference is None or itself:
        return True, at_bolts(groups, names, xyz)

    def change_of(bolt: int, spot: Spot, difference: float | None) -> Change | None:
        parts = [(*where[i], at) for i, at in spot]
        found = _change(result, bolt, parts, difference)
        free = tuple(dict.fromkeys(group.name for group, values, chosen in parts if result.opens[0][values][chosen].all()))
        felt = any(group.name not in free for group, _, _ in parts)
        if found is None:
            return None
        own = _partial_changes(inputs, result, parts) if result.posterior.shapes.by_bolt else ()
        at = _sampled(result, bolt)
        # Joints only: the hats of an edge share one change.
        joint = parts[0][0].bolt is not None
        ratio = float(result.changes.ratios[at]) if joint and at is not None and result.changes is not None else None
        return replace(found, may_be_free=not felt, unfelt=free if felt else (), parts=own, ratio=ratio, **_lost(result, at))

    found = at_bolts(groups, names, xyz, change_of)
    if result.changes is not None:
        inclusion = result.changes.inclusion
        at = [_sampled(result, i) for i in range(len(found))]
        found = tuple(
            bolt if k is None or bolt.outside is not None else replace(bolt, probability_changed=min(float(inclusion[k]), 1.0))
            for bolt, k in zip(found, at, strict=True)
        )
    return True, found


def _lost(result: Identification, at: int | None) -> dict[str, Any]:
    """``whole`` and ``alone`` of ``Change``, of the sampled bolt ``at``."""
    told = () if result.changes is None else [one for one in result.changes.groups if one.joint == at]
    alone = tuple(LossAlone(one.of, one.ratio, one.shown) for one in told if one.of is not None)
    return {"whole": next((one.ratio for one in told if one.of is None), None), "alone": alone}


def _sampled(result: Identification, bolt: int) -> int | None:
    """Position of a bolt among the sampled changes."""
    if result.changes is None or not result.posterior.shapes.by_bolt:
        return None
    at = np.flatnonzero(result.changes.bolts == result.posterior.shapes.bolts[bolt])
    return int(at[0]) if at.size else None


#: Values of one group that belong to a bolt: the group, its slice of theta, and indices within it.
Part = tuple[ParameterGroup, slice, NDArray[np.int64]]


def _change(result: Identification, bolt: int, parts: Sequence[Part], difference: float | None) -> Change | None:
    """Posterior of the change at a bolt: from samples, else from its unknown, else from the values that belong to it (``difference``)."""
    knowledge = result.posterior
    column = int(knowledge.shapes.bolts[bolt]) if knowledge.shapes.by_bolt else -1
    if column >= 0:
        excess, ceiling = _saturated(result, column, parts)
        at = _sampled(result, bolt)
        # Without relative comparison, the error of the reference state is part of the posterior already.
        tight_std = _tight_std(parts, result.reference) if result.relative and knowledge.shapes.joint[bolt] else 0.0
        if result.changes is None or at is None:
            mean, std = float(knowledge.z[column]), float(np.hypot(knowledge.std[column], excess))
            return Change(mean=mean + excess, std=float(np.hypot(std, carried(mean, tight_std))), ceiling=ceiling, excess=excess)
        mean, std = float(result.changes.mean[at]), float(np.hypot(result.changes.std[at], excess))
        beyond = 0.0 if result.beyond is None else float(result.beyond[at])
        std = float(np.hypot(std, carried(mean, tight_std)))
        return Change(
            mean=mean + excess,
            std=std,
            ceiling=ceiling,
            excess=excess,
            leakage=float(result.changes.smeared[at]),
            beyond=beyond if np.isfinite(beyond) else 0.0,
            open_below=not np.isfinite(beyond),
            sampled=SampledChange.of(result.changes, at, tight_std),
        )
    if difference is None:
        return None
    theta, count = result.solution.theta, sum(chosen.size for _, _, chosen in parts)
    # Mean of log10(W 10^p) over the values.
    row = np.zeros(theta.size)
    for group, values, chosen in parts:
        p = theta[values]
        row[values] = (group.value_jacobian(p) / (LN10 * group.values(p)[:, None]))[chosen].sum(axis=0) / count
    covariance = knowledge.boundary
    if result.against_reference:
        # Covariance of the change, without that of the reference state.
        covariance = knowledge.shapes.T @ knowledge.covariance[: knowledge.z.size, : knowledge.z.size] @ knowledge.shapes.T.T
    variance = float(row @ covariance @ row)
    if not result.against_reference:
        variance += _tight_std(parts, result.reference) ** 2
    return Change(mean=difference, std=float(np.sqrt(max(variance, 0.0))))


def _partial_changes(inputs: Inputs, result: Identification, parts: Sequence[Part]) -> tuple[PartialChange, ...]:
    """Changes of a joint by group of springs, for groups whose change is known to within ``deviation_std``; empty with a single group."""
    knowledge, prior = result.posterior, inputs.statistics.bolts
    if len({group.name for group, _, _ in parts}) < 2:
        return ()
    m = knowledge.z.size
    found = []
    for group, values, chosen in parts:
        rows = knowledge.shapes.T[values][chosen].mean(axis=0)
        mean = float(rows @ knowledge.z)
        told = float(np.sqrt(max(float(rows @ knowledge.covariance[:m, :m] @ rows), 0.0)))
        if told > prior.deviation_std:
            continue
        # The same errors widen the change of the whole joint.
        tight = _tight_std([(group, values, chosen)], result.reference) if result.relative else 0.0
        std = float(np.sqrt(told**2 + float(carried(mean, tight)) ** 2 + (inputs.statistics.errors.shift_error * mean) ** 2))
        found.append(PartialChange(group=group.name, mean=mean, std=std, deviation=prior.deviation_std))
    return tuple(found)


def _tight_std(parts: Sequence[Part], reference: ReferenceState | None) -> float:
    """Standard deviation of these values in the reference job, rms [decades]; 0 if none is stored."""
    stored = [(_stored(reference, group, "std"), chosen) for group, _, chosen in parts]
    before = [std[chosen] for std, chosen in stored if std is not None]
    return float(np.sqrt(np.mean(np.concatenate(before) ** 2))) if before else 0.0


def _saturated(result: Identification, column: int, parts: Sequence[Part]) -> tuple[float, float | None]:
    """Excess of the reference state over saturation at a bolt, and its distance below saturation (None if unknown), both >= 0 [decades].

    The excess comes from the prior of the reference job, not from data: it is added to a change and to its standard deviation. The group
    that is lowest counts, because the FRFs respond to a joint if one kind of its springs is below saturation.
    """
    above = []
    for group, values, _ in parts:
        tight, shape = _stored(result.reference, group, "log10_effective"), result.posterior.shapes.T[values, column]
        if tight is not None and shape.any():
            above.append(float(shape @ tight / shape.sum()) - result.saturations[group.name].start)
    return (max(min(above), 0.0), max(-min(above), 0.0)) if above else (0.0, None)


def _alternatives(inputs: Inputs, result: Identification) -> tuple[tuple[tuple[float | None, ...], float], ...]:
    """Changes of all bolts in each state about which was sampled, and the posterior probability of that state among them."""
    if result.changes is None or inputs.bolts is None:
        return ()
    order, columns = result.changes.bolts.tolist(), result.posterior.shapes.bolts.tolist()
    states = ((dict(zip(order, changes.tolist(), strict=True)), share) for changes, share in result.changes.alternatives)
    return tuple((tuple(found.get(column) for column in columns), share) for found, share in states)


def guessed_text(name: str, limits: Saturation, start: float | None) -> str:
    """Note on bounds, and on a start value unless it is given, that were guessed because the FRFs do not show where they saturate."""
    guessed = f"bounds {limits.lower:.3g} to {limits.upper:.3g}, log10"
    guessed, keys = (f"start {limits.start:.3g}, {guessed}", "`initial` and `bounds`") if start is None else (guessed, "`bounds`")
    return (
        f"{name}: the FRFs do not show above which stiffness a joint is practically rigid, and below which practically free. `auto` was "
        f"therefore guessed from the stiffness matrix ({guessed}). If values end at one of these bounds, write {keys} of "
        f"parameters.{name} instead of auto; otherwise do nothing"
    )


def remarks(inputs: Inputs, result: Identification) -> list[str]:
    """Notes of a result: guessed limits, values at their bounds, near ties between descents, relative comparison."""
    found = []
    for group, values, _ in result.parameters.placed:
        limits = result.saturations.get(group.name)
        config = inputs.campaign.parameters[group.name]
        # Said once, with the reference job: all jobs have the same bounds.
        if result.reference is None and limits is not None and not limits.found and (config.start is None or config.bounds == "auto"):
            low, high = float(group.bounds[:, 0].min()), float(group.bounds[:, 1].max())
            found.append(guessed_text(group.name, replace(limits, lower=low, upper=high), config.start))
        p, bounds = result.solution.theta[values], group.bounds
        low, high = int(np.sum(p <= bounds[:, 0])), int(np.sum(p >= bounds[:, 1]))
        if low or high:
            found.append(f"{group.name}: {low} of {group.count} values at the lower and {high} at the upper bound")
    found += damping_at_bounds(result.parameters, result.solution.theta)
    tie = near_tie(result.parameters, result.solution.starts)
    if tie is not None:
        best, second, apart = tie
        found.append(
            f"near tie: the results from '{best.description}' and '{second.description}' differ by {second.cost - best.cost:.3f} in cost "
            f"and by {apart:.2f} decades (rms) in the identified values"
        )
    if result.relative:
        found.append("compared after correcting the measurement by the model discrepancy of the reference job")
    return found
