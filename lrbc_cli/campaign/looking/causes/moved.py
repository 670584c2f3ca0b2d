"""Tests whether a hammer or a sensor was at another place than stated, by full solves at a few lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers, spaced
from lrbc_cli.campaign.identification.compared.likeness import (
    CLEARLY,
    LEAST_DIFFERENCE,
    MOST_LEFT,
    apart,
    apart_there,
    by_place,
    levels,
    spread,
)
from lrbc_cli.campaign.identification.compared.sensors import same_sensor
from lrbc_cli.campaign.looking.states import Seen, values_of
from lrbc_cli.campaign.looking.trials import EXPLAINED, NEARER, affordable, gradually, picking, solved
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import LrbcError
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.reduction.reduced.ports import PortFrf

#: Numbers of places tried for a sensor, and of places tried for the hammer times responses.
MOST_PLACES, MOST_HITS = 1000, 6000

#: Largest misfit of a corrected hammer point relative to that of the other hammer points.
_AS_MUCH = 1.5


def hammer_text(seen: Seen, stated: Floats) -> str | None:
    """Warning with the probable place of the hammer; None if no other place explains the measurement.

    Uses the transposed model: one solve per sensor gives the effect of forces at all possible places.

    Parameters
    ----------
    seen : Seen
    stated : (S, R) float array
        Level misfits of each state with the stated places [dB]; as much as for other hammer points may remain.
    """
    if seen.inputs.dofs is None or not affordable(seen):
        return None

    for at in range(len(seen.inputs.excitations)):
        others, least = np.flatnonzero(seen.inputs.input_of != at), seen.least_of(at)
        lacking = float(np.median(stated[:, others], axis=1).min()) if others.size else 0.0
        if seen.by_excitation.get(at, 0.0) > least and (text := _hammer_text(seen, at, lacking, least)):
            return text
    return None


def _hammer_text(seen: Seen, at: int, lacking: float, least: float) -> str | None:
    """As ``hammer_text`` for excitation ``at``, if its misfit is above ``least``; those of the others have ``lacking`` [dB]."""
    inputs, dofs = seen.inputs, seen.inputs.dofs
    assert dofs is not None
    before, after, dof, own = 0.0, np.inf, -1, -1
    # Where as much remains as of the other hammer points, which a calibrated model fits, it is errors of that model.
    as_others = _AS_MUCH * lacking if seen.source.fitted_to is not None and lacking <= LEAST_DIFFERENCE else 0.0
    for few, wider in gradually(seen):
        before, after, dof, own = _nearest_place(few, dofs, at)
        # One of three directions at its own node fits by chance less often than one of a thousand places.
        limit = MOST_LEFT if dof >= 0 and dofs.node[dof] == dofs.node[own] else max(EXPLAINED, _AS_MUCH * lacking)
        if after > wider * max(min(limit, CLEARLY * before), min(as_others, NEARER * before)):
            return None
    if before <= least:
        return None
    name = inputs.excitations[at]
    where, how = _place_text(inputs, dofs, dof, own)
    fix = f"Correct excitation.{name}: {how}" if seen.reference else "Measure it again at the point of the reference job"
    return (
        f"the hammer probably hit elsewhere than at excitation.{name}: {where} the level misfit falls from {before:.1f} to "
        f"{after:.1f} dB (mean level of each response removed). {fix}"
    )


def _nearest_place(seen: Seen, dofs: DofTable, at: int) -> tuple[float, float, int, int]:
    """Misfits of excitation ``at`` as stated and at the best place [dB], the DOFs of the best and the stated place; infinite if unknown."""
    inputs, points = seen.inputs, _single_points(seen.inputs)
    there = np.isfinite(levels(seen.measured))
    heard = {to: np.flatnonzero((inputs.input_of == to) & (2 * there.sum(axis=0) > len(there))) for to in {at, *points}}
    responses = heard[at]
    # A single response without its constant is too little evidence, and a distributed load has no place.
    if at not in points or responses.size < 2:
        return 0.0, np.inf, -1, -1
    own, level, sensors = points[at], levels(seen.measured[:, responses])[:, None, :], _sensors(inputs, responses)
    # Hammer points with the same sensors share the solves.
    alike = [point for to, point in points.items() if to == at or _sensors(inputs, heard[to]) == sensors]
    every = _places(dofs, alike, MOST_HITS // responses.size)
    tried = (dofs.component[every] == dofs.component[own]) | ((dofs.node[every] == dofs.node[own]) & _translates(dofs)[every])
    places = every[tried]
    left, gaps = np.full(places.size, np.inf), not there[:, responses].all()
    with suppress(LrbcError):
        ports = _reciprocal_ports(seen, every, responses)
        some = ports.select(np.arange(seen.s.size), np.arange(responses.size))
        # The rows of H0p depend on the place only, not on the sensor.
        held, base = ports.H0p[:, :: responses.size][:, tried], ports.H00.reshape(seen.s.size, every.size, responses.size)[:, tried]
        for state in values_of(seen.parameters)[0]:
            values = base + held @ some.drive(seen.parameters.dynamic(state, seen.s))[1]
            difference = level - levels(values)
            # Same as `spread` without missing values, in a tenth of the time.
            off = spread(difference, 0) if gaps else np.abs(difference - np.median(difference, axis=0)).mean(axis=0)
            left = np.fmin(left, np.median(off, axis=1))
    best = int(np.argmin(left))
    return float(left[places == own][0]), float(left[best]), int(places[best]), own


def _single_points(inputs: Inputs) -> dict[int, int]:
    """DOF of each excitation that acts on a single one."""
    loads = [inputs.model.B[:, [at]].tocoo() for at in range(len(inputs.excitations))]
    return {at: int(load.row[0]) for at, load in enumerate(loads) if load.nnz == 1}


def _sensors(inputs: Inputs, responses: Integers) -> bytes:
    """Equal for responses at the same places, of the same quantities, in the same order."""
    rows, powers = inputs.model.L[responses].tocsr(), inputs.model.output_power[responses]
    return b"".join(part.tobytes() for part in (rows.indptr, rows.indices, rows.data, powers))


def _translates(dofs: DofTable) -> Bools:
    """(n,) whether a DOF is a translation."""
    return np.isin(dofs.component, COMPONENTS[:3])


def hammers_text(seen: Seen, fitted: Callable[[Complexes], Complexes | None] | None = None) -> str:
    """Warning if two excitations with sensors in common are exchanged; else empty.

    Parameters
    ----------
    seen : Seen
    fitted : callable or None
        From measured FRFs (F, R) to those of the best-fitting state of the bolts; given if ``seen`` contains such a state. With loosened
        bolts, exchanged records are near to no other state.
    """
    inputs, measured, states = seen.inputs, seen.measured, seen.states
    for one in range(len(inputs.excitations)):
        for two in range(one):
            ways = ((one, two), (two, one))
            pairs = [pair for at, to in ways for pair in _shared(inputs, at, to)]
            own, other = [i for i, _ in pairs], [k for _, k in pairs]
            if len(own) < 4:
                continue
            stated = float(np.median(apart(measured[:, own], states[:, :, own]), axis=1).min())
            changed = float(np.median(apart(measured[:, own], states[:, :, other]), axis=1).min())
            if fitted is not None and stated > LEAST_DIFFERENCE and changed >= CLEARLY * stated:
                turned = measured.copy()
                turned[:, own] = measured[:, other]
                again = fitted(turned)
                changed = np.inf if again is None else float(np.median(apart(turned[:, own], again[:, own])))
            rest = np.setdiff1d(np.arange(measured.shape[1]), own)
            # Errors of the model are as large here as in the FRFs of other hammer points.
            lacking = float(np.median(apart(measured[:, rest], states[:, :, rest]), axis=1).min()) if rest.size else 0.0
            if stated > LEAST_DIFFERENCE and changed < min(max(EXPLAINED, _AS_MUCH * lacking), CLEARLY * stated):
                first, second = inputs.excitations[two], inputs.excitations[one]
                exchange = f"exchange the places of excitation.{first} and excitation.{second}"
                records = ", ".join(f"{inputs.responses[i].name}: {inputs.responses[k].name}" for i, k in sorted(pairs))
                only = f"write jobs.{seen.job}.records: {{{records}}}"
                # In one job the order of the blows was probably different, in the reference job rather the campaign file is wrong.
                fix = f"{exchange}, or {only}" if seen.reference else f"{only}, or, if all jobs are affected, {exchange}"
                fix = f"{fix[:1].upper()}{fix[1:]}"
                return f"{first} and {second} are probably exchanged: the FRFs of each fit the model's FRFs of the other. {fix}"
    return ""


def unmoved_text(seen: Seen, *, same: float = 0.1, other: float = 0.5, least: int = 3) -> str:
    """Warning if two excitations have the same FRFs at all sensors they share, although those of the model differ; else empty.

    Parameters
    ----------
    seen : Seen
    same, other : float
        Relative differences (median over the lines) up to which measured FRFs are the same, and from which the model's differ.
    least : int
        Least number of sensors in common.
    """
    inputs = seen.inputs
    for one in range(len(inputs.excitations)):
        for two in range(one):
            pairs = _shared(inputs, two, one)
            own, further = [i for i, _ in pairs], [k for _, k in pairs]
            if len(pairs) < least:
                continue
            away = [np.nan_to_num(_relative(H[:, further], H[:, own]), nan=np.inf) for H in (seen.measured, seen.model)]
            if away[0].max() <= same and np.median(away[1]) >= other:
                first, second = inputs.excitations[two], inputs.excitations[one]
                return (
                    f"the hammer was probably not moved: FRFs of {first} and of {second} are the same at all {len(pairs)} sensors, those "
                    f"of the model are not. Measure {first} or {second} again at its own place, or select the right records (a file or a "
                    "series may have been exported twice)"
                )
    return ""


def _shared(inputs: Inputs, at: int, to: int) -> list[tuple[int, int]]:
    """Pairs of responses of the same sensor to excitations ``at`` and ``to``, in the order of the responses."""
    places = by_place(inputs)
    turned = ((i, places.get((*place[:3], to))) for place, i in places.items() if place[3] == at)
    return [(i, k) for i, k in turned if k is not None]


def _relative(values: Complexes, others: Complexes) -> Floats:
    """(R,) relative differences, median over the lines."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found: Floats = np.median(np.abs(values - others) / np.abs(others), axis=0)
    return found


def _reciprocal_ports(seen: Seen, places: Integers, responses: Integers) -> PortFrf:
    """Interface FRFs of the transposed model from sensors to places (responses vary fastest); solved once for all jobs with these lines."""
    # Transposed, so that one solve per sensor suffices; without a cavity the matrices are symmetric.
    model, count = seen.inputs.model, responses.size
    K, C, M = (A.T.tocsc() for A in (model.K, model.C, model.M))
    terms = replace(model.terms, left=model.terms.right, right=model.terms.left)
    turned = replace(
        model,
        K=K,
        C=C,
        M=M,
        terms=terms,
        B=model.L[responses].T.tocsc(),
        L=picking(np.repeat(places, count), model.size),
        output_power=np.tile(model.output_power[responses], places.size),
        extras={},
    )
    key = b"places" + places.tobytes() + _sensors(seen.inputs, responses)
    return solved(seen, turned, np.tile(np.arange(count), places.size), key)


def sensor_text(seen: Seen, response: int, *, share: float = CLEARLY) -> str:
    """Clause with the place at which the model gives what a sensor measured; empty if none leaves less than a share of the misfit."""
    inputs, dofs, point = seen.inputs, seen.inputs.dofs, seen.inputs.model.L[[response]].tocoo()
    if dofs is None or point.nnz == 0 or not affordable(seen):
        return ""
    own, model = int(point.col[np.argmax(np.abs(point.data))]), inputs.model
    places = _places(dofs, [own], MOST_PLACES)
    moved = replace(model, L=picking(places, model.size), output_power=np.full(places.size, model.output_power[response]), extras={})
    # A structure has places alike for one hammer point, so all records of the sensor count.
    records, left, best = [response, *same_sensor(inputs, response)], np.full(places.size, np.inf), 0

    def away(few: Seen, record: int) -> Floats:
        input_of = np.full(places.size, inputs.input_of[record])
        computed = solved(few, moved, input_of, b"sensor" + np.int64(record).tobytes()).evaluate(few.dynamic)
        return apart_there(np.broadcast_to(few.measured[:, [record]], computed.shape), computed, float(np.abs(computed).max()))

    for few, wider in gradually(seen):
        with suppress(LrbcError):
            left = np.mean([away(few, record) for record in records], axis=0)
        best = int(np.argmin(left))
        if places[best] == own or left[best] > wider * min(EXPLAINED, share * float(left[places == own][0])):
            return ""
    at, how = _place_text(inputs, dofs, int(places[best]), own)
    return f"; {at} it would differ by {left[best]:.1f} dB ({how})"


def _places(dofs: DofTable, own: Sequence[int], most: int, *, least: int = 30) -> Integers:
    """DOFs to be tried: translations at the stated nodes, and DOFs of their components, about ``most``.

    If there are more, half of them are the nearest ones, as many about each stated one, but not fewer than ``least``.
    """
    here = np.flatnonzero(_translates(dofs) & np.isin(dofs.node, dofs.node[own]))
    found, components = [np.array(own), here], list(dict.fromkeys(dofs.component[own].tolist()))
    for component in components:
        stated = [at for at in own if dofs.component[at] == component]
        alike = np.flatnonzero(dofs.component == component)
        away = np.linalg.norm(dofs.xyz[alike, None] - dofs.xyz[stated], axis=2)
        allowed = most // len(components)
        if alike.size > allowed:
            few = max(allowed // 2 // len(stated), min(least, allowed // 2))
            near = np.unique(np.argsort(away, axis=0, kind="stable")[:few])
            rest = np.setdiff1d(np.argsort(away.min(axis=1), kind="stable"), near, assume_unique=True)
            alike = alike[np.concatenate([near, rest[spaced(rest.size, max(allowed - near.size, allowed // 2))]])]
        found.append(alike)
    return np.unique(np.concatenate(found))


def _place_text(inputs: Inputs, dofs: DofTable, dof: int, own: int) -> tuple[str, str]:
    """Place of a DOF as the beginning of a clause, and the corresponding keys."""
    system = inputs.campaign.unit_system
    xyz = ", ".join(f"{value:.6g}" for value in dofs.xyz[dof] / system.length)
    component = dofs.component[dof]
    if dofs.node[dof] == dofs.node[own]:
        return f"along {component}", f"component: {component}"
    away = float(np.linalg.norm(dofs.xyz[dof] - dofs.xyz[own])) / system.length
    at = f"at or near node {dofs.node[dof]}, {away:.4g} {system.length_name} away,"
    return at, f"near: [{xyz}], component: {component}"
