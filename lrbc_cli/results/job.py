"""``NAME/result.json``: what was identified and judged from one measurement, or why that failed."""

from __future__ import annotations

import math
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from lrbc_cli.results.agreement import CorrelationRecord, ModesRecord
from lrbc_cli.results.fields import (
    Gap,
    Gaps,
    Many,
    MethodTree,
    Point,
    Points,
    Range,
    Record,
    SealedRecord,
    Seconds,
    Share,
    Square,
    Stated,
    Vector,
    same_length,
    wrong,
)
from lrbc_cli.results.nuisances import Nuisances
from lrbc_cli.updating.judging.clearance import BoltFinding, JobFinding, sentence
from lrbc_cli.updating.judging.reference import GroupState, ReferenceState

Verdict = Literal["tight", "loose", "undecided", "outside"]


class SaturationRecord(Record):
    """Values [log10] below (``free``) and above (``clamped``) which the springs are saturated, and the start value between them."""

    free: float
    start: float
    clamped: float


class Parameter(Record):
    """The identified values of one parameter group.

    ``log10_effective`` holds the values after smoothing along the edge; ``lower95`` and ``upper95`` are their 95 % limits, null if the
    interval is open to that side; ``reference_log10_effective`` is the tight state. Positions and arc lengths are in metres. For joints,
    which have no ``arc_length``, ``bolts`` names the bolt that owns each value.
    """

    kind: str
    unit: str = ""
    log10: Vector
    log10_effective: Gaps
    log10_per_metre: Gaps | None = None
    std: Gaps | None = None
    lower95: Gaps | None = None
    upper95: Gaps | None = None
    initial: Gaps
    initial_effective: Gaps
    reference_log10_effective: Gaps | None = None
    bounds: Range | None = None
    positions: Points | None = None
    arc_length: Vector | None = None
    bolts: Many[str | None] | None = None
    saturation: Stated[SaturationRecord] = None
    damping_exponent: float | None = None
    damping_exponent_std: float | None = None
    damping_factor: float | None = None
    damping_beta: float | None = None
    damping_loss_factor: float | None = None
    damping_bounds: Range | None = None

    @model_validator(mode="after")
    def _together(self) -> Self:
        names = ("log10_effective", "log10_per_metre", "std", "lower95", "upper95", "initial", "initial_effective")
        same_length(self, "log10", *names, "reference_log10_effective", "positions", "arc_length", "bolts")
        for own, other in (("damping_exponent", "damping_factor"), ("damping_factor", "damping_exponent")):
            if getattr(self, own) is None and (own in self.model_fields_set or getattr(self, other) is not None):
                raise wrong(f".{own}", "a number", "none")
        return self


class BeforeAfter(Record):
    """A number before and after updating."""

    initial: Gap
    final: Gap


class ResponseMisfit(BeforeAfter):
    """Misfit of one response [dB]; ``used`` is false for validation channels."""

    used: bool


class MisfitRecord(Record):
    """Misfit over the lines of the band, values that are mostly noise left out [dB].

    Of the responses used, of the validation channels (``held_out``), of each response.
    """

    initial: Gap
    final: float
    held_out_initial: Gap
    held_out_final: Gap
    responses: dict[str, ResponseMisfit]


class Bolt(Record):
    """Result at one bolt; ``removed`` is its true state as the campaign states it, null if unknown.

    ``change``, its ``change_std``, its 95 % limits ``change_interval95`` (null if open to that side) and the ``threshold`` below
    which a bolt counts as loose are in decades. A bolt ``outside``, which no term reaches, has none of these numbers. ``open_groups``:
    groups of springs of a tight bolt whose loss alone the data do not exclude; ``unclear_groups``: those that all baselines exclude, and
    that would show. ``lost_groups``: those that the data call loose alone; ``excluded_groups``: those that the data exclude.
    """

    name: str
    position: Point
    log10_stiffness: float | None = None
    change: float | None = None
    change_std: float | None = None
    change_interval95: Range | None = None
    threshold: float | None = None
    probability_loose: Share | None = None
    probability_changed: Share | None = None
    open_groups: Many[str] = ()
    unclear_groups: Many[str] = ()
    excluded_groups: Many[str] = ()
    lost_groups: Many[str] = ()
    verdict: Verdict
    removed: bool | None = None
    note: str | None = None

    @property
    def outside(self) -> bool:
        """Whether no term reaches the bolt, so that the FRFs tell nothing about it."""
        return self.verdict == "outside"


class TakenAsTight(Record):
    """Role of a job whose bolts are assumed to be tight, and the bolts that the fit shows as loose all the same (``doubtful``)."""

    role: Literal["reference", "baseline"] = Field(alias="as")
    doubtful: Many[str]


class ValidityRecord(Record):
    """Whether the model explains the measurement.

    ``passed`` is null if bolts are judged but not validated; ``unvalidated`` states the reason. ``held_out_db`` is the misfit of the
    validation channels, ``limit_db`` its upper limit [dB]: above it only loose bolts are named, or none. ``nearest``: bolts that
    are loose, else those that probably are, in the state that fits best, if ``passed`` is false.
    """

    passed: bool | None
    compared: str | None = None
    misfit_db: float | None = None
    held_out_db: float | None = None
    limit_db: float | None = None
    reason: str = ""
    unvalidated: str = ""
    nearest: Many[str] = ()


class NoiseRecord(Record):
    """Scatter of the residuals [dB] and correlation factor (number of lines over their effective sample size) behind all intervals."""

    sigma_db: float
    correlation_factor: float
    validation_ratio: float = 1.0


class Prior(Record):
    """The prior of the verdicts: the state it is about, the unknowns, its standard deviation [decades], its shape."""

    of: str
    unknowns: str
    std: float | None
    shape: str
    comparison: str
    scatter: float


class EvaluationRecord(Record):
    """One entry of the optimiser's history."""

    evaluation: int
    cost: Gap
    misfit_db: Gap
    accepted: bool = True


class Lines(Record):
    """The frequency lines used."""

    frequency_hz: Vector
    count: int


class StartRecord(Record):
    """A start of the optimiser, the cost at which its descent ended, and whether this end was kept."""

    description: str
    cost: Gap
    total: Gap
    kept: bool


class Optimiser(Record):
    """Method, weight of the penalty and starts of the minimisation."""

    method: str
    regularisation: Gap
    regularisation_per_residual: Gap
    starts: Many[StartRecord] = ()


class Alternative(Record):
    """Loose bolts of one of several states with similar posterior probabilities; the verdicts account for all of these states."""

    loose: Many[str]
    probability: float


class CornerRecord(Record):
    """Corner of an L-curve: sums of squares of data and penalty."""

    data: float
    penalty: float


class LCurveRecord(Record):
    """L-curve: sums of squares of residuals (``data``) and penalty for each weight ``eta``; ``at`` is its corner, null if there is none."""

    eta: Vector
    data: Gaps
    penalty: Gaps
    corner: int | None = None
    at: CornerRecord | None = None
    chosen: float
    evaluations: int | None = None

    @model_validator(mode="after")
    def _together(self) -> Self:
        same_length(self, "eta", "data", "penalty")
        return self


class CalibrationInUse(Record):
    """Key and factors of the calibration that the model uses."""

    key: str
    factors: dict[str, float]


class Certificate(Record):
    """Key, size and measured error of the reduced model that a result rests on."""

    key: str
    size: int
    tolerance: float | None = None
    worst: Gap
    reached: bool | None = None


class RestsOn(Record):
    """Digests of the tight states behind the verdicts; null (reference) or left out (baselines) for a job without a result."""

    reference: str | None = None
    baselines: dict[str, str]


class IdentityRecord(Record):
    """Digest of everything that a result or judgement rests on, and the digests of its parts by name.

    For a judgement also why the measurement counts as a copy of that of another job (``copied``), this job (``original``) and the digest
    of its measurement (``content``).
    """

    identity: str
    parts: dict[str, str]
    copied: str | None = None
    original: str | None = None
    content: str | None = None


class Provenance(Record):
    """What a result rests on; ``inputs`` and ``files`` hold the SHA-256 of each file read for it and written with it."""

    identity: str | None = None
    #: Digest of everything except the bytes of ``inputs``: while both are unchanged, jobs can be judged again without reading the model.
    origin: str | None = None
    parts: dict[str, str] | None = None
    versions: dict[str, str] = Field(default_factory=dict)
    inputs: dict[str, str] = Field(default_factory=dict)
    configuration: dict[str, Any] = Field(default_factory=dict)
    calibration: CalibrationInUse | None = None
    certificate: Stated[Certificate] = None
    rests_on: RestsOn | None = None
    #: Means of the measurement [dB] by which a copy of it is recognised, see ``Measurement.means``.
    measured_db: Vector | None = None
    #: The same of the noise by its coherence, see ``Measurement.noise_means``.
    coherence_db: Vector | None = None
    files: dict[str, str] | None = None
    judgement: IdentityRecord | None = None


class _JobBase(SealedRecord):
    format: Literal["lrbc-result"]
    job: str


class FailedJob(_JobBase):
    """A job without a result, and the reason."""

    status: Literal["failed"]
    reason: str
    provenance: Provenance

    @property
    def finding(self) -> JobFinding:
        """Status and verdicts of the job, for summaries and exit codes."""
        return JobFinding(status="failed")

    @property
    def sentence(self) -> str:
        """One sentence for people: the first line of the reason."""
        return f"{self.job}: failed: {(self.reason.strip() or 'no reason given').splitlines()[0]}"


class JobRecord(_JobBase):
    """Result of a job. ``status`` unexplained: the model does not reproduce the measurement, so there are no verdicts."""

    status: Literal["converged", "stopped", "unexplained"]
    reason: str
    removed: Many[str] | None = None
    parameters: dict[str, Parameter]
    covariance: Square | None = None
    cost: BeforeAfter
    misfit_db: MisfitRecord
    bolts: Many[Bolt]
    alternatives: Many[Alternative] = ()
    taken_as_tight: TakenAsTight | None = None
    validity: ValidityRecord | None = None
    noise: NoiseRecord
    prior: Prior | None = None
    nuisances: Nuisances = Nuisances()
    method: MethodTree | None = None
    decision_rule: dict[str, float] | None = None
    iterations: int
    evaluations: int
    line_evaluations: int
    history: Many[EvaluationRecord] = ()
    lines: Lines
    optimiser: Optimiser
    l_curve: LCurveRecord | None = None
    seconds: Seconds
    warnings: Many[str] = ()
    notes: Many[str] = ()
    provenance: Provenance
    correlation: Stated[CorrelationRecord] = None
    modes: ModesRecord | None = None

    @property
    def explained(self) -> bool:
        """Whether the model reproduces the measurement, so that there are verdicts."""
        return self.status != "unexplained"

    @property
    def validated(self) -> bool:
        """False if there are verdicts but they are neither validated nor refuted (``validity.passed`` is null)."""
        return not self.explained or self.validity is None or self.validity.passed is not None

    @property
    def observable(self) -> list[Bolt]:
        """The bolts that a term reaches."""
        return [bolt for bolt in self.bolts if not bolt.outside]

    @property
    def damped(self) -> dict[str, Parameter]:
        """The groups with an identified damping exponent."""
        return {name: group for name, group in self.parameters.items() if group.damping_exponent is not None}

    def names(self, verdict: Verdict) -> list[str]:
        """Names of the bolts with this verdict."""
        return [bolt.name for bolt in self.bolts if bolt.verdict == verdict]

    @property
    def finding(self) -> JobFinding:
        """Status and verdicts of the job, for summaries and exit codes."""
        tight = self.taken_as_tight
        return JobFinding(
            status=self.status,
            bolts=tuple(map(BoltFinding.of, self.bolts)),
            identity=self.provenance.identity or "",
            against=(self.provenance.parts or {}).get("reference", ""),
            validated=self.validity is not None and self.validity.passed is True,
            unvalidated="" if self.validity is None else self.validity.unvalidated,
            nearest=() if self.validity is None else self.validity.nearest,
            assumed=None if tight is None else tight.role,
            doubtful=() if tight is None else tight.doubtful,
            missing=tuple(name for name, entry in self.misfit_db.responses.items() if entry.used and not math.isfinite(entry.final)),
            measurement=() if self.provenance.measured_db is None else tuple(self.provenance.measured_db.tolist()),
            coherence=() if self.provenance.coherence_db is None else tuple(self.provenance.coherence_db.tolist()),
            content=self.provenance.parts.get("measurement", "") if self.provenance.parts else "",
            copied_content=self.provenance.judgement.content or "" if self.provenance.judgement else "",
            **{name: value for name, value in (self.decision_rule or {}).items() if name in ("copied_db", "confidence")},
        )

    @property
    def sentence(self) -> str:
        """The finding as one sentence for people: ``bolts-04: B08 to B10 loose, B11 probably; 9 tight``."""
        return f"{self.job}: {sentence(self.finding)}"

    @property
    def state(self) -> ReferenceState:
        """The identified state that other jobs use if this is their reference job."""
        validation = self.misfit_db.held_out_final
        return ReferenceState(
            job=self.job,
            parameters={
                name: GroupState(
                    log10=group.log10,
                    damping_exponent=group.damping_exponent,
                    log10_effective=group.log10_effective,
                    std=group.std,
                    upper95=group.upper95,
                )
                for name, group in self.parameters.items()
            },
            covariance=self.covariance,
            sigma_db=self.noise.sigma_db,
            misfit_db=self.misfit_db.final,
            validation_db=validation if math.isfinite(validation) else None,
            hammer_offset_m={name: 1e-3 * entry.value for name, entry in self.nuisances.hammer_offset_mm.items()},
            gain_db={name: entry.value for name, entry in self.nuisances.gain_db.items()},
            explained=self.explained,
            inputs=frozenset(self.provenance.inputs.values()),
        )


Job = JobRecord | FailedJob
