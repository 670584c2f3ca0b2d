"""Sensors with several axes that are mounted turned, or at another place, than the campaign file says, by all axes together."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.findings import Finding, Kind
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, apart
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.causes.moved import sensor_text
from lrbc_cli.campaign.looking.fitted import roughly_calibrated
from lrbc_cli.campaign.looking.states import Looking, Seen
from lrbc_cli.campaign.looking.trials import NEAR
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.errors import listing
from lrbc_cli.model.dofs import COMPONENTS


@dataclass(frozen=True, kw_only=True)
class Body:
    """A sensor with several axes at one node.

    Attributes
    ----------
    node : int
    axes : (a, 3) float array
        Stated directions, perpendicular to each other.
    responses : (h, a) int array
        Response along each of them, for each of h hammer points.
    """

    node: int
    axes: Floats
    responses: Integers


def bodies_of(inputs: Inputs, *, rounding: float = 1e-6) -> list[Body]:
    """Sensors that measure along two or three perpendicular directions at one node, at each hammer point along the same ones."""
    dofs, L = inputs.dofs, inputs.model.L.tocsr()
    at: dict[int, dict[int, list[tuple[int, Floats]]]] = {}
    for i in range(L.shape[0]) if dofs is not None else ():
        assert dofs is not None
        row = L[[i]].tocoo()
        labels = dofs.component[row.col].tolist()
        if np.unique(dofs.node[row.col]).size == 1 and set(labels) <= set(COMPONENTS[:3]):
            direction = np.zeros(3)
            direction[[COMPONENTS.index(label) for label in labels]] = row.data
            own = at.setdefault(int(dofs.node[row.col[0]]), {}).setdefault(inputs.responses[i].input, [])
            direction /= np.linalg.norm(direction)
            # A DOF may have two names.
            if not any(float(direction @ other) > 1.0 - rounding for _, other in own):
                own.append((i, direction))
    found = []
    for node, points in at.items():
        axes = [np.array([direction for _, direction in own]) for own in points.values()]
        first = axes[0]
        alone = len(first) in (2, 3) and bool(np.all(np.abs(first @ first.T - np.eye(len(first))) < rounding))
        if alone and all(own.shape == first.shape and np.allclose(own, first) for own in axes):
            found.append(Body(node=node, axes=first, responses=np.array([[i for i, _ in own] for own in points.values()])))
    return found


def turn_of(measured: Complexes, computed: Complexes) -> Floats:
    """(a, a) orthogonal matrix R with the least weighted ``|measured - R computed|²``, from FRFs (..., a) along a axes.

    Each line has the same weight, whatever its level (orthogonal Procrustes problem, Schönemann, Psychometrika 31, 1966).
    """
    axes = measured.shape[-1]
    m, y = measured.reshape(-1, axes), computed.reshape(-1, axes)
    known = np.isfinite(m).all(axis=1) & np.isfinite(y).all(axis=1)
    m, y = m[known], y[known]
    size = np.sum(np.abs(m) ** 2, axis=1) + np.sum(np.abs(y) ** 2, axis=1)
    weight = 1.0 / np.maximum(size, np.finfo(float).tiny)
    left, _, right = np.linalg.svd(np.real((m * weight[:, None]).T @ y.conj()))
    return np.asarray(left @ right)


def of_several_axes(source: Looking, measurement: Measurement, job: str) -> list[Finding]:
    """Findings of sensors with several axes that are mounted turned, or at another place, in the reference job.

    Beside a rough calibration where there is one: what its axes say one by one may look like a reversed sign or a wrong unit.
    """
    if not bodies_of(source.inputs):
        return []
    seen = Seen.of(roughly_calibrated(source, measurement) or source, job, measurement)
    turned = turned_findings(seen)
    return turned + moved_findings(seen, {i for each in turned for i in each.responses})


def moved_findings(seen: Seen, known: Collection[int], *, farther: float = 2.0) -> list[Finding]:
    """Findings of sensors of which several axes fit the model at another place.

    Parameters
    ----------
    seen : Seen
        The reference job.
    known : collection of int
        Responses of sensors with other findings.
    farther : float
        Least level misfit of the records of a sensor, median, over that of all records.
    """
    every, found = apart(seen.measured, seen.model), []
    if not (every > 0.0).any():
        return []
    # Records without values have no misfit.
    every = np.where(every > 0.0, every, np.nan)
    least = max(NEAR, farther * float(np.nanmedian(every)))
    for body in bodies_of(seen.inputs):
        own = body.responses.ravel().tolist()
        away = float(np.nanmedian(every[own])) if np.isfinite(every[own]).any() else 0.0
        # What other directions explain, such as exchanged axes, is told elsewhere.
        if away <= least or set(own) & set(known) or _explained(seen, body):
            continue
        places = {seen.inputs.responses[i].name: text for i in body.responses[0].tolist() if (text := sensor_text(seen, i))}
        if len(places) > 1:
            text = (
                f"{listing([seen.inputs.responses[i].name for i in own], 9)} differ from the model by {away:.1f} dB (median, mean level of "
                f"each removed), all records by {np.nanmedian(every):.1f} dB: the sensor was probably at another place than stated. "
                + "; ".join(f"{name}: {place.removeprefix('; ')}" for name, place in places.items())
                + ". Check where it was, and correct its responses"
            )
            found.append(Finding(text=text, kind=Kind.COORDINATES, responses=tuple(own)))
    return found


def turned_findings(seen: Seen, *, plain: float = 0.99) -> list[Finding]:
    """Findings of sensors whose records fit the model along other directions, common to all their axes, than the stated ones.

    Exchanged axes and reversed signs are told as such elsewhere. One rotation for all records hardly halves what errors of the model leave:
    it has one or three free values. The axis that fits worst decides, since a small turn shows most where little motion is stated.

    Parameters
    ----------
    seen : Seen
        The reference job.
    plain : float
        Largest cosine of a channel with the nearest stated axis, or its opposite, from which on it measures along that axis: 8 degrees.
    """
    found = []
    for body in bodies_of(seen.inputs):
        turn, stated, there = _turned(seen, body)
        if not np.isfinite([*stated, *there]).all() or np.abs(turn).max(axis=1).min() >= plain:
            continue
        worst = int(np.argmax(stated))
        if stated[worst] > NEAR and there[worst] <= CLEARLY * stated[worst] and there.sum() < stated.sum():
            text = _text(seen, body, turn, (float(stated[worst]), float(there[worst])))
            found.append(Finding(text=text, kind=Kind.COORDINATES, responses=tuple(body.responses.ravel().tolist())))
    return found


def _explained(seen: Seen, body: Body) -> bool:
    """Whether other directions of its axes, right angles and reversed signs included, leave less than half of the misfit of a sensor."""
    _, stated, there = _turned(seen, body)
    return bool(np.nansum(there) <= CLEARLY * np.nansum(stated))


def _turned(seen: Seen, body: Body) -> tuple[Floats, Floats, Floats]:
    """``turn_of`` a sensor, and level misfits of its axes (a,) as stated and turned [dB]."""
    measured, computed = seen.measured[:, body.responses], seen.model[:, body.responses]
    turn = turn_of(measured, computed)
    return turn, _by_axis(measured, computed), _by_axis(measured, computed @ turn.T)


def _by_axis(measured: Complexes, computed: Complexes) -> Floats:
    """(a,) level misfits of FRFs (F, h, a) [dB], median over the records with values of each axis; NaN for an axis without values."""
    away = apart(measured.reshape(len(measured), -1), computed.reshape(len(measured), -1)).reshape(measured.shape[1:])
    return np.array([np.median(own[own > 0.0]) if (own > 0.0).any() else np.nan for own in away.T])


def _text(seen: Seen, body: Body, turn: Floats, misfits: tuple[float, float], *, same: float = 0.99) -> str:
    """``misfits``: level misfit of its worst axis as stated, and turned [dB]; ``same``: cosine from which on a direction is right."""
    names = [[seen.inputs.responses[i].name for i in own] for own in body.responses.T.tolist()]
    pairs = list(zip(names, body.axes, turn @ body.axes, strict=True))
    channels = [f"{own[0]} along {_along(there)} instead of {_along(here)}" for own, here, there in pairs if here @ there < same]
    return (
        f"{listing([name for own in names for name in own], 9)}: the sensor at node {body.node} is probably mounted turned"
        f"{_angle(body, turn)}: {listing(channels, 3)}. This reduces the level misfit of its worst axis from {misfits[0]:.1f} to "
        f"{misfits[1]:.1f} dB (mean level of each removed). Check how it is mounted. Then state these directions as rows of a matrix "
        "(responses: {matrix: FILE, row:}), or mount it as stated"
    )


def _angle(body: Body, turn: Floats) -> str:
    """By how much and about which direction, in words; what else a reflection is."""
    if np.linalg.det(turn) < 0.0:
        return ", with one channel reversed or two of them exchanged"
    if len(body.axes) == 3:
        # Of the sensor in space.
        space = body.axes.T @ turn.T @ body.axes
        axis = np.array([space[2, 1] - space[1, 2], space[0, 2] - space[2, 0], space[1, 0] - space[0, 1]])
        cosine = 0.5 * (np.trace(space) - 1.0)
    else:
        axis, cosine = np.cross(*body.axes) * (turn[0, 1] - turn[1, 0]), 0.5 * np.trace(turn)
    degrees = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    length = float(np.linalg.norm(axis))
    return f" by about {degrees:.0f} degrees" + (f" about {_along(axis / length)}" if length > 0.0 else "")


def _along(direction: Floats, *, least: float = 0.05) -> str:
    """A direction in words, as ``0.71 X - 0.71 Z``; parts below ``least`` are left out."""
    parts: Sequence[tuple[float, str]] = [(float(part), axis) for part, axis in zip(direction, "XYZ", strict=True) if abs(part) >= least]
    text = " ".join(f"{'-' if part < 0 else '+'} {'' if abs(part) > 1.0 - least**2 else f'{abs(part):.2f} '}{axis}" for part, axis in parts)
    return text.removeprefix("+ ").replace("- ", "-", 1) if text.startswith("- ") else text.removeprefix("+ ")
