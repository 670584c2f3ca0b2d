"""What holds the structure in addition to the terms: boundary conditions and ties that were left in the matrices."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, apart, levels, spread
from lrbc_cli.campaign.looking.moved import LINES
from lrbc_cli.campaign.looking.rescaled import MOST_LEFT, MOST_WORK
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.reading.doubts.springs import turned_about
from lrbc_cli.campaign.reduced.memory import reduction_cost
from lrbc_cli.errors import LrbcError
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.reduction.problem.full import full_ports

#: Forces below this share of a row's entries are rounding.
_ROUNDING = 1e-6

#: Nodes whose rotations are looked at.
_MOST_NODES = 1000


def idle_text(seen: Seen, *, least: float = 0.1) -> str:
    """Which groups of springs have no effect, as where the parts are tied or the nodes fixed in the matrices; empty where all have some.

    Parameters
    ----------
    seen : Seen
    least : float
        Change of the computed levels with all springs of a group free, below which it has none [dB]. 2.9 dB and more on the samples and on
        virtual rigs, 0.01 dB where the parts were tied.
    """
    parameters, idle = seen.parameters, list[str]()
    frf = seen.source.model(seen.s, parameters).frf
    for group, where, _ in parameters.placed:
        free = parameters.initial.copy()
        free[where] = parameters.bounds[where, 0]
        if group.kind == "stiffness" and float(np.median(apart(frf(free), seen.model))) < least:
            idle.append(f"parameters.{group.name}")
    if not idle:
        return ""
    return (
        f"the springs of {' and '.join(idle)} have no effect: without them the computed FRFs change by less than {least:g} dB. Something "
        "else in the matrices joins the same nodes (a tie, a contact, merged or fixed nodes). Remove it in the FE model, where the springs "
        "hold the structure instead, and export the matrices again"
    )


def held_text(seen: Seen, before: float) -> str | None:
    """Which nodes are held where the model without that explains the tight state, and what to do; None where it does not.

    Parameters
    ----------
    seen : Seen
    before : float
        How far levels are apart as it is, constants taken out, in the median over the responses [dB].
    """
    inputs, dofs, model = seen.inputs, seen.inputs.dofs, seen.inputs.model
    if dofs is None or model.is_acoustic.any() or reduction_cost(inputs)[0].line * LINES > MOST_WORK:
        return None
    rows = _held(model.K, dofs, np.unique(model.terms.left.indices))
    if not rows.size:
        return None
    few = seen.few(LINES)
    # A damping that follows the stiffness holds the nodes, too; of one that follows the mass next to nothing is lost with it.
    free = {name: (A - sp.diags_array(_forces(A, dofs, rows), format="csc")).tocsc() for name, A in (("K", model.K), ("C", model.C))}
    with suppress(LrbcError):
        ports = full_ports(replace(model, **free, extras={}), inputs.input_of, few.s, inputs.campaign.reduction.band)
        left = float(np.median(spread(levels(few.measured) - levels(ports.evaluate(few.dynamic)), 0)))
        if left <= min(MOST_LEFT, CLEARLY * before):
            nodes = np.unique(dofs.node[rows])
            named = ", ".join(str(node) for node in nodes[:6].tolist()) + (" ..." if nodes.size > 6 else "")
            components = ", ".join(label for label in COMPONENTS if np.any(dofs.component[rows] == label))
            return (
                f"the stiffness matrix holds {nodes.size} node{'s' if nodes.size > 1 else ''} to the ground in addition to the terms "
                f"({named}; {components}), probably by a boundary condition that was left in: without it the level misfit falls from "
                f"{before:.1f} to {left:.1f} dB (mean level of each response removed). Remove it in the FE model, export the matrices again"
            )
    return None


def supports_text(seen: Seen) -> str:
    """That the model holds nodes beside the terms, as a cause of what is unlike; empty where it holds none, or that cannot be told."""
    inputs = seen.inputs
    dofs, model = inputs.dofs, inputs.model
    if dofs is None or model.is_acoustic.any():
        return ""
    rows = _held(model.K, dofs, np.unique(model.terms.left.indices))
    nodes, first = np.unique(dofs.node[rows], return_index=True)
    if not nodes.size:
        return ""
    xyz, unit = dofs.xyz[rows[first]], inputs.campaign.unit_system.length
    spans, own = np.ptp(dofs.xyz, axis=0), np.ptp(xyz, axis=0)
    common = [f"{'xyz'[k]} = {xyz[0, k] / unit:.4g}" for k in range(3) if own[k] < 1e-6 * spans.max() < spans[k]]
    alike = f", all at {', '.join(common)}" if common and nodes.size > 2 else ""
    named = ", ".join(str(node) for node in nodes[:4].tolist()) + (" ..." if nodes.size > 4 else "")
    return (
        f". The model is held to the ground in addition to the bolts (at or next to {nodes.size} node{'s' if nodes.size > 1 else ''}"
        f"{alike}: {named}): check whether the structure on the test bench is held there, too"
    )


def _held(K: sp.csc_array, dofs: DofTable, terms: Integers) -> Integers:
    """Rows of no term at which a rigid translation, or a rotation about the own node, meets forces."""
    size = np.abs(K) @ np.ones(dofs.size)
    translations = np.setdiff1d(np.flatnonzero(np.isin(dofs.component, COMPONENTS[:3])), terms)
    held = translations[_forces(K, dofs, translations).real[translations] > _ROUNDING * size[translations]]
    nodes = np.unique(dofs.node[held])[:_MOST_NODES]
    rotations = np.setdiff1d(np.flatnonzero(np.isin(dofs.component, COMPONENTS[3:]) & np.isin(dofs.node, nodes)), terms)
    turned = rotations[_forces(K, dofs, rotations).real[rotations] > _ROUNDING * size[rotations]]
    found: Integers = np.concatenate([held, turned])
    return found


def _forces(A: sp.csc_array, dofs: DofTable, rows: Integers) -> Floats | Complexes:
    """(n,) forces that meet a rigid translation along the component of each row, or a rotation about its node; zero at other rows."""
    found = np.zeros(dofs.size, dtype=A.dtype)
    for label in COMPONENTS[:3]:
        own = rows[dofs.component[rows] == label]
        found[own] = (A @ (dofs.component == label).astype(float))[own]
    for row in rows[np.isin(dofs.component[rows], COMPONENTS[3:])].tolist():
        found[row] = (A[[row]] @ turned_about(dofs, row))[0]
    return found
