"""Checks whether stored results are still valid: their files, and the tight states on which they depend; and the outcome of one call."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from lrbc_cli.campaign.jobs.judging import ComparedWith
from lrbc_cli.errors import DataError, LrbcError
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.results.fields import plain
from lrbc_cli.results.job import JobRecord, RestsOn
from lrbc_cli.results.store import versions
from lrbc_cli.updating.judging.clearance import JobFinding, across, not_clear
from lrbc_cli.updating.judging.reference import ReferenceState

#: Files beside ``result.json``, which holds their hashes; ``shapes.json`` is added if shapes can be drawn.
FILES = ("profile.csv", "frf.csv", "fdac.csv", "evidence.json")


def altered(folder: Path, stored: JobRecord) -> str | None:
    """How the files of a job differ from those written with its result, in words; None if they do not."""
    hashes = stored.provenance.files or {}
    for name in dict.fromkeys((*FILES, *hashes)):
        try:
            if not (folder / name).is_file():
                return f"a result file is missing ({name})"
            if file_hash(folder / name) != hashes.get(name):
                return f"{name} is not the file that was written with it"
        except (DataError, OSError):
            return f"{name} cannot be read"
    return None


def state_of(reference: ReferenceState) -> str:
    """Digest of the state identified in the reference job, without its input files and judgement; the same in memory and read back."""
    return _digest({key: value for key, value in asdict(reference).items() if key not in ("explained", "inputs")})


def changes_of(record: JobRecord) -> str:
    """Digest of what is compared with a baseline: its changes, which give the scatter of tight states, excluded losses, and misfit."""
    bolts = [[bolt.name, bolt.change, bolt.change_std, bolt.verdict, bolt.excluded_groups] for bolt in record.bolts]
    return _digest([bolts, record.explained, record.misfit_db.final])


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(plain(value), sort_keys=True).encode()).hexdigest()


def rests_on(tight: ComparedWith) -> RestsOn:
    """Digests of the tight states on which the verdicts of a job depend; None, or left out, for those without a result."""
    return RestsOn(
        reference=None if tight.reference is None else state_of(tight.reference),
        baselines={other: changes_of(record) for other, record in tight.baselines.items()},
    )


def other_reference(stored: RestsOn | None, now: RestsOn, reference: str | None) -> str | None:
    """Reason why an identification does not belong to the present reference state; None if it does."""
    before = None if stored is None else stored.reference
    if before == now.reference:
        return None
    if before is None:
        return f"it was identified without a result of {reference}"
    return f"it rests on a result of {reference} that is no longer there"


def other_baselines(stored: RestsOn | None, now: RestsOn) -> str | None:
    """Reason why a judgement does not belong to the present baselines; None if it does."""
    before = {} if stored is None else stored.baselines
    changed = [name for name in dict.fromkeys([*before, *now.baselines]) if before.get(name) != now.baselines.get(name)]
    return f"it rests on other results of the baselines ({', '.join(changed)})" if changed else None


def of_other_libraries(record: JobRecord) -> bool:
    """Whether a result was made with another version of Python or of a library; the code of the program itself is in its identity."""
    return {**record.provenance.versions, "lrbc": ""} != {**versions(), "lrbc": ""}


def findings_of(records: Mapping[str, JobRecord], names: Iterable[str]) -> dict[str, JobFinding]:
    """Finding of each of these jobs, in this order; one without a result counts as failed."""
    return {name: records[name].finding if name in records else JobFinding(status="failed") for name in names}


@dataclass(kw_only=True)
class Outcome:
    """Outcome of one call for all its jobs.

    Attributes
    ----------
    results : dict
        Result by job, kept ones included.
    kept, judged, failed : lists of str
        Jobs that were kept, judged anew, or failed.
    errors : dict
        Error of each failed job.
    unseen : str
        Reason why there may be measurements that this call did not find; empty if none.
    beside : list of str
        Measurement files that no job names, in words.
    others : dict
        Findings of the jobs of the campaign that are not of this call, see ``plans.other_findings``.
    """

    results: dict[str, JobRecord] = field(default_factory=dict)
    kept: list[str] = field(default_factory=list)
    judged: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    errors: dict[str, LrbcError] = field(default_factory=dict)
    unseen: str = ""
    beside: list[str] = field(default_factory=list)
    others: dict[str, JobFinding] = field(default_factory=dict)

    @property
    def across(self) -> dict[str, str]:
        """Messages on jobs that only several jobs show together."""
        return across(self.findings, self.others)

    @property
    def loose(self) -> bool:
        """Whether a bolt is judged loose in any job."""
        return any(record.names("loose") for record in self.results.values())

    @property
    def of_other_libraries(self) -> list[str]:
        """Jobs whose identification was kept, but made with another version of Python or of a library."""
        return [name for name in (*self.kept, *self.judged) if of_other_libraries(self.results[name])]

    @property
    def findings(self) -> dict[str, JobFinding]:
        """Finding of each job."""
        return findings_of(self.results, [*self.results, *self.failed])

    @property
    def not_clear(self) -> dict[str, list[str]]:
        """Reasons why these jobs give no all-clear, by job; empty if they do."""
        found = not_clear(self.findings, self.others)
        if self.unseen:
            found.setdefault("", []).append(self.unseen)
        return found

    def exit_code(self, fail_on_loose: bool) -> int:
        """Exit code, as listed by `lrbc --help`."""
        if self.failed:
            kinds = {error.exit_code for error in self.errors.values()}
            if not self.results and len(kinds) == 1:
                return kinds.pop()
            return 5
        if not fail_on_loose:
            return 0
        return 6 if self.loose else 7 if self.not_clear else 0
