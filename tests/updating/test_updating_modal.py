"""Windows and filters told by the modes of two measurements, and loosened bolts that are neither."""

from __future__ import annotations

import numpy as np
import pytest
from samples import ROOT

from lrbc_cli.io.frf import read_frf
from lrbc_cli.updating.statistics.chain.modal import fitted_modes, other_chain, same_modes, window_of_model
from lrbc_cli.updating.statistics.chain.runs import other_run

F = np.arange(30.0, 501.0, 1.0)
OMEGA = 2 * np.pi * np.array([62.0, 118.0, 171.0, 240.0, 333.0, 421.0])
DECAY = np.array([2.0, 3.0, 3.5, 5.0, 8.0, 11.0])
SHAPES = np.random.default_rng(3).standard_normal((6, 5))
NAMES = [f"a{k + 1}" for k in range(5)]


def frfs(omega=OMEGA, decay=DECAY, shapes=SHAPES, window=0.0, noise=0.003, seed=0):
    """(F, R) accelerances of a structure with these modes; an exponential window moves the axis, s + window for s."""
    s = 2j * np.pi * F[:, None] + window
    modes = 1 / ((s + decay) ** 2 + omega**2)
    H = s**2 * (modes @ (shapes * shapes[:, :1] + 0.1))
    rng = np.random.default_rng(seed)
    return H * (1 + noise * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)))


def test_frequency_and_decay_of_well_parted_modes():
    found = fitted_modes(F, frfs())
    assert found.decay.size >= 5
    for hz, decay in zip(found.frequency_hz, found.decay, strict=True):
        k = np.argmin(np.abs(OMEGA / 2 / np.pi - hz))
        assert hz == pytest.approx(OMEGA[k] / 2 / np.pi, abs=0.1)
        assert decay == pytest.approx(DECAY[k], rel=0.1)


@pytest.mark.parametrize("end", [0.2, 0.01])
def test_a_window_in_one_of_two_measurements(end):
    tight, own = frfs(), frfs(OMEGA * [0.97, 1.0, 0.99, 1.0, 0.98, 1.0], window=-np.log(end), seed=1)
    kind, text = other_chain(F, own, tight, "tight", NAMES) or ("", "")
    assert kind == "window"
    assert "decay faster than in tight" in text
    assert "set for this job" in text
    told = float(text.partition("about ")[2].partition(" %")[0])
    assert told / 100 == pytest.approx(end, rel=0.2)
    other = other_chain(F, tight, own, "windowed", NAMES)
    assert other is not None
    assert "set for windowed" in other.text


def test_a_window_beside_a_model():
    """Of all jobs alike; a model damped otherwise, or with few modes, says nothing."""
    window = -np.log(0.01)
    count, rate = window_of_model(F, frfs(window=window, seed=1), frfs(noise=0.0))
    assert count >= 4
    assert rate == pytest.approx(window, rel=0.1)
    assert window_of_model(F, frfs(decay=2.5 * DECAY, seed=1), frfs(noise=0.0)) == (0, 0.0)
    assert window_of_model(F, frfs(seed=1), frfs(window=window, noise=0.0)) == (0, 0.0)
    assert window_of_model(F[:150], frfs(window=window)[:150], frfs(noise=0.0)[:150]) == (0, 0.0)
    assert window_of_model(F, np.full((F.size, 5), np.nan), frfs()) == (0, 0.0)


def test_a_window_where_a_loosened_bolt_damps_one_mode():
    """Or two modes merge in one broadened peak: seven of eight rates told it on a virtual rig, the eighth had risen by twice as much."""
    alike, one = np.array([3.1, 2.3, 4.3, 2.4, 5.0, 3.0]), np.array([0.0, 0.0, 0.0, 0.0, 5.8, 0.0])
    tight, own = frfs(decay=alike), frfs(decay=alike + one, window=-np.log(0.01), seed=1)
    kind, text = other_chain(F, own, tight, "tight", NAMES) or ("", "")
    assert kind == "window"
    assert float(text.partition("about ")[2].partition(" %")[0]) == pytest.approx(1.0, rel=0.2)
    assert other_chain(F, frfs(decay=alike + one, seed=1), tight, "tight", NAMES) is None


OTHER_SHAPES = np.random.default_rng(8).standard_normal((6, 5))
MOVED = OMEGA * [0.93, 1.04, 0.95, 1.03, 0.96, 0.99]


def test_a_window_where_loosened_bolts_change_all_shapes():
    """No mode is the same as before: rates at the same frequencies tell it."""
    tight, own = frfs(), frfs(MOVED, shapes=OTHER_SHAPES, window=-np.log(0.001), seed=1)
    assert len(same_modes(fitted_modes(F, own), fitted_modes(F, tight))) < 3
    text = str(other_chain(F, own, tight, "tight", NAMES))
    assert "kind='window'" in text
    assert "decay faster than in tight by the same" in text
    assert float(text.split("by the same ")[1].split(" 1/s")[0]) == pytest.approx(-np.log(0.001), rel=0.1)


def test_a_window_where_loosened_bolts_lower_the_first_mode():
    """It lies below all modes of the reference job, whose first one has the damping ratio expected of it."""
    few = slice(0, 4)
    tight = frfs(OMEGA[few], DECAY[few], SHAPES[few])
    own = frfs(OMEGA[few] * [0.7, 0.96, 0.94, 0.97], DECAY[few] * [0.7, 1.0, 1.0, 1.0], OTHER_SHAPES[few], window=-np.log(0.001), seed=1)
    assert "decay faster than in tight by the same" in str(other_chain(F, own, tight, "tight", NAMES))


@pytest.mark.parametrize("count", [-1, 2])
def test_a_file_whose_lines_are_off_by_whole_numbers(count):
    tight, own = (frfs(OMEGA * np.array([0.98, 1.0, 0.99, 1.0, 1.0, 1.0]) ** k, seed=k) for k in range(2))
    text = str(other_chain(F[3:-3], np.roll(own, count, axis=0)[3:-3], tight[3:-3], "tight", NAMES))
    aside = "1 line (1 Hz) lower" if count < 0 else "2 lines (2 Hz) higher"
    assert f"modes that can be compared are {aside} than in tight, all by the same amount" in text
    assert ("add 1 Hz to its frequencies" if count < 0 else "subtract 2 Hz from its frequencies") in text
    assert other_chain(F, own, tight, "tight", NAMES) is None


@pytest.mark.parametrize("more", [0.0, np.array([9.0, 0.5, 7.0, 1.0, 8.0, 3.0])])
def test_loosened_bolts_that_change_all_shapes_are_no_window(more):
    """Nor where they damp some modes much and others hardly."""
    assert other_chain(F, frfs(MOVED, DECAY + more, OTHER_SHAPES, seed=1), frfs(), "tight", NAMES) is None


@pytest.mark.parametrize("factor", [0.7, 1.5])
def test_another_damping_of_the_material_is_no_window(factor):
    """All rates multiplied, by more than a window's length: a window adds the same to all of them."""
    slow = DECAY + 6.0
    own, tight = frfs(decay=factor * slow, seed=1), frfs(decay=slow)
    first, second = fitted_modes(F, own), fitted_modes(F, tight)
    assert first.decay.size == second.decay.size >= 5
    assert abs(np.median(first.decay - second.decay)) > 1.0
    assert other_chain(F, own, tight, "tight", NAMES) is None


def test_another_clock_and_warmer_air():
    """Air of three kelvin more moves all of its modes by half a per cent: no clock, where the model holds air."""
    loosened = np.array([0.97, 1.0, 1.0, 1.0, 0.98, 1.0])
    clock, warm = (frfs(OMEGA * share * loosened, seed=1) for share in (1.04, 1.006))
    for air in (False, True):
        kind, text = other_chain(F, clock, frfs(), "tight", NAMES, air=air) or ("", "")
        assert kind == "clock"
        assert float(text.split("divide its frequencies by ")[1].split(",")[0]) == pytest.approx(1.04, abs=2e-3)
    assert other_chain(F, warm, frfs(), "tight", NAMES, air=True) is None
    assert "by the same percentage" in str(other_chain(F, warm, frfs(), "tight", NAMES))


def test_another_temperature_shifts_modes_less_in_which_supports_work():
    """Modulus 1.5 % lower, as of a cover in eight modes: the one of seven tenths the shift came first, and nothing was said."""
    colder = np.array([0.9931, 0.9951, 0.9932, 0.9934, 0.9938, 0.9925])
    text = str(other_chain(F, frfs(OMEGA * colder, seed=1), frfs(), "tight", NAMES))
    assert "5 of the 6 modes that can be compared are 0.67% lower than in tight" in text
    assert "the structure is much warmer or colder" in text
    loosened = np.array([0.9931, 0.9951, 0.9999, 0.9834, 0.9938, 0.9725])
    assert other_chain(F, frfs(OMEGA * loosened, seed=1), frfs(), "tight", NAMES) is None


def test_three_modes_that_agree_by_chance_are_no_clock():
    """Six bolts tightened anew moved the modes of a right rig by +0.5, -0.9, 1.2, 1.1 and 1.2 %."""
    scattered = np.array([1.0048, 0.9915, 1.0122, 1.0111, 1.0115, 0.99])
    assert other_chain(F, frfs(OMEGA * scattered, seed=1), frfs(), "tight", NAMES) is None
    # By more than warm air does: in a baseline no bolt has lowered the other modes, so these would have to agree, too.
    scattered[2:5] += 0.005
    told = [other_chain(F, frfs(OMEGA * scattered, seed=1), frfs(), "tight", NAMES, loosened=loosened) for loosened in (True, False)]
    assert [bool(fault) for fault in told] == [True, False]


@pytest.mark.parametrize("more", [[4.0, 0.1, 4.0, 0.0, 3.0, 2.0], [1.0, 1.5, 1.7, 2.5, 4.0, 5.5]])
def test_damping_of_loosened_bolts_is_no_window(more):
    """Some modes lose more, others none; the second: half as much again of all, less than the file would hold as a window."""
    assert other_chain(F, frfs(decay=DECAY + 0.4 * np.array(more), seed=1), frfs(), "tight", NAMES) is None


def test_a_filter_in_one_channel():
    own = frfs(seed=1)
    corner = 1j * F / 110.0
    own[:, 2] *= corner**2 / (corner**2 + 1.414 * corner + 1.0)
    kind, text = other_chain(F, own, frfs(), "tight", NAMES) or ("", "")
    assert kind == "filter"
    assert ": a3 by " in text
    assert "a1" not in text


def test_channels_that_were_not_measured_and_uneven_lines():
    own = frfs(window=4.6, seed=1)
    own[:, 1] = np.nan
    assert other_chain(F, own, frfs(), "tight", NAMES) is not None
    assert other_chain(F**1.1, own, frfs(), "tight", NAMES) is None
    own[:] = np.nan
    assert other_chain(F, own, frfs(), "tight", NAMES) is None


@pytest.mark.parametrize(("sample", "tight"), [("soundbox", "bolts-00"), ("plate", "tight-1"), ("frame", "tight")])
def test_nothing_of_the_kind_in_the_samples(sample, tight):
    held = {}
    for path in (ROOT / "data_samples" / sample / "frf").glob("*.[uc]*"):
        records = read_frf(path).records
        held[path.stem] = records[0].frequency_hz, np.stack([record.values for record in records], axis=1)
    for name, (hz, values) in held.items():
        if name != tight:
            assert other_chain(hz, values, held[tight][1], tight, [str(k) for k in range(values.shape[1])]) is None, name


def shown(*factors, jobs=3, noise=0.0):
    """Frequencies of the modes that each sensor shows in some jobs, with a factor of its own."""
    rng, hz = np.random.default_rng(2), OMEGA / 2 / np.pi
    moved = {f"a{k + 1}": factor for k, factor in enumerate(factors)}
    return [{name: factor * hz * (1 + noise * rng.standard_normal(hz.size)) for name, factor in moved.items()} for _ in range(jobs)]


def test_sensors_of_another_run_show_all_modes_lower():
    found = other_run(shown(1.0, 1.0, 0.988, 1.0, 0.988, noise=5e-4))
    assert found is not None
    assert (found.lower, found.higher) == (["a3", "a5"], ["a1", "a2", "a4"])
    assert found.shift == pytest.approx(0.012, rel=0.05)


def test_sensors_of_one_run():
    assert other_run(shown(1.0, 1.0, 1.0, noise=0.01)) is None
    # As temperature does between two measurements; too few modes; no two groups.
    assert other_run(shown(1.0, 0.998, noise=5e-4)) is None
    assert other_run(shown(1.0, 0.98, jobs=1)) is None
    assert other_run(shown(1.0, 0.98, 0.96)) is None
    # A mode more at one sensor, as of a neighbour, has no match.
    assert other_run([{"a1": OMEGA, "a2": OMEGA[1:]}] * 4) is None
    assert other_run([{}, {"a1": OMEGA}]) is None


def test_half_of_the_modes_of_a_baseline_agree_by_chance() -> None:
    """Three of six modes four lines higher, as of bolts tightened anew: if the file began elsewhere, all modes would be."""
    step = 2.0 * np.pi * float(np.diff(F).mean())
    tightened = OMEGA + step * np.array([1.0, 4.02, 3.95, 2.4, 4.0, 0.3])
    told = [str(other_chain(F, frfs(tightened, seed=1), frfs(), "tight", NAMES, loosened=loosened)) for loosened in (True, False)]
    assert ["lines (" in text for text in told] == [True, False]
