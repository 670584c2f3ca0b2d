"""What FRFs and their coherence say of the chain that measured them, without a model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pads import S, pads_model, pads_ports
from samples import sample

from lrbc_cli.campaign import check
from lrbc_cli.campaign.findings import Kind, kinds_of
from lrbc_cli.campaign.identification.compared.chains import blows_doubt, coherence_doubt, soft_tip
from lrbc_cli.campaign.identification.compared.likeness import run_backwards
from lrbc_cli.campaign.identification.records import read_measurement
from lrbc_cli.campaign.looking import measured
from lrbc_cli.updating.misfit.frf import port_model
from lrbc_cli.updating.statistics.chain.modal import ChainFault
from lrbc_cli.updating.statistics.model import STATISTICS

HZ = S.imag / (2 * np.pi)


def frfs() -> np.ndarray:
    model, parameters = pads_model()
    return np.asarray(port_model(pads_ports(model), parameters).frf(parameters.initial))


def measurement(noise: np.ndarray, level: np.ndarray | float = 1.0) -> Any:
    """Noise over signal of four responses, and their levels, the same at all lines."""
    return SimpleNamespace(frequency_hz=HZ, coherence=np.tile(1.0 / (1.0 + noise), (HZ.size, 1)), values=np.ones((HZ.size, 4)) * level + 0j)


TIGHT = np.array([1e-4, 2e-4, 1e-4, 3e-4])
INPUTS: Any = SimpleNamespace(responses=[SimpleNamespace(name=f"a{k}") for k in range(1, 5)])


def said(noise: np.ndarray) -> str | None:
    return coherence_doubt(INPUTS, measurement(noise), measurement(TIGHT), "tight")


def test_a_response_whose_coherence_fell_alone() -> None:
    text = said(TIGHT * np.array([1.0, 300.0, 1.0, 1.0]))
    assert text is not None
    assert text.startswith("the coherence of a2 is 0.9434 (median over the lines), 0.9998 in tight; that of no")


@pytest.mark.parametrize(
    "times",
    [
        pytest.param([1.0, 40.0, 1.0, 1.0], id="as a loosened bolt may"),
        pytest.param([200.0, 200.0, 200.0, 200.0], id="a noisier job"),
        pytest.param([1.0, 200.0, 200.0, 200.0], id="most of them"),
    ],
)
def test_other_noise_is_no_fault_of_one_channel(times: list[float]) -> None:
    assert said(TIGHT * np.array(times)) is None


@pytest.mark.parametrize(("kind", "kept"), [("clock", False), ("lines", False), ("window", True)])
def test_frequencies_are_not_doubted_while_the_quantity_is(monkeypatch: pytest.MonkeyPatch, kind: str, kept: bool) -> None:
    """Velocities stated as accelerations: a few modes 2.8 % higher, all alike, and advice to divide the frequencies by that."""
    monkeypatch.setattr(measured, "chain_doubt", lambda *_, **__: ChainFault(kind, "told"))
    monkeypatch.setattr(measured, "blows_doubt", lambda *_, **__: None)
    inputs: Any = SimpleNamespace(responses=INPUTS.responses, campaign=SimpleNamespace(update=SimpleNamespace(reference="tight")))
    jobs = {name: measurement(TIGHT) for name in ("tight", "loose")}

    def told(*other_quantity: str) -> bool:
        return Kind.CHAIN in kinds_of(measured.other_chains(inputs, jobs, other_quantity))

    assert told()
    assert told("another")
    assert told("loose") is told("tight") is kept


def test_a_response_that_a_loose_bolt_lets_fall_is_no_fault() -> None:
    """The noise is what it was, and stands beside less."""
    fallen = measurement(TIGHT * np.array([1.0, 300.0, 1.0, 1.0]), 1.0 / np.sqrt([1.0, 300.0, 1.0, 1.0]))
    assert coherence_doubt(INPUTS, fallen, measurement(TIGHT), "tight") is None


def test_without_coherence_nothing_is_said() -> None:
    empty = replace_coherence(measurement(TIGHT))
    assert coherence_doubt(INPUTS, empty, measurement(TIGHT), "tight") is None


def replace_coherence(own: Any) -> Any:
    return SimpleNamespace(frequency_hz=own.frequency_hz, coherence=np.full_like(own.coherence, np.nan), values=own.values)


def test_conjugates_answer_before_the_blow() -> None:
    y = frfs()
    assert not run_backwards(HZ, y)
    assert run_backwards(HZ, y.conj())
    # Reversed sensors are none, nor is a response without values; of uneven lines nothing is known.
    assert not run_backwards(HZ, y * np.array([1.0, -1.0, 1.0, -1.0]))
    assert run_backwards(HZ, np.column_stack([y.conj(), np.full(HZ.size, np.nan)]))
    assert not run_backwards(HZ**2, y.conj())


def along(coherence: np.ndarray) -> Any:
    """Four responses with one coherence over the lines."""
    return SimpleNamespace(frequency_hz=HZ, coherence=np.repeat(coherence[:, None], 4, axis=1))


def test_a_coherence_that_ends_before_the_band() -> None:
    edge = 2 * HZ.size // 3
    dips = np.where(np.arange(HZ.size) % 20 == 0, 0.3, 0.99)
    found = soft_tip(along(np.where(np.arange(HZ.size) < edge, dips, 0.1)))
    assert found is not None
    assert found[0] == pytest.approx(HZ[edge], abs=2 * (HZ[1] - HZ[0]))
    assert found[1] == pytest.approx(0.1)


def test_resonances_may_rise_above_the_noise_of_a_soft_tip() -> None:
    at = np.arange(HZ.size) / HZ.size
    falling = (at >= 0.7) | ((at >= 0.5) & (at < 0.58))
    found = soft_tip(along(np.where(falling, 0.1, 0.99)))
    assert found is not None
    assert found[0] == pytest.approx(HZ[0] + 0.7 * (HZ[-1] - HZ[0]), rel=0.01)


@pytest.mark.parametrize("part", [(0.0, 1.0), (0.3, 0.6), (0.0, 0.3), (0.95, 1.0), (1.0, 1.0)])
def test_a_coherence_that_is_low_elsewhere_is_no_soft_tip(part: tuple[float, float]) -> None:
    at = np.arange(HZ.size) / HZ.size
    assert soft_tip(along(np.where((at >= part[0]) & (at < part[1]), 0.1, 0.99))) is None


def test_a_coherence_that_is_not_known_is_no_soft_tip() -> None:
    assert soft_tip(along(np.full(HZ.size, np.nan))) is None


def test_blows_of_repeats_count_together() -> None:
    """Values are the mean of all files, the coherence is that of one: three repeats of right blows looked like blows that differ."""
    rng, hz = np.random.default_rng(5), np.linspace(20.0, 400.0, 381)
    frf = np.stack([(hz**2 / (pole**2 - hz**2 + 0.04j * pole * hz)) for pole in (90.0, 170.0, 260.0)], axis=1)
    size, blows, files = 0.1 * np.sqrt(np.mean(np.abs(frf) ** 2)), 5, 9

    def noisy(count: int) -> np.ndarray:
        return frf + size * (rng.standard_normal(frf.shape) + 1j * rng.standard_normal(frf.shape)) / np.sqrt(2.0 * blows * count)

    coherence = 1.0 / (1.0 + (size / np.abs(frf)) ** 2)
    campaign = SimpleNamespace(
        update=SimpleNamespace(reference="tight"), jobs=dict.fromkeys(("tight", "own"), SimpleNamespace(averages=blows))
    )
    inputs: Any = SimpleNamespace(campaign=campaign, statistics=STATISTICS, excitations=("h1",), input_of=np.zeros(3, dtype=int))
    tight: Any = SimpleNamespace(values=noisy(1), coherence=coherence, files=1)
    own: Any = SimpleNamespace(values=noisy(files), coherence=coherence, files=files)
    assert blows_doubt(inputs, "own", own, tight) is None
    # As if it were a single file: the same lines then are too smooth.
    own.files = 1
    assert blows_doubt(inputs, "own", own, tight) is not None


def test_blows_that_differ_at_one_hammer_point_are_told() -> None:
    """A bolt came loose between the blows at one point; the lines of the other are right, and outweigh it in the median over all."""
    rng, hz, blows = np.random.default_rng(6), np.linspace(20.0, 400.0, 381), 5

    def state(shift: float) -> np.ndarray:
        poles = np.array([90.0, 170.0, 260.0, 110.0, 190.0, 310.0]) * np.where(np.arange(6) < 3, shift, 1.0)
        return np.stack([(hz**2 / (pole**2 - hz**2 + 0.04j * pole * hz)) for pole in poles], axis=1)

    def averaged(shifts: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        every = np.array([state(shift) for shift in shifts])
        every = every * (1.0 + 0.01 * (rng.standard_normal(every.shape) + 1j * rng.standard_normal(every.shape)))
        mean = every.mean(axis=0)
        return mean, np.abs(mean) ** 2 / np.mean(np.abs(every) ** 2, axis=0)

    jobs = dict.fromkeys(("tight", "own"), SimpleNamespace(averages=blows))
    campaign = SimpleNamespace(update=SimpleNamespace(reference="tight"), jobs=jobs)
    inputs: Any = SimpleNamespace(campaign=campaign, statistics=STATISTICS, excitations=("h1", "h2"), input_of=np.repeat([0, 1], 3))
    right, mixed = averaged((1.0,) * blows), averaged((1.0, 1.0, 0.9, 0.9, 0.9))
    tight: Any = SimpleNamespace(values=right[0], coherence=right[1], files=1)
    own: Any = SimpleNamespace(values=mixed[0], coherence=mixed[1], files=1)
    text = blows_doubt(inputs, "own", own, tight)
    assert text is not None
    assert text.startswith("FRFs of h1: by the coherence")
    assert blows_doubt(inputs, "own", tight, tight) is None


@pytest.mark.parametrize("job", ["loose-2", "loose-all"])
def test_a_second_blow_beside_loosened_bolts_shows_in_check(tmp_path: Path, job: str) -> None:
    """It is hidden beside the tight state, and shows beside the state fitted to the job; without it nothing is said."""
    inputs = sample("frame")
    right = {name: read_measurement(inputs, inputs.campaign.jobs[name], name) for name in ("tight", job)}
    twice = 1.0 + 0.3 * np.exp(-2j * np.pi * right[job].frequency_hz * 0.03)
    struck = right | {job: replace(right[job], values=right[job].values * twice[:, None])}
    assert not any(each.detail == "blow" for each in measured.other_chains(inputs, struck))
    for measurements, told in ((right, False), (struck, True)):
        out = check.Findings()
        check._compared(inputs, tmp_path, measurements, out, lambda _: None)
        assert any("the hammer probably hit a second time" in each.text for each in out.found if each.job == job) is told
