"""The smallest split real basis that singular vectors of all port solutions give, to compare the size of the reduced model with."""

from __future__ import annotations

import numpy as np
from measure import Figure, at_most
from numpy.typing import NDArray

from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.reduction.build import Reduction, ReductionOptions, reduce_model
from lrbc_cli.reduction.problem.norms import quantity_groups
from lrbc_cli.reduction.problem.vectors import certificate_vectors, local_scale
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.steps.unseen import distance

Floats = NDArray[np.float64]

#: The solutions are those of a reduced model of this tolerance, whose coordinates are orthonormal in the energy norm of each field.
EXACT = 1e-7
STRIDE = 3


def smallest_basis(inputs: Inputs, reduction: Reduction, backend: str, *, quick: bool = False) -> list[Figure]:
    """Size of the reduced model over that of the smallest one within the tolerance.

    Solutions for all inputs and responses at every line (1 Hz), normalised; singular vectors of each field; then every pair of sizes, in
    strides and one by one, measured at every fourth line with the vectors of the certificate.
    """
    model, options = inputs.model, reduction.options
    low, high = options.band_hz
    exact = reduce_model(model, inputs.input_of, ReductionOptions(band_hz=options.band_hz, tolerance=EXACT), backend=backend)
    rich, sizes = exact.model, exact.sizes
    s = 2j * np.pi * np.linspace(low, high, 60 if quick else round(high - low) + 1)
    D = rich.reference_dynamic(s)
    loads = np.hstack([rich.B, rich.left])
    fields = np.split(np.arange(rich.size), np.cumsum(sizes)[:-1])
    spread = [np.zeros((size, size)) for size in sizes]
    for at in range(s.size):
        Z = rich.dynamic_stiffness(s[at : at + 1], D[at : at + 1])[0]
        X = np.hstack([np.linalg.solve(Z, loads), np.linalg.solve(Z.T, rich.L.T)])
        for rows, total in zip(fields, spread, strict=True):
            Y = X[rows] / np.linalg.norm(X[rows], axis=0)
            total += (Y @ Y.conj().T).real
    modes = [np.linalg.eigh(total)[1][:, ::-1] for total in spread]
    lines = s[::4]
    scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * high)
    vectors = [D for Ds in certificate_vectors(model.terms, scale, lines).values() for D in Ds]
    groups, reference = quantity_groups(model), rich.ports(lines)

    def error(counts: tuple[int, ...]) -> float:
        V = np.zeros((rich.size, sum(counts)))
        start = 0
        for rows, vectors_of, count in zip(fields, modes, counts, strict=True):
            V[rows, start : start + count] = vectors_of[:, :count]
            start += count
        small = ReducedModel(
            K=V.T @ rich.K @ V, C=V.T @ rich.C @ V, M=V.T @ rich.M @ V,
            B=V.T @ rich.B, L=rich.L @ V, left=V.T @ rich.left, right=V.T @ rich.right,
            output_power=rich.output_power, input_of=rich.input_of, reference=rich.reference, structure=counts[0] if rich.structure else 0,
        )  # fmt: skip
        return float(distance(reference, small.ports(lines), vectors, groups).max())

    def least(first: tuple[int, ...], start: int) -> int | None:
        """Fewest columns of the last field with so many of those before it, by bisection."""
        few, enough = 1, start
        if error((*first, enough)) > options.tolerance:
            return None
        while enough - few > 1:
            middle = (few + enough) // 2
            few, enough = (few, middle) if error((*first, middle)) <= options.tolerance else (middle, enough)
        return enough

    best = sum(reduction.sizes)
    if len(sizes) == 2:
        start = reduction.sizes[1]
        for first in range(reduction.sizes[0], 0, -STRIDE if quick else -1):
            second = least((first,), start)
            if second is None:
                break
            best = min(best, first + second)
    else:
        best = least((), best) or best
    size = reduction.model.size
    text = f"{size} / {best} = {size / best:.2f} ({s.size} lines)"
    return [at_most("Reduction", "reduced DOFs over the smallest split basis", size / best, 1.3, text, "1.3")]
