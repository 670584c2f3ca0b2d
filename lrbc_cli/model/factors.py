"""Global factors of the model, which a calibration identifies: gamma, delta, alpha and beta of Table 2, and factors of further groups.

The operators are sums of constant matrices, each times a product of powers of the factors (``Recipe``). Unlike the terms these
contributions are not of low rank.
"""

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

#: The imaginary part of a complex stiffness, i Im K, treated as a matrix of its own with the factors ``loss_factor.FIELD``.
LOSS = "loss"

#: Factor whose square scales the acoustic stiffness: when the temperature of a gas changes, rho c² stays and c² changes as 1/rho.
SOUND_SPEED = "sound_speed"


@dataclass(frozen=True)
class Monomial:
    """``coefficient * prod factor**exponent``: weight with which a matrix enters the operator ``slot`` (0 stiffness, 1 damping, 2 mass)."""

    slot: int
    coefficient: float
    exponents: Mapping[str, float]

    def value(self, factors: Mapping[str, float]) -> float:
        """Value at the given factors; factors that are not given are one."""
        return float(self.coefficient * np.prod([factors.get(name, 1.0) ** power for name, power in self.exponents.items()]))


@dataclass(frozen=True, kw_only=True)
class Piece:
    """One constant matrix and the weights with which it enters K, C and M.

    Attributes
    ----------
    operator : str
        Operator that the matrix is a block of: ``stiffness``, ``damping``, ``mass`` or ``loss``, see ``parted``.
    field : str
        Block: ``structure``, ``acoustic`` or ``coupling``.
    group : str or None
        Further group that the operator belongs to; None: the model.
    shares : tuple of Monomial
        The weights.
    """

    operator: str
    field: str
    group: str | None
    shares: tuple[Monomial, ...]

    def coefficients(self, factors: Mapping[str, float]) -> NDArray[np.float64]:
        """(3,) weights in stiffness, damping and mass."""
        out = np.zeros(3)
        for share in self.shares:
            out[share.slot] += share.value(factors)
        return out

    def slopes(self, factors: Mapping[str, float], name: str) -> NDArray[np.float64]:
        """(3,) derivative of ``coefficients`` with respect to the natural logarithm of the factor ``name``."""
        out = np.zeros(3)
        for share in self.shares:
            out[share.slot] += share.exponents.get(name, 0.0) * share.value(factors)
        return out


@dataclass(frozen=True)
class Recipe:
    """How K, C and M are assembled from constant matrices and factors; ``make_recipe`` creates it.

    Attributes
    ----------
    pieces : tuple of Piece
    names : tuple of str
        Factors that have an effect.
    proportional : frozenset of str
        Factors alpha and beta of proportional damping. They are in none of the constant matrices; the recipe applies them.
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
        """The operators K, C and M at the given factors.

        Parameters
        ----------
        K, C, M : (n, n) csc_array
            Operators with all factors one.
        is_acoustic : (n,) bool array
        groups : mapping of str to mappings of str to csc_array
            Matrices of the further groups, by group and operator; K, C, M include them.
        factors : mapping
            Values by name; factors that are not given are one.

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
        """Factors by which assembling at ``factors`` multiplies the matrices of a further group, by (operator, field)."""
        scales = {}
        for piece in self.pieces:
            if piece.group == name:
                slot = OPERATORS.index(_whole(piece.operator))
                scales[piece.operator, piece.field] = sum(
                    share.value(factors) for share in piece.shares if share.slot == slot and name in share.exponents
                )
        return scales

    def at(self, factors: Mapping[str, float]) -> Recipe:
        """The recipe for operators that were assembled at these factors: all factors one then gives these operators back."""

        def moved(share: Monomial) -> Monomial:
            # The other factors are contained in the matrices now, those of proportional damping are not.
            powers = {name: power for name, power in share.exponents.items() if name in self.proportional}
            return replace(share, coefficient=replace(share, exponents=powers).value(factors))

        return replace(self, pieces=tuple(replace(piece, shares=tuple(map(moved, piece.shares))) for piece in self.pieces))


def with_factors(model: FeModel, recipe: Recipe, factors: Mapping[str, float]) -> tuple[FeModel, Recipe]:
    """The model assembled at these factors, and the recipe for it, whose factors multiply those already applied.

    Parameters
    ----------
    model : FeModel
    recipe : Recipe
    factors : mapping
        Values by name; factors that are not given stay one.

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
    """Matrices by operator; a complex stiffness is split into its real part and, as ``LOSS``, i times its imaginary part."""
    out = dict(operators)
    if "stiffness" in out and np.iscomplexobj(out["stiffness"]):
        out["stiffness"], out[LOSS] = out["stiffness"].real, 1j * out["stiffness"].imag
    return out


def _whole(operator: str) -> str:
    """The operator that a part belongs to: ``LOSS`` belongs to the stiffness."""
    return "stiffness" if operator == LOSS else operator


def block(matrix: sp.csc_array, is_acoustic: NDArray[np.bool_], field: str) -> sp.csc_array:
    """The block of a matrix that belongs to one field, or the two blocks between the fields (``coupling``); size unchanged."""
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
    """Define how K, C and M depend on the factors.

    ``stiffness.FIELD`` (gamma) scales the stiffness of a field and ``mass.FIELD`` (delta) its mass. With proportional damping,
    ``C = alpha (delta M) + beta (gamma K)`` of each field follows them and has the factors ``alpha.FIELD`` and ``beta.FIELD``; otherwise
    the damping matrix of a field has the factor ``damping.FIELD``. The imaginary part of a complex stiffness is scaled by
    ``stiffness.FIELD`` and ``loss_factor.FIELD``. The coupling blocks are constant. The operators include the matrices of a further group;
    its factor phi scales this part of them: ``gamma (K + (phi - 1) K_group)``, and likewise for damping and mass.

    Parameters
    ----------
    damping : ((alpha, beta), (alpha, beta)) or None
        Coefficients of structure and air; None if C is given as a matrix, or is zero.
    acoustic, structural : bool
        Which fields the model has.
    groups : mapping of str to collections of str
        For each further group the operators, or their parts, to which it contributes.
    lossy : collection of str
        Complex blocks of the stiffness: fields, and ``coupling``.

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
    """The piece for one block of the model, and one for the contribution of each further group to it."""
    out = [Piece(operator=operator, field=field, group=None, shares=tuple(shares))]
    for group, there in (groups or {}).items():
        if operator in there:
            own = [replace(share, exponents={**share.exponents, group: 1.0}) for share in shares]
            rest = [replace(share, coefficient=-share.coefficient) for share in shares]
            out.append(Piece(operator=operator, field=field, group=group, shares=(*own, *rest)))
    return out
