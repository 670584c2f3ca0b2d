"""The statistical model as one value: all numbers of an identification, from the choice of lines to the priors.

The numbers of the judgement that follows are those of ``judging.rule.DecisionRule``.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, fields

from lrbc_cli.updating.checked import Checked, Count, NotNegative, Share
from lrbc_cli.updating.own_code import code_of
from lrbc_cli.updating.statistics.chain.blows import BLOWS, BlowRule
from lrbc_cli.updating.statistics.chain.modal import MODAL, ModalRule
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel
from lrbc_cli.updating.statistics.lines import RESOLUTION, RESONANCES, Resolution, Resonances
from lrbc_cli.updating.statistics.priors import BOLT_PRIOR, CALIBRATION_PRIOR, VALUE_PRIOR, BoltPrior, CalibrationPrior, ValuePrior
from lrbc_cli.updating.statistics.saturation import LIMITS, Limits


@dataclass(frozen=True, kw_only=True)
class ValidationChannels(Checked):
    """Which responses count as validation channels, and which faults of a measurement prevent its validation.

    Attributes
    ----------
    least_lines : float
        Least share of the lines on which a validation channel has values. A choice.
    copied : float
        Relative difference below which two responses are the same record: the precision of files; no two sensors agree as closely.
    copied_db : float
        Largest scatter of the level difference of two records of one measurement [dB]: rounding to three digits leaves 0.006 dB, the
        noise of a separate measurement more, see ``copied_responses``.
    least_common, same_line : int, float
        Least number of common lines for that comparison, and the relative distance up to which two lines are the same.
    least_span : float
        Least share of the range of the reference job's lines that the lines of a job span; less means a truncated file. A choice.
    exchanged_db, exchanged_share : float
        Responses are exchanged if, as they are named, their mean distance from the model, constants taken out, is above the first [dB], and
        if exchanged it is at most the second times that. A choice: twice the misfit of a tight state.
    exchanged_lines : int
        Least number of lines on which both have values for that comparison. A choice.
    """

    least_lines: Share = 0.8
    copied: NotNegative = 1e-6
    copied_db: NotNegative = 0.01
    least_common: Count = 10
    same_line: NotNegative = 1e-5
    least_span: Share = 0.98
    exchanged_db: NotNegative = 3.0
    exchanged_share: Share = 0.5
    exchanged_lines: Count = 5


@dataclass(frozen=True, kw_only=True)
class StatisticalModel(Checked):
    """All parts of the statistical model; passed from the campaign's ``Method`` to where each is used, and stored with a result.

    Attributes
    ----------
    errors : ErrorModel
    bolts : BoltPrior
    values : ValuePrior
    resonances : Resonances
        Which lines are compared.
    resolution : Resolution
        Whether the lines resolve the peaks.
    limits : Limits
        When FRFs count as those of the free or clamped limit.
    calibration : CalibrationPrior
    validation : ValidationChannels
    modal : ModalRule
        Whether a job was measured with another window or filter than the reference job.
    blows : BlowRule
        Whether a job was hit twice.
    """

    errors: ErrorModel = ERRORS
    bolts: BoltPrior = BOLT_PRIOR
    values: ValuePrior = VALUE_PRIOR
    resonances: Resonances = RESONANCES
    resolution: Resolution = RESOLUTION
    limits: Limits = LIMITS
    calibration: CalibrationPrior = CALIBRATION_PRIOR
    validation: ValidationChannels = ValidationChannels()
    modal: ModalRule = MODAL
    blows: BlowRule = BLOWS

    def digest(self, *names: str) -> str:
        """SHA-256 digest of the named parts, or of all: their numbers and classes, since a subclass may compute differently."""
        parts = {name: getattr(self, name) for name in names or [entry.name for entry in fields(self)]}
        found = sorted((name, code_of(type(part)), sorted(asdict(part).items())) for name, part in parts.items())
        return hashlib.sha256(repr(found).encode()).hexdigest()


#: The defaults, for callers that use a part of the package by itself.
STATISTICS = StatisticalModel()
