"""``campaign.json``, ``reduction.json`` and ``calibration.json``: records that all jobs of a campaign share."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from lrbc_cli.results.fields import Gap, Gaps, Many, Point, Range, Record, SealedRecord, Seconds, Stated, Vector, same_length, wrong
from lrbc_cli.results.job import CalibrationInUse, Lines, MisfitRecord, NoiseRecord, Provenance
from lrbc_cli.results.nuisances import Estimate


def _folders(names: tuple[str, ...]) -> tuple[str, ...]:
    """Accept names that can be folders, each once: the results of a job lie in a folder of its name."""
    for index, name in enumerate(names):
        if not name.strip() or name in {".", ".."} or any(mark in name for mark in '/\\:\0\n\r\t"<>|?*') or name in names[:index]:
            raise wrong(f"[{index}]", "names that folders may have, each once", repr(name))
    return names


class PlaceRecord(Record):
    """Name and position [m] of a bolt."""

    name: str
    position: Point


class ResponseRecord(Record):
    """A response of the campaign; ``unit`` is that of the FRF, ``used`` is false for validation channels."""

    name: str
    quantity: str
    unit: str
    used: bool


class Tool(Record):
    """Name and version of the program that wrote the results."""

    name: str
    version: str


class CalibrationNews(Record):
    """Whether a stored calibration is used, and the message on it, which is a warning if the calibration is ``stale``."""

    used: bool
    stale: bool
    text: str


class ReadingRecord(Record):
    """Warnings given when the inputs were read, stored so that they can be repeated without reading the inputs again.

    ``origin`` is that of the results, see ``Provenance``; ``files`` holds the SHA-256 of the files written beside.
    """

    origin: str
    warnings: Many[str]
    calibration: CalibrationNews | None = None
    files: dict[str, str]


class CampaignRecord(SealedRecord):
    """The campaign: its jobs, bolts and responses in order. ``calibration`` is the key of the one that the jobs rest on.

    It is null without a calibration, and empty if the jobs rest on different ones. ``description``, ``test_article``, ``operator`` and
    ``compare_with`` are copied from the campaign file; no result rests on them.
    ``reference_guessed``: nobody confirmed that the reference job is tight.
    """

    format: Literal["lrbc-campaign"]
    campaign: str
    description: str = ""
    test_article: str = ""
    operator: str = ""
    compare_with: Literal["paper"] | None = None
    reference: str | None = None
    reference_guessed: bool = False
    jobs: Annotated[Many[str], AfterValidator(_folders)]
    bolts: Many[PlaceRecord]
    responses: Many[ResponseRecord]
    calibration: str | None = None
    reading: ReadingRecord | None = None
    tool: Tool

    @property
    def bolt_names(self) -> tuple[str, ...]:
        """Names of the bolts, in the order of their file."""
        return tuple(bolt.name for bolt in self.bolts)

    def response(self, name: str) -> ResponseRecord:
        """Response by name; one that the campaign does not list counts as unused, with an unknown quantity."""
        unknown = ResponseRecord(name=name, quantity="response", unit="1/N", used=False)
        return next((entry for entry in self.responses if entry.name == name), unknown)


class HeldOutRecord(Record):
    """Measured error of the reduced model at one line outside its basis, by kind of parameter vector."""

    frequency_hz: float
    errors: dict[str, float]


class ModelCertificate(Record):
    """Measured errors at lines outside the basis; ``unseen`` bounds those of a share of other lines at a confidence, null if unknown."""

    held_out: Many[HeldOutRecord]
    worst: Gap
    vectors: int | None = None
    unseen: float | None = None
    unseen_share: float | None = None
    unseen_confidence: float | None = None


class ExpansionPoint(Record):
    """Frequency at which the full model was solved, number of moments (``order``), and directions added to the basis."""

    frequency_hz: float
    order: int
    added: int


class StepRecord(Record):
    """One step of the adaptive reduction: size of the basis, estimated error over the band, error measured at the line then solved."""

    step: int
    size: int
    factorised_hz: float | None = None
    measured_error: float | None = None
    frequency_hz: Vector
    estimate: Gaps

    @model_validator(mode="after")
    def _together(self) -> Self:
        same_length(self, "frequency_hz", "estimate")
        return self


class Cache(Record):
    """Key of the reduced model, whether the cache held it, and the reason."""

    key: str
    hit: bool
    reason: str


class ReductionRecord(SealedRecord):
    """The reduced model: sizes, expansion points, certificate, times, machine."""

    HINT: ClassVar[str] = "run `lrbc reduce` to write it again"

    format: Literal["lrbc-reduction"]
    size: int
    size_structure: int
    size_acoustic: int
    full_size: int
    terms: int
    inputs: int
    outputs: int
    band_hz: Range
    tolerance: float
    reached: bool
    backend: str
    symmetry: str = ""
    expansion_points: Many[ExpansionPoint]
    certificate: ModelCertificate
    trace: Many[StepRecord]
    seconds: Seconds
    machine: dict[str, Any]
    date: str
    calibration: CalibrationInUse | None = None
    cache: Cache
    versions: dict[str, str]


#: Range of factors that a calibration can find: its own bounds lie inside.
Plausible = Annotated[float, Field(ge=0.01, le=100.0)]


class Factor(Estimate):
    """A factor of the reference model with its 95 % interval; a limit is null if it is open or unknown."""

    value: Plausible
    lower95: float | None = None
    upper95: float | None = None
    initial: float = 1.0


class Boundary(Record):
    """Values of a parameter group that were identified or held beside the factors."""

    log10: Vector
    damping_exponent: Stated[float] = None


class RoundRecord(Record):
    """One round of calibration: misfit [dB], factors, and measured error and size of the reduced model used."""

    misfit_db: Gap
    factors: dict[str, float]
    error: Gap
    size: int


class StageRecord(Record):
    """One stage of calibration on spectra smoothed over ``width_hz``: misfit before and after [dB]."""

    width_hz: Gap
    before_db: Gap
    after_db: Gap
    evaluations: int


class FactorCertificate(Record):
    """Measured error of the reduced model at the identified factors."""

    worst: float
    tolerance: float
    size: int
    held_out: Many[HeldOutRecord]


class CalibrationRecord(SealedRecord):
    """The factors of the reference model, digests of what they rest on (``key`` and its ``parts``), and the misfit reached."""

    HINT: ClassVar[str] = "run `lrbc calibrate` to write it again"

    format: Literal["lrbc-calibration"]
    job: str
    key: str
    parts: dict[str, str]
    used: bool
    status: str
    reason: str
    factors: Annotated[dict[str, Factor], Field(min_length=1)]
    gain_db: dict[str, Estimate] = Field(default_factory=dict)
    hammer_offset_mm: dict[str, Estimate] = Field(default_factory=dict)
    boundary: dict[str, Boundary] = Field(default_factory=dict)
    boundary_held: bool
    misfit_db: MisfitRecord
    noise: NoiseRecord
    rounds: Many[RoundRecord]
    stages: Many[StageRecord]
    reduction: FactorCertificate
    lines: Lines
    frf: Literal["calibration/frf.csv"] = "calibration/frf.csv"
    seconds: float
    seconds_by_stage: Seconds
    warnings: Many[str] = ()
    notes: Many[str] = ()
    provenance: Provenance
