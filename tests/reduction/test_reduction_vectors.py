"""Local scales, reference values and the vectors for which errors are measured."""

from __future__ import annotations

import numpy as np
import pytest
from systems import beam, chain, csc, direct_frf, fe_model, relative, unit

from lrbc_cli.model.terms import LowRankTerms
from lrbc_cli.reduction.problem.vectors import FILL_LIMIT, RANDOM_DECADES, certificate_vectors, local_scale, reference_values

OMEGA = 2 * np.pi * 400.0


def terms(left, right=None, power=0, baseline=0.0):
    right = left if right is None else right
    nt = left.shape[1]
    return LowRankTerms(
        left=left, right=right, power=np.broadcast_to(power, nt).astype(np.int64), baseline=np.broadcast_to(baseline, nt).astype(float)
    )


def test_local_scale_of_a_unit_vector_is_the_diagonal():
    K, M = chain(6)
    expected = K.diagonal()[[2, 5]] + OMEGA**2 * M.diagonal()[[2, 5]]
    np.testing.assert_allclose(local_scale(K, M, terms(unit(6, 2, 5)), OMEGA), expected, rtol=1e-13)


def test_local_scale_is_in_the_unit_of_the_term():
    K, M = chain(6)
    stiffness = local_scale(K, M, terms(unit(6, 2)), OMEGA)
    np.testing.assert_allclose(local_scale(K, M, terms(unit(6, 2), power=1), OMEGA), stiffness / OMEGA)
    np.testing.assert_allclose(local_scale(K, M, terms(unit(6, 2), power=2), OMEGA), stiffness / OMEGA**2)


def test_local_scale_does_not_depend_on_the_exporters_scale_of_the_vectors():
    """k b bᵀ with b ten times as long needs a hundredth of the value."""
    K, M = chain(6)
    np.testing.assert_allclose(local_scale(K, M, terms(csc(10 * unit(6, 2))), OMEGA), local_scale(K, M, terms(unit(6, 2)), OMEGA) / 100)


def test_local_scale_of_vectors_that_share_no_dof():
    K, M = chain(6)
    found = local_scale(K, M, terms(unit(6, 1), unit(6, 4)), OMEGA)
    diagonal = K.diagonal() + OMEGA**2 * M.diagonal()
    np.testing.assert_allclose(found, np.sqrt(diagonal[1] * diagonal[4]), rtol=1e-12)


def test_free_and_clamped_lie_on_either_side():
    """A hundredth of the scale leaves the FRFs nearly free, ten thousand times clamp them."""
    K, M = beam(20)
    n = K.shape[0]
    model = fe_model(K, M, loads=unit(n, 5), outputs=unit(n, 9, 31), left=unit(n, 0), damping=(20.0, 1e-5))
    s = 2j * np.pi * np.linspace(10, 100, 12)
    scale = local_scale(K, M, model.terms, OMEGA)

    def at(factor):
        return direct_frf(model, s, np.full((12, 1), factor * scale, dtype=complex))

    assert relative(at(1e4), at(1e12)) < 1e-3
    assert relative(at(1e-6), at(0.0)) < 1e-3
    assert relative(at(1.0), at(0.0)) > 0.05


def test_reference_is_the_damped_local_stiffness():
    K, M = chain(6)
    mixed = terms(unit(6, 1, 2, 3), power=np.array([0, 1, 2]))
    scale = local_scale(K, M, mixed, OMEGA)
    np.testing.assert_allclose(reference_values(mixed, scale, OMEGA), [[scale[0], 0.1 * scale[0] / OMEGA, 0], [0, 0, 0], [0, 0, 0]])


def test_long_vectors_stay_out_of_the_reference():
    """Their outer product would fill the matrix."""
    n = int(np.sqrt(FILL_LIMIT)) + 5
    both = csc(np.hstack([np.ones((n, 1)), unit(n, 3).toarray()]))
    reference = reference_values(terms(both), np.ones(2), OMEGA)
    assert not reference[0].any()
    assert reference[1, 0] == 1.0


class TestCertificateVectors:
    S = 2j * np.pi * np.array([30.0, 300.0])

    def test_kinds(self):
        left = unit(6, 1, 2, 3)
        mixed = terms(left, power=np.array([0, 1, 2]), baseline=np.array([5.0, 0.0, 0.5]))
        scale = np.array([1e3, 10.0, 0.1])
        found = certificate_vectors(mixed, scale, self.S)
        power = self.S[:, None] ** np.array([0, 1, 2])
        base = -np.array([5.0, 0.0, 0.5]) * power
        np.testing.assert_allclose(found["free"][0], base)
        # Stiffness goes from free to far beyond clamped; a dashpot or a mass stays within what structures have.
        for kind, stiff, other in (("loose", -2.0, -2.0), ("local", 0.0, 0.0), ("clamped", 4.0, 1.0), ("beyond", 9.0, 2.0)):
            decades = np.array([stiff, other, other])
            np.testing.assert_allclose(found[kind][0], base + 10.0**decades * scale * power, rtol=1e-13)
        assert len(found["random"]) == 16

    def test_random_ones_span_their_range_and_some_are_damped(self):
        found = certificate_vectors(terms(unit(60, *range(50))), np.full(50, 1e3), self.S, count=20)["random"]
        decades = np.log10(np.abs([D[0] for D in found]) / 1e3)
        low, high = RANDOM_DECADES[0]
        assert decades.min() == pytest.approx(low, abs=0.2)
        assert decades.max() == pytest.approx(high, abs=0.7)
        loss = np.array([(D[1].imag / D[1].real).max() for D in found])
        assert loss.min() < 1e-3
        assert loss.max() > 0.1

    def test_they_are_the_same_every_time(self):
        args = (terms(unit(6, 1, 2)), np.ones(2), self.S)
        for a, b in zip(certificate_vectors(*args)["random"], certificate_vectors(*args)["random"], strict=True):
            np.testing.assert_array_equal(a, b)
