"""Cheap estimate of the error of y over the whole band: product of sketched primal and dual residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.reduction.ports import in_chunks, port_frf
from lrbc_cli.reduction.reduced import reference_dynamic
from lrbc_cli.reduction.vectors import certificate_vectors

if TYPE_CHECKING:
    from lrbc_cli.reduction.build import Reducer

Floats = NDArray[np.float64]


class Estimator:
    """Residual estimate on a grid of lines.

    The error of a response is ``z_lᵀ R u``, with R the residual of the reduced solutions for all inputs, u the inputs that a parameter
    vector makes (auxiliary ones included), and z_l the dual solution; by Galerkin orthogonality only the error of the dual counts, so that
    |e_l| is about |R_dual| |R u| in rows scaled by the diagonals of M and K. Residuals enter through a random sketch, so that they do
    not drown in round-off as in the expanded normal form (Balabanov and Nouy 2019).

    Parameters
    ----------
    reducer : Reducer
    count : int
        Lines of the grid.
    """

    def __init__(self, reducer: Reducer, count: int) -> None:
        self._reducer = reducer
        low, high = reducer.options.band_hz
        self.grid_hz: Floats = np.linspace(low, high, count)
        s = 2j * np.pi * self.grid_hz
        model = reducer.model
        chosen = certificate_vectors(model.terms, reducer.scale, s, count=2)
        self._vectors = [D for kind in ("free", "local", "clamped", "random") for D in chosen[kind]]
        self._acoustic_response = np.asarray(abs(reducer.dual_rhs).T @ model.is_acoustic.astype(float)) > 0

    def estimate(self) -> Floats:
        """(count,) estimated relative error of y, worst over a few parameter vectors."""
        reducer = self._reducer
        P = reducer.projection
        s = 2j * np.pi * self.grid_hz
        K, C, M = (P.operator(i) for i in range(3))
        SK, SC, SM = (P.sketched(i) for i in range(3))
        B, L, theta_B = P.inputs.astype(complex), P.outputs, P.sketched_inputs
        dual, theta_dual = P.dual.astype(complex), P.sketched_dual
        symmetric = reducer.Z.symmetric
        TK, TC, TM = (SK, SC, SM) if symmetric else tuple(P.sketched(i, transposed=True) for i in range(3))
        kappa = reducer.Z.coupling.kappa
        R, n_in, m = reducer.model.L.shape[0], reducer.model.B.shape[1], B.shape[1]
        H = np.empty((s.size, L.shape[0], m), dtype=complex)
        primal = np.empty((s.size, theta_B.shape[0], m), dtype=complex)
        dual_norm = np.empty((s.size, R))

        def work(part: slice) -> None:
            z = s[part, None, None]
            Z = z**2 * M + z * C + K
            if symmetric:
                both = np.linalg.solve(Z, np.hstack([B, dual])[None])
                X, Y = both[:, :, :m], both[:, :, m:]
            else:
                X, Y = np.linalg.solve(Z, B[None]), np.linalg.solve(Z.transpose(0, 2, 1), dual[None])
            H[part] = L @ X
            primal[part] = theta_B - (z**2 * SM + z * SC + SK) @ X
            rest = theta_dual - (z**2 * TM + z * TC + TK) @ Y
            # Rows of the acoustic field scaled as in the symmetrised system, by |l| = 1/|kappa s²|.
            weight = self._row_weight(s[part], kappa)
            primal[part] *= weight[:, :, None]
            norm = np.linalg.norm(rest * weight[:, :, None], axis=1)
            if kappa is not None:
                norm = norm * np.where(self._acoustic_response[None, :], np.abs(kappa * s[part, None] ** 2), 1.0)
            dual_norm[part] = norm[:, :R]

        in_chunks(s.size, work, chunk=8)
        ports = port_frf(H, s, reference_dynamic(reducer.reference, s), reducer.model.output_power, reducer.input_of)
        worst = np.zeros(s.size)
        to_quantity = np.abs(s[:, None] ** reducer.model.output_power[None, :])
        for D in self._vectors:
            y, u = ports.drive(D)
            for column in range(n_in):
                mine = reducer.input_of == column
                unit = np.zeros((s.size, n_in), dtype=complex)
                unit[:, column] = 1.0
                residual = np.linalg.norm((primal @ np.concatenate([unit, u[:, :, column]], axis=1)[:, :, None])[:, :, 0], axis=1)
                for group in reducer.quantity_groups():
                    rows = group[mine[group]]
                    if rows.size:
                        error = residual * np.linalg.norm(dual_norm[:, rows] * to_quantity[:, rows], axis=1)
                        worst = np.maximum(worst, error / np.maximum(np.linalg.norm(y[:, rows], axis=1), np.finfo(float).tiny))
        return np.asarray(worst)

    def _row_weight(self, s: NDArray[np.complexfloating[Any, Any]], kappa: float | None) -> Floats:
        """(F, sketch rows) square root of |l| of each field's rows."""
        P = self._reducer.projection
        weight = np.ones((s.size, P.rows * len(P.fields)))
        if kappa is not None:
            weight[:, P.rows :] = (1.0 / np.sqrt(np.abs(kappa * s**2)))[:, None]
        return weight
