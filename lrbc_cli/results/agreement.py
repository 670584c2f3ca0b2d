"""Records of ``result.json`` on the agreement of model and measurement before and after updating: modes, peaks, FRAC and FDAC."""

from __future__ import annotations

from typing import Literal

from lrbc_cli.results.fields import Gap, Many, Record


class ModePair(Record):
    """A mode of the model before and after updating: natural frequency [Hz], damping ratio, and MAC of both shapes over all DOFs.

    Null if the other state has no matching mode in the band. The loss factor of a mode is twice its damping ratio.
    """

    before_hz: Gap
    before_damping: Gap
    after_hz: Gap
    after_damping: Gap
    mac: Gap


class ModesRecord(Record):
    """Modes of the reduced model in the band; ``before`` tells whether the state before updating is the reference or the start values."""

    before: Literal["reference", "initial"]
    pairs: Many[ModePair]


class Peak(Record):
    """A measured peak and the matching peaks of the model before and after updating [Hz]; null if the model has none."""

    measured_hz: Gap
    initial_hz: Gap
    final_hz: Gap


class Spectrum(Record):
    """Peaks of one spectrum."""

    peaks: Many[Peak]


class ResponseCorrelation(Spectrum):
    """FRAC of one response before and after updating, and its peaks."""

    frac_initial: Gap
    frac_final: Gap


class CorrelationRecord(Record):
    """Agreement of the FRFs before and after updating: means over the responses used; peak shifts [%] over peaks matched in both states."""

    frac_initial: Gap
    frac_final: Gap
    frac_held_out_initial: Gap
    frac_held_out_final: Gap
    fdac_diagonal_initial: Gap
    fdac_diagonal_final: Gap
    peak_shift_percent_initial: Gap
    peak_shift_percent_final: Gap
    mean_spectrum: Spectrum
    responses: dict[str, ResponseCorrelation]
