"""The reduced model (26)-(27): projected operators, from which port FRFs follow, and the reduced dynamic stiffness (28)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.reduction.reduced.ports import CLAMPED, PortFrf, port_frf
from lrbc_cli.reduction.threads import in_chunks


@dataclass(frozen=True, kw_only=True)
class ReducedModel:
    """``(s² M + s C + K + b D(s) cᵀ) x = B u, y = s^q L x`` with r DOFs; K, C and M do not contain the terms.

    Attributes
    ----------
    K, C, M : (r, r) arrays
        Vᵀ K V etc.; real unless the full operator is complex.
    B : (r, n_in) float array
    L : (n_out, r) float array
    left, right : (r, nt) float arrays
        Vᵀ b and Vᵀ c, eq. (27).
    output_power : (n_out,) int array
        Power q of s for each response.
    input_of : (n_out,) int array
        Which input each response belongs to.
    reference : (nt, 3) float array
        Coefficients of the reference values ``D_ref(s) = k + s c + s² m`` of the terms, about which port FRFs are taken.
    structure : int
        Number of structural DOFs, the first ones.
    extras : mapping of str to mappings of str to (r, r) arrays
        Projected matrices of the further calibration groups, by group and operator.
    """

    K: Complexes | Floats = field(repr=False)
    C: Complexes | Floats = field(repr=False)
    M: Complexes | Floats = field(repr=False)
    B: Floats = field(repr=False)
    L: Floats = field(repr=False)
    left: Floats = field(repr=False)
    right: Floats = field(repr=False)
    output_power: Integers = field(repr=False)
    input_of: Integers = field(repr=False)
    reference: Floats = field(repr=False)
    structure: int
    extras: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, repr=False)

    @property
    def size(self) -> int:
        """Number of reduced DOFs r."""
        return int(self.K.shape[0])

    @property
    def terms(self) -> int:
        """Number of terms nt."""
        return int(self.left.shape[1])

    def reference_dynamic(self, s: Complexes) -> Complexes:
        """(F, nt) D_ref(s)."""
        return reference_dynamic(self.reference, s)

    def dynamic_stiffness(self, s: Complexes, D: Complexes) -> Complexes:
        """(F, r, r) reduced dynamic stiffness, eq. (28).

        Parameters
        ----------
        s : (F,) complex array
        D : (F, nt) complex array
            Dynamic values of the terms, finite.
        """
        Z = s[:, None, None] ** 2 * self.M + s[:, None, None] * self.C + self.K
        return np.asarray(Z + (self.left * D[:, None, :]) @ self.right.T)

    def transfer(self, s: Complexes, *, workers: int = 2) -> Complexes:
        """(F, n_out + nt, n_in + nt) transfer matrix of the extended system at the reference values."""
        D = self.reference_dynamic(s)
        inputs = np.hstack([self.B, self.left])
        outputs = np.vstack([self.L, self.right.T])
        H = np.empty((s.size, outputs.shape[0], inputs.shape[1]), dtype=complex)

        def work(part: slice) -> None:
            H[part] = outputs @ np.linalg.solve(self.dynamic_stiffness(s[part], D[part]), inputs.astype(complex)[None])

        in_chunks(s.size, work, workers=workers)
        return H

    def ports(self, s: Complexes, *, workers: int = 2) -> PortFrf:
        """Port FRFs at the lines s."""
        return port_frf(self.transfer(s, workers=workers), s, self.reference_dynamic(s), self.output_power, self.input_of)

    def evaluate(self, s: Complexes, D: Complexes, *, workers: int = 2) -> Complexes:
        """(F, n_out) FRFs from the reduced dynamic stiffness, eq. (28), for (F, nt) values D (inf clamps); port FRFs give the same."""
        return self._solve(s, D, gradient=False, workers=workers)[0]

    def linearise(self, s: Complexes, D: Complexes, *, workers: int = 2) -> tuple[Complexes, Complexes]:
        """(F, n_out) FRFs and their (F, n_out, nt) derivatives with respect to D_j, eqs. (28) and (32) in adjoint form."""
        return self._solve(s, D, gradient=True, workers=workers)

    def _solve(self, s: Complexes, D: Complexes, *, gradient: bool, workers: int) -> tuple[Complexes, Complexes]:
        R = self.L.shape[0]
        y = np.empty((s.size, R), dtype=complex)
        dy = np.empty((s.size, R if gradient else 0, self.terms), dtype=complex)
        rows = np.arange(R)
        size, rest = self._sizes(s)
        # Terms much larger than the rest of the dynamic stiffness.
        stiff = size * np.abs(D).max(axis=0, initial=0.0) > 100.0 * rest
        soft = ~stiff
        rigid = CLAMPED * size[stiff] / rest
        r, extra = self.size, int(stiff.sum())
        loads = np.vstack([self.B, np.zeros((extra, self.B.shape[1]))]).astype(complex)
        outputs = np.vstack([self.L.T, np.zeros((extra, R))]).astype(complex)

        def work(part: slice) -> None:
            d = np.where(stiff, 0.0, D[part])
            # Stiff terms have u = -D cᵀ x as a further unknown, E u + F cᵀ x = 0 with D = F/E: no huge entries, even for clamped terms.
            clamped = np.isinf(D[part][:, stiff])
            finite = np.where(clamped, 0.0, D[part][:, stiff])
            E = np.where(clamped, rigid, 1.0 / (1.0 + np.abs(finite)))
            F = np.where(clamped, 1.0, finite * E)
            A = np.zeros((d.shape[0], r + extra, r + extra), dtype=complex)
            A[:, :r, :r] = self.dynamic_stiffness(s[part], d)
            A[:, :r, r:] = -self.left[:, stiff]
            A[:, r:, :r] = F[:, :, None] * self.right[:, stiff].T
            A[:, r + np.arange(extra), r + np.arange(extra)] = E
            to_quantity = s[part, None] ** self.output_power[None, :]
            x = np.linalg.solve(A, loads[None])
            y[part] = (self.L @ x[:, :r])[:, rows, self.input_of] * to_quantity
            if gradient:
                adjoint = np.linalg.solve(A.transpose(0, 2, 1), outputs[None])
                before = np.empty((d.shape[0], self.terms, R), dtype=complex)
                after = np.empty((d.shape[0], self.terms, self.B.shape[1]), dtype=complex)
                before[:, soft] = self.left[:, soft].T @ adjoint[:, :r]
                after[:, soft] = self.right[:, soft].T @ x[:, :r]
                before[:, stiff] = E[:, :, None] * adjoint[:, r:]
                after[:, stiff] = -(E / F)[:, :, None] * x[:, r:]
                dy[part] = -(before * after[:, :, self.input_of]).transpose(0, 2, 1) * to_quantity[:, :, None]

        in_chunks(s.size, work, chunk=8, workers=workers)
        return y, dy

    def _sizes(self, s: Complexes) -> tuple[Floats, float]:
        """(nt,) norms of the terms at D = 1, and the size of the rest of the dynamic stiffness."""
        size = np.linalg.norm(self.left, axis=0) * np.linalg.norm(self.right, axis=0)
        return size, float(np.abs(self.K).max() + np.abs(s).max() ** 2 * np.abs(self.M).max())


def reference_dynamic(reference: Floats, s: Complexes) -> Complexes:
    """(F, nt) values k + s c + s² m from (nt, 3) coefficients k, c, m."""
    return np.asarray(reference[:, 0] + s[:, None] * reference[:, 1] + s[:, None] ** 2 * reference[:, 2])
