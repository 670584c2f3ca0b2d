"""Fill before it is computed: against elimination by hand, and against what the solvers report afterwards."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from systems import chain, csc, duct, fe_model, grid, unit

from lrbc_cli.reduction.solve import pardiso
from lrbc_cli.reduction.solve.dynamic import DynamicStiffness
from lrbc_cli.reduction.solve.symbolic import column_counts, elimination_tree

BACKENDS = ["superlu", *(["pardiso"] if pardiso.library() else [])]


def eliminated(A: sp.csr_array) -> np.ndarray:
    """Pattern of the Cholesky factor by eliminating one column after the other."""
    L = np.tril(A.toarray() != 0)
    np.fill_diagonal(L, True)
    for j in range(L.shape[0]):
        below = np.flatnonzero(L[j + 1 :, j]) + j + 1
        if below.size:
            # Its rows are connected through the first of them, which is eliminated next.
            L[below, below[0]] = True
    return L


@pytest.mark.parametrize("n", [1, 2, 7, 40, 90])
@pytest.mark.parametrize("density", [0.0, 0.01, 0.05, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_against_elimination(n, density, seed):
    A = sp.random_array((n, n), density=density, rng=np.random.default_rng(seed))
    A = sp.csr_array(A + A.T + sp.eye_array(n))
    L = eliminated(A)
    parents = [int(np.flatnonzero(L[j + 1 :, j])[0]) + j + 1 if L[j + 1 :, j].any() else -1 for j in range(n)]
    assert elimination_tree(A).tolist() == parents
    fill = column_counts(A)
    assert fill.counts.tolist() == L.sum(axis=0).tolist()
    assert fill.nonzeros == L.sum()
    assert fill.operations == np.sum(L.sum(axis=0).astype(float) ** 2)


def test_known_patterns():
    n = 50
    line = sp.diags_array([np.ones(n), np.ones(n - 1), np.ones(n - 1)], offsets=[0, 1, -1]).tocsr()
    assert column_counts(line).nonzeros == 2 * n - 1
    full = sp.csr_array(np.ones((n, n)))
    assert column_counts(full).nonzeros == n * (n + 1) // 2
    # An arrow that points the wrong way fills all.
    arrow = sp.eye_array(n).tolil()
    arrow[0, :] = arrow[:, 0] = 1.0
    assert column_counts(arrow.tocsr()).nonzeros == n * (n + 1) // 2
    assert column_counts(arrow.tocsr()[::-1][:, ::-1].tocsr()).nonzeros == 2 * n - 1


def models():
    K, M, acoustic = duct(60, 240, 1.2, coupling=0.05)
    yield "duct", fe_model(K, M, loads=unit(300, 1), outputs=unit(300, 2), left=unit(300, 0), is_acoustic=acoustic, damping=(1.0, 1e-6))
    K = csc(4e4 * grid(11, 12, 13))
    n = K.shape[0]
    yield "cube", fe_model(K, csc(sp.eye_array(n)), loads=unit(n, 1), outputs=unit(n, 2), left=unit(n, 0), damping=(1.0, 1e-6))
    K, M = chain(200)
    skew = csc(K + sp.diags_array(np.full(199, 2e4), offsets=1))
    yield "skew", fe_model(skew, M, loads=unit(200, 1), outputs=unit(200, 2), left=unit(200, 0), damping=(1.0, 1e-6))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("model", [pytest.param(model, id=name) for name, model in models()])
def test_against_the_solver(model, backend):
    """What is analysed is what is factorised, and the factorisation after an analysis is as good as without."""
    Z = DynamicStiffness(model.K, model.C, model.M, model.is_acoustic, backend=backend)
    analysis = Z.analyse()
    s = 2j * np.pi * 33.0
    factorisation = Z.factor(s)
    b = model.B.toarray()
    assert factorisation.residual(factorisation.solve(b, refine=1), b) < 1e-12
    # Supernodes store a few zeros, in narrow bands as many as entries.
    assert analysis.nonzeros <= 1.02 * Z.nonzeros
    assert analysis.nonzeros >= (0.9 if model.size > 1000 else 0.4) * Z.nonzeros
    assert analysis.triangle == pytest.approx(analysis.nonzeros / (1 if Z.half else 2), abs=model.size)
    if model.size > 1000:
        # PARDISO counts in millions.
        assert analysis.operations > 10 * analysis.triangle
    if backend == "pardiso":
        assert analysis.bytes > 16 * Z.nonzeros
