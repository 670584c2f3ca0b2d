"""Symmetry of the operators and the u-p coupling, found from the numbers."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from systems import chain, csc, duct

from lrbc_cli.model.coupling import asymmetry, coupling_of
from lrbc_cli.model.fem import proportional_damping


def damped(K, M, acoustic):
    return proportional_damping(K, M, acoustic, (3.0, 2e-6), (5.0, 7e-7))


def symmetrised(K, C, M, acoustic, kappa, s=300j):
    Z = (s**2 * M + s * C + K).toarray()
    Z[acoustic] /= -kappa * s**2
    return Z


@pytest.mark.parametrize("kappa", [1.0, 1.204, 1.42e5, 8.3e-4])
def test_kappa_is_found_and_does_symmetrise(kappa):
    K, M, acoustic = duct(6, 12, kappa)
    C = damped(K, M, acoustic)
    found = coupling_of(K, C, M, acoustic)
    assert found.symmetric
    assert found.kappa == pytest.approx(kappa, rel=1e-12)
    Z = symmetrised(K, C, M, acoustic, found.kappa)
    np.testing.assert_allclose(Z, Z.T, rtol=0, atol=1e-12 * np.abs(Z).max())


def test_the_exporters_sign_does_not_matter():
    K, M, acoustic = duct(6, 12, 1.2)
    flip = sp.diags_array(np.where(acoustic, -1.0, 1.0))
    K, M = csc(flip @ K @ flip), csc(flip @ M @ flip)
    assert coupling_of(K, damped(K, M, acoustic), M, acoustic).kappa == pytest.approx(1.2, rel=1e-12)


def test_fields_may_be_interleaved():
    K, M, acoustic = duct(6, 12, 1.2)
    perm = np.random.default_rng(0).permutation(acoustic.size)
    K, M, acoustic = csc(K[perm][:, perm]), csc(M[perm][:, perm]), acoustic[perm]
    assert coupling_of(K, damped(K, M, acoustic), M, acoustic).kappa == pytest.approx(1.2, rel=1e-12)


@pytest.mark.parametrize("pressure_unit", [1e-3, 1.0, 1e3])
def test_a_heavy_block_does_not_hide_the_coupling(pressure_unit):
    """One huge mass and spring dwarf the coupling in any norm of the whole matrix; it is still the physics."""
    K, M, acoustic = duct(6, 12, 1.2)
    heavy = sp.diags_array(np.eye(18)[0])
    unit = sp.diags_array(np.where(acoustic, pressure_unit, 1.0))
    K, M = csc((K + 1e12 * heavy) @ unit), csc((M + 1e8 * heavy) @ unit)
    found = coupling_of(K, damped(K, M, acoustic), M, acoustic)
    assert found.symmetric
    assert found.kappa == pytest.approx(1.2 / pressure_unit, rel=1e-9)
    Z = symmetrised(K, damped(K, M, acoustic), M, acoustic, found.kappa)
    rows = ~acoustic
    np.testing.assert_allclose(Z[np.ix_(rows, acoustic)], Z[np.ix_(acoustic, rows)].T, rtol=1e-9)


def test_disproportional_blocks_are_refused():
    K, M, acoustic = duct(6, 12, 1.2)
    M = M.tolil()
    row, col = 8, int(np.argmax(np.abs(M.toarray()[8, :6])))
    M[row, col] *= 1.0 + 1e-5
    M = csc(M)
    found = coupling_of(K, damped(K, M, acoustic), M, acoustic)
    assert not found.symmetric
    assert found.kappa is None
    assert "not transposes of each other" in found.text


@pytest.mark.parametrize("which", ["K_as", "M_sa", "C_sa", "K_ss", "M_aa"])
def test_blocks_that_the_form_does_not_have_are_refused(which):
    K, M, acoustic = duct(6, 12, 1.2)
    C = damped(K, M, acoustic)
    matrices = {"K": K.tolil(), "C": C.tolil(), "M": M.tolil()}
    row, col = {"as": (9, 2), "sa": (2, 9), "ss": (1, 2), "aa": (9, 10)}[which[2:]]
    X = matrices[which[0]].toarray()
    block = X[np.ix_(acoustic if which[2] == "a" else ~acoustic, acoustic if which[3] == "a" else ~acoustic)]
    matrices[which[0]][row, col] += 1e-3 * (np.abs(block).max() or np.sqrt(np.abs(np.diag(X)[:6]).max() * np.abs(np.diag(X)[6:]).max()))
    found = coupling_of(*(csc(matrices[name]) for name in "KCM"), acoustic)
    assert not found.symmetric
    assert found.kappa is None


def test_symmetric_structure():
    K, M = chain(7)
    acoustic = np.zeros(7, dtype=bool)
    found = coupling_of(K, damped(K, M, acoustic), M, acoustic)
    assert found.symmetric
    assert found.kappa is None


def test_hysteretic_structure_is_complex_symmetric_not_hermitian():
    K, M = chain(7)
    K = csc(K * (1 + 0.05j))
    acoustic = np.zeros(7, dtype=bool)
    assert coupling_of(K, csc(sp.csc_array((7, 7))), M, acoustic).symmetric
    skew = csc(K + 1j * sp.diags_array([np.ones(6), -np.ones(6)], offsets=[1, -1]) * 1e3)
    assert not coupling_of(skew, csc(sp.csc_array((7, 7))), M, acoustic).symmetric


def test_uncoupled_fields_are_symmetric():
    K, M, acoustic = duct(6, 12, coupling=0.0)
    found = coupling_of(K, damped(K, M, acoustic), M, acoustic)
    assert found.symmetric
    assert found.kappa is None


def test_unsymmetric_structure():
    K, M = chain(7)
    K = csc(K + sp.diags_array(np.full(6, 500.0), offsets=1))
    found = coupling_of(K, csc(sp.csc_array((7, 7))), M, np.zeros(7, dtype=bool))
    assert not found.symmetric
    assert "LU" in found.text


def test_one_way_coupling_is_unsymmetric():
    K, M, acoustic = duct(6, 12)
    M = csc(sp.block_diag([M[:6][:, :6], M[6:][:, 6:]]))
    assert not coupling_of(K, damped(K, M, acoustic), M, acoustic).symmetric


def test_asymmetry_is_relative():
    X = csc(np.array([[3.0, 1.0], [0.0, 4.0]]))
    assert asymmetry(X) == pytest.approx(np.sqrt(2.0) / np.sqrt(26.0))
    assert asymmetry(csc(np.zeros((3, 3)))) == 0.0
