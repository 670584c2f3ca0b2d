"""Detects names of bolts that were sorted in a spreadsheet without their coordinates, or that a table of springs lacks."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from lrbc_cli.errors import listing
from lrbc_cli.io.text.bushings import BushingTable
from lrbc_cli.model.dofs import COMPONENTS, DofTable, PointTable
from lrbc_cli.model.selection import at_node

#: What tells the springs of a bolt apart: table, component, and whether they go to ground.
_Sort = tuple[Path, str, bool]

#: Nodes of a spring; None is ground.
_Ends = tuple[int, int | None]


def sorted_names(bolts: PointTable | None) -> Iterator[str]:
    """Warning if the names of bolts in a row are in alphabetical order (1, 10, 11 ... 2) instead of that of their numbers.

    Parameters
    ----------
    bolts : PointTable or None
    """
    if bolts is None or not len(set(bolts.name)) == len(bolts.name) >= 3:
        return
    away = bolts.xyz - bolts.xyz.mean(axis=0)
    along = away @ np.linalg.svd(away, full_matrices=False)[2][0]
    row = [bolts.name[k] for k in np.argsort(along, kind="stable")]
    row = row if row[0] <= row[-1] else row[::-1]

    def counted(name: str) -> list[tuple[str, int]]:
        return [(word, int(number or 0)) for word, number in re.findall(r"(\D*)(\d*)", name)]

    by_number = sorted(row, key=counted)
    if row == sorted(row) and row != by_number:
        at = next(k for k in range(len(row)) if row[k] != by_number[k])
        yield (
            f"bolts: {', '.join(row[max(at - 1, 0) : at + 3])} ... lie in a row in alphabetical order. Check whether the names were sorted "
            "in a spreadsheet without their coordinates, and give each bolt its own place. If the bolts are really named in this order, "
            "ignore this warning"
        )


@dataclass
class _Springs:
    """Springs of one bolt: their nodes and stiffnesses by sort."""

    ends: dict[_Sort, list[_Ends]] = field(default_factory=dict)
    stiffness: dict[_Sort, list[float]] = field(default_factory=dict)

    def like(self, peers: Sequence[_Springs], *, rounding: float = 1e-6) -> bool:
        """Whether its springs are of the same sorts as some of its peers' and no stiffer or softer, so that only lines are missing."""

        def within(sort: _Sort, values: Sequence[float]) -> bool:
            usual = [value for peer in peers for value in peer.stiffness[sort]]
            return (1.0 - rounding) * min(usual) <= min(values) and max(values) <= (1.0 + rounding) * max(usual)

        return self.ends.keys() < peers[0].ends.keys() and all(within(sort, values) for sort, values in self.stiffness.items())


def missing_springs(
    tables: Sequence[BushingTable], dofs: DofTable, misnamed: Collection[str] = (), *, least: int = 4, few: float = 0.2
) -> Iterator[str]:
    """Warnings about bolts that lack springs in a table, although they have the springs of the other bolts in another table.

    Such lines are easily forgotten, and the bolt is then held less than the others in all states. A table may serve some bolts only, so
    nearly all must be alike, and the bolts that lack springs must have neither other springs nor other stiffnesses than those.

    Parameters
    ----------
    tables : sequence of BushingTable
        Of the groups, in the units of the files; as often as a group selects a component of it.
    dofs : DofTable
    misnamed : collection of str
        Bolts whose springs were found under the name of another bolt.
    least : int
        Least number of bolts that have all springs.
    few : float
        Largest number of bolts that lack springs, as a share of those that have all.
    """
    bolts: dict[str, _Springs] = {}
    for table in tables:
        each = zip(table.bolt, table.node_a.tolist(), table.node_b, table.component, table.stiffness.tolist(), strict=True)
        for bolt, a, b, component, stiffness in each:
            own, sort = bolts.setdefault(bolt, _Springs()), (table.path, component, b is None)
            own.ends.setdefault(sort, []).append((a, b))
            own.stiffness.setdefault(sort, []).append(stiffness)
    usual, count = Counter(frozenset(own.ends) for own in bolts.values()).most_common(1)[0] if bolts else (frozenset[_Sort](), 0)
    peers = {name: own for name, own in bolts.items() if own.ends.keys() == usual}
    short = {name: own for name, own in bolts.items() if name not in peers and name}
    if count < least or len(short) > few * count or not all(own.like(list(peers.values())) for own in short.values()):
        return
    plain = all(np.allclose(table.axes, np.eye(3)) for table in tables)
    for path in dict.fromkeys(table.path for table in tables):
        for name, own in short.items():
            lacking = sorted((sort for sort in usual - own.ends.keys() if sort[0] == path), key=lambda sort: COMPONENTS.index(sort[1]))
            lacking = [sort for sort in lacking if _movable(own, sort, dofs, plain)]
            if lacking and name not in misnamed:
                yield _missing_text(name, own, lacking, peers, plain)


def odd_springs(tables: Sequence[BushingTable], *, least: int = 4, share: float = 0.8, rounding: float = 0.01) -> Iterator[tuple[str, str]]:
    """Warnings about springs whose stiffness is a power of ten times that of nearly all others of their component, as by a digit too few.

    Each with its bolt, which is empty for a spring without one.

    Parameters
    ----------
    tables : sequence of BushingTable
    least, share : int, float
        Least number of springs of a component, and least share of them that are equal.
    rounding : float
        Largest relative difference from the power of ten.
    """
    for table in {table.path: table for table in tables}.values():
        for component in dict.fromkeys(table.component):
            at = [k for k, own in enumerate(table.component) if own == component]
            values = table.stiffness[at]
            usual, count = Counter(values.tolist()).most_common(1)[0]
            if len(at) < least or count < share * len(at) or usual <= 0.0:
                continue
            for k, value in zip(at, values.tolist(), strict=True):
                power = round(np.log10(value / usual)) if value > 0.0 else 0
                if power and abs(value / (usual * 10.0**power) - 1.0) <= rounding:
                    text = (
                        f"{table.path.name}, line {table.lines[k]}: {component} of {table.bolt[k] or 'a spring'} is {10.0**power:g} times "
                        f"the {usual:g} of the others. Check whether a digit is wrong; if it is right, nothing needs to be done"
                    )
                    yield table.bolt[k] or "", text


def _ends_of(own: _Springs, ground: bool) -> list[_Ends]:
    """Nodes of the other springs of a bolt, of those that go to ground or of those that do not."""
    return list(dict.fromkeys(ends for sort, every in own.ends.items() if sort[2] == ground for ends in every))


def _movable(own: _Springs, sort: _Sort, dofs: DofTable, plain: bool) -> bool:
    """Whether the nodes of a bolt have the DOFs that a missing spring needs: an export without them leaves no place for it."""
    first = 3 * (COMPONENTS.index(sort[1]) // 3)
    named = [sort[1]] if plain else COMPONENTS[first : first + 3]
    ends = _ends_of(own, sort[2])
    return bool(ends) and all(any(at_node(dofs, node, name).size for name in named) for each in ends for node in each if node is not None)


def _missing_text(name: str, own: _Springs, lacking: Sequence[_Sort], peers: dict[str, _Springs], plain: bool, *, most: int = 6) -> str:
    """Warning about the springs that a bolt lacks in one table, with the lines to be added."""
    path, components = lacking[0][0], listing([sort[1] for sort in lacking])
    others = listing(list(dict.fromkeys(f"{sort[1]} in {sort[0].name}" for sort in own.ends)), 3)
    first, peer = next(iter(peers.items()))
    lines = list[str]()
    for sort in lacking:
        values = sorted({value for each in peers.values() for value in each.stiffness[sort]})
        ends = _ends_of(own, sort[2])
        if plain and len(values) == 1 and len(ends) == len(peer.ends[sort]):
            lines += [f"{name},{a},{'' if b is None else b},{sort[1]},{values[0]:g}" for a, b in ends]
    shown = f"{'; '.join(lines[:most])}{' ...' if len(lines) > most else ''}"
    whole = len(lines) >= len(lacking)
    added = f": {shown} (bolt,node_a,node_b,component,stiffness)" if whole else f", as those of {first} there, at the nodes of {name}"
    return (
        f"{path.name}: no {components} spring of {name}, although all {len(peers)} other bolts of its kind have one there; {name} has "
        f"{others}. Check whether its lines were forgotten. If so, add {'them' if max(len(lines), len(lacking)) > 1 else 'it'}{added}"
    )
