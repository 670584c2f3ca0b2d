"""What excludes the loss of a joint's springs: likelihood ratios of linear data, their significance, and the level before the loss."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from lrbc_cli.updating.normal import NORMAL_95
from lrbc_cli.updating.posterior.excluded import as_shown, limited, loss_ratios, significant
from lrbc_cli.updating.posterior.mixture import MixtureProblem, SpringLoss, Springs, State
from lrbc_cli.updating.statistics.priors import BOLT_PRIOR as PRIOR
from lrbc_cli.updating.unknowns.springs import SpringsOf

ROWS = 400


def linear(
    seed: int = 0, *, effect: float = 1.0, lost: float = 0.0, where: slice = slice(None)
) -> tuple[SpringLoss, np.ndarray, np.ndarray]:
    """Data of two unknowns, and a loss that changes rows by ``effect`` standard deviations; a share ``lost`` of it happened."""
    rng = np.random.default_rng(seed)
    J, way = rng.normal(size=(ROWS, 2)), np.zeros(ROWS)
    way[where] = effect * rng.normal(size=ROWS)[where]
    r = rng.normal(size=ROWS) - lost * way
    return SpringLoss(without=r, lost=r + way, jacobian=J), np.array([1.0, 4.0]), way


def unlimited(loss: SpringLoss, variance: float, prior: tuple[np.ndarray, np.ndarray]) -> float:
    """The whole ratio."""
    with patch("lrbc_cli.updating.posterior.excluded.significant", return_value=np.inf):
        return limited(loss, variance, prior, np.zeros(ROWS, dtype=int))


def test_without_a_limit_it_is_the_ratio_of_two_normal_densities() -> None:
    loss, precision, _ = linear(effect=0.1)
    z = np.array([0.3, -0.2])
    found = unlimited(loss, 1.0, (precision, precision * z))
    spread = np.eye(ROWS) + loss.jacobian @ np.diag(1.0 / precision) @ loss.jacobian.T
    # In this state the unknowns are z above their prior means.
    exact = [multivariate_normal.logpdf(r, loss.jacobian @ z, spread) for r in (loss.without, loss.lost)]
    assert found == pytest.approx(exact[1] - exact[0], rel=1e-9)


def test_what_all_parts_exclude_stays_excluded() -> None:
    """Of independent normal residuals the limit is a quarter of the ratio, which the coarsening of joints takes off anyway."""
    loss, precision, way = linear(effect=0.5)
    whole = -0.5 * float(way @ way)
    found = limited(loss, 1.0, (precision, np.zeros(2)), np.arange(ROWS))
    assert whole < -30.0
    assert found == pytest.approx(0.25 * whole, rel=0.35)
    # With the variance of a coarsened posterior nothing is limited.
    coarse = limited(loss, 8.0, (precision, np.zeros(2)), np.arange(ROWS))
    assert coarse == pytest.approx(unlimited(loss, 8.0, (precision, np.zeros(2))), rel=1e-9)


def test_a_few_lines_exclude_nothing() -> None:
    """An antiresonance that the model has elsewhere: one cell of a hundred says all."""
    cells = np.arange(ROWS) // 4
    loss, precision, way = linear(effect=20.0, where=slice(40, 44))
    assert -0.5 * float(way @ way) < -200.0
    assert -0.6 < limited(loss, 1.0, (precision, np.zeros(2)), cells) < -0.3
    # Nor do they show a loss.
    loss, precision, way = linear(effect=20.0, lost=1.0, where=slice(40, 44))
    assert 0.3 < limited(loss, 1.0, (precision, np.zeros(2)), cells) < 0.6


def test_a_part_that_is_louder_than_the_others_does_not_silence_them() -> None:
    """One band at 28 000 and 47 others at 10 to 2000 each, all against a loss."""
    parts = np.append(np.geomspace(10.0, 2000.0, 47), 28_000.0)
    assert 0.5 * parts.sum() ** 2 / (parts @ parts) < 2.0
    # Capped at the least of them all parts say the same.
    assert significant(parts) == pytest.approx(24.0)
    # Beside parts that say nothing, or the contrary, it counts no more than before.
    assert significant(np.append(np.zeros(47), 28_000.0)) == pytest.approx(0.5)
    assert significant(np.append(-np.ones(47), 28_000.0)) < 0.5
    assert significant(-parts) == 0.0


@pytest.mark.parametrize(("count", "told"), [(1, 0.5), (2, 1.0), (5, 2.5), (6, 3.0)])
def test_few_parts_exclude_nothing_however_much_they_agree(count: int, told: float) -> None:
    """Each could prefer either model by chance: a verdict needs 2.94, which five of them never reach."""
    assert significant(np.full(count, 1e4)) == pytest.approx(told)


@given(st.lists(st.floats(-100.0, 100.0, allow_subnormal=False).map(lambda x: round(x, 3)), min_size=2, max_size=30))
def test_what_counts_is_the_most_over_all_caps(values: list[float]) -> None:
    """Compared with the definition, cap by cap."""
    parts, expected = np.array(values), 0.0
    for cap in np.unique(np.abs(parts)):
        capped = np.clip(parts, -cap, cap)
        if (total := float(capped.sum())) > 1e-9:
            expected = max(expected, min(total, 0.5 * total**2 / float(capped @ capped)))
    assert significant(parts) == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_some_springs_alone_may_have_lost_a_decade_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """A typical loss of them is excluded by far, the slight one is not; all springs of the joint are asked for the typical one."""
    asked: list[tuple[int, float]] = []

    def compare(terms: np.ndarray, decades: float, level: float) -> Sequence[Any]:
        asked.append((int(terms[0]), decades))
        return [-100.0 if decades == PRIOR.joint_loose_mean else -0.5]

    monkeypatch.setattr("lrbc_cli.updating.posterior.excluded.limited", lambda loss, *_: loss)
    monkeypatch.setattr("lrbc_cli.updating.posterior.excluded.as_shown", lambda loss: 2.0 * loss)
    two = np.zeros(2)
    problem = MixtureProblem(
        data=lambda z: (z, np.eye(2)), variance=1.0, bounds=np.tile([-4.0, 2.0], (2, 1)), bolts=np.arange(2), neighbours=(),
        joint=np.array([True, True]), mean=two, std=two + 1.0,
        springs=[Springs(0, None, np.array([7])), Springs(0, SpringsOf("axial"), np.array([8]))],
        losses=lambda _: compare, level_error=0.0, cells=np.arange(2),
    )  # fmt: skip
    state = State(kinds=np.array([False, True]), z=two, evidence=0.0, A=np.eye(2), b=two)
    found = {one.of: (one.ratio, one.shown) for one in loss_ratios(problem, PRIOR, state)}
    assert found == {None: pytest.approx((-100.0, -200.0)), SpringsOf("axial"): pytest.approx((-0.5, -1.0))}
    slight = PRIOR.joint_loose_mean + 0.6745 * PRIOR.joint_loose_std
    assert slight == pytest.approx(-0.96, abs=0.01)
    assert set(asked) == {(7, PRIOR.joint_loose_mean), (8, PRIOR.joint_loose_mean), (8, slight)}


@given(st.integers(0, 50), st.floats(0.01, 5.0), st.floats(0.0, 1.0), st.integers(1, 40))
def test_the_limit_changes_the_size_only(seed: int, effect: float, lost: float, width: int) -> None:
    loss, precision, _ = linear(seed, effect=effect, lost=lost)
    free = unlimited(loss, 2.0, (precision, np.zeros(2)))
    found = limited(loss, 2.0, (precision, np.zeros(2)), np.arange(ROWS) // width)
    assert abs(found) <= abs(free)
    assert found * free >= 0.0


@pytest.mark.parametrize(
    ("ratios", "told"),
    [((-40.0, -10.0), -10.0), ((-40.0, 5.0), 0.0), ((6.0, 9.0), 6.0), ((6.0, -1.0), 0.0)],
    ids=["excluded from both levels", "not from the lower one", "shown from both", "shown from one"],
)
@pytest.mark.parametrize("error", [0.25, 0.0])
def test_a_loss_also_counts_from_a_lower_level(
    monkeypatch: pytest.MonkeyPatch, ratios: tuple[float, float], told: float, error: float
) -> None:
    """Of the joint that is loose nothing is asked; the mean of the covariances counts."""
    asked: list[tuple[int, float, float]] = []

    def compare(terms: np.ndarray, decades: float, level: float) -> Sequence[Any]:
        asked.append((int(terms[0]), decades, level))
        value = ratios[0] if level == 0.0 else ratios[1]
        # Equal likelihoods in the mean.
        return [value - 0.5, value + float(np.log(2.0 - np.exp(-0.5)))]

    monkeypatch.setattr("lrbc_cli.updating.posterior.excluded.limited", lambda loss, *_: loss)
    monkeypatch.setattr("lrbc_cli.updating.posterior.excluded.as_shown", lambda loss: 2.0 * loss)
    two = np.zeros(2)
    problem = MixtureProblem(
        data=lambda z: (z, np.eye(2)), variance=1.0, bounds=np.tile([-4.0, 2.0], (2, 1)), bolts=np.arange(2), neighbours=(),
        joint=np.array([True, True]), mean=two, std=two + 1.0,
        springs=[Springs(0, None, np.array([7])), Springs(1, SpringsOf("axial"), np.array([8]))],
        losses=lambda _: compare, level_error=error, cells=np.arange(2),
    )  # fmt: skip
    state = State(kinds=np.array([False, True]), z=two, evidence=0.0, A=np.eye(2), b=two)
    ((joint, name, ratio, _),) = loss_ratios(problem, PRIOR, state)
    assert (joint, name) == (0, None)
    assert ratio == pytest.approx(told if error else ratios[0])
    assert {(terms, decades) for terms, decades, _ in asked} == {(7, PRIOR.joint_loose_mean)}
    assert [level for *_, level in asked] == [0.0, *([-NORMAL_95 * error] if error else [])]


def test_what_a_loss_would_show_is_its_ratio_if_the_frfs_are_those_of_the_state() -> None:
    rng = np.random.default_rng(3)
    without, change, J = 0.3 * rng.standard_normal(ROWS), rng.standard_normal(ROWS), rng.standard_normal((ROWS, 2))
    loss, precision, cells = SpringLoss(without=without, lost=without + change, jacobian=J), np.ones(2), np.arange(ROWS)
    shown = limited(as_shown(loss), 2.0, (precision, np.zeros(2)), cells)
    exact = limited(SpringLoss(without=np.zeros(ROWS), lost=change, jacobian=J), 2.0, (precision, np.zeros(2)), cells)
    assert shown == pytest.approx(exact)
    # Half the square of the change that the other unknowns cannot make, unless its significance is less.
    left = change @ change / 2.0 - (J.T @ change / 2.0) @ np.linalg.solve(J.T @ J / 2.0 + np.eye(2), J.T @ change / 2.0)
    assert -0.5 * left <= shown < 0.0
    nothing = as_shown(SpringLoss(without=without, lost=without, jacobian=J))
    assert limited(nothing, 2.0, (precision, np.zeros(2)), cells) == pytest.approx(0.0)
