"""Joints: which bolt owns which parameter, and the vectors of springs between two nodes or to ground."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.errors import ConfigError, DataError, listing
from lrbc_cli.io.text.bushings import BushingTable
from lrbc_cli.model.dofs import COMPONENTS, DofTable, PointTable, numbers_text
from lrbc_cli.model.selection import at_node, pitch

#: Direction cosines below this are rounding of an axis.
ROUNDING = 1e-9

#: Largest number of springs that are named one by one.
MOST_NAMED = 4

#: Hint for a node that has coordinates but no DOFs.
HELD = (
    "it has coordinates, but no DOFs in the matrices: it was fixed when they were exported, and a fixed node neither moves nor loosens. "
    "Remove the boundary condition that holds it, and export the matrices again"
)


@dataclass(frozen=True)
class Owners:
    """The parameters of one group, and the bolts that own them.

    Attributes
    ----------
    parameter : (m,) int array
        Parameter of each term.
    bolt : (k,) tuple of str or None
        Bolt of each parameter, empty if it has none; None if bolts own none.
    """

    parameter: Integers
    bolt: tuple[str, ...] | None


def owners(
    count: int, parameter: Sequence[str] | None, bolt: Sequence[str] | None, known: Collection[str] | None, file: Path | None
) -> Owners:
    """Parameter of each term and bolt of each parameter: terms with the same parameter name share it; without names, terms of one bolt do.

    Parameters
    ----------
    count : int
        Number of terms m.
    parameter, bolt : (m,) sequences of str or None
        Columns of a table.
    known : collection of str or None
        Names in the bolts file: without a column ``bolt``, a parameter with the name of a bolt belongs to it.
    file : Path or None
        For messages.

    Raises
    ------
    DataError
        If a parameter belongs to two bolts.
    """
    own = bolt if bolt is not None else [name if known and name in known else "" for name in parameter or [""] * count]
    # A trailing blank avoids collisions, as no name has one.
    labels = parameter if parameter is not None else [name or f"{k} " for k, name in enumerate(own)]
    order = {label: k for k, label in enumerate(dict.fromkeys(labels))}
    found = np.array([order[label] for label in labels], dtype=np.int64)
    names: dict[int, str] = {}
    for term, k in enumerate(found.tolist()):
        if names.setdefault(k, own[term]) != own[term]:
            raise DataError(
                f"the parameter {labels[term]} belongs to two bolts",
                file=file,
                place=f"term {term}",
                expected=f"bolt {names[k] or '(none)'}, as for its other terms",
                found=own[term] or "none",
                hint="give parameters of two bolts two names",
            )
    return Owners(found, tuple(names[k] for k in range(len(order))) if any(own) else None)


def bushing_vectors(table: BushingTable, dofs: DofTable) -> tuple[sp.csc_array, Floats]:
    """Vectors b of springs, with the stiffness matrix ``b bᵀ`` for each, and their positions.

    Returns
    -------
    (n, m) csc_array
        ``sqrt(stiffness)`` times the motion of node a minus that of node b in the local direction.
    (m, 3) float array
        Midpoint of the two nodes, or the node [m].

    Raises
    ------
    DataError
        If a node, or a component of it, does not exist.
    """
    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    places = np.zeros((len(table.lines), 3))
    for k, label in enumerate(table.component):
        family, axis = divmod(COMPONENTS.index(label), 3)
        direction, size = table.axes[k, axis], float(np.sqrt(table.stiffness[k]))
        ends = [("node_a", int(table.node_a[k]), 1.0), ("node_b", table.node_b[k], -1.0)]
        given = [(column, node, sign) for column, node, sign in ends if node is not None]
        for column, node, sign in given:
            for cosine, name in zip(direction, COMPONENTS[3 * family : 3 * family + 3], strict=True):
                if abs(cosine) > ROUNDING:
                    rows.append(_dof(table, dofs, k, column, node, name))
                    columns.append(k)
                    values.append(sign * size * float(cosine))
            places[k] += dofs.xyz[np.flatnonzero((dofs.node == node) & ~dofs.is_acoustic)[0]] / len(given)
    vectors = sp.csc_array((values, (rows, columns)), shape=(dofs.size, len(table.lines)))
    return vectors, places


def require_free(table: BushingTable, held: Integers) -> None:
    """Refuse springs at nodes that have no DOFs.

    Parameters
    ----------
    table : BushingTable
    held : int array
        Nodes with coordinates but without DOFs.

    Raises
    ------
    DataError
        If there are such springs; names all, since replacing single nodes would be the wrong remedy.
    """
    known = set(held.tolist())
    springs = list(zip(table.node_a.tolist(), table.node_b, table.bolt, table.lines, strict=True))
    at = [(node, bolt, line) for a, b, bolt, line in springs for node in (a, b) if node in known]
    if not at:
        return
    nodes, bolts = ([str(name) for name in dict.fromkeys(entry[k] for entry in at) if name != ""] for k in (0, 1))
    have = f"nodes {listing(nodes, 6)} have" if len(nodes) > 1 else f"node {nodes[0]} has"
    of = f", of {len(bolts)} bolt{'s' if len(bolts) > 1 else ''} ({listing(bolts, 6)})" if bolts else ""
    hint = (
        "they were probably fixed when the matrices were exported, and a fixed node cannot loosen. Remove the boundary condition at the "
        "bolts, so that only these springs hold the structure there, and export the matrices again (a node without elements has no DOFs "
        "either)"
    )
    if not any(a in known for a, *_ in springs):
        hint = "a spring to a fixed node goes to ground: leave node_b empty for it"
    raise DataError(
        f"{have} coordinates, but no DOFs in the matrices",
        file=table.path,
        place=f"line {at[0][2]}",
        expected="springs at nodes that can move",
        found=f"{len(nodes)} node{'s' if len(nodes) > 1 else ''} without a row{of}",
        hint=hint,
    )


def _dof(table: BushingTable, dofs: DofTable, k: int, column: str, node: int, name: str) -> int:
    """Index of one DOF of a node; raises a DataError if it does not exist."""
    found = at_node(dofs, node, name)
    if found.size == 1:
        return int(found[0])
    here = sorted(str(label) for label in dofs.component[(dofs.node == node) & ~dofs.is_acoustic])
    line, own = f"line {table.lines[k]}", table.component[k]
    if not here:
        expected = "a structural node of the DOF table"
        raise DataError(
            f"node {node} does not exist",
            file=table.path,
            place=f"{line}, column {column!r}",
            expected=expected,
            found=f"node {node}",
            hint="leave node_b empty if a spring goes to ground" if column == "node_b" and node <= 0 else numbers_text(dofs.node),
        )
    hint = "a DOF that the export eliminated cannot carry a spring: export it, or remove the line"
    if name.startswith("ROT") and not any(str(label).startswith("ROT") for label in np.unique(dofs.component)):
        hint = (
            "no node of the DOF table has a rotation. For shells, plates and beams its labels are wrong then (w, rx, ry of a plate in X "
            "and Y are UZ, ROTX, ROTY): correct them. Solid elements have no rotations: remove the line"
        )
    raise DataError(
        f"node {node} has no DOF {name}",
        file=table.path,
        place=f"{line}, column 'component'",
        expected=f"one of {', '.join(here)}",
        found=own if name == own else f"{own}, which acts along {name} there",
        hint=hint,
    )


def aside_text(table: BushingTable, dofs: DofTable, *, elements: float = 4.0) -> str:
    """Warning about springs whose nodes are not on the spring axis, so that they resist rigid rotations; empty if there are none.

    Parameters
    ----------
    table : BushingTable
    dofs : DofTable
    elements : float
        If the nodes of all springs are farther from the axis than this multiple of the node spacing, the table is of another mesh.
    """
    place = {int(node): dofs.xyz[at] for at, node in enumerate(dofs.node.tolist()) if not dofs.is_acoustic[at]}
    arms = dict[int, float]()
    for k, (a, b) in enumerate(zip(table.node_a.tolist(), table.node_b, strict=True)):
        family, axis = divmod(COMPONENTS.index(table.component[k]), 3)
        if b is not None and family == 0:
            arms[k] = float(np.linalg.norm(np.cross(place[b] - place[a], table.axes[k, axis])))
    least = 1e-6 * float(np.ptp(dofs.xyz, axis=0).max())
    far = [k for k, arm in arms.items() if arm > least]
    if not far:
        return ""
    count, longest = len(far), max(arms[k] for k in far)
    every = "all " if 1 < count == len(arms) else ""
    text = f"the nodes of {every}{count} spring{'s' if count > 1 else ''} lie up to {1e3 * longest:.3g} mm off the spring axis"
    fix = "also resists when both its nodes rotate as one rigid body: join nodes on the axis, or export rigid arms to it"
    if 2 * count >= len(arms):
        # Nodes of one bolt are a few elements apart.
        if min(arms.values()) > elements * pitch(np.array(list(place.values()))):
            return f"{text}. Probably table and DOF table are of different meshes: export both, and the matrices, from one model"
        return f"{text}. Such a spring {fix}"
    named = listing([f"line {table.lines[k]}, {_joined(table, k)}" for k in far], MOST_NAMED, "; ")
    return f"{text}; those of the other springs lie on it. Check whether a node is mistyped: {named}. A spring off its axis {fix}"


def _joined(table: BushingTable, k: int) -> str:
    """Bolt and nodes of a spring in words, with other bolts that have one of these nodes."""
    said, own = [], table.bolt[k]
    for node in (int(table.node_a[k]), table.node_b[k]):
        others = sorted({bolt for bolt, *ends in zip(table.bolt, table.node_a.tolist(), table.node_b, strict=True) if node in ends} - {own})
        said.append(f"{node}{f' (also of {others[0]})' if others else ''}")
    return f"{own}{' with' if own else ''} nodes {' and '.join(said)}".lstrip()


def bolts_of_terms(groups: Sequence[tuple[str, Sequence[str] | None, Floats | None]]) -> PointTable | None:
    """Bolts that groups name, in their order, each at the mean position of its parameters; None if there are none.

    Parameters
    ----------
    groups : sequence of (str, (k,) sequence of str or None, (k, 3) float array or None)
        Name, bolt of each parameter, and places.

    Raises
    ------
    ConfigError
        If the position of a bolt is unknown.
    """
    places: dict[str, list[Floats]] = {}
    for _, bolts, xyz in groups:
        for k, bolt in enumerate(bolts or ()):
            if bolt:
                places.setdefault(bolt, [])
                places[bolt] += [] if xyz is None else [xyz[k]]
    lost = [name for name, found in places.items() if not found]
    if lost:
        raise ConfigError(
            f"the place of bolt {lost[0]} is not given",
            place="bolts",
            expected="a bolts file, a DOF table, or columns x, y and z beside the terms",
            hint="add `bolts: bolts.csv` with the columns name, x, y, z",
        )
    return PointTable(tuple(places), np.array([np.mean(found, axis=0) for found in places.values()])) if places else None


def joint_notes(bolts: PointTable, owned: Sequence[tuple[str, Sequence[str]]], ground: bool | None) -> list[str]:
    """Note on bolts and their groups, for ``lrbc check``.

    Parameters
    ----------
    bolts : PointTable
    owned : sequence of (str, (k,) sequence of str)
        Groups with the bolt of each parameter.
    ground : bool or None
        Whether all springs go to ground (True), none does (False), or some do or it is not known (None).
    """
    names = {name for _, group in owned for name in group if name}
    between = {True: ", to ground", False: ", between two nodes", None: ""}[ground]
    count = f"{len(names)} bolt{'' if len(names) == 1 else 's'}, {len(owned)} group{'' if len(owned) == 1 else 's'}"
    rest = [name for name in bolts.name if name not in names]
    return [
        f"joints: {count} ({', '.join(name for name, _ in owned)}){between}"
        + (f"; {len(rest)} further bolts own no term ({listing(rest, 5)})" if rest else "")
    ]
