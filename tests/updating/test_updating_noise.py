"""How many residuals are worth one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lrbc_cli.updating.statistics.error_model import ERRORS
from lrbc_cli.updating.statistics.noise import correlation_factor, estimate_noise, validation_ratio

LINES, RESPONSES = 400, 6


def places(lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Line and response of every residual, line by line."""
    return np.repeat(lines, RESPONSES), np.tile(np.arange(RESPONSES), lines.size)


def autoregressive(rng: np.random.Generator, phi: float, count: int = LINES) -> np.ndarray:
    """(count, RESPONSES) stationary residuals of standard deviation one whose neighbours correlate by phi."""
    out = rng.normal(size=(count, RESPONSES))
    for k in range(1, count):
        out[k] = phi * out[k - 1] + np.sqrt(1 - phi**2) * out[k]
    return out


def factor(residual: np.ndarray, jacobian: np.ndarray, lines: np.ndarray) -> float:
    return correlation_factor(residual.ravel(), jacobian.reshape(residual.size, -1), *places(lines))


def smooth(count: int = LINES) -> np.ndarray:
    return np.ones((count, RESPONSES, 1))


class TestCorrelationFactor:
    def test_white_residuals_count_in_full(self) -> None:
        rng = np.random.default_rng(1)
        found = [factor(rng.normal(size=(LINES, RESPONSES)), smooth(), np.arange(LINES)) for _ in range(20)]
        assert min(found) >= 1.0
        assert np.mean(found) < 1.15

    @pytest.mark.parametrize("phi", [0.3, 0.6, 0.8])
    def test_autoregressive_residuals_with_even_sensitivities(self, phi: float) -> None:
        """(1 + phi)/(1 - phi), the inflation of a mean's variance, but for lags of which nothing is left."""
        rng = np.random.default_rng(2)
        found = np.mean([factor(autoregressive(rng, phi), smooth(), np.arange(LINES)) for _ in range(20)])
        assert found == pytest.approx((1 + phi) / (1 - phi), rel=0.12)

    def test_it_is_the_inflation_of_the_scatter_of_estimates(self) -> None:
        """Against the scatter itself, for sensitivities that change along the lines."""
        rng = np.random.default_rng(3)
        J = np.sin(2 * np.pi * np.arange(LINES) / 25.0)[:, None] * np.ones(RESPONSES)
        estimates, factors = [], []
        for _ in range(300):
            r = autoregressive(rng, 0.7)
            estimates.append(np.sum(J * r) / np.sum(J * J))
            factors.append(factor(r, J, np.arange(LINES)))
        inflation = np.var(estimates) * np.sum(J * J)
        assert np.mean(factors) == pytest.approx(inflation, rel=0.2)

    def test_sensitivities_that_oscillate_feel_less_of_it(self) -> None:
        rng = np.random.default_rng(4)
        r = autoregressive(rng, 0.8)
        slow, fast = (np.cos(2 * np.pi * np.arange(LINES) / period)[:, None] * np.ones(RESPONSES) for period in (100.0, 12.0))
        even, some, little = (factor(r, J, np.arange(LINES)) for J in (smooth(), slow, fast))
        assert even > some > 2.0 > little >= 1.0

    def test_lines_that_were_left_out_are_no_neighbours(self) -> None:
        """Every tenth line of residuals whose correlation has faded over ten lines."""
        rng = np.random.default_rng(5)
        r = autoregressive(rng, 0.7, 10 * LINES)[::10]
        apart = 10 * np.arange(LINES)
        assert factor(r, smooth(), apart) == pytest.approx(1.0, abs=0.05)
        # Pairs of neighbours with gaps between: nothing is known of lags of two, nor invented.
        pairs = np.sort(np.concatenate([apart, apart + 1]))
        r = autoregressive(rng, 0.7, 10 * LINES)[pairs]
        found = factor(r, smooth(2 * LINES), pairs)
        # One neighbour each, of half the residuals a pair: 1 + 2 phi / 2.
        assert found == pytest.approx(1.7, rel=0.05)

    def test_responses_do_not_mix(self) -> None:
        """The same error in all responses is none along the lines."""
        rng = np.random.default_rng(6)
        r = np.repeat(rng.normal(size=(LINES, 1)), RESPONSES, axis=1)
        assert factor(r, smooth(), np.arange(LINES)) < 1.25

    def test_degenerate(self) -> None:
        none = np.zeros(0, dtype=np.int64)
        assert correlation_factor(np.zeros(0), np.zeros((0, 2)), none, none) == 1.0
        assert factor(np.zeros((5, RESPONSES)), smooth(5), np.arange(5)) == 1.0
        assert factor(np.ones((5, RESPONSES)), np.zeros((5, RESPONSES, 1)), np.arange(5)) == 1.0
        assert correlation_factor(np.ones(1), np.ones((1, 1)), np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)) == 1.0


class TestSigma:
    def test_unknowns_take_freedom(self) -> None:
        rng = np.random.default_rng(7)
        J = rng.normal(size=(40, 20))
        at = (np.arange(40), np.zeros(40, dtype=np.int64))
        found, stiff = [], []
        for _ in range(200):
            e = 0.7 * rng.normal(size=40)
            r = e - J @ np.linalg.lstsq(J, e, rcond=None)[0]
            found.append(estimate_noise(r, J, np.zeros((0, 20)), *at).sigma ** 2)
            # Unknowns that a prior holds take none.
            stiff.append(estimate_noise(e, J, 1e6 * np.eye(20), *at).sigma ** 2)
        assert np.mean(found) == pytest.approx(0.49, rel=0.08)
        assert np.mean(stiff) == pytest.approx(0.49, rel=0.08)

    def test_variance(self) -> None:
        rng = np.random.default_rng(8)
        r = 2.0 * autoregressive(rng, 0.6)
        least = replace(ERRORS, coarsening=1.0)
        alone, noise = (
            estimate_noise(r.ravel(), smooth().reshape(-1, 1), np.zeros((0, 1)), *places(np.arange(LINES)), errors)
            for errors in (least, ERRORS)
        )
        assert alone.sigma == noise.sigma == pytest.approx(2.0, rel=0.05)
        assert alone.variance == pytest.approx(16.0, rel=0.3)
        # What lines and responses share beyond that: so many residuals tell as much as one, in the weight of every prior.
        assert noise.variance == pytest.approx(ERRORS.coarsening * alone.variance)
        assert noise.at(1.0).variance == pytest.approx(noise.variance / noise.sigma**2)


@pytest.mark.parametrize(
    ("validation", "used", "ratio"),
    [(2.0, 1.0, 2.0), (1.0, 1.0, 1.0), (0.5, 1.0, 1.0), (None, 1.0, 1.0), (1.0, None, 1.0), (1.0, 0.0, 1.0), (np.nan, 1.0, 1.0)],
)
def test_validation_channels_can_only_widen(validation: float | None, used: float | None, ratio: float) -> None:
    assert validation_ratio(validation, used) == ratio
