"""Correlation of measured and computed FRFs (FRAC, FDAC, peak frequencies) for the result files of a job."""

from __future__ import annotations

import numpy as np

from lrbc_cli.arrays import Floats
from lrbc_cli.campaign.identification.found import Identification
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.results.agreement import CorrelationRecord, Peak, ResponseCorrelation, Spectrum
from lrbc_cli.updating.comparison.correlation import Correlation, PeakTable, correlate

FDAC_COLUMNS = ["measured_hz", "model_hz", "initial", "updated"]


def correlation_of(inputs: Inputs, result: Identification) -> Correlation:
    """Correlation of the measured FRFs of a job with those of the initial and the updated model, validation channels included."""
    quantities = tuple(response.quantity for response in inputs.responses)
    measurement = result.measurement
    return correlate(measurement.frequency_hz, measurement.values, result.initial, result.updated, quantities)


def correlation_record(inputs: Inputs, found: Correlation) -> CorrelationRecord:
    """The correlation in ``result.json``; FRAC is averaged over the responses used, and over the validation channels."""
    initial, final = found.mean_peaks.shifts_percent()
    used, validation = inputs.used, inputs.validation
    return CorrelationRecord(
        frac_initial=mean_or_gap(found.frac_initial[used]),
        frac_final=mean_or_gap(found.frac_final[used]),
        frac_held_out_initial=mean_or_gap(found.frac_initial[validation]),
        frac_held_out_final=mean_or_gap(found.frac_final[validation]),
        fdac_diagonal_initial=mean_or_gap(np.diag(found.fdac_initial)),
        fdac_diagonal_final=mean_or_gap(np.diag(found.fdac_final)),
        peak_shift_percent_initial=initial,
        peak_shift_percent_final=final,
        mean_spectrum=Spectrum(peaks=_peaks(found.mean_peaks)),
        responses={
            response.name: ResponseCorrelation(
                frac_initial=found.frac_initial[i], frac_final=found.frac_final[i], peaks=_peaks(found.peaks[i])
            )
            for i, response in enumerate(inputs.responses)
        },
    )


def _peaks(table: PeakTable) -> tuple[Peak, ...]:
    # Six digits are finer than any line spacing.
    rounded = ([float(f"{value:.6g}") for value in column] for column in (table.measured_hz, table.initial_hz, table.final_hz))
    return tuple(Peak(measured_hz=m, initial_hz=i, final_hz=f) for m, i, f in zip(*rounded, strict=True))


def mean_of(values: Floats) -> float | None:
    """Mean of the finite values; None if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else None


def mean_or_gap(values: Floats) -> float:
    """The same as records have it: NaN if there are none."""
    found = mean_of(values)
    return float("nan") if found is None else found


def fdac_rows(result: Identification, found: Correlation) -> list[list[float]]:
    """Rows of ``fdac.csv``: measured line [Hz], line of the model [Hz], FDAC of the initial and of the updated model, to three decimals."""
    f = result.measurement.frequency_hz[found.lines]
    initial, updated = found.fdac_initial.round(3), found.fdac_final.round(3)
    n = range(f.size)
    return [[float(f[i]), float(f[j]), float(initial[i, j]), float(updated[i, j])] for i in n for j in n]
