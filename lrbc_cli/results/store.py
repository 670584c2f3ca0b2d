"""Reads and writes the JSON result files (atomically, with digests), and gives their JSON Schema."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import ValidationError
from pydantic.json_schema import models_json_schema

from lrbc_cli.errors import ConfigError, DataError, LrbcError, room_or
from lrbc_cli.io.atomic import atomic_write
from lrbc_cli.io.json_text import parse_json, read_json_text
from lrbc_cli.remembered import Remembered
from lrbc_cli.results.evidence import EvidenceRecord
from lrbc_cli.results.fields import SealedRecord, StoredRecord, first_wrong
from lrbc_cli.results.job import FailedJob, Job, JobRecord
from lrbc_cli.results.model import CalibrationRecord, CampaignRecord, ReductionRecord
from lrbc_cli.results.plan import PlanRecord
from lrbc_cli.results.rehearsal import RehearsalRecord
from lrbc_cli.results.shapes import ShapesRecord
from lrbc_cli.results.structure import StructureRecord
from lrbc_cli.updating.judging.evidence import Evidence
from lrbc_cli.version import __version__

R = TypeVar("R", bound=StoredRecord)
S = TypeVar("S", bound=SealedRecord)

#: Cache of the last records read; sharing them is safe, since they are frozen.
_records = Remembered[StoredRecord](256)


def versions() -> dict[str, str]:
    """Versions of the tool, of Python and of the numerical libraries that are installed."""
    out = {"lrbc": __version__, "python": platform.python_version()}
    for package in ("numpy", "scipy", "h5py", "pymetis", "mkl"):
        try:
            out[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return out


def write(path: Path, record: StoredRecord, *, compact: bool = False) -> str:
    """Write a record atomically; `compact` writes it on one line.

    Returns
    -------
    str
        SHA-256 of the bytes written.

    Raises
    ------
    ConfigError
        If the output folder cannot be written.
    """
    return write_bytes(path, _document(record.tree(), compact))


def write_sealed(path: Path, record: S) -> S:
    """Write a record with a digest of itself, which shows later changes of the file; returns the record with its digest.

    Raises
    ------
    ConfigError
        If the output folder cannot be written.
    """
    found = sealed(record)
    content = _document(found.tree(), False)
    write_bytes(path, content)
    # Reading the file again gives this record from the cache; `read_job` looks for failed jobs under JobRecord too.
    _records.of(content, lambda: found, JobRecord if isinstance(found, FailedJob) else type(found))
    return found


def sealed(record: S) -> S:
    """Copy of a record with a digest of itself."""
    return record.model_copy(update={"digest": digest_of(record.tree())})


def digest_of(tree: Mapping[str, Any]) -> str:
    """SHA-256 of the content of a record without its digest; independent of layout and order of keys."""
    content = {key: value for key, value in tree.items() if key != "digest"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _document(tree: Mapping[str, Any], compact: bool) -> bytes:
    layout: dict[str, Any] = {"separators": (",", ":")} if compact else {"indent": 1}
    return (json.dumps(tree, ensure_ascii=False, allow_nan=False, **layout) + "\n").encode()


def write_bytes(path: Path, content: bytes) -> str:
    """Write a file atomically; returns the SHA-256 of `content`, since another process may replace the file at once.

    Raises
    ------
    ConfigError
        If the output folder cannot be written.
    """
    try:
        with atomic_write(path, "wb") as file:
            file.write(content)
    except OSError as error:
        raise unwritable(path, error) from error
    return hashlib.sha256(content).hexdigest()


def unwritable(path: Path, error: OSError) -> ConfigError:
    """Error that the output folder cannot be written."""
    hint = room_or(error, "choose another folder in `output`")
    return ConfigError(f"the results cannot be written ({error.strerror or error})", file=path, hint=hint)


def read(path: Path, kind: type[R]) -> R | None:
    """Read a result file as a record; None if it is missing.

    Raises
    ------
    DataError
        If it is damaged, of another format or version, or was changed after it was written; names the key path.
    ConfigError
        If the output folder cannot be read at all.
    """
    text = _text(path, kind)
    return None if text is None else cast(R, _records.of(text.encode(), lambda: _record(path, kind, _tree(path, kind, text)), kind))


def read_job(output: Path, name: str, file: str = "result.json") -> Job | None:
    """Read the result of a job, also of a failed one; None if it is missing.

    Raises
    ------
    DataError, ConfigError
        As ``read``; also if it is the result of another job.
    """
    path = output / name / file
    text = _text(path, JobRecord)
    if text is None:
        return None

    def parsed() -> Job:
        tree = _tree(path, JobRecord, text)
        return _record(path, FailedJob, tree) if tree.get("status") == "failed" else _record(path, JobRecord, tree)

    job = cast(Job, _records.of(text.encode(), parsed, JobRecord))
    if job.job != name:
        raise DataError(f"this result belongs to job {job.job}", file=path, place="job", expected=name, found=job.job, hint=JobRecord.HINT)
    return job


def write_evidence(folder: Path, evidence: Evidence) -> str:
    """Write the evidence of a job into its folder; returns the SHA-256 of the file.

    Raises
    ------
    NumericalError
        If a number in it is not finite.
    """
    return write(folder / "evidence.json", EvidenceRecord.checked({"evidence": asdict(evidence)}))


def read_evidence(folder: Path) -> Evidence:
    """Read the evidence of a job from its folder.

    Raises
    ------
    DataError
        If it is missing, damaged or of another version.
    """
    record = read(folder / "evidence.json", EvidenceRecord)
    if record is None:
        raise DataError("this result file is missing", file=folder / "evidence.json", hint=EvidenceRecord.HINT)
    return record.evidence


def read_before(output: Path, jobs: Iterable[str]) -> list[str]:
    """SHA-256 of the input files of the first finished job; empty if there is none or it was read with another version of h5py."""
    for name in jobs:
        with suppress(LrbcError):
            job = read_job(output, name)
            if isinstance(job, JobRecord):
                same = job.provenance.versions.get("h5py") == versions()["h5py"]
                return list(job.provenance.inputs.values()) if same else []
    return []


def _record(path: Path, kind: type[R], tree: dict[str, Any]) -> R:
    try:
        record = kind.model_validate(tree)
    except ValidationError as error:
        place, expected, found = first_wrong(error)
        found = found if len(found) < 80 else found[:77] + "..."
        raise DataError("this result file is damaged", file=path, place=place, expected=expected, found=found, hint=kind.HINT) from error
    if isinstance(record, SealedRecord) and record.digest != (own := digest_of(tree)):
        problem = "this result file was changed after it was written"
        raise DataError(problem, file=path, place="digest", expected=own, found=record.digest or "no such key", hint=kind.HINT)
    return record


def _text(path: Path, kind: type[StoredRecord]) -> str | None:
    """Text of a result file; None if it is missing."""
    try:
        return read_json_text(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        problem = f"the results cannot be read ({error.strerror or error})"
        raise ConfigError(problem, file=path, hint="choose another folder in `output`") from error
    except UnicodeDecodeError as error:
        problem = "this result file is damaged: it is not UTF-8 text"
        raise DataError(problem, file=path, place=f"byte {error.start}", hint=kind.HINT) from error
    except ValueError as error:
        raise DataError(f"this result file is damaged: {error}", file=path, hint=kind.HINT) from error


def _tree(path: Path, kind: type[StoredRecord], text: str) -> dict[str, Any]:
    """Content of a result file, checked for format and version."""
    expected, hint = kind.form(), kind.HINT
    try:
        tree = parse_json(text)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno}, column {error.colno}"
        raise DataError("this result file is damaged: it is not JSON", file=path, place=place, found=error.msg, hint=hint) from error
    except ValueError as error:
        raise DataError(f"this result file is damaged: {str(error)[:100]}", file=path, hint=hint) from error
    if not isinstance(tree, dict) or tree.get("format") != expected:
        found = tree.get("format", "no such key") if isinstance(tree, dict) else "no object"
        raise DataError("this is not a result file of lrbc", file=path, place="format", expected=expected, found=found, hint=hint)
    if type(tree.get("version")) is not int or tree["version"] != 1:
        problem = "this result file is of another version"
        raise DataError(problem, file=path, place="version", expected=1, found=tree.get("version", "none"), hint=hint)
    return tree


#: Records by name of the result file; ``rehearsal.json`` lies beside the campaign of a rehearsal.
FILES: dict[str, tuple[type[StoredRecord], ...]] = {
    "campaign.json": (CampaignRecord,),
    "reduction.json": (ReductionRecord,),
    "calibration.json": (CalibrationRecord,),
    "plan.json": (PlanRecord,),
    "structure.json": (StructureRecord,),
    "shapes.json": (ShapesRecord,),
    "result.json": (JobRecord, FailedJob),
    "evidence.json": (EvidenceRecord,),
    "rehearsal.json": (RehearsalRecord,),
}


def results_schema() -> dict[str, Any]:
    """JSON Schema of the result files: each of them fits the whole schema, and ``$defs`` has an entry with the name of each."""
    kinds = [kind for several in FILES.values() for kind in several]
    refs, below = models_json_schema([(kind, "validation") for kind in kinds])
    files = {name: {"oneOf": [refs[kind, "validation"] for kind in several]} for name, several in FILES.items()}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "lrbc result files",
        "oneOf": [{"$ref": f"#/$defs/{name}"} for name in files],
        "$defs": files | below["$defs"],
    }
