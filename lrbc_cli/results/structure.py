"""``structure.json``: the picture of the structure (nodes, bolts, excitations, responses, terms), in metres."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from lrbc_cli.results.fields import Many, Point, Points, Record, SealedRecord, wrong
from lrbc_cli.results.model import PlaceRecord


class DrawnNodes(Record):
    """The drawn nodes of one field, out of ``count``, and lines between neighbours as a flat list of pairs of node numbers (from 0)."""

    field: Literal["structure", "acoustic"]
    count: int
    xyz: Points
    lines: Many[int] = ()

    @model_validator(mode="after")
    def _within(self) -> Self:
        if len(self.lines) % 2 or any(not 0 <= node < len(self.xyz) for node in self.lines):
            raise wrong(".lines", f"pairs of numbers from 0 to {len(self.xyz) - 1}", "others")
        return self


class DrawnPoint(Record):
    """Position and direction of an excitation or response; ``direction`` is null for a pressure or if unknown."""

    name: str
    position: Point
    direction: Point | None = None
    quantity: str
    used: bool = True


class DrawnTerms(Record):
    """The updated terms of one group: their positions along an edge or at joints, and both ends of each spring between two nodes."""

    name: str
    kind: str
    along_edge: bool
    positions: Points
    springs: Points


class StructureRecord(SealedRecord):
    """The structure as it is drawn; ``reason`` states why there is no picture, ``notes`` which parts were thinned out."""

    format: Literal["lrbc-structure"]
    campaign: str
    reason: str | None = None
    fields: Many[DrawnNodes] = ()
    bolts: Many[PlaceRecord] = ()
    excitations: Many[DrawnPoint] = ()
    responses: Many[DrawnPoint] = ()
    terms: Many[DrawnTerms] = ()
    notes: Many[str] = ()
