"""Matching the records of an FRF file to the responses of the campaign."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers
from lrbc_cli.campaign.reading.inputs import Inputs, Response
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.config.structure import RecordRef
from lrbc_cli.errors import DataError
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.io.frf import TextLayout, read_coherence, read_frf
from lrbc_cli.model.frf import FrfRecord, FrfSet
from lrbc_cli.updating.residuals import DB

#: Share of the band that the lines should cover.
MIN_BAND = 0.9


@dataclass(frozen=True)
class Measurement:
    """FRFs of one job on the lines of the band.

    Attributes
    ----------
    frequency_hz : (F,) float array
    values : (F, R) complex array
        NaN where a response has no record or no value.
    coherence : (F, R) float array
        NaN where unknown.
    notes, warnings : tuples of str
    records : tuple of str
        Which record each response is, where it has one.
    hashes : dict
    sigma_db : (F, R) float array or None
        Standard deviation of the magnitude of ``values`` from repeated measurements [dB], NaN where there is one value only; None
        without repeats.
    files : int
        Measurements of which ``values`` is the mean.
    left_out : (int, int)
        Lines below and above the band.
    """

    frequency_hz: Floats = field(repr=False)
    values: Complexes = field(repr=False)
    coherence: Floats = field(repr=False)
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    records: tuple[str, ...]
    hashes: dict[str, str]
    sigma_db: Floats | None = field(default=None, repr=False)
    files: int = 1
    left_out: tuple[int, int] = (0, 0)

    @property
    def lines(self) -> str:
        """Its lines in words."""
        axis, (low, high) = self.frequency_hz, self.left_out
        outside = f" ({low} below and {high} above the band left out)" if low or high else ""
        return f"{axis.size} lines from {axis[0]:g} to {axis[-1]:g} Hz{outside}"


def with_job(inputs: Inputs, name: str) -> Inputs:
    """The inputs with a job that has no file: whoever identifies it hands over its measurement."""
    job = JobConfig.model_construct(frf=Path(name))
    return replace(inputs, campaign=inputs.campaign.model_copy(update={"jobs": {**inputs.campaign.jobs, name: job}}))


def _describe(record: FrfRecord) -> str:
    parts = [record.name or "(no name)"]
    if record.response_node is not None:
        parts.append(f"node {record.response_node} direction {record.response_direction}")
    if record.reference_node is not None:
        parts.append(f"over node {record.reference_node} direction {record.reference_direction}")
    parts.append(record.quantity or "quantity unknown")
    return f"{record.place}: {', '.join(parts)}"


def _place_text(response: Response) -> str:
    if response.node is None:
        return ""
    return f", or of node {response.node}" + ("" if response.direction is None else f" direction {response.direction}")


def match_record(response: Response, wanted: str | RecordRef | None, frf: FrfSet, inputs: Inputs) -> FrfRecord | None:
    """The record of a response: by what the campaign says, else by name, else by node and direction.

    Returns
    -------
    FrfRecord or None
        None where the file has none.

    Raises
    ------
    DataError
        Where several records fit.
    """

    def one(found: list[FrfRecord], how: str) -> FrfRecord | None:
        if len(found) > 1:
            # Several hammer points: the record over this response's own input.
            node, _ = inputs.excitation_points[response.input]
            own = [r for r in found if node is not None and r.reference_node == node]
            if len(own) == 1:
                return own[0]
            raise DataError(
                f"several records fit response {response.name} ({how})",
                file=frf.source,
                found="; ".join(_describe(r) for r in found[:12]),
                hint=f"say which one in responses.{response.name}.record or in the job's records",
            )
        return found[0] if found else None

    if isinstance(wanted, RecordRef):
        return one(
            [r for r in frf.records if r.response_node == wanted.node and r.response_direction == wanted.direction],
            f"node {wanted.node} direction {wanted.direction}",
        )
    name = wanted if wanted is not None else response.name
    found = one([r for r in frf.records if r.name.strip().lower() == name.strip().lower()], f"name {name}")
    if found is not None or wanted is not None:
        return found
    if response.node is None:
        return None
    driven, _ = inputs.excitation_points[response.input]
    several = len(inputs.excitations) > 1

    def fits(record: FrfRecord) -> bool:
        if record.response_node != response.node:
            return False
        # Labels of one's own have no direction: then any motion of the node will do.
        if response.direction is None and record.response_direction == 0:
            return False
        if response.direction is not None and record.response_direction != response.direction:
            return False
        return not several or driven is None or record.reference_node in (None, driven)

    direction = "" if response.direction is None else f" direction {response.direction}"
    return one([r for r in frf.records if fits(r)], f"node {response.node}{direction}")


def read_measurement(inputs: Inputs, job: JobConfig, name: str) -> Measurement:
    """Read a job's FRFs, the mean of its repeats, and arrange them by response on the lines inside the band.

    Raises
    ------
    DataError
        Where a file is unusable, a response that enters the cost has no record, no line lies in the band, or a repeat has other lines.
    """
    first = _read(inputs, job, name)
    if not job.repeats:
        return first
    # A coherence in a file of its own belongs to the first measurement.
    further = [_read(inputs, job.model_copy(update={"frf": file, "coherence": None}), name) for file in job.repeats]
    for file, other in zip(job.repeats, further, strict=True):
        if other.frequency_hz.shape != first.frequency_hz.shape or not np.allclose(other.frequency_hz, first.frequency_hz, rtol=1e-5):
            raise DataError(
                "a repeat on other lines than its measurement",
                file=file,
                place=f"job {name}",
                expected=f"the lines of {job.frf.name}: " + _lines_text(first.frequency_hz),
                found=_lines_text(other.frequency_hz),
                hint="repeats are measured with the same settings; else make them jobs of their own",
            )
    return _mean_of([first, *further])


def _lines_text(axis: Floats) -> str:
    return f"{axis.size} lines from {axis[0]:g} to {axis[-1]:g} Hz"


def _mean_of(parts: list[Measurement]) -> Measurement:
    """Mean of repeated measurements of one state, and the standard deviation of its magnitude."""
    values = np.stack([part.values for part in parts])
    known = np.isfinite(values)
    count = known.sum(axis=0)
    mean = np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan + 0j)
    square = np.where(known, np.abs(np.where(known, values, 0.0) - mean) ** 2, 0.0).sum(axis=0)
    # Half of a complex deviation lies along the mean.
    variance = square / (2.0 * np.maximum(count - 1, 1) * np.maximum(count, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.where(count > 1, DB * np.sqrt(variance) / np.abs(mean), np.nan)
    coherence = np.stack([part.coherence for part in parts])
    told = np.isfinite(coherence)
    mean_coherence = np.where(told.any(axis=0), np.where(told, coherence, 0.0).sum(axis=0) / np.maximum(told.sum(axis=0), 1), np.nan)
    return replace(
        parts[0],
        values=mean,
        coherence=mean_coherence,
        notes=(*parts[0].notes, f"mean of {len(parts)} measurements"),
        warnings=tuple(dict.fromkeys(warning for part in parts for warning in part.warnings)),
        hashes={path: digest for part in parts for path, digest in part.hashes.items()},
        sigma_db=sigma,
        files=len(parts),
    )


def _read(inputs: Inputs, job: JobConfig, name: str) -> Measurement:
    layout = TextLayout(**job.format.model_dump()) if job.format is not None else None
    frf = read_frf(job.frf, layout)
    hashes = {job.frf.as_posix(): file_hash(job.frf)}
    coherences = {}
    if job.coherence is not None:
        coherences = read_coherence(job.coherence)
        hashes[job.coherence.as_posix()] = file_hash(job.coherence)
    records = _matched(inputs, job, name, frf)
    missing = [response.name for response, record in zip(inputs.responses, records, strict=True) if record is None]
    notes, warnings = list(frf.notes), [f"{job.frf.name}: {warning}" for warning in frf.warnings]
    warnings += [f"{job.frf.name}: no record of response {response}, which is only reported" for response in missing]
    unstated = [r.name for r, record in zip(inputs.responses, records, strict=True) if record is not None and record.quantity is None]
    if unstated:
        notes.append(f"quantities not stated in the file, taken as in the campaign: {', '.join(unstated)}")
    axis, low, high = _axis([r for r in records if r is not None], job, name, inputs)
    values = np.full((axis.size, len(records)), np.nan + 0j, dtype=complex)
    coherence = np.full((axis.size, len(records)), np.nan)
    for i, record in enumerate(records):
        if record is None:
            continue
        at, found = _indices(record.frequency_hz, axis)
        values[found, i] = record.values[at[found]] * job.scale.get(inputs.responses[i].name, 1.0)
        if record.coherence is not None:
            coherence[found, i] = record.coherence[at[found]]
        for key in (inputs.responses[i].name, record.name, (record.response_node, record.response_direction)):
            if key in coherences:
                lines, table = coherences[key]
                at, found = _indices(lines, axis)
                coherence[found, i] = table[at[found]]
                break
    for i in inputs.used:
        if not np.any(np.abs(np.nan_to_num(values[:, i])) > 0):
            raise DataError(
                f"the record of response {inputs.responses[i].name} is zero on the whole band", file=job.frf, expected="measured values"
            )
    warnings += _gaps(axis, values, job, inputs)
    mapping = (f"{r.name}: {_describe(record)}" for r, record in zip(inputs.responses, records, strict=True) if record is not None)
    return Measurement(
        frequency_hz=axis,
        values=values,
        coherence=coherence,
        notes=tuple(notes),
        warnings=tuple(warnings),
        records=tuple(mapping),
        hashes=hashes,
        left_out=(low, high),
    )


def _matched(inputs: Inputs, job: JobConfig, name: str, frf: FrfSet) -> list[FrfRecord | None]:
    """The record of each response, of its quantity; None where a response that is only reported has none."""
    records: list[FrfRecord | None] = []
    for i, response in enumerate(inputs.responses):
        wanted = job.records.get(response.name, inputs.campaign.responses[response.name].record)
        record = match_record(response, wanted, frf, inputs)
        if record is None and i in inputs.used:
            raise DataError(
                f"no record of response {response.name}",
                file=job.frf,
                place=f"job {name}",
                expected=(f"name {wanted}" if isinstance(wanted, str) else f"node {wanted.node} direction {wanted.direction}")
                if wanted is not None
                else f"a record named {response.name}" + _place_text(response),
                found="; ".join(_describe(r) for r in frf.records[:12]) + (" ..." if len(frf.records) > 12 else ""),
                hint=f"say which one in responses.{response.name}.record or in the job's records",
            )
        if record is not None and record.quantity not in (None, response.quantity):
            raise DataError(
                f"the record of response {response.name} has another quantity",
                file=job.frf,
                place=record.place,
                expected=response.quantity,
                found=record.quantity,
                hint=f"set responses.{response.name}.quantity, or correct the record",
            )
        records.append(record)
    return records


def _gaps(axis: Floats, values: Complexes, job: JobConfig, inputs: Inputs) -> list[str]:
    """Warn of a measurement that is much smaller than the band: it may have been cut off on its way here."""
    found = []
    low, high = inputs.campaign.reduction.band
    # Each line stands for its surroundings.
    step = float(np.median(np.diff(axis))) if axis.size > 1 else 0.0
    if axis[-1] - axis[0] + step < MIN_BAND * (high - low):
        found.append(
            f"{job.frf.name}: the lines from {axis[0]:g} to {axis[-1]:g} Hz cover {(axis[-1] - axis[0]) / (high - low):.0%} of the band "
            f"from {low:g} to {high:g} Hz; is the file complete?"
        )
    # Validation channels too: what they do not hold they cannot test.
    for i in range(values.shape[1]):
        finite = np.isfinite(values[:, i])
        if finite.any() and finite.mean() < inputs.statistics.validation.least_lines:
            own = axis[finite]
            found.append(
                f"{job.frf.name}: response {inputs.responses[i].name} has values on {own.size} of {axis.size} lines only, "
                f"from {own[0]:g} to {own[-1]:g} Hz; is the file complete?"
            )
    return found


def _axis(records: list[FrfRecord], job: JobConfig, name: str, inputs: Inputs) -> tuple[Floats, int, int]:
    """Lines of the band on which any record has a value, and how many were left out below and above."""
    band = inputs.campaign.reduction.band
    lines = np.unique(np.concatenate([r.frequency_hz for r in records]))
    # Two records written with other precision share their lines all the same.
    lines = lines[np.concatenate([[True], np.diff(lines) > 1e-6 * np.maximum(lines[1:], 1e-12)])]
    eps = 1e-9 * band[1]
    low, high = int((lines < band[0] - eps).sum()), int((lines > band[1] + eps).sum())
    axis = lines[(lines >= band[0] - eps) & (lines <= band[1] + eps)]
    if not axis.size:
        raise DataError(
            "no line of this measurement lies in the band of the reduced model",
            file=job.frf,
            place=f"job {name}",
            expected=f"lines between {band[0]:g} and {band[1]:g} Hz",
            found=f"{lines[0]:g} to {lines[-1]:g} Hz",
            hint="change reduction.band, or check the unit of the frequency column",
        )
    return axis, low, high


def _indices(lines: Floats, axis: Floats) -> tuple[Integers, Bools]:
    """For each line of the axis the nearest of ``lines``, and whether it is the same line."""
    at = np.clip(np.searchsorted(lines, axis), 1, max(lines.size - 1, 1)) if lines.size > 1 else np.zeros(axis.size, dtype=np.int64)
    if lines.size > 1:
        at = np.where(np.abs(lines[at - 1] - axis) <= np.abs(lines[at] - axis), at - 1, at)
    return at, np.abs(lines[at] - axis) <= 1e-5 * axis
