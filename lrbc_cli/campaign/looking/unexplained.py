"""Likely causes where neither factors nor exchanged records explain a job: places, coordinates, supports, single responses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification.compared.likeness import LEAST_DIFFERENCE, apart, outlying
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.all_jobs import Told
from lrbc_cli.campaign.looking.causes.coordinates import coordinates_texts, mirrored_text
from lrbc_cli.campaign.looking.causes.held import held_text, idle_text, supports_text
from lrbc_cli.campaign.looking.causes.moved import hammer_text, sensor_text
from lrbc_cli.campaign.looking.causes.rescaled import rescaled_text, softness_text
from lrbc_cli.campaign.looking.causes.tightness import UNLIKE, looser, tighter_text
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.reading.inputs import Inputs


def placed(seen: Seen, told: Told) -> Told:
    """Findings ``told`` of a job, replaced or completed by wrong places of hammer or sensors, or fixed nodes, if these explain it."""
    away = apart(seen.measured, seen.states)
    every = np.median(away, axis=1)
    # If all sensors are mirrored, some seem exchanged, and the others are far off, too.
    involved = {i for kind in told if kind[0] == "exchanged" for cycle in kind[1:] if isinstance(cycle, tuple) for i in cycle}
    rest = np.setdiff1d(np.arange(away.shape[1]), list(involved))
    beyond = not told or ("unlike",) in told or (involved and (not rest.size or float(np.median(away[0, rest])) > LEAST_DIFFERENCE))
    if seen.reference and beyond and float(every[0]) > LEAST_DIFFERENCE and (mirrored := mirrored_text(seen)):
        return {("mirrored",): mirrored}
    # The bolts may be in a state that was not tried, so misfits up to ``UNLIKE`` are accepted.
    # In the reference job no bolt is loose, so a smaller misfit is examined already.
    # With a calibrated model a single hammer point may be wrong.
    uneven = {at for at, db in seen.by_excitation.items() if seen.reference and db > seen.least_of(at)}
    calibrated = seen.reference and bool(seen.source.start)
    far = bool(uneven) if calibrated else float(every.min()) > (LEAST_DIFFERENCE if seen.reference else UNLIKE)
    # Single responses stand out, too, if their hammer point is wrong.
    others = {key for key in told if key[0] != "alone" or not calibrated or int(seen.inputs.input_of[int(str(key[1]))]) not in uneven}
    struck = _of_one_blow(seen, told)
    if ("unlike",) in told or struck or (not others and far):
        if text := hammer_text(seen, away):
            return {("hammer",): text}
        if struck:
            return {("hammer",): struck}
        if seen.reference and (text := held_text(seen, float(every[0]))):
            return {("held",): text}
        # Where springs are at wrong nodes, supports are no cause of their own.
        if seen.reference and ("unlike",) in told and not seen.inputs.springs_doubt:
            told = told | {("unlike",): told["unlike",] + supports_text(seen)}
    if not seen.reference:
        return told
    told = _stated(seen, told)
    elsewhere = {key: sensor_text(seen, int(str(key[1]))) for key in told if key[0] == "alone"}
    # After a calibration, a response with small motion stands out by errors of the model alone.
    weak = {
        key
        for key, where in elsewhere.items()
        if seen.source.start and not where and apart(seen.measured, seen.model)[int(str(key[1]))] <= UNLIKE
    }
    return {key: text + elsewhere.get(key, "") for key, text in told.items() if key not in weak}


def _of_one_blow(seen: Seen, told: Told) -> str:
    """Warning if the single responses that differ are most of those of one excitation and none of another; else empty."""
    alone = [int(str(key[1])) for key in told if key[0] == "alone"]
    away, input_of = seen.by_excitation, seen.inputs.input_of
    if not alone or len(away) < 2 or len(own := set(input_of[alone].tolist())) > 1:
        return ""
    at = own.pop()
    if 2 * len(alone) <= int((input_of == at).sum()):
        return ""
    name, rest = seen.inputs.excitations[at], max(db for other, db in away.items() if other != at)
    return (
        f"FRFs of {name} differ from the model by {away[at]:.1f} dB (median over its responses, mean level of each removed), those of "
        f"other excitations by {rest:.1f} dB at most. Check the place and the direction of excitation.{name}, and that its records are not "
        "those of another hammer point"
    )


def _stated(seen: Seen, told: Told) -> Told:
    """Findings of the reference job with those of wrong coordinates, which replace other findings of the same sensors."""
    if not {kind for kind, *_ in told} <= {"unlike", "alone"}:
        return told
    found, left = coordinates_texts(seen, unlike=("unlike",) in told)
    elsewhere = {i for responses in found for i in responses}
    kept = {
        key: text
        for key, text in told.items()
        if key[1:] not in {(i,) for i in elsewhere} and not (found and key == ("unlike",) and float(np.median(left)) <= UNLIKE)
    }
    return {("coordinates", *responses): text for responses, text in found.items()} | kept


def little_in_common(seen: Seen, measurements: Mapping[str, Measurement]) -> Told:
    """Warnings if the tight state is not explained although neither factors nor exchanged sensors were found.

    ``measurements`` of all jobs: another one may be nearer to the tight model.
    """
    inputs, every = seen.inputs, apart(seen.measured, seen.model)
    own = every[inputs.used]
    typical = float(np.median(every))
    told: Told = {}
    if typical > LEAST_DIFFERENCE:
        text = rescaled_text(seen, typical)
        if text is not None:
            return {("rescaled",): text}
        if idle := idle_text(seen):
            return {("idle",): idle}
    if float(np.median(own)) > UNLIKE:
        far = f"level misfits of {min(own):.1f} to {max(own):.1f} dB at the start values (mean level of each response removed)"
        far += _uneven_text(seen)
        if tighter := tighter_text(seen, measurements):
            return {("unlike",): f"measured and computed FRFs differ: {far}. {tighter}{looser(seen, typical)}"}
        causes = "the springs whose places are warned of may be the reason; otherwise " if inputs.springs_doubt else ""
        causes += (
            "check the mass sum (units of the model), the material of each part, damping, start values, places and directions of hammer "
            "and sensors (lrbc check --picture); `lrbc calibrate` corrects errors of some per cent" + softness_text(seen)
        )
        if free := looser(seen, typical):
            causes = f"this is the reference job{free}. Set update.reference to a tight job, or measure it again; otherwise {causes}"
        told["unlike",] = f"measured and computed FRFs have little in common: {far}. {causes[:1].upper()}{causes[1:]}"
    return told | single_responses(inputs, every, "the model")


def _uneven_text(seen: Seen, *, uneven: float = 1.5) -> str:
    """Clause that names the excitation whose FRFs differ most, if by ``uneven`` times as much as any other's; else empty."""
    worst, *others = sorted(seen.by_excitation.items(), key=lambda item: -item[1])
    if not others or worst[1] < uneven * others[0][1]:
        return ""
    name = seen.inputs.excitations[worst[0]]
    return f", mostly those of {name} ({worst[1]:.1f} dB, others up to {others[0][1]:.1f} dB: check excitation.{name} first)"


def single_responses(inputs: Inputs, every: Floats, of: str, job: str | None = None) -> Told:
    """Warnings about single responses with a large distance ``every`` (R,) [dB] from ``of``; relative to the reference job if ``job``."""
    told: Told = {}
    for i in outlying(every):
        response = inputs.responses[i].name
        causes = f"Check the place and the component of responses.{response} (lrbc check --picture), and that the channel is not another"
        causes += " sensor's"
        if job is not None:
            causes = "Check whether its sensor was dead, overloaded or moved, or another one was connected. Measure it again, or remove "
            causes += f"its record from the file of {job}"
        told["alone", i] = (
            f"{response} differs from {of} by {every[i]:.1f} dB (mean level removed), the median of all responses is "
            f"{float(np.median(every)):.1f} dB. {causes}"
        )
    return told
