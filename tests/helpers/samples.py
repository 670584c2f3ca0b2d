"""The two sample campaigns, read once a process, reduced once a run."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import numpy as np
from shared import shared

from lrbc_cli.campaign.reading.inputs import Inputs, read_as_exported
from lrbc_cli.campaign.reduced.stage import obtain_reduction
from lrbc_cli.config import load_campaign
from lrbc_cli.reduction.build import Reduction

ROOT = Path(__file__).parents[2]


@cache
def sample(name: str) -> Inputs:
    """Model, terms, loads and outputs of ``soundbox`` or ``frame``."""
    return read_as_exported(load_campaign(ROOT / "configs" / f"{name}.yaml"))


def reduced_cache(name: str) -> Path:
    """Cache folder that holds its reduced model with the campaign's own settings; read only."""
    return shared(f"reduced-{name}", partial(obtain_reduction, sample(name)))


@cache
def reduced_sample(name: str) -> Reduction:
    """That reduced model."""
    return obtain_reduction(sample(name), reduced_cache(name)).reduction


def lines(low: float, high: float, count: int) -> np.ndarray:
    """s = i omega on evenly spaced lines in Hz."""
    return 2j * np.pi * np.linspace(low, high, count)
