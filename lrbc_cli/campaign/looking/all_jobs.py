"""Combines findings of all jobs (``together``), and finds what only several jobs show: a loose bolt or a wrong record in the reference job.

Wrong hammers, sensors or units are the same in all jobs, but bolts and errors of the model may hide them in some. Signs and factors that
all share are reported once, even if no single job shows each of them clearly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.findings import Effect, Finding, Kind, kinds_of, said, without_responses
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.identification.compared.offsets import offset_findings, sign_tail
from lrbc_cli.campaign.identification.compared.sensors import same_sensor, sensors_of, standing_out
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.moved import sensor_text
from lrbc_cli.campaign.looking.causes.removed import removed_findings
from lrbc_cli.campaign.looking.causes.tightness import beside_others, fallen_text, risen_text, taken_as_tight
from lrbc_cli.campaign.looking.fitted import closely_fitted
from lrbc_cli.campaign.looking.multiaxial import of_several_axes
from lrbc_cli.campaign.looking.odd.jobs import odd_jobs
from lrbc_cli.campaign.looking.states import Looking, Seen
from lrbc_cli.campaign.looking.trials import NEAR, NEARER, UNLIKE
from lrbc_cli.campaign.looking.unexplained import many_loosened, single_responses
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import listing
from lrbc_cli.updating.comparison.scale import (
    ALIKE,
    LEAST_ALIKE,
    LEAST_OFFSET,
    LEAST_REACH,
    LEFT,
    MEDIAN_SPREAD,
    MOST_REACH,
    STUDENT,
    Offset,
)
from lrbc_cli.updating.robust import scatter


@dataclass(frozen=True)
class OfJob:
    """Findings of one job.

    Attributes
    ----------
    told : list of Finding
    offsets : tuple of Offset
        Factors and phases of its responses; empty if another fault must be corrected first.
    """

    told: list[Finding] = field(default_factory=list)
    offsets: tuple[Offset, ...] = ()


def together(source: Looking, measurements: Mapping[str, Measurement], found: dict[str, OfJob]) -> list[Finding]:
    """Findings of all jobs, and those that only several jobs show if the reference job alone shows no fault."""
    inputs, reference = source.inputs, source.inputs.campaign.update.reference or ""
    explained = reference in found and not kinds_of(found[reference].told)
    if explained and (text := risen_text(inputs, source.changes, _levels(source, measurements))):
        found[reference] = OfJob(said(Kind.LOWERED, text), found[reference].offsets)
        # A tight job differs from one that is not.
        found.update({name: replace(of, told=[each for each in of.told if each.kind is not Kind.FREED]) for name, of in found.items()})
    elif explained:
        for name in taken_as_tight(inputs) & found.keys() & source.changes.keys() - {reference}:
            if not kinds_of(found[name].told) and (text := fallen_text(inputs, name, source.changes[name])):
                found[name] = replace(found[name], told=[*found[name].told, Finding(text=text, kind=Kind.FREED)])
    if reference in found:
        found[reference] = replace(found[reference], told=of_one_sensor(source, measurements, found[reference].told))
    if reference in found.keys() & measurements.keys() and (turned := of_several_axes(source, measurements[reference], reference)):
        wrong = {i for each in turned for i in each.responses}
        for name, of in list(found.items()):
            offsets = tuple(offset for offset in of.offsets if offset.response not in wrong)
            found[name] = OfJob([*(turned if name == reference else []), *without_responses(of.told, wrong)], offsets)
    closer = partial(closely_fitted, source, measurements)
    found.update(of_sensors(inputs, found, source, reference, closer))
    if explained:
        # A state that nothing comes near may have a cause, too.
        quiet = [name for name, of in found.items() if kinds_of(of.told) <= {Kind.FOREIGN} and name != reference]
        found.update({name: replace(found[name], told=[odd]) for name, odd in odd_jobs(source, measurements, quiet, closer).items()})
    told = pooled(of_all_jobs(inputs, found, reference), reference)
    of_model = any(each.kind in {Kind.UNLIKE, Kind.SPRINGS} for each in told if each.job == reference)
    if inputs.springs_doubt or of_model or source.left.get(reference, 0.0) > UNLIKE:
        # With springs at wrong nodes a loosened bolt looks like exchanged sensors; far from any measurement some FRFs agree by chance, and
        # levels and phases of others are off.
        doubtful = {Kind.EXCHANGED, Kind.UNITS, Kind.LATE, Kind.EARLY, Kind.HAMMER}
        known = {each.cause for each in told if each.job == reference}
        told = [each for each in told if each.kind not in doubtful or each.job == reference or each.cause in known]
    if explained and not any(each.job == reference for each in told):
        told += misplaced_sensor(source, measurements)
    doubted = {each.job for each in told}
    return told + [each for each in (removed_findings(source, measurements) if explained else []) if each.job not in doubted]


def _levels(source: Looking, measurements: Mapping[str, Measurement]) -> Floats | None:
    """Levels of the bolts in the model beside each other, see ``beside_others``; None without bolts."""
    bolts, reference = source.inputs.bolts, source.inputs.campaign.update.reference or ""
    return None if bolts is None else beside_others(source.parameters(2j * np.pi * measurements[reference].frequency_hz), len(bolts.name))


def tight_state(reference: Measurement | None, told: Sequence[Finding]) -> Measurement | None:
    """The reference job as the tight state, without single responses that are in doubt; None if it is faulty itself."""
    if reference is None or not all(each.has(Effect.LEAVES_TIGHT) for each in told):
        return None
    doubted = [i for each in told for i in each.responses if each.kind is Kind.ALONE]
    values = reference.values.copy()
    values[:, doubted] = np.nan
    return replace(reference, values=values)


def of_all_jobs(inputs: Inputs, found: Mapping[str, OfJob], reference: str) -> dict[str, list[Finding]]:
    """Findings of each job, in which signs and factors that all jobs share have the same cause.

    Parameters
    ----------
    inputs : Inputs
    found : mapping
        Findings by job.
    reference : str
        Reference job; if it shows no factors, none are shared by all.
    """
    told = {name: of.told for name, of in found.items()}
    several = {name: of.offsets for name, of in found.items() if of.offsets}
    own = several.get(reference, ())
    if len(several) < 2 or not own or any(o.delay or o.conjugate for o in own):
        return told
    factors = _factors(list(several.values()), own)
    units = [each for each in offset_findings(inputs, factors, reference) if each.kind is Kind.UNITS]
    scaled = {i for each in units for i in each.responses}
    known = {o.response: o for o in factors if o.response in scaled}
    cosines = _cosines(list(several.values()))
    reversed_there = _reversed(inputs, cosines) if any(o.reversed for offsets in several.values() for o in offsets) else _Reversed()
    shared = units + _sign_findings(inputs, reversed_there, len(cosines))
    if not shared:
        return told
    for name, offsets in several.items():
        left = tuple(
            replace(
                o,
                # Once the shared factor is corrected, check tells whether this job has another one beside it.
                named=o.named and o.response not in known,
                reversed=o.reversed and o.response not in reversed_there.responses,
            )
            for o in offsets
        )
        before = {each.cause for each in told[name]}
        further = [each for each in offset_findings(inputs, left, name) if each.kind is not Kind.PLACES or each.cause in before]
        told[name] = [*shared, *further, *(each for each in told[name] if not each.has(Effect.IS_OFFSET))]
    return told


def _factors(jobs: Sequence[Sequence[Offset]], own: Sequence[Offset]) -> tuple[Offset, ...]:
    """Shared factor of each response (median over the jobs); empty if the reference job shows no factor."""
    named = [o.power for offsets in jobs for o in offsets if o.named]
    if not named or not any(o.named for o in own):
        return ()
    usual = max(set(named), key=named.count)
    found = []
    for response in sorted({o.response for offsets in jobs for o in offsets}):
        every = [o for offsets in jobs for o in offsets if o.response == response]
        same = [o for o in every if o.power == usual]
        if 2 * len(same) <= len(every):
            # Compared, too, without this factor.
            found.append(replace(every[0], named=False))
            continue
        db = np.array([o.db for o in same])
        # Bolts and lines differ between jobs, so errors of the model scatter the factor.
        half = float(STUDENT * MEDIAN_SPREAD * scatter(db) / np.sqrt(db.size)) if db.size > 3 else min(o.half for o in same)
        middle, before, after = (float(np.median(of)) for of in (db, [o.before for o in same], [o.after for o in same]))
        clear = any(o.named for o in same) and (usual != 0 or abs(middle) >= max(LEAST_OFFSET, half)) and after <= LEFT * before
        # Most jobs must agree.
        clear = clear and 2 * sum(abs(o.db - middle) <= max(MOST_REACH, o.half) for o in same) > len(every)
        nearest = min(same, key=lambda o: abs(o.db - middle))
        half = max(half, LEAST_REACH)
        found.append(replace(nearest, db=middle, half=half, before=before, after=after, named=clear, reversed=False))
    return tuple(found)


def _cosines(jobs: Sequence[Sequence[Offset]]) -> dict[int, float]:
    """Mean cosine of the angle between measured and computed phases, as stated, by response: median over the jobs.

    The largest value is taken instead if the phases of some job clearly agree: the sign is then not reversed in all jobs.
    """
    found: dict[int, list[float]] = {}
    for offsets in jobs:
        for o in offsets:
            if (False, False) in o.phases:
                found.setdefault(o.response, []).append(o.phases[False, False])
    return {response: max(cosines) if max(cosines) >= ALIKE else float(np.median(cosines)) for response, cosines in found.items()}


@dataclass(frozen=True)
class _Reversed:
    """Excitations and single responses whose sign is reversed in all jobs, and all responses affected."""

    excitations: tuple[int, ...] = ()
    single: tuple[int, ...] = ()
    responses: frozenset[int] = frozenset()


def _reversed(inputs: Inputs, cosines: Mapping[int, float]) -> _Reversed:
    """Reversed excitations and responses by the mean cosines, small ones by chance: a hammer affects all its records, as a sensor does."""
    excitations, hit = [], set[int]()
    for e in range(len(inputs.campaign.excitation)):
        own = [r for r in cosines if inputs.responses[r].input == e]
        if len(own) > 1 and max(cosines[r] for r in own) < LEAST_ALIKE and 2 * sum(cosines[r] <= -LEAST_ALIKE for r in own) > len(own):
            excitations.append(e)
            hit |= set(own)
    clear = {r for r, cosine in cosines.items() if cosine <= -LEAST_ALIKE and r not in hit}
    single = clear | {r for r in cosines if cosines[r] < 0.0 and r not in hit and clear.intersection(same_sensor(inputs, r))}
    return _Reversed(tuple(excitations), tuple(sorted(single)), frozenset(hit | single))


def _sign_findings(inputs: Inputs, found: _Reversed, count: int) -> list[Finding]:
    """Findings of reversed signs; ``count`` responses were compared."""
    told, names = list[Finding](), list(inputs.campaign.excitation)
    said = "measured phases are 180 degrees from the model's"
    if found.excitations:
        hit = tuple(i for i, r in enumerate(inputs.responses) if r.input in found.excitations and i in found.responses)
        every = len(hit) == count
        what = "the hammer or of all sensors" if every else f"the hammer at {', '.join(names[e] for e in found.excitations)}"
        fix = ", ".join(f"excitation.{names[e]}.scale: {-inputs.campaign.excitation[names[e]].scale:g}" for e in found.excitations)
        own = "all responses" if every else ", ".join(inputs.responses[i].name for i in hit)
        text = f"probably reversed sign: {own}: {said}. Possible cause: the direction of {what}. Write {fix}{sign_tail(inputs)}"
        told.append(Finding(text=text, kind=Kind.REVERSED, responses=hit))
    if found.single:
        single = [inputs.responses[r].name for r in found.single]
        fix = ", ".join(f"responses.{name}.scale: {-inputs.campaign.responses[name].scale:g}" for name in single)
        pressures = {i for i, response in enumerate(inputs.responses) if response.quantity == "pressure"}
        cause = "the direction of the sensor"
        if pressures.issuperset(found.single):
            cause = "the polarity of the microphones"
            if pressures == set(found.single):
                cause = "the sign of the coupling of structure and air (normals of the coupling surface in the FE model), or " + cause
        text = f"probably reversed sign: {', '.join(single)}: {said}. Possible cause: {cause}. Write {fix}"
        told.append(Finding(text=text + sign_tail(inputs), kind=Kind.REVERSED, responses=found.single))
    return told


def of_one_sensor(source: Looking, measurements: Mapping[str, Measurement], told: list[Finding], *, least: int = 4) -> list[Finding]:
    """Findings ``told`` of the reference job, with what ``least`` or more other jobs say about its sensors.

    A response far from the model in the reference job that fits in the others was wrong in that job alone.
    """
    inputs, reference = source.inputs, source.inputs.campaign.update.reference or ""
    if len(source.away) < least or not told:
        return told
    usual, seen = np.median(list(source.away.values()), axis=0), Seen.of(source, reference, measurements[reference])
    every = apart(seen.measured, seen.model)
    single = [each for each in told if each.kind is Kind.ALONE and not each.detail]
    right = [i for each in single for i in each.responses if usual[i] < min(LEAST_DIFFERENCE, CLEARLY * every[i])]
    if not right:
        return told
    kept = [each for each in told if not set(right).issuperset(each.responses) or each not in single]
    return [*kept, *single_responses(inputs, every, right, "the model in this job alone", reference)]


def misplaced_sensor(source: Looking, measurements: Mapping[str, Measurement], *, most: int = 2) -> list[Finding]:
    """Findings of a sensor, of the ``most`` that fit worst in the reference job, at another place than stated; from ``NEAR`` on.

    On 12 right campaigns the stated place was the best one of every sensor.
    """
    inputs, reference = source.inputs, source.inputs.campaign.update.reference or ""
    seen = Seen.of(source, reference, measurements[reference])
    every = apart(seen.measured, seen.model)
    # Responses without values have no misfit.
    away = {own: float(np.mean(every[list(own)][every[list(own)] > 0.0])) for own in sensors_of(inputs) if (every[list(own)] > 0.0).any()}
    for own in sorted(away, key=away.__getitem__, reverse=True)[:most]:
        if away[own] > NEAR and (text := sensor_text(seen, own[0], share=NEARER)):
            found = single_responses(inputs, every, own, "the model", better=dict.fromkeys(own, text), few=len(own))
            return [replace(each, job=reference) for each in found]
    return []


def of_sensors(
    inputs: Inputs, found: Mapping[str, OfJob], source: Looking, reference: str, closer: Callable[[str], Floats]
) -> dict[str, OfJob]:
    """Findings by job, with sensors that are far off in one job alone, and without those in doubt in the reference job already.

    ``closer`` gives the level misfits of a job after a careful fit, without which nothing is said. Nothing is added to what is found in a
    job already, nor beside a reference job with findings.
    """
    own = found[reference].told if reference in found else []
    changed = without_sensors(inputs, found, reference) if any(each.responses for each in own) else dict(found)
    if reference in found and not own:
        known = {name: far for name, far in source.away.items() if name in found}
        for name in odd_sensors(inputs, known):
            if not changed[name].told and not many_loosened(source.changes.get(name)):
                changed[name] = replace(changed[name], told=odd_sensors(inputs, known | {name: closer(name)}).get(name, []))
        every = {**source.near, **known}
        for name in (name for name in found if name in every and not many_loosened(source.changes.get(name))):
            # Fitted closely only if a coarse fit shows it.
            if not changed[name].told and odd_records(inputs, name, every):
                far = closer(name)
                alone = odd_records(inputs, name, every | {name: far})
                told = single_responses(inputs, far, alone, "the state of the bolts that fits best", name)
                changed[name] = replace(changed[name], told=told)
        for name in (name for name in source.near if name in found and not changed[name].told):
            if astray_sensor(inputs, name, every):
                changed[name] = replace(changed[name], told=astray_sensor(inputs, name, every | {name: closer(name)}))
    return changed


def astray_sensor(inputs: Inputs, name: str, away: Mapping[str, Floats], *, least: int = 3) -> list[Finding]:
    """Finding of a sensor whose FRFs alone are far from a state that explains all others, see ``standing_out``; empty if there is none.

    Parameters
    ----------
    inputs : Inputs
    name : str
        Job near the tight state.
    away : mapping
        Level misfits (R,) with the nearest state [dB], by job. What other jobs show too, if there are ``least``, is an error of the model.
    least : int
        Number of other jobs from which on these tell the errors of the model.
    """
    others = [own for other, own in away.items() if other != name]
    excess = away[name] - (np.median(others, axis=0) if len(others) >= least else 0.0)
    sensors = sensors_of(inputs)
    found = standing_out(excess, sensors, inputs.statistics.errors.astray_db)
    if found is None:
        return []
    at, far = list(sensors[found]), away[name]
    names, usual = listing([inputs.responses[i].name for i in at], 4), np.median(np.delete(far, at))
    text = (
        f"the FRFs of one sensor ({names}) are {np.median(far[at]):.1f} dB from the state of the bolts that fits best (mean level "
        f"removed), the others {usual:.1f} dB. Check whether it was overloaded, moved, turned, exchanged or loose, and measure again"
    )
    return [Finding(text=text, kind=Kind.ALONE, responses=tuple(at))]


def odd_sensors(
    inputs: Inputs, away: Mapping[str, Floats], *, least: int = 4, times: float = 2.5, far_db: float = 6.0
) -> dict[str, list[Finding]]:
    """Findings by job of sensors that are far from the fitted state in this job alone.

    Errors of the model are large at some responses in all jobs, so each is compared with itself in the others, and the ratio with that of
    the other sensors, since no coarse fit is equally near in all jobs.

    Parameters
    ----------
    inputs : Inputs
    away : mapping
        Level misfits (R,) with the fitted state [dB], by job.
    least : int
        Least number of jobs.
    times : float
        Least ratio to those of the other sensors. On right campaigns it was 1.7 at most, but once 2.8 (4.7 dB) with two loosened joints
        next to a sensor.
    far_db : float
        Least level misfit of a sensor, median over its records [dB].
    """
    found: dict[str, list[Finding]] = {}
    for name, own in away.items() if len(away) > least else ():
        usual = np.median([every for other, every in away.items() if other != name], axis=0)
        ratio = own / np.maximum(usual, 1.0)
        for records in sensors_of(inputs):
            at = list(records)
            far, typical = float(np.median(ratio[at])), float(np.median(ratio))
            if float(np.median(own[at])) > far_db and far > times * max(typical, 1.0):
                names = ", ".join(inputs.responses[i].name for i in at)
                text = (
                    f"{names}: {np.median(own[at]):.1f} dB from the state of the bolts that fits best (mean level removed), {far:.1f} "
                    f"times as far as in the other jobs; the median of all responses is {typical:.1f} times. Check whether the sensor was "
                    f"overloaded, loose or dead, or another one was connected. Measure again, or remove its records from the file of {name}"
                )
                found.setdefault(name, []).append(Finding(text=text, kind=Kind.ALONE, responses=records))
    return found


def odd_records(inputs: Inputs, name: str, away: Mapping[str, Floats], *, times: float = 2.5, beyond: float = 2.0) -> list[int]:
    """Responses that are far from the fitted state in one job and at one hammer point alone, as if overloaded during these blows.

    Errors of the model and loosened joints near a sensor show at its other hammer points, in other jobs, or in the other responses of that
    hammer point, too. On 12 right campaigns with 100 jobs no response was more than 2.2 times as far as the farthest of these three.

    Parameters
    ----------
    inputs : Inputs
    name : str
    away : mapping
        Level misfits (R,) with the fitted state [dB], by job.
    times : float
        Least ratio to the farthest of the medians of these three.
    beyond : float
        Least distance from it [dB].
    """
    own, others = away[name], [every for other, every in away.items() if other != name]
    found = list[int]()
    for i, far in enumerate(own.tolist()):
        sensor = same_sensor(inputs, i)
        struck = own[(inputs.input_of == inputs.input_of[i]) & (np.arange(own.size) != i)]
        if others and sensor and struck.size > 1:
            usual = max(float(np.median(each)) for each in (own[sensor], struck, [every[i] for every in others]))
            if far > max(times * usual, usual + beyond):
                found.append(i)
    return found


def without_sensors(inputs: Inputs, found: Mapping[str, OfJob], reference: str) -> dict[str, OfJob]:
    """Findings by job, without single records of sensors whose place or direction is in doubt in the reference job already."""
    alone = {Kind.ALONE, Kind.COORDINATES}
    own = {i for each in found[reference].told if each.kind in alone for i in each.responses}
    wrong = own.union(*(same_sensor(inputs, i) for i in own))
    return {
        name: of
        if name == reference
        else replace(of, told=[each for each in of.told if each.kind is not Kind.ALONE or not wrong.issuperset(each.responses)])
        for name, of in found.items()
    }


def pooled(found: Mapping[str, Sequence[Finding]], reference: str | None) -> list[Finding]:
    """Findings of all jobs with their places; a part of a fault of the reference job gets that cause, as bolts may hide the rest.

    Parameters
    ----------
    found : mapping
        Findings by job, the reference job first.
    reference : str or None
    """
    own = found.get(reference or "", ())
    reversed_there = [each for each in own if each.kind is Kind.REVERSED]
    units_there = any(each.kind is Kind.UNITS for each in own)
    quantities = [each for each in own if each.kind is Kind.UNITS and each.detail]
    stated_wrong = {i for each in own if each.kind in {Kind.ALONE, Kind.COORDINATES} for i in each.responses}
    shared, exchanges = list[Finding](), list[Finding]()
    for name, told in found.items():
        for each in told:
            of = each
            if each.kind is Kind.EXCHANGED:
                # If a sensor has the wrong place or direction, some other sensor fits better in some state of the bolts.
                if name != reference and stated_wrong.intersection(i for cycle in each.cycles for i in cycle):
                    continue
                # A job with loose bolts may show exchanged cables for one hammer point only.
                of = next((other for other in exchanges if set(each.cycles) < set(other.cycles)), each)
                exchanges.append(of)
            elif each.kind is Kind.REVERSED:
                of = next((other for other in reversed_there if set(each.responses) <= set(other.responses)), each)
            elif each.kind is Kind.UNITS:
                of = next((other for other in quantities if set(each.responses) <= set(other.responses)), each)
            # With wrong units in the reference job (velocity for acceleration), phases off by 90 degrees are the same fault.
            if not (units_there and each.kind in {Kind.SIDEWAYS, Kind.PARTS}):
                shared.append(replace(of, job=name))
    return shared
