"""From the campaign file to ``Inputs``: full-order model, parameter groups, responses and bolts, with notes and warnings on all files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.protect import require_inputs_apart
from lrbc_cli.campaign.reading.dof_source import added_nodes, numbering, unfitting
from lrbc_cli.campaign.reading.doubts.chosen import require_apart, require_own
from lrbc_cli.campaign.reading.doubts.mesh import mesh_doubts
from lrbc_cli.campaign.reading.doubts.names import odd_springs
from lrbc_cli.campaign.reading.doubts.numbering import require_whole
from lrbc_cli.campaign.reading.doubts.points import beside_nodes, exchanged_axes, exchanged_text, require_unit, shared_places
from lrbc_cli.campaign.reading.doubts.rigid import components_doubt
from lrbc_cli.campaign.reading.doubts.settings import guesses
from lrbc_cli.campaign.reading.doubts.springs import held_springs
from lrbc_cli.campaign.reading.drift import check_drift, load_shift
from lrbc_cli.campaign.reading.edges import by_edges
from lrbc_cli.campaign.reading.factors import (
    CalibrationUse,
    factor_groups,
    left_behind,
    recipe_of,
    with_loss,
    with_proportional,
    without_springs,
)
from lrbc_cli.campaign.reading.groups import GroupReader, TermGroup, Terms
from lrbc_cli.campaign.reading.model_doubts import doubts, fixed_dofs, require_mass, require_roles, slips
from lrbc_cli.campaign.reading.places import components_place, extents
from lrbc_cli.campaign.reading.reach import require_frequencies, require_reach
from lrbc_cli.campaign.reading.reader import Parts, Point
from lrbc_cli.config import Campaign
from lrbc_cli.config.structure import FieldDamping, ProportionalDamping, ResponseConfig
from lrbc_cli.errors import DataError
from lrbc_cli.io.hdf5.tools import came_through
from lrbc_cli.method.resolve import Facts, Method, resolve
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, DofTable, PointTable
from lrbc_cli.model.factors import Recipe
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.frf import QUANTITIES
from lrbc_cli.model.selection import unit_columns
from lrbc_cli.model.shifts import shift_columns
from lrbc_cli.model.terms import LowRankTerms
from lrbc_cli.results.store import read_before
from lrbc_cli.updating.statistics.model import StatisticalModel

UNITS = {"pressure": "Pa", "displacement": "m", "velocity": "m/s", "acceleration": "m/s²"}


@dataclass(frozen=True, kw_only=True)
class Response:
    """One response of the campaign.

    Attributes
    ----------
    name, quantity, own_unit : str
        Name, quantity and its unit.
    input : int
        Index of its excitation.
    node, direction : int or None
        Node of the model and direction as in universal files, by which records are matched; None if unknown.
    text : str
        Its place in words.
    """

    name: str
    quantity: str
    own_unit: str
    input: int
    node: int | None
    direction: int | None
    text: str

    @property
    def unit(self) -> str:
        """Unit of its FRF."""
        return f"{self.own_unit}/N"


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Everything that a campaign reads except the measured FRFs.

    Attributes
    ----------
    campaign : Campaign
    model : FeModel
    dofs : DofTable or None
    responses : tuple of Response
    excitations : tuple of str
    excitation_points : tuple
        Node and direction of each excitation, None if unknown.
    groups : tuple of TermGroup
    bolts : PointTable or None
    notes : tuple of str
        Printed by ``lrbc check``.
    warnings : tuple of str
    units_doubt : str or None
        The warning that guesses wrong units from the mesh alone.
    places_doubt, springs_doubt : bool
        Whether hammer and sensors seem to be given from another origin or in another numbering; springs, far from their bolts.
    odd_bolts : frozenset of str
        Bolts with springs a power of ten beside those of the others.
    held_doubt : bool
        Whether the springs seem to be in the stiffness matrix as exported otherwise than stated: in another unit, without their baseline,
        or less than it. ``model`` is without the baselines.
    hashes : dict
        SHA-256 of every file that was read, by its absolute path.
    recipe : Recipe
        How the operators of ``model`` depend on global factors; factors of 1 give the operators as they are.
    shifts : (n_in, 2) int array or None
        Columns of the loads that are derivatives with respect to offsets of each hammer along the surface; None without
        ``nuisances.hammer``.
    calibration : CalibrationUse or None
        Whether ``model`` contains the factors of a stored calibration; None if as exported, or if the campaign has none.
    read_with : str
        See ``digests.surroundings``; empty if a stored calibration was not looked for.
    by_hand : mapping
        Fields of ``Method`` that are set from Python, for experiments.
    """

    campaign: Campaign
    model: FeModel
    dofs: DofTable | None
    responses: tuple[Response, ...]
    excitations: tuple[str, ...]
    excitation_points: tuple[Point, ...]
    groups: tuple[TermGroup, ...]
    bolts: PointTable | None
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    hashes: dict[str, str] = field(repr=False)
    recipe: Recipe = field(repr=False)
    units_doubt: str | None = None
    places_doubt: bool = False
    springs_doubt: bool = False
    odd_bolts: frozenset[str] = frozenset()
    held_doubt: bool = False
    shifts: NDArray[np.int64] | None = None
    calibration: CalibrationUse | None = None
    read_with: str = ""
    by_hand: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def method(self) -> Method:
        """Method of identification that results from the settings, for `check`, `plan` and `update` alike."""
        return self.resolved(self.campaign.update.reference is not None)

    def resolved(self, reference: bool) -> Method:
        """Method of identification with or without a reference job; a plan assumes one."""
        return replace(
            resolve(self.campaign.update, Facts(reference, self.bolts is not None, any(group.bolt is not None for group in self.groups))),
            **self.by_hand,
        )

    @property
    def statistics(self) -> StatisticalModel:
        """Statistical model of the method."""
        return self.method.statistics

    @property
    def input_of(self) -> NDArray[np.int64]:
        """(R,) index of the excitation of each response."""
        return np.array([response.input for response in self.responses], dtype=np.int64)

    @property
    def addresses(self) -> list[tuple[object, ...]]:
        """Quantity of each response and what its record is found by: its name, node and direction, and those of its excitation."""
        struck = list(zip(self.excitations, self.excitation_points, strict=True))
        return [(r.name, r.quantity, r.node, r.direction, name, *point) for r in self.responses for name, point in [struck[r.input]]]

    @property
    def used(self) -> NDArray[np.int64]:
        """Indices of the responses that enter the cost."""
        names = self.method.responses
        return np.array([i for i, r in enumerate(self.responses) if names is None or r.name in names], dtype=np.int64)

    @property
    def validation(self) -> NDArray[np.int64]:
        """Indices of the validation channels: all other responses."""
        return np.setdiff1d(np.arange(len(self.responses)), self.used)


class _Reader(GroupReader):
    """Reads loads and outputs, each from its section of the campaign file."""

    shifts: NDArray[np.int64] | None = None

    def loads(self) -> tuple[sp.csc_array, list[Point]]:
        columns: list[sp.csc_array] = []
        points: list[Point] = []
        shifts: list[Floats] = []
        moving = self.campaign.update.nuisances.hammer is not None
        for name, point in self.campaign.excitation.items():
            if point.vector is not None:
                matrix = self.vectors(point.vector, f"excitation.{name}")
                if matrix.shape[1] != 1 or matrix.nnz == 0:
                    raise DataError(
                        "an excitation must be one vector that is not zero",
                        file=point.vector.path,
                        expected="one column",
                        found=f"{matrix.shape[1]}",
                    )
                columns.append(matrix * point.scale)
                points.append((None, None))
                dof = -1
            else:
                dof, text = self.pick(point, "excitation", name)
                self.notes.append(f"excitation {name}: {text}")
                if (point.component or "").startswith("ROT"):
                    self.warn(
                        f"excitation.{name} acts about an axis ({point.component}): a moment, which a hammer cannot apply. If it is a "
                        "force, write a translation, such as UZ"
                    )
                columns.append(unit_columns([dof], self.n, point.scale))
                points.append(self.point(dof))
            if moving:
                shifts.append(load_shift(self.campaign, self.dofs, dof, name) * point.scale)
        # Derivatives with respect to hammer offsets are further loads, so the reduced model is valid for them, too.
        self.shifts = len(columns) + np.arange(2 * len(shifts)).reshape(-1, 2) if moving else None
        return sp.hstack([*columns, *([shift_columns(shifts)] if moving else [])], format="csc"), points

    def outputs(self, acoustic: NDArray[np.bool_]) -> tuple[sp.csc_array, list[Response]]:
        rows, responses = [], []
        parts = Parts()
        for name, point in self.campaign.responses.items():
            found = parts.read(partial(self.response, point, name, acoustic))
            if found is not None:
                rows.append(found[0])
                responses.append(found[1])
        parts.read(self.require_points)
        parts.require()
        return sp.vstack(rows, format="csc"), responses

    def slips(self, model: FeModel, responses: list[Response], groups: list[TermGroup], bolts: PointTable | None) -> Iterator[str]:
        """Warnings about contradictions within the campaign."""
        named = [(response.name, response.input) for response in responses]
        return slips(self.campaign, model, named, groups, bolts, self.dofs, astray=self.astray, misnamed=self.misnamed)

    def response(self, point: ResponseConfig, name: str, acoustic: NDArray[np.bool_]) -> tuple[sp.csc_array, Response]:
        """Output row (1, n) of one response, and its description."""
        excitations = list(self.campaign.excitation)
        row, (node, direction), text, is_pressure = self.output(point, name, acoustic)
        quantity = point.quantity or ("pressure" if is_pressure else "displacement")
        if (quantity == "pressure") != is_pressure:
            raise self.campaign.error(
                f"response {name} is a {'pressure' if is_pressure else 'motion'}, not a {quantity}",
                "responses",
                name,
                "quantity",
                expected="pressure" if is_pressure else "displacement, velocity or acceleration",
                found=quantity,
            )
        if point.excitation is None and len(excitations) > 1:
            raise self.campaign.error(
                f"response {name} does not say which excitation it belongs to",
                "responses",
                name,
                expected=f"excitation: one of {', '.join(excitations)}",
            )
        at = excitations.index(point.excitation) if point.excitation else 0
        self.notes.append(f"response {name}: {text}, {quantity}")
        turns = (point.component or "").startswith("ROT")
        unit = UNITS[quantity].replace("m", "rad", 1) if turns else UNITS[quantity]
        return row, Response(name=name, quantity=quantity, own_unit=unit, input=at, node=node, direction=direction, text=text)

    def output(self, point: ResponseConfig, name: str, acoustic: NDArray[np.bool_]) -> tuple[sp.csc_array, Point, str, bool]:
        if point.matrix is not None or point.vector is not None:
            ref = point.matrix or point.vector
            assert ref is not None
            matrix = self.vectors(ref, f"responses.{name}")
            if point.row >= matrix.shape[1]:
                known, hint = f"0 to {matrix.shape[1] - 1}", "rows are counted from 0: subtract 1 from the row of each response"
                raise self.campaign.error("this row does not exist", "responses", name, "row", expected=known, found=point.row, hint=hint)
            column = matrix[:, [point.row]]
            fields = acoustic[column.indices]
            if column.nnz == 0 or (fields.any() and not fields.all()):
                raise DataError(
                    f"the output row of {name} is {'empty' if column.nnz == 0 else 'a mixture of pressures and motions'}",
                    file=ref.path,
                    place=f"row {point.row}",
                )
            return (column.T * point.scale).tocsc(), (None, None), f"row {point.row} of {ref.path.name}", bool(fields.all())
        dof, text = self.pick(point, "responses", name)
        return unit_columns([dof], self.n, point.scale).T.tocsc(), self.point(dof), text, bool(acoustic[dof])


def read_as_exported(campaign: Campaign) -> Inputs:
    """Inputs of a campaign with the model as exported, without a stored calibration (for that see ``calibration.read_inputs``).

    Raises
    ------
    DataError
        If a file is missing, damaged or inconsistent.
    ConfigError
        If the campaign file refers to a DOF that does not exist, or contradicts itself.
    """
    require_inputs_apart(campaign)
    reader = _Reader(campaign)
    K, M, acoustic = _stiffness_and_mass(reader)
    C = _damping(reader, K, M, acoustic)
    parts = Parts()
    loads = parts.read(reader.loads)
    outputs = parts.read(lambda: reader.outputs(acoustic))
    carried = parts.read(lambda: _bolts_and_terms(reader))
    parts.require()
    assert loads is not None
    assert outputs is not None
    assert carried is not None
    (B, points), (L, responses), (found, terms) = loads, outputs, carried
    power = np.array([QUANTITIES[r.quantity] for r in responses], dtype=np.int64)
    bolts, groups = reader.owned(found)
    groups, along, no_lines = by_edges(campaign, groups, bolts)
    reader.notes += along
    lossy = partial(with_loss, campaign, acoustic)
    extras = factor_groups(reader, {"stiffness": K, "damping": C, "mass": M}, acoustic, lossy)
    model = FeModel(K=lossy(K), C=C, M=M, B=B, L=L, output_power=power, is_acoustic=acoustic, terms=terms, extras=extras)
    reader.warn(*no_lines, *left_behind(K, campaign), *doubts(model), *reader.slips(model, responses, groups, bolts))
    check_drift(campaign, bool(acoustic.any()))
    require_reach(model, [(r.name, r.input) for r in responses], list(campaign.excitation), reader.dofs, reader.misplaced)
    require_frequencies(model, campaign, reader.dofs)
    return Inputs(
        campaign=campaign,
        model=without_springs(model, K, campaign),
        dofs=reader.dofs,
        responses=tuple(responses),
        excitations=tuple(campaign.excitation),
        excitation_points=tuple(points),
        groups=tuple(groups),
        bolts=bolts,
        notes=tuple(reader.notes),
        warnings=(*guesses(campaign), *reader.warnings),
        hashes=reader.hashes,
        recipe=recipe_of(campaign, model),
        units_doubt=reader.units_doubt,
        places_doubt=reader.moved or bool(reader.axes) or bool(reader.misplaced),
        springs_doubt=bool(reader.beside) or reader.strayed,
        odd_bolts=frozenset(bolt for bolt, _ in odd_springs(reader.bushings)),
        held_doubt=any(held_springs(campaign, model, groups, reader.dofs)),
        shifts=reader.shifts,
    )


def _bolts_and_terms(reader: _Reader) -> tuple[list[Terms], LowRankTerms]:
    # All points have been read by now.
    dofs, points = reader.dofs, list(reader.near.values())
    if dofs is not None:
        require_unit(dofs, points, reader.campaign.path)
        # If the coordinates of the nodes are wrong, the places of the points say nothing.
        reader.axes = "" if reader.misplaced else exchanged_axes(dofs, points)
        if not reader.axes and not reader.misplaced:
            warnings, reader.moved = beside_nodes(dofs, points, reader.unit.length)
            reader.warn(*warnings)
        reader.warn(*shared_places(points))
    reader.read_bolts()
    found = reader.terms()
    if reader.axes:
        reader.warn(exchanged_text(reader.axes, points, reader.campaign, of_table=reader.table_exchanged))
    return found


def _stiffness_and_mass(reader: _Reader) -> tuple[sp.csc_array, sp.csc_array, NDArray[np.bool_]]:
    """Stiffness and mass without fixed DOFs, and (n,) mask of the pressures."""
    source = reader.campaign.model
    require_own(reader.campaign)
    came_through(read_before(reader.campaign.output, reader.campaign.jobs))
    first, second = reader.load(source.stiffness), reader.load(source.mass)
    require_whole(reader.campaign, first, second)
    numbered = numbering(source.dofs, first)
    reader.number(numbered)
    K = reader.matrix(source.stiffness, "stiffness", found=first)
    n = reader.n = reader.rows = K.shape[0]
    if K.nnz == 0:
        raise DataError("the stiffness matrix is empty", file=source.stiffness.path, place=source.stiffness.group, expected="values")
    M = reader.matrix(source.mass, "mass", found=second)
    if np.iscomplexobj(M.data):
        raise DataError("the mass matrix is complex", file=source.mass.path, expected="real numbers")
    if reader.labels is not None and reader.labels.size != n:
        raise DataError(
            "the DOF table does not fit the matrices",
            file=source.dofs if isinstance(source.dofs, Path) else source.stiffness.path,
            expected=f"{n} DOFs",
            found=f"{reader.labels.size}",
            hint=unfitting(reader.labels.size, n),
        )
    require_apart(source, stiffness=K, mass=M)
    exchanged = None
    if reader.dofs is not None and source.dofs is not None:
        # In the units of the files: those of a row follow from its component, which is in question.
        exported = replace(reader.dofs, xyz=reader.dofs.xyz / reader.unit.length)
        exchanged = components_doubt(K, exported, components_place(reader.campaign))
    K, M = reader.scale(K, M)
    require_roles(K, M, source, reader.campaign.reduction.band, reader.labels)
    acoustic = np.zeros(n, dtype=bool) if reader.labels is None else reader.labels.component == ACOUSTIC_COMPONENT
    added, doubt = added_nodes(K, numbered)
    reader.notes += [added] if added else []
    reader.warn(*([doubt] if doubt else []))
    fixed, note = fixed_dofs(K, M)
    if note:
        reader.notes.append(note)
        reader.leave_out(fixed)
        K, M, acoustic = (K[:, ~fixed][~fixed], M[:, ~fixed][~fixed], acoustic[~fixed])
    if reader.dofs is not None and source.dofs is not None:
        found = mesh_doubts(reader.campaign, K, M, reader.dofs, entries=first.matrix.data, exchanged=exchanged)
        reader.units_doubt, reader.misplaced = found.units, found.misplaced
        reader.warn(*found.warnings)
        reader.notes.append(f"DOF table: {extents(reader.dofs.xyz)}")
    return K, M, acoustic


def _damping(reader: _Reader, K: sp.csc_array, M: sp.csc_array, acoustic: NDArray[np.bool_]) -> sp.csc_array:
    damping = reader.campaign.model.damping
    if isinstance(damping, ProportionalDamping):
        structure, air = damping.structure, damping.acoustic
        reader.notes.append(
            f"damping: proportional, structure alpha {structure.alpha:g} beta {structure.beta:g}{_loss(structure)}"
            + (f", acoustic alpha {air.alpha:g} beta {air.beta:g}{_loss(air)}" if acoustic.any() else "")
        )
        return with_proportional(damping, K, M, acoustic)
    if damping is None:
        reader.notes.append("damping: none" + ("" if np.iscomplexobj(K.data) else " (an undamped model has infinite resonances)"))
        return sp.csc_array(K.shape)
    C = reader.matrix(damping, "damping")
    if reader.dofs is not None:
        require_mass(M, C, reader.dofs, reader.campaign.model)
    require_apart(reader.campaign.model, stiffness=K, damping=C)
    try:
        require_apart(reader.campaign.model, mass=M, damping=C)
    except DataError as error:
        # It may be intended: alpha = 1/s.
        reader.warn(f"{error.problem}: {error.hint}")
    return C


def _loss(damping: FieldDamping) -> str:
    return f" loss factor {damping.loss_factor:g}" if damping.loss_factor else ""


__all__ = ["ACOUSTIC_COMPONENT", "Inputs", "Response", "TermGroup", "read_as_exported"]
