"""Coupling of structure and air: one of its two blocks is missing or of the wrong sign, or the places of coupled DOFs do not fit."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from lrbc_cli.arrays import Floats
from lrbc_cli.model.dofs import COMPONENTS, DofTable
from lrbc_cli.model.fem import FeModel
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


def uncoupled_doubt(
    K: sp.csc_array, M: sp.csc_array, dofs: DofTable, *, least: int = 4, share: float = 0.05, rounding: float = 1e-6
) -> str | None:
    """Warning if structural nodes lie at the air as the coupled ones do, but are not coupled to it; else None.

    Parameters
    ----------
    K, M : (n, n) csc_array
    dofs : DofTable
        Of n rows.
    least : int
        Least number of coupled nodes, and of nodes without coupling.
    share : float
        Least number of these over that of the coupled ones.
    rounding : float
        Distance that counts as zero, over the extent of the model.
    """
    air = dofs.is_acoustic
    if not air.any() or air.all():
        return None
    entries = (abs(K) + abs(M)).tocsr()
    felt = np.zeros(dofs.size, dtype=bool)
    felt[~air] = (entries[~air][:, air].sum(axis=1) + entries[air][:, ~air].sum(axis=0)) > 0.0
    rows = np.flatnonzero(np.isin(dofs.component, COMPONENTS[:3]) & ~air)
    _, first, of = np.unique(dofs.node[rows], return_index=True, return_inverse=True)
    coupled = np.bincount(of, felt[rows]) > 0
    if not least <= coupled.sum() < coupled.size:
        return None
    xyz = dofs.xyz[rows][first]
    far, _ = cKDTree(dofs.xyz[air]).query(xyz)
    # Meshes that do not match leave a distance of nodes that touch.
    left = ~coupled & (far <= max(float(np.median(far[coupled])), rounding * float(np.ptp(dofs.xyz, axis=0).max())))
    if left.sum() < max(least, share * coupled.sum()):
        return None
    ranges = ", ".join(
        f"{axis} from {low:.4g} to {high:.4g} m" for axis, low, high in zip("xyz", xyz[left].min(0), xyz[left].max(0), strict=True)
    )
    return (
        f"{left.sum()} structural nodes lie as near to the air as the {coupled.sum()} that the matrices couple to it, but are not coupled "
        f"({ranges}): the coupling surface is probably incomplete. Select the whole wetted surface in the FE model, and export the "
        "matrices again; if these nodes are dry, nothing needs to be done"
    )


#: Rows of the coupling blocks, by whether they are pressures; and the matrix with the other block of a model, by that with the first one.
_ROWS = {False: "displacements", True: "pressures"}
_PARTNER = {"stiffness": "mass", "mass": "stiffness", "damping": "damping"}


def one_way(model: FeModel) -> tuple[bool, str, str] | None:
    """Whether the air (True) or the structure does not feel the other, since one coupling block is empty, with what there is; else None.

    The matrix that lacks the block is the third.
    """
    matrices = {"stiffness": model.K, "damping": model.C, "mass": model.M}
    counts = {side: {name: _coupling(matrix, model, side) for name, matrix in matrices.items()} for side in _ROWS}
    for deaf in _ROWS:
        there = {name: count for name, count in counts[not deaf].items() if count}
        if there and not any(counts[deaf].values()) and not joined_by_terms(model):
            first = max(there, key=lambda name: there[name])
            other = _PARTNER[first]
            return (
                deaf,
                f"{there[first]} entries in the rows of {_ROWS[not deaf]} of the {first} matrix, none in those of {_ROWS[deaf]} of the "
                f"{other} matrix",
                other,
            )
    return None


def one_way_text(model: FeModel) -> str | None:
    """Warning if structure and air are coupled one way only; else None."""
    found = one_way(model)
    if found is None:
        return None
    deaf, text, other = found
    one, effect = ("air", "structure") if deaf else ("structure", "air")
    return f"the {one} does not feel the {effect}: the matrices couple them by {text}. Export the {other} matrix with the coupling"


def opposed_text(model: FeModel, *, alike: float = 0.9) -> str | None:
    """Warning if the two coupling blocks, of stiffness and mass matrix, have signs with which structure and air gain energy; else None.

    With K_sa = A energy is conserved if M_as = -kappa A^T with kappa > 0, whatever the sign of pressures: that turns both blocks. Rows of
    one field written with the opposite sign turn one block, but also the mass matrix of this field.

    Parameters
    ----------
    model : FeModel
    alike : float
        Cosine between the two blocks above which they are the same up to a factor.
    """
    air = model.is_acoustic
    of_structure, of_air = (part.tocsr() for part in (model.K.real[:, air].tocsr()[~air], model.M.real[:, ~air].tocsr()[air].T))
    size = float(np.linalg.norm(of_structure.data) * np.linalg.norm(of_air.data))
    if not size:
        return None
    masses = np.real(model.M.diagonal())
    signs = np.sign(masses[air].sum()) * np.sign(masses[~air].sum())
    if float(of_structure.multiply(of_air).sum()) * signs < alike * size:
        return None
    return (
        "structure and air gain energy from their coupling: its blocks in the stiffness matrix (rows of displacements, columns of "
        "pressures) and in the mass matrix (rows of pressures, columns of displacements) are of one sign instead of opposite signs. "
        "Reverse the sign of the block in the mass matrix (the normals of the faces there) in the FE model, and export it again; if "
        "`lrbc check` then finds all measured phases reversed, reverse both blocks"
    )


def joined_by_terms(model: FeModel) -> bool:
    """Whether a term acts on structure and air. A term connects all DOFs of its two vectors."""
    ends, air = abs(model.terms.left) + abs(model.terms.right), model.is_acoustic
    return bool(np.any((ends.T @ air.astype(float) > 0) & (ends.T @ (~air).astype(float) > 0)))


def _coupling(matrix: sp.csc_array, model: FeModel, acoustic: bool) -> int:
    """Number of entries in the rows of one field and the columns of the other."""
    entries, air = matrix.tocoo(), model.is_acoustic
    return int(np.count_nonzero(entries.data[(air[entries.row] == acoustic) & (air[entries.col] != acoustic)]))
