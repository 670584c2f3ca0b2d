"""Combines findings of all jobs: signs and factors that all share are reported once, even if no single job shows each of them clearly.

Wrong hammers, sensors or units are the same in all jobs, but bolts and errors of the model may hide them in some.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.campaign.identification.compared.likeness import same_sensor
from lrbc_cli.campaign.identification.compared.offsets import offset_texts, sign_tail
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

#: Warnings about a job, each under a key (kind, responses) that is equal for the same finding in another job.
Told = dict[tuple[object, ...], str]

#: Kinds of warnings by ``offset_texts``.
_OF_OFFSETS = ("units", "places", "reversed", "late", "early", "conjugate")


@dataclass(frozen=True)
class OfJob:
    """Findings of one job.

    Attributes
    ----------
    told : dict
        Warnings by kind and responses.
    offsets : tuple of Offset
        Factors and phases of its responses; empty if another fault must be corrected first.
    """

    told: Told
    offsets: tuple[Offset, ...] = ()


def told_of_all(inputs: Inputs, found: Mapping[str, OfJob], reference: str) -> dict[str, Told]:
    """Warnings of each job, in which signs and factors that all jobs share have the same key.

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
        own_texts = {key: text for key, text in offset_texts(inputs, left, name).items() if key[0] != "places" or key in told[name]}
        told[name] = texts | own_texts | kept
    return told


def _agree(own: Offset, shared: Offset | None) -> bool:
    """Whether the factor of a job is the shared one within both intervals; also if powers differ, as one of the two must be wrong."""
    return shared is not None and (own.power != shared.power or abs(own.db - shared.db) <= max(MOST_REACH, own.half + shared.half))


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
    """Reversed excitations and responses by the mean cosines: a hammer affects all its responses, a sensor all that it measures."""
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
    """Warnings about reversed signs; ``count`` responses were compared."""
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
    """Warnings of each job, with findings that are part of a fault of the reference job under its key; loose bolts may hide the rest."""
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
                # If a sensor has the wrong place or direction, some other sensor fits better in some state of the bolts.
                if name != reference and stated_wrong.intersection(i for cycle in kind[1:] if isinstance(cycle, tuple) for i in cycle):
                    continue
                # A job with loose bolts may show exchanged cables for one hammer point only.
                kind = next((other for other in exchanges if set(kind[1:]) < set(other[1:])), kind)
                exchanges.append(kind)
            if kind[0] == "reversed" and set(kind) <= set(reversed_there):
                kind = reversed_there
            # With wrong units in the reference job (velocity for acceleration), phases off by 90 degrees are the same fault.
            if not (units_there and kind[0] == "sideways"):
                shared[name][kind] = text
    return shared


def each_once(found: Mapping[str, Told]) -> list[str]:
    """Each finding once, naming all jobs that share it."""
    jobs: dict[str, list[str]] = {}
    first: dict[str, str] = {}
    for name, told in found.items():
        for kind, text in told.items():
            at = first.setdefault(repr(kind), f"job {name}: {text}")
            jobs.setdefault(at, []).append(name)
    return [text + (f"; the same in {', '.join(names[1:])}" if len(names) > 1 else "") for text, names in jobs.items()]
