"""Assigns roles in a campaign to the recognised files, by name, and by content where that says more."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.drafting.recognise import FilesFound, MatrixFound, can
from lrbc_cli.campaign.reading.dof_source import numbering
from lrbc_cli.campaign.reading.places import likely_units
from lrbc_cli.config.structure import DofSource
from lrbc_cli.errors import DataError, LrbcError
from lrbc_cli.io.frf_common import alike
from lrbc_cli.io.sparse import MatrixFile
from lrbc_cli.io.text.bushings import read_bushings
from lrbc_cli.io.text.tables import read_positions, read_table
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.reduction.problem.vectors import highest_omega

#: Names of operators: whole names, then parts of names.
OPERATORS = {
    "stiffness": re.compile(r"^(k|kaax?|stif)$|stiff|steif|(^|[_\W])k([_\W]|$)|stif\d|\.sti(\.gz)?$", re.IGNORECASE),
    "mass": re.compile(r"^(m|maax?|mas)$|mass|(^|[_\W])m([_\W]|$)|\.mas(\.gz)?$", re.IGNORECASE),
    "damping": re.compile(r"^(c|d|caax?|baax?)$|damp|daempf|dämpf|visc|\.dmp(\.gz)?$", re.IGNORECASE),
}

#: Names of tight states, the most certain first.
TIGHT = ("reference", "ref", "tight", "fest", "baseline", "fixed", "intact", "healthy", "nominal", "00", "000", "0")

#: Words in a name that exclude a tight state: something is loose, missing or damaged; or the file is a coherence.
LOOSE = re.compile(
    "loos|lose|los$|lost|gel(oe|o)st|locker|slack|open|remov|missing|fehl|without|ohne|half|halb|hand$|partly|partial|teilw|free|frei|"
    "damag|defe[kc]t|broken|crack|not?$|non(serr|tight|fix)|desserr|nicht|un(?!it|damaged)|coh|koh"
)
#: Negation in words joined by blanks (French `non-serré`), unless it concerns the measurement.
DENIED = re.compile(" non (?!lin|contact)")
#: A single bolt in words joined by blanks.
ONE_BOLT = re.compile(" (b|bolt|screw|schraube|joint) ?0*[1-9][0-9]* ")

BOLTS = re.compile("bolt|screw|schraub|joint|fastener", re.IGNORECASE)
HAMMER = re.compile("hammer|exc|force|kraft|impact|shaker|input|anreg|driv", re.IGNORECASE)


#: Quantities by the beginning of a sensor's name.
QUANTITIES = {"acc": "acceleration", "bes": "acceleration", "mic": "pressure", "mik": "pressure", "vel": "velocity", "disp": "displacement"}


@dataclass
class PointFound:
    """Point at which something is measured or hit."""

    xyz: Floats
    component: str | None = None
    quantity: str | None = None


@dataclass(kw_only=True)
class Roles:
    """Roles of the files in the campaign.

    Attributes
    ----------
    operators : dict of MatrixFound
        ``stiffness``, ``mass``, ``damping``.
    terms : list
        Vectors of terms, each with the table of their positions.
    rows : MatrixFound or None
        Output rows of responses.
    loads : list of MatrixFound
    bolts : Path or None
    points : dict of PointFound
        Sensors and hammer points by name, in lower case.
    spare : list of str
        Files without a role.
    doubts : list of str
        Guesses to be confirmed by the user.
    """

    operators: dict[str, MatrixFound] = field(default_factory=dict)
    terms: list[tuple[MatrixFound, Path]] = field(default_factory=list)
    rows: MatrixFound | None = None
    loads: list[MatrixFound] = field(default_factory=list)
    bolts: Path | None = None
    points: dict[str, PointFound] = field(default_factory=dict)
    spare: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)

    def point(self, name: str) -> PointFound | None:
        """Point of a sensor by the name of its record, or by the only name that is alike; None if there is none."""
        near = [point for key, point in self.points.items() if alike(key) == alike(name)]
        return self.points.get(name.strip().lower()) or (near[0] if len(near) == 1 else None)


def roles_of(found: FilesFound) -> Roles:
    """Guess the roles of the files; guesses by content alone, or contrary to a name, are listed as doubts.

    Raises
    ------
    DataError
        If the files belong to several models.
    """
    _require_one_model(found)
    roles = Roles()
    _operators(found, roles)
    _vectors(found, roles)
    _named_points(found, roles)
    return roles


def _require_one_model(found: FilesFound) -> None:
    """Refuse stiffness matrices of different sizes in separate files, as tables and FRFs could belong to any of them."""
    square = [matrix for matrix in found.matrices if matrix.matrix.shape[0] == matrix.matrix.shape[1]]
    named: dict[int, MatrixFound] = {}
    for matrix in square:
        if OPERATORS["stiffness"].search(matrix.name) or (matrix.group is None and OPERATORS["stiffness"].search(matrix.path.name)):
            named.setdefault(matrix.matrix.shape[0], matrix)
    if len(named) < 2:
        return
    files = [{matrix.path for matrix in square if matrix.matrix.shape[0] == size} for size in named]
    # A file that contains both has one model and a reduced one of it.
    if set.intersection(*files):
        return
    raise DataError(
        f"{'two' if len(named) == 2 else len(named)} stiffness matrices, {' and '.join(map(str, named))} DOFs: these are files of "
        "several models",
        file=found.folder,
        place="--from",
        expected="the files of one model, and its measurements",
        found="; ".join(f"{found.called(matrix.path)} ({size} DOFs)" for size, matrix in named.items()),
        hint="give --from one of them, in a folder of its own",
    )


def _same(one: MatrixFound, other: MatrixFound, digits: float = 1e-5) -> bool:
    """Whether two matrices are equal within rounding of the files."""
    A, B = one.matrix, other.matrix
    return A.shape == B.shape and bool(abs(A - B).max() <= digits * abs(A).max())


def _operators(found: FilesFound, roles: Roles) -> None:
    n, taken = found.size, roles.operators
    square: list[MatrixFound] = []
    for matrix in found.matrices:
        first = next((other for other in square if _same(matrix, other)), None)
        if matrix.matrix.shape == (n, n) and first is None:
            square.append(matrix)
        elif first is not None:
            roles.doubts.append(f"{found.called(matrix.path)} contains the same matrix as {found.called(first.path)}: left out")
    for role, pattern in OPERATORS.items():
        # The shortest name counts: K before K_x.
        named = [m for m in square if pattern.search(m.name) or (m.group is None and pattern.search(m.path.name))]
        if named:
            taken[role] = min(named, key=lambda matrix: len(matrix.name))
            square = [matrix for matrix in square if matrix is not taken[role]]
    by_size = sorted(square, key=lambda m: -float(np.abs(m.matrix.diagonal()).max(initial=0.0)))
    # If stiffness and mass are known by name, a further matrix may be a part of one of them as well as a damping.
    wanted = [role for role in OPERATORS if role not in taken] if not {"stiffness", "mass"} <= set(taken) else []
    for role in wanted:
        if by_size:
            # The stiffness has the largest entries in all systems of units.
            taken[role] = by_size.pop(0 if role == "stiffness" else -1)
            roles.doubts.append(f"model.{role}: chosen by the size of its entries; its name does not say so")
    other = [matrix for matrix in found.matrices if n not in matrix.matrix.shape]
    roles.spare += [_called(found, matrix) for matrix in (*by_size, *other)]
    if {"stiffness", "mass"} <= set(taken):
        K, M = taken["stiffness"], taken["mass"]
        if highest_omega(K.matrix, M.matrix) < 1.0 < highest_omega(M.matrix, K.matrix) < np.inf:
            taken["stiffness"], taken["mass"] = M, K
            roles.doubts.append("model.stiffness and model.mass: exchanged against their names; otherwise frequencies would be near zero")


def _vectors(found: FilesFound, roles: Roles) -> None:
    n = found.size
    thin = [m for m in found.matrices if n in m.matrix.shape and m.matrix.shape != (n, n)]
    positions = {path: read_positions(path).xyz.shape[0] for path in found.of("positions") if can(partial(read_positions, path))}
    for matrix in thin:
        count = min(matrix.matrix.shape)
        fits = [path for path, terms in positions.items() if terms == count]
        near = sorted(fits, key=lambda path: path.stem.split(".")[0].lower() != matrix.name.lower())
        if near and not HAMMER.search(matrix.name):
            roles.terms.append((matrix, near[0]))
            del positions[near[0]]
        elif HAMMER.search(matrix.name) and count == 1:
            roles.loads.append(matrix)
        elif roles.rows is None:
            roles.rows = matrix
        else:
            roles.spare.append(_called(found, matrix))
    roles.spare += [found.called(path) for path in positions]
    # The first file of each kind is used.
    roles.spare += [found.called(path) for kind in ("dofs", "nodes", "map") for path in found.of(kind)[1:]]


def _named_points(found: FilesFound, roles: Roles) -> None:
    """Assign tables of named points to bolts, or to places of sensors and hammer."""
    records = {alike(record.name) for frf in found.measurements.values() for record in frf.records}
    for path in (*found.of("points"), *found.of("named")):
        try:
            table = read_table(path, ("name", "x", "y", "z"), ("component", "quantity"))
            names, xyz = table.text("name"), table.floats("x", "y", "z")
        except LrbcError as error:
            roles.doubts.append(f"{found.called(path)}: {error.problem}")
            continue
        measured = any(alike(name) in records or HAMMER.search(name) for name in names)
        if path in found.of("named") and (BOLTS.search(path.stem) or not measured):
            if roles.bolts is None:
                roles.bolts = path
            else:
                roles.spare.append(found.called(path))
            continue
        kinds, quantities = (
            [cell or None for cell in table.text(key)] if key in table.columns else [None] * len(names) for key in ("component", "quantity")
        )
        for name, place, kind, quantity in zip(names, xyz, kinds, quantities, strict=True):
            roles.points[name.strip().lower()] = PointFound(place, kind and kind.upper(), quantity)


def _called(found: FilesFound, matrix: MatrixFound) -> str:
    return f"{found.called(matrix.path)}{f'#{matrix.group}' if matrix.group else ''} ({' x '.join(map(str, matrix.matrix.shape))})"


def tight_states(states: Mapping[str, str], bolts: Collection[str] = ()) -> tuple[list[str], list[str]]:
    """Jobs named as tight state by a word, and those by a number such as 00; the most certain first.

    Parameters
    ----------
    states : dict of str
        Names of folder and file of each job.
    bolts : collection of str
        Names of bolts; a job whose name contains one is about that bolt.
    """
    found = list[tuple[int, int, int, str, bool]]()
    for name, text in states.items():
        words = words_of(name)
        told = next((word for word in TIGHT if word in words or (not word.isdigit() and word in _letters(words))), None)
        if told is not None and not names_loose(text, bolts):
            # Order: fewest words in the name, then rank in ``TIGHT``.
            found.append((len(words), TIGHT.index(told), len(found), name, told.isdigit()))
    ordered = sorted(found)
    return [name for *_, name, number in ordered if not number], [name for *_, name, number in ordered if number]


def names_loose(text: str, bolts: Collection[str] = ()) -> bool:
    """Whether a name indicates that something is loose, or refers to a single bolt."""
    words = words_of(text)
    said = f" {' '.join(words)} "
    # Bolts named by numbers only are left out: repeats are numbered, too.
    own = [" ".join(words_of(bolt)) for bolt in bolts if not bolt.strip().isdigit()]
    loose = any(map(LOOSE.match, (*words, *_letters(words)))) or DENIED.search(f" {' '.join(_letters(words))} ")
    return bool(loose or ONE_BOLT.search(said)) or any(f" {bolt} " in said for bolt in own if bolt)


def words_of(text: str) -> list[str]:
    """Words and numbers of a name, in lower case and without accents."""
    letters = "".join(c for c in unicodedata.normalize("NFKD", text.lower()) if not unicodedata.combining(c))
    return [word for word in re.split(r"[_\W]+", letters) if word]


def _letters(words: Sequence[str]) -> list[str]:
    return [part for word in words for part in re.split(r"\d+", word) if part]


def table_of(found: FilesFound, roles: Roles) -> DofTable | None:
    """DOF table in the order of the stiffness matrix; None if the files do not give it."""
    stiffness, tables, nodes = roles.operators.get("stiffness"), found.of("dofs"), found.of("nodes")
    if stiffness is None or not (tables or nodes):
        return None
    maps = [*found.of("map"), None]
    source = tables[0] if tables else DofSource.model_construct(nodes=nodes[0], map=maps[0], order=None, components=None)
    try:
        table = numbering(source, MatrixFile(matrix=stiffness.matrix, format="", labels=stiffness.labels)).table
    except LrbcError as error:
        roles.doubts.append(f"model.dofs: {error.problem}" + (f"; {error.hint}" if error.hint else ""))
        return None
    return table if table is not None and table.node.size == stiffness.matrix.shape[0] else None


def units_of(roles: Roles, table: DofTable | None) -> list[str]:
    """Possible systems of units of the model, see ``places.likely_units``."""
    matrices = [roles.operators[role].matrix for role in ("stiffness", "mass") if role in roles.operators]
    if table is None or len(matrices) < 2 or matrices[0].shape != matrices[1].shape:
        return ["SI"]
    return likely_units(matrices[0], matrices[1], table)


def holds_springs(path: Path, roles: Roles, table: DofTable | None) -> bool | None:
    """Whether the stiffness matrix contains the springs of a table already; None if unknown.

    Springs between two nodes of separate parts are tested by the coupling entry, translational ones to ground by the force under a rigid
    translation.
    """
    if table is None or "stiffness" not in roles.operators:
        return None
    K, springs = roles.operators["stiffness"].matrix.real.tocsr(), read_bushings(path)
    at = {key: row for row, key in enumerate(zip(table.node.tolist(), table.component.tolist(), strict=True))}
    shares = []
    left = {label: K @ (table.component == label).astype(float) for label in COMPONENTS[:3]}
    for k, label in enumerate(springs.component):
        rows = [at.get((int(node), str(label))) for node in (springs.node_a[k], springs.node_b[k]) if node is not None]
        if (len(rows) == 1 and label not in left) or None in rows or not np.array_equal(springs.axes[k], np.eye(3)):
            continue
        held = left[label][rows[0]] if len(rows) == 1 else -K[rows[0], rows[1]]
        shares.append(float(held) / springs.stiffness[k])
    share = float(np.median(shares)) if shares else np.nan
    return True if 0.5 < share < 1.5 else False if abs(share) < 0.05 else None


def edge_near(bolts: Floats, table: DofTable) -> tuple[str, list[list[float]]] | None:
    """Component and box of the line of nodes along a row of bolts; None if the bolts are no row, or no node has that rotation.

    Parameters
    ----------
    bolts : (m, 3) float array
    table : DofTable
    """
    if len(bolts) < 2:
        return None
    extent = np.ptp(bolts, axis=0)
    axis = int(np.argmax(extent))
    component = f"ROT{'XYZ'[axis]}"
    turning = table.xyz[table.component == component]
    if np.sort(extent)[1] > 0.05 * extent[axis] or not len(turning):
        return None
    others = [k for k in range(3) if k != axis]
    pitch = float(extent[axis]) / (len(bolts) - 1)
    middle = bolts.mean(axis=0)
    nearest = turning[np.argmin(np.linalg.norm(turning[:, others] - middle[others], axis=1))]
    slack = 1e-4 * float(np.ptp(table.xyz, axis=0).max())
    box = [[0.0, 0.0]] * 3
    for k in others:
        box[k] = [float(nearest[k]) - slack, float(nearest[k]) + slack]
    box[axis] = [float(bolts[:, axis].min()) - pitch - slack, float(bolts[:, axis].max()) + pitch + slack]
    return component, box


def quantity_of(name: str) -> str | None:
    """Quantity by the beginning of a sensor's name; None if it is not known."""
    return next((quantity for start, quantity in QUANTITIES.items() if name.lower().startswith(start)), None)
