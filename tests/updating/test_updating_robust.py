"""Medians without values that are NaN: those of NumPy, to the bit."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from lrbc_cli.updating.robust import medians


@given(
    values=arrays(np.float64, array_shapes(min_dims=1, max_dims=3, max_side=6), elements=st.floats(-1e3, 1e3) | st.just(float("nan"))),
    data=st.data(),
)
def test_medians(values, data):
    axis = data.draw(st.integers(-values.ndim, values.ndim - 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        expected = np.nanmedian(values, axis=axis, keepdims=True)
    np.testing.assert_array_equal(medians(values, axis), expected)


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_one_dimension(count):
    values = np.random.default_rng(count).normal(size=count)
    assert medians(values)[0] == np.median(values)
