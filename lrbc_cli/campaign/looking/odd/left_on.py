"""Tests whether something was left on the structure in a job, such as a tool, with all bolts tight or beside loosened ones."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, apart
from lrbc_cli.campaign.looking.causes.added import EXTRA, Added, Solved, Tried, best_added, nearest_added, translations, with_added
from lrbc_cli.campaign.looking.causes.held import supports_of
from lrbc_cli.campaign.looking.fitted import expected_frf, fitted_frf, multiplied
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import EXPLAINED, FEWEST, LINES, NEARER, affordable
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.updating.search.starts import LEVELS
from lrbc_cli.updating.unknowns.shapes import bolt_shapes

#: Matrix, number of the place, and what is added there.
_Way = tuple[str, int, float]


def left_on_text(seen: Seen, before: float, usual: float = 0.0) -> str:
    """Clause on a job that a further mass, or other supports, explain; empty if they do not.

    A mass is looked for with all bolts tight first, then either with the bolts fitted beside it.

    Parameters
    ----------
    seen : Seen
        A job that no state of the bolts explains.
    before : float
        Level misfit that a fit of the bolts leaves [dB].
    usual : float
        What such a fit leaves of the best explained job, by errors of the model, and so of this one, too [dB].
    """
    most = min(EXPLAINED, usual + CLEARLY * max(before - usual, 0.0))
    how, found = "with all bolts tight", nearest_added(seen, before)
    if found is None or found.left > min(most, NEARER * seen.misfit):
        how, found = f"with the bolts fitted beside it, {before:.1f} dB without it", _beside_loosened(seen, before)
    if found is None or found.left > most:
        return ""
    if found.of is not None:
        times = 1.0 + found.size
        changed = f"{times:.2g} times as stiff" if times > 1.0 else f"softer by a factor of {1.0 / times:.2g}"
        return (
            f"With the supports at nodes {listing(list(found.nodes), 6)} {changed} the level misfit is {found.left:.1f} dB, {how}: the "
            "structure probably stood on other supports, or one of them was blocked. Measure this job again on those of the reference job"
        )
    return (
        f"With about {found.size:.2g} kg more near {found.where} the level misfit is {found.left:.1f} dB, {how}: something "
        "was probably left on the structure, such as a tool, a stand or a further sensor. Remove it, and measure this job again"
    )


def _beside_loosened(seen: Seen, before: float, *, steps: tuple[float, ...] = (0.5, 0.7, 1.0, 1.4, 2.0)) -> Added | None:
    """The mass, or the change of the supports, with which some state of the bolts is nearest to a measurement; None if there is none.

    Bolts and mass hide each other, so neither is found beside a fit of the other. Where both are found together, the bolts are fitted
    with ``steps`` times the mass or the change found.

    Parameters
    ----------
    seen : Seen
        A job with the measured tight state.
    before : float
        Level misfit that a fit of the bolts alone leaves [dB].
    steps : tuple of float
    """
    source, prior = seen.source, seen.parameters.initial
    if seen.tight is None or source.stage is None or seen.inputs.model.extras:
        return None
    model = source.model(seen.s, seen.parameters).frf(prior)
    # As compared with the measured tight state, which holds the errors of the model.
    found = _together(seen.reading(seen.measured * model / expected_frf(seen, prior)))
    if found is None or found.left >= before:
        return None
    left = list[tuple[float, float]]()
    with suppress(LrbcError):
        heavier = with_added(seen, found)
        assert heavier.stage is not None
        affine = affine_model(heavier.inputs, heavier.stage)
        # Supports cannot lose more than they have.
        for step in (step for step in steps if found.of is None or step * found.size > -1.0):
            other = multiplied(heavier, affine, {EXTRA: step})
            # The tight state as it would be with the mass.
            there = other.model(seen.s, seen.parameters).frf(prior)
            fitted = fitted_frf(replace(seen, source=other, tight=seen.tight * there / model))
            left += [] if fitted is None else [(float(np.median(apart(seen.measured, fitted))), step)]
    least, step = min(left, default=(np.inf, 1.0))
    return replace(found, size=step * found.size, left=least)


def _together(
    seen: Seen,
    *,
    nodes: int = 60,
    shares: tuple[float, ...] = (0.03, 0.06, 0.1, 0.2, 0.4),
    times: tuple[float, ...] = (0.03, 0.1, 0.3, 3.0, 10.0, 30.0, 100.0, 300.0),
    levels: tuple[float, ...] = LEVELS[1::2],
    most: int = 4,
) -> Added | None:
    """A mass or other supports, and loosened bolts, one after another, each the one that leaves least; None without bolts.

    Parameters
    ----------
    seen : Seen
    nodes : int
        Number of nodes that are tried, spread over the structure, then about the best of these; and largest number of DOFs of supports.
    shares : tuple of float
        Shares of the mass of the model that are tried at each.
    times : tuple of float
        Factors that are tried on the stiffness of all supports.
    levels : tuple of float
        Changes of a bolt that are tried [decades]; the fit that follows needs no more.
    most : int
        Largest number of bolts.
    """
    inputs, tried = seen.inputs, Tried.of(seen, nodes)
    if inputs.bolts is None or tried is None or not affordable(seen, 1.0 + 3.0 * nodes / (1.0 + inputs.model.terms.size)):
        return None
    supports, stiffness = supports_of(seen)
    places = translations(seen, tried.nodes[tried.spread])
    share = np.concatenate([np.ones(sum(place.size for place in places)), stiffness])
    masses = [("mass", k, size * tried.mass) for k in range(len(places)) for size in shares]
    others = [("stiffness", len(places), factor - 1.0) for factor in times] if 0 < supports.size <= nodes else []
    with suppress(LrbcError):
        solved = Solved.of(seen.few(FEWEST), [*places, *([supports] if others else [])], share if others else None)
        found = [_greedy(solved, ways, levels, most) for ways in (masses, others) if ways]
        left, theta, (matrix, at, size) = min(found, key=lambda each: each[0])
        if matrix == "stiffness":
            return _supports(seen, supports, stiffness, size, left)
        about = tried.about(tried.xyz[tried.spread[at]], nodes)
        sizes = [size * step for step in np.geomspace(1.0 / 3.0, 3.0, 5)]
        return best_added(seen.few(LINES), tried, about, [("mass", (k,), sizes) for k in range(about.size)], theta)
    return None


def _greedy(solved: Solved, ways: Sequence[_Way], levels: Sequence[float], most: int) -> tuple[float, Floats, _Way]:
    """Level misfit [dB] with the best of some ways and of the states of up to ``most`` loosened bolts, that state, and the way."""
    inputs, parameters = solved.seen.inputs, solved.seen.parameters
    assert inputs.bolts is not None
    shapes = bolt_shapes(parameters, inputs.bolts.xyz, inputs.statistics.values, inputs.statistics.bolts)
    columns = sorted(set(shapes.bolts.tolist()) - {-1})

    def best(states: list[Floats]) -> tuple[float, Floats, _Way]:
        found = list[tuple[float, int, _Way]]()
        for each, theta in enumerate(states):
            misfits = solved.misfits(theta)
            found.append(min((misfits(way[0], (way[1],), way[2]), each, way) for way in ways))
        left, each, way = min(found)
        return left, states[each], way

    found = best([parameters.initial])
    for _ in range(most):
        now = best([np.clip(found[1] + level * shapes.T[:, own], *parameters.bounds.T) for own in columns for level in levels])
        if now[0] >= found[0]:
            break
        found = now
    return found


def _supports(seen: Seen, at: Integers, stiffness: Floats | Complexes, change: float, left: float) -> Added:
    """All supports, stiffer by ``change`` times their stiffness."""
    assert seen.inputs.dofs is not None
    nodes = tuple(np.unique(seen.inputs.dofs.node[at]).tolist())
    return Added(matrix="stiffness", size=change, nodes=nodes, at=at, place="", left=left, of=stiffness)
