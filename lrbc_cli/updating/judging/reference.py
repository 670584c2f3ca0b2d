"""The reference state: the tight state that other jobs are compared with, as identified from the reference job."""

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
        Identified log10 values p.
    damping_exponent : float or None
        p_damp.
    log10_effective : (k,) float array
        Effective values ``log10(W 10^p)``.
    std, upper95 : (k,) float arrays or None
        Standard deviation and upper 95 % limit of the effective values [decades]; NaN if open.
    """

    log10: Floats
    damping_exponent: float | None = None
    log10_effective: Floats
    std: Floats | None = None
    upper95: Floats | None = None


@dataclass(frozen=True, kw_only=True)
class ReferenceState:
    """Results of the reference job that the identification and judgement of other jobs use.

    Attributes
    ----------
    job : str
    parameters : mapping
        State of each parameter group, by name.
    covariance : (n, n) float array or None
        Covariance of theta: all values and damping exponents, in the order of the groups.
    sigma_db : float
        Standard deviation of the residuals [dB].
    misfit_db, validation_db : float or None
        Mean misfit of the responses used, and of the validation channels [dB].
    hammer_offset_m : mapping
        Offset of the hammer point, by excitation and direction [m].
    gain_db : mapping
        Gain of its measured FRFs relative to the model, by response [dB].
    explained : bool
        Whether the model explains its measurement, by the rule that it was judged with.
    inputs : frozenset of str
        SHA-256 digests of the files from which it was identified.
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
        """Mean misfit of the validation channels or, for any other name, of the channels used [dB]."""
        return self.validation_db if channels == VALIDATION else self.misfit_db
