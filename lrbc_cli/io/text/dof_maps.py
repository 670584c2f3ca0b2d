"""Reads the DOF of each matrix row from files that FE programs write beside the matrix (CalculiX, Ansys), or from a table."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Integers
from lrbc_cli.errors import DataError
from lrbc_cli.io.common import damaged, require_file
from lrbc_cli.io.encoding import read_lines
from lrbc_cli.io.text.tables import read_table
from lrbc_cli.model.dofs import ACOUSTIC_COMPONENT, COMPONENTS, DofLabels

_CALCULIX = re.compile(r"\s*(\d+)\.(\d)\s*")
_EQUATION = re.compile(r"\s*(\d+)\s+(\d+)\s+([A-Za-z]\w*)\s*")

#: Usual components of a node by their number.
USUAL: dict[int, tuple[str, ...]] = {
    2: COMPONENTS[:2],
    3: COMPONENTS[:3],
    4: (*COMPONENTS[:3], ACOUSTIC_COMPONENT),
    6: COMPONENTS,
    7: (*COMPONENTS, ACOUSTIC_COMPONENT),
}


def read_dof_map(path: Path, n: int, components: Sequence[str] | None = None) -> tuple[DofLabels, tuple[str, ...]]:
    """Node and component of each matrix row.

    Parameters
    ----------
    path
        ``node.direction`` lines (CalculiX ``.dof``); lines of equation, node and label (Ansys ``HBMAT`` mapping); one node number per line
        after a header (Ansys ``*EXPORT`` of a nodal mapping vector), each for all DOFs of that node; or a CSV table ``dof,node,component``.
    n
        Number of rows of the matrices.
    components
        DOFs of each node in order, if the file names nodes only; None: the usual ones.

    Returns
    -------
    DofLabels, tuple of str
        Notes on what was assumed.

    Raises
    ------
    DataError
        If a line cannot be read, or the map does not fit the matrices.
    """
    with damaged(path, "DOF map"):
        labels, notes = _read(path, n, components)
    if labels.size != n:
        raise DataError(
            "the DOF map does not fit the matrices",
            file=path,
            expected=f"{n} DOFs",
            found=f"{labels.size}",
            hint="export matrices and map of one model in one run",
        )
    _once(labels, path)
    return labels, notes


def _read(path: Path, n: int, components: Sequence[str] | None) -> tuple[DofLabels, tuple[str, ...]]:
    require_file(path)
    numbered = [(k, line) for k, line in enumerate(read_lines(path), start=1) if line.strip() and line.lstrip()[0] not in "%#!"]
    first = numbered[0][1] if numbered else ""
    notes: tuple[str, ...] = ()
    if "," in first or "component" in first.lower():
        labels = _table(path)
    elif _CALCULIX.fullmatch(first):
        found = [_matched(_CALCULIX, line, path, k, "node.direction") for k, line in numbered]
        labels = _labels([int(m[1]) for m in found], [COMPONENTS[int(m[2]) - 1] if 0 < int(m[2]) < 7 else f"DOF{m[2]}" for m in found])
    elif _integers(first) is not None:
        labels, notes = _nodal(path, numbered, n, components)
    else:
        # The first line is a header.
        found = [_matched(_EQUATION, line, path, k, "equation, node and label such as UX") for k, line in numbered[1:]]
        order = np.argsort([int(m[1]) for m in found], kind="stable")
        labels = _labels([int(found[k][2]) for k in order], [found[k][3].upper() for k in order])
    return labels, notes


def _once(labels: DofLabels, path: Path) -> None:
    seen: set[tuple[int, str]] = set()
    for row, pair in enumerate(zip(labels.node.tolist(), labels.component.tolist(), strict=True), start=1):
        if pair in seen:
            raise DataError(
                "a DOF is given twice in the DOF map",
                file=path,
                place=f"row {row} of the matrices",
                expected="each component of a node once",
                found=f"node {pair[0]} {pair[1]}",
                hint="export matrices and map of one model in one run",
            )
        seen.add(pair)


def _labels(node: Sequence[int] | Integers, component: Sequence[str]) -> DofLabels:
    return DofLabels(np.asarray(node, dtype=np.int64), np.array(component, dtype=np.str_))


def _integers(line: str) -> list[int] | None:
    words = line.split()
    return [int(word) for word in words] if words and all(re.fullmatch(r"\d+", word) for word in words) else None


def _matched(pattern: re.Pattern[str], line: str, path: Path, number: int, expected: str) -> re.Match[str]:
    found = pattern.fullmatch(line)
    if found is None:
        raise DataError("a line of the DOF map cannot be read", file=path, place=f"line {number}", expected=expected, found=repr(line[:60]))
    return found


def _table(path: Path) -> DofLabels:
    table = read_table(path, ("dof", "node", "component"), ("x", "y", "z"))
    dof, node = table.integers("dof"), table.integers("node")
    if not np.array_equal(np.sort(dof), np.arange(dof.size)):
        raise DataError("the DOFs are not 0, 1, 2 ...", file=path, place="column 'dof'", expected=f"each of 0 to {dof.size - 1} once")
    order = np.argsort(dof)
    component = [cell.upper() for cell in table.text("component")]
    return _labels(node[order], [component[k] for k in order])


def _nodal(path: Path, numbered: list[tuple[int, str]], n: int, components: Sequence[str] | None) -> tuple[DofLabels, tuple[str, ...]]:
    """Labels from a list of nodes only: each node stands for all of its DOFs, in the order of the lines."""
    rows = [(k, _integers(line)) for k, line in numbered]
    wrong = next((k for k, row in rows if row is None), None)
    if wrong is not None:
        raise DataError("a line of the mapping vector cannot be read", file=path, place=f"line {wrong}", expected="a node number")
    numbers = [row for _, row in rows if row is not None]
    # A first line with several numbers is the size line of Matrix Market.
    nodes = np.array([row[0] for row in (numbers[1:] if len(numbers[0]) > 1 else numbers)], dtype=np.int64)
    unique, count = np.unique(nodes, return_counts=True)
    per_node = n // unique.size if unique.size else 0
    if (
        not unique.size
        or unique.size * per_node != n
        or nodes.size not in (unique.size, n)
        or (nodes.size == n and np.any(count != per_node))
    ):
        raise DataError(
            "the mapping vector does not fit the matrices",
            file=path,
            expected=f"the same number of DOFs at each node, {n} DOFs in all",
            found=f"{unique.size} nodes in {nodes.size} lines",
            hint="export the matrices in nodal order (NOD2BCS applied), or use HBMAT, whose mapping names each DOF",
        )
    labels = tuple(components) if components is not None else USUAL.get(per_node)
    if labels is None or len(labels) != per_node:
        raise DataError(
            "it is not clear which DOFs the nodes have",
            file=path,
            expected=f"{per_node} components of each node" + (", given by `components: [...]` beside `map:`" if labels is None else ""),
            found="no `components:`" if components is None else ", ".join(components),
        )
    notes = (f"DOF map: {unique.size} nodes, each {', '.join(labels)}",)
    if nodes.size == n:
        order = np.argsort(nodes, kind="stable")
        which = np.empty(n, dtype=np.int64)
        which[order] = np.tile(np.arange(per_node), unique.size)
        return _labels(nodes, [labels[k] for k in which]), notes
    return _labels(np.repeat(nodes, per_node), list(labels) * nodes.size), notes
