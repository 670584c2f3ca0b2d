"""Tests whether something was left on the structure in a job, such as a tool, with all bolts tight or beside loosened ones."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, apart
from lrbc_cli.campaign.looking.causes.added import EXTRA, Added, Solved, Tried, best_added, nearest_added, with_added
from lrbc_cli.campaign.looking.fitted import expected_frf, fitted_frf, multiplied
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import EXPLAINED, FEWEST, LINES, NEARER, affordable
from lrbc_cli.campaign.reduced.stage import affine_model
from lrbc_cli.errors import LrbcError
from lrbc_cli.updating.search.starts import LEVELS
from lrbc_cli.updating.unknowns.shapes import bolt_shapes


def left_on_text(seen: Seen, before: float) -> str:
    """Clause on a job that a further mass explains, with all bolts tight or with the bolts fitted beside it; empty if there is none.

    Parameters
    ----------
    seen : Seen
        A job that no state of the bolts explains.
    before : float
        Level misfit that a fit of the bolts leaves [dB].
    """
    most, how, found = min(EXPLAINED, CLEARLY * before), "with all bolts tight", nearest_added(seen, before)
    if found is None or found.left > min(most, NEARER * seen.misfit):
        how, found = f"with the bolts fitted beside it, {before:.1f} dB without it", _beside_loosened(seen, before)
    if found is None or found.left > most:
        return ""
    return (
        f"With about {found.size:.2g} kg more near {found.where} the level misfit is {found.left:.1f} dB, {how}: something "
        "was probably left on the structure, such as a tool, a stand or a further sensor. Remove it, and measure this job again"
    )


def _beside_loosened(seen: Seen, before: float, *, steps: tuple[float, ...] = (0.5, 0.7, 1.0, 1.4, 2.0)) -> Added | None:
    """The mass with which some state of the bolts is nearest to a measurement; None if there is none.

    Bolts and mass hide each other, so neither is found beside a fit of the other. Where both are found together, the bolts are fitted
    with masses of ``steps`` times the one found.

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
        for step in steps:
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
    levels: tuple[float, ...] = LEVELS[1::2],
    most: int = 4,
) -> Added | None:
    """A mass and loosened bolts, one after another, each the one that leaves least with the best of all masses; None without bolts.

    Parameters
    ----------
    seen : Seen
    nodes : int
        Number of nodes that are tried, spread over the structure, then about the best of these.
    shares : tuple of float
        Shares of the mass of the model that are tried at each.
    levels : tuple of float
        Changes of a bolt that are tried [decades]; the fit that follows needs no more.
    most : int
        Largest number of bolts.
    """
    inputs, parameters, tried = seen.inputs, seen.parameters, Tried.of(seen, nodes)
    if inputs.bolts is None or tried is None or not affordable(seen, 1.0 + 3.0 * nodes / (1.0 + inputs.model.terms.size)):
        return None
    shapes = bolt_shapes(parameters, inputs.bolts.xyz, inputs.statistics.values, inputs.statistics.bolts)
    columns = sorted(set(shapes.bolts.tolist()) - {-1})
    with suppress(LrbcError):
        solved = Solved.of(seen.few(FEWEST), tried.nodes[tried.spread])

        def best(states: list[Floats]) -> tuple[float, int, int, float]:
            found = list[tuple[float, int, int, float]]()
            for each, theta in enumerate(states):
                misfits = solved.misfits(theta)
                tries = ((k, share * tried.mass) for k in range(tried.spread.size) for share in shares)
                found.append(min((misfits("mass", (k,), size), each, k, size) for k, size in tries))
            return min(found)

        theta = parameters.initial
        left, _, at, size = best([theta])
        for _ in range(most):
            states = [np.clip(theta + level * shapes.T[:, own], *parameters.bounds.T) for own in columns for level in levels]
            now = best(states)
            if now[0] >= left:
                break
            (left, _, at, size), theta = now, states[now[1]]
        about = tried.about(tried.xyz[tried.spread[at]], nodes)
        sizes = [size * step for step in np.geomspace(1.0 / 3.0, 3.0, 5)]
        return best_added(seen.few(LINES), tried, about, [("mass", (k,), sizes) for k in range(about.size)], theta)
    return None
