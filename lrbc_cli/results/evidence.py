"""``NAME/evidence.json``: what an identification tells about the bolts, stored so that changed rules can judge it without a new fit."""

from __future__ import annotations

from typing import Literal

from pydantic import ConfigDict

from lrbc_cli.results.fields import StoredRecord
from lrbc_cli.updating.judging.evidence import Evidence


class EvidenceRecord(StoredRecord):
    """The evidence of one job, see ``Evidence``."""

    # JSON has lists where the evidence has tuples.
    model_config = ConfigDict(strict=False)

    format: Literal["lrbc-evidence"]
    evidence: Evidence
