"""Lines that follow from their neighbours are left out; the noise is then judged by neighbours among those that are left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lrbc_cli.updating.statistics.lines import RESONANCES, resonance_lines
from lrbc_cli.updating.statistics.noise import correlation_factor
from lrbc_cli.updating.statistics.thinning import ranks, thinned


def modes(f, loss, at=(60.0, 131.0, 250.0), shapes=((1.0, 0.5), (0.7, -0.9), (1.0, 1.0))):
    """(F, R) sum of modes with a loss factor."""
    w2 = (2 * np.pi * np.asarray(at)) ** 2
    return (np.asarray(shapes).T[None] / (w2 * (1 + 1j * loss) - (2 * np.pi * f[:, None, None]) ** 2)).sum(axis=-1)


def interpolated(f, H, at):
    """(F, R) linear interpolation from the lines at some indices (numpy interpolates complex values, too)."""
    return np.column_stack([np.interp(f, f[at], column[at]) for column in H.T])


@pytest.mark.parametrize(("step", "loss"), [(0.125, 0.01), (0.125, 0.03), (0.25, 0.03), (1.0, 0.1)])
def test_the_rest_follows_from_what_is_kept(step, loss):
    f = np.arange(20.0, 400.0, step)
    H = modes(f, loss)
    near = resonance_lines(f, H)
    kept = thinned(f, H, near)
    assert kept.size < 0.6 * near.size
    assert set(kept.tolist()) <= set(near.tolist())
    for run in np.split(near, np.flatnonzero(np.diff(near) > 1) + 1):
        own = kept[np.isin(kept, run)]
        found = interpolated(f[run], H[run], np.flatnonzero(np.isin(run, own)))
        assert np.all(np.abs(found - H[run]).max(axis=0) <= 0.1 * np.abs(H[run]).max(axis=0))
        assert own.size >= 5


@pytest.mark.parametrize("lines", [1.0, 1.5, 2.5, 5.0, 10.0, 20.0, 40.0])
def test_a_peak_keeps_about_three_lines_in_its_half_power_bandwidth(lines):
    f = np.arange(20.0, 400.0, 0.25)
    H = modes(f, 0.25 * lines / 200.0, at=(200.0,), shapes=((1.0, 0.5),))
    near = resonance_lines(f, H)
    kept = thinned(f, H, near)
    wide = np.abs(H[kept, 0]) >= np.abs(H[:, 0]).max() / np.sqrt(2)
    if lines <= 5.0:
        np.testing.assert_array_equal(kept, near)
    else:
        assert 3 <= wide.sum() <= 7


def test_a_sharp_peak_of_one_response_keeps_all_lines():
    f = np.arange(20.0, 400.0, 0.25)
    H = modes(f, 0.05, at=(200.0,), shapes=((1.0, 0.5),))
    near = resonance_lines(f, H)
    assert thinned(f, H, near).size < 0.5 * near.size
    H[:, 1] += 0.5 * np.abs(H[:, 1]).max() * 1j / (1 + 1j * (f - 203.0) / 0.3)
    np.testing.assert_array_equal(thinned(f, H, near), near)


@pytest.mark.parametrize("level_db", [-8.0, -10.0, -14.0])
def test_a_low_narrow_peak_beside_a_high_wide_one_keeps_lines(level_db):
    """Within 10 % of the high peak, interpolation missed most of the low one: one of its five lines was left."""
    f = np.arange(60.0, 160.0, 0.1)
    high = modes(f, 0.02, at=(100.0,), shapes=((1.0,),))
    low = modes(f, 0.004, at=(107.0,), shapes=((1.0,),))
    H = high / np.abs(high).max() + 10 ** (level_db / 20) * low / np.abs(low).max()
    near = resonance_lines(f, H)
    assert near[0] < 400
    assert near[-1] > 475
    kept = thinned(f, H, near)
    assert np.count_nonzero(np.abs(f[kept] - 107.0) <= 0.5 * 0.004 * 107.0 + 0.05) >= 3


def test_few_lines_whatever_the_rule():
    few = 1.0 + 0.01 * np.arange(5)[:, None] + 0j
    for least in (1, 2, 5):
        rule = replace(RESONANCES, least_lines=least)
        for count in (1, 2, 3, 5):
            kept = thinned(np.arange(100.0, 100.0 + count), few[:count], np.arange(count), rule)
            assert kept[0] == 0
            assert kept[-1] == count - 1
            silent = np.full((count, 1), np.nan + 0j)
            assert thinned(np.arange(100.0, 100.0 + count), silent, np.arange(count), rule).size


def test_noise_and_gaps_keep_lines():
    """Noise above the fraction does not follow from its neighbours, nor does a value beside a missing one; nothing but gaps is no fault."""
    f = np.arange(20.0, 400.0, 0.25)
    H = modes(f, 0.05)
    near = resonance_lines(f, H)
    rng = np.random.default_rng(3)
    noise = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    noisy = H + 0.2 * noise * np.abs(H[near]).max(axis=0)
    np.testing.assert_array_equal(thinned(f, noisy, near), near)
    gap = H.copy()
    gap[near[:200:2], 0] = np.nan
    assert thinned(f, gap, near).size > thinned(f, H, near).size
    silent = np.column_stack([H, np.full(f.size, np.nan)])
    np.testing.assert_array_equal(thinned(f, silent, near), thinned(f, H, near))
    assert thinned(f, H, near[:0]).size == 0


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 400), min_size=1, max_size=60, unique=True).map(sorted))
def test_ranks_ascend_and_do_not_depend_on_the_spacing(lines):
    lines = np.array(lines)
    found = ranks(lines)
    assert found[0] == 0
    assert np.all(np.diff(found) >= 1)
    np.testing.assert_array_equal(ranks(5 * lines + 3), found)


def test_ranks_of_runs():
    np.testing.assert_array_equal(ranks(np.array([3, 4, 5, 20, 21, 22])), [0, 1, 2, 17, 18, 19])
    np.testing.assert_array_equal(ranks(np.array([4, 8, 12, 16, 60, 64, 68])), [0, 1, 2, 3, 14, 15, 16])
    np.testing.assert_array_equal(ranks(np.array([0, 1, 2, 40, 44, 48])), [0, 1, 2, 12, 13, 14])


def test_correlated_residuals_count_as_correlated_on_a_comb():
    """Residuals on every fourth line with a correlation of 0.8 from one to the next: by measured lines they had no neighbours."""
    rng = np.random.default_rng(5)
    residual = np.zeros(400)
    for k in range(1, 400):
        residual[k] = 0.8 * residual[k - 1] + 0.6 * rng.standard_normal()
    lines, J, one = 4 * np.arange(400), np.ones((400, 1)), np.zeros(400, dtype=int)
    told = correlation_factor(residual, J, ranks(lines), one)
    assert told > 4.0
    assert correlation_factor(residual, J, np.arange(400), one) == pytest.approx(told)
    assert correlation_factor(residual, J, lines, one) == 1.0


def test_the_default_rule():
    assert (RESONANCES.followed, RESONANCES.least_lines) == (0.1, 5)
