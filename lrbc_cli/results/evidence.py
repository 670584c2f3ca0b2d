"""``NAME/evidence.json``: what an identification says of the bolts, so that it can be judged by another rule."""

from __future__ import annotations

from dataclasses import asdict
from typing import Literal, Self

from pydantic import ConfigDict

from lrbc_cli.results.fields import StoredRecord
from lrbc_cli.updating.judging.evidence import Evidence


class EvidenceRecord(StoredRecord):
    """The evidence of one job, see ``Evidence``."""

    # Lists become tuples.
    model_config = ConfigDict(strict=False)

    format: Literal["lrbc-evidence"]
    evidence: Evidence

    @classmethod
    def of(cls, evidence: Evidence) -> Self:
        """To be written.

        Raises
        ------
        NumericalError
            Where a number of it is not finite.
        """
        return cls.checked({"evidence": asdict(evidence)})
