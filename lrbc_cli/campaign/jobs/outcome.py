"""What happened to the jobs of one call."""

from __future__ import annotations

from dataclasses import dataclass, field

from lrbc_cli.campaign.jobs.standing import findings_of
from lrbc_cli.errors import LrbcError
from lrbc_cli.results.job import JobRecord
from lrbc_cli.updating.clearance import JobFinding, not_clear


@dataclass(kw_only=True)
class Outcome:
    """What happened to the jobs of one call.

    Attributes
    ----------
    results : dict
        Result by job, kept ones included.
    kept, judged, failed : lists of str
        Kept as they were, judged anew, failed.
    errors : dict
        The error of each failed job.
    unseen : str
        Why there may be measurements that this call knows nothing of.
    beside : list of str
        Files beside those of the jobs that no job names, in words.
    """

    results: dict[str, JobRecord] = field(default_factory=dict)
    kept: list[str] = field(default_factory=list)
    judged: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    errors: dict[str, LrbcError] = field(default_factory=dict)
    unseen: str = ""
    beside: list[str] = field(default_factory=list)

    @property
    def loose(self) -> bool:
        """Whether a bolt is judged loose in any job."""
        return any(record.names("loose") for record in self.results.values())

    @property
    def findings(self) -> dict[str, JobFinding]:
        """What each job says of the bolts."""
        return findings_of(self.results, [*self.results, *self.failed])

    @property
    def not_clear(self) -> dict[str, list[str]]:
        """What keeps these jobs from being an all-clear, by job; empty where they are one."""
        found = not_clear(self.findings)
        if self.unseen:
            found.setdefault("", []).append(self.unseen)
        return found

    def exit_code(self, fail_on_loose: bool) -> int:
        """The exit code of ``interface.md``."""
        if self.failed:
            kinds = {error.exit_code for error in self.errors.values()}
            if not self.results and len(kinds) == 1:
                return kinds.pop()
            return 5
        if not fail_on_loose:
            return 0
        return 6 if self.loose else 7 if self.not_clear else 0
