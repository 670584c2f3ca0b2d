"""Signs and factors that all jobs have: told once, of all responses that share them, though no job shows each of them clearly.

Bolts and errors of the model hide in one job what shows in another. What is wrong with a hammer, a sensor or a unit is the same in all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.campaign.identification.compared.doubts import offset_texts, sign_tail
from lrbc_cli.campaign.identification.compared.likeness import same_sensor
from lrbc_cli.campaign.reading.inputs import Inputs
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

#: What is told of a job, each text under what tells whether another job has it, too.
Told = dict[tuple[object, ...], str]

#: What ``offset_texts`` tells.
_OF_OFFSETS = ("units", "reversed", "late", "early", "conjugate")


@dataclass(frozen=True)
class OfJob:
    """What is found of one job.

    Attributes
    ----------
    told : dict
    offsets : tuple of Offset
        Factors and phases of its responses; empty where something else has to be mended first.
    """

    told: Told
    offsets: tuple[Offset, ...] = ()


def told_of_all(inputs: Inputs, found: Mapping[str, OfJob], reference: str) -> dict[str, Told]:
    """What is told of each job, where signs and factors that all share stand under the same key in all.

    Parameters
    ----------
    inputs : Inputs
    found : mapping
        By job.
    reference : str
        What it does not show is not the same in all jobs.
    """
    told = {name: of.told for name, of in found.items()}
    several = {name: of.offsets for name, of in found.items() if of.offsets}
    own = several.get(reference, ())
    if len(several) < 2 or not own or any(o.delay or o.conjugate for o in own):
        return told
    shared = _factors(list(several.values()), own)
    cosines = _cosines(list(several.values()))
    texts = {key: text for key, text in offset_texts(inputs, shared, reference).items() if key[0] == "units"}
    known = {o.response: o for o in shared if any(o.response in key[1:] for key in texts)}
    reversed_there = _reversed(inputs, cosines) if any(o.reversed for offsets in several.values() for o in offsets) else _Reversed()
    texts |= _sign_texts(inputs, reversed_there, len(cosines))
    if not texts:
        return told
    for name, offsets in several.items():
        left = tuple(
            replace(
                o,
                named=o.named and not _agree(o, known.get(o.response)),
                reversed=o.reversed and o.response not in reversed_there.responses,
            )
            for o in offsets
        )
        kept = {key: text for key, text in told[name].items() if key[0] not in _OF_OFFSETS}
        told[name] = texts | offset_texts(inputs, left, name) | kept
    return told


def _agree(own: Offset, shared: Offset | None) -> bool:
    """Whether the factor of a job is the one that all have, within the intervals of both; of two powers of the frequency one is none."""
    return shared is not None and (own.power != shared.power or abs(own.db - shared.db) <= max(MOST_REACH, own.half + shared.half))


def _factors(jobs: Sequence[Sequence[Offset]], own: Sequence[Offset]) -> tuple[Offset, ...]:
    """Of each response the factor that most jobs have, by its median; none where the reference job does not show one."""
    named = [o.power for offsets in jobs for o in offsets if o.named]
    if not named or not any(o.named for o in own):
        return ()
    usual = max(set(named), key=named.count)
    found = []
    for response in sorted({o.response for offsets in jobs for o in offsets}):
        every = [o for offsets in jobs for o in offsets if o.response == response]
        same = [o for o in every if o.power == usual]
        if 2 * len(same) <= len(every):
            continue
        db = np.array([o.db for o in same])
        # Between jobs bolts and lines change, and with them how the errors of the model move a factor.
        half = float(STUDENT * MEDIAN_SPREAD * scatter(db) / np.sqrt(db.size)) if db.size > 3 else min(o.half for o in same)
        middle, before, after = (float(np.median(of)) for of in (db, [o.before for o in same], [o.after for o in same]))
        clear = any(o.named for o in same) and (usual != 0 or abs(middle) >= max(LEAST_OFFSET, half)) and after <= LEFT * before
        # Of one job alone it is no factor of all.
        clear = clear and 2 * sum(abs(o.db - middle) <= max(MOST_REACH, o.half) for o in same) > len(every)
        nearest = min(same, key=lambda o: abs(o.db - middle))
        half = max(half, LEAST_REACH)
        found.append(replace(nearest, db=middle, half=half, before=before, after=after, named=clear, reversed=False))
    return tuple(found)


def _cosines(jobs: Sequence[Sequence[Offset]]) -> dict[int, float]:
    """How alike measured and computed phases are as they stand: mean cosine of each response, by its median over the jobs.

    By the largest where phases of some job clearly are alike: what is reversed in others is not so in all.
    """
    found: dict[int, list[float]] = {}
    for offsets in jobs:
        for o in offsets:
            if (False, False) in o.phases:
                found.setdefault(o.response, []).append(o.phases[False, False])
    return {response: max(cosines) if max(cosines) >= ALIKE else float(np.median(cosines)) for response, cosines in found.items()}


@dataclass(frozen=True)
class _Reversed:
    """Excitations and single responses whose sign is the other one in all jobs, and all responses that this concerns."""

    excitations: tuple[int, ...] = ()
    single: tuple[int, ...] = ()
    responses: frozenset[int] = frozenset()


def _reversed(inputs: Inputs, cosines: Mapping[int, float]) -> _Reversed:
    """Whose sign is the other one, by the mean cosines: of a hammer all its responses, of a sensor all that it measures."""
    excitations, hit = [], set[int]()
    for e in range(len(inputs.campaign.excitation)):
        own = [r for r in cosines if inputs.responses[r].input == e]
        if len(own) > 1 and all(cosines[r] < 0.0 for r in own) and 2 * sum(cosines[r] <= -LEAST_ALIKE for r in own) > len(own):
            excitations.append(e)
            hit |= set(own)
    clear = {r for r, cosine in cosines.items() if cosine <= -LEAST_ALIKE and r not in hit}
    single = clear | {r for r in cosines if cosines[r] < 0.0 and r not in hit and clear.intersection(same_sensor(inputs, r))}
    return _Reversed(tuple(excitations), tuple(sorted(single)), frozenset(hit | single))


def _sign_texts(inputs: Inputs, found: _Reversed, count: int) -> Told:
    """What to say of them, of so many responses that were compared."""
    texts: Told = {}
    names = list(inputs.campaign.excitation)
    said = "measured phases are 180 degrees from the model's"
    if found.excitations:
        own = [r.name for i, r in enumerate(inputs.responses) if r.input in found.excitations and i in found.responses]
        every = len(own) == count
        what = "the hammer or of all sensors" if every else f"the hammer at {', '.join(names[e] for e in found.excitations)}"
        fix = ", ".join(f"excitation.{names[e]}.scale: {-inputs.campaign.excitation[names[e]].scale:g}" for e in found.excitations)
        texts["reversed", "hammer", *found.excitations] = (
            f"probably reversed sign: {'all responses' if every else ', '.join(own)}: {said}. Possible cause: the direction of {what}. "
            f"Write {fix}{sign_tail(inputs)}"
        )
    if found.single:
        own = [inputs.responses[r].name for r in found.single]
        fix = ", ".join(f"responses.{name}.scale: {-inputs.campaign.responses[name].scale:g}" for name in own)
        texts["reversed", *found.single] = (
            f"probably reversed sign: {', '.join(own)}: {said}. Possible cause: the direction of the sensor. Write {fix}{sign_tail(inputs)}"
        )
    return texts


def pooled(found: Mapping[str, Told], reference: str | None) -> dict[str, Told]:
    """What is wrong in the reference job, in all jobs: others, in which bolts are loose, show part of it, or what looks like part of it."""
    own = found.get(reference or "", {})
    reversed_there = next((kind for kind in own if kind[0] == "reversed"), ())
    units_there = any(kind[0] == "units" for kind in own)
    stated_wrong = {i for kind in own if kind[0] in {"alone", "coordinates"} for i in kind[1:]}
    shared: dict[str, Told] = {}
    exchanges: list[tuple[object, ...]] = []
    for name, told in found.items():
        shared[name] = {}
        for kind, text in told.items():
            if kind[0] == "exchanged":
                # Of a sensor that is elsewhere, or has another direction, any other fits better in some state of the bolts.
                if name != reference and stated_wrong.intersection(i for cycle in kind[1:] if isinstance(cycle, tuple) for i in cycle):
                    continue
                # Of cables that are exchanged in other jobs a job with loose bolts may show one hammer point only.
                kind = next((other for other in exchanges if set(kind[1:]) < set(other[1:])), kind)
                exchanges.append(kind)
            if kind[0] == "reversed" and set(kind) <= set(reversed_there):
                kind = reversed_there
            # Velocities for accelerations: phases alone say that their levels are right, which nobody knows of a job with loose bolts.
            if not (units_there and kind[0] == "sideways"):
                shared[name][kind] = text
    return shared


def each_once(found: Mapping[str, Told]) -> list[str]:
    """Each finding once, with the jobs that share it."""
    jobs: dict[str, list[str]] = {}
    first: dict[str, str] = {}
    for name, told in found.items():
        for kind, text in told.items():
            at = first.setdefault(repr(kind), f"job {name}: {text}")
            jobs.setdefault(at, []).append(name)
    return [text + (f"; the same in {', '.join(names[1:])}" if len(names) > 1 else "") for text, names in jobs.items()]
