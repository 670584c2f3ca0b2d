"""Very small models are kept whole: no state of the terms is missed."""

from __future__ import annotations

import numpy as np
import scipy.linalg as la
from systems import beam, csc, direct_frf, fe_model, unit

from lrbc_cli.reduction.build import reduce_model
from lrbc_cli.reduction.outcome import ReductionOptions

SPRINGS = 9


def held_loosely(elements: int):
    """A beam on nine springs, a loss factor of 0.01."""
    K, M = (A.toarray() for A in beam(elements, length=0.8, bending=119.5, line_mass=0.864))
    n = K.shape[0]
    left = unit(n, *np.linspace(1, n - 3, SPRINGS).round().astype(int) // 2 * 2 + 1)
    return fe_model(csc(K * (1 + 0.01j)), csc(M), loads=unit(n, 13), outputs=unit(n, 7, 19, 31, 43), left=left, output_power=2)


def test_small_models_are_exact_on_resonances_between_the_lines():
    """All springs loose: a resonance that no held-out line shows, with 25 directions off by a hundred times what was measured."""
    model = held_loosely(25)
    options = ReductionOptions(band_hz=(20.0, 1500.0), tolerance=1e-3)
    found = reduce_model(model, np.zeros(4, dtype=int), options)
    assert found.sizes == (model.size,)
    assert found.reached
    assert found.unseen <= 1e-6
    rng = np.random.default_rng(3)
    for value in (2e3, *10.0 ** rng.uniform(1.3, 6.8, 3)):
        Z = model.K.toarray().real + value * (model.terms.left @ model.terms.left.T).toarray()
        hz = np.sqrt(la.eigh(Z, model.M.toarray(), eigvals_only=True)[:12]) / (2 * np.pi)
        s = 2j * np.pi * hz[(hz > 20.0) & (hz < 1500.0)]
        D = np.full((s.size, SPRINGS), value * (1 + 0.01j))
        np.testing.assert_allclose(found.model.ports(s, workers=1).evaluate(D), direct_frf(model, s, D), rtol=1e-6)


def test_a_limit_of_the_size_holds_all_the_same():
    options = ReductionOptions(band_hz=(20.0, 1500.0), tolerance=1e-3, max_size=20)
    assert sum(reduce_model(held_loosely(25), np.zeros(4, dtype=int), options).sizes) <= 20


def test_larger_models_are_reduced():
    options = ReductionOptions(band_hz=(20.0, 1500.0), tolerance=1e-3)
    found = reduce_model(held_loosely(60), np.zeros(4, dtype=int), options)
    assert sum(found.sizes) < 60
