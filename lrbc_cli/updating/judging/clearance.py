"""The outcome of verdicts: one sentence for each job, and whether all jobs together are an all-clear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from statistics import median
from types import MappingProxyType
from typing import Any

from lrbc_cli.updating.judging.rule import probably

#: States of a job that may have verdicts.
FINISHED = ("converged", "stopped")

#: Largest number of entries in a list of names.
MOST_NAMES = 8

NO_CHANNELS = "no validation channel shows whether the model explains the measurement"


@dataclass(frozen=True, kw_only=True)
class BoltFinding:
    """A bolt with its verdict, and probability of being loose, change, its std, threshold and groups of springs as in ``BoltVerdict``."""

    name: str
    verdict: str
    probability: float | None = None
    change: float | None = None
    change_std: float | None = None
    threshold: float | None = None
    open_groups: Sequence[str] = ()
    unclear_groups: Sequence[str] = ()
    lost_groups: Sequence[str] = ()

    @classmethod
    def of(cls, bolt: Any) -> BoltFinding:
        """That of a ``BoltVerdict``, or of the record of one."""
        return cls(
            name=bolt.name,
            verdict=bolt.verdict,
            probability=bolt.probability_loose,
            change=bolt.change,
            change_std=bolt.change_std,
            threshold=bolt.threshold,
            open_groups=bolt.open_groups,
            unclear_groups=bolt.unclear_groups,
            lost_groups=bolt.lost_groups,
        )


@dataclass(frozen=True, kw_only=True)
class JobFinding:
    """Result of one job.

    Attributes
    ----------
    status : str
        ``converged``, ``stopped``, ``unexplained`` or ``failed``.
    bolts : sequence of BoltFinding
    validated : bool
        Whether the job is validated, see ``decide.Validity``.
    unvalidated : str
        Why it is not validated.
    nearest : sequence of str
        Bolts of an unexplained job that are loose, else those that probably are, in the state that fits best, see ``decide.Validity``.
    assumed : str or None
        ``reference`` or ``baseline`` if its bolts are taken as tight by assumption, else None.
    doubtful : sequence of str
        Bolts of the reference job, or of a baseline, that appear loose nevertheless.
    missing : sequence of str
        Responses to be used that the files of the job do not contain.
    measurement : sequence of float
        Figures of the measured levels, independent of the file [dB]; empty if not known.
    coherence : sequence of float
        The same of the noise that the coherence states [dB]; zeros where it is constant or unknown.
    identity, against : str
        Digests of what its identification rests on, and of that of the reference job with which it is compared; empty if not known.
    content, copied_content : str
        Digests of its measurement, and of that of another job of which it is a copy in part, scaled or thinned out; empty if not known.
    copied_db : float
        Largest difference of these figures for the same measurement, see ``DecisionRule`` [dB].
    confidence : float
        Posterior probability that a verdict needs, and that of no loose bolt at all which an all-clear needs.
    """

    status: str
    bolts: Sequence[BoltFinding] = ()
    validated: bool = True
    unvalidated: str = ""
    nearest: Sequence[str] = ()
    assumed: str | None = None
    doubtful: Sequence[str] = ()
    missing: Sequence[str] = ()
    measurement: Sequence[float] = ()
    coherence: Sequence[float] = ()
    identity: str = ""
    against: str = ""
    content: str = ""
    copied_content: str = ""
    copied_db: float = 0.0
    confidence: float = 0.95

    def named(self, verdict: str) -> list[BoltFinding]:
        """The bolts with this verdict."""
        return [bolt for bolt in self.bolts if bolt.verdict == verdict]

    @property
    def seen(self) -> list[BoltFinding]:
        """The bolts that the job can judge: all that are not ``outside``."""
        return [bolt for bolt in self.bolts if bolt.verdict != "outside"]

    @property
    def inconclusive(self) -> list[BoltFinding]:
        """The bolts of ``seen`` that are judged neither tight nor loose."""
        return [bolt for bolt in self.seen if bolt.verdict not in ("tight", "loose")]

    @property
    def together(self) -> str:
        """That one of the bolts may be loose although each by itself is judged tight; empty if that leaves the all-clear its confidence.

        The sum of their probabilities is the largest probability that any of them is loose, however they depend on each other (Boole).
        """
        tight = self.named("tight")
        most = sum(bolt.probability or 0.0 for bolt in tight)
        alone = self.assumed is None and len(tight) == len(self.seen)
        return f"one of them may be loose, with a probability of up to {min(most, 1.0):.2g}" if alone and most > 1 - self.confidence else ""


def open_points(job: JobFinding) -> list[str]:
    """Reasons why a job is no all-clear; empty if all bolts that it can judge are tight, also together, and it is validated and complete.

    The reference job and baselines are tight by assumption, which says nothing about other jobs.
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
    if job.together:
        points.append(f"{len(job.seen)} tight, but {job.together}")
    if unclear := unclear_text(job):
        points.append(unclear)
    if job.missing:
        points.append(f"no record of {_names(job.missing)}")
    if not job.validated:
        points.append(_unvalidated(job))
    return points


def once_more(jobs: Mapping[str, JobFinding], others: Mapping[str, JobFinding] = MappingProxyType({})) -> dict[str, str]:
    """Messages on jobs with the measurement or the coherence of another job or of one of ``others``.

    Measurements whose figures all differ by no more than ``copied_db`` are the same, even if written with other digits. A copy of the
    reference job is not validated anyway.
    """
    every = {**others, **jobs}
    known = {name: job for name, job in every.items() if job.measurement and job.assumed != "reference"}
    found = {}
    for name, job in ((name, job) for name, job in known.items() if name in jobs):
        same = [other for other in known if other != name and _alike(job.measurement, known[other].measurement, job.copied_db)]
        same += [other for other, each in every.items() if other not in (name, *same) and each.copied_content == job.content != ""]
        if same:
            found[name] = f"the same measurement as {_names(same)}: check whether another file was meant"
        elif any(job.coherence) and (
            same := [other for other in every if other != name and _alike(job.coherence, every[other].coherence, job.copied_db)]
        ):
            found[name] = (
                f"the coherence is that of {_names(same)}, so one of them is of another measurement: check which files were meant, or "
                "leave the coherence out"
            )
    return found


def loose_there(
    jobs: Mapping[str, JobFinding], others: Mapping[str, JobFinding] = MappingProxyType({}), *, least: int = 3
) -> dict[str, str]:
    """Message on a reference job in which bolts were probably loose, by its name; empty if there are none.

    A loss that all comparisons share is seen in none of them, and a calibration takes it up, but the other jobs show the bolt stiffer. What
    counts as a loss, the threshold, counts in the other direction, too: in the median of ``least`` or more jobs compared with this
    reference job, of changes known to less than the threshold. A job in which the bolt is loose, or probably, does not show it stiffer. On
    59 right campaigns this median was 0.17 decades or more below the threshold.
    """
    every = {**others, **jobs}
    there = next((name for name, job in every.items() if job.assumed == "reference"), None)
    if there is None:
        return {}
    found = dict[str, dict[str, tuple[float, float]]]()
    for name, job in every.items():
        if job.status not in FINISHED or job.assumed == "reference" or job.against != every[there].identity:
            continue
        for bolt in job.bolts:
            if bolt.change is None or bolt.change_std is None or bolt.threshold is None or bolt.change_std >= -bolt.threshold:
                continue
            loose = bolt.verdict == "loose" or probably(bolt.probability)
            # The same measurement counts once.
            found.setdefault(bolt.name, {})[job.content or name] = bolt.change, -inf if loose else bolt.change + bolt.threshold
    far = {name: told.values() for name, told in found.items() if len(told) >= least and median(by for _, by in told.values()) > 0.0}
    if not far:
        return {}
    bolts = ", ".join(f"{name} ({median(change for change, _ in told):+.2f} decades)" for name, told in far.items())
    return {
        there: f"probably not all tight: half of the other jobs, or more, show bolts stiffer than here, by as much as counts as a loss: "
        f"{bolts}. Bolts that are as loose in other jobs come out tight against this one. Tighten them and measure this job again, or set "
        "update.reference to another job"
    }


def across(jobs: Mapping[str, JobFinding], others: Mapping[str, JobFinding] = MappingProxyType({})) -> dict[str, str]:
    """Messages on jobs that only several jobs show together: ``once_more`` and ``loose_there``."""
    return {**once_more(jobs, others), **loose_there(jobs, others)}


def _alike(own: Sequence[float], other: Sequence[float], most: float) -> bool:
    return len(own) == len(other) and all(abs(a - b) <= most for a, b in zip(own, other, strict=True))


def not_clear(jobs: Mapping[str, JobFinding], others: Mapping[str, JobFinding] = MappingProxyType({})) -> dict[str, list[str]]:
    """Reasons why the jobs are no all-clear, by job; under an empty name if no job was compared with the reference job.

    Empty exactly if every bolt that can be judged is tight in every job, all jobs are validated, none has the measurement of another one
    (of ``others`` neither), the reference job seems tight beside all of them, and one was compared.
    """
    found = {name: points for name, job in jobs.items() if (points := open_points(job))}
    for name, problem in once_more(jobs, others).items():
        # A copy that was found when the job was judged is why it is not validated.
        if name not in found or not jobs[name].copied_content:
            found.setdefault(name, []).append(problem)
    for name, problem in loose_there(jobs, others).items():
        found.setdefault(name, []).append(problem)
    if not any(job.assumed is None for job in jobs.values()):
        found[""] = ["no job was compared with the reference job"]
    return found


def sentence(job: JobFinding) -> str:
    """The result of a job in one sentence, without the job's name."""
    if job.status not in FINISHED or not job.seen:
        return _no_verdict(job)
    loose, tight, inconclusive = job.named("loose"), job.named("tight"), job.inconclusive
    likely = _likely(inconclusive) if job.assumed is None else []
    alarm = f"{_names([bolt.name for bolt in loose])} loose" if loose else ""
    if likely:
        # They come first, too, and are not counted again.
        alarm = f"{alarm}, {_names(likely)} probably" if loose else f"{_names(likely)} probably loose"
        inconclusive = [bolt for bolt in inconclusive if bolt.name not in likely]
    outside = len(job.bolts) - len(job.seen)
    counts = [f"{len(tight)} tight{_as_a_whole(tight) if job.assumed is None else ''}"] if tight else []
    counts += [_inconclusive(inconclusive)] if inconclusive else []
    counts += [f"{outside} outside"] if outside else []
    if job.assumed is not None:
        role = "the reference job" if job.assumed == "reference" else "a baseline"
        counts += [alarm] if loose else []
        text = f"{role}, taken as tight" + (f": {', '.join(counts)}" if counts != [f"{len(tight)} tight"] else "")
    elif alarm:
        text = "; ".join([alarm, *([", ".join(counts)] if counts else [])])
    elif tight:
        text = f"no loose bolt found: {', '.join(counts)}" + (f"; {job.together}" if job.together else "")
    else:
        text = f"no loose bolt found, but none is judged tight: {', '.join(counts)}"
    if job.doubtful:
        text += f"; but {_names(job.doubtful)} {_doubt(job)}"
    if unclear := unclear_text(job):
        text += f"; {unclear}"
    if job.missing:
        text += f"; no record of {_names(job.missing)}"
    return text if job.validated else f"{text} ({_unvalidated(job)})"


def unclear_text(job: JobFinding) -> str:
    """Clause on springs of tight bolts whose loss alone the data exclude in the baselines, but not in this job; empty if there are none."""
    unclear = [bolt for bolt in job.named("tight") if bolt.unclear_groups] if job.assumed is None else []
    if not unclear:
        return ""
    springs = _names(list(dict.fromkeys(group for bolt in unclear for group in bolt.unclear_groups)), " or ")
    return f"unlike in the baselines, springs of {springs} of {_names([bolt.name for bolt in unclear])} alone may be loose"


def open_groups(job: JobFinding) -> list[str]:
    """Groups of springs that a tight bolt of a job may have lost alone; none of a job that is taken as tight."""
    bolts = job.named("tight") if job.assumed is None else []
    return list(dict.fromkeys(group for bolt in bolts for group in bolt.open_groups))


def _as_a_whole(tight: Sequence[BoltFinding]) -> str:
    """Which of the tight bolts may have lost a group of springs alone, and which groups; empty if none."""
    partly = [bolt for bolt in tight if bolt.open_groups]
    groups = dict.fromkeys(group for bolt in partly for group in bolt.open_groups)
    few = f"{_names([bolt.name for bolt in partly])} " if len(partly) < len(tight) else ""
    return f" ({few}as a whole: springs of {_names(list(groups), ' or ')} alone may be loose)" if partly else ""


def loose_bolts(job: JobFinding) -> str:
    """Names of the loose bolts and of those that probably are: ``B4, probably B3``; empty without either."""
    loose, likely = _names([bolt.name for bolt in job.named("loose")]), _names(_likely(job.inconclusive))
    return ", ".join(part for part in (loose, likely and f"probably {likely}") if part)


def _doubt(job: JobFinding) -> str:
    return "far looser than the other bolts there" if job.assumed == "reference" else "probably loose against the reference job"


def _unvalidated(job: JobFinding) -> str:
    return f"not validated: {job.unvalidated or NO_CHANNELS}"


def _no_verdict(job: JobFinding) -> str:
    if job.status == "unexplained":
        first = f"; check {_names(job.nearest)} first (the nearest state has a loss there)" if job.nearest else ""
        return f"no verdict: the model does not explain the measurement{first}"
    if job.status not in FINISHED:
        return f"no verdict: {job.status}"
    if job.assumed is not None and not job.bolts:
        return f"{'the reference job' if job.assumed == 'reference' else 'a baseline'}, no bolts to judge"
    return "no verdict: no bolt is within reach of the parameters" if job.bolts else "no verdict: no bolts to judge"


def _inconclusive(bolts: Sequence[BoltFinding]) -> str:
    likely, partly = _likely(bolts), [bolt.name for bolt in bolts if bolt.lost_groups]
    told = [f"{what}{_names(names)} probably loose" for what, names in (("", likely), ("some springs of ", partly)) if names]
    return f"{len(bolts)} inconclusive" + (f" ({'; '.join(told)})" if told else "")


def _likely(bolts: Sequence[BoltFinding]) -> list[str]:
    """Names of the bolts that are probably loose."""
    return [bolt.name for bolt in bolts if probably(bolt.probability)]


def ranges(names: Sequence[str], to: str = " to ") -> list[tuple[str, int]]:
    """Names for a list, each with the number that it stands for: three or more consecutive numbers are joined as ``B08 to B10``."""
    runs: list[list[str]] = []
    for name in names:
        if runs and _next(runs[-1][-1]) == name:
            runs[-1].append(name)
        else:
            runs.append([name])
    return [word for run in runs for word in ([(f"{run[0]}{to}{run[-1]}", len(run))] if len(run) > 2 else [(name, 1) for name in run])]


def _names(names: Sequence[str], between: str = ", ") -> str:
    words = ranges(names)
    rest = sum(count for _, count in words[MOST_NAMES:])
    return between.join(word for word, _ in words[:MOST_NAMES]) + (f" and {rest} more" if rest else "")


def _next(name: str) -> str | None:
    """``B09`` gives ``B10``; None for a name without a number at its end."""
    stem = name.rstrip("0123456789")
    number = name[len(stem) :]
    return f"{stem}{int(number) + 1:0{len(number)}d}" if number.isascii() and number else None
