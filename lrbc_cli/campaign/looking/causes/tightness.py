"""Tests whether jobs that are assumed tight (reference job, baselines, calibration job) have loose bolts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import NEARER, UNLIKE, USUAL
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.search.starts import LEVELS
from lrbc_cli.updating.unknowns.shapes import joints_of


def taken_as_tight(inputs: Inputs) -> set[str]:
    """Baselines and calibration job, in which all bolts are assumed tight."""
    campaign = inputs.campaign
    return {*campaign.update.baselines, *([campaign.calibration.job] if campaign.calibration is not None else [])}


def tighter_text(seen: Seen, measurements: Mapping[str, Measurement], *, as_well: float = 1.1, least: float = UNLIKE) -> str:
    """Warning that names jobs that fit the tight model far better than the reference job does; empty if there are none.

    If one bolt explains the reference job, files are not said to be exchanged: that would put the file of a loosened state in its place.

    Parameters
    ----------
    seen : Seen
        Of the reference job.
    measurements : mapping
        By job.
    as_well : float
        Largest misfit that a free bolt may leave, as a ratio to that of the nearest job that could be exchanged. Its stiffness is not
        fitted, so it may leave a little more.
    least : float
        Least difference from the reference job of a job assumed tight that is nearer to the model, but not twice as near [dB].
    """
    reference, every = seen.job, {name: Seen.of(seen.source, name, whole) for name, whole in measurements.items()}
    far = {name: own.misfit for name, own in every.items()}

    def share(name: str) -> float:
        values, other = every[name].measured, every[reference].measured
        known = name in taken_as_tight(seen.inputs) and values.shape == other.shape
        return NEARER if known and float(np.median(apart(values, other))) > least else CLEARLY

    near = {name: own for name, own in far.items() if name != reference and own < min(UNLIKE, share(name) * far[reference])}
    if not near:
        return ""
    assumed = taken_as_tight(seen.inputs)
    if near.keys() <= assumed:
        # Other tight jobs show that the reference job is not tight: they are not exchanged with it, but with a job that is to be judged.
        near |= {name: own for name, own in far.items() if name not in {reference, *assumed} and own < min(UNLIKE, NEARER * far[reference])}
    order = sorted(near.items(), key=lambda each: (each[0] in assumed, each[1]))
    judged = [name for name in near if name not in assumed]
    loose, how, left, _ = freed(seen)
    bolts = () if seen.inputs.bolts is None else seen.inputs.bolts.name
    tight = [name for name, _ in order if name in assumed]
    another = f"set {_references(seen.inputs)} to a tight job{f', such as {tight[0]}' if tight else ''}"
    if len(loose) == 1 and loose[0] in bolts and left <= min([NEARER * far[reference], *(as_well * near[name] for name in judged)]):
        return (
            f"With {loose[0]} {how} the level misfit is {left:.1f} dB, instead of {far[reference]:.1f} dB: {loose[0]} was probably loose "
            f"in {reference}. S{another[1:]}, or tighten it and measure {reference} again. {_fit_text(order, reference, far[reference])}"
        )
    fit = _fit_text(order, reference, far[reference])
    bolt = looser(seen, far[reference]) or foremost(seen, far[reference])
    if not judged:
        return (
            f"{fit}. Probably a bolt was loose in {reference}, or jobs.{reference}.frf is the file of another state: {another}, or correct "
            f"the file{bolt}"
        )
    other = f"jobs.{order[0][0]}.frf{' (or that of another of these)' if len(judged) > 1 else ''}"
    return f"{fit}. If files are exchanged, exchange jobs.{reference}.frf and {other}. If a bolt was loose in {reference}, {another}{bolt}"


def _fit_text(order: Sequence[tuple[str, float]], reference: str, far: float) -> str:
    """Clause on the jobs, with their misfits [dB], that fit the tight model better than the reference job (``far``) does."""
    named = ", ".join(f"{name} ({own:.1f} dB)" for name, own in order)
    return f"{named} {'fits' if len(order) == 1 else 'fit'} the tight model far better than {reference} ({far:.1f} dB)"


def _references(inputs: Inputs) -> str:
    """The keys that name the tight job."""
    campaign = inputs.campaign
    same = campaign.calibration is not None and campaign.calibration.job == campaign.update.reference
    return f"update.reference{' and calibration.job' if same else ''}"


def within_scatter(away: Floats, change: Floats | None, *, largest: float = 0.7) -> bool:
    """Whether changes of the bolts that are usual between tight states explain a job that is assumed tight.

    Parameters
    ----------
    away : (R,) float array
        Level misfits with the state fitted to it [dB].
    change : (b,) float array or None
        Its fitted changes [decades].
    largest : float
        Largest change of a bolt: a rise as large is a bolt that was loose in the reference job. See ``fallen_text``.
    """
    return change is not None and float(np.median(away)) <= LEAST_DIFFERENCE and not bool((np.abs(change) > largest).any())


def not_tight(seen: Seen, held: Complexes, others: Sequence[Complexes] = (), *, least: int = 3) -> str:
    """Warning about a job that is assumed tight but differs much from the reference job; empty if it does not.

    Tight states that were assembled anew differ less from each other than a model from measurements.

    Parameters
    ----------
    seen : Seen
    held : (F, R) complex array
        Measured tight state, see ``Seen.held``.
    others : sequence of (F, R) complex arrays
        Measurements of the jobs to be judged, on the same lines. Most of at least ``least`` of them must be farther from the reference job.
    """
    reference, name = seen.inputs.campaign.update.reference, seen.job
    stated, found = float(np.median(apart(held, seen.model))), seen.misfit
    # Remove the model discrepancy of the reference job, which is that of another tight job, too.
    there = np.isfinite(held) & (held != 0)
    own = seen.reading(seen.measured * np.where(there, seen.model / np.where(there, held, 1.0), np.nan))
    before = own.misfit
    # Another tight state differs less, and not by one bolt.
    freed = (looser(own, before) if before > LEAST_DIFFERENCE else "") or (foremost(own, before) if before > USUAL else "")
    nearer = before > LEAST_DIFFERENCE and found < NEARER * stated
    within = sum(float(np.median(apart(values, held))) < before for values in others)
    farther = len(others) >= least and before > LEAST_DIFFERENCE and 2 * within > len(others)
    if not freed and not nearer and not farther and before <= UNLIKE:
        return ""
    fix = _fix(seen.inputs, name)
    if nearer and (not freed or before > UNLIKE):
        return (
            f"it is taken as tight, but differs from {reference} by {before:.1f} dB, and is nearer to the tight model ({found:.1f} dB) "
            f"than {reference} is ({stated:.1f} dB). Check whether a bolt was loose in {reference}. Correct jobs.{reference}.frf, or set "
            f"update.reference to a tight job; otherwise {fix[:1].lower()}{fix[1:]}"
        )
    return (
        f"it is taken as tight, but differs from {reference} by {before:.1f} dB"
        f"{f', more than {within} of {len(others)} jobs that are to be judged' if farther else ''}"
        f"{freed or '. Check whether all bolts were tight'}. {fix}, or measure it again"
    )


def looser(seen: Seen, typical: float) -> str:
    """Clause that names bolts or values with which free the model fits clearly better; empty if there are none.

    ``typical`` is the level misfit of the tight state [dB].
    """
    names, how, left, _ = freed(seen)
    if not names or left > CLEARLY * typical:
        return ""
    return f". With {', '.join(names)} {how} the level misfit is {left:.1f} dB: check whether all bolts were tight"


def foremost(seen: Seen, typical: float, *, least: float = 1.0) -> str:
    """Clause that names the joint whose loss alone lowers the misfit ``typical`` [dB] far more than that of any other; else empty.

    Beside a model with errors no loss leaves little. At the right joint it lowers the misfit by ``least`` [dB], more than twice as much as
    anywhere else.
    """
    best = dict[str, Freed]()
    for each in _partly_loose(seen):
        best[each.names[0]] = min(each, best.get(each.names[0], each), key=lambda one: one.left)
    order = sorted(best.values(), key=lambda each: each.left)
    if len(order) < 2 or typical - order[1].left > CLEARLY * (typical - order[0].left) or order[0].left > typical - least:
        return ""
    first, second = order[:2]
    return (
        f". With {first.names[0]} {first.how} the level misfit is {first.left:.1f} dB, with a loss of any other bolt {second.left:.1f} dB "
        f"or more: check {first.names[0]} first"
    )


class Freed(NamedTuple):
    """The nearest state with something loosened: bolts, or values of an edge in words, how far in words and [decades], misfit [dB].

    There are no names if the tight state fits best.
    """

    names: list[str]
    how: str
    left: float
    change: float = -np.inf


def freed(seen: Seen) -> Freed:
    """The state of the model, tight or with something loosened, that fits best."""
    inputs, loosened = seen.inputs, seen.loosened
    distances = np.median(apart(seen.measured, seen.states[: len(loosened)]), axis=1)
    best = int(np.argmin(distances))
    names, how, left = list[str](), "free", float(distances[best])
    for group, where, _ in seen.parameters.placed:
        if loosened[best].size and where.start <= loosened[best][0] < where.stop:
            at = loosened[best] - where.start
            owners = [] if group.bolt is None or inputs.bolts is None else [inputs.bolts.name[b] for b in group.bolt[at] if b >= 0]
            values = f"values {at[0] + 1} to {at[-1] + 1} of parameters.{group.name}"
            names = list(dict.fromkeys(owners)) or [values]
            several = sum(each.bolt is not None for each, *_ in seen.parameters.placed) > 1
            how = f"free in {group.name}" if owners and several else "free"
    return min([Freed(names, how, left), *_partly_loose(seen)], key=lambda each: each.left)


def _partly_loose(seen: Seen) -> Iterator[Freed]:
    """As ``freed``, for each joint, and for each of its groups if it has several, at each of the levels that a search tries."""
    parameters, bolts = seen.parameters, seen.inputs.bolts
    if bolts is None:
        return
    owned = list[tuple[str, str, Integers]]()
    for name, own in zip(bolts.name, joints_of(parameters, len(bolts.name)), strict=True):
        if own:
            owned.append((name, "", np.concatenate(list(own.values()))))
        if len(own) > 1:
            owned += [(name, f" in {parameters.placed[group][0].name}", at) for group, at in own.items()]
    if not owned:
        return
    states = np.tile(parameters.initial, (len(owned), len(LEVELS), 1))
    for state, (*_, at) in zip(states, owned, strict=True):
        state[:, at] = np.maximum(state[:, at] + np.array(LEVELS)[:, None], parameters.bounds[at, 0])
    key = b"partly loose" + seen.s.tobytes()
    if key not in seen.source.known:
        nearby = seen.source.model(seen.s, parameters).nearby(parameters.initial)
        # One joint at a time: only its own terms are solved for.
        seen.source.known[key] = np.concatenate([nearby(own) for own in states])
    distances = np.median(apart(seen.measured, seen.source.known[key]), axis=1).reshape(len(owned), -1)
    for (name, group, _), away in zip(owned, distances, strict=True):
        best = int(np.argmin(away))
        yield Freed([name], f"at {10.0 ** LEVELS[best]:.1g} of its stiffness{group}", float(away[best]), LEVELS[best])


def loose_text(seen: Seen, loose: str) -> str:
    """Warning about a reference job that is explained with loose bolts, as the clause ``loose`` says."""
    return (
        f"measured and computed FRFs differ by {seen.misfit:.1f} dB (median of the responses, mean level of each removed). {loose}. If "
        "they were not, set update.reference to a tight job, or tighten them and measure this job again; otherwise check the springs of "
        "these bolts in the model"
    )


def lowered_text(before: Seen, after: Seen, *, least: float = 1.0, clearly: float = 0.85) -> str:
    """Warning that names bolts of which a rough calibration lowers all springs, to good purpose; empty if there are none.

    Parameters
    ----------
    before, after : Seen
        The reference job with the model as exported, and with the roughly calibrated one.
    least : float
        Least fall of each spring relative to the median of its group [decades].
    clearly : float
        Largest share of the misfit without that fall that may be left: the springs of a bolt that hardly affects the FRFs take up errors
        of the model.
    """
    low = {bolt: -own for bolt, own in _calibrated_change(before, after, 1.0).items() if own <= -least}
    named = _named(before.inputs, {bolt: own for bolt, own in low.items() if after.misfit <= clearly * _with_others(before, after, bolt)})
    if not named:
        return ""
    return (
        f"a rough calibration from this job lowers the stiffness of {named} more than that of the other bolts. Check whether all bolts "
        "were tight. If not, set update.reference and calibration.job to a tight job, or measure it again"
    )


def _with_others(before: Seen, after: Seen, bolt: int) -> float:
    """Level misfit after a calibration [dB] if the springs of a bolt had moved as the median of their groups."""
    theta = after.parameters.initial.copy()
    for group, where, _ in before.parameters.placed:
        if group.kind == "stiffness" and group.bolt is not None:
            start = before.parameters.initial[where]
            own = np.flatnonzero(group.bolt == bolt)
            theta[where.start + own] = start[own] + np.median(theta[where] - start)
    return after.at(theta).misfit


def raised_text(before: Seen, after: Seen, *, least: float = 1.0) -> str:
    """Warning that names joints of which a rough calibration raises all springs: their table is wrong; as ``lowered_text``."""
    high = _calibrated_change(before, after, -1.0)
    named = _named(before.inputs, {bolt: own for bolt, own in high.items() if own >= least})
    if not named:
        return ""
    return (
        f"a rough calibration from this job raises the stiffness of {named} more than that of the other bolts. Check the stiffnesses of "
        "their springs, and the units of these, in the table and in the FE model"
    )


def _calibrated_change(before: Seen, after: Seen, sign: float) -> dict[int, float]:
    """Change of each bolt by a calibration, relative to the median of its group [decades]; of its groups the largest times ``sign``."""
    change = dict[int, float]()
    for group, where, _ in before.parameters.placed:
        if group.kind != "stiffness" or group.bolt is None:
            continue
        moved = (after.parameters.initial - before.parameters.initial)[where]
        for bolt, own in zip(group.bolt.tolist(), (moved - np.median(moved)).tolist(), strict=True):
            change[bolt] = sign * max(sign * own, sign * change.get(bolt, own))
    return {bolt: own for bolt, own in change.items() if bolt >= 0}


def _named(inputs: Inputs, sizes: Mapping[int, float]) -> str:
    """Bolts with the sizes of their changes [decades] in words; empty without bolts."""
    bolts = inputs.bolts
    return "" if bolts is None else ", ".join(f"{bolts.name[bolt]} ({_decades(own)})" for bolt, own in sorted(sizes.items()))


def beside_others(parameters: Parameterisation, count: int) -> Floats:
    """(b,) start values of the bolts above the median of their group, mean over the groups [decades]; 0 of a bolt without its own.

    ``count`` is the number of bolts.
    """
    total, groups = np.zeros(count), np.zeros(count)
    for group, values, _ in parameters.placed:
        if group.kind == "stiffness" and group.bolt is not None and (group.bolt >= 0).any():
            owned = group.bolt >= 0
            own = parameters.initial[values][owned]
            np.add.at(total, group.bolt[owned], own - np.median(own))
            np.add.at(groups, group.bolt[owned], 1.0)
    return np.asarray(total / np.maximum(groups, 1.0))


def risen_text(
    inputs: Inputs,
    changes: Mapping[str, Floats],
    above: Floats | None = None,
    *,
    least: float = 0.8,
    every: float = 0.5,
    both: float = 0.4,
    jobs: int = 4,
) -> str:
    """Warning that names bolts that are stiffer in most or all other jobs than in the reference job; empty if there are none.

    A bolt that was loose in the reference job is fitted by a calibration as well as any other, but all other jobs show it stiffer.

    Parameters
    ----------
    inputs : Inputs
    changes : mapping
        Fitted changes of the bolts against the reference job [decades], by job.
    above : (b,) float array or None
        See ``beside_others``, of the model calibrated from the reference job.
    least : float
        Least median of the changes [decades], without jobs in which the bolt has lost as much. On right campaigns it was 0.6 at most.
    every : float
        Least change in each of these jobs that counts, too [decades]: as much counts as a loss in the other direction. On 12 right
        campaigns no bolt was stiffer by more than 0.2 in all of them.
    both : float
        Least median, and least distance below the other bolts in the reference job, that count together [decades]. On 12 right campaigns
        no bolt had more than 0.21 of both.
    jobs : int
        Least number of jobs that count.
    """
    bolts = inputs.bolts
    if bolts is None or not changes:
        return ""
    below = np.zeros(len(bolts.name)) if above is None else -above
    kept = [own[own > -least] for own in np.array(list(changes.values())).T]
    usual = [(float(np.median(own)), float(own.min())) if own.size >= jobs else (0.0, 0.0) for own in kept]
    # Springs that the table has too soft are told already.
    told = zip(bolts.name, usual, below.tolist(), strict=True)
    far = [(name, own) for name, (own, low), soft in told if own >= least or low >= every or min(own, soft) >= both]
    risen = [(name, own) for name, own in far if name not in inputs.odd_bolts]
    named = ", ".join(f"{name} ({_decades(own)})" for name, own in risen)
    if not named:
        return ""
    return (
        f"most other jobs are fitted best with a stiffer {named}: probably not all bolts were tight here, or a mass was left on the "
        f"structure. Set {_references(inputs)} to a job with all bolts tight, or tighten them, remove what does not belong to it, and "
        "measure this job again"
    )


def fallen_text(inputs: Inputs, name: str, change: Floats, *, least: float = 1.0) -> str:
    """Warning that names bolts that are far looser in a job that is assumed tight than in the reference job; empty if there are none.

    Parameters
    ----------
    inputs : Inputs
    name : str
        Baseline, or job of the calibration.
    change : (b,) float array
        Fitted changes of the bolts against the reference job [decades].
    least : float
        Least loss [decades]. On right campaigns it was 0.7 at most.
    """
    if inputs.bolts is None:
        return ""
    named = ", ".join(f"{bolt} ({_decades(-own)})" for bolt, own in zip(inputs.bolts.name, change, strict=True) if own <= -least)
    if not named:
        return ""
    return (
        f"it is taken as tight, but is fitted best with a looser {named}. Check whether all bolts were tight. {_fix(inputs, name)}, "
        "or measure it again"
    )


def _decades(change: float) -> str:
    """Size of a change, as a factor too."""
    return f"by {change:.1f} decades, a factor of {10.0**change:.2g}"


def _fix(inputs: Inputs, name: str) -> str:
    """What to write if a job that is assumed tight is not."""
    campaign, fixes = inputs.campaign, list[str]()
    if name in campaign.update.baselines:
        fixes.append("remove it from update.baselines")
    if campaign.calibration is not None and campaign.calibration.job == name:
        fixes.append("set calibration.job to a tight job")
    fix = " and ".join(fixes)
    return f"{fix[:1].upper()}{fix[1:]}"
