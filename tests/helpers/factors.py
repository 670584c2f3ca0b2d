"""A small vibro-acoustic model with global factors: masses on springs on the flank of a duct, and a share of them as a further group."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from systems import csc, direct_frf, duct, fe_model, unit, whole

from lrbc_cli.model.factors import FIELDS, Recipe, make_recipe, parted, with_factors
from lrbc_cli.model.fem import FeModel, hysteretic
from lrbc_cli.model.terms import EdgeDamping, ParameterGroup, Parameterisation
from lrbc_cli.reduction.reduced.affine import AffineModel
from lrbc_cli.updating.calibration.calibrate import FactorProblem

COEFFICIENTS = ((4.0, 6e-6), (3.0, 4e-7))
SPRINGS = 6
FREQUENCY = np.arange(20.0, 401.0)


def duct_model(matrix_damping: bool = False, loss: tuple[float, float] | None = None) -> tuple[FeModel, Recipe]:
    """The model with the group ``part`` (and its damping, where that is a matrix), and how it depends on factors.

    With loss factors of structure and air both have a complex stiffness.
    """
    ns, na = 8, 24
    K, M, acoustic = duct(ns, na, kappa=1.0, coupling=1.0)
    n = ns + na
    model = fe_model(
        K,
        M,
        loads=unit(n, 7),
        outputs=unit(n, ns + 2, ns + 11, n - 1, 6),
        left=unit(n, *range(SPRINGS)),
        damping=COEFFICIENTS[0],
        acoustic_damping=COEFFICIENTS[1],
        is_acoustic=acoustic,
        output_power=[0, 0, 0, 2],
    )
    first = np.diag((np.arange(n) < 4).astype(float))
    part = {"stiffness": csc(0.4 * first @ model.K.toarray() @ first), "mass": csc(0.3 * first @ model.M.toarray() @ first)}
    if matrix_damping:
        part["damping"] = csc(0.5 * first @ model.C.toarray() @ first)
    if loss is not None:
        part["stiffness"] = hysteretic(part["stiffness"], acoustic, *loss)
        model = replace(model, K=hysteretic(model.K, acoustic, *loss))
    coefficients = None if matrix_damping else COEFFICIENTS
    recipe = make_recipe(coefficients, True, True, {"part": list(parted(part))}, () if loss is None else FIELDS)
    return replace(model, extras={"part": part}), recipe


def affine(model: FeModel, recipe: Recipe) -> AffineModel:
    """The model as its own reduced model."""
    extras = {name: {key: A.toarray() for key, A in group.items()} for name, group in model.extras.items()}
    return AffineModel(whole(model, extras=extras), recipe)


def springs(damped: bool = False) -> Parameterisation:
    """One parameter a spring; damped, with p_damp."""
    at = np.arange(SPRINGS)
    limits = np.tile([1.0, 7.0], (SPRINGS, 1))
    damping = EdgeDamping(beta=2e-5, initial=0.0, bounds=(-2.0, 2.0)) if damped else None
    group = ParameterGroup(
        name="springs",
        kind="stiffness",
        terms=at,
        parameter=at,
        initial=np.full(SPRINGS, 4.5),
        bounds=limits,
        smoothing=np.eye(SPRINGS),
        damping=damping,
    )
    return Parameterisation((group,))


def measured(model: FeModel, recipe: Recipe, factors: dict[str, float], theta: np.ndarray, noise: float, seed: int = 0) -> np.ndarray:
    """(F, R) FRFs of the assembled model by dense solves, with noise relative to each line, and a little to each response's rms."""
    s = 2j * np.pi * FREQUENCY
    y = direct_frf(with_factors(model, recipe, factors)[0], s, springs(theta.size > SPRINGS).dynamic(theta, s))
    rng = np.random.default_rng(seed)
    z = (rng.normal(size=y.shape) + 1j * rng.normal(size=y.shape)) / np.sqrt(2)
    return np.asarray(y + noise * z * (np.abs(y) + 0.001 * np.sqrt(np.mean(np.abs(y) ** 2, axis=0))))


def problem(model: AffineModel, values: np.ndarray, names: tuple[str, ...], **options) -> FactorProblem:
    """All lines and responses."""
    used = np.arange(values.shape[1])
    settings = {"base": {}, "hold": False, "parameters": springs(), "selected": np.arange(FREQUENCY.size)} | options
    return FactorProblem(model=model, names=names, frequency_hz=FREQUENCY, measured=values[:, used], responses=used, **settings)
