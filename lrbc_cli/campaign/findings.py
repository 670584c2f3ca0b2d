"""Findings of ``lrbc check``: typed warnings, and how one cause that shows in several jobs or files becomes one line."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from enum import Enum, auto


class Kind(Enum):
    """Cause of a finding; findings of one kind about the same responses are one fault, whatever numbers their texts hold."""

    # Numbers of a file, without the model.
    BLOW = auto()
    CHAIN = auto()
    DIGITS = auto()
    NOISE = auto()
    NORMALISED = auto()
    # Numbers of a file, by comparison with the model or the reference job.
    READ = auto()
    UNITS = auto()
    LEVEL = auto()
    REVERSED = auto()
    LATE = auto()
    EARLY = auto()
    CONJUGATE = auto()
    CUT = auto()
    FILTERED = auto()
    PARTS = auto()
    SIDEWAYS = auto()
    STRETCHED = auto()
    STRIKE = auto()
    # Places, directions and channels.
    ALONE = auto()
    COORDINATES = auto()
    EXCHANGED = auto()
    HAMMER = auto()
    HAMMERS = auto()
    ORIGIN = auto()
    PLACES = auto()
    # The model.
    GUESSED = auto()
    DAMPING = auto()
    HELD = auto()
    IDLE = auto()
    LOWERED = auto()
    MATERIAL = auto()
    RESCALED = auto()
    SPRINGS = auto()
    TABLE = auto()
    # The state of the structure.
    FOREIGN = auto()
    FREED = auto()
    NOT_TIGHT = auto()
    REMOVED = auto()
    UNLIKE = auto()


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A warning with its place and its cause.

    Attributes
    ----------
    text : str
        What was found, expected, and how to mend it, without the place.
    place : str
        ``job NAME`` or the name of a file; empty if the text says it.
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
    place: str = ""
    kind: Kind | None = None
    responses: tuple[int, ...] = ()
    cycles: tuple[tuple[int, ...], ...] = ()
    detail: str = ""

    @property
    def cause(self) -> Hashable:
        """Equal for findings that are one fault."""
        return self.text if self.kind is None else (self.kind, self.responses, self.cycles, self.detail)

    def __str__(self) -> str:
        return f"{self.place}: {self.text}" if self.place else self.text


def kinds_of(findings: Iterable[Finding]) -> set[Kind | None]:
    """Kinds of findings."""
    return {finding.kind for finding in findings}


def once(findings: Iterable[Finding]) -> list[str]:
    """One line for each cause, in the words of its first finding, with the other places that show it."""
    several: dict[Hashable, list[Finding]] = {}
    for finding in findings:
        several.setdefault(finding.cause, []).append(finding)
    told = []
    for first, *others in several.values():
        places = dict.fromkeys(other.place.removeprefix("job ") for other in others if other.place != first.place)
        told.append(f"{first}; also found in {', '.join(places)}" if any(places) else str(first))
    return told
