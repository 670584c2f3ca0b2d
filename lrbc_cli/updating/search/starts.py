"""Start values of descents by scans and tables of the cost, which find valleys beyond ridges that no gradient passes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats
from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.reduction.threads import side_by_side
from lrbc_cli.updating.misfit.cost import Evaluation, Misfit
from lrbc_cli.updating.search.optimise import Objective, Solution
from lrbc_cli.updating.unknowns.shapes import joints_of

#: From two columns of joints to all pairs that are exchanged together with them, see ``Shapes.mirrored``.
Mirrors = Callable[[int, int], Sequence[tuple[int, int]]]

#: Changes of a bolt that tables try [decades], from half of the stiffness to almost none.
LEVELS = (-0.3, -0.7, -1.2, -2.0, -3.0)


def between(levels: Sequence[float], parts: int = 4) -> tuple[float, ...]:
    """The levels with further ones between them and zero, each interval divided into ``parts`` equal parts."""
    known = np.array([0.0, *levels])
    return tuple(np.interp(np.arange(1, parts * len(levels) + 1) / parts, np.arange(known.size), known).tolist())


def alone(one: int, other: int) -> list[tuple[int, int]]:
    """Only the two joints themselves: the default of ``Mirrors``."""
    return [(one, other)]


def moved_values(parameters: Parameterisation) -> NDArray[np.bool_]:
    """(size,) mask of the values of stiffness groups; of all groups if there is no stiffness group."""
    moved = np.zeros(parameters.size, dtype=bool)
    for group, values, _ in parameters.placed:
        moved[values] = group.kind == "stiffness"
    return moved if moved.any() else ~parameters.is_damping


def uniform_values(misfit: Misfit, theta: Floats, bounds: Floats, *, step: float = 0.25, most: int = 41) -> list[Floats]:
    """Thetas with uniform values of the stiffness groups between their bounds, in steps of ``step`` decades, at most ``most`` of them.

    p_damp, damping and mass groups keep their values; without a stiffness group all groups are moved.
    """
    moved = moved_values(misfit.model.parameters)
    width = bounds[:, 1] - bounds[:, 0]
    count = int(np.clip(np.ceil(float(np.max(width[moved], initial=0.0)) / step) + 1, 2, most))
    return [np.where(moved, bounds[:, 0] + fraction * width, theta) for fraction in np.linspace(0.0, 1.0, count)]


def uniform_changes(misfit: Misfit, bounds: Floats, *, step: float = 0.25, most: int = 41) -> list[Floats]:
    """Thetas with the prior of the stiffness groups moved as a whole within their bounds, in steps of ``step`` decades."""
    prior, moved = misfit.prior, moved_values(misfit.model.parameters)
    low, high = (bounds - prior[:, None])[moved].T
    steps = np.arange(np.ceil(np.median(low) / step), np.floor(np.median(high) / step) + 1)[:most]
    return [np.clip(np.where(moved, prior + step * count, prior), bounds[:, 0], bounds[:, 1]) for count in steps]


def zoom(
    objective: Objective, theta: Floats, bounds: Floats, direction: Floats, *, step: float = 0.125, least: float = 1e-4
) -> Iterator[tuple[Floats, Evaluation]]:
    """Compass search along a direction on the mean misfit, from steps that pass many peaks down to steps within two lines.

    If lines are further apart than a peak is wide, the cost has a valley wherever a peak lies between two lines; the mean misfit falls
    towards the truth nevertheless.

    Parameters
    ----------
    objective : callable
    theta : (size,) float array
        Start.
    bounds : (size, 2) float array
    direction : (size,) float array
    step, least : float
        First and last step along it, halved if neither way lowers the misfit.

    Yields
    ------
    (size,) float array, Evaluation
        Every place that is tried.
    """
    value = objective(theta)
    yield theta, value
    while step >= least:
        for way in (step, -step):
            trial = np.clip(theta + way * direction, *bounds.T)
            found = objective(trial)
            yield trial, found
            if found.misfit_db < value.misfit_db:
                theta, value = trial, found
                break
        else:
            step *= 0.5


def group_levels(
    misfit: Misfit, theta: Floats, bounds: Floats, *, step: float = 0.5, least: float = 1e-3, width: int = 8, kept: int = 3
) -> list[Floats]:
    """Thetas with each stiffness group moved as a whole to the least mean misfit; an empty list if there is one group only.

    Axial and rocking stiffnesses of the same bolts may be wrong by different factors. A beam search by tables over one group at a time is
    followed by a compass search about the best places.

    Parameters
    ----------
    misfit : Misfit
    theta : (size,) float array
        Start.
    bounds : (size, 2) float array
    step, least : float
        Step of the tables, and last step of the compass search [decades].
    width, kept : int
        Size of the beam, and number of places returned.
    """
    P, (low, high) = misfit.model.parameters, bounds.T
    groups = [values for group, values, _ in P.placed if group.kind == "stiffness"]
    known: dict[tuple[float, ...], float] = {}

    def place(shifts: tuple[float, ...]) -> Floats:
        moved = theta.copy()
        for values, shift in zip(groups, shifts, strict=True):
            moved[values] = np.clip(theta[values] + shift, low[values], high[values])
        return moved

    def at(shifts: tuple[float, ...]) -> float:
        if shifts not in known:
            value = misfit.mean_db(misfit.model.frf(place(shifts)))
            known[shifts] = value if np.isfinite(value) else np.inf
        return known[shifts]

    if len(groups) < 2:
        return []
    reach = [np.arange(np.ceil((low - theta)[v].min() / step), np.floor((high - theta)[v].max() / step) + 1) * step for v in groups]
    beam = [(0.0,) * len(groups)]
    while True:
        table = {(*own[:k], float(shift), *own[k + 1 :]) for own in beam for k in range(len(groups)) for shift in reach[k]}
        nearest = sorted({*beam, *table}, key=lambda shifts: (at(shifts), shifts))[:width]
        if nearest == beam:
            break
        beam = nearest
    found = []
    for own in beam[:kept]:
        size = 0.5 * step
        while size >= least:
            ways = [(*own[:k], own[k] + way, *own[k + 1 :]) for k in range(len(groups)) for way in (size, -size)]
            nearer = min(ways, key=at)
            own, size = (nearer, size) if at(nearer) < at(own) else (own, 0.5 * size)
        found.append(own)
    return [place(own) for own in dict.fromkeys(sorted(found, key=at))]


def single_values(misfit: Misfit, theta: Floats, bounds: Floats, *, step: float = 0.25, least: float = 0.01) -> Floats:
    """Theta with single values moved until the mean misfit falls no more: a compass search, each step the best of a table of all values.

    A sharp peak between two lines hardly shows, so a descent on squares stays in its valley; a table does not. Damping exponents stay.

    Parameters
    ----------
    misfit : Misfit
    theta : (size,) float array
    bounds : (size, 2) float array
    step, least : float
        First and last step, halved if no move lowers the misfit [decades].
    """
    stiff, best = np.flatnonzero(~misfit.model.parameters.is_damping).tolist(), misfit.mean_db(misfit.model.frf(theta))
    near = misfit.model.near(theta)
    while step >= least:
        table = []
        for k, way in product(stiff, (step, -step)):
            trial = theta.copy()
            trial[k] = np.clip(theta[k] + way, *bounds[k])
            table.append((misfit.mean_db(near.frf(trial)), k, way, trial))
        nearest = min(table, key=lambda one: one[:3])
        if nearest[0] < best:
            best, theta = nearest[0], nearest[3]
            near = near.near(theta)
        else:
            step *= 0.5
    return theta


def single_joints(misfit: Misfit, theta: Floats, start: Floats, bounds: Floats, *, tighter: float = 0.5, kept: int = 2) -> list[Floats]:
    """Thetas with one joint moved to its best level of a table, for the ``kept`` joints with the least mean misfit, best first.

    A joint is here all values of a bolt, or a stiffness value that belongs to no bolt.

    Parameters
    ----------
    misfit : Misfit
    theta : (size,) float array
    start : (size,) float array
        Values from which the levels count.
    bounds : (size, 2) float array
    tighter : float
        Level in addition to ``LEVELS`` [decades].
    kept : int
    """
    P = misfit.model.parameters
    bolts = 1 + max((int(group.bolt.max()) for group in P.groups if group.bolt is not None and group.bolt.size), default=-1)
    joints = [np.concatenate(list(own.values())) for own in joints_of(P, bolts) if own]
    owned = {int(k) for own in joints for k in own}
    stiff = [k for group, values, _ in P.placed if group.kind == "stiffness" for k in range(values.start, values.stop)]
    joints += [np.array([k]) for k in stiff if k not in owned]
    found = []
    for number, values_of in enumerate(joints):
        own = []
        for level in (*LEVELS, tighter):
            moved = theta.copy()
            moved[values_of] = np.clip(start[values_of] + level, *bounds[values_of].T)
            own.append((misfit.mean_db(misfit.model.frf(moved)), level, moved))
        difference, _, moved = min(own, key=lambda one: one[:2])
        found.append((difference, number, moved))
    return [moved for _, _, moved in sorted(found, key=lambda one: one[:2])[:kept]]


def hops(misfit: Misfit, end: Solution, bounds: Floats, span: Floats, *, step: float = 0.25, kept: int = 3) -> list[Floats]:
    """Places beside an optimum from which a descent may find another valley: where the cost rises least relative to its curvature.

    Each unknown z is moved by ``step`` either way. A peak that passes a line is a narrow, steep ridge in the cost; a small rise indicates
    that it has been passed.

    Parameters
    ----------
    misfit : Misfit
    end : Solution
        Its Jacobian is to z.
    bounds : (size, 2) float array
    span : (size, m) float array
        Unknowns ``prior + span z``.
    step : float
        [decades].
    kept : int
        Number of places.

    Returns
    -------
    list of (size,) float array
        At most one for each z.
    """
    near, here = misfit.near(end.theta), end.evaluation
    found: list[tuple[float, int, Floats]] = []
    for k in np.flatnonzero(~misfit.model.parameters.is_damping @ np.abs(span) > 0).tolist():
        slope, column = float(here.jacobian[:, k] @ here.residual), here.jacobian[:, k]
        ratios = []
        for way in (step, -step):
            theta = np.clip(end.theta + way * span[:, k], *bounds.T)
            promised = float(column @ column) * way**2 + 2.0 * slope * way
            rise = near.sum(theta) - here.total
            ratios.append((rise / promised if promised > 0.0 else np.inf, theta))
        ratio, theta = min(ratios, key=lambda one: one[0])
        found.append((ratio, k, theta))
    return [theta for ratio, _, theta in sorted(found, key=lambda one: one[:2])[:kept] if np.isfinite(ratio)]


def other_levels(
    misfit: Misfit, end: Solution, bounds: Floats, span: Floats, joints: Sequence[int], mirrors: Mirrors = alone, *, kept: int = 12
) -> list[Floats]:
    """Places beside an optimum with one joint at another level (its groups alike), or exchanged with a stiffer joint; all else as there.

    The levels are zero and ``LEVELS``, without the one nearest to the end.

    A table about the prior has all other joints as in the reference job. About an end their scatter is known, so a joint that was mistaken
    for another one, or whose descent stopped halfway, shows. Joints at mirrored places differ only by what is not symmetric: a descent
    that began nearer to one never finds the other.

    Parameters
    ----------
    misfit : Misfit
    end : Solution
    bounds : (size, 2) float array
    span : (size, m) float array
        Unknowns ``prior + span z``.
    joints : sequence of int
        Indices in z of the changes of joints.
    mirrors : callable
        Pairs that are exchanged together with a pair of joints. The softer one of the pair has lost ``LEVELS[0]`` or more.
    kept : int

    Returns
    -------
    list of (size,) float array
        The ``kept`` places with the least mean misfit, best first.
    """
    frf = misfit.model.near(end.theta).frf
    z = np.linalg.lstsq(span, end.theta - misfit.prior, rcond=None)[0]

    def moved(joint: int) -> list[tuple[float, int, float, Floats]]:
        others = sorted((0.0, *LEVELS), key=lambda level: abs(level - z[joint]))[1:]
        own, alike = span[:, joint] != 0.0, span[:, joint]
        thetas = [np.clip(np.where(own, misfit.prior + level * alike, end.theta), *bounds.T) for level in others]
        return [(misfit.mean_db(frf(theta)), joint, level, theta) for level, theta in zip(others, thetas, strict=True)]

    def exchanged(pair: tuple[int, int]) -> list[tuple[float, int, float, Floats]]:
        theta = end.theta.copy()
        for one, other in mirrors(*pair):
            own, its = (np.flatnonzero(span[:, joint]) for joint in (one, other))
            higher = theta[its].mean() - theta[own].mean()
            theta[own], theta[its] = (theta[its], theta[own]) if own.size == its.size else (theta[own] + higher, theta[its] - higher)
        theta = np.clip(theta, *bounds.T)
        return [(misfit.mean_db(frf(theta)), pair[0], float(pair[1]), theta)]

    loosened = [(one, other) for one, other in product(joints, joints) if z[one] <= LEVELS[0] and z[one] < z[other]]
    tables = [*side_by_side(moved, joints), *side_by_side(exchanged, loosened)]
    found = [place for places in tables for place in places if np.isfinite(place[0])]
    return [theta for *_, theta in sorted(found, key=lambda one: one[:3])[:kept]]


def basins(totals: Sequence[float], count: int = 2) -> list[int]:
    """Indices of the trials to start from: the ``count`` lowest local minima of a scan, then trial 0, the given start.

    The trials after the first are the scan, in order of their values.
    """
    scan = np.array([np.inf, *totals[1:], np.inf])
    valleys = [i for i in range(1, len(totals)) if scan[i] < scan[i - 1] and scan[i] <= scan[i + 1]]
    return [*sorted(valleys, key=lambda i: totals[i])[:count], 0]
