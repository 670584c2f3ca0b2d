"""The head of the page: what was tested, one sentence on all results, and one for each job."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from datetime import datetime

import numpy as np

from lrbc_cli.report.content import Content
from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.html import Markup, details, tag
from lrbc_cli.report.old import room
from lrbc_cli.report.parts import tables
from lrbc_cli.report.parts.calibration import serves
from lrbc_cli.results.job import Job, JobRecord, Verdict
from lrbc_cli.updating.judging.clearance import loose_bolts, unclear_text

#: Text for a job of the campaign without a result.
NO_RESULT = "no result, not judged"

#: Text for a job with a result that cannot be read.
UNREADABLE = "no verdict: its result cannot be read"

#: Texts for a job whose files exist but cannot be used, without and with a result.
CANNOT_BE_USED = "no verdict: its files cannot be used"
EARLIER = "result of an earlier measurement; the present files cannot be used"

#: Text for a job whose files are gone or were replaced, or whose settings were changed, since it was identified.
REPLACED = "result of an earlier measurement or of earlier settings, see below"

#: Number of sentences shown; further ones are folded away.
_SENTENCES = 24

#: Most jobs whose loose bolts the first sentence names.
_IN_WORDS = 3


def header(content: Content, written: datetime, live: Markup | None = None) -> Markup:
    """Return the head of the page, with the paragraph of one that refreshes itself."""
    campaign = content.campaign
    about = [campaign.test_article, f"measured by {campaign.operator}" if campaign.operator else ""]
    about += [f"report of {written:%d %B %Y, %H:%M %Z}".strip(), content.tool]
    sentences = [_sentence(content, job) for job in content.jobs]
    sentences += [tag("li", f"{name}: {UNREADABLE}") for name in content.unreadable]
    sentences += [tag("li", f"{name}: {CANNOT_BE_USED if name in content.unusable else NO_RESULT}") for name in content.missing]
    first, rest = sentences[:_SENTENCES], sentences[_SENTENCES:]
    return tag(
        "header",
        room(),
        live,
        tag("p", "Bolts and boundary stiffness from measured FRFs", class_="eyebrow"),
        tag("h1", campaign.campaign),
        tag("p", campaign.description, class_="description") if campaign.description else None,
        tag("p", " · ".join(part for part in about if part), class_="meta"),
        tag("p", campaign_sentence(content), class_="lead"),
        tag("ul", *first, class_="findings"),
        details(f"{len(rest)} further jobs", tag("ul", *rest, class_="findings")) if rest else None,
        _files(content),
        tag("p", _guessed(campaign.reference), class_="warning") if campaign.reference_guessed else None,
        tag("dl", *_tiles(content), class_="tiles"),
    )


def _sentence(content: Content, job: Job) -> Markup:
    text = job.sentence.removeprefix(job.job)
    text += f" ({EARLIER})" if job.job in content.unusable else f" ({REPLACED})" if job.job in content.earlier else ""
    if problem := content.across.get(job.job):
        text += f"; {problem}"
    return tag("li", tag("a", job.job, href=f"#{content.anchors[job.job]}"), text)


def _files(content: Content) -> Markup | None:
    """List of results that cannot be read, measurements that cannot be used and files that belong to no job, with advice."""
    wrong = [*content.unreadable.items(), *content.unusable.items(), *content.earlier.items()]
    lines = [f"{name}: {problem}" for name, problem in wrong] + list(content.passed_over)
    if not lines:
        return None
    return tag(
        "div",
        tag("p", "Files that cannot be read, were not judged, were replaced or no longer exist, and results of earlier settings:"),
        tag("ul", *(tag("li", line) for line in lines)),
        class_="warning",
    )


def _guessed(reference: str | None) -> str:
    return (
        f"Reference job not confirmed: `lrbc init --from` guessed {reference} from names, and all verdicts rest on it. If all bolts were "
        "tight in this job, remove `update.reference_guessed` from the campaign file; otherwise set `update.reference` to another job. "
        "Then run `lrbc run`."
    )


def campaign_sentence(content: Content) -> str:
    """Return the finding of all jobs together; it also counts jobs without a verdict, so that none passes for an all-clear."""
    compared, judged, missing = _compared(content)
    if not compared and not missing:
        return "No job was compared with a tight state."
    loose = [job for job in judged if job.names("loose")]
    likely = sum(bool(loose_bolts(job.finding)) for job in judged) - len(loose)
    count = len(compared) + len(missing)
    of = f"{count} tested job{'' if count == 1 else 's'}"
    if not judged:
        return f"No verdict in {of}.{_first(content)}"
    text = f"Loose bolts in {len(loose)} of {of}" if loose else f"No loose bolt found in {len(judged)} of {of}"
    if likely:
        text = f"{text}, probably in {likely} more" if loose else f"Probably loose bolts in {likely} of {of}"
    text += f".{_in_words(judged)}"
    counts = {
        "without verdict": len(compared) - len(judged),
        "without result": len(missing),
        "with files that cannot be used": sum(job.job in content.unusable for job in compared),
        "with results of earlier measurements or settings": sum(job.job in content.earlier for job in content.jobs),
        "not validated": sum(not job.validated for job in judged),
        "with inconclusive bolts": sum(bool(job.names("undecided")) for job in judged),
        "with bolts that may be loose together": sum(bool(job.finding.together) for job in judged),
        "with springs that may be loose alone, unlike in the baselines": sum(bool(unclear_text(job.finding)) for job in judged),
        "without records of some responses": sum(bool(job.finding.missing) for job in content.done),
        "taken as tight although bolts are probably loose": sum(
            bool(job.finding.doubtful) or job.job in content.across.keys() - content.copies.keys() for job in content.done
        ),
        "with the measurement of another job": len(content.copies),
    }
    open_points = [f"{what}: {count}" for what, count in counts.items() if count]
    return text + (f" Jobs {', '.join(open_points)}." if open_points else "") + _first(content)


def _first(content: Content) -> str:
    """The bolts to check first in jobs without a verdict."""
    nearest = list(dict.fromkeys(name for job in content.done for name in job.finding.nearest))
    return f" Without verdict, check first: {tables.names_of(nearest, content.campaign.bolt_names)}." if nearest else ""


def _in_words(judged: Sequence[JobRecord]) -> str:
    """The bolts that are loose, or probably loose, in up to ``_IN_WORDS`` jobs, or else in the job with most of them."""
    found = {job.job: words for job in judged if (words := loose_bolts(job.finding))}
    if len(found) <= _IN_WORDS:
        return f" {'; '.join(f'{name}: {words}' for name, words in found.items())}." if found else ""
    most = max((job for job in judged if job.job in found), key=lambda job: len(job.names("loose")))
    return f" Most in {most.job}: {found[most.job]}; the other {len(found) - 1} jobs below."


def _compared(content: Content) -> tuple[list[Job], list[JobRecord], list[str]]:
    """Jobs that are compared with a tight state, those of them with verdicts, and the names of those without a result."""
    compared = [job for job in content.jobs if not isinstance(job, JobRecord) or job.taken_as_tight is None]
    judged = [job for job in compared if isinstance(job, JobRecord) and job.explained and job.observable]
    return compared, judged, [name for name in (*content.unreadable, *content.missing) if name != content.campaign.reference]


def _union(jobs: Iterable[JobRecord], verdict: Verdict = "loose") -> list[str]:
    return list(dict.fromkeys(name for job in jobs for name in job.names(verdict)))


def _tiles(content: Content) -> Iterable[Markup]:
    jobs, done = content.jobs, content.done
    compared, judged, missing = _compared(content)
    if any(job.bolts for job in done):
        count = len(compared) + len(missing)
        yield _loose(content, judged, count)
        yield _open(content, judged, count)
    if any(math.isfinite(job.misfit_db.initial) for job in done):
        yield _misfit(done)
    times = tables.account(jobs, content.reduction)
    if times is not None:
        parts = [f"{times.jobs} job{'' if times.jobs == 1 else 's'} and the reduction {fmt.seconds(times.spent)}"]
        calibration, total = content.calibration, times.spent
        if calibration is not None and serves(calibration, content.campaign):
            parts.append(f"calibration {fmt.seconds(calibration.seconds)}")
            total += calibration.seconds
        yield _tile("Computing time", fmt.seconds(total), ", ".join(parts))


def _misfit(done: Sequence[JobRecord]) -> Markup:
    """Tile with the mean misfit of the jobs with verdicts: one that the model does not explain says nothing of the others."""
    known = [job for job in done if math.isfinite(job.misfit_db.initial)]
    shown = [job for job in known if job.explained] or known
    initial, final = (float(np.mean([getattr(job.misfit_db, when) for job in shown])) for when in ("initial", "final"))
    note = "before → after updating; mean over lines, responses used and jobs"
    return _tile("Misfit of the model", f"{fmt.change(initial, final)} dB", note + (" with a verdict" if len(shown) < len(known) else ""))


def _loose(content: Content, judged: list[JobRecord], count: int) -> Markup:
    """Tile with the bolts that are loose in any job."""
    removed = [bolt for job in judged for bolt in job.observable if bolt.removed]
    loose = [job for job in judged if job.names("loose")]
    notes = [f"in {len(loose)} of {count} tested job{'' if count == 1 else 's'}"]
    if removed:
        found = sum(bolt.verdict == "loose" for bolt in removed)
        notes.append(f"{found} of {len(removed)} observable bolts known to be removed were found")
    names = tables.listed(_union(judged), content.campaign.bolt_names) or "none"
    return _tile("Loose in any job", names if judged else fmt.MISSING, ", ".join(notes))


def _open(content: Content, judged: list[JobRecord], count: int) -> Markup:
    """Tile with the inconclusive bolts, and the jobs without verdicts."""
    bolts = [bolt for job in judged for bolt in job.observable]
    unsure = sum(bolt.verdict == "undecided" for bolt in bolts)
    names = tables.listed(_union(judged, "undecided"), content.campaign.bolt_names) or "none"
    without, unvalidated = count - len(judged), sum(not job.validated for job in judged)
    notes = [f"{unsure} of {len(bolts)} verdicts"] if bolts else []
    notes += [f"{without} job{'' if without == 1 else 's'} without verdict"]
    notes += [f"{unvalidated} not validated"] if unvalidated else []
    outside = {bolt.name for job in content.done for bolt in job.bolts if bolt.outside}
    notes += [f"outside, never observable: {tables.listed(sorted(outside), content.campaign.bolt_names)}"] if outside else []
    return _tile("Inconclusive", names if bolts else fmt.MISSING, ", ".join(notes))


def _tile(title: str, value: str, note: str) -> Markup:
    return tag("div", tag("dt", title), tag("dd", value, class_="value"), tag("dd", note, class_="note"), class_="tile")
