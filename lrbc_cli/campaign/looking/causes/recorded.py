"""Faults of recording that all responses of a job share, by comparison with the model: the first milliseconds are lost."""

from __future__ import annotations

import numpy as np

from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.looking.states import Seen
from lrbc_cli.updating.knots import evenly
from lrbc_cli.updating.statistics.chain.start import starting


def cut_text(seen: Seen, whole: Measurement, *, least: float = 0.15, share: float = 0.5) -> str:
    """Warning if the impulse responses begin some milliseconds after the blow, those of the model do not; else empty.

    Parameters
    ----------
    seen : Seen
    whole : Measurement
        On all its lines.
    least : float
        Energy up to some time over that of as long a time after it, below which nothing was recorded there. On virtual rigs and samples it
        is above 0.18 at all times; without the first 3 ms of the responses it is mostly below 0.15, without 6 ms below 0.1.
    share : float
        The same relative to the model: sensors far from the hammer, or in air, respond late.
    """
    hz = whole.frequency_hz
    if not evenly(hz):
        return ""
    times, own = starting(hz, whole.values)
    if not (lost := own < least).any():
        return ""
    s = 2j * np.pi * hz
    parameters = seen.source.parameters(s)
    lost &= own < share * starting(hz, seen.source.model(s, parameters).frf(parameters.initial))[1]
    if not lost.any():
        return ""
    first = 1e3 * float(times[np.where(lost, own, np.inf).argmin()])
    return (
        f"the responses begin about {first:.2g} ms after the blow, those of the model at once: their first milliseconds are probably "
        "lost. Check whether the recording started at the trigger, or a window cut off the beginning. Set a pretrigger (5 % of the "
        "record), start the window of the responses before the blow, and measure again"
    )
