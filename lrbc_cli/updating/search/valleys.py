"""Whether two descents lead to the same place: told by where the linearisations about them have their minima, long before they end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.misfit.cost import Evaluation, Misfit
from lrbc_cli.updating.search.optimise import promised


def worth(misfit: Misfit, value: Evaluation) -> float:
    """Change of the sum of squares that the data can tell: one nat of the log posterior, with the noise that the sum itself tells [dB²].

    A difference of so much between the residuals of two states makes neither much more probable than the other.
    """
    rows = max(misfit.data_rows(value), 1)
    return float(2.0 * misfit.coarsening * value.total / rows)


@dataclass(frozen=True)
class Lead:
    """A place on a descent, and where the linearisation there leads.

    Attributes
    ----------
    total : float
        Sum of squares at the place.
    jacobian : (n, m) float array
        There.
    end : (m,) float array
        Minimum of the linearised cost inside the bounds.
    """

    total: float
    jacobian: Floats = field(repr=False)
    end: Floats = field(repr=False)

    @classmethod
    def of(cls, value: Evaluation, z: Floats, box: Floats) -> Lead:
        """By the evaluation at z; a place without a cost leads nowhere but to itself."""
        known = np.isfinite(value.total) and bool(np.all(np.isfinite(value.jacobian)))
        return cls(value.total, value.jacobian, z + promised(value, z, box) if known else z)

    def meets(self, other: Lead, difference: float) -> bool:
        """Whether residuals of both ends differ by no more than that, as sums of squares.

        By the derivatives of both: a joint that is free at one of them is felt at the other.
        """
        apart = self.end - other.end
        return all(float(np.sum((J @ apart) ** 2)) <= difference for J in (self.jacobian, other.jacobian))


def leading_apart(leads: Sequence[Lead], difference: float) -> list[int]:
    """Which of the leads end where none with a lower cost does, those with the lowest cost first."""
    found: list[int] = []
    for at in sorted(range(len(leads)), key=lambda at: leads[at].total if np.isfinite(leads[at].total) else np.inf):
        if not any(leads[at].meets(leads[other], difference) for other in found):
            found.append(at)
    return found
