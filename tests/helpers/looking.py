"""Measurements beside a model, put together by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.states import Seen


def measurement(frequency_hz: np.ndarray, values: np.ndarray) -> Measurement:
    """FRFs without coherence, notes or files."""
    none = np.full(values.shape, np.nan)
    return Measurement(frequency_hz=frequency_hz, values=values, coherence=none, notes=(), warnings=(), records=(), hashes={})


def seen(measured: np.ndarray, states: np.ndarray, *, hz: np.ndarray | None = None, job: str = "tight", **given: Any) -> Seen:
    """A job beside (S, F, R) states of a model; ``given`` are its source, or inputs alone, and the rest."""
    source: Any = given.pop("source", None) or SimpleNamespace(inputs=given.pop("inputs", None), known={})
    lines = np.arange(1.0, len(measured) + 1.0) if hz is None else hz
    return Seen(source=source, job=job, measurement=measurement(lines, measured), states=states, **{"parameters": None} | given)
