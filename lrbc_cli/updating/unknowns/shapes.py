"""The unknowns z of a job, ``theta = prior + T z``: every value by itself, or one change for each bolt.

A bolt changes the terms it owns (a joint) or the values along its edge through a hat. Searches and posterior work on z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lrbc_cli.arrays import Floats
from lrbc_cli.model.terms import ParameterGroup, Parameterisation
from lrbc_cli.updating.knots import hats
from lrbc_cli.updating.statistics.priors import BOLT_PRIOR, VALUE_PRIOR, BoltPrior, ValuePrior
from lrbc_cli.updating.unknowns.places import Edge, places

#: Distances that differ by less than this fraction count as equal.
ROUND_OFF = 1e-9


@dataclass(frozen=True, kw_only=True)
class Shapes:
    """The map ``theta = prior + T z`` from m unknowns z to theta.

    Attributes
    ----------
    T : (size, m) float array
        A column is the change of theta by one decade of an unknown.
    std : (m,) float array
        Standard deviations of z in the prior [decades]; infinite if there is no prior.
    bolts : (n,) int array
        Column of each bolt; of a joint the column that changes all of its groups alike; -1 if no term reaches the bolt. Empty if the
        unknowns are the values themselves.
    joint : (n,) bool array
        Whether a bolt owns its terms; otherwise its column is a hat along an edge.
    """

    T: Floats
    std: Floats
    bolts: NDArray[np.int64]
    joint: NDArray[np.bool_]

    @property
    def by_bolt(self) -> bool:
        """Whether the unknowns are changes at bolts."""
        return bool(self.bolts.size)

    @property
    def joints_only(self) -> bool:
        """Whether every bolt that has a column is a joint."""
        return self.by_bolt and bool(self.joint[self.bolts >= 0].all())

    @property
    def joint_columns(self) -> list[int]:
        """Columns of the bolts if all are joints, else an empty list."""
        return self.bolts[self.bolts >= 0].tolist() if self.joints_only else []

    def mirrored(self, bolts: Floats, one: int, other: int, *, tolerance: float = 0.02) -> list[tuple[int, int]]:
        """Pairs of columns whose bolts are mirror images of each other in the plane midway between two given bolts.

        Only the two given columns if the arrangement of the bolts is not symmetric about that plane.

        Parameters
        ----------
        bolts : (n, 3) float array
            Positions [m].
        one, other : int
            Columns of the two bolts.
        tolerance : float
            Largest distance of a mirrored bolt from the nearest bolt, over the distance of the two given bolts.
        """
        known = np.flatnonzero(self.bolts >= 0)
        xyz, columns = bolts[known], self.bolts[known].tolist()
        i, j = columns.index(one), columns.index(other)
        apart = float(np.linalg.norm(xyz[j] - xyz[i]))
        if apart == 0.0:
            return [(one, other)]
        normal = (xyz[j] - xyz[i]) / apart
        image = xyz - 2.0 * np.outer((xyz - 0.5 * (xyz[i] + xyz[j])) @ normal, normal)
        far, partner = cKDTree(xyz).query(image)
        if far.max() > tolerance * apart:
            return [(one, other)]
        return [(columns[a], columns[b]) for a, b in enumerate(partner.tolist()) if a < b]

    def penalty(self) -> Floats:
        """(m, size) rows that give ``z / std`` from ``theta - prior``, by the pseudoinverse of T: exact for theta in the span of T."""
        weight = np.where(np.isfinite(self.std), 1.0 / self.std, 0.0)
        return np.asarray(weight[:, None] * np.linalg.pinv(self.T))


def node_shapes(parameters: Parameterisation, std: float) -> Shapes:
    """Every entry of theta as its own unknown, with standard deviation ``std`` [decades]; damping exponents without a prior, as in (29)."""
    spread = np.where(parameters.is_damping, np.inf, std)
    return Shapes(T=np.eye(parameters.size), std=spread, bolts=np.zeros(0, dtype=np.int64), joint=np.zeros(0, dtype=bool))


def edges_of(parameters: Parameterisation) -> list[ParameterGroup]:
    """Stiffness groups along an edge, on which bolts can be."""
    return [group for group in parameters.groups if _is_edge(group)]


def _is_edge(group: ParameterGroup) -> bool:
    return group.kind == "stiffness" and group.xyz is not None and group.arc_length is not None


def joints_of(parameters: Parameterisation, count: int) -> list[dict[int, NDArray[np.int64]]]:
    """Stiffness values that each of ``count`` bolts owns: indices in theta by index of the group; an empty dict for bolts along edges."""
    found: list[dict[int, NDArray[np.int64]]] = [{} for _ in range(count)]
    for i, (group, values, _) in enumerate(parameters.placed):
        if group.kind == "stiffness" and group.bolt is not None:
            for bolt in np.unique(group.bolt[group.bolt >= 0]).tolist():
                found[bolt][i] = values.start + np.flatnonzero(group.bolt == bolt)
    return found


def neighbours(parameters: Parameterisation, bolts: Floats, shapes: Shapes) -> list[tuple[int, int]]:
    """Pairs of neighbouring bolts: consecutive ones along an edge, and relative neighbours among joints.

    Two joints are relative neighbours (Toussaint, Pattern Recognition 12, 1980) if no third is nearer to both than they are to each
    other. On a ring, along a row and on a grid these are the adjacent ones.

    Parameters
    ----------
    parameters : Parameterisation
    bolts : (n, 3) float array
        Positions [m].
    shapes : Shapes
        Bolts without a column are left out.

    Returns
    -------
    list of (int, int)
        Indices of bolts.
    """
    hats, joints = (np.flatnonzero((shapes.bolts >= 0) & (shapes.joint == joint)) for joint in (False, True))
    edges = edges_of(parameters)
    owner, at = _feet(edges, bolts[~shapes.joint])
    row = {int(b): k for k, b in enumerate(np.flatnonzero(~shapes.joint))}
    found: list[tuple[int, int]] = []
    for which in range(len(edges)):
        found += pairwise(sorted((b for b in hats.tolist() if owner[row[b]] == which), key=lambda b: float(at[row[b]])))
    distance = np.linalg.norm(bolts[joints, None] - bolts[None, joints], axis=2)
    for i in range(joints.size):
        for j in range(i + 1, joints.size):
            farther = np.delete(np.maximum(distance[i], distance[j]), [i, j])
            if not (farther < distance[i, j] * (1.0 - ROUND_OFF)).any():
                found.append((int(joints[i]), int(joints[j])))
    return found


def neighbouring_columns(parameters: Parameterisation, bolts: Floats, shapes: Shapes) -> list[tuple[int, int]]:
    """Pairs of columns of neighbouring bolts, see ``neighbours``."""
    found = ((int(shapes.bolts[a]), int(shapes.bolts[b])) for a, b in neighbours(parameters, bolts, shapes))
    return [(a, b) for a, b in found if a != b]


def bolt_shapes(parameters: Parameterisation, bolts: Floats, values: ValuePrior = VALUE_PRIOR, prior: BoltPrior = BOLT_PRIOR) -> Shapes:
    """Unknowns of ``approach: bolts``: one change for each bolt, of all the values it owns or through a hat along its edge.

    A hat is 1 at the bolt and falls to 0 at its neighbours. A joint has a column that changes its values in all groups alike, and for each
    group beyond the first a column that changes groups against each other: orthonormal contrasts, so that with equal standard deviations
    no group is preferred. Damping exponents and the values of groups without bolts have a column each.

    Parameters
    ----------
    parameters : Parameterisation
    bolts : (n, 3) float array
        Positions [m].
    values : ValuePrior
        Standard deviations of the changes and of the damping exponents.
    prior : BoltPrior
        Standard deviation of the contrasts, ``deviation_std``.

    Returns
    -------
    Shapes
        A bolt too far from all edges has no column, nor has one beyond the end of its edge whose hat reaches no term.
    """
    own = joints_of(parameters, bolts.shape[0])
    joint = np.array([bool(parts) for parts in own], dtype=bool)
    edges = [i for i, group in enumerate(parameters.groups) if _is_edge(group)]
    owner, at = np.full(bolts.shape[0], -1, dtype=np.int64), np.zeros(bolts.shape[0])
    owner[~joint], at[~joint] = _feet([parameters.groups[i] for i in edges], bolts[~joint])
    columns: list[Floats] = []
    spread: list[float] = []
    column_of = np.full(bolts.shape[0], -1, dtype=np.int64)

    def add(where: NDArray[np.int64] | slice | int, weights: Floats | float, std: float) -> None:
        columns.append(np.zeros(parameters.size))
        columns[-1][where] = weights
        spread.append(std)

    for i, (group, where, damping) in enumerate(parameters.placed):
        mine = np.flatnonzero(owner == edges.index(i)) if i in edges else np.zeros(0, dtype=np.int64)
        hats = _hats(group, at[mine]) if mine.size else np.zeros((group.count, 0))
        felt = hats.any(axis=0)
        if felt.any():
            for bolt, hat in zip(mine[felt], hats[:, felt].T, strict=True):
                column_of[bolt] = len(columns)
                add(where, hat, values.std)
        else:
            for k in range(group.count):
                if group.kind != "stiffness" or group.bolt is None or group.bolt[k] < 0:
                    add(where.start + k, 1.0, values.std)
        if damping is not None:
            add(damping, 1.0, values.damping_std)
    for bolt in np.flatnonzero(joint).tolist():
        parts = list(own[bolt].values())
        column_of[bolt] = len(columns)
        add(np.concatenate(parts), 1.0, values.joint_std)
        for k in range(1, len(parts)):
            # Contrast k: the mean of the first k groups against the next group.
            weight = np.repeat([1.0] * k + [-float(k)], [part.size for part in parts[: k + 1]]) / np.sqrt(k * (k + 1.0))
            add(np.concatenate(parts[: k + 1]), weight, prior.deviation_std)
    return Shapes(T=np.column_stack(columns), std=np.array(spread), bolts=column_of, joint=joint)


def _feet(groups: Sequence[ParameterGroup], bolts: Floats) -> tuple[NDArray[np.int64], Floats]:
    """(n,) edge of every bolt, -1 if it is too far from all of them, and (n,) arc length of its foot there [m]."""
    edges = []
    for group in groups:
        assert group.xyz is not None
        assert group.arc_length is not None
        edges.append(Edge(xyz=group.xyz, arc_length=group.arc_length, log10=np.zeros(group.count), cap=np.inf, reference=None))
    if not edges or not bolts.shape[0]:
        return np.full(bolts.shape[0], -1, dtype=np.int64), np.zeros(bolts.shape[0])
    found = places(edges, bolts)
    owner = np.array([place.edge if place.aside is None else -1 for place in found], dtype=np.int64)
    return owner, np.array([place.at for place in found], dtype=float)


def _hats(group: ParameterGroup, at: Floats) -> Floats:
    """(k, b) hats: weights of the piecewise linear interpolation from the feet ``at`` (b,) of the bolts to the k values of the group."""
    assert group.arc_length is not None
    if at.size == 1:
        return np.ones((group.count, 1))
    order = np.argsort(at, kind="stable")
    places, which = np.unique(at[order], return_inverse=True)
    shapes = hats(group.arc_length, places)
    out = np.zeros((group.count, at.size))
    for place in range(places.size):
        sharing = order[which == place]
        # Bolts with the same foot cannot be distinguished: they share the hat in equal parts.
        out[:, sharing] = shapes[:, [place]] / sharing.size
    return out
