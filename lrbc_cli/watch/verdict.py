"""The verdict on one job as ``lrbc watch`` reports it: on the terminal, as a JSON line, and to the hook command."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from lrbc_cli.errors import ConfigError, on_one_line
from lrbc_cli.results.job import Job
from lrbc_cli.updating.judging.clearance import FINISHED, JobFinding, not_clear, open_points

#: Time limit of a hook [s].
PATIENCE = 30.0


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Verdict on one job.

    Attributes
    ----------
    job : str
    verdict : str
        ``loose``, ``tight``, ``inconclusive``, ``reference``, ``baseline``, ``unexplained``, ``failed`` or ``unusable``.
    exit_code : int
        That of ``lrbc update --job NAME --fail-on-loose``: 0 all clear, 6 loose, 7 no all-clear, 5 failed, 3 unusable.
    sentence : str
    """

    job: str
    verdict: str
    exit_code: int
    sentence: str

    def tree(self) -> dict[str, str | int]:
        """Content of the JSON line."""
        return asdict(self)


def verdict_of(record: Job, known: Mapping[str, JobFinding], tight: Collection[str] = (), *, unseen: bool = False) -> Verdict:
    """Verdict on a job with a result or a failure.

    Parameters
    ----------
    record : Job
    known : mapping
        Findings of the other jobs, which show whether it was measured twice.
    tight : collection of str
        Reference job and baselines on which it rests: as for ``lrbc update --job``, there is no all-clear beside open points of these.
    unseen : bool
        There are measurements that belong to no job, and no all-clear.
    """
    found = record.finding
    if found.status not in FINISHED:
        word, code = found.status, 5 if found.status == "failed" else 7
    elif found.named("loose") and found.assumed is None:
        word, code = "loose", 6
    else:
        own = {name: known[name] for name in tight if name in known} | {record.job: found}
        points = not_clear(own, known) | ({"": ["a measurement belongs to no job"]} if unseen else {})
        word, code = found.assumed or ("inconclusive" if points else "tight"), 7 if points else 0
        # What stands in the way elsewhere is not in the sentence on this job.
        if points and found.assumed is None and not open_points(found):
            others = "; ".join(f"{name}: {told[0]}" if name not in ("", record.job) else told[0] for name, told in points.items())
            return Verdict(job=record.job, verdict=word, exit_code=code, sentence=f"{record.sentence}; no all-clear: {others}")
    return Verdict(job=record.job, verdict=word, exit_code=code, sentence=record.sentence)


def unusable(job: str, error: Exception) -> Verdict:
    """Verdict on a job whose files cannot be read."""
    return Verdict(job=job, verdict="unusable", exit_code=3, sentence=f"{job}: no verdict; measure again or fix the file: {error}")


class Hook:
    """A command of the user that runs at each verdict, with the job, the verdict and the exit code as further arguments.

    No shell is used. The environment holds the same (``LRBC_JOB`` etc.), and the sentence, on one line, and the path of the page.

    Parameters
    ----------
    command : str
        Program and arguments, in quotes if they contain blanks.

    Raises
    ------
    ConfigError
        If the command cannot be parsed or there is no such program.
    """

    def __init__(self, command: str) -> None:
        try:
            self.words = shlex.split(command, posix=os.name != "nt")
        except ValueError as error:
            raise ConfigError(f"not a valid command ({error})", place="--hook", found=command) from None
        if os.name == "nt":
            self.words = [word.strip('"') for word in self.words]
        program = shutil.which(self.words[0]) if self.words else None
        if program is None:
            raise ConfigError("no such program", place="--hook", expected="a program that can be run", found=command)
        self.words[0] = program

    def run(self, verdict: Verdict, page: Path) -> str | None:
        """Run the command; returns why it failed, None if it did not."""
        told: Mapping[str, str] = {
            "LRBC_JOB": verdict.job,
            "LRBC_VERDICT": verdict.verdict,
            "LRBC_EXIT_CODE": str(verdict.exit_code),
            "LRBC_SENTENCE": on_one_line(verdict.sentence),
            "LRBC_REPORT": str(page),
        }
        line = [*self.words, verdict.job, verdict.verdict, str(verdict.exit_code)]
        try:
            # Its output goes to stderr: stdout carries the results of lrbc.
            done = subprocess.run(line, env={**os.environ, **told}, stdin=subprocess.DEVNULL, stdout=2, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired:
            return f"stopped after {PATIENCE:g} s"
        except (OSError, ValueError) as error:
            return str(error)
        return f"exit code {done.returncode}" if done.returncode else None
