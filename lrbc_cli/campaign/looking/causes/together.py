"""Finds points of hammer and sensors stated from another origin, or with an axis counted from the other side, by all FRFs together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from scipy.spatial import cKDTree

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, LEAST_DIFFERENCE, MOST_LEFT, apart, apart_there
from lrbc_cli.campaign.looking.causes.moved import MOST_HITS
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import affordable, gradually, picking, solved
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reading.places import AT_NODE
from lrbc_cli.campaign.reading.reach import parts_of
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.selection import spacing

_AXES = "xyz"


@dataclass(frozen=True, kw_only=True)
class _Points:
    """Places of hammer points and point sensors, in one order; ``responses`` (R, 2): the points of sensor and hammer of each response."""

    names: tuple[str, ...]
    dof: Integers
    xyz: Floats
    hammer: Integers
    responses: Integers
    of: Integers


@dataclass(frozen=True, kw_only=True)
class _Move:
    """Other places of some points: what was done with them in words, and the DOF of each point."""

    how: str
    fix: str
    moved: Integers
    dof: Integers


def together_text(seen: Seen) -> str:
    """Warning if sensors, with or without the hammer, fit with all of them moved or mirrored in the same way; else empty."""
    inputs, dofs = seen.inputs, seen.inputs.dofs
    if dofs is None or seen.misfit <= LEAST_DIFFERENCE or not affordable(seen) or (points := _points(inputs, dofs)) is None:
        return ""
    moves = list(_moves(inputs, dofs, points))[: MOST_HITS // points.of.size]
    if not moves:
        return ""
    found, largest = list[tuple[float, float, _Move]](), float(np.abs(seen.model).max())
    for few, wider in gradually(seen):
        before, found = apart(few.measured, few.model), []
        with suppress(LrbcError):
            after = _misfits(few, points, moves, largest)
            for move, left in zip(moves, after, strict=True):
                own = np.isfinite(left)
                stated, now = float(np.median(before[points.of[own]])), float(np.median(left[own]))
                if wider * stated > LEAST_DIFFERENCE and now <= wider * min(MOST_LEFT, CLEARLY * stated):
                    found.append((now, stated, move))
        if not found:
            return ""
        moves = [move for *_, move in found]
    now, stated, move = min(found, key=lambda each: each[0])
    unit, first = inputs.campaign.unit_system.length, int(move.moved[0])
    at = ", ".join(f"{value:.6g}" for value in dofs.xyz[move.dof[first]] / unit)
    # With all points mirrored, nothing tells whether they are wrong or the model is; the bolts are wrong only in the latter case.
    every = "counted from the other side" in move.how and move.moved.size == points.dof.size
    model = ". But if their places are right, the model is the mirrored variant, and the bolts are wrong, too: export the other one"
    fix = f"{points.names[first]}: near: [{at}] and so on{model if every else ''}"
    return (
        f"{_who(points, move)} are probably stated {move.how}: {move.fix} the level misfit falls from {stated:.1f} to {now:.1f} dB (mean "
        f"level of each response removed). Correct the places of these points: {fix}"
    )


def _who(points: _Points, move: _Move) -> str:
    """Names of the points that were moved."""
    sensors = np.flatnonzero(~points.hammer)
    if np.setdiff1d(sensors, move.moved).size:
        return listing([points.names[k].partition(".")[2] for k in move.moved], 8)
    return "hammer and sensors" if points.hammer[move.moved].any() else "all sensors"


def _points(inputs: Inputs, dofs: DofTable) -> _Points | None:
    """Points with a single DOF each; None if there are fewer than three sensors."""
    unit, campaign = inputs.campaign.unit_system.length, inputs.campaign
    known: dict[tuple[bool, int], int] = {}
    names, places, of, responses = list[str](), list[Floats](), list[int](), list[tuple[int, int]]()
    L, B = inputs.model.L.tocsr(), inputs.model.B.tocsc()

    def point(hammer: bool, dof: int, name: str) -> int:
        if (hammer, dof) not in known:
            known[hammer, dof] = len(names)
            near = (campaign.excitation if hammer else campaign.responses)[name].near
            names.append(f"{'excitation' if hammer else 'responses'}.{name}")
            places.append(dofs.xyz[dof] if near is None else np.array(near) * unit)
        return known[hammer, dof]

    for i, response in enumerate(inputs.responses):
        row, column = L[[i]].tocoo(), B[:, [response.input]].tocoo()
        if row.nnz == column.nnz == 1:
            hit = point(True, int(column.row[0]), inputs.excitations[response.input])
            of.append(i)
            responses.append((point(False, int(row.col[0]), response.name), hit))
    hammer = np.array([hammer for hammer, _ in known], dtype=bool)
    if (~hammer).sum() < 3:
        return None
    return _Points(
        names=tuple(names),
        dof=np.array([dof for _, dof in known]),
        xyz=np.array(places),
        hammer=hammer,
        responses=np.array(responses),
        of=np.array(of),
    )


def _moves(inputs: Inputs, dofs: DofTable, points: _Points) -> Iterator[_Move]:
    """Reflections, and shifts by mesh widths, to bolts and to the corners of parts, of sensors, of hammer and sensors, or of one part."""
    alike = {component: np.flatnonzero(dofs.component == component) for component in {str(dofs.component[dof]) for dof in points.dof}}
    nearest = {component: (own, cKDTree(dofs.xyz[own])) for component, own in alike.items()}
    sizes = np.array([spacing(dofs, int(dof)) for dof in points.dof])
    part = parts_of(inputs.model, joined=False)
    count = int(part.max()) + 1
    unit, seen = inputs.campaign.unit_system.length, set[bytes]()

    def moved(places: Floats, own: Integers, how: str, fix: str, of: int | None = None) -> Iterator[_Move]:
        dof = points.dof.copy()
        away = np.zeros(dof.size)
        for k in own.tolist():
            candidates, tree = nearest[str(dofs.component[dof[k]])]
            away[k], at = tree.query(places[k])
            dof[k] = candidates[at]
        # Of one part, only those that then lie at its nodes.
        own = own if of is None else own[(part[dof[own]] == of) & (away[own] <= AT_NODE * sizes[own])]
        rest = np.setdiff1d(np.arange(dof.size), own)
        dof[rest] = points.dof[rest]
        # Of points on the plane of a mirror none moves; what leaves the structure was not there. Within it, in the middle of a cell, the
        # nearest node is up to 0.87 mesh widths away.
        changed = (dof != points.dof)[own]
        if own.size > 1 and 2 * changed.sum() > own.size and np.all(away[own] <= sizes[own]) and dof.tobytes() not in seen:
            seen.add(dof.tobytes())
            yield _Move(how=how, fix=fix, moved=own, dof=dof)

    every = np.arange(points.dof.size)
    groups = [np.flatnonzero(~points.hammer), every]
    # Walls of the air, or ends of the structure; where these are fixed, the model has no DOFs of the component there.
    ends = [np.array([_ends(dofs.xyz[alike[str(dofs.component[dof])]]) for dof in points.dof]), _ends(dofs.xyz)]
    for own, total, axis in product(groups, ends, range(3)):
        mirrored = np.where(np.arange(3) == axis, total - points.xyz, points.xyz)
        yield from moved(mirrored, own, f"with {_AXES[axis]} counted from the other side", "at the mirrored places")
    # Named origins come first: a mesh width may be the same shift.
    structural = ~inputs.model.is_acoustic
    for one in np.flatnonzero(np.bincount(part[structural], minlength=count) > points.dof.size).tolist():
        for corner in product(*({0.0, value} for value in dofs.xyz[(part == one) & structural].min(axis=0).tolist())):
            if any(corner):
                yield from moved(points.xyz + np.array(corner), every, "from the corner of their part", _added(corner, unit), one)
    shifts: list[tuple[str, tuple[float, ...]]] = []
    if inputs.bolts is not None:
        shifts += [(f"from bolt {name}", tuple(at)) for name, at in zip(inputs.bolts.name, inputs.bolts.xyz.tolist(), strict=True)]
    for axes in combinations(range(3), 2):
        for steps in product((-2, -1, 0, 1, 2), repeat=2):
            along = dict(zip(axes, steps, strict=True))
            shifts.append(("from another origin", tuple(along.get(axis, 0) * float(np.median(sizes)) for axis in range(3))))
    for how, shift in shifts:
        for own in groups:
            yield from moved(points.xyz + np.array(shift), own, how, _added(shift, unit))


def _ends(xyz: Floats) -> Floats:
    """Sum of the least and the largest coordinates along each axis."""
    return np.asarray(xyz.min(axis=0) + xyz.max(axis=0))


def _added(shift: tuple[float, ...], unit: float) -> str:
    return f"with ({', '.join(f'{value / unit:g}' for value in shift)}) added"


def _misfits(seen: Seen, points: _Points, moves: list[_Move], largest: float) -> list[Floats]:
    """Level misfits of the responses of ``points.of`` with each move [dB]; NaN for those that it does not affect."""
    sensor, hammer = points.responses.T
    pairs = np.array([np.stack([np.arange(points.of.size), move.dof[sensor], move.dof[hammer]], axis=1) for move in moves])
    changed = np.array([(move.dof != points.dof)[points.responses].any(axis=1) for move in moves])
    rows, at = np.unique(pairs[changed], axis=0, return_inverse=True)
    struck, input_of = np.unique(rows[:, 2], return_inverse=True)
    model, of = seen.inputs.model, points.of[rows[:, 0]]
    L, B = picking(rows[:, 1], model.size), picking(struck, model.size).T.tocsc()
    other = replace(model, L=L, B=B, output_power=model.output_power[of], extras={})
    computed = solved(seen, other, input_of, b"together" + rows.tobytes()).evaluate(seen.dynamic)
    found = np.full(changed.shape, np.nan)
    found[changed] = apart_there(seen.measured[:, of], computed, largest)[at.ravel()]
    return list(found)
