"""Another damping of the structure, told from FRFs alone, beside a gain and beside a second blow."""

from __future__ import annotations

import numpy as np
import pytest

from lrbc_cli.updating.statistics.chain.blows import second_blow
from lrbc_cli.updating.statistics.chain.damping import beside_damping, damping_pattern
from lrbc_cli.updating.statistics.decibels import decibel

HZ = np.arange(20.0, 500.0)
RESONANCES = np.array([60.0, 110.0, 190.0, 300.0, 410.0])
SHAPES = np.array([[1.0, 0.6], [0.8, -0.9], [1.0, 0.5], [0.7, -1.0], [1.0, 0.8]])


def frfs(loss_factor: float, hz: np.ndarray = HZ) -> np.ndarray:
    """Of five modes at two places."""
    return np.asarray((1.0 / (RESONANCES**2 * (1.0 + 1j * loss_factor) - hz[:, None] ** 2)) @ SHAPES)


def pattern(loss_factor: float, hz: np.ndarray = HZ, step: float = 1e-3) -> np.ndarray:
    y = frfs(loss_factor, hz)
    return damping_pattern(hz, (frfs(loss_factor, hz + step) / y - 1.0) / step)


def test_levels_follow_the_slope_of_the_phase():
    """But for a share of the loss factor itself."""
    change = 1e-6
    exact = decibel(frfs(0.01 + change) / frfs(0.01)) / change
    np.testing.assert_allclose(exact, pattern(0.01), rtol=0.02, atol=0.02 * np.abs(exact).max())


@pytest.mark.parametrize("times", [0.7, 1.5])
@pytest.mark.parametrize("gain", [0.0, 1.0])
def test_a_gain_is_left_and_damping_is_not(times: float, gain: float):
    """Of a structure that is damped heavily levels move on all lines."""
    levels = decibel(frfs(0.3 * times) / frfs(0.3)) + gain
    assert abs(np.median(levels) - gain) > 0.8
    assert abs(np.median(beside_damping(levels, pattern(0.3))) - gain) < 0.3


def test_what_cannot_be_compared_stays():
    levels = np.array([[1.0, np.nan], [2.0, 3.0]])
    np.testing.assert_array_equal(beside_damping(levels, np.zeros((2, 2))), levels)
    assert np.isnan(beside_damping(levels, np.ones((2, 2)))[0, 1])


@pytest.mark.parametrize("times", [0.6, 1.7])
def test_another_damping_is_no_second_blow(times: float):
    """Few resonances, as far apart as they are wide, rise and fall about as slowly."""
    hz = np.arange(20.0, 800.0)
    rows = np.arange(90.0, 800.0, 110.0)

    def wide(loss_factor: float) -> np.ndarray:
        return np.asarray((1.0 / (rows**2 * (1.0 + 1j * loss_factor) - hz[:, None] ** 2)) @ np.ones((rows.size, 1)))

    assert second_blow(hz, wide(0.1 * times), wide(0.1), "tight") is None
    told = second_blow(hz, wide(0.1 * times) * (1.0 + 0.5 * np.exp(-2j * np.pi * hz * 0.02))[:, None], wide(0.1), "tight")
    assert "hammer probably hit a second time" in str(told)
