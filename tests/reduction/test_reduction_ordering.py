"""Orderings are permutations, and the built-in bisection keeps the fill near that of METIS."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.linalg import splu
from systems import grid

from lrbc_cli.reduction.solve.ordering import bisection_order, nested_dissection, without_diagonal

METIS = importlib.util.find_spec("pymetis") is not None
METHODS = [pytest.param("metis", marks=pytest.mark.skipif(not METIS, reason="pymetis is not installed")), "bisection"]


def fill(matrix: sp.csr_array, order: np.ndarray) -> int:
    """Non-zeros of the factors of a matrix eliminated in this order."""
    permuted = sp.csc_matrix(matrix[order][:, order])
    return splu(permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).nnz


def is_permutation(order: np.ndarray, n: int) -> bool:
    return order.shape == (n,) and np.array_equal(np.sort(order), np.arange(n))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [(1,), (7,), (300,), (23, 31), (9, 10, 11)])
def test_grids_are_permuted(method, shape):
    matrix = grid(*shape)
    assert is_permutation(nested_dissection(matrix, method), matrix.shape[0])


@given(st.integers(1, 400), st.floats(0.0, 3.0), st.integers(0, 2**31))
@settings(max_examples=40, deadline=None)
def test_any_graph_is_permuted(n, degree, seed):
    """Sparse random graphs: isolated vertices, many parts, stars and all."""
    pattern = sp.random_array((n, n), density=min(1.0, degree / n), rng=np.random.default_rng(seed), format="csr")
    pattern = (pattern + pattern.T + sp.eye_array(n)).tocsr()
    assert is_permutation(bisection_order(pattern), n)


@pytest.mark.parametrize("method", METHODS)
def test_no_edges_at_all(method):
    assert is_permutation(nested_dissection(sp.eye_array(200, format="csr"), method), 200)


def test_no_vertices():
    assert bisection_order(sp.csr_array((0, 0))).shape == (0,)


@pytest.mark.parametrize("method", METHODS)
def test_disconnected_parts_do_not_cost_fill(method):
    part = grid(18, 18)
    parts = sp.block_diag([part, part, sp.eye_array(40), grid(150)], format="csr")
    shuffle = np.random.default_rng(1).permutation(parts.shape[0])
    parts = parts[shuffle][:, shuffle].tocsr()
    order = nested_dissection(parts, method)
    assert is_permutation(order, parts.shape[0])
    alone = 2 * fill(part, nested_dissection(part, method)) + 2 * 40 + fill(grid(150), nested_dissection(grid(150), method))
    assert fill(parts, order) < 1.2 * alone


def test_complete_graph_and_star():
    dense = sp.csr_array(np.ones((150, 150)))
    assert is_permutation(bisection_order(dense), 150)
    star = sp.lil_array((201, 201))
    star[0, :] = star[:, 0] = 1.0
    star.setdiag(2.0)
    star = star.tocsr()
    order = bisection_order(star)
    assert is_permutation(order, 201)


@pytest.mark.parametrize("shape", [(60, 60), (14, 14, 14)])
def test_bisection_fills_much_less_than_the_natural_order(shape):
    matrix = grid(*shape)
    shuffled = np.random.default_rng(2).permutation(matrix.shape[0])
    mixed = matrix[shuffled][:, shuffled].tocsr()
    found = fill(mixed, bisection_order(mixed))
    assert found < 0.7 * fill(matrix, np.arange(matrix.shape[0]))


@pytest.mark.skipif(not METIS, reason="pymetis is not installed")
@pytest.mark.parametrize(("shape", "factor"), [((60, 60), 1.6), ((14, 14, 14), 1.5)])
def test_bisection_fills_little_more_than_metis(shape, factor):
    matrix = grid(*shape)
    assert fill(matrix, bisection_order(matrix)) < factor * fill(matrix, nested_dissection(matrix, "metis"))


def test_the_graph_has_no_loops():
    graph = without_diagonal(grid(5, 5))
    assert not graph.diagonal().any()
    assert graph.nnz == 2 * 2 * 5 * 4
