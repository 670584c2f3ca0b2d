"""Responses that nothing connects with the hammer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from campaigns import Folder, box

from lrbc_cli.campaign.reading.inputs import read_as_exported
from lrbc_cli.campaign.reading.reach import require_reach
from lrbc_cli.config import load_campaign
from lrbc_cli.errors import DataError
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.fem import FeModel
from lrbc_cli.model.terms import LowRankTerms

STRUCTURE = 8


def without_coupling(tmp_path: Path, names: str, at: int = STRUCTURE) -> Folder:
    """The box without the entries of these matrices between the first DOFs and the others."""
    folder = box(tmp_path)
    for path in (folder.data / f"{name}.mtx" for name in names):
        matrix = scipy.io.mmread(path).toarray()
        matrix[:at, at:] = matrix[at:, :at] = 0.0
        scipy.io.mmwrite(path, matrix, symmetry="general", precision=17)
    return folder


def test_a_coupling_that_was_not_exported_is_told_as_one(tmp_path: Path) -> None:
    folder = without_coupling(tmp_path, "KM")
    with pytest.raises(DataError, match="mic1 to excitation hammer is zero: no entry of the matrices couples structure and air") as told:
        read_as_exported(load_campaign(folder.config))
    assert "export the matrices of the coupled model" in str(told.value)


def test_a_block_of_the_coupling_that_was_not_exported_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="mic1 to excitation hammer is zero: structure and air are coupled one way only") as told:
        read_as_exported(load_campaign(without_coupling(tmp_path, "M").config))
    assert "entries in the rows of displacements of the stiffness matrix, none in those of pressures of the mass matrix" in str(told.value)
    assert "export the mass matrix with the coupling" in str(told.value)


def test_a_structure_that_does_not_feel_the_air_is_told(tmp_path: Path) -> None:
    said = read_as_exported(load_campaign(without_coupling(tmp_path, "K").config)).warnings
    assert any(
        text.startswith("the structure does not feel the air: ") and text.endswith("Export the stiffness matrix with the coupling")
        for text in said
    )
    assert not any("does not feel" in text for text in read_as_exported(load_campaign(box(tmp_path / "right").config)).warnings)


def test_a_piece_of_the_air_alone_is_one_of_several(tmp_path: Path) -> None:
    folder = without_coupling(tmp_path, "KM", 22)
    with pytest.raises(DataError, match="mic3 to excitation hammer is zero: nothing in the matrices connects them") as told:
        read_as_exported(load_campaign(folder.config))
    assert "2 separate pieces" in str(told.value)
    assert "the DOF table is not in the order of the matrices" in str(told.value)


def test_directions_that_nothing_couples_are_no_separate_parts() -> None:
    """A straight beam of two nodes: its motions along UY and UZ are independent, though its mesh is in one piece."""
    K = sp.csc_array(np.kron([[2.0, -1.0], [-1.0, 2.0]], np.eye(2)))
    unit = sp.csc_array(np.eye(4))
    model = FeModel(
        K=K, C=0.0 * K, M=sp.csc_array(np.eye(4)), B=unit[:, [0]], L=unit[[2, 3]], output_power=np.zeros(2, dtype=np.int64),
        is_acoustic=np.zeros(4, dtype=bool),
        terms=LowRankTerms(left=unit[:, [3]], right=unit[:, [3]], power=np.zeros(1, dtype=np.int64), baseline=np.zeros(1)),
    )  # fmt: skip
    dofs = DofTable(node=np.array([1, 1, 2, 2]), component=np.array(["UY", "UZ"] * 2), xyz=np.zeros((4, 3)))
    with pytest.raises(DataError, match="response z to excitation h is zero: it and the hammer act along directions") as told:
        require_reach(model, [("y", 0), ("z", 0)], ["h"], dofs)
    assert "correct the component of the response or of the hammer" in str(told.value)
    apart = replace(dofs, node=np.array([1, 2, 3, 4]))
    with pytest.raises(DataError, match="response z to excitation h is zero: nothing in the matrices connects them"):
        require_reach(model, [("y", 0), ("z", 0)], ["h"], apart)
