"""What the results rest on: versions, machine, inputs by hash, resolved configuration."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from lrbc_cli.report import format as fmt
from lrbc_cli.report.html import Cell, Markup, details, table, tag
from lrbc_cli.report.reduction import Reduction
from lrbc_cli.report.results import Campaign, JobResult
from lrbc_cli.report.tables import names_of


def provenance(campaign: Campaign, jobs: Sequence[JobResult], reduction: Reduction | None) -> list[Markup | None]:
    """Return the parts of the section; what several jobs share is said once."""
    return [
        _settings(campaign, reduction),
        _versions(jobs, reduction),
        _inputs(jobs),
        *_documents("Resolved configuration", "configuration", jobs),
        *_documents("Certificate that the job rests on", "certificate", jobs),
        _optimisers(jobs),
    ]


def _settings(campaign: Campaign, reduction: Reduction | None) -> Markup:
    facts: dict[str, str] = {"Program": campaign.tool or fmt.MISSING}
    if reduction is not None:
        facts |= {f"Machine: {key}": str(value) for key, value in reduction.machine.items()}
        hit = reduction.cache.get("hit")
        facts |= {
            "Factorisation": reduction.backend or fmt.MISSING,
            "Reduced model made": reduction.date or fmt.MISSING,
            "Cache": f"{'hit' if hit else 'miss'}: {reduction.cache.get('reason') or 'no reason given'}"
            if reduction.cache
            else fmt.MISSING,
            "Cache key": str(reduction.cache.get("key") or fmt.MISSING),
        }
    return table(
        "Program and machine", ["What", "Value"], [[key, Cell(value, class_="hash")] for key, value in facts.items()], text_columns=2
    )


def _versions(jobs: Sequence[JobResult], reduction: Reduction | None) -> Markup | None:
    found: dict[tuple[str, str], list[str]] = {}
    if reduction is not None:
        for name, version in reduction.versions.items():
            found.setdefault((str(name), str(version)), []).append("reduction")
    for job in jobs:
        for name, version in _mapping(job.provenance.get("versions")).items():
            found.setdefault((str(name), str(version)), []).append(job.job)
    if not found:
        return None
    rows: list[list[str | Cell]] = [[name, version, names_of(where)] for (name, version), where in sorted(found.items())]
    return details("Versions", table("Versions", ["Package", "Version", "Where"], rows, text_columns=3))


def _inputs(jobs: Sequence[JobResult]) -> Markup | None:
    found: dict[tuple[str, str], list[str]] = {}
    for job in jobs:
        for path, digest in _mapping(job.provenance.get("inputs")).items():
            found.setdefault((str(path), str(digest)), []).append(job.job)
    if not found:
        return None
    rows: list[list[str | Cell]] = [
        [path, Cell(tag("code", digest), class_="hash"), names_of(where)] for (path, digest), where in found.items()
    ]
    return details(f"Inputs ({len(rows)} files)", table("Input files by SHA-256", ["File", "SHA-256", "Jobs"], rows, text_columns=3))


def _documents(title: str, key: str, jobs: Sequence[JobResult]) -> list[Markup]:
    found: dict[str, list[str]] = {}
    for job in jobs:
        value = job.provenance.get(key)
        if value is not None:
            found.setdefault(json.dumps(value, indent=2, ensure_ascii=False), []).append(job.job)
    label = {len(jobs): title}
    return [details(label.get(len(where), f"{title}: {names_of(where)}"), tag("pre", tag("code", text))) for text, where in found.items()]


def _optimisers(jobs: Sequence[JobResult]) -> Markup | None:
    done = [job for job in jobs if job.complete]
    if not done:
        return None
    stages = list(dict.fromkeys(stage for job in done for stage in job.seconds))
    rows: list[list[str | Cell]] = []
    for job in done:
        times = [fmt.seconds(job.seconds.get(stage)) for stage in stages]
        rows.append(
            [
                job.job,
                job.optimiser or fmt.MISSING,
                job.reason or fmt.MISSING,
                fmt.count(len(job.lines_hz)),
                fmt.count(job.iterations),
                *times,
            ]
        )
    head = ["Job", "Method", "Why it ended", "Lines", "Iterations", *(f"Seconds: {stage}" for stage in stages)]
    return details("Optimiser and seconds by stage", table("Optimiser and seconds by stage", head, rows, text_columns=3))


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}
