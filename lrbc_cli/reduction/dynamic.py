"""The dynamic stiffness Z(s) = s² M + s C + K of the full model, and its factorisations."""

from __future__ import annotations

import copy
import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from lrbc_cli.errors import NumericalError
from lrbc_cli.model.coupling import Coupling, coupling_of
from lrbc_cli.reduction import pardiso
from lrbc_cli.reduction.ordering import nested_dissection
from lrbc_cli.reduction.symbolic import column_counts

Complexes = NDArray[np.complexfloating[Any, Any]]

#: A refined solve whose residual stays above this fraction of its right-hand side is reported as singular.
RESIDUAL_LIMIT = 1e-6


class Solver(Protocol):
    """A sparse direct solver with a fixed pattern."""

    def factor(self, data: Complexes) -> None:
        """Factorise the values on the pattern."""

    def solve(self, rhs: Complexes, *, transposed: bool = False) -> Complexes:
        """Unrefined solution."""

    @property
    def nonzeros(self) -> int:
        """Non-zeros of the factors."""


class SuperLuSolver:
    """SciPy's SuperLU in symmetric mode on a nested-dissection ordering that was applied beforehand."""

    def __init__(self, indptr: NDArray[Any], indices: NDArray[Any]) -> None:
        self._indptr, self._indices = indptr.astype(np.int32), indices.astype(np.int32)
        self._lu: Any = None

    def factor(self, data: Complexes) -> None:
        """Factorise; the earlier factors are released first."""
        n = self._indptr.size - 1
        matrix = sp.csc_matrix((data, self._indices, self._indptr), shape=(n, n))
        self._lu = None
        try:
            # Threaded BLAS on small supernodes made this many times slower on busy cores.
            with threadpool_limits(limits=1, user_api="blas"):
                self._lu = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.01, options={"SymmetricMode": True})
        except MemoryError as error:
            raise NumericalError("SuperLU failed (not enough memory)", hint="a coarser model, or reduction.backend: pardiso") from error
        except RuntimeError as error:
            raise NumericalError(f"SuperLU failed ({error})") from error

    def solve(self, rhs: Complexes, *, transposed: bool = False) -> Complexes:
        """Unrefined solution."""
        with threadpool_limits(limits=1, user_api="blas"):
            return np.asarray(self._lu.solve(np.asfortranarray(rhs), "T" if transposed else "N"))

    @property
    def nonzeros(self) -> int:
        """Non-zeros of the factors."""
        return int(self._lu.nnz)


@dataclass(frozen=True)
class Analysis:
    """What a factorisation will take.

    Attributes
    ----------
    nonzeros : int
        Entries of the factors that are stored.
    triangle : int
        Entries of one triangular factor.
    operations : float
        Real operations of LDLᵀ with real entries; complex ones cost four times as much, LU twice.
    bytes : float or None
        What the solver itself says it will allocate.
    """

    nonzeros: int
    triangle: int
    operations: float
    bytes: float | None = None


class DynamicStiffness:
    """Z(s) with one analysed union pattern for all s.

    The u-p system is made complex symmetric by dividing its acoustic rows by -kappa s² where the matrices allow it
    (``coupling_of`` verifies that), and symmetrically equilibrated: S = diag(l d) Z diag(d).

    Parameters
    ----------
    K, C, M : (n, n) csc_array
    is_acoustic : (n,) bool array
    backend : str
        ``superlu``, ``pardiso`` or ``auto`` (PARDISO where it is installed).
    ordering : str
        ``metis``, ``bisection`` or ``auto``; SuperLU only.
    """

    def __init__(
        self,
        K: sp.csc_array,
        C: sp.csc_array,
        M: sp.csc_array,
        is_acoustic: NDArray[np.bool_],
        *,
        backend: str = "auto",
        ordering: str = "auto",
        coupling: Coupling | None = None,
    ) -> None:
        if backend == "auto":
            backend = "pardiso" if pardiso.library() else "superlu"
        self.backend = backend
        self.K, self.C, self.M = K, C, M
        self.coupling = coupling or coupling_of(K, C, M, is_acoustic)
        self.symmetric = self.coupling.symmetric
        self._acoustic = is_acoustic
        n = K.shape[0]
        self.size = n

        union = (abs(K) + abs(C) + abs(M) + sp.eye_array(n)).tocsr()
        union = (union + union.T).tocsr()
        if backend == "superlu":
            self._perm = nested_dissection(union, ordering)
        else:
            self._perm = np.arange(n)
        self._permuted = backend == "superlu"
        self._rows = [op.tocsr() for op in (K, C, M)]
        inverse = np.empty(n, dtype=np.int64)
        inverse[self._perm] = np.arange(n)
        self._inverse = inverse
        rows, cols = (inverse[index] for index in (union.tocoo().row, union.tocoo().col))
        upper = backend == "pardiso" and self.symmetric
        if upper:
            rows, cols = rows[rows <= cols], cols[rows <= cols]
        # PARDISO wants rows, SuperLU columns.
        major, minor = (rows, cols) if backend == "pardiso" else (cols, rows)
        key = np.sort(major * n + minor)
        self._major, self._minor = key // n, key % n
        self.entries = int(union.nnz)
        indptr = np.searchsorted(self._major, np.arange(n + 1))
        self._values = []
        for matrix in (K, C, M):
            coo = matrix.tocoo()
            r, c = inverse[coo.row], inverse[coo.col]
            keep = r <= c if upper else np.ones(r.size, dtype=bool)
            entry = (r * n + c if backend == "pardiso" else c * n + r)[keep]
            data = np.zeros(key.size, dtype=coo.data.dtype)
            data[np.searchsorted(key, entry)] = coo.data[keep]
            self._values.append(data)
        self._diagonal = np.searchsorted(key, np.arange(n) * n + np.arange(n))
        self._indptr = indptr
        self._begin()

    def _begin(self) -> None:
        self._solver: Solver = (
            pardiso.Pardiso(self._indptr, self._minor, symmetric=self.symmetric)
            if self.backend == "pardiso"
            else SuperLuSolver(self._indptr, self._minor)
        )
        self._state: tuple[complex, Any, Any] | None = None
        self.factor_seconds: list[float] = []
        self.solve_seconds: list[tuple[int, float]] = []

    def twin(self) -> DynamicStiffness:
        """Another one on the same matrices and ordering, with factors of its own: for a second thread."""
        other = copy.copy(self)
        other._begin()
        return other

    @property
    def nonzeros(self) -> int:
        """Non-zeros of the latest factors."""
        return int(self._solver.nonzeros)

    @property
    def half(self) -> bool:
        """Whether only one of two equal factors is stored."""
        return self.backend == "pardiso" and self.symmetric

    def analyse(self) -> Analysis:
        """Fill and operations of a factorisation, from the pattern alone."""
        if isinstance(self._solver, pardiso.Pardiso):
            nonzeros, operations, size = self._solver.analyse()
            return Analysis(nonzeros, nonzeros if self.half else nonzeros // 2, operations, size)
        n = self.size
        indptr, indices = np.searchsorted(self._major, np.arange(n + 1)), self._minor
        fill = column_counts(sp.csr_array((np.ones(indices.size, dtype=np.int8), indices, indptr), shape=(n, n)))
        return Analysis(2 * fill.nonzeros - n, fill.nonzeros, fill.operations)

    def operator(self, s: complex) -> sp.csr_array:
        """Z(s) as a sparse array."""
        return (s**2 * self.M + s * self.C + self.K).tocsr()

    def apply(self, s: complex, X: Complexes, *, transposed: bool = False) -> Complexes:
        """Z(s) X, or Z(s)ᵀ X."""
        K, C, M = (op.T for op in self._rows) if transposed else self._rows
        return np.asarray(s**2 * (M @ X) + s * (C @ X) + K @ X)

    def factor(self, s: complex) -> Factorisation:
        """Factorise Z(s); the returned object is valid until the next call.

        Raises
        ------
        NumericalError
            Where the matrix is singular.
        """
        start = time.perf_counter()
        k, c, m = self._values
        data = s**2 * m + s * c + k
        left = np.ones(self.size, dtype=complex)
        if self.coupling.kappa is not None:
            left[self._acoustic] = -1.0 / (self.coupling.kappa * s**2)
        left = left[self._perm]
        row = self._major if self.backend == "pardiso" else self._minor
        col = self._minor if self.backend == "pardiso" else self._major
        data = left[row] * data
        size = np.abs(data[self._diagonal])
        largest = np.zeros(self.size)
        np.maximum.at(largest, col, np.abs(data))
        # A (nearly) empty diagonal is scaled by the largest entry of its column instead.
        size = np.where(size > 1e-8 * largest, size, largest)
        if np.any(size == 0.0) or not np.all(np.isfinite(size)):
            dof = int(self._perm[int(np.argmin(np.where(np.isfinite(size), size, 0.0)))])
            raise NumericalError(
                "the dynamic stiffness has an empty or non-finite column",
                place=f"DOF {dof}",
                hint="remove DOFs without stiffness and mass (fixed or orphan nodes) from the export",
            )
        d = 1.0 / np.sqrt(size)
        self._solver.factor(d[row] * data * d[col])
        self._state = (s, np.asarray(left * d), np.asarray(d + 0j))
        self.factor_seconds.append(time.perf_counter() - start)
        return Factorisation(self, s)

    def _solve(self, s: complex, rhs: Complexes, *, transposed: bool, refine: int) -> Complexes:
        if self._state is None or self._state[0] != s:
            raise NumericalError("the factorisation was replaced by a later one")
        start = time.perf_counter()
        _, left, right = self._state
        before, after = (right, left) if transposed else (left, right)
        # A symmetric S needs no transposed solve.
        swap = transposed and not self.symmetric

        def once(b: Complexes) -> Complexes:
            scaled = (before if b.ndim == 1 else before[:, None]) * (b[self._perm] if self._permuted else b)
            y = self._solver.solve(scaled, transposed=swap)
            y *= after if b.ndim == 1 else after[:, None]
            return np.asarray(y[self._inverse] if self._permuted else y)

        b = np.asarray(rhs, dtype=complex)
        x = once(b)
        regular = bool(np.all(np.isfinite(x)))
        if refine and regular:
            for _ in range(refine):
                x = x + once(b - self.apply(s, x, transposed=transposed))
            # A pivot of the size of round-off gives no error and a finite solution, which does not solve.
            weight = np.abs(before) if b.ndim == 1 else np.abs(before)[:, None]
            rest = np.linalg.norm(weight * (b - self.apply(s, x, transposed=transposed))[self._perm], axis=0)
            regular = bool(np.all(rest <= RESIDUAL_LIMIT * np.linalg.norm(weight * b[self._perm], axis=0)))
        self.solve_seconds.append((1 if b.ndim == 1 else b.shape[1], time.perf_counter() - start))
        if not regular:
            raise NumericalError(
                f"the dynamic stiffness is singular at {abs(s) / (2 * np.pi):.6g} Hz", hint="add damping, or choose another band"
            )
        return x


@dataclass(frozen=True)
class Factorisation:
    """One factorised Z(s)."""

    owner: DynamicStiffness
    s: complex

    def solve(self, rhs: NDArray[Any], *, refine: int = 0) -> Complexes:
        """Z(s)⁻¹ B, (n,) or (n, m), with ``refine`` steps of iterative refinement."""
        return self.owner._solve(self.s, rhs, transposed=False, refine=refine)

    def solve_transposed(self, rhs: NDArray[Any], *, refine: int = 0) -> Complexes:
        """Z(s)⁻ᵀ B."""
        return self.owner._solve(self.s, rhs, transposed=True, refine=refine)

    def residual(self, x: Complexes, rhs: NDArray[Any]) -> float:
        """Largest column-wise relative residual of a solution, rows weighted by the largest entry of Z in them."""
        Z = self.owner.operator(self.s)
        weight = 1.0 / np.sqrt(abs(Z).max(axis=1).toarray().ravel())
        scale = np.abs(Z) @ np.abs(x) + np.abs(rhs)
        columns = (weight[:, None] if x.ndim == 2 else weight) * (Z @ x - rhs)
        norms = (weight[:, None] if x.ndim == 2 else weight) * scale
        return float(np.max(np.linalg.norm(columns, axis=0) / np.linalg.norm(norms, axis=0)))
