"""Writes the result files in the output folder; ``result.json`` of a job comes last, with the hashes of its other files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lrbc_cli.campaign.jobs.finished import Finished, calibration_record, origin_of
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.campaign.reduced.stage import ReductionStage
from lrbc_cli.errors import DataError, LrbcError, from_folder, unwritten
from lrbc_cli.io.atomic import together
from lrbc_cli.reduction.outcome import Step
from lrbc_cli.reduction.steps.unseen import CONFIDENCE, SHARE
from lrbc_cli.results import model
from lrbc_cli.results.job import FailedJob, JobRecord, Provenance
from lrbc_cli.results.store import read_job, unwritable, versions, write, write_bytes, write_evidence, write_sealed
from lrbc_cli.results.tables import write_csv
from lrbc_cli.version import __version__


def write_result(output: Path, finished: Finished) -> JobRecord:
    """Write the tables, evidence.json and shapes.json, then result.json with their hashes; if one cannot be written, none is replaced.

    Returns
    -------
    JobRecord
        Content of result.json.

    Raises
    ------
    ConfigError
        If the output folder cannot be written.
    """
    folder = output / finished.record.job
    try:
        with together():
            files = {name: write_csv(folder / name, *table) for name, table in finished.tables.items()}
            files["evidence.json"] = write_evidence(folder, finished.evidence)
            if finished.shapes is not None:
                files["shapes.json"] = write(folder / "shapes.json", finished.shapes, compact=True)
            provenance = finished.record.provenance.model_copy(update={"files": files})
            return write_sealed(folder / "result.json", finished.record.model_copy(update={"provenance": provenance}))
    except OSError as error:
        raise unwritable(folder / "result.json", error) from error


def write_failure(output: Path, inputs: Inputs, name: str, error: LrbcError, identity: str | None) -> None:
    """Write ``result.json`` of a job that failed; an earlier result is kept as ``result.previous.json``, its tables and figures stay.

    If only the new result could not be written and the earlier one has the same identity, nothing speaks against that: it stays.
    Paths in the reason are those seen from the campaign file.

    Raises
    ------
    ConfigError
        If the folder of the job cannot be read or written; the earlier result then stays ``result.json``.
    """
    path = output / name / "result.json"
    try:
        before = read_job(output, name)
    except DataError:
        before = None
    if isinstance(before, JobRecord):
        not_written = unwritten(error) is not None and error.file is not None and Path(error.file).parent == path.parent
        if not_written and before.provenance.identity == identity:
            return
        # Copied, not moved: should the disk be full, `result.json` is still there.
        write_bytes(path.with_name("result.previous.json"), path.read_bytes())
    reason = from_folder(error.message, inputs.campaign.path.parent)
    provenance = Provenance(identity=identity, versions=versions(), inputs=inputs.hashes, configuration=inputs.campaign.resolved())
    failed = FailedJob(format="lrbc-result", version=1, job=name, status="failed", reason=reason, provenance=provenance)
    write_sealed(path, failed)


def write_campaign(output: Path, inputs: Inputs, files: Mapping[str, str] | None = None) -> None:
    """Write ``campaign.json``: what the report needs of the campaign, and hashes of the files that ``lrbc update`` wrote beside it."""
    campaign, use = inputs.campaign, inputs.calibration
    origin = None if files is None else origin_of(inputs)
    record = model.CampaignRecord(
        format="lrbc-campaign",
        version=1,
        campaign=campaign.name,
        description=campaign.description,
        test_article=campaign.test_article,
        operator=campaign.operator,
        compare_with=campaign.compare_with,
        reference=campaign.update.reference,
        reference_guessed=campaign.update.reference is not None and campaign.update.reference_guessed,
        jobs=tuple(campaign.jobs),
        bolts=()
        if inputs.bolts is None
        else tuple(model.PlaceRecord(name=n, position=p) for n, p in zip(inputs.bolts.name, inputs.bolts.xyz, strict=True)),
        responses=tuple(model.ResponseRecord.like(r, used=bool(i in inputs.used)) for i, r in enumerate(inputs.responses)),
        # Empty string: there is a calibration, but the jobs use the model as exported.
        calibration=None if use is None else (use.key if use.used else ""),
        reading=None
        if origin is None or files is None
        else model.ReadingRecord(
            origin=origin,
            warnings=(*inputs.warnings, *inputs.method.warnings),
            calibration=None if use is None else model.CalibrationNews.like(use),
            files=dict(files),
        ),
        tool=model.Tool(name="lrbc", version=__version__),
    )
    write_sealed(output / "campaign.json", record)


def write_reduction(output: Path, inputs: Inputs, stage: ReductionStage) -> model.ReductionRecord:
    """Write ``reduction.json``: certificate, trace and costs of the reduced model."""
    r = stage.reduction
    seconds = dict(r.seconds)
    seconds["full_lines_worth"] = seconds["total"] / seconds["full_line"]
    record = model.ReductionRecord.like(
        r,
        format="lrbc-reduction",
        version=1,
        size=r.model.size,
        size_structure=r.model.structure,
        size_acoustic=r.model.size - r.model.structure,
        terms=r.model.terms,
        inputs=r.model.B.shape[1],
        outputs=r.model.L.shape[0],
        band_hz=np.array(r.options.band_hz),
        tolerance=r.options.tolerance,
        symmetry=r.coupling,
        expansion_points=tuple(model.ExpansionPoint.like(t) for t in r.trace if t.order),
        certificate=model.ModelCertificate.like(
            r,
            held_out=tuple(model.HeldOutRecord.like(line) for line in r.held_out),
            unseen_share=SHARE,
            unseen_confidence=CONFIDENCE,
        ),
        trace=tuple(_step(i + 1, step) for i, step in enumerate(r.trace)),
        seconds=seconds,
        calibration=calibration_record(inputs),
        cache=model.Cache.like(stage.decision),
        versions=versions(),
    )
    return write_sealed(output / "reduction.json", record)


def _step(number: int, step: Step) -> model.StepRecord:
    estimated = slice(None) if np.all(np.isfinite(step.estimate)) else slice(0)
    return model.StepRecord(
        step=number,
        size=step.size,
        factorised_hz=step.frequency_hz,
        measured_error=step.measured_error,
        frequency_hz=step.grid_hz[estimated],
        estimate=step.estimate[estimated],
    )
