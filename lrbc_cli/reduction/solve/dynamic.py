"""The dynamic stiffness Z(s) = s² M + s C + K of the full model, and its factorisations."""

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
from lrbc_cli.model.coupling import Coupling, coupling_of
from lrbc_cli.reduction.solve import pardiso
from lrbc_cli.reduction.solve.ordering import nested_dissection
from lrbc_cli.reduction.solve.symbolic import column_counts

#: Right-hand sides, (n,) or (n, m), or sparse (n, m).
Columns: TypeAlias = NDArray[Any] | sp.csc_array

#: A refined solve whose residual stays above this fraction of its right-hand side is reported as singular.
RESIDUAL_LIMIT = 1e-6

#: Right-hand sides that are solved for together: more gain nothing, and each takes several vectors besides its solution.
COLUMNS = 16

#: More of them where one array of them stays below this.
COLUMN_BYTES = 64e6


class Solver(Protocol):
    """A sparse direct solver with a fixed pattern."""

    def factor(self, data: Complexes) -> None:
        """Factorise the values on the pattern."""

    def solve(self, rhs: Complexes, *, transposed: bool = False) -> Complexes:
        """Unrefined solution."""

    def release(self) -> None:
        """Give the memory of the factors back; solves need another factorisation."""

    @property
    def nonzeros(self) -> int:
        """Non-zeros of the latest factors."""


def columns_at_once(size: int) -> int:
    """How many right-hand sides of a model of so many DOFs are solved together."""
    return max(COLUMNS, int(COLUMN_BYTES / (16 * size)))


class SuperLuSolver:
    """SciPy's SuperLU in symmetric mode on a nested-dissection ordering that was applied beforehand."""

    def __init__(self, indptr: NDArray[Any], indices: NDArray[Any]) -> None:
        self._indptr, self._indices = indptr.astype(np.int32), indices.astype(np.int32)
        self._lu: Any = None
        self._nonzeros = 0

    def factor(self, data: Complexes) -> None:
        """Factorise; the earlier factors are released first."""
        n = self._indptr.size - 1
        matrix = sp.csc_matrix((data, self._indices, self._indptr), shape=(n, n))
        self.release()
        try:
            # Threaded BLAS on small supernodes made this many times slower on busy cores.
            with threadpool_limits(limits=1, user_api="blas"):
                self._lu = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.01, options={"SymmetricMode": True})
                self._nonzeros = int(self._lu.nnz)
        except MemoryError as error:
            raise NumericalError("SuperLU failed (not enough memory)", hint="a coarser model, or reduction.backend: pardiso") from error
        except RuntimeError as error:
            raise NumericalError(f"SuperLU failed ({error})") from error

    def solve(self, rhs: Complexes, *, transposed: bool = False) -> Complexes:
        """Unrefined solution."""
        with threadpool_limits(limits=1, user_api="blas"):
            try:
                return np.asarray(self._lu.solve(np.asfortranarray(rhs), "T" if transposed else "N"))
            except RuntimeError as error:
                raise MemoryError(str(error)) if "MALLOC" in str(error).upper() else error from None

    def release(self) -> None:
        """Give the memory of the factors back."""
        self._lu = None

    @property
    def nonzeros(self) -> int:
        """Non-zeros of the latest factors."""
        return self._nonzeros


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
        is_acoustic: Bools,
        *,
        backend: str = "auto",
        ordering: str = "auto",
        coupling: Coupling | None = None,
    ) -> None:
        self.backend = pardiso.resolved(backend)
        self.K, self.C, self.M = K, C, M
        self.coupling = coupling or coupling_of(K, C, M, is_acoustic)
        self.symmetric = self.coupling.symmetric
        self._acoustic = is_acoustic
        n = K.shape[0]
        self.size = n

        # Patterns are counted in bytes: on large models the operators' values would be copied several times over.
        union = _ones(K) + _ones(C) + _ones(M) + sp.eye_array(n, dtype=np.int8, format="csc")
        union = (union + union.T).tocsc()
        self._permuted = self.backend == "superlu"
        self._perm = nested_dissection(union.T, ordering) if self._permuted else np.arange(n)
        self._inverse = np.empty(n, dtype=np.int64)
        self._inverse[self._perm] = np.arange(n)

        def stored(matrix: sp.csc_array) -> sp.csr_array:
            """As the solver wants it: PARDISO by rows, of the upper triangle where symmetric; SuperLU by columns, reordered."""
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
        """Another one on the same matrices and ordering, with factors of its own: for a second thread."""
        other = copy.copy(self)
        other._begin()
        return other

    def _major(self) -> Integers:
        """Row of each stored entry for PARDISO, column for SuperLU."""
        return np.repeat(np.arange(self.size), self._counts)

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
        pattern = sp.csr_array((np.ones(self._minor.size, dtype=np.int8), self._minor, self._indptr), shape=(n, n))
        fill = column_counts(pattern)
        return Analysis(2 * fill.nonzeros - n, fill.nonzeros, fill.operations)

    def operator(self, s: complex) -> sp.csr_array:
        """Z(s) as a sparse array."""
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
        """Factorise Z(s); the returned object is valid until the next call.

        Raises
        ------
        NumericalError
            Where the matrix is singular.
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
        data *= d[self._minor]
        data *= np.repeat(d, self._counts)
        self._solver.factor(data)
        self._state = (s, np.asarray(left * d), np.asarray(d + 0j))
        self.factor_seconds.append(time.perf_counter() - start)
        return Factorisation(self, s)

    def release(self) -> None:
        """Give the memory of the factors back; the analysis stays, and solves need another factorisation."""
        self._state = None
        self._solver.release()

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
                # A pivot of the size of round-off gives no error and a finite solution, which does not solve.
                weight = np.abs(before)[:, None]
                rest = np.linalg.norm(weight * (b - self.apply(s, x, transposed=transposed))[self._perm], axis=0)
                regular = bool(np.all(rest <= RESIDUAL_LIMIT * np.linalg.norm(weight * b[self._perm], axis=0)))
            if not regular:
                raise NumericalError(
                    f"the dynamic stiffness is singular at {abs(s) / (2 * np.pi):.6g} Hz", hint="add damping, or choose another band"
                )
            return x

        columns = rhs[:, None] if rhs.ndim == 1 else rhs
        # Fortran order: PARDISO's own, and a part of the columns lies together.
        out = np.empty(columns.shape, dtype=complex, order="F")
        step = columns_at_once(self.size)
        for first in range(0, columns.shape[1], step):
            part = columns[:, first : first + step]
            dense = part if isinstance(part, np.ndarray) else part.toarray()
            out[:, first : first + step] = solved(np.asarray(dense, dtype=complex))
        return np.asarray(out[:, 0] if rhs.ndim == 1 else out)


def _ones(matrix: sp.csc_array) -> sp.csc_array:
    """The pattern of a matrix, a byte an entry."""
    return sp.csc_array((np.ones(matrix.indices.size, dtype=np.int8), matrix.indices, matrix.indptr), shape=matrix.shape)


def _spread(matrix: sp.csr_array, pattern: sp.csr_array) -> NDArray[Any]:
    """Values of a matrix on a pattern that contains its own, zero elsewhere; both with sorted indices."""
    mine, whole = (sp.csr_array((np.full(A.indices.size, 1, dtype=np.int8), A.indices, A.indptr), shape=A.shape) for A in (matrix, pattern))
    values = np.zeros(pattern.indices.size, dtype=matrix.dtype)
    values[(mine + whole).data == 2] = matrix.data
    return values


@dataclass(frozen=True)
class Factorisation:
    """One factorised Z(s)."""

    owner: DynamicStiffness
    s: complex

    def solve(self, rhs: Columns, *, refine: int = 0) -> Complexes:
        """Z(s)⁻¹ B, (n,) or (n, m), dense or sparse, with ``refine`` steps of iterative refinement."""
        return self.owner._solve(self.s, rhs, transposed=False, refine=refine)

    def solve_transposed(self, rhs: Columns, *, refine: int = 0) -> Complexes:
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
