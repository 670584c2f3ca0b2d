"""Finds sensors stated with wrong coordinates, on the wrong one of two parts, or in a wrong direction, by all FRFs of each together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, MOST_LEFT, apart, apart_there
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import affordable, gradually, picking, solved
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reading.reach import parts_of
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.selection import nearest, spacing

_AXES = "xyz"

#: Largest share of the misfit that may remain if all FRFs of a sensor (at least two) come nearer. With right places, none of these changes
#: reduced the misfit; with a wrong place, errors of the model alone left 0.6 of it.
MOSTLY = 0.75

#: Misfit over the median of all responses above which a sensor is examined.
FARTHER = 1.25


@dataclass(frozen=True, kw_only=True)
class _Other:
    """Possible DOF of a sensor: its responses, the DOF, its relation to the stated one in words; ``turned``: at the same node."""

    responses: tuple[int, ...]
    dof: int
    how: str
    turned: bool = False


def coordinates_texts(seen: Seen, *, unlike: bool) -> tuple[dict[tuple[int, ...], str], Floats]:
    """Warnings about sensors that fit better with other coordinates or directions, by their responses, and misfits (R,) with these [dB].

    Parameters
    ----------
    seen : Seen
    unlike : bool
        Whether most responses are far from the model: then the places of all sensors may be wrong.
    """
    inputs, dofs = seen.inputs, seen.inputs.dofs
    left = apart(seen.measured, seen.model)
    if dofs is None or not affordable(seen):
        return {}, left
    typical = FARTHER * float(np.median(left))
    least = LEAST_DIFFERENCE if unlike else max(LEAST_DIFFERENCE, typical)
    others = [other for other in _others(inputs, dofs) if left[list(other.responses)].mean() > least]
    largest, told = float(np.abs(seen.model).max()), dict[tuple[int, ...], str]()
    better: list[tuple[_Other, Floats, Floats]] = []
    for few, wider in gradually(seen):
        before, better = apart(few.measured, few.model), []
        with suppress(LrbcError):
            for other, after in zip(others, _misfits(few, others, largest), strict=True):
                own = list(other.responses)
                # If the model is far from most responses, it must be near at the other place.
                limit = MOST_LEFT if unlike and not other.turned else max(MOST_LEFT, typical)
                share = MOSTLY if len(own) > 1 and not other.turned else CLEARLY
                if after.mean() <= wider * min(limit, share * float(before[own].mean())) and np.all(after < wider * before[own]):
                    better.append((other, before[own], after))
        if not better:
            break
    for other, before, after in sorted(better, key=lambda each: float(each[2].mean())):
        if other.responses not in told:
            left[list(other.responses)] = after
            told[other.responses] = _text(inputs, dofs, other, float(before.mean()), float(after.mean()))
    return told, left


def _points(inputs: Inputs) -> dict[int, list[int]]:
    """Responses of each sensor that measures a single DOF, by DOF; distributed or interpolated sensors have no single place."""
    L, sensors = inputs.model.L.tocsr(), dict[int, list[int]]()
    for i in range(L.shape[0]):
        row = L[[i]].tocoo()
        if row.nnz == 1:
            sensors.setdefault(int(row.col[0]), []).append(i)
    return sensors


def _misfits(seen: Seen, others: Sequence[_Other], largest: float) -> list[Floats]:
    """Level misfits of the responses of each place, with the FRFs of the model there, see ``apart_there`` [dB]."""
    if not others:
        return []
    responses = np.array([i for other in others for i in other.responses])
    at = np.array([other.dof for other in others for _ in other.responses])
    model = seen.inputs.model
    moved = replace(model, L=picking(at, model.size), output_power=model.output_power[responses], extras={})
    ports = solved(seen, moved, seen.inputs.input_of[responses], b"moved" + at.tobytes() + responses.tobytes())
    computed = ports.evaluate(seen.dynamic)
    found = apart_there(seen.measured[:, responses], computed, largest)
    return np.split(found, np.cumsum([len(other.responses) for other in others])[:-1])


def _text(inputs: Inputs, dofs: DofTable, other: _Other, before: float, after: float) -> str:
    each, component = [inputs.responses[i].name for i in other.responses], dofs.component[other.dof]
    names, keys = listing(each, 4), listing([f"responses.{name}" for name in each], 4)
    if other.turned:
        return (
            f"{names}: sensor stated along {other.how} probably measures along {component}: this reduces the level misfit from "
            f"{before:.1f} to {after:.1f} dB (mean level of each response removed). Correct {keys}: component: {component}"
        )
    xyz = ", ".join(f"{value:.6g}" for value in dofs.xyz[other.dof] / inputs.campaign.unit_system.length)
    return (
        f"{names}: sensor probably stated {other.how}: at node {dofs.node[other.dof]} the level misfit falls from "
        f"{before:.1f} to {after:.1f} dB (mean level of each response removed). If the sensor was there, correct {keys}: near: [{xyz}]"
    )


def _others(inputs: Inputs, dofs: DofTable) -> Iterator[_Other]:
    """Nodes at the stated coordinates with two exchanged or one sign reversed, or on another part, and other directions at that node."""
    part = parts_of(inputs.model, joined=False)
    for own, responses in _points(inputs).items():
        if inputs.model.is_acoustic[own]:
            continue
        place, at_node = dofs.xyz[own], np.flatnonzero((dofs.node == dofs.node[own]) & np.char.startswith(dofs.component.astype(str), "U"))
        if own in at_node:
            stated = str(dofs.component[own])
            yield from (_Other(responses=tuple(responses), dof=int(dof), how=stated, turned=True) for dof in at_node if dof != own)
        ways: list[tuple[str, Floats]] = []
        for a, b in ((0, 1), (0, 2), (1, 2)):
            order = [b if k == a else a if k == b else k for k in range(3)]
            ways.append((f"with {_AXES[a]} and {_AXES[b]} exchanged", place[order]))
        ways += [(f"with the sign of {_AXES[a]} reversed", place * np.where(np.arange(3) == a, -1.0, 1.0)) for a in range(3)]
        for how, other in ways:
            found = nearest(dofs, other.tolist(), str(dofs.component[own]))
            if found is not None and found[0] != own and found[1] <= 0.5 * spacing(dofs, found[0]):
                yield _Other(responses=tuple(responses), dof=found[0], how=how)
        if (other_side := _on_other_part(dofs, part, own)) is not None:
            yield _Other(responses=tuple(responses), dof=other_side, how="on the wrong one of two parts that overlap there")


def _on_other_part(dofs: DofTable, part: Integers, own: int) -> int | None:
    """DOF of another part than that of DOF ``own``, nearest to it within half of the mesh size, as in the overlap of a lap joint."""
    away = np.where(dofs.component == dofs.component[own], np.linalg.norm(dofs.xyz - dofs.xyz[own], axis=1), np.inf)
    same = part == part[own]
    mesh = away[same & (away > 0.0)].min(initial=np.inf)
    across = np.where(same, np.inf, away)
    best = int(np.argmin(across))
    return best if np.isfinite(mesh) and across[best] <= 0.5 * mesh else None
