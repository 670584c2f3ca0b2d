"""Compares the places of structure and air where the matrices couple them: coordinates of one of the two may be those of other nodes."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Floats
from lrbc_cli.model.dofs import DofTable
from lrbc_cli.model.selection import pitch


def coupled_doubt(K: sp.csc_array, M: sp.csc_array, dofs: DofTable, table: str, *, most: float = 5.0) -> str | None:
    """Warning if structural and acoustic DOFs that the matrices couple lie far apart; else None.

    Parameters
    ----------
    K, M : (n, n) csc_array
    dofs : DofTable
        Of n rows.
    table : str
        Name of its file.
    most : float
        Distance (median over the coupled pairs) above which coordinates are wrong, over the larger node spacing of the two: coupled DOFs
        are corners of faces that touch, at most a diagonal and a thickness apart.
    """
    air = dofs.is_acoustic
    if not air.any() or air.all():
        return None
    entries = (abs(K) + abs(M)).tocsc()[air][:, ~air].tocoo()
    if not entries.nnz:
        return None
    row, column = np.flatnonzero(air)[entries.row], np.flatnonzero(~air)[entries.col]

    def apart(xyz: Floats) -> float:
        return float(np.median(np.linalg.norm(xyz[row] - xyz[column], axis=1)))

    spacing, own = max(pitch(dofs.xyz[air]), pitch(dofs.xyz[~air])), apart(dofs.xyz)
    if own <= most * spacing:
        return None
    # Rows of one node share its place, so nodes are reversed, not rows.
    nodes, first, of = np.unique(dofs.node[~air], return_index=True, return_inverse=True)
    order = np.argsort(first)
    places, turned = dofs.xyz.copy(), np.empty((nodes.size, 3))
    turned[order] = dofs.xyz[~air][first[order[::-1]]]
    places[~air] = turned[of]
    backwards = apart(places)
    other = f"With the structural nodes in reverse order it is {backwards:.3g} m. " if backwards <= most * spacing else ""
    return (
        f"the coordinates of the nodes are probably not those of the matrices: these couple structure and air at DOFs that are {own:.3g} m "
        f"apart in {table} (median, node spacing {spacing:.3g} m). {other}Check whether the table is of another numbering of the nodes, "
        "before a renumbering for example. Export matrices and DOF table of one model in one run"
    )
