"""The tight state that other jobs are compared with, as its own job found it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from lrbc_cli.arrays import Floats
from lrbc_cli.updating.judging.evidence import VALIDATION


@dataclass(frozen=True, kw_only=True)
class GroupState:
    """One parameter group in the reference state.

    Attributes
    ----------
    log10 : (k,) float array
        Identified values.
    damping_exponent : float or None
    log10_effective : (k,) float array
        Of the smoothed terms.
    std, upper95 : (k,) float arrays or None
        Of these [decades]; NaN where there is no limit.
    """

    log10: Floats
    damping_exponent: float | None = None
    log10_effective: Floats
    std: Floats | None = None
    upper95: Floats | None = None


@dataclass(frozen=True, kw_only=True)
class ReferenceState:
    """What identifying and judging a job take of its reference job.

    Attributes
    ----------
    job : str
    parameters : mapping
        State of each parameter group, by name.
    covariance : (n, n) float array or None
        Of all values and damping exponents, in the order of the groups.
    sigma_db : float
        Scatter of the residuals [dB].
    misfit_db, validation_db : float or None
        Mean misfit of the responses used, and of the validation channels [dB].
    hammer_offset_m : mapping
        Where the hammer hit, by excitation and direction [m].
    gain_db : mapping
        By how much its FRFs lie above the model's at all lines, by response [dB].
    explained : bool
        The model explains its measurement, by the rule that it was judged by.
    inputs : frozenset of str
        SHA-256 of the files that it was identified from.
    """

    job: str
    parameters: Mapping[str, GroupState] = field(repr=False)
    covariance: Floats | None = field(repr=False)
    sigma_db: float
    misfit_db: float
    validation_db: float | None
    hammer_offset_m: Mapping[str, float] = field(default_factory=dict)
    gain_db: Mapping[str, float] = field(default_factory=dict)
    explained: bool = True
    inputs: frozenset[str] = field(default_factory=frozenset, repr=False)

    def misfit_of(self, channels: str | None) -> float | None:
        """Mean misfit of these channels [dB]."""
        return self.validation_db if channels == VALIDATION else self.misfit_db
