"""Global factors: how the operators depend on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from factors import COEFFICIENTS, duct_model

from lrbc_cli.model.factors import make_recipe, with_factors
from lrbc_cli.model.fem import hysteretic

PROPORTIONAL = ("stiffness.structure", "mass.structure", "alpha.structure", "beta.structure", "stiffness.acoustic", "mass.acoustic",
                "alpha.acoustic", "beta.acoustic", "sound_speed", "part")  # fmt: skip


def close(a, b) -> None:
    for x, y in zip((a.K, a.C, a.M), (b.K, b.C, b.M), strict=True):
        np.testing.assert_allclose(x.toarray(), y.toarray(), rtol=1e-12, atol=1e-12 * np.abs(y.data).max())
    for group, matrices in b.extras.items():
        for key, A in matrices.items():
            np.testing.assert_allclose(a.extras[group][key].toarray(), A.toarray(), rtol=1e-12)


MODELS = pytest.mark.parametrize(("matrix", "loss"), [(False, None), (True, None), (False, (0.02, 0.003)), (True, (0.02, 0.003))])


@MODELS
def test_factors_of_one_change_nothing(matrix, loss):
    model, recipe = duct_model(matrix, loss)
    close(with_factors(model, recipe, {})[0], model)
    close(with_factors(model, recipe, dict.fromkeys(recipe.names, 1.0))[0], model)


def test_names():
    assert set(duct_model()[1].names) == set(PROPORTIONAL)
    assert "damping.structure" in duct_model(True)[1].names
    assert "alpha.structure" not in duct_model(True)[1].names
    assert make_recipe(((4.0, 0.0), (0.0, 0.0)), False).names == ("stiffness.structure", "mass.structure", "alpha.structure")


@MODELS
def test_factors_multiply(matrix, loss):
    """Factors on a model that contains factors are those of the product."""
    model, recipe = duct_model(matrix, loss)
    rng = np.random.default_rng(3)
    first, second = ({name: float(np.exp(rng.normal(scale=0.3))) for name in recipe.names} for _ in range(2))
    once = with_factors(model, recipe, {name: first[name] * second[name] for name in recipe.names})[0]
    close(with_factors(*with_factors(model, recipe, first), second)[0], once)


def test_each_operator():
    """By hand: gamma (K + (phi - 1) K_part) on the structure's block, damping from it, the coupling untouched."""
    model, recipe = duct_model()
    gamma, phi, beta, alpha, c = 1.1, 0.8, 1.5, 0.7, 1.02
    factors = {"stiffness.structure": gamma, "part": phi, "beta.structure": beta, "alpha.structure": alpha, "sound_speed": c}
    found = with_factors(model, recipe, factors)[0]
    at, air = np.ix_(~model.is_acoustic, ~model.is_acoustic), np.ix_(model.is_acoustic, model.is_acoustic)
    K, M = (
        gamma * (X.toarray() + (phi - 1) * P.toarray())[at]
        for X, P in ((model.K, model.extras["part"]["stiffness"]), (model.M, model.extras["part"]["mass"]))
    )
    M = M / gamma
    np.testing.assert_allclose(found.K.toarray()[at], K, rtol=1e-12)
    np.testing.assert_allclose(found.M.toarray()[at], M, rtol=1e-12)
    np.testing.assert_allclose(found.C.toarray()[at], COEFFICIENTS[0][0] * alpha * M + COEFFICIENTS[0][1] * beta * K, rtol=1e-12)
    np.testing.assert_allclose(found.K.toarray()[air], model.K.toarray()[air] * c**2, rtol=1e-12)
    cross = np.ix_(~model.is_acoustic, model.is_acoustic)
    np.testing.assert_array_equal(found.K.toarray()[cross], model.K.toarray()[cross])


def test_the_loss_factor():
    """Gamma K (1 + i lambda eta) with K and its share as real matrices; damping from the real part, the coupling real."""
    real, plain_recipe = duct_model()
    model, recipe = duct_model(loss=(0.02, 0.003))
    assert set(recipe.names) == {*PROPORTIONAL, "loss_factor.structure", "loss_factor.acoustic"}
    factors = {"stiffness.structure": 1.1, "part": 0.8, "sound_speed": 1.02, "beta.structure": 1.5}
    lost = {"loss_factor.structure": 2.5, "loss_factor.acoustic": 0.4}
    found = with_factors(model, recipe, factors | lost)[0]
    expected = with_factors(real, plain_recipe, factors)[0]
    close(found, replace(expected, K=hysteretic(expected.K, real.is_acoustic, 0.05, 0.0012), extras={}))
    own = hysteretic(expected.extras["part"]["stiffness"], real.is_acoustic, 0.05, 0.0012)
    np.testing.assert_allclose(found.extras["part"]["stiffness"].toarray(), own.toarray(), rtol=1e-12)
