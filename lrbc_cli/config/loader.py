"""Loads and checks a campaign file, with overrides of the command line and the jobs of a watched folder."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from lrbc_cli.config.campaign import Campaign
from lrbc_cli.config.checks import check_references
from lrbc_cli.config.document import MAX_DEPTH, Document, Node, parse, read_document
from lrbc_cli.config.explain import explain, refuse_gone, refuse_unfilled, without_unfilled
from lrbc_cli.config.fields import FrozenDict, job_name, plain_name, shown, unspeakable
from lrbc_cli.config.settings import JobConfig, MeasuredFile
from lrbc_cli.errors import ConfigError

#: Keys of a job that describe its own measurement: a job made from a file in the watched folder does not inherit them.
OWN = {"frf", "coherence", "repeats", "removed"}

DEFAULT_OUTPUT = "output"


def load_campaign(path: Path, overrides: Sequence[str] = ()) -> Campaign:
    """Load a campaign file.

    Parameters
    ----------
    path
        The file.
    overrides
        Texts ``key.path=value`` with the value in YAML; they act as if written in the file.

    Returns
    -------
    Campaign
        Frozen, with absolute paths; its jobs are those of the file and of the watched folder.

    Raises
    ------
    ConfigError
        If it is not a valid campaign; with file, line and key path.
    """
    if unspeakable(path.absolute()):
        raise ConfigError(
            "a name in the path of the campaign file is not UTF-8",
            file=Path(shown(path)),
            expected="names of folders and files that can be written into results",
            hint="rename it; in a terminal without UTF-8, set PYTHONUTF8=1 (or LC_ALL=C.UTF-8)",
        )
    return _build(_document(path, overrides))


def load_unfilled(path: Path, overrides: Sequence[str] = ()) -> tuple[Campaign, list[ConfigError]]:
    """As ``load_campaign``, but coordinates that are not filled in are replaced by zeros, with an error for each of them.

    The campaign is then only good for finding further errors.
    """
    document = _document(path, overrides)
    values, errors = without_unfilled(document)
    for keys, value in values.items():
        below, _ = document.node(keys)
        node = parse(str(value), file=document.file, origin=below.origin)
        assert node is not None
        document = Document(document.file, _replace(document, document.root, list(keys), 0, node, below.origin))
    return _build(document), errors


def _document(path: Path, overrides: Sequence[str]) -> Document:
    document = read_document(Path(path))
    for override in overrides:
        document = Document(document.file, _override(document, override))
    return document


def _build(document: Document) -> Campaign:
    refuse_gone(document)
    refuse_unfilled(document)
    values: dict[str, Any] = document.root.plain()  # type: ignore[assignment]
    values.setdefault("output", DEFAULT_OUTPUT)
    try:
        campaign = Campaign.model_validate(values, context={"folder": document.file.parent})
    except ValidationError as error:
        raise explain(error, document, Campaign) from None
    campaign._document = document
    campaign = with_folder(campaign)
    check_references(campaign)
    return campaign


def _override(document: Document, text: str) -> Node:
    if any(0xD800 <= ord(char) <= 0xDFFF for char in text):
        raise ConfigError(
            "the override contains characters outside the character set of the terminal",
            place=f"--override {text[:60]!a}",
            expected="a terminal with UTF-8",
            hint="set PYTHONUTF8=1 (or LC_ALL=C.UTF-8), or write the value into the campaign file",
        )
    path, equals, value = text.partition("=")
    keys = _split_path(path)
    if not equals or not keys:
        raise ConfigError(
            "this is not an override",
            place=f"--override {text[:60]}",
            expected="key.path=value, for instance update.method=bfgs",
            found=f"'{text[:60]}'",
        )
    node = parse(value, file=document.file, origin=path)
    return _replace(document, document.root, keys, 0, node or Node(None, 0, path), path)


def _split_path(path: str) -> list[str]:
    """Keys of a path such as ``a.b[0].c``; empty if it is not a key path."""
    parts = re.sub(r"\[(\d{1,9})\]", r".\1", path.strip()).split(".")
    return parts if all(parts) and len(parts) <= MAX_DEPTH else []


def _replace(document: Document, node: Node, keys: list[str], depth: int, value: Node, path: str) -> Node:
    """Copy of the tree with `value` at the key path; names that contain dots are found by the longest match."""
    rest = keys[depth:]
    if not rest:
        return Node(value.value, node.line, path)
    where = ".".join(keys[:depth])
    if isinstance(node.value, tuple):
        if not rest[0].isdecimal() or int(rest[0]) >= len(node.value):
            raise ConfigError(
                f"'{where}' is a list without an entry '{rest[0]}'",
                file=document.file,
                place=f"--override {path}",
                expected=f"an index from 0 to {len(node.value) - 1}" if node.value else "an entry of a list that is not empty",
            )
        index = int(rest[0])
        items = list(node.value)
        items[index] = _replace(document, items[index], keys, depth + 1, value, path)
        return Node(tuple(items), node.line, node.origin)
    if node.value is not None and not isinstance(node.value, Mapping):
        raise ConfigError(
            f"'{where}' is a value and has no keys",
            file=document.file,
            place=f"--override {path}",
            hint=f"replace it as a whole: --override '{where}={{{rest[0]}: ...}}'",
        )
    entries = dict(node.value or {})
    used = next((count for count in range(len(rest), 0, -1) if ".".join(rest[:count]) in entries), 1)
    key = ".".join(rest[:used])
    entries[key] = _replace(document, entries.get(key) or Node(None, node.line, path), keys, depth + used, value, path)
    origin = path if node.value is None else node.origin
    return Node(entries, node.line, origin)


def with_folder(campaign: Campaign) -> Campaign:
    """Add a job for each file of the watched folder that no job names, and for each tight state that is not measured yet.

    A file with the name of a job whose own files are missing becomes the file of that job. Every matching file gets a job, so that no
    measurement stays without a verdict.
    """
    watch, jobs = campaign.watch, dict(campaign.jobs)
    if watch is None:
        return campaign
    update, calibration = campaign.update, campaign.calibration
    like = jobs.get(watch.like or update.reference or "")

    def job(path: Path, settings: JobConfig | None, without: set[str]) -> JobConfig:
        given = {} if settings is None else settings.model_dump(by_alias=True, exclude_unset=True, exclude=without)
        if settings is not None and isinstance(settings.frf, MeasuredFile) and (own := settings.format_of(settings.frf.file)) is not None:
            given["format"] = own.model_dump(exclude_unset=True)
        return JobConfig.model_validate(_texts(given | {"frf": path}), context={"folder": campaign.path.parent})

    named = {os.path.realpath(path) for config in jobs.values() for path in config.all_files}
    taken = {name.lower(): name for name in jobs}
    for path in watch.files():
        if os.path.realpath(path) in named:
            continue
        known = taken.get(path.stem.lower())
        if known is not None and any(file.exists() for file in jobs[known].all_files):
            known = None
        with suppress(ValidationError):  # the file has just been removed
            stem = plain_name(path.stem) or "job"
            name = known or job_name([stem, f"{stem}-{path.suffix.lstrip('.')}"], taken, path.name)
            jobs[name] = job(path, jobs.get(name, like), {"frf"} if known else OWN)
            taken[name.lower()] = name
    suffix = Path(watch.patterns[0]).suffix
    for tight in (update.reference, *update.baselines, None if calibration is None else calibration.job):
        if tight is not None and tight.lower() not in taken and "*" not in suffix:
            jobs[tight] = job(watch.folder / f"{tight}{suffix}", like, OWN)
            taken[tight.lower()] = tight
    return campaign.model_copy(update={"jobs": FrozenDict(jobs)})


def _texts(value: Any) -> Any:
    """Copy of nested values with paths as text, as in the file."""
    if isinstance(value, dict):
        return {key: _texts(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return tuple(map(_texts, value))
    return str(value) if isinstance(value, Path) else value
