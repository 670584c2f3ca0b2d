"""Weights of the lines of one job: from coherence, or from the scatter of repeated measurements."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Floats, Integers
from lrbc_cli.campaign.identification.records import Measurement
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.method import noise_source
from lrbc_cli.updating.residuals import coherence_sigma


def line_sigma(inputs: Inputs, measurement: Measurement, job: JobConfig, selected: Integers) -> tuple[Floats | None, tuple[str, ...]]:
    """Standard deviation of the measured magnitudes on the selected lines of the responses used.

    Returns
    -------
    (m, U) float array or None
        [dB], NaN where unknown; None where lines are not weighted by it.
    tuple of str
        Which lines keep the weight 1 because nothing is known of their noise.
    """
    coherent = bool((measurement.coherence[np.ix_(selected, inputs.used)] > 0.0).any()) and job.averages * measurement.files > 1
    kind = noise_source(inputs.method, coherent=coherent, repeated=measurement.sigma_db is not None)
    if kind == "coherence":
        # Of no record at all some programs write 0, which no estimate is.
        told = np.where(measurement.coherence > 0.0, measurement.coherence, np.nan)
        sigma = coherence_sigma(told, job.averages * measurement.files, inputs.statistics.errors)
    elif kind == "scatter" and measurement.sigma_db is not None:
        sigma = measurement.sigma_db
    else:
        return None, ()
    chosen = sigma[np.ix_(selected, inputs.used)]
    valid = np.isfinite(measurement.values[np.ix_(selected, inputs.used)])
    unknown = [(inputs.responses[i].name, int(n)) for i, n in zip(inputs.used, (np.isnan(chosen) & valid).sum(axis=0), strict=True) if n]
    notes: tuple[str, ...] = ()
    if unknown:
        what = "coherence" if kind == "coherence" else "second measurement"
        named = ", ".join(f"{name} ({count} lines)" for name, count in unknown)
        notes = (f"weights: no {what}, hence the weight 1, for {named}",)
    return chosen, notes
