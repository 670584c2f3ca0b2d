"""``structure.json``: what is drawn of the structure, in metres."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from lrbc_cli.results.fields import Many, Point, Points, Record, SealedRecord, wrong
from lrbc_cli.results.model import PlaceRecord


class DrawnNodes(Record):
    """The nodes of one field that are drawn, of how many, and lines between neighbours: two numbers of nodes each, one after the other."""

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
    """Where an excitation or a response acts; ``direction`` is null of a pressure and where it is not known."""

    name: str
    position: Point
    direction: Point | None = None
    quantity: str
    used: bool = True


class DrawnTerms(Record):
    """The updated terms of one group: their places along an edge or at joints, and springs between two nodes, two places each."""

    name: str
    kind: str
    along_edge: bool
    positions: Points
    springs: Points


class StructureRecord(SealedRecord):
    """The structure as it is drawn; ``reason`` says why there is no picture, ``notes`` what was thinned."""

    format: Literal["lrbc-structure"]
    campaign: str
    reason: str | None = None
    fields: Many[DrawnNodes] = ()
    bolts: Many[PlaceRecord] = ()
    excitations: Many[DrawnPoint] = ()
    responses: Many[DrawnPoint] = ()
    terms: Many[DrawnTerms] = ()
    notes: Many[str] = ()
