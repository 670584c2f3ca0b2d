"""Solves with Z(s) against dense algebra: every back end, ordering and symmetry."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import scipy.sparse as sp
from systems import beam, chain, csc, duct, grid

from lrbc_cli.errors import ConfigError, NumericalError
from lrbc_cli.model.fem import proportional_damping
from lrbc_cli.reduction.solve import pardiso
from lrbc_cli.reduction.solve.dynamic import COLUMNS, DynamicStiffness

needs_pardiso = pytest.mark.skipif(pardiso.library() is None, reason="MKL is not installed")
needs_metis = pytest.mark.skipif(importlib.util.find_spec("pymetis") is None, reason="pymetis is not installed")

BACKENDS = [pytest.param("superlu", id="superlu"), pytest.param("pardiso", marks=needs_pardiso, id="pardiso")]
SOLVERS = [
    pytest.param("superlu", "metis", marks=needs_metis, id="superlu-metis"),
    pytest.param("superlu", "bisection", id="superlu-bisection"),
    pytest.param("pardiso", "auto", marks=needs_pardiso, id="pardiso"),
]


def undamped(n):
    return csc(sp.csc_array((n, n)))


def structure(n=60):
    K, M = chain(n)
    return K, proportional_damping(K, M, np.zeros(n, dtype=bool), (3.0, 1e-6), (0, 0)), M, np.zeros(n, dtype=bool)


def coupled():
    K, M, acoustic = duct(40, 90, 1.42e3)
    return K, proportional_damping(K, M, acoustic, (3.0, 2e-6), (5.0, 7e-7)), M, acoustic


def interleaved():
    K, C, M, acoustic = coupled()
    perm = np.random.default_rng(5).permutation(acoustic.size)
    return *(csc(X[perm][:, perm]) for X in (K, C, M)), acoustic[perm]


def disproportional():
    """u-p, but one coupling entry is off: no symmetric form."""
    K, C, M, acoustic = coupled()
    M = M.tolil()
    M[45, 2] = M[45, 2] * 1.5 + 1e-3
    return K, C, csc(M), acoustic


def unsymmetric():
    """A follower force makes K unsymmetric."""
    K, C, M, acoustic = structure()
    return csc(K + sp.diags_array(np.full(59, 4e4), offsets=1)), C, M, acoustic


def hysteretic():
    K, _, M, acoustic = structure()
    return csc(K * (1 + 0.04j)), undamped(60), M, acoustic


def massless():
    """Rotations of a beam without inertia: M is singular."""
    K, M = beam(24)
    lumped = np.zeros(K.shape[0])
    lumped[1:-1:2] = M.diagonal()[1:-1:2]
    return K, csc(1e-6 * K), csc(sp.diags_array(lumped)), np.zeros(K.shape[0], dtype=bool)


def constrained():
    """Two nodes tied by a Lagrange multiplier: an empty diagonal entry."""
    K, C, M, _ = structure()
    tie = np.zeros((60, 1))
    tie[[3, 40], 0] = 1.0, -1.0
    K = sp.block_array([[K, tie * 1e5], [tie.T * 1e5, None]])
    grow = sp.csc_array((1, 1))
    return csc(K), csc(sp.block_diag([C, grow])), csc(sp.block_diag([M, grow])), np.zeros(61, dtype=bool)


def with_free_air():
    """Hard walls: K of the cavity is singular (constant pressure), the structure is not attached."""
    K, M, acoustic = duct(40, 90, coupling=0.0)
    return K, undamped(130), M, acoustic


SYSTEMS = {
    f.__name__: f for f in (structure, coupled, interleaved, disproportional, unsymmetric, hysteretic, massless, constrained, with_free_air)
}
SYMMETRIC = {"structure", "coupled", "interleaved", "hysteretic", "massless", "constrained", "with_free_air"}


def error(found, expected):
    """Largest relative error of a column; fields apart would be stricter, but the systems' dense solves are not better."""
    return np.max(np.linalg.norm(found - expected, axis=0) / np.linalg.norm(expected, axis=0))


@pytest.mark.parametrize(("backend", "ordering"), SOLVERS)
@pytest.mark.parametrize("name", SYSTEMS)
class TestSolves:
    S = 2j * np.pi * 87.3

    def make(self, name, backend, ordering):
        K, C, M, acoustic = SYSTEMS[name]()
        Z = DynamicStiffness(K, C, M, acoustic, backend=backend, ordering=ordering)
        dense = (self.S**2 * M + self.S * C + K).toarray()
        rng = np.random.default_rng(8)
        rhs = rng.normal(size=(K.shape[0], 5)) + 1j * rng.normal(size=(K.shape[0], 5))
        return Z, dense, rhs

    def test_forward_and_transposed(self, name, backend, ordering):
        Z, dense, rhs = self.make(name, backend, ordering)
        assert Z.symmetric == (name in SYMMETRIC)
        factorisation = Z.factor(self.S)
        limit = 1e-14 * np.linalg.cond(dense) + 1e-11
        assert error(factorisation.solve(rhs, refine=1), np.linalg.solve(dense, rhs)) < limit
        assert error(factorisation.solve_transposed(rhs, refine=1), np.linalg.solve(dense.T, rhs)) < limit

    def test_refined_residual(self, name, backend, ordering):
        Z, _, rhs = self.make(name, backend, ordering)
        factorisation = Z.factor(self.S)
        x = factorisation.solve(rhs, refine=1)
        assert factorisation.residual(x, rhs) < 1e-14
        # The measure sees a wrong entry.
        x[x.shape[0] // 2] *= 1 + 1e-4
        assert factorisation.residual(x, rhs) > 1e-9

    def test_one_right_hand_side(self, name, backend, ordering):
        Z, _, rhs = self.make(name, backend, ordering)
        factorisation = Z.factor(self.S)
        x = factorisation.solve(rhs[:, 2], refine=1)
        assert x.shape == (rhs.shape[0],)
        block = factorisation.solve(rhs, refine=1)[:, 2]
        np.testing.assert_allclose(x, block, rtol=1e-8, atol=1e-9 * np.abs(block).max())

    def test_real_right_hand_sides_and_other_shifts(self, name, backend, ordering):
        """One analysis serves all shifts."""
        Z, _, rhs = self.make(name, backend, ordering)
        for s in (2j * np.pi * 11.0, 2j * np.pi * 390.0, -3.0 + 2j * np.pi * 60.0):
            dense = Z.operator(s).toarray()
            limit = 1e-14 * np.linalg.cond(dense) + 1e-11
            assert error(Z.factor(s).solve(rhs.real, refine=1), np.linalg.solve(dense, rhs.real)) < limit


@pytest.mark.parametrize("backend", BACKENDS)
class TestSafety:
    def test_a_replaced_factorisation_does_not_answer(self, backend):
        Z = DynamicStiffness(*structure(), backend=backend)
        old, rhs = Z.factor(100j), np.ones(60)
        new = Z.factor(200j)
        for solve in (old.solve, old.solve_transposed):
            with pytest.raises(NumericalError, match="replaced by a later one"):
                solve(rhs)
        assert np.all(np.isfinite(new.solve(rhs)))

    def test_released_factors_do_not_answer_and_the_analysis_stays(self, backend):
        Z, rhs = DynamicStiffness(*coupled(), backend=backend), np.ones(130)
        old = Z.factor(300j)
        x, nonzeros = old.solve(rhs), Z.nonzeros
        for _ in range(2):
            Z.release()
        assert Z.nonzeros == nonzeros
        with pytest.raises(NumericalError, match="was released"):
            old.solve(rhs)
        np.testing.assert_array_equal(Z.factor(300j).solve(rhs), x)

    def test_more_columns_than_are_solved_at_a_time(self, backend):
        Z = DynamicStiffness(*coupled(), backend=backend)
        rhs = np.random.default_rng(2).normal(size=(130, 2 * COLUMNS + 3)) * (np.arange(2 * COLUMNS + 3) % 2 == 0)
        factorisation = Z.factor(300j)
        expected = np.linalg.solve(Z.operator(300j).toarray(), rhs)
        for solve, right in ((factorisation.solve, expected), (factorisation.solve_transposed, None)):
            whole = solve(rhs, refine=1)
            if right is not None:
                np.testing.assert_allclose(whole, right, rtol=0, atol=1e-9 * np.abs(right).max())
            np.testing.assert_array_equal(solve(csc(rhs), refine=1), whole)
            for column in (0, COLUMNS - 2, COLUMNS, 2 * COLUMNS + 2):
                np.testing.assert_allclose(whole[:, column], solve(rhs[:, column], refine=1), rtol=0, atol=1e-12 * np.abs(whole).max())

    def test_an_orphan_node_is_named(self, backend):
        K, C, M, acoustic = structure()
        keep = np.ones(60)
        keep[17] = 0.0
        P = sp.diags_array(keep)
        Z = DynamicStiffness(*(csc(P @ X @ P) for X in (K, C, M)), acoustic, backend=backend)
        with pytest.raises(NumericalError, match="DOF 17") as caught:
            Z.factor(100j)
        assert "orphan" in caught.value.message

    @pytest.mark.parametrize("name", ["mechanism", "twin rows"])
    def test_a_singular_system_is_refused(self, backend, name):
        """Neither an empty column nor a zero pivot gives it away, only the solution does."""
        if name == "mechanism":
            # A massless free-free chain beside a healthy one.
            free, _ = chain(30, grounded=False)
            K, C, M, _ = structure()
            grow = sp.csc_array((30, 30))
            K, C, M = (csc(sp.block_diag([X, Y])) for X, Y in ((K, free), (C, grow), (M, grow)))
        else:
            # A DOF exported twice.
            K, C, M, _ = structure()
            twice = sp.csc_array(np.eye(60)[:, [*range(60), 20]])
            K, C, M = (csc(twice.T @ X @ twice) for X in (K, C, M))
        Z = DynamicStiffness(K, C, M, np.zeros(K.shape[0], dtype=bool), backend=backend)
        rhs = np.random.default_rng(0).normal(size=K.shape[0])
        with pytest.raises(NumericalError):
            Z.factor(2j * np.pi * 87.3).solve(rhs, refine=1)

    def test_a_sharp_resonance_is_not_singular(self, backend):
        """An undamped system a part in 10⁸ beside its resonance still gives five digits."""
        n = 40
        K, M = chain(n)
        omega = np.sqrt(np.linalg.eigvalsh(K.toarray() / np.sqrt(np.outer(M.diagonal(), M.diagonal())))[3])
        Z = DynamicStiffness(K, undamped(n), M, np.zeros(n, dtype=bool), backend=backend)
        s = 1j * omega * (1 + 1e-8)
        x = Z.factor(s).solve(np.eye(n)[0], refine=1)
        w2, phi = np.linalg.eigh(K.toarray() / np.sqrt(np.outer(M.diagonal(), M.diagonal())))
        phi = phi / np.sqrt(M.diagonal())[:, None]
        expected = phi @ (phi[0] / (w2 + s**2))
        np.testing.assert_allclose(np.linalg.norm(x), np.linalg.norm(expected), rtol=1e-5)

    def test_statistics_count_every_call(self, backend):
        Z = DynamicStiffness(*structure(), backend=backend)
        Z.factor(100j)
        Z.factor(200j)
        assert len(Z.factor_seconds) == 2
        assert Z.nonzeros >= 60


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_larger_grid(backend):
    """Enough supernodes and separators for pivoting and permutations to matter."""
    K = csc(1e6 * grid(14, 13, 12))
    n = K.shape[0]
    M = csc(sp.diags_array(np.linspace(1.0, 2.0, n)))
    C = csc(2e-6 * K)
    Z = DynamicStiffness(K, C, M, np.zeros(n, dtype=bool), backend=backend)
    s = 2j * np.pi * 250.0
    rhs = np.random.default_rng(1).normal(size=(n, 3))
    x = Z.factor(s).solve(rhs, refine=1)
    residual = Z.apply(s, x) - rhs
    assert np.max(np.linalg.norm(residual, axis=0) / np.linalg.norm(rhs, axis=0)) < 1e-11


@needs_pardiso
def test_the_back_ends_agree():
    answers = []
    for backend in ("superlu", "pardiso"):
        Z = DynamicStiffness(*interleaved(), backend=backend)
        answers.append(Z.factor(2j * np.pi * 51.0).solve(np.eye(130)[:, ::7], refine=1))
    np.testing.assert_allclose(answers[0], answers[1], rtol=1e-9, atol=1e-12 * np.abs(answers[0]).max())


def test_auto_takes_what_is_there():
    assert DynamicStiffness(*structure()).backend == ("superlu" if pardiso.library() is None else "pardiso")


def test_asking_for_what_is_missing(monkeypatch):
    monkeypatch.setattr(pardiso, "library", lambda: None)
    assert DynamicStiffness(*structure()).backend == "superlu"
    with pytest.raises(ConfigError, match="not installed"):
        DynamicStiffness(*structure(), backend="pardiso")
