"""Bolts beside nodes that the model holds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sp

from lrbc_cli.campaign.reading.doubts.idle import clamped_beside
from lrbc_cli.model.dofs import DofTable, PointTable
from lrbc_cli.model.units import SI

#: Nodes 1 to 10 of a plate that bends, 0.1 m apart.
COMPONENTS = ("UZ", "ROTX", "ROTY")


def told(
    held: set[int], bolts: dict[str, int], *, component: str = "UZ", between: bool = False, components: tuple[str, ...] = COMPONENTS
) -> list[str]:
    """With UZ of some nodes held, and a spring along ``component`` at the node of each bolt."""
    rows = [(node, name) for node in range(1, 11) for name in components if (node, name) not in {(one, "UZ") for one in held}]
    xyz = np.array([[0.1 * node, 0.0, 0.0] for node, _ in rows])
    dofs = DofTable(node=np.array([node for node, _ in rows]), component=np.array([name for _, name in rows]), xyz=xyz)
    at = [rows.index((node, component)) for node in bolts.values()]
    left = sp.lil_array((len(rows), len(at)))
    for k, row in enumerate(at):
        left[row, k] = 1.0
        if between:
            left[rows.index((10, "ROTX")), k] = -1.0
    own = np.arange(len(at))
    group: Any = SimpleNamespace(name="axial", terms=own, bolt=own, parameter=own)
    model: Any = SimpleNamespace(terms=SimpleNamespace(left=left.tocsc()))
    table = PointTable(tuple(bolts), np.array([[0.1 * node, 0.0, 0.0] for node in bolts.values()]))
    return list(clamped_beside(model, [group], table, dofs, SI))


def test_a_boundary_condition_that_was_left_beside_a_bolt() -> None:
    (text,) = told({1}, {"B1": 2, "B2": 5, "B3": 8})
    assert text.startswith(
        "the model holds UZ of 1 node (x 0.1, y 0, z 0 m), 0.1 m or less from bolts whose springs act on it (B1): their loss changes "
        "little there."
    )
    assert "remove the boundary condition from the FE model" in text


def test_supports_away_from_bolts_and_springs_along_others() -> None:
    assert told({1}, {"B1": 4, "B2": 7}) == []
    assert told({1}, {"B1": 2, "B2": 5}, component="ROTX") == []
    assert told({1}, {"B1": 2, "B2": 5}, between=True) == []
    assert told(set(), {"B1": 2, "B2": 5}) == []
    # Nothing says what is near a single bolt.
    assert told({1}, {"B1": 2}) == []


def test_a_membrane_or_solid_without_rotations() -> None:
    """A node whose only component is held has no rows; nothing is known of it."""
    assert told({1}, {"B1": 2, "B2": 5}, components=("UZ",)) == []
