"""The matrix of a part of the structure given as the stiffness: named with the matrix of the whole that the file also contains."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import Folder
from matrix_files import write_matrix_hdf5


def told(frame: Folder, share: float, *, group: str = "", **also: str) -> list[str]:
    """Warnings of the frame whose stiffness lacks a share of the nodes; ``also``: further matrices by name."""
    model, dofs = frame.inputs().model, frame.inputs().dofs
    assert dofs is not None
    there = dofs.node > np.quantile(dofs.node, share)
    part = sp.diags_array(there.astype(float)) @ model.K @ sp.diags_array(there.astype(float))
    whole = {name: {"K": model.K, "M": model.M}[what] for what, name in also.items()}
    write_matrix_hdf5(frame.data / "model.h5", {"part": part, "M": model.M, **whole})
    frame.replace("data/model/stiffness.mtx ", "data/model.h5#part ")
    frame.replace("data/model/mass.mtx.gz", "data/model.h5#M")
    frame.replace("  factors: [stiffness.structure", f"{group}  factors: [stiffness.structure")
    return [text for text in frame.inputs().warnings if text.startswith(("model.stiffness", "model.mass", "model.damping"))]


def test_the_matrix_of_the_whole_is_named(frame: Folder) -> None:
    (text,) = told(frame, 0.5, K="K", M="M_2")
    assert "nodes the matrix has only empty rows, although they have a mass" in text
    assert text.endswith("model.h5 also contains K, which nothing uses: write model.stiffness: data/model.h5#K")


def test_a_part_that_the_calibration_names(frame: Folder) -> None:
    (text,) = told(frame, 0.2, group="  groups: {rim: {stiffness: data/model.h5#part}}\n")
    assert "model.h5#part is probably a part of the stiffness, as calibration.groups.rim says of it. Export the stiffness" in text


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_few_masses_that_nothing_holds_are_possible(frame: Folder, share: float) -> None:
    assert told(frame, share, K="K") == []
