"""Orthonormal directions, deflation, and the random sketch of residuals."""

from __future__ import annotations

import numpy as np
import pytest
from systems import chain, csc, unit

from lrbc_cli.errors import NumericalError
from lrbc_cli.reduction.problem.basis import Field, Projection, check_orthonormal, energy_weight, new_directions


def empty_field(n=80, seed=0):
    rng = np.random.default_rng(seed)
    return Field(np.arange(n), 10.0 ** rng.uniform(-3, 3, size=n), np.zeros((n, 0)))


def snapshots(n, m, seed=1):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, m)) + 1j * rng.normal(size=(n, m))


def test_complex_snapshots_enter_as_real_and_imaginary_part():
    field, X = empty_field(), snapshots(80, 4)
    Q = new_directions(field, [X], 1e-10)
    assert Q.shape == (80, 8)
    np.testing.assert_allclose(Q.T @ Q, np.eye(8), atol=1e-13)
    for part in (X.real, X.imag):
        Y = part * field.weight[:, None]
        np.testing.assert_allclose(Q @ (Q.T @ Y), Y, atol=1e-10 * np.abs(Y).max())


def test_v_is_in_the_units_of_the_dofs():
    field, X = empty_field(), snapshots(80, 2).real
    field.Q = new_directions(field, [X], 1e-10)
    coefficients = np.linalg.lstsq(field.V, X, rcond=None)[0]
    np.testing.assert_allclose(field.V @ coefficients, X, atol=1e-8)


def test_grown_block_by_block_it_stays_orthonormal():
    """Snapshots that nearly lie in the basis are the hard case."""
    field = empty_field()
    known = snapshots(80, 5)
    for seed in range(6):
        X = known @ snapshots(5, 3, seed) + 1e-7 * snapshots(80, 3, 100 + seed)
        field.Q = np.hstack([field.Q, new_directions(field, [X], 1e-9)])
        assert check_orthonormal(field) < 1e-12
    assert field.Q.shape[1] > 10


@pytest.mark.parametrize(("size", "kept"), [(1e-2, 12), (1e-5, 10)])
def test_deflation_looks_at_the_size_of_what_is_new(size, kept):
    """Ten directions, and one snapshot that leaves their span by ``size``."""
    field = empty_field()
    field.weight = np.ones(80)
    X = snapshots(80, 5)
    new = X @ snapshots(5, 1, 3)
    far = snapshots(80, 1, 4)
    new = new / np.linalg.norm(new) + size * far / np.linalg.norm(far)
    Q = new_directions(field, [np.hstack([X, new])], 1e-3)
    assert Q.shape[1] == kept


def test_nothing_new_is_nothing():
    field = empty_field()
    X = snapshots(80, 3)
    field.Q = new_directions(field, [X], 1e-8)
    assert new_directions(field, [X @ snapshots(3, 4)], 1e-8).shape == (80, 0)
    assert new_directions(field, [np.zeros((80, 3), dtype=complex)], 1e-8).shape == (80, 0)
    assert new_directions(field, [np.zeros((80, 0), dtype=complex)], 1e-8).shape == (80, 0)


def test_the_size_of_a_snapshot_does_not_matter():
    field, X = empty_field(), snapshots(80, 3)
    Q, R = new_directions(field, [X], 1e-6), new_directions(field, [X * np.array([1e-12, 1.0, 1e9])], 1e-6)
    np.testing.assert_allclose(np.linalg.svd(Q.T @ R)[1], 1.0, atol=1e-9)


def test_a_basis_that_lost_its_orthonormality_is_refused():
    field = empty_field()
    field.Q = np.linalg.qr(snapshots(80, 4).real)[0]
    assert check_orthonormal(field) < 1e-13
    field.Q[:, 1] += 1e-6 * field.Q[:, 0]
    with pytest.raises(NumericalError, match="no longer orthonormal"):
        check_orthonormal(field)
    field.Q[0, 0] = np.nan
    with pytest.raises(NumericalError, match="no longer orthonormal"):
        check_orthonormal(field)


def test_energy_weight_is_never_zero():
    K, M = chain(5)
    K, M = K.tolil(), M.tolil()
    K[2, 2] = M[2, 2] = 0.0
    weight = energy_weight(csc(K), csc(M), 100.0)
    assert weight.min() > 0
    assert weight[2] == weight.min()
    np.testing.assert_allclose(weight[0] ** 2, K[0, 0] + 1e4 * M[0, 0])


def test_the_sketch_measures_residual_norms():
    """A random embedding of 96 rows: norms within a third, without forming the residual."""
    n = 400
    K, M = chain(n)
    rng = np.random.default_rng(0)
    field = Field(np.arange(n), energy_weight(K, M, 500.0), np.zeros((n, 0)))
    weight = energy_weight(K, M, 500.0, 0.1)
    P = Projection(
        (K, csc(1e-5 * K), M), unit(n, 0), csc(unit(n, n - 1).T), [field], dual=unit(n, n - 1), residual_weight=weight, transposed=True
    )
    P.extend([np.linalg.qr(rng.normal(size=(n, 12)))[0]])
    s = 200j
    Z = s**2 * M + s * 1e-5 * K + K
    now = P.projected()
    for _ in range(20):
        x = rng.normal(size=12)
        exact = np.linalg.norm((unit(n, 0).toarray()[:, 0] - Z @ (field.V @ x)) / weight)
        sketched = now.sketched_inputs[:, 0] - (s**2 * now.sketches[2] + s * now.sketches[1] + now.sketches[0]) @ x
        assert np.linalg.norm(sketched) == pytest.approx(exact, rel=0.35)
        exact = np.linalg.norm((Z.T @ (field.V @ x)) / weight)
        sketched = (s**2 * now.turned[2] + s * now.turned[1] + now.turned[0]) @ x
        assert np.linalg.norm(sketched) == pytest.approx(exact, rel=0.35)
