"""Compression of a rich basis, the sweep over the band, errors by residuals, and the bound for lines that were not solved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as la
from scipy import stats
from systems import beam, csc, dense_ports, duct, fe_model, relative, unit

from lrbc_cli.reduction.build import COMPRESSION, Reducer, ReductionOptions, reduce_model
from lrbc_cli.reduction.problem import problem
from lrbc_cli.reduction.problem.vectors import certificate_vectors, local_scale
from lrbc_cli.reduction.reduced.sweep import ReducedSolver
from lrbc_cli.reduction.steps import full_lines
from lrbc_cli.reduction.steps.certify import port_errors, residual_errors
from lrbc_cli.reduction.steps.compress import ELSEWHERE, Compressor, SweepModes
from lrbc_cli.reduction.steps.unseen import distance, tolerance_factor, unseen_bound

BAND = (10.0, 400.0)


def box(*, skew: float = 0.0, on_air: bool = False):
    """A chain that closes a duct; with ``skew`` no factor makes its coupling symmetric."""
    K, M, acoustic = duct(60, 150, 1.2, coupling=0.05, stiffness=6e5)
    n = acoustic.size
    left = unit(n, 0, 15, 30, 45, 59)
    if on_air:
        left = csc(np.hstack([left.toarray(), 1e-3 * unit(n, 100).toarray()]))
    if skew:
        M = M.tolil()
        M[np.flatnonzero(acoustic)[:80], :20] *= 1.0 + skew
        M = csc(M)
    return fe_model(
        K, M, loads=unit(n, 11), outputs=unit(n, 40, 90, 140, 209), left=left, is_acoustic=acoustic, damping=(4.0, 1e-6),
        output_power=[2, 0, 0, 0],
    )  # fmt: skip


def strip():
    K, M = beam(80, bending=15.0)
    n = K.shape[0]
    return fe_model(K, M, loads=unit(n, 21), outputs=unit(n, 51, 103, 131), left=unit(n, 0, 40, 60, 100, n - 1), damping=(4.0, 2e-6))


MODELS = {"box": box, "skew box": lambda: box(skew=0.4), "terms on air": lambda: box(on_air=True), "strip": strip}


def one_input(model):
    return np.zeros(model.L.shape[0], dtype=np.int64)


def rich(model, tolerance=1e-3, points=(45.0, 200.0, 360.0)):
    R = Reducer(model, one_input(model), ReductionOptions(band_hz=BAND, tolerance=tolerance))
    for frequency in points:
        R.enrich(*R.lines.solve([frequency]))
    return R


@pytest.mark.parametrize("name", MODELS)
def test_the_sweep_solves_the_reduced_system(name):
    """With the air condensed out or not: the same as the dense system, in the coordinates of the basis."""
    R = rich(MODELS[name]())
    P, operators = R.basis, R.basis.operators
    solver = ReducedSolver(operators, R.problem.structure_of(R.basis), P.inputs, P.dual, symmetric=R.problem.Z.symmetric)
    assert (solver.air is not None) == ("box" in name)
    s = 2j * np.pi * np.array([17.0, 111.0, 390.0])
    X, Y = solver.solve(s)
    K, C, M = operators
    for at, z in enumerate(s):
        Z = z**2 * M + z * C + K
        assert relative(solver.turn @ X[at], np.linalg.solve(Z, P.inputs)) < 1e-8
        assert relative(solver.turn @ Y[at], np.linalg.solve(Z if R.problem.Z.symmetric else Z.T, P.dual)) < 1e-8


@pytest.mark.parametrize("name", ["box", "skew box"])
def test_a_restricted_projection_is_that_of_the_smaller_basis(name):
    R = rich(MODELS[name]())
    P = R.basis
    rng = np.random.default_rng(0)
    turns = [la.qr(rng.normal(size=(size, size // 2)), mode="economic")[0] for size in P.sizes]
    T = la.block_diag(*turns)
    rich_one = P.projected()
    operators, inputs, outputs = rich_one.operators, rich_one.inputs, rich_one.outputs
    states = rng.normal(size=(T.shape[1], 2))
    lifted = P.lift(T @ states)
    P.restrict(turns)
    for found, full in zip(R.basis.operators, operators, strict=True):
        np.testing.assert_allclose(found, T.T @ full @ T, rtol=0, atol=1e-11 * np.abs(full).max())
    small = P.projected()
    for found, full in zip((*small.sketches, *small.turned), (*rich_one.sketches, *rich_one.turned), strict=True):
        np.testing.assert_allclose(found, full @ T, rtol=0, atol=1e-11 * np.abs(full).max())
    np.testing.assert_allclose(P.inputs, T.T @ inputs, rtol=0, atol=1e-12 * np.abs(inputs).max())
    np.testing.assert_allclose(P.outputs, outputs @ T, rtol=0, atol=1e-12 * np.abs(outputs).max())
    np.testing.assert_allclose(P.lift(states), lifted, rtol=0, atol=1e-12 * np.abs(lifted).max())
    # It can grow again.
    R.enrich(*R.lines.solve([300.0]))
    V = np.zeros((R.problem.model.size, P.size))
    start = 0
    for field in R.basis.fields:
        V[field.dofs, start : start + field.Q.shape[1]] = field.V
        start += field.Q.shape[1]
    for found, full in zip((R.reduced().K, R.reduced().M), (R.problem.model.K, R.problem.model.M), strict=True):
        expected = V.T @ (full @ V)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


class TestCompression:
    @pytest.mark.parametrize("name", MODELS)
    def test_it_keeps_the_responses_of_the_rich_model(self, name):
        R = rich(MODELS[name]())
        sweep, size = R.estimator.sweep(R.basis.projected()), R.basis.size
        R.compress(sweep)
        assert R.basis.size < size
        lost = distance(sweep.ports, R.estimator.sweep(R.basis.projected()).ports, sweep.vectors, R.problem.quantities)
        # Searched at some of the lines, it holds at all of them.
        assert lost.max() <= ELSEWHERE * COMPRESSION * R.options.tolerance
        assert np.sort(lost)[: lost.size * 9 // 10].max() <= COMPRESSION * R.options.tolerance

    @pytest.mark.slow
    def test_the_basis_is_nearly_the_smallest(self):
        """Against the singular vectors of all solutions of the full model at all lines, field by field, tried size by size."""
        model = box()
        reduction = reduce_model(model, one_input(model), ReductionOptions(band_hz=BAND))
        s = 2j * np.pi * np.linspace(*BAND, 60)
        R = Reducer(model, one_input(model), ReductionOptions(band_hz=BAND))
        K, C, M = (A.toarray() for A in (R.problem.Z.K, R.problem.Z.C, R.problem.Z.M))
        rhs = np.hstack([model.inputs.toarray(), model.L.T.toarray()])
        X = np.hstack([np.linalg.solve(z**2 * M + z * C + K, rhs) for z in s])
        bases = []
        for field in R.basis.fields:
            Y = X[field.dofs] * field.weight[:, None]
            Y = Y / np.linalg.norm(Y, axis=0)
            bases.append(la.svd(np.hstack([Y.real, Y.imag]), full_matrices=False)[0] / field.weight[:, None])
        exact = dense_ports(model, s[::2], R.problem.reference)
        vectors = [D for Ds in certificate_vectors(model.terms, R.problem.scale, s[::2], count=4).values() for D in Ds]

        def error(counts) -> float:
            V = np.zeros((model.size, sum(counts)))
            start = 0
            for field, basis, count in zip(R.basis.fields, bases, counts, strict=True):
                V[field.dofs, start : start + count] = basis[:, :count]
                start += count
            K, C, M = (V.T @ (A @ V) for A in (model.K, model.C, model.M))
            B, L, left, right = V.T @ model.B, model.L @ V, V.T @ model.terms.left, V.T @ model.terms.right
            small = replace(reduction.model, K=K, C=C, M=M, B=B, L=L, left=left, right=right, structure=counts[0])
            return float(distance(exact, small.ports(s[::2]), vectors, R.problem.quantities).max())

        found = reduction.sizes
        smallest = min(
            sum(counts)
            for counts in ((a, b) for a in range(found[0] // 2, found[0] + 1) for b in range(found[1] // 2, found[1] + 1))
            if sum(counts) <= 0.95 * sum(found) and error(counts) <= 1e-3
        )
        assert sum(found) <= 1.3 * smallest

    def test_a_limit_of_the_size_is_kept(self):
        R = rich(box())
        compressor = Compressor(R.problem, R.basis, R.estimator.sweep(R.basis.projected()), R.estimator, 1e-9)
        for limit in (R.basis.size - 1, 30, 12):
            counts = compressor.within(limit)
            assert limit - 4 <= sum(counts) <= limit

    def test_shares_left_out(self):
        rng = np.random.default_rng(2)
        X = rng.normal(size=(12, 12)) @ np.diag(10.0 ** -np.arange(12.0)) @ rng.normal(size=(12, 40))
        modes = SweepModes.of(X @ X.T)
        for count in (1, 2, 4):
            rest = X - modes.vectors[:, :count] @ (modes.vectors[:, :count].T @ X)
            assert modes.tail[count] == pytest.approx(np.linalg.norm(rest) / np.linalg.norm(X), rel=1e-3)
            assert modes.count(float(modes.tail[count])) == count
        assert modes.tail[modes.count(0.0)] == 0.0


@pytest.mark.parametrize("name", MODELS)
def test_errors_by_residuals_are_those_by_exact_ports(name):
    model = MODELS[name]()
    R = rich(model, points=(150.0, 300.0))
    R.compress(R.estimator.sweep(R.basis.projected()))
    reduced = R.reduced()
    for frequency in (60.0, 385.0):
        [line] = R.lines.solve([frequency])
        expected = port_errors(model, R.problem.scale, line.exact, reduced.ports(line.exact.s))
        found = residual_errors(model, R.problem.scale, reduced, line.factorisation, R.basis.lift, lambda u: R.problem.inputs @ u)
        assert 1e-7 < max(expected.values()) < 0.5
        for kind, error in expected.items():
            # Up to a share of its own size.
            assert found[kind] == pytest.approx(error, rel=3 * error + 0.05, abs=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_many_inputs_are_compressed_before_solving(monkeypatch, name):
    monkeypatch.setattr(problem, "MANY_INPUTS", 3)
    monkeypatch.setattr(full_lines, "COMBINATIONS", 4)
    model = MODELS[name]()
    R = Reducer(model, one_input(model), ReductionOptions(band_hz=BAND))
    assert R.problem.many
    assert R.lines.combinations.shape[1] == 5
    reduction = R.run()
    assert reduction.reached
    # Only the first line was solved for all inputs.
    assert len(R.exact) == 1
    s = 2j * np.pi * np.linspace(12.0, 399.0, 25)
    exact, found = dense_ports(model, s, R.problem.reference), reduction.model.ports(s)
    vectors = [
        D for Ds in certificate_vectors(model.terms, local_scale(model.K, model.M, model.terms, 2 * np.pi * 400.0), s).values() for D in Ds
    ]
    error = distance(exact, found, vectors, R.problem.quantities)
    assert np.mean(error < 1e-3) > 0.95


def test_two_lines_at_a_time_give_the_same_model(monkeypatch):
    model, s = box(), 2j * np.pi * np.linspace(*BAND, 21)
    found = []
    for cores in (1, 2):
        monkeypatch.setattr(full_lines, "cores", lambda cores=cores: cores)
        found.append(reduce_model(model, one_input(model), ReductionOptions(band_hz=BAND), backend="superlu"))
    assert found[0].sizes == found[1].sizes
    np.testing.assert_allclose(found[0].model.ports(s).H00, found[1].model.ports(s).H00, rtol=1e-6)


@pytest.mark.parametrize("skew", [0.0, 0.4])
def test_a_roving_hammer_is_solved_from_the_other_side(skew):
    """Eight hammer points, two responses: port FRFs from the transposed system, each place solved once."""
    K, M, acoustic = duct(60, 150, 1.2, coupling=0.05, stiffness=6e5)
    n = acoustic.size
    if skew:
        M = M.tolil()
        M[np.flatnonzero(acoustic)[:80], :20] *= 1.0 + skew
        M = csc(M)
    hammer = np.arange(5, 45, 5)
    model = fe_model(
        K, M, loads=unit(n, *hammer), outputs=unit(n, *np.tile([40, 140], hammer.size)), left=unit(n, 0, 59), is_acoustic=acoustic,
        damping=(4.0, 1e-6), output_power=[2, 0] * hammer.size,
    )  # fmt: skip
    input_of = np.repeat(np.arange(hammer.size), 2)
    R = Reducer(model, input_of, ReductionOptions(band_hz=BAND))
    assert R.problem.dual.shape[1] == (2 if R.problem.Z.symmetric else 4)
    whole = model.L.T if R.problem.Z.symmetric else model.outputs.T
    np.testing.assert_array_equal(R.problem.dual[:, R.problem.dual_of].toarray(), whole.toarray())
    (line,) = R.lines.solve([123.0])
    assert line.X is None
    exact = dense_ports(model, np.array([line.factorisation.s]), R.problem.reference, input_of)
    for name in ("H00", "H0p", "Hp0", "Hpp"):
        np.testing.assert_allclose(
            getattr(line.exact, name), getattr(exact, name), rtol=1e-6, atol=1e-10 * np.abs(getattr(exact, name)).max()
        )
    reduction = R.run()
    assert reduction.reached
    s = 2j * np.pi * np.linspace(12.0, 399.0, 25)
    exact, found = dense_ports(model, s, R.problem.reference, input_of), reduction.model.ports(s)
    scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * 400.0)
    vectors = [D for Ds in certificate_vectors(model.terms, scale, s).values() for D in Ds]
    assert np.mean(distance(exact, found, vectors, R.problem.quantities) < 1e-3) > 0.95


class TestBound:
    def test_factors_are_those_of_the_tables(self):
        """One-sided tolerance factors k(n; 0.95, 0.95) and k(n; 0.99, 0.95), ISO 16269-6."""
        for count, factor in ((5, 4.203), (10, 2.911), (30, 2.220)):
            assert tolerance_factor(count) == pytest.approx(factor, abs=2e-3)
        assert tolerance_factor(10, share=0.99) == pytest.approx(3.981, abs=2e-3)

    def test_it_covers_what_it_says(self):
        """Errors that are the estimate times a lognormal factor: at least 95 % of lines below the bound in 95 % of repetitions."""
        rng = np.random.default_rng(7)
        estimate = np.full(200, 1e-3)
        kept = 0
        for _ in range(2000):
            ratio = rng.lognormal(-2.0, 0.7, size=5)
            bound = unseen_bound(1e-3 * ratio, np.full(5, 1e-3), np.zeros(5), estimate=estimate, rounded=np.zeros(200))
            kept += stats.lognorm.cdf(bound / 1e-3, 0.7, scale=np.exp(-2.0)) >= 0.95
        assert 0.935 <= kept / 2000 <= 0.965

    def test_what_compression_lost_and_rounding_are_added(self):
        measured, expected, none = np.array([1e-5, 2e-5, 3e-5]), np.full(3, 1e-4), np.zeros(3)
        band = {"estimate": np.full(9, 1e-4), "rounded": np.zeros(9)}
        plain = unseen_bound(measured, expected, none, **band)
        assert unseen_bound(measured, expected, none, **band, lost=np.full(9, 5e-5)) == pytest.approx(plain + 5e-5)
        assert unseen_bound(measured, expected, none, **(band | {"rounded": np.full(9, 5e-5)})) == pytest.approx(plain + 5e-5)
        assert np.isnan(unseen_bound(measured[:1], expected[:1], none[:1], **band))

    def test_lines_where_rounding_may_be_all_do_not_tell(self):
        """Else one of them, far above an estimate of next to nothing, would raise the bound by orders of magnitude."""
        measured, expected = np.array([1e-5, 2e-5, 3e-5, 3e-4]), np.array([1e-4, 1e-4, 1e-4, 1e-12])
        low, band = np.full(3, 1e-9), {"estimate": np.full(9, 1e-4), "rounded": np.full(9, 1e-4)}
        told = unseen_bound(measured[:3], expected[:3], low, **band)
        assert unseen_bound(measured, expected, np.append(low, 1e-4), **band) == pytest.approx(told)
        # What is far above both was foreseen by neither.
        assert unseen_bound(measured, expected, np.append(low, 1e-6), **band) > 100 * told

    def test_with_rounding_alone_it_is_what_rounding_comes_to(self):
        none, rounding = np.full(4, 1e-12), np.full(4, 1e-4)
        assert unseen_bound(rounding, none, rounding, estimate=none, rounded=2 * rounding) == pytest.approx(2e-4)
        # A tenth of it measured, a tenth of it believed.
        assert unseen_bound(0.1 * rounding, none, rounding, estimate=none, rounded=2 * rounding) == pytest.approx(2e-5)

    @pytest.mark.parametrize("name", MODELS)
    def test_true_errors_are_below_it(self, name):
        model = MODELS[name]()
        reduction = reduce_model(model, one_input(model), ReductionOptions(band_hz=BAND))
        s = 2j * np.pi * np.random.default_rng(3).uniform(*BAND, size=60)
        exact, found = dense_ports(model, s, reduction.model.reference), reduction.model.ports(s)
        scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * BAND[1])
        vectors = [D for Ds in certificate_vectors(model.terms, scale, s).values() for D in Ds]
        groups = Reducer(model, one_input(model), ReductionOptions(band_hz=BAND)).problem.quantities
        assert reduction.worst < reduction.unseen
        assert np.mean(distance(exact, found, vectors, groups) <= reduction.unseen) >= 0.95
