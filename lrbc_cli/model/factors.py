"""Global factors of the model: affine in the operators, but not low rank (gamma, delta, alpha and beta of Table 2, and further groups)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from lrbc_cli.model.fem import FeModel

FIELDS = ("structure", "acoustic")

#: The operators of a model in the order in which coefficients are given.
OPERATORS = ("stiffness", "damping", "mass")

#: What makes the stiffness complex, i Im K: a matrix of its own with the factors ``loss_factor.FIELD``.
LOSS = "loss"

#: Scales the acoustic stiffness by its square: with the temperature of a gas rho c² stays and c² goes as 1/rho.
SOUND_SPEED = "sound_speed"


@dataclass(frozen=True)
class Monomial:
    """``coefficient * prod factor**exponent``, a share of one operator (0 stiffness, 1 damping, 2 mass)."""

    slot: int
    coefficient: float
    exponents: Mapping[str, float]

    def value(self, factors: Mapping[str, float]) -> float:
        """At the given factors; those that are not named are one."""
        return float(self.coefficient * np.prod([factors.get(name, 1.0) ** power for name, power in self.exponents.items()]))


@dataclass(frozen=True)
class Piece:
    """One constant matrix and its shares of K, C and M.

    Attributes
    ----------
    operator : str
        Which operator of the model, or of the group, the matrix is taken from, see ``parted``.
    field : str
        ``structure``, ``acoustic`` or ``coupling``.
    group : str or None
        A further group instead of the model.
    shares : tuple of Monomial
    """

    operator: str
    field: str
    group: str | None
    shares: tuple[Monomial, ...]

    def coefficients(self, factors: Mapping[str, float]) -> NDArray[np.float64]:
        """(3,) shares of stiffness, damping and mass."""
        out = np.zeros(3)
        for share in self.shares:
            out[share.slot] += share.value(factors)
        return out

    def slopes(self, factors: Mapping[str, float], name: str) -> NDArray[np.float64]:
        """(3,) derivative of ``coefficients`` to the natural logarithm of a factor."""
        out = np.zeros(3)
        for share in self.shares:
            out[share.slot] += share.exponents.get(name, 0.0) * share.value(factors)
        return out


@dataclass(frozen=True)
class Recipe:
    """How the operators are put together from constant matrices and factors.

    Attributes
    ----------
    pieces : tuple of Piece
    names : tuple of str
        Factors that change something.
    proportional : frozenset of str
        Factors of proportional damping: no matrix contains them, the recipe applies them.
    """

    pieces: tuple[Piece, ...]
    names: tuple[str, ...]
    proportional: frozenset[str] = frozenset()

    def assemble(
        self,
        K: sp.csc_array,
        C: sp.csc_array,
        M: sp.csc_array,
        is_acoustic: NDArray[np.bool_],
        groups: Mapping[str, Mapping[str, sp.csc_array]],
        factors: Mapping[str, float],
    ) -> tuple[sp.csc_array, sp.csc_array, sp.csc_array]:
        """Operators at the given factors.

        Parameters
        ----------
        K, C, M : (n, n) csc_array
            At factors that are all one.
        is_acoustic : (n,) bool array
        groups : mapping of str to mappings of str to csc_array
            Matrices of the further groups by operator, which K, C, M contain.
        factors : mapping

        Returns
        -------
        K, C, M : (n, n) csc_array
        """
        out: list[sp.csc_array] = [sp.csc_array(K.shape, dtype=A.dtype) for A in (K, C, M)]
        operators = {None: parted(dict(zip(OPERATORS, (K, C, M), strict=True)))} | {name: parted(group) for name, group in groups.items()}
        for piece in self.pieces:
            A = block(operators[piece.group][piece.operator], is_acoustic, piece.field)
            for at, weight in enumerate(piece.coefficients(factors)):
                if weight != 0.0 and A.nnz:
                    out[at] = out[at] + weight * A
        for A in out:
            A.sort_indices()
        return out[0].tocsc(), out[1].tocsc(), out[2].tocsc()

    def group_scales(self, name: str, factors: Mapping[str, float]) -> dict[tuple[str, str], float]:
        """By operator and field, what the matrices of a group are multiplied with where the operators are assembled at these factors."""
        scales = {}
        for piece in self.pieces:
            if piece.group == name:
                slot = OPERATORS.index(_whole(piece.operator))
                scales[piece.operator, piece.field] = sum(
                    share.value(factors) for share in piece.shares if share.slot == slot and name in share.exponents
                )
        return scales

    def at(self, factors: Mapping[str, float]) -> Recipe:
        """The recipe about operators that were assembled at these factors: one is then what they have."""

        def moved(share: Monomial) -> Monomial:
            # The other factors are in the matrices; those of proportional damping are not.
            powers = {name: power for name, power in share.exponents.items() if name in self.proportional}
            return replace(share, coefficient=replace(share, exponents=powers).value(factors))

        return replace(self, pieces=tuple(replace(piece, shares=tuple(map(moved, piece.shares))) for piece in self.pieces))


def with_factors(model: FeModel, recipe: Recipe, factors: Mapping[str, float]) -> tuple[FeModel, Recipe]:
    """The model with these factors, and the recipe about it: its factors multiply those that are contained.

    Parameters
    ----------
    model : FeModel
    recipe : Recipe
    factors : mapping
        Those that are not named stay.

    Returns
    -------
    FeModel, Recipe
    """
    K, C, M = recipe.assemble(model.K, model.C, model.M, model.is_acoustic, model.extras, factors)
    extras: dict[str, dict[str, sp.csc_array]] = {name: {} for name in model.extras}
    for name, group in model.extras.items():
        for (operator, field), scale in recipe.group_scales(name, factors).items():
            share, key = scale * block(parted(group)[operator], model.is_acoustic, field), _whole(operator)
            extras[name][key] = (extras[name][key] + share).tocsc() if key in extras[name] else share.tocsc()
    return replace(model, K=K, C=C, M=M, extras=extras), recipe.at(factors)


def parted(operators: Mapping[str, Any]) -> dict[str, Any]:
    """Matrices by operator, a complex stiffness in two: its real part, and ``LOSS``."""
    out = dict(operators)
    if "stiffness" in out and np.iscomplexobj(out["stiffness"]):
        out["stiffness"], out[LOSS] = out["stiffness"].real, 1j * out["stiffness"].imag
    return out


def _whole(operator: str) -> str:
    """The operator that a part belongs to."""
    return "stiffness" if operator == LOSS else operator


def block(matrix: sp.csc_array, is_acoustic: NDArray[np.bool_], field: str) -> sp.csc_array:
    """The entries of a matrix that couple a field with itself, or the two fields (``coupling``)."""
    coo = matrix.tocoo()
    row, column = is_acoustic[coo.row], is_acoustic[coo.col]
    keep = {"structure": ~row & ~column, "acoustic": row & column, "coupling": row != column}[field]
    return sp.coo_array((coo.data[keep], (coo.row[keep], coo.col[keep])), shape=matrix.shape).tocsc()


def make_recipe(
    damping: tuple[tuple[float, float], tuple[float, float]] | None,
    acoustic: bool,
    structural: bool = True,
    groups: Mapping[str, Collection[str]] | None = None,
    lossy: Collection[str] = (),
) -> Recipe:
    """Say how K, C and M depend on the factors.

    ``stiffness.FIELD`` scales the stiffness of a field, ``mass.FIELD`` its mass; with proportional damping
    ``C = alpha·(delta M) + beta·(gamma K)`` per field follows them and has the factors ``alpha.FIELD`` and ``beta.FIELD``; otherwise
    the damping matrix of a field has the factor ``damping.FIELD``. What makes its stiffness complex follows that and has the factor
    ``loss_factor.FIELD``. The coupling blocks stay. A further group is contained in the operators
    once: its factor scales this share of them, ``gamma (K + (phi - 1) K_group)`` and likewise for damping and mass.

    Parameters
    ----------
    damping : ((alpha, beta), (alpha, beta)) or None
        Of structure and air; None where C is a matrix of its own (or nothing).
    acoustic, structural : bool
        Which fields there are.
    groups : mapping of str to collections of str
        The operators of the model, or their parts, to which a further group contributes.
    lossy : collection of str
        Blocks of the stiffness that are complex: fields, and ``coupling``.

    Returns
    -------
    Recipe
    """
    pieces, names, proportional = list[Piece](), list[str](), list[str]()
    present = [name for name, there in zip(FIELDS, (structural, acoustic), strict=True) if there]
    for name in present:
        stiffness, mass = {f"stiffness.{name}": 1.0}, {f"mass.{name}": 1.0}
        names += [*stiffness, *mass]
        if name == "acoustic":
            stiffness[SOUND_SPEED] = 2.0
        of_stiffness, of_mass = [Monomial(0, 1.0, stiffness)], [Monomial(2, 1.0, mass)]
        if damping is not None:
            own = dict(zip((f"alpha.{name}", f"beta.{name}"), damping[FIELDS.index(name)], strict=True))
            for (key, value), shares, exponents in zip(own.items(), (of_mass, of_stiffness), (mass, stiffness), strict=True):
                shares.append(Monomial(1, value, exponents | {key: 1.0}))
            names += [key for key, value in own.items() if value != 0.0]
            proportional += own
        else:
            pieces += _pieces("damping", name, [Monomial(1, 1.0, {f"damping.{name}": 1.0})], groups)
            names.append(f"damping.{name}")
        pieces += [*_pieces("stiffness", name, of_stiffness, groups), *_pieces("mass", name, of_mass, groups)]
        if name in lossy:
            pieces += _pieces(LOSS, name, [Monomial(0, 1.0, stiffness | {f"loss_factor.{name}": 1.0})], groups)
            names.append(f"loss_factor.{name}")
    if len(present) == 2:
        for slot, operator in enumerate(OPERATORS):
            if operator != "damping" or damping is None:
                pieces += _pieces(operator, "coupling", [Monomial(slot, 1.0, {})], groups)
        if "coupling" in lossy:
            pieces += _pieces(LOSS, "coupling", [Monomial(0, 1.0, {})], groups)
    if acoustic:
        names.append(SOUND_SPEED)
    return Recipe(tuple(pieces), (*names, *(groups or {})), frozenset(proportional))


def _pieces(operator: str, field: str, shares: Sequence[Monomial], groups: Mapping[str, Collection[str]] | None) -> list[Piece]:
    """A matrix of the model, and what the further groups contribute to it."""
    out = [Piece(operator, field, None, tuple(shares))]
    for group, there in (groups or {}).items():
        if operator in there:
            own = [replace(share, exponents={**share.exponents, group: 1.0}) for share in shares]
            rest = [replace(share, coefficient=-share.coefficient) for share in shares]
            out.append(Piece(operator, field, group, (*own, *rest)))
    return out
