"""What verdicts add up to: a sentence a job, and whether all jobs together are an all-clear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

#: States of a job that may have verdicts.
FINISHED = ("converged", "stopped")

#: Names at most in one list of a sentence.
MOST_NAMES = 8

NO_CHANNELS = "no validation channel shows whether the model explains the measurement"


@dataclass(frozen=True)
class BoltFinding:
    """A bolt with its verdict; the probability of being loose where it is known."""

    name: str
    verdict: str
    probability: float | None = None


@dataclass(frozen=True, kw_only=True)
class JobFinding:
    """What one job says of the bolts.

    Attributes
    ----------
    status : str
        ``converged``, ``stopped``, ``unexplained`` or ``failed``.
    bolts : sequence of BoltFinding
    validated : bool
        The model explains responses that the identification did not use.
    unvalidated : str
        Why not, where nothing speaks against it.
    assumed : str or None
        ``reference`` or ``baseline``: its bolts are tight by assumption, not by comparison.
    doubtful : sequence of str
        Bolts of the reference job, or of a baseline, that come out loose all the same.
    missing : sequence of str
        Responses that the job should have been identified from, and does not hold.
    measurement : sequence of float
        Figures of what was measured [dB], the same whatever file holds it; empty where they are not known.
    copied_db : float
        Up to which they are those of another job, see ``DecisionRule``.
    """

    status: str
    bolts: Sequence[BoltFinding] = ()
    validated: bool = True
    unvalidated: str = ""
    assumed: str | None = None
    doubtful: Sequence[str] = ()
    missing: Sequence[str] = ()
    measurement: Sequence[float] = ()
    copied_db: float = 0.0

    def named(self, verdict: str) -> list[BoltFinding]:
        """The bolts with this verdict."""
        return [bolt for bolt in self.bolts if bolt.verdict == verdict]

    @property
    def seen(self) -> list[BoltFinding]:
        """The bolts that the job can say something of."""
        return [bolt for bolt in self.bolts if bolt.verdict != "outside"]

    @property
    def inconclusive(self) -> list[BoltFinding]:
        """Those of them that are judged neither tight nor loose."""
        return [bolt for bolt in self.seen if bolt.verdict not in ("tight", "loose")]


def open_points(job: JobFinding) -> list[str]:
    """Why a job is not clear; nothing where every bolt that it can see is tight.

    The reference job and the baselines are tight by assumption, which clears them, but no other job.
    """
    if job.status not in FINISHED:
        return [_no_verdict(job)]
    points = []
    loose, inconclusive = job.named("loose"), job.inconclusive
    if loose:
        points.append(f"{_names([bolt.name for bolt in loose])} loose")
    if inconclusive:
        points.append(_inconclusive(inconclusive))
    if job.doubtful:
        points.append(f"{_names(job.doubtful)} taken as tight, but {_doubt(job)}")
    if job.assumed is None and not job.seen:
        points.append(_no_verdict(job))
    if job.missing:
        points.append(f"no record of {_names(job.missing)}")
    if not job.validated:
        points.append(_unvalidated(job))
    return points


def once_more(jobs: Mapping[str, JobFinding]) -> dict[str, str]:
    """What is wrong with jobs that hold the measurement of another; one that holds that of the reference job is not validated anyway.

    Measurements whose figures differ by no more than ``copied_db`` are one, written with other digits.
    """
    known = {name: job for name, job in jobs.items() if job.measurement and job.assumed != "reference"}
    found = {}
    for name, job in known.items():
        same = [other for other in known if other != name and _one(job, known[other])]
        if same:
            found[name] = f"the measurement of {_names(same)} once more; was another file meant?"
    return found


def _one(job: JobFinding, other: JobFinding) -> bool:
    own, figures = job.measurement, other.measurement
    return len(own) == len(figures) and all(abs(a - b) <= job.copied_db for a, b in zip(own, figures, strict=True))


def not_clear(jobs: Mapping[str, JobFinding]) -> dict[str, list[str]]:
    """What keeps jobs from being an all-clear, by job; under an empty name where none was compared with the tight state.

    Empty exactly where every bolt that can be seen is tight in every job, and at least one job was there to show it.
    """
    found = {name: points for name, job in jobs.items() if (points := open_points(job))}
    for name, problem in once_more(jobs).items():
        found.setdefault(name, []).append(problem)
    if not any(job.assumed is None for job in jobs.values()):
        found[""] = ["no job was compared with the reference job"]
    return found


def sentence(job: JobFinding) -> str:
    """What was found, in one sentence without the job's name."""
    if job.status not in FINISHED or not job.seen:
        return _no_verdict(job)
    loose, tight, inconclusive = job.named("loose"), job.named("tight"), job.inconclusive
    alarm = f"{_names([bolt.name for bolt in loose])} loose"
    likely = _likely(inconclusive) if loose and job.assumed is None else []
    if likely:
        # Beside those that are loose they stand in the alarm, and are not counted again.
        alarm += f", {_names(likely)} probably"
        inconclusive = [bolt for bolt in inconclusive if bolt.name not in likely]
    outside = len(job.bolts) - len(job.seen)
    counts = [f"{len(tight)} tight"] if tight else []
    counts += [_inconclusive(inconclusive)] if inconclusive else []
    counts += [f"{outside} outside"] if outside else []
    if job.assumed is not None:
        role = "the reference job" if job.assumed == "reference" else "a baseline"
        counts += [alarm] if loose else []
        text = f"{role}, taken as tight" + (f": {', '.join(counts)}" if counts != [f"{len(tight)} tight"] else "")
    elif loose:
        text = "; ".join([alarm, *([", ".join(counts)] if counts else [])])
    elif tight:
        text = f"no loose bolt found: {', '.join(counts)}"
    else:
        text = f"no loose bolt found, but none is judged tight: {', '.join(counts)}"
    if job.doubtful:
        text += f"; but {_names(job.doubtful)} {_doubt(job)}"
    return text if job.validated else f"{text} ({_unvalidated(job)})"


def _doubt(job: JobFinding) -> str:
    return "far looser than the other bolts there" if job.assumed == "reference" else "loose against the reference job"


def _unvalidated(job: JobFinding) -> str:
    return f"not validated: {job.unvalidated or NO_CHANNELS}"


def _no_verdict(job: JobFinding) -> str:
    if job.status == "unexplained":
        return "no verdict: the model does not explain the measurement"
    if job.status not in FINISHED:
        return f"no verdict: {job.status}"
    if job.assumed is not None and not job.bolts:
        return f"{'the reference job' if job.assumed == 'reference' else 'a baseline'}, no bolts to judge"
    return "no verdict: no bolt lies where the parameters could show it" if job.bolts else "no verdict: no bolts to judge"


def _inconclusive(bolts: Sequence[BoltFinding]) -> str:
    likely = _likely(bolts)
    return f"{len(bolts)} inconclusive" + (f" ({_names(likely)} probably loose)" if likely else "")


def _likely(bolts: Sequence[BoltFinding]) -> list[str]:
    """Those that are more likely loose than not."""
    return [bolt.name for bolt in bolts if (bolt.probability or 0.0) > 0.5]


def _names(names: Sequence[str]) -> str:
    """A list of names; ``B08 to B10`` where three or more follow one another by their number."""
    runs: list[list[str]] = []
    for name in names:
        if runs and _next(runs[-1][-1]) == name:
            runs[-1].append(name)
        else:
            runs.append([name])
    # Each with the number of bolts that it stands for.
    words = [word for run in runs for word in ([(f"{run[0]} to {run[-1]}", len(run))] if len(run) > 2 else [(name, 1) for name in run])]
    rest = sum(count for _, count in words[MOST_NAMES:])
    return ", ".join(word for word, _ in words[:MOST_NAMES]) + (f" and {rest} more" if rest else "")


def _next(name: str) -> str | None:
    """``B09`` gives ``B10``; None for a name without a number at its end."""
    stem = name.rstrip("0123456789")
    number = name[len(stem) :]
    return f"{stem}{int(number) + 1:0{len(number)}d}" if number.isascii() and number else None
