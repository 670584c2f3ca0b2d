"""Jobs that are taken as tight, and look as if bolts were free."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from lrbc_cli.arrays import Complexes
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.reading.inputs import Inputs

#: From so much on, in the median over the responses used, the tight state is no model's with small errors [dB].
UNLIKE = 6.0

#: Of two tight jobs that differ by more than that, the one is tight whose distance from the tight model is below this share of the other's:
#: two that are as tight as stated differ by less, and lie about as far from it.
NEARER = 0.65


def taken_as_tight(inputs: Inputs) -> set[str]:
    """Jobs other than the reference job in which all bolts are taken as tight."""
    campaign = inputs.campaign
    return {*campaign.update.baselines, *([campaign.calibration.job] if campaign.calibration is not None else [])}


def tighter_text(seen: Seen, measurements: Mapping[str, Measurement]) -> str:
    """Which other jobs are those of the model with all bolts tight, where the reference job is not, and what to do; empty where none is."""
    reference, every = seen.job, {name: Seen.of(seen.source, name, whole) for name, whole in measurements.items()}
    far = {name: float(np.median(apart(own.measured, own.model))) for name, own in every.items()}

    def share(name: str) -> float:
        values, other = every[name].measured, every[reference].measured
        known = name in taken_as_tight(seen.inputs) and values.shape == other.shape
        return NEARER if known and float(np.median(apart(values, other))) > UNLIKE else CLEARLY

    near = {name: own for name, own in far.items() if name != reference and own < min(UNLIKE, share(name) * far[reference])}
    if not near:
        return ""
    order = sorted(near.items(), key=lambda each: each[1])
    other = " (or that of another of these)" if len(near) > 1 else ""
    named, first = ", ".join(f"{name} ({own:.1f} dB)" for name, own in order), order[0][0]
    return (
        f"{named} {'fits' if len(near) == 1 else 'fit'} the tight model far better than {reference} ({far[reference]:.1f} dB). If files "
        f"are exchanged, exchange jobs.{reference}.frf and jobs.{first}.frf{other}. If a bolt was loose in "
        f"{reference}, set update.reference to a tight job"
    )


def not_tight(seen: Seen, held: Complexes) -> str:
    """What to say of a job that is taken as tight and lies far from the reference job, by the keys that take it so; empty where it is near.

    Tight states put together anew lie nearer to each other than models and measurements do, whatever it is that is another there.

    Parameters
    ----------
    seen : Seen
    held : (F, R) complex array
        What the reference job measured, see ``Seen.held``.
    """
    reference, name = seen.inputs.campaign.update.reference, seen.job
    stated, found = (float(np.median(apart(values, seen.model))) for values in (held, seen.measured))
    # What the model lacks in the reference job it lacks in another tight one, too.
    there = held != 0
    own = seen.reading(seen.measured * np.where(there, seen.model / np.where(there, held, 1.0), np.nan))
    before = float(np.median(apart(own.measured, own.model)))
    freed = looser(own, before) if before > LEAST_DIFFERENCE else ""
    nearer = before > LEAST_DIFFERENCE and found < NEARER * stated
    if not freed and not nearer and before <= UNLIKE:
        return ""
    campaign, fixes = seen.inputs.campaign, list[str]()
    if name in campaign.update.baselines:
        fixes.append("remove it from update.baselines")
    if campaign.calibration is not None and campaign.calibration.job == name:
        fixes.append("set calibration.job to a tight job")
    fix = " and ".join(fixes)
    if nearer and (not freed or before > UNLIKE):
        return (
            f"it is taken as tight, but differs from {reference} by {before:.1f} dB, and is nearer to the tight model ({found:.1f} dB) "
            f"than {reference} is ({stated:.1f} dB). Check whether a bolt was loose in {reference}. Correct jobs.{reference}.frf, or set "
            f"update.reference to a tight job; otherwise {fix}"
        )
    return (
        f"it is taken as tight, but differs from {reference} by {before:.1f} dB{freed or '. Check whether all bolts were tight'}. "
        f"{fix[:1].upper()}{fix[1:]}, or measure it again"
    )


def looser(seen: Seen, typical: float) -> str:
    """What the tight state looks like where some values are free, in a clause; empty where that is not clearly nearer."""
    inputs, loosened = seen.inputs, seen.loosened
    distances = np.median(apart(seen.measured, seen.states[: len(loosened)]), axis=1)
    best = int(np.argmin(distances))
    if distances[best] > CLEARLY * typical or not loosened[best].size:
        return ""
    for group, where, _ in seen.parameters.placed:
        if where.start <= loosened[best][0] < where.stop:
            at = loosened[best] - where.start
            owners = [] if group.bolt is None or inputs.bolts is None else [inputs.bolts.name[b] for b in group.bolt[at] if b >= 0]
            named = ", ".join(dict.fromkeys(owners)) or f"values {at[0] + 1} to {at[-1] + 1} of parameters.{group.name}"
            return f". With {named} free the level misfit is {distances[best]:.1f} dB: check whether all bolts were tight"
    return ""


def lowered_text(before: Seen, after: Seen, *, least: float = 1.0) -> str:
    """Which bolts a rough calibration lowers with all their springs; empty where it lowers none.

    Parameters
    ----------
    before, after : Seen
        The reference job beside the model as exported, and beside the calibrated one.
    least : float
        By how much each spring has to fall below the median of its group [decades].
    """
    bolts, change = before.inputs.bolts, dict[int, float]()
    for group, where, _ in before.parameters.placed:
        if group.kind != "stiffness" or group.bolt is None:
            continue
        moved = (after.parameters.initial - before.parameters.initial)[where]
        for bolt, own in zip(group.bolt.tolist(), (moved - np.median(moved)).tolist(), strict=True):
            change[bolt] = max(change.get(bolt, -np.inf), own)
    low = {bolt: own for bolt, own in change.items() if bolt >= 0 and own <= -least}
    if bolts is None or not low:
        return ""
    named = ", ".join(f"{bolts.name[bolt]} ({-own:.1f} decades)" for bolt, own in sorted(low.items()))
    return (
        f"a rough calibration from this job lowers the stiffness of {named} more than that of the other bolts. Check whether all bolts "
        "were tight. If not, set update.reference and calibration.job to a tight job, or measure it again"
    )
