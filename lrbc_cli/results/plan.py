"""``plan.json``: what a measurement can tell of each bolt, from the model alone."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from lrbc_cli.results.fields import Gap, Gaps, Many, Point, Record, SealedRecord, Share
from lrbc_cli.results.job import Lines, NoiseRecord, Provenance

#: Whether a loosened bolt will be called loose.
Visibility = Literal["detectable", "marginal", "not detectable"]


class PlannedNoise(NoiseRecord):
    """Noise of a line, and where it is from."""

    source: str


class VisibilityLimits(Record):
    """Probability of a right verdict from which on a bolt is detectable, and below which it is not."""

    detectable: float
    not_detectable: float


class PlannedNuisance(Record):
    """A nuisance parameter beside the unknowns."""

    kind: str
    name: str
    std: float


class Rehearsals(Record):
    """What the rehearsals of one bolt and loss said.

    Attributes
    ----------
    draws, loose, undecided, tight : int
        How many, and the verdicts on the bolt itself.
    alarms : int
        Draws in which a tight bolt was called loose.
    alarmed : dict
        These bolts, and how often each was.
    judged : int
        Verdicts on tight bolts.
    change, probability_loose : (draws,) arrays
        As found at the bolt.
    """

    draws: int
    loose: int
    undecided: int
    tight: int
    alarms: int
    alarmed: dict[str, int]
    judged: int
    change: Gaps
    probability_loose: Gaps


class PlannedLoss(Record):
    """What will be said where a bolt alone has lost so much.

    Attributes
    ----------
    decades, change : float
        As asked, and as far as the bounds let it; negative where it is loosened.
    d_prime : float
    right : float or None
        Probability of a right verdict on the bolt: loose.
    right95 : two floats or None
        Its 95 % interval by the draws of this bolt alone.
    missed, alarm : float or None
        Probability that it is called tight, and that a tight bolt is called loose.
    linearised : float
        What d' says of ``right``.
    """

    decades: float
    change: Gap
    d_prime: Gap
    right: Gap
    right95: Many[float] | None = None
    missed: Gap
    alarm: Gap
    linearised: Gap
    rehearsal: Rehearsals | None = None


class LossSum(Record):
    """All bolts at one loss: mean probability of a right verdict; verdicts of the rehearsals on all bolts, and wrong ones among them."""

    decades: float
    right: Gap
    draws: int
    verdicts: int
    missed: int
    alarms: int


class WithAll(Record):
    """The same with all responses."""

    d_prime: Gap
    std: Gap


class PlannedBolt(Record):
    """What the planned responses can tell of one bolt; null where nothing is known."""

    name: str
    position: Point | None = None
    group: str | None = None
    arc_length: float | None = None
    verdict: Visibility
    std: Gap
    variance_removed: Gap
    losses: Many[PlannedLoss]
    all_responses: WithAll
    note: str | None = None

    def at(self, decades: float) -> PlannedLoss:
        """What is said of one of the losses."""
        return next(loss for loss in self.losses if loss.decades == decades)


class Worst(Record):
    """The bolt of which least is seen."""

    bolt: str
    d_prime: Gap


class Sum(Record):
    """What a set of responses tells of all bolts."""

    bits: Gap
    worst: Worst | None = None


class PlannedSum(Sum):
    """And bolts by what can be seen of them."""

    detectable: int
    marginal: int
    not_detectable: int


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


class PlanRecord(SealedRecord):
    """The whole plan; ``state_job`` is the job whose result the ``state`` is."""

    HINT: ClassVar[str] = "run `lrbc plan` to write it again"

    format: Literal["lrbc-plan"]
    campaign: str
    state: str
    state_job: str | None = None
    noise: PlannedNoise
    #: What is asked of every bolt, and on which of these its word and all d' rest [decades].
    losses: Many[float]
    loss: float
    tightened: bool
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
    by_loss: Many[LossSum]
    planned: PlannedSum
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
        return self.draws > 0
