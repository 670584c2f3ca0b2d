"""Matrices of which a file contains one triangle: completed if the campaign says so, refused otherwise."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.config.fields import OperatorRef
from lrbc_cli.errors import DataError
from lrbc_cli.io.sparse import stored_triangle
from lrbc_cli.model.coupling import asymmetry

#: Largest relative asymmetry attributed to rounding: exporters write at least six digits.
ROUNDING = 1e-6


def whole(
    matrix: sp.csc_array, ref: OperatorRef, operator: str, acoustic: NDArray[np.bool_] | None, what: str | None = None
) -> tuple[sp.csc_array, str | None]:
    """The whole matrix, and a note on what was done to it (None if nothing).

    Parameters
    ----------
    matrix : (n, n) csc_array
        As stored.
    ref : OperatorRef
        Its ``symmetric`` states what a single triangle means.
    operator : str
        ``stiffness``, ``damping`` or ``mass``.
    acoustic : (n,) bool array or None
        Mask of the pressures; coupling blocks may be in one triangle.
    what : str or None
        Name of the matrix in messages; None: the operator.

    Raises
    ------
    DataError
        If one triangle is stored and the campaign does not state what that means, or if ``symmetric: true`` cannot be right.
    """
    what = what or operator
    triangle = stored_triangle(matrix, acoustic)
    if ref.symmetric is None and triangle:
        raise DataError(
            f"only the {triangle} triangle of the {what} matrix is stored",
            file=ref.path,
            place=ref.group,
            expected="both triangles, or a Matrix Market file with 'symmetric' in its banner",
            found=f"no entry {'above' if triangle == 'lower' else 'below'} the diagonal" + _of_field(acoustic),
            hint="export the whole matrix. If the other triangle is its mirror image, write {file: ..., symmetric: true} "
            "(symmetric: false if the matrix is really triangular)",
        )
    if not ref.symmetric:
        return matrix, f"{what}: one triangle, as given (symmetric: false)" if triangle else None
    if acoustic is not None and acoustic.any() and not acoustic.all() and operator != "damping":
        column = np.repeat(acoustic, np.diff(matrix.indptr))
        if np.any(acoustic[matrix.indices] != column):
            raise DataError(
                f"the {what} matrix couples pressures and displacements, so it is not symmetric",
                file=ref.path,
                place=ref.group,
                expected="no symmetric: true",
                hint="export the whole matrix: the coupling lies on one side of the diagonal in K and on the other in M",
            )
    if stored_triangle(matrix):
        return _completed(matrix), f"{what}: the other triangle was filled in (symmetric: true)"
    if asymmetry(matrix) > ROUNDING:
        raise DataError(
            f"the {what} matrix is not symmetric",
            file=ref.path,
            place=ref.group,
            expected="a symmetric matrix or one triangle of it (symmetric: true)",
            found=f"a relative asymmetry of {asymmetry(matrix):.1e}",
            hint="export it again, or remove symmetric: true",
        )
    return matrix, None


def _completed(matrix: sp.csc_array) -> sp.csc_array:
    whole = sp.csc_array(matrix + matrix.T - sp.diags_array(matrix.diagonal(), format="csc"))
    whole.eliminate_zeros()
    whole.sort_indices()
    return whole


def _of_field(acoustic: NDArray[np.bool_] | None) -> str:
    return "" if acoustic is None or not acoustic.any() or acoustic.all() else " in the block of one field"
