"""Recognises files in which an analyser appended one measurement to another."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from lrbc_cli.config import Campaign
from lrbc_cli.errors import DataError, LrbcError
from lrbc_cli.io.frf import read_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet


def require_one_measurement(campaign: Campaign, frf: FrfSet, file: str) -> None:
    """Refuse a file that contains every record the same number of times, in the same order, and more than one record.

    Parameters
    ----------
    campaign : Campaign
        Other files of its jobs may hold one of the measurements.
    frf : FrfSet
        Of all files of a job.
    file : str

    Raises
    ------
    DataError
    """
    records = [record for record in frf.records if record.file == file]
    names = [_named(record) for record in records]
    each = len(set(names))
    if each in (1, len(names)) or len(names) % each or names != names[:each] * (len(names) // each):
        return
    parts = [records[at : at + each] for at in range(0, len(records), each)]
    others = [_elsewhere(campaign, part, file) for part in parts]
    # Records of coherence count, too.
    ends = [f"to {later[0].number - 1}" for later in parts[1:]]
    spans = [f"records {part[0].number} {end}" for part, end in zip(parts, [*ends, "to the last"], strict=True)]
    found = [f"{span} with the numbers of {other}" if other else span for span, other in zip(spans, others, strict=True)]
    titles = f" (titles: {'; '.join(frf.titles)})" if len(frf.titles) == len(parts) else ""
    own = [span for span, other in zip(spans, others, strict=True) if other]
    delete = " and ".join(own) if 0 < len(own) < len(parts) else "the records of the other measurements"
    raise DataError(
        f"the file holds {len(parts)} measurements, one after the other",
        file=file,
        expected="each record once",
        found=f"{'; '.join(found)}: the same {each} FRFs each{titles}",
        hint=f"delete {delete} from the file, or export the measurement of this job alone. Repeats of one state belong in files of their "
        "own, under repeats of the job",
    )


def _named(record: FrfRecord) -> tuple[object, ...]:
    struck = record.reference_node, record.reference_direction, record.reference_name
    return record.name, record.response_node, record.response_direction, *struck


def _elsewhere(campaign: Campaign, part: Sequence[FrfRecord], own: str) -> str:
    """Name of the file of another job whose records have the numbers of these; empty if there is none."""
    for file in dict.fromkeys(file for job in campaign.jobs.values() for file in job.measurements[0] if file != Path(own)):
        with suppress(LrbcError, OSError):
            known = {_named(record): record.values for record in read_frf(file).records}
            if all(_named(record) in known and np.array_equal(known[_named(record)], record.values) for record in part):
                return file.name
    return ""
