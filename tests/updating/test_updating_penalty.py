"""The rows of the regularisation, and the prior that they draw to."""

from dataclasses import replace

import numpy as np
import pytest

from lrbc_cli.model.terms import EdgeDamping, ParameterGroup, Parameterisation, smoothing_matrix
from lrbc_cli.updating.misfit.cost import penalty_rows


def edge(count: int, first: int = 0, damping: EdgeDamping | None = None) -> ParameterGroup:
    terms = np.arange(first, first + count)
    return ParameterGroup(
        name=f"edge{first}",
        kind="stiffness",
        terms=terms,
        parameter=np.arange(count),
        initial=np.full(count, 3.0),
        bounds=np.tile([-1.0, 7.0], (count, 1)),
        smoothing=smoothing_matrix(None, count),
        damping=damping,
    )


def test_departures_alone_are_the_paper():
    parameters = Parameterisation((edge(4, damping=EdgeDamping(beta=1e-6)),))
    rows = penalty_rows(parameters)
    assert rows.shape == (4, 5)
    np.testing.assert_array_equal(rows[:, :4], np.eye(4))
    np.testing.assert_array_equal(rows[:, 4], 0.0)


def test_differences_do_not_see_constants():
    rows = penalty_rows(Parameterisation((edge(5),)), value=0.0, slope=2.0)
    np.testing.assert_allclose(rows @ np.ones(5), 0.0, atol=1e-14)
    assert np.sum((rows @ np.array([0.0, 0.0, 1.0, 0.0, 0.0])) ** 2) == pytest.approx(2.0 * 2)


def test_groups_are_not_tied_to_each_other():
    parameters = Parameterisation((edge(3), edge(3, first=3)))
    rows = penalty_rows(parameters, value=0.0, slope=1.0)
    step = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    np.testing.assert_allclose(rows @ step, 0.0, atol=1e-14)


def test_a_single_parameter_has_no_neighbour():
    assert penalty_rows(Parameterisation((edge(1),)), value=0.0, slope=1.0).shape == (0, 1)


def test_joints_are_alike_in_no_order():
    """Independent of how they are listed, the level left to itself: weight times the sum of squares about the mean."""
    group = replace(edge(5), bolt=np.arange(5))
    rows = penalty_rows(Parameterisation((group,)), value=0.0, slope=2.0)
    np.testing.assert_allclose(rows @ np.ones(5), 0.0, atol=1e-14)
    values = np.random.default_rng(0).normal(size=5)
    for order in (np.arange(5), np.array([3, 0, 4, 2, 1])):
        assert np.sum((rows @ values[order]) ** 2) == pytest.approx(2.0 * 5 * np.var(values))
