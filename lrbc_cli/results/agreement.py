"""How FRFs and natural frequencies agree before and after updating, as ``result.json`` holds it."""

from __future__ import annotations

from typing import Literal

from lrbc_cli.results.fields import Gap, Many, Record


class ModePair(Record):
    """A mode of the model before and after: natural frequencies [Hz], damping ratios zeta, and the MAC of both shapes over the whole model.

    Null where the other state has no mode like it in the band; the loss factor of a mode is twice its damping ratio.
    """

    before_hz: Gap
    before_damping: Gap
    after_hz: Gap
    after_damping: Gap
    mac: Gap


class ModesRecord(Record):
    """Modes of the band, of the reduced model; ``before`` is the reference state or the start values."""

    before: Literal["reference", "initial"]
    pairs: Many[ModePair]


class Peak(Record):
    """A measured peak and the same resonance of the model before and after [Hz]; null where the model has none."""

    measured_hz: Gap
    initial_hz: Gap
    final_hz: Gap


class Spectrum(Record):
    """The peaks of a spectrum."""

    peaks: Many[Peak]


class ResponseCorrelation(Spectrum):
    """FRAC before and after of one response, and its peaks."""

    frac_initial: Gap
    frac_final: Gap


class CorrelationRecord(Record):
    """How well the FRFs agree before and after; means are over the responses used, shifts over peaks matched both times [%]."""

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
