"""Prevents all commands from writing to files that are inputs of a campaign."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path

from pydantic import BaseModel

from lrbc_cli.config import Campaign
from lrbc_cli.config.fields import RESULT_FILES
from lrbc_cli.errors import ConfigError


def _figures(*names: str) -> tuple[str, ...]:
    return tuple(f"{name}.{kind}" for name in names for kind in ("png", "pdf", "svg"))


#: Files that ``update``, ``calibrate``, ``reduce``, ``plan`` and ``report`` write: in the output folder, in the folder of a job, in that of
#: the calibration. A test compares these lists with the files written.
IN_OUTPUT = RESULT_FILES
IN_JOB = (
    "result.json",
    "result.previous.json",
    "frf.csv",
    "profile.csv",
    "fdac.csv",
    "evidence.json",
    "shapes.json",
    *_figures("profile", "map", "structure", "shapes", "fdac", "l-curve", "frf-*"),
)
IN_CALIBRATION = ("frf.csv",)

Keys = tuple[str | int, ...]


def input_files(campaign: Campaign) -> list[tuple[Path, Keys]]:
    """Every input file of the campaign, with its keys; the campaign file itself has none."""
    found: list[tuple[Path, Keys]] = [(campaign.path, ())]
    found += [(path, keys) for path, keys in _paths(campaign, ()) if keys != ("output",)]
    return found


def _paths(value: object, keys: Keys) -> Iterator[tuple[Path, Keys]]:
    if isinstance(value, Path):
        yield value, keys
    elif isinstance(value, BaseModel):
        for name, field in type(value).model_fields.items():
            yield from _paths(getattr(value, name), (*keys, field.alias or name))
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from _paths(item, (*keys, name))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _paths(item, (*keys, index))


class _Place:
    """Resolved path and inode of a file, looked up once for many comparisons."""

    def __init__(self, path: Path) -> None:
        self.path, self.real = path, os.path.realpath(path)
        try:
            status = path.stat()
            self.node = (status.st_dev, status.st_ino) if status.st_ino else None
        except OSError:
            self.node = None  # missing or inaccessible: compare names

    def same(self, other: _Place) -> bool:
        if self.node is not None and other.node is not None:
            return self.node == other.node
        return self.real == other.real or (self.real.casefold() == other.real.casefold() and folds_case(Path(self.real).parent))


def same_file(a: Path, b: Path) -> bool:
    """Whether two paths are the same file: links resolved, case ignored if the file system does; files need not exist."""
    return _Place(a).same(_Place(b))


def folds_case(folder: Path) -> bool:
    """Whether the file system of a folder ignores case, as far as existing names show."""
    for at in (folder, *folder.parents):
        other = at.with_name(at.name.swapcase())
        if at.exists() and other != at:
            try:
                return at.samefile(other)
            except OSError:
                return False
    return False


def require_inputs_apart(campaign: Campaign) -> None:
    """Refuse a campaign whose results would replace one of its inputs.

    Raises
    ------
    ConfigError
        Names the key of the input, and the result file that would replace it.
    """
    if campaign.watch is not None and same_file(campaign.watch.folder, campaign.output):
        raise campaign.error(
            "measurements would arrive among the results",
            "watch",
            "folder",
            expected="a folder of measurements only",
            found=f"{campaign.watch.folder}, which is `output`",
            hint="choose another `output`",
        )
    folders = [(campaign.output, IN_OUTPUT), (campaign.output / "calibration", IN_CALIBRATION)]
    folders += [(campaign.output / name, IN_JOB) for name in campaign.jobs]
    inputs = [(_Place(path), keys) for path, keys in input_files(campaign)]
    parents = {place.path.parent.as_posix().casefold() for place, _ in inputs}
    for folder, names in folders:
        # A folder that does not exist contains no links.
        there = folder.is_dir() or folder.as_posix().casefold() in parents
        written = [_Place(folder / name) for name in names if there and "*" not in name]
        patterns = [name for name in names if "*" in name]
        for place, keys in inputs if there else ():
            # A pattern matters only for inputs whose names match it.
            own = [_Place(folder / place.path.name) for name in patterns if fnmatchcase(place.path.name.casefold(), name)]
            for file in (*written, *own):
                if file.same(place):
                    raise _collision(campaign, place.path, keys, file.path)


def _collision(campaign: Campaign, path: Path, keys: Keys, written: Path) -> ConfigError:
    problem = "the results would replace this input"
    expected, hint = "inputs outside the results", "move the file elsewhere, or choose another `output`"
    found = f"{path}, which is {written.relative_to(campaign.output.parent)} of the results"
    if not keys:
        return ConfigError(problem, file=campaign.path, place="output", expected=expected, found=found, hint=hint)
    return campaign.error(problem, *keys, expected=expected, found=found, hint=hint)


def require_no_input(file: Path, campaign: Campaign, option: str) -> None:
    """Refuse to write to an input of the campaign; an input that does not exist yet may be created.

    Raises
    ------
    ConfigError
        Names the key of the input.
    """
    for path, keys in input_files(campaign) if os.path.lexists(file) else ():
        if same_file(file, path):
            named = campaign.place(*keys) if keys else "the campaign file"
            raise ConfigError(
                "this is an input of the campaign", file=file, place=option, expected="a file of its own", found=f"{path} ({named})"
            )


def require_new(file: Path, option: str, agreed: str) -> None:
    """Refuse to replace an existing file.

    Raises
    ------
    ConfigError
        If it exists; ``agreed`` is the option that allows to replace it.
    """
    if os.path.lexists(file):
        raise ConfigError("this file already exists", file=file, place=option, expected="a new file", hint=f"{agreed} replaces it")
