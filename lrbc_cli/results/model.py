"""``campaign.json``, ``reduction.json`` and ``calibration.json``: what the jobs have in common."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from lrbc_cli.results.fields import Gap, Gaps, Many, Point, Range, Record, SealedRecord, Seconds, Vector, same_length, wrong
from lrbc_cli.results.job import CalibrationInUse, Estimate, Lines, MisfitRecord, NoiseRecord, Provenance


def _folders(names: tuple[str, ...]) -> tuple[str, ...]:
    """They become parts of paths."""
    for index, name in enumerate(names):
        if not name.strip() or name in {".", ".."} or any(mark in name for mark in '/\\:\0\n\r\t"<>|?*') or name in names[:index]:
            raise wrong(f"[{index}]", "names that folders may have, each once", repr(name))
    return names


class PlaceRecord(Record):
    """A bolt of the campaign."""

    name: str
    position: Point


class ResponseRecord(Record):
    """A response of the campaign; ``unit`` is that of the FRF, ``used`` tells whether the updating sees it."""

    name: str
    quantity: str
    unit: str
    used: bool


class Tool(Record):
    """What wrote the results."""

    name: str
    version: str


class CalibrationNews(Record):
    """What became of a stored calibration, in words that are a warning where it is ``stale``."""

    used: bool
    stale: bool
    text: str


class ReadingRecord(Record):
    """What was said of the inputs when they were read, so that they need not be read again to say it.

    ``origin`` is that of the results, see ``Provenance``; ``files`` the SHA-256 of what was written beside.
    """

    origin: str
    warnings: Many[str]
    calibration: CalibrationNews | None = None
    files: dict[str, str]


class CampaignRecord(SealedRecord):
    """The campaign: names, order and places; the key of the calibration its jobs rest on, empty for none of several, null without one.

    ``description``, ``test_article``, ``operator`` and ``compare_with`` are what the campaign file says; no result rests on them.
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
        """Return a response by name; one that the campaign does not list is unknown and unused."""
        unknown = ResponseRecord(name=name, quantity="response", unit="1/N", used=False)
        return next((entry for entry in self.responses if entry.name == name), unknown)


class HeldOutRecord(Record):
    """Measured error of the reduced model at one line outside its basis, per kind of parameter vector."""

    frequency_hz: float
    errors: dict[str, float]


class ModelCertificate(Record):
    """Measured errors; ``unseen`` bounds those at a share of all other lines, with a confidence, null where nothing tells."""

    held_out: Many[HeldOutRecord]
    worst: Gap
    vectors: int | None = None
    unseen: float | None = None
    unseen_share: float | None = None
    unseen_confidence: float | None = None


class ExpansionPoint(Record):
    """A point at which the full model was solved, and what it added to the basis."""

    frequency_hz: float
    order: int
    added: int


class StepRecord(Record):
    """One step of the adaptive reduction: the estimated error over the band, and what was then measured."""

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
    """Whether the reduced model was found, and why."""

    key: str
    hit: bool
    reason: str


class ReductionRecord(SealedRecord):
    """The reduced model: sizes, certificate, costs, machine."""

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


#: Factors beyond these are not what a calibration finds: its bounds lie closer to one.
Plausible = Annotated[float, Field(ge=0.01, le=100.0)]


class Factor(Estimate):
    """A factor of the reference model with its 95 % interval; null where a limit is open or unknown."""

    value: Plausible
    lower95: float | None = None
    upper95: float | None = None
    initial: float = 1.0


class Boundary(Record):
    """Values of a parameter group beside the factors."""

    log10: Vector
    damping_exponent: float | None = None


class RoundRecord(Record):
    """One round of calibration: misfit [dB], values of the factors, measured error of the reduced model it rests on."""

    misfit_db: Gap
    factors: dict[str, float]
    error: Gap
    size: int


class StageRecord(Record):
    """One width of smoothing over frequency, and its misfit."""

    width_hz: Gap
    before_db: Gap
    after_db: Gap
    evaluations: int


class FactorCertificate(Record):
    """Error of the reduced model at the factors found."""

    worst: float
    tolerance: float
    size: int
    held_out: Many[HeldOutRecord]


class CalibrationRecord(SealedRecord):
    """The factors of the reference model, what they rest on (``key`` and its ``parts``), and how well the model then agrees."""

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
