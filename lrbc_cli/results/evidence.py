"""``NAME/evidence.json``: what an identification tells about the bolts, stored so that changed rules can judge it without a new fit."""

from __future__ import annotations

from dataclasses import asdict
from typing import Literal, Self

from pydantic import ConfigDict

from lrbc_cli.results.fields import StoredRecord
from lrbc_cli.updating.judging.evidence import Evidence


class EvidenceRecord(StoredRecord):
    """The evidence of one job, see ``Evidence``."""

    # JSON has lists where the evidence has tuples.
    model_config = ConfigDict(strict=False)

    format: Literal["lrbc-evidence"]
    evidence: Evidence

    @classmethod
    def of(cls, evidence: Evidence) -> Self:
        """Record of the evidence of one job.

        Raises
        ------
        NumericalError
            If a number in it is not finite.
        """
        return cls.checked({"evidence": asdict(evidence)})
