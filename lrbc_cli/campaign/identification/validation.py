"""Responses that were not fitted: which of them can test an identification, and what they say of its errors."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Complexes, Floats, Integers
from lrbc_cli.campaign.identification.correlate import mean_of
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.updating.noise import validation_ratio
from lrbc_cli.updating.statistics import ValidationChannels


def validation_channels(values: Complexes, used: Integers, unused: Integers, limits: ValidationChannels) -> tuple[Integers, str]:
    """Responses that can test an identification which did not see them, and why there is none.

    Parameters
    ----------
    values : (F, R) complex array
        As measured; NaN where there is no value.
    used, unused : int arrays
    limits : ValidationChannels

    Returns
    -------
    int array, str
        Those of the unused ones with values on most lines that are no copy of a response used.
    """
    if not unused.size:
        return unused, "there are no validation channels"
    finite = np.isfinite(values)
    share = finite[:, unused].mean(axis=0)
    if not share.any():
        return unused[:0], "the validation channels have no values"
    told = unused[share >= limits.least_lines]
    if not told.size:
        return told, f"the validation channels have values on {share.max():.0%} of the lines only"

    def copied(i: int, j: int) -> bool:
        """Whether a record is another one but for a constant factor: two sensors never are."""
        both = finite[:, i] & finite[:, j] & (values[:, j] != 0)
        if not both.any():
            return False
        ratio = values[both, i] / values[both, j]
        return bool(np.all(np.abs(ratio - ratio[0]) <= limits.copied * abs(ratio[0])))

    own = np.array([i for i in told if not any(copied(int(i), int(j)) for j in used)], dtype=np.int64)
    return own, "" if own.size else "the validation channels are records that were fitted too"


def ratio_of(inputs: Inputs, measured: Complexes, misfit: Floats) -> float:
    """How many times larger the errors are than the residuals of the channels used, see ``noise.validation_ratio``.

    Parameters
    ----------
    inputs : Inputs
    measured : (F, R) complex array
        NaN where there is no value.
    misfit : (R,) float array
        Mean misfit of each response [dB].
    """
    channels, _ = validation_channels(measured, inputs.used, inputs.validation, inputs.statistics.validation)
    return validation_ratio(mean_of(misfit[channels]), mean_of(misfit[inputs.used]))
