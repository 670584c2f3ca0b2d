"""Section of the page on what the results rest on: versions, machine, inputs by hash, resolved configuration."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from lrbc_cli.report.drawing import format as fmt
from lrbc_cli.report.html import Cell, Markup, details, table, tag
from lrbc_cli.report.parts.tables import names_of
from lrbc_cli.results.job import Job, JobRecord
from lrbc_cli.results.model import CampaignRecord, ReductionRecord


def provenance(campaign: CampaignRecord, jobs: Sequence[Job], reduction: ReductionRecord | None) -> list[Markup | None]:
    """Return the parts of the section; entries that several jobs share appear once."""
    return [
        _settings(campaign, reduction),
        _versions(jobs, reduction),
        _inputs(jobs),
        *_documents("Resolved configuration", {job.job: job.provenance.configuration for job in jobs}, len(jobs)),
        *_documents(
            "Certificate of the reduced model used",
            {job.job: job.provenance.certificate.tree() for job in jobs if job.provenance.certificate is not None},
            len(jobs),
        ),
        _optimisers(jobs),
    ]


def _settings(campaign: CampaignRecord, reduction: ReductionRecord | None) -> Markup:
    said = {"Test article": campaign.test_article, "Operator": campaign.operator, "Description": campaign.description}
    facts = {"Program": f"{campaign.tool.name} {campaign.tool.version}"} | {key: text for key, text in said.items() if text}
    if reduction is not None:
        facts |= {f"Machine: {key}": str(value) for key, value in reduction.machine.items()}
        facts |= {
            "Factorisation": reduction.backend or fmt.MISSING,
            "Reduced model built": reduction.date or fmt.MISSING,
            "Cache": f"{'hit' if reduction.cache.hit else 'miss'}: {reduction.cache.reason or 'no reason given'}",
            "Cache key": reduction.cache.key,
        }
    return table(
        "Program and machine", ["What", "Value"], [[key, Cell(value, class_="hash")] for key, value in facts.items()], text_columns=2
    )


def _versions(jobs: Sequence[Job], reduction: ReductionRecord | None) -> Markup | None:
    found: dict[tuple[str, str], list[str]] = {}
    if reduction is not None:
        for name, version in reduction.versions.items():
            found.setdefault((name, version), []).append("reduction")
    for job in jobs:
        for name, version in job.provenance.versions.items():
            found.setdefault((name, version), []).append(job.job)
    if not found:
        return None
    rows: list[list[str | Cell]] = [[name, version, names_of(where)] for (name, version), where in sorted(found.items())]
    return details("Versions", table("Versions", ["Package", "Version", "Where"], rows, text_columns=3))


def _inputs(jobs: Sequence[Job]) -> Markup | None:
    found: dict[tuple[str, str], list[str]] = {}
    for job in jobs:
        for path, digest in job.provenance.inputs.items():
            found.setdefault((path, digest), []).append(job.job)
    if not found:
        return None
    # The common folder of the files on the machine that read them is not published.
    folders = {str(PurePath(path).parent) for path, _ in found}
    common = os.path.commonpath(folders) if all(map(os.path.isabs, folders)) else ""
    rows: list[list[str | Cell]] = [
        [path.removeprefix(common).lstrip("/\\"), Cell(tag("code", digest), class_="hash"), names_of(where)]
        for (path, digest), where in found.items()
    ]
    count = f"{len(rows)} file{'' if len(rows) == 1 else 's'}"
    return details(f"Inputs ({count})", table("Input files by SHA-256", ["File", "SHA-256", "Jobs"], rows, text_columns=3))


def _documents(title: str, documents: Mapping[str, dict[str, Any]], jobs: int) -> list[Markup]:
    """Each different entry once, with the jobs that share it."""
    found: dict[str, list[str]] = {}
    for job, document in documents.items():
        if document:
            found.setdefault(json.dumps(document, indent=2, ensure_ascii=False), []).append(job)
    label = {jobs: title}
    return [
        details(label.get(len(where), f"{title}: {names_of(where)}"), tag("pre", tag("code", text), tabindex="0"), class_="document")
        for text, where in found.items()
    ]


def _optimisers(jobs: Sequence[Job]) -> Markup | None:
    done = [job for job in jobs if isinstance(job, JobRecord)]
    if not done:
        return None
    stages = list(dict.fromkeys(stage for job in done for stage in job.seconds))
    rows: list[list[str | Cell]] = []
    for job in done:
        times = [fmt.seconds(job.seconds.get(stage)) for stage in stages]
        rows.append(
            [
                job.job,
                job.optimiser.method,
                job.reason or fmt.MISSING,
                fmt.count(len(job.lines.frequency_hz)),
                fmt.count(job.iterations),
                *times,
            ]
        )
    head = ["Job", "Method", "Why it ended", "Lines", "Iterations", *(f"Seconds: {stage}" for stage in stages)]
    return details("Optimiser and seconds by stage", table("Optimiser and seconds by stage", head, rows, text_columns=3))
