"""The real basis V = diag(Vs, Va), split into structure and air, and the operators projected on it, extended block by block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.errors import NumericalError

#: Loss of orthonormality above which the basis is refused.
ORTHONORMALITY = 1e-10

#: Share of the stiffness in the norm of residuals. The residual of a nearly converged basis is smooth (M times a mode above the band), and
#: the large stiffness of a fine mesh would hide it: with the full share estimates were orders of magnitude below the error.
RESIDUAL_STIFFNESS = 0.1

#: Smallest deflation for which singular values are computed from the normal matrix, which squares them.
SQUARED = 3e-7

#: Rows (for each field) of the sparse sign embedding, which gives norms of residuals without forming the residuals.
SKETCH = 96

#: A block whose asymmetry is at most this fraction of its largest entry is projected as a symmetric one.
MIRRORED = 1e-14


@dataclass
class Field:
    """The block of the basis for one field, structure or air.

    Attributes
    ----------
    dofs : (n_f,) int array
        DOFs of the field.
    weight : (n_f,) float array
        Square root of a diagonal energy norm. Columns of V are orthonormal after scaling with it, so that translations, rotations and
        pressures have comparable weight.
    Q : (n_f, r_f) float array
        Orthonormal columns; V = Q / weight.
    """

    dofs: Integers
    weight: Floats
    Q: Floats

    @property
    def V(self) -> Floats:
        """(n_f, r_f) basis in the units of the DOFs."""
        return np.asarray(self.Q / self.weight[:, None])


def energy_weight(K: sp.csc_array, M: sp.csc_array, omega: float, stiffness: float = 1.0) -> Floats:
    """(n,) weights ``sqrt(stiffness |diag K| + omega² |diag M|)``, at least the smallest positive one."""
    diagonal = stiffness * np.abs(K.diagonal()) + omega**2 * np.abs(M.diagonal())
    floor = diagonal[diagonal > 0].min() if np.any(diagonal > 0) else 1.0
    return np.asarray(np.sqrt(np.maximum(diagonal, floor)))


def new_directions(field: Field, blocks: Sequence[Complexes], deflation: float) -> Floats:
    """Orthonormal directions by which snapshots (solutions of the full model) extend the basis of a field.

    Each complex snapshot is scaled to norm one and enters as real and imaginary part. Directions whose singular value is below
    ``deflation`` are nearly dependent on the others and are dropped.

    Parameters
    ----------
    field : Field
    blocks : sequence of (n, m) complex arrays
        Snapshots, rows of all fields, in the units of the DOFs.
    deflation : float

    Returns
    -------
    (n_f, k) float array
        In weighted coordinates.
    """
    count = sum(block.shape[1] for block in blocks)
    Y = np.empty((field.dofs.size, 2 * count), order="F")
    start = 0
    for block in blocks:
        # Column by column, since a copy of all snapshots needs much memory in large models.
        for column in range(block.shape[1]):
            values = block[field.dofs, column]
            np.multiply(values.real, field.weight, out=Y[:, start])
            np.multiply(values.imag, field.weight, out=Y[:, count + start])
            start += 1
    norm = np.sqrt(np.einsum("ij,ij->j", Y, Y))
    norm = np.hypot(norm[:count], norm[count:])
    Y /= np.tile(np.where(norm > 0, norm, 1.0), 2)
    for _ in range(2):  # twice is enough (Kahan, Parlett)
        Y -= field.Q @ (field.Q.T @ Y)
    size = np.sqrt(np.einsum("ij,ij->j", Y, Y))
    Y = Y[:, size > 0.1 * deflation]
    if Y.shape[1] == 0:
        return np.zeros((field.dofs.size, 0))
    new = _principal(Y, deflation)
    # Round-off is amplified in directions with small singular values: orthogonalise against the basis once more.
    new -= field.Q @ (field.Q.T @ new)
    return _orthonormal(new)


def _principal(Y: Floats, deflation: float) -> Floats:
    """Left singular vectors of Y with singular values above ``deflation``, roughly orthonormal."""
    if deflation >= SQUARED:
        # Eigenvectors of the normal matrix are cheaper than a factorisation of the tall matrix.
        values, vectors = la.eigh(Y.T @ Y, check_finite=False)
        keep = values > deflation**2
        return np.asarray(Y @ (vectors[:, keep] / np.sqrt(values[keep]))[:, ::-1])
    q, r = la.qr(Y, mode="economic", check_finite=False)
    u, sigma, _ = la.svd(r, full_matrices=False, check_finite=False)
    return np.asarray(q @ u[:, sigma > deflation])


def _orthonormal(new: Floats) -> Floats:
    """Orthonormalise nearly orthonormal columns in their order (Cholesky QR, twice)."""
    for _ in range(2):
        try:
            factor = la.cholesky(new.T @ new, check_finite=False)
        except la.LinAlgError:
            return np.asarray(la.qr(new, mode="economic", check_finite=False)[0])
        new = la.solve_triangular(factor, new.T, trans="T", check_finite=False).T
    return np.asarray(new)


def check_orthonormal(field: Field) -> float:
    """Largest entry of |QᵀQ - I|.

    Raises
    ------
    NumericalError
        If it exceeds ``ORTHONORMALITY``.
    """
    defect = float(np.abs(field.Q.T @ field.Q - np.eye(field.Q.shape[1])).max(initial=0.0))
    if not defect <= ORTHONORMALITY:
        raise NumericalError("the reduced basis is no longer orthonormal", expected=f"at most {ORTHONORMALITY:.0e}", found=f"{defect:.1e}")
    return defect


@dataclass(frozen=True, kw_only=True)
class Projected:
    """Snapshot of a ``Projection`` for responses and residual estimates, without the basis itself, which may be very large.

    Attributes
    ----------
    operators : three (r, r) arrays
        Projected K, C, M.
    inputs, dual : (r, m) and (r, q) float arrays
        Vᵀ B_ext, and Vᵀ times the dual right-hand sides.
    outputs : (p, r) float array
        L_ext V.
    sketches, turned : three (fields * SKETCH, r) arrays
        Sketches of K V, C V and M V; and the same for the transposed operators (equal to ``sketches`` for symmetric models).
    sketched_inputs, sketched_dual : (fields * SKETCH, m) and (fields * SKETCH, q) float arrays
        Sketches of B_ext and of the dual right-hand sides.
    sizes : list of int
        Reduced DOFs of each field.
    """

    operators: tuple[Any, Any, Any]
    inputs: Floats
    dual: Floats
    outputs: Floats
    sketches: tuple[Any, Any, Any]
    turned: tuple[Any, Any, Any]
    sketched_inputs: Floats
    sketched_dual: Floats
    sizes: list[int]


class Projection:
    """Operators projected on the growing basis, block by block of the fields, and random sketches for the norms of residuals.

    Parameters
    ----------
    operators : sequence of (n, n) csc_array
        K, C, M.
    inputs : (n, m) csc_array
        B_ext.
    outputs : (p, n) csc_array
        L_ext.
    fields : list of Field
    dual : (n, q) csc_array
        Right-hand sides of the dual (transposed) problem.
    residual_weight : (n,) float array
        Residuals are divided by it, row by row, before their norm is taken.
    transposed : bool
        Keep sketches of the transposed operators too, for models that cannot be symmetrised.
    """

    def __init__(
        self,
        operators: Sequence[sp.csc_array],
        inputs: sp.csc_array,
        outputs: sp.csc_array,
        fields: list[Field],
        *,
        dual: sp.csc_array,
        residual_weight: Floats,
        transposed: bool = False,
    ) -> None:
        self.fields = fields
        self._transposed = transposed
        count = range(len(fields))
        weights = [residual_weight[field.dofs] for field in fields]
        # Division by an array gives coordinate format, which SciPy before 1.16 cannot slice.
        self._theta = [(_sparse_sign(SKETCH, weight.size, seed) / weight).tocsr() for seed, weight in enumerate(weights)]
        self._parts = [_blocks_of(operator, fields) for operator in operators]
        self._mirrored = [{pair: pair[0] == pair[1] and _is_symmetric(part) for pair, part in parts.items()} for parts in self._parts]
        self._blocks: list[dict[tuple[int, int], Any]] = [
            {pair: np.zeros((0, 0), dtype=part.dtype) for pair, part in parts.items()} for parts in self._parts
        ]
        # The products K V, C V, M V are not kept: they would take as much memory as several bases.
        self._sketches = [_empty_sketches(parts) for parts in self._parts]
        self._turned = [
            {(f, g): parts[g, f].T for f in count for g in count if (g, f) in parts} if transposed else {} for parts in self._parts
        ]
        self._turned_sketches = [_empty_sketches(parts) for parts in self._turned]
        self._inputs = [_Rows.of(inputs.tocsr()[field.dofs]) for field in fields]
        self._outputs = [_Rows.of(outputs.tocsc()[:, field.dofs].T.tocsr()) for field in fields]
        self._dual = [_Rows.of(dual.tocsr()[field.dofs]) for field in fields]
        self.sketched_inputs = self._stack(self._inputs)
        self.sketched_dual = self._stack(self._dual)

    def _stack(self, parts: list[_Rows]) -> Floats:
        return np.vstack([(theta[:, part.rows] @ part.values).toarray() for theta, part in zip(self._theta, parts, strict=True)])

    @property
    def size(self) -> int:
        """Number of reduced DOFs r."""
        return sum(self.sizes)

    @property
    def sizes(self) -> list[int]:
        """Number of reduced DOFs of each field."""
        return [field.Q.shape[1] for field in self.fields]

    def extend(self, new: Sequence[Floats]) -> None:
        """Extend the basis by orthonormal directions in weighted coordinates, one (n_f, k_f) array for each field."""
        old, fields = self.sizes, self.fields
        added = [directions / field.weight[:, None] for directions, field in zip(new, fields, strict=True)]
        for which, parts in enumerate(self._parts):
            for (f, g), part in parts.items():
                image = part @ added[g]
                self._append_sketch(self._sketches[which], f, g, image)
                image /= fields[f].weight[:, None]
                block = np.zeros((old[f] + new[f].shape[1], old[g] + new[g].shape[1]), dtype=image.dtype)
                block[: old[f], : old[g]] = self._blocks[which][f, g]
                block[: old[f], old[g] :] = fields[f].Q.T @ image
                block[old[f] :, old[g] :] = new[f].T @ image
                if self._mirrored[which][f, g]:
                    block[old[f] :, : old[g]] = block[: old[f], old[g] :].T
                else:
                    block[old[f] :, : old[g]] = ((part.T @ added[f]) / fields[g].weight[:, None]).T @ fields[g].Q
                self._blocks[which][f, g] = block
            for (f, g), part in self._turned[which].items():
                self._append_sketch(self._turned_sketches[which], f, g, part @ added[g])
        for field, directions in zip(fields, new, strict=True):
            field.Q = np.hstack([field.Q, directions])

    def _append_sketch(self, sketches: dict[tuple[int, int], Any], f: int, g: int, image: Any) -> None:
        sketches[f, g] = np.hstack([sketches[f, g], self._theta[f] @ image])

    def restrict(self, turns: Sequence[Floats]) -> None:
        """Restrict the basis to a subspace: Q becomes Q T, with an (r_f, k_f) matrix T of orthonormal columns for each field."""
        for blocks in self._blocks:
            for f, g in blocks:
                blocks[f, g] = turns[f].T @ blocks[f, g] @ turns[g]
        for sketches in (*self._sketches, *self._turned_sketches):
            for f, g in sketches:
                sketches[f, g] = sketches[f, g] @ turns[g]
        for field, turn in zip(self.fields, turns, strict=True):
            field.Q = field.Q @ turn

    @property
    def operators(self) -> tuple[Any, Any, Any]:
        """(r, r) Vᵀ K V, Vᵀ C V and Vᵀ M V with the terms at their reference values, fields one after the other."""
        K, C, M = (self._assemble(blocks, self.sizes) for blocks in self._blocks)
        return K, C, M

    def project(self, matrix: sp.csc_array) -> Any:
        """(r, r) Vᵀ A V of any (n, n) matrix A, fields one after the other."""
        blocks, fields = _blocks_of(matrix, self.fields), self.fields
        return self._assemble({(f, g): fields[f].V.T @ (part @ fields[g].V) for (f, g), part in blocks.items()}, self.sizes)

    def lift(self, states: Any) -> Any:
        """(n, k) full states V a of (r, k) reduced states a."""
        out = np.empty((sum(field.dofs.size for field in self.fields), states.shape[1]), dtype=states.dtype)
        start = 0
        for field in self.fields:
            part = states[start : start + field.Q.shape[1]]
            out[field.dofs] = (field.Q @ part) / field.weight[:, None]
            start += field.Q.shape[1]
        return out

    def rows_at(self, dofs: Integers) -> Floats:
        """(k, r) rows of V at k DOFs."""
        out, start = np.zeros((dofs.size, self.size)), 0
        for field in self.fields:
            at = np.searchsorted(field.dofs, dofs).clip(max=field.dofs.size - 1)
            own = np.flatnonzero(field.dofs[at] == dofs)
            out[own, start : start + field.Q.shape[1]] = field.Q[at[own]] / field.weight[at[own], None]
            start += field.Q.shape[1]
        return out

    def projected(self) -> Projected:
        """The present projections and sketches; later changes of the basis do not affect them."""
        heights = [SKETCH] * len(self.fields)
        K, C, M = (self._assemble(sketches, heights) for sketches in self._sketches)
        turned = [self._assemble(sketches, heights) for sketches in self._turned_sketches] if self._transposed else [K, C, M]
        return Projected(
            operators=self.operators,
            inputs=self.inputs,
            dual=self.dual,
            outputs=self.outputs,
            sketches=(K, C, M),
            turned=(turned[0], turned[1], turned[2]),
            sketched_inputs=self.sketched_inputs,
            sketched_dual=self.sketched_dual,
            sizes=self.sizes,
        )

    def _assemble(self, blocks: dict[tuple[int, int], Any], heights: list[int]) -> Any:
        sizes = self.sizes
        zeros = [[np.zeros((height, width)) for width in sizes] for height in heights]
        return np.block([[blocks.get((f, g), zero) for g, zero in enumerate(row)] for f, row in enumerate(zeros)])

    @property
    def inputs(self) -> Floats:
        """(r, m) Vᵀ B_ext."""
        return np.vstack([part.against(field) for part, field in zip(self._inputs, self.fields, strict=True)])

    @property
    def dual(self) -> Floats:
        """(r, q) Vᵀ times the dual right-hand sides."""
        return np.vstack([part.against(field) for part, field in zip(self._dual, self.fields, strict=True)])

    @property
    def outputs(self) -> Floats:
        """(p, r) L_ext V."""
        return np.hstack([part.against(field).T for part, field in zip(self._outputs, self.fields, strict=True)])


@dataclass(frozen=True)
class _Rows:
    """The non-empty rows of a sparse matrix."""

    rows: Integers
    values: sp.csr_array

    @classmethod
    def of(cls, matrix: sp.csr_array) -> _Rows:
        rows = np.flatnonzero(np.diff(matrix.indptr))
        return cls(rows, matrix[rows])

    def against(self, field: Field) -> Floats:
        """(r, m) Vᵀ A."""
        return np.asarray((self.values.T @ (field.Q[self.rows] / field.weight[self.rows, None])).T)


def _empty_sketches(parts: Mapping[tuple[int, int], Any]) -> dict[tuple[int, int], Any]:
    return {pair: np.zeros((SKETCH, 0), dtype=part.dtype) for pair, part in parts.items()}


def _is_symmetric(part: sp.csr_array) -> bool:
    rest = part - part.T
    return bool(rest.nnz == 0 or np.abs(rest.data).max() <= MIRRORED * np.abs(part.data).max())


def narrow(A: Any) -> Any:
    """The same matrix with 32-bit indices if they suffice: slicing gives 64-bit ones, which take as much memory as the values."""
    if A.indices.itemsize > 4 and max(*A.shape, A.nnz) < 2**31:
        return type(A)((A.data, A.indices.astype(np.int32), A.indptr.astype(np.int32)), shape=A.shape)
    return A


def _blocks_of(operator: sp.csc_array, fields: Sequence[Field]) -> dict[tuple[int, int], sp.csr_array]:
    rows = [operator.tocsr()[field.dofs] for field in fields]
    parts = {(f, g): narrow(rows[f][:, fields[g].dofs].tocsr()) for f in range(len(fields)) for g in range(len(fields))}
    return {pair: part for pair, part in parts.items() if part.nnz}


def _sparse_sign(rows: int, columns: int, seed: int, per_column: int = 4) -> sp.csr_array:
    """(rows, columns) random sparse sign embedding theta: the expectation of |theta x|² is |x|²."""
    rng = np.random.default_rng(seed)
    row = rng.integers(0, rows, size=(columns, per_column))
    sign = rng.choice([-1.0, 1.0], size=(columns, per_column)) / np.sqrt(per_column)
    column = np.repeat(np.arange(columns), per_column)
    return sp.coo_array((sign.ravel(), (row.ravel(), column)), shape=(rows, columns)).tocsr()
