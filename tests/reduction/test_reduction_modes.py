"""Modes of the reduced model: those of the full one, whatever the terms and the damping; shapes compared over the whole model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as la
from samples import reduced_sample, sample
from systems import duct, fe_model, unit, whole

from lrbc_cli.campaign.identification.unknowns import layout
from lrbc_cli.campaign.updated.modes import polynomial
from lrbc_cli.reduction.reduced.model import ReducedModel
from lrbc_cli.reduction.reduced.modes import Modes, mac, modes_of, paired

BAND = (30.0, 500.0)

#: log10 of the ten values of the frame and exponent of their damping.
STATES = {"tight": [6.5] * 10 + [0.0], "loose": [8.0, 7.0, 6.0, 2.0, 2.5, 3.0, 6.0, 7.5, 8.0, 5.0, 2.0], "free": [2.0] * 10 + [-1.0]}


def full_modes(matrices: list[np.ndarray], band: tuple[float, float]) -> Modes:
    """Of matrices, by the companion form: nothing of the code under test."""
    K, C, M = matrices
    n = K.shape[0]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    s, z = la.eig(A)
    hz = np.abs(s) / (2 * np.pi)
    kept = np.flatnonzero((s.imag > 0) & (hz >= band[0]) & (hz <= band[1]))
    kept = kept[np.argsort(hz[kept])]
    return Modes(s[kept], z[:n, kept])


def assembled(model, terms: np.ndarray) -> list[np.ndarray]:
    left, right = model.terms.left.toarray(), model.terms.right.toarray()
    return [A.toarray() + (left * terms[:, q]) @ right.T for q, A in enumerate((model.K, model.C, model.M))]


@pytest.fixture(scope="module")
def frame() -> tuple[ReducedModel, dict[str, Modes]]:
    """The reduced model of the frame sample, and the modes of its full matrices in each state."""
    model, parameters = sample("frame").model, layout(sample("frame"))
    return reduced_sample("frame").model, {
        name: full_modes(assembled(model, polynomial(parameters, np.array(theta))), BAND) for name, theta in STATES.items()
    }


def test_frequencies_and_damping_are_those_of_the_full_model(frame) -> None:
    reduced, full = frame
    for name, theta in STATES.items():
        found = modes_of(reduced, polynomial(layout(sample("frame")), np.array(theta)), BAND)
        assert found.frequency_hz.size >= 8
        np.testing.assert_allclose(found.frequency_hz, full[name].frequency_hz, rtol=1e-6, err_msg=name)
        np.testing.assert_allclose(found.damping_ratio, full[name].damping_ratio, rtol=1e-4, err_msg=name)


def test_mac_is_that_of_the_full_shapes(frame) -> None:
    reduced, full = frame
    parameters = layout(sample("frame"))
    tight, loose = (modes_of(reduced, polynomial(parameters, np.array(STATES[name])), BAND) for name in ("tight", "loose"))
    M, a, b = sample("frame").model.M.toarray(), full["tight"].shapes, full["loose"].shapes
    own = np.outer(np.einsum("im,ij,jm->m", a.conj(), M, a).real, np.einsum("im,ij,jm->m", b.conj(), M, b).real)
    expected = np.abs(a.conj().T @ M @ b) ** 2 / own
    np.testing.assert_allclose(mac(reduced, tight, loose), expected, atol=1e-4)
    assert 0.2 < np.sort(expected.ravel())[-len(expected) // 2] < 0.999


def test_hysteretic_damping_of_terms_and_structure() -> None:
    """A loss factor in all stiffness is twice the damping ratio of every mode."""
    reduced, parameters = reduced_sample("frame").model, layout(sample("frame"))
    eta, theta = 0.02, np.array(STATES["tight"])
    group = parameters.groups[0]
    lossy = replace(parameters, groups=(replace(group, damping=replace(group.damping, beta=0.0, loss_factor=eta)),))
    terms = polynomial(lossy, theta)
    assert np.iscomplexobj(terms)
    model = replace(reduced, K=reduced.K * (1 + 1j * eta), C=np.zeros_like(reduced.C))
    found = modes_of(model, terms, BAND)
    plain = modes_of(replace(model, K=reduced.K), terms.real, BAND)
    np.testing.assert_allclose(2 * found.damping_ratio, eta, rtol=2e-4)
    np.testing.assert_allclose(found.frequency_hz, plain.frequency_hz * (1 + eta**2) ** 0.25, rtol=1e-8)


def test_modes_of_plate_and_air_are_orthogonal_in_energy() -> None:
    ns, na = 8, 24
    K, M, acoustic = duct(ns, na, kappa=1.3, coupling=1.0)
    full = fe_model(K, M, loads=unit(ns + na, 7), outputs=unit(ns + na, 2), left=unit(ns + na, 0), is_acoustic=acoustic)
    model = whole(full, C=np.zeros((ns + na, ns + na)))
    found = modes_of(model, np.array([[1e4, 0.0, 0.0]]), (5.0, 2000.0))
    assert found.frequency_hz.size >= 6
    np.testing.assert_allclose(mac(model, found, found), np.eye(found.frequency_hz.size), atol=1e-8)


def test_pairs_leave_out_what_is_not_alike() -> None:
    likeness = np.array([[0.1, 0.9, 0.0], [0.8, 0.7, 0.2], [0.0, 0.3, 0.4]])
    assert set(paired(likeness)) == {(0, 1), (1, 0), (2, None), (None, 2)}
