"""Whether two descents lead to the same end, recognised early by the minima of the linearisations about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.misfit.cost import Evaluation, Misfit
from lrbc_cli.updating.search.optimise import promised


def worth(misfit: Misfit, value: Evaluation) -> float:
    """Least change of the sum of squares that the data resolve: one nat of the log posterior [dB²].

    The variance is that of the evaluation itself, ``total`` over the number of data residuals, times the coarsening.
    """
    rows = max(misfit.data_rows(value), 1)
    return float(2.0 * misfit.coarsening * value.total / rows)


@dataclass(frozen=True)
class Lead:
    """The present place of a descent, and the minimum of the linearised cost.

    Attributes
    ----------
    total : float
        Sum of squares at the place [dB²].
    jacobian : (n, m) float array
        At the place, to z.
    end : (m,) float array
        z at the minimum of the linearised cost inside the bounds.
    """

    total: float
    jacobian: Floats = field(repr=False)
    end: Floats = field(repr=False)

    @classmethod
    def of(cls, value: Evaluation, z: Floats, box: Floats) -> Lead:
        """From the evaluation at z with the bounds ``box`` (m, 2); if the cost is not finite, the end is z itself."""
        known = np.isfinite(value.total) and bool(np.all(np.isfinite(value.jacobian)))
        return cls(value.total, value.jacobian, z + promised(value, z, box) if known else z)

    def meets(self, other: Lead, difference: float) -> bool:
        """Whether the residuals at both ends differ by no more than ``difference`` [dB²], as a sum of squares.

        It must hold by both Jacobians, because a joint that is free at one place affects the FRFs at the other.
        """
        apart = self.end - other.end
        return all(float(np.sum((J @ apart) ** 2)) <= difference for J in (self.jacobian, other.jacobian))


def leading_apart(leads: Sequence[Lead], difference: float) -> list[int]:
    """Indices of the leads that do not meet one with a lower cost, lowest cost first."""
    found: list[int] = []
    for at in sorted(range(len(leads)), key=lambda at: leads[at].total if np.isfinite(leads[at].total) else np.inf):
        if not any(leads[at].meets(leads[other], difference) for other in found):
            found.append(at)
    return found
