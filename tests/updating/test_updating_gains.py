"""A gain that all responses share: found, and taken out of the cost."""

from __future__ import annotations

import numpy as np
import pytest

from lrbc_cli.updating.statistics.chain.blows import blow_spread, differing_blows, second_blow, too_many_blows
from lrbc_cli.updating.statistics.residuals import DataResidual, ResidualOptions

LINES, RESPONSES = 200, 3
CASES = [ResidualOptions(kind=kind, loss_scale=loss) for kind in ("db", "log-complex") for loss in (None, 3.0)]


def values(seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(size=(LINES, RESPONSES)) + 1j * rng.uniform(-1.0, 1.0, (LINES, RESPONSES)))


def cost(data: DataResidual, y: np.ndarray) -> float:
    own, _, _ = data(y, np.zeros((*y.shape, 0), dtype=complex))
    return float(own @ own)


@pytest.mark.parametrize("options", CASES, ids=lambda o: f"{o.kind}-{o.loss_scale}")
def test_it_is_found_and_costs_no_more_than_its_prior(options):
    y = values()
    plain = DataResidual(y * 10.0 ** (1.0 / 20.0), options)
    gains = plain.with_gains(np.ones((RESPONSES, 1)))
    assert plain.gains_db(y) is None
    # Squares grow as they should; the soft loss is linearised where differences are small.
    np.testing.assert_allclose(gains.gains_db(y), 1.0, atol=0.06)
    assert cost(plain, y) > 0.8 * LINES * RESPONSES
    assert cost(gains, y) < (1.1 if options.loss_scale is None else 4.0)


@pytest.mark.parametrize("options", CASES, ids=lambda o: f"{o.kind}-{o.loss_scale}")
def test_linearised_about_itself_it_is_exact_also_with_a_loss(options):
    y = values()
    change, band = np.zeros(y.shape), np.zeros(LINES, dtype=np.int64)
    shifts = np.zeros((*y.shape, 1), dtype=complex)
    data = DataResidual(y * 10.0 ** (2.0 / 20.0), options).with_gains(np.ones((RESPONSES, 1)))
    about = data.with_change(y, change, 1.0, shifts, band)
    np.testing.assert_allclose(about.gains_db(y), 2.0, atol=0.03)
    alone = data.gained_about(y)
    np.testing.assert_allclose(alone.gains_db(y), 2.0, atol=0.03)
    assert cost(alone, y) < 4.1
    assert np.abs(alone(y, np.zeros((*y.shape, 0), dtype=complex))[2]).max() < 0.03
    # Nothing is linearised where no gain is allowed for.
    plain = DataResidual(y, options)
    assert plain.gained_about(y) is plain


def test_the_difference_is_told_without_it():
    y = values()
    data = DataResidual(2.0 * y).with_gains(np.full((RESPONSES, 1), 10.0))
    _, _, difference = data(y, np.zeros((*y.shape, 0)))
    assert np.abs(difference).max() < 0.01


def test_its_standard_deviation_is_that_of_a_mean_beside_unknowns():
    rng = np.random.default_rng(2)
    y, J = values(), rng.normal(size=(LINES, RESPONSES, 2))
    data = DataResidual(y).with_gains(np.full((RESPONSES, 1), 100.0))
    _, rows, _ = data(y, J)
    covariance = 0.25 * np.linalg.inv(rows.T @ rows)
    exact = np.linalg.inv((A := np.column_stack([J.reshape(-1, 2), np.ones(y.size)])).T @ A)[2, 2]
    np.testing.assert_allclose(data.gains_std(rows, covariance, 0.25), 0.5 * np.sqrt(exact), rtol=1e-3)


@pytest.mark.parametrize("size", [0.3, 0.6])
def test_a_second_blow_in_either_job(size):
    hz, tight = np.arange(30.0, 430.0), np.ones((400, 2), dtype=complex)
    own = tight * np.exp(0.02 * np.random.default_rng(3).normal(size=tight.shape))
    twice = (1.0 + size * np.exp(-2j * np.pi * hz * 0.02))[:, None]
    assert second_blow(hz, own, tight, "tight") is None
    told = str(second_blow(hz, own * twice, tight, "tight"))
    assert "the hammer probably hit a second time in this job, 20" in told
    assert f"ms later and {size:.0%} as hard" in told
    assert "the hammer probably hit a second time in tight" in str(second_blow(hz, own, tight * twice, "tight"))


def test_blows_of_two_states_are_not_noise() -> None:
    """Half of the blows are those of another state: a low coherence, and smooth lines. Noise makes both rough."""
    hz, rng = np.linspace(20.0, 400.0, 381), np.random.default_rng(4)

    def state(shift: float) -> np.ndarray:
        poles = np.array([70.0, 150.0, 260.0, 330.0]) * shift
        return np.stack([(hz[:, None] ** 2 / (poles**2 - hz[:, None] ** 2 + 0.04j * poles * hz[:, None])).sum(axis=1)] * 3, axis=1)

    def averaged(blows: list[np.ndarray], noise: float) -> tuple[np.ndarray, np.ndarray]:
        each = np.array(blows)
        each = each + noise * np.abs(each) * (rng.standard_normal(each.shape) + 1j * rng.standard_normal(each.shape)) / np.sqrt(2.0)
        mean = each.mean(axis=0)
        return mean, np.abs(mean) ** 2 / (np.abs(each) ** 2).mean(axis=0)

    tight, loose = state(1.0), state(0.9)
    mixed = differing_blows(*averaged([tight] * 4 + [loose] * 4, 0.02), 8)
    assert mixed is not None
    assert "the blows probably differ from each other" in mixed
    for blows, noise in (([tight] * 8, 0.02), ([tight] * 8, 0.8)):
        assert differing_blows(*averaged(blows, noise), 8) is None
    # Two of five blows: seen beside a reference job whose blows are alike, and not beside one whose blows differ as well.
    few, usual = averaged([tight] * 3 + [state(0.97)] * 2, 0.02), blow_spread(*averaged([tight] * 5, 0.02), 5)
    assert usual is not None
    assert usual == pytest.approx(1.0, abs=0.3)
    spread = blow_spread(*few, 5)
    assert spread is not None
    assert spread > 2.0
    assert differing_blows(*few, 5, usual=usual) is not None
    # One of five, whose peaks moved by less: noise of 6 % by the coherence, and lines that agree within a fifth of that.
    one = averaged([tight] * 4 + [state(0.985)], 0.003)
    assert differing_blows(*one, 5, usual=usual) is not None
    assert differing_blows(*averaged([tight] * 4 + [state(0.999)], 0.003), 5, usual=usual) is None
    rough = averaged([tight] * 3 + [state(0.97)] * 2, 0.2)
    assert 1.7 < (blow_spread(*rough, 5) or 0.0) < 2.5
    assert differing_blows(*rough, 5, usual=usual) is not None
    assert differing_blows(*rough, 5, usual=2.0) is None
    assert differing_blows(*rough, 5) is None
    # Beside a reference job whose blows differ by far, the limit is that without one.
    half = averaged([tight] * 4 + [loose] * 4, 0.02)
    assert (blow_spread(*half, 8) or 0.0) > 3.0
    assert differing_blows(*half, 8, usual=9.0) is not None
    values, coherence = averaged([tight] * 4 + [loose] * 4, 0.02)
    assert blow_spread(values, np.full_like(coherence, np.nan), 8) is None
    assert differing_blows(values, np.full_like(coherence, np.nan), 8) is None
    assert differing_blows(values, coherence, 1) is None


def test_more_blows_than_the_scatter_of_the_lines_allows():
    """The noise of five blows, with 500 stated; a right number and an unknown coherence say nothing."""
    rng = np.random.default_rng(4)
    hz, blows, noise = np.linspace(20.0, 220.0, 400), 5, 0.03
    frf = sum(hz[:, None] ** 2 / (pole**2 * (1 + 0.02j) - hz[:, None] ** 2) for pole in (60.0, 130.0, 190.0)) * [1.0, 0.7, 1.3]
    each = noise * np.abs(frf).mean() * (rng.normal(size=(blows, *frf.shape)) + 1j * rng.normal(size=(blows, *frf.shape)))
    values, share = frf + each.mean(axis=0), 2.0 * (noise * np.abs(frf).mean() / np.abs(frf)) ** 2
    coherence = 1.0 / (1.0 + share)
    said = too_many_blows(values, coherence, 500)
    assert said is not None
    assert said.startswith("averages: 500 is too large: neighbouring lines scatter")
    assert "Write the number of blows" in said
    assert int(said.split("about ")[1].split()[0]) in range(2, 9)
    assert too_many_blows(values, coherence, 5) is None
    assert too_many_blows(values, coherence, 8) is None
    assert too_many_blows(values, np.full_like(coherence, np.nan), 500) is None
    assert too_many_blows(values, np.ones_like(coherence), 500) is None
