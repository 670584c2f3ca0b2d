"""Faults of recording that all responses share: a lost beginning."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from looking import measurement, seen

from lrbc_cli.campaign.looking.causes.recorded import cut_text

HZ = np.arange(30.0, 500.0)


def modal(seed: int = 1, responses: int = 8) -> np.ndarray:
    """Accelerances of a structure with modes from 20 to 700 Hz."""
    rng = np.random.default_rng(seed)
    own = np.sort(rng.uniform(20.0, 700.0, 40))
    shapes = rng.normal(size=(own.size, responses)) * rng.normal(size=(own.size, 1))
    s, w = 2j * np.pi * HZ[:, None], 2.0 * np.pi * own
    return s**2 / (s**2 + 2.0 * 0.01 * w * s + w**2) @ shapes


def without_beginning(values: np.ndarray, time_s: float) -> np.ndarray:
    whole, first = np.zeros((4097, values.shape[1]), dtype=complex), int(HZ[0])
    whole[first : first + HZ.size] = values
    impulse = np.fft.irfft(whole, axis=0)
    impulse[: int(time_s * len(impulse))] = 0.0
    return np.fft.rfft(impulse, axis=0)[first : first + HZ.size]


def told(values: np.ndarray, model: np.ndarray) -> str:
    computed = SimpleNamespace(frf=lambda theta: model)
    source = SimpleNamespace(parameters=lambda s: SimpleNamespace(initial=None), model=lambda s, parameters: computed)
    return cut_text(seen(values, model[None], hz=HZ, source=source), measurement(HZ, values))


def test_responses_that_begin_late_were_cut() -> None:
    model = modal()
    assert told(model, model) == ""
    assert "begin about 7.4 ms after the blow" in told(without_beginning(model, 0.008), model)


def test_responses_that_the_model_has_late_too_are_right() -> None:
    """Sensors far from the hammer: the wave takes its time."""
    late = modal() * np.exp(-2j * np.pi * HZ * 0.006)[:, None]
    assert told(late, late) == ""
    assert told(late, modal()) != ""
