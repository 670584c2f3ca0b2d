"""Constant factors between measured and computed FRFs: found, named, and not seen where the model alone is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pads import PADS, S, loosened, pads_model, pads_ports

from lrbc_cli.updating.comparison.delays import delay_of
from lrbc_cli.updating.comparison.scale import Offset, grouped, misses_unit, offsets_of
from lrbc_cli.updating.misfit.frf import port_model

FREQUENCY = S.imag / (2 * np.pi)
RNG = np.random.default_rng(3)
QUANTITIES = ["acceleration"] * 4


@pytest.fixture(scope="module")
def frfs():
    """Measured with 5 % of noise; computed by a model whose pads are 12 % off; and one with three pads loose, far from both."""
    model, parameters = pads_model()
    frf = port_model(pads_ports(model), parameters)
    tight = loosened(parameters, tight=4.5, at=())
    wrong = tight.copy()
    wrong[:PADS] += np.where(np.arange(PADS) % 2 == 0, 0.05, -0.05)
    y = frf.frf(tight)
    noise = 1 + 0.05 * (RNG.normal(size=y.shape) + 1j * RNG.normal(size=y.shape)) / np.sqrt(2)
    return {"measured": y * noise, "computed": frf.frf(wrong), "far": frf.frf(loosened(parameters, loose=1.0, at=(2, 3, 4, 5, 6, 7)))}


def found(measured, *states, quantities=QUANTITIES):
    return offsets_of(FREQUENCY, measured, states, quantities)


def test_a_model_in_error_is_no_factor(frfs):
    for states in (("computed",), ("far",), ("far", "computed")):
        offsets = found(frfs["measured"], *(frfs[state] for state in states))
        assert len(offsets) == 4
        assert not any(o.named or o.reversed or o.conjugate or o.delay for o in offsets)
        assert not misses_unit(offsets)


@pytest.mark.parametrize("milliseconds", [2.0, -3.0])
def test_a_delay_of_the_sensors(frfs, milliseconds):
    late = frfs["measured"] * np.exp(-2j * np.pi * FREQUENCY * 1e-3 * milliseconds)[:, None]
    # Reversed or not.
    for sign in (1.0, -1.0):
        assert [o.delay for o in found(sign * late, frfs["far"], frfs["computed"])] == [pytest.approx(1e-3 * milliseconds, rel=0.05)] * 4


def test_a_delay_that_shows_in_all_responses_together(frfs):
    """A fifth of a turn at the upper end of the band: no response alone shows it beside errors of the model."""
    late = frfs["measured"] * np.exp(-2j * np.pi * FREQUENCY * 0.5e-3)[:, None]
    assert not any(delay_of(FREQUENCY, late[:, [i]], frfs["computed"][:, [i]]) for i in range(4))
    assert [o.delay for o in found(late, frfs["far"], frfs["computed"])] == [pytest.approx(0.5e-3, rel=0.05)] * 4
    # Delays of single responses are none of all.
    assert not any(o.delay for o in found(np.where(np.arange(4) < 2, late, frfs["measured"]), frfs["computed"]))


def test_resonances_that_the_model_has_not_are_no_delay():
    """Each turns the phase by 180 degrees: a stair, which a straight line fits badly."""
    frequency = np.linspace(10.0, 500.0, 400)
    stair = np.exp(-1j * np.pi * np.floor(frequency / 25.0))
    assert delay_of(frequency, stair[:, None], np.ones((400, 1), dtype=complex)) == 0.0


@pytest.mark.parametrize(
    ("factor", "cause", "unit"),
    [
        (1 / 9.80665, "FRFs in g/N", "g/N"),
        (1e3, "FRFs in mm/s2/N", "mm/s2/N"),
        (4.4482216, "FRFs per lbf", "m/s2/lbf"),
        (1 / 0.0254, "FRFs in in/s2/N", "in/s2/N"),
        (1e-3, "FRFs per mN", "m/s2/mN"),
        (np.sqrt(2.0), "rms and peak values mixed", None),
        (0.5, "one-sided and two-sided spectra, or peak and peak-to-peak values, mixed", None),
    ],
)
@pytest.mark.parametrize("state", ["computed", "far"])
def test_a_factor_over_all_responses(frfs, factor, cause, unit, state):
    """From the state that is near, also where another was tried before it."""
    states = [frfs["far"], frfs["computed"]] if state == "far" else [frfs["computed"]]
    offsets = found(frfs["measured"] * factor, *states)
    (common,) = grouped(offsets, QUANTITIES)
    assert common.responses == (0, 1, 2, 3)
    assert common.offset.db == pytest.approx(20 * np.log10(factor), abs=max(common.offset.half, 0.5))
    assert common.offset.known[0].cause == cause
    assert common.offset.known[0].unit == unit
    assert misses_unit(offsets) == (unit is not None)
    assert all(o.after < 0.5 * o.before for o in offsets)


def test_a_gain_that_is_no_unit(frfs):
    offsets = found(frfs["measured"] * 10 ** (8.3 / 20), frfs["computed"])
    (common,) = grouped(offsets, QUANTITIES)
    assert not common.offset.known
    assert common.offset.db == pytest.approx(8.3, abs=0.5)
    assert not misses_unit(offsets)


def test_one_response_among_others(frfs):
    spoilt = frfs["measured"].copy()
    spoilt[:, 2] /= 9.80665
    offsets = found(spoilt, frfs["computed"])
    assert [o.named for o in offsets] == [False, False, True, False]
    (common,) = grouped(offsets, QUANTITIES)
    assert common.responses == (2,)
    assert common.offset.known[0].unit == "g/N"
    assert not misses_unit(offsets)


def test_a_gain_of_one_response_is_not_that_of_all(frfs):
    """Within the limits the others had counted as like it: "all responses +0.1 dB", with a wrong `scale` for each."""
    spoilt = frfs["measured"].copy()
    spoilt[:, 2] *= 1.5
    offsets = found(spoilt, frfs["computed"])
    assert [o.named for o in offsets] == [False, False, True, False]
    (common,) = grouped(offsets, QUANTITIES)
    assert common.responses == (2,)
    assert common.offset.db == pytest.approx(3.52, abs=0.3)


@pytest.mark.parametrize("power", [-2, -1, 1, 2])
def test_powers_of_the_frequency(frfs, power):
    offsets = found(frfs["measured"] * S[:, None] ** power, frfs["computed"])
    (common,) = grouped(offsets, QUANTITIES)
    assert common.responses == (0, 1, 2, 3)
    assert common.offset.power == power
    assert abs(common.offset.db) < 1.0
    # The quarter turns that belong to it are no reversed sign.
    assert not any(o.reversed or o.conjugate for o in offsets)
    assert misses_unit(offsets)


def test_one_analyser_wrote_all_responses(frfs):
    """Beside a model that errs much at one response, its factor looks like a gain; those of the others say what it is."""
    model = frfs["computed"].copy()
    model[:, 2] *= 1.3
    offsets = found(frfs["measured"] / S[:, None], model)
    assert [o.power for o in offsets] == [-1, -1, -1, -1]
    (common,) = grouped(offsets, QUANTITIES)
    assert common.responses == (0, 1, 2, 3)


def test_velocity_in_millimetres(frfs):
    offsets = found(frfs["measured"] / S[:, None] * 1e3, frfs["computed"])
    (common,) = grouped(offsets, QUANTITIES)
    assert common.offset.power == -1
    assert common.offset.known[0].unit == "mm/s/N"


@pytest.mark.parametrize("responses", [[0, 1, 2, 3], [1]])
def test_reversed_signs(frfs, responses):
    spoilt = frfs["measured"].copy()
    spoilt[:, responses] *= -1
    offsets = found(spoilt, frfs["computed"])
    assert [o.response for o in offsets if o.reversed] == responses
    assert not any(o.named or o.conjugate for o in offsets)


def test_conjugates(frfs):
    offsets = found(frfs["measured"].conj(), frfs["measured"])
    assert all(o.conjugate and not o.reversed for o in offsets)


def test_conjugates_of_velocities_are_not_reversed_too(frfs):
    offsets = found((frfs["measured"] / S[:, None]).conj(), frfs["computed"])
    assert all(o.power == -1 and o.conjugate and not o.reversed for o in offsets)


def test_one_response_alone_is_no_other_convention(frfs):
    spoilt = frfs["measured"].copy()
    spoilt[:, 1] = spoilt[:, 1].conj()
    assert not any(o.conjugate for o in found(spoilt, frfs["computed"]))


def test_sign_and_unit_together(frfs):
    offsets = found(-frfs["measured"] / 9.80665, frfs["computed"])
    assert all(o.reversed and o.unit is not None for o in offsets)


def test_pressures_have_units_of_their_own(frfs):
    quantities = ["pressure"] * 4
    (common,) = grouped(found(frfs["measured"] * 1e6, frfs["computed"], quantities=quantities), quantities)
    assert common.offset.known[0].unit == "uPa/N"
    (common,) = grouped(found(frfs["measured"] / 20e-6, frfs["computed"], quantities=quantities), quantities)
    assert common.offset.known[0].cause == "levels in dB re 20 uPa/N read as dB re 1 Pa/N"
    (common,) = grouped(found(frfs["measured"] / 9.80665, frfs["computed"], quantities=quantities), quantities)
    assert not common.offset.known


def test_gaps_and_too_few_lines(frfs):
    spoilt = frfs["measured"] / 9.80665
    spoilt[::3, 0] = np.nan
    spoilt[::4, 1] = 0.0
    spoilt[5:, 3] = np.nan
    offsets = found(spoilt, frfs["computed"])
    assert [o.response for o in offsets] == [0, 1, 2]
    assert all(o.named for o in offsets)
    assert found(np.full_like(spoilt, np.nan), frfs["computed"]) == ()


def test_what_is_clear_of_some_responses_is_meant_of_all_that_may_share_it() -> None:
    """A fix for four of five channels made the fifth wrong by 17 %."""
    quantities = ["acceleration"] * 5
    clear = Offset(response=0, db=-19.6, half=0.4, power=0, known=(), before=19.7, after=2.0, named=True)
    others = [replace(clear, response=r, db=db, half=half) for r, db, half in ((1, -19.9, 0.5), (2, -21.2, 1.0), (3, -19.4, 0.6))]
    unsure = replace(clear, response=4, db=-18.9, half=4.0, after=12.0, named=False)
    (common,) = grouped([clear, *others, unsure], quantities)
    assert common.responses == (0, 1, 2, 3, 4)
    assert next(known.unit for known in common.offset.known if known.unit) == "g/N"
    # A sensor of another sensitivity stays alone, and so does what another quantity says.
    alone = grouped([clear, *others, replace(clear, response=4, db=-6.0)], quantities)
    assert sorted(one.responses for one in alone) == [(0, 1, 3), (2,), (4,)]
    assert grouped([clear, *others, unsure], [*quantities[:4], "pressure"])[0].responses == (0, 1, 3)


@pytest.mark.parametrize(("strays", "together"), [((-22.9, -22.6), True), ((-22.9, -22.6, -17.0), False), ((-26.0,), False)])
def test_some_intervals_of_many_miss_the_factor_that_a_file_has(strays: tuple[float, ...], together: bool) -> None:
    """Eight responses in g/N: half of them were told, with a scale for each."""
    sizes = [*strays, *[-19.8] * (8 - len(strays))]
    offsets = [Offset(response=i, db=db, half=1.0, power=0, known=(), before=19.0, after=4.0, named=True) for i, db in enumerate(sizes)]
    assert (len(grouped(offsets, ["acceleration"] * 8)) == 1) == together
