"""Bands that open where nothing is felt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear import line_group

from lrbc_cli.model.terms import smoothing_matrix
from lrbc_cli.updating.posterior.confidence import CHI2_95, NORMAL_95, band, beyond_errors, open_sides

NEVER = (np.zeros(7, dtype=bool), np.zeros(7, dtype=bool))


class TestBand:
    def test_values_without_smoothing(self) -> None:
        p = np.linspace(3.0, 6.0, 7)
        std = np.linspace(0.1, 0.7, 7)
        found = band(line_group(7), p, np.diag(std**2), NEVER)
        np.testing.assert_allclose(found.std, std)
        np.testing.assert_allclose(found.lower, p - 1.959964 * std, rtol=1e-6)
        np.testing.assert_allclose(found.upper, p + 1.959964 * std, rtol=1e-6)

    def test_smoothed_values_against_draws(self) -> None:
        rng = np.random.default_rng(0)
        group = replace(line_group(7), smoothing=smoothing_matrix((1 / 3, 2 / 3, 1 / 3), 7))
        A = 0.03 * rng.normal(size=(7, 7))
        p = np.linspace(3.0, 4.0, 7)
        draws = p + rng.normal(size=(4000, 7)) @ A.T
        found = band(group, p, A @ A.T, NEVER)
        np.testing.assert_allclose(found.std, np.std([np.log10(group.values(d)) for d in draws], axis=0), rtol=0.06)

    def test_it_opens(self) -> None:
        down, up = np.arange(7) < 2, np.arange(7) > 4
        found = band(line_group(7), np.full(7, 4.0), 0.01 * np.eye(7), (down, up))
        np.testing.assert_array_equal(np.isinf(found.lower), down)
        np.testing.assert_array_equal(np.isinf(found.upper), up)
        assert np.isfinite(found.std).all()


class TestOpenSides:
    """Data that saturate: nothing above 5 and nothing below 1 is felt."""

    bounds = np.tile([0.0, 8.0], (3, 1))
    truth = np.array([6.0, 3.0, 0.5])

    def data(self, theta: np.ndarray) -> float:
        return float(40.0 * np.sum((np.clip(theta, 1.0, 5.0) - np.clip(self.truth, 1.0, 5.0)) ** 2))

    def test_open_where_saturated(self) -> None:
        down, up = open_sides(self.data, self.truth, np.eye(3), self.bounds, 1.0)
        np.testing.assert_array_equal(up, [True, False, False])
        np.testing.assert_array_equal(down, [False, False, True])

    def test_noise_opens_everything(self) -> None:
        cost = self.data(np.array([0.0, 3.0, 0.5]))
        for variance, open_ in ((0.99 * cost / CHI2_95, False), (1.01 * cost / CHI2_95, True)):
            down, _ = open_sides(self.data, self.truth, np.eye(3)[:, :1], self.bounds, variance)
            assert bool(down[0]) == open_

    def test_a_stretch_is_moved_as_a_whole(self) -> None:
        """What the neighbours could make up for is not asked: all go together."""
        patch = np.array([[1.0], [1.0], [0.0]])
        _, up = open_sides(self.data, self.truth, patch, self.bounds, 1.0)
        assert not up[0]


class TestBeyondErrors:
    """Of what FRFs tell of a joint where its predicted effect is wrong by a share."""

    steps = np.linspace(0.0, -4.0, 401)

    def test_where_frfs_move_alike_all_the_way_the_standard_deviation_holds_it(self) -> None:
        assert beyond_errors(-1.0, self.steps, np.full(401, 3.0), 0.12) == pytest.approx(0.0, abs=1e-6)

    def test_where_they_hardly_move_any_more_it_reaches_far(self) -> None:
        """``L = 1 - exp(z)``: from -1 on the share of the way there, against the exact inverse."""
        speeds, share = np.exp(self.steps), 0.12
        gone = 1.0 - np.exp(-1.0)
        reach = -np.log(1.0 - (1.0 + NORMAL_95 * share) * gone) - 1.0
        expected = np.sqrt(reach**2 - (NORMAL_95 * share) ** 2)
        assert beyond_errors(-1.0, self.steps, speeds, share) == pytest.approx(expected, rel=1e-3)
        assert expected > 0.4

    def test_a_joint_that_is_free_but_for_the_errors_is_open(self) -> None:
        assert beyond_errors(-2.0, self.steps, np.exp(self.steps), 0.12) == np.inf
        assert np.isfinite(beyond_errors(-2.0, self.steps, np.exp(self.steps), 0.01))

    def test_where_they_move_ever_faster_nothing_is_added(self) -> None:
        """Between two plates the last of the stiffness is felt most."""
        assert beyond_errors(-1.0, self.steps, np.exp(-self.steps), 0.12) == 0.0

    def test_beyond_its_bound_a_joint_is_free(self) -> None:
        assert beyond_errors(-5.0, self.steps, np.full(401, 3.0), 0.12) == np.inf
