import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lrbc_cli.updating.comparison.correlation import (
    correlate,
    fdac,
    frac,
    match_peaks,
    mean_spectrum,
    measured_values,
    quantity_weights,
    spectrum_peaks,
)

MODES = np.array([40.0, 75.0, 110.0, 160.0])


def rig(frequency, shift=0.0, responses=5, seed=2):
    """FRFs of a few modes with shapes of their own, shifted in frequency by a fraction."""
    shapes = np.random.default_rng(seed).normal(size=(MODES.size, responses))
    modes = MODES * (1 + shift)
    return (1e4 / (modes**2 - frequency[:, None] ** 2 + 0.02j * modes * frequency[:, None])) @ shapes


@st.composite
def frfs(draw):
    seed, lines, responses = draw(st.integers(0, 2**31)), draw(st.integers(1, 12)), draw(st.integers(1, 5))
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(2, 2, lines, responses))
    measured, model = H[0] + 1j * H[1]
    measured[rng.random(measured.shape) < draw(st.floats(0, 0.7))] = np.nan
    return measured, model


scales = st.tuples(st.floats(-150, 150), st.floats(0, 6.28)).map(lambda pair: 10.0 ** pair[0] * np.exp(1j * pair[1]))


@given(frfs(), scales, scales)
@settings(max_examples=60, deadline=None)
def test_frac_is_a_share_that_no_factor_changes(pair, a, b):
    measured, model = pair
    value = frac(measured, model)
    known = np.isfinite(value)
    assert np.array_equal(known, measured_values(measured).any(axis=0))
    assert np.all((value[known] >= 0) & (value[known] <= 1))
    np.testing.assert_allclose(frac(a * measured, b * model)[known], value[known], atol=1e-9)
    np.testing.assert_allclose(frac(measured, b * measured)[known], 1.0, rtol=1e-12)


def test_frac_by_hand():
    measured, model = np.array([[1.0 + 0j], [1j]]), np.array([[1.0 + 0j], [1.0]])
    # |1 + conj(i)|² / (2 * 2) = |1 - i|² / 4
    assert frac(measured, model)[0] == pytest.approx(0.5)
    measured = np.array([[1.0 + 0j, np.nan], [np.nan, np.nan], [2.0, 0.0]])
    np.testing.assert_allclose(frac(measured, np.array([[1.0 + 0j, 1], [99, 1], [2, 1]])), [1.0, np.nan])


@given(frfs(), st.floats(-150, 150), st.floats(-150, 150))
@settings(max_examples=60, deadline=None)
def test_fdac_is_a_cosine_that_no_gain_changes(pair, a, b):
    measured, model = pair
    value = fdac(measured, model)
    known = measured_values(measured).sum(axis=1) >= 2
    assert np.isfinite(value[known]).all()
    assert np.isnan(value[~known]).all()
    assert np.all(np.abs(value[known]) <= 1)
    np.testing.assert_allclose(fdac(10.0**a * measured, 10.0**b * model)[known], value[known], atol=1e-9)
    np.testing.assert_allclose(fdac(measured, -model)[known], -value[known], atol=1e-12)
    np.testing.assert_allclose(np.diag(fdac(measured, np.nan_to_num(measured)))[known], 1.0, rtol=1e-12)


def test_fdac_against_its_definition():
    rng = np.random.default_rng(0)
    H = rng.normal(size=(2, 2, 6, 4))
    measured, model = H[0] + 1j * H[1]
    measured[2, 1] = np.nan
    model[5, 0] = np.nan
    value = fdac(measured, model)
    for i in range(6):
        keep = np.isfinite(measured[i])
        for j in range(5):
            a, b = measured[i, keep], model[j, keep]
            assert value[i, j] == pytest.approx(np.vdot(a, b).real / np.linalg.norm(a) / np.linalg.norm(b), rel=1e-12)
    assert np.isnan(value[:, 5]).all()


def test_fdac_shows_a_shift_beside_the_diagonal():
    f = np.arange(30.0, 180.0)
    value = fdac(rig(f, 0.05), rig(f))
    # The measured rig is 5 % stiffer in frequency: its line f is the model's line f / 1.05.
    for mode in MODES[1:]:
        at = int(np.argmin(np.abs(f - mode * 1.05)))
        near = np.abs(f - mode) < 12
        assert f[near][np.argmax(value[at, near])] == pytest.approx(mode, abs=1.0)
        assert value[at, near].max() > 0.9


def test_quantities_count_alike():
    f = np.arange(30.0, 180.0)
    H = rig(f, responses=4)
    other = H * np.array([1.0, 1.0, 1e6, 1e6])
    weights = quantity_weights(other, ("pressure", "pressure", "acceleration", "acceleration"))
    size = np.sqrt(np.mean(np.abs(other * weights) ** 2, axis=0))
    np.testing.assert_allclose([np.hypot(*size[:2]), np.hypot(*size[2:])], np.sqrt(2))
    np.testing.assert_array_equal(quantity_weights(other, ("pressure",) * 4), np.ones(4))


@given(st.floats(35.2, 44.8), st.floats(0.3, 3.0))
@settings(deadline=None)
def test_a_peak_is_placed_between_the_lines(peak, width):
    f = np.arange(20.0, 60.0)
    found = spectrum_peaks(f, -((f - peak) ** 2) / width)
    assert found.frequency_hz == pytest.approx([peak], abs=1e-9)
    assert abs(f[found.line[0]] - peak) <= 0.5 + 1e-9


def test_uneven_lines_have_peaks_too():
    f = np.array([10.0, 11.0, 13.0, 14.0, 17.0, 18.0])
    assert spectrum_peaks(f, -((f - 13.4) ** 2)).frequency_hz == pytest.approx([13.4])


def test_a_gap_makes_no_peak():
    f = np.arange(20.0, 60.0)
    level = -((f - 40.0) ** 2)
    level[20] = np.nan
    assert spectrum_peaks(f, level).frequency_hz.size == 0
    assert spectrum_peaks(f, np.full(40, np.nan)).frequency_hz.size == 0


def test_peaks_pair_off_one_to_one_within_the_tolerance():
    measured = np.array([100.0, 104.0, 200.0, 300.0])
    model = np.array([101.0, 105.0, 108.0, 290.5, 350.0])
    np.testing.assert_array_equal(match_peaks(measured, model), [0, 1, -1, 3])
    # As many pairs as there can be, though the nearest one is then another's.
    np.testing.assert_array_equal(match_peaks(np.array([100.0, 103.0]), np.array([103.0, 106.0])), [0, 1])
    # Shapes that cross keep their resonance.
    alike = np.array([[0.1, 0.95], [0.95, 0.1]])
    np.testing.assert_array_equal(match_peaks(np.array([100.0, 102.0]), np.array([100.0, 102.0]), alike), [1, 0])
    np.testing.assert_array_equal(match_peaks(np.array([100.0]), np.array([100.0]), np.array([[0.2]])), [-1])
    assert match_peaks(np.array([100.0]), np.empty(0)).tolist() == [-1]


@given(st.floats(-0.03, 0.03))
@settings(max_examples=25, deadline=None)
def test_a_known_shift_is_found(shift):
    f = np.arange(30.0, 180.0, 0.5)
    found = correlate(f, rig(f), rig(f, shift), rig(f, 0.1 * shift))
    initial, final = found.mean_peaks.shifts_percent()
    assert found.mean_peaks.measured_hz == pytest.approx(MODES, rel=5e-3)
    assert initial == pytest.approx(100 * abs(shift), abs=0.15)
    assert final == pytest.approx(10 * abs(shift), abs=0.15)
    assert np.all(found.frac_final >= found.frac_initial - 1e-9)


def test_equal_frfs_agree_in_every_figure():
    f = np.arange(30.0, 180.0)
    H = rig(f)
    found = correlate(f, H, H, H, grid=40)
    assert found.lines.size == 40
    np.testing.assert_allclose(np.diag(found.fdac_final), 1.0)
    np.testing.assert_allclose(found.frac_final, 1.0)
    assert found.mean_peaks.shifts_percent() == (0.0, 0.0)
    for table in found.peaks:
        np.testing.assert_array_equal(table.measured_hz, table.final_hz)


def test_missing_responses_and_lines_are_left_out():
    f = np.arange(30.0, 180.0)
    measured = rig(f)
    measured[:, 3] = np.nan
    measured[60:70, 0] = np.nan
    found = correlate(f, measured, rig(f, 0.02), rig(f))
    assert np.isnan(found.frac_final[3])
    assert found.peaks[3].measured_hz.size == 0
    assert np.isnan(found.peaks[3].shifts_percent()).all()
    np.testing.assert_allclose(found.frac_final[[0, 1, 2, 4]], 1.0)
    np.testing.assert_allclose(np.diag(found.fdac_final), 1.0)
    assert np.isnan(mean_spectrum(measured, measured_values(measured))[60:70]).all()


def test_a_single_response_has_no_shape_to_compare():
    f = np.arange(30.0, 180.0)
    found = correlate(f, rig(f)[:, :1], rig(f, 0.02)[:, :1], rig(f)[:, :1])
    assert np.isnan(found.fdac_final).all()
    assert np.isfinite(found.peaks[0].initial_hz).any()
    nothing = correlate(f, np.full((f.size, 2), np.nan + 0j), rig(f, responses=2), rig(f, responses=2))
    assert np.isnan(nothing.frac_final).all()
    assert nothing.mean_peaks.measured_hz.size == 0
