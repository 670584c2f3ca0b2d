"""A structure in the coordinates of its modes: the FRFs and derivatives of dense solves, however far its stiffness reaches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from systems import beam, chain, direct_frf, fe_model, relative, unit, whole

from lrbc_cli.model.factors import make_recipe, parted
from lrbc_cli.reduction.reduced import many
from lrbc_cli.reduction.reduced.affine import AffineModel
from lrbc_cli.reduction.reduced.condense import NEGLIGIBLE
from lrbc_cli.reduction.reduced.modal import diagonal_of, modal_structure
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.ports import PortFrf

HZ = np.linspace(20.0, 400.0, 61)
S = 2j * np.pi * HZ
DAMPING = (4.0, 3e-6)


def structure(grounded: bool = True, group: bool = False):
    """A row of masses with springs to ground as terms, and how it depends on factors; half of it a further group on request."""
    K, M = chain(30, grounded=grounded)
    model = fe_model(
        K, M, loads=unit(30, 7, 19), outputs=unit(30, 7, 19, 25), left=unit(30, 0, 1, 12, 29), damping=DAMPING, output_power=[2, 2, 0]
    )
    if not group:
        return model, make_recipe((DAMPING, (0.0, 0.0)), False)
    first = np.diag((np.arange(30) < 12).astype(float))
    part = {"stiffness": type(K)(0.4 * first @ K.toarray() @ first), "mass": type(M)(0.3 * first @ M.toarray() @ first)}
    return replace(model, extras={"part": part}), make_recipe((DAMPING, (0.0, 0.0)), False, True, {"part": list(parted(part))})


def affine(model, recipe) -> AffineModel:
    extras = {name: {key: A.toarray() for key, A in group.items()} for name, group in model.extras.items()}
    return AffineModel(replace(whole(model, extras=extras), input_of=np.array([0, 1, 0])), recipe)


def by_solves(model: AffineModel, D: np.ndarray, factors: dict[str, float], names: list[str]):
    """The same by one factorisation a line, the way of models whose damping couples modes."""
    K, C, M = model.operators(factors)
    x, v = model._solve(S[:, None, None], D, (K, C, M), model.loads(None), None)
    to_quantity, own = S[:, None] ** model.base.output_power, model.base.input_of
    y = (model.base.L @ x)[:, np.arange(3), own] * to_quantity
    terms = -((model.base.left.T @ v) * (model.base.right.T @ x[:, :, own])).transpose(0, 2, 1) * to_quantity[:, :, None]
    slopes = []
    for name in names:
        step = 1e-4
        up, down = (model.operators(factors | {name: factors.get(name, 1.0) * np.exp(sign * step)}) for sign in (1, -1))
        k, c, m = ((a - b) / (2 * step) for a, b in zip(up, down, strict=True))
        z = S[:, None, None]
        slopes.append(-np.einsum("frj,frj->fj", v, ((k + z * c + z**2 * m) @ x)[:, :, own]) * to_quantity)
    return y, terms, np.stack(slopes, axis=2)


@pytest.mark.parametrize("group", [False, True])
@pytest.mark.parametrize("grounded", [True, False])
@pytest.mark.parametrize("turned", [True, False])
@pytest.mark.parametrize("level", [0.0, 4.0, 9.0])
def test_modes_give_the_frfs_of_dense_solves(group: bool, grounded: bool, turned: bool, level: float) -> None:
    """From free terms, the structure then without any support, to terms that clamp; all factors away from one."""
    model = affine(*structure(grounded, group))
    names = list(model.recipe.names)
    factors = {name: 1.0 + 0.07 * (i + 1) for i, name in enumerate(names)}
    D = np.outer(1.0 + 2e-5 * S, 10.0**level * np.array([1.0, 0.3, 2.0, 0.7])) * (level > 0)
    used = model.diagonalised(2 * np.pi * 90.0) if turned else model
    assert modal_structure(*used.operators(factors), 500.0) is not None
    found = used.linearise(S, D, factors, names)
    y, terms, slopes = by_solves(model, D, factors, names)
    assert relative(found.y, y) < 1e-9
    # A term that clamps hardly moves: the difference of two solutions has no digits left there, the port formula has.
    close = 1e-9 if level < 9 else 1e-3
    np.testing.assert_allclose(found.terms, terms, rtol=close, atol=close * np.abs(terms).max())
    np.testing.assert_allclose(found.factors, slopes, rtol=1e-6, atol=1e-7 * np.abs(slopes).max())


def test_the_highest_modes_leave_the_lowest_their_digits() -> None:
    """A beam of 60 elements: its stiffness spans nine decades of eigenvalues; the FRFs of the lowest modes keep eight digits."""
    K, M = beam(60)
    n = K.shape[0]
    model = fe_model(K, M, loads=unit(n, 21), outputs=unit(n, 21, 51), left=unit(n, 41, 71), damping=(0.5, 2e-7), output_power=[2, 2])
    used = AffineModel(whole(model), make_recipe(((0.5, 2e-7), (0.0, 0.0)), False))
    modal = modal_structure(model.K.toarray(), model.C.toarray(), model.M.toarray(), 2 * np.pi * 90.0)
    assert modal is not None
    eigenvalues = modal.diagonals[0].real / modal.diagonals[2]
    assert eigenvalues.max() / eigenvalues.min() > 1e8
    D = np.full((S.size, 2), 3e4, dtype=complex)
    exact = direct_frf(model, S, D)
    assert relative(used.linearise(S, D, {}, ["stiffness.structure"]).y, exact) < 1e-8


def test_where_damping_couples_modes_lines_are_solved_one_by_one() -> None:
    model, _ = structure()
    K, C, M = model.K.toarray(), model.C.toarray(), model.M.toarray()
    assert modal_structure(K, C, M, 500.0) is not None
    # A damper of a thousandth of the damping at one mass.
    C[3, 3] *= 1.001
    assert modal_structure(K, C, M, 500.0) is None
    # Not symmetric; no definite matrix.
    assert modal_structure(np.triu(K), M, M, 500.0) is None
    assert modal_structure(-K, M, M, 1.0) is None


def test_a_loss_factor_of_the_whole_structure_stays_diagonal() -> None:
    model, _ = structure()
    K, C, M = model.K.toarray() * (1 + 0.02j), model.C.toarray(), model.M.toarray()
    modal = modal_structure(K, C, M, 500.0)
    assert modal is not None
    np.testing.assert_allclose(modal.diagonals[0].imag, 0.02 * modal.diagonals[0].real, rtol=1e-9)
    K[:12, :12] = K[:12, :12].real
    assert modal_structure(K, C, M, 500.0) is None


def test_what_stands_beside_a_diagonal_is_seen() -> None:
    A = np.diag([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(diagonal_of(A), [1.0, 2.0, 3.0])
    A[0, 2] = 10 * NEGLIGIBLE
    assert diagonal_of(A) is None


class TestManyLines:
    """Port FRFs as a sum over modes are those of direct solves, or direct solves are taken."""

    @staticmethod
    def model(level: float = 5.0, **other) -> ReducedModel:
        reference = 10.0**level * np.array([[1.0, 1e-5, 0.0], [0.3, 0.0, 0.0], [2.0, 0.0, 0.0], [0.7, 0.0, 0.0]])
        return replace(whole(structure(grounded=False)[0]), input_of=np.array([0, 1, 0]), reference=reference, **other)

    @pytest.fixture
    def solved(self, monkeypatch: pytest.MonkeyPatch) -> list[int]:
        """Numbers of lines that are solved directly."""
        lines, direct = list[int](), ReducedModel.ports

        def ports(model: ReducedModel, s: np.ndarray, **options) -> PortFrf:
            lines.append(s.size)
            return direct(model, s, **options)

        monkeypatch.setattr(ReducedModel, "ports", ports)
        return lines

    @staticmethod
    def require_same(found: PortFrf, expected: PortFrf) -> None:
        for name in ("H00", "H0p", "Hp0", "Hpp"):
            one, other = getattr(found, name), getattr(expected, name)
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-8 * np.abs(other).max(), err_msg=name)
        np.testing.assert_array_equal(found.D_ref, expected.D_ref)
        D = expected.D_ref * np.array([1.0, 0.0, 0.5, 1e3])
        assert relative(found.evaluate(D), expected.evaluate(D)) < 1e-8

    @pytest.mark.parametrize("level", [0.0, 3.0, 6.0])
    def test_by_modes(self, level: float, solved: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
        """Without any support but the terms, at low and high values of these, hysteretic damping included."""
        model = self.model(level)
        model = replace(model, K=model.K * (1.0 + 0.02j))
        expected = model.ports(S)
        found = many.ports_of(model, S)
        self.require_same(found, expected)
        assert solved == [S.size, 3]
        # Where it saves nothing, lines are solved directly.
        self.require_same(many.ports_of(model, S[:4]), model.ports(S[:4]))
        assert solved[2:] == [4, 4]

    @staticmethod
    def in_a_box(loss: float) -> ReducedModel:
        """The structure, with a loss factor, beside air of 40 DOFs whose matrices are full, with the given loss factor."""
        model, rng = TestManyLines.model(), np.random.default_rng(3)
        ns, na = model.size, 40
        Q, coupling = np.linalg.qr(rng.standard_normal((na, na)))[0] + 0.1, rng.standard_normal((ns, na))
        # Resonances of the air in rigid walls from zero to some times the band.
        hz = np.linspace(0.0, 4.0 * np.abs(S).max(), na) / (2 * np.pi)
        K, M = Q.T @ np.diag((2 * np.pi * hz) ** 2) @ Q, Q.T @ Q
        full = [np.zeros((ns + na, ns + na), dtype=complex) for _ in range(3)]
        for A, own, air in zip(full, (model.K * (1.0 + 0.01j), model.C, model.M), (K * (1.0 + 1j * loss), 0.0 * K, M), strict=True):
            A[:ns, :ns], A[ns:, ns:] = own, air
        full[0][:ns, ns:], full[2][ns:, :ns] = -coupling, 1.2 * coupling.T
        none = np.zeros((na, model.terms))
        return replace(
            model, K=full[0], C=full[1].real, M=full[2].real, structure=ns, B=np.vstack([model.B, np.zeros((na, model.B.shape[1]))]),
            L=np.hstack([model.L, rng.standard_normal((model.L.shape[0], na))]), left=np.vstack([model.left, none]),
            right=np.vstack([model.right, none]),
        )  # fmt: skip

    @pytest.mark.parametrize("loss", [0.0, 0.003])
    def test_with_the_air_condensed_out(self, loss: float, solved: list[int]) -> None:
        model = self.in_a_box(loss)
        self.require_same(many.ports_of(model, S), model.ports(S))
        assert solved == [3, S.size]

    @pytest.mark.parametrize("near", [0.0, 1e-12, 1e-9, 1e-6])
    def test_not_about_resonances_of_the_air_in_rigid_walls(self, near: float, solved: list[int]) -> None:
        model = self.in_a_box(0.0)
        ns = model.structure
        squares = np.sort(np.linalg.eigvals(np.linalg.solve(model.M[ns:, ns:], model.K[ns:, ns:].real)).real)
        s = np.sort_complex(np.append(S, 1j * np.sqrt(squares[3:6]) * (1.0 + near)))
        self.require_same(many.ports_of(model, s), model.ports(s))
        assert near > 1e-6 or solved[-2] > 3

    def test_not_where_damping_couples_the_modes_or_terms_act_on_the_air(self, solved: list[int]) -> None:
        model = self.model()
        dashpot = np.zeros_like(model.C)
        dashpot[3, 3] = 50.0
        for other in (replace(model, C=model.C + dashpot), replace(model, structure=model.size - 5)):
            solved.clear()
            many.ports_of(other, S)
            assert solved == [S.size]

    @pytest.mark.parametrize("near", [0.0, 1e-12, 1e-9, 1e-6])
    def test_not_about_resonances_without_the_terms(self, near: float, solved: list[int]) -> None:
        """An undamped structure that only the terms hold: about its own resonances the sum over modes has no digits left."""
        model = self.model()
        M = np.linalg.inv(np.linalg.cholesky(model.M))
        resonances = np.sqrt(np.linalg.eigvalsh(M @ model.K.real @ M.T)[4:7]) * (1.0 + near)
        model, s = replace(model, C=0.0 * model.C), np.sort_complex(np.append(S, 1j * resonances))
        self.require_same(many.ports_of(model, s), model.ports(s))
        # Few lines besides those that are checked, unless one is exactly there.
        assert near == 0.0 or all(count < 10 for count in solved[:-1])

    def test_not_where_it_is_inaccurate(self, solved: list[int]) -> None:
        many.ports_of(self.model(), S, apart=0.0)
        assert solved == [3, S.size]
