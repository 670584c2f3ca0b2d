"""Reads the measurement of a job: FRFs and coherence of its files, assigned to the responses of the campaign on the lines of the band."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from lrbc_cli.arrays import Bools, Complexes, Floats, Integers
from lrbc_cli.campaign.findings import Finding
from lrbc_cli.campaign.identification.compared.addressed import misplaced, pair_notes
from lrbc_cli.campaign.identification.compared.likeness import LEAST_DIFFERENCE, apart
from lrbc_cli.campaign.identification.matching import (
    called,
    coherences_of,
    dead_records,
    describe,
    keys_of,
    layout_of,
    matched,
    unmatched,
    with_files,
)
from lrbc_cli.campaign.reading.inputs import Inputs
from lrbc_cli.config.settings import JobConfig
from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.atomic import file_hash, unchanged
from lrbc_cli.io.frf import CoherenceKey, read_frf
from lrbc_cli.io.frf_common import HERTZ
from lrbc_cli.model.frf import FrfRecord, FrfSet
from lrbc_cli.remembered import Remembered
from lrbc_cli.updating.comparison.correlation import measured_values
from lrbc_cli.updating.knots import evenly
from lrbc_cli.updating.statistics.chain.blows import too_many_blows
from lrbc_cli.updating.statistics.decibels import DB, decibel
from lrbc_cli.updating.statistics.lines import MIN_BAND, covers

#: Share of the lines on which a coherence should have values.
MIN_COHERENCE = 0.8
#: Files that were read: every job needs the reference job and the baselines.
_files = Remembered[FrfSet](16)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """FRFs of one job on the lines of the band.

    Attributes
    ----------
    frequency_hz : (F,) float array
    values : (F, R) complex array
        NaN where a response has no record or no value.
    coherence : (F, R) float array
        NaN where unknown.
    notes : tuple of str
    warnings : tuple of Finding
        With the file, or the files of the job, as the place.
    records : tuple of str
        The record of each response that has one.
    hashes : dict
        Content hash of each file read, by path.
    sigma_db : (F, R) float array or None
        Standard deviation of the magnitude of ``values`` from repeated measurements [dB], NaN where there is one value only; None
        without repeats.
    files : int
        Number of measurements of which ``values`` is the mean.
    left_out : (int, int)
        Number of lines below and above the band.
    titles, uncalibrated : tuple of str, bool
        See ``FrfSet``, and ``FrfRecord`` (of some record, and no scale of the job converts it).
    """

    frequency_hz: Floats = field(repr=False)
    values: Complexes = field(repr=False)
    coherence: Floats = field(repr=False)
    notes: tuple[str, ...]
    warnings: tuple[Finding, ...]
    records: tuple[str, ...]
    hashes: dict[str, str]
    sigma_db: Floats | None = field(default=None, repr=False)
    files: int = 1
    left_out: tuple[int, int] = (0, 0)
    titles: tuple[str, ...] = ()
    uncalibrated: bool = False

    @property
    def lines(self) -> str:
        """Number and range of the lines, in words."""
        axis, (low, high) = self.frequency_hz, self.left_out
        outside = f" ({low} below and {high} above the band left out)" if low or high else ""
        return f"{axis.size} lines from {axis[0]:g} to {axis[-1]:g} Hz{outside}"

    @property
    def means(self) -> Floats:
        """(2 R,) sums of levels over lines, weight 1 and weight rising from 0 to 1, over the number of valid lines [dB]; 0 without any."""
        valid = measured_values(self.values)
        return _means(np.where(valid, decibel(np.where(valid, self.values, 1.0)), 0.0), valid)

    def noise_means(self, *, least: int = 10) -> Floats:
        """(2 R,) the same sums of the levels of noise that the coherence states, ``1 - g²`` [dB].

        0 where it is constant, unknown or 1 on all but ``least`` lines: coherences of few digits are alike by chance.
        """
        valid = (self.coherence > 0.0) & (self.coherence < 1.0)
        valid &= (valid.sum(axis=0) >= least) & (np.ptp(np.where(valid, self.coherence, 0.5), axis=0) > 0.0)
        return _means(np.where(valid, 0.5 * decibel(np.where(valid, 1.0 - self.coherence, 1.0)), 0.0), valid)


def _means(level: Floats, valid: Bools) -> Floats:
    """(2 R,) sums of levels (F, R) over lines, weight 1 and weight rising from 0 to 1, over the number of valid lines."""
    rising = np.linspace(0.0, 1.0, max(level.shape[0], 1))[: level.shape[0], None]
    return np.asarray(np.concatenate([level.sum(axis=0), (rising * level).sum(axis=0)]) / np.tile(np.maximum(valid.sum(axis=0), 1), 2))


def read_measurement(inputs: Inputs, job: JobConfig, name: str) -> Measurement:
    """FRFs of a job, averaged over its repeats, by response on the lines inside the band.

    Raises
    ------
    DataError
        If a file is unusable, a response that enters the cost has no record, fewer than two lines lie in the band, or a repeat has
        other lines.
    """
    first = _read(inputs, job, name)
    if not job.repeats:
        return first
    # A separate coherence file, and the variable name for it, belong to the first measurement.
    alone: dict[str, object] = {"coherence": None, "repeats": ()}
    if job.format is not None and job.coherence is not None:
        alone["format"] = job.format.model_copy(update={"coherence": None})
    further = [_read(inputs, job.model_copy(update={"frf": files, **alone}), name) for files in job.repeats]
    for files, other in zip(job.measurements[1:], further, strict=True):
        if not _same_lines(other.frequency_hz, first.frequency_hz):
            raise DataError(
                "a repeat has other frequency lines than its measurement",
                file=files[0],
                place=f"job {name}",
                expected=f"the lines of {job.first.name}: " + _lines_text(first.frequency_hz),
                found=_lines_text(other.frequency_hz),
                hint="measure repeats with the same settings, or make them jobs of their own",
            )
    found = _mean_of([first, *further])
    strange = [
        f"its repeat {files[0].name} differs from it by {away:.1f} dB (mean level of each response removed), probably "
        f"another state. Remove it from jobs.{name}.repeats, or give the file that was measured"
        for files, other in zip(job.measurements[1:], further, strict=True)
        if (away := float(np.median(apart(other.values, first.values)[inputs.used]))) > LEAST_DIFFERENCE
    ]
    return replace(found, warnings=(*found.warnings, *_of_job(job, strange)))


def _same_lines(a: Floats, b: Floats) -> bool:
    return a.shape == b.shape and np.allclose(a, b, rtol=1e-5)


def _lines_text(axis: Floats) -> str:
    return f"{axis.size} lines from {axis[0]:g} to {axis[-1]:g} Hz" if axis.size else "no line"


def unlike(axis: Floats, other: Floats) -> str:
    """How the lines of a measurement [Hz] differ from those of another, in words; empty if they are the same."""
    if axis.shape == other.shape and np.allclose(axis, other, rtol=1e-6):
        return ""
    here, there = _lines_text(axis), _lines_text(other)
    if here != there:
        return f"{here} instead of {there}"
    at = int(np.argmax(np.abs(axis - other) > 1e-6 * other))
    return f"line {at + 1} at {axis[at]:.8g} Hz instead of {other[at]:.8g} Hz"


def _mean_of(parts: list[Measurement]) -> Measurement:
    """Mean of repeated measurements of one state, and the standard deviation of its magnitude."""
    values = np.stack([part.values for part in parts])
    known = np.isfinite(values)
    count = known.sum(axis=0)
    mean = np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan + 0j)
    square = np.where(known, np.abs(np.where(known, values, 0.0) - mean) ** 2, 0.0).sum(axis=0)
    # Half of the variance of a complex deviation is along the mean, where it changes the magnitude.
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
    frf, hashes, doubts = _records_of(job, name)
    coherences = coherences_of(job, hashes)
    records, full = matched(inputs, job, name, frf), with_files(frf)
    warnings = [*_missing(inputs, records, frf), *misplaced(inputs, job, records)]
    pairs = [(r, record) for r, record in zip(inputs.responses, records, strict=True) if record is not None]
    notes = [*frf.notes, *pair_notes(inputs, job, pairs)]
    if unused := len(frf.records) - len({id(record) for _, record in pairs}):
        notes.append(f"{unused} of {len(frf.records)} records belong to no response; left out")
    _require_one_axis(records, name, inputs)
    axis, low, high = _axis([record for _, record in pairs], job, name, inputs)
    values = np.full((axis.size, len(records)), np.nan + 0j, dtype=complex)
    coherence = np.full((axis.size, len(records)), np.nan)
    thin: dict[str, list[str]] = {}
    for i, record in enumerate(records):
        if record is None:
            continue
        at, found = _indices(record.frequency_hz, axis)
        values[found, i] = record.values[at[found]] * job.factor(inputs.responses[i].name)
        own = [(record.frequency_hz, record.coherence)] if record.coherence is not None else []
        own += [coherences[key] for key in keys_of(inputs.responses[i], record, full) if key in coherences][:1]
        for lines, table in own:
            at, here = _indices(lines, axis)
            coherence[here, i] = table[at[here]]
        known = int((np.isfinite(coherence[:, i]) & found).sum())
        if own and known < MIN_COHERENCE * found.sum():
            thin.setdefault(f"{known} of {found.sum()}", []).append(inputs.responses[i].name)
    warnings += [f"the coherence of {', '.join(names)} has values on {lines} lines of the band only" for lines, names in thin.items()]
    warnings += dead_records(inputs, records, values)
    if "averages" in job.model_fields_set and not np.isfinite(coherence).any():
        warnings.append(f"averages: {job.averages} is not used, as the job has no coherence")
    if evenly(axis) and (many := too_many_blows(values, coherence, job.averages, inputs.statistics.blows, inputs.statistics.errors)):
        warnings.append(many)
    warnings += [*_gaps(axis, records, values, inputs), *_strange(coherences, inputs, records, full)]
    return Measurement(
        frequency_hz=axis,
        values=values,
        coherence=coherence,
        notes=tuple(notes),
        warnings=(*doubts, *_of_job(job, warnings)),
        records=tuple(f"{r.name}: {describe(record, len(job.measurements[0]) > 1)}" for r, record in pairs),
        hashes=hashes,
        left_out=(low, high),
        titles=frf.titles,
        uncalibrated=any(record.uncalibrated and job.factor(r.name) == 1.0 for r, record in pairs),
    )


def _strange(
    coherences: Collection[CoherenceKey],
    inputs: Inputs,
    records: list[FrfRecord | None],
    full: Mapping[int, tuple[str, ...]],
) -> list[str]:
    """Warning if none of the coherences belongs to a response."""
    taken = {key for response, record in zip(inputs.responses, records, strict=True) for key in keys_of(response, record, full)}
    if not coherences or taken & set(coherences):
        return []
    return [
        f"no coherence of the job belongs to a response ({listing(list(coherences), 4)}), so all "
        "lines have equal weight. Name its columns like the responses or their records, or give the file of this measurement"
    ]


def _records_of(job: JobConfig, name: str) -> tuple[FrfSet, dict[str, str], list[Finding]]:
    """All records of a job's files, content hashes by path, and warnings of the files.

    Raises
    ------
    DataError
        If a file is unusable, or two have the same content.
    """
    files = job.measurements[0]
    records, told, hashes = list[FrfRecord](), dict[str, list[str]](), dict[str, str]()
    named, warnings, titles = list[str](), list[Finding](), list[str]()
    for file in files:
        digest = file_hash(file)
        twin = next((other for other, known in hashes.items() if known == digest), None)
        if twin is not None:
            raise DataError(
                "two files of one job have the same content",
                file=file,
                place=f"job {name}",
                expected="each response once",
                found=f"the content of {Path(twin).name} once more",
                hint="check whether another file was meant",
            )
        hashes[file.as_posix()] = digest
        reader = partial(unchanged, file, digest, partial(read_frf, file, layout_of(job, file)))
        found = _files.of(digest.encode(), reader, (str(file), repr(layout_of(job, file))))
        only = found.records[0]
        if len(found.records) == 1 and not only.name and only.response_node is None:
            named.append(file.stem)
            found = replace(found, records=(replace(only, name=file.stem),))
        records += found.records
        titles += found.titles
        for note in found.notes:
            told.setdefault(note, []).append(file.name)
        warnings += [Finding(place=file.name, text=warning) for warning in found.warnings]
    # A note that holds for every file is given once.
    notes = [note if len(of) == len(files) else f"{', '.join(of)}: {note}" for note, of in told.items()]
    if named:
        notes.append(f"no name in the file, named after the file: {', '.join(named)}")
    every = FrfSet(
        source=str(job.first), records=tuple(records), notes=tuple(notes), warnings=tuple(map(str, warnings)), titles=tuple(titles)
    )
    return every, hashes, warnings


def _of_job(job: JobConfig, texts: Iterable[str]) -> list[Finding]:
    return [Finding(place=called(job), text=text) for text in texts]


def _missing(inputs: Inputs, records: list[FrfRecord | None], frf: FrfSet) -> list[str]:
    """Warnings about responses without a record, with unassigned records that may be theirs."""
    spare = unmatched(records, frf)
    lacking = [i for i, record in enumerate(records) if record is None]
    used = [inputs.responses[i].name for i in lacking if i in inputs.used]
    found = [f"no record of response {inputs.responses[i].name}, which is only reported" for i in lacking if i not in inputs.used]
    if used:
        found.append(
            f"no record of {', '.join(used)}: identified from the other {inputs.used.size - len(used)} responses, "
            "so this job gives no all-clear; "
            + (
                f"if it is {' or '.join(spare[:4])}, write responses.{used[0]}.record: {spare[0]}, or, for one job alone, "
                f"records: {{{used[0]}: {spare[0]}}} in that job"
                if spare
                else f"measure {', '.join(used)} again if one is wanted"
            )
        )
    return found


def _require_one_axis(records: list[FrfRecord | None], name: str, inputs: Inputs) -> None:
    """Raise a DataError that names both files if two files of a job have different lines in the band."""
    low, high = inputs.campaign.reduction.band
    eps = 1e-9 * high
    axes: dict[str, Floats] = {}
    for file in dict.fromkeys(record.file for record in records if record is not None):
        lines = np.unique(np.concatenate([r.frequency_hz for r in records if r is not None and r.file == file]))
        axes[file] = lines[(lines >= low - eps) & (lines <= high + eps)]
    for file, axis in list(axes.items())[1:]:
        first, lines = next(iter(axes.items()))
        if not _same_lines(axis, lines):
            raise DataError(
                f"two files of one job have different frequency lines, {Path(first).name} and {Path(file).name}",
                file=file,
                place=f"job {name}",
                expected=f"the lines of {Path(first).name} in the band: " + _lines_text(lines),
                found=_lines_text(axis),
                hint="measure or export them with the same resolution and range",
            )


def _why_short(axis: Floats, every: Floats, band: tuple[float, float]) -> str:
    """Likely reason why lines do not cover the band, and remedy.

    Parameters
    ----------
    axis, every : float arrays
        Lines in the band, and all lines of the files [Hz].
    band : (float, float)
    """
    low, high = band
    for unit, factor in HERTZ.items():
        if factor != 1.0 and _covers(every * factor, band):
            return f"If the frequencies are in {unit}, write format: {{frequency_unit: {unit}}} in the job"
    circular = (low / (2.0 * np.pi), high / (2.0 * np.pi))
    measured = f"[{max(low, axis[0]):g}, {min(high, axis[-1]):g}]"
    whole = "Check whether the file is complete. Otherwise measure again over the whole band, or end the band of all jobs there"
    text = f"{whole}: reduction.band: {measured}"
    # If the lines began where the stated band begins, the band would be in Hz.
    if _covers(every, circular) and every.min() ** 2 < low * circular[0]:
        text += f"; or, if the band is in rad/s, write it in Hz: reduction.band: [{circular[0]:.3g}, {circular[1]:.3g}]"
    return text


def _covers(lines: Floats, band: tuple[float, float]) -> bool:
    """Whether lines cover the band without extending to more than five times its upper end."""
    inside = lines[(lines >= band[0]) & (lines <= band[1])]
    return inside.size > 1 and float(np.ptp(inside)) > MIN_BAND * (band[1] - band[0]) and float(lines.max()) < 5.0 * band[1]


def _gaps(axis: Floats, records: list[FrfRecord | None], values: Complexes, inputs: Inputs) -> list[str]:
    """Warnings if lines, or values of a response, cover only part of the band: the file may be incomplete."""
    found = []
    low, high = inputs.campaign.reduction.band
    every = np.concatenate([record.frequency_hz for record in records if record is not None])
    if not covers(axis, (low, high)):
        found.append(
            f"the lines from {axis[0]:g} to {axis[-1]:g} Hz cover {(axis[-1] - axis[0]) / (high - low):.0%} of the band "
            f"from {low:g} to {high:g} Hz. {_why_short(axis, every, (low, high))}"
        )
    # Validation channels, too: without values they cannot validate.
    for i in range(values.shape[1]):
        finite = np.isfinite(values[:, i])
        if finite.any() and finite.mean() < inputs.statistics.validation.least_lines:
            own = axis[finite]
            found.append(
                f"response {inputs.responses[i].name} has values on {own.size} of {axis.size} lines only, "
                f"from {own[0]:g} to {own[-1]:g} Hz. Check whether the file is complete. Otherwise measure it again, or remove the response"
            )
    return found


def _axis(records: list[FrfRecord], job: JobConfig, name: str, inputs: Inputs) -> tuple[Floats, int, int]:
    """Union of the lines of all records within the band [Hz], and the numbers of lines below and above it."""
    band = inputs.campaign.reduction.band
    lines = np.unique(np.concatenate([r.frequency_hz for r in records]))
    # Lines of records written with different precision are the same lines.
    lines = lines[np.concatenate([[True], np.diff(lines) > 1e-6 * np.maximum(lines[1:], 1e-12)])]
    eps = 1e-9 * band[1]
    low, high = int((lines < band[0] - eps).sum()), int((lines > band[1] + eps).sum())
    axis = lines[(lines >= band[0] - eps) & (lines <= band[1] + eps)]
    if not axis.size:
        raise DataError(
            "no frequency line of this measurement lies in the band of the reduced model",
            file=job.first,
            place=f"job {name}",
            expected=f"lines between {band[0]:g} and {band[1]:g} Hz",
            found=f"{lines[0]:g} to {lines[-1]:g} Hz",
            hint=_why_none(lines, band),
        )
    if axis.size == 1:
        raise DataError(
            "only one frequency line of this measurement lies in the band of the reduced model",
            file=job.first,
            place=f"job {name}",
            expected=f"an FRF: many lines between {band[0]:g} and {band[1]:g} Hz",
            found=f"one line, {axis[0]:g} Hz (of {lines.size} from {lines[0]:g} to {lines[-1]:g} Hz)",
            hint="check whether the file is complete. Otherwise check the unit of the frequency column, or change reduction.band",
        )
    return axis, low, high


def _why_none(lines: Floats, band: tuple[float, float]) -> str:
    """Likely reason why no line lies in the band, and remedy."""
    for unit, factor in HERTZ.items():
        if factor != 1.0 and _covers(lines * factor, band):
            return f"if the frequencies are in {unit}, write format: {{frequency_unit: {unit}}} in the job; otherwise change reduction.band"
    if _covers(lines, (1e3 * band[0], 1e3 * band[1])):
        return f"if reduction.band is in kHz, write it in Hz: [{1e3 * band[0]:g}, {1e3 * band[1]:g}]"
    return "change reduction.band, or check the unit of the frequency column"


def _indices(lines: Floats, axis: Floats) -> tuple[Integers, Bools]:
    """Index of the nearest of ``lines`` for each line of ``axis``, and whether both are the same line."""
    at = np.clip(np.searchsorted(lines, axis), 1, max(lines.size - 1, 1)) if lines.size > 1 else np.zeros(axis.size, dtype=np.int64)
    if lines.size > 1:
        at = np.where(np.abs(lines[at - 1] - axis) <= np.abs(lines[at] - axis), at - 1, at)
    return at, np.abs(lines[at] - axis) <= 1e-5 * axis
