"""Writes the result files in the output folder; ``result.json`` of a job comes last, with the hashes of its other files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lrbc_cli.campaign.jobs.finished import Finished, calibration_tree, origin_of
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import ReductionStage
from lrbc_cli.errors import DataError
from lrbc_cli.reduction.steps.unseen import CONFIDENCE, SHARE
from lrbc_cli.results.job import FailedJob, JobRecord
from lrbc_cli.results.model import CampaignRecord, ReductionRecord
from lrbc_cli.results.store import read_job, versions, write, write_evidence, write_sealed
from lrbc_cli.results.tables import write_csv
from lrbc_cli.version import __version__


def write_result(output: Path, finished: Finished) -> JobRecord:
    """Write the tables, evidence.json and shapes.json, then result.json with their hashes.

    Returns
    -------
    JobRecord
        Content of result.json.
    """
    folder = output / finished.name
    files = {name: write_csv(folder / name, *table) for name, table in finished.tables.items()}
    files["evidence.json"] = write_evidence(folder, finished.evidence)
    if finished.shapes is not None:
        files["shapes.json"] = write(folder / "shapes.json", finished.shapes, compact=True)
    tree = finished.tree | {"provenance": finished.tree["provenance"] | {"files": files}}
    return write_sealed(folder / "result.json", JobRecord.checked(tree))


def write_failure(output: Path, inputs: Inputs, name: str, reason: str, identity: str | None) -> None:
    """Write ``result.json`` of a job that failed; an earlier result is kept as ``result.previous.json``, its tables and figures stay."""
    path = output / name / "result.json"
    try:
        before = read_job(output, name)
    except DataError:
        before = None
    if isinstance(before, JobRecord):
        path.replace(path.with_name("result.previous.json"))
    tree = {
        "job": name,
        "status": "failed",
        "reason": reason,
        "provenance": {"identity": identity, "versions": versions(), "inputs": inputs.hashes, "configuration": inputs.campaign.resolved()},
    }
    write_sealed(path, FailedJob.checked(tree))


def write_campaign(output: Path, inputs: Inputs, files: Mapping[str, str] | None = None) -> None:
    """Write ``campaign.json``: what the report needs of the campaign, and hashes of the files that ``lrbc update`` wrote beside it."""
    campaign, use = inputs.campaign, inputs.calibration
    origin = None if files is None else origin_of(inputs)
    bolts = [] if inputs.bolts is None else [{"name": n, "position": p} for n, p in zip(inputs.bolts.name, inputs.bolts.xyz, strict=True)]
    record = CampaignRecord.checked(
        {
            "campaign": campaign.name,
            "description": campaign.description,
            "test_article": campaign.test_article,
            "operator": campaign.operator,
            "compare_with": campaign.compare_with,
            "reference": campaign.update.reference,
            "reference_guessed": campaign.update.reference is not None and campaign.update.reference_guessed,
            "jobs": list(campaign.jobs),
            "bolts": bolts,
            "responses": [
                {"name": r.name, "quantity": r.quantity, "unit": r.unit, "used": bool(i in inputs.used)}
                for i, r in enumerate(inputs.responses)
            ],
            # Empty string: there is a calibration, but the jobs use the model as exported.
            "calibration": None if use is None else (use.key if use.used else ""),
            "reading": None
            if origin is None
            else {
                "origin": origin,
                "warnings": [*inputs.warnings, *inputs.method.warnings],
                "calibration": None if use is None else {"used": use.used, "stale": use.stale, "text": use.text},
                "files": files,
            },
            "tool": {"name": "lrbc", "version": __version__},
        }
    )
    write_sealed(output / "campaign.json", record)


def write_reduction(output: Path, inputs: Inputs, stage: ReductionStage) -> ReductionRecord:
    """Write ``reduction.json``: certificate, trace and costs of the reduced model."""
    r = stage.reduction
    seconds = dict(r.seconds)
    seconds["full_lines_worth"] = seconds["total"] / seconds["full_line"]
    tree = {
        "size": r.model.size,
        "size_structure": r.model.structure,
        "size_acoustic": r.model.size - r.model.structure,
        "full_size": r.full_size,
        "terms": r.model.terms,
        "inputs": int(r.model.B.shape[1]),
        "outputs": int(r.model.L.shape[0]),
        "band_hz": r.options.band_hz,
        "tolerance": r.options.tolerance,
        "reached": r.reached,
        "backend": r.backend,
        "symmetry": r.coupling,
        "expansion_points": [{"frequency_hz": t.frequency_hz, "order": t.order, "added": t.added} for t in r.trace if t.order],
        "certificate": {
            "held_out": [{"frequency_hz": line.frequency_hz, "errors": line.errors} for line in r.held_out],
            "worst": r.worst,
            "vectors": r.vectors,
            "unseen": r.unseen if np.isfinite(r.unseen) else None,
            "unseen_share": SHARE,
            "unseen_confidence": CONFIDENCE,
        },
        "trace": [
            {
                "step": i + 1,
                "size": t.size,
                "factorised_hz": t.frequency_hz if np.isfinite(t.frequency_hz) else None,
                "measured_error": t.measured_error,
                "frequency_hz": t.grid_hz if np.all(np.isfinite(t.estimate)) else [],
                "estimate": t.estimate if np.all(np.isfinite(t.estimate)) else [],
            }
            for i, t in enumerate(r.trace)
        ],
        "seconds": seconds,
        "machine": r.machine,
        "date": r.date,
        "calibration": calibration_tree(inputs),
        "cache": {"key": stage.decision.key, "hit": stage.decision.hit, "reason": stage.decision.reason},
        "versions": versions(),
    }
    record = ReductionRecord.checked(tree)
    return write_sealed(output / "reduction.json", record)
