"""A Hann window on the records of a blow, by envelopes of impulse responses."""

from __future__ import annotations

import numpy as np
import pytest

from lrbc_cli.updating.statistics.chain.windows import hann_text

HZ = np.arange(20.0, 421.0)


def frfs(*, decay: float = 1.0, lowered: float = 0.0, seed: int = 0) -> np.ndarray:
    """(F, 5) accelerances of twelve modes."""
    rng = np.random.default_rng(3)
    poles = -decay * rng.uniform(2.0, 6.0, 12) + 2j * np.pi * np.linspace(35.0, 400.0, 12) * (1.0 - lowered * rng.uniform(0.0, 1.0, 12))
    s = 2j * np.pi * HZ
    values = np.einsum("fm,mr->fr", s[:, None] ** 2 / ((s[:, None] - poles) * (s[:, None] - poles.conj())), rng.normal(size=(12, 5)))
    noise = np.random.default_rng(seed).normal(size=(2, *values.shape))
    return np.asarray(values + 1e-3 * np.abs(values).mean() * (noise[0] + 1j * noise[1]))


def windowed(values: np.ndarray, begin: float) -> np.ndarray:
    """The same from records of 1 s with the blow at ``begin``, times a Hann window."""
    whole = np.zeros((2048, values.shape[1]), dtype=complex)
    whole[20 : 20 + len(values)] = values
    time = np.arange(2048) / 2048
    window = np.sin(np.pi * ((time + begin) % 1.0)) ** 2 / np.sin(np.pi * begin) ** 2
    return np.asarray(np.fft.fft(np.fft.ifft(whole, axis=0) * window[:, None], axis=0)[20 : 20 + len(values)])


@pytest.mark.parametrize("begin", [0.02, 0.05, 0.1, 0.25])
def test_a_hann_window_on_a_blow_is_told_also_beside_loosened_bolts(begin: float) -> None:
    loose = frfs(decay=1.5, lowered=0.05, seed=1)
    text = hann_text(HZ, windowed(loose, begin), frfs(), "tight")
    assert "with a Hann window in this job (the blow at " in text
    assert "set a uniform (or force and exponential) window" in text
    assert "with a Hann window in tight" in hann_text(HZ, loose, windowed(frfs(), begin), "tight")


@pytest.mark.parametrize(("decay", "lowered"), [(1.0, 0.0), (1.0, 0.1), (2.5, 0.05), (0.5, 0.1)])
def test_other_bolts_and_damping_are_none(decay: float, lowered: float) -> None:
    """Nor is an exponential window, which adds to all decay rates."""
    assert hann_text(HZ, frfs(decay=decay, lowered=lowered, seed=1), frfs(), "tight") == ""
    assert hann_text(np.geomspace(20.0, 420.0, 401), windowed(frfs(), 0.05), frfs(), "tight") == ""
