"""Models that others wrote (NLEVP collection): read, reduced, compared with full solves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from systems import csc, fe_model, relative, unit

from lrbc_cli.io.matrices.read import read_matrix
from lrbc_cli.reduction.build import ReductionOptions, full_ports, reduce_model

DATA = Path(__file__).parents[1] / "data" / "nlevp"


def matrices(name, *names):
    return [read_matrix(DATA / f"{name}.mat", variable).matrix for variable in names]


def compare(model, reduction, hz, vectors, seed=0):
    """Largest error of each line's norm, over lines and stiffness vectors."""
    s = 2j * np.pi * hz
    full = full_ports(model, np.zeros(model.L.shape[0], dtype=np.int64), s, reduction.options.band_hz)
    ports = reduction.model.ports(s)
    return max(relative(ports.evaluate(D), full.evaluate(D)) for D in vectors(s, np.random.default_rng(seed)))


@pytest.fixture(scope="module")
def speaker_box():
    """Mass, damping (indefinite, of round-off size) and stiffness of a loudspeaker box with its air, normalised to unit masses."""
    M, C, K = matrices("speaker_box", "A", "B", "C")
    n = K.shape[0]
    assert n == 107
    # An added spring, dashpot and mass between DOFs of the model.
    left = csc(np.hstack([unit(n, 3).toarray(), unit(n, 40).toarray() - unit(n, 41).toarray(), unit(n, 80).toarray()]))
    return fe_model(K, M, C=C, loads=unit(n, 10), outputs=unit(n, 0, 55, 100), left=left, power=[0, 1, 2])


def test_speaker_box(speaker_box):
    model = speaker_box
    reduction = reduce_model(model, np.zeros(3, dtype=np.int64), ReductionOptions(band_hz=(20.0, 700.0)))
    assert reduction.reached
    assert reduction.model.size < 70

    def vectors(s, rng):
        power = s[:, None] ** model.terms.power
        size = np.array([1e6, 1e3, 0.5])
        yield np.zeros((s.size, 3), dtype=complex)
        for _ in range(10):
            yield size * 10.0 ** rng.uniform(-4, 3, size=3) * power

    # The model is undamped: an exact resonance has no relative error to speak of, lines between them do.
    hz = np.random.default_rng(1).uniform(20.0, 700.0, size=40)
    assert compare(model, reduction, hz, vectors) < 1e-3


@pytest.fixture(scope="module")
def foundation():
    """A machine foundation: ``w² M + w D + K`` is the negative of the dynamic stiffness, loss factor 0.1 in K, dashpots in D."""
    M, D, K = matrices("foundation", "M", "D", "K")
    n = K.shape[0]
    assert n == 3627
    K, C = csc(-K), csc((1j * D).real)
    loss = K.diagonal().imag / K.diagonal().real
    # A spring consumes energy: with exp(+i w t) the imaginary part is positive.
    np.testing.assert_allclose(loss, 0.1, rtol=0.02)
    assert C.nnz == 211
    assert C.diagonal().min() >= 0
    dashpots = np.flatnonzero(C.diagonal())
    # Piles under the foundation: springs beside its dashpots.
    return fe_model(
        K, M, C=C, loads=unit(n, 1801), outputs=unit(n, 0, 900, 1802, 3000), left=unit(n, *dashpots[:48:6]), output_power=[0, 2, 2, 0]
    )


def test_foundation(foundation):
    model = foundation
    reduction = reduce_model(model, np.zeros(4, dtype=np.int64), ReductionOptions(band_hz=(5.0, 60.0)))
    assert reduction.reached
    assert np.iscomplexobj(reduction.model.K)
    assert reduction.model.size < 250

    def vectors(s, rng):
        nt = model.terms.size
        yield np.zeros((s.size, nt), dtype=complex)
        yield np.full((s.size, nt), np.inf + 0j)
        for _ in range(10):
            yield 10.0 ** rng.uniform(2, 11, size=nt) * (1 + 1e-4 * s[:, None])

    hz = np.random.default_rng(2).uniform(5.0, 60.0, size=12)
    assert compare(model, reduction, hz, vectors) < 1e-3


def test_foundation_with_the_stored_sign_gains_energy(foundation):
    """The conjugate stiffness is another system: the check that warns of it has a reason."""
    conjugate = fe_model(
        csc(foundation.K.conj()), foundation.M, C=foundation.C, loads=foundation.B, outputs=csc(foundation.L.T), left=foundation.terms.left
    )
    s = 2j * np.pi * np.array([25.0])
    D = np.zeros((1, foundation.terms.size), dtype=complex)
    input_of = np.zeros(4, dtype=np.int64)
    right = full_ports(foundation, input_of, s, (5.0, 60.0)).evaluate(D)
    wrong = full_ports(conjugate, input_of, s, (5.0, 60.0)).evaluate(D)
    assert relative(wrong[:, [0, 3]], right[:, [0, 3]]) > 0.1
