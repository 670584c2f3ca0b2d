"""Section of the page with the verdicts of all jobs: the strip, and a table with a row for each job."""

from __future__ import annotations

from lrbc_cli.report.content import Content
from lrbc_cli.report.drawing.svg import legend, own_size, with_rows
from lrbc_cli.report.html import Markup, beside, tag
from lrbc_cli.report.parts import tables
from lrbc_cli.report.parts.remarks import UNEXPLAINED, UNVALIDATED


def verdict_parts(content: Content) -> list[Markup | None]:
    """Return the parts of the section."""
    done = content.done
    parts: list[Markup | None] = []
    unexplained = [job.job for job in done if not job.explained]
    if unexplained:
        parts.append(tag("p", f"{tables.names_of(unexplained)}: {UNEXPLAINED}.", class_="warning"))
    unsure = [job.job for job in done if not job.validated]
    if unsure:
        parts.append(tag("p", f"{tables.names_of(unsure)}: {UNVALIDATED}.", class_="warning"))
    warned = [tag("li", f"{job.job}: {text}") for job in done for text in job.warnings]
    if warned:
        parts.append(tag("ul", *warned, class_="warning"))
    if content.strip is not None:
        hits = tables.hits(done)
        # The picture is as wide as its bolts need and is not scaled, so that its letters keep their size.
        drawing = tag(
            "div", with_rows(content.strip), class_="plot strip", style=own_size(content.strip), tabindex="0", role="group",
            aria_label="Verdicts",
        )  # fmt: skip
        bolts = [bolt for job in done for bolt in job.bolts]
        text = "One row per job, one cell per bolt: ✕ judged loose, ? inconclusive, a dot judged tight"
        text += f", {tables.NOT_COVERED} not covered by the identified terms" if any(bolt.outside for bolt in bolts) else ""
        text += f". Number in a cell: {tables.OF_LOOSE}, in per cent." if any(bolt.probability_loose is not None for bolt in bolts) else "."
        files = tag("p", beside(("", "verdicts.png"), ("", "campaign.csv")), class_="files")
        parts += [tag("p", text), legend(content.strip), drawing, files, tag("p", hits) if hits else None]
    parts.append(tables.verdict_table(content.campaign, content.jobs, content.anchors))
    return parts
