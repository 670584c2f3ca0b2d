"""Likely causes where neither factors nor exchanged records explain a job: places, coordinates, supports, single responses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from types import MappingProxyType

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.findings import Finding, Kind, kinds_of, said
from lrbc_cli.campaign.identification.compared.likeness import (
    CLEARLY,
    LEAST_DIFFERENCE,
    OTHER_LEVEL_DB,
    apart,
    level_changes,
    off_level,
    other_reading,
    outlying,
)
from lrbc_cli.campaign.identification.compared.offsets import causes_of, quantities_of
from lrbc_cli.campaign.identification.compared.sensors import same_sensor
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.axes import out_of_reach_text
from lrbc_cli.campaign.looking.causes.added import added_text, missing_cause
from lrbc_cli.campaign.looking.causes.coordinates import coordinates_texts
from lrbc_cli.campaign.looking.causes.held import held_text, idle_text, supports_text, tied_text
from lrbc_cli.campaign.looking.causes.moved import hammer_text, sensor_text
from lrbc_cli.campaign.looking.causes.parts import lump_text, part_cause, part_text
from lrbc_cli.campaign.looking.causes.rescaled import air_text, rescaled_text, softness_text
from lrbc_cli.campaign.looking.causes.tables import unit_text
from lrbc_cli.campaign.looking.causes.tightness import looser, tighter_text
from lrbc_cli.campaign.looking.causes.together import together_text
from lrbc_cli.campaign.looking.displaced import displaced_cause
from lrbc_cli.campaign.looking.fitted import calibrated_from, carefully_fitted, expected_frf
from lrbc_cli.campaign.looking.states import Seen, by_excitation
from lrbc_cli.campaign.looking.trials import NEAR, NEARER, UNLIKE, USUAL, Cause
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.comparison.scale import Offset, grouped


def placed(seen: Seen, told: list[Finding]) -> list[Finding]:
    """Findings ``told`` of a job, replaced or completed by wrong places of hammer or sensors, or fixed nodes, if these explain it."""
    away, kinds = apart(seen.measured, seen.states), kinds_of(told)
    every = np.median(away, axis=1)
    # If all sensors are mirrored, some seem exchanged, and the others are far off, too.
    involved = {i for each in told for cycle in each.cycles for i in cycle}
    rest = np.setdiff1d(np.arange(away.shape[1]), list(involved))
    beyond = not told or Kind.UNLIKE in kinds or (involved and (not rest.size or float(np.median(away[0, rest])) > LEAST_DIFFERENCE))
    if seen.reference and beyond and (moved := together_text(seen)):
        return said(Kind.ORIGIN, moved)
    # The bolts may be in a state that was not tried, so misfits up to ``UNLIKE`` are accepted.
    # In the reference job no bolt is loose, so a smaller misfit is examined already.
    # With a calibrated model a single hammer point may be wrong.
    uneven = {at for at, db in seen.by_excitation.items() if seen.reference and db > seen.least_of(at)}
    calibrated = seen.reference and seen.source.fitted_to is not None
    far = bool(uneven) if calibrated else float(every.min()) > (LEAST_DIFFERENCE if seen.reference else UNLIKE)
    # Single responses stand out, too, if their hammer point is wrong.
    struck_there = [each for each in told if each.kind is Kind.ALONE and calibrated and uneven.issuperset(_struck(seen, each.responses))]
    struck = _of_one_blow(seen, told)
    if Kind.UNLIKE in kinds or struck or (len(struck_there) == len(told) and far):
        # Where the model is far from the tight state, too, it does not tell the places of a single job.
        near = seen.reference or seen.source.left.get(seen.inputs.campaign.update.reference or "", 0.0) <= UNLIKE
        if cause := said(Kind.HAMMER, (hammer_text(seen, away) if near else "") or struck):
            return cause
        if seen.reference and (cause := said(Kind.HELD, held_text(seen, float(every[0])))):
            return cause
        if seen.reference and Kind.UNLIKE in kinds and (cause := said(Kind.MATERIAL, added_text(seen, float(every[0])))):
            return cause
        # Where springs are at wrong nodes, supports are no cause of their own.
        if seen.reference and Kind.UNLIKE in kinds and not seen.inputs.springs_doubt:
            told = [replace(each, text=each.text + supports_text(seen)) if each.kind is Kind.UNLIKE else each for each in told]
    return _stated(seen, told) if seen.reference else told


def _struck(seen: Seen, responses: Sequence[int]) -> set[int]:
    """Numbers of the excitations of responses."""
    return set(seen.inputs.input_of[list(responses)].tolist())


def _of_one_blow(seen: Seen, told: list[Finding]) -> str:
    """Warning if the single responses that differ are most of those of one excitation and none of another; else empty."""
    alone = [i for each in told if each.kind is Kind.ALONE for i in each.responses]
    away, input_of = seen.by_excitation, seen.inputs.input_of
    if not alone or len(away) < 2 or len(own := _struck(seen, alone)) > 1:
        return ""
    at = own.pop()
    if 2 * len(alone) <= int((input_of == at).sum()):
        return ""
    return _blow_text(seen, away, at, "the model")


def _blow_text(seen: Seen, away: Mapping[int, float], at: int, what: str) -> str:
    """Warning that the records of excitation ``at`` alone differ from ``what``, by the level misfits of all excitations [dB]."""
    name, rest = seen.inputs.excitations[at], max(db for other, db in away.items() if other != at)
    return (
        f"FRFs of {name} differ from {what} by {away[at]:.1f} dB (median over its responses, mean level of each removed), those of "
        f"other excitations by {rest:.1f} dB at most. Check the place and the direction of excitation.{name}"
        f"{'' if seen.reference else ' in this job'}, and that its records are not those of another hammer point or state of the bolts"
    )


def _stated(seen: Seen, told: list[Finding]) -> list[Finding]:
    """Findings of the reference job with those of wrong coordinates, which replace other findings of the same sensors."""
    if kinds_of(told) <= {Kind.UNLIKE, Kind.ALONE}:
        found, left = coordinates_texts(seen, unlike=Kind.UNLIKE in kinds_of(told))
        elsewhere = {i for responses in found for i in responses}
        explained = bool(found) and float(np.median(left)) <= UNLIKE
        told = [
            *(Finding(text=text, kind=Kind.COORDINATES, responses=responses) for responses, text in found.items()),
            *(each for each in told if not elsewhere.intersection(each.responses) and not (explained and each.kind is Kind.UNLIKE)),
        ]
    # A sensor along another axis may be as far below the level of the model as a dead one.
    told = _dead(seen, told)
    alone = [i for each in told if each.kind is Kind.ALONE for i in each.responses]
    if not alone:
        return told
    every = apart(seen.measured, seen.model)
    better = {i: text for i in alone if (text := sensor_text(seen, i))}
    # After a calibration, a response with small motion stands out by errors of the model alone.
    kept = [i for i in alone if i in better or seen.source.fitted_to is None or every[i] > UNLIKE]
    told = [each for each in told if each.kind is not Kind.ALONE]
    return told + single_responses(seen.inputs, every, kept, "the model", better=better)


def _dead(seen: Seen, told: list[Finding]) -> list[Finding]:
    """Findings of the reference job in which single responses far below the level of the model are dead channels, not sensors elsewhere."""
    alone = {i for each in told if each.kind is Kind.ALONE for i in each.responses}
    below = {i: db for i, db in level_changes(seen.measured, seen.model).items() if db < -OTHER_LEVEL_DB}
    dead = tuple(sorted(i for i in alone & below.keys() if below.keys() >= set(same_sensor(seen.inputs, i))))
    if not dead:
        return told
    names = ", ".join(seen.inputs.responses[i].name for i in dead)
    text = (
        f"{names}: no signal: {-max(below[i] for i in dead):.0f} dB or more below the level of the model, and another shape, unlike the "
        f"other responses. Check the sensor, its cable and its supply, and measure again, or remove {'it' if len(dead) == 1 else 'them'} "
        "from the campaign file"
    )
    kept = [each for each in told if each.kind is not Kind.ALONE or not set(each.responses) <= set(dead)]
    return [*kept, Finding(text=text, kind=Kind.LEVEL, responses=dead)]


def little_in_common(seen: Seen, measurements: Mapping[str, Measurement], explained: Callable[[], bool] = lambda: False) -> list[Finding]:
    """Findings if the tight state is not explained although neither factors nor exchanged sensors were found.

    ``measurements`` of all jobs: another one may be nearer to the tight model. Where a calibration has ``explained`` it, no factor of a
    matrix and no wrong part is looked for.
    """
    inputs, every = seen.inputs, apart(seen.measured, seen.model)
    own = every[inputs.used]
    typical = float(np.median(every))
    told = list[Finding]()
    if typical > LEAST_DIFFERENCE and (
        cause := said(Kind.RESCALED, "" if explained() else rescaled_text(seen, typical))
        or said(Kind.MATERIAL, "" if explained() else air_text(seen, typical))
        or said(Kind.IDLE, idle_text(seen))
        or said(Kind.SPRINGS, unit_text(seen, typical))
        or said(Kind.MATERIAL, "" if explained() else lump_text(seen, typical) or part_text(seen, typical))
    ):
        return cause
    if float(np.median(own)) > (LEAST_DIFFERENCE if seen.source.fitted_to not in (None, seen.job) else UNLIKE):
        far = f"level misfits of {min(own):.1f} to {max(own):.1f} dB at the start values (mean level of each response removed; after a "
        far += "calibration 1 to 2 dB are usual)"
        if tighter := tighter_text(seen, measurements):
            # Jobs that fit have the same hammer points.
            return said(Kind.NOT_TIGHT, f"measured and computed FRFs differ: {far}. {tighter}")
        far += _uneven_text(seen)
        causes = "the springs whose places are warned of may be the reason; otherwise " if inputs.springs_doubt else ""
        causes += _usual(seen)
        if free := looser(seen, typical):
            causes = f"this is the reference job{free}. Set update.reference to a tight job, or measure it again; otherwise {causes}"
        text = f"measured and computed FRFs have little in common: {far}{softness_text(seen)}"
        told = [Finding(text=text, fix=causes[:1].upper() + causes[1:], kind=Kind.UNLIKE)]
    # Each on its own: ``placed`` looks for the place of each.
    return told + single_responses(inputs, every, outlying(every), "the model", few=every.size)


def badly_calibrated(seen: Seen, before: float) -> list[Finding]:
    """Finding of the reference job, from which a rough calibration leaves the model far, of ``before`` [dB], for no known cause."""
    text = (
        f"a rough calibration leaves {seen.misfit:.1f} dB between measured and computed FRFs, of {before:.1f} dB (mean level of each "
        "removed; 1 to 2 dB are usual): the FE model is probably wrong. A stiffener, another part or a support may be missing, a part may "
        "have another thickness or be joined otherwise, or the mesh may be too coarse or its elements too stiff"
    )
    fix = _usual(seen)
    return [Finding(text=text, fix=fix[:1].upper() + fix[1:], kind=Kind.UNLIKE)]


def uncalibrated(seen: Seen, measurements: Mapping[str, Measurement], told: list[Finding]) -> list[Finding]:
    """Findings of the reference job, of which no rough calibration brings the model near: a stiffness out of reach, or supports."""
    measurement = measurements[seen.job]
    if Kind.UNLIKE in kinds_of(told):
        text = out_of_reach_text(measurement, seen)
        return said(Kind.MATERIAL, text) or of_a_part(seen, measurement, seen.misfit) or of_one_field(seen, measurement, told)
    differ = f"measured and computed FRFs differ by {seen.misfit:.1f} dB (median of the responses, mean level of each removed)"
    if not told and seen.misfit > LEAST_DIFFERENCE and (tighter := tighter_text(seen, measurements, least=LEAST_DIFFERENCE)):
        return said(Kind.NOT_TIGHT, f"{differ}. {tighter}")
    if not told and seen.misfit > LEAST_DIFFERENCE and (held := supports_text(seen)):
        text = (
            f"{differ}, more than a calibration corrects{held}. Correct the supports in the FE model: remove the constraint where the test "
            "bench has none, and add what it has besides, such as props or slings. Then export it again"
        )
        return said(Kind.UNLIKE, text)
    return told


def of_a_part(seen: Seen, whole: Measurement, calibrated: float, *, lump: bool = True) -> list[Finding]:
    """Findings of a tie beside the bolts, of a mass (``lump``) that the model lacks, a wrong part of it, or a joint elsewhere.

    The latter three come from calibrations with each of them; ``calibrated``: level misfit after a rough calibration without [dB]. Nothing
    where springs at wrong nodes are warned of already.
    """
    if seen.inputs.springs_doubt:
        return []
    if tied := tied_text(seen):
        return said(Kind.SPRINGS, tied)
    cause = missing_cause(seen, whole, calibrated, least=NEAR) if lump else Cause()
    # A part that is wrong looks like a mass or a support that is missing, which leaves more.
    if cause.left > NEAR and (part := part_cause(seen, whole, calibrated=calibrated)).left < cause.left:
        cause = part
    # So does a joint whose springs are elsewhere.
    if cause.left > USUAL and (elsewhere := displaced_cause(seen, whole, calibrated)).left < cause.left:
        return said(Kind.SPRINGS, elsewhere.text)
    return said(Kind.MATERIAL, cause.text)


def of_one_field(seen: Seen, measurement: Measurement, told: list[Finding]) -> list[Finding]:
    """Findings ``told`` of the reference job, which has little in common with the model, with what each field alone says.

    Where a rough calibration from the motion of the structure, or from the pressures, brings these near and leaves the others far, the
    fault is that of the others: a weighting, or their sensors.
    """
    air = np.array(seen.quantities) == "pressure"
    for own, words, others in ((~air, "motion of the structure", "pressures"), (air, "pressures", "motion of the structure")):
        one = calibrated_from(seen.source, measurement, own) if own.any() and not own.all() else None
        if one is None:
            continue
        after = Seen.of(one, seen.job, measurement)
        every = apart(after.measured, after.model)
        near, far = float(np.median(every[own])), float(np.median(every[~own]))
        if near > LEAST_DIFFERENCE or far <= max(LEAST_DIFFERENCE, near / CLEARLY):
            continue
        quantities = [quantity for quantity, there in zip(seen.quantities, own, strict=True) if not there]
        hz, measured, states = after.measurement.frequency_hz, after.measured[:, ~own], after.states[:, :, ~own]
        if reading := other_reading(quantities, hz, measured, states, seen.job):
            return said(Kind.READ, f"{others}: {reading.text}")
        clause = (
            f". After a rough calibration from the {words} alone, these FRFs are near ({near:.1f} dB), but not those of the {others} "
            f"({far:.1f} dB): check first what the latter have in common (sensors, conditioner, weighting, places"
            f"{', coupling and walls of the air in the model' if air[~own].any() else ''})"
        )
        return [
            replace(each, text=each.text + clause, fix=f"Otherwise {each.fix[:1].lower()}{each.fix[1:]}" if each.fix else "")
            if each.kind is Kind.UNLIKE
            else each
            for each in told
        ]
    return told


def _usual(seen: Seen) -> str:
    """What to check if nothing more is known."""
    air = "that structure and air are coupled on their whole common surface, " if seen.inputs.model.is_acoustic.any() else ""
    return (
        "check first the mass sum (units, missing parts), material and thickness of each part, stiffness and units of the springs, "
        f"{air}supports, damping, places and directions of hammer and sensors (lrbc check --picture), quantities, units and sensitivities "
        "of the FRFs; `lrbc calibrate` corrects errors of some per cent. Until the model fits, faults of other jobs may stay hidden"
    )


def _uneven_text(seen: Seen, *, uneven: float = 1.5) -> str:
    """Clause that names the excitation whose FRFs differ most, if by ``uneven`` times as much as any other's; else empty.

    If others are far off, too, its place is not the cause.
    """
    worst, *others = sorted(seen.by_excitation.items(), key=lambda item: -item[1])
    if not others or worst[1] < uneven * others[0][1] or others[0][1] > UNLIKE:
        return ""
    name = seen.inputs.excitations[worst[0]]
    return f", mostly those of {name} ({worst[1]:.1f} dB, others up to {others[0][1]:.1f} dB: check excitation.{name} first)"


def single_responses(
    inputs: Inputs,
    every: Floats,
    alone: Sequence[int],
    of: str,
    job: str | None = None,
    *,
    better: Mapping[int, str] = MappingProxyType({}),
    few: int = 2,
) -> list[Finding]:
    """Findings of the responses ``alone``, whose distances ``every`` (R,) [dB] from ``of`` are large.

    Relative to the reference job if ``job``. Those without a ``better`` place, a clause for each, are one finding if more than ``few``.
    """
    plain = [i for i in alone if i not in better]
    groups: list[list[int]] = [plain] if len(plain) > few else [[i] for i in plain]
    placed_at: dict[object, list[int]] = {}
    for i in alone:
        if i in better:
            # In one job a sensor was moved with all its records; of the campaign file each response is corrected.
            placed_at.setdefault(better[i] if job is not None else i, []).append(i)
    groups = [*placed_at.values(), *groups]
    typical = f"(mean level removed), the median of all responses is {float(np.median(every)):.1f} dB"
    found = []
    for group in groups:
        names = ", ".join(inputs.responses[i].name for i in group)
        if len(group) == 1:
            differ, sizes, sensor, it, record = "differs", f"{every[group[0]]:.1f}", "its sensor was", "it", "its record"
            causes = (
                f"the place and the component of responses.{names} (lrbc check --picture), and that the channel is not another sensor's"
            )
        else:
            differ, sizes = "differ", f"{every[group].min():.1f} to {every[group].max():.1f}"
            sensor, it, record = "their sensors were", "them", "their records"
            causes = "places and components of these responses (lrbc check --picture), and that the channels are not those of other sensors"
        if job is not None:
            causes = f"whether {sensor} loose, dead, overloaded or moved, or another one was connected"
            if group[0] in better:
                causes = f"whether the sensor was moved: {better[group[0]].removeprefix('; ')}"
            elif any(set(same_sensor(inputs, i)) - set(alone) for i in group):
                right = "(it is right at other hammer points)"
                causes = f"whether {sensor} overloaded or had fallen off, or a cable was loose, during these blows {right}"
            causes += f". Measure {it} again, or remove {record} from the file of {job}"
        where = better.get(group[0], "") if job is None else ""
        text = f"{names} {differ} from {of} by {sizes} dB {typical}. Check {causes}{where}"
        found.append(Finding(text=text, kind=Kind.ALONE, responses=tuple(group), detail=better.get(group[0], "")))
    return found


def without_repeated(seen: Seen, told: Sequence[Finding], others: Sequence[Complexes]) -> list[Finding]:
    """Findings of the reference job without single records that only errors of the model put apart.

    A sensor at another place, along another axis or with another's cable is wrong at all hammer points, and a record that was overloaded
    does not repeat. So a record without a better place is no finding if its sensor is right at another hammer point, and those of other
    jobs with all bolts tight are as far from the model.

    Parameters
    ----------
    seen : Seen
        The reference job.
    told : sequence of Finding
    others : sequence of (F, R) complex arrays
        Measurements of other tight jobs, on the same lines.
    """
    far, alone = apart(seen.measured, seen.model), {i for each in told if each.kind is Kind.ALONE for i in each.responses}
    again = [apart(values, seen.model) for values in others]
    repeated = {i for i in alone if again and set(same_sensor(seen.inputs, i)) - alone and all(away[i] > NEARER * far[i] for away in again)}
    return [each for each in told if each.kind is not Kind.ALONE or each.detail or not repeated.issuperset(each.responses)]


def beside_tight(seen: Seen, tight: Complexes, reach: tuple[Floats | float, Floats | float]) -> list[Finding]:
    """Single responses far from the reference job (``tight``, (F, R)) in shape or level, by more than one bolt can cause.

    ``reach`` is that limit, see ``reach_of_one``; distances must be twice as large, because the model has errors.
    """
    reference = str(seen.inputs.campaign.update.reference)
    away, every = off_level(seen.inputs, seen.measured, tight, reference, seen.job, reach[0]), apart(seen.measured, tight)
    found = [Finding(text=text, kind=Kind.LEVEL, responses=(i,)) for i, text in away.items()]
    limit, off = np.broadcast_to(reach[1], every.shape), {k for i in away for k in (i, *same_sensor(seen.inputs, i))}
    # A dead channel differs in shape, too; its level says more.
    far = [i for i in outlying(every) if CLEARLY * every[i] > limit[i] and i not in off]
    place = _placing(seen)
    better = {i: text for i in far if (text := place(i))}
    return single_responses(seen.inputs, every, far, f"its FRF in {reference}", seen.job, better=better) + found


def _placing(seen: Seen) -> Callable[[int], str]:
    """A clause on another place of a response in the state of the bolts that fits best, which is found when it is first asked for."""

    @cache
    def fitted() -> Seen | None:
        theta = carefully_fitted(seen)
        return None if theta is None else seen.at(theta)

    def place(response: int) -> str:
        there = fitted()
        return "" if there is None else sensor_text(there, response)

    return place


def many_loosened(change: Floats | None, *, loss: float = 0.5, share: float = 1 / 3) -> bool:
    """Whether more than a ``share`` of the bolts have a ``loss`` [decades] or more in the state fitted to a job, by their ``change`` (b,).

    What holds the structure is then another one, and errors of the model at single sensors are no longer those of the reference job.
    """
    return change is not None and bool(np.count_nonzero(change <= -loss) > share * change.size)


def beside_fitted(seen: Seen, fitted: Complexes, place: Callable[[int], str] = lambda _: "") -> list[Finding]:
    """Hammer point or sensors far from the state of the bolts that fits best (``fitted``, (F, R)), if that explains the others.

    ``place``: a clause on another place of a response that explains it, if there is one.
    """
    every, what = apart(seen.measured, fitted), "the state of the bolts that fits best"
    away = by_excitation(every, seen.inputs.input_of)
    worst = max(away, key=away.__getitem__)
    rest = max((db for at, db in away.items() if at != worst), default=np.inf)
    if rest < LEAST_DIFFERENCE < away[worst] and rest < CLEARLY * away[worst]:
        return [Finding(text=_blow_text(seen, away, worst, what), kind=Kind.HAMMER)]
    if float(np.median(every)) > UNLIKE or many_loosened(seen.source.changes.get(seen.job)):
        return []
    # Errors of the model show at single hammer points, too, so the median over these counts.
    own = [[i, *same_sensor(seen.inputs, i)] for i in range(every.size)]
    # A record alone may be overloaded; those of its sensor at other hammer points are right.
    far = [i for i in outlying(np.array([np.median(every[at]) for at in own])) if every[i] > LEAST_DIFFERENCE]
    return single_responses(seen.inputs, every, far, what, seen.job, better={i: text for i in far if (text := place(i))})


def foreign(seen: Seen, tight: Complexes) -> list[Finding]:
    """Finding if no state of the model, the fitted one included, is near a measurement, although the tight state is explained."""
    least = seen.left
    if least <= max(UNLIKE, float(np.median(apart(tight, seen.model))) / CLEARLY):
        return []
    text = (
        f"no tried state of the bolts comes near: the level misfit is {least:.1f} dB at best after a first, coarse fit (mean level of each "
        "response removed). Check whether it is the file of another structure or set-up, whether the hammer hit another point, and whether "
        "more changed than the bolts"
    )
    return said(Kind.FOREIGN, text)


def beside_fit(seen: Seen, tight: Complexes, fitted: Complexes | None) -> list[Finding]:
    """Findings of a job by its distance from the state that fits best. The first fit is coarse: nothing is said without a better one."""
    if fitted is None or not (beside_fitted(seen, fitted) or foreign(seen, tight)):
        return []
    theta = carefully_fitted(seen)
    assert theta is not None
    fitted = expected_frf(seen, theta)
    return beside_fitted(seen.beside(fitted), fitted, partial(sensor_text, seen.at(theta))) or foreign(seen.beside(fitted), tight)


def gains_by_chance(seen: Seen, told: Sequence[Finding], offsets: Sequence[Offset]) -> bool:
    """Whether all findings of the reference job are factors of less than half of the responses, without a known cause, beside a far model.

    Such a model, with a wrong material for example, is at another level at some response by chance.
    """
    few, compared = {i for each in told for i in each.responses}, [offset.response for offset in offsets]
    if not seen.reference or seen.misfit <= LEAST_DIFFERENCE or kinds_of(told) != {Kind.UNITS} or 2 * len(few) >= len(compared):
        return False
    shared = [common for common in grouped(offsets, quantities_of(seen.inputs)) if few.intersection(common.responses)]
    return not any(causes_of(seen.inputs, common, compared) for common in shared)
