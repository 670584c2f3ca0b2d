"""Global factors of the model: matrices of calibration groups, damping and baselines of the operators, and use of a stored calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import norm

from lrbc_cli.campaign.reading.doubts.chosen import whole_group
from lrbc_cli.campaign.reading.reader import ModelReader
from lrbc_cli.config import Campaign
from lrbc_cli.config.fields import MatrixRef
from lrbc_cli.config.structure import ProportionalDamping
from lrbc_cli.errors import DataError
from lrbc_cli.model.factors import FIELDS, Recipe, block, make_recipe, parted
from lrbc_cli.model.fem import FeModel, hysteretic, proportional_damping
from lrbc_cli.results.model import Boundary

#: Largest ratio of norms of a group's matrix and the model's entries at the same places; above it is another matrix, or in other units.
LARGEST_SHARE = 2.0


@dataclass(frozen=True, kw_only=True)
class CalibrationUse:
    """Whether and how a stored calibration is used.

    Attributes
    ----------
    used : bool
    text : str
        The same in words.
    key : str or None
        Key of the stored calibration.
    factors : dict
        Factors contained in the model; empty if it is not used.
    stale : bool
        Stored but out of date: a warning is given.
    boundary : mapping
        Values identified together with the factors, by parameter group.
    coarse : str
        Warning that it leaves too much of the reference job for any job to be validated; empty if not.
    """

    used: bool
    text: str
    key: str | None = None
    factors: dict[str, float] = field(default_factory=dict)
    stale: bool = False
    boundary: Mapping[str, Boundary] = field(default_factory=dict)
    coarse: str = ""


def factor_groups(
    reader: ModelReader, operators: dict[str, sp.csc_array], acoustic: NDArray[np.bool_], lossy: Callable[[sp.csc_array], sp.csc_array]
) -> dict[str, dict[str, sp.csc_array]]:
    """Matrices of the calibration groups, by group and operator; ``lossy`` adds the loss factor to a stiffness.

    Raises
    ------
    DataError
        If one cannot be a part of the model's matrix.
    """
    calibration = reader.campaign.calibration
    found: dict[str, dict[str, sp.csc_array]] = {}
    for name, group in ({} if calibration is None else calibration.groups).items():
        found[name] = {}
        for operator, ref in group.matrices.items():
            matrix = reader.matrix(ref, operator, name)
            whole = operators[operator]
            if matrix.nnz == 0 or (np.iscomplexobj(matrix.data) and not np.iscomplexobj(whole.data)):
                raise DataError(
                    f"the {operator} of group {name} is {'empty' if matrix.nnz == 0 else 'complex, but that of the model is not'}",
                    file=ref.path,
                    place=ref.group,
                    expected="a part of the model's matrix",
                )
            # A part has entries only where the model's matrix has some; a few may have cancelled.
            outside = abs(matrix).sum() - abs(matrix).multiply(abs(whole).sign()).sum()
            if outside > 1e-6 * abs(matrix).sum():
                raise DataError(
                    f"the {operator} of group {name} is not part of the model's matrix: it has entries where the model has none",
                    file=ref.path,
                    place=ref.group,
                    expected=f"a part of the model's {operator} matrix, in the same order of DOFs",
                    hint="export the group from the same model; the model's matrix must contain it once",
                )
            _weigh_share(reader, ref, name, operator, matrix, whole)
            reader.warn(*whole_group(reader.campaign, f"calibration.groups.{name}.{operator}", ref, matrix, whole, acoustic))
            found[name][operator] = lossy(matrix) if operator == "stiffness" else matrix
    return found


def _weigh_share(reader: ModelReader, ref: MatrixRef, name: str, operator: str, matrix: sp.csc_array, whole: sp.csc_array) -> None:
    """Refuse a part much larger than the model's entries there; warn if the rest of the model has negative diagonal entries.

    A part of a sum of positive semidefinite matrices has no diagonal entry above that of the sum. With prestress, which is not positive, a
    part may exceed the sum slightly or have the opposite sign, but not be larger by a factor.
    """
    there = abs(matrix).sign().multiply(abs(whole))
    share = float(norm(matrix) / norm(there))
    if share > LARGEST_SHARE:
        raise DataError(
            f"the {operator} of group {name} is not part of the model's matrix: it is {share:.3g} times what the model has there",
            file=ref.path,
            place=ref.group,
            expected=f"a part of the model's {operator} matrix, in the same units",
            found=f"a norm of {norm(matrix):.3g}, the model's there {norm(there):.3g}",
            hint="export the group from the same model and in its units; the model's matrix must contain it once",
        )
    own, all_ = np.real(matrix.diagonal()), np.real(whole.diagonal())
    shown = np.abs(own) > 1e-6 * np.abs(own).max(initial=0.0)
    wrong = shown & ((own * all_ < 0) | (np.abs(own) > np.abs(all_) * (1 + 1e-6)))
    if wrong.any():
        reader.warnings.append(
            f"calibration.groups.{name}: its {operator} exceeds that of the model, or has the opposite sign, at {int(wrong.sum())} of "
            f"{int(shown.sum())} diagonal entries: the rest of the model is negative there, which only prestress causes"
        )


def with_loss(campaign: Campaign, acoustic: NDArray[np.bool_], K: sp.csc_array) -> sp.csc_array:
    """Stiffness with the loss factors of structure and air as imaginary part."""
    damping = campaign.model.damping
    if not isinstance(damping, ProportionalDamping):
        return K
    return hysteretic(K, acoustic, damping.structure.loss_factor, damping.acoustic.loss_factor)


def with_proportional(damping: ProportionalDamping, K: sp.csc_array, M: sp.csc_array, acoustic: NDArray[np.bool_]) -> sp.csc_array:
    """Damping matrix ``alpha M + beta K`` by field; loss factors are in the stiffness instead."""
    structure, air = damping.structure, damping.acoustic
    return proportional_damping(K.real, M, acoustic, (structure.alpha, structure.beta), (air.alpha, air.beta))


def left_behind(exported: sp.csc_array, campaign: Campaign) -> list[str]:
    """Warning if baselines are subtracted from the stiffness, but their part of the damping is unknown."""
    held = [name for name, group in campaign.parameters.items() if group.kind == "stiffness" and group.baseline]
    given = "a damping matrix" if isinstance(campaign.model.damping, MatrixRef) else "a complex stiffness matrix"
    if not held or (not isinstance(campaign.model.damping, MatrixRef) and not np.iscomplexobj(exported.data)):
        return []
    return [
        f"parameters {', '.join(held)}: the matrices contain these springs, and {given} contains an unknown share of their damping: this "
        "damping stays when a spring loosens. Export without the springs (no baseline), or give a real stiffness and model.damping as "
        "alpha, beta and loss_factor"
    ]


def without_springs(model: FeModel, exported: sp.csc_array, campaign: Campaign) -> FeModel:
    """The model without the ``baseline`` of its terms, and without their proportional damping.

    Then a spring that is lost takes its damping along, and factors of a calibration scale the structure only.

    Parameters
    ----------
    model : FeModel
    exported : (n, n) csc_array
        Its stiffness without the loss factors of the campaign.
    campaign : Campaign
    """
    terms, damping = model.terms, campaign.model.damping
    if not terms.baseline.any():
        return model
    held = [(terms.left * np.where(terms.power == power, terms.baseline, 0.0)) @ terms.right.T for power in range(3)]
    K, M = (exported - held[0]).tocsc(), (model.M - held[2]).tocsc()
    C = (model.C - held[1]).tocsc()
    if isinstance(damping, ProportionalDamping):
        C = (with_proportional(damping, K, M, model.is_acoustic) - held[1]).tocsc()
    own = replace(terms, baseline=np.zeros(terms.size))
    return replace(model, K=with_loss(campaign, model.is_acoustic, K), C=C, M=M, terms=own)


def recipe_of(campaign: Campaign, model: FeModel) -> Recipe:
    """How the operators depend on global factors.

    Raises
    ------
    ConfigError
        If the calibration names a factor that scales nothing in the model.
    """
    damping, acoustic = campaign.model.damping, model.is_acoustic
    coefficients = None
    if isinstance(damping, ProportionalDamping):
        coefficients = ((damping.structure.alpha, damping.structure.beta), (damping.acoustic.alpha, damping.acoustic.beta))
    groups = {name: list(parted(group)) for name, group in model.extras.items()}
    loss = model.K.imag if np.iscomplexobj(model.K) else None
    lossy = [name for name in (*FIELDS, "coupling") if loss is not None and block(loss, acoustic, name).count_nonzero()]
    recipe = make_recipe(coefficients, bool(acoustic.any()), not acoustic.all(), groups, lossy)
    require_fields(campaign, recipe)
    return recipe


def require_fields(campaign: Campaign, recipe: Recipe) -> None:
    """Refuse factors of the calibration that scale nothing in the model."""
    if campaign.calibration is None:
        return
    for index, name in enumerate(campaign.calibration.factors):
        if name not in recipe.names:
            raise campaign.error(
                f"the factor '{name}' scales nothing in this model",
                "calibration",
                "factors",
                index,
                expected=f"one of {', '.join(recipe.names)}",
                hint="a loss factor needs model.damping.FIELD.loss_factor above 0, or a complex stiffness"
                if name.startswith("loss_factor.")
                else "acoustic DOFs are those with component PRES in the DOF table",
            )
