"""The statistical model as one value: what decides a verdict before a decision rule does, from the lines that count to the priors."""

from __future__ import annotations

from dataclasses import dataclass

from lrbc_cli.updating.error_model import ERRORS, ErrorModel
from lrbc_cli.updating.lines import RESONANCES, Resonances
from lrbc_cli.updating.priors import BOLT_PRIOR, CALIBRATION_PRIOR, VALUE_PRIOR, BoltPrior, CalibrationPrior, ValuePrior
from lrbc_cli.updating.saturation import LIMITS, Limits


@dataclass(frozen=True)
class StatisticalModel:
    """Passed from the campaign's ``Method`` down to where each part is used, and part of what a result rests on.

    Attributes
    ----------
    errors : ErrorModel
    bolts : BoltPrior
    values : ValuePrior
    resonances : Resonances
        Which lines count.
    limits : Limits
        Where FRFs count as free or clamped.
    calibration : CalibrationPrior
    """

    errors: ErrorModel = ERRORS
    bolts: BoltPrior = BOLT_PRIOR
    values: ValuePrior = VALUE_PRIOR
    resonances: Resonances = RESONANCES
    limits: Limits = LIMITS
    calibration: CalibrationPrior = CALIBRATION_PRIOR


#: The defaults, for those who call a part alone.
STATISTICS = StatisticalModel()
