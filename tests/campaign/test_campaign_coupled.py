"""Coordinates of structural nodes in another order than the matrices, beside a cavity."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from lrbc_cli.campaign.reading.doubts.coupled import coupled_doubt
from lrbc_cli.model.dofs import DofTable

COUNT = 40
ROW = 0.05 * np.arange(COUNT)
PLATE = np.column_stack([ROW, np.zeros((COUNT, 2))])
NODE = np.concatenate([np.arange(COUNT), np.arange(COUNT)])
COMPONENT = np.repeat(["UZ", "PRES"], COUNT)


def told(structure: np.ndarray) -> str | None:
    """A row of plate nodes, each coupled to the air node above it."""
    entries = np.ones(COUNT), (np.arange(COUNT), COUNT + np.arange(COUNT))
    K = sp.csc_array(entries, (2 * COUNT, 2 * COUNT))
    dofs = DofTable(node=NODE, component=COMPONENT, xyz=np.concatenate([structure, PLATE + np.array([0.0, 0.0, 0.01])]))
    return coupled_doubt(K, sp.csc_array(K.T), dofs, "dofs.csv")


def test_structure_and_air_lie_at_the_same_places() -> None:
    assert told(PLATE) is None


def test_structural_nodes_in_reverse_order() -> None:
    text = str(told(PLATE[::-1]))
    assert "these couple structure and air at DOFs that are 1 m apart in dofs.csv (median, node spacing 0.05 m)" in text
    assert "With the structural nodes in reverse order it is 0.01 m" in text


def test_structural_nodes_in_any_other_order() -> None:
    text = str(told(np.random.default_rng(0).permutation(PLATE)))
    assert "Export matrices and DOF table of one model in one run" in text
    assert "reverse order" not in text


def test_without_air_there_is_nothing_to_compare() -> None:
    dofs = DofTable(node=np.arange(3), component=np.full(3, "UZ"), xyz=np.eye(3))
    assert coupled_doubt(sp.csc_array(np.eye(3)), sp.csc_array(np.eye(3)), dofs, "dofs.csv") is None
