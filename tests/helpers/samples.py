"""The two sample campaigns, read once a process, the SoundBox reduced once."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from lrbc_cli.campaign.inputs import Inputs, read_inputs
from lrbc_cli.config import load_campaign
from lrbc_cli.reduction.build import Reduction, ReductionOptions, reduce_model

ROOT = Path(__file__).parents[2]


@cache
def sample(name: str) -> Inputs:
    """Model, terms, loads and outputs of ``soundbox`` or ``frame``."""
    return read_inputs(load_campaign(ROOT / "configs" / f"{name}.yaml"))


@cache
def reduced_sample(name: str) -> Reduction:
    """Its reduced model with the campaign's own settings."""
    inputs = sample(name)
    settings = inputs.campaign.reduction
    return reduce_model(inputs.model, inputs.input_of, ReductionOptions(settings.band, settings.tolerance, settings.held_out))


def lines(low: float, high: float, count: int) -> np.ndarray:
    """s = i omega on evenly spaced lines in Hz."""
    return 2j * np.pi * np.linspace(low, high, count)
