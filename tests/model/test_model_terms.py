"""Parameters to term values: smoothing, layout, derivatives, limits."""

from __future__ import annotations

import numpy as np
import pytest
from derivatives import check_derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from systems import csc, unit

from lrbc_cli.model.terms import EdgeDamping, LowRankTerms, ParameterGroup, Parameterisation, smoothing_matrix

THIRDS = (1 / 3, 2 / 3, 1 / 3)


def group(name, kind, terms, parameter=None, **more):
    """A group with start values that differ."""
    terms = np.asarray(terms)
    parameter = np.arange(terms.size) if parameter is None else np.asarray(parameter)
    count = int(parameter.max()) + 1
    return ParameterGroup(
        name=name,
        kind=kind,
        terms=terms,
        parameter=parameter,
        initial=more.pop("initial", 2.0 + 0.1 * np.arange(count)),
        bounds=np.tile(more.pop("bounds", (-1.0, 7.0)), (count, 1)),
        smoothing=smoothing_matrix(more.pop("weights", None), count, more.pop("normalised", False)),
        **more,
    )


@pytest.fixture
def mixed():
    """Interleaved terms of three kinds, two of them tied to one parameter, smoothing and two p_damp."""
    return Parameterisation(
        (
            group("edge", "stiffness", [0, 2, 4, 6], weights=THIRDS, damping=EdgeDamping(beta=2e-6, initial=0.4)),
            group("bushing", "stiffness", [1, 3, 5], [0, 1, 0], damping=EdgeDamping(beta=1e-5, initial=-0.3, bounds=(-1.0, 2.0))),
            group("pot", "damping", [8]),
            group("mass", "mass", [7], initial=np.array([-2.0])),
        )
    )


class TestSmoothing:
    def test_rows_of_the_paper_sum_to_four_thirds_inside_and_one_at_the_ends(self):
        sums = smoothing_matrix(THIRDS, 9).sum(axis=1)
        np.testing.assert_allclose(sums[1:-1], 4 / 3, rtol=1e-14)
        np.testing.assert_allclose(sums[[0, -1]], 1.0, rtol=1e-14)

    def test_bands(self):
        W = smoothing_matrix(THIRDS, 5)
        expected = np.diag(np.full(5, 2 / 3)) + np.diag(np.full(4, 1 / 3), 1) + np.diag(np.full(4, 1 / 3), -1)
        np.testing.assert_allclose(W, expected, rtol=1e-14)

    def test_skew_weights_keep_their_side(self):
        W = smoothing_matrix((0.1, 0.7, 0.2), 3)
        np.testing.assert_allclose(W, [[0.7, 0.2, 0], [0.1, 0.7, 0.2], [0, 0.1, 0.7]])

    @given(st.integers(1, 12), st.lists(st.floats(0.05, 2.0), min_size=1, max_size=4))
    @settings(max_examples=40, deadline=None)
    def test_normalised_rows_sum_to_one_and_keep_their_proportions(self, count, half):
        weights = [*half[::-1], *half[1:]]
        W = smoothing_matrix(weights, count, normalised=True)
        np.testing.assert_allclose(W.sum(axis=1), 1.0, rtol=1e-12)
        plain = smoothing_matrix(weights, count)
        np.testing.assert_allclose(W * plain.sum(axis=1, keepdims=True), plain, rtol=1e-12)

    def test_none_is_the_identity(self):
        np.testing.assert_array_equal(smoothing_matrix(None, 4), np.eye(4))

    def test_nearly_blind_to_alternation(self):
        """The condition that the method page warns of."""
        assert np.linalg.cond(smoothing_matrix(THIRDS, 31)) == pytest.approx(414, rel=0.01)


class TestLayout:
    def test_values_then_p_damp_group_by_group(self, mixed):
        assert mixed.size == 4 + 1 + 2 + 1 + 1 + 1
        assert mixed.terms == 9
        np.testing.assert_allclose(mixed.initial, [2.0, 2.1, 2.2, 2.3, 0.4, 2.0, 2.1, -0.3, 2.0, -2.0])
        np.testing.assert_array_equal(np.flatnonzero(mixed.is_damping), [4, 7])
        np.testing.assert_array_equal(mixed.bounds[7], (-1.0, 2.0))
        np.testing.assert_array_equal(mixed.bounds[4], EdgeDamping(beta=1.0).bounds)
        np.testing.assert_array_equal(mixed.bounds[[0, 5, 9]], [(-1.0, 7.0)] * 3)

    def test_scales_go_to_the_terms_of_each_group(self, mixed):
        theta = mixed.initial
        kappa = mixed.scales(theta)
        p = 10.0 ** theta[:4]
        edge = [2 * p[0] / 3 + p[1] / 3, p[0] / 3 + 2 * p[1] / 3 + p[2] / 3, p[1] / 3 + 2 * p[2] / 3 + p[3] / 3, p[2] / 3 + 2 * p[3] / 3]
        np.testing.assert_allclose(kappa[[0, 2, 4, 6]], edge, rtol=1e-13)
        # Terms 1 and 5 are one joint.
        np.testing.assert_allclose(kappa[[1, 3, 5]], 10.0 ** theta[[5, 6, 5]], rtol=1e-13)
        np.testing.assert_allclose(kappa[[8, 7]], 10.0 ** theta[[8, 9]], rtol=1e-13)

    def test_terms_that_changed_besides(self, mixed):
        """Term 1 alone of the joint of terms 1 and 5, twice over; unknowns, damping and all others are as before."""
        theta, changed = mixed.initial, mixed.weakened(np.array([1, 8]), -0.5).weakened(np.array([1]), -1.0)
        factor = np.ones(9)
        factor[[1, 8]] = 10.0**-1.5, 10.0**-0.5
        np.testing.assert_allclose(changed.scales(theta), factor * mixed.scales(theta), rtol=1e-14)
        np.testing.assert_allclose(changed.scale_jacobian(theta), factor[:, None] * mixed.scale_jacobian(theta), rtol=1e-14)
        s = np.array([10j, 500j])
        np.testing.assert_allclose(changed.dynamic(theta, s), factor * mixed.dynamic(theta, s), rtol=1e-14)
        np.testing.assert_array_equal(changed.initial, theta)
        assert mixed.factor is None

    def test_no_groups(self):
        empty = Parameterisation(())
        assert empty.size == empty.terms == 0
        assert empty.initial.shape == (0,)


class TestSpectra:
    S = 2j * np.pi * np.array([20.0, 155.0, 400.0])

    def test_equation_33(self, mixed):
        """D = k (1 + s beta 10^p_damp) for stiffness, s q, s² r; less what the matrices already contain."""
        theta = mixed.initial
        kappa, D, s = mixed.scales(theta), mixed.dynamic(theta, self.S), self.S
        for j in (0, 2, 4, 6):
            np.testing.assert_allclose(D[:, j], kappa[j] * (1 + s * 2e-6 * 10**0.4), rtol=1e-13)
        for j in (1, 3, 5):
            np.testing.assert_allclose(D[:, j], kappa[j] * (1 + s * 1e-5 * 10**-0.3), rtol=1e-12)
        np.testing.assert_allclose(D[:, 8], kappa[8] * s, rtol=1e-13)
        np.testing.assert_allclose(D[:, 7], kappa[7] * s**2, rtol=1e-13)

    def test_a_loss_factor_beside_beta(self):
        P = Parameterisation((group("edge", "stiffness", [0, 1], damping=EdgeDamping(beta=2e-6, initial=0.4, loss_factor=0.02)),))
        theta = np.array([2.0, 3.0, 0.7])
        expected = 10.0 ** theta[:2] * (1 + (self.S[:, None] * 2e-6 + 0.02j) * 10**0.7)
        np.testing.assert_allclose(P.dynamic(theta, self.S), expected, rtol=1e-13)

    def test_infinite_clamps_and_minus_infinite_frees(self, mixed):
        theta = mixed.initial
        theta[[0, 1, 5]] = [np.inf, -np.inf, -np.inf]
        D = mixed.dynamic(theta, self.S)
        # The far rows of W do not touch the clamped node: terms 4 and 6 stay finite.
        assert np.isposinf(D[:, [0, 2]].real).all()
        p = 10.0 ** theta[2:4]
        np.testing.assert_allclose(D[:, 4], (2 * p[0] / 3 + p[1] / 3) * (1 + self.S * 2e-6 * 10**0.4), rtol=1e-13)
        assert not D[:, [1, 5]].any()
        assert np.isfinite(D[:, [3, 4, 6, 7, 8]]).all()

    def test_all_clamped(self, mixed):
        theta = np.where(mixed.is_damping, mixed.initial, np.inf)
        assert np.isinf(mixed.dynamic(theta, self.S)).all()

    def test_polynomial(self, mixed):
        """D(s) is k + s c + s² m, with infinite and vanishing values too."""
        for first in (2.0, np.inf, -np.inf):
            theta = mixed.initial
            theta[0] = first
            terms = mixed.polynomial(theta)
            clamped = np.isinf(terms).any(axis=1)
            assert np.array_equal(clamped, np.isinf(mixed.scales(theta)))
            D = terms[~clamped] @ np.array([self.S**0, self.S, self.S**2])
            np.testing.assert_allclose(D.T, mixed.dynamic(theta, self.S)[:, ~clamped], rtol=1e-12)
            assert np.all(terms[clamped][:, 1:] == 0)


class TestDerivatives:
    @pytest.mark.parametrize("seed", range(3))
    def test_scales(self, mixed, seed):
        direction = np.random.default_rng(seed).normal(size=mixed.size)
        check_derivative(mixed.scales, mixed.scale_jacobian(mixed.initial), mixed.initial, direction, first=0.05)

    @pytest.mark.parametrize("more", [{"weights": (0.1, 0.7, 0.2)}, {"weights": THIRDS, "normalised": True}])
    def test_unsymmetric_smoothing(self, more):
        P = Parameterisation((group("edge", "stiffness", range(6), **more),))
        direction = np.random.default_rng(1).normal(size=6)
        check_derivative(P.scales, P.scale_jacobian(P.initial), P.initial, direction, first=0.05)

    def test_p_damp_does_not_move_the_scales(self, mixed):
        assert not mixed.scale_jacobian(mixed.initial)[:, mixed.is_damping].any()

    @pytest.mark.parametrize("seed", range(3))
    def test_dynamic_values_by_the_chain_rule(self, mixed, seed):
        """dD = c dkappa + kappa dc, as ``Slopes`` puts it together: with one response for each term."""
        s, theta = TestSpectra.S, mixed.initial
        direction = np.random.default_rng(seed).normal(size=mixed.size)
        slopes, each = mixed.slopes(theta, s), np.tile(np.eye(mixed.terms, dtype=complex), (s.size, 1, 1))
        J = slopes.of(each)
        assert J.shape == (s.size, mixed.terms, slopes.size)
        np.testing.assert_array_equal(slopes.of(each[1:], slice(1, None)), J[1:])
        # Real and imaginary parts on one scale: the damping part is a hundredth of the rest.
        check_derivative(lambda t: mixed.dynamic(t, s)[:, :7].imag, J[:, :7].imag, theta, direction, first=0.05)
        check_derivative(lambda t: mixed.dynamic(t, s)[:, :8].real, J[:, :8].real, theta, direction, first=0.05)

    def test_damping_spectra_name_their_terms(self, mixed):
        found = mixed.damping_spectra(mixed.initial, TestSpectra.S)
        assert [at for at, _, _ in found] == [4, 7]
        np.testing.assert_array_equal(found[0][1], [0, 2, 4, 6])


class TestLowRankTerms:
    def make(self, left, right):
        return LowRankTerms(left=left, right=right, power=np.zeros(left.shape[1], dtype=np.int64), baseline=np.zeros(left.shape[1]))

    def test_symmetric_means_equal_vectors(self):
        b = unit(5, 1, 3)
        assert self.make(b, b.copy()).symmetric
        assert not self.make(b, unit(5, 1, 2)).symmetric
        assert not self.make(b, csc(2 * b)).symmetric

    def test_stored_zeros_do_not_matter(self):
        b = unit(5, 1, 3)
        padded = b.copy()
        padded = csc(padded)
        padded.data = padded.data.copy()
        other = b + unit(5, 2, 2) - unit(5, 2, 2)
        assert self.make(b, other.tocsc()).symmetric
