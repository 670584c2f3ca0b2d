"""The statistical model as one value: what decides a verdict before a decision rule does, from the lines that count to the priors."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, fields

from lrbc_cli.updating.statistics.chain.modal import MODAL, ModalRule
from lrbc_cli.updating.statistics.error_model import ERRORS, ErrorModel
from lrbc_cli.updating.statistics.lines import RESOLUTION, RESONANCES, Resolution, Resonances
from lrbc_cli.updating.statistics.priors import BOLT_PRIOR, CALIBRATION_PRIOR, VALUE_PRIOR, BoltPrior, CalibrationPrior, ValuePrior
from lrbc_cli.updating.statistics.saturation import LIMITS, Limits


@dataclass(frozen=True, kw_only=True)
class ValidationChannels:
    """Which responses that were not fitted can show whether the model explains a measurement: without one no job is validated.

    Attributes
    ----------
    least_lines : float
        Share of the lines on which such a response has values. A choice.
    copied : float
        Relative difference below which two records are one: no file has more digits than that, and no two sensors as many in common.
    copied_db : float
        Scatter of the level against another measurement up to which both are one, written with fewer digits: rounding to three digits
        leaves 0.006 dB, the noise of a measurement of its own more, see ``copied_responses``.
    least_common, same_line : int, float
        Lines in common from which that can be told, and the relative distance up to which two lines are one.
    least_span : float
        Share of the reference job's lines that a job's reach over: a file that was cut off on its way shows less. A choice.
    exchanged_db, exchanged_share : float
        Responses are in each other's place where they lie further from the model than the one as they are called [dB], in the mean and
        constants taken out, and nearer to it than the other times that in each other's place. A choice: twice the misfit of a tight state.
    exchanged_lines : int
        Lines on which both have values from which that can be told. A choice: of fewer a mean distance says little.
    """

    least_lines: float = 0.8
    copied: float = 1e-6
    copied_db: float = 0.01
    least_common: int = 10
    same_line: float = 1e-5
    least_span: float = 0.98
    exchanged_db: float = 3.0
    exchanged_share: float = 0.5
    exchanged_lines: int = 5


@dataclass(frozen=True, kw_only=True)
class StatisticalModel:
    """Passed from the campaign's ``Method`` down to where each part is used, and part of what a result rests on.

    Attributes
    ----------
    errors : ErrorModel
    bolts : BoltPrior
    values : ValuePrior
    resonances : Resonances
        Which lines count.
    resolution : Resolution
        Whether the lines resolve the peaks.
    limits : Limits
        Where FRFs count as free or clamped.
    calibration : CalibrationPrior
    validation : ValidationChannels
    modal : ModalRule
        Whether a job was measured with another window or filter than the reference job.
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

    def digest(self, *names: str) -> str:
        """Digest of these parts, or of all: their numbers, and of which classes they are, for another class may compute otherwise."""
        parts = {name: getattr(self, name) for name in names or [entry.name for entry in fields(self)]}
        found = sorted((name, type(part).__qualname__, sorted(asdict(part).items())) for name, part in parts.items())
        return hashlib.sha256(repr(found).encode()).hexdigest()


#: The defaults, for those who call a part alone.
STATISTICS = StatisticalModel()
