"""Tests whether the springs of a joint are at another place in the model than on the structure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.compared.likeness import CLEARLY, apart
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.fitted import calibrated_by_rounds
from lrbc_cli.campaign.looking.states import Looking, Seen, coarsely_reduced
from lrbc_cli.campaign.looking.trials import EXPLAINED, FEWEST, LINES, MOST_WORK, NEARER, Cause, affordable, at_values, with_ports
from lrbc_cli.campaign.reading.factors import recipe_of
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reading.reach import parts_of
from lrbc_cli.campaign.reduced.memory import reduction_cost
from lrbc_cli.campaign.structure import thinned
from lrbc_cli.errors import LrbcError
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.reduction.problem.full import full_frfs


@dataclass(frozen=True, kw_only=True)
class _Joint:
    """Springs of a bolt: their terms, and for each entry of their vectors its term, its DOF and its value.

    Attributes
    ----------
    bolt : int
    terms : (k,) int array
    term, dof : (e,) int arrays
        ``term`` counts within ``terms``.
    value : (e,) float array
    """

    bolt: int
    terms: Integers
    term: Integers
    dof: Integers
    value: Floats


@dataclass(frozen=True)
class _Elsewhere:
    """A joint elsewhere: the DOFs of its entries there, and the level misfit with it there [dB]."""

    joint: _Joint
    dof: Integers
    left: float = np.inf


def displaced_cause(seen: Seen, whole: Measurement, calibrated: float, *, most: int = 60, kept: int = 3, rounds: int = 2) -> Cause:
    """A joint whose springs are probably at another place; no words if that explains nothing.

    The model as exported is compared with each joint at other places in turn, first all over its part, then about the best of these. The
    rest of the model errs, too, so the nearest of some joints are calibrated: a place counts if that leaves less than half of what a
    calibration without it leaves, and clearly less than any other joint does.

    Parameters
    ----------
    seen : Seen
        The reference job, with the model as it is.
    whole : Measurement
        The same on all its lines.
    calibrated : float
        Level misfit after a rough calibration [dB].
    most : int
        Largest number of places of a joint that are tried at a time.
    kept : int
        Number of joints that are calibrated, each at its best place.
    rounds : int
        Of each calibration.
    """
    source, settings, dofs = seen.source, seen.inputs.campaign.calibration, seen.inputs.dofs
    joints = [] if dofs is None else list(_joints(seen.inputs))
    free = settings is not None and settings.job == seen.job and not seen.inputs.model.extras and source.stage is not None
    if not free or dofs is None or not joints or reduction_cost(seen.inputs)[0].work > MOST_WORK:
        return Cause()
    few, label = seen.few(FEWEST), parts_of(seen.inputs.model, joined=False)
    with suppress(LrbcError):
        tried = [place for joint in joints for place in _elsewhere(dofs, label, joint, most)]
        for _ in range(2):
            found = _compared(few, tried)
            nearest = sorted({place.joint.bolt: place for place in reversed(found)}.values(), key=lambda place: place.left)[:kept]
            tried = [other for place in nearest for other in _elsewhere(dofs, label, place.joint, most // kept, about=place)]
        left = sorted((_calibrated_with(seen, whole, place, rounds), k) for k, place in enumerate(nearest))
        others = min((one for one, _ in left[1:]), default=np.inf)
        if left and left[0][0] <= min(EXPLAINED, CLEARLY * calibrated, NEARER * others):
            return Cause(_text(seen, nearest[left[0][1]], left[0][0], calibrated), left[0][0])
    return Cause()


def _joints(inputs: Inputs) -> Iterator[_Joint]:
    """The bolts with springs; vectors that are not the same on both sides are no springs."""
    terms, owner = inputs.model.terms, np.full(inputs.model.terms.size, -1)
    for group in inputs.groups:
        if group.bolt is not None and group.config.kind == "stiffness":
            owner[group.terms] = group.bolt[group.parameter]
    ends = terms.left.tocsc()
    for bolt in np.unique(owner[owner >= 0]).tolist() if terms.symmetric else ():
        own = np.flatnonzero(owner == bolt)
        part = ends[:, own].tocoo()
        yield _Joint(bolt=bolt, terms=own, term=part.col.astype(int), dof=part.row.astype(int), value=np.real(part.data))


def _elsewhere(dofs: DofTable, label: Integers, joint: _Joint, most: int, *, about: _Elsewhere | None = None) -> Iterator[_Elsewhere]:
    """A joint moved so that its first node comes to lie at others of its part, spread over it, or nearest to the place ``about``.

    Its further nodes move by as much, each to the nearest node of its own part.
    """
    at = {key: row for row, key in enumerate(zip(dofs.node.tolist(), dofs.component.tolist(), strict=True))}
    first, component = joint.dof[0], dofs.component[joint.dof[0]]
    rows = np.flatnonzero((label == label[first]) & (dofs.component == component))
    rows = rows[rows != first]
    if about is None:
        rows = rows[thinned(dofs.xyz[rows], most)[1]] if rows.size > most else rows
    else:
        rows = rows[np.argsort(np.linalg.norm(dofs.xyz[rows] - dofs.xyz[about.dof[0]], axis=1), kind="stable")[:most]]
    there = {part: np.flatnonzero((label == part) & (dofs.component == component)) for part in np.unique(label[joint.dof]).tolist()}
    for row in rows.tolist():
        found = list[int | None]()
        for dof in joint.dof.tolist():
            near = there[int(label[dof])]
            if not near.size:
                break
            away = np.linalg.norm(dofs.xyz[near] - (dofs.xyz[dof] + dofs.xyz[row] - dofs.xyz[first]), axis=1)
            found.append(at.get((int(dofs.node[near[np.argmin(away)]]), str(dofs.component[dof]))))
        if len(found) == joint.dof.size and None not in found:
            yield _Elsewhere(joint, np.array(found, dtype=int))


def _compared(seen: Seen, places: Sequence[_Elsewhere], *, most_ports: int = 800) -> list[_Elsewhere]:
    """The places with their level misfits, nearest first, by one full solve a line; empty if there are none or if that takes too long.

    Raises
    ------
    LrbcError
        If the model cannot be solved.
    """
    if not places:
        return []
    inputs, settings = seen.inputs, seen.inputs.campaign.reduction
    model, every = inputs.model, np.unique(np.concatenate([place.dof for place in places]))
    if every.size + model.terms.size > most_ports or not affordable(seen, FEWEST / LINES * (1.0 + every.size / (1.0 + model.terms.size))):
        return []
    H, D_ref = full_frfs(with_ports(model, every), seen.s, settings.band, backend=settings.backend, refine=0)
    loads, outputs, terms = model.B.shape[1], model.L.shape[0], model.terms
    quantity, each, without = seen.s[:, None] ** model.output_power, np.arange(outputs), dict[int, Complexes]()

    def moved(place: _Elsewhere) -> float:
        joint = place.joint
        if joint.bolt not in without:
            D = seen.dynamic.copy()
            D[:, joint.terms] = -terms.baseline[joint.terms]
            without[joint.bolt] = at_values(H, D - D_ref)
        G, springs = without[joint.bolt], (seen.dynamic + terms.baseline)[:, joint.terms]
        V = np.zeros((every.size, joint.terms.size))
        np.add.at(V, (np.searchsorted(every, place.dof), joint.term), joint.value)
        used = np.flatnonzero(V.any(axis=1))
        V = V[used]
        felt = V.T @ G[:, outputs + used]
        flexible = np.eye(joint.terms.size) / springs[:, :, None] + felt[:, :, loads + used] @ V
        force = np.linalg.solve(flexible, felt[:, :, :loads])[:, :, inputs.input_of]
        values = G[:, each, inputs.input_of] - np.einsum("frc,fcr->fr", G[:, :outputs][:, :, loads + used] @ V, force)
        return float(np.median(apart(seen.measured, values * quantity)))

    return sorted((replace(place, left=moved(place)) for place in places), key=lambda place: place.left)


def _calibrated_with(seen: Seen, whole: Measurement, place: _Elsewhere, rounds: int) -> float:
    """Level misfit after rough calibrations of the model with a joint elsewhere [dB]."""
    source, inputs, settings = seen.source, seen.inputs, seen.inputs.campaign.calibration
    assert source.stage is not None
    assert settings is not None
    moved = _moved(inputs, place)
    beside = Looking(inputs=moved, stage=replace(source.stage, reduction=coarsely_reduced(moved)), kind="port")
    found, _ = calibrated_by_rounds(beside, whole, settings.names, rounds)
    return Seen.of_model(found, seen.job, whole).misfit


def _moved(inputs: Inputs, place: _Elsewhere) -> Inputs:
    """The model with the springs of a joint elsewhere; what its matrix holds of them goes with them."""
    terms, joint = inputs.model.terms, place.joint
    kept = np.ones(terms.size)
    kept[joint.terms] = 0.0
    own = sp.csc_array((joint.value, (place.dof, joint.terms[joint.term])), shape=terms.left.shape)
    left, held = sp.csc_array(terms.left @ sp.diags_array(kept) + own), sp.diags_array(terms.baseline)
    K = sp.csc_array(inputs.model.K + left @ held @ left.T - terms.left @ held @ terms.left.T)
    model = replace(inputs.model, K=K, terms=replace(terms, left=left, right=left))
    return replace(inputs, model=model, recipe=recipe_of(inputs.campaign, model))


def _text(seen: Seen, place: _Elsewhere, left: float, calibrated: float) -> str:
    """Warning about a joint, with the misfits with and without its springs elsewhere [dB]."""
    inputs, units = seen.inputs, seen.inputs.campaign.unit_system
    assert inputs.dofs is not None
    assert inputs.bolts is not None
    stated, there = place.joint.dof[0], place.dof[0]
    xyz = ", ".join(f"{value:.4g}" for value in inputs.dofs.xyz[there] / units.length)
    away, unit = float(np.linalg.norm(inputs.dofs.xyz[there] - inputs.dofs.xyz[stated])) / units.length, units.length_name
    files = dict.fromkeys(file.name for group in inputs.groups if (file := group.config.select.bushings) is not None)
    return (
        f"the springs of {inputs.bolts.name[place.joint.bolt]} are probably at a wrong place in the model: with them at or near node "
        f"{inputs.dofs.node[there]} at ({xyz}) {unit}, {away:.3g} {unit} from node {inputs.dofs.node[stated]}, a rough calibration leaves "
        f"a level misfit of {left:.1f} dB, without that {calibrated:.1f} dB (mean level of each response removed). Check on the structure "
        f"where this bolt is, and the nodes of its springs in {' and '.join(files) or 'the parameters'} and in the FE model"
    )
