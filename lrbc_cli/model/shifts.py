"""Derivatives of a point load with respect to the position of the hammer, for the nuisance parameter *offset of the hammer point*."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Floats
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.selection import at_node

AXES = "XYZ"

#: By (direction a of the load, direction b of the shift): ``du_a/db = sign * rotation`` of a rigid cross-section, u = theta x r.
SLOPES = {
    ("X", "Z"): ("ROTY", 1.0),
    ("X", "Y"): ("ROTZ", -1.0),
    ("Y", "X"): ("ROTZ", 1.0),
    ("Y", "Z"): ("ROTX", -1.0),
    ("Z", "Y"): ("ROTX", 1.0),
    ("Z", "X"): ("ROTY", -1.0),
}

#: Number of neighbours through which a gradient is fitted if the node has no rotations.
NEIGHBOURS = 8


def load_shifts(table: DofTable, dof: int) -> tuple[Floats, tuple[str, str]] | None:
    """Derivatives of a unit load on a translation with respect to shifts of its point along the two other axes.

    A load is work-conjugate to the displacement at its point, so its derivatives follow from the gradient of the displacement: given by
    the rotations of the node, or by a plane fitted through the nearest nodes with the same component.

    Parameters
    ----------
    table : DofTable
    dof : int
        A DOF with component UX, UY or UZ.

    Returns
    -------
    (n, 2) float array and the two directions, or None
        Load vectors [N/m]; None if the DOF is not a translation or has no neighbours in both directions.
    """
    component = str(table.component[dof])
    if len(component) != 2 or component[0] != "U" or component[1] not in AXES:
        return None
    normal = component[1]
    along = tuple(axis for axis in AXES if axis != normal)
    columns = np.zeros((table.size, 2))
    rotations = [at_node(table, int(table.node[dof]), SLOPES[normal, axis][0]) for axis in along]
    if all(found.size == 1 for found in rotations):
        for i, (axis, found) in enumerate(zip(along, rotations, strict=True)):
            columns[found[0], i] = SLOPES[normal, axis][1]
        return columns, (along[0], along[1])
    plane = [AXES.index(axis) for axis in along]
    same = np.flatnonzero(table.component == component)
    offset = table.xyz[same][:, plane] - table.xyz[dof][plane]
    depth = np.abs(table.xyz[same][:, AXES.index(normal)] - table.xyz[dof][AXES.index(normal)])
    distance = np.hypot(*offset.T) + depth
    near = [int(i) for i in np.argsort(distance, kind="stable") if same[i] != dof and distance[i] > 0][:NEIGHBOURS]
    if len(near) < 2:
        return None
    weight = 1.0 / distance[near]
    fit = np.linalg.pinv(weight[:, None] * offset[near])
    if np.linalg.matrix_rank(offset[near]) < 2:
        return None
    gradient = fit * weight
    columns[same[near]] = gradient.T
    columns[dof] -= gradient.sum(axis=1)
    return columns, (along[0], along[1])


def shift_columns(found: list[Floats]) -> sp.csc_array:
    """The derivatives of all loads side by side, two columns for each load."""
    return sp.csc_array(np.hstack(found))
