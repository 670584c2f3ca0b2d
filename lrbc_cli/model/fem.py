"""The full-order finite-element model: operators, loads, outputs and low-rank terms, as read from files and passed to the reduction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.errors import DataError
from lrbc_cli.model.terms import LowRankTerms


@dataclass(frozen=True, kw_only=True)
class FeModel:
    """Second-order system ``(s² M + s C + K) x = B u, y = s^q L x`` with n DOFs (eqs. (1)-(5)).

    Attributes
    ----------
    K, C, M : (n, n) csc_array
        Stiffness, damping and mass *without* the low-rank terms; K may be complex (hysteretic damping), M may be singular.
    B : (n, n_in) csc_array
        Loads, one column for each hammer point; a unit input is 1 N.
    L : (n_out, n) csc_array
        Outputs, one row for each response.
    output_power : (n_out,) int array
        Power q of s: 0 for pressures and displacements, 1 for velocities, 2 for accelerations.
    is_acoustic : (n,) bool array
        Which DOFs are acoustic pressures.
    terms : LowRankTerms
    extras : mapping of str to mappings of str to (n, n) csc_array
        Matrices of further calibration groups, by group and operator (``stiffness``, ``damping``, ``mass``); K, C, M include them.
    """

    K: sp.csc_array
    C: sp.csc_array
    M: sp.csc_array
    B: sp.csc_array
    L: sp.csc_array
    output_power: NDArray[np.int64] = field(repr=False)
    is_acoustic: NDArray[np.bool_] = field(repr=False)
    terms: LowRankTerms = field(repr=False)
    extras: Mapping[str, Mapping[str, sp.csc_array]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        n = self.K.shape[0]
        for name, matrix, shape in (
            ("stiffness", self.K, (n, n)),
            ("damping", self.C, (n, n)),
            ("mass", self.M, (n, n)),
            ("loads", self.B, (n, self.B.shape[1])),
            ("outputs", self.L, (self.L.shape[0], n)),
            ("left vectors of the terms", self.terms.left, (n, self.terms.size)),
            ("right vectors of the terms", self.terms.right, (n, self.terms.size)),
            *((f"{operator} of {name}", A, (n, n)) for name, group in self.extras.items() for operator, A in group.items()),
        ):
            if matrix.shape != shape:
                raise DataError(
                    f"the size of the {name} does not match the other matrices", expected=f"shape {shape}", found=f"shape {matrix.shape}"
                )

    @property
    def size(self) -> int:
        """Number of DOFs n."""
        return int(self.K.shape[0])

    @property
    def inputs(self) -> sp.csc_array:
        """(n, n_in + nt) inputs of the extended system, B_ext = [B | b d f], eq. (11)."""
        return sp.hstack([self.B, self.terms.left], format="csc")

    @property
    def outputs(self) -> sp.csc_array:
        """(n_out + nt, n) outputs of the extended system, L_ext = [L ; cᵀ ; eᵀ ; gᵀ], eq. (15) with one row for each term."""
        return sp.vstack([self.L, self.terms.right.T], format="csr").tocsc()


def proportional_damping(
    K: sp.csc_array, M: sp.csc_array, is_acoustic: NDArray[np.bool_], structure: tuple[float, float], acoustic: tuple[float, float]
) -> sp.csc_array:
    """Proportional damping C = alpha M + beta K on the diagonal block of each field; the coupling blocks stay zero.

    Parameters
    ----------
    K, M : (n, n) csc_array
    is_acoustic : (n,) bool array
    structure, acoustic : (alpha, beta)
        Coefficients in 1/s and s (Table 2 of the paper).

    Returns
    -------
    (n, n) csc_array
    """
    C = (_by_field(M, is_acoustic, structure[0], acoustic[0]) + _by_field(K, is_acoustic, structure[1], acoustic[1])).tocsc()
    C.eliminate_zeros()
    C.sort_indices()
    return C


def hysteretic(K: sp.csc_array, is_acoustic: NDArray[np.bool_], structure: float, acoustic: float) -> sp.csc_array:
    """Hysteretic damping, ``K (1 + i eta)`` on the diagonal block of each field; the coupling blocks stay unchanged.

    Parameters
    ----------
    K : (n, n) csc_array
        If it is complex, i eta times its real part is added to it.
    is_acoustic : (n,) bool array
    structure, acoustic : float
        Loss factors eta.

    Returns
    -------
    (n, n) csc_array
        K itself if both loss factors are zero.
    """
    if not structure and not acoustic:
        return K
    loss = _by_field(K.real, is_acoustic, structure, acoustic)
    loss.eliminate_zeros()
    return (K + 1j * loss).tocsc() if loss.nnz else K


def _by_field(matrix: sp.csc_array, is_acoustic: NDArray[np.bool_], structure: float, acoustic: float) -> sp.csc_array:
    """The diagonal blocks of both fields, each multiplied by the number of its field; coupling blocks become zero."""
    column = np.repeat(is_acoustic, np.diff(matrix.indptr))
    factor = np.where(column, acoustic, structure) * (is_acoustic[matrix.indices] == column)
    return sp.csc_array((factor * matrix.data, matrix.indices, matrix.indptr), shape=matrix.shape)
