"""Measurements beside a model, put together by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.states import Seen


def modal(hz: np.ndarray, seed: int = 1, responses: int = 8) -> np.ndarray:
    """Accelerances (F, R) of a structure with modes from 20 to 700 Hz."""
    rng = np.random.default_rng(seed)
    own = np.sort(rng.uniform(20.0, 700.0, 40))
    shapes = rng.normal(size=(own.size, responses)) * rng.normal(size=(own.size, 1))
    s, w = 2j * np.pi * hz[:, None], 2.0 * np.pi * own
    return np.asarray(s**2 / (s**2 + 2.0 * 0.01 * w * s + w**2) @ shapes)


def measurement(frequency_hz: np.ndarray, values: np.ndarray) -> Measurement:
    """FRFs without coherence, notes or files."""
    none = np.full(values.shape, np.nan)
    return Measurement(frequency_hz=frequency_hz, values=values, coherence=none, notes=(), warnings=(), records=(), hashes={})


def seen(measured: np.ndarray, states: np.ndarray, *, hz: np.ndarray | None = None, job: str = "tight", **given: Any) -> Seen:
    """A job beside (S, F, R) states of a model; ``given`` are its source, or inputs alone, and the rest."""
    source: Any = given.pop("source", None) or SimpleNamespace(inputs=given.pop("inputs", None), known={}, changes={})
    lines = np.arange(1.0, len(measured) + 1.0) if hz is None else hz
    return Seen(source=source, job=job, measurement=measurement(lines, measured), states=states, **{"parameters": None} | given)
