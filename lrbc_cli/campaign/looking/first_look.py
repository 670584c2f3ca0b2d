"""First comparison of measurements with the model for ``lrbc check``: finds wrong units, signs, places and files before any identification.

``first_look`` calls the tests of this package in order for each job; a clear fault ends the tests of a job, since it would affect the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache as cache_of
from functools import partial
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Complexes
from lrbc_cli.campaign.findings import Effect, Finding, Kind, kinds_of, said
from lrbc_cli.campaign.identification.compared.chains import soft_tip
from lrbc_cli.campaign.identification.compared.likeness import (
    CLEARLY,
    LEAST_DIFFERENCE,
    apart,
    other_reading,
    run_backwards,
    sideways,
)
from lrbc_cli.campaign.identification.compared.offsets import (
    LEAST_BAND,
    sideways_finding,
)
from lrbc_cli.campaign.identification.compared.sensors import same_sensor
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.identification.weights import without_noise
from lrbc_cli.campaign.looking.all_jobs import OfJob, tight_state, together
from lrbc_cli.campaign.looking.axes import stretched_text
from lrbc_cli.campaign.looking.causes.added import loaded_text
from lrbc_cli.campaign.looking.causes.damped import misdamped_text
from lrbc_cli.campaign.looking.causes.held import idle_text, or_held
from lrbc_cli.campaign.looking.causes.moved import hammers_text, unmoved_text
from lrbc_cli.campaign.looking.causes.parts import at_bounds_text, part_cause
from lrbc_cli.campaign.looking.causes.recorded import cut_text, field_reading_text, filter_findings
from lrbc_cli.campaign.looking.causes.rescaled import material_text, overdamped_text, rescaled_text
from lrbc_cli.campaign.looking.causes.tables import joints_text, of_other_unit_text, other_tables
from lrbc_cli.campaign.looking.causes.tightness import (
    loose_text,
    looser,
    lowered_text,
    not_tight,
    raised_text,
    taken_as_tight,
    tighter_text,
    within_scatter,
)
from lrbc_cli.campaign.looking.exchanges import channel_findings
from lrbc_cli.campaign.looking.fitted import (
    as_exported,
    calibrated_from,
    calibrated_from_another,
    fitted_exchanged,
    fitted_frf,
    roughly_calibrated,
    strike_text,
)
from lrbc_cli.campaign.looking.states import BUILT_WORK, Looking, Seen, coarsely_reduced, nearest_states, on_lines, reach_of_one
from lrbc_cli.campaign.looking.trials import EXPLAINED, NEAR, UNLIKE, USUAL
from lrbc_cli.campaign.looking.unexplained import (
    badly_calibrated,
    beside_fit,
    beside_tight,
    gains_by_chance,
    little_in_common,
    of_a_part,
    placed,
    uncalibrated,
    without_repeated,
)
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reading.model_doubts import misread
from lrbc_cli.campaign.reduced import cache
from lrbc_cli.campaign.reduced.memory import reduction_cost
from lrbc_cli.campaign.reduced.stage import ReductionStage, require_baselines
from lrbc_cli.errors import DataError, LrbcError, listing
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.comparison.scale import Offset


@dataclass(frozen=True)
class FirstLook:
    """Findings of the comparison of measurements with the model.

    Attributes
    ----------
    found : list of Finding
    note : str
        Why nothing was compared, or with which rough calibration; empty if with the model as given.
    compared : bool
        False if nothing was compared.
    doubted : frozenset of str
        Jobs with faults of numbers or responses that the reference job does not have; other comparisons with it are meaningless.
    source : Looking or None
        The model that was compared, with a rough calibration if there was one, and how far the jobs are from it; None without a comparison.
    """

    found: list[Finding] = field(default_factory=list)
    note: str = ""
    doubted: frozenset[str] = frozenset()
    compared: bool = True
    source: Looking | None = None


def first_look(
    inputs: Inputs, folder: Path, measurements: Mapping[str, Measurement], progress: Callable[[str], None] = lambda _: None
) -> FirstLook:
    """Warnings about systematic differences between measurements and model, or a note why they were not compared.

    Parameters
    ----------
    inputs : Inputs
    folder : Path
        Folder of the cache of reduced models; nothing is written to it.
    measurements : mapping
        By job, in any order.
    progress : callable
    """
    reference = inputs.campaign.update.reference
    try:
        if inputs.held_doubt or misread(inputs.campaign, inputs.model, inputs.groups, inputs.dofs):
            first = "measured and computed FRFs are compared once the warnings on model and parameters are corrected"
            return FirstLook(note=first, compared=False)
        band = LEAST_BAND * float(np.ptp(inputs.campaign.reduction.band))
        whole = [name for name, found in measurements.items() if np.ptp(found.frequency_hz) > band]
        if measurements and not whole:
            return FirstLook(note="measured and computed FRFs are compared once reduction.band is a band that was measured", compared=False)
        if reference in whole and (text := misdamped_text(inputs, measurements[reference])):
            note = "measured and computed FRFs are compared once the damping is corrected"
            return FirstLook([Finding(job=reference, text=text, kind=Kind.DAMPING)], note=note)
        source = _source(inputs, folder, progress)
        if source is None:
            first = "measured and computed FRFs (units, signs, exchanged sensors) are compared once `lrbc reduce` has been run"
            return FirstLook(note=first, compared=False)
        order = sorted(whole, key=lambda name: name != reference)
        # A matrix that does not contain the baseline subtracted from it gives no FRFs to compare with.
        if lacking := _lacking(inputs, source):
            return FirstLook([Finding(text=text) for text in lacking])
        found: dict[str, OfJob] = {}
        tight = measurements.get(reference or "")
        heard = {name: replace(measurements[name], values=_heard(inputs, name, measurements[name], tight)) for name in order}
        source = exported = calibrated_from_another(source, heard)
        if reference in order:
            progress(f"comparing {reference} with the model, job 1 of {len(order)}")
            source, found[reference] = _of_reference(source, heard, reference)
        own = found[reference].told if reference in found else []
        rest = [] if any(each.has(Effect.STOPS) for each in own) else [name for name in order if name != reference]
        tight, cycles = tight_state(heard.get(reference or ""), own), [cycle for each in own for cycle in each.cycles]

        def look(name: str) -> OfJob:
            progress(f"comparing {name} with the model, job {order.index(name) + 1} of {len(order)}")
            return _of_job(source, exported, name, lambda of: _looked_at(of, heard, name, tight, cycles))

        found |= zip(rest, side_by_side(look, rest), strict=True)
        later = f"the other jobs are compared once the fault of {reference} is corrected" if len(found) < len(order) else ""
        told = together(source, heard, found)
        return FirstLook(
            told,
            note="; ".join(filter(None, (source.note, later, _left_text(source, found)))),
            doubted=_doubted(told, found, reference or ""),
            source=source,
        )
    except LrbcError as error:
        return FirstLook(note=f"measured and computed FRFs were not compared: {error.problem}", compared=False)


def _doubted(told: Sequence[Finding], names: Iterable[str], reference: str) -> frozenset[str]:
    """Jobs with other doubts of numbers, records or places than the reference job has."""
    causes = {name: {each.cause for each in told if each.has(Effect.DOUBTS_JOB) and each.job == name} for name in names}
    return frozenset(name for name, own in causes.items() if own != causes.get(reference, set()))


def _left_text(source: Looking, found: Mapping[str, OfJob]) -> str:
    """Level misfits of the jobs that were compared."""
    named = ", ".join(f"{name} {source.left[name]:.1f}" for name in found if name in source.left)
    return named and f"level misfit with the nearest of the states compared, after a coarse fit of the bolts [dB]: {named}"


def _heard(inputs: Inputs, name: str, measurement: Measurement, tight: Measurement | None) -> Complexes:
    """(F, R) measured values without those that are mostly noise, in the reference job if it is another one, or beyond a soft tip."""
    # Noise by the coherence of the reference job says nothing on the model. In other jobs it dilutes what errors of the model leave of
    # single sensors.
    own = name == inputs.campaign.update.reference
    values = without_noise(inputs, name, measurement, None if own else tight, known=own)
    edge = soft_tip(measurement)
    return values if edge is None else np.where(measurement.frequency_hz[:, None] < edge[0], values, np.nan)


def _source(inputs: Inputs, folder: Path, progress: Callable[[str], None]) -> Looking | None:
    """Reduced model from the cache, else a coarse one built here if that is cheap; else None."""
    decision = cache.look_up(folder, cache.key_parts(inputs))
    if not decision.hit and reduction_cost(inputs)[0].work > BUILT_WORK:
        return None
    found = cache.load(decision, inputs) if decision.hit else coarsely_reduced(inputs, progress)
    return Looking(inputs=inputs, stage=ReductionStage(found, decision, 0.0), kind="port")


def _lacking(inputs: Inputs, source: Looking) -> list[str]:
    """Error that `lrbc reduce` will raise if the stiffness matrix does not contain the baselines; else empty."""
    try:
        if source.stage is not None:
            require_baselines(inputs, source.stage.reduction.model)
    except DataError as error:
        return [f"{error.problem}: {'first fix the causes of the other warnings' if inputs.warnings else error.hint}"]
    return []


def _of_job(source: Looking, exported: Looking, name: str, look: Callable[[Looking], OfJob]) -> OfJob:
    """Findings of a job beside the ``source`` that the reference job left; an exchange may show beside the model as ``exported`` only."""
    found = look(source)
    if source is exported or not kinds_of(found.told) <= {Kind.FOREIGN} or source.left[name] <= UNLIKE:
        return found
    return again if Kind.EXCHANGED in kinds_of((again := look(exported)).told) else found


def _looked_at(
    source: Looking,
    measurements: Mapping[str, Measurement],
    name: str,
    tight: Measurement | None = None,
    cycles: Sequence[tuple[int, ...]] = (),
    explained: Callable[[], bool] = lambda: False,
) -> OfJob:
    """Findings of one job, by comparison with the model and, if given, with measurement ``tight`` and ``cycles`` of the reference job.

    Where it is ``explained`` otherwise, no wrong places or supports are looked for, which takes long.
    """
    seen = Seen.of(source, name, measurements[name], tight)
    inputs, held = seen.inputs, seen.held
    seen = seen.beside(held)
    assumed = name in taken_as_tight(inputs)
    fitted = None if held is None or seen.left <= (USUAL if assumed else NEAR) else fitted_frf(seen)  # tight states are more alike
    seen = seen.beside(fitted)
    if fitted is not None:
        source.away[name] = apart(seen.measured, fitted)
    elif held is not None:
        source.near[name] = apart(seen.measured, held)
    source.left[name] = seen.left
    if whole := _of_all(seen, fitted, assumed, measurements):
        return OfJob(whole)
    # Where all bolts are assumed tight, no bolt explains a difference.
    reach = (0.0, 0.0) if seen.reference or assumed else reach_of_one(seen)
    # Exchanged real and imaginary parts also look like complex conjugates.
    how = sideways(seen.measured, seen.states)
    backwards = not how and run_backwards(measurements[name].frequency_hz, measurements[name].values)
    near = [*nearest_states(seen), *(state for state in (held, fitted) if state is not None)]
    told, offsets = channel_findings(seen, near, reach[0], cycles, backwards=backwards)
    # A factor of all FRFs may be the material of the model.
    shared = seen.reference and any(len(each.responses) == len(offsets) for each in told if each.kind is Kind.UNITS)
    if shared and (text := material_text(seen, measurements[name], offsets)):
        return OfJob(said(Kind.MATERIAL, text))
    told, offsets = _by_chance(seen, measurements, told, offsets)
    # Places are looked for below; without a better finding these remain.
    uneven = [each for each in told if each.kind is Kind.PLACES]
    told = [each for each in told if each.kind is not Kind.PLACES]
    if not told and how:
        return OfJob([sideways_finding(inputs, how, name)])
    if not told and (cut := cut_text(seen, measurements[name])):
        return OfJob(said(Kind.CUT, cut))
    # A filter delays, too.
    delayed = {i for each in told for i in each.responses}
    if kinds_of(told) <= {Kind.LATE, Kind.EARLY} and (passed := filter_findings(seen, delayed)):
        return OfJob(passed)
    if not told and seen.reference:
        told = _of_model(seen, measurements, explained)
        kinds = kinds_of(told)
        if kinds <= {Kind.UNLIKE, Kind.ALONE, Kind.SPRINGS} and explained():
            # A table in another unit is told by what the calibration makes of it.
            return OfJob([each for each in told if each.kind is not Kind.SPRINGS] or uneven, offsets)
    told = placed(seen, told)
    if not told and held is not None:
        told = beside_tight(seen, held, reach) or beside_fit(seen, held, fitted)
    return OfJob(told or uneven, offsets)


def _by_chance(
    seen: Seen, measurements: Mapping[str, Measurement], told: list[Finding], offsets: tuple[Offset, ...]
) -> tuple[list[Finding], tuple[Offset, ...]]:
    """Findings and factors of a job, without factors that a reference job far from the model may show by chance."""
    if not gains_by_chance(seen, told, offsets):
        return told, offsets
    if far := [one for one in _of_model(seen, measurements) if one.kind is not Kind.ALONE]:
        # Not shared with the other jobs, either.
        return far, tuple(replace(offset, named=False) for offset in offsets)
    # A calibration may show more.
    return [replace(each, kind=Kind.PLACES) for each in told], offsets


def _of_all(seen: Seen, fitted: Complexes | None, assumed: bool, measurements: Mapping[str, Measurement]) -> list[Finding]:
    """Findings on all FRFs of a job: another damping or reading, a loose bolt if it is ``assumed`` tight, hammer points, strikes."""
    reading = other_reading(seen.quantities, seen.measurement.frequency_hz, seen.measured, seen.states, seen.job)
    if alone := field_reading_text(seen):
        return said(Kind.READ, alone)
    beyond = seen.reference and seen.misfit >= LEAST_DIFFERENCE
    if beyond and (text := overdamped_text(seen, CLEARLY * seen.misfit if reading is None else reading.after)):
        return said(Kind.DAMPING, text)
    if reading is not None:
        return said(Kind.READ, reading.text)
    loose = _not_tight(seen, seen.held, measurements) if seen.held is not None and assumed else ""
    return (
        said(Kind.FREED, loose)
        or said(Kind.HAMMERS, hammers_text(seen, None if fitted is None else partial(fitted_exchanged, seen)) or unmoved_text(seen))
        or said(Kind.STRIKE, "" if fitted is None else strike_text(seen, fitted))
    )


def _of_model(seen: Seen, measurements: Mapping[str, Measurement], explained: Callable[[], bool] = lambda: False) -> list[Finding]:
    """Findings of the reference job if the model is far from it: another material, factor or unit, or little in common.

    No wrong factor of a matrix or a part, which takes long, where a calibration within its bounds has ``explained`` it.
    """
    told = other_tables(seen) or little_in_common(seen, measurements, explained)
    if Kind.UNLIKE in kinds_of(told):
        stretched = said(Kind.STRETCHED, stretched_text(measurements[seen.job], seen))
        # Joints can make up for much of what one factor on all frequencies says more simply.
        joints = [] if explained() else said(Kind.SPRINGS, joints_text(seen, most=NEAR if stretched else EXPLAINED))
        rescaled = "" if joints or stretched or explained() else rescaled_text(seen, seen.misfit, further=1.5)
        told = joints or stretched or said(Kind.RESCALED, rescaled) or told
    return told


def _not_tight(seen: Seen, held: Complexes, measurements: Mapping[str, Measurement]) -> str:
    """See ``tightness.not_tight``; nothing of a job that usual changes of the bolts explain."""
    source = seen.source
    if seen.job in source.away and within_scatter(source.away[seen.job], source.changes.get(seen.job)):
        return ""
    tight = {seen.inputs.campaign.update.reference, *taken_as_tight(seen.inputs)}
    return not_tight(seen, held, on_lines(seen, measurements, [name for name in measurements if name not in tight]))


def _seen_and_calibrated(source: Looking, measurements: Mapping[str, Measurement], name: str) -> tuple[Looking, OfJob]:
    """Model for the other jobs, and findings of the reference job ``name``, after a rough calibration where that helps."""
    rough, own = cache_of(lambda: roughly_calibrated(source, measurements[name])), source.inputs.campaign.calibration

    @cache_of
    def explained() -> bool:
        """Whether a calibration with factors within their bounds brings the model near at all hammer points."""
        if own is None or own.job != name or (found := rough()) is None or found.at_bounds:
            return False
        after = Seen.of_model(found, name, measurements[name])
        return max(after.misfit, *after.by_excitation.values()) <= LEAST_DIFFERENCE

    first = _looked_at(source, measurements, name, explained=explained)
    # A factor on the frequencies or the springs, or a mass somewhere, may mend half of what a wrong part causes; the part mends all of it.
    if kinds_of(first.told) & {Kind.RESCALED, Kind.STRETCHED, Kind.MATERIAL, Kind.SPRINGS} and (
        part := part_cause(Seen.of(source, name, measurements[name]), measurements[name], most=NEAR).text
    ):
        return source, OfJob(said(Kind.MATERIAL, part))
    return _calibrated(source, measurements, name, first, rough)


def _calibrated(
    source: Looking, measurements: Mapping[str, Measurement], name: str, first: OfJob, rough: Callable[[], Looking | None]
) -> tuple[Looking, OfJob]:
    """Model after the ``rough`` calibration from job ``name``, and the findings with it; both unchanged if a calibration would not help.

    Nothing is calibrated from a job that loose bolts explain.
    """
    calibration, kinds = source.inputs.campaign.calibration, kinds_of(first.told)
    if calibration is None or calibration.job != name or not all(each.has(Effect.IS_CALIBRATED) for each in first.told):
        return source, first
    seen = Seen.of(source, name, measurements[name])
    if loose := tighter_text(seen, measurements) or looser(seen, seen.misfit).removeprefix(". "):
        # Below what counts as unlike, nothing was said yet.
        told = first.told if first.told or seen.misfit <= LEAST_DIFFERENCE else said(Kind.NOT_TIGHT, loose_text(seen, loose))
        return source, replace(first, told=told)
    calibrated = rough()
    if calibrated is None:
        return source, replace(first, told=uncalibrated(seen, measurements, first.told))
    again, after = _looked_at(calibrated, measurements, name), Seen.of(calibrated, name, measurements[name])
    # A calibration takes a wrong clock for another stiffness, so only a place that it shows is told instead.
    if Kind.STRETCHED in kinds and not kinds_of(again.told) & {Kind.COORDINATES, Kind.HAMMER, Kind.HAMMERS, Kind.EXCHANGED}:
        return source, first
    far = Kind.UNLIKE in kinds | kinds_of(again.told) and after.misfit > LEAST_DIFFERENCE
    if far and (part := of_a_part(seen, measurements[name], after.misfit, lump=False)):
        return source, OfJob(part)
    # Nothing found is no all-clear while the FRFs of another excitation are not fitted; levels of some responses may be off by the model.
    unsure = after.misfit > LEAST_DIFFERENCE and kinds_of(again.told) <= {Kind.PLACES, Kind.ALONE}
    if (not again.told or unsure) and (Kind.COORDINATES in kinds or any(db > LEAST_DIFFERENCE for db in after.by_excitation.values())):
        told = said(Kind.MATERIAL, loaded_text(after)) or of_a_part(seen, measurements[name], after.misfit)
        if told or Kind.UNLIKE in kinds or after.misfit <= LEAST_DIFFERENCE:
            return calibrated, OfJob(told) if told else first
        return calibrated, OfJob(badly_calibrated(after, seen.misfit))
    if unit := of_other_unit_text(seen, after):
        return calibrated, OfJob(said(Kind.SPRINGS, unit))
    if not kinds_of(again.told) and after.misfit > NEAR and (bound := at_bounds_text(calibrated, after.misfit)):
        return calibrated, OfJob(said(Kind.MATERIAL, bound))
    moved = [*said(Kind.LOWERED, or_held(seen, lowered_text(seen, after))), *said(Kind.SPRINGS, raised_text(seen, after))]
    # Single responses stand out by a wrong part or joint, too.
    if kinds_of(again.told) <= {Kind.ALONE, Kind.PLACES} and not moved and after.misfit > USUAL:
        if (others := _without_sensors(source, measurements[name], name, again.told)) is not None:
            return others, _looked_at(others, measurements, name)
        part = of_a_part(seen, measurements[name], after.misfit)
        return calibrated, replace(again, told=part or again.told)
    return calibrated, replace(again, told=[*again.told, *moved])


def _without_sensors(source: Looking, measurement: Measurement, name: str, told: Sequence[Finding]) -> Looking | None:
    """Model after a rough calibration from job ``name`` without the sensors that were told; None if it does not fit all others then.

    A single wrong sensor spoils a calibration, and then all responses differ as if a part were wrong.
    """
    inputs, alone = source.inputs, {i for each in told for i in each.responses}
    if not alone:
        return None
    own = np.ones(len(inputs.responses), dtype=bool)
    own[list(alone.union(*(same_sensor(inputs, i) for i in alone)))] = False
    found = calibrated_from(source, measurement, own) if own.any() else None
    if found is None:
        return None
    seen = Seen.of_model(found, name, measurement)
    left = float(np.median(apart(seen.measured, seen.model)[own]))
    without = listing([inputs.responses[i].name for i in np.flatnonzero(~own)], 4)
    note = f"compared with a rough calibration from {name} without {without}, not stored: level misfit {left:.1f} dB"
    return replace(found, note=note) if left <= USUAL else None


def _of_reference(source: Looking, measurements: Mapping[str, Measurement], name: str) -> tuple[Looking, OfJob]:
    """Model for the other jobs, and findings of the reference job ``name``.

    A stored calibration hides mistakes by wrong factors: a sensor along another axis, another material, a constraint. So the model as
    exported is compared first, and what it tells holds unless the calibration mends it. Single records that repeat are left out.
    """
    used, found = _of_one(source, measurements, name)
    again = [other for other in measurements if other != name and other in taken_as_tight(source.inputs)]
    if Kind.ALONE in kinds_of(found.told) and again:
        seen = Seen.of(used, name, measurements[name])
        found = replace(found, told=without_repeated(seen, found.told, on_lines(seen, measurements, again)))
    return used, found


def _of_one(source: Looking, measurements: Mapping[str, Measurement], name: str) -> tuple[Looking, OfJob]:
    """See ``_of_reference``, from the reference job alone."""
    seen = Seen.of(source, name, measurements[name])
    if seen.misfit <= LEAST_DIFFERENCE and (idle := idle_text(seen, every=True)):
        return source, OfJob(said(Kind.IDLE, idle))
    if (exported := as_exported(source)) is not None:
        exported = calibrated_from_another(exported, measurements)
        first, found = _seen_and_calibrated(exported, measurements, name)
        if not all(each.has(Effect.IS_FAR) for each in found.told):
            return first, found
    return _seen_and_calibrated(source, measurements, name)
