"""Reads matrices and tables of a model, and finds the DOFs to which the campaign file refers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.reading.dof_source import Numbering, aligned
from lrbc_cli.campaign.reading.doubts.points import NearPoint
from lrbc_cli.campaign.reading.joints import HELD
from lrbc_cli.campaign.reading.triangles import whole
from lrbc_cli.config import Campaign
from lrbc_cli.config.fields import MatrixRef, OperatorRef
from lrbc_cli.config.structure import GroupConfig, PointConfig, SelectConfig
from lrbc_cli.errors import DataError, LrbcError, listing
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.io.common import head
from lrbc_cli.io.encoding import unfinished
from lrbc_cli.io.hdf5.matrices import ArrayNames
from lrbc_cli.io.matrices.read import read_matrix, read_vectors
from lrbc_cli.io.sparse import MatrixFile
from lrbc_cli.io.text.tables import ROUNDING, DofList, read_dof_list, read_nodes
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, DofLabels, DofTable, PointTable, numbers_text
from lrbc_cli.model.scaling import Scaling, scaling
from lrbc_cli.model.selection import at_node, coincident, in_box, in_order, near_line, near_points, nearest, outline, pitch, spacing
from lrbc_cli.model.units import SI

Point = tuple[int | None, int | None]
T = TypeVar("T")

BESIDE = "move it onto the model; coordinates are in the units of the campaign file"
PINNED = "DOFs that the export eliminated cannot be loosened: export the edge pinned, with free rotations"
FREE_IT = "a fixed DOF can neither move nor be loosened: export the edge pinned, with free rotations"

#: Directions of universal files by the label of a DOF; a pressure has none.
DIRECTIONS = {ACOUSTIC_COMPONENT: 0, "UX": 1, "UY": 2, "UZ": 3, "ROTX": 4, "ROTY": 5, "ROTZ": 6}
LABELS = {direction: label for label, direction in DIRECTIONS.items()}


class Parts:
    """Reads parts of the model that do not depend on each other, and collects the errors of all."""

    def __init__(self) -> None:
        self.errors: list[LrbcError] = []

    def read(self, part: Callable[[], T]) -> T | None:
        """A part; None if reading it raised an error."""
        try:
            return part()
        except LrbcError as error:
            self.errors += [error, *error.others]
            return None

    def require(self) -> None:
        """Raise the first error, with the others."""
        if self.errors:
            first, *rest = self.errors
            first.others = tuple(rest)
            raise first


class ModelReader:
    """Reads matrices and tables of one campaign, finds DOFs, and keeps notes, warnings and hashes of files.

    Parameters
    ----------
    campaign : Campaign
    """

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        self.unit = campaign.unit_system
        self.scaling: Scaling | None = None
        self.notes: list[str] = []
        self.warnings: list[str] = []
        #: The warning that guesses wrong units from the mesh alone.
        self.units_doubt: str | None = None
        self.hashes: dict[str, str] = {}
        self.dofs: DofTable | None = None
        #: Nodes with coordinates but without free DOFs in the matrices.
        self.held = np.zeros(0, dtype=np.int64)
        self.bolts: PointTable | None = None
        #: Node and component of each row as exported, and the number of these rows, to which DOF numbers in files refer.
        self.labels: DofLabels | None = None
        self.rows = 0
        #: Indices of the rows kept, and new index of each exported row (-1: left out); None if all are kept.
        self.kept: NDArray[np.int64] | None = None
        self.row_of: NDArray[np.int64] | None = None
        self.n = 0
        #: Points given by coordinates, by their keys, and the warning that the DOF table has wrong coordinates or another order, or none.
        self.near: dict[tuple[str, ...], NearPoint] = {}
        self.misplaced = ""
        #: Warnings about bolts far from their own springs, with the names of the tables concerned.
        self.beside: dict[str, list[str]] = {}
        #: Bolts whose springs bear the name of another bolt; whether a few springs lie far from theirs.
        self.misnamed: set[str] = set()
        self.strayed = False
        #: Whether all points seem to refer to another origin, or to exchanged axes (then these), and whether the bolts do so, too.
        self.moved = False
        self.axes = ""
        self.table_exchanged = False

    def hash(self, path: Path) -> None:
        """Store the hash of a file that was read."""
        self.hashes[path.as_posix()] = file_hash(path)

    def table(self, path: Path) -> None:
        """Store the hash of a table that was read, and warn if it may have been truncated."""
        self.hash(path)
        if unfinished(path.read_bytes()):
            self.warn(f"{path.name}: the last line has no line break; if the file was truncated there, its last value is wrong")

    def warn(self, *warnings: str) -> None:
        """Add warnings, each once, because a file is read as often as it is named."""
        self.warnings += [warning for warning in warnings if warning not in self.warnings]

    def load(self, ref: OperatorRef) -> MatrixFile:
        """A square matrix as stored in its file."""
        found = read_matrix(ref.path, ref.group, ref.format or self.campaign.model.format, _arrays(ref))
        self.hash(ref.path)
        self.warn(*found.warnings)
        return found

    def number(self, found: Numbering) -> None:
        """Adopt the numbering of the rows, with coordinates converted to metres."""
        self.dofs, self.labels, self.held = found.table, found.labels, found.spare
        if self.dofs is not None:
            self.dofs = replace(self.dofs, xyz=self.dofs.xyz * self.unit.length)
        self.notes += found.notes
        for path in found.files:
            # A binary mesh has no lines that could be truncated.
            (self.hash if b"\0\0" in head(path, 4096) else self.table)(path)

    def matrix(self, ref: OperatorRef, operator: str, group: str | None = None, found: MatrixFile | None = None) -> sp.csc_array:
        """A square matrix in the order of the model's rows, in SI, without fixed DOFs; ``group``: share of a calibration group."""
        what = operator if group is None else f"{operator} of group {group}"
        found = found or self.load(ref)
        matrix = aligned(found, self.labels, self.rows, ref.path, what)
        self.notes += [f"{what}: {note}" for note in found.notes]
        if self.rows and matrix.shape[0] != self.rows:
            raise DataError(
                f"the {what} matrix has the wrong size",
                file=ref.path,
                place=ref.group,
                expected=f"{self.rows} x {self.rows}, as the stiffness matrix",
                found=f"{matrix.shape[0]} x {matrix.shape[1]}",
                hint="export all matrices of one model in one run",
            )
        labels = self.labels
        acoustic = None if labels is None or labels.size != matrix.shape[0] else labels.component == ACOUSTIC_COMPONENT
        if ref.conjugate:
            matrix = matrix.conj()
        if ref.scale != 1.0:
            matrix = matrix * (ref.scale if isinstance(ref.scale, float) else complex(*ref.scale))
        if np.iscomplexobj(matrix.data) and not matrix.data.imag.any():
            matrix = matrix.real
            self.notes.append(f"{what}: all imaginary parts are zero")
        matrix, note = whole(matrix, ref, operator, acoustic, what)
        self.notes += [note] if note else []
        self.notes.append(f"{what}: {matrix.shape[0]} x {matrix.shape[1]}, {matrix.nnz} non-zeros, {found.format}, {matrix.dtype}")
        if self.scaling is not None:
            matrix = self.scaling.matrix(matrix, operator)
        return matrix if self.kept is None else matrix[:, self.kept][self.kept]

    def scale(self, K: sp.csc_array, M: sp.csc_array) -> tuple[sp.csc_array, sp.csc_array]:
        """Stiffness and mass converted to SI; everything read later is converted, too."""
        if self.unit == SI:
            return K, M
        if self.labels is None:
            raise self.campaign.error(
                "rows of unknown kind cannot be converted to SI",
                "units",
                expected="model.dofs: which rows are displacements, rotations and pressures",
                found="no DOF table",
                hint="add it, or export the model in SI units",
            )
        self.scaling = scaling(self.unit, self.labels, K, M)
        unit = self.unit
        self.notes.append(
            f"units {unit.text}: length {unit.length:.6g} m, force {unit.force:.6g} N, mass {unit.mass:.6g} kg, time {unit.time:.6g} s"
        )
        return self.scaling.matrix(K, "stiffness"), self.scaling.matrix(M, "mass")

    def leave_out(self, fixed: NDArray[np.bool_]) -> None:
        """Leave out fixed rows from here on; DOF numbers in files still refer to all exported rows.

        Parameters
        ----------
        fixed : (n,) bool array
            Mask over the exported rows.
        """
        self.kept = np.flatnonzero(~fixed)
        self.row_of = np.where(fixed, -1, np.cumsum(~fixed) - 1)
        self.n = self.kept.size
        if self.dofs is not None:
            at = self.kept
            self.held = np.union1d(self.held, np.setdiff1d(self.dofs.node, self.dofs.node[at]))
            self.dofs = DofTable(node=self.dofs.node[at], component=self.dofs.component[at], xyz=self.dofs.xyz[at])

    def vectors(self, ref: MatrixRef, what: str) -> sp.csc_array:
        """(n, m) real vectors as columns; transposed if the file has them as rows."""
        found = read_vectors(ref.path, ref.group, ref.format, _arrays(ref))
        self.hash(ref.path)
        self.warn(*found.warnings)
        matrix = found.matrix
        if matrix.shape[0] != self.rows and matrix.shape[1] == self.rows:
            matrix = matrix.T.tocsc()
        if matrix.shape[0] != self.rows:
            raise DataError(
                f"the vectors of {what} do not fit the model",
                file=ref.path,
                place=ref.group,
                expected=f"{self.rows} rows",
                found=f"{matrix.shape[0]} x {matrix.shape[1]}",
            )
        if np.iscomplexobj(matrix.data):
            raise DataError(f"the vectors of {what} are complex", file=ref.path, place=ref.group, expected="real numbers")
        if self.scaling is not None:
            matrix = self.scaling.vectors(matrix.tocsc())
        return matrix if self.kept is None else matrix[self.kept]

    def listed(self, path: Path) -> DofList:
        """DOFs of a list, with coordinates of the DOF table or, without one, of the list [m]."""
        found = read_dof_list(path, None if self.bolts is None else self.bolts.name)
        if found.xyz is not None:
            found = replace(found, xyz=found.xyz * self.unit.length)
        self.table(path)
        dofs = found.dof
        if dofs.size == 0 or dofs.max() >= self.rows or dofs.min() < 0:
            raise DataError(
                "this list of DOFs does not fit the model",
                file=path,
                expected=f"DOFs from 0 to {self.rows - 1}",
                found=str(dofs[:5].tolist()),
            )
        if self.row_of is not None:
            fixed = dofs[self.row_of[dofs] < 0]
            if fixed.size:
                raise DataError(
                    "a DOF of this list is fixed in the matrices", file=path, expected="free DOFs", found=f"DOF {fixed[0]}", hint=FREE_IT
                )
            dofs = self.row_of[dofs]
        if self.dofs is None:
            return replace(found, dof=dofs)
        own = self.dofs.xyz[dofs]
        if found.xyz is not None:
            wrong = np.flatnonzero(np.abs(found.xyz - own).max(axis=1) > ROUNDING * float(np.ptp(self.dofs.xyz, axis=0).max()))
            if wrong.size:
                raise DataError(
                    f"DOF {dofs[wrong[0]]} has other coordinates than in the DOF table",
                    file=path,
                    expected=f"{own[wrong[0]].tolist()}, as in {self.campaign.model.dofs}",
                    found=f"{found.xyz[wrong[0]].tolist()} ({wrong.size} such lines)",
                    hint="export both from one model, or remove the columns x, y and z",
                )
        return DofList(dofs, found.parameter, own, found.bolt)

    def term_dofs(self, name: str, config: GroupConfig) -> DofList:
        """DOFs of the terms of a group, with their coordinates [m] if known."""
        select, campaign = config.select, self.campaign
        keys = ("parameters", name, "select")
        if select.dofs is not None:
            return self.listed(select.dofs)
        table = self.dofs
        if table is None:
            raise campaign.error(
                "components need a DOF table", *keys, hint="add model.dofs, or select with {dofs: file} or {vectors: file}"
            )
        assert select.component is not None
        components = sorted(set(table.component.tolist()))
        if select.component not in components:
            raise campaign.error(
                "no DOF has this component",
                *keys,
                "component",
                expected=f"one of {', '.join(components)}",
                found=select.component,
                hint=PINNED,
            )
        if select.near_bolts is not None:
            return self._at_bolts(table, select.component, select.near_bolts * self.unit.length, keys)
        dofs = self._at_nodes(table, select, keys) if select.nodes is not None else self._in_space(table, select, keys)
        return DofList(dofs, xyz=table.xyz[dofs])

    def _at_nodes(self, table: DofTable, select: SelectConfig, keys: Sequence[str]) -> NDArray[np.int64]:
        """DOFs of a list of nodes, in the order of the list."""
        assert select.nodes is not None
        assert select.component is not None
        nodes = select.nodes
        if isinstance(nodes, Path):
            self.table(nodes)
            nodes = read_nodes(nodes)
        out = []
        for node in nodes:
            found = at_node(table, node, select.component)
            if found.size != 1:
                known = bool(np.any(table.node == node))
                raise self.campaign.error(
                    f"node {node} has no DOF {select.component}" if known or node in self.held else f"node {node} does not exist",
                    *keys,
                    "nodes",
                    hint=PINNED if known else HELD if node in self.held else numbers_text(table.node),
                )
            out.append(int(found[0]))
        return np.array(out, dtype=np.int64)

    def _in_space(self, table: DofTable, select: SelectConfig, keys: Sequence[str]) -> NDArray[np.int64]:
        """DOFs of the nodes in a box, along a line or on the border of a field, ordered along their edges."""
        unit, component = self.unit.length, select.component
        assert component is not None
        inside = table.xyz[table.component == component] / unit
        low, high = inside.min(axis=0), inside.max(axis=0)
        extent = ", ".join(f"{axis} {a:g} to {b:g}" for axis, a, b in zip("xyz", low, high, strict=True))
        if select.along is not None:
            assert select.tolerance is not None
            dofs = near_line(table, component, np.array(select.along) * unit, select.tolerance * unit)
            if not dofs.size:
                problem = f"no DOF {component} lies within {select.tolerance:g} of this line"
                expected, line = f"a line through nodes in {extent}", np.array(select.along)
                beside = bool(np.any((line.max(axis=0) + select.tolerance < low) | (line.min(axis=0) - select.tolerance > high)))
                raise self.campaign.error(problem, *keys, "along", expected=expected, hint=BESIDE if beside else PINNED)
            return dofs
        if select.box is not None:
            dofs = in_box(table, component, [(a * unit, b * unit) for a, b in select.box])
        else:
            dofs = np.flatnonzero(table.component == component)
        if not dofs.size:
            problem = f"no DOF {component} lies in this box"
            assert select.box is not None
            beside = any(b < lower or a > upper for (a, b), lower, upper in zip(select.box, low, high, strict=True))
            raise self.campaign.error(problem, *keys, "box", expected=f"a box that overlaps {extent}", hint=BESIDE if beside else PINNED)
        if select.boundary is None:
            return dofs
        try:
            return in_order(table, dofs[outline(table.xyz[dofs])])
        except ValueError as error:
            raise self.campaign.error(
                "the coordinates of these nodes do not define a border",
                *keys,
                "boundary",
                expected="a flat field of nodes",
                found=f"{dofs.size} nodes; {error}",
                hint="restrict them by `box`, or select by `along` or `nodes`",
            ) from None

    def _at_bolts(self, table: DofTable, component: str, radius: float, keys: Sequence[str]) -> DofList:
        """DOFs of the nodes within ``radius`` [m] of the bolts, each with its bolt."""
        if self.bolts is None:
            raise self.campaign.error("nodes near the bolts need the bolts", *keys, "near_bolts", expected="bolts: a CSV file name,x,y,z")
        unit = self.unit.length
        there = table.xyz[table.component == component]
        size = float(np.linalg.norm(np.ptp(table.xyz, axis=0)))
        apart = pitch(self.bolts.xyz)
        if radius > min(apart, size):
            what = (
                f"the distance of neighbouring bolts, {apart / unit:.4g}" if apart < size else f"the size of the model, {size / unit:.4g}"
            )
            raise self.campaign.error(
                "this radius reaches beyond the neighbours of a bolt",
                *keys,
                "near_bolts",
                expected=f"less than {what}",
                found=f"{radius / unit:g}",
                hint="give about the radius of the washer, in metres or in the length unit of `units`",
            )
        dofs, owner = near_points(table, component, self.bolts.xyz, radius)
        alone = [name for b, name in enumerate(self.bolts.name) if b not in owner]
        if alone:
            raise self.campaign.error(
                f"no DOF {component} lies within this radius of {listing(alone, 8)}",
                *keys,
                "near_bolts",
                expected=f"a node for each of {len(self.bolts.name)} bolts",
                found=f"{radius / unit:g}; none for {len(alone)}, and {_farthest(self.bolts, there, unit)}",
                hint="enlarge it, or remove bolts without terms from the bolts file",
            )
        return DofList(dofs, xyz=table.xyz[dofs], bolt=tuple(self.bolts.name[b] for b in owner))

    def pick(self, point: PointConfig, *keys: str) -> tuple[int, str]:
        """DOF of a point, and its place in words."""
        table, campaign = self.dofs, self.campaign
        if point.dof is not None:
            if point.dof >= self.rows:
                raise campaign.error("this DOF does not exist", *keys, "dof", expected=f"0 to {self.rows - 1}", found=point.dof)
            row = point.dof if self.row_of is None else int(self.row_of[point.dof])
            if row < 0:
                raise campaign.error(
                    "this DOF is fixed in the matrices", *keys, "dof", expected="a free DOF", found=point.dof, hint=FREE_IT
                )
            return row, f"DOF {point.dof}"
        if table is None:
            raise campaign.error("nodes and coordinates need a DOF table", *keys, hint="add model.dofs, or give {dof: number}")
        assert point.component is not None
        components = ", ".join(sorted(set(table.component.tolist())))
        if point.node is not None:
            dofs = at_node(table, point.node, point.component)
            if dofs.size != 1:
                here = sorted(table.component[table.node == point.node].tolist())
                raise campaign.error(
                    f"node {point.node} has no DOF {point.component}"
                    if not dofs.size
                    else f"node {point.node} has several DOFs {point.component}",
                    *keys,
                    expected=f"one of {', '.join(here)}" if here else "a node of the DOF table",
                    found=point.component if here else f"node {point.node}",
                    hint="a fixed DOF that the export eliminated cannot be used"
                    if here
                    else HELD
                    if point.node in self.held
                    else numbers_text(table.node),
                )
            return int(dofs[0]), f"node {point.node} {point.component}"
        assert point.near is not None
        place = [value * self.unit.length for value in point.near]
        found = nearest(table, place, point.component)
        if found is None:
            raise campaign.error("no DOF has this component", *keys, "component", expected=f"one of {components}", found=point.component)
        (dof, distance), key = found, ".".join(keys)
        node, size = int(table.node[dof]), spacing(table, dof)
        others, at = tuple(coincident(table, dof)), np.array(place)
        self.near[keys] = NearPoint(key=key, place=at, component=point.component, node=node, distance=distance, size=size, others=others)
        return dof, f"node {node} {point.component}, {1e3 * distance:.2f} mm from the given point"

    def point(self, dof: int) -> Point:
        """Node and direction of a DOF; None if unknown."""
        if self.dofs is None:
            return None, None
        return int(self.dofs.node[dof]), DIRECTIONS.get(str(self.dofs.component[dof]))


def _farthest(bolts: PointTable, nodes: Floats, unit: float) -> str:
    """The bolt that is farthest from all nodes, in words; ``unit`` is the length unit of the campaign [m]."""
    away = cKDTree(nodes).query(bolts.xyz)[0]
    worst = int(np.argmax(away))
    return f"the nearest node to {bolts.name[worst]} is {away[worst] / unit:.4g} away"


def _arrays(ref: MatrixRef) -> ArrayNames | None:
    return None if ref.arrays is None else ArrayNames(**ref.arrays.model_dump())
