"""Finds exchanged channels with other factors and phases, and jobs whose files are exchanged, by their titles and the stated removed bolts.

The more bolts are removed, the more a measurement differs from that of the tight state.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import LEAST_DIFFERENCE, apart, by_sensors, exchanged, exchanged_text, turned
from lrbc_cli.campaign.identification.compared.offsets import factors_of, late_together, offset_findings, trusted
from lrbc_cli.campaign.identification.compared.sensors import ends_of
from lrbc_cli.campaign.identification.records import Measurement, unlike
from lrbc_cli.campaign.looking.states import Seen, nearest_states
from lrbc_cli.campaign.looking.trials import EXPLAINED
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.comparison.scale import Offset

#: Least contradiction of distances and order that is reported [dB], and the share of it that one exchange may leave. Choices: if nearly
#: all bolts are removed, distances differ by tenths of a decibel.
CLEAR, LEFT = 2.0, 0.1


def exchanged_files(inputs: Inputs, measurements: Mapping[str, Measurement]) -> str | None:
    """Warning that names two jobs whose files are probably exchanged, by their distances from the reference job; else None.

    Parameters
    ----------
    inputs : Inputs
    measurements : mapping
        By job.
    """
    reference = inputs.campaign.update.reference
    tight = measurements.get(reference or "")
    if tight is None:
        return None
    far = {
        name: float(np.median(apart(found.values, tight.values)[inputs.used]))
        for name, found in measurements.items()
        if name != reference and inputs.campaign.jobs[name].removed and not unlike(found.frequency_hz, tight.frequency_hz)
    }
    chain = _nested({name: frozenset(inputs.campaign.jobs[name].removed) for name in far})
    found = _exchange([far[name] for name in chain])
    if found is None:
        return None
    one, other = chain[found[0]], chain[found[1]]
    few, many = (len(inputs.campaign.jobs[name].removed) for name in (one, other))
    return (
        f"the files of {one} and {other} may be exchanged: {one} ({few} bolt{'s' if few > 1 else ''} removed) differs from {reference} by "
        f"{far[one]:.1f} dB, {other} ({many} removed) by {far[other]:.1f} dB. With these files exchanged, jobs with more bolts removed "
        f"differ more from {reference}, in all jobs. Check jobs.{one}.frf and jobs.{other}.frf"
    )


def mistitled(inputs: Inputs, measurements: Mapping[str, Measurement]) -> dict[tuple[str, str], str]:
    """Warnings about jobs whose file has the title of another job, unless the file of that job has the same title; by both jobs.

    Parameters
    ----------
    inputs : Inputs
    measurements : mapping
        By job.
    """
    called = {name.lower(): name for name in measurements}

    def named(title: str) -> set[str]:
        # Words are looked up, also without a final dot or an extension: with hundreds of jobs, a search for each name would take minutes.
        words = re.findall(r"[\w.-]+", title.lower())
        return {called[part] for word in words for part in (word, word.rpartition(".")[0]) if part in called}

    titled = {name: [(title, named(title)) for title in found.titles] for name, found in measurements.items()}
    every = {name: set[str]().union(*(names for _, names in titles)) for name, titles in titled.items()}
    told, jobs = dict[tuple[str, str], str](), inputs.campaign.jobs
    for name, others in every.items():
        other = next(iter(others), "")
        if len(others) != 1 or other in every[other] or (other, name) in told:
            continue
        title = next(title for title, names in titled[name] if names)
        own, its = jobs[name].first.name, jobs[other].first.name
        told[name, other] = (
            f"job {name}: its file and that of {other} may be exchanged: {own} is titled {title!r}, and {its}, the file of {other}, is "
            f"not. Check jobs.{name}.frf and jobs.{other}.frf"
        )
    return told


def foreign_titles(inputs: Inputs, measurements: Mapping[str, Measurement], *, least: int = 3) -> list[str]:
    """Warnings about jobs whose file lacks most words of the title that nearly all other files share, as one of another structure.

    Parameters
    ----------
    inputs : Inputs
    measurements : mapping
        By job.
    least : int
        Least number of jobs with that title, without the name of the job; at least three quarters of all must have it.
    """
    stated = {name: found.titles[0].strip() for name, found in measurements.items() if found.titles and found.titles[0].strip()}
    titles = {name: " ".join(title.lower().replace(name.lower(), " ").split()) for name, title in stated.items()}
    usual, count = max(Counter(titles.values()).items(), key=lambda item: item[1], default=("", 0))
    words = set(re.findall(r"\w+", usual))
    if count < max(least, 0.75 * len(titles)) or not words:
        return []
    other = next(name for name, title in titles.items() if title == usual)
    return [
        f"job {name}: {inputs.campaign.jobs[name].first.name} is titled {stated[name]!r}, but the file of {other} {stated[other]!r}, and "
        f"those of the other jobs alike. Check whether it is the file of another structure or set-up, and correct jobs.{name}.frf"
        for name, title in titles.items()
        if 2 * len(words.intersection(re.findall(r"\w+", title))) < len(words)
    ]


def _nested(removed: Mapping[str, frozenset[str]]) -> list[str]:
    """Jobs from few to many removed bolts; empty if the removed bolts of one do not contain those of the one before."""
    chain = sorted(removed, key=lambda name: len(removed[name]))
    return chain if all(removed[a] < removed[b] for a, b in pairwise(chain)) else []


def _exchange(far: Sequence[float]) -> tuple[int, int] | None:
    """Indices of the two distances [dB] whose exchange makes all ascend, if they clearly do not and only one exchange does; else None."""

    def wrong(values: Sequence[float]) -> float:
        return sum(max(a - b, 0.0) for a, b in combinations(values, 2))

    before, ways = wrong(far), dict[tuple[int, int], float]()
    for i, k in combinations(range(len(far)), 2):
        turned = list(far)
        turned[i], turned[k] = far[k], far[i]
        ways[i, k] = wrong(turned)
    best = min(ways, key=lambda pair: ways[pair], default=None)
    if best is None or before <= CLEAR or ways[best] > LEFT * before:
        return None
    # If several exchanges restore the order, the right one is unknown.
    return best if sum(left <= LEFT * before for left in ways.values()) == 1 else None


def channel_findings(
    seen: Seen, near: list[Complexes], movable: Floats | float, cycles: Sequence[tuple[int, ...]], *, backwards: bool, nearest: int = 4
) -> tuple[list[Finding], tuple[Offset, ...]]:
    """Exchanged channels, and factors and phases of the others relative to the nearest states.

    A factor is reported only if it exceeds the change of level by one loosened bolt, ``movable`` ((R,) or one value for all) [dB]. If the
    FRFs are complex conjugates (``backwards``), other findings from phases are dropped. Exchanged sensors are looked for beside the
    ``nearest`` states.
    """
    inputs = seen.inputs
    exchanges = exchanged(inputs, seen.measured, nearest_states(seen, nearest), cycles)
    offsets = factors_of(inputs, seen.measurement, near)
    involved = {i for cycle in exchanges for i in cycle}
    by_bolt = np.broadcast_to(movable, len(inputs.responses))
    if backwards:
        offsets = tuple(replace(o, conjugate=True, reversed=False) for o in offsets)
    offsets = tuple(
        replace(o, named=o.named and trusted(o, offsets) and (o.power != 0 or abs(o.db) > by_bolt[o.response]))
        for o in offsets
        if o.response not in involved
    )
    # A power of the frequency, a delay and complex conjugation also rotate phases.
    plain = not any(o.power or o.delay or o.conjugate or o.reversed for o in offsets)
    opposite = set(turned(seen.measured, seen.states)) if plain else {o.response for o in offsets if o.reversed}
    away = min((apart(seen.measured, state) for state in near), key=lambda each: float(np.median(each)))
    clear = {i for i in opposite if away[i] <= EXPLAINED}
    whole = clear | _whole(inputs, opposite, set(np.flatnonzero(np.isfinite(seen.measured).any(axis=0)).tolist()) - involved)
    offsets = tuple(replace(o, reversed=o.response in whole) for o in offsets)
    # Phases of a model that is not near agree with a delay by chance.
    offsets = offsets if seen.misfit <= LEAST_DIFFERENCE else late_together(inputs, offsets)
    cycled = by_sensors(inputs, exchanges)
    found = [Finding(text=exchanged_text(inputs, cycles, seen.job), kind=Kind.EXCHANGED, cycles=cycles) for cycles in cycled]
    return [*offset_findings(inputs, offsets, seen.job), *found], offsets


def _whole(inputs: Inputs, opposite: set[int], measured: set[int]) -> set[int]:
    """Responses with ``opposite`` phases: most records of their sensor, or all of their hammer point.

    A single record that is far from the model has its phases by chance, as that of a sensor which is loose, or at another place.
    """
    found = set[int]()
    for end, own in ends_of(inputs):
        there = measured.intersection(own)
        if 2 * len(opposite & there) > len(there) and (end == "sensor" or opposite >= there):
            found |= opposite & there
    return found
