"""The port formula against direct solves, its derivatives against finite differences, from free to clamped."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from derivatives import check_derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from systems import beam, chain, csc, dense_ports, direct_frf, duct, fe_model, random_vectors, relative, unit

from lrbc_cli.reduction import threads
from lrbc_cli.reduction.reduced.ports import _sensors, port_frf
from lrbc_cli.reduction.threads import by_lines, in_chunks, in_turn, side_by_side

S = 2j * np.pi * np.array([13.0, 55.5, 121.0, 240.0, 333.3])


def edge_model():
    """Beam with rotational springs at both ends and two deflection springs, well damped."""
    K, M = beam(20)
    n = K.shape[0]
    return fe_model(K, M, loads=unit(n, 5), outputs=unit(n, 9, 31), left=unit(n, 0, 11, 25, n - 1), damping=(4.0, 2e-5))


def mixed_model():
    """Stiffness, damping and mass terms with unlike left and right vectors, two inputs, all kinds of responses, a baseline."""
    K, M = chain(30)
    rng = np.random.default_rng(4)
    return fe_model(
        K, M, loads=random_vectors(30, 2, rng), outputs=random_vectors(30, 4, rng), left=random_vectors(30, 6, rng),
        right=random_vectors(30, 6, rng), power=[0, 1, 2, 0, 1, 2], baseline=[0, 0, 0, 900.0, 2.0, 0.01],
        damping=(5.0, 3e-6), output_power=[0, 1, 2, 2],
    )  # fmt: skip


def coupled_model():
    """u-p model whose terms sit on structure and air."""
    K, M, acoustic = duct(20, 40, 1.2)
    left = csc(np.hstack([unit(60, 0, 7, 15).toarray(), unit(60, 33).toarray() * 1e-2]))
    return fe_model(K, M, loads=unit(60, 4), outputs=unit(60, 25, 59), left=left, is_acoustic=acoustic, damping=(4.0, 1e-5))


MODELS = {f.__name__: f for f in (edge_model, mixed_model, coupled_model)}
INPUTS = {"edge_model": [0, 0], "mixed_model": [0, 1, 1, 0], "coupled_model": [0, 0]}


def sizes(model):
    """Value of each term as strong as the structure it acts on, in its own unit, at 100 Hz."""
    b, c = model.terms.left.toarray(), model.terms.right.toarray()
    diagonal = np.abs(model.K.diagonal())[:, None]
    flexible = np.sqrt(np.sum(b**2 / diagonal, axis=0) * np.sum(c**2 / diagonal, axis=0))
    return 1 / flexible / (2 * np.pi * 100.0) ** model.terms.power


def values(model, decades):
    """D(s) a number of decades above the local size."""
    return 10.0**decades * sizes(model) * S[:, None] ** model.terms.power


def rounding(model, *D):
    """(F,) what a solve may lose by rounding: eps times the condition of Z with rows and columns of one size, times the root of n.

    The worst of Z with each of the values, the free one included; and what the formula itself may lose.
    """
    K, C, M, b, c = (X.toarray() for X in (model.K, model.C, model.M, model.terms.left, model.terms.right))
    out = np.zeros(S.size)
    for value in (np.zeros((S.size, model.terms.size)), *D):
        for line, z in enumerate(S):
            Z = z**2 * M + z * C + K + (b * value[line]) @ c.T
            weight = 1.0 / np.sqrt(np.abs(Z).max(axis=1))
            out[line] = max(out[line], np.linalg.cond(weight[:, None] * Z * weight))
    return np.sqrt(model.size) * np.finfo(float).eps * out + 1e-11


def errors(found, expected):
    """(F,) error of each line relative to its norm over the responses."""
    return np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)


@pytest.fixture(params=MODELS)
def case(request):
    return MODELS[request.param](), np.array(INPUTS[request.param])


@pytest.mark.parametrize("about", ["free", "local"])
@pytest.mark.parametrize("decades", [-np.inf, -6.0, -2.0, 0.0, 2.0, 4.0, 7.0, 10.0, np.inf])
def test_formula_against_direct_solves(case, about, decades):
    """The same accuracy from free to clamped, whatever the reference."""
    model, input_of = case
    reference = np.zeros((model.terms.size, 3))
    if about == "local":
        reference[np.arange(model.terms.size), model.terms.power] = sizes(model)
        reference[:, 1] += 1e-4 * sizes(model) * (model.terms.power == 0)
    D = values(model, decades) if np.isfinite(decades) or decades < 0 else np.full((S.size, model.terms.size), np.inf + 0j)
    if decades < 0 and not np.isfinite(decades):
        D = np.zeros((S.size, model.terms.size), dtype=complex)
    ports = dense_ports(model, S, reference, input_of)
    assert np.all(errors(ports.evaluate(D), direct_frf(model, S, D, input_of)) < rounding(model, ports.D_ref))


def test_baseline_frees_what_the_matrices_contain(case):
    """D = -baseline: the same as matrices without these terms."""
    model, input_of = case
    base = 0.3 * sizes(model)
    b, c, q = model.terms.left, model.terms.right, model.terms.power
    K, C, M = (csc(X + (b * np.where(q == power, base, 0.0)[None, :]) @ c.T) for power, X in enumerate((model.K, model.C, model.M)))
    bare = direct_frf(model, S, np.zeros((S.size, base.size)), input_of)
    stiffened = fe_model(K, M, C=C, loads=model.B, outputs=csc(model.L.T), left=b, right=c, power=q, output_power=model.output_power)
    ports = dense_ports(stiffened, S, None, input_of)
    assert relative(ports.evaluate(-base * S[:, None] ** q), bare) < 1e-10


@given(st.integers(0, 2**31))
@settings(max_examples=25, deadline=None)
def test_any_mixture_of_values_and_references(seed):
    rng = np.random.default_rng(seed)
    model, input_of = mixed_model(), np.array(INPUTS["mixed_model"])
    reference = np.zeros((6, 3))
    reference[np.arange(6), model.terms.power] = sizes(model) * 10.0 ** rng.uniform(-3, 2, size=6) * rng.integers(0, 2, size=6)
    D = sizes(model) * 10.0 ** rng.uniform(-5, 7, size=6) * S[:, None] ** model.terms.power * (1 + 0.2j * rng.uniform(size=6))
    D[:, rng.integers(0, 6)] = np.inf
    exact = direct_frf(model, S, D, input_of)
    # A line where the responses nearly vanish would measure the reference solves, not the formula.
    assert relative(dense_ports(model, S, reference, input_of).evaluate(D), exact) < 1e-8


@given(st.integers(0, 2**31))
@settings(max_examples=25, deadline=None)
def test_a_change_of_few_terms(seed):
    """About a state, a system of the changed terms alone gives what all terms give."""
    rng = np.random.default_rng(seed)
    model, input_of = mixed_model(), np.array(INPUTS["mixed_model"])
    ports = dense_ports(model, S, None, input_of)
    D = sizes(model) * 10.0 ** rng.uniform(-2, 2, size=6) * S[:, None] ** model.terms.power
    terms = np.sort(rng.permutation(6)[: rng.integers(0, 7)])
    other = D.copy()
    other[:, terms] *= 10.0 ** rng.uniform(-3, 2, size=terms.size)
    assert relative(ports.about(D).among(terms).evaluate(other[:, terms]), ports.evaluate(other)) < 1e-9
    assert relative(ports.about(D).evaluate(other), ports.evaluate(other)) < 1e-9
    # From state to state, only the terms that differ are solved for.
    near, back = ports.about(D).about(other), ports.about(D).about(other).about(D)
    assert relative(near.evaluate(D), ports.evaluate(D)) < 1e-9
    for own, at in ((near, other), (back, D)):
        for mine, direct in ((own.Hpp, ports.about(at).Hpp), (own.H0p, ports.about(at).H0p), (own.Hp0, ports.about(at).Hp0)):
            assert relative(mine, direct) < 1e-8


@pytest.mark.parametrize("decades", [-3.0, 0.0, 3.0, 8.0])
def test_the_reference_does_not_matter(case, decades):
    model, input_of = case
    D = values(model, decades)
    found = []
    for factor in (0.0, 1e-2, 1.0, 30.0):
        reference = np.zeros((model.terms.size, 3))
        reference[np.arange(model.terms.size), model.terms.power] = factor * sizes(model)
        ports = dense_ports(model, S, reference, input_of)
        slopes = ports.linearise(D)[1] * D[:, None, :]
        found.append(np.concatenate([ports.evaluate(D), slopes.reshape(S.size, -1)], axis=1))
    for other in found[1:]:
        assert relative(other, found[0]) < 1e-8


class TestLinearise:
    @pytest.mark.parametrize("decades", [-2.0, 0.0, 2.0])
    @pytest.mark.parametrize("about", [0.0, 1.0])
    def test_taylor(self, case, decades, about):
        """Second-order remainder for every term alone, in complex directions."""
        model, input_of = case
        reference = np.zeros((model.terms.size, 3))
        reference[np.arange(model.terms.size), model.terms.power] = about * sizes(model)
        ports, D = dense_ports(model, S, reference, input_of), values(model, decades)
        y, dy = ports.linearise(D)
        np.testing.assert_allclose(y, ports.evaluate(D), rtol=1e-11, atol=1e-13 * np.abs(y).max())
        for j in range(model.terms.size):
            step = D[:, j] * np.exp(0.7j)

            def changed(x, j=j, step=step):
                moved = D.copy()
                moved[:, j] += x[0] * step
                out = ports.evaluate(moved) / np.abs(y).max(axis=1, keepdims=True)
                return np.concatenate([out.real.ravel(), out.imag.ravel()])

            slope = (dy[:, :, j] * step[:, None] / np.abs(y).max(axis=1, keepdims=True)).ravel()
            check_derivative(changed, np.concatenate([slope.real, slope.imag])[:, None], np.zeros(1), np.ones(1), first=0.2)

    def test_against_direct_central_differences(self, case):
        """No formula shared: the derivative of direct dense solves."""
        model, input_of = case
        D = values(model, 0.5)
        dy = dense_ports(model, S, None, input_of).linearise(D)[1]
        for j in range(model.terms.size):
            h = 1e-4 * D[:, j]
            up, down = D.copy(), D.copy()
            up[:, j] += h
            down[:, j] -= h
            slope = (direct_frf(model, S, up, input_of) - direct_frf(model, S, down, input_of)) / (2 * h[:, None])
            assert relative(dy[:, :, j], slope) < 1e-6

    def test_unsymmetric_ports_have_their_own_transposed_solve(self):
        model = mixed_model()
        assert not dense_ports(model, S, None, np.array(INPUTS["mixed_model"])).symmetric
        assert dense_ports(edge_model(), S).symmetric

    def test_clamped_terms_have_no_slope(self):
        model = edge_model()
        D = values(model, 1.0)
        D[:, 2] = np.inf
        y, dy = dense_ports(model, S).linearise(D)
        assert np.all(errors(y, direct_frf(model, S, D)) < rounding(model))
        assert np.abs(dy[:, :, 2] * sizes(model)[2]).max() < 1e-20 * np.abs(y).max()
        assert np.all(np.isfinite(dy))


def test_drive_gives_the_forces_of_the_terms():
    """u = -(D - D_ref) cᵀ x, with x from a direct solve."""
    model = edge_model()
    D = values(model, 1.0)
    y, u = dense_ports(model, S).drive(D)
    K, C, M, b = (X.toarray() for X in (model.K, model.C, model.M, model.terms.left))
    for line, z in enumerate(S):
        x = np.linalg.solve(z**2 * M + z * C + K + (b * D[line]) @ b.T, model.B.toarray())
        expected = -D[line][:, None] * (b.T @ x)
        assert np.abs(u[line] - expected).max() < rounding(model, D)[line] * np.abs(expected).max()
    assert np.all(errors(y, direct_frf(model, S, D)) < rounding(model, D))


class TestDependentTerms:
    """The same DOF named twice, or more segment vectors than DOFs."""

    def model(self):
        K, M = beam(20)
        n = K.shape[0]
        left = csc(np.hstack([unit(n, 0, 0, 11).toarray(), unit(n, 0).toarray() + unit(n, 11).toarray()]))
        return fe_model(K, M, loads=unit(n, 5), outputs=unit(n, 9, 31), left=left, damping=(4.0, 2e-5))

    def independent(self):
        K, M = beam(20)
        n = K.shape[0]
        return fe_model(K, M, loads=unit(n, 5), outputs=unit(n, 9, 31), left=unit(n, 0, 11), damping=(4.0, 2e-5))

    @pytest.mark.parametrize("decades", [-3.0, 0.0, 3.0, 6.0, 9.0])
    def test_finite_values(self, decades):
        model = self.model()
        assert relative(dense_ports(model, S).evaluate(values(model, decades)), direct_frf(model, S, values(model, decades))) < 1e-7

    def test_clamped(self):
        found = dense_ports(self.model(), S).evaluate(np.full((S.size, 4), np.inf + 0j))
        expected = direct_frf(self.independent(), S, np.full((S.size, 2), np.inf + 0j))
        assert relative(found, expected) < 1e-7


def test_select_is_the_same_for_fewer_lines_and_responses():
    model, input_of = mixed_model(), np.array(INPUTS["mixed_model"])
    ports = dense_ports(model, S, None, input_of)
    lines, rows = np.array([3, 0]), np.array([2, 1])
    part = ports.select(lines, rows)
    D = values(model, 0.0)
    y, dy = ports.linearise(D)
    y_part, dy_part = part.linearise(D[lines])
    np.testing.assert_allclose(y_part, y[np.ix_(lines, rows)], rtol=1e-12)
    np.testing.assert_allclose(dy_part, dy[np.ix_(lines, rows)], rtol=1e-11)
    assert part.lines == 2
    np.testing.assert_allclose(part.frequency_hz, [240.0, 13.0])


def test_responses_of_one_sensor_share_a_solve():
    """Three sensors under two inputs are six responses, in any order: three rows, and figures as if each had a row of its own."""
    K, M = chain(30)
    rng = np.random.default_rng(7)
    sensors, loads = random_vectors(30, 3, rng), random_vectors(30, 2, rng)
    outputs, input_of = sensors[:, [0, 1, 2, 1, 0, 2]], np.array([0, 0, 1, 1, 1, 0])
    model = fe_model(
        K, M, loads=loads, outputs=outputs, left=random_vectors(30, 4, rng), damping=(5.0, 3e-6), output_power=[2, 2, 2, 2, 2, 1]
    )
    ports = dense_ports(model, S, None, input_of)
    # The last response is the velocity of sensor 2: another row.
    np.testing.assert_array_equal(ports.heard, [0, 1, 2, 5])
    np.testing.assert_array_equal(ports.output_of, [0, 1, 2, 1, 0, 3])
    every, D = np.arange(6), values(model, 0.3)
    apart = replace(ports, heard=every, output_of=every)
    for one, other in (
        (ports, apart),
        (ports.select(np.array([4, 1]), np.array([4, 0, 3])), apart.select(np.array([4, 1]), np.array([4, 0, 3]))),
    ):
        own = D[[4, 1]] if one.lines == 2 else D
        for found, expected in zip(one.linearise(own), other.linearise(own), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14 * np.abs(expected).max())
        np.testing.assert_allclose(one.evaluate(own), other.evaluate(own), rtol=1e-12)
    assert ports.select(every[:2], np.array([4, 0, 3])).heard.tolist() == [0, 2]
    assert np.all(errors(ports.evaluate(D), direct_frf(model, S, D, input_of)) < rounding(model, D))


def test_rows_that_differ_at_one_line_are_of_two_sensors():
    ports = dense_ports(mixed_model(), S, None, np.array(INPUTS["mixed_model"]))
    H0p = ports.H0p.copy()
    H0p[:, 1] = H0p[:, 0]
    assert _sensors(H0p)[0].tolist() == [0, 2, 3]
    H0p[3, 1, 2] *= 1.0 + 1e-8
    assert _sensors(H0p)[0].tolist() == [0, 1, 2, 3]


def test_no_terms():
    K, M = chain(8)
    model = fe_model(K, M, loads=unit(8, 0), outputs=unit(8, 7), left=csc(np.zeros((8, 0))), damping=(3.0, 1e-6))
    ports = dense_ports(model, S)
    y, dy = ports.linearise(np.zeros((S.size, 0), dtype=complex))
    assert relative(y, direct_frf(model, S, np.zeros((S.size, 0)))) < 1e-12
    assert dy.shape == (S.size, 1, 0)


@pytest.mark.parametrize("skew", [0.0, 0.125])
def test_a_term_that_alone_holds_a_motion_is_set_free(skew):
    """What nothing drives does not stop the rest, though its own equation is zero: exactly so, with these powers of two."""
    held, value = 4.0, np.array([[0.0, 6.0]], dtype=complex)
    H = np.array([[[1.0, 0.0, 0.5], [0.0, 1 / held, 0.0], [0.5 + skew, 0.0, 2.0]]], dtype=complex)
    s, q, one = np.array([1j]), np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
    ports = port_frf(H, s, np.array([[held, 1.0]], dtype=complex), q, one)
    rest = port_frf(H[:, ::2, ::2], s, np.ones((1, 1), dtype=complex), q, one)
    (y, dy), (expected, slope) = ports.linearise(value), rest.linearise(value[:, 1:])
    np.testing.assert_allclose(y, expected, rtol=1e-14)
    np.testing.assert_allclose(ports.evaluate(value), expected, rtol=1e-14)
    np.testing.assert_allclose(dy, np.concatenate([np.zeros((1, 1, 1)), slope], axis=2), rtol=1e-14)
    # One that is driven has no answer.
    H[0, 1, 0] = 0.25
    with pytest.raises(np.linalg.LinAlgError):
        port_frf(H, s, ports.D_ref, q, one).evaluate(value)


def test_nearly_symmetric_ports_are_made_so_and_others_kept():
    H = np.ones((1, 3, 3), dtype=complex)
    H[0, 1:, 1:] = [[2.0, 1.0 + 1e-12], [1.0, 3.0]]
    kept = H.copy()
    kept[0, 1, 2] = 1.1
    pieces = (np.array([1j]), np.zeros((1, 2), dtype=complex), np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64))
    assert port_frf(H, *pieces).symmetric
    np.testing.assert_array_equal(port_frf(H, *pieces).Hpp, port_frf(H, *pieces).Hpp.transpose(0, 2, 1))
    assert not port_frf(kept, *pieces).symmetric
    assert port_frf(kept, *pieces).Hpp[0, 0, 1] == 1.1


@pytest.mark.parametrize(("count", "workers"), [(0, 2), (1, 2), (16, 2), (17, 2), (50, 1), (50, 3)])
def test_chunks_cover_every_line_once(count, workers):
    seen = np.zeros(count, dtype=int)

    def work(part):
        seen[part] += 1

    in_chunks(count, work, workers=workers)
    assert np.all(seen == 1)


def test_a_failure_in_a_chunk_is_not_swallowed():
    def work(part):
        raise FloatingPointError("line")

    with pytest.raises(FloatingPointError):
        in_chunks(40, work)


def solved(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Line by line, as the port formula does."""
    found = np.empty(B.shape, dtype=complex)

    def work(part: slice) -> None:
        found[part] = np.linalg.solve(A[part], B[part])

    by_lines(A.shape[0], A.shape[1], 1, work)
    return found


class TestThreads:
    """Lines solved by several threads, in slices that a cache holds, are those of one."""

    @pytest.mark.parametrize("cores", [2, 5])
    @pytest.mark.parametrize("cached", [1, 9 * 9 * 16 * 4, 2_000_000])
    @pytest.mark.parametrize("threaded", [0.0, 2.5e4, 1e9])
    def test_the_same_to_the_last_bit(self, cached: int, threaded: float, cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
        rng = np.random.default_rng(0)
        A, B = (rng.normal(size=(41, 9, k)) + 1j * rng.normal(size=(41, 9, k)) for k in (9, 3))
        expected = np.linalg.solve(A, B)
        monkeypatch.setattr(threads, "THREADED", threaded)
        monkeypatch.setattr(threads, "CACHED", cached)
        monkeypatch.setattr(threads, "cores", lambda: cores)
        np.testing.assert_array_equal(solved(A, B), expected)

    @pytest.mark.parametrize("lines", [0, 1, 2])
    def test_few_lines(self, lines: int, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(threads, "THREADED", 0.0)
        A, B = np.tile(2.0 * np.eye(5, dtype=complex), (lines, 1, 1)), np.ones((lines, 5, 1), dtype=complex)
        np.testing.assert_array_equal(solved(A, B), 0.5 * B)

    @pytest.mark.parametrize("line", [0, 40])
    def test_a_singular_line_is_told(self, line: int, monkeypatch: pytest.MonkeyPatch) -> None:
        A = np.tile(np.eye(5, dtype=complex), (41, 1, 1))
        A[line] = 0.0
        monkeypatch.setattr(threads, "THREADED", 0.0)
        with pytest.raises(np.linalg.LinAlgError):
            solved(A, np.ones((41, 5, 1), dtype=complex))

    def test_the_caller_sets_what_is_an_error_on_lines(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(threads, "THREADED", 0.0)

        def work(part: slice) -> None:
            np.float64(1.0) / np.zeros(1)

        with np.errstate(divide="raise"), pytest.raises(FloatingPointError):
            by_lines(4, 3, 1, work)

    @pytest.mark.parametrize("cores", [2, 4])
    def test_pieces_of_work_side_by_side(self, cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(threads, "THREADED", 0.0)
        monkeypatch.setattr(threads, "cores", lambda: cores)
        rng = np.random.default_rng(1)
        A = rng.normal(size=(7, 40, 6, 6)) + 0j
        expected = np.linalg.solve(A, np.ones((7, 40, 6, 1)))
        begun = threading.active_count()

        def work(k: int) -> tuple[np.ndarray, int]:
            with np.errstate(divide="raise"):
                return solved(A[k], np.ones((40, 6, 1), dtype=complex)), threading.active_count()

        found = side_by_side(work, range(7))
        np.testing.assert_array_equal([x for x, _ in found], expected)
        # What one of them solves does not begin threads of its own.
        assert max(count for _, count in found) <= begun + cores

    def test_jobs_share_the_cores(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Three jobs on eight cores use two threads each; what they run side by side uses one."""
        monkeypatch.setattr(threads, "cores", lambda: 8)

        def job(_: int) -> tuple[int, list[int]]:
            return threads.threads(), side_by_side(lambda _: threads.threads(), range(3))

        with threads.sharing(3) as pool:
            assert list(pool.map(job, range(5))) == [(2, [1, 1, 1])] * 5
        assert threads.threads() == 8
        with threads.at_most(2), threads.sharing(4) as pool:
            assert pool.submit(threads.threads).result() == 1
        with threads.at_most(0):
            assert threads.threads() == 1

    def test_the_caller_sets_what_is_an_error(self) -> None:
        with np.errstate(divide="raise"), pytest.raises(FloatingPointError):
            side_by_side(lambda value: np.float64(1.0) / value, [np.float64(0.0)] * 3)

    @pytest.mark.parametrize("lines", [False, True])
    def test_threads_leave_what_another_ignores(self, lines: bool, monkeypatch: pytest.MonkeyPatch) -> None:
        """NumPy 1 counts the threads with other settings; work begun elsewhere made a division by zero a warning here."""
        monkeypatch.setattr(threads, "cores", lambda: 4)
        monkeypatch.setattr(threads, "THREADED", 0.0)

        def elsewhere() -> None:
            if lines:
                by_lines(8, 3, 1, lambda _: None)
            else:
                side_by_side(str, range(4))

        with np.errstate(divide="ignore"):
            for _ in range(3):
                other = threading.Thread(target=elsewhere)
                other.start()
                other.join()
            assert np.log10(np.zeros(1)) == -np.inf

    def test_a_failure_ends_what_has_not_begun(self) -> None:
        done = []

        def work(k: int) -> None:
            done.append(k)
            if k == 0:
                raise KeyboardInterrupt
            time.sleep(0.05)

        with pytest.raises(KeyboardInterrupt):
            side_by_side(work, range(100))
        assert len(done) < 10

    def test_in_turn_nothing_is_side_by_side(self) -> None:
        with in_turn():
            assert len(set(side_by_side(lambda _: threading.get_ident(), range(5)))) == 1
