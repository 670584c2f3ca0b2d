"""Tests whether measurements fit the removed bolts that are stated, those of another job, or those of bolts counted from the other end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.tightness import freed
from lrbc_cli.campaign.looking.fitted import expected_frfs
from lrbc_cli.campaign.looking.states import MOST_STATES, Looking, Seen
from lrbc_cli.campaign.looking.trials import NEARER
from lrbc_cli.updating.search.starts import LEVELS
from lrbc_cli.updating.unknowns.shapes import bolt_shapes


def removed_findings(source: Looking, measurements: Mapping[str, Measurement]) -> list[Finding]:
    """Findings of bolts numbered from the other end, or else of jobs with exchanged files, by the removed bolts that the jobs state.

    Parameters
    ----------
    source : Looking
        Model that explains the reference job.
    measurements : mapping
        By job.
    """
    inputs, reference = source.inputs, source.inputs.campaign.update.reference or ""
    tight, bolts = measurements.get(reference), inputs.bolts
    stated = {name: frozenset(inputs.campaign.jobs[name].removed) for name in measurements if name != reference}
    stated = {name: removed for name, removed in stated.items() if removed}
    if tight is None or bolts is None or not stated:
        return []
    changes = {name: _changes(source, name, measurements[name], tight) for name in measurements if name != reference}
    swapped = _swapped(changes, stated)
    other = list(swapped.values())
    told = {each for pair in swapped for each in pair}
    for name in (name for name in stated if name not in told):
        seen = Seen.of(source, name, measurements[name], tight)
        alone = _other_bolts(source, name, stated[name], changes[name]) or _none(seen, stated[name], changes[name])
        other += [] if alone is None else [alone]
    if len(stated) < 2:
        return other
    opposite = dict(zip(bolts.name, bolts.name[::-1], strict=True))
    turned = {name: frozenset(opposite[bolt] for bolt in removed) for name, removed in stated.items()}
    sets = sorted({*stated.values(), *turned.values()}, key=sorted)
    if len(sets) * len(LEVELS) > MOST_STATES:
        return other
    far: dict[str, dict[frozenset[str], float]] = {}
    for name in stated:
        seen = Seen.of(source, name, measurements[name], tight)
        if seen.tight is not None:
            far[name] = dict(zip(sets, _distances(seen, sets).tolist(), strict=True))
    file = "the bolts" if inputs.campaign.bolts is None else inputs.campaign.bolts.name
    return _numbering(far, stated, turned, file) or _exchanges(far, stated) or other


#: Least and largest loss of bolts that count as loose and as tight [decades].
LOST, KEPT = 1.0, 0.3

#: Changes of the bolts in the state fitted coarsely to a job [decades].
_Changes = Mapping[str, float]


def _changes(source: Looking, name: str, measurement: Measurement, tight: Measurement) -> _Changes:
    """Changes of the bolts of a job, NaN for those without values."""
    bolts, change = source.inputs.bolts, source.changes.get(name)
    assert bolts is not None
    if change is None:
        # One of the states that are tried is near enough: no fit was needed.
        nearest = freed(Seen.of(source, name, measurement, tight))
        change = np.where(np.isin(bolts.name, nearest.names), max(nearest.change, -LOST), 0.0)
    return dict(zip(bolts.name, change.tolist(), strict=True))


def _loose(changes: _Changes) -> frozenset[str]:
    return frozenset(bolt for bolt, own in changes.items() if own <= -LOST)


def _tight(changes: _Changes, bolts: frozenset[str]) -> bool:
    return all(changes.get(bolt, np.nan) >= -KEPT for bolt in bolts)


def _swapped(changes: Mapping[str, _Changes], stated: Mapping[str, frozenset[str]]) -> dict[tuple[str, str], Finding]:
    """Findings of jobs whose removed bolts are tight, while they and no others are loose in one other job, which does not state them."""
    found = dict[tuple[str, str], Finding]()
    for name, removed in stated.items():
        there = [other for other, own in changes.items() if stated.get(other) != removed and _loose(own) == removed]
        if len(there) == 1 and _tight(changes[name], removed) and not {name, *there} & {each for pair in found for each in pair}:
            bolts, are = ", ".join(sorted(removed)), "is" if len(removed) == 1 else "are"
            text = (
                f"the files of {name} and {there[0]} are probably exchanged: {bolts} {are} stated as removed in {name} and fitted best as "
                f"tight, but loose in {there[0]}. Exchange jobs.{name}.frf and jobs.{there[0]}.frf, or correct `removed`"
            )
            found[name, there[0]] = Finding(text=text, kind=Kind.REMOVED, detail=f"{name} {there[0]}")
    return found


def _other_bolts(source: Looking, name: str, removed: frozenset[str], changes: _Changes) -> Finding | None:
    """Finding if a job is fitted best with other bolts loose than those stated as removed, and with these as tight as before."""
    loose = sorted(_loose(changes))
    if not loose or not _tight(changes, removed):
        return None
    file = "the bolts file" if source.inputs.campaign.bolts is None else source.inputs.campaign.bolts.name
    text = (
        f"{', '.join(sorted(removed))} {'is' if len(removed) == 1 else 'are'} stated as removed, but the measurement is fitted best with "
        f"{', '.join(loose)} loose instead. Check the names of the bolts in {file} and in the tables of springs, whether they are numbered "
        f"from the other end, and jobs.{name}.removed"
    )
    return Finding(text=text, kind=Kind.REMOVED, job=name)


def _none(seen: Seen, removed: frozenset[str], changes: _Changes, *, kept: float = 0.5) -> Finding | None:
    """Finding if a job is clearly nearer to a state with the bolts stated as removed, which lost less than ``kept``, than without them."""
    near = seen.source.left.get(seen.job)
    if near is None or seen.tight is None or _loose(changes) or not all(changes.get(bolt, np.nan) > -kept for bolt in removed):
        return None
    away = float(_distances(seen, [removed], [level for level in LEVELS if level <= -LOST])[0])
    # Where bolts hardly change the FRFs, both states are near.
    if away <= LEAST_DIFFERENCE or near > CLEARLY * away:
        return None
    text = (
        f"{', '.join(sorted(removed))} {'is' if len(removed) == 1 else 'are'} stated as removed, but the measurement is {near:.1f} dB from "
        f"a state with all bolts, and {away:.1f} dB from the nearest one without these (mean level of each response removed). Check if "
        f"it was made before they were removed, or is another file, and jobs.{seen.job}.removed"
    )
    return Finding(text=text, kind=Kind.REMOVED, job=seen.job)


def _distances(seen: Seen, sets: Sequence[frozenset[str]], levels: Sequence[float] = LEVELS) -> Floats:
    """Level misfits of a job with each set of bolts removed, at the loss that fits best: median over the responses used [dB]."""
    inputs, prior = seen.inputs, seen.parameters.initial
    assert inputs.bolts is not None
    shapes = bolt_shapes(seen.parameters, inputs.bolts.xyz, inputs.statistics.values, inputs.statistics.bolts)
    known = shapes.bolts >= 0
    columns = [np.isin(inputs.bolts.name, list(removed)) & known for removed in sets]
    # Hats of neighbouring bolts overlap.
    lost = np.array([np.minimum(shapes.T[:, shapes.bolts[own]].sum(axis=1), 1.0) for own in columns])
    states = np.clip(prior + np.array(levels)[:, None, None] * lost, *seen.parameters.bounds.T)
    expected = expected_frfs(seen, states.reshape(-1, prior.size))
    every = np.median(apart(seen.measured, expected)[:, inputs.used], axis=1)
    return np.asarray(every.reshape(len(levels), -1).min(axis=0))


def _numbering(
    far: Mapping[str, Mapping[frozenset[str], float]], stated: Mapping[str, frozenset[str]], turned: Mapping[str, frozenset[str]], file: str
) -> list[Finding]:
    """Finding if each job fits the bolts counted from the other end better than the stated ones, and all of them clearly."""
    own = {name: (all_far[stated[name]], all_far[turned[name]]) for name, all_far in far.items() if stated[name] != turned[name]}
    before, after = (sum(each[k] for each in own.values()) for k in (0, 1))
    clear = _clear(before, after, sum(min(far[name].values()) for name in own))
    if len(own) < 2 or not clear or any(other > as_stated for as_stated, other in own.values()):
        return []
    text = (
        f"the bolts of {file} are probably numbered from the other end: with the names in reverse order, the removed bolts explain the "
        f"jobs with a level misfit of {after / len(own):.1f} dB on average, as stated with {before / len(own):.1f} dB. Correct the names "
        f"in {file}, or those under jobs.JOB.removed"
    )
    return [Finding(text=text, kind=Kind.REMOVED)]


def _clear(before: float, after: float, least: float, *, further: float = 0.1) -> bool:
    """Whether misfits ``after`` a correction are clearly below those ``before``, sums over jobs [dB].

    A model that is not calibrated leaves as much as it explains. Less is therefore enough if the correction leads to the nearest bolts of
    all that jobs state: if those with the ``least`` misfits explain not more than the share ``further`` of it in addition. Neighbours of a
    bolt that hardly changes the FRFs fit as well as the bolt itself.
    """
    nearest = after - least <= further * (before - after)
    return after <= (NEARER**0.5 if nearest else NEARER) * before


def _exchanges(far: Mapping[str, Mapping[frozenset[str], float]], stated: Mapping[str, frozenset[str]]) -> list[Finding]:
    """Findings of pairs of jobs that each fit the removed bolts of the other clearly better."""
    found, gone = list[Finding](), set[str]()
    ways = []
    for one, other in combinations(far, 2):
        before = far[one][stated[one]] + far[other][stated[other]]
        after = far[one][stated[other]] + far[other][stated[one]]
        least = min(far[one].values()) + min(far[other].values())
        if (
            _clear(before, after, least)
            and far[one][stated[other]] < far[one][stated[one]]
            and far[other][stated[one]] < far[other][stated[other]]
        ):
            ways.append((after / before, after, before, one, other))
    for _, after, before, one, other in sorted(ways):
        if gone.isdisjoint((one, other)):
            gone |= {one, other}
            text = (
                f"the files of {one} and {other} are probably exchanged: each fits the removed bolts of the other (level misfits of "
                f"{after / 2.0:.1f} dB on average, as stated {before / 2.0:.1f} dB). Exchange jobs.{one}.frf and jobs.{other}.frf, "
                "or correct `removed` of both"
            )
            found.append(Finding(text=text, kind=Kind.REMOVED, detail=f"{one} {other}"))
    return found
