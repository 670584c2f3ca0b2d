"""Measurements handed over as arrays, jobs without files, and experiments with the method, for callers from Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.arrays import Complexes, Floats
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.protect import require_inputs_apart, same_file
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config import JobConfig
from lrbc_cli.errors import ConfigError, DataError


def with_job(inputs: Inputs, name: str) -> Inputs:
    """The inputs with a further job without files, whose measurement is passed to the identification."""
    job = JobConfig.model_construct(frf=Path(name))
    return replace(inputs, campaign=inputs.campaign.model_copy(update={"jobs": {**inputs.campaign.jobs, name: job}}))


def with_choices(inputs: Inputs, choices: Mapping[str, Any], output: Path | None) -> Inputs:
    """The inputs with other fields of the method, and with another folder for the results, if one is given.

    Raises
    ------
    ConfigError
        If the folder is that of the campaign, or contains its inputs.
    """
    campaign = inputs.campaign
    if output is not None:
        own = Path(output).expanduser().absolute()
        if same_file(own, campaign.output):
            raise ConfigError("the argument output cannot be used", expected="another folder than that of the campaign", found=own)
        campaign = campaign.model_copy(update={"output": own})
        require_inputs_apart(campaign)
    return replace(inputs, campaign=campaign, by_hand={**inputs.by_hand, **choices})


def measurement_of(inputs: Inputs, lines: Floats, values: Complexes, coherence: Floats | None) -> Measurement:
    """Measurement from ascending lines (F,) [Hz], FRFs (F, R) and coherences (F, R) or None; lines outside the band are left out.

    Raises
    ------
    DataError
        If shapes do not fit the responses, lines are not ascending, none lies in the band, or coherence is not between 0 and 1.
    """
    expected = (lines.size, len(inputs.responses))
    if values.shape != expected or not lines.size or np.any(np.diff(lines) <= 0) or lines[0] < 0.0:
        raise DataError("this is not a measurement", expected=f"ascending lines and FRFs of shape {expected}", found=f"{values.shape}")
    band = inputs.campaign.reduction.band
    below, above = lines < band[0] * (1 - 1e-9), lines > band[1] * (1 + 1e-9)
    inside = ~(below | above)
    if not inside.any():
        lie = f"lines from {lines[0]:g} to {lines[-1]:g} Hz"
        raise DataError("no line lies in the band", expected=f"lines from {band[0]:g} to {band[1]:g} Hz", found=lie)
    known = np.full(expected, np.nan) if coherence is None else coherence
    if known.shape != expected or np.any((known < 0.0) | (known > 1.0 + 1e-6)):
        what = f"numbers from 0 to 1, NaN where unknown, of shape {expected}"
        raise DataError("this is not a coherence", expected=what, found=known.shape)
    return Measurement(
        frequency_hz=lines[inside],
        values=values[inside],
        coherence=known[inside],
        left_out=(int(below.sum()), int(above.sum())),
        notes=("handed over as arrays",),
        warnings=(),
        records=(),
        hashes={},
    )
