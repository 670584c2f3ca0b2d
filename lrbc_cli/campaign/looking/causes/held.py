"""Finds boundary conditions and ties that were left in the matrices and hold the structure in addition to the terms."""

from __future__ import annotations

import itertools
from collections import Counter
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, apart
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.campaign.looking.trials import FEWEST, NEARER, UNLIKE, affordable, gradually, ported, solved
from lrbc_cli.campaign.reading.doubts.springs import turned_about
from lrbc_cli.campaign.reading.places import extents
from lrbc_cli.errors import LrbcError, listing
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.model.fem import FeModel

#: Forces below this share of the sum of a row's magnitudes are rounding.
_ROUNDING = 1e-6

#: Largest number of nodes whose rotations are examined.
_MOST_NODES = 1000


def idle_text(seen: Seen, *, every: bool = False, least: float = 0.1) -> str:
    """Warning about groups of springs without effect, because parts are tied or nodes fixed in the matrices; else empty.

    Parameters
    ----------
    seen : Seen
    every : bool
        Only if no group has an effect: in a model that is near the measurement, one group alone may not matter.
    least : float
        Least change of the computed levels if all springs of a group are free [dB]. It was at least 2.9 dB on the samples and on virtual
        rigs, and 0.01 dB where the parts were tied.
    """
    parameters, idle, count = seen.parameters, list[str](), 0
    frf = seen.source.model(seen.s, parameters).frf
    for group, where, _ in parameters.placed:
        count += group.kind == "stiffness"
        free = parameters.initial.copy()
        free[where] = parameters.bounds[where, 0]
        if group.kind == "stiffness" and float(np.median(apart(frf(free), seen.model))) < least:
            idle.append(f"parameters.{group.name}")
    if not idle or (every and len(idle) < count):
        return ""
    return (
        f"the springs of {' and '.join(idle)} have no effect: without them the computed FRFs change by less than {least:g} dB. Something "
        "else in the matrices joins the same nodes (a tie, a contact, merged or fixed nodes). Remove it in the FE model, where the springs "
        "hold the structure instead, and export the matrices again"
    )


def tied_text(seen: Seen) -> str:
    """Warning that names nodes at one place that the matrices join beside the bolts, if the model is nearer without; else empty.

    ``seen``: the reference job, with the model as it is.
    """
    dofs, model, few = seen.inputs.dofs, seen.inputs.model, seen.few(FEWEST)
    pairs = np.zeros((0, 2), dtype=np.int64) if dofs is None else _coincident(model, dofs)
    if dofs is None or not pairs.size or not affordable(seen):
        return ""
    stiffness = _between(model, pairs)
    one, other = (sp.csc_array((np.ones(len(pairs)), (at, np.arange(len(pairs)))), (model.size, len(pairs))) for at in pairs.T)
    apart_there = one - other
    free = replace(model, K=sp.csc_array(model.K - apart_there @ sp.diags_array(stiffness) @ apart_there.T))
    with suppress(LrbcError):
        before = float(np.median(apart(few.measured, few.model)))
        left = float(np.median(apart(few.measured, ported(few, free).evaluate(few.dynamic))))
        if left <= NEARER * before:
            nodes = np.unique(np.sort(dofs.node[pairs], axis=1), axis=0)
            named = listing([f"{a} and {b}" for a, b in nodes.tolist()], 3)
            units = seen.inputs.campaign.unit_system
            return (
                f"beside the bolts the stiffness matrix joins {len(nodes)} pair{'s' if len(nodes) > 1 else ''} of nodes at one place "
                f"({named}; {extents(dofs.xyz[pairs.ravel()], units.length, units.length_name)}): without these joints the level misfit "
                f"falls from {before:.1f} to {left:.1f} dB (mean level of each response removed). Probably a tie or a contact was left "
                "active there. Remove it in the FE model, and export the matrices again"
            )
    return ""


def _coincident(model: FeModel, dofs: DofTable, *, near: float = 1e-6, least: float = 1e-9) -> Integers:
    """(k, 2) DOFs of the same component, of two nodes at one place, that the stiffness matrix joins.

    ``near``: share of the extent within which places are one; ``least``: smallest entry, as a share of those on the diagonal.
    """
    upper, diagonal = sp.triu(sp.csc_array(model.K.real), 1).tocoo(), np.abs(model.K.diagonal())
    row, col = upper.row, upper.col
    extent = float(np.ptp(dofs.xyz, axis=0).max()) or 1.0
    kept = (dofs.component[row] == dofs.component[col]) & np.isin(dofs.component[row], COMPONENTS) & (dofs.node[row] != dofs.node[col])
    kept &= (np.abs(dofs.xyz[row] - dofs.xyz[col]) <= near * extent).all(axis=1)
    kept &= upper.data < -least * np.sqrt(diagonal[row] * diagonal[col])
    found: Integers = np.stack([row[kept], col[kept]], axis=1).astype(np.int64)
    return found


def _between(model: FeModel, pairs: Integers) -> Floats | Complexes:
    """(k,) stiffness that joins pairs (k, 2) of DOFs."""
    return -np.asarray(model.K.tocsr()[pairs[:, 0], pairs[:, 1]]).ravel()


def held_text(seen: Seen, before: float, *, most: int = 8) -> str | None:
    """Warning that names nodes held to the ground, if the model without these supports explains the tight state; else None.

    Parameters
    ----------
    seen : Seen
    before : float
        Level misfit with the supports, constants removed, median over the responses [dB].
    most : int
        Largest number of held nodes up to which each is tried alone, as a foot that stands in the air.
    """
    dofs, model = seen.inputs.dofs, seen.inputs.model
    if dofs is None or model.is_acoustic.any():
        return None
    rows, beside = _held(model, dofs)
    nodes, joints, every = np.unique(dofs.node[rows]), np.unique(dofs.node[beside]), np.concatenate([rows, beside])
    alone = [rows[dofs.node[rows] == node] for node in nodes] if 1 < nodes.size <= most else []
    alone += [beside[dofs.node[beside] == node] for node in joints] if joints.size <= most else []
    # Supports may stand at nodes of bolts, all or some of them.
    cases = list({each.tobytes(): each for each in (rows, beside, every, *alone) if each.size}.values())
    if not cases or not affordable(seen, len(cases)):
        return None
    left, best = min((_without(seen, each, before), k) for k, each in enumerate(cases))
    if not np.isfinite(left):
        return _misstated_text(seen, every, before)
    at = np.unique(dofs.node[cases[best]])
    named = listing(at.tolist(), 6)
    components = ", ".join(label for label in COMPONENTS if np.any(dofs.component[cases[best]] == label))
    falls = f"the level misfit falls from {before:.1f} to {left:.1f} dB (mean level of each response removed)"
    if np.isin(cases[best], beside).all():
        of = f"nodes {named} of bolts" if at.size > 1 else f"node {named} of a bolt"
        return (
            f"the stiffness matrix holds {of} to the ground ({components}) in addition to the springs: without that {falls}. Probably a "
            "boundary condition was left in there, or a support is far too stiff. Remove it in the FE model, or give it the stiffness that "
            "it has on the test bench, and export the matrices again"
        )
    if at.size == 1 and nodes.size > 1:
        return (
            f"the stiffness matrix holds {nodes.size} nodes to the ground in addition to the terms ({listing(nodes.tolist(), 6)}). Without "
            f"the support of node {named} alone ({components}) {falls}: probably the structure was not held there in the measurement, as "
            "by a foot in the air. Support it on the test bench and measure again, or remove this support in the FE model"
        )
    return (
        f"the stiffness matrix holds {at.size} node{'s' if at.size > 1 else ''} to the ground in addition to the terms "
        f"({named}; {components}), probably by a boundary condition that was left in: without it {falls}. Remove it in the FE model, "
        "export the matrices again"
    )


def free_of_supports(seen: Seen) -> FeModel:
    """The model without its springs to the ground beside the terms: another material of a part leaves feet as they are."""
    model, dofs = seen.inputs.model, seen.inputs.dofs
    if dofs is None or model.is_acoustic.any():
        return model
    rows, _ = _held(model, dofs)
    return replace(model, K=sp.csc_array(model.K - sp.diags_array(_forces(model.K, dofs, rows)))) if rows.size else model


def supports_of(seen: Seen) -> tuple[Integers, Floats | Complexes]:
    """DOFs that the stiffness matrix holds to the ground in addition to the terms, and the stiffness of these supports.

    Both are empty without a DOF table, and for a model with air.
    """
    model, dofs = seen.inputs.model, seen.inputs.dofs
    if dofs is None or model.is_acoustic.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    rows = np.concatenate(_held(model, dofs))
    return rows, _forces(model.K, dofs, rows)[rows]


def _misstated_text(seen: Seen, rows: Integers, before: float, *, times: tuple[float, ...] = (0.1, 10.0, 1e-3, 1e3)) -> str | None:
    """Warning if the supports at ``rows``, all of them stiffer or softer by one of some factors, explain the tight state; else None."""
    dofs = seen.inputs.dofs
    assert dofs is not None
    if not affordable(seen, len(times)):
        return None
    left, factor = min((_without(seen, rows, before, left_over=factor), factor) for factor in times)
    if not np.isfinite(left):
        return None
    wrong = f"{1.0 / factor:g} times too stiff" if factor < 1.0 else f"{factor:g} times too soft"
    return (
        f"the supports of the model ({listing(np.unique(dofs.node[rows]).tolist(), 6)}) are probably {wrong}: corrected, the level misfit "
        f"falls from {before:.1f} to {left:.1f} dB (mean level of each response removed). Check the stiffness of feet or mounts, and its "
        "unit, in the FE model, and export the matrices again"
    )


def _without(seen: Seen, rows: Integers, before: float, *, left_over: float = 0.0) -> float:
    """Level misfit without the forces to the ground at ``rows`` [dB], but for a share ``left_over``; infinite if it does not explain it."""
    inputs, model = seen.inputs, seen.inputs.model
    assert inputs.dofs is not None
    dofs, left = inputs.dofs, np.inf
    # Stiffness-proportional damping also holds the nodes. Removing mass-proportional damping with it changes next to nothing.
    held = {name: sp.diags_array((1.0 - left_over) * _forces(A, dofs, rows)) for name, A in (("K", model.K), ("C", model.C))}
    free = {name: sp.csc_array(getattr(model, name) - own) for name, own in held.items()}
    for few, wider in gradually(seen):
        with suppress(LrbcError):
            ports = solved(
                few, replace(model, **free, extras={}), inputs.input_of, b"held" + rows.tobytes() + np.float64(left_over).tobytes()
            )
            left = float(np.median(apart(few.measured, ports.evaluate(few.dynamic))))
        # A model that is not calibrated leaves more than one that is.
        if left > wider * min(UNLIKE, CLEARLY * before):
            return np.inf
    return left


def supports_text(seen: Seen) -> str:
    """Clause that the model is held at nodes in addition to the terms, a possible cause of a misfit; empty if not, or if unknown."""
    inputs = seen.inputs
    dofs, model = inputs.dofs, inputs.model
    if dofs is None:
        return ""
    lacking = _lacking(dofs, inputs.campaign.unit_system.length)
    if model.is_acoustic.any():
        return lacking
    rows, beside = _held(model, dofs)
    nodes, first = np.unique(dofs.node[rows], return_index=True)
    tied = _tied_text(model, dofs)
    joints = np.unique(dofs.node[beside]).tolist()
    if 0 < len(joints) <= 2:
        named = " and ".join(f"node {node}" for node in joints)
        tied += f". At {named} of a bolt the model is held to the ground in addition to the springs"
    if not nodes.size:
        return f"{lacking}{tied}"
    xyz, unit = dofs.xyz[rows[first]], inputs.campaign.unit_system.length
    common = _common(xyz, np.ptp(dofs.xyz, axis=0), unit)
    alike = f", all at {', '.join(common)}" if common and nodes.size > 2 else ""
    named = listing(nodes.tolist(), 12)
    held = {node: tuple(dofs.component[rows[dofs.node[rows] == node]].tolist()) for node in nodes.tolist()}
    usual = Counter(held.values()).most_common(1)[0][0]
    odd = [f"node {node} in {', '.join(own)} alone" for node, own in held.items() if own != usual] if len(held) > 2 else []
    unlike = f"; unlike the others, {' and '.join(odd)}" if 0 < len(odd) <= 2 else ""
    return (
        f"{lacking}{tied}. The model is held to the ground in addition to the bolts (at or next to {nodes.size} "
        f"node{'s' if nodes.size > 1 else ''}{alike}: {named}{unlike}): check whether the structure on the test bench is held there, too, "
        "as stiffly, and nowhere else"
    )


def or_held(seen: Seen, lowered: str) -> str:
    """The text on joints that a calibration lowers, with supports of the model, if any: softer joints make up for wrong ones."""
    held = supports_text(seen) if lowered else ""
    return lowered + (f"{held}. What the test bench does not have is to be removed in the FE model" if held else "")


def _lacking(dofs: DofTable, unit: float, *, most: int = 4, share: float = 0.25) -> str:
    """Clause that names nodes without some of the components that all others have, fixed at the export; else empty.

    Parameters
    ----------
    dofs : DofTable
    unit : float
        Of coordinates in the campaign file [m].
    most, share : int, float
        Largest number of such nodes; of nodes with one coordinate in common (an edge, a plane), largest share of all.
    """
    sets: dict[int, frozenset[str]] = {}
    for node, component in zip(*(column[~dofs.is_acoustic].tolist() for column in (dofs.node, dofs.component)), strict=True):
        sets[node] = sets.get(node, frozenset()) | {component}
    if not sets:
        return ""
    usual, count = Counter(sets.values()).most_common(1)[0]
    odd = {node: sorted(usual - own) for node, own in sets.items() if own < usual}
    if not odd or len(odd) + count < len(sets):
        return ""
    left_in = "check whether a boundary condition was left in there"
    if len(odd) <= most:
        named = ", ".join(f"node {node} has no {', '.join(own)}" for node, own in odd.items())
        return f". Alone of all nodes, {named}: {left_in}"
    common = _common(dofs.xyz[np.isin(dofs.node, list(odd)) & ~dofs.is_acoustic], np.ptp(dofs.xyz, axis=0), unit)
    # Nodes of solid elements beside shells have no rotations.
    solid = all(set(own) == {label for label in usual if label.startswith("ROT")} for own in odd.values())
    if not common or solid or len(odd) > share * len(sets):
        return ""
    components = ", ".join(sorted({label for own in odd.values() for label in own}))
    return f". Alone of all nodes, {len(odd)} at {', '.join(common)} have no {components}: {left_in}, or a condition of symmetry"


def _common(xyz: Floats, spans: Floats, unit: float) -> list[str]:
    """Coordinates that all of some places (n, 3) have in common, of those along which the model extends (``spans``), in words."""
    least = 1e-6 * float(spans.max())
    middle = np.where(np.abs(xyz).max(axis=0) < least, 0.0, xyz[0])
    return [f"{'xyz'[k]} = {middle[k] / unit:.4g}" for k in range(3) if np.ptp(xyz[:, k]) < least < spans[k]]


def _tied_text(model: FeModel, dofs: DofTable) -> str:
    """Clause that nodes at the same place are coupled without being ends of a term, as by a tie or a contact left in; else empty."""
    ends = model.terms.left.tocsc()
    own = {frozenset(dofs.node[ends.indices[a:b]].tolist()) for a, b in itertools.pairwise(ends.indptr.tolist())}
    rows = _coincident(model, dofs)
    rows = rows[np.isin(dofs.component[rows[:, 0]], COMPONENTS[:3])]
    if not rows.size:
        return ""
    found = dict[tuple[int, int], float]()
    for (one, other), size in zip(np.sort(dofs.node[rows], axis=1).tolist(), _between(model, rows).real.tolist(), strict=True):
        if frozenset((one, other)) not in own:
            found[one, other] = max(found.get((one, other), 0.0), size)
    if not found:
        return ""
    named = listing([f"{one} and {other}" for one, other in found], 4)
    return (
        f". Besides the bolts, nodes at the same place are coupled in the model by up to {max(found.values()):.2g} N/m "
        f"(pairs: {len(found)}, nodes {named}): check whether a tie or a contact was left in there"
    )


def _held(model: FeModel, dofs: DofTable, *, left_over: float = 1e-2) -> tuple[Integers, Integers]:
    """Rows at which a rigid translation, or a rigid rotation about the row's node, causes a force: others than those of terms, and these.

    ``left_over``: least force at a term to the ground, from which springs that the matrices held were subtracted, as a share of the row's
    magnitudes.
    """
    K, vectors = model.K, model.terms.left
    size, moving = np.abs(K) @ np.ones(dofs.size), np.isin(dofs.component, COMPONENTS[:3])
    # What joins two nodes moves with both.
    net = np.max([np.abs((dofs.component == label) @ vectors) for label in COMPONENTS[:3]], axis=0)
    grounded = np.flatnonzero(net > _ROUNDING * np.ravel(np.abs(vectors).max(axis=0).toarray()))
    least = np.full(dofs.size, _ROUNDING)
    least[np.unique(vectors[:, grounded].indices)] = left_over

    def held(rows: Integers) -> Integers:
        found: Integers = rows[_forces(K, dofs, rows).real[rows] > least[rows] * size[rows]]
        return found

    found = held(np.flatnonzero(moving))
    nodes = np.unique(dofs.node[found])[:_MOST_NODES]
    turned = held(np.flatnonzero(np.isin(dofs.component, COMPONENTS[3:]) & np.isin(dofs.node, nodes)))
    every = np.concatenate([found, turned])
    of_terms = np.isin(every, vectors.indices)
    return every[~of_terms], every[of_terms]


def _forces(A: sp.csc_array, dofs: DofTable, rows: Integers) -> Floats | Complexes:
    """(n,) force at each of ``rows`` under a rigid translation along its component, or a rotation about its node; zero elsewhere."""
    found = np.zeros(dofs.size, dtype=A.dtype)
    for label in COMPONENTS[:3]:
        own = rows[dofs.component[rows] == label]
        found[own] = (A @ (dofs.component == label).astype(float))[own]
    for row in rows[np.isin(dofs.component[rows], COMPONENTS[3:])].tolist():
        found[row] = (A[[row]] @ turned_about(dofs, row))[0]
    return found
