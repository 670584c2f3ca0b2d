"""``rehearsal.json``: what was drawn for virtual measurements, to be compared with what was found."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from lrbc_cli.results.fields import Many, Record, SealedRecord


class RehearsedJob(Record):
    """One job: its loosened bolts, by how many decades each bolt was changed, the values that this gave, and what drifted."""

    removed: Many[str]
    decades: dict[str, float]
    log10: dict[str, Many[float]]
    drift: dict[str, Any]


class RehearsalRecord(SealedRecord):
    """What was asked for, and what was drawn; ``factors`` are those on the model's materials and damping."""

    HINT: ClassVar[str] = "run `lrbc rehearse` with --force to write it again"

    format: Literal["lrbc-rehearsal"]
    campaign: str
    seed: int
    settings: dict[str, Any]
    factors: dict[str, float]
    jobs: dict[str, RehearsedJob]
    versions: dict[str, str]
