"""``plan.json``: what a measurement can tell of each bolt, from the model alone."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from lrbc_cli.results.fields import Gap, Gaps, Many, Point, Record, Share, StoredRecord
from lrbc_cli.results.job import Lines, NoiseRecord, Provenance

Visibility = Literal["seen", "weak", "blind"]


class PlannedNoise(NoiseRecord):
    """Noise of a line, and where it is from."""

    source: str


class Limit(Record):
    """A probability of a right verdict, and the d' to which it belongs."""

    probability: float
    d_prime: float


class VisibilityLimits(Record):
    """At and above which a bolt is seen, and below which it is blind."""

    seen: Limit
    blind: Limit


class PlannedNuisance(Record):
    """A nuisance parameter beside the unknowns."""

    kind: str
    name: str
    std: float


class Rehearsals(Record):
    """What the rehearsals of one bolt said of it, and which tight bolts they called loose."""

    draws: int
    loose: int
    undecided: int
    tight: int
    right: int
    wrong: int
    others_loose: dict[str, int]
    change: Gaps
    probability_loose: Gaps


class LinearisedFigures(Record):
    """What follows from d'."""

    probability_correct: Gap
    expected_change: Gap
    expected_probability_loose: Gap


class WithAll(Record):
    """The same with all responses."""

    verdict: Visibility
    d_prime: Gap
    std: Gap


class PlannedBolt(Record):
    """What the planned responses can tell of one bolt; null where nothing is known."""

    name: str
    position: Point | None = None
    group: str | None = None
    arc_length: float | None = None
    verdict: Visibility
    d_prime: Gap
    probability_correct: Gap
    std: Gap
    lower95: Gap
    upper95: Gap
    variance_removed: Gap
    change: Gap
    expected_change: Gap
    expected_probability_loose: Gap
    rehearsal: Rehearsals | None = None
    linearised: LinearisedFigures
    all_responses: WithAll
    note: str | None = None


class Worst(Record):
    """The bolt of which least is seen."""

    bolt: str
    d_prime: Gap


class Sum(Record):
    """Bolts by what can be seen of them."""

    seen: int
    weak: int
    blind: int
    bits: Gap
    worst: Worst | None = None


class Worth(Record):
    """What a response is worth [bits]: added to the planned ones, or lost without it; the worst bolt then."""

    name: str
    planned: bool
    excitation: str
    quantity: str
    gain_bits: Gap
    alone_bits: Gap
    worst: Worst | None = None


class Chosen(Record):
    """A response in the order of what each adds to those before."""

    name: str
    bits: Gap
    worst: Worst | None = None


class Excitation(Record):
    """What the planned responses of one excitation are worth [bits]."""

    name: str
    responses: Many[str]
    alone_bits: Gap
    gain_bits: Gap
    all_bits: Gap
    worst: Worst | None = None


class PlanSeconds(Record):
    """Seconds."""

    reduction: float
    plan: float


class PlanRecord(StoredRecord):
    """The whole plan; ``state_job`` is the job whose result the ``state`` is."""

    HINT: ClassVar[str] = "run `lrbc plan` to write it anew"

    format: Literal["lrbc-plan"]
    campaign: str
    state: str
    state_job: str | None = None
    noise: PlannedNoise
    change: float
    unknowns: str
    prior_std: float
    confidence: Share
    loose_change: float
    method: str
    draws: int
    assumes: Many[str] = ()
    identification: dict[str, Any] | None = None
    limits: VisibilityLimits
    lines: Lines
    nuisances: Many[PlannedNuisance] = ()
    bolts: Many[PlannedBolt]
    planned: Sum
    all_responses: Sum
    responses: Many[Worth]
    order: Many[Chosen]
    excitations: Many[Excitation]
    notes: Many[str] = ()
    seconds: PlanSeconds
    provenance: Provenance

    @property
    def rehearsed(self) -> bool:
        """Whether verdicts are those of rehearsals; else they follow from d'."""
        return any(bolt.rehearsal is not None for bolt in self.bolts)
