"""The split real basis V = diag(Vs, Va) and what is projected on it, grown block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.errors import NumericalError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complexfloating[Any, Any]]

#: Loss of orthonormality above which the basis is refused.
ORTHONORMALITY = 1e-10

#: Share of the stiffness in the norm of residuals. What a converging basis lacks is smooth, M times a mode beyond the band, and a norm of
#: the mesh's own stiffness would not see it: on fine meshes the estimate fell below the error by orders of magnitude.
RESIDUAL_STIFFNESS = 0.1


@dataclass
class Field:
    """One diagonal block of the basis.

    Attributes
    ----------
    dofs : (n_f,) int array
        DOFs of the field.
    weight : (n_f,) float array
        Square root of a diagonal energy norm: columns are orthonormal after scaling with it, so that translations,
        rotations and pressures are measured alike.
    Q : (n_f, r_f) float array
        Orthonormal columns; V = Q / weight.
    """

    dofs: NDArray[np.int64]
    weight: Floats
    Q: Floats

    @property
    def V(self) -> Floats:
        """(n_f, r_f) basis in the units of the DOFs."""
        return np.asarray(self.Q / self.weight[:, None])


def energy_weight(K: sp.csc_array, M: sp.csc_array, omega: float, stiffness: float = 1.0) -> Floats:
    """(n,) square root of stiffness |diag K| + omega² |diag M|, floored where both vanish."""
    diagonal = stiffness * np.abs(K.diagonal()) + omega**2 * np.abs(M.diagonal())
    floor = diagonal[diagonal > 0].min() if np.any(diagonal > 0) else 1.0
    return np.asarray(np.sqrt(np.maximum(diagonal, floor)))


def new_directions(field: Field, X: Complexes, deflation: float) -> Floats:
    """Orthonormal directions that the snapshots X add to a field.

    Complex snapshots enter as real and imaginary part. Each snapshot is scaled to norm one first; directions whose singular
    value is below ``deflation`` are near-dependent and dropped.

    Parameters
    ----------
    field : Field
    X : (n_f, m) complex array
        Snapshots in the units of the DOFs.
    deflation : float

    Returns
    -------
    (n_f, k) float array
        In weighted coordinates.
    """
    Y = X * field.weight[:, None]
    norm = np.linalg.norm(Y, axis=0)
    Y = Y[:, norm > 0] / norm[norm > 0]
    Y = np.hstack([Y.real, Y.imag])
    for _ in range(2):  # twice is enough (Kahan, Parlett)
        Y -= field.Q @ (field.Q.T @ Y)
    if Y.size == 0:
        return np.zeros((field.dofs.size, 0))
    size = np.linalg.norm(Y, axis=0)
    Y = Y[:, size > 0.1 * deflation]
    if Y.shape[1] == 0:
        return np.zeros((field.dofs.size, 0))
    q, r = la.qr(Y, mode="economic", overwrite_a=True, check_finite=False)
    u, sigma, _ = la.svd(r, full_matrices=False, check_finite=False)
    new = q @ u[:, sigma > deflation]
    # Directions kept with a small singular value inherit its amplified round-off: clean them once more.
    new -= field.Q @ (field.Q.T @ new)
    new, _ = la.qr(new, mode="economic", overwrite_a=True, check_finite=False)
    return np.asarray(new)


def check_orthonormal(field: Field) -> float:
    """Largest entry of QᵀQ - I.

    Raises
    ------
    NumericalError
        Where it exceeds ``ORTHONORMALITY``.
    """
    defect = float(np.abs(field.Q.T @ field.Q - np.eye(field.Q.shape[1])).max(initial=0.0))
    if not defect <= ORTHONORMALITY:
        raise NumericalError("the reduced basis lost its orthonormality", expected=f"at most {ORTHONORMALITY:.0e}", found=f"{defect:.1e}")
    return defect


class Projection:
    """Operators projected on the growing basis, block by block of the fields, and a random sketch of their residuals.

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
        Residuals are measured in the norm of rows divided by it.
    transposed : bool
        Keep sketches of the transposed operators too, for models that cannot be symmetrised.
    sketch : int
        Rows a field of the sparse sign embedding that measures residual norms without forming the residuals.
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
        sketch: int = 96,
    ) -> None:
        self.fields = fields
        self.rows = sketch
        self._V = [np.zeros((field.dofs.size, 0)) for field in fields]
        self._theta = [_sparse_sign(sketch, field.dofs.size, seed) / residual_weight[field.dofs] for seed, field in enumerate(fields)]
        self._parts = [_blocks_of(operator, fields) for operator in operators]
        self._images: list[dict[tuple[int, int], Any]] = [
            {(f, g): np.zeros((fields[f].dofs.size, 0), dtype=part.dtype) for (f, g), part in parts.items()} for parts in self._parts
        ]
        self._blocks: list[dict[tuple[int, int], Any]] = [
            {pair: np.zeros((0, 0), dtype=part.dtype) for pair, part in parts.items()} for parts in self._parts
        ]
        # Theta Aᵀ is formed once, so that its product with V needs no second image of the basis.
        self._transposed = [
            {(f, g): self._theta[f] @ part for (f, g), part in _blocks_of(operator.T.tocsc(), fields).items()} if transposed else {}
            for operator in operators
        ]
        self._inputs = [inputs.tocsr()[field.dofs] for field in fields]
        self._outputs = [outputs.tocsc()[:, field.dofs] for field in fields]
        self._dual = [dual.tocsr()[field.dofs] for field in fields]
        self.sketched_inputs = self._stack(self._inputs)
        self.sketched_dual = self._stack(self._dual)

    def _stack(self, parts: list[sp.csr_array]) -> Floats:
        return np.vstack([(theta @ part).toarray() for theta, part in zip(self._theta, parts, strict=True)])

    @property
    def size(self) -> int:
        """Number of reduced DOFs so far."""
        return sum(V.shape[1] for V in self._V)

    @property
    def sizes(self) -> list[int]:
        """Number of reduced DOFs of each field."""
        return [V.shape[1] for V in self._V]

    def extend(self, new: Sequence[Floats]) -> None:
        """Append orthonormal directions in weighted coordinates, one array a field."""
        old = self.sizes
        added = [directions / field.weight[:, None] for directions, field in zip(new, self.fields, strict=True)]
        for field, directions in zip(self.fields, new, strict=True):
            field.Q = np.hstack([field.Q, directions])
        for parts, images, blocks in zip(self._parts, self._images, self._blocks, strict=True):
            for (f, g), part in parts.items():
                image = part @ added[g]
                block = np.zeros((old[f] + added[f].shape[1], old[g] + added[g].shape[1]), dtype=image.dtype)
                block[: old[f], : old[g]] = blocks[f, g]
                block[: old[f], old[g] :] = self._V[f].T @ image
                images[f, g] = np.hstack([images[f, g], image])
                block[old[f] :] = added[f].T @ images[f, g]
                blocks[f, g] = block
        self._V = [np.hstack([V, v]) for V, v in zip(self._V, added, strict=True)]

    def operator(self, which: int) -> Any:
        """Vᵀ K V (0), Vᵀ C V (1) or Vᵀ M V (2), fields one after the other."""
        blocks, sizes = self._blocks[which], self.sizes
        return np.block([[blocks.get((f, g), np.zeros((sizes[f], sizes[g]))) for g in range(len(sizes))] for f in range(len(sizes))])

    def project(self, matrix: sp.csc_array) -> Any:
        """Vᵀ A V of any matrix, fields one after the other."""
        blocks, count = _blocks_of(matrix, self.fields), len(self.fields)
        return np.block(
            [
                [
                    self._V[f].T @ (blocks[f, g] @ self._V[g]) if (f, g) in blocks else np.zeros((self.sizes[f], self.sizes[g]))
                    for g in range(count)
                ]
                for f in range(count)
            ]
        )

    def sketched(self, which: int, *, transposed: bool = False) -> Any:
        """Sketch of K V, C V or M V (or of Kᵀ V ...), (fields * rows, r)."""
        count = len(self.fields)

        def block(f: int, g: int) -> Any:
            if transposed and (f, g) in self._transposed[which]:
                return self._transposed[which][f, g] @ self._V[g]
            if not transposed and (f, g) in self._images[which]:
                return self._theta[f] @ self._images[which][f, g]
            return np.zeros((self.rows, self.sizes[g]))

        return np.block([[block(f, g) for g in range(count)] for f in range(count)])

    @property
    def inputs(self) -> Floats:
        """(r, m) Vᵀ B_ext."""
        return np.vstack([(part.T @ V).T for part, V in zip(self._inputs, self._V, strict=True)])

    @property
    def dual(self) -> Floats:
        """(r, q) Vᵀ times the dual right-hand sides."""
        return np.vstack([(part.T @ V).T for part, V in zip(self._dual, self._V, strict=True)])

    @property
    def outputs(self) -> Floats:
        """(p, r) L_ext V."""
        return np.hstack([part @ V for part, V in zip(self._outputs, self._V, strict=True)])


def _blocks_of(operator: sp.csc_array, fields: Sequence[Field]) -> dict[tuple[int, int], sp.csr_array]:
    rows = [operator.tocsr()[field.dofs] for field in fields]
    parts = {(f, g): rows[f][:, fields[g].dofs].tocsr() for f in range(len(fields)) for g in range(len(fields))}
    return {pair: part for pair, part in parts.items() if part.nnz}


def _sparse_sign(rows: int, columns: int, seed: int, per_column: int = 4) -> sp.csr_array:
    """Sparse sign embedding: E |theta x|² = |x|²."""
    rng = np.random.default_rng(seed)
    row = rng.integers(0, rows, size=(columns, per_column))
    sign = rng.choice([-1.0, 1.0], size=(columns, per_column)) / np.sqrt(per_column)
    column = np.repeat(np.arange(columns), per_column)
    return sp.coo_array((sign.ravel(), (row.ravel(), column)), shape=(rows, columns)).tocsr()
