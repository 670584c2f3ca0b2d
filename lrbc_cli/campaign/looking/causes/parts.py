"""Tests whether one part of an assembly has the material of another, or the model holds a mass that the structure does not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Bools
from lrbc_cli.campaign.identification.compared.likeness import LEAST_DIFFERENCE
from lrbc_cli.campaign.looking.causes.rescaled import explains
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import FEWEST, MOST_WORK, UNLIKE, left_of, ported, resonances
from lrbc_cli.campaign.reading.places import extents
from lrbc_cli.campaign.reading.reach import parts_of
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.model.fem import FeModel

#: What of a part is multiplied, and what is then to be checked.
_WRONG = {
    "mass": ("mass", "density"),
    "stiffness": ("stiffness", "modulus"),
    "material": ("stiffness and mass", "material, or thickness,"),
}


def part_text(seen: Seen, before: float, *, ratio: float = 2.9, moduli: float = 3.0) -> str:
    """Warning that names a part, of those that only springs join, or a structure beside air, with the material of another; else empty.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit of the model, constants removed, median over the responses [dB].
    ratio, moduli : float
        Of the densities (7850 and 2700 kg/m3), and of the moduli (210 and 70 GPa), of steel and aluminium.
    """
    cases = [(part, factor, kind) for part in _parts(seen) for factor in (ratio, 1.0 / ratio) for kind in _WRONG]
    if not cases and seen.inputs.model.is_acoustic.any() and before > UNLIKE:
        # One structure beside air, whose mass is right: large models, so one case only. More resonances than computed: it is too light.
        more = resonances(seen.measured) >= resonances(seen.model)
        cases = [(~seen.inputs.model.is_acoustic, ratio if more else 1.0 / ratio, "mass")]
    few, inputs = seen.few(FEWEST), seen.inputs
    if before <= LEAST_DIFFERENCE or not cases or len(cases) * seen.work(few.s.size) > MOST_WORK:
        return ""
    model, found = inputs.model, list[tuple[float, float, int]]()
    for number, (part, factor, kind) in enumerate(cases):
        # The coupling of structure and air stays.
        own, stiff = sp.diags_array(part.astype(float)), moduli if factor > 1.0 else 1.0 / moduli
        K = model.K if kind == "mass" else sp.csc_array(model.K + (stiff - 1.0) * (own @ model.K @ own))
        M = model.M if kind == "stiffness" else sp.csc_array(model.M + (factor - 1.0) * (own @ model.M @ own))
        with suppress(LrbcError):
            found.append((*_misfit(few, replace(model, K=K, M=M)), number))
    if not found or not explains(*min(found)[:2], before, 1.5):
        return ""
    left, _, best = min(found)
    part, factor, kind = cases[best]
    what, check = _WRONG[kind]
    dofs = inputs.dofs
    where = "structure" if len(cases) == 1 else "part" if dofs is None else f"part at {extents(dofs.xyz[part])}"
    size = "small" if factor > 1.0 else "large"
    return (
        f"the {what} of the {where} {'are' if kind == 'material' else 'is'} probably about {ratio:g} times too {size}, as of aluminium and "
        f"steel exchanged: corrected, the level misfit falls from {before:.1f} to {left:.1f} dB (mean level of each response removed). "
        f"Check the {check} there in the FE model, and export it again"
    )


def lump_text(seen: Seen, before: float, *, times: float = 20.0, most: int = 8) -> str:
    """Warning that names masses at single nodes without which the model explains a measurement; empty if there are none.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit of the model, constants removed, median over the responses [dB].
    times : float
        Least ratio of such a mass to the median of the nodes. On right models the largest ratio was 2.8.
    most : int
        Largest number of such nodes.
    """
    inputs, model, few = seen.inputs, seen.inputs.model, seen.few(FEWEST)
    if inputs.dofs is None or before <= LEAST_DIFFERENCE or seen.work(few.s.size) > MOST_WORK:
        return ""
    diagonal = np.where(np.char.startswith(inputs.dofs.component.astype(str), "U"), np.real(model.M.diagonal()), 0.0)
    typical = float(np.median(diagonal[diagonal > 0.0])) if (diagonal > 0.0).any() else np.inf
    excess = np.where(diagonal > times * typical, diagonal - typical, 0.0)
    nodes = np.unique(inputs.dofs.node[excess > 0.0])
    if not 0 < nodes.size <= most:
        return ""
    with suppress(LrbcError):
        left, off = _misfit(few, replace(model, M=sp.csc_array(model.M - sp.diags_array(excess))))
        if explains(left, off, before, 1.5):
            held = listing([f"{excess[inputs.dofs.node == node].max():.3g} kg at node {node}" for node in nodes], 4)
            return (
                f"the mass matrix holds {held} in addition to the mass of the structure; without it the level misfit falls from "
                f"{before:.1f} to {left:.1f} dB (mean level of each response removed). Check whether that mass was on the test bench; if "
                "not, remove it in the FE model, and export it again"
            )
    return ""


def _misfit(seen: Seen, model: FeModel) -> tuple[float, float]:
    """See ``left_of``, for another model."""
    return left_of(seen, ported(seen, model).evaluate(seen.dynamic))


def _parts(seen: Seen, *, least: float = 0.02) -> Iterator[Bools]:
    """(n,) masks of the structural parts that only terms join, each with a share of ``least`` of the DOFs; nothing if there is one."""
    model = seen.inputs.model
    structural = ~model.is_acoustic
    # Air joins parts, too; without it, each of its DOFs is a part of its own.
    own = sp.diags_array(structural.astype(float))
    alone = {name: sp.csc_array(own @ getattr(model, name) @ own) for name in ("K", "C", "M")}
    labels = parts_of(replace(model, **alone), joined=False)
    large = np.flatnonzero(np.bincount(labels[structural], minlength=1) >= max(least * structural.sum(), 1.0))
    if large.size > 1:
        yield from (labels == label for label in large)
