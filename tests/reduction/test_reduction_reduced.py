"""The reduced dynamic stiffness (28), (32) and the port FRFs: two formulas that share nothing and must agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from derivatives import check_derivative
from samples import reduced_sample, sample
from scipy.signal import find_peaks
from systems import beam, chain, csc, dense_ports, direct_frf, fe_model, random_vectors, relative, unit, whole

from lrbc_cli.reduction.problem.vectors import certificate_vectors
from lrbc_cli.reduction.reduced import condense
from lrbc_cli.reduction.reduced.condense import CondensedAir
from lrbc_cli.reduction.reduced.model import ReducedModel, reference_dynamic

S = 2j * np.pi * np.array([13.0, 55.5, 121.0, 240.0, 333.3])


def unreduced(model, input_of=None, reference=None) -> ReducedModel:
    """A 'reduced' model on the whole space: its formulas can be compared with direct solves."""
    given = {name: value for name, value in (("input_of", input_of), ("reference", reference)) if value is not None}
    return whole(model, structure=model.size, **given)


def edge():
    K, M = beam(12)
    n = K.shape[0]
    return fe_model(K, M, loads=unit(n, 5), outputs=unit(n, 9, 17), left=unit(n, 0, 11, n - 1), damping=(4.0, 2e-5))


def mixed():
    K, M = chain(25)
    rng = np.random.default_rng(4)
    return fe_model(
        K, M, loads=random_vectors(25, 2, rng), outputs=random_vectors(25, 3, rng), left=random_vectors(25, 4, rng),
        right=random_vectors(25, 4, rng), power=[0, 1, 2, 0], damping=(5.0, 3e-6), output_power=[0, 1, 2],
    )  # fmt: skip


def scale_of(model):
    """A value of the order of the structure's own, by kind of term."""
    return np.abs(model.K.diagonal()).mean() / (2 * np.pi * 100.0) ** model.terms.power


CASES = [pytest.param(edge, np.array([0, 0]), id="edge"), pytest.param(mixed, np.array([0, 1, 1]), id="mixed")]


@pytest.mark.parametrize(("make", "input_of"), CASES)
@pytest.mark.parametrize("decades", [-np.inf, -3.0, 0.0, 1.5, 3.0, 7.0, 12.0, np.inf])
def test_dynamic_stiffness_against_direct_solves(make, input_of, decades):
    model = make()
    D = np.full((S.size, model.terms.size), np.inf + 0j)
    if decades < np.inf:
        D = 10.0**decades * scale_of(model) * S[:, None] ** model.terms.power
    found = unreduced(model, input_of).evaluate(S, D)
    assert relative(found, direct_frf(model, S, D, input_of)) < 1e-9


@pytest.mark.parametrize(("make", "input_of"), CASES)
@pytest.mark.parametrize("decades", [-1.0, 0.0, 1.5, 4.0])
def test_derivatives(make, input_of, decades):
    """Taylor remainders, where terms are assembled and where they keep their force as an unknown."""
    model = make()
    D = 10.0**decades * scale_of(model) * S[:, None] ** model.terms.power
    reduced = unreduced(model, input_of)
    y, dy = reduced.linearise(S, D)
    size = np.abs(y).max(axis=1, keepdims=True)
    np.testing.assert_allclose(y, reduced.evaluate(S, D), rtol=1e-12)
    rng = np.random.default_rng(1)
    step = D * rng.normal(size=model.terms.size)

    def changed(x):
        out = reduced.evaluate(S, D + x[0] * step) / size
        return np.concatenate([out.real.ravel(), out.imag.ravel()])

    slope = np.einsum("frt,ft->fr", dy, step) / size
    if decades < 3:
        check_derivative(changed, np.concatenate([slope.real.ravel(), slope.imag.ravel()])[:, None], np.zeros(1), np.ones(1), first=0.1)
    # The same derivatives from the port formula.
    _, dy_port = dense_ports(model, S, None, input_of).linearise(D)
    assert relative((dy * D[:, None]).reshape(S.size, -1), (dy_port * D[:, None]).reshape(S.size, -1)) < 1e-7


@pytest.mark.parametrize(("make", "input_of"), CASES)
def test_transfer_is_the_extended_system(make, input_of):
    model = make()
    reference = np.array([[1.0, 1e-4, 1e-6]]) * scale_of(model)[:, None]
    reduced = unreduced(model, input_of, reference)
    K, C, M, b, c = (X.toarray() for X in (model.K, model.C, model.M, model.terms.left, model.terms.right))
    D = reference_dynamic(reference, S)
    np.testing.assert_allclose(D[1], reference[:, 0] + S[1] * reference[:, 1] + S[1] ** 2 * reference[:, 2], rtol=1e-14)
    expected = [
        model.outputs.toarray() @ np.linalg.solve(z**2 * M + z * C + K + (b * d) @ c.T, model.inputs.toarray())
        for z, d in zip(S, D, strict=True)
    ]
    np.testing.assert_allclose(reduced.transfer(S), expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_clamping_dependent_terms():
    K, M = beam(12)
    n = K.shape[0]
    pieces = {"loads": unit(n, 5), "outputs": unit(n, 9, 17), "damping": (4.0, 2e-5)}
    dependent = fe_model(K, M, left=csc(np.hstack([unit(n, 0, 0, 11).toarray(), unit(n, 0).toarray() + unit(n, 11).toarray()])), **pieces)
    independent = fe_model(K, M, left=unit(n, 0, 11), **pieces)
    found = unreduced(dependent).evaluate(S, np.full((S.size, 4), np.inf + 0j))
    assert relative(found, direct_frf(independent, S, np.full((S.size, 2), np.inf + 0j))) < 1e-7


def test_with_reference_changes_nothing_but_the_ports():
    model = edge()
    first = unreduced(model)
    second = replace(first, reference=np.array([[1.0, 1e-4, 0.0]]) * scale_of(model)[:, None])
    D = 2.0 * scale_of(model) * np.ones((S.size, 3), dtype=complex)
    np.testing.assert_array_equal(first.evaluate(S, D), second.evaluate(S, D))
    assert relative(second.ports(S).evaluate(D), first.ports(S).evaluate(D)) < 1e-9
    assert np.abs(second.ports(S).H00 - first.ports(S).H00).max() > 1e-3 * np.abs(first.ports(S).H00).max()


@pytest.fixture(scope="module")
def box():
    return reduced_sample("soundbox").model


@pytest.fixture(scope="module")
def box_lines(box):
    """Fifteen lines over the band, and the resonances of the base system found to a ten-thousandth of a hertz."""
    coarse = np.linspace(20.0, 400.0, 1500)

    def level(hz):
        return np.log(np.abs(box.ports(2j * np.pi * hz).H00)).mean(axis=1)

    peaks, _ = find_peaks(level(coarse), prominence=0.5)
    assert peaks.size >= 12
    at, width = coarse[peaks], coarse[1] - coarse[0]
    for _ in range(4):
        fine = at[:, None] + np.linspace(-width, width, 21)
        at = fine[np.arange(at.size), level(fine.ravel()).reshape(fine.shape).argmax(axis=1)]
        width /= 10
    return 2j * np.pi * np.sort(np.concatenate([np.linspace(20.0, 400.0, 15), at]))


@pytest.mark.slow
class TestSoundBox:
    """The figure that the campaign's results stand on: 1e-8 between the formulas, also on resonances."""

    @staticmethod
    def vectors(s):
        inputs = sample("soundbox")
        scale = np.full(inputs.model.terms.size, 10.0)
        chosen = certificate_vectors(inputs.model.terms, scale, s, count=4)
        named = {kind: D for kind, Ds in chosen.items() for D in Ds[:1]} | {f"random {i}": D for i, D in enumerate(chosen["random"])}
        for decades in range(0, 8):
            named[f"1e{decades}"] = np.full((s.size, scale.size), 10.0**decades, dtype=complex)
        return named

    def test_values(self, box, box_lines):
        s = box_lines
        ports = box.ports(s)
        worst = {name: relative(ports.evaluate(D), box.evaluate(s, D)) for name, D in self.vectors(s).items()}
        assert max(worst.values()) < 1e-8, worst

    @pytest.mark.parametrize(("damping", "limit"), [(1.0, 1e-8), (0.01, 5e-7)])
    def test_exactly_on_the_resonances_of_the_base(self, box, damping, limit):
        """Undamped natural frequencies of the base, its reference without loss factor; digits go with the damping and not faster."""
        bare = replace(box, reference=box.reference * np.array([1.0, 0.0, 0.0]))
        light = ReducedModel(**{**bare.__dict__, "C": damping * np.asarray(bare.C)})
        w2 = np.linalg.eigvals(np.linalg.solve(light.M, light.K + (light.left * light.reference[:, 0]) @ light.right.T))
        hz = np.sort(np.sqrt(np.abs(w2.real))) / (2 * np.pi)
        at = 2j * np.pi * hz[(hz > 20) & (hz < 400)]
        assert at.size >= 12
        ports = light.ports(at)
        worst = {name: relative(ports.evaluate(D), light.evaluate(at, D)) for name, D in self.vectors(at).items()}
        assert max(worst.values()) < limit, worst

    @pytest.mark.parametrize("value", [1.0, 1e2, 1e4])
    def test_gradients(self, box, box_lines, value):
        """Compared as the optimiser uses them: per decade of stiffness, relative to the line's FRFs."""
        rng, s = np.random.default_rng(3), box_lines
        D = value * 10.0 ** rng.uniform(-1, 1, size=box.terms) * (1 + 1e-4 * s[:, None])
        (y, dy), (y0, dy0) = box.ports(s).linearise(D), box.linearise(s, D)
        assert relative(y, y0) < 1e-8
        slopes, slopes0 = dy * D[:, None], dy0 * D[:, None]
        error = np.linalg.norm(slopes - slopes0, axis=(1, 2))
        assert np.max(error / np.linalg.norm(slopes0, axis=(1, 2))) < 1e-7
        assert np.max(error / np.linalg.norm(y0, axis=1)) < 1e-8

    def test_the_reference_does_not_matter(self, box, box_lines):
        s = box_lines
        D = np.full((s.size, box.terms), 300.0, dtype=complex)
        other = replace(box, reference=np.array([[40.0, 1e-2, 0.0]]) * np.ones((box.terms, 1)))
        assert relative(other.ports(s).evaluate(D), box.ports(s).evaluate(D)) < 1e-8


def in_air(symmetric: bool, lossy: bool, viscous: bool, rng: np.random.Generator) -> tuple:
    """K, C, M (r, r) with a diagonal air behind the structure, and left and right vectors of terms on the structure."""
    ns, na, nt = 7, 5, 3

    def block(rows: int, columns: int) -> np.ndarray:
        return rng.standard_normal((rows, columns))

    operators = [np.zeros((ns + na, ns + na), dtype=complex if lossy else float) for _ in range(3)]
    for A, size in zip(operators, (1e6, 10.0, 1.0), strict=True):
        own = block(ns, ns)
        A[:ns, :ns] = size * (own @ own.T if symmetric else own)
        A[ns:, ns:] = np.diag(size * rng.uniform(0.5, 2.0, na))
    coupling = 1e3 * block(ns, na)
    K, C, M = operators
    K[:ns, ns:], M[ns:, :ns] = -coupling, 1.2 * coupling.T if symmetric else block(na, ns)
    if viscous:
        # A u-p form with a velocity potential: what K and C say together is symmetric, neither alone is.
        C[:ns, ns:] = 2.0 * block(ns, na)
        K[ns:, :ns], C[ns:, :ns] = K[:ns, ns:].T, C[:ns, ns:].T
        M[ns:, :ns] = 0.0
    if lossy:
        K[:ns, :ns] *= 1.0 + 0.02j
        K[ns:, ns:] *= 1.0 + 0.001j
    left = np.vstack([block(ns, nt), np.zeros((na, nt))])
    return operators, left, left.copy() if symmetric else np.roll(left, 1, axis=1), ns


@pytest.mark.parametrize("table", [True, False], ids=["one table", "line by line"])
@pytest.mark.parametrize("viscous", [False, True])
@pytest.mark.parametrize("lossy", [False, True])
@pytest.mark.parametrize("symmetric", [True, False])
def test_the_condensed_air_solves_the_whole_system(
    monkeypatch: pytest.MonkeyPatch, symmetric: bool, lossy: bool, viscous: bool, table: bool
) -> None:
    """Against a dense solution of all coordinates, and one factorisation for both problems exactly where S is symmetric."""
    if not table:
        monkeypatch.setattr(condense, "PAIRS", 0)
    rng = np.random.default_rng([symmetric, lossy, viscous])
    operators, left, right, ns = in_air(symmetric, lossy, viscous, rng)
    r, s = operators[0].shape[0], S[:, None, None]
    D, loads, outputs = 1e5 * (rng.standard_normal((S.size, 3)) + 0.3j), rng.standard_normal((r, 2)), rng.standard_normal((4, r)).T
    air = CondensedAir(tuple(operators), (left, right), ns)
    assert air.symmetric == symmetric
    x, v = air.solve(s, D, loads, outputs)
    Z = operators[0] + s * operators[1] + s**2 * operators[2] + (left * D[:, None, :]) @ right.T
    np.testing.assert_allclose(Z @ x, np.broadcast_to(loads, x.shape), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.swapaxes(Z, 1, 2) @ v, np.broadcast_to(outputs, v.shape), rtol=1e-9, atol=1e-9)
