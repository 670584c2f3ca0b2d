"""The search over changes at bolts: what gradients do not see, it finds; on exact data it ends no worse than at the truth."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest
from pads import PADS, pads_model, pads_ports
from sharp import sharp_misfit

from lrbc_cli.model.terms import Parameterisation
from lrbc_cli.updating.misfit.cost import ChangeError, Misfit
from lrbc_cli.updating.misfit.frf import port_model
from lrbc_cli.updating.search.descent import descend
from lrbc_cli.updating.search.levels import gauss_newton_by_levels
from lrbc_cli.updating.search.optimise import Solution
from lrbc_cli.updating.search.race import Race
from lrbc_cli.updating.search.search import search
from lrbc_cli.updating.search.starts import LEVELS, between, hops, other_levels
from lrbc_cli.updating.unknowns.shapes import Shapes

PAIRS = [(k, k + 1) for k in range(PADS - 1)]


def joints(changes: dict[int, float], *, eta: float = 1e-6) -> tuple[Misfit, Parameterisation, Shapes, np.ndarray]:
    """Pads as joints: each value is a bolt's own; the measurement is the model's own with some of them loosened."""
    model, parameters = pads_model(None, initial=4.5, bounds=(0.0, 7.0))
    truth = parameters.initial.copy()
    for bolt, change in changes.items():
        truth[bolt] += change
    frf = port_model(pads_ports(model), parameters)
    bolts = np.arange(PADS)
    shapes = Shapes(T=np.eye(parameters.size), std=np.ones(parameters.size), bolts=bolts, joint=np.ones(PADS, dtype=bool))
    return Misfit(frf, frf.frf(truth), parameters.initial, eta, shapes.penalty()), parameters, shapes, truth


def solve(misfit: Misfit, parameters: Parameterisation, shapes: Shapes):
    starts, _ = search(misfit, shapes, parameters.bounds, PAIRS)
    return gauss_newton_by_levels(
        misfit, misfit.prior, parameters.bounds, further=starts, span=shapes.T, joints=range(PADS), tolerance=1e-8
    )


@pytest.mark.parametrize("seed", range(6))
def test_exact_data_end_no_worse_than_at_the_truth(seed: int) -> None:
    """One to half of the joints less 0.3 to 3 decades."""
    rng = np.random.default_rng(seed)
    loose = rng.permutation(PADS)[: rng.integers(1, PADS // 2 + 1)]
    misfit, parameters, shapes, truth = joints({int(b): -float(rng.uniform(0.3, 3.0)) for b in loose})
    solution = solve(misfit, parameters, shapes)
    assert solution.evaluation.total <= 1.01 * misfit(truth).total
    change = solution.theta[:PADS] - misfit.prior[:PADS]
    assert set(np.flatnonzero(change < -0.15)) == set(loose.tolist())


def test_a_descent_from_the_tight_state_alone_does_not_find_it() -> None:
    """Why there is a search: two of ten joints loose, and the gradient of the tight state leads elsewhere."""
    misfit, parameters, shapes, truth = joints({4: -1.8, 8: -1.4})
    alone = descend(misfit, misfit.prior, parameters.bounds, shapes.T, tolerance=1e-8)
    assert alone.evaluation.misfit_db > 0.5
    assert solve(misfit, parameters, shapes).evaluation.total <= 1.01 * misfit(truth).total


def test_the_starts_are_described_and_counted() -> None:
    misfit, parameters, shapes, _ = joints({3: -1.2})
    starts, evaluations = search(misfit, shapes, parameters.bounds, PAIRS)
    assert next(iter(starts)) == "table of changes: bolt 4 by -1.2"
    assert evaluations > PADS * 5
    for theta in starts.values():
        assert np.all((theta >= parameters.bounds[:, 0]) & (theta <= parameters.bounds[:, 1]))


@pytest.mark.parametrize("seed", [0, 3])
def test_other_levels_lead_on_from_an_end_with_the_wrong_joint(seed: int) -> None:
    """Places beside an end at which a neighbour was loosened instead: one of them leads to the truth, the own valley is not among them."""
    rng = np.random.default_rng(seed)
    loose, other = (int(b) for b in rng.permutation(PADS)[:2])
    misfit, parameters, shapes, truth = joints({loose: -1.2})
    wrong = misfit.prior.copy()
    wrong[other] -= 0.7
    start = descend(misfit, wrong, parameters.bounds, shapes.T, max_iterations=1)
    columns = shapes.bolts.tolist()
    places = other_levels(misfit, start, parameters.bounds, shapes.T, columns, kept=1000)
    exchanged = [theta for theta in places if np.count_nonzero(np.abs(theta - start.theta) > 1e-9) == 2]
    assert len(places) - len(exchanged) == PADS * len(LEVELS)
    places = [theta for theta in places if not any(theta is one for one in exchanged)]
    z = np.linalg.pinv(shapes.T) @ (start.theta - misfit.prior)
    for theta in places:
        moved = np.linalg.pinv(shapes.T) @ (theta - misfit.prior) - z
        at = [column for column in columns if abs(moved[column]) > 1e-9]
        assert len(at) <= 1
        # Not the level that is nearest to the end's own.
        assert not at or min((0.0, *LEVELS), key=lambda level: abs(level - z[at[0]])) != pytest.approx(z[at[0]] + moved[at[0]])
    ends = [descend(misfit, theta, parameters.bounds, shapes.T) for theta in places[:12]]
    best = min(ends, key=lambda end: end.evaluation.total)
    np.testing.assert_allclose(best.theta, truth, atol=0.05)


def test_a_loosened_joint_and_each_stiffer_one_have_each_others_stiffness() -> None:
    """Ends at mirrored places are told apart by little: each is a place to begin at."""
    misfit, parameters, shapes, truth = joints({1: -2.0, 6: -0.2})
    end = descend(misfit, truth, parameters.bounds, shapes.T, max_iterations=1)
    places = other_levels(misfit, end, parameters.bounds, shapes.T, shapes.bolts.tolist(), kept=1000)
    exchanged = [theta for theta in places if np.count_nonzero(np.abs(theta - end.theta) > 1e-9) == 2]
    assert len(exchanged) == PADS - 1
    for theta in exchanged:
        other = [int(at) for at in np.flatnonzero(np.abs(theta - end.theta) > 1e-9) if at != 1]
        np.testing.assert_allclose(theta[[1, *other]], end.theta[[*other, 1]])
    # Places of a row that is symmetric: with the two at its ends the inner ones change places too.
    row = np.column_stack([np.arange(PADS), np.zeros((PADS, 2))])
    places = other_levels(misfit, end, parameters.bounds, shapes.T, [1, 8], partial(shapes.mirrored, row), kept=1000)
    (mirrored,) = [theta for theta in places if np.count_nonzero(np.abs(theta - end.theta) > 1e-9) > 2]
    np.testing.assert_allclose(mirrored[:PADS], end.theta[:PADS][::-1])


def test_bounds_that_allow_no_change_leave_nothing_to_solve() -> None:
    misfit, _, shapes, _ = joints({2: -1.0})
    held = np.column_stack([misfit.prior, misfit.prior])
    starts, _ = search(misfit, shapes, held, PAIRS)
    np.testing.assert_array_equal(next(iter(starts.values())), misfit.prior)


def test_without_bolts_there_is_nothing_to_search() -> None:
    misfit, parameters, shapes, _ = joints({})
    none = dataclasses.replace(shapes, bolts=np.full(PADS, -1))
    assert search(misfit, none, parameters.bounds) == ({}, 0)


def test_tables_are_what_full_evaluations_give() -> None:
    misfit, _, _, truth = joints({2: -1.0, 7: -0.4})
    frf = misfit.model.nearby(truth)
    other = truth.copy()
    other[[0, 7]] -= [2.0, 1.0]
    np.testing.assert_allclose(frf(other), misfit.model.frf(other), rtol=1e-9)
    np.testing.assert_allclose(frf(truth), misfit.model.frf(truth), rtol=1e-9)
    several = np.stack([other, truth])
    np.testing.assert_allclose(frf(several), [misfit.model.frf(theta) for theta in several], rtol=1e-9)


@pytest.mark.parametrize("moved", [[], [7], [0, 7]])
def test_a_cost_near_a_state_is_the_same_cost(moved: list[int]) -> None:
    """Values, Jacobian and the errors of a predicted change, with none, one and two joints moved from that state, and everything moved."""
    misfit, parameters, _, truth = joints({2: -1.0, 7: -0.4})
    measured = misfit.model.frf(truth)
    lines, step = misfit.model.ports.frequency_hz, 1e-3
    pads = pads_model(None, initial=4.5, bounds=(0.0, 7.0))[0]
    above = port_model(pads_ports(pads, 2j * np.pi * (lines + step)), parameters)
    error = ChangeError(most=2.0, here=misfit.model, above=above, frequency_hz=lines, step_hz=step, size=truth.size)
    at = truth - 0.3
    near, close = misfit.near(at), error.near(at)
    for theta in (at - 0.9 * np.isin(np.arange(truth.size), moved), truth):
        one, other = misfit(theta), near(theta)
        assert other.total == pytest.approx(one.total, rel=1e-8, abs=1e-12 * np.abs(measured).size)
        np.testing.assert_allclose(other.residual, one.residual, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(other.jacobian, one.jacobian, rtol=1e-7, atol=1e-7)
        assert near.sum(theta) == pytest.approx(one.total, rel=1e-8)
        for ours, expected in zip(close(misfit.prior, theta), error(misfit.prior, theta), strict=True):
            np.testing.assert_allclose(ours, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_speeds_are_the_derivative_of_all_frfs_along_a_joint() -> None:
    """Solved among its terms alone, by all sensitivities, and as a difference of two states; at a state that clips another value, too."""
    misfit, _, _, truth = joints({2: -1.0, 7: -0.4})
    model = misfit.model
    along = np.zeros((3, truth.size))
    along[:, 2] = 1.0
    along[2, 3] = 0.5
    states = np.tile(truth, (3, 1))
    states[:, 2] -= [0.0, 1.0, 2.5]
    states[2, 3] -= 0.3
    found = model.speeds(truth, states, along)
    np.testing.assert_allclose(found, dataclasses.replace(model, ports=None).speeds(truth, states, along), rtol=1e-8)
    step = 1e-5
    for x, d, speed in zip(states, along, found, strict=True):
        y, change = np.abs(model.frf(x)), (model.frf(x + step * d) - model.frf(x - step * d)) / (2.0 * step)
        assert speed == pytest.approx(np.linalg.norm(change / np.hypot(y, np.median(y, axis=0))), rel=1e-5)


def test_hops_pass_the_ridge_between_two_valleys() -> None:
    """One value, lines wider apart than the peaks: beside an end in a wrong valley there are places that lead out of it."""
    misfit = sharp_misfit(3.0, beta=1e-6)
    bounds = misfit.model.parameters.bounds
    stuck = descend(misfit, np.array([3.2]), bounds, np.eye(1))
    assert stuck.evaluation.misfit_db > 1.0
    places = hops(misfit, stuck, bounds, np.eye(1))
    assert len(places) == 1
    assert min(descend(misfit, place, bounds, np.eye(1)).evaluation.total for place in places) < stuck.evaluation.total


def followed(misfit: Misfit, start: np.ndarray) -> tuple[float, Solution]:
    """Mean difference where a plain descent ends [dB], and where it ends after it went on without what it explains least."""
    race = Race(misfit, misfit.model.parameters.bounds, np.eye(start.size), 1e-4, 100)
    race.begin([("start", start)])
    stuck = race.ends[0][1].evaluation
    race.look_beside(np.eye(start.size), (0.03, 0.2), (3, 8), 3)
    end = race.ends[race.best][1]
    assert end.evaluation.total <= stuck.total
    return stuck.misfit_db, end


@pytest.mark.slow
def test_without_the_lines_of_a_ridge_a_descent_leaves_the_wrong_valley() -> None:
    """Lines wider apart than the peaks: each valley ends where a peak would pass a line."""
    stuck, end = followed(sharp_misfit(3.0, beta=1e-6), np.array([3.02]))
    assert stuck > 0.3
    assert end.theta == pytest.approx(3.0, abs=1e-6)
    several = sharp_misfit(3.0, beta=1e-6, shared=False)
    rng = np.random.default_rng(0)
    ends = [followed(several, 3.0 + 0.05 * rng.normal(size=several.model.parameters.size)) for _ in range(8)]
    assert min(before for before, _ in ends) > 0.03
    assert sum(end.evaluation.misfit_db < 5e-3 for _, end in ends) >= 6


def test_a_closer_table_holds_the_wider_one_and_reaches_from_slight_to_free() -> None:
    closer = np.array(between(LEVELS))
    assert set(LEVELS) <= set(closer.round(12).tolist())
    assert closer.size == 4 * len(LEVELS)
    assert closer[0] == pytest.approx(LEVELS[0] / 4)
    assert closer[-1] == LEVELS[-1]
    assert np.all(np.diff(closer) < 0)
    # No gap is wider than a quarter of the wider table's.
    assert np.abs(np.diff(closer)).max() <= np.abs(np.diff(LEVELS)).max() / 4 + 1e-12
