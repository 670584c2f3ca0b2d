"""The adaptive reduction reaches its tolerance on models of every kind, and direct solves confirm it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.sparse as sp
from systems import beam, chain, csc, dense_ports, direct_frf, duct, fe_model, random_vectors, relative, unit

from lrbc_cli.errors import NumericalError
from lrbc_cli.reduction.build import Reducer, Reduction, ReductionOptions, full_ports, reduce_model
from lrbc_cli.reduction.problem.basis import check_orthonormal
from lrbc_cli.reduction.problem.vectors import band_omega, certificate_vectors, local_scale
from lrbc_cli.reduction.solve import pardiso
from lrbc_cli.reduction.steps import grid
from lrbc_cli.reduction.steps.certify import measured_vectors, port_errors


def one_input(model):
    return np.zeros(model.L.shape[0], dtype=np.int64)


def beam_pieces(elements=80, **more):
    """A beam with two dozen modes below 500 Hz and its own kinds of terms."""
    K, M = beam(elements, bending=15.0)
    n = K.shape[0]
    pieces = {"loads": unit(n, 21), "outputs": unit(n, 51, 103, 131), "left": unit(n, 0, 60, n - 1), "damping": (4.0, 2e-6)}
    return K, M, pieces | more


def damped():
    K, M, pieces = beam_pieces()
    return fe_model(K, M, **pieces)


def undamped():
    K, M, pieces = beam_pieces(damping=(0.0, 0.0))
    return fe_model(K, M, **pieces)


def rigid_body():
    """Free-free chain: two parts can drift once a term between them is free."""
    K, M = chain(150, 6e6, 0.05, grounded=False)
    K = K.tolil()
    K[70, 70] -= 6e6
    K[71, 71] -= 6e6
    K[70, 71] = K[71, 70] = 0.0
    n = 150
    joint = unit(n, 70) - unit(n, 71)
    left = csc(np.hstack([joint.toarray(), unit(n, 140).toarray()]))
    return fe_model(csc(K), M, loads=unit(n, 3), outputs=unit(n, 20, 60, 100), left=left, damping=(3.0, 1e-6))


def singular_mass():
    K, _, pieces = beam_pieces()
    lumped = np.zeros(K.shape[0])
    lumped[1:-1:2] = 0.8 / 80
    return fe_model(K, csc(sp.diags_array(lumped)), **pieces)


def hysteretic():
    K, M, pieces = beam_pieces(damping=(0.0, 0.0))
    return fe_model(csc(K * (1 + 0.02j)), M, **pieces)


def disconnected():
    """Two beams that only a term connects; the second one answers only through it."""
    K, M = beam(50, bending=15.0)
    K2, M2 = beam(45, length=0.8, bending=12.0)
    n, both = K.shape[0], K.shape[0] + K2.shape[0]
    joint = unit(both, 31) - unit(both, n + 31)
    left = csc(np.hstack([joint.toarray(), unit(both, 0, n).toarray()]))
    return fe_model(
        csc(sp.block_diag([K, K2])),
        csc(sp.block_diag([M, M2])),
        loads=unit(both, 21),
        outputs=unit(both, 51, 61),
        left=left,
        damping=(4.0, 2e-6),
    )


def duplicate_terms():
    K, M, pieces = beam_pieces()
    n = K.shape[0]
    left = csc(np.hstack([unit(n, 0, 0, 60, 60, 61).toarray(), (unit(n, 60) + unit(n, 61)).toarray()]))
    return fe_model(K, M, **(pieces | {"left": left}))


def irrelevant_term():
    """One term sits on a part that neither load nor output can reach."""
    K, M, pieces = beam_pieces()
    n = K.shape[0]
    far_K, far_M = chain(20)

    def grow(X):
        return csc(sp.vstack([X, sp.csc_array((20, X.shape[1]))]))

    left = csc(np.hstack([grow(pieces["left"]).toarray(), unit(n + 20, n + 10).toarray()]))
    more = {"loads": grow(pieces["loads"]), "outputs": grow(pieces["outputs"]), "left": left}
    return fe_model(csc(sp.block_diag([K, far_K])), csc(sp.block_diag([M, far_M])), **(pieces | more))


def several_inputs():
    K, M, pieces = beam_pieces()
    n = K.shape[0]
    return fe_model(K, M, **(pieces | {"loads": unit(n, 21, 81), "outputs": unit(n, 51, 103, 131, 51), "output_power": [2, 0, 1, 2]}))


def one_term():
    K, M, pieces = beam_pieces()
    return fe_model(K, M, **(pieces | {"left": unit(K.shape[0], 0)}))


def unsymmetric():
    """Follower forces and terms with unlike left and right vectors."""
    K, M, pieces = beam_pieces()
    n = K.shape[0]
    K = csc(K + sp.diags_array(np.full(n - 2, 0.02 * np.abs(K.diagonal()).mean()) * (np.arange(n - 2) % 2), offsets=2))
    rng = np.random.default_rng(3)
    return fe_model(K, M, **(pieces | {"left": random_vectors(n, 4, rng), "right": random_vectors(n, 4, rng)}))


def kinds_of_terms():
    """Dashpots and masses beside springs, each with a baseline in the matrices."""
    K, M, pieces = beam_pieces()
    n = K.shape[0]
    more = {"left": unit(n, 0, 41, 91, n - 1), "power": [0, 1, 2, 0], "baseline": [0.0, 0.2, 0.003, 5.0]}
    b = unit(n, 0, 41, 91, n - 1).toarray()
    C = csc(4.0 * M + 2e-6 * K + 0.2 * b[:, [1]] @ b[:, [1]].T)
    M = csc(M + 0.003 * b[:, [2]] @ b[:, [2]].T)
    K = csc(K + 5.0 * b[:, [3]] @ b[:, [3]].T)
    pieces.pop("damping")
    return fe_model(K, M, C=C, **(pieces | more))


def vibro_acoustic():
    """u-p model with responses in pressure and acceleration, and terms on both fields."""
    K, M, acoustic = duct(40, 110, 1.2, coupling=0.05, stiffness=6e5)
    n = acoustic.size
    left = csc(np.hstack([unit(n, 0, 20, 39).toarray(), 1e-3 * unit(n, 90).toarray()]))
    return fe_model(
        K,
        M,
        loads=unit(n, 11),
        outputs=unit(n, 30, 60, 100, 149),
        left=left,
        is_acoustic=acoustic,
        damping=(4.0, 1e-6),
        output_power=[2, 0, 0, 0],
    )


def vibro_acoustic_unsymmetric():
    """The same with a coupling that no factor symmetrises."""
    model = vibro_acoustic()
    M = model.M.tolil()
    M[model.is_acoustic.nonzero()[0][:60], :20] *= 1.4
    return fe_model(
        model.K, csc(M), loads=model.B, outputs=csc(model.L.T), left=model.terms.left, is_acoustic=model.is_acoustic, damping=(4.0, 1e-6),
        output_power=model.output_power,
    )  # fmt: skip


def only_air():
    """A cavity with hard walls: K is singular by its constant pressure."""
    K, M, _ = duct(2, 160)
    K, M = csc(K[2:][:, 2:]), csc(M[2:][:, 2:])
    return fe_model(
        K,
        M,
        loads=unit(160, 5),
        outputs=unit(160, 60, 159),
        left=1e-3 * unit(160, 90),
        is_acoustic=np.ones(160, dtype=bool),
        damping=(2.0, 1e-6),
    )


MODELS = {
    f.__name__: f
    for f in (
        damped, undamped, rigid_body, singular_mass, hysteretic, disconnected, duplicate_terms, irrelevant_term, several_inputs, one_term,
        unsymmetric, kinds_of_terms, vibro_acoustic, vibro_acoustic_unsymmetric, only_air,
    )
}  # fmt: skip
BAND = (10.0, 400.0)


def inputs_of(name, model):
    return np.array([0, 1, 1, 1]) if name == "several_inputs" else one_input(model)


def true_error(model, reduction: Reduction, input_of, count=15, seed=11) -> dict[str, float]:
    """Largest error against direct solves on random lines, by kind of vector, each physical quantity apart."""
    rng = np.random.default_rng(seed)
    s = 2j * np.pi * rng.uniform(*reduction.options.band_hz, size=count)
    scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * reduction.options.band_hz[1])
    vectors = {kind: Ds[:4] for kind, Ds in certificate_vectors(model.terms, scale, s).items()}
    # Other vectors than those that the certificate draws.
    vectors["fresh"] = []
    for _ in range(4):
        k = scale * 10.0 ** rng.uniform(-5, 7, size=scale.size)
        vectors["fresh"].append((k - model.terms.baseline) * s[:, None] ** model.terms.power * (1 + 1e-5 * s[:, None]))
    ports = reduction.model.ports(s)
    acoustic = np.asarray(abs(model.L) @ model.is_acoustic.astype(float)) > 0
    key = np.where(acoustic, -1, model.output_power)
    errors = {}
    for kind, Ds in vectors.items():
        for D in Ds:
            y, exact = ports.evaluate(D), direct_frf(model, s, D, input_of)
            for value in np.unique(key):
                group = key == value
                # Where nothing answers, nothing may be invented.
                silent = np.linalg.norm(exact[:, group], axis=1) < 1e-12 * np.linalg.norm(exact)
                assert np.abs(y[silent][:, group]).max(initial=0.0) <= 1e-9 * np.abs(exact).max()
                if not silent.all():
                    errors[kind] = max(errors.get(kind, 0.0), relative(y[~silent][:, group], exact[~silent][:, group]))
    return errors


@pytest.fixture(scope="module")
def reductions():
    """Every model reduced once."""
    found = {}

    def get(name) -> tuple:
        if name not in found:
            model = MODELS[name]()
            found[name] = model, reduce_model(model, inputs_of(name, model), ReductionOptions(band_hz=BAND))
        return found[name]

    return get


@pytest.mark.parametrize("name", MODELS)
def test_tolerance_is_reached_and_true(reductions, name):
    model, reduction = reductions(name)
    assert reduction.reached, reduction.worst
    assert reduction.worst <= 1e-3
    errors = true_error(model, reduction, inputs_of(name, model))
    assert max(errors.values()) < 1e-3, errors


@pytest.mark.parametrize("name", MODELS)
def test_the_reduced_model_is_small(reductions, name):
    model, reduction = reductions(name)

    assert reduction.model.size == sum(reduction.sizes) < 0.6 * model.size
    assert reduction.full_size == model.size
    assert len(reduction.held_out) >= 5


@pytest.mark.parametrize("name", ["damped", "hysteretic", "unsymmetric", "vibro_acoustic", "singular_mass", "several_inputs"])
def test_moments_match_where_it_was_expanded(reductions, name):
    """Reduced equals full at the expansion points, for any vector."""
    model, reduction = reductions(name)
    points = np.array([step.frequency_hz for step in reduction.trace if step.order])
    s = 2j * np.pi * points
    scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * BAND[1])
    reference = dense_ports(model, s, reduction.model.reference, inputs_of(name, model))
    ports = reduction.model.ports(s)
    for Ds in certificate_vectors(model.terms, scale, s).values():
        # Up to what deflation drops, well below the tolerance.
        assert relative(ports.evaluate(Ds[0]), reference.evaluate(Ds[0])) < 3e-4


def reducer(model, **options):
    return Reducer(model, one_input(model), ReductionOptions(band_hz=BAND, **options), backend="superlu")


class TestKrylov:
    @pytest.mark.parametrize(("order", "rate"), [(1, 2), (2, 4)])
    @pytest.mark.parametrize("skew", [0.0, 3e4])
    def test_an_expansion_point_matches_its_moments(self, monkeypatch, order, rate, skew):
        """The error of H grows with the distance to the power of twice the order: two moments an order, left and right together.

        Unlike dashpots at every mass: with proportional damping a wrong slope of Z would span the same space.
        """
        K, M = chain(150)
        n = 150
        K = csc(K + sp.diags_array(np.full(n - 1, skew), offsets=1))
        C = csc(sp.diags_array(20.0 * np.random.default_rng(0).uniform(size=n)))
        model = fe_model(K, M, C=C, loads=unit(n, 30), outputs=unit(n, 90), left=unit(n, 50))
        R = reducer(model)
        monkeypatch.setitem(vars(R.lines), "order", order)
        R.deflation = 1e-13
        R.enrich(*R.lines.solve([150.0]))
        reduced, point = R.reduced(), 2j * np.pi * 150.0
        s = point + 2j * np.pi * 20.0 * 0.5 ** (np.arange(4) + (7 if order == 1 else 5))
        ports, full = reduced.ports(s), dense_ports(model, s, reduced.reference)
        error = np.linalg.norm(ports.H00 - full.H00, axis=1) / np.linalg.norm(full.H00, axis=1)
        assert error[-1] > 1e-11
        np.testing.assert_allclose(np.log2(error[:-1] / error[1:])[-2:], rate, atol=0.2)
        at = reduced.ports(np.array([point]))
        assert relative(at.H00, dense_ports(model, np.array([point]), reduced.reference).H00) < 1e-10

    def test_the_basis_is_orthonormal_real_and_split(self):
        model = vibro_acoustic()
        R = reducer(model)
        for frequency in (50.0, 150.0, 350.0):
            R.enrich(*R.lines.solve([frequency]))
            for field in R.basis.fields:
                assert field.Q.dtype == np.float64
                assert check_orthonormal(field) < 1e-12
        sizes = R.basis.sizes
        assert len(sizes) == 2
        K, C, M = R.basis.operators
        # The coupling keeps its form: no acoustic rows in the structure's part of M, no structural ones in the air's part of K.
        assert not K[sizes[0] :, : sizes[0]].any()
        assert not M[: sizes[0], sizes[0] :].any()
        assert not C[: sizes[0], sizes[0] :].any()

    def test_projection_grown_block_by_block_is_the_projection(self):
        model = MODELS["vibro_acoustic_unsymmetric"]()
        R = reducer(model)
        for frequency in (50.0, 150.0, 350.0):
            R.enrich(*R.lines.solve([frequency]))
        P = R.basis
        V = np.zeros((model.size, P.size))
        at = 0
        for field in R.basis.fields:
            V[np.ix_(field.dofs, np.arange(at, at + field.V.shape[1]))] = field.V
            at += field.V.shape[1]
        reduced = R.reduced()
        for found, full in ((reduced.K, model.K), (reduced.C, model.C), (reduced.M, model.M)):
            expected = V.T @ (full @ V)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
        np.testing.assert_allclose(reduced.B, V.T @ model.B, rtol=0, atol=1e-12 * np.abs(reduced.B).max())
        np.testing.assert_allclose(reduced.L, model.L @ V, rtol=0, atol=1e-12 * np.abs(reduced.L).max())
        np.testing.assert_allclose(reduced.left, V.T @ model.terms.left, rtol=0, atol=1e-12 * np.abs(reduced.left).max())
        np.testing.assert_allclose(reduced.right, V.T @ model.terms.right, rtol=0, atol=1e-12 * np.abs(reduced.right).max())

    def test_the_error_falls_with_every_point(self):
        model = damped()
        R, s = reducer(model), 2j * np.pi * np.linspace(*BAND, 41)
        D = np.zeros((41, 3), dtype=complex)
        exact, errors = direct_frf(model, s, D), []
        for frequency in (60.0, 380.0, 200.0):
            R.enrich(*R.lines.solve([frequency]))
            errors.append(relative(R.reduced().ports(s).evaluate(D), exact))
        assert errors[0] > 1.0
        assert errors[1] < 0.1 * errors[0]
        assert errors[2] < 0.1 * errors[1]
        assert errors[2] < 1e-3

    def test_near_dependent_directions_are_dropped(self):
        model = duplicate_terms()
        R = reducer(model)
        _, added = R.enrich(*R.lines.solve([100.0]))
        # Input, three outputs, three distinct terms, each with a real and an imaginary part.
        assert added <= 14
        assert R.enrich(*R.lines.solve([100.0]))[1] == 0


class TestCertificate:
    def test_held_out_lines_are_measured_and_no_expansion_points(self, reductions):
        model, reduction = reductions("damped")
        expanded = {step.frequency_hz for step in reduction.trace if step.order}
        assert not expanded & {line.frequency_hz for line in reduction.held_out}
        for line in reduction.held_out:
            assert set(line.errors) == {"free", "loose", "local", "clamped", "beyond", "random", "resonant"}
            s = np.array([2j * np.pi * line.frequency_hz])
            scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * BAND[1])
            exact = dense_ports(model, s, reduction.model.reference)
            ports = reduction.model.ports(s)
            for kind, Ds in measured_vectors(exact, model.terms, scale).items():
                measured = max(relative(ports.evaluate(D), exact.evaluate(D)) for D in Ds)
                assert line.errors[kind] == pytest.approx(measured, rel=1e-2, abs=1e-8)

    @pytest.mark.parametrize("name", MODELS)
    def test_the_estimate_is_of_the_size_of_the_error(self, name):
        """At lines that were never factorised: no line of the grid is out of tolerance, and the estimate knows how far it is."""
        model, input_of = MODELS[name](), inputs_of(name, MODELS[name]())
        R = Reducer(model, input_of, ReductionOptions(band_hz=BAND))
        assert R.run().reached
        grid = R.estimator.grid.lines_hz
        lines = np.flatnonzero(np.abs(grid[:, None] - np.array(R.enriched)).min(axis=1) > 0.01 * (BAND[1] - BAND[0]))[::2]
        s = 2j * np.pi * grid[lines]
        full, ports = dense_ports(model, s, R.problem.reference, input_of), R.reduced().ports(s)
        sweep, error = R.estimator.sweep(R.basis.projected()), np.zeros(lines.size)
        estimate = sweep.estimate[lines] + sweep.rounding[lines]
        for D in sweep.vectors:
            y, exact = ports.evaluate(D[lines]), full.evaluate(D[lines])
            for group in R.problem.quantities:
                size = np.linalg.norm(exact[:, group], axis=1)
                error = np.maximum(error, np.linalg.norm((y - exact)[:, group], axis=1) / np.where(size > 0, size, 1.0))
        assert error.max() < 1e-3
        # Too low would end the search early, too high only costs a point or two; a coupling errs on that side.
        high = {"vibro_acoustic": 600, "vibro_acoustic_unsymmetric": 1e5}.get(name, 40)
        assert 1 / 20 < estimate.max() / error.max() < high
        assert np.median(estimate / error) > 1 / 10

    def test_an_unreachable_tolerance_is_confessed(self):
        reduction = reduce_model(damped(), np.zeros(3, dtype=np.int64), ReductionOptions(band_hz=BAND, tolerance=1e-3, max_size=12))
        assert not reduction.reached
        assert reduction.worst > 1e-3
        assert len(reduction.held_out) >= 5
        tiny = reduce_model(damped(), np.zeros(3, dtype=np.int64), ReductionOptions(band_hz=BAND, tolerance=1e-16, max_points=6))
        assert not tiny.reached

    def test_a_finer_tolerance_is_reached_too(self):
        model = damped()
        reduction = reduce_model(model, one_input(model), ReductionOptions(band_hz=BAND, tolerance=1e-6))
        assert reduction.reached
        assert max(true_error(model, reduction, one_input(model)).values()) < 1e-6

    def test_more_lines_on_request(self):
        model = damped()
        assert len(reduce_model(model, one_input(model), ReductionOptions(band_hz=BAND, held_out=9)).held_out) == 9


def test_the_same_input_gives_the_same_basis():
    model = vibro_acoustic()
    first, second = (reduce_model(model, one_input(model), ReductionOptions(band_hz=BAND)) for _ in range(2))
    np.testing.assert_array_equal(first.model.K, second.model.K)
    np.testing.assert_array_equal(*([step.frequency_hz for step in reduction.trace] for reduction in (first, second)))


@pytest.mark.skipif(pardiso.library() is None, reason="MKL is not installed")
def test_back_ends_give_the_same_model():
    model, s = vibro_acoustic(), 2j * np.pi * np.linspace(*BAND, 33)
    found = [reduce_model(model, one_input(model), ReductionOptions(band_hz=BAND), backend=backend) for backend in ("superlu", "pardiso")]
    assert found[0].sizes == found[1].sizes
    D = np.zeros((33, 4), dtype=complex)
    assert relative(found[0].model.evaluate(s, D), found[1].model.evaluate(s, D)) < 1e-5


def test_progress_tells_every_factorisation():
    model, told = damped(), []
    reduction = reduce_model(model, one_input(model), ReductionOptions(band_hz=BAND), progress=told.append)
    assert len(told) == len(reduction.trace)
    assert sum("compressed" in text for text in told) == 1
    assert "expansion point" in told[0]
    assert "held out" in told[-1]


def test_the_trace_holds_the_estimate_after_each_change_of_the_basis(reductions):
    _, reduction = reductions("damped")
    changed = [step for step in reduction.trace if np.all(np.isfinite(step.estimate))]
    # Points, of which those solved side by side share the estimate of the last one, then the compression.
    points = [step for step in reduction.trace if step.order]
    lines = [step.frequency_hz for step in points[1:]]
    assert [step.frequency_hz for step in changed[:-1]] in (lines, lines[1:])
    assert np.isnan(changed[-1].frequency_hz)
    assert changed[-1].size == reduction.model.size
    for earlier, later in itertools.pairwise(changed[:-1]):
        assert later.estimate.max() < 0.3 * earlier.estimate.max()
    assert all(np.isnan(step.estimate).all() and step.measured_error is not None for step in reduction.trace[len(points) + 1 :])


class TestFullPorts:
    @pytest.mark.parametrize("name", ["damped", "unsymmetric", "vibro_acoustic", "several_inputs"])
    def test_the_reference_of_all_errors(self, name):
        model, s = MODELS[name](), 2j * np.pi * np.array([20.0, 133.0, 380.0])
        input_of = inputs_of(name, model)
        ports = full_ports(model, input_of, s, BAND)
        scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * BAND[1])
        for Ds in certificate_vectors(model.terms, scale, s).values():
            assert relative(ports.evaluate(Ds[0]), direct_frf(model, s, Ds[0], input_of)) < 1e-8

    @pytest.mark.parametrize("name", ["damped", "unsymmetric", "vibro_acoustic"])
    def test_unrefined_solutions_differ_by_far_less_than_a_thousandth_of_a_decibel(self, name):
        model, s = MODELS[name](), 2j * np.pi * np.array([20.0, 133.0, 380.0])
        refined, plain = (full_ports(model, inputs_of(name, model), s, BAND, refine=steps) for steps in (1, 0))
        D = refined.D_ref * 0.1
        assert relative(plain.evaluate(D), refined.evaluate(D)) < 1e-6

    @pytest.mark.parametrize("refine", [0, 1])
    def test_a_singular_line_is_refused_with_and_without_refinement(self, refine):
        """Two masses of 1 kg with a spring of 0.5 N/m between them: the pivot at 1 rad/s is exactly zero."""
        pieces = {"loads": unit(2, 0), "outputs": unit(2, 1), "left": csc(np.zeros((2, 0))), "damping": (0.0, 0.0)}
        free = fe_model(csc(np.array([[0.5, -0.5], [-0.5, 0.5]])), csc(np.eye(2)), **pieces)
        with pytest.raises(NumericalError):
            full_ports(free, one_input(free), np.array([1j]), BAND, refine=refine)


@pytest.mark.slow
def test_the_low_decades_of_a_wide_band_are_certified_too(monkeypatch):
    """Four decades: evenly spaced lines alone would see the lowest two not at all."""
    band = (1.0, 20000.0)
    model = damped()
    lines = np.geomspace(*band, 60)
    s = 2j * np.pi * lines
    exact = full_ports(model, one_input(model), s, band)
    scale = local_scale(model.K, model.M, model.terms, 2 * np.pi * band[1])

    def errors() -> tuple[Reduction, np.ndarray]:
        found = reduce_model(model, one_input(model), ReductionOptions(band_hz=band))
        near, rows = found.model.ports(s, workers=1), np.arange(model.L.shape[0])
        at = [np.array([i]) for i in range(lines.size)]
        return found, np.array([max(port_errors(model, scale, exact.select(i, rows), near.select(i, rows)).values()) for i in at])

    found, error = errors()
    assert found.reached
    assert error.max() <= 1e-3
    assert np.mean(error <= found.unseen) >= 0.95
    monkeypatch.setattr(grid, "WIDE_BAND", np.inf)
    assert errors()[1].max() > 1e-3


def test_a_frequency_that_stands_for_a_band_is_one_of_the_mesh():
    model = damped()
    assert band_omega(model.K, model.M, (1.0, 400.0)) == pytest.approx(2 * np.pi * 400)
    top = np.sqrt(np.max(model.K.diagonal() / model.M.diagonal()))
    assert band_omega(model.K, model.M, (1.0, 1e12)) == pytest.approx(2 * top)
    assert band_omega(model.K, 0 * model.M, (1.0, 400.0)) == pytest.approx(2 * np.pi * 400)


def test_points_after_the_first_check_the_basis_before_them():
    found = reduce_model(damped(), one_input(damped()), ReductionOptions(band_hz=BAND))
    points = [step for step in found.trace if step.order]
    errors = [step.measured_error for step in points]
    assert errors[0] is None
    assert all(error is not None and error > 0 for error in errors[1:])
    assert errors[-1] <= errors[1]
