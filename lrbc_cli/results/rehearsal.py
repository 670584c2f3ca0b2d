"""``rehearsal.json``: the true values that ``lrbc rehearse`` drew for its simulated measurements, to be compared with the results."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from lrbc_cli.results.fields import Many, Record, SealedRecord


class RehearsedJob(Record):
    """One simulated job: loosened bolts, change of each bolt [decades], resulting values [log10] by group, and drift."""

    removed: Many[str]
    decades: dict[str, float]
    log10: dict[str, Many[float]]
    drift: dict[str, Any]


class RehearsalRecord(SealedRecord):
    """Settings and draws of a rehearsal; ``factors`` are those on the materials and the damping of the model."""

    HINT: ClassVar[str] = "run `lrbc rehearse` with --force to write it again"

    format: Literal["lrbc-rehearsal"]
    campaign: str
    seed: int
    settings: dict[str, Any]
    factors: dict[str, float]
    jobs: dict[str, RehearsedJob]
    versions: dict[str, str]
