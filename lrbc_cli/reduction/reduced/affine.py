"""The reduced model as a function of the global factors of a calibration (Table 2): stiffness, mass, damping of each field, further groups.

Factors are affine but not of low rank, so the port formula does not apply. One factorisation of the reduced dynamic stiffness (28) at each
line gives the FRFs with their derivatives with respect to terms, factors and shifts of the loads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.factors import FIELDS, OPERATORS, Recipe, parted
from lrbc_cli.reduction.reduced.condense import CondensedAir, air_is_diagonal, plain, with_diagonal_air
from lrbc_cli.reduction.reduced.modal import Motions, diagonal_of, modal_structure
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.threads import in_chunks

#: Z counts as symmetric if, after scaling of the acoustic rows, it differs from its transpose by at most this fraction.
SYMMETRY = 1e-9


@dataclass(frozen=True, kw_only=True)
class Linearised:
    """FRFs y and their derivatives.

    Attributes
    ----------
    y : (F, R) complex array
    terms : (F, R, nt) complex array
        dy/dD_j for the dynamic values of the terms.
    factors : (F, R, k) complex array
        dy/d ln phi_i for the factors.
    shifts : (F, R, 2) complex array
        Derivatives with respect to shifts of the response's load along two directions [1/m]; (F, R, 0) without ``AffineModel.shifts``.
    """

    y: Complexes
    terms: Complexes
    factors: Complexes
    shifts: Complexes


@dataclass(frozen=True)
class AffineModel:
    """The reduced dynamic stiffness ``Z(s, phi) = sum_p c_p(s, phi) A_p`` as a function of the factors phi.

    Attributes
    ----------
    base : ReducedModel
        With all factors one; columns of B beyond the loads are the derivatives that ``shifts`` refers to.
    recipe : Recipe
        Gives the coefficients c_p.
    shifts : (n_in, 2) int array or None
        For every load the columns of B with its derivatives with respect to two shifts of the hammer [N/m].
    """

    base: ReducedModel
    recipe: Recipe
    shifts: Integers | None = None

    @cached_property
    def blocks(self) -> list[Any]:
        """(r, r) matrices A_p in the order of ``Recipe.pieces``."""
        r, ns = self.base.size, self.base.structure
        first = np.arange(r) < ns
        inside = {"structure": np.outer(first, first), "acoustic": np.outer(~first, ~first), "coupling": first[:, None] != first[None, :]}
        own = dict(zip(OPERATORS, (self.base.K, self.base.C, self.base.M), strict=True))
        found = {None: parted(own)} | {name: parted(group) for name, group in self.base.extras.items()}
        return [np.where(inside[piece.field], found[piece.group][piece.operator], 0.0) for piece in self.recipe.pieces]

    def operators(self, factors: Mapping[str, float]) -> tuple[Any, Any, Any]:
        """K, C and M at the given factors."""
        out: list[Any] = [np.zeros((self.base.size, self.base.size)) for _ in range(3)]
        for piece, A in zip(self.recipe.pieces, self.blocks, strict=True):
            weights = piece.coefficients(factors)
            for slot in np.flatnonzero(weights):
                out[slot] = out[slot] + weights[slot] * A
        K, C, M = out
        return K, C, M

    def damping_coefficients(self) -> dict[str, float]:
        """Values of alpha, beta and loss factor of each field that the model has with all factors one, by the names of their factors."""
        ns, K = self.base.structure, self.base.K
        found: dict[str, float] = {}
        for piece in self.recipe.pieces:
            for share in piece.shares if piece.group is None else ():
                found |= {name: share.coefficient for name in share.exponents if name in self.recipe.proportional and share.coefficient}
        for field, part in zip(FIELDS, (slice(0, ns), slice(ns, None)), strict=True):
            if f"loss_factor.{field}" in self.recipe.names:
                found[f"loss_factor.{field}"] = float(np.trace(K[part, part]).imag / np.trace(K[part, part]).real)
        return found

    def at(self, factors: Mapping[str, float]) -> ReducedModel:
        """The reduced model with these factors."""
        K, C, M = self.operators(factors)
        return replace(self.base, K=K, C=C, M=M)

    def diagonalised(self, omega: float) -> AffineModel:
        """The model with diagonal acoustic blocks or, for a structure without air, in modal coordinates: faster at each line.

        Parameters
        ----------
        omega : float
            Angular frequency in the band [rad/s].
        """
        base = self.base
        modal = modal_structure(base.K, base.C, base.M, omega) if base.structure == base.size else None
        if modal is None:
            return replace(self, base=with_diagonal_air(base))
        T, (K, C, M) = modal.turn, modal.diagonals
        base = replace(
            base,
            K=np.diag(plain(K)),
            C=np.diag(C),
            M=np.diag(M),
            B=T.T @ base.B,
            L=base.L @ T,
            left=T.T @ base.left,
            right=T.T @ base.right,
            extras={name: {operator: T.T @ A @ T for operator, A in group.items()} for name, group in base.extras.items()},
        )
        return replace(self, base=base)

    def restricted(self, responses: Integers) -> AffineModel:
        """The model with some of the responses only (index array)."""
        base = replace(
            self.base, L=self.base.L[responses], output_power=self.base.output_power[responses], input_of=self.base.input_of[responses]
        )
        return replace(self, base=base)

    def linearise(
        self,
        s: Complexes,
        D: Complexes,
        factors: Mapping[str, float],
        names: Sequence[str],
        offset: Floats | None = None,
        *,
        workers: int = 2,
    ) -> Linearised:
        """FRFs and their derivatives with respect to terms, factors and shifts of the loads.

        ``dy/dD_j = -(b_jᵀ v)(c_jᵀ x)`` and ``dy/d ln phi = -vᵀ (dZ/d ln phi) x`` with ``Z x = B u`` and ``Zᵀ v = Lᵀ``, eqs. (28), (32).

        Parameters
        ----------
        s : (F,) complex array
        D : (F, nt) complex array
            Dynamic values of the terms, finite.
        factors : mapping
            Values by name; factors that are not given are one.
        names : sequence of str
            Factors for which derivatives are computed.
        offset : (n_in, 2) float array or None
            Shift of each load along its two directions [m].

        Returns
        -------
        Linearised
        """
        base = self.base
        rows, own, B = np.arange(base.L.shape[0]), base.input_of, self.loads(offset)
        moved, turn, shared = self._solver(s, D, self.operators(factors), B)
        heard = base.L if turn is None else base.L @ turn
        sloping = self._sloping(factors, names, turn)
        y = np.empty((s.size, rows.size), dtype=complex)
        by_term, by_factor, by_shift = (
            np.empty((s.size, rows.size, count), dtype=complex) for count in (base.terms, len(names), 0 if self.shifts is None else 2)
        )

        def work(part: slice) -> None:
            found = moved(part)
            to_quantity = s[part, None] ** base.output_power[None, :]
            y[part] = found.y * to_quantity
            by_term[part] = -(found.before * found.after[:, :, own]).transpose(0, 2, 1) * to_quantity[:, :, None]
            by_factor[part] = -_slopes(s[part], found.x, found.v, own, sloping, len(names)) * to_quantity[:, :, None]
            if self.shifts is not None:
                for i in range(2):
                    by_shift[part, :, i] = (heard @ found.x)[:, rows, self.shifts[own, i]] * to_quantity

        # Lines that share one product pay together, but not by matrices that fill the memory; each thread has as many.
        rounds = max(-(-s.size // (64 * workers)), 1)
        in_chunks(s.size, work, chunk=max(-(-s.size // (rounds * workers)), 1) if shared else 8, workers=workers)
        return Linearised(y=y, terms=by_term, factors=by_factor, shifts=by_shift)

    def _solver(
        self, s: Complexes, D: Complexes, operators: tuple[Any, Any, Any], B: Floats
    ) -> tuple[Callable[[slice], Motions], Floats | None, bool]:
        """A function that solves a slice of lines; the (r, r) matrix from its coordinates to ``base`` or None; whether lines share work."""
        base, own, rows = self.base, self.base.input_of, np.arange(self.base.L.shape[0])
        terms = (base.left, base.right)
        modal = modal_structure(*operators, omega=float(np.median(np.abs(s)))) if base.structure == base.size else None
        if modal is not None:
            return lambda part: modal.motions(s[part], D[part], terms, B, base.L, own), modal.turn, True
        air = CondensedAir(operators, terms, base.structure) if air_is_diagonal(*operators, base.structure, *terms) else None
        kappa = self._kappa(*operators) if air is None else None

        def moved(part: slice) -> Motions:
            z = s[part, None, None]
            x, v = self._solve(z, D[part], operators, B, kappa) if air is None else air.solve(z, D[part], B, base.L.T)
            return Motions(x=x, v=v, after=base.right.T @ x, before=base.left.T @ v, y=(base.L @ x)[:, rows, own])

        return moved, None, air is not None

    def _sloping(self, factors: Mapping[str, float], names: Sequence[str], turn: Floats | None) -> list[tuple[Any, Floats]]:
        """Pieces that depend on ``names``: (r, r) matrix or (r,) diagonal, and (k, 3) derivatives of its weights in K, C, M."""
        found = []
        for piece, A in zip(self.recipe.pieces, self.blocks, strict=True):
            slopes = np.array([piece.slopes(factors, name) for name in names]).reshape(-1, 3)
            if slopes.any() and A.any():
                own = A if turn is None else turn.T @ A @ turn
                diagonal = diagonal_of(own)
                found.append((own if diagonal is None else diagonal, slopes))
        return found

    def loads(self, offset: Floats | None) -> Floats:
        """(r, columns) B with each load shifted by its (2,) offset [m]."""
        B = np.array(self.base.B, dtype=float)
        if offset is not None and self.shifts is not None:
            for load, columns in enumerate(self.shifts):
                B[:, load] += self.base.B[:, columns] @ offset[load]
        return B

    def _solve(
        self, z: Complexes, D: Complexes, operators: tuple[Any, Any, Any], B: Floats, kappa: float | None
    ) -> tuple[Complexes, Complexes]:
        """Solutions x and v of ``Z x = B`` and ``Zᵀ v = Lᵀ``; kappa from ``_kappa``."""
        base, ns = self.base, self.base.structure
        K, C, M = operators
        Z = z**2 * M + z * C + K + (base.left * D[:, None, :]) @ base.right.T
        if kappa is None:
            return np.linalg.solve(Z, B.astype(complex)[None]), np.linalg.solve(Z.transpose(0, 2, 1), base.L.T.astype(complex)[None])
        # diag(I, -1/(kappa s²)) Z is symmetric, so v follows from the same factorisation.
        scale = np.ones((Z.shape[0], base.size, 1), dtype=complex)
        scale[:, ns:] = -1.0 / (kappa * z**2)
        both = np.linalg.solve(Z, np.concatenate([np.broadcast_to(B, (Z.shape[0], *B.shape)), base.L.T[None] / scale], axis=2))
        return both[:, :, : B.shape[1]], scale * both[:, :, B.shape[1] :]

    def _kappa(self, K: Any, C: Any, M: Any) -> float | None:
        """The kappa with which Z becomes symmetric (acoustic rows divided by -kappa s²); 1 if it is symmetric; None if there is none."""
        ns, base = self.base.structure, self.base
        if not np.array_equal(base.left, base.right):
            return None
        for A in (K, C, M):
            for part in (A[:ns, :ns], A[ns:, ns:]):
                if part.size and np.abs(part - part.T).max() > SYMMETRY * np.abs(part).max():
                    return None
        if ns in (0, base.size):
            return 1.0
        A, F = plain(K[:ns, ns:]), -M[ns:, :ns].T
        if (
            np.abs(K[ns:, :ns]).max(initial=0.0)
            or np.abs(M[:ns, ns:]).max(initial=0.0)
            or np.abs(C[:ns, ns:]).max()
            or np.abs(C[ns:, :ns]).max()
            or np.iscomplexobj(A)
        ):
            return None
        square = float(np.sum(A * A))
        if square == 0.0:
            return 1.0
        kappa = float(np.sum(A * F)) / square
        return kappa if kappa != 0.0 and np.abs(F - kappa * A).max() <= SYMMETRY * np.abs(F).max() else None


def _slopes(s: Complexes, x: Complexes, v: Complexes, own: Integers, sloping: Sequence[tuple[Any, Floats]], names: int) -> Complexes:
    """(F, R, k) products ``vᵀ (dZ/d ln phi) x`` for every response and factor."""
    out = np.zeros((s.size, own.size, names), dtype=complex)
    powers = s[:, None] ** np.arange(3)
    for A, slopes in sloping:
        image = A[:, None] * x if A.ndim == 1 else A @ x
        out += np.einsum("frj,frj->fj", v, image[:, :, own])[:, :, None] * (powers @ slopes.T)[:, None, :]
    return out
