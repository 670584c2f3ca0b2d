"""The full-order model with its terms at reference values, and the quantities that estimate, compression and certificate share."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.model.fem import FeModel
from lrbc_cli.reduction.outcome import ReductionOptions
from lrbc_cli.reduction.problem.basis import RESIDUAL_STIFFNESS, Field, Projected, Projection, energy_weight
from lrbc_cli.reduction.problem.full import full_operators
from lrbc_cli.reduction.problem.norms import quantity_groups
from lrbc_cli.reduction.problem.vectors import band_omega, local_scale, reference_values
from lrbc_cli.reduction.reduced.model import ReducedModel, reference_dynamic
from lrbc_cli.reduction.reduced.ports import PortFrf, port_frf
from lrbc_cli.reduction.solve.dynamic import DynamicStiffness

#: Number of first expansion points, at Chebyshev places of the band; later ones are chosen by the error estimate.
FIRST_POINTS = 3

#: Number of inputs above which only the first line is solved for all inputs, and later lines for random combinations of them.
MANY_INPUTS = 150


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A model to be reduced, with everything about it that does not change during the reduction.

    Attributes
    ----------
    model : FeModel
    input_of : (n_out,) int array
        Which input each response belongs to.
    options : ReductionOptions
    Z : DynamicStiffness
        Dynamic stiffness with the terms at their reference values.
    scale : (nt,) float array
        Local stiffness, damping or mass of each term, see ``local_scale``.
    reference : (nt, 3) float array
        Coefficients of D_ref(s) = k + s c + s² m.
    inputs : (n, n_in + nt) csc_array
        B_ext of the paper's extended system, eq. (11).
    outputs : (n_out + nt, n) csc_array
        L_ext of the extended system, eq. (15).
    dual : (n, d) csc_array
        Right-hand sides of the dual (transposed) problem: distinct responses, and the outputs of the terms unless, by symmetry, their dual
        solutions equal those of the term inputs.
    dual_of : int array
        Column of ``dual`` for each response (and each term output).
    quantities : tuple of int arrays
        Indices of the responses that share a physical quantity.
    many : bool
        More than ``MANY_INPUTS`` inputs: random combinations of them are solved, and errors are measured by residuals.
    """

    model: FeModel
    input_of: Integers
    options: ReductionOptions
    Z: DynamicStiffness = field(repr=False)
    scale: Floats = field(repr=False)
    reference: Floats = field(repr=False)
    inputs: sp.csc_array = field(repr=False)
    outputs: sp.csc_array = field(repr=False)
    dual: sp.csc_array = field(repr=False)
    dual_of: Integers = field(repr=False)
    quantities: tuple[Integers, ...] = field(repr=False)
    many: bool

    @classmethod
    def of(cls, model: FeModel, input_of: Integers, options: ReductionOptions, *, backend: str = "auto") -> Problem:
        """Choose reference values of the terms, and order the dynamic stiffness with them; parameters as of ``reduce_model``."""
        omega = band_omega(model.K, model.M, options.band_hz)
        scale = local_scale(model.K, model.M, model.terms, omega)
        reference = reference_values(model.terms, scale, omega)
        Z = DynamicStiffness(*full_operators(model, reference), model.is_acoustic, backend=backend)
        inputs, outputs = model.inputs, model.outputs
        # With a symmetric Z and equal left and right vectors only the responses need dual solutions.
        covered = Z.symmetric and model.terms.symmetric
        # Rows of one response to several hammer points are equal, and need one dual solution.
        dual, dual_of = distinct_columns((model.L.T if covered else outputs.T).tocsc())
        return cls(
            model=model,
            input_of=input_of,
            options=options,
            Z=Z,
            scale=scale,
            reference=reference,
            inputs=inputs,
            outputs=outputs,
            dual=dual,
            dual_of=dual_of,
            quantities=tuple(quantity_groups(model)),
            many=inputs.shape[1] > MANY_INPUTS,
        )

    @property
    def loads(self) -> int:
        """Number of loads n_in, the first inputs; those of the terms follow."""
        return int(self.model.B.shape[1])

    @property
    def responses(self) -> int:
        """Number of responses n_out, the first outputs; those of the terms follow."""
        return int(self.model.L.shape[0])

    @property
    def is_small(self) -> bool:
        """Whether the model has no more DOFs than the first expansion points give directions; it is then kept whole.

        Each solution gives two directions, its real and its imaginary part.
        """
        limit, directions = self.options.max_size, 2 * FIRST_POINTS * (self.inputs.shape[1] + self.dual.shape[1])
        return bool(self.model.size <= (directions if limit is None else min(directions, limit)))

    def empty_basis(self) -> Projection:
        """A basis without columns, split into structure and air, with its energy weights."""
        model, omega = self.model, band_omega(self.model.K, self.model.M, self.options.band_hz)
        weight = energy_weight(self.Z.K, self.Z.M, omega)
        masks = [~model.is_acoustic, model.is_acoustic]
        return Projection(
            (self.Z.K, self.Z.C, self.Z.M),
            self.inputs,
            self.outputs,
            [Field(np.flatnonzero(mask), weight[mask], np.zeros((int(mask.sum()), 0))) for mask in masks if mask.any()],
            dual=self.dual,
            residual_weight=energy_weight(self.Z.K, self.Z.M, omega, RESIDUAL_STIFFNESS),
            transposed=not self.Z.symmetric,
        )

    def structure_of(self, basis: Projection | Projected) -> int:
        """Number of structural reduced DOFs, the first ones."""
        return 0 if self.model.is_acoustic.all() else basis.sizes[0]

    def reduced(self, basis: Projection) -> ReducedModel:
        """The reduced model on a basis, with the reference values of the terms removed again; without matrices of further groups."""
        inputs, outputs = basis.inputs, basis.outputs
        left, right = inputs[:, self.loads :], outputs[self.responses :].T
        K, C, M = (A - (left * self.reference[:, i]) @ right.T for i, A in enumerate(basis.operators))
        return ReducedModel(
            K=K,
            C=C,
            M=M,
            B=inputs[:, : self.loads],
            L=outputs[: self.responses],
            left=left,
            right=right,
            output_power=self.model.output_power,
            input_of=self.input_of,
            reference=self.reference,
            structure=self.structure_of(basis),
        )

    def ports(self, H: Complexes, s: Complexes) -> PortFrf:
        """Port FRFs from the (F, n_out + nt, n_in + nt) transfer matrices of the extended system at the reference values."""
        return port_frf(H, s, reference_dynamic(self.reference, s), self.model.output_power, self.input_of)


def distinct_columns(A: sp.csc_array) -> tuple[sp.csc_array, Integers]:
    """The distinct columns of A in their order, and for each column of A the index of its copy among them."""
    A = A.copy()
    A.sum_duplicates()
    kept: dict[tuple[bytes, bytes], int] = {}
    of = np.empty(A.shape[1], dtype=np.int64)
    for j, (low, high) in enumerate(itertools.pairwise(A.indptr)):
        of[j] = kept.setdefault((A.indices[low:high].tobytes(), A.data[low:high].tobytes()), len(kept))
    return A[:, np.unique(of, return_index=True)[1]].tocsc(), of
