"""Descents that lead to the same place: told from the linearisations, and only where both agree."""

from __future__ import annotations

import numpy as np
import pytest
from pads import PADS, pads_model, pads_ports

from lrbc_cli.updating.misfit.cost import Misfit
from lrbc_cli.updating.misfit.frf import port_model
from lrbc_cli.updating.search.optimise import promised
from lrbc_cli.updating.search.race import Race
from lrbc_cli.updating.search.valleys import Lead, leading_apart, worth


def lead(total: float, jacobian: np.ndarray, end: list[float]) -> Lead:
    return Lead(total, jacobian, np.array(end))


def test_ends_meet_where_their_residuals_hardly_differ():
    J = np.diag([10.0, 0.1])
    one, near, far = lead(1.0, J, [0.0, 0.0]), lead(1.1, J, [0.05, 1.0]), lead(1.2, J, [1.0, 0.0])
    assert one.meets(near, 1.0)
    assert near.meets(one, 1.0)
    assert not one.meets(far, 1.0)
    assert leading_apart([far, near, one], 1.0) == [2, 0]
    assert leading_apart([far, near, one], 0.1) == [2, 1, 0]


def test_a_joint_that_one_of_them_does_not_feel_keeps_them_apart():
    """Free at one end, tight at the other: the derivative is nought at the first."""
    free, tight = lead(1.0, np.diag([10.0, 0.0]), [0.0, -3.0]), lead(1.1, np.diag([10.0, 10.0]), [0.0, 0.0])
    assert not free.meets(tight, 1.0)
    assert not tight.meets(free, 1.0)


def test_a_place_without_a_cost_leads_nowhere_and_comes_last():
    J = np.eye(2)
    assert leading_apart([lead(np.nan, J, [5.0, 5.0]), lead(2.0, J, [0.0, 0.0])], 1.0) == [1, 0]


@pytest.fixture
def loosened() -> tuple[Misfit, np.ndarray]:
    model, parameters = pads_model(None, initial=4.5, bounds=(0.0, 7.0))
    truth = parameters.initial.copy()
    truth[3] -= 1.2
    frf = port_model(pads_ports(model), parameters)
    noise = 1.0 + 0.02 * np.random.default_rng(0).standard_normal(frf.frf(truth).shape)
    return Misfit(frf, frf.frf(truth) * noise, parameters.initial, 1e-6), truth


def test_the_promise_is_the_minimum_of_the_linearised_cost(loosened: tuple[Misfit, np.ndarray]):
    misfit, truth = loosened
    value, bounds = misfit(truth), misfit.model.parameters.bounds
    step = promised(value, truth, bounds)
    expected = np.linalg.lstsq(value.jacobian, -value.residual, rcond=None)[0]
    np.testing.assert_allclose(step, expected, rtol=1e-3, atol=1e-6)
    held = bounds.copy()
    held[3] = truth[3]
    assert promised(value, truth, held)[3] == 0.0


def test_what_is_worth_a_nat_is_so_many_times_the_noise(loosened: tuple[Misfit, np.ndarray]):
    misfit, truth = loosened
    value = misfit(truth)
    assert worth(misfit, value) == pytest.approx(2.0 * misfit.coarsening * value.total / misfit.valid.sum())


def test_descents_that_meet_are_followed_once(loosened: tuple[Misfit, np.ndarray]):
    """Eight starts about the truth and one in another valley: after an iteration one of the eight goes on, and the other one."""
    misfit, truth = loosened
    span, bounds = np.eye(truth.size), misfit.model.parameters.bounds
    rng = np.random.default_rng(1)
    near = [truth + 0.01 * rng.standard_normal(truth.size) for _ in range(8)]
    far = misfit.prior.copy()
    far[PADS - 1] -= 3.0
    race = Race(misfit, bounds, span, 1e-8, 100)
    race.begin([*((f"near {k}", theta) for k, theta in enumerate(near)), ("far", far)], 3)
    iterations = [end.iterations for _, end in race.ends]
    assert sum(count > 1 for count in iterations[:8]) == 1
    assert iterations[8] > 1
    race.go_on([race.best])
    assert race.ends[race.best][1].evaluation.total <= misfit(truth).total
