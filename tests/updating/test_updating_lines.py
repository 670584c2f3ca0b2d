"""Resonances found on synthetic FRFs."""

from __future__ import annotations

import numpy as np
import pytest

from lrbc_cli.updating.statistics.lines import (
    RESONANCES,
    Resolution,
    Resonances,
    interpolated,
    missed,
    neighbour_sigma,
    phaseless,
    resolved,
    resonance_lines,
    too_wide,
    unresolved,
)

F = np.arange(20.0, 401.0)


def modal(frequencies, shapes, loss=0.01, f=F):
    """(F, R) sum of modes."""
    w2 = (2 * np.pi * np.asarray(frequencies)) ** 2
    return (np.asarray(shapes).T[None] / (w2 * (1 + 1j * loss) - (2 * np.pi * f[:, None, None]) ** 2)).sum(axis=-1)


MODES = [60.0, 131.0, 250.0]
SHAPES = [[1.0, 0.5, 0.8], [0.7, -0.9, 1.0], [1.0, 1.0, -0.6]]


def test_every_resonance_and_its_flanks():
    chosen = F[resonance_lines(F, modal(MODES, SHAPES))]
    for mode in MODES:
        assert {mode - 1, mode, mode + 1} <= set(chosen)
    assert chosen.size < 0.4 * F.size


def test_nothing_far_from_a_resonance():
    chosen = F[resonance_lines(F, modal(MODES, np.ones((3, 2))))]
    assert set(MODES) <= set(chosen)
    assert np.abs(chosen[:, None] - MODES).min(axis=1).max() <= RESONANCES.half_width * 250 + 1


def test_sorted_and_unique():
    chosen = resonance_lines(F, modal(MODES, SHAPES))
    assert np.all(np.diff(chosen) > 0)


def test_lines_end_15_db_below_the_peak():
    H = modal([200.0], [[1.0]], loss=0.002)
    chosen = resonance_lines(F, H)
    level = 20 * np.log10(np.abs(H[:, 0]))
    assert level[chosen].min() > level.max() - 15.0
    assert chosen.size >= 3


def test_wide_resonances_are_cut():
    chosen = F[resonance_lines(F, modal([200.0], [[1.0]], loss=0.1))]
    assert np.abs(chosen - 200).max() <= RESONANCES.half_width * 210 + 2


def test_a_resonance_reaches_over_its_half_power_bandwidth():
    """Heavily damped: a few lines at the top would be fewer than the unknowns, and a loose bolt was called tight by them."""
    H = modal([200.0], [[1.0]], loss=0.3)
    chosen, level = resonance_lines(F, H), 20 * np.log10(np.abs(H[:, 0]))
    np.testing.assert_array_equal(chosen, np.flatnonzero(level >= level.max() - 10 * np.log10(2)))
    assert np.ptp(F[chosen]) == pytest.approx(0.3 * 200, rel=0.1)


def test_flat_frfs_give_all_lines():
    np.testing.assert_array_equal(resonance_lines(F, np.full((F.size, 2), 1e-6 + 0j)), np.arange(F.size))
    np.testing.assert_array_equal(resonance_lines(F, (F[:, None] * (1 + 0j))), np.arange(F.size))


def test_noise_of_single_responses_is_no_resonance():
    """Antiphase spikes vanish in the mean of the responses."""
    rng = np.random.default_rng(0)
    H = np.repeat(modal(MODES, np.ones((3, 1))), 8, axis=1)
    noisy = H * 10.0 ** (rng.normal(scale=1.0, size=H.shape) / 20)
    chosen = F[resonance_lines(F, noisy)]
    assert all({mode - 1, mode, mode + 1} <= set(chosen) for mode in MODES)
    assert np.abs(chosen[:, None] - MODES).min(axis=1).max() <= 25


def test_missing_values_do_not_matter():
    H = modal(MODES, SHAPES)
    H[:60, 0] = np.nan
    H[40, :] = np.nan
    H[100, 1] = 0.0
    H = np.column_stack([H, np.full(F.size, np.nan)])
    chosen = F[resonance_lines(F, H)]
    for mode in MODES[1:]:
        assert {mode - 1, mode, mode + 1} <= set(chosen)


def test_one_response():
    chosen = F[resonance_lines(F, modal(MODES, SHAPES)[:, :1])]
    assert set(MODES) <= set(chosen)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_units_do_not_matter(scale):
    np.testing.assert_array_equal(resonance_lines(F, scale * modal(MODES, SHAPES)), resonance_lines(F, modal(MODES, SHAPES)))


def test_coarse_lines_keep_two_neighbours():
    coarse = np.arange(20.0, 401.0, 10.0)
    chosen = coarse[resonance_lines(coarse, modal([100.0], [[1.0]], loss=0.2, f=coarse))]
    assert {80.0, 90.0, 100.0, 110.0, 120.0} <= set(chosen)


def test_lines_wider_apart_than_the_peaks_are_told() -> None:
    """Half-power widths of 6 and of 0.06 Hz, lines 2 Hz apart."""
    f = np.arange(20.0, 400.0, 2.0)
    for damping, most_sharp in ((0.03, False), (3e-4, True)):
        H = sum(1.0 / (f0**2 - f**2 + 2j * damping * f0 * f) for f0 in np.linspace(50.7, 380.3, 9))
        found = unresolved(f, np.column_stack([H, np.full(f.size, np.nan)]))
        assert found.peaks.size >= 5
        assert (2 * found.sharp.size > found.peaks.size) == most_sharp


@pytest.mark.parametrize(("apart", "share"), [(0.5, 0.0), (1.0, 0.25), (1.6, 0.5)])
def test_share_of_peaks_that_fall_to_both_sides(apart: float, share: float) -> None:
    """Resonances anywhere between lines that lie so many half-power widths apart."""
    step, rng = 1.0, np.random.default_rng(0)
    f = np.arange(180.0, 221.0, step)
    f0 = 200.0 + step * rng.random(400)
    found = unresolved(f, 1.0 / (f0**2 - f[:, None] ** 2 + 1j * step / apart * f0))
    assert found.peaks.size == 400
    assert found.sharp.size / 400 == pytest.approx(share, abs=0.06)


def test_a_third_is_too_wide() -> None:
    """Between one and one and a half half-power widths; jobs count together."""
    f, f0 = np.arange(180.0, 221.0), 200.0 + np.linspace(0.0, 1.0, 60, endpoint=False)
    fine, coarse = (1.0 / (f0**2 - f[:, None] ** 2 + 1j * f0 / apart) for apart in (0.9, 3.0))
    assert too_wide((f, fine)) is None
    assert too_wide((f, coarse)) is not None
    assert too_wide((f, fine), (f, fine), (f, fine), (f, coarse)) is None
    assert too_wide((f, np.full((41, 2), np.nan))) is None
    both = too_wide((f, fine), (f, coarse))
    assert both is not None
    assert "of 120 peaks fall by more than 6 dB to both neighbouring lines" in both.text


def many_modes(f: np.ndarray, damping: float) -> np.ndarray:
    """Four responses of twelve resonances, each in its own share."""
    shares = np.random.default_rng(1).uniform(0.5, 2.0, (12, 4))
    f0 = np.linspace(50.7, 380.3, 12)
    modes = 1.0 / (f0[:, None] ** 2 - f**2 + 2j * damping * f0[:, None] * f)
    return np.asarray((modes[:, :, None] * shares[:, None, :]).sum(axis=0))


@pytest.mark.parametrize(
    ("noisy", "said"),
    [
        (lambda f: f > 250.0, ("them from 25", "let reduction.band end there")),
        (lambda f: f < 150.0, ("them up to 14", "let reduction.band begin there")),
        (lambda f: f > 0.0, ("at other lines; measure with more averages",)),
    ],
)
def test_noise_is_no_lack_of_lines(noisy, said) -> None:
    """Peaks of noise fall to both sides, too; other responses do not have them."""
    f, rng = np.arange(20.0, 400.0, 0.5), np.random.default_rng(0)
    H = many_modes(f, 0.01)
    assert too_wide((f, H)) is None
    noise = 3.0 * np.abs(H) * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape))
    found = too_wide((f, H + np.where(noisy(f)[:, None], noise, 0.0)))
    assert found is not None
    assert found.text.startswith("probably noise: ")
    assert all(part in found.text for part in said)


def test_a_few_sharp_peaks_are_no_noise() -> None:
    """Of two sharp peaks in two responses nothing tells that they are apart for noise."""
    f = np.arange(20.0, 400.0, 1.0)
    centres = np.array([[60.5, 120.0, 180.5, 240.0, 300.5], [63.0, 121.5, 182.0, 242.0, 302.5]]).T
    widths = np.full(centres.shape, 3.0)
    widths[0, 0], widths[0, 1] = 0.2, 0.2
    centres[0] = 60.0, 63.0
    H = (1.0 / (centres**2 - f[:, None, None] ** 2 + 1j * centres * widths)).sum(axis=1)
    found = unresolved(f, H)
    assert (found.peaks.size, found.sharp.size) == (10, 2)
    assert too_wide((f, H)) is None


def test_resonances_between_the_lines_are_no_noise() -> None:
    """All responses have them at the same lines."""
    f = np.arange(20.0, 400.0, 2.0)
    found = too_wide((f, many_modes(f, 3e-4)))
    assert found is not None
    assert found.text.startswith("lines too far apart: ")


@pytest.mark.parametrize("every", [2, 3, 4, 8])
def test_lines_on_straight_lines_are_told(every):
    fine = np.arange(F[0], F[-1], 1.0 / every)
    H, noise = modal(MODES, SHAPES), np.random.default_rng(0).normal(size=(F.size, 3))
    H *= 1.0 + 0.01 * noise
    between = np.column_stack([np.interp(fine, F, column) for column in H.T])
    rounded = np.round(between / 1e-11) * 1e-11
    for values in (between, rounded):
        assert f"one of {every} lines was measured" in (interpolated(values) or "")


def test_measured_lines_are_not_taken_for_interpolated_ones():
    """Closely spaced, zero padded, noisy, of few digits, flat, partly missing: none bends at some lines only."""
    H = modal(MODES, SHAPES, f=np.arange(20.0, 401.0, 0.1))
    noise = np.random.default_rng(1).normal(size=(2, *H.shape))
    padded = np.fft.fft(np.pad(np.fft.ifft(modal(MODES, SHAPES), axis=0), ((0, 3 * F.size), (0, 0))), axis=0)
    holes = modal(MODES, SHAPES)
    holes[100:300, 0] = np.nan
    coarse = np.round(H / np.median(np.abs(H)), 1)
    for values in (
        H,
        H + 1e-3 * np.abs(H).mean() * (noise[0] + 1j * noise[1]),
        padded,
        coarse,
        np.ones((400, 2), dtype=complex),
        holes,
        H[:5],
    ):
        assert interpolated(values) is None


@pytest.mark.parametrize("share", [0.02, 0.1, 0.3])
def test_noise_by_neighbouring_lines(share: float) -> None:
    """Of the noise that each line has on its own, as large as told; resonances and antiresonances do not count."""
    f, rng = np.arange(20.0, 400.0, 0.25), np.random.default_rng(3)
    H = many_modes(f, 0.02)
    noise = (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2.0)
    sigma = neighbour_sigma(H * (1.0 + share * noise), 15)
    assert sigma.shape == H.shape
    # Half of the variance lies along the magnitude.
    assert np.nanmedian(sigma) == pytest.approx(20.0 / np.log(10.0) * share / np.sqrt(2.0), rel=0.1)
    assert np.nanmedian(neighbour_sigma(H, 15)) < 0.02
    assert np.nanmax(neighbour_sigma(H, 15)) < 1.0


def test_noise_alone_by_neighbouring_lines() -> None:
    rng = np.random.default_rng(4)
    noise = rng.normal(size=(200, 3)) + 1j * rng.normal(size=(200, 3))
    noise[50:60, 1] = np.nan
    sigma = neighbour_sigma(noise, 15)
    assert np.isfinite(sigma).all()
    assert 4.0 < np.nanmedian(sigma) < 9.0
    assert np.isnan(neighbour_sigma(np.full((30, 1), np.nan + 0j), 15)).all()


@pytest.mark.parametrize(("damping", "noise", "expected"), [(0.02, 0.0, True), (1e-4, 0.0, False), (0.02, 1.0, True)])
def test_noise_is_no_peak_that_lines_do_not_resolve(damping: float, noise: float, expected: bool) -> None:
    f, rng = np.arange(20.0, 400.0, 2.0), np.random.default_rng(5)
    H = many_modes(f, damping)
    H = H + noise * np.median(np.abs(H), axis=0) * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape))
    assert resolved(f, H) == expected


def test_peaks_count_by_the_rule_of_the_campaign() -> None:
    magnitudes = np.abs(modal(MODES, SHAPES)) + 0j
    assert phaseless(magnitudes) == [0, 1, 2]
    assert phaseless(magnitudes, Resolution(prominence_db=100.0)) == []
    assert phaseless(modal(MODES, SHAPES)) == []
    # Without any damping all are real; one that alone is real has lost its imaginary part.
    assert phaseless(modal([60.3, 131.2, 250.4], SHAPES, loss=0.0)) == []
    shifted = modal(MODES, SHAPES)
    shifted[:, 2] = shifted[:, 2].real
    assert phaseless(shifted) == [2]
    few = np.array([40, 41])
    empty, count = missed(F, magnitudes, few)
    assert 0 < empty == count - 1
    assert missed(F, magnitudes, few, Resonances(prominence_db=100.0))[1] == 0
