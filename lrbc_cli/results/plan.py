"""``plan.json``: what a planned measurement can tell about each bolt, predicted from the model alone by ``lrbc plan``."""

from __future__ import annotations

from typing import ClassVar, Literal

from lrbc_cli.results.fields import Gap, Gaps, Many, MethodTree, Point, Record, SealedRecord, Share, Stated
from lrbc_cli.results.job import Lines, NoiseRecord, Provenance

#: Whether a bolt that has lost the planned stiffness will be called loose.
Visibility = Literal["detectable", "marginal", "not detectable"]


class PlannedNoise(NoiseRecord):
    """Noise of a line, the source of this number, and how many residuals count as one beside the correlation factor (for joints)."""

    source: str
    coarsening: float = 1.0

    @property
    def counted(self) -> float:
        """Number of residuals that count as one."""
        return self.correlation_factor * self.coarsening


class VisibilityLimits(Record):
    """Probabilities of a right verdict from which a bolt is detectable, and below which it is not."""

    detectable: float
    not_detectable: float


class PlannedNuisance(Record):
    """A nuisance parameter of the planned identification, with the standard deviation of its prior."""

    kind: str
    name: str
    std: float


class Rehearsals(Record):
    """Verdicts of simulated measurements in which one bolt has one loss of stiffness.

    Attributes
    ----------
    draws, loose, undecided, tight : int
        Number of simulated measurements, and of each verdict on the bolt.
    alarms : int
        Draws in which a tight bolt was called loose.
    alarmed : dict
        How often each of these bolts was called loose.
    judged : int
        Number of verdicts on tight bolts.
    change, probability_loose : (draws,) arrays
        Identified change [decades] and probability at the bolt.
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
    """Prediction for a bolt that alone has one loss of stiffness.

    Attributes
    ----------
    decades, change : float
        Change as asked and as the bounds allow [decades]; negative for a loosened bolt.
    d_prime : float
        Distance of the FRFs from what all other unknowns can imitate [standard deviations].
    right : float or None
        Probability of the right verdict on the bolt: loose.
    right95 : two floats or None
        Its 95 % interval from the draws of this bolt alone.
    missed, alarm : float or None
        Probability that the bolt is called tight, and that a tight bolt is called loose.
    linearised : float
        ``right`` as it follows from d'.
    """

    decades: float
    change: Gap
    d_prime: Gap
    right: Gap
    right95: Stated[Many[float]] = None
    missed: Gap
    alarm: Gap
    linearised: Gap
    rehearsal: Stated[Rehearsals] = None


class LossSum(Record):
    """All bolts at one loss: mean probability of a right verdict, number of verdicts of the rehearsals, and wrong ones among them."""

    decades: float
    right: Gap
    draws: int
    verdicts: int
    missed: int
    alarms: int


class PlannedTight(Record):
    """Verdicts of simulated measurements in which all bolts are tight, tightened again.

    Attributes
    ----------
    draws, clear, validated : int
        Number of simulated measurements, of those that are an all-clear, and of validated ones.
    verdicts, tight, loose : int
        Number of judged bolts in all draws, and of those called tight and loose.
    undecided : dict
        How often each of these bolts was inconclusive.
    """

    draws: int
    clear: int
    validated: int
    verdicts: int
    tight: int
    loose: int
    undecided: dict[str, int]


class WithAll(Record):
    """d' and standard deviation of a bolt [decades] if all responses of the campaign are measured."""

    d_prime: Gap
    std: Gap


class PlannedBolt(Record):
    """What the planned responses can tell about one bolt; null for unknown numbers."""

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
        """Prediction for one of the losses of the plan [decades]."""
        return next(loss for loss in self.losses if loss.decades == decades)


class Worst(Record):
    """The bolt with the lowest d'."""

    bolt: str
    d_prime: Gap


class Sum(Record):
    """Information of a set of responses on all bolts [bits], and the bolt with the lowest d'."""

    bits: Gap
    worst: Worst | None = None


class PlannedSum(Sum):
    """The same for the planned responses, with the numbers of detectable, marginal and not detectable bolts."""

    detectable: int
    marginal: int
    not_detectable: int


class Worth(Record):
    """Information of a response [bits]: gained by adding it to the planned ones or lost without it, and alone; the worst bolt then."""

    name: str
    planned: bool
    excitation: str
    quantity: str
    gain_bits: Gap
    alone_bits: Gap
    worst: Worst | None = None


class Chosen(Record):
    """A response in the order in which each adds most to those before it."""

    name: str
    bits: Gap
    worst: Worst | None = None


class Excitation(Record):
    """Information of the planned responses of one excitation [bits]: alone, lost without them, and with all responses of the excitation."""

    name: str
    responses: Many[str]
    alone_bits: Gap
    gain_bits: Gap
    all_bits: Gap
    worst: Worst | None = None


class PlanSeconds(Record):
    """Time of the reduction and of the plan [s]."""

    reduction: float
    plan: float


class PlanRecord(SealedRecord):
    """The whole plan; ``state`` describes the state it starts from, ``state_job`` is the job that gave it, if any."""

    HINT: ClassVar[str] = "run `lrbc plan` to write it again"

    format: Literal["lrbc-plan"]
    campaign: str
    state: str
    state_job: str | None = None
    noise: PlannedNoise
    #: Losses examined at every bolt [decades]; ``loss`` is the one on which the verdict of each bolt and all d' rest.
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
    identification: MethodTree | None = None
    limits: VisibilityLimits
    lines: Lines
    nuisances: Many[PlannedNuisance] = ()
    bolts: Many[PlannedBolt]
    by_loss: Many[LossSum]
    tight: Stated[PlannedTight] = None
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
        """Whether the predictions come from rehearsals; else they follow from d'."""
        return self.draws > 0
