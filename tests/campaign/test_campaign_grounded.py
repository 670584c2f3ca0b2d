"""Springs of one table to ground, where those of another join the same nodes of the same bolts to others."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sp

from lrbc_cli.campaign.reading.doubts.springs import half_grounded

#: Two bolts between the nodes 1, 2 of a sheet and 11, 12 of another.
NODES = {1: 0, 2: 1, 11: 2, 12: 3}


def told(axial: list[tuple[int, ...]], rocking: list[tuple[int, ...]], *, one_bolt: bool = False) -> list[str]:
    """Of two tables, each with the nodes of the springs of the bolts in order."""
    ends = [*axial, *rocking]
    rows = [NODES[node] for spring in ends for node in spring]
    columns = [k for k, spring in enumerate(ends) for _ in spring]
    signs = [1.0 if at == 0 else -1.0 for spring in ends for at in range(len(spring))]
    left = sp.csc_array((signs, (rows, columns)), (4, len(ends)))

    def group(name: str, first: int, count: int) -> Any:
        select = SimpleNamespace(bushings=Path(f"bushings-{name}.csv"))
        terms, own = np.arange(first, first + count), np.arange(count)
        bolt = np.zeros_like(own) if one_bolt else own
        return SimpleNamespace(name=name, terms=terms, bolt=bolt, parameter=own, config=SimpleNamespace(select=select))

    groups = [group("axial", 0, len(axial)), group("rocking", len(axial), len(rocking))]
    model: Any = SimpleNamespace(terms=SimpleNamespace(left=left))
    dofs: Any = SimpleNamespace(node=np.array(list(NODES)))
    return list(half_grounded(model, groups, dofs))


def test_a_column_that_was_left_empty() -> None:
    (text,) = told([(1,), (2,)], [(1, 11), (2, 12)])
    assert text.startswith(
        "parameters.axial: springs of bushings-axial.csv go to ground, but those of rocking join the same nodes to other nodes "
        "(node 1 to 11). Check whether node_b was left empty, and fill it in."
    )


def test_the_other_end() -> None:
    assert "(node 11 to 1)" in told([(11,), (12,)], [(1, 11), (2, 12)])[0]


def test_springs_that_are_alike_and_one_that_holds_the_part() -> None:
    assert told([(1, 11), (2, 12)], [(1, 11), (2, 12)]) == []
    assert told([(1,), (2,)], [(1,), (2,)]) == []
    assert told([(1,), (2, 12)], [(1, 11), (2, 12)]) != []
    assert told([(1,), (12,)], [(2, 11)]) == []
    # In one table both are meant: who wrote them filled node_b in where it is wanted.
    assert told([(1,), (1, 11)], [], one_bolt=True) == []
