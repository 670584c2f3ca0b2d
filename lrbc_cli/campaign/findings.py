"""Findings of ``lrbc check``: typed warnings, and how one cause that shows in several jobs or files becomes one line."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable
from dataclasses import dataclass, field
from enum import Enum, Flag, auto, unique

from lrbc_cli.errors import listing


class Effect(Flag):
    """What a finding of some kind means for the rest of the comparison."""

    NONE = 0
    #: The numbers, records or places of a job are wrong: nothing else that compares this job is told.
    DOUBTS_JOB = auto()
    #: In the reference job: no other job can be compared with the model.
    STOPS = auto()
    #: Says only that the model, or its springs, are far from the measurement: a stored calibration mends it.
    IS_FAR = auto()
    #: A rough calibration from that job is tried in spite of it.
    IS_CALIBRATED = auto()
    #: In the reference job: it remains the tight state for the others.
    LEAVES_TIGHT = auto()
    #: A factor, a phase or a delay of responses: told once if all jobs share it.
    IS_OFFSET = auto()
    #: A job taken as tight is not: follows if the files of two jobs are exchanged.
    NOT_TIGHT = auto()


@unique
class Kind(Enum):
    """Cause of a finding; findings of one kind about the same responses are one fault, whatever numbers their texts hold.

    Attributes
    ----------
    meaning : str
        The cause in words.
    effect : Effect
    """

    # Numbers of a file, without the model.
    BLOW = "a coherence of 1 at every line, as of a single blow"
    CHAIN = "a measuring chain unlike that of the reference job: clock, window, filter, gain"
    DIGITS = "values rounded to few digits"
    NOISE = "records that are mostly noise"
    NORMALISED = "records scaled to the same maximum"
    # Numbers of a file, by comparison with the model or the reference job.
    READ = "another reading fits: magnitude and phase, decibels, the inverse, zeros for imaginary parts", Effect.DOUBTS_JOB
    UNITS = "a factor, or a power of the frequency: another unit, sensitivity or quantity", Effect.DOUBTS_JOB | Effect.IS_OFFSET
    LEVEL = "a sensor without signal, or at another level than in the reference job", Effect.DOUBTS_JOB
    REVERSED = "a reversed sign of a sensor or a hammer", Effect.IS_OFFSET
    LATE = "sensors later than the hammer", Effect.IS_OFFSET
    EARLY = "sensors earlier than the hammer", Effect.IS_OFFSET
    CONJUGATE = "complex conjugates: the other sign convention of time", Effect.IS_OFFSET
    CUT = "the first milliseconds of the responses were not recorded", Effect.DOUBTS_JOB | Effect.STOPS
    FILTERED = "a filter in some channels", Effect.DOUBTS_JOB | Effect.STOPS
    PARTS = "real and imaginary parts exchanged"
    SIDEWAYS = "all phases 90 degrees off"
    STRETCHED = "another sampling rate: all frequencies times one factor", Effect.DOUBTS_JOB | Effect.STOPS | Effect.IS_CALIBRATED
    STRIKE = "the hammer hit beside its place in one job"
    # Places, directions and channels.
    ALONE = (
        "single responses that do not fit: their sensors, places or records",
        Effect.DOUBTS_JOB | Effect.IS_FAR | Effect.IS_CALIBRATED | Effect.LEAVES_TIGHT,
    )
    COORDINATES = "a sensor with another component, or with coordinates that are mixed up", Effect.IS_CALIBRATED
    EXCHANGED = "records or sensors that are exchanged", Effect.DOUBTS_JOB
    HAMMER = "a hammer point with another place, direction or records", Effect.DOUBTS_JOB | Effect.STOPS
    HAMMERS = "hammer points that are exchanged, or records of one for several", Effect.DOUBTS_JOB | Effect.STOPS
    ORIGIN = "all sensors or hammer points moved or mirrored together: another origin or axis", Effect.STOPS
    PLACES = "levels that differ between responses without another cause: places", Effect.IS_OFFSET | Effect.IS_CALIBRATED
    # The model.
    GUESSED = "another system of units, guessed from the model alone"
    DAMPING = "damping many times too high or too low", Effect.STOPS
    HELD = "nodes that are held in the model only"
    IDLE = "springs without effect: their nodes are held in the model", Effect.STOPS
    LOWERED = "a reference job with a bolt that is probably looser than the others", Effect.IS_FAR | Effect.LEAVES_TIGHT | Effect.NOT_TIGHT
    MATERIAL = "material, thickness or mass of the model or of a part of it", Effect.STOPS
    RESCALED = "the stiffness or mass matrix times a factor"
    SPRINGS = "springs of another unit, found by their effect", Effect.IS_FAR
    TABLE = "springs of some table or component wrong by a factor, or exchanged"
    # The state of the structure.
    FOREIGN = "a job unlike any state of the bolts: another structure or set-up, warmer air", Effect.DOUBTS_JOB
    FREED = "a job taken as tight that has a loose bolt", Effect.NOT_TIGHT
    NOT_TIGHT = "a reference job that is less tight than another job", Effect.NOT_TIGHT
    REMOVED = "bolts stated as removed that are not, or others that are"
    UNLIKE = "model and measurement have little in common, for no known cause", Effect.IS_FAR | Effect.IS_CALIBRATED

    def __init__(self, meaning: str, effect: Effect = Effect.NONE) -> None:
        self.meaning, self.effect = meaning, effect


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A warning with its place and its cause.

    Attributes
    ----------
    text : str
        What was found and expected, and the fix unless ``fix`` tells it, without the place.
    fix : str
        What to do where no cause is known: clauses on what else was seen come before it.
    job : str
        Job in which it was found; empty if it is in none alone, or if the text says it.
    place : str
        Where else it was found: the name of a file, several jobs; empty if a job or the text says it.
    kind : Kind or None
        None: the text is the cause.
    responses : tuple of int
        Indices of the responses concerned.
    cycles : tuple of tuples of int
        Exchanged responses, see ``likeness.exchanged``.
    detail : str
        Tells different causes of one kind apart; for ``Kind.UNITS`` not empty if another quantity was measured.
    """

    text: str
    fix: str = ""
    job: str = ""
    place: str = ""
    kind: Kind | None = None
    responses: tuple[int, ...] = ()
    cycles: tuple[tuple[int, ...], ...] = ()
    detail: str = ""

    @property
    def cause(self) -> Hashable:
        """Equal for findings that are one fault."""
        return self.text if self.kind is None else (self.kind, self.responses, self.cycles, self.detail)

    def has(self, effect: Effect) -> bool:
        """Whether its kind has this effect; a finding without a kind has none."""
        return self.kind is not None and bool(self.kind.effect & effect)

    def __str__(self) -> str:
        where = f"job {self.job}" if self.job else self.place
        text = f"{self.text}. {self.fix}" if self.fix else self.text
        return f"{where}: {text}" if where else text


def said(kind: Kind, text: str | None) -> list[Finding]:
    """The finding of a text; an empty list without a text, so that tests can follow each other by ``or``."""
    return [Finding(text=text, kind=kind)] if text else []


def kinds_of(findings: Iterable[Finding]) -> set[Kind | None]:
    """Kinds of findings."""
    return {finding.kind for finding in findings}


def without_responses(findings: Iterable[Finding], responses: Collection[int]) -> list[Finding]:
    """Findings without those about some of the responses alone, which another finding explains."""

    def about(finding: Finding) -> set[int]:
        return {*finding.responses, *(i for cycle in finding.cycles for i in cycle)}

    return [each for each in findings if not about(each) or not about(each) <= set(responses)]


def once(findings: Iterable[Finding]) -> list[str]:
    """One line for each cause, in the words of its first finding, with the other places that show it."""
    several: dict[Hashable, list[Finding]] = {}
    for finding in findings:
        several.setdefault(finding.cause, []).append(finding)
    told = []
    for first, *others in several.values():
        places = dict.fromkeys(other.job or other.place for other in others if (other.job, other.place) != (first.job, first.place))
        also = f"; also found in {', '.join(places)}" if any(places) else ""
        # A key of one job mends that job alone.
        told.append(f"{first}{also}{' (each needs its own key)' if also and f'jobs.{first.job}.' in first.text else ''}")
    return told


@dataclass(kw_only=True)
class Left:
    """What the comparison of measurements with the model leaves unexplained.

    Attributes
    ----------
    reference : str
        The reference job.
    far_db : dict of str to float
        Level misfits [dB] of the jobs that are farther from the model than usual: of the reference job, and of others after a coarse fit
        of the bolts.
    explained : set of str
        Jobs with findings that may explain these misfits.
    """

    reference: str = ""
    far_db: dict[str, float] = field(default_factory=dict)
    explained: set[str] = field(default_factory=set)

    @property
    def text(self) -> str:
        """What no finding explains, in a sentence; else empty."""
        # What is wrong with the reference job is wrong beside all others.
        if self.reference in self.explained:
            return ""
        if self.reference in self.far_db:
            return (
                f"the reference job is {self.far_db[self.reference]:.1f} dB from the model (1 to 2 dB are usual after a calibration; see "
                "jobs): an error of the model may hide loose bolts"
            )
        if named := [f"{name} ({far:.1f} dB)" for name, far in self.far_db.items() if name not in self.explained]:
            return (
                f"the coarse fit of the bolts leaves much of {listing(named, 4)}: many loose bolts (`lrbc update` fits more closely), an "
                "error of the model, or more than bolts changed"
            )
        return ""
