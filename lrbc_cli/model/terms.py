"""Rank-one terms of the operators, eqs. (3)-(5), and the parameters that scale them: log10 values and damping exponents p_damp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.arrays import Complexes, Floats, Integers

LN10 = float(np.log(10.0))

#: Power of s with which a term enters the dynamic stiffness, eqs. (3)-(5).
KIND_POWER = {"stiffness": 0, "damping": 1, "mass": 2}


@dataclass(frozen=True, kw_only=True)
class LowRankTerms:
    """Vectors of the rank-one terms ``D_j(s) left_j right_jᵀ`` of the dynamic stiffness, eqs. (3)-(5).

    Attributes
    ----------
    left, right : (n, nt) csc_array
        Columns b, d, f and c, e, g of eqs. (3)-(5).
    power : (nt,) int array
        Power of s in D_j: 0 stiffness, 1 damping, 2 mass.
    baseline : (nt,) float array
        Linear value that the exported operators already contain; a term is free at ``D_j = -baseline s^power``.
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
        """Whether left and right vectors are equal."""
        return bool(self.left.shape == self.right.shape and (self.left != self.right).nnz == 0)


@dataclass(frozen=True, kw_only=True)
class EdgeDamping:
    """Damping tied to an identified stiffness, eq. (33), with one exponent p_damp for the whole group.

    Attributes
    ----------
    beta : float
        Coefficient of stiffness-proportional damping [s].
    initial : float
        Start value of p_damp.
    bounds : (float, float)
        Of p_damp.
    loss_factor : float
        eta of hysteretic damping.
    """

    beta: float
    initial: float = 0.0
    bounds: tuple[float, float] = (-3.0, 4.0)
    loss_factor: float = 0.0

    def loss(self, s: Complexes) -> Complexes:
        """(F,) ``s beta + i loss_factor``, the damping of a unit stiffness at p_damp = 0."""
        return s * self.beta + 1j * self.loss_factor


@dataclass(frozen=True, kw_only=True)
class ParameterGroup:
    """A group of k parameters p (log10 values) of one kind, along an edge or of joints, and the terms that they scale.

    Attributes
    ----------
    name : str
    kind : str
        ``stiffness``, ``damping`` or ``mass``.
    terms : (m,) int array
        Columns of ``LowRankTerms`` that belong to the group.
    parameter : (m,) int array
        Index of the parameter that scales each of these terms.
    initial : (k,) float array
        Start values, log10.
    bounds : (k, 2) float array
        Lower and upper bounds, log10.
    smoothing : (k, k) float array
        W of Fig. 5: the linear values are ``W 10^p``.
    damping : EdgeDamping or None
    xyz : (k, 3) float array or None
        Positions of the parameters [m].
    arc_length : (k,) float array or None
        Position along the edge [m]; None for joints.
    bolt : (k,) int array or None
        Index of the bolt that owns each parameter, -1 for none; None if no bolt owns any.
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
        """Number k of log10 values, without p_damp."""
        return int(self.initial.size)

    def values(self, p: Floats) -> Floats:
        """(k,) linear values W 10^p."""
        # p may be inf (clamped): the zeros of W times inf must give 0.
        power = np.power(10.0, p)
        if np.all(np.isfinite(power)):
            return np.asarray(self.smoothing @ power)
        return np.asarray(
            np.sum(np.where(self.smoothing == 0.0, 0.0, self.smoothing * np.where(self.smoothing == 0.0, 0.0, power)), axis=1)
        )

    def value_jacobian(self, p: Floats) -> Floats:
        """(k, k) Jacobian of ``values`` with respect to p."""
        return np.asarray(self.smoothing * (LN10 * np.power(10.0, p)))


def smoothing_matrix(weights: Sequence[float] | None, count: int, normalised: bool = False) -> Floats:
    """Banded W that spreads each parameter over its neighbours along the edge (Fig. 5).

    Parameters
    ----------
    weights : sequence of odd length, or None
        Centre weight in the middle. The paper has (1/3, 2/3, 1/3): rows sum to 4/3, the first and the last to 1. None: W is the identity.
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


@dataclass(frozen=True, kw_only=True)
class Slopes:
    """Derivatives of the dynamic values ``D_j = c_j(s) kappa_j`` to theta at F lines, by which those of FRFs follow from ``dy/dD_j``.

    Attributes
    ----------
    spectra : (F, nt) complex array
        c_j(s).
    jacobian : (nt, size) complex array
        Of the scales kappa; complex, so that no product has to convert it.
    scales : (nt,) float array
        kappa.
    damping : sequence of (int, int array, (F,) complex array)
        For every p_damp: its index in theta, its terms, and ``d c_j / d p_damp``.
    """

    spectra: Complexes = field(repr=False)
    jacobian: Complexes = field(repr=False)
    scales: Floats = field(repr=False)
    damping: Sequence[tuple[int, Integers, Complexes]] = field(repr=False)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return int(self.jacobian.shape[1])

    def of(self, dy: Complexes, lines: slice = slice(None)) -> Complexes:
        """(f, R, size) derivatives of FRFs to theta from ``dy/dD_j`` (f, R, nt) at some of the lines, chain rule of (35), (36), (A.4)."""
        J = (dy * self.spectra[lines, None]) @ self.jacobian
        for at, terms, slope in self.damping:
            J[:, :, at] = (dy[:, :, terms] @ self.scales[terms]) * slope[lines, None]
        return np.asarray(J)


@dataclass(frozen=True)
class Parameterisation:
    """The vector of unknowns theta: group by group the log10 values, followed by p_damp if the group has tied damping.

    Attributes
    ----------
    groups : tuple of ParameterGroup
    factor : (nt,) float array or None
        Factor of the linear value of each term; None for 1, see ``weakened``.
    placed : tuple of (ParameterGroup, slice, int or None)
        Each group with the slice of its log10 values and the index of its p_damp in theta.
    size : int
        Length of theta.
    """

    groups: tuple[ParameterGroup, ...]
    factor: Floats | None = field(default=None, repr=False)
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
        """Whether some group has parameters owned by bolts, i.e. joints."""
        return any(group.bolt is not None for group in self.groups)

    @property
    def terms(self) -> int:
        """Number of terms nt."""
        return sum(group.terms.size for group in self.groups)

    @property
    def initial(self) -> Floats:
        """(size,) start values of theta."""
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

    def by_group(self, theta: Floats) -> dict[str, Floats]:
        """Values in theta (size,) by group; the damping exponent (1,) under ``GROUP.damping``."""
        found: dict[str, Floats] = {}
        for group, values, at in self.placed:
            found[group.name] = theta[values]
            if at is not None:
                found[f"{group.name}.damping"] = theta[at : at + 1]
        return found

    def scales(self, theta: Floats) -> Floats:
        """(nt,) linear value kappa_j of every term."""
        kappa = np.zeros(self.terms)
        for group, values, _ in self.placed:
            kappa[group.terms] = group.values(theta[values])[group.parameter]
        return kappa if self.factor is None else kappa * self.factor

    def weakened(self, terms: Integers, decades: float) -> Parameterisation:
        """The same unknowns, with the linear values of some terms changed by so many decades whatever the unknowns are."""
        factor = np.ones(self.terms) if self.factor is None else self.factor.copy()
        factor[terms] *= 10.0**decades
        return Parameterisation(self.groups, factor)

    def scale_jacobian(self, theta: Floats) -> Floats:
        """(nt, size) Jacobian of ``scales`` with respect to theta; columns of p_damp are zero."""
        J = np.zeros((self.terms, self.size))
        for group, values, _ in self.placed:
            J[group.terms, values] = group.value_jacobian(theta[values])[group.parameter]
        return J if self.factor is None else J * self.factor[:, None]

    def spectra(self, theta: Floats, s: Complexes) -> Complexes:
        """(F, nt) c_j(s) of ``D_j = c_j(s) kappa_j``: s^power, times ``1 + (s beta + i loss_factor) 10^p_damp`` with tied damping (33)."""
        c = np.ones((s.size, self.terms), dtype=complex)
        for group, _, at in self.placed:
            spectrum = s ** KIND_POWER[group.kind]
            if group.damping and at is not None:
                spectrum = spectrum * (1.0 + group.damping.loss(s) * 10.0 ** theta[at])
            c[:, group.terms] = spectrum[:, None]
        return c

    def damping_spectra(self, theta: Floats, s: Complexes) -> list[tuple[int, NDArray[np.int64], Complexes]]:
        """For every p_damp: its index in theta, its terms, and the (F,) derivative d c_j / d p_damp, eq. (36)."""
        out = []
        for group, _, at in self.placed:
            if group.damping and at is not None:
                out.append((at, group.terms, group.damping.loss(s) * LN10 * 10.0 ** theta[at]))
        return out

    def dynamic(self, theta: Floats, s: Complexes) -> Complexes:
        """(F, nt) dynamic values D_j(s) of the terms, infinite for a clamped term."""
        kappa = self.scales(theta)
        finite = np.where(np.isfinite(kappa), kappa, 0.0)
        D = self.spectra(theta, s) * finite
        D[:, ~np.isfinite(kappa)] = np.inf
        return D

    def slopes(self, theta: Floats, s: Complexes) -> Slopes:
        """Derivatives of the dynamic values at the lines s to theta, see ``Slopes``."""
        return Slopes(
            spectra=self.spectra(theta, s),
            jacobian=self.scale_jacobian(theta).astype(complex),
            scales=self.scales(theta),
            damping=self.damping_spectra(theta, s),
        )

    def polynomial(self, theta: Floats) -> Floats:
        """(nt, 3) coefficients k, c and m of ``D_j(s) = k + s c + s² m``; of a clamped term one is infinite and the others are zero.

        Damping tied to a stiffness (33) is viscous, ``c = k beta 10^p_damp``. A loss factor has no such form and is left out.
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
