"""Digests (SHA-256) of values, files, settings and the program, by which results that are out of date are recognised."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from lrbc_cli.config import Campaign
from lrbc_cli.config.settings import JobConfig, MeasuredFile
from lrbc_cli.config.structure import FileRecordRef
from lrbc_cli.errors import DataError
from lrbc_cli.io.atomic import file_hash
from lrbc_cli.io.frf_common import WORDS, alike
from lrbc_cli.method.rule import RULE
from lrbc_cli.results.store import versions
from lrbc_cli.version import __version__

CALIBRATION_FILE = "calibration.json"


def digest(*parts: Any) -> str:
    """SHA-256 of values: arrays, sparse matrices, and objects by their ``repr``; independent of how arrays are stored."""
    h = hashlib.sha256()
    for part in parts:
        if hasattr(part, "nnz"):
            h.update(repr(part.shape).encode())
            for array in (part.indptr.astype(np.int64), part.indices.astype(np.int64), part.data):
                h.update(np.ascontiguousarray(array).tobytes())
        elif isinstance(part, np.ndarray):
            h.update(repr((part.shape, part.dtype.str)).encode() + np.ascontiguousarray(part).tobytes())
        else:
            h.update(repr(part).encode())
        h.update(b"|")
    return h.hexdigest()


def key_of(parts: Mapping[str, str]) -> str:
    """Key (32 digits) from the digests of parts, independent of their order."""
    return digest(sorted(parts.items()))[:32]


def about_measurement(resolved: Mapping[str, Any], job: JobConfig, name: str) -> dict[str, Any]:
    """Settings of a job about its measurement, without paths: files named in ``records`` are replaced by their positions."""
    found = {key: value for key, value in resolved["jobs"][name].items() if key not in ("frf", "coherence", "repeats", "removed")}
    files = [file for files in job.measurements for file in files]
    for response, record in job.records.items():
        if isinstance(record, FileRecordRef) and record.file in files:
            found["records"] = found["records"] | {response: [files.index(record.file), record.number, record.name]}
    own = [entry.format.model_dump(mode="json", exclude_unset=True) if isinstance(entry, MeasuredFile) else {} for entry in job.entries]
    if any(own):
        found["formats"] = own
    # A record or a coherence without a name has that of its file, and names in several files end with that; others do not matter.
    stated = [value.get("record") for value in resolved["responses"].values()]
    wanted = {alike(name) for name in (*resolved["responses"], *stated, *found["records"].values()) if isinstance(name, str)}
    words = [{alike(word) for word in (file.stem, *WORDS.split(file.stem)) if word} for file in job.all_files]
    named = {at: file.stem for at, file in enumerate(job.all_files) if any(name.endswith(tuple(words[at])) for name in wanted)}
    if named:
        found["names"] = named
    return found


#: What an identification leaves for its judgement, beside what judges.
_LEFT = ("updating/judging/evidence.py", "updating/judging/reference.py")

#: Rooms and modules of the package by stage: reduced models; identifications and calibrations, which also rest on these; judgements, which
#: are no part of identifying.
STAGES = {
    "reduction": ("model", "reduction", "campaign/reduced"),
    "identification": (
        *("updating", "io", "method", "campaign/reading", "campaign/identification"),
        *("campaign/calibrate.py", "campaign/calibration.py", "campaign/jobs/evidence.py", "campaign/jobs/finished.py", "results/job.py"),
        # What a key stands for if it is left out, and what a file is multiplied by.
        *("config/structure.py", "config/settings.py"),
    ),
    "judgement": ("updating/judging", "updating/normal.py", "campaign/jobs/judging.py", "campaign/jobs/rejudge.py"),
}


@cache
def code(stage: str) -> str:
    """Digest of the modules of a stage, whose results are out of date if any of them changes."""
    return digest([(name, content) for name, content in _modules() if of_stage(stage, name)])


def of_stage(stage: str, name: str) -> bool:
    """Whether a module, by its path inside the package, belongs to a stage."""
    judges = _within("judgement", name) and name not in _LEFT
    return judges if stage == "judgement" else _within(stage, name) and not judges


def _within(stage: str, name: str) -> bool:
    return name in STAGES[stage] or name.startswith(tuple(f"{part}/" for part in STAGES[stage]))


@cache
def program() -> str:
    """Digest of all modules of this program and of the versions of its libraries."""
    return digest(versions(), _modules())


@cache
def _modules() -> list[tuple[str, str]]:
    """Name and SHA-256 of each module of the package, also of one that is installed as an archive or without sources."""

    def below(folder: Traversable, path: str) -> Iterator[tuple[str, str]]:
        for entry in folder.iterdir():
            name = f"{path}{entry.name}"
            if entry.is_dir():
                yield from below(entry, f"{name}/") if entry.name != "__pycache__" else ()
            elif name.endswith(".py"):
                # A checkout on Windows may have other line ends.
                yield name, hashlib.sha256(entry.read_bytes().replace(b"\r\n", b"\n")).hexdigest()
            elif name.endswith(".pyc"):
                # Without the time stamp in its head.
                yield name.removesuffix("c"), hashlib.sha256(entry.read_bytes()[16:]).hexdigest()

    return sorted(below(files(__name__.partition(".")[0]), "")) or [("", __version__)]


def surroundings(campaign: Campaign, calibration: bool) -> str:
    """Digest of what reading the inputs depends on besides their files: the program, the stored calibration and its measurement.

    Parameters
    ----------
    campaign : Campaign
    calibration : bool
        A stored calibration is used if it is up to date.
    """
    job = None if campaign.calibration is None else campaign.jobs[campaign.calibration.job]
    files = [campaign.output / CALIBRATION_FILE, *([] if job is None else job.all_files)]
    return digest(program(), calibration, [content_of(file) for file in files])


def origin(campaign: Campaign, read_with: str) -> str:
    """Digest of everything on which a result depends except input files: ``surroundings``, and settings except those of the rule."""
    settings, given = campaign.resolved(), campaign.model_dump(by_alias=True, exclude_unset=True)
    for key in RULE:
        settings["update"].pop(key)
        given.get("update", {}).pop(key, None)
    # The keys given count, too, because a default that is written out can cause a warning.
    return digest(read_with, settings, _keys(given))


def _keys(value: Any) -> Any:
    return {key: _keys(item) for key, item in value.items()} if isinstance(value, Mapping) else None


def content_of(path: Path) -> str | None:
    """SHA-256 of a file; None if it cannot be read (the reader reports that)."""
    try:
        return file_hash(path)
    except (DataError, OSError):
        return None
