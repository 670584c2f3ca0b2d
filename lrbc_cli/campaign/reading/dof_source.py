"""Numbering of the matrix rows: the DOF table of a model, from one table, or from labels of matrices, maps and node coordinates."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.config.structure import DofSource
from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.encoding import decode
from lrbc_cli.io.matrices.read import read_vectors
from lrbc_cli.io.meshes.nodes import read_nodes
from lrbc_cli.io.sparse import MatrixFile
from lrbc_cli.io.text.dof_maps import USUAL, read_dof_map
from lrbc_cli.io.text.tables import is_dof_table, read_dof_table
from lrbc_cli.model.dofs import COMPONENTS, DofLabels, DofTable
from lrbc_cli.model.selection import pitch

#: Least number of DOFs, and largest share of non-zero entries, for tests of the order: otherwise all DOFs are neighbours.
LEAST_DOFS, MOST_FILLED = 100, 0.3

#: Number of matrix entries examined: enough for mean distances to one per cent.
ENTRIES = 50_000

#: Ratio of the median distance of connected DOFs to that of any two DOFs above which they are no neighbours.
FAR = 0.8

#: Another order is reported if it reduces the mean distance of connected DOFs below this share.
NEARER = 0.5

#: Share of rows without force under a rigid translation (none is loaded away from supports): at most in a wrong order, least in the right.
FEW, MANY = 0.05, 0.3

#: Elements that CalculiX expands to solids with its own nodes: shells, beams, trusses, plane and axisymmetric ones.
_EXPANDED = re.compile(r"\*ELEMENT\b.*TYPE\s*=\s*(S\d|M3D|B\d|T[23]D|CP[SE]|CAX)", re.IGNORECASE)


@dataclass(kw_only=True)
class Numbering:
    """Meaning of the matrix rows.

    Attributes
    ----------
    table : DofTable or None
        Node, component and coordinates of each row; None without coordinates.
    labels : DofLabels or None
        Node and component of each row, if known.
    notes : list of str
    files : list of Path
        Files that were read.
    lacking : Path or None
        The file of coordinates, if it lacks nodes of the matrices.
    spare : (k,) int array
        Nodes with coordinates but without rows.
    """

    table: DofTable | None = None
    labels: DofLabels | None = None
    notes: list[str] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)
    lacking: Path | None = None
    spare: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


def numbering(source: Path | DofSource | None, stiffness: MatrixFile) -> Numbering:
    """Numbering of the rows of the stiffness matrix.

    Parameters
    ----------
    source : Path or DofSource or None
        ``model.dofs``.
    stiffness : MatrixFile
        Its labels are used if no map is given.

    Raises
    ------
    DataError
        If a file is wrong, the meaning of the rows is unknown, or a node has no coordinates.
    """
    if source is None:
        return Numbering(labels=stiffness.labels)
    if isinstance(source, Path):
        if is_dof_table(source):
            table = read_dof_table(source)
            return Numbering(table=table, labels=DofLabels(table.node, table.component), files=[source])
        source = DofSource.model_construct(nodes=source)
    found = Numbering(labels=stiffness.labels, files=[source.nodes])
    n = stiffness.matrix.shape[0]
    if source.map is not None:
        found.labels, notes = _mapped(source.map, source, n)
        found.notes += notes
        found.files += [source.map, *([source.order] if source.order else [])]
    node, xyz, what = read_nodes(source.nodes)
    found.notes.append(f"coordinates: {node.size} nodes, {what}")
    if found.labels is None:
        components = source.components
        if components is None or node.size * len(components) != n:
            raise DataError(
                "the DOF of each matrix row is not given",
                file=source.nodes,
                expected=f"a map of the {n} rows, or `components:`, the DOFs of each of the {node.size} nodes",
                found="no map" if components is None else f"{node.size} nodes with {len(components)} components",
                hint=f"add `map: FILE` under model.dofs{_guess(n, node.size)}; `lrbc guide export` says what each program writes",
            )
        order = np.sort(node)
        found.labels = DofLabels(np.repeat(order, len(components)), np.tile(np.array(components, dtype=np.str_), order.size))
        found.notes.append(f"rows: nodes in ascending order, each {', '.join(components)} (not confirmed by any file)")
    _place(found, node, xyz, source.nodes)
    return found


def _mapped(path: Path, source: DofSource, n: int) -> tuple[DofLabels, tuple[str, ...]]:
    """Labels of the rows from a map, and notes; ``source.order`` converts the order of the map to that of the solver."""
    if source.order is None:
        return read_dof_map(path, n, source.components)
    order = read_vectors(source.order).matrix
    order = order.T.tocsc() if order.shape[0] == n else order
    if order.shape[1] != n or np.any(np.diff(order.indptr) != 1):
        wrong = "" if order.shape[1] != n else f", {int((np.diff(order.indptr) != 1).sum())} rows do not have exactly one entry"
        raise DataError(
            "the order matrix (`order:`) does not fit the model matrices",
            file=source.order,
            expected=f"{n} rows with one entry each: the position of each row in the map",
            found=f"{order.shape[1]} x {order.shape[0]}{wrong}",
            hint="export NOD2BCS from the same .full file; constraint equations and couplings have no single DOF: use HBMAT",
        )
    labels, notes = read_dof_map(path, order.shape[0], source.components)
    return DofLabels(labels.node[order.indices], labels.component[order.indices]), notes


def _guess(n: int, nodes: int) -> str:
    usual = USUAL.get(n // nodes) if n % nodes == 0 else None
    return f", or `components: [{', '.join(usual)}]`" if usual else ""


def _place(found: Numbering, node: Integers, xyz: Floats, path: Path) -> None:
    """Add the DOF table; internal DOFs, which the FE program added, are placed at the centre of all nodes."""
    labels = found.labels
    assert labels is not None
    order = np.argsort(node)
    at = np.minimum(np.searchsorted(node[order], labels.node), node.size - 1)
    known = node[order][at] == labels.node
    # Numbers beyond those of the model: incompatible modes and expanded shells of CalculiX.
    inner = ~known & ((labels.node < 0) | (labels.node > node.max()))
    lost = np.unique(labels.node[~known & ~inner])
    if lost.size or not known.any():
        raise DataError(
            f"{lost.size or 'all'} nodes of the matrices have no coordinates",
            file=path,
            expected="every node of the matrices",
            found=f"no {listing([str(k) for k in lost], 5)}",
            hint="give the nodes of the model that the matrices were exported from",
        )
    component = labels.component.astype(object)
    if inner.any():
        component[inner] = [name if name.startswith("INNER") else f"INNER{name}" for name in component[inner]]
        found.lacking = path
    places = np.where(known[:, None], xyz[order][at], xyz.mean(axis=0))
    found.spare = np.setdiff1d(node, labels.node)
    found.labels = DofLabels(labels.node, component.astype(np.str_))
    found.table = DofTable(node=labels.node, component=found.labels.component, xyz=places)


def added_nodes(K: sp.csc_array, found: Numbering) -> tuple[str, str]:
    """Note on internal nodes without coordinates, or warning if they are ordinary nodes; both empty if there are none.

    At an ordinary node a rigid translation causes no force, at an incompatible mode it does. Nodes of expanded shells and beams behave as
    ordinary ones, although the FE program added them.

    Parameters
    ----------
    K : (n, n) csc_array
    found : Numbering
        Of n rows.
    """
    dofs, file = found.table, found.lacking
    if dofs is None or file is None:
        return "", ""
    inner = np.char.startswith(dofs.component, "INNER")
    nodes = np.unique(dofs.node[inner])
    at_rest, moved = 0, 0
    for label in COMPONENTS[:3]:
        motion = np.isin(dofs.component, (label, f"INNER{label}")).astype(float)
        force, size = (np.abs(A @ motion)[dofs.component == f"INNER{label}"] for A in (K.real, np.abs(K)))
        at_rest += int(((force < 1e-6 * size) & (size > 0.0)).sum())
        moved += int((size > 0.0).sum())
    if 2 * at_rest > moved and not _EXPANDED.search(decode(file.read_bytes())):
        names = found.files[1].name if len(found.files) > 1 else "the stiffness matrix"
        return "", (
            f"{names} contains {nodes.size} nodes ({nodes[0]} to {nodes[-1]}) that are missing in {file.name}, so no point is found at "
            f"them. Check whether {file.name} is the input that the matrices were exported from. Give the file that contains these nodes "
            "under model.dofs.nodes"
        )
    return f"{int(inner.sum())} DOFs of {nodes.size} nodes that are not in {file.name} are internal DOFs of the FE program", ""


def aligned(found: MatrixFile, labels: DofLabels | None, n: int, path: Path, what: str) -> sp.csc_array:
    """Matrix of a file with rows and columns in the order of the model.

    Raises
    ------
    DataError
        If it has a DOF that the model does not have.
    """
    if found.labels is not None and labels is not None:
        at = labels.find(found.labels)
        lost = np.flatnonzero(at < 0)
        if lost.size:
            k = int(lost[0])
            raise DataError(
                f"the {what} matrix has DOFs that the model does not have",
                file=path,
                expected="DOFs of the stiffness matrix or the DOF table",
                found=f"node {found.labels.node[k]} {found.labels.component[k]} ({lost.size} in all)",
                hint="export all matrices and tables of one model in one run",
            )
        entries = found.matrix.tocoo()
        moved = sp.coo_array((entries.data, (at[entries.row], at[entries.col])), shape=(labels.size, labels.size)).tocsc()
        moved.sort_indices()
        return moved
    matrix = found.matrix
    if not found.sized and max(matrix.shape) < n:
        matrix = sp.csc_array(matrix)
        matrix.resize((n, n))
    return matrix


def order_doubt(K: sp.csc_array, dofs: DofTable, source: Path | DofSource | None = None) -> str | None:
    """Warning if the rows are in another order than the DOF table; else None.

    Parameters
    ----------
    K : (n, n) csc_array
    dofs : DofTable
        Of n rows.
    source : Path or DofSource or None
        Source of the table.
    """
    n = dofs.size
    if n < LEAST_DOFS or K.nnz > MOST_FILLED * n * n:
        return None
    own = _at_rest(K, dofs.component)
    for text, order in _other_orders(dofs) if own < FEW else ():
        if _at_rest(K, dofs.component[order]) > MANY:
            return (
                f"probably the rows of the matrices are in another order ({text}) than the DOF table: in the order of the table a rigid "
                f"translation would cause forces at {1 - own:.0%} of all DOFs. Sort the table {text}, and renumber its column dof from 0"
            )
    # Internal DOFs have no real place.
    given = np.flatnonzero(~np.char.startswith(dofs.component, "INNER"))
    entries, xyz = K[given][:, given].tocoo(), dofs.xyz[given]
    # A sample of very many entries suffices, the same one for each order.
    some = slice(None) if entries.nnz <= ENTRIES else np.random.default_rng(0).integers(entries.nnz, size=ENTRIES)
    connected = entries.row[some], entries.col[some]
    apart = _distances(xyz, *connected)
    anew = _sorted_anew(dofs, given, connected, float(apart.mean()), isinstance(source, DofSource))
    if anew is not None:
        return anew
    # Distances within one node are ignored.
    apart, usual = apart[apart > 0.0], float(np.median(_distances(xyz, *np.random.default_rng(0).integers(len(xyz), size=(2, 4096)))))
    if not apart.size or (near := float(np.median(apart))) < FAR * usual:
        return _against_text(K, dofs.component, source)
    return (
        f"the stiffness matrix connects DOFs that are {near:.3g} m apart, as far as any two of the model (node spacing {pitch(xyz):.3g} "
        f"m): {_solver_order(source) or 'the DOF table is of another model or in another order. Export matrices and table in one run'}"
    )


def _sorted_anew(dofs: DofTable, given: Integers, connected: tuple[Integers, Integers], own: float, meshed: bool) -> str | None:
    """Warning if the table was sorted and numbered anew: in another order, connected DOFs are much nearer to each other; else None."""
    places = dict(zip("xyz", dofs.xyz[given].T, strict=True))
    axes = [axis for axis, values in places.items() if np.ptp(values) > 0.0]
    orders = {
        "by node number": np.argsort(dofs.node[given], kind="stable"),
        **{f"by {', then '.join(way)}": np.lexsort([places[axis] for axis in reversed(way)]) for way in permutations(axes)},
    }
    mean = {text: float(_distances(dofs.xyz[given[order]], *connected).mean()) for text, order in orders.items()}
    # A sorted table keeps the node of each row; coordinates of another numbering do not belong to the nodes, and sorting does not help.
    by_node = mean["by node number"] <= NEARER * own
    text = "by node number" if by_node else min(mean, key=lambda name: mean[name])
    if mean[text] > NEARER * own:
        return None
    causes = (
        "Check whether the table was sorted in a spreadsheet and its column dof filled down again. Use the table as it was exported, or "
        f"sort its rows {text} and then number the column dof from 0"
        if by_node
        else "The coordinates are probably those of another numbering of the nodes. Export matrices and DOF table of one model in one run"
    )
    if meshed:
        causes = (
            "Check whether the file of nodes belongs to another mesh, or the mapping to another run. Export matrices, mapping and nodes "
            "of one model"
        )
    return (
        f"probably the rows of the matrices are sorted {text}, but the DOF table is not: DOFs that the stiffness matrix connects are "
        f"{own:.3g} m apart on average, sorted {text} {mean[text]:.3g} m. {causes}"
    )


def _solver_order(source: Path | DofSource | None) -> str | None:
    """Hint if the source is an Ansys mapping without ``order``, as matrices in Matrix Market format are in the solver's order."""
    if not isinstance(source, DofSource) or source.map is None or source.order is not None:
        return None
    if not source.map.read_bytes()[:14].lower().startswith(b"%%matrixmarket"):
        return None
    return (
        f"probably the rows of the matrices are in the solver's order, but {source.map.name} lists nodes in the order of the model. Also "
        "export NOD2BCS from the same .full file, and give it as model.dofs: {map: ..., order: NOD2BCS.mtx, nodes: ...} "
        "(`lrbc guide export`)"
    )


def _at_rest(K: sp.csc_array, component: np.ndarray) -> float:
    """Share of the translational rows at which a rigid translation causes no force."""
    rest, all_rows = 0, 0
    for label in COMPONENTS[:3]:
        moved = (component == label).astype(float)
        force, size = np.abs(K.real @ moved), np.abs(K) @ moved
        rest += int(((force < 1e-6 * size) & (size > 0.0)).sum())
        all_rows += int((size > 0.0).sum())
    return rest / all_rows if all_rows else 1.0


def _against_text(K: sp.csc_array, component: np.ndarray, source: Path | DofSource | None, *, clear: float = 0.01) -> str | None:
    """Warning if a rigid translation causes forces nearly everywhere, and many that push on in its direction, as no support does.

    Rows in the order of a solver have near neighbours, too, so distances do not show them.

    Parameters
    ----------
    K : (n, n) csc_array
    component : (n,) array of str
    source : Path or DofSource or None
        See ``order_doubt``.
    clear : float
        Least force relative to the sum of magnitudes in the row; few digits, or the forces of rotating frames, cause smaller ones.
    """
    loaded, against, known = 0, 0, 0
    for label in COMPONENTS[:3]:
        moved = component == label
        force, size = (A[moved] @ moved.astype(float) for A in (K.real, np.abs(K)))
        loaded, against = loaded + int((np.abs(force) > clear * size).sum()), against + int((force < -clear * size).sum())
        known += int((size > 0.0).sum())
    if not known or loaded <= (1.0 - MANY) * known or against <= FEW * known:
        return None
    return (
        f"probably the rows of the matrices are in another order than the DOF table: a rigid translation would cause forces at "
        f"{loaded / known:.0%} of the translational DOFs, at {against / known:.0%} of them in its own direction, as no support does. "
        + (
            _solver_order(source)
            or "Matrices are often in the order of the solver, tables in that of the nodes: export the DOF table in the order of the "
            "rows, or give the file with which the FE program maps rows to nodes (model.dofs: {map: FILE, nodes: FILE}; `lrbc guide "
            "export`), of the same run as the matrices. If the DOFs of each node are in axes of their own, export them in global axes"
        )
    )


def _other_orders(dofs: DofTable) -> list[tuple[str, Integers]]:
    """Usual orders of rows, as permutations of the table."""
    rank = np.array([COMPONENTS.index(label) if label in COMPONENTS else len(COMPONENTS) for label in dofs.component.tolist()])
    by_node = np.lexsort((dofs.component, rank, dofs.node))
    inside = bool(np.array_equal(dofs.node[by_node], dofs.node))
    ranked = ", ".join(sorted(dict.fromkeys(dofs.component.tolist()), key=lambda label: (*COMPONENTS, label).index(label)))
    return [
        (f"{ranked} in each node" if inside else "node by node", by_node),
        ("component by component", np.lexsort((dofs.node, dofs.component, rank))),
    ]


def _distances(xyz: Floats, one: Integers, two: Integers) -> Floats:
    return np.asarray(np.linalg.norm(xyz[one] - xyz[two], axis=1))


def unfitting(lines: int, rows: int) -> str:
    """Hint for a DOF table whose number of lines differs from the number of matrix rows."""
    other = "otherwise export matrices and DOF table of one model in one run"
    if lines > rows:
        return (
            f"it has {lines - rows} lines more than the matrices have rows: probably those of fixed or tied DOFs, which matrices do not "
            f"contain. Remove these lines and number the others from 0, in the order of the rows; {other}"
        )
    return (
        f"it has {rows - lines} lines fewer than the matrices have rows: it lacks DOFs (of nodes or fields that were left out), or the "
        f"matrices contain fixed DOFs. List every row; {other}"
    )
