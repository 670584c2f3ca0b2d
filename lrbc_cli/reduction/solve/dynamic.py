"""The dynamic stiffness Z(s) = s² M + s C + K of the full model, factorised and solved for the reduction and for full-order FRFs."""

from __future__ import annotations

import copy
import time
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from lrbc_cli.arrays import Bools, Complexes, Integers
from lrbc_cli.errors import NumericalError
from lrbc_cli.model.coupling import coupling_of
from lrbc_cli.reduction.solve import pardiso
from lrbc_cli.reduction.solve.ordering import nested_dissection
from lrbc_cli.reduction.solve.symbolic import column_counts

#: Right-hand sides, (n,) or (n, m), or sparse (n, m).
Columns: TypeAlias = NDArray[Any] | sp.csc_array

#: Z(s) is reported as singular if the residual of a refined solve exceeds this fraction of the right-hand side.
RESIDUAL_LIMIT = 1e-6

#: Right-hand sides solved at a time: more are not faster, and each needs several further vectors.
COLUMNS = 16

#: In small models more are solved at a time, up to arrays of this size [bytes].
COLUMN_BYTES = 64e6


class Solver(Protocol):
    """A sparse direct solver with a fixed pattern."""

    def factor(self, data: Complexes) -> None:
        """Factorise the values on the pattern."""

    def solve(self, rhs: Complexes, *, transposed: bool = False) -> Complexes:
        """Solution without iterative refinement."""

    def release(self) -> None:
        """Release the memory of the factors; another factorisation is needed before the next solve."""

    @property
    def nonzeros(self) -> int:
        """Non-zeros of the latest factors."""


def columns_at_once(size: int) -> int:
    """Number of right-hand sides solved at a time in a model of ``size`` DOFs."""
    return max(COLUMNS, int(COLUMN_BYTES / (16 * size)))


class SuperLuSolver:
    """SciPy's SuperLU in symmetric mode, for a matrix that is already in nested-dissection order."""

    def __init__(self, indptr: NDArray[Any], indices: NDArray[Any]) -> None:
        self._indptr, self._indices = indptr.astype(np.int32), indices.astype(np.int32)
        self._lu: Any = None
        self._nonzeros = 0

    def factor(self, data: Complexes) -> None:
        """Factorise the values on the pattern; earlier factors are released first."""
        n = self._indptr.size - 1
        matrix = sp.csc_matrix((data, self._indices, self._indptr), shape=(n, n))
        self.release()
        try:
            # On busy cores BLAS threads on small supernodes make this many times slower.
            with threadpool_limits(limits=1, user_api="blas"):
                self._lu = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.01, options={"SymmetricMode": True})
                self._nonzeros = int(self._lu.nnz)
        except MemoryError as error:
            raise NumericalError("SuperLU failed (not enough memory)", hint="use a coarser model, or reduction.backend: pardiso") from error
        except RuntimeError as error:
            raise NumericalError(f"SuperLU failed ({error})") from error

    def solve(self, rhs: Complexes, *, transposed: bool = False) -> Complexes:
        """Solution without iterative refinement."""
        with threadpool_limits(limits=1, user_api="blas"):
            try:
                return np.asarray(self._lu.solve(np.asfortranarray(rhs), "T" if transposed else "N"))
            except RuntimeError as error:
                raise MemoryError(str(error)) if "MALLOC" in str(error).upper() else error from None

    def release(self) -> None:
        """Release the memory of the factors."""
        self._lu = None

    @property
    def nonzeros(self) -> int:
        """Non-zeros of the latest factors."""
        return self._nonzeros


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """Predicted size and operations of a factorisation.

    Attributes
    ----------
    nonzeros : int
        Entries of the stored factors.
    triangle : int
        Entries of one triangular factor.
    operations : float
        Real operations of LDLᵀ with real entries; complex entries take four times as many, LU twice as many.
    bytes : float or None
        Memory that the solver itself predicts; None if it does not.
    """

    nonzeros: int
    triangle: int
    operations: float
    bytes: float | None = None


class DynamicStiffness:
    """Z(s) on the union pattern of K, C and M, which is ordered and analysed once for all s.

    If the matrices allow it (``coupling_of``), a u-p system is made complex symmetric by dividing its acoustic rows by -kappa s². The
    matrix is then equilibrated: S = diag(l d) Z diag(d), with l this row scaling and d the inverse square root of the diagonal.

    Parameters
    ----------
    K, C, M : (n, n) csc_array
    is_acoustic : (n,) bool array
    backend : str
        Sparse solver: ``superlu``, ``pardiso`` or ``auto`` (PARDISO if it is installed).
    ordering : str
        ``metis``, ``bisection`` or ``auto``; SuperLU only.
    """

    def __init__(
        self, K: sp.csc_array, C: sp.csc_array, M: sp.csc_array, is_acoustic: Bools, *, backend: str = "auto", ordering: str = "auto"
    ) -> None:
        self.backend = pardiso.resolved(backend)
        self.K, self.C, self.M = K, C, M
        self.coupling = coupling_of(K, C, M, is_acoustic)
        self.symmetric = self.coupling.symmetric
        self._acoustic = is_acoustic
        n = K.shape[0]
        self.size = n

        # Patterns have entries of one byte: on large models copies of the values would need too much memory.
        union = _ones(K) + _ones(C) + _ones(M) + sp.eye_array(n, dtype=np.int8, format="csc")
        union = (union + union.T).tocsc()
        self._permuted = self.backend == "superlu"
        self._perm = nested_dissection(union.T, ordering) if self._permuted else np.arange(n)
        self._inverse = np.empty(n, dtype=np.int64)
        self._inverse[self._perm] = np.arange(n)

        def stored(matrix: sp.csc_array) -> sp.csr_array:
            """Storage order of the solver: PARDISO by rows (upper triangle only if symmetric), SuperLU by columns and permuted."""
            if self._permuted:
                found = matrix[self._perm][:, self._perm].T
            else:
                found = sp.triu(matrix, format="csr") if self.half else matrix.tocsr()
            found.sort_indices()
            return found

        pattern = stored(union)
        self.entries = int(union.nnz)
        del union
        self._values = [_spread(stored(matrix), pattern) for matrix in (K, C, M)]
        self._counts, self._minor = np.diff(pattern.indptr), pattern.indices
        self._diagonal = np.flatnonzero(self._major() == self._minor)
        self._indptr = pattern.indptr
        self._begin()

    def _begin(self) -> None:
        self._solver: Solver = (
            pardiso.Pardiso(self._indptr, self._minor, symmetric=self.symmetric)
            if self.backend == "pardiso"
            else SuperLuSolver(self._indptr, self._minor)
        )
        self._state: tuple[complex, Any, Any] | None = None
        self.factor_seconds: list[float] = []

    def twin(self) -> DynamicStiffness:
        """A copy with the same matrices and ordering but its own factors, for a second thread."""
        other = copy.copy(self)
        other._begin()
        return other

    def _major(self) -> Integers:
        """(entries,) row (PARDISO) or column (SuperLU) of each stored entry."""
        return np.repeat(np.arange(self.size), self._counts)

    @property
    def nonzeros(self) -> int:
        """Non-zeros of the latest factors."""
        return int(self._solver.nonzeros)

    @property
    def half(self) -> bool:
        """Whether only one triangular factor is stored (LDLᵀ)."""
        return self.backend == "pardiso" and self.symmetric

    def analyse(self) -> Analysis:
        """Fill and operations of a factorisation, from the pattern only."""
        if isinstance(self._solver, pardiso.Pardiso):
            nonzeros, operations, size = self._solver.analyse()
            return Analysis(nonzeros=nonzeros, triangle=nonzeros if self.half else nonzeros // 2, operations=operations, bytes=size)
        n = self.size
        pattern = sp.csr_array((np.ones(self._minor.size, dtype=np.int8), self._minor, self._indptr), shape=(n, n))
        fill = column_counts(pattern)
        return Analysis(nonzeros=2 * fill.nonzeros - n, triangle=fill.nonzeros, operations=fill.operations)

    def operator(self, s: complex) -> sp.csr_array:
        """(n, n) Z(s) as a sparse array."""
        return (s**2 * self.M + s * self.C + self.K).tocsr()

    def apply(self, s: complex, X: Complexes, *, transposed: bool = False) -> Complexes:
        """Z(s) X, or Z(s)ᵀ X."""
        K, C, M = ((op.T if transposed else op) for op in (self.K, self.C, self.M))
        out = (M @ X).astype(complex, copy=False)
        out *= s**2
        damped = (C @ X).astype(complex, copy=False)
        damped *= s
        out += damped
        out += K @ X
        return np.asarray(out)

    def factor(self, s: complex) -> Factorisation:
        """Factorise Z(s); the returned object is valid until the next call or ``release``.

        Raises
        ------
        NumericalError
            If the matrix has an empty or non-finite column, or the solver fails.
        """
        start = time.perf_counter()
        k, c, m = self._values
        data = s**2 * m
        data += s * c
        data += k
        left = np.ones(self.size, dtype=complex)
        if self.coupling.kappa is not None:
            left[self._acoustic] = -1.0 / (self.coupling.kappa * s**2)
        left = left[self._perm]
        data *= left[self._minor] if self._permuted else np.repeat(left, self._counts)
        size = np.abs(data[self._diagonal])
        largest = np.zeros(self.size)
        np.maximum.at(largest, self._major() if self._permuted else self._minor, np.abs(data))
        # If a diagonal entry is (nearly) zero, the largest entry of its column is used for scaling instead.
        size = np.where(size > 1e-8 * largest, size, largest)
        if np.any(size == 0.0) or not np.all(np.isfinite(size)):
            dof = int(self._perm[int(np.argmin(np.where(np.isfinite(size), size, 0.0)))])
            raise NumericalError(
                "the dynamic stiffness has an empty or non-finite column",
                place=f"DOF {dof}",
                hint="remove DOFs without stiffness and mass (fixed or orphan nodes) from the export",
            )
        d = 1.0 / np.sqrt(size)
        data *= d[self._minor]
        data *= np.repeat(d, self._counts)
        self._solver.factor(data)
        self._state = (s, np.asarray(left * d), np.asarray(d + 0j))
        self.factor_seconds.append(time.perf_counter() - start)
        return Factorisation(self, s)

    def release(self) -> None:
        """Release the memory of the factors; the analysis is kept, and another factorisation is needed before the next solve."""
        self._state = None
        self._solver.release()

    def regular(self, s: complex, x: Complexes, b: Complexes, *, transposed: bool = False) -> bool:
        """Whether columns solve the latest factorised system: a pivot of the size of round-off raises no error, but leaves a residual."""
        assert self._state is not None
        weight = np.abs(self._state[2 if transposed else 1])[:, None]
        rest = np.linalg.norm(weight * (b - self.apply(s, x, transposed=transposed))[self._perm], axis=0)
        return bool(np.all(rest <= RESIDUAL_LIMIT * np.linalg.norm(weight * b[self._perm], axis=0)))

    def _solve(self, s: complex, rhs: Columns, *, transposed: bool, refine: int) -> Complexes:
        if self._state is None or self._state[0] != s:
            raise NumericalError("the factorisation was released, or replaced by a later one")
        _, left, right = self._state
        before, after = (right, left) if transposed else (left, right)
        # A symmetric S needs no transposed solve.
        swap = transposed and not self.symmetric

        def once(b: Complexes) -> Complexes:
            y = self._solver.solve(before[:, None] * (b[self._perm] if self._permuted else b), transposed=swap)
            y *= after[:, None]
            return np.asarray(y[self._inverse] if self._permuted else y)

        def solved(b: Complexes) -> Complexes:
            x = once(b)
            regular = bool(np.all(np.isfinite(x)))
            if refine and regular:
                for _ in range(refine):
                    x += once(b - self.apply(s, x, transposed=transposed))
                regular = self.regular(s, x, b, transposed=transposed)
            if not regular:
                raise NumericalError(
                    f"the dynamic stiffness is singular at {abs(s) / (2 * np.pi):.6g} Hz", hint="add damping, or choose another band"
                )
            return x

        columns = rhs[:, None] if rhs.ndim == 1 else rhs
        # Fortran order, as PARDISO uses it; columns are contiguous.
        out = np.empty(columns.shape, dtype=complex, order="F")
        step = columns_at_once(self.size)
        for first in range(0, columns.shape[1], step):
            part = columns[:, first : first + step]
            dense = part if isinstance(part, np.ndarray) else part.toarray()
            out[:, first : first + step] = solved(np.asarray(dense, dtype=complex))
        return np.asarray(out[:, 0] if rhs.ndim == 1 else out)


def _ones(matrix: sp.csc_array) -> sp.csc_array:
    """The pattern of a matrix, with entries of one byte."""
    return sp.csc_array((np.ones(matrix.indices.size, dtype=np.int8), matrix.indices, matrix.indptr), shape=matrix.shape)


def _spread(matrix: sp.csr_array, pattern: sp.csr_array) -> NDArray[Any]:
    """Values of a matrix on a larger pattern that includes its own, zero elsewhere; both have sorted indices."""
    mine, whole = (sp.csr_array((np.full(A.indices.size, 1, dtype=np.int8), A.indices, A.indptr), shape=A.shape) for A in (matrix, pattern))
    values = np.zeros(pattern.indices.size, dtype=matrix.dtype)
    values[(mine + whole).data == 2] = matrix.data
    return values


@dataclass(frozen=True)
class Factorisation:
    """A factorised Z(s); valid until its owner factorises again or releases its factors."""

    owner: DynamicStiffness
    s: complex

    def solve(self, rhs: Columns, *, refine: int = 0) -> Complexes:
        """Z(s)⁻¹ B for dense or sparse B, (n,) or (n, m), with ``refine`` steps of iterative refinement; raises NumericalError."""
        return self.owner._solve(self.s, rhs, transposed=False, refine=refine)

    def solve_transposed(self, rhs: Columns, *, refine: int = 0) -> Complexes:
        """Z(s)⁻ᵀ B, likewise."""
        return self.owner._solve(self.s, rhs, transposed=True, refine=refine)

    def residual(self, x: Complexes, rhs: NDArray[Any]) -> float:
        """Largest relative residual of the columns of a solution x; rows are weighted by the inverse root of their largest entry of Z."""
        Z = self.owner.operator(self.s)
        weight = 1.0 / np.sqrt(abs(Z).max(axis=1).toarray().ravel())
        scale = np.abs(Z) @ np.abs(x) + np.abs(rhs)
        columns = (weight[:, None] if x.ndim == 2 else weight) * (Z @ x - rhs)
        norms = (weight[:, None] if x.ndim == 2 else weight) * scale
        return float(np.max(np.linalg.norm(columns, axis=0) / np.linalg.norm(norms, axis=0)))
