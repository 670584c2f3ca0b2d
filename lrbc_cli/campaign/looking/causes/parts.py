"""Tests whether one part of an assembly has the material of another: its stiffness, its mass or both are wrong by a factor."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from lrbc_cli.arrays import Bools
from lrbc_cli.campaign.identification.compared.likeness import LEAST_DIFFERENCE, levels, spread
from lrbc_cli.campaign.looking.causes.rescaled import LINES, MOST_WORK, explains
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.reading.places import extents
from lrbc_cli.errors import LrbcError
from lrbc_cli.reduction.problem.full import full_ports

#: What of a part is multiplied, and what is then to be checked.
_WRONG = {
    "mass": ("mass", "density"),
    "stiffness": ("stiffness", "modulus"),
    "material": ("stiffness and mass", "material, or thickness,"),
}


def part_text(seen: Seen, before: float, *, ratio: float = 2.9) -> str:
    """Warning that names a part, of those that only springs join, with the material of another; empty if that explains no misfit.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit of the model, constants removed, median over the responses [dB].
    ratio : float
        Of the densities, and nearly of the moduli, of steel and aluminium.
    """
    parts = list(_parts(seen))
    cases = [(part, factor, kind) for part in parts for factor in (ratio, 1.0 / ratio) for kind in _WRONG]
    few, inputs = seen.few(LINES), seen.inputs
    if before <= LEAST_DIFFERENCE or not cases or len(cases) * seen.work(few.s.size) > MOST_WORK:
        return ""
    model, band, found = inputs.model, inputs.campaign.reduction.band, list[tuple[float, float, int]]()
    for number, (part, factor, kind) in enumerate(cases):
        scale = sp.diags_array(np.where(part, np.sqrt(factor), 1.0))
        K = model.K if kind == "mass" else sp.csc_array(scale @ model.K @ scale)
        M = model.M if kind == "stiffness" else sp.csc_array(scale @ model.M @ scale)
        with suppress(LrbcError):
            values = full_ports(replace(model, K=K, M=M), inputs.input_of, few.s, band, backend=inputs.campaign.reduction.backend)
            difference = levels(few.measured) - levels(values.evaluate(few.dynamic))
            found.append((float(np.median(spread(difference, 0))), float(np.nanmedian(difference)), number))
    if not found or not explains(*min(found)[:2], before, 1.5):
        return ""
    left, _, best = min(found)
    part, factor, kind = cases[best]
    what, check = _WRONG[kind]
    dofs = inputs.dofs
    where, size = "" if dofs is None else f" at {extents(dofs.xyz[part])}", "small" if factor > 1.0 else "large"
    return (
        f"the {what} of the part{where} {'are' if kind == 'material' else 'is'} probably about {ratio:g} times too {size}, as of aluminium "
        f"and steel exchanged: corrected, the level misfit falls from {before:.1f} to {left:.1f} dB (mean level of each response removed). "
        f"Check the {check} of this part in the FE model, and export it again"
    )


def _parts(seen: Seen, *, least: float = 0.02) -> Iterator[Bools]:
    """(n,) masks of the structural parts that only terms join, each with a share of ``least`` of the DOFs; nothing if there is one."""
    model = seen.inputs.model
    structural = ~model.is_acoustic
    labels = np.full(model.size, -1)
    labels[structural] = connected_components(abs(model.K[structural][:, structural]), directed=False)[1]
    sizes = np.bincount(labels[structural]) if structural.any() else np.zeros(0)
    large = np.flatnonzero(sizes >= least * structural.sum())
    if large.size > 1:
        yield from (labels == label for label in large)
