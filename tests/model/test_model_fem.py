"""The full model's pieces: proportional damping, shapes, the extended system."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from systems import chain, duct, fe_model, unit

from lrbc_cli.errors import DataError
from lrbc_cli.model.fem import FeModel, hysteretic, proportional_damping


class TestProportionalDamping:
    def test_each_field_has_its_own_coefficients_and_the_coupling_none(self):
        K, M, acoustic = duct(5, 9)
        C = proportional_damping(K, M, acoustic, (3.0, 2e-6), (5.0, 7e-7)).toarray()
        K, M = K.toarray(), M.toarray()
        s, a = np.ix_(~acoustic, ~acoustic), np.ix_(acoustic, acoustic)
        np.testing.assert_allclose(C[s], 3.0 * M[s] + 2e-6 * K[s], rtol=1e-14)
        np.testing.assert_allclose(C[a], 5.0 * M[a] + 7e-7 * K[a], rtol=1e-14)
        assert np.abs(K[np.ix_(~acoustic, acoustic)]).max() > 0
        assert np.abs(M[np.ix_(acoustic, ~acoustic)]).max() > 0
        assert not C[np.ix_(~acoustic, acoustic)].any()
        assert not C[np.ix_(acoustic, ~acoustic)].any()

    def test_fields_may_be_interleaved(self):
        K, M, acoustic = duct(5, 9)
        perm = np.random.default_rng(3).permutation(acoustic.size)
        direct = proportional_damping(K[perm][:, perm], M[perm][:, perm], acoustic[perm], (3.0, 2e-6), (5.0, 7e-7)).toarray()
        np.testing.assert_array_equal(direct, proportional_damping(K, M, acoustic, (3.0, 2e-6), (5.0, 7e-7)).toarray()[np.ix_(perm, perm)])

    def test_none_is_empty(self):
        K, M = chain(4)
        C = proportional_damping(K, M, np.zeros(4, dtype=bool), (0.0, 0.0), (1.0, 1.0))
        assert C.nnz == 0

    def test_complex_stiffness(self):
        K, M = chain(4)
        C = proportional_damping((K * (1 + 0.1j)).tocsc(), M, np.zeros(4, dtype=bool), (2.0, 1e-5), (0.0, 0.0))
        np.testing.assert_allclose(C.toarray(), (2.0 * M + 1e-5 * (1 + 0.1j) * K).toarray(), rtol=1e-14)


class TestHysteretic:
    def test_each_field_has_its_own_loss_factor_and_the_coupling_none(self):
        K, _, acoustic = duct(5, 9)
        found = hysteretic(K, acoustic, 0.02, 0.003).toarray()
        np.testing.assert_allclose(found.real, K.toarray(), rtol=1e-14)
        expected = K.toarray() * np.where(np.logical_or.outer(acoustic, acoustic), 0.003, 0.02)
        expected[acoustic[:, None] != acoustic] = 0.0
        np.testing.assert_allclose(found.imag, expected, rtol=1e-14)

    def test_it_adds_to_a_complex_stiffness(self):
        K, _ = chain(4)
        found = hysteretic((K * (1 + 0.1j)).tocsc(), np.zeros(4, dtype=bool), 0.02, 0.5)
        np.testing.assert_allclose(found.toarray(), K.toarray() * (1 + 0.12j), rtol=1e-14)

    def test_none_stays_real(self):
        K, _ = chain(4)
        assert hysteretic(K, np.zeros(4, dtype=bool), 0.0, 0.5) is K


class TestFeModel:
    def test_extended_system(self):
        K, M = chain(5)
        model = fe_model(K, M, loads=unit(5, 0, 1), outputs=unit(5, 4), left=unit(5, 2, 3), right=unit(5, 1, 0))
        np.testing.assert_array_equal(model.inputs.toarray(), np.eye(5)[:, [0, 1, 2, 3]])
        np.testing.assert_array_equal(model.outputs.toarray(), np.eye(5)[[4, 1, 0]])

    @pytest.mark.parametrize("which", ["K", "C", "M", "B", "L"])
    def test_wrong_sizes_are_named(self, which):
        K, M = chain(5)
        model = fe_model(K, M, loads=unit(5, 0), outputs=unit(5, 4), left=unit(5, 2))
        pieces = {name: getattr(model, name) for name in ("K", "C", "M", "B", "L", "output_power", "is_acoustic", "terms")}
        pieces[which] = {"K": sp.csc_array((5, 4)), "B": sp.csc_array((4, 1)), "L": sp.csc_array((1, 6))}.get(which, sp.csc_array((4, 4)))
        with pytest.raises(DataError, match=r"does not match the other matrices"):
            FeModel(**pieces)
