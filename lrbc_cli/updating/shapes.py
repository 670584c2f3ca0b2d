"""What the unknowns of a job are: every value along the edges, or one change a bolt through a shape along its edge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lrbc_cli.model.terms import ParameterGroup, Parameterisation
from lrbc_cli.updating.places import Edge, places
from lrbc_cli.updating.priors import VALUE_PRIOR

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Shapes:
    """``theta = prior + T z`` with unknowns z.

    Attributes
    ----------
    T : (size, m) float array
    std : (m,) float array
        Standard deviations of z in the prior [decades]; infinite where there is no prior.
    bolts : (n,) int array
        Column of each bolt; -1 where no term feels it. Empty where the unknowns are the values along the edges.
    """

    T: Floats
    std: Floats
    bolts: NDArray[np.int64]

    @property
    def by_bolt(self) -> bool:
        """Whether the unknowns are changes at bolts."""
        return bool(self.bolts.size)

    def penalty(self) -> Floats:
        """(m, size) rows that give ``z / std`` from ``theta - prior`` for theta in the span, the least change outside it ignored."""
        weight = np.where(np.isfinite(self.std), 1.0 / self.std, 0.0)
        return np.asarray(weight[:, None] * np.linalg.pinv(self.T))


def node_shapes(parameters: Parameterisation, std: float) -> Shapes:
    """Every value for itself; damping exponents without a prior, as in (29)."""
    spread = np.where(parameters.is_damping, np.inf, std)
    return Shapes(np.eye(parameters.size), spread, np.zeros(0, dtype=np.int64))


def edges_of(parameters: Parameterisation) -> list[ParameterGroup]:
    """Stiffness groups along which bolts can lie."""
    return [group for group in parameters.groups if _is_edge(group)]


def _is_edge(group: ParameterGroup) -> bool:
    return group.kind == "stiffness" and group.xyz is not None and group.arc_length is not None


def neighbours(parameters: Parameterisation, bolts: Floats, among: Sequence[int]) -> list[tuple[int, int]]:
    """Pairs of bolts that follow each other along an edge, in whatever order they are listed.

    Parameters
    ----------
    parameters : Parameterisation
    bolts : (n, 3) float array
    among : sequence of int
        Those that count.

    Returns
    -------
    list of (int, int)
    """
    edges = edges_of(parameters)
    owner, at = _feet(edges, bolts)
    found: list[tuple[int, int]] = []
    for which in range(len(edges)):
        row = sorted((b for b in among if owner[b] == which), key=lambda b: float(at[b]))
        found += pairwise(row)
    return found


def bolt_shapes(
    parameters: Parameterisation, bolts: Floats, std: float = VALUE_PRIOR.std, damping_std: float = VALUE_PRIOR.damping_std
) -> Shapes:
    """One change a bolt: a hat along its edge that reaches to the neighbouring bolts.

    Damping exponents, and groups without bolts, stay as they are.

    Parameters
    ----------
    parameters : Parameterisation
    bolts : (n, 3) float array
    std, damping_std : float
        Of the changes, and of those of damping exponents, see ``ValuePrior``.

    Returns
    -------
    Shapes
        A bolt beyond the end of its edge, whose hat no term feels, has no column, nor has one that lies aside of all edges.
    """
    groups = list(zip(parameters.groups, parameters.slices, strict=True))
    edges = [i for i, (group, _) in enumerate(groups) if _is_edge(group)]
    owner, at = _feet([groups[i][0] for i in edges], bolts)
    columns: list[Floats] = []
    spread: list[float] = []
    column_of = np.full(bolts.shape[0], -1, dtype=np.int64)
    for i, (group, (values, damping)) in enumerate(groups):
        mine = np.flatnonzero(owner == edges.index(i)) if i in edges else np.zeros(0, dtype=np.int64)
        hats = _hats(group, at[mine]) if mine.size else np.zeros((group.count, 0))
        felt = hats.any(axis=0)
        if felt.any():
            for bolt, hat in zip(mine[felt], hats[:, felt].T, strict=True):
                column_of[bolt] = len(columns)
                columns.append(np.zeros(parameters.size))
                columns[-1][values] = hat
                spread.append(std)
        else:
            for k in range(group.count):
                columns.append(np.zeros(parameters.size))
                columns[-1][values.start + k] = 1.0
                spread.append(std)
        if damping is not None:
            columns.append(np.zeros(parameters.size))
            columns[-1][damping] = 1.0
            spread.append(damping_std)
    return Shapes(np.column_stack(columns), np.array(spread), column_of)


def _feet(groups: Sequence[ParameterGroup], bolts: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Edge of every bolt, -1 for one that lies aside of all, and the arc length of its foot there."""
    edges = []
    for group in groups:
        assert group.xyz is not None
        assert group.arc_length is not None
        edges.append(Edge(group.xyz, group.arc_length, np.zeros(group.count), np.inf, None))
    if not edges:
        return np.zeros(bolts.shape[0], dtype=np.int64), np.zeros(bolts.shape[0])
    found = places(edges, bolts)
    owner = np.array([place.edge if place.aside is None else -1 for place in found], dtype=np.int64)
    return owner, np.array([place.at for place in found], dtype=float)


def _hats(group: ParameterGroup, at: Floats) -> Floats:
    """(k, b) piecewise linear interpolation from the feet of the bolts to the values; feet in one place share a hat."""
    assert group.arc_length is not None
    if at.size == 1:
        return np.ones((group.count, 1))
    order = np.argsort(at, kind="stable")
    places, which = np.unique(at[order], return_inverse=True)
    hats = np.column_stack([np.interp(group.arc_length, places, row) for row in np.eye(places.size)])
    out = np.zeros((group.count, at.size))
    for place in range(places.size):
        sharing = order[which == place]
        # Bolts in one place cannot be told apart: they share the change.
        out[:, sharing] = hats[:, [place]] / sharing.size
    return out
