"""Derivatives of FRFs to everything that may move them, and the affine model against full solves."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from derivatives import check_derivative
from systems import chain, csc, direct_frf, duct, fe_model, unit

from lrbc_cli.model.factors import FIELDS, Recipe, make_recipe
from lrbc_cli.model.fem import FeModel, hysteretic, proportional_damping
from lrbc_cli.model.terms import EdgeDamping, ParameterGroup, Parameterisation, smoothing_matrix
from lrbc_cli.reduction.reduced.affine import AffineModel
from lrbc_cli.reduction.reduced.condense import air_is_diagonal
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.updating.misfit.extended import ExtendedFrf
from lrbc_cli.updating.misfit.nuisances import Gain, ModelFactor, Nuisance, Shift

S = 2j * np.pi * np.linspace(20.0, 380.0, 23)
STRUCTURE, AIR = (60.0, 2e-5), (40.0, 1e-6)


class System:
    """A small model whose basis is the identity: the affine model is then the full one."""

    def __init__(self, coupled: bool, matrix_damping: bool = False, loss: tuple[float, float] | None = None) -> None:
        if coupled:
            K, M, acoustic = duct(8, 16, kappa=1.3, coupling=1.0)
        else:
            (K, M), acoustic = chain(10, 4e4), np.zeros(10, dtype=bool)
        self.acoustic, n = acoustic, K.shape[0]
        C = proportional_damping(K, M, acoustic, STRUCTURE, AIR)
        lossy = () if loss is None else FIELDS[: 1 + coupled]
        K = K if loss is None else hysteretic(K, acoustic, *loss)
        outputs = (9, 14, 22, 5) if coupled else (2, 8, 5)
        # Two hammers, each with the derivatives of its load to two shifts behind them.
        rng = np.random.default_rng(0)
        shifts = sp.csc_array(np.where(acoustic[:, None], 0.0, rng.normal(size=(n, 4))))
        loads = csc(sp.hstack([unit(n, 7, 3), shifts]))
        self.model = fe_model(
            K, M, loads=loads, outputs=unit(n, *outputs), left=unit(n, 0, 1, 2, 4), C=C, is_acoustic=acoustic,
            output_power=[0, 0, 0, 2] if coupled else [2, 0, 1],
        )  # fmt: skip
        self.input_of = np.array([0, 1, 0, 1] if coupled else [0, 1, 0])
        self.recipe: Recipe = make_recipe(None if matrix_damping else (STRUCTURE, AIR), coupled, True, lossy=lossy)
        self.affine = AffineModel(self.reduced(self.model), self.recipe, np.array([[2, 3], [4, 5]]))
        group = ParameterGroup(
            name="edge",
            kind="stiffness",
            terms=np.arange(3),
            parameter=np.arange(3),
            initial=np.full(3, 4.0),
            bounds=np.tile([0.0, 8.0], (3, 1)),
            smoothing=smoothing_matrix((0.2, 0.6, 0.2), 3),
            damping=EdgeDamping(beta=2e-5, loss_factor=0.0 if loss is None else 0.03),
        )
        mass = ParameterGroup(
            name="mass",
            kind="mass",
            terms=np.array([3]),
            parameter=np.zeros(1, dtype=int),
            initial=np.array([-2.0]),
            bounds=np.array([[-4.0, 0.0]]),
            smoothing=np.eye(1),
        )
        self.parameters = Parameterisation((group, mass))
        self.own = np.array([4.2, 3.6, 4.5, 0.7, -2.1])

    def reduced(self, m: FeModel) -> ReducedModel:
        K, C, M, B, L = (X.toarray() for X in (m.K, m.C, m.M, m.B, m.L))
        left, right = m.terms.left.toarray(), m.terms.right.toarray()
        structure = int(np.sum(~m.is_acoustic))
        return ReducedModel(
            K=K,
            C=C,
            M=M,
            B=B,
            L=L,
            left=left,
            right=right,
            output_power=m.output_power,
            input_of=self.input_of,
            reference=np.zeros((4, 3)),
            structure=structure,
        )

    def direct(self, theta: np.ndarray, factors: dict[str, float], offset: np.ndarray) -> np.ndarray:
        """FRFs of the full model with its matrices put together anew, by dense solves."""
        m = self.model
        K, C, M = self.recipe.assemble(m.K, m.C, m.M, self.acoustic, {}, factors)
        B = m.B.toarray()
        moved = np.column_stack([B[:, 0] + B[:, 2:4] @ offset[0], B[:, 1] + B[:, 4:6] @ offset[1]])
        model = FeModel(K=K, C=C, M=M, B=csc(moved), L=m.L, output_power=m.output_power, is_acoustic=m.is_acoustic, terms=m.terms)
        return direct_frf(model, S, self.parameters.dynamic(theta, S), self.input_of)


def nuisances(system: System) -> list[Nuisance]:
    factors = [ModelFactor(name=name, std=0.1, reach=1.0) for name in system.recipe.names]
    gains = [Gain(name=f"r{i}", index=i, std=0.3, reach=5.0) for i in range(system.input_of.size)]
    return [*factors, *gains, *(Shift(name=f"h{k // 2}", load=k // 2, direction=k % 2, std=0.003, reach=1.0) for k in range(4))]


CASES = {
    "u-p": (True, False),
    "u-p with a damping matrix": (True, True),
    "structure": (False, False),
    "structure with a damping matrix": (False, True),
    "u-p with loss factors": (True, False, (0.02, 0.003)),
    "u-p with one loss factor": (True, False, (0.02, 0.0)),
    "structure with a loss factor": (False, True, (0.02, 0.0)),
}


@pytest.fixture(params=CASES.values(), ids=CASES)
def system(request) -> System:  # type: ignore[no-untyped-def]
    return System(*request.param)


def point(model: ExtendedFrf, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    theta = model.initial
    theta[: model.parameters.size] = [4.2, 3.6, 4.5, 0.7, -2.1]
    theta[model.parameters.size :] = 0.1 * rng.normal(size=len(model.nuisances))
    return theta


def build(system: System, responses: np.ndarray | None = None) -> ExtendedFrf:
    every = np.arange(system.input_of.size)
    return ExtendedFrf(system.affine, S, system.parameters, nuisances(system), every if responses is None else responses)


def test_factors_cover_every_kind() -> None:
    assert set(System(True).recipe.names) == {
        f"{kind}.{field}" for kind in ("stiffness", "mass", "alpha", "beta") for field in ("structure", "acoustic")
    } | {"sound_speed"}
    assert {"damping.structure", "damping.acoustic"} <= set(System(True, True).recipe.names)
    assert "sound_speed" not in System(False).recipe.names


def test_it_is_the_full_model(system: System) -> None:
    model = build(system)
    theta = point(model)
    factors = model.effects(theta).factors
    offset = model.offset(theta)
    assert offset is not None
    gains = np.array([theta[model.parameters.size + i] for i, e in enumerate(model.nuisances) if e.kind == "gain"])
    expected = system.direct(theta[: model.parameters.size], factors, offset) * 10.0 ** (gains / 20.0)
    np.testing.assert_allclose(model.frf(theta), expected, rtol=1e-8)


def test_without_nuisances_it_is_the_model_as_it_is(system: System) -> None:
    model = ExtendedFrf(system.affine, S, system.parameters, [], np.arange(system.input_of.size))
    expected = direct_frf(system.model, S, system.parameters.dynamic(system.own, S), system.input_of)
    np.testing.assert_allclose(model.frf(system.own), expected, rtol=1e-8)
    assert model.offset(system.own) is None


def test_derivatives_to_every_unknown(system: System) -> None:
    """One by one: terms through the smoothing, p_damp, each kind of factor, sound speed, gains, shifts."""
    model = build(system)
    theta = point(model)
    y, J = model.derivatives(theta)
    for k in range(model.size):
        direction = np.eye(model.size)[k]
        step = 1e-6
        change = (model.frf(theta + step * direction) - model.frf(theta - step * direction)) / (2 * step)
        scale = np.abs(change).max()
        if scale < 1e-9 * np.abs(y).max():
            # A response of the other hammer, say: then both are nothing.
            assert np.abs(J[:, :, k]).max() <= 1e-8 * np.abs(y).max()
            continue
        np.testing.assert_allclose(J[:, :, k], change, rtol=1e-4, atol=1e-5 * scale, err_msg=f"unknown {k}")


@pytest.mark.parametrize("kind", ["boundary", "factor", "gain", "shift", "all"])
def test_taylor_remainders(system: System, kind: str) -> None:
    model = build(system)
    theta = point(model)
    own = np.array(["boundary"] * model.parameters.size + [e.kind for e in model.nuisances])
    direction = np.where((own == kind) | (kind == "all"), np.random.default_rng(2).normal(size=model.size), 0.0)
    _, J = model.derivatives(theta)
    scale = 1.0 / np.abs(model.frf(theta)).mean(axis=0)
    check_derivative(lambda t: model.frf(t) * scale, J * scale[:, None], theta, direction)


@pytest.mark.parametrize("phase", [False, True])
def test_logarithmic_derivatives(system: System, phase: bool) -> None:
    model = build(system)
    theta = point(model)
    _, J = model.sensitivities(theta, phase)
    assert np.iscomplexobj(J) == phase
    direction = np.random.default_rng(3).normal(size=model.size)
    check_derivative(lambda t: 20.0 * np.log10(np.abs(model.frf(t))), J.real, theta, direction, first=3e-2)


def test_terms_that_changed_besides(system: System) -> None:
    """As with the dynamic values of these terms changed by hand; the model itself stays as it is."""
    model, terms = build(system), np.array([0, 3])
    theta, before = point(model), build(system).frf(point(model))
    D = system.parameters.dynamic(theta[: system.parameters.size], S)
    D[:, terms] *= 10.0**-0.7
    effects = model.effects(theta)
    expected = system.affine.linearise(S, D, effects.factors, [], model.offset(theta)).y
    gains = 10.0 ** (np.array([effects.gains.get(i, 0.0) for i in range(system.input_of.size)]) / 20.0)
    np.testing.assert_allclose(model.weakened(terms, -0.7).frf(theta), expected * gains, rtol=1e-10)
    np.testing.assert_array_equal(model.frf(theta), before)


def test_some_of_the_responses(system: System) -> None:
    chosen = np.array([0, 2])
    few = [*(e for e in nuisances(system) if e.kind != "gain"), Gain(name="r2", index=2, std=0.3, reach=5.0)]
    model = ExtendedFrf(system.affine, S, system.parameters, few, chosen)
    theta = point(model)
    y, J = model.derivatives(theta)
    assert y.shape == (S.size, 2)
    # The gain belongs to the second of those compared.
    assert not J[:, 0, -1].any()
    np.testing.assert_allclose(J[:, 1, -1], y[:, 1] * np.log(10.0) / 20.0)
    bounds = model.bounds
    assert bounds.shape == (model.size, 2)
    np.testing.assert_array_equal(bounds[-1], [-5.0, 5.0])


def test_the_speed_of_sound_moves_the_resonances_of_the_air() -> None:
    """Frequencies of a duct alone go with the speed."""
    system = System(True)
    m = system.model
    a = system.acoustic
    speed = 1.07

    def frequencies(factors: dict[str, float]) -> np.ndarray:
        K, _, M = system.recipe.assemble(m.K, m.C, m.M, a, {}, factors)
        values = np.linalg.eigvals(np.linalg.solve(M.toarray()[np.ix_(a, a)], K.toarray()[np.ix_(a, a)]))
        return np.sqrt(np.sort(np.maximum(values.real, 0.0))[1:])

    np.testing.assert_allclose(frequencies({"sound_speed": speed}), speed * frequencies({}), rtol=1e-6)


def test_unsymmetric_models_have_the_same_derivatives() -> None:
    """Left and right vectors that differ: no symmetric factorisation to share."""
    system = System(False)
    base = system.affine.base
    right = np.roll(base.right, 1, axis=0)
    affine = AffineModel(ReducedModel(**{**vars(base), "right": right}), system.recipe, system.affine.shifts)
    model = ExtendedFrf(affine, S, system.parameters, nuisances(system), np.arange(3))
    theta = point(model)
    _, J = model.derivatives(theta)
    scale = 1.0 / np.abs(model.frf(theta)).mean(axis=0)
    direction = np.random.default_rng(4).normal(size=model.size)
    check_derivative(lambda t: model.frf(t) * scale, J * scale[:, None], theta, direction, first=3e-2)


def test_the_air_is_condensed_beside_a_lossy_structure() -> None:
    """Loss factors leave the air diagonal in the modes of the cavity, and the coupling real."""
    for loss in ((0.02, 0.0), (0.02, 0.003)):
        system = System(True, False, loss)
        turned = system.affine.diagonalised(300.0)
        base = turned.base
        assert air_is_diagonal(base.K, base.C, base.M, base.structure, base.left, base.right)
        found = [ExtendedFrf(model, S, system.parameters, nuisances(system), np.arange(4)) for model in (turned, system.affine)]
        theta = point(found[0])
        for a, b in zip(*(model.derivatives(theta) for model in found), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9 * np.abs(b).max())
