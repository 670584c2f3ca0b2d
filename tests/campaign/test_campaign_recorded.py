"""Faults of recording: a lost beginning, a filter of all responses, a resonance of a mounting."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from looking import measurement, modal, seen

from lrbc_cli.campaign.looking.causes.recorded import cut_text, filter_findings

HZ = np.arange(30.0, 500.0)


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
    model = modal(HZ)
    assert told(model, model) == ""
    assert "begin about 7.4 ms after the blow" in told(without_beginning(model, 0.008), model)


def test_responses_that_the_model_has_late_too_are_right() -> None:
    """Sensors far from the hammer: the wave takes its time."""
    late = modal(HZ) * np.exp(-2j * np.pi * HZ * 0.006)[:, None]
    assert told(late, late) == ""
    assert told(late, modal(HZ)) != ""


def found(values: np.ndarray, model: np.ndarray, job: str = "tight", late: tuple[int, ...] = ()) -> list[str]:
    """Every two responses are of one sensor."""
    responses = tuple(SimpleNamespace(name=f"a{i}", node=i // 2, direction=0) for i in range(values.shape[1]))
    inputs = SimpleNamespace(responses=responses, campaign=SimpleNamespace(update=SimpleNamespace(reference="tight")))
    return [each.text for each in filter_findings(seen(values, model[None], hz=HZ, inputs=inputs, job=job), late)]


def other_model(values: np.ndarray) -> np.ndarray:
    """The same a little softer, as errors of a model leave it."""
    return np.stack([np.interp(0.98 * HZ, HZ, column) for column in values.T], axis=1)


HIGH = 1.0 / (1.0 + np.sqrt(2.0) * 100.0 / (1j * HZ) + (100.0 / (1j * HZ)) ** 2)[:, None]


def test_a_filter_of_all_responses_is_named_with_its_corner() -> None:
    values = modal(HZ)
    model = other_model(values)
    assert found(values, model) == []
    assert found(values[::-1], model) == []
    (text,) = found(values * HIGH, model, "state-1")
    assert text.startswith("levels of all responses fall below 90.1 Hz relative to the model")
    assert "the signals probably passed a high-pass filter of order 2 with its corner near 90.1 Hz" in text
    (text,) = found(values / HIGH, model)
    assert "the force probably passed a high-pass filter of order 2" in text


def test_a_sensor_that_resonates_on_its_mounting_is_named() -> None:
    values = modal(HZ)
    ratio = HZ[:, None] / 300.0
    moved = values.copy()
    moved[:, 2:4] /= 1.0 - ratio**2 + 1j * ratio / 8.0
    (text,) = found(moved, other_model(values))
    assert text.startswith("a2, a3: levels rise towards 306 Hz")
    assert "amplification about 8" in text
    # In another job it is looked for only where a delay would be told otherwise.
    assert found(moved, other_model(values), "state-1") == []
    assert found(moved, other_model(values), "state-1", (2, 3)) == [text]
    assert found(moved, other_model(values), "state-1", (0, 1)) == []


def test_one_filter_of_several_channels_is_told_once() -> None:
    values = modal(HZ)
    channels = np.where(np.isin(np.arange(values.shape[1]) // 2, [0, 1]), HIGH, 1.0)
    (text,) = found(values * channels, other_model(values))
    assert text.startswith("levels of a0, a1, a2, a3 fall below 90.1 to 102 Hz relative to the model")
    assert text.endswith("Probably the channels of the other sensors have the same filter: check them, too")
