"""Rank-one terms of the operators and the parameters that scale them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.arrays import Complexes, Floats

LN10 = float(np.log(10.0))

#: Power of s with which a term enters the dynamic stiffness, eqs. (3)-(5).
KIND_POWER = {"stiffness": 0, "damping": 1, "mass": 2}


@dataclass(frozen=True)
class LowRankTerms:
    """Rank-one terms ``D_j(s) left_j right_jᵀ`` of the dynamic stiffness.

    Attributes
    ----------
    left, right : (n, nt) csc_array
        b, d, f and c, e, g of eqs. (3)-(5).
    power : (nt,) int array
        Of s: 0 stiffness, 1 damping, 2 mass.
    baseline : (nt,) float array
        Linear value that the operators already contain; a term is free where ``D_j = -baseline s^power``.
    """

    left: sp.csc_array
    right: sp.csc_array
    power: NDArray[np.int64]
    baseline: Floats

    @property
    def size(self) -> int:
        """Number of terms nt."""
        return int(self.left.shape[1])

    @property
    def symmetric(self) -> bool:
        """Whether left and right vectors are the same."""
        return bool(self.left.shape == self.right.shape and (self.left != self.right).nnz == 0)


@dataclass(frozen=True)
class EdgeDamping:
    """Damping tied to an identified stiffness, eq. (33): one exponent p_damp for the whole group.

    Attributes
    ----------
    beta : float
        Stiffness-proportional damping coefficient [s].
    initial : float
        p_damp at the start.
    bounds : (float, float)
    loss_factor : float
        Of hysteretic damping.
    """

    beta: float
    initial: float = 0.0
    bounds: tuple[float, float] = (-3.0, 4.0)
    loss_factor: float = 0.0

    def loss(self, s: Complexes) -> Complexes:
        """(F,) ``s beta + i loss_factor``, the damping of a unit stiffness where p_damp is 0."""
        return s * self.beta + 1j * self.loss_factor


@dataclass(frozen=True, kw_only=True)
class ParameterGroup:
    """Parameters of one kind along one edge or joint, in log10.

    Attributes
    ----------
    name : str
    kind : str
        ``stiffness``, ``damping`` or ``mass``.
    terms : (m,) int array
        Columns of ``LowRankTerms`` that belong to the group.
    parameter : (m,) int array
        Which of the group's parameters scales each of these terms.
    initial : (k,) float array
        log10 at the start.
    bounds : (k, 2) float array
        log10.
    smoothing : (k, k) float array
        W of Fig. 5: the values are ``W 10^p``.
    damping : EdgeDamping or None
    xyz : (k, 3) float array or None
        Positions of the parameters [m].
    arc_length : (k,) float array or None
        Along the edge [m]; None of joints, which lie along none.
    bolt : (k,) int array or None
        Bolt that owns each parameter, -1 where none does; None where no bolt owns any.
    """

    name: str
    kind: str
    terms: NDArray[np.int64] = field(repr=False)
    parameter: NDArray[np.int64] = field(repr=False)
    initial: Floats = field(repr=False)
    bounds: Floats = field(repr=False)
    smoothing: Floats = field(repr=False)
    damping: EdgeDamping | None = None
    xyz: Floats | None = field(default=None, repr=False)
    arc_length: Floats | None = field(default=None, repr=False)
    bolt: NDArray[np.int64] | None = field(default=None, repr=False)

    @property
    def count(self) -> int:
        """Number of log10 values, p_damp not counted."""
        return int(self.initial.size)

    def values(self, p: Floats) -> Floats:
        """(k,) linear values W 10^p."""
        # inf clamps and -inf frees: 0 * inf of the far rows of W must stay 0.
        power = np.power(10.0, p)
        if np.all(np.isfinite(power)):
            return np.asarray(self.smoothing @ power)
        return np.asarray(
            np.sum(np.where(self.smoothing == 0.0, 0.0, self.smoothing * np.where(self.smoothing == 0.0, 0.0, power)), axis=1)
        )

    def value_jacobian(self, p: Floats) -> Floats:
        """(k, k) derivative of ``values`` to p."""
        return np.asarray(self.smoothing * (LN10 * np.power(10.0, p)))


def smoothing_matrix(weights: Sequence[float] | None, count: int, normalised: bool = False) -> Floats:
    """Banded W that spreads each parameter over its neighbours along the edge (Fig. 5).

    Parameters
    ----------
    weights : sequence of odd length, or None
        Centre weight in the middle; (1/3, 2/3, 1/3) in the paper, whose rows sum to 4/3 inside and to 1 at the ends.
    count : int
        Number of parameters, ordered by arc length.
    normalised : bool
        Scale each row to the sum 1.

    Returns
    -------
    (count, count) float array
    """
    if weights is None:
        return np.eye(count)
    half = len(weights) // 2
    W = np.zeros((count, count))
    for offset, weight in zip(range(-half, half + 1), weights, strict=True):
        if abs(offset) < count:
            W += weight * np.eye(count, k=offset)
    if normalised:
        W /= W.sum(axis=1, keepdims=True)
    return W


@dataclass(frozen=True)
class Parameterisation:
    """All groups; theta holds, group by group, the log10 values and then p_damp where there is one.

    Attributes
    ----------
    groups : tuple of ParameterGroup
    placed : tuple of (ParameterGroup, slice, int or None)
        Each group with the places of its values, and of its damping exponent, in theta.
    size : int
        Of theta.
    """

    groups: tuple[ParameterGroup, ...]
    placed: tuple[tuple[ParameterGroup, slice, int | None], ...] = field(init=False, repr=False)
    size: int = field(init=False)

    def __post_init__(self) -> None:
        placed: list[tuple[ParameterGroup, slice, int | None]] = []
        at = 0
        for group in self.groups:
            values = slice(at, at + group.count)
            at += group.count
            placed.append((group, values, at if group.damping else None))
            at += group.damping is not None
        object.__setattr__(self, "placed", tuple(placed))
        object.__setattr__(self, "size", at)

    @property
    def of_joints(self) -> bool:
        """Whether bolts own terms, in some group."""
        return any(group.bolt is not None for group in self.groups)

    @property
    def terms(self) -> int:
        """Number of terms nt."""
        return sum(group.terms.size for group in self.groups)

    @property
    def initial(self) -> Floats:
        """Theta at the start."""
        theta = np.zeros(self.size)
        for group, values, at in self.placed:
            theta[values] = group.initial
            if group.damping and at is not None:
                theta[at] = group.damping.initial
        return theta

    @property
    def bounds(self) -> Floats:
        """(size, 2) lower and upper bounds of theta."""
        bounds = np.zeros((self.size, 2))
        for group, values, at in self.placed:
            bounds[values] = group.bounds
            if group.damping and at is not None:
                bounds[at] = group.damping.bounds
        return bounds

    @property
    def is_damping(self) -> NDArray[np.bool_]:
        """(size,) mask of the p_damp entries."""
        mask = np.zeros(self.size, dtype=bool)
        for _, _, at in self.placed:
            if at is not None:
                mask[at] = True
        return mask

    def scales(self, theta: Floats) -> Floats:
        """(nt,) linear value kappa_j of every term."""
        kappa = np.zeros(self.terms)
        for group, values, _ in self.placed:
            kappa[group.terms] = group.values(theta[values])[group.parameter]
        return kappa

    def scale_jacobian(self, theta: Floats) -> Floats:
        """(nt, size) derivative of ``scales``; columns of p_damp are zero."""
        J = np.zeros((self.terms, self.size))
        for group, values, _ in self.placed:
            J[group.terms, values] = group.value_jacobian(theta[values])[group.parameter]
        return J

    def spectra(self, theta: Floats, s: Complexes) -> Complexes:
        """(F, nt) c_j(s) with ``D_j(s) = c_j(s) kappa_j``: s^power, times ``1 + (s beta + i loss_factor) 10^p_damp`` (33)."""
        c = np.ones((s.size, self.terms), dtype=complex)
        for group, _, at in self.placed:
            spectrum = s ** KIND_POWER[group.kind]
            if group.damping and at is not None:
                spectrum = spectrum * (1.0 + group.damping.loss(s) * 10.0 ** theta[at])
            c[:, group.terms] = spectrum[:, None]
        return c

    def damping_spectra(self, theta: Floats, s: Complexes) -> list[tuple[int, NDArray[np.int64], Complexes]]:
        """For every p_damp its index in theta, its terms, and (F,) d c_j / d p_damp (36)."""
        out = []
        for group, _, at in self.placed:
            if group.damping and at is not None:
                out.append((at, group.terms, group.damping.loss(s) * LN10 * 10.0 ** theta[at]))
        return out

    def dynamic(self, theta: Floats, s: Complexes) -> Complexes:
        """(F, nt) D_j(s), the value to add to matrices without the terms; infinite where a term clamps."""
        kappa = self.scales(theta)
        finite = np.where(np.isfinite(kappa), kappa, 0.0)
        D = self.spectra(theta, s) * finite
        D[:, ~np.isfinite(kappa)] = np.inf
        return D

    def polynomial(self, theta: Floats) -> Floats:
        """(nt, 3) k, c and m of ``D_j(s) = k + s c + s² m``; the one of its kind is infinite, the others zero, where a term clamps.

        Damping tied to a stiffness (33) is viscous, ``c = k beta 10^p_damp``; a loss factor has no such form.
        """
        kappa = self.scales(theta)
        finite = np.isfinite(kappa)
        out = np.zeros((self.terms, 3))
        for group, _, at in self.placed:
            power, terms = KIND_POWER[group.kind], group.terms
            out[terms, power] = kappa[terms]
            if group.damping and at is not None:
                out[terms, power + 1] = np.where(finite[terms], kappa[terms], 0.0) * group.damping.beta * 10.0 ** theta[at]
        return out
